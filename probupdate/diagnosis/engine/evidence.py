"""Evidence that numbers of a record move along time profiles, in closed form.

Each number x (n_block,) that scatters independently of the others is

    x_b = nuisance_b . coefficients + amount h_b + slow_b + noise_b / sqrt(v_b)

with flat coefficients, noise of an unknown variance s^2 (prior 1 / s^2) and a slow error (Ornstein-Uhlenbeck, of
variance rho s^2 / mean v). The ratio rho and the length of memory are averaged over a short grid, s^2 is integrated
out: Student's t (O'Hagan & Forster 2004, ch. 11), so that few blocks have heavy tails by themselves. Amounts are normal
with standard deviations of s sqrt(g), averaged over scales; what has one size in all numbers has it by its own prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from scipy.linalg import solveh_banded
from scipy.special import logsumexp

# variance of slow errors over that of a block, and their memory over the record's span, each as probable before;
# there are none as probably as there are
SLOW_RATIO, SLOW_LENGTH = (0.3, 3.0, 30.0), (1 / 3, 1 / 10, 1 / 30)
# standard deviations of amounts over that of a block, each as probable before
SCALES = (0.3, 1.5, 8.0, 40.0, 200.0)
# a profile that offset and turning explain to more than this is not distinguishable from them; blocks asked for beside
# what is fitted, and on either side of a step
REMAINING, SPARE, FEWEST_ASIDE = 0.05, 5, 3
ROUNDING = 1e-12


@dataclass(frozen=True, eq=False, kw_only=True)
class ProfileInformation:
    """What n_number numbers say of n_profile profiles, for each slow error of the grid: information `a` and score `b`
    (n_slow, n_number, n_profile), sum of squares `c` and ln density `null` (n_slow, n_number) where nothing moves,
    degrees of freedom (n_number,), usable (n_number, n_profile)."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    null: np.ndarray
    degrees: np.ndarray
    usable: np.ndarray

    @cached_property
    def log_nothing(self) -> np.ndarray:
        """(n_number,) ln density where nothing moves."""
        return logsumexp(self.null, axis=0)

    def log_moved(self) -> np.ndarray:
        """(n_scale, n_number, n_profile) ln Bayes factor of an amount of each scale, of each number by itself."""
        result = np.empty((len(SCALES), *self.usable.shape))
        for k, scale in enumerate(SCALES):
            spread = 1 + scale**2 * self.a
            left = np.maximum(1 - scale**2 * self.b**2 / spread / self.c[:, :, None], ROUNDING)
            own = self.null[:, :, None] - 0.5 * np.log(spread) - 0.5 * self.degrees[:, None] * np.log(left)
            result[k] = logsumexp(own, axis=0) - self.log_nothing[:, None]
        return np.where(self.usable, result, 0.0)

    @cached_property
    def amounts(self) -> tuple[np.ndarray, np.ndarray]:
        """(n_number, n_profile) amounts with flat priors and their variances, infinite where not usable."""
        a = np.where(self.usable, self.a, 1.0)
        left = np.maximum(self.c[:, :, None] - self.b**2 / a, ROUNDING * self.c[:, :, None])
        own = self.null[:, :, None] - 0.5 * np.log(a)
        own = own - 0.5 * self.degrees[:, None] * np.log(left / self.c[:, :, None])
        share = np.exp(own - logsumexp(own, axis=0))
        each = self.b / a
        mean = np.sum(share * each, axis=0)
        spare = np.maximum(self.degrees - 1, 1)[:, None]
        variance = np.sum(share * (left / a / spare + (each - mean) ** 2), axis=0)
        return np.where(self.usable, mean, 0.0), np.where(self.usable, variance, np.inf)

    def log_of_size(self, signature: np.ndarray, profile: int, size: float) -> float:
        """ln Bayes factor of amounts size * signature (n_number,) along one profile."""
        amount = np.where(self.usable[:, profile], size * signature, 0.0)
        left = 1 + (amount**2 * self.a[:, :, profile] - 2 * amount * self.b[:, :, profile]) / self.c
        own = self.null - 0.5 * self.degrees * np.log(np.maximum(left, 1e-300))
        return float(np.sum(logsumexp(own, axis=0) - self.log_nothing))


def profile_information(
    numbers: np.ndarray, weight: np.ndarray, least: np.ndarray, hours: np.ndarray, nuisance: np.ndarray,
    profiles: np.ndarray,
) -> ProfileInformation:
    """numbers (n_block, n_number) with weight (n_block, n_number), zero where not measured, and `least` variance
    (n_number,) below which none is believed to repeat; hours (n_block,); nuisance (n_block, n_nuisance), the offset
    first; profiles (n_profile, n_block)."""
    patterns, of_number = np.unique(weight.T, axis=0, return_inverse=True)
    parts = [np.flatnonzero(of_number.ravel() == k) for k in range(len(patterns))]
    found = [_equal_weight_information(numbers[:, own], v, least[own], hours, nuisance, profiles)
             for own, v in zip(parts, patterns, strict=True)]
    return _join_information(found, np.argsort(np.concatenate(parts)))


def sequential_information(
    numbers: np.ndarray, weight: np.ndarray, least: np.ndarray, hours: np.ndarray, nuisance: np.ndarray,
    profiles: np.ndarray,
) -> ProfileInformation:
    """The same where each number is explained by those before it too, with flat coefficients: the densities of all
    multiply to that of numbers that scatter and drift together, whatever their covariance."""
    found = [_equal_weight_information(numbers[:, [k]], weight[:, k], least[[k]], hours,
                                       np.hstack([nuisance, numbers[:, :k] / np.sqrt(least[:k])]), profiles)
             for k in range(numbers.shape[1])]
    return _join_information(found, np.arange(numbers.shape[1]))


def _join_information(parts: Sequence[ProfileInformation], order: np.ndarray) -> ProfileInformation:
    def join(name: str, axis: int) -> np.ndarray:
        return np.take(np.concatenate([getattr(p, name) for p in parts], axis=axis), order, axis=axis)

    return ProfileInformation(a=join("a", 1), b=join("b", 1), c=join("c", 1), null=join("null", 1),
                              degrees=join("degrees", 0), usable=join("usable", 0))


def _equal_weight_information(
    numbers: np.ndarray, weight: np.ndarray, least: np.ndarray, hours: np.ndarray, nuisance: np.ndarray,
    profiles: np.ndarray,
) -> ProfileInformation:
    """Of numbers of one weight (n_block,)."""
    m, k = numbers.shape[1], len(profiles)
    grid = [(0.0, 1.0), *product(SLOW_RATIO, SLOW_LENGTH)]
    prior = np.log([0.5, *[0.5 / (len(grid) - 1)] * (len(grid) - 1)])
    shape = (len(grid), m, k)
    a, b, c, null = np.ones(shape), np.zeros(shape), np.ones(shape[:2]), np.zeros(shape[:2])
    counted, degrees, usable = weight > 0, np.ones(m), np.zeros((m, k), bool)
    rank = np.linalg.matrix_rank(nuisance[counted]) if counted.any() else 0
    if np.sum(counted) >= rank + SPARE:
        degrees[:] = np.sum(counted) - rank + 1
        columns, n = np.hstack([nuisance, profiles.T, numbers]), nuisance.shape[1]
        for j, (ratio, length) in enumerate(grid):
            gram, log_det = _products(columns, weight, hours, ratio, length)
            rest, log_known = _residual_products(gram, n, rank)
            if not j:
                whole = np.diag(_residual_products(gram, 1, 1)[0])[n - 1 :][:k]
                good = (np.diag(rest)[:k] > REMAINING * whole) & _has_blocks_on_both_sides(profiles, counted)
                # what is as good as constant where it counts
                good &= whole > 1e-9 * np.mean(weight)
                usable[:] = good
            a[j] = np.where(good, np.maximum(np.diag(rest)[:k], ROUNDING * whole), 1.0)
            b[j] = np.where(good, rest[k:, :k], 0.0)
            c[j] = np.maximum(np.diag(rest)[k:], 0.0) + least
            null[j] = prior[j] - 0.5 * (log_det + log_known + degrees * np.log(c[j]))
    return ProfileInformation(a=a, b=b, c=c, null=null, degrees=degrees, usable=usable)


def _has_blocks_on_both_sides(profiles: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """(n_profile,) whether a step has enough blocks that count on either side; others always."""
    step = np.all((profiles == 0) | (profiles == 1), axis=1)
    after = np.sum(profiles[:, counted] != 0, axis=1)
    return ~step | ((after >= FEWEST_ASIDE) & (np.sum(counted) - after >= FEWEST_ASIDE))


def _products(
    columns: np.ndarray, weight: np.ndarray, hours: np.ndarray, ratio: float, length: float
) -> tuple[np.ndarray, float]:
    """Products of columns (n_block, n) with the inverse covariance of a block's noise and the slow error, and the ln
    determinant of that covariance. The inverse of an Ornstein-Uhlenbeck covariance has three diagonals."""
    weighted = weight[:, None] * columns
    gram, log_det = columns.T @ weighted, -float(np.sum(np.log(weight[weight > 0])))
    if not ratio:
        return gram, log_det
    span = max(float(hours[-1] - hours[0]), 1e-9)
    memory = np.exp(-np.maximum(np.diff(hours), 1e-6 * span) / (length * span))
    ratio = ratio / float(np.mean(weight[weight > 0]))
    fresh = 1 - memory**2
    diagonal = np.ones(len(hours))
    diagonal[:-1] += memory**2 / fresh
    diagonal[1:] += memory**2 / fresh
    banded = np.zeros((2, len(hours)))
    banded[1] = diagonal / ratio + weight
    banded[0, 1:] = -memory / fresh / ratio
    gram = gram - weighted.T @ solveh_banded(banded, weighted)
    pivots = _pivots(banded)
    return gram, log_det + float(np.sum(np.log(pivots)) + np.sum(np.log(fresh)) + len(hours) * np.log(ratio))


def _pivots(banded: np.ndarray) -> np.ndarray:
    """Of the elimination of a symmetric matrix of three diagonals: their product is its determinant."""
    result = banded[1].copy()
    for k in range(1, len(result)):
        result[k] -= banded[0, k] ** 2 / result[k - 1]
    return result


def _residual_products(gram: np.ndarray, n: int, rank: int) -> tuple[np.ndarray, float]:
    """Products of what the first n columns do not explain, and the ln determinant of theirs."""
    value, vector = np.linalg.eigh(gram[:n, :n])
    value, vector = value[n - rank :], vector[:, n - rank :]
    part = vector.T @ gram[:n, n:] / np.sqrt(value)[:, None]
    return gram[n:, n:] - part.T @ part, float(np.sum(np.log(value)))


def scale_mean(log_moved: np.ndarray) -> np.ndarray:
    """Mean over amounts of no size and of each scale, of ln Bayes factors (n_scale, ...)."""
    return logsumexp(np.concatenate([np.zeros((1, *log_moved.shape[1:])), log_moved]), axis=0) - np.log(
        1 + len(log_moved))
