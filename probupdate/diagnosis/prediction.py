"""What a fitted model says of blocks that took no part in its fit.

The unknowns of a design (parameters, tolerances, sizes of effects: c) are estimated from the training blocks alone.
What no model explains, the offset of each response and the model error of signatures, is not carried over: a report
uses the model, not its residuals. So the prediction is X E[c | training] with the offsets at zero, and what is measured
differs from it by N(0, X Q X^T + R): Q is the covariance of (c - E[c | training], offset), exact under the design's own
assumptions, R the noise. Everything is linear about a fit to all blocks, whose choice is of second order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg, special

from probupdate.diagnosis.linear import Design
from probupdate.runtime.arrays import frozen_array


@dataclass(frozen=True, eq=False, kw_only=True)
class Prediction:
    """Of the held-out blocks `rows` (n_held,): per group residual (n_held, n_response), measured less predicted, zero
    where not measured; std (n_held, n_response) of its prediction; weight (n_held,), zero where not measured.

    log_density of all of them together, `squared` their squared distance, of n_number numbers; `uncertain` (n_common,
    n_common) is Q of the unknowns that are carried; mean (n_unknown,) what predicts.
    """

    rows: np.ndarray
    residual: tuple[np.ndarray, ...]
    std: tuple[np.ndarray, ...]
    weight: tuple[np.ndarray, ...]
    log_density: float
    squared: float
    n_number: int
    uncertain: np.ndarray
    mean: np.ndarray


def columns(design: Design, q: int, g: int) -> tuple[np.ndarray, np.ndarray]:
    """Of group q at angle bin g: X (n_response, n) of the unknowns that act there and their numbers (n,);
    `profile_factors` shows what the columns are multiplied with in a block."""
    m, n_all = design.discrepancy_std[q].size, design.n_common
    start, total = n_all + sum(f.size for f in design.discrepancy_std[:q]), sum(f.size for f in design.discrepancy_std)
    known = design.effect[q][g][:, [effect for effect, _, _ in design.included]]
    offsets = np.zeros((m, m))
    for part, made in design.offsets_made(q):
        offsets[:, part] += np.diag(made[g]) if made.ndim == 2 else made[g]
    parts, numbers = [design.nuisance[q][g], known, offsets], [np.arange(n_all), np.arange(start, start + m)]
    for k, (_, spread) in enumerate(design.model_errors):
        parts.append(np.diag(spread[q][g]))
        numbers.append(np.arange(start, start + m) + (k + 1) * total)
    return np.concatenate(parts, axis=1), np.concatenate(numbers)


def profile_factors(design: Design, q: int, blocks: np.ndarray) -> np.ndarray:
    """(n_block, n) what the columns of group q are multiplied with in each of `blocks`: the time profile of effects."""
    m = design.discrepancy_std[q].size
    factors = np.ones((len(blocks), design.n_common + (1 + len(design.model_errors)) * m))
    for k, (_, time_profile, _) in enumerate(design.included):
        factors[:, design.nuisance_std.size + k] = time_profile.value[blocks]
    for k, (time_profile, _) in enumerate(design.model_errors):
        start = design.n_common + (k + 1) * m
        factors[:, start : start + m] = time_profile.value[blocks, None]
    return factors


def gram(design: Design, blocks: np.ndarray) -> np.ndarray:
    """X^T R^-1 X (n_unknown, n_unknown) of `blocks` (their numbers)."""
    total = np.zeros((design.n_unknown, design.n_unknown))
    for q in range(len(design.discrepancy_std)):
        weight = design.noise.weight[q][blocks]
        for g in np.unique(design.bin_of[blocks]):
            there = blocks[(design.bin_of[blocks] == g) & (weight > 0)]
            if len(there):
                X, numbers = columns(design, q, g)
                t = profile_factors(design, q, there)
                total[np.ix_(numbers, numbers)] += (X.T @ design.noise.precision[q] @ X) * (
                    t.T @ (t * design.noise.weight[q][there, None]))
    return total


def cross(design: Design, blocks: np.ndarray, y: Sequence[np.ndarray], *, weighted: bool = True) -> np.ndarray:
    """X^T R^-1 y (n_unknown,) of `blocks`, y per group (len(blocks), n_response); not `weighted`: X^T y."""
    total = np.zeros(design.n_unknown)
    for q in range(len(design.discrepancy_std)):
        weight = design.noise.weight[q][blocks]
        P = design.noise.precision[q] if weighted else np.eye(design.discrepancy_std[q].size)
        scale = weight if weighted else (weight > 0).astype(float)
        for g in np.unique(design.bin_of[blocks]):
            there = np.flatnonzero((design.bin_of[blocks] == g) & (weight > 0))
            if len(there):
                X, numbers = columns(design, q, g)
                t = profile_factors(design, q, blocks[there])
                part = (y[q][there] * scale[there, None]) @ (P @ X)
                total[numbers] += np.sum(part * t, axis=0)
    return total


def predict_groups(design: Design, blocks: np.ndarray, unknowns: np.ndarray) -> list[np.ndarray]:
    """X u per group (len(blocks), n_response)."""
    return [y[blocks] for y in design.expected(unknowns)]


def transient(design: Design) -> np.ndarray:
    """(n_unknown,) bool: offsets and model errors of signatures, not carried from training to prediction."""
    return np.arange(design.n_unknown) >= design.n_common


def posterior(
    design: Design, centred: Sequence[np.ndarray], blocks: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean (n_unknown,) and covariance (n_unknown, n_unknown) of the unknowns as `blocks` show them."""
    prior = design.prior_std
    # in units of the prior's standard deviations, as these are many powers of ten apart
    information = gram(design, blocks)
    information *= np.outer(prior, prior)
    information[np.diag_indices_from(information)] += 1.0
    factor = linalg.cho_factor(information, lower=True, overwrite_a=True)
    del information
    mean = prior * linalg.cho_solve(factor, prior * cross(design, blocks, [y[blocks] for y in centred]))
    covariance = linalg.cho_solve(factor, np.eye(design.n_unknown), overwrite_b=True)
    del factor
    covariance *= np.outer(prior, prior)
    return mean, covariance


def carried_unknowns(
    design: Design, centred: Sequence[np.ndarray], blocks: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What `blocks` show other blocks of the unknowns: mean, zero of what is `transient`, and covariance Q of how the
    unknowns differ from it."""
    mean, Q = posterior(design, centred, blocks)
    left = transient(design)
    mean[left] = 0.0
    Q[np.ix_(left, left)] = np.diag(design.prior_std[left] ** 2)
    return mean, Q


def predict(design: Design, centred: Sequence[np.ndarray], held: np.ndarray) -> Prediction:
    """Predict the blocks where `held` (n_block,) bool from all others; `centred` residuals per group (n_block,
    n_response) of the fit to all."""
    rows = np.flatnonzero(held)
    mean, Q = carried_unknowns(design, centred, np.flatnonzero(~held))

    weight = tuple(w[rows] for w in design.noise.weight)
    expected = predict_groups(design, rows, mean)
    residual = tuple(np.where(w[:, None] > 0, y[rows] - m, 0.0)
                     for y, m, w in zip(centred, expected, weight, strict=True))
    shares, squares = log_density(design, rows, Q, residual)
    numbers = sum(int(np.sum(w > 0)) * r.shape[1] for w, r in zip(weight, residual, strict=True))
    return Prediction(
        rows=frozen_array(rows, int), residual=tuple(map(frozen_array, residual)),
        std=tuple(map(frozen_array, _prediction_std(design, rows, Q))), weight=tuple(map(frozen_array, weight)),
        log_density=float(shares.sum()), squared=squares, n_number=numbers,
        uncertain=frozen_array(Q[: design.n_common, : design.n_common]),
        mean=frozen_array(mean),
    )


def log_density(
    design: Design, rows: np.ndarray, Q: np.ndarray, residual: Sequence[np.ndarray], own: Sequence[Own] = ()
) -> tuple[np.ndarray, float]:
    """Joint log density of the residuals of blocks `rows`, N(0, C) as in `solve_covariance`, as shares (len(rows),)
    that add up to it, and their squared distance."""
    found = solve_covariance(design, rows, Q, residual, own)
    weight = [w[rows] for w in design.noise.weight]
    numbers = sum(((w > 0) * r.shape[1] for w, r in zip(weight, residual, strict=True)), np.zeros(len(rows), int))
    density = -0.5 * (found.shares + numbers * np.log(2 * np.pi))
    for w, covariance in zip(weight, design.noise.covariance, strict=True):
        measured = w > 0
        log_noise = np.linalg.slogdet(covariance)[1] - len(covariance) * np.log(np.where(measured, w, 1.0))
        density -= 0.5 * np.where(measured, log_noise, 0.0)
    return density - 0.5 * found.log_determinant * numbers / max(numbers.sum(), 1), float(found.shares.sum())


# what differs in a fold alone: places of its blocks among the rows, covariance (n, n) there of the first n unknowns,
# those that all groups share
Own = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False, kw_only=True)
class SolvedResiduals:
    """C^-1 y per group (len(rows), n_response); shares (len(rows),) that add up to y^T C^-1 y: of each block what the
    unknowns' best values leave, and evenly what these values cost; logarithm of what the unknowns multiply the noise's
    determinant with."""

    solved: list[np.ndarray]
    shares: np.ndarray
    log_determinant: float


def solve_covariance(
    design: Design, rows: np.ndarray, Q: np.ndarray, y: Sequence[np.ndarray], own: Sequence[Own] = ()
) -> SolvedResiduals:
    """With C = X Q X^T + R, and in the blocks of every fold of `own` its X Q_own X^T besides."""
    everywhere = (np.arange(len(rows)), covariance_root(Q, design.prior_std))
    parts = [everywhere, *((places, covariance_root(covariance, design.prior_std[: len(covariance)]))
                           for places, covariance in own)]
    ends = np.cumsum([0, *(root.shape[1] for _, root in parts)])
    # by columns, so that it is factorised in its place: of all folds together it is larger than all else
    inner, right = np.eye(ends[-1], order="F"), np.empty(ends[-1])
    for k, (places, root) in enumerate(parts):
        here, n, G = slice(ends[k], ends[k + 1]), len(root), gram(design, rows[places])
        inner[here, here] += root.T @ G[:n, :n] @ root
        if k:
            inner[: ends[1], here] = everywhere[1].T @ G[:, :n] @ root
            inner[here, : ends[1]] = inner[: ends[1], here].T
        right[here] = root.T @ cross(design, rows[places], [v[places] for v in y])[:n]
    factor = linalg.cho_factor(inner, lower=True, overwrite_a=True)
    del inner
    solution = linalg.cho_solve(factor, right)
    moved = [np.zeros_like(v) for v in y]
    for k, (places, root) in enumerate(parts):
        unknowns = np.zeros(design.n_unknown)
        unknowns[: len(root)] = root @ solution[ends[k] : ends[k + 1]]
        for m, made in zip(moved, predict_groups(design, rows[places], unknowns), strict=True):
            m[places] += made
    solved, shares, common, numbers = [], np.zeros(len(rows)), 0.0, np.zeros(len(rows))
    for q, (r, m) in enumerate(zip(y, moved, strict=True)):
        w = design.noise.weight[q][rows][:, None]
        solved.append(w * ((r - m) @ design.noise.precision[q]))
        shares += np.sum((r - m) * solved[-1], axis=1)
        common += float(np.sum(m * solved[-1]))
        numbers += (w[:, 0] > 0) * r.shape[1]
    return SolvedResiduals(solved=solved, shares=shares + common * numbers / max(numbers.sum(), 1.0),
                           log_determinant=float(2 * np.sum(np.log(np.diag(factor[0])))))


def covariance_root(Q: np.ndarray, size: np.ndarray) -> np.ndarray:
    """L (n, rank) with L L^T = Q, by eigenvalues in units of `size`."""
    scaled = Q / np.outer(size, size)
    # numpy's divide and conquer does not always converge where some unknowns are as free as before
    value, turn = linalg.eigh(0.5 * (scaled + scaled.T))
    # rounding of numbers of one
    kept = value > 1e-12
    return size[:, None] * turn[:, kept] * np.sqrt(value[kept])


def _prediction_std(design: Design, rows: np.ndarray, Q: np.ndarray) -> list[np.ndarray]:
    """Standard deviation (n_held, n_response) of every predicted number by itself, per group; infinite where not
    measured."""
    result = []
    for q, covariance in enumerate(design.noise.covariance):
        w = design.noise.weight[q][rows]
        variance = np.where(w > 0, 1 / np.where(w > 0, w, 1.0), np.inf)[:, None] * np.diag(covariance)
        for g in np.unique(design.bin_of[rows]):
            there = np.flatnonzero(design.bin_of[rows] == g)
            X, numbers = columns(design, q, g)
            t = profile_factors(design, q, rows[there])
            own = Q[np.ix_(numbers, numbers)]
            # few different time profiles: constants and steps have one or two
            found, place = np.unique(t, axis=0, return_inverse=True)
            spread = np.array([np.sum(((X * f) @ own) * (X * f), axis=1) for f in found])
            variance[there] += spread[place.ravel()]
        result.append(np.sqrt(variance))
    return result


def crps(residual: np.ndarray, std: np.ndarray) -> np.ndarray:
    """Continuous ranked probability score of normal predictions, in the response's units, less is better (Gneiting &
    Raftery 2007, eq. 21)."""
    z = residual / std
    density = np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi)
    return std * (z * (2 * special.ndtr(z) - 1) + 2 * density - 1 / np.sqrt(np.pi))
