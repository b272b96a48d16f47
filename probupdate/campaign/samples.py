"""One block, channel by channel: what its samples alone show."""

from __future__ import annotations

import numpy as np
import pandas as pd

from probupdate.campaign.blocks import Block
from probupdate.campaign.gaps import find_lone_samples, runs

# a spike stands this many robust standard deviations above its channel's median or its neighbours' second differences
SPIKE_STD = 12.0
# the extreme value taken by more than so many samples in a row is a stop, if it is taken so many times more often than
# the value next to it (a coarse converter repeats every value)
CLIP_RUN, CLIP_PILE = 4, 3.0
# the same value for so long, and for so many samples, is a sensor that stands still
STILL_S, STILL_SAMPLES = 1.0, 20
# drift over a block, between the means of its first and last tenth, in multiples of the vibration's own standard
# deviation
PARTS = 10


def channel_table(block: Block, channels: tuple[str, ...]) -> pd.DataFrame:
    """A row per channel: missing, repeated, filled (shares), impossible (samples) and marker (see `Block`),
    longest_gap_s, rms and offset (SI, about the median), lowest and highest (SI), drift, wander and vibration (SI: the
    mean of the last tenth less that of the first, the range of the tenths' means, the standard deviation about them),
    spikes and clipped (samples), still_s (longest run of one value), flat."""
    data, rate = block.data, block.sampling_rate_hz
    n_channel = data.shape[1]
    known = np.isfinite(data)
    columns = {name: np.full(n_channel, np.nan) for name in (
        "rms", "offset", "lowest", "highest", "drift", "wander", "vibration")}
    counts = {"spikes": np.zeros(n_channel, int) + block.spikes, "clipped": np.zeros(n_channel, int)}
    still, gap, flat = np.zeros(n_channel), np.zeros(n_channel), np.zeros(n_channel, bool)
    whole = np.all(known, axis=0)
    for c in range(n_channel):
        column = np.ascontiguousarray(data[:, c])
        if not whole[c]:
            starts, ends = runs(~known[:, c])
            gap[c] = np.max(ends - starts) / rate
        values = column if whole[c] else column[known[:, c]]
        if not len(values):
            continue
        middle = float(np.median(values))
        low, high = float(values.min()), float(values.max())
        columns["offset"][c], columns["lowest"][c], columns["highest"][c] = middle, low, high
        columns["rms"][c] = np.sqrt(np.mean((values - middle) ** 2))
        flat[c] = low == high
        if flat[c]:
            still[c] = len(values) / rate
            continue
        still[c] = _longest_still_s(column, rate)
        counts["spikes"][c] += _spikes(column - middle, rate)
        counts["clipped"][c] = _count_clipped(values)
        columns["drift"][c], columns["wander"][c], columns["vibration"][c] = _drift(column)
    return pd.DataFrame({
        "id": block.id, "channel": channels, "missing": block.missing, "impossible": block.impossible,
        "marker": np.nan if block.marker is None else block.marker,
        "repeated": block.repeated, "filled": block.filled, "longest_gap_s": gap,
        **columns, **counts, "still_s": still, "flat": flat,
    })


def _spikes(away: np.ndarray, rate_hz: float) -> int:
    """Samples, or two in a row, that stand alone; away (n_sample,) from the median. Looked for in the values and in
    their second differences, in which slow motion does not hide what is small."""
    kink = np.zeros(len(away))
    kink[1:-1] = away[1:-1] - 0.5 * (away[:-2] + away[2:])
    found = find_lone_samples(np.abs(away), rate_hz, 1, SPIKE_STD)
    pointed = find_lone_samples(np.abs(kink), rate_hz, 2, SPIKE_STD)
    # one sample off makes -1/2, 1, -1/2 of it; a jump, which a structure's load may make, does not
    for k in np.flatnonzero(pointed):
        found[k] |= max(kink[k - 1] / kink[k], kink[k + 1] / kink[k]) < -0.25
    starts, _ = runs(found)
    # a spike shows in its neighbours' second differences too
    return int(np.sum(np.diff(starts, prepend=-10) > 2))


def _count_clipped(values: np.ndarray) -> int:
    """Samples that stand at the record's own largest or smallest value for at least CLIP_RUN in a row."""
    count = 0
    for limit, inward in ((values.max(), -1), (values.min(), 1)):
        at = values == limit
        n = int(at.sum())
        if n < CLIP_RUN:
            continue
        starts, ends = runs(at)
        long = (ends - starts) >= CLIP_RUN
        if not long.any():
            continue
        inside = values[~at]
        following = inside.max() if inward < 0 else inside.min()
        if n > CLIP_PILE * np.sum(inside == following):
            count += int((ends - starts)[long].sum())
    return count


def _longest_still_s(column: np.ndarray, rate_hz: float) -> float:
    """Seconds of the longest run of one value, 0 where no longer than STILL_S."""
    starts, ends = runs(np.diff(column) == 0)
    if not len(starts):
        return 0.0
    length = np.sort(ends - starts) + 1
    longest = int(length[-1])
    # a coarse converter repeats values: a stop is longer than what it does by itself
    usual = float(np.median(length[:-1])) if len(length) > 1 else 1.0
    return longest / rate_hz if longest >= max(STILL_S * rate_hz, STILL_SAMPLES, 10 * usual) else 0.0


def _drift(column: np.ndarray) -> tuple[float, float, float]:
    """Last tenth's mean less the first's, range of the tenths' means, standard deviation about them; tenths of which
    more than half is lost are left out, NaN where fewer than three remain or the first or last is lost."""
    size = len(column) // PARTS
    parts = column[: size * PARTS].reshape(PARTS, size)
    known = np.isfinite(parts)
    count = known.sum(axis=1)
    enough = count > size / 2
    if enough.sum() < 3:
        return float("nan"), float("nan"), float("nan")
    value = np.where(known, parts, 0.0)
    means = np.where(enough, value.sum(axis=1) / np.maximum(count, 1), np.nan)
    squares = np.sum(np.where(known, parts - means[:, None], 0.0)[enough] ** 2, axis=1) / count[enough]
    return float(means[-1] - means[0]), float(np.ptp(means[enough])), float(np.sqrt(np.mean(squares)))
