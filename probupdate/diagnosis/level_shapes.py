"""Constant errors of sensors by the mean shapes alone: levels are rigid, square structures bend alike to x and y.

A close pair of an upright structure moves each level to x in one of its shapes and to y, by as much, in the other; a
rigid level moves and tilts; modes are real up to a phase. What tolerances and lack of symmetry allow is a Gaussian
unknown, how far each level moves is free. A sensor whose change mends what is beyond that is named, if no other does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg
from scipy.special import logsumexp

from probupdate.diagnosis.diagnose import POWER
from probupdate.diagnosis.evidence import log_weight_of_size, size_at_bound, size_by_secant
from probupdate.diagnosis.level_responses import own_responses
from probupdate.diagnosis.mode_numbers import Reference
from probupdate.diagnosis.problem import DISCREPANCY_PHASE, DISCREPANCY_SHAPE
from probupdate.effects.catalogue import GAIN_TOLERANCE, ROTATION_TOLERANCE_DEG, Effect
from probupdate.modal.modes import Sensor

# what is free may be so many times the largest component
FREE = 10.0
# how far the axes of a pair, found by a vote of the levels, may be turned and sheared
SHEAR = 0.1
# lack of symmetry between x and y, share of a level's motion: the rotor's inertias, legs and soil that differ
ASYMMETRY = 0.05
# bends beside a rigid level's motion (legs towards and from one another), share of the largest component
SPLAY = 0.05
_SHEARS = np.array([[[0.0, -1], [1, 0]], [[0, 1], [1, 0]], [[1, 0], [0, -1]]])
N_DRAW, MOST = 4000, 3
# by what share of what a level moves its channels may move by themselves where the structure is odd, as probable before
SPREADS = (0.02, 0.05, 0.1, 0.2)


@dataclass(frozen=True, eq=False, kw_only=True)
class Mended:
    """An effect of sensors that explains what is beyond the normal: size with standard deviation, z, by how much the
    fit betters (half a chi-square), what is left (largest z over the threshold), ln posterior over that of no
    effect."""

    effect: Effect
    size: float
    size_std: float
    z: float
    gain: float
    left: float
    log_posterior: float


@dataclass(frozen=True, eq=False, kw_only=True)
class LevelAnswer:
    """found: per effect taken in, its competing hypotheses, best first; `structure` for each of these the ln posterior
    of a structure that is neither symmetric nor rigid; `detectable_sizes` per effect (size, share of its signature
    left, z); threshold; p_value of the largest z; unexplained: what remains over the threshold, 0 where nothing
    does."""

    found: tuple[tuple[Mended, ...], ...]
    structure: tuple[float, ...]
    detectable_sizes: dict[int, tuple[float, float, float]]
    threshold: float
    p_value: float
    unexplained: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Shapes:
    """Mean complex shapes (n_channel, k) and frequency of every group, with the sensors by channel."""

    shape: tuple[np.ndarray, ...]
    frequency_hz: tuple[float, ...]
    sensors: tuple[Sensor | None, ...]
    upright: bool


def mean_shapes(means: Sequence[Reference], channels: Sequence[str], sensors: Sequence[Sensor]) -> Shapes:
    by_name = {s.channel: s for s in sensors}
    placed = tuple(by_name.get(c) for c in channels)
    extent = np.ptp([s.position_m for s in sensors], axis=0)
    upright = len({s.level for s in sensors}) > 1 and extent[2] > 2 * np.hypot(extent[0], extent[1])
    return Shapes(shape=tuple(_along(m.shape) for m in means), sensors=placed, upright=bool(upright),
                  frequency_hz=tuple(float(np.exp(np.trace(m.tensor) / len(m.tensor))) for m in means))


def _along(shape: np.ndarray) -> np.ndarray:
    """Columns turned to the real axis, largest component 1."""
    turned = shape * np.exp(-0.5j * np.angle(np.sum(shape**2, axis=0)))
    return turned / np.max(np.abs(turned), axis=0)


def _numbers(shapes: Sequence[np.ndarray]) -> np.ndarray:
    return np.concatenate([np.concatenate([np.real(s.T).ravel(), np.imag(s.T).ravel()]) for s in shapes])


def _levels(sensors: Sequence[Sensor | None]) -> list[list[tuple[int, Sensor]]]:
    """Per level its sensors with the numbers of their channels."""
    levels: dict[str, list[tuple[int, Sensor]]] = {}
    for k, s in enumerate(sensors):
        if s is not None:
            levels.setdefault(s.level, []).append((k, s))
    return list(levels.values())


def patterns(sensors: Sequence[Sensor | None]) -> list[tuple[np.ndarray, np.ndarray, bool]]:
    """Per level the motions of a square structure: what channels see (n_channel,) of one to x and of the same to y, and
    whether it is one of a rigid body."""
    result = []
    for placed in _levels(sensors):
        rows = [k for k, _ in placed]
        position = np.array([s.position_m for _, s in placed])
        direction = np.array([s.direction for _, s in placed])
        arm = position - np.unique(position, axis=0).mean(axis=0)
        size = max(float(np.max(np.linalg.norm(arm, axis=1))), 1e-9)
        fields = [(np.tile([1.0, 0, 0], (len(rows), 1)), np.tile([0, 1.0, 0], (len(rows), 1)), True)]
        if size > 0.5:
            fields.append((np.cross([0, 1.0, 0], arm) / size, np.cross([-1.0, 0, 0], arm) / size, True))
            twist = (arm[:, 0] * arm[:, 1] / size**2)[:, None]
            fields.append((twist * [0, 1.0, 0], twist * [1.0, 0, 0], False))
        for to_x, to_y, rigid in fields:
            pair = np.zeros((2, len(sensors)))
            pair[:, rows] = np.sum(direction * to_x, axis=1), np.sum(direction * to_y, axis=1)
            if np.any(np.abs(pair) > 1e-6):
                result.append((pair[0], pair[1], rigid))
    return result


def rigid_motions(sensors: Sequence[Sensor | None]) -> np.ndarray:
    """(n_channel, n): what channels see of each level's own six motions."""
    columns = []
    for placed in _levels(sensors):
        rows = [k for k, _ in placed]
        position = np.array([s.position_m for _, s in placed])
        arm = position - position.mean(axis=0)
        arm = arm / max(float(np.max(np.abs(arm))), 1e-9)
        for axis in np.eye(3):
            for field in (np.tile(axis, (len(rows), 1)), np.cross(axis, arm)):
                column = np.zeros(len(sensors))
                column[rows] = np.sum(field * [s.direction for _, s in placed], axis=1)
                columns.append(column)
    return np.array(columns).T


def _unknowns(s: Shapes, tolerated: Sequence[tuple[Effect, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Columns (m, n) by which the numbers may differ, and their standard deviations (n,)."""
    columns, std = [], []

    def add(q, change, allowed):
        columns.append(_numbers([change if r == q else np.zeros_like(x) for r, x in enumerate(s.shape)]))
        std.append(allowed)

    own, rigid = patterns(s.sensors), rigid_motions(s.sensors)
    unplaced = np.flatnonzero([x is None for x in s.sensors])
    for q, shape in enumerate(s.shape):
        n, k = shape.shape
        square = s.upright and k == 2
        # how a pair's shapes are turned and sheared (not by how much they move), and every shape's phase
        for shear in _SHEARS if k == 2 else ():
            add(q, shape @ shear + 0j, SHEAR)
        for i in range(k):
            for j in range(k):
                add(q, 1j * np.outer(shape[:, i], np.eye(k)[j]), FREE)
            for row in unplaced:
                for unit in (1.0, 1j):
                    add(q, unit * np.outer(np.eye(n)[row], np.eye(k)[i]), FREE)
        if not square:
            for column in rigid.T:
                for j in range(k):
                    add(q, np.outer(column, np.eye(k)[j]) + 0j, FREE)
        for to_x, to_y, stiff in own:
            both = np.column_stack([to_x, to_y])
            if square:
                add(q, both + 0j, FREE)
                moved = float(np.max(np.abs(shape[np.any(both != 0, axis=1)])))
                for part in (to_x, to_y):
                    for j in range(2):
                        add(q, np.outer(part, np.eye(2)[j]) + 0j, ASYMMETRY * moved)
            elif not stiff:
                for part in (to_x, to_y):
                    for j in range(k):
                        add(q, np.outer(part, np.eye(k)[j]) + 0j, SPLAY)
    for effect, allowed in tolerated:
        columns.append(_change(s, effect))
        std.append(allowed)
    return np.array(columns).T, np.array(std)


def _seen(s: Shapes, effect: Effect, size: float, inverse: bool = False) -> list[np.ndarray]:
    result = []
    for shape, frequency in zip(s.shape, s.frequency_hz, strict=True):
        if inverse:
            whole, _ = effect.observation(np.eye(len(shape), dtype=complex), frequency, size)
            result.append(np.linalg.solve(whole, shape))
        else:
            result.append(effect.observation(shape, frequency, size)[0])
    return result


def _change(s: Shapes, effect: Effect) -> np.ndarray:
    h = effect.step_of_size
    return (_numbers(_seen(s, effect, h)) - _numbers(_seen(s, effect, -h))) / (2 * h)


def _without(s: Shapes, effect: Effect, size: float) -> Shapes:
    return Shapes(shape=tuple(_along(x) for x in _seen(s, effect, size, inverse=True)), frequency_hz=s.frequency_hz,
                  sensors=s.sensors, upright=s.upright)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Test:
    """chi2 of the shapes; per effect u = f' V^-1 y, v = f' V^-1 f, raw = f' f over the model discrepancy's square; root
    (n_effect, m) of which random normals make scores."""

    chi2: float
    u: np.ndarray
    v: np.ndarray
    raw: np.ndarray
    score_correlation: np.ndarray


def _test(s: Shapes, tolerated, effects: Sequence[Effect]) -> _Test:
    y, discrepancy_std = _numbers(s.shape), _discrepancy_std(s)
    U, std = _unknowns(s, tolerated)
    scaled = U * std / discrepancy_std[:, None]
    white = y / discrepancy_std
    F = np.array([_change(s, e) for e in effects]).T / discrepancy_std[:, None] if effects else np.zeros((len(y), 0))
    inner = np.linalg.cholesky(np.eye(len(std)) + scaled.T @ scaled)
    solve = lambda x: x - scaled @ np.linalg.solve(inner.T, np.linalg.solve(inner, scaled.T @ x))  # noqa: E731
    VF = solve(F)
    information = F.T @ VF
    v = np.maximum(np.diag(information), 0.0)
    size = np.sqrt(np.maximum(v, 1e-300))
    return _Test(chi2=float(white @ solve(white)), u=VF.T @ white, v=v, raw=np.sum(F**2, axis=0),
                 score_correlation=np.clip(information / np.outer(size, size), -1, 1))


def _discrepancy_std(s: Shapes, rows: Sequence[int] = (), spread: float = 0.0) -> np.ndarray:
    """Of `_numbers`; where the channels `rows` move by themselves, by a share `spread` of the most that one of them
    moves."""
    result = []
    for shape in s.shape:
        real = np.full(shape.T.shape, DISCREPANCY_SHAPE)
        if len(rows):
            moved = np.max(np.abs(shape[list(rows)]), axis=0)
            real[:, list(rows)] = np.hypot(DISCREPANCY_SHAPE, spread * moved)[:, None]
        result += [real.ravel(), np.full(shape.size, DISCREPANCY_PHASE)]
    return np.concatenate(result)


def _log_odd_structure(s: Shapes, tolerated) -> float:
    """ln Bayes factor of a structure that is less symmetric and less rigid than is normal, everywhere or at one level,
    over one that is not: legs without their brace move by themselves."""
    y, (U, std) = _numbers(s.shape), _unknowns(s, tolerated)

    def log_density(discrepancy_std: np.ndarray) -> float:
        scaled, white = U * std / discrepancy_std[:, None], y / discrepancy_std
        inner = np.linalg.cholesky(np.eye(len(std)) + scaled.T @ scaled)
        known = linalg.solve_triangular(inner, scaled.T @ white, lower=True)
        return float(-0.5 * (white @ white - known @ known) - np.sum(np.log(np.diag(inner)))
                     - np.sum(np.log(discrepancy_std)))

    placed = [[k for k, _ in level] for level in _levels(s.sensors)]
    each = [log_density(_discrepancy_std(s, rows, spread)) for rows in [sum(placed, []), *placed] for spread in SPREADS]
    return float(logsumexp(each) - np.log(len(each)) - log_density(_discrepancy_std(s)))


def _usable(t: _Test) -> np.ndarray:
    return t.v > 1e-2 * np.maximum(t.raw, 1e-300)


def _best_size(s: Shapes, tolerated, effect: Effect) -> tuple[Shapes, float, float, float]:
    """The shapes without the effect of the size that fits best, that size, its standard deviation, chi2."""
    if effect.discrete:
        now = _without(s, effect, effect.discrete[0])
        return now, effect.discrete[0], 0.0, _test(now, tolerated, ()).chi2

    def left(size: float) -> tuple[float, float]:
        t = _test(_without(s, effect, size), tolerated, (effect,))
        return (float(t.u[0] / t.v[0]), float(t.v[0] ** -0.5)) if _usable(t)[0] else (0.0, np.inf)

    size, std = size_by_secant(effect, left)
    if not np.isfinite(std):
        return s, 0.0, np.inf, np.inf
    now = _without(s, effect, size)
    return now, size, std, _test(now, tolerated, ()).chi2


def judge_levels(
    s: Shapes, effects: Sequence[Effect], whole: Sequence[Effect], *, false_alarm: float, seed: int
) -> LevelAnswer:
    """`effects` of sensors with a size, `whole` ones that are there or not. false_alarm: chance that any is named when
    nothing is wrong."""
    tolerance = {"sensor gain": GAIN_TOLERANCE, "sensor rotation": ROTATION_TOLERANCE_DEG}
    tolerated = [(e, tolerance[e.cause]) for e in effects if e.tolerance and e.cause in tolerance]
    first = _test(s, tolerated, effects)
    usable = _usable(first)
    z = np.where(usable, first.u / np.sqrt(np.maximum(first.v, 1e-300)), 0.0)
    rng = np.random.default_rng([seed, 33])
    value, vector = np.linalg.eigh(first.score_correlation)
    drawn = rng.standard_normal((N_DRAW, len(value))) @ (vector * np.sqrt(np.maximum(value, 0.0))).T
    maxima = np.max(np.abs(drawn[:, usable]), axis=1) if usable.any() else np.full(N_DRAW, np.inf)
    threshold = float(np.quantile(maxima, 1 - false_alarm)) if usable.any() else np.inf
    share = np.sqrt(first.v / np.maximum(first.raw, 1e-300))
    detectable_sizes = {k: (float((threshold + POWER) * first.v[k] ** -0.5) if usable[k] else np.inf, float(share[k]),
                  float(z[k])) for k in range(len(effects))}
    p_value = float((1 + np.sum(maxima >= np.max(np.abs(z), initial=0.0))) / (N_DRAW + 1))
    found: list[tuple[Mended, ...]] = []
    structure: list[float] = []
    now, left = s, float(np.max(np.abs(z), initial=0.0)) / threshold
    while left > 1 and len(found) < MOST:
        competing, best = _competing(now, tolerated, effects, whole, threshold)
        # sensors and the structure are as probable before as each other, no change as both
        odd = _log_odd_structure(now, tolerated) - np.log(2)
        if not competing or competing[0].left >= left:
            break
        if max(odd, 0.0) > max(m.log_posterior for m in competing):
            # beyond the threshold, but so are the most of so many by chance
            left = left if odd > 0 else 0.0
            break
        found.append(tuple(competing))
        structure.append(odd)
        now, left = best, competing[0].left
    if left > 1:
        found, structure = [], []
    return LevelAnswer(found=tuple(found), structure=tuple(structure), detectable_sizes=detectable_sizes,
                       threshold=threshold, p_value=p_value, unexplained=left if left > 1 else 0.0)


def _competing(now: Shapes, tolerated, effects, whole, threshold) -> tuple[list[Mended], Shapes]:
    """Every effect that mends much of what is beyond, best first, and the shapes without the best."""
    t = _test(now, tolerated, effects)
    usable = _usable(t)
    z = np.where(usable, t.u / np.sqrt(np.maximum(t.v, 1e-300)), 0.0)
    order = [int(k) for k in np.argsort(-np.abs(z))[:6] if abs(z[k]) > 0.5 * np.max(np.abs(z))]
    near = {effects[k].location for k in np.argsort(-np.abs(z))[:8]}
    tried = []
    total = 2 * sum(e.prior_odds("constant") for e in (*effects, *whole))
    # a response of its own is as probable before as one row, and its factors pay for what they may be
    own = {r.effect: r for r in own_responses(now.sensors, now.frequency_hz, _scored(now, tolerated))}
    for effect in [*(effects[k] for k in order), *(e for e in whole if set(e.location.split(" and ")) <= near), *own]:
        then, size, std, chi2 = _best_size(now, tolerated, effect)
        if not np.isfinite(chi2) or size_at_bound(effect, size) or _backward(then):
            continue
        left = _test(then, tolerated, effects)
        remaining = np.where(_usable(left), np.abs(left.u) / np.sqrt(np.maximum(left.v, 1e-300)), 0.0)
        gain = 0.5 * (t.chi2 - chi2)
        posterior = gain + np.log(effect.prior_odds("constant") / total) + log_weight_of_size(effect, size, std)
        if effect in own:
            size, std = own[effect].largest
            posterior += sum(log_weight_of_size(replace(effect, discrete=()), float(a), float(b))
                             for a, b in zip(own[effect].phase, own[effect].phase_std, strict=True))
        tried.append((Mended(effect=effect, size=size, size_std=std, z=float(np.sqrt(max(2 * gain, 0.0))), gain=gain,
                             left=float(remaining.max()) / threshold, log_posterior=float(posterior)), then))
    tried.sort(key=lambda r: -r[0].log_posterior)
    return [r for r, _ in tried], tried[0][1] if tried else now


def _scored(s: Shapes, tolerated) -> Callable[[Effect, list[Effect]], tuple[np.ndarray, np.ndarray]]:
    """Scores and information of effects beside what is taken out."""
    def scored(taken_out: Effect, parts: list[Effect]) -> tuple[np.ndarray, np.ndarray]:
        t = _test(_without(s, taken_out, 1.0), tolerated, parts)
        size = np.sqrt(np.maximum(t.v, 0.0))
        return t.u, t.score_correlation * np.outer(size, size)
    return scored


def _backward(s: Shapes) -> bool:
    """Whether, in the lowest pair of an upright structure, some level goes against the others: it bends to one side."""
    if not s.upright or s.shape[0].shape[1] != 2:
        return False
    level: dict[str, list[float]] = {}
    for k, sensor in enumerate(s.sensors):
        if sensor is not None and abs(sensor.direction[2]) < 0.3:
            level.setdefault(sensor.level, []).append(float(s.shape[0][k].real @ sensor.direction[:2]))
    means = np.array([np.mean(v) for v in level.values()])
    return bool(np.any(means > 0.02) and np.any(means < -0.02))
