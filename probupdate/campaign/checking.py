"""What a campaign holds, what is wrong with it and what can be done with it."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from probupdate.campaign.blocks import Block, block_starts, blocks
from probupdate.campaign.reading import Campaign
from probupdate.campaign.scada import COLUMNS, StateRule, block_conditions, with_rated_power
from probupdate.progress import Progress, silent

# what a column of SCADA is needed for
USES = {
    "power_kw": "turbine states (idling, below rated, rated)",
    "rotor_speed_rpm": "harmonics told from modes; idling confirmed",
    "pitch_deg": "criterion 'no pitching'",
    "nacelle_heading_deg": "fore-aft and side-side told apart as the nacelle turns; criterion 'no yawing'",
    "yaw_rate_degps": "criterion 'no yawing'",
    "wind_speed_mps": "wind and state over time (Fig. 4)",
    "water_level_m": "frequency against water level",
    "air_temperature_c": "frequency against temperature",
}
# a spike is this many robust deviations off its channel's median and this many times what surrounds it within half a
# second: an impact on the structure rings, a fault of the logger does not
SPIKE_DEVIATIONS, SPIKE_ALONE = 12.0, 4.0
# the extreme value taken by more than so many samples in a row is a stop
CLIP_RUN = 4
# a record of m/s2 given in g looks 10 times too small: channels of one direction are compared with each other
SCALE_FACTOR = 8.0


@dataclass(frozen=True, eq=False, kw_only=True)
class CampaignCheck:
    """table: a row per block and channel with missing (share), repaired (samples), rms (SI), spikes, clipped
    (samples), flat; blocks: a row per block with id, state, excluded; findings: what is wrong, in sentences; uses:
    what can be done, in sentences."""

    campaign: str
    table: pd.DataFrame
    blocks: pd.DataFrame
    findings: tuple[str, ...]
    uses: tuple[str, ...]
    summary: str

    def write(self, path: str | Path) -> Path:
        """JSON: campaign, findings, uses, blocks, channels (a summary per channel)."""
        path = Path(path)
        content = {
            "campaign": self.campaign, "findings": list(self.findings), "uses": list(self.uses),
            "blocks": self.blocks.to_dict("records"), "channels": _per_channel(self.table).to_dict("records"),
        }
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(content, indent=1))
        return path


def check(campaign: Campaign, *, progress: Progress = silent) -> CampaignCheck:
    """Read every block once and say what was found; nothing is changed."""
    rule = with_rated_power(StateRule(rated_power_kw=campaign.rated_power_kw), campaign.scada)
    total, rows, heads, notes = len(block_starts(campaign)), [], [], Counter()
    for number, block in enumerate(blocks(campaign)):
        progress("checking blocks", number, total)
        rows.append(_channel_rows(campaign, block))
        state = block_conditions(campaign.scada, block.start, block.minutes, rule)["state"]
        heads.append({"id": block.id, "state": str(state), "excluded": block.excluded, "notes": "; ".join(block.notes)})
        notes.update(["overlap"] * any("two files" in n for n in block.notes))
    progress("checking blocks", total, total)
    table, head = pd.concat(rows, ignore_index=True), pd.DataFrame(heads)
    findings = (*_coverage(campaign, head, notes), *_channel_findings(campaign, table), *_scada_findings(campaign))
    uses = _uses(campaign, head)
    summary = "\n".join([
        f"{campaign.name}: {len(campaign.sensors)} channels at {campaign.sampling_rate_hz:g} Hz, {len(campaign.files)} "
        f"files, {len(head)} blocks of {campaign.block_minutes:g} minutes",
        *(f"found: {t}" for t in findings), *(f"can do: {t}" for t in uses),
    ])
    return CampaignCheck(
        campaign=campaign.name, table=table, blocks=head, findings=findings, uses=uses, summary=summary
    )


def _channel_rows(campaign: Campaign, block: Block) -> pd.DataFrame:
    data = block.data
    known = np.isfinite(data).any(axis=0)
    centre, spread, rms = (np.full(data.shape[1], np.nan) for _ in range(3))
    centre[known] = np.nanmedian(data[:, known], axis=0)
    away = np.abs(data - centre)
    spread[known] = 1.4826 * np.nanmedian(away[:, known], axis=0)
    rms[known] = np.sqrt(np.nanmean((data[:, known] - centre[known]) ** 2, axis=0))
    flat = np.array([np.nanmax(c) == np.nanmin(c) if k else False for c, k in zip(data.T, known, strict=True)])
    spikes = [_spikes(a, s, campaign.sampling_rate_hz) for a, s in zip(away.T, spread, strict=True)]
    return pd.DataFrame({
        "id": block.id, "channel": campaign.channels, "missing": block.missing, "repaired": block.repaired, "rms": rms,
        "offset": centre, "spikes": spikes, "clipped": [_clipped(c) for c in data.T], "flat": flat,
    })


def _spikes(away: np.ndarray, spread: float, rate_hz: float) -> int:
    """Samples, or two in a row, that stand alone; away (n_sample,) distance from the median."""
    reach, count = max(int(rate_hz / 2), 3), 0
    candidates = np.flatnonzero(away > SPIKE_DEVIATIONS * spread) if spread > 0 else ()
    for k in candidates:
        around = np.concatenate([away[max(k - reach, 0): max(k - 1, 0)], away[k + 2: k + reach]])
        around = around[np.isfinite(around)]
        count += bool(len(around)) and bool(away[k] > SPIKE_ALONE * around.max())
    return count


def _clipped(column: np.ndarray) -> int:
    """Samples that stand at the record's own largest or smallest value for at least CLIP_RUN in a row."""
    column = column[np.isfinite(column)]
    if not len(column) or np.ptp(column) == 0:
        return 0
    count = 0
    for limit in (column.max(), column.min()):
        edge = np.flatnonzero(np.diff(np.concatenate([[0], (column == limit).astype(int), [0]])))
        runs = edge[1::2] - edge[::2]
        count += int(runs[runs >= CLIP_RUN].sum())
    return count


def _coverage(campaign: Campaign, head: pd.DataFrame, notes: Counter) -> list[str]:
    found = []
    starts = block_starts(campaign)
    span = round((starts[-1] - starts[0]) / pd.Timedelta(minutes=campaign.block_minutes)) + 1
    if len(starts) < span:
        found.append(f"{span - len(starts)} of {span} blocks between the first and the last have no record")
    gone = head["excluded"] != ""
    if gone.any():
        found.append(f"{int(gone.sum())} blocks have gaps too long to repair: {', '.join(head['id'][gone][:6])}"
                     + (" and more" if gone.sum() > 6 else ""))
    if notes["overlap"]:
        found.append(f"files overlap in {notes['overlap']} blocks; the file that starts first is used")
    return found


def _per_channel(table: pd.DataFrame) -> pd.DataFrame:
    grouped = table.groupby("channel", sort=False)
    return grouped.agg(missing=("missing", "mean"), repaired=("repaired", "sum"), rms=("rms", "median"),
                       offset=("offset", "median"), spikes=("spikes", "sum"), clipped=("clipped", "sum"),
                       flat_blocks=("flat", "sum")).reset_index()


def _channel_findings(campaign: Campaign, table: pd.DataFrame) -> list[str]:
    found, per = [], _per_channel(table)
    n_block = table["id"].nunique()
    for row in per.itertuples():
        if row.flat_blocks:
            found.append(f"{row.channel} is flat in {row.flat_blocks} of {n_block} blocks")
        if row.spikes:
            found.append(f"{row.channel} has {row.spikes} spikes above {SPIKE_DEVIATIONS:g} robust deviations")
        if row.clipped:
            found.append(f"{row.channel} stands at its extreme value for {row.clipped} samples: clipped")
        if row.missing > 0.02:
            found.append(f"{row.channel} lacks {100 * row.missing:.1f} % of its samples")
    rms = per["rms"].to_numpy(float)
    for k, sensor in enumerate(campaign.sensors):
        peers = [i for i, s in enumerate(campaign.sensors)
                 if i != k and s.level == sensor.level and abs(float(s.direction @ sensor.direction)) > 0.9]
        if len(peers) >= 2 and rms[k] > 0:
            ratio = rms[k] / np.median(rms[peers])
            if not 1 / SCALE_FACTOR < ratio < SCALE_FACTOR:
                found.append(
                    f"{sensor.channel} moves {ratio:.3g} times as much as channels beside it: wrong unit or scale?"
                )
    quantities = {s.quantity for s in campaign.sensors}
    if len(quantities) > 1:
        names = ", ".join(sorted(quantities))
        found.append(f"channels measure different quantities ({names}): convert before identifying")
    return found


def _scada_findings(campaign: Campaign) -> list[str]:
    if campaign.scada is None:
        return ["no scada.csv: states, yawing, pitching and harmonics cannot be told"]
    missing = [c for c in COLUMNS if c not in campaign.scada]
    found = [f"SCADA has no {c}: no {USES[c]}" for c in missing if c in USES]
    index = campaign.scada.index
    span = round((index[-1] - index[0]) / pd.Timedelta(minutes=10)) + 1 if len(index) else 0
    if len(index) < span:
        found.append(f"{span - len(index)} of {span} SCADA rows are missing")
    return found


def _uses(campaign: Campaign, head: pd.DataFrame) -> tuple[str, ...]:
    good = head["excluded"] == ""
    one_quantity = len({s.quantity for s in campaign.sensors}) == 1
    uses = [f"identify {int(good.sum())} blocks"] if one_quantity and good.any() else []
    states = Counter(head["state"][good])
    if campaign.scada is not None:
        uses.append("states of these: " + ", ".join(f"{n} {name}" for name, n in states.most_common()))
        uses += dict.fromkeys(text for column, text in USES.items() if column in campaign.scada)
    return tuple(uses)
