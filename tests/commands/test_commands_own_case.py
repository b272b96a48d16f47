"""A first case of one's own: a shear building, records in CSV, a model of matrices, from `convert` to `report`.

The records are made here, by modal superposition of discretised oscillators, not by the package's simulator.
"""

import json

import numpy as np
import pytest
from scipy import linalg, signal

from probupdate.cli import main
from probupdate.modal.modes import read_modes
from probupdate.updating.update_file import read_update

RATE_HZ, MINUTES, BLOCK_MINUTES, STIFFER = 40.0, 40, 10, 1.10
MASS_KG, DAMPING = 2e4, 0.01


def stiffness(spring):
    """Of a shear building, storeys from the ground up."""
    K = np.diag(np.array(spring, float))
    K[:-1, :-1] += np.diag(spring[1:])
    return K - np.diag(spring[1:], 1) - np.diag(spring[1:], -1)


def springs(n):
    return 3.0e7 * np.linspace(1.0, 0.7, n)


def frequencies(n):
    return np.sqrt(linalg.eigvalsh(STIFFER * stiffness(springs(n)), MASS_KG * np.eye(n))) / (2 * np.pi)


def write_case(folder, n, measured):
    """Columns of CSV with the storeys `measured`, campaign.toml, convert.toml, model.npz and parameters.toml."""
    value, shape = linalg.eigh(STIFFER * stiffness(springs(n)), MASS_KG * np.eye(n))
    rng = np.random.default_rng(4)
    size = int(60 * MINUTES * RATE_HZ)
    force = 1e3 * rng.standard_normal((size, n))
    motion = np.empty((size, n))
    for j, w in enumerate(np.sqrt(value)):
        b, a, _ = signal.cont2discrete(([1.0, 0.0, 0.0], [1.0, 2 * DAMPING * w, w * w]), 1 / RATE_HZ, method="zoh")
        motion[:, j] = signal.lfilter(b.ravel(), a, force @ shape[:, j])
    record = motion @ shape.T + 1e-4 * rng.standard_normal((size, n))
    names = [f"floor {k + 1}" for k in measured]
    (folder / "raw").mkdir(parents=True)
    (folder / "campaign").mkdir()
    second = np.arange(size) / RATE_HZ
    np.savetxt(folder / "raw" / "one.csv", np.column_stack([second, record[:, measured]]), delimiter=",", fmt="%.9g",
               header=",".join(["t", *names]), comments="")
    sensors = "".join(
        f'[[sensor]]\nchannel = "{name}"\nlevel = "{name}"\nposition_m = [0.0, 0.0, {3.0 * (k + 1)}]\n'
        'direction = [1.0, 0.0, 0.0]\nquantity = "acceleration"\nunit = "m/s2"\n'
        for name, k in zip(names, measured, strict=True)
    )
    (folder / "campaign" / "campaign.toml").write_text(
        f'name = "building"\nsampling_rate_hz = {RATE_HZ}\nblock_minutes = {BLOCK_MINUTES}\n{sensors}')
    (folder / "campaign" / "convert.toml").write_text(
        'files = "*.csv"\ntime = "t"\ntime_unit = "s"\nstart = "2024-05-01T00:00:00Z"\n')
    each = {f"K_k{k + 1}": stiffness(springs(n) * (np.arange(n) == k)) for k in range(n)}
    np.savez(folder / "model.npz", K0=stiffness(springs(n)), M0=MASS_KG * np.eye(n), channel=np.array(names),
             channel_dof=np.array(measured), **each)
    (folder / "parameters.toml").write_text("".join(
        f'[[parameter]]\nname = "k{k + 1}"\nunit = "-"\ninitial = 0.0\nstd = 0.15\nlower = -0.5\nupper = 1.0\n'
        'prior = "normal"\n' for k in range(n)))
    return folder


def run(*words):
    assert main([str(w) for w in words]) == 0, words


def identified(case, n):
    run("convert", case / "raw", case / "campaign")
    run("check", case / "campaign")
    run("identify", case / "campaign", "--model", case / "model.npz", "--lowest", n,
        "--out", case / "run" / "modes.json")
    return read_modes(case / "run" / "modes.json")


@pytest.fixture(scope="module")
def building(tmp_path_factory):
    case = write_case(tmp_path_factory.mktemp("building"), 3, [0, 1, 2])
    return case, identified(case, 3)


def test_three_storeys_from_csv_to_report(building, validation):
    row = validation(what="a building of its own from CSV to report: f; stiffness in standard deviations",
                     reference="modal superposition written in the test", why="discretisation")
    case, data = building
    out, model = case / "run", case / "model.npz"
    found = np.nanmean([s.frequency_hz for s in data.sets], axis=0)
    # half a per cent: the discretised oscillators' own, and 40 minutes
    assert len(data.sets) == 4
    row.error(found[:3] / frequencies(3) - 1, below=5e-3, of="f")
    run("select", out / "modes.json", "--out", out / "nine.json")
    run("update", "--model", model, "--modes", out / "modes.json", "--out", out / "update.json")
    run("sample", "--model", model, "--modes", out / "modes.json", "--out", out / "posterior.nc", "--ess", 200)
    run("compare", out / "update.json", out / "posterior.nc", "--out", out / "compare.json")
    run("report", out, "--out", out / "report.html")
    record = read_update(out / "update.json")
    std = np.sqrt(np.diag(record.map_covariance))
    row.error((record.map_theta - (STIFFER - 1)) / std, below=4, of="stiffness")
    assert np.all(std < 0.03)
    rows = json.loads((out / "compare.json").read_text())["rows"]
    assert {r["identified"] for r in rows} == {"strongly identified"}
    assert (out / "report.html").stat().st_size > 1e5


def test_without_a_model_the_same_three_modes(building):
    case, _ = building
    run("identify", case / "campaign", "--out", case / "alone.json")
    data = read_modes(case / "alone.json")
    found = np.nanmean([s.frequency_hz for s in data.sets], axis=0)
    assert found[:3] == pytest.approx(frequencies(3), rel=5e-3)


def test_four_sets_are_diagnosed_by_what_they_state(building, capsys):
    case, _ = building
    words = ["diagnose", "--model", case / "model.npz", "--modes", case / "run" / "modes.json",
             "--out", case / "d.json"]
    assert main([str(w) for w in words]) == 0
    assert "4 sets show too little scatter" in capsys.readouterr().out
    # nothing is hidden in the building but the storeys' own stiffness
    assert json.loads((case / "d.json").read_text())["verdict"] in ("none", "named", "ambiguous")


@pytest.mark.parametrize(("n", "measured"), [(1, [0]), (2, [0, 1]), (3, [2])])
def test_small_structures_and_a_single_sensor(tmp_path, n, measured, validation):
    """One and two degrees of freedom, and one sensor on three storeys: frequencies alone."""
    row = validation(what="one and two degrees of freedom, one sensor on three storeys: f identified, f updated",
                     reference="closed form; the identified ones", why="discretisation")
    case = write_case(tmp_path, n, measured)
    data = identified(case, n)
    found = np.nanmean([s.frequency_hz for s in data.sets], axis=0)
    row.error(found[:n] / frequencies(n) - 1, below=5e-3, of="identified")
    run("update", "--model", case / "model.npz", "--modes", case / "run" / "modes.json", "--out", case / "update.json")
    record = read_update(case / "update.json")
    fitted = record.map_hz[np.isfinite(record.map_hz)]
    row.error(fitted / found[:n] - 1, below=0.01, of="updated")
    assert any("paired by frequency alone" in text for text in record.left_out) == (len(measured) == 1)
