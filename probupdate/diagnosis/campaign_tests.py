"""What the raw records say against the measurement, for a diagnosis: mounting, clocks, scale, and the sampling rate.

A wrong sampling rate shifts every frequency by one share and leaves shapes alone: in modes it looks like a stiffer
tower. The rotor shows it, as its lines lie at multiples of the speed in SCADA.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from probupdate.campaign.blocks import block_files, read_block
from probupdate.campaign.checking import FEWEST_PIECES, HALF, ComparedBlock, compare_block
from probupdate.campaign.findings import (
    RATE_LIMIT,
    SIGMA,
    channel_findings,
    clock_findings,
    mounting_findings,
    rate_findings,
    runaway_clocks,
    scale_findings,
    sensor_findings,
)
from probupdate.campaign.heading import Sway, block_sway
from probupdate.campaign.reading import Campaign, RecordFile
from probupdate.campaign.rotor_lines import line_scores, rate_ratio
from probupdate.campaign.samples import channel_table
from probupdate.campaign.scada import StateRule, block_conditions, with_rated_power
from probupdate.campaign.sensor_findings import SensorFinding
from probupdate.diagnosis.results import Finding
from probupdate.modal.modes import ModalData
from probupdate.runtime.executors import LEAST_TASKS, SERIAL, Executor
from probupdate.runtime.progress import Progress, silent

# blocks read, evenly spread; those with a turning rotor from which lines are taken
MOST_BLOCKS = 48
# words of a sentence -> the catalogue's cause
CAUSES = (
    ("flipped", "sensor polarity"), ("swapped", "swapped channels"), ("turned by", "sensor rotation"),
    ("clock of", "clock offset"), ("true sampling rate", "sampling rate"), ("looks dead", "dead channel"),
    ("wrong unit or scale", "sensor gain"), ("gravity", "unit of all channels"),
    ("the top moves", "unit of all channels"),
)
# what sensors say of one another -> the catalogue's cause
MEASURED = {"gain": "sensor gain", "gain change": "sensor gain", "common gain": "sensor gain",
            "reference": "sensor gain", "nacelle heading": "nacelle heading"}


@dataclass(frozen=True, eq=False, kw_only=True)
class _BlockTests:
    """What one block's record shows: its state, its channels' table, what sensors say of one another, rotor lines, and
    which way it sways (None where it cannot be told)."""

    id: str
    state: str
    channels: pd.DataFrame
    compared: ComparedBlock | None
    lines: list[np.ndarray]
    sway: Sway | None


def _block_tests(
    campaign: Campaign, rule: StateRule, pieces: int, n_compared: int, start: pd.Timestamp,
    touching: tuple[RecordFile, ...],
) -> _BlockTests:
    block = read_block(campaign, start, touching)
    conditions = block_conditions(campaign.scada, block.start, block.minutes, rule)
    state = str(conditions["state"])
    rows = channel_table(block, campaign.channels)
    found = compare_block(campaign, block, state, conditions, rows, pieces=pieces, n_compared=n_compared)
    lines: list[np.ndarray] = []
    sway = None
    if campaign.scada is not None:
        lines = line_scores(block, campaign.scada)
        usable = (block.measured >= HALF) & ~rows["flat"].to_numpy(bool)
        sway = block_sway(block, campaign.sensors, usable, conditions)
    return _BlockTests(id=block.id, state=state, channels=rows, compared=found, lines=lines, sway=sway)


def campaign_tests(campaign: Campaign, *, runs: Executor = SERIAL, progress: Progress = silent) -> list[dict]:
    """Rows as in diagnosis.json's details: kind, cause, channels, statement; the sampling rate's has size and size_std
    too (share by which the records' clock runs fast), also where nothing is wrong with it (suspected: false). Blocks
    are read side by side on the executor `runs`."""
    rule = with_rated_power(StateRule(rated_power_kw=campaign.rated_power_kw), campaign.scada)
    files = list(block_files(campaign).items())
    chosen = np.unique(np.round(np.linspace(0, len(files) - 1, min(MOST_BLOCKS, len(files)))).astype(int))
    pieces = -(-FEWEST_PIECES // max(len(chosen), 1))
    progress("testing raw records", 0, len(chosen))
    blocks = runs.in_order(_block_tests, [files[k] for k in chosen], shared=(campaign, rule, pieces, len(chosen)),
                           least=LEAST_TASKS // 2,
                           ended=lambda count: progress("testing raw records", count, len(chosen)))
    table = pd.concat([b.channels for b in blocks], ignore_index=True)
    compared = [b.compared for b in blocks if b.compared is not None]
    sways = [b.sway for b in blocks if b.sway is not None]
    states = {b.id: b.state for b in blocks}
    ratio = rate_ratio([line for b in blocks for line in b.lines])
    own = channel_findings(table, campaign.sensors)
    sentences = [*own, *mounting_findings(compared, own, runaway_clocks(compared, campaign.channels)),
                 *clock_findings(compared, campaign.channels)[0]]
    sentences += scale_findings(table, states, campaign.sensors, sentences)
    measured, _ = sensor_findings(campaign, compared, sways, sentences)
    by_rate, agrees = rate_findings(campaign, ratio)
    rows = [_row(s, campaign.channels) for s in (*sentences, *by_rate)]
    rows += [finding_row(f, campaign.channels) for f in measured]
    if np.isfinite(ratio.ratio):
        of_lines = [r for r in rows if r["cause"] == "sampling rate" and "rotor" in r["statement"]]
        row = of_lines[0] if of_lines else {
            "kind": "measurement", "cause": "sampling rate", "channels": [], "statement": agrees or "rotor lines agree",
            "suspected": False}
        row |= {"size": 1 / ratio.ratio - 1, "size_std": ratio.std / ratio.ratio**2}
        rows += [] if of_lines else [row]
    return rows


def _row(sentence: str, channels: Sequence[str]) -> dict:
    cause = next((cause for words, cause in CAUSES if words in sentence), "samples")
    words = {w.strip(",;:()") for w in sentence.split()}
    return {"kind": "measurement", "cause": cause, "channels": [c for c in channels if c in words],
            "statement": sentence, "suspected": True}


def finding_row(found: SensorFinding, channels: Sequence[str]) -> dict:
    """With the size as the catalogue has it: a gain less one."""
    cause = MEASURED.get(found.name, "samples")
    size = found.size - 1 if cause == "sensor gain" else found.size
    return {"kind": "measurement", "cause": cause, "channels": [c for c in channels if c in found.channel.split(", ")],
            "statement": found.message, "suspected": True, "size": size, "size_std": found.std,
            "since": found.since}


def rate_finding(tests: Sequence[dict]) -> Finding | None:
    """The sampling rate as a finding, where the rotor's lines contradict it beyond model-error scale."""
    for row in tests:
        if row["cause"] == "sampling rate" and row["suspected"] and "size" in row:
            z = abs(row["size"]) / row["size_std"]
            if abs(row["size"]) > RATE_LIMIT and z > SIGMA:
                return Finding(
                    kind="measurement", cause="sampling rate", location="all channels", size=row["size"],
                    size_std=row["size_std"], unit="-", time_profile="constant", time_profile_start="", z=z,
                    posterior_probability=1.0, alternatives=(), check="the logger's clock against a reference; "
                    "the files' own start times",
                )
    return None


def with_true_rate(data: ModalData, finding: Finding) -> ModalData:
    """The modes as a clock without that error had given them."""
    factor = 1 + finding.size
    sets = tuple(replace(s, frequency_hz=s.frequency_hz * factor, frequency_std_hz=s.frequency_std_hz * factor)
                 for s in data.sets)
    return replace(data, sets=sets)
