"""What a channel that has nothing in common with the others may have been recorded with: a clock hours from theirs, by
phase correlation over the whole record, or another sampling rate, by that of a piece resampled to it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy import fft, ndimage

from probupdate.campaign.blocks import block_files, read_block
from probupdate.campaign.clocks import LARGEST_DELAY_S, are_comparable
from probupdate.campaign.gaps import zero_filled
from probupdate.campaign.reading import Campaign
from probupdate.campaign.sensor_findings import SIGMA

# of a record so much is compared: a day at 25 Hz
MOST_SAMPLES = 2**21
MOST_PARTNERS = 3
# rates that are tried, in steps, on a piece of so many samples near the start, among so many of its lengths
LARGEST_RATIO, STEP, PIECE, LENGTHS = 0.05, 5e-4, 4096, 8
# less is a drift, which is followed
LEAST_RATIO = 2e-3


def far_clock(campaign: Campaign, channel: str, lone: Sequence[str] = ()) -> str:
    """Words on how the channel's record fits those of its direction that are not `lone` too, '' where it fits at no
    time and no rate."""
    k = campaign.channels.index(channel)
    partners = [j for j, s in enumerate(campaign.sensors) if j != k and s.channel not in lone
                and are_comparable(s, campaign.sensors[k])]
    partners = partners[:: max(-(-len(partners) // MOST_PARTNERS), 1)]
    if not partners:
        return ""
    record = _longest_record(campaign, [k, *partners])
    if late := _late_s(record, campaign.sampling_rate_hz):
        # whichever way modes move partners, by less than a second
        minutes, rest = divmod(round(abs(late)), 60)
        apart = " ".join(f"{n} {unit}" for n, unit in ((minutes // 60, "h"), (minutes % 60, "min"), (rest, "s"))
                         if n)
        sense = "later" if late > 0 else "earlier"
        return (f"what happens stands {apart} {sense} in it than in the others: a clock or a time "
                "zone of its own? Put its times right and convert it again, or leave it out")
    rate = campaign.sampling_rate_hz
    if ratio := _rate_ratio(record):
        return (f"what happens stands in it at {ratio:.3f} times the frequencies of the others: was it sampled at "
                f"about {rate / ratio:.4g} Hz? Convert it again with its own rate, or leave it out")
    return ""


def _longest_record(campaign: Campaign, columns: list[int]) -> np.ndarray:
    """(n_sample, n) columns of the blocks that follow one another longest, about their means, zero where lost."""
    files = block_files(campaign)
    starts = list(files)
    length = pd.Timedelta(minutes=campaign.block_minutes)
    at = np.concatenate([[0], 1 + np.flatnonzero(np.diff(pd.DatetimeIndex(starts)) > length), [len(starts)]])
    first = int(at[np.argmax(np.diff(at))])
    most = max(int(MOST_SAMPLES / (60 * campaign.block_minutes * campaign.sampling_rate_hz)), 1)
    some = starts[first : first + min(int(np.diff(at).max()), most)]
    return np.concatenate([zero_filled(read_block(campaign, start, files[start]).data[:, columns]) for start in some])


def _late_s(record: np.ndarray, rate_hz: float) -> float:
    """Seconds by which the first column is later than the others, by phase correlation (Knapp and Carter 1976), of
    which as many agree as disagree; 0 where they show none."""
    n = len(record)
    size = fft.next_fast_len(2 * n, real=True)
    lag = np.append(np.arange(n), np.arange(-(size - n), 0))
    lines = _phases(record, size)
    each = []
    for other in lines.T[1:]:
        found = np.abs(fft.irfft(lines[:, 0] * other.conj(), size))
        # what is far has few samples in common: twice what counts, as for a drift
        if found.max() > 2 * SIGMA * np.sqrt(np.mean(found**2)):
            each.append(lag[int(np.argmax(found))] / rate_hz)
    if not each:
        return 0.0
    middle = float(np.median(each))
    agree = np.abs(np.array(each) - middle) < LARGEST_DELAY_S
    return middle if 2 * agree.sum() >= record.shape[1] - 1 and abs(middle) > LARGEST_DELAY_S else 0.0


def _rate_ratio(record: np.ndarray) -> float:
    """Frequencies of the first column over those of the others, by that at which a piece of it fits the others at some
    time by phase correlation; 0 where it fits at none, or at one."""
    n = min(PIECE, len(record) // LENGTHS)
    if 2 * n < PIECE:
        return 0.0
    others = _phases(record[: LENGTHS * n, 1:], 2 * LENGTHS * n)
    best = 2 * SIGMA, 0.0
    for tried in np.exp(np.arange(-LARGEST_RATIO, LARGEST_RATIO, STEP)):
        at = LENGTHS * n / 4 + np.arange(n) / tried
        piece = ndimage.map_coordinates(record[:, 0], [at], order=5)
        found = np.abs(fft.irfft(_phases(piece[:, None], 2 * LENGTHS * n) * others.conj(), axis=0))
        best = max(best, (_median_height(found), float(tried)))
    return best[1] if abs(best[1] - 1) > LEAST_RATIO else 0.0


def _median_height(found: np.ndarray) -> float:
    """Of columns (n_lag, n), their largest over their root mean square; 0 where they are zero."""
    size = np.sqrt(np.mean(found**2, axis=0))
    return float(np.median(found.max(axis=0) / np.where(size > 0, size, np.inf)))


def _phases(data: np.ndarray, size: int) -> np.ndarray:
    """Fourier lines of columns, each of size 1."""
    lines = fft.rfft(data, size, axis=0)
    return lines / np.maximum(np.abs(lines), 1e-300)
