"""Sources of a model's error, marginalised: against the joint posterior with them as parameters, written out."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from updating_cases import (
    CHAIN_PARAMETERS,
    CHAIN_TRUTH,
    LINEAR_HZ,
    chain_model,
    linear_data,
    linear_model,
    measured_chain,
)

from probupdate import verbs
from probupdate.effects.tolerances import SensorUncertainty, TurbineUncertainty
from probupdate.model.uncertainty import ErrorSource, marginal_root
from probupdate.structure.load import load_model, reference_model
from probupdate.updating.components import variance_components
from probupdate.updating.discrepancy import LikelihoodSettings, estimate_discrepancy, state_model_error
from probupdate.updating.hierarchical import Population
from probupdate.updating.laplace import maximum_a_posteriori
from probupdate.updating.problem import Weights, build_problem
from probupdate.updating.set_likelihoods import coordinates_of, linearise
from probupdate.updating.set_views import Common, gaussian_prior, joint_posterior
from probupdate.updating.shared_error import Scales, shared_error, total
from probupdate.updating.tikhonov import update

SHARP = Weights(frequency_cov=(0.01,) * 4, shape_std=False, shape_factor=1.0)
FREQUENCIES = Weights(shapes="none", tolerances=True, least_frequency_cov=1e-9)


@dataclass(frozen=True, eq=False)
class Given:
    """Changes of the frequencies in Hz per unit of each source, (n_mode, n_source)."""

    model: object
    slope: np.ndarray
    std: tuple[float, ...]
    mean: tuple[float, ...]

    @property
    def sources(self):
        return tuple(ErrorSource(name=f"s{k}", group="structure", description=f"source {k}", unit="-", std=s, mean=m)
                     for k, (s, m) in enumerate(zip(self.std, self.mean, strict=True)))

    def changes(self, theta, n_mode, clusters):
        solution = self.model.solve(theta, n_mode)
        slope = np.zeros((n_mode, len(self.std)))
        slope[: len(self.slope)] = self.slope[:n_mode]
        still = np.zeros((*solution.shape.shape, len(self.std)))
        return replace(solution, frequency_derivative=slope, shape_derivative=still)

    def fingerprint(self):
        return "given"


@pytest.fixture(scope="module")
def linear():
    rng = np.random.default_rng(4)
    model = linear_model()
    slope = 0.2 * rng.standard_normal((5, 3))
    known = replace(model, uncertainty=Given(model, slope, (0.1, 0.2, 0.3), (0.5, 0.0, -0.2)))
    return build_problem(known, linear_data(np.array([1.03, 1.9, 4.1, 8.2, 15.8])), weights=FREQUENCIES), slope


def test_the_marginal_likelihood_is_the_gaussian_written_out(linear, validation):
    row = validation(what="likelihood with the model's error marginalised", reference="Gaussian density written out",
                     why="rounding", unit="in ln p")
    problem, slope = linear
    theta = problem.parameters.initial
    B = slope * np.array([0.1, 0.2, 0.3])
    covariance = np.diag(problem.std**2) + B @ B.T
    residual = problem.measured - problem.model.solve(theta, 5).frequency_hz - slope @ [0.5, 0.0, -0.2]
    expected = -0.5 * residual @ np.linalg.solve(covariance, residual)
    expected -= 0.5 * np.linalg.slogdet(2 * np.pi * covariance)[1]
    row.error(problem.log_likelihood(theta)[0] - expected, below=1e-9)


def test_the_posterior_is_that_with_the_sources_as_parameters(linear, validation):
    """Of a linear model both are Gaussian: the joint one has the sources beside theta, and is marginalised by hand."""
    row = validation(what="its posterior; Eq. 6 with that W_Lambda",
                     reference="sources as further parameters, by hand (linear model)", why="the solver's",
                     unit="in theta")
    problem, slope = linear
    std = problem.std
    S = problem.sensitivity(problem.parameters.initial)[1]
    whole = np.hstack([S, slope]) / std[:, None]
    prior = np.concatenate([problem.parameters.std, [0.1, 0.2, 0.3]])
    start = np.concatenate([problem.parameters.initial, [0.5, 0.0, -0.2]])
    plain = problem.model.solve(problem.parameters.initial, 5).frequency_hz
    residual = (problem.measured - plain - slope @ [0.5, 0.0, -0.2]) / std
    P = np.linalg.inv(whole.T @ whole + np.diag(prior**-2.0))
    joint = start + P @ whole.T @ residual
    top = maximum_a_posteriori(problem, [problem.parameters.initial])
    row.error(top.theta - joint[:3], below=1e-7, of="MAP")
    assert top.covariance == pytest.approx(P[:3, :3], rel=1e-8)
    # Eq. 6 with W_Lambda the inverse of that covariance ends there too
    row.error(update(problem, penalty="prior").theta[-1] - joint[:3], below=1e-6, of="Eq. 6")


def test_variance_components_add_up_and_a_source_known_exactly_is_one_left_out(linear, validation):
    row = validation(what="variance components", reference="posterior's covariance; a source left out",
                     why="rounding; the solver's")
    problem, _ = linear
    top = maximum_a_posteriori(problem, [problem.parameters.initial])
    parts = variance_components(problem, top)
    row.error(np.sum(parts.std**2, axis=0) / parts.total**2 - 1, below=1e-10, of="sum")
    assert parts.total == pytest.approx(np.sqrt(np.diag(top.covariance)), rel=1e-8)
    assert np.sum(parts.source_std**2, axis=0) == pytest.approx(parts.std[parts.names.index("structure")] ** 2)
    measure = next(m for m in parts.measures if m.what.startswith("determine"))
    without = replace(problem, error=None)
    alone = maximum_a_posteriori(without, [problem.parameters.initial])
    fallen = 1 - np.sqrt(np.diag(alone.covariance) / np.diag(top.covariance))
    row.error(measure.gain - fallen, below=1e-6, of="source left out")


def test_marginal_root_against_the_dense_inverse():
    rng = np.random.default_rng(2)
    root, factor = rng.standard_normal((6, 6)), rng.standard_normal((6, 9))
    found, log_det = marginal_root(root, factor)
    C = np.linalg.inv(root.T @ root)
    assert found.T @ found == pytest.approx(np.linalg.inv(C + factor @ factor.T), rel=1e-8)
    assert log_det == pytest.approx(np.linalg.slogdet(C + factor @ factor.T)[1] - np.linalg.slogdet(C)[1])


def test_gains_of_sensors_widen_what_shapes_tell():
    model = chain_model()
    known = replace(model, uncertainty=SensorUncertainty(model=model))
    data = measured_chain(noise=0.002, seed=5)
    plain, stated = (build_problem(m, data, weights=replace(SHARP, tolerances=t))
                     for m, t in ((model, False), (known, True)))
    assert len(stated.error.sources) == len(model.channels)
    top = maximum_a_posteriori(plain, [CHAIN_TRUTH])
    a, b = (np.linalg.inv(p.whiten(p.sensitivity(top.theta)[1].T) @ p.whiten(p.sensitivity(top.theta)[1].T).T
                          + np.diag(CHAIN_PARAMETERS.std**-2.0)) for p in (plain, stated))
    assert np.all(np.diag(b) >= np.diag(a) * (1 - 1e-9)) and np.max(np.diag(b) / np.diag(a)) > 1.01


def test_the_response_to_a_gain_is_its_finite_difference(validation):
    """One channel reads a per mille more: the aligned responses move as the source says."""
    checked = validation(what="response to a sensor's gain", reference="differences of the model",
                         why="rounding, of the largest")
    model = chain_model()
    known = replace(model, uncertainty=SensorUncertainty(model=model))
    data = measured_chain(noise=0.002, seed=5)
    problem = build_problem(known, data, weights=Weights(frequency_cov=(0.01,) * 4, shape_std=False, tolerances=True))
    theta, row, h = problem.parameters.initial, 3, 1e-5
    pick = model.channel_matrix.toarray()
    ends = []
    for sign in (1, -1):
        moved = pick.copy()
        moved[row] *= 1 + sign * h
        other = replace(model, channel_matrix=type(model.channel_matrix)(moved))
        ends.append(problem.with_model(other).predict(theta))
    difference = (ends[0] - ends[1]) / (2 * h)
    source = problem.error.sources[row]
    assert source.description.endswith(model.channels[row])
    error = problem.error.factor[:, row] / source.std - difference
    checked.error(error / np.abs(difference).max(), below=1e-6)


@pytest.fixture(scope="module")
def turbine():
    path = reference_model("as_built")
    model = load_model(path)
    return replace(model, uncertainty=TurbineUncertainty.from_description(path, model, None, None))


def test_every_source_of_a_turbine_has_a_standard_deviation_and_a_group(turbine):
    sources = turbine.uncertainty.sources
    assert {s.group for s in sources} == {"structure", "soil", "rotor-nacelle assembly", "water and growth", "sensors"}
    assert all(s.std > 0 for s in sources) and len({s.name for s in sources}) == len(sources)


def test_tolerances_of_a_turbine_against_differences_of_the_file(turbine, validation):
    """The nacelle a per cent heavier, written into the file, moves ln f as its source says."""
    row = validation(what="response to the nacelle's mass", reference="differences of the file",
                     why="differences, of the largest")
    from probupdate.structure.description_file import parse_description
    from probupdate.structure.load import turbine_model
    from probupdate.structure.parameter_table import read_toml

    theta = turbine.parameters.initial
    solution = turbine.uncertainty.changes(theta, 6, ((0, 1), (3, 4)))
    column = next(k for k, s in enumerate(turbine.uncertainty.sources) if s.name == "rna_mass")
    ends = []
    for sign in (1, -1):
        raw = read_toml(reference_model("as_built"))
        raw["rna"][0]["mass_kg"] += sign * 1000.0
        ends.append(turbine_model(parse_description(raw, "x"), where="x").solve(theta, 6).frequency_hz)
    difference = (ends[0] - ends[1]) / 2000.0
    error = solution.frequency_derivative[:, column] - difference
    row.error(error / np.max(np.abs(difference)), below=1e-3)


def test_bernoulli_euler_members_are_expected_to_be_stiff(tmp_path, validation):
    """The mean of the model's error is what Timoshenko's theory does to the frequencies."""
    row = validation(what="what Bernoulli-Euler members are expected to miss, five frequencies",
                     reference="Timoshenko's theory solved", why="first order")
    text = reference_model("as_built").read_text(encoding="utf-8")
    path = tmp_path / "model.toml"
    path.write_text(text.replace('theory = "timoshenko"', 'theory = "bernoulli-euler"'), encoding="utf-8")
    euler, timoshenko = load_model(path), load_model(reference_model("as_built"))
    known = TurbineUncertainty.from_description(path, euler, None, None)
    theta = euler.parameters.initial
    change = known.changes(theta, 5, ((0, 1), (3, 4))).frequency_derivative @ np.array([s.mean for s in known.sources])
    apart = timoshenko.solve(theta, 5).frequency_hz - euler.solve(theta, 5).frequency_hz
    # to first order
    row.error(change / apart - 1, 0.25)
    assert np.all(change < 0)


def test_stating_the_error_twice_gives_the_same_numbers():
    model = chain_model()
    known = replace(model, uncertainty=SensorUncertainty(model=model))
    data = measured_chain(noise=0.01, seed=8)
    weights = Weights(frequency_cov=(0.004,) * 4, shape_std=False, tolerances=True)
    first, second = (state_model_error(known, data, weights=weights, discrepancy="auto") for _ in range(2))
    assert first == second or first.at == second.at
    a, b = (build_problem(known, data, weights=w).fingerprint() for w in (first, second))
    assert a == b


def test_the_papers_weights_stay_what_they_are():
    data = measured_chain(noise=0.004, seed=3)
    record = verbs.update(chain_model(), data, likelihood=LikelihoodSettings(weights="paper"))
    assert "tolerances" not in record.settings["weights"] and "discrepancy" not in record.settings["weights"]
    assert "tolerances" in verbs.update(chain_model(), data).settings["weights"]


def test_an_error_that_sets_share_is_marginalised_over_all_of_them(linear, validation):
    """Four sets of a linear model with the same sources: one posterior for all against the dense joint Gaussian."""
    checked = validation(what="error of the model that sets share: ln p of one posterior for all",
                         reference="dense joint Gaussian", why="rounding", unit="nat")
    problem, slope = linear
    rng = np.random.default_rng(6)
    frequencies = LINEAR_HZ * (1 + 0.01 * rng.standard_normal((4, 5)))
    problems = [build_problem(problem.model, linear_data(row), weights=FREQUENCIES) for row in frequencies]
    parameters = problem.parameters
    coordinates = replace(coordinates_of(parameters), logarithmic=np.zeros(3, bool), scale=parameters.std)
    centres = np.tile(parameters.initial, (4, 1))
    error = shared_error(problems, centres, coordinates)
    found = error.likelihoods(total(error.each((0.0, 0.0))), [Scales(new=(0.0, 0.0), shared=(0.0, 0.0, 0.0))])

    S, B = problem.sensitivity(parameters.initial)[1], problem.factor
    stacked, shared = np.tile(S, (4, 1)), np.tile(B, (4, 1))
    covariance = np.diag(np.tile(problem.std**2, 4)) + shared @ shared.T
    y = np.concatenate([p.measured for p in problems]) - np.tile(problem.predict(parameters.initial), 4)
    for u in (parameters.initial, parameters.initial + [0.1, -0.2, 0.05]):
        left = y - stacked @ (u - parameters.initial)
        dense = -0.5 * left @ np.linalg.solve(covariance, left) - 0.5 * np.linalg.slogdet(2 * np.pi * covariance)[1]
        checked.error(found.evaluate(u[None])[0] - dense, below=1e-8)
    # four sets narrow the noise and leave what they share
    W, one = np.linalg.inv(covariance), np.linalg.inv(np.diag(problem.std**2) + B @ B.T)
    together, alone = stacked.T @ W @ stacked, S.T @ one @ S
    assert np.all(np.linalg.eigvalsh(together) < 4 * np.linalg.eigvalsh(alone) * (1 - 1e-6))


@pytest.mark.parametrize(("new", "shared"), [(0.004, 0.0), (0.0, 0.01), (0.006, 0.006)])
def test_a_discrepancy_that_sets_share_is_a_block_of_ones(linear, validation, new, shared):
    """Five sets, one of them without the third frequency: stacked residuals of the dense joint Gaussian."""
    row = validation(what="model discrepancy that sets share: ln p of one posterior for all",
                     reference="dense joint Gaussian", why="rounding", unit="nat")
    frequencies = LINEAR_HZ * (1 + 0.01 * np.random.default_rng(8).standard_normal((5, 5)))
    frequencies[2, 2] = np.nan
    weights = Weights(shapes="none")
    single = [(j,) for j in range(5)]
    data = linear_data(frequencies, cov=0.002)
    problems = [build_problem(linear_model(), data, set_id=s.id, weights=weights, clusters=single) for s in data.sets]
    parameters, theta = problems[0].parameters, problems[0].parameters.initial + [0.1, -0.05, 0.02]
    coordinates = coordinates_of(parameters)
    error = shared_error(problems, np.tile(parameters.initial, (5, 1)), coordinates)
    scales = Scales(new=(new, 0.0), shared=(shared, 0.0, 0.0))
    found = error.likelihoods(total(error.each(scales.new)), [scales]).evaluate(coordinates.transform(theta)[None])[0]
    kept = np.isfinite(frequencies)
    f, mode = frequencies[kept], np.nonzero(kept)[1]
    residual = f - problems[0].predict(theta)[mode]
    # a share of the first set's frequencies: of each one's own, a large one could shrink their scatter
    common = (mode[:, None] == mode) * np.outer(frequencies[0][mode], frequencies[0][mode]) * shared**2
    covariance = common + np.diag((0.002 * LINEAR_HZ[mode]) ** 2 + (new * f) ** 2)
    expected = -0.5 * residual @ np.linalg.solve(covariance, residual) - 0.5 * np.linalg.slogdet(
        2 * np.pi * covariance)[1]
    row.error(found - expected, below=1e-7)


def test_what_all_sets_miss_alike_is_not_averaged_out(validation):
    """Forty structures, frequencies 1 % off alike in nine sets with 0.1 % of their own: 90 % intervals of the one
    posterior for all. As noise that is new in each set they hold less than a half."""
    row = validation(what="error that nine sets repeat: 90 % intervals of one posterior for all, 40 structures",
                     reference="0.9", unit="standard errors")
    rng, inside = np.random.default_rng(12), []
    model = linear_model()
    single, weights = [(j,) for j in range(5)], Weights(shapes="none")
    coordinates = coordinates_of(model.parameters)
    prior = gaussian_prior(model.parameters, coordinates)
    for _ in range(40):
        theta = model.parameters.draw(rng, 1)[0]
        truth = model.solve(theta, 5).frequency_hz * (1 + 0.01 * rng.standard_normal(5))
        data = linear_data(truth * (1 + 0.001 * rng.standard_normal((9, 5))), cov=0.001)
        learnt = estimate_discrepancy(model, data, weights=weights, clusters=single)
        problems = [build_problem(model, data, set_id=s.id, weights=learnt, clusters=single) for s in data.sets]
        error = shared_error(problems, np.tile(model.parameters.initial, (9, 1)), coordinates)
        density = Common.from_error(error, prior).all_sets_density()
        found = joint_posterior(density, model.parameters, coordinates, prior, rng)
        below = found.weight @ (found.theta < theta)
        inside += list((below > 0.05) & (below < 0.95))
    # parameters of one structure go together: forty times one of them
    row.error((np.mean(inside) - 0.9) / np.sqrt(0.9 * 0.1 / 40), below=3)


def test_a_populations_mean_is_as_wide_as_the_shared_error_makes_it(linear, validation):
    """At no scatter between sets the mean's covariance is that of one posterior for all."""
    row = validation(what="error of the model that sets share: the population's mean",
                     reference="the same at no scatter", unit="standard errors")
    problem, _ = linear
    problems = [build_problem(problem.model, linear_data(LINEAR_HZ * (1 + 0.002 * k)), weights=FREQUENCIES)
                for k in range(3)]
    parameters = problem.parameters
    coordinates = replace(coordinates_of(parameters), logarithmic=np.zeros(3, bool), scale=parameters.std)
    centres = np.tile(parameters.initial, (3, 1))
    shared, none = shared_error(problems, centres, coordinates), Scales(new=(0.0, 0.0), shared=(0.0, 0.0, 0.0))
    normal = parameters.initial, np.diag(parameters.std**-2.0)
    expected = shared.expected_common(none.new, [none], np.full(3, 1e-9), normal)
    noise = linearise(shared.conditional_problems(expected, none.new), centres, coordinates)
    prior = np.diag(parameters.std**-2.0)
    K = noise.precision.sum(axis=0) + prior
    rng = np.random.default_rng(9)
    n = 40_000
    mean = np.linalg.solve(K, noise.gradient.sum(axis=0)) + parameters.initial
    drawn = mean + rng.standard_normal((n, 3)) @ np.linalg.cholesky(np.linalg.inv(K)).T
    zero = np.full((n, 3), 1e-9)
    population = Population(mean=drawn, tau=zero, factor=np.zeros((n, 3, 3)), log_likelihood=np.zeros((n, 3)),
                            r_hat=1.0, ess=1e4, converged=True, verdict="")
    widened = shared.widen(population, expected, none.new, [none], normal, rng).mean
    together = shared.likelihoods(total(shared.each(none.new)), [none]).node(0)
    H = together.precision[0] + prior
    expected = parameters.initial + np.linalg.solve(H, together.gradient[0])
    std = np.sqrt(np.diag(np.linalg.inv(H)))
    # five standard errors of means and standard deviations of so many draws
    row.error((widened.mean(axis=0) - expected) / np.max(std) * np.sqrt(n), below=5)
    row.error((widened.std(axis=0) / std - 1) * np.sqrt(2 * n), below=5)
