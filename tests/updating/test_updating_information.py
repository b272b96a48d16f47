"""Which parameters: Fisher information and widths against closed forms, bits, directions, pairs, roles, the file."""

from dataclasses import replace

import numpy as np
import pytest
from updating_cases import LINEAR_HZ, LINEAR_PARAMETERS, SLOPE, chain_problem, linear_data, linear_model
from updating_records import gaussian_draws, posterior_of, record

from probupdate.errors import InputError
from probupdate.model.parameters import Parameter, Parameters
from probupdate.updating.information import CARRY, LEAVE, UPDATE, information, read_information
from probupdate.updating.problem import Weights, build_problem

COV = 0.01
W = np.diag(1 / (COV * LINEAR_HZ) ** 2)


def linear(parameters=LINEAR_PARAMETERS, slope=SLOPE):
    return build_problem(linear_model(parameters, slope), linear_data(LINEAR_HZ, cov=COV),
                         weights=Weights(shapes="none"))


def test_fisher_information_widths_and_bits_are_the_closed_forms(validation):
    row = validation(what="Fisher information, widths, bits", reference="closed forms",
                     why="derivatives by differences")
    found = information(linear())
    std = LINEAR_PARAMETERS.std
    fisher = SLOPE.T @ W @ SLOPE * np.outer(std, std)
    row.error((found.fisher - fisher) / np.maximum(np.abs(fisher), 0.01), below=1e-6)
    covariance = np.linalg.inv(np.eye(3) + fisher)
    row.error([r.contraction for r in found.rows] / np.sqrt(np.diag(covariance)) - 1, below=1e-6)
    assert [r.bits for r in found.rows] == pytest.approx(-0.5 * np.log2(np.diag(covariance)), rel=1e-5, abs=1e-8)
    assert [r.signal for r in found.rows] == pytest.approx(np.sqrt(np.diag(fisher)), rel=1e-6)
    row.error(found.total_bits / (-0.5 * np.log2(np.linalg.det(covariance))) - 1, below=1e-6)
    # independent directions add up to the whole
    gain = np.linalg.eigvalsh(fisher)
    assert [d.gain for d in found.directions] == pytest.approx(sorted(gain[gain > 0.1])[::-1], rel=1e-6)
    relative = np.abs(SLOPE * LINEAR_PARAMETERS.initial / LINEAR_HZ[:, None]).max(axis=0)
    assert [r.slope for r in found.rows] == pytest.approx(relative, rel=1e-6)


def test_a_correlated_prior_counts_too():
    correlation = np.array([[1, 0.8, 0], [0.8, 1, 0], [0, 0, 1]])
    parameters = replace(LINEAR_PARAMETERS, correlation=correlation)
    found = information(linear(parameters))
    P = np.linalg.inv(SLOPE.T @ W @ SLOPE + np.linalg.inv(parameters.covariance))
    assert [r.contraction for r in found.rows] == pytest.approx(np.sqrt(np.diag(P)) / parameters.std, rel=1e-6)


def test_roles_and_what_fixing_the_silent_ones_costs():
    items = [Parameter(name=n, unit="-", initial=1.0, std=s) for n, s in zip("abc", (0.5, 0.08, 0.001), strict=True)]
    found = information(linear(Parameters(tuple(items)), np.abs(SLOPE)))
    assert [r.role for r in found.rows] == [UPDATE, CARRY, LEAVE]
    assert found.names_with(LEAVE) == ("c",) and 0 <= found.cost < 0.001
    assert [r.uncertainty for r in found.rows] == [2, 1, 0]
    assert "leave at their values: c" in found.summary and "recommended: update a" in found.summary


def test_two_parameters_that_do_the_same_are_named_with_the_modes():
    slope = SLOPE.copy()
    slope[:, 1] = 0.9 * slope[:, 0]
    slope[4, 1] *= 0.8
    pair = information(linear(slope=slope)).pairs[0]
    assert {pair.first, pair.second} == {"a", "b"} and pair.correlation < -0.5 and pair.cosine > 0.98
    assert "have the same effect" in pair.sentence
    # one that has no other like it is in no pair
    assert all("c" not in (p.first, p.second) for p in information(linear(slope=slope)).pairs)


def test_a_parameter_at_zero_has_no_cov_and_says_so():
    items = (*LINEAR_PARAMETERS.items[:2], Parameter(name="depth", unit="m", initial=0.0, std=2.0, lower=0.0))
    found = information(linear(Parameters(items)), theta=np.array([1.0, 2.0, 0.0]))
    row = found.rows[2]
    assert np.isnan(row.cov) and row.uncertainty == -1 and "depth" in found.settings["sensitivity metric"]
    # the model's frequencies are LINEAR_HZ at -1
    assert row.slope == pytest.approx(np.max(np.abs(SLOPE[:, 2]) * 2.0 / (LINEAR_HZ + SLOPE[:, 2])), rel=1e-5)


def test_a_close_pair_is_one_group_and_the_file_is_read_back(tmp_path):
    found = information(chain_problem())
    assert all("+" in label for pair in found.pairs for label in pair.by_modes)
    assert found.names_with(UPDATE)
    assert read_information(found.write(tmp_path / "information.json")).summary == found.summary


def test_draws_of_the_posterior_give_the_same_widths_and_bits():
    update = record(n_set=1)
    draws = gaussian_draws(update)
    posterior = posterior_of(update, draws, ess=np.full(3, 20_000.0))
    model = linear_model(update.parameters, np.array(SLOPE))
    problem = build_problem(model, linear_data(LINEAR_HZ, cov=COV), weights=Weights(shapes="none"))
    rows = information(problem, posterior=posterior).rows
    prior = np.array([p.distribution.std() for p in update.parameters])
    assert [r.sampled_contraction for r in rows] == pytest.approx(draws.std(axis=0) / prior, rel=0.02)
    assert rows[0].sampled_bits > 1 and rows[2].sampled_bits < 0.05


def test_files_and_points_that_do_not_fit_are_refused(tmp_path):
    with pytest.raises(InputError, match="2 values for 3 parameters"):
        information(linear(), theta=np.zeros(2))
    path = tmp_path / "information.json"
    path.write_text("[]")
    with pytest.raises(InputError, match=r"is not (information\.json|a JSON table)"):
        read_information(path)
