"""The search without a model: numbers followed along the record, their scores, and chance's largest.

A series, a frequency or what a sensor's effect would do, is s_b = offset + turning + a h_b + slow error + noise /
sqrt(v_b). The noise is estimated from differences of successive blocks, the slow error (Ornstein-Uhlenbeck, a sixth of
the record long) by means over a dozen parts of it, both after the time profile under test is taken out, so that an
effect is not counted as its own scatter. a is by weighted least squares, its standard deviation holds both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from probupdate.diagnosis.blocks import Blocks
from probupdate.diagnosis.empirical_reference import (
    EmpiricalReference,
    look,
    own_noise,
    residuals,
    signatures,
    stated_patterns,
    untied,
)
from probupdate.diagnosis.frequency_noise import FrequencyDirections, frequency_directions
from probupdate.diagnosis.noise import Noise, estimate_noise
from probupdate.diagnosis.search import exceeded, tail
from probupdate.diagnosis.time_profiles import TimeProfile
from probupdate.effects.catalogue import Effect
from probupdate.modal.modes import Sensor
from probupdate.runtime.arrays import frozen_array

# length of slow errors over that of the record; parts whose means show their size, blocks in each
SLOW_LENGTH, N_PART, FEWEST_IN_PART = 1 / 6, 12, 3
# a value this many standard deviations beyond those before and those after it, so many each, is no change but a block
# gone wrong
OUTLIER, AROUND = 6.0, 3
# a time profile that offset and turning explain to more than this is not distinguishable from them
LEFT = 0.05
# blocks asked for beside what is fitted
SPARE = 5


@dataclass(frozen=True, eq=False, kw_only=True)
class Contrasts:
    """What is done to a series of each of n_series kinds, whatever its values: per series the map to its residual,
    to time profile sizes, to differences and to means over parts. `usable` (n_series, n_profile)."""

    weight: np.ndarray  # (n_series, n_block), zero where not used
    nuisance: np.ndarray  # (n_block, n_nuisance)
    fit: np.ndarray  # (n_series, n_nuisance, n_block) coefficients of the nuisance
    time_profile: np.ndarray  # (n_series, n_profile, n_block) beyond the nuisance, zero where not used
    size: np.ndarray  # (n_series, n_profile, n_block)
    usable: np.ndarray
    before: tuple[np.ndarray, ...]  # per series: blocks whose successor follows in `after`
    after: tuple[np.ndarray, ...]
    part: np.ndarray  # (n_part, n_block) one where a block lies in a part of the record
    slow: np.ndarray  # (n_block, n_block) correlation of the slow error
    white_trace: np.ndarray  # (n_series, n_profile) what noise of size one adds to the parts' sum of squares
    slow_trace: np.ndarray  # (n_profile,) slow error, over the mean weight
    white_var: np.ndarray  # (n_series, n_profile) variance of a time profile's size for noise, slow error of size one
    slow_var: np.ndarray


def slow_correlation(hours: np.ndarray) -> np.ndarray:
    span = max(float(hours[-1] - hours[0]), 1e-9)
    return np.exp(-np.abs(hours[:, None] - hours[None, :]) / (SLOW_LENGTH * span))


def make_contrasts(
    weight: np.ndarray, nuisance: np.ndarray, time_profiles: Sequence[TimeProfile], hours: np.ndarray
) -> Contrasts:
    """weight (n_series, n_block), nuisance (n_block, n_nuisance) with the offset in it."""
    n_block = weight.shape[1]
    h = np.array([c.value for c in time_profiles]).reshape(-1, n_block)
    counted = weight > 0
    gram = np.einsum("np,kn,nq->kpq", nuisance, weight, nuisance, optimize=True)
    fit = np.linalg.pinv(gram, hermitian=True) @ (nuisance.T * weight[:, None, :])
    rest = np.where(counted[:, None, :], h - (fit @ h.T).transpose(0, 2, 1) @ nuisance.T, 0.0)
    sums = np.maximum(weight.sum(axis=1), 1e-300)
    total = weight @ (h**2).T - (weight @ h.T) ** 2 / sums[:, None]
    own = np.einsum("kcn,kn->kc", rest**2, weight)
    usable = (own > LEFT * np.maximum(total, 1e-300)) & (counted.sum(axis=1) >= nuisance.shape[1] + SPARE)[:, None]
    # on both sides of a step there must be blocks that count
    for c, time_profile in enumerate(time_profiles):
        if time_profile.kind == "step":
            before, after = counted[:, : time_profile.at], counted[:, time_profile.at :]
            usable[:, c] &= (before.sum(axis=1) >= 3) & (after.sum(axis=1) >= 3)
    size = np.where(usable[:, :, None], rest * weight[:, None, :] / np.where(usable, own, 1.0)[:, :, None], 0.0)
    beyond = rest
    rows = [np.flatnonzero(r) for r in counted]
    before, after = [r[:-1] for r in rows], [r[1:] for r in rows]
    slow = slow_correlation(hours)
    safe = np.where(weight > 0, weight, np.inf)
    n_part = int(np.clip(n_block // FEWEST_IN_PART, 2, N_PART))
    part = np.zeros((n_part, n_block))
    for row, blocks in zip(part, np.array_split(np.arange(n_block), n_part), strict=True):
        row[blocks] = 1.0
    white_trace = _white_trace(weight, part, nuisance, gram, beyond, own, usable)
    slow_trace = _slow_trace(part, nuisance, h, slow)
    return Contrasts(
        weight=weight, nuisance=nuisance, fit=fit, time_profile=beyond, size=size, usable=usable, before=tuple(before),
        after=tuple(after), part=part, slow=slow, white_trace=white_trace, slow_trace=slow_trace,
        white_var=np.sum(size**2 / safe[:, None, :], axis=2),
        slow_var=np.sum((size @ slow) * size, axis=2),
    )


def _white_trace(weight, part, nuisance, gram, beyond, own, usable) -> np.ndarray:
    """(n_series, n_profile) expected sum over parts of (weight in it) x (weighted mean of residuals)^2 for noise
    one."""
    held = weight @ part.T  # (n_series, n_part)
    safe = np.where(held > 0, held, np.inf)
    cross = np.einsum("np,kn,wn->kwp", nuisance, weight, part, optimize=True)
    taken = np.sum((cross @ np.linalg.pinv(gram, hermitian=True)) * cross, axis=2) / safe
    first = np.sum(held > 0, axis=1) - taken.sum(axis=1)
    time_profile = (beyond * weight[:, None, :]) @ part.T
    more = np.sum(time_profile**2 / safe[:, None, :], axis=2) / np.where(usable, own, 1.0)
    return first[:, None] - np.where(usable, more, 0.0)


def _slow_trace(part, nuisance, h, slow) -> np.ndarray:
    """(n_profile,) the same over the mean weight for a slow error of size one, with blocks of equal weight."""
    count = part.sum(axis=1)
    mean = part / count[:, None]
    keep = np.eye(len(nuisance)) - nuisance @ np.linalg.pinv(nuisance)
    first = mean @ keep
    result = []
    for time_profile in h:
        rest = keep @ time_profile
        own = rest @ rest
        C = first - np.outer(mean @ rest, rest) / own if own > 1e-12 * max(time_profile @ time_profile,
                                                                           1e-300) else first
        result.append(float(count @ np.sum((C @ slow) * C, axis=1)))
    return np.array(result)


@dataclass(frozen=True, eq=False, kw_only=True)
class Scores:
    """z, size and its standard deviation (..., n_series, n_profile); noise and slow_error (...,) the variances they
    rest on."""

    z: np.ndarray
    size: np.ndarray
    size_std: np.ndarray
    noise: np.ndarray
    slow_error: np.ndarray


def score(contrasts: Contrasts, series: np.ndarray, pools: Sequence[Sequence[int]]) -> Scores:
    """Of series (..., n_series, n_block). `pools`: series that share the ratio of slow error to noise; a dozen parts of
    one series alone show it too badly."""
    c = contrasts
    n_fit, n_profile = c.nuisance.shape[1], c.white_var.shape[1]
    shape = (*series.shape[:-1], n_profile)
    size, noise, ratio = np.zeros(shape), np.ones(shape), np.full(shape, np.nan)
    for k, (before, after) in enumerate(zip(c.before, c.after, strict=True)):
        w = c.weight[k]
        if not np.any(c.usable[k]):
            continue
        own = series[..., k, :]
        rest = np.where(w > 0, own - (own @ c.fit[k].T) @ c.nuisance.T, 0.0)
        a = own @ c.size[k].T
        scale = 1 / np.sqrt(1 / w[before] + 1 / w[after])
        difference = (rest[..., after] - rest[..., before]) * scale
        time_profile = (c.time_profile[k][:, after] - c.time_profile[k][:, before]) * scale
        # a step that is not under test is one large difference among many
        limit = 4 * np.median(np.abs(difference), axis=-1, keepdims=True) / 0.6745
        clipped = np.clip(difference, -limit, limit)
        plain = np.sum(clipped**2, axis=-1)[..., None]
        total = plain - 2 * a * (clipped @ time_profile.T) + a**2 * np.sum(time_profile**2, axis=1)
        # where the time profile's own difference is clipped, the plain sum is the better one
        noise[..., k, :] = np.clip(total, 0.05 * plain, plain) / max(len(before) - n_fit, 1)
        held = c.part @ w
        count = np.where(held > 0, held, np.inf)
        sums, of_profile = (rest * w) @ c.part.T, (c.time_profile[k] * w) @ c.part.T
        parts = (sums**2 @ (1 / count))[..., None] - 2 * a * ((sums / count) @ of_profile.T)
        parts = parts + a**2 * (of_profile**2 @ (1 / count))
        ratio[..., k, :] = (parts / noise[..., k, :] - c.white_trace[k]) / c.slow_trace
        size[..., k, :] = a
    slow = np.zeros(shape)
    for pool in pools:
        rows = [k for k in pool if np.any(c.usable[k])]
        if rows:
            shared = np.maximum(np.median(ratio[..., rows, :], axis=-2, keepdims=True), 0.0)
            typical = np.array([c.weight[k][c.weight[k] > 0].mean() for k in rows])
            slow[..., rows, :] = shared * noise[..., rows, :] / typical[:, None]
    variance = noise * c.white_var + slow * c.slow_var
    good = c.usable & (variance > 0)
    std = np.where(good, np.sqrt(np.where(good, variance, 1.0)), np.inf)
    return Scores(z=np.where(good, size / std, 0.0), size=size, size_std=std, noise=noise, slow_error=slow)


def outliers(series: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(n_series, n_block) bool: blocks that lie beyond those before them and those after them, in standard deviations
    by differences of successive blocks: what of noise alone were called so would be missing from its scatter."""
    result = np.zeros(series.shape, bool)
    for k, (s, w) in enumerate(zip(series, weight, strict=True)):
        rows = np.flatnonzero(w > 0)
        if len(rows) < 2 * AROUND + 4:
            continue
        value, root = s[rows], np.sqrt(w[rows])
        spread = np.median(np.abs(np.diff(value)) / np.hypot(1 / root[1:], 1 / root[:-1])) / 0.6745
        # of three each one may have gone wrong too
        padded = np.concatenate([value[AROUND:0:-1], value, value[-2 : -2 - AROUND : -1]])
        middle = np.median(np.lib.stride_tricks.sliding_window_view(padded, AROUND), axis=1)
        before, after = middle[: len(value)], middle[AROUND + 1 :]
        # between them it is on the way from one to the other
        apart = np.maximum(value - np.maximum(before, after), np.minimum(before, after) - value) * root
        result[k, rows] = apart > OUTLIER * max(spread, 1e-300)
    return result


# what a change of the structure may do to a frequency, or to the shape of a mode or pair, each as probable before:
# standard deviations of ln f, of real parts of shapes as shares of their largest component; phases stay
SPREAD_LOG, SPREAD_SHAPE = (0.0, 3e-4, 1e-3, 3e-3, 1e-2), (0.0, 1e-3, 3e-3, 1e-2, 3e-2)


def log_change_of_structure(
    rest: Sequence[np.ndarray], noise: Noise, nuisance: np.ndarray, time_profiles: Sequence[TimeProfile],
    sizes: Sequence[int],
) -> float:
    """ln Bayes factor of a change of the structure along one of the time profiles over none, of residuals `rest` per
    group (n_block, n_response). Times of a step share one prior. sizes: modes of each group."""
    return _of_any_profile(log_change_along(rest, noise, nuisance, time_profiles, sizes), time_profiles)


def log_change_along(
    rest: Sequence[np.ndarray], noise: Noise, nuisance: np.ndarray, time_profiles: Sequence[TimeProfile],
    sizes: Sequence[int],
) -> np.ndarray:
    """(n_profile,) the same of each time profile: frequencies and real parts of shapes move each by itself, by normal
    amounts over the profile's range."""
    h = np.array([c.value / max(float(np.ptp(c.value)), 1e-300) for c in time_profiles])
    directions = frequency_directions(rest, noise, sizes)
    n_log = [1 if k == 1 else 3 for k in sizes]
    logs = np.hstack([y[:, :n] for y, n in zip(rest, n_log, strict=True)]) @ directions.turn.T
    total = np.zeros(len(h))
    for own, weight in zip(logs.T, directions.weight(noise.weight), strict=True):
        total += _log_moved(own[:, None], np.ones(1), weight, h, nuisance, SPREAD_LOG)
    for y, covariance, weight, n in zip(rest, noise.covariance, noise.weight, n_log, strict=True):
        real = slice(n, n + (y.shape[1] - n) // 2)
        value, turn = np.linalg.eigh(covariance[real, real])
        total += _log_moved(y[:, real] @ turn, value, weight, h, nuisance, SPREAD_SHAPE)
    return total


def _log_moved(y: np.ndarray, variance: np.ndarray, weight: np.ndarray, h: np.ndarray, nuisance: np.ndarray,
               spreads: Sequence[float]) -> np.ndarray:
    """(n_profile,) ln Bayes factor of independent numbers y (n_block, n) that each move along h (n_profile, n_block) by
    normal amounts of one of the `spreads`; variance (n,) of each in a block of weight one."""
    root = np.sqrt(weight)
    scaled = (root * h).T
    own = scaled - (root[:, None] * nuisance) @ np.linalg.lstsq(root[:, None] * nuisance, scaled, rcond=None)[0]
    known = np.sum(own**2, axis=0)
    usable = known > LEFT * np.maximum(np.sum(scaled**2, axis=0), 1e-300)
    safe = np.where(usable, known, 1.0)[:, None]
    along = own.T @ (root[:, None] * y) / safe
    variance = np.maximum(variance, 1e-300) / safe
    ratio = np.array(spreads)[:, None, None] ** 2 / variance
    each = 0.5 * np.sum(along**2 / variance * ratio / (1 + ratio) - np.log1p(ratio), axis=2)
    return np.where(usable, logsumexp(each, axis=0) - np.log(len(spreads)), 0.0)


def log_common_change(
    rest: Sequence[np.ndarray], noise: Noise, nuisance: np.ndarray, time_profiles: Sequence[TimeProfile],
    sizes: Sequence[int],
) -> float:
    """The same where all frequencies move by one share and shapes stay, as where all of the structure warms."""
    h = np.array([c.value / max(float(np.ptp(c.value)), 1e-300) for c in time_profiles])
    score_of, known, whole = np.zeros(len(h)), np.zeros(len(h)), np.zeros(len(h))
    for y, covariance, weight, k in zip(rest, noise.covariance, noise.weight, sizes, strict=True):
        root = np.sqrt(weight)[:, None]
        scaled = root * h.T
        own = scaled - (root * nuisance) @ np.linalg.lstsq(root * nuisance, scaled, rcond=None)[0]
        n_log = 1 if k == 1 else 3
        toward = np.linalg.solve(covariance[:n_log, :n_log], np.array([1.0, 1.0, 0.0])[:n_log])
        score_of += own.T @ ((root * y[:, :n_log]) @ toward)
        known += np.sum(own**2, axis=0) * float(toward[:k].sum())
        whole += np.sum(scaled**2, axis=0) * float(toward[:k].sum())
    usable = known > LEFT * np.maximum(whole, 1e-300)
    ratio = np.array(SPREAD_LOG)[:, None] ** 2 * known
    each = 0.5 * (score_of**2 / np.where(usable, known, 1.0) * ratio / (1 + ratio) - np.log1p(ratio))
    return _of_any_profile(np.where(usable, logsumexp(each, axis=0) - np.log(len(SPREAD_LOG)), 0.0), time_profiles)


def _of_any_profile(log_factor: np.ndarray, time_profiles: Sequence[TimeProfile]) -> float:
    """ln Bayes factor of any of the time profiles from those of each; times of a step share one prior."""
    n_step = max(sum(c.kind == "step" for c in time_profiles), 1)
    prior = np.array([1 / n_step if c.kind == "step" else 1.0 for c in time_profiles])
    return float(logsumexp(log_factor, b=prior / prior.sum()))


def log_density(rest: Sequence[np.ndarray], noise: Noise) -> float:
    """ln density of residuals per group (n_block, n_response), but for a constant of the noise."""
    return -0.5 * sum(float(np.sum((y @ P) * y, axis=1) @ w)
                      for y, P, w in zip(rest, noise.precision, noise.weight, strict=True))


def draw_slow(rng: np.random.Generator, hours: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """(*shape, n_block) slow errors of size one."""
    root = np.linalg.cholesky(slow_correlation(hours) + 1e-9 * np.eye(len(hours)))
    return frozen_array(rng.standard_normal((*shape, len(hours))) @ root.T)


# of the whole search; below 5 %, as a bootstrap of so many records knows its own quantiles to a few tenths
FALSE_ALARM = 0.03
# records drawn, and drawn with their noise estimated anew
N_BOOTSTRAP, N_AGAIN = 400, 20
# number of the series in which all groups are taken together, and of those along independent directions of all
# frequencies; in a pair's four, that of the mean of its two
ALL, DIRECTION, MEAN = -1, -2, 3
# numbers drawn at a time
CHUNK = 3_000_000


@dataclass(frozen=True, eq=False, kw_only=True)
class Followed:
    """What is followed along the record: series (n_series, n_block) with their weight; the first `n_frequency` are
    numbers of the frequencies, first single ones and then along the independent `directions` of all, the others one of
    `effects` each."""

    blocks: Blocks
    empirical: EmpiricalReference
    noise: Noise
    stated: Sequence[np.ndarray | None]
    prints: tuple[np.ndarray, ...]
    effects: tuple[Effect, ...]
    names: tuple[tuple[int, int], ...]
    directions: FrequencyDirections
    series: np.ndarray
    weight: np.ndarray

    @property
    def n_frequency(self) -> int:
        return len(self.names)

    @property
    def along_directions(self) -> slice:
        """Series along the directions."""
        return slice(self.n_frequency - len(self.directions.turn), self.n_frequency)

    @property
    def classes(self) -> tuple[list[int], list[int]]:
        """Series of frequencies, of sensors."""
        return list(range(self.n_frequency)), list(range(self.n_frequency, len(self.series)))

    @property
    def pools(self) -> tuple[list[int], ...]:
        """Series that share how large slow errors are beside noise: a group's frequencies, all of sensors. What drifts
        slowly along one direction of the frequencies need not along another."""
        groups: dict[tuple[int, int], list[int]] = {}
        for k, (q, i) in enumerate(self.names):
            groups.setdefault((q, i if q == DIRECTION else 0), []).append(k)
        return (*groups.values(), *filter(len, self.classes[1:]))


def watch(
    blocks: Blocks, effects: Sequence[Effect], sensors: Sequence[Sensor], known: np.ndarray,
    time_profile: np.ndarray | None = None,
) -> Followed:
    """The series of these blocks. known (n_block, n_known): time profiles along which anything may change;
    `time_profile`: see `look`."""
    empirical = look(blocks, sensors, time_profile)
    stated = stated_patterns(blocks, empirical)
    rest = residuals(empirical, known)
    noise = own_noise(blocks, empirical, rest, stated)
    prints = signatures(effects, empirical)
    sizes = [len(g) for g in blocks.groups]
    directions = frequency_directions(rest, noise, sizes)
    series, weight = follow(rest, empirical, noise, prints, sizes, directions)
    apart = outliers(series, weight)
    weight = np.where(apart, 0.0, weight)
    names = tuple((q, i) for q, g in enumerate(blocks.groups) for i in range(1 if len(g) == 1 else 4))
    names = (*names, (ALL, 0)) if len(blocks.groups) > 1 else names
    names = (*names, *((DIRECTION, k) for k in range(len(directions.turn))))
    return Followed(
        blocks=blocks,
        empirical=empirical,
        noise=noise,
        stated=stated,
        prints=prints,
        effects=tuple(effects),
        names=names,
        directions=directions,
        series=frozen_array(np.where(apart, 0.0, series)),
        weight=frozen_array(weight),
    )


def follow(
    differences, empirical: EmpiricalReference, noise: Noise, prints, sizes, directions: FrequencyDirections
) -> tuple[np.ndarray, np.ndarray]:
    """series (..., n_series, n_block), weight (n_series, n_block) of residuals per group (..., n_block, n_response):
    numbers of the frequencies as `_of_frequencies`, then the size of each effect that fits each block best."""
    lead = differences[0].shape[:-2]
    n_block, n_effect = len(empirical.sector_of), prints[0].shape[2]
    score_of, information = np.zeros((*lead, n_effect, n_block)), np.zeros((n_effect, n_block))
    logs = []
    for q, (y, P, w) in enumerate(zip(differences, noise.precision, noise.weight, strict=True)):
        n_log = 1 if sizes[q] == 1 else 3
        logs.append(np.where(w > 0, np.swapaxes(y[..., :n_log], -1, -2), 0.0))
        for s in range(len(prints[q])):
            rows = np.flatnonzero((empirical.sector_of == s) & (w > 0))
            PF = P @ prints[q][s]
            score_of[..., rows] += np.swapaxes(y[..., rows, :] @ PF, -1, -2) * w[rows]
            information[:, rows] += np.sum(prints[q][s] * PF, axis=0)[:, None] * w[rows]
    along = directions.turn @ np.concatenate(logs, axis=-2)
    single, weights = _of_frequencies(along, noise, directions)
    sizes_found = np.where(information > 0, score_of / np.where(information > 0, information, 1.0), 0.0)
    return (np.concatenate([single, along, sizes_found], axis=-2),
            np.concatenate([weights, directions.weight(noise.weight), information]))


def _of_frequencies(along: np.ndarray, noise: Noise, directions: FrequencyDirections) -> tuple[np.ndarray, np.ndarray]:
    """Series (..., n, n_block) with weight (n, n_block) of single frequencies, of a pair also their mean, and of the
    mean of all where there are several, from those along the directions (..., n_direction, n_block)."""
    logs = np.swapaxes(directions.turn, 0, 1) @ along
    frequencies, weights = [], []
    for q, (own_covariance, w) in enumerate(zip(noise.covariance, noise.weight, strict=True)):
        at = np.flatnonzero(directions.group_of == q)
        own, covariance = np.where(w > 0, logs[..., at, :], 0.0), own_covariance[: len(at), : len(at)]
        variance = np.diag(covariance)
        if len(at) == 3:
            own = np.concatenate([own, 0.5 * (own[..., :1, :] + own[..., 1:2, :])], axis=-2)
            variance = np.append(variance, 0.25 * covariance[:2, :2].sum())
        frequencies.append(own)
        weights.append(w / variance[:, None])
    if len(frequencies) > 1:
        # the last row of each group is its frequency, or the pair's mean
        share = np.array([w[-1] for w in weights])
        together = np.sum([f[..., -1, :] * w for f, w in zip(frequencies, share, strict=True)], axis=0)
        total = share.sum(axis=0)
        frequencies.append(np.where(total > 0, together / np.where(total > 0, total, 1.0), 0.0)[..., None, :])
        weights.append(total[None])
    return np.concatenate(frequencies, axis=-2), np.concatenate(weights)


def judged(z: np.ndarray, followed: Followed) -> np.ndarray:
    """Scores (..., n_series, n_profile) with those along the directions of the frequencies taken together: their sum of
    squares as the standard normal variable of the same probability (signed root of its rate function), at each of
    them; zero where it is not known how they scatter together."""
    at = followed.along_directions
    if not followed.directions.joint:
        result = np.array(z)
        result[..., at, :] = 0.0
        return result
    usable = np.maximum(np.count_nonzero(z[..., at, :], axis=-2), 1)
    square = np.maximum(np.sum(z[..., at, :] ** 2, axis=-2), usable)
    together = np.sqrt(square - usable - usable * np.log(square / usable))
    result = np.array(z)
    result[..., at, :] = together[..., None, :]
    return result


def allowed_profiles(followed: Followed, time_profiles: Sequence[TimeProfile]) -> np.ndarray:
    """(n_series, n_profile) bool: frequencies may go with all, sensors with those of their row."""
    result = np.ones((len(followed.series), len(time_profiles)), bool)
    for k, effect in enumerate(followed.effects):
        result[followed.n_frequency + k] = [c.name in effect.time_profiles for c in time_profiles]
    return result


@dataclass(frozen=True, eq=False, kw_only=True)
class Found:
    """Scores at one stage; z with zeros where a candidate is not allowed, over the threshold of its class
    (frequencies, sensors); p of the largest."""

    contrasts: Contrasts
    scores: Scores
    z: np.ndarray
    threshold: np.ndarray  # (n_series,)
    p_value: float

    @property
    def over(self) -> np.ndarray:
        """(n_series, n_profile) |z| over the threshold."""
        return np.abs(self.z) / self.threshold[:, None]


def search(
    followed: Followed,
    time_profiles: Sequence[TimeProfile],
    known: np.ndarray,
    seed: int,
    false_alarm: float = FALSE_ALARM / 2,
) -> Found:
    """All candidates, and how large the largest is when nothing changes (drawn with the record's own scatter).
    `false_alarm` of each of the two classes."""
    nuisance = followed.empirical.nuisance(known)
    contrasts = make_contrasts(followed.weight, nuisance, time_profiles, followed.blocks.hours)
    allowed = allowed_profiles(followed, time_profiles)
    pools = followed.pools
    scores = score(contrasts, followed.series, pools)
    z = judged(np.where(allowed, scores.z, 0.0), followed)
    maxima = _maxima(followed, contrasts, allowed, scores, z, time_profiles, nuisance, seed)
    threshold, p = np.full(len(z), np.inf), []
    for rows, drawn in zip(followed.classes, maxima, strict=True):
        if len(rows):
            threshold[rows] = exceeded(drawn, false_alarm)
            p.append(tail(drawn, float(np.max(np.abs(z[rows])))))
    return Found(contrasts=contrasts, scores=scores, z=z, threshold=frozen_array(threshold),
                 p_value=min(1.0, min(p) * FALSE_ALARM / false_alarm))


def _maxima(followed, contrasts, allowed, scores, z, time_profiles, nuisance, seed) -> list[np.ndarray]:
    """Per class the largest |z| of records in which nothing changes."""
    rng = np.random.default_rng([seed, 31])
    slow, lift = np.zeros(len(z)), np.ones(len(z))
    for pool in followed.pools:
        # as they are once the pool's best candidate is out
        best = int(np.argmax(np.max(np.abs(scores.z[pool]), axis=0)))
        slow[pool], lift[pool] = np.sqrt(scores.slow_error[pool, best]), scores.noise[pool, best]
    noise, sizes, pools = followed.noise, [len(g) for g in followed.blocks.groups], followed.pools
    roots = [np.linalg.cholesky(c) for c in noise.covariance]
    n_block = len(followed.blocks)
    scale = [np.where(w > 0, 1 / np.sqrt(np.maximum(w, 1e-12)), 0.0) for w in noise.weight]
    chunk = max(1, CHUNK // (n_block * max(len(z), sum(len(r) for r in roots))))

    def draw(n):
        drawn = [rng.standard_normal((n, n_block, len(r))) @ r.T * s[:, None]
                 for r, s in zip(roots, scale, strict=True)]
        # frequencies scatter together
        logs = followed.directions.draw(rng, (n, n_block))
        for q, y in enumerate(drawn):
            at = np.flatnonzero(followed.directions.group_of == q)
            y[..., : len(at)] = logs[..., at] * scale[q][:, None]
        return drawn

    def largest(used: Contrasts, series):
        z = score(used, np.where(followed.weight > 0, series, 0.0), pools).z
        found = np.abs(judged(np.where(allowed, z, 0.0), followed))
        return [found[..., c, :].max(axis=(-2, -1)) if len(c) else np.zeros(found.shape[:-2]) for c in followed.classes]

    maxima, typical = [], None
    for start in range(0, N_BOOTSTRAP, chunk):
        n = min(chunk, N_BOOTSTRAP - start)
        series, _ = follow(draw(n), followed.empirical, noise, followed.prints, sizes, followed.directions)
        # noise as large as this record's differences say
        if typical is None:
            typical = np.median(score(contrasts, series, pools).noise[..., 0], axis=0)
        series = series * np.sqrt(lift / typical)[:, None]
        series = series + slow[:, None] * draw_slow(rng, followed.blocks.hours, (n, len(z)))
        at = followed.along_directions
        series[..., : at.start, :] = _of_frequencies(series[..., at, :], noise, followed.directions)[0]
        maxima.append(largest(contrasts, series))
    together = [np.concatenate(m) for m in zip(*maxima, strict=True)]
    # noise is estimated from the record it is used for: the whole once more, a few times
    again = []
    for _ in range(N_AGAIN):
        y = [d[0] for d in draw(1)]
        own = untied(estimate_noise(tuple(y), followed.empirical.used, tuple(sizes), followed.blocks.relative_std,
                                    followed.blocks.states(), followed.stated,
                                    std_alone=followed.blocks.std_alone), sizes)
        series, weight = follow(y, followed.empirical, own, followed.prints, sizes,
                                frequency_directions(y, own, sizes))
        renewed = make_contrasts(np.where(followed.weight > 0, weight, 0.0), nuisance, time_profiles,
                                 followed.blocks.hours)
        again.append(largest(renewed, series))
    plain = [np.mean(m) for m in together]
    return [m * max(1.0, float(np.mean([a[k] for a in again]) / max(plain[k], 1e-300)))
            for k, m in enumerate(together)]
