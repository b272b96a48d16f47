"""Errors that last from block to block: an Ornstein-Uhlenbeck process beside independent noise, whitened."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_banded


def whiten_columns(columns: np.ndarray, noise: np.ndarray, slow: float, decay: np.ndarray) -> tuple[np.ndarray, float]:
    """L^-1 columns (n_row, n_column) and ln det V of V = diag(noise^2) + slow^2 exp(-|dt| / hours) = L L^T.

    Kalman's filter of the slow error, its work linear in the rows. decay (n_row - 1,): exp(-dt / hours).
    """
    totals, variance = [], slow**2
    for own, kept in zip((noise**2).tolist(), [*decay.tolist(), 0.0], strict=True):
        totals.append(variance + own)
        # what is still unknown of the slow error once this row is, carried to the next
        variance = kept**2 * variance * own / (variance + own) + slow**2 * (1 - kept**2)
    total = np.array(totals)
    # a row less what those before it say of the slow error: d_k+1 = y_k+1 - decay_k (y_k - (1 - gain_k) d_k)
    band = np.ones((2, len(columns)))
    band[1, :-1] = -decay * noise[:-1] ** 2 / total[:-1]
    ahead = np.array(columns, float)
    ahead[1:] -= decay[:, None] * columns[:-1]
    difference = solve_banded((1, 0), band, ahead, check_finite=False)
    return difference / np.sqrt(total)[:, None], float(np.sum(np.log(total)))
