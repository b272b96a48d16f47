"""Structures drawn at random, diagnosed without a model: what is said of sensors that is the structure's?

python studies/other_worlds/without_model.py OUT.jsonl [--families ...] [--first 1] [--most 8]  goes on where it stopped
python studies/other_worlds/without_model.py OUT.jsonl --table

Every record twice, with the places of the sensors and with their names alone. Of the structure nothing has a name
without a model: what steps is unexplained, what is constant is silent; what follows the temperature is named so.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from records import Record, draw_record
from run import read_lines

from probupdate.diagnosis.without_model import diagnose_without_model
from probupdate.errors import InputError

SENSORS = ("gain", "polarity", "swap", "turned", "clock")
ASKED = ("null", "loss step", "loss constant", *SENSORS, "temperature", "mass column", "ground spring", "tuned mass",
         "two sets", "nine sets", "frequencies", "one channel")
CERTAIN = 0.95
# what the only row that moves frequencies with a condition is called without a model
WITHOUT = {"stiffness with temperature": "temperature of the steel"}
# what no row describes, but follows a column
FOLLOWED = {"mass column": [["frequencies follow the amplitude", "all modes"]]}
WORDS = ("right", "in the set", "unexplained", "silent", "doubtful", "wrong", "refused")


def run_one(record: Record, placed: bool) -> dict:
    begun = time.process_time()
    line = {"family": record.family, "number": record.number, "placed": placed, "kind": record.world.kind,
            "hidden": record.hidden, "size": record.size, "time_profile": record.time_profile,
            "right": sorted([WITHOUT.get(cause, cause), place] for cause, place in record.places)}
    try:
        found = diagnose_without_model(record.data, record.world.sensors if placed else None)
    except InputError as error:
        return line | {"verdict": "refused", "error": str(error), "findings": [], "changes": []}
    return line | {
        "verdict": found.verdict, "cpu_s": round(time.process_time() - begun, 2),
        "findings": [[f.kind, f.cause, f.location, f.time_profile, f.time_profile_start, f.size, f.size_std,
                      f.posterior_probability, [[a.cause, a.location, a.posterior_probability] for a in f.alternatives]]
                     for f in found.findings],
        "changes": [[c["time_profile"], c["since"]] for c in found.details["changes"]],
    }


def outcome(line: dict) -> str:
    """right: what is hidden and no other, alone; in the set: among the alternatives; doubtful: something else, less
    than certain; wrong: something else at 0.95 or more."""
    findings, open_too = line["findings"], line["verdict"] == "unexplained"
    if line["verdict"] == "refused":
        return "refused"
    if not findings:
        return "unexplained" if open_too else "silent"
    named = sorted([f[1], f[2]] for f in findings)
    # a loss has no name here
    hidden = FOLLOWED.get(line["family"], line["right"] if line["family"] in (*SENSORS, "temperature") else [])
    if hidden and named == hidden and not open_too:
        return "right"
    if hidden and all(any([a[0], a[1]] in hidden for a in [f[1:3], *f[8]]) for f in findings):
        return "in the set"
    return "wrong" if max(f[7] for f in findings) >= CERTAIN else "doubtful"


def table(lines: list[dict]) -> str:
    rows = ["| hidden | places | records | " + " | ".join(WORDS) + " |", "|---" * (3 + len(WORDS)) + "|"]
    for family in ASKED:
        for placed in (True, False):
            own = [outcome(x) for x in lines if x["family"] == family and x["placed"] is placed]
            if own:
                rows.append(f"| {family} | {'known' if placed else 'not known'} | {len(own)} | "
                            + " | ".join(str(own.count(w)) for w in WORDS) + " |")
    return "\n".join(rows) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--families", nargs="*", default=list(ASKED), choices=ASKED, metavar="FAMILY")
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--most", type=int, default=8, help="records of each family")
    parser.add_argument("--table", action="store_true")
    a = parser.parse_args()
    done = {(x["family"], x["number"], x["placed"]) for x in read_lines(a.out)}
    for number in range(a.first, a.first if a.table else a.first + a.most):
        for family in a.families:
            record = draw_record(family, number)
            for placed in (True, False):
                if (family, number, placed) not in done:
                    with a.out.open("a", encoding="utf-8") as file:
                        file.write(json.dumps(run_one(record, placed)) + "\n")
    sys.stdout.write(table(read_lines(a.out)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
