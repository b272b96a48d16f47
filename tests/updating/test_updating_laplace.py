"""The maximum of the posterior and its Gaussian: closed forms, scipy's optimisers, numerical Hessians."""

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

import probupdate
from probupdate import LikelihoodSettings, SamplerSettings
from probupdate.errors import ConvergenceError
from probupdate.modal.modes import ModalData
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.functions import FunctionModel
from probupdate.updating import laplace as laplace_module
from probupdate.updating import runs, tikhonov
from probupdate.updating.laplace import maximum_a_posteriori, prior_residual
from probupdate.updating.problem import Problem, Weights, build_problem
from probupdate.updating.tikhonov import update

MEASURED = LINEAR_HZ + np.array([0.03, -0.06, 0.10, 0.15, -0.30])
MIXED = Parameters((
    Parameter(name="base", unit="-", initial=1.0, std=0.5, lower=0.05, upper=6.0, prior="lognormal"),
    Parameter(name="upper", unit="-", initial=1.0, std=0.1, lower=0.3, upper=2.0),
    Parameter(name="top", unit="-", initial=1.0, std=0.05, lower=0.5, upper=2.0, prior="lognormal"),
    Parameter(name="twist", unit="-", initial=0.02, std=0.02, lower=-0.2, upper=0.2),
))
CORRELATION = np.array([[1.0, 0.6, 0.2, 0.0], [0.6, 1.0, 0.0, 0.0], [0.2, 0.0, 1.0, -0.3], [0.0, 0.0, -0.3, 1.0]])


def negative_log_posterior(problem: Problem):
    return lambda theta: -float(problem.log_posterior(np.asarray(theta))[0][0])


def numerical_hessian(function, theta, step):
    n = len(theta)
    H = np.empty((n, n))
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for a in (1, -1):
                for b in (1, -1):
                    moved = np.array(theta, float)
                    moved[i] += a * step[i]
                    moved[j] += b * step[j]
                    total += a * b * function(moved)
            H[i, j] = H[j, i] = total / (4 * step[i] * step[j])
    return H


# closed form


def test_the_linear_problem_has_its_closed_form(validation):
    row = validation(what="MAP, covariance, resolution of a linear problem", reference="closed form",
                     why="derivatives by differences")
    top = maximum_a_posteriori(linear_problem(MEASURED), [LINEAR_PARAMETERS.initial])
    W, W_theta = np.diag(1 / (0.01 * LINEAR_HZ) ** 2), np.linalg.inv(LINEAR_PARAMETERS.covariance)
    P = np.linalg.inv(SLOPE.T @ W @ SLOPE + W_theta)
    exact = LINEAR_PARAMETERS.initial + P @ SLOPE.T @ W @ (MEASURED - LINEAR_HZ)
    row.error(top.theta / exact - 1, below=1e-8, of="MAP")
    row.error(top.covariance / P - 1, below=1e-6, of="covariance")
    resolution = 1 - np.diag(P) / np.diag(LINEAR_PARAMETERS.covariance)
    row.error(top.resolution / resolution - 1, below=1e-6, of="resolution")
    assert top.gradient * LINEAR_PARAMETERS.std == pytest.approx(np.zeros(3), abs=1e-5)
    assert top.others == () and not top.at_bound.any()


def test_resolution_is_zero_where_the_data_say_nothing_and_one_where_they_say_all():
    slope = np.array(SLOPE)
    slope[:, 2] = 0.0
    slope[:, 0] *= 30.0
    # the data must stay within the spacing of the frequencies
    measured = LINEAR_HZ + slope @ [0.01, 0.1, 0.0]
    top = maximum_a_posteriori(linear_problem(measured, slope=slope), [LINEAR_PARAMETERS.initial])
    assert abs(top.resolution[2]) < 1e-9
    assert top.covariance[2, 2] == pytest.approx(0.2**2, rel=1e-9)
    assert top.theta[2] == pytest.approx(-1.0, abs=1e-9)
    # R = I - P W_Theta
    std = LINEAR_PARAMETERS.std[0]
    assert top.resolution[0] > 0.999 and top.resolution[0] == pytest.approx(1 - top.covariance[0, 0] / std**2, abs=1e-9)


# the chain with its close pairs


@pytest.mark.parametrize(
    ("parameters", "name"),
    [(CHAIN_PARAMETERS, "normal"), (MIXED, "mixed"), (Parameters(MIXED.items, CORRELATION), "mixed, correlated")],
)
def test_no_optimiser_of_scipy_finds_a_higher_point(parameters, name, validation):
    row = validation(what="MAP, three kinds of prior: ln p above it; distance in posterior standard deviations",
                     reference="scipy's Nelder-Mead", why="where the other solver ends")
    problem = build_problem(chain_model(parameters), measured_chain(noise=0.01, seed=5))
    top = maximum_a_posteriori(problem, [parameters.initial])
    function = negative_log_posterior(problem)
    assert top.log_posterior == pytest.approx(-function(top.theta), rel=1e-12)
    root = np.linalg.cholesky(top.covariance)
    # off by about two standard deviations in every direction, optimised in whitened coordinates
    begin = np.random.default_rng(6).standard_normal(4) * 2
    peer = optimize.minimize(
        lambda z: function(np.clip(top.theta + root @ z, parameters.lower, parameters.upper)), begin,
        method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-7, "maxfev": 500},
    )
    assert peer.success
    row.error(max(-peer.fun - top.log_posterior, 0.0), below=1e-6, of="ln p")
    # within a hundredth of a posterior standard deviation of the same point
    row.error(peer.x, below=0.01, of="distance")


@pytest.mark.parametrize("parameters", [CHAIN_PARAMETERS, MIXED, Parameters(MIXED.items, CORRELATION)])
def test_the_gradient_is_that_of_the_log_posterior(parameters):
    problem = build_problem(chain_model(parameters), measured_chain(noise=0.01, seed=5))
    top = maximum_a_posteriori(problem, [parameters.initial])
    function = negative_log_posterior(problem)
    posterior_std = np.sqrt(np.diag(top.covariance))
    for k in range(4):
        h = np.zeros(4)
        h[k] = 1e-3 * posterior_std[k]
        slope = -(function(top.theta + h) - function(top.theta - h)) / (2 * h[k])
        # in units of one over a posterior deviation: the maximum is flat to a thousandth
        assert abs(slope) * posterior_std[k] < 1e-3
        assert abs(top.gradient[k]) * posterior_std[k] < 1e-4


def test_the_precision_is_the_gauss_newton_hessian_by_differences_of_the_responses():
    problem = chain_problem(noise=0.01)
    top = maximum_a_posteriori(problem, [CHAIN_PARAMETERS.initial])
    J = np.empty((problem.measured.size, 4))
    for k in range(4):
        h = np.zeros(4)
        h[k] = 1e-4 * CHAIN_PARAMETERS.std[k]
        J[:, k] = (problem.predict(top.theta + h) - problem.predict(top.theta - h)) / (2 * h[k] * problem.std)
    expected = J.T @ J + np.diag(1 / CHAIN_PARAMETERS.std**2)
    scale = np.sqrt(np.diag(expected))
    assert top.precision / np.outer(scale, scale) == pytest.approx(expected / np.outer(scale, scale), abs=1e-6)
    assert top.covariance @ top.precision == pytest.approx(np.eye(4), abs=1e-8)


def test_the_whole_hessian_is_gauss_newtons_where_the_model_fits():
    # without noise and with a prior centred on the truth residuals vanish, and with them their curvature
    problem = chain_problem(CHAIN_PARAMETERS.initial, noise=0.0)
    top = maximum_a_posteriori(problem, [CHAIN_PARAMETERS.initial * 1.01])
    assert top.theta == pytest.approx(CHAIN_PARAMETERS.initial, abs=1e-6)
    posterior_std = np.sqrt(np.diag(top.covariance))
    found = numerical_hessian(negative_log_posterior(problem), top.theta, 0.02 * posterior_std)
    scale = np.sqrt(np.diag(top.precision))
    assert found / np.outer(scale, scale) == pytest.approx(top.precision / np.outer(scale, scale), abs=2e-3)


def test_data_predicted_exactly_by_the_start_settle_there():
    # -2 ln p is zero there but for rounding: no step lowers it any more
    problem = chain_problem(CHAIN_PARAMETERS.initial, noise=0.0)
    top = maximum_a_posteriori(problem, [CHAIN_PARAMETERS.initial])
    assert top.theta == pytest.approx(CHAIN_PARAMETERS.initial, abs=1e-9) and top.misfit < 1e-12


# the prior as residuals


@pytest.mark.parametrize("correlation", [None, CORRELATION])
def test_the_priors_residual_is_its_log_density_and_its_slope_their_derivative(correlation):
    parameters = Parameters(MIXED.items, correlation)
    rng = np.random.default_rng(8)
    points = parameters.initial * rng.uniform(0.6, 1.5, (6, 4))
    values = [prior_residual(parameters, theta) for theta in points]
    quadratic = np.array([-0.5 * r @ r for r, _ in values])
    density = parameters.log_density(points)
    assert quadratic - quadratic[0] == pytest.approx(density - density[0], abs=1e-10)
    for theta, (_, slope) in zip(points, values, strict=True):
        for k in range(4):
            h = np.zeros(4)
            h[k] = 1e-6 * theta[k]
            up, down = prior_residual(parameters, theta + h)[0], prior_residual(parameters, theta - h)[0]
            assert slope[:, k] == pytest.approx((up - down) / (2 * h[k]), rel=1e-6, abs=1e-6 * np.abs(slope).max())


# bounds


def test_a_maximum_at_a_bound_is_flagged_and_its_gradient_points_outward():
    tight = Parameters((replace(CHAIN_PARAMETERS.items[0], lower=0.9), *CHAIN_PARAMETERS.items[1:]))
    problem = build_problem(chain_model(tight), measured_chain(noise=0.004, seed=3))
    top = maximum_a_posteriori(problem, [tight.initial])
    assert top.at_bound.tolist() == [True, False, False, False]
    assert top.theta[0] == pytest.approx(0.9, abs=1e-12)
    posterior_std = np.sqrt(np.diag(top.covariance))
    assert top.gradient[0] * posterior_std[0] < -0.1
    assert np.max(np.abs(top.gradient[1:]) * posterior_std[1:]) < 1e-4
    # the free directions are at their best given the bound
    function = negative_log_posterior(problem)
    peer = optimize.minimize(lambda z: function([0.9, *(top.theta[1:] + z * posterior_std[1:])]), np.ones(3) * 0.5,
                             method="Nelder-Mead", options={"xatol": 1e-5, "fatol": 1e-9, "maxfev": 500})
    assert np.max(np.abs(peer.x)) < 0.01


# several maxima


def two_sided_problem():
    """f = 2 + t^2 / 4: the data want |t| = 1, the prior leans to one side."""
    shape = np.linalg.qr(np.random.default_rng(9).standard_normal((13, 13)))[0]
    spare = 50.0 * 1.5 ** np.arange(12)
    parameters = Parameters((Parameter(name="t", unit="-", initial=0.2, std=1.0, lower=-5.0, upper=5.0),))
    model = FunctionModel(
        name="folded", parameters=parameters, channels=tuple(f"c{k}" for k in range(13)), version="1",
        function=lambda theta: (np.concatenate([[2.0 + theta[0] ** 2 / 4], spare]), shape),
    )
    return build_problem(model, ModalData(channels=model.channels, sets=(modal_set([2.25], shape[:, :1]),)))


def test_the_higher_of_two_maxima_wins_and_the_other_is_told_by_its_depth():
    problem = two_sided_problem()
    function = negative_log_posterior(problem)
    options = {"method": "bounded", "options": {"xatol": 1e-9}}
    right = optimize.minimize_scalar(lambda t: function([t]), bounds=(0.2, 3), **options)
    left = optimize.minimize_scalar(lambda t: function([t]), bounds=(-3, -0.2), **options)
    top = maximum_a_posteriori(problem, [[-2.0], [2.0], [1.5]])
    assert top.theta == pytest.approx([right.x], abs=1e-6)
    assert top.others == pytest.approx((left.fun - right.fun,), abs=1e-3)
    assert maximum_a_posteriori(problem, [[2.0], [1.5]]).others == ()


def bent_model():
    """The misfit of 2 Hz has a minimum beside the initial value and one of nothing at t = 2."""
    shape = np.linalg.qr(np.random.default_rng(9).standard_normal((6, 6)))[0]
    parameters = Parameters((Parameter(name="t", unit="-", initial=0.0, std=1.0, lower=-5.0, upper=5.0),))

    def modes(theta):
        first = 2.0 + 0.06 * (theta[0] - 2) * ((theta[0] + 0.2) ** 2 + 1)
        return np.array([first, *(20.0 * 1.5 ** np.arange(5))]), shape

    model = FunctionModel(name="bent", parameters=parameters, channels=tuple("abcdef"), version="1", function=modes)
    return model, shape


def bent_sets(frequencies, std):
    model, shape = bent_model()
    sets = tuple(replace(modal_set([f], shape[:, :1], std=np.array([std])), id=f"s{k}")
                 for k, f in enumerate(frequencies))
    return model, ModalData(channels=model.channels, sets=sets)


FREQUENCIES_ALONE = LikelihoodSettings(shapes="none", discrepancy=0.0)


def test_an_update_is_not_left_in_a_lower_maximum_beside_its_start():
    """On a monopile whose sensor was 12 % too large `update` stayed at a soil factor of 0.86 where 1.48 is more
    probable."""
    model, data = bent_sets([2.0], 0.05)
    record = probupdate.update(model, data, likelihood=FREQUENCIES_ALONE)
    problem = build_problem(model, data, weights=Weights(shapes="none"))
    far = optimize.minimize_scalar(lambda t: negative_log_posterior(problem)([t]), bounds=(1.5, 3), method="bounded")
    assert record.map_theta == pytest.approx([far.x], abs=1e-4)
    assert len(record.other_maxima) == 1


def test_the_maximum_of_a_chain_is_the_highest_that_its_starts_found(tmp_path, monkeypatch):
    model, data = bent_sets([2.0], 0.05)
    highest = probupdate.update(model, data, likelihood=FREQUENCIES_ALONE).map_theta
    monkeypatch.setattr(runs, "probable_draws", lambda problem: [])
    assert abs(probupdate.update(model, data, likelihood=FREQUENCIES_ALONE).map_theta[0] - highest[0]) > 1
    short = SamplerSettings(target_ess=50, max_steps=100, ensembles=2, seed=2)
    posterior = probupdate.sample(model, data, tmp_path / "p.nc", likelihood=FREQUENCIES_ALONE, settings=short)
    assert posterior.record["map"] == pytest.approx(highest.tolist(), abs=1e-4)


def test_sets_that_are_alike_do_not_part_between_two_maxima():
    """Either maximum is the higher one of some sets: their scatter is that of the frequencies, not of the choice."""
    frequencies = 2.0 + 0.005 * np.array([-1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5])
    record = probupdate.update(*bent_sets(frequencies, 0.064), likelihood=FREQUENCIES_ALONE)
    # dt/df of the model at t = 2 is 1 / (0.06 (2.2^2 + 1))
    slope = 1 / (0.06 * (2.2**2 + 1))
    assert np.std(record.sets.theta_map) < 2 * slope * np.std(frequencies)
    # the prior, 2 away, pulls a single set by so much
    pulled = record.map_theta[0] - 2 * (slope * 0.064) ** 2
    assert np.mean(record.sets.theta_map) == pytest.approx(pulled, abs=2 * slope * np.std(frequencies))


def test_where_nothing_settles_the_best_parameters_are_handed_over(monkeypatch):
    monkeypatch.setattr(laplace_module, "MAX_ITERATION", 1)
    problem = chain_problem(noise=0.01)
    with pytest.raises(ConvergenceError, match="was not reached within 1 iterations from any of 1 starts") as error:
        maximum_a_posteriori(problem, [CHAIN_PARAMETERS.initial])
    function = negative_log_posterior(problem)
    assert function(error.value.estimate) < function(CHAIN_PARAMETERS.initial)


def test_a_mode_whose_counterpart_changes_on_the_way_is_named(monkeypatch):
    """Two oscillators, of which the data say that the softer one of the model is the stiffer."""
    def solve(theta):
        f, order = np.sqrt([theta[0], 1.3]), np.argsort([theta[0], 1.3])
        return f[order], np.eye(2)[:, order]

    parameters = Parameters((Parameter(name="k", unit="-", initial=1.0, std=1.0, lower=0.1, upper=9.0),))
    model = FunctionModel(name="two", parameters=parameters, channels=("a", "b"), function=solve, version="1")
    frequency, shape = solve([2.0])
    data = ModalData(channels=("a", "b"), sets=(modal_set(frequency, shape, std=0.001 * frequency),))
    problem = build_problem(model, data, weights=Weights(shape_std=False))
    monkeypatch.setattr(laplace_module, "MAX_ITERATION", 1)
    with pytest.raises(ConvergenceError, match="which of the model's modes is .* changes with the parameters") as error:
        maximum_a_posteriori(problem, [np.array([1.0])])
    assert error.value.modes == (0, 1)


def test_a_mode_whose_counterpart_changes_is_left_out_and_said(monkeypatch):
    given = LikelihoodSettings.stated_for

    def with_three(self, model, data, **more):
        if data.n_mode == 4:
            raise ConvergenceError("no maximum was reached", None, (2,))
        return given(self, model, data, **more)

    monkeypatch.setattr(LikelihoodSettings, "stated_for", with_three)
    record = probupdate.update(chain_model(), measured_chain(noise=0.01),
                               likelihood=LikelihoodSettings(discrepancy=0.0))
    assert len(record.measured_hz) == 3
    assert "mode 3 left out: its counterpart among the model's modes changes" in record.settings["sets"]


def test_the_updates_end_is_a_start_that_is_already_there():
    problem = chain_problem(noise=0.01, weights=Weights(frequency_cov=(0.015,) * 4, shape_std=False))
    anchored = update(problem)
    top = maximum_a_posteriori(problem, [anchored.theta[-1]])
    assert np.max(np.abs(top.theta - anchored.theta[-1]) / np.sqrt(np.diag(top.covariance))) < 1e-4


def test_steps_that_overshoot_are_shortened(monkeypatch, validation):
    """A residual whose curvature exceeds what Gauss-Newton keeps: full steps part from the maximum by 1.6 a step."""
    row = validation(what="maximum where Gauss-Newton steps grow by 1.6", reference="scipy's scalar minimiser",
                     why="root of rounding", unit="in theta")
    parameters = Parameters((Parameter(name="a", unit="-", initial=1.0, std=1.0),))
    shape = np.linalg.qr(np.random.default_rng(2).standard_normal((4, 4)))[0]
    model = FunctionModel(name="bowl", parameters=parameters, channels=tuple("abcd"), version="1",
                          function=lambda theta: (np.array([10 + theta[0] ** 2, 20.0, 40.0, 80.0]), shape))
    # the parameter moves one frequency only, and that cannot come nearer than one standard deviation of what was
    # measured
    data = ModalData(channels=model.channels, sets=(modal_set(np.array([9.0]), shape[:, :1], std=np.array([1.0])),))
    problem = build_problem(model, data, weights=Weights(shapes="none"))
    end = optimize.minimize_scalar(lambda a: (1 + a**2) ** 2 + (a - 1) ** 2, bracket=(0, 0.3, 1), tol=1e-14)
    anchored = update(problem, penalty="prior")
    found = maximum_a_posteriori(problem, [parameters.initial])
    # a minimiser of values is good to the root of rounding
    row.error(found.theta[0] - end.x, below=1e-7)
    assert anchored.converged
    assert anchored.theta[-1, 0] == pytest.approx(end.x, abs=1e-6)
    assert anchored.share.min() < 0.9 and anchored.share.max() <= 1
    monkeypatch.setattr(tikhonov, "RELAX_BELOW", 0.0)
    assert len(update(problem, penalty="prior").share) > 2 * len(anchored.share)
