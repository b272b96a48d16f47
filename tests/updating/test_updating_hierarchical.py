"""Sets that differ: the integral over each set's parameters, the population of a linear problem by quadrature, hyper-
priors where the data are silent, leave-one-set-out scores, and the four views of a chain whose base varies."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, stats
from updating_cases import LINEAR_HZ, LINEAR_PARAMETERS, SLOPE, arviz_psislw, linear_data, linear_model

from probupdate.errors import InputError
from probupdate.modal.modes import CovarianceFactors, ModalData
from probupdate.model.parameters import Parameter, Parameters
from probupdate.reporting.sets_section import information_section, sets_section
from probupdate.reporting.values import Run
from probupdate.updating.discrepancy import LikelihoodSettings
from probupdate.updating.hierarchical import SPREAD, lkj_factor, sample_population, scatter_interval
from probupdate.updating.information import information
from probupdate.updating.predictive import population_left_out, population_score
from probupdate.updating.problem import build_problem
from probupdate.updating.set_likelihoods import SetLikelihoods, coordinates_of, linearise
from probupdate.updating.set_views import LAST_ESS, Common, gaussian_prior, joint_posterior, mode_scatter, view_sets
from probupdate.updating.set_views_file import IDENTIFIED_BITS, MANY, ONE, POOLED, parameter_sentence, read_views
from probupdate.updating.shared_error import shared_error
from probupdate.updating.weight_smoothing import smoothed_weights
from probupdate.verbs import sets
from studies.calibration.scatter import coverage

NOISE = 0.002
PLAIN = LikelihoodSettings(shapes="none", tolerances=False, discrepancy=0.0)
SINGLE = [(j,) for j in range(5)]
TRUTH, TAU = np.array([1.3, 2.2, -1.1]), np.array([0.2, 0.0, 0.05])
N_SET = 9


def measured(n=N_SET, seed=0, tau=TAU):
    rng = np.random.default_rng(seed)
    theta = TRUTH + tau * rng.standard_normal((n, 3))
    return LINEAR_HZ + (theta - LINEAR_PARAMETERS.initial) @ SLOPE.T + NOISE * LINEAR_HZ * rng.standard_normal((n, 5))


def likelihoods_of(frequencies, parameters=LINEAR_PARAMETERS, slope=SLOPE):
    model, data = linear_model(parameters, slope), linear_data(frequencies, cov=NOISE)
    problems = [build_problem(model, data, set_id=s.id, clusters=SINGLE) for s in data.sets]
    coordinates = coordinates_of(parameters)
    return linearise(problems, np.tile(parameters.initial, (len(problems), 1)), coordinates), coordinates, problems


def shapes_constant(problem):
    """What the shapes, which never change, add to ln p of a set's data."""
    frequencies = np.sum(np.log(NOISE * LINEAR_HZ)) + 2.5 * np.log(2 * np.pi)
    return float(problem.log_likelihood(TRUTH)[0] + 0.5 * problem.misfit(problem.predict(TRUTH)) + frequencies)


def test_the_integral_over_a_sets_parameters_is_the_density_of_its_data(validation):
    row = validation(what="ln p of a set, its parameters integrated out over a population",
                     reference="density of its data in closed form", why="derivatives by differences",
                     unit="in ln p")
    frequencies = measured()
    found, _, problems = likelihoods_of(frequencies)
    rng = np.random.default_rng(4)
    factor = np.tril(0.1 * rng.standard_normal((3, 3)))[None]
    value = found.marginal(TRUTH[None], factor)[0]
    covariance = np.diag((NOISE * LINEAR_HZ) ** 2) + SLOPE @ factor[0] @ factor[0].T @ SLOPE.T
    mean = LINEAR_HZ + SLOPE @ (TRUTH - LINEAR_PARAMETERS.initial)
    constant = np.array([shapes_constant(p) for p in problems])
    expected = stats.multivariate_normal(mean, covariance).logpdf(frequencies) + constant
    row.error(value - expected, below=1e-6)
    # no scatter at all: the likelihood itself
    alone = found.evaluate(TRUTH[None])[0]
    assert found.marginal(TRUTH[None], np.zeros((1, 3, 3)))[0] == pytest.approx(alone, abs=1e-9)


def test_draws_of_a_sets_own_parameters_are_its_conditional():
    found, _, _ = likelihoods_of(measured())
    factor = np.diag([0.2, 0.05, 0.1])
    n = 4000
    own = found.draw_own(np.tile(TRUTH, (n, 1)), np.tile(factor, (n, 1, 1)), np.random.default_rng(1))[:, 2]
    precision = found.precision[2] + np.linalg.inv(factor @ factor.T)
    slope = found.gradient[2] + found.precision[2] @ (found.centre[2] - TRUTH)
    expected = TRUTH + np.linalg.solve(precision, slope)
    covariance = np.linalg.inv(precision)
    error = np.sqrt(np.diag(covariance) / n)
    assert np.all(np.abs(own.mean(axis=0) - expected) < 4 * error)
    assert np.cov(own.T) == pytest.approx(covariance, abs=4 * np.max(np.diag(covariance)) * np.sqrt(2 / n))


def test_the_population_of_one_parameter_is_that_of_quadrature(validation):
    row = validation(what="population of one parameter, nine sets: mean and standard deviation of tau",
                     reference="quadrature over tau", unit="standard errors")
    parameters = Parameters((Parameter(name="a", unit="-", initial=1.0, std=0.5),))
    slope = np.array([[0.05], [0.10], [0.02], [0.30], [-0.20]])
    rng = np.random.default_rng(3)
    theta = 1.2 + 0.06 * rng.standard_normal((N_SET, 1))
    frequencies = LINEAR_HZ + (theta - 1.0) @ slope.T + NOISE * LINEAR_HZ * rng.standard_normal((N_SET, 5))
    model = linear_one(parameters, slope)
    data = linear_data(frequencies, cov=NOISE)
    problems = [build_problem(model, data, set_id=s.id, clusters=SINGLE) for s in data.sets]
    coordinates = coordinates_of(parameters)
    found = linearise(problems, np.ones((N_SET, 1)), coordinates)
    population = sample_population(found, parameters, coordinates, seed=2, target_ess=600)
    assert population.converged, population.verdict
    # by the sets' own estimates: y_j ~ N(mu, tau^2 + s^2), mu integrated in closed form, tau on a grid
    weight = slope[:, 0] / (NOISE * LINEAR_HZ) ** 2
    s2 = 1 / np.sum(weight * slope[:, 0])
    y = 1.0 + (frequencies - LINEAR_HZ) @ weight * s2

    def density(tau):
        v = tau**2 + s2
        marginal = stats.multivariate_normal(np.ones(N_SET), v * np.eye(N_SET) + 0.25).pdf(y)
        return marginal * stats.halfnorm(scale=SPREAD * 0.5).pdf(tau)

    grid = np.linspace(0, 0.6, 4001)
    p = np.array([density(t) for t in grid])
    p /= integrate.simpson(p, x=grid)
    mean = integrate.simpson(grid * p, x=grid)
    std = np.sqrt(integrate.simpson((grid - mean) ** 2 * p, x=grid))
    row.error((population.tau.mean() - mean) / std * np.sqrt(population.ess), below=4, of="mean")
    row.error((population.tau.std() / std - 1) * np.sqrt(population.ess), below=4, of="standard deviation")


@pytest.mark.parametrize("middle", [0.9, 1.3])
def test_a_population_at_its_bound_is_that_of_quadrature(middle):
    """Far beyond the bound no independent draw of the mean lies within, and a chain walks."""
    parameters = Parameters((Parameter(name="a", unit="-", initial=1.0, std=0.5, lower=1.0),))
    own = np.log(middle) + 0.02 * np.random.default_rng(4).standard_normal((N_SET, 1))
    sets = SetLikelihoods(ids=tuple("abcdefghi"), centre=own, value=np.zeros(N_SET), gradient=np.zeros((N_SET, 1)),
                          precision=np.full((N_SET, 1, 1), 0.02**-2))
    found = sample_population(sets, parameters, coordinates_of(parameters), seed=2)
    assert found.converged and ("steps" in found.verdict) == (middle < 1)
    u, tau = np.linspace(0, 0.6, 1201), np.linspace(1e-4, 0.6, 1200)
    value = stats.norm.logpdf(np.exp(u), 1, 0.5) + u
    value = value + stats.norm.logpdf(tau, 0, 0.5 * SPREAD)[:, None]
    value = value + np.sum(stats.norm.logpdf(own, u, np.hypot(tau, 0.02)[:, None, None]), axis=1)
    weight = np.exp(value - value.max())
    for drawn, number, share in ((found.mean[:, 0], u, weight.sum(axis=0)), (found.tau[:, 0], tau, weight.sum(axis=1))):
        share = share / share.sum()
        mean = share @ number
        std = np.sqrt(share @ (number - mean) ** 2)
        assert abs(drawn.mean() - mean) < 4 * std / np.sqrt(found.ess)
        assert drawn.std() == pytest.approx(std, rel=4 / np.sqrt(found.ess) + 0.02)


def linear_one(parameters, slope):
    """The linear model with one parameter about 1."""
    from probupdate.structure.functions import FunctionModel

    full = linear_model()
    shape = full.solve(full.parameters.initial, 17).shape

    def function(theta):
        return np.concatenate([LINEAR_HZ + slope @ (theta - 1.0), 100.0 * 1.5 ** np.arange(12)]), shape

    return FunctionModel(name="one", parameters=parameters, channels=full.channels, function=function, version="1")


@pytest.fixture(scope="module")
def population():
    slope = SLOPE.copy()
    slope[:, 2] = 0.0
    frequencies = LINEAR_HZ + (measured() - LINEAR_HZ)
    found, coordinates, _ = likelihoods_of(frequencies, slope=slope)
    return found, coordinates, sample_population(found, LINEAR_PARAMETERS, coordinates, seed=1)


def test_scatter_is_found_where_it_is_and_not_where_it_is_not(population):
    _, _, drawn = population
    assert drawn.converged, drawn.verdict
    low, high = np.quantile(drawn.tau, [0.05, 0.95], axis=0)
    assert low[0] < TAU[0] < high[0] and low[0] > 0.1 * TAU[0]
    # nothing varies b: its scatter is at most that of its estimates' noise
    assert high[1] < 0.4 * LINEAR_PARAMETERS.std[1]


def test_a_parameter_without_data_returns_its_hyper_prior(population, validation):
    row = validation(what="population: a parameter without data", reference="its hyper-prior", unit="standard errors")
    _, _, drawn = population
    prior = stats.halfnorm(scale=SPREAD * 0.2)
    row.error((drawn.tau[:, 2].mean() - prior.mean()) / prior.std() * np.sqrt(drawn.ess), below=4)
    row.error((drawn.mean[:, 2].mean() + 1.0) / 0.2 * np.sqrt(drawn.ess), below=4)
    row.error((drawn.mean[:, 2].std() / 0.2 - 1) * np.sqrt(drawn.ess), below=4)


def test_leaving_a_set_out_by_weights_and_by_sampling_without_it_agree(population, validation):
    row = validation(what="ln p of a set left out, by smoothed weights", reference="sampling without it",
                     why="both sums are known to some hundredths", unit="nat")
    found, coordinates, drawn = population
    by_weights, k = population_left_out(drawn, 4)
    again = sample_population(found.leave_out(4), LINEAR_PARAMETERS, coordinates, seed=5)
    # both sums are known to some hundredths of a nat at these effective sizes
    assert k < 0.7
    row.error(by_weights - population_score(again, found, 4), below=0.15)


def test_one_posterior_of_all_sets_is_the_closed_form(validation):
    row = validation(what="one posterior of nine sets: mean in standard errors, variance, evidence in nat",
                     reference="closed form", why="8000 draws")
    frequencies = measured()
    _, coordinates, problems = likelihoods_of(frequencies)
    error = shared_error(problems, np.tile(LINEAR_PARAMETERS.initial, (N_SET, 1)), coordinates)
    normal = gaussian_prior(LINEAR_PARAMETERS, coordinates)
    joint = joint_posterior(Common.from_error(error, normal).all_sets_density(), LINEAR_PARAMETERS, coordinates, normal,
                            np.random.default_rng(2))
    W, prior = np.diag(1 / (NOISE * LINEAR_HZ) ** 2), np.linalg.inv(LINEAR_PARAMETERS.covariance)
    P = np.linalg.inv(N_SET * SLOPE.T @ W @ SLOPE + prior)
    mean = LINEAR_PARAMETERS.initial + P @ SLOPE.T @ W @ (frequencies - LINEAR_HZ).sum(axis=0)
    row.error((joint.mean() - mean) / np.sqrt(np.diag(P) / 8000), below=5, of="mean")
    row.error(joint.variance() / np.diag(P) - 1, below=0.08, of="variance")
    covariance = np.kron(np.eye(N_SET), np.linalg.inv(W))
    covariance = covariance + np.kron(np.ones((N_SET, N_SET)), SLOPE @ LINEAR_PARAMETERS.covariance @ SLOPE.T)
    constant = sum(shapes_constant(p) for p in problems)
    expected = stats.multivariate_normal(np.tile(LINEAR_HZ, N_SET), covariance).logpdf(frequencies.ravel()) + constant
    row.error(joint.log_evidence - expected, below=0.05, of="evidence")
    assert joint.pareto_k < 0.5


def test_correlation_matrices_follow_lkj():
    rng = np.random.default_rng(6)
    n, m = 4, 20_000
    factor = lkj_factor(rng.standard_normal((m, n * (n - 1) // 2)), n)
    correlation = factor @ np.swapaxes(factor, 1, 2)
    assert np.allclose(np.diagonal(correlation, axis1=1, axis2=2), 1)
    # every entry is beta(eta + n / 2 - 1) on -1 to 1: variance 1 / (2 a + 1)
    expected = 1 / (2 * (2.0 + n / 2 - 1) + 1)
    rows, columns = np.tril_indices(n, -1)
    found = correlation[:, rows, columns].var(axis=0)
    assert found == pytest.approx(np.full(rows.size, expected), rel=4 * np.sqrt(2 / m))


def test_smoothed_weights_are_arvizs():
    log_ratio = 1.3 * np.random.default_rng(8).standard_normal(4000)
    weight, k = smoothed_weights(log_ratio)
    peer, peer_k = arviz_psislw()(log_ratio)
    assert k == pytest.approx(float(peer_k), abs=0.02)
    assert np.exp(weight) == pytest.approx(np.exp(np.asarray(peer)), abs=2e-4)


@pytest.fixture(scope="module")
def views(tmp_path_factory):
    data = linear_data(measured(6), cov=NOISE)
    return view_sets(linear_model(), data, seed=3)


def test_the_four_views_of_a_varying_parameter(views, tmp_path):
    a, _, c = views.rows
    # scatter of updates is near the truth where the data decide, and is shown with its resolution
    assert a.resolution > 0.9 and c.resolution < 0.95
    # pooled is never less than the scatter, one posterior is narrower than any
    assert a.pooled_cov >= 0.99 * a.scatter_cov and a.joint_cov < 0.5 * a.pooled_cov
    assert a.tau_low < 0.2 < a.tau_high and a.tau_bits > IDENTIFIED_BITS
    assert a.population_cov * a.mean > a.tau and "varies between sets by a standard deviation of" in a.sentence
    assert "tau is a CoV, but of a, b, c a standard deviation in the parameter's unit" in views.summary
    total = {name: score.sum() for name, score in views.scores.score.items()}
    assert total[MANY] > total[ONE] + 10 and set(total) == {MANY, ONE, POOLED}
    assert re.search(r"a, c vary between sets \(sets left out|a varies between sets \(sets left out", views.advice)
    assert np.all(views.linear_share > 0.999)
    assert read_views(views.write(tmp_path / "sets.json")).summary == views.summary


def test_a_number_that_sets_have_in_common_is_one_of_them_all(validation):
    """One spring in three states, and one that varies: by dense Gaussians on a grid over tau."""
    row = validation(what="population with a common parameter: means and standard deviations",
                     reference="dense Gaussians on a grid over tau", unit="standard errors")
    parameters = Parameters(LINEAR_PARAMETERS.items[:2])
    full, slope, n = linear_model(), SLOPE[:, :2], 3

    def function(theta):
        return full.function(np.append(theta, -1.0))

    rng = np.random.default_rng(7)
    theta = np.column_stack([np.full(n, 1.3), 2.1 + 0.08 * rng.standard_normal(n)])
    hz = LINEAR_HZ + (theta - [1, 2]) @ slope.T + NOISE * LINEAR_HZ * rng.standard_normal((n, 5))
    found = view_sets(replace(full, parameters=parameters, function=function), linear_data(hz, cov=NOISE),
                      common=("a",), correlated=True, seed=3)
    assert found.converged and found.rows[0].sentence == "a is one number in all sets, as stated"
    assert np.isnan(found.rows[0].tau) and found.rows[1].tau > 0 and np.all(np.isfinite(found.correlation))
    A, noise, prior = np.tile(slope, (n, 1)), np.diag((NOISE * LINEAR_HZ) ** 2), np.diag(parameters.std**-2)
    y, weight, mean, variance = (hz - LINEAR_HZ).ravel(), [], [], []
    grid = np.linspace(1e-4, 0.4, 400)
    for tau in grid:
        own = np.kron(np.eye(n), noise + tau**2 * np.outer(slope[:, 1], slope[:, 1]))
        whole = stats.multivariate_normal(cov=own + A @ parameters.covariance @ A.T)
        weight.append(whole.logpdf(y) - 0.5 * (tau / (SPREAD * 0.3)) ** 2)
        inner = np.linalg.inv(own)
        P = np.linalg.inv(A.T @ inner @ A + prior)
        mean.append(P @ A.T @ inner @ y + [1, 2])
        variance.append(np.diag(P))
    weight = np.exp(np.array(weight) - max(weight))
    weight /= weight.sum()
    centre = weight @ mean
    std = np.sqrt(weight @ np.array(variance) + weight @ (np.array(mean) - centre) ** 2)
    own = [(r.mean, r.mean_cov * abs(r.mean)) for r in found.rows]
    row.error(([x for x, _ in own] - centre) / std * np.sqrt(LAST_ESS), below=4, of="means")
    row.error(([x for _, x in own] / std - 1) * np.sqrt(LAST_ESS), below=4, of="standard deviations")


@pytest.mark.parametrize(("options", "words"), [
    ({"common": ("z",)}, "parameter z: not among the updated ones; choose from a, b, c"),
    ({"common": ("a", "b", "c")}, "common: leaves no parameter that varies"), ({"common": "a"}, "common: 'a' is not a"),
    ({"spread": 0.0}, "spread: 0.0 is not above zero"), ({"spread": np.nan}, "spread: nan is not a finite number"),
    ({"spread": "1"}, "spread: '1' is not a finite number"), ({"seed": 1.5}, "seed: 1.5 is not a whole number"),
    ({"seed": -1}, "seed: -1 is below 0"), ({"correlated": "yes"}, "correlated: 'yes' is not True or False"),
])
def test_wrong_options_of_sets_are_refused(options, words):
    with pytest.raises(InputError, match=re.escape(words)):
        sets(linear_model(), linear_data(measured(2), cov=NOISE), likelihood=PLAIN, **options)


def test_tau_of_a_change_about_zero_is_no_share_of_its_mean():
    """As a CoV it had been 8.4 for a stiffness that lies within -0.95 and 1."""
    zero = Parameters(tuple(Parameter(name=p.name, unit="m", initial=0.0, std=p.std) for p in LINEAR_PARAMETERS))
    theta = TAU * np.random.default_rng(2).standard_normal((N_SET, 3))
    frequencies = LINEAR_HZ + (theta - LINEAR_PARAMETERS.initial) @ SLOPE.T
    found = view_sets(linear_model(zero, SLOPE), linear_data(frequencies, cov=NOISE), seed=3).rows[0]
    assert abs(found.mean) < 0.2 and found.tau_low < 0.2 < found.tau_high < 0.6 and not found.tau_relative
    assert re.search(r"a varies between sets by a standard deviation of 0\.\d+ m \(0\.\d+ m to", found.sentence)


@pytest.mark.parametrize(("low", "bits", "relative", "words"), [
    (0.04, 9.0, True, "k varies between sets by a CoV of 0.06 (0.04 to 0.09)"),
    (0.0, 9.0, False, "by a standard deviation of at most 0.09 m (95 %), perhaps not at all"),
    (0.0, 0.0, False, "tau, its standard deviation between sets, is below 0.09 m (95 %)"),
])
def test_a_sentence_says_what_tau_is(low, bits, relative, words):
    row = {"name": "k", "unit": "m", "tau": 0.06, "tau_low": low, "tau_high": 0.09, "tau_prior": 0.1, "tau_bits": bits,
           "tau_relative": relative, "resolution": 0.5}
    assert words in parameter_sentence(row)


@pytest.mark.parametrize("ratio", [0.0, 1.0])
def test_intervals_of_a_scatter_hold_it_and_none_at_all(validation, ratio):
    row = validation(what="scatter of nine sets, none and as large as their noise: share of 60 campaigns whose 90 % "
                          "interval holds it", reference="0.9", why="binomial, p 0.01")
    row.least(coverage(range(60), 9, ratio), above=0.8)
    draws = np.abs(np.random.default_rng(1).standard_normal(1000))
    assert scatter_interval(draws)[0] == 0.0 and scatter_interval(3 + draws)[0] > 3
    assert scatter_interval(np.sqrt(4 + draws))[0] > 2


def test_the_same_seed_gives_the_same_numbers():
    found, coordinates, _ = likelihoods_of(measured(3))
    one, two, other = (sample_population(found, LINEAR_PARAMETERS, coordinates, seed=seed, target_ess=1)
                       for seed in (3, 3, 4))
    assert np.array_equal(one.tau, two.tau) and np.array_equal(one.mean, two.mean)
    assert not np.array_equal(one.tau[0], other.tau[0])


def with_deviations(data, cov):
    n = data.n_mode
    sets = tuple(type(s)(**{k: getattr(s, k) for k in ("id", "frequency_hz", "shape", "damping_ratio",
                                                       "frequency_std_hz", "shape_std")},
                         covariance_factors=CovarianceFactors(ln_frequency=np.full((n, 1), cov),
                                                              damping_ratio=np.ones((n, 1)),
                                                              shape=np.zeros((*s.shape.shape, 1)))) for s in data.sets)
    return ModalData(channels=data.channels, sets=sets)


def test_noise_and_variation_of_a_frequency_are_told_apart_with_the_stated_coverage(validation):
    row = validation(what="variation of frequencies beyond stated noise, 150 campaigns: coverage of 90 % intervals",
                     reference="0.925, as zero lies at an end of half of them", unit="standard errors")
    rng = np.random.default_rng(9)
    noise, variation, inside, rejected = 0.003, 0.006, 0, 0
    n = 150
    for k in range(n):
        real = variation if k % 2 else 0.0
        f = LINEAR_HZ * np.exp(np.hypot(noise, real) * rng.standard_normal((N_SET, 5)))
        first = mode_scatter(with_deviations(linear_data(f), noise))[0]
        inside += first.low <= real <= first.high
        rejected += first.p_value < 0.05 and not k % 2
    # of 90 % intervals, those of zero variation reach down to it in 95 %
    row.error((inside / n - 0.925) / np.sqrt(0.925 * 0.075 / n), below=4)
    assert rejected <= stats.binom(n // 2, 0.05).ppf(0.9999)


def test_the_report_shows_the_views_where_they_are_and_nothing_where_not(views, tmp_path):
    run = Run(folder=tmp_path, title="t", missing=(), provenance=())
    assert sets_section(run) is None and information_section(run) is None
    views.write(tmp_path / "sets.json")
    information(build_problem(linear_model(), linear_data(LINEAR_HZ))).write(tmp_path / "information.json")
    tables = [item for item in sets_section(run).items if item.kind == "table"]
    assert [row[0] for row in tables[0].rows] == ["a", "b", "c"] and len(tables[1].rows) == 7
    assert information_section(run).items[0].rows[0][0] == "a"


def test_one_set_is_refused():
    with pytest.raises(InputError, match="give two sets or more"):
        view_sets(linear_model(), linear_data(measured(1), cov=NOISE))


def test_a_file_that_is_none_is_refused(tmp_path):
    path = tmp_path / "sets.json"
    path.write_text("{}")
    with pytest.raises(InputError, match=r"is not sets\.json"):
        read_views(path)
