"""The evidence against quadrature, closed forms, ArviZ and dynesty; the check of the Laplace approximation."""

from dataclasses import replace

import numpy as np
import pytest
from peer_packages import peer
from scipy import stats
from updating_cases import (
    CHAIN_PARAMETERS,
    LINEAR_HZ,
    arviz_psislw,
    chain_problem,
    linear_data,
    linear_model,
    linear_problem,
)

from probupdate.model.parameters import Parameter, Parameters
from probupdate.updating.ensemble import SamplerSettings, sample
from probupdate.updating.evidence import (
    TRUSTED_K,
    check_laplace,
    estimate_evidence,
    log_prior_constant,
    pareto_shape,
)
from probupdate.updating.importance import importance_sample
from probupdate.updating.laplace import maximum_a_posteriori
from probupdate.updating.problem import build_problem
from probupdate.updating.surrogate import Proposal, fit_surrogate

LIMIT = 4.0
CUT = Parameters((
    Parameter(name="a", unit="-", initial=1.0, std=0.5, lower=0.2, upper=4.0, prior="lognormal"),
    Parameter(name="b", unit="-", initial=2.0, std=0.3, lower=1.9, upper=2.6),
))
SLOPE = np.array([[0.05, 0.02, 0], [0.10, -0.04, 0], [0.02, 0.20, 0], [0.30, 0.10, 0], [-0.20, 0.50, 0]])


def two_parameters(parameters=CUT):
    model, three = linear_model(parameters, slope=SLOPE[:, :2]), linear_model(slope=SLOPE)

    def function(theta):
        return three.function(np.append(theta, -1.0))

    return build_problem(replace(model, function=function),
                         linear_data(LINEAR_HZ + np.array([0.02, 0.05, -0.04, 0.1, -0.25]), cov=0.02))


def by_quadrature(problem, constant=0.0) -> float:
    node, weight = np.polynomial.legendre.leggauss(60)
    half = [0.5 * (p.upper - p.lower) for p in problem.parameters]
    axes = [0.5 * (p.upper + p.lower) + h * node for p, h in zip(problem.parameters, half, strict=True)]
    a, b = np.meshgrid(*axes, indexing="ij")
    value, _ = problem.log_posterior(np.column_stack([a.ravel(), b.ravel()]))
    total = np.sum(np.exp(value).reshape(a.shape) * np.outer(weight, weight)) * half[0] * half[1]
    return float(np.log(total) + constant)


def evidence_of(problem, folder, *, seed=1, ess=1000):
    top = maximum_a_posteriori(problem, [problem.parameters.initial])
    approximation, _ = fit_surrogate(problem, top, np.random.default_rng(seed))
    chain = sample(problem, approximation, folder, SamplerSettings(seed=seed, target_ess=ess))
    kept, proposal = slice(chain.first, None), Proposal(approximation=approximation)
    drawn = importance_sample(problem, proposal, np.random.default_rng(seed))
    return estimate_evidence(problem.parameters, proposal, drawn.log_weight, chain.theta[kept],
                             chain.log_posterior[kept])


def test_evidence_against_quadrature(tmp_path, validation):
    row = validation(what="ln evidence, two parameters, lognormal and cut prior", reference="Gauss-Legendre",
                     why="each below 0.02 nat", unit="stated standard deviations")
    problem = two_parameters()
    found, exact = evidence_of(problem, tmp_path), by_quadrature(problem)
    row.error((found.log_evidence - exact) / found.std, below=LIMIT, of="bridge")
    row.error((found.importance - exact) / found.importance_std, below=LIMIT, of="importance")
    assert found.std < 0.02 and found.pareto_k < TRUSTED_K and found.agrees


def test_a_correlated_priors_constant_is_part_of_the_evidence(tmp_path):
    parameters = replace(CUT, correlation=np.array([[1.0, -0.6], [-0.6, 1.0]]))
    problem = two_parameters(parameters)
    constant, unknown = log_prior_constant(parameters)
    # the prior integrates to one with it
    node, weight = np.polynomial.legendre.leggauss(200)
    half = [0.5 * (p.upper - p.lower) for p in parameters]
    axes = [0.5 * (p.upper + p.lower) + h * node for p, h in zip(parameters, half, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    total = np.sum(np.exp(parameters.log_density(grid)) * np.outer(weight, weight)) * half[0] * half[1]
    assert unknown < 1e-4 and np.log(total) + constant == pytest.approx(0.0, abs=5 * unknown + 1e-9)
    found = evidence_of(problem, tmp_path)
    assert found.log_evidence == pytest.approx(by_quadrature(problem, constant), abs=LIMIT * found.std + 1e-9)
    assert log_prior_constant(CUT) == (0.0, 0.0)


def test_a_linear_problems_evidence_is_the_density_of_its_data(tmp_path, validation):
    row = validation(what="ln evidence of a linear problem, by sampling; by Laplace's method",
                     reference="density of its data")
    problem = linear_problem(LINEAR_HZ + np.array([0.03, -0.06, 0.10, 0.15, -0.30]))
    _, S = problem.sensitivity(problem.parameters.initial)
    covariance = np.diag(problem.std**2) + S @ problem.parameters.covariance @ S.T
    mean = problem.predict(problem.parameters.initial)
    exact = stats.multivariate_normal(mean, covariance).logpdf(problem.measured)
    found = evidence_of(problem, tmp_path)
    row.error((found.log_evidence - exact) / (found.std + 1e-3 / LIMIT), below=LIMIT, of="stated standard deviations")
    top = maximum_a_posteriori(problem, [problem.parameters.initial])
    check = check_laplace(problem, top, np.random.default_rng(2))
    # a linear problem without bounds is its Laplace approximation, up to the model's differences
    row.error(check.log_evidence - exact, below=1e-3, of="nat, Laplace")
    assert check.share > 0.999 and check.pareto_k < TRUSTED_K


@pytest.mark.long
def test_the_stated_deviation_is_the_scatter_over_seeds(tmp_path, validation):
    row = validation(what="ln evidence by sampling, five seeds (long): scatter over the stated standard deviation",
                     reference="1", why="a chi-square of 4 over 4, probability 0.998")
    problem = two_parameters()
    found = [evidence_of(problem, tmp_path / str(k), seed=k, ess=300) for k in range(5)]
    scatter = np.std([f.log_evidence for f in found], ddof=1)
    stated = np.sqrt(np.mean([f.std**2 for f in found]))
    # a chi-square of 4 over 4: its root lies within these factors with probability 0.998
    row.between(scatter / stated, 0.15, 2.2)


def test_pareto_shape_of_known_tails(validation):
    row = validation(what="Pareto k", reference="exact tails", unit="standard errors")
    rng = np.random.default_rng(3)
    for k in (0.2, 0.5, 0.9):
        weights = stats.genpareto(k).rvs(20_000, random_state=rng)
        # the tail's 424 largest: standard deviation of k about (1 + k) / sqrt(424)
        row.error((pareto_shape(np.log(weights)) - k) / (1 + k) * np.sqrt(424), below=LIMIT)
    assert pareto_shape(np.zeros(100)) == 0.0
    assert pareto_shape(np.zeros(20)) == np.inf


def test_pareto_shape_is_arvizs(validation):
    row = validation(what="Pareto k of normal weights", reference="ArviZ",
                     why="the threshold may be one weight lower there")
    psislw = arviz_psislw()
    rng = np.random.default_rng(4)
    for scale in (0.5, 1.5, 3.0):
        weights = scale * rng.standard_normal(4000)
        # the threshold may be one weight lower there
        row.error(pareto_shape(weights) - float(psislw(weights)[1]), below=0.02)


def test_laplace_is_told_to_be_wrong_where_it_is():
    # data that say little of a coupling that only enters squared: two maxima, of which it knows one
    good = chain_problem(noise=0.004)
    top = maximum_a_posteriori(good, [CHAIN_PARAMETERS.initial])
    check = check_laplace(good, top, np.random.default_rng(1))
    assert check.pareto_k < TRUSTED_K and "tails are not" not in check.sentence
    narrow = replace(top, precision=top.precision * 30.0)
    assert check_laplace(good, narrow, np.random.default_rng(1)).pareto_k > TRUSTED_K
    assert "tails are not" in check_laplace(good, narrow, np.random.default_rng(1)).sentence


@pytest.mark.long
def test_evidence_against_nested_sampling(tmp_path, validation):
    row = validation(what="ln evidence of a chain of masses, four parameters (long)",
                     reference="nested sampling by dynesty, 300 live points",
                     unit="stated standard deviations of both")
    dynesty = peer("dynesty")
    problem = chain_problem(noise=0.004)
    parameters = problem.parameters
    nested = dynesty.NestedSampler(
        lambda theta: float(problem.log_likelihood(theta)[0]),
        lambda u: np.array([p.distribution.ppf(x) for p, x in zip(parameters, u, strict=True)]), len(parameters),
        nlive=300, rstate=np.random.default_rng(1),
    )
    nested.run_nested(dlogz=0.05, print_progress=False)
    found = evidence_of(problem, tmp_path)
    both = np.hypot(nested.results.logzerr[-1], found.std)
    row.error((found.log_evidence - nested.results.logz[-1]) / both, below=4)
