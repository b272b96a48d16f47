"""The ways to compare modes, chosen by name, and a full covariance: each with its derivative and its count of data."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from updating_cases import CHAIN_TRUTH, CHANNELS, chain_model, measured_chain, turned

from probupdate.errors import InputError
from probupdate.modal.modes import CovarianceFactors, ModalData, mac
from probupdate.updating.laplace import maximum_a_posteriori
from probupdate.updating.problem import Weights, build_problem

COV = 0.003
POINTS = [CHAIN_TRUTH, np.array([1.0, 1.0, 1.0, 0.02]), np.array([2.5, 0.8, 1.2, -0.01])]
KINDS = [
    {"frequencies": "log"}, {"shapes": "mac"}, {"shapes": "none"}, {"frequencies": "log", "shapes": "mac"},
    {"covariance": True}, {"covariance": True, "frequencies": "log"}, {"covariance": True, "shapes": "none"},
]


def weights_of(kind: dict, **least_std) -> Weights:
    if kind.get("covariance"):
        return Weights(**kind, **least_std)
    return Weights(frequency_cov=(COV,) * 4, shape_std=False, **kind)


def root_of_noise(n_column=70, seed=4) -> np.ndarray:
    """Standard deviations (4 + 40, n_column) of frequencies' logarithms and of shapes with largest component 1,
    correlated over modes and channels."""
    rng = np.random.default_rng(seed)
    mixed = rng.standard_normal((44, n_column)) / np.sqrt(n_column)
    common = rng.standard_normal((1, n_column)) / np.sqrt(n_column)
    return np.concatenate([COV * (mixed[:4] + common), 0.04 * (mixed[4:] + common)])


def correlated(seed: int, root=None, theta=CHAIN_TRUTH) -> ModalData:
    """The chain's modes with noise of exactly that covariance, which the set states."""
    root = root_of_noise() if root is None else root
    data = measured_chain(theta)
    one = data.sets[0]
    noise = root @ np.random.default_rng(seed).standard_normal(root.shape[1])
    shape = one.shape + noise[4:].reshape(10, 4)
    covariance_factors = CovarianceFactors(
        ln_frequency=root[:4], damping_ratio=np.zeros((4, root.shape[1])),
        shape=root[4:].reshape(10, 4, -1).astype(complex),
    )
    changed = replace(one, frequency_hz=one.frequency_hz * np.exp(noise[:4]), shape=shape,
                      covariance_factors=covariance_factors)
    return replace(data, sets=(changed,))


def problem_of(kind: dict, seed=2, **least_std):
    data = correlated(seed) if kind.get("covariance") else measured_chain(noise=COV, seed=seed)
    return build_problem(chain_model(), data, weights=weights_of(kind, **least_std))


@pytest.mark.parametrize("theta", POINTS)
@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_every_response_has_its_exact_derivative(kind, theta, validation):
    row = validation(what="derivatives of log-frequencies, MACs, joint weights", reference="central differences",
                     why="the differences' own error, of the largest")
    problem = problem_of(kind)
    response, S = problem.sensitivity(theta)
    assert response == pytest.approx(problem.predict(theta), abs=1e-9)
    differences = np.empty_like(S)
    for k, h in enumerate(1e-4 * problem.parameters.std):
        step = h * np.eye(4)[k]
        differences[:, k] = (problem.predict(theta + step) - problem.predict(theta - step)) / (2 * h)
    scale = problem.parameters.std
    error = problem.whiten(((S - differences) * scale).T)
    # truncation goes with the square of the step
    row.error(error / np.max(np.abs(problem.whiten((S * scale).T))), below=1e-5)


@pytest.mark.parametrize("kind", [{}, *KINDS], ids=str)
def test_the_chi_square_at_the_truth_is_the_effective_number_of_data(kind, validation):
    row = validation(what="effective number of data of every kind of response, 80 noises each",
                     reference="chi-square at the truth", unit="standard errors")
    found, n = [], None
    for seed in range(80):
        # floors beside the very noise that was drawn would only count it twice
        problem = problem_of(kind, seed, least_frequency_cov=1e-6, least_shape_std=1e-6)
        n = problem.n_effective
        found.append(problem.misfit(problem.predict(CHAIN_TRUTH)))
    row.error((np.mean(found) - n) / np.std(found) * np.sqrt(len(found)), below=4)


def test_log_frequencies_and_those_in_hz_agree_to_first_order():
    hz, log = (build_problem(chain_model(), measured_chain(noise=COV, seed=2), weights=weights_of(kind))
               for kind in ({}, {"frequencies": "log"}))
    # (f' - f) / (c f) against ln(f' / f) / c, at residuals of a few standard deviations c
    theta = CHAIN_TRUTH * [1.02, 1.005, 1.0, 1.0]
    residual = (hz.measured - hz.predict(theta))[:4] / hz.std[:4]
    assert 0.5 < np.max(np.abs(residual)) < 20
    logs = (log.measured - log.predict(theta))[:4] / log.std[:4]
    assert logs == pytest.approx(residual, abs=np.max(residual**2) * COV)


def test_macs_misfit_is_one_minus_mac_over_its_expectation():
    model, sigma = chain_model(asymmetry=0.5), 10 * COV
    data = measured_chain(n_mode=3, noise=COV, model=model)
    weights = Weights(frequency_cov=(COV,) * 3, shape_std=False, shapes="mac")
    problem = build_problem(model, data, weights=weights, clusters=[(0,), (1,), (2,)])
    computed = model.solve(POINTS[1], 3)
    misfit = problem.misfit(problem.predict(POINTS[1]))
    measured = data.sets[0]
    expected = np.sum(((measured.frequency_hz - computed.frequency_hz) / (COV * measured.frequency_hz)) ** 2)
    for j in range(3):
        x = measured.shape[:, j].real / np.max(np.abs(measured.shape[:, j]))
        # of noise sigma on each component the part across x counts
        expected += (1 - mac(x, computed.shape[:, j])[0, 0]) / (9 * sigma**2 / (x @ x))
    assert misfit == pytest.approx(expected, rel=1e-9)
    assert problem.n_effective == 6


def test_without_shapes_only_frequencies_count():
    problem = problem_of({"shapes": "none"})
    assert problem.measured.size == problem.n_effective == 4
    assert problem.predict(CHAIN_TRUTH) == pytest.approx(chain_model().solve(CHAIN_TRUTH, 4).frequency_hz)


def test_as_components_close_modes_stand_alone_and_turned_ones_are_left_out():
    data = measured_chain(noise=COV)
    problem = build_problem(chain_model(), data, weights=weights_of({"shapes": "components"}))
    assert problem.matching.pairs == () and problem.n_effective == 4 + 4 * 9
    one, left_out = data.sets[0], 0
    for angle in np.linspace(0, np.pi, 24, endpoint=False):
        bent = replace(data, sets=(replace(one, shape=turned(one.shape, (0, 1), angle)),))
        assert build_problem(chain_model(), bent, weights=weights_of({})).matching.pairs
        alone = build_problem(chain_model(), bent, weights=weights_of({"shapes": "components"})).matching
        left_out += any("as planes" in sentence for sentence in alone.left_out)
    # where a shape stands at 45 degrees to the computed ones; elsewhere it is paired
    assert 1 <= left_out <= 9


def test_the_joint_weights_are_the_inverse_covariance_across_the_planes():
    problem = problem_of({"covariance": True})
    root = root_of_noise()
    one = correlated(2).sets[0]
    # by hand for the frequencies alone: their marginal covariance with the floor
    covariance = np.linalg.inv(problem.root @ problem.root.T)
    wanted = root[:4] @ root[:4].T + problem.weights.least_frequency_cov**2 * np.eye(4)
    order = list(problem.used)
    inner = np.linalg.pinv(problem.root.T @ problem.root, rcond=1e-12)[:4, :4]
    assert inner == pytest.approx(wanted[np.ix_(order, order)] * np.outer(*2 * [one.frequency_hz[order]]), rel=1e-6)
    assert covariance.shape == (4 + 2 * 2 * 8,) * 2
    assert problem.n_effective == len(problem.root)
    theta = POINTS[1]
    value = problem.log_likelihood(theta)[0]
    whitened = problem.whiten(problem.measured - problem.predict(theta))
    log_det = -np.linalg.slogdet(problem.root @ problem.root.T)[1]
    assert value == pytest.approx(stats.norm.logpdf(whitened).sum() - 0.5 * log_det, rel=1e-10)


def test_a_pair_and_its_deviations_turned_in_their_plane_change_nothing():
    data = correlated(3)
    one = data.sets[0]
    size = np.max(np.abs(one.shape), axis=0)
    shape, spread = one.shape / size, one.covariance_factors.shape / size[None, :, None]
    angle = 0.6
    c, s = np.cos(angle), np.sin(angle)
    turn = np.eye(4)
    turn[:2, :2] = [[c, -s], [s, c]]
    # the plane's basis is set up from shapes of equal largest component: rescale neither
    other = replace(one, shape=shape @ turn,
                    covariance_factors=replace(one.covariance_factors, shape=np.einsum("cjp,jk->ckp", spread, turn)))
    a, b = (build_problem(chain_model(), replace(data, sets=(x,)), weights=Weights(covariance=True))
            for x in (one, other))
    for theta in POINTS:
        # turned shapes have other largest components, by which the floor of 2 % is measured
        assert b.misfit(b.predict(theta)) == pytest.approx(a.misfit(a.predict(theta)), rel=0.1)


def test_uncorrelated_deviations_give_the_posterior_of_independent_weights(validation):
    """The same variances as a covariance and as deviations: nearly the same maximum, as both describe one noise."""
    row = validation(what="joint weights of uncorrelated standard deviations: maximum, width over the posterior's",
                     reference="independent weights", why="to first order")
    rng_free = np.zeros((44, 44))
    rng_free[np.arange(4), np.arange(4)] = COV
    rng_free[np.arange(4, 44), np.arange(4, 44)] = 0.04
    data = correlated(5, rng_free)
    joint = build_problem(chain_model(), data,
                          weights=Weights(covariance=True, least_frequency_cov=1e-6, least_shape_std=1e-6))
    std = Weights(frequency_cov=(COV,) * 4, shape_std=False, shape_factor=0.04 / COV)
    plain = build_problem(chain_model(), data, weights=std)
    a, b = (maximum_a_posteriori(p, [CHAIN_TRUTH]) for p in (joint, plain))
    covariance_factors = np.sqrt(np.diag(b.covariance))
    row.error((a.theta - b.theta) / covariance_factors, below=0.1, of="maximum")
    row.error(np.sqrt(np.diag(a.covariance)) / covariance_factors - 1, below=0.05, of="width")
    assert a.misfit == pytest.approx(b.misfit, rel=0.05)


def test_a_covariance_needs_the_sets_deviations():
    with pytest.raises(InputError, match="no covariance factors"):
        build_problem(chain_model(), measured_chain(), weights=Weights(covariance=True))


@pytest.mark.parametrize("wrong", [
    {"frequencies": "rad"}, {"shapes": "MAC"}, {"least_shape_std": 0.0}, {"covariance": True, "frequency_cov": (0.01,)},
    {"covariance": True, "shapes": "mac"},
])
def test_what_makes_no_sense_is_refused(wrong):
    with pytest.raises(InputError):
        Weights(**wrong)


def test_other_responses_are_another_problem():
    assert len({problem_of(kind).fingerprint() for kind in [{}, *KINDS]}) == len(KINDS) + 1
    assert len(CHANNELS) == 10


def test_weights_are_read_back_from_plain_numbers():
    """posterior.nc keeps them, so that export and the sampler have one likelihood."""
    weights = Weights(discrepancy=0.004, mixing=0.01, tolerances=True, at=(1.0, 0.5), frequency_cov=(0.01, 0.02),
                      scales=((0.003, 0.01, 0.0, -0.4), (0.005, 0.02, 0.01, -1.2)), discrepancy_by="learnt")
    again = Weights.from_table(json.loads(json.dumps(weights.to_table())))
    assert again.to_table() == weights.to_table() and again.scales == weights.scales and again.at == weights.at
