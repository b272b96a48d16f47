"""What two workers bring over one: blocks identified an hour and a diagnosis, in processes and on a Dask cluster.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python studies/performance/benchmark_executors.py RUN [--repeat 1]

RUN: a folder that the demonstration wrote, or writes now; its campaign is identified and diagnosed on each executor in
turns, so that ratios do not depend on what else the machine does as much as seconds do. Workers are started and have
imported the package before the clock runs. Files are compared byte by byte.
"""

from __future__ import annotations

import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

from demonstrated import asked

from probupdate import verbs
from probupdate.runtime.executors import SERIAL, Executor, dask_cluster, processes

MODULES = ("probupdate.identification.identify", "probupdate.diagnosis.run")


def identified(run: Path, folder: Path, runs: Executor) -> bytes:
    result = verbs.identify(run / "campaign", run / "model.toml", store=folder / "modes.json.blocks", jobs=runs)
    result.write(folder / "modes.json")
    return (folder / "modes.json").read_bytes()


def diagnosed(run: Path, folder: Path, runs: Executor) -> bytes:
    out = folder / "diagnosis.json"
    found = verbs.diagnose(run / "model.toml", run / "modes.json", campaign=run / "campaign", seed=1, out=out,
                           jobs=runs)
    found.write(out)
    # the command that is said names the folder
    return out.read_bytes().replace(str(folder).encode(), b"")


def imported(name: str) -> bool:
    __import__(name)
    return True


def executors(stack: ExitStack) -> dict[str, Executor]:
    """Each with its workers started."""
    found = {"one process": SERIAL, "two processes": stack.enter_context(processes(2))}
    found["two processes"].prepare(2, *MODULES)
    try:
        from distributed import LocalCluster
    except ImportError:
        sys.stdout.write("Dask is left out: the package distributed is not installed\n")
        return found
    for n in (1, 2):
        cluster = stack.enter_context(LocalCluster(n_workers=n, threads_per_worker=1, dashboard_address=None))
        runs = stack.enter_context(dask_cluster(cluster.scheduler_address))
        list(runs.as_completed(imported, [(name,) for name in MODULES for _ in range(4)]))
        found[f"Dask, {'one worker' if n == 1 else 'two workers'}"] = runs
    return found


def main() -> None:
    a = asked(__doc__)
    n_block = len(list((a.run / "modes.json.blocks").glob("*.poles.npz")))
    with ExitStack() as stack:
        known = executors(stack)
        for what, job in (("identify", identified), ("diagnose", diagnosed)):
            least: dict[str, float] = {}
            results = set()
            for _ in range(a.repeat):
                for name, runs in known.items():
                    with tempfile.TemporaryDirectory() as folder:
                        clock = time.perf_counter()
                        results.add(job(a.run, Path(folder), runs))
                        taken = time.perf_counter() - clock
                    least[name] = min(taken, least.get(name, taken))
            for name, taken in least.items():
                rate = f", {3600 * n_block / taken:.0f} blocks an hour" if job is identified else ""
                sys.stdout.write(f"{what}, {name}: {taken:.1f} s{rate}, ratio {least['one process'] / taken:.2f}\n")
            sys.stdout.write(f"{what}: files are {'the same' if len(results) == 1 else 'NOT the same'}\n")


if __name__ == "__main__":
    main()
