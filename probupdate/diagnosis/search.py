"""One search: every candidate scored at a fit, the largest score judged by bootstrap of the whole search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from probupdate.diagnosis.fitting import Fit
from probupdate.diagnosis.linear import Design
from probupdate.diagnosis.noise import estimate_noise
from probupdate.diagnosis.setting import Named, Setting

# false alarms of the whole first search, and of each one after a finding. With the test of the remainder, and what a
# noise that was itself estimated leaves, a diagnosis stays below 5 %
FALSE_ALARM, FALSE_NEXT = 0.02, 0.01
N_BOOTSTRAP = 400
# records whose noise is estimated anew
N_AGAIN = 30
# a size that may only be one value is meant where the linear estimate lies within these multiples of it
MEANT = (0.1, 5.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class Search:
    """Scores of all candidates, `which` (n_candidate, 2) effect and course, at a fit: z signed, the size that fits best
    and its deviation; `allowed` bool where that size lies on a side the effect can be on; threshold and p of the
    largest |z| by bootstrap, whose maxima were taken `heavier` times as large because the noise itself was estimated;
    u of the record and of the drawn ones (n_draw, n_candidate)."""

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
    drawn: np.ndarray

    @property
    def statistic(self) -> np.ndarray:
        """|z| where the candidate can be what it says, else 0."""
        return np.where(self.allowed & self.usable, np.abs(self.z), 0.0)


def search(
    setting: Setting, fitted: Fit, *, seed: int, heavier: float | None = None, n_draw: int = N_BOOTSTRAP
) -> Search:
    """Score every candidate at the fit and calibrate the largest. `heavier`: that of an earlier search of the same
    record, found anew if None."""
    design = fitted.design
    u, v = design.scores(fitted.centred), design.information
    usable = (design.share_left > 1e-3) & ~taken(setting, fitted.named)
    std = np.where(usable, 1 / np.sqrt(np.where(usable, v, 1.0)), np.inf)
    scale = np.where(usable, std, 0.0)
    z = u * scale
    can = _possible(setting, scale)
    rng = np.random.default_rng([seed, 21])
    drawn = design.draw(rng, n_draw)
    maxima = np.max(np.where(can(drawn * scale), np.abs(drawn * scale), 0.0), axis=1)
    if heavier is None:
        heavier = estimated_noise_factor(setting, design, float(np.mean(maxima)), can, usable, seed=seed)
    maxima = maxima * heavier
    largest = float(np.max(np.where(can(z), np.abs(z), 0.0)))
    alarms = FALSE_NEXT if fitted.named else FALSE_ALARM
    return Search(which=setting.which, z=z, size=np.where(usable, u / np.where(usable, v, 1.0), 0.0), size_std=std,
                  allowed=can(z), usable=usable, threshold=exceeded(maxima, alarms), p_value=tail(maxima, largest),
                  maxima=maxima, heavier=heavier, u=u, drawn=drawn)  # fmt: skip


def taken(setting: Setting, named: Sequence[Named]) -> np.ndarray:
    """(n_candidate,) bool: effects that were found already, whatever their course."""
    found = [j for j, e in enumerate(setting.effects) if any(n.effect is e for n in named)]
    return np.isin(setting.which[:, 0], found)


def _possible(setting: Setting, scale: np.ndarray):
    """z (..., n_candidate) -> bool: whether the size that fits best, z times `scale`, is one the effect can have."""
    effects = [setting.effects[j] for j, _ in setting.which]
    lower, upper = np.array([e.lower for e in effects]), np.array([e.upper for e in effects])
    # what begins in the record begins from neutral; a covariate's sense is not known beforehand
    both = np.array([setting.courses[c].kind == "covariate" for _, c in setting.which])
    only = np.array([e.discrete[0] if e.discrete else np.nan for e in effects])
    single = np.isfinite(only)

    def can(z: np.ndarray) -> np.ndarray:
        sided = np.where(z > 0, both | (upper > 0), both | (lower < 0))
        share = z * scale / np.where(single, only, 1.0)
        return (scale > 0) & np.where(single, (share > MEANT[0]) & (share < MEANT[1]), sided)

    return can


def estimated_noise_factor(setting: Setting, design: Design, typical: float, can, usable, *, seed: int) -> float:
    """How much larger the largest |z| of a record with nothing wrong is when its noise is estimated from that record,
    as it was here; 1 where the identification states the noise's pattern and only its scale was estimated."""
    if all(c is not None for c in setting.stated):
        return 1.0
    rng = np.random.default_rng([seed, 23])
    sizes = tuple(len(g) for g in setting.blocks.groups)
    weights = np.column_stack(design.noise.weight)
    relative = 1 / np.sqrt(np.maximum(weights, 1e-12))
    maxima = []
    for _ in range(N_AGAIN):
        y = design.simulate(rng)
        left = tuple(a - b for a, b in zip(y, design.expected(design.unknowns(y)), strict=True))
        noise = estimate_noise(left, tuple(weights.T > 0), sizes, relative, np.full(len(weights), ""))
        again = replace(design, noise=noise)
        z = np.where(usable, again.scores(y) / np.sqrt(np.maximum(again.information, 1e-300)), 0.0)
        maxima.append(np.max(np.where(can(z), np.abs(z), 0.0)))
    return max(1.0, float(np.mean(maxima)) / typical)


def tail(maxima: np.ndarray, value: float) -> float:
    """P(max >= value): the share of draws, or where few of them are as large a Gumbel distribution of all."""
    above = int(np.sum(maxima >= value))
    if above >= 10:
        return (above + 1) / (len(maxima) + 1)
    location, scale = stats.gumbel_r.fit(maxima)
    return float(min(stats.gumbel_r.sf(value, location, scale), 11 / (len(maxima) + 1)))


def exceeded(maxima: np.ndarray, share: float) -> float:
    """The value above which `tail` is less than `share`."""
    if share * (len(maxima) + 1) > 11:
        return float(np.quantile(maxima, 1 - share))
    location, scale = stats.gumbel_r.fit(maxima)
    return float(max(stats.gumbel_r.isf(share, location, scale), np.sort(maxima)[-10]))


def chance(p_value: float) -> float:
    """Least probability that a search found nothing but chance, with even odds before: the bound -e p ln p on the Bayes
    factor (Sellke, Bayarri & Berger 2001)."""
    if p_value <= 0:
        return 0.0
    bound = -np.e * p_value * np.log(p_value) if p_value < 1 / np.e else 1.0
    return float(bound / (1 + bound))
