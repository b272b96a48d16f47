"""`template`: each model runs as it is, nothing is written over, and a monopile goes from records to its report."""

import datetime
import json

import h5py
import numpy as np
import pytest
from scipy import linalg, signal

import probupdate
from probupdate.cli import main
from probupdate.lifetime.conditions import read_conditions
from probupdate.lifetime.details import find_details
from probupdate.structure.description_file import parse_description, read_description
from probupdate.structure.load import turbine_model
from probupdate.structure.parameter_table import read_toml
from probupdate.structure.turbine_frame import build_frame

RATE_HZ, MINUTES, SEED = 20.0, 10, 3


@pytest.mark.parametrize("kind", ["monopile", "jacket", "tower", "matrices"])
def test_each_template_has_its_modes_and_a_campaign(kind, tmp_path, capsys):
    assert main(["template", kind, str(tmp_path / "run")]) == 0
    model = tmp_path / "run" / ("model.npz" if kind == "matrices" else "model.toml")
    capsys.readouterr()
    assert main(["modes", str(model), "--count", "6", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    first = ("X1", "Y1") if kind == "matrices" else ("FA1", "SS1")
    assert {*first, "T1"} <= set(answer["label"]) and not any("implausible" in note for note in answer["notes"])
    campaign = read_toml(tmp_path / "run" / "campaign" / "campaign.toml")
    assert [s["channel"] for s in campaign["sensor"]] == list(probupdate.open_model(model).channels)


@pytest.mark.parametrize("kind, sides", [("monopile", {"weld"}), ("jacket", {"weld", "chord", "brace"})])
def test_loads_and_welds_of_a_template_are_those_of_its_model(kind, sides, tmp_path):
    probupdate.template(kind, tmp_path / "run")
    conditions = read_conditions(tmp_path / "run" / "fatigue.toml")
    description = read_description(tmp_path / "run" / "model.toml")
    details, spots = find_details(description, build_frame(description), conditions, "fatigue.toml")
    assert {s.side for s in spots} == sides and len(details) > 3
    assert {s.curve for s in spots} <= set(conditions.curve)


def test_a_template_is_written_over_nothing(tmp_path, capsys):
    assert main(["template", "tower", str(tmp_path / "run")]) == 0
    (tmp_path / "run" / "model.toml").write_text("mine")
    assert main(["template", "monopile", str(tmp_path / "run")]) == 2
    assert "already exists; name another place" in capsys.readouterr().err
    assert (tmp_path / "run" / "model.toml").read_text() == "mine"


def test_a_file_s_name_is_the_model_alone(tmp_path, capsys):
    assert main(["template", "monopile", str(tmp_path / "mine.toml")]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["mine.toml"]
    assert main(["template", "monopile", str(tmp_path / "mine.npz")]) == 2
    assert "a file that ends in .toml" in capsys.readouterr().err


def test_the_virtual_turbine_says_that_it_stands_on_jackets(tmp_path, capsys):
    assert main(["template", "monopile", str(tmp_path / "model.toml")]) == 0
    capsys.readouterr()
    assert main(["simulate", str(tmp_path / "records"), "--model", str(tmp_path / "model.toml")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "built on jackets alone" in error and "or measured records" in error


def test_an_unknown_kind_is_shown_the_forms_that_describe_it(tmp_path, capsys):
    assert main(["template", "tripod", str(tmp_path / "run")]) == 2
    error = capsys.readouterr().err
    assert "choose from monopile, jacket, tower, matrices" in error and "SubDyn files" in error
    assert "'probupdate matrices'" in error and not (tmp_path / "run").exists()


def records(folder, truth, n_block):
    """Accelerations of the model with the parameters `truth` under white forces: its matrices solved densely, each mode
    a recursion of its own, exact between samples."""
    raw = read_toml(folder / "model.toml")
    for entry in raw["parameter"]:
        entry["initial"] = truth.get(entry["name"], entry["initial"])
    model = turbine_model(parse_description(raw, "truth"), where="truth")
    K, M = (matrix.toarray() for matrix in model.matrices(model.parameters.initial))
    value, phi = linalg.eigh(K, M, subset_by_index=[0, 9])
    # whose sign is the processor's, and with it the record
    phi = phi * np.sign(phi[np.argmax(np.abs(phi), axis=0), np.arange(10)])
    omega, at = np.sqrt(value), model.channel_matrix @ phi
    rng = np.random.default_rng(SEED)
    n = int(MINUTES * 60 * RATE_HZ)
    forces = rng.standard_normal((6, len(omega)))
    total = np.zeros((n_block * n, len(at)))
    source = rng.standard_normal((n_block * n + 4000, 6))
    for j, w in enumerate(omega):
        A = np.array([[0.0, 1.0], [-w * w, -2 * 0.008 * w]])
        E = linalg.expm(A / RATE_HZ)
        B = np.linalg.solve(A, (E - np.eye(2)) @ np.array([[0.0], [1.0]]))
        numerator, denominator = signal.ss2tf(E, B, A[1:], np.ones((1, 1)))
        total += np.outer(signal.lfilter(numerator[0], denominator, source @ forces[:, j])[4000:], at[:, j])
    total *= 0.02 / total.std()
    total += 2e-4 * rng.standard_normal(total.shape)
    where = folder / "campaign" / "acceleration"
    where.mkdir()
    for k in range(n_block):
        start = datetime.datetime(2024, 5, 1) + datetime.timedelta(minutes=MINUTES * k)
        with h5py.File(where / f"{start:%Y%m%dT%H%M}.h5", "w") as file:
            data = file.create_dataset("data", data=total[k * n : (k + 1) * n].astype(np.float32))
            data.attrs["start"], data.attrs["sampling_rate_hz"] = f"{start.isoformat()}Z", RATE_HZ
    text = folder / "campaign" / "campaign.toml"
    text.write_text(text.read_text().replace("sampling_rate_hz = 25.0", f"sampling_rate_hz = {RATE_HZ}")
                    .replace("block_minutes = 30", f"block_minutes = {MINUTES}"))


@pytest.fixture(scope="module")
def identified(tmp_path_factory):
    run = tmp_path_factory.mktemp("monopile") / "run"
    probupdate.template("monopile", run)
    records(run, {"py": 0.4}, 9)
    assert main(["identify", str(run / "campaign"), "--model", str(run / "model.toml"), "--out",
                 str(run / "modes.json")]) == 0
    return run


def test_the_modes_of_a_monopile_keep_their_names(identified):
    data = json.loads((identified / "modes.json").read_text())
    assert data["labels"][:5] == ["FA1", "SS1", "T1", "FA2", "SS2"] or set(data["labels"]) >= {
        "FA1", "SS1", "T1", "FA2", "SS2"}


def test_an_update_of_a_monopile_finds_the_soil_that_was_hidden(identified, capsys):
    run = identified
    assert main(["select", str(run / "modes.json"), "--preset", "structure", "--out", str(run / "nine.json")]) == 0
    assert main(["update", "--model", str(run / "model.toml"), "--modes", str(run / "nine.json"), "--out",
                 str(run / "update.json")]) == 0
    done = json.loads((run / "update.json").read_text())
    names = [p["name"] for p in done["parameters"]["items"]]
    py, std = done["map_theta"][names.index("py")], np.sqrt(np.diag(done["map_covariance"]))[names.index("py")]
    # stiffer soil by a factor of 2.5, which the prior (1 +- 0.5) hardly expects
    assert py < 0.8 and abs(py - 0.4) < 3 * std
    assert not done["labels"] or "SS2" in done["labels"]
    assert main(["report", str(run), "--out", str(run / "report.html")]) == 0
    text = (run / "report.html").read_text()
    assert "monopile stiffness" in text and "(Table 5)" not in text


def test_a_monopile_s_draws_are_models_again(identified, capsys):
    """Softened by its weight: each draw's model has its own masses' softening, which is said."""
    run = identified
    if not (run / "nine.json").exists():
        probupdate.select(run / "modes.json", preset="structure")
        assert main(["select", str(run / "modes.json"), "--preset", "structure", "--out", str(run / "nine.json")]) == 0
    assert main(["sample", "--model", str(run / "model.toml"), "--modes", str(run / "nine.json"), "--out",
                 str(run / "posterior.nc"), "--ess", "50", "--max-steps", "400"]) == 0
    assert main(["export", str(run), "--to", "lifetime", str(run.parent / "life"), "--draws", "3", "--accept"]) == 0
    left_out = json.loads((run.parent / "life" / "manifest.json").read_text())["left_out"]
    assert any("softening" in line for line in left_out)
    again = probupdate.open_model(run.parent / "life" / "models" / "002" / "model.toml")
    assert again.parameters.names == ("k_t", "k_p", "m_h", "py")


def test_a_diagnosis_of_a_tower_on_land_has_a_turbine_s_catalogue(tmp_path, capsys):
    """Its sensor with a wrong gain is named; it has no pile, whose head other turbines' models derive."""
    probupdate.template("tower", tmp_path)
    path, rng = tmp_path / "model.toml", np.random.default_rng(SEED)
    model = probupdate.open_model(path)
    found = model.solve(np.array([0.97, 0.7, 55.5e3]), 5)
    gain = np.where(np.array(model.channels) == "T60-y", 1.1, 1.0)
    shape, size = found.shape, np.abs(found.shape).max(axis=0)
    sets = [{"id": f"2024-05-01T0{k}:00:00Z", "damping_ratio": [0.01] * 5,
             "frequency_hz": (found.frequency_hz * (1 + 1e-3 * rng.standard_normal(5))).tolist(),
             "frequency_std_hz": (1e-3 * found.frequency_hz).tolist(),
             "shape_re": (gain[:, None] * shape / size + 2e-3 * rng.standard_normal(shape.shape)).T.tolist(),
             "shape_std": np.full((5, len(gain)), 2e-3).tolist()} for k in range(10)]
    (tmp_path / "modes.json").write_text(json.dumps({"channels": list(model.channels), "sets": sets}))
    assert main(["diagnose", "--model", str(path), "--modes", str(tmp_path / "modes.json"), "--out",
                 str(tmp_path / "diagnosis.json"), "--no-extend"]) == 0, capsys.readouterr().err
    diagnosis = json.loads((tmp_path / "diagnosis.json").read_text())
    assert [(f["cause"], f["location"]) for f in diagnosis["findings"]] == [("sensor gain", "T60-y")]
    assert "RNA inertia" in {row["cause"] for row in diagnosis["detectable_sizes"]}


@pytest.mark.parametrize("kind", ["tower", "jacket"])
def test_a_sound_template_s_record_makes_no_channel_suspect(kind, tmp_path, capsys):
    """Torsion and second bending 8 % apart, pushed by the same forces: phases between levels that are no clock's. The
    jacket's tower moves five times as much in its middle as at its ends, at most frequencies."""
    run = tmp_path / "run"
    probupdate.template(kind, run)
    records(run, {}, 4)
    assert main(["check", str(run / "campaign")]) == 0
    assert "suspect" not in capsys.readouterr().out
