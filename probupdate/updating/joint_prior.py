"""Normal scores of parameters: coordinates in which each prior, bounded, lognormal or uniform, is standard normal.

A linear-Gaussian system in them has the true priors, and no value of it lies outside their bounds; a tangent is that
in theta times the mapping's derivative, which dies towards a bound (Liu & Der Kiureghian 1986, marginal by marginal).
Priors that correlate keep their own Gaussian before the bounds cut it; what lies outside is weighed away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import special

from probupdate.model.parameters import Parameters

# scores farther from the median than this are one value: bounds themselves have none
FARTHEST = 7.5


def _normal_mass(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Probability of a standard normal between low and high, in the tail where it is exact."""
    return np.where(low > 0, special.ndtr(-low) - special.ndtr(-high), special.ndtr(high) - special.ndtr(low))


@dataclass(frozen=True, eq=False, kw_only=True)
class NormalScores:
    """Of `parameters`: every method takes (..., n_param)."""

    parameters: Parameters

    @cached_property
    def lognormal(self) -> np.ndarray:
        return np.array([p.prior == "lognormal" for p in self.parameters])

    @cached_property
    def _uniform(self) -> np.ndarray:
        return np.array([p.prior == "uniform" for p in self.parameters])

    @cached_property
    def _ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds (n_param,) of the Gaussian that the prior is cut from; infinite where nothing is cut."""
        if self.parameters.correlation is not None:
            none = np.full(len(self.parameters), np.inf)
            return -none, none
        low, high = (self._standard(x) for x in (self.parameters.lower, self.parameters.upper))
        return np.where(self._uniform, -np.inf, low), np.where(self._uniform, np.inf, high)

    @cached_property
    def _size(self) -> tuple[np.ndarray, np.ndarray]:
        """Place and scale (n_param,) of that Gaussian, in ln theta of a lognormal; of a uniform prior its lower bound
        and the distance to the upper one."""
        p = self.parameters
        place = np.array([np.log(q.initial) if q.prior == "lognormal" else q.initial for q in p])
        scale = np.array([q.log_std if q.prior == "lognormal" else q.std for q in p])
        lower, upper = (np.where(self._uniform, x, 0.0) for x in (p.lower, p.upper))
        return np.where(self._uniform, lower, place), np.where(self._uniform, upper - lower, scale)

    def _standard(self, theta: np.ndarray) -> np.ndarray:
        place, scale = self._size
        with np.errstate(divide="ignore", invalid="ignore"):
            value = np.where(self.lognormal, np.log(np.maximum(np.where(self.lognormal, theta, 1.0), 0.0)), theta)
        return (value - place) / scale

    @property
    def covariance(self) -> np.ndarray:
        """Of the scores a priori (n_param, n_param); their means are zero."""
        known = self.parameters.correlation
        return np.eye(len(self.parameters)) if known is None else np.array(known)

    def transform(self, theta: np.ndarray) -> np.ndarray:
        x, (low, high) = self._standard(np.asarray(theta, float)), self._ends
        mass = _normal_mass(low, high)
        below = np.where(self._uniform, x, _normal_mass(low, x) / mass)
        above = np.where(self._uniform, 1 - x, _normal_mass(x, high) / mass)
        with np.errstate(divide="ignore"):
            score = np.where(below < above, special.ndtri(np.clip(below, 0, 1)), -special.ndtri(np.clip(above, 0, 1)))
        whole = np.isinf(low) & np.isinf(high) & ~self._uniform
        return np.clip(np.where(whole, x, score), -FARTHEST, FARTHEST)

    def back(self, u: np.ndarray) -> np.ndarray:
        """theta, within its bounds but for priors that correlate."""
        x, (place, scale) = self._untruncated(np.asarray(u, float)), self._size
        value = place + scale * x
        value = np.where(self.lognormal, np.exp(np.where(self.lognormal, value, 0.0)), value)
        return value if self.parameters.correlation is not None else np.clip(
            value, self.parameters.lower, self.parameters.upper)

    def _untruncated(self, u: np.ndarray) -> np.ndarray:
        """Of the Gaussian before it was cut, from the end that is nearer."""
        low, high = self._ends
        ln_mass = np.log(_normal_mass(low, high))
        # ln of the probability beyond the bound, and of what lies between it and the value
        ends = np.where(u < 0, special.log_ndtr(low), special.log_ndtr(-high))
        x = special.ndtri_exp(np.logaddexp(ends, special.log_ndtr(-np.abs(u)) + ln_mass))
        whole = np.isinf(low) & np.isinf(high)
        return np.where(self._uniform, special.ndtr(u), np.where(whole, u, np.where(u < 0, x, -x)))

    def rate(self, theta: np.ndarray) -> np.ndarray:
        """d theta / d u (..., n_param)."""
        theta = np.asarray(theta, float)
        (low, high), scale = self._ends, self._size[1]
        u = self.transform(theta)
        x = np.where(np.isinf(low) & np.isinf(high), u, self._standard(theta))
        density = np.exp(-0.5 * (u**2 - np.where(self._uniform, 0.0, x**2)))
        density = density * np.where(self._uniform, 1 / np.sqrt(2 * np.pi), _normal_mass(low, high))
        return scale * density * np.where(self.lognormal, theta, 1.0)

    def some(self, numbers: Sequence[int]) -> NormalScores:
        """Of some of the parameters."""
        k, known = list(numbers), self.parameters.correlation
        return NormalScores(parameters=Parameters(
            tuple(self.parameters.items[i] for i in k), None if known is None else known[np.ix_(k, k)]))

    def log_cut(self, u: np.ndarray) -> np.ndarray:
        """0 (...,) where u lies within the bounds, -inf where not, which only priors that correlate let happen."""
        return np.where(self.parameters.inside(self.back(u)), 0.0, -np.inf)
