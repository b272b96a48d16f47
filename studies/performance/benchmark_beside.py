"""Processor time and largest memory of `diagnose` beside those of another commit, on the same files in one run.

    OMP_NUM_THREADS=1 python studies/performance/benchmark_beside.py RUN TREE [--extend] [--repeat N]

RUN: a folder that the demonstration wrote; TREE: a checkout of the other commit (`git worktree add TREE COMMIT`). Each
diagnosis is a process of its own, the two in turn. `--extend`: with the gain and the extended model's update.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parents[2]
ONE = """
import json, resource, sys, time
from pathlib import Path
from probupdate.verbs import diagnose
run = Path(sys.argv[1])
found = diagnose(run / "model.toml", run / "modes.json", campaign=run / "campaign",
                 extend=len(sys.argv) > 2, out=run / "benchmark_beside.json")
print(json.dumps({"cpu_s": time.process_time(), "mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
                  "verdict": found.verdict, "findings": [f"{f.cause}, {f.location}" for f in found.findings]}))
"""


def measured(tree: Path, run: Path, extend: bool) -> dict:
    found = subprocess.run([sys.executable, "-c", ONE, str(run), *["extend"] * extend], capture_output=True, text=True,
                           env={**os.environ, "PYTHONPATH": str(tree)}, check=True)
    return json.loads(found.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("tree", type=Path)
    parser.add_argument("--extend", action="store_true")
    parser.add_argument("--repeat", type=int, default=1)
    a = parser.parse_args()
    for _ in range(a.repeat):
        own, other = measured(HERE, a.run, a.extend), measured(a.tree, a.run, a.extend)
        for name, one in (("here", own), ("there", other)):
            sys.stdout.write(f"{name}: {one['cpu_s']:.1f} s of processor time, {one['mb']:.0f} MB; {one['verdict']} "
                             f"{'; '.join(one['findings'])}\n")
        sys.stdout.write(f"ratio: {own['cpu_s'] / other['cpu_s']:.2f} of its time, "
                         f"{own['mb'] / other['mb']:.2f} of its memory\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
