"""One inference for the turbines of a design against one dense joint Gaussian, quadrature and a plain chain."""

from __future__ import annotations

from dataclasses import replace

import emcee
import numpy as np
import pytest
from joint_cases import HZ, PARAMETERS, ROLES, SLOPE, STD, dense, drawn_farm, farm_problems, linear_model
from scipy import optimize, special, stats

from probupdate.errors import InputError
from probupdate.model.parameters import Parameter, Parameters
from probupdate.updating.joint_file import read_joint
from probupdate.updating.joint_inference import JointSettings, estimate_farm, sample_farm
from probupdate.updating.joint_next import SURVEY, next_measurements
from probupdate.updating.joint_prior import NormalScores
from probupdate.updating.joint_result import infer_farm
from probupdate.updating.joint_scales import sample_scale_chain, student_about
from probupdate.updating.problem import Weights

SPREAD = 0.25 * 1.5
# normal scores of unbounded normal priors are theta over these
UNIT = PARAMETERS.std
# a common error of a share of each frequency, half of it the same for all
STATED = Weights(shapes="none", discrepancy=0.01)


def parts(y):
    """Standard deviations of what all share and of what is new, as the weights of a file state them."""
    share = 0.01 * np.sqrt(0.5)
    return share * y[0, 0], np.hypot(STD, share * y)


@pytest.fixture(scope="module")
def farm():
    y, _ = drawn_farm(5, 3, seed=1, wrong=0.007)
    return y, estimate_farm(farm_problems(y, weights=STATED), **ROLES)


def test_the_stacked_estimate_is_the_mean_of_one_dense_gaussian(farm, validation):
    row = validation(what="stacked Tikhonov estimate of five turbines with one model error: values, covariances",
                     reference="one dense joint Gaussian, plain numpy", unit="posterior standard deviations")
    y, found = farm
    mean, covariance, _ = dense(y, 1.5 * found.tau[0], *parts(y))
    std, theta = np.sqrt(np.diag(covariance)), found.theta
    row.error((np.concatenate([found.z * UNIT[:2], theta[:, 1], theta[:, 2]]) - mean) / std, below=1e-6, of="values")
    joint = found.system.conditional(found.tau, found.common_std)
    _, own, across, _ = found.system.of_turbines(found.tau, joint)
    assert found.settled and np.allclose(theta[:, 0], found.z[0], atol=1e-9)
    own, across = own * np.outer(UNIT, UNIT), across * np.outer(UNIT, UNIT[:2])
    soil, scour = np.arange(2, 7), np.arange(7, 12)
    errors = [own[:, 1, 2] - covariance[soil, scour], own[:, 1, 1] - std[soil] ** 2,
              across[:, 2, 0] - covariance[scour, 0], across[:, 1, 1] - covariance[soil, 1]]
    row.error(np.array(errors) / std[2] ** 2, below=1e-6, of="covariances")


def test_the_density_of_the_scatter_is_that_of_all_data(farm):
    y, found = farm
    taus = np.array([1e-3, 0.05, 0.2, 0.5, 1.5])
    each = found.system.log_density(taus[:, None] / 1.5, np.tile(found.common_std, (5, 1)))
    stacked = [dense(y, tau, *parts(y))[2] for tau in taus]
    assert np.ptp(each - stacked) < 1e-7


def test_the_chain_over_the_scatter_is_quadrature_s(farm, validation):
    row = validation(what="scatter between turbines, all else in closed form: mean of ln tau",
                     reference="quadrature over the dense Gaussian's density", unit="standard errors")
    y, found = farm
    about = student_about(found.scales, found.system, found.x)
    chains = {"independent draws": sample_farm(found).chain,
              "emcee": sample_scale_chain(found.scales, found.system, about, np.random.default_rng(1))}
    tau = np.geomspace(1e-4, 3, 400)
    value = np.array([dense(y, t, *parts(y))[2] for t in tau]) + stats.halfnorm.logpdf(tau, scale=SPREAD) + np.log(tau)
    weight = special.softmax(value)
    mean = weight @ np.log(tau)
    std = np.sqrt(weight @ (np.log(tau) - mean) ** 2)
    for name, chain in chains.items():
        assert chain.converged and name.split()[0] in chain.verdict.replace("steps", "emcee")
        off = np.log(1.5 * found.scales.tau(chain.x)[:, 0]).mean() - mean
        row.error(off / (std / np.sqrt(chain.ess)), below=4, of=name)


def test_a_turbine_is_odd_with_the_probability_of_the_mixture(validation):
    row = validation(what="probability that a turbine is unlike the others", unit="of the logit",
                     reference="evidences of dense Gaussians, quadrature over the scatter")
    tau = np.geomspace(1e-3, 3, 60)
    prior = stats.halfnorm.logpdf(tau, scale=SPREAD) + np.log(tau)
    for shift, turbine in ((0.0, 3), (1.0, 0)):
        y, _ = drawn_farm(6, 1, seed=4, shift=shift)
        found = estimate_farm(farm_problems(y), **ROLES).odd
        # each beside all others
        assert np.all(np.delete(found.probability, turbine) < 0.5)
        evidence = []
        for off in (None, 0, 1):
            each = [dense(y, t, 0 * HZ, STD, odd=None if off is None else (turbine, off))[2] for t in tau]
            evidence.append(special.logsumexp(np.array(each) + prior))
        factor = np.logaddexp(evidence[1], evidence[2]) - np.log(2) - evidence[0]
        row.error(special.logit(found.probability[turbine]) - (factor + np.log(0.05 / 0.95)), below=0.15)
        assert found.share[turbine, 1] / found.probability[turbine] == pytest.approx(
            special.expit(evidence[2] - evidence[1]), abs=0.03)


def test_an_odd_turbine_is_named_and_the_population_is_the_others():
    y, truth = drawn_farm(12, 3, seed=1, shift=4.0)
    found = infer_farm(farm_problems(y), **ROLES)
    assert found.odd_probability[0] > 0.99 and max(found.odd_probability[1:]) < 0.5
    soil = next(r for r in found.population if r.parameter == "soil")
    assert soil.low < truth[1:, 1].mean() < soil.high and soil.tau_high < 1.0
    own = next(r for r in found.rows if r.turbine == "T0" and r.parameter == "soil")
    assert own.low < truth[0, 1] < own.high and own.odd > 0.95 and own.limit < 4.0
    assert any(text.startswith("T0 is unlike") and "soil" in text for text in found.notes)


BOUNDED = Parameters((
    Parameter(name="steel", unit="-", initial=0.0, std=1.0, lower=-1.0, upper=3.0),
    Parameter(name="soil", unit="-", initial=0.5, std=1.5, lower=-0.5),
    Parameter(name="scour", unit="-", initial=0.0, lower=-1.0, upper=1.2, prior="uniform")))


def log_joint(x: np.ndarray, y: np.ndarray, bend: float, noise: float, parameters: Parameters) -> np.ndarray:
    """ln of the whole density (n,) of x = (steel, mu, ln tau, soil of each, scour of each) (n, 3 + 2 n_turbine)."""
    n = len(y)
    steel, mean, tau, soil, scour = x[:, 0], x[:, 1], np.exp(x[:, 2]), x[:, 3 : 3 + n], x[:, 3 + n :]
    theta = np.stack([np.broadcast_to(steel[:, None], soil.shape), soil, scour], axis=-1)
    exact = HZ + theta @ SLOPE.T + bend * HZ * soil[:, :, None] ** 2
    value = -0.5 * np.sum(((y[None] - exact[:, :, None]) / (noise * STD)) ** 2, axis=(1, 2, 3))
    of_steel, of_soil, of_scour = (p.distribution for p in parameters)
    value += of_steel.logpdf(steel) + of_soil.logpdf(mean) + np.sum(of_scour.logpdf(scour), axis=1)
    value += -0.5 * (tau / 0.25) ** 2 + np.log(tau)
    # normal scores scatter about that of the mean
    score, of_mean = (stats.norm.ppf(of_soil.cdf(t)) for t in (soil, mean[:, None]))
    with np.errstate(invalid="ignore"):
        jacobian = of_soil.logpdf(soil) - stats.norm.logpdf(score)
        value += np.sum(stats.norm.logpdf(score, of_mean, tau[:, None]) + jacobian, axis=1)
    return np.where(np.isfinite(value), value, -np.inf)


@pytest.mark.parametrize(("name", "bend", "noise", "seed"), [
    ("bent", 0.02, 5.0, 6), ("bounded", 0.005, 10.0, 7)])
def test_draws_moved_to_true_models_are_those_of_a_plain_chain(validation, name, bend, noise, seed):
    row = validation(what="two turbines with a bent response, priors with and without bounds: posterior means",
                     unit="posterior standard deviations",
                     reference="emcee on the whole density, nothing in closed form")
    parameters = PARAMETERS if name == "bent" else BOUNDED
    y, _ = drawn_farm(2, 1, seed=seed, bend=bend, noise=noise)
    found = infer_farm(farm_problems(y, model=linear_model(parameters, bend), noise=noise), **ROLES)
    assert found.corrected and found.pareto_k < 0.7 and found.effective > 100
    own = {(r.turbine, r.parameter): r for r in found.rows}
    rows = [own[key] for key in (("T0", "steel"), ("T0", "soil"), ("T1", "soil"), ("T0", "scour"), ("T1", "scour"))]
    start = np.array([rows[0].mean, rows[1].mean, np.log(0.3), *(r.mean for r in rows[1:])])
    sampler = emcee.EnsembleSampler(28, 7, log_joint, args=(y, bend, noise, parameters), vectorize=True,
                                    moves=[(emcee.moves.DEMove(), 0.8), (emcee.moves.StretchMove(), 0.2)])
    state = emcee.State(start + 0.05 * np.random.default_rng(2).standard_normal((28, 7)),
                        random_state=np.random.RandomState(3).get_state())
    sampler.run_mcmc(state, 1500)
    draws = np.delete(sampler.get_chain(discard=300, flat=True), [1, 2], axis=1)
    for number, (r, values) in enumerate(zip(rows, draws.T, strict=True)):
        row.error((r.mean - values.mean()) / values.std(), below=0.25, of="means")
        assert r.std == pytest.approx(values.std(), rel=0.2), number


def test_a_narrow_posterior_keeps_all_draws_and_one_with_two_solutions_says_that_it_failed():
    """Where the response turns back within the prior draws have no solution, or two."""
    share = {}
    for noise, bend in ((0.3, 0.01), (10.0, 0.01), (10.0, 0.05)):
        farms = [infer_farm(farm_problems(drawn_farm(2, 1, seed=seed, bend=bend, noise=noise)[0],
                                          model=linear_model(bend=bend), noise=noise), **ROLES) for seed in range(3)]
        for one in farms:
            assert one.corrected != ("DO NOT REPRESENT" in one.summary)
        share[noise, bend] = [one.effective / one.draws for one in farms], [one.corrected for one in farms]
    assert min(share[0.3, 0.01][0]) > 0.98 and all(share[0.3, 0.01][1]) and all(share[10.0, 0.01][1])
    assert not all(share[10.0, 0.05][1])


def test_ten_turbines_within_wide_bounds_are_represented():
    """Steps of the estimate go to and fro there, unless each is shorter than the last."""
    y, _ = drawn_farm(10, 1, seed=3, bend=0.005, noise=10.0)
    found = infer_farm(farm_problems(y, model=linear_model(BOUNDED, 0.005), noise=10.0), **ROLES)
    assert found.settled and found.corrected and found.pareto_k < 0.7, found.verdict
    for row in found.rows:
        bounds = BOUNDED.items[BOUNDED.names.index(row.parameter)]
        assert bounds.lower <= row.low < row.high <= bounds.upper


def test_the_estimate_is_found_from_afar():
    """Bent responses, first made linear three prior standard deviations off: the same estimate as from the truth."""
    y, truth = drawn_farm(4, 3, seed=12, bend=0.01)
    near, far = (estimate_farm([replace(t, theta=theta + off) for t, theta in
                                zip(farm_problems(y, model=linear_model(bend=0.01)), truth, strict=True)], **ROLES)
                 for off in (np.zeros(3), -3 * PARAMETERS.std))
    assert near.settled and far.settled
    np.testing.assert_allclose(far.u, near.u, atol=0.02)


@pytest.mark.parametrize(("bend", "noise", "seed"), [(0.02, 3.0, 4), (0.05, 5.0, 1), (-0.03, 10.0, 2)])
def test_bent_models_are_estimated_where_their_whole_density_is_largest(bend, noise, seed):
    """At the scatter that the estimate has: a minimum of plain numpy's by BFGS, from many starts."""
    y, _ = drawn_farm(3, 2, seed=seed, bend=bend, noise=noise)
    found = estimate_farm(farm_problems(y, model=linear_model(bend=bend), noise=noise), **ROLES)
    tau = found.tau[0]

    def surprise(v):
        steel, mean, soil, scour = v[0], v[1], v[2:5], v[5:]
        exact = HZ + np.column_stack([np.full(3, steel), 1.5 * soil, 0.8 * scour]) @ SLOPE.T
        exact += bend * HZ * (1.5 * soil[:, None]) ** 2
        misfit = np.sum(((y - exact[:, None]) / (noise * STD)) ** 2)
        return 0.5 * (misfit + steel**2 + mean**2 + np.sum((soil - mean) ** 2) / tau**2 + np.sum(scour**2))

    rng = np.random.default_rng(seed)
    ends = [optimize.minimize(surprise, rng.standard_normal(8), method="BFGS") for _ in range(8)]
    best = min(ends, key=lambda end: end.fun)
    mine = np.concatenate([found.z, found.u[:, 1], found.u[:, 2]])
    assert found.settled and surprise(mine) - best.fun < 0.02
    assert np.all(np.abs(mine - best.x) < 0.3 * np.sqrt(np.diag(best.hess_inv)))


def test_what_a_survey_says_is_the_ratio_of_dense_variances():
    y, _ = drawn_farm(4, 2, seed=2)
    found = estimate_farm(farm_problems(y), **ROLES)
    _, covariance, _ = dense(y, 1.5 * found.tau[0], 0 * HZ, STD)
    rows = {(r.turbine, r.measurement): r for r in next_measurements(found, tuple("ABCD"))}
    of_soil = rows["B", "a survey of soil"]
    noise, at, z = (SURVEY * 1.5) ** 2, 3, [0, 1]
    after = covariance - np.outer(covariance[:, at], covariance[at]) / (covariance[at, at] + noise)
    expected = 0.5 * np.log2(np.linalg.det(covariance[np.ix_(z, z)]) / np.linalg.det(after[np.ix_(z, z)]))
    assert of_soil.farm_bits == pytest.approx(expected, rel=1e-6)
    twice = np.concatenate([y, y], axis=1)[:, :4]
    std = np.where(np.arange(4)[:, None, None] == 1, 1.0, np.sqrt(2.0)) * STD
    again = dense(twice, 1.5 * found.tau[0], 0 * HZ, std)[1]
    expected = 0.5 * np.log2(np.linalg.det(covariance[np.ix_(z, z)]) / np.linalg.det(again[np.ix_(z, z)]))
    assert rows["B", "as many sets again"].farm_bits == pytest.approx(expected, rel=1e-6)


def test_a_turbine_without_sensors_inherits_the_population():
    y, _ = drawn_farm(10, 2, seed=3)
    found = infer_farm(farm_problems(y), **ROLES)
    steel, soil, scour = (next(r for r in found.population if r.parameter == n) for n in ("steel", "soil", "scour"))
    assert steel.inherited_std == pytest.approx(steel.std, rel=1e-9)
    assert soil.std < soil.tau < soil.inherited_std < 1.5
    assert scour.inherited_std == pytest.approx(0.8, rel=0.15) and np.isnan(scour.mean)


def test_what_all_have_in_common_narrows_with_turbines_until_the_model_error():
    widths = []
    for n in (2, 8, 32):
        y, _ = drawn_farm(n, 2, seed=5, wrong=0.002)
        found = estimate_farm(farm_problems(y, weights=Weights(shapes="none", discrepancy=0.003)), **ROLES)
        joint = found.system.conditional(found.tau, found.common_std)
        widths.append(np.sqrt(joint.solve(np.eye(len(joint.mean))[:, 0])[0]))
    # sixteen times the turbines, not a fourth of the width
    assert widths[0] > widths[1] > widths[2] > 0.3 * widths[0]


def test_an_estimate_read_back_says_the_same(tmp_path):
    y, _ = drawn_farm(3, 2, seed=3)
    found = infer_farm(farm_problems(y), **ROLES, settings=JointSettings(odd_share=0.0))
    again = read_joint(found.write(tmp_path / "farm_joint.json"))
    assert again.summary == found.summary and len(found.to_frame()) == 9
    (tmp_path / "other.json").write_text('{"format": 1, "rows": 3}')
    with pytest.raises(InputError, match="farm_joint.json"):
        read_joint(tmp_path / "other.json")


@pytest.mark.parametrize("common, varying, said", [
    (("steel", "oak"), (), "oak"), (("steel",), ("steel",), "common and varying"), ((), (), "names no parameter")])
def test_roles_that_cannot_be_are_refused(common, varying, said):
    y, _ = drawn_farm(2, 1, seed=1)
    with pytest.raises(InputError, match=said):
        estimate_farm(farm_problems(y), common=common, varying=varying)
    assert PARAMETERS.names == ("steel", "soil", "scour")


def test_scores_are_standard_normal_under_each_prior_and_have_their_derivative():
    items = (*BOUNDED.items, Parameter(name="ratio", unit="-", initial=2.0, std=1.5, lower=1.9, prior="lognormal"),
             Parameter(name="py", unit="-", initial=1.0, std=0.5, lower=0.05, upper=5.0))
    scores, u = NormalScores(parameters=Parameters(items)), np.linspace(-5, 5, 11)[:, None] * np.ones(5)
    theta = scores.back(u)
    quantile = np.column_stack([p.distribution.ppf(special.ndtr(u[:, 0])) for p in items])
    np.testing.assert_allclose(theta, quantile, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(scores.transform(theta), u, atol=1e-7)
    differences = (scores.back(u + 1e-5) - scores.back(u - 1e-5)) / 2e-5
    np.testing.assert_allclose(scores.rate(theta), differences, rtol=1e-4)
    assert np.all(scores.transform(Parameters(items).lower) == -7.5)
