"""Why no block of a campaign can be used, and what to change in campaign.toml."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence

import numpy as np
import pandas as pd

from probupdate.campaign.blocks import Block, block_files, read_block
from probupdate.campaign.reading import Campaign

# blocks that are read again for the advice, evenly over the campaign
LOOKED_AT = 24


def leave_out(channels: Sequence[str]) -> str:
    """The advice to do without some channels."""
    return f"write leave_out = {json.dumps(list(channels), ensure_ascii=False)} into campaign.toml"


def remedy(campaign: Campaign) -> str:
    """What to do where none of the campaign's blocks can be used."""
    if text := uncovered(campaign):
        return text
    files = block_files(campaign)
    starts = list(files)
    some = [starts[int(k)] for k in np.linspace(0, len(starts) - 1, min(LOOKED_AT, len(starts)))]
    spoilt = [_spoilt(read_block(campaign, start, files[start])) for start in some]
    alone, count = Counter(spoilt).most_common(1)[0]
    if not 0 < len(alone) < len(campaign.channels):
        return "run `probupdate check` to see what is missing"
    return f"{leave_out([campaign.channels[k] for k in alone])}: {count} of {len(some)} blocks can be used without it"


def _spoilt(block: Block) -> tuple[int, ...]:
    """Columns with a gap too long to repair or without any signal."""
    lost = np.any(np.isnan(block.data), axis=0)
    still = np.zeros(len(lost), bool)
    still[~lost] = np.ptp(block.data[:, ~lost], axis=0) == 0
    return tuple(int(k) for k in np.flatnonzero(lost | still))


def uncovered(campaign: Campaign) -> str:
    """What to do where no record holds a whole block; empty where one does."""
    length = pd.Timedelta(minutes=campaign.block_minutes)
    sample = pd.Timedelta(seconds=1 / campaign.sampling_rate_hz)
    # blocks lie on the clock: of at most half a record's length, one lies within it wherever it begins
    longest = pd.Timedelta(0)
    begin = end = None
    for file in campaign.files:
        if end is None or file.start > end + sample / 2:
            begin = file.start
            end = begin
        end = max(end, file.start + file.n_sample * sample)
        longest = max(longest, end - begin)
        first = (begin + sample / 2 - pd.Timestamp(0, tz="UTC")) // length
        block = pd.Timestamp(0, tz="UTC") + first * length
        block += length if block < begin - sample / 2 else pd.Timedelta(0)
        if block + length <= end + sample / 2:
            return ""
    minutes = longest.total_seconds() / 60
    return (f"set block_minutes in campaign.toml to {_round_down(minutes / 2):g} or less: the longest record is of "
            f"{minutes:.3g} minutes, and blocks of {campaign.block_minutes:g} minutes begin on the clock")


def _round_down(value: float) -> float:
    """To a whole number of minutes, or two digits below ten."""
    return float(np.floor(value)) if value >= 10 else float(np.floor(10 * value) / 10)
