"""The measured footbridge through update, sample, compare and report, as a user would type it, with the seconds."""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
DATA = HERE.parents[2] / "shared" / "data" / "footbridge"


def commands(run: Path) -> list[tuple[str, ...]]:
    """The steps in `run`, which holds model.npz, parameters.toml and modes.json."""
    problem = ("--model", str(run / "model.npz"), "--modes", str(run / "modes.json"))
    update, posterior = str(run / "update.json"), str(run / "posterior.nc")
    return [
        ("update", *problem, "--out", update),
        ("sample", *problem, "--out", posterior),
        ("compare", update, posterior, "--out", str(run / "compare.json")),
        ("report", str(run), "--out", str(run / "report.html")),
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path, help="directory to write")
    parser.add_argument("--data", type=Path, default=DATA, help="directory of model.npz and modes.json")
    a = parser.parse_args()
    if not a.data.is_dir():
        sys.stderr.write(f"{a.data}: no such directory; give --data with the bridge's model.npz and modes.json\n")
        return 2
    a.out.mkdir(parents=True, exist_ok=True)
    for source in (a.data / "model.npz", a.data / "modes.json", HERE / "parameters.toml"):
        shutil.copyfile(source, a.out / source.name)
    seconds = {}
    for command in commands(a.out):
        sys.stdout.write(f"$ probupdate {' '.join(command)}\n")
        sys.stdout.flush()
        begun = time.monotonic()
        subprocess.run([sys.executable, "-m", "probupdate", *command], check=True)
        seconds[command[0]] = time.monotonic() - begun
    sys.stdout.write("\n".join(f"{step:<8} {s:6.1f} s" for step, s in seconds.items()) + "\n")
    sys.stdout.write(f"{'total':<8} {sum(seconds.values()):6.1f} s\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
