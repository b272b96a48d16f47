"""Between which two blocks a step lies: the search tries a few times only, and a long record shows more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from probupdate.diagnosis.expected import ModelAnswers, residuals_at
from probupdate.diagnosis.fitting import Fit, kept
from probupdate.diagnosis.problem import DiagnosisProblem, IncludedEffect
from probupdate.diagnosis.time_profiles import MARGIN, TimeProfile, step_profile
from probupdate.runtime.arrays import frozen_array

# shares of a block that a step may have left; by how much -2 ln posterior must be lower for it to be within one
SHARES, WITHIN = (0.2, 0.4, 0.6, 0.8), 16.0


def sharpened(problem: DiagnosisProblem, fitted: Fit, effect: int, time_profile: TimeProfile) -> TimeProfile:
    """The step of effect number `effect` that scores highest among all blocks between the neighbours of `time_profile`
    in the search's grid; blocks that lie on the wrong side of a strong step look like an effect of their own."""
    tried = _between_neighbours(problem, time_profile)
    design = replace(fitted.design, time_profiles=(fitted.design.time_profiles[0], *tried),
                     which=np.array([(effect, c + 1) for c in range(len(tried))]))
    information = design.information
    score = np.abs(design.scores(fitted.centred)) / np.sqrt(np.maximum(information, 1e-300))
    return tried[int(np.argmax(np.where(information > 0, score, 0.0)))]


def sharpened_again(problem: DiagnosisProblem, fitted: Fit) -> tuple[IncludedEffect, ...]:
    """The fit's included effects, each step at the time that leaves least, where need be within a block: where another
    effect was still unknown the scores may have been misled."""
    included, answers = list(fitted.included), ModelAnswers(problem.predictor)
    held, noise = fitted.design.held(len(problem.updated)), fitted.design.noise
    for i, n in enumerate(included):
        if n.time_profile.kind != "step":
            continue

        def left(time_profile: TimeProfile, n=n, i=i) -> float:
            tried = [*included[:i], replace(n, time_profile=time_profile), *included[i + 1 :]]
            there = residuals_at(problem, fitted.theta, tried, answers)
            return fitted.design.misfit(kept(there, noise), held)

        # where two leave the same the one that is there
        best = min([n.time_profile, *_between_neighbours(problem, n.time_profile)], key=left)
        # what has one size only has no share of it
        within = best if n.effect.discrete else min(_within_a_block(best), key=left)
        included[i] = replace(n, time_profile=within if left(within) < left(best) - WITHIN else best)
    return tuple(included)


def _within_a_block(time_profile: TimeProfile) -> list[TimeProfile]:
    """The step within the block before it or after it."""
    result = []
    for block in (time_profile.at - 1, time_profile.at):
        for share in SHARES:
            value = np.array(time_profile.value, float)
            value[block] = share
            result.append(replace(time_profile, value=frozen_array(value)))
    return result


def _between_neighbours(problem: DiagnosisProblem, time_profile: TimeProfile) -> list[TimeProfile]:
    """Steps at all blocks between the neighbours of one in the search's grid."""
    n = len(problem.blocks)
    grid = np.array([MARGIN, *(c.at for c in problem.time_profiles if c.kind == "step"), n - MARGIN])
    low = int(np.max(grid[grid < time_profile.at], initial=min(MARGIN, time_profile.at)))
    high = int(np.min(grid[grid > time_profile.at], initial=max(n - MARGIN, time_profile.at)))
    return [step_profile(n, at) for at in range(low, high + 1)]
