"""Why no block of a campaign can be used, what to change in campaign.toml, and which channels it leaves out."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence

import numpy as np
import pandas as pd

from probupdate.campaign.blocks import LEAST_MEASURED, Block, block_files, count_held_blocks, read_block, recordings
from probupdate.campaign.gaps import zero_filled
from probupdate.campaign.reading import Campaign

# blocks that are read again for the advice, evenly over the campaign
LOOKED_AT = 24
# how a sentence begins on channels that a model has and the campaign has not, and how many it names
LACKING, MOST_NAMED = "the campaign has no", 12


def leave_out(channels: Sequence[str]) -> str:
    """The advice to do without some channels."""
    return f"write leave_out = {json.dumps(list(channels), ensure_ascii=False)} into campaign.toml"


def left_out_notes(channels: Sequence[str]) -> list[str]:
    """What a step says of the channels that it was not to use; [] without any."""
    return [f"{', '.join(channels)} left out, as campaign.toml says"] if channels else []


def lacking_notes(channels: Sequence[str], campaigns: Sequence[Campaign]) -> list[str]:
    """What a step says of a model's channels that no [[sensor]] of the campaigns is; [] where each is, or none, as the
    model's own sensors are then other ones."""
    known = {name for c in campaigns for name in (*c.channels, *c.left_out)}
    lacking = [name for name in channels if name not in known]
    if not 0 < len(lacking) < len(channels):
        return []
    more = f" and {len(lacking) - MOST_NAMED} more" if len(lacking) > MOST_NAMED else ""
    return [f"{LACKING} {', '.join(lacking[:MOST_NAMED])}{more}, of {len(channels)} channels of the model: where it "
            "was measured, add its [[sensor]] to campaign.toml"]


def remedy(campaign: Campaign) -> str:
    """What to do where none of the campaign's blocks can be used."""
    if text := no_block_remedy(campaign):
        return text
    files = block_files(campaign)
    starts = list(files)
    some = [starts[int(k)] for k in np.linspace(0, len(starts) - 1, min(LOOKED_AT, len(starts)))]
    spoilt = [_unusable_channels(read_block(campaign, start, files[start])) for start in some]
    alone, count = Counter(spoilt).most_common(1)[0]
    if not 0 < len(alone) < len(campaign.channels):
        return "run `probupdate check` to see what is missing"
    return f"{leave_out([campaign.channels[k] for k in alone])}: {count} of {len(some)} blocks can be used without it"


def _unusable_channels(block: Block) -> tuple[int, ...]:
    """Columns that were hardly measured, or without any signal."""
    lost = block.measured < LEAST_MEASURED
    still = np.zeros(len(lost), bool)
    still[~lost] = np.ptp(zero_filled(block.data[:, ~lost]), axis=0) == 0
    return tuple(int(k) for k in np.flatnonzero(lost | still))


def no_block_remedy(campaign: Campaign) -> str:
    """What to do where no record holds a whole block; empty where one does."""
    length, own = pd.Timedelta(minutes=campaign.block_minutes), recordings(campaign)
    if any(count_held_blocks(one, length.value) for one in own):
        return ""
    minutes = max(one.end - one.start for one in own).total_seconds() / 60
    return (f"set block_minutes in campaign.toml to {_round_down(minutes):g} or less: the longest record is of "
            f"{minutes:.3g} minutes")


def _round_down(value: float) -> float:
    """To a whole number of minutes, or two digits below ten."""
    return float(np.floor(value)) if value >= 10 else float(np.floor(10 * value) / 10)
