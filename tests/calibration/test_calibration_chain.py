"""Calibration of maximum, chain and log-likelihood on a chain of masses: ranks of the truth over fifty data sets, with
errors planted that the ranks must see. The study of the whole chain is in studies/calibration."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from probupdate.modal.modes import ModalData, ModalSet
from probupdate.model.interface import ManySolutions
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.functions import FunctionModel
from probupdate.updating.ensemble import SamplerSettings, sample
from probupdate.updating.laplace import maximum_a_posteriori
from probupdate.updating.problem import build_problem
from probupdate.updating.surrogate import Proposal, from_laplace

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "studies" / "calibration"))
from ranks import band, coverage, histogram, uniformity, weighted_rank

N_REPLICATE, N_MODE, N_MASS = 50, 3, 5
CHANNELS = tuple(f"c{k}" for k in range(N_MASS))
PARAMETERS = Parameters((
    Parameter(name="base", unit="-", initial=1.0, std=0.6, lower=0.1, upper=6.0),
    Parameter(name="upper", unit="-", initial=1.0, std=0.2, lower=0.2, upper=4.0, prior="lognormal"),
    Parameter(name="top", unit="-", initial=1.0, std=0.1, lower=0.5, upper=2.0),
))
FREQUENCY_STD, SHAPE_STD = np.array([0.01, 0.03, 0.05]), 0.03
# p-value that calibrated ranks fall below once in a thousand: passed above it, caught below it
LIMIT = 1e-3


def many_modes(theta):
    """Masses on springs, the lowest one soft, of theta (n, 3): frequencies (n, 5) in Hz and shapes (n, 5, 5)."""
    spring = 60.0 * np.stack([0.3 * theta[:, 0], *(4 * [theta[:, 1]])], axis=1)
    stiffness = np.zeros((len(theta), N_MASS, N_MASS))
    for k in range(N_MASS):
        stiffness[:, k, k] += spring[:, k]
        if k:
            stiffness[:, k - 1, k - 1] += spring[:, k]
            stiffness[:, k, k - 1] -= spring[:, k]
            stiffness[:, k - 1, k] -= spring[:, k]
    root = np.ones((len(theta), N_MASS))
    root[:, -1] = np.sqrt(theta[:, 2])
    value, shape = np.linalg.eigh(stiffness / (root[:, :, None] * root[:, None, :]))
    shape = shape / root[:, :, None]
    return np.sqrt(value) / (2 * np.pi), shape / np.abs(shape).max(axis=1, keepdims=True)


def modes(theta):
    frequency, shape = many_modes(theta[None])
    return frequency[0], shape[0]


class Masses(FunctionModel):
    """Many at once, as a chain asks for thousands."""

    def solve_many(self, theta, n_mode):
        frequency, shape = many_modes(np.atleast_2d(theta))
        return ManySolutions(frequency_hz=frequency[:, :n_mode], shape=shape[:, :, :n_mode],
                             fallback=np.zeros(len(frequency), bool))


def measured(theta, rng, stated=1.0):
    """Modes with Gaussian noise whose standard deviation is told as `stated` times what it is."""
    frequency, shape = modes(theta)
    frequency = frequency[:N_MODE] + FREQUENCY_STD * rng.standard_normal(N_MODE)
    shape = shape[:, :N_MODE] + SHAPE_STD * rng.standard_normal((N_MASS, N_MODE))
    one = ModalSet(
        id="one", frequency_hz=frequency, shape=shape, damping_ratio=np.full(N_MODE, 0.01),
        frequency_std_hz=stated * FREQUENCY_STD, shape_std=np.full(shape.shape, stated * SHAPE_STD),
    )
    return ModalData(channels=CHANNELS, sets=(one,))


def problem_of(theta, rng, stated=1.0):
    model = Masses(name="masses", parameters=PARAMETERS, channels=CHANNELS, function=modes, version="1")
    # shapes one by one, whatever the noise does to the gaps between modes
    return build_problem(model, measured(theta, rng, stated), clusters=[(k,) for k in range(N_MODE)])


def ranks_of(problem, theta, draws, log_likelihood, weight=None):
    values = np.column_stack([draws, log_likelihood])
    return weighted_rank(values, np.append(theta, problem.log_likelihood(theta)[0]), weight)


def by_chain(problem, top, theta, number, folder):
    """Forty steps of 24 walkers, of which a fifth is left out, from the Laplace approximation."""
    settings = SamplerSettings(seed=number, walkers_per_parameter=8, target_ess=1, max_steps=40,
                               ensembles=1)
    chain = sample(problem, from_laplace(top, problem.parameters), folder, settings)
    value = chain.log_posterior[chain.first :].ravel() - problem.parameters.log_density(chain.draws)
    return ranks_of(problem, theta, chain.draws, value)


def by_weights(problem, top, theta, rng):
    proposal = Proposal(approximation=from_laplace(top, problem.parameters))
    draws = proposal.draw(400, rng)
    value, _ = problem.log_posterior(draws)
    weight = value - proposal.log_density(draws)
    return ranks_of(problem, theta, draws, value - problem.parameters.log_density(draws),
                    np.exp(weight - weight.max()))


def replicates(place, seed, stated=1.0, count=N_REPLICATE):
    found = []
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        theta = PARAMETERS.draw(rng, 1)[0]
        problem = problem_of(theta, rng, stated)
        found.append(place(problem, theta, number, rng))
    return np.array(found)


def maximum(problem):
    return maximum_a_posteriori(problem, [problem.parameters.initial])


def test_the_chain_is_calibrated(tmp_path):
    ranks = replicates(lambda problem, theta, k, _: by_chain(problem, maximum(problem), theta, k, tmp_path / str(k)),
                       seed=1)
    assert ranks.shape == (N_REPLICATE, 4)
    assert min(uniformity(column) for column in ranks.T) > LIMIT
    for column in ranks.T:
        for level in (0.5, 0.9):
            low, high = band(level, N_REPLICATE, 1 - LIMIT)
            assert low <= coverage(column, level) <= high


def test_intervals_hold_the_truth_as_often_as_they_say(validation):
    """By weighted draws, which cost little: 90 % of 200 within 82.5 to 96.5 %, where fifty chains allow 74 to 100."""
    row = validation(what="coverage of 90 % intervals, 200 data sets, each parameter", reference="0.9",
                     why="binomial, p 1e-3")
    ranks = replicates(lambda problem, theta, _, rng: by_weights(problem, maximum(problem), theta, rng), seed=5,
                       count=200)
    for column in ranks[:, :-1].T:
        low, high = band(0.9, 200, 1 - LIMIT)
        assert low > 0.82 and high < 0.97
        row.between(coverage(column, 0.9), 0.82, 0.97)
        assert low <= coverage(column, 0.9) <= high


def test_deviations_stated_too_wide_are_caught(validation):
    row = validation(what="standard deviations stated 1.5 times too wide, and rightly: p of the log-likelihood's rank",
                     reference="caught; calibrated")
    ranks = replicates(lambda problem, theta, _, rng: by_weights(problem, maximum(problem), theta, rng), seed=2,
                       stated=1.5)
    row.error(uniformity(ranks[:, -1]), below=LIMIT, of="too wide")
    # and the same weights without the error pass
    ranks = replicates(lambda problem, theta, _, rng: by_weights(problem, maximum(problem), theta, rng), seed=2)
    row.least(min(uniformity(column) for column in ranks.T), above=LIMIT, of="rightly")


def test_data_ignored_are_caught_by_the_log_likelihood_only(validation):
    row = validation(what="data ignored: p of the log-likelihood's rank, of the parameters'",
                     reference="caught; calibrated")
    def prior_only(problem, theta, _, rng):
        draws = PARAMETERS.draw(rng, 200)
        return ranks_of(problem, theta, draws, problem.log_likelihood(draws))

    ranks = replicates(prior_only, seed=3)
    row.error(uniformity(ranks[:, -1]), below=LIMIT, of="log-likelihood")
    # every parameter alone looks calibrated: that is why the log-likelihood is ranked
    row.least(min(uniformity(column) for column in ranks[:, :-1].T), above=LIMIT, of="parameters")


def test_ranks_and_bands():
    draws = np.arange(10.0)[:, None]
    assert weighted_rank(draws, np.array([2.5]))[0] == 0.3
    assert weighted_rank(draws, np.array([2.5]), np.array([1.0] + 9 * [1 / 9]))[0] == pytest.approx((1 + 2 / 9) / 2)
    assert histogram(np.array([0.0, 0.05, 0.95, 1.0])).tolist() == [2, 0, 0, 0, 0, 0, 0, 0, 0, 2]
    assert coverage(np.array([0.01, 0.2, 0.5, 0.8, 0.99]), 0.5) == 0.2
    low, high = band(0.9, 300)
    inside = stats.binom.cdf(round(300 * high), 300, 0.9) - stats.binom.cdf(round(300 * low) - 1, 300, 0.9)
    assert 0.95 <= inside < 0.97 and low < 0.9 < high


def test_correlated_priors_are_calibrated_too():
    correlation = np.array([[1.0, -0.5, 0.0], [-0.5, 1.0, 0.3], [0.0, 0.3, 1.0]])
    parameters = replace(PARAMETERS, correlation=correlation)

    found = []
    for number in range(N_REPLICATE):
        rng = np.random.default_rng([4, number])
        theta = parameters.draw(rng, 1)[0]
        problem = problem_of(theta, rng)
        problem = problem.with_model(replace(problem.model, parameters=parameters))
        found.append(by_weights(problem, maximum(problem), theta, rng))
    assert min(uniformity(column) for column in np.array(found).T) > LIMIT
