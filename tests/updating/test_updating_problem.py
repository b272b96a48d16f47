"""Responses, weights and densities of the one problem every estimator solves, each by a second route."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg, sparse, stats
from small_turbine import small_turbine
from updating_cases import (
    CHAIN_PARAMETERS,
    CHAIN_TRUTH,
    CHANNELS,
    LINEAR_HZ,
    chain_model,
    chain_problem,
    linear_data,
    linear_model,
    linear_problem,
    measured_chain,
    modal_set,
    turned,
)

from probupdate.errors import InputError
from probupdate.modal.modes import ModalData
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.description_file import parse_description
from probupdate.structure.load import load_model, reference_model, turbine_model
from probupdate.updating.problem import Weights, build_problem, paper_weights

PAPER = Weights(frequency_cov=(0.015, 0.015, 0.017, 0.017), shape_std=False)
POINTS = [CHAIN_TRUTH, CHAIN_PARAMETERS.initial, np.array([2.5, 0.8, 1.2, -0.01])]


def with_set(data: ModalData, **changes) -> ModalData:
    """The data with one field of its only set changed."""
    return replace(data, sets=(replace(data.sets[0], **changes),))


# the responses


def test_single_modes_are_fitted_by_the_best_scale_of_the_computed_shape():
    model, theta = chain_model(asymmetry=0.5), np.array([0.9, 1.02, 1.0, 0.03])
    data = measured_chain(theta, n_mode=3, noise=0.01, model=model)
    problem = build_problem(model, data, clusters=[(0,), (1,), (2,)], weights=Weights(shape_std=False))
    measured = data.sets[0]
    response, computed = problem.predict(CHAIN_TRUTH), model.solve(CHAIN_TRUTH, 3)
    for j in range(3):
        x = measured.shape[:, j].real / measured.shape[np.argmax(np.abs(measured.shape[:, j])), j].real
        y = computed.shape[:, j]
        rows = slice(3 + 10 * j, 13 + 10 * j)
        assert problem.measured[rows] == pytest.approx(x)
        assert response[rows] == pytest.approx(y * (x @ y) / (y @ y))
    assert response[:3] == pytest.approx(computed.frequency_hz)
    assert problem.n_effective == 33 - 3


def test_a_pair_is_the_projection_of_the_measured_plane_onto_the_computed_one():
    problem = chain_problem(weights=PAPER)
    response, computed = problem.predict(CHAIN_TRUTH), chain_model().solve(CHAIN_TRUTH, 4)
    assert [sorted(pair) for pair in problem.matching.pairs] == [[0, 1], [2, 3]]
    for k, pair in enumerate(((0, 1), (2, 3))):
        rows = slice(4 + 20 * k, 24 + 20 * k)
        basis = problem.measured[rows].reshape(2, 10).T
        assert basis.T @ basis == pytest.approx(np.eye(2) * (basis[:, 0] @ basis[:, 0]), abs=1e-12)
        assert np.max(np.linalg.norm(basis, axis=1)) == pytest.approx(1.0)
        plane = computed.shape[:, list(pair)]
        projected = plane @ np.linalg.lstsq(plane, basis, rcond=None)[0]
        assert response[rows] == pytest.approx(projected.T.ravel(), abs=1e-10)
    assert problem.n_effective == 44 - 8


def test_one_and_many_parameter_vectors_are_answered_alike():
    problem = chain_problem()
    many = problem.predict_many(np.array(POINTS))
    for theta, row in zip(POINTS, many.response, strict=True):
        assert problem.predict(theta) == pytest.approx(row, abs=1e-12)
        assert problem.sensitivity(theta)[0] == pytest.approx(row, abs=1e-9)
    assert not many.fallback.any()


def test_the_chi_square_of_a_true_model_is_the_number_of_effective_responses(validation):
    # noise drawn by the very standard deviations that are assumed: mean of chi-square within four of its standard
    # errors
    row = validation(what="chi-square of a true model, 120 noises", reference="number of effective responses",
                     unit="standard errors")
    model, cov = chain_model(), 0.003
    weights = Weights(frequency_cov=(cov,) * 4, shape_std=False)
    found = []
    for seed in range(120):
        problem = build_problem(model, measured_chain(noise=cov, seed=seed), weights=weights)
        found.append(problem.misfit(problem.predict(CHAIN_TRUTH)))
    n = problem.n_effective
    row.error((np.mean(found) - n) / np.sqrt(2 * n / len(found)), below=4)
    assert np.std(found) == pytest.approx(np.sqrt(2 * n), rel=0.3)


def test_a_callable_may_give_no_more_modes_than_were_measured():
    whole = linear_model()
    model = replace(whole, function=lambda theta: tuple(a[..., :5] for a in whole.function(theta)))
    data = linear_data(LINEAR_HZ * 1.01)
    problem, wide = build_problem(model, data), build_problem(whole, data)
    assert problem.matching.n_mode == 5 and wide.matching.n_mode == 6
    theta = np.array([1.2, 2.1, -1.1])
    assert problem.predict(theta) == pytest.approx(wide.predict(theta), abs=1e-12)
    assert problem.sensitivity(theta)[1] == pytest.approx(wide.sensitivity(theta)[1], abs=1e-6)


def test_a_model_of_few_degrees_of_freedom_is_searched_as_far_as_it_goes():
    # a small model is solved dense: each of its six degrees of freedom gives a mode
    full, small = chain_model(), 6
    pick = sparse.csr_array(np.eye(small))
    cut = [tuple(sparse.csc_array(m.toarray()[:small, :small]) for m in ms) for ms in (full.stiffness, full.mass)]
    model = replace(full, stiffness=cut[0], mass=cut[1], channel_matrix=pick, channels=tuple("abcdef"), hash_key="six")
    assert model.n_available == 6
    solution = model.solve(CHAIN_TRUTH, 2)
    data = ModalData(channels=model.channels, sets=(modal_set(solution.frequency_hz, solution.shape),))
    problem = build_problem(model, data)
    assert problem.misfit(problem.predict(CHAIN_TRUTH)) < 1e-12


# standard deviations


def test_paper_weights_are_told_by_label_or_by_frequency():
    labels = ("FA1", "SS1", "T1", "FA2", "SS2")
    frequency = np.array([0.32, 0.33, 1.2, 1.9, 2.0])
    assert paper_weights(labels, frequency).frequency_cov == (0.015, 0.015, 0.017, 0.017, 0.017)
    assert paper_weights((), frequency).frequency_cov == (0.015, 0.015, 0.017, 0.017, 0.017)


def test_a_shape_component_deviates_by_ten_times_the_frequencys_cov_of_the_largest_component():
    problem = chain_problem(weights=PAPER)
    frequency = problem.measured[:4]
    assert problem.std[:4] == pytest.approx(frequency * [0.015, 0.015, 0.017, 0.017])
    # every component of the first pair, also those near zero
    assert problem.std[4:24] == pytest.approx(np.full(20, 0.15))
    assert problem.std[24:] == pytest.approx(np.full(20, 0.17))


def test_deviations_of_the_file_follow_the_scale_of_the_shape_and_have_a_floor():
    model = chain_model(asymmetry=0.5)
    data = measured_chain(CHAIN_TRUTH, n_mode=2, model=model)
    std = np.full((10, 2), 0.05)
    std[2], std[3], std[4] = 0.0, 0.3, np.nan
    weights = Weights()
    scaled = with_set(data, shape=data.sets[0].shape * -7.0, shape_std=std * 7.0)
    problem = build_problem(model, scaled, weights=weights, clusters=[(0,), (1,)])
    sigma = problem.std[2:].reshape(2, 10)
    wanted = np.full(10, 0.05)
    # no standard deviation of the file: ten times the frequency's, which is 1 %
    wanted[2], wanted[3], wanted[4] = 0.02, 0.3, 0.1
    assert sigma == pytest.approx(np.array([wanted, wanted]))


def test_a_frequency_without_deviation_is_asked_for():
    data = measured_chain(std=np.array([0.01, np.nan, 0.01, 0.01]))
    with pytest.raises(InputError, match="frequency_std_hz of mode 2: is missing or not above zero"):
        build_problem(chain_model(), data)
    assert build_problem(chain_model(), data, weights=PAPER).measured.size == 44


def test_covs_that_do_not_fit_the_modes_and_impossible_deviations_are_refused():
    with pytest.raises(InputError, match="2 given for 4 modes"):
        chain_problem(weights=Weights(frequency_cov=(0.01, 0.01), shape_std=False))
    bad = np.full((10, 4), 0.05)
    bad[3, 1] = -0.05
    with pytest.raises(InputError, match="shape_std"):
        chain_problem(shape_std=bad)
    for cov in (0.0, -0.01, np.nan):
        with pytest.raises(InputError, match="frequency CoV"):
            chain_problem(weights=Weights(frequency_cov=(0.01, cov, 0.01, 0.01), shape_std=False))


def test_a_pair_of_equal_shapes_or_a_zero_shape_is_refused():
    data = measured_chain()
    shape = np.array(data.sets[0].shape)
    shape[:, 1] = 2 * shape[:, 0]
    with pytest.raises(InputError, match="span no plane"):
        build_problem(chain_model(), with_set(data, shape=shape))
    with pytest.raises(InputError, match="the shape of mode 3 is zero at every channel"):
        build_problem(chain_model(), with_set(data, shape=data.sets[0].shape * [1, 1, 0, 1]))


# invariance to what no measurement determines


@pytest.mark.parametrize("weights", [PAPER, Weights()])
def test_sign_phase_and_scale_of_measured_shapes_do_not_matter(weights):
    data = measured_chain(noise=0.004, seed=2, shape_std=np.full((10, 4), 0.04))
    factor = np.array([-1.0, 3.0 * np.exp(0.7j), 0.2j, -5.0 * np.exp(2.0j)])
    other = with_set(data, shape=data.sets[0].shape * factor, shape_std=data.sets[0].shape_std * np.abs(factor))
    a, b = (build_problem(chain_model(), d, weights=weights) for d in (data, other))
    theta = np.array(POINTS)
    assert b.misfit(b.predict_many(theta).response) == pytest.approx(a.misfit(a.predict_many(theta).response), rel=1e-8)


@pytest.mark.parametrize("angle", [0.2, np.pi / 4, 1.3, 2.5])
def test_a_measured_pair_turned_in_its_plane_changes_no_misfit_and_no_sensitivity_norm(angle):
    data = measured_chain(noise=0.004, seed=2)
    # shapes orthogonal and of one length, so that turning them keeps what a standard deviation of the largest component
    # means
    shape = np.array(data.sets[0].shape)
    for pair in ([0, 1], [2, 3]):
        shape[:, pair] = linalg.orth(shape[:, pair])
    data = with_set(data, shape=shape)
    other = with_set(data, shape=turned(turned(shape, (0, 1), angle), (2, 3), -angle))
    a, b = (build_problem(chain_model(), d, weights=PAPER) for d in (data, other))
    theta = np.array(POINTS)
    assert b.std == pytest.approx(a.std)
    assert b.misfit(b.predict_many(theta).response) == pytest.approx(a.misfit(a.predict_many(theta).response), rel=1e-8)
    normal = []
    for problem in (a, b):
        response, S = problem.sensitivity(CHAIN_TRUTH)
        W = np.diag(1 / problem.std**2)
        normal.append(np.column_stack([S.T @ W @ S, S.T @ W @ (problem.measured - response)]))
    assert normal[1] == pytest.approx(normal[0], rel=1e-7, abs=1e-7 * np.max(np.abs(normal[0])))


def test_the_models_own_rotation_in_a_pair_does_not_matter():
    # twist turns the computed pair from x, y towards the diagonals; data of the plane alone must hardly notice
    model = chain_model(asymmetry=1e-4)
    data = measured_chain([0.7, 1.06, 0.97, 0.0], model=model)
    problem = build_problem(model, data, weights=PAPER)
    straight, diagonal = np.array([0.7, 1.06, 0.97, 0.0]), np.array([0.7, 1.06, 0.97, 0.01])
    shapes = [model.solve(theta, 2).shape for theta in (straight, diagonal)]
    # the single shapes turn by tens of degrees: compared one by one they would miss by many standard deviations
    assert np.max(np.abs(shapes[0] - shapes[1])) > 0.5 * np.max(np.abs(shapes[0]))
    difference = problem.predict(diagonal) - problem.predict(straight)
    assert np.max(np.abs(difference[4:] / problem.std[4:])) < 0.05
    assert problem.predict_many(diagonal).mac == pytest.approx(np.ones((1, 4)), abs=1e-3)


# sensitivity


def central_differences(problem, theta, step):
    S = np.empty((problem.measured.size, len(theta)))
    for k, h in enumerate(step * problem.parameters.std):
        up, down = theta.copy(), theta.copy()
        up[k] += h
        down[k] -= h
        S[:, k] = (problem.predict(up) - problem.predict(down)) / (2 * h)
    return S


@pytest.mark.parametrize("theta", POINTS)
@pytest.mark.parametrize("weights", [PAPER, Weights()])
def test_sensitivity_is_the_central_difference_of_the_responses(theta, weights, validation):
    row = validation(what="sensitivities of all responses, with pairs", reference="central differences",
                     why="the differences' own error, of the largest")
    sigma = np.random.default_rng(4).uniform(0.03, 0.2, (10, 4))
    problem = chain_problem(weights=weights, noise=0.02, shape_std=sigma)
    _, S = problem.sensitivity(theta)
    # in standard deviations of the response for a prior standard deviation of the parameter; truncation goes with the
    # step squared
    scale = problem.parameters.std / problem.std[:, None]
    error = (S - central_differences(problem, theta, 1e-4)) * scale
    row.error(error / np.max(np.abs(S * scale)), below=1e-5)


def test_sensitivity_holds_where_a_pair_is_almost_degenerate():
    # frequencies 1e-6 apart: single shape derivatives are a million times larger than the plane's
    model, theta = chain_model(asymmetry=2e-6), np.array([0.8, 1.0, 1.0, 0.0])
    problem = build_problem(model, measured_chain(noise=0.005), weights=PAPER)
    _, S = problem.sensitivity(theta)
    single = model.solve(theta, 5, derivatives=True).shape_derivative
    assert np.max(np.abs(single[:, :2])) > 1e3 * np.max(np.abs(S[4:]))
    # parameters that keep the symmetry: their frequencies do not kink
    error = (S - central_differences(problem, theta, 1e-3))[:, :3]
    assert np.max(np.abs(error)) < 1e-5 * np.max(np.abs(S))


def test_sensitivity_on_a_turbine_of_beams(validation):
    row = validation(what="the same on a turbine of beams", reference="central differences",
                     why="the differences' own error, of the largest")
    model = turbine_model(parse_description(small_turbine(), "small"), where="small")
    theta = model.parameters.initial.copy()
    solution = model.solve(theta * 1.03, 5)
    data = ModalData(channels=model.channels, sets=(modal_set(solution.frequency_hz, solution.shape),))
    problem = build_problem(model, data, weights=Weights(frequency_cov=(0.015,) * 5, shape_std=False))
    _, S = problem.sensitivity(theta)
    scale = problem.parameters.std / problem.std[:, None]
    error = (S - central_differences(problem, theta, 1e-3)) * scale
    row.error(error / np.max(np.abs(S * scale)), below=1e-5)


def test_the_reference_turbine_pairs_its_own_modes_with_misfit_zero():
    model = load_model(reference_model("as_built"))
    solution = model.solve(model.parameters.initial, 5)
    shape = turned(solution.shape, (0, 1), 0.6)
    data = ModalData(channels=model.channels, sets=(modal_set(solution.frequency_hz, shape),))
    problem = build_problem(model, data)
    assert problem.matching.computed == (0, 1, 2, 3, 4)
    assert problem.misfit(problem.predict(model.parameters.initial)) < 1e-10
    assert problem.matching.left_out == ()


# densities


def test_misfit_is_the_quadratic_form_of_the_paper():
    problem = chain_problem()
    for theta in POINTS:
        response = problem.predict(theta)
        residual = problem.measured - response
        W = np.linalg.inv(np.diag(problem.std**2))
        assert problem.misfit(response) == pytest.approx(residual @ W @ residual)


def test_log_posterior_is_scipys_prior_times_scipys_likelihood(validation):
    row = validation(what="log posterior", reference="scipy's prior times scipy's likelihood", why="rounding")
    parameters = Parameters((
        Parameter(name="base", unit="-", initial=1.0, std=1.0, lower=0.05, upper=6.0, prior="lognormal"),
        Parameter(name="upper", unit="-", initial=1.0, std=0.3, lower=0.8, upper=2.0),
        Parameter(name="top", unit="-", initial=1.0, std=0.05),
        Parameter(name="twist", unit="-", initial=0.02, std=0.02, lower=0.0),
    ))
    problem = build_problem(chain_model(parameters), measured_chain(noise=0.004))
    theta = np.array([[0.7, 1.06, 0.97, 0.035], [1.4, 0.81, 1.02, 0.001]])
    # lognormal of median 1 and standard deviation 1: e^{s^2} (e^{s^2} - 1) = 1, the golden ratio
    s = np.sqrt(np.log((1 + np.sqrt(5)) / 2))
    base = stats.lognorm(s, scale=1.0)
    cut = np.log(base.cdf(6.0) - base.cdf(0.05))
    likelihood = stats.multivariate_normal(problem.measured, np.diag(problem.std**2))
    for point, (value, _) in zip(theta, (problem.log_posterior(t) for t in theta), strict=True):
        prior = (
            base.logpdf(point[0]) - cut
            + stats.truncnorm.logpdf(point[1], (0.8 - 1) / 0.3, (2.0 - 1) / 0.3, 1.0, 0.3)
            + stats.norm.logpdf(point[2], 1.0, 0.05)
            + stats.truncnorm.logpdf(point[3], -1.0, np.inf, 0.02, 0.02)
        )
        data = likelihood.logpdf(problem.predict(point))
        row.error(problem.log_likelihood(point)[0] / data - 1, below=1e-10)
        row.error(value[0] / (prior + data) - 1, below=1e-10)


def test_outside_the_bounds_the_density_is_zero_and_the_model_is_not_asked():
    problem = linear_problem([1.0, 2.0, 4.0, 8.0, 16.0], Parameters((
        Parameter(name="a", unit="-", initial=1.0, std=0.5, lower=0.0),
        Parameter(name="b", unit="-", initial=2.0, std=0.3),
        Parameter(name="c", unit="-", initial=-1.0, std=0.2),
    )))
    value, fallback = problem.log_posterior(np.array([[-1e-9, 2.0, -1.0], [1.0, 2.0, -1.0]]))
    assert value[0] == -np.inf and np.isfinite(value[1]) and not fallback.any()


# what was not measured


def test_components_not_measured_are_left_out_of_their_group_only():
    data = measured_chain(noise=0.004)
    shape = np.array(data.sets[0].shape)
    shape[[1, 6], 0] = np.nan
    part = build_problem(chain_model(), with_set(data, shape=shape), weights=PAPER)
    whole = build_problem(chain_model(), data, weights=PAPER)
    assert [g.rows.size for g in part.groups] == [8, 10]
    assert 1 not in part.groups[0].rows and 6 not in part.groups[0].rows
    a, b = part.predict(CHAIN_TRUTH), whole.predict(CHAIN_TRUTH)
    assert a.size == b.size - 4
    assert a[-20:] == pytest.approx(b[-20:])
    assert part.measured[-20:] == pytest.approx(whole.measured[-20:])


def test_dropping_a_channel_is_the_same_as_not_measuring_it():
    data = measured_chain(noise=0.004)
    keep = [k for k in range(10) if k != 6]
    shape = np.array(data.sets[0].shape)
    shape[6] = np.nan
    fewer = ModalData(
        channels=tuple(CHANNELS[k] for k in keep),
        sets=(modal_set(data.sets[0].frequency_hz, data.sets[0].shape[keep]),),
    )
    a = build_problem(chain_model(), fewer, weights=PAPER)
    b = build_problem(chain_model(), with_set(data, shape=shape), weights=PAPER)
    assert a.measured == pytest.approx(b.measured, abs=1e-12)
    assert a.fingerprint() == b.fingerprint()


def test_a_mode_missing_in_a_set_leaves_the_others_responses():
    frequency = np.array([1.01, 2.02, np.nan, 8.1, 16.1])
    problem = linear_problem(frequency)
    whole = linear_problem([1.01, 2.02, 4.0, 8.1, 16.1])
    assert problem.used == (0, 1, 3, 4)
    assert problem.matching.left_out == ("mode 3 was not identified in set set 0",)
    assert problem.measured[:4] == pytest.approx(whole.measured[[0, 1, 3, 4]])
    S, all_of_it = problem.sensitivity(problem.parameters.initial)[1], whole.sensitivity(whole.parameters.initial)[1]
    assert S[:4] == pytest.approx(all_of_it[[0, 1, 3, 4]])


# the fingerprint


def fingerprint_of(data, model=None, weights=PAPER, **options):
    return build_problem(model or chain_model(), data, weights=weights, **options).fingerprint()


def test_the_fingerprint_is_deaf_to_what_changes_no_density():
    data = measured_chain(noise=0.004)
    one = data.sets[0]
    kept = fingerprint_of(data)
    assert fingerprint_of(measured_chain(noise=0.004)) == kept
    assert fingerprint_of(with_set(data, damping_ratio=[0.02] * 4)) == kept
    assert fingerprint_of(with_set(data, environment={"water_level_m": 0.4})) == kept
    assert fingerprint_of(with_set(data, shape_std=np.full((10, 4), 0.1))) == kept
    assert fingerprint_of(replace(data, labels=("A", "B", "C", "D"))) == kept
    other = replace(one, id="two", frequency_hz=one.frequency_hz * 1.1)
    assert fingerprint_of(replace(data, sets=(one, other))) == kept


def test_the_fingerprint_hears_everything_that_changes_a_density():
    data = measured_chain(noise=0.004)
    one = data.sets[0]
    shape = np.array(one.shape)
    shape[3, 2] += 1e-6

    def parameters(**change):
        return Parameters((replace(CHAIN_PARAMETERS.items[0], **change), *CHAIN_PARAMETERS.items[1:]))

    correlation = np.eye(4)
    correlation[0, 1] = correlation[1, 0] = 0.3
    found = [
        fingerprint_of(data),
        fingerprint_of(with_set(data, frequency_hz=one.frequency_hz * (1 + 1e-9))),
        fingerprint_of(with_set(data, shape=shape)),
        fingerprint_of(data, weights=replace(PAPER, shape_factor=11.0)),
        fingerprint_of(data, weights=Weights()),
        fingerprint_of(data, clusters=[(0,), (1,), (2, 3)]),
        fingerprint_of(replace(data, channels=("x3", "x1", *CHANNELS[2:]))),
        fingerprint_of(data, chain_model(asymmetry=0.021)),
        fingerprint_of(data, chain_model(parameters(std=0.6))),
        fingerprint_of(data, chain_model(parameters(initial=1.1))),
        fingerprint_of(data, chain_model(parameters(upper=5.0))),
        fingerprint_of(data, chain_model(parameters(prior="lognormal"))),
        fingerprint_of(data, chain_model(Parameters(CHAIN_PARAMETERS.items, correlation))),
    ]
    assert len(set(found)) == len(found)


def test_a_callables_fingerprint_hears_its_priors_correlation():
    items = linear_model().parameters.items
    correlation = np.eye(3)
    correlation[0, 1] = correlation[1, 0] = 0.5
    plain, joint = linear_model(Parameters(items)), linear_model(Parameters(items, correlation))
    assert plain.fingerprint() != joint.fingerprint()
