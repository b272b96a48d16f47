"""The diagnosis on structures that are drawn at random: what it says of every record, counted.

python studies/other_worlds/run.py OUT [--families ...] [--first 1] [--most 8] [--quick]     goes on where it stopped
python studies/other_worlds/run.py OUT --raw ...        the same structures from raw accelerations, by `identify`
python studies/other_worlds/run.py OUT --tables                                              counts what is there
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import traceback
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import numpy as np
from campaigns import write_campaign
from records import FAMILIES, Record, draw_record

import probupdate
from probupdate.diagnosis.prepare import prepare
from probupdate.diagnosis.run import _read_groups

SURE = 0.95
# families of which accelerations are made: the others are of what modal sets lack
MEASURED = ("null", "null, masses", "loss step", "loss constant", "gain", "polarity", "swap", "turned", "clock",
            "temperature", "temperature untold", "ground spring", "tuned mass")


def judged(found, record: Record) -> str:
    """What a diagnosis comes to. silent; right: every place and no other; in the set: among a finding's alternatives;
    beside: right and another one; wrong: another one; unexplained."""
    if found.verdict in ("none", "unexplained"):
        return "silent" if found.verdict == "none" else "unexplained"
    first = {(f.cause, f.location) for f in found.findings}
    if record.places and first == record.places:
        return "right"
    if record.places and record.places <= first:
        return "beside"
    sets = {(a.cause, a.location) for f in found.findings for a in f.alternatives} | first
    if record.places and record.places <= sets and len(found.findings) == len(record.places):
        return "in the set"
    return "wrong"


def run_one(record: Record, folder: Path, raw: bool = False) -> dict:
    """One line of records.jsonl; `raw`: from accelerations, by `identify`."""
    path = record.world.write(folder / "model")
    campaign = write_campaign(record, folder / "campaign") if raw else None
    begun = time.process_time()
    line = {"family": record.family, "number": record.number, "kind": record.world.kind, "hidden": record.hidden,
            "size": record.size, "time_profile": record.time_profile}
    try:
        groups = _read_groups(path.parent / "groups.toml") if record.world.groups else None
        prepared, data = prepare(path, groups=groups, sensors=record.world.sensors), record.data
        if campaign is not None:
            data = probupdate.identify(campaign, path, lowest=record.world.n_mode).data
        found = probupdate.diagnose(prepared, data, extend=False, seed=record.number)
    except Exception as error:
        return line | {"judged": "error", "error": f"{type(error).__name__}: {error}",
                       "trace": traceback.format_exc(), "cpu_s": round(time.process_time() - begun, 2)}
    limit = [x.size for x in found.detectable_sizes if (x.cause, x.location) in record.places
             and x.time_profile == record.time_profile]
    return line | {
        "judged": judged(found, record), "verdict": found.verdict, "p": found.p_value, "adequacy": found.adequacy_p,
        "threshold": found.threshold, "limit": float(limit[0]) if limit and np.isfinite(limit[0]) else None,
        "findings": [{"cause": f.cause, "location": f.location, "time_profile": f.time_profile, "size": f.size,
                      "std": f.size_std,
                      "probability": f.posterior_probability, "z": f.z,
                      "alternatives": [[a.cause, a.location, round(a.posterior_probability, 3)]
                                       for a in f.alternatives]} for f in found.findings],
        "nearest": found.details.get("nearest", []), "notes": list(found.notes),
        "parts": [{k: part[k] for k in ("cause", "location", "size", "size_std", "frequency_hz", "frequency_std_hz")}
                  for part in found.details.get("free_form", {}).get("parts", []) if "has_mode" in part],
        **({"hung": hung(record)} if record.hidden == "tuned mass" else {}),
        "cpu_s": round(time.process_time() - begun, 2),
    }


def hung(record: Record) -> dict:
    """Mass, frequency of its own and channel (where it hangs at one) of a tuned mass."""
    K, M = record.scene.state(record.scene.n)
    dof = int(np.argmin(K[-1, :-1]))
    seen = np.abs(record.world.rows[:, dof])
    channel = record.world.sensors[int(np.argmax(seen))].channel if seen.max() > 0 else ""
    return {"size": float(M[-1, -1]), "frequency_hz": float(np.sqrt(K[-1, -1] / M[-1, -1]) / (2 * np.pi)),
            "channel": channel}


def read_lines(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.is_file() else []


def run_all(out: Path, families: list[str], first: int, most: int, raw: bool = False) -> None:
    """records.jsonl, line by line, a number of all families before the next."""
    out.mkdir(parents=True, exist_ok=True)
    path = out / "records.jsonl"
    done = {(x["family"], x["number"]) for x in read_lines(path)}
    for number in range(first, first + most):
        for family in families:
            if (family, number) in done:
                continue
            line = run_one(draw_record(family, number), out, raw)
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")


WORDS = ("right", "in the set", "beside", "wrong", "unexplained", "silent", "error")


def tables(out: Path) -> str:
    """Outcomes by family; sizes; wrong names that are said to be sure."""
    lines = read_lines(out / "records.jsonl")
    rows = ["| hidden | records | " + " | ".join(WORDS) + " | sure and wrong | sizes within 2 std | median cpu, s |",
            "|---" * (5 + len(WORDS)) + "|"]
    for family in FAMILIES:
        own = [x for x in lines if x["family"] == family]
        if not own:
            continue
        counts = " | ".join(str(sum(x["judged"] == w for x in own)) for w in WORDS)
        sure = sum(x["judged"] == "wrong" and max(f["probability"] for f in x["findings"]) >= SURE for x in own)
        sized = [(f["size"] - x["size"]) / f["std"] for x in own if x["judged"] == "right" for f in x["findings"]
                 if len(x["findings"]) == 1 and f["std"] > 0]
        near = sum(abs(off) < 2 for off in sized)
        rows.append(f"| {family} | {len(own)} | {counts} | {sure} | {near} of {len(sized)} | "
                    f"{np.median([x['cpu_s'] for x in own]):.1f} |")
    return "\n".join([*rows, *_hung_rows(lines)]) + "\n"


def _hung_rows(lines: list[dict]) -> list[str]:
    """Tuned masses whose own mode was identified as one that the model lacks: where they were found, and how large."""
    own = [x for x in lines if x.get("hung") and any("is none of the model's" in note for note in x["notes"])]
    found = [(x["hung"], x["parts"][0]) for x in own if x["parts"]]
    if not own:
        return []
    near = [part["location"].startswith(f"channel {there['channel']},") for there, part in found]

    def within(key: str, std: str) -> int:
        return sum(abs(part[key] - there[key]) < 2 * part[std] for there, part in found)

    return ["", f"tuned masses whose own mode was identified and is none of the model's: {len(own)}; searched and "
                f"found: {len(found)}, at the channel where they hang {sum(near)}, mass within 2 std "
                f"{within('size', 'size_std')}, frequency within 2 std {within('frequency_hz', 'frequency_std_hz')}"]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--families", nargs="*", default=list(FAMILIES), choices=FAMILIES, metavar="FAMILY")
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--most", type=int, default=8, help="records of each family")
    parser.add_argument("--quick", action="store_true", help="one record of each family")
    parser.add_argument("--raw", action="store_true", help="accelerations instead of modes")
    parser.add_argument("--tables", action="store_true")
    a = parser.parse_args()
    families = [x for x in a.families if x in MEASURED] if a.raw else a.families
    if not a.tables:
        run_all(a.out, families, a.first, 1 if a.quick else a.most, a.raw)
    sys.stdout.write(tables(a.out))
    return 0


if __name__ == "__main__":
    sys.exit(main())
