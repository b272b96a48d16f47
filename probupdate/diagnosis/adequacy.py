"""What remains after the best fit, and whether it is more than noise.

At the most probable parameters (and sizes of effects) residuals are r = y - G_h c_h. When nothing more is wrong
cov(r) = W - G_h C_h G_h^T: W is the noise with tolerances, the model discrepancy of model form and the model error of
signatures that were taken in, C_h the posterior covariance of what was fitted. All that is shown is a sum over blocks
of r (a mean, a slope, a bin's mean) over its own standard deviation, so that it is standard normal when the model is
right; the fit's own appetite is counted. Whether the rest is more than noise is tested in directions that some effect
could take, in the frequencies as such, and in each number of the shapes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg, stats

from probupdate.diagnosis.fitting import Fit
from probupdate.diagnosis.linear import Design
from probupdate.diagnosis.problem import DiagnosisProblem, local_std, prior_shift
from probupdate.diagnosis.search import Search, drawn_scores

# share of a sum's variance that a fit leaves at least: less is rounding, and what is not linear
LEAST_LEFT = 1e-4
# a residual as unlikely as this is not explained
ADEQUATE = 0.01
# of the parameters' joint test: directions that the data inform less, as a share of the prior's variance, are left out
INFORMED = 0.05


@dataclass(frozen=True, eq=False, kw_only=True)
class Residual:
    """What a fit leaves: per group `left` (n_block, n_response), zero where not measured; `held` the unknowns of the
    design that the fit chose, `held_cov` their posterior covariance."""

    design: Design
    left: tuple[np.ndarray, ...]
    held: np.ndarray
    held_cov: np.ndarray

    def own_noise(self, q: int, share: np.ndarray) -> np.ndarray:
        """Covariance (m, m) of sum_b share_b r_b of group q by its noise and offsets alone; share (n_block,)."""
        weight = self.design.noise.weight[q]
        there = weight > 0
        scale = float(np.sum(share[there] ** 2 / weight[there]))
        return scale * self._covariances[q] + np.diag(self._offset_variance(q, share))

    @cached_property
    def _covariances(self) -> tuple[np.ndarray, ...]:
        """Of a block of weight one, as the fit weighs it: with how far modes turn towards mates that were not measured,
        which the noise's own covariance leaves out."""
        return tuple(map(np.linalg.inv, self.design.noise.precision))

    def _offset_variance(self, q: int, share: np.ndarray) -> np.ndarray:
        """(m,) what the model discrepancy of model form adds, and the model error of signatures of effects that were
        taken in."""
        design = self.design
        share = np.where(design.noise.weight[q] > 0, share, 0.0)
        variance = (design.discrepancy_std[q] * share.sum()) ** 2
        for time_profile, spread in design.model_errors:
            by_bin = np.bincount(design.bin_of, share * time_profile.value, design.n_bin)
            variance = variance + (by_bin @ spread[q]) ** 2
        return variance

    def spread_between(self, q: int, share: np.ndarray, p: int, other: np.ndarray) -> np.ndarray:
        """What tolerances add and the fit takes away of the covariance between two sums."""
        first, second = self._summed_unknowns(q, share), self._summed_unknowns(p, other)
        return (first * self._tolerance**2) @ second.T - first[:, self.held] @ self.held_cov @ second[:, self.held].T

    @cached_property
    def _tolerance(self) -> np.ndarray:
        """(n_common,) standard deviations of what was not fitted, zero for what was."""
        std = np.array(self.design.prior_std[: self.design.n_common])
        std[self.held] = 0.0
        return std

    def _summed_unknowns(self, q: int, share: np.ndarray) -> np.ndarray:
        """(m, n_common) what common unknowns make of a sum over blocks."""
        design = self.design
        share = np.where(design.noise.weight[q] > 0, share, 0.0)
        by_bin = np.bincount(design.bin_of, share, design.n_bin)
        columns = [np.einsum("g,gmk->mk", by_bin, design.nuisance[q])]
        for effect, time_profile, _ in design.included:
            there = np.bincount(design.bin_of, share * time_profile.value, design.n_bin)
            columns.append(np.einsum("g,gm->m", there, design.effect[q][:, :, effect])[:, None])
        return np.concatenate(columns, axis=1)

    def share_mean(self, q: int, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """sum_b share_b r_b (m,) of group q and its standard deviation (m,)."""
        weight = self.design.noise.weight[q]
        there = weight > 0
        value = np.where(there, share, 0.0) @ self.left[q]
        # the diagonal of `spread_between` and `own_noise`
        summed = self._summed_unknowns(q, share)
        own = np.sum(share[there] ** 2 / weight[there]) * np.diag(self._covariances[q])
        variance = own + self._offset_variance(q, share) + summed**2 @ self._tolerance**2
        held = summed[:, self.held]
        left = variance - np.sum((held @ self.held_cov) * held, axis=1)
        # a group of which no block shows has no variance
        return value, np.sqrt(np.maximum(left, np.maximum(LEAST_LEFT * variance, 1e-300)))

    def mean_share(self, q: int) -> np.ndarray:
        weight = self.design.noise.weight[q]
        return weight / max(weight.sum(), 1e-12)

    @cached_property
    def means(self) -> tuple[np.ndarray, np.ndarray]:
        """Means over blocks of all groups' responses in a row (n,), and their full covariance (n, n)."""
        shares = [self.mean_share(q) for q in range(len(self.left))]
        sizes = [y.shape[1] for y in self.left]
        at = np.concatenate([[0], np.cumsum(sizes)])
        covariance = np.zeros((at[-1], at[-1]))
        for q, share in enumerate(shares):
            for p in range(q + 1):
                block = self.spread_between(q, share, p, shares[p])
                if p == q:
                    block = block + self.own_noise(q, share)
                covariance[at[q] : at[q + 1], at[p] : at[p + 1]] = block
                covariance[at[p] : at[p + 1], at[q] : at[q + 1]] = block.T
        return np.concatenate([s @ y for s, y in zip(shares, self.left, strict=True)]), covariance


def residual_of(fitted: Fit, n_own: int) -> Residual:
    """Of a fit with n_own updated parameters."""
    design = fitted.design
    held = np.array(design.fitted_unknowns(n_own))
    return Residual(design=design, left=fitted.residuals, held=held, held_cov=design.unknowns_cov(held))


def slope_share(r: Residual, q: int, value: np.ndarray) -> np.ndarray:
    """Shares (n_block,) of blocks whose sum is the slope of a response on `value`."""
    weight = r.design.noise.weight[q]
    centred = value - (weight @ value) / max(weight.sum(), 1e-12)
    size = float(weight @ centred**2)
    return weight * centred / size if size > 0 else np.zeros_like(weight)


def chunk_share(r: Residual, q: int, chosen: np.ndarray) -> np.ndarray | None:
    """(n_block,) shares whose sum is the mean over the chosen blocks (n_block,) of bool less that over all; None where
    none of them was measured."""
    weight = r.design.noise.weight[q]
    own = np.where(chosen, weight, 0.0)
    return own / own.sum() - weight / max(weight.sum(), 1e-12) if own.sum() > 0 else None


def free_directions(shape: np.ndarray, n_log: int) -> np.ndarray:
    """(m, n) orthonormal: responses of a group less those that aligning its shapes to `shape` (n_channel, k) takes
    away."""
    n_channel, k = shape.shape
    m = n_log + 2 * n_channel * k
    taken = []
    for i in range(k):
        real = slice(n_log + i * n_channel, n_log + (i + 1) * n_channel)
        imaginary = slice(real.start + k * n_channel, real.stop + k * n_channel)
        for j in range(k):
            in_phase, out_of_phase = np.real(shape[:, j]), np.imag(shape[:, j])
            for re, im in ((in_phase, out_of_phase), (-out_of_phase, in_phase)):
                row = np.zeros(m)
                row[real], row[imaginary] = re, im
                taken.append(row)
    return linalg.null_space(np.array(taken))


def block_sizes(r: Residual, effect: int) -> tuple[np.ndarray, np.ndarray]:
    """The size of an effect that fits each block best, by its signature (n_block,), and its standard deviation by the
    block's noise; infinite where nothing was measured."""
    design = r.design
    top, bottom = np.zeros(len(design.bin_of)), np.zeros(len(design.bin_of))
    for q, y in enumerate(r.left):
        prints = design.effect[q][:, :, effect]
        weighted = prints @ design.noise.precision[q]
        top += design.noise.weight[q] * np.einsum("bm,bm->b", weighted[design.bin_of], y)
        bottom += design.noise.weight[q] * np.einsum("gm,gm->g", weighted, prints)[design.bin_of]
    known = bottom > 0
    return np.where(known, top / np.where(known, bottom, 1.0), 0.0), np.where(
        known, 1 / np.sqrt(np.where(known, bottom, 1.0)), np.inf)


def push(problem: DiagnosisProblem, fitted: Fit) -> tuple[np.ndarray, np.ndarray, float]:
    """Shift of each updated parameter over its prior's standard deviation (n,), the standard deviation expected of
    that, and p of all shifts together: c_hat is N(0, S - C) when the prior is right, S prior's and C posterior
    covariance."""
    n = len(problem.updated)
    std = np.array([local_std(problem.prior, i, fitted.theta[k]) for i, k in enumerate(problem.updated)])
    shift = -prior_shift(problem, fitted.theta) / std
    learnt = np.eye(n) - fitted.design.unknowns_cov(range(n)) / np.outer(std, std)
    value, turn = np.linalg.eigh(learnt)
    informed = value > INFORMED
    statistic = float(np.sum((turn[:, informed].T @ shift) ** 2 / value[informed]))
    p = float(stats.chi2.sf(statistic, int(informed.sum()))) if informed.any() else 1.0
    return shift, np.sqrt(np.maximum(np.diag(learnt), 0.0)), p


# the pattern of the noise is known to about a tenth of a variance (few columns, states that differ: 0.89 to 1.12 in
# records whose noise was known), which sums of many squares see though no single score does
PATTERN = 1.05
# directions of the catalogue's span that are tested for a residual, by their share of the largest
SPAN = 1e-2
# of frequencies their tolerances and the fit leave fewer directions, and each of them is tested
FREE = 1e-6
FREQUENCIES, SHAPES = "frequencies", "shapes"
# standard deviations from which a mode's mean frequency is said to be off, beside a residual that is not explained
OFF = 3.0
# and a number of its shape, of which there are many more
FAR_OFF = 5.0


def adequacy(
    problem: DiagnosisProblem, fitted: Fit, found: Search, drawn: np.ndarray
) -> tuple[float, dict[str, float]]:
    """p of what remains. In the directions that the catalogue spans: constants together, and each time profile along
    the record; the smallest of them against its own bootstrap distribution. And in the mean frequencies, which what no
    row of the catalogue does moves too: the smaller of both, twice. And no more than p of the single number of a shape
    that is farthest off, which none of these directions need show (a channel out of phase). With it each part's own p.
    `drawn`: scores (n_draw, n_candidate) of drawn records at that fit (`drawn_scores`)."""
    free, all_of_them = _frequencies(problem, fitted, found), _spanned_residuals(problem, fitted, found, drawn)
    shapes = _single_shapes(problem, fitted, found)
    if all_of_them is None:
        return min(free, shapes), {FREQUENCIES: free, SHAPES: shapes}
    p, parts = all_of_them
    return min(1.0, 2 * min(p, free), shapes), {**parts, FREQUENCIES: free, SHAPES: shapes}


def explains(problem: DiagnosisProblem, fitted: Fit, found: Search, seed: int) -> bool:
    """Whether what a fit leaves may be noise: `found` the search beside it."""
    return adequacy(problem, fitted, found, drawn_scores(fitted.design, seed))[0] >= ADEQUATE


def _spanned_residuals(
    problem: DiagnosisProblem, fitted: Fit, found: Search, drawn: np.ndarray
) -> tuple[float, dict[str, float]] | None:
    """None where so few effects are listed that the directions of what is left are theirs alone."""
    design = fitted.design
    names, rare = [], []
    # crosstalks may have been taken up after the search
    usable = spanning_candidates(problem, design)[: len(found.which)]
    for c, time_profile in enumerate(problem.time_profiles):
        rows = np.flatnonzero((found.which[:, 1] == c) & usable)
        if len(rows) < 5:
            continue
        white = whitening_matrix(design, rows)
        z = np.vstack([found.u[None, rows], drawn[:, rows]]) @ white
        z[0] /= PATTERN * found.heavier if time_profile.kind == "constant" else found.heavier * np.maximum(
            1.0, design.scatter(fitted.centred, c, found.which[rows, 0], white))
        names.append(f"{time_profile.name} {time_profile.at}".strip())
        rare.append(stats.chi2.logsf(np.sum(z**2, axis=1), z.shape[1]))
    if not rare:
        return None
    # the rarest over the time profiles, of the record and of every drawn one alike: by ranks among the drawn ones, a
    # record above all of them along any one time profile would be rarer than each of these can be
    rarest = np.min(rare, axis=0)
    p = float((1 + np.sum(rarest[1:] <= rarest[0])) / (len(drawn) + 1))
    return p, {name: float(np.exp(values[0])) for name, values in zip(names, rare, strict=True)}


def _frequencies(problem: DiagnosisProblem, fitted: Fit, found: Search) -> float:
    """p of the mean frequencies together (of a pair: its tensor's three numbers), beyond all that is normal: no shape,
    whose noise is known less well, takes part."""
    design = fitted.design
    own = [1 if axes.shape[1] == 1 else 3 for axes in problem.predictor.axes]
    first, n_effect = np.concatenate([[0], np.cumsum(own)]), len(problem.effects)
    signatures = []
    for q, made in enumerate(design.effect):
        unit = np.zeros((*made.shape[:2], first[-1]))
        unit[:, np.arange(own[q]), np.arange(first[q], first[q + 1])] = 1.0
        signatures.append(np.concatenate([made, unit], axis=2))
    measured = [k for q, n in enumerate(own) if design.noise.weight[q].any() for k in range(first[q], first[q] + n)]
    constant = next(c for c in design.time_profiles if c.kind == "constant")
    which = np.array([(n_effect + k, 0) for k in measured])
    moved = replace(design, effect=tuple(signatures), time_profiles=(constant,), which=which)
    rows = np.flatnonzero(moved.share_left > FREE)
    if not len(rows):
        return 1.0
    z = moved.scores(fitted.centred)[rows] / (PATTERN * found.heavier) @ whitening_matrix(moved, rows, FREE)
    return float(stats.chi2.sf(z @ z, len(z)))


def _single_shapes(problem: DiagnosisProblem, fitted: Fit, found: Search) -> float:
    """p of the largest mean of all single numbers of shapes in its standard deviations, by Bonferroni's bound: far
    above its own, as tolerances make many of them one, so that it says something of what is far off alone."""
    z = np.concatenate([value / std for _, value, std in _mean_shapes(problem, fitted)] or [np.zeros(0)])
    largest = np.abs(z).max(initial=0.0) / (PATTERN * found.heavier)
    return float(min(1.0, 2 * stats.norm.sf(largest) * max(len(z), 1)))


def _mean_shapes(problem: DiagnosisProblem, fitted: Fit) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Number of each group that shows, the means over blocks of what is left of its shapes (real parts, then phases,
    one mode after the other), and their standard deviations."""
    left, n_channel = residual_of(fitted, len(problem.updated)), len(problem.blocks.channels)
    for q, w in enumerate(fitted.design.noise.weight):
        if w.any() and n_channel:
            value, std = left.share_mean(q, left.mean_share(q))
            n_shape = 2 * n_channel * len(problem.blocks.groups[q])
            yield q, value[-n_shape:], std[-n_shape:]


def shapes_off(problem: DiagnosisProblem, fitted: Fit) -> list[str]:
    """What to say of the number of each group's shapes that the fit leaves off most."""
    channels, off = problem.blocks.channels, []
    for q, value, std in _mean_shapes(problem, fitted):
        worst = int(np.argmax(np.abs(value) / std))
        if abs(value[worst]) > FAR_OFF * std[worst]:
            phase = worst >= len(value) // 2
            off.append(f"{problem.blocks.group_name(q)} at {channels[worst % len(channels)]} "
                       f"{100 * value[worst]:+.2g} % {'out of' if phase else 'in'} phase (expected within "
                       f"{100 * std[worst]:.2g} %)")
    return [f"measured shapes are off what the fit explains, in shares of their largest component: {', '.join(off)}"
            ] if off else []


def frequencies_off(problem: DiagnosisProblem, fitted: Fit) -> list[str]:
    """What to say of the modes whose mean frequency the fit leaves off."""
    left, off = residual_of(fitted, len(problem.updated)), []
    for q, axes in enumerate(problem.predictor.axes):
        value, std = left.share_mean(q, left.mean_share(q))
        # of a pair the third number turns its two axes
        worst = max(range(1 if axes.shape[1] == 1 else 2), key=lambda k: abs(value[k]) / std[k])
        if abs(value[worst]) > OFF * std[worst]:
            off.append(f"{problem.blocks.group_name(q)} {100 * value[worst]:+.2f} % (expected within "
                       f"{100 * std[worst]:.2g} %)")
    return [f"measured frequencies are off what the fit explains: {', '.join(off)}"] if off else []


def span_left(problem: DiagnosisProblem, fitted: Fit, time_profile: int) -> tuple[float, int]:
    """Sum of squares of what remains in the directions the catalogue spans with one time profile, and their number:
    zero and one where unknowns can follow all of them."""
    design = fitted.design
    rows = np.flatnonzero((problem.which[:, 1] == time_profile) & spanning_candidates(problem, design))
    if not len(rows):
        return 0.0, 1
    z = design.scores(fitted.centred)[rows] @ whitening_matrix(design, rows)
    return float(z @ z), len(z)


def spanning_candidates(problem: DiagnosisProblem, design: Design) -> np.ndarray:
    """(n_candidate,) bool: what spans the directions of the rest; exchanged cables of any two sensors would span
    every shape."""
    return (design.share_left > 1e-3) & np.array([not problem.effects[j].discrete for j, _ in design.which])


def whitening_matrix(design: Design, rows: np.ndarray, least: float = SPAN) -> np.ndarray:
    """(n_row, n_direction): u of these candidates -> independent standard normal numbers when nothing is wrong."""
    value, turn = np.linalg.eigh(design.score_correlation(rows))
    kept = value > least * value[-1]
    return turn[:, kept] / np.sqrt(value[kept]) / np.sqrt(design.information[rows])[:, None]
