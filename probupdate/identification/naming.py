"""The campaign's modes get their names: the model's modes of interest where they match, numbers otherwise."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar, overload

import numpy as np

from probupdate.campaign.reading import Campaign
from probupdate.identification.classification import ClassifierSettings
from probupdate.identification.counterparts import MatchedModes, match_modes, records_of
from probupdate.identification.environment import fore_aft_deg
from probupdate.identification.physical import PhysicalModes, stays
from probupdate.identification.reference import ReferenceModes, turn_reference
from probupdate.identification.tracking import Choice
from probupdate.io.result_table import plural
from probupdate.modal.joined_modes import columns_of, frequencies_around, joined_mode_words, modes_with_two_numbers
from probupdate.modal.modes import ModalSet, ModelMode, ModeRecord

T = TypeVar("T")


@dataclass(frozen=True, eq=False, kw_only=True)
class NamedModes:
    """names: of every physical mode, '' for one that is left out; columns: of the result, by place among the physical
    modes, -1 for a mode of interest that was not found; labels, records and sets of the columns; mode_in_column (n_set,
    n_column): of each set the place among the physical modes, as one that changed amid the record has two."""

    names: tuple[str, ...]
    columns: tuple[int, ...]
    labels: tuple[str, ...]
    records: tuple[ModeRecord, ...]
    model_only: tuple[ModelMode, ...]
    notes: tuple[str, ...]
    sets: list[ModalSet]
    mode_in_column: np.ndarray


def name_modes(
    sets: list[ModalSet], physical: PhysicalModes, reference: ReferenceModes | None, others: ReferenceModes | None,
    campaign: Campaign | None, *, settings: ClassifierSettings, highest_hz: float, every: bool,
) -> NamedModes:
    """The campaign's modes matched with the model's, once, and given their names. highest_hz: up to where modes of the
    model can be missed; every: a column for each mode, also for one that stands in no block."""
    n_mode = len(physical.modes.labels)
    # a pair that turns with the nacelle is found in one direction before it turns and in another one after it; modes of
    # several setups are those of all of them
    turns = any("nacelle_angle_deg" in s.environment for s in sets)
    two = [] if turns or every else modes_with_two_numbers(sets)
    mode_in_column = columns_of(len(sets), n_mode, {(a, b, k): a for a, b, k in two})
    sets = [s.of_modes(own) for s, own in zip(sets, mode_in_column.tolist(), strict=True)]
    seconds = None if campaign is None else 60 * campaign.block_minutes
    seen, notes = _steady_modes(sets, physical, every, {b for _, b, _ in two}, seconds)
    wanted: tuple[str, ...] = ()
    matched = None
    if reference is not None and campaign is not None:
        wanted = reference.labels
        model = reference if others is None else reference.join(others)
        matched = _match_modes(sets, physical, seen, model, len(wanted), campaign)
    columns, labels = _columns(seen, wanted, matched)
    own = [s.of_modes(columns) for s in sets]
    in_pair = {i for pair in physical.modes.pairs for i in pair}
    pair_columns = {k for k, j in enumerate(columns) if j in in_pair}
    records, lacking, said = records_of(
        own, labels, None if matched is None else matched.select(columns), in_pair=pair_columns, settings=settings,
        highest_hz=highest_hz, wanted=wanted)
    name = dict(zip(columns, labels, strict=True))
    name |= {b: name[a] for a, b, _ in two if a in name}
    for change in sorted({k for _, _, k in two}):
        those = [pair for pair in two if pair[2] == change and pair[0] in name]
        around = [frequencies_around(sets, (a, a, k)) for a, _, k in those]
        if those:
            notes.append(f"from {sets[change].id} on {', '.join(name[a] for a, _, _ in those)} found "
                         f"{joined_mode_words(around)}")
    return NamedModes(names=tuple(name.get(j, "") for j in range(n_mode)), columns=columns, labels=labels,
                      records=records, model_only=lacking, notes=(*notes, *said), sets=own,
                      mode_in_column=np.where(np.array(columns) < 0, -1, mode_in_column[:, list(columns)]))


def _steady_modes(
    sets: list[ModalSet], physical: PhysicalModes, every: bool, joined: Collection[int],
    block_seconds: float | None,
) -> tuple[np.ndarray, list[str]]:
    """(n_mode,) bool: modes that stand in two blocks, or in the only one, and do not jump from block to block, with
    `every` all; what to say of the others. `joined`: those that stand in the column of another."""
    n_mode = len(physical.modes.labels)
    measured = np.array([s.measured for s in sets])
    seen = measured.sum(axis=0) >= min(2, int(measured.any(axis=1).sum())) if measured.any() else np.zeros(n_mode, bool)
    jumps = np.zeros(n_mode, bool)
    in_pair = {i for pair in physical.modes.pairs for i in pair}
    for j in set(range(n_mode)) - in_pair if block_seconds else ():
        steps = np.diff([np.log(s.frequency_hz[j]) for s in sets if s.measured[j]])
        jumps[j] = not stays(steps, physical.modes.frequency_hz[j], physical.damping_ratio[j], block_seconds)
    seen = np.ones(n_mode, bool) if every else seen & ~jumps
    seen[list(joined)] = False
    # the other direction of a single mode that turns with the nacelle is not a mode that was lost
    mated = np.zeros(n_mode, bool)
    mated[list(joined)] = True
    for pair in physical.modes.turning or ():
        mated[list(pair)] = seen[list(pair)].any()
    return seen, [f"{f:.4g} Hz comes back but is found as a mode in {plural(int(n), 'block')}"
                  + (", at other frequencies from block to block" if jump else "") + ": left out"
                  for f, n, jump, kept in zip(physical.modes.frequency_hz, measured.sum(axis=0), jumps, seen | mated,
                                              strict=True) if not kept]


def _match_modes(
    sets: list[ModalSet], physical: PhysicalModes, seen: np.ndarray, model: ReferenceModes, sought: int,
    campaign: Campaign,
) -> MatchedModes:
    # asked for some hundred blocks, of each mode for nearly the same
    at_block = lru_cache(maxsize=512)(
        lambda k: turn_reference(model, campaign.sensors, fore_aft_deg(sets[k].environment, campaign)))
    pairs = [pair for pair in physical.modes.pairs if seen[list(pair)].all()]
    shown = [s.of_modes(np.where(seen, np.arange(len(seen)), -1).tolist()) for s in sets]
    return match_modes(shown, pairs, _Lazy(at_block, len(sets)), model, sought)


def _columns(
    seen: np.ndarray, wanted: tuple[str, ...], matched: MatchedModes | None
) -> tuple[tuple[int, ...], tuple[str, ...]]:
    """Columns of the result, the modes of interest before the numbered ones: place among the physical modes, -1 where
    one was not found; and their labels."""
    label_of: dict[int, str] = {}
    if matched is not None:
        model_labels = matched.model.labels
        label_of = {j: model_labels[i] for j, i in matched.partner.items() if model_labels[i] in wanted}
    place = {label: j for j, label in label_of.items()}
    rest = [j for j in range(len(seen)) if seen[j] and j not in label_of]
    numbers = (str(len(wanted) + k + 1) for k in range(len(rest)))
    return (*(place.get(label, -1) for label in wanted), *rest), (*wanted, *numbers)


class _Lazy(Sequence[T]):
    """What a function gives for 0, 1, ..., made when it is asked for."""

    def __init__(self, function: Callable[[int], T], count: int):
        self._function, self._count = function, count

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, number: int) -> T: ...

    @overload
    def __getitem__(self, number: slice) -> Sequence[T]: ...

    def __getitem__(self, number: int | slice) -> T | Sequence[T]:
        if isinstance(number, slice):
            return [self._function(k) for k in range(self._count)[number]]
        return self._function(range(self._count)[number])


def with_independence(s: ModalSet, choice: Choice, names: tuple[str, ...], modes: ReferenceModes) -> dict:
    """The set's conditions, and how far the two poles of each pair are apart in their plane, under the names that the
    pair got."""
    known = {}
    for g, group in enumerate(modes.groups):
        # what is one mode, before and after a change, is not a pair
        if len(group) > 1 and all(names[i] for i in group) and len({names[i] for i in group}) == len(group):
            # fore-aft first, and numbers ascending
            known["independence_" + "_".join(sorted(names[i] for i in group))] = float(choice.independence[g])
    return dict(s.environment) | known
