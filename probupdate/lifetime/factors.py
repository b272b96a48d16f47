"""Model factors X_dyn: what is measured over what the design says, with their bias, CoV and what the CoV is made of.

ln X is linear about the posterior's maximum in the parameters (slope a) and in what the model states and nobody knows,
its tolerances u (slope b). The error of its value at the estimate and u = 0, a^T (theta^ - theta) - b^T u, has the
components of the one model (`updating.components`): identification, model discrepancy, tolerances, through the
estimate and directly at once, and what the prior has left. X itself, its bias and CoV, is drawn: parameters from the
posterior as it is, tolerances given the data and the parameters (`tolerance_draws`), as stress is not linear in soft
joints.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probupdate.runtime.arrays import frozen_array
from probupdate.updating.components import candidates, whitened_at
from probupdate.updating.laplace import Laplace, prior_residual
from probupdate.updating.problem import Problem

PARTS = ("measurement", "tolerance", "set_to_set", "model_form", "prior")


@dataclass(frozen=True, eq=False, kw_only=True)
class Gains:
    """What moves the estimate: measurement (n_param, n_response), model_form (n_param, n_response), tolerance (n_param,
    n_source) and prior (n_param, n) for unit normal errors of each; covariance (n_param, n_param)."""

    theta: np.ndarray
    covariance: np.ndarray
    measurement: np.ndarray
    model_form: np.ndarray
    tolerance: np.ndarray
    prior: np.ndarray
    sources: tuple[str, ...]
    source_std: np.ndarray

    def parts(self, slope: np.ndarray, direct: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """Standard deviation of ln X by part, (n_quantity,) each, without set-to-set. slope (n_quantity, n_param),
        direct (n_quantity, n_source) d ln X / d u per unit of each source."""
        through = slope @ self.tolerance
        own = 0.0 if direct is None else direct * self.source_std
        size = {
            "measurement": slope @ self.measurement,
            "tolerance": through - own,
            "model_form": slope @ self.model_form,
            "prior": slope @ self.prior,
        }
        found = {k: np.sqrt(np.sum(v**2, axis=1)) for k, v in size.items()}
        found["measurement"] = np.sqrt(np.maximum(found["measurement"] ** 2 - found["model_form"] ** 2, 0.0))
        return found


def gains(problem: Problem, laplace: Laplace) -> Gains:
    """Of one problem at the maximum of its posterior; the squares of all parts along a parameter add up to its
    variance."""
    _, sensitivity = problem.sensitivity(laplace.theta)
    _, prior_slope = prior_residual(problem.parameters, laplace.theta)
    X, B = problem.noise_root @ sensitivity, problem.noise_root @ problem.factor
    inner = np.eye(B.shape[1]) + B.T @ B
    XB = X.T @ B
    P = np.linalg.inv(X.T @ X - XB @ np.linalg.solve(inner, XB.T) + prior_slope.T @ prior_slope)
    gain = P @ (X.T - XB @ np.linalg.solve(inner, B.T))
    sources = problem.error_sources
    return Gains(
        theta=frozen_array(laplace.theta),
        covariance=frozen_array(P),
        measurement=frozen_array(gain),
        model_form=frozen_array(gain @ (problem.noise_root * problem.discrepancy_std)),
        tolerance=frozen_array(gain @ B),
        prior=frozen_array(P @ prior_slope.T),
        sources=tuple(s.name for s in sources),
        source_std=frozen_array([s.std for s in sources]),
    )


def variance_shares(
    problem: Problem, laplace: Laplace, slope: np.ndarray, direct: np.ndarray | None = None
) -> list[tuple[str, np.ndarray]]:
    """The share of the variance of ln X, as measurement, model error and prior make it, that one more measurement, or a
    quantity better known, would take off, (n_quantity,) each, as `components` lists them; the most useful first. slope
    (n_quantity, n_param), direct (n_quantity, n_source) per unit.

    Of a tolerance that becomes known the part that acts on stress directly goes too (parameters and tolerances
    together); of more data it is what comes through the parameters.
    """
    now = whitened_at(problem, laplace)
    sources = problem.error_sources
    through = np.einsum("ij,jk,ik->i", slope, now.covariance(), slope)
    n = slope.shape[1]
    own = np.zeros((len(slope), now.factor.shape[1]))
    if direct is not None:
        own[:, : len(sources)] = direct * np.array([s.std for s in sources])
    both, A = np.hstack([slope, own]), np.hstack([now.slope, now.factor])
    precision = A.T @ A
    precision[:n, :n] += now.prior
    precision[n:, n:] += np.eye(own.shape[1])
    whole = np.einsum("ij,ji->i", both, np.linalg.solve(precision, both.T))
    found = []
    for one in candidates(problem, laplace, now):
        if one.known:
            kept = np.setdiff1d(np.arange(len(precision)), n + np.array(one.known))
            part = both[:, kept]
            gone = whole - np.einsum("ij,ji->i", part, np.linalg.solve(precision[np.ix_(kept, kept)], part.T))
        else:
            gone = through - np.einsum("ij,jk,ik->i", slope, one.covariance, slope)
        found.append((one.what, np.clip(gone / np.maximum(whole, 1e-300), 0.0, 1.0)))
    return sorted(found, key=lambda item: -float(np.max(item[1])))


def tolerance_draws(
    problem: Problem, thetas: np.ndarray, rng: np.random.Generator, *, response: np.ndarray | None = None,
    lowest: np.ndarray | None = None,
) -> np.ndarray:
    """(n, n_source) draws of the tolerances in their units, differences from what is stated, given the data and each of
    thetas (n, n_param): Gaussian, as responses are linear in them; the mean that is expected of a source in it. What
    falls below `lowest` (n_source,) is held there, and the others are given that. `response`: the problem's prediction
    (n, n_response) at thetas, where it is known already."""
    std = np.array([s.std for s in problem.error_sources])
    mean = np.array([s.mean for s in problem.error_sources])
    B = problem.noise_root @ problem.factor
    root = np.linalg.cholesky(np.linalg.inv(np.eye(B.shape[1]) + B.T @ B))
    response = problem.predict_many(thetas).response if response is None else response
    # what a source is expected to do (its mean) is in the prediction
    residual = (problem.measured - response) @ problem.noise_root.T
    unit = residual @ B @ (root @ root.T) + rng.standard_normal((len(thetas), B.shape[1])) @ root.T
    return mean + std * (unit if lowest is None else _censored_draws(unit, (lowest - mean) / std, root @ root.T))


def _censored_draws(draws: np.ndarray, lowest: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Draws (n, n_source) of a Gaussian with what lies below `lowest` set to it, and the others moved as they follow
    from that: what the data say of all together stays."""
    found = np.array(draws)
    for row, drawn in zip(found, draws, strict=True):
        held = np.zeros(len(row), bool)
        while np.any(below := (row < lowest) & ~held):
            held |= below
            own = covariance[np.ix_(held, held)]
            row[:] = drawn + covariance[:, held] @ np.linalg.solve(own, lowest[held] - drawn[held])
            row[held] = lowest[held]
    return found
