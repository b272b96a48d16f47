"""How many turbine-months an hour, by workers; and what a farm of 70 turbines over twelve months takes.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python studies/farm/run.py OUT [--days 0.5] [--turbines 4] [--workers 1 2]

Virtual turbines are measured for `--days` each, and for twice as long one of them; the farm of them runs on 1, 2, ...
processes, and on a Dask cluster of as many workers where distributed is installed. Seconds of processor time by step, at
two lengths of record, give the arithmetic. Everything printed is of one run; OUT/measured.json holds it too.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import probupdate
from probupdate.executors import executor, one_thread_each
from probupdate.farms import month as months
from probupdate.farms.description import read_farm

TURBINES, MONTHS, BLOCKS_A_MONTH, CHANNELS, RATE_HZ = 70, 12, 30 * 48, 18, 25.0
DESCRIPTION = """\
name = "Virtual farm"
model = "as_built"
steps = ["identify", "select", "update", "diagnose"]
[update]
weights = "paper"
[diagnose]
extend = false
"""


def write_farm(folder: Path, days: float, turbines: int) -> Path:
    """Campaigns T1/0 ... of `days`, and long/0 of twice as long beside them, which belongs to no farm."""
    for k in range(turbines):
        probupdate.simulate(folder / f"T{k + 1}" / "0", model="updated", days=days, seed=k + 1)
    probupdate.simulate(folder / "long" / "0", model="updated", days=2 * days, seed=1)
    text = DESCRIPTION + "".join(f'[[turbine]]\nname = "T{k + 1}"\ncampaigns = "T{k + 1}/*"\n' for k in range(turbines))
    (folder / "farm.toml").write_text(text, encoding="utf-8")
    (folder / "long.toml").write_text(DESCRIPTION + '[[turbine]]\nname = "long"\ncampaigns = "long/*"\n', encoding="utf-8")
    return folder / "farm.toml"


def steps_of(description: Path, out: Path) -> tuple[dict[str, float], int]:
    """Processor seconds of each step of the farm's first month in this process, and its number of blocks."""
    farm = read_farm(description)
    first = farm.months[0]
    taken = {}
    for step in farm.steps:
        begun = time.process_time()
        months._RUN[step](first, out / first.folder, farm.options, farm.seed)
        taken[step] = time.process_time() - begun
    return taken, len(list((out / first.folder / "modes.json.blocks").glob("*.poles.npz")))


PEAK = """
import resource, sys
from pathlib import Path
from probupdate.farms.description import read_farm
from probupdate.farms.month import run_month
farm = read_farm(sys.argv[1])
run_month(farm.months[0], farm, Path(sys.argv[2]))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""


def peak_mb(description: Path, out: Path) -> float:
    """The largest resident memory of one month in a process of its own, MB."""
    answer = subprocess.run([sys.executable, "-c", PEAK, str(description), str(out)], capture_output=True, text=True,
                            check=True)  # fmt: skip
    return float(answer.stdout)


def wall(description: Path, out: Path, jobs: int, scheduler: str | None = None) -> float:
    """Seconds by the clock, the workers' start included."""
    shutil.rmtree(out, ignore_errors=True)
    begun = time.monotonic()
    with executor(jobs, scheduler) as runs:
        run = probupdate.farm(description, out, jobs=runs)
    if run.failed:
        raise SystemExit(run.summary)
    return time.monotonic() - begun


def on_dask(description: Path, out: Path, workers: int) -> float | None:
    if importlib.util.find_spec("distributed") is None:
        return None
    import distributed

    with one_thread_each(), distributed.LocalCluster(n_workers=workers, threads_per_worker=1, processes=True,
                                                     dashboard_address=":0") as cluster:  # fmt: skip
        return wall(description, out, 1, cluster.scheduler_address)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--days", type=float, default=0.5)
    parser.add_argument("--turbines", type=int, default=4)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    a = parser.parse_args()
    data = a.out / "data"
    description = data / "farm.toml"
    if not description.exists():
        write_farm(data, a.days, a.turbines)
    measured: dict = {"cores": os.cpu_count(), "load": os.getloadavg()[0], "days": a.days, "turbines": a.turbines}
    for name, toml in (("short", description), ("long", data / "long.toml")):
        shutil.rmtree(a.out / name, ignore_errors=True)
        taken, blocks = steps_of(toml, a.out / name)
        shutil.rmtree(a.out / f"{name}-peak", ignore_errors=True)
        measured[name] = {"blocks": blocks, "seconds": taken, "peak_mb": peak_mb(toml, a.out / f"{name}-peak")}
        print(f"{blocks} blocks: " + ", ".join(f"{step} {s:.1f} s" for step, s in taken.items())
              + f"; at most {measured[name]['peak_mb']:.0f} MB", flush=True)
    measured["wall"] = {}
    for workers in a.workers:
        for kind, taken in (("processes", wall(description, a.out / "farm", workers)),
                            ("dask", on_dask(description, a.out / "farm", workers))):  # fmt: skip
            if taken is None:
                print("Dask: distributed is not installed")
                continue
            measured["wall"][f"{kind} {workers}"] = taken
            print(f"{workers} {kind}: {a.turbines} turbine-months in {taken:.0f} s by the clock, "
                  f"{3600 * a.turbines / taken:.0f} an hour", flush=True)
    short, long = measured["short"], measured["long"]
    more = long["blocks"] - short["blocks"]
    hours = 0.0
    for step, first in short["seconds"].items():
        slope = max((long["seconds"][step] - first) / more, 0.0)
        fixed = max(first - slope * short["blocks"], 0.0)
        month = fixed + slope * BLOCKS_A_MONTH
        hours += month * TURBINES * MONTHS / 3600
        print(f"{step}: {fixed:.1f} s + {1e3 * slope:.0f} ms a block; a month of {BLOCKS_A_MONTH} blocks {month:.0f} s, "
              f"{TURBINES} x {MONTHS} of them {month * TURBINES * MONTHS / 3600:.1f} h")
    terabytes = TURBINES * MONTHS * 30 * 86400 * RATE_HZ * CHANNELS * 4 / 1e12
    measured |= {"hours": hours, "terabytes": terabytes}
    print(f"{TURBINES} turbines x {MONTHS} months: {hours:.0f} hours of one core, {terabytes:.1f} TB of records in single "
          "precision; identify reads them twice, the diagnosis's tests of the records once")  # fmt: skip
    (a.out / "measured.json").write_text(json.dumps(measured, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
