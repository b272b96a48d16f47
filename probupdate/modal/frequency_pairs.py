"""Measured and computed frequencies where shapes say nothing: pairs in their order, and frequencies in another unit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from probupdate.errors import InputError

# frequencies that differ by a common factor beyond this are taken for given in another unit: no model is so wrong
OTHER_UNIT = 3.0
# a model's errors in ln f are correlated over so much of it, and differ between equal frequencies as over this much
ALIKE_OVER, OWN_ERROR = 1.0, 0.01


def refuse_another_unit(where: str, ratios: Sequence[float] | np.ndarray) -> None:
    """Raises InputError where measured frequencies are in another unit than those of modes of like shape, by their
    `ratios`."""
    ratio = float(np.median(ratios)) if len(ratios) else 1.0
    if max(ratio, 1 / ratio) > OTHER_UNIT:
        raise InputError(
            where, f"its frequencies are {ratio:.3g} times (median) those of modes of like shape",
            "give Hz (rad/s are 6.28 times as many), or check the model's units (N/m belongs to kg, kN/m to t; one of "
            "each is 31.6 times off)",
        )


def common_factor_words(off: np.ndarray, scatter: float) -> str:
    """What to say where ln of computed over measured frequencies (n_mode,), NaN where unknown, scatters by at most so
    much about more than twice of it; empty elsewhere."""
    off = off[np.isfinite(off)]
    if len(off) < 2 or np.std(off) > scatter or abs(np.mean(off)) < 2 * scatter:
        return ""
    factor = float(np.exp(np.mean(off)))
    return (f"all frequencies of the model are {factor:.3g} times the measured ones, as with stiffness over mass "
            f"{factor**2:.3g} times what it is: look for a unit, or for a part that is in K0 and in its K_<name> too")


def pair_in_order(measured: np.ndarray, computed: np.ndarray) -> np.ndarray:
    """Number of the computed mode of each measured one (n_measured,) where their frequencies alone are known: the most
    probable pairing of ln f (n_measured,) with ln f (n_computed,), both ascending, that keeps their order.

    What a model's ln f is off by is much the same for close modes and less and less so for distant ones: an
    Ornstein-Uhlenbeck process over ln f, of which each step's density depends on the one before alone, so that the
    pairing is found by going from mode to mode (Viterbi). The nearest computed modes, one by one, would put a close
    pair of a model too soft by a fifth on two modes that are an octave apart.
    """
    error = measured[:, None] - computed
    correlation = np.exp(-np.maximum(np.diff(measured), OWN_ERROR) / ALIKE_OVER)
    cost, before = error[0] ** 2, []
    earlier = np.arange(len(computed))[:, None] < np.arange(len(computed))
    for own, last, share in zip(error[1:], error[:-1], correlation, strict=True):
        step = (own - share * last[:, None]) ** 2 / (1 - share**2)
        whole = np.where(earlier, cost[:, None] + step, np.inf)
        before.append(np.argmin(whole, axis=0))
        cost = np.min(whole, axis=0)
    chosen = [int(np.argmin(cost))]
    for came_from in reversed(before):
        chosen.append(int(came_from[chosen[-1]]))
    return np.array(chosen[::-1])
