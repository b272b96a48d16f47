"""The maximum of the posterior and the Gaussian around it: where the sampler starts and what it is checked against."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, special

from probupdate.errors import ConvergenceError, ProbupdateError
from probupdate.runtime.arrays import frozen_array
from probupdate.updating.problem import Problem
from probupdate.updating.settings import CONSTANTS
from probupdate.updating.tikhonov import HALVINGS, ROUNDING, bounded_step, is_pinned, relaxation_share

MAX_ITERATION = 200
# in -2 ln posterior, two ways that end as high: a twentieth of a standard deviation
CREASE = 2.5e-3
TOLERANCE = CONSTANTS.map_tolerance
# modes nearer than this share may trade their places on the first step; starts about such a model, and how far off in
# prior standard deviations
NEARLY_EQUAL, N_BESIDE, BESIDE = 1e-3, 4, 0.3
# draws of the prior from the most probable of which the maximum is looked for too, and how many of them
N_DRAWN, N_CLIMBED = 32, 4
# where a start at which a prior is zero begins instead, a share of the initial value
NEAR_ZERO = 1e-3
# a uniform prior counts as a Gaussian this many times as wide: what the data do not inform keeps a width
FLAT = 1e-3
# a step is lengthened to at most so many times itself where steps shrink slowly
LONGEST = 2.0
# draws of the prior from which further maxima are looked for at a time, how many times at most, and the probability of
# a new one with which the search ends
N_START, MOST_ROUNDS, UNSEEN = 12, 20, 0.02
SAME_HEIGHT = CONSTANTS.same_height
NEGLIGIBLE = CONSTANTS.negligible


@dataclass(frozen=True, eq=False, kw_only=True)
class Laplace:
    """theta (n_param,) the maximum of p(theta | data) inside the bounds; precision (n_param, n_param) of the
    Gauss-Newton Gaussian there and covariance its inverse, averaged over the discrepancy's scales where these are
    learnt; gradient (n_param,) of ln p there, not zero where at_bound.

    projected_gradient: its largest component that the bounds leave, per posterior standard deviation: how far, in ln p,
    the point is from the exact maximum. resolution (n_param,) is the diagonal of P S^T W_Lambda S: 1 where the data
    alone decide, 0 where the prior does. `others`: log densities below the maximum of further maxima that starts ended
    in.
    """

    theta: np.ndarray
    covariance: np.ndarray
    precision: np.ndarray
    gradient: np.ndarray
    projected_gradient: float
    at_bound: np.ndarray
    resolution: np.ndarray
    log_posterior: float
    misfit: float
    others: tuple[float, ...]


def prior_residual(parameters, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """r (n,) and dr/dtheta (n, n) with -2 ln prior(theta) = r^T r + const inside the bounds.

    A lognormal density's factor 1/theta is kept by completing the square: in z = ln(theta / median) / s it shifts the
    centre by C s, C the correlation and s the logarithmic standard deviations of the lognormal parameters.
    """
    n = len(parameters)
    z, slope, log_std = np.empty(n), np.empty(n), np.zeros(n)
    for k, p in enumerate(parameters):
        if p.prior == "normal":
            z[k], slope[k] = (theta[k] - p.initial) / p.std, 1 / p.std
        elif p.prior == "uniform":
            z[k], slope[k] = FLAT * (theta[k] - 0.5 * (p.lower + p.upper)) / p.std, FLAT / p.std
        elif theta[k] <= 0:
            # the density is zero there
            z[k], slope[k] = np.inf, np.inf
        else:
            log_std[k] = p.log_std
            z[k], slope[k] = np.log(theta[k] / p.initial) / p.log_std, 1 / (theta[k] * p.log_std)
    correlation = np.eye(n) if parameters.correlation is None else parameters.correlation
    if np.any(np.isinf(z)):
        return np.full(n, np.inf), np.full((n, n), np.inf)
    factor = linalg.cholesky(correlation, lower=True)
    white = linalg.solve_triangular(factor, np.column_stack([z + correlation @ log_std, np.diag(slope)]), lower=True)
    return white[:, 0], white[:, 1:]


def maximum_a_posteriori(problem: Problem, starts: Sequence[np.ndarray]) -> Laplace:
    """Bounded Gauss-Newton from every start; the highest maximum wins. Where the initial model has equal modes that are
    compared as a plane, a few starts about it join them (`_starts_beside_crossings`).

    Starts at which the model has no modes are left out. Raises ConvergenceError, with the best parameters as estimate,
    where no start settles, and what the model says where it has modes at none.
    """
    starts = [*starts, *_starts_beside_crossings(problem)]
    starts = [_move_off_zero(problem, np.asarray(start, float)) for start in starts]
    ends = [end for end in (_climb(problem, np.asarray(start, float)) for start in starts) if np.isfinite(end[1])]
    if not ends:
        problem.predict(np.asarray(starts[0], float))
    if not any(end[2] for end in ends):
        # where full steps jump about, the trust region of a well-kept library mostly does not
        ends += [_climb(problem, trust_region(problem, end[0])) for end in ends]
    settled = [end for end in ends if end[2]] or _maxima_on_crossing(problem, min(ends, key=lambda end: end[1]))
    if not settled:
        best = min(ends, key=lambda end: end[1])
        reason, modes = _likely_reason(problem, best[0])
        raise ConvergenceError(
            f"the posterior's maximum was not reached within {MAX_ITERATION} iterations from any of {len(starts)} "
            f"starts: {reason}", best[0], modes)
    theta, lowest, _ = min(settled, key=lambda end: end[1])
    highest = _laplace(problem, theta, ())
    others = sorted({
        round(float(0.5 * (end[1] - lowest)), 3) for end in settled
        if not is_same_maximum(end[0], highest) and 0.5 * (end[1] - lowest) > SAME_HEIGHT
    })
    return replace(highest, others=tuple(others))


def _likely_reason(problem: Problem, theta: np.ndarray) -> tuple[str, tuple[int, ...]]:
    """Which measured modes have another of the model's at theta, the best parameters, than at the initial ones, and
    their columns."""
    found = problem.predict_many(np.array([problem.parameters.initial, theta]))
    changed = np.flatnonzero(found.computed[0] != found.computed[1])
    if not len(changed):
        return ("the measured modes may not be this model's; check the order of the channels (x and y exchanged?), "
                "units and pairing"), ()
    named = [problem.mode_labels[problem.used[k]] for k in changed]
    said = ", ".join(
        f"{label} is {found.frequency_hz[0, k]:.4g} Hz (MAC {found.mac[0, k]:.2f}) at the initial parameters and "
        f"{found.frequency_hz[1, k]:.4g} Hz (MAC {found.mac[1, k]:.2f}) at the best" for k, label in zip(
            changed, named, strict=True))
    return (f"which of the model's modes is {' and '.join(named)} changes with the parameters ({said}); leave "
            f"{'it' if len(named) == 1 else 'them'} out: list the other modes' labels behind the file of --modes",
            tuple(problem.used[k] for k in changed))


def probable_draws(problem: Problem) -> list[np.ndarray]:
    """Of draws of the prior, always the same, those with the highest posterior density (n_param,): what climbs from the
    initial parameters alone may end in a lower maximum. Draws at which the model has no modes are left out."""
    draws = problem.parameters.draw(np.random.default_rng(1), N_DRAWN)
    value = np.array([_value(problem, theta) for theta in draws])
    return [draws[k] for k in np.argsort(value)[:N_CLIMBED] if np.isfinite(value[k])]


def start_of_sets(problem: Problem) -> np.ndarray | None:
    """Where each of many sets like this one begins (n_param,): at this one's maximum; None where it has none, as others
    may have."""
    try:
        return maximum_a_posteriori(problem, [problem.parameters.initial, *probable_draws(problem)]).theta
    except ProbupdateError:
        return None


def _move_off_zero(problem: Problem, start: np.ndarray) -> np.ndarray:
    """A start at which the prior is zero, as a lognormal's is at zero, a little inside."""
    parameters = problem.parameters
    return np.where(parameters._zero_at_bound & (start <= 0), NEAR_ZERO * parameters.initial, start)


def _starts_beside_crossings(problem: Problem) -> list[np.ndarray]:
    """Starts about the initial parameters where two modes that are compared as a plane are equal there, as of a model
    alike both ways: which of them is the lower is rounding's, and a climb from there goes to one side alone."""
    parameters = problem.parameters
    solution = problem.model.solve(parameters.initial, problem.matching.n_mode)
    pairs = [solution.frequency_hz[list(c)] for c in problem._clusters(solution) if len(c) > 1]
    if not any(np.ptp(f) < NEARLY_EQUAL * f[0] for f in pairs):
        return []
    draws = np.random.default_rng(1).standard_normal((N_BESIDE, len(parameters)))
    return list(np.clip(parameters.initial + BESIDE * parameters.std * draws, parameters.lower, parameters.upper))


def distinct_maxima(problem: Problem, found: Laplace, starts: Sequence[np.ndarray] | np.ndarray) -> tuple[Laplace, ...]:
    """`found` and the further maxima that climbs from `starts`, each (n_param,), end in, highest mass first: those of
    which the Laplace evidence is within NEGLIGIBLE of the largest. Starts that do not settle are left out."""
    kept = [found]
    for start in starts:
        _reached(problem, start, kept)
    return tuple(kept[k] for k in _with_mass(kept))


def search_maxima(problem: Problem, found: Laplace, rng: np.random.Generator) -> tuple[tuple[Laplace, ...], int, float]:
    """The same from draws of the prior, in rounds of N_START until another start would hardly find a maximum that none
    has found; how many starts it took, and that probability: the share of starts that were alone in their maximum
    (Good 1953)."""
    # the one that is known was reached before
    kept, visits, started = [found], [2], 0
    for _ in range(MOST_ROUNDS):
        started += N_START
        for start in problem.parameters.draw(rng, N_START):
            k = _reached(problem, start, kept)
            visits += [0] * (len(kept) - len(visits))
            if k is not None:
                visits[k] += 1
        probable = _with_mass(kept)
        # of those that settled, where any did but for the one that was known
        alone = sum(visits[k] == 1 for k in probable) / max(sum(visits) - 2, 1)
        if alone <= UNSEEN:
            break
    return tuple(kept[k] for k in probable), started, alone


def _reached(problem: Problem, start: np.ndarray, kept: list[Laplace]) -> int | None:
    """The number in `kept` of the maximum that a climb ends in, added where it is new; None where it does not settle.
    """
    theta, _, settled = _climb(problem, np.asarray(start, float))
    if not settled:
        return None
    same = [k for k, other in enumerate(kept) if is_same_maximum(theta, other)]
    if not same:
        kept.append(_laplace(problem, theta, ()))
    return same[0] if same else len(kept) - 1


def _with_mass(kept: Sequence[Laplace]) -> list[int]:
    """Numbers of those with mass worth counting, the largest first."""
    mass = np.array([_log_mass(x) for x in kept])
    return [int(k) for k in np.argsort(-mass) if mass[k] > mass.max() - NEGLIGIBLE]


def is_same_maximum(theta: np.ndarray, other: Laplace) -> bool:
    """Within a posterior standard deviation a parameter: one broad maximum, not two."""
    apart = theta - other.theta
    return float(apart @ other.precision @ apart) < len(theta)


def _log_mass(laplace: Laplace) -> float:
    return laplace.log_posterior + 0.5 * np.linalg.slogdet(laplace.covariance)[1]


def _laplace(problem: Problem, theta: np.ndarray, others: tuple[float, ...]) -> Laplace:
    """The Gauss-Newton Gaussian at a maximum."""
    residual, slope, data_slope = _system(problem, theta)
    precision = slope.T @ slope
    at_bound = is_pinned(theta, problem.parameters)
    covariance = np.linalg.inv(precision) if len(problem.nodes) == 1 else _averaged_covariance(problem, theta)
    # a uniform prior resolves as a Gaussian of its standard deviation would
    flat = np.array([p.prior == "uniform" for p in problem.parameters]) / problem.parameters.std**2
    resolution = np.diag(np.linalg.solve(precision + np.diag(flat), data_slope.T @ data_slope))
    value, _ = problem.log_posterior(theta)
    gradient = -slope.T @ residual
    # at a bound only what points inside could be followed
    parameters = problem.parameters
    outward = np.where(theta - parameters.lower <= parameters.upper - theta, gradient < 0, gradient > 0)
    free = np.where(at_bound & outward, 0.0, gradient)
    return Laplace(
        theta=frozen_array(theta), covariance=frozen_array(covariance), precision=frozen_array(precision),
        gradient=frozen_array(gradient),
        projected_gradient=float(np.max(np.abs(free) * np.sqrt(np.diag(covariance)))),
        at_bound=frozen_array(at_bound, bool),
        resolution=frozen_array(resolution), log_posterior=float(value[0]),
        misfit=float(problem.misfit(problem.predict(theta))), others=others,
    )


def gaussian_at(
    problem: Problem, residual: np.ndarray, slope: np.ndarray, prior_precision: np.ndarray, prior_pull: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Of responses linear about a point, with residual (n_response,), slope (n_response, n_param) there and the prior's
    precision and slope of ln p (n_param,): ln of the integral over the parameters + const, the step from the point to
    the maximum, and the inverse precision."""
    white, X = problem.whiten(residual), problem.whiten(slope.T).T
    precision = X.T @ X + prior_precision
    pull = X.T @ white + prior_pull
    covariance = np.linalg.inv(precision)
    step = covariance @ pull
    value = problem.log_constant - 0.5 * white @ white + 0.5 * pull @ step
    return float(value - 0.5 * np.linalg.slogdet(precision)[1]), step, covariance


def _averaged_covariance(problem: Problem, theta: np.ndarray) -> np.ndarray:
    """Over the discrepancy's scales: mean of each one's covariance and covariance of their maxima (total variance)."""
    response, slope = problem.sensitivity(theta)
    prior, prior_slope = prior_residual(problem.parameters, theta)
    of_prior = prior_slope.T @ prior_slope, -prior_slope.T @ prior
    # nodes of a baseline expect other errors
    found = [gaussian_at(node, problem.measured - response + problem.mean - node.mean, slope, *of_prior)
             for _, node in problem.nodes]
    value = np.array([weight for weight, _ in problem.nodes]) + np.array([f[0] for f in found])
    share = np.exp(value - special.logsumexp(value))
    steps = np.array([f[1] for f in found])
    apart = steps - share @ steps
    return np.einsum("k,kij->ij", share, np.array([f[2] for f in found])) + (share[:, None] * apart).T @ apart


def _system(problem: Problem, theta: np.ndarray):
    """Residual and its slope of the whole posterior, and the data's part of the slope."""
    response, sensitivity = problem.sensitivity(theta)
    prior, prior_slope = prior_residual(problem.parameters, theta)
    data_slope = problem.whiten(sensitivity.T).T
    residual = np.concatenate([problem.whiten(response - problem.measured), prior])
    return residual, np.vstack([data_slope, prior_slope]), data_slope


def _value(problem: Problem, theta: np.ndarray) -> float:
    """-2 ln posterior + const; infinite where bounds allow what has no modes, such as a negative stiffness."""
    prior, _ = prior_residual(problem.parameters, theta)
    try:
        return float(problem.misfit(problem.predict(theta)) + prior @ prior)
    except (ProbupdateError, np.linalg.LinAlgError):
        return np.inf


def trust_region(problem: Problem, start: np.ndarray) -> np.ndarray:
    """The end of scipy's bounded trust-region least squares ('trf') on -2 ln posterior, from `start`."""
    from scipy import optimize

    parameters = problem.parameters
    kept: dict[bytes, tuple] = {}

    def system(theta):
        key = theta.tobytes()
        if key not in kept:
            kept.clear()
            try:
                kept[key] = _system(problem, theta)
            except (ProbupdateError, np.linalg.LinAlgError):
                # a step that is not a number is shortened; its slope is not asked for
                kept[key] = (np.full(problem.measured.size + len(parameters), np.inf),)
        return kept[key]

    # it wants a start strictly inside
    inside = 1e-6 * np.minimum(parameters.std, parameters.upper - parameters.lower)
    begin = np.clip(start, parameters.lower + inside, parameters.upper - inside)
    found = optimize.least_squares(
        lambda theta: system(theta)[0], begin, jac=lambda theta: system(theta)[1], method="trf",
        bounds=(parameters.lower, parameters.upper), x_scale=parameters.std, max_nfev=MAX_ITERATION,
    )
    return found.x


def _maxima_on_crossing(problem: Problem, best: tuple[np.ndarray, float, bool]) -> list[tuple[np.ndarray, float, bool]]:
    """The best end as settled where the way from the prior's centre ends as high: where two modes of the model are
    equal, as of a mast alike both ways, slopes jump from one side to the other, and a maximum there has none of zero.
    """
    theta = trust_region(problem, np.array(problem.parameters.initial))
    value = _value(problem, theta)
    if not abs(value - best[1]) < CREASE:
        return []
    return [(theta, value, True) if value < best[1] else (best[0], best[1], True)]


def _climb(problem: Problem, theta: np.ndarray) -> tuple[np.ndarray, float, bool]:
    """theta, -2 ln posterior + const, settled."""
    parameters = problem.parameters
    value = _value(problem, theta)
    if not np.isfinite(value):
        return theta, value, False
    share, last = 1.0, None
    for _ in range(MAX_ITERATION):
        residual, slope, _ = _system(problem, theta)
        step = bounded_step(slope, -residual, theta, parameters)
        share, trial, fresh = relaxation_share(step / parameters.std, last, share, LONGEST), theta, value
        last = step / parameters.std
        for _ in range(HALVINGS):
            trial = np.clip(theta + share * step, parameters.lower, parameters.upper)
            fresh = _value(problem, trial)
            if fresh <= value * (1 + ROUNDING):
                break
            share *= 0.5
        small = float(np.max(np.abs(step) / parameters.std))
        if fresh > value * (1 + ROUNDING):
            return theta, value, False
        theta, value = trial, fresh
        if small * share < TOLERANCE:
            return theta, value, True
    return theta, value, False
