"""Processor time and memory of `export --fatigue`, beside an older commit in one run.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python studies/performance/benchmark_export.py RUN OUT --against COMMIT

RUN is a finished run that both commits read (`probupdate demo`); OUT takes the older commit's files and both exports.
The ranges of fatigue.csv are compared row by row.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]


def exported(code: Path, run: Path, out: Path, draws: int) -> tuple[float, float]:
    """Processor seconds and peak memory in MB of one export by the package in `code`."""
    shutil.rmtree(out, ignore_errors=True)
    words = [sys.executable, "-m", "probupdate", "export", str(run), "--to", "lifetime", str(out), "--draws",
             str(draws), "--fatigue", str(ROOT / "studies" / "lifetime" / "fatigue.toml"), "--accept"]
    child = subprocess.Popen(words, env=os.environ | {"PYTHONPATH": str(code)}, cwd=code, stdout=subprocess.DEVNULL,
                             stderr=subprocess.DEVNULL)
    _, status, used = os.wait4(child.pid, 0)
    if status:
        raise SystemExit(f"{' '.join(words)} ended with {os.waitstatus_to_exitcode(status)}")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def ranges(out: Path) -> np.ndarray:
    """(n, 2) m = 3 and 5 of every draw and hot spot."""
    lines = [line for line in (out / "fatigue.csv").read_text(encoding="utf-8").splitlines() if line[:1] != "#"]
    head = lines[0].split(",")
    columns = [head.index(name) for name in head if name.startswith("del_m")]
    return np.array([[float(line.split(",")[k]) for k in columns] for line in lines[1:]])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--against", default="04b0e61")
    parser.add_argument("--draws", type=int, default=40)
    a = parser.parse_args()
    a.out.mkdir(parents=True, exist_ok=True)
    older = a.out / "older"
    if not older.exists():
        older.mkdir()
        files = subprocess.run(["git", "-C", str(ROOT), "archive", a.against, "probupdate"], check=True,
                               capture_output=True).stdout
        subprocess.run(["tar", "-x", "-C", str(older)], input=files, check=True)
    before = exported(older, a.run, a.out / "before", a.draws)
    now = exported(ROOT, a.run, a.out / "now", a.draws)
    print(f"export of {a.draws} draws: {a.against} {before[0]:.1f} s, {before[1]:.0f} MB; now {now[0]:.1f} s, "
          f"{now[1]:.0f} MB; ratio {now[0] / before[0]:.2f}")
    old, new = ranges(a.out / "before"), ranges(a.out / "now")
    top = old > old.max(axis=0) / 3
    print(f"ranges, relative difference: largest {np.max(np.abs(new / old - 1)):.1e}, of those above a third of the "
          f"largest {np.max(np.abs(new / old - 1)[top]):.1e}")


if __name__ == "__main__":
    main()
