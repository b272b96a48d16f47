"""A small farm of shear buildings: three storeys each, three accelerometers, a model of matrices; and its farm.toml."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
from scipy import linalg, signal

RATE_HZ, BLOCK_MINUTES, BLOCKS = 20.0, 3, 4
MASS_KG, DAMPING, SPRING = 2e4, 0.01, 6.0e6
DESCRIPTION = """\
name = "Three buildings"
model = "model.npz"
steps = ["identify", "select", "update", "diagnose"]
[identify]
lowest = 3
[select]
preset = "structure"
count = 2
[diagnose]
records = false
extend = false
[[turbine]]
name = "A"
campaigns = "A/2024-*"
[[turbine]]
name = "B"
campaigns = "B/2024-*"
"""


def stiffness(spring) -> np.ndarray:
    found = np.diag(np.array(spring, float))
    found[:-1, :-1] += np.diag(spring[1:])
    return found - np.diag(spring[1:], 1) - np.diag(spring[1:], -1)


def write_campaign(folder: Path, factor: float, seed: int, start: str, blocks: int = BLOCKS) -> None:
    """Records of a building whose storeys are `factor` times as stiff, by discretised oscillators."""
    value, shape = linalg.eigh(factor * stiffness(np.full(3, SPRING)), MASS_KG * np.eye(3))
    rng = np.random.default_rng(seed)
    size = int(60 * BLOCK_MINUTES * blocks * RATE_HZ)
    force = 1e3 * rng.standard_normal((size, 3))
    motion = np.empty((size, 3))
    for j, w in enumerate(np.sqrt(value)):
        b, a, _ = signal.cont2discrete(([1.0, 0.0, 0.0], [1.0, 2 * DAMPING * w, w * w]), 1 / RATE_HZ, method="zoh")
        motion[:, j] = signal.lfilter(b.ravel(), a, force @ shape[:, j])
    record = motion @ shape.T + 1e-4 * rng.standard_normal((size, 3))
    (folder / "acceleration").mkdir(parents=True)
    sensors = "".join(
        f'[[sensor]]\nchannel = "floor {k + 1}"\nlevel = "{k + 1}"\nposition_m = [0.0, 0.0, {3.0 * (k + 1)}]\n'
        'direction = [1.0, 0.0, 0.0]\nquantity = "acceleration"\nunit = "m/s2"\n' for k in range(3))
    (folder / "campaign.toml").write_text(
        f'name = "building"\nsampling_rate_hz = {RATE_HZ}\nblock_minutes = {BLOCK_MINUTES}\n{sensors}')
    with h5py.File(folder / "acceleration" / "all.h5", "w") as file:
        data = file.create_dataset("data", data=record.astype(np.float32))
        data.attrs["start"], data.attrs["sampling_rate_hz"] = start, RATE_HZ


def write_model(folder: Path) -> None:
    each = {f"K_k{k + 1}": stiffness(np.full(3, SPRING) * (np.arange(3) == k)) for k in range(3)}
    np.savez(folder / "model.npz", K0=stiffness(np.full(3, SPRING)), M0=MASS_KG * np.eye(3),
             channel=np.array([f"floor {k + 1}" for k in range(3)]), channel_dof=np.arange(3), **each)
    (folder / "parameters.toml").write_text("".join(
        f'[[parameter]]\nname = "k{k + 1}"\nunit = "-"\ninitial = 0.0\nstd = 0.15\nlower = -0.5\nupper = 1.0\n'
        'prior = "normal"\n' for k in range(3)))


def write_farm(folder: Path) -> Path:
    """A: two months alike. B: softer by 6 % in the second, so that frequencies fall by 3 %."""
    folder.mkdir(parents=True, exist_ok=True)
    write_model(folder)
    for k, (turbine, month, factor) in enumerate((("A", "05", 1.0), ("A", "06", 1.0), ("B", "05", 1.0),
                                                  ("B", "06", 0.94))):
        write_campaign(folder / turbine / f"2024-{month}", factor, k, f"2024-{month}-01T00:00:00Z")
    (folder / "farm.toml").write_text(DESCRIPTION)
    return folder / "farm.toml"
