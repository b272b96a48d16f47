"""A run directory: written by the steps' own writers, read back as the values the page shows; every mistake said."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from probupdate.campaign.checking import check
from probupdate.campaign.reading import read_campaign
from probupdate.errors import InputError
from probupdate.io.files import sha256
from probupdate.modal.modes import ModalData, ModalSet, write_modes
from probupdate.reporting import report
from probupdate.reporting.run_files import PARTS, read_run, setting_rows
from probupdate.runtime.progress import silent
from probupdate.structure.load import load_model, reference_model
from probupdate.updating.comparison import write_comparison
from probupdate.updating.posterior_file import write_posterior
from probupdate.updating.update_file import write_update


def _write_campaign(folder: Path, campaign) -> None:
    (folder / "acceleration").mkdir(parents=True)
    lines = ['name = "June"', "sampling_rate_hz = 25.0", "block_minutes = 30", "water_depth_m = 38.0"]
    for s in campaign.sensors:
        lines += ["[[sensor]]", f'channel = "{s.channel}"', f'level = "{s.level}"',
                  f"position_m = {s.position_m.tolist()}", f"direction = {s.direction.tolist()}",
                  f'quantity = "{s.quantity}"', f'unit = "{s.unit}"']
    (folder / "campaign.toml").write_text("\n".join(lines))
    # an hour, and an hour that overlaps the first by half and is followed by a gap
    for name, start, hours in (("b", "2019-06-03T00:00:00Z", 1), ("a", "2019-06-03T00:30:00Z", 1),
                               ("c", "2019-06-03T03:00:00Z", 1)):
        with h5py.File(folder / "acceleration" / f"{name}.h5", "w") as file:
            shape = (hours * 90000, len(campaign.sensors))
            data = file.create_dataset("data", shape=shape, dtype="f4", chunks=True, compression="gzip")
            data.attrs["start"], data.attrs["sampling_rate_hz"] = start, 25.0
    scada = campaign.scada.drop(columns="state").assign(power_kw=np.linspace(0, 5000, len(campaign.scada)))
    scada["time"] = scada["time"].dt.strftime("%Y-%m-%dT%H:%M:%SZ")
    scada.to_csv(folder / "scada.csv", index=False)


def _write_model(folder: Path, parameters, channels) -> None:
    """Matrices: a chain of masses, one a channel; every parameter stiffens one spring."""
    n = len(channels)
    chain = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    content = {"K0": 40 * chain, "M0": np.eye(n), "channel": np.array(channels), "channel_dof": np.arange(n)}
    for k, p in enumerate(parameters):
        content[f"K_{p.name}"] = np.diag(1.0 * (np.arange(n) == k)) / p.initial
    np.savez(folder / "model.npz", **content)
    tables = []
    for p in parameters:
        tables.append(f'[[parameter]]\nname = "{p.name}"\nunit = "{p.unit}"\ninitial = {p.initial}\nstd = {p.std}\n'
                      f'lower = {p.lower}\nupper = {p.upper}\nprior = "{p.prior}"\n')
    (folder / "parameters.toml").write_text("\n".join(tables))


def write_run(folder: Path, run) -> Path:
    folder.mkdir(exist_ok=True)
    _write_campaign(folder / "campaign", run.campaign)
    _write_model(folder, run.update.parameters, run.modes.channels)
    write_modes(run.modes, folder / "modes.json")
    write_modes(run.nine, folder / "nine.json")
    run.poles.to_csv(folder / "modes.poles.csv", index=False)
    run.selection.to_csv(folder / "selection.csv", index=False)
    write_update(run.update, folder / "update.json")
    write_posterior(run.posterior, folder / "posterior.nc")
    write_comparison(run.comparison, folder / "compare.json")
    (folder / "diagnosis.json").write_text(json.dumps(run.diagnosis))
    (folder / "run.json").write_text(json.dumps({"title": "June <b>", "seed": 7, "version": "0.1.0"}))
    return folder


@pytest.fixture(scope="module")
def directory(full_run, tmp_path_factory):
    return write_run(tmp_path_factory.mktemp("report") / "run", full_run)


@pytest.fixture
def own(directory, tmp_path):
    """The directory by links, so that a test may take a part away or put another in its place."""
    for path in directory.iterdir():
        (tmp_path / path.name).symlink_to(path)
    return tmp_path


def put(folder: Path, name: str, text: str) -> None:
    (folder / name).unlink(missing_ok=True)
    (folder / name).write_text(text)


def test_what_the_steps_wrote_comes_back(directory, full_run):
    run = read_run(directory, silent)
    assert run.missing == () and run.warnings == () and run.jacket and run.title == "June <b>"
    assert run.update.parameters.names == full_run.update.parameters.names
    assert run.update.map_hz == pytest.approx(full_run.update.map_hz, nan_ok=True)
    assert np.allclose(run.posterior.draws, full_run.posterior.draws)
    assert len(run.poles) == len(full_run.poles) and run.poles["time"].iloc[0] == full_run.poles["time"].iloc[0]
    assert run.nine.reference_set == full_run.nine.reference_set
    assert run.comparison.rows[2].step_distance == pytest.approx(full_run.comparison.rows[2].step_distance)
    assert run.truth is None and run.model.wire is None
    said = dict(run.provenance)
    assert said["seed of the run"] == "7" and said["update.json"].startswith("SHA-256 ")


def test_the_update_with_the_findings_in_it_leads(own, full_run):
    """Made as `diagnose` states, beside the update of the model without them."""
    extended = replace(full_run.update, set_id="mean of 5 blocks")
    write_update(extended, own / "diagnosis.update.json")
    run = read_run(own, silent)
    assert run.update.set_id == "mean of 5 blocks" and run.posterior is None and run.comparison is None
    said = dict(run.provenance)
    assert "diagnosis.update.json" in said
    assert {n for n, words in said.items() if words.startswith("not shown")} == {
        "update.json", "posterior.nc", "compare.json"}
    write_posterior(full_run.posterior, own / "diagnosis.posterior.nc")
    assert read_run(own, silent).posterior is not None


def test_an_overlap_of_records_is_counted_once(directory):
    facts = dict(read_run(directory, silent).campaign.facts)
    # 00:00-01:30 and 03:00-04:00
    assert facts["records"] == "2.5 of 4.0 hours in 3 files"
    assert facts["recorded"] == "2019-06-03 00:00 to 2019-06-03 04:00 UTC"


def test_states_follow_the_power(directory):
    scada = read_run(directory, silent).campaign.scada
    idle, rated = scada["state"] == "idling", scada["state"] == "rated"
    assert scada["power_kw"][idle].max() <= 25 and scada["power_kw"][rated].min() >= 4850
    assert idle.any() and rated.any()


def test_the_page_of_a_directory_is_written(directory, undrawn, tmp_path):
    out = report(directory, tmp_path / "deep" / "report.html")
    page = out.read_text(encoding="utf-8")
    assert "June &lt;b&gt;" in page and 'class="notice missing"' not in page.split('id="measured"')[0]


def test_records_and_model_that_lie_elsewhere_are_named(directory, undrawn, tmp_path):
    """As the commands on data of one's own leave them: beside the run directory, not in it."""
    run = tmp_path / "run"
    run.mkdir()
    for path in directory.iterdir():
        to = tmp_path if path.name in ("campaign", "model.npz", "parameters.toml") else run
        (to / path.name).symlink_to(path)
    assert set(read_run(run, silent).missing) == {PARTS["campaign"], PARTS["model"]}
    given = {"campaign": tmp_path / "campaign", "model": tmp_path / "model.npz",
             "parameters": tmp_path / "parameters.toml"}
    found = read_run(run, silent, given)
    assert found.missing == () and found.model is not None
    assert dict(found.provenance)["../model.npz"].startswith("SHA-256 ")
    assert str(tmp_path) not in report(run, tmp_path / "r.html", **given).read_text(encoding="utf-8")
    with pytest.raises(InputError, match="--campaign: '.*/nowhere' does not exist; correct the path"):
        report(run, tmp_path / "r.html", campaign=tmp_path / "nowhere")


@pytest.mark.parametrize("name", [n for n in PARTS if n not in ("model",)])
def test_a_part_that_is_not_there_is_named(own, name):
    (own / name).unlink()
    run = read_run(own, silent)
    assert run.missing == (PARTS[name],)


def test_findings_of_a_check_are_shown(own):
    put(own, "check.json", json.dumps({"findings": ["TP-A-x is flat"]}))
    assert read_run(own, silent).campaign.findings == ("TP-A-x is flat",)
    put(own, "check.json", "[]")
    with pytest.raises(InputError, match=r"check\.json: is not a JSON table"):
        read_run(own, silent)


@pytest.mark.parametrize(("content", "words"), [
    ({"campaign": "July"}, "is of the campaign 'July', not of 'June'"),
    ({"channels": [{"channel": "M-1"}]}, r"other channels \(M-1\)"),
    ({"blocks": [{"id": "2020-01-01T00:00Z"}]}, "2020-01-01T00:00Z is not a block of this campaign"),
])
def test_a_check_of_another_campaign_is_refused(own, content, words):
    put(own, "check.json", json.dumps({"findings": ["a sensor is flat"], **content}))
    with pytest.raises(InputError, match=words):
        read_run(own, silent)


def test_a_check_of_this_campaign_is_taken(own):
    found = check(read_campaign((own / "campaign").resolve()))
    found.write(own / "check.json")
    assert read_run(own, silent).campaign.findings == found.findings
    put(own / "campaign", "campaign.toml", (own / "campaign" / "campaign.toml").read_text() + "# changed\n")
    first, *rest = read_run(own, silent).campaign.findings
    assert "campaign.toml was changed after this check" in first and tuple(rest) == found.findings


def test_settings_within_settings_are_rows_of_their_own():
    settings = dict(setting_rows("moves", {"jump": 0.25, "names": ["a", "b"], "deep": {"n": 3}}))
    assert settings == {"moves, jump": "0.25", "moves, names": "a, b", "moves, deep, n": "3"}


def test_numbers_of_different_problems_are_told_apart(own, full_run):
    (own / "posterior.nc").unlink()
    write_posterior(replace(full_run.posterior, fingerprint="other"), own / "posterior.nc")
    assert any("do not belong together" in w for w in read_run(own, silent).warnings)


def test_results_of_other_parameters_are_refused(own, full_run):
    names = ("other", *full_run.posterior.names[1:])
    (own / "posterior.nc").unlink()
    write_posterior(replace(full_run.posterior, names=names), own / "posterior.nc")
    with pytest.raises(InputError, match="have different parameters"):
        read_run(own, silent)


def with_inputs(folder: Path, diagnosis: dict) -> None:
    """diagnosis.json as `diagnose` writes it of the files that lie here."""
    made = {"model": ("model.npz", "parameters.toml"), "modes": ("modes.json",)}
    inputs = {part: {name: sha256(folder / name) for name in names} for part, names in made.items()}
    put(folder, "diagnosis.json", json.dumps(diagnosis | {"inputs": inputs}))


def test_a_diagnosis_of_these_files_is_taken(own, full_run):
    with_inputs(own, full_run.diagnosis)
    assert read_run(own, silent).warnings == ()
    # of the sets that were selected it may be as well
    (own / "modes.json").rename(own / "all.json")
    (own / "nine.json").rename(own / "modes.json")
    (own / "all.json").rename(own / "nine.json")
    assert read_run(own, silent).warnings == ()


@pytest.mark.parametrize(("name", "words"), [
    ("parameters.toml", "another model or of other parameters"), ("modes.json", "other modal sets (modes.json "),
])
def test_a_diagnosis_of_other_files_is_said(own, full_run, name, words):
    with_inputs(own, full_run.diagnosis)
    put(own, name, (own / name).read_text() + "\n")
    (said,) = read_run(own, silent).warnings
    assert words in said and name in said


def test_a_diagnosis_of_another_structure_is_refused(own, full_run):
    other = [p | {"name": f"bottom{k}"} for k, p in enumerate(full_run.diagnosis["parameters"])]
    put(own, "diagnosis.json", json.dumps(full_run.diagnosis | {"parameters": other}))
    with pytest.raises(InputError, match=r"another structure: none of its parameters \(bottom0.*k_j"):
        read_run(own, silent)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("run.json", "{", r"run\.json: not JSON"),
        ("run.json", "[]", r"run\.json: is not a JSON table"),
        ("run.json", '{"model": "../other/model.toml"}', "leaves the folder .*; copy it into the run directory"),
        ("run.json", '{"campaign": "June"}', "'June' does not exist"),
        ("run.json", '{"campain": "June"}', r"run\.json: unknown key 'campain'; did you mean 'campaign'"),
        ("run.json", '{"parametrs_file": "p.toml"}', r"unknown key 'parametrs_file'; did you mean 'parameters'"),
        ("run.json", '{"weather": 1}', r"unknown key 'weather'; write \{"),
        ("modes.poles.csv", "time,frequency_hz\n", "has no column 'mac'"),
        ("modes.poles.csv", "time,frequency_hz,mac,mode,criterion\nnoon,1,1,FA1,kept\n", "not a time"),
        ("selection.csv", "\n", "not a table"),
        ("update.json", "{}", r"is not update\.json"),
        ("compare.json", "{}", r"is not compare\.json"),
    ],
)
def test_a_broken_part_is_one_line(own, name, text, message):
    put(own, name, text)
    with pytest.raises(InputError, match=message) as error:
        read_run(own, silent)
    assert "\n" not in str(error.value)


def test_what_is_no_run_is_refused(tmp_path):
    with pytest.raises(InputError, match="holds nothing of a run"):
        report(tmp_path, tmp_path / "r.html")
    with pytest.raises(InputError, match="is not a directory"):
        report(tmp_path / "none", tmp_path / "r.html")


def test_a_turbine_is_drawn_with_its_modes_matched(undrawn, tmp_path):
    """Modes made by the model itself, turned within their pairs: the viewer's states get the model's frequencies."""
    path = reference_model("as_built")
    model = load_model(path)
    solution = model.solve(model.parameters.initial, 5)
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    shape = np.array(solution.shape)
    shape[:, :2] = shape[:, :2] / np.linalg.norm(shape[:, :2], axis=0) @ turn
    table = {"channels": list(model.channels), "sets": [{
        "id": "one", "frequency_hz": solution.frequency_hz.tolist(), "shape_re": shape.T.tolist()}]}
    (tmp_path / "modes.json").write_text(json.dumps(table))
    (tmp_path / "model.toml").write_text(path.read_text())
    run = read_run(tmp_path, silent)
    assert run.model.states["initial"].frequency_hz == pytest.approx(solution.frequency_hz)
    assert (0, 1) in run.model.pairs and run.jacket and run.title == model.name
    assert "Drag turns" in report(tmp_path, tmp_path / "r.html").read_text(encoding="utf-8")


def test_a_measured_structure_needs_no_campaign_and_no_geometry(tmp_path):
    """Matrices, and modes that were not measured in the model's order; nothing else."""
    n, order = 8, [2, 0, 3, 1]
    K = 2e4 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    value, shape = np.linalg.eigh(K)
    names = [f"P{k}" for k in range(n)]
    np.savez(tmp_path / "model.npz", K0=0 * K, K_k=K, M0=np.eye(n), channel=np.array(names), channel_dof=np.arange(n))
    (tmp_path / "parameters.toml").write_text('[[parameter]]\nname = "k"\nunit = "-"\ninitial = 1.0\ncov = 0.1\n')
    measured = 1.05 * np.sqrt(value[order]) / (2 * np.pi)
    write_modes(ModalData(channels=tuple(names), sets=(ModalSet(
        id="one", frequency_hz=measured, shape=shape[:, order].astype(complex), damping_ratio=np.full(4, 0.01),
        frequency_std_hz=0.01 * measured, shape_std=np.full((n, 4), 0.02)),)), tmp_path / "modes.json")
    run = read_run(tmp_path, silent)
    assert run.model.states["initial"].frequency_hz == pytest.approx(measured / 1.05)
    page = report(tmp_path, tmp_path / "r.html").read_text(encoding="utf-8")
    assert "channel by channel" in page and "class=\"number paper\"" not in page and "mode 4" in page


def test_a_model_of_matrices_with_places_is_drawn_in_space(tmp_path, full_run):
    """Nodes without lines: dots. The channels' places are not known, so nothing measured is drawn among them."""
    _write_model(tmp_path, full_run.update.parameters, full_run.modes.channels)
    write_modes(full_run.nine, tmp_path / "nine.json")
    with np.load(tmp_path / "model.npz") as archive:
        content = dict(archive)
    n = len(content["channel"])
    content |= {"node_position_m": np.column_stack([np.zeros(n), np.zeros(n), np.arange(n)]), "dof_node": np.arange(n),
                "dof_direction": np.zeros(n, int)}
    np.savez(tmp_path / "model.npz", **content)
    run = read_run(tmp_path, silent)
    assert run.model.wire.node_m.shape == (n, 3) and len(run.model.wire.line) == 0
    page = report(tmp_path, tmp_path / "r.html").read_text(encoding="utf-8")
    assert "data-viewer>" in page and "Drag turns" in page
