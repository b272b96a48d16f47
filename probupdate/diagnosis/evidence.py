"""The evidence of a fitted hypothesis by Laplace's method, and how large its effects are."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy import special

from probupdate.diagnosis.expected import ModelAnswers, residuals_at, signatures_at
from probupdate.diagnosis.fitting import Fit, centre_about, design_without_candidates, error_scale, penalty
from probupdate.diagnosis.linear import Design
from probupdate.diagnosis.noise import Noise
from probupdate.diagnosis.problem import DiagnosisProblem, IncludedEffect
from probupdate.effects.catalogue import Effect

# errors of signatures that are as probable before
ERROR_SCALES = (0.2, 0.5, 1.0, 2.0)
# of a size that is taken out: most steps, what is left of its standard deviation, least slope that is one
MOST_STEPS, SETTLED, LEAST_SLOPE = 12, 0.1, 0.02


def promised_evidence(problem: DiagnosisProblem, fitted: Fit) -> float:
    """ln evidence that the linear equations promise at a fit and that the model does not keep, where it stalled."""
    linear = linear_evidence(fitted.design, fitted.centred)
    return max(0.0, linear - _evidence_at(problem, fitted, fitted.design))


def sizes_std(problem: DiagnosisProblem, fitted: Fit) -> list[float]:
    """Standard deviation of the size of each included effect, zero where it has one size only; with what a fit stopped
    short by."""
    design, result = fitted.design, []
    free = iter(range(design.sizes.start, design.sizes.stop))
    for n, short in zip(fitted.included, fitted.short, strict=True):
        if n.effect.discrete:
            result.append(0.0)
            continue
        own = float(design.unknowns_cov([next(free)])[0, 0])
        # what the signature's length is not known better than
        length = np.hypot(error_scale(n.effect), 0.0 if n.exact else length_std(problem, fitted, n))
        result.append(float(np.sqrt(own + (length * n.size) ** 2 + short**2)))
    return result


def sizes_in_own_std(fitted: Fit) -> list[float]:
    """Of each included effect its size over the standard deviation that the evidence gives it, in which the error of
    its signature is counted response by response; inf of an effect of one size."""
    free = iter(range(fitted.design.sizes.start, fitted.design.sizes.stop))
    return [np.inf if n.effect.discrete else
            float(abs(n.size) / np.sqrt(fitted.design.unknowns_cov([next(free)])[0, 0])) for n in fitted.included]


def length_std(problem: DiagnosisProblem, fitted: Fit, included: IncludedEffect) -> float:
    """Relative standard deviation of the length of a signature that the parameters' own uncertainty makes, along
    itself: a metre of water does as much as the added mass is large, and only the two together are measured. What
    enters the reference as it is needs no such allowance, as the design is made with the effect in place."""
    predictor, design = problem.predictor, fitted.design
    if included.effect.observe is not None:
        return 0.0
    rows = range(len(problem.updated))
    covariance = design.unknowns_cov(rows)
    std = np.sqrt(np.diag(covariance))
    names = tuple(name for name, _ in included.effect.increments)
    angle = problem.bins[0][:1]

    def signature_at(theta) -> list[np.ndarray]:
        local = predictor.small.evaluate(np.clip(theta, predictor.parameters.lower, predictor.parameters.upper))
        return [f[0, :, 0] for f in signatures_at(predictor, local, [included.effect], names, angle)]

    def product(a, b) -> float:
        return sum(float(x @ P @ y) for x, P, y in zip(a, design.noise.precision, b, strict=True))

    here = signature_at(fitted.theta)
    change = []
    for row, k in zip(rows, problem.updated, strict=True):
        moved = fitted.theta.copy()
        moved[k] += 0.1 * std[row]
        there = signature_at(moved)
        change.append(10 * (product(there, here) / product(here, here) - 1))
    change = np.array(change)
    return float(np.sqrt(change @ (covariance / np.outer(std, std)) @ change))


def log_evidence(problem: DiagnosisProblem, fitted: Fit) -> float:
    """ln p(blocks | model with the included effects) by Laplace's method, but for a constant of the record."""
    return log_size_prior(fitted.included) + error_scale_mean(
        fitted.design, lambda d: _evidence_at(problem, fitted, d)
    )


def log_size_prior(included: Sequence[IncludedEffect]) -> float:
    """ln of the sizes' prior over the normal densities that stand for it in the linear equations; an effect that can be
    on one side only has all of its prior there."""
    free = [n for n in included if not n.effect.discrete]
    return float(sum(n.log_prior_ratio + np.log(2 / len(n.effect.signs)) for n in free))


def log_weight_of_size(effect: Effect, size: float, size_std: float) -> float:
    """ln of what of the size's prior, the Cauchy density of `IncludedEffect`, a posterior of this width holds; zero for
    an effect of one size."""
    if effect.discrete:
        return 0.0
    density = 2 / (len(effect.signs) * np.pi * effect.prior_scale * (1 + (size / effect.prior_scale) ** 2))
    return float(np.log(np.sqrt(2 * np.pi) * size_std * density))


def _range_looked_through(effect: Effect) -> tuple[float, float]:
    return 0.95 * max(effect.lower, -1e300), min(effect.upper, 1e300)


def size_at_bound(effect: Effect, size: float) -> bool:
    """Whether a size that `size_by_secant` found is where its range ends: what was measured asks for something else."""
    lower, upper = _range_looked_through(effect)
    return not effect.discrete and not lower < size < upper


def size_by_secant(
    effect: Effect, left: Callable[[float], tuple[float, float]], start: float = 0.0
) -> tuple[float, float]:
    """Size and standard deviation of an effect to be taken out of what was measured, from `start` on. left(size): what
    of it is left, in its own unit, with its standard deviation, where so much is taken out.

    Of a gain of 1 + g (1 + g) / (1 + s) - 1 is left where 1 + s is taken out: its slope is as far from -1 as g is
    large, and sizes that are added up swing about -1/2 and beyond.
    """
    lower, upper = _range_looked_through(effect)
    size, slope = start, -1.0
    more, std = left(size)
    for _ in range(MOST_STEPS):
        then = float(np.clip(size - more / slope, lower, upper)) if np.isfinite(std) else size
        if then == size or abs(more) < SETTLED * std:
            break
        more_then, std = left(then)
        slope = _negative_slope((more_then - more) / (then - size))
        size, more = then, more_then
    if not 0 < std < np.inf:
        return size, std
    # what an error of what is left is of the size, there and not over all the way
    aside = size + std if size + std < upper else size - std
    return size, std / abs(_negative_slope((left(aside)[0] - more) / (aside - size)))


def _negative_slope(slope: float) -> float:
    """What grows as more is taken out tells no slope."""
    return slope if slope < -LEAST_SLOPE else -1.0


def marginal_evidence(
    problem: DiagnosisProblem, theta: np.ndarray, included: Sequence[IncludedEffect], noise: Noise,
    answers: ModelAnswers | None = None,
) -> float:
    """ln p(blocks | included effects near their sizes) with all parameters to first order about theta, but for a
    constant of record and noise; `answers`: see `residuals_at`."""
    design = design_without_candidates(problem, theta, included, noise)
    _, centred = centre_about(problem, design, theta, included, residuals_at(problem, theta, included, answers))
    return log_size_prior(included) + error_scale_mean(design, lambda d: linear_evidence(d, centred))


def _evidence_at(problem: DiagnosisProblem, fitted: Fit, design: Design) -> float:
    misfit = design.misfit(fitted.residuals, design.fitted_unknowns(len(problem.updated)))
    misfit += penalty(problem, fitted.theta, fitted.included, fitted.included)
    return float(-0.5 * misfit + design.log_volume + design.log_noise)


def linear_evidence(design: Design, centred: Sequence[np.ndarray]) -> float:
    """ln density of residuals, of each group (n_block, m), under a design, but for powers of 2 pi."""
    return float(-0.5 * design.misfit(centred, []) + design.log_volume + design.log_noise)


def error_scale_mean(design: Design, evidence: Callable[[Design], float]) -> float:
    """Mean over how well signatures may be known: with one model-error scale for all, what changes much is held against
    the long signature that explains it to a hundredth, and a short one that explains it less well wins."""
    if not design.model_errors:
        return evidence(design)
    each = [evidence(design.with_error_scale(share)) for share in ERROR_SCALES]
    return float(special.logsumexp(each) - np.log(len(each)))
