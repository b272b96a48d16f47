"""One physical quantity for all channels: acceleration, velocity and displacement turned into one another.

Differentiation and integration are multiplications by (2 pi i f)^k in the frequency domain; what noise and drift would
become outside a band is cut there. Inside the band they are exact, outside nothing is left.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import fft

from probupdate.campaign.blocks import LONGEST_BREAK_S, Block
from probupdate.campaign.gaps import fill_short_gaps
from probupdate.errors import InputError
from probupdate.modal.modes import QUANTITIES, Sensor
from probupdate.runtime.arrays import frozen_array

# how often each quantity is to be differentiated to become acceleration
TO_ACCELERATION = {"acceleration": 0, "velocity": 1, "displacement": 2}


@dataclass(frozen=True, kw_only=True)
class Band:
    """Where a conversion holds, in Hz: exact from lowest_hz to highest_hz, nothing below half the one and above 1.25
    times the other, cosine flanks between.

    The lowest default lies below the first mode of any wind turbine in service and above the drift of integrated
    noise; highest_hz None is 0.4 of the sampling rate.
    """

    lowest_hz: float = 0.1
    highest_hz: float | None = None

    def limits(self, rate_hz: float) -> tuple[float, float]:
        """(lowest, highest) at a sampling rate; InputError where nothing lies between."""
        highest = 0.4 * rate_hz if self.highest_hz is None else self.highest_hz
        if not 0 < self.lowest_hz < highest <= 0.4 * rate_hz * (1 + 1e-12):
            raise InputError("band", f"{self.lowest_hz:g} to {highest:g} Hz is no band of a {rate_hz:g} Hz record",
                             f"give limits between 0 and {0.4 * rate_hz:g} Hz, the lower one first")
        return self.lowest_hz, highest


def convert_quantity(block: Block, sensors: tuple[Sensor, ...], quantity: str, *, band: Band | None = None) -> Block:
    """The block with every channel in `quantity`, SI units; the very block where that is so already.

    block.data (n_sample, n_channel) in the sensors' quantities. Where one channel is converted, all are cut to the
    same band, so that no channel holds what its neighbours have lost; a note says which and between which limits.
    Differences and integrals ask for whole records: gaps of up to a second are bridged by straight lines, which the
    note says too, and a channel with a longer one is lost as a whole. Raises InputError for an unknown
    quantity, another number of channels, or a block shorter than ten periods of the lowest frequency.
    """
    if quantity not in QUANTITIES:
        raise InputError("quantity", f"'{quantity}' is unknown", f"choose from {', '.join(QUANTITIES)}")
    if block.data.shape[1] != len(sensors):
        raise InputError(f"block {block.id}", f"has {block.data.shape[1]} channels, {len(sensors)} sensors are given",
                         "give the campaign's own sensors")
    times = np.array([TO_ACCELERATION[s.quantity] - TO_ACCELERATION[quantity] for s in sensors])
    if not times.any():
        return block
    low, high = (band or Band()).limits(block.sampling_rate_hz)
    if len(block.data) < 10 * block.sampling_rate_hz / low:
        raise InputError(f"block {block.id}", f"is shorter than ten periods of {low:g} Hz, the band's lower limit",
                         "raise the lower limit of the band, or use longer blocks")
    whole, left = fill_short_gaps(block.data, round(LONGEST_BREAK_S * block.sampling_rate_hz))
    data = differentiate(whole, block.sampling_rate_hz, times, (low, high))
    changed = ", ".join(s.channel for s, k in zip(sensors, times, strict=True) if k)
    note = f"{changed} converted to {quantity}; all channels cut to {low:g}-{high:g} Hz"
    drawn = [s.channel for s, k, m in zip(sensors, left, block.measured, strict=True) if not k and m < 1]
    if drawn:
        note += f"; for that, gaps of up to {LONGEST_BREAK_S:g} s were bridged by straight lines in {', '.join(drawn)}"
    return replace(block, data=frozen_array(data), notes=(*block.notes, note))


def differentiate(data: np.ndarray, rate_hz: float, times: np.ndarray, band_hz: tuple[float, float]) -> np.ndarray:
    """data (n_sample, n_channel) differentiated `times` (n_channel,) times (negative: integrated) within band_hz.

    The straight line through the record is taken off, as the transform takes it for periodic, and the record continued
    at both ends: what is integrated by its mirror image, which keeps the mean; what is differentiated by its point
    reflection about the end, which keeps value and slope. A few periods of the lowest frequency at the ends remain
    approximate. A column with NaN becomes NaN.
    """
    n, (low, high) = len(data), band_hz
    lost = ~np.isfinite(data).all(axis=0)
    centred = np.where(lost, 0.0, data)
    centred -= centred.mean(axis=0)
    time = np.linspace(-1, 1, n)
    centred -= np.outer(time, time @ centred / (time @ time))
    reach = min(n - 1, int(np.ceil(6 * rate_hz / low)))
    before, after = centred[reach:0:-1], centred[-2:-reach - 2:-1]
    before = np.where(times > 0, 2 * centred[0] - before, before)
    after = np.where(times > 0, 2 * centred[-1] - after, after)
    long = np.concatenate([before, centred, after])
    total = fft.next_fast_len(len(long), real=True)
    frequency = fft.rfftfreq(total, 1 / rate_hz)
    kept = _window(frequency, low, high)
    inside = kept > 0
    factor = np.zeros((len(frequency), data.shape[1]), complex)
    factor[inside] = kept[inside, None] * (2j * np.pi * frequency[inside, None]) ** times
    answer = fft.irfft(fft.rfft(long, total, axis=0) * factor, total, axis=0)[reach: reach + n]
    answer[:, lost] = np.nan
    return answer


def _window(frequency: np.ndarray, low: float, high: float) -> np.ndarray:
    """(n_frequency,) 1 in [low, high], cosine flanks down to low / 2 and up to 1.25 high."""
    rising = np.clip((frequency - low / 2) / (low / 2), 0, 1)
    falling = np.clip((1.25 * high - frequency) / (0.25 * high), 0, 1)
    return (0.5 - 0.5 * np.cos(np.pi * rising)) * (0.5 - 0.5 * np.cos(np.pi * falling))
