"""Several setups of one structure, measured one after the other with some sensors in common, merged into one set.

Each setup is identified by itself and its blocks are averaged; its shapes are scaled, by least squares, to another
setup's at the channels that the two share (PoSER: Reynders, Magalhaes, De Roeck & Cunha 2009), that to a third's, and
so on to the one that knows its references best; all covariance factors are carried along.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import special

from probupdate.errors import InputError
from probupdate.identification.settings import CONSTANTS
from probupdate.identification.uncertainty import scaled_change
from probupdate.io.files import write_table
from probupdate.io.result_table import with_units
from probupdate.modal.modes import (
    CovarianceFactors,
    ModalData,
    ModalSet,
    Sensor,
    mac,
    pair_by_mac,
    unit_largest,
    write_modes,
)

SAME_FREQUENCY, SAME_MAC = CONSTANTS.same_frequency, CONSTANTS.same_mac
LEAST_SETUPS = CONSTANTS.least_setups
LARGEST_CONDITION = CONSTANTS.largest_condition
LARGEST_STD = CONSTANTS.largest_std
LEAST_P_VALUE = CONSTANTS.least_p_value


@dataclass(frozen=True, eq=False, kw_only=True)
class Setup:
    """One setup's sensors and what was identified of it; `name` for messages."""

    name: str
    sensors: tuple[Sensor, ...]
    data: ModalData


@dataclass(frozen=True, eq=False, kw_only=True)
class MergedModes:
    """data: one set over the channels of all setups; sensors in its order; references: channels of two or more setups;
    table: a row a mode and setup with label, setup, blocks, frequency_hz, frequency_std_hz, misfit (share of the
    references' motion that scaling leaves), p_value (that the setups' frequencies are one, by chi-square)."""

    data: ModalData
    sensors: tuple[Sensor, ...]
    references: tuple[str, ...]
    table: pd.DataFrame
    summary: str

    def to_frame(self) -> pd.DataFrame:
        """A row a mode and setup."""
        return with_units(self.table)

    def write(self, out: str | Path) -> list[Path]:
        """modes.json, modes.deviations.h5 and modes.setups.csv beside it."""
        out = Path(out)
        table = out.with_name(f"{out.stem}.setups.csv")
        written = write_modes(self.data, out)
        write_table(table, self.table)
        return [*written, table]


@dataclass(frozen=True, eq=False, kw_only=True)
class _Mean:
    """A setup's modes averaged over its blocks; ln_frequency, damping (n_mode,), shape (n_channel, n_mode), and their
    covariance factors with a last axis of columns; count (n_mode,) blocks."""

    ln_frequency: np.ndarray
    damping: np.ndarray
    shape: np.ndarray
    d_ln_frequency: np.ndarray
    d_damping: np.ndarray
    d_shape: np.ndarray
    count: np.ndarray


def _gravity(known: Mapping[str, Sensor], channels: Sequence[str]) -> tuple[bool, ...]:
    return tuple(bool(known[c].gravity) for c in channels)


def merge_setups(setups: Sequence[Setup], *, same_modes: bool = False) -> MergedModes:
    """One modal set of all channels. Modes go by label where the setups have the same ones from a model, or
    `same_modes` says that column j is one mode in all; else they are matched by frequency and by the shapes at the
    references. A mode stays if at least two setups and a third of them have it; the others are said, and their
    channels are NaN in it.

    Frequencies and dampings are means weighted by inverse variances; where setups disagree by more than their
    standard deviations, the stated standard deviation is widened by the Birge ratio, and said. Raises InputError
    without common channels, where channels of one name sit at different places, or where a standard deviation is
    missing. A mode in which the references hardly move keeps its frequency; its shape is NaN, which is said.
    """
    if len(setups) < 2:
        raise InputError("setups", f"{len(setups)} cannot be merged", "give two or more")
    references = _references(setups)
    means = [_mean(setup) for setup in setups]
    labels, columns = _common_modes(setups, means, same_modes)
    if not labels:
        raise InputError("setups", "have no mode in common", "check the frequencies and the references")
    means = [_select_modes(mean, column) for mean, column in zip(means, columns, strict=True)]
    channels = tuple(dict.fromkeys([*references, *(c for s in setups for c in s.data.channels)]))
    known = {sensor.channel: sensor for s in setups for sensor in s.sensors}
    shape, d_shape, misfit, noise = _joined_shapes(setups, means, channels, references)
    parts = [m.d_ln_frequency.shape[1] for m in means]
    ln_frequency, d_ln_frequency, spread, p_value = _weighted_mean([m.ln_frequency for m in means],
                                                                   [m.d_ln_frequency for m in means], parts)
    damping, d_damping, _, _ = _weighted_mean([m.damping for m in means], [m.d_damping for m in means], parts)
    frequency = np.exp(ln_frequency)
    modal = ModalSet(
        id="merged: " + ", ".join(s.name for s in setups), frequency_hz=frequency, damping_ratio=damping, shape=shape,
        # what is wider than the record's own scatter is stated here; the standard deviation below keeps the covariances
        frequency_std_hz=frequency * np.linalg.norm(d_ln_frequency, axis=1) * spread,
        shape_std=np.full(shape.shape, np.nan), environment={"setups": float(len(setups))},
        covariance_factors=CovarianceFactors(ln_frequency=d_ln_frequency, damping_ratio=d_damping, shape=d_shape),
    )
    table = pd.DataFrame([
        {"label": label, "setup": setup.name, "blocks": int(mean.count[j]),
         "frequency_hz": float(np.exp(mean.ln_frequency[j])),
         "frequency_std_hz": float(np.exp(mean.ln_frequency[j]) * np.linalg.norm(mean.d_ln_frequency[j])),
         "misfit": float(misfit[k][j]), "p_value": float(p_value[j])}
        for j, label in enumerate(labels) for k, (setup, mean) in enumerate(zip(setups, means, strict=True))
        if np.isfinite(mean.ln_frequency[j])
    ])
    data = ModalData(channels=channels, sets=(modal,), labels=labels, gravity=_gravity(known, channels))
    return MergedModes(
        data=data, sensors=tuple(known[c] for c in channels), references=references, table=table,
        summary=_summary(setups, means, modal, labels, references, misfit, p_value),
    )


def _references(setups: Sequence[Setup]) -> tuple[str, ...]:
    return shared_channels([(s.name, tuple(x for x in s.sensors if x.channel in s.data.channels)) for s in setups])


def shared_channels(setups: Sequence[tuple[str, tuple[Sensor, ...]]]) -> tuple[str, ...]:
    """The channels that two or more setups (name, sensors) have. Raises InputError where these do not join all setups,
    or where channels of one name sit at different places."""
    places = [{sensor.channel: sensor for sensor in sensors} for _, sensors in setups]
    joined, left = {0}, set(range(1, len(places)))
    while more := {k for k in left if any(places[k].keys() & places[j].keys() for j in joined)}:
        joined, left = joined | more, left - more
    if left:
        first, second = (", ".join(setups[k][0] for k in sorted(some)) for some in (joined, left))
        raise InputError("setups", f"have no channel in common: {first} and {second}",
                         "name the references alike in every campaign.toml")
    every = dict.fromkeys(c for place in places for c in place)
    for channel in sorted(every):
        here = [place[channel] for place in places if channel in place]
        for other in here[1:]:
            moved = float(np.linalg.norm(other.position_m - here[0].position_m))
            if moved > 0.05 or float(other.direction @ here[0].direction) < 0.99 or other.gravity != here[0].gravity:
                raise InputError(f"channel {channel}", f"sits elsewhere in another setup ({moved:.2g} m away, or of "
                                 "another direction or gravity)",
                                 "give a sensor that was moved a name of its own in each setup")
    return tuple(c for c in every if sum(c in place for place in places) > 1)


def _shared_channels(first: Setup, second: Setup) -> tuple[list[int], list[int]]:
    """Rows of the channels that two setups share, in each."""
    one, two = first.data.channels, second.data.channels
    names = [c for c in one if c in two]
    return [one.index(c) for c in names], [two.index(c) for c in names]


def _mean(setup: Setup) -> _Mean:
    """Blocks averaged, shapes scaled to those of the block with the least standard deviation; unresolved pairs as
    planes."""
    sets = [s for s in setup.data.sets if s.measured.any()]
    if not sets:
        raise InputError(f"setup {setup.name}", "has no identified mode", "run `probupdate check` on it")
    known = [s.covariance_factors for s in sets if s.covariance_factors is not None]
    if len(known) < len(sets):
        raise InputError(f"setup {setup.name}", "a block has no standard deviations, which merging weights by",
                         "identify with sub-records")
    n_mode, widths = setup.data.n_mode, [d.n_column for d in known]
    total, place = sum(widths), np.cumsum([0, *widths])
    n_channel = len(setup.data.channels)
    value, damping = np.full(n_mode, np.nan), np.full(n_mode, np.nan)
    shape = np.full((n_channel, n_mode), np.nan + 0j)
    d_value, d_damping = np.zeros((n_mode, total)), np.zeros((n_mode, total))
    d_shape, count = np.zeros((n_channel, n_mode, total), complex), np.zeros(n_mode, int)
    for j in range(n_mode):
        some = [k for k, s in enumerate(sets) if s.measured[j] and np.isfinite(known[k].ln_frequency[j]).all()]
        if not some:
            continue
        count[j] = len(some)
        # equal weights within a setup: a block's own standard deviation is known to 13 % only, and goes with its
        # frequency
        weight = 1 / len(some)
        value[j] = sum(np.log(sets[k].frequency_hz[j]) for k in some) * weight
        damping[j] = sum(sets[k].damping_ratio[j] for k in some) * weight
        for k in some:
            columns = slice(place[k], place[k + 1])
            d_value[j, columns] = weight * known[k].ln_frequency[j]
            d_damping[j, columns] = weight * known[k].damping_ratio[j]
    for group in _groups(value, damping):
        some = [k for k, d in enumerate(known) if np.isfinite(d.shape[:, group]).all()]
        if not some:
            # its frequency stays: other setups may know the shape
            shape[:, group], d_shape[:, group] = np.nan, np.nan
            continue
        best = min(some, key=lambda k: np.linalg.norm(known[k].shape[:, group]))
        gathered = np.zeros((n_channel, len(group)), complex)
        # the block that the others are scaled to has errors too: in a pair they turn all of them
        d_own, d_target = (np.zeros((n_channel, len(group), total), complex) for _ in range(2))
        d_target[:, :, place[best]: place[best + 1]] = known[best].shape[:, group]
        for k in some:
            d_own[...] = 0
            d_own[:, :, place[k]: place[k + 1]] = known[k].shape[:, group]
            scaled, d_scaled = scaled_to(
                sets[k].shape[:, group], d_own, sets[best].shape[:, group], d_target=d_target)
            gathered += scaled / len(some)
            d_shape[:, group] += d_scaled / len(some)
        shape[:, group] = gathered
    return _Mean(ln_frequency=value, damping=damping, shape=shape, d_ln_frequency=d_value, d_damping=d_damping,
                 d_shape=d_shape, count=count)


def scaled_to(
    shape: np.ndarray, covariance_factors: np.ndarray, target: np.ndarray, rows: Sequence[int] | None = None,
    d_target: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """shape T with T (k, k) that brings shape[rows] T nearest to target (n_row, k), and the change of the
    product.

    shape (n_channel, k), covariance_factors (n_channel, k, n_column); d_target (n_row, k, n_column) of a target with
    one. dT = P^+ (dR - dP T) + (P^H P)^-1 dP^H (R - P T), with P the rows and R the target.
    """
    rows = list(range(len(shape))) if rows is None else list(rows)
    part, d_part = shape[rows], covariance_factors[rows]
    factor = np.linalg.lstsq(part, target, rcond=None)[0]
    inverse = np.linalg.inv(part.conj().T @ part)
    left = target - part @ factor
    moved = -np.einsum("ikc,kl->ilc", d_part, factor)
    if d_target is not None:
        moved = moved + d_target
    d_factor = np.einsum("ki,ilc->klc", inverse @ part.conj().T, moved)
    d_factor += np.einsum("km,imc,il->klc", inverse, d_part.conj(), left)
    return shape @ factor, np.einsum("ikc,kl->ilc", covariance_factors, factor) + np.einsum("ik,klc->ilc", shape,
                                                                                            d_factor)


def _common_modes(
    setups, means: list[_Mean], same_modes: bool
) -> tuple[tuple[str, ...], list[list[int]]]:
    """Labels, and for each setup the column of each, -1 where it does not have the mode."""
    first = setups[0].data
    there = [np.isfinite(m.ln_frequency) for m in means]
    least = max(2, int(np.ceil(LEAST_SETUPS * len(setups))))
    named = all(s.data.labels == first.labels for s in setups) and not all(t.isdigit() for t in first.labels)
    if same_modes or named:
        kept = [j for j in range(first.n_mode) if sum(bool(t[j]) for t in there) >= least]
        labels = tuple(first.labels[j] for j in kept) if named else tuple(str(k + 1) for k in range(len(kept)))
        return labels, [[j if t[j] else -1 for j in kept] for t in there]
    modes = [m for m in _alike_at_references(setups, means, there) if len(m) >= least]
    modes.sort(key=lambda m: np.mean([means[k].ln_frequency[j] for k, j in m.items()]))
    columns = [[m.get(k, -1) for m in modes] for k in range(len(setups))]
    return tuple(str(k + 1) for k in range(len(modes))), columns


def _alike_at_references(
    setups: Sequence[Setup], means: list[_Mean], there: list[np.ndarray]
) -> list[dict[int, int]]:
    """Modes as setup -> column, by frequency and by the shapes at the channels that two setups share."""
    # setups with most modes first; each mode is held against those of the setups before that have it best
    modes: list[dict[int, int]] = []
    for k in sorted(range(len(means)), key=lambda k: -int(there[k].sum())):
        criterion = np.full((len(modes), len(there[k])), np.nan)
        for m, known in enumerate(modes):
            for other, column in known.items():
                away = np.abs(means[k].ln_frequency - means[other].ln_frequency[column])
                theirs, ours = _shared_channels(setups[other], setups[k])
                # setups without a channel in common may have a mode of the same frequency, known by a third
                alike = (mac(means[other].shape[np.ix_(theirs, [column])], means[k].shape[ours])[0] if ours
                         else np.full(len(away), SAME_MAC))
                # of two about as alike the nearer
                value = np.where((away <= SAME_FREQUENCY) & (alike >= SAME_MAC), alike - away / SAME_FREQUENCY, np.nan)
                criterion[m] = np.fmax(criterion[m], value + 1)
        pairs = dict(pair_by_mac(criterion)) if modes else {}
        for m, column in pairs.items():
            modes[m][k] = column
        modes += [{k: int(j)} for j in np.flatnonzero(there[k]) if int(j) not in pairs.values()]
    return modes


def _select_modes(mean: _Mean, columns: list[int]) -> _Mean:
    there = np.array(columns, int)

    def pick(value: np.ndarray, axis: int = 0) -> np.ndarray:
        picked = np.array(np.take(value, np.maximum(there, 0), axis=axis))
        index: list = [slice(None)] * picked.ndim
        index[axis] = there < 0
        picked[tuple(index)] = 0 if picked.dtype.kind == "i" else np.nan
        return picked

    return _Mean(ln_frequency=pick(mean.ln_frequency), damping=pick(mean.damping), shape=pick(mean.shape, 1),
                 d_ln_frequency=pick(mean.d_ln_frequency), d_damping=pick(mean.d_damping),
                 d_shape=pick(mean.d_shape, 1), count=pick(mean.count))


def _groups(ln_frequency: np.ndarray, damping: np.ndarray) -> list[list[int]]:
    """Modes that stand alone, and pairs so close that records turn them in their plane: their half-power bandwidths
    meet. Modes without a frequency are left out."""
    frequency = np.exp(ln_frequency)
    width, taken, groups = frequency * damping, set(), []
    order = [int(k) for k in np.argsort(frequency) if np.isfinite(frequency[k])]
    for i, j in pairwise(order):
        if i not in taken and frequency[j] - frequency[i] < width[i] + width[j]:
            groups.append([i, j])
            taken |= {i, j}
    return groups + [[k] for k in order if k not in taken]


def _joined_shapes(setups, means: list[_Mean], channels, references):
    """Shape (n_channel, n_mode) of all channels, its covariance factors over the columns of all setups, the misfit of
    each setup and mode (n_setup, n_mode) to the merged shape at all references that it has, NaN where a setup gives no
    shape, and how well each setup's references know the mode (n_setup, n_mode), relative. NaN: channels of
    setups without the mode, or in which the references hardly move."""
    n_mode, widths = len(means[0].ln_frequency), [m.d_ln_frequency.shape[1] for m in means]
    place, total = np.cumsum([0, *widths]), sum(widths)
    shape = np.full((len(channels), n_mode), np.nan + 0j)
    misfit, known = np.full((len(means), n_mode), np.nan), np.full((len(means), n_mode), np.nan)
    d_shape = np.full((len(channels), n_mode, total), np.nan + 0j)
    rows = [[s.data.channels.index(c) for c in references if c in s.data.channels] for s in setups]
    middle = (np.nanmean([m.ln_frequency for m in means], axis=0), np.nanmean([m.damping for m in means], axis=0))
    for group in _groups(*middle):
        noise = np.full(len(means), np.inf)
        for k, (m, r) in enumerate(zip(means, rows, strict=True)):
            if np.isfinite(m.shape[:, group]).all() and np.isfinite(m.d_shape[:, group]).all():
                noise[k] = _relative_noise(m, r, group)
        known[:, group] = noise[:, None]
        usable = [int(k) for k in np.flatnonzero(noise <= LARGEST_STD)]
        if not usable:
            continue
        scaled: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        for k, parent in _tree(setups, means, group, usable, int(np.argmin(noise))):
            d_own = np.zeros((*means[k].shape[:, group].shape, total), complex)
            d_own[:, :, place[k]: place[k + 1]] = means[k].d_shape[:, group]
            theirs, ours = _shared_channels(setups[parent], setups[k])
            # the first is scaled to itself
            target, d_target = scaled.get(parent, (means[k].shape[:, group], d_own))
            target, d_target = target[theirs], d_target[theirs]
            _refuse_alike(target, [setups[k].data.channels[i] for i in ours], np.exp(means[k].ln_frequency[group]))
            scaled[k] = scaled_to(means[k].shape[:, group], d_own, target, ours, d_target)
        value = np.zeros((len(channels), len(group)), complex)
        d_value = np.zeros((len(channels), len(group), total), complex)
        weights = np.zeros(len(channels))
        for k, (own, d_own) in scaled.items():
            index = [channels.index(c) for c in setups[k].data.channels]
            weight = 1 / max(noise[k], 1e-12) ** 2
            value[index] += weight * own
            d_value[index] += weight * d_own
            weights[index] += weight
        reached = np.flatnonzero(weights > 0)
        shape[np.ix_(reached, np.array(group, int))] = value[reached] / weights[reached, None]
        for k, (own, _) in scaled.items():
            index = [channels.index(setups[k].data.channels[i]) for i in rows[k]]
            mean = value[index] / weights[index, None]
            misfit[k, group] = np.sum(np.abs(mean - own[rows[k]]) ** 2, axis=0) / np.sum(np.abs(mean) ** 2, axis=0)
        d_shape[np.ix_(reached, np.array(group, int))] = d_value[reached] / weights[reached, None, None]
    for j in range(n_mode):
        seen_rows = np.flatnonzero(np.isfinite(shape[:, j]))
        if len(seen_rows):
            d_shape[seen_rows, j] = scaled_change(shape[seen_rows, j][:, None], d_shape[seen_rows, j][:, None])[:, 0]
            shape[seen_rows, j] = unit_largest(shape[seen_rows, j][:, None])[:, 0]
    return shape, d_shape, misfit, known


def _relative_noise(mean: _Mean, rows: list[int], group: list[int]) -> float:
    """Standard deviation of some channels' motion in a group of modes over that motion."""
    size = np.linalg.norm(mean.shape[np.ix_(rows, group)])
    return float(np.linalg.norm(mean.d_shape[np.ix_(rows, group)]) / size) if size > 0 else np.inf


def _tree(
    setups: Sequence[Setup], means: list[_Mean], group: list[int], usable: list[int], base: int
) -> list[tuple[int, int]]:
    """Setups with the one that each is scaled to, nearest to the base first. Left out are those that no channels join
    to it which both know well enough."""
    found, reached = [(base, base)], [base]
    for parent in reached:
        for k in usable:
            if k in reached:
                continue
            theirs, ours = _shared_channels(setups[parent], setups[k])
            if ours and max(_relative_noise(means[parent], theirs, group),
                            _relative_noise(means[k], ours, group)) <= LARGEST_STD:
                found.append((k, parent))
                reached.append(k)
    return found


def _refuse_alike(target: np.ndarray, references: Sequence[str], frequency_hz: np.ndarray) -> None:
    size = np.linalg.norm(target, axis=0)
    if len(target) < target.shape[1] or np.linalg.cond(target / size) > LARGEST_CONDITION:
        raise InputError("references", f"{', '.join(references)} cannot distinguish modes of "
                         f"{', '.join(f'{f:.4g} Hz' for f in frequency_hz)}",
                         "take references in which they differ")


def _weighted_mean(values: list[np.ndarray], factors: list[np.ndarray], widths: list[int]):
    """Mean by inverse variances with its factors over all columns, the Birge ratio (1 or more) and the
    p-value; of the values that are there, with their factors."""
    value = np.array(values)
    variance = np.array([np.sum(d**2, axis=1) for d in factors])
    there = np.isfinite(value) & np.isfinite(variance) & (variance > 0)
    inverse = np.where(there, 1 / np.where(there, variance, 1.0), 0.0)
    weight = inverse / inverse.sum(axis=0)
    mean = np.sum(weight * np.where(there, value, 0.0), axis=0)
    place = np.cumsum([0, *widths])
    joint = np.zeros((len(mean), place[-1]))
    for k, d in enumerate(factors):
        joint[:, place[k]: place[k + 1]] = weight[k][:, None] * np.where(there[k][:, None], d, 0.0)
    chi2 = np.sum(inverse * (np.where(there, value, 0.0) - mean) ** 2, axis=0)
    freedom = there.sum(axis=0) - 1
    several = np.maximum(freedom, 1)
    birge = np.where(freedom > 0, np.maximum(np.sqrt(chi2 / several), 1.0), 1.0)
    return mean, joint, birge, np.where(freedom > 0, special.chdtrc(several, chi2), 1.0)


def _summary(setups, means, modal: ModalSet, labels, references, misfit, p_value) -> str:
    lines = [f"{len(setups)} setups merged on {', '.join(references)}: {modal.shape.shape[0]} channels, "
             f"{len(labels)} modes; a gain that all references share in one setup, or of the only one that a mode "
             "moves, scales that part of its shape: `probupdate check` of all setups says whether it would show"]
    for j, label in enumerate(labels):
        text = f"{label}: {modal.frequency_hz[j]:.4g} Hz, standard deviation {modal.frequency_std_hz[j]:.2g} Hz; "
        if np.isfinite(misfit[:, j]).any():
            worst = np.nanmax(misfit[:, j])
            text += f"scaling leaves {100 * worst:.2g} % of the references' motion in the worst setup"
        else:
            text += "the references hardly move in it: no shape"
        without = [s.name for s, m in zip(setups, means, strict=True) if not np.isfinite(m.ln_frequency[j])]
        vague = [s.name for k, s in enumerate(setups) if s.name not in without and not np.isfinite(misfit[k, j])]
        if without:
            text += f"; not found in {', '.join(without)}"
        if vague and np.isfinite(misfit[:, j]).any():
            text += f"; no shape from {', '.join(vague)}, whose references resolve it too poorly"
        if p_value[j] < LEAST_P_VALUE:
            text += f"; the setups' frequencies disagree (p {p_value[j]:.2g}): the standard deviation was widened"
        lines.append(text)
    return "\n".join(lines)
