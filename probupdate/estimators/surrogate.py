"""A Gaussian cut at the bounds that stands in for the posterior: it starts chains, proposes moves, and marks the region
a reduced basis must answer well. Nothing is concluded from it.

The Laplace approximation is exact at the maximum only; where responses are curved over the posterior's width, a
quadratic fitted to the log density over that width is closer by orders of magnitude in its importance weights.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg, optimize, special

from probupdate.estimators.laplace import Laplace
from probupdate.modes import frozen_array
from probupdate.parameters import Parameters
from probupdate.problem import Problem
from probupdate.progress import Progress, silent

# rounds of fitting: how far the points that are fitted to spread (times the Gaussian's variance), and the power of the
# importance weights, which would single out few points at first
ROUNDS = ((2.0, 0.1), (2.0, 0.2), (1.5, 0.3), (1.3, 0.5), (1.3, 0.5))
# points per coefficient of the quadratic
POINTS_PER_COEFFICIENT = 8
# of the fitted coefficients, as a share of the points
RIDGE = 1e-3
# least curvature along any direction, as a share of the diagonals': the fit may be flat or turn up inside the bounds
LEAST_CURVATURE = 0.02
# log weights further below the largest than this count as this
LEAST_WEIGHT = -15.0
# draws inside the bounds are sought among so many times their number, and otherwise made by so many sweeps
MOST_TRIES, SWEEPS = 20, 40


@dataclass(frozen=True, eq=False, kw_only=True)
class TruncatedGaussian:
    """Density exp(g^T d - d^T H d / 2), d = theta - centre, within [lower, upper]; not normalised."""

    centre: np.ndarray
    gradient: np.ndarray
    precision: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        """(n,) of theta (n, n_param), without its constant."""
        d = theta - self.centre
        return d @ self.gradient - 0.5 * np.einsum("ij,jk,ik->i", d, self.precision, d)

    def widened(self, factor: float) -> TruncatedGaussian:
        """The same centre of mass before the bounds cut it, `factor` times the variance."""
        return TruncatedGaussian(
            centre=self.centre, gradient=self.gradient / factor, precision=self.precision / factor,
            lower=self.lower, upper=self.upper,
        )

    def sweep(self, theta: np.ndarray, order, random) -> np.ndarray:
        """Each parameter of `order` in turn from its truncated normal conditional; theta (n, n_param), not in place.

        `random` has uniform(size=n). A sweep up and down again is reversible for this density.
        """
        d = theta - self.centre
        std = 1 / np.sqrt(np.diag(self.precision))
        low, high = self.lower - self.centre, self.upper - self.centre
        for k in order:
            others = d @ self.precision[:, k] - d[:, k] * self.precision[k, k]
            mean = (self.gradient[k] - others) * std[k] ** 2
            a, b = (low[k] - mean) / std[k], (high[k] - mean) / std[k]
            d[:, k] = mean + std[k] * _truncated_normal(a, b, random.uniform(size=len(d)))
        # rounding may leave a draw a hair outside
        return np.clip(self.centre + d, self.lower, self.upper)

    def draw(self, n: int, random) -> np.ndarray:
        """n draws (n, n_param); `random` has uniform(size=shape).

        Of the Gaussian without bounds those inside are kept, which is exact, as long as one in MOST_TRIES is. Where
        they are rarer, Gibbs sweeps start from the Gaussian around the highest point inside, cut to the bounds: from
        one point they would need a thousand steps to spread along a ridge.
        """
        scale = 1 / np.sqrt(np.diag(self.precision))
        factor = linalg.cholesky(self.precision * np.outer(scale, scale), lower=True)
        pull = linalg.solve_triangular(factor, self.gradient * scale, lower=True)

        def around(middle: np.ndarray) -> np.ndarray:
            normal = special.ndtri(np.clip(random.uniform(size=(n, len(middle))), 1e-16, 1 - 1e-16))
            return self.centre + (middle + linalg.solve_triangular(factor, normal.T, lower=True, trans="T").T) * scale

        mean = linalg.solve_triangular(factor, pull, lower=True, trans="T")
        kept, found = [], 0
        for tried in range(1, MOST_TRIES + 1):
            theta = around(mean)
            kept.append(theta[np.all((theta >= self.lower) & (theta <= self.upper), axis=1)])
            found += len(kept[-1])
            if found >= n:
                return np.concatenate(kept)[:n]
            if found * MOST_TRIES < n * tried / 2:
                break
        bounds = (self.lower - self.centre) / scale, (self.upper - self.centre) / scale
        top = optimize.lsq_linear(factor.T, pull, bounds=bounds, method="bvls").x
        theta = np.clip(around(top), self.lower, self.upper)
        for _ in range(SWEEPS):
            theta = self.sweep(theta, range(len(self.centre)), random)
        return theta


def _truncated_normal(a: np.ndarray, b: np.ndarray, uniform: np.ndarray) -> np.ndarray:
    """Standard normal between a and b by inverting its distribution function."""
    # the function is exact in relative terms on its lower side only: turn the interval there
    turned = a > 0
    low, high = np.where(turned, -b, a), np.where(turned, -a, b)
    below = special.ndtr(low)
    x = special.ndtri(below + uniform * (special.ndtr(high) - below))
    # so far out that the probability underflows, all of it lies at the nearer end
    x = np.clip(np.where(np.isfinite(x), x, high), low, high)
    return np.where(turned, -x, x)


def from_laplace(laplace: Laplace, parameters: Parameters) -> TruncatedGaussian:
    """The Laplace approximation; its gradient is not zero at a bound the maximum is pinned to."""
    return TruncatedGaussian(
        centre=laplace.theta, gradient=laplace.gradient, precision=laplace.precision, lower=parameters.lower,
        upper=parameters.upper,
    )


def fit_surrogate(
    problem: Problem, laplace: Laplace, rng: np.random.Generator, progress: Progress = silent
) -> tuple[TruncatedGaussian, float]:
    """The best of a few quadratic fits to the log posterior, the Laplace approximation among them, and the effective
    share of its importance weights, 1 for a posterior that is such a Gaussian.

    It is given as wide as it was tried: a proposal narrower than the posterior's tails leaves walkers stuck there.
    """
    parameters = problem.parameters
    n = len(parameters)
    n_point = max(400, POINTS_PER_COEFFICIENT * (1 + n + n * (n + 1) // 2))
    current = from_laplace(laplace, parameters)
    best, best_share = current, 0.0
    for done, (spread, power) in enumerate(ROUNDS):
        progress("posterior's outline", done, len(ROUNDS))
        wide = current.widened(spread)
        theta = wide.draw(n_point, rng)
        value, _ = problem.log_posterior(theta)
        weight = value - wide.log_density(theta)
        weight -= weight.max()
        share = np.exp(weight).sum() ** 2 / np.exp(2 * weight).sum() / n_point
        if share > best_share:
            best, best_share = wide, share
        current = _refit(current, theta, value, np.maximum(power * weight, LEAST_WEIGHT), parameters.std)
    progress("posterior's outline", len(ROUNDS), len(ROUNDS))
    return best, float(best_share)


def _refit(current: TruncatedGaussian, theta, value, log_weight, scale) -> TruncatedGaussian:
    """Weighted least squares for what the quadratic misses, in units of the prior deviations."""
    d = (theta - current.centre) / scale
    n = d.shape[1]
    i, j = np.triu_indices(n)
    columns = np.column_stack([np.ones(len(d)), d, d[:, i] * d[:, j]])
    missed = value - value.max() - current.log_density(theta)
    weight = np.exp(log_weight)
    weight /= weight.mean()
    size = np.sqrt(np.mean(columns**2 * weight[:, None], axis=0))
    matrix = columns / size * np.sqrt(weight)[:, None]
    ridge = RIDGE * len(d) * np.diag([0.0] + [1.0] * (columns.shape[1] - 1))
    found = np.linalg.solve(matrix.T @ matrix + ridge, matrix.T @ (missed * np.sqrt(weight))) / size
    bend = np.zeros((n, n))
    bend[i, j] = found[1 + n :]
    precision = current.precision * np.outer(scale, scale) - (bend + bend.T)
    size = np.sqrt(np.abs(np.diag(precision))) + 1e-12
    curvature, direction = np.linalg.eigh(precision / np.outer(size, size))
    precision = (direction * np.maximum(curvature, LEAST_CURVATURE)) @ direction.T * np.outer(size, size)
    return TruncatedGaussian(
        centre=current.centre, gradient=frozen_array(current.gradient + found[1 : 1 + n] / scale),
        precision=frozen_array(precision / np.outer(scale, scale)), lower=current.lower, upper=current.upper,
    )
