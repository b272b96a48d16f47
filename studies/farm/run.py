"""How many turbine-months an hour, by workers; and what a farm of 70 turbines over twelve months takes.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python studies/farm/run.py OUT [--days 0.5] [--turbines 6] [--workers 1 2]

Virtual turbines are measured for `--days` each, and for twice as long one of them; the farm of them runs on 1, 2, ...
processes, on a Dask cluster of as many workers where distributed is installed, and as so many shards at once. Each
way's results must have the bytes of the first. Seconds of processor time by step, at two lengths of record, give the
arithmetic. Everything printed is of one run; OUT/measured.json holds it too.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import probupdate
from probupdate.campaign.reading import read_campaign
from probupdate.farms import month as months
from probupdate.farms.description import read_farm
from probupdate.runtime.executors import executor, limit_threads_of_workers
from probupdate.verbs import model_path

PREPARED = "diagnose, once a turbine"
# undisturbed half hours of a month, and what is hidden in the one of two that takes longer to diagnose
SETS_A_MONTH = 698
HIDDEN = [
    {"kind": "joint_stiffness", "face": "BC", "bay": 2, "leg": "all", "end": "all", "factor": 0.3,
     "time_profile": "step",
     "at_hour": 360.0},
    {"kind": "sensor_gain", "channel": "T66-x", "factor": 0.85},
]
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
    (folder / "long.toml").write_text(DESCRIPTION + '[[turbine]]\nname = "long"\ncampaigns = "long/*"\n',
                                      encoding="utf-8")
    return folder / "farm.toml"


def steps_of(description: Path, out: Path) -> tuple[dict[str, float], int]:
    """Processor seconds of each step of the farm's first month in this process, and its number of blocks; apart from
    them what the diagnosis makes of the model once for all months of a turbine."""
    farm = read_farm(description)
    first = farm.months[0]
    months._KEPT.clear()
    begun = time.process_time()
    months._prepare_model(model_path(first.model), read_campaign(first.campaign).sensors)
    taken = {PREPARED: time.process_time() - begun}
    for step in farm.steps:
        begun = time.process_time()
        months._RUN[step](first, out / first.folder, farm.options, farm.seed)
        taken[step] = time.process_time() - begun
    return taken, len(list((out / first.folder / "modes.json.blocks").glob("*.poles.npz")))


def month_of_modes(ready, hidden: list[dict]) -> tuple[float, int, str]:
    """Processor seconds of a diagnosis of a month's undisturbed half hours, their number and the verdict; of modal sets
    that are simulated as such, as a month of records takes hours to simulate."""
    from probupdate.diagnosis.diagnose import examine
    from probupdate.virtual.modal_blocks import simulate_modes

    data = simulate_modes(truth={"effect": hidden}, seed=3, states=("idling", "below rated", "rated"),
                          n_block=SETS_A_MONTH, days=SETS_A_MONTH / 22).data
    begun = time.process_time()
    outcome = examine(ready, data, seed=1)
    return time.process_time() - begun, len(data.sets), outcome.diagnosis.verdict


def records_tested(campaign: Path) -> float:
    """Processor seconds a block of the diagnosis's tests of the raw records."""
    from probupdate.campaign.blocks import block_files
    from probupdate.diagnosis.campaign_tests import campaign_tests

    opened = read_campaign(campaign)
    begun = time.process_time()
    campaign_tests(opened)
    return (time.process_time() - begun) / len(block_files(opened))


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
                            check=True)
    return float(answer.stdout)


RESULTS = ("modes.json", "nine.json", "update.json", "diagnosis.json")
SHARD = """
import sys
from probupdate import farm
run = farm(sys.argv[1], sys.argv[2], shard=sys.argv[3])
if run.failed:
    sys.exit(run.summary)
"""


def contents(out: Path) -> dict[str, str]:
    """Hash of every result of every month, by its path."""
    return {path.relative_to(out).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
            for name in RESULTS for path in sorted(out.glob(f"*/*/{name}"))}


def on_executor(description: Path, out: Path, jobs: int, scheduler: str | None = None) -> None:
    months._KEPT.clear()
    with executor(jobs, scheduler) as runs:
        run = probupdate.farm(description, out, jobs=runs)
    if run.failed:
        raise SystemExit(run.summary)


def on_dask(description: Path, out: Path, workers: int) -> None:
    import distributed

    with limit_threads_of_workers(), distributed.LocalCluster(n_workers=workers, threads_per_worker=1, processes=True,
                                                              dashboard_address=":0") as cluster:
        on_executor(description, out, 1, cluster.scheduler_address)


def on_shards(description: Path, out: Path, count: int) -> None:
    """All shards at once, each in a process of its own, as an array of jobs runs them."""
    started = [subprocess.Popen([sys.executable, "-c", SHARD, str(description), str(out), f"{k}/{count}"])
               for k in range(1, count + 1)]
    if any([one.wait() for one in started]):
        raise SystemExit("a shard failed")


WAYS = {"processes": on_executor, "dask": on_dask, "shards": on_shards}


def processor_seconds() -> float:
    """Of this process and of all that it has waited for."""
    found = os.times()
    return found.user + found.system + found.children_user + found.children_system


def throughput(description: Path, out: Path, workers: Sequence[int], n_month: int) -> list[dict]:
    """Per way and number of workers: seconds by the clock with the workers' start, processor seconds, the load before,
    turbine-months an hour; every way's results are held against the first's, byte for byte."""
    rows: list[dict] = []
    first: dict[str, str] = {}
    for count in workers:
        for way, run in WAYS.items():
            if way == "dask" and importlib.util.find_spec("distributed") is None:
                print("Dask: distributed is not installed")
                continue
            shutil.rmtree(out, ignore_errors=True)
            load, begun, used = os.getloadavg()[0], time.monotonic(), processor_seconds()
            run(description, out, count)
            seconds, used = time.monotonic() - begun, processor_seconds() - used
            found = contents(out)
            first = first or found
            if found != first or len(found) != n_month * len(RESULTS):
                raise SystemExit(f"{count} {way}: other bytes than those of the first way")
            rows.append({"way": way, "workers": count, "seconds": seconds, "processor_seconds": used,
                         "load_before": load, "an_hour": 3600 * n_month / seconds,
                         "ratio": rows[0]["seconds"] / seconds if rows else 1.0})
            print(f"{count} {way}: {n_month} turbine-months in {seconds:.0f} s by the clock, {used:.0f} s of processor "
                  f"time, load before {load:.1f}: {3600 * n_month / seconds:.0f} an hour, {rows[-1]['ratio']:.2f} "
                  "times the first; same bytes", flush=True)
    return rows


def arithmetic(measured: dict) -> tuple[float, float]:
    """Hours of one core for the whole farm, where nothing is found and where every month has two findings; what each
    step has part in it is printed. identify, select and update by two lengths of record, the diagnosis by months."""
    short, long = measured["short"], measured["long"]
    more, number = long["blocks"] - short["blocks"], TURBINES * MONTHS
    total = np.zeros(2)

    def add(name: str, seconds: float | np.ndarray, times: int) -> None:
        nonlocal total
        hours = np.broadcast_to(np.asarray(seconds) * times / 3600, 2)
        total = total + hours
        each = " to ".join(f"{s:.0f}" for s in np.unique(seconds))
        print(f"{name}: {each} s, {times} times: {' to '.join(f'{h:.1f}' for h in np.unique(hours))} h")

    add(PREPARED, 0.5 * (short["seconds"][PREPARED] + long["seconds"][PREPARED]), TURBINES)
    for step in ("identify", "select", "update"):
        slope = max((long["seconds"][step] - short["seconds"][step]) / more, 0.0)
        # nine sets are updated, however many there are
        slope = 0.0 if step == "update" else slope
        fixed = max(short["seconds"][step] - slope * short["blocks"], 0.0)
        add(f"{step} a month of {BLOCKS_A_MONTH} blocks", fixed + slope * BLOCKS_A_MONTH, number)
    add("tests of a month's records", measured["records"] * BLOCKS_A_MONTH, number)
    add("diagnose a month", np.array(list(measured["diagnose"].values())), number)
    return float(total[0]), float(total[1])


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--days", type=float, default=0.5)
    parser.add_argument("--turbines", type=int, default=6)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--throughput", action="store_true", help="only that; OUT/throughput.json")
    a = parser.parse_args()
    data = a.out / "data"
    description = data / "farm.toml"
    if not description.exists():
        write_farm(data, a.days, a.turbines)
    if a.throughput:
        rows = throughput(description, a.out / "farm", a.workers, a.turbines)
        content = {"cores": os.cpu_count(), "days": a.days, "rows": rows}
        (a.out / "throughput.json").write_text(json.dumps(content, indent=1), encoding="utf-8")
        return
    measured: dict = {"cores": os.cpu_count(), "load": os.getloadavg()[0], "days": a.days, "turbines": a.turbines}
    for name, toml in (("short", description), ("long", data / "long.toml")):
        shutil.rmtree(a.out / name, ignore_errors=True)
        taken, blocks = steps_of(toml, a.out / name)
        shutil.rmtree(a.out / f"{name}-peak", ignore_errors=True)
        measured[name] = {"blocks": blocks, "seconds": taken, "peak_mb": peak_mb(toml, a.out / f"{name}-peak")}
        print(f"{blocks} blocks: " + ", ".join(f"{step} {s:.1f} s" for step, s in taken.items())
              + f"; at most {measured[name]['peak_mb']:.0f} MB", flush=True)
    measured["throughput"] = throughput(description, a.out / "farm", a.workers, a.turbines)
    ready = months._prepare_model(model_path("as_built"), read_campaign(data / "T1" / "0").sensors)
    measured["diagnose"] = {}
    for name, hidden in (("nothing hidden", []), ("two hidden", HIDDEN)):
        taken, n_set, verdict = month_of_modes(ready, hidden)
        measured["diagnose"][name] = taken
        print(f"diagnosis of a month, {n_set} sets, {name}: {taken:.0f} s, {verdict}", flush=True)
    measured["records"] = records_tested(data / "T1" / "0")
    hours = arithmetic(measured)
    terabytes = TURBINES * MONTHS * 30 * 86400 * RATE_HZ * CHANNELS * 4 / 1e12
    measured |= {"hours": hours, "terabytes": terabytes}
    print(f"{TURBINES} turbines x {MONTHS} months: {hours[0]:.0f} to {hours[1]:.0f} hours of one core, {terabytes:.1f} "
          "TB of records in single precision; identify reads them twice, the diagnosis's tests of the records once")
    (a.out / "measured.json").write_text(json.dumps(measured, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
