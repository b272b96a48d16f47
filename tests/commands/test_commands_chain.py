"""The whole job on a short virtual campaign, from raw records to the report, against the campaign's truth."""

from __future__ import annotations

import re
import tomllib

import numpy as np
import pytest

from probupdate.cli import main
from probupdate.modal.modes import read_modes
from probupdate.structure.load import reference_model
from probupdate.updating.posterior_file import read_posterior
from probupdate.updating.update_file import read_update

# the parameters the first and second bending pairs see best; the others stay as built
UPDATED = ("k_t", "k_TP", "tz")


def as_built_with_three_parameters() -> str:
    text = reference_model("as_built").read_text(encoding="utf-8")
    tables = re.split(r"(?=^\[\[parameter\]\])", text, flags=re.M)
    kept = []
    for table in tables:
        name = re.search(r'^name = "(\w+)"', table, flags=re.M)
        if table.startswith("[[parameter]]") and name.group(1) not in UPDATED:
            table = re.sub(r"^update = true", "update = false", table, flags=re.M)
        kept.append(table)
    return "".join(kept)


@pytest.mark.long
def test_from_records_to_report(tmp_path, validation):
    row = validation(what="records to report in twelve hours of measurement, three parameters (long): errors over "
                          "those of the initial model, of the worst frequency, of k_TP's maximum, of its mean",
                     reference="its truth", why="another formulation made the data, the lateral soil stays wrong")
    run, campaign, model = tmp_path, tmp_path / "campaign", tmp_path / "model.toml"
    model.write_text(as_built_with_three_parameters(), encoding="utf-8")
    modes, nine, update, posterior = (str(run / f) for f in ("modes.json", "nine.json", "update.json", "posterior.nc"))
    problem = ["--model", str(model), "--modes", nine, "--weights", "paper"]
    for command in (
        ["simulate", str(campaign), "--model", "updated", "--days", "0.5", "--seed", "1"],
        ["check", str(campaign), "--out", str(run / "check.json")],
        ["identify", str(campaign), "--model", str(model), "--out", modes],
        ["select", modes, "--scada", str(campaign / "scada.csv"), "--out", nine],
        ["update", *problem, "--out", update],
        ["sample", *problem, "--out", posterior, "--ess", "50", "--max-steps", "200"],
        ["compare", update, posterior, "--model", str(model), "--out", str(run / "compare.json")],
        ["report", str(run), "--out", str(run / "report.html")],
    ):
        assert main(command) == 0, command[0]
    truth = tomllib.loads((campaign / "truth.toml").read_text())["parameters"]
    record, drawn = read_update(update), read_posterior(posterior)
    data = read_modes(nine)
    assert {"FA1", "SS1", "FA2", "SS2"} <= set(data.labels)
    # the lateral soil stays as built, seven times too stiff, so that three parameters cannot close the whole gap
    used = np.isfinite(record.map_hz)
    error = np.abs(record.map_hz[used] / record.measured_hz[used] - 1)
    before = np.abs(record.initial_hz[used] / record.measured_hz[used] - 1)
    row.error(error.max() / before.max(), 0.5, "frequency")
    # both estimates of the transition piece's stiffness, the best informed parameter, come nearer to the truth
    k = record.parameters.index("k_TP")
    start = abs(record.parameters.initial[k] - truth["k_TP"])
    row.error((record.map_theta[k] - truth["k_TP"]) / start, 0.5, "maximum")
    row.error((drawn.draws[:, k].mean() - truth["k_TP"]) / start, 0.5, "mean")
    assert (run / "report.html").stat().st_size > 100_000
