"""A proposal that bends: its density integrates to one, and thin curved posteriors are drawn as quadrature has them."""

from dataclasses import replace

import numpy as np
import pytest
from updating_cases import modal_set

from probupdate.modal.modes import ModalData
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.functions import FunctionModel
from probupdate.updating.importance import fitted_proposal, importance_sample
from probupdate.updating.laplace import maximum_a_posteriori
from probupdate.updating.problem import Weights, build_problem
from probupdate.updating.surrogate import (
    GaussianApproximation,
    Proposal,
    TruncatedGaussian,
    fit_surrogate,
    from_laplace,
)
from probupdate.updating.transport import Transport, fit_transport

SHAPE = np.linalg.qr(np.random.default_rng(5).standard_normal((6, 6)))[0]
# of (a, b): two springs in series, in parallel with a mass on them, a product
FUNCTIONS = {"series": lambda a, b: 2 / (1 / a + 1 / b), "product": lambda a, b: a * b,
             "ratio": lambda a, b: (1 + a * a) / (1 + b)}
# b where the function of a is r^2
SOLVED = {"series": lambda a, r: 1 / (2 / r**2 - 1 / a), "product": lambda a, r: r**2 / a,
          "ratio": lambda a, r: (1 + a * a) / r**2 - 1}


def ridge(kind: str, sigma: float, prior: str = "normal"):
    """One frequency, sharp to `sigma`, that two parameters share."""
    parameters = Parameters(tuple(Parameter(name=name, unit="-", initial=1.0, std=0.4, lower=0.05, upper=4.0,
                                            prior=prior) for name in "ab"))

    def function(theta):
        return np.concatenate([[np.sqrt(FUNCTIONS[kind](*theta))], 100.0 * 1.5 ** np.arange(5)]), SHAPE

    model = FunctionModel(name=kind, parameters=parameters, channels=tuple(f"c{k}" for k in range(6)),
                          function=function, version="1")
    data = ModalData(channels=model.channels, sets=(modal_set([1.0], SHAPE[:, :1], std=np.array([sigma])),))
    return build_problem(model, data, weights=Weights(shapes="none"))


def by_quadrature(problem, kind: str, sigma: float):
    """ln Z, means and standard deviations: for each a, steps of the response across the ridge."""
    a = np.linspace(0.05, 4.0, 4001)[:, None]
    t = np.linspace(-7, 7, 57)
    with np.errstate(divide="ignore"):
        b = SOLVED[kind](a, 1 + sigma * t)
        up, down = (SOLVED[kind](a, 1 + sigma * (t + h)) for h in (1e-3, -1e-3))
    slope = np.abs(up - down) / (2e-3 * sigma)
    inside = (b > 0.05) & (b < 4.0)
    theta = np.stack(np.broadcast_arrays(a, b), axis=-1)[inside]
    off = np.broadcast_to(t, b.shape)[inside]
    density = slope[inside] * np.exp(problem.parameters.log_density(theta) - 0.5 * off**2)
    total = density.sum()
    mean = density @ theta / total
    log_evidence = np.log(total * (t[1] - t[0]) * (a[1, 0] - a[0, 0]) / np.sqrt(2 * np.pi))
    return log_evidence, mean, np.sqrt(density @ theta**2 / total - mean**2)


@pytest.mark.parametrize(("kind", "sigma", "prior"), [
    ("series", 1e-4, "normal"), ("product", 1e-3, "lognormal"), ("ratio", 1e-4, "normal"),
    ("product", 1e-3, "uniform")])
def test_a_thin_curved_ridge_is_drawn_as_it_is(kind, sigma, prior, validation):
    row = validation(what="thin curved ridges of two parameters: ln Z, means, standard deviations",
                     reference="quadrature", unit="standard errors")
    problem = ridge(kind, sigma, prior)
    rng = np.random.default_rng(3)
    top = maximum_a_posteriori(problem, [problem.parameters.initial])
    approximation = fit_surrogate(problem, top, rng)[0]
    proposal, solved = fitted_proposal(problem, [Proposal(approximation=approximation)], rng)
    found = importance_sample(problem, proposal, rng)
    log_evidence, mean, std = by_quadrature(problem, kind, sigma)
    # several fits together, each part once
    assert sum(isinstance(part, Transport) for part in proposal.components) > 2
    assert len({*map(id, proposal.components)}) == len(proposal.components)
    assert proposal.weight.sum() == pytest.approx(1)
    assert found.effective > 1500 and found.unreached < 2 and solved < 35_000
    # four standard errors, and what the grid along the ridge leaves
    row.error((found.log_evidence - log_evidence) / (found.log_evidence_std + 1e-3), below=4, of="ln Z")
    row.error((found.mean - mean) / found.mean_error, below=4, of="means")
    row.error((found.std - std) / found.std_error, below=4, of="standard deviations")


@pytest.mark.parametrize(("kind", "sigma"), [("series", 1e-4), ("product", 1e-3)])
def test_a_proposal_that_keeps_to_the_maximum_is_no_check(kind, sigma):
    problem = ridge(kind, sigma)
    rng = np.random.default_rng(3)
    top = maximum_a_posteriori(problem, [problem.parameters.initial])
    proposal, _ = fitted_proposal(problem, [Proposal(approximation=fit_surrogate(problem, top, rng)[0])], rng)
    # draws about the maximum that the ridge does not leave
    local = from_laplace(top, problem.parameters).widen(0.05)
    found = importance_sample(problem, replace(proposal, components=(local,), weight=np.ones(1)), rng)
    assert found.unreached > 20 and not found.good
    assert importance_sample(problem, proposal, rng).unreached < 2


@pytest.mark.parametrize("lower", [0.05, -4.0])
def test_the_maps_density_integrates_to_one(lower):
    parameters = Parameters(tuple(Parameter(name=n, unit="-", initial=1.0, std=0.4, lower=lower, upper=9.0)
                                  for n in "ab"))
    problem = ridge("product", 0.05)
    top = maximum_a_posteriori(problem, [problem.parameters.initial])
    rng = np.random.default_rng(1)
    a = np.exp(0.2 * rng.standard_normal(4000))
    theta = np.column_stack([a, np.exp(0.05 * rng.standard_normal(4000)) / a])
    found = fit_transport(theta, np.full(4000, 1 / 4000), from_laplace(top, parameters))
    grid = np.linspace(0.0503, 6.0, 600)
    both = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)
    density = np.exp(found.log_density(both)) * (grid[1] - grid[0]) ** 2
    assert density.sum() == pytest.approx(1.0, abs=5e-3)
    drawn = found.draw(20_000, np.random.default_rng(2))
    value = np.exp(-np.abs(drawn - 1).sum(axis=1))
    expected = density @ np.exp(-np.abs(both - 1).sum(axis=1))
    assert value.mean() == pytest.approx(expected, abs=4 * value.std() / np.sqrt(len(value)) + 2e-3)
    # it bends: a straight Gaussian of these draws has them farther from the ridge
    assert np.std(np.log(drawn[:, 0] * drawn[:, 1])) < 0.1


@pytest.mark.parametrize(("n_param", "most"), [(12, 0.25), (24, 0.5)])
def test_few_draws_leave_a_straight_posterior_straight(n_param, most):
    """4000 draws, of which 2500 count, for 2900 coefficients of 24 numbers: the divergence from the Gaussian that they
    are of was 0.56 and 2.5, most of it chance that the scatter and the middle had followed."""
    rng = np.random.default_rng(n_param)
    root = 0.05 * np.linalg.qr(rng.standard_normal((n_param, n_param)))[0] * np.linspace(1, 0.2, n_param)
    fitted, fresh = rng.standard_normal((2, 4000, n_param))
    weight = np.exp(0.7 * rng.standard_normal(4000))
    straight = TruncatedGaussian(centre=np.ones(n_param), gradient=np.zeros(n_param), lower=np.full(n_param, -9.0),
                                 precision=np.linalg.inv(root.T @ root), upper=np.full(n_param, 9.0))
    like = GaussianApproximation(gaussian=straight, powers=(1,) * n_param, lower=straight.lower, upper=straight.upper,
                                 origin=np.zeros(n_param))
    found = fit_transport(1 + fitted @ root, weight / weight.sum(), like)
    exact = -0.5 * np.sum(fresh**2 + np.log(2 * np.pi), axis=1) - np.linalg.slogdet(root)[1]
    assert 0 < np.mean(exact - found.log_density(1 + fresh @ root)) < most
