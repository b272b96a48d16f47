"""The most probable values and scales of a farm, both at once: Newton steps within a region of trust.

One density decides on every step: of the scales x with the common error, the scatter and the turbines' parameters at
their place, times the Gaussian volume about it (Laplace), F(v, x) = ln p(y, v | x) p(x) - ln det H(v, x) / 2. Where the
models are made linear at v, F is what `joint_system` has for x, all else integrated out, less half the squared distance
of v from the linear posterior's mean, so that a step to that mean at the x of the largest density is Newton's for both.
A step that does not raise F is tried again nearer to v (Levenberg 1944; Marquardt 1963): scales and values that are
solved for in turn may go round for ever. Where F is as good as its largest, a step may lower it that lowers what
another one would gain: the volume's own slope is in no step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg, optimize

from probupdate.runtime.arrays import frozen_array
from probupdate.runtime.progress import Progress
from probupdate.updating.joint_nonlinear import Arrow
from probupdate.updating.joint_prior import NormalScores
from probupdate.updating.joint_scales import Scales
from probupdate.updating.joint_system import FarmSystem, Layout, Roles
from probupdate.updating.problem import Problem
from probupdate.updating.shared_error import Inner, SharedError, shared_error, total

# linearisations at most; a place is the maximum where another step would gain less of ln density than this: a tenth of
# a standard deviation; densities are as good as one another that differ by less than a factor of e
ROUNDS, LEAST_GAIN, ALIKE = 60, 5e-3, 1.0
# what holds a step near, in prior standard deviations to the power of -2: where it is first needed, how it grows and
# falls, and from where on no step gains anything
FIRST, GROWTH, MOST = 0.1, 4.0, 1e6
# shares of a gain that was hoped for between which steps are held as they were
POOR, GOOD = 0.25, 0.75
# steps at most of the search for the scales beside a step that is held
SEARCHES = 8


@dataclass(frozen=True, eq=False, kw_only=True)
class Place:
    """Scores u (n_turbine, n_param) and z (n_z,) of what turbines share, where the models are linear; scales x (n_x,),
    and where their density is largest; value: F. inners: one a turbine."""

    u: np.ndarray
    z: np.ndarray
    x: np.ndarray
    error: SharedError
    inners: tuple[Inner, ...]
    system: FarmSystem
    turn: np.ndarray
    laplace: Laplace
    value: float
    next_x: np.ndarray

    @property
    def gain(self) -> float:
        """Of F by a step, if the models were linear."""
        return self.laplace.largest(self.next_x) - self.value


@dataclass(eq=False, kw_only=True)
class FarmAscent:
    """What does not change from place to place; `new`: what is new in each set; learnt: whether scales follow the data;
    wide (n_turbine, n_z): of turbines that are unlike the others; rounds: linearisations so far."""

    problems: Sequence[Problem]
    set_turbine: np.ndarray
    roles: Roles
    scores: NormalScores
    scales: Scales
    new: tuple[float, float]
    progress: Progress
    learnt: bool = False
    wide: np.ndarray | None = None
    rounds: int = 0

    @property
    def shared(self) -> list[int]:
        return self.roles.numbers(self.roles.shared)

    def start(self, u: np.ndarray) -> Place:
        """Near u (n_turbine, n_param), the scales as large as expected."""
        z = u[:, self.shared].mean(axis=0)
        u = np.array(u)
        u[:, self.shared[: len(self.roles.common)]] = z[: len(self.roles.common)]
        return self.evaluate(u, z, None)

    def evaluate(self, u: np.ndarray, z: np.ndarray, x: np.ndarray | None) -> Place:
        """The models made linear there. x None: as expected."""
        self.progress("joint estimate", min(self.rounds, ROUNDS), ROUNDS + 1)
        self.rounds += 1
        p = self.scores.parameters
        theta = np.clip(self.scores.back(u), p.lower, p.upper)
        error = shared_error(self.problems, theta[self.set_turbine], self.scores)
        return self.with_error(error, u, z, x)

    def with_error(self, error: SharedError, u: np.ndarray, z: np.ndarray, x: np.ndarray | None) -> Place:
        layout = Layout.from_roles(self.roles, self.scores.covariance, error.middle)
        inners = group_inners(error, self.new, self.set_turbine)
        system, turn = FarmSystem.assemble(inners, layout, error.kind, error.form).keep_informed(
            self.scales.hyper, self.scales.learnt)
        if self.wide is not None:
            system = system.with_odd_scale(self.wide)
        x = np.zeros(self.scales.n_x(system)) if x is None else x
        full = linalg.block_diag(np.eye(1 + len(error.middle)), turn)
        laplace = Laplace(system=system, scales=self.scales, middle=error.middle, shared=self.shared,
                          inner=np.array([full.T @ one.products @ full for one in inners]))
        return Place(u=frozen_array(u), z=frozen_array(z), x=frozen_array(x), error=error, inners=tuple(inners),
                     system=system, turn=turn, laplace=laplace, value=laplace.value(x, u, z),
                     next_x=self.scales.maximum(system, x) if self.learnt else x)

    def ascend(self, place: Place, least: float = LEAST_GAIN) -> tuple[Place, bool]:
        """The maximum that is uphill, and whether it was reached: where a step would gain less than `least`."""
        held, closing, most = 0.0, False, self.rounds + ROUNDS
        while self.rounds < most and held < MOST:
            if place.gain < least:
                return place, True
            x = place.laplace.best_scales(place, held) if held and self.learnt else place.next_x
            u, z = place.laplace.step(x, place.u, place.z, held)
            fresh, hoped = self.evaluate(u, z, x), place.laplace.value(x, u, z) - place.value
            # a step so short that nothing is hoped for is as good as none
            share = (fresh.value - place.value) / hoped if hoped > 0 else 0.0
            if fresh.gain < place.gain < ALIKE and fresh.value > place.value - ALIKE:
                place, closing = fresh, True
            elif closing or share <= 0:
                held = max(FIRST, GROWTH * held)
                continue
            else:
                place = fresh
            # as straight as it was thought, or not (Marquardt's factor by the share of the gain that came)
            held = held / GROWTH if share > GOOD else held * GROWTH if share < POOR else held
            held = held if held > FIRST / GROWTH else 0.0
        return place, False


@dataclass(frozen=True, eq=False, kw_only=True)
class Laplace:
    """F over scales and values where the models are linear: inner (n_turbine, n_a, n_a) products of whitened
    (residual, slope, effect) about middle (n_param,); shared: numbers of z's parameters."""

    system: FarmSystem
    scales: Scales
    inner: np.ndarray
    middle: np.ndarray
    shared: Sequence[int]

    def largest(self, x: np.ndarray) -> float:
        """F (all values at their best) of x (n_x,)."""
        mean, precision = self.system.layout.prior
        return float(self.scales.log_posterior(x[None], self.system)[0]) - 0.5 * float(mean @ precision @ mean)

    def value(self, x: np.ndarray, u: np.ndarray, z: np.ndarray) -> float:
        off, arrow = self._off(x, u, z)
        return self.largest(x) - 0.5 * float(off @ arrow.precision @ off)

    def step(self, x: np.ndarray, u: np.ndarray, z: np.ndarray, held: float) -> tuple[np.ndarray, np.ndarray]:
        """u and z at the largest F of x, less `held` times half the squared distance of u."""
        off, arrow = self._off(x, u, z)
        step = -np.linalg.solve(arrow.precision + held * arrow.distance, arrow.precision @ off)
        return u + arrow.move_turbines(step), z + step[: self.system.n_z]

    def best_scales(self, place: Place, held: float) -> np.ndarray:
        """x (n_x,) of the largest F where u is held."""
        n = len(place.x)
        inside = self.scales.bounds(n) + np.array([0.01, -0.01])

        def descent(x: np.ndarray) -> float:
            off, arrow = self._off(x, place.u, place.z)
            pull = arrow.precision @ off
            left = off @ pull - pull @ np.linalg.solve(arrow.precision + held * arrow.distance, pull)
            return 0.5 * float(left) - self.largest(x)

        return optimize.minimize(descent, np.clip(place.x, *inside.T), method="L-BFGS-B", bounds=inside,
                                 options={"eps": 1e-4, "maxiter": SEARCHES}).x if n else place.x

    def _off(self, x: np.ndarray, u: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, Arrow]:
        """How far u and z are from the linear posterior's mean (n_w,), in the coordinates of its arrow."""
        tau, std = self.scales.tau(x), self.system.common_std(self.scales.shared(x, self.system))
        joint = self.system.conditional(tau, std)
        best = self.system.means(tau, joint)
        arrow = Arrow.assemble(self.system, self.inner[:, 1:, 1:], self.system.spread(tau), std)
        return arrow.coordinates(u - self.middle - best,
                                 z - self.middle[list(self.shared)] - joint.mean[: self.system.n_z]), arrow


def group_inners(error: SharedError, new: tuple[float, float], group: np.ndarray) -> list[Inner]:
    """Of each group of sets, by its number (n_set,)."""
    each = error.each(new)
    return [total([each[s] for s in np.flatnonzero(group == i)]) for i in range(group.max() + 1)]
