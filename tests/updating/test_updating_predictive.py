"""Predictive checks: uniform p-values where the model holds, small ones where it does not; bits of known posteriors."""

import numpy as np
import pytest
from scipy import stats
from updating_cases import CHAIN_PARAMETERS, LINEAR_HZ, LINEAR_PARAMETERS, SLOPE, chain_model, linear_data, linear_model
from updating_cases import measured_chain as chain_data

from probupdate.updating.laplace import maximum_a_posteriori
from probupdate.updating.predictive import bits_gained, predictive_check
from probupdate.updating.problem import Weights, build_problem

COV = 0.01
N_DATA = 80
FREQUENCIES = Weights(shapes="none")


def check(frequency, **options):
    problem = build_problem(linear_model(), linear_data(frequency, cov=COV), weights=FREQUENCIES)
    return predictive_check(problem, maximum_a_posteriori(problem, [problem.parameters.initial]), **options)


@pytest.fixture(scope="module")
def many():
    rng = np.random.default_rng(1)
    theta = LINEAR_PARAMETERS.draw(rng, N_DATA) - LINEAR_PARAMETERS.initial
    noise = COV * LINEAR_HZ * rng.standard_normal((N_DATA, 5))
    return [check(LINEAR_HZ + row, seed=k) for k, row in enumerate(theta @ SLOPE.T + noise)]


@pytest.mark.parametrize("name", ["total_p", "misfit_p", "penalty_p"])
def test_p_values_are_uniform_where_the_model_holds(many, name, validation):
    row = validation(what="p-values of misfit, penalty and both, 80 data sets: Kolmogorov-Smirnov's p",
                     reference="uniform")
    row.least(stats.kstest([getattr(c, name) for c in many], "uniform").pvalue, above=1e-3)


def test_a_chi_square_of_the_number_of_parameters_would_not_be(many):
    assert stats.kstest([c.naive_penalty_p for c in many], "uniform").pvalue < 1e-6


def test_each_frequency_s_distance_is_standard_normal(many):
    for name in ("prior_z", "posterior_z"):
        z = np.array([[getattr(r, name) for r in c.responses] for c in many])
        assert np.all(np.abs(z.var(axis=0) - 1) < 4 * np.sqrt(2 / len(many)))
        assert np.all(np.abs(z.mean(axis=0)) < 4 / np.sqrt(len(many)))


def test_the_total_is_the_density_of_the_data(many):
    frequency = LINEAR_HZ * np.array([1.01, 1.03, 0.98, 1.02, 1.0])
    covariance = np.diag((COV * LINEAR_HZ) ** 2) + SLOPE @ LINEAR_PARAMETERS.covariance @ SLOPE.T
    off = frequency - LINEAR_HZ
    found = check(frequency)
    assert found.total == pytest.approx(off @ np.linalg.solve(covariance, off), rel=1e-6)
    assert found.total_p == pytest.approx(stats.chi2.sf(found.total, 5), rel=1e-9)
    assert found.misfit_expected + found.penalty_expected == pytest.approx(5)
    assert found.nonlinear < 1e-5


def test_a_model_that_cannot_fit_and_a_truth_beyond_the_prior_are_told_apart():
    # across all the parameters' effects; then five prior standard deviations along the first
    across = np.linalg.svd(SLOPE / LINEAR_HZ[:, None])[0][:, -1]
    misfit = check(LINEAR_HZ * (1 + 0.08 * across))
    assert misfit.misfit_p < 1e-3 and misfit.penalty_p > 0.05
    assert "no parameters within the prior" in misfit.sentences[1]
    beyond = check(LINEAR_HZ + SLOPE @ np.array([2.5, 0.0, 0.0]))
    assert beyond.penalty_p < 1e-3 and beyond.misfit_p > 0.05
    assert "did not expect them" in beyond.sentences[2]


def test_on_a_chain_with_close_pairs_and_shapes_it_stays_calibrated(validation):
    row = validation(what="the misfit's p-values of a chain with pairs, 24 data sets: Kolmogorov-Smirnov's p",
                     reference="uniform")
    rng = np.random.default_rng(5)
    model, p = chain_model(), []
    for k in range(24):
        theta = CHAIN_PARAMETERS.initial + 0.4 * CHAIN_PARAMETERS.std * rng.standard_normal(4)
        problem = build_problem(model, chain_data(theta, noise=0.01, seed=k))
        found = predictive_check(problem, maximum_a_posteriori(problem, [theta]))
        p.append(found.misfit_p)
    row.least(stats.kstest(p, "uniform").pvalue, above=1e-3)


@pytest.mark.parametrize("width, shift", [(1.0, 0.0), (0.5, 0.3), (0.02, 1.0), (0.8, -1.5)])
def test_bits_are_those_of_two_gaussians(width, shift, validation):
    row = validation(what="bits gained, from draws: error over the bits and a third",
                     reference="two Gaussians in closed form", why="sixty bins")
    n = 20_000
    draws = shift + width * np.random.default_rng(7).standard_normal(n)
    exact = (0.5 * (width**2 + shift**2 - 1) - np.log(width)) / np.log(2)
    # sixty bins: how the density bends within one is not seen
    row.error((bits_gained(stats.norm.cdf(draws), n) - exact) / (exact + 1 / 3), below=0.03)


def test_no_bits_where_draws_are_the_prior_s():
    values = [bits_gained(np.random.default_rng(k).uniform(size=500), 500) for k in range(40)]
    assert np.mean(values) < 0.03 and max(values) < 0.1
