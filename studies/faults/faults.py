"""Faults of the machine over every command that writes: kill -9, two writers, full disk, read-only, no permission, lost
input, SIGTERM and Ctrl-C, a full or closed output, a clock that goes back.

    python studies/faults/faults.py WORK SEED [COMMAND ...]      # goes on where WORK/log.jsonl ends
    python studies/faults/faults.py table WORK/log.jsonl ...     # RESULTS.md beside this file

Inputs are small (a building of 20 storeys with nine sets of modes, eight blocks of a minute, 0.03 to 0.2 virtual days).
Each command is run twice undisturbed; what is the same bytes both times is compared byte for byte afterwards, what is
not (it states when it was made) is read to its end. After each fault the command is given again and must end as an
undisturbed run does. A trial is one line of the log, in rounds over the commands, so that a run that is stopped loses
the trial that it was at; moments are shares of the processor time of an undisturbed run, drawn from (SEED, command,
fault, number), whatever was run before. In the third round the first process killed and those that get a signal are
started as a shell does; else, where the fault allows it, they are forked from one that has imported everything, so that
the moments lie in the command's own work.
"""

from __future__ import annotations

import contextlib
import datetime
import importlib
import json
import os
import platform
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from fault_bench import Bench
from fault_inputs import LONG, LOST, OF_INPUTS, READ_BESIDE, SELDOM, commands, inputs
from fault_processes import OWN_START, clock_runs_back, dies_at_rename
from fault_table import table

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parents[1]
MODULES = ("probupdate.cli", "probupdate.verbs", "probupdate.demonstration", "probupdate.diagnosis.run",
           "probupdate.lifetime.export", "probupdate.reporting.page", "probupdate.updating.ensemble", "arviz",
           "matplotlib.pyplot", "scipy.sparse.linalg", "pandas", "rich.progress")
# round in which processes are started as a shell does
SHELL = 2


def kill(bench: Bench, rng: np.random.Generator, number: int) -> dict:
    """kill -9 at drawn moments, three times at the same place (over a finished result in every second trial), then one
    run to the end. A command that takes long is killed ten times, each time a part further."""
    bench.prepare(finished=number % 2 == 1)
    what = Counter(kills=0, met=0, torn=0, orphans=0)
    names: list[str] = []
    for k in range(10 if bench.slow else 3):
        one = bench.start(shell=number == SHELL and k == 0)
        met = bench.moment(rng, one, 0.03, 0.15) if bench.slow else bench.moment(rng, one)
        what.update(kills=1, met=met)
        one.send(signal.SIGKILL)
        one.ended()
        what["orphans"] += bench.orphans()
        names += bench.torn()
    return {**what, "torn": len(names), "names": names[:5], **bench.again(always=True)}


def kill_at_rename(bench: Bench, rng: np.random.Generator, number: int) -> dict:
    """kill -9 just before or after one of the files takes its place."""
    bench.prepare(finished=number % 2 == 1)
    which, when = int(rng.integers(1, len(bench.wanted) + 1)), ("before", "after")[int(rng.integers(2))]
    ended = bench.run(before=lambda: dies_at_rename(which, when))
    return {"kills": 1, "met": int(ended.code == -signal.SIGKILL), "moment": f"{when} {which}",
            "orphans": bench.orphans(), "torn": len(bench.torn()), **bench.again()}


def two_writers(bench: Bench, rng: np.random.Generator, number: int) -> dict:
    """Two at the same place; one of them killed in every second trial."""
    bench.prepare()
    both = [bench.start()]
    bench.moment(rng, both[0], 0.0, 0.3)
    both.append(bench.start())
    what: dict = {"met": int(both[0].poll() is None), "kills": 0}
    if number % 2 == 0:
        one = both.pop(int(rng.integers(2)))
        what |= {"kills": 1, "met": int(bench.moment(rng, one, 0.3))}
        one.send(signal.SIGKILL)
        one.ended()
    said = [one.ended() for one in both]
    found = [bench.refusal(one) for one in said]
    what |= {key: any(one[key] for one in found) for key in ("traceback", "more_lines", "other_exit")}
    what |= {"refused": sum(one.code != bench.status for one in said),
             "words": " | ".join(one.said[-200:] for one in said if one.code != bench.status),
             "orphans": bench.orphans(), "torn": len(bench.torn())}
    return together(what, bench.again())


def together(first: dict, second: dict) -> dict:
    return {**first, **second, "words": " | ".join(w for w in (first.get("words"), second.get("words")) if w)}


def signalled(kind: signal.Signals) -> Callable:
    def trial(bench: Bench, rng: np.random.Generator, number: int) -> dict:
        bench.prepare()
        one = bench.start(shell=number == SHELL)
        met = bench.moment(rng, one, OWN_START if number == SHELL else 0.0)
        # Ctrl-C goes to all processes of a terminal, SIGTERM to the one that is named
        one.send(kind, group=kind == signal.SIGINT)
        ended = one.ended()
        what = {**bench.refusal(ended), "met": int(met)}
        if met and ended.code not in (130, bench.status):
            what |= {"other_exit": True, "words": f"{ended.code} {ended.said[-400:]}"}
        what |= {"orphans": bench.orphans(), "parts_at_once": parts(bench.out), "torn": len(bench.torn())}
        return together(what, bench.again())

    return trial


def parts(folder: Path) -> int:
    return len(list(folder.rglob("*.part")))


def full_limit(bench: Bench, rng: np.random.Generator, number: int) -> dict:
    """A limit on the size of a file."""
    largest = max((p.stat().st_size for p in bench.finished.rglob("*") if p.is_file()), default=1)
    size = 0 if number == 0 else int(rng.uniform(0.0, 1.0) * largest)
    bench.prepare()
    what = bench.refusal(bench.run(before=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))))
    what |= {"moment": f"{size} B", "torn": len(bench.torn()), "orphans": bench.orphans()}
    return together(what, bench.again())


@contextlib.contextmanager
def mounted(bench: Bench, options: str):
    """The output folder as a file system of its own; False where none can be had here."""
    bench.clear()
    bench.out.mkdir()
    words = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(bench.out)]
    good = subprocess.run(words, capture_output=True).returncode == 0
    try:
        yield good
    finally:
        if good:
            subprocess.run(["umount", str(bench.out)], check=True)
        bench.clear()


def full_disk(bench: Bench, rng: np.random.Generator, number: int) -> dict:
    """A file system with room for a part of the result; then it is given more, and the command again."""
    size = 4096 * max(2, int(rng.uniform(0.0, 0.95) * bench.size / 4096))
    with mounted(bench, f"size={size}") as good:
        if not good:
            return {"skipped": "no file system can be mounted here"}
        with contextlib.suppress(OSError):
            bench.fill()
        what = {**bench.refusal(bench.run()), "moment": f"{size} B", "orphans": bench.orphans()}
        what |= {"parts_at_once": parts(bench.out), "torn": len(bench.torn())}
        subprocess.run(["mount", "-o", "remount,size=2g", str(bench.out)], check=True, capture_output=True)
        if bench.verb == "convert":
            shutil.copy(bench.i / "empty" / "campaign.toml", bench.out / "campaign" / "campaign.toml")
        return together(what, bench.again())


def read_only(bench: Bench, rng: np.random.Generator, number: int) -> dict:
    with mounted(bench, "ro") as good:
        if not good:
            return {"skipped": "no file system can be mounted here"}
        return {**bench.refusal(bench.run()), "orphans": bench.orphans()}


def forbidden(bench: Bench, rng: np.random.Generator, number: int) -> dict:
    """A folder that nothing may be written into, for a user without root's rights to do so all the same; in every
    second trial with a finished result in it."""
    bench.prepare(finished=number % 2 == 1)
    for path in (bench.out, *bench.out.rglob("*")):
        path.chmod(0o555 if path.is_dir() else 0o444)
    what = {**bench.refusal(bench.run(shell=True, rights=False)), "torn": len(bench.torn()), "orphans": bench.orphans()}
    for path in (bench.out, *bench.out.rglob("*")):
        path.chmod(0o755)
    return together(what, bench.again())


def names_lost(bench: Bench) -> list[str]:
    said = " ".join(bench.words).replace(str(bench.out), "")
    return [n for n in LOST if any(f"{bench.i}/{part}" in said for part in (READ_BESIDE.get(n, n), n.split("/")[0]))]


def lost_before(bench: Bench, rng: np.random.Generator, number: int) -> dict:
    """Each input gone before it is asked for."""
    what: Counter = Counter()
    words = ""
    for name in names_lost(bench):
        path, away = bench.i / name, bench.i / "away"
        bench.prepare()
        path.rename(away)
        try:
            found = bench.refusal(bench.run())
        finally:
            away.rename(path)
        words += found.pop("words", "")
        what.update(found | {"tried": 1, "torn": len(bench.torn())})
    return {**what, "words": words, "orphans": bench.orphans()} if what else {"skipped": "reads no file"}


def lost_midway(bench: Bench, rng: np.random.Generator, number: int) -> dict:
    """An input gone at a drawn moment; then it is back, and the command given again."""
    names = names_lost(bench)
    if not names:
        return {"skipped": "reads no file"}
    name = names[int(rng.integers(len(names)))]
    path, away = bench.i / name, bench.i / "away"
    bench.prepare()
    one = bench.start()
    met = bench.moment(rng, one, 0.0)
    path.rename(away)
    try:
        ended = one.ended()
    finally:
        away.rename(path)
    what = {**bench.refusal(ended), "met": int(met), "moment": name, "torn": len(bench.torn()),
            "orphans": bench.orphans()}
    return together(what, bench.again())


def output_full(bench: Bench, rng: np.random.Generator, number: int) -> dict:
    bench.prepare()
    with Path("/dev/full").open("w") as stream:
        ended = bench.run(shell=True, stdout=stream.fileno())
    what = {**bench.refusal(ended), "torn": len(bench.torn()), "orphans": bench.orphans()}
    return together(what, bench.again())


def output_closed(bench: Bench, rng: np.random.Generator, number: int) -> dict:
    bench.prepare()
    what = {**bench.refusal(bench.run(shell=True, before=lambda: os.close(1))), "torn": len(bench.torn()),
            "orphans": bench.orphans()}
    return together(what, bench.again())


def clock_back(bench: Bench, rng: np.random.Generator, number: int) -> dict:
    """The clock goes back while it runs, over results that are dated tomorrow."""
    bench.prepare(finished=True)
    for path in bench.out.rglob("*"):
        os.utime(path, (time.time() + 86400,) * 2)
    what = {**bench.refusal(bench.run(before=clock_runs_back)), "torn": len(bench.torn()), "orphans": bench.orphans()}
    return together(what, bench.again())


# fault -> (trial, how often, of the commands that are tried less often, of the long one)
FAULTS: dict[str, tuple[Callable, int, int, int]] = {
    "kill -9 at a drawn moment": (kill, 4, 2, 1),
    "kill -9 as a file takes its place": (kill_at_rename, 4, 2, 0),
    "two writers": (two_writers, 4, 2, 0),
    "SIGTERM": (signalled(signal.SIGTERM), 3, 1, 1),
    "Ctrl-C": (signalled(signal.SIGINT), 3, 1, 1),
    "full disk (file system)": (full_disk, 3, 1, 1),
    "full disk (limit on file size)": (full_limit, 3, 1, 1),
    "read-only file system": (read_only, 1, 1, 1),
    "no permission": (forbidden, 2, 1, 1),
    "input gone before": (lost_before, 1, 1, 0),
    "input gone midway": (lost_midway, 2, 1, 0),
    "output full": (output_full, 1, 1, 0),
    "output closed": (output_closed, 1, 1, 0),
    "clock goes back": (clock_back, 1, 1, 0),
}


def trials(verbs: list[str]) -> list[tuple[str, str, int]]:
    """(command, fault, number) in rounds; those that are tried less often after the others, the long one last."""
    most = max(often for _, often, *_ in FAULTS.values())
    kind = {verb: 2 if verb == LONG else int(verb in SELDOM) for verb in verbs}
    return [(verb, fault, number) for which in range(3) for number in range(most) for verb in verbs
            if kind[verb] == which for fault, (_, *often) in FAULTS.items() if number < often[which]]


def commit() -> str:
    """Of the checkout, with + where it has changes; '' where it is none."""
    def git(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=REPOSITORY, capture_output=True, text=True).stdout.strip()

    return git("rev-parse", "--short", "HEAD") + ("+" if git("status", "--porcelain", "probupdate") else "")


def run(
    work: Path, seed: int, chosen: Sequence[str], *, faults: Sequence[str] = tuple(FAULTS), rounds: int = 10
) -> None:
    """The trials that WORK/log.jsonl does not have, of the chosen commands (or all), a line each."""
    work = work.resolve()
    if not (work / "whole").exists():
        shutil.rmtree(work / "in", ignore_errors=True)
        inputs(work / "in", of_steps=not set(chosen) or not set(chosen) <= set(OF_INPUTS))
        (work / "in").rename(work / "whole")
    # the trial that was stopped may have taken one away
    shutil.rmtree(work / "in", ignore_errors=True)
    shutil.copytree(work / "whole", work / "in")
    log = work / "log.jsonl"
    lines = [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []
    done = {(one["command"], one["fault"], one["number"]) for one in lines if one["seed"] == seed}
    for name in MODULES if not chosen else MODULES[:2]:
        importlib.import_module(name)
    benches: dict[str, Bench] = {}
    for verb, fault, number in trials(list(chosen) or list(commands(work, work))):
        if (verb, fault, number) in done or fault not in faults or number >= rounds:
            continue
        if verb not in benches:
            benches[verb] = Bench(verb, work)
        bench, begun = benches[verb], time.monotonic()
        rng = np.random.default_rng([seed, number, *verb.encode(), *fault.encode()])
        what = FAULTS[fault][0](bench, rng, number)
        bench.clear()
        kept = {key: value for key, value in what.items() if value or key in ("met", "kills")}
        line = {"command": verb, "fault": fault, "number": number, "seed": seed, "commit": commit(),
                "processor_s": round(bench.processor_s[True], 1), "seconds": round(time.monotonic() - begun, 1),
                **machine(), "what": kept}
        with log.open("a") as stream:
            stream.write(json.dumps(line).replace(str(work), "WORK") + "\n")


def machine() -> dict[str, str]:
    """Its kind, without names."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    return {"date": datetime.datetime.now(datetime.UTC).date().isoformat(),
            "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, {memory:.0f} GB, "
                       f"Python {platform.python_version()}"}


def main() -> None:
    if sys.argv[1] == "table":
        lines = [json.loads(line) for path in sys.argv[2:] for line in Path(path).read_text().splitlines()]
        planned = Counter(verb for verb, _, _ in trials(list(commands(Path("i"), Path("o")))))
        (HERE / "RESULTS.md").write_text(table(lines, FAULTS, planned))
        return
    wanted = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(REPOSITORY)}
    if any(os.environ.get(name) != value for name, value in wanted.items()):
        # read when numpy is first imported
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, **wanted})
    run(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3:])


if __name__ == "__main__":
    main()
