"""What a fitted model says of blocks that took no part in its fit.

The unknowns of a design (parameters, tolerances, sizes of effects: c) are estimated from the training blocks alone.
What no model explains, the offset of each response and the model error of signatures, is not carried over: a report
uses the model, not its residuals. So the prediction is X E[c | training] with the offsets at zero, and what is measured
differs from it by N(0, X Q X^T + R): Q is the covariance of (c - E[c | training], offset), exact under the design's own
assumptions, R the noise. Everything is linear about a fit to all blocks, whose choice is of second order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, special

from probupdate.diagnosis.linear import Design
from probupdate.runtime.arrays import frozen_array


@dataclass(frozen=True, eq=False, kw_only=True)
class Prediction:
    """Of the held-out blocks `rows` (n_held,): per group residual (n_held, n_response), measured less predicted, zero
    where not measured; std (n_held, n_response) of its prediction; weight (n_held,), zero where not measured.

    log_density of all of them together, `squared` their squared distance, of n_number numbers; `uncertain` (n_common,
    n_common) is Q of the unknowns that are carried.
    """

    rows: np.ndarray
    residual: tuple[np.ndarray, ...]
    std: tuple[np.ndarray, ...]
    weight: tuple[np.ndarray, ...]
    log_density: float
    squared: float
    n_number: int
    uncertain: np.ndarray


def carried_unknowns(
    design: Design, centred: Sequence[np.ndarray], blocks: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What `blocks` show other blocks of the unknowns: mean (n_unknown,), and covariance Q (n_unknown, n_unknown) of
    how the unknowns differ from it. Offsets and model errors of signatures are not carried: their mean is zero."""
    there, n = design.select_blocks(blocks), design.n_common
    mean, Q = there.unknowns([y[blocks] for y in centred]), there.unknowns_cov(range(design.n_unknown))
    mean[n:] = 0.0
    Q[n:, n:] = np.diag(design.prior_std[n:] ** 2)
    return mean, Q


def predict(design: Design, centred: Sequence[np.ndarray], held: np.ndarray) -> Prediction:
    """Predict the blocks where `held` (n_block,) bool from all others; `centred` residuals per group (n_block,
    n_response) of the fit to all."""
    rows = np.flatnonzero(held)
    mean, Q = carried_unknowns(design, centred, np.flatnonzero(~held))
    there, root = design.select_blocks(rows), covariance_root(Q, design.prior_std)
    weight = there.noise.weight
    residual = tuple(np.where(w[:, None] > 0, y[rows] - m, 0.0)
                     for y, m, w in zip(centred, there.expected_residuals(mean), weight, strict=True))
    shares, squares = log_density(there, residual, [(np.arange(len(rows)), root)])
    numbers = sum(int(np.sum(w > 0)) * r.shape[1] for w, r in zip(weight, residual, strict=True))
    return Prediction(
        rows=frozen_array(rows, int), residual=tuple(map(frozen_array, residual)),
        std=tuple(map(frozen_array, _prediction_std(there, root))), weight=tuple(map(frozen_array, weight)),
        log_density=float(shares.sum()), squared=squares, n_number=numbers,
        uncertain=frozen_array(Q[: design.n_common, : design.n_common]),
    )


# what is not known in some blocks (their numbers): a root (n, rank) of the covariance of the first n unknowns
UnknownPart = tuple[np.ndarray, np.ndarray]


def log_density(
    design: Design, residual: Sequence[np.ndarray], parts: Sequence[UnknownPart]
) -> tuple[np.ndarray, float]:
    """Joint log density of residuals, N(0, C) as in `solve_covariance`, as shares (n_block,) that add up to it, and
    their squared distance."""
    found, weight = solve_covariance(design, residual, parts), design.noise.weight
    numbers = np.sum([(w > 0) * r.shape[1] for w, r in zip(weight, residual, strict=True)], axis=0)
    density = -0.5 * (found.shares + numbers * np.log(2 * np.pi))
    for w, covariance in zip(weight, design.noise.covariance, strict=True):
        measured = w > 0
        log_noise = np.linalg.slogdet(covariance)[1] - len(covariance) * np.log(np.where(measured, w, 1.0))
        density -= 0.5 * np.where(measured, log_noise, 0.0)
    return density - 0.5 * found.log_determinant * numbers / max(numbers.sum(), 1), float(found.shares.sum())


@dataclass(frozen=True, eq=False, kw_only=True)
class SolvedResiduals:
    """C^-1 y per group (n_block, n_response); shares (n_block,) that add up to y^T C^-1 y: of each block what the
    unknowns' best values leave, and evenly what these values cost; logarithm of what the unknowns multiply the noise's
    determinant with."""

    solved: list[np.ndarray]
    shares: np.ndarray
    log_determinant: float


def solve_covariance(
    design: Design, y: Sequence[np.ndarray], parts: Sequence[UnknownPart]
) -> SolvedResiduals:
    """With C = X Q X^T + R, Q of the root of the first of these `parts`, which is of all blocks, and in the blocks of
    every other one its X Q_part X^T besides."""
    n_block, root = len(design.bin_of), parts[0][1]
    there = [design.select_blocks(places) for places, _ in parts]
    ends = np.cumsum([0, *(part.shape[1] for _, part in parts)])
    # by columns, so that it is factorised in its place: of all folds together it is larger than all else
    inner, right = np.eye(ends[-1], order="F"), np.empty(ends[-1])
    for k, ((places, part), of_part) in enumerate(zip(parts, there, strict=True)):
        here, n, G = slice(ends[k], ends[k + 1]), len(part), of_part.unknowns_information
        inner[here, here] += part.T @ G[:n, :n] @ part
        if k:
            inner[: ends[1], here] = root.T @ G[:, :n] @ part
            inner[here, : ends[1]] = inner[: ends[1], here].T
        right[here] = part.T @ of_part.unknowns_scores([v[places] for v in y])[:n]
    factor = linalg.cho_factor(inner, lower=True, overwrite_a=True)
    del inner
    solution = linalg.cho_solve(factor, right)
    moved = [np.zeros_like(v) for v in y]
    for k, ((places, part), of_part) in enumerate(zip(parts, there, strict=True)):
        unknowns = np.zeros(design.n_unknown)
        unknowns[: len(part)] = part @ solution[ends[k] : ends[k + 1]]
        for m, made in zip(moved, of_part.expected_residuals(unknowns), strict=True):
            m[places] += made
    solved, shares, common, numbers = [], np.zeros(n_block), 0.0, np.zeros(n_block)
    for r, m, weight, precision in zip(y, moved, design.noise.weight, design.noise.precision, strict=True):
        solved.append(weight[:, None] * ((r - m) @ precision))
        shares += np.sum((r - m) * solved[-1], axis=1)
        common += float(np.sum(m * solved[-1]))
        numbers += (weight > 0) * r.shape[1]
    return SolvedResiduals(solved=solved, shares=shares + common * numbers / max(numbers.sum(), 1.0),
                           log_determinant=float(2 * np.sum(np.log(np.diag(factor[0])))))


def sum_over_blocks(design: Design, y: Sequence[np.ndarray]) -> np.ndarray:
    """X^T y (n_unknown,) of y per group (n_block, n_response)."""
    alike = replace(design.noise, precision=tuple(np.eye(v.shape[1]) for v in y),
                    weight=tuple(np.ones(len(v)) for v in y))
    return replace(design, noise=alike).unknowns_scores(y)


def covariance_root(Q: np.ndarray, size: np.ndarray) -> np.ndarray:
    """L (n, rank) with L L^T = Q, by eigenvalues in units of `size`."""
    scaled = Q / np.outer(size, size)
    # numpy's divide and conquer does not always converge where some unknowns are as free as before
    value, turn = linalg.eigh(0.5 * (scaled + scaled.T))
    # rounding of numbers of one
    kept = value > 1e-12
    return size[:, None] * turn[:, kept] * np.sqrt(value[kept])


def _prediction_std(design: Design, root: np.ndarray) -> list[np.ndarray]:
    """Standard deviation (n_block, n_response) of every predicted number by itself, per group, with unknowns of this
    root of their covariance; infinite where not measured."""
    # blocks of one angle in which all time profiles are the same are predicted alike: constants and steps have one or
    # two values
    profiles = [*(profile for _, profile, _ in design.included), *(profile for profile, _ in design.model_errors)]
    levels = np.column_stack([design.bin_of, *(profile.value for profile in profiles)])
    _, first, place = np.unique(levels, axis=0, return_index=True, return_inverse=True)
    each = [[np.sum(made**2, axis=0) for made in design.select_blocks(np.array([k])).expected_residuals(root.T)]
            for k in first]
    result = []
    for of_group, covariance, weight in zip(zip(*each, strict=True), design.noise.covariance, design.noise.weight,
                                            strict=True):
        own = np.where(weight > 0, 1 / np.where(weight > 0, weight, 1.0), np.inf)[:, None] * np.diag(covariance)
        result.append(np.sqrt(own + np.concatenate(of_group)[place.ravel()]))
    return result


def crps(residual: np.ndarray, std: np.ndarray) -> np.ndarray:
    """Continuous ranked probability score of normal predictions, in the response's units, less is better (Gneiting &
    Raftery 2007, eq. 21)."""
    z = residual / std
    density = np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi)
    return std * (z * (2 * special.ndtr(z) - 1) + 2 * density - 1 / np.sqrt(np.pi))
