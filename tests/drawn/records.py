"""A case as raw accelerations: modal oscillators under white forces, by an exact recursion between samples, in CSV
files with a campaign.toml and a convert.toml beside them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy import signal

from drawn import toml_text
from drawn.cases import GRAVITY, START, Scene

BLOCK_PERIODS = 700.0  # of the first mode
SETTLING = 6.0  # time constants of the first mode before a block
NOISE = 0.01  # of a channel's standard deviation
MORE_MODES = 4  # above those that are looked for


def write_campaign(s: Scene, folder: Path, *, blocks: int = 16) -> dict:
    """raw/*.csv and a folder campaign/ that `convert` fills -> rate and minutes of a block."""
    raw, campaign = folder / "raw", folder / "campaign"
    raw.mkdir(parents=True, exist_ok=True)
    campaign.mkdir(parents=True, exist_ok=True)
    f = s.drawn.solve(count=s.drawn.n_mode).frequency_hz
    rate = float(np.ceil(4 * f[-1] * 10) / 10)
    minutes = int(np.clip(np.ceil(BLOCK_PERIODS / f[0] / 60), 1, 60))
    rng = s.rng(6)
    damping = rng.uniform(0.005, 0.02, s.drawn.n_mode + MORE_MODES)
    picked = [s.blocks[int(k)] for k in np.linspace(0, len(s.blocks) - 1, min(blocks, len(s.blocks)))]
    names = [x["channel"] for x in s.drawn.sensors]
    rows = []
    for k, block in enumerate(picked):
        start = START + np.timedelta64(k * max(minutes, 10), "m")
        samples = _block(s, block, rate, minutes, damping, rng)
        times = np.arange(len(samples)) / rate
        np.savetxt(raw / f"{k:03d}_{np.datetime_as_string(start, unit='s').replace(':', '')}.csv",
                   np.column_stack([times, samples]), delimiter=",", fmt="%.9g", comments="",
                   header=",".join(["t", *names]))
        for minute in range(0, max(minutes, 10), 10):
            rows.append([f"{start + np.timedelta64(minute, 'm')}Z", *map(str, block.columns.values())])
    head = {"name": s.drawn.title, "sampling_rate_hz": rate, "block_minutes": minutes}
    sensors = [{k: v for k, v in x.items() if k != "states_level"} | {"quantity": "acceleration", "unit": "m/s2"}
               for x in s.drawn.sensors]
    (campaign / "campaign.toml").write_text(toml_text.text({**head, "sensor": sensors}), encoding="utf-8")
    (campaign / "convert.toml").write_text(toml_text.text({
        "files": "*.csv", "time": "t", "time_unit": "s", "start_pattern": r"_(\d{4}-\d{2}-\d{2}T\d{6})",
        "start_format": "%Y-%m-%dT%H%M%S", "zone": "UTC", "columns": {f'"{n}"': n for n in names}}), encoding="utf-8")
    if picked[0].columns:
        lines = [",".join(["time", *picked[0].columns]), *(",".join(r) for r in rows)]
        (campaign / "scada.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return head


def _block(s: Scene, block, rate, minutes, damping, rng) -> np.ndarray:
    """(n_sample, n_channel) in m/s2. An accelerometer reads along its axis what it is accelerated by, and gravity's
    component as it tilts."""
    h, count = s.hidden, s.drawn.n_mode + MORE_MODES
    solution = s.drawn.solve(changes=h.changes(block.amount) if h and h.changes and block.amount else (),
                             attached=h.attached if h and block.amount else (), level=block.level, warmer=block.warmer,
                             count=count)
    f = solution.frequency_hz
    direction = np.array([x["direction"] for x in s.drawn.sensors])
    tilts = GRAVITY * (solution.tilt[:, 0] * direction[:, 1:2] - solution.tilt[:, 1] * direction[:, :1])
    wanted = int(round(60 * minutes * rate))
    settling = int(SETTLING / (2 * np.pi * f[0] * damping[0]) * rate) + 1
    n = wanted + settling
    motion = np.zeros((n, len(direction)))
    for j in np.flatnonzero(f < 0.49 * rate):
        omega, zeta = 2 * np.pi * f[j], damping[min(j, len(damping) - 1)]
        force = rng.standard_normal(n) * np.sqrt(rate)
        bottom = [1.0, 2 * zeta * omega, omega**2]
        accelerated, moved = (signal.lfilter(b.ravel(), a, force) for b, a, _ in (
            signal.cont2discrete((top, bottom), 1 / rate, method="zoh") for top in ([1.0, 0.0, 0.0], [1.0])))
        motion += accelerated[:, None] * solution.shape[:, j] + moved[:, None] * tilts[:, j]
    motion = motion @ s.sensors.T
    if h and h.seen and block.amount:
        # what a sensor does at each frequency, of the whole record
        spectrum = np.fft.rfft(motion, axis=0).T
        motion = np.fft.irfft(h.seen(spectrum, np.fft.rfftfreq(n, 1 / rate), block.amount).T, n, axis=0)
    motion = motion[settling:]
    return motion + NOISE * motion.std(axis=0) * rng.standard_normal(motion.shape)
