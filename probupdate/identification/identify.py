"""A campaign's modes: poles of every block kept in a store, classified, gathered into one modal set a block."""

from __future__ import annotations

import re
import tempfile
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd

from probupdate.campaign.reading import Campaign
from probupdate.campaign.scada import StateRule, block_conditions, with_rated_power
from probupdate.errors import InputError
from probupdate.identification import classification as rules
from probupdate.identification import tracking
from probupdate.identification.block_poles import (
    STAY,
    TAKEN_OUT,
    BlockDeviations,
    BlockPoles,
    BlockSettings,
    common_quantity,
)
from probupdate.identification.block_store import BlockStore
from probupdate.identification.classification import ClassifierSettings, Likeness
from probupdate.identification.reference import ReferenceModes, turned
from probupdate.identification.tracking import Choice, JudgedPoles, Tracked
from probupdate.identification.unlabelled import only, unlabelled_modes
from probupdate.modes import ModalData, ModalDeviation, ModalSet, unit_largest, write_modes
from probupdate.progress import Progress, silent

# the broad-band amplitude of a block goes by the unit of what was measured
AMPLITUDE = {"acceleration": "rms_mps2", "velocity": "rms_mps", "displacement": "rms_m"}


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
    """data: a modal set a block, NaN where a mode was not found; poles: every pole with its criterion.

    poles has the columns time (UTC, start of the block), frequency_hz, damping_ratio, mpc, mac and mode (best single
    MAC and that mode; for a kept pole the mode it was taken for), similarity (S2MAC to the pair's plane), stability,
    criterion, paper_criterion, order; those of the chosen order, and those of other orders that stand for a mode.
    centre_hz: label -> median frequency of the mode's path; tracked: the paths, one row an identified block.
    """

    data: ModalData
    poles: pd.DataFrame
    settings: SSISettings
    centre_hz: dict[str, float]
    tracked: Tracked
    notes: tuple[str, ...]
    summary: str

    def write(self, out: str | Path) -> list[Path]:
        """modes.json, modes.deviations.h5 where there are deviations, and modes.poles.csv beside it."""
        out = Path(out)
        table = out.with_name(f"{out.stem}.poles.csv")
        out.parent.mkdir(parents=True, exist_ok=True)
        write_modes(self.data, out)
        written = self.poles.assign(time=self.poles["time"].dt.strftime("%Y-%m-%dT%H:%M:%SZ"))
        written.to_csv(table, index=False, float_format="%.6g", lineterminator="\n")
        deviations = [out.with_name(f"{out.stem}.deviations.h5")] if any(s.deviation for s in self.data.sets) else []
        return [out, *deviations, table]


def identify(
    campaign: Campaign,
    reference: ReferenceModes | None,
    *,
    settings: SSISettings | None = None,
    state_rule: StateRule | None = None,
    store: str | Path | None = None,
    jobs: int = 1,
    progress: Progress = silent,
) -> Identification:
    """Identify every block of the campaign by SSI-cov and tell its poles by the reference modes; without any, the poles
    that come back over orders and blocks are the modes, and have numbers for names.

    store: folder in which the poles of each block are kept as they are found; a run that was killed goes on there, and
    another classifier or model takes the poles from there. None: they are kept while this runs. jobs: processes; the
    modes are the same for any number. Then, from what is stored: clusters over the campaign, the choice in each block.
    """
    settings = settings or SSISettings()
    if reference is not None and reference.shape.shape[0] != len(campaign.sensors):
        raise InputError("reference modes", f"have {reference.shape.shape[0]} channels, the campaign "
                         f"{len(campaign.sensors)}", "compute the model's shapes at the campaign's sensors")
    with tempfile.TemporaryDirectory() if store is None else nullcontext(store) as folder:
        blocks = BlockStore(folder, campaign, settings.of_blocks)
        blocks.fill(jobs=jobs, progress=progress)
        if reference is None:
            return _numbered(blocks, campaign, settings=settings, state_rule=state_rule, jobs=jobs, progress=progress)
        return classified(
            blocks, campaign, reference, settings=settings, state_rule=state_rule, jobs=jobs, progress=progress)


def _numbered(blocks: BlockStore, campaign: Campaign, *, settings: SSISettings, state_rule, **how) -> Identification:
    """Modes without a model: what comes back and does not move with the rotor, and is found when it is looked for."""
    rule = state_rule or StateRule(rated_power_kw=campaign.rated_power_kw)
    rule = with_rated_power(rule, campaign.scada)
    reference, said = unlabelled_modes(
        (blocks.read(t) for t in blocks.starts), classifier=settings.classifier,
        bands_of=lambda block: rules.rotor_bands(_environment(block, campaign, rule), settings.classifier))
    while True:
        found = classified(blocks, campaign, reference, settings=settings, state_rule=state_rule, **how)
        seen = np.isfinite([s.frequency_hz for s in found.data.sets]).any(axis=0)
        if seen.all() or not seen.any():
            break
        said = (*said, *(f"{f:.3f} Hz comes back but is found in no block as a mode: left out"
                         for f in reference.frequency_hz[~seen]))  # fmt: skip
        reference = only(reference, np.flatnonzero(seen))
    return replace(found, notes=(*said, *found.notes), summary="\n".join([found.summary, *said]))


def classified(
    blocks: BlockStore,
    campaign: Campaign,
    reference: ReferenceModes,
    *,
    settings: SSISettings,
    state_rule: StateRule | None = None,
    jobs: int = 1,
    progress: Progress = silent,
) -> Identification:
    """The second pass: from stored poles to modes, and their deviations. Raises InputError where no block can be used.
    """
    rule = state_rule or StateRule(rated_power_kw=campaign.rated_power_kw)
    rule = with_rated_power(rule, campaign.scada)
    found = []
    for number, start in enumerate(blocks.starts):
        progress("telling modes", number, len(blocks.starts))
        found.append(_held_against(blocks.read(start), campaign, reference, settings, rule))
    progress("telling modes", len(blocks.starts), len(blocks.starts))
    usable = [one for one in found if one.judged is not None]
    if not usable:
        raise InputError(str(campaign.path), f"none of {len(found)} blocks can be used; the first: "
                         f"{found[0].block.excluded}", "run `probupdate check` to see what is missing")
    followed = tracking.track([one.judged for one in usable], settings.classifier)
    chosen = {one.block.start: choice for one, choice in zip(usable, followed.choices, strict=True)}
    if settings.sub_records:
        chosen |= _without_uncertain(blocks, usable, chosen, followed.centre_hz, settings.classifier, jobs, progress)
        followed = replace(followed, choices=tuple(chosen[one.block.start] for one in usable))
    sets, tables = [], []
    for one in found:
        choice = chosen.get(one.block.start)
        kept = blocks.read_deviations(one.block.start) if choice is not None and _wanted(one, choice) and \
            settings.sub_records else None
        sets.append(_modal_set(one, choice, reference, kept))
        if choice is not None:
            tables.append(_pole_table(one, choice, settings.order))
    data = ModalData(channels=campaign.channels, sets=tuple(sets), labels=reference.labels)
    poles = pd.concat(tables, ignore_index=True)
    remarks = [f"{b.id}: {text}" for b in (one.block for one in found) for text in (*b.notes, b.excluded) if text]
    return Identification(
        data=data, poles=poles, settings=settings,
        centre_hz=dict(zip(reference.labels, map(float, np.median(followed.centre_hz, axis=0)), strict=True)),
        tracked=followed,
        notes=tuple(remarks),
        summary=_summary([one.block for one in found], data, poles, campaign, rule),
    )


def modal_data(identification: Identification) -> ModalData:
    """What `modes.json` holds: a set a block."""
    return identification.data


def fore_aft_deg(environment: Mapping, campaign: Campaign) -> float:
    """Counter-clockwise angle from the model's x axis to where the nacelle looks; 0 where no heading was recorded."""
    heading = environment.get("nacelle_heading_deg")
    return 0.0 if heading is None else campaign.x_axis_heading_deg - float(heading)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Found:
    """A stored block and, unless it was excluded, its poles held against the model: `judged` with the model turned to
    where the nacelle looked, `single` and `paper` as the paper has it, against the model as it is."""

    block: BlockPoles
    environment: dict
    judged: JudgedPoles | None = None
    single: Likeness | None = None
    paper: np.ndarray | None = None


def _held_against(
    block: BlockPoles, campaign: Campaign, reference: ReferenceModes, settings: SSISettings, rule: StateRule
) -> _Found:
    environment = _environment(block, campaign, rule)
    if block.poles is None:
        return _Found(block=block, environment=environment)
    near = tuple(p for p in block.others if p.order >= settings.order - settings.below)
    stack = rules.stacked((block.poles, *near))
    here = turned(reference, campaign.sensors, fore_aft_deg(environment, campaign))
    like = rules.likeness(stack, here)
    bands = rules.rotor_bands(environment, settings.classifier)
    judged = JudgedPoles(
        id=block.id, poles=stack, likeness=like, bands=bands, reference=here,
        verdict=rules.block_criteria(stack, like, here, settings.classifier),
    )
    single = rules.likeness(stack, reference, like.stability)
    paper = rules.paper_criteria(stack, single, bands, settings.classifier)
    return _Found(block=block, environment=environment, judged=judged, single=single, paper=paper)


def _without_uncertain(
    blocks: BlockStore, usable: list[_Found], chosen: dict, centre_hz: np.ndarray, settings: ClassifierSettings,
    jobs: int, progress: Progress,
) -> dict[pd.Timestamp, Choice]:
    """Choices again in blocks where a chosen pole's deviations are beyond the classifier's limits; start -> choice.

    Deviations are computed of chosen poles only; each round takes poles away, so that it ends.
    """
    judged = {one.block.start: one.judged for one in usable}
    centre = {one.block.start: row for one, row in zip(usable, centre_hz, strict=True)}
    known = {start: [np.full(len(j.poles.order), np.nan) for _ in range(2)] for start, j in judged.items()}
    todo, again = dict(chosen), {}
    by_start = {one.block.start: one for one in usable}
    while todo:
        wanted = {start: keys for start, choice in todo.items() if (keys := _wanted(by_start[start], choice))}
        blocks.fill_deviations(wanted, jobs=jobs, progress=progress)
        todo = {}
        for start, keys in wanted.items():
            kept, one = blocks.read_deviations(start), judged[start]
            for (order, index), pole in keys.items():
                row = kept.key.index((order, index))
                known[start][0][pole] = np.linalg.norm(kept.ln_frequency[row])
                known[start][1][pole] = np.linalg.norm(kept.damping_ratio[row])
            verdict = rules.block_criteria(one.poles, one.likeness, one.reference, settings,
                                           ln_frequency_std=known[start][0], damping_std=known[start][1])
            if np.any((verdict != one.verdict)[list(keys.values())]):
                judged[start] = replace(one, verdict=verdict)
                again[start] = todo[start] = tracking.choose(judged[start], centre[start], settings)
    return again


def _wanted(one: _Found, choice: Choice) -> dict[tuple[int, int], int]:
    """(model order, index within its poles) -> place in the block's stack, of the poles that stand for modes."""
    order = one.judged.poles.order
    return {(int(order[p]), int(p - np.argmax(order == order[p]))): int(p) for p in choice.pole if p >= 0}


def _deviation(one: _Found, choice: Choice, kept: BlockDeviations) -> ModalDeviation:
    """Columns of every mode; NaN for one that was not found."""
    n_column = kept.ln_frequency.shape[1]
    ln_frequency, damping = (np.full((len(choice.pole), n_column), np.nan) for _ in range(2))
    shape = np.full((kept.shape.shape[0], len(choice.pole), n_column), np.nan + 0j)
    keys = {pole: key for key, pole in _wanted(one, choice).items()}
    for mode in np.flatnonzero(choice.pole >= 0):
        row = kept.key.index(keys[int(choice.pole[mode])])
        ln_frequency[mode], damping[mode] = kept.ln_frequency[row], kept.damping_ratio[row]
        shape[:, mode] = kept.shape[:, row]
    return ModalDeviation(ln_frequency=ln_frequency, damping_ratio=damping, shape=shape)


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
    told = [note for note in block.notes if note.startswith((TAKEN_OUT, STAY))]
    if told:
        conditions["harmonics"] = told[0]
    return conditions


def _modal_set(
    one: _Found, choice: Choice | None, reference: ReferenceModes, kept: BlockDeviations | None
) -> ModalSet:
    n_channel, n_mode = reference.shape.shape
    frequency, damping = np.full(n_mode, np.nan), np.full(n_mode, np.nan)
    shape = np.full((n_channel, n_mode), np.nan + 0j)
    environment = dict(one.environment)
    if choice is not None:
        poles = one.judged.poles
        there = np.flatnonzero(choice.pole >= 0)
        taken = choice.pole[there]
        frequency[there], damping[there] = poles.frequency_hz[taken], poles.damping_ratio[taken]
        shape[:, there] = unit_largest(poles.shape[:, taken])
        for g, group in enumerate(reference.groups):
            if len(group) > 1:
                name = "_".join(reference.labels[i] for i in group)
                environment[f"independence_{name}"] = float(choice.independence[g])
    return ModalSet(id=one.block.id, frequency_hz=frequency, damping_ratio=damping, shape=shape,
                    frequency_std_hz=np.full(n_mode, np.nan), shape_std=np.full((n_channel, n_mode), np.nan),
                    environment=environment, deviation=None if kept is None else _deviation(one, choice, kept))


def _pole_table(one: _Found, choice: Choice, order: int) -> pd.DataFrame:
    poles, like, labels = one.judged.poles, one.judged.likeness, one.judged.reference.labels
    mode = np.array(labels, dtype=object)[one.single.best_mode]
    there = choice.pole >= 0
    mode[choice.pole[there]] = np.array(labels, dtype=object)[there]
    table = pd.DataFrame({
        "time": one.block.start, "frequency_hz": poles.frequency_hz, "damping_ratio": poles.damping_ratio,
        "mpc": like.mpc, "mac": one.single.best_mac, "mode": mode, "similarity": like.similarity.max(axis=1),
        "stability": like.stability, "criterion": choice.criterion, "paper_criterion": one.paper, "order": poles.order,
    })
    return table[(table["order"] == order) | (table["criterion"] == rules.KEPT)]


def _summary(found: list[BlockPoles], data: ModalData, poles: pd.DataFrame, campaign: Campaign, rule: StateRule) -> str:
    used = [one for one in found if one.poles is not None]
    lines = [f"{len(used)} of {len(found)} blocks identified, {len(poles)} poles"]
    other = Counter(s.quantity for s in campaign.sensors if s.quantity != common_quantity(campaign.sensors))
    lines += [f"{n} channels of {name} were converted to acceleration" for name, n in other.items()]
    reasons = Counter("gap" if one.excluded.startswith("gap") else one.excluded for one in found if one.excluded)
    if reasons:
        lines.append("left out: " + ", ".join(f"{n} for {name}" for name, n in reasons.items()))
    for j, label in enumerate(data.labels):
        f = np.array([s.frequency_hz[j] for s in data.sets])
        f = f[np.isfinite(f)]
        text = f"mean {np.mean(f):.4f} Hz, CoV {np.std(f, ddof=1) / np.mean(f):.4f}" if len(f) > 1 else "too few"
        lines.append(f"{label}: in {len(f)} blocks, {text}")
    states = Counter(str(s.environment["state"]) for s in data.sets)
    lines.append("states: " + ", ".join(f"{n} {name}" for name, n in states.most_common()))
    if rule.rated_power_kw is not None and campaign.rated_power_kw is None:
        lines.append(f"rated power taken as the highest recorded, {rule.rated_power_kw:.0f} kW")
    if campaign.scada is not None and "nacelle_heading_deg" in campaign.scada:
        axis = f"{campaign.x_axis_heading_deg:g} deg of the compass"
        lines.append(f"fore-aft is where the nacelle looks; the model's x axis lies at {axis}")
    else:
        lines.append("no nacelle heading in SCADA: fore-aft is the model's x axis")
    lines += harmonics_removed(note for block in found for note in block.notes)
    lined = int((poles["criterion"] == "harmonic").sum()) if "criterion" in poles else 0
    if lined:
        lines.append(f"{lined} poles follow the rotor's speed and count as its lines")
    if campaign.scada is None or "rotor_speed_rpm" not in campaign.scada:
        lines.append("no rotor speed in SCADA: harmonics were not looked for, and may be among the modes")
    return "\n".join(lines)


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
