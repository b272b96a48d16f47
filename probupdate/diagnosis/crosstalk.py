"""Shares of one channel in another, as competing hypotheses of what stands out.

To first order a sensor that is turned is two crosstalks, one each way, and where one of its axes hardly moves it is
one. They are as many as there are ordered pairs of channels: too many for every fit to follow and for a table of
detectable sizes to list. So they cost no false alarm; a record in which nothing else stands out is not asked for them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from probupdate.diagnosis.fitting import Fit, design_at
from probupdate.diagnosis.problem import DiagnosisProblem
from probupdate.diagnosis.search import (
    MARGIN,
    Search,
    gains,
    model_error_dispersion,
    scores_beside,
    search,
)
from probupdate.effects.catalogue import Crosstalk, Effect

# of all ordered pairs, how many are refitted
MOST_OFFERED = 2


def crosstalk_effects(channels: Sequence[str]) -> tuple[Effect, ...]:
    """The share of every channel in every other."""
    return tuple(
        Effect(kind="measurement", cause="crosstalk", location=f"{other} into {into}", unit="-", tolerance=0.0,
               prior_scale=0.1, lower=-1.0, upper=1.0, observe=Crosstalk(i, j), step_of_size=1e-3,
               signature="one channel shows a share of another, every mode alike; the other shows nothing of it",
               check=f"tap the sensor of {other} along its axis and look at {into}; measure the cables' insulation",
               odds=1 / (len(channels) * (len(channels) - 1)))
        for i, into in enumerate(channels) for j, other in enumerate(channels) if i != j
    )


def with_crosstalk(
    problem: DiagnosisProblem, fitted: Fit, found: Search, *, seed: int, z_included: Sequence[float] = ()
) -> tuple[DiagnosisProblem, Fit, Search]:
    """Problem, fit and search with the crosstalks, constant or along the time profile of the best candidate, that with
    their prior odds promise nearly as much as it does, as last candidates. The threshold is what it was without
    them."""
    best = int(np.argmax(found.statistic))
    _, c = problem.which[best]
    known = {(e.cause, e.location) for e in problem.effects}
    rows = [e for e in crosstalk_effects(problem.blocks.channels) if (e.cause, e.location) not in known]
    constant = [k for k, time_profile in enumerate(problem.time_profiles) if time_profile.kind == "constant"]
    time_profiles = np.unique([*constant, c])
    everything = _wider(problem, rows, np.tile(time_profiles, (len(rows), 1)))
    design = design_at(everything, fitted.theta, fitted.included, fitted.design.noise)
    u, v = scores_beside(everything, design, fitted.centred, fitted.included, z_included)
    gain, _ = gains(everything, u, np.where(design.share_left > 1e-3, v, 0.0))
    odds = np.log([everything.effects[j].prior_odds(everything.time_profiles[d].name) for j, d in everything.which])
    promise = gain / model_error_dispersion(float(found.statistic.max())) + odds
    of_table = np.where(found.usable, promise[: len(problem.which)], -np.inf)
    new = promise[len(problem.which):].reshape(len(rows), len(time_profiles))
    strongest = [k for k in np.argsort(-new.max(axis=1), kind="stable")[:MOST_OFFERED]
                 if new[k].max() > of_table.max() - MARGIN]
    if not len(strongest):
        return problem, fitted, found
    wider = _wider(problem, [rows[k] for k in strongest], time_profiles[np.argmax(new[strongest], axis=1)][:, None])
    fitted = replace(fitted, design=design_at(wider, fitted.theta, fitted.included, fitted.design.noise))
    again = search(wider, fitted, seed=seed, z_included=z_included, heavier=found.heavier)
    return wider, fitted, replace(again, threshold=found.threshold, p_value=found.p_value, maxima=found.maxima)


def _wider(problem: DiagnosisProblem, rows: Sequence[Effect], time_profiles: np.ndarray) -> DiagnosisProblem:
    """The problem with these effects as last candidates, each along its time profiles (n_effect, n)."""
    numbers = len(problem.effects) + np.arange(len(rows))
    added = np.column_stack([np.repeat(numbers, time_profiles.shape[1]), time_profiles.ravel()])
    return replace(problem, effects=(*problem.effects, *rows), which=np.vstack([problem.which, added]))
