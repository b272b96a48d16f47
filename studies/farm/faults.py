"""A farm of 20 turbines over twelve months in which things go wrong: what is done, what fails, what a rerun does.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python studies/farm/faults.py OUT [--turbines 20] [--months 12]

Each turbine is a building of three storeys of its own stiffness (tests/farms), each month one record of two blocks
that is identified with the model. The record of one month is cut short, and of the two processes that work on the farm
each is killed once, in the middle. Then the farm runs again, and once more with the record put back and the model of
one turbine changed. Results are held against those of an undisturbed farm, byte for byte.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "farms"))
from farm_cases import write_campaign, write_model

RESULTS = ("modes.json", "modes.poles.csv")
HEAD = """\
name = "Twenty buildings"
steps = ["identify"]
[identify]
lowest = 3
"""
BROKEN, CHANGED = ("T01", "2024-05"), "T02"


def write_farm(folder: Path, turbines: int, months: int) -> None:
    text = HEAD
    for k in range(turbines):
        name = f"T{k + 1:02d}"
        text += f'[[turbine]]\nname = "{name}"\ncampaigns = "{name}/2024-*"\nmodel = "{name}.npz"\n'
        write_model(folder)
        shutil.move(folder / "model.npz", folder / f"{name}.npz")
        for m in range(months):
            write_campaign(folder / name / f"2024-{m + 1:02d}", 1 + 0.01 * (k % 5), 100 * k + m,
                           f"2024-{m + 1:02d}-01T00:00:00Z", blocks=2)
    (folder / "farm.toml").write_text(text, encoding="utf-8")


def contents(out: Path) -> dict[str, str]:
    return {path.relative_to(out).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
            for name in RESULTS for path in out.glob(f"*/*/{name}")}


def say_differences(expected: dict[str, str], found: dict[str, str]) -> None:
    if expected:
        other = sorted({name.rsplit("/", 1)[0] for name in expected if expected[name] != found.get(name)})
        print(f"other than undisturbed: {', '.join(other) or 'nothing'}", flush=True)


def children(pid: int) -> list[int]:
    """Processes of Python that `multiprocessing` started for tasks."""
    found = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        for text in (task / "children").read_text().split():
            found += [int(text)] if b"spawn_main" in Path(f"/proc/{text}/cmdline").read_bytes() else []
    return found


def run(folder: Path, out: Path, kill: int = 0) -> None:
    """The command with two jobs; `kill` of its processes are ended as a full memory would, when a third, two thirds, of
    the months are there."""
    begun, before = time.monotonic(), contents(out) if out.exists() else {}
    words = [sys.executable, "-m", "probupdate", "farm", str(folder / "farm.toml"), "--out", str(out), "--jobs", "2"]
    child = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    n_month = len(list(folder.glob("*/2024-*")))
    for part in range(1, kill + 1):
        while len(list(out.glob("*/*/modes.json"))) < part * n_month / (kill + 1) and child.poll() is None:
            time.sleep(0.05)
        ended = children(child.pid)[0]
        os.kill(ended, signal.SIGKILL)
        print(f"  process {part} killed", flush=True)
    said = child.communicate()[0]
    used = os.times()
    now = contents(out)
    lines = [line for line in said.splitlines() if re.search(r"turbine-months|failed|left out", line)]
    anew = sum(before.get(k) != v for k, v in now.items())
    seconds = used.children_user + used.children_system
    print(f"exit {child.returncode}, {time.monotonic() - begun:.0f} s, {anew} of {len(now)} results written again, "
          f"{seconds:.0f} s of processor time in all so far", *lines, sep="\n  ", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--turbines", type=int, default=20)
    parser.add_argument("--months", type=int, default=12)
    parser.add_argument("--alone", action="store_true", help="without the undisturbed farm that takes as long again")
    a = parser.parse_args()
    data, sound, disturbed = a.out / "data", a.out / "sound", a.out / "disturbed"
    if not (data / "farm.toml").exists():
        data.mkdir(parents=True)
        write_farm(data, a.turbines, a.months)
    if not a.alone:
        print("undisturbed", flush=True)
        run(data, sound)
    shutil.rmtree(disturbed, ignore_errors=True)
    record = data / BROKEN[0] / BROKEN[1] / "acceleration" / "all.h5"
    whole = record.read_bytes()
    record.write_bytes(whole[: len(whole) // 3])
    try:
        print("a record cut short, two processes killed", flush=True)
        run(data, disturbed, kill=2)
        print("again", flush=True)
        run(data, disturbed)
    finally:
        record.write_bytes(whole)
    expected = contents(sound)
    say_differences(expected, contents(disturbed))
    shutil.copyfile(data / f"{CHANGED}.npz", data / "kept.npz")
    import numpy as np

    with np.load(data / "kept.npz") as arrays:
        np.savez(data / f"{CHANGED}.npz", **{**arrays, "M0": 1.01 * arrays["M0"]})
    print("the record put back, a model changed", flush=True)
    run(data, disturbed)
    shutil.move(data / "kept.npz", data / f"{CHANGED}.npz")
    say_differences(expected, contents(disturbed))


if __name__ == "__main__":
    main()
