"""Between which two blocks a step lies: the search tries a few times only, and a long record tells more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from probupdate.diagnosis.courses import MARGIN, Course, step_course
from probupdate.diagnosis.expected import DeparturesBeside
from probupdate.diagnosis.fitting import Fit, kept
from probupdate.diagnosis.setting import Named, Setting
from probupdate.modes import frozen_array

# shares of a block that a step may have left; by how much -2 ln posterior must be lower for it to be within one
SHARES, WITHIN = (0.2, 0.4, 0.6, 0.8), 16.0


def sharpened(setting: Setting, fitted: Fit, effect: int, course: Course) -> Course:
    """The step of effect number `effect` that scores highest among all blocks between the neighbours of `course` in the
    search's grid; blocks that lie on the wrong side of a strong step look like an effect of their own."""
    tried = _between_neighbours(setting, course)
    design = replace(fitted.design, courses=(fitted.design.courses[0], *tried),
                     which=np.array([(effect, c + 1) for c in range(len(tried))]))  # fmt: skip
    information = design.information
    told = np.abs(design.scores(fitted.centred)) / np.sqrt(np.maximum(information, 1e-300))
    return tried[int(np.argmax(np.where(information > 0, told, 0.0)))]


def sharpened_again(setting: Setting, fitted: Fit) -> tuple[Named, ...]:
    """The fit's named effects, each step at the time that leaves least, where need be within a block: where another
    effect was still unknown the scores may have been misled."""
    named, beside = list(fitted.named), DeparturesBeside(setting, fitted.theta, fitted.named)
    held, noise = fitted.design.held(len(setting.updated)), fitted.design.noise
    for i, n in enumerate(named):
        if n.course.kind != "step":
            continue

        def left(course: Course, n=n, i=i) -> float:
            there = beside([*named[:i], replace(n, course=course), *named[i + 1 :]])
            return fitted.design.misfit(kept(there, noise), held)

        # where two leave the same the one that is there
        best = min([n.course, *_between_neighbours(setting, n.course)], key=left)
        # what has one size only has no share of it
        within = best if n.effect.discrete else min(_within_a_block(best), key=left)
        named[i] = replace(n, course=within if left(within) < left(best) - WITHIN else best)
    return tuple(named)


def _within_a_block(course: Course) -> list[Course]:
    """The step within the block before it or after it."""
    result = []
    for block in (course.at - 1, course.at):
        for share in SHARES:
            value = np.array(course.value, float)
            value[block] = share
            result.append(replace(course, value=frozen_array(value)))
    return result


def _between_neighbours(setting: Setting, course: Course) -> list[Course]:
    """Steps at all blocks between the neighbours of one in the search's grid."""
    n = len(setting.blocks)
    grid = np.array([MARGIN, *(c.at for c in setting.courses if c.kind == "step"), n - MARGIN])
    low = int(np.max(grid[grid < course.at], initial=min(MARGIN, course.at)))
    high = int(np.min(grid[grid > course.at], initial=max(n - MARGIN, course.at)))
    return [step_course(n, at) for at in range(low, high + 1)]
