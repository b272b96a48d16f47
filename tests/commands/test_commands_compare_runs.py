"""`compare RUN RUN`: two runs beside each other, number by number."""

import json

import numpy as np
import pandas as pd
import pytest

from probupdate.cli import main
from probupdate.updating.posterior_file import Posterior, write_posterior


def write_run(folder, mean, std, *, seed, measured=1.0, names=("k", "m"), converged=True):
    """A run with a made-up posterior and three modal sets."""
    folder.mkdir()
    rng = np.random.default_rng(seed)
    theta = np.asarray(mean) + np.asarray(std) * rng.standard_normal((4, 500, len(names)))
    write_posterior(Posterior(
        names=names, theta=theta, log_likelihood=np.zeros((4, 500)), log_posterior=np.zeros((4, 500)),
        prior=theta[0, :10], response_labels=("f",), measured=np.array([measured]), std=np.ones(1),
        predicted=np.ones((2, 1)), frequency_hz=np.ones((2, 1)), mode_labels=("FA1",), r_hat=np.ones(len(names)),
        ess=np.full(len(names), 400.0), converged=converged, verdict="made up", fingerprint="none",
        record={"evidence": {"log_evidence": 3.25, "std": 0.01}}), folder / "posterior.nc")
    sets = [{"id": f"2024-01-0{k + 1}T00:00Z", "frequency_hz": [measured * f], "damping_ratio": [0.01],
             "shape_re": [[1.0, 0.5]]} for k, f in enumerate((0.99, 1.0, 1.01))]
    (folder / "modes.json").write_text(json.dumps({"channels": ["a", "b"], "labels": ["FA1"], "sets": sets}))
    return folder


def test_differences_are_in_their_own_standard_deviations(tmp_path, capsys):
    a = write_run(tmp_path / "a", [1.0, 5.0], [0.03, 0.4], seed=1)
    b = write_run(tmp_path / "b", [1.2, 5.0], [0.04, 0.3], seed=2)
    assert main(["compare", str(a), str(b), "--out", str(tmp_path / "c.csv")]) == 0
    table = pd.read_csv(tmp_path / "c.csv").set_index(["kind", "name"])
    # four standard deviations of 0.05, with the scatter of 2000 draws
    assert table.loc[("parameter", "k"), "standardised"] == pytest.approx(4.0, abs=0.2)
    assert abs(table.loc[("parameter", "m"), "standardised"]) < 0.2
    assert table.loc[("frequency", "FA1"), "first_std"] == pytest.approx(0.01 / np.sqrt(3), rel=1e-6)
    words = capsys.readouterr().out
    assert "1 of 4 numbers differ" in words and "ln evidence: 3.25 ± 0.01 (both)" in words


def test_what_must_not_be_compared_is_said(tmp_path, capsys):
    a = write_run(tmp_path / "a", [1.0, 5.0], [0.03, 0.4], seed=1)
    b = write_run(tmp_path / "b", [1.0, 5.0], [0.03, 0.4], seed=1, measured=1.1, names=("k", "q"), converged=False)
    assert main(["compare", str(a), str(b), "--out", str(tmp_path / "c.json")]) == 0
    notes = json.loads((tmp_path / "c.json").read_text())["notes"]
    assert len(notes) == 4 and any("ln evidence is of other data" in n for n in notes)
    held = {r["name"]: r["standardised"] for r in json.loads((tmp_path / "c.json").read_text())["rows"]
            if r["kind"] == "parameter"}
    assert held["m"] is None and held["q"] is None and held["k"] == 0.0


def test_a_folder_without_results_is_named(tmp_path, capsys):
    a = write_run(tmp_path / "a", [1.0, 5.0], [0.03, 0.4], seed=1)
    (tmp_path / "empty").mkdir()
    assert main(["compare", str(a), str(tmp_path / "empty"), "--out", str(tmp_path / "c.json")]) == 2
    assert "holds neither posterior.nc nor modes.json" in capsys.readouterr().err


def compared(tmp_path, first, second, *, step_min=30, decimals=None, **stated):
    """Rows of two runs whose sets have these frequencies (n_set, 1) in Hz."""
    for name, values in (("a", first), ("b", second)):
        (tmp_path / name).mkdir()
        values = values if decimals is None else np.round(values, decimals)
        sets = [{"id": str(np.datetime64("2024-01-01T00:00") + np.timedelta64(step_min * k, "m")) + "Z",
                 "frequency_hz": [float(f)], **stated} for k, f in enumerate(values)]
        (tmp_path / name / "modes.json").write_text(json.dumps({"channels": [], "labels": ["FA1"], "sets": sets}))
    assert main(["compare", *(str(tmp_path / name) for name in "ab"), "--out", str(tmp_path / "c.json")]) == 0
    (row,) = json.loads((tmp_path / "c.json").read_text())["rows"]
    return row


def slow(rng, n, decay=0.9):
    """Ornstein-Uhlenbeck errors (n,) of standard deviation one."""
    found = np.empty(n)
    found[0] = rng.standard_normal()
    for k in range(1, n):
        found[k] = decay * found[k - 1] + np.sqrt(1 - decay**2) * rng.standard_normal()
    return found


def test_what_lasts_for_hours_is_no_change_between_days(tmp_path):
    apart = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        (folder := tmp_path / str(seed)).mkdir()
        apart.append(compared(folder, *(0.32 * (1 + 3e-3 * slow(rng, 48)) for _ in range(2)))["standardised"])
    # two standard deviations: by chance in one of twenty, five of twenty with a probability of 0.003
    assert np.sum(np.abs(apart) > 2) < 5


@pytest.mark.parametrize("n", [3, 9, 40])
def test_a_step_of_rounded_frequencies_is_a_difference(tmp_path, n):
    row = compared(tmp_path, np.full(n, 0.3204), np.full(n, 0.3502), decimals=2)
    assert row["first_std"] == pytest.approx(0.01 / np.sqrt(12))
    assert row["standardised"] == pytest.approx(0.03 / (0.01 / np.sqrt(6)))


def test_single_sets_are_compared_by_what_they_state(tmp_path):
    row = compared(tmp_path, [0.320114], [0.323217], frequency_std_hz=[0.0011])
    assert row["standardised"] == pytest.approx(0.003103 / 0.0011 / np.sqrt(2))
    (other := tmp_path / "silent").mkdir()
    row = compared(other, [0.320114], [0.323217])
    assert row["first"] == pytest.approx(0.320114) and row["first_std"] is row["standardised"] is None
