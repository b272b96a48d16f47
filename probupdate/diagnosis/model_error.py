"""A larger error of the model as a competing hypothesis of what is constant: everywhere, or in the shapes at a sensor.

How large a model's error is (of frequencies, of shapes, and of the shapes at one place) is known no better than by a
factor: each of the scales is as probable before the data as any other, with an effect and without. What begins within a
record is there whatever the model misses throughout, and is not compared with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from scipy.special import logsumexp

from probupdate.diagnosis.evidence import error_scale_mean, linear_evidence, log_size_prior
from probupdate.diagnosis.fitting import Fit
from probupdate.diagnosis.hypotheses import refit_without
from probupdate.diagnosis.problem import DiagnosisProblem
from probupdate.diagnosis.ranking import Hypothesis, log_prior
from probupdate.diagnosis.results import Alternative
from probupdate.diagnosis.wording import error_words

LARGER_ERROR = "larger model error"
# of the standard deviations of what a model leaves out: of frequencies, or of the shapes at one place, beside all else,
# and of all alike
FREQUENCY_SCALES = (1.0, 2.0, 4.0, 8.0, 16.0)
DISCREPANCY_SCALES = FREQUENCY_SCALES[:-1]
# of what a model usually leaves out, tried for a record that is unexplained and for what is constant, the largest first
LARGER_ERRORS = (4.0, 2.0)


def error_factors(problem: DiagnosisProblem, frequencies: float, shapes: float) -> list[np.ndarray]:
    """Per group of modes the factor (n_response,) of each number's discrepancy."""
    n_channel, result = len(problem.blocks.channels), []
    for std, group in zip(problem.discrepancy_std, problem.blocks.groups, strict=True):
        n_shape = 2 * n_channel * len(group)
        result.append(np.repeat([frequencies, shapes], [len(std) - n_shape, n_shape]))
    return result


def _factors_at(problem: DiagnosisProblem, channels: Sequence[int], scale: float) -> list[np.ndarray]:
    """The same of the shapes at these channels alone, in phase: a model without damping has no other part."""
    n_channel, result = len(problem.blocks.channels), error_factors(problem, 1.0, 1.0)
    for factor, group in zip(result, problem.blocks.groups, strict=True):
        first = len(factor) - 2 * n_channel * len(group)
        for mode in range(len(group)):
            factor[first + mode * n_channel + np.asarray(channels)] = scale
    return result


def _log_evidence(fitted: Fit, factors: Sequence[np.ndarray]) -> float:
    """ln evidence with the discrepancy so many times as large, all unknowns to first order about the fit."""
    design = replace(fitted.design, discrepancy_std=tuple(
        std * factor for std, factor in zip(fitted.design.discrepancy_std, factors, strict=True)))
    return log_size_prior(fitted.included) + error_scale_mean(design, lambda d: linear_evidence(d, fitted.centred))


def stated_error(problem: DiagnosisProblem, frequencies: float = 1.0, shapes: float = 1.0) -> dict[str, float]:
    """So many times the error that the problem takes the model to have: shares of a frequency and of a shape's largest
    component; no shape of frequencies alone."""
    std = problem.discrepancy_std[0]
    of_shapes = {"shape": shapes * float(std[-1])} if problem.blocks.channels else {}
    return {"frequency": frequencies * float(std[0]), **of_shapes}


def _channels_moved(problem: DiagnosisProblem, best: Hypothesis, numbers: Sequence[int]) -> list[int]:
    """Channels whose shapes the effects of sensors among these move: at least half as much as that moved most."""
    n_channel, chosen = len(problem.blocks.channels), set()
    for k in numbers:
        if best.fitted.included[k].effect.kind != "measurement" or not n_channel:
            continue
        moved = np.zeros(n_channel)
        for signature, group in zip(best.fitted.design.effect, problem.blocks.groups, strict=True):
            own = signature[0, :, problem.which[best.candidates[k], 0]][-2 * n_channel * len(group):]
            moved += np.sum(own.reshape(-1, n_channel) ** 2, axis=0)
        chosen |= set(map(int, np.flatnonzero(np.sqrt(moved) >= 0.5 * np.sqrt(moved.max()))))
    return sorted(chosen) if len(chosen) < n_channel else []


def constant(best: Hypothesis, numbers: Sequence[int]) -> bool:
    return all(best.fitted.included[k].time_profile.kind == "constant" for k in numbers)


def _fit_without(problem: DiagnosisProblem, best: Hypothesis, numbers: Sequence[int]) -> tuple[Fit, float]:
    """The fit without these effects, and ln of how many times as probable that was before the data."""
    rest = best.fitted
    for k in sorted(numbers, reverse=True):
        rest, _ = refit_without(problem, rest, k)
    return rest, -log_prior(problem, [best.candidates[k] for k in numbers])


def _scaled_errors(
    problem: DiagnosisProblem, best: Hypothesis, numbers: Sequence[int]
) -> list[list[tuple[str, list[np.ndarray]]]]:
    """The model's error everywhere, and in the shapes of the channels that these effects move, each at all scales, the
    first as it is: words with the factors."""
    result = [[(error_words(stated_error(problem, f, s)), error_factors(problem, f, s))
               for f, s in product(DISCREPANCY_SCALES, repeat=2)]]
    channels = _channels_moved(problem, best, numbers)
    if channels:
        there = ", ".join(problem.blocks.channels[c] for c in channels)
        shape = stated_error(problem)["shape"]
        result.append([(f"{error_words({'shape': scale * shape})} at {there}", _factors_at(problem, channels, scale))
                       for scale in FREQUENCY_SCALES])
    return result


def larger_error(
    problem: DiagnosisProblem, best: Hypothesis, numbers: tuple[int, ...]
) -> tuple[Alternative, float, float]:
    """A larger error of the model in place of these constant effects of the most probable hypothesis: its words by the
    size that is most probable, ln evidence and ln prior relative to theirs."""
    rest, before = _fit_without(problem, best, numbers)
    instead: list[tuple[float, str]] = []
    evidence = []
    for scales in _scaled_errors(problem, best, numbers):
        # beside the error as it is chance alone competes
        own = [(_log_evidence(rest, factors), words) for words, factors in scales[1:]]
        there = logsumexp([_log_evidence(best.fitted, factors) for _, factors in scales])
        evidence.append(logsumexp([value for value, _ in own]) - there)
        instead += own
    row = Alternative(cause=LARGER_ERROR, location=max(instead)[1], posterior_probability=np.nan, key=LARGER_ERROR)
    return row, float(logsumexp(evidence)), float(before)


def error_without(problem: DiagnosisProblem, best: Hypothesis) -> dict[str, dict]:
    """`model_error`, on which constant effects of the most probable hypothesis rest: that which the model is `taken` to
    have, the `least` of LARGER_ERRORS beside which one of them is less probable than none, and which are `lost` there;
    empty where they are more probable beside all."""
    each = [k for k in range(len(best.candidates)) if constant(best, (k,))]
    rests = {k: _fit_without(problem, best, (k,)) for k in each}
    for scale in sorted(LARGER_ERRORS):
        factors = error_factors(problem, scale, scale)
        lost = [best.fitted.included[k].effect.name for k, (rest, before) in rests.items()
                if _log_evidence(rest, factors) + before > _log_evidence(best.fitted, factors)]
        if lost:
            return {"model_error": {"taken": stated_error(problem), "least": stated_error(problem, scale, scale),
                                    "lost": lost}}
    return {}
