"""Fewer samples: records brought to the rate at which the modes of interest are identified."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from probupdate.errors import InputError
from probupdate.identification.settings import CONSTANTS

PASS_SHARE, STOP_DB = CONSTANTS.pass_share, CONSTANTS.stop_db
# outputs that are made together: more take products of taps that are zero, fewer more products
GROUP = 16


def resample(data: np.ndarray, rate_hz: float, target_hz: float) -> np.ndarray:
    """data (n_sample, n_channel) without its mean, at target_hz.

    One symmetric (zero-phase) Kaiser FIR filter serves anti-aliasing and decimation; all channels
    get the same one, so that shapes are untouched. Up to 0.9 of the new Nyquist frequency it is flat within 0.03 %.
    Raises InputError where the target is above the recorded rate or no simple ratio of it.
    """
    centred = data - data.mean(axis=0)
    up, down, taps = _design(rate_hz, target_hz)
    return centred if taps is None else _filter_polyphase(centred, up, down, taps)


def filter_reach(rate_hz: float, target_hz: float) -> int:
    """Samples at target_hz on each side of one that `resample` makes it of; 0 where the rate stays."""
    up, down, taps = _design(rate_hz, target_hz)
    return 0 if taps is None else -(-(len(taps) // 2) // down)


def covariance_weights(rate_hz: float, target_hz: float, n_lag: int) -> tuple[int, np.ndarray]:
    """What `resample` does to covariances: the first lag k0 at rate_hz, and W (n_lag + 1, n) so that W R, with R (n,)
    the covariances at lags k0, k0 + 1, ... at rate_hz, are those at lags 0..n_lag at target_hz.

    The filter's autocorrelation, averaged over the phases at which a rational rate takes its outputs.
    """
    from scipy import signal

    up, down, taps = _design(rate_hz, target_hz)
    if taps is None:
        return 0, np.eye(n_lag + 1)
    response = signal.correlate(taps, taps) / up
    middle = len(taps) - 1
    first, last = -(middle // up), (n_lag * down + middle) // up
    place = np.arange(n_lag + 1)[:, None] * down - np.arange(first, last + 1) * up
    return first, np.where(np.abs(place) <= middle, response[np.clip(place + middle, 0, 2 * middle)], 0.0)


def _design(rate_hz: float, target_hz: float) -> tuple[int, int, np.ndarray | None]:
    """Up, down, and taps of the filter at `up` times the recorded rate; no taps where the rate stays."""
    from scipy import signal

    if abs(target_hz - rate_hz) <= 1e-9 * rate_hz:
        return 1, 1, None
    if not 0 < target_hz < rate_hz:
        raise InputError("target rate", f"{target_hz:g} Hz is not in (0, {rate_hz:g}]",
                         "records are only decimated: give a lower rate")
    ratio = Fraction(target_hz / rate_hz).limit_denominator(1000)
    if abs(float(ratio) * rate_hz - target_hz) > 1e-6 * target_hz:
        raise InputError("target rate", f"{target_hz:g} of {rate_hz:g} Hz is not a ratio of small numbers",
                         "choose a rate that divides the recorded one")
    up, down = ratio.numerator, ratio.denominator
    fine_hz = rate_hz * up
    width = 2 * (1 - PASS_SHARE) * target_hz / 2
    n_tap, beta = signal.kaiserord(STOP_DB, width / (fine_hz / 2))
    taps = signal.firwin(n_tap | 1, target_hz / 2, window=("kaiser", beta), fs=fine_hz)
    return up, down, up * taps


def _filter_polyphase(data: np.ndarray, up: int, down: int, taps: np.ndarray) -> np.ndarray:
    """What scipy's resample_poly gives, data (n_sample, n_channel) taken as zero beyond its ends, as matrix products.

    A few outputs in a row are one product of taps with the inputs around them, moved by `hop` inputs from each group of
    outputs to the next; cut into pieces of `hop` inputs, all of them are strided views of the same numbers.
    """
    group = max(1, GROUP // up)
    n_row, hop, half = group * up, group * down, len(taps) // 2
    lead = -(-half // up)
    n_piece = -(-(lead + ((n_row - 1) * down + half) // up + 1) // hop)
    # output o of a group takes input i, counted from `lead` before the group's first, by this tap
    tap = np.arange(n_row)[:, None] * down + half - (np.arange(n_piece * hop) - lead) * up
    weight = np.where((tap >= 0) & (tap < len(taps)), taps[np.clip(tap, 0, len(taps) - 1)], 0.0)
    n_sample, n_channel = data.shape
    n_out = -(-n_sample * up // down)
    n_group = -(-n_out // n_row)
    padded = np.zeros(((n_group + n_piece - 1) * hop, n_channel))
    kept = min(n_sample, len(padded) - lead)
    padded[lead : lead + kept] = data[:kept]
    pieces = padded.reshape(-1, hop, n_channel)
    found = np.zeros((n_group, n_row, n_channel))
    for k in range(n_piece):
        found += np.ascontiguousarray(weight[:, k * hop : (k + 1) * hop]) @ pieces[k : k + n_group]
    return found.reshape(-1, n_channel)[:n_out]
