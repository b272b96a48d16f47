"""Cross-spectra of a block, from which channels are compared with one another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft

from probupdate.campaign.gaps import zero_filled
from probupdate.campaign.quantity import TO_ACCELERATION
from probupdate.modal.modes import Sensor
from probupdate.runtime.arrays import frozen_array

# length of a segment: resolves 0.025 Hz, a tenth of the first mode of the slenderest turbine; less where that would be
# more frequencies than are needed, at rates for stiffer structures
SEGMENT_S, MOST_FREQUENCIES = 40.0, 1024
FEWEST_SEGMENTS = 8
# of one block's densities
LARGEST_BYTES = 256 * 2**20


@dataclass(frozen=True, eq=False, kw_only=True)
class CrossSpectra:
    """frequency_hz (n_frequency,); density (n_frequency, n_channel, n_channel) complex, one-sided, unit squared per Hz,
    density[f, i, j] the mean of conj(X_i) X_j; n_segment it was averaged over (they overlap by half)."""

    frequency_hz: np.ndarray
    density: np.ndarray
    n_segment: int

    def coherence(self, channels: Sequence[int]) -> np.ndarray:
        """(n_frequency, n, n) squared coherence of some channels, 0 where one of two does not move."""
        g = self.density[:, channels][:, :, channels]
        own = np.einsum("fii->fi", np.real(g))
        both = own[:, :, None] * own[:, None, :]
        return np.divide(np.abs(g) ** 2, both, out=np.zeros(both.shape), where=both > 0)


def comparable_channels(rate_hz: float, highest_hz: float) -> int:
    """How many channels can be compared with one another within LARGEST_BYTES."""
    lines = min(SEGMENT_S, MOST_FREQUENCIES / highest_hz) * min(highest_hz, rate_hz / 2)
    return int(np.sqrt(LARGEST_BYTES / (16 * max(lines, 1.0))))


def cross_spectra(data: np.ndarray, rate_hz: float, highest_hz: float) -> CrossSpectra | None:
    """Welch's estimate from segments of 40 s (shorter where a block holds fewer than eight), Hann windows, half
    overlap, up to highest_hz. data (n_sample, n_channel), NaN where lost (`gaps.zero_filled`); segments in which less
    than half of a channel was measured are left out; None where fewer than eight are left, and where there are more
    channels than `comparable_channels`. A channel that does not move has a density of zero."""
    n_sample = len(data)
    if data.shape[1] > comparable_channels(rate_hz, highest_hz):
        return None
    length = segment_samples(n_sample, rate_hz, highest_hz)
    if length < 16:
        return None
    frequency = fft.rfftfreq(length, 1 / rate_hz)
    wanted = (frequency > 0) & (frequency <= highest_hz)
    lines = segment_lines(data, length, wanted)
    if len(lines) < FEWEST_SEGMENTS:
        return None
    density = mean_products(lines) * per_hz(length, rate_hz)
    return CrossSpectra(frequency_hz=frozen_array(frequency[wanted]), density=frozen_array(density, complex),
                        n_segment=len(lines))


def segment_samples(n_sample: int, rate_hz: float, highest_hz: float) -> int:
    """Even length of the segments of a block."""
    length = min(round(min(SEGMENT_S, MOST_FREQUENCIES / highest_hz) * rate_hz), 2 * n_sample // (FEWEST_SEGMENTS + 1))
    return length - length % 2


def segment_lines(
    data: np.ndarray, length: int, kept: np.ndarray, *, moving: bool = False
) -> list[np.ndarray]:
    """Lines `kept` of the Fourier transforms (n_line, n_channel) of half overlapping segments under Hann windows, those
    in which at least half of every channel's samples (n_sample, n_channel) were measured (and every channel moves)."""
    window, found = np.hanning(length + 1)[:-1], []
    for first in range(0, len(data) - length + 1, length // 2):
        piece = data[first: first + length]
        if np.any(2 * np.isfinite(piece).sum(axis=0) < length):
            continue
        piece = zero_filled(piece)
        if not moving or np.all(np.ptp(piece, axis=0) > 0):
            found.append(fft.rfft(piece.T * window, axis=1)[:, kept].T)
    return found


def mean_products(lines: Sequence[np.ndarray]) -> np.ndarray:
    """(n_line, n, n) mean of conj(X_i) X_j over segments' transforms."""
    stack = np.array(lines).transpose(1, 0, 2)
    return stack.conj().transpose(0, 2, 1) @ stack / len(lines)


def per_hz(length: int, rate_hz: float) -> float:
    """What makes `mean_products` a one-sided density."""
    return 2 / (rate_hz * np.sum(np.hanning(length + 1)[:-1] ** 2))


def to_acceleration(sensors: Sequence[Sensor], frequency_hz: np.ndarray) -> np.ndarray:
    """(n_line, n_channel) factors that make every channel's transform an acceleration's."""
    return (2j * np.pi * frequency_hz[:, None]) ** np.array([TO_ACCELERATION[s.quantity] for s in sensors])


def convert_to_acceleration(spectra: CrossSpectra, sensors: tuple[Sensor, ...]) -> CrossSpectra:
    """The same with every channel as an acceleration, whatever it measures."""
    if all(TO_ACCELERATION[s.quantity] == 0 for s in sensors):
        return spectra
    factor = to_acceleration(sensors, spectra.frequency_hz)
    density = factor.conj()[:, :, None] * spectra.density * factor[:, None, :]
    return CrossSpectra(frequency_hz=spectra.frequency_hz, density=frozen_array(density, complex),
                        n_segment=spectra.n_segment)
