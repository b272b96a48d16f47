"""Sets that do not belong to the others' population: one mode's frequency or shape far from what the other sets say.

ln f of a mode over the sets is a normal about their mean, with what each set states of itself and a scatter that the
others show; each set is judged by the others alone, so that it does not widen what it is held against. An outlier has
one mode drawn from a Cauchy distribution of scale WIDE, whose tail is wider than any Student t of the others' so that
what is farther off is never less an outlier, or its shape (`outlier_shapes`), whichever: a mixture with a stated share
of outliers (Box & Tiao 1968).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from probupdate.modal.modes import ModalData, ModalSet
from probupdate.modal.rounding import rounding_std
from probupdate.runtime.arrays import frozen_array
from probupdate.updating.outlier_shapes import ShapeTable
from probupdate.updating.settings import CONSTANTS

SHARE, WIDE, SURE = CONSTANTS.outlier_share, CONSTANTS.outlier_wide, CONSTANTS.outlier_sure
# fewer sets show no outlier among them; passes in which outliers stop counting among the others
FEWEST, PASSES = 3, 4
# of ln f, where nothing is stated and all sets agree to the last digit
LEAST = 1e-6
# so many sets that are off alike are said one by one
MOST_SINGLE = 2
# sets on each side of a step; its size over the scatter within both: of a straight drift cut in halves that is
# 2 sqrt(3) = 3.5, of a sine cut where it crosses its mean 4.1
FEWEST_SIDE, STEP = 3, 6.0


@dataclass(frozen=True, eq=False, kw_only=True)
class OutlierSets:
    """probability (n_set,) of each set to be an outlier; mode (n_set,) the number of the mode that is the most likely
    reason, and by how much its ln f is off, `off` (n_set,); mac (n_set,) with what the others say where its shape is
    the reason, else NaN."""

    ids: tuple[str, ...]
    labels: tuple[str, ...]
    probability: np.ndarray
    mode: np.ndarray
    off: np.ndarray
    mac: np.ndarray

    @property
    def numbers(self) -> tuple[int, ...]:
        """Sets that are outliers with a probability of SURE or more."""
        return tuple(int(k) for k in np.flatnonzero(self.probability >= SURE))

    @property
    def sentences(self) -> list[str]:
        alike: dict[tuple[int, float], list[int]] = {}
        for k in self.numbers:
            direction = float(np.sign(self.off[k])) if np.isnan(self.mac[k]) else 0.0
            alike.setdefault((int(self.mode[k]), direction), []).append(k)
        named = [sentence for own in alike.values() for sentence in self._sentences(own)]
        return named + [self._suspicion(int(k)) for k in self._suspects]

    @property
    def _suspects(self) -> np.ndarray:
        """Sets that stay in the population, though the data make them more probably outliers than any set is."""
        return np.flatnonzero((self.probability > SHARE) & (self.probability < SURE))

    def _difference(self, own: Sequence[int]) -> str:
        """In what sets that are off in one mode and one direction are unlike the others."""
        label, some = self.labels[self.mode[own[0]]], list(own)
        if np.isfinite(self.mac[own[0]]):
            return f"shape of {label} is unlike the other sets' (MAC {self.mac[some].min():.3f})"
        size, how = 100 * np.mean(np.abs(np.expm1(self.off[some]))), "above" if self.off[own[0]] > 0 else "below"
        return f"frequency of {label} is {size:.2g} % {how} the other sets'"

    def _suspicion(self, k: int) -> str:
        return (f"set {self.ids[k]} may be an outlier, with probability {self.probability[k]:.2f}: its "
                f"{self._difference([k])}; {len(self.ids)} sets do not decide, so it is used: inspect it, and leave it "
                "out of the modes if it is wrong")

    def _sentences(self, own: Sequence[int]) -> list[str]:
        """Of sets that are off in one mode and one direction: each by itself, or of many what is common to them."""
        rest = "the population is estimated from the others"
        if len(own) <= MOST_SINGLE:
            return [f"set {self.ids[k]} is an outlier with probability {self.probability[k]:.3f}: its "
                    f"{self._difference([k])}; {rest}" for k in own]
        return [f"{len(own)} of {len(self.ids)} sets, {self.ids[own[0]]} to {self.ids[own[-1]]}, are outliers with "
                f"probability {self.probability[own].min():.3f} and more: their {self._difference(own)}; {rest}. So "
                "many that differ alike indicate a change: `diagnose` identifies what changed, and when"]


def outlier_sets(data: ModalData) -> OutlierSets:
    """Of the sets of one structure, by their frequencies and shapes."""
    labels = data.labels or tuple(f"mode {j + 1}" for j in range(data.n_mode))
    frequency = np.array([s.frequency_hz for s in data.sets], float)
    stated = np.nan_to_num(np.array([s.frequency_std_hz for s in data.sets], float))
    # of rounded frequencies the others' scatter is the grid's, or none at all; one mode's values may show no grid
    stated = np.hypot(stated, rounding_std(frequency))
    with np.errstate(invalid="ignore", divide="ignore"):
        ln, stated = np.log(frequency), np.nan_to_num(stated / frequency)
    stated, shapes = np.maximum(stated, LEAST), ShapeTable.from_sets(data, ln)
    n_set, n_mode = ln.shape
    # of the frequency and of the shape of each mode
    ratio, off, mac = np.full((2, n_set, n_mode), -np.inf), np.zeros((n_set, n_mode)), np.ones((n_set, n_mode))
    probability = np.zeros(n_set)
    counts = is_near_median(ln, stated) & shapes.median_sets()
    for _ in range(PASSES if n_set >= FEWEST else 0):
        for s, j in np.ndindex(n_set, n_mode):
            others = (np.arange(n_set) != s) & counts
            same, seen = others & np.isfinite(ln[:, j]), others & shapes.measured(j)
            if np.isfinite(ln[s, j]) and same.sum() >= FEWEST - 1:
                ratio[0, s, j], off[s, j] = _log_ratio(ln[s, j], stated[s, j], ln[same, j], stated[same, j])
            if shapes.measured(j)[s] and seen.sum() >= FEWEST - 1:
                ratio[1, s, j], mac[s, j] = shapes.log_ratio(s, j, seen)
        each = np.concatenate(ratio, axis=1)
        odds = special.logsumexp(each, axis=1) - np.log(np.maximum(np.isfinite(each).sum(axis=1), 1))
        probability = special.expit(odds + np.log(SHARE / (1 - SHARE)))
        if np.array_equal(counts, probability < 0.5):
            break
        counts = probability < 0.5
    row = np.arange(n_set)
    kind, mode = np.divmod(np.argmax(np.concatenate(ratio, axis=1), axis=1), n_mode)
    return OutlierSets(ids=tuple(s.id for s in data.sets), labels=labels, probability=frozen_array(probability),
                       mode=mode, off=frozen_array(off[row, mode]),
                       mac=frozen_array(np.where(kind == 1, mac[row, mode], np.nan)))


def is_near_median(value: np.ndarray, stated: np.ndarray, times: float = 5.0) -> np.ndarray:
    """Rows (n_set,) of value (n_set, n) to begin with: none far from the median by the median absolute deviation, which
    is no less than what is stated."""
    # a mode of interest that no set shows says nothing
    shown = np.isfinite(value).any(axis=0)
    value, stated = value[:, shown], stated[:, shown]
    middle = np.nanmedian(value, axis=0)
    scale = np.maximum(1.4826 * np.nanmedian(np.abs(value - middle), axis=0), np.median(stated, axis=0))
    return ~np.any(np.abs(value - middle) > times * scale, axis=1)


def _log_ratio(value: float, own: float, others: np.ndarray, stated: np.ndarray) -> tuple[float, float]:
    """ln of the density as an outlier over that as one of the others, and how far it is off their mean. Their scatter
    beyond what is stated is known to their number: a Student t."""
    n = len(others)
    excess = max(float(np.var(others, ddof=1)) - float(np.mean(stated**2)), 0.0)
    variance = stated**2 + excess
    weight = 1 / variance
    mean = float(weight @ others / weight.sum())
    scale = np.sqrt(own**2 + excess + 1 / weight.sum())
    # SciPy's densities check their arguments for ten times as long
    regular = (special.gammaln(0.5 * n) - special.gammaln(0.5 * (n - 1)) - 0.5 * np.log((n - 1) * np.pi)
               - 0.5 * n * np.log1p(((value - mean) / scale) ** 2 / (n - 1)) - np.log(scale))
    wider = np.hypot(scale, WIDE)
    wide = -np.log(np.pi * wider) - np.log1p(((value - mean) / wider) ** 2)
    return float(wide - regular), float(value - mean)


def without_outliers(data: ModalData) -> tuple[ModalData, list[str]]:
    """The sets that are of one population, and a sentence for each that is not or may not be."""
    found = outlier_sets(data)
    if not found.numbers:
        return data, found.sentences
    kept = tuple(s for k, s in enumerate(data.sets) if k not in found.numbers)
    reference = data.reference_set if any(s.id == data.reference_set for s in kept) else None
    return replace(data, sets=kept, reference_set=reference), found.sentences


def step_between_sets(data: ModalData, used: Collection[str] | None = None) -> str:
    """A sentence where frequencies (of the modes `used`, None: of all) stand at one level up to a set and at another
    from it on: their mean describes neither state; empty where they do not. The sets are in the order of the data,
    which is that of time."""
    first, sizes = first_after_step(data, used)
    ids = [s.id for s in data.sets]
    return first and (f"frequencies step between sets {ids[ids.index(first) - 1]} and {first} ({sizes}): the structure "
                      "changed between them, and parameters from the mean of all sets describe neither state")


def first_after_step(data: ModalData, used: Collection[str] | None = None) -> tuple[str, str]:
    """The first set after the clearest step of a frequency, and by how much each that steps does, in words; both empty
    where none does."""
    labels = data.labels or tuple(f"mode {j + 1}" for j in range(data.n_mode))
    frequency = np.array([s.frequency_hz for s in data.sets], float)
    stated = np.array([_own_std_hz(s, labels) for s in data.sets]) / frequency
    changed = {}
    for j, label in enumerate(labels):
        there = np.flatnonzero(np.isfinite(frequency[:, j]))
        if len(there) < 2 * FEWEST_SIDE or (used is not None and label not in used):
            continue
        size, scatter = _steps(np.log(frequency[there, j]), np.nanmedian([LEAST, *stated[there, j]]))
        at = int(np.argmax(np.abs(size) / scatter))
        if abs(size[at]) >= STEP * scatter[at]:
            changed[label] = (size[at], scatter[at], data.sets[there[at + FEWEST_SIDE]].id)
    if not changed:
        return "", ""
    clearest = max(changed, key=lambda label: abs(changed[label][0]) / changed[label][1])
    return changed[clearest][2], ", ".join(
        f"{label} by {100 * np.expm1(size):+.2g} %" for label, (size, _, _) in changed.items())


def _own_std_hz(modal_set: ModalSet, labels: Sequence[str]) -> list[float]:
    """Of the identification, where `select` kept it beside the scatter over the campaign, which a step is a part of."""
    kept = [modal_set.environment.get(f"own_std_hz_{label}") for label in labels]
    return [float(own) if isinstance(own, int | float) else float(std)
            for own, std in zip(kept, modal_set.frequency_std_hz, strict=True)]


def _steps(value: np.ndarray, least: float) -> tuple[np.ndarray, np.ndarray]:
    """For each number of values before a step, FEWEST_SIDE at least on both sides: what the mean of those after is more
    than that of those before, and the scatter within both."""
    n, value = len(value), value - value.mean()
    before = np.arange(FEWEST_SIDE, n - FEWEST_SIDE + 1)
    total, after = np.cumsum(value)[before - 1], n - before
    # about a mean of nothing those after have the other's sum, of the other sign
    within = np.sum(value**2) - total**2 / before - total**2 / after
    return -total / after - total / before, np.maximum(np.sqrt(np.maximum(within, 0.0) / (n - 2)), least)
