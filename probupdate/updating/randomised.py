"""Draws near the posterior, found by none of its proposals: maxima of randomised posteriors.

Each draw of the prior is the mean of a prior as wide, a draw of the noise is added to the data, and the maximum of that
posterior is found (randomised maximum likelihood: Oliver, He & Reynolds 1996; randomise, then optimise: Bardsley,
Solonen, Haario & Laine 2014). They are the posterior's own draws where responses are linear, and follow bent ridges
otherwise. Nothing is concluded from them but where proposals ought to be.
"""

from __future__ import annotations

import numpy as np

from probupdate.errors import ProbupdateError
from probupdate.runtime.arrays import frozen_array
from probupdate.runtime.progress import Progress
from probupdate.updating.problem import Problem
from probupdate.updating.set_likelihoods import coordinates_of

# draws at least, and how many a parameter; steps at most
FEWEST, PER_PARAMETER, STEPS = 200, 25, 12
# how far off bounds, the step of differences and the longest step, in standard deviations of the prior
INSIDE, DIFFERENCE, FARTHEST = 1e-3, 1e-4, 1.5
# a step that lowers -2 ln p by less than this is the last one
SETTLED = 0.05
# of each step, over the prior's precision: of the first, how it changes with one that leads down, with one that does
# not, and where it ends (Levenberg-Marquardt)
DAMPING, RELAXED, STIFFER, MOST_DAMPING = 1.0, 0.2, 8.0, 1e8


def randomised_maxima(problem: Problem, rng: np.random.Generator, progress: Progress) -> tuple[np.ndarray, int]:
    """Points (n, n_param) inside the bounds, those that settled, and how many parameter vectors were solved; all points
    move at once."""
    parameters, map_u = problem.parameters, coordinates_of(problem.parameters)
    n, scale = len(parameters), map_u.scale
    inside = INSIDE * np.minimum(parameters.std, parameters.upper - parameters.lower)
    least = np.where(map_u.logarithmic, np.maximum(parameters.lower, 0.0), parameters.lower)
    low, high = (map_u.transform(bound) / scale for bound in (least + inside, parameters.upper - inside))

    # x = u in the prior's standard deviations
    def residuals(x: np.ndarray) -> np.ndarray:
        return _residuals(problem, np.clip(map_u.back(x * scale), parameters.lower, parameters.upper))

    x = np.clip(map_u.transform(parameters.draw(rng, max(FEWEST, PER_PARAMETER * n))) / scale, low, high)
    begin, residual = x.copy(), residuals(x)
    noise = rng.standard_normal(residual.shape)
    moving, settled = np.all(np.isfinite(residual), axis=1), np.zeros(len(x), bool)
    residual, solved, damping = residual + noise, len(x), np.full(len(x), DAMPING)
    for step in range(STEPS):
        at = np.flatnonzero(moving)
        if not at.size:
            break
        progress("randomised maxima", step, STEPS)
        h = np.where(x[at] + DIFFERENCE > high, -DIFFERENCE, DIFFERENCE)
        beside = residuals((x[at, None] + h[:, None] * np.eye(n)).reshape(-1, n)).reshape(len(at), n, -1)
        slope = np.nan_to_num((beside + noise[at, None] - residual[at, None]) / h[:, :, None])
        off = x[at] - begin[at]
        precision = slope @ np.swapaxes(slope, 1, 2) + (1 + damping[at])[:, None, None] * np.eye(n)
        downhill = (slope @ residual[at][..., None])[..., 0] + off
        move = np.linalg.solve(precision, downhill[..., None])[..., 0]
        move /= np.maximum(np.abs(move).max(axis=1, keepdims=True) / FARTHEST, 1.0)
        trial = np.clip(x[at] - move, low, high)
        after = residuals(trial) + noise[at]
        solved += len(at) * (n + 1)
        gain = np.sum(residual[at] ** 2 - after**2, axis=1) + np.sum(off**2 - (trial - begin[at]) ** 2, axis=1)
        taken = gain > 0
        x[at[taken]], residual[at[taken]] = trial[taken], after[taken]
        damping[at] *= np.where(taken, RELAXED, STIFFER)
        settled[at] = taken & (gain < SETTLED)
        moving[at] = ~settled[at] & (damping[at] < MOST_DAMPING)
    progress("randomised maxima", STEPS, STEPS)
    found = np.clip(map_u.back(x[settled] * scale), parameters.lower, parameters.upper)
    return frozen_array(found), solved


def _residuals(problem: Problem, theta: np.ndarray) -> np.ndarray:
    """Weighted (n, n_effective) at theta (n, n_param), NaN where the model has no modes."""
    try:
        return problem.whiten(problem.measured - problem.predict_many(theta).response)
    except (ProbupdateError, np.linalg.LinAlgError):
        if len(theta) == 1:
            return np.full((1, problem.whiten(problem.measured).size), np.nan)
        return np.concatenate([_residuals(problem, half) for half in np.array_split(theta, 2)])
