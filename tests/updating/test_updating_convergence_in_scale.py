"""A chain whose means agree and whose widths do not has not converged; exchangeable parameters are counted."""

import math
from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import integrate, stats
from updating_cases import LINEAR_PARAMETERS, linear_problem, modal_set

from probupdate.errors import InputError
from probupdate.modal.modes import ModalData
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.functions import FunctionModel
from probupdate.updating.discrepancy import LikelihoodSettings
from probupdate.updating.ensemble import R_HAT_LIMIT, nested_r_hat
from probupdate.updating.exchanges import exchangeable, images_about, orders
from probupdate.updating.importance import N_DRAW, WeightedDraws, agree
from probupdate.updating.laplace import maximum_a_posteriori
from probupdate.updating.problem import Weights, build_problem
from probupdate.updating.runs import sample_posterior
from probupdate.updating.settings import SamplerSettings, UpdateSettings


def test_an_ensemble_of_another_width_shows_in_folded_draws_alone():
    """Four ensembles of eight walkers, one of them 1.5 times as wide about the same middle."""
    rng = np.random.default_rng(3)
    theta = rng.standard_normal((400, 32, 1))
    assert nested_r_hat(np.abs(theta - np.median(theta)), 4)[0] < R_HAT_LIMIT
    theta[:, :8] *= 1.5
    assert nested_r_hat(theta, 4)[0] < R_HAT_LIMIT
    assert nested_r_hat(np.abs(theta - np.median(theta)), 4)[0] > R_HAT_LIMIT


def weighted(std=1.0, pareto_k=0.2):
    theta = std * np.random.default_rng(1).standard_normal((N_DRAW, 3))
    return WeightedDraws(names=("a", "b", "c"), theta=theta, weight=np.full(N_DRAW, 1 / N_DRAW),
                         effective=float(N_DRAW), pareto_k=pareto_k, log_evidence=-1.6, log_evidence_std=0.03,
                         evaluated=N_DRAW, without_modes=0)


def chain(std=1.0, converged=True):
    draws = np.random.default_rng(2).standard_normal((4000, 3)) * [std, 1.0, 1.0]
    size = np.full(3, 1500.0)
    return SimpleNamespace(draws=draws, ess=size, spread_ess=size, converged=converged)


@pytest.mark.parametrize(("std", "agrees"), [(1.0, True), (1.05, True), (1.18, False), (0.8, False)])
def test_standard_deviations_stand_beside_those_of_importance_sampling(std, agrees):
    found = agree(weighted(), chain(std))
    assert found.agrees == agrees and ("THEY DISAGREE" in found.sentence) == (not agrees)
    assert agrees or found.spread_parameter == "a"


def test_a_far_maximum_of_next_to_no_probability_is_no_disagreement():
    """Two hundred standard deviations away with one in a hundred thousand: the standard deviation is 18 % more."""
    near = weighted()
    theta, weight = np.vstack([near.theta, [[200.0, 0.0, 0.0]]]), np.append(near.weight, 1e-5) / (1 + 1e-5)
    assert agree(replace(near, theta=theta, weight=weight), chain()).agrees


@pytest.mark.parametrize(("pareto_k", "converged", "stated"), [
    (0.2, True, True), (0.6, True, True), (0.6, False, False), (0.2, False, True), (0.8, True, False)])
def test_no_evidence_is_stated_by_what_failed(pareto_k, converged, stated):
    found = agree(weighted(pareto_k=pareto_k), chain(converged=converged))
    assert ("ln evidence" in found.sentence) == stated and (found.log_evidence is not None) == stated


def oscillators(items):
    """Four springs whose frequencies come out in ascending order, whichever is whose, and one that is another's."""
    n = len(items)
    model = FunctionModel(
        name="o", parameters=Parameters(items), channels=tuple("abcdefgh"[:n]), version="1",
        function=lambda theta: (np.append(np.sort(np.sqrt(theta[:-1])), 9 + theta[-1]), np.eye(n)))
    data = ModalData(channels=model.channels, sets=(modal_set(np.append(np.linspace(0.8, 1.2, n - 1), 10), np.eye(n)),))
    return build_problem(model, data, weights=Weights(shapes="none"), clusters=[(j,) for j in range(n)])


ALIKE = tuple(Parameter(name=f"k{j}", unit="-", initial=1.0, std=0.3, lower=0.01) for j in range(4))


@pytest.mark.parametrize(("top", "number"), [
    ((0.7, 1.0, 1.3, 1.6, 1.0), 24), ((0.917, 0.917, 1.1, 1.1, 1.0), 6), ((1.0, 1.0, 1.0, 1.0, 1.0), 0)])
def test_images_are_one_for_each_maximum(top, number):
    """Of maxima that coincide, as two parameters are alike there, there are fewer than orders."""
    problem = oscillators((*ALIKE, Parameter(name="z", unit="-", initial=1.0, std=0.3, lower=0.01)))
    at = replace(maximum_a_posteriori(problem, [np.array([0.7, 1.0, 1.3, 1.6, 1.0])]), theta=np.array(top))
    images, words = images_about(problem, at)
    assert (images is None) == (number == 0) and (str(number) in words or not number)
    if images is not None:
        rng = np.random.default_rng(1)
        theta = rng.uniform(0.5, 1.7, (200, 5))
        folded, spread = images.fold(theta), images.spread(theta, rng)
        assert len(images.orders) == number and not np.any(images.nearest(folded))
        assert np.array_equal(images.fold(images.spread(folded, rng)), folded) or number < 24
        assert np.array_equal(np.sort(spread, axis=1), np.sort(theta, axis=1))
        assert len(set(images.nearest(images.spread(np.tile(folded[0], (400, 1)), rng)))) == number


def test_evidence_of_exchangeable_parameters_counts_all_maxima(tmp_path, validation):
    """Five springs whose frequencies say nothing of whose they are: 120 maxima, some of which meet."""
    row = validation(what="five exchangeable parameters, 120 maxima that meet: ln Z", reference="nested quadrature",
                     why="four standard errors", unit="standard deviations stated")
    hz, n = np.sqrt(np.linspace(0.6, 1.4, 5)), 5
    shape = np.linalg.qr(np.random.default_rng(5).standard_normal((n, n)))[0]
    items = tuple(Parameter(name=f"k{j}", unit="-", initial=1.0, std=0.3, lower=0.1, upper=3.0) for j in range(n))
    model = FunctionModel(name="o", parameters=Parameters(items), channels=tuple("abcde"), version="1",
                          function=lambda theta: (np.sqrt(np.sort(theta)), shape))
    data = ModalData(channels=model.channels, sets=(modal_set(hz, shape, std=0.02 * hz),))
    found = sample_posterior(model, data, tmp_path, weights=Weights(shapes="none"),
                             settings=SamplerSettings(target_ess=200, ensembles=2))
    x = np.linspace(0.1, 3.0, 40_001)
    prior = stats.truncnorm(-3.0, 2.0 / 0.3, 1.0, 0.3).pdf(x)
    below = np.ones_like(x)
    for f in hz:
        # of all that lie in ascending order, the last at x
        below = integrate.cumulative_trapezoid(prior * stats.norm.pdf(f, np.sqrt(x), 0.02 * f) * below, x, initial=0.0)
    exact = np.log(below[-1] * math.factorial(n))
    evidence = found.record["evidence"]
    row.error((evidence["log_evidence"] - exact) / evidence["std"], below=4)
    assert found.converged and "120 maxima alike" in " ".join(found.record["statements"])
    # whichever is whose: all have the same marginal
    assert np.ptp(found.draws.mean(axis=0)) < 4 * 0.29 / np.sqrt(found.ess.min())


def test_parameters_that_may_be_exchanged_are_found_and_counted():
    other = Parameter(name="z", unit="-", initial=1.0, std=0.3, lower=0.01)
    problem = oscillators((*ALIKE, other))
    found = exchangeable(problem, problem.parameters.initial)
    assert {frozenset(pair) for (pair,) in found} == {frozenset(p) for p in combinations(["k0", "k1", "k2", "k3"], 2)}
    assert len(orders(found, problem.parameters.names)) == 24
    # so are parameters whose priors are correlated alike, in groups, and not of others
    two = np.kron(np.eye(3), [[0.0, 0.5], [0.5, 0.0]])[:5, :5] + np.eye(5)
    both = replace(problem.model, parameters=Parameters((*ALIKE, other), two))
    found = exchangeable(replace(problem, model=both), problem.parameters.initial)
    assert len(orders(found, problem.parameters.names)) == 8
    # another prior is another parameter
    less = oscillators((*ALIKE[:3], replace(ALIKE[3], std=0.2), other))
    assert len(orders(exchangeable(less, less.parameters.initial), less.parameters.names)) == 6
    assert exchangeable(linear_problem(np.array([1.0, 2, 4, 8, 16])), LINEAR_PARAMETERS.initial) == []


@pytest.mark.parametrize("n_alike", [2, 3])
@pytest.mark.parametrize("at_bound", [False, True])
def test_substructures_built_alike_are_exchanged_with_all_their_parameters(n_alike, at_bound):
    """Two springs a substructure: neither may be exchanged alone, the substructures may, in every order."""
    items = tuple(Parameter(name=f"{which}{j}", unit="-", initial=1.0, std=0.3, lower=0.1, upper=2.0)
                  for j in range(n_alike) for which in ("below", "above"))

    def function(theta):
        below, above = theta[::2], theta[1::2]
        own = [np.linalg.eigvalsh([[b + a, -a], [-a, a]]) for b, a in zip(below, above, strict=True)]
        return np.sqrt(np.sort(np.concatenate(own))), np.eye(2 * n_alike)

    channels = tuple(f"c{k}" for k in range(2 * n_alike))
    model = FunctionModel(name="alike", parameters=Parameters(items), channels=channels, version="1", function=function)
    hz = function(np.linspace(0.8, 1.2, 2 * n_alike))[0]
    problem = build_problem(model, ModalData(channels=channels, sets=(modal_set(hz, np.eye(2 * n_alike)),)),
                            weights=Weights(shapes="none"), clusters=[(j,) for j in range(2 * n_alike)])
    found = exchangeable(problem, np.full(2 * n_alike, 2.0 if at_bound else 1.0))
    assert len(found) == n_alike * (n_alike - 1) // 2 and all(len(one) == 2 for one in found)
    assert len(orders(found, problem.parameters.names)) == {2: 2, 3: 6}[n_alike]


@pytest.mark.parametrize("value", [True, "2", float("nan"), 2.5, None, [2], 0, -1])
@pytest.mark.parametrize("name", ["walkers_per_parameter", "target_ess", "max_steps", "ensembles"])
def test_settings_that_are_no_positive_whole_numbers_are_refused(name, value):
    with pytest.raises(InputError, match=f"{name}: .*(is not a whole number|is below [15])"):
        SamplerSettings(**{name: value})


@pytest.mark.parametrize("settings", [{"alpha": True}, {"alpha": float("nan")}, {"alpha": None}, {"method": 2},
                                      {"iterations": True}, {"iterations": "2"}, {"iterations": float("nan")}])
def test_settings_of_the_update_that_are_no_such_thing_are_refused(settings):
    said = f"{next(iter(settings))}: .* is not a (whole number|finite number or a word|word); the default is "
    with pytest.raises(InputError, match=said):
        UpdateSettings(**settings)


@pytest.mark.parametrize(("name", "value", "words"), [
    ("modes", "FA1", "a tuple of words or whole numbers or None"), ("modes", (1.0,), "a tuple of words"),
    ("fix", "k=1", "a mapping of words to finite numbers"), ("fix", {"k": None}, "a mapping of words to finite"),
    ("fix", {"k": True}, "a mapping"), ("tolerances", "yes", "True or False or None"),
    ("tolerances", 1, "True or False"),
    ("weights", 0.01, "a word, a tuple of finite numbers or Weights"), ("weights", ("a",), "a word, a tuple"),
    ("discrepancy", [0.1], "a finite number, a word or None"), ("discrepancy", float("inf"), "a finite number"),
    ("baseline", "run", "a tuple of "), ("alternatives", "model.toml", "a tuple of "), ("shapes", None, "a word"),
])
def test_a_likelihood_of_other_types_is_refused_in_words(name, value, words):
    with pytest.raises(InputError, match=f"^{name}: .* is not {words}.*; the default is "):
        LikelihoodSettings(**{name: value})


def test_lists_and_numpys_numbers_serve_as_settings():
    found = LikelihoodSettings(weights=[np.float32(0.01)], fix={"k": np.float64(1)}, modes=[np.int64(1), "FA1"],
                               tolerances=True, discrepancy=0)
    assert found.modes == [1, "FA1"]
