"""A proposal that bends: a triangular map of independent numbers, fitted to weighted draws.

Sharp posteriors are thin, bent ridges that no Gaussian follows. In coordinates ordered from the widest direction to the
thinnest each number is a quadratic of those before it, with a scatter whose logarithm is linear in them: a
Knothe-Rosenblatt rearrangement of polynomials (El Moselhy & Marzouk 2012; Parno & Marzouk 2018). Every part of the fit
is a regression, draws follow one after another, and the density is exact and normalised.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from probupdate.runtime.arrays import frozen_array
from probupdate.updating.surrogate import GaussianApproximation, from_coordinates, log_jacobian, to_coordinates

# degrees of freedom of the independent numbers, whose tails are heavier than the posterior's, and how much wider
DEGREES, SPREAD = 12.0, 1.05
# of the coefficients, in effective draws: few draws leave the map straight
RIDGE = 3.0
# rounds in which the scatter of a number along those before it is found, and ln of its most and least over its mean
ROUNDS, MOST_LN = 3, 1.5
# no draw is farther out, in standard deviations of the draws fitted to, than quadratics are believed
FARTHEST = 4.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Transport:
    """u = mean + root x; x_k = middle_k(x before) + exp(ln_scale_k(x before)) t_k, t_k Student t of DEGREES: `middle`
    and `ln_scale` hold the coefficients of each k. u are the coordinates of `like`, a Gaussian approximation."""

    mean: np.ndarray
    root: np.ndarray
    middle: tuple[np.ndarray, ...]
    ln_scale: tuple[np.ndarray, ...]
    like: GaussianApproximation

    def _at(self, k: int, before: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Middle and ln of the scatter (n,) of the k-th number given those before it (n, k)."""
        known = np.clip(before, -FARTHEST, FARTHEST)
        ln = np.clip(_linear(known) @ self.ln_scale[k], *_limits(self.ln_scale[k]))
        return _quadratic(known) @ self.middle[k], ln

    def draw(self, n: int, random) -> np.ndarray:
        """(n, n_param); draws may lie outside the parameters' bounds. `random` has uniform(size=n)."""
        x = np.empty((n, len(self.mean)))
        for k in range(len(self.mean)):
            middle, ln = self._at(k, x[:, :k])
            x[:, k] = middle + np.exp(ln) * special.stdtrit(DEGREES, random.uniform(size=n))
        with np.errstate(over="ignore", divide="ignore"):
            return from_coordinates(self.mean + x @ self.root.T, self.like.powers) + self.like.origin

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        """(n,) of theta (n, n_param) inside the bounds, normalised."""
        u, jacobian = _coordinates(theta, self.like)
        x = np.linalg.solve(self.root, (u - self.mean).T).T
        n = len(self.mean)
        constant = special.gammaln(0.5 * (DEGREES + 1)) - special.gammaln(0.5 * DEGREES) - 0.5 * np.log(DEGREES * np.pi)
        total = np.full(len(x), n * constant - np.linalg.slogdet(self.root)[1])
        for k in range(n):
            middle, ln = self._at(k, x[:, :k])
            t = (x[:, k] - middle) * np.exp(-ln)
            total -= ln + 0.5 * (DEGREES + 1) * np.log1p(t**2 / DEGREES)
        return total - jacobian


def _coordinates(theta: np.ndarray, like: GaussianApproximation) -> tuple[np.ndarray, np.ndarray]:
    """u (n, n_param) and ln |d theta / du| (n,)."""
    x = theta - like.origin
    return to_coordinates(x, like.powers), log_jacobian(x, like.powers)


def _linear(x: np.ndarray) -> np.ndarray:
    return np.concatenate([np.ones((len(x), 1)), x], axis=1)


def _quadratic(x: np.ndarray) -> np.ndarray:
    i, j = np.triu_indices(x.shape[1])
    return np.concatenate([_linear(x), x[:, i] * x[:, j]], axis=1)


def _limits(ln_scale: np.ndarray) -> tuple[float, float]:
    return ln_scale[0] - MOST_LN, ln_scale[0] + MOST_LN


def fit_transport(theta: np.ndarray, weight: np.ndarray, like: GaussianApproximation) -> Transport:
    """To points theta (n, n_param) inside the bounds with normalised weights (n,), in the coordinates of `like`."""
    u, _ = _coordinates(theta, like)
    mean = weight @ u
    scale = np.sqrt(weight @ (u - mean) ** 2) + 1e-12 * (1 + np.abs(mean))
    z = (u - mean) / scale
    value, vector = np.linalg.eigh((z * weight[:, None]).T @ z)
    root = vector[:, ::-1] * np.sqrt(np.maximum(value[::-1], 1e-12))
    x = np.linalg.solve(root, z.T).T
    counts = 1 / np.sum(weight**2)
    middle, ln_scale = [], []
    for k in range(x.shape[1]):
        before = np.clip(x[:, :k], -FARTHEST, FARTHEST)
        straight, bent = _linear(before), _quadratic(before)
        own_weight, ln = weight, np.zeros(1 + k)
        for _ in range(ROUNDS if k else 1):
            coefficient = _regression(bent, x[:, k], own_weight, counts)
            off = x[:, k] - bent @ coefficient
            along = np.clip(straight @ ln, *_limits(ln)) if k else np.full(len(x), ln[0])
            # one step of scoring for a scatter that is log-linear
            excess = off**2 * np.exp(-2 * along)
            mean_excess = weight @ excess
            ln = ln + np.concatenate([[0.5 * np.log(max(mean_excess, 1e-24))],
                                      _regression(straight, 0.5 * (np.minimum(excess / mean_excess, 9.0) - 1), weight,
                                                  counts)[1:]])
            own_weight = weight * np.exp(-2 * (np.clip(straight @ ln, *_limits(ln)) - ln[0]))
            own_weight = own_weight / own_weight.sum()
        ln[0] += 0.5 * np.log(SPREAD)
        middle.append(frozen_array(coefficient))
        ln_scale.append(frozen_array(ln))
    return Transport(mean=frozen_array(mean), root=frozen_array(scale[:, None] * root), middle=tuple(middle),
                     ln_scale=tuple(ln_scale), like=like)


def _regression(columns: np.ndarray, value: np.ndarray, weight: np.ndarray, counts: float) -> np.ndarray:
    """Weighted least squares with a ridge on all but the constant."""
    weighted = columns * weight[:, None]
    normal = weighted.T @ columns
    ridge = RIDGE / counts * np.diag(normal)
    ridge[0] = 0.0
    return np.linalg.solve(normal + np.diag(ridge + 1e-12), weighted.T @ value)
