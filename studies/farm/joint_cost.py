"""Processor seconds of one inference for 20 turbines of nine sets each, beside one turbine's update and posterior.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python studies/farm/joint_cost.py OUT [--turbines 20]
                                                                [--ways "one process" "two processes" "Dask"]

Modal sets of the virtual turbine, a seed a turbine; the joint inference begins where the farm's own step does, with
each turbine's estimate known from its update. Workers' processor time is counted; every way ends with the same bytes.
"""

from __future__ import annotations

import argparse
import contextlib
import os
from dataclasses import replace
from pathlib import Path

import probupdate
from probupdate.modal.modes import write_modes
from probupdate.runtime.executors import executor, limit_threads_of_workers
from probupdate.updating.discrepancy import LikelihoodSettings
from probupdate.updating.joint_inference import TurbineSets
from probupdate.updating.joint_result import infer_farm
from probupdate.updating.problem import build_problem
from probupdate.verbs.estimating import Case, compared_modes
from probupdate.verbs.models import ModelAt
from probupdate.virtual.modal_blocks import simulate_modes

MODEL, N_SET = "as_built", 9


def processor_s() -> float:
    """Of this process and of its workers that have ended."""
    return sum(os.times()[:4])


@contextlib.contextmanager
def runs_of(way: str):
    with contextlib.ExitStack() as stack:
        stack.enter_context(limit_threads_of_workers())
        address = None
        if way == "Dask":
            from distributed import LocalCluster

            cluster = stack.enter_context(LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None))
            address = cluster.scheduler_address
        yield stack.enter_context(executor(2 if way == "two processes" else 1, address))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--turbines", type=int, default=20)
    parser.add_argument("--common", nargs="+", default=["k_j", "k_t", "k_p"])
    parser.add_argument("--varying", nargs="+", default=["a_m", "py"])
    parser.add_argument("--ways", nargs="+", default=["one process", "two processes", "Dask"])
    a = parser.parse_args()
    a.out.mkdir(parents=True, exist_ok=True)
    paths = []
    for k in range(a.turbines):
        data = simulate_modes(seed=k + 1, states=("idling",), n_block=N_SET, days=1).data
        paths.append(a.out / f"modes_{k + 1}.json")
        write_modes(data, paths[-1])
    begun = processor_s()
    update = probupdate.update(MODEL, paths[0])
    updated = processor_s() - begun
    probupdate.sample(MODEL, paths[0], a.out / "posterior.nc")
    alone = processor_s() - begun
    print(f"one turbine: update of {N_SET} sets {updated:.1f} s, sample {alone - updated:.1f} s", flush=True)
    begun = processor_s()
    case = Case.prepare(MODEL, paths[0], LikelihoodSettings())
    model_at = ModelAt(MODEL, None, str(paths[0]), case.data.felt)
    turbines = []
    for k, path in enumerate(paths):
        data = compared_modes(path)
        # of its own estimate each: linearised again at the joint one
        at = tuple(x * (1 + 1e-3 * k) for x in case.weights.at)
        weights = replace(case.weights, at=at)
        problems = tuple(build_problem(model_at(s), data, set_id=s.id, weights=weights) for s in data.sets)
        turbines.append(TurbineSets(name=f"T{k + 1}", month="1", problems=problems, theta=update.map_theta))
    built = processor_s() - begun
    print(f"problems of {a.turbines} turbines {built:.1f} s", flush=True)
    for way in a.ways:
        begun = processor_s()
        with runs_of(way) as jobs:
            found = infer_farm(turbines, common=a.common, varying=a.varying, jobs=jobs)
        joint = built + processor_s() - begun
        (a.out / f"{way}.txt").write_text(found.summary)
        print(found.verdict)
        print(f"{way}: {joint:.1f} s, {joint / alone:.2f} times one turbine", flush=True)


if __name__ == "__main__":
    main()
