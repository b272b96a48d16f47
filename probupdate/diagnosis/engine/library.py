"""What may move numbers along a record: effects of one size each, and what no row of the catalogue describes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from probupdate.diagnosis.engine.evidence import ProfileInformation, scale_mean
from probupdate.diagnosis.evidence import log_weight_of_size
from probupdate.diagnosis.time_profiles import TimeProfile
from probupdate.effects.catalogue import Effect

# candidates of one size whose evidence is computed, those of the largest gain to first order
MOST_WEIGHED = 24


@dataclass(frozen=True, eq=False, kw_only=True)
class Unknown:
    """ln Bayes factors (n_profile,) over nothing of what no row describes: `frequencies` (all by one share, each by an
    amount of one scale, or of its own); with them the real parts of shapes, as where a structure changes; with these
    also phases."""

    frequencies: np.ndarray
    structure: np.ndarray
    everything: np.ndarray

    @property
    def any_unknown(self) -> np.ndarray:
        """Of any: frequencies alone are as probable before as both others."""
        return logsumexp([self.frequencies, self.structure, self.everything], axis=0, b=_SHARES)


# the simplest of three is as probable before as both others
_SHARES = np.array([[0.5], [0.25], [0.25]])


def log_unknown(
    frequencies: ProfileInformation, shapes: ProfileInformation, real: Sequence[np.ndarray],
    imaginary: Sequence[np.ndarray],
) -> Unknown:
    """`frequencies`: numbers in sequence, of which only the first moves with one share of all; per group `real` and
    `imaginary`: the numbers of `shapes`, with one scale a group."""
    each, moved = frequencies.log_moved(), shapes.log_moved()
    ways = np.array([scale_mean(each[:, 0]), scale_mean(np.sum(each, axis=1)), np.sum(scale_mean(each), axis=0)])
    own = logsumexp(ways, axis=0, b=_SHARES)

    def free(parts: Sequence[np.ndarray]) -> np.ndarray:
        return sum((scale_mean(np.sum(moved[:, rows], axis=1)) for rows in parts), np.zeros(moved.shape[2]))

    structure = own + free(real)
    return Unknown(frequencies=own, structure=structure, everything=structure + free(imaginary))


def sizes(along: ProfileInformation, signature: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n_effect, n_profile) sizes and standard deviations of effects of signatures (n_number, n_effect) by weighted
    least squares, infinite where nothing shows them."""
    amount, variance = along.amounts
    precision = np.where(np.isfinite(variance), 1 / np.where(np.isfinite(variance), variance, 1.0), 0.0)
    information = (signature**2).T @ precision
    shown = information > 0
    size = np.where(shown, (signature.T @ (amount * precision)) / np.where(shown, information, 1.0), 0.0)
    return size, np.where(shown, 1 / np.sqrt(np.where(shown, information, 1.0)), np.inf)


@dataclass(frozen=True, eq=False, kw_only=True)
class EffectGains:
    """Effects of one size beside nothing: `rows` (n, 2) effect and profile of those with the largest gain, `log`
    (n,) their ln Bayes factors; size and size_std (n_effect, n_profile)."""

    rows: np.ndarray
    log: np.ndarray
    size: np.ndarray
    size_std: np.ndarray


def weigh(
    along: ProfileInformation, effects: Sequence[Effect], signature: np.ndarray, profiles: Sequence[TimeProfile],
    span: np.ndarray,
) -> EffectGains:
    """Effects (signature (n_number, n_effect)) along the profiles of range `span` (n_profile,) that their rows allow.
    """
    size, std = sizes(along, signature)
    can = np.array([[c.name in e.time_profiles for c in profiles] for e in effects]).reshape(size.shape)
    can &= np.isfinite(std)
    for e, row in enumerate(effects):
        can[e] &= np.where(size[e] < 0, row.lower < 0, row.upper > 0)
    gain = np.where(can, (size / std) ** 2, 0.0)
    order = np.argsort(-gain, axis=None)[: min(MOST_WEIGHED, int(np.count_nonzero(can)))]
    rows = np.column_stack(np.unravel_index(order, gain.shape))
    log = np.array([
        along.log_of_size(signature[:, e], h, size[e, h])
        + min(0.0, log_weight_of_size(effects[e], size[e, h] / span[h], std[e, h] / span[h]))
        for e, h in rows])
    return EffectGains(rows=rows, log=log, size=size, size_std=std)
