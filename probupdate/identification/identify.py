"""A campaign's modes: poles of every block kept in a store, classified, gathered into one modal set a block."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from probupdate.campaign.reading import Campaign
from probupdate.campaign.scada import StateRule, block_conditions, with_rated_power
from probupdate.errors import InputError
from probupdate.identification import classification as rules
from probupdate.identification.block_poles import BlockPoles, BlockSettings, common_quantity
from probupdate.identification.block_store import BlockStore
from probupdate.identification.classification import Assignment, ClassifierSettings, Likeness
from probupdate.identification.reference import ReferenceModes, turned
from probupdate.identification.ssi import Poles, stability
from probupdate.modes import ModalData, ModalSet, rotate_to_real, write_modes
from probupdate.progress import Progress, silent

# the broad-band amplitude of a block goes by the unit of what was measured
AMPLITUDE = {"acceleration": "rms_mps2", "velocity": "rms_mps", "displacement": "rms_m"}


@dataclass(frozen=True, kw_only=True)
class SSISettings(BlockSettings):
    """`BlockSettings` are what the stored poles depend on; the classifier works on stored poles. A pole's stability is
    told at the orders up to `spread` below and above `order`."""

    classifier: ClassifierSettings = field(default_factory=ClassifierSettings)

    @property
    def of_blocks(self) -> BlockSettings:
        return BlockSettings(order=self.order, block_rows=self.block_rows, target_rate_hz=self.target_rate_hz,
                             spread=self.spread, lowest_order=self.lowest_order)


@dataclass(frozen=True, eq=False, kw_only=True)
class Identification:
    """data: a modal set a block, NaN where a mode was not found; poles: every pole with its criterion.

    poles has the columns time (UTC, start of the block), frequency_hz, damping_ratio, mpc, mac and mode (best single
    MAC and that mode; for a kept pole the mode it was taken for), similarity (S2MAC to the pair's plane), stability,
    criterion, paper_criterion. centre_hz: label(s) of a group -> its cluster's frequency.
    """

    data: ModalData
    poles: pd.DataFrame
    settings: SSISettings
    centre_hz: dict[str, float]
    notes: tuple[str, ...]
    summary: str

    def write(self, out: str | Path) -> list[Path]:
        """modes.json, and modes.poles.csv beside it."""
        out = Path(out)
        table = out.with_name(f"{out.stem}.poles.csv")
        out.parent.mkdir(parents=True, exist_ok=True)
        write_modes(self.data, out)
        written = self.poles.assign(time=self.poles["time"].dt.strftime("%Y-%m-%dT%H:%M:%SZ"))
        written.to_csv(table, index=False, float_format="%.6g", lineterminator="\n")
        return [out, table]


@dataclass(frozen=True, eq=False, kw_only=True)
class _Found:
    """One block on its way: poles are None where the block was excluded."""

    id: str
    start: pd.Timestamp
    environment: dict
    excluded: str
    notes: tuple[str, ...]
    poles: Poles | None = None
    likeness: Likeness | None = None
    verdict: np.ndarray | None = None
    paper: np.ndarray | None = None
    bands: np.ndarray | None = None


def identify(
    campaign: Campaign,
    reference: ReferenceModes,
    *,
    settings: SSISettings | None = None,
    state_rule: StateRule | None = None,
    store: str | Path | None = None,
    jobs: int = 1,
    progress: Progress = silent,
) -> Identification:
    """Identify every block of the campaign by SSI-cov and tell its poles by the reference modes.

    store: folder in which the poles of each block are kept as they are found; a run that was killed goes on there, and
    another classifier or model takes the poles from there. None: they are kept while this runs. jobs: processes; the
    modes are the same for any number. Then, from what is stored: clusters over the campaign, the choice in each block.
    """
    settings = settings or SSISettings()
    if reference.shape.shape[0] != len(campaign.sensors):
        raise InputError("reference modes", f"have {reference.shape.shape[0]} channels, the campaign "
                         f"{len(campaign.sensors)}", "compute the model's shapes at the campaign's sensors")
    with tempfile.TemporaryDirectory() if store is None else nullcontext(store) as folder:
        blocks = BlockStore(folder, campaign, settings.of_blocks)
        blocks.fill(jobs=jobs, progress=progress)
        return classified(blocks, campaign, reference, settings=settings, state_rule=state_rule, progress=progress)


def classified(
    blocks: BlockStore,
    campaign: Campaign,
    reference: ReferenceModes,
    *,
    settings: SSISettings,
    state_rule: StateRule | None = None,
    progress: Progress = silent,
) -> Identification:
    """The second pass: from stored poles to modes. Raises InputError where no block can be used."""
    rule = state_rule or StateRule(rated_power_kw=campaign.rated_power_kw)
    rule = with_rated_power(rule, campaign.scada)
    found = []
    for number, start in enumerate(blocks.starts):
        progress("telling modes", number, len(blocks.starts))
        found.append(_held_against(blocks.read(start), campaign, reference, settings, rule))
    progress("telling modes", len(blocks.starts), len(blocks.starts))
    centre = _centres(found, reference, settings.classifier)
    sets, tables = [], []
    for one in found:
        if one.block.poles is None:
            sets.append(_modal_set(one, None, reference))
            continue
        here = turned(reference, campaign.sensors, fore_aft_deg(one.environment, campaign))
        choice = rules.assigned(
            one.block.poles, one.likeness, one.verdict, centre, one.bands, here, settings.classifier)
        sets.append(_modal_set(one, choice, reference))
        tables.append(_pole_table(one, choice, reference))
    if not tables:
        raise InputError(str(campaign.path), f"none of {len(found)} blocks can be used; the first: "
                         f"{found[0].block.excluded}", "run `probupdate check` to see what is missing")
    data = ModalData(channels=campaign.channels, sets=tuple(sets), labels=reference.labels)
    poles = pd.concat(tables, ignore_index=True)
    remarks = [f"{b.id}: {text}" for b in (one.block for one in found) for text in (*b.notes, b.excluded) if text]
    names = ["/".join(reference.labels[i] for i in g) for g in reference.groups]
    return Identification(
        data=data, poles=poles, settings=settings,
        centre_hz=dict(zip(names, map(float, centre), strict=True)),
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
    """A stored block held against the model; the optional parts are None where the block was excluded."""

    block: BlockPoles
    environment: dict
    likeness: Likeness | None = None
    verdict: np.ndarray | None = None
    paper: np.ndarray | None = None
    bands: np.ndarray | None = None


def _held_against(
    block: BlockPoles, campaign: Campaign, reference: ReferenceModes, settings: SSISettings, rule: StateRule
) -> _Found:
    environment = _environment(block, campaign, rule)
    if block.poles is None:
        return _Found(block=block, environment=environment)
    near = tuple(p for p in block.others if abs(p.order - settings.order) <= settings.spread)
    twins = stability(block.poles, near) if near else np.ones(len(block.poles.frequency_hz))
    like = rules.likeness(block.poles, reference, twins)
    bands = rules.rotor_bands(environment, settings.classifier)
    return _Found(
        block=block, environment=environment, likeness=like, bands=bands,
        verdict=rules.block_criteria(block.poles, like, reference, settings.classifier),
        paper=rules.paper_criteria(block.poles, like, bands, settings.classifier),
    )


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
    return conditions


def _centres(found: list[_Found], reference: ReferenceModes, settings: ClassifierSettings) -> np.ndarray:
    """(n_group,) where each group's frequencies gather over the campaign; harmonics have no vote."""
    centres = []
    for g in range(len(reference.groups)):
        frequency, weight = [np.zeros(0)], [np.zeros(0)]
        for one in found:
            if one.block.poles is None:
                continue
            mine = (one.verdict == rules.KEPT) & (one.likeness.group == g)
            poles = one.block.poles
            swept = rules.within(poles.frequency_hz, one.bands)
            frequency.append(poles.frequency_hz[mine & ~swept])
            weight.append(one.likeness.score(poles.damping_ratio)[mine & ~swept])
        centres.append(rules.cluster_centre(np.concatenate(frequency), np.concatenate(weight)))
    return np.array(centres)


def _modal_set(one: _Found, choice: Assignment | None, reference: ReferenceModes) -> ModalSet:
    n_channel, n_mode = reference.shape.shape
    frequency, damping = np.full(n_mode, np.nan), np.full(n_mode, np.nan)
    shape = np.full((n_channel, n_mode), np.nan + 0j)
    environment, poles = dict(one.environment), one.block.poles
    if choice is not None:
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
                    environment=environment)


def unit_largest(shape: np.ndarray) -> np.ndarray:
    """Columns turned to lie along the real axis, the largest real part +1 (what imaginary part is left stays)."""
    real = rotate_to_real(shape)
    largest = np.argmax(np.abs(real.real), axis=0)
    return real / real.real[largest, np.arange(real.shape[1])]


def _pole_table(one: _Found, choice: Assignment, reference: ReferenceModes) -> pd.DataFrame:
    poles, like = one.block.poles, one.likeness
    mode = np.array(reference.labels, dtype=object)[like.best_mode]
    for label, pole in zip(reference.labels, choice.pole, strict=True):
        if pole >= 0:
            mode[pole] = label
    return pd.DataFrame({
        "time": one.block.start, "frequency_hz": poles.frequency_hz, "damping_ratio": poles.damping_ratio,
        "mpc": like.mpc, "mac": like.best_mac, "mode": mode, "similarity": like.similarity.max(axis=1),
        "stability": like.stability,
        "criterion": choice.criterion,
        "paper_criterion": one.paper,
    })


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
    if campaign.scada is None or "rotor_speed_rpm" not in campaign.scada:
        lines.append("no rotor speed in SCADA: harmonics were not looked for, and may be among the modes")
    return "\n".join(lines)
