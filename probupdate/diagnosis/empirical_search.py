"""The search without a model: series of frequencies and of sensors' effects, their scores, and chance's largest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from probupdate.diagnosis.along_record import Contrasts, Scores, draw_slow, make_contrasts, outliers, score
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
from probupdate.diagnosis.noise import Noise, estimate_noise
from probupdate.diagnosis.search import exceeded, tail
from probupdate.diagnosis.time_profiles import TimeProfile
from probupdate.effects.catalogue import Effect
from probupdate.modal.modes import Sensor
from probupdate.runtime.arrays import frozen_array

# of the whole search; below 5 %, as a bootstrap of so many records knows its own quantiles to a few tenths
FALSE_ALARM = 0.03
# records drawn, and drawn with their noise estimated anew
N_BOOTSTRAP, N_AGAIN = 400, 20
# number of the series in which all groups are taken together; in a pair's four, that of the mean of its two
ALL, MEAN = -1, 3
# numbers drawn at a time
CHUNK = 3_000_000


@dataclass(frozen=True, eq=False, kw_only=True)
class Followed:
    """What is followed along the record: series (n_series, n_block) with their weight; the first `n_frequency` are
    numbers of the frequencies, the others one of `effects` each. `raw` as series, before outliers were taken out."""

    blocks: Blocks
    empirical: EmpiricalReference
    noise: Noise
    stated: Sequence[np.ndarray | None]
    prints: tuple[np.ndarray, ...]
    effects: tuple[Effect, ...]
    names: tuple[tuple[int, int], ...]
    series: np.ndarray
    weight: np.ndarray

    @property
    def n_frequency(self) -> int:
        return len(self.names)

    @property
    def classes(self) -> tuple[list[int], list[int]]:
        """Series of frequencies, of sensors."""
        return list(range(self.n_frequency)), list(range(self.n_frequency, len(self.series)))

    @property
    def pools(self) -> tuple[list[int], ...]:
        """Series that share how large slow errors are beside noise: a group's frequencies, all of sensors."""
        groups = {q: [k for k, (p, _) in enumerate(self.names) if p == q] for q, _ in self.names}
        return (*groups.values(), *filter(len, self.classes[1:]))


def watch(
    blocks: Blocks, effects: Sequence[Effect], sensors: Sequence[Sensor], known: np.ndarray,
    stated: Sequence[np.ndarray | None] | None = None, time_profile: np.ndarray | None = None,
) -> Followed:
    """The series of these blocks. known (n_block, n_known): time profiles along which anything may change. `stated` of
    an earlier look; `time_profile`: see `own_picture.look`."""
    empirical = look(blocks, sensors, time_profile)
    stated = stated_patterns(blocks, empirical) if stated is None else stated
    rest = residuals(empirical, known)
    noise = own_noise(blocks, empirical, rest, stated)
    prints = signatures(effects, empirical)
    series, weight = follow(rest, empirical, noise, prints, [len(g) for g in blocks.groups])
    apart = outliers(series, weight)
    weight = np.where(apart, 0.0, weight)
    names = tuple((q, i) for q, g in enumerate(blocks.groups) for i in range(1 if len(g) == 1 else 4))
    names = (*names, (ALL, 0)) if len(blocks.groups) > 1 else names
    return Followed(
        blocks=blocks,
        empirical=empirical,
        noise=noise,
        stated=stated,
        prints=prints,
        effects=tuple(effects),
        names=names,
        series=frozen_array(np.where(apart, 0.0, series)),
        weight=frozen_array(weight),
    )


def follow(differences, empirical: EmpiricalReference, noise: Noise, prints, sizes) -> tuple[np.ndarray, np.ndarray]:
    """series (..., n_series, n_block), weight (n_series, n_block) of residuals per group (..., n_block, n_response):
    numbers of frequencies (of a pair also their mean, and the mean of all), then the size of each effect that fits each
    block best."""
    lead = differences[0].shape[:-2]
    n_block, n_effect = len(empirical.sector_of), prints[0].shape[2]
    score_of, information = np.zeros((*lead, n_effect, n_block)), np.zeros((n_effect, n_block))
    frequencies, weights = [], []
    for q, (y, P, w) in enumerate(zip(differences, noise.precision, noise.weight, strict=True)):
        n_log = 1 if sizes[q] == 1 else 3
        covariance = noise.covariance[q][:n_log, :n_log]
        own = np.where(w > 0, np.swapaxes(y[..., :n_log], -1, -2), 0.0)
        if n_log == 3:
            own = np.concatenate([own, 0.5 * (own[..., :1, :] + own[..., 1:2, :])], axis=-2)
            mean_var = np.array([0.25 * covariance[:2, :2].sum()])
        else:
            mean_var = np.zeros(0)
        frequencies.append(own)
        weights.append(w / np.concatenate([np.diag(covariance), mean_var])[:, None])
        for s in range(len(prints[q])):
            rows = np.flatnonzero((empirical.sector_of == s) & (w > 0))
            PF = P @ prints[q][s]
            score_of[..., rows] += np.swapaxes(y[..., rows, :] @ PF, -1, -2) * w[rows]
            information[:, rows] += np.sum(prints[q][s] * PF, axis=0)[:, None] * w[rows]
    if len(differences) > 1:
        # the last row of each group is its frequency, or the pair's mean
        share = np.array([w[-1] for w in weights])
        together = np.sum([f[..., -1, :] * w for f, w in zip(frequencies, share, strict=True)], axis=0)
        total = share.sum(axis=0)
        frequencies.append(np.where(total > 0, together / np.where(total > 0, total, 1.0), 0.0)[..., None, :])
        weights.append(total[None])
    sizes_found = np.where(information > 0, score_of / np.where(information > 0, information, 1.0), 0.0)
    return np.concatenate([*frequencies, sizes_found], axis=-2), np.concatenate([*weights, information])


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
    nuisance = np.column_stack([np.ones(len(followed.blocks)), followed.empirical.turning, known])
    contrasts = make_contrasts(followed.weight, nuisance, time_profiles, followed.blocks.hours)
    allowed = allowed_profiles(followed, time_profiles)
    pools = followed.pools
    scores = score(contrasts, followed.series, pools)
    z = np.where(allowed, scores.z, 0.0)
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
        best = int(np.argmax(np.max(np.abs(z[pool]), axis=0)))
        slow[pool], lift[pool] = np.sqrt(scores.slow_error[pool, best]), scores.noise[pool, best]
    noise, sizes, pools = followed.noise, [len(g) for g in followed.blocks.groups], followed.pools
    roots = [np.linalg.cholesky(c) for c in noise.covariance]
    n_block = len(followed.blocks)
    scale = [np.where(w > 0, 1 / np.sqrt(np.maximum(w, 1e-12)), 0.0) for w in noise.weight]
    chunk = max(1, CHUNK // (n_block * max(len(z), sum(len(r) for r in roots))))

    def draw(n):
        return [rng.standard_normal((n, n_block, len(r))) @ r.T * s[:, None] for r, s in zip(roots, scale, strict=True)]

    def largest(used: Contrasts, series):
        found = np.where(allowed, np.abs(score(used, np.where(followed.weight > 0, series, 0.0), pools).z), 0.0)
        return [found[..., c, :].max(axis=(-2, -1)) if len(c) else np.zeros(found.shape[:-2]) for c in followed.classes]

    maxima, typical = [], None
    for start in range(0, N_BOOTSTRAP, chunk):
        n = min(chunk, N_BOOTSTRAP - start)
        series, _ = follow(draw(n), followed.empirical, noise, followed.prints, sizes)
        # noise as large as this record's differences say
        if typical is None:
            typical = np.median(score(contrasts, series, pools).noise[..., 0], axis=0)
        series = series * np.sqrt(lift / typical)[:, None]
        maxima.append(largest(contrasts, series + slow[:, None] * draw_slow(rng, followed.blocks.hours, (n, len(z)))))
    together = [np.concatenate(m) for m in zip(*maxima, strict=True)]
    # noise is estimated from the record it is used for: the whole once more, a few times
    again = []
    for _ in range(N_AGAIN):
        y = [d[0] for d in draw(1)]
        own = untied(estimate_noise(tuple(y), followed.empirical.used, tuple(sizes), followed.blocks.relative_std,
                                    followed.blocks.states(), followed.stated), sizes)
        series, weight = follow(y, followed.empirical, own, followed.prints, sizes)
        renewed = make_contrasts(np.where(followed.weight > 0, weight, 0.0), nuisance, time_profiles,
                                 followed.blocks.hours)
        again.append(largest(renewed, series))
    plain = [np.mean(m) for m in together]
    return [m * max(1.0, float(np.mean([a[k] for a in again]) / max(plain[k], 1e-300)))
            for k, m in enumerate(together)]
