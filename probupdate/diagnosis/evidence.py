"""How probable an effect is beside its rivals, and how large: Laplace's method about each fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from probupdate.diagnosis.expected import all_departures, fingerprints_at
from probupdate.diagnosis.fitting import FINGERPRINT, Fit, linearised, penalty
from probupdate.diagnosis.linear import Design
from probupdate.diagnosis.noise import Noise
from probupdate.diagnosis.setting import Named, Setting
from probupdate.errors import ConvergenceError

# errors of fingerprints that are as probable before, in FINGERPRINT
DOUBTS = (0.2, 0.5, 1.0, 2.0)
# ln evidence within which rivals are compared about the same parameters
CLOSE = 40.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Rival:
    """A candidate refitted as it is, within its bounds: fit, size with deviation, log of its prior odds, log evidence
    (Laplace) but for a constant that all rivals share."""

    candidate: int
    fitted: Fit
    size: float
    size_std: float
    log_odds: float
    log_evidence: float

    @property
    def log_posterior(self) -> float:
        """But for a constant that all rivals share."""
        return self.log_evidence + self.log_odds


def rival_of(setting: Setting, candidate: int, fitted: Fit) -> Rival | None:
    """What a fit with the candidate as its last effect tells of it; None where nothing is left of the effect."""
    extra = fitted.named[-1]
    if not extra.effect.discrete and abs(extra.size) < 1e-6 * extra.slab:
        # it cannot be on the side that the score asked for
        return None
    return Rival(candidate=candidate, fitted=fitted, size=extra.size, size_std=sizes_std(setting, fitted)[-1],
                 log_odds=float(np.log(extra.effect.prior_odds(extra.course.name))),
                 log_evidence=log_evidence(setting, fitted) + _sides(extra))  # fmt: skip


def _sides(named: Named) -> float:
    """An effect that can be on one side only has half of its slab."""
    return float(np.log(2.0)) if len(named.effect.signs) == 1 and not named.effect.discrete else 0.0


def ranked(setting: Setting, tried: Sequence[Rival | None]) -> list[Rival]:
    """By posterior odds, the most probable first, each effect with its best course; where any fit has settled, those that
    have not are worth nothing."""
    there = [r for r in tried if r is not None]
    settled = [r for r in there if r.fitted.settled]
    order = _compared(setting, sorted(settled or there, key=lambda r: -r.log_posterior))
    first = {int(setting.which[r.candidate, 0]): r for r in reversed(order)}
    return [r for r in order if first[int(setting.which[r.candidate, 0])] is r]


def _compared(setting: Setting, order: list[Rival]) -> list[Rival]:
    """Rivals close to the best with their evidence relative to its, each pair about the parameters of both fits,
    whichever is the better for each. Fingerprints of all that is marginalised differ from one fit's parameters to the
    next, which alone moves evidence by ten and more, of both alike; and far from its own fit neither is linear."""
    if not order:
        return order
    best, known = order[0], {}
    noise = best.fitted.design.noise

    def about(theta: np.ndarray, rival: Rival) -> float:
        key = theta.tobytes(), rival.candidate
        if key not in known:
            try:
                known[key] = marginal_evidence(setting, theta, rival.fitted.named, noise)
            except ConvergenceError:
                # no modes that pair with the measured ones there
                known[key] = -np.inf
        return known[key]

    result = [best]
    for rival in order[1:]:
        if best.log_posterior - rival.log_posterior < CLOSE:
            places = best.fitted.theta, rival.fitted.theta
            own, best_there = (max(about(p, r) for p in places) for r in (rival, best))
            if not np.isfinite([own, best_there]).all():
                result.append(rival)
                continue
            apart = own - best_there
            sides = _sides(rival.fitted.named[-1]) - _sides(best.fitted.named[-1])
            promised = only_promised(setting, rival.fitted) - only_promised(setting, best.fitted)
            rival = replace(rival, log_evidence=best.log_evidence + apart + sides - promised)
        result.append(rival)
    return sorted(result, key=lambda r: -r.log_posterior)


def only_promised(setting: Setting, fitted: Fit) -> float:
    """ln evidence that the linear equations promise at a fit and that the model does not keep, where it stalled."""
    linear = linear_evidence(fitted.design, fitted.centred)
    return max(0.0, linear - _evidence_at(setting, fitted, fitted.design))


def sizes_std(setting: Setting, fitted: Fit) -> list[float]:
    """Deviation of the size of each named effect, zero where it has one size only; with what a fit stopped short by."""
    design, result = fitted.design, []
    free = iter(range(design.sizes.start, design.sizes.stop))
    for n, short in zip(fitted.named, fitted.short, strict=True):
        if n.effect.discrete:
            result.append(0.0)
            continue
        own = float(design.unknowns_cov([next(free)])[0, 0])
        # what the fingerprint's length is not known better than
        length = np.hypot(FINGERPRINT, 0.0 if n.exact else length_std(setting, fitted, n))
        result.append(float(np.sqrt(own + (length * n.size) ** 2 + short**2)))
    return result


def length_std(setting: Setting, fitted: Fit, named: Named) -> float:
    """Relative deviation of the length of a fingerprint that the parameters' own uncertainty makes, along itself: a
    metre of water does as much as the added mass is large, and only the two together are measured. What enters the
    reference as it is needs no such allowance, as the design is made with the effect in place."""
    field, design = setting.field, fitted.design
    if named.effect.observe is not None:
        return 0.0
    rows = range(len(setting.updated))
    covariance = design.unknowns_cov(rows)
    std = np.sqrt(np.diag(covariance))
    names = tuple(name for name, _ in named.effect.increments)
    angle = setting.bins[0][:1]

    def fingerprint_at(theta) -> list[np.ndarray]:
        local = field.small.at(np.clip(theta, field.parameters.lower, field.parameters.upper))
        return [f[0, :, 0] for f in fingerprints_at(field, local, [named.effect], names, angle)]

    def product(a, b) -> float:
        return sum(float(x @ P @ y) for x, P, y in zip(a, design.noise.precision, b, strict=True))

    here = fingerprint_at(fitted.theta)
    change = []
    for row, k in zip(rows, setting.updated, strict=True):
        moved = fitted.theta.copy()
        moved[k] += 0.1 * std[row]
        there = fingerprint_at(moved)
        change.append(10 * (product(there, here) / product(here, here) - 1))
    change = np.array(change)
    return float(np.sqrt(change @ (covariance / np.outer(std, std)) @ change))


def log_evidence(setting: Setting, fitted: Fit) -> float:
    """ln p(blocks | model with the named effects) by Laplace's method, but for a constant of the record."""
    return _prior_ratio(fitted.named) + over_doubts(fitted.design, lambda d: _evidence_at(setting, fitted, d))


def _prior_ratio(named: Sequence[Named]) -> float:
    return sum(n.log_prior_ratio for n in named if not n.effect.discrete)


def marginal_evidence(setting: Setting, theta: np.ndarray, named: Sequence[Named], noise: Noise) -> float:
    """ln p(blocks | named effects near their sizes) with all parameters to first order about theta, but for a constant
    of record and noise."""
    design, _, centred = linearised(setting, theta, named, noise, all_departures(setting, theta, named))
    return _prior_ratio(named) + over_doubts(design, lambda d: linear_evidence(d, centred))


def _evidence_at(setting: Setting, fitted: Fit, design: Design) -> float:
    misfit = design.misfit(fitted.departures, design.held(len(setting.updated)))
    misfit += penalty(setting, fitted.theta, fitted.named, fitted.named)
    return float(-0.5 * misfit + design.log_volume + design.log_noise)


def linear_evidence(design: Design, centred: Sequence[np.ndarray]) -> float:
    """ln density of departures under a design, but for powers of 2 pi."""
    return float(-0.5 * design.misfit(centred, []) + design.log_volume + design.log_noise)


def over_doubts(design: Design, evidence: Callable[[Design], float]) -> float:
    """Mean over how well fingerprints may be known: with one doubt for all, what changes much is held against the long
    fingerprint that explains it to a hundredth, and a short one that explains it less well wins."""
    if not design.doubted:
        return evidence(design)
    each = [evidence(design.doubting(share)) for share in DOUBTS]
    return float(special.logsumexp(each) - np.log(len(each)))
