"""What sensors would be suspected of if a model's own modes were the record: a leg between its joints moves to another
side than the tower, a vertical sensor on the axis hardly moves at all, and neither is a fault."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from probupdate.campaign.mounting import DEAD, PROFILE_LIMIT, SCALED, TURNED, TURNED_DEG, Suspicion, suspicions
from probupdate.campaign.spectra import CrossSpectra
from probupdate.modal.modes import Sensor
from probupdate.runtime.arrays import frozen_array

# of the modes a record would show; noise beside each channel's own motion, without which two are one signal
DAMPING, NOISE = 0.01, 0.01
# of the median channel's motion, below which noise is all that a sensor reads
STILL = 0.01
LINES, SEGMENTS = 2000, 90


def expected_suspicions(frequency_hz: np.ndarray, shape: np.ndarray, sensors: tuple[Sensor, ...]) -> list[Suspicion]:
    """What `suspicions` says of the modes (n_mode,) of unit modal mass, shape (n_channel, n_mode) in the sensors'
    readings, under forces alike in all of them."""
    line_hz = np.linspace(0, 1.1 * frequency_hz.max(), LINES + 1)[1:]
    ratio = line_hz[:, None] / frequency_hz
    size = ratio**4 / ((1 - ratio**2) ** 2 + (2 * DAMPING * ratio) ** 2)
    density = np.einsum("ik,fk,jk->fij", shape, size, shape)
    density += NOISE * density * np.eye(len(shape))
    rms = np.sqrt(np.einsum("fii->i", density))
    still = rms < STILL * np.median(rms)
    found = [Suspicion(kind=DEAD, channels=(s.channel,)) for s, no in zip(sensors, still, strict=True) if no]
    spectra = CrossSpectra(frequency_hz=frozen_array(line_hz), density=frozen_array(density, complex),
                           n_segment=SEGMENTS)
    return found + suspicions(spectra, sensors)


def is_expected(one: Suspicion, expected: Sequence[Suspicion]) -> bool:
    """Whether all its channels are suspected alike, by so much, of the model's modes."""
    return all(any(one.kind == e.kind and c in e.channels and _alike(one, e) for e in expected) for c in one.channels)


def _alike(one: Suspicion, other: Suspicion) -> bool:
    if one.kind == TURNED:
        return abs(one.size - other.size) < TURNED_DEG
    return one.kind != SCALED or abs(np.log(one.size / other.size)) < np.log(PROFILE_LIMIT)
