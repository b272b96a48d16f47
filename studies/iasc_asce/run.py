"""The IASC-ASCE phase I benchmark: which braces the diagnosis names, case by case, seed by seed.

python studies/iasc_asce/run.py OUT [--first 1] [--seeds 20] [--quick]     goes on where it was stopped; OUT/cases.jsonl
python studies/iasc_asce/run.py OUT --tables                   the tables of RESULTS.md from what is there
python studies/iasc_asce/run.py OUT --loss                     a pair of braces that loses ever more
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from functools import cache
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import cases
import numpy as np
from cases import CASES, PATTERNS, Case, Pattern

import probupdate
from probupdate.diagnosis.prepare import Prepared, prepare

# the generator's patterns are asked where its authors ask them: whole storeys in all cases, single braces where the
# mass is asymmetric
ASKED = {1: (0, 1, 2), 2: (0, 1, 2), 3: (0, 1, 2), 4: (0, 1, 2, 3, 4, 6), 5: (0, 1, 2, 3, 4, 5, 6)}
QUICK_SEEDS = 1
# of a pair of braces, for the least loss that is found
SIMPLE, SIMPLE_STD = {2: (0, 1), 5: (0, 1, 3)}, 0.3
LOSSES = (0.04, 0.06, 0.08, 0.1, 0.15, 0.2)


def ready(case: Case, folder: Path, *, simple: bool = False) -> Prepared:
    """The model that is given for a case: of its own degrees of freedom and masses, stiffness known to the prior; or
    `simple`, the shear building for whatever was measured, with a prior of 30 % to meet its frequencies."""
    if simple:
        path = cases.write_model(folder / f"simple-{case.number}", n_dof=12, heavy=case.heavy, std=SIMPLE_STD)
        return prepare(path, groups=cases.groups())
    path = cases.write_model(folder / f"model-{case.n_dof}{'-heavy' if case.heavy else ''}", n_dof=case.n_dof,
                             heavy=case.heavy)
    return prepare(path, groups=cases.groups())


def judged(found, pattern: Pattern) -> str:
    """What a diagnosis comes to. silent; right: every place and no other; in the set: every place among a finding's
    alternatives; part: some and no wrong one; wrong: another place named; unexplained."""
    if found.verdict in ("none", "unexplained"):
        return "silent" if found.verdict == "none" else "unexplained"
    names = [f.location for f in found.findings]
    if frozenset(names) == pattern.places:
        return "right"
    sets = [{f.location, *(a.location for a in f.alternatives)} for f in found.findings]
    if len(sets) == len(pattern.places) and all(any(p in s for s in sets) for p in pattern.places):
        return "in the set"
    if set(names) < pattern.places:
        return "part"
    return "beside" if pattern.places and pattern.places < set(names) else "wrong"


def run_one(prepared: Prepared, case: Case, pattern: Pattern, seed: int, time_profile: str) -> dict:
    """One line of cases.jsonl."""
    data = cases.record(case, pattern, seed, time_profile=time_profile)
    begun = time.process_time()
    found = probupdate.diagnose(prepared, data, extend=False, seed=seed)
    limits = {
        x.location: x.size
        for x in found.detectable_sizes
        if x.cause in ("parameter", "group of parameters") and x.time_profile == time_profile and np.isfinite(x.size)
    }
    return {
        "case": case.number, "pattern": pattern.number, "seed": seed, "time_profile": time_profile,
            "verdict": found.verdict,
        "judged": judged(found, pattern), "p": found.p_value, "adequacy": found.adequacy_p,
        "threshold": found.threshold,
        "findings": [{"cause": f.cause, "location": f.location, "time_profile": f.time_profile, "size": f.size,
                      "std": f.size_std,
                      "probability": f.posterior_probability, "z": f.z,
                      "alternatives": [a.location for a in f.alternatives]} for f in found.findings],
        "nearest": found.details.get("nearest", []), "notes": list(found.notes), "limits": limits,
        "cpu_s": round(time.process_time() - begun, 2),
    }


def asked(first: int, seeds: int, patterns: dict[int, tuple[int, ...]]):
    """(case, pattern, seed, time profile), all of a seed before the next, so that what is there is a whole table."""
    for seed in range(first, first + seeds):
        for case in CASES:
            for number in patterns.get(case.number, ()):
                for time_profile in ("step", "constant") if number else ("step",):
                    yield case, PATTERNS[number], seed, time_profile


def read_lines(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.is_file() else []


def run_all(out: Path, first: int, seeds: int, *, patterns: list[int] | None = None, simple: bool = False) -> None:
    """cases.jsonl, or simple.jsonl, line by line; of these `patterns` only, if any are given."""
    out.mkdir(parents=True, exist_ok=True)
    model = cache(lambda case: ready(case, out, simple=simple))
    path = out / ("simple.jsonl" if simple else "cases.jsonl")
    done = {(x["case"], x["pattern"], x["seed"], x["time_profile"]) for x in read_lines(path)}
    for case, pattern, seed, time_profile in asked(first, seeds, SIMPLE if simple else ASKED):
        left_out = patterns is not None and pattern.number not in patterns
        if left_out or (case.number, pattern.number, seed, time_profile) in done:
            continue
        line = run_one(model(case), case, pattern, seed, time_profile)
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")


def run_losses(out: Path, seeds: int) -> None:
    """losses.jsonl: one pair of each face of storeys 1 and 4 that loses a part, case 4."""
    out.mkdir(parents=True, exist_ok=True)
    case, path = CASES[3], out / "losses.jsonl"
    prepared = ready(case, out)
    done = {(x["place"], x["loss"], x["seed"], x["time_profile"]) for x in read_lines(path)}
    for seed in range(1, seeds + 1):
        for storey, face in ((1, "x+"), (1, "y-"), (3, "y-"), (4, "x+")):
            for loss in LOSSES:
                for time_profile in ("step", "constant"):
                    if (f"b{storey}{face}", loss, seed, time_profile) in done:
                        continue
                    pattern = Pattern(100 + round(1000 * loss), f"{loss:.0%} of a pair", ((storey, face, None, loss),))
                    line = run_one(prepared, case, pattern, seed, time_profile)
                    line |= {"place": f"b{storey}{face}", "loss": loss}
                    with path.open("a", encoding="utf-8") as file:
                        file.write(json.dumps(line) + "\n")


WORDS = ("right", "in the set", "beside", "part", "wrong", "unexplained", "silent")


def outcomes(lines: list[dict]) -> list[str]:
    """Rows of a table that counts lines of cases.jsonl by case, pattern and time profile."""
    rows = ["| case | pattern | time profile | records | " + " | ".join(WORDS) + " |", "|---" * (4 + len(WORDS)) + "|"]
    for key in sorted({(x["case"], x["pattern"], x["time_profile"]) for x in lines}):
        own = [x for x in lines if (x["case"], x["pattern"], x["time_profile"]) == key]
        counts = [sum(x["judged"] == w for x in own) for w in WORDS]
        rows.append(f"| {key[0]} | {key[1]} {PATTERNS[key[1]].words} | {key[2] if key[1] else '-'} | {len(own)} | "
                    + " | ".join(str(c) for c in counts) + " |")
    return rows


def tables(out: Path) -> str:
    """The outcomes counted, by case, pattern and time profile; the limits stated; sizes; losses."""
    lines = read_lines(out / "cases.jsonl")
    rows = outcomes(lines)
    if simple := read_lines(out / "simple.jsonl"):
        rows += ["", "The shear building given for the frame of 120:", "", *outcomes(simple)]
    rows += ["", "| case | time profile | median stated limit of a pair, storey 1 to 4 | sizes within 2 std |",
             "|---|---|---|---|"]
    for case in CASES:
        for time_profile in ("step", "constant"):
            # of records with nothing hidden, or of all for what is constant
            own = [x for x in lines if x["case"] == case.number and x["time_profile"] == time_profile]
            cells = []
            for s in range(1, 5):
                values = [v for x in own for k, v in x["limits"].items() if k.startswith(f"b{s}")]
                cells.append(f"{np.median(values):.2f}" if values else "-")
            sized = [(f, x) for x in own if x["judged"] == "right" for f in x["findings"]]
            near = sum(abs(f["size"] - true_size(PATTERNS[x["pattern"]], f["location"])) < 2 * f["std"]
                       for f, x in sized)
            rows.append(f"| {case.number} | {time_profile} | {', '.join(cells)} | {near} of {len(sized)} |")
    losses = read_lines(out / "losses.jsonl")
    if losses:
        rows += ["",
                 "| pair of braces, case 4 | time profile | records | " + " | ".join(f"{x:.0%}" for x in LOSSES) + " |",
                 "|---" * (3 + len(LOSSES)) + "|"]
        for key in sorted({(x["place"], x["time_profile"]) for x in losses}):
            own = [x for x in losses if (x["place"], x["time_profile"]) == key]
            cells = []
            for loss in LOSSES:
                part = [x for x in own if x["loss"] == loss]
                cells.append(f"{sum(x['judged'] in ('right', 'in the set') for x in part)} of {len(part)}")
            rows.append(f"| {key[0]} | {key[1]} | {len({x['seed'] for x in own})} | {' | '.join(cells)} |")
    return "\n".join(rows) + "\n"


def true_size(pattern: Pattern, location: str) -> float:
    """Of a pair one brace is half; of a storey's group one is all."""
    for s, face, number, share in pattern.lost:
        if location == f"b{s}{face}":
            return -share * (1.0 if number is None else 0.5)
    return 1.0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--first", type=int, default=1, help="seed")
    parser.add_argument("--seeds", type=int, default=20, help="how many")
    parser.add_argument("--quick", action="store_true", help="one seed")
    parser.add_argument("--patterns", type=int, nargs="*", help="these only")
    parser.add_argument("--simple", action="store_true", help="the shear building given for the frame of 120")
    parser.add_argument("--loss", action="store_true")
    parser.add_argument("--tables", action="store_true")
    a = parser.parse_args()
    seeds = QUICK_SEEDS if a.quick else a.seeds
    if a.loss:
        run_losses(a.out, seeds)
    elif not a.tables:
        run_all(a.out, a.first, seeds, patterns=a.patterns, simple=a.simple)
    sys.stdout.write(tables(a.out))
    return 0


if __name__ == "__main__":
    sys.exit(main())
