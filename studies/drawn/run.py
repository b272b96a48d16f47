"""Every command on drawn structures: one JSON line a case in OUT/cases.jsonl, resumable.

python studies/drawn/run.py OUT [--kinds turbine ...] [--classes null ...] [--first K] [--most N] [--raw EVERY]
                                [--whole EVERY]
python studies/drawn/run.py OUT --tables                    counts what is there
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parents[1] / "tests"), str(HERE.parents[1])]

from drawn import commands  # noqa: E402
from drawn.cases import Case  # noqa: E402
from drawn.hiding import CLASSES  # noqa: E402
from drawn.structures import KINDS  # noqa: E402
from scipy import stats  # noqa: E402

# of a case that is not looked at whole
SHORT = ("modes", "update", "diagnose")


def commit() -> str:
    found = subprocess.run(["git", "describe", "--always", "--dirty"], cwd=HERE, capture_output=True, text=True)
    return found.stdout.strip() or "unknown"


def read_lines(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.is_file() else []


def run_all(out: Path, cases: list[Case], *, raw: int, whole: int) -> None:
    path, at = out / "cases.jsonl", commit()
    out.mkdir(parents=True, exist_ok=True)
    done = {x["id"].removesuffix("-raw") for x in read_lines(path)}
    for number, case in enumerate(cases):
        if case.id in done:
            continue
        folder = out / "case"
        shutil.rmtree(folder, ignore_errors=True)
        every = bool(whole) and number % whole == 0
        line = commands.run_case(case, folder, only=() if every else SHORT, extend=every,
                                 raw=bool(raw) and number % raw == raw - 1) | {"commit": at}
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
        ended = [f"{c['command']} {c['code']}" for c in line["commands"] if c["code"]]
        sys.stdout.write(f"{line['id']}: {line['judged']}{'; ' if ended else ''}{', '.join(ended)}\n")
        sys.stdout.flush()


def rate(hits: int, n: int) -> str:
    """With the 95 % interval of Clopper and Pearson (1934)."""
    if not n:
        return "no case"
    low = stats.beta.ppf(0.025, hits, n - hits + 1) if hits else 0.0
    high = stats.beta.ppf(0.975, hits + 1, n - hits) if hits < n else 1.0
    return f"{hits} of {n} ({100 * low:.0f} to {100 * high:.0f} %)"


def above(line: dict) -> bool:
    hidden = line["hidden"]
    return bool(hidden and hidden["size"] and line.get("limit") and abs(hidden["size"]) >= line["limit"])


def tables(lines: list[dict]) -> str:
    judged = [x for x in lines if x["verdict"]]
    null = [x for x in judged if not x["hidden"]]
    known = [x for x in judged if x["hidden"] and x["hidden"]["right"]]
    seen = [x for x in known if above(x)]
    words = ("right", "in the set", "wrong", "unexplained", "silent")
    ran = [c for x in lines for c in x["commands"]]
    rows = ["| what | rate |", "|---|---|",
            f"| nothing hidden: silent | {rate(sum(x['judged'] == 'silent' for x in null), len(null))} |",
            f"| all records: a wrong name *named* | "
            f"{rate(sum(x['judged'] == 'wrong' and x['verdict'] == 'named' for x in judged), len(judged))} |",
            f"| all records: a wrong name, *ambiguous* ones too | "
            f"{rate(sum(x['judged'] == 'wrong' for x in judged), len(judged))} |",
            f"| above the stated limit: right first or in the set | "
            f"{rate(sum(x['judged'] in words[:2] for x in seen), len(seen))} |",
            f"| commands: exit 0 | {rate(sum(c['code'] == 0 for c in ran), len(ran))} |", "",
            "| structure | hidden | records | " + " | ".join(words) + " | no verdict |",
            "|---" * (4 + len(words)) + "|"]
    for kind, name in sorted({(x["kind"], x["hidden"]["name"] if x["hidden"] else "nothing") for x in lines}):
        own = [x for x in lines if (x["kind"], x["hidden"]["name"] if x["hidden"] else "nothing") == (kind, name)]
        counts = [sum(x["judged"] == w for x in own) for w in (*words, "no diagnosis")]
        rows.append(f"| {kind} | {name} | {len(own)} | " + " | ".join(map(str, counts)) + " |")
    ends = Counter((c["command"], c["code"]) for c in ran if c["code"])
    rows += ["", "| command | exit code | times |", "|---|---|---|"]
    rows += [f"| {command} | {code} | {n} |" for (command, code), n in sorted(ends.items())]
    return "\n".join(rows) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--classes", nargs="+", choices=CLASSES, default=list(CLASSES))
    parser.add_argument("--first", type=int, default=0, help="seed of the first case of each kind and class")
    parser.add_argument("--most", type=int, default=4, help="cases of each kind and class")
    parser.add_argument("--raw", type=int, default=0, help="every so many cases from accelerations")
    parser.add_argument("--whole", type=int, default=6, help="every so many cases by every command, the posterior with "
                        "the findings included; the others by modes, update and diagnose")
    parser.add_argument("--tables", action="store_true", help="count what is there")
    a = parser.parse_args()
    if not a.tables:
        cases = [Case(kind, c, a.first + k) for k in range(a.most) for c in a.classes for kind in a.kinds]
        run_all(a.out, cases, raw=a.raw, whole=a.whole)
    sys.stdout.write(tables(read_lines(a.out / "cases.jsonl")))
    return 0


if __name__ == "__main__":
    sys.exit(main())
