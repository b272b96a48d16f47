"""Records of free decays: recognised, and identified as what they are.

A record y(t) = C A^t x decays from its start. Its lagged products, divided by their number as those of a stationary
record, fall by exp(k / N) too slowly: damping comes out 1 / (omega T) too low. Summed at every lag over the same
starts, sum_t y(t + k) y(t)^T = C A^k G holds without error, and the poles are exact. (Ibrahim & Mikulcik 1977 take the
samples themselves; with sums over the record noise averages out.)"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from probupdate.identification.lost_samples import WholeRecord
from probupdate.identification.record import IdentifiedRecord, identify_covariances
from probupdate.identification.ssi import check_record, product_sums, reference_projection

# energy of a decay's first third over that of its last third, from which it is asked whether it decays; and of a window
# over that of the one before it, from which something released the structure anew
FALLING = 4.0
# windows of the energy in which releases are sought
WINDOWS = 60
# share of the energy that decaying modes explain in a free decay; where something drives the structure they do not
EXPLAINED = 0.95
# what is said of such a block
SAID = "free decay: identified from what follows each release"


@dataclass(frozen=True, eq=False, kw_only=True)
class DecayRecord:
    """decays [(n_sample, n_channel)] at target_hz, each from a release on, nothing missing."""

    decays: tuple[np.ndarray, ...]
    target_hz: float

    def identify(
        self, *, limited: int | None, sub_records: int, block_rows: int, **settings
    ) -> IdentifiedRecord:
        """`record.identify_covariances` of sums over the same starts at every lag."""
        covariance, changes = _mean_products(self.decays, 2 * block_rows - 1, sub_records)
        if limited is not None and limited < self.decays[0].shape[1]:
            projection = reference_projection(covariance, limited)
            covariance = covariance @ projection
            changes = None if changes is None else changes @ projection
        return identify_covariances(covariance, changes, self.target_hz, block_rows=block_rows, **settings)

    def summed_spectrum(self) -> tuple[np.ndarray, np.ndarray]:
        """As of any record, of the longest decay."""
        return WholeRecord(data=max(self.decays, key=len), target_hz=self.target_hz).summed_spectrum()

    def singular_spectrum(self) -> tuple[np.ndarray, np.ndarray]:
        """As of any record, of the longest decay."""
        return WholeRecord(data=max(self.decays, key=len), target_hz=self.target_hz).singular_spectrum()


def decay_of(record: WholeRecord, *, edge: int, order: int, block_rows: int) -> DecayRecord | None:
    """The record as free decays, one after each release; None where it is none, or too short to be judged.

    edge: samples at the beginning, after a release and at the end, that a filter mixed with what lies beyond.
    """
    data = record.data
    # not channel by channel: of a pluck along one axis sensors across it read their noise
    energy = np.sum(data**2, axis=1)
    width = max(len(data) // WINDOWS, 1)
    releases = [0, *_releases(energy, width), len(data)]
    pieces = [(first + (width if first else 0) + edge, last - edge) for first, last in pairwise(releases)]
    kept = [data[a:b] for a, b in pieces if b - a >= 8 * block_rows and _falls(energy[a:b])]
    if 2 * sum(map(len, kept)) < len(data):
        return None
    found = DecayRecord(decays=tuple(kept), target_hz=record.target_hz)
    poles = found.identify(limited=None, sub_records=0, block_rows=block_rows, order=order).poles
    explained = _explained_share(kept, record.target_hz, poles.frequency_hz, poles.damping_ratio)
    return found if explained > EXPLAINED else None


def _releases(energy: np.ndarray, width: int) -> list[int]:
    """Samples at which the windows of most energy begin, where a window has FALLING times that of the one before."""
    window = np.convolve(energy, np.ones(width), mode="valid")
    rises = np.flatnonzero(window[width:] > FALLING * window[:-width])
    runs = np.split(rises, np.flatnonzero(np.diff(rises) > width) + 1) if len(rises) else []
    return [int(run[0] + np.argmax(window[run[0]: run[-1] + 2 * width])) for run in runs]


def _falls(energy: np.ndarray) -> bool:
    first, _, last = (float(part.sum()) for part in np.array_split(energy, 3))
    return first >= FALLING * last


def _mean_products(
    decays: Sequence[np.ndarray], n_lag: int, sub_records: int
) -> tuple[np.ndarray, np.ndarray | None]:
    """(n_lag + 1, n_channel, n_channel) means of products over the starts from which every lag is measured, and the
    changes (n_sub, ...) of as many parts, as `uncertainty.sub_record_covariances` scales them. What a part, or a decay,
    has more or less of changes G alone, and no pole."""
    n_start = [len(data) - n_lag for data in decays]
    n_part = min(max(sub_records, 1), *n_start)
    sums, share = 0.0, np.zeros(n_part)
    for data, number in zip(decays, n_start, strict=True):
        check_record(data, n_lag)
        edges = np.round(np.linspace(0, number, n_part + 1)).astype(int)
        sums = sums + product_sums(data, n_lag, edges) / sum(n_start)
        share += np.diff(edges) / sum(n_start)
    covariance = sums.sum(axis=0)
    if sub_records < 2:
        return covariance, None
    return covariance, (sums - share[:, None, None, None] * covariance) * np.sqrt(n_part / (n_part - 1))


def _explained_share(
    decays: Sequence[np.ndarray], rate_hz: float, frequency_hz: np.ndarray, damping: np.ndarray
) -> float:
    """Share of the energy that decaying modes of these poles explain, each decay from any start."""
    sound = (damping > 0) & (damping < 1)
    rate = 2 * np.pi * frequency_hz[sound] * (-damping[sound] + 1j * np.sqrt(1 - damping[sound] ** 2))
    left = size = 0.0
    for data in decays:
        motion = np.exp(np.arange(len(data))[:, None] / rate_hz * rate)
        basis = np.hstack([motion.real, motion.imag, np.ones((len(data), 1))])
        fitted = basis @ np.linalg.lstsq(basis, data, rcond=None)[0]
        left, size = left + float(np.sum((data - fitted) ** 2)), size + float(np.sum(data**2))
    return 1 - left / max(size, 1e-300)
