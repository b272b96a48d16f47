"""Rate, model order and block rows that a record itself asks for, where no turbine's model says up to where modes lie.

Peaks of the singular values of the cross spectra (Brincker, Zhang & Andersen 2001, Modal identification of
output-only systems using frequency domain decomposition) that stand out from the spectrum about them: the highest sets
the rate, the lowest how long the covariances must be, their number the order. Lines of machines and mains have a power
that does not vary from one part of the record to the next (spectral kurtosis: Antoni 2006), and set nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from probupdate.campaign.blocks import block_files
from probupdate.campaign.reading import Campaign
from probupdate.campaign.usable import remedy
from probupdate.errors import InputError
from probupdate.identification.block_poles import usable_block
from probupdate.identification.lost_samples import pair_spectra
from probupdate.identification.settings import CONSTANTS

PARTS, STANDS_OUT, LEAST_LOG = CONSTANTS.proposal_parts, CONSTANTS.stands_out, CONSTANTS.least_log
# blocks that are looked at, evenly over the campaign
BLOCKS = 6
STEADY = CONSTANTS.steady
RATE, PERIODS = CONSTANTS.rate, CONSTANTS.periods
ROWS, ORDERS = (20, 60), (20, 60)
# peaks closer than this are one, ln f
SAME_PEAK = 0.03
# a block has so many samples for each block row at least; channels times block rows at most: time goes with the third
# power
LEAST_BLOCK, LARGEST = 20, 720


@dataclass(frozen=True, kw_only=True)
class Proposal:
    """target_rate_hz, order, block_rows for `BlockSettings`; peaks_hz, ascending, that they were estimated from;
    usual_hz: those that more than half of the blocks have; above_hz: peaks that such a rate does not hold; lines_hz:
    steady lines, which set nothing; sentence: the same in words."""

    target_rate_hz: float
    order: int
    block_rows: int
    peaks_hz: tuple[float, ...]
    usual_hz: tuple[float, ...] = ()
    above_hz: tuple[float, ...] = ()
    lines_hz: tuple[float, ...] = ()

    @property
    def sentence(self) -> str:
        text = (f"settings proposed from the record: rate {self.target_rate_hz:g} Hz, order {self.order}, "
                f"{self.block_rows} block rows, for {len(self.peaks_hz)} peaks of the spectrum from "
                f"{self.peaks_hz[0]:.3g} to {self.peaks_hz[-1]:.3g} Hz")
        if self.above_hz:
            text += f"; peaks above, from {self.above_hz[0]:.3g} Hz, are left to a run with another --rate"
        if self.lines_hz:
            listed = ", ".join(f"{f:.3g}" for f in self.lines_hz)
            text += f"; steady lines at {listed} Hz, as of machines or mains, set no rate"
        return text


def propose(
    campaigns: Sequence[Campaign], *, rate_hz: float | None = None, block_rows: int | None = None,
    up_to_hz: float = 0.0,
) -> Proposal:
    """One proposal for a campaign, or for all setups of a structure; what is given of it stands, and the rest is
    estimated from the peaks that such a rate holds. `up_to_hz`: modes up to there are looked for, so that the rate
    holds them, whatever stands out. Raises InputError where no block can be used, or where nothing stands out of the
    spectra."""
    peaks: list[tuple[float, float]] = []
    looked = 0
    reason = ""
    for campaign in campaigns:
        files = block_files(campaign)
        starts = list(files)
        wanted = max(1, -(-BLOCKS // len(campaigns)))
        for start in [starts[int(k)] for k in np.linspace(0, len(starts) - 1, min(wanted, len(starts)))]:
            block, why = usable_block(campaign, start, files[start])
            reason = reason or why
            if not why:
                looked += 1
                peaks += spectral_peaks(block.data, campaign.sampling_rate_hz)
    where = str(campaigns[0].path)
    if not looked:
        raise InputError(where, f"no block can be used; the first: {reason}", remedy(campaigns[0]))
    if not peaks:
        raise InputError(f"{where}, settings", "no peak stands out of the spectra, so no rate is proposed",
                         "state all three: --rate, at least twice the highest frequency of interest, --order and "
                         "--block-rows, such as 20 and 20")
    inside, lines = _merge_peaks(peaks, least=1 if looked < 3 else max(2, looked // 4))
    above = inside[:0]
    recorded = min(c.sampling_rate_hz for c in campaigns)
    fewest, most = (pick(len(c.sensors) for c in campaigns) for pick in (min, max))
    largest = max(min(LARGEST // most, ROWS[1]), 2)
    if rate_hz is None:
        rate = recorded / max(int(recorded / (RATE * max(inside[-1], up_to_hz))), 1)
        # lags that do not cover the lowest mode lose it; modes above a lower rate are lost too, but that is said
        longest = 2 * (block_rows or largest) * inside[0] / PERIODS
        if rate > longest and recorded / np.ceil(recorded / longest) > 2.2 * max(inside[0], up_to_hz):
            rate = recorded / np.ceil(recorded / longest)
            held = inside[inside < 0.45 * rate]
            inside, above = held, inside[len(held):]
    else:
        rate, held = rate_hz, inside[inside < 0.5 * rate_hz]
        inside = held if len(held) else inside
    rows = int(np.clip(np.ceil(0.5 * PERIODS * rate / inside[0]), *ROWS))
    order = int(np.clip(2 * np.ceil(1.5 * len(inside)), *ORDERS))
    samples = int(min(c.block_minutes for c in campaigns) * 60 * rate)
    rows = block_rows or max(min(rows, largest, samples // LEAST_BLOCK), 2)
    order = min(order, 2 * (fewest * (rows - 1) // 2))
    usual = [f for f in inside if 2 * np.sum(np.abs(np.log(np.array(peaks)[:, 0] / f)) < SAME_PEAK) > looked]
    return Proposal(target_rate_hz=float(rate), order=order, block_rows=rows, peaks_hz=tuple(map(float, inside)),
                    usual_hz=tuple(map(float, usual)), above_hz=tuple(map(float, above)),
                    lines_hz=tuple(map(float, lines)))


def spectral_peaks(data: np.ndarray, rate_hz: float) -> list[tuple[float, float]]:
    """Frequencies in Hz at which a singular value of the cross spectra of data (n_sample, n_channel), each channel by
    its own root mean square, stands out of its running median; and of each the mean square of its power over the parts,
    over the square of the mean (NaN where samples are lost).

    A mode that lies below the flank of stronger ones shows in a later singular value: the leading half of them is
    looked at, as the rest scatters by itself, and of peaks closer than 3 % the first value's counts.
    """
    from scipy import signal

    size = min(max(2 * (len(data) // (PARTS + 1)), 64), len(data))
    n_part = 2 * len(data) // size - 1
    leading = (min(data.shape[1], n_part) + 1) // 2
    if np.isfinite(data).all():
        data = signal.detrend(data, axis=0)
        data = data / data.std(axis=0)
        line, _, transform = signal.stft(data.T, fs=rate_hz, nperseg=size, boundary=None, padded=False)
        # (n_line, n_channel, n_part)
        vector, size_of, _ = np.linalg.svd(transform.transpose(1, 0, 2), full_matrices=False)
        value = size_of[:, :leading] ** 2
        # (n_line, n_value, n_part)
        power = np.abs(vector[:, :, :leading].conj().transpose(0, 2, 1) @ transform.transpose(1, 0, 2)) ** 2
        varies = np.mean(power**2, axis=2) / np.maximum(np.mean(power, axis=2) ** 2, 1e-300)
    else:
        line, density = pair_spectra(data, rate_hz, size)
        value = np.linalg.eigvalsh(density)[:, :-1 - leading:-1]
        varies = np.full(value.shape, np.nan)
    spectrum = np.log(np.maximum(value, 1e-12 * value[:, :1].max()))
    usable = (line > 2 * rate_hz / size) & (line < 0.45 * rate_hz)
    # neighbours of half-overlapping Hann windows share about a fifth of their variance
    threshold = max(STANDS_OUT / np.sqrt(n_part * 0.8), LEAST_LOG)
    found: list[tuple[float, float]] = []
    excess = np.where(usable[:, None], spectrum - _running_median(line, spectrum), -10.0)
    for column, steady in zip(excess.T, varies.T, strict=True):
        peaks, _ = signal.find_peaks(column, height=threshold, prominence=threshold)
        found += [(float(line[k]), float(steady[k])) for k in peaks
                  if all(abs(np.log(line[k] / f)) > SAME_PEAK for f, _ in found)]
    return found


def _running_median(line: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Of value (n_line, n_value), over a factor of 1.6 in frequency to both sides, a dozen lines at least; between
    lines that are 2 % apart it is as good as straight."""
    at = np.unique(np.r_[0, np.geomspace(1, len(line) - 1, max(int(50 * np.log(len(line))), 2)).astype(int)])
    low = np.minimum(np.searchsorted(line, line[at] / 1.6), at - 12).clip(0)
    high = np.maximum(np.searchsorted(line, line[at] * 1.6), at + 13).clip(max=len(line))
    median = np.array([np.median(value[a:b], axis=0) for a, b in zip(low, high, strict=True)])
    return np.column_stack([np.interp(line, line[at], column) for column in median.T])


def _merge_peaks(peaks: Sequence[tuple[float, float]], least: int) -> tuple[np.ndarray, np.ndarray]:
    """Means of runs whose neighbours are closer than 3 %, those of `least` members or, where there is none, all; and of
    these the steady lines apart, unless there is nothing else."""
    frequency, varies = np.array(sorted(peaks)).T
    parts = np.split(np.arange(len(frequency)), np.flatnonzero(np.diff(np.log(frequency)) > SAME_PEAK) + 1)
    often = [run for run in parts if len(run) >= least] or parts
    mean = np.array([np.mean(frequency[run]) for run in often])
    steady = np.array([np.median(varies[run]) < STEADY for run in often])
    return (mean, mean[:0]) if steady.all() else (mean[~steady], mean[steady])
