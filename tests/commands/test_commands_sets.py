"""`sets` of a building whose upper storeys differ from set to set."""

import json

import numpy as np
import pytest
from command_cases import CHANNELS, GROUPS, TRUTH, true_modes

from probupdate.cli import main


@pytest.mark.parametrize("scatter", [0.0, 0.02, 0.08])
def test_one_value_of_sets_that_differ_lies_among_them(building, scatter):
    """Slopes at each set's own place would make up for the sets' scatter far away."""
    rng = np.random.default_rng(1)
    theta = TRUTH + scatter * rng.standard_normal((9, 1)) * [0, 0, 1]
    sets = []
    for k, row in enumerate(theta):
        frequency, shape = (found[..., :4] for found in true_modes(row))
        shape = shape / np.abs(shape).max(axis=0)
        sets.append({"id": f"2026-06-0{k + 1}T00:00Z", "frequency_std_hz": (1e-3 * frequency).tolist(),
                     "frequency_hz": (frequency * (1 + 1e-3 * rng.standard_normal(4))).tolist(),
                     "shape_re": (shape + 0.01 * rng.standard_normal(shape.shape)).T.tolist(),
                     "shape_std": np.full(shape.T.shape, 0.01).tolist()})
    modes, out = building["folder"] / "nine.json", building["folder"] / "sets.json"
    modes.write_text(json.dumps({"channels": list(CHANNELS), "sets": sets}))
    assert main(["sets", "--model", building["model"], "--modes", str(modes), "--out", str(out)]) == 0
    rows = {row["name"]: row for row in json.loads(out.read_text())["rows"]}
    for name, own in zip(GROUPS, theta.T, strict=True):
        # standard deviations of one set's estimate, of the sets, and of their common value
        std = np.hypot(np.std(own), abs(rows[name]["joint_cov"] or 0.0) * abs(rows[name]["joint_mean"]))
        assert abs(rows[name]["joint_mean"] - own.mean()) < 3 * std
        assert abs(rows[name]["pooled_mean"] - own.mean()) < 3 * std
