"""A Gaussian cut at the bounds that stands in for the posterior: it starts chains, proposes moves, and marks the region
a reduced basis must answer well. Nothing is concluded from it.

The Laplace approximation is exact at the maximum only; where responses are curved over the posterior's width, a
quadratic fitted to the log density over that width is closer by orders of magnitude in its importance weights.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy import linalg

from probupdate.model.box_probability import log_probability as _log_probability
from probupdate.model.box_probability import truncated_normal
from probupdate.model.parameters import Parameters
from probupdate.runtime.arrays import frozen_array
from probupdate.runtime.progress import Progress, silent
from probupdate.updating.laplace import Laplace
from probupdate.updating.problem import Problem

# rounds of fitting: how far the points that are fitted to spread (times the Gaussian's variance), and the power of the
# importance weights, which would single out few points at first
ROUNDS = ((2.0, 0.1), (2.0, 0.2), (1.5, 0.3), (1.3, 0.5), *4 * ((1.1, 0.5),))
# effective share of the draws from which no further round is needed
SERVES = 0.95
# points per coefficient of the quadratic
POINTS_PER_COEFFICIENT = 8
# of the fitted coefficients, as a share of the points
RIDGE = 1e-3
# least curvature along any direction, as a share of the diagonals': the fit may be flat or turn up inside the bounds
LEAST_CURVATURE = 0.02
# log weights further below the largest than this count as this
LEAST_WEIGHT = -15.0
# a parameter's coordinate changes where the squares a quadratic misses fall to this share
CLEARLY_LESS = 0.98
# where coordinates begin, below a lower bound that is not positive: this share of the prior standard deviation
ORIGIN_BELOW = 0.05
# share of proposals that come from a Gaussian approximation of so many times its variance
WIDE_SHARE, WIDE = 0.15, 2.5
# against division by a column that does not vary
TINY = 1e-12


class Density(Protocol):
    """What proposes draws: (n, n_param), and their normalised ln density (n,)."""

    def draw(self, n: int, random) -> np.ndarray: ...

    def log_density(self, theta: np.ndarray) -> np.ndarray: ...


@dataclass(frozen=True, eq=False, kw_only=True)
class TruncatedGaussian:
    """A Gaussian with exponent g^T d - d^T H d / 2, d = theta - centre, cut to [lower, upper] one parameter after
    another: each from its conditional on those before it, between its own bounds (the proposal of Geweke, Hajivassiliou
    and Keane, and of Genz).

    Draws and density are exact and the density is normalised, at any correlation and however far out the bounds cut.
    It is the Gaussian's density in the box itself where parameters are uncorrelated, and close to it otherwise when the
    hardest cut comes first.
    """

    centre: np.ndarray
    gradient: np.ndarray
    precision: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    def exponent(self, theta: np.ndarray) -> np.ndarray:
        """(n,) of theta (n, n_param): the Gaussian's without its constant and without bounds."""
        d = theta - self.centre
        return d @ self.gradient - 0.5 * np.einsum("ij,jk,ik->i", d, self.precision, d)

    def widen(self, factor: float) -> TruncatedGaussian:
        """The same mean before the bounds cut it, `factor` times the variance."""
        return TruncatedGaussian(
            centre=self.centre, gradient=self.gradient / factor, precision=self.precision / factor,
            lower=self.lower, upper=self.upper,
        )

    @cached_property
    def _stages(self) -> _Stages:
        return _stages(self)

    def draw(self, n: int, random) -> np.ndarray:
        """n independent draws (n, n_param); `random` has uniform(size=n)."""
        stages = self._stages
        z, theta = np.zeros((n, len(stages.order))), np.empty((n, len(stages.order)))
        for k, j in enumerate(stages.order):
            low, high = stages.cut(k, z)
            z[:, k] = truncated_normal(low, high, random.uniform(size=n))
            theta[:, j] = stages.mean[k] + stages.scale[k] * (z[:, : k + 1] @ stages.factor[k, : k + 1])
        # rounding may leave a draw a hair outside
        return np.clip(theta, self.lower, self.upper)

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        """(n,) of theta (n, n_param) inside the bounds, normalised."""
        stages = self._stages
        z = linalg.solve_triangular(
            stages.factor, ((theta[:, stages.order] - stages.mean) / stages.scale).T, lower=True
        ).T
        value = -0.5 * np.sum(z**2 + np.log(2 * np.pi), axis=1) - np.sum(np.log(np.diag(stages.factor) * stages.scale))
        return value - np.sum(_log_probability(*stages.cuts(z)), axis=1)


@dataclass(frozen=True, eq=False)
class _Stages:
    """Parameters in the order they are drawn, with mean, scale and bounds (n_param,) in that order and the lower
    Cholesky factor of their correlation: theta = mean + scale * (factor @ z)."""

    order: np.ndarray
    mean: np.ndarray
    scale: np.ndarray
    factor: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    def cut(self, k: int, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bounds (n,) of the k-th standard normal, given those before it."""
        before = z[:, :k] @ self.factor[k, :k]
        return (self.lower[k] - before) / self.factor[k, k], (self.upper[k] - before) / self.factor[k, k]

    def cuts(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same of all at once, (n, n_param): chains ask for densities of two dozen walkers thousands of times."""
        own = np.diag(self.factor)
        before = z @ (self.factor - np.diag(own)).T
        return (self.lower - before) / own, (self.upper - before) / own


def _stages(gaussian: TruncatedGaussian) -> _Stages:
    """The parameter whose bounds leave least goes first, then the one they leave least given the first at its mean
    between them, and so on."""
    size = 1 / np.sqrt(np.diag(gaussian.precision))
    inverse = np.linalg.inv(gaussian.precision * np.outer(size, size))
    mean = gaussian.centre + size * (inverse @ (gaussian.gradient * size))
    scale = size * np.sqrt(np.diag(inverse))
    correlation = inverse / np.sqrt(np.outer(np.diag(inverse), np.diag(inverse)))
    low, high = (gaussian.lower - mean) / scale, (gaussian.upper - mean) / scale
    order, shift, left = [], np.zeros(len(mean)), correlation.copy()
    for _ in range(len(mean)):
        rest = np.setdiff1d(np.arange(len(mean)), order)
        std = np.sqrt(np.maximum(np.diag(left), 1e-12))
        a, b = (low - shift) / std, (high - shift) / std
        chance = _log_probability(a, b)
        j = rest[np.argmin(chance[rest])]
        order.append(j)
        column = left[:, j] / std[j]
        shift = shift + column * _truncated_mean(float(a[j]), float(b[j]))
        left = left - np.outer(column, column)
    order = np.array(order)
    return _Stages(order, mean[order], scale[order], linalg.cholesky(correlation[np.ix_(order, order)], lower=True),
                   low[order], high[order])


def _truncated_mean(a: float, b: float) -> float:
    """Of the standard normal between a and b."""
    if a > 0:
        return -_truncated_mean(-b, -a)
    log_probability = float(_log_probability(np.array([a]), np.array([b]))[0])
    ends = [np.exp(-0.5 * x * x - log_probability) if np.isfinite(x) else 0.0 for x in (a, b)]
    return float(np.clip((ends[0] - ends[1]) / np.sqrt(2 * np.pi), a, b))


@dataclass(frozen=True, eq=False, kw_only=True)
class GaussianApproximation:
    """A truncated Gaussian in coordinates u of the parameters: u = x, ln x or -1 / x for powers (n_param,) of 1, 0 and
    -1, x = theta - origin. `gaussian` lives in u.

    The origin is 0 for parameters that are positive by their bounds, and else a little below the lower bound: that is
    where a relative change of a stiffness leaves none.
    """

    gaussian: TruncatedGaussian
    powers: tuple[int, ...]
    lower: np.ndarray
    upper: np.ndarray
    origin: np.ndarray

    def draw(self, n: int, random) -> np.ndarray:
        """n independent draws (n, n_param)."""
        theta = from_coordinates(self.gaussian.draw(n, random), self.powers) + self.origin
        return np.clip(theta, self.lower, self.upper)

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        """(n,) of theta (n, n_param) inside the bounds, normalised."""
        x = theta - self.origin
        return self.gaussian.log_density(to_coordinates(x, self.powers)) - log_jacobian(x, self.powers)

    def widen(self, factor: float) -> GaussianApproximation:
        """`factor` times the variance, in its coordinates."""
        return replace(self, gaussian=self.gaussian.widen(factor))

    def turned_to(self, powers: tuple[int, ...]) -> GaussianApproximation:
        """The same slope and, but for what the coordinates bend, the same curvature at the centre in other ones."""
        x = from_coordinates(self.gaussian.centre[None], self.powers)
        rate = np.exp(_log_rates(x, powers) - _log_rates(x, self.powers))[0]
        # the density per du has the slope of ln |dx / du| too, which is 0, 1 and 2 x per unit of u
        own, new = (np.array([{1: 0.0, 0: 1.0, -1: 2 * t}[power] for t, power in zip(x[0], chosen, strict=True)])
                    for chosen in (self.powers, powers))
        return _approximation(
            to_coordinates(x, powers)[0], (self.gaussian.gradient - own) * rate + new,
            self.gaussian.precision * np.outer(rate, rate), powers, self,
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class Proposal:
    """Draws of the Gaussian approximation, a share of them from a wider one: where the posterior's tail is heavier than
    the Gaussian approximation's, the ratio of their densities stays bounded."""

    approximation: GaussianApproximation

    @cached_property
    def _wide(self) -> GaussianApproximation:
        return self.approximation.widen(WIDE)

    def draw(self, n: int, random) -> np.ndarray:
        """n independent draws (n, n_param)."""
        wide = random.uniform(size=n) < WIDE_SHARE
        return np.where(wide[:, None], self._wide.draw(n, random), self.approximation.draw(n, random))

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        """(n,) of theta (n, n_param) inside the bounds, normalised."""
        # both in the same coordinates, which are computed once
        x = theta - self.approximation.origin
        u, jacobian = to_coordinates(x, self.approximation.powers), log_jacobian(x, self.approximation.powers)
        own, wide = (approximation.gaussian.log_density(u) for approximation in (self.approximation, self._wide))
        return np.logaddexp(np.log(1 - WIDE_SHARE) + own - jacobian, np.log(WIDE_SHARE) + wide - jacobian)


def _approximation(centre, gradient, precision, powers, like: GaussianApproximation) -> GaussianApproximation:
    """With the bounds and the origin of another one."""
    # an open end stays one in every coordinate that is used with it
    low, high = (to_coordinates((bound - like.origin)[None], powers)[0] for bound in (like.lower, like.upper))
    gaussian = TruncatedGaussian(centre=frozen_array(centre), gradient=frozen_array(gradient),
                                 precision=frozen_array(precision), lower=low, upper=high)
    return replace(like, gaussian=gaussian, powers=tuple(powers))


def _origin(parameters: Parameters) -> np.ndarray:
    below = parameters.lower - ORIGIN_BELOW * np.minimum(parameters.std, parameters.upper - parameters.lower)
    return np.where((parameters.lower > 0) | ~np.isfinite(parameters.lower), 0.0, below)


def to_coordinates(x: np.ndarray, powers: tuple[int, ...]) -> np.ndarray:
    """u (n, n_param) of x = theta - origin (n, n_param)."""
    how = {1: lambda x: x, 0: np.log, -1: lambda x: -1 / x}
    return np.stack([how[power](x[:, k]) for k, power in enumerate(powers)], axis=1)


def from_coordinates(u: np.ndarray, powers: tuple[int, ...]) -> np.ndarray:
    """x (n, n_param) of u (n, n_param)."""
    how = {1: lambda x: x, 0: np.exp, -1: lambda x: -1 / x}
    # an open end is infinite
    with np.errstate(divide="ignore"):
        return np.stack([how[power](u[:, k]) for k, power in enumerate(powers)], axis=1)


def _log_rates(x: np.ndarray, powers: tuple[int, ...]) -> np.ndarray:
    """ln dx_k / du_k (n, n_param)."""
    how = {1: np.zeros_like, 0: np.log, -1: lambda x: 2 * np.log(x)}
    return np.stack([how[power](x[:, k]) for k, power in enumerate(powers)], axis=1)


def log_jacobian(x: np.ndarray, powers: tuple[int, ...]) -> np.ndarray:
    """ln |dx / du| (n,) of x (n, n_param)."""
    return _log_rates(x, powers).sum(axis=1)


def from_laplace(laplace: Laplace, parameters: Parameters) -> GaussianApproximation:
    """The Laplace approximation; its gradient is not zero at a bound the maximum is pinned to."""
    origin = _origin(parameters)
    gaussian = TruncatedGaussian(
        centre=frozen_array(laplace.theta - origin), gradient=laplace.gradient, precision=laplace.precision,
        lower=frozen_array(parameters.lower - origin), upper=frozen_array(parameters.upper - origin),
    )
    return GaussianApproximation(gaussian=gaussian, powers=(1,) * len(parameters), lower=parameters.lower,
                                 upper=parameters.upper,
                                 origin=frozen_array(origin))


def fit_surrogate(
    problem: Problem, laplace: Laplace, rng: np.random.Generator, progress: Progress = silent
) -> tuple[GaussianApproximation, float]:
    """The best of a few quadratic fits to the log posterior, the Laplace approximation among them, and the effective
    share of its importance weights, 1 for a posterior that is such a Gaussian.

    Each fit chooses the coordinates in which a quadratic misses least: stiffnesses in series add as reciprocals, those
    in parallel as themselves, and a posterior that is curved in one is straight in the other.
    """
    parameters = problem.parameters
    n = len(parameters)
    n_point = max(400, POINTS_PER_COEFFICIENT * (1 + n + n * (n + 1) // 2))
    current = from_laplace(laplace, parameters)
    best, best_share = current, 0.0
    for done, (spread, power) in enumerate(ROUNDS):
        progress("posterior's Gaussian approximation", done, len(ROUNDS))
        wide = current.widen(spread)
        theta = wide.draw(n_point, rng)
        value, _ = problem.log_posterior(theta)
        # those without modes, or at the open end of a coordinate, have no height to fit
        known = np.isfinite(value)
        if known.sum() <= n:
            break
        theta, value = theta[known], value[known]
        weight = value - wide.log_density(theta)
        weight -= weight.max()
        share = np.exp(weight).sum() ** 2 / np.exp(2 * weight).sum() / n_point
        if share > best_share:
            best, best_share = wide, share
        if share > SERVES:
            break
        x, tempered = theta - current.origin, np.maximum(power * weight, LEAST_WEIGHT)
        chosen = straightest_powers(x, value, tempered, current.powers, np.isfinite(parameters.lower))
        current = _refit(current.turned_to(chosen), x, value, tempered)
    progress("posterior's Gaussian approximation", len(ROUNDS), len(ROUNDS))
    return best, float(best_share)


def straightest_powers(x, value, log_weight, powers, positive) -> tuple[int, ...]:
    """Powers, changed one parameter after another where a quadratic then misses clearly less. Another power changes the
    products of one coordinate: of many parameters the normal equations of the others cost the most."""
    powers = list(powers)
    columns, root, _, ridge = _least_squares(to_coordinates(x, powers), log_weight)
    factors = np.hstack([np.ones((len(x), 1)), _standardise(to_coordinates(x, powers))])
    i, j = np.triu_indices(factors.shape[1])

    def misfit(gram, right, target) -> float:
        found = np.linalg.solve(gram + ridge, right)
        return float(target @ target - found @ (2 * right - gram @ found))

    def target_of(powers) -> np.ndarray:
        return (value - value.max() + log_jacobian(x, powers)) * root

    gram, target = columns.T @ columns, target_of(powers)
    least = misfit(gram, columns.T @ target, target)
    for k in np.flatnonzero(positive):
        own = (i == k + 1) | (j == k + 1)
        for power in (1, 0, -1):
            if power == powers[k]:
                continue
            trial, new = [*powers[:k], power, *powers[k + 1 :]], factors.copy()
            new[:, k + 1] = _standardise(to_coordinates(x[:, [k]], (power,)))[:, 0]
            fresh, _ = _unit_columns(new[:, i[own]] * new[:, j[own]] * root[:, None])
            other, target = gram.copy(), target_of(trial)
            other[own] = fresh.T @ columns
            other[np.ix_(own, own)] = fresh.T @ fresh
            other[:, own] = other[own].T
            right = columns.T @ target
            right[own] = fresh.T @ target
            if (value_missed := misfit(other, right, target)) < CLEARLY_LESS * least:
                powers, least, factors, gram = trial, value_missed, new, other
                columns[:, own] = fresh
    return tuple(powers)


def _standardise(u: np.ndarray, centre: np.ndarray | None = None) -> np.ndarray:
    return (u - (u.mean(axis=0) if centre is None else centre)) / (u.std(axis=0) + TINY)


def _unit_columns(columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    size = np.sqrt(np.mean(columns**2, axis=0)) + TINY
    return columns / size, size


def _least_squares(u, log_weight, centre=None):
    """Columns 1, d, d d^T of d = (u - centre) / scale, each of unit size and times the root of the weights (n,); the
    sizes, and the ridge on all but the constant."""
    weight = np.exp(log_weight)
    root = np.sqrt(weight / weight.mean())
    factors = np.hstack([np.ones((len(u), 1)), _standardise(u, centre)])
    i, j = np.triu_indices(factors.shape[1])
    columns, size = _unit_columns(factors[:, i] * factors[:, j] * root[:, None])
    ridge = RIDGE * len(u) * np.diag([0.0] + [1.0] * (len(i) - 1))
    return columns, root, size, ridge


def _refit(current: GaussianApproximation, x, value, log_weight) -> GaussianApproximation:
    """Weighted least squares for what the quadratic misses, in its coordinates."""
    gaussian = current.gaussian
    u = to_coordinates(x, current.powers)
    columns, root, size, ridge = _least_squares(u, log_weight, gaussian.centre)
    missed = value - value.max() + log_jacobian(x, current.powers) - gaussian.exponent(u)
    found = np.linalg.solve(columns.T @ columns + ridge, columns.T @ (missed * root)) / size
    n, scale = u.shape[1], u.std(axis=0) + TINY
    i, j = np.triu_indices(n)
    bend = np.zeros((n, n))
    bend[i, j] = found[1 + n :]
    precision = gaussian.precision * np.outer(scale, scale) - (bend + bend.T)
    size = np.sqrt(np.abs(np.diag(precision))) + TINY
    curvature, direction = np.linalg.eigh(precision / np.outer(size, size))
    precision = (direction * np.maximum(curvature, LEAST_CURVATURE)) @ direction.T * np.outer(size, size)
    return _approximation(gaussian.centre, gaussian.gradient + found[1 : 1 + n] / scale,
                          precision / np.outer(scale, scale),
                          current.powers, current)
