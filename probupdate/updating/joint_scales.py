"""How much the varying parameters scatter and what the turbines' common error amounts to: maximum, and emcee.

Everything else of a `FarmSystem` is integrated out in closed form, so that the chain walks over ln tau and the scales
alone; common parameters, means and turbines' values follow from each of its draws exactly. Independent draws about the
maximum are weighed first; emcee walks only where they do not represent the density.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import emcee
import numpy as np
from scipy import optimize

from probupdate.runtime.arrays import frozen_array
from probupdate.runtime.progress import Progress, silent
from probupdate.updating.hierarchical import half_normal
from probupdate.updating.importance import StudentT
from probupdate.updating.joint_system import FarmSystem
from probupdate.updating.posterior_file import effective_size
from probupdate.updating.scales import log_half_cauchy
from probupdate.updating.settings import CONSTANTS
from probupdate.updating.weight_smoothing import smoothed_weights

# of w, standard normal a priori, and of ln of a scale over its hyper-prior's
W_RANGE, LN_RANGE = (-5.0, 6.0), (-6.0, 4.0)
N_WALKER, SEGMENT, MAX_STEPS, TARGET_ESS, BURN_IN = 32, 120, 3000, 400, 0.25
# independent draws at a time, at most, as they are kept; from which number on, and how many effective a dimension,
# their own spread is taken
AT_ONCE, MOST_DRAWS, RESAMPLED = 200, 6000, 2000
REFITTED_FROM, FITS = 800, 10
# how much wider in variance proposals are
WIDER = 1.3
# step of central differences of w and of ln of a scale
STEP = 0.05


@dataclass(frozen=True, eq=False, kw_only=True)
class Scales:
    """x = (w of tau, ln of the learnt scales of the common error over their hyper-prior's): spread (n_varying,) of the
    half-normal hyper-prior of tau; hyper (3,), of frequencies, components of shapes and mixing; learnt: whether these
    are unknown."""

    spread: np.ndarray
    hyper: np.ndarray
    learnt: bool

    def present(self, system: FarmSystem) -> np.ndarray:
        """Which of the three scales are unknown and count."""
        return np.flatnonzero(np.array([self.learnt and bool(np.any(system.kind == k)) for k in (1, 2, 3)]))

    def n_x(self, system: FarmSystem) -> int:
        return len(self.spread) + len(self.present(system))

    def tau(self, x: np.ndarray) -> np.ndarray:
        return half_normal(x[..., : len(self.spread)], self.spread)

    def shared(self, x: np.ndarray, system: FarmSystem) -> np.ndarray:
        """(..., 3) of x (..., n_x)."""
        found = np.tile(np.array(self.hyper, float), (*x.shape[:-1], 1)).reshape(*x.shape[:-1], 3)
        found[..., self.present(system)] *= np.exp(x[..., len(self.spread) :])
        return found

    def bounds(self, n_x: int) -> np.ndarray:
        """(n_x, 2)."""
        n = len(self.spread)
        return np.array([W_RANGE] * n + [LN_RANGE] * (n_x - n)).reshape(-1, 2)

    def log_prior(self, x: np.ndarray, system: FarmSystem) -> np.ndarray:
        """Of x (..., n_x)."""
        present = self.present(system)
        scales = log_half_cauchy(self.shared(x, system)[..., present], self.hyper[present])
        return np.sum(scales, axis=-1) - 0.5 * np.sum(x[..., : len(self.spread)] ** 2, axis=-1)

    def log_posterior(self, x: np.ndarray, system: FarmSystem) -> np.ndarray:
        """(n,) of x (n, n_x)."""
        low, high = self.bounds(x.shape[1]).T
        held = np.clip(x, low, high)
        value = self.log_prior(held, system) + system.log_density(
            self.tau(held), system.common_std(self.shared(held, system)))
        return np.where(np.all(held == x, axis=1), value, -np.inf)

    def maximum(self, system: FarmSystem, start: np.ndarray | None = None) -> np.ndarray:
        """x (n_x,) of the largest density."""
        n = self.n_x(system)
        begin = np.zeros(n) if start is None or len(start) != n else start
        if not n:
            return begin
        # differences stay inside the bounds
        inside = self.bounds(n) + np.array([0.01, -0.01])
        steps = np.vstack([np.zeros(n), 1e-4 * np.eye(n), -1e-4 * np.eye(n)])

        def descent(x: np.ndarray) -> tuple[float, np.ndarray]:
            value = -self.log_posterior(x + steps, system)
            return float(value[0]), (value[1 : n + 1] - value[n + 1 :]) / 2e-4

        return optimize.minimize(descent, begin, jac=True, method="L-BFGS-B", bounds=inside, options={"ftol": 1e-10}).x

    def curvature(self, x: np.ndarray, system: FarmSystem) -> np.ndarray:
        """Covariance (n_x, n_x) of the Gaussian at x, by differences; no wider than twice the hyper-prior."""
        n = len(x)
        i, j = (index.ravel() for index in np.indices((n, n)))
        steps, (low, high) = STEP * np.eye(n), self.bounds(n).T
        x = np.clip(x, low + 2 * STEP, high - 2 * STEP)
        corners = [self.log_posterior(x + a * steps[i] + b * steps[j], system) for a, b in
                   ((1, 1), (1, -1), (-1, 1), (-1, -1))]
        H = -(corners[0] - corners[1] - corners[2] + corners[3]).reshape(n, n) / (4 * STEP**2)
        value, vectors = np.linalg.eigh(H)
        return (vectors / np.maximum(value, 0.5)) @ vectors.T


@dataclass(frozen=True, eq=False, kw_only=True)
class ScaleChain:
    """Equally likely draws x (n, n_x), effectively `ess` of them, with what is said of their convergence."""

    x: np.ndarray
    ess: float
    converged: bool
    verdict: str

    def thin(self, n: int) -> np.ndarray:
        """n of its draws (n, n_x)."""
        return self.x[np.linspace(0, len(self.x) - 1, n).astype(int)]


def student_about(scales: Scales, system: FarmSystem, maximum: np.ndarray) -> StudentT:
    """A Student t distribution about the maximum (n_scale,), wider than the density there."""
    root = np.linalg.cholesky(WIDER * scales.curvature(maximum, system))
    return StudentT(centre=maximum, factor=root, logarithmic=np.zeros(len(maximum), bool))


class _Redraw(emcee.moves.RedBlueMove):
    """Each walker drawn again, independently of where it was."""

    def __init__(self, about: StudentT):
        super().__init__()
        self._about = about

    def get_proposal(self, sample, complement, random):
        fresh = self._about.draw(len(sample), random)
        return fresh, self._about.of_coordinates(sample) - self._about.of_coordinates(fresh)


def sample_scales(
    scales: Scales, system: FarmSystem, maximum: np.ndarray, *, seed: int, progress: Progress = silent
) -> ScaleChain:
    """Weighed independent draws about the maximum (n_scale,); emcee from there where these do not represent the
    density."""
    n = len(maximum)
    if not n:
        return ScaleChain(x=np.zeros((1, 0)), ess=float(TARGET_ESS), converged=True, verdict="no scale is unknown")
    rng = np.random.default_rng([seed, 31])
    about = student_about(scales, system, maximum)
    return independent_draws(scales, system, about, rng, progress) or sample_scale_chain(scales, system, about, rng,
                                                                                         progress)


def independent_draws(scales: Scales, system: FarmSystem, about: StudentT, rng: np.random.Generator,
                      progress: Progress = silent) -> ScaleChain | None:
    """Draws of a Student t distribution taken by their weights (importance sampling, resampled), after a second one was
    fitted to the first's weighed draws; None where Pareto k or their effective number say that they are not those of
    the density."""
    x, log_weight, fitted = np.zeros((0, len(about.centre))), np.zeros(0), False
    for done in range(0, MOST_DRAWS, AT_ONCE):
        progress("scatter between turbines", done, MOST_DRAWS)
        fresh = about.draw(AT_ONCE, rng)
        x = np.vstack([x, fresh])
        log_weight = np.append(log_weight, scales.log_posterior(fresh, system) - about.of_coordinates(fresh))
        inside = np.flatnonzero(np.isfinite(log_weight))
        if len(inside) < AT_ONCE // 2:
            continue
        smooth, k = smoothed_weights(log_weight[inside])
        ess = float(1 / np.sum(np.exp(2 * smooth)))
        if k <= CONSTANTS.trusted_k and ess >= TARGET_ESS:
            progress("scatter between turbines", MOST_DRAWS, MOST_DRAWS)
            # each as often as its weight, in drawn order
            at = (np.arange(RESAMPLED) + rng.uniform()) / RESAMPLED
            taken = np.minimum(np.searchsorted(np.cumsum(np.exp(smooth)), at), len(inside) - 1)
            return ScaleChain(x=frozen_array(x[inside][rng.permutation(taken)]), ess=ess, converged=True,
                              verdict=f"converged: {len(x)} independent draws, {ess:.0f} effective, Pareto k {k:.2f}")
        if not fitted and len(x) >= REFITTED_FROM and ess > FITS * len(about.centre):
            weight = np.exp(smooth)
            centre = weight @ x[inside]
            spread = (x[inside] - centre).T @ (weight[:, None] * (x[inside] - centre))
            about = replace(about, centre=centre, factor=np.linalg.cholesky(WIDER * spread))
            x, log_weight, fitted = x[:0], log_weight[:0], True
    return None


def sample_scale_chain(scales: Scales, system: FarmSystem, about: StudentT, rng: np.random.Generator,
                       progress: Progress = silent) -> ScaleChain:
    """emcee."""
    n = len(about.centre)
    low, high = scales.bounds(n).T
    start = np.clip(about.draw(max(N_WALKER, 2 * n + 2), rng), low + 0.1, high - 0.1)
    moves = [(_Redraw(about), 0.6), (emcee.moves.DEMove(), 0.3), (emcee.moves.StretchMove(), 0.1)]
    sampler = emcee.EnsembleSampler(*start.shape, lambda x: scales.log_posterior(x, system), moves=moves,
                                    vectorize=True)
    state = emcee.State(start, random_state=np.random.RandomState(rng.integers(2**32, size=8)).get_state())
    judged, kept = (np.inf, 0.0), start[None]
    while sampler.iteration < MAX_STEPS and not (
            judged[0] < CONSTANTS.population_r_hat_limit and judged[1] >= TARGET_ESS):
        progress("scatter between turbines", sampler.iteration, MAX_STEPS)
        more = max(SEGMENT, sampler.iteration // 3)
        state = sampler.run_mcmc(state, more, skip_initial_state_check=True)
        kept = sampler.get_chain(discard=int(BURN_IN * sampler.iteration))
        judged = tuple(float(f(v)) for f, v in zip((np.max, np.min), effective_size(kept), strict=True))
    progress("scatter between turbines", MAX_STEPS, MAX_STEPS)
    words = f"{sampler.iteration} steps, R-hat {judged[0]:.3f}, effective size {judged[1]:.0f}"
    settled = judged[0] < CONSTANTS.population_r_hat_limit and judged[1] >= TARGET_ESS
    return ScaleChain(x=frozen_array(kept.reshape(-1, n)), ess=judged[1], converged=settled,
                      verdict=f"{'converged' if settled else 'NOT converged'}: {words}")
