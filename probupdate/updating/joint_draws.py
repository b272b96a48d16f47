"""Draws of a farm's joint posterior: of the linear-Gaussian system exactly, and what they are with their weights once
`joint_nonlinear` has moved them to the true models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from probupdate.runtime.arrays import frozen_array
from probupdate.updating.joint_scales import ScaleChain, Scales
from probupdate.updating.joint_system import FarmSystem
from probupdate.updating.weight_smoothing import smoothed_weights

# draws; so many at a time
N_DRAW, CHUNK = 400, 50
# ln weights that differ by less are alike: the posterior is the linear one
ALIKE = 1e-4


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

    def weigh(self) -> tuple[np.ndarray, float]:
        """Normalised weights (n,), smoothed, and Pareto k; -inf where all weights are alike."""
        if not np.isfinite(self.log_weight).any():
            return np.full(len(self.z), 1 / len(self.z)), np.inf
        if np.ptp(self.log_weight) < ALIKE:
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
class LinearDraws:
    """Of the linear-Gaussian posterior, about the system's middle: z (n, n_z), e (n, n_e), d (n, n_turbine, n_param);
    tau (n, n_varying) and std (n, n_e) a priori, of which each is."""

    z: np.ndarray
    e: np.ndarray
    d: np.ndarray
    tau: np.ndarray
    std: np.ndarray

    def some(self, rows: slice) -> LinearDraws:
        return LinearDraws(**{name: value[rows] for name, value in vars(self).items()})


def draw_linear(
    system: FarmSystem, scales: Scales, chain: ScaleChain, *, n: int = N_DRAW, seed: int = 1
) -> LinearDraws:
    """n draws, exactly."""
    rng, parts = np.random.default_rng([seed, 37]), []
    for some in np.array_split(chain.thin(n), max(1, n // CHUNK)):
        tau, std = scales.tau(some), system.common_std(scales.shared(some, system))
        z, e, d = system.draw(tau, std, rng)
        parts.append((z, e, d, tau, std))
    return LinearDraws(**{name: np.concatenate([part[k] for part in parts])
                          for k, name in enumerate(("z", "e", "d", "tau", "std"))})
