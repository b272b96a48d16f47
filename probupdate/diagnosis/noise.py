"""How far one block's responses scatter by themselves: covariance within a group of modes, blocks' weights, memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, stats

from probupdate.runtime.arrays import frozen_array

# blocks that must show a group of modes for its scatter to be estimated
FEWEST = 2
# blocks of a turbine state from which its own scatter is stated
FEWEST_OF_STATE = 10
# share of a response's variance that is its own at least, and steps in which variances settle
LEAST_OWN, MOST_FACTORINGS = 1e-3, 200
# standard deviations of chi-square beyond which a block that is far from both its neighbours counts less
WRONG = 4.0
# times the largest eigenvalue that noise as stated has, from which it is not as stated; variance, in that stated, below
# which numbers are real and have no scatter at all
BEYOND_EDGE, SCATTERS = 2.0, 1e-12
# variance, in that of a block, along a way below which leaving it free changes nothing
HIDDEN = 2.0
# modes nearer to one another than this, as a share of their frequency, mix as if they were so far apart
NEAREST = 0.01
# no identification is believed to repeat better than this: ln f, share of the largest component
SMALLEST_LOG, SMALLEST_SHAPE = 2e-4, 5e-4


@dataclass(frozen=True, eq=False, kw_only=True)
class Noise:
    """Of each group: covariance (n_response, n_response) of a block of weight one; `precision` with which it counts,
    its inverse, less along the ways W (n_response, n) that a model leaves free (`free`, empty where it leaves none; see
    `fitting.turning_freely`), a standard deviation each; weight (n_block,) with zero where the group was not
    measured; `degrees` of freedom (n_response,) from which the scale of each response was stated, empty
    where it is known; `stray` (n_block,) bool, empty where it was not looked for: far from both neighbours. `stated`:
    taken from the identification of few blocks, unchecked by these."""

    covariance: tuple[np.ndarray, ...]
    precision: tuple[np.ndarray, ...]
    weight: tuple[np.ndarray, ...]
    degrees: tuple[np.ndarray, ...] = ()
    stray: tuple[np.ndarray, ...] = ()
    stated: bool = False
    free: tuple[np.ndarray, ...] = ()

    def with_free(self, free: Sequence[np.ndarray]) -> Noise:
        """With these ways (n_response, n) of each group free: (C + W W^T)^-1 by Woodbury's identity."""
        if not any(W.size for W in free):
            return self
        precision = []
        for C, own, W in zip(self.covariance, self.precision, free, strict=True):
            if not W.size:
                precision.append(own)
                continue
            P = np.linalg.inv(C)
            left = P @ W
            P = P - left @ np.linalg.solve(np.eye(W.shape[1]) + W.T @ left, left.T)
            precision.append(frozen_array(0.5 * (P + P.T)))
        return replace(self, precision=tuple(precision), free=tuple(map(frozen_array, free)))

    def also_free(self, other: Noise) -> Noise:
        """With what another noise leaves free too; the same object where that is no more than scatters anyway."""
        if not other.free or all(
            np.einsum("mi,mn,ni->i", W, P, W, optimize=True).max(initial=0.0) < HIDDEN
            for W, P in zip(other.free, self.precision, strict=True)
        ):
            return self
        own = self.free or tuple(W[:, :0] for W in other.free)
        return self.with_free([np.hstack(both) for both in zip(own, other.free, strict=True)])

    def select_blocks(self, chosen: np.ndarray) -> Noise:
        """Of only the blocks numbered `chosen`."""
        return replace(self, weight=tuple(frozen_array(w[chosen]) for w in self.weight),
                       stray=tuple(frozen_array(s[chosen], bool) for s in self.stray))

    def with_usual_weights(self, numbers: Sequence[int]) -> Noise:
        """With these blocks counted as their group's usual ones, where they are stray."""
        if not self.stray:
            return self
        weights = []
        for w, stray in zip(self.weight, self.stray, strict=True):
            own = np.array(w)
            odd = [k for k in numbers if stray[k]]
            own[odd] = np.median(w[w > 0]) if odd else own[odd]
            weights.append(frozen_array(own))
        return replace(self, weight=tuple(weights))

    def of_groups(self, numbers: Sequence[int]) -> Noise:
        """Of only these groups."""
        def pick(rows: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
            return tuple(rows[q] for q in numbers) if rows else ()

        return replace(self, covariance=pick(self.covariance), precision=pick(self.precision), weight=pick(self.weight),
                       degrees=pick(self.degrees), stray=pick(self.stray), free=pick(self.free))

    def scales(self, rng: np.random.Generator, n: int) -> list[np.ndarray]:
        """Per group (n, n_response) by how much standard deviations may truly be larger: one factor for all responses
        whose scale was estimated together."""
        result = []
        for own in self.degrees:
            factor = np.ones((n, len(own)))
            for estimated in np.unique(own):
                factor[:, own == estimated] = np.sqrt(estimated / rng.chisquare(estimated, n))[:, None]
            result.append(factor)
        return result


@dataclass(frozen=True, eq=False, kw_only=True)
class Mixing:
    """How identified shapes mix with those of other modes, per group: `free` (n, n_free) orthonormal, what aligning
    leaves of its shapes' real parts or of their phases; `made` (n_group, n, n) what mixing with each other group makes
    of their covariance, per unit of the standard deviations of both groups' ln f."""

    free: tuple[np.ndarray, ...]
    made: tuple[np.ndarray, ...]


def mixing_of(axes: Sequence[np.ndarray], frequency_hz: np.ndarray) -> Mixing:
    """Of groups with these real shapes (n_channel, k) at these frequencies (n_group,): what moves poles at random by
    s_i and s_j mixes the vector of one with the other's by sqrt(s_i s_j) over their distance (first-order perturbation;
    Kato 1966)."""
    result = []
    for q, A in enumerate(axes):
        beside, f = np.eye(len(A)) - A @ np.linalg.pinv(A), frequency_hz[q]
        share = f * frequency_hz / np.maximum((f - frequency_hz) ** 2, (NEAREST * f) ** 2)
        share[q] = 0.0
        result.append(frozen_array([np.kron(np.eye(A.shape[1]), s * beside @ B @ B.T @ beside)
                                    for s, B in zip(share, axes, strict=True)]))
    free = [linalg.block_diag(*[linalg.null_space(A.T)] * A.shape[1]) for A in axes]
    return Mixing(free=tuple(map(frozen_array, free)), made=tuple(result))


def estimate_noise(
    residuals: tuple[np.ndarray, ...], used: tuple[np.ndarray, ...], sizes: tuple[int, ...],
    relative_std: np.ndarray, states: np.ndarray, stated: Sequence[np.ndarray | None] | None = None,
    few: bool = False, std_alone: bool = False, mixing: Mixing | None = None,
) -> Noise:
    """From differences of successive blocks, which slow effects, steps and offsets hardly touch.

    residuals per group (n_block, n_response), used (n_block,) bool, sizes the number of modes of each group,
    relative_std (n_block, n_group), states (n_block,).
    The covariance is shrunk towards its diagonal by as much as so few blocks ask for (Schaefer & Strimmer 2005), or
    where it is known how shapes mix (`mixing`) towards that beside a scatter of each component's own. Where the
    identification states a joint covariance (`stated`, of a typical block), that one's pattern is taken instead, and
    the differences give its scale only, one for ln f and one for shapes; where standard deviations alone were stated
    (`std_alone`), which say neither how shapes mix nor how much of a shape's is across its phase, one for its real
    parts and one for its phases, beside mixing. With `few` blocks it is taken as stated.
    """
    if few:
        return _noise_as_stated(residuals, used, sizes, relative_std, stated)
    weights, differences, kinds, covariances = [], [], [], []
    patterns: Sequence[np.ndarray | None] = [None] * len(sizes) if stated is None else stated
    for q, (y, ok, pattern) in enumerate(zip(residuals, used, patterns, strict=True)):
        # a group of fewer blocks says nothing
        weight = np.zeros(len(y))
        if np.count_nonzero(ok) >= FEWEST:
            trust = _trust(y, ok, relative_std[:, q])
            weight = np.where(ok, relative_std[:, q] ** (-2.0 * trust), 0.0) if trust else _state_weights(y, ok, states)
        weights.append(weight)
        differences.append(_differences(y, weights[q]))
        m, n_log = y.shape[1], 1 if sizes[q] == 1 else 3
        kinds.append(_kinds(m, n_log, mixing is not None or (std_alone and pattern is not None)))
        if not len(differences[q]):
            found = np.eye(m)
        elif pattern is not None:
            found = _scale_pattern(pattern, differences[q], kinds[q])
        else:
            found = (_shrink_covariance(differences[q]) if mixing is None else
                     _common_variances(differences[q], kinds[q]))
        covariances.append(found + np.diag(_least(m, n_log) ** 2))
    if mixing is not None:
        covariances = _add_mixing(covariances, differences, mixing)
        covariances = [_shrink_towards(C, d) if pattern is None and len(d) else C
                       for C, pattern, d in zip(covariances, patterns, differences, strict=True)]
    degrees, strays = [], []
    for q, (C, y) in enumerate(zip(covariances, residuals, strict=True)):
        beside = _excess_variance(y, weights[q], np.linalg.inv(C))
        weights[q] = weights[q] / beside
        strays.append(frozen_array(beside > 1, bool))
        degrees.append(_degrees(C, len(differences[q]), kinds[q]))
    return Noise(covariance=tuple(map(frozen_array, covariances)), weight=tuple(map(frozen_array, weights)),
                 precision=tuple(frozen_array(np.linalg.inv(C)) for C in covariances),
                 degrees=tuple(degrees), stray=tuple(strays))


def _add_mixing(
    covariances: Sequence[np.ndarray], differences: Sequence[np.ndarray], mixing: Mixing
) -> list[np.ndarray]:
    """Covariances with how far identified shapes mix with those of other modes, which standard deviations alone do not
    say, nor the correlations of a dozen blocks: along the shapes of all others the structure's own changes lie too. Of
    every group's own scatter, real parts and phases, a factor is estimated, and of all mixing one, by maximum
    likelihood of the differences of successive blocks (Zhou, Hu, Zhou & Lange 2019)."""
    log_std = np.array([np.sqrt(np.mean(np.diag(C)[: min(2, len(C) - 2 * made.shape[1])])) if len(d) else 0.0
                        for C, d, made in zip(covariances, differences, mixing.made, strict=True)])
    parts, result = [], [np.array(C) for C in covariances]
    for q, (C, d, free, made) in enumerate(zip(result, differences, mixing.free, mixing.made, strict=True)):
        if not len(d) or not free.size:
            continue
        mixed, n = log_std[q] * np.tensordot(log_std, made, 1), made.shape[1]
        for part in (slice(len(C) - 2 * n, len(C) - n), slice(len(C) - n, len(C))):
            share, turn = linalg.eigh(free.T @ mixed @ free, free.T @ C[part, part] @ free)
            square = np.sum((d[:, part] @ free @ turn) ** 2, axis=0)
            # shapes given as real numbers have no phases to scatter
            if np.mean(square) > SCATTERS * len(d):
                parts.append((q, part, mixed, share, square, len(d)))
    if not parts:
        return result
    share, square = (np.concatenate([p[k] for p in parts]) for k in (3, 4))
    lengths = [len(p[3]) for p in parts]
    own, factor = _split_variances(share, square, np.repeat([p[5] for p in parts], lengths),
                         np.repeat(np.arange(len(parts)), lengths))
    for (q, part, mixed, *_), scale in zip(parts, np.sqrt(own), strict=True):
        result[q][part] *= scale
        result[q][:, part] *= scale
        result[q][part, part] += factor * mixed
    return result


def _split_variances(
    share: np.ndarray, square: np.ndarray, n: np.ndarray, part: np.ndarray
) -> tuple[np.ndarray, float]:
    """Factors of own variance, one a part, and of what mixing adds, one of all: of directions (n_direction,) of the
    variance own + factor share whose n squares add up to `square`; `part`: the number of each one's part."""
    # where no other group is known nothing mixes
    own, factor = np.ones(part[-1] + 1), float(np.any(share > 0))
    for _ in range(MOST_FACTORINGS):
        variance = own[part] + factor * share
        seen, known = square / variance**2, n / variance
        own = own * np.sqrt(np.bincount(part, seen) / np.bincount(part, known))
        if factor:
            factor *= np.sqrt(np.sum(share * seen) / np.sum(share * known))
    return np.maximum(own, LEAST_OWN), float(factor)


def _differences(y: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(n, n_response) of successive blocks that show, in those of weight one."""
    rows = np.flatnonzero(weight > 0)
    if len(rows) < FEWEST:
        return np.zeros((0, y.shape[1]))
    before, after = rows[:-1], rows[1:]
    return typical_differences((y[after] - y[before]) / np.sqrt(1 / weight[before] + 1 / weight[after])[:, None])


def typical_differences(difference: np.ndarray) -> np.ndarray:
    """Differences of successive blocks (n, n_response) as they mostly are: a step of the structure, or one block gone
    wrong, is one large difference among many, and left out; where these are the half of all they are cut."""
    limit = 4.0 * np.maximum(np.median(np.abs(difference), axis=0) / 0.6745, 1e-300)
    kept = np.all(np.abs(difference) < 2 * limit, axis=1)
    return difference[kept] if kept.sum() > len(kept) / 2 else np.clip(difference, -limit, limit)


def _noise_as_stated(residuals, used, sizes, relative_std, stated) -> Noise:
    covariances, precisions, weights = [], [], []
    for q, (y, ok) in enumerate(zip(residuals, used, strict=True)):
        estimated = stated[q] is not None
        covariance = np.array(stated[q]) if estimated else np.eye(y.shape[1])
        covariance[np.diag_indices_from(covariance)] += _least(y.shape[1], 1 if sizes[q] == 1 else 3) ** 2
        covariances.append(frozen_array(covariance))
        precisions.append(frozen_array(np.linalg.inv(covariance)))
        weights.append(frozen_array(np.where(ok & estimated, relative_std[:, q] ** -2.0, 0.0)))
    return Noise(covariance=tuple(covariances), precision=tuple(precisions), weight=tuple(weights), stated=True)


def _least(n_response: int, n_log: int) -> np.ndarray:
    least = np.full(n_response, SMALLEST_SHAPE)
    least[:n_log] = SMALLEST_LOG
    return least


def _common_variances(sample: np.ndarray, kinds: Sequence[slice]) -> np.ndarray:
    """Covariance (m, m) of rows of mean zero, all numbers of one of these kinds alike."""
    variance = np.empty(sample.shape[1])
    for part in kinds:
        variance[part] = np.mean(sample[:, part] ** 2)
    return np.diag(variance)


def _kinds(n_response: int, n_log: int, apart: bool) -> list[slice]:
    """Logarithms of frequencies, and shapes where there are any, their real parts and phases together or apart."""
    if n_response == n_log:
        return [slice(0, n_log)]
    middle = (n_response + n_log) // 2
    return [slice(0, n_log), *([slice(n_log, middle), slice(middle, None)] if apart else [slice(n_log, None)])]


def _excess_variance(y: np.ndarray, weight: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """(n_block,) by how much the variance of single blocks exceeds what all scatter by, one where it does not: a block
    far from both its neighbours, and from the next ones, went wrong; one far from those on one side stands at a step.
    How far it is off is one standard deviation of all its responses together: of each of m it would be the square root
    of m of them along its own direction, which effects may follow."""
    rows, m = np.flatnonzero(weight > 0), len(precision)
    result = np.ones(len(weight))
    if len(rows) < 4:
        return result

    def scaled_distance(a, b):
        d = (y[a] - y[b]) / np.sqrt(1 / weight[a] + 1 / weight[b])[:, None]
        return np.einsum("ni,ij,nj->n", d, precision, d) / m

    excess = np.full(len(rows), np.inf)
    # a sound one between two strays is near the next ones
    for step in (1, 2):
        between = scaled_distance(rows[:-step], rows[step:])
        for one in (excess[:-step], excess[step:]):
            np.minimum(one, between, out=one)
    # of two blocks one is wrong: half of the difference's variance would be the other's
    far = excess > 1 + WRONG * np.sqrt(2 / m)
    result[rows[far]] = m * (2 * excess[far] - 1)
    return result


def _degrees(covariance: np.ndarray, n_difference: int, kinds: Sequence[slice]) -> np.ndarray:
    """(n_response,) degrees of freedom of the scales of each of these kinds. Neighbouring differences share a block, so
    that three show what two independent ones would; responses show as much as their correlations leave."""
    result = np.empty(len(covariance))
    std = np.sqrt(np.diag(covariance))
    for part in kinds:
        r = covariance[part, part] / np.outer(std[part], std[part])
        result[part] = max(1.0, 2 / 3 * n_difference) * len(r) ** 2 / np.sum(r**2)
    return frozen_array(result)


def _trust(y: np.ndarray, ok: np.ndarray, relative_std: np.ndarray) -> float:
    """How far stated standard deviations predict the scatter of blocks: slope of its logarithm on theirs, less its
    standard error, between 0 and 1.

    A standard deviation estimated from few parts of one block is itself off by a fifth; weights made of it would call
    the noise of what they favour too small.
    """
    rows = np.flatnonzero(ok)
    difference = y[rows[1:]] - y[rows[:-1]]
    typical = np.median(difference**2, axis=0) / 0.455
    # a step is one large difference; it counts as a large one, not as itself
    share = np.mean(np.minimum(difference**2 / np.where(typical > 0, typical, 1.0), 9.0), axis=1)
    stated = np.log(0.5 * (relative_std[rows[1:]] ** 2 + relative_std[rows[:-1]] ** 2))
    known = share > 0
    if known.sum() < FEWEST_OF_STATE or np.ptp(stated[known]) == 0:
        return 0.0
    found = stats.linregress(stated[known], np.log(share[known]))
    return float(np.clip(found.slope - found.stderr, 0.0, 1.0))


def _state_weights(y: np.ndarray, ok: np.ndarray, states: np.ndarray) -> np.ndarray:
    """One over the scatter's square of each turbine state, relative to the median block."""
    weight = np.where(ok, 1.0, 0.0)
    variances = {}
    for state in np.unique(states):
        rows = np.flatnonzero(ok & (states == state))
        if len(rows) >= FEWEST_OF_STATE:
            variances[state] = np.median(np.abs(np.diff(y[rows], axis=0)), axis=0) ** 2
    if len(variances) < 2:
        return weight
    typical = np.median(list(variances.values()), axis=0)
    for state, variance in variances.items():
        ratio = np.exp(np.mean(np.log(np.maximum(variance, 1e-30) / np.maximum(typical, 1e-30))))
        weight[states == state] /= np.clip(ratio, 0.1, 10.0)
    return np.where(ok, weight, 0.0)


def _scale_pattern(pattern: np.ndarray, sample: np.ndarray, kinds: Sequence[slice]) -> np.ndarray:
    """The stated covariance with its standard deviations times what the sample's are over them, in each of these
    kinds."""
    scale = np.ones(len(pattern))
    for part in kinds:
        variance = np.diag(pattern)[part]
        seen = np.mean(sample[:, part] ** 2, axis=0)
        # shapes given as real numbers have no phases to scatter
        known = (variance > 1e-3 * variance.max()) & (seen > 0)
        scale[part] = np.sqrt(np.mean(seen[known] / variance[known])) if known.any() else 1.0
    return pattern * np.outer(scale, scale)


def agrees(covariance: np.ndarray, numbers: np.ndarray, n_log: int) -> bool:
    """Whether neighbouring blocks' numbers (n_block, n_response), the first `n_log` of them of frequencies, scatter as
    standard deviations alone say, but for the scale of each kind: without covariances the shapes of a close pair, which
    turn as one, are said to be many times better known along that turn than they are. The largest eigenvalue of noise
    that is as stated ends at (1 + sqrt(p / n))^2 (Marchenko & Pastur 1967)."""
    if len(numbers) < 3:
        return True
    difference = typical_differences(np.diff(numbers, axis=0) / np.sqrt(2))
    covariance = _scale_pattern(covariance, difference, _kinds(len(covariance), n_log, apart=True))
    std = np.sqrt(np.diag(covariance))
    used = std > 0
    value, turn = np.linalg.eigh(covariance[np.ix_(used, used)] / np.outer(std[used], std[used]))
    kept = value > 1e-6 * value[-1]
    white = (difference[:, used] / std[used]) @ turn[:, kept] / np.sqrt(value[kept])
    square = np.mean(white**2, axis=0)
    there = square > SCATTERS
    n, p = len(white), np.count_nonzero(there)
    largest = np.linalg.svd(white[:, there], compute_uv=False)[0] ** 2 / n
    return bool(largest < BEYOND_EDGE * (1 + np.sqrt(p / n)) ** 2 * np.median(square[there]))


def factor_covariance(sample: np.ndarray) -> np.ndarray:
    """Covariance (m, m) of rows of mean zero as few common factors and a scatter of each response's own: modes mix in a
    few directions, channels have their own noise. Maximum likelihood (Joereskog 1967); factors are those whose
    eigenvalue noise alone would not reach (Marchenko & Pastur 1967).

    A sample covariance of n rows, inverted as it is, makes small directions look n / (n - m) times too sure, and
    signatures lean on these; one shrunk to its diagonal loses them where modes mix by more than channels scatter.
    """
    n, m = sample.shape
    std = np.sqrt(np.mean(sample**2, axis=0))
    std = np.where(std > 0, std, 1.0)
    correlation = (sample / std).T @ (sample / std) / n
    edge = (1 + np.sqrt(m / n)) ** 2
    own, loading = np.full(m, 0.5), np.zeros((m, 0))
    for _ in range(MOST_FACTORINGS):
        scale = np.sqrt(own)
        value, turn = np.linalg.eigh(correlation / np.outer(scale, scale))
        common = value > edge
        loading = scale[:, None] * turn[:, common] * np.sqrt(value[common] - 1)
        before, own = own, np.maximum(1 - np.sum(loading**2, axis=1), LEAST_OWN)
        if np.max(np.abs(np.log(own / before))) < 1e-3:
            break
    return (loading @ loading.T + np.diag(own)) * np.outer(std, std)


def _shrink_towards(target: np.ndarray, sample: np.ndarray) -> np.ndarray:
    """Covariance (m, m) of rows of mean zero, drawn towards the target by as much as so few rows ask for (Ledoit & Wolf
    2004, of rows of unit covariance). Neighbouring differences share a block: three show what two rows would."""
    root = np.linalg.cholesky(target)
    x = linalg.solve_triangular(root, sample.T, lower=True).T
    n, found = len(x), x.T @ x / len(x)
    variance = 1.5 * ((x**2).T @ (x**2) / n - found**2) / n
    share = float(np.clip(np.sum(variance) / np.sum((found - np.eye(len(found))) ** 2), 0.02, 1.0))
    return root @ ((1 - share) * found + share * np.eye(len(found))) @ root.T


def _shrink_covariance(sample: np.ndarray) -> np.ndarray:
    """Covariance (m, m) of rows of mean zero, correlations shrunk by Schaefer & Strimmer's intensity."""
    n = len(sample)
    std = np.sqrt(np.mean(sample**2, axis=0))
    std = np.where(std > 0, std, 1.0)
    x = sample / std
    correlation = x.T @ x / n
    second = (x**2).T @ (x**2) / n
    variance = (second - correlation**2) / n
    off = ~np.eye(len(correlation), dtype=bool)
    total = np.sum(correlation[off] ** 2)
    share = 1.0 if total == 0 else float(np.clip(np.sum(variance[off]) / total, 0.02, 1.0))
    shrunk = (1 - share) * correlation + share * np.eye(len(correlation))
    return shrunk * np.outer(std, std)
