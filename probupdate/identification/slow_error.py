"""Errors that last from block to block: an Ornstein-Uhlenbeck process beside independent noise, whitened."""

from __future__ import annotations

import numpy as np


def whiten_columns(columns: np.ndarray, noise: np.ndarray, slow: float, decay: np.ndarray) -> tuple[np.ndarray, float]:
    """L^-1 columns (n_row, n_column) and ln det V of V = diag(noise^2) + slow^2 exp(-|dt| / hours) = L L^T.

    Kalman's filter of the slow error, its work linear in the rows. decay (n_row - 1,): exp(-dt / hours).
    """
    white = np.empty_like(columns, dtype=float)
    state, variance, log_determinant = np.zeros(columns.shape[1]), slow**2, 0.0
    for k, row in enumerate(columns):
        total = variance + noise[k] ** 2
        difference = row - state
        white[k] = difference / np.sqrt(total)
        log_determinant += np.log(total)
        if k < len(decay):
            gain = variance / total
            state = decay[k] * (state + gain * difference)
            variance = decay[k] ** 2 * (1 - gain) * variance + slow**2 * (1 - decay[k] ** 2)
    return white, float(log_determinant)
