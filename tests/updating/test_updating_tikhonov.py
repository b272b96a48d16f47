"""Eq. 7 in both readings: closed forms of the linear problem, bounds, line search, history, and the MAP."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import optimize
from updating_cases import (
    CHAIN_PARAMETERS,
    LINEAR_HZ,
    LINEAR_PARAMETERS,
    SLOPE,
    chain_model,
    chain_problem,
    linear_problem,
    measured_chain,
    modal_set,
)

from probupdate.errors import InputError
from probupdate.modal.modes import ModalData
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.functions import FunctionModel
from probupdate.updating.laplace import maximum_a_posteriori
from probupdate.updating.problem import build_problem
from probupdate.updating.tikhonov import bounded_step, update

MEASURED = LINEAR_HZ + np.array([0.03, -0.06, 0.10, 0.15, -0.30])
STD = 0.01 * LINEAR_HZ
PRIOR = LINEAR_PARAMETERS.covariance
START = LINEAR_PARAMETERS.initial


def closed_form_map(alpha=1.0):
    """Normal equations of the linear problem, by hand."""
    W = np.diag(1 / STD**2)
    normal = SLOPE.T @ W @ SLOPE + alpha * np.linalg.inv(PRIOR)
    return START + np.linalg.solve(normal, SLOPE.T @ W @ (MEASURED - LINEAR_HZ))


def whitened():
    """Singular values and vectors of the sensitivity in response and prior standard deviations, and the data in
    them."""
    deviations = np.sqrt(np.diag(PRIOR))
    u, s, v = np.linalg.svd(SLOPE / STD[:, None] * deviations, full_matrices=False)
    return s, deviations[:, None] * v.T, u.T @ ((MEASURED - LINEAR_HZ) / STD)


# the linear problem


@pytest.mark.parametrize("alpha", [0.1, 1.0, 10.0])
def test_one_anchored_step_is_the_closed_form_by_two_routes(alpha, validation):
    row = validation(what="one anchored step", reference="closed form by two routes",
                     why="rounding; derivatives by differences")
    run = update(linear_problem(MEASURED), penalty="prior", alpha=alpha)
    stacked = optimize.lsq_linear(
        np.vstack([SLOPE / STD[:, None], np.sqrt(alpha) * np.diag(1 / LINEAR_PARAMETERS.std)]),
        np.concatenate([(MEASURED - LINEAR_HZ) / STD, np.zeros(3)]), method="bvls",
    )
    row.error((START + stacked.x) / closed_form_map(alpha) - 1, below=1e-10, of="stacked least squares")
    row.error(run.theta[1] / closed_form_map(alpha) - 1, below=1e-7, of="the step")
    # linear: nothing is left for the second
    assert run.converged and len(run.theta) == 3
    assert run.theta[-1] == pytest.approx(closed_form_map(alpha), rel=1e-9)


@pytest.mark.parametrize("alpha", [0.3, 1.0])
def test_the_kth_printed_iterate_has_the_filter_factors_of_iterated_tikhonov(alpha, validation):
    row = validation(what="k-th iterate of Eq. 7 as printed", reference="filter factors of iterated Tikhonov",
                     why="derivatives by differences", unit="in theta")
    run = update(linear_problem(MEASURED), penalty="step", alpha=alpha, max_iteration=12)
    s, vectors, data = whitened()
    assert s.min() < 0.3 < 3 < s.max()
    for k, theta in enumerate(run.theta):
        filters = 1 - (alpha / (alpha + s**2)) ** k
        row.error(theta - (START + vectors @ (filters * data / s)), below=1e-6)
    assert len(run.theta) == 13 and not run.converged


def test_the_printed_scheme_forgets_the_prior_and_ends_at_the_least_squares_fit():
    run = update(linear_problem(MEASURED), penalty="step", alpha=0.02, max_iteration=300)
    fit = START + np.linalg.lstsq(SLOPE / STD[:, None], (MEASURED - LINEAR_HZ) / STD, rcond=None)[0]
    assert run.converged
    # it stops when steps shrink below 1e-6 prior standard deviations; what remains is that times 1 / (1 - contraction)
    s, *_ = whitened()
    left = 1e-6 * (0.02 + s.min() ** 2) / s.min() ** 2
    assert np.max(np.abs(run.theta[-1] - fit) / LINEAR_PARAMETERS.std) < 3 * left
    apart = np.linalg.norm((run.theta - fit) / LINEAR_PARAMETERS.std, axis=1)
    assert np.all(np.diff(apart) < 0)
    # not where the prior still counts
    assert np.max(np.abs(run.theta[-1] - closed_form_map(0.02)) / LINEAR_PARAMETERS.std) > 1000 * left


def test_both_readings_share_their_first_iteration_only():
    problem = chain_problem()
    printed = update(problem, penalty="step", max_iteration=3, tolerance=0.0)
    anchored = update(problem, penalty="prior", max_iteration=3, tolerance=0.0)
    assert printed.theta[1] == pytest.approx(anchored.theta[1], rel=1e-12)
    assert np.max(np.abs(printed.theta[2] - anchored.theta[2]) / CHAIN_PARAMETERS.std) > 1e-3


def test_a_correlated_prior_weighs_with_its_whole_inverse_covariance():
    correlation = np.array([[1.0, 0.7, 0.0], [0.7, 1.0, -0.3], [0.0, -0.3, 1.0]])
    parameters = Parameters(LINEAR_PARAMETERS.items, correlation)
    run = update(linear_problem(MEASURED, parameters), penalty="prior")
    W, W_theta = np.diag(1 / STD**2), np.linalg.inv(correlation * np.outer(parameters.std, parameters.std))
    expected = START + np.linalg.solve(SLOPE.T @ W @ SLOPE + W_theta, SLOPE.T @ W @ (MEASURED - LINEAR_HZ))
    assert run.theta[-1] == pytest.approx(expected, rel=1e-8)
    change = run.theta[-1] - START
    assert run.penalty[-1] == pytest.approx(change @ W_theta @ change, rel=1e-8)


# bounds


def bounded(**bounds):
    return Parameters(tuple(replace(p, **bounds.get(p.name, {})) for p in LINEAR_PARAMETERS))


def test_bounds_hold_and_the_end_is_the_bounded_minimum(validation):
    row = validation(what="bounded update's end", reference="scipy's bounded minimum", why="its minimiser's",
                     unit="in theta")
    free = closed_form_map()
    # 40 % of the way to where it wants
    assert free[1] > 2
    parameters = bounded(b={"upper": 2.0 + 0.4 * (free[1] - 2.0)})
    problem = linear_problem(MEASURED, parameters)
    for penalty in ("prior", "step"):
        run = update(problem, penalty=penalty, max_iteration=200)
        assert np.all(parameters.inside(run.theta))
        assert run.at_bound.tolist() == [False, True, False]

    def objective(theta):
        r = (MEASURED - LINEAR_HZ - SLOPE @ (theta - START)) / STD
        return r @ r + np.sum(((theta - START) / parameters.std) ** 2)

    run = update(problem, penalty="prior")
    bounds = list(zip(parameters.lower, parameters.upper, strict=True))
    options = {"ftol": 1e-15, "gtol": 1e-10}
    peer = optimize.minimize(objective, START, method="L-BFGS-B", bounds=bounds, options=options)
    assert objective(run.theta[-1]) <= objective(peer.x) * (1 + 1e-9)
    row.error(run.theta[-1] - peer.x, below=1e-4)
    assert run.objective[-1] == pytest.approx(objective(run.theta[-1]), rel=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_a_bounded_step_satisfies_the_conditions_of_optimality(seed):
    rng = np.random.default_rng(seed)
    scale = 10.0 ** rng.uniform(-6, 6, 5)
    parameters = Parameters(tuple(
        Parameter(name=f"p{k}", unit="-", initial=0.0, std=s, lower=-0.3 * s, upper=0.4 * s)
        for k, s in enumerate(scale)
    ))
    theta = parameters.initial + scale * np.array([0.4, -0.3, 0.0, 0.1, -0.1])
    matrix, right = rng.standard_normal((8, 5)) / scale, 3 * rng.standard_normal(8)
    step = bounded_step(matrix, right, theta, parameters)
    end = theta + step
    # to rounding: whoever takes the step cuts it at the bounds
    assert np.all((end - parameters.lower > -1e-14 * scale) & (parameters.upper - end > -1e-14 * scale))
    downhill = -(matrix.T @ (matrix @ step - right)) * scale
    size = np.max(np.abs(matrix.T @ right) * scale)
    low, high = end - parameters.lower < 1e-9 * scale, parameters.upper - end < 1e-9 * scale
    assert np.all(np.abs(downhill[~low & ~high]) < 1e-8 * size)
    assert np.all(downhill[low] < 1e-8 * size) and np.all(downhill[high] > -1e-8 * size)


def test_a_start_at_the_very_bound_can_leave_it():
    free = closed_form_map()
    parameters = bounded(b={"lower": 2.0} if free[1] > 2 else {"upper": 2.0})
    run = update(linear_problem(MEASURED, parameters))
    assert run.theta[-1] == pytest.approx(free, rel=1e-8) and not run.at_bound.any()


# stopping and history


def test_history_has_one_row_for_every_parameter_vector_and_one_share_for_every_step():
    problem = chain_problem()
    for penalty in ("prior", "step"):
        run = update(problem, penalty=penalty, max_iteration=5, tolerance=0.0)
        assert run.theta.shape == (6, 4) and run.share.shape == (5,)
        assert run.misfit.shape == run.penalty.shape == run.objective.shape == (6,)
        assert run.frequency_hz.shape == run.mac.shape == (6, 4)
        assert not run.converged and "5 iterations" in run.status
        for k, theta in enumerate(run.theta):
            change = (theta - CHAIN_PARAMETERS.initial) / CHAIN_PARAMETERS.std
            assert run.misfit[k] == pytest.approx(problem.misfit(problem.predict(theta)))
            assert run.penalty[k] == pytest.approx(change @ change)
            assert run.frequency_hz[k] == pytest.approx(problem.predict(theta)[:4])
        with pytest.raises(ValueError, match="read-only"):
            run.theta[0, 0] = 0


def test_it_stops_when_no_parameter_moves_by_more_than_the_tolerance():
    problem = chain_problem()
    for tolerance in (1e-2, 1e-4, 1e-6):
        run = update(problem, tolerance=tolerance)
        moves = np.max(np.abs(np.diff(run.theta, axis=0)) / CHAIN_PARAMETERS.std, axis=1)
        assert run.converged
        assert moves[-1] < tolerance and np.all(moves[:-1] >= tolerance)


def test_no_iteration_at_all_returns_the_start():
    run = update(chain_problem(), max_iteration=0)
    assert run.theta == pytest.approx(CHAIN_PARAMETERS.initial[None]) and run.share.size == 0 and not run.converged


def test_data_predicted_exactly_by_the_start_settle_there():
    problem = chain_problem(CHAIN_PARAMETERS.initial, noise=0.0)
    for penalty in ("prior", "step"):
        run = update(problem, penalty=penalty)
        assert run.converged, run.status
        assert run.theta[-1] == pytest.approx(CHAIN_PARAMETERS.initial, abs=1e-9)


def saturating_problem():
    """A frequency that hardly changes at the start and quickly further on: Gauss-Newton steps overshoot."""
    shape = np.linalg.qr(np.random.default_rng(9).standard_normal((13, 13)))[0]
    spare = 50.0 * 1.5 ** np.arange(12)
    parameters = Parameters((Parameter(name="t", unit="-", initial=0.0, std=10.0, lower=-40.0, upper=40.0),))
    model = FunctionModel(
        name="steep", parameters=parameters, channels=tuple(f"c{k}" for k in range(13)), version="1",
        function=lambda theta: (np.concatenate([[2.0 + np.tanh(theta[0] - 1.5)], spare]), shape),
    )
    return build_problem(model, ModalData(channels=model.channels, sets=(modal_set([2.6], shape[:, :1]),)))


def test_steps_that_overshoot_are_shortened_and_every_taken_one_lowers_the_objective():
    run = update(saturating_problem(), max_iteration=50)
    assert run.share.min() < 1
    assert np.all(np.diff(run.objective) <= 1e-9 * run.objective[0])
    assert run.converged
    # 2.6 = 2 + tanh(t - 1.5), the prior being wide
    assert run.theta[-1, 0] == pytest.approx(1.5 + np.arctanh(0.6), abs=0.05)


# against the maximum of the posterior


def test_anchored_at_alpha_one_it_ends_at_the_map_and_the_printed_one_does_not(validation):
    row = validation(what="anchored update's end", reference="MAP", why="where both stop",
                     unit="posterior standard deviations")
    problem = chain_problem(noise=0.015)
    anchored = update(problem)
    top = maximum_a_posteriori(problem, [CHAIN_PARAMETERS.initial])
    assert anchored.converged

    def deviations(theta):
        d = theta - top.theta
        return np.sqrt(d @ top.precision @ d / d.size)

    row.error(deviations(anchored.theta[-1]), below=1e-5)
    printed = update(problem, penalty="step", max_iteration=60)
    assert deviations(printed.theta[-1]) > 0.1
    # its J, counted from the prior, is lowest early and rises again
    assert np.argmin(printed.objective) < 5
    assert printed.objective[-1] > printed.objective.min() * 1.01
    assert printed.misfit[-1] < anchored.misfit[-1]


def test_more_regularisation_stays_closer_to_the_start():
    problem = chain_problem()
    ends = [update(problem, alpha=alpha).theta[-1] for alpha in (0.1, 1.0, 10.0, 1e8)]
    apart = [np.linalg.norm((end - CHAIN_PARAMETERS.initial) / CHAIN_PARAMETERS.std) for end in ends]
    assert np.all(np.diff(apart) < 0) and apart[-1] < 1e-4


# mistakes


@pytest.mark.parametrize(
    ("options", "words"),
    [({"penalty": "ridge"}, "penalty: 'ridge' is unknown"), ({"alpha": -1.0}, "alpha: -1.0"),
     ({"alpha": np.nan}, "alpha: nan"), ({"alpha": np.inf}, "alpha: inf"), ({"start": [1.0, 1.0]}, "start"),
     ({"start": [99.0, 1.0, 1.0, 0.0]}, "start"), ({"start": [np.nan, 1.0, 1.0, 0.0]}, "start"),
     ({"max_iteration": -1}, "iterations: -1")],
)
def test_impossible_options_are_one_clear_line(options, words):
    with pytest.raises(InputError, match=words) as error:
        update(chain_problem(), **options)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("penalty", ["step", "prior"])
def test_a_step_onto_a_bound_without_stiffness_is_halved(penalty):
    """Whole steps go to a spring of zero, where a chain has no modes: the update was refused."""
    items = (replace(CHAIN_PARAMETERS.items[0], lower=0.0), *CHAIN_PARAMETERS.items[1:])
    model, truth = chain_model(Parameters(items)), np.array([0.12, 1.0, 1.0, 0.02])
    with pytest.raises(InputError, match="not positive definite"):
        model.solve(np.array([0.0, 1.0, 1.0, 0.02]), 2)
    problem = build_problem(model, measured_chain(truth, model=model))
    assert bounded_first_step(problem)[0] == pytest.approx(-1.0)
    assert update(problem, penalty=penalty).theta[-1][0] == pytest.approx(0.12, abs=0.03)


def bounded_first_step(problem):
    initial = problem.parameters.initial
    response, slope = problem.sensitivity(initial)
    matrix = np.vstack([problem.whiten(slope.T).T, np.diag(1 / problem.parameters.std)])
    right = np.concatenate([problem.whiten(problem.measured - response), np.zeros(len(initial))])
    return bounded_step(matrix, right, initial, problem.parameters)
