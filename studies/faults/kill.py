"""kill -9 and SIGTERM at random moments, then the same command again: the bytes are those of an undisturbed run.

    python studies/faults/kill.py TRIALS SEED

A line of JSON at the end: trials, how often a signal met a running command, files that differ, temporary files left,
processes left, lines on standard error after SIGTERM beyond one.
"""

import hashlib
import json
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np


def command(out: Path) -> list[str]:
    return [sys.executable, "-m", "probupdate.cli", "simulate", str(out), "--days", "0.1", "--seed", "3"]


def digest(folder: Path) -> dict[str, str]:
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest()
            for p in sorted(folder.rglob("*")) if p.is_file()}  # fmt: skip


def main() -> None:
    trials, seed = int(sys.argv[1]), int(sys.argv[2])
    rng, counts = np.random.default_rng(seed), {"met": 0, "differ": 0, "parts": 0, "lines": 0, "code": 0}
    with tempfile.TemporaryDirectory() as place:
        whole, begun = Path(place) / "whole", time.monotonic()
        subprocess.run(command(whole), check=True, capture_output=True)
        lasts, wanted = time.monotonic() - begun, digest(whole)
        for number in range(trials):
            out, kind = Path(place) / f"c{number}", (signal.SIGKILL, signal.SIGTERM)[number % 2]
            one = subprocess.Popen(command(out), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
            # the first second is Python's own start
            time.sleep(rng.uniform(min(1.0, 0.3 * lasts), lasts))
            met = one.poll() is None
            one.send_signal(kind)
            _, words = one.communicate()
            counts["met"] += met
            if met and kind == signal.SIGTERM:
                counts["lines"] += len([w for w in words.splitlines() if not w.startswith("  ")]) > 1
                counts["code"] += one.returncode != 130
            subprocess.run(command(out), check=True, capture_output=True)
            counts["parts"] += len(list(out.rglob("*.part")))
            counts["differ"] += digest(out) != wanted
    sys.stdout.write(json.dumps({"trials": trials, "seconds_undisturbed": round(lasts, 1), **counts}) + "\n")


if __name__ == "__main__":
    main()
