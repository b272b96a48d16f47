"""One number a block, followed along the record: does it go with a time profile, beyond noise and what drifts by
itself?

A series is s_b = offset + turning + a h_b + slow error + noise / sqrt(v_b). The noise is estimated from differences of
successive blocks, the slow error (Ornstein-Uhlenbeck, a sixth of the record long) by means over a dozen parts of it,
both after the time profile under test is taken out, so that an effect is not counted as its own scatter. a is by
weighted least squares, its standard deviation holds both. """

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from probupdate.diagnosis.time_profiles import TimeProfile
from probupdate.runtime.arrays import frozen_array

# length of slow errors over that of the record; parts whose means show their size, blocks in each
SLOW_LENGTH, N_PART, FEWEST_IN_PART = 1 / 6, 12, 3
# a value this many standard deviations from those around it is no change but a block gone wrong
OUTLIER, AROUND = 6.0, 2
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
    """(n_series, n_block) bool: blocks that stand apart from the blocks around them on both sides."""
    result = np.zeros(series.shape, bool)
    for k, (s, w) in enumerate(zip(series, weight, strict=True)):
        rows = np.flatnonzero(w > 0)
        if len(rows) < 2 * AROUND + 4:
            continue
        value = s[rows]
        padded = np.concatenate([value[AROUND:0:-1], value, value[-2 : -2 - AROUND : -1]])
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * AROUND + 1)
        residual = (value - np.median(windows, axis=1)) * np.sqrt(w[rows])
        spread = np.median(np.abs(residual)) / 0.6745
        result[k, rows] = np.abs(residual) > OUTLIER * max(spread, 1e-300)
    return result


def draw_slow(rng: np.random.Generator, hours: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """(*shape, n_block) slow errors of size one."""
    root = np.linalg.cholesky(slow_correlation(hours) + 1e-9 * np.eye(len(hours)))
    return frozen_array(rng.standard_normal((*shape, len(hours))) @ root.T)
