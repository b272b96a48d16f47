"""Records of a free decay: recognised, and identified as what they are.

A record y(t) = C A^t x decays from its start. Its lagged products, divided by their number as those of a stationary
record, fall by exp(k / N) too slowly: damping comes out 1 / (omega T) too low. Summed at every lag over the same
starts, sum_t y(t + k) y(t)^T = C A^k G holds without error, and the poles are exact. (Ibrahim & Mikulcik 1977 take the
samples themselves; with sums over the record noise averages out.)"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probupdate.identification.lost_samples import WholeRecord
from probupdate.identification.record import IdentifiedRecord, identify_covariances
from probupdate.identification.ssi import check_record, product_sums, reference_projection

# energy of the record's first third over that of its last third, from which it is asked whether it decays
FALLING = 4.0
# windows of the energy in which the release is sought
WINDOWS = 60
# share of the energy that decaying modes explain in a free decay; where something drives the structure they do not
EXPLAINED = 0.95
# what is said of such a block
SAID = "free decay: identified from what follows the release"


@dataclass(frozen=True, eq=False, kw_only=True)
class DecayRecord:
    """data (n_sample, n_channel) at target_hz from the release on, nothing missing."""

    data: np.ndarray
    target_hz: float

    def identify(
        self, *, limited: int | None, sub_records: int, block_rows: int, **settings
    ) -> IdentifiedRecord:
        """`record.identify_covariances` of sums over the same starts at every lag."""
        covariance, changes = _mean_products(self.data, 2 * block_rows - 1, sub_records)
        if limited is not None and limited < self.data.shape[1]:
            projection = reference_projection(covariance, limited)
            covariance = covariance @ projection
            changes = None if changes is None else changes @ projection
        return identify_covariances(covariance, changes, self.target_hz, block_rows=block_rows, **settings)

    def summed_spectrum(self) -> tuple[np.ndarray, np.ndarray]:
        """As of any record."""
        return WholeRecord(data=self.data, target_hz=self.target_hz).summed_spectrum()

    def singular_spectrum(self) -> tuple[np.ndarray, np.ndarray]:
        """As of any record."""
        return WholeRecord(data=self.data, target_hz=self.target_hz).singular_spectrum()


def decay_of(record: WholeRecord, *, edge: int, order: int, block_rows: int) -> DecayRecord | None:
    """The record as a free decay; None where it is none, or too short to be judged.

    edge: samples at the beginning, after the release and at the end, that a filter mixed with what lies beyond.
    """
    data = record.data
    scale = data.std(axis=0)
    n_sample = len(data)
    energy = np.sum((data / np.where(scale > 0, scale, 1.0)) ** 2, axis=1)
    thirds = [float(part.sum()) for part in np.array_split(energy, 3)]
    if thirds[0] < FALLING * thirds[2]:
        return None
    width = max(n_sample // WINDOWS, 1)
    release = int(np.argmax(np.convolve(energy, np.ones(width), mode="valid")))
    kept = data[release + (width if release else 0) + edge: n_sample - edge]
    if 2 * len(kept) < n_sample or len(kept) < 8 * block_rows:
        return None
    found = DecayRecord(data=kept, target_hz=record.target_hz)
    poles = found.identify(limited=None, sub_records=0, block_rows=block_rows, order=order).poles
    explained = _explained_share(kept, record.target_hz, poles.frequency_hz, poles.damping_ratio)
    return found if explained > EXPLAINED else None


def _mean_products(data: np.ndarray, n_lag: int, sub_records: int) -> tuple[np.ndarray, np.ndarray | None]:
    """(n_lag + 1, n_channel, n_channel) means of products over the starts from which every lag is measured, and the
    changes (n_sub, ...) of as many parts, as `uncertainty.sub_record_covariances` scales them. What a part has more or
    less of a decay changes G alone, and no pole."""
    check_record(data, n_lag)
    n_start = len(data) - n_lag
    n_part = min(max(sub_records, 1), n_start)
    edges = np.round(np.linspace(0, n_start, n_part + 1)).astype(int)
    sums = product_sums(data, n_lag, edges) / n_start
    covariance = sums.sum(axis=0)
    if sub_records < 2:
        return covariance, None
    sums -= (np.diff(edges) / n_start)[:, None, None, None] * covariance
    return covariance, sums * np.sqrt(n_part / (n_part - 1))


def _explained_share(data: np.ndarray, rate_hz: float, frequency_hz: np.ndarray, damping: np.ndarray) -> float:
    """Share of the energy that decaying modes of these poles explain, from any start."""
    sound = (damping > 0) & (damping < 1)
    rate = 2 * np.pi * frequency_hz[sound] * (-damping[sound] + 1j * np.sqrt(1 - damping[sound] ** 2))
    motion = np.exp(np.arange(len(data))[:, None] / rate_hz * rate)
    basis = np.hstack([motion.real, motion.imag, np.ones((len(data), 1))])
    fitted = basis @ np.linalg.lstsq(basis, data, rcond=None)[0]
    size = np.maximum(np.sum(data**2, axis=0), 1e-300)
    return float(1 - np.mean(np.sum((data - fitted) ** 2, axis=0) / size))
