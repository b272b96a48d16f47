"""Likelihoods of several sets to second order in coordinates in which parameters vary freely: logarithms of what bounds
keep positive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from probupdate.model.parameters import Parameters
from probupdate.runtime.arrays import frozen_array
from probupdate.updating.problem import Problem
from probupdate.updating.solved_once import solved_once


@dataclass(frozen=True, eq=False, kw_only=True)
class Coordinates:
    """u = ln theta where `logarithmic` (n_param,), else theta; `scale` (n_param,) is the prior's standard deviation in
    u."""

    logarithmic: np.ndarray
    scale: np.ndarray

    def transform(self, theta: np.ndarray) -> np.ndarray:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.logarithmic, np.log(np.where(self.logarithmic, theta, 1.0)), theta)

    def back(self, u: np.ndarray) -> np.ndarray:
        return np.where(self.logarithmic, np.exp(np.where(self.logarithmic, u, 0.0)), u)

    def rate(self, theta: np.ndarray) -> np.ndarray:
        """d theta / d u (..., n_param)."""
        return np.where(self.logarithmic, theta, 1.0)


def coordinates_of(parameters: Parameters) -> Coordinates:
    """Logarithms for parameters that their bounds or prior keep positive."""
    logarithmic = np.array([p.initial > 0 and (p.lower >= 0 or p.prior == "lognormal") for p in parameters])
    relative = np.array([p.log_std if p.prior == "lognormal" else p.std / abs(p.initial or 1.0) for p in parameters])
    return Coordinates(logarithmic=frozen_array(logarithmic, bool),
                       scale=frozen_array(np.where(logarithmic, relative, parameters.std)))


@dataclass(frozen=True, eq=False, kw_only=True)
class SetLikelihoods:
    """ln p(Lambda_S of set j | theta) = value + gradient d - d^T precision d / 2, d = u - centre: value (n_set,),
    gradient, centre (n_set, n_param), precision (n_set, n_param, n_param)."""

    ids: tuple[str, ...]
    centre: np.ndarray
    value: np.ndarray
    gradient: np.ndarray
    precision: np.ndarray

    def evaluate(self, u: np.ndarray) -> np.ndarray:
        """(n, n_set) of one u (n, n_param) for all sets."""
        return self.own(np.broadcast_to(u[:, None], (len(u), *self.centre.shape)))

    def own(self, u: np.ndarray) -> np.ndarray:
        """(n, n_set) of u (n, n_set, n_param), one a set."""
        d = u - self.centre
        return self.value + np.sum(d * (self.gradient - 0.5 * np.einsum("njk,jkl->njl", d, self.precision)), axis=2)

    def marginal(self, mean: np.ndarray, factor: np.ndarray) -> np.ndarray:
        """ln of the integral over u_j ~ N(mean, factor factor^T), (n, n_set); mean (n, n_param), factor (n, n_param,
        n_param). Exact for these quadratics, at any scale down to zero."""
        slope, root = self._inner(mean, factor)
        white = np.linalg.solve(root, slope[..., None])[..., 0]
        shrink = np.log(np.diagonal(root, axis1=2, axis2=3)).sum(axis=2)
        return self.evaluate(mean) - shrink + 0.5 * np.sum(white**2, axis=2)

    def draw_own(self, mean: np.ndarray, factor: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """u_j given the population and the set's data, (n, n_set, n_param)."""
        slope, root = self._inner(mean, factor)
        turned = np.swapaxes(root, 2, 3)
        middle = np.linalg.solve(turned, np.linalg.solve(root, slope[..., None]))
        epsilon = middle + np.linalg.solve(turned, rng.standard_normal(slope.shape)[..., None])
        return mean[:, None] + (factor[:, None] @ epsilon)[..., 0]

    def _inner(self, mean, factor):
        """C^T b and the Cholesky factor of 1 + C^T H C, with b the gradient at the mean."""
        b = self.gradient - np.einsum("njk,jkl->njl", mean[:, None] - self.centre, self.precision)
        spread = np.swapaxes(factor, 1, 2)[:, None] @ self.precision @ factor[:, None]
        return np.einsum("nkl,njk->njl", factor, b), np.linalg.cholesky(np.eye(mean.shape[1]) + spread)

    def select(self, numbers: Sequence[int]) -> SetLikelihoods:
        """Of some of the sets."""
        pick = list(numbers)
        return SetLikelihoods(ids=tuple(self.ids[j] for j in pick), centre=self.centre[pick], value=self.value[pick],
                              gradient=self.gradient[pick], precision=self.precision[pick])

    def leave_out(self, number: int) -> SetLikelihoods:
        return self.select([j for j in range(len(self.ids)) if j != number])


def linearise(problems: Sequence[Problem], theta: np.ndarray, coordinates: Coordinates) -> SetLikelihoods:
    """Each set's likelihood with its responses linear in u about theta (n_set, n_param)."""
    value, gradient, precision = [], [], []
    for problem, point in zip(solved_once(problems), theta, strict=True):
        response, sensitivity = problem.sensitivity(point)
        slope = problem.whiten((sensitivity * coordinates.rate(point)).T).T
        residual = problem.whiten(problem.measured - response)
        value.append(float(problem.log_likelihood(point)[0]))
        gradient.append(slope.T @ residual)
        precision.append(slope.T @ slope)
    return SetLikelihoods(
        ids=tuple(p.set_id for p in problems), centre=frozen_array(coordinates.transform(np.asarray(theta))),
        value=frozen_array(value), gradient=frozen_array(gradient), precision=frozen_array(precision),
    )
