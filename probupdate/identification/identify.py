"""A campaign's modes: poles of every block kept in a store, classified, gathered into one modal set a block."""

from __future__ import annotations

import tempfile
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from probupdate.campaign.reading import Campaign
from probupdate.campaign.scada import StateRule, with_rated_power
from probupdate.campaign.usable import remedy
from probupdate.errors import InputError
from probupdate.identification import classification as rules
from probupdate.identification.block_poles import BlockPoles
from probupdate.identification.block_store import BlockStore
from probupdate.identification.chosen_poles import (
    SSISettings,
    averaged_over_orders,
    chosen_keys,
    covariance_factors_of,
    follow,
    modal_set,
    pole_stack,
    pole_table,
    without_uncertain,
)
from probupdate.identification.environment import environment_of
from probupdate.identification.hand_picked import HandPickedModes, hand_picked, opened_choice, refuse_other_records
from probupdate.identification.naming import name_modes, with_independence
from probupdate.identification.physical import (
    PersistenceSettings,
    PhysicalModes,
    block_candidates,
    even_blocks,
    gather_candidates,
    physical_modes,
)
from probupdate.identification.preprocessing import PASS_SHARE
from probupdate.identification.reference import ReferenceModes
from probupdate.identification.steadiness import of_steady_modes, of_vague_modes
from probupdate.identification.summary import of_likelihood, summarise
from probupdate.identification.tracking import TrackedModes
from probupdate.io.files import write_table
from probupdate.io.result_table import table_of
from probupdate.modal.mode_choice import ModeChoice
from probupdate.modal.modes import ModalData, StoredFactors, mac, write_modes
from probupdate.runtime.executors import Executor, Shard, executor
from probupdate.runtime.progress import Progress, silent

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True, eq=False, kw_only=True)
class Identification:
    """data: a modal set a block, NaN where a mode was not found, with a record of each mode: where it was found and
    what it is in the model; with standard deviations, of each mode the value at the greatest likelihood of the block's
    spectra (`refinement`), or where these do not bear one the average over model orders, rather than its pole.
    poles: every pole with its criterion.

    poles has the columns time (UTC, start of the block), frequency_hz, damping_ratio, mpc, mac and mode (best single
    MAC to the model's modes of interest and that mode; for a kept pole the mode it was taken for), similarity (to the
    campaign's modes, S2MAC to a pair's plane), stability, criterion, paper_criterion, order; those of the chosen order,
    and those of other orders that stand for a mode or were rejected by hand, then with their `reason`. centre_hz: label
    -> median frequency of the mode's path; tracked: the paths of the campaign's modes, '' one that was left out, a row
    an identified block.
    """

    data: ModalData
    poles: pd.DataFrame
    settings: SSISettings
    centre_hz: dict[str, float]
    tracked: TrackedModes
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
        written = write_modes(self.data, out)
        write_table(table, self.poles)
        return [*written, table]


def identify(
    campaign: Campaign,
    reference: ReferenceModes | None,
    *,
    others: ReferenceModes | None = None,
    settings: SSISettings | None = None,
    state_rule: StateRule | None = None,
    choice: str | Path | ModeChoice | None = None,
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
    any. choice: poles that were picked by hand, which are the modes then, whatever comes back. Raises InputError where
    no block can be used, where nothing comes back, and for a choice that was made on other records.
    """
    settings = settings or SSISettings()
    if reference is not None and reference.shape.shape[0] != len(campaign.sensors):
        raise InputError("reference modes", f"have {reference.shape.shape[0]} channels, the campaign "
                         f"{len(campaign.sensors)}", "compute the model's shapes at the campaign's sensors")
    rule = state_rule or StateRule(rated_power_kw=campaign.rated_power_kw)
    rule = with_rated_power(rule, campaign.scada)
    with tempfile.TemporaryDirectory() if store is None else nullcontext(store) as folder, executor(jobs) as runs:
        blocks = BlockStore(folder, campaign, settings.of_blocks)
        picked, where = (None, "") if choice is None else opened_choice(choice)
        if picked is not None:
            refuse_other_records(picked, blocks, campaign, settings.of_blocks, where)
        blocks.fill(jobs=runs, progress=progress)
        hand = None if picked is None else hand_picked(picked, blocks, where)
        found = hand.physical if hand is not None else physical_of(blocks, campaign, settings=settings, rule=rule,
                                                                   progress=progress)
        result = classify_blocks(blocks, campaign, found, reference, others=others, settings=settings, rule=rule,
                                 hand=hand,
                                 every=hand is not None, jobs=runs, progress=progress)
        result = replace(result, data=replace(result.data, choice=picked))
        return hold_factors(result) if store is None else result


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
        n_left, done, n_without = len(blocks.pending_blocks()), 0, None
        if not n_left:
            found = physical_of(blocks, campaign, settings=settings, rule=rule, progress=progress)
            first = follow(blocks, campaign, found, None, settings=settings, rule=rule, progress=progress)
            wanted = chosen_keys(first.picked) if settings.sub_records else {}
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
        block = blocks.read_head(start)
        if block.excluded:
            reason = reason or block.excluded
            continue
        usable.append(start)
        states.append(str(environment_of(block, campaign, rule).get("state", "unknown")))
    if not usable:
        raise InputError(str(campaign.path), f"none of {len(blocks.starts)} blocks can be used; the first: {reason}",
                         remedy(campaign))
    parts, bands, angles, waves, state = [], [], [], [], []
    chosen = even_blocks(states)
    for number, k in enumerate(chosen):
        progress("classifying modes", number, len(chosen))
        block = blocks.read(usable[k], spectra=False)
        environment = environment_of(block, campaign, rule)
        parts.append(block_candidates(pole_stack(block, settings), number, settings.classifier, persistence))
        bands.append(rules.rotor_bands(environment, settings.classifier))
        angles.append(environment.get("nacelle_angle_deg", np.nan))
        period = environment.get("wave_period_s")
        waves.append(1 / float(period) if period is not None and float(period) > 0 else np.nan)
        state.append(states[k])
    progress("classifying modes", len(chosen), len(chosen))
    return physical_modes(
        gather_candidates(parts), n_block=len(chosen), settings=persistence, state=state, bands=bands, wave_hz=waves,
        angle_deg=angles, sensors=campaign.sensors, block_seconds=60 * campaign.block_minutes,
        highest_hz=passed_hz(campaign, settings), where=str(campaign.path))


def proposed_poles(block: BlockPoles, settings: SSISettings) -> dict[tuple[int, int], str]:
    """(model order, index) -> number of the mode, of the poles of one block that would be its modes were it all there
    is: of the chosen order, where it has them."""
    stack = pole_stack(block, settings)
    candidates = block_candidates(stack, 0, settings.classifier, PersistenceSettings())
    try:
        modes = physical_modes(candidates, n_block=1).modes
    except InputError:
        # nothing comes back over the orders
        return {}
    found = {}
    for j, label in enumerate(modes.labels):
        near = np.exp(-0.5 * (np.log(stack.frequency_hz / modes.frequency_hz[j]) / rules.TWIN_FREQUENCY) ** 2)
        score = near * mac(stack.shape, modes.shape[:, [j]])[:, 0] * np.where(stack.order == settings.order, 1.0, 0.5)
        pole = int(np.argmax(score))
        found[int(stack.order[pole]), int(pole - np.argmax(stack.order == stack.order[pole]))] = label
    return found


def passed_hz(campaign: Campaign, settings: SSISettings) -> float:
    """Up to where a record at the rate of identification is as it was measured."""
    thinned = settings.target_rate_hz < campaign.sampling_rate_hz * (1 - 1e-9)
    return (PASS_SHARE if thinned else 1.0) * settings.target_rate_hz / 2


def classify_blocks(
    blocks: BlockStore,
    campaign: Campaign,
    physical: PhysicalModes,
    reference: ReferenceModes | None,
    *,
    settings: SSISettings,
    rule: StateRule,
    others: ReferenceModes | None = None,
    hand: HandPickedModes | None = None,
    every: bool = False,
    jobs: int | Executor = 1,
    progress: Progress = silent,
) -> Identification:
    """The second pass: from stored poles to the modes that were found in them, their standard deviations, and their
    names. every: a column for each, also for one that stands in no block (one setup of several)."""
    first = follow(blocks, campaign, physical, reference, settings=settings, rule=rule, progress=progress, hand=hand)
    found, usable, followed, picked = first.found, first.usable, first.tracked, dict(first.picked)
    if settings.sub_records:
        picked |= without_uncertain(blocks, first, settings.classifier, jobs, progress)
        picked = {start: averaged_over_orders(blocks, start, stands) for start, stands in picked.items()}
        followed = replace(followed, choices=tuple(picked[one.block.start].choice for one in usable))
    # what its poles were before they were averaged
    del first
    sets = [modal_set(one, picked.get(one.block.start), physical.modes) for one in found]
    named = name_modes(sets, physical, reference, others, campaign, settings=settings.classifier,
                       highest_hz=passed_hz(campaign, settings), every=every)
    del sets
    sets = []
    for s, one, columns in zip(named.sets, found, named.mode_in_column, strict=True):
        stands = picked.get(one.block.start)
        if stands is None:
            sets.append(s)
            continue
        covariance_factors = None
        if stands.keys and settings.sub_records:
            keys = tuple(stands.key_of.get(int(j)) for j in columns)
            covariance_factors = StoredFactors(read=partial(covariance_factors_of, blocks, one.block.start, keys))
        sets.append(replace(s, environment=with_independence(s, stands.choice, named.names, physical.modes),
                            covariance_factors=covariance_factors))
    data = ModalData(channels=campaign.channels, sets=tuple(sets), labels=named.labels, records=named.records,
                     gravity=tuple(bool(s.gravity) for s in campaign.sensors),
                     model_only=named.model_only)
    poles = pole_table(usable, [picked[one.block.start].rows for one in usable], named.names, reference)
    remarks = [f"{b.id}: {text}" for b in (one.block for one in found) for text in (*b.notes, b.excluded) if text]
    said = (*physical.notes, *named.notes, *of_vague_modes(data, 60 * campaign.block_minutes),
            *of_steady_modes(
                named.names, *(np.array([getattr(p, of) for p in picked.values()])
                               for of in ("kurtosis", "frequency_hz", "damping_ratio")), 60 * campaign.block_minutes),
            *of_likelihood(named.names, np.array([p.by_likelihood for p in picked.values()]),
                           np.array([np.isfinite(p.frequency_hz) for p in picked.values()])))
    centre = np.median(followed.centre_hz, axis=0)
    return Identification(
        data=data, poles=poles, settings=settings,
        centre_hz={label: float(centre[k]) if k >= 0 else np.nan
                   for label, k in zip(named.labels, named.columns, strict=True)},
        tracked=replace(followed, labels=named.names),
        notes=(*said, *remarks),
        summary="\n".join([summarise(found, data, poles, campaign, rule), *said]),
    )


def hold_factors(identification: Identification) -> Identification:
    """The same with its covariance factors in memory, before the store goes that they are read from."""
    sets = tuple(s if s.covariance_factors is None else replace(s, covariance_factors=s.covariance_factors.load())
                 for s in identification.data.sets)
    return replace(identification, data=replace(identification.data, sets=sets))
