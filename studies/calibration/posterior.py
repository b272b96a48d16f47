"""Where the truth lies in what is said of the parameters: the posterior, and the intervals of deterministic updates.

The posterior is weighted draws of the Laplace approximation (cut at the bounds, a share of them wider), more of them
until they are worth WANTED independent ones; where they do not get there or their weights cannot be trusted (Pareto k),
of the posterior's outline; where that fails too, the product's chain.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass

import numpy as np
from ranks import weighted_rank
from scipy import stats

from probupdate.estimators.ensemble import SamplerSettings, sample
from probupdate.estimators.evidence import TRUSTED_K, pareto_shape
from probupdate.estimators.laplace import Laplace, maximum_a_posteriori
from probupdate.estimators.surrogate import Proposal, fit_surrogate, from_laplace
from probupdate.estimators.tikhonov import update
from probupdate.problem import Problem, build_problem

DRAWS, MOST_ROUNDS = 1000, 4
WANTED = 200
CHAIN = {"target_ess": 300, "max_steps": 3000}
ITERATIONS = 10  # of Eq. 7 as printed


@dataclass(frozen=True, eq=False, kw_only=True)
class Place:
    """rank (n_param,) of the truth and rank_log_likelihood of its log-likelihood among the posterior's draws; how it
    was drawn, effective draws, Pareto k; misfit at the truth less n_effective; mean and deviation of the posterior."""

    rank: np.ndarray
    rank_log_likelihood: float
    by: str
    effective: float
    pareto_k: float
    misfit: float
    n_effective: int
    mean: np.ndarray
    std: np.ndarray


def place_of_truth(problem: Problem, top: Laplace, theta: np.ndarray, rng: np.random.Generator, seed: int) -> Place:
    by, laplace = "laplace", from_laplace(top, problem.parameters)
    draws, weight, k = _weighted(problem, Proposal(outline=laplace), rng)
    if not _good(weight, k):
        by, (outline, _) = "outline", fit_surrogate(problem, top, rng)
        draws, weight, k = _weighted(problem, Proposal(outline=outline), rng)
    if not _good(weight, k):
        by = "chain"
        with tempfile.TemporaryDirectory() as folder:
            chain = sample(problem, outline, folder, SamplerSettings(seed=seed, **CHAIN))
        log_posterior = chain.log_posterior[chain.first :].ravel()
        draws = np.column_stack([chain.draws, log_posterior - problem.parameters.log_density(chain.draws)])
        weight = np.ones(len(draws))
    true_log_likelihood = float(problem.log_likelihood(theta)[0])
    ranks = weighted_rank(draws, np.append(theta, true_log_likelihood), weight)
    mean = weight @ draws[:, :-1] / weight.sum()
    std = np.sqrt(weight @ (draws[:, :-1] - mean) ** 2 / weight.sum())
    return Place(
        rank=ranks[:-1], rank_log_likelihood=float(ranks[-1]), by=by, pareto_k=k,
        effective=float(np.min(chain.ess)) if by == "chain" else _effective(weight),
        misfit=float(problem.misfit(problem.predict(theta))), n_effective=problem.n_effective, mean=mean, std=std,
    )


def _weighted(problem: Problem, proposal: Proposal, rng) -> tuple[np.ndarray, np.ndarray, float]:
    """Draws with their log-likelihood in the last column (n, n_param + 1), weights (n,), Pareto k of these."""
    parts, log_weight = [], np.empty(0)
    for _ in range(MOST_ROUNDS):
        drawn = proposal.draw(DRAWS, rng)
        value, _ = problem.log_posterior(drawn)
        parts.append(np.column_stack([drawn, value - problem.parameters.log_density(drawn)]))
        log_weight = np.concatenate([log_weight, value - proposal.log_density(drawn)])
        weight = np.exp(log_weight - log_weight.max())
        if _effective(weight) >= WANTED:
            break
    return np.vstack(parts), weight, pareto_shape(log_weight)


def _effective(weight: np.ndarray) -> float:
    return float(weight.sum() ** 2 / np.sum(weight**2))


def _good(weight: np.ndarray, k: float) -> bool:
    return k <= TRUSTED_K and _effective(weight) >= WANTED


def gaussian_rank(theta: np.ndarray, centre: np.ndarray, std: np.ndarray) -> np.ndarray:
    """The same of intervals centre +- z std."""
    return stats.norm.cdf((theta - centre) / std)


def printed_interval(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Eq. 7 as printed after ITERATIONS, and the Gauss-Newton deviations (S^T W_Lambda S + W_Theta)^-1 there."""
    found = update(problem, penalty="step", max_iteration=ITERATIONS).theta[-1]
    _, sensitivity = problem.sensitivity(found)
    over = problem.weighted(sensitivity.T)
    precision = over @ over.T + np.linalg.inv(problem.parameters.covariance)
    return found, np.sqrt(np.diag(np.linalg.inv(precision)))


def nine_sets(fast, full, measured, problem: Problem, top: Laplace) -> np.ndarray:
    """Deviation (n_param,) of the maxima of every set's posterior (Table 7)."""
    clusters = [group.measured for group in problem.matching.groups]
    ends = [top.theta]
    for each in measured.data.sets[1:]:
        other = build_problem(full, measured.data, set_id=each.id, weights=measured.weights, clusters=clusters)
        ends.append(maximum_a_posteriori(other.with_model(fast), [top.theta]).theta)
    return np.std(ends, axis=0, ddof=1)
