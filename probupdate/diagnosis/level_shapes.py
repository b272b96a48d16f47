"""Rigid, symmetric levels as what is expected of the mean shapes: square structures bend alike to x and y.

A close pair of an upright structure moves each level to x in one of its shapes and to y, by as much, in the other; a
rigid level moves and tilts; modes are real up to a phase. What tolerances and lack of symmetry allow is a Gaussian
unknown, how far each level moves is free. Constant errors of sensors are put right and compared by evidence with one
another, with nothing, and with a structure that is less symmetric or less rigid everywhere or at one level.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy import linalg
from scipy.special import logsumexp

from probupdate.campaign.rigid_bodies import rigid_motions
from probupdate.diagnosis.engine.once import Once
from probupdate.diagnosis.engine.verdict import CHANCE, EffectSet, findings_of
from probupdate.diagnosis.evidence import log_weight_of_size, size_at_bound, size_by_secant
from probupdate.diagnosis.mode_numbers import Reference
from probupdate.diagnosis.problem import DISCREPANCY_PHASE, DISCREPANCY_SHAPE
from probupdate.diagnosis.results import Finding
from probupdate.diagnosis.sensor_changes import MOST_AT_ONCE, MOST_TRIED
from probupdate.effects.catalogue import GAIN_TOLERANCE, ROTATION_TOLERANCE_DEG, Effect, positions
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
# by what share of what a level moves its channels may move by themselves where the structure is odd, as probable before
SPREADS = (0.02, 0.05, 0.1, 0.2)
# a level that is no larger does not tilt
LEAST_EXTENT_M = 0.5
# least share of a signature that must be left beside what is unknown
LEAST_LEFT = 0.1
ODD = "structure less symmetric or less rigid than is normal"
OWN_RESPONSE = "frequency response of its own"
# prior scale of a mode's phase in radian: what shows as much a quarter of a period ahead as a gain does in phase; steps
# in which they are found, the largest one
RESPONSE_SCALE, MOST_STEPS, LARGEST_STEP = 0.1, 12, 0.5


@dataclass(frozen=True, eq=False, kw_only=True)
class LevelMotions:
    """Names of channels; per level the numbers of its channels and what they see of rigid motions (n_channel, 6),
    `places` of sensors with theirs; pairs of motions that a square structure makes alike to x and to y (n_channel, 2):
    rigid ones, and bends of levels that have an extent."""

    channels: tuple[str, ...]
    rows: tuple[list[int], ...]
    places: tuple[tuple[str, tuple[int, ...]], ...]
    rigid: tuple[np.ndarray, ...]
    alike: tuple[np.ndarray, ...]
    bends: tuple[np.ndarray, ...]

    @property
    def own_channel_groups(self) -> list[tuple[str, tuple[int, ...]]]:
        """Places and single channels that one filter or mount may be of."""
        return [*self.places, *((self.channels[k], (k,)) for _, rows in self.places if len(rows) > 1 for k in rows)]


def _level_motions(sensors: Sequence[Sensor | None]) -> LevelMotions:
    levels: dict[str, list[tuple[int, Sensor]]] = {}
    for k, s in enumerate(sensors):
        if s is not None:
            levels.setdefault(s.level, []).append((k, s))
    rigid, alike, bends = [], [], []
    for level in levels.values():
        rows, there = [k for k, _ in level], [s for _, s in level]
        seen, bend = np.zeros((len(sensors), 6)), np.zeros((len(sensors), 2))
        seen[rows] = rigid_motions(there)
        rigid.append(seen)
        alike.append(seen[:, :2])
        arm = np.array([s.position_m for s in there])
        arm = arm - np.unique(arm, axis=0).mean(axis=0)
        size = float(np.max(np.linalg.norm(arm, axis=1)))
        if size > LEAST_EXTENT_M:
            alike.append(seen[:, [4, 3]] * [1, -1])
            bend[rows] = np.prod(arm[:, :2] / size, axis=1)[:, None] * seen[rows][:, [1, 0]]
            bends.append(bend)
    placed = {s.channel: k for k, s in enumerate(sensors) if s is not None}
    places = tuple((name, rows) for name, rows, _ in positions([s for s in sensors if s is not None], placed))
    return LevelMotions(channels=tuple("" if s is None else s.channel for s in sensors),
                        rows=tuple([k for k, _ in level] for level in levels.values()), places=places,
                        rigid=tuple(rigid), alike=tuple(x for x in alike if np.any(x)),
                        bends=tuple(x for x in bends if np.any(x)))


@dataclass(frozen=True, eq=False, kw_only=True)
class LevelReference:
    """Mean complex shapes (n_channel, k) and frequency of every group, with the sensors by channel, and what is normal
    of these: effects with the standard deviation of their sizes. `scatter` per group (n_channel, k): by how much less
    well than as measured what was put right is known; `laws`: what effects make of shapes per unit, per group
    (n_channel, n_channel)."""

    shape: tuple[np.ndarray, ...]
    frequency_hz: tuple[float, ...]
    sensors: tuple[Sensor | None, ...]
    upright: bool
    motions: LevelMotions
    tolerated: tuple[tuple[Effect, float], ...]
    scatter: tuple[np.ndarray, ...]
    laws: dict[Hashable, list[np.ndarray]] = field(default_factory=dict)

    @property
    def log_density(self) -> float:
        """ln density of what was measured, in its standard deviations."""
        return self.measured.log_density + float(np.sum(np.log(self.measured.std)))

    @cached_property
    def measured(self) -> Once:
        std = _numbers([(DISCREPANCY_SHAPE + 1j * DISCREPANCY_PHASE) * s for s in self.scatter])
        return Once(numbers=_numbers(self.shape), std=std, unknowns=self._unknowns())

    def _unknowns(self) -> np.ndarray:
        """Columns (m, n) by which the numbers may differ, of one standard deviation each."""
        unplaced = np.eye(len(self.sensors))[[x is None for x in self.sensors]]
        groups = []
        for shape in self.shape:
            k = shape.shape[1]
            units, square = np.eye(k), self.upright and k == 2
            # how a pair's shapes are turned and sheared (not by how much they move), and every shape's phase
            changes = [SHEAR * shape @ shear for shear in _SHEARS if k == 2]
            changes += [FREE * 1j * shape @ unit for unit in np.eye(k * k).reshape(-1, k, k)]
            changes += [FREE * phase * np.outer(row, unit) for row in unplaced for unit in units for phase in (1, 1j)]
            changes += [FREE * np.outer(column, unit) for column in np.hstack(self.motions.rigid).T
                        for unit in units if not square]
            # each to x and to y by itself: as square as structures are, or as bends go
            for both in (*(self.motions.alike if square else ()), *self.motions.bends):
                moved = float(np.max(np.abs(shape[np.any(both != 0, axis=1)])))
                allowed = ASYMMETRY * moved if square else SPLAY
                changes += [FREE * both] if square else []
                changes += [allowed * np.outer(part, unit) for part in both.T for unit in units]
            groups.append(np.column_stack([_numbers([change]) for change in changes]))
        tolerated = [allowed * self.signature(effect) for effect, allowed in self.tolerated]
        return np.column_stack([linalg.block_diag(*groups), *tolerated])

    def sensed_shapes(self, effect: Effect, size: float) -> list[np.ndarray]:
        """Per group (n_channel, n_channel) what an effect of sensors makes of shapes."""
        return [effect.observation(np.eye(len(s), dtype=complex), hz, size)[0]
                for s, hz in zip(self.shape, self.frequency_hz, strict=True)]

    def signature(self, effect: Effect) -> np.ndarray:
        """(m,) change of the numbers per unit of an effect."""
        if effect.key not in self.laws:
            h = effect.step_of_size
            self.laws[effect.key] = [(more - less) / (2 * h) for more, less in
                                     zip(self.sensed_shapes(effect, h), self.sensed_shapes(effect, -h), strict=True)]
        return _numbers([law @ s for law, s in zip(self.laws[effect.key], self.shape, strict=True)])

    def score_effect(self, effect: Effect) -> tuple[float, float, float]:
        """Score and information of an effect, and the share of its signature that is left beside what is unknown."""
        signature = self.signature(effect)
        (u,), ((v,),) = self.measured.scores(signature[:, None])
        raw = float(np.sum((signature / self.measured.std) ** 2))
        return float(u), float(v), float(np.sqrt(max(v, 0.0) / raw)) if raw else 0.0

    def remove_effect(self, effect: Effect, size: float) -> LevelReference:
        """The shapes as they were without an effect of that size; a shape has no scale of its own."""
        shapes, scatter = [], []
        for M, s, own in zip(self.sensed_shapes(effect, size), self.shape, self.scatter, strict=True):
            back = np.linalg.inv(M)
            shape, scale = _rotate_to_real(back @ s)
            shapes.append(shape)
            scatter.append(np.sqrt(np.abs(back) ** 2 @ own**2) / scale)
        return replace(self, shape=tuple(shapes), scatter=tuple(scatter))

    def lead_response(self, rows: Sequence[int]) -> np.ndarray:
        """(m, 2 n_group) change of the numbers per radian that these channels lead, and per unit of the logarithm of
        their gain, in each group."""
        there = np.zeros((len(self.sensors), 1))
        there[list(rows)] = 1.0
        return np.column_stack([_numbers([unit * there * s * (r == q) for r, s in enumerate(self.shape)])
                                for unit in (1j, 1.0) for q in range(len(self.shape))])

    @cached_property
    def log_odd(self) -> float:
        """ln Bayes factor of a structure that is less symmetric and less rigid than is normal, everywhere, at one level
        or at one place: legs without their brace move by themselves."""
        alone = [sum(self.motions.rows, []), *self.motions.rows, *(list(rows) for _, rows in self.motions.places)]
        each = [self.measured.log_wider(self._moving_alone(rows, spread)) for rows in alone for spread in SPREADS]
        return float(logsumexp(each) - np.log(len(each)))

    def _moving_alone(self, rows: Sequence[int], spread: float) -> np.ndarray:
        """(m,) standard deviations by which these channels move by themselves, a share of the most that one moves."""
        own = [np.zeros_like(s) for s in self.shape]
        for made, shape in zip(own, self.shape, strict=True):
            made[rows] = spread * np.max(np.abs(shape[rows]), axis=0)
        return _numbers(own)

    @property
    def backward(self) -> bool:
        """Whether, in the lowest pair of an upright structure, some level goes against the others: it bends to one
        side."""
        if not self.upright or self.shape[0].shape[1] != 2:
            return False
        along = np.array([s.direction[:2] if s is not None and abs(s.direction[2]) < 0.3 else (0.0, 0.0)
                          for s in self.sensors])
        moved = np.sum(self.shape[0].real * along, axis=1)
        means = np.array([np.mean(moved[rows]) for rows in self.motions.rows])
        return bool(np.any(means > 0.02) and np.any(means < -0.02))


def level_reference(
    means: Sequence[Reference], channels: Sequence[str], sensors: Sequence[Sensor], effects: Sequence[Effect]
) -> LevelReference:
    by_name = {s.channel: s for s in sensors}
    placed = tuple(by_name.get(c) for c in channels)
    extent = np.ptp([s.position_m for s in sensors], axis=0)
    upright = len({s.level for s in sensors}) > 1 and extent[2] > 2 * np.hypot(extent[0], extent[1])
    tolerance = {"sensor gain": GAIN_TOLERANCE, "sensor rotation": ROTATION_TOLERANCE_DEG}
    return LevelReference(
        shape=tuple(_rotate_to_real(m.shape)[0] for m in means), sensors=placed, upright=bool(upright),
        scatter=tuple(np.ones(m.shape.shape) for m in means),
        motions=_level_motions(placed),
        frequency_hz=tuple(float(np.exp(np.trace(m.tensor) / len(m.tensor))) for m in means),
        tolerated=tuple((e, tolerance[e.cause]) for e in effects if e.tolerance and e.cause in tolerance))


def _rotate_to_real(shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Columns turned to the real axis, largest component 1, and what that was (k,)."""
    turned = shape * np.exp(-0.5j * np.angle(np.sum(shape**2, axis=0)))
    scale = np.max(np.abs(turned), axis=0)
    return turned / scale, scale


def _numbers(shapes: Sequence[np.ndarray]) -> np.ndarray:
    return np.concatenate([np.concatenate([np.real(s.T).ravel(), np.imag(s.T).ravel()]) for s in shapes])


# Selection ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, kw_only=True)
class PutRight(EffectSet):
    """The levels without effects of a size each; ln posterior odds over nothing."""

    levels: LevelReference
    log_odds: float


@dataclass(frozen=True, eq=False, kw_only=True)
class EffectTest:
    """Of an effect to first order: |z| from which it would be found, standard deviation of its size, share of its
    signature that is left beside what is unknown, z."""

    needed: float
    size_std: float
    share_left: float
    z: float


@dataclass(frozen=True, eq=False, kw_only=True)
class LevelAnswer:
    """Findings; ln posterior odds of anything over nothing; whether beside what sensors explain best the structure is
    odd; what could be found."""

    findings: tuple[Finding, ...]
    log_odds: float
    unexplained: bool
    tested: tuple[tuple[Effect, EffectTest], ...]


def judge_levels(levels: LevelReference, effects: Sequence[Effect], share: float) -> LevelAnswer:
    """What sensors' `effects` have done throughout. `share`: odds of nothing below which anything is said."""
    total = 2 * sum(e.prior_odds("constant") for e in effects)
    prior = {e.key: float(np.log(e.prior_odds("constant") / total)) for e in effects}
    best = PutRight(effects=(), size=(), size_std=(), levels=levels, log_odds=0.0)
    tried: dict[frozenset, PutRight] = {}
    for number in range(MOST_AT_ONCE):
        tried |= {one.keys: one for one in _add_one_effect(best, effects, prior)}
        best = max([best, *tried.values()], key=lambda one: one.log_odds)
        if len(best.effects) <= number:
            break
    # sensors and the structure are as probable before as each other, and both as nothing
    odd, sets = levels.log_odd - np.log(2), list(tried.values())
    log_odds = float(logsumexp([odd, *(one.log_odds for one in sets)]))
    found, unexplained = None, best.levels.log_odd > -np.log(share)
    if log_odds > -np.log(share) and not unexplained:
        found = findings_of(sets, [one.log_odds for one in sets], [(ODD, "structure", odd), (CHANCE, "", 0.0)],
                            time_profile="constant")
    return LevelAnswer(findings=() if found is None else found[1], log_odds=log_odds, unexplained=unexplained,
                       tested=tuple((e, _judge_effect(levels, e, prior[e.key], share)) for e in effects
                                    if not e.discrete))


def _add_one_effect(begun: PutRight, effects: Sequence[Effect], prior: Mapping[Hashable, float]) -> list[PutRight]:
    """The effects that first order, or their only size, promises most of beside those begun with, each put right at the
    size that leaves nothing of it; and each place of sensors with a response of its own."""
    levels, once = begun.levels, begun.levels.measured
    free = [e for e in effects if e not in begun.effects]
    if not free:
        return []
    promised = {}
    before = once.misfits(once.numbers[:, None])[0]
    for e in free:
        if e.discrete:
            rest = levels.remove_effect(e, e.discrete[0])
            promised[e] = 0.5 * (before - once.misfits(_numbers(rest.shape)[:, None])[0])
        else:
            score, v, left = levels.score_effect(e)
            promised[e] = 0.5 * score**2 / v if left > LEAST_LEFT else -np.inf
    order = sorted(promised, key=lambda e: -promised[e] - prior[e.key])[:MOST_TRIED]
    found = [_correct_effect(begun, e, prior[e.key]) for e in order]
    if all(e.cause != OWN_RESPONSE for e in begun.effects):
        found += [_fit_channel_response(begun, name, rows, min(prior.values()))
                  for name, rows in levels.motions.own_channel_groups]
    return [one for one in found if one is not None]


def _correct_effect(begun: PutRight, effect: Effect, log_prior: float) -> PutRight | None:
    """None where the size ends at a bound, or nothing of its signature is left: what was measured asks for something
    else."""
    def remaining_size(size: float) -> tuple[float, float]:
        score, v, shown = begun.levels.remove_effect(effect, size).score_effect(effect)
        return (score / v, v**-0.5) if shown > LEAST_LEFT else (0.0, np.inf)

    size, std = (effect.discrete[0], 0.0) if effect.discrete else size_by_secant(effect, remaining_size)
    if not np.isfinite(std) or size_at_bound(effect, size):
        return None
    return _add_effect(begun, effect, effect, size, std, log_prior + log_weight_of_size(effect, size, std))


def _add_effect(
    begun: PutRight, effect: Effect, done: Effect, size: float, std: float, log_prior: float
) -> PutRight | None:
    """One effect more, stated with a size; `done`: what it did to the shapes, at its own size."""
    own = done.discrete[0] if done.discrete else size
    levels = begun.levels.remove_effect(done, own)
    if levels.backward:
        return None
    return PutRight(effects=(*begun.effects, effect), size=(*begun.size, size), size_std=(*begun.size_std, std),
                    levels=levels,
                    log_odds=begun.log_odds + levels.log_density - begun.levels.log_density + log_prior)


@dataclass(frozen=True, eq=False, kw_only=True)
class MeasuredResponse:
    """Channels `rows` that show the modes of each of the frequencies `at_hz` with these leads `phase` (n,) in radian
    and logarithms of their gain `gain` (n,): a filter, a loose mount, a geophone below its corner, where a clock's lead
    would grow with frequency. How far a whole level moves is not known: its gain stays at none."""

    rows: tuple[int, ...]
    at_hz: tuple[float, ...]
    phase: tuple[float, ...]
    gain: tuple[float, ...]

    def __call__(self, shape, frequency_hz, size):
        result = np.array(shape, complex)
        nearest = int(np.argmin(np.abs(np.log(frequency_hz) - np.log(self.at_hz))))
        result[list(self.rows)] *= np.exp((self.gain[nearest] + 1j * self.phase[nearest]) * size)
        return result, 0.0

    def words(self) -> str:
        """The lead and gain of each mode for people."""
        return ", ".join(f"{'a lead' if a >= 0 else 'a lag'} of {abs(np.degrees(a)):.0f} deg"
                         + (f" and {np.exp(g):.2f} times" if abs(g) > 0.02 else "") + f" at {hz:.3g} Hz"
                         for hz, a, g in sorted(zip(self.at_hz, self.phase, self.gain, strict=True)))


def _fit_channel_response(begun: PutRight, place: str, rows: tuple[int, ...], log_prior: float) -> PutRight | None:
    """As probable before as one row; each mode's phase and gain pay for what they may be. None where no phases below a
    half turn settle."""
    n = len(begun.levels.shape)
    value = np.zeros(2 * n)
    for _ in range(MOST_STEPS):
        done = _response(place, MeasuredResponse(rows=rows, at_hz=begun.levels.frequency_hz, phase=tuple(value[:n]),
                                                 gain=tuple(value[n:])))
        there = begun.levels.remove_effect(done, 1.0)
        u, information = there.measured.scores(there.lead_response(rows))
        precision = information + np.diag(2 / (RESPONSE_SCALE**2 + value**2))
        std = np.sqrt(np.diag(np.linalg.inv(precision)))
        step = np.linalg.solve(precision, u - 2 * value / (RESPONSE_SCALE**2 + value**2))
        if np.all(np.abs(step) < 0.1 * std):
            largest = int(np.argmax(np.abs(value[:n]) / std[:n]))
            free = replace(done, discrete=())
            weight = sum(log_weight_of_size(free, float(a), float(s)) for a, s in zip(value, std, strict=True))
            return _add_effect(begun, done, done, float(value[largest]), float(std[largest]), log_prior + weight)
        value = value + np.clip(step, -LARGEST_STEP, LARGEST_STEP)
        if np.any(np.abs(value[:n]) > np.pi):
            return None
    return None


def _response(place: str, observe: MeasuredResponse) -> Effect:
    return Effect(kind="measurement", cause=OWN_RESPONSE, location=place, unit="rad", tolerance=0.0,
                  prior_scale=RESPONSE_SCALE, lower=-np.pi, upper=np.pi, observe=observe, discrete=(1.0,),
                  signature="channels of one place with another phase and gain in every mode",
                  check="look at its mount, its cable and its filter")


def _judge_effect(levels: LevelReference, effect: Effect, log_prior: float, share: float) -> EffectTest:
    score, v, left = levels.score_effect(effect)
    if left < LEAST_LEFT:
        return EffectTest(needed=np.inf, size_std=np.inf, share_left=left, z=0.0)
    # the odds of what is found just so, at the size that it then has
    std, needed = v**-0.5, 0.0
    for _ in range(2):
        weight = log_weight_of_size(effect, needed * std, std)
        needed = float(np.sqrt(2 * max(-np.log(share) - log_prior - weight, 0.0)))
    return EffectTest(needed=needed, size_std=std, share_left=left, z=score * std)
