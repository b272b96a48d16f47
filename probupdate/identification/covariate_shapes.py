"""How a response follows a covariate, if not along a line: after a lag or with hysteresis, with a bend or up to a
saturation, or both; and beside all covariates along time, over the day or by a step. Shapes compete by evidence under
errors that last.

Evidence is the marginal likelihood with coefficients of unit information (the Bayesian information criterion before its
maximum over the error's size and length, and over a shape's own constant, which are averaged over).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import linalg

from probupdate.identification.slow_error import whiten_columns

# odds over the model without it from which a shape is taken; shapes share an even chance
ODDS, MOST_SHAPES = 20.0, 4
# ratios of slow error to noise and number of lengths over which evidence is averaged; points of a shape's own constant
RATIOS, N_HOURS, N_COARSE, N_FINE = (0.0, 0.3, 1.0, 3.0), 5, 16, 9
# places of a step, at most
N_PLACES = 1000
# a bend, a saturation or a step has so large a share of the blocks on each side, and eight at least
LEAST_SHARE, LEAST_ROWS = 0.05, 8
DAY_H = 24.0
# the lunar tide's is that of half a day as the moon has it (M2)
PERIODS_H = {"day": DAY_H, "tide": 12.4206}
# a covariate is followed in one way and bends in one, which may be of what is followed
FOLLOWED, BENT = "follows", "bends"
WAYS = {"lag": FOLLOWED, "hysteresis": FOLLOWED, "bend": BENT, "saturation": BENT}


@dataclass(frozen=True, eq=False, kw_only=True)
class Shape:
    """kind: 'lag', 'bend', 'saturation', 'hysteresis', 'harmonic', 'day', 'tide', 'drift' or 'step', of `covariate`
    ('' of the last four). constant with constant_std: hours of the lag or of the step, or in the covariate's unit; NaN
    where there is none. ln_odds: of the model with it over that without. names of its columns."""

    kind: str
    covariate: str
    constant: float
    constant_std: float
    ln_odds: float
    names: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Candidate:
    kind: str
    covariate: str
    constants: np.ndarray
    columns: Callable[[float], np.ndarray]
    names: Callable[[float], tuple[str, ...]]
    # columns that hold for what is not known and are no covariate's
    nuisance: int = 0
    adds: bool = False
    # of a covariate's constant what is followed (n_row,); of what is followed and a constant its columns
    follow: Callable[[float], np.ndarray] | None = None
    bend: Callable[[np.ndarray, float], np.ndarray] | None = None

    @property
    def way(self) -> tuple[str, str]:
        """What a covariate, or time, has once."""
        return self.covariate, WAYS.get(self.kind, self.kind)


@dataclass(frozen=True, eq=False, kw_only=True)
class ChosenCovariates:
    """names and columns (n_row,) of all covariates as they are to be fitted, and of nuisances; shapes in the order in
    which they were found; spread (n_name, n_name): covariance of the coefficients of `names` for what is not known of
    the shapes' constants; followed: of covariates that are followed behind, what is followed (n_row,)."""

    names: tuple[str, ...]
    columns: tuple[np.ndarray, ...]
    nuisances: tuple[np.ndarray, ...]
    shapes: tuple[Shape, ...]
    spread: np.ndarray
    followed: Mapping[str, np.ndarray]


def choose_shapes(
    value: np.ndarray, noise: np.ndarray, time_h: np.ndarray, covariates: Mapping[str, np.ndarray]
) -> ChosenCovariates:
    """Shapes of value (n_row,), all known, at time_h (n_row,) ascending with standard deviations noise (n_row,), one by
    one as long as the odds for the best are twenty beyond all others' share. A name 'cos x' has its 'sin x'."""
    so_far = _Columns(blocks={name: column[:, None] for name, column in covariates.items()},
                      names={name: (name,) for name in covariates})
    shapes: list[Shape] = []
    for _ in range(MOST_SHAPES):
        ahead = [c for c in _candidates(covariates, time_h, so_far) if c.way not in so_far.taken]
        if not ahead:
            break
        # with the constants found so far as if they were known, as the candidates have them
        nothing = np.zeros((len(value), 0))
        best = _evidence(value, noise, time_h, so_far.table(value), [nothing])[0]
        found = [_weigh(c, value, noise, time_h, so_far, best) for c in ahead]
        k = int(np.argmax([f.gain for f in found]))
        gain = found[k].gain - np.log(len(ahead))
        if gain < np.log(ODDS):
            break
        shapes.append(Shape(kind=ahead[k].kind, covariate=ahead[k].covariate, constant=found[k].constant,
                            constant_std=found[k].std, ln_odds=float(gain), names=ahead[k].names(found[k].constant)))
        so_far.take(ahead[k], found[k])
    return so_far.choose(shapes)


@dataclass(eq=False)
class _Columns:
    """Columns of the model so far, by covariate or by what was added: blocks (n_row, n_name) with names, nuisances,
    spread of the coefficients for constants that are not known; of a covariate what is `followed` (n_row,), and with
    which columns that bends; `taken`: ways of candidates that there is no second of."""

    blocks: dict[str, np.ndarray]
    names: dict[str, tuple[str, ...]]
    nuisances: dict[str, np.ndarray] = field(default_factory=dict)
    spread: dict[str, np.ndarray] = field(default_factory=dict)
    unknown: dict[str, float] = field(default_factory=dict)
    followed: dict[str, np.ndarray] = field(default_factory=dict)
    bends: dict[str, tuple[Callable[[np.ndarray], np.ndarray], tuple[str, ...]]] = field(default_factory=dict)
    taken: set[tuple[str, str]] = field(default_factory=set)

    def table(self, value: np.ndarray, without: str | None = None) -> np.ndarray:
        """(n_row, n) of all but one covariate."""
        rest = [block for key, block in self.blocks.items() if key != without]
        return np.hstack([np.zeros((len(value), 0)), *rest, *self.nuisances.values()])

    def take(self, candidate: _Candidate, found: _Weighed) -> None:
        u, name = found.constant, candidate.covariate
        columns, own = candidate.columns(u), candidate.names(u)
        key, n = f"{candidate.kind} {name} {u}" if candidate.adds else name, len(own)
        self.blocks[key], self.names[key] = columns[:, :n], own
        if candidate.nuisance:
            self.nuisances[key] = columns[:, n:]
        # what is not known of an earlier constant changes all coefficients alike
        size = found.coefficient[:n]
        self.spread[key] = found.scatter[:n, :n] + np.outer(size, size) * self.unknown.get(key, 0.0)
        self.unknown[key] = float(np.trace(self.spread[key]) / max(size @ size, 1e-300))
        if candidate.way[1] == FOLLOWED:
            self.followed[name] = candidate.follow(u)
        elif candidate.way[1] == BENT:
            self.bends[name] = lambda z: candidate.bend(z, u), own
        # a structure may step again
        self.taken |= {candidate.way} if candidate.kind != "step" else set()

    def choose(self, shapes: Sequence[Shape]) -> ChosenCovariates:
        return ChosenCovariates(
            names=tuple(n for own in self.names.values() for n in own),
            columns=tuple(c for block in self.blocks.values() for c in block.T),
            nuisances=tuple(c for block in self.nuisances.values() for c in block.T), shapes=tuple(shapes),
            spread=linalg.block_diag(np.zeros((0, 0)), *(
                self.spread.get(key, np.zeros((len(own), len(own)))) for key, own in self.names.items())),
            followed=dict(self.followed))


@dataclass(frozen=True, eq=False)
class _Weighed:
    """gain: ln evidence beyond the model without it; constant with its standard deviation; coefficient (n_column,) and
    scatter (n_column, n_column) of it by what is not known of the constant."""

    gain: float
    constant: float
    std: float
    coefficient: np.ndarray
    scatter: np.ndarray


def _weigh(candidate: _Candidate, value, noise, time_h, so_far: _Columns, best: float) -> _Weighed:
    """best: ln evidence of the model without it."""
    base, grid = so_far.table(value, None if candidate.adds else candidate.covariate), candidate.constants
    if candidate.nuisance:
        # what its nuisances explain alone is none of its own
        alone = [candidate.columns(u)[:, len(candidate.names(u)) :] for u in grid]
        best = max(best, _evidence(value, noise, time_h, so_far.table(value), alone)[0])
    whole, each, coefficient = _evidence(value, noise, time_h, base, [candidate.columns(u) for u in grid])
    if len(grid) == 1:
        return _Weighed(whole - best, float(grid[0]), np.nan, coefficient[0], np.zeros((8, 8)))
    share = 1.0
    for _ in range(3):
        # between the neighbours of the best, until the grid is finer than what is known of the constant
        top = int(np.argmax(each))
        low, high = max(top - 1, 0), min(top + 1, len(grid) - 1)
        share *= (high - low) / (len(grid) - 1)
        grid = np.linspace(grid[low], grid[high], N_FINE)
        fine, each, coefficient = _evidence(value, noise, time_h, base, [candidate.columns(u) for u in grid])
        weight = np.exp(each - each.max())
        whole = max(whole, fine + float(np.log(share)))
        if np.sum(weight > 0.1) >= 4:
            break
    weight /= weight.sum()
    mean, middle = float(weight @ grid), weight @ coefficient
    apart = coefficient - middle
    return _Weighed(whole - best, mean, float(np.sqrt(weight @ (grid - mean) ** 2)), middle,
                    (apart * weight[:, None]).T @ apart)


def _evidence(
    value, noise, time_h, base: np.ndarray, options: Sequence[np.ndarray]
) -> tuple[float, np.ndarray, np.ndarray]:
    """ln evidence averaged over options, of each (n_option,), and the options' coefficients (n_option, n_column) where
    each is likeliest; base (n_row, n_base), options [(n_row, n_column)]."""
    n, q = len(value), options[0].shape[1]
    fixed = np.column_stack([np.ones(n), base])
    fixed[:, 1:] = (fixed[:, 1:] - fixed[:, 1:].mean(axis=0)) / np.maximum(fixed[:, 1:].std(axis=0), 1e-300)
    every = np.hstack(options)
    size = np.maximum(every.std(axis=0), 1e-300) if q else np.ones(0)
    every = (every - every.mean(axis=0)) / size if q else every
    step, unit = np.diff(time_h), float(np.median(noise))
    hours = np.geomspace(step.min(), max(time_h[-1] - time_h[0], 4 * step.min()), N_HOURS)
    points = [(last, ratio) for last in hours for ratio in RATIOS if ratio > 0 or last == hours[0]]
    log = np.empty((len(points), len(options)))
    coefficient = np.empty((len(points), len(options), q))
    all_columns = np.column_stack([fixed, every, value - value.mean()])
    for p, (last, ratio) in enumerate(points):
        white, log_determinant = whiten_columns(all_columns, noise, unit * ratio, np.exp(-step / last))
        q_fixed = np.linalg.qr(white[:, : fixed.shape[1]])[0]
        left = white[:, fixed.shape[1]:] - q_fixed @ (q_fixed.T @ white[:, fixed.shape[1]:])
        y = left[:, -1]
        rss, found = _residuals(left[:, :-1], y, len(options))
        k = fixed.shape[1] + q
        log[p] = -0.5 * (n * np.log(np.maximum(rss, 1e-300) / n) + log_determinant + k * np.log(n))
        coefficient[p] = found / size.reshape(found.shape[0], -1) if q else found
    # without a slow error its length is nothing: that point counts as the others of one length
    each = np.logaddexp.reduce(log, axis=0) - np.log(len(points))
    at = np.argmax(log, axis=0)
    return (float(np.logaddexp.reduce(each) - np.log(len(each))), each, coefficient[at, np.arange(len(options))])


def _residuals(x: np.ndarray, y: np.ndarray, n_option: int) -> tuple[np.ndarray, np.ndarray]:
    """Sums of squares (n_option,) of what as many columns for each option leave of y, and their coefficients."""
    q = x.shape[1] // n_option
    if q == 1:
        power = np.sum(x**2, axis=0)
        found = np.where(power > 1e-16 * (y @ y), (y @ x) / np.maximum(power, 1e-300), 0.0)
        return y @ y - found**2 * power, found[:, None]
    found = np.zeros((n_option, q))
    rss = np.full(n_option, y @ y)
    for o in range(n_option if q else 0):
        own = x[:, o * q: (o + 1) * q]
        found[o] = np.linalg.lstsq(own, y, rcond=1e-8)[0]
        rss[o] = np.sum((y - own @ found[o]) ** 2)
    return rss, found


def _candidates(covariates: Mapping[str, np.ndarray], time_h: np.ndarray, so_far: _Columns) -> list[_Candidate]:
    found: list[_Candidate] = []
    n, span, step = len(time_h), time_h[-1] - time_h[0], float(np.median(np.diff(time_h)))
    least = max(LEAST_ROWS, int(LEAST_SHARE * n))
    if n <= 2 * least + 2:
        return found
    none = np.array([np.nan])
    for name, x in covariates.items():
        if name.startswith(("cos ", "sin ")):
            if name.startswith("cos "):
                found.append(_second_harmonic(name, x, covariates["sin " + name[4:]], none))
            continue
        z = so_far.followed.get(name, x)
        inner = np.sort(z)[least: -least]
        if inner[-1] > inner[0]:
            found += _hinges(name, z, np.linspace(inner[0], inner[-1], N_COARSE))
        found += _followers(name, x, time_h, so_far.bends.get(name, (lambda z: z[:, None], (name,))))
    for kind, hours in PERIODS_H.items():
        if span > 2 * hours and step < hours / 4:
            turn = 2 * np.pi * time_h / hours
            found.append(_Candidate(kind, "", none, lambda _, t=turn: np.column_stack([np.cos(t), np.sin(t)]),
                                    lambda _, k=kind: (f"cos of the {k}", f"sin of the {k}"), adds=True))
    found.append(_Candidate("drift", "", none, lambda _: time_h[:, None] / DAY_H, lambda _: ("days",), adds=True))
    # between each two blocks, as a few on the wrong side of it hide a step
    places = 0.5 * (time_h[least:-least] + time_h[least - 1 : -least - 1])
    places = places[np.unique(np.linspace(0, len(places) - 1, N_PLACES).astype(int))]
    found.append(_Candidate("step", "", places, lambda t: (time_h >= t).astype(float)[:, None],
                            lambda t: (f"step at {t:.4g} h",), adds=True))
    return found


def _followers(name: str, x: np.ndarray, time_h: np.ndarray, bends) -> list[_Candidate]:
    """x (n_row,) with hysteresis or behind, of either what it bends to, if it does: bends (function, names)."""
    bend, names = bends
    span, step = time_h[-1] - time_h[0], float(np.median(np.diff(time_h)))
    widths = np.linspace(0.05, 0.6, N_COARSE) * np.ptp(x)
    found = [_Candidate("hysteresis", name, widths, lambda r: bend(play(x, r)), lambda _: names,
                        follow=lambda r: play(x, r)),
             _Candidate("hysteresis", name, widths, lambda r: np.column_stack([bend(smooth_play(x, r)),
                                                                              x - smooth_play(x, r)]),
                        lambda r: (*names, f"{name} within {r:.3g}"), follow=lambda r: smooth_play(x, r))]
    if span > 8 * step:
        found.append(_Candidate(
            "lag", name, np.geomspace(step, span / 6, N_COARSE), lambda tau: np.column_stack([
                bend(lag_covariate(x, time_h, tau)), np.exp(-(time_h - time_h[0]) / tau)]), lambda _: names,
            follow=lambda tau: lag_covariate(x, time_h, tau), nuisance=1))
    return found


def _second_harmonic(name: str, cos: np.ndarray, sin: np.ndarray, none: np.ndarray) -> _Candidate:
    angle = name[4:]
    return _Candidate("harmonic", angle, none, lambda _: np.column_stack([cos**2 - sin**2, 2 * sin * cos]),
                      lambda _: (f"cos 2 {angle}", f"sin 2 {angle}"), adds=True)


def _hinges(name: str, x: np.ndarray, points: np.ndarray) -> list[_Candidate]:
    found = []
    for kind, words, bend in (
            ("bend", ("below", "above"), lambda z, c: np.column_stack([np.minimum(z - c, 0), np.maximum(z - c, 0)])),
            ("saturation", ("below",), lambda z, c: np.minimum(z, c)[:, None]),
            ("saturation", ("above",), lambda z, c: np.maximum(z, c)[:, None])):
        found.append(_Candidate(kind, name, points, lambda c, bend=bend: bend(x, c),
                                lambda c, words=words: tuple(f"{name} {word} {c:.3g}" for word in words), bend=bend))
    return found


def lag_covariate(x: np.ndarray, time_h: np.ndarray, tau_h: float) -> np.ndarray:
    """First-order low-pass dz/dt = (x - z) / tau of x (n_row,), linear between rows, from z = x at the first."""
    z = np.empty_like(x)
    z[0] = x[0]
    for k, dt in enumerate(np.diff(time_h)):
        decay, slope = np.exp(-dt / tau_h), (x[k + 1] - x[k]) / dt
        # exact for a straight line: it is followed tau behind
        z[k + 1] = x[k + 1] - slope * tau_h + (z[k] - x[k] + slope * tau_h) * decay
    return z


def play(x: np.ndarray, width: float) -> np.ndarray:
    """Play operator: follows x (n_row,) when it is pushed, half a width behind, and rests while x turns within."""
    z = np.empty_like(x)
    z[0] = x[0]
    for k in range(1, len(x)):
        z[k] = min(max(z[k - 1], x[k] - width / 2), x[k] + width / 2)
    return z


def smooth_play(x: np.ndarray, width: float) -> np.ndarray:
    """Mean of play operators of widths up to `width`: loops of rounded corners (Prandtl and Ishlinskii)."""
    return np.mean([play(x, part * width) for part in (0.2, 0.4, 0.6, 0.8, 1.0)], axis=0)


def find_lone_rows(value: np.ndarray, noise: np.ndarray, base: np.ndarray, limit: float, around: int = 3) -> np.ndarray:
    """(n_row,) bool: rows that lie off their neighbours in time by more than `limit` robust standard deviations, what
    base (n_row, n_column) explains by least absolute deviations taken away: what lasts is no outlier."""
    weight = np.ones(len(value))
    for _ in range(20):
        root = np.sqrt(weight) / noise
        rest = (value - base @ np.linalg.lstsq(base * root[:, None], value * root, rcond=None)[0]) / noise
        weight = 1 / np.maximum(np.abs(rest), 0.1 * max(float(np.median(np.abs(rest))), 1e-300))
    padded = np.pad(rest, around, mode="reflect")
    local = rest - np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * around + 1), axis=1)
    scale = 1.4826 * np.median(np.abs(local[local != 0])) if np.any(local != 0) else np.inf
    return np.abs(local) > limit * scale
