"""Parameters that vary from set to set: their mean and their scatter, separated from the noise of each set.

theta_j of set j is drawn from a population of mean mu and covariance D R D, D = diag(tau); its data see theta_j only
(Behmanesh et al. 2015). Each set's likelihood enters to second order about where the population puts it, so that
theta_j is integrated out in closed form; the error of that is measured on the full model. A parameter that is positive
by its bounds varies by its logarithm (tau is then a CoV), others as they are.

Hyper-priors: mu has the parameters' own prior; tau_k is half-normal with standard deviation `spread` times the prior's;
R, where asked for, is LKJ with eta = 2 (Lewandowski, Kurowicka & Joe 2009). An error of the model that all sets share
moves mu, not tau; one that the sets' weights already count as noise lowers tau.
"""

from __future__ import annotations

from dataclasses import dataclass

import emcee
import numpy as np
from scipy import optimize, special

from probupdate.errors import InputError
from probupdate.model.parameters import Parameters
from probupdate.runtime.arrays import frozen_array
from probupdate.runtime.progress import Progress, silent
from probupdate.updating.ensemble import SubsetMove
from probupdate.updating.importance import StudentT
from probupdate.updating.posterior_file import effective_size
from probupdate.updating.set_likelihoods import Coordinates, SetLikelihoods
from probupdate.updating.settings import CONSTANTS
from probupdate.updating.weight_smoothing import smoothed_weights

SPREAD = CONSTANTS.population_spread
LKJ_ETA = CONSTANTS.lkj_eta
SEGMENT, MAX_STEPS, BURN_IN = 400, 12_000, 0.2
R_HAT_LIMIT = CONSTANTS.population_r_hat_limit
# share of moves that redraw one or two scales and with them the mean, and of those of a few numbers along differences
REDRAW_SHARE, SUBSET_SHARE = 0.5, 0.3
# the Gaussian that stands for the prior in proposals of the mean is so many times as wide in variance
PROPOSAL_VARIANCE = 1.3
N_PRIOR = 20_000
# independent draws at first, in parts, twice as many after each fit; as they are kept; step of differences and range
# of w
AT_ONCE, PART, FITS, N_KEPT, DIFFERENCE, W_RANGE = 4000, 500, 4, 8000, 1e-3, (-5.0, 6.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class Population:
    """Draws of the population: mean (n, n_param) in u, tau (n, n_param), factor (n, n_param, n_param) with covariance
    factor factor^T; log_likelihood (n, n_set) of each set, its own parameters integrated out."""

    mean: np.ndarray
    tau: np.ndarray
    factor: np.ndarray
    log_likelihood: np.ndarray
    r_hat: float
    ess: float
    converged: bool
    verdict: str

    def draw_new(self, rng: np.random.Generator) -> np.ndarray:
        """u of a set not yet measured (n, n_param), one for each draw."""
        return self.mean + (self.factor @ rng.standard_normal(self.mean.shape)[..., None])[..., 0]


def half_normal(w: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """tau that is half-normal of that scale where w is standard normal, by the distribution function: 2 Phi(tau /
    scale) - 1 = Phi(w)."""
    tau = -scale * special.ndtri(0.5 * special.ndtr(-w))
    return np.where(w > -6, tau, scale * np.sqrt(np.pi / 2) * special.ndtr(w))


def scatter_interval(tau: np.ndarray) -> tuple[float, float]:
    """90 % interval of draws (n,) of a scatter: 5 to 95 %, from zero on where that is no longer, as there the density
    is largest; an interval of two tails never holds a scatter of zero."""
    low, most, high = np.quantile(tau, [0.05, 0.9, 0.95])
    return (0.0 if most <= high - low else float(low)), float(high)


class _Hyper:
    """The density of x = (mean of u, w of tau, w of R); every w is standard normal by its hyper-prior."""

    def __init__(
        self, likelihoods: SetLikelihoods, parameters: Parameters, coordinates: Coordinates, correlated, spread
    ):
        self.likelihoods, self.parameters, self.coordinates = likelihoods, parameters, coordinates
        self.n, self.correlated = len(parameters), correlated
        self.n_x = 2 * self.n + (self.n * (self.n - 1) // 2 if correlated else 0)
        self.spread = spread * coordinates.scale
        drawn = coordinates.transform(parameters.draw(np.random.default_rng(0), N_PRIOR))
        self.prior_mean = drawn.mean(axis=0)
        self.prior_precision = np.linalg.inv(np.atleast_2d(np.cov(drawn.T)) * PROPOSAL_VARIANCE)

    def scales(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """tau (n, n_param) and the factor of the covariance."""
        tau = half_normal(x[:, self.n : 2 * self.n], self.spread)
        root = lkj_factor(x[:, 2 * self.n :], self.n) if self.correlated else np.eye(self.n)
        return tau, tau[:, :, None] * root

    def __call__(self, x: np.ndarray) -> np.ndarray:
        mean = x[:, : self.n]
        theta = self.coordinates.back(mean)
        value = self.parameters.log_density(theta)
        inside = np.isfinite(value)
        value = value + np.log(self.coordinates.rate(theta)).sum(axis=1) - 0.5 * np.sum(x[:, self.n :] ** 2, axis=1)
        if inside.any():
            value[inside] += self.likelihoods.marginal(mean[inside], self.scales(x[inside])[1]).sum(axis=1)
        return np.where(inside, value, -np.inf)

    def of_scales(self, w: np.ndarray) -> np.ndarray:
        """ln of the density of w (n, n_w), the mean integrated out with a Gaussian for its prior, up to a constant."""
        x = np.hstack([np.zeros((len(w), self.n)), w])
        middle, root = self.conditional(x)
        off = middle - self.prior_mean
        value = self.likelihoods.marginal(middle, self.scales(x)[1]).sum(axis=1) - 0.5 * np.sum(w**2, axis=1)
        return value - 0.5 * np.sum(off @ self.prior_precision * off, axis=1) - np.log(
            np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)

    def conditional(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean (n, n_param) and lower factor of the precision of mu given tau, R, with a Gaussian for its prior."""
        like, (_, factor) = self.likelihoods, self.scales(x)
        slope, root = like._inner(np.broadcast_to(like.centre[:1], (len(x), self.n)), factor)
        # d of the marginal at the first centre; its curvature is H - H C M^-1 C^T H
        half = np.linalg.solve(root, np.swapaxes(factor, 1, 2)[:, None] @ like.precision)
        curvature = like.precision - np.swapaxes(half, 2, 3) @ half
        at = like.gradient - np.einsum("jk,jkl->jl", like.centre[:1] - like.centre, like.precision)
        gradient = at - (np.swapaxes(half, 2, 3) @ np.linalg.solve(root, slope[..., None]))[..., 0]
        precision = curvature.sum(axis=1) + self.prior_precision
        right = gradient.sum(axis=1) + self.prior_precision @ (self.prior_mean - like.centre[0])
        middle = like.centre[0] + np.linalg.solve(precision, right[..., None])[..., 0]
        return middle, np.linalg.cholesky(precision)


def lkj_factor(w: np.ndarray, n: int) -> np.ndarray:
    """Lower Cholesky factors (m, n, n) of correlation matrices from standard normals w (m, n (n - 1) / 2): partial
    correlations are beta distributed, and the matrices follow LKJ (vine method of Lewandowski, Kurowicka & Joe)."""
    factor, k = np.zeros((len(w), n, n)), 0
    factor[:, 0, 0] = 1.0
    left = np.ones((len(w), n))
    for i in range(n - 1):
        a = LKJ_ETA + 0.5 * (n - 2 - i)
        for j in range(i + 1, n):
            partial = 2 * special.betaincinv(a, a, special.ndtr(w[:, k])) - 1
            factor[:, j, i] = partial * np.sqrt(left[:, j])
            left[:, j] = left[:, j] * (1 - partial**2)
            k += 1
        factor[:, i + 1, i + 1] = np.sqrt(left[:, i + 1])
    return factor


class _Redraw(emcee.moves.RedBlueMove):
    """One or two w of each walker from their hyper-prior, then the mean from its conditional given the new scales."""

    def __init__(self, hyper: _Hyper):
        super().__init__()
        self._hyper = hyper

    def get_proposal(self, sample, complement, random):
        hyper, n = self._hyper, self._hyper.n
        w = sample[:, n:]
        order = np.argsort(random.uniform(size=w.shape), axis=1)
        fresh = np.where(order < random.randint(0, 3, size=(len(w), 1)), random.standard_normal(w.shape), w)
        fresh = np.concatenate([sample[:, :n], fresh], axis=1)
        middle, root = hyper.conditional(np.concatenate([sample, fresh]))
        m = len(sample)
        z = random.standard_normal((m, n))
        fresh[:, :n] = middle[m:] + np.linalg.solve(np.swapaxes(root[m:], 1, 2), z[..., None])[..., 0]
        before = (np.swapaxes(root[:m], 1, 2) @ (sample[:, :n] - middle[:m])[..., None])[..., 0]
        log_det = np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
        factors = log_det[:m] - 0.5 * np.sum(before**2, axis=1) - log_det[m:] + 0.5 * np.sum(z**2, axis=1)
        factors += 0.5 * np.sum(fresh[:, n:] ** 2, axis=1) - 0.5 * np.sum(w**2, axis=1)
        return fresh, factors


@dataclass(frozen=True, eq=False)
class _Independent:
    """Independent draws of x: scales from a Student t, the mean from its conditional given them."""

    hyper: _Hyper
    about: StudentT

    @classmethod
    def from_hyperparameters(cls, hyper: _Hyper) -> _Independent:
        """About the largest density of the scales, the mean integrated out with a Gaussian for its prior."""
        n_w = hyper.n_x - hyper.n
        steps = np.vstack([np.zeros(n_w), DIFFERENCE * np.eye(n_w), -DIFFERENCE * np.eye(n_w)])

        def descent(w: np.ndarray) -> tuple[float, np.ndarray]:
            value = -hyper.of_scales(w + steps)
            return float(value[0]), (value[1 : n_w + 1] - value[n_w + 1 :]) / (2 * DIFFERENCE)

        top = optimize.minimize(descent, np.zeros(n_w), jac=True, method="L-BFGS-B", bounds=[W_RANGE] * n_w).x
        slope = np.array([descent(top + step)[1] for step in DIFFERENCE * np.vstack([np.eye(n_w), -np.eye(n_w)])])
        value, vectors = np.linalg.eigh((slope[:n_w] - slope[n_w:]) / (2 * DIFFERENCE))
        # no wider than twice the hyper-prior
        return cls(hyper, _student_about(top, (vectors / np.maximum(value, 0.5)) @ vectors.T))

    def draw(self, n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """x (n, n_x) and ln of what they weigh (n,)."""
        size = self.hyper.n
        w = self.about.draw(n, rng)
        x = np.hstack([np.zeros((n, size)), w])
        middle, root = self.hyper.conditional(x)
        z = rng.standard_normal(middle.shape)
        x[:, :size] = middle + np.linalg.solve(np.swapaxes(root, 1, 2), z[..., None])[..., 0]
        log_det = np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
        return x, self.hyper(x) - (self.about.of_coordinates(w) + log_det - 0.5 * np.sum(z**2, axis=1))

    def fit(self, x: np.ndarray, weight: np.ndarray) -> _Independent:
        w = x[:, self.hyper.n :]
        middle = weight @ w
        return _Independent(self.hyper, _student_about(middle, (w - middle).T @ (weight[:, None] * (w - middle))))


def _student_about(centre: np.ndarray, covariance: np.ndarray) -> StudentT:
    return StudentT(centre=centre, factor=np.linalg.cholesky(PROPOSAL_VARIANCE * covariance),
                    logarithmic=np.zeros(len(centre), bool))


def _independent_draws(
    hyper: _Hyper, target_ess: int, rng: np.random.Generator, progress: Progress
) -> tuple[np.ndarray, float, float, str] | None:
    """As `_chain`, each draw as often as its weight, R-hat one; None where the weights say that they are not the
    population's."""
    source, number = _Independent.from_hyperparameters(hyper), AT_ONCE
    for fit in range(FITS):
        progress("population", fit, FITS)
        parts = [source.draw(PART, rng) for _ in range(number // PART)]
        x, log_weight = (np.concatenate([part[k] for part in parts]) for k in range(2))
        inside = np.isfinite(log_weight)
        if inside.sum() < hyper.n_x * 10:
            return None
        x = x[inside]
        smooth, k = smoothed_weights(log_weight[inside])
        weight = np.exp(smooth)
        ess = float(1 / np.sum(weight**2))
        if k <= CONSTANTS.trusted_k and ess >= target_ess:
            at = (np.arange(N_KEPT) + rng.uniform()) / N_KEPT
            taken = np.minimum(np.searchsorted(np.cumsum(weight), at), len(x) - 1)
            words = f"{number} independent draws, {ess:.0f} effective, Pareto k {k:.2f}"
            return x[rng.permutation(taken)], 1.0, ess, words
        if ess < 2 * hyper.n_x:
            return None
        source, number = source.fit(x, weight), 2 * number
    return None


def sample_population(
    likelihoods: SetLikelihoods, parameters: Parameters, coordinates: Coordinates, *, seed: int,
    correlated: bool = False, spread: float | np.ndarray = SPREAD, target_ess: int = 500,
    r_hat_limit: float = R_HAT_LIMIT, progress: Progress = silent,
) -> Population:
    """Mean, scales and, where asked for, correlation by weighed independent draws; by emcee where these do not
    represent them. That stops at the wanted bulk effective size of the worst number with R-hat below its limit, or says
    that it did not get there. spread: one, or one a parameter, zero of what is one number in all sets."""
    if len(likelihoods.ids) < 2:
        raise InputError("sets", "fewer than two do not show any scatter between sets", "give two or more")
    hyper = _Hyper(likelihoods, parameters, coordinates, correlated, spread)
    found = _independent_draws(hyper, target_ess, np.random.default_rng([seed, 10]), progress)
    flat, r_hat, ess, words = found or _chain(hyper, seed, target_ess, r_hat_limit, progress)
    converged = r_hat < r_hat_limit and ess >= target_ess
    tau, factor = hyper.scales(flat)
    return Population(
        mean=frozen_array(flat[:, : hyper.n]), tau=frozen_array(tau), factor=frozen_array(factor),
        log_likelihood=frozen_array(likelihoods.marginal(flat[:, : hyper.n], factor)), r_hat=r_hat, ess=ess,
        converged=converged, verdict=f"converged: {words}" if converged else
        f"NOT converged after {words}: its means and scatter are provisional; hold parameters that the sets hardly "
        "identify (a smaller cov in their table) or give more sets",
    )


def _chain(
    hyper: _Hyper, seed: int, target_ess: int, r_hat_limit: float, progress: Progress
) -> tuple[np.ndarray, float, float, str]:
    """x (n, n_x) by emcee, R-hat, effective size, and both in words."""
    rng = np.random.default_rng([seed, 11])
    start = _start(hyper, 2 * hyper.n_x + 2, rng)
    moves = [(_Redraw(hyper), REDRAW_SHARE), (SubsetMove(), SUBSET_SHARE),
             (emcee.moves.DEMove(), 0.8 * (1 - REDRAW_SHARE - SUBSET_SHARE)),
             (emcee.moves.DEMove(gamma0=1.0), 0.2 * (1 - REDRAW_SHARE - SUBSET_SHARE))]
    sampler = emcee.EnsembleSampler(*start.shape, hyper, vectorize=True, moves=moves)
    random = np.random.RandomState(np.random.default_rng([seed, 12]).integers(2**32, size=8))
    state, judged = emcee.State(start, random_state=random.get_state()), (np.inf, 0.0)
    kept = np.empty((0, *start.shape))
    while sampler.iteration < MAX_STEPS and not (judged[0] < r_hat_limit and judged[1] >= target_ess):
        progress("population", sampler.iteration, MAX_STEPS)
        # looked at ever more rarely: judging a chain takes as long as many of its steps
        n_more = min(max(SEGMENT, sampler.iteration // 3), MAX_STEPS - sampler.iteration)
        state = sampler.run_mcmc(state, n_more, skip_initial_state_check=True)
        kept = sampler.get_chain(discard=int(BURN_IN * sampler.iteration))
        r_hat, ess = effective_size(kept)
        judged = float(np.max(r_hat)), float(np.min(ess))
    progress("population", MAX_STEPS, MAX_STEPS)
    words = f"{sampler.iteration} steps, R-hat {judged[0]:.4f}, effective size {judged[1]:.0f} of the worst number"
    flat = kept.reshape(-1, hyper.n_x)
    return flat[:: max(1, int(np.ceil(len(flat) / N_KEPT)))], *judged, words


def _start(hyper: _Hyper, n_walker: int, rng: np.random.Generator) -> np.ndarray:
    """Scales from their hyper-prior, means from their conditional, held within the bounds."""
    x = 0.5 * rng.standard_normal((n_walker, hyper.n_x))
    x[:, : hyper.n] = 0.0
    middle, root = hyper.conditional(x)
    u = middle + np.linalg.solve(np.swapaxes(root, 1, 2), rng.standard_normal(middle.shape)[..., None])[..., 0]
    theta, parameters = hyper.coordinates.back(u), hyper.parameters
    # a little inside, and not all at one place
    width = np.minimum(parameters.std, parameters.upper - parameters.lower)
    low = parameters.lower + width * rng.uniform(0.001, 0.05, theta.shape)
    high = parameters.upper - width * rng.uniform(0.001, 0.05, theta.shape)
    x[:, : hyper.n] = hyper.coordinates.transform(np.clip(theta, low, high))
    return x
