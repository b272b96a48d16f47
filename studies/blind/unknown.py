"""What no row describes: is it noticed, is it given a row's name, and do elementary parts say where it is?

python studies/blind/unknown.py OUT.jsonl [--first K] [--most N] [--kinds cable ...]     (goes on where it stopped)
python studies/blind/unknown.py OUT.jsonl --table

In the set: the place, or one of those that the part may have instead (probability above 0.05), is right.

By turns a cable from a leg to the tower, a fender at a leg, a tuned mass on the tower, a second structure beside a leg,
each throughout (even numbers) or as a step on the fifteenth day. The place is right within a bay of the leg (or a face
that it is part of), within a level of sensors of the tower.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
from cases import LEGS
from run import prepared

STEP = {"time_profile": "step", "at_hour": 360.0}
BAY_M, LEVEL_M = 14.0, 24.0
KINDS = {
    "cable": lambda rng: {"leg": str(rng.choice(list(LEGS))), "z_m": 13.0, "tower_z_m": float(rng.uniform(40, 85)),
                          "stiffness_npm": float(10 ** rng.uniform(7.5, 8.2))},
    "fender": lambda rng: {"leg": str(rng.choice(list(LEGS))), "z_m": float(rng.uniform(-4, 8)),
                           "direction_deg": float(rng.uniform(0, 180)),
                           "stiffness_npm": float(10 ** rng.uniform(7.2, 7.8))},
    "tuned_mass": lambda rng: {"z_m": float(rng.uniform(40, 75)), "direction_deg": float(rng.uniform(0, 180)),
                               "frequency_hz": float(rng.uniform(1.2, 2.2)), "mass_kg": float(rng.uniform(4e3, 1e4))},
    "second_structure": lambda rng: {"leg": str(rng.choice(list(LEGS))), "z_m": float(rng.uniform(2, 13)),
                                     "frequency_hz": float(rng.uniform(1.0, 2.0)),
                                     "mass_kg": float(rng.uniform(2e4, 6e4))},
}
PARTS = {"cable": "spring between two points", "fender": "spring to ground", "tuned_mass": "mass on springs",
         "second_structure": "mass on springs"}


def hidden(kind: str, number: int) -> dict:
    rng = np.random.default_rng([number, list(KINDS).index(kind)])
    return {"kind": kind, **KINDS[kind](rng), **(STEP if number % 2 else {})}


def placed(truth: dict, cause: str, location: str) -> bool:
    """Whether a part is of the right kind and its place right."""
    if cause != PARTS[truth["kind"]]:
        return False
    tower = [float(z) for z in re.findall(r"tower, z = ([-\d.]+) m", location)]
    if truth["kind"] == "tuned_mass":
        return any(abs(z - truth["z_m"]) <= LEVEL_M for z in tower)
    at_leg = [float(z) for z in re.findall(rf"leg {truth['leg']}, z = ([-\d.]+) m", location)]
    near = any(abs(z - truth["z_m"]) <= BAY_M for z in at_leg)
    # at the height of the water and above stand the two uppermost bays
    face = any(truth["leg"] in face and int(bay) >= 3 for face, bay in re.findall(r"face (\w\w), bay (\d)", location))
    if truth["kind"] == "cable":
        return near and any(abs(z - truth["tower_z_m"]) <= LEVEL_M for z in tower)
    return near or face


def run_case(kind: str, number: int) -> dict:
    from probupdate.diagnosis.diagnose import examine
    from probupdate.diagnosis.free_form import free_form
    from probupdate.diagnosis.gain import measures
    from probupdate.virtual.modal_blocks import simulate_modes

    begun, truth = time.process_time(), hidden(kind, number)
    data = simulate_modes(truth={"parameters_from": "prior", "effect": [truth]}, seed=number).data
    known = examine(prepared(), data, seed=1)
    found = known.diagnosis
    result = {"id": f"{kind}-{number}", "kind": kind, "number": number, "hidden": truth, "verdict": found.verdict,
              "findings": [[f.cause, f.location, f.posterior_probability,
                            [[a.cause, a.location, a.posterior_probability] for a in f.alternatives]]
                           for f in found.findings], "cpu_diagnosis_s": time.process_time() - begun}
    free = free_form(prepared(), known, data, seed=1) if found.verdict == "unexplained" else None
    if free is not None:
        null, outcome = free.outcome.null, free.outcome
        gain = measures(outcome.problem, null, outcome.fitted, noise=null.design.noise)
        parts = free.content["parts"]
        result |= {"parts": [[p["cause"], p["location"], p["size"], p["size_std"], p["time_profile"]] for p in parts],
                   "placed": any(placed(truth, p["cause"], p["location"]) for p in parts),
                   "in_set": any(placed(truth, a["cause"], a["location"]) for p in parts
                                 for a in (p, *p["alternatives"])),
                   "gain": gain["heldout_elpd"], "gain_se": gain["heldout_elpd_se"],
                   "complete": free.content["complete"]}
    return {**result, "cpu_s": time.process_time() - begun}


def table(rows: list[dict]) -> str:
    lines = ["| hidden | cases | noticed | named as a row | parts found | kind and place right | in the set | "
             "gain above 2 s.e. |", "|---|---|---|---|---|---|---|---|"]
    for kind in (*KINDS, "all"):
        own = [r for r in rows if kind in (r["kind"], "all")]
        noticed = [r for r in own if r["verdict"] != "none"]
        named = [r for r in own if r["verdict"] == "named"]
        found = [r for r in own if r.get("parts")]
        right, gained = [r for r in found if r["placed"]], [r for r in found if r["gain"] > 2 * r["gain_se"]]
        lines.append(f"| {kind.replace('_', ' ')} | {len(own)} | {len(noticed)} | {len(named)} | {len(found)} | "
                     f"{len(right)} | {sum(r['in_set'] for r in found)} | {len(gained)} |")
    return "\n".join(lines)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("out", type=Path)
    options.add_argument("--first", type=int, default=1)
    options.add_argument("--most", type=int, default=10, help="cases of each kind")
    options.add_argument("--kinds", nargs="+", choices=[*KINDS], default=[*KINDS])
    options.add_argument("--table", action="store_true")
    given = options.parse_args()
    rows = [json.loads(line) for line in given.out.read_text().splitlines()] if given.out.exists() else []
    if not given.table:
        done = {r["id"] for r in rows}
        for number in range(given.first, given.first + given.most):
            for kind in given.kinds:
                if f"{kind}-{number}" in done:
                    continue
                rows.append(run_case(kind, number))
                with given.out.open("a") as file:
                    file.write(json.dumps(rows[-1]) + "\n")
                print(rows[-1]["id"], rows[-1]["verdict"], rows[-1].get("parts"), round(rows[-1]["cpu_s"]), flush=True)
    print(table(rows))


if __name__ == "__main__":
    main()
