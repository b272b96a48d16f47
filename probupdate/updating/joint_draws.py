"""Draws of a farm's joint posterior: of the linear-Gaussian system exactly, then weighed by the true priors and, where
the turbines' problems are given, by the true model once a turbine and draw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import special

from probupdate.model.interface import ManySolutions
from probupdate.model.parameters import Parameters
from probupdate.runtime.arrays import frozen_array
from probupdate.runtime.executors import Executor, completed
from probupdate.runtime.progress import Progress, silent
from probupdate.structure.affine import AffineModel
from probupdate.structure.reduced import reduce_basis
from probupdate.updating.joint_scales import ScaleChain, Scales
from probupdate.updating.joint_system import FarmSystem, Roles
from probupdate.updating.predictive import smoothed_weights
from probupdate.updating.problem import Problem
from probupdate.updating.set_likelihoods import Coordinates
from probupdate.updating.settings import CONSTANTS

# draws; candidates of each turbine's own part in every one, of which one is taken by the true prior
N_DRAW, N_CANDIDATE, CHUNK = 400, 16, 50
# a reduced basis answers the draws of a large model from so many questions on, and is made from so many of them
REDUCE_FROM, N_BASIS = 1000, 200


@dataclass(frozen=True, eq=False, kw_only=True)
class JointDraws:
    """z (n, n_z), e (n, n_e), tau (n, n_varying), u (n, n_turbine, n_param), all in u; weight (n,) normalised; pareto_k
    NaN where nothing was to be weighed."""

    z: np.ndarray
    e: np.ndarray
    tau: np.ndarray
    u: np.ndarray
    log_weight: np.ndarray

    def __post_init__(self):
        for name in ("z", "e", "tau", "u", "log_weight"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))

    def weighed(self) -> tuple[np.ndarray, float]:
        """Normalised weights (n,), smoothed, and Pareto k; -inf where all weights are alike."""
        if not np.isfinite(self.log_weight).any():
            return np.full(len(self.z), 1 / len(self.z)), np.inf
        if np.ptp(self.log_weight) < 1e-9:
            return np.full(len(self.z), 1 / len(self.z)), -np.inf
        finite = np.isfinite(self.log_weight)
        smooth, k = smoothed_weights(self.log_weight[finite])
        weight = np.zeros(len(self.z))
        weight[finite] = np.exp(smooth - special.logsumexp(smooth))
        return weight, float(k)


def weighted_quantile(values: np.ndarray, weight: np.ndarray, share: Sequence[float]) -> np.ndarray:
    """(n_share, ...) of values (n, ...) with normalised weights (n,)."""
    order = np.argsort(values, axis=0)
    ranked = np.take_along_axis(values, order, axis=0).reshape(len(values), -1)
    below = np.cumsum(weight[order], axis=0).reshape(len(values), -1)
    middle = below - 0.5 * weight[order].reshape(len(values), -1)
    found = np.array([np.interp(share, middle[:, k], ranked[:, k]) for k in range(ranked.shape[1])])
    return found.T.reshape(len(share), *values.shape[1:])


@dataclass(frozen=True, eq=False, kw_only=True)
class PriorRatio:
    """ln of the true prior over the Gaussian that stands for it in u, mean (n_param,) and covariance."""

    parameters: Parameters
    coordinates: Coordinates
    roles: Roles
    mean: np.ndarray
    covariance: np.ndarray

    def _log_prior(self, u: np.ndarray, numbers: list[int]) -> np.ndarray:
        """Of some of the parameters (...,), -inf outside their bounds; u (..., n)."""
        known = self.parameters.correlation
        some = Parameters(tuple(self.parameters.items[k] for k in numbers),
                          None if known is None else known[np.ix_(numbers, numbers)])
        part = Coordinates(logarithmic=self.coordinates.logarithmic[numbers], scale=self.coordinates.scale[numbers])
        theta = part.back(u)
        root = np.linalg.cholesky(self.covariance[np.ix_(numbers, numbers)])
        off = np.linalg.solve(root, np.moveaxis(u - self.mean[numbers], -1, 0).reshape(len(numbers), -1))
        gaussian = -0.5 * np.sum(off**2, axis=0).reshape(u.shape[:-1]) - np.log(np.diag(root)).sum()
        gaussian -= 0.5 * len(numbers) * np.log(2 * np.pi)
        value = some.log_density(theta)
        inside = np.isfinite(value)
        jacobian = np.log(np.where(inside[..., None], part.rate(theta), 1.0)).sum(axis=-1)
        return np.where(inside, value + jacobian - gaussian, -np.inf)

    def shared(self, z: np.ndarray) -> np.ndarray:
        """Of z in u (..., n_z)."""
        return self._log_prior(z, self.roles.numbers(self.roles.shared))

    def own(self, u: np.ndarray) -> np.ndarray:
        """Of one turbine's own parameters given its shared ones, u (..., n_param)."""
        shared = self.roles.numbers(self.roles.shared)
        whole = self._log_prior(u, list(range(u.shape[-1])))
        with np.errstate(invalid="ignore"):
            return np.where(np.isfinite(whole), whole - self._log_prior(u[..., shared], shared), -np.inf)


def draw_joint(
    system: FarmSystem, scales: Scales, chain: ScaleChain, middle: np.ndarray, *, shared: Sequence[int],
    turn: np.ndarray | None = None, ratio: PriorRatio | None = None, n: int = N_DRAW, seed: int = 1,
) -> JointDraws:
    """n draws of the linear-Gaussian posterior; with `ratio` weighed by the true prior. middle (n_param,): u about
    which the system is; shared: numbers of z's parameters; turn (n_e, n_kept): back to the common unknowns."""
    rng = np.random.default_rng([seed, 37])
    parts = []
    x = chain.evenly(n)
    for some in np.array_split(x, max(1, n // CHUNK)):
        tau, std = scales.tau(some), system.common_std(scales.shared(some, system))
        z, e, d = system.draw(tau, std, rng, 1 if ratio is None else N_CANDIDATE)
        z, u, log_weight = z + middle[list(shared)], middle + d, np.zeros(len(some))
        if ratio is not None:
            own = ratio.own(u)
            log_weight = ratio.shared(z) + np.sum(special.logsumexp(own, axis=0) - np.log(len(own)), axis=1)
            # one of the candidates of each turbine, by its weight
            chosen = np.argmax(np.where(np.isfinite(own), own + rng.gumbel(size=own.shape), -np.inf), axis=0)
            u = np.take_along_axis(u, chosen[None, :, :, None], axis=0)
        parts.append((z, e if turn is None else e @ turn.T, tau, u[0], log_weight))
    z, e, tau, u, log_weight = (np.concatenate([part[k] for part in parts]) for k in range(5))
    return JointDraws(z=z, e=e, tau=tau, u=u, log_weight=log_weight)


class _Once:
    """A model that answers the same parameters once: all sets of a turbine ask for the same."""

    def __init__(self, model):
        self._model, self._known = model, {}

    def __getattr__(self, name: str):
        return getattr(self._model, name)

    def solve_many(self, theta: np.ndarray, n_mode: int) -> ManySolutions:
        key = theta.tobytes(), n_mode
        if key not in self._known:
            self._known = {key: self._model.solve_many(theta, n_mode)}
        return self._known[key]


@dataclass(frozen=True, eq=False, kw_only=True)
class LinearSet:
    """One set of a turbine: its problem with what is new in it alone, residual (n,), slope (n, n_param) in u and effect
    of the common unknowns (n, n_e) at `centre` (n_param,) in u."""

    problem: Problem
    centre: np.ndarray
    residual: np.ndarray
    slope: np.ndarray
    effect: np.ndarray

    def log_ratio(self, problem: Problem, theta: np.ndarray, u: np.ndarray, e: np.ndarray) -> np.ndarray:
        """ln of the true likelihood over the linear one (n,), `problem` answered by a fast model."""
        common = e @ self.effect.T
        linear = self.residual - (u - self.centre) @ self.slope.T - common
        true = self.problem.measured - problem.predict_many(theta).response - common
        return 0.5 * np.sum(self.problem.weighted(linear) ** 2 - self.problem.weighted(true) ** 2, axis=1)


def turbine_log_ratio(
    number: int, sets: Sequence[LinearSet], fast: Mapping[str, Any], coordinates: Coordinates, u: np.ndarray,
    e: np.ndarray,
) -> tuple[int, np.ndarray]:
    """(n,) of draws u (n, n_param), e (n, n_e) of one turbine; one solution a draw and model. fast: models by the
    fingerprint of those that they stand for."""
    theta = coordinates.back(u)
    inside = sets[0].problem.parameters.inside(theta)
    total = np.full(len(u), -np.inf)
    if inside.any():
        models: dict[str, Any] = {key: _Once(model) for key, model in fast.items()}
        total[inside] = 0.0
        for one in sets:
            problem = one.problem.with_model(models[one.problem.model.fingerprint()])
            total[inside] += one.log_ratio(problem, theta[inside], u[inside], e[inside])
    return number, total


def _fast_models(
    turbines: Sequence[Sequence[LinearSet]], theta: np.ndarray, seed: int, progress: Progress
) -> dict[str, Any]:
    """By fingerprint each model of the sets, or where it is large and often asked a reduced basis for the region of the
    draws theta (n, n_turbine, n_param)."""
    asked: dict[str, tuple[Problem, list[int]]] = {}
    for i, sets in enumerate(turbines):
        for key, problem in {one.problem.model.fingerprint(): one.problem for one in sets}.items():
            asked.setdefault(key, (problem, []))[1].append(i)
    found: dict[str, Any] = {}
    for key, (problem, of) in asked.items():
        found[key], points = problem.model, theta[:, of].reshape(-1, theta.shape[2])
        points = points[problem.parameters.inside(points)]
        if isinstance(problem.model, AffineModel) and problem.model.n_dof >= CONSTANTS.reduce_from and (
                len(points) >= REDUCE_FROM):
            chosen = points[np.linspace(0, len(points) - 1, N_BASIS).astype(int)]
            found[key] = reduce_basis(
                problem.model, frequency_tolerance=CONSTANTS.frequency_tolerance, n_mode=problem.matching.n_mode,
                seed=seed, points=chosen, box=(points.min(axis=0), points.max(axis=0)), progress=progress)
    return found


def weigh_by_model(
    draws: JointDraws, turbines: Sequence[Sequence[LinearSet]], coordinates: Coordinates, *, seed: int = 1,
    jobs: int | Executor = 1, progress: Progress = silent,
) -> JointDraws:
    """The same draws with their weights times the true likelihood over the linear one, of all turbines."""
    fast = _fast_models(turbines, coordinates.back(draws.u), seed, progress)
    tasks = [(i, sets, {key: fast[key] for key in {one.problem.model.fingerprint() for one in sets}}, coordinates,
              draws.u[:, i], draws.e) for i, sets in enumerate(turbines)]
    found = {}
    for done, (number, one) in enumerate(completed(turbine_log_ratio, tasks, jobs=jobs, least=1), 1):
        found[number] = one
        progress("true model at the draws", done, len(tasks))
    return replace(draws, log_weight=draws.log_weight + sum(found[number] for number in range(len(tasks))))
