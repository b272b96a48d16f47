"""Where the truth lies in what is said of the parameters: the posterior, and the intervals of deterministic updates.

The posterior is weighted draws from several sources at once, weighed by the mixture of all their densities (the balance
heuristic of Veach & Guibas 1995, the deterministic mixture of Owen & Zhou 2000): a pool of prior draws that is solved
once for all replicates, a Student t around the Laplace approximation where that is at hand, and Student t distributions
fitted to the weighted draws so far, in ln theta. The pool bounds the weights: nothing inside the prior is missed. Where
these do not reach WANTED effective draws with a Pareto k that can be trusted, the product's chain serves.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass

import numpy as np
from chain import PRIORS, of_kind
from ranks import weighted_rank
from scipy import stats

from probupdate.model.interface import ManySolutions
from probupdate.updating.ensemble import SamplerSettings, sample
from probupdate.updating.evidence import TRUSTED_K, pareto_shape
from probupdate.updating.laplace import Laplace, maximum_a_posteriori
from probupdate.updating.problem import Problem, build_problem
from probupdate.updating.surrogate import fit_surrogate
from probupdate.updating.tikhonov import update

N_POOL = 10_000
# pool rows whose frequencies alone miss by this much more than the best row's weigh nothing: their shapes are not asked
MISSED = 24.0
DRAWS, ROUNDS, WANTED = 500, 5, 250
MORE_DRAWS, MORE_ROUNDS = 2000, 8  # where these do not do: sharp data's posteriors bend
DEGREES = 5.0  # of the Student t distributions
SPREAD = 1.2  # times the covariance of the weighted draws
CHAIN = {"target_ess": 300, "max_steps": 3000}
ITERATIONS = 10  # of Eq. 7 as printed


@dataclass(frozen=True, eq=False, kw_only=True)
class Pool:
    """Draws of both priors in equal numbers, theta (n, n_param), solved: frequency_hz (n, n_mode), shape (n, n_channel,
    n_mode); log_density (n,) of the priors' mixture."""

    theta: np.ndarray
    frequency_hz: np.ndarray
    shape: np.ndarray
    parameters: tuple

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        return np.logaddexp(*(p.log_density(theta) for p in self.parameters)) - np.log(len(self.parameters))


def make_pool(model, n: int = N_POOL, seed: int = 0) -> Pool:
    rng = np.random.default_rng([seed, 11])
    parameters = tuple(of_kind(model.parameters, kind) for kind in PRIORS)
    theta = np.vstack([p.draw(rng, n // len(parameters)) for p in parameters])
    parts = [model.solve_many(rows, model.n_mode) for rows in np.array_split(theta, max(1, n // 2000))]
    return Pool(theta=theta, frequency_hz=np.concatenate([p.frequency_hz for p in parts]),
                shape=np.concatenate([p.shape for p in parts]).astype(np.float32), parameters=parameters)


@dataclass(frozen=True, eq=False)
class _Solved:
    """A model whose answers are known."""

    parameters: object
    solutions: ManySolutions

    def solve_many(self, theta, n_mode):
        s = self.solutions
        return ManySolutions(frequency_hz=s.frequency_hz[:, :n_mode], shape=s.shape[:, :, :n_mode], fallback=s.fallback)


@dataclass(frozen=True, eq=False, kw_only=True)
class Place:
    """rank (n_param,) of the truth and rank_log_likelihood of its log-likelihood among the posterior's draws; how it
    was drawn, effective draws, Pareto k; misfit at the truth, n_effective; mean and standard deviation of the
    posterior."""

    rank: np.ndarray
    rank_log_likelihood: float
    by: str
    effective: float
    pareto_k: float
    misfit: float
    n_effective: int
    mean: np.ndarray
    std: np.ndarray


def place_of_truth(
    problem: Problem, pool: Pool, theta: np.ndarray, rng: np.random.Generator, seed: int, top: Laplace | None
) -> Place:
    draws, log_likelihood, weight, k = _mixture(problem, pool, rng, top)
    by, effective = "weights", _effective(weight)
    if top is None and (k > TRUSTED_K or effective < WANTED):
        # from around the maximum the mixture mostly finds a posterior that the prior's draws hardly hit
        top = maximum_a_posteriori(problem, [problem.parameters.initial])
        draws, log_likelihood, weight, k = _mixture(problem, pool, rng, top)
        effective = _effective(weight)
    if k > TRUSTED_K or effective < WANTED:
        approximation, _ = fit_surrogate(problem, top, rng)
        with tempfile.TemporaryDirectory() as folder:
            chain = sample(problem, approximation, folder, SamplerSettings(seed=seed, **CHAIN))
        by, effective, draws = "chain", float(np.min(chain.ess)), chain.draws
        log_likelihood = chain.log_posterior[chain.first :].ravel() - problem.parameters.log_density(draws)
        weight = np.ones(len(draws))
    at_truth = float(problem.log_likelihood(theta)[0])
    ranks = weighted_rank(np.column_stack([draws, log_likelihood]), np.append(theta, at_truth), weight)
    mean = weight @ draws / weight.sum()
    std = np.sqrt(weight @ (draws - mean) ** 2 / weight.sum())
    return Place(
        rank=ranks[:-1], rank_log_likelihood=float(ranks[-1]), by=by, pareto_k=k, effective=effective,
        misfit=float(problem.misfit(problem.predict(theta))), n_effective=problem.n_effective, mean=mean, std=std,
    )


def _mixture(problem: Problem, pool: Pool, rng, top: Laplace | None):
    """Draws (n, n_param), log-likelihood, weights (n,) and Pareto k."""
    rows = _likely(problem, pool)
    theta = pool.theta[rows]
    solved = ManySolutions(frequency_hz=pool.frequency_hz[rows], shape=pool.shape[rows].astype(float),
                           fallback=np.zeros(len(rows), bool))
    known = problem.with_model(_Solved(problem.parameters, solved))
    value = known.log_likelihood(theta)
    sources = [(len(pool.theta), pool.log_density)]
    last = ROUNDS + MORE_ROUNDS
    for number in range(last + 1):
        log_prior = problem.parameters.log_density(theta)
        mixture = np.logaddexp.reduce([np.log(n) + density(theta) for n, density in sources])
        log_weight = value + log_prior - mixture
        weight = np.exp(log_weight - log_weight.max())
        k = pareto_shape(log_weight)
        if (k <= TRUSTED_K and _effective(weight) >= WANTED) or number == last:
            return theta, value, weight, k
        n = DRAWS if number < ROUNDS else MORE_DRAWS
        if number == 0 and top is not None:
            fresh, density = _student(top.theta, top.covariance, rng, problem.parameters, n, logarithms=False)
        else:
            # few draws carry the first rounds' weight: tempered, so that the fit has a width
            soft = weight ** (1.0 if _effective(weight) > 50 else 0.3)
            soft /= soft.sum()
            u = np.log(theta)
            centre = soft @ u
            spread = (u - centre).T @ (soft[:, None] * (u - centre))
            fresh, density = _student(centre, SPREAD * spread, rng, problem.parameters, n, logarithms=True)
        sources.append((n, density))
        theta = np.vstack([theta, fresh])
        value = np.concatenate([value, problem.log_likelihood(fresh)]) if len(fresh) else value


def _likely(problem: Problem, pool: Pool) -> np.ndarray:
    """Rows of the pool whose frequencies, taken in the modes' order, are not hopeless."""
    measured = np.concatenate([g.frequency_hz for g in problem.groups])
    variance = problem.std**2 + np.sum(problem.factor**2, axis=1)
    std = np.sqrt(variance[: problem.n_frequency])
    measured = measured - problem.mean[: problem.n_frequency]
    missed = np.sum(((pool.frequency_hz[:, problem.matching.computed] - measured) / std) ** 2, axis=1)
    return np.flatnonzero(missed < missed.min() + MISSED)


def _student(centre, covariance, rng, parameters, n: int, *, logarithms: bool):
    """n draws of a Student t, those inside the bounds, and its density over theta."""
    # in units of its standard deviations, as masses in kg stand beside factors
    scale = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(scale, scale) + 1e-6 * np.eye(len(scale))
    shape = stats.multivariate_t(np.zeros(len(scale)), correlation, df=DEGREES)
    drawn = centre + scale * shape.rvs(n, random_state=rng)

    def log_density(theta):
        u = np.log(theta) if logarithms else theta
        value = shape.logpdf((u - centre) / scale) - np.sum(np.log(scale))
        return value - (u.sum(axis=1) if logarithms else 0.0)

    fresh = np.exp(drawn) if logarithms else drawn
    return fresh[parameters.inside(fresh)], log_density


def _effective(weight: np.ndarray) -> float:
    return float(weight.sum() ** 2 / np.sum(weight**2))


def gaussian_rank(theta: np.ndarray, centre: np.ndarray, std: np.ndarray) -> np.ndarray:
    """The same of intervals centre +- z std."""
    return stats.norm.cdf((theta - centre) / std)


def printed_interval(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Eq. 7 as printed after ITERATIONS, and the Gauss-Newton standard deviations (S^T W_Lambda S + W_Theta)^-1
    there."""
    found = update(problem, penalty="step", max_iteration=ITERATIONS).theta[-1]
    _, sensitivity = problem.sensitivity(found)
    over = problem.whiten(sensitivity.T)
    precision = over @ over.T + np.linalg.inv(problem.parameters.covariance)
    return found, np.sqrt(np.diag(np.linalg.inv(precision)))


def set_wise_scatter(fast, full, measured, problem: Problem, top: Laplace) -> np.ndarray:
    """Standard deviation (n_param,) of the maxima of every set's posterior (Table 7)."""
    clusters = [group.measured for group in problem.matching.groups]
    ends = [top.theta]
    for each in measured.data.sets[1:]:
        other = build_problem(full, measured.data, set_id=each.id, weights=measured.weights, clusters=clusters)
        ends.append(maximum_a_posteriori(other.with_model(fast), [top.theta]).theta)
    return np.std(ends, axis=0, ddof=1)
