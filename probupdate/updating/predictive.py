"""Does the model with its prior expect these data? Checks whose p-values are uniform where it does, and scores of sets
left out.

With responses linear over the posterior's width, e the noise of unit standard deviation and s_i the singular values of
W_Lambda^(1/2) S Sigma_theta^(1/2), the residual at the maximum and the penalty there are sums of independent chi-square
variables with weights known from the s_i alone. A posterior predictive p-value that compares the data with draws of a
posterior which has seen them is not uniform (it crowds about one half); these are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg, stats

from probupdate.io.schema import BoolArray
from probupdate.updating.hierarchical import Population
from probupdate.updating.laplace import Laplace
from probupdate.updating.problem import Problem
from probupdate.updating.set_likelihoods import SetLikelihoods
from probupdate.updating.settings import CONSTANTS
from probupdate.updating.weight_smoothing import smoothed_weights

# draws of a weighted sum of chi-square variables: a p-value to 0.0025 at most
N_SUM = 40_000
SUSPICIOUS = CONSTANTS.suspicious
NONLINEAR = CONSTANTS.bent


@dataclass(frozen=True, kw_only=True)
class ResponseCheck:
    """One frequency: how far, in standard deviations of what is predicted, the data lie from the initial model
    (`prior_z`) and from the maximum of the posterior that has seen them (`posterior_z`, its standard deviation less by
    what was fitted); both standard normal where the model holds."""

    label: str
    prior_z: float
    posterior_z: float


@dataclass(frozen=True, eq=False, kw_only=True)
class PredictiveCheck:
    """`total`: misfit plus penalty at the maximum, chi-square of n_effective: prior predictive. `misfit`, `penalty`:
    each alone against its own distribution; expected and p of each. The misfit shows whether any parameters fit, the
    penalty whether those that fit are ones the prior expects. nonlinear: largest change of a whitened response between
    initial model and maximum that the slope at the maximum does not account for, in standard deviations."""

    n_effective: int
    total: float
    total_p: float
    misfit: float
    misfit_expected: float
    misfit_p: float
    penalty: float
    penalty_expected: float
    penalty_p: float
    naive_penalty_p: float
    nonlinear: float
    responses: tuple[ResponseCheck, ...]

    @property
    def sentences(self) -> tuple[str, ...]:
        """What the two checks say, in words."""
        fit = (f"prior predictive check: chi-square {self.total:.4g} for {self.n_effective} effective responses, "
               f"p = {self.total_p:.2g}")
        left = (f"posterior predictive check: misfit {self.misfit:.4g} at the maximum where {self.misfit_expected:.3g} "
                f"is expected, p = {self.misfit_p:.2g}")
        if self.misfit_p < SUSPICIOUS:
            left += ": no parameters within the prior make this model fit within the stated standard " \
                    "deviations"
        elif self.misfit_p > 1 - SUSPICIOUS:
            left += ": closer than the stated standard deviations allow by chance; they are too wide or their errors " \
                    "are correlated"
        way = (f"the update's own distance from the prior: {self.penalty:.4g} where {self.penalty_expected:.3g} is "
               f"expected, p = {self.penalty_p:.2g}")
        if self.penalty_p < SUSPICIOUS:
            way += ": the data pull the parameters to where the prior did not expect them; it is too narrow, or an " \
                   "error of the model is taken for a parameter"
        if self.nonlinear < NONLINEAR:
            return fit, left, way
        bent = (f"these p-values are rough: between initial model and maximum responses deviate from linearity "
                f"by up to {self.nonlinear:.1f} standard deviations")
        return fit, left, way, bent


def predictive_check(problem: Problem, laplace: Laplace, *, seed: int = 1) -> PredictiveCheck:
    """Of one set, at its maximum; Gaussian priors, lognormal ones by their standard deviation. Bounds are not counted:
    where they hold the maximum, the penalty is less and the misfit more than expected."""
    parameters = problem.parameters
    response, sensitivity = problem.sensitivity(laplace.theta)
    root = linalg.cholesky(parameters.covariance, lower=True)
    slope = problem.whiten(sensitivity.T).T @ root
    u, singular, _ = np.linalg.svd(slope, full_matrices=False)
    gain = singular[: problem.n_effective] ** 2
    # directions that no parameter moves are noise alone
    free = problem.n_effective - gain.size
    off = linalg.solve_triangular(root, laplace.theta - parameters.initial, lower=True)
    penalty, misfit = float(off @ off), float(problem.misfit(response))
    rng = np.random.default_rng([seed, 21])
    chi = rng.standard_normal((N_SUM, len(gain))) ** 2
    left, way = chi @ (1 / (1 + gain)), chi @ (gain / (1 + gain))
    if free:
        left = left + rng.chisquare(free, N_SUM)
    begin = problem.predict(parameters.initial)
    bent = problem.whiten(begin - response) - slope @ -off
    return PredictiveCheck(
        n_effective=problem.n_effective, total=misfit + penalty,
        total_p=float(stats.chi2.sf(misfit + penalty, problem.n_effective)),
        misfit=misfit, misfit_expected=float(np.sum(1 / (1 + gain)) + free), misfit_p=_share(left, misfit),
        penalty=penalty, penalty_expected=float(np.sum(gain / (1 + gain))), penalty_p=_share(way, penalty),
        naive_penalty_p=float(stats.chi2.sf(penalty, len(parameters))), nonlinear=float(np.max(np.abs(bent))),
        responses=_responses(problem, begin, response, u, singular, slope),
    )


def _share(drawn: np.ndarray, value: float) -> float:
    """Share of draws beyond the value, never zero."""
    return float((1 + np.sum(drawn >= value)) / (1 + drawn.size))


def _responses(problem: Problem, begin, response, u, singular, slope) -> tuple[ResponseCheck, ...]:
    """Of frequencies, that come first; with joint standard deviations each by its own marginal one."""
    found = []
    residual, before = problem.measured - response, problem.measured - begin
    independent = problem.root is None
    for k in range(problem.n_frequency):
        label = problem.mode_labels[problem.used[k]]
        # of row k in standard deviations: 1 + s s^T before, its inverse's diagonal after the fit
        spread = float(np.sum(slope[k] ** 2)) if independent else np.nan
        taken = float(np.sum(u[k] ** 2 * singular**2 / (1 + singular**2))) if independent else np.nan
        std = problem.std[k]
        found.append(ResponseCheck(label=label, prior_z=float(before[k] / std / np.sqrt(1 + spread)),
                                   posterior_z=float(residual[k] / std / np.sqrt(max(1 - taken, 1e-12)))))
    return tuple(found)


# Sets left out ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, kw_only=True)
class LeaveOneOut:
    """ln p(data of a set | all other sets) (n_set,), by name of the view; pareto_k (n_set,) of the population's
    importance weights, refitted (n_set,) where they fail."""

    ids: tuple[str, ...]
    score: dict[str, np.ndarray]
    pareto_k: np.ndarray
    refitted: BoolArray

    def difference(self, one: str, other: str) -> tuple[float, float]:
        """Sum of score one minus other, and its standard error over the sets."""
        d = self.score[one] - self.score[other]
        return float(d.sum()), float(np.sqrt(d.size * np.var(d, ddof=1)))


def population_left_out(population: Population, number: int) -> tuple[float, float]:
    """ln p(data of set `number` | the others) from draws that have seen it, and Pareto k."""
    own = population.log_likelihood[:, number]
    weight, k = smoothed_weights(-own)
    return float(_log_sum(weight + own)), k


def population_score(population: Population, likelihoods: SetLikelihoods, number: int) -> float:
    """The same from draws that have not seen it."""
    value = likelihoods.select([number]).marginal(population.mean, population.factor)[:, 0]
    return float(_log_sum(value) - np.log(value.size))


def _log_sum(value: np.ndarray) -> float:
    top = np.max(value)
    return float(top + np.log(np.sum(np.exp(value - top))))


def bits_gained(cumulative: np.ndarray, effective: float) -> float:
    """Information gained on one quantity in bits, the Kullback-Leibler divergence of its draws from the prior:
    `cumulative` (n,) is the prior's distribution function at draws worth `effective` independent ones.

    By the prior's mass between the draws' quantiles, less the bias that spacings of so many draws have (Vasicek 1976).
    """
    n_bin = int(np.clip(effective / 25, 4, 60))
    edges = np.quantile(cumulative, np.linspace(0, 1, n_bin + 1))
    mass = np.maximum(np.diff(edges), 1e-300)
    # E[ln spacing] of m of n draws is ln(m / n) - 1 / (2 m) to first order
    bias = 0.5 * n_bin / effective
    return float(max(0.0, (-np.mean(np.log(mass * n_bin)) - bias) / np.log(2)))
