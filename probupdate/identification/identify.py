"""A campaign's modes: poles of every block kept in a store, classified, gathered into one modal set a block."""

from __future__ import annotations

import re
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar, overload

import numpy as np
import pandas as pd

from probupdate.campaign.reading import Campaign
from probupdate.campaign.scada import StateRule, block_conditions, with_rated_power
from probupdate.campaign.usable import remedy
from probupdate.errors import InputError
from probupdate.identification import classification as rules
from probupdate.identification import tracking
from probupdate.identification.block_poles import (
    STAY,
    TAKEN_OUT,
    BlockPoles,
    BlockSettings,
    common_quantity,
)
from probupdate.identification.block_store import BlockStore
from probupdate.identification.classification import ClassifierSettings, PoleComparison, PoleStack
from probupdate.identification.counterparts import (
    ModelComparison,
    mode_records,
    model_comparison,
    model_only,
    paired,
    sentences,
)
from probupdate.identification.physical import (
    PersistenceSettings,
    PhysicalModes,
    block_candidates,
    evenly,
    gathered,
    physical_modes,
)
from probupdate.identification.preprocessing import PASS_SHARE
from probupdate.identification.reference import ReferenceModes, turned
from probupdate.identification.tracking import Choice, JudgedPoles, Tracked
from probupdate.io.files import write_table
from probupdate.io.result_table import plural, table_of
from probupdate.modal.labels import TURBINE, family
from probupdate.modal.modes import (
    CovarianceFactors,
    ModalData,
    ModalSet,
    ModelMode,
    ModeRecord,
    StoredFactors,
    unit_largest,
    write_modes,
)
from probupdate.runtime.arrays import frozen_array
from probupdate.runtime.executors import Executor, Shard, executor
from probupdate.runtime.progress import Progress, silent

if TYPE_CHECKING:
    import xarray

# the broad-band amplitude of a block goes by the unit of what was measured
AMPLITUDE = {"acceleration": "rms_mps2", "velocity": "rms_mps", "displacement": "rms_m"}
NOTHING = frozen_array(np.zeros(0))

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class SSISettings(BlockSettings):
    """`BlockSettings` are what the stored poles depend on; the classifier works on stored poles, of the orders from
    `below` under `order` upwards."""

    classifier: ClassifierSettings = field(default_factory=ClassifierSettings)
    below: int = 8

    @property
    def of_blocks(self) -> BlockSettings:
        return BlockSettings(order=self.order, block_rows=self.block_rows, target_rate_hz=self.target_rate_hz,
                             spread=self.spread, sub_records=self.sub_records, harmonics=self.harmonics)


@dataclass(frozen=True, eq=False, kw_only=True)
class Identification:
    """data: a modal set a block, NaN where a mode was not found, with a record of each mode: where it was found and
    what it is in the model; poles: every pole with its criterion.

    poles has the columns time (UTC, start of the block), frequency_hz, damping_ratio, mpc, mac and mode (best single
    MAC to the model's modes of interest and that mode; for a kept pole the mode it was taken for), similarity (to the
    campaign's modes, S2MAC to a pair's plane), stability, criterion, paper_criterion, order; those of the chosen order,
    and those of other orders that stand for a mode. centre_hz: label -> median frequency of the mode's path; tracked:
    the paths of the campaign's modes, '' one that was left out, a row an identified block.
    """

    data: ModalData
    poles: pd.DataFrame
    settings: SSISettings
    centre_hz: dict[str, float]
    tracked: Tracked
    notes: tuple[str, ...]
    summary: str

    def to_frame(self) -> pd.DataFrame:
        """A row a set and mode."""
        return self.data.to_frame()

    def to_xarray(self) -> xarray.Dataset:
        """The sets as an xarray dataset (`ModalData.to_xarray`)."""
        return self.data.to_xarray()

    def write(self, out: str | Path) -> list[Path]:
        """modes.json, modes.deviations.h5 where there are covariance factors, and modes.poles.csv beside it."""
        out = Path(out)
        table = out.with_name(f"{out.stem}.poles.csv")
        write_modes(self.data, out)
        written = self.poles.assign(time=self.poles["time"].dt.strftime("%Y-%m-%dT%H:%M:%SZ"))
        write_table(table, written)
        beside = [out.with_name(f"{out.stem}.deviations.h5")] if any(s.covariance_factors
                                                                     for s in self.data.sets) else []
        return [out, *beside, table]


def identify(
    campaign: Campaign,
    reference: ReferenceModes | None,
    *,
    others: ReferenceModes | None = None,
    settings: SSISettings | None = None,
    state_rule: StateRule | None = None,
    store: str | Path | None = None,
    jobs: int | Executor = 1,
    progress: Progress = silent,
) -> Identification:
    """Identify every block of the campaign by SSI-cov, find the modes that its poles come back at, whatever the model,
    and name them by the model's: `reference` its modes of interest, each a column of the result, `others` more of them.

    A mode without a counterpart among those of interest has a number; without a reference all have. store: folder in
    which the poles of each block are kept as they are found; a run that was killed goes on there, and another model
    takes the poles from there, and the result reads its covariance factors there when asked for them, so that a year
    fits into memory. None: blocks are kept while this runs. jobs: processes, or an executor; the modes are the same on
    any. Raises InputError where no block can be used, and where nothing comes back.
    """
    settings = settings or SSISettings()
    if reference is not None and reference.shape.shape[0] != len(campaign.sensors):
        raise InputError("reference modes", f"have {reference.shape.shape[0]} channels, the campaign "
                         f"{len(campaign.sensors)}", "compute the model's shapes at the campaign's sensors")
    rule = state_rule or StateRule(rated_power_kw=campaign.rated_power_kw)
    rule = with_rated_power(rule, campaign.scada)
    with tempfile.TemporaryDirectory() if store is None else nullcontext(store) as folder, executor(jobs) as runs:
        blocks = BlockStore(folder, campaign, settings.of_blocks)
        blocks.fill(jobs=runs, progress=progress)
        found = physical_of(blocks, campaign, settings=settings, rule=rule, progress=progress)
        result = classified(blocks, campaign, found, reference, others=others, settings=settings, rule=rule, jobs=runs,
                            progress=progress)
        return in_memory(result) if store is None else result


@dataclass(frozen=True, kw_only=True)
class ShardOfBlocks:
    """What a shard of an identification did: blocks and standard deviations that it computed, blocks of the campaign
    without poles yet, and those whose chosen poles still lack standard deviations (None until all poles are there)."""

    shard: Shard
    identified: int
    with_std: int
    n_block: int
    left: int
    left_std: int | None

    def to_frame(self) -> pd.DataFrame:
        """One row: the shard and what it did."""
        return table_of([{"shard": str(self.shard), "identified": self.identified, "with_std": self.with_std,
                          "blocks": self.n_block, "left": self.left, "left_std": self.left_std}])

    @property
    def summary(self) -> str:
        text = f"shard {self.shard}: {self.identified} blocks identified"
        if self.left:
            return (f"{text}; {self.n_block - self.left} of {self.n_block} are there. When all are, the same command "
                    "computes this shard's standard deviations")
        text += f", standard deviations of {self.with_std}; all {self.n_block} blocks have poles"
        if self.left_std:
            return f"{text}, {self.left_std} lack standard deviations: the other shards' commands once more"
        return f"{text} and standard deviations: the command without --shard writes the modes"


def identify_shard(
    campaign: Campaign,
    shard: Shard,
    *,
    settings: SSISettings | None = None,
    state_rule: StateRule | None = None,
    store: str | Path,
    jobs: int | Executor = 1,
    progress: Progress = silent,
) -> ShardOfBlocks:
    """One shard's blocks of what `identify` computes, into the store that all shards share: their poles, and where all
    blocks' poles are there the standard deviations of those chosen. No model is asked; `identify` on the store ends it.
    """
    settings = settings or SSISettings()
    rule = with_rated_power(state_rule or StateRule(rated_power_kw=campaign.rated_power_kw), campaign.scada)
    with executor(jobs) as runs:
        blocks = BlockStore(store, campaign, settings.of_blocks)
        identified = blocks.fill(jobs=runs, shard=shard, progress=progress)
        n_left, done, n_without = len(blocks.pending()), 0, None
        if not n_left:
            found = physical_of(blocks, campaign, settings=settings, rule=rule, progress=progress)
            first = _followed(blocks, campaign, found, None, settings=settings, rule=rule, progress=progress)
            wanted = _all_wanted(first.picked) if settings.sub_records else {}
            done = blocks.fill_factors(wanted, jobs=runs, shard=shard, progress=progress)
            n_without = blocks.without_factors(wanted)
    return ShardOfBlocks(shard=shard, identified=identified, with_std=done, n_block=len(blocks.starts),
                         left=n_left, left_std=n_without)


def physical_of(
    blocks: BlockStore, campaign: Campaign, *, settings: SSISettings, rule: StateRule, progress: Progress = silent,
) -> PhysicalModes:
    """The modes that stored poles come back at. Raises InputError where no block can be used."""
    persistence = PersistenceSettings()
    usable, states, reason = [], [], ""
    for start in blocks.starts:
        block = blocks.read(start)
        if block.poles is None:
            reason = reason or block.excluded
            continue
        usable.append(start)
        states.append(str(_environment(block, campaign, rule).get("state", "unknown")))
    if not usable:
        raise InputError(str(campaign.path), f"none of {len(blocks.starts)} blocks can be used; the first: {reason}",
                         remedy(campaign))
    parts, bands, angles, waves, state = [], [], [], [], []
    chosen = evenly(states)
    for number, k in enumerate(chosen):
        progress("classifying modes", number, len(chosen))
        block = blocks.read(usable[k])
        environment = _environment(block, campaign, rule)
        parts.append(block_candidates(pole_stack(block, settings), number, settings.classifier, persistence))
        bands.append(rules.rotor_bands(environment, settings.classifier))
        angles.append(environment.get("nacelle_angle_deg", np.nan))
        period = environment.get("wave_period_s")
        waves.append(1 / float(period) if period is not None and float(period) > 0 else np.nan)
        state.append(states[k])
    progress("classifying modes", len(chosen), len(chosen))
    return physical_modes(
        gathered(parts), n_block=len(chosen), settings=persistence, state=state, bands=bands, wave_hz=waves,
        angle_deg=angles, sensors=campaign.sensors, block_seconds=60 * campaign.block_minutes,
        highest_hz=passed_hz(campaign, settings), where=str(campaign.path))


def passed_hz(campaign: Campaign, settings: SSISettings) -> float:
    """Up to where a record at the rate of identification is as it was measured."""
    thinned = settings.target_rate_hz < campaign.sampling_rate_hz * (1 - 1e-9)
    return (PASS_SHARE if thinned else 1.0) * settings.target_rate_hz / 2


def classified(
    blocks: BlockStore,
    campaign: Campaign,
    physical: PhysicalModes,
    reference: ReferenceModes | None,
    *,
    settings: SSISettings,
    rule: StateRule,
    others: ReferenceModes | None = None,
    every: bool = False,
    jobs: int | Executor = 1,
    progress: Progress = silent,
) -> Identification:
    """The second pass: from stored poles to the modes that were found in them, their standard deviations, and their
    names. every: a column for each, also for one that stands in no block (one setup of several)."""
    first = _followed(blocks, campaign, physical, reference, settings=settings, rule=rule, progress=progress)
    found, usable, followed, picked = first.found, first.usable, first.tracked, dict(first.picked)
    if settings.sub_records:
        picked |= _without_uncertain(blocks, first, settings.classifier, jobs, progress)
        followed = replace(followed, choices=tuple(picked[one.block.start].choice for one in usable))
    sets = [_modal_set(one, picked.get(one.block.start), physical.modes) for one in found]
    named = _named(sets, physical, reference, others, campaign, settings, every)
    del sets
    sets = []
    for s, one in zip(named.sets, found, strict=True):
        stands = picked.get(one.block.start)
        if stands is None:
            sets.append(s)
            continue
        covariance_factors = None
        if stands.keys and settings.sub_records:
            keys = tuple(stands.key_of.get(int(j)) for j in named.columns)
            covariance_factors = StoredFactors(read=partial(_covariance_factors, blocks, one.block.start, keys))
        sets.append(replace(s, environment=_with_independence(s, stands.choice, named.names, physical.modes),
                            covariance_factors=covariance_factors))
    data = ModalData(channels=campaign.channels, sets=tuple(sets), labels=named.labels, records=named.records,
                     model_only=named.model_only)
    poles = _pole_table(usable, [picked[one.block.start].rows for one in usable], named.names, reference)
    remarks = [f"{b.id}: {text}" for b in (one.block for one in found) for text in (*b.notes, b.excluded) if text]
    said = (*physical.notes, *named.notes)
    centre = np.median(followed.centre_hz, axis=0)
    return Identification(
        data=data, poles=poles, settings=settings,
        centre_hz={label: float(centre[k]) if k >= 0 else np.nan
                   for label, k in zip(named.labels, named.columns, strict=True)},
        tracked=replace(followed, labels=named.names),
        notes=(*said, *remarks),
        summary="\n".join([_summary(found, data, poles, campaign, rule), *said]),
    )


def in_memory(identification: Identification) -> Identification:
    """The same with its covariance factors in memory, before the store goes that they are read from."""
    sets = tuple(s if s.covariance_factors is None else replace(s, covariance_factors=s.covariance_factors.loaded())
                 for s in identification.data.sets)
    return replace(identification, data=replace(identification.data, sets=sets))


@dataclass(frozen=True, eq=False, kw_only=True)
class _Followed:
    """Every block, those that can be used, the modes' paths through these, what stands for the modes in each by its
    start, and how a block's stored poles are judged once more."""

    found: list[_Found]
    usable: list[_Found]
    tracked: Tracked
    picked: dict[pd.Timestamp, _Picked]
    judge: Callable[[_Found], _Judged]
    order: int


def _followed(
    blocks: BlockStore, campaign: Campaign, physical: PhysicalModes, reference: ReferenceModes | None, *,
    settings: SSISettings, rule: StateRule, progress: Progress,
) -> _Followed:
    # a year's poles are gigabytes: a block is held against the modes twice, for its votes and for its choice
    judge = partial(_held_against, blocks, campaign, physical.modes, reference, settings)
    found, votes = [], []
    for number, start in enumerate(blocks.starts):
        progress("classifying modes", number, 2 * len(blocks.starts))
        block = blocks.read(start)
        slim = replace(block, poles=None, others=(), line_hz=NOTHING, spectrum=NOTHING)
        one = _Found(block=slim, environment=_environment(block, campaign, rule), usable=block.poles is not None)
        found.append(one)
        if one.usable:
            votes.append(tracking.votes_of(judge(one, block).poles, settings.classifier))
    usable = [one for one in found if one.usable]
    centre, support = tracking.paths(votes, physical.modes, settings.classifier)
    del votes
    picked = {}
    for number, (one, row) in enumerate(zip(usable, centre, strict=True)):
        progress("classifying modes", len(found) + number, len(found) + len(usable))
        judged = judge(one)
        choice = tracking.choose(judged.poles, row, settings.classifier)
        picked[one.block.start] = _picked(judged, choice, settings.order)
    progress("classifying modes", 2 * len(blocks.starts), 2 * len(blocks.starts))
    tracked = Tracked(labels=physical.modes.labels, choices=tuple(stands.choice for stands in picked.values()),
                      centre_hz=frozen_array(centre), support=frozen_array(support))
    return _Followed(found=found, usable=usable, tracked=tracked, picked=picked, judge=judge, order=settings.order)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Named:
    """names: of every physical mode, '' for one that is left out; columns: of the result, by place among the physical
    modes, -1 for a mode of interest that was not found; labels, records and sets of the columns."""

    names: tuple[str, ...]
    columns: tuple[int, ...]
    labels: tuple[str, ...]
    records: tuple[ModeRecord, ...]
    model_only: tuple[ModelMode, ...]
    notes: tuple[str, ...]
    sets: list[ModalSet]


class _Each(Sequence[T]):
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


def _named(
    sets: list[ModalSet], physical: PhysicalModes, reference: ReferenceModes | None, others: ReferenceModes | None,
    campaign: Campaign, settings: SSISettings, every: bool,
) -> _Named:
    """The campaign's modes matched with the model's, once, and given their names."""
    n_mode = len(physical.modes.labels)
    seen, notes = _seen(sets, physical, every)
    wanted: tuple[str, ...] = ()
    matched = None
    if reference is not None:
        wanted = reference.labels
        matched = _matched(sets, physical, seen, reference if others is None else reference.joined(others), campaign)
    columns, labels = _columns(seen, wanted, matched)
    own = [s.of_modes(columns) for s in sets]
    in_pair = {i for pair in physical.modes.pairs for i in pair}
    pair_columns = {k for k, j in enumerate(columns) if j in in_pair}
    if matched is None:
        records, lacking = mode_records(own, labels, like=None, partner={}, probability=None, model=None,
                                        in_pair=pair_columns, settings=settings.classifier), ()
    else:
        at = list(columns)
        records = mode_records(
            own, labels, like=matched.like.at(columns),
            partner={k: matched.partner[j] for k, j in enumerate(columns) if j in matched.partner},
            probability=matched.probability[at] * (np.array(at) >= 0)[:, None], model=matched.model,
            in_pair=pair_columns, settings=settings.classifier)
        lacking = model_only(matched.model, matched.partner, [r.frequency_hz for r in records if r.found],
                             passed_hz(campaign, settings), wanted)
        notes += sentences(records, lacking, wanted)
    name = dict(zip(columns, labels, strict=True))
    return _Named(names=tuple(name.get(j, "") for j in range(n_mode)), columns=columns, labels=labels, records=records,
                  model_only=lacking, notes=tuple(notes), sets=own)


def _seen(sets: list[ModalSet], physical: PhysicalModes, every: bool) -> tuple[np.ndarray, list[str]]:
    """(n_mode,) bool: modes that stand in two blocks, or in the only one, with `every` all; what to say of the
    others."""
    n_mode = len(physical.modes.labels)
    measured = np.array([s.measured for s in sets])
    seen = measured.sum(axis=0) >= min(2, int(measured.any(axis=1).sum())) if measured.any() else np.zeros(n_mode, bool)
    seen = np.ones(n_mode, bool) if every else seen
    # the other direction of a single mode that turns with the nacelle is no mode that was lost
    mated = np.zeros(n_mode, bool)
    for pair in physical.modes.turning or ():
        mated[list(pair)] = seen[list(pair)].any()
    return seen, [f"{f:.4g} Hz comes back but is found as a mode in {plural(int(n), 'block')}: left out"
                  for f, n, kept in zip(physical.modes.frequency_hz, measured.sum(axis=0), seen | mated, strict=True)
                  if not kept]


@dataclass(frozen=True, eq=False, kw_only=True)
class _Matched:
    """The campaign's modes held against a model's: similarities, mode -> the model's mode, probability (n_mode,
    n_model)."""

    model: ReferenceModes
    like: ModelComparison
    partner: dict[int, int]
    probability: np.ndarray


def _matched(
    sets: list[ModalSet], physical: PhysicalModes, seen: np.ndarray, model: ReferenceModes, campaign: Campaign
) -> _Matched:
    # asked for some hundred blocks, of each mode for nearly the same
    at_block = lru_cache(maxsize=512)(
        lambda k: turned(model, campaign.sensors, fore_aft_deg(sets[k].environment, campaign)))
    pairs = [pair for pair in physical.modes.pairs if seen[list(pair)].all()]
    like = model_comparison([s.of_modes(np.where(seen, np.arange(len(seen)), -1).tolist()) for s in sets], pairs,
                            _Each(at_block, len(sets)))
    partner, probability = paired(like, model)
    return _Matched(model=model, like=like, partner=partner, probability=probability)


def _columns(
    seen: np.ndarray, wanted: tuple[str, ...], matched: _Matched | None
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


def modal_data(identification: Identification) -> ModalData:
    """What `modes.json` holds: a set a block."""
    return identification.data


def fore_aft_deg(environment: Mapping, campaign: Campaign) -> float:
    """Counter-clockwise angle from the model's x axis to where the nacelle looks; 0 where no heading was recorded."""
    heading = environment.get("nacelle_heading_deg")
    return 0.0 if heading is None else campaign.x_axis_heading_deg - float(heading)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Found:
    """A stored block without its poles and its spectrum, which stay on the disk; usable: it was not excluded."""

    block: BlockPoles
    environment: dict
    usable: bool


@dataclass(frozen=True, eq=False, kw_only=True)
class _Judged:
    """A block's poles held against the campaign's modes, which are turned to where the nacelle looked; `single` and
    `paper` as the paper has it, against the model as it is (without a model, against the campaign's modes)."""

    poles: JudgedPoles
    single: PoleComparison
    paper: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class _Picked:
    """What is kept of a block's poles: the choice; of the poles that stand for modes frequency_hz, damping_ratio
    (n_mode,), shape (n_channel, n_mode), NaN where none does; keys: (model order, index within its poles) -> place in
    the block's stack; key_of: mode -> key; rows of the table of poles, the mode as its number."""

    choice: Choice
    frequency_hz: np.ndarray
    damping_ratio: np.ndarray
    shape: np.ndarray
    keys: dict[tuple[int, int], int]
    rows: dict[str, np.ndarray]

    @property
    def key_of(self) -> dict[int, tuple[int, int]]:
        place = {pole: key for key, pole in self.keys.items()}
        return {int(j): place[int(p)] for j, p in enumerate(self.choice.pole) if p >= 0}


def pole_stack(block: BlockPoles, settings: SSISettings) -> PoleStack:
    own = block.every_order[:1]
    return rules.stacked((*own, *(p for p in block.others if p.order >= settings.order - settings.below)))


def _held_against(
    blocks: BlockStore, campaign: Campaign, modes: ReferenceModes, model: ReferenceModes | None, settings: SSISettings,
    one: _Found, block: BlockPoles | None = None,
) -> _Judged:
    """`block` if it was read already."""
    block = block or blocks.read(one.block.start)
    stack = pole_stack(block, settings)
    here = turned(modes, campaign.sensors, fore_aft_deg(one.environment, campaign))
    like = rules.comparison(stack, here)
    bands = rules.rotor_bands(one.environment, settings.classifier)
    judged = JudgedPoles(
        id=block.id, poles=stack, comparison=like, bands=bands, reference=here,
        verdict=rules.block_criteria(stack, like, here, settings.classifier),
    )
    single = like if model is None else rules.comparison(stack, model, like.stability)
    return _Judged(poles=judged, single=single, paper=rules.paper_criteria(stack, single, bands, settings.classifier))


def _without_uncertain(
    blocks: BlockStore, first: _Followed, settings: ClassifierSettings, jobs: int | Executor, progress: Progress,
) -> dict[pd.Timestamp, _Picked]:
    """What stands again in blocks where a chosen pole's standard deviations are beyond the classifier's limits, by
    start.

    Standard deviations are computed of chosen poles only; each round takes poles away, so that it ends.
    """
    place = {one.block.start: k for k, one in enumerate(first.usable)}
    known: dict[pd.Timestamp, dict[int, tuple[float, float]]] = {}
    todo, again = dict(first.picked), {}
    while todo:
        wanted = _all_wanted(todo)
        blocks.fill_factors(wanted, jobs=jobs, progress=progress)
        before, todo = todo, {}
        for start in wanted:
            kept, found = blocks.read_factors(start), {}
            for key, pole in before[start].keys.items():
                row = kept.key.index(key)
                found[pole] = (float(np.linalg.norm(kept.ln_frequency[row])),
                               float(np.linalg.norm(kept.damping_ratio[row])))
            if all(f <= settings.frequency_std and zeta <= settings.damping_std for f, zeta in found.values()):
                continue
            known[start] = known.get(start, {}) | found
            judged = first.judge(first.usable[place[start]])
            std = np.full((2, len(judged.poles.poles.order)), np.nan)
            std[:, list(known[start])] = np.array(list(known[start].values())).T
            verdict = rules.block_criteria(judged.poles.poles, judged.poles.comparison, judged.poles.reference,
                                           settings,
                                           ln_frequency_std=std[0], damping_std=std[1])
            judged = replace(judged, poles=replace(judged.poles, verdict=verdict))
            choice = tracking.choose(judged.poles, first.tracked.centre_hz[place[start]], settings)
            again[start] = todo[start] = _picked(judged, choice, first.order)
    return again


def _all_wanted(picked: Mapping[pd.Timestamp, _Picked]) -> dict[pd.Timestamp, tuple[tuple[int, int], ...]]:
    """Start of a block -> keys of the poles that stand for modes in it, of blocks that have any."""
    return {start: tuple(stands.keys) for start, stands in picked.items() if stands.keys}


def _picked(judged: _Judged, choice: Choice, chosen_order: int) -> _Picked:
    poles, like = judged.poles.poles, judged.poles.comparison
    n_mode = len(choice.pole)
    frequency, damping = np.full(n_mode, np.nan), np.full(n_mode, np.nan)
    shape = np.full((len(poles.shape), n_mode), np.nan + 0j)
    there = np.flatnonzero(choice.pole >= 0)
    taken = choice.pole[there]
    frequency[there], damping[there] = poles.frequency_hz[taken], poles.damping_ratio[taken]
    shape[:, there] = unit_largest(poles.shape[:, taken])
    keys = {(int(poles.order[p]), int(p - np.argmax(poles.order == poles.order[p]))): int(p) for p in taken}
    # the number of the mode that a pole stands for, else of the one that it is most like, marked by a minus
    mode = -1 - judged.single.best_mode
    mode[taken] = there
    shown = (poles.order == chosen_order) | (choice.criterion == rules.KEPT)
    rows = {
        "frequency_hz": poles.frequency_hz, "damping_ratio": poles.damping_ratio, "mpc": like.mpc,
        "mac": judged.single.best_mac, "mode": mode, "similarity": like.similarity.max(axis=1),
        "stability": like.stability, "criterion": choice.criterion, "paper_criterion": judged.paper,
        "order": poles.order,
    }
    return _Picked(choice=choice, frequency_hz=frequency, damping_ratio=damping, shape=shape, keys=keys,
                   rows={name: value[shown] for name, value in rows.items()})


def _covariance_factors(blocks: BlockStore, start: pd.Timestamp,
                        keys: Sequence[tuple[int, int] | None]) -> CovarianceFactors:
    """Columns of the modes whose poles are named by `keys`; NaN for one that was not found."""
    kept = blocks.read_factors(start)
    n_mode, n_column = len(keys), kept.ln_frequency.shape[1]
    ln_frequency, damping = (np.full((n_mode, n_column), np.nan) for _ in range(2))
    shape = np.full((kept.shape.shape[0], n_mode, n_column), np.nan + 0j)
    for mode, key in enumerate(keys):
        if key is not None:
            row = kept.key.index(key)
            ln_frequency[mode], damping[mode] = kept.ln_frequency[row], kept.damping_ratio[row]
            shape[:, mode] = kept.shape[:, row]
    return CovarianceFactors(ln_frequency=ln_frequency, damping_ratio=damping, shape=shape)


def _environment(block: BlockPoles, campaign: Campaign, rule: StateRule) -> dict:
    conditions = dict(block_conditions(campaign.scada, block.start, block.minutes, rule))
    conditions["block_minutes"] = block.minutes
    if np.isfinite(block.rms):
        conditions[AMPLITUDE[block.quantity]] = block.rms
    if conditions.get("nacelle_heading_deg") is not None:
        # relative to the model's axes, so that a model can be turned to it without the campaign at hand
        conditions["nacelle_angle_deg"] = (fore_aft_deg(conditions, campaign) + 180.0) % 360.0 - 180.0
    if block.excluded:
        conditions["excluded"] = block.excluded
    of_harmonics = [note for note in block.notes if note.startswith((TAKEN_OUT, STAY))]
    if of_harmonics:
        conditions["harmonics"] = of_harmonics[0]
    return conditions


def _modal_set(one: _Found, stands: _Picked | None, reference: ReferenceModes) -> ModalSet:
    """A column a mode of the campaign, without standard deviations."""
    n_channel, n_mode = reference.shape.shape
    nothing = np.full(n_mode, np.nan)
    return ModalSet(
        id=one.block.id, frequency_hz=nothing if stands is None else stands.frequency_hz,
        damping_ratio=nothing if stands is None else stands.damping_ratio,
        shape=np.full((n_channel, n_mode), np.nan + 0j) if stands is None else stands.shape,
        frequency_std_hz=nothing, shape_std=np.full((n_channel, n_mode), np.nan), environment=one.environment)


def _with_independence(s: ModalSet, choice: Choice, names: tuple[str, ...], modes: ReferenceModes) -> dict:
    """The set's conditions, and how far the two poles of each pair are apart in their plane, under the names that the
    pair got."""
    known = {}
    for g, group in enumerate(modes.groups):
        if len(group) > 1 and all(names[i] for i in group):
            # fore-aft first, and numbers ascending
            known["independence_" + "_".join(sorted(names[i] for i in group))] = float(choice.independence[g])
    return dict(s.environment) | known


def _pole_table(
    usable: Sequence[_Found], rows: Sequence[Mapping[str, np.ndarray]], names: tuple[str, ...],
    model: ReferenceModes | None,
) -> pd.DataFrame:
    """Poles of the chosen order and those that stand for modes, of every block."""
    columns: dict[str, object] = {
        "time": pd.DatetimeIndex([one.block.start for one in usable]).repeat([len(r["order"]) for r in rows])}
    for name in rows[0]:
        columns[name] = np.concatenate([r[name] for r in rows])
    known = np.array(names if model is None else model.labels, dtype=object)
    stands, mode = np.array(names, dtype=object), np.asarray(columns["mode"])
    columns["mode"] = np.where(mode >= 0, stands[np.maximum(mode, 0)], known[np.maximum(-1 - mode, 0)])
    return pd.DataFrame(columns)


def _summary(every: list[_Found], data: ModalData, poles: pd.DataFrame, campaign: Campaign, rule: StateRule) -> str:
    found, used = [one.block for one in every], [one for one in every if one.usable]
    lines = [f"{len(used)} of {len(found)} blocks identified, {len(poles)} poles"]
    other = Counter(s.quantity for s in campaign.sensors if s.quantity != common_quantity(campaign.sensors))
    lines += [f"{plural(n, 'channel')} of {name} converted to acceleration" for name, n in other.items()]
    reasons = Counter("gap" if one.excluded.startswith("gap") else one.excluded for one in found if one.excluded)
    if reasons:
        lines.append("left out: " + ", ".join(f"{n} for {name}" for name, n in reasons.items()))
    lines += [_of_a_mode(label, np.array([s.frequency_hz[j] for s in data.sets]))
              for j, label in enumerate(data.labels)]
    of_turbine = any(family(label) == TURBINE[0] for label in data.labels)
    lines += _of_scada(data, campaign, rule, of_turbine)
    lines += harmonics_removed(note for block in found for note in block.notes)
    lined = int((poles["criterion"] == "harmonic").sum()) if "criterion" in poles else 0
    if lined:
        lines.append(f"{lined} poles follow the rotor's speed and count as its lines")
    if campaign.scada is None and not of_turbine:
        lines.append("no SCADA: lines of a rotating machine were not looked for, and may be among the modes")
    elif campaign.scada is None or "rotor_speed_rpm" not in campaign.scada:
        lines.append("no rotor speed in SCADA: harmonics were not looked for, and may be among the modes")
    return "\n".join(lines)


def _of_a_mode(label: str, frequency_hz: np.ndarray) -> str:
    f = frequency_hz[np.isfinite(frequency_hz)]
    text = f"mean {np.mean(f):.4f} Hz, CoV {np.std(f, ddof=1) / np.mean(f):.4f}" if len(f) > 1 else "too few"
    return f"{label}: in {plural(len(f), 'block')}, {text}"


def _of_scada(data: ModalData, campaign: Campaign, rule: StateRule, of_turbine: bool) -> list[str]:
    """Turbine states, rated power and what fore-aft is."""
    lines = []
    if campaign.scada is not None or of_turbine:
        states = Counter(str(s.environment["state"]) for s in data.sets)
        lines.append("states: " + ", ".join(f"{n} {name}" for name, n in states.most_common()))
    if rule.rated_power_kw is not None and campaign.rated_power_kw is None:
        lines.append(f"rated power taken as the highest recorded, {rule.rated_power_kw:.0f} kW")
    if campaign.scada is not None and "nacelle_heading_deg" in campaign.scada:
        axis = f"{campaign.x_axis_heading_deg:g} deg of the compass"
        lines.append(f"fore-aft is where the nacelle looks; the model's x axis lies at {axis}")
    elif of_turbine:
        lines.append("no nacelle heading in SCADA: fore-aft is the model's x axis")
    return lines


def harmonics_removed(notes: Iterable[str]) -> list[str]:
    """What --harmonics remove did, by the blocks' notes: which multiples were taken out in how many blocks, and why
    they stayed in others."""
    taken, stayed, used = Counter(), Counter(), 0
    for note in notes:
        if note.startswith(TAKEN_OUT):
            used += 1
            taken.update(note.removeprefix(TAKEN_OUT).split(", "))
        elif note.startswith(STAY):
            # numbers differ from block to block, the reason does not
            stayed[re.sub(r"[:(].*", "", note.removeprefix(STAY)).strip()] += 1
    if not taken and not stayed:
        return []
    lines = [f"harmonics taken out in {used} of {used + sum(stayed.values())} blocks"
             + (": " + ", ".join(f"{name} in {n}" for name, n in sorted(taken.items())) if taken else "")]
    return [*lines, *(f"harmonics stay in {n} blocks: {reason}" for reason, n in stayed.most_common())]
