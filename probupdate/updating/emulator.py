"""A quick likelihood for proposals: every response a quadratic of the parameters, in the coordinates of the Gaussian
approximation.

Sharp posteriors are thin, bent ridges: no Gaussian follows them, and moves along straight differences leave them. A
quadratic response surface bends with the responses, so that its misfit, a quartic, bends with the ridge. Walkers move
on it many times before the model is asked once (delayed acceptance: Christen & Fox 2005). Nothing is concluded from it.
"""

from __future__ import annotations

from dataclasses import dataclass

import emcee
import numpy as np

from probupdate.model.parameters import Parameters
from probupdate.runtime.arrays import frozen_array
from probupdate.runtime.progress import Progress, silent
from probupdate.updating.problem import Problem
from probupdate.updating.surrogate import GaussianApproximation, to_coordinates

# points per coefficient that surfaces are fitted to, drawn from a Gaussian approximation of so many times its variance
POINTS_PER_COEFFICIENT, SPREAD = 6, 1.5
# of a point's log posterior below the best: how fast its weight in the fit falls
WEIGHT_POWER = 0.3
# of the coefficients, as a share of the points
RIDGE = 1e-6
# the misfit counts by this share: a quick density a little too wide leaves no walker where it is far too low
FLATTER = 0.9
# moves on the quick density for each question to the model
SUBSTEPS = 40


@dataclass(frozen=True, eq=False, kw_only=True)
class Emulator:
    """misfit = features^T gram features, with features 1, d, d d^T of d = (u - centre) / scale in the coordinates u of
    the Gaussian approximation; `error`: standard deviation of its log-likelihood on draws not fitted to, weighted as
    the posterior is."""

    parameters: Parameters
    approximation: GaussianApproximation
    centre: np.ndarray
    scale: np.ndarray
    gram: np.ndarray
    error: float

    def misfit(self, theta: np.ndarray) -> np.ndarray:
        """(n,) of theta (n, n_param) inside the bounds."""
        features = _features(theta, self.approximation, self.centre, self.scale)
        return np.einsum("ij,ij->i", features @ self.gram, features)

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        """ln of the quick posterior + const (n,), -inf outside the bounds."""
        value = self.parameters.log_density(theta)
        inside = np.isfinite(value)
        value[inside] -= 0.5 * FLATTER * self.misfit(theta[inside])
        return value


def _features(theta, approximation: GaussianApproximation, centre, scale) -> np.ndarray:
    d = (to_coordinates(theta - approximation.origin, approximation.powers) - centre) / scale
    i, j = np.triu_indices(d.shape[1])
    return np.concatenate([np.ones((len(d), 1)), d, d[:, i] * d[:, j]], axis=1)


def fit_emulator(
    problem: Problem, approximation: GaussianApproximation, rng: np.random.Generator, progress: Progress = silent
) -> Emulator:
    """Weighted least squares of all weighted responses, at draws of the widened Gaussian approximation."""
    n = len(problem.parameters)
    n_feature = 1 + n + n * (n + 1) // 2
    wide = approximation.widened(SPREAD)
    theta = wide.draw(2 * POINTS_PER_COEFFICIENT * n_feature, rng)
    progress("response surfaces", 0, 1)
    residual = problem.weighted(problem.measured - problem.predict_many(theta).response)
    value = problem.parameters.log_density(theta) - 0.5 * np.sum(residual**2, axis=1)
    u = to_coordinates(theta - approximation.origin, approximation.powers)
    centre, scale = u.mean(axis=0), u.std(axis=0)
    features = _features(theta, approximation, centre, scale)
    root = np.exp(0.5 * np.maximum(WEIGHT_POWER * (value - value.max()), -20.0))[:, None]
    fitted, judged = slice(0, None, 2), slice(1, None, 2)
    matrix, right = (root * features)[fitted], (root * residual)[fitted]
    normal = matrix.T @ matrix
    normal += RIDGE * np.trace(normal) / n_feature * np.eye(n_feature)
    surface = np.linalg.solve(normal, matrix.T @ right)
    missed = 0.5 * (np.sum((features @ surface) ** 2, axis=1) - np.sum(residual**2, axis=1))[judged]
    weight = value[judged] - wide.log_density(theta[judged])
    weight = np.exp(weight - weight.max())
    mean = np.sum(weight * missed) / weight.sum()
    error = float(np.sqrt(np.sum(weight * (missed - mean) ** 2) / weight.sum()))
    progress("response surfaces", 1, 1)
    return Emulator(parameters=problem.parameters, approximation=approximation, centre=frozen_array(centre),
                    scale=frozen_array(scale), gram=frozen_array(surface @ surface.T), error=error)


class EmulatorMove(emcee.moves.RedBlueMove):
    """SUBSTEPS moves of each walker on the quick posterior, then the ratio of the two densities decides.

    Each inner move, drawn at random, leaves the quick posterior as it is and is reversible while the other half of the
    walkers stands; so is any number of them in a row.
    """

    def __init__(self, emulator: Emulator, inner: list[tuple[emcee.moves.RedBlueMove, float]]):
        super().__init__()
        self._emulator = emulator
        self._moves = [move for move, _ in inner]
        self._limits = np.cumsum([share for _, share in inner])

    def setup(self, coords):
        for move in self._moves:
            move.setup(coords)

    def get_proposal(self, sample, complement, random):
        start = value = self._emulator.log_density(sample)
        theta = sample
        chosen = np.searchsorted(self._limits, self._limits[-1] * random.uniform(size=SUBSTEPS), side="right")
        for number in chosen:
            trial, factor = self._moves[number].get_proposal(theta, complement, random)
            fresh = self._emulator.log_density(trial)
            taken = np.log(random.uniform(size=len(theta))) < fresh - value + factor
            theta, value = np.where(taken[:, None], trial, theta), np.where(taken, fresh, value)
        return theta, start - value
