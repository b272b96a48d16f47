"""Memory and processor time of `identify` and `diagnose` by how many blocks a campaign has, and the exponent of each.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python studies/performance/benchmark_scale.py OUT [--blocks 50 500 5000]

Half hours of a frame of four storeys at 10 Hz, one file a day, in OUT; each command in a process of its own, with one
job; `identify` once more with all blocks in its store, which is what no worker shares. What a process takes before its
work (`modes` of the frame) is taken off before the exponent, which is of the last two numbers of blocks, as is the
ratio of memory. What was measured stands in OUT/measured.json and is not measured again.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from multiprocessing import Process
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
from scipy import linalg, signal

RATE, MINUTES, DAY = 10.0, 30, 48
STIFFNESS, MASS, DAMPING = 1.0e6, 5.0e3, 0.01
CHANNELS = tuple(f"F{k}-x" for k in (1, 2, 3, 4))


def storey(k: int) -> np.ndarray:
    part = np.zeros((4, 4))
    part[k, k] = 1.0
    if k:
        part[k - 1, k - 1], part[k - 1, k], part[k, k - 1] = 1.0, -1.0, -1.0
    return STIFFNESS * part


def write_model(out: Path) -> tuple[np.ndarray, np.ndarray]:
    """The frame with a parameter a storey; its frequencies in Hz and shapes."""
    parts = {f"K_k{k + 1}": storey(k) for k in range(4)}
    stiffness, mass = sum(parts.values()), MASS * np.eye(4)
    np.savez(out / "model.npz", K0=stiffness, M0=mass, **parts, channel=np.array(CHANNELS), channel_dof=np.arange(4))
    (out / "parameters.toml").write_text("".join(
        f'[[parameter]]\nname = "k{k + 1}"\nunit = "-"\ninitial = 0.0\nstd = 0.1\nlower = -0.5\nupper = 0.5\n'
        for k in range(4)))
    value, shape = linalg.eigh(stiffness, mass)
    return np.sqrt(value) / (2 * np.pi), shape


def write_campaign(out: Path, count: int, frequency: np.ndarray, shape: np.ndarray) -> None:
    """Accelerations under white modal forces."""
    (out / "acceleration").mkdir(parents=True, exist_ok=True)
    tables = "".join(f'[[sensor]]\nchannel = "{c}"\nlevel = "{c[:2]}"\nposition_m = [0.0, 0.0, {3.0 * k + 3}]\n'
                     'direction = [1.0, 0.0, 0.0]\nquantity = "acceleration"\nunit = "m/s2"\n'
                     for k, c in enumerate(CHANNELS))
    (out / "campaign.toml").write_text(f"sampling_rate_hz = {RATE}\nblock_minutes = {MINUTES}\n{tables}")
    for day, first in enumerate(range(0, count, DAY)):
        n = round(60 * MINUTES * RATE) * min(DAY, count - first)
        rng = np.random.default_rng(day)
        motion = np.zeros((n, 4))
        for f, column in zip(frequency, shape.T, strict=True):
            w = 2 * np.pi * f
            a, b = np.array([[0, 1], [-w * w, -2 * DAMPING * w]]), np.array([[0.0], [1.0]])
            found = signal.cont2discrete((a, b, a[1:], np.ones((1, 1))), 1 / RATE)[:4]
            motion += np.outer(signal.lfilter(*(x.ravel() for x in signal.ss2tf(*found)),
                                              rng.standard_normal(n + 2000))[2000:], column)
        motion += 0.02 * motion.std() * rng.standard_normal(motion.shape)
        with h5py.File(out / "acceleration" / f"{day:03d}.h5", "w") as file:
            data = file.create_dataset("data", data=motion.astype("f4"))
            start = pd.Timestamp("2026-01-01T00:00Z") + pd.Timedelta(days=day)
            data.attrs.update(start=start.isoformat(), sampling_rate_hz=RATE, channels=json.dumps(CHANNELS))


def measured(*words: str | Path) -> tuple[float, float]:
    """Processor time (s) and largest resident memory (MB) of a command in a process of its own."""
    begun = subprocess.Popen([sys.executable, "-m", "probupdate", *map(str, words)], stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(begun.pid, 0)
    if status:
        sys.exit(f"{words[0]} ended with {os.waitstatus_to_exitcode(status)}")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--blocks", type=int, nargs="+", default=[50, 500, 5000])
    a = parser.parse_args()
    a.out.mkdir(parents=True, exist_ok=True)
    frequency, shape = write_model(a.out)
    model = ("--model", a.out / "model.npz", "--parameters", a.out / "parameters.toml")
    done = a.out / "measured.json"
    known = json.loads(done.read_text()) if done.exists() else {}

    def once(key: str, *words: str | Path) -> tuple[float, float]:
        if key not in known:
            known[key] = measured(*words)
            done.write_text(json.dumps(known))
            print(key, *(f"{x:.1f}" for x in known[key]), flush=True)
        return known[key]

    begin, _ = once("modes", "modes", a.out / "model.npz")
    found: dict[str, list[tuple[float, float]]] = {}
    for count in a.blocks:
        campaign = a.out / f"c{count}"
        if not (campaign / "campaign.toml").exists():
            # a process counts what its parent had when it began
            made = Process(target=write_campaign, args=(campaign, count, frequency, shape))
            made.start()
            made.join()
        modes = a.out / f"modes-{count}.json"
        for name, words in {
            "identify": ("identify", campaign, "--jobs", "1", "--out", modes),
            "identify, blocks stored": ("identify", campaign, "--jobs", "1", "--out", modes),
            "diagnose without a model": ("diagnose", "--modes", modes, "--jobs", "1", "--out", a.out / "w.json"),
            "diagnose with a model": ("diagnose", *model, "--modes", modes, "--no-extend", "--jobs", "1", "--out",
                                      a.out / "d.json"),
            "diagnose of records": ("diagnose", "--modes", modes, "--campaign", campaign, "--jobs", "1", "--out",
                                    a.out / "r.json"),
        }.items():
            found.setdefault(name, []).append(once(f"{count} {name}", *words))
    heads = " | ".join(f"{count} blocks" for count in a.blocks)
    print(f"| command, one job | {heads} | exponent of time | memory |\n|---|{'---|' * len(a.blocks)}---|---|")
    for name, measures in found.items():
        (t1, m1), (t2, m2) = measures[-2:]
        exponent = np.log((t2 - begin) / max(t1 - begin, 0.01)) / np.log(a.blocks[-1] / a.blocks[-2])
        cells = " | ".join(f"{t:.1f} s, {m:.0f} MB" for t, m in measures)
        print(f"| {name} | {cells} | {exponent:.2f} | {m2 / m1:.2f} |")
    print(f"before the work: {begin:.1f} s")


if __name__ == "__main__":
    main()
