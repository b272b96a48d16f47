"""From the coordinates in which a farm's linear system is Gaussian to parameters under their true priors.

A parameter with a prior of its own is the quantile of that prior at its Gaussian coordinate's probability; what
scatters between turbines is normal about the population's mean and cut at the bounds. Nothing is left to be weighed
then but priors that correlate, which stay Gaussian here and are weighed by `log_ratio`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special, stats

from probupdate.model.parameters import Parameters
from probupdate.updating.joint_system import Roles
from probupdate.updating.set_likelihoods import Coordinates

# Gaussian coordinates are told from one another within so many standard deviations; bounds farther away cut nothing
FARTHEST = 7.5


@dataclass(frozen=True, eq=False, kw_only=True)
class PriorMap:
    """mean (n_param,) and covariance: the Gaussian that stands for the prior in u; columns (n_scattering,): places in z
    of what differs between turbines."""

    parameters: Parameters
    coordinates: Coordinates
    roles: Roles
    mean: np.ndarray
    covariance: np.ndarray
    columns: np.ndarray

    def _marginal(self, number: int, g: np.ndarray) -> np.ndarray:
        """u of one parameter by its own prior at Gaussian coordinates g."""
        p = self.parameters.items[number]
        unbounded = p.prior == "normal" and not np.isfinite([p.lower, p.upper]).any()
        if self.parameters.correlation is not None or (unbounded and not self.coordinates.logarithmic[number]):
            return g
        x = (g - self.mean[number]) / np.sqrt(self.covariance[number, number])
        theta = p.distribution.ppf(special.ndtr(np.clip(x, -FARTHEST, FARTHEST)))
        return np.log(theta) if self.coordinates.logarithmic[number] else theta

    def shared(self, z: np.ndarray) -> np.ndarray:
        """u of what turbines share (..., n_z) at Gaussian coordinates z."""
        numbers = self.roles.numbers(self.roles.shared)
        return np.stack([self._marginal(number, z[..., k]) for k, number in enumerate(numbers)], axis=-1)

    def turbine(self, g: np.ndarray, z: np.ndarray, spread: np.ndarray) -> np.ndarray:
        """u (n, n_param) of one turbine at Gaussian coordinates g (n, n_param) of its own and z (n, n_scattering) of
        the means from which it scatters by `spread` (n, n_scattering)."""
        numbers = [self.roles.numbers(self.roles.shared)[k] for k in self.columns]
        u = np.stack([self._marginal(k, g[:, k]) if k not in numbers else g[:, k] for k in range(g.shape[1])], axis=1)
        if self.parameters.correlation is not None:
            return u
        lower, upper = (self.coordinates.to(x) for x in (self.parameters.lower, self.parameters.upper))
        for j, k in enumerate(numbers):
            x = np.divide(g[:, k] - z[:, j], spread[:, j], out=np.zeros(len(g)), where=spread[:, j] > 0)
            u[:, k] = cut_normal(self._marginal(k, z[:, j]), spread[:, j], x, lower[k], upper[k])
        return u

    def log_ratio(self, z: np.ndarray, u: np.ndarray) -> np.ndarray:
        """ln of the true prior over the one that the coordinates stand for (n,), of z (n, n_z) and u (n, n_turbine,
        n_param)."""
        if self.parameters.correlation is None:
            return np.zeros(len(z))
        shared = self.roles.numbers(self.roles.shared)
        with np.errstate(invalid="ignore"):
            own = self._log_prior(u, list(range(u.shape[-1]))) - self._log_prior(u[..., shared], shared)
            total = self._log_prior(z, shared) + own.sum(axis=1)
        return np.where(np.isfinite(total), total, -np.inf)

    def _log_prior(self, u: np.ndarray, numbers: list[int]) -> np.ndarray:
        """ln of the true prior of some of the parameters over the Gaussian (...,), -inf outside their bounds; u (...,
        n)."""
        known = self.parameters.correlation
        some = Parameters(tuple(self.parameters.items[k] for k in numbers),
                          None if known is None else known[np.ix_(numbers, numbers)])
        part = Coordinates(logarithmic=self.coordinates.logarithmic[numbers], scale=self.coordinates.scale[numbers])
        theta = part.back(u)
        root = np.linalg.cholesky(self.covariance[np.ix_(numbers, numbers)])
        off = np.linalg.solve(root, np.moveaxis(u - self.mean[numbers], -1, 0).reshape(len(numbers), -1))
        gaussian = -0.5 * np.sum(off**2, axis=0).reshape(u.shape[:-1]) - np.log(np.diag(root)).sum()
        gaussian -= 0.5 * len(numbers) * np.log(2 * np.pi)
        value = some.log_density(theta)
        inside = np.isfinite(value)
        jacobian = np.log(np.where(inside[..., None], part.rate(theta), 1.0)).sum(axis=-1)
        return np.where(inside, value + jacobian - gaussian, -np.inf)


def cut_normal(mean: np.ndarray, std: np.ndarray, x: np.ndarray, lower: float, upper: float) -> np.ndarray:
    """The quantile at the probability of x, standard normal, of a normal (n,) cut at bounds; its mean where std is 0.
    """
    value = np.array(mean + std * x)
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (lower - mean) / std, (upper - mean) / std
    cut = (std > 0) & ((a > -FARTHEST) | (b < FARTHEST))
    x = np.clip(x, -FARTHEST, FARTHEST)
    for side, quantile, chance in ((x < 0, stats.truncnorm.ppf, special.ndtr(x)),
                                   (x >= 0, stats.truncnorm.isf, special.ndtr(-x))):
        some = cut & side
        value[some] = quantile(chance[some], a[some], b[some], loc=mean[some], scale=std[some])
    return np.clip(value, lower, upper)
