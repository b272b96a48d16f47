"""One search: every candidate scored at a fit, the largest score judged by bootstrap of the whole search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from probupdate.diagnosis.fitting import MODEL_ERROR_SCALE, Fit, driver_profiles
from probupdate.diagnosis.linear import Design
from probupdate.diagnosis.noise import estimate_noise
from probupdate.diagnosis.problem import DiagnosisProblem, IncludedEffect
from probupdate.diagnosis.time_profiles import TimeProfile

# false alarms of the whole first search, and of each one after a finding. With the test of the rest, and what a
# noise that was itself estimated leaves, a diagnosis stays below 5 %
FALSE_ALARM, FALSE_NEXT = 0.02, 0.01
N_BOOTSTRAP = 400
# largest threshold of |z| that a catalogue can need (of ten million independent candidates it is 5.9)
SENSIBLE = 12.0
# ln posterior by which a move may promise less than the best hypothesis known, and a hypothesis be less probable than
# it, to be looked at: odds of one to 150
MARGIN = 5.0
# directions among which the error of a signature is shared out
DIRECTIONS = 4
# share of a candidate's information from which its signature along another time profile is an unknown
LEAST = 1e-9
# records whose noise is estimated again; of fewer blocks than these, where it is not known how shapes mix, N_BOOTSTRAP,
# as one in a hundred of their largest scores is twice as large as usual
N_AGAIN, SHORT = 30, 30
# share of the largest maxima by which a heavy tail is known
TAIL = 0.1
# drawn records that are looked through at once; effects whose overlaps are
AT_ONCE, EFFECTS_AT_ONCE = 50, 10
# a size that may only be one value is meant where the linear estimate lies within these multiples of it
MEANT = (0.1, 5.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class Search:
    """Scores of all candidates, `which` (n_candidate, 2) effect and time profile, at a fit: z signed, the size that
    fits best and its standard deviation; `allowed` bool where that size lies on a side the effect can be on; threshold
    and p of the largest |z| by bootstrap, whose maxima were taken `heavier` times as large because the noise itself was
    estimated; u of the record (n_candidate,)."""

    which: np.ndarray
    z: np.ndarray
    size: np.ndarray
    size_std: np.ndarray
    allowed: np.ndarray
    usable: np.ndarray
    threshold: float
    p_value: float
    maxima: np.ndarray
    heavier: float
    u: np.ndarray

    @property
    def statistic(self) -> np.ndarray:
        """|z| where the candidate can be what it says, else 0."""
        return np.where(self.allowed & self.usable, np.abs(self.z), 0.0)

    @property
    def scores_impossible(self) -> bool:
        """Whether scores that are standard normal by construction need a threshold that no such numbers reach: the
        linear equations do not hold as far as what is not known of the model moves these modes."""
        # infinite where nothing is left to be scored, as beside findings of few sets
        return bool(SENSIBLE < self.threshold < np.inf)


def search(
    problem: DiagnosisProblem, fitted: Fit, *, seed: int, z_included: Sequence[float] = (),
    heavier: float | None = None,
) -> Search:
    """Score every candidate at the fit and calibrate the largest. `z_included`: scores of the fit's effects; `heavier`:
    that of an earlier search of the same record, found again if None."""
    design = fitted.design
    u, v = design.scores(fitted.centred), design.information
    found = [j for j, e in enumerate(problem.effects) if any(n.effect is e for n in fitted.included)]
    usable = (design.share_left > 1e-3) & ~np.isin(problem.which[:, 0], found)
    std = np.where(usable, 1 / np.sqrt(np.where(usable, v, 1.0)), np.inf)
    scale = np.where(usable, std, 0.0)
    can = _possible(problem, scale)
    maxima = _largest(drawn_scores(design, seed), scale, can)
    heavy = False
    if heavier is None:
        again = maxima_with_own_noise(problem, design, can, usable, seed=seed) if np.any(maxima) else maxima
        heavier = max(1.0, float(np.mean(again) / np.mean(maxima))) if len(again) and np.any(maxima) else 1.0
        heavy = len(again) == N_BOOTSTRAP and heavier > 1
        maxima = again if heavy else maxima * heavier
    else:
        maxima = maxima * heavier
    # the threshold is that of noise; what stands out beside a strong effect must exceed that one's model error too
    beside, known = conditional_scores(problem, design, fitted.centred, fitted.included, z_included)
    std = np.where(usable, 1 / np.sqrt(np.where(usable, known, 1.0)), np.inf)
    scale = np.where(usable, std, 0.0)
    z = beside * scale
    allowed = _possible(problem, scale)(z)
    largest = float(np.max(np.where(allowed, np.abs(z), 0.0)))
    alarms = FALSE_NEXT if fitted.included else FALSE_ALARM
    return Search(which=problem.which, z=z, size=np.where(usable, z * scale, 0.0), size_std=std, allowed=allowed,
                  usable=usable, threshold=value_exceeded_by(maxima, alarms, heavy=heavy),
                  p_value=tail(maxima, largest, heavy=heavy),
                  maxima=maxima, heavier=heavier, u=u)


def drawn_scores(design: Design, seed: int) -> np.ndarray:
    """u (N_BOOTSTRAP, n_candidate) of the records with nothing wrong that a search of this seed, and what it leaves, is
    judged by; kept with the design, as both ask for them."""
    return design.keep_draws(seed, N_BOOTSTRAP)


def _largest(drawn: np.ndarray, scale: np.ndarray, can) -> np.ndarray:
    """(n_draw,) the largest |z| that can be of each drawn record, some records at a time."""
    result = []
    for first in range(0, len(drawn), AT_ONCE):
        z = drawn[first : first + AT_ONCE] * scale
        result.append(np.max(np.where(can(z), np.abs(z), 0.0), axis=1))
    return np.concatenate(result)


def _possible(problem: DiagnosisProblem, scale: np.ndarray):
    """z (..., n_candidate) -> bool: whether the size that fits best, z times `scale`, is one the effect can have."""
    effects = [problem.effects[j] for j, _ in problem.which]
    lower, upper = np.array([e.lower for e in effects]), np.array([e.upper for e in effects])
    # what begins in the record begins from neutral; a covariate's sense is not known beforehand
    both = np.array([problem.time_profiles[c].kind == "covariate" for _, c in problem.which])
    only = np.array([e.discrete[0] if e.discrete else np.nan for e in effects])
    single = np.isfinite(only)

    def can(z: np.ndarray) -> np.ndarray:
        sided = np.where(z > 0, both | (upper > 0), both | (lower < 0))
        share = z * scale / np.where(single, only, 1.0)
        return (scale > 0) & np.where(single, (share > MEANT[0]) & (share < MEANT[1]), sided)

    return can


def maxima_with_own_noise(problem: DiagnosisProblem, design: Design, can, usable, *, seed: int) -> np.ndarray:
    """(n,) the largest |z| of records with nothing wrong whose noise is estimated from each, as it was here; none where
    the identification states the noise's pattern and only its scale was estimated."""
    if all(c is not None for c in problem.stated):
        return np.zeros(0)
    rng = np.random.default_rng([seed, 23])
    sizes = tuple(len(g) for g in problem.blocks.groups)
    weights = np.column_stack(design.noise.weight)
    relative = 1 / np.sqrt(np.maximum(weights, 1e-12))
    maxima = []
    for _ in range(N_BOOTSTRAP if len(weights) < SHORT and problem.mixing is None else N_AGAIN):
        y = design.simulate(rng)
        left = tuple(a - b for a, b in zip(y, design.expected_residuals(design.unknowns(y)), strict=True))
        noise = estimate_noise(left, tuple(weights.T > 0), sizes, relative, np.full(len(weights), ""),
                               mixing=problem.mixing)
        again = replace(design, noise=noise)
        z = np.where(usable, again.scores(y) / np.sqrt(np.maximum(again.information, 1e-300)), 0.0)
        maxima.append(np.max(np.where(can(z), np.abs(z), 0.0)))
    return np.array(maxima)


def tail(maxima: np.ndarray, value: float, *, heavy: bool = False) -> float:
    """P(max >= value): the share of draws, or where few of them are as large a Gumbel distribution of all, and of
    `heavy` tails, as noise has that was estimated from a few blocks, a power of the value (Hill 1975)."""
    above = int(np.sum(maxima >= value))
    if above >= 10:
        return (above + 1) / (len(maxima) + 1)
    if heavy:
        begin, power = _power_tail(maxima)
        beyond = TAIL * (value / begin) ** -power
    else:
        beyond = stats.gumbel_r.sf(value, *stats.gumbel_r.fit(maxima))
    return float(min(beyond, 11 / (len(maxima) + 1)))


def value_exceeded_by(maxima: np.ndarray, share: float, *, heavy: bool = False) -> float:
    """The value above which `tail` is less than `share`; infinite where draws are all zero: nothing can be scored."""
    if not np.any(maxima):
        return np.inf
    if share * (len(maxima) + 1) > 11:
        return float(np.quantile(maxima, 1 - share))
    if heavy:
        begin, power = _power_tail(maxima)
        beyond = begin * (TAIL / share) ** (1 / power)
    else:
        beyond = stats.gumbel_r.isf(share, *stats.gumbel_r.fit(maxima))
    return float(max(beyond, np.sort(maxima)[-10]))


def _power_tail(maxima: np.ndarray) -> tuple[float, float]:
    """Where the tail begins, and the power by which it falls."""
    begin = float(np.quantile(maxima, 1 - TAIL))
    return begin, 1 / max(float(np.mean(np.log(maxima[maxima >= begin] / begin))), 1e-9)


def least_by_chance(p: float) -> float:
    """The least odds of chance against any causes, alike before, where they leave p: -e p ln p (Sellke, Bayarri &
    Berger 2001)."""
    return float(-np.e * p * np.log(p)) if 0 < p < 1 / np.e else float(p > 0)


def model_error_dispersion(z: float, scale: float = MODEL_ERROR_SCALE) -> float:
    """What log evidence between competing hypotheses is divided by: the error of a signature of z standard deviations,
    `scale` as a share of it, lies along a few directions, and between two hypotheses is one of them."""
    return 1 + (scale * z) ** 2 / DIRECTIONS


def conditional_scores(
    problem: DiagnosisProblem, design: Design, centred: Sequence[np.ndarray], included: Sequence[IncludedEffect],
    z_included: Sequence[float],
) -> tuple[np.ndarray, np.ndarray]:
    """Scores u and information v (n_candidate,) beside effects of the structure or its environment that are included:
    their signatures' error, a share of what they do, follows their own time profile and lies along a few directions, of
    which the candidate's may be one. So each candidate's own signature along that profile is one more unknown, of the
    variance that makes v so much less there as `model_error_dispersion` says; what the candidate does at other times
    counts in full. What drives an effect along a column is not that column alone, and the error follows it
    (`driver_profiles`). What a sensor does to shapes is exact, what is constant has the model's discrepancy anyway."""
    uncertain = [(profile, 1 - 1 / model_error_dispersion(z * _length(profile) / _length(n.time_profile)))
                 for n, z in zip(included, z_included, strict=False)
                 if n.effect.kind != "measurement" and n.time_profile.kind != "constant"
                 for profile in (n.time_profile, *driver_profiles(problem, n))]
    u, v = design.scores(centred), design.information
    if not uncertain:
        return u, v
    n, m, n_effect = len(design.which), len(uncertain), len(problem.effects)
    along = np.column_stack([np.repeat(np.arange(n_effect), m),
                             np.tile(len(design.time_profiles) + np.arange(m), n_effect)])
    profiles = (*design.time_profiles, *(time_profile for time_profile, _ in uncertain))
    there = design.with_candidates(profiles, along).scores(centred).reshape(n_effect, m)
    wide = design.with_candidates(profiles, np.vstack([design.which, along]))
    share = np.array([part for _, part in uncertain])
    u, v, searched = u.copy(), v.copy(), np.unique(design.which[:, 0])
    for first in range(0, len(searched), EFFECTS_AT_ONCE):
        effects = searched[first : first + EFFECTS_AT_ONCE]
        rows = np.flatnonzero(np.isin(design.which[:, 0], effects))
        others = n + (effects[:, None] * m + np.arange(m)).ravel()
        overlap = wide.overlap(np.concatenate([others, rows]), others)
        for k, j in enumerate(effects):
            here, same = slice(k * m, (k + 1) * m), design.which[rows, 0] == j
            own, crossed, numbers = overlap[here, here], overlap[len(others):][same, here], rows[same]
            kept = np.diag(own) > LEAST * v[numbers].max(initial=0.0)
            if not kept.any():
                continue
            own, crossed = own[np.ix_(kept, kept)], crossed[:, kept]
            # v / (1 + v variance) = v / dispersion
            own[np.diag_indices_from(own)] /= share[kept]
            taken = np.linalg.solve(own, np.column_stack([there[j][kept], crossed.T]))
            u[numbers] -= crossed @ taken[:, 0]
            v[numbers] -= np.sum(crossed * taken[:, 1:].T, axis=1)
    return u, np.maximum(v, 0.0)


def _length(profile: TimeProfile) -> float:
    return float(np.linalg.norm(profile.value))


def gains(problem: DiagnosisProblem, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of every candidate beside a linear model with scores u and information v (n_candidate,): ln Bayes factor, size
    that explains most on a side that it can be on. The prior of a size is the Cauchy density of `IncludedEffect`."""
    empty = [IncludedEffect(effect=problem.effects[j], time_profile=problem.time_profiles[c], size=0.0)
             for j, c in problem.which]
    only = np.array([n.effect.discrete[0] if n.effect.discrete else np.nan for n in empty])
    prior_scale, (lower, upper) = np.array([n.prior_scale for n in empty]), np.array([n.bounds for n in empty]).T
    # an effect that is not linear explains more at its bound than its slope promises there: its side alone counts
    lower, upper = np.where(lower < 0, -np.inf, 0.0), np.where(upper > 0, np.inf, 0.0)
    usable = v > 0
    known = np.where(usable, v, 1.0)
    free = np.clip(np.where(usable, u / known, 0.0), lower, upper)
    variance = 0.5 * (prior_scale**2 + free**2)
    size = np.clip(u / (known + 1 / variance), lower, upper)
    # the normal density that stands for the prior, and what the prior has over it
    explained = size * u - 0.5 * size**2 * (known + 1 / variance)
    prior = (-np.log(np.pi * prior_scale) - np.log1p((size / prior_scale) ** 2)
             + 0.5 * np.log(2 * np.pi * variance) + 0.5 * size**2 / variance)
    one_sided = np.log(2.0) * ((lower == 0) | (upper == 0))
    gain = explained - 0.5 * np.log1p(known * variance) + prior + one_sided
    single = np.isfinite(only)
    gain = np.where(single, u * only - 0.5 * v * only**2, gain)
    return np.where(usable, gain, -np.inf), np.where(single, only, size)
