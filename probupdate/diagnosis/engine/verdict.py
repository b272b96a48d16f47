"""From sets of effects and their ln posterior odds to findings: each effect with its probability, over all sets, and
what may be meant instead."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from scipy.special import logsumexp

from probupdate.diagnosis.results import Alternative, Finding
from probupdate.effects.catalogue import Effect

# probability from which a cause is named among its competing hypotheses; below which what may be meant is not listed
SURE, LISTED = 0.95, 1e-3
# a minimum detectable size is found in so many of a hundred records: normal quantile of 0.9
POWER = 1.2815515655446004
CHANCE = "chance alone"


@dataclass(frozen=True, eq=False, kw_only=True)
class EffectSet:
    """Effects that are there together, of a size each with its standard deviation."""

    effects: tuple[Effect, ...]
    size: tuple[float, ...]
    size_std: tuple[float, ...]

    @property
    def keys(self) -> frozenset:
        return frozenset(e.key for e in self.effects)


S = TypeVar("S", bound=EffectSet)


def verdict_of(findings: Sequence[Finding]) -> str:
    """What findings that explain a record say of it."""
    if not findings:
        return "none"
    return "ambiguous" if any(f.posterior_probability < SURE for f in findings) else "named"


def findings_of(
    sets: Sequence[S], log_odds: Sequence[float], beside: Sequence[tuple[str, str, float]], *, time_profile: str,
    start: str = "",
) -> tuple[S, tuple[Finding, ...]] | None:
    """The most probable of the sets and its findings; None where one of `beside`, (cause, place, ln odds) of what is no
    set of effects, is more probable than all of them together."""
    each = np.array([*log_odds, *(log for _, _, log in beside)])
    share = np.exp(each - logsumexp(each))
    own, others = share[: len(sets)], share[len(sets) :]
    if own.sum() < others.max():
        return None
    best = sets[int(np.argmax(own))]
    what_else = [Alternative(cause=cause, location=place, posterior_probability=float(p))
                 for (cause, place, _), p in zip(beside, others, strict=True) if p > LISTED]
    findings = []
    for effect, size, std in zip(best.effects, best.size, best.size_std, strict=True):
        # of all sets the effect is in, and of those it is not in what they have instead
        there = np.array([effect.key in one.keys for one in sets])
        instead: dict[Effect, float] = {}
        for one, p in zip(sets, own, strict=True):
            for other in one.effects if effect.key not in one.keys else ():
                if other not in best.effects:
                    instead[other] = instead.get(other, 0.0) + float(p)
        ranked = sorted(((e, p) for e, p in instead.items() if p > LISTED), key=lambda pair: -pair[1])
        probability = float(own[there].sum())
        names = " or ".join([effect.name, *(e.name for e, _ in ranked[:3])])
        findings.append(Finding(
            kind=effect.kind, cause=effect.cause, location=effect.location, size=size, size_std=std, unit=effect.unit,
            time_profile=time_profile, time_profile_start=start,
            z=float(np.sqrt(2 * max(log_odds[sets.index(best)], 0.0))), posterior_probability=probability,
            alternatives=(*(Alternative(cause=e.cause, location=e.location, posterior_probability=p, key=e.key)
                            for e, p in ranked), *what_else),
            check=effect.check if probability >= SURE else f"check on site: {names}", key=effect.key))
    return best, tuple(findings)
