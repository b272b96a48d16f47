"""Which turbine is unlike the others, and in which parameter.

A turbine is odd with a stated prior share; then one of the common or varying parameters, whichever, is off by a normal
of stated width: a mixture in closed form, as of `outlier_sets`. Each turbine is judged by the others alone, averaged
over their scatter, so that it does not widen what it is held against. What size would be found is solved for, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import special, stats

from probupdate.runtime.arrays import frozen_array
from probupdate.updating.joint_scales import Scales
from probupdate.updating.joint_system import FarmSystem, lower_solve
from probupdate.updating.outlier_sets import is_near_median
from probupdate.updating.settings import CONSTANTS

SHARE, SURE = CONSTANTS.outlier_share, CONSTANTS.outlier_sure
# fewer turbines show none that is unlike the others; passes in which odd ones stop counting among the others
FEWEST, PASSES = 3, 8
# nodes over the scales: half of a Gaussian about their maximum, so much wider in variance, half of the hyper-prior
N_NODE, WIDER = 64, 2.0
# to begin with, turbines this far off the median do not count among the others, in robust standard deviations
FAR, LEAST = 3.5, 1e-12
# a deviation that is found in 95 % of the cases is this many standard deviations larger than one that just is
POWER = 1.645
# steps of the search for a limit
DOUBLINGS, BISECTIONS = 8, 40


@dataclass(frozen=True, eq=False, kw_only=True)
class OddTurbines:
    """probability (n_turbine,) of each to be unlike the others; share (n_turbine, n_z): probability that it is so in
    this parameter; shift, shift_std (n_turbine, n_z): by how much, in u; limit (n_turbine, n_z): the shift that is
    named in 95 % of cases."""

    probability: np.ndarray
    share: np.ndarray
    shift: np.ndarray
    shift_std: np.ndarray
    limit: np.ndarray

    @property
    def numbers(self) -> tuple[int, ...]:
        return tuple(int(i) for i in np.flatnonzero(self.probability >= SURE))

    def outlier_scale(self, scale: np.ndarray) -> np.ndarray:
        """How much farther than tau (n_turbine, n_z) a turbine may be in the parameters that may be the reason."""
        found = np.zeros_like(self.share)
        for i in self.numbers:
            own = self.share[i] / self.share[i].sum()
            found[i] = np.where((own >= 0.05) | (own == own.max()), scale, 0.0)
        return found


def odd_turbines(
    system: FarmSystem, scales: Scales, wide: np.ndarray, *, share: float = SHARE, seed: int = 1
) -> OddTurbines:
    """wide (n_z,): standard deviation of an odd turbine's shift in u; share: of turbines that are odd a priori."""
    system = system.with_odd_scale(np.zeros_like(system.wide))
    n, n_z = len(system.products), system.n_z
    counts = _start_values(system, scales)
    found, mixtures = _nobody(n, n_z), []
    for _ in range(PASSES if n >= FEWEST and share > 0 else 0):
        if counts.sum() < FEWEST - 1:
            break
        nodes = _nodes(system.select(np.flatnonzero(counts)), scales, seed)
        mixtures = _mixtures(system, counts, scales, nodes, wide)
        judged: list[tuple[Any, ...]] = [m.judge_turbines(share) for m in mixtures]
        found = OddTurbines(**{name: frozen_array([one[k] for one in judged]) for k, name in enumerate(
            ("probability", "share", "shift", "shift_std"))}, limit=found.limit)
        fresh = _counted_as_typical(counts, found.probability)
        if np.array_equal(counts, fresh):
            break
        counts = fresh
    return replace(found, limit=frozen_array([m.limits(share) for m in mixtures])) if mixtures else found


def _counted_as_typical(counts: np.ndarray, probability: np.ndarray) -> np.ndarray:
    """Those that are alike count again; then the one that is the least alike does not: beside it others may look so,
    too."""
    fresh = counts | (probability < 0.5)
    if np.array_equal(fresh, counts):
        worst = int(np.argmax(np.where(counts, probability, -1.0)))
        fresh[worst] = probability[worst] < 0.5
    return fresh


def _nobody(n: int, n_z: int) -> OddTurbines:
    none = np.full((n, n_z), np.nan)
    return OddTurbines(probability=np.zeros(n), share=np.zeros((n, n_z)), shift=none, shift_std=none, limit=none)


def _start_values(system: FarmSystem, scales: Scales) -> np.ndarray:
    """Turbines (n_turbine,) to begin with, by what each says alone of its z."""
    tau, std = scales.tau(np.zeros(len(scales.spread))), system.common_std(scales.hyper)
    alone = [system.select([i]).conditional(tau, std) for i in range(len(system.products))]
    value = np.array([one.mean[: one.n_z] for one in alone])
    return is_near_median(value, np.full_like(value, LEAST), FAR) if len(value) > 3 else np.ones(len(value), bool)


def _nodes(system: FarmSystem, scales: Scales, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """x (n_node, n_x) over the scales of those that count, and ln of their density as they were drawn."""
    top = scales.maximum(system)
    n_w = len(scales.spread)
    if not n_w:
        return top[None], np.zeros(1)
    # evenly spread; the hyper-prior's half bounds the weights
    even = special.ndtri(stats.qmc.Halton(n_w, seed=np.random.default_rng([seed, 33])).random(N_NODE))
    root = np.linalg.cholesky(WIDER * scales.curvature(top, system)[:n_w, :n_w])
    w = np.vstack([top[:n_w] + even[: N_NODE // 2] @ root.T, even[N_NODE // 2 :]])
    w = np.clip(w, *scales.bounds(n_w).T)
    density = np.logaddexp(*(-0.5 * np.sum(off**2, axis=1) - scale for off, scale in (
        (np.linalg.solve(root, (w - top[:n_w]).T).T, np.log(np.diag(root)).sum()), (w, 0.0))))
    return np.column_stack([w, np.tile(top[n_w:], (N_NODE, 1))]), density


def _mixtures(system: FarmSystem, counts: np.ndarray, scales: Scales, nodes, wide: np.ndarray) -> list[_Mixture]:
    """Of every turbine beside the others that count."""
    n, n_z = len(system.products), system.n_z
    log_weight, log_likelihood, f, g = (np.empty((n, len(nodes[0]), *more)) for more in ((), (), (n_z,), (n_z,)))
    for t, (x, log_q) in enumerate(zip(*nodes, strict=True)):
        tau, std = scales.tau(x), system.common_std(scales.shared(x, system))
        own, constant = system.each(tau)
        rest = own[counts].sum(axis=0) - counts[:, None, None] * own
        less = constant[counts].sum() - counts * constant
        before, _, _ = system.evidences(rest, less, std)
        after, known, root = system.evidences(rest + own, less + constant, std)
        log_weight[:, t] = scales.log_prior(x, system) + before - log_q
        log_likelihood[:, t] = after - before
        columns = own[:, 1:, 1 : 1 + n_z]
        half = lower_solve(root, columns)
        f[:, t] = np.diagonal(own, axis1=1, axis2=2)[:, 1 : 1 + n_z] - np.sum(half**2, axis=1)
        g[:, t] = own[:, 0, 1 : 1 + n_z] - np.einsum("ijk,ij->ik", half, known)
    return [_Mixture(log_weight=log_weight[i], log_likelihood=log_likelihood[i], f=np.maximum(f[i], 1e-300), g=g[i],
                     wide=wide) for i in range(n)]


@dataclass(frozen=True, eq=False, kw_only=True)
class _Mixture:
    """Of one turbine, over nodes of the others' scales with ln weights (n_node,): log_likelihood (n_node,) of it
    without a shift; f (n_node, n_z), the information about a shift in each parameter that all else leaves, g the pull
    on it; wide (n_z,), its standard deviation if there is one."""

    log_weight: np.ndarray
    log_likelihood: np.ndarray
    f: np.ndarray
    g: np.ndarray
    wide: np.ndarray

    def judge_turbines(self, share: float) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
        """Probability to be odd, that in each parameter (n_z,), shift and its standard deviation."""
        base = (self.log_weight + self.log_likelihood)[:, None]
        density = base + _log_factor(self.f, self.g, self.wide)
        factor = special.logsumexp(density, axis=0) - special.logsumexp(base, axis=0)
        odds = special.logsumexp(factor) - np.log(len(factor)) + np.log(share / (1 - share))
        probability = float(special.expit(odds))
        shift = np.sum(special.softmax(density, axis=0) * self.g / (self.f + self.wide**-2), axis=0)
        return probability, probability * special.softmax(factor), shift, self.std

    @property
    def std(self) -> np.ndarray:
        """Of an estimated shift (n_z,), the others' scatter counted."""
        return np.sqrt(special.softmax(self.log_weight) @ (1 / self.f))

    def limits(self, share: float) -> np.ndarray:
        """The shifts (n_z,) that are named in 95 % of cases, infinite where none is."""
        n_z = self.f.shape[1]
        wanted = np.log(SURE / (1 - SURE)) + np.log((1 - share) / share) + np.log(n_z)

        def surplus(s: np.ndarray) -> np.ndarray:
            # of an estimate s: its density at each node without and with a shift
            base = self.log_weight[:, None] + 0.5 * np.log(self.f) - 0.5 * self.f * s**2
            with_shift = base + _log_factor(self.f, self.f * s, self.wide)
            return special.logsumexp(with_shift, axis=0) - special.logsumexp(base, axis=0) - wanted

        low, high = np.zeros(n_z), 4 * self.std
        for _ in range(DOUBLINGS):
            high = np.where(surplus(high) < 0, 2 * high, high)
        found = surplus(high) >= 0
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            above = surplus(middle) >= 0
            low, high = np.where(above, low, middle), np.where(above, middle, high)
        return np.where(found, high + POWER * self.std, np.inf)


def _log_factor(f: np.ndarray, g: np.ndarray, wide: np.ndarray) -> np.ndarray:
    """ln of the density with a shift over that without, (n_node, n_z)."""
    gain = f * wide**2
    return -0.5 * np.log1p(gain) + 0.5 * g**2 * wide**2 / (1 + gain)


def odd_sentences(odd: OddTurbines, turbines: Sequence[str], names: Sequence[str], words) -> list[str]:
    """Of those that are odd with a probability of SURE or more; words(i, k): the shift of turbine i in parameter k."""
    found = []
    for i in odd.numbers:
        order = np.argsort(-odd.share[i])
        likely = [k for k in order if odd.share[i, k] >= 0.05 * odd.probability[i]]
        text = " or ".join(f"{names[k]} ({words(i, k)}, {odd.share[i, k]:.2f})" for k in likely)
        found.append(f"{turbines[i]} is unlike the other turbines with probability {odd.probability[i]:.3f}: {text}; "
                     "the population is estimated from the others")
    return found
