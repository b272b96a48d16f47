"""The model and the data with findings in them: files that load, sets that are corrected, commands that run."""

import json
import shlex
import shutil
from dataclasses import replace

import numpy as np
import pytest

import probupdate
from probupdate.cli import main
from probupdate.diagnosis.diagnose import examine
from probupdate.diagnosis.extension import (
    correct_sensors,
    corrections,
    describe_parameter,
    extend,
    mean_set,
)
from probupdate.diagnosis.prepare import prepare
from probupdate.diagnosis.problem import IncludedEffect, diagnosis_problem
from probupdate.diagnosis.proposals import sharpen_time
from probupdate.diagnosis.time_profiles import TimeProfile, step_profile
from probupdate.effects.catalogue import Delay, Effect, Gain, Rate, Turn
from probupdate.effects.turbine import turbine_effects
from probupdate.modal.modes import mac, read_modes
from probupdate.structure.description_file import read_description
from probupdate.structure.extend import extended_model, write_extended
from probupdate.structure.load import load_model, reference_model
from probupdate.updating.identifiability import DIAGNOSED


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
    later = outcome.problem.blocks.select_blocks(np.arange(18, 40))
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


def test_a_wrong_gain_is_taken_out_of_the_sets_and_an_update_fits_them(prepared, record, tmp_path):
    data = record(8, gain=("y4", 1.15))
    out = tmp_path / "run" / "diagnosis.json"
    found = probupdate.diagnose(prepared, data, out=out)
    content = json.loads(found.write(out)[0].read_text())
    assert content["extended_model"] is None and content["extension"]["files"]["model"] is None
    again = read_modes(out.with_name(content["extension"]["files"]["modes"]))
    ratio = again.sets[0].shape[data.channels.index("y4")] / data.sets[0].shape[data.channels.index("y4")]
    (added,) = content["extension"]["added"]
    np.testing.assert_allclose(ratio, 1 / (1 + added["size"]), rtol=1e-9)
    assert abs(added["size"] - content["findings"][0]["size"]) < 0.3 * content["findings"][0]["size_std"]
    untouched = [k for k, c in enumerate(data.channels) if c != "y4"]
    np.testing.assert_array_equal(again.sets[0].shape[untouched], data.sets[0].shape[untouched])
    assert content["extension"]["joint"]["findings"][0]["identified"] is True
    assert any(s.startswith("the other parameters move ") for s in content["extension"]["statements"])
    # the mean's file is what an update or a chain starts from: fifteen standard deviations of one per cent on one row
    # of four shapes less than of a mean in which the gain still is
    mean = read_modes(out.with_name(content["extension"]["files"]["mean"]))
    wrong = replace(mean, sets=tuple(replace(s, shape=s.shape * ratio_of(data.channels, "y4", 1 + added["size"]))
                                     for s in mean.sets))
    right, off = (probupdate.update(prepared.path, one).map_misfit for one in (mean, wrong))
    assert right < off - 10


def ratio_of(channels, channel, factor):
    return np.where(np.array(channels) == channel, factor, 1.0)[:, None]


@pytest.mark.long
def test_the_commands_that_are_said_run_where_the_parameters_lie_elsewhere(frame_file, record, tmp_path):
    model, parameters = tmp_path / "a model" / "frame.npz", tmp_path / "priors.toml"
    model.parent.mkdir()
    shutil.copy(frame_file, model)
    shutil.copy(frame_file.with_suffix(".toml"), parameters)
    found = probupdate.diagnose(model, record(8, gain=("y4", 1.15)), parameters=parameters, out=tmp_path / "d.json")
    (program, *update), (same, *sample) = map(shlex.split, found.extension["commands"])
    assert program == same == "probupdate" and main(update) == 0
    assert main([*sample, "--ess", "50", "--max-steps", "100"]) == 0
    assert (tmp_path / "d.update.json").is_file() and (tmp_path / "d.posterior.nc").is_file()


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


# A group as one parameter ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def grouped(frame_file, record, tmp_path_factory):
    """(prepared, data, outcome, extension, out): the two lowest storeys loosen by a tenth from block 18 on, and their
    group is a candidate."""
    prepared = prepare(frame_file, groups={"lower storeys": {"k1": 0.1, "k2": 0.1}})
    data = record(4, storey=slice(0, 2), factor=0.9, from_block=18)
    outcome = examine(prepared, data)
    out = tmp_path_factory.mktemp("grouped") / "diagnosis.json"
    found_here = extend(prepared, outcome, data, out)
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
    before, after = ({p["name"]: p[key] for p in outcome.diagnosis.parameters}
                     for key in ("prior_shift", "prior_shift_after"))
    assert all(abs(after[n]) < abs(before[n]) and abs(after[n]) < 0.5 for n in ("k1", "k2"))
    # and an update of the files gives the group the size that was found
    mean = out.with_name(found_here.content["files"]["mean"])
    again = probupdate.update(out.with_name(found_here.model), mean)
    assert abs(again.map_theta[-1] - one.size) < added["size_std"]


def test_one_that_was_there_throughout_keeps_the_catalogues_prior():
    effect = next(r for r in turbine_effects(read_description(reference_model("updated"))) if
                  r.adds.name == "brace_BC_2")
    constant = TimeProfile(kind="constant", value=np.ones(4))
    kept = describe_parameter(effect.adds, IncludedEffect(effect=effect, time_profile=constant, size=-0.6), 0.05)
    assert (kept.initial, kept.std) == (None, effect.adds.std) and DIAGNOSED not in kept.description
