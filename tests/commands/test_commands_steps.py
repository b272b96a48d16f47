"""The steps on three forms of model, what they write, and going on after an interruption."""

from __future__ import annotations

import json
import operator
import re
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from command_cases import CHANNELS, N_FLOOR, TRUTH, true_modes
from small_turbine import SENSORS, small_turbine

import probupdate
from probupdate import demonstration
from probupdate.cli import build_parser, main
from probupdate.errors import InputError
from probupdate.structure.functions import FunctionModel
from probupdate.structure.load import load_model
from probupdate.structure.parameter_table import read_parameters
from probupdate.updating.posterior_file import GROUPS, read_posterior, write_posterior
from probupdate.updating.update_file import read_update

BRIDGE = Path(__file__).resolve().parents[3] / "shared" / "data" / "footbridge"
STUDY = Path(__file__).resolve().parents[2] / "studies" / "footbridge"


# The commands and their options -------------------------------------------------------------------------------------

OPTIONS = {
    "demo": {"--seed"}, "simulate": {"--model", "--days", "--truth", "--seed"}, "check": {"--model"},
    "identify": {"--model", "--out"}, "select": {"--scada", "--out"}, "update": {"--model", "--modes", "--out"},
    "sample": {"--model", "--modes", "--out", "--seed"}, "compare": {"--out", "--model"}, "report": {"--out"},
    "diagnose": {"--model", "--modes", "--campaign", "--groups", "--no-extend", "--out", "--seed",
                 "--without"},
}


@pytest.mark.parametrize("verb", OPTIONS)
def test_every_command_has_its_options_its_help_and_its_function(verb, capsys):
    with pytest.raises(SystemExit) as end:
        build_parser().parse_args([verb, "--help"])
    assert end.value.code == 0
    found = set(re.findall(r"--[a-z-]+", capsys.readouterr().out))
    assert found >= OPTIONS[verb] | {"--help"}
    assert callable(getattr(probupdate, verb))


def test_a_model_file_that_is_no_text_is_one_line(tmp_path):
    (tmp_path / "model.toml").write_bytes(b"\xff\xfe\x00bad")
    content = {"channels": ["a", "b"], "sets": [{"id": "one", "frequency_hz": [1.0], "damping_ratio": [0.01],
               "shape_re": [[1.0, 0.5]], "shape_im": [[0.0, 0.0]]}]}
    (tmp_path / "modes.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"model\.toml: not TOML"):
        probupdate.update(tmp_path / "model.toml", tmp_path / "modes.json")


@pytest.mark.parametrize(("typed", "extended"), [([], True), (["--no-extend"], False)])
def test_diagnose_extends_the_model_unless_it_is_told_not_to(typed, extended, monkeypatch, tmp_path):
    given = {}

    def diagnose(model, modes, **options):
        given.update(options)
        raise InputError("modes", "are not asked", "stop here")

    monkeypatch.setattr(probupdate, "diagnose", diagnose)
    assert main(["diagnose", "--modes", "modes.json", "--out", str(tmp_path / "d.json"), "--seed", "4", *typed]) == 2
    assert given["extend"] is extended and given["seed"] == 4


def test_import_stays_light():
    code = "import sys, probupdate; print([m for m in ('arviz', 'matplotlib', 'pandas', 'emcee') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


# Matrices: the whole way --------------------------------------------------------------------------------------------


def test_matrices_find_the_building_that_was_measured(estimated, validation):
    """Truth within four standard deviations of both estimates, which the 1 in 10^4 of a Gaussian allows; modes by
    MAC."""
    row = validation(what="posterior standard deviations of a shear building, near-linear", reference="Laplace",
                     why="a few hundred effective draws")
    record, posterior = read_update(estimated / "update.json"), read_posterior(estimated / "posterior.nc")
    std = np.sqrt(np.diag(record.map_covariance))
    assert np.all(np.abs(record.map_theta - TRUTH) < 4 * std)
    assert np.all(np.abs(posterior.draws.mean(axis=0) - TRUTH) < 4 * posterior.draws.std(axis=0))
    # near-linear problem: the Laplace standard deviations are the posterior's
    row.error(posterior.draws.std(axis=0) / std - 1, below=0.2)
    # the file's second column is the first mode
    assert list(record.computed_mode) == [2, 1, 3, 4]


def test_arviz_opens_the_posterior(estimated):
    import arviz

    data = arviz.from_netcdf(str(estimated / "posterior.nc"))
    posterior = read_posterior(estimated / "posterior.nc")
    # ArviZ before 1 has an InferenceData with a method, later ones have xarray's tree, whose children are the groups
    assert set(GROUPS) <= set(data.groups() if "InferenceData" in vars(arviz) else data.children)
    assert set(data["posterior"].data_vars) == {"low", "middle", "high"}
    middle, ensembles = data["posterior"]["middle"].values, posterior.record["ensembles"]
    assert np.array_equal(middle, posterior.theta[:, :, 1].reshape(ensembles, -1))
    assert data["log_likelihood"]["response"].shape == middle.shape


def test_arvizs_summary_has_the_verdicts_r_hat(estimated, validation):
    row = validation(what="R-hat of `arviz.summary` on posterior.nc", reference="the verdict's nested R-hat",
                     why="ArviZ splits each ensemble in two; walkers as chains give 0.02 to 0.05 more")
    import arviz

    data, posterior = arviz.from_netcdf(str(estimated / "posterior.nc")), read_posterior(estimated / "posterior.nc")
    shown = arviz.summary(data)
    row.error(shown["r_hat"].astype(float) - posterior.r_hat, below=0.0075)
    # of walkers as chains, on which the verdict's is
    own = np.array([float(arviz.ess(data["posterior"][name].values)) for name in posterior.names])
    assert np.all((own > 0.8 * posterior.ess) & (own < 1.6 * posterior.ess))


def test_posterior_round_trip(estimated, tmp_path):
    first = read_posterior(estimated / "posterior.nc")
    again = read_posterior(write_posterior(first, tmp_path / "again.nc"))
    for name in first.__dataclass_fields__:
        one, two = getattr(first, name), getattr(again, name)
        if name == "model_error":
            one, two = one.to_table(), two.to_table()
        same = np.array_equal(one, two, equal_nan=True) if isinstance(one, np.ndarray) and one.dtype.kind == "f" else (
            np.array_equal(one, two) if isinstance(one, np.ndarray) else one == two)
        assert same, name
        assert not isinstance(two, np.ndarray) or not two.flags.writeable


# A callable ---------------------------------------------------------------------------------------------------------


@pytest.mark.numbers
def test_a_callable_gives_what_the_matrices_give(estimated, tmp_path):
    function = FunctionModel(
        name="building", parameters=read_parameters(estimated / "parameters.toml"), channels=CHANNELS,
        function=true_modes, version="1",
    )
    modes, here = estimated / "modes.json", read_update(estimated / "update.json")
    record = probupdate.update(function, modes)
    # derivatives by differences: they steer the iteration, its end is where the residual's projection vanishes
    assert np.allclose(record.map_theta, here.map_theta, atol=1e-3 * np.sqrt(np.diag(here.map_covariance)))
    assert record.map_misfit == pytest.approx(here.map_misfit, rel=1e-6)
    posterior = probupdate.sample(
        function, modes, tmp_path / "p.nc", settings=probupdate.SamplerSettings(max_steps=200))
    drawn, other = posterior.draws, read_posterior(estimated / "posterior.nc").draws
    # two chains of some hundred effective draws: means within 0.3 standard deviations
    assert np.all(np.abs(drawn.mean(axis=0) - other.mean(axis=0)) < 0.3 * other.std(axis=0))
    assert len(true_modes(TRUTH)[0]) == N_FLOOR


# A turbine's model.toml ---------------------------------------------------------------------------------------------


def toml(value) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k} = {toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value)


UPDATED = ("k_t", "py", "m_h")
TURBINE_TRUTH = {"k_t": 1.10, "py": 0.85, "m_h": 63000.0}


@pytest.fixture(scope="module")
def turbine(tmp_path_factory):
    """model.toml of the small turbine with three updated parameters, and modes of it at the truth."""
    folder = tmp_path_factory.mktemp("turbine")
    raw = small_turbine()
    for table in raw["parameter"]:
        table["update"] = table["name"] in UPDATED
    (folder / "model.toml").write_text("".join(f"{key} = {toml(value)}\n" for key, value in raw.items()))
    model = load_model(folder / "model.toml")
    theta = np.array([TURBINE_TRUTH[name] for name in model.parameters.names])
    solution = model.solve(theta, 4)
    shape = solution.shape / np.max(np.abs(solution.shape), axis=0)
    (folder / "modes.json").write_text(json.dumps({
        "channels": [s[0] for s in SENSORS],
        "sets": [{"id": "a", "frequency_hz": solution.frequency_hz.tolist(), "shape_re": shape.T.tolist(),
                  "frequency_std_hz": (0.005 * solution.frequency_hz).tolist()}],
    }))
    return folder


def test_a_turbine_through_every_step(turbine):
    """Modes without noise: both estimates hold the truth within their standard deviations, the report has it all."""
    problem = ["--model", str(turbine / "model.toml"), "--modes", str(turbine / "modes.json")]
    update, posterior = str(turbine / "update.json"), str(turbine / "posterior.nc")
    assert main(["update", *problem, "--out", update]) == 0
    assert main(["sample", *problem, "--out", posterior, "--ess", "50", "--max-steps", "200"]) == 0
    assert main(["compare", update, posterior, *problem[:2], "--out", str(turbine / "compare.json")]) == 0
    record, drawn = read_update(update), read_posterior(posterior)
    truth = np.array([TURBINE_TRUTH[name] for name in drawn.names])
    assert np.all(np.abs(record.map_theta - truth) < 2 * np.sqrt(np.diag(record.map_covariance)))
    assert np.all(np.abs(drawn.draws.mean(axis=0) - truth) < 3 * drawn.draws.std(axis=0))
    # --model brings the pile head's stiffness over the posterior
    compared = json.loads((turbine / "compare.json").read_text())
    # py is updated, the axial soil is not
    across, along = compared["derived"]["k_xy"], compared["derived"]["k_z"]
    assert 0.01 < across["cov"] < 0.5 and abs(across["mean"] / across["map"] - 1) < 2 * across["cov"]
    assert along["cov"] < 1e-9 and along["mean"] == pytest.approx(along["map"], rel=1e-9)
    assert main(["report", str(turbine), "--out", str(turbine / "report.html")]) == 0
    page = (turbine / "report.html").read_text(encoding="utf-8")
    assert all(name in page for name in UPDATED)


# Going on after an interruption -------------------------------------------------------------------------------------


@pytest.mark.numbers
def test_a_killed_chain_goes_on_with_the_same_numbers(estimated, tmp_path):
    for name in ("model.npz", "parameters.toml", "modes.json"):
        shutil.copy(estimated / name, tmp_path)
    out = tmp_path / "posterior.nc"
    command = ["sample", "--model", str(tmp_path / "model.npz"), "--modes", str(tmp_path / "modes.json"), "--out",
               str(out), "--ess", "100", "--max-steps", "400"]
    running = subprocess.Popen([sys.executable, "-m", "probupdate.cli", *command], stdout=subprocess.DEVNULL,
                               stderr=subprocess.DEVNULL)
    segment = tmp_path / "posterior.nc.chain" / "segment-00000.npz"
    end = time.monotonic() + 120
    while not segment.exists() and running.poll() is None and time.monotonic() < end:
        time.sleep(0.005)
    running.send_signal(signal.SIGKILL)
    assert running.wait() == -signal.SIGKILL
    assert segment.exists() and not out.exists()
    written = segment.stat().st_mtime_ns
    assert main(command) == 0
    assert segment.stat().st_mtime_ns == written
    whole, resumed = read_posterior(estimated / "posterior.nc"), read_posterior(out)
    assert np.array_equal(whole.theta, resumed.theta)
    assert np.array_equal(whole.log_posterior, resumed.log_posterior)


class Step:
    """A step's result that writes nothing but a mark."""

    def __init__(self, name):
        self.summary = name

    def write(self, path):
        Path(path).write_text(json.dumps({"extension": {"files": {"model": "with.toml", "mean": "mean.json"}}}))

    def content(self):
        return {"findings": []}


def test_a_demonstration_started_again_repeats_no_finished_step(tmp_path, monkeypatch):
    done, broken, given = [], {"sample"}, {}

    def step(name):
        def run(*arguments, **options):
            if name in broken:
                raise KeyboardInterrupt
            done.append(name)
            given[name] = [Path(a).name for a in arguments[:2]]
            return Step(name)

        return run

    for name in ("simulate", "identify", "select", "update", "sample", "diagnose", "compare"):
        monkeypatch.setattr(demonstration.verbs, name, step(name))
    monkeypatch.setattr(demonstration, "report_with_conclusion", lambda run, out, jobs, progress: (Path(out), ["so"]))
    monkeypatch.setattr(demonstration, "read_modes", lambda path: SimpleNamespace(set=lambda: SimpleNamespace(id="a")))
    monkeypatch.setattr(demonstration, "stated_likelihood",
                        lambda model, modes, progress: probupdate.LikelihoodSettings())
    out = tmp_path / "demo"
    with pytest.raises(KeyboardInterrupt):
        probupdate.demo(out, seed=3)
    # the paper's weights first, on the model as built
    assert done == ["simulate", "identify", "select", "update", "diagnose", "update"]
    broken.clear()
    finished = probupdate.demo(out, seed=3)
    assert done == ["simulate", "identify", "select", "update", "diagnose", "update", "sample", "compare"]
    # both estimators are given the model and the mean with the findings in them, and the report that model
    assert given["diagnose"] == ["model.toml", "modes.json"]
    assert given["update"] == given["sample"] == ["with.toml", "mean.json"]
    assert json.loads((out / "run.json").read_text())["model"] == "with.toml"
    assert finished.summary.splitlines()[1] == "so"
    with pytest.raises(InputError, match="whose seed is"):
        probupdate.demo(out, seed=4)
    with pytest.raises(InputError, match="in which something else is hidden"):
        probupdate.demo(out, seed=3, hide="none")
    with pytest.raises(InputError, match="shorter than one block"):
        probupdate.demo(tmp_path / "short", days=0.01)
    assert not (tmp_path / "short").exists()
    with pytest.raises(InputError, match="is not a file"):
        probupdate.demo(tmp_path / "other", hide=tmp_path / "missing.toml")


def _steps(folder: Path, said: list[str]) -> demonstration._Steps:
    folder.mkdir(exist_ok=True)
    return demonstration._Steps(demonstration.RunState(folder, {"seed": 1}), said.append)


def test_steps_side_by_side_are_reported_in_their_order(tmp_path):
    said: list[str] = []
    steps = _steps(tmp_path / "demo", said)

    def diagnose(progress):
        deadline = time.monotonic() + 120
        while not steps._state.done("select") and time.monotonic() < deadline:
            progress("searching", 0, 1)
            time.sleep(0.01)
        # what ran beside it is known to be finished before it ends itself
        assert steps._state._content["finished"] == ["select", "paper"]
        return "found"

    work = {"select": (operator.add, "sel", "ected"), "paper": (operator.add, "pa", "per"), "diagnose": (diagnose,)}
    steps.side_by_side(work, 2, lambda *_: None)
    heads = [re.findall(r"\[(\d)/9\] (\w+)", text)[0] for text in said[1:]]
    assert heads == [("3", "select"), ("4", "paper"), ("5", "diagnose")]
    assert [text.splitlines()[2] for text in said[1:]] == ["selected", "paper", "found"]
    # whichever ended first
    assert steps._state._content["finished"] == ["select", "paper", "diagnose"]
    # one taken up between the two: what was finished comes first
    (tmp_path / "half").mkdir()
    said.clear()
    steps = _steps(tmp_path / "half", said)
    steps._state.finish("select")
    steps.side_by_side(work | {"diagnose": (lambda progress: "found",)}, 2, lambda *_: None)
    assert [re.findall(r"\[(\d)/9\]", text)[0] for text in said] == ["3", "4", "4", "5"]
    # a finished folder, with either number of jobs
    for jobs in (1, 2):
        again: list[str] = []
        _steps(tmp_path / "demo", again).side_by_side(work, jobs, lambda *_: None)
        assert again == [f"[{k}/9] {name}: finished before" for k, name in enumerate(work, 3)]


def test_an_error_of_a_step_beside_ends_the_others_at_once(tmp_path):
    steps = _steps(tmp_path / "demo", [])

    def diagnose(progress):
        deadline = time.monotonic() + 120
        while time.monotonic() < deadline:
            progress("searching", 0, 1)
            time.sleep(0.01)
        return "found"

    work = {"update": (operator.truediv, 1, 0), "sample": (time.sleep, 600), "diagnose": (diagnose,)}
    begun = time.monotonic()
    with pytest.raises(ZeroDivisionError):
        steps.side_by_side(work, 2, lambda *_: None)
    assert time.monotonic() - begun < 110 and steps._state._content["finished"] == []


def test_what_was_hidden_stands_beside_what_was_found():
    words = demonstration.hidden_and_found_words(demonstration.hidden_text("default", 2.0), Step("diagnose"))
    assert words.splitlines() == [
        "hidden in this campaign:", "  leg stiffness, leg B, bay 4: factor 0.75, from hour 24 on",
        "  sensor gain, channel TP-C-y: factor 1.15, all through the record", "found by the diagnosis:",
        "  nothing with a name"]
    assert "nothing" in demonstration.hidden_and_found_words(demonstration.hidden_text("none", 1.0), Step("diagnose"))


@pytest.mark.long
def test_the_demonstration_against_its_truth(tmp_path, validation, capsys):
    """What was hidden is found, both estimators are given the model with it, and the truth lies inside.

    Of n independent intervals of 90 % all but two hold the truth in 90 cases of a hundred and more; the parameters are
    of one posterior, and the virtual turbine has other elements and another soil law than the model."""
    row = validation(what="demonstration (long): sizes of the hidden effects; worst distance of the truth from the "
                          "posterior's mean; parameters whose 90 % interval leaves the truth out",
                     reference="truth.toml of the virtual turbine", why="statistical", unit="standard deviations")
    out = tmp_path / "demo"
    assert main(["demo", str(out)]) == 0
    assert (out / "report.html").stat().st_size > 100_000
    diagnosis = json.loads((out / "diagnosis.json").read_text())
    found = diagnosis["findings"]
    assert [(f["cause"], f["location"]) for f in found] == [
        ("leg stiffness lost", "leg B, bay 4"), ("sensor gain", "TP-C-y")]
    row.error([(f["size"] - true) / f["size_std"] for f, true in zip(found, (-0.25, 0.15), strict=True)], 3, "sizes")
    assert all(f["gain"]["significant"] for f in found)
    posterior, updated = read_posterior(out / "posterior.nc"), read_update(out / "update.json")
    assert posterior.converged and posterior.names == updated.parameters.names and "leg_B_4" in posterior.names
    assert posterior.fingerprint == updated.fingerprint and "model discrepancy" in updated.settings["weights"]
    truth = tomllib.loads((out / "campaign" / "truth.toml").read_text())["parameters"] | {"leg_B_4": 0.75}
    draws, true = posterior.draws, np.array([truth[name] for name in posterior.names])
    row.error((draws.mean(axis=0) - true) / draws.std(axis=0), 3, "truth")
    low, high = np.percentile(draws, [5, 95], axis=0)
    row.error(float(np.sum((true < low) | (true > high))), 2, "outside")
    # those that the data identify are known much better than with the paper's weights, which are there beside them
    paper = read_update(out / "paper.json")
    k, own = paper.parameters.index("k_t"), posterior.names.index("k_t")
    assert draws[:, own].std() < 0.5 * np.sqrt(paper.map_covariance[k, k])
    # screen and page end with the same answer
    said = capsys.readouterr().out
    assert "Faults identified: leg stiffness lost, leg B, bay 4" in said and "Do not rely" not in said
    assert "Parameters to use, with their intervals:" in said


@pytest.mark.long
def test_the_demonstration_with_nothing_hidden_names_nothing(tmp_path):
    assert main(["demo", str(tmp_path / "demo"), "--hide", "none"]) == 0
    found = json.loads((tmp_path / "demo" / "diagnosis.json").read_text())
    assert (found["verdict"], found["findings"]) == ("none", [])


# The measured footbridge --------------------------------------------------------------------------------------------


def footbridge(tmp_path, *options):
    out = tmp_path / "update.json"
    assert main(["update", "--model", str(BRIDGE / "model.npz"), "--parameters", str(STUDY / "parameters.toml"),
                 "--modes", str(BRIDGE / "modes.json"), "--iterations", "20", "--out", str(out), *options]) == 0
    return read_update(out)


@pytest.mark.numbers
@pytest.mark.skipif(not BRIDGE.is_dir(), reason="the footbridge's data are not beside the repository")
def test_footbridge_with_a_stated_error_comes_near_the_published_update(tmp_path, validation):
    """Otsuki et al. 2022: -0.716 for the lateral support y1; the vertical ones z1 and z2 are hardly identified."""
    row = validation(what="measured footbridge, 1 % of every frequency stated as the model's error: y1; width of z1 "
                          "and z2 over their prior's", reference="Otsuki et al. 2022: -0.716; hardly identified",
                     why="their three objectives differ by it")
    record = footbridge(tmp_path, "--discrepancy", "0.01")
    k = {name: record.parameters.index(name) for name in ("y1", "z1", "z2")}
    width = np.sqrt(np.diag(record.map_covariance)) / record.parameters.std
    row.error(record.map_theta[k["y1"]] + 0.716, below=0.10, of="y1")
    row.least([width[k["z1"]], width[k["z2"]]], above=0.5, of="width")
    assert record.map_misfit < record.n_effective


@pytest.mark.numbers
@pytest.mark.skipif(not BRIDGE.is_dir(), reason="the footbridge's data are not beside the repository")
def test_footbridge_by_default_says_not_to_rely_on_its_parameters(tmp_path):
    """Its shapes and frequencies ask for different supports: 6 % of a frequency is learnt of the model's error."""
    record = footbridge(tmp_path)
    assert "not to be trusted" in record.summary
    assert "model discrepancy" in record.settings["weights"]


@pytest.mark.long
@pytest.mark.numbers
@pytest.mark.skipif(not BRIDGE.is_dir(), reason="the footbridge's data are not beside the repository")
def test_footbridge_with_the_measurements_error_alone_flags_what_is_pinned(tmp_path, validation):
    row = validation(what="measured footbridge with its own standard deviations alone (long): order of modes; least "
                          "MAC at the design values; misfit over the effective responses; those at a bound",
                     reference="studies/footbridge", why="the model misses the data, and says so")
    record = footbridge(tmp_path, "--no-tolerances", "--discrepancy", "0")
    # the lowest measured mode is the model's second
    row.equal(list(record.computed_mode), [2, 1, 3, 4, 5], "order")
    row.least(record.initial_mac, 0.85, "MAC")
    pinned = {p.name for p, at in zip(record.parameters, record.map_at_bound, strict=True) if at}
    row.count(len({"Frame", "Conc1", "Conc2"} & pinned), 3, 3, "at a bound", case=pinned)
    for name in pinned:
        k = record.parameters.index(name)
        assert record.map_theta[k] in (record.parameters.lower[k], record.parameters.upper[k])
    # a model that misses the data, and says so
    row.least(record.map_misfit / record.n_effective, 4, "misfit")
    assert "misses the data" in record.summary


@pytest.mark.parametrize("change", ["a draw", "the verdict", "a label"])
def test_a_posterior_changed_by_hand_is_refused(estimated, tmp_path, change):
    path = tmp_path / "posterior.nc"
    shutil.copy(estimated / "posterior.nc", path)
    with h5py.File(path, "r+") as file:
        if change == "a draw":
            name = read_posterior(estimated / "posterior.nc").names[0]
            file["posterior"][name][0, 0] += 1e-9
        elif change == "the verdict":
            head = json.loads(file["posterior"].attrs["probupdate"])
            file["posterior"].attrs["probupdate"] = json.dumps(head | {"converged": not head["converged"]})
        else:
            file["observed_data"]["response_std"][0] *= 2
    with pytest.raises(InputError, match=r"posterior\.nc: was changed after it was written"):
        read_posterior(path)


def test_export_finds_the_modes_of_the_posterior_beside_selected_ones(estimated, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(estimated, run)
    # a selection with wider standard deviations, whose mean has the same name
    content = json.loads((run / "modes.json").read_text())
    for one in content["sets"]:
        one["frequency_std_hz"] = [2 * std for std in one["frequency_std_hz"]]
    (run / "nine.json").write_text(json.dumps(content))
    done = probupdate.export(run, tmp_path / "life", draws=4)
    assert not any("tolerances in models" in text for text in done.left_out)


def test_export_finds_the_modes_of_a_posterior_of_some_of_them(estimated, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(estimated, run, ignore=shutil.ignore_patterns("posterior.nc*"))
    content = json.loads((run / "modes.json").read_text())
    labels = content["labels"] = [f"X{j + 1}" for j in range(len(content["sets"][0]["frequency_hz"]))]
    (run / "modes.json").write_text(json.dumps(content))
    (model,) = (run / name for name in ("model.npz", "model.toml") if (run / name).is_file())
    assert main(["sample", "--model", str(model), "--modes", str(run / "modes.json"), ",".join(labels[:-1]), "--out",
                 str(run / "posterior.nc"), "--ess", "100", "--max-steps", "400"]) == 0
    done = probupdate.export(run, tmp_path / "life", draws=4)
    assert not any("tolerances in models" in text for text in done.left_out)


def test_export_finds_the_modes_of_a_posterior_beside_one_without_a_number(estimated, tmp_path):
    """As of a monopile's torsion, which no set holds: it was taken for a posterior of other modes."""
    run = tmp_path / "run"
    shutil.copytree(estimated, run, ignore=shutil.ignore_patterns("posterior.nc*"))
    content = json.loads((run / "modes.json").read_text())
    n = len(content["sets"][0]["frequency_hz"])
    content["labels"] = ["T9", *(content.get("labels") or [f"X{j + 1}" for j in range(n)])]
    for one in content["sets"]:
        for value in one.values():
            if isinstance(value, list) and len(value) == n:
                value.insert(0, [None] * len(content["channels"]) if isinstance(value[0], list) else None)
    (run / "modes.json").write_text(json.dumps(content))
    (model,) = (run / name for name in ("model.npz", "model.toml") if (run / name).is_file())
    assert main(["sample", "--model", str(model), "--modes", str(run / "modes.json"), "--out",
                 str(run / "posterior.nc"), "--ess", "100", "--max-steps", "400"]) == 0
    done = probupdate.export(run, tmp_path / "life", draws=4)
    assert not any("tolerances in models" in text for text in done.left_out)
