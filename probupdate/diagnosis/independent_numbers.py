"""Numbers of one record that scatter nearly independently.

Temperature, mass and clocks move all frequencies at once. Judged one by one, a change of a tenth of that common scatter
is lost in it; of their differences it may be thirty standard deviations. The first number is their mean, weighted so
that it scatters independently of what is the same for all; the others are contrasts, which one share of all does not
move. Of shapes they are the eigenvectors, within each group of modes, of the covariance of real and of imaginary parts:
what ties frequencies to shapes is left out, as a real change moves both in a proportion that noise does not have.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from probupdate.diagnosis.noise import MOST_FACTORINGS, SMALLEST_LOG, SMALLEST_SHAPE, Noise, typical_differences
from probupdate.runtime.arrays import frozen_array

# groups of modes that are found in fewer of the blocks stay by themselves
COMMON = 0.7
# differences of successive blocks asked for, for each frequency of a joint covariance: with fewer its least eigenvalue
# may be a third of what it estimates (Marchenko & Pastur 1967: (1 - sqrt(1 / 6))^2 = 0.35)
DIFFERENCES_A_FREQUENCY = 6


@dataclass(frozen=True, eq=False, kw_only=True)
class Directions:
    """turn (n_number, n_response): the numbers of the responses of all groups in a row, and `back`, its inverse; weight
    (n_block, n_number) of each number, relative to its median, zero where it was not measured; least (n_number,)
    variance that none is believed to repeat better than; group_of (n_response,); `frequency`, `real` and `imaginary`
    parts: the numbers of ln f, their mean first, and of each group those of its shapes. joint: responses of ln f of
    which a block may lack some, `covariance` theirs; used (n_group, n_block)."""

    turn: np.ndarray
    back: np.ndarray
    weight: np.ndarray
    least: np.ndarray
    group_of: np.ndarray
    frequency: np.ndarray
    real: tuple[np.ndarray, ...]
    imaginary: tuple[np.ndarray, ...]
    joint: np.ndarray
    covariance: np.ndarray
    used: np.ndarray

    def project(self, rest: Sequence[np.ndarray]) -> np.ndarray:
        """(n_block, n_number) of residuals per group (n_block, n_response)."""
        responses = np.hstack(rest)
        responses[:, self.joint] = fill_missing(responses[:, self.joint], self.used[self.group_of[self.joint]].T,
                                          self.covariance)[0]
        return np.where(self.weight > 0, responses @ self.turn.T, 0.0)

    def where(self, used: Sequence[np.ndarray]) -> Directions:
        """Of only the blocks in which all groups of a number are `used` (n_block,), of joint ones enough of them."""
        there = np.array(used)[self.group_of].T
        there[:, self.joint] |= _has_enough(there[:, self.joint])[:, None]
        missing = (~there).astype(float) @ (np.abs(self.turn.T) > 0)
        return replace(self, used=frozen_array(used, bool),
                       weight=frozen_array(np.where(missing > 0, 0.0, self.weight)))


def independent_directions(rest: Sequence[np.ndarray], noise: Noise, sizes: Sequence[int]) -> Directions:
    """Of residuals `rest` per group (n_block, n_response); `noise`: weights of blocks and covariance within a group.
    sizes: modes of each group."""
    n_log = [1 if k == 1 else 3 for k in sizes]
    lengths = [y.shape[1] for y in rest]
    start = np.concatenate([[0], np.cumsum(lengths)])
    turn, number = np.zeros((start[-1], start[-1])), 0
    group_of = np.repeat(np.arange(len(sizes)), lengths)
    weight, least = np.zeros((len(rest[0]), start[-1])), np.zeros(start[-1])
    kinds: dict[str, list[np.ndarray]] = {"frequency": [], "real": [], "imaginary": []}

    def add(kind: str, columns: np.ndarray, own: np.ndarray, vectors: np.ndarray, of_blocks: np.ndarray) -> None:
        nonlocal number
        rows = np.arange(number, number + len(columns))
        turn[np.ix_(rows, columns)] = vectors
        weight[:, rows] = _weights(vectors, own, of_blocks)
        smallest = SMALLEST_LOG if kind == "frequency" else SMALLEST_SHAPE
        least[rows] = smallest**2 * np.sum(vectors**2, axis=1)
        kinds[kind].append(rows)
        number += len(columns)

    common = np.flatnonzero(np.mean(np.array(noise.weight) > 0, axis=1) >= COMMON)
    joint = np.concatenate([[], *(start[q] + np.arange(n_log[q]) for q in common)]).astype(int)
    of_group = np.array([noise.weight[q] for q in group_of[joint]]).reshape(-1, len(rest[0])).T
    levels, joint_weight = np.hstack(rest)[:, joint], _joint_weights(of_group)
    between = _covariance_of_incomplete(levels, of_group > 0)
    covariance = _scatter(fill_missing(levels, of_group > 0, between)[0], joint_weight,
                          linalg.block_diag(*(noise.covariance[q][: n_log[q], : n_log[q]] for q in common)))
    alone = [(start[q] + np.arange(n_log[q]), noise.covariance[q][: n_log[q], : n_log[q]],
              np.tile(noise.weight[q], (n_log[q], 1))) for q in range(len(sizes)) if q not in common]
    for columns, own, of_blocks in [(joint, covariance, joint_weight.T)] * bool(len(joint)) + alone:
        unit = np.concatenate([[1.0, 1.0, 0.0][: n_log[q]] for q in np.unique(group_of[columns])])
        add("frequency", columns, own, _mean_first(own, unit), of_blocks)
    for q, (own, n) in enumerate(zip(noise.covariance, n_log, strict=True)):
        middle = (lengths[q] + n) // 2
        for kind, part in (("real", slice(n, middle)), ("imaginary", slice(middle, None))):
            block = own[part, part]
            if len(block):
                add(kind, start[q] + np.arange(lengths[q])[part], block, np.linalg.eigh(block)[1].T,
                    np.tile(noise.weight[q], (len(block), 1)))
    return Directions(turn=frozen_array(turn), back=frozen_array(np.linalg.inv(turn)), weight=frozen_array(weight),
                      least=frozen_array(least), group_of=frozen_array(group_of, int),
                      frequency=np.concatenate(kinds["frequency"]), real=tuple(kinds["real"]),
                      imaginary=tuple(kinds["imaginary"]), joint=joint, covariance=frozen_array(between),
                      used=frozen_array(np.array(noise.weight) > 0, bool))


def _mean_first(covariance: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Rows (n, n): the mean that scatters least of those that one share of all, `unit` (n,), moves by one, then what
    scatters independently of it and of one another, the most first."""
    toward = np.linalg.solve(covariance, unit)
    contrasts = linalg.null_space(unit[None])
    vectors = np.linalg.eigh(contrasts.T @ covariance @ contrasts)[1].T[::-1]
    return np.vstack([toward / (unit @ toward), vectors @ contrasts.T])


def _weights(vectors: np.ndarray, covariance: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(n_block, n) one over the variance of each direction in each block, relative to the median, from weights (n,
    n_block) of the numbers; zero where one that takes part was not measured."""
    there = weight > 0
    std = 1 / np.sqrt(np.where(there, weight, 1.0))
    part = vectors[:, :, None] * std[None]
    variance = np.einsum("kib,ij,kjb->kb", part, covariance, part, optimize=True)
    complete = np.all(there, axis=0)
    if not complete.any():
        return np.zeros((weight.shape[1], len(vectors)))
    relative = np.median(variance[:, complete], axis=1, keepdims=True) / variance
    # what differs by rounding alone is one pattern
    return np.where(complete, np.round(relative, 9), 0.0).T


# Modes that a block lacks --------------------------------------------------------------------------------------------


def _has_enough(there: np.ndarray) -> np.ndarray:
    """(n_block,) whether a block has more than half of the joint numbers, there (n_block, n)."""
    return 2 * np.sum(there, axis=1) > there.shape[1]


def _joint_weights(weight: np.ndarray) -> np.ndarray:
    """Weights (n_block, n) of joint numbers; those that a block lacks have the mean of those it has, zero where it has
    too few."""
    there = weight > 0
    mean = np.sum(weight, axis=1) / np.maximum(np.sum(there, axis=1), 1)
    return np.where(_has_enough(there)[:, None], np.where(there, weight, mean[:, None]), 0.0)


def fill_missing(values: np.ndarray, there: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values (n_block, n) of mean zero with those not `there` as expected beside those that are, by their covariance,
    and the sum over blocks of the covariance (n, n) of what was filled. What all share is in the others; what is a
    mode's own stays zero, which makes its changes smaller, and its scatter by as much."""
    result, open_ = np.array(values), np.zeros_like(covariance)
    patterns, of_block = np.unique(there, axis=0, return_inverse=True)
    for k, known in enumerate(patterns):
        if known.all():
            continue
        rows = np.flatnonzero(of_block.ravel() == k)
        cross = covariance[np.ix_(~known, known)]
        onto = np.linalg.solve(covariance[np.ix_(known, known)], cross.T).T
        result[np.ix_(rows, ~known)] = values[np.ix_(rows, known)] @ onto.T
        open_[np.ix_(~known, ~known)] += len(rows) * (covariance[np.ix_(~known, ~known)] - onto @ cross.T)
    return result, open_


def _covariance_of_incomplete(values: np.ndarray, there: np.ndarray) -> np.ndarray:
    """(n, n) of numbers (n_block, n) of mean zero of which only those `there` are known: expectation and maximisation
    (Dempster, Laird & Rubin 1977)."""
    n = np.maximum(np.sum(there, axis=0), 1)
    least = SMALLEST_LOG**2 * np.eye(len(n))
    covariance = np.diag(np.sum(np.where(there, values, 0.0) ** 2, axis=0) / n) + least
    for _ in range(0 if there.all() else MOST_FACTORINGS):
        complete, open_ = fill_missing(values, there, covariance)
        before, covariance = covariance, (complete.T @ complete + open_) / max(len(values), 1) + least
        std = np.sqrt(np.diag(before))
        if np.allclose(covariance / std / std[:, None], before / std / std[:, None], rtol=0, atol=1e-3):
            break
    return covariance


def _scatter(values: np.ndarray, weight: np.ndarray, within: np.ndarray) -> np.ndarray:
    """Covariance (n, n) of joint numbers (n_block, n): by differences of successive blocks where these are enough,
    `within` each group otherwise."""
    rows = np.flatnonzero(np.all(weight > 0, axis=1))
    if len(rows) - 1 < DIFFERENCES_A_FREQUENCY * values.shape[1]:
        return within
    before, after = rows[:-1], rows[1:]
    difference = typical_differences((values[after] - values[before]) / np.sqrt(1 / weight[before] + 1 / weight[after]))
    return difference.T @ difference / len(difference) + SMALLEST_LOG**2 * np.eye(difference.shape[1])
