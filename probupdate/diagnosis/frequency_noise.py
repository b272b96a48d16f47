"""Frequencies of one record scatter together: temperature, mass and clocks move all of them at once.

Judged one by one, a change of a tenth of that common scatter is lost in it; of their differences it may be thirty
standard deviations. The directions in which the logarithms of the frequencies scatter independently of each other are
the eigenvectors of their joint covariance, which differences of successive blocks show.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from probupdate.diagnosis.noise import SMALLEST_LOG, Noise, usual
from probupdate.runtime.arrays import frozen_array

# groups of modes that are found in fewer of the blocks stay by themselves: blocks that lack one say nothing of the
# joint directions
COMMON = 0.7
# differences of successive blocks asked for, for each frequency of a joint covariance: with fewer its least eigenvalue
# may be a third of what it estimates (Marchenko & Pastur 1967: (1 - sqrt(1 / 6))^2 = 0.35)
DIFFERENCES_A_FREQUENCY = 6


@dataclass(frozen=True, eq=False, kw_only=True)
class FrequencyDirections:
    """covariance (n, n) of the logarithms of the frequencies of all groups (of a pair the three numbers of its tensor)
    in a block of weight one; turn (n, n) orthonormal rows, the directions that scatter independently; group_of (n,)
    which group of modes each number belongs to; `joint`: whether the blocks are enough to tell how groups scatter
    together, otherwise each is taken by itself."""

    covariance: np.ndarray
    turn: np.ndarray
    group_of: np.ndarray
    joint: bool

    def weight(self, group_weight: Sequence[np.ndarray]) -> np.ndarray:
        """(n, n_block) one over the variance of each direction in each block, zero where a group that takes part in it
        was not measured; group_weight per group (n_block,)."""
        relative = np.array([group_weight[q] for q in self.group_of])
        there = relative > 0
        std = 1 / np.sqrt(np.where(there, relative, 1.0))
        # (n_direction, n, n_block): what each number contributes
        part = self.turn[:, :, None] * std[None]
        variance = np.einsum("kib,ij,kjb->kb", part, self.covariance, part, optimize=True)
        complete = ~np.any((np.abs(self.turn) > 0)[:, :, None] & ~there[None], axis=1)
        return np.where(complete, 1 / np.maximum(variance, 1e-300), 0.0)

    def draw(self, rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
        """(*shape, n) numbers that scatter by this covariance."""
        value, vector = np.linalg.eigh(self.covariance)
        root = vector * np.sqrt(np.maximum(value, 0.0))
        return rng.standard_normal((*shape, len(value))) @ root.T


def frequency_directions(rest: Sequence[np.ndarray], noise: Noise, sizes: Sequence[int]) -> FrequencyDirections:
    """Of residuals `rest` per group (n_block, n_response), whose first number (of a pair: three) are of frequencies;
    `noise` tells the weights of blocks, and the covariance of a group that stays by itself. sizes: modes of each
    group."""
    n_log = [1 if k == 1 else 3 for k in sizes]
    group_of = np.repeat(np.arange(len(sizes)), n_log)
    covariance = np.zeros((len(group_of),) * 2)
    for q, (own, n) in enumerate(zip(noise.covariance, n_log, strict=True)):
        at = np.flatnonzero(group_of == q)
        covariance[np.ix_(at, at)] = own[:n, :n]
    weight = np.array(noise.weight)
    common = _common(weight)
    together = np.flatnonzero(np.isin(group_of, common))
    rows = np.flatnonzero(np.all(weight[common] > 0, axis=0))
    joint = len(common) > 1 and len(rows) - 1 >= DIFFERENCES_A_FREQUENCY * len(together)
    if joint:
        covariance[np.ix_(together, together)] = _of_differences(rest, weight, common, n_log, rows)
    turn = np.zeros_like(covariance)
    for members in [together, *(np.flatnonzero(group_of == q) for q in range(len(sizes)) if q not in common)]:
        if len(members):
            turn[np.ix_(members, members)] = np.linalg.eigh(covariance[np.ix_(members, members)])[1].T
    return FrequencyDirections(covariance=frozen_array(covariance), turn=frozen_array(turn),
                               group_of=frozen_array(group_of, int), joint=joint)


def _common(weight: np.ndarray) -> np.ndarray:
    """The groups found in most blocks; weight (n_group, n_block)."""
    return np.flatnonzero(np.mean(weight > 0, axis=1) >= COMMON)


def _of_differences(rest, weight, common, n_log, rows) -> np.ndarray:
    """Covariance of the common groups' numbers by differences of successive blocks of weight one."""
    before, after = rows[:-1], rows[1:]
    columns = [(rest[q][after, : n_log[q]] - rest[q][before, : n_log[q]])
               / np.sqrt(1 / weight[q][before] + 1 / weight[q][after])[:, None] for q in common]
    difference = usual(np.hstack(columns))
    return difference.T @ difference / len(difference) + SMALLEST_LOG**2 * np.eye(difference.shape[1])
