"""Measured blocks as arrays: which sets are used, in what order, with what environmental and operational conditions."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import combinations

import numpy as np
from scipy.sparse import csgraph

from probupdate.campaign.blocks import PART
from probupdate.errors import InputError
from probupdate.io.result_table import plural
from probupdate.modal.joined_modes import hours_of, join_modes
from probupdate.modal.matching import close_clusters
from probupdate.modal.modes import (
    CovarianceFactors,
    ModalData,
    ModalSet,
    ModeRecord,
    StoredFactors,
    rotate_to_real,
)
from probupdate.runtime.arrays import frozen_array

# a block in which the nacelle turned by more has no one set of modes
YAW_RANGE_DEG = 2.0
# a mode found in a smaller share of the blocks is left out
MODE_SHARE = 0.2
# a mode this far off its median (in ln f) was taken for another one, unless it stays there: two levels, each held by
# this share of the sets and three of many, that leave at most this share of the standard deviations from one level
STRAY, LEVEL_SHARE, LEVEL_LEAVES = 0.15, 0.2, 0.5
# fewer blocks say nothing of their own scatter: what the identification states of them is believed
FEWEST = 8
# a mode without a counterpart is said from this share of the sets on
PERSISTENT = 0.5
# sets that lack one mode of a pair are said from this share on
RARELY = 0.25
# a covariate known in a smaller share of the blocks is none
KNOWN_SHARE = 0.9
# neighbours nearer to each other (in ln f) are copies, computed or rounded: identification scatters by 1e-4 and more
SCATTER = 1e-9
# of two channels' shapes, squared, the share that no factor explains within which their numbers are the same
COPIED = 1e-12


@dataclass(frozen=True, eq=False, kw_only=True)
class SetFactors:
    """Covariance factors the identification states for a block, one column a sub-record. `read` gives ln_frequency
    (n_mode, n_column) and shape (n_channel, n_mode, n_column) complex, made or read from the disk each time, as those
    of a year are a gigabyte; sums over columns are joint covariances."""

    read: Callable[[], tuple[np.ndarray, np.ndarray]]

    @property
    def ln_frequency(self) -> np.ndarray:
        return self.read()[0]

    @property
    def shape(self) -> np.ndarray:
        return self.read()[1]


@dataclass(frozen=True, eq=False, kw_only=True)
class Blocks:
    """ids and hours (n_block,) since the first; frequency_hz (n_block, n_mode) and shape (n_block, n_channel, n_mode)
    complex, NaN where a mode was not found; groups: modes compared together, one or a close cluster, ascending.

    relative_std (n_block, n_group): the standard deviations the identification states over their median, 1 where it
    states none. `few`: fewer than FEWEST, all with stated standard deviations, which are then taken as they are.
    `std_alone`: no set states covariances. No channels: frequencies alone, each mode by itself.
    """

    ids: tuple[str, ...]
    hours: np.ndarray
    channels: tuple[str, ...]
    labels: tuple[str, ...]
    groups: tuple[tuple[int, ...], ...]
    frequency_hz: np.ndarray
    shape: np.ndarray
    angle_deg: np.ndarray
    environment: tuple[Mapping, ...]
    relative_std: np.ndarray
    factors: tuple[SetFactors | None, ...]
    notes: tuple[str, ...]
    few: bool = False
    std_alone: bool = False

    def __len__(self) -> int:
        return len(self.ids)

    @cached_property
    def present(self) -> np.ndarray:
        """(n_block, n_group) bool: all modes of the group with every channel."""
        return np.column_stack([self.have(g) for g in self.groups])

    def have(self, modes: Sequence[int]) -> np.ndarray:
        """(n_block,) bool: all these modes with every channel."""
        there = np.isfinite(self.frequency_hz) & np.all(np.isfinite(self.shape), axis=1)
        return there[:, list(modes)].all(axis=1)

    def covariate(self, name: str) -> np.ndarray | None:
        """(n_block,) of a number in the environment; None unless nearly every block shows it and it varies."""
        values = self.numbers(name)
        known = np.isfinite(values)
        if known.mean() < KNOWN_SHARE or np.std(values[known]) == 0:
            return None
        return np.where(known, values, np.mean(values[known]))

    def sparse_column_notes(self, columns: Sequence[str]) -> list[str]:
        """What to say of those that only a part of the blocks shows."""
        shares = {name: np.mean(np.isfinite(self.numbers(name))) for name in columns}
        return [f"{name} is stated in {share:.0%} of the blocks: effects that follow it are not searched"
                for name, share in shares.items() if 0 < share < KNOWN_SHARE]

    def rarely_whole(self) -> list[str]:
        """What to say of pairs of which often one mode alone was found."""
        said = []
        for q, group in enumerate(self.groups):
            one = np.any([self.have([j]) for j in group], axis=0)
            lost = one & ~self.present[:, q]
            if np.sum(lost) > RARELY * np.sum(one):
                said.append(f"modes {self.group_name(q)}: of {int(np.sum(one))} sets that have one of the two, "
                            f"{int(np.sum(lost))} lack the other and inform neither (the last: "
                            f"{self.ids[int(np.flatnonzero(lost)[-1])]})")
        return said

    @property
    def headings_known(self) -> bool:
        """Whether any block shows where the nacelle looked."""
        return bool(np.isfinite(self.numbers("nacelle_angle_deg")).any())

    def numbers(self, name: str) -> np.ndarray:
        """(n_block,) of the environment, NaN where it shows none."""
        return np.array([_number(e.get(name)) for e in self.environment])

    def states(self) -> np.ndarray:
        """(n_block,) text, empty where none is stated."""
        return np.array([str(e.get("state", "")) for e in self.environment])

    def group_name(self, number: int) -> str:
        return "/".join(self.labels[j] for j in self.groups[number])

    def select_blocks(self, chosen: np.ndarray) -> Blocks:
        """Only the blocks numbered `chosen`."""
        chosen = np.asarray(chosen)
        return Blocks(
            ids=tuple(self.ids[k] for k in chosen), hours=frozen_array(self.hours[chosen]), channels=self.channels,
            labels=self.labels, groups=self.groups, frequency_hz=frozen_array(self.frequency_hz[chosen]),
            shape=frozen_array(self.shape[chosen], complex), angle_deg=frozen_array(self.angle_deg[chosen]),
            environment=tuple(self.environment[k] for k in chosen),
            relative_std=frozen_array(self.relative_std[chosen]),
            factors=tuple(self.factors[k] for k in chosen), notes=self.notes, few=self.few,
            std_alone=self.std_alone,
        )


def _number(value) -> float:
    usable = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if usable else np.nan


def _refuse_zero_shapes(where: str, ids: Sequence[str], shape: np.ndarray) -> None:
    """Shapes (n_set, n_channel, n_mode), NaN where they were not measured."""
    measured = np.isfinite(shape)
    zero = np.argwhere(np.any(measured, axis=1) & ~np.any(measured & (shape != 0), axis=1))
    if len(zero):
        number, mode = zero[0]
        raise InputError(f"{where}, set {ids[number]}", f"the shape of mode {mode + 1} is zero at every channel",
                         "leave shapes that were not measured out (null)")


def gather(
    data: ModalData, where: str = "modes", expected_hz: Mapping[str, float] | None = None, alone: Sequence[str] = (),
    resting_deg: float = 0.0,
) -> Blocks:
    """The usable blocks of modes.json in the order of time; raises InputError, naming `where`, if too few are left.

    `expected_hz`: where a model has each mode, by label; a mode that is not there is left out. Modes are compared
    together that are close where they were measured or close in the model: a model of equal stiffness both ways has no
    shapes of single modes to compare. `alone`: modes that are compared by themselves whatever they are close to.
    """
    sets, few, notes = _usable_sets(data, where)
    sets, hours, more = _order_by_time(sets)
    notes += more
    frequency, more = _without_stray_frequencies(np.array([s.frequency_hz for s in sets]))
    notes += more
    with np.errstate(invalid="ignore"):
        steps = np.abs(np.diff(np.log(frequency), axis=0))
    if not few and np.isfinite(steps).any() and np.nanmedian(steps) < SCATTER:
        raise InputError(where, "most sets have the frequencies of the set before them: copied, computed or rounded",
                         "give sets that were identified one by one, with all digits: their scatter is the noise that "
                         "effects are tested against")
    shape = np.array([s.shape for s in sets])
    kept_channels, more = _used_channels(data.channels, frequency, shape, with_model=expected_hz is not None)
    notes += more
    shape = shape[:, kept_channels]
    _refuse_zero_shapes(where, [s.id for s in sets], shape)
    labels = data.labels or tuple(f"mode {j + 1}" for j in range(data.n_mode))
    kept, more = _used_modes(labels, frequency, shape, expected_hz)
    notes += more
    if not len(kept):
        raise InputError(where, "no mode is found with every channel in a fifth of the blocks",
                         "leave out channels that are mostly missing")
    frequency, shape = frequency[:, kept], shape[:, :, kept]
    raw, shape = shape, np.array([rotate_to_real(s) for s in shape])
    # what turned a shape turns its standard deviations
    turn = np.exp(1j * np.angle(np.nansum(shape * raw.conj(), axis=1)))
    factors = tuple(_factors(s, kept, kept_channels, t) for s, t in zip(sets, turn, strict=True))
    names = tuple(labels[j] for j in kept)
    places = [np.nanmedian(frequency, axis=0)]
    if expected_hz is not None:
        places.append(np.array([expected_hz[name] for name in names]))
    # one channel shows no plane of two shapes
    groups = _groups(np.array(places), names, alone if len(kept_channels) > 1 else names)
    angle = np.array([_number(s.environment.get("nacelle_angle_deg")) for s in sets])
    unknown = int(np.sum(np.isnan(angle)))
    if 0 < unknown < len(sets):
        notes.append(f"{unknown} sets do not state where the nacelle looked: taken as in the model")
    return Blocks(
        ids=tuple(s.id for s in sets), hours=frozen_array(hours),
        channels=tuple(data.channels[k] for k in kept_channels), labels=names, groups=groups,
        frequency_hz=frozen_array(frequency), shape=frozen_array(shape, complex),
        angle_deg=frozen_array(np.where(np.isnan(angle), resting_deg, angle)),
        environment=tuple(dict(s.environment) for s in sets),
        relative_std=frozen_array(_relative_std(sets, kept, kept_channels, groups)), factors=factors,
        notes=tuple(notes), few=few, std_alone=not any(s.covariance_factors is not None for s in sets),
    )


def of_model(data: ModalData, beside: Collection[str] = ()) -> tuple[ModalData, list[str]]:
    """The modes that are compared with a model, each as one, and those `beside` them; and what to say of those that
    were two, or that are none of the model's."""
    data, notes = join_modes(data)
    # what the model lacks comes first
    notes = [*map(unmatched_words, find_unmatched_modes(data)), *notes]
    compared = data.compared()
    if not beside:
        return compared, notes
    return data.of_modes([j for j, label in enumerate(data.labels) if label in {*compared.labels, *beside}]), notes


def find_unmatched_modes(data: ModalData) -> list[ModeRecord]:
    """Modes found in most sets, below the highest that the model has, that no mode of the model is."""
    highest = max((r.frequency_hz for r in data.records if r.found and r.match in ("alike", "unlike")), default=0.0)
    return [r for r in data.records if r.label.isdigit() and r.match == "none" and r.frequency_hz < highest
            and r.found >= PERSISTENT * r.blocks]


def unmatched_words(r: ModeRecord) -> str:
    return (f"{mode_words(r)}, has no counterpart in the model and is not compared: the verdict does not cover what "
            "the model lacks there (a member, a tuned mass, a machine)")


def mode_words(r: ModeRecord) -> str:
    """"mode 6 at 2.068 Hz, in 23 of 24 sets"."""
    return f"mode {r.label} at {r.frequency_hz:.4g} Hz, in {r.found} of {r.blocks} sets"


def _usable_sets(data: ModalData, where: str) -> tuple[list[ModalSet], bool, list[str]]:
    """The sets with modes in which the nacelle hardly turned, whether they are few, and what to say of it; raises
    InputError where they show no noise."""
    notes = []
    sets = [s for s in data.sets if np.any(s.measured)]
    unused = [s for s in data.sets if not np.any(s.measured)]
    part = sum(str(s.environment.get("excluded", "")).startswith(PART) for s in unused)
    if part:
        notes.append(f"{plural(part, 'block')} at the ends of recordings, shorter than the others, not used")
    empty = [s.id for s in unused if not str(s.environment.get("excluded", "")).startswith(PART)]
    if empty:
        notes.append(f"{len(empty)} {'set' if len(empty) == 1 else 'sets'} left out without a mode: "
                     f"{', '.join(empty[:3])}{', ...' * (len(empty) > 3)}")
    turning = [s for s in sets if _number(s.environment.get("nacelle_heading_deg_range", 0.0)) > YAW_RANGE_DEG]
    if turning:
        notes.append(f"{len(turning)} blocks left out in which the nacelle turned by more than {YAW_RANGE_DEG:g} deg")
        sets = [s for s in sets if not any(s is t for t in turning)]
    few = len(sets) < FEWEST
    without = [s.id for s in sets if not _states_std(s)]
    if not sets or (few and without):
        raise InputError(
            where,
            f"has {len(sets)} usable sets of {len(data.sets)}"
            + (f"; in {len(turning)} the nacelle turned by more than {YAW_RANGE_DEG:g} deg" if turning else "")
            + (f"; set {without[0]} has a frequency or shape with no standard deviation above zero" if without else ""),
            f"give at least {FEWEST}, as the scatter between them is the noise that effects are tested against (a "
            "longer record, or identify shorter blocks: block_minutes in campaign.toml), or state what each set's "
            "frequencies and shapes are known to (frequency_std_hz, shape_std in modes.json, or --frequency-std and "
            "--shape-std for all), or leave shapes out (--shapes none)",
        )
    zero = [s.id for s in sets if _states_zero(s)]
    if zero:
        notes.append(f"{plural(len(zero), 'set')} with a standard deviation of zero ({', '.join(zero[:3])}"
                     f"{', ...' * (len(zero) > 3)}): taken as not known; write what it is, or null")
    if few:
        who = "1 set shows" if len(sets) == 1 else f"{len(sets)} sets show"
        notes.append(f"{who} too little scatter to check the stated standard deviations, which are taken as they are")
    return sets, few, notes


def _order_by_time(sets: Sequence[ModalSet]) -> tuple[list[ModalSet], np.ndarray, list[str]]:
    """The sets in the order of time, their hours since the first one, and what to say where ids are not times."""
    notes = []
    hours = hours_of(tuple(s.id for s in sets))
    if hours is None:
        other = [s.id for s in sets if hours_of((s.id,)) is None]
        whose = "the sets' ids are not times" if len(other) == len(sets) else (
            f"of {len(sets)} ids {len(other)} {'is not a time' if len(other) == 1 else 'are not times'} "
            f"({', '.join(map(repr, other[:3]))}{', ...' if len(other) > 3 else ''}; correct to use the times)")
        notes.append(f"{whose}: all sets are taken as an hour apart, in the file's order, so that no daily cycle "
                     "is recognised: give each the time of its start, 2026-03-01T10:00Z")
        hours = np.arange(len(sets), dtype=float)
    order = np.argsort(hours, kind="stable")
    return [sets[k] for k in order], hours[order], notes


def _without_stray_frequencies(frequency: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Frequencies (n_block, n_mode), NaN where they are far off their mode's, and what to say of it."""
    with np.errstate(invalid="ignore"):
        level = np.column_stack([_level(np.log(f)) for f in frequency.T])
        stray = np.abs(np.log(frequency) - level) > STRAY
    if not stray.any():
        return frequency, []
    return np.where(stray, np.nan, frequency), [
        f"{int(stray.sum())} modes left out, more than {100 * STRAY:.0f} % off their median frequency"]


def _used_channels(
    channels: Sequence[str], frequency: np.ndarray, shape: np.ndarray, *, with_model: bool
) -> tuple[np.ndarray, list[str]]:
    """Numbers of the channels that are used, of shapes (n_block, n_channel, n_mode), and what to say of the others."""
    notes = []
    if not np.isfinite(shape).any():
        pairing = ", paired with the model's in their order," if with_model else ""
        notes.append(f"no set has a shape: frequencies alone{pairing} distinguish few causes, and show nothing of the "
                     "sensors")
    found = np.isfinite(frequency) & np.any(np.isfinite(shape), axis=1)
    there = np.isfinite(shape)[found.any(axis=1)]
    seen = np.any(there, axis=2)
    kept = _best_known(seen) if len(seen) else np.zeros(0, int)
    left = [f"{c} (there in {m:.0%} of the blocks)" for k, (c, m) in
            enumerate(zip(channels, seen.mean(axis=0), strict=True)) if k not in kept] if len(seen) else []
    if left:
        notes.append(f"channels left out, so that blocks without them can be used: {', '.join(left)}")
    short = int(np.sum(~seen[:, kept].all(axis=1)))
    if short:
        notes.append(f"{short} of {len(seen)} blocks left out, in which one channel or another is missing")
    return kept, [*notes, *_copied_channel_notes(channels, shape)]


def _copied_channel_notes(channels: Sequence[str], shape: np.ndarray) -> list[str]:
    """What to say of channels with the same numbers, but for one factor, in a part of the sets or in all: sensors that
    differ in nothing have their own noise all the same."""
    notes = []
    for a, b in combinations(range(len(channels)), 2):
        both = np.isfinite(shape[:, a]) & np.isfinite(shape[:, b])
        x, y = np.where(both, shape[:, a], 0.0), np.where(both, shape[:, b], 0.0)
        size, other = np.sum(np.abs(x) ** 2, axis=1), np.sum(np.abs(y) ** 2, axis=1)
        left = size * other - np.abs(np.sum(x.conj() * y, axis=1)) ** 2
        # of one number alone any other is a multiple
        same = (both.sum(axis=1) > 1) & (size * other > 0) & (left <= COPIED * size * other)
        if same.sum() > 1:
            notes.append(f"{channels[a]} and {channels[b]} have the same numbers, but for a factor, in {same.sum()} of "
                         f"{len(shape)} sets, as of one signal that is written twice: leave one of them out, and "
                         "follow their cables")
    return notes


def _used_modes(
    labels: tuple[str, ...], frequency: np.ndarray, shape: np.ndarray, expected_hz: Mapping[str, float] | None
) -> tuple[np.ndarray, list[str]]:
    """Numbers of the modes that are found with every channel often enough, and that the model has where it was asked;
    what to say of the others."""
    notes = []
    complete = np.isfinite(frequency) & np.all(np.isfinite(shape), axis=1)
    kept = np.flatnonzero(complete.mean(axis=0) >= MODE_SHARE)
    if len(kept) < len(labels):
        names = [label for j, label in enumerate(labels) if j not in kept]
        notes.append(f"{', '.join(names)} left out: found with every channel in fewer than a fifth of the blocks")
    if expected_hz is not None and any(labels[j] not in expected_hz for j in kept):
        lost = [labels[j] for j in kept if labels[j] not in expected_hz]
        notes.append(f"{', '.join(lost)} left out: no mode of the model that these sensors see is left for it")
        kept = np.array([j for j in kept if labels[j] in expected_hz], int)
    return kept, notes


def _best_known(seen: np.ndarray) -> np.ndarray:
    """Numbers of the channels with which most numbers are left, of `seen` (n_block, n_channel) bool: a block counts
    with all of them only. One after the other, as long as what is left grows."""
    kept = np.arange(seen.shape[1])[seen.any(axis=0)]
    while len(kept) > 1:
        size = [np.sum(seen[:, np.delete(kept, k)].all(axis=1)) * (len(kept) - 1) for k in range(len(kept))]
        if max(size) <= np.sum(seen[:, kept].all(axis=1)) * len(kept):
            break
        kept = np.delete(kept, int(np.argmax(size)))
    return kept


def _groups(places_hz: np.ndarray, labels: tuple[str, ...], alone: Sequence[str]) -> tuple[tuple[int, ...], ...]:
    """Modes (single ones and pairs, ascending) that are close in any row of `places_hz` (n_place, n_mode), those
    `alone` by themselves."""
    apart, together = _smallest_distances(places_hz), np.flatnonzero([label not in alone for label in labels])
    near = np.eye(len(labels), dtype=bool)
    for row in places_hz:
        for cluster in close_clusters(row[together]):
            near[np.ix_(together[list(cluster)], together[list(cluster)])] = True
    _, number = csgraph.connected_components(near, directed=False)
    parts = [p for q in np.unique(number)
             for p in pairs_of(tuple(map(int, np.flatnonzero(number == q))), apart, labels)]
    return tuple(sorted((tuple(sorted(int(j) for j in p)) for p in parts), key=lambda p: places_hz[0][p[0]]))


def _smallest_distances(places_hz: np.ndarray) -> np.ndarray:
    """(n_mode, n_mode) how far apart (in ln f) each two modes are where they are nearest."""
    log = np.log(places_hz)
    return np.fmin.reduce(np.abs(log[:, :, None] - log[:, None, :]), axis=0)


def pairs_of(cluster: tuple[int, ...], apart: np.ndarray, labels: tuple[str, ...]) -> list[tuple[int, ...]]:
    """A run of close modes as pairs and single modes: torsion, where labels show it, stands by itself, as it mixes with
    bending only where it nearly meets it; a run that is still too long is cut where its modes are farthest apart, of
    `apart` (n_mode, n_mode) the longest link of the shortest chain through all."""
    if len(cluster) <= 2:
        return [tuple(cluster)]
    torsion = [j for j in cluster if labels[j].startswith("T")]
    rest = tuple(j for j in cluster if j not in torsion)
    if torsion and rest:
        return [*((j,) for j in torsion), *pairs_of(rest, apart, labels)]
    # equal modes are a link too
    tree = csgraph.minimum_spanning_tree(apart[np.ix_(cluster, cluster)] + 1e-12).toarray()
    tree[np.unravel_index(np.argmax(tree), tree.shape)] = 0.0
    _, side = csgraph.connected_components(tree, directed=False)
    return [p for k in range(2) for p in
            pairs_of(tuple(j for j, own in zip(cluster, side, strict=True) if own == k), apart, labels)]


def _states_std(modal_set) -> bool:
    """Whether every frequency and shape component that was measured has a standard deviation above zero."""
    if modal_set.covariance_factors is not None:
        return True
    measured = np.isfinite(modal_set.frequency_hz)
    frequency, shape = modal_set.frequency_std_hz[measured], modal_set.shape_std[np.isfinite(modal_set.shape)]
    return bool(np.all(frequency > 0) and np.all(shape >= 0) and (shape.size == 0 or np.any(shape > 0)))


def _states_zero(modal_set) -> bool:
    """Whether a frequency that was measured is without error by its standard deviation, or all that the shapes have: of
    a shape's largest component, which normalises it, zero is right."""
    if modal_set.covariance_factors is not None:
        return False
    frequency = modal_set.frequency_std_hz[np.isfinite(modal_set.frequency_hz)]
    shape = modal_set.shape_std[np.isfinite(modal_set.shape) & np.isfinite(modal_set.shape_std)]
    return bool(np.any(frequency == 0) or (shape.size and not np.any(shape)))


def _factors(modal_set, kept, channels, turn) -> SetFactors | None:
    d = modal_set.covariance_factors
    if d is None:
        if not _states_std(modal_set):
            return None
        return SetFactors(read=partial(_independent, modal_set.frequency_std_hz[kept] / modal_set.frequency_hz[kept],
                                       modal_set.shape_std[np.ix_(channels, kept)]))
    return SetFactors(read=partial(_joint, d, kept, channels, turn))


def _joint(d: CovarianceFactors | StoredFactors, kept, channels, turn) -> tuple[np.ndarray, np.ndarray]:
    d = d.load()
    return d.ln_frequency[kept], d.shape[channels][:, kept] * turn[None, :, None]


def _independent(ln_frequency: np.ndarray, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of a set that states standard deviations alone: every frequency and every part of a component by itself."""
    n, m = len(ln_frequency), shape.size
    spread = (np.eye(m) * np.nan_to_num(shape).ravel()).reshape(*shape.shape, m)
    return (np.hstack([np.diag(np.nan_to_num(ln_frequency)), np.zeros((n, 2 * m))]),
            np.concatenate([np.zeros((*shape.shape, n)), spread, 1j * spread], axis=2))


def _level(y: np.ndarray) -> np.ndarray:
    """What each of a mode's ln f (n_block,) is held against: the record's median, or of a mode that falls and stays
    there, as where all braces of a storey are lost, the median before and after."""
    known = np.flatnonzero(np.isfinite(y))
    if not len(known):
        return y
    one = np.median(y[known])
    least, best, n = LEVEL_LEAVES * np.sum(np.abs(y[known] - one)), None, len(known)
    fewest = max(1 if len(y) < FEWEST else 3, int(np.ceil(LEVEL_SHARE * n)))
    for k in range(fewest, n - fewest + 1):
        before, after = np.median(y[known[:k]]), np.median(y[known[k:]])
        left = np.sum(np.abs(y[known[:k]] - before)) + np.sum(np.abs(y[known[k:]] - after))
        if abs(after - before) > STRAY and left < least:
            least, best = left, (known[k], before, after)
    if best is None:
        return np.full(len(y), one)
    return np.where(np.arange(len(y)) < best[0], best[1], best[2])


def _relative_std(sets, kept, channels, groups) -> np.ndarray:
    """How much worse than usual the identification says each block's group is: mean over frequencies and shapes."""
    frequency = np.array([s.frequency_std_hz for s in sets])[:, kept]
    shape = np.array([s.shape_std for s in sets])[:, channels][:, :, kept]
    with np.errstate(invalid="ignore"):
        size = np.sqrt(np.sum(shape**2, axis=1) / max(len(channels), 1))
    result = np.ones((len(sets), len(groups)))
    for q, group in enumerate(groups):
        parts = []
        for std in (frequency[:, list(group)], size[:, list(group)]):
            known = np.isfinite(std) & (std > 0)
            if known.mean() > 0.5:
                typical = np.array([np.median(column[ok]) for column, ok in zip(std.T, known.T, strict=True)
                                    if ok.any()] or [1.0])
                if len(typical) == std.shape[1]:
                    parts.append(np.where(known, std / typical, 1.0))
        if parts:
            result[:, q] = np.clip(np.mean(np.concatenate(parts, axis=1), axis=1), 1 / 3, 3.0)
    return result


def with_derived(blocks: Blocks) -> Blocks:
    """Adds to every block's environment what follows from it: share of rated thrust, degrees of frost."""
    environment = []
    power, wind = blocks.numbers("power_kw"), blocks.numbers("wind_speed_mps")
    with np.errstate(invalid="ignore", divide="ignore"):
        thrust = np.maximum(power, 0) / np.maximum(wind, 1.0)
    highest = np.nanmax(thrust) if np.isfinite(thrust).any() else np.nan
    for k, old in enumerate(blocks.environment):
        new = dict(old)
        if highest > 0 and np.isfinite(thrust[k]):
            new["thrust_share"] = float(thrust[k] / highest)
        air = old.get("air_temperature_c")
        if isinstance(air, int | float):
            new["frost_degc"] = max(0.0, -float(air))
        environment.append(new)
    return replace(blocks, environment=tuple(environment))
