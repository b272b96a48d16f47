"""The chain: every move on its own against known variances, the whole against quadrature, resuming, refusals."""

import json
import shutil
from dataclasses import replace

import emcee
import numpy as np
import pytest
from scipy import stats
from updating_cases import LINEAR_HZ, LINEAR_PARAMETERS, linear_data, linear_model, linear_problem

from probupdate.errors import InputError
from probupdate.model.parameters import Parameter, Parameters
from probupdate.runtime.executors import Executor
from probupdate.updating import ensemble
from probupdate.updating.ensemble import PriorMove, SamplerSettings, SubsetMove, SurrogateMove, moves, sample
from probupdate.updating.laplace import maximum_a_posteriori
from probupdate.updating.posterior_file import effective_size
from probupdate.updating.problem import Weights, build_problem
from probupdate.updating.surrogate import GaussianApproximation, TruncatedGaussian, fit_surrogate

# of a z-score: seeds are fixed, and chance exceeds it once in some ten thousand
LIMIT = 4.0
N_PARAM, N_WALKER, N_STEP = 3, 16, 4000
COVARIANCE = np.array([[1.0, 0.8, 0.0], [0.8, 1.0, -0.3], [0.0, -0.3, 0.5]])
LOWER = np.array([-0.7, -np.inf, -np.inf])
PARAMETERS = Parameters(tuple(
    Parameter(name=name, unit="-", initial=0.0, std=2.0, lower=low) for name, low in zip("abc", LOWER, strict=True)
))


def target(theta):
    value = -0.5 * np.einsum("ij,jk,ik->i", theta, np.linalg.inv(COVARIANCE), theta)
    return np.where(theta[:, 0] >= LOWER[0], value, -np.inf)


def approximation(covariance) -> GaussianApproximation:
    gaussian = TruncatedGaussian(
        centre=np.array([0.1, 0.0, 0.0]), gradient=np.zeros(3), precision=np.linalg.inv(covariance), lower=LOWER,
        upper=np.full(3, np.inf),
    )
    return GaussianApproximation(gaussian=gaussian, powers=(1, 1, 1), lower=LOWER, upper=np.full(3, np.inf),
                                 origin=np.zeros(3))


def exact_draws(n):
    free = np.random.default_rng(1).multivariate_normal(np.zeros(3), COVARIANCE, 2 * n)
    return free[free[:, 0] >= LOWER[0]][:n]


CANDIDATES = {
    # a proposal that is not the target: the ratio of densities has to correct for it
    "approximation": SurrogateMove(approximation(1.5 * np.diag(np.diag(COVARIANCE)) + 0.5 * COVARIANCE)),
    "prior": PriorMove(PARAMETERS),
    "subset": SubsetMove(),
    "differential evolution": emcee.moves.DEMove(),
    "jumps": emcee.moves.DEMove(gamma0=1.0),
}


@pytest.mark.parametrize("name", CANDIDATES)
def test_every_move_leaves_a_cut_gaussian_as_it_is(name, validation):
    """Started from exact draws, a chain of this move alone has the exact moments: a move that is not in balance drifts
    from them. Jumps of full length mix with ordinary ones, or walkers would stay on a lattice."""
    row = validation(what="each move alone, seven moments of a cut Gaussian", reference="exact draws",
                     why="emcee's snooker move fails the same check", unit="standard errors")
    move = CANDIDATES[name] if name != "jumps" else [(CANDIDATES[name], 0.5), (emcee.moves.DEMove(), 0.5)]
    sampler = emcee.EnsembleSampler(N_WALKER, N_PARAM, target, vectorize=True, moves=move)
    state = emcee.State(exact_draws(N_WALKER), random_state=np.random.RandomState(5).get_state())
    sampler.run_mcmc(state, N_STEP)
    chain = sampler.get_chain()[N_STEP // 10 :]
    exact = exact_draws(400_000)
    for power in ((1, 0, 0), (0, 1, 0), (2, 0, 0), (0, 2, 0), (0, 0, 2), (1, 1, 0), (0, 1, 1)):
        values, expected = (np.prod(x ** np.array(power), axis=-1) for x in (chain, exact))
        _, ess = effective_size(values[:, :, None])
        error = np.hypot(values.std() / np.sqrt(ess[0]), expected.std() / np.sqrt(len(exact)))
        row.error((values.mean() - expected.mean()) / error, below=LIMIT)


def test_the_balance_test_can_fail():
    """The same check on emcee's snooker move, which leaves another variance behind (why it is not offered)."""
    mixed = [(emcee.moves.DESnookerMove(), 0.7), (emcee.moves.DEMove(), 0.3)]
    sampler = emcee.EnsembleSampler(N_WALKER, N_PARAM, target, vectorize=True, moves=mixed)
    state = emcee.State(exact_draws(N_WALKER), random_state=np.random.RandomState(5).get_state())
    sampler.run_mcmc(state, N_STEP)
    values = sampler.get_chain()[1000:, :, 2] ** 2
    _, ess = effective_size(values[:, :, None])
    assert abs(values.mean() - COVARIANCE[2, 2]) > LIMIT * values.std() / np.sqrt(ess[0])


def test_walkers_that_never_moved_tell_nothing_and_warn_of_nothing():
    chain = np.random.default_rng(1).normal(size=(200, 8, 2))
    chain[:, :, 1] = chain[0, :, 1]
    r_hat, ess = effective_size(chain)
    assert r_hat[0] < 1.05 and ess[0] > 500
    assert r_hat[1] == np.inf and ess[1] == 0


def test_shares_of_the_moves_add_up():
    shares = [share for _, share in moves(PARAMETERS, approximation(COVARIANCE))]
    assert sum(shares) == pytest.approx(1.0) and min(shares) > 0.05


def approximated(problem, seed=0):
    top = maximum_a_posteriori(problem, [problem.parameters.initial])
    return fit_surrogate(problem, top, np.random.default_rng(seed))[0]


# a lognormal, a normal cut close to its middle, and one cut where the data push it
MIXED = Parameters((
    Parameter(name="a", unit="-", initial=1.0, std=0.5, lower=0.2, upper=4.0, prior="lognormal"),
    Parameter(name="b", unit="-", initial=2.0, std=0.3, lower=1.9, upper=2.6),
))
SLOPE = np.array([[0.05, 0.02], [0.10, -0.04], [0.02, 0.20], [0.30, 0.10], [-0.20, 0.50]])


def mixed_problem():
    three = linear_model(slope=np.column_stack([SLOPE, np.zeros(5)]))
    model = linear_model(MIXED, slope=SLOPE)

    def function(theta):
        return three.function(np.append(theta, -1.0))

    data = linear_data(LINEAR_HZ + np.array([0.02, 0.05, -0.04, 0.1, -0.25]), cov=0.02)
    return build_problem(replace(model, function=function), data)


def test_posterior_against_quadrature(tmp_path, validation):
    """Means, standard deviations and 5 and 95 % points of a posterior with a lognormal and two cut priors."""
    row = validation(what="posterior with a lognormal and a cut prior: means, standard deviations",
                     reference="Gauss-Legendre", unit="standard errors")
    problem = mixed_problem()
    chain = sample(problem, approximated(problem), tmp_path / "chain", SamplerSettings(target_ess=1500))
    assert chain.converged, chain.verdict
    node, weight = np.polynomial.legendre.leggauss(120)
    axes = [0.5 * (p.upper + p.lower) + 0.5 * (p.upper - p.lower) * node for p in MIXED]
    a, b = np.meshgrid(*axes, indexing="ij")
    value, _ = problem.log_posterior(np.column_stack([a.ravel(), b.ravel()]))
    density = np.exp(value - value.max()).reshape(a.shape) * np.outer(weight, weight)
    density /= density.sum()
    for k in range(2):
        marginal = density.sum(axis=1 - k)
        mean = marginal @ axes[k]
        std = np.sqrt(marginal @ (axes[k] - mean) ** 2)
        draws, ess = chain.draws[:, k], chain.ess[k]
        row.error((draws.mean() - mean) / std * np.sqrt(ess), below=LIMIT, of="means")
        # of a deviation: kurtosis at most that of an exponential, 9
        row.error((draws.std() / std - 1) / np.sqrt(8 / 4 / ess), below=LIMIT, of="standard deviations")
        below = np.interp(np.quantile(draws, [0.05, 0.95]), axes[k], np.cumsum(marginal) - 0.5 * marginal)
        assert np.all(abs(below - [0.05, 0.95]) < LIMIT * np.sqrt(0.05 * 0.95 / ess) + 2e-3)


def test_a_gaussian_posterior_has_its_closed_form_covariance(tmp_path, validation):
    row = validation(what="posterior of a linear problem, three parameters: means, covariance",
                     reference="closed form", unit="standard errors")
    problem = linear_problem(LINEAR_HZ + np.array([0.03, -0.06, 0.10, 0.15, -0.30]))
    top = maximum_a_posteriori(problem, [problem.parameters.initial])
    chain = sample(problem, approximated(problem), tmp_path / "chain", SamplerSettings(target_ess=2000))
    assert chain.converged, chain.verdict
    white = np.linalg.solve(np.linalg.cholesky(top.covariance), (chain.draws - top.theta).T)
    ess = chain.ess.min()
    row.error(white.mean(axis=1) * np.sqrt(ess), below=LIMIT, of="means")
    row.error((np.cov(white) - np.eye(3)) / np.sqrt(2 / ess), below=LIMIT, of="covariance")
    assert stats.kstest(white[0, :: max(1, white.shape[1] // 500)], "norm").pvalue > 1e-4


SHORT = SamplerSettings(target_ess=10**7, max_steps=3 * ensemble.SEGMENT, ensembles=2)


def test_a_chain_that_would_need_far_too_long_is_given_up(tmp_path):
    problem = linear_problem(LINEAR_HZ + 0.05)
    settings = SamplerSettings(target_ess=10**7, max_steps=2000, ensembles=2)
    chain = sample(problem, approximated(problem), tmp_path / "chain", settings)
    assert len(chain.theta) == 1000 and not chain.converged
    assert "NOT converged" in chain.verdict and "at most 2000 are allowed" in chain.verdict


def test_a_stopped_chain_goes_on_with_the_same_numbers(tmp_path):
    problem = linear_problem(LINEAR_HZ + 0.05)
    surrogate = approximated(problem)
    whole = sample(problem, surrogate, tmp_path / "whole", SHORT)
    assert whole.theta.shape[0] == SHORT.max_steps and not whole.converged and "NOT converged" in whole.verdict
    shutil.copytree(tmp_path / "whole", tmp_path / "part")
    # killed in the third segment: only two are there, and half a file
    (tmp_path / "part" / "segment-00002.npz").rename(tmp_path / "part" / "segment-00002.part")
    part = sample(problem, surrogate, tmp_path / "part", SHORT)
    np.testing.assert_array_equal(part.theta, whole.theta)
    np.testing.assert_array_equal(part.log_posterior, whole.log_posterior)
    again = sample(problem, surrogate, tmp_path / "again", SHORT)
    np.testing.assert_array_equal(again.theta, whole.theta)
    other = sample(problem, surrogate, tmp_path / "other", SamplerSettings(seed=2, target_ess=10**7, max_steps=200))
    assert not np.array_equal(other.theta[:200], whole.theta[:200])


def test_a_finished_chain_is_not_run_again(tmp_path):
    problem = linear_problem(LINEAR_HZ + 0.05)
    surrogate = approximated(problem)
    first = sample(problem, surrogate, tmp_path / "chain", SHORT)

    def refuse(theta):
        raise AssertionError("evaluated again")

    object.__setattr__(problem, "log_posterior", refuse)
    np.testing.assert_array_equal(sample(problem, surrogate, tmp_path / "chain", SHORT).theta, first.theta)


def test_a_signal_amid_the_steps_prints_nothing(tmp_path, capsys):
    problem = linear_problem(LINEAR_HZ + 0.05)
    surrogate, asked = approximated(problem), []

    def interrupted(theta):
        asked.append(len(theta))
        # the starts are asked first, by another
        if len(asked) > 2:
            raise KeyboardInterrupt
        return type(problem).log_posterior(problem, theta)

    object.__setattr__(problem, "log_posterior", interrupted)
    with pytest.raises(KeyboardInterrupt):
        sample(problem, surrogate, tmp_path / "chain", SHORT)
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(("change", "named"), [
    ({"problem": LINEAR_HZ + 0.06}, "another run: the measured modes or the set differ;"),
    ({"settings": SamplerSettings(seed=9)}, "another run: seed is 9 here and 1 there;"),
    ({"settings": SamplerSettings(seed=9, ensembles=2)}, "seed is 9 here and 1 there; ensembles is 2 here and 4 th"),
    ({"weights": Weights(frequency_cov=(0.02,) * 5, shape_std=False)}, "another run: the weights or what is compared"),
    ({"parameters": replace(LINEAR_PARAMETERS.items[0], std=0.6)}, "another run: the prior or bounds differ;"),
])
def test_a_folder_with_another_chain_is_refused_and_what_differs_is_named(tmp_path, change, named, monkeypatch):
    monkeypatch.setattr(ensemble, "SEGMENT", 25)
    problem = linear_problem(LINEAR_HZ + 0.05)
    surrogate = approximated(problem)
    sample(problem, surrogate, tmp_path / "chain", SamplerSettings(target_ess=10**7, max_steps=25))
    other = problem
    if "problem" in change:
        other = linear_problem(change["problem"])
    elif "weights" in change:
        other = build_problem(linear_model(), linear_data(LINEAR_HZ + 0.05), weights=change["weights"])
    elif "parameters" in change:
        other = linear_problem(LINEAR_HZ + 0.05, Parameters((change["parameters"], *LINEAR_PARAMETERS.items[1:])))
    with pytest.raises(InputError) as error:
        sample(other, surrogate, tmp_path / "chain", change.get("settings", SamplerSettings()))
    assert named in str(error.value)


class LastFirst(Executor):
    """Tasks end in another order than they were given in."""

    def as_completed(self, function, tasks, *, least=None):
        yield from (function(*task) for task in reversed(tasks))


def test_ensembles_are_the_same_on_any_executor_and_after_a_kill(tmp_path, monkeypatch, validation):
    row = validation(what="ensembles on another executor, after a kill", reference="one after the other")
    monkeypatch.setattr(ensemble, "SEGMENT", 25)
    problem = linear_problem(LINEAR_HZ + 0.05)
    surrogate = approximated(problem)
    settings = SamplerSettings(target_ess=10**7, max_steps=2 * ensemble.SEGMENT, ensembles=3)
    plain = sample(problem, surrogate, tmp_path / "plain", settings)
    n_walker = plain.theta.shape[1] // 3
    assert plain.theta.shape == (50, 3 * n_walker, 3)
    other = sample(problem, surrogate, tmp_path / "other", settings, jobs=LastFirst())
    row.equal(other.theta, plain.theta)
    row.equal(other.log_posterior, plain.log_posterior)
    # killed in the second round: one ensemble had finished it, another not
    (tmp_path / "plain" / "segment-00001-1.npz").unlink()
    row.equal(sample(problem, surrogate, tmp_path / "plain", settings).theta, plain.theta)
    # the first of several is the one that would run alone, the others are others
    alone = sample(problem, surrogate, tmp_path / "alone", replace(settings, ensembles=1))
    row.equal(plain.theta[:, :n_walker], alone.theta)
    assert not np.array_equal(plain.theta[:, :n_walker], plain.theta[:, n_walker : 2 * n_walker])


@pytest.mark.parametrize("text", ["{", "[]", json.dumps({"format": 1})])
def test_a_damaged_head_is_named(tmp_path, text):
    (tmp_path / "chain.json").write_text(text, encoding="utf-8")
    problem = linear_problem(LINEAR_HZ + 0.05)
    with pytest.raises(InputError, match="chain"):
        sample(problem, approximated(problem), tmp_path, SHORT)


def test_a_damaged_segment_is_named(tmp_path):
    problem = linear_problem(LINEAR_HZ + 0.05)
    surrogate = approximated(problem)
    sample(problem, surrogate, tmp_path, SamplerSettings(target_ess=10**7, max_steps=400))
    (tmp_path / "segment-00001.npz").write_bytes(b"no archive")
    with pytest.raises(InputError, match="segment-00001"):
        sample(problem, surrogate, tmp_path, SamplerSettings(target_ess=10**7, max_steps=400))


@pytest.mark.parametrize("wrong", [{"seed": -1}, {"seed": 1.5}, {"seed": True}, {"target_ess": 0}, {"max_steps": -1}])
def test_settings_that_make_no_sense_are_refused(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        SamplerSettings(**wrong)
