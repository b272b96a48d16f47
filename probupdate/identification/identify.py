"""A campaign's modes: poles of every block, classified, gathered into one modal set a block."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from probupdate.campaign.blocks import Block, block_starts, blocks
from probupdate.campaign.reading import Campaign
from probupdate.campaign.scada import StateRule, block_conditions, with_rated_power
from probupdate.errors import InputError
from probupdate.identification import classification as rules
from probupdate.identification.classification import Assignment, ClassifierSettings, Likeness
from probupdate.identification.preprocessing import resampled
from probupdate.identification.reference import ReferenceModes, turned
from probupdate.identification.ssi import Poles, identify_poles
from probupdate.modes import ModalData, ModalSet, rotate_to_real, write_modes
from probupdate.progress import Progress, silent


@dataclass(frozen=True, kw_only=True)
class SSISettings:
    """order 20 and 5 Hz as the paper; 30 block rows of 0.2 s see two periods of a 0.3 Hz mode and more of the rest.
    spread: a pole's stability is told at the even orders up to so many below and above `order`."""

    order: int = 20
    block_rows: int = 30
    target_rate_hz: float = 5.0
    spread: int = 8
    classifier: ClassifierSettings = field(default_factory=ClassifierSettings)

    def __post_init__(self):
        for name, least in (("order", 2), ("block_rows", 2), ("spread", 0)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
                raise InputError(name, f"{value!r} is no whole number from {least}", "give one")
        if not 0 < self.target_rate_hz < np.inf:
            raise InputError("target rate", f"{self.target_rate_hz} Hz is not positive", "give one, such as 5")


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
    progress: Progress = silent,
) -> Identification:
    """Identify every block of the campaign by SSI-cov and tell its poles by the reference modes.

    Two passes: poles of each block as it is read; then the clusters over the campaign and the choice in each block.
    """
    settings = settings or SSISettings()
    _refuse_mixed(campaign)
    if reference.shape.shape[0] != len(campaign.sensors):
        raise InputError("reference modes", f"have {reference.shape.shape[0]} channels, the campaign "
                         f"{len(campaign.sensors)}", "compute the model's shapes at the campaign's sensors")
    rule = state_rule or StateRule(rated_power_kw=campaign.rated_power_kw)
    rule = with_rated_power(rule, campaign.scada)
    total, found = len(block_starts(campaign)), []
    for number, block in enumerate(blocks(campaign)):
        progress("identifying blocks", number, total)
        found.append(_one_block(campaign, block, reference, settings, rule))
    progress("identifying blocks", total, total)
    centre = _centres(found, reference, settings.classifier)
    sets, tables = [], []
    for one in found:
        if one.poles is None:
            sets.append(_modal_set(one, None, reference))
            continue
        here = turned(reference, campaign.sensors, fore_aft_deg(one.environment, campaign))
        choice = rules.assigned(one.poles, one.likeness, one.verdict, centre, one.bands, here, settings.classifier)
        sets.append(_modal_set(one, choice, reference))
        tables.append(_pole_table(one, choice, reference))
    if not tables:
        raise InputError(str(campaign.path), f"none of {total} blocks can be used; the first: {found[0].excluded}",
                         "run `probupdate check` to see what is missing")
    data = ModalData(channels=campaign.channels, sets=tuple(sets), labels=reference.labels)
    poles = pd.concat(tables, ignore_index=True)
    remarks = [f"{one.id}: {text}" for one in found for text in (*one.notes, one.excluded) if text]
    names = ["/".join(reference.labels[i] for i in g) for g in reference.groups]
    return Identification(
        data=data, poles=poles, settings=settings,
        centre_hz=dict(zip(names, map(float, centre), strict=True)),
        notes=tuple(remarks),
        summary=_summary(found, data, poles, campaign, rule),
    )


def modal_data(identification: Identification) -> ModalData:
    """What `modes.json` holds: a set a block."""
    return identification.data


def fore_aft_deg(environment: Mapping, campaign: Campaign) -> float:
    """Counter-clockwise angle from the model's x axis to where the nacelle looks; 0 where no heading was recorded."""
    heading = environment.get("nacelle_heading_deg")
    return 0.0 if heading is None else campaign.x_axis_heading_deg - float(heading)


def _refuse_mixed(campaign: Campaign) -> None:
    quantities = Counter(s.quantity for s in campaign.sensors)
    if len(quantities) > 1:
        common = quantities.most_common(1)[0][0]
        odd = [s.channel for s in campaign.sensors if s.quantity != common]
        raise InputError(str(campaign.path / "campaign.toml"), f"{', '.join(odd)} measure other than {common}, which "
                         "scales a shape's components by frequency", "convert the records to one quantity")


def _one_block(campaign, block: Block, reference, settings: SSISettings, rule: StateRule) -> _Found:
    conditions = dict(block_conditions(campaign.scada, block.start, block.minutes, rule))
    conditions["block_minutes"] = block.minutes
    if conditions.get("nacelle_heading_deg") is not None:
        # relative to the model's axes, so that a model can be turned to it without the campaign at hand
        conditions["nacelle_angle_deg"] = (fore_aft_deg(conditions, campaign) + 180.0) % 360.0 - 180.0
    common = {"id": block.id, "start": block.start, "environment": conditions, "notes": block.notes}
    if block.excluded:
        return _Found(excluded=block.excluded, **common)
    still = [c for c, moved in zip(campaign.channels, np.ptp(block.data, axis=0) > 0, strict=True) if not moved]
    if still:
        return _Found(excluded=f"no signal in {', '.join(still)}", **common)
    record = resampled(block.data, campaign.sampling_rate_hz, settings.target_rate_hz)
    poles, stability = identify_poles(
        record, settings.target_rate_hz, order=settings.order, block_rows=settings.block_rows, spread=settings.spread)
    like = rules.likeness(poles, reference, stability)
    bands = rules.rotor_bands(conditions, settings.classifier)
    return _Found(
        excluded="", poles=poles, likeness=like, bands=bands,
        verdict=rules.block_criteria(poles, like, reference, settings.classifier),
        paper=rules.paper_criteria(poles, like, bands, settings.classifier), **common,
    )


def _centres(found: list[_Found], reference: ReferenceModes, settings: ClassifierSettings) -> np.ndarray:
    """(n_group,) where each group's frequencies gather over the campaign; harmonics have no vote."""
    centres = []
    for g in range(len(reference.groups)):
        frequency, weight = [np.zeros(0)], [np.zeros(0)]
        for one in found:
            if one.poles is None:
                continue
            mine = (one.verdict == rules.KEPT) & (one.likeness.group == g)
            swept = rules.within(one.poles.frequency_hz, one.bands)
            frequency.append(one.poles.frequency_hz[mine & ~swept])
            weight.append(one.likeness.score(one.poles.damping_ratio)[mine & ~swept])
        centres.append(rules.cluster_centre(np.concatenate(frequency), np.concatenate(weight)))
    return np.array(centres)


def _modal_set(one: _Found, choice: Assignment | None, reference: ReferenceModes) -> ModalSet:
    n_channel, n_mode = reference.shape.shape
    frequency, damping = np.full(n_mode, np.nan), np.full(n_mode, np.nan)
    shape = np.full((n_channel, n_mode), np.nan + 0j)
    environment = dict(one.environment)
    if one.excluded:
        environment["excluded"] = one.excluded
    if choice is not None:
        there = np.flatnonzero(choice.pole >= 0)
        taken = choice.pole[there]
        frequency[there], damping[there] = one.poles.frequency_hz[taken], one.poles.damping_ratio[taken]
        shape[:, there] = unit_largest(one.poles.shape[:, taken])
        for g, group in enumerate(reference.groups):
            if len(group) > 1:
                name = "_".join(reference.labels[i] for i in group)
                environment[f"independence_{name}"] = float(choice.independence[g])
    return ModalSet(id=one.id, frequency_hz=frequency, damping_ratio=damping, shape=shape,
                    frequency_std_hz=np.full(n_mode, np.nan), shape_std=np.full((n_channel, n_mode), np.nan),
                    environment=environment)


def unit_largest(shape: np.ndarray) -> np.ndarray:
    """Columns turned to lie along the real axis, the largest real part +1 (what imaginary part is left stays)."""
    real = rotate_to_real(shape)
    largest = np.argmax(np.abs(real.real), axis=0)
    return real / real.real[largest, np.arange(real.shape[1])]


def _pole_table(one: _Found, choice: Assignment, reference: ReferenceModes) -> pd.DataFrame:
    poles, like = one.poles, one.likeness
    mode = np.array(reference.labels, dtype=object)[like.best_mode]
    for label, pole in zip(reference.labels, choice.pole, strict=True):
        if pole >= 0:
            mode[pole] = label
    return pd.DataFrame({
        "time": one.start, "frequency_hz": poles.frequency_hz, "damping_ratio": poles.damping_ratio, "mpc": like.mpc,
        "mac": like.best_mac, "mode": mode, "similarity": like.similarity.max(axis=1), "stability": like.stability,
        "criterion": choice.criterion,
        "paper_criterion": one.paper,
    })


def _summary(found: list[_Found], data: ModalData, poles: pd.DataFrame, campaign: Campaign, rule: StateRule) -> str:
    used = [one for one in found if one.poles is not None]
    lines = [f"{len(used)} of {len(found)} blocks identified, {len(poles)} poles"]
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
