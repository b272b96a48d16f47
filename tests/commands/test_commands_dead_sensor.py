"""Raw records of which one channel is dead and another is skewed go through every step, and end."""

import re

import h5py
import numpy as np
import pytest
from known_frame import write_campaign

from probupdate.cli import main


@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_a_dead_and_a_skewed_channel_are_said_and_end_no_step(tmp_path, monkeypatch, capsys, noise):
    monkeypatch.chdir(tmp_path)
    campaign = write_campaign(tmp_path / "c", blocks=6)
    rng = np.random.default_rng(0)
    for path in (campaign / "acceleration").glob("*.h5"):
        with h5py.File(path, "r+") as file:
            rows = file["data"][:]
            rows[:, 3] = np.where(rows[:, 3] > 0, 3 * rows[:, 3], rows[:, 3])
            rows[:, 1] = noise * rng.standard_normal(len(rows))
            file["data"][...] = rows
    assert main(["check", "c"]) == 0
    assert "storey-2" in capsys.readouterr().out
    if not noise:
        assert main(["identify", "c", "--out", "m.json"]) == 2
        (left_out,) = re.findall(r'leave_out = \["storey-2"\]', capsys.readouterr().err)
        table = campaign / "campaign.toml"
        table.write_text(f"{left_out}\n{table.read_text()}")
    assert main(["identify", "c", "--out", "m.json"]) == 0
    assert main(["diagnose", "--modes", "m.json", "--campaign", "c", "--out", "d.json"]) == 0
    assert "verdict: " in capsys.readouterr().out
