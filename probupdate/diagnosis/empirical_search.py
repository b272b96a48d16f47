"""The record's own mean as what is expected: its numbers in independent directions, and what the engine says of
them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import logsumexp

from probupdate.diagnosis.blocks import Blocks
from probupdate.diagnosis.empirical_reference import (
    EmpiricalReference,
    look,
    residuals,
    scatter_noise,
    signatures,
    stated_patterns,
)
from probupdate.diagnosis.engine.evidence import ProfileInformation, profile_information, sequential_information
from probupdate.diagnosis.engine.library import EffectGains, Unknown, log_unknown, weigh
from probupdate.diagnosis.independent_numbers import Directions, independent_directions
from probupdate.diagnosis.time_profiles import TimeProfile
from probupdate.effects.catalogue import Effect
from probupdate.modal.modes import Sensor


@dataclass(frozen=True, eq=False, kw_only=True)
class ReferencedBlocks:
    """Blocks with their own mean as reference, residuals `rest` per group from it beside the nuisance (n_block,
    n_nuisance), and the independent directions; what every effect would do to their numbers, `signature`
    (n_number, n_effect)."""

    blocks: Blocks
    empirical: EmpiricalReference
    rest: tuple[np.ndarray, ...]
    nuisance: np.ndarray
    directions: Directions
    effects: tuple[Effect, ...]
    signature: np.ndarray
    profiles: tuple[TimeProfile, ...]

    @property
    def _numbers(self) -> tuple[np.ndarray, ...]:
        d = self.directions
        return d.project(self.rest), d.weight, d.least

    @property
    def _times(self) -> tuple[np.ndarray, ...]:
        h = np.array([p.value for p in self.profiles]).reshape(-1, len(self.blocks)) / self.span[:, None]
        return self.blocks.hours, self.nuisance, h

    @cached_property
    def along(self) -> ProfileInformation:
        """What the numbers say of the profiles, each over its range and by itself."""
        return profile_information(*self._numbers, *self._times)

    @cached_property
    def in_sequence(self) -> ProfileInformation:
        """The same of the frequencies' numbers, each explained by those before it too."""
        return sequential_information(*(x[..., self.directions.frequency] for x in self._numbers), *self._times)

    @property
    def log_numbers(self) -> list[np.ndarray]:
        """Per group the numbers of ln f among all responses."""
        sizes = [len(g) for g in self.blocks.groups]
        starts = np.searchsorted(self.directions.group_of, np.arange(len(sizes)))
        return [start + np.arange(1 if k == 1 else 3) for start, k in zip(starts, sizes, strict=True)]

    def unknown(self) -> Unknown:
        """What no row of the catalogue describes, along each profile."""
        return log_unknown(self.in_sequence, self.along, self.directions.real, self.directions.imaginary)

    @property
    def log_nothing(self) -> float:
        """ln density of all numbers where nothing moves."""
        of_shapes = np.delete(self.along.log_nothing, self.directions.frequency)
        return float(np.sum(of_shapes) + np.sum(self.in_sequence.log_nothing))

    @cached_property
    def span(self) -> np.ndarray:
        """(n_profile,) range of each profile, over which `profile_information` and `weighed` state amounts."""
        return np.array([np.ptp(p.value) for p in self.profiles])

    def weigh(self) -> EffectGains:
        """Effects of sensors by what they do to shapes, and to the frequencies in the one direction in which they do
        most: all of these drift together."""
        signature, rows = np.array(self.signature), self.directions.frequency
        most = np.abs(signature[rows]).max(axis=0, initial=0.0)
        signature[rows] = np.where(np.abs(signature[rows]) < most, 0.0, signature[rows])
        return weigh(self.along, self.effects, signature, self.profiles, self.span)

    def with_residuals(self, rest: Sequence[np.ndarray], used: Sequence[np.ndarray]) -> ReferencedBlocks:
        """Other residuals per group, of the blocks `used` in each, in the same directions."""
        return replace(self, directions=self.directions.where(used), rest=tuple(rest))


def watch(
    blocks: Blocks, effects: Sequence[Effect], sensors: Sequence[Sensor], known: np.ndarray,
    profiles: Sequence[TimeProfile], begun: np.ndarray | None = None,
) -> ReferencedBlocks:
    """known (n_block, n_known): time profiles along which anything may change; `begun`: see `look`."""
    empirical = look(blocks, sensors, begun)
    rest = residuals(empirical, known)
    noise = scatter_noise(blocks, empirical, rest, stated_patterns(blocks, empirical))
    directions = independent_directions(rest, noise, [len(g) for g in blocks.groups])
    return ReferencedBlocks(
        blocks=blocks, empirical=empirical, rest=rest, nuisance=empirical.nuisance(known), directions=directions,
        effects=tuple(effects), signature=directions.turn @ signatures(effects, empirical), profiles=tuple(profiles))


@dataclass(frozen=True, eq=False, kw_only=True)
class Odds:
    """ln posterior odds over nothing of all candidates together, of the unknown per profile (n_profile,), and of each
    weighed effect."""

    total: float
    unknown: np.ndarray
    of_sensors: np.ndarray
    weighed: EffectGains | None


def log_prior_of_profiles(profiles: Sequence[TimeProfile]) -> np.ndarray:
    """(n_profile,) what steps or drifts, and what follows any column, are each as probable before as nothing: a stated
    column is there because frequencies may follow it. Times of a step share one."""
    names, own = [p.name for p in profiles], ("step", "ramp")
    kinds = [sum((n in own) is by_time for n in set(names)) for by_time in (True, False)]
    return -np.log([names.count(n) * kinds[n not in own] for n in names])


def log_prior_of_effects(effects: Sequence[Effect], name: str) -> np.ndarray:
    """(n_effect,) by their odds along profiles of this name."""
    odds = np.array([e.prior_odds(name) for e in effects])
    return np.log(odds / odds.sum())


def odds_of(followed: ReferencedBlocks, unknown: Unknown) -> Odds:
    """Sensors and the structure are as probable before as each other, and both as nothing."""
    prior = log_prior_of_profiles(followed.profiles)
    free = unknown.any_unknown + prior
    if not followed.effects:
        return Odds(total=float(logsumexp(free)), unknown=free, of_sensors=np.zeros(0), weighed=None)
    weighed = followed.weigh()
    names = {name for e in followed.effects for name in e.time_profiles}
    of_effect = {p.name: log_prior_of_effects(followed.effects, p.name) for p in followed.profiles}
    own = np.array([log + prior[h] + of_effect[followed.profiles[h].name][e] - np.log(2)
                    for (e, h), log in zip(weighed.rows, weighed.log, strict=True)])
    # sensors do not follow every profile
    free = free - np.where([p.name in names for p in followed.profiles], np.log(2), 0.0)
    return Odds(total=float(logsumexp(np.concatenate([free, own]))), unknown=free, of_sensors=own, weighed=weighed)
