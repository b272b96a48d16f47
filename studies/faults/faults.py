"""Faults of the machine over every command that writes: kill -9, two writers, full disk, read-only, no permission, lost
input, SIGTERM and Ctrl-C, a full or closed output, a clock that goes back.

    python studies/faults/faults.py WORK SEED [COMMAND ...]      # goes on where WORK/log.jsonl ends
    python studies/faults/faults.py table WORK/log.jsonl ...     # RESULTS.md beside this file

Inputs are small (a building of 20 storeys with nine sets of modes, eight blocks of a minute, 0.03 to 0.2 virtual days).
Each command is run twice undisturbed; what is the same bytes both times is compared byte for byte afterwards, what is not
(it states when it was made) is read to its end. After each fault the command is given again and must end as an
undisturbed run does. A trial is one line of the log, in rounds over the commands, so that a run that is stopped loses the
trial that it was at; moments are shares of the processor time of an undisturbed run, drawn from (SEED, command, fault,
number), whatever was run before. In the third round the first process killed and those that get a signal are started as a
shell does; else, where the fault allows it, they are forked from one that has imported everything, so that the moments lie
in the command's own work.
"""

from __future__ import annotations

import contextlib
import datetime
import hashlib
import importlib
import io
import json
import os
import platform
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import zipfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parents[1]
sys.path[:0] = [str(REPOSITORY), str(REPOSITORY / "tests" / "commands")]
from command_cases import modes_table, write_building  # noqa: E402

RATE_HZ, SECONDS = 20.0, 480
# enough blocks for two processes
MANY = 84
RIGHTS = "-dac_override,-dac_read_search,-fowner"
WITHOUT_RIGHTS = ["setpriv", f"--bounding-set={RIGHTS}", f"--inh-caps={RIGHTS}"]
MODULES = ("probupdate.cli", "probupdate.verbs", "probupdate.demonstration", "probupdate.diagnosis.run",
           "probupdate.lifetime.export", "probupdate.reporting.page", "probupdate.estimators.ensemble", "arviz",
           "matplotlib.pyplot", "scipy.sparse.linalg", "pandas", "rich.progress")
# a process whose parent was killed has this long to notice it
ORPHAN_S = 10.0
# the command that takes minutes; those that are not tried; those that read nothing of other commands; those that are tried
# less often
LONG = "demo"
UNTRIED = ("farm",)
OF_INPUTS = ("convert", "check", "modes", "select", "update")
SELDOM = ("sample", "sets", "report", "simulate, 2 processes", "identify, 2 processes")
HANGS_S = 900.0
# share of a short process's time in which Python starts, before there is anything of this program
OWN_START = 0.15
# round in which processes are started as a shell does
SHELL = 2


# What the commands read, and their words ------------------------------------------------------------------------------


def inputs(folder: Path, *, of_steps: bool = True) -> None:
    """All that the commands read; without what other commands write where `of_steps` says so."""
    folder.mkdir(parents=True)
    write_building(folder)
    (folder / "nine.json").write_text(json.dumps(modes_table(n_set=9)))
    rng = np.random.default_rng(3)
    size = int(30 * MANY * RATE_HZ)
    motion = np.zeros((size, 3))
    for k in range(3):
        noise, w, decay = rng.standard_normal(size), 0.25 + 0.35 * k, 0.995
        for t in range(2, size):
            motion[t, k] = 2 * decay * np.cos(w) * motion[t - 1, k] - decay**2 * motion[t - 2, k] + noise[t]
    data = motion @ rng.standard_normal((3, 4)) + 0.1 * rng.standard_normal((size, 4))
    head = f'name = "b"\nsampling_rate_hz = {RATE_HZ}\nblock_minutes = 1\n' + "".join(
        f'[[sensor]]\nchannel = "c{k}"\nlevel = "l{k}"\nposition_m = [0.0, 0.0, {3.0 * k + 3}]\n'
        "direction = [1.0, 0.0, 0.0]\n" for k in range(4))  # fmt: skip
    few = data[: int(SECONDS * RATE_HZ)]
    for name, held, text in (("campaign", few, head), ("many", data, head.replace("minutes = 1", "minutes = 0.5")),
                             ("empty", None, head)):  # fmt: skip
        (folder / name).mkdir()
        (folder / name / "campaign.toml").write_text(text)
        if held is not None:
            (folder / name / "acceleration").mkdir()
            with h5py.File(folder / name / "acceleration" / "a.h5", "w") as file:
                made = file.create_dataset("data", data=held.astype(np.float32))
                made.attrs["start"], made.attrs["sampling_rate_hz"] = "2024-01-01T00:00:00Z", RATE_HZ
    (folder / "raw").mkdir()
    for k in range(4):
        np.save(folder / "raw" / f"2024010{k + 1}_000000.npy", few[k * len(few) // 4 : (k + 1) * len(few) // 4])
    (folder / "convert.toml").write_text(
        'files = "*.npy"\nstart_pattern = \'(\\d{8}_\\d{6})\'\nstart_format = "%Y%m%d_%H%M%S"\nzone = "UTC"\n')
    (folder / "run").mkdir()
    for name in ("model.npz", "parameters.toml", "nine.json"):
        shutil.copy(folder / name, folder / "run" / name)
    shutil.copy(folder / "nine.json", folder / "run" / "modes.json")
    if of_steps:
        steps(folder)


def steps(folder: Path) -> None:
    """What commands read that other commands write; enough sets for a regression."""
    rows = modes_table(n_set=30)
    for k, one in enumerate(rows["sets"]):
        one["id"] = f"2026-06-{k + 1:02d}T00:00Z"
    (folder / "thirty.json").write_text(json.dumps(rows))
    problem = ["--model", str(folder / "model.npz"), "--modes", str(folder / "nine.json")]
    sampled = ["--ess", "100", "--max-steps", "400", "--out", str(folder / "run" / "posterior.nc")]
    for words in (["update", *problem, "--out", str(folder / "run" / "update.json")], ["sample", *problem, *sampled],
                  ["identify", str(folder / "campaign"), "--jobs", "1", "--out", str(folder / "identified" / "modes.json")]):
        subprocess.run(command(words), check=True, capture_output=True)


def commands(i: Path, o: Path) -> dict[str, list[str]]:
    """Command -> its words, with inputs in `i` and results in `o`: every verb that writes."""
    problem = ["--model", f"{i}/model.npz", "--modes", f"{i}/nine.json"]
    return {
        "simulate": ["simulate", f"{o}/campaign", "--days", "0.03", "--seed", "3"],
        "convert": ["convert", f"{i}/raw", f"{o}/campaign", "--description", f"{i}/convert.toml"],
        "check": ["check", f"{i}/campaign", "--out", f"{o}/check.json"],
        "identify": ["identify", f"{i}/campaign", "--jobs", "1", "--out", f"{o}/modes.json"],
        "modes": ["modes", f"{i}/model.npz", "--out", f"{o}/own.json"],
        "select": ["select", f"{i}/nine.json", "--out", f"{o}/selected.json"],
        "regress": ["regress", f"{i}/thirty.json", "--covariates", "water_level_m", "--out", f"{o}/regression.csv"],
        "update": ["update", *problem, "--out", f"{o}/update.json"],
        "sample": ["sample", *problem, "--ess", "100", "--max-steps", "400", "--out", f"{o}/posterior.nc"],
        "compare": ["compare", f"{i}/run/update.json", f"{i}/run/posterior.nc", "--out", f"{o}/compare.json"],
        "sets": ["sets", *problem, "--out", f"{o}/sets.json"],
        "inform": ["inform", *problem, "--out", f"{o}/information.json"],
        "diagnose": ["diagnose", *problem, "--no-extend", "--no-sampler", "--out", f"{o}/diagnosis.json"],
        "figures": ["figures", f"{i}/identified/modes.json", "--out", f"{o}/figures"],
        "export": ["export", f"{i}/run", "--to", "lifetime", f"{o}/lifetime", "--draws", "5", "--accept"],
        "report": ["report", f"{i}/run", "--out", f"{o}/report.html"],
        "simulate, 2 processes": ["simulate", f"{o}/campaign", "--days", "0.1", "--seed", "4", "--jobs", "2"],
        "identify, 2 processes": ["identify", f"{i}/many", "--jobs", "2", "--out", f"{o}/modes.json"],
        "demo": ["demo", f"{o}/demo", "--days", "0.2", "--hide", "none"],
    }  # fmt: skip


# inputs one by one, for those commands whose words name them or what they lie in
LOST = ("nine.json", "model.npz", "parameters.toml", "convert.toml", "campaign/campaign.toml",
        "campaign/acceleration/a.h5", "raw/20240102_000000.npy", "run/posterior.nc", "run/update.json", "run/model.npz",
        "thirty.json", "identified/modes.json")  # fmt: skip
READ_BESIDE = {"parameters.toml": "model.npz"}


def command(words: list[str]) -> list[str]:
    return [sys.executable, "-m", "probupdate", *words]


# Files ----------------------------------------------------------------------------------------------------------------


def digest(folder: Path) -> dict[str, str]:
    """File -> SHA-256 of what it holds; without temporary files."""
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest()
            for p in sorted(folder.rglob("*")) if p.is_file() and not p.name.endswith(".part")}  # fmt: skip


def is_whole(path: Path) -> bool:
    """Whether a file that differs from the undisturbed one reads to its end."""
    try:
        if path.suffix == ".npz":
            # numpy leaves a file open that is no archive
            with np.load(io.BytesIO(path.read_bytes())) as held:
                return all(held[name] is not None for name in held.files)
        if path.suffix in (".h5", ".nc"):
            with h5py.File(path) as file:
                file.visititems(lambda _, one: one[()] if isinstance(one, h5py.Dataset) else None)
            return True
        if path.suffix == ".json":
            return json.loads(path.read_text()) is not None
        if path.suffix == ".html":
            return path.read_text().rstrip().endswith("</html>")
        if path.suffix == ".png":
            return path.read_bytes().endswith(b"IEND\xaeB`\x82")
        return path.suffix == ".csv" and path.read_text().endswith("\n")
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return False


class Bench:
    """One command: its folder, its undisturbed result, and the judgement of what a fault left."""

    def __init__(self, verb: str, work: Path):
        self.verb, self.i, self.place = verb, work / "in", work / verb
        self.out, self.finished, self.temporary = (self.place / n for n in ("out", "finished", "tmp"))
        self.words = commands(self.i, self.out)[verb]
        self.temporary.mkdir(parents=True, exist_ok=True)
        self.sessions: list[int] = []
        known = self.place / "undisturbed.json"
        if not known.exists():
            first, one = self._undisturbed(shell=True)
            second, two = (first, one) if verb == LONG else self._undisturbed(shell=False)
            # run once only: pages and posteriors state when they were made
            steady = [name for name in first if first[name] == second.get(name)
                      and not (one is two and name.endswith((".nc", ".html")))]
            known.write_text(json.dumps({"wanted": first, "steady": steady, "status": two.code,
                                         "processor_s": {"True": one.processor_s, "False": two.processor_s}}))
        found = json.loads(known.read_text())
        self.wanted, self.steady, self.status = found["wanted"], set(found["steady"]), found["status"]
        self.processor_s = {kind == "True": value for kind, value in found["processor_s"].items()}
        self.slow = verb == LONG
        self.several = self.slow or "2 processes" in verb
        self.size = sum(p.stat().st_size for p in self.finished.rglob("*") if p.is_file())

    def _undisturbed(self, shell: bool) -> tuple[dict[str, str], Ended]:
        self.prepare()
        ended = self.run(shell=shell)
        found = digest(self.out)
        if ended.code or not found:
            raise SystemExit(f"{self.verb}: {ended.code} {ended.said[-400:]}")
        shutil.rmtree(self.finished, ignore_errors=True)
        shutil.copytree(self.out, self.finished)
        self.clear()
        return found, ended

    def moment(
        self, rng: np.random.Generator, one: Shell | Forked, lowest: float = 0.05, highest: float = 0.98
    ) -> bool:
        """Waits until a drawn share of an undisturbed run's processor time is used; whether it still runs then."""
        wanted = rng.uniform(lowest, highest) * self.processor_s[isinstance(one, Shell)]
        return self.reached(one, wanted)

    def reached(self, one: Shell | Forked, wanted_s: float) -> bool:
        end = time.monotonic() + HANGS_S
        while one.poll() is None and time.monotonic() < end:
            with contextlib.suppress(OSError):
                if sum(map(processor_s, of_sessions([one.pid]) if self.several else [one.pid])) >= wanted_s:
                    break
            time.sleep(0.02 if self.several else 0.001)
        return one.poll() is None

    def prepare(self, finished: bool = False) -> None:
        """An output folder as before the first run, or as after one; an export goes into a new folder only."""
        self.clear()
        if finished and self.verb != "export":
            shutil.copytree(self.finished, self.out)
            return
        self.out.mkdir()
        self.fill()

    def fill(self) -> None:
        if self.verb == "convert" and not (self.out / "campaign").exists():
            shutil.copytree(self.i / "empty", self.out / "campaign")

    def clear(self) -> None:
        shutil.rmtree(self.out, ignore_errors=True)
        shutil.rmtree(self.temporary, ignore_errors=True)
        self.temporary.mkdir()

    def start(self, *, shell: bool = False, rights: bool = True, stdout: int | None = None,
              before: Callable[[], object] = lambda: None) -> Shell | Forked:  # fmt: skip
        """The command in a session of its own; `before` is called in the new process."""
        self.running = (Shell if shell else Forked)(self.words, self.temporary, rights, stdout, before)
        self.sessions.append(self.running.pid)
        return self.running

    def run(self, **options) -> Ended:
        return self.start(**options).ended()

    def torn(self) -> list[str]:
        """Files that are neither those of an undisturbed run nor whole ones (how far a command is, when it was made)."""
        found = digest(self.out)
        return [name for name, text in found.items()
                if not (name in self.steady and text == self.wanted[name]) and not is_whole(self.out / name)]

    def again(self, always: bool = False) -> dict:
        """The command once more, undisturbed: whether it ends as it should, what it leaves. Not of commands that take
        long, but where `always` says so."""
        if self.slow and not always:
            return {}
        if self.verb == "export":
            # an export goes into a new or empty folder, and says so
            shutil.rmtree(self.out / "lifetime", ignore_errors=True)
        self.fill()
        ended = self.run()
        found = digest(self.out)
        differ = sorted({name for name in self.wanted.keys() | found.keys()
                         if (name in self.wanted) != (name in found)
                         or (name in self.steady and found[name] != self.wanted[name])})  # fmt: skip
        parts = [p.name for p in self.out.rglob("*.part")]
        what = {"again_differs": ended.code != self.status or bool(differ), "parts_left": len(parts),
                "temporary_left": len(list(self.temporary.iterdir()))}  # fmt: skip
        if what["again_differs"] or parts:
            what["words"] = f"{ended.code} {ended.said[-300:]} {differ[:5]} {parts[:3]}"
        return what

    def orphans(self) -> int:
        """Processes that this command's started and that are still there; they are ended."""
        end, left = time.monotonic() + ORPHAN_S, of_sessions(self.sessions)
        while left and time.monotonic() < end:
            time.sleep(0.05)
            left = of_sessions(self.sessions)
        for number in left:
            with contextlib.suppress(OSError):
                os.kill(number, signal.SIGKILL)
        self.sessions.clear()
        return len(left)

    def refusal(self, ended: Ended) -> dict:
        """What a command that met a fault said."""
        lines = [w for w in ended.said.splitlines() if w and not w.startswith("  ")]
        what = {"ended_well": ended.code == self.status, "traceback": "Traceback" in ended.said,
                "more_lines": len(lines) > 1, "other_exit": ended.code not in (self.status, 1, 2, 130)}  # fmt: skip
        if what["traceback"] or what["more_lines"] or what["other_exit"]:
            what["words"] = f"{ended.code} {ended.said[-400:]}"
        return what


# Processes ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Ended:
    """code: as of subprocess, negative for a signal. said: standard error. processor_s: of it and what it waited for."""

    code: int
    said: str
    processor_s: float


class _Process:
    """A process in a session of its own; its standard error is a pipe, read when it has ended."""

    pid: int
    _status: tuple[int, float] | None = None

    def __init__(self):
        self._error, self._to = os.pipe()

    def poll(self, wait: bool = False) -> int | None:
        if self._status is None:
            number, status, used = os.wait4(self.pid, 0 if wait else os.WNOHANG)
            if number:
                self._status = os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime
        return None if self._status is None else self._status[0]

    def send(self, number: int, group: bool = False) -> None:
        if self.poll() is None:
            with contextlib.suppress(OSError):
                (os.killpg if group else os.kill)(self.pid, number)

    def ended(self) -> Ended:
        end, hung = time.monotonic() + HANGS_S, False
        while self.poll() is None:
            if time.monotonic() > end:
                hung = True
                self.send(signal.SIGKILL)
            time.sleep(0.005)
        # an orphan would hold it open
        os.set_blocking(self._error, False)
        said = b""
        with contextlib.suppress(BlockingIOError):
            while more := os.read(self._error, 2**16):
                said += more
        os.close(self._error)
        words = said.decode(errors="replace") + f"Traceback: not ended after {HANGS_S:.0f} s" * hung
        return Ended(self._status[0], words, self._status[1])


class Shell(_Process):
    """As a shell starts it."""

    def __init__(self, words: list[str], temporary: Path, rights: bool, stdout: int | None, before: Callable):
        super().__init__()
        without = WITHOUT_RIGHTS if not rights and os.getuid() == 0 else []
        one = subprocess.Popen(
            [*without, *command(words)], stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL if stdout is None else stdout, stderr=self._to, env={**os.environ, "TMPDIR": str(temporary)}, start_new_session=True,
            preexec_fn=lambda: (signal.signal(signal.SIGINT, signal.default_int_handler), before()))  # fmt: skip
        os.close(self._to)
        # asked about here, with the time that it used
        self.pid, one.returncode = one.pid, 0


class Forked(_Process):
    """Forked from this process, which has imported what the commands import and done nothing with it."""

    def __init__(self, words: list[str], temporary: Path, rights: bool, stdout: int | None, before: Callable):
        super().__init__()
        self.pid = os.fork()
        if self.pid:
            os.close(self._to)
            return
        code = 1
        try:
            os.setsid()
            signal.signal(signal.SIGINT, signal.default_int_handler)
            nowhere = os.open(os.devnull, os.O_RDWR)
            for number, to in ((0, nowhere), (1, nowhere if stdout is None else stdout), (2, self._to)):
                os.dup2(to, number)
            sys.stdout, sys.stderr = open(1, "w", closefd=False), open(2, "w", closefd=False)  # noqa: SIM115
            os.environ["TMPDIR"] = tempfile.tempdir = str(temporary)
            before()
            sys.argv = ["probupdate", *words]
            code = importlib.import_module("probupdate.__main__").main()
        except SystemExit as end:
            code = end.code or 0
        except BaseException:
            traceback.print_exc()
        finally:
            with contextlib.suppress(OSError, ValueError):
                sys.stdout.flush()
                sys.stderr.flush()
            os._exit(code)


def processor_s(process: int) -> float:
    """Processor time of a running process, all its threads (Linux: its own clock). Raises OSError where it has gone."""
    return time.clock_gettime((~process << 3) | 2)


def of_sessions(sessions: list[int]) -> list[int]:
    """Living processes of these sessions."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with contextlib.suppress(OSError, IndexError):
                fields = (entry / "stat").read_text(errors="replace").rpartition(")")[2].split()
                # a session's number is that of its first process
                if fields[0] not in "ZX" and int(fields[3]) in sessions:
                    found.append(int(entry.name))
    return found


def clock_runs_back() -> None:
    """By an hour each time it is asked."""
    last = [time.time()]

    def earlier() -> float:
        last[0] -= 3600.0
        return last[0]

    time.time = earlier


def dies_at_rename(number: int, when: str) -> None:
    """kill -9 by itself, just before or after the n-th file takes its place."""
    replace, seen = os.replace, [0]

    def renamed(*names, **options) -> None:
        seen[0] += 1
        if seen[0] == number and when == "before":
            os.kill(os.getpid(), signal.SIGKILL)
        replace(*names, **options)
        if seen[0] == number:
            os.kill(os.getpid(), signal.SIGKILL)

    os.replace = renamed


# The faults: each takes a bench and a generator, and says what happened ------------------------------------------------


def kill(bench: Bench, rng: np.random.Generator, number: int) -> dict:
    """kill -9 at drawn moments, three times at the same place (over a finished result in every second trial), then one
    run to the end. A command that takes long is killed ten times, each time a part further."""
    bench.prepare(finished=number % 2 == 1)
    what = Counter(kills=0, met=0, torn=0, orphans=0)
    names: list[str] = []
    for k in range(10 if bench.slow else 3):
        if bench.verb == "export":
            shutil.rmtree(bench.out / "lifetime", ignore_errors=True)
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
            "orphans": bench.orphans(), "torn": len(bench.torn()), **bench.again()}  # fmt: skip


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
             "orphans": bench.orphans(), "torn": len(bench.torn())}  # fmt: skip
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
    """A folder that nothing may be written into, for a user without root's rights to do so all the same; in every second
    trial with a finished result in it."""
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
            "orphans": bench.orphans()}  # fmt: skip
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
            "orphans": bench.orphans()}  # fmt: skip
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
    return [(verb, fault, number) for which in range(3) for number in range(most) for verb in verbs if kind[verb] == which
            for fault, (_, *often) in FAULTS.items() if number < often[which]]  # fmt: skip


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
                **machine(), "what": kept}  # fmt: skip
        with log.open("a") as stream:
            stream.write(json.dumps(line).replace(str(work), "WORK") + "\n")


def machine() -> dict[str, str]:
    """Its kind, without names."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    return {"date": datetime.datetime.now(datetime.UTC).date().isoformat(),
            "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, {memory:.0f} GB, "
                       f"Python {platform.python_version()}"}  # fmt: skip


# The table ------------------------------------------------------------------------------------------------------------

BAD = ("torn", "again_differs", "parts_left", "orphans", "traceback", "more_lines", "other_exit")


def table(lines_of: list[dict]) -> str:
    """RESULTS.md of the lines that runs wrote."""
    skipped = Counter(one["command"] for one in lines_of if "skipped" in one["what"])
    lines_of = [one for one in lines_of if "skipped" not in one["what"]]

    def total(chosen: list[dict], key: str) -> int:
        return sum(int(one["what"].get(key, 0)) for one in chosen)

    def distinct(key: str) -> str:
        return ", ".join(dict.fromkeys(str(one[key]) for one in lines_of))

    verbs = list(dict.fromkeys(one["command"] for one in lines_of))
    kills = total(lines_of, "kills")
    met = sum(one["what"].get("met", 0) for one in lines_of if one["what"].get("kills"))
    out = [
        "# Faults of the machine", "",
        f"Written by `studies/faults/faults.py`: commit {distinct('commit')}; seed {distinct('seed')};",
        f"{distinct('date')}; {distinct('machine')}.", "",
        f"{len(lines_of)} trials over {len(verbs)} commands, {kills} kills, of which {met} met a running command (others "
        "came after its end).",
        "A file is torn if it is neither absent, nor byte for byte that of an undisturbed run, nor (for files that state",
        "when they were made or how far a command is) a whole one. After each fault the command is given again; its files",
        "are compared with those of an undisturbed run. `refused` counts the second of two writers that ended with one",
        "line because of the first.", "",
        "| fault | commands | trials | kills | met a running command | torn files | differs when given again | `*.part` "
        "left after that | orphan processes | tracebacks | more than one line | another exit code | refused |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|"]  # fmt: skip
    for fault in FAULTS:
        mine = [one for one in lines_of if one["fault"] == fault]
        if not mine:
            continue
        cells = [len({one["command"] for one in mine}), sum(one["what"].get("tried", 1) for one in mine),
                 total(mine, "kills") or "-", total(mine, "met") if any("met" in one["what"] for one in mine) else "-",
                 *(total(mine, key) for key in BAD), total(mine, "refused") or "-"]  # fmt: skip
        out.append(f"| {fault} | " + " | ".join(map(str, cells)) + " |")
    out += ["", "| command | processor time undisturbed, s | trials | kills that met it | trials with a fault of ours |",
            "|---|---|---|---|---|"]  # fmt: skip
    for verb in verbs:
        mine = [one for one in lines_of if one["command"] == verb]
        bad = sum(any(one["what"].get(key) for key in BAD) for one in mine)
        met = sum(one["what"].get("met", 0) for one in mine if one["what"].get("kills"))
        out.append(f"| {verb} | {mine[-1]['processor_s']:g} | {len(mine)} | {met} | {bad} |")
    planned = Counter(verb for verb, _, _ in trials(list(commands(Path("i"), Path("o")))))
    short = [f"{verb} {sum(one['command'] == verb for one in lines_of)} of {number}" for verb, number in planned.items()
             if sum(one["command"] == verb for one in lines_of) + skipped[verb] < number]  # fmt: skip
    out += ["", f"Trials that were not reached (done, of planned): {', '.join(short) or 'none'}.",
            f"Commands that are not tried: {', '.join(UNTRIED) or 'none'}."]  # fmt: skip
    out += ["", "## Trials with a torn file, a difference, something left, a trace, more lines or another exit code", ""]
    for one in lines_of:
        found = {key: one["what"][key] for key in BAD if one["what"].get(key)}
        if found:
            words = " ".join(str(one["what"].get("words", "")).split())[-160:].replace("`", "'").replace("|", "/")
            out.append(f"- {one['command']}, {one['fault']} {one['number']} (commit {one['commit']}): "
                       + ", ".join(f"{k} {int(v)}" for k, v in found.items()) + (f": `{words}`" if words else ""))  # fmt: skip
    if out[-1] == "":
        out.append("None.")
    return "\n".join(out) + "\n"


def main() -> None:
    if sys.argv[1] == "table":
        lines = [json.loads(line) for path in sys.argv[2:] for line in Path(path).read_text().splitlines()]
        (HERE / "RESULTS.md").write_text(table(lines))
        return
    wanted = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(REPOSITORY)}
    if any(os.environ.get(name) != value for name, value in wanted.items()):
        # read when numpy is first imported
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, **wanted})
    run(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3:])


if __name__ == "__main__":
    main()
