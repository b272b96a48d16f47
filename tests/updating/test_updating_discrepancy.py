"""What a model misses beyond the stated deviations: found where it was put in, zero where there is none."""

from dataclasses import replace

import numpy as np
import pytest
from updating_cases import CHAIN_TRUTH, chain_model, measured_chain

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
    variance = np.array([w.discrepancy**2 for w in found])
    expected = MISSED**2 - STATED**2
    n = build_problem(model, data_sets[0], weights=WEIGHTS).n_effective
    # a mean of chi-squares over four sets, 1 % of the root's accuracy in each
    row.error((variance.mean() / expected - 1) / np.sqrt(2 / (4 * n)), below=4)
    problem = build_problem(model, data_sets[0], weights=found[0])
    top = maximum_a_posteriori(problem, [CHAIN_TRUTH])
    assert top.misfit == pytest.approx(expected_misfit(problem, top), rel=0.03)
    assert "estimated" in problem.weights.description and "%" in problem.weights.description
    # the sure posterior of the stated standard deviations alone becomes as wide as what is missed says
    plain = maximum_a_posteriori(build_problem(model, data_sets[0], weights=WEIGHTS), [CHAIN_TRUTH])
    assert top.covariance[0, 0] > 4 * plain.covariance[0, 0]


def test_none_where_the_stated_deviations_suffice():
    found = estimate_discrepancy(chain_model(), disturbed(3, 0.5 * STATED), weights=WEIGHTS)
    assert found.discrepancy == 0.0 and found.discrepancy_by == WEIGHTS.discrepancy_by


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
    assert [r.cov for r in there.rows] == [r.cov for r in first.rows]
    with pytest.raises(InputError, match="choose from initial, map"):
        verbs.inform(chain_model(), data, at="mean")


def test_what_is_no_settings_value_is_refused_by_name():
    data = measured_chain(noise=0.003, seed=1)
    with pytest.raises(InputError, match=r"likelihood: a str is no LikelihoodSettings; give probupdate\.Likelihood"):
        verbs.sets(chain_model(), data, likelihood="paper")
    with pytest.raises(InputError, match="settings: a SamplerSettings is no UpdateSettings"):
        verbs.update(chain_model(), data, settings=SamplerSettings())
    with pytest.raises(TypeError, match="weights"):
        verbs.update(chain_model(), data, weights="paper")
