"""What all comparable sets say together, as one set: means of their frequencies and shapes, with their scatter.

Where responses follow from the same parameters in every set, the mean with the variance of the mean holds all that the
sets say of them; what the model gets wrong is the same in all and is stated beside it, not divided by their number.
Sets are comparable where all that is stated in words of their conditions is the same (the turbine's state) and the
nacelle looks the same way. Weights are inverse variances, each set's own with what all scatter beyond it (DerSimonian &
Laird 1986); shapes are brought to the first set's scale and phase, a close pair to its plane.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from probupdate.modal.matching import close_clusters
from probupdate.modal.modes import CovarianceFactors, ModalData, ModalSet, rotate_to_real
from probupdate.modal.rounding import rounding_std
from probupdate.updating.settings import CONSTANTS

ANGLE = "nacelle_angle_deg"
# how far a nacelle may look from where it does in the others, and sets from whose scatter alone a standard deviation
# of their mean is taken
SAME_ANGLE_DEG, FEWEST = CONSTANTS.same_angle_deg, 8
# p-value of Cochran's Q below which scatter beyond what is stated is said
UNLIKELY = 0.01


@dataclass(frozen=True, eq=False, kw_only=True)
class JointSet:
    """The one set that stands for `ids`, as the data that an estimator is given; `notes`: sentences on what it is of,
    which sets are not in it and why, and how the others scatter."""

    data: ModalData
    ids: tuple[str, ...]
    notes: tuple[str, ...]


def single_set(data: ModalData, set_id: str) -> JointSet:
    """One set alone."""
    alone = replace(data, sets=(data.set(set_id),), reference_set=None)
    n_set = len(data.sets)
    said = (f"results of set {set_id} alone, one of {n_set}; without --set: of all comparable sets",)
    return JointSet(data=alone, ids=(set_id,), notes=said if n_set > 1 else ())


def joint_set(data: ModalData, *, covariance: bool = False) -> JointSet:
    """All comparable sets of the data; the only set as it is. covariance: the mean's joint covariance factors too."""
    from probupdate.updating.outlier_sets import without_outliers

    if len(data.sets) == 1:
        return JointSet(data=data, ids=(data.sets[0].id,), notes=())
    alike, others = _comparable_sets(data)
    kept, outliers = without_outliers(alike)
    ids = tuple(s.id for s in kept.sets)
    if len(ids) == 1:
        only = single_set(data, ids[0])
        return replace(only, notes=(f"no other set is comparable with set {ids[0]}", *others, *outliers))
    together, scatter = _mean_set(kept, f"{len(ids)} of {len(data.sets)} sets", covariance)
    first = (f"results of {len(ids)} of {len(data.sets)} sets together (means with their scatter); --set takes one "
             "alone")
    joint = replace(kept, sets=(together,), reference_set=None)
    return JointSet(data=joint, ids=ids, notes=(first, *others, *outliers, *scatter))


def states_words(data: ModalData, ids: Sequence[str]) -> str:
    """Where frequencies of modes that have a name step between comparable sets, and which state those of `ids` are of;
    empty where none does."""
    from probupdate.updating.outlier_sets import first_after_step

    named = [label for label in data.labels or () if not label.isdigit()]
    first, sizes = first_after_step(_comparable_sets(data)[0], named or None)
    if not first:
        return ""
    every = [s.id for s in data.sets]
    later = sum(every.index(one) >= every.index(first) for one in ids)
    whose = {0: "before it: an update of them is of the state before",
             len(ids): "after it: an update of them is of the state after"}.get(
                 later, f"of both states, {len(ids) - later} before it and {later} after: their mean describes neither")
    return f"frequencies step at set {first} ({sizes}), and the sets kept are {whose}"


def _comparable_sets(data: ModalData) -> tuple[ModalData, list[str]]:
    """The sets in the conditions of the reference set, or of most sets, and why others are not among them."""
    words = [tuple(sorted((k, v) for k, v in s.environment.items() if isinstance(v, str))) for s in data.sets]
    named = [k for k, s in enumerate(data.sets) if s.id == data.reference_set]
    wanted = words[named[0]] if named else Counter(words).most_common(1)[0][0]
    there = np.array([w == wanted for w in words])
    angle = np.array([s.environment.get(ANGLE, np.nan) for s in data.sets], float)
    near = np.abs((angle[:, None] - angle[None, :] + 180.0) % 360.0 - 180.0) <= SAME_ANGLE_DEG
    near |= np.isnan(angle)[:, None] & np.isnan(angle)[None, :]
    centre = named[0] if named else int(np.argmax(np.where(there, (near & there).sum(axis=1), -1)))
    same = there & near[centre]
    said = []
    if (off := int(np.sum(~there))):
        said.append(f"{off} sets are in other conditions than {', '.join(f'{k} {v}' for k, v in wanted)}")
    if (off := int(np.sum(there & ~same))):
        said.append(f"in {off} sets the nacelle's heading differs from {angle[centre]:.0f} deg, or is not known")
    sets = tuple(s for s, kept in zip(data.sets, same, strict=True) if kept)
    reference = data.reference_set if any(s.id == data.reference_set for s in sets) else None
    return replace(data, sets=sets, reference_set=reference), said


def _mean_set(data: ModalData, id: str, covariance: bool) -> tuple[ModalSet, list[str]]:
    """The mean of sets, and sentences on frequencies that scatter beyond what the sets state."""
    if not covariance:
        # those of a year are read from the disk, and most of a gigabyte
        data = replace(data, sets=tuple(replace(s, covariance_factors=None) for s in data.sets))
    sets = _to_one_scale(data)
    frequency = np.array([s.frequency_hz for s in sets])
    std = np.array([s.frequency_std_hz for s in sets])
    mean = Mean.estimate(frequency, std)
    # sets that state nothing and agree to the last digit that is printed share its rounding
    mean = replace(mean, std=np.where(mean.is_stated, mean.std, np.maximum(mean.std, rounding_std(frequency))))
    shape = Mean.estimate(np.real(np.array([s.shape for s in sets])), np.array([s.shape_std for s in sets]))
    imaginary = _weighted_sum(np.imag(np.array([s.shape for s in sets])), shape.share)
    damping = Mean.estimate(np.array([s.damping_ratio for s in sets]), np.array([s.damping_ratio_std for s in sets]))
    every = [s.covariance_factors.load() for s in sets if s.covariance_factors is not None]
    factors = _mean_factors(every, mean, shape, damping) if len(every) == len(sets) else None
    together = ModalSet(
        id=id, frequency_hz=mean.value, frequency_std_hz=mean.std, damping_ratio=damping.value,
        damping_ratio_std=damping.std, shape=shape.value + 1j * np.nan_to_num(imaginary), shape_std=shape.std,
        environment=_mean_environment(sets), covariance_factors=factors)
    labels = data.labels or tuple(f"mode {j + 1}" for j in range(data.n_mode))
    unstated = [labels[j] for j in np.flatnonzero(~mean.is_stated & np.isfinite(mean.std))]
    said = [f"{labels[j]} {100 * mean.scatter[j] / mean.value[j]:.2g} % ({100 * mean.stated[j] / mean.value[j]:.2g} %)"
            for j in np.flatnonzero(mean.p_value < UNLIKELY)]
    notes = [f"standard deviations of {', '.join(unstated)} by the sets' scatter, as not every set states them"
             ] if unstated else []
    return together, [*notes, f"frequencies scatter over these sets more than their standard deviations (in brackets): "
                              f"{', '.join(said)}"] if said else notes


@dataclass(frozen=True, eq=False)
class Mean:
    """Of values (n_set, ...) along the first axis: value, std of it; share (n_set, ...) of each set; extra: the part
    of std**2 beyond what sets state; scatter over the sets, root mean square of what they state, p-value of Q;
    is_stated: by every set that has a value."""

    value: np.ndarray
    std: np.ndarray
    share: np.ndarray
    extra: np.ndarray
    scatter: np.ndarray
    stated: np.ndarray
    p_value: np.ndarray
    is_stated: np.ndarray

    @classmethod
    def estimate(cls, values: np.ndarray, std: np.ndarray) -> Mean:
        from scipy import stats

        there = np.isfinite(values)
        n = there.sum(axis=0)
        known = there & (std > 0)
        # where one set states none, the scatter of all is what is known
        stated = np.all(known | ~there, axis=0) & (n > 0)
        own = np.where(known, std, 0.0) ** 2
        weight = np.where(there, 1 / np.where(there & stated, own, 1.0), 0.0)
        first = _weighted_sum(values, weight / np.maximum(weight.sum(axis=0), 1e-300))
        square = np.where(there, (values - first) ** 2, 0.0)
        q, total = np.sum(weight * square, axis=0), weight.sum(axis=0)
        room = total - np.sum(weight**2, axis=0) / np.where(total > 0, total, 1.0)
        between = np.where(stated, np.maximum(q - (n - 1), 0.0) / np.where(room > 0, room, np.inf), 0.0)
        weight = np.where(there & stated, 1 / np.where(there & stated, own + between, 1.0), there.astype(float))
        share = weight / np.maximum(weight.sum(axis=0), 1e-300)
        value = _weighted_sum(values, share)
        scatter = np.sqrt(np.sum(square, axis=0) / np.maximum(n - 1, 1))
        noise = np.sum(share**2 * np.where(there, own, 0.0), axis=0)
        variance = np.where(stated, np.sum(share**2 * np.where(there, own + between, 0.0), axis=0),
                            np.where(n >= FEWEST, scatter**2 / np.maximum(n, 1), np.nan))
        p_value = np.where(stated & (n > 1), stats.chi2.sf(q, np.maximum(n - 1, 1)), 1.0)
        return cls(value=value, std=np.where(n > 0, np.sqrt(variance), np.nan), share=share,
                   extra=np.maximum(variance - noise, 0.0), scatter=scatter,
                   stated=np.sqrt(np.sum(np.where(there, own, 0.0), axis=0) / np.maximum(n, 1)), p_value=p_value,
                   is_stated=stated)


def _weighted_sum(values: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Sum over the first axis, NaN where no set has a value."""
    there = np.isfinite(values)
    return np.where(there.any(axis=0), np.sum(np.where(there, values, 0.0) * share, axis=0), np.nan)


def _to_one_scale(data: ModalData) -> list[ModalSet]:
    """The sets with shapes in the scale, sign and phase of a first one: that which has most; members of a close pair
    turned within their plane."""
    first = max(data.sets, key=lambda s: (s.id == data.reference_set, int(np.isfinite(s.shape).sum())))
    target = rotate_to_real(first.shape)
    # modes that the first set lacks take the scale of the first set that has them
    for s in data.sets:
        lacking = ~np.isfinite(target).any(axis=0)
        target[:, lacking] = rotate_to_real(s.shape)[:, lacking]
    measured = np.array([s.frequency_hz for s in data.sets])
    n = np.isfinite(measured).sum(axis=0)
    frequency = np.where(n > 0, np.nansum(measured, axis=0) / np.maximum(n, 1), np.nan)
    return [_turn_set(s, target, close_clusters(frequency)) for s in data.sets]


def _turn_set(modal_set: ModalSet, target: np.ndarray, clusters: Sequence[Sequence[int]]) -> ModalSet:
    shape, std = np.array(modal_set.shape), np.array(modal_set.shape_std)
    factors = None if modal_set.covariance_factors is None else modal_set.covariance_factors.load()
    moved = None if factors is None else np.array(factors.shape)
    for cluster in clusters:
        members = list(cluster)
        whole = np.isfinite(modal_set.shape[:, members]) & np.isfinite(target[:, members])
        groups = [members] if np.all(whole.any(axis=0)) and whole.all(axis=1).sum() >= len(members) else (
            [[j] for j in members])
        for group in groups:
            rows = np.all(np.isfinite(modal_set.shape[:, group]) & np.isfinite(target[:, group]), axis=1)
            if rows.sum() < len(group):
                continue
            # the combination of this set's shapes that is nearest to the target
            turn = np.linalg.lstsq(modal_set.shape[rows][:, group], target[rows][:, group], rcond=None)[0]
            shape[:, group] = modal_set.shape[:, group] @ turn
            std[:, group] = np.sqrt(modal_set.shape_std[:, group] ** 2 @ np.abs(turn) ** 2)
            if moved is not None and factors is not None:
                moved[:, group] = np.einsum("cjk,jl->clk", factors.shape[:, group], turn)
    return replace(modal_set, shape=shape, shape_std=std,
                   covariance_factors=None if factors is None else replace(factors, shape=moved))


def _mean_factors(each: list[CovarianceFactors], frequency: Mean, shape: Mean, damping: Mean) -> CovarianceFactors:
    """Of the mean: those of the sets by their shares, a column more a quantity for what they scatter beyond them."""
    ln, one = frequency.extra / frequency.value**2, np.arange(frequency.value.size)
    n_channel, n_mode = shape.value.shape
    own_ln = np.zeros((n_mode, n_mode + shape.value.size))
    own_ln[one, one] = np.sqrt(ln)
    own_shape = np.zeros((n_channel, n_mode, own_ln.shape[1]), complex)
    column = n_mode + np.arange(shape.value.size).reshape(n_channel, n_mode)
    np.put_along_axis(own_shape, column[:, :, None], np.sqrt(np.nan_to_num(shape.extra))[:, :, None], axis=2)
    parts = {"ln_frequency": [own_ln], "damping_ratio": [np.zeros_like(own_ln)], "shape": [own_shape]}
    for k, factors in enumerate(each):
        for name, mean in (("ln_frequency", frequency), ("damping_ratio", damping), ("shape", shape)):
            found = getattr(factors, name)
            parts[name].append(mean.share[k][..., None] * np.where(mean.share[k][..., None] > 0, found, 0.0))
    return CovarianceFactors(**{name: np.concatenate(rows, axis=-1) for name, rows in parts.items()})


def _mean_environment(sets: Sequence[ModalSet]) -> dict[str, float]:
    """Means of numbers, of the nacelle's angle around the circle; words that all have. None: not known."""
    found = {}
    for key in dict.fromkeys(key for s in sets for key, value in s.environment.items() if value is not None):
        values = [s.environment[key] for s in sets if s.environment.get(key) is not None]
        if isinstance(values[0], str):
            found[key] = values[0]
        elif key == ANGLE:
            found[key] = float(np.degrees(np.angle(np.mean(np.exp(1j * np.radians(values))))))
        else:
            found[key] = float(np.nanmean(values)) if np.isfinite(values).any() else float("nan")
    return found
