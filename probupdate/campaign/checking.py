"""What a campaign holds, what is wrong with it and what can be done with it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from probupdate.campaign.blocks import (
    CONTRADICTION,
    LEAST_MEASURED,
    OVERLAP,
    PART,
    Block,
    block_files,
    block_starts,
    read_block,
)
from probupdate.campaign.clocks import Delays, apart, delays, drifts, far_delays, put_in_time
from probupdate.campaign.expected import expected_suspicions, is_expected
from probupdate.campaign.far_clocks import far_clock
from probupdate.campaign.findings import (
    LEAST_DELAY_S,
    ComparedBlock,
    apart_findings,
    channel_findings,
    clock_findings,
    mounting_findings,
    phase_findings,
    rate_findings,
    runaway_clocks,
    scale_findings,
    sensor_findings,
)
from probupdate.campaign.gain_steps import FEWEST_PIECES, number_of_lines, parts_of_block, whole_piece
from probupdate.campaign.heading import Sway, block_sway
from probupdate.campaign.mounting import DEAD, Suspicion, is_upright, lowest_motion_hz, suspicions
from probupdate.campaign.plausible import amplitude_spectrum, refuse_time, unit_findings
from probupdate.campaign.reading import Campaign
from probupdate.campaign.rigid_bodies import name_levels
from probupdate.campaign.rotor_lines import MOST_ROWS, line_scores, rate_ratio
from probupdate.campaign.samples import channel_table
from probupdate.campaign.scada import (
    ROW_MINUTES,
    StateRule,
    block_conditions,
    renaming,
    turning_range,
    with_rated_power,
)
from probupdate.campaign.scada_time import RecordRow, record_rows, time_findings
from probupdate.campaign.sensor_findings import SIGMA, SensorFinding
from probupdate.campaign.spectra import CrossSpectra, comparable_channels, convert_to_acceleration, cross_spectra
from probupdate.campaign.usable import leave_out, left_out_notes, no_block_remedy
from probupdate.io.files import sha256, write_json, write_table
from probupdate.io.result_table import plural, with_units
from probupdate.modal.conditions import COLUMNS, OF_TURBINES, SIMILAR, find_misnamed, of_turbine
from probupdate.modal.modes import Sensor
from probupdate.runtime.arrays import frozen_array
from probupdate.runtime.progress import Progress, silent

# what a column of SCADA is needed for
USES = {
    "power_kw": "turbine states (idling, below rated, rated)",
    "rotor_speed_rpm": "harmonics distinguished from modes, idling confirmed",
    "pitch_deg": "criterion 'no pitching'",
    "nacelle_heading_deg": "fore-aft and side-side as the nacelle turns, how far it turned within a block",
    "yaw_rate_degps": "criterion 'no yawing'",
    "wind_speed_mps": "wind over time",
    "water_level_m": "frequency against water level",
    "air_temperature_c": "frequency against temperature",
}
# channels are compared with one another in so many blocks, evenly spread over a longer campaign
MOST_COMPARED = 240
# and in so many where modes are identified whatever their clocks
FEW_COMPARED = 6
# the units of channels in so many, as each block says the same
MOST_SPECTRA = 24
# of a channel's samples, from which it is compared with others
HALF = 0.5


@dataclass(frozen=True, eq=False, kw_only=True)
class CampaignCheck:
    """table: a row per block and channel (see samples.channel_table) with delay_ms (how late it is, where compared)
    and suspicion; blocks: a row per block with id, state, excluded, notes; findings: what is wrong, in sentences, those
    that begin with 'suspect' inferred from other channels; measured: those of them that have a size, as values; uses:
    what can be done, in sentences; sha256: of the campaign.toml, so that what was found before a change is known."""

    campaign: str
    table: pd.DataFrame
    blocks: pd.DataFrame
    findings: tuple[str, ...]
    uses: tuple[str, ...]
    summary: str
    measured: tuple[SensorFinding, ...] = ()
    sha256: str = ""

    def with_finding(self, finding: str, use: str = "") -> CampaignCheck:
        """With a finding before the others and something that can be done, '' for none of either."""
        found, uses = (*filter(None, [finding]), *self.findings), (*self.uses, *filter(None, [use]))
        return replace(self, findings=found, uses=uses, summary=_summary(self.summary.splitlines()[0], found, uses))

    def to_frame(self) -> pd.DataFrame:
        """`table`: a row a block and channel; numbers about samples in SI units."""
        return with_units(self.table)

    def write(self, path: str | Path) -> Path:
        """JSON: campaign, findings, measured, uses, blocks, channels (a summary per channel); beside it
        `<stem>.channels.csv`, the table."""
        path = Path(path)
        content = {
            "campaign": self.campaign, "campaign_toml_sha256": self.sha256, "findings": list(self.findings),
            "measured": [asdict(f) for f in self.measured], "uses": list(self.uses),
            "blocks": self.blocks.to_dict("records"), "channels": _records(_per_channel(self.table)),
        }
        write_json(path, content)
        write_table(path.with_name(f"{path.stem}.channels.csv"), self.table)
        return path


def check(
    campaign: Campaign, *, modes: tuple[np.ndarray, np.ndarray] | None = None, progress: Progress = silent,
) -> CampaignCheck:
    """Read every block once and say what was found; nothing is changed. modes: of a model of the structure, by
    frequencies and readings (`expected_suspicions`); what is suspected of them too is no fault."""
    expected = [] if modes is None else expected_suspicions(*modes, campaign.sensors)
    rule = with_rated_power(StateRule(rated_power_kw=campaign.rated_power_kw), campaign.scada)
    files = block_files(campaign)
    stride = -(-len(files) // MOST_COMPARED)
    n_compared = max(-(-len(files) // stride), 1)
    pieces = -(-FEWEST_PIECES // n_compared)
    tables, heads, compared, lines, sways, amplitudes, timed = [], [], [], [], [], [], []
    cleared: set[str] = set()
    for number, (start, touching) in enumerate(files.items()):
        progress("checking blocks", number, len(files))
        block = read_block(campaign, start, touching)
        conditions = block_conditions(campaign.scada, block.start, block.minutes, rule)
        state = str(conditions["state"])
        refuse_time(f"{campaign.path}, block {block.id}", campaign.channels, block.data)
        rows = channel_table(block, campaign.channels)
        if number % -(-len(files) // MOST_SPECTRA) == 0 and (found := amplitude_spectrum(block)) is not None:
            amplitudes.append(found)
        if number % stride == 0:
            found = compare_block(campaign, block, state, conditions, rows, pieces=pieces, n_compared=n_compared)
            if found is not None and expected:
                found = _without_expected(found, expected, cleared)
            rows = rows.assign(delay_ms=np.nan if found is None else 1e3 * found.delay_s,
                               suspicion=_suspicions_by_channel(campaign, found))
            compared += [] if found is None else [found]
            if campaign.scada is not None and len(lines) < MOST_ROWS:
                lines += line_scores(block, campaign.scada)
            if campaign.scada is not None and len(timed) < MOST_ROWS:
                timed += record_rows(block)
            if campaign.scada is not None:
                usable = (block.measured >= HALF) & ~rows["flat"].to_numpy(bool)
                sway = block_sway(block, campaign.sensors, usable, conditions)
                sways += [] if sway is None else [sway]
        tables.append(rows)
        heads.append({"id": block.id, "state": state, "excluded": block.excluded, "notes": "; ".join(block.notes)})
    progress("checking blocks", len(files), len(files))
    table, head = pd.concat(tables, ignore_index=True), pd.DataFrame(heads)
    findings, able, measured = _findings(campaign, table, head, compared, rate_ratio(lines), sways)
    vibration = table.groupby("channel")["vibration"].median().to_dict()
    findings = (*findings, *unit_findings(amplitudes, campaign.sensors, vibration, findings),
                *time_findings(timed, campaign.scada))
    uses = (*_uses(campaign, head, table), *able)
    uses = (*uses, *_cleared_words(cleared))
    most = comparable_channels(campaign.sampling_rate_hz, 0.4 * campaign.sampling_rate_hz)
    if len(campaign.sensors) > most:
        uses = (*uses, f"channels were not compared with one another: {len(campaign.sensors)} are more than the {most} "
                "whose spectra memory holds; leave_out in campaign.toml takes some away")
    elif stride > 1:
        uses = (*uses, f"channels were compared with one another in every {stride}th block")
    summary = _summary(
        f"{campaign.name}: {plural(len(campaign.sensors), 'channel')} at {campaign.sampling_rate_hz:g} Hz, "
        f"{plural(len(campaign.files), 'file')}, {plural(len(head), 'block')} of {campaign.block_minutes:g} minutes",
        findings, uses)
    return CampaignCheck(
        campaign=campaign.name, table=table, blocks=head, findings=findings, uses=uses, summary=summary,
        measured=measured, sha256=sha256(campaign.path / "campaign.toml"),
    )


def _without_expected(found: ComparedBlock, expected: Sequence[Suspicion], cleared: set[str]) -> ComparedBlock:
    """Without suspicions that the model's modes raise too, which are added to those `cleared`."""
    odd = tuple(s for s in found.suspicions if not is_expected(s, expected))
    cleared |= {f"{c} ({s.kind})" for s in found.suspicions if s not in odd for c in s.channels}
    return replace(found, suspicions=odd)


def _cleared_words(cleared: set[str]) -> list[str]:
    return [f"looks odd beside other channels, but no more than by the model's modes: {', '.join(sorted(cleared))}"
            ] if cleared else []


def _summary(head: str, findings: Sequence[str], uses: Sequence[str]) -> str:
    return "\n".join([head, *(f"found: {t}" for t in findings), *(f"note: {t}" for t in uses)])


def compare_block(
    campaign: Campaign, block: Block, state: str, conditions: Mapping, rows: pd.DataFrame, *, pieces: int = 0,
    n_compared: int = MOST_COMPARED,
) -> ComparedBlock | None:
    """One block's channels against one another; None where the block's samples do not allow it. Channels of which
    more than half is lost, and those that stand still, are left out. pieces: parts whose cross-spectra are kept (0:
    none), as one of n_compared blocks."""
    n = len(campaign.sensors)
    usable = (block.measured >= HALF) & ~rows["flat"].to_numpy(bool)
    if usable.sum() < 2:
        return None
    rate = block.sampling_rate_hz
    sensors = name_levels([s for s, ok in zip(campaign.sensors, usable, strict=True) if ok])
    in_time = _check_in_time(block.data[:, usable], rate, sensors, _rotor_bands(conditions))
    if in_time is None:
        return None
    data, spectra, clocks = np.full(block.data.shape, np.nan), in_time.spectra, np.full((4, n), np.nan)
    data[:, usable], clocks[:, usable] = in_time.data, (in_time.delay_s, in_time.std_s, in_time.drift, in_time.apart)
    moves = np.flatnonzero(np.einsum("fii->i", np.real(spectra.density)) > 0)
    lowest = lowest_motion_hz(spectra, sensors, [int(k) for k in moves])
    kept = ()
    if pieces == 1:
        kept = (whole_piece(block.id, spectra, usable, number_of_lines(n, n_compared)),)
    elif pieces:
        kept = tuple(parts_of_block(block.id, data, rate, campaign.sensors, usable, pieces,
                                    number_of_lines(n, n_compared * pieces)))
    return ComparedBlock(id=block.id, start=block.start, state=state, suspicions=tuple(suspicions(spectra, sensors)),
                         delay_s=clocks[0], delay_std_s=clocks[1], drift=clocks[2], apart=clocks[3] == 1, pieces=kept,
                         lowest_hz=np.nan if lowest is None else lowest)


@dataclass(frozen=True, eq=False, kw_only=True)
class _InTime:
    """A block's channels as right clocks would have recorded them, data (n_sample, n_channel) with their cross-spectra
    as accelerations, and what was wrong: delay_s in the middle of the block with std_s, drift in s per s, and what is
    `apart` from the others, (n_channel,)."""

    data: np.ndarray
    spectra: CrossSpectra
    delay_s: np.ndarray
    std_s: np.ndarray
    drift: np.ndarray
    apart: np.ndarray


def _check_in_time(data: np.ndarray, rate: float, sensors: tuple[Sensor, ...], avoid_hz: np.ndarray) -> _InTime | None:
    """Signs, gains and places are judged beside right clocks; None where the samples do not allow it."""

    def compared(moved: np.ndarray) -> tuple[CrossSpectra, Delays] | None:
        spectra = cross_spectra(moved, rate, 0.4 * rate)
        if spectra is None:
            return None
        spectra = convert_to_acceleration(spectra, sensors)
        return spectra, delays(spectra, sensors, avoid_hz)

    if (found := compared(data)) is None:
        return None
    drift, far, moved = np.zeros(len(sensors)), np.zeros(len(sensors)), data
    alone = np.isnan(found[1].delay_s) | apart(found[1], sensors)
    if alone.any() and not alone.all():
        drift = np.nan_to_num(drifts(data, rate, 0.4 * rate, sensors, alone))
        far = np.where(drift == 0, np.nan_to_num(far_delays(data, rate, sensors, alone)), 0.0)
        if drift.any() or far.any():
            moved = put_in_time(data, rate, far, drift)
            found = compared(moved) or found
    spectra, late = found
    late = replace(late, delay_s=frozen_array(late.delay_s + far))
    away = np.abs(late.delay_s) > np.maximum(LEAST_DELAY_S, SIGMA * late.std_s)
    if away.any():
        moved = put_in_time(data, rate, np.where(away, late.delay_s, 0.0), drift)
        spectra, _ = compared(moved) or found
    if (lost := (drift != 0) & np.isnan(late.delay_s)).any():
        # as a channel that does not move: nothing is known of its sign beside the others
        sound = np.where(lost, 0.0, 1.0)
        spectra = replace(spectra, density=frozen_array(spectra.density * np.outer(sound, sound), complex))
    return _InTime(data=moved, spectra=spectra, delay_s=late.delay_s, std_s=late.std_s, drift=drift,
                   apart=apart(late, sensors))


def _rotor_bands(conditions: Mapping) -> np.ndarray:
    """(n_band, 2) Hz that the rotor's harmonics sweep during a block."""
    low, high = turning_range(conditions)
    if not (np.isfinite(low) and np.isfinite(high) and high > 3):
        return np.zeros((0, 2))
    return np.array([[n * low / 60 - 0.05, n * high / 60 + 0.05] for n in (1, *range(3, 19, 3))])


def _suspicions_by_channel(campaign: Campaign, found: ComparedBlock | None) -> list[str]:
    """(n_channel,) what one block suspects of each channel."""
    if found is None:
        return [""] * len(campaign.sensors)
    return [", ".join(s.kind for s in found.suspicions if c in s.channels) for c in campaign.channels]


def _lone_findings(campaign: Campaign, compared, mentioned: Sequence[str], away: Collection[str]) -> list[str]:
    """`mounting_findings` and `apart_findings`, with the clock or the rate by which a channel fits the others."""
    found = mounting_findings(compared, mentioned, away, lambda channel: far_clock(campaign, channel))
    return [*found, *apart_findings(compared, campaign.channels, found, away, partial(far_clock, campaign))]


def suspected_clocks(campaign: Campaign) -> list[str]:
    """What `check` would say of clocks and of channels that have nothing in common with others, by a few blocks."""
    files = block_files(campaign)
    compared = []
    for start in list(files)[:: -(-len(files) // FEW_COMPARED)]:
        block = read_block(campaign, start, files[start])
        conditions = block_conditions(campaign.scada, block.start, block.minutes, StateRule())
        found = compare_block(campaign, block, "", conditions, channel_table(block, campaign.channels))
        if found is not None:
            compared.append(replace(found, suspicions=tuple(s for s in found.suspicions if s.kind == DEAD)))
    away = runaway_clocks(compared, campaign.channels)
    lone = _lone_findings(campaign, compared, [], away)
    return [*lone, *phase_findings(compared, campaign.channels, lone, away),
            *clock_findings(compared, campaign.channels)[0]]


def suspected_time(campaign: Campaign) -> list[str]:
    """`time_findings` of a campaign's records: of its first ten-minute rows, as `check` looks at them."""
    if campaign.scada is None:
        return []
    rows: list[RecordRow] = []
    for start, files in block_files(campaign).items():
        if len(rows) >= MOST_ROWS:
            break
        rows += record_rows(read_block(campaign, start, files))
    return time_findings(rows, campaign.scada)


def _findings(
    campaign, table, head, compared, ratio, sways: list[Sway]
) -> tuple[tuple[str, ...], tuple[str, ...], tuple[SensorFinding, ...]]:
    """What is wrong, what the comparisons can show, and the findings that have a size."""
    ends = head["id"][head["excluded"].str.startswith(PART)]
    # what is cut off at the end of a recording says nothing of a channel
    whole = table[~table["id"].isin(ends)]
    single = [*channel_findings(whole if len(whole) else table, campaign.sensors), *_quantities(campaign)]
    states = dict(zip(head["id"], head["state"], strict=True))
    clocks, clock_use = clock_findings(compared, campaign.channels)
    rates, rate_use = rate_findings(campaign, ratio)
    # what is late by seconds has no gain against the others, and may have nothing in common with them
    away = runaway_clocks(compared, campaign.channels)
    single += _lone_findings(campaign, compared, single, away)
    single += phase_findings(compared, campaign.channels, single, away)
    measured, able = sensor_findings(campaign, compared, sways, single)
    measured = [f for f in measured if f.channel not in away]
    findings = (
        *_coverage(campaign, head), *single, *(f.message for f in measured), *clocks, *rates,
        *scale_findings(table, states, campaign.sensors, single), *_scada_findings(campaign),
    )
    measured += [SensorFinding(name="sampling rate", channel=", ".join(campaign.channels), size=1 / ratio.ratio,
                               std=ratio.std / ratio.ratio**2, message=text) for text in rates if "rotor" in text]
    return findings, tuple(u for u in (clock_use, rate_use, *able) if u is not None), tuple(measured)


def _coverage(campaign: Campaign, head: pd.DataFrame) -> list[str]:
    found = []
    starts = block_starts(campaign)
    span = round((starts[-1] - starts[0]) / pd.Timedelta(minutes=campaign.block_minutes)) + 1
    if len(starts) < span:
        found.append(f"{span - len(starts)} of {span} blocks between the first and the last have no record")
    part = head["excluded"].str.startswith(PART)
    gone = (head["excluded"] != "") & ~part
    if advice := no_block_remedy(campaign):
        found.append(f"no record covers a whole block: {advice}")
    elif gone.any():
        found.append(f"{plural(int(gone.sum()), 'block')} in which a channel was hardly measured, not used: "
                     f"{', '.join(head['id'][gone][:6])}" + (" and more" if gone.sum() > 6 else ""))
    if part.any() and not advice:
        found.append(f"{plural(int(part.sum()), 'block')} at the ends of recordings, shorter than the others, not used")
    for text in (OVERLAP, CONTRADICTION):
        has = head["id"][[text in notes.split("; ") for notes in head["notes"]]]
        found += [f"in {len(has)} of {len(head)} blocks, first {has.iloc[0]}, {text}"] if len(has) else []
    return found


def _per_channel(table: pd.DataFrame) -> pd.DataFrame:
    grouped = table.groupby("channel", sort=False)
    return grouped.agg(missing=("missing", "mean"), impossible=("impossible", "sum"),
                       repeated=("repeated", "mean"), filled=("filled", "mean"),
                       rms=("rms", "median"), offset=("offset", "median"), spikes=("spikes", "sum"),
                       clipped=("clipped", "sum"), flat_blocks=("flat", "sum")).reset_index()


def _records(table: pd.DataFrame) -> list[dict]:
    """Rows as JSON has them: null for what is not a number."""
    return [{k: (None if isinstance(v, float) and not np.isfinite(v) else v) for k, v in row.items()}
            for row in table.to_dict("records")]


def _quantities(campaign: Campaign) -> list[str]:
    quantities = {s.quantity for s in campaign.sensors}
    if len(quantities) < 2:
        return []
    return [f"channels measure different quantities ({', '.join(sorted(quantities))}): they are brought to one before "
            "modes are identified"]


def _scada_findings(campaign: Campaign) -> list[str]:
    turbine = campaign.rated_power_kw is not None or is_upright(campaign.sensors)
    if campaign.scada is None:
        return ["no scada.csv: nothing is known of wind and temperature"
                + (", nor of a turbine's operation (states, harmonics)" if turbine else "")]
    turbine = turbine or of_turbine(campaign.scada.columns)
    missing = [c for c in COLUMNS if c not in campaign.scada and (turbine or c not in OF_TURBINES)]
    similar = find_misnamed(campaign.scada.columns, SIMILAR)
    found = [*campaign.scada.attrs.get("notes", ())]
    found += [f"SCADA has no {c}{renaming(similar.get(c))}; it is needed for: {USES[c]}" for c in missing if c in USES]
    index = campaign.scada.index
    span = round((index[-1] - index[0]) / pd.Timedelta(minutes=ROW_MINUTES)) + 1 if len(index) else 0
    if len(index) < span:
        found.append(f"{span - len(index)} of {span} SCADA rows are missing")
    if not len(index):
        found.append("SCADA has a header and no rows")
    elif not _scada_overlaps(campaign):
        rows, block = (f"{time:%Y-%m-%dT%H:%MZ}" for time in (index[0], block_starts(campaign)[0]))
        found.append(f"no SCADA row lies within the records: the first row is of {rows}, the first block of {block}; "
                     "check year and time zone of both")
    doubled = campaign.scada.attrs.get("contradicted", 0)
    if doubled:
        found.append(f"{plural(doubled, 'SCADA row')} with the time of an earlier one and other values; the first was "
                     "kept: a clock set back, or local time?")
    return found


def _scada_overlaps(campaign: Campaign) -> bool:
    """Whether any row lies between the first block's start and the last one's end."""
    starts, index = block_starts(campaign), campaign.scada.index
    end = starts[-1] + pd.Timedelta(minutes=campaign.block_minutes)
    return bool(((index > starts[0] - pd.Timedelta(minutes=ROW_MINUTES)) & (index < end)).any())


def _uses(campaign: Campaign, head: pd.DataFrame, table: pd.DataFrame) -> tuple[str, ...]:
    # as identification takes them: every channel measured, and none without any signal
    known = 1 - table["missing"] - table["repeated"] - table["filled"]
    spoilt = table[(known < LEAST_MEASURED) | table["flat"]]
    good = (head["excluded"] == "") & ~head["id"].isin(spoilt["id"][spoilt["flat"]])
    uses = [f"{plural(int(good.sum()), 'block')} can be identified"]
    few = max(1, len(campaign.channels) // 3)
    alone = Counter(c for c in spoilt.groupby("id")["channel"].agg(tuple) if len(c) <= few < len(campaign.channels))
    uses += [f"{n} more can be identified without {', '.join(channels)}: {leave_out(channels)}"
             for channels, n in alone.most_common(3)]
    uses += left_out_notes(campaign.left_out)
    states = Counter(head["state"][good])
    if set(states) - {"unknown"}:
        uses.append("states of these: " + ", ".join(f"{n} {name}" for name, n in states.most_common()))
    if campaign.scada is not None and _scada_overlaps(campaign):
        allowed = [text for column, text in USES.items() if column in campaign.scada]
        uses += [f"SCADA serves for: {'; '.join(allowed)}"] if allowed else []
    return tuple(uses)
