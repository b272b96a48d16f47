"""A record whose modes are known, by a program that is not ours: a frame of four storeys in modal coordinates, each the
response of a damped oscillator to white noise by `scipy.signal`, and a machine that runs at a speed of its own."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
from scipy import linalg, signal

RATE_HZ, MINUTES, MACHINE_HZ = 20.0, 10.0, 2.85
DAMPING = (0.010, 0.012, 0.015, 0.018)


def modes() -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (4,) in Hz and shapes (4, 4) of a shear frame, by `scipy.linalg.eigh`."""
    stiffness = 2.0 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1)
    stiffness[3, 3] = 1.0
    square, shape = linalg.eigh(900.0 * stiffness, np.eye(4))
    return np.sqrt(square) / (2 * np.pi), shape / np.abs(shape).max(axis=0)


def write_campaign(folder: Path, *, blocks: int = 1, seed: int = 3) -> Path:
    """The folder of a campaign with `campaign.toml` and one file a block."""
    frequency, shape = modes()
    n = int(60 * MINUTES * RATE_HZ)
    (folder / "acceleration").mkdir(parents=True)
    (folder / "campaign.toml").write_text(
        f'name = "frame"\nsampling_rate_hz = {RATE_HZ}\nblock_minutes = {MINUTES:g}\n' + "".join(
            f'[[sensor]]\nchannel = "storey-{k + 1}"\nlevel = "storey {k + 1}"\n'
            f"position_m = [0.0, 0.0, {3.0 * k + 3}]\n"
            "direction = [1.0, 0.0, 0.0]\n" for k in range(4)))
    for block in range(blocks):
        rng = np.random.default_rng(seed + block)
        motion = 0.02 * rng.standard_normal((n, 4))
        for f, zeta, phi in zip(frequency, DAMPING, shape.T, strict=True):
            w = 2 * np.pi * f
            held = signal.cont2discrete(([1.0, 0.0, 0.0], [1.0, 2 * zeta * w, w**2]), 1 / RATE_HZ, "zoh")
            motion += np.outer(signal.lfilter(held[0].ravel(), held[1], rng.standard_normal(n)), phi)
        # a machine on the second storey, whose speed wanders a little: narrow, and no mode
        phase = 2 * np.pi * np.cumsum(MACHINE_HZ + 0.004 * np.cumsum(rng.standard_normal(n)) / np.sqrt(n)) / RATE_HZ
        motion += 0.8 * np.outer(np.sin(phase), [0.3, 1.0, 0.5, 0.4])
        with h5py.File(folder / "acceleration" / f"b{block}.h5", "w") as file:
            data = file.create_dataset("data", data=motion.astype(np.float32))
            data.attrs["start"] = f"2026-01-01T{block:02d}:00:00Z"
            data.attrs["sampling_rate_hz"] = RATE_HZ
    return folder


def nearest(block, order: int, frequency_hz: float) -> tuple[int, float, float]:
    """Index, frequency and damping of a stored block's pole of that order nearest to a frequency."""
    poles = next(p for p in block.every_order if p.order == order)
    k = int(np.argmin(np.abs(poles.frequency_hz - frequency_hz)))
    return k, float(poles.frequency_hz[k]), float(poles.damping_ratio[k])


def pole(block, order: int, frequency_hz: float, **more: str) -> dict:
    k, f, zeta = nearest(block, order, frequency_hz)
    return {"block": block.id, "order": order, "index": k, "frequency_hz": f, "damping_ratio": zeta, **more}


def write_choice(path: Path, head: dict, picked: list[dict], rejected: list[dict]) -> Path:
    """A choice as the page saves it."""
    path.write_text(json.dumps({"format": 1, **head, "picked": picked, "rejected": rejected}))
    return path
