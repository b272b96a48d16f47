"""One block of a campaign to its poles: a pure function of the records and the settings; no model, no SCADA."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from probupdate.campaign.blocks import Block, read_block
from probupdate.campaign.quantity import as_quantity
from probupdate.campaign.reading import Campaign, RecordFile
from probupdate.errors import InputError
from probupdate.identification.preprocessing import resampled
from probupdate.identification.ssi import Poles, factorise, output_covariances, poles
from probupdate.modes import Sensor, frozen_array

# segments of the spectrum that goes beside a stabilisation diagram: 512 samples are 100 s at 5 Hz
SPECTRUM_SAMPLES = 512


@dataclass(frozen=True, kw_only=True)
class BlockSettings:
    """What the poles of a block depend on. order 20 and 5 Hz as the paper; 30 block rows of 0.2 s see two periods of a
    0.3 Hz mode and more of the rest. Poles are kept of the even orders from `lowest_order` to `order` + `spread`."""

    order: int = 20
    block_rows: int = 30
    target_rate_hz: float = 5.0
    spread: int = 16
    lowest_order: int = 4

    def __post_init__(self):
        for name, least in (("order", 2), ("block_rows", 2), ("spread", 0), ("lowest_order", 2)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
                raise InputError(name, f"{value!r} is no whole number from {least}", "give one")
        if not 0 < self.target_rate_hz < np.inf:
            raise InputError("target rate", f"{self.target_rate_hz} Hz is not positive", "give one, such as 5")

    def orders(self, n_channel: int) -> tuple[int, ...]:
        """The chosen order first, then the others, ascending; none above what the block rows allow."""
        highest = min(self.order + self.spread, n_channel * (self.block_rows - 1))
        lowest = min(self.lowest_order, self.order)
        first = lowest + (self.order - lowest) % 2
        return (self.order, *(n for n in range(first, highest + 1, 2) if n != self.order))


@dataclass(frozen=True, eq=False, kw_only=True)
class BlockPoles:
    """What is kept of a block. poles: those of the chosen order; others: of the other orders, ascending; both empty
    where the block was excluded, with the reason in `excluded`.

    rms: root mean square over samples and channels of the motion about its mean, in SI units of `quantity`; line_hz
    and spectrum (n_line,): one-sided power spectral density summed over channels, at the rate of identification.
    """

    id: str
    start: pd.Timestamp
    minutes: float
    quantity: str
    excluded: str
    notes: tuple[str, ...]
    rms: float
    poles: Poles | None
    others: tuple[Poles, ...]
    line_hz: np.ndarray
    spectrum: np.ndarray


def common_quantity(sensors: tuple[Sensor, ...]) -> str:
    """The quantity that all channels measure; acceleration where they measure several, and are converted."""
    found = {s.quantity for s in sensors}
    return found.pop() if len(found) == 1 else "acceleration"


def identify_block(
    campaign: Campaign, start: pd.Timestamp, files: tuple[RecordFile, ...], settings: BlockSettings
) -> BlockPoles:
    """Read, convert, thin out and identify one block; `files` from `block_files`."""
    block = read_block(campaign, start, files)
    quantity = common_quantity(campaign.sensors)
    reason = block.excluded or _silent_channels(block, campaign.channels)
    if reason:
        return _left_out(block, quantity, reason)
    block = as_quantity(block, campaign.sensors, quantity)
    rms = float(np.sqrt(np.mean(np.var(block.data, axis=0))))
    record = resampled(block.data, campaign.sampling_rate_hz, settings.target_rate_hz)
    if len(record) < 4 * settings.block_rows:
        raise InputError(f"block {block.id}", f"{len(record)} samples at {settings.target_rate_hz:g} Hz are less than "
                         f"four times {settings.block_rows} block rows", "give longer blocks or fewer block rows")
    orders = settings.orders(record.shape[1])
    covariance = output_covariances(record, 2 * settings.block_rows - 1)
    factorisation = factorise(covariance, settings.block_rows, max(orders), settings.target_rate_hz)
    chosen, *others = poles(factorisation, orders)
    line, spectrum = summed_spectrum(record, settings.target_rate_hz)
    return BlockPoles(
        id=block.id, start=block.start, minutes=block.minutes, quantity=quantity, excluded="", notes=block.notes,
        rms=rms, poles=chosen, others=tuple(others), line_hz=line, spectrum=spectrum,
    )


def _silent_channels(block: Block, channels: tuple[str, ...]) -> str:
    still = [c for c, moved in zip(channels, np.ptp(block.data, axis=0) > 0, strict=True) if not moved]
    return f"no signal in {', '.join(still)}" if still else ""


def _left_out(block: Block, quantity: str, reason: str) -> BlockPoles:
    nothing = frozen_array(np.zeros(0))
    return BlockPoles(
        id=block.id, start=block.start, minutes=block.minutes, quantity=quantity, excluded=reason, notes=block.notes,
        rms=np.nan, poles=None, others=(), line_hz=nothing, spectrum=nothing,
    )


def summed_spectrum(record: np.ndarray, rate_hz: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (n_line,) in Hz and the sum over channels of the power spectral densities, in SI units squared per
    Hz; Welch's mean over half-overlapping Hann windows. record (n_sample, n_channel)."""
    from scipy import signal

    line, density = signal.welch(record, fs=rate_hz, nperseg=min(SPECTRUM_SAMPLES, len(record)), axis=0)
    return frozen_array(line), frozen_array(density.sum(axis=1))
