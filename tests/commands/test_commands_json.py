"""Every command prints one JSON object where it is asked to, and every step's result is a table with units."""

import argparse
import ast
import inspect
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray
from command_cases import write_building, write_campaign

import probupdate
from probupdate.cli import EXAMPLES, build_parser, main
from probupdate.io.result_table import OWN_UNIT, json_object, plain_value, table_of, with_units
from probupdate.modal.modes import CovarianceFactors, ModalData, ModalSet, read_modes, write_modes

PACKAGE = Path(probupdate.__file__).parent
KEYS = {"command", "summary", "files", "table"}


def verbs() -> dict[str, argparse.ArgumentParser]:
    return next(a for a in build_parser()._actions if isinstance(a, argparse._SubParsersAction)).choices


def class_of(name: str, module: str) -> ast.ClassDef:
    """The class that a module means by a name: its own, or the one it imports; rooms may have classes of one name."""
    path = PACKAGE.parent / f"{module.replace('.', '/')}.py"
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.ClassDef) and node.name == name:
            return node
        if isinstance(node, ast.ImportFrom) and any(alias.name == name for alias in node.names):
            return class_of(name, node.module)
    raise AssertionError(f"{module} knows no {name}")


@pytest.mark.parametrize("verb", sorted(EXAMPLES))
def test_every_command_has_json(verb):
    assert "--json" in verbs()[verb]._option_string_actions


def test_no_command_is_without_an_example():
    assert set(verbs()) == set(EXAMPLES)


def test_every_steps_result_has_a_table_and_a_summary():
    seen = set()
    for step in [name for name in probupdate.__all__ if inspect.isfunction(getattr(probupdate, name))]:
        function = inspect.unwrap(getattr(probupdate, step))
        answer = inspect.signature(function).return_annotation
        for name in str(answer).split(" | "):
            if name == "Model":
                continue
            found = class_of(name, function.__module__)
            own = {node.name for node in found.body if isinstance(node, ast.FunctionDef)}
            fields = {node.target.id for node in found.body if isinstance(node, ast.AnnAssign)}
            assert "to_frame" in own, f"{step} returns {name}, which has no to_frame()"
            assert "summary" in own | fields, f"{step} returns {name}, which has no summary"
            seen.add(name)
    assert len(seen) >= 18


def spoken(capsys, *words) -> dict:
    assert main([*map(str, words), "--json"]) == 0
    said = capsys.readouterr().out
    assert said.endswith("}\n") and said.count("\n") == 1
    found = json.loads(said, parse_constant=lambda text: pytest.fail(f"{text} is not valid JSON"))
    assert set(found) >= KEYS and found["command"] == words[0] and found["summary"]
    names = [c["name"] for c in found["table"]["columns"]]
    assert len(set(names)) == len(names) and all(c["unit"] for c in found["table"]["columns"])
    assert all(len(row) == len(names) for row in found["table"]["rows"])
    return found


def test_steps_of_a_small_job_say_one_object(tmp_path, capsys):
    paths = write_building(tmp_path)
    problem = ["--model", paths["model"], "--modes", paths["modes"]]
    answer = spoken(capsys, "modes", paths["model"], "--count", "3")
    assert len(answer["frequency_hz"]) == 3 and answer["table"]["columns"][2] == {"name": "frequency_hz", "unit": "Hz"}
    update = spoken(capsys, "update", *problem, "--out", tmp_path / "update.json")
    assert update["files"] == [str(tmp_path / "update.json")]
    assert [c["name"] for c in update["table"]["columns"]][:3] == ["name", "unit", "initial"]
    assert update["table"]["columns"][2]["unit"] == OWN_UNIT
    drawn = spoken(capsys, "sample", *problem, "--out", tmp_path / "posterior.nc", "--ess", "20", "--max-steps", "60")
    assert len(drawn["table"]["rows"]) == len(update["table"]["rows"])
    compared = spoken(
        capsys,
        "compare",
        tmp_path / "update.json",
        tmp_path / "posterior.nc",
        "--model",
        paths["model"],
        "--out",
        tmp_path / "compare.json",
    )
    assert compared["table"]["rows"][0][0] == drawn["table"]["rows"][0][0]
    assert spoken(capsys, "inform", *problem, "--out", tmp_path / "i.json")["table"]["rows"]
    page = spoken(capsys, "report", tmp_path, "--out", tmp_path / "report.html")
    assert page["files"] == [str(tmp_path / "report.html")]
    campaign = write_campaign(tmp_path / "campaign")
    checked = spoken(capsys, "check", campaign)
    assert {"name": "channel", "unit": "-"} in checked["table"]["columns"]
    assert all("campaigns" in spoken(capsys, "check", campaign, write_campaign(tmp_path / "other")) for _ in range(1))


def test_a_mistake_prints_nothing_else(tmp_path, capsys):
    assert main(["modes", str(tmp_path / "none.toml"), "--json"]) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1


def test_hdf5_files_are_groups_of_xarray(tmp_path):
    shape = np.arange(12, dtype=complex).reshape(4, 3)
    covariance_factors = CovarianceFactors(
        ln_frequency=np.ones((3, 5)), damping_ratio=np.zeros((3, 5)), shape=np.ones((4, 3, 5), complex)
    )
    one = ModalSet(
        id="2019-06-03T00:00Z",
        frequency_hz=np.array([0.3, 0.31, 1.2]),
        shape=shape,
        damping_ratio=np.full(3, 0.01),
        frequency_std_hz=np.full(3, 0.001),
        shape_std=np.full((4, 3), 0.02),
        covariance_factors=covariance_factors,
    )
    write_modes(ModalData(channels=tuple("abcd"), sets=(one,)), tmp_path / "modes.json")
    with xarray.open_dataset(tmp_path / "modes.deviations.h5", group=one.id, engine="h5netcdf") as found:
        assert found["shape"].dims == ("channel", "mode", "column") and dict(found.sizes) == {
            "mode": 3,
            "column": 5,
            "channel": 4,
        }
        assert float(found["ln_frequency"].sum()) == 15.0
    np.testing.assert_allclose(read_modes(tmp_path / "modes.json").sets[0].covariance_factors.shape,
                               covariance_factors.shape)


def test_tables_have_units_and_json_its_nulls(tmp_path):
    data = read_modes(write_building(tmp_path)["modes"])
    table = data.to_frame()
    assert table.attrs["units"] == {
        "id": "-",
        "mode": "-",
        "frequency_hz": "Hz",
        "frequency_std_hz": "Hz",
        "damping_ratio": "-",
        "damping_ratio_std": "-",
    }
    assert len(table) == len(data.sets) * data.n_mode
    odd = with_units(pd.DataFrame({"a_m": [np.nan, 1.0], "t": [pd.Timestamp("2020-01-01T00:00Z"), pd.NaT]}))
    found = json.loads(json_object("x", "one\ntwo", odd, ["f"], more=np.array([1, 2])))
    assert found["table"] == {
        "columns": [{"name": "a_m", "unit": "m"}, {"name": "t", "unit": "-"}],
        "rows": [[None, "2020-01-01T00:00:00+00:00"], [1.0, None]],
    }
    assert found["summary"] == ["one", "two"] and found["more"] == [1, 2] and found["files"] == ["f"]
    assert plain_value({"a": (np.bool_(True), 1 + 2j, Path("p"))}) == {"a": [True, [1.0, 2.0], "p"]}
    assert list(table_of([], ("x", "y")).columns) == ["x", "y"]
