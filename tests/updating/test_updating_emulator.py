"""Response surfaces: exact where responses are quadratic, in balance as proposals whatever they miss."""

import emcee
import numpy as np
import pytest
from test_updating_ensemble import COVARIANCE, LIMIT, N_WALKER, PARAMETERS, approximation, exact_draws, target
from updating_cases import LINEAR_HZ, linear_problem

from probupdate.updating import emulator as emulator_module
from probupdate.updating.emulator import FLATTER, EmulatorMove, fit_emulator
from probupdate.updating.ensemble import SubsetMove, SurrogateMove
from probupdate.updating.laplace import maximum_a_posteriori
from probupdate.updating.posterior_file import effective_size
from probupdate.updating.surrogate import from_laplace


def test_linear_responses_are_answered_exactly():
    problem = linear_problem(LINEAR_HZ + 0.05)
    top = maximum_a_posteriori(problem, [problem.parameters.initial])
    emulator = fit_emulator(problem, from_laplace(top, problem.parameters), np.random.default_rng(1))
    theta = np.random.default_rng(2).multivariate_normal(top.theta, top.covariance, 50)
    misfit = problem.misfit(problem.predict_many(theta).response)
    # the ridge on the coefficients leaves this much
    assert emulator.misfit(theta) == pytest.approx(misfit, abs=0.01) and emulator.error < 0.01
    exact = problem.parameters.log_density(theta) - 0.5 * FLATTER * misfit
    assert emulator.log_density(theta) == pytest.approx(exact, abs=0.01)


class _Wrong:
    """A quick density that is not the target: wider, shifted and uncorrelated."""

    def log_density(self, theta):
        value = -0.5 * np.sum((theta - 0.4) ** 2 / (1.8 * np.diag(COVARIANCE)), axis=1)
        return np.where(theta[:, 0] >= PARAMETERS.lower[0], value, -np.inf)


def test_the_move_leaves_a_cut_gaussian_as_it_is(monkeypatch, validation):
    row = validation(what="move on response surfaces, seven moments of a cut Gaussian", reference="exact draws",
                     unit="standard errors")
    monkeypatch.setattr(emulator_module, "SUBSTEPS", 5)
    inner = [(SurrogateMove(approximation(2.0 * COVARIANCE)), 0.3), (SubsetMove(), 0.4), (emcee.moves.DEMove(), 0.3)]
    sampler = emcee.EnsembleSampler(N_WALKER, 3, target, vectorize=True, moves=EmulatorMove(_Wrong(), inner))
    state = emcee.State(exact_draws(N_WALKER), random_state=np.random.RandomState(5).get_state())
    sampler.run_mcmc(state, 500)
    chain, exact = sampler.get_chain()[50:], exact_draws(400_000)
    for power in ((1, 0, 0), (0, 1, 0), (2, 0, 0), (0, 2, 0), (0, 0, 2), (1, 1, 0), (0, 1, 1)):
        values, expected = (np.prod(x ** np.array(power), axis=-1) for x in (chain, exact))
        _, ess = effective_size(values[:, :, None])
        error = np.hypot(values.std() / np.sqrt(ess[0]), expected.std() / np.sqrt(len(exact)))
        row.error((values.mean() - expected.mean()) / error, below=LIMIT)
    assert np.mean(sampler.acceptance_fraction) > 0.3
