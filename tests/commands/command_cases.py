"""A small shear building as matrices, its measured modes and a short campaign: what the commands are tried on."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
from scipy import linalg

N_FLOOR, N_MODE = 20, 4
CHANNELS = ("F05", "F10", "F14", "F17", "F20")
FLOORS = np.array([5, 10, 14, 17, 20]) - 1
GROUPS = {"low": range(0, 7), "middle": range(7, 14), "high": range(14, 20)}
# relative changes of the storeys' stiffness in the building that was "measured"
TRUTH = np.array([-0.20, 0.15, 0.05])
FREQUENCY_COV = 0.004
SHAPE_STD = 0.02
PARAMETERS = "".join(
    f'[[parameter]]\nname = "{name}"\nunit = "-"\ninitial = 0.0\nstd = 0.2\nlower = -0.6\nupper = 0.6\n\n'
    for name in GROUPS
)


def storey_matrix(storeys) -> np.ndarray:
    k = np.zeros((N_FLOOR, N_FLOOR))
    for s in storeys:
        k[s, s] += 4.0e6
        if s > 0:
            k[s - 1, s - 1] += 4.0e6
            k[s - 1, s] -= 4.0e6
            k[s, s - 1] -= 4.0e6
    return k


def matrices() -> dict[str, np.ndarray]:
    """K0, M0, K_<name> and the channels, as model.npz holds them."""
    parts = {f"K_{name}": storey_matrix(storeys) for name, storeys in GROUPS.items()}
    return {
        "K0": sum(parts.values()), "M0": np.diag(np.full(N_FLOOR, 1000.0)), **parts,
        "channel": np.array(CHANNELS), "channel_dof": FLOORS,
    }


def true_modes(theta) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (n,) in Hz and shapes (n_channel, n) by a dense solver of its own."""
    m = matrices()
    k = m["K0"] + sum(t * m[f"K_{name}"] for t, name in zip(theta, GROUPS, strict=True))
    value, vector = linalg.eigh(k, m["M0"])
    return np.sqrt(value) / (2 * np.pi), vector[FLOORS]


def modes_table(n_set: int = 3, seed: int = 7) -> dict:
    """modes.json of the building at TRUTH with noise; column order of the modes is not the model's."""
    rng = np.random.default_rng(seed)
    frequency, shape = true_modes(TRUTH)
    order = [1, 0, 2, 3]
    sets = []
    for number in range(n_set):
        noisy = frequency[order] * (1 + FREQUENCY_COV * rng.standard_normal(N_MODE))
        scaled = shape[:, order] / np.max(np.abs(shape[:, order]), axis=0)
        scaled = scaled + SHAPE_STD * rng.standard_normal(scaled.shape)
        sets.append({
            "id": f"2026-06-01T0{number}:00Z", "frequency_hz": noisy.tolist(),
            "frequency_std_hz": (FREQUENCY_COV * frequency[order]).tolist(), "shape_re": scaled.T.tolist(),
            "shape_std": np.full(scaled.T.shape, SHAPE_STD).tolist(), "damping_ratio": [0.01] * N_MODE,
            "environment": {"water_level_m": 0.1 * number},
        })
    return {"channels": list(CHANNELS), "sets": sets}


def write_building(folder: Path) -> dict[str, str]:
    """model.npz, parameters.toml and modes.json in `folder`; their paths by name."""
    np.savez(folder / "model.npz", **matrices())
    (folder / "parameters.toml").write_text(PARAMETERS)
    (folder / "modes.json").write_text(json.dumps(modes_table()))
    return {name: str(folder / f"{name}{end}") for name, end in
            (("model", ".npz"), ("parameters", ".toml"), ("modes", ".json"))}


CAMPAIGN = """name = "Short"
sampling_rate_hz = 10.0
block_minutes = 10
"""
SENSOR = """
[[sensor]]
channel = "{channel}"
level = "{level}"
position_m = {position}
direction = {direction}
quantity = "acceleration"
unit = "m/s2"
"""
PLACES = {
    "TP-A-x": ("TP", [5.6, 5.6, 15.0], [1.0, 0.0, 0.0]),
    "TP-A-y": ("TP", [5.6, 5.6, 15.0], [0.0, 1.0, 0.0]),
    "T90-x": ("tower", [0.0, 0.0, 90.0], [1.0, 0.0, 0.0]),
}


def campaign_text(**changes: str) -> str:
    text = CAMPAIGN + "".join(
        SENSOR.format(channel=c, level=level, position=p, direction=d) for c, (level, p, d) in PLACES.items()
    )
    for old, new in changes.values():
        assert old in text
        text = text.replace(old, new, 1)
    return text


def write_campaign(folder: Path, *, blocks: int = 3, data: np.ndarray | None = None) -> Path:
    """A campaign of white noise: enough for every look at it, not for modes."""
    (folder / "acceleration").mkdir(parents=True)
    (folder / "campaign.toml").write_text(campaign_text())
    rng = np.random.default_rng(3)
    for number in range(blocks):
        values = 0.01 * rng.standard_normal((6000, len(PLACES))) if data is None else data
        with h5py.File(folder / "acceleration" / f"block-{number}.h5", "w") as file:
            held = file.create_dataset("data", data=values.astype(np.float32))
            held.attrs["start"] = f"2026-06-01T00:{10 * number:02d}:00Z"
            held.attrs["sampling_rate_hz"] = 10.0
    rows = [f"2026-06-01T00:{10 * k:02d}:00Z,{5.0 + k},{0.0}" for k in range(blocks)]
    (folder / "scada.csv").write_text("time,wind_speed_mps,power_kw\n" + "\n".join(rows) + "\n")
    return folder
