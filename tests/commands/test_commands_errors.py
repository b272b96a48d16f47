"""A user's mistake is one line that names file, key or channel, exit code 2, and leaves nothing behind."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from command_cases import CHANNELS, PARAMETERS, campaign_text, matrices, modes_table, write_campaign

import probupdate
from probupdate.errors import InputError
from probupdate.io.outputs import sole_writer
from probupdate.modal.modes import read_modes
from probupdate.structure.load import reference_model


def contents(folder: Path) -> dict:
    return {p: p.stat().st_mtime_ns for p in folder.rglob("*") if p.is_file()}


def update(building) -> list[str]:
    return ["update", "--model", building["model"], "--modes", building["modes"], "--out",
            str(building["folder"] / "new.json")]


# modes.json --------------------------------------------------------------------------------------------------------


def in_set(key, value):
    return lambda table: table["sets"][0].update({key: value})


def rename(old, new):
    def change(table):
        table["sets"][0][new] = table["sets"][0].pop(old)

    return change


def nan_in_shape(table):
    table["sets"][0]["shape_re"][1][2] = float("nan")


def two_ids(table):
    table["sets"][1]["id"] = table["sets"][0]["id"]


MODES = {
    "NaN frequency": (in_set("frequency_hz", [1.0, float("nan"), 3.0, 4.0]), ("frequency_hz", "NaN", "null")),
    "NaN shape": (nan_in_shape, ("shape_re", "NaN", "null")),
    "infinite": (in_set("frequency_hz", [1.0, float("inf"), 3.0, 4.0]), ("frequency_hz", "infinite")),
    "quoted": (in_set("frequency_hz", ["1.2", 2.0, 3.0, 4.0]), ("frequency_hz", "'1.2'")),
    "no list": (in_set("frequency_hz", 3.0), ("frequency_hz", "list")),
    "negative": (in_set("frequency_hz", [-1.0, 2.0, 3.0, 4.0]), ("frequency_hz", "not positive")),
    "no standard deviation": (in_set("frequency_std_hz", [0.01, None, 0.01, 0.01]),
                              ("frequency_std_hz of mode 2", "--weights")),
    "negative standard deviation": (in_set("shape_std", [[-0.1] * 5] * 4), ("shape_std", "negative")),
    "ragged": (in_set("shape_re", [[1, 2], [1] * 5, [1] * 5, [1] * 5]),
               ("shape_re", "row 1 has 2 numbers for 5 channels")),
    "shape no table": (in_set("shape_re", 3), ("shape_re", "list")),
    "channels short": (in_set("shape_re", [[1.0] * 4] * 4), ("shape_re", "(4, 4)")),
    "misspelt": (rename("frequency_hz", "frequncy_hz"), ("frequncy_hz", "did you mean 'frequency_hz'")),
    "misspelt optional": (rename("shape_std", "shape_sdt"), ("shape_sdt", "did you mean 'shape_std'")),
    "environment": (in_set("environment", [1]), ("environment",)),
    "word for a number": (in_set("environment", {"water_level_m": "calm"}), ("water_level_m", "'calm'", "null")),
    "nothing identified": (lambda t: [s.update(frequency_hz=[None] * 4) for s in t["sets"]],
                           ("modes.json", "no set has an identified mode")),
    "no set": (lambda t: t.update(sets=[]), ("there is no set",)),
    "channels number": (lambda t: t.update(channels=3), ("channels", "list")),
    "channel missing": (lambda t: t.update(channels=[*CHANNELS[:-1], "roof"]), ("channel roof", "not in the model")),
    "channel twice": (lambda t: t.update(channels=[*CHANNELS[:-1], "F05"]), ("channels", "twice")),
    "labels": (lambda t: t.update(labels=["a"]), ("1 labels for 4 modes",)),
    "reference": (lambda t: t.update(reference_set="nope"), ("reference_set 'nope'",)),
    "ids": (two_ids, ("two sets share one id",)),
}


@pytest.mark.parametrize("change, words", MODES.values(), ids=MODES)
def test_modal_sets(building, refused, change, words):
    table = modes_table()
    change(table)
    Path(building["modes"]).write_text(json.dumps(table))
    before = contents(building["folder"])
    line = refused(*update(building))
    assert all(word in line for word in words), line
    assert contents(building["folder"]) == before


def test_a_set_that_is_asked_for_and_has_no_mode_is_named_so(building, refused):
    table = modes_table()
    table["sets"][0].update(frequency_hz=[None] * 4)
    Path(building["modes"]).write_text(json.dumps(table))
    own = table["sets"][0]["id"]
    line = refused(*update(building), "--set", own)
    assert f"set {own}" in line and "no identified mode" in line, line


# model.npz and parameters.toml -------------------------------------------------------------------------------------


def matrix(key, value):
    return lambda m: m.update({key: value})


def asymmetric(m):
    m["K0"][0, 5] = 1e5


def negative(key):
    def change(m):
        m[key] = -m[key]

    return change


MATRICES = {
    "asymmetric": (asymmetric, ("model.npz, K0", "not symmetric")),
    "indefinite K": (negative("K0"), ("not positive definite", "supports")),
    "indefinite M": (negative("M0"), ("model.npz, M0", "row 0 has a negative mass")),
    "singular": (lambda m: m.update(K0=0 * m["K0"]), ("singular",)),
    "NaN": (matrix("K0", np.full((20, 20), np.nan)), ("model.npz, K0", "NaN")),
    "missing": (lambda m: m.pop("M0"), ("model.npz, M0", "missing")),
    "no K_low": (lambda m: m.pop("K_low"), ("model.npz, K_low",)),
    "stranger": (matrix("K_extra", np.eye(20)), ("K_extra", "'extra'")),
    "size": (matrix("K_low", np.eye(19)), ("model.npz, K_low", "(19, 19)")),
    "text": (matrix("K0", np.array([["a"]])), ("model.npz, K0", "not real numbers")),
    "complex": (matrix("K0", np.eye(20) * (1 + 1j)), ("model.npz, K0", "not real numbers")),
    "row outside": (matrix("channel_dof", np.array([1, 2, 3, 4, 20])), ("channel_dof", "row 20")),
    "rows no integers": (matrix("channel_dof", np.array([1.5, 2, 3, 4, 5])),
                         ("channel_dof", "float64", "whole numbers")),
    "misspelt": (matrix("chanel_sign", np.ones(5)), ("chanel_sign", "did you mean 'channel_sign'")),
    "sign": (matrix("channel_sign", np.array(["a"] * 5)), ("channel_sign",)),
    "node outside": (lambda m: m.update(node_position_m=np.zeros((3, 3)), dof_node=np.full(20, 7),
                                        dof_direction=np.zeros(20, int)), ("dof_node",)),
}


@pytest.mark.parametrize("change, words", MATRICES.values(), ids=MATRICES)
def test_matrices(building, refused, change, words):
    content = matrices()
    change(content)
    np.savez(building["model"], **content)
    before = contents(building["folder"])
    line = refused(*update(building))
    assert all(word in line for word in words), line
    assert contents(building["folder"]) == before


TABLES = {
    "key": ("initial", "inital", ("inital", "did you mean 'initial'")),
    "bounds": ("lower = -0.6", "lower = 0.9", ("parameters.toml, parameter low", "bounds")),
    "outside": ("initial = 0.0", "initial = 1.0", ("parameters.toml, parameter low", "outside")),
    "covariance_factors": ("std = 0.2", "std = -0.2", ("parameters.toml, parameter low", "not positive")),
    "quoted": ("std = 0.2", 'std = "0.2"', ("parameter low, std", "not a number")),
    "both": ("std = 0.2", "std = 0.2\ncov = 0.1", ("exactly one",)),
    "cov of zero": ("std = 0.2", "cov = 0.2", ("give 'std'",)),
    "prior": ("lower", 'prior = "flat"\nlower', ("'flat'", "normal, lognormal")),
    "twice": ('"middle"', '"low"', ("low listed twice",)),
    "name": ('"middle"', '"midle"', ("K_midle",)),
    "update": ("lower", 'update = "no"\nlower', ("update", "true")),
    "correlation": ("[[parameter]]", "correlation = 3\n[[parameter]]", ("correlation", "table")),
    "broken": ("[[parameter]]", "[[parameter", ("parameters.toml", "not TOML")),
    "one table": (PARAMETERS, f"[parameter]{PARAMETERS.split('[[parameter]]')[1]}",
                  ("parameters.toml, parameter", "write [[parameter]] before each")),
}


@pytest.mark.parametrize("old, new, words", TABLES.values(), ids=TABLES)
def test_parameters(building, refused, old, new, words):
    Path(building["parameters"]).write_text(PARAMETERS.replace(old, new, 1))
    line = refused(*update(building))
    assert all(word in line for word in words), line
    assert not (building["folder"] / "new.json").exists()


@pytest.mark.parametrize("old, new, words", [
    ("thickness_m = 0.038", "thickness_m = -0.038", ("jacket.leg.thickness_m", "-0.038")),
    ("thickness_m = 0.038", "thickness_m = 38.0", ("jacket.leg.thickness_m", "unit")),
    ("[steel]", '[steel]\ncolour = "grey"', ("steel.colour", "not a key")),
    ("leg = { diameter_m = 1.3,", "leg = { diameter_m = nan,", ("jacket.leg.diameter_m", "finite")),
])
def test_turbine(building, refused, old, new, words):
    text = reference_model("as_built").read_text(encoding="utf-8")
    assert old in text
    path = building["folder"] / "model.toml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    line = refused("update", "--model", path, "--modes", building["modes"], "--out", building["folder"] / "new.json")
    assert "model.toml" in line and all(word in line for word in words), line


# Files that are none ------------------------------------------------------------------------------------------------


def halved(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def emptied(path: Path) -> None:
    path.write_bytes(b"")


def binary(path: Path) -> None:
    path.write_bytes(bytes(range(256)))


def directory(path: Path) -> None:
    path.unlink()
    path.mkdir()


def gone(path: Path) -> None:
    path.unlink()


WRONG = (halved, emptied, binary, directory, gone)


# half of the parameters' text may be a whole file
@pytest.mark.parametrize(("name", "spoil"), [
    (name, spoil) for name in ("model", "modes", "parameters") for spoil in WRONG
    if (name, spoil) != ("parameters", halved)
])
def test_spoilt_inputs(building, refused, name, spoil):
    path = Path(building[name])
    spoil(path)
    assert building["folder"].name in refused(*update(building), "--parameters", building["parameters"])
    assert not (building["folder"] / "new.json").exists()


@pytest.mark.parametrize("spoil", WRONG)
@pytest.mark.parametrize("name", ["update.json", "posterior.nc"])
def test_spoilt_results(estimated, tmp_path, refused, name, spoil):
    for file in ("update.json", "posterior.nc"):
        shutil.copy(estimated / file, tmp_path)
    spoil(tmp_path / name)
    line = refused("compare", tmp_path / "update.json", tmp_path / "posterior.nc", "--out", tmp_path / "c.json")
    assert name in line
    assert not (tmp_path / "c.json").exists()


def test_spoilt_contents_of_a_posterior(estimated, tmp_path, refused):
    for number, spoil in enumerate((
        lambda f: f.__delitem__("prior"), lambda f: f["posterior"].__delitem__("low"),
        lambda f: f["posterior"].attrs.__setitem__("probupdate", "{"),
        lambda f: f["posterior"].attrs.__delitem__("probupdate"),
    )):
        path = Path(shutil.copy(estimated / "posterior.nc", tmp_path / f"{number}.nc"))
        with h5py.File(path, "a") as file:
            spoil(file)
        assert path.name in refused("compare", estimated / "update.json", path, "--out", tmp_path / "c.json")


def test_a_posterior_of_another_problem(estimated, tmp_path, refused):
    """The same files with other weights: other numbers under the same names."""
    problem = ["--model", str(estimated / "model.npz"), "--modes", str(estimated / "modes.json")]
    from probupdate.cli import main

    other = tmp_path / "update.json"
    assert main(["update", *problem, "--weights", "paper", "--out", str(other)]) == 0
    line = refused("compare", other, estimated / "posterior.nc", "--out", tmp_path / "c.json")
    assert "does not fit" in line and "weights" in line


def test_a_report_of_strangers(estimated, tmp_path, refused):
    for name in ("model.npz", "modes.json", "posterior.nc"):
        shutil.copy(estimated / name, tmp_path)
    text = (estimated / "parameters.toml").read_text()
    (tmp_path / "parameters.toml").write_text(text.replace("std", "update = false\nstd", 1))
    assert "different parameters" in refused("report", tmp_path, "--out", tmp_path / "r.html")
    assert not (tmp_path / "r.html").exists()


def test_a_second_chain_in_the_folder_of_the_first(estimated, tmp_path, refused):
    for path in estimated.iterdir():
        shutil.copytree(path, tmp_path / path.name) if path.is_dir() else shutil.copy(path, tmp_path)
    before = contents(tmp_path)
    sample = ["sample", "--model", tmp_path / "model.npz", "--modes", tmp_path / "modes.json", "--out",
              tmp_path / "posterior.nc", "--max-steps", "400"]
    assert "seed is 2 here and 1 there" in refused(*sample, "--seed", "2")
    assert "the weights or what is compared differ" in refused(*sample, "--weights", "paper")
    assert contents(tmp_path) == before


@pytest.mark.parametrize("verb", [probupdate.update, probupdate.sets, probupdate.inform, probupdate.diagnose])
def test_model_and_modes_in_the_wrong_order_or_of_another_kind(building, verb):
    modes = read_modes(building["modes"])
    model = probupdate.open_model(building["model"])
    for given, words in (
        ((modes, building["model"]), "modal data were given in the model's place"),
        ((building["model"], model), "a model was given in the modes' place"),
        ((building["modes"], building["model"]),
         "model.npz: is an archive of arrays such as a model's, not modal sets"),
        ((building["model"], 3), "not modal data"), ((np.sin, building["modes"]), "a ufunc is not a model"),
    ):
        with pytest.raises(InputError, match=words):
            verb(*given)


def test_files_in_the_wrong_place_are_named_by_what_they_are(building, refused):
    update = ["--out", building["folder"] / "u.json"]
    assert "model.npz: is an archive of arrays such as a model's, not modal sets; give a modes.json" in refused(
        "update", "--model", building["model"], "--modes", building["model"], *update)
    campaign = write_campaign(building["folder"] / "campaign")
    assert "campaign: is a campaign's folder, not a model's file" in refused(
        "update", "--model", campaign, "--modes", building["modes"], *update)
    table = building["folder"] / "other.toml"
    table.write_text(Path(building["parameters"]).read_text().replace('"low"', '"lower"'))
    assert f"model.npz, K_lower: there is neither this matrix nor its M_ for 'lower' of {table}" in refused(
        "modes", building["model"], "--parameters", table)


def test_a_second_sampler_on_the_same_out_is_refused_while_the_first_runs(building, refused):
    out = building["folder"] / "posterior.nc"
    sample = ["sample", "--model", building["model"], "--modes", building["modes"], "--out", out, "--weights", "paper",
              "--shapes", "none"]
    chain = out.with_name("posterior.nc.chain")
    with sole_writer(chain):
        said = refused(*sample)
    assert "posterior.nc.chain: another run is writing into it; wait until it ends" in said
    # nothing of the refused run, and no lock, is left; the next one may write
    assert not out.exists() and not list(chain.iterdir())
    with sole_writer(chain):
        pass


# Campaigns ----------------------------------------------------------------------------------------------------------

CAMPAIGNS = {
    "unit": ('unit = "m/s2"', 'unit = "furlong"', ("campaign.toml, sensor TP-A-x", "'furlong'", "m/s2")),
    "unit of another quantity": ('"acceleration"', '"velocity"', ("unit 'm/s2' is none of velocity",)),
    "quantity": ('"acceleration"', '"strain"', ("campaign.toml, sensor TP-A-x", "measures strain")),
    "key": ("block_minutes", "block_minuts", ("block_minuts", "did you mean 'block_minutes'")),
    "rate": ("sampling_rate_hz = 10.0", "sampling_rate_hz = 20.0", ("10 Hz", "20 Hz")),
    "rate quoted": ("sampling_rate_hz = 10.0", 'sampling_rate_hz = "10"', ("sampling_rate_hz", "not a number")),
    "position": ("[5.6, 5.6, 15.0]", '"x"', ("campaign.toml, sensor TP-A-x", "three numbers")),
    "direction": ("[1.0, 0.0, 0.0]", "[1.0, 1.0, 0.0]", ("unit vector",)),
    "direction NaN": ("[1.0, 0.0, 0.0]", "[nan, 1.0, 0.0]", ("unit vector",)),
    "channel twice": ('"TP-A-y"', '"TP-A-x"', ("listed twice",)),
    "channel number": ('"TP-A-y"', "7", ("channel", "not text")),
    "broken": ('name = "Short"', 'name = "Short', ("campaign.toml", "not TOML")),
}


@pytest.mark.parametrize("old, new, words", CAMPAIGNS.values(), ids=CAMPAIGNS)
@pytest.mark.parametrize("verb", ["check", "identify"])
def test_campaign(tmp_path, refused, verb, old, new, words):
    folder = write_campaign(tmp_path / "campaign", blocks=1)
    (folder / "campaign.toml").write_text(campaign_text(change=(old, new)))
    more = ["--model", "as_built"] if verb == "identify" else []
    line = refused(verb, folder, *more, "--out", tmp_path / "out.json")
    assert all(word in line for word in words), line
    assert not (tmp_path / "out.json").exists()


def without_column(file):
    held = dict(file["data"].attrs)
    del file["data"]
    file.create_dataset("data", data=np.zeros((6000, 2), np.float32)).attrs.update(held)


RECORDS = {
    "a column missing": (without_column, ("(6000, 2)", "3 channels")),
    "no dataset": (lambda f: f.__delitem__("data"), ("no dataset 'data'",)),
    "no start": (lambda f: f["data"].attrs.__delitem__("start"), ("'start'",)),
    "start no time": (lambda f: f["data"].attrs.__setitem__("start", "yesterday"), ("'yesterday'",)),
    "rate no number": (lambda f: f["data"].attrs.__setitem__("sampling_rate_hz", "ten"), ("sampling_rate_hz",)),
    "rate NaN": (lambda f: f["data"].attrs.__setitem__("sampling_rate_hz", np.nan), ("nan Hz",)),
}


@pytest.mark.parametrize("spoil, words", RECORDS.values(), ids=RECORDS)
def test_records(tmp_path, refused, spoil, words):
    folder = write_campaign(tmp_path / "campaign", blocks=2)
    with h5py.File(folder / "acceleration" / "block-1.h5", "a") as file:
        spoil(file)
    line = refused("check", folder)
    assert "block-1.h5" in line and all(word in line for word in words), line


# half of a text may be a whole file
@pytest.mark.parametrize(("name", "spoil"), [
    (name, spoil) for name in ("campaign.toml", "scada.csv", "acceleration/block-0.h5") for spoil in WRONG[:-1]
    if spoil is not halved or name.endswith(".h5")
])
def test_spoilt_campaign_files(tmp_path, refused, name, spoil):
    folder = write_campaign(tmp_path / "campaign", blocks=1)
    spoil(folder / name)
    assert name in refused("check", folder) or (name, spoil) == ("campaign.toml", emptied)


def test_scada_with_a_time_that_is_none(tmp_path, refused):
    folder = write_campaign(tmp_path / "campaign", blocks=1)
    (folder / "scada.csv").write_text("time,power_kw\nyesterday,1\n")
    assert "scada.csv, row 2, time" in refused("check", folder)


def test_data_that_is_all_nan_is_found_not_refused(tmp_path, capsys):
    """Lost samples are the measurement's fault: said in the findings."""
    from probupdate.cli import main

    folder = write_campaign(tmp_path / "campaign", blocks=1, data=np.full((6000, 3), np.nan))
    assert main(["check", str(folder)]) == 0
    said = capsys.readouterr().out
    assert "TP-A-x" in said or "all channels" in said


# Where results go ---------------------------------------------------------------------------------------------------


def test_out_that_cannot_be_written_is_refused_before_the_work(building, refused):
    folder, problem = building["folder"], ["--model", building["model"], "--modes", building["modes"]]
    before = contents(folder)
    for verb in ("update", "sample"):
        assert "is a directory" in refused(verb, *problem, "--out", folder)
        assert "not a directory" in refused(verb, *problem, "--out", Path(building["modes"]) / "x.json")
    assert "is a directory" in refused("select", building["modes"], "--out", folder)
    assert "is a directory" in refused("compare", "u.json", "p.nc", "--out", folder)
    assert "is a directory" in refused("report", folder, "--out", folder)
    assert "is a directory" in refused("check", folder, "--out", folder)
    for verb in ("demo", "simulate"):
        assert "is a file" in refused(verb, building["modes"])
    assert contents(folder) == before


def test_out_in_a_directory_that_is_not_there_yet(building):
    from probupdate.cli import main

    folder = building["folder"]
    assert main(["update", "--model", building["model"], "--modes", building["modes"], "--out",
                 str(folder / "a" / "b" / "update.json")]) == 0
    assert main(["select", building["modes"], "--out", str(folder / "c" / "nine.json")]) == 0
    assert (folder / "a" / "b" / "update.json").is_file() and (folder / "c" / "selection.csv").is_file()
    assert not list(folder.rglob("*.part"))


def test_demo_and_simulate_leave_nothing_behind(tmp_path, refused):
    filled = tmp_path / "filled"
    filled.mkdir()
    (filled / "notes.txt").write_text("mine")
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "run.json").write_text("{")
    (tmp_path / "t.toml").write_text("[parameters]\nk_x = 1.0\n")
    before = contents(tmp_path)
    assert "empty" in refused("demo", filled)
    assert "run.json" in refused("demo", tmp_path / "broken")
    assert "seed" in refused("demo", tmp_path / "new", "--seed", "-1")
    assert "k_x" in refused("simulate", tmp_path / "new", "--truth", tmp_path / "t.toml", "--days", "0.03")
    assert "shorter than one block" in refused("simulate", tmp_path / "new", "--days", "0.0001")
    assert contents(tmp_path) == before and not (tmp_path / "new").exists()


@pytest.mark.parametrize("options, word", [
    (["update", "--alpha", "0"], "--alpha"), (["update", "--alpha", "x"], "--alpha"),
    (["update", "--weights", "x"], "--weights"), (["update", "--iterations", "1.5"], "--iterations"),
    (["update", "--weights", "paper", "--frequency-cov", "0.1"], "--frequency-cov"),
    (["sample", "--seed", "x"], "--seed"), (["updte"], "updte"), ([], "VERB"),
])
def test_options(refused, options, word):
    assert word in refused(*options)


# As a process -------------------------------------------------------------------------------------------------------


def process(*arguments) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, "-m", "probupdate.cli", *map(str, arguments)], capture_output=True,
                          text=True, timeout=120)


def test_a_mistake_seen_from_the_shell(building, estimated):
    done = process("update", "--model", building["model"], "--modes", building["folder"] / "no.json", "--out", "x.json")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.splitlines() == [
        f"probupdate update: {building['folder'] / 'no.json'}: no such file; check the path, or run `probupdate "
        "identify` first"
    ]
    # the step that imports most: no warning of another package beside its line
    done = process("compare", estimated / "posterior.nc", estimated / "update.json", "--out", building["folder"] / "c")
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1, done.stderr


def test_a_success_seen_from_the_shell_is_silent_on_stderr(estimated, tmp_path):
    done = process("compare", estimated / "update.json", estimated / "posterior.nc", "--out", tmp_path / "c.json")
    assert (done.returncode, done.stderr) == (0, "")
    assert "strongly identified" in done.stdout and (tmp_path / "c.json").is_file()


def test_a_defect_rises_with_its_trace(monkeypatch, building):
    from probupdate.cli import estimates, main

    def broken(arguments, progress):
        raise ZeroDivisionError("a defect")

    monkeypatch.setattr(estimates, "run_update", broken)
    # Python then prints the trace and exits with 1, which is no code of ours
    with pytest.raises(ZeroDivisionError, match="a defect"):
        main(update(building))


# Channels exchanged or reversed -------------------------------------------------------------------------------------


def exchanged(first, second):
    def change(table):
        for one in table["sets"]:
            for key in ("shape_re", "shape_im", "shape_std"):
                for row in one.get(key) or ():
                    row[first], row[second] = row[second], row[first]

    return change


@pytest.mark.parametrize(("channels", "weights", "written"), [((0, 4), "paper", True), ((0, 4), "measured", False),
                                                              ((1, 3), "measured", False)])
def test_exchanged_channels_are_named_and_the_misfit_said(building, capsys, channels, weights, written):
    from probupdate.cli import main

    table = modes_table()
    exchanged(*channels)(table)
    Path(building["modes"]).write_text(json.dumps(table))
    one = ["--set", table["sets"][0]["id"]] if written else []
    assert main([*update(building), "--weights", weights, *one]) == 2
    said = capsys.readouterr()
    assert f"channels {CHANNELS[channels[0]]} and {CHANNELS[channels[1]]} exchanged would explain it" in said.err
    assert len([line for line in said.err.splitlines() if not line.startswith("  ")]) == 1
    assert (building["folder"] / "new.json").exists() == written
    if written:
        assert said.out.startswith("MISFIT BEYOND CHANCE")
        assert "new.json holds the result of the data as they stand" in said.err


@pytest.mark.parametrize("verb", ["update", "sample"])
def test_a_name_that_is_nearly_a_model_is_asked_about(building, refused, verb):
    words = refused(verb, "--model", "updatd", "--modes", building["modes"], "--out", building["folder"] / "x.nc")
    assert "updatd: is not a state of the reference turbine" in words and "did you mean 'updated'?" in words


NAMELESS = {
    "set": (["update", "--set", "nope"], "modes.json, set nope: there is none of that id"),
    "channels": (["update", "--model", "updated"],
                 "modes.json, channel F05: is in the measured modes but not in the model"),
    "count": (["modes", "--count", "900"], "model.npz, model: 900 modes are asked for"),
    "option": (["update", "--frequency-cov", "0.1"], "probupdate update: frequency CoV: 1 given for 4 modes"),
    "covariate": (["regress", "--covariates", "xx"], "modes.json, covariate xx: is not a number in any set"),
}


@pytest.mark.parametrize("given, words", NAMELESS.values(), ids=NAMELESS)
def test_what_is_wrong_with_values_names_their_file_or_the_option(building, refused, given, words):
    verb, *options = given
    files = {"update": ["--model", building["model"], "--modes", building["modes"]], "modes": [building["model"]],
             "regress": [building["modes"]]}[verb]
    out = ["--out", str(building["folder"] / "new.x")]
    assert words in refused(verb, *files, *options, *out)


def test_a_model_that_is_called_model_is_not_named_twice(building, refused):
    table = modes_table()
    table["channels"][-1] = "roof"
    Path(building["modes"]).write_text(json.dumps(table))
    assert "but not in the model (1 of 5 missing)" in refused(*update(building))


def test_a_discrepancy_of_zero_is_said_to_be_allowed(building, refused):
    assert "-1 is neither a share of zero or more nor auto" in refused(*update(building), "--discrepancy=-1")


ABSURD = [["simulate", "x", "--days", "1e9"], ["simulate", "x", "--days", "inf"], ["demo", "x", "--days", "1e9"],
          ["simulate", "x", "--jobs", "1000000000"], ["sample", "--ensembles", "1000000000"],
          ["sample", "--ess", "1" + "0" * 12], ["sample", "--max-steps", "1" + "0" * 12],
          ["sample", "--seed", "9" * 30], ["update", "--iterations", "1" + "0" * 10],
          ["update", "--frequency-cov", "1e300"], ["sets", "--spread", "1e300"],
          ["select", "x.json", "--count", "1" + "0" * 10], ["identify", "x", "--order", "100000"],
          ["identify", "x", "--block-rows", "1000000"],
          ["export", "x", "--to", "lifetime", "y", "--draws", "1" + "0" * 10]]


@pytest.mark.parametrize("given", ABSURD, ids=[" ".join(g[-2:]) for g in ABSURD])
def test_what_no_memory_or_lifetime_holds_is_refused_at_once(tmp_path, monkeypatch, refused, given):
    monkeypatch.chdir(tmp_path)
    words = refused(*given, *([] if given[0] in ("simulate", "demo", "export") else ["--out", "out.json"]))
    assert given[-2] in words and ("most there can be" in words or "is not from 0 to" in words)
    assert not list(tmp_path.iterdir())
