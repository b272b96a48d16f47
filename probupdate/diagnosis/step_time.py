"""Between which two blocks a step lies: the search tries a few times only, and a long record tells more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from probupdate.diagnosis.courses import MARGIN, Course, step_course
from probupdate.diagnosis.fitting import Fit, Setting


def sharpened(setting: Setting, fitted: Fit, effect: int, course: Course) -> Course:
    """The step of effect number `effect` that scores highest among all blocks between the neighbours of `course` in the
    search's grid; blocks that lie on the wrong side of a strong step look like an effect of their own."""
    n = len(setting.blocks)
    grid = np.array([MARGIN, *(c.at for c in setting.courses if c.kind == "step"), n - MARGIN])
    low = int(np.max(grid[grid < course.at], initial=min(MARGIN, course.at)))
    high = int(np.min(grid[grid > course.at], initial=max(n - MARGIN, course.at)))
    tried = [step_course(n, at) for at in range(low, high + 1)]
    design = replace(fitted.design, courses=(fitted.design.courses[0], *tried),
                     which=np.array([(effect, c + 1) for c in range(len(tried))]))  # fmt: skip
    information = design.information
    told = np.abs(design.scores(fitted.centred)) / np.sqrt(np.maximum(information, 1e-300))
    return tried[int(np.argmax(np.where(information > 0, told, 0.0)))]
