"""Shares of one channel in another, as rivals of what stands out.

To first order a sensor that is turned is two crosstalks, one each way, and where one of its axes hardly moves it is
one. They are as many as there are ordered pairs of channels: too many for every fit to follow and for a table of limits
to list. So they cost no false alarm; a record in which nothing else stands out is not asked for them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from probupdate.effects.catalogue import Crosstalk, Effect, Swap, Turn
from probupdate.diagnosis.fitting import Fit, design_at
from probupdate.diagnosis.search import Search, search, tail
from probupdate.diagnosis.setting import Setting

# of all ordered pairs, how many are refitted
MOST_OFFERED = 2
# times the score of the best candidate: on a rigid level the share of a channel that moves alike is a wrong gain, which
# is the usual cause
CLEARER = 1.2


def crosstalk_effects(channels: Sequence[str]) -> tuple[Effect, ...]:
    """The share of every channel in every other."""
    return tuple(
        Effect(kind="measurement", cause="crosstalk", location=f"{other} into {into}", unit="-", tolerance=0.0,
               slab=0.1, lower=-1.0, upper=1.0, observe=Crosstalk(i, j), step_of_size=1e-3,
               fingerprint="one channel shows a share of another, every mode alike; the other shows nothing of it",
               check=f"tap the sensor of {other} along its axis and look at {into}; measure the cables' insulation",
               odds=1 / (len(channels) * (len(channels) - 1)))
        for i, into in enumerate(channels) for j, other in enumerate(channels) if i != j
    )  # fmt: skip


def beside_crosstalk(
    setting: Setting, fitted: Fit, found: Search, best: int, *, seed: int
) -> tuple[Setting, Fit, Search]:
    """Setting, fit and search with the crosstalks, constant or along the course of the `best` candidate, that explain
    most as last candidates: where the best is a turned sensor or exchanged cables, or they stand out clearly more than
    it does. The threshold is what it was without them."""
    j, c = setting.which[best]
    known = {(e.cause, e.location) for e in setting.effects}
    rows = [e for e in crosstalk_effects(setting.blocks.channels) if (e.cause, e.location) not in known]
    constant = [k for k, course in enumerate(setting.courses) if course.kind == "constant"]
    courses = np.unique([*constant, c])
    everything = _wider(setting, rows, np.tile(courses, (len(rows), 1)))
    design = design_at(everything, fitted.theta, fitted.named, fitted.design.noise)
    new = slice(len(setting.which), None)
    z = np.abs(design.scores(fitted.centred)[new]) / np.sqrt(np.maximum(design.information[new], 1e-300))
    z = np.where(design.share_left[new] > 1e-3, z, 0.0).reshape(len(rows), len(courses))
    strongest = np.argsort(-z.max(axis=1), kind="stable")[:MOST_OFFERED]
    if not isinstance(setting.effects[j].observe, Turn | Swap):
        strongest = [k for k in strongest if z[k].max() > CLEARER * found.statistic[best]]
    if not len(strongest):
        return setting, fitted, found
    wider = _wider(setting, [rows[k] for k in strongest], courses[np.argmax(z[strongest], axis=1)][:, None])
    fitted = replace(fitted, design=design_at(wider, fitted.theta, fitted.named, fitted.design.noise))
    again = search(wider, fitted, seed=seed, heavier=found.heavier)
    # of so many more candidates, in proportion
    p = (1 + z.size / len(setting.which)) * tail(found.maxima, float(z.max()))
    return wider, fitted, replace(again, threshold=found.threshold, p_value=min(found.p_value, p), maxima=found.maxima)


def _wider(setting: Setting, rows: Sequence[Effect], courses: np.ndarray) -> Setting:
    """The setting with these effects as last candidates, each along its courses (n_effect, n)."""
    numbers = len(setting.effects) + np.arange(len(rows))
    added = np.column_stack([np.repeat(numbers, courses.shape[1]), courses.ravel()])
    return replace(setting, effects=(*setting.effects, *rows), which=np.vstack([setting.which, added]))
