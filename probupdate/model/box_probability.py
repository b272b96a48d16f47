"""A joint Gaussian within bounds: its probability there, and draws.

One variable after another is taken between its own bounds given those before it (Genz 1992, Numerical computation of
multivariate normal probabilities; Geweke, Hajivassiliou and Keane), the hardest cut first. The product of the
conditional probabilities is smooth, whatever the probability's size, so that scrambled Sobol points integrate it to a
known error where counting draws that fall inside would find a handful, or none.
"""

from __future__ import annotations

import numpy as np
from scipy import linalg, special

# points of one scrambled sequence, and sequences, whose scatter is the error
N_POINT, N_SEQUENCE = 2048, 8
# candidates for each draw, which are kept by their weights
CANDIDATES = 16


def log_box_probability(
    low: np.ndarray, high: np.ndarray, correlation: np.ndarray, rng: np.random.Generator
) -> tuple[float, float]:
    """ln P(low < z < high) of z ~ N(0, correlation), and its standard deviation; low, high (n,)."""
    from scipy.stats import qmc

    found = []
    for _ in range(N_SEQUENCE):
        points = qmc.Sobol(len(low), scramble=True, seed=rng).random(N_POINT)
        found.append(special.logsumexp(_conditional_sample(low, high, correlation, points)[1]) - np.log(N_POINT))
    relative = np.exp(np.array(found) - np.max(found))
    mean = float(np.max(found) + np.log(relative.mean()))
    return mean, float(np.std(relative, ddof=1) / relative.mean() / np.sqrt(N_SEQUENCE))


def draws_in_box(
    low: np.ndarray, high: np.ndarray, correlation: np.ndarray, rng: np.random.Generator, n: int
) -> np.ndarray:
    """z ~ N(0, correlation) within the bounds (n, n_variable): of CANDIDATES n conditional draws, n by their weights.
    """
    z, log_weight = _conditional_sample(low, high, correlation, rng.uniform(size=(CANDIDATES * n, len(low))))
    weight = np.exp(log_weight - log_weight.max())
    # systematic: each is kept as often as its weight says, to within one
    places = (rng.uniform() + np.arange(n)) / n
    chosen = np.searchsorted(np.cumsum(weight) / weight.sum(), places)
    return z[rng.permutation(np.minimum(chosen, len(z) - 1))]


def _conditional_sample(low, high, correlation, uniform: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """z (m, n) one after another, and ln of the product of their conditional probabilities (m,)."""
    order = np.argsort(log_probability(low, high))
    factor = linalg.cholesky(correlation[np.ix_(order, order)], lower=True)
    x, total = np.zeros(uniform.shape), np.zeros(len(uniform))
    for k, j in enumerate(order):
        before = x[:, :k] @ factor[k, :k]
        a, b = (low[j] - before) / factor[k, k], (high[j] - before) / factor[k, k]
        total += log_probability(a, b)
        x[:, k] = truncated_normal(a, b, uniform[:, j])
    z = np.empty_like(x)
    z[:, order] = x @ factor.T
    return np.clip(z, low, high), total


def log_probability(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """ln of the standard normal's probability between a and b, any shape; exact in relative terms far in both tails."""
    turned = a > 0
    low, high = np.where(turned, -b, a), np.where(turned, -a, b)
    upper = special.log_ndtr(high)
    return upper + np.log(-np.expm1(special.log_ndtr(low) - upper))


def truncated_normal(a: np.ndarray, b: np.ndarray, uniform: np.ndarray) -> np.ndarray:
    """Standard normal between a and b, of their shape, by inverting its distribution function at uniform (0 to 1)."""
    # the function is exact in relative terms on its lower side only: turn the interval there
    turned = a > 0
    low, high = np.where(turned, -b, a), np.where(turned, -a, b)
    below = special.ndtr(low)
    x = special.ndtri(below + uniform * (special.ndtr(high) - below))
    # so far out that the probability underflows, all of it lies at the nearer end
    x = np.clip(np.where(np.isfinite(x), x, high), low, high)
    return np.where(turned, -x, x)
