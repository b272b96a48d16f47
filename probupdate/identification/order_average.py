"""A mode's pole averaged over model orders, each weighted by the inverse of its variance.

An order above what the record holds puts poles of the noise beside that of a mode. They pull at it, so that it scatters
more than the record asks for, and to first order its stated standard deviation is larger still (at order 20 for four
states ten times the scatter). Lower orders that show the mode have less of either, until one lacks what the pole
needs. That is a specification test: going down, the estimate at each order is compared with the mean of those above by
the standard deviation of their difference (Hausman 1978, Specification tests in econometrics).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from probupdate.identification.record import IdentifiedRecord
from probupdate.identification.settings import CONSTANTS
from probupdate.identification.ssi import Poles
from probupdate.identification.uncertainty import scaled_change
from probupdate.modal.modes import CovarianceFactors, mac, unit_largest

TWIN_FREQUENCY, TWIN_MAC = CONSTANTS.twin_frequency, CONSTANTS.twin_mac
SAME = CONSTANTS.same_estimate
# orders that are averaged beside the chosen one: more add work and little information
MOST = 6
# the shape of a single channel has no scatter
ROUNDING = 1e-9


@dataclass(frozen=True, eq=False, kw_only=True)
class ModePoles:
    """frequency_hz, damping_ratio (n_mode,), shape (n_channel, n_mode), and covariance factors, in the scaling of
    `modes.unit_largest`."""

    frequency_hz: np.ndarray
    damping_ratio: np.ndarray
    shape: np.ndarray
    factors: CovarianceFactors


def twins(every: Sequence[Poles], order: int, index: int, most: int = MOST) -> tuple[tuple[int, int], ...]:
    """(model order, index) of a pole, and of its twins at lower orders, descending: frequency within 1 % and MAC of
    0.9; evenly `most` of those that have one. An index of -1 - k is pole k by itself (`single_pole_key`)."""
    if index < 0:
        return ((order, single_pole_key(index)),)
    own = next(p for p in every if p.order == order)
    found = []
    for other in sorted(every, key=lambda p: -p.order):
        if other.order >= order or not len(other.frequency_hz):
            continue
        alike = mac(own.shape[:, [index]], other.shape)[0]
        alike[np.abs(other.frequency_hz / own.frequency_hz[index] - 1) > TWIN_FREQUENCY] = 0
        if alike.max() >= TWIN_MAC:
            found.append((other.order, int(np.argmax(alike))))
    some = np.unique(np.linspace(0, len(found) - 1, min(most, len(found))).astype(int))
    return ((order, index), *(found[k] for k in some))


def single_pole_key(index: int) -> int:
    """The key of a pole that is to be taken by itself, not averaged, from its index; and back."""
    return -1 - index


def average_orders(poles: ModePoles, rows: Sequence[int]) -> ModePoles:
    """One mode from its pole at several orders: those of `poles` at `rows`, the chosen one first, others descending;
    shapes in any scale.

    One after the other joins the mean, unless its standard deviations are not known, or it differs from the mean of
    those before by more than three standard deviations of the difference.
    """
    rows = list(rows)
    # shapes all in the scale of the first one's largest component
    unit = unit_largest(poles.shape[:, rows])
    largest = int(np.argmax(np.abs(unit[:, 0])))
    scale = unit[largest].real
    shape, moved = unit / scale, poles.factors.shape[:, rows]
    moved = (moved - shape[:, :, None] * moved[largest].real) / scale[:, None]
    # a row an order; columns ln f, damping, shape
    value = np.column_stack([np.log(poles.frequency_hz[rows]), poles.damping_ratio[rows], shape.T])
    factor = np.concatenate([poles.factors.ln_frequency[rows][:, None], poles.factors.damping_ratio[rows][:, None],
                             moved.transpose(1, 0, 2)], axis=1)
    # each of the three by its own variance: what a low order lacks shows in one of them first
    parts = (slice(0, 1), slice(1, 2), slice(2, None))
    variance = np.array([np.sum(np.abs(factor[:, p]) ** 2, axis=(1, 2)) for p in parts])
    mean, mean_factor, weight = value[0], factor[0], np.zeros(3)
    for k in np.flatnonzero(np.isfinite(variance).all(axis=0) & (variance[:2] > 0).all(axis=0)):
        if not weight.any():
            mean, mean_factor = value[k], factor[k]
        away, apart = value[k] - mean, factor[k] - mean_factor
        if weight.any() and any(np.linalg.norm(away[p]) > SAME * np.linalg.norm(apart[p]) + ROUNDING for p in parts):
            continue
        own = 1 / np.maximum(variance[:, k], 1e-300)
        weight += own
        share = np.repeat(own / weight, [1, 1, len(away) - 2])
        mean, mean_factor = mean + share * away, mean_factor + share[:, None] * apart
    middle = mean[2:, None]
    return ModePoles(
        frequency_hz=np.exp(mean[:1].real), damping_ratio=mean[1:2].real, shape=unit_largest(middle),
        factors=CovarianceFactors(ln_frequency=mean_factor[:1].real, damping_ratio=mean_factor[1:2].real,
                                  shape=scaled_change(middle, mean_factor[2:, None])))


def averages(record: IdentifiedRecord, alike: Sequence[Sequence[tuple[int, int]]]) -> ModePoles:
    """Of each mode its (model order, index) in `alike`, the chosen one first (`twins`), averaged."""
    wanted = sorted({one for some in alike for one in some})
    parts = []
    for poles in record.by_order:
        index = np.array([k for n, k in wanted if n == poles.order], int)
        if len(index):
            parts.append(ModePoles(frequency_hz=poles.frequency_hz[index], damping_ratio=poles.damping_ratio[index],
                                   shape=poles.shape[:, index], factors=record.factors(index, poles.order)))
    every, place = _gather_modes(parts), {one: row for row, one in enumerate(wanted)}
    return _gather_modes([average_orders(every, [place[one] for one in some]) for some in alike])


def _gather_modes(modes: Sequence[ModePoles]) -> ModePoles:
    factors = [m.factors for m in modes]
    return ModePoles(
        frequency_hz=np.concatenate([m.frequency_hz for m in modes]),
        damping_ratio=np.concatenate([m.damping_ratio for m in modes]),
        shape=np.concatenate([m.shape for m in modes], axis=1),
        factors=CovarianceFactors(
            ln_frequency=np.concatenate([f.ln_frequency for f in factors]),
            damping_ratio=np.concatenate([f.damping_ratio for f in factors]),
            shape=np.concatenate([f.shape for f in factors], axis=1)))
