"""Raw accelerations of a drawn structure, written as a campaign: modal oscillators driven by white forces at every
mass, by an exact recursion between samples, and what the sensors make of that."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import h5py
import numpy as np
from records import FAMILIES, Record, Scene
from scipy import signal
from worlds import modes

START = np.datetime64("2026-01-01T00:00:00")
# periods of the first mode that a block holds
N_PERIOD = 1200
# time constants of the first mode that are let pass before a block
SETTLING = 8.0


def write_campaign(record: Record, folder: Path) -> Path:
    """A campaign of one file for each block; the blocks follow each other as the scene's hours say, with gaps."""
    shutil.rmtree(folder, ignore_errors=True)
    scene, world = record.scene, record.world
    rng = np.random.default_rng([FAMILIES.index(record.family), record.number, 21])
    f, _ = modes(*(scene.sound or scene.state(0)))
    damping = rng.uniform(0.004, 0.02, len(f))
    highest = f[min(world.n_mode, len(f)) - 1]
    rate = float(np.ceil(rng.uniform(2.6, 4.0) * highest * 10) / 10)
    minutes = int(np.clip(np.ceil(N_PERIOD / f[0] / 60), 1, 30))
    noise, weight = 10 ** rng.uniform(-2.5, -1.5), rng.uniform(0.3, 1.0, len(f))
    (folder / "acceleration").mkdir(parents=True)
    for k in range(scene.n):
        measured = _block(scene, k, rate, minutes, damping, weight, rng)
        measured += noise * np.sqrt(np.mean(measured**2)) * rng.standard_normal(measured.shape)
        with h5py.File(folder / "acceleration" / f"{k:03d}.h5", "w") as file:
            data = file.create_dataset("data", data=measured.astype(np.float32))
            data.attrs["start"] = f"{_start(scene, k)}Z"
            data.attrs["sampling_rate_hz"] = rate
    lines = [f'name = "{world.kind}"', f"sampling_rate_hz = {rate}", f"block_minutes = {minutes}"]
    for s in world.sensors:
        lines += ["[[sensor]]", f"channel = {json.dumps(s.channel)}", f"level = {json.dumps(s.level)}",
                  f"position_m = {[float(x) for x in s.position_m]}", f"direction = {[float(x) for x in s.direction]}",
                  'quantity = "acceleration"', 'unit = "m/s2"']
    (folder / "campaign.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    if scene.environment:
        rows = [{**scene.environment(k)} for k in range(scene.n)]
        names = list(rows[0])
        table = [",".join(["time", *names])]
        for k, row in enumerate(rows):
            # a block's ten minutes, and more where it is longer
            for minute in range(0, max(minutes, 10), 10):
                time = _start(scene, k) + np.timedelta64(minute, "m")
                table.append(",".join([f"{time}Z", *(repr(float(row[name])) for name in names)]))
        (folder / "scada.csv").write_text("\n".join(table) + "\n", encoding="utf-8")
    return folder


def _start(scene: Scene, k: int) -> np.datetime64:
    return START + np.timedelta64(round(3600 * scene.hours[k]), "s")


def _block(scene, k, rate, minutes, damping, weight, rng) -> np.ndarray:
    """(n_sample, n_channel) of one block in its state, what its sensors make of it included."""
    K, M = scene.state(k)
    f, phi = modes(K, M)
    rows = np.hstack([scene.world.rows, np.zeros((len(scene.world.rows), len(K) - scene.world.rows.shape[1]))])
    kept = f < 0.49 * rate
    wanted = int(round(60 * minutes * rate))
    damping = np.concatenate([damping, np.full(len(f), 0.01)])[: len(f)]
    settling = int(SETTLING / (2 * np.pi * f[0] * damping[0]) * rate) + 1
    n = wanted + settling + 200
    # forces of one size for each mass, so that a mode has what its shape collects
    force = rng.standard_normal((n, len(K))) * np.sqrt(np.diag(M)) * np.concatenate(
        [weight, np.zeros(len(K))])[: len(K)]
    motion = np.zeros((n, len(rows)))
    for j in np.flatnonzero(kept):
        omega = 2 * np.pi * f[j]
        oscillator = ([1.0, 0.0, 0.0], [1.0, 2 * damping[j] * omega, omega**2])
        b, a, _ = signal.cont2discrete(oscillator, 1 / rate, method="zoh")
        motion += signal.lfilter(b.ravel(), a, force @ phi[:, j])[:, None] * (rows @ phi[:, j])
    if scene.sensors is not None:
        spectrum = np.fft.rfft(motion, axis=0).T
        motion = np.fft.irfft(scene.sensors(k, spectrum, np.fft.rfftfreq(n, 1 / rate)).T, n, axis=0)
    return motion[settling : settling + wanted]
