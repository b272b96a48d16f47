"""Priors at their bounds: zero density, mass inside, joint moments, flat ones, and means near zero."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, stats
from updating_cases import LINEAR_HZ, LINEAR_PARAMETERS, SLOPE, linear_data, linear_model, linear_problem

from probupdate import verbs
from probupdate.errors import InputError
from probupdate.model.box_probability import draws_in_box, log_box_probability
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.parameter_table import parameter_from_table
from probupdate.updating.comparison import compare
from probupdate.updating.discrepancy import LikelihoodSettings
from probupdate.updating.identifiability import cov_of, sampled_width
from probupdate.updating.laplace import maximum_a_posteriori
from probupdate.updating.problem import Weights, build_problem
from probupdate.updating.settings import SamplerSettings, UpdateSettings

SHORT = SamplerSettings(target_ess=50, max_steps=100, ensembles=2)
FREQUENCIES = LikelihoodSettings(shapes="none", tolerances=False, discrepancy=0.0)
B, C = LINEAR_PARAMETERS.items[1:]


def pair(rho):
    return np.array([[1.0, rho], [rho, 1.0]])


@pytest.mark.parametrize(("low", "high", "rho"), [
    ((0.0, -np.inf), (np.inf, np.inf), 0.95), ((3.0, -3.2), (3.1, -3.0), 0.9), ((2.0, 2.0), (2.5, 2.4), -0.5),
    ((-1.0, 4.0), (1.0, 5.0), 0.0),
])
def test_the_mass_inside_two_bounds_is_that_of_quadrature(validation, low, high, rho):
    row = validation(what="mass of a correlated prior inside its bounds, down to 1e-20", reference="quadrature",
                     why="eight scrambled sequences; quadrature's own 1e-8", unit="stated standard deviations")
    found, std = log_box_probability(np.array(low), np.array(high), pair(rho), np.random.default_rng(1))
    root = np.sqrt(1 - rho**2)

    def inner(x):
        # of the second given the first, in whichever tail is exact
        a, b = (low[1] - rho * x) / root, (high[1] - rho * x) / root
        return stats.norm.pdf(x) * (stats.norm.sf(a) - stats.norm.sf(b) if a > 0 else stats.norm.cdf(b)
                                    - stats.norm.cdf(a))

    exact, _ = integrate.quad(inner, max(low[0], -8), min(high[0], 8), epsabs=0, epsrel=1e-9)
    row.error((found - np.log(exact)) / (std + 1e-7), below=5)
    assert std < 2e-3


def test_the_mass_inside_narrow_bounds_of_many_is_computed_with_its_error():
    """Equal correlations have a one-dimensional integral; counting draws would find none of 1e-12."""
    n, rho = 8, 0.6
    low, high = np.full(n, 1.0), np.full(n, 1.1)
    found, std = log_box_probability(low, high, rho * np.ones((n, n)) + (1 - rho) * np.eye(n), np.random.default_rng(0))

    def inner(x):
        ends = (np.array([1.0, 1.1]) - np.sqrt(rho) * x) / np.sqrt(1 - rho)
        return stats.norm.pdf(x) * (stats.norm.cdf(ends[1]) - stats.norm.cdf(ends[0])) ** n

    exact, _ = integrate.quad(inner, -8, 8, epsabs=0, epsrel=1e-9)
    assert exact < 1e-8 and std < 0.01
    assert found == pytest.approx(np.log(exact), abs=5 * std + 1e-6)


def test_draws_within_narrow_bounds_come_to_an_end_and_are_the_priors():
    low, high = np.array([2.0, 1.0]), np.array([2.2, 1.3])
    drawn = draws_in_box(low, high, pair(0.8), np.random.default_rng(3), 4000)
    assert np.all((drawn >= low) & (drawn <= high))
    grid = np.linspace(low[1], high[1], 400)
    first = np.linspace(low[0], high[0], 400)
    density = stats.multivariate_normal([0, 0], pair(0.8)).pdf(np.stack(np.meshgrid(first, grid, indexing="ij"), -1))
    mean = [np.sum(density * first[:, None]) / density.sum(), np.sum(density * grid[None]) / density.sum()]
    assert np.abs(drawn.mean(axis=0) - mean) == pytest.approx(0.0, abs=5 * 0.09 / np.sqrt(4000))


def lognormal(low):
    return Parameters((Parameter(name="a", unit="-", initial=1.0, std=1.5, lower=low, prior="lognormal"), B, C))


@pytest.mark.parametrize("low", [0.0, -np.inf, -3.0])
def test_a_lognormal_prior_is_zero_at_zero_and_below(low):
    parameters = lognormal(low)
    density = parameters.log_density(parameters.initial * [[1, 1, 1], [0, 1, 1], [-1, 1, 1]])
    assert np.isfinite(density[0]) and np.all(density[1:] == -np.inf)


def test_estimates_with_a_lognormal_prior_stay_above_zero(tmp_path):
    parameters = lognormal(-np.inf)
    data = linear_data(LINEAR_HZ + SLOPE @ np.array([-0.98, 0.0, 0.0]), cov=0.02)
    record = verbs.update(linear_model(parameters), data)
    drawn = verbs.sample(linear_model(parameters), data, tmp_path / "p.nc", settings=SHORT)
    assert record.map_theta[0] > 0 and np.all(drawn.draws[:, 0] > 0) and np.isfinite(record.map_covariance).all()


@pytest.mark.parametrize("correlation", [None, np.array([[1, 0.9, 0], [0.9, 1, 0], [0, 0, 1.0]])])
def test_a_step_of_eq_7_that_ends_at_a_lognormals_zero_is_no_end_of_the_update(correlation):
    """Data that ask for a = -1.5; the path over alpha went on from zero, and was refused as out of its bounds."""
    parameters = Parameters(lognormal(0.0).items, correlation)
    data = linear_data(LINEAR_HZ + SLOPE @ np.array([-2.5, 0.5, 0.1]))
    record = verbs.update(linear_model(parameters), data, likelihood=FREQUENCIES)
    assert record.schemes[0].theta[-1][0] == 0 and 0 < record.map_theta[0] < 0.2


def test_a_parameter_that_the_data_leave_alone_keeps_its_joint_prior():
    """Correlation 0.95 with one that a bound cuts at its mode: the other's prior is narrower than its own says."""
    items = (Parameter(name="a", unit="-", initial=1.0, std=0.5, lower=1.0), B, C)
    parameters = Parameters(items, np.array([[1, 0.95, 0], [0.95, 1, 0], [0, 0, 1.0]]))
    rng = np.random.default_rng(2)
    width = sampled_width(parameters.draw(rng, 8000), parameters)
    assert width == pytest.approx(np.ones(3), abs=0.03)
    assert parameters.moments[1][1] < 0.75 * B.std
    mean = B.initial + 0.95 * B.std * np.sqrt(2 / np.pi)
    assert parameters.moments[0][1] == pytest.approx(mean, abs=0.01)


def test_a_uniform_prior_is_flat_and_the_posterior_the_likelihood():
    flat = Parameter(name="a", unit="-", initial=1.0, lower=0.0, upper=3.0, prior="uniform")
    assert flat.std == pytest.approx(3 / np.sqrt(12))
    parameters = Parameters((flat, B, C))
    inside = parameters.initial + [[0.0, 0, 0], [1.5, 0, 0], [-1.0, 0, 0]]
    assert np.ptp(parameters.log_density(inside)) < 1e-12
    assert parameters.log_density(parameters.initial + [2.1, 0, 0]) == -np.inf
    problem = linear_problem(LINEAR_HZ + SLOPE @ np.array([1.2, 0.0, 0.0]), parameters)
    top = maximum_a_posteriori(problem, [parameters.initial])
    assert top.theta[0] == pytest.approx(2.2, abs=1e-4)
    W = np.diag(1 / (0.01 * LINEAR_HZ) ** 2)
    precision = SLOPE.T @ W @ SLOPE + np.diag([0.0, B.std**-2, C.std**-2])
    assert top.covariance == pytest.approx(np.linalg.inv(precision), rel=1e-4)
    assert maximum_a_posteriori(linear_problem(LINEAR_HZ, parameters), [parameters.initial]).resolution.max() < 1


def test_what_a_uniform_prior_needs_is_said():
    with pytest.raises(InputError, match="both bounds"):
        Parameter(name="a", unit="-", initial=1.0, lower=0.0, prior="uniform")
    with pytest.raises(InputError, match="no correlation"):
        Parameters((Parameter(name="a", unit="-", initial=1.0, lower=0, upper=2, prior="uniform"), B), pair(0.5))
    row = {"name": "k", "initial": 1.0, "lower": 0.5, "upper": 2.0, "prior": "uniform"}
    assert parameter_from_table(row, "t").std == pytest.approx(1.5 / np.sqrt(12))


@pytest.mark.parametrize(("mean", "std", "initial", "lower", "known"), [
    (0.01, 0.1, 1.0, -np.inf, False), (-1.0, 0.7, 1.0, -3.0, False), (1.0, 0.8, 1.0, 0.0, True),
    (-1.0, 0.2, 1.0, -3.0, True), (0.01, 0.1, 0.0, 0.0, False), (4.0, 1.2, 0.0, 0.0, True),
])
def test_a_coefficient_of_variation_about_zero_is_none(mean, std, initial, lower, known):
    parameter = Parameter(name="a", unit="m", initial=initial, std=1.0, lower=lower)
    assert np.isfinite(cov_of(mean, std, parameter)) == known


def test_the_comparison_gives_the_standard_deviation_and_says_why(tmp_path):
    zero = Parameters((replace(LINEAR_PARAMETERS.items[0], initial=0.0, unit="m"), B, C))
    data = linear_data(LINEAR_HZ - SLOPE @ np.array([1.0, 0, 0]))
    record = verbs.update(linear_model(zero), data)
    drawn = verbs.sample(linear_model(zero), data, tmp_path / "p.nc", settings=SHORT)
    assert "a has no CoV, as its mean is within two standard deviations of zero" in compare(record, drawn).summary


@pytest.mark.parametrize("wrong", [2.5, True, "3", -1])
def test_iterations_are_a_whole_number(wrong):
    with pytest.raises(InputError, match="iterations"):
        UpdateSettings(iterations=wrong)


def test_a_frequency_of_zero_at_a_bound_is_no_warning():
    """Its frequency is zero, infinitely far from any measured one: that was a warning of numpy on the screen."""
    items = tuple(Parameter(name=n, unit="-", initial=1.0, std=0.8, lower=0.0) for n in "ab")
    full = linear_model()

    def function(theta):
        return np.concatenate([LINEAR_HZ[:2] * np.sqrt(theta), 100.0 * 1.5 ** np.arange(15)]), full.function(
            LINEAR_PARAMETERS.initial)[1]

    problem = build_problem(replace(full, parameters=Parameters(items), function=function),
                            linear_data([*LINEAR_HZ[:2], *[np.nan] * 3]), weights=Weights(shapes="none"))
    value, _ = problem.log_posterior(np.array([[0.0, 1.0], [1.0, 1.0]]))
    # of a hundred standard deviations
    assert value[0] - value[1] == pytest.approx(-5000.0, rel=1e-3)
