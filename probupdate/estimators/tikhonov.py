"""The sensitivity-based Tikhonov update of the paper, Eq. 4-7, in both readings of its penalty.

"step", as printed: every iteration minimises |dLambda - S d|^2_W_Lambda + alpha |d|^2_W_Theta, the penalty counted
from the previous iterate. Iterated, it forgets the prior; the number of iterations is then the regulariser.
"prior", anchored: the penalty is counted from the initial parameters, alpha |theta_i + d - theta_0|^2_W_Theta. At
alpha = 1 its fixed point is the maximum of a posterior with Gaussian priors. Both share their first iteration.

Steps are held within the bounds by a bounded least-squares solution of the same quadratic; inside them it is Eq. 7
exactly. A step that raises the quantity it minimises is halved, and the share taken is recorded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg, optimize

from probupdate.errors import InputError
from probupdate.modes import frozen_array
from probupdate.problem import Problem
from probupdate.progress import Progress, silent

PENALTIES = ("step", "prior")
# an iteration is the last when no parameter moves by more than this share of its prior deviation
TOLERANCE = 1e-6
HALVINGS = 12
# relative noise of the objective: eigenvalues are solved to about 1e-12, and misfits multiply that
ROUNDING = 1e-9
# a parameter this close to a bound, as a share of its prior deviation, is pinned there
AT_BOUND = 1e-6


@dataclass(frozen=True, eq=False, kw_only=True)
class TikhonovUpdate:
    """One reading of Eq. 7 run to its end.

    theta (n_iteration + 1, n_param) from the initial parameters on; misfit, penalty (n_iteration + 1,) are the terms
    of Eq. 6, the penalty counted from theta_0 and times alpha; share (n_iteration,) of each step that was taken;
    frequency_hz, mac (n_iteration + 1, n_used) of the matched modes.
    """

    penalty_on: str
    alpha: float
    theta: np.ndarray
    misfit: np.ndarray
    penalty: np.ndarray
    share: np.ndarray
    frequency_hz: np.ndarray
    mac: np.ndarray
    at_bound: np.ndarray
    converged: bool
    status: str

    @property
    def objective(self) -> np.ndarray:
        """J of Eq. 6 with the change counted from theta_0 (n_iteration + 1,)."""
        return self.misfit + self.penalty


def update(
    problem: Problem,
    *,
    penalty: str = "prior",
    alpha: float = 1.0,
    max_iteration: int = 50,
    tolerance: float = TOLERANCE,
    start: np.ndarray | None = None,
    progress: Progress = silent,
) -> TikhonovUpdate:
    """Iterate Eq. 7 from `start` (default theta_0). The result says whether and why it stopped."""
    if penalty not in PENALTIES:
        raise InputError("penalty", f"'{penalty}' is unknown", f"choose from {', '.join(PENALTIES)}")
    if not (alpha >= 0 and np.isfinite(alpha)):
        raise InputError("alpha", f"{alpha} is negative or not finite",
                         "give the regularisation coefficient of Eq. 6, 1 for a MAP")  # fmt: skip
    if max_iteration < 0:
        raise InputError("iterations", f"{max_iteration} is negative", "give how many at most")
    parameters = problem.parameters
    prior_root = linalg.cholesky(np.linalg.inv(parameters.covariance))
    root_alpha = np.sqrt(alpha)
    theta = np.array(parameters.initial if start is None else start, float)
    if theta.shape != (len(parameters),) or not parameters.inside(theta):
        raise InputError("start", f"{theta.tolist()} is not one value within its bounds for each parameter",
                         f"give {', '.join(parameters.names)}")  # fmt: skip

    def misfit_at(theta: np.ndarray) -> float:
        return float(problem.misfit(problem.predict(theta)))

    def penalty_at(theta: np.ndarray) -> float:
        return float(alpha * np.sum((prior_root @ (theta - parameters.initial)) ** 2))

    path, shares, misfits = [theta], [], [misfit_at(theta)]
    converged, status = False, f"stopped after {max_iteration} iterations without settling"
    for iteration in range(max_iteration):
        progress(f"update, penalty on the {penalty}", iteration, max_iteration)
        response, sensitivity = problem.sensitivity(theta)
        anchor = np.zeros_like(theta) if penalty == "step" else theta - parameters.initial
        # Eq. 7 as a least-squares problem: rows of the responses over those of the penalty
        matrix = np.vstack([problem.weighted(sensitivity.T).T, root_alpha * prior_root])
        right = np.concatenate([problem.weighted(problem.measured - response), -root_alpha * prior_root @ anchor])
        step = bounded_step(matrix, right, theta, parameters)

        def value(trial: np.ndarray, here=theta) -> float:
            if penalty == "prior":
                return misfit_at(trial) + penalty_at(trial)
            return misfit_at(trial) + float(alpha * np.sum((prior_root @ (trial - here)) ** 2))

        before = misfits[-1] + (penalty_at(theta) if penalty == "prior" else 0.0)
        share = 1.0
        for _ in range(HALVINGS):
            trial = np.clip(theta + share * step, parameters.lower, parameters.upper)
            if value(trial) <= before * (1 + ROUNDING):
                break
            share *= 0.5
        moved = np.max(np.abs(share * step) / parameters.std)
        small = np.max(np.abs(step) / parameters.std) < tolerance
        if value(trial) > before * (1 + ROUNDING) and not small:
            status = "no share of the last step lowers the objective: a kink where computed modes change places"
            break
        theta = trial
        path.append(theta)
        shares.append(share)
        misfits.append(misfit_at(theta))
        if small or moved < tolerance:
            converged, status = True, f"settled: no parameter moves by more than {tolerance:g} prior deviations"
            break
    progress(f"update, penalty on the {penalty}", max_iteration, max_iteration)
    path = np.array(path)
    predicted = problem.predict_many(path)
    return TikhonovUpdate(
        penalty_on=penalty, alpha=float(alpha), theta=frozen_array(path), misfit=frozen_array(misfits),
        penalty=frozen_array([penalty_at(row) for row in path]), share=frozen_array(shares),
        frequency_hz=frozen_array(predicted.frequency_hz), mac=frozen_array(predicted.mac),
        at_bound=frozen_array(pinned(path[-1], parameters), bool), converged=converged, status=status,
    )


def bounded_step(matrix: np.ndarray, right: np.ndarray, theta: np.ndarray, parameters) -> np.ndarray:
    """d that minimises |matrix d - right|^2 with theta + d inside the bounds; the plain solution where that is inside.

    Columns are scaled by the prior deviations: their units differ by many orders.
    """
    scaled = matrix * parameters.std
    plain, *_ = np.linalg.lstsq(scaled, right, rcond=None)
    step = plain * parameters.std
    if parameters.inside(theta + step):
        return step
    low, high = (parameters.lower - theta) / parameters.std, (parameters.upper - theta) / parameters.std
    # the active-set solver wants a start strictly able to move: bounds touched exactly are widened by rounding
    result = optimize.lsq_linear(scaled, right, bounds=(np.minimum(low, -1e-14), np.maximum(high, 1e-14)),
                                 method="bvls", tol=1e-14)  # fmt: skip
    return np.clip(theta + result.x * parameters.std, parameters.lower, parameters.upper) - theta


def pinned(theta: np.ndarray, parameters) -> np.ndarray:
    """(n_param,) bool: at a bound."""
    close = AT_BOUND * parameters.std
    return (theta - parameters.lower <= close) | (parameters.upper - theta <= close)
