"""How much a model misses of frequencies and of shapes, learnt from the residuals of one set or of several.

Two scales hold what is new in each set, of frequencies and of components of shapes, two what all sets share, and one
the local error of stiffness that mixes modes: scatter of residuals over sets shows what is new, what is left of their
mean shows what is common (Kennedy & O'Hagan 2001; Kaipio & Somersalo 2005). Each has a half-Cauchy hyper-prior that
keeps it realistic (Gelman 2006; Brynjarsdottir & O'Hagan 2014). Nodes over all of them are averaged over, not chosen
from, as in nested Laplace approximations (Rue, Martino & Chopin 2009).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from probupdate.updating.mixing import OWN_CHANGE
from probupdate.updating.problem import Problem
from probupdate.updating.responses import FORM_FREQUENCY_COV, FORM_SHAPE_STD, SHAPE_FACTOR
from probupdate.updating.settings import CONSTANTS
from probupdate.updating.shared_error import (
    COMPONENT,
    FREQUENCY,
    MIXING,
    GaussianPrior,
    Inner,
    Scales,
    SharedError,
    total,
)

MOST = CONSTANTS.most_discrepancy
# ln p of what is new in each set, of frequencies and components, and of shared scales (n, 3): (n,)
Evidence = Callable[[tuple[float, float], np.ndarray], np.ndarray]
# axes: new in each set, of frequencies and components; shared, of frequencies, components and mixing
N_AXIS, NEW = 5, 2
# scales that are looked at along each axis, from this share of the hyper-prior's on, one axis after another; then of a
# grid about where the posterior is: of what is new, each of which sums over the sets again, and of what is shared; of
# one set alone
SPAN, N_SCAN, SWEEPS, ROUNDS = 0.02, 10, 2, 2
N_GRID, N_GRID_ALONE = (5, 5, 7, 7, 5), (7, 6, 1, 1, 5)
# of the largest: nodes with less are left out, and where an axis ends
LEAST_SHARE, LEAST_AT_EDGE = 5e-3, 0.02


@dataclass(frozen=True, eq=False, kw_only=True)
class LearntScales:
    """Nodes over what is new in each set and what is shared, where the posterior has its mass; `new` stands for the
    first where one number is wanted, `shared` are nodes over the second alone, at that. `axes`: numbers along each, new
    and shared, of frequencies, of components and, shared alone, of mixing; `marginal`: posterior probability of each.
    """

    nodes: tuple[Scales, ...]
    new: tuple[float, float]
    shared: tuple[Scales, ...]
    axes: tuple[np.ndarray, ...]
    marginal: tuple[np.ndarray, ...]
    learnt: bool

    @property
    def ends(self) -> tuple[tuple[float, float], ...]:
        """5 and 95 % of each axis."""
        found = []
        for m, axis in zip(self.marginal, self.axes, strict=True):
            low, high = np.exp(np.interp((0.05, 0.95), np.cumsum(m) - 0.5 * m, np.log(axis))) if len(axis) > 1 else (
                axis[0], axis[0])
            found.append((float(low), float(high)))
        return tuple(found)


def hyper_scales(problem: Problem) -> tuple[float, float, float]:
    """Of the half-Cauchy hyper-priors of frequencies, components and mixing: beside stated tolerances of the structure
    what its form misses is all that is left; of sensors' alone no error of the structure is stated. What mixes modes
    changes frequencies too: both together are as large a priori as the one of frequencies alone."""
    structural = any(s.group not in ("sensors", "theory") for s in problem.error_sources)
    frequency, shape = ((FORM_FREQUENCY_COV, FORM_SHAPE_STD) if problem.weights.tolerances and structural else
                        (CONSTANTS.frequency_discrepancy, CONSTANTS.shape_discrepancy))
    if problem.mixing is not None:
        frequency /= np.sqrt(2)
    return frequency, shape, frequency / OWN_CHANGE


def log_half_cauchy(scale: np.ndarray, hyper: float | np.ndarray) -> np.ndarray:
    """ln of the density of ln(scale), the scale half-Cauchy: flat towards zero, and a tail that lets the data say ten
    times as much."""
    return np.log(2 / np.pi) + np.log(scale / hyper) - np.log1p((scale / hyper) ** 2)


def learn_scales(
    error: SharedError, prior: GaussianPrior, tau: np.ndarray | None = None, evidence: Evidence | None = None
) -> LearntScales:
    """Scales of the discrepancy of several sets at one common u, or each at its own, scattered by `tau` (n_param,); of
    weights that state a discrepancy, that. evidence: of the sets with all else that shows these scales."""
    weights = error.problems[0].weights
    if not (weights.scales or error.alone):
        new, shared = weights.part(1 - weights.shared), weights.part(weights.shared)
        one = Scales(new=new, shared=(*shared, weights.mixing))
        return LearntScales(nodes=(one,), new=new, shared=(one,), learnt=False, marginal=(np.ones(1),) * N_AXIS,
                            axes=tuple(np.array([x]) for x in (*new, *one.shared)))
    grid = _Grid(error, prior, tau, evidence)
    axes = grid.scan_axes()
    for _ in range(ROUNDS):
        value = grid.values(axes)
        axes = [_scales_about(axis, special.logsumexp(value, axis=_sum_over_other_axes(k)), grid.number[k])
                for k, axis in enumerate(axes)]
    value = grid.values(axes)
    prior_value = grid.log_prior(axes)
    share = np.exp(value - special.logsumexp(value))
    marginal = [share.sum(axis=_sum_over_other_axes(k)) for k in range(N_AXIS)]
    frequency, shape = (float(np.exp(m @ np.log(axis))) for m, axis in zip(marginal[:NEW], axes[:NEW], strict=True))
    new = frequency, shape
    nodes = [_node(axes, at, float(prior_value[tuple(at)]))
             for at in np.argwhere(share > LEAST_SHARE * share.max())]
    along = share.sum(axis=(0, 1))
    shared = [Scales(new=new, shared=_node(axes, (0, 0, *at)).shared, log_weight=float(prior_value[(0, 0, *at)]))
              for at in np.argwhere(along > LEAST_SHARE * along.max())]
    return LearntScales(nodes=tuple(nodes), new=new, shared=tuple(shared), axes=tuple(axes), marginal=tuple(marginal),
                        learnt=True)


def _node(axes: Sequence[np.ndarray], at: Sequence[int] | np.ndarray, log_weight: float = 0.0) -> Scales:
    *new, frequency, shape, mixing = (float(axis[k]) for axis, k in zip(axes, at, strict=True))
    return Scales(new=(new[0], new[1]), shared=(frequency, shape, mixing), log_weight=log_weight)


def _sum_over_other_axes(axis: int) -> tuple[int, ...]:
    return tuple(k for k in range(N_AXIS) if k != axis)


def _scales_about(axis: np.ndarray, log_share: np.ndarray, number: int) -> np.ndarray:
    """`number` scales over where the marginal has its mass, a step beyond to either side."""
    if len(axis) == 1:
        return axis
    inside = np.flatnonzero(log_share > log_share.max() + np.log(LEAST_AT_EDGE))
    return np.geomspace(axis[max(inside[0] - 1, 0)], axis[min(inside[-1] + 1, len(axis) - 1)], number)


class _Grid:
    """ln posterior of scales over the axes."""

    def __init__(
        self, error: SharedError, prior: GaussianPrior, tau: np.ndarray | None, evidence: Evidence | None
    ):
        self.error, self.prior, self.tau, self.own_evidence = error, prior, tau, evidence
        frequency, shape, mixing = hyper_scales(error.problems[0])
        self.hyper = (frequency, shape, frequency, shape, mixing)
        has_shapes = any(p.measured.size > p.n_frequency for p in error.problems)
        new = (True, has_shapes)
        shared = tuple(bool(np.any(error.kind == k)) for k in (FREQUENCY, COMPONENT, MIXING))
        self.present = (*new, *shared)
        self.number = N_GRID_ALONE if error.alone else N_GRID
        self.kept: dict[tuple[float, float], Inner] = {}

    def evidence(self, new: tuple[float, float], shared: np.ndarray) -> np.ndarray:
        """(n,) of shared scales (n, 3)."""
        if self.own_evidence is not None:
            return self.own_evidence(new, shared)
        if new not in self.kept:
            self.kept[new] = self.error.sum_sets(new) if self.tau is None else total(self.error.each(new, self.tau))
        return self.kept[new].evidence(self.error.common_std(shared), self.prior)

    def values(self, axes: Sequence[np.ndarray]) -> np.ndarray:
        """ln of evidence, hyper-prior and steps over the grid of the axes."""
        shared = np.stack(np.meshgrid(*axes[NEW:], indexing="ij"), axis=-1).reshape(-1, N_AXIS - NEW)
        found = [[self.evidence((float(a), float(b)), shared) for b in axes[1]] for a in axes[0]]
        return np.array(found).reshape([len(axis) for axis in axes]) + self.log_prior(axes)

    def scan_axes(self) -> list[np.ndarray]:
        """Where each scale's conditional has its mass, the others at their best so far."""
        tops = (MOST, SHAPE_FACTOR * MOST) * 2 + (2 * MOST,)
        full = [np.geomspace(SPAN * h, top, N_SCAN) if there else np.array([h])
                for h, top, there in zip(self.hyper, tops, self.present, strict=True)]
        at, axes = [np.array([h]) for h in self.hyper], list(full)
        for _ in range(SWEEPS):
            for k, axis in enumerate(full):
                if len(axis) > 1:
                    found = self.values([*at[:k], axis, *at[k + 1 :]]).ravel()
                    at[k], axes[k] = axis[[np.argmax(found)]], _scales_about(axis, found, self.number[k])
        return axes

    def log_prior(self, axes: Sequence[np.ndarray]) -> np.ndarray:
        """ln of hyper-prior times steps over the grid; an axis of one number counts nothing."""
        value = np.zeros([len(axis) for axis in axes])
        for k, (axis, h) in enumerate(zip(axes, self.hyper, strict=True)):
            if len(axis) > 1:
                own = np.log(np.log(axis[1] / axis[0])) + log_half_cauchy(axis, h)
                value = value + own.reshape([-1 if j == k else 1 for j in range(N_AXIS)])
        return value
