"""The model and the data with findings in them: files that load, sets that are corrected, estimators run again."""

import json
import shlex
import shutil
from dataclasses import replace

import numpy as np
import pytest

import probupdate
from probupdate.cli import main
from probupdate.diagnosis import extension_sampling
from probupdate.diagnosis.diagnose import examine
from probupdate.diagnosis.extension import (
    correct_sensors,
    corrections,
    describe_parameter,
    extend,
    mean_set,
    size_statements,
)
from probupdate.diagnosis.prepare import prepare
from probupdate.diagnosis.problem import IncludedEffect, diagnosis_problem
from probupdate.diagnosis.proposals import sharpen_time
from probupdate.diagnosis.time_profiles import TimeProfile, step_profile
from probupdate.effects.catalogue import Delay, Effect, Gain, Rate, Turn
from probupdate.effects.turbine import turbine_effects
from probupdate.errors import ConvergenceError
from probupdate.modal.modes import mac, read_modes
from probupdate.structure.description_file import read_description
from probupdate.structure.extend import extended_model, write_extended
from probupdate.structure.load import load_model, reference_model
from probupdate.updating.ensemble import SamplerSettings
from probupdate.updating.identifiability import DIAGNOSED
from probupdate.updating.posterior_file import read_posterior


@pytest.fixture(scope="module")
def prepared(frame_file):
    return prepare(frame_file)


def included(observe, size, time_profile):
    return IncludedEffect(
        effect=Effect(
            kind="measurement", cause="test", location="", unit="-", tolerance=0.0, prior_scale=1.0, observe=observe
        ),
        time_profile=time_profile,
        size=size,
    )


def test_corrected_sets_are_those_without_the_sensors_faults(prepared, record, validation):
    """A late logger, a turned sensor, a gain from the tenth block on and a fast clock, put in by the observations and
    taken out again."""
    row = validation(what="sets corrected for a gain from block 10 on, rotation, clock offset and rate: frequencies, "
                          "shapes", reference="the sets before these were put in", why="rounding")
    true = record(1)
    problem, _ = diagnosis_problem(prepared, true)
    n = len(true.sets)
    constant = TimeProfile(kind="constant", value=np.ones(n))
    faults = (included(Gain((3,)), 0.2, step_profile(n, 10)), included(Turn(((4, 5),)), 12.0, constant),
              included(Delay((0, 1)), 8.0, constant), included(Rate(), 0.01, constant))
    sets = []
    for b, s in enumerate(true.sets):
        shape, frequency = np.array(s.shape), np.array(s.frequency_hz)
        for j in range(len(frequency)):
            shape[3, j] *= 1.2 if b >= 10 else 1.0
            c, d = np.cos(np.radians(12.0)), np.sin(np.radians(12.0))
            shape[4, j], shape[5, j] = c * shape[4, j] + d * shape[5, j], c * shape[5, j] - d * shape[4, j]
            late = Delay((0,))(np.ones((1, 1)), frequency[j] / 1.01, 8.0)[0][0, 0]
            assert abs(abs(np.angle(late)) - 2 * np.pi * frequency[j] / 1.01 * 8e-3) < 1e-9
            shape[[0, 1], j] *= late
        sets.append(replace(s, shape=shape, frequency_hz=frequency / 1.01))
    found = correct_sensors(problem, replace(true, sets=tuple(sets)), faults)
    for was, now in zip(true.sets, found.sets, strict=True):
        row.error(now.frequency_hz / was.frequency_hz - 1, 1e-12, "frequencies")
        row.error(now.shape - was.shape, 1e-12, "shapes")


def test_deviations_are_corrected_as_the_shapes_are():
    A, shift = corrections(4, [included(Gain((2,)), 0.25, None)], [1.0], 1.0)
    assert shift == 0.0 and A[2, 2] == 1.25 and np.allclose(np.delete(np.diag(A), 2), 1.0)
    assert corrections(4, [included(Gain((2,)), 0.25, None)], [0.0], 1.0)[0][2, 2] == 1.0


def test_mean_of_blocks_is_that_of_frequencies_and_shapes(stepped):
    """Against plain means of the blocks: pairs of this frame have their axes in x and y."""
    outcome = stepped[2]
    found, n = mean_set(outcome.problem, outcome.fitted)
    later = outcome.problem.blocks.taken(np.arange(18, 40))
    assert n == 22
    plain = later.frequency_hz.mean(axis=0)
    # pairs 1.5 % apart are mixed with the noise of shapes: a mean of ordered frequencies is off by less than that of
    # twenty-two blocks of 0.1 %
    np.testing.assert_allclose(found.frequency_hz, plain, rtol=3e-3 / np.sqrt(22))
    # the mean's own, of blocks of 0.1 %, in pairs that are mixed; what the model misses is the likelihood's to state
    assert np.all(found.frequency_std_hz > 0.5 * 1e-3 / np.sqrt(22) * plain)
    assert np.all(found.frequency_std_hz < 2 * 1e-3 / np.sqrt(22) * plain)
    one = later.shape[0]
    assert np.min(np.diag(mac(one, found.shape))) > 0.999


def test_a_wrong_gain_is_taken_out_and_the_parameters_move_back(prepared, record, tmp_path):
    data = record(8, gain=("y4", 1.15))
    out = tmp_path / "run" / "diagnosis.json"
    found = probupdate.diagnose(prepared, data, out=out, sampler=False)
    content = json.loads(found.write(out)[0].read_text())
    assert content["extended_model"] is None and content["extension"]["files"]["model"] is None
    again = read_modes(out.with_name(content["extension"]["files"]["modes"]))
    ratio = again.sets[0].shape[data.channels.index("y4")] / data.sets[0].shape[data.channels.index("y4")]
    (added,) = content["extension"]["added"]
    np.testing.assert_allclose(ratio, 1 / (1 + added["size"]), rtol=1e-9)
    assert abs(added["size"] - content["findings"][0]["size"]) < 0.3 * content["findings"][0]["size_std"]
    untouched = [k for k, c in enumerate(data.channels) if c != "y4"]
    np.testing.assert_array_equal(again.sets[0].shape[untouched], data.sets[0].shape[untouched])
    before, after = (content["extension"][side] for side in ("before", "after"))
    # fifteen standard deviations of one per cent on one row of four shapes
    assert after["misfit"] < before["misfit"] - 10
    assert content["extension"]["joint"]["findings"][0]["identified"] is True
    # the mean's file is what an update or a chain starts from
    mean = read_modes(out.with_name(content["extension"]["files"]["mean"]))
    record_of_it = probupdate.update(prepared.path, mean)
    assert record_of_it.map_misfit == pytest.approx(after["misfit"], rel=1e-3)
    # the sampler was left out, and it says so
    assert content["extension"]["sampler"]["asked"] is False and content["extension"]["files"]["posterior"] is None
    command = f"probupdate sample --model {prepared.path} --modes {out.with_name('diagnosis.mean.json')}"
    assert any("was not asked for" in s and command in s for s in content["extension"]["statements"])


@pytest.mark.long
def test_the_command_that_is_told_runs_where_the_parameters_lie_elsewhere(frame_file, record, tmp_path):
    model, parameters = tmp_path / "a model" / "frame.npz", tmp_path / "priors.toml"
    model.parent.mkdir()
    shutil.copy(frame_file, model)
    shutil.copy(frame_file.with_suffix(".toml"), parameters)
    found = probupdate.diagnose(model, record(8, gain=("y4", 1.15)), parameters=parameters, sampler=False,
                                out=tmp_path / "d.json")
    program, *arguments = shlex.split(found.extension["sampler"]["command"])
    assert program == "probupdate" and main([*arguments, "--ess", "50", "--max-steps", "100"]) == 0
    assert (tmp_path / "d.posterior.nc").is_file()


def test_left_out_on_request(prepared, record, tmp_path):
    found = probupdate.diagnose(prepared, record(8, gain=("y4", 1.15)), extend=False, out=tmp_path / "d.json")
    assert found.findings[0].gain == {} and found.extension == {} and not list(tmp_path.iterdir())


def test_an_extended_turbine_is_the_old_one_until_its_parameter_moves(tmp_path, validation):
    """The file with a finding in it loads; at its neutral value its modes are the original's, at the diagnosed size,
    where its prior has its centre, those of the model the size was fitted in."""
    row = validation(what="frequencies of the extended turbine at the neutral and at the found size",
                     reference="the original; the model it was fitted in", why="eigensolver")
    path = reference_model("updated")
    effect = next(r for r in turbine_effects(read_description(path)) if r.adds.name == "brace_BC_2")
    one = IncludedEffect(effect=effect, time_profile=step_profile(40, 20), size=-0.6)
    found_here = describe_parameter(effect.adds, one, 0.05)
    model = load_model(write_extended(path, [found_here], tmp_path / "diagnosis.model.toml"))
    assert model.parameters.names[-1] == "brace_BC_2"
    words = next(p.description for p in model.parameters if p.name == "brace_BC_2")
    assert DIAGNOSED in words and "block 21" in words
    theta = np.array(model.parameters.initial)
    assert (theta[-1], model.parameters.items[-1].std) == (effect.adds.neutral - 0.6, 0.05)
    theta[-1] = effect.adds.neutral
    plain = load_model(path)
    original = plain.solve(plain.parameters.initial, 5).frequency_hz
    row.error(model.solve(theta, 5).frequency_hz / original - 1, 1e-9, "neutral")
    theta[-1] = effect.adds.neutral - 0.6
    fitted_in = extended_model(path, [effect.adds])
    row.error(model.solve(theta, 5).frequency_hz / fitted_in.solve(theta, 5).frequency_hz - 1, 1e-9, "found")
    assert model.solve(theta, 5).frequency_hz[2] < original[2] * 0.999


def test_findings_of_parameters_leave_the_model_as_it_is(stepped):
    prepared, data, outcome = stepped
    found_here = extend(prepared, outcome, data)
    assert found_here.model is None
    (added,) = found_here.content["added"]
    assert added["parameter"] == "k3" and "in question" in added["as"]


def test_a_step_between_the_grids_blocks_is_found_to_the_block(stepped):
    outcome = stepped[2]
    problem = outcome.problem
    (one,) = outcome.fitted.included
    assert one.time_profile.at == 18 and outcome.diagnosis.findings[0].time_profile_start == problem.blocks.ids[18]
    # from the block before it, whatever the grid holds
    effect = next(j for j, e in enumerate(problem.effects) if e is one.effect)
    assert sharpen_time(problem, outcome.null, effect, step_profile(len(problem.blocks), 17)).at == 18


# The posterior with the findings ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def grouped(frame_file, record, tmp_path_factory):
    """(prepared, data, outcome, extension, out): the two lowest storeys loosen by a tenth from block 18 on, and their
    group is a candidate; sampled until it has converged."""
    prepared = prepare(frame_file, groups={"lower storeys": {"k1": 0.1, "k2": 0.1}})
    data = record(4, storey=slice(0, 2), factor=0.9, from_block=18)
    outcome = examine(prepared, data)
    out = tmp_path_factory.mktemp("grouped") / "diagnosis.json"
    found_here = extend(prepared, outcome, data, out, sampler=SamplerSettings(seed=3, target_ess=400, max_steps=3000))
    return prepared, data, outcome, found_here, out


def test_a_group_that_is_found_becomes_a_parameter_of_a_model_of_matrices(grouped):
    prepared, _, outcome, found_here, out = grouped
    (one,) = outcome.fitted.included
    (added,) = found_here.content["added"]
    assert (added["as"], added["parameter"], found_here.model) == ("parameter", "lower_storeys", "diagnosis.model.toml")
    model = load_model(out.with_name(found_here.model))
    plain = load_model(prepared.path)
    assert "block 19" in model.parameters.items[-1].description
    # found by a change: the size with its standard deviation is what is known beforehand of the mean after it
    assert model.parameters.items[-1].initial == one.size
    assert model.parameters.items[-1].std == added["size_std"] < one.effect.prior_scale
    theta = plain.parameters.initial
    moved = np.array(theta)
    moved[:2] += 0.1 * one.size
    np.testing.assert_allclose(model.solve([*theta, one.size], 4).frequency_hz, plain.solve(moved, 4).frequency_hz,
                               rtol=1e-12)
    np.testing.assert_allclose(model.solve([*theta, 0.0], 4).frequency_hz, plain.solve(theta, 4).frequency_hz,
                               rtol=1e-12)
    # what its members were shifted by is its own now
    before, after = ({p["name"]: p for p in found_here.content[side]["parameters"]} for side in ("before", "after"))
    assert all(before[n]["prior_shift"] < -1.5 and abs(after[n]["prior_shift"]) < 0.5 for n in ("k1", "k2"))
    assert abs(after["lower_storeys"]["map"] - one.size) < after["lower_storeys"]["std"]


def test_the_files_are_read_by_update_and_sample_with_the_same_numbers(grouped, tmp_path, validation):
    """The chain is that of `probupdate sample` on the files with the same settings."""
    row = validation(what="chain of a diagnosis on a frame: draws, means stated of them",
                     reference="`probupdate sample` on its files; the draws", why="rounding")
    *_, found_here, out = grouped
    model, mean = (out.with_name(found_here.content["files"][key]) for key in ("model", "mean"))
    after = found_here.content["after"]["parameters"]
    again = probupdate.update(model, mean)
    np.testing.assert_allclose(again.map_theta, [p["map"] for p in after], rtol=1e-4, atol=1e-5)
    asked = found_here.content["sampler"]
    settings = probupdate.SamplerSettings(seed=3, target_ess=400, max_steps=400)
    drawn = probupdate.sample(model, mean, tmp_path / "posterior.nc", settings=settings)
    kept = read_posterior(out.with_name(found_here.content["files"]["posterior"]))
    assert kept.names == drawn.names and kept.fingerprint == drawn.fingerprint
    assert asked["draws"] == len(kept.draws)
    row.error(np.array([p["mean"] for p in asked["parameters"]]) / kept.draws.mean(axis=0) - 1, 1e-12, "means")
    # a fifth of the steps of each is left out: a short chain and a long one share those from 20 to 80 % of the short
    short, long = drawn.record["steps"], kept.record["steps"]
    start = int(0.2 * long) - int(0.2 * short)
    same = drawn.theta.shape[1] - start
    assert same > 40 and short <= long
    row.equal(kept.theta[:, :same], drawn.theta[:, start:], "draws")


def test_the_chain_is_laplaces_where_that_is_close(grouped, validation):
    """Nearly Gaussian: means and standard deviations to three errors of the chain, and a tenth of a standard deviation
    for what bends."""
    row = validation(what="chain of a diagnosis on a frame, nearly Gaussian: what means and standard deviations "
                          "differ by beyond a tenth of a standard deviation", reference="Laplace's",
                     why="the tenth is for what bends", unit="errors of the chain")
    found_here = grouped[3].content
    chain = found_here["sampler"]
    assert chain["converged"] and chain["verdict"].startswith("Converged")
    assert (chain["seed"], chain["effective_draws_asked"], chain["steps_at_most"]) == (3, 400, 3000)
    assert 0.1 < chain["acceptance"] < 0.9
    laplace = {p["name"]: p for p in found_here["after"]["parameters"]}
    assert set(laplace) == {p["name"] for p in chain["parameters"]}
    for p in chain["parameters"]:
        own, error = laplace[p["name"]], 1 / np.sqrt(p["effective_draws"])
        assert p["effective_draws"] >= 400 and p["r_hat"] < 1.01
        beyond = np.maximum(0, np.abs([(p["mean"] - own["map"]) / own["std"], np.log(p["std"] / own["std"])]) - 0.1)
        row.error(beyond[0] / error, 3, "means", case=p["name"])
        row.error(beyond[1] * np.sqrt(2) / error, 3, "standard deviations", case=p["name"])
        width = p["q95"] - p["q05"]
        # 3.29 standard deviations; a quantile at 5 % is known to 2.1 errors of a mean
        assert p["q05"] < p["q50"] < p["q95"] and abs(width / p["std"] - 3.29) < 0.1 + 3 * 2.1 * np.sqrt(2) * error
    words = found_here["statements"]
    assert any("asked for 400 effective draws in at most 3000 steps" in s for s in words)
    assert any("approximation agree" in s for s in words) and not any("not converged" in s for s in words)


@pytest.mark.long
def test_a_chain_that_stops_too_early_says_so(grouped):
    prepared, data, outcome, *_ = grouped
    one, same = (extend(prepared, outcome, data, sampler=SamplerSettings(seed=5, target_ess=10**6, max_steps=60))
                 for _ in range(2))
    assert one.content["sampler"] == same.content["sampler"]
    assert one.content["sampler"]["converged"] is False and one.content["files"]["posterior"] is None
    assert any("wanted 1000000" in s for s in one.content["statements"])
    assert any(s.startswith("the chain has not converged") for s in one.content["statements"])


@pytest.mark.parametrize(("error", "words"), [
    (ConvergenceError("a basis of 240 vectors is not enough"), "240 vectors"),
    (ValueError("Probability function returned NaN"), "ValueError: Probability"),
])
def test_a_sampler_that_fails_leaves_the_findings(grouped, monkeypatch, tmp_path, error, words):
    def fails(*_, **__):
        raise error

    monkeypatch.setattr(extension_sampling, "sample_posterior", fails)
    prepared, data, outcome, before, _ = grouped
    found_here = extend(prepared, outcome, data, tmp_path / "d.json", sampler=SamplerSettings())
    assert found_here.content["after"] == before.content["after"] and found_here.model == "d.model.toml"
    assert words in found_here.content["sampler"]["refused"] and found_here.content["files"]["posterior"] is None
    assert any("gave no posterior" in s and words in s for s in found_here.content["statements"])
    assert not (tmp_path / "d.posterior.nc").exists()


def test_where_the_chain_and_laplace_part_is_said_with_how_much():
    chain = {"asked": True, "converged": True, "command": "", "draws": 4000, "walkers": 10, "acceptance": 0.4,
             "effective_draws_asked": 200, "steps_at_most": 400, "verdict": "Converged.", "laplace_check": "close",
             "parameters": [
                 {"name": "near", "mean": 1.04, "std": 0.1, "effective_draws": 400.0},
                 {"name": "shifted", "mean": 1.2, "std": 0.1, "effective_draws": 400.0},
                 {"name": "wide", "mean": 1.0, "std": 0.2, "effective_draws": 400.0},
                 # a shift of 0.8 standard deviations is no more than nine effective draws may show
                 {"name": "few", "mean": 1.08, "std": 0.1, "effective_draws": 9.0},
                 {"name": "stuck", "mean": 1.0, "std": 0.0, "effective_draws": float("nan")}]}
    laplace = [{"name": p["name"], "map": 1.0, "std": 0.1} for p in chain["parameters"]]
    said = extension_sampling.sampler_statements(chain, laplace)[2:]
    assert said == [
        "shifted: sampled, its mean 1.2 is 2.0 standard deviations above the maximum 1",
        "wide: sampled, its standard deviation 0.2 is 2.00 times Laplace's 0.1",
        "stuck: not sampled, as its walkers did not move",
    ]


def test_one_that_was_there_throughout_keeps_the_catalogues_prior():
    effect = next(r for r in turbine_effects(read_description(reference_model("updated"))) if
                  r.adds.name == "brace_BC_2")
    constant = TimeProfile(kind="constant", value=np.ones(4))
    kept = describe_parameter(effect.adds, IncludedEffect(effect=effect, time_profile=constant, size=-0.6), 0.05)
    assert (kept.initial, kept.std) == (None, effect.adds.std) and DIAGNOSED not in kept.description


def test_a_size_that_the_mean_tells_otherwise_is_said_with_both():
    # found as a change, which is its prior's centre: the mean moves it by 3.7 standard deviations
    row = {"name": "mass", "prior": 24513.0, "map": 5726.0, "std": 5133.0, "at_bound": False}
    one = {"as": "parameter", "parameter": "mass", "time_profile": "step", "size": 24513.0, "size_std": 2569.0}
    (words,) = size_statements([one], [row])
    assert "2.451e+04 +- 2.6e+03" in words and "5726 +- 5.1e+03" in words and "as a change" in words
    assert not size_statements([one], [row | {"map": 20000.0}])
    # a leg of 0.72 throughout that the mean leaves whole, at its bound, with nearly the prior's standard deviation
    (words,) = size_statements([one | {"size": -0.28, "size_std": 0.03, "time_profile": "constant"}],
                               [{"name": "mass", "prior": 1.0, "map": 1.0, "std": 0.26, "at_bound": True}])
    assert "found as -0.28 +- 0.03, but 0 +- 0.26, at a bound, by the update of the mean" in words
    assert not size_statements([one | {"time_profile": "covariate"}], [row])
    assert not size_statements([one | {"as": "other"}], [row])
