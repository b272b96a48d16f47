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

import numpy as np
from scipy import linalg

from probupdate.errors import InputError
from probupdate.runtime.arrays import frozen_array
from probupdate.runtime.progress import Progress, silent
from probupdate.updating.problem import Problem

PENALTIES = ("step", "prior")
METHODS = ("gauss-newton", "levenberg-marquardt")
# an iteration is the last when no parameter moves by more than this share of its prior deviation
TOLERANCE = 1e-6
HALVINGS = 12
# relative noise of the objective: eigenvalues are solved to about 1e-12, and misfits multiply that
ROUNDING = 1e-9
# a parameter this close to a bound, as a share of its prior deviation, is pinned there
AT_BOUND = 1e-6
# near the end, where steps are below this many prior standard deviations, they are relaxed, to no less than this share
RELAX_BELOW, LEAST_SHARE = 0.1, 0.2


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

    if method == "levenberg-marquardt":
        path, converged, status = _trust_region(problem, theta, root_alpha * prior_root, max_iteration, tolerance)
        return _finished(problem, penalty, alpha, path, [misfit_at(row) for row in path], np.ones(len(path) - 1),
                         penalty_at, converged, status)  # fmt: skip

    path, shares, misfits = [theta], [], [misfit_at(theta)]
    share, last = 1.0, None
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
        relative = step / parameters.std
        share = relaxed(relative, last, share, 1.0) if penalty == "prior" else 1.0
        last = relative
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
            converged, status = True, (
                f"settled: no parameter moves by more than {tolerance:g} prior standard deviations")
            break
    progress(f"update, penalty on the {penalty}", max_iteration, max_iteration)
    if converged and np.max(np.abs(path[-1] - path[0]) / parameters.std) < tolerance:
        status = (f"settled where it started: alpha {alpha:g} leaves the data no weight" if alpha > 1 else
                  "settled where it started: the data ask for no change")  # fmt: skip
    return _finished(problem, penalty, alpha, path, misfits, shares, penalty_at, converged, status)


def relaxed(step: np.ndarray, last: np.ndarray | None, share: float, most: float) -> float:
    """Share of a Gauss-Newton step after a `share` of the `last` one, both in prior deviations (Aitken 1926; Irons &
    Tuck 1969): where the residual's own curvature, which Gauss-Newton leaves out, makes steps overshoot, they go to and
    fro with a fixed ratio that the two tell."""
    if last is None or np.max(np.abs(step)) > RELAX_BELOW:
        return 1.0
    change = step - last
    size = change @ change
    return 1.0 if size == 0 else float(np.clip(-share * (last @ change) / size, LEAST_SHARE, most))


def _finished(problem, penalty, alpha, path, misfits, shares, penalty_at, converged, status) -> TikhonovUpdate:
    path = np.array(path)
    predicted = problem.predict_many(path)
    return TikhonovUpdate(
        penalty_on=penalty, alpha=float(alpha), theta=frozen_array(path), misfit=frozen_array(misfits),
        penalty=frozen_array([penalty_at(row) for row in path]), share=frozen_array(shares),
        frequency_hz=frozen_array(predicted.frequency_hz), mac=frozen_array(predicted.mac),
        at_bound=frozen_array(pinned(path[-1], problem.parameters), bool), converged=converged, status=status,
    )


def _trust_region(problem: Problem, start, root, max_iteration: int, tolerance: float):
    """Accepted iterates of scipy's least_squares on misfit plus penalty, whether it settled, and its own words."""
    from scipy import optimize

    parameters = problem.parameters
    path = [np.array(start)]

    def residual(theta):
        return np.concatenate([problem.weighted(problem.predict(theta) - problem.measured),
                               root @ (theta - parameters.initial)])  # fmt: skip

    def slope(theta):
        # asked for once at every iterate that was accepted
        if np.any(theta != path[-1]):
            path.append(np.array(theta))
        return np.vstack([problem.weighted(problem.sensitivity(theta)[1].T).T, root])

    inside = 1e-9 * np.minimum(parameters.std, parameters.upper - parameters.lower)
    found = optimize.least_squares(
        residual, np.clip(start, parameters.lower + inside, parameters.upper - inside), jac=slope, method="trf",
        bounds=(parameters.lower, parameters.upper), x_scale=parameters.std, xtol=tolerance * 1e-3, ftol=1e-14,
        gtol=1e-12, max_nfev=max(1, max_iteration),
    )  # fmt: skip
    # it keeps a hair's breadth off bounds
    end = np.where(found.x - parameters.lower < AT_BOUND * parameters.std, parameters.lower, found.x)
    end = np.where(parameters.upper - end < AT_BOUND * parameters.std, parameters.upper, end)
    if np.any(end != path[-1]):
        path.append(end)
    words = found.message.rstrip(".")
    return path, found.status > 0, f"settled: {words}" if found.status > 0 else f"stopped: {words}"


def bounded_step(matrix: np.ndarray, right: np.ndarray, theta: np.ndarray, parameters) -> np.ndarray:
    """d that minimises |matrix d - right|^2 with theta + d inside the bounds; the plain solution where that is inside.

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
                                 method="bvls", tol=1e-14)  # fmt: skip
    return np.clip(theta + result.x * parameters.std, parameters.lower, parameters.upper) - theta


def pinned(theta: np.ndarray, parameters) -> np.ndarray:
    """(n_param,) bool: at a bound."""
    close = AT_BOUND * parameters.std
    return (theta - parameters.lower <= close) | (parameters.upper - theta <= close)
