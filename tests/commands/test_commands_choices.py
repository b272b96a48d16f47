"""Parameters that are held and modes that are chosen, on the command line and in Python."""

import json

import numpy as np
import pytest
from command_cases import GROUPS, true_modes, write_building

import probupdate
from probupdate.cli import main
from probupdate.structure.functions import FunctionModel
from probupdate.structure.load import load_model, reference_model
from probupdate.updating.update_file import read_update


def arguments(building, *more) -> list[str]:
    return ["update", "--model", building["model"], "--modes", building["modes"], *more,
            "--out", str(building["folder"] / "new.json")]


def test_a_parameter_is_held_at_its_value(building, capsys):
    assert main(arguments(building, "--fix", "middle=0.15")) == 0
    record = read_update(building["folder"] / "new.json")
    assert record.parameters.names == ("low", "high") and record.parameters.held == (("middle", 0.15),)
    assert "held: middle at 0.15" in capsys.readouterr().out
    # the model as it was held: the same modes by a dense solver
    theta = dict(zip(record.parameters.names, record.map_theta, strict=True)) | {"middle": 0.15}
    exact, _ = true_modes([theta[name] for name in GROUPS])
    assert np.sort(record.map_hz) == pytest.approx(exact[:4], rel=1e-9)


@pytest.mark.long
def test_a_run_with_a_held_parameter_goes_on_to_the_report(building):
    out = building["folder"]
    first, again = (probupdate.update(building["model"], building["modes"],
                                      likelihood=probupdate.LikelihoodSettings(fix={"middle": x})) for x in (0.15, 0.1))
    first.write(out / "update.json")
    assert again.fingerprint != read_update(out / "update.json").fingerprint
    assert main(["report", str(out), "--out", str(out / "report.html")]) == 0


def test_a_turbines_parameter_is_held_at_its_value():
    own = load_model(reference_model())
    value = own.parameters.initial[own.parameters.index("m_h")] * 1.1
    held = load_model(reference_model(), parameters=own.parameters.hold_parameters({"m_h": value}))
    theta = np.array(own.parameters.initial)
    theta[own.parameters.index("m_h")] = value
    expected = own.solve(theta, 4).frequency_hz
    assert held.solve(held.parameters.initial, 4).frequency_hz == pytest.approx(expected, rel=1e-10)


def test_a_functions_parameter_is_held(tmp_path):
    write_building(tmp_path)
    own = load_model(tmp_path / "model.npz")
    model = FunctionModel(name="building", parameters=own.parameters, channels=own.channels, version="1",
                          function=lambda t: true_modes(t))
    held = probupdate.LikelihoodSettings(fix={"low": -0.2})
    record, other = (probupdate.update(m, tmp_path / "modes.json", likelihood=held)
                     for m in (model, tmp_path / "model.npz"))
    assert record.map_theta == pytest.approx(other.map_theta, abs=1e-3)


@pytest.mark.parametrize("choice", (["2,1"], ["1", "2"], ["--modes", "1,2"]))
def test_modes_are_chosen_behind_their_file(building, choice):
    assert main(["update", "--model", building["model"], "--modes", building["modes"], *choice, "--out",
                 str(building["folder"] / "new.json")]) == 0
    record = read_update(building["folder"] / "new.json")
    assert record.measured_hz.size == 2
    assert record.map_hz == pytest.approx(record.measured_hz, rel=0.02)


def test_what_data_inform_is_asked_with_both_choices(building, capsys):
    assert main(["inform", "--model", building["model"], "--modes", building["modes"], "1,2,3", "--fix", "high=0.05",
                 "--json", "--out", str(building["folder"] / "new.json")]) == 0
    rows = json.loads(capsys.readouterr().out)["table"]["rows"]
    assert "high" not in json.dumps(rows)


@pytest.mark.parametrize("more, words", (
    (["--fix", "lov=0.1"], "fix, lov: is not an updated parameter; did you mean 'low'?"),
    (["--fix", "low=2"], "fix, low: 2 is outside its bounds; give a value from -0.6 to 0.6"),
    (["--fix", "low"], "low is no NAME=VALUE with a number"),
    (["--fix", "low=nan"], "low=nan is no NAME=VALUE with a number"),
    (["--fix", "low=0.1", "--fix", "low=0.2"], "--fix low: is given two values"),
    (["--fix", "low=0", "middle=0", "high=0"], "fix: no parameter is left to update"),
    (["--modes", "FA1"], "mode FA1: is to be compared, but there is none of that label; there are 1, 2, 3, 4"),
))
def test_choices_of_what_is_not_there_name_what_is(building, refused, more, words):
    assert words in refused(*arguments(building, *more))


def test_labels_without_a_file_are_refused(building, refused):
    words = refused("update", "--model", building["model"], "--modes", "FA1,SS1", "--out", building["folder"] / "x")
    assert "--modes FA1,SS1: names no file" in words


def test_a_correlated_parameter_is_not_held_alone(building, refused):
    with open(building["parameters"], "a") as file:
        file.write("[correlation.low]\nmiddle = 0.5\n")
    assert "its prior is correlated with that of middle" in refused(*arguments(building, "--fix", "low=0"))
    assert main(arguments(building, "--fix", "low=0", "middle=0")) == 0
