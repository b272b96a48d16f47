"""Evidence that what channels see lies in the subspace that a reference lets it: a rigid body's motions, a model's
shape, the shape that other setups saw.

A shape's size means nothing, so its direction is compared. That of a Gaussian vector of unit variance along the
subspace (r of n dimensions) and variance s^2 across it has the angular central Gaussian density (Tyler 1987), up to a
constant

    s^-(n - r) (1 - x + x / s^2)^(-n/2)

with x the share of the squared direction outside the subspace: tails are heavy, and s = 1 is a reference that says
nothing. The error s is common to what is compared, unknown, and averaged over a grid, as probable by the decade.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import logsumexp, softmax

# errors of a reference (standard deviation across the subspace over that along it), each as probable before: from
# calibrations and flexibility of a hundredth to a reference that is none
ERRORS = np.geomspace(0.01, 1.0, 9)
# what may be wrong is named with this probability, and what has so much of the most probable's is said beside it
CERTAIN, AS_WELL = 0.95, 0.05


def log_evidence(
    outside: np.ndarray, n: np.ndarray, r: np.ndarray, *, size: np.ndarray | float = 1.0,
    count: np.ndarray | float = 1.0, noise: np.ndarray | float = 0.0,
) -> np.ndarray:
    """(...) ln density, up to a constant, of directions (..., n_sample) in n (n_sample,) dimensions beside subspaces of
    r; `outside` their squared part outside and `size` their squared size (1: directions as they are; otherwise those of
    vectors that a hypothesis changed), `count` for how many independent ones each counts, `noise` the standard
    deviation across the subspace that is known of each."""
    variance = ERRORS[:, None] ** 2 + np.square(noise)
    outside = np.asarray(outside)[..., None, :]
    size = np.asarray(size)[..., None, :] if np.ndim(size) else size
    log = -0.5 * (n - r) * np.log(variance) - 0.5 * n * np.log(size - outside + outside / variance)
    return logsumexp(np.sum(count * log, axis=-1), axis=-1) - np.log(len(ERRORS))


def choose_explanations(log: Sequence[float], names: Sequence[bool]) -> list[int]:
    """Which of some explanations (ln of probabilities up to a constant) are named, the most probable first: those that
    are `names` of a fault, among which it lies as good as certainly; empty where it does not."""
    share = softmax(np.asarray(log, float)) * np.asarray(names)
    if share.sum() < CERTAIN:
        return []
    return [int(k) for k in np.argsort(-share) if share[k] > AS_WELL * share.max()]
