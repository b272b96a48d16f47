"""Draws of a farm's joint posterior with the turbines' true models: randomise, then optimise.

A draw v_L of the linear system is moved to v, where the true model's residuals, projected on the linear system's
columns A, are the linear ones': H (v - v_L) + A^T n(v) = 0, H the system's precision, n what the true response has
beside the straight line. The density of v is known, its weight the true density at v over the linear one at v_L, times
det H / det(H + A^T n') (Bardsley, Solonen, Haario & Laine 2014; hierarchical: Bardsley & Cui 2020). Draws follow bent
ridges on which linear ones have no weight at all. Of the unknowns only the turbines' parameters enter n; the common
error is eliminated exactly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import linalg

from probupdate.runtime.executors import Executor, iterate_completed
from probupdate.runtime.progress import Progress
from probupdate.structure.affine import AffineModel
from probupdate.structure.reduced import reduce_alike
from probupdate.updating.joint_draws import CHUNK, JointDraws, LinearDraws
from probupdate.updating.joint_prior import NormalScores
from probupdate.updating.joint_system import FarmSystem
from probupdate.updating.problem import Problem
from probupdate.updating.settings import CONSTANTS
from probupdate.updating.solved_once import SolvedOnce

# points of which a reduced basis of a large model is made; how many times as far from their middle they lie as linear
# draws, which move
N_BASIS, WIDER = 200, 2.0
# steps of Newton at most; squared standard deviations of the linear posterior by which a solution is missed; how often
# a step is divided by three
STEPS, SOLVED, SHORTER = 40, 1e-6, 6
# step of differences of scores
DIFFERENCE = 3e-4


@dataclass(frozen=True, eq=False, kw_only=True)
class LinearSet:
    """One set of a turbine: its problem with what is new in it alone, residual (n,) at scores u = middle (n_param,),
    slope (n, n_param) in u and effect of the common unknowns (n, n_e)."""

    problem: Problem
    middle: np.ndarray
    residual: np.ndarray
    slope: np.ndarray
    effect: np.ndarray

    @cached_property
    def white(self) -> np.ndarray:
        """Whitened (slope, effect, residual) (n, n_param + n_e + 1)."""
        return self.problem.whiten(np.column_stack([self.slope, self.effect, self.residual]).T).T


@dataclass(frozen=True, eq=False, kw_only=True)
class TurbineModel:
    """The sets of one turbine, and the scores u of its parameters."""

    sets: tuple[LinearSet, ...]
    scores: NormalScores

    def theta(self, u: np.ndarray) -> np.ndarray:
        """What the models are asked for (n, n_param): what correlates is cut where it is weighed."""
        return np.clip(self.scores.back(u), self.scores.parameters.lower, self.scores.parameters.upper)

    def bend(self, fast: Mapping[str, Any], u: np.ndarray) -> np.ndarray:
        """Whitened n(u), what the true responses have beside the straight line, projected on (slope, effect, residual)
        and itself: (n, n_param + n_e + 2)."""
        theta = self.theta(u)
        models: dict[str, Any] = {key: SolvedOnce(model) for key, model in fast.items()}
        total = 0.0
        for one in self.sets:
            problem = one.problem.with_model(models[one.problem.model.fingerprint()])
            line = one.problem.measured - one.residual + (u - one.middle) @ one.slope.T
            beside = one.problem.whiten(problem.predict_many(theta).response - line)
            total = total + np.column_stack([beside @ one.white, np.sum(beside**2, axis=1)])
        return total


def turbine_bends(
    number: int, turbine: TurbineModel, fast: Mapping[str, Any], u: np.ndarray, wanted: np.ndarray,
) -> tuple[int, np.ndarray, np.ndarray]:
    """`bend` at u (n, n_param), and where wanted (n,) its derivatives (n_wanted, n_param + n_e, n_param) by
    differences."""
    n, n_param = u.shape
    points = np.concatenate([u, (u[wanted, None] + DIFFERENCE * np.eye(n_param)).reshape(-1, n_param)])
    found = turbine.bend(fast, points)
    more = found[n:].reshape(-1, n_param, found.shape[1])
    slope = (more[:, :, :-2] - found[:n][wanted][:, None, :-2]) / DIFFERENCE
    return number, found[:n], np.swapaxes(slope, 1, 2)


@dataclass(frozen=True, eq=False, kw_only=True)
class Arrow:
    """The linear system of one draw, in w = (z, scatter over its standard deviation and own parameters of each
    turbine), the common error e eliminated: local (n_turbine, n_param, n_local) from a turbine's part of w, at
    `place` (n_turbine, n_local), to u; precision (n_w, n_w) and its factor; follow (n_e, n_w): -e per unit of w."""

    local: np.ndarray
    place: np.ndarray
    precision: np.ndarray
    factor: tuple[np.ndarray, bool]
    error: tuple[np.ndarray, bool]
    follow: np.ndarray

    @classmethod
    def assemble(cls, system: FarmSystem, inner: np.ndarray, spread: np.ndarray, std: np.ndarray) -> Arrow:
        """inner (n_turbine, n_param + n_e, n_param + n_e): inner products of (slope, effect) of each turbine."""
        layout, c, n_z = system.layout, system.columns, system.n_z
        n_t, n, n_own = len(inner), len(layout.offset), layout.own.shape[1]
        n_local = n_z + len(c) + n_own
        local = np.zeros((n_t, n, n_local))
        local[:, :, :n_z] = layout.shared
        local[:, :, n_z : n_z + len(c)] = layout.shared[:, c] * spread[:, None, :]
        local[:, :, n_z + len(c) :] = layout.own
        own = n_z + np.arange(n_t * (n_local - n_z)).reshape(n_t, -1)
        place = np.column_stack([np.tile(np.arange(n_z), (n_t, 1)), own])
        n_w, n_e = n_z + own.size, inner.shape[1] - n
        precision, across = np.eye(n_w), np.zeros((n_e, n_w))
        precision[:n_z, :n_z] = layout.prior[1]
        for G, W, at in zip(inner, local, place, strict=True):
            precision[np.ix_(at, at)] += W.T @ G[:n, :n] @ W
            across[:, at] += G[n:, :n] @ W
        error = linalg.cho_factor(np.diag(1 / std**2) + inner[:, n:, n:].sum(axis=0), lower=True)
        follow = linalg.cho_solve(error, across)
        precision -= across.T @ follow
        return cls(local=local, place=place, precision=precision, factor=linalg.cho_factor(precision), error=error,
                   follow=follow)

    def move_turbines(self, w: np.ndarray) -> np.ndarray:
        """By how much u (n_turbine, n_param) moves with w (n_w,)."""
        return np.einsum("icl,il->ic", self.local, w[self.place])

    def coordinates(self, u: np.ndarray, z: np.ndarray) -> np.ndarray:
        """w (n_w,) of what moves u (n_turbine, n_param) and z (n_z,)."""
        # where nothing scatters, least squares give zero
        return np.concatenate([z, *(
            np.linalg.lstsq(local[:, len(z) :], own - local[:, : len(z)] @ z, rcond=1e-12)[0]
            for local, own in zip(self.local, u, strict=True))])

    @property
    def distance(self) -> np.ndarray:
        """(n_w, n_w): w^T distance w is the squared distance by which u moves with w."""
        total = np.zeros_like(self.precision)
        for at, local in zip(self.place, self.local, strict=True):
            total[np.ix_(at, at)] += local.T @ local
        return total

    def gather(self, local: np.ndarray) -> np.ndarray:
        """Sums at their place in w (n_w, ...) of each turbine's part (n_turbine, n_local, ...)."""
        total = np.zeros((len(self.precision), *local.shape[2:]))
        for at, part in zip(self.place, local, strict=True):
            total[at] += part
        return total

    def pull(self, bend: np.ndarray) -> np.ndarray:
        """A^T n (n_w,) of bends (n_turbine, n_param + n_e), the common error eliminated."""
        n = bend.shape[1] - len(self.follow)
        own = np.einsum("icl,ic->il", self.local, bend[:, :n])
        return self.gather(own) - self.follow.T @ bend[:, n:].sum(axis=0)

    def curvature(self, slope: np.ndarray) -> np.ndarray:
        """H + A^T n' (n_w, n_w) of derivatives (n_turbine, n_param + n_e, n_param)."""
        n = slope.shape[1] - len(self.follow)
        moved = slope @ self.local
        own = np.swapaxes(self.local, 1, 2) @ moved[:, :n]
        total, error = np.array(self.precision), np.zeros_like(self.follow)
        for at, a, b in zip(self.place, own, moved[:, n:], strict=True):
            total[np.ix_(at, at)] += a
            error[:, at] += b
        return total - self.follow.T @ error

    def ln_det(self) -> float:
        return 2 * float(np.log(np.diag(self.factor[0])).sum())


@dataclass(eq=False)
class _Moving:
    """One draw on its way: its shift s (n_w,) so far, that of e, the next step, how far it is missed, ln of the
    determinants' ratio; derivatives of its bends, none at first, as steps show them (Broyden 1965), by differences
    where those do not serve and where it stays (`exact`, and `fresh` after that); `end`: '' while it moves,
    'solved' or 'lost'."""

    arrow: Arrow
    shift: np.ndarray
    step: np.ndarray
    error: np.ndarray
    length: float = 1.0
    missed: float = np.inf
    ln_ratio: float = 0.0
    bend: np.ndarray | None = None
    slope: np.ndarray | None = None
    exact: bool = False
    fresh: bool = False
    end: str = ""

    @property
    def trial(self) -> np.ndarray:
        return self.shift + self.length * self.step

    def shorten(self) -> None:
        """After a step that does not lead nearer, or out of the region that the models know."""
        self.length /= 3
        self.end = "lost" if self.length < 3.0**-SHORTER else ""

    def judge(self, bend: np.ndarray, slope: np.ndarray | None) -> None:
        """Of bends (n_turbine, n_param + n_e + 2) and, where they were worked out, derivatives at the trial: taken
        where it misses by less."""
        arrow, trial = self.arrow, self.trial
        left = arrow.precision @ trial + arrow.pull(bend[:, :-2])
        missed = float(left @ linalg.cho_solve(arrow.factor, left))
        if not (self.exact or missed < self.missed):
            if self.fresh:
                self.shorten()
            else:
                # derivatives that steps have shown are worked out again where it is
                self.step, self.exact = np.zeros_like(self.step), True
            return
        if slope is None:
            slope = self._update_derivatives(bend, arrow.move_turbines(trial - self.shift))
        whole = arrow.curvature(slope)
        n = bend.shape[1] - 2 - len(arrow.follow)
        self.shift, self.missed, self.bend, self.slope = trial, missed, bend, slope
        self.error = -linalg.cho_solve(arrow.error, bend[:, n:-2].sum(axis=0)) - arrow.follow @ trial
        sign, ln_det = np.linalg.slogdet(whole)
        if self.exact and not (sign > 0 and np.isfinite(ln_det)):
            # folded over: the density is not that of one solution
            self.end = "lost"
            return
        self.ln_ratio, solved = float(ln_det) - arrow.ln_det(), missed < SOLVED
        self.end = "solved" if solved and self.exact else ""
        # once more where it is, for its determinant
        self.step = np.zeros_like(left) if solved else -np.linalg.solve(whole, left)
        self.length, self.fresh, self.exact = min(1.0, 3 * self.length), self.exact, solved

    def _update_derivatives(self, bend: np.ndarray, moved: np.ndarray) -> np.ndarray:
        """Derivatives changed by what a step (n_turbine, n_param) has shown."""
        if self.bend is None:
            return np.zeros((*bend[:, :-2].shape, moved.shape[1]))
        found = np.array(self.slope)
        for M, after, before, step in zip(found, bend, self.bend, moved, strict=True):
            if np.any(step):
                M += np.outer(after[:-2] - before[:-2] - M @ step, step / (step @ step))
        return found


@dataclass(frozen=True, eq=False, kw_only=True)
class FarmModels:
    """The turbines' true models beside their linear system: inner (n_turbine, 1 + n_param + n_e squared) products of
    whitened (residual, slope, effect) about middle (n_param,)."""

    system: FarmSystem
    turbines: tuple[TurbineModel, ...]
    inner: np.ndarray
    middle: np.ndarray

    def linear_scores(self, draws: LinearDraws) -> np.ndarray:
        """u (n, n_turbine, n_param)."""
        return self.middle + draws.d

    def transport(
        self, draws: LinearDraws, fast: FastModels, jobs: int | Executor
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Of linear draws: z (n, n_z), u (n, n_turbine, n_param) and e (n, n_e) where they are moved to, and ln of what
        these weigh."""
        begin, spread, n_z = self.linear_scores(draws), self.system.spread(draws.tau), self.system.n_z
        n_w = n_z + begin.shape[1] * (len(self.system.columns) + self.system.layout.own.shape[1])
        moving = [_Moving(Arrow.assemble(self.system, self.inner[:, 1:, 1:], own, std), np.zeros(n_w), np.zeros(n_w),
                          np.zeros(draws.e.shape[1])) for own, std in zip(spread, draws.std, strict=True)]
        u = np.array(begin)
        for _ in range(STEPS):
            some = [k for k, one in enumerate(moving) if not one.end]
            for k in some:
                u[k] = begin[k] + moving[k].arrow.move_turbines(moving[k].trial)
                while not (moving[k].end or self._inside(fast, u[k])):
                    moving[k].shorten()
                    u[k] = begin[k] + moving[k].arrow.move_turbines(moving[k].trial)
            some = [k for k in some if not moving[k].end]
            if not some:
                break
            self._judge([moving[k] for k in some], fast, u[some], jobs)
        for k, one in enumerate(moving):
            u[k] = begin[k] + one.arrow.move_turbines(one.shift)
        z = draws.z + np.array([one.shift[:n_z] for one in moving])
        e = draws.e + np.array([one.error for one in moving])
        weight = np.array([self._log_weight(one, *both) if one.end == "solved" else -np.inf for one, both in zip(
            moving, zip(draws.z, draws.std, begin, u, draws.e, e, strict=True), strict=True)])
        return z, u, e, weight

    def _inside(self, fast: FastModels, u: np.ndarray) -> bool:
        """Whether the fast models of all turbines know u (n_turbine, n_param)."""
        theta = self.turbines[0].theta(u)
        return bool(np.all((theta >= fast.lower) & (theta <= fast.upper)))

    def _judge(self, moving, fast: FastModels, u: np.ndarray, jobs) -> None:
        wanted = np.array([one.exact for one in moving])
        tasks = [(i, turbine, fast.models[i], u[:, i], wanted) for i, turbine in enumerate(self.turbines)]
        found = {number: rest for number, *rest in iterate_completed(turbine_bends, tasks, jobs=jobs, least=1)}
        bend, slope = (np.array([found[i][k] for i in range(len(tasks))]) for k in range(2))
        row = np.cumsum(wanted) - 1
        for k, one in enumerate(moving):
            one.judge(bend[:, k], slope[:, row[k]] if wanted[k] else None)

    def _log_weight(self, one: _Moving, z, std, begin, u, e_begin, e) -> float:
        """ln of the true density at u, e over the linear one at `begin`, e_begin, times the ratio of determinants."""
        mean, precision = self.system.layout.prior
        s, bend, n_z = one.shift, one.bend, self.system.n_z
        value = -one.ln_ratio - 0.5 * np.sum((e**2 - e_begin**2) / std**2)
        value -= 0.5 * s[:n_z] @ precision @ (2 * (z - mean) + s[:n_z])
        # of what scatters and own parameters, standard normal each
        own = one.arrow.coordinates(begin - self.middle - self.system.layout.offset, z)[n_z:]
        value -= 0.5 * np.sum(s[n_z:] * (2 * own + s[n_z:]))
        ends = u - self.middle, begin - self.middle
        for G, at, before, own in zip(self.inner, *ends, bend, strict=True):
            x, y = np.concatenate([[1.0], -at, -e]), np.concatenate([[1.0], -before, -e_begin])
            across = own[-2] - own[:-2] @ np.concatenate([at, e])
            value -= 0.5 * (x @ G @ x - y @ G @ y - 2 * across + own[-1])
        return float(value)


@dataclass(frozen=True, eq=False, kw_only=True)
class FastModels:
    """Of each turbine its models by fingerprint, and lower, upper (n_turbine, n_param) of theta between which they
    answer."""

    models: tuple[dict[str, Any], ...]
    lower: np.ndarray
    upper: np.ndarray


def fast_models(
    turbines: Sequence[TurbineModel], theta: np.ndarray, seed: int, progress: Progress
) -> FastModels:
    """A reduced basis for the region of points theta (n, n_turbine, n_param) instead of a large model."""
    asked: dict[str, tuple[Problem, set[int]]] = {}
    for i, turbine in enumerate(turbines):
        for one in turbine.sets:
            asked.setdefault(one.problem.model.fingerprint(), (one.problem, set()))[1].add(i)
    found: tuple[dict[str, Any], ...] = tuple({} for _ in turbines)
    lower, upper = np.full(theta.shape[1:], -np.inf), np.full(theta.shape[1:], np.inf)
    # models of one mesh share a basis
    meshes: dict[tuple, list[str]] = {}
    for key, (problem, of) in asked.items():
        model: Any = problem.model
        if isinstance(model, AffineModel) and model.n_dof >= CONSTANTS.reduce_from:
            meshes.setdefault((model.mesh, problem.parameters.names, problem.matching.n_mode), []).append(key)
        for i in of:
            found[i][key] = model
    for (_, _, n_mode), keys in meshes.items():
        some, p = sorted(set.union(*(asked[key][1] for key in keys))), asked[keys[0]][0].parameters
        points = theta[:, some].reshape(-1, theta.shape[2])
        # each turbine's own cloud about its own middle
        middle = np.tile(np.median(theta[:, some], axis=0), (len(theta), 1))
        points = np.clip(middle + WIDER * (points - middle), p.lower, p.upper)
        low, high = points.min(axis=0), points.max(axis=0)
        models = reduce_alike(
            [asked[key][0].model for key in keys], frequency_tolerance=CONSTANTS.frequency_tolerance, n_mode=n_mode,
            seed=seed, points=points[:: max(1, len(points) // N_BASIS)], box=(low, high), progress=progress)
        for key, model in zip(keys, models, strict=True):
            for i in asked[key][1]:
                found[i][key] = model
                lower[i], upper[i] = np.maximum(lower[i], low), np.minimum(upper[i], high)
    return FastModels(models=found, lower=lower, upper=upper)


def draw_nonlinear(
    models: FarmModels, draws: LinearDraws, turn: np.ndarray, *, shared: Sequence[int], seed: int = 1,
    jobs: int | Executor = 1, progress: Progress
) -> JointDraws:
    """The draws of a farm's linear system moved to the true models, with their weights; turn (n_e, n_kept): back to the
    common unknowns; shared: numbers of z's parameters."""
    scores, u = models.turbines[0].scores, models.linear_scores(draws)
    fast, parts = fast_models(models.turbines, models.turbines[0].theta(u), seed, progress), []
    for start in range(0, len(u), CHUNK):
        progress("true model at the draws", start, len(u))
        parts.append(models.transport(draws.some(slice(start, start + CHUNK)), fast, jobs))
    progress("true model at the draws", len(u), len(u))
    z, u, e, weight = (np.concatenate([part[k] for part in parts]) for k in range(4))
    z = z + models.middle[list(shared)]
    weight = weight + scores.some(shared).log_cut(z) + scores.log_cut(u).sum(axis=1)
    return JointDraws(z=z, e=e @ turn.T, tau=draws.tau, u=u, log_weight=weight)
