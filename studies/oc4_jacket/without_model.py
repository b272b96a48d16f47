"""The OC4 jacket solved by OpenSees, diagnosed without a model: what is said of sensors that is the structure's?

python studies/oc4_jacket/without_model.py OUT.jsonl [--first K] [--most N] [--data FOLDER]   goes on where it stopped
python studies/oc4_jacket/without_model.py OUT.jsonl --table

The records of `run.py`, with tide, temperature and wind in all of them. What follows the tide is right wherever it is
found. Of the structure nothing has a name without a model: a step or a ramp is unexplained, what is constant is silent.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).resolve().parent))

import hidden_cases as cases
import opensees_jacket as jacket
from run import DATA, MOST, rate, read_lines

from probupdate.diagnosis.prepare import prepare
from probupdate.diagnosis.without_model import diagnose_without_model

SENSORS = ("gain", "flip", "swap")
CERTAIN = 0.95


def run_one(d: jacket.Description, sensors, case: cases.Case) -> dict:
    data, begun = cases.record(d, case), time.process_time()
    found = diagnose_without_model(data, sensors)
    return {
        "id": case.id, "hidden": [[e.kind, e.cause, e.location, e.time_profile, str(e.size)] for e in case.effects],
        "verdict": found.verdict, "cpu_s": round(time.process_time() - begun, 2),
        "findings": [[f.kind, f.cause, f.location, f.time_profile, f.size, f.size_std, f.posterior_probability,
                      [[a.cause, a.location, a.posterior_probability] for a in f.alternatives]]
                     for f in found.findings],
        "changes": [c["time_profile"] for c in found.details["changes"]],
    }


def outcome(line: dict) -> str:
    """right: named as it is, or where it has no name without one; in the set; silent; unexplained; doubtful: something
    else, less than certain; wrong: something else at 0.95 or more."""
    others = [f for f in line["findings"] if f[3] != "water_level_m"]
    kind, cause, place, time_profile = line["hidden"][0][:4] if line["hidden"] else ("nothing", "", "", "constant")
    if kind in SENSORS:
        right = [f for f in others if f[1:3] == [cause, place]]
        if right and len(others) == 1 and others[0][6] >= CERTAIN:
            return "right"
        if right or any([cause, place] == a[:2] for f in others for a in f[7]):
            return "in the set"
    if any(f[0] == "measurement" for f in others):
        return "wrong" if max(f[6] for f in others if f[0] == "measurement") >= CERTAIN else "doubtful"
    if line["changes"] or others:
        return "right" if time_profile != "constant" and kind not in SENSORS else "unexplained"
    silent = time_profile == "constant" and kind not in SENSORS
    return "right" if silent else "silent"


def table(lines: list[dict]) -> str:
    words = ("right", "in the set", "silent", "unexplained", "doubtful", "wrong")
    groups: dict[str, list[str]] = {}
    for line in lines:
        kind = "nothing"
        if line["hidden"]:
            hidden = line["hidden"][0]
            kind = f"{hidden[0] if hidden[0] in SENSORS else 'structure'}, {hidden[3]}"
        groups.setdefault(kind, []).append(outcome(line))
    rows = ["| hidden | records | " + " | ".join(words) + " |", "|---" * (2 + len(words)) + "|"]
    rows += [f"| {kind} | {len(own)} | " + " | ".join(str(own.count(w)) for w in words) + " |"
             for kind, own in sorted(groups.items())]
    every = [o for own in groups.values() for o in own]
    return "\n".join([*rows, "", f"Named wrong: {rate(every.count('wrong'), len(every))}."])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--first", type=int, default=0, help="number of the first case of each family")
    parser.add_argument("--most", type=int, help="cases of each family at most")
    parser.add_argument("--table", action="store_true", help="count what is there")
    a = parser.parse_args()
    if not a.table:
        d = jacket.read_description(a.data)
        with TemporaryDirectory() as folder:
            sensors = prepare(cases.write_model(a.data, Path(folder) / "model", d)).sensors
        done = {line["id"] for line in read_lines(a.out)}
        for family, most in MOST.items():
            for number in range(a.first, a.first + min(most, most if a.most is None else a.most)):
                case = cases.make_case(family, number)
                if case.id not in done:
                    with a.out.open("a", encoding="utf-8") as file:
                        file.write(json.dumps(run_one(d, sensors, case)) + "\n")
    sys.stdout.write(table(read_lines(a.out)) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
