"""Updates of every set: their scatter under noise alone, missing modes, sets that give no update."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg
from updating_cases import (
    CHANNELS,
    LINEAR_HZ,
    LINEAR_PARAMETERS,
    SLOPE,
    chain_model,
    linear_data,
    linear_model,
    measured_chain,
    modal_set,
)

from probupdate.modal.modes import ModalData
from probupdate.updating.problem import Weights
from probupdate.updating.set_wise_updates import update_sets

N_SET = 150
STD = 0.01 * LINEAR_HZ
SINGLE = [(j,) for j in range(5)]
W, W_THETA = np.diag(1 / STD**2), np.linalg.inv(LINEAR_PARAMETERS.covariance)
P = np.linalg.inv(SLOPE.T @ W @ SLOPE + W_THETA)
TRUTH = np.array([1.3, 2.2, -1.1])
OPTIONS = {"weights": Weights(), "clusters": SINGLE, "iterations": 2}


def measured(n=N_SET, seed=1):
    noise = np.random.default_rng(seed).standard_normal((n, 5)) * STD
    return LINEAR_HZ + SLOPE @ (TRUTH - LINEAR_PARAMETERS.initial) + noise


@pytest.fixture(scope="module")
def scatter():
    return update_sets(linear_model(), linear_data(measured()), **OPTIONS)


def test_the_scatter_of_maxima_under_noise_alone_is_less_than_the_posterior(scatter, validation):
    row = validation(what="scatter of updates over sets", reference="P - P W_Theta P", unit="standard errors")
    expected = P - P @ W_THETA @ P
    assert expected == pytest.approx(P @ SLOPE.T @ W @ SLOPE @ P, rel=1e-9)
    found = np.cov(scatter.theta_map.T)
    root = linalg.cholesky(expected, lower=True)
    white = linalg.solve_triangular(root, linalg.solve_triangular(root, found, lower=True).T, lower=True)
    # entries of a sample covariance of whitened normals: 1 +- sqrt(2 / (n - 1)), 0 +- sqrt(1 / (n - 1))
    error = np.sqrt((1 + np.eye(3)) / (N_SET - 1))
    row.error((white - np.eye(3)) / error, below=4)
    # the posterior itself would be distinguished: the third parameter hardly scatters, and is hardly known
    assert found[2, 2] < 0.2 * P[2, 2] and P[2, 2] > 0.5 * 0.2**2


def test_each_sets_maximum_variance_and_resolution_are_the_closed_forms(scatter):
    expected = LINEAR_PARAMETERS.initial + (measured() - LINEAR_HZ) @ (P @ SLOPE.T @ W).T
    assert np.max(np.abs(scatter.theta_map - expected) / LINEAR_PARAMETERS.std) < 1e-6
    assert scatter.variance == pytest.approx(np.tile(np.diag(P), (N_SET, 1)), rel=1e-6)
    assert scatter.resolution == pytest.approx(np.tile(1 - np.diag(P @ W_THETA), (N_SET, 1)), rel=1e-5)
    assert scatter.cov == pytest.approx(np.std(expected, axis=0, ddof=1) / np.abs(expected.mean(axis=0)), rel=1e-5)
    total = np.sqrt(np.diag(P) + np.var(expected, axis=0, ddof=1))
    assert scatter.total_std == pytest.approx(total, rel=1e-5)
    assert len(scatter.ids) == N_SET and scatter.failed == ()


def test_the_printed_scheme_is_taken_after_the_given_number_of_iterations(scatter):
    half = P @ SLOPE.T @ W @ (measured() - LINEAR_HZ).T
    twice = LINEAR_PARAMETERS.initial + (half + P @ W_THETA @ half).T
    assert scatter.iterations == 2
    assert np.max(np.abs(scatter.theta_step - twice) / LINEAR_PARAMETERS.std) < 1e-6


def test_a_set_with_a_missing_mode_is_updated_without_it():
    frequencies = measured(3, seed=4)
    frequencies[1, 3] = np.nan
    found = update_sets(linear_model(), linear_data(frequencies), **OPTIONS)
    assert found.ids == ("set 0", "set 1", "set 2") and found.failed == ()
    rows = [0, 1, 2, 4]
    S, weight = SLOPE[rows], W[np.ix_(rows, rows)]
    covariance = np.linalg.inv(S.T @ weight @ S + W_THETA)
    expected = LINEAR_PARAMETERS.initial + covariance @ S.T @ weight @ (frequencies[1, rows] - LINEAR_HZ[rows])
    assert np.max(np.abs(found.theta_map[1] - expected) / LINEAR_PARAMETERS.std) < 1e-6
    assert found.variance[1] == pytest.approx(np.diag(covariance), rel=1e-6)
    assert np.all(found.variance[1] > found.variance[0])


def test_a_set_without_any_mode_is_named_with_its_reason():
    frequencies = measured(3, seed=4)
    frequencies[1] = np.nan
    found = update_sets(linear_model(), linear_data(frequencies), **OPTIONS)
    assert found.ids == ("set 0", "set 2") and found.theta_map.shape == (2, 3)
    (sentence,) = found.failed
    assert sentence.startswith("set set 1: ") and "none of its modes can be used" in sentence and "\n" not in sentence


def test_sets_that_measured_a_close_pair_in_either_order_give_one_maximum():
    one = measured_chain(noise=0.003, seed=5).sets[0]
    swap = [1, 0, 2, 3]
    other = modal_set(one.frequency_hz[swap], one.shape[:, swap], id="two")
    data = ModalData(channels=CHANNELS, sets=(one, other))
    found = update_sets(chain_model(), data, weights=Weights(), clusters=[(0, 1), (2, 3)], iterations=1)
    deviations = (found.theta_map[1] - found.theta_map[0]) / np.sqrt(found.variance[0])
    assert np.max(np.abs(deviations)) < 1e-4


def test_every_set_reports_progress_and_derived_quantities_have_one_value_each():
    model = replace(chain_model(), derived={"head": lambda theta: 1e6 * theta[0]})
    seen = []
    sets = tuple(
        modal_set(s.frequency_hz, s.shape, id=str(k))
        for k, s in enumerate(measured_chain(noise=0.003, seed=seed).sets[0] for seed in (1, 2))
    )
    found = update_sets(
        model, ModalData(channels=CHANNELS, sets=sets), weights=Weights(), clusters=[(0, 1), (2, 3)], iterations=1,
        progress=lambda what, done, total: seen.append((done, total)),
    )
    assert found.derived["head"] == pytest.approx(1e6 * found.theta_map[:, 0])
    assert seen == [(0, 2), (1, 2), (2, 2)]
