"""Which gain, sign or exchange of channels, or motion of their own, makes what they see the motion of a reference.

The evidence of directions (`directions`) is a closed form of the factor that takes a gain back; its maximum is found by
quadratics in turn, one for each sign, and its integral over heavy-tailed gains by Laplace's method. Channels as they
should be differ by what calibrations leave, and by the reference's own error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import entr, softmax

from probupdate.evidence.directions import ERRORS, log_evidence

# probabilities before, over that of nothing and shared by the channels or groups that it may be: a wrong gain, an
# exchange, a motion of its own; of wrong gains: size, sign, both
GAIN, EXCHANGE, OWN_MOTION = 0.5, 0.05, 0.01
SIZE, SIGN, BOTH = 0.5, 0.4, 0.1
# of gains: half of their logarithms lie within this (Cauchy)
GAIN_SCALE = 0.3
# gains of sound sensors differ by so much (one standard deviation): calibrations to 1 %
ALIKE = 0.01
# directions in which sensors see less than this of a motion give no information on it
LEAST_SEEN = 1e-3
# turns in which a gain is found, when it stands, and step of its logarithm for the curvature
TURNS, CONVERGED, STEP = 30, 1e-6, 1e-3


@dataclass(frozen=True, kw_only=True)
class Explanation:
    """kind: '' (nothing), 'gain', 'exchange' or 'own motion' of the members (indices); gain: as recorded over as it
    should be, std its standard deviation; log: ln probability up to a constant."""

    kind: str
    members: tuple[int, ...]
    log: float
    gain: float = 1.0
    std: float = 0.0


def explanations(
    samples: np.ndarray, motion: np.ndarray, groups: Sequence[tuple[int, ...]],
    pairs: Sequence[tuple[int, int]] = (), *, count: float | None = None, noise: np.ndarray | float = 0.0,
) -> list[Explanation]:
    """samples (n_sample, n_channel) what was seen, each a direction; motion (n_channel, r), or of each sample
    (n_sample, n_channel, r), what the reference lets happen; groups of channels that may together have a gain or a
    motion of their own, pairs that may be exchanged; count: for how many independent ones each sample counts (None:
    `independent_count`); noise (n_sample,) standard deviation known of each, its size 1. The first is nothing, with the
    gains of sound channels."""
    samples = samples / np.linalg.norm(samples, axis=1)[:, None]
    count = independent_count(samples) / len(samples) if count is None else count
    seen = _SeenMotion(motion=_orthonormal(motion), count=count, noise=noise)
    nothing, found = [seen.log(samples)], []
    for group in groups:
        kept = samples.copy()
        kept[:, list(group)] = 0
        own = np.broadcast_to(np.eye(samples.shape[1])[:, list(group)], (*motion.shape[:-1], len(group)))
        apart = replace(seen, motion=_orthonormal(np.concatenate([seen.motion, own], axis=-1)))
        found.append(Explanation(kind="own motion", members=group,
                                 log=apart.log(samples) + np.log(OWN_MOTION / len(groups))))
        sound, gains = _gains(seen, kept, samples - kept, group, np.log(GAIN / len(groups)))
        nothing, found = [*nothing, *sound], [*found, *gains]
    for i, j in pairs:
        changed = samples.copy()
        changed[:, [i, j]] = samples[:, [j, i]]
        found.append(Explanation(kind="exchange", members=(i, j),
                                 log=seen.log(changed) + np.log(EXCHANGE / len(pairs))))
    return [Explanation(kind="", members=(), log=max(nothing)), *found]


def independent_count(samples: np.ndarray) -> float:
    """How many independent motions samples (n_sample, n_channel) are, whatever the channels' units: those of one motion
    say the same. The exponential of the entropy of their shares (Roy & Vetterli 2007)."""
    share = np.linalg.svd(samples / np.linalg.norm(samples, axis=0), compute_uv=False) ** 2
    return float(np.exp(np.sum(entr(share / share.sum()))))


def outside_share(samples: np.ndarray, motion: np.ndarray) -> float:
    """Mean share of samples (n_sample, n_channel) outside motion (n_channel, r), each sample of one size."""
    outside = _reject_motion(samples, _orthonormal(motion))
    return float(np.mean(np.sum(outside**2, axis=1) / np.sum(samples**2, axis=1)))


def _orthonormal(motion: np.ndarray) -> np.ndarray:
    """Directions (..., n, r) of motion; those that sensors do not see are zero."""
    left, value, _ = np.linalg.svd(motion, full_matrices=False)
    return left * (value > LEAST_SEEN * value[..., :1])[..., None, :]


def _reject_motion(samples: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """(n_sample, n) part of samples outside motion, of all or of each."""
    each = samples[:, None, :]
    return (each - each @ motion @ np.swapaxes(motion, -1, -2))[:, 0]


@dataclass(frozen=True, eq=False, kw_only=True)
class _SeenMotion:
    """motion (..., n, r) orthonormal or zero; for how many independent ones each sample counts; noise of each."""

    motion: np.ndarray
    count: float
    noise: np.ndarray | float

    @property
    def rank(self) -> np.ndarray:
        return np.rint(np.sum(self.motion**2, axis=(-2, -1)))

    def log(self, samples: np.ndarray) -> float:
        outside = np.sum(_reject_motion(samples, self.motion) ** 2, axis=1)
        return float(log_evidence(outside, np.array(samples.shape[1]), self.rank, count=self.count, noise=self.noise))


def _gains(
    seen: _SeenMotion, rest: np.ndarray, own: np.ndarray, group: tuple[int, ...], log_odds: float
) -> tuple[list[float], list[Explanation]]:
    """ln evidence of a sound gain of the group, and its wrong gains of either sign; samples are the sum of `rest` and
    `own`. Nothing where nothing redundant sees the group."""
    a, b, c = (np.sum(_reject_motion(x, seen.motion) * y, axis=1) for x, y in ((rest, rest), (rest, own), (own, own)))
    d, e = np.sum(rest**2, axis=1), np.sum(own**2, axis=1)
    (m, n), r = rest.shape, seen.rank
    if c.sum() < LEAST_SEEN**2 * e.sum():
        return [], []
    variance = ERRORS[:, None] ** 2 + np.square(seen.noise) * np.ones(m)
    known = np.sum((n - r) * np.log(variance), axis=1)

    def log(factor: float) -> float:
        evidence = log_evidence(a + 2 * b * factor + c * factor**2, np.array(n), r, size=d + e * factor**2,
                                count=seen.count, noise=seen.noise)
        return float(evidence) + seen.count * m * len(group) * np.log(abs(factor))

    found = []
    for sign in (1.0, -1.0):
        factor = sign
        for _ in range(TURNS):
            outside = a + 2 * b * factor + c * factor**2
            spread = d + e * factor**2 - outside + outside / variance
            share = softmax(-0.5 * seen.count * (known + n * np.log(spread).sum(axis=1)))
            within, across = share @ (1 / spread), share @ ((1 / variance - 1) / spread)
            square, linear = n * (e @ within + c @ across), n * (b @ across)
            last, factor = factor, (-linear + sign * np.sqrt(linear**2 + 4 * square * m * len(group))) / (2 * square)
            if abs(factor / last - 1) < CONVERGED:
                break
        top, move = log(factor), -np.log(abs(factor))
        curvature = (2 * top - log(factor * np.exp(STEP)) - log(factor * np.exp(-STEP))) / STEP**2
        std = min(1 / np.sqrt(max(curvature, GAIN_SCALE**-2)), GAIN_SCALE)
        total = std**2 + ALIKE**2
        # a normal density of sound gains, a Cauchy density of wrong ones
        peak = top + np.log(std) + 0.5 * np.log(2 * np.pi)
        sound = peak - 0.5 * (move**2 / total + np.log(2 * np.pi * total))
        wrong = peak - np.log(np.pi * GAIN_SCALE * (1 + (move / GAIN_SCALE) ** 2))
        found.append((sound, wrong, 1 / factor, np.sqrt(total) / abs(factor)))
    (sound, wrong, *positive), (reversed_sign, negative, *other) = found
    return [sound], [
        Explanation(kind="gain", members=group, log=log_odds + np.log(SIZE) + wrong, gain=positive[0], std=positive[1]),
        Explanation(kind="gain", members=group, gain=other[0], std=other[1],
                    log=log_odds + np.logaddexp(np.log(SIGN) + reversed_sign, np.log(BOTH) + negative))]
