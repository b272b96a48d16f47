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

from probupdate.diagnosis.noise import SMALLEST_LOG, SMALLEST_SHAPE, Noise, usual
from probupdate.runtime.arrays import frozen_array

# groups of modes that are found in fewer of the blocks stay by themselves: blocks that lack one say nothing of the
# joint directions
COMMON = 0.7
# differences of successive blocks asked for, for each frequency of a joint covariance: with fewer its least eigenvalue
# may be a third of what it estimates (Marchenko & Pastur 1967: (1 - sqrt(1 / 6))^2 = 0.35)
DIFFERENCES_A_FREQUENCY = 6


@dataclass(frozen=True, eq=False, kw_only=True)
class Directions:
    """turn (n_number, n_response): the numbers of the responses of all groups in a row, and `back`, its inverse; weight
    (n_block, n_number) of each number, relative to its median, zero where it was not measured; least (n_number,)
    variance that none is believed to repeat better than; group_of (n_response,); `frequency`, `real` and `imaginary`
    parts: the numbers of ln f, their mean first, and of each group those of its shapes."""

    turn: np.ndarray
    back: np.ndarray
    weight: np.ndarray
    least: np.ndarray
    group_of: np.ndarray
    frequency: np.ndarray
    real: tuple[np.ndarray, ...]
    imaginary: tuple[np.ndarray, ...]

    def of(self, rest: Sequence[np.ndarray]) -> np.ndarray:
        """(n_block, n_number) of residuals per group (n_block, n_response)."""
        return np.where(self.weight > 0, np.hstack(rest) @ self.turn.T, 0.0)

    def where(self, used: Sequence[np.ndarray]) -> Directions:
        """Of only the blocks in which all groups of a number are `used` (n_block,)."""
        there = np.array(used)[self.group_of].T
        missing = (~there).astype(float) @ (np.abs(self.turn.T) > 0)
        return replace(self, weight=frozen_array(np.where(missing > 0, 0.0, self.weight)))


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

    def add(kind: str, columns: np.ndarray, own: np.ndarray, vectors: np.ndarray, groups: Sequence[int]) -> None:
        nonlocal number
        rows = np.arange(number, number + len(columns))
        turn[np.ix_(rows, columns)] = vectors
        weight[:, rows] = _weights(vectors, own, np.array([noise.weight[q] for q in groups]))
        smallest = SMALLEST_LOG if kind == "frequency" else SMALLEST_SHAPE
        least[rows] = smallest**2 * np.sum(vectors**2, axis=1)
        kinds[kind].append(rows)
        number += len(columns)

    common, covariance = _frequencies(rest, noise, n_log)
    for groups in [list(common), *([q] for q in range(len(sizes)) if q not in common)]:
        if groups:
            own = covariance if groups == list(common) else noise.covariance[groups[0]][: n_log[groups[0]],
                                                                                         : n_log[groups[0]]]
            add("frequency", np.concatenate([start[q] + np.arange(n_log[q]) for q in groups]), own,
                _mean_first(own, np.concatenate([[1.0, 1.0, 0.0][: n_log[q]] for q in groups])),
                [q for q in groups for _ in range(n_log[q])])
    for q, (own, n) in enumerate(zip(noise.covariance, n_log, strict=True)):
        middle = (lengths[q] + n) // 2
        for kind, part in (("real", slice(n, middle)), ("imaginary", slice(middle, None))):
            block = own[part, part]
            if len(block):
                add(kind, start[q] + np.arange(lengths[q])[part], block, np.linalg.eigh(block)[1].T, [q] * len(block))
    return Directions(turn=frozen_array(turn), back=frozen_array(np.linalg.inv(turn)), weight=frozen_array(weight),
                      least=frozen_array(least), group_of=frozen_array(group_of, int),
                      frequency=np.concatenate(kinds["frequency"]), real=tuple(kinds["real"]),
                      imaginary=tuple(kinds["imaginary"]))


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


def _frequencies(rest: Sequence[np.ndarray], noise: Noise, n_log: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Groups found in most blocks and the covariance of their numbers of frequencies: by differences of successive
    blocks of weight one where these are enough, within each group otherwise."""
    weight = np.array(noise.weight)
    common = np.flatnonzero(np.mean(weight > 0, axis=1) >= COMMON)
    rows = np.flatnonzero(np.all(weight[common] > 0, axis=0))
    if len(rows) - 1 < DIFFERENCES_A_FREQUENCY * sum(n_log[q] for q in common):
        return common, linalg.block_diag(*(noise.covariance[q][: n_log[q], : n_log[q]] for q in common))
    before, after = rows[:-1], rows[1:]
    columns = [(rest[q][after, : n_log[q]] - rest[q][before, : n_log[q]])
               / np.sqrt(1 / weight[q][before] + 1 / weight[q][after])[:, None] for q in common]
    difference = usual(np.hstack(columns))
    return common, difference.T @ difference / len(difference) + SMALLEST_LOG**2 * np.eye(difference.shape[1])
