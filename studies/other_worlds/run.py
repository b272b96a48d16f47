"""The diagnosis on structures that are drawn at random: what it says of every record, counted.

python studies/other_worlds/run.py OUT [--families ...] [--first 1] [--most 8] [--quick]     goes on where it stopped
python studies/other_worlds/run.py OUT --raw ...        the same structures from raw accelerations, by `identify`
python studies/other_worlds/run.py OUT --extend ...          elementary parts that are like what no row describes, too
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
from probupdate.diagnosis.run import read_groups

SURE = 0.95
# families of which accelerations are made: the others are of what modal sets lack
MEASURED = ("null", "null, masses", "loss step", "loss constant", "gain", "polarity", "swap", "turned", "clock",
            "temperature", "temperature untold", "ground spring", "tuned mass", "large gain")


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


def run_one(record: Record, folder: Path, raw: bool = False, extend: bool = False) -> dict:
    """One line of records.jsonl; `raw`: from accelerations, by `identify`; `extend`: with what is like the unknown
    cause, and what that gains on held-out blocks."""
    path = record.world.write(folder / "model")
    campaign = write_campaign(record, folder / "campaign") if raw else None
    begun = time.process_time()
    line = {"family": record.family, "number": record.number, "kind": record.world.kind, "hidden": record.hidden,
            "size": record.size, "time_profile": record.time_profile}
    try:
        groups = read_groups(path.parent / "groups.toml") if record.world.groups else None
        prepared, data = prepare(path, groups=groups, sensors=record.world.sensors), record.data
        if campaign is not None:
            data = probupdate.identify(campaign, path, lowest=record.world.n_mode).data
        found = probupdate.diagnose(prepared, data, extend=extend, seed=record.number)
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
        **({"unknown": unknown(record, found.details.get("free_form", {}))}
           if extend and record.hidden in UNKNOWN else {}),
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


UNKNOWN = ("ground spring", "tuned mass")


def unknown(record: Record, found: dict) -> dict:
    """The elementary part that is said to be like what is hidden, what it gains on held-out blocks with its standard
    error, and the channels by how much they move with the place where that acts, the nearest first (static flexibility,
    as a correlation)."""
    K, _ = record.scene.state(record.scene.n)
    n = len(record.world.mass)
    at = int(np.argmax(np.diag(K - record.scene.sound[0]) if record.hidden == "ground spring" else -K[-1, :n]))
    flexibility = np.linalg.inv(record.world.stiffness({}))
    own = np.sqrt(np.einsum("cn,nm,cm->c", record.world.rows, flexibility, record.world.rows) * flexibility[at, at])
    alike = np.abs(record.world.rows @ flexibility[:, at]) / np.maximum(own, 1e-300)
    order = np.argsort(-alike, kind="stable")
    part, gain = next(iter(found.get("parts", [])), {}), found.get("gain", {})
    return {"nearest": [record.world.channels[k] for k in order[:2]], "alike": [float(alike[k]) for k in order[:2]],
            "cause": part.get("cause"), "location": part.get("location"), "since": part.get("since"),
            "complete": found.get("complete"), "gain": gain.get("heldout_elpd"), "gain_se": gain.get("heldout_elpd_se")}


def read_lines(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.is_file() else []


def run_all(out: Path, families: list[str], first: int, most: int, raw: bool = False, extend: bool = False) -> None:
    """records.jsonl, line by line, a number of all families before the next."""
    out.mkdir(parents=True, exist_ok=True)
    path = out / "records.jsonl"
    done = {(x["family"], x["number"]) for x in read_lines(path)}
    for number in range(first, first + most):
        for family in families:
            if (family, number) in done:
                continue
            line = run_one(draw_record(family, number), out, raw, extend)
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
    return "\n".join([*rows, *_hung_rows(lines), *_unknown_rows(lines)]) + "\n"


def _hung_rows(lines: list[dict]) -> list[str]:
    """Tuned masses whose own mode was identified as one that the model lacks: where they were found, and how large."""
    own = [x for x in lines if x.get("hung") and any("no counterpart in the model" in note for note in x["notes"])]
    found = [(x["hung"], x["parts"][0]) for x in own if x["parts"]]
    if not own:
        return []
    near = [part["location"].startswith(f"channel {there['channel']},") for there, part in found]

    def within(key: str, std: str) -> int:
        return sum(abs(part[key] - there[key]) < 2 * part[std] for there, part in found)

    return ["", f"tuned masses whose own mode was identified and is none of the model's: {len(own)}; searched and "
                f"found: {len(found)}, at the channel where they hang {sum(near)}, mass within 2 std "
                f"{within('size', 'size_std')}, frequency within 2 std {within('frequency_hz', 'frequency_std_hz')}"]


def _unknown_rows(lines: list[dict]) -> list[str]:
    """Of what no row describes and is *unexplained*: the part that is like it, where, and what it gains."""
    own = [x for x in lines if "unknown" in x and x["verdict"] == "unexplained"]
    if not own:
        return []
    rows = ["", "| hidden | unexplained | a part is said | of its kind | at the nearest channel | at one of the two "
                "nearest | gain beyond two standard errors |", "|---" * 7 + "|"]
    for family in UNKNOWN:
        of = [x["unknown"] for x in own if x["family"] == family]
        said = [x for x in of if x["location"]]
        kind = {"ground spring": "spring to ground", "tuned mass": "mass on springs"}[family]
        at = [x["location"].split(",")[0].removeprefix("channel ") for x in said]
        rows.append(f"| {family} | {len(of)} | {len(said)} | {sum(x['cause'] == kind for x in said)} | "
                    f"{sum(a == x['nearest'][0] for a, x in zip(at, said, strict=True))} | "
                    f"{sum(a in x['nearest'] for a, x in zip(at, said, strict=True))} | "
                    f"{sum(bool(x['gain_se']) and x['gain'] > 2 * x['gain_se'] for x in said)} |")
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--families", nargs="*", default=list(FAMILIES), choices=FAMILIES, metavar="FAMILY")
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--most", type=int, default=8, help="records of each family")
    parser.add_argument("--quick", action="store_true", help="one record of each family")
    parser.add_argument("--raw", action="store_true", help="accelerations instead of modes")
    parser.add_argument("--extend", action="store_true", help="look for elementary parts that are like the unknown")
    parser.add_argument("--tables", action="store_true")
    a = parser.parse_args()
    families = [x for x in a.families if x in MEASURED] if a.raw else a.families
    if not a.tables:
        run_all(a.out, families, a.first, 1 if a.quick else a.most, a.raw, a.extend)
    sys.stdout.write(tables(a.out))
    return 0


if __name__ == "__main__":
    sys.exit(main())
