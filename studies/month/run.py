"""A month of the virtual turbine through identification to the nine sets, killed on the way and resumed.

    python studies/month/run.py OUT --days 30

Everything is written below OUT; a second call takes up what is there. The figures measured go to OUT/measured.json.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

COMMAND = [sys.executable, "-m", "probupdate"]
SAMPLE_S = 0.25


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--days", type=float, default=30.0)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--kill", type=float, default=None, help="share of the blocks after which to kill (random)")
    a = parser.parse_args()
    a.out.mkdir(parents=True, exist_ok=True)
    campaign, modes, nine = a.out / "campaign", a.out / "modes.json", a.out / "nine.json"
    blocks = round(48 * a.days)
    measured: dict = {"days": a.days, "blocks": blocks, "jobs": a.jobs, "cores": os.cpu_count()}
    measured["simulate"] = run(["simulate", str(campaign), "--days", str(a.days), "--seed", str(a.seed)])
    identify = ["identify", str(campaign), "--model", "as_built", "--out", str(modes), "--jobs", str(a.jobs)]
    store = a.out / "modes.json.blocks"
    share = random.SystemRandom().uniform(0.1, 0.9) if a.kill is None else a.kill
    first = run(identify, store=store, kill_at=max(int(share * blocks), 1))
    before = {p.name: p.stat().st_mtime_ns for p in store.glob("*.npz")}
    second = run(identify, store=store)
    after = {p.name: p.stat().st_mtime_ns for p in store.glob("*.npz")}
    again = [name for name, changed in before.items() if after[name] != changed]
    measured["identify"] = {
        "killed_after_files": len(before), "written_again": again, "until_killed": first, "resumed": second,
        "wall_s": first["wall_s"] + second["wall_s"], "cpu_s": first["cpu_s"] + second["cpu_s"],
        "cpu_s_per_block": (first["cpu_s"] + second["cpu_s"]) / blocks,
        "peak_mb": max(first["peak_mb"], second["peak_mb"]),
    }
    measured["select"] = run(["select", str(modes), "--scada", str(campaign / "scada.csv"), "--out", str(nine)])
    measured["total_wall_s"] = sum(measured[k]["wall_s"] for k in ("simulate", "identify", "select"))
    measured["sets"] = len(json.loads(nine.read_text())["sets"])
    measured["store_mb"] = sum(p.stat().st_size for p in store.iterdir()) / 1e6
    (a.out / "measured.json").write_text(json.dumps(measured, indent=1))
    sys.stdout.write(json.dumps(measured, indent=1) + "\n")


def run(arguments: list[str], store: Path | None = None, kill_at: int | None = None) -> dict:
    """Run one verb, watching the resident memory of all of its processes; kill -9 once `kill_at` files are stored."""
    begun, used = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    child = subprocess.Popen([*COMMAND, *arguments], env=environment, stdout=subprocess.PIPE, text=True)
    peak, spent = 0.0, 0.0
    while child.poll() is None:
        members = family(child.pid)
        peak = max(peak, sum(memory_mb(p) for p in members))
        # a killed process's children are not waited for: their time is read while they run
        spent = max(spent, sum(cpu_s(p) for p in members))
        if kill_at is not None and store is not None and len(list(store.glob("*.npz"))) >= kill_at:
            child.send_signal(signal.SIGKILL)
            break
        time.sleep(SAMPLE_S)
    said = child.communicate()[0]
    if child.returncode not in (0, -signal.SIGKILL):
        raise SystemExit(f"{' '.join(arguments)} ended with {child.returncode}")
    now = resource.getrusage(resource.RUSAGE_CHILDREN)
    waited = now.ru_utime + now.ru_stime - used.ru_utime - used.ru_stime
    return {"wall_s": time.monotonic() - begun, "cpu_s": max(waited, spent), "peak_mb": peak,
            "said": said.strip().splitlines()}


def family(pid: int) -> list[int]:
    """A process and all below it."""
    found = [pid]
    for parent in found:
        try:
            for task in Path(f"/proc/{parent}/task").iterdir():
                found += [int(x) for x in (task / "children").read_text().split()]
        except OSError:
            continue
    return found


def memory_mb(pid: int) -> float:
    """Proportional resident size: pages that several processes share count once."""
    try:
        for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
            if line.startswith("Pss:"):
                return int(line.split()[1]) / 1024
    except OSError:
        pass
    return 0.0


def cpu_s(pid: int) -> float:
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    main()
