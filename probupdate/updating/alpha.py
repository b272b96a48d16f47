"""How the anchored update depends on alpha of Eq. 6, and three rules that choose it.

L-curve (Hansen 1992): where ln misfit over ln penalty bends most. Discrepancy principle (Morozov): where the misfit is
what the stated standard deviations expect, the effective number of responses. Evidence (MacKay 1992): where the data
are most probable under a prior of covariance Sigma_theta / alpha, by the Laplace approximation without bounds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probupdate.errors import InputError
from probupdate.runtime.arrays import frozen_array
from probupdate.runtime.progress import Progress, silent
from probupdate.updating.problem import Problem
from probupdate.updating.settings import CONSTANTS
from probupdate.updating.tikhonov import update

RULES = ("l-curve", "discrepancy", "evidence")
# two values a decade
ALPHAS = np.logspace(-2, 2, 9)
LEAST_BEND = CONSTANTS.least_bend
TOLERANCE = CONSTANTS.alpha_tolerance
# Gauss-Newton steps to and fro where alpha is small and bounds or curvature turn it back; the trust region, slower
# where it is not, goes on from there
STEPS, REGION_STEPS = 10, 60


@dataclass(frozen=True, eq=False, kw_only=True)
class AlphaPath:
    """alpha (n,) ascending; theta (n, n_param) the anchored update's end; misfit, penalty (n,) the terms of Eq. 6
    there, the penalty without alpha; log_evidence (n,) up to a constant. chosen: rule -> alpha, NaN where it has none,
    with the reason in `remarks`. settled (n,) bool."""

    alpha: np.ndarray
    theta: np.ndarray
    misfit: np.ndarray
    penalty: np.ndarray
    log_evidence: np.ndarray
    settled: np.ndarray
    chosen: dict[str, float]
    remarks: dict[str, str]


def alpha_path(problem: Problem, *, progress: Progress = silent) -> AlphaPath:
    """The anchored update at every of ALPHAS, each started from the end of the next larger one."""
    parameters = problem.parameters
    weight = np.linalg.inv(parameters.covariance)
    theta = parameters.initial
    rows = []
    for done, alpha in enumerate(ALPHAS[::-1]):
        progress("path over alpha", done, len(ALPHAS))
        options = {"penalty": "prior", "alpha": float(alpha), "tolerance": TOLERANCE}
        run = update(problem, max_iteration=STEPS, start=theta, **options)
        if not run.converged:
            run = update(problem, method="levenberg-marquardt", max_iteration=REGION_STEPS, start=run.theta[-1],
                         **options)
        theta = run.theta[-1]
        apart = theta - parameters.initial
        slope = problem.whiten(problem.sensitivity(theta)[1].T).T
        _, log_det = np.linalg.slogdet(slope.T @ slope + alpha * weight)
        evidence = 0.5 * (len(theta) * np.log(alpha) - log_det - run.objective[-1])
        pull = weight @ apart
        fall = -2 * pull @ np.linalg.solve(slope.T @ slope + alpha * weight, pull)
        rows.append((alpha, theta, run.misfit[-1], apart @ pull, fall, evidence, run.converged))
    progress("path over alpha", len(ALPHAS), len(ALPHAS))
    alpha, theta, misfit, penalty, fall, evidence, settled = (np.array(x) for x in zip(*rows[::-1], strict=True))
    found = {
        "l-curve": curve_corner(alpha, misfit, penalty, fall),
        "discrepancy": _discrepancy(alpha, misfit, problem.n_effective),
        "evidence": _highest(alpha, evidence),
    }
    return AlphaPath(
        alpha=frozen_array(alpha), theta=frozen_array(theta), misfit=frozen_array(misfit),
        penalty=frozen_array(penalty), log_evidence=frozen_array(evidence), settled=frozen_array(settled, bool),
        chosen={rule: value for rule, (value, _) in found.items()},
        remarks={rule: remark for rule, (_, remark) in found.items() if remark},
    )


def choose(path: AlphaPath, rule: str) -> float:
    """The rule's alpha; raises InputError where it has none on this path."""
    if rule not in RULES:
        raise InputError("alpha", f"'{rule}' is unknown", f"give a number or one of {', '.join(RULES)}")
    if not np.isfinite(path.chosen[rule]):
        raise InputError(f"alpha by {rule}", path.remarks[rule], "give a number, 1 for a MAP, or another rule")
    return path.chosen[rule]


def curvature(alpha, misfit, penalty, penalty_slope) -> np.ndarray:
    """Of ln penalty over ln misfit (n,), positive where it turns about the origin; penalty_slope: d penalty / d alpha.

    On the path d misfit = -alpha d penalty, so that no second derivative is needed (Hansen 1992; U4).
    """
    rise = alpha * penalty_slope
    fall = -alpha * rise
    steep = misfit / (alpha * penalty)
    turn = -(fall / (alpha * penalty) - steep - steep * rise / penalty) / (1 + steep**2)
    return turn / np.maximum(np.hypot(fall / misfit, rise / penalty), 1e-300)


def curve_corner(alpha, misfit, penalty, penalty_slope) -> tuple[float, str]:
    """Alpha at the corner of the L-curve, NaN without one, and why there is none."""
    if np.any(penalty <= 0) or np.any(misfit <= 0):
        return float("nan"), "a term of Eq. 6 is zero on the path, so that it has no logarithm"
    bend = curvature(alpha, misfit, penalty, penalty_slope)
    best = int(np.argmax(bend))
    if bend[best] < LEAST_BEND or best in (0, len(alpha) - 1):
        where = "" if bend[best] < LEAST_BEND else f"; it bends most at the window's end, alpha {alpha[best]:g}"
        return float("nan"), (f"the curve has no corner between alpha {alpha[0]:g} and {alpha[-1]:g}{where}: take "
                              "'evidence' or 'discrepancy', or 1, the maximum of the posterior")
    s = np.log(alpha)
    a, b, _ = np.polyfit(s[best - 1 : best + 2] - s[best], bend[best - 1 : best + 2], 2)
    return float(np.exp(s[best] - 0.5 * b / a)), ""


def _discrepancy(alpha, misfit, n_effective: int) -> tuple[float, str]:
    above = misfit >= n_effective
    if above[0] or not above[-1]:
        return float("nan"), (
            f"the misfit goes from {misfit[0]:.4g} at alpha {alpha[0]:g} to {misfit[-1]:.4g} at {alpha[-1]:g} and does "
            f"not pass the {n_effective} that the stated standard deviations expect"
        )
    k = int(np.argmax(above))
    part = (n_effective - misfit[k - 1]) / (misfit[k] - misfit[k - 1])
    return float(np.exp(np.log(alpha[k - 1]) + part * np.log(alpha[k] / alpha[k - 1]))), ""


def _highest(alpha, value) -> tuple[float, str]:
    best = int(np.argmax(value))
    if best in (0, len(alpha) - 1):
        return float("nan"), f"the evidence is highest at the end of the path, alpha {alpha[best]:g}"
    s = np.log(alpha)
    a, b, _ = np.polyfit(s[best - 1 : best + 2] - s[best], value[best - 1 : best + 2], 2)
    return float(np.exp(s[best] - 0.5 * b / a)), ""
