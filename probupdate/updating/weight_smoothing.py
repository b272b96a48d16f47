"""Weights of draws whose largest are smoothed, and what their tail says of them (Pareto k)."""

from __future__ import annotations

import numpy as np


def smoothed_weights(log_weight: np.ndarray) -> tuple[np.ndarray, float]:
    """ln of weights that sum to one, the largest replaced by quantiles of the generalised Pareto distribution fitted to
    them, and its k (Vehtari, Simpson, Gelman, Yao & Gabry 2024); log_weight (n,)."""
    n = log_weight.size
    shifted = log_weight - log_weight.max()
    n_tail = int(np.ceil(min(0.2 * n, 3 * np.sqrt(n))))
    order = np.argsort(shifted)
    tail_at = order[-n_tail:]
    cut = np.exp(shifted[order[-n_tail - 1]])
    tail = np.exp(shifted[tail_at]) - cut
    if n_tail < 5 or tail[0] >= tail[-1] * (1 - 1e-12):
        return shifted - np.log(np.sum(np.exp(shifted))), 0.0
    k, sigma = _pareto(tail)
    probability = (np.arange(n_tail) + 0.5) / n_tail
    quantile = -np.log1p(-probability) * sigma if abs(k) < 1e-12 else sigma / k * np.expm1(-k * np.log1p(-probability))
    smooth = shifted.copy()
    smooth[tail_at] = np.minimum(np.log(quantile + cut), 0.0)
    return smooth - np.log(np.sum(np.exp(smooth))), k


def _pareto(x: np.ndarray) -> tuple[float, float]:
    """k (drawn to 0.5 as if by ten more weights) and scale of exceedances x, ascending (Zhang & Stephens 2009)."""
    n = x.size
    m = 30 + int(np.sqrt(n))
    b = 1 - np.sqrt(m / (np.arange(1, m + 1) - 0.5))
    b = b / (3 * max(x[int(n / 4 + 0.5) - 1], np.finfo(float).tiny)) + 1 / x[-1]
    k = np.mean(np.log1p(-b[:, None] * x), axis=1)
    length = n * (np.log(-b / k) - k - 1)
    weight = 1 / np.sum(np.exp(length - length[:, None]), axis=1)
    kept = weight >= 10 * np.finfo(float).eps
    b = float(np.sum(b[kept] * weight[kept]) / np.sum(weight[kept]))
    k = float(np.mean(np.log1p(-b * x)))
    sigma = -k / b
    return (n * k + 5.0) / (n + 10.0), sigma
