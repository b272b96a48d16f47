"""The evidence ln p(data), by two estimators with their errors, and whether the Laplace approximation may be used.

Bridge sampling (Meng & Wong 1996) joins the chain's draws with draws of a proposal that is normalised within the
bounds: those of importance sampling. Its error is that of Frühwirth-Schnatter (2004), with the chain's
autocorrelation. Importance sampling by the same draws stands beside it; the shape k of the generalised Pareto
distribution that fits the largest weights (Vehtari et al., 2024) shows whether they can be averaged at all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from probupdate.errors import ConvergenceError
from probupdate.model.parameters import Parameters
from probupdate.runtime.progress import Progress, silent
from probupdate.updating.laplace import Laplace
from probupdate.updating.problem import Problem
from probupdate.updating.settings import CONSTANTS
from probupdate.updating.surrogate import Density, from_laplace

# most draws of the chain that are used
N_CHAIN = 4000
# draws of the Laplace approximation that judge it
N_LAPLACE = 500
TRUSTED_K = CONSTANTS.trusted_k
CHUNK = 500


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """ln p(data) and its standard deviation by bridge sampling; the same by importance sampling, with Pareto k."""

    log_evidence: float
    std: float
    importance: float
    importance_std: float
    pareto_k: float
    n_proposed: int

    @property
    def agrees(self) -> bool:
        """Within four of their standard deviations, where both claim one."""
        return abs(self.log_evidence - self.importance) < 4 * np.hypot(self.std, self.importance_std) + 0.01

    @property
    def sentence(self) -> str:
        text = f"ln evidence {self.log_evidence:.3f} +- {self.std:.3f} by bridge sampling"
        if self.pareto_k > TRUSTED_K:
            return f"{text}; importance weights have Pareto k {self.pareto_k:.2f} and confirm nothing"
        other = f"{self.importance:.3f} +- {self.importance_std:.3f}"
        text += f", {other} by importance sampling (Pareto k {self.pareto_k:.2f})"
        return text if self.agrees else f"{text}: THEY DISAGREE, use neither"


@dataclass(frozen=True, kw_only=True)
class LaplaceCheck:
    """Pareto k and effective share of the weights posterior / Laplace at draws of the Laplace approximation within the
    bounds, and ln p(data) by it."""

    pareto_k: float
    share: float
    log_evidence: float

    @property
    def sentence(self) -> str:
        text = f"Laplace approximation: Pareto k {self.pareto_k:.2f}, effective share of its draws {self.share:.2f}"
        if self.pareto_k > TRUSTED_K:
            return f"{text}: its tails are not the posterior's, take intervals from the draws"
        return f"{text}: {'close to the posterior' if self.share > 0.5 else 'usable when its draws are weighted'}"


def estimate_evidence(
    parameters: Parameters, proposal: Density, on_drawn: np.ndarray, theta: np.ndarray, log_posterior: np.ndarray
) -> Evidence:
    """From a converged chain theta (n_step, n_walker, n_param) with its log_posterior (n_step, n_walker), and draws of
    the proposal that were not fitted to, with on_drawn (n,) ln of posterior over proposal (`WeightedDraws.log_weight`).

    Raises ConvergenceError where the bridge does not settle: proposal and chain share no region.
    """
    from probupdate.updating.posterior_file import effective_size

    thin = max(1, int(np.ceil(log_posterior.size / N_CHAIN)))
    kept, value = theta[::thin], log_posterior[::thin]
    constant, unknown = log_prior_constant(parameters)
    on_chain = value + constant - proposal.log_density(kept.reshape(-1, kept.shape[2])).reshape(value.shape)
    n_proposed = on_drawn.size
    _, (size,) = effective_size(on_chain[:, :, None])
    share = size / (size + n_proposed)
    found = _bridge(on_chain.ravel(), on_drawn, share)
    # both ratios over the bridge's denominator, at the draws of the other
    joint = np.logaddexp(np.log(share) + on_drawn - found, np.log(1 - share))
    first = np.exp(on_drawn - found - joint)
    second = np.exp(-np.logaddexp(np.log(share) + on_chain - found, np.log(1 - share)))
    _, (independent,) = effective_size(second[:, :, None])
    variance = first.var() / first.mean() ** 2 / n_proposed + second.var() / second.mean() ** 2 / independent
    importance, importance_std = _importance(on_drawn)
    return Evidence(
        log_evidence=float(found), std=float(np.hypot(np.sqrt(variance), unknown)), importance=importance,
        importance_std=float(np.hypot(importance_std, unknown)),
        pareto_k=pareto_shape(on_drawn[np.isfinite(on_drawn)]), n_proposed=n_proposed,
    )


def check_laplace(
    problem: Problem, laplace: Laplace, rng: np.random.Generator, progress: Progress = silent
) -> LaplaceCheck:
    """N_LAPLACE evaluations of the problem's model."""
    approximation = from_laplace(laplace, problem.parameters)
    drawn = approximation.draw(N_LAPLACE, rng)
    weight = _evaluate(problem, drawn, "check of the Laplace approximation",
                       progress) - approximation.log_density(drawn)
    relative = np.exp(weight - weight.max())
    share = float(relative.sum() ** 2 / np.sum(relative**2) / len(weight))
    # the Gaussian's own integral within the bounds: density at the top over the Gaussian approximation's there
    top = laplace.theta[None]
    log_evidence = laplace.log_posterior - float(approximation.log_density(top)[0])
    log_evidence += log_prior_constant(problem.parameters)[0]
    log_evidence += 0.0 if problem.images is None else problem.images.log_number
    return LaplaceCheck(pareto_k=pareto_shape(weight), share=share, log_evidence=log_evidence)


def _evaluate(problem: Problem, theta: np.ndarray, what: str, progress: Progress) -> np.ndarray:
    parts = []
    for start in range(0, len(theta), CHUNK):
        progress(what, start, len(theta))
        parts.append(problem.log_posterior(theta[start : start + CHUNK])[0])
    progress(what, len(theta), len(theta))
    return np.concatenate(parts)


def _bridge(on_chain: np.ndarray, on_drawn: np.ndarray, share: float) -> float:
    """ln Z with the optimal bridge: a fixed point, iterated from the importance estimate."""
    log_z = _importance(on_drawn)[0]
    low, high = np.log(1 - share), np.log(share)
    for _ in range(1000):
        above = special.logsumexp(on_drawn - np.logaddexp(high + on_drawn, low + log_z)) - np.log(on_drawn.size)
        below = special.logsumexp(-np.logaddexp(high + on_chain, low + log_z)) - np.log(on_chain.size)
        fresh = above - below
        if abs(fresh - log_z) < 1e-10 * max(1.0, abs(fresh)):
            return float(fresh)
        log_z = fresh
    raise ConvergenceError("bridge sampling of the evidence did not converge", log_z)


def _importance(log_weight: np.ndarray) -> tuple[float, float]:
    """ln of the weights' mean, and its standard deviation (of the logarithm, to first order)."""
    mean = special.logsumexp(log_weight) - np.log(log_weight.size)
    relative = np.exp(log_weight - mean)
    return float(mean), float(np.std(relative) / np.sqrt(log_weight.size))


def pareto_shape(log_weight: np.ndarray) -> float:
    """k of the generalised Pareto distribution of the largest weights, min(20 %, 3 sqrt(n)) of them: the estimator of
    Zhang & Stephens (2009), drawn to 0.5 as if by ten more weights (Vehtari, Simpson, Gelman, Yao & Gabry 2024).
    Infinite, which nobody trusts, where fewer than five would count."""
    n = log_weight.size
    n_tail = int(np.ceil(min(0.2 * n, 3 * np.sqrt(n))))
    if n_tail < 5:
        return np.inf
    ordered = np.sort(log_weight - log_weight.max())
    threshold = np.exp(ordered[-n_tail - 1])
    tail = np.exp(ordered[-n_tail:]) - threshold
    if tail[-1] <= 0 or tail[0] == tail[-1]:
        return 0.0
    n_grid = 30 + int(np.sqrt(n_tail))
    quarter = tail[int(n_tail / 4 + 0.5) - 1]
    b = 1 - np.sqrt(n_grid / (np.arange(1, n_grid + 1) - 0.5))
    b = b / (3 * max(quarter, np.finfo(float).tiny)) + 1 / tail[-1]
    k = np.mean(np.log1p(-b[:, None] * tail), axis=1)
    length = n_tail * (np.log(-b / k) - k - 1)
    weight = 1 / np.sum(np.exp(length - length[:, None]), axis=1)
    kept = weight >= 10 * np.finfo(float).eps
    b = np.sum(b[kept] * weight[kept]) / np.sum(weight[kept])
    k = np.mean(np.log1p(-b * tail))
    return float((n_tail * k + 10 * 0.5) / (n_tail + 10))


def log_prior_constant(parameters: Parameters) -> tuple[float, float]:
    """What ln p(theta) of a correlated prior lacks to be normalised within the bounds, and its standard deviation; 0 of
    independent ones."""
    if parameters.normalised or parameters.correlation is None:
        return 0.0, 0.0
    mass, std = parameters.log_mass
    gaussian = [p.prior != "uniform" for p in parameters]
    constant = -0.5 * sum(gaussian) * np.log(2 * np.pi) - 0.5 * np.linalg.slogdet(parameters.correlation)[1] - mass
    constant -= sum(np.log(p.std) for p in parameters if p.prior == "normal")
    constant -= sum(np.log(p.upper - p.lower) for p in parameters if p.prior == "uniform")
    return float(constant), std
