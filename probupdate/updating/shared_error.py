"""An error of the model that all sets share: the same wrong wall or soil law in every one of them.

Sets of one structure are independent in their identification, not in what is not known of the model. With the noise's
likelihood of set j linear about its centre, r_j - J_j d_j - B_j e over its standard deviations, and e ~ N(0, 1) common
to all, e is integrated out once over all sets together. Nine sets then narrow the noise by three and the model's error
not at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from probupdate.errors import InputError
from probupdate.runtime.arrays import frozen_array
from probupdate.updating.hierarchical import Coordinates, Population, SetLikelihoods
from probupdate.updating.problem import Problem


@dataclass(frozen=True, eq=False, kw_only=True)
class SharedError:
    """Of each set about its centre (n_set, n_param) in u: whitened residual r (n,), slope J (n, n_param), factor B
    (n, n_source)."""

    centre: np.ndarray
    residual: tuple[np.ndarray, ...]
    slope: tuple[np.ndarray, ...]
    factor: tuple[np.ndarray, ...]

    def joint_term(self, keep: Sequence[int]) -> SetLikelihoods:
        """What the sources add to the sum of the noise's log-likelihoods of these sets at one common u, as one more
        quadratic: b^T A^-1 b / 2 - ln det A / 2 with b = sum of B_j^T (r_j - J_j d_j) and A = 1 + sum of B_j^T B_j."""
        middle = self.centre[list(keep)].mean(axis=0)
        n = self.factor[0].shape[1]
        A, F, b = np.eye(n), np.zeros((n, middle.size)), np.zeros(n)
        for j in keep:
            B, J = self.factor[j], self.slope[j]
            A += B.T @ B
            F += B.T @ J
            b += B.T @ (self.residual[j] - J @ (middle - self.centre[j]))
        solved = np.linalg.solve(A, np.column_stack([b, F]))
        value = 0.5 * b @ solved[:, 0] - 0.5 * np.linalg.slogdet(A)[1]
        return SetLikelihoods(
            ids=("the sources of the model's error",), centre=frozen_array(middle[None]), value=frozen_array([value]),
            gradient=frozen_array(-(F.T @ solved[:, 0])[None]), precision=frozen_array(-(F.T @ solved[:, 1:])[None]),
        )

    def widened(self, population: Population, prior_precision: np.ndarray, rng: np.random.Generator) -> Population:
        """The population with its mean where the sources allow it: they move all sets alike, so that the scatter stays.

        Each draw's mean is shifted by what a draw of e, given the data, does to it at the population's median tau.
        """
        n = self.factor[0].shape[1]
        spread = np.median(population.tau, axis=0) ** 2
        about = np.median(population.mean, axis=0)
        K, C, N, f = np.array(prior_precision), np.zeros((about.size, n)), np.eye(n), np.zeros(n)
        for j, (B, J) in enumerate(zip(self.factor, self.slope, strict=True)):
            # (1 + J D J^T)^-1: each set's own scatter counts as noise
            inner = np.linalg.inv(np.eye(len(J)) + (J * spread) @ J.T)
            K += J.T @ inner @ J
            C += J.T @ inner @ B
            N += B.T @ inner @ B
            f += B.T @ inner @ (self.residual[j] - J @ (about - self.centre[j]))
        covariance = np.linalg.inv(N - C.T @ np.linalg.solve(K, C))
        root = np.linalg.cholesky(0.5 * (covariance + covariance.T))
        e = covariance @ f + rng.standard_normal((len(population.mean), n)) @ root.T
        return replace(population, mean=frozen_array(population.mean - e @ np.linalg.solve(K, C).T))


def shared_error(problems: Sequence[Problem], theta: np.ndarray, coordinates: Coordinates) -> SharedError | None:
    """Of problems with the same sources, about theta (n_set, n_param); None where none is stated."""
    if all(p.error is None for p in problems):
        return None
    names = {tuple(s.name for s in p.error_sources) for p in problems}
    if len(names) > 1:
        raise InputError("sets", "state different sources of the model's error", "give all sets one model")
    residual, slope, factor = [], [], []
    for problem, point in zip(problems, theta, strict=True):
        response, sensitivity = problem.sensitivity(point)
        root = problem.noise_root
        residual.append(root @ (problem.measured - response))
        slope.append(root @ (sensitivity * coordinates.rate(point)))
        factor.append(root @ problem.factor)
    return SharedError(centre=frozen_array(coordinates.to(np.asarray(theta))), residual=tuple(residual),
                       slope=tuple(slope), factor=tuple(factor))
