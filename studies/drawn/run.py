"""Every command on drawn structures: one JSON line a case in OUT/cases.jsonl, resumable, each case of bounded time.

python studies/drawn/run.py OUT [--kinds turbine ...] [--classes null ...] [--first K] [--most N] [--minutes M]
                                [--seconds S] [--jobs 1|2] [--update EVERY] [--raw EVERY] [--whole EVERY] [--small]
                                [--commands modes diagnose ...]
python studies/drawn/run.py OUT --tables                    counts what is there
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import resource
import shutil
import subprocess
import sys
import time
from collections import Counter
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parents[1] / "tests"), str(HERE.parents[1])]

from drawn import commands  # noqa: E402
from drawn.cases import Case  # noqa: E402
from drawn.hiding import CLASSES  # noqa: E402
from drawn.structures import KINDS  # noqa: E402
from scipy import stats  # noqa: E402

SHORT = ("modes", "diagnose")
# cases of a class beside one of environment or of an unknown cause: false alarms need the largest number
OFTEN = {"null": 4, "structural": 2, "measurement": 2}
# a case that waits longer than so many times its processor time is ended too
PATIENCE = 20
WORDS = ("silent", "right", "in the set", "ambiguous", "unexplained", "missed, below the limit",
         "missed, above the limit", "wrong", "no verdict", "out of time")


@dataclass(frozen=True, kw_only=True)
class Job:
    """A case, its folder, the commands that are run (none named: all), and the processor time that it has."""

    case: Case
    folder: Path
    only: tuple[str, ...]
    raw: bool
    seconds: int

    @property
    def file(self) -> Path:
        return self.folder.with_suffix(".json")

    @property
    def id(self) -> str:
        return self.case.id + ("-raw" if self.raw else "")


def commit() -> str:
    found = subprocess.run(["git", "describe", "--always", "--dirty"], cwd=HERE, capture_output=True, text=True)
    return found.stdout.strip() or "unknown"


def read_lines(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.is_file() else []


def work(job: Job) -> None:
    """In a process of its own: the line so far is kept, as the processor time may end it anywhere."""
    resource.setrlimit(resource.RLIMIT_CPU, (job.seconds, job.seconds + 2))

    def keep(line: dict) -> None:
        job.file.write_text(json.dumps(line), encoding="utf-8")

    shutil.rmtree(job.folder, ignore_errors=True)
    line = commands.run_case(job.case, job.folder, only=job.only, extend=not job.only, raw=job.raw, after_each=keep)
    used = resource.getrusage(resource.RUSAGE_SELF)
    keep(line | {"cpu_s": round(used.ru_utime + used.ru_stime, 1)})


def line_of(job: Job, ended: BaseProcess) -> dict:
    """What a finished process kept; of one that was ended, `out_of_time` names the command that it was in."""
    line = json.loads(job.file.read_text(encoding="utf-8")) if job.file.is_file() else {
        "id": job.id, "kind": job.case.kind, "class": job.case.hidden_class, "seed": job.case.seed, "hidden": None,
        "commands": [], "running": "the drawing"}
    job.file.unlink(missing_ok=True)
    shutil.rmtree(job.folder, ignore_errors=True)
    if ended.exitcode == 0:
        return line
    where = line.pop("running", "what comes after the commands")
    return line | {"verdict": None, "judged": f"ended with {ended.exitcode}", "out_of_time": where,
                   "cpu_s": float(job.seconds)}


def run_all(out: Path, todo: list[Job], *, jobs: int, minutes: float) -> None:
    path, at, begun = out / "cases.jsonl", commit(), time.monotonic()
    running: list[tuple[Job, BaseProcess, float]] = []
    # what is loaded before it is forked is loaded once; one processor each, so that nothing else runs beside it
    __import__("probupdate").diagnose, __import__("probupdate").update  # noqa: B018
    fork = multiprocessing.get_context("fork")
    while todo or running:
        while todo and len(running) < jobs and time.monotonic() - begun < 60 * minutes:
            job, process = todo[0], fork.Process(target=work, args=(todo[0],))
            process.start()
            running.append((job, process, time.monotonic()))
            del todo[0]
        if not running:
            break
        running[0][1].join(0.05)
        for job, process, started in list(running):
            if process.is_alive():
                if time.monotonic() - started > PATIENCE * job.seconds:
                    process.kill()
                continue
            process.join()
            running.remove((job, process, started))
            line = line_of(job, process) | {"commit": at}
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
            ends = [f"{c['command']} {c['code']}" for c in line["commands"] if c["code"]]
            sys.stdout.write(f"{line['id']}: {', '.join([word_of(line), *ends])} ({line.get('cpu_s', 0):.0f} s)\n")
            sys.stdout.flush()


# tables --------------------------------------------------------------------------------------------------------------


def rate(hits: int, n: int) -> str:
    """With the 95 % interval of Clopper and Pearson (1934)."""
    if not n:
        return "no case"
    low = stats.beta.ppf(0.025, hits, n - hits + 1) if hits else 0.0
    high = stats.beta.ppf(0.975, hits + 1, n - hits) if hits < n else 1.0
    return f"{hits} of {n} ({100 * low:.1f} to {100 * high:.1f} %)"


def above(line: dict) -> bool:
    hidden = line["hidden"]
    return bool(hidden and hidden["size"] and line.get("limit") and abs(hidden["size"]) >= line["limit"])


def word_of(line: dict) -> str:
    """One of WORDS."""
    if "out_of_time" in line:
        return "out of time"
    if not line["verdict"]:
        return "no verdict"
    if line["hidden"] and line["judged"] == "silent":
        return "missed, above the limit" if above(line) else "missed, below the limit"
    return line["judged"]


def tables(lines: list[dict]) -> str:
    judged = [x for x in lines if x["verdict"]]
    null = [x for x in judged if not x["hidden"]]
    known = [x for x in judged if x["hidden"] and x["hidden"]["right"]]
    unknown = [x for x in judged if x["hidden"] and not x["hidden"]["right"]]
    seen, ran = [x for x in known if above(x)], [c for x in lines for c in x["commands"]]

    def share(of: list[dict], *words: str) -> str:
        return rate(sum(word_of(x) in words for x in of), len(of))

    rows = ["| what | rate |", "|---|---|", f"| nothing hidden: silent | {share(null, 'silent')} |",
            f"| all records: a wrong name | {share(judged, 'wrong')} |",
            f"| all records: *ambiguous* without the right one | {share(judged, 'ambiguous')} |",
            f"| above the stated limit: right first or in the set | {share(seen, 'right', 'in the set')} |",
            f"| no row describes it: *unexplained* or silent | "
            f"{share(unknown, 'unexplained', 'missed, below the limit')} |",
            f"| commands: exit 0 | {rate(sum(c['code'] == 0 for c in ran), len(ran))} |",
            f"| cases out of processor time | {rate(sum('out_of_time' in x for x in lines), len(lines))} |", "",
            "| structure | hidden | records | " + " | ".join(WORDS) + " |", "|---" * (3 + len(WORDS)) + "|"]

    def what(line: dict) -> tuple[str, str]:
        hidden = line["hidden"]
        return line["kind"], f"{line['class']}: {hidden['name']}" if hidden else line["class"]

    for kind, name in sorted({what(x) for x in lines}):
        own = Counter(word_of(x) for x in lines if what(x) == (kind, name))
        rows.append(f"| {kind} | {name} | {own.total()} | " + " | ".join(str(own[w] or "") for w in WORDS) + " |")
    rows += ["", "| command | processor time, s: median, 90 %, most |", "|---|---|"]
    for command in dict.fromkeys(c["command"] for c in ran):
        took = sorted(c["cpu_s"] for c in ran if c["command"] == command)
        rows.append(f"| {command} | {took[len(took) // 2]:.1f}, {took[int(0.9 * len(took))]:.1f}, {took[-1]:.1f} |")
    rows += ["", *(f"- {x['id']}: {c['command']} {c['code']}: {c['last']}" for x in lines for c in x["commands"]
                   if c["code"])]
    rows += [f"- {x['id']}: {x['judged']} in {x['out_of_time']}" for x in lines if "out_of_time" in x]
    rows += [f"- {x['id']}: {x['verdict']}, p {x['p']:.3g}: {x['findings'][:1]}" for x in judged
             if word_of(x) in ("wrong", "ambiguous", "missed, above the limit") or x in null and word_of(x) != "silent"]
    return "\n".join(rows) + "\n"


def planned(a: argparse.Namespace) -> list[Job]:
    """In turn, so that whatever is done when a run is stopped is of all kinds and classes."""
    done = {x["id"].removesuffix("-raw") for x in read_lines(a.out / "cases.jsonl")}
    turns = sorted((k / OFTEN.get(c, 1), a.classes.index(c), c, k) for c in a.classes
                   for k in range(a.most * OFTEN.get(c, 1)))
    todo = []
    for number, (c, k, kind) in enumerate((c, k, kind) for _, _, c, k in turns for kind in a.kinds):
        case = Case(kind, c, a.first + k, small=a.small)
        only = () if a.whole and number % a.whole == 0 else (
            *a.commands, *(("update",) if a.update and number % a.update == 0 else ()))
        if case.id not in done:
            todo.append(Job(case=case, folder=a.out / f"case-{case.id}", only=only, seconds=a.seconds,
                            raw=bool(a.raw) and number % a.raw == a.raw - 1))
    return todo


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--classes", nargs="+", choices=CLASSES, default=list(CLASSES))
    parser.add_argument("--first", type=int, default=0, help="seed of the first case of each kind and class")
    parser.add_argument("--most", type=int, default=2, help="cases of each kind of environment and of unknown causes; "
                        f"of others times {OFTEN}")
    parser.add_argument("--minutes", type=float, default=1e9, help="no case begins after these")
    parser.add_argument("--seconds", type=int, default=120, help="processor time of a case, by the system's limit")
    parser.add_argument("--jobs", type=int, choices=(1, 2), default=1)
    parser.add_argument("--small", action="store_true", help="turbines of one or two bays")
    parser.add_argument("--update", type=int, default=0, help="every so many cases by update too")
    parser.add_argument("--raw", type=int, default=0, help="every so many cases from accelerations")
    parser.add_argument("--whole", type=int, default=0, help="every so many cases by every command, the posterior with "
                        "the findings included; the others by --commands")
    parser.add_argument("--commands", nargs="+", default=list(SHORT), help="of a case that is not looked at whole")
    parser.add_argument("--tables", action="store_true", help="count what is there")
    a = parser.parse_args()
    if not a.tables:
        a.out.mkdir(parents=True, exist_ok=True)
        run_all(a.out, planned(a), jobs=a.jobs, minutes=a.minutes)
    sys.stdout.write(tables(read_lines(a.out / "cases.jsonl")))
    return 0


if __name__ == "__main__":
    sys.exit(main())
