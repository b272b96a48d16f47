"""How local errors of a model's stiffness and mass mix its modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from probupdate.model.interface import ModalSolution

# relative gap of two eigenvalues below which their modes mix no more: an error of some percent turns them into any two
LEAST_GAP = 0.05
# what a local error does to a frequency over what it does to neighbours' mixing: of waves along a member the mean of
# sin^4 is 3/8, of sin^2 sin^2 1/4; of stiffness and of mass
OWN_CHANGE = 0.5 * np.sqrt(3)


def signs_as_mixed(shape: np.ndarray) -> np.ndarray:
    """(n_mode,) that make the largest components of shapes (n_channel, n_mode) positive: of either sign as solved."""
    largest = np.take_along_axis(shape, np.argmax(np.abs(shape), axis=0)[None], axis=0)[0]
    return np.where(largest < 0, -1.0, 1.0)


def mix_modes(
    solution: ModalSolution, clusters: Sequence[tuple[int, ...]]
) -> tuple[tuple[tuple[int, int], ...], ModalSolution]:
    """Pairs of modes, the lower first, and the modes with their derivatives with respect to how a local error of
    stiffness couples two of them, or one with itself, which changes its frequency: one number a pair (n_pair) of which
    one at least is in `clusters`, scaled so that a relative error of one has a standard deviation of one. First-order
    perturbation: d phi_i = sum_j k_ij phi_j / (lambda_i - lambda_j) (Fox & Kapoor 1968).

    k_ij of an error that is independent from place to place scatters about zero by its size times f_i f_j, with mass in
    error too times f_i hypot(f_i, f_j): neighbours mix most. Modes nearer than their own error turn by no more than it.
    """
    own = {i: number for number, cluster in enumerate(clusters) for i in cluster}
    f, shape = solution.frequency_hz, solution.shape
    one_way = shape * signs_as_mixed(shape)
    pairs = tuple((i, j) for i in range(len(f)) for j in range(i, len(f))
                  if (i in own or j in own) and (i == j or own.get(i, -1) != own.get(j, -2)))
    change, own_change = np.zeros((*shape.shape, len(pairs))), np.zeros((len(f), len(pairs)))
    for k, (i, j) in enumerate(pairs):
        if i == j:
            own_change[i, k] = OWN_CHANGE * f[i]
            continue
        gap = f[i] ** 2 - f[j] ** 2
        rate = np.hypot(f[i], f[j]) / np.copysign(np.hypot(gap, LEAST_GAP * f[i] * f[j]), gap)
        change[:, i, k], change[:, j, k] = f[i] * rate * one_way[:, j], -f[j] * rate * one_way[:, i]
    return pairs, replace(solution, shape=one_way, frequency_derivative=own_change, shape_derivative=change)
