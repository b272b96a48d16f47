"""The model's error that an earlier state of the structure showed, known to the next: against dense Gaussians."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg, sparse, special, stats
from updating_cases import (
    CHAIN_PARAMETERS,
    CHANNELS,
    LEVELS,
    LINEAR_HZ,
    N_LEVEL,
    SLOPE,
    chain_model,
    chain_springs,
    linear_data,
    linear_model,
    modal_set,
)

from probupdate import verbs
from probupdate.errors import InputError
from probupdate.modal.modes import ModalData
from probupdate.model.parameters import Parameter, Parameters
from probupdate.updating.discrepancy import (
    LikelihoodSettings,
    estimate_discrepancy,
    learnt_error,
    weights_by_name,
)
from probupdate.updating.error_states import join_states
from probupdate.updating.laplace import Laplace, maximum_a_posteriori
from probupdate.updating.problem import Problem, build_problem
from probupdate.updating.settings import SamplerSettings
from probupdate.updating.update_file import read_update

STD, MISSED = 1e-3, 0.01
CENTRE = np.array([1.0, 2.0, -1.0])
KNOWN, WIDE = np.array([0.02, 0.01, 0.01]), np.array([0.5, 0.3, 0.2])
OTHER_SLOPE = SLOPE * [1.1, 0.8, 1.3]
PLAIN = LikelihoodSettings(shapes="none", tolerances=False, discrepancy=MISSED)


def parameters(std) -> Parameters:
    return Parameters(tuple(Parameter(name=n, unit="-", initial=c, std=s)
                            for n, c, s in zip("abc", CENTRE, std, strict=True)))


def states(seed: int = 1, n: int = 2) -> list[np.ndarray]:
    """Frequencies of states with parameters of their own, all missed by the same shares; the last is the wide one."""
    rng = np.random.default_rng(seed)
    missed = 1 + MISSED * rng.standard_normal(5)
    found = []
    for k in range(n):
        std, slope = (WIDE, OTHER_SLOPE) if k == n - 1 else (KNOWN, SLOPE)
        found.append((LINEAR_HZ + slope @ (std * rng.standard_normal(3))) * missed
                     + STD * LINEAR_HZ * rng.standard_normal(5))
    return found


def stacked(first: np.ndarray, second: np.ndarray, missed: float, std=KNOWN):
    """Of both states' parameters and of the shares missed: mean, covariance, ln p, by one dense Gaussian."""
    A = np.zeros((10, 11))
    A[:5, :3], A[:5, 6:], A[5:, 3:6], A[5:, 6:] = SLOPE, np.diag(first), OTHER_SLOPE, np.diag(second)
    prior = np.diag(np.concatenate([std, WIDE, np.full(5, missed)]) ** 2)
    r = np.concatenate([first - LINEAR_HZ, second - LINEAR_HZ])
    S = A @ prior @ A.T + np.diag(np.tile(STD * LINEAR_HZ, 2) ** 2)
    gain = prior @ A.T @ np.linalg.inv(S)
    return gain @ r, prior - gain @ A @ prior, -0.5 * r @ np.linalg.solve(S, r) - 0.5 * np.linalg.slogdet(S)[1]


def updated(hz: np.ndarray, std=WIDE, slope=OTHER_SLOPE, likelihood=PLAIN, **options):
    return verbs.update(linear_model(parameters(std), slope), linear_data(hz, cov=STD),
                        likelihood=replace(likelihood, **options))


def test_two_states_are_one_gaussian(validation):
    row = validation(what="update with a baseline: parameters and the model's error", reference="dense Gaussian",
                     unit="posterior standard deviations")
    first, second = states()
    before = updated(first, KNOWN, SLOPE)
    now = updated(second, baseline=(before,))
    mean, covariance, _ = stacked(first, second, MISSED)
    std = np.sqrt(np.diag(covariance))
    row.error((now.map_theta - CENTRE - mean[3:6]) / std[3:6], below=1e-6, of="parameters")
    row.error((now.model_error.mean - mean[6:]) / std[6:], below=1e-6, of="the model's error")
    row.error(np.sqrt(np.diag(now.map_covariance)) / std[3:6] - 1, below=1e-6, of="standard deviations")
    row.error(now.model_error.covariance / np.outer(std, std)[6:, 6:] - covariance[6:, 6:] / np.outer(
        std, std)[6:, 6:], below=1e-6, of="covariance of the error")
    alone = updated(second)
    assert np.all(np.diag(now.map_covariance)[:2] < 0.1 * np.diag(alone.map_covariance)[:2])


def test_scales_are_learnt_from_both_states(validation):
    row = validation(what="update with a baseline whose scale is learnt", reference="quadrature over the scale",
                     unit="posterior standard deviations")
    first, second = states()
    learnt = replace(PLAIN, discrepancy=None)
    now = updated(second, likelihood=learnt, baseline=(updated(first, KNOWN, SLOPE, learnt),))
    grid = np.geomspace(1e-5, 1.0, 1001)
    every = [stacked(first, second, missed) for missed in grid]
    weight = np.array([value for *_, value in every]) + np.log(grid) - np.log1p((grid / 0.01) ** 2)
    weight = np.exp(weight - weight.max()) / np.exp(weight - weight.max()).sum()
    means, variances = np.array([m for m, *_ in every]), np.array([np.diag(c) for _, c, _ in every])
    mean = weight @ means
    std = np.sqrt(weight @ variances + weight @ (means - mean) ** 2)
    row.error((now.map_theta - CENTRE - mean[3:6]) / std[3:6], below=1e-3, of="parameters")
    row.error(np.sqrt(np.diag(now.map_covariance)) / std[3:6] - 1, below=1e-3, of="standard deviations")
    row.error((now.model_error.mean - mean[6:]) / std[6:], below=1e-3, of="the model's error")


# Parameters that are one number in all states

COMMON_STD = np.array([0.5, 0.3, 0.2])


def tied_states(seed: int, common: tuple[int, ...], missed: float = MISSED):
    """Frequencies of two states, in which some parameters are the same number, with other slopes."""
    rng = np.random.default_rng([seed, 3])
    share = 1 + missed * rng.standard_normal(5)
    first, second = COMMON_STD * rng.standard_normal((2, 3))
    second[list(common)] = first[list(common)]
    return second, *((LINEAR_HZ + slope @ theta) * share + STD * LINEAR_HZ * rng.standard_normal(5)
                     for slope, theta in ((SLOPE, first), (OTHER_SLOPE, second)))


def dense_tied(first, second, common: tuple[int, ...], missed: float, correlation=None):
    """Of the second state's parameters: mean, covariance and ln p of both, the parameters of both stacked with those
    in common as one column, by one dense Gaussian."""
    rest = [k for k in range(3) if k not in common]
    A = np.zeros((10, 3 + len(rest) + 5))
    A[5:, :3], A[:5, list(common)], A[:5, 3:3 + len(rest)] = OTHER_SLOPE, SLOPE[:, list(common)], SLOPE[:, rest]
    A[:5, -5:], A[5:, -5:] = np.diag(first), np.diag(second)
    C = np.diag(COMMON_STD**2) if correlation is None else correlation * np.outer(COMMON_STD, COMMON_STD)
    prior = np.zeros((A.shape[1],) * 2)
    prior[:3, :3], prior[-5:, -5:] = C, missed**2 * np.eye(5)
    own = slice(3, 3 + len(rest))
    # the first state's own are as the second's are: correlated with what is common, and by that alone with the second's
    tied = np.ix_(rest, common)
    back = C[tied] @ np.linalg.inv(C[np.ix_(common, common)])
    prior[own, :3] = back @ C[list(common)]
    prior[:3, own] = prior[own, :3].T
    prior[own, own] = C[np.ix_(rest, rest)]
    r = np.concatenate([first - LINEAR_HZ, second - LINEAR_HZ])
    S = A @ prior @ A.T + np.diag(np.tile(STD * LINEAR_HZ, 2) ** 2)
    gain = prior @ A.T @ np.linalg.inv(S)
    return (gain @ r)[:3], (prior - gain @ A @ prior)[:3, :3], -0.5 * r @ np.linalg.solve(S, r) - 0.5 * (
        np.linalg.slogdet(S)[1])


@pytest.mark.parametrize("common", [(2,), (0, 1), (0, 1, 2)])
@pytest.mark.parametrize("correlation", [None, np.array([[1.0, 0.6, 0.2], [0.6, 1.0, -0.3], [0.2, -0.3, 1.0]])])
def test_common_parameters_of_two_states_are_one_gaussian(common, correlation, validation):
    row = validation(what="update with a baseline, some parameters common", reference="dense Gaussian",
                     unit="posterior standard deviations")
    _, first, second = tied_states(1, common)
    given = replace(parameters(COMMON_STD), correlation=correlation)
    before = verbs.update(linear_model(given, SLOPE), linear_data(first, cov=STD), likelihood=PLAIN)
    now = verbs.update(linear_model(given, OTHER_SLOPE), linear_data(second, cov=STD), likelihood=replace(
        PLAIN, baseline=(before,), common=tuple("abc"[k] for k in common)))
    mean, covariance, _ = dense_tied(first, second, common, MISSED, correlation)
    std = np.sqrt(np.diag(covariance))
    row.error((now.map_theta - CENTRE - mean) / std, below=1e-6, of="parameters")
    row.error(now.map_covariance / np.outer(std, std) - covariance / np.outer(std, std), below=1e-6, of="covariance")


def test_scales_are_learnt_with_a_common_parameter(validation):
    row = validation(what="density with a baseline, a parameter common, scale learnt",
                     reference="quadrature over the scale", unit="ln p")
    _, first, second = tied_states(2, (0, 1))
    learnt = replace(PLAIN, discrepancy=None)
    before = updated(first, COMMON_STD, SLOPE, learnt)
    model, data = linear_model(parameters(COMMON_STD), OTHER_SLOPE), linear_data(second, cov=STD)
    weights = replace(learnt, baseline=(before,), common=("a", "b")).stated_for(model, data)
    grid = np.geomspace(1e-5, 1.0, 401)
    every = [dense_tied(first, second, (0, 1), missed) for missed in grid]
    weight = np.array([value for *_, value in every]) + np.log(grid) - np.log1p((grid / 0.01) ** 2)
    mean, covariance, _ = every[int(np.argmax(weight))]
    points = np.random.default_rng(1).multivariate_normal(mean, covariance, 30)
    exact = special.logsumexp([w + stats.multivariate_normal(m, c).logpdf(points)
                               for w, (m, c, _) in zip(weight, every, strict=True)], axis=0)
    off = build_problem(model, data, weights=weights).log_posterior(CENTRE + points)[0] - exact
    row.error(off - off.mean(), below=0.05)


def test_a_chain_of_baselines_holds_all_of_them():
    first, second, third = states(n=3)
    one, other = updated(first, KNOWN, SLOPE), updated(second, KNOWN, SLOPE)
    both = updated(third, baseline=(one, other))
    chain = updated(third, baseline=(updated(second, KNOWN, SLOPE, baseline=(one,)),))
    assert chain.map_theta == pytest.approx(both.map_theta, abs=1e-6)
    assert chain.map_covariance == pytest.approx(both.map_covariance, rel=1e-6)
    assert chain.model_error.states == both.model_error.states


def test_where_nothing_resolves_the_error_intervals_stay_wide():
    """A baseline with an unknown parameter for each frequency shows no error."""
    first, second = states()
    plain = linear_model()
    free = replace(plain, function=lambda theta: (LINEAR_HZ * theta, plain.function(CENTRE)[1][:, :5]), parameters=(
        Parameters(tuple(Parameter(name=f"f{k}", unit="-", initial=1.0, std=1.0) for k in range(5)))))
    vague = verbs.update(free, linear_data(first, cov=STD), likelihood=PLAIN)
    now, alone = updated(second, baseline=(vague,)), updated(second)
    assert np.all(vague.model_error.left > 0.999)
    assert now.map_covariance == pytest.approx(alone.map_covariance, rel=1e-3)
    assert now.map_theta == pytest.approx(alone.map_theta, abs=1e-2 * np.sqrt(np.diag(alone.map_covariance)).min())
    assert "mode 1 0 %" in vague.model_error.resolved_words()


@pytest.mark.long
def test_sample_takes_a_common_parameter_along(tmp_path, validation):
    row = validation(what="emcee with a baseline's file, two parameters common", reference="dense Gaussian",
                     unit="posterior standard deviations")
    _, first, second = tied_states(4, (0, 1))
    updated(first, COMMON_STD, SLOPE).write(tmp_path / "update.json")
    found = verbs.sample(linear_model(parameters(COMMON_STD), OTHER_SLOPE), linear_data(second, cov=STD),
                         tmp_path / "posterior.nc", likelihood=replace(PLAIN, baseline=(tmp_path,), common=("a", "b")),
                         settings=SamplerSettings(target_ess=200))
    mean, covariance, _ = dense_tied(first, second, (0, 1), MISSED)
    std = np.sqrt(np.diag(covariance))
    row.error((found.draws.mean(axis=0) - CENTRE - mean) / std, below=4 / np.sqrt(200), of="means")
    row.error(found.draws.std(axis=0) / std - 1, below=4 / np.sqrt(2 * 200), of="standard deviations")
    assert found.measured.size == found.predicted.shape[1] == len(found.response_labels) == 5
    assert any("one number in all states: a, b" in text for text in found.record["statements"])


@pytest.mark.long
def test_sample_takes_a_baseline_along(tmp_path, validation):
    row = validation(what="emcee with a baseline's file", reference="dense Gaussian",
                     unit="posterior standard deviations")
    first, second = states()
    updated(first, KNOWN, SLOPE).write(tmp_path / "update.json")
    found = verbs.sample(linear_model(parameters(WIDE), OTHER_SLOPE), linear_data(second, cov=STD),
                         tmp_path / "posterior.nc", likelihood=replace(PLAIN, baseline=(str(tmp_path),)),
                         settings=SamplerSettings(target_ess=200))
    mean, covariance, _ = stacked(first, second, MISSED)
    std = np.sqrt(np.diag(covariance))[3:6]
    row.error((found.draws.mean(axis=0) - CENTRE - mean[3:6]) / std, below=4 / np.sqrt(200), of="means")
    row.error(found.draws.std(axis=0) / std - 1, below=4 / np.sqrt(2 * 200), of="standard deviations")
    assert any(text.startswith("baseline ") and "resolve" in text for text in found.record["statements"])
    # the file is the next one's baseline
    again = updated(second + 1e-3, baseline=(tmp_path / "posterior.nc",))
    assert again.model_error.states == ("set 0", "set 0", "set 0")


# A chain whose springs and masses are each off by a share -----------------------------------------------------------

INITIAL = np.array([1.0, 1.0, 1.0, 0.02])
CHAIN_KNOWN, CHAIN_WIDE = np.array([0.005, 0.005, 0.005, 5e-4]), np.array([0.3, 0.1, 0.05, 0.02])
ADDED = 0.5
SHAPES = LikelihoodSettings(tolerances=False)


def model_with(std, added: float = 0.0):
    """A mass added at the top is known."""
    given = Parameters(tuple(replace(p, std=s) for p, s in zip(CHAIN_PARAMETERS, std, strict=True)))
    model = chain_model(given)
    mass = model.mass[0].toarray()
    mass[[N_LEVEL - 1, -1], [N_LEVEL - 1, -1]] += added
    return replace(model, mass=(sparse.csc_array(mass), *model.mass[1:]), hash_key=f"{model.hash_key} {added}")


def measured(theta, springs, masses, rng, added: float = 0.0) -> ModalData:
    """The true chain solved by SciPy, with the noise of identification."""
    base, upper, coupling = np.zeros(N_LEVEL), np.zeros(N_LEVEL), np.zeros(N_LEVEL)
    base[:2], upper[2:], coupling[3] = 200.0, 400.0, 400.0
    K = np.kron(np.diag([1.0, 1.02]), chain_springs((theta[0] * base + theta[1] * upper) * (1 + springs)))
    K += np.kron([[0.0, 1.0], [1.0, 0.0]], chain_springs(theta[3] * coupling))
    mass = 1 + masses
    mass[-1] += 2 * theta[2] + added
    value, vector = linalg.eigh(K, np.kron(np.eye(2), np.diag(mass)))
    hz = np.sqrt(value[:4]) / (2 * np.pi) * (1 + STD * rng.standard_normal(4))
    shape = vector[[N_LEVEL * axis + level for axis in (0, 1) for level in LEVELS], :4]
    shape = shape / np.abs(shape).max(axis=0) + 5e-3 * rng.standard_normal((len(CHANNELS), 4))
    return ModalData(channels=CHANNELS, sets=(
        modal_set(hz, shape, std=STD * hz, shape_std=np.full(shape.shape, 5e-3)),))


def drawn(seed: int):
    """Truth and data of a wide state with a known mass, the baseline's data without."""
    rng = np.random.default_rng([seed, 7])
    springs, masses = 0.03 * rng.standard_normal((2, N_LEVEL))
    before = INITIAL + CHAIN_KNOWN * rng.standard_normal(4)
    now = np.clip(INITIAL + CHAIN_WIDE * rng.standard_normal(4), [0.4, 0.6, 0.7, -0.1], 5.0)
    return now, measured(before, springs, masses, rng), measured(now, springs, masses, rng, ADDED)


def estimated(model, data, known=()) -> tuple[Problem, Laplace]:
    weights = replace(SHAPES, baseline=()).stated_for(model, data) if not known else estimate_discrepancy(
        model, data, weights=replace(weights_by_name("measured", data, tolerances=False), baseline=known))
    problem = build_problem(model, data, weights=weights)
    return problem, maximum_a_posteriori(problem, [INITIAL])


@pytest.mark.long
def test_intervals_of_drawn_chains_hold_the_truth_and_narrow(validation):
    row = validation(what="90 % intervals of 8 drawn chains with a known mass, given a baseline",
                     reference="the truth, solved by SciPy")
    inside, width = [], []
    for seed in range(8):
        truth, first, second = drawn(seed)
        problem, before = estimated(model_with(CHAIN_KNOWN), first)
        known = learnt_error(problem, before.theta)
        assert known is not None
        now, alone = (estimated(model_with(CHAIN_WIDE, ADDED), second, k)[1] for k in ((known,), ()))
        std, other = (np.sqrt(np.diag(x.covariance)) for x in (now, alone))
        inside.append(np.abs(now.theta - truth) < 1.645 * std)
        width.append(std / other)
    # binomial, three standard deviations below nine tenths
    row.count(int(np.sum(inside)), 32, least=int(32 * 0.9 - 3 * np.sqrt(32 * 0.09)))
    assert np.median(width, axis=0)[1] < 0.8 and np.max(np.median(width, axis=0)) < 1.02


def test_errors_of_two_states_correlate_as_their_modes_turn(validation):
    """Springs whose stiffness is off by K^(1/2) X K^(1/2), X symmetric: drawn 20 000 times, solved to first order."""
    row = validation(what="correlation of errors of frequencies between states with and without a mass",
                     reference="drawn errors of stiffness")
    K = np.kron(np.diag([1.0, 1.02]), chain_springs(np.r_[200.0, 200.0, np.full(N_LEVEL - 2, 400.0)]))
    K += np.kron([[0.0, 1.0], [1.0, 0.0]], 0.02 * chain_springs(400.0 * (np.arange(N_LEVEL) == 3)))
    root, rng, share = linalg.sqrtm(K).real, np.random.default_rng(1), []
    for added in (0.0, 8.0):
        mass = np.ones(N_LEVEL)
        mass[-1] += 2 + added
        M = np.kron(np.eye(2), np.diag(mass))
        value, vector = linalg.eigh(K, M)
        share.append(root @ vector[:, :4] / np.sqrt(value[:4]))
    X = rng.standard_normal((20000, *K.shape))
    X = (X + X.transpose(0, 2, 1)) / np.sqrt(2)
    drawn = np.hstack([np.einsum("di,ndk,ki->ni", q, X, q, optimize=True) for q in share])
    problems = []
    for added in (0.0, 8.0):
        model = model_with(CHAIN_KNOWN, added)
        data = measured_modes(model)
        problems.append(build_problem(model, data, weights=replace(
            weights_by_name("measured", data, tolerances=False), discrepancy=0.01, shape_discrepancy=0.0)))
    states = [p.error_origins(INITIAL) for p in problems]
    found = join_states(states, problems[1].model, INITIAL).covariance((1.0, 0.0, 0.0))
    n = len(problems[0].unknowns.names)
    at = [*range(4), *range(n, n + 4)]
    row.error(found[np.ix_(at, at)] - np.corrcoef(drawn.T), below=5 / np.sqrt(20000))


def measured_modes(model) -> ModalData:
    solution = model.solve(INITIAL, 4)
    shape = solution.shape / np.abs(solution.shape).max(axis=0)
    return ModalData(channels=CHANNELS, sets=(modal_set(solution.frequency_hz, shape, std=STD * solution.frequency_hz,
                                                        shape_std=np.full(shape.shape, 5e-3)),))


def test_states_without_turn_have_one_error():
    """A model without matrices is compared at its channels, one with matrices by its stiffness; of either sign."""
    model = model_with(CHAIN_KNOWN)
    data = measured_modes(model)
    problem = build_problem(model, data, weights=replace(weights_by_name("measured", data, tolerances=False),
                                                         discrepancy=0.01, mixing=0.02))
    one = problem.error_origins(INITIAL)
    for other in (one, replace(one, modes=one.modes[:0]), replace(one, modes=-one.modes, first=-one.first,
                                                                  second=-one.second)):
        found = join_states([other, one], model, INITIAL).covariance((0.01, 0.1, 0.02))
        n = len(one.effect)
        np.testing.assert_allclose(found[:n, n:], found[n:, n:], atol=1e-9 * found.max())
        unit = problem.unknowns.unit
        np.testing.assert_allclose(found[n:, n:] * np.outer(unit, unit), problem.error_covariance,
                                   atol=1e-9 * found.max() * unit.max() ** 2)


def test_scale_and_sign_of_a_baselines_shapes_do_not_matter():
    _, first, second = drawn(1)
    one = first.sets[0]
    factor = np.array([-2.0, -2.0, 3.0, 3.0])
    scaled = replace(first, sets=(replace(one, shape=one.shape * factor, shape_std=one.shape_std * np.abs(factor)),))
    found = []
    for data in (first, scaled):
        problem, before = estimated(model_with(CHAIN_KNOWN), data)
        known = learnt_error(problem, before.theta)
        assert known is not None
        found.append(estimated(model_with(CHAIN_WIDE, ADDED), second, (known,))[1])
    std = np.sqrt(np.diag(found[0].covariance))
    assert found[1].theta == pytest.approx(found[0].theta, abs=1e-3 * std.min())
    assert found[1].covariance == pytest.approx(found[0].covariance, rel=1e-3)


# What is refused ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def baseline(tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "update.json"
    updated(states()[0], KNOWN, SLOPE).write(path)
    return path


def test_the_file_holds_the_error_as_it_was(baseline):
    kept, fresh = read_update(baseline).model_error, updated(states()[0], KNOWN, SLOPE).model_error
    for name in ("mean", "covariance", "matrix", "value", "left", "measured"):
        assert getattr(kept, name) == pytest.approx(getattr(fresh, name), rel=1e-8)
    assert kept.names == fresh.names and kept.scales == fresh.scales


def renamed(data: ModalData, labels) -> ModalData:
    return replace(data, labels=labels)


@pytest.mark.parametrize(("change", "words"), [
    ({"hz": lambda first, second: first}, "same data"),
    ({"hz": lambda first, second: 2 * second}, "another structure"),
    ({"labels": ("P", "Q", "R", "S", "T")}, "other modes"),
    ({"tolerances": True}, "tolerances"),
    ({"shapes": "mac"}, "MAC"),
    ({"discrepancy": 0.0}, "states that there is none"),
])
def test_a_baseline_that_does_not_fit_is_refused(baseline, change, words):
    first, second = states()
    data = linear_data(change.get("hz", lambda a, b: b)(first, second), cov=STD)
    data = renamed(data, change["labels"]) if "labels" in change else data
    options = {k: v for k, v in change.items() if k not in ("hz", "labels")}
    with pytest.raises(InputError, match=words):
        verbs.update(linear_model(parameters(WIDE)), data, likelihood=replace(
            PLAIN, baseline=(baseline,), **options))


@pytest.mark.parametrize(("common", "with_baseline", "words"), [
    (("d",), True, "parameter d"), (("a",), False, "there is no baseline")])
def test_a_common_parameter_that_is_none_is_refused(baseline, common, with_baseline, words):
    with pytest.raises(InputError, match=words):
        updated(states()[1], baseline=(baseline,) if with_baseline else (), common=common)


def test_a_parameter_that_the_baseline_held_is_not_common():
    first, second = states()
    before = updated(first, KNOWN, SLOPE, fix={"a": 1.0})
    with pytest.raises(InputError, match="'a' is no parameter of"):
        updated(second, baseline=(before,), common=("a",))


def test_runs_that_hold_the_same_state_are_refused(baseline):
    _, second = states()
    with pytest.raises(InputError, match="holds a state that"):
        updated(second, baseline=(baseline, updated(states()[0] + 1e-3, KNOWN, SLOPE, baseline=(baseline,))))


def test_a_run_without_an_error_of_its_model_is_refused(baseline, tmp_path):
    content = json.loads(baseline.read_text())
    content["model_error"] = None
    (tmp_path / "update.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match="holds no error of its model"):
        updated(states()[1], baseline=(tmp_path,))
    with pytest.raises(InputError, match=r"has no posterior.nc or update.json"):
        updated(states()[1], baseline=(tmp_path.parent,))


def test_views_of_several_sets_take_no_baseline(baseline):
    with pytest.raises(InputError, match="give it to update or sample"):
        verbs.sets(linear_model(), linear_data(np.array(states())), likelihood=replace(PLAIN, baseline=(baseline,)))
