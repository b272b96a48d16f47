"""The OC4 jacket solved by OpenSees, diagnosed with its SubDyn file as the model: one JSON line a case.

python studies/oc4_jacket/run.py OUT [--families null single] [--first K] [--most N] [--quick]   goes on where it was
python studies/oc4_jacket/run.py OUT --tables                                     the tables from what is there
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import hidden_cases as cases
import numpy as np
import opensees_jacket as jacket
from scipy import stats

import probupdate
from probupdate.diagnosis.prepare import Prepared, prepare
from probupdate.modal.modes import write_modes

DATA = Path(__file__).resolve().parents[3] / "shared" / "reference" / "oc4"
MOST = {"null": 20, "single": 36}
# of the quick form: one record with nothing hidden, one lost brace, one wrong gain
QUICK = (("null", 0), ("single", 0), ("single", 1))
WORDS = ("right", "beside", "in the set", "wrong", "unexplained", "silent")


def judged(verdict: str, findings: list[dict], hidden: list[dict]) -> str:
    """silent; unexplained; right: the one finding is what is hidden; beside: it comes first and others after it; in
    the set: it is a later one, or among the alternatives of any; wrong: nowhere."""
    if verdict == "none":
        return "silent"
    if verdict == "unexplained" or not findings:
        return "unexplained"
    if not hidden:
        return "wrong"
    key = (hidden[0]["cause"], hidden[0]["location"])
    if (findings[0]["cause"], findings[0]["location"]) == key:
        return "right" if len(findings) == 1 else "beside"
    held = any((f["cause"], f["location"]) == key or key in [tuple(a[:2]) for a in f["alternatives"]] for f in findings)
    return "in the set" if held else "wrong"


def hidden_row(effect: cases.Effect, limits) -> dict:
    """What is hidden, with what the diagnosis states as the least of it that it finds in this record."""
    row = {
        "kind": effect.kind,
        "cause": effect.cause,
        "location": effect.location,
        "time_profile": effect.time_profile,
        "size": effect.size if np.isfinite(effect.size) else None,
        "parts": dict(effect.parts),
    }
    for x in limits:
        if (x.cause, x.location, x.time_profile) == (effect.cause, effect.location,
                                                     effect.time_profile) and np.isfinite(x.size):
            row |= {"limit": x.size, "share_left": x.share_left, "z_first": x.z}
    return row


def run_one(
    prepared: Prepared,
    d: jacket.Description,
    case: cases.Case,
    folder: Path,
    *,
    stated: str = "joint",
    still: bool = False,
) -> dict:
    """One line of cases.jsonl; the record stands in `folder` as a user's file would."""
    begun = time.process_time()
    path = folder / f"{case.id}.json"
    write_modes(cases.record(d, case, stated=stated, still=still), path)
    simulated = time.process_time()
    found = probupdate.diagnose(prepared, path, extend=False, seed=1)
    findings = [
        {
            "cause": f.cause,
            "location": f.location,
            "time_profile": f.time_profile,
            "size": f.size,
            "std": f.size_std,
            "probability": f.posterior_probability,
            "z": f.z,
            "alternatives": [[a.cause, a.location, a.posterior_probability] for a in f.alternatives],
        }
        for f in found.findings
    ]
    hidden = [hidden_row(e, found.detectable_sizes) for e in case.effects]
    return {
        "id": case.id,
        "family": case.family,
        "stated": stated,
        "still": still,
        "hidden": hidden,
        "verdict": found.verdict,
        "judged": judged(found.verdict, findings, hidden),
        "p": found.p_value,
        "threshold": found.threshold,
        "adequacy": found.adequacy_p,
        "findings": findings,
        "nearest": found.details.get("nearest", []),
        "notes": list(found.notes),
        "simulate_s": round(simulated - begun, 2),
        "cpu_s": round(time.process_time() - simulated, 2),
    }


def read_lines(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.is_file() else []


def run_all(out: Path, data: Path, tasks, **how) -> None:
    """cases.jsonl line by line; `how`: see cases.record."""
    (out / "records").mkdir(parents=True, exist_ok=True)
    d = jacket.read_description(data)
    prepared = prepare(cases.write_model(data, out / "model", d))
    path = out / "cases.jsonl"
    done = {x["id"] for x in read_lines(path)}
    for family, number in tasks:
        case = cases.make_case(family, number)
        if case.id in done:
            continue
        line = run_one(prepared, d, case, out / "records", **how)
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
        sys.stdout.write(f"{case.id}: {line['judged']}\n")
        sys.stdout.flush()


def rate(hits: int, n: int) -> str:
    """With the 95 % interval of Clopper and Pearson (1934)."""
    if not n:
        return "no case"
    low = stats.beta.ppf(0.025, hits, n - hits + 1) if hits else 0.0
    high = stats.beta.ppf(0.975, hits + 1, n - hits) if hits < n else 1.0
    return f"{hits} of {n} ({100 * low:.0f} to {100 * high:.0f} %)"


def above_limit(line: dict) -> bool:
    """Whether the diagnosis of this record states that it would find an effect of this size (a flip and an exchange
    have one size; of growth, in a unit of its own, the limit is not compared)."""
    hidden = line["hidden"][0]
    limit = hidden.get("limit")
    return hidden["size"] is not None and limit is not None and abs(hidden["size"]) >= abs(limit)


def tables(lines: list[dict]) -> str:
    lines = [x | {"judged": judged(x["verdict"], x["findings"], x["hidden"])} for x in lines]
    null = [x for x in lines if x["family"] == "null"]
    single = [x for x in lines if x["family"] == "single"]
    detected = [x for x in single if x["verdict"] != "none"]
    above = [x for x in single if above_limit(x)]
    named = [x for x in single if x["verdict"] == "named"]

    def first(x):
        return x["judged"] in ("right", "beside")

    sized = [
        (f["size"], f["std"], e["size"])
        for x in detected
        if first(x)
        for f, e in [(x["findings"][0], x["hidden"][0])]
        if e["size"] is not None and f["std"] > 0
    ]
    rows = [
        "| what | rate |",
        "|---|---|",
        f"| nothing hidden: silent | {rate(sum(x['verdict'] == 'none' for x in null), len(null))} |",
        f"| above the record's stated limit: detected | {rate(sum(x in detected for x in above), len(above))} |",
        f"| detected: right cause and place first | {rate(sum(map(first, detected)), len(detected))} |",
        f"| detected: and nothing beside it | {rate(sum(x['judged'] == 'right' for x in detected), len(detected))} |",
        f"| detected: first or in the set | {rate(sum(x['judged'] in WORDS[:3] for x in detected), len(detected))} |",
        f"| *named*: right | {rate(sum(x['judged'] == 'right' for x in named), len(named))} |",
        f"| size within its 90 % interval | {rate(sum(abs(a - b) < 1.645 * s for a, s, b in sized), len(sized))} |",
        "",
        "| hidden | time profile | records | " + " | ".join(WORDS) + " |",
        "|---" * (3 + len(WORDS)) + "|",
    ]
    keys = {(x["hidden"][0]["kind"], x["hidden"][0]["time_profile"]) if x["hidden"] else ("nothing", "-")
            for x in lines}
    for kind, time_profile in sorted(keys):
        own = [
            x
            for x in lines
            if (x["hidden"][0]["kind"] if x["hidden"] else "nothing") == kind
            and (not x["hidden"] or x["hidden"][0]["time_profile"] == time_profile)
        ]
        counts = [sum(x["judged"] == w for x in own) for w in WORDS]
        rows.append(f"| {kind} | {time_profile} | {len(own)} | " + " | ".join(map(str, counts)) + " |")
    if lines:
        rows += [
            "",
            f"Processor time of a diagnosis: median {np.median([x['cpu_s'] for x in lines]):.0f} s, "
            f"of a record {np.median([x['simulate_s'] for x in lines]):.0f} s.",
        ]
    return "\n".join(rows) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--families", nargs="+", choices=[*MOST], default=[*MOST])
    parser.add_argument("--first", type=int, default=0, help="number of the first case of each family")
    parser.add_argument("--most", type=int, help="cases of each family at most")
    parser.add_argument("--quick", action="store_true", help="one record with nothing hidden, two with an effect")
    parser.add_argument(
        "--stated",
        choices=("joint", "std", "none"),
        default="joint",
        help="what the sets say of their scatter: covariances as identify writes them, standard "
        "deviations alone, nothing",
    )
    parser.add_argument("--still", action="store_true", help="no tide, temperature, wind")
    parser.add_argument("--tables", action="store_true", help="count what is there")
    a = parser.parse_args()
    if not a.tables:
        counts = {f: min(MOST[f], a.most if a.most is not None else MOST[f]) for f in a.families}
        by_turns = [(f, a.first + k) for k in range(max(counts.values())) for f in a.families if k < counts[f]]
        run_all(a.out, a.data, QUICK if a.quick else by_turns, stated=a.stated, still=a.still)
    sys.stdout.write(tables(read_lines(a.out / "cases.jsonl")))
    return 0


if __name__ == "__main__":
    sys.exit(main())
