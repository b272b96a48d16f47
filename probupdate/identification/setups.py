"""Several setups of one structure: its modes out of the poles of all setups together, then each setup's own part of
them, merged on the common sensors (`roving`)."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np

from probupdate.campaign.reading import Campaign
from probupdate.campaign.scada import StateRule, with_rated_power
from probupdate.errors import InputError
from probupdate.identification.block_store import BlockStore
from probupdate.identification.chosen_poles import SSISettings, pole_stack
from probupdate.identification.counterparts import MatchedModes, match_modes, records_of
from probupdate.identification.identify import classify_blocks, hold_factors, passed_hz, physical_of
from probupdate.identification.physical import (
    Candidates,
    PersistenceSettings,
    PhysicalModes,
    block_candidates,
    gather_candidates,
    leading_direction,
    physical_modes,
)
from probupdate.identification.preprocessing import PASS_SHARE
from probupdate.identification.reference import ReferenceModes
from probupdate.identification.references_between import SetupModes, compare_references, frequency_shifts
from probupdate.identification.roving import MergedModes, Setup, merge_setups, shared_channels
from probupdate.modal.modes import Sensor, rotate_to_real
from probupdate.runtime.executors import Executor, executor
from probupdate.runtime.progress import Progress, silent


def identify_setups(
    campaigns: Sequence[Campaign],
    names: Sequence[str],
    *,
    reference: ReferenceModes | None = None,
    others: ReferenceModes | None = None,
    channels: tuple[str, ...] = (),
    settings: SSISettings | None = None,
    store: str | Path | None = None,
    jobs: int | Executor = 1,
    progress: Progress = silent,
) -> MergedModes:
    """The modes of a structure measured in several setups, in one set of all channels.

    Poles of all setups' blocks are clustered together, by frequency and by their shape at the channels that all have (a
    chain of setups without such is identified setup by setup, and merged by what two share), so that
    a mode that one setup hardly shows is known from the others; each setup then gives its own part of every mode that
    it has. reference, others: a model's modes at `channels`, of which the merged ones get their names. store: folder
    below which each setup keeps its blocks. Raises InputError without common channels, or where nothing comes back.
    """
    settings, persistence = settings or SSISettings(), PersistenceSettings()
    campaigns = align_directions(campaigns)
    shared = shared_channels([(name, c.sensors) for name, c in zip(names, campaigns, strict=True)])
    common = [c for c in shared if all(c in campaign.channels for campaign in campaigns)]
    if not common and reference is not None:
        raise InputError("setups", "have no channel in common, by which to find the model's modes",
                         "merge them without --model: `update` pairs what is merged with the model")
    with tempfile.TemporaryDirectory() if store is None else nullcontext(store) as folder, executor(jobs) as runs:
        poles = []
        for campaign, name in zip(campaigns, names, strict=True):
            blocks = BlockStore(Path(folder) / name, campaign, settings.of_blocks)
            blocks.fill(jobs=runs, progress=progress)
            poles.append(blocks)
        parts, owner = _candidates(poles, settings, persistence)
        if not parts:
            raise InputError("setups", "have no block that can be used", "run `probupdate check` on each")
        alone = _identify_setups_alone(campaigns, names, parts, owner, persistence)
        compared, away = compare_references(alone, shared), frequency_shifts(alone, shared)
        # of a structure that changed in between the modes are one all the same
        shift = [away.get(name, 0.0) for name in names]
        if not common:
            return _merge_along_chain(campaigns, names, poles, compared, settings, runs, progress)
        rows = [[campaign.channels.index(c) for c in common] for campaign in campaigns]
        at_common = [_shapes_at(part, rows[k], shift[k]) for part, k in zip(parts, owner, strict=True)]
        found = physical_modes(gather_candidates(at_common),
                               n_block=len(owner), settings=persistence,
                               block_seconds=60 * campaigns[0].block_minutes, where=f"{len(names)} setups",
                               highest_hz=min(passed_hz(c, settings) for c in campaigns))
        setups, notes = [], [*compared, *found.notes]
        for k, (campaign, name) in enumerate(zip(campaigns, names, strict=True)):
            own, place, absent = _setup_part(found, parts, [j for j, one in enumerate(owner) if one == k], shift[k])
            if own is None:
                notes.append(f"{name}: shows none of the {len(found.modes.labels)} modes: left out")
                continue
            rule = with_rated_power(StateRule(rated_power_kw=campaign.rated_power_kw), campaign.scada)
            result = classify_blocks(poles[k], campaign, own, None, settings=settings, rule=rule, jobs=runs,
                                     progress=progress, every=True)
            columns = [place.get(j, -1) for j in range(len(found.modes.labels))]
            data = replace(result.data, sets=tuple(s.of_modes(columns) for s in hold_factors(result).data.sets),
                           records=(), labels=found.modes.labels)
            setups.append(Setup(name=name, sensors=campaign.sensors, data=data))
    if reference is None:
        merged = merge_setups(setups, same_modes=True)
        return replace(merged, summary="\n".join([merged.summary, *notes]))
    model = reference if others is None else reference.join(others)
    named, matched = _name_modes(setups, found, model, reference.labels, channels)
    merged = merge_setups(named, same_modes=True)
    return _with_records(merged, named[0].data.labels, matched, reference.labels, notes, settings)


def _merge_along_chain(
    campaigns: Sequence[Campaign], names: Sequence[str], poles: Sequence[BlockStore], compared: list[str],
    settings: SSISettings, runs: Executor, progress: Progress,
) -> MergedModes:
    """Setups without a channel common to all: each with the modes that its own poles come back at, merged."""
    setups, notes = [], ["no channel is common to all setups: each was identified by itself, and they were merged "
                         "along the chain of channels that two share"]
    for campaign, name, blocks in zip(campaigns, names, poles, strict=True):
        rule = with_rated_power(StateRule(rated_power_kw=campaign.rated_power_kw), campaign.scada)
        found = physical_of(blocks, campaign, settings=settings, rule=rule, progress=progress)
        result = hold_factors(classify_blocks(blocks, campaign, found, None, settings=settings, rule=rule, jobs=runs,
                                              progress=progress))
        setups.append(Setup(name=name, sensors=campaign.sensors, data=replace(result.data, records=())))
        notes += [f"{name}: {text}" for text in found.notes]
    merged = merge_setups(setups)
    return replace(merged, summary="\n".join([merged.summary, *compared, *notes]))


def align_directions(campaigns: Sequence[Campaign]) -> list[Campaign]:
    """The campaigns with every channel along the direction of the first that has it: one that is stated the other way
    round is taken with the other sign."""
    stated: dict[str, Sensor] = {}
    found = []
    for campaign in campaigns:
        against = {s.channel for s in campaign.sensors if float(s.direction @ stated.setdefault(
            s.channel, s).direction) < -0.99}
        sensors = tuple(replace(s, direction=stated[s.channel].direction) if s.channel in against else s
                        for s in campaign.sensors)
        found.append(replace(campaign, sensors=sensors, turned=tuple(sorted(against))))
    return found


def _identify_setups_alone(
    campaigns: Sequence[Campaign], names: Sequence[str], parts: list[Candidates], owner: list[int],
    persistence: PersistenceSettings,
) -> list[SetupModes]:
    """Setups' modes by themselves, of those in which some come back."""
    each = (_identify_setup(campaign, name, [p for p, own in zip(parts, owner, strict=True) if own == k], persistence)
            for k, (campaign, name) in enumerate(zip(campaigns, names, strict=True)))
    return [one for one in each if one]


def _identify_setup(campaign: Campaign, name: str, parts: list[Candidates], persistence: PersistenceSettings
                    ) -> SetupModes | None:
    """A setup's modes by itself; None where nothing comes back."""
    if not parts or not sum(len(p.block) for p in parts):
        return None
    own = gather_candidates([replace(p, block=np.full(len(p.block), k)) for k, p in enumerate(parts)])
    try:
        found = physical_modes(own, n_block=len(parts), settings=persistence,
                               block_seconds=60 * campaign.block_minutes)
    except InputError:
        # its parts of modes may come back with those of the others
        return None
    shape = np.column_stack([leading_direction(own.shape[:, rows], own.share[rows]) for rows in found.rows])
    return SetupModes(name=name, sensors=campaign.sensors, frequency_hz=found.modes.frequency_hz,
                      shape=rotate_to_real(shape))


def _candidates(
    poles: Sequence[BlockStore], settings: SSISettings, persistence: PersistenceSettings
) -> tuple[list[Candidates], list[int]]:
    """Of every block that can be used its candidates, at its setup's own channels, and the setup's number."""
    parts, owner = [], []
    for k, blocks in enumerate(poles):
        for start in blocks.starts:
            block = blocks.read(start)
            if block.poles is None:
                continue
            parts.append(block_candidates(pole_stack(block, settings), len(owner), settings.classifier, persistence))
            owner.append(k)
    return parts, owner


def _shapes_at(part: Candidates, rows: list[int], shift: float) -> Candidates:
    """The same with the shapes at some channels, where these hardly move the shape says nothing, and is kept so; and
    ln f without the setup's `shift`."""
    shape = part.shape[rows]
    size = np.linalg.norm(shape, axis=0)
    return replace(part, shape=shape / np.where(size > 0, size, 1.0), ln_frequency=part.ln_frequency - shift)


def _setup_part(
    found: PhysicalModes, parts: list[Candidates], blocks: list[int], shift: float
) -> tuple[PhysicalModes | None, dict[int, int], list[int]]:
    """The modes with their shapes at one setup's channels, from the candidates of its blocks, and their frequencies
    with its `shift` of ln f; mode -> place among them; modes that none of its blocks has."""
    starts = np.cumsum([0, *(len(p.block) for p in parts)])
    chosen, shapes, absent = [], [], []
    for j, rows in enumerate(found.rows):
        mine = [parts[b].shape[:, int(r - starts[b])] for b in blocks for r in rows if starts[b] <= r < starts[b + 1]]
        weight = [parts[b].share[int(r - starts[b])] for b in blocks for r in rows if starts[b] <= r < starts[b + 1]]
        if not mine:
            absent.append(j)
            continue
        chosen.append(j)
        direction = leading_direction(np.array(mine).T, np.array(weight))
        real = np.real(rotate_to_real(direction[:, None]))[:, 0]
        shapes.append(real / np.abs(real).max())
    if not chosen:
        return None, {}, absent
    part = found.select(chosen)
    span = part.modes.range_hz
    modes = replace(part.modes, shape=np.column_stack(shapes), frequency_hz=part.modes.frequency_hz * np.exp(shift),
                    range_hz=None if span is None else span * np.exp(shift))
    return replace(part, modes=modes, notes=()), {j: k for k, j in enumerate(chosen)}, absent


def _name_modes(
    setups: list[Setup], found: PhysicalModes, model: ReferenceModes, wanted: tuple[str, ...], channels: tuple[str, ...]
) -> tuple[list[Setup], MatchedModes]:
    """The setups' modes matched with the model's by all their blocks: those of interest first, by name, the others by
    number; the match has the columns in their new order."""
    sets, at = [], []
    for setup in setups:
        rows = [channels.index(c) for c in setup.data.channels]
        here = replace(model, shape=model.shape[rows])
        sets += setup.data.sets
        at += [here] * len(setup.data.sets)
    matched = match_modes(sets, found.modes.pairs, at, model, len(wanted))
    place = {model.labels[i]: j for j, i in matched.partner.items() if model.labels[i] in wanted}
    known = [label for label in wanted if label in place]
    columns = [place[label] for label in known]
    columns += [j for j in range(len(found.modes.labels)) if j not in columns]
    labels = (*known, *(str(len(wanted) + k + 1) for k in range(len(columns) - len(known))))
    named = [replace(s, data=replace(s.data.of_modes(columns), labels=labels)) for s in setups]
    return named, matched.select(columns)


def _with_records(
    merged: MergedModes, labels: tuple[str, ...], matched: MatchedModes, wanted: tuple[str, ...], notes: list[str],
    settings: SSISettings,
) -> MergedModes:
    """The merged set with the record of each mode that it kept."""
    kept = matched.select([labels.index(label) for label in merged.data.labels])
    records, lacking, said = records_of(
        merged.data.sets, merged.data.labels, kept, in_pair=(), settings=settings.classifier,
        highest_hz=PASS_SHARE * settings.target_rate_hz / 2, wanted=wanted)
    return replace(merged, data=replace(merged.data, records=records, model_only=lacking),
                   summary="\n".join([merged.summary, *notes, *said]))
