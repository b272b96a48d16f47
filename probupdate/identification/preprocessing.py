"""Fewer samples: records brought to the rate at which the modes of interest are identified."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from scipy import signal

from probupdate.errors import InputError

# the filter passes up to this share of the new Nyquist frequency and stops, by STOP_DB, from its mirror image above:
# what folds back lands above the passed band
PASS_SHARE, STOP_DB = 0.9, 70.0


def resampled(data: np.ndarray, rate_hz: float, target_hz: float) -> np.ndarray:
    """data (n_sample, n_channel) without its mean, at target_hz.

    One symmetric (zero-phase) Kaiser FIR filter in polyphase form serves anti-aliasing and decimation; all channels
    get the same one, so that shapes are untouched. Up to 0.9 of the new Nyquist frequency it is flat within 0.03 %.
    Raises InputError where the target is above the recorded rate or no simple ratio of it.
    """
    centred = data - data.mean(axis=0)
    if abs(target_hz - rate_hz) <= 1e-9 * rate_hz:
        return centred
    if not 0 < target_hz < rate_hz:
        raise InputError("target rate", f"{target_hz:g} Hz is not in (0, {rate_hz:g}]", "records are only thinned out")
    ratio = Fraction(target_hz / rate_hz).limit_denominator(1000)
    if abs(float(ratio) * rate_hz - target_hz) > 1e-6 * target_hz:
        raise InputError("target rate", f"{target_hz:g} of {rate_hz:g} Hz is no ratio of small numbers",
                         "choose a rate that divides the recorded one")
    up, down = ratio.numerator, ratio.denominator
    fine_hz = rate_hz * up
    width = 2 * (1 - PASS_SHARE) * target_hz / 2
    n_tap, beta = signal.kaiserord(STOP_DB, width / (fine_hz / 2))
    taps = signal.firwin(n_tap | 1, target_hz / 2, window=("kaiser", beta), fs=fine_hz)
    # scipy scales the given taps by `up` itself
    return signal.resample_poly(centred, up, down, axis=0, window=taps)
