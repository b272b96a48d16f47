"""One inference for the turbines of a design: stacked Tikhonov, then emcee and draws moved to the true models.

Each turbine's responses are linear about its own estimate; the joint estimate is where they are made linear again until
it stays where it is. There the estimate is the minimum of the stacked misfit with pooled weights (the model's error is
one for all) and penalties of the priors and the scatter; the posterior is that of `joint_scales` and
`joint_nonlinear`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, optimize

from probupdate.errors import InputError
from probupdate.model.parameters import Parameters
from probupdate.runtime.arrays import frozen_array
from probupdate.runtime.executors import Executor
from probupdate.runtime.progress import Progress, silent
from probupdate.runtime.settings import refuse_other_types
from probupdate.updating.hierarchical import SPREAD
from probupdate.updating.joint_ascent import ALIKE, ROUNDS, FarmAscent, group_inners
from probupdate.updating.joint_draws import JointDraws, draw_linear
from probupdate.updating.joint_nonlinear import FarmModels, LinearSet, TurbineModel, draw_nonlinear
from probupdate.updating.joint_odd import SHARE, OddTurbines, odd_turbines
from probupdate.updating.joint_prior import NormalScores
from probupdate.updating.joint_scales import LN_RANGE, ScaleChain, Scales, sample_scales
from probupdate.updating.joint_system import FarmSystem, Layout, Roles
from probupdate.updating.problem import Problem
from probupdate.updating.scales import hyper_scales, log_half_cauchy
from probupdate.updating.shared_error import MIXING, Inner, SharedError, shared_error

# scores between which responses are first made linear, as tangents at a bound lead nowhere; an estimate this near to a
# bound, in prior standard deviations, is at it
BEGIN, AT_BOUND = 2.5, 0.05
# sets from which what is new in each is learnt: more do not say more of two numbers
LEARNT_FROM = 18
# steps at most of the search for these
SEARCHES = 15


@dataclass(frozen=True, eq=False, kw_only=True)
class TurbineSets:
    """A turbine's sets of one month as problems of one model, and theta (n_param,) about which its responses are first
    made linear: its own estimate."""

    name: str
    month: str
    problems: tuple[Problem, ...]
    theta: np.ndarray


@dataclass(frozen=True, kw_only=True)
class JointSettings:
    """spread: of the half-normal hyper-prior of tau, in prior standard deviations; odd_share: of turbines that are
    unlike the others a priori, odd_wide: how far, in prior standard deviations."""

    spread: float = SPREAD
    odd_share: float = SHARE
    odd_wide: float = 1.0
    seed: int = 1

    def __post_init__(self):
        refuse_other_types(self)


DEFAULT = JointSettings()


@dataclass(frozen=True, eq=False, kw_only=True)
class JointEstimate:
    """The stacked estimate and what the posterior is sampled from. z (n_z,), u (n_turbine, n_param) as normal scores,
    tau (n_varying,) of them; turn (n_e, n_kept) from the system's common unknowns back to all; `new`: what is new in
    each set."""

    roles: Roles
    scores: NormalScores
    error: SharedError
    set_turbine: np.ndarray
    new: tuple[float, float]
    inners: tuple[Inner, ...]
    system: FarmSystem
    turn: np.ndarray
    scales: Scales
    x: np.ndarray
    z: np.ndarray
    e: np.ndarray
    u: np.ndarray
    odd: OddTurbines
    rounds: int
    settled: bool

    @property
    def parameters(self) -> Parameters:
        return self.scores.parameters

    @property
    def theta(self) -> np.ndarray:
        """(n_turbine, n_param)."""
        return self.scores.back(self.u)

    @property
    def at_bound(self) -> np.ndarray:
        """Where the stacked estimate is at a bound of the prior (n_turbine, n_param)."""
        theta, p = self.theta, self.parameters
        # a lognormal parameter's zero is no bound
        lower = np.where(self.scores.lognormal & (p.lower <= 0), -np.inf, p.lower)
        return np.minimum(theta - lower, p.upper - theta) < AT_BOUND * p.std

    @property
    def tau(self) -> np.ndarray:
        return self.scales.tau(self.x)

    @property
    def common_std(self) -> np.ndarray:
        return self.system.common_std(self.scales.shared(self.x, self.system))

    def of_months(self, months: Sequence[TurbineSets], number: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Scores u and their standard deviations (n_month, n_param) by each month's sets alone, linear about its own
        estimate, where all that turbines share is known; number: of each month's turbine."""
        problems = [*self.error.problems, *(p for month in months for p in month.problems)]
        own = np.concatenate([self.scores.back(self.error.centre),
                              *(np.tile(self.scores.back(np.clip(self.scores.transform(m.theta), -BEGIN, BEGIN)),
                                        (len(m.problems), 1)) for m in months)])
        error = shared_error(problems, own, self.scores)
        # modes and channels that the joint inference does not know follow its own, and pairs that mix follow its pairs
        n_pair, first_pair = np.sum(self.error.kind == MIXING), np.sum(error.kind != MIXING)
        known = np.r_[: len(self.error.kind) - n_pair, first_pair : first_pair + n_pair]
        error = replace(error, effect=tuple(B[:, known] for B in error.effect), kind=self.error.kind,
                        form=self.error.form)
        group = np.concatenate([np.full(len(self.error.problems), len(months)),
                                np.repeat(np.arange(len(months)), [len(m.problems) for m in months])])
        layout = Layout.from_roles(self.roles, self.scores.covariance, error.middle)
        whole = FarmSystem.assemble(group_inners(error, self.new, group)[:-1], layout, self.error.kind, self.error.form)
        system = whole.rotate_errors(self.turn, self.system.kind, self.system.form)
        system = system.with_odd_scale(self.system.wide[list(number)])
        shared = self.roles.numbers(self.roles.shared)
        joint = self.system.conditional(self.tau, self.common_std)
        joint = replace(joint, mean=np.concatenate([self.z - error.middle[shared], self.e]))
        mean, _, _, left = system.of_turbines(self.tau, joint)
        return mean + error.middle, np.sqrt(np.diagonal(left, axis1=1, axis2=2))

    def models(self) -> FarmModels:
        """The turbines' true models beside the linear system."""
        error, sets = self.error, [[] for _ in self.inners]
        for i, problem, centre, r, J, B in zip(self.set_turbine, error.problems, error.centre, error.residual,
                                               error.slope, error.effect, strict=True):
            sets[i].append(LinearSet(problem=problem.noise_alone(self.new), middle=error.middle, slope=J,
                                     residual=r - J @ (error.middle - centre), effect=B @ self.turn))
        n = 1 + len(error.middle)
        full = linalg.block_diag(np.eye(n), self.turn)
        return FarmModels(system=self.system, middle=error.middle,
                          inner=np.array([full.T @ one.products @ full for one in self.inners]),
                          turbines=tuple(TurbineModel(sets=tuple(own), scores=self.scores) for own in sets))


def _new_scales(
    error: SharedError, set_turbine: np.ndarray, roles: Roles, covariance: np.ndarray, tau: np.ndarray
) -> tuple[float, float]:
    """What is new in each set, the most probable beside what is shared, from as many turbines as have enough sets."""
    weights = error.problems[0].weights
    if not weights.scales:
        return weights.part(1 - weights.shared)
    some = np.flatnonzero(set_turbine <= set_turbine[min(LEARNT_FROM, len(set_turbine)) - 1])
    part = replace(error, centre=error.centre[some], **{name: tuple(getattr(error, name)[s] for s in some) for name in
                                                        ("problems", "residual", "slope", "effect")})
    layout, shared = Layout.from_roles(roles, covariance, part.middle), _hyper(error.problems[0])
    hyper = np.concatenate([shared[:2], shared])

    def descent(x: np.ndarray) -> float:
        scales = hyper * np.exp(x)
        inners = group_inners(part, (float(scales[0]), float(scales[1])), set_turbine[some])
        system = FarmSystem.assemble(inners, layout, part.kind, part.form)
        value = system.log_density(tau[None], system.common_std(scales[None, 2:]))[0]
        return -float(value + np.sum(log_half_cauchy(scales, hyper)))

    found = optimize.minimize(descent, np.full(len(hyper), -1.0), method="L-BFGS-B", bounds=[LN_RANGE] * len(hyper),
                              options={"eps": 1e-3, "maxiter": SEARCHES})
    frequency, shape = (hyper * np.exp(found.x))[:2]
    return float(frequency), float(shape)


def estimate_farm(
    turbines: Sequence[TurbineSets], *, common: Sequence[str], varying: Sequence[str],
    settings: JointSettings = DEFAULT, progress: Progress = silent,
) -> JointEstimate:
    """The deterministic estimate: linear again at every round, scales at the maximum of their density, turbines that
    are unlike the others set apart. Raises InputError where turbines have different parameters."""
    first = turbines[0].problems[0].parameters
    for one in turbines:
        for problem in one.problems:
            if tuple(problem.parameters) != tuple(first):
                raise InputError(f"turbine {one.name}", "has other parameters or priors than the first turbine's model",
                                 "give turbines of one joint inference the same parameters")
    roles = Roles(names=first.names, common=tuple(common), varying=tuple(varying))
    scores, problems = NormalScores(parameters=first), [p for t in turbines for p in t.problems]
    hyper, weights = _hyper(problems[0]), problems[0].weights
    scales = Scales(spread=np.full(len(roles.varying), settings.spread), hyper=hyper, learnt=bool(weights.scales))
    new = (float(hyper[0]), float(hyper[1])) if weights.scales else weights.part(1 - weights.shared)
    ascent = FarmAscent(problems=problems, roles=roles, scores=scores, scales=scales, new=new, progress=progress,
                        set_turbine=np.repeat(np.arange(len(turbines)), [len(t.problems) for t in turbines]))
    # far from the estimate the misfit looks like an error of the model: values first, at scales as they are expected
    start = np.clip(scores.transform(np.array([t.theta for t in turbines])), -BEGIN, BEGIN)
    place, _ = ascent.ascend(ascent.start(start), ALIKE)
    ascent.learnt = True
    ascent.new = _new_scales(place.error, ascent.set_turbine, roles, scores.covariance, scales.tau(place.x))
    place, settled = ascent.ascend(ascent.with_error(place.error, place.u, place.z, place.x))
    odd_wide = np.full(len(ascent.shared), settings.odd_wide)
    while True:
        odd = odd_turbines(place.system, scales, odd_wide, share=settings.odd_share, seed=settings.seed)
        before, ascent.wide = ascent.wide, odd.outlier_scale(odd_wide)
        # who is odd is set apart, and all is solved again
        if not settled or np.array_equal(ascent.wide, np.zeros_like(ascent.wide) if before is None else before):
            break
        place, settled = ascent.ascend(ascent.with_error(place.error, place.u, place.z, place.x))
    progress("joint estimate", ROUNDS + 1, ROUNDS + 1)
    x = place.next_x
    reached, z, e = _solve_system(place.system, scales, x)
    return JointEstimate(
        roles=roles, scores=scores, error=place.error, set_turbine=ascent.set_turbine, new=ascent.new,
        inners=place.inners, system=place.system, turn=place.turn, scales=scales, x=x,
        z=z + place.error.middle[ascent.shared], e=e, u=frozen_array(reached + place.error.middle), odd=odd,
        rounds=ascent.rounds, settled=settled)


def _hyper(problem: Problem) -> np.ndarray:
    """Of the common part: hyper-priors' scales where it is learnt, else what is stated of it."""
    weights = problem.weights
    if weights.scales:
        return np.array(hyper_scales(problem))
    return np.array([*(np.sqrt(weights.shared) * x for x in weights.discrepancies), weights.mixing])


def _solve_system(system: FarmSystem, scales: Scales, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    tau = scales.tau(x)
    joint = system.conditional(tau, system.common_std(scales.shared(x, system)))
    return system.means(tau, joint), joint.mean[: system.n_z], joint.mean[system.n_z :]


@dataclass(frozen=True, eq=False, kw_only=True)
class JointPosterior:
    """chain over the scales, draws with what they weigh, effective number of draws, Pareto k."""

    chain: ScaleChain
    draws: JointDraws
    weight: np.ndarray
    effective: float
    pareto_k: float

    @property
    def lost(self) -> float:
        """Share of draws that have no weight."""
        return float(np.mean(~np.isfinite(self.draws.log_weight)))

    @property
    def equal_weights(self) -> np.ndarray:
        """The same weight (n,) of each draw that has any, of all where none has."""
        some = np.isfinite(self.draws.log_weight)
        return np.where(some, 1 / some.sum(), 0.0) if some.any() else np.full(len(some), 1 / len(some))


def sample_farm(
    estimate: JointEstimate, *, seed: int = 1, jobs: int | Executor = 1, progress: Progress = silent
) -> JointPosterior:
    """emcee over the scales, exact draws of all else in the linear system, moved to the true priors and models."""
    chain = sample_scales(estimate.scales, estimate.system, estimate.x, seed=seed, progress=progress)
    draws = draw_nonlinear(estimate.models(), draw_linear(estimate.system, estimate.scales, chain, seed=seed),
                           estimate.turn, shared=estimate.roles.numbers(estimate.roles.shared), seed=seed, jobs=jobs,
                           progress=progress)
    weight, k = draws.weigh()
    return JointPosterior(chain=chain, draws=draws, weight=frozen_array(weight), pareto_k=k,
                          effective=float(1 / np.sum(weight**2)))
