"""A proposal that bends: a triangular map of independent numbers, fitted to weighted draws.

Sharp posteriors are thin, bent ridges that no Gaussian follows. In coordinates ordered from the widest direction to the
thinnest each number is a quadratic of those before it and a cubic spline along each, with a scatter whose logarithm is
linear in them and such splines: a Knothe-Rosenblatt rearrangement (El Moselhy & Marzouk 2012; Parno & Marzouk 2018).
Every part of the fit is a regression, draws follow one after another, and the density is exact and normalised.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import special

from probupdate.runtime.arrays import frozen_array
from probupdate.updating.surrogate import GaussianApproximation, from_coordinates, log_jacobian, to_coordinates

# degrees of freedom of the independent numbers, whose tails are heavier than the posterior's, and how much wider
DEGREES, SPREAD = 12.0, 1.05
# of the coefficients, in effective draws of what is left of the number: few draws leave the map straight, and a number
# that those before it determine bends as they want
RIDGE = 3.0
# rounds in which the scatter of a number along those before it is found, and ln of its most and least over its mean
ROUNDS, MOST_LN = 5, 2.5
# knots of a spline: draws that count for each, at most, fewest that are better than the quadratic alone, and the share
# of the draws that lies beyond them
PER_KNOT, MOST_KNOTS, FEWEST_KNOTS, BEYOND = 8, 20, 4, 1e-4
# of the variance, the most that coefficients are said to have taken
MOST_TAKEN = 0.5
# no draw is farther out, in standard deviations of the draws fitted to, than quadratics are believed
FARTHEST = 4.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Transport:
    """u = mean + root x; x_k = middle_k(x before) + exp(ln_scale_k(x before)) t_k, t_k Student t of DEGREES: `middle`
    and `ln_scale` hold the coefficients of each k, `columns` what they multiply. u are the coordinates of `like`, a
    Gaussian approximation."""

    mean: np.ndarray
    root: np.ndarray
    columns: tuple[_Columns, ...]
    middle: tuple[np.ndarray, ...]
    ln_scale: tuple[np.ndarray, ...]
    like: GaussianApproximation

    def _conditional_scale(self, k: int, before: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Middle and ln of the scatter (n,) of the k-th number given those before it (n, k)."""
        return (self.columns[k].combine(before, self.middle[k]),
                np.clip(self.columns[k].combine(before, self.ln_scale[k]), *_limits(self.ln_scale[k])))

    def draw(self, n: int, random) -> np.ndarray:
        """(n, n_param); draws may lie outside the parameters' bounds. `random` has uniform(size=n)."""
        x = np.empty((n, len(self.mean)))
        for k in range(len(self.mean)):
            middle, ln = self._conditional_scale(k, x[:, :k])
            x[:, k] = middle + np.exp(ln) * special.stdtrit(DEGREES, random.uniform(size=n))
        with np.errstate(over="ignore", divide="ignore"):
            return from_coordinates(self.mean + x @ self.root.T, self.like.powers) + self.like.origin

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        """(n,) of theta (n, n_param) inside the bounds, normalised."""
        u, jacobian = _coordinates(theta, self.like)
        x = np.linalg.solve(self.root, (u - self.mean).T).T
        n = len(self.mean)
        constant = special.gammaln(0.5 * (DEGREES + 1)) - special.gammaln(0.5 * DEGREES) - 0.5 * np.log(DEGREES * np.pi)
        total = np.full(len(x), n * constant - np.linalg.slogdet(self.root)[1])
        for k in range(n):
            middle, ln = self._conditional_scale(k, x[:, :k])
            t = (x[:, k] - middle) * np.exp(-ln)
            total -= ln + 0.5 * (DEGREES + 1) * np.log1p(t**2 / DEGREES)
        return total - jacobian


def _coordinates(theta: np.ndarray, like: GaussianApproximation) -> tuple[np.ndarray, np.ndarray]:
    """u (n, n_param) and ln |d theta / du| (n,)."""
    x = theta - like.origin
    return to_coordinates(x, like.powers), log_jacobian(x, like.powers)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Columns:
    """What the scatter and the middle of a number follow of those before it (n, k), each column about its mean over the
    draws that were fitted to: splines of equally spaced knots (k, n_knot), straight beyond them; products of two."""

    knots: np.ndarray
    centre: np.ndarray

    @cached_property
    def _pairs(self) -> tuple[np.ndarray, np.ndarray]:
        return np.triu_indices(len(self.knots))

    @property
    def n_straight(self) -> int:
        k, n_knot = self.knots.shape
        return 1 + k * (n_knot - 1)

    @cached_property
    def _width(self) -> np.ndarray:
        return 6 * np.diff(self.knots[:, :2], axis=1)

    def _lines(self, x: np.ndarray) -> np.ndarray:
        beyond = np.maximum(x[:, :, None] - self.knots, 0.0)
        # a power of three is three times as slow
        cubes = beyond**2
        cubes *= beyond
        # each has the second derivative of a roof over three knots
        splines = np.diff(cubes, n=2, axis=2) / self._width
        return np.concatenate([x, splines.reshape(len(x), -1)], axis=1)

    def raw(self, before: np.ndarray) -> np.ndarray:
        x = np.clip(before, -FARTHEST, FARTHEST)
        i, j = self._pairs
        return np.concatenate([self._lines(x), x[:, i] * x[:, j]], axis=1)

    def centred(self, raw: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        columns = np.concatenate([np.ones((len(raw), 1)), raw - self.centre], axis=1)
        return columns[:, : self.n_straight], columns

    def combine(self, before: np.ndarray, coefficient: np.ndarray) -> np.ndarray:
        """(n,) the columns of the scatter or of the middle, as many as there are coefficients, times these: products
        as a quadratic form, which costs a tenth of theirs one by one."""
        if not coefficient[1:].any():
            return np.full(len(before), coefficient[0])
        x = np.clip(before, -FARTHEST, FARTHEST)
        lines = coefficient[1 : self.n_straight]
        total = coefficient[0] - self.centre[: len(coefficient) - 1] @ coefficient[1:] + self._lines(x) @ lines
        if len(coefficient) > self.n_straight:
            form = np.zeros((len(self.knots),) * 2)
            form[self._pairs] = coefficient[self.n_straight :]
            total += np.einsum("nk,nk->n", x @ form, x)
        return total

    @classmethod
    def fitted(cls, before: np.ndarray, weight: np.ndarray, counts: float) -> tuple[_Columns, np.ndarray, np.ndarray]:
        """Of draws (n, k) with weights (n,), `counts` of which count, with their values at these draws."""
        k = before.shape[1]
        number = int(min(counts / (PER_KNOT * max(k, 1)), MOST_KNOTS))
        # two knots make no spline
        number = 2 if number < FEWEST_KNOTS else number
        knots = np.empty((k, number))
        for i in range(k):
            order = np.argsort(before[:, i])
            ends = np.interp([BEYOND, 1 - BEYOND], np.cumsum(weight[order]), before[order, i])
            knots[i] = np.linspace(*ends, number)
        raw = cls(knots=knots, centre=np.zeros(1)).raw(before)
        found = cls(knots=frozen_array(knots), centre=frozen_array(weight @ raw))
        return found, *found.centred(raw)


def _limits(ln_scale: np.ndarray) -> tuple[float, float]:
    return ln_scale[0] - MOST_LN, ln_scale[0] + MOST_LN


def fit_transport(theta: np.ndarray, weight: np.ndarray, like: GaussianApproximation) -> Transport:
    """To points theta (n, n_param) inside the bounds with normalised weights (n,), in the coordinates of `like`."""
    u, _ = _coordinates(theta, like)
    mean = weight @ u
    scale = np.sqrt(weight @ (u - mean) ** 2) + 1e-12 * (1 + np.abs(mean))
    z = (u - mean) / scale
    value, vector = np.linalg.eigh((z * weight[:, None]).T @ z)
    root = vector[:, ::-1] * np.sqrt(np.maximum(value[::-1], 1e-12))
    x = np.linalg.solve(root, z.T).T
    counts = 1 / np.sum(weight**2)
    columns, middle, ln_scale = [], [], []
    for k in range(x.shape[1]):
        own, straight, bent = _Columns.fitted(x[:, :k], weight, counts)
        coefficient, ln = _regress(x[:, k], straight, bent, weight, counts)
        columns.append(own)
        middle.append(frozen_array(coefficient))
        ln_scale.append(frozen_array(ln))
    return Transport(mean=frozen_array(mean), root=frozen_array(scale[:, None] * root), columns=tuple(columns),
                     middle=tuple(middle), ln_scale=tuple(ln_scale), like=like)


def _regress(x: np.ndarray, straight: np.ndarray, bent: np.ndarray, weight: np.ndarray, counts: float):
    """Coefficients of the middle and of ln of the scatter of a number x (n,), each shrunk by what chance alone makes of
    as many columns (James and Stein 1961), so that few draws leave the map straight."""
    ln, left, of_scatter = np.zeros(straight.shape[1]), 1.0, None
    own_weight, taken = weight, min(bent.shape[1] / counts, MOST_TAKEN)
    # of ln of an equal scatter: half of a share of 1 / counts for each column
    by_chance = 0.5 * (len(ln) - 1) / counts
    for _ in range(ROUNDS):
        normal = _normal(bent, own_weight, counts / left)
        # of the first round, whose weights are the draws' own, the scatter's are a part in every round
        of_scatter = normal[: len(ln), : len(ln)] if of_scatter is None else of_scatter
        coefficient = np.linalg.solve(normal, (own_weight * x) @ bent)
        off = x - bent @ coefficient
        left = min(float(own_weight @ off**2), 1.0)
        kept = _share_kept(own_weight @ (x - off - coefficient[0]) ** 2, left * taken / (1 - taken))
        coefficient[1:] *= kept
        coefficient[0] += own_weight @ (x - bent @ coefficient)
        off = x - bent @ coefficient
        along = np.clip(straight @ ln, *_limits(ln))
        # one step of scoring for a scatter that is log-linear
        excess = off**2 * np.exp(-2 * along)
        mean_excess = weight @ excess
        step = np.linalg.solve(of_scatter, (weight * 0.5 * (np.minimum(excess / mean_excess, 9.0) - 1)) @ straight)
        step[0] = 0.5 * np.log(max(mean_excess, 1e-24))
        ln = ln + step
        own_weight = weight * np.exp(-2 * (np.clip(straight @ ln, *_limits(ln)) - ln[0]))
        own_weight = own_weight / own_weight.sum()
        if weight @ (straight[:, 1:] @ step[1:]) ** 2 <= by_chance:
            break
    ln[1:] *= _share_kept(weight @ (straight[:, 1:] @ ln[1:]) ** 2, by_chance)
    # what the coefficients took from the draws, and their own error at others
    ln[0] += 0.5 * np.log(SPREAD * (1 + kept * taken) / (1 - kept * taken))
    return coefficient, ln


def _share_kept(found: float, by_chance: float) -> float:
    """Of coefficients whose sum has the variance `found`."""
    return max(0.0, 1 - by_chance / found) if found > 0 else 0.0


def _normal(columns: np.ndarray, weight: np.ndarray, counts: float) -> np.ndarray:
    """Normal equations' matrix with a ridge on all but the constant: a product with itself costs half of one."""
    own = columns * np.sqrt(weight)[:, None]
    normal = own.T @ own
    ridge = RIDGE / counts * np.diag(normal)
    ridge[0] = 0.0
    return normal + np.diag(ridge + 1e-12)
