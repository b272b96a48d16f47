"""Importance sampling from a fitted mixture: two maxima and known Gaussians against quadrature and closed forms."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy import stats
from updating_cases import LINEAR_HZ, LINEAR_PARAMETERS, linear_problem, modal_set

from probupdate import verbs
from probupdate.errors import InputError
from probupdate.modal.modes import ModalData
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.functions import FunctionModel
from probupdate.updating.discrepancy import LikelihoodSettings
from probupdate.updating.ensemble import initial_state, nested_r_hat
from probupdate.updating.importance import (
    Mixture,
    PriorDensity,
    StudentT,
    coordinates,
    fitted_proposal,
    importance_sample,
)
from probupdate.updating.laplace import distinct_maxima, maximum_a_posteriori, search_maxima, trust_region
from probupdate.updating.problem import Weights, build_problem
from probupdate.updating.settings import SamplerSettings
from probupdate.updating.surrogate import Proposal, fit_surrogate, from_laplace

OFFSET, N_CHANNEL = 20.0, 6
SHAPE = np.linalg.qr(np.random.default_rng(5).standard_normal((N_CHANNEL, N_CHANNEL)))[0]


def two_modes(measured, sigma, prior_a, bend=0.2, slope=0.1):
    """g = (b + slope a, a^2 + bend b) as frequencies about OFFSET and twice that: +-a fit alike."""
    parameters = Parameters((Parameter(name="a", unit="-", initial=prior_a[0], std=prior_a[1], lower=-4.0, upper=4.0),
                             Parameter(name="b", unit="-", initial=0.0, std=1.0, lower=-4.0, upper=4.0)))

    def function(theta):
        a, b = theta
        spare = 100.0 * 1.5 ** np.arange(N_CHANNEL - 2)
        return np.concatenate([[OFFSET + b + slope * a, 2 * OFFSET + a * a + bend * b], spare]), SHAPE

    model = FunctionModel(name="two modes", parameters=parameters, channels=tuple(f"c{k}" for k in range(N_CHANNEL)),
                          function=function, version="1")
    one = modal_set(np.array([OFFSET + measured[1], 2 * OFFSET + measured[0]]), SHAPE[:, :2],
                    std=np.array([sigma[1], sigma[0]]))
    return model, ModalData(channels=model.channels, sets=(one,))


@cache
def quadrature(measured, sigma, prior_a, bend=0.2, slope=0.1):
    """P(a < 0) and ln Z on a grid that resolves a tenth of the sharpest width."""
    a, b = np.linspace(-4, 4, 16_001)[:, None], np.linspace(-4, 4, 801)

    def cut(x, mean, std):
        return stats.truncnorm.logpdf(x, (-4 - mean) / std, (4 - mean) / std, loc=mean, scale=std)

    def normal(x, mean, std):
        return -0.5 * ((x - mean) / std) ** 2 - np.log(std * np.sqrt(2 * np.pi))

    value = cut(a, *prior_a) + cut(b, 0.0, 1.0)
    value += normal(a * a + bend * b, measured[0], sigma[0]) + normal(b + slope * a, measured[1], sigma[1])
    most = value.max()
    density = np.exp(value - most).sum(axis=1)
    step = (a[1, 0] - a[0, 0]) * (b[1] - b[0])
    return density[a[:, 0] < 0].sum() / density.sum(), np.log(density.sum() * step) + most


CASES = [((4.0, 0.3), (0.02, 0.5), (0.3, 1.5)), ((2.5, -0.2), (0.05, 0.3), (-0.4, 1.2)),
         ((6.0, 0.5), (0.1, 0.4), (0.1, 2.0))]


@pytest.mark.parametrize("case", CASES)
def test_two_separate_maxima_are_both_sampled(case, validation):
    row = validation(what="two separate maxima: share of each, ln Z, by weighted draws", reference="quadrature",
                     unit="standard errors")
    model, data = two_modes(*case)
    problem = build_problem(model, data, weights=Weights(shapes="none"))
    rng = np.random.default_rng(17)
    top = maximum_a_posteriori(problem, [model.parameters.initial])
    maxima = distinct_maxima(problem, top, model.parameters.draw(rng, 12))
    assert len(maxima) == 2 and np.sign(maxima[0].theta[0]) == -np.sign(maxima[1].theta[0])
    approximations = [Proposal(approximation=fit_surrogate(problem, x, rng)[0]) for x in maxima]
    proposal, _ = fitted_proposal(problem, approximations, rng)
    found = importance_sample(problem, proposal, rng)
    share, log_evidence = quadrature(*case)
    assert found.pareto_k < 0.5 and found.effective > 500
    # four standard errors
    row.error((found.log_evidence - log_evidence) / (found.log_evidence_std + 5e-4), below=4, of="ln Z")
    error = np.sqrt(share * (1 - share) / found.effective)
    row.error((found.weight[found.theta[:, 0] < 0].sum() - share) / error, below=4, of="share")


@pytest.mark.parametrize("seed", [1, 2])
def test_maxima_are_looked_for_until_few_can_be_missing(seed, validation):
    """Twelve starts find 8 of the 16; ln evidence was 0.1 off and the chain disagreed with the weighted draws."""
    row = validation(what="sixteen unlike maxima of four parameters: ln Z by weighted draws",
                     reference="product of four quadratures", unit="standard errors")
    rng = np.random.default_rng(seed)
    base, slope, bend = 10.0 * 1.5 ** np.arange(4), rng.uniform(0.02, 0.06, 4), rng.uniform(0.02, 0.06, 4)
    parameters = Parameters(tuple(Parameter(name=f"p{k}", unit="-", initial=1.0, std=0.2, lower=0.0, upper=2.0)
                                  for k in range(4)))

    def frequency(theta):
        z = (theta - 1) / 0.2
        return base * (1 + slope * z + bend * z**2)

    model = FunctionModel(name="oscillators", parameters=parameters, channels=("a", "b", "c", "d"), version=str(seed),
                          function=lambda theta: (frequency(theta), np.eye(4)))
    measured = frequency(1 + 0.2 * rng.uniform(0.5, 1.2, 4))
    data = ModalData(channels=model.channels, sets=(modal_set(measured, np.eye(4), std=0.01 * measured),))
    problem = build_problem(model, data, weights=Weights(shapes="none"))
    top = maximum_a_posteriori(problem, [parameters.initial])
    maxima, n_start, unseen = search_maxima(problem, top, rng)
    by_twelve = distinct_maxima(problem, top, parameters.draw(rng, 12))
    assert n_start > 12 and unseen <= 0.02 and len(maxima) > len(by_twelve)
    found = importance_sample(problem, fitted_proposal(problem, [
        Proposal(approximation=fit_surrogate(problem, x, rng)[0]) for x in maxima], rng)[0], rng)
    grid = np.linspace(0, 2, 20_001)
    density = stats.norm.pdf(measured, frequency(grid[:, None]), 0.01 * measured) * stats.truncnorm.pdf(
        grid[:, None], -5, 5, loc=1.0, scale=0.2)
    log_evidence = np.sum(np.log(density.sum(axis=0) * (grid[1] - grid[0])))
    row.error((found.log_evidence - log_evidence) / found.log_evidence_std, below=4, of="ln Z")


def test_the_chain_visits_both_maxima_and_says_so(tmp_path, validation):
    """P(a < 0) was 0.000 for 0.352 and the chain 'converged'."""
    row = validation(what="two separate maxima by the chain: share in standard errors, ln Z", reference="quadrature")
    model, data = two_modes(*CASES[0])
    posterior = verbs.sample(model, data, tmp_path / "p.nc", settings=SamplerSettings(target_ess=400, seed=5),
                             likelihood=LikelihoodSettings(weights=Weights(shapes="none")))
    share, log_evidence = quadrature(*CASES[0])
    draws = posterior.draws[:, 0]
    # four standard errors at the effective size the chain claims
    error = np.sqrt(share * (1 - share) / posterior.ess[0])
    assert posterior.converged
    row.error((np.mean(draws < 0) - share) / error, below=4, of="share")
    row.error(posterior.record["evidence"]["log_evidence"] - log_evidence, below=0.05, of="ln Z")
    assert "2 separate maxima" in " ".join(posterior.record["statements"])


def test_a_linear_problems_draws_are_its_gaussian(validation):
    row = validation(what="weighted draws of a linear problem: means, standard deviations, evidence",
                     reference="its Gaussian, closed form", unit="standard errors")
    problem = linear_problem(LINEAR_HZ + 0.05)
    top = maximum_a_posteriori(problem, [LINEAR_PARAMETERS.initial])
    rng = np.random.default_rng(3)
    assert len(distinct_maxima(problem, top, LINEAR_PARAMETERS.draw(rng, 6))) == 1
    proposal, _ = fitted_proposal(problem, [Proposal(approximation=fit_surrogate(problem, top, rng)[0])], rng)
    found = importance_sample(problem, proposal, rng)
    assert found.good and found.effective > 1500
    row.error((found.mean - top.theta) / found.mean_error, below=4, of="means")
    row.error((found.std / np.sqrt(np.diag(top.covariance)) - 1) * np.sqrt(2 * found.effective), below=4,
              of="standard deviations")
    # the evidence of a linear problem is the Gaussian density of its data
    S, covariance = problem.sensitivity(top.theta)[1], np.diag(problem.std**2)
    covariance = covariance + S @ np.diag(LINEAR_PARAMETERS.std**2) @ S.T
    left = problem.measured - problem.predict(LINEAR_PARAMETERS.initial)
    dense = -0.5 * left @ np.linalg.solve(covariance, left) - 0.5 * np.linalg.slogdet(2 * np.pi * covariance)[1]
    row.error((found.log_evidence - dense) / found.log_evidence_std, below=4, of="evidence")


@pytest.mark.parametrize("logarithmic", [(False, False), (True, False)])
def test_student_t_draws_follow_its_density(logarithmic, validation):
    """The mean of exp(-|u|) under the draws against a grid over its density, which integrates to one."""
    row = validation(what="Student t draws", reference="density on a grid", unit="standard errors")
    logarithmic = np.array(logarithmic)
    centre, factor = np.array([0.2, -0.3]), np.array([[0.4, 0.0], [0.2, 0.5]])
    t = StudentT(centre=centre, factor=factor, logarithmic=logarithmic)
    drawn = coordinates(t.draw(20_000, np.random.default_rng(1)), logarithmic)
    grid = np.linspace(-30, 30, 1201)
    U = np.column_stack([g.ravel() for g in np.meshgrid(grid, grid, indexing="ij")])
    density = np.exp(t.of_coordinates(U)) * (grid[1] - grid[0]) ** 2
    assert density.sum() == pytest.approx(1.0, abs=2e-3)
    value = np.exp(-np.abs(drawn).sum(axis=1))
    expected = density @ np.exp(-np.abs(U).sum(axis=1))
    row.error((value.mean() - expected) / (value.std() / np.sqrt(len(value)) + 5e-4), below=4)
    theta = t.draw(50, np.random.default_rng(2))
    u = coordinates(theta, logarithmic)
    stretched = t.of_coordinates(u) - np.where(logarithmic, u, 0.0).sum(axis=1)
    assert t.log_density(theta) == pytest.approx(stretched)


def test_a_mixtures_density_is_the_sum_and_draws_outside_have_none():
    prior = PriorDensity(LINEAR_PARAMETERS)
    t = StudentT(centre=LINEAR_PARAMETERS.initial, factor=0.3 * np.eye(3), logarithmic=np.zeros(3, bool))
    mixture = Mixture(parameters=LINEAR_PARAMETERS, components=(t, prior), weight=np.array([0.7, 0.3]))
    theta = mixture.draw_inside(40, np.random.default_rng(4))
    parts = 0.7 * np.exp(t.log_density(theta)) + 0.3 * np.exp(prior.log_density(theta))
    assert np.exp(mixture.log_density(theta)) == pytest.approx(parts)
    bounded = Parameters((Parameter(name="p", unit="-", initial=1.0, std=0.5, lower=0.5, upper=1.5),))
    wide = StudentT(centre=np.array([1.0]), factor=np.array([[1.0]]), logarithmic=np.array([False]))
    out = Mixture(parameters=bounded, components=(wide,), weight=np.array([1.0])).log_density(np.array([[0.2], [1.0]]))
    assert out[0] == -np.inf and np.isfinite(out[1])


def test_nested_r_hat_sees_ensembles_that_disagree_and_no_dependence_within(validation):
    """Margossian et al. 2024: sqrt(1 + B / W); walkers that move together do not lower it."""
    row = validation(what="nested R-hat", reference="sqrt(1 + B / W) by hand", why="sampling")
    rng = np.random.default_rng(8)
    n_step, n_walker = 200, 10
    same = rng.standard_normal((n_step, 4 * n_walker, 1))
    assert nested_r_hat(same, 4)[0] < 1.001
    apart = same.copy()
    apart[:, :n_walker] += 1.0
    # means 1, 0, 0, 0: B = 1/4 over W about one
    row.error(nested_r_hat(apart, 4)[0] / np.sqrt(1.25) - 1, below=0.02)
    # a walk that all walkers of an ensemble share looks converged to each of them
    walk = np.repeat(np.cumsum(rng.standard_normal((4, n_step)) * 0.05, axis=1), n_walker, axis=0).T[:, :, None]
    assert nested_r_hat(same + walk, 4)[0] > 1.01
    assert np.isinf(nested_r_hat(np.zeros((50, 8, 1)), 4)[0])


def test_draws_without_modes_have_probability_zero_and_are_counted():
    """Bounds that allow what is not a structure: the model refuses a below zero."""
    model, data = two_modes(*CASES[0])

    def function(theta):
        if theta[0] < 0:
            raise InputError("model", "has a negative stiffness", "raise the lower bound")
        return model.function(theta)

    half = replace(model, function=function)
    problem = build_problem(half, data, weights=Weights(shapes="none"))
    rng = np.random.default_rng(2)
    top = maximum_a_posteriori(problem, [np.array([2.0, 0.0])])
    proposal, _ = fitted_proposal(problem, [Proposal(approximation=from_laplace(top, problem.parameters))], rng)
    found = importance_sample(problem, proposal, rng)
    assert found.without_modes > 0 and np.all(found.theta[found.weight > 0][:, 0] >= 0)
    whole = quadrature(*CASES[0])
    # the positive half of the evidence
    assert found.log_evidence == pytest.approx(whole[1] + np.log(1 - whole[0]), abs=4 * found.log_evidence_std + 2e-3)



def half_of_two_modes():
    """The problem above, and how often the model was asked for a below zero."""
    model, data = two_modes(*CASES[0])
    asked = []

    def function(theta):
        if theta[0] < 0:
            asked.append(theta)
            raise InputError("model", "has a negative stiffness", "raise the lower bound")
        return model.function(theta)

    return build_problem(replace(model, function=function), data, weights=Weights(shapes="none")), asked


def test_the_posterior_is_zero_where_there_are_no_modes():
    problem, asked = half_of_two_modes()
    theta = np.array([[2.0, 0.0], [-2.0, 0.0], [5.0, 0.0], [1.0, 0.1]])
    value, fallback = problem.log_posterior(theta)
    assert asked and np.array_equal(np.isfinite(value), [True, False, False, True]) and not fallback.any()
    assert value[0] == problem.log_posterior(theta[0])[0][0] and value[3] == problem.log_posterior(theta[3])[0][0]


def test_climbs_from_where_there_are_no_modes_are_left_out():
    problem, asked = half_of_two_modes()
    right, wrong = np.array([2.0, 0.0]), np.array([-2.0, 0.0])
    alone = maximum_a_posteriori(problem, [right])
    assert np.array_equal(maximum_a_posteriori(problem, [wrong, right]).theta, alone.theta)
    assert len(distinct_maxima(problem, alone, [wrong, right])) == 1 and asked
    with pytest.raises(InputError, match="has a negative stiffness"):
        maximum_a_posteriori(problem, [wrong])
    # a trust region that steps there comes back
    assert trust_region(problem, np.array([0.2, 0.0]))[0] > 0


class Uniform:
    """Draws of a from `lowest` to `highest`, b zero."""

    def __init__(self, lowest, highest):
        self.lowest, self.highest = lowest, highest

    def draw(self, n, rng):
        return np.column_stack([rng.uniform(self.lowest, self.highest, n), np.zeros(n)])


def test_walkers_begin_where_there_are_modes():
    """From one that has none emcee subtracts an infinity from an infinity at each step."""
    problem, asked = half_of_two_modes()
    start = initial_state(problem, Uniform(-4.0, 4.0), 40, 3, 1).coords
    assert asked and np.all(start[:, 0] >= 0) and len(np.unique(start[:, 0])) == 40
    # where all have modes nothing is drawn again
    plain = initial_state(problem, Uniform(0.0, 4.0), 40, 3, 1).coords
    assert np.array_equal(plain, Uniform(0.0, 4.0).draw(40, np.random.default_rng([3, 0, 1])))


def test_a_model_that_has_no_modes_anywhere_is_refused():
    problem, _ = half_of_two_modes()
    with pytest.raises(InputError, match="no modes at 10 of 10 starts"):
        initial_state(problem, Uniform(-4.0, -0.1), 10, 3, 0)
