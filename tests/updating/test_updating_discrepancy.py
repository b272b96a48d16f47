"""What a model misses beyond the stated deviations: found where it was put in, zero where there is none."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from updating_cases import (
    CHAIN_TRUTH,
    LINEAR_HZ,
    LINEAR_PARAMETERS,
    SLOPE,
    chain_model,
    linear_data,
    linear_model,
    measured_chain,
)

from probupdate import verbs
from probupdate.cli import main
from probupdate.errors import InputError
from probupdate.modal.modes import ModalData
from probupdate.updating.discrepancy import LikelihoodSettings, estimate_discrepancy, expected_misfit
from probupdate.updating.laplace import maximum_a_posteriori
from probupdate.updating.problem import Weights, build_problem
from probupdate.updating.responses import SHAPE_FACTOR
from probupdate.updating.settings import SamplerSettings

STATED, MISSED = 1e-3, 6e-3


def disturbed(seed: int, share: float) -> ModalData:
    """Four modes of the chain off by `share` of frequencies and tenfold of shapes; standard deviations of STATED are
    stated."""
    rng = np.random.default_rng(seed)
    data = measured_chain()
    one = data.sets[0]
    largest = np.abs(one.shape).max(axis=0)
    shape = one.shape + SHAPE_FACTOR * share * largest * rng.standard_normal(one.shape.shape)
    frequency = one.frequency_hz * (1 + share * rng.standard_normal(one.frequency_hz.size))
    return replace(data, sets=(replace(one, frequency_hz=frequency, shape=shape,
                                       frequency_std_hz=STATED * one.frequency_hz),))


WEIGHTS = Weights(frequency_cov=(STATED,) * 4, shape_std=False)


def test_what_the_model_misses_is_found(validation):
    row = validation(what="model discrepancy put into four sets of a chain: its variance", reference="what was put in",
                     unit="standard deviations of chi-squares")
    model, data_sets = chain_model(), [disturbed(seed, MISSED) for seed in range(4)]
    found = [estimate_discrepancy(model, data, weights=WEIGHTS) for data in data_sets]
    problems = [build_problem(model, data, weights=w) for data, w in zip(data_sets, found, strict=True)]
    problem, expected = problems[0], MISSED**2 - STATED**2
    # of frequencies with what mixing of modes does to them: means of chi-squares over four sets
    frequency = [np.mean((p.frequency_std_hz / p.measured[: p.n_frequency]) ** 2) - STATED**2 for p in problems]
    row.error((np.mean(frequency) / expected - 1) / np.sqrt(2 / (4 * 4)), below=4, of="frequencies")
    shape = [(w.shape_discrepancy / SHAPE_FACTOR) ** 2 for w in found]
    row.error((np.mean(shape) / expected - 1) / np.sqrt(2 / (4 * (problem.n_effective - 4))), below=4, of="shapes")
    top = maximum_a_posteriori(problem, [CHAIN_TRUTH])
    # about what is expected, within what a chi-square of that many scatters by
    assert abs(top.misfit - expected_misfit(problem, top)) < 3 * np.sqrt(2 * expected_misfit(problem, top))
    assert "learnt" in problem.weights.description and "%" in problem.weights.description
    # the sure posterior of the stated standard deviations alone becomes as wide as what is missed says
    plain = maximum_a_posteriori(build_problem(model, data_sets[0], weights=WEIGHTS), [CHAIN_TRUTH])
    assert top.covariance[0, 0] > 4 * plain.covariance[0, 0]


def test_little_is_left_where_the_stated_deviations_suffice():
    found = estimate_discrepancy(chain_model(), disturbed(3, 0.5 * STATED), weights=WEIGHTS)
    # a fifth of what the hyper-priors hold for usual
    assert found.discrepancy < 2 * STATED and found.shape_discrepancy < SHAPE_FACTOR * STATED
    assert found.mixing < 4 * STATED


def test_shapes_that_fit_do_not_hide_frequencies_that_do_not():
    """Frequencies 1 % off in three of four, shapes exact: each kind learns its own."""
    data = measured_chain()
    off = data.sets[0].frequency_hz * [1.01, 0.985, 1.012, 0.99]
    data = replace(data, sets=(replace(data.sets[0], frequency_hz=off, frequency_std_hz=STATED * off),))
    found = estimate_discrepancy(chain_model(), data, weights=WEIGHTS)
    problem = build_problem(chain_model(), data, weights=found)
    missed = np.sqrt((problem.frequency_std_hz / off) ** 2 - STATED**2)
    assert np.all((missed > 0.002) & (missed < 0.03)) and found.shape_discrepancy < SHAPE_FACTOR * STATED


def test_the_average_over_scales_is_the_integral_over_them(validation):
    """Linear model, frequencies alone: ln p of the data against quadrature over the scale with the dense Gaussian."""
    row = validation(what="likelihood averaged over what the model misses", reference="quadrature over its scale",
                     why="nodes of half a decade", unit="nat")
    y = LINEAR_HZ * (1 + 0.008 * np.random.default_rng(4).standard_normal(5))
    model, data = linear_model(), linear_data(y, cov=STATED)
    weights = estimate_discrepancy(model, data, weights=Weights(shapes="none"))
    problem = build_problem(model, data, weights=weights)
    theta = LINEAR_PARAMETERS.initial + np.array([[0.0, 0.0, 0.0], [0.1, -0.05, 0.1], [-0.1, 0.1, 0.0]])
    fine = np.geomspace(1e-5, 1.0, 4001)
    prior = 2 / (np.pi * 1e-2) / (1 + (fine / 1e-2) ** 2)
    expected = []
    for t in theta:
        r = y - LINEAR_HZ - SLOPE @ (t - LINEAR_PARAMETERS.initial)
        std = np.hypot(STATED, fine[:, None]) * y
        expected.append(np.trapezoid(prior * np.exp(stats.norm.logpdf(r, scale=std).sum(axis=1)), fine))
    row.error(problem.log_likelihood(theta) - np.log(expected), below=0.05)


def test_a_structure_that_is_not_the_models_is_no_matter_of_discrepancy():
    data = disturbed(1, MISSED)
    # stiff along x, soft along y; all of them 30 times as high would be another unit
    factor = np.array([2.9, 0.34, 2.9, 0.34])
    far = replace(data, sets=(replace(data.sets[0], frequency_hz=data.sets[0].frequency_hz * factor),))
    with pytest.raises(InputError, match="does not explain the misfit"):
        estimate_discrepancy(chain_model(), far, weights=WEIGHTS)


def test_it_is_added_in_squares():
    model, data = chain_model(), disturbed(1, MISSED)
    plain = build_problem(model, data, weights=WEIGHTS)
    more = build_problem(model, data, weights=replace(WEIGHTS, discrepancy=2 * STATED))
    n = plain.n_frequency
    assert more.std[:n] == pytest.approx(np.sqrt(5) * plain.std[:n])
    assert more.std[n:] == pytest.approx(np.sqrt(5) * plain.std[n:])
    assert more.fingerprint() != plain.fingerprint()


def test_a_stated_one_goes_through_the_steps_and_wrong_ones_are_refused(capsys):
    data = disturbed(1, MISSED)
    record = verbs.update(chain_model(), data, likelihood=LikelihoodSettings(weights=(STATED,) * 4, discrepancy=0.004))
    assert "discrepancy of 0.4 % of each frequency" in record.settings["weights"]
    with pytest.raises(InputError, match="auto"):
        verbs.update(chain_model(), data, likelihood=LikelihoodSettings(discrepancy="much"))
    with pytest.raises(InputError, match="no share"):
        Weights(discrepancy=-0.1)
    with pytest.raises(SystemExit) as left:
        main(["update", "--model", "m", "--modes", "n", "--out", "o", "--discrepancy", "-1"])
    assert left.value.code == 2 and "auto" in capsys.readouterr().err


def test_inform_says_where_it_was_evaluated(validation):
    row = validation(what="parameters where `inform` says that it was evaluated", reference="the posterior's maximum",
                     why="where both stop")
    data = disturbed(1, MISSED)
    likelihood = LikelihoodSettings(weights=(STATED,) * 4)
    first, there = (verbs.inform(chain_model(), data, likelihood=likelihood, at=at) for at in ("initial", "map"))
    assert first.settings["evaluated at"] == "the initial parameters" and "maximum" in there.summary
    problem = build_problem(chain_model(), data, weights=WEIGHTS)
    top = maximum_a_posteriori(problem, [CHAIN_TRUTH])
    row.error(np.array([r.value for r in there.rows]) - top.theta, 1e-6)
    # a prior's CoV does not depend on where slopes are taken
    assert [r.cov for r in there.rows] == pytest.approx([r.cov for r in first.rows], nan_ok=True)
    with pytest.raises(InputError, match="choose from initial, map"):
        verbs.inform(chain_model(), data, at="mean")


def test_what_is_no_settings_value_is_refused_by_name():
    data = measured_chain(noise=0.003, seed=1)
    with pytest.raises(InputError, match=r"of type str, where LikelihoodSettings is expected; give probupdate\."):
        verbs.sets(chain_model(), data, likelihood="paper")
    with pytest.raises(InputError, match="settings: a value of type SamplerSettings, where UpdateSettings is expected"):
        verbs.update(chain_model(), data, settings=SamplerSettings())
    with pytest.raises(TypeError, match="weights"):
        verbs.update(chain_model(), data, weights="paper")
