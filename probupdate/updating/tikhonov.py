"""The sensitivity-based Tikhonov update of the paper, Eq. 4-7, in both readings of its penalty.

"step", as printed: every iteration minimises |dLambda - S d|^2_W_Lambda + alpha |d|^2_W_Theta, the penalty counted
from the previous iterate. Iterated, it forgets the prior; the number of iterations is then the regulariser.
"prior", anchored: the penalty is counted from the initial parameters, alpha |theta_i + d - theta_0|^2_W_Theta. At
alpha = 1 its fixed point is the maximum of a posterior with Gaussian priors. Both share their first iteration.

Steps are held within the bounds by a bounded least-squares solution of the same quadratic; inside them it is Eq. 7
exactly. A step that raises the quantity it minimises is halved, and an anchored one that takes the last one back is
shortened; the share taken is recorded.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import linalg

from probupdate.errors import InputError, ProbupdateError
from probupdate.runtime.arrays import frozen_array
from probupdate.runtime.progress import Progress, silent
from probupdate.updating.problem import Problem
from probupdate.updating.settings import CONSTANTS

PENALTIES = ("step", "prior")
METHODS = ("gauss-newton", "levenberg-marquardt")
TOLERANCE = CONSTANTS.update_tolerance
HALVINGS = 12
ROUNDING = CONSTANTS.rounding
AT_BOUND = CONSTANTS.at_bound
RELAX_BELOW, LEAST_SHARE = CONSTANTS.relax_below, CONSTANTS.least_share


@dataclass(frozen=True, eq=False, kw_only=True)
class TikhonovUpdate:
    """One reading of Eq. 7 run to its end.

    theta (n_iteration + 1, n_param) from the initial parameters on; misfit, penalty (n_iteration + 1,) are the terms
    of Eq. 6, the penalty counted from theta_0 and times alpha; share (n_iteration,) of each step that was taken;
    frequency_hz, mac (n_iteration + 1, n_used) of the matched modes.
    """

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
    method: str = "gauss-newton",
    max_iteration: int = 50,
    tolerance: float = TOLERANCE,
    start: np.ndarray | None = None,
    progress: Progress = silent,
) -> TikhonovUpdate:
    """Iterate Eq. 7 from `start` (default theta_0). The result says whether and why it stopped.

    `method` "levenberg-marquardt" (anchored only) leaves the steps to scipy's bounded trust region ('trf').
    """
    if method not in METHODS:
        raise InputError("method", f"'{method}' is unknown", f"choose from {', '.join(METHODS)}")
    if method != METHODS[0] and penalty == "step":
        raise InputError("method", "Eq. 7 as printed has its own step", "use it with the penalty on the prior")
    if penalty not in PENALTIES:
        raise InputError("penalty", f"'{penalty}' is unknown", f"choose from {', '.join(PENALTIES)}")
    if not (alpha >= 0 and np.isfinite(alpha)):
        raise InputError("alpha", f"{alpha} is negative or not finite",
                         "give the regularisation coefficient of Eq. 6, 1 for a MAP")
    if max_iteration < 0:
        raise InputError("iterations", f"{max_iteration} is negative", "give how many at most")
    parameters = problem.parameters
    theta = np.array(parameters.initial if start is None else start, float)
    # the penalty of Eq. 6 is finite at a bound where a lognormal prior is zero
    if theta.shape != (len(parameters),) or not np.all((theta >= parameters.lower) & (theta <= parameters.upper)):
        raise InputError("start", f"{theta.tolist()} is not one value within its bounds for each parameter",
                         f"give {', '.join(parameters.names)}")
    objective = _Objective(problem, penalty, alpha, linalg.cholesky(np.linalg.inv(parameters.covariance)))
    if method == "levenberg-marquardt":
        return _finish_update(objective, _trust_region(objective, theta, max_iteration, tolerance))
    found = _gauss_newton(objective, theta, max_iteration, tolerance, progress)
    progress(f"update, penalty on the {penalty}", max_iteration, max_iteration)
    if found.converged and np.max(np.abs(found.path[-1] - found.path[0]) / parameters.std) < tolerance:
        found = found._replace(status="converged where it started: the data ask for no change" if alpha <= 1 else
                               f"converged where it started: alpha {alpha:g} leaves the data no weight")
    return _finish_update(objective, found)


class _Iterates(NamedTuple):
    """theta of every iterate with its misfit, the share of each step that was taken, whether they settled, and why they
    end."""

    path: list[np.ndarray]
    misfit: list[float]
    share: list[float]
    converged: bool
    status: str


@dataclass(frozen=True, eq=False)
class _Objective:
    """J of Eq. 6 and its minimiser Eq. 7 for one reading of the penalty; prior_root^T prior_root = W_Theta."""

    problem: Problem
    penalty: str
    alpha: float
    prior_root: np.ndarray

    @property
    def root(self) -> np.ndarray:
        """R (n_param, n_param) with alpha W_Theta = R^T R."""
        return np.sqrt(self.alpha) * self.prior_root

    def origin(self, here: np.ndarray) -> np.ndarray:
        """Where the penalty is counted from at the iterate `here`: there, as Eq. 7 is printed, or from theta_0."""
        return here if self.penalty == "step" else self.problem.parameters.initial

    def misfit(self, theta: np.ndarray) -> float:
        """First term of Eq. 6."""
        return float(self.problem.misfit(self.problem.predict(theta)))

    def trial_misfit(self, theta: np.ndarray) -> float:
        """The same; infinite where the bounds allow what has no modes, such as no stiffness at all."""
        try:
            return self.misfit(theta)
        except (ProbupdateError, np.linalg.LinAlgError):
            return np.inf

    def change(self, theta: np.ndarray, origin: np.ndarray) -> float:
        """Second term of Eq. 6: alpha (theta - origin)^T W_Theta (theta - origin)."""
        return float(self.alpha * np.sum((self.prior_root @ (theta - origin)) ** 2))

    def step(self, theta: np.ndarray) -> np.ndarray:
        """Eq. 7 within the bounds, as a least-squares problem: rows of the responses over those of the penalty."""
        response, sensitivity = self.problem.sensitivity(theta)
        matrix = np.vstack([self.problem.whiten(sensitivity.T).T, self.root])
        residual = self.problem.whiten(self.problem.measured - response)
        right = np.concatenate([residual, -self.root @ (theta - self.origin(theta))])
        return bounded_step(matrix, right, theta, self.problem.parameters)


def _gauss_newton(
    objective: _Objective, theta: np.ndarray, max_iteration: int, tolerance: float, progress: Progress
) -> _Iterates:
    """Eq. 7 from theta on, its steps halved where they raise J and relaxed where they go to and fro."""
    parameters = objective.problem.parameters
    path, misfits, shares = [theta], [objective.misfit(theta)], []
    share, last = 1.0, None
    for iteration in range(max_iteration):
        progress(f"update, penalty on the {objective.penalty}", iteration, max_iteration)
        step, origin = objective.step(theta), objective.origin(theta)
        before = misfits[-1] + objective.change(theta, origin)
        relative = step / parameters.std
        share = relaxation_share(relative, last, share, 1.0) if objective.penalty == "prior" else 1.0
        last = relative
        trial, misfit, lower = theta, misfits[-1], False
        for _ in range(HALVINGS):
            trial = np.clip(theta + share * step, parameters.lower, parameters.upper)
            misfit = objective.trial_misfit(trial)
            lower = misfit + objective.change(trial, origin) <= before * (1 + ROUNDING)
            if lower:
                break
            share *= 0.5
        small = np.max(np.abs(step) / parameters.std) < tolerance
        if not lower and not small:
            status = "no part of the last step lowers the objective: computed modes swap their order there"
            return _Iterates(path, misfits, shares, False, status)
        moved = np.max(np.abs(share * step) / parameters.std)
        theta = trial
        path.append(theta)
        misfits.append(misfit)
        shares.append(share)
        if small or moved < tolerance:
            status = f"converged: no parameter moves by more than {tolerance:g} prior standard deviations"
            return _Iterates(path, misfits, shares, True, status)
    return _Iterates(path, misfits, shares, False, f"did not converge within {max_iteration} iterations")


def relaxation_share(step: np.ndarray, last: np.ndarray | None, share: float, most: float) -> float:
    """Share of a Gauss-Newton step after a `share` of the `last` one, both in prior standard deviations (Aitken 1926;
    Irons & Tuck 1969): where the residual's own curvature, which Gauss-Newton leaves out, makes steps overshoot, they
    go to and fro with a fixed ratio that the two give."""
    if last is None or np.max(np.abs(step)) > RELAX_BELOW:
        return 1.0
    change = step - last
    size = change @ change
    return 1.0 if size == 0 else float(np.clip(-share * (last @ change) / size, LEAST_SHARE, most))


def _finish_update(objective: _Objective, found: _Iterates) -> TikhonovUpdate:
    path, parameters = np.array(found.path), objective.problem.parameters
    predicted = objective.problem.predict_many(path)
    return TikhonovUpdate(
        alpha=float(objective.alpha), theta=frozen_array(path),
        misfit=frozen_array(found.misfit), share=frozen_array(found.share),
        penalty=frozen_array([objective.change(row, parameters.initial) for row in path]),
        frequency_hz=frozen_array(predicted.frequency_hz), mac=frozen_array(predicted.mac),
        at_bound=frozen_array(is_pinned(path[-1], parameters), bool), converged=found.converged, status=found.status,
    )


def _trust_region(objective: _Objective, start: np.ndarray, max_iteration: int, tolerance: float) -> _Iterates:
    """Accepted iterates of scipy's least_squares on J of Eq. 6, whether it settled, and its own words."""
    from scipy import optimize

    problem, parameters, root = objective.problem, objective.problem.parameters, objective.root
    path = [np.array(start)]

    def residual(theta):
        return np.concatenate([problem.whiten(problem.predict(theta) - problem.measured),
                               root @ (theta - parameters.initial)])

    def slope(theta):
        # asked for once at every iterate that was accepted
        if np.any(theta != path[-1]):
            path.append(np.array(theta))
        return np.vstack([problem.whiten(problem.sensitivity(theta)[1].T).T, root])

    inside = 1e-9 * np.minimum(parameters.std, parameters.upper - parameters.lower)
    found = optimize.least_squares(
        residual, np.clip(start, parameters.lower + inside, parameters.upper - inside), jac=slope, method="trf",
        bounds=(parameters.lower, parameters.upper), x_scale=parameters.std, xtol=tolerance * 1e-3, ftol=1e-14,
        gtol=1e-12, max_nfev=max(1, max_iteration),
    )
    # it keeps a hair's breadth off bounds
    end = np.where(found.x - parameters.lower < AT_BOUND * parameters.std, parameters.lower, found.x)
    end = np.where(parameters.upper - end < AT_BOUND * parameters.std, parameters.upper, end)
    if np.any(end != path[-1]):
        path.append(end)
    words = found.message.rstrip(".")
    status = f"converged: {words}" if found.status > 0 else f"stopped: {words}"
    return _Iterates(path, [objective.misfit(row) for row in path], [1.0] * (len(path) - 1), found.status > 0, status)


def bounded_step(matrix: np.ndarray, right: np.ndarray, theta: np.ndarray, parameters) -> np.ndarray:
    """d (n_param,) that minimises |matrix d - right|^2 with theta + d inside the bounds; the plain solution where that
    is inside. matrix (n_row, n_param), right (n_row,).

    Columns are scaled by the prior standard deviations: their units differ by many orders.
    """
    from scipy import optimize

    scaled = matrix * parameters.std
    plain, *_ = np.linalg.lstsq(scaled, right, rcond=None)
    step = plain * parameters.std
    if parameters.inside(theta + step):
        return step
    low, high = (parameters.lower - theta) / parameters.std, (parameters.upper - theta) / parameters.std
    # the active-set solver wants a start strictly able to move: bounds touched exactly are widened by rounding
    result = optimize.lsq_linear(scaled, right, bounds=(np.minimum(low, -1e-14), np.maximum(high, 1e-14)),
                                 method="bvls", tol=1e-14)
    return np.clip(theta + result.x * parameters.std, parameters.lower, parameters.upper) - theta


def is_pinned(theta: np.ndarray, parameters) -> np.ndarray:
    """(n_param,) bool: at a bound."""
    close = AT_BOUND * parameters.std
    return (theta - parameters.lower <= close) | (parameters.upper - theta <= close)
