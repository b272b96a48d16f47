"""What calibration is judged by: ranks of the truth among draws, coverage with binomial bands, tests of uniformity.

The truth's rank among draws of a posterior is uniform if truth, data and posterior belong together (Cook, Gelman &
Rubin 2006; Talts et al. 2018, Validating Bayesian inference algorithms with simulation-based calibration), for every
quantity that depends on parameters and data: the log-likelihood sees errors that no parameter does (Modrak et al. 2023,
Simulation-based calibration checking for Bayesian computation: the choice of test quantities shapes sensitivity).
"""

from __future__ import annotations

import numpy as np
from scipy import stats

LEVELS = (0.5, 0.9)
BINS = 10


def weighted_rank(draws: np.ndarray, truth: np.ndarray, weight: np.ndarray | None = None) -> np.ndarray:
    """Share of the draws (n, n_quantity) below the truth (n_quantity,), draws weighing `weight` (n,); in 0..1."""
    below = np.asarray(draws) < truth
    return below.mean(axis=0) if weight is None else weight @ below / np.sum(weight)


def coverage(rank: np.ndarray, level: float) -> float:
    """Share of replicates whose truth lies in the central interval of probability `level`."""
    return float(np.mean(np.abs(np.asarray(rank) - 0.5) < 0.5 * level))


def band(level: float, n: int, confidence: float = 0.95) -> tuple[float, float]:
    """Between which shares the coverage of n calibrated replicates lies."""
    tail = 0.5 * (1 - confidence)
    return tuple(float(k) / n for k in stats.binom.ppf((tail, 1 - tail), n, level))


def histogram(rank: np.ndarray, bins: int = BINS) -> np.ndarray:
    """Counts (bins,) over equal parts of 0..1."""
    return np.histogram(np.clip(rank, 0, 1), bins=bins, range=(0, 1))[0]


def uniformity(rank: np.ndarray) -> float:
    """p-value of Kolmogorov and Smirnov's test for uniform ranks."""
    return float(stats.kstest(np.asarray(rank), "uniform").pvalue)
