"""Runs the blind study: one JSON line a case, in two processes; started again, it goes on where it stopped.

python studies/blind/run.py OUT [--families null single ...] [--first K] [--most N] [--processes 2] [--ablation NAME]
Then: python studies/blind/tables.py OUT
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
from cases import FAMILIES, Case, make_case

MODEL = "updated"
_prepared = None


def simulated(case: Case):
    """The case's modal sets."""
    from probupdate.virtual.modal_blocks import simulate_modes
    from probupdate.virtual.turbine_file import read_turbine, reference_file

    options, truth = dict(case.options), dict(case.truth)
    shifts = options.pop("shifts", {})
    if shifts:
        known = read_turbine(reference_file()).parameters
        truth["parameters"] = {
            name: float(min(max(known[name].initial + k * known[name].std, known[name].lower + 1e-3 * known[name].std),
                            known[name].upper))
            for name, k in shifts.items()
        }
    if "states" in options:
        options["states"] = tuple(options["states"])
    return simulate_modes(truth=truth, seed=case.seed, **options)


def prepared():
    """The model made ready, once a process."""
    global _prepared
    if _prepared is None:
        from probupdate.diagnosis.prepare import prepare
        from probupdate.structure.load import reference_model

        _prepared = prepare(reference_model(MODEL))
    return _prepared


def ablate(name: str) -> None:
    """Take one safeguard out of the diagnosis, for this process: the study shows what it is for."""
    from probupdate.diagnosis import problem as settings

    if name == "no-floor":
        for part in ("LOG", "CROSS", "SHAPE", "PHASE"):
            setattr(settings, f"DISCREPANCY_{part}", 1e-6)
    elif name == "unconverged":
        from probupdate.diagnosis import fitting

        fitting.SETTLED = 1e9
    elif name:
        raise SystemExit(f"ablation '{name}' is unknown: no-floor, unconverged")


def run_case(case: Case) -> dict:
    from probupdate.diagnosis.diagnose import examine

    begun = time.process_time()
    record = simulated(case)
    outcome = examine(prepared(), record.data, seed=1)
    found = outcome.diagnosis
    return {
        "id": case.id, "family": case.family, "seed": case.seed, "hidden": list(case.truth.get("effect", ())),
        "effects": list(case.effects), "verdict": found.verdict, "p_value": found.p_value,
        "threshold": found.threshold, "adequacy_p": found.adequacy_p,
        "findings": [
            {"cause": f.cause, "location": f.location, "time_profile": f.time_profile, "size": f.size,
             "size_std": f.size_std,
             "z": f.z, "probability": f.posterior_probability,
             "alternatives": [[a.cause, a.location] for a in f.alternatives],
             "probabilities": [a.posterior_probability for a in f.alternatives]}
            for f in found.findings
        ],
        # what was taken in where the verdict is "unexplained": the names an analysis without that verdict would give
        "taken_in": [[n.effect.cause, n.effect.location] for n in outcome.fitted.included],
        "notes": list(found.notes), "left_over": float(outcome.last.statistic.max() / outcome.last.threshold),
        "limits": {f"{x.cause} | {x.location} | {x.time_profile}": x.size for x in found.detectable_sizes},
        "cpu_s": time.process_time() - begun,
    }


def _start(ablation: str) -> None:
    if ablation:
        ablate(ablation)


def _one(task: tuple[str, int, dict | None]) -> str:
    family, number, limits = task
    case = make_case(family, number, limits)
    try:
        found = run_case(case)
    except Exception as error:  # a case that fails is a result of the study, named and counted
        found = {"id": case.id, "family": family, "effects": list(case.effects), "failed": repr(error)[:300],
                 "hidden": list(case.truth.get("effect", ()))}
    return json.dumps(found)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--families", nargs="*", default=list(FAMILIES))
    parser.add_argument("--first", type=int, default=0, help="number of the first case of each family")
    parser.add_argument("--most", type=int, default=10**6,
                        help="cases of each family at most, those of the table by default")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--ablation", default="")
    a = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    a.out.mkdir(parents=True, exist_ok=True)
    path = a.out / f"cases{'-' + a.ablation if a.ablation else ''}.jsonl"
    done = {json.loads(line)["id"] for line in path.read_text().splitlines()} if path.is_file() else set()
    stated = Path(__file__).with_name("limits.json")
    limits = json.loads(stated.read_text()) if stated.is_file() else None
    tasks = [(family, k, limits) for family in a.families
             for k in range(a.first, a.first + min(FAMILIES[family], a.most)) if f"{family}-{k:03d}" not in done]
    _start(a.ablation)
    if a.processes <= 1:
        _write(path, map(_one, tasks), len(tasks))
        return
    with multiprocessing.get_context("spawn").Pool(a.processes, _start, (a.ablation,)) as pool:
        _write(path, pool.imap_unordered(_one, tasks), len(tasks))


def _write(path: Path, lines, n: int) -> None:
    from probupdate.cli.terminal import time_left

    begun = time.monotonic()
    with path.open("a") as file:
        for k, line in enumerate(lines, start=1):
            file.write(line + "\n")
            file.flush()
            print(f"{k}/{n} {json.loads(line)['id']}{time_left(time.monotonic() - begun, k, n)}", flush=True)


if __name__ == "__main__":
    main()
