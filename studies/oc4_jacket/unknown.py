"""What stands in no table of the OC4 jacket: is it noticed, is it given a row's name, is it placed?

python studies/oc4_jacket/unknown.py OUT [--first K] [--most N] [--data FOLDER] [--mounts | --moved]
python studies/oc4_jacket/unknown.py OUT --tables
It goes on where it stopped.

By turns a cable from a leg's upper end to the tower, a fender at the water, a mass that swings on the tower, a second
structure beside a leg at the water, in OpenSees; four throughout, four as a step, and so on. The place is right within
a bay of the leg (or on a face that it is part of), within a level of sensors of the tower; in the set: the place of the
part, or one that it may have instead. `--mounts`: sensors on mounts that resonate, instead; the channel is the place,
and factor and phase in each group of modes are compared with the mount's. `--moved`: the sensors of a joint sit at the
next one along a member; the place is right within NEAR_M of that joint.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import hidden_cases as cases
import numpy as np
import opensees_jacket as jacket
from run import DATA, read_lines

from probupdate.diagnosis.diagnose import Outcome, examine
from probupdate.diagnosis.free_form import channel_response_content, free_form
from probupdate.diagnosis.gain import measures
from probupdate.diagnosis.prepare import Prepared, prepare

BAY_M, FACE_M, LEVEL_M = 14.0, 6.5, 24.0
NEAR_M = 2.0
POINT = re.compile(r"\(([-\d.]+), ([-\d.]+), ([-\d.]+)\) m")


def placed(effect: cases.Effect, cause: str, location: str) -> bool:
    """Whether a part is of the right kind and each of its points is near one of the truth."""
    points = [np.array(list(map(float, found))) for found in POINT.findall(location)]
    if cause != effect.cause or len(points) != len(effect.parts["where"]):
        return False

    def near(point: np.ndarray, truth: np.ndarray) -> bool:
        on_tower = truth[2] > 20
        apart = np.abs(point - truth)
        return bool(apart[2] <= (LEVEL_M if on_tower else BAY_M) and np.hypot(*apart[:2]) <= FACE_M
                    and (point[2] > 20) == on_tower)

    return all(any(near(point, np.array(truth)) for point in points) for truth in effect.parts["where"])


def run_one(prepared: Prepared, d: jacket.Description, number: int) -> dict:
    begun, case = time.process_time(), cases.unknown_case(d, number)
    (effect,) = case.effects
    data = cases.record(d, case)
    known = examine(prepared, data, seed=1)
    line = {"id": case.id, "kind": effect.kind, "where": effect.parts["where"], "size": effect.size,
            "frequency_hz": effect.parts["attached"][0].frequency_hz, "time_profile": effect.time_profile,
            "verdict": known.diagnosis.verdict,
            "findings": [[f.cause, f.location, f.posterior_probability] for f in known.diagnosis.findings]}
    free = free_form(prepared, known, data, seed=1) if known.diagnosis.verdict == "unexplained" else None
    if free is not None:
        outcome, parts = free.outcome, free.content["parts"]
        gain = measures(outcome.problem, outcome.null, outcome.fitted, noise=outcome.null.design.noise)
        line |= {"parts": parts, "complete": free.content["complete"],
                 "placed": any(placed(effect, p["cause"], p["location"]) for p in parts),
                 "in_set": any(placed(effect, a["cause"], a["location"]) for p in parts
                               for a in (p, *p["alternatives"])),
                 "gain": gain["heldout_elpd"], "gain_se": gain["heldout_elpd_se"]}
    return {**line, "cpu_s": round(time.process_time() - begun, 1)}


def run_mount(prepared: Prepared, d: jacket.Description, number: int) -> dict:
    begun, case = time.process_time(), cases.mount_case(number)
    (effect,) = case.effects
    known = examine(prepared, cases.record(d, case), seed=1)
    line = {"id": case.id, "kind": effect.kind, "where": effect.location, "size": effect.parts["resonance_hz"],
            "time_profile": effect.time_profile, "verdict": known.diagnosis.verdict,
            "findings": [[f.cause, f.location, f.posterior_probability] for f in known.proposed]}
    if known.own_response is not None:
        content = channel_response_content(known)
        line |= {"parts": content["parts"], "complete": content["complete"], "gain": content["gain"]["heldout_elpd"],
                 "gain_se": content["gain"]["heldout_elpd_se"], "off": _off(known, content["parts"][0], effect)}
        line["placed"] = line["in_set"] = content["parts"][0]["location"] == effect.location
    return {**line, "cpu_s": round(time.process_time() - begun, 1)}


def run_moved(prepared: Prepared, d: jacket.Description, number: int) -> dict:
    begun, case = time.process_time(), cases.moved_case(d, number)
    (effect,) = case.effects
    known = examine(prepared, cases.record(d, case), seed=1)
    at, to = d.place[effect.parts["joint"]], d.place[effect.parts["to"]]
    found = [{"cause": f.cause, "location": f.location, "size": f.size, "std": f.size_std,
              "probability": f.posterior_probability} for f in known.diagnosis.findings]
    apart = np.inf
    for f in found:
        if (f["cause"], f["location"].split()[0]) == (effect.cause, effect.location):
            end = np.array(list(map(float, POINT.findall(f["location"])[0])))
            point = at + f["size"] * (end - at) / np.linalg.norm(end - at)
            apart = min(apart, float(np.linalg.norm(point - to)))
    return {"id": case.id, "kind": effect.kind, "where": [effect.location, to.tolist()], "size": effect.size,
            "time_profile": effect.time_profile, "verdict": known.diagnosis.verdict, "findings": found,
            "parts": [], "apart_m": apart, "placed": apart < NEAR_M, "cpu_s": round(time.process_time() - begun, 1)}


def _off(known: Outcome, part: dict, effect: cases.Effect) -> list[list[float]]:
    """By how many of their standard deviations factor and phase are off in each group of modes."""
    blocks, result = known.problem.blocks, []
    of_group = {blocks.group_name(q): float(np.nanmedian(blocks.frequency_hz[:, list(members)]))
                for q, members in enumerate(blocks.groups)}
    for one in part["factors"]:
        true = cases.of_mount(np.array(of_group[one["mode"]]), effect.parts["resonance_hz"])
        result.append([float((one["factor"] - abs(true)) / one["factor_std"]),
                       float((one["phase_deg"] - np.degrees(np.angle(true))) / one["phase_std_deg"])])
    return result


def tables(lines: list[dict]) -> str:
    rows = ["| hidden | records | noticed | named as a row | parts found | kind and place right | in the set | "
            "gain above 2 s.e. |", "|---|---|---|---|---|---|---|---|"]
    for kind in (*cases.ATTACHED, "mount", "all"):
        own = [x for x in lines if kind in (x["kind"], "all")]
        if not own:
            continue
        found = [x for x in own if x.get("parts")]
        rows.append(f"| {kind} | {len(own)} | {sum(x['verdict'] != 'none' for x in own)} | "
                    f"{sum(x['verdict'] == 'named' for x in own)} | {len(found)} | {sum(x['placed'] for x in found)} | "
                    f"{sum(x['in_set'] for x in found)} | {sum(x['gain'] > 2 * x['gain_se'] for x in found)} |")
    moved = [x for x in lines if x["kind"] == "moved"]
    if moved:
        rows += ["", "| sensors at another joint | records | noticed | named | first place within 2 m |",
                 "|---|---|---|---|---|",
                 f"| all | {len(moved)} | {sum(x['verdict'] != 'none' for x in moved)} | "
                 f"{sum(x['verdict'] == 'named' for x in moved)} | {sum(x['placed'] for x in moved)} |"]
    return "\n".join(rows)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("out", type=Path)
    options.add_argument("--data", type=Path, default=DATA)
    options.add_argument("--first", type=int, default=0)
    options.add_argument("--most", type=int, default=16)
    kinds = options.add_mutually_exclusive_group()
    kinds.add_argument("--mounts", action="store_true")
    kinds.add_argument("--moved", action="store_true")
    options.add_argument("--tables", action="store_true")
    given = options.parse_args()
    path = given.out / "unknown.jsonl"
    if not given.tables:
        given.out.mkdir(parents=True, exist_ok=True)
        d = jacket.read_description(given.data)
        prepared = prepare(cases.write_model(given.data, given.out / "model", d))
        done = {x["id"] for x in read_lines(path)}
        for number in range(given.first, given.first + given.most):
            kind, run = ("mount", run_mount) if given.mounts else (
                ("moved", run_moved) if given.moved else ("unknown", run_one))
            if f"{kind}-{number:03d}" in done:
                continue
            line = run(prepared, d, number)
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
            sys.stdout.write(f"{line['id']}, {line['kind']}: {line['verdict']}, "
                             f"{[[p['cause'], p['location']] for p in line.get('parts', [])]}\n")
            sys.stdout.flush()
    sys.stdout.write(tables(read_lines(path)) + "\n")


if __name__ == "__main__":
    main()
