"""Faults of the machine over every command that writes: kill -9, two writers, full disk, read-only, no permission, lost
input, SIGTERM and Ctrl-C, a clock that goes back.

    python studies/faults/faults.py KILLS SEED [COMMAND ...] >> lines.jsonl
    python studies/faults/faults.py table lines.jsonl

Inputs are small (a building of 20 storeys with nine sets of modes, eight blocks of a minute, 0.05 virtual days). After
each fault the files that are there must be whole: those of an undisturbed run, byte for byte, or not there; the command
given again must end as an undisturbed run does, and no temporary file may be left. A line of JSON a command; `table` writes
RESULTS.md of them beside this file.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import h5py
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "commands"))
from command_cases import modes_table, write_building  # noqa: E402

HERE = Path(__file__).resolve().parent
RATE_HZ, SECONDS = 20.0, 480
RIGHTS = "-dac_override,-dac_read_search,-fowner"
WITHOUT_RIGHTS = ["setpriv", f"--bounding-set={RIGHTS}", f"--inh-caps={RIGHTS}"]
# a clock that goes back by an hour each time it is asked
BACK = ("import sys, time; told = [time.time()]\n"
        "def back(): told[0] -= 3600.0; return told[0]\n"
        "time.time = back; from probupdate.cli import main; sys.exit(main(sys.argv[1:]))")


def inputs(folder: Path) -> None:
    """All that the commands read."""
    folder.mkdir(parents=True)
    write_building(folder)
    (folder / "nine.json").write_text(json.dumps(modes_table(n_set=9)))
    rng = np.random.default_rng(3)
    size = int(SECONDS * RATE_HZ)
    motion = np.zeros((size, 3))
    for k in range(3):
        noise, w, decay = rng.standard_normal(size), 0.25 + 0.35 * k, 0.995
        for t in range(2, size):
            motion[t, k] = 2 * decay * np.cos(w) * motion[t - 1, k] - decay**2 * motion[t - 2, k] + noise[t]
    data = motion @ rng.standard_normal((3, 4)) + 0.1 * rng.standard_normal((size, 4))
    head = f'name = "b"\nsampling_rate_hz = {RATE_HZ}\nblock_minutes = 1\n' + "".join(
        f'[[sensor]]\nchannel = "c{k}"\nlevel = "l{k}"\nposition_m = [0.0, 0.0, {3.0 * k + 3}]\ndirection = [1.0, 0.0, 0.0]\n'
        for k in range(4))  # fmt: skip
    for name in ("campaign", "empty"):
        (folder / name).mkdir()
        (folder / name / "campaign.toml").write_text(head)
    (folder / "campaign" / "acceleration").mkdir()
    with h5py.File(folder / "campaign" / "acceleration" / "a.h5", "w") as file:
        held = file.create_dataset("data", data=data.astype(np.float32))
        held.attrs["start"], held.attrs["sampling_rate_hz"] = "2024-01-01T00:00:00Z", RATE_HZ
    (folder / "raw").mkdir()
    for k in range(4):
        np.save(folder / "raw" / f"{k}.npy", data[k * size // 4 : (k + 1) * size // 4])
        (folder / "raw" / f"{k}.npy").rename(folder / "raw" / f"2024010{k + 1}_000000.npy")
    (folder / "convert.toml").write_text(
        'files = "*.npy"\nstart_pattern = \'(\\d{8}_\\d{6})\'\nstart_format = "%Y%m%d_%H%M%S"\nzone = "UTC"\n')
    (folder / "run").mkdir()
    for name in ("model.npz", "parameters.toml"):
        shutil.copy(folder / name, folder / "run" / name)
    shutil.copy(folder / "nine.json", folder / "run" / "nine.json")
    shutil.copy(folder / "nine.json", folder / "run" / "modes.json")
    problem = ["--model", str(folder / "model.npz"), "--modes", str(folder / "nine.json")]
    for words in (["update", *problem, "--out", str(folder / "run" / "update.json")],
                  ["sample", *problem, "--ess", "100", "--max-steps", "400", "--out", str(folder / "run" / "posterior.nc")]):
        subprocess.run(command(words), check=True, capture_output=True)


def commands(i: Path, o: Path) -> dict[str, list[str]]:
    """Command -> its words, with inputs in `i` and results in `o`."""
    problem = ["--model", f"{i}/model.npz", "--modes", f"{i}/nine.json"]
    return {
        "simulate": ["simulate", f"{o}/campaign", "--days", "0.05", "--seed", "3"],
        "convert": ["convert", f"{i}/raw", f"{o}/campaign", "--description", f"{i}/convert.toml"],
        "check": ["check", f"{i}/campaign", "--out", f"{o}/check.json"],
        "identify": ["identify", f"{i}/campaign", "--jobs", "1", "--out", f"{o}/modes.json"],
        "modes": ["modes", f"{i}/model.npz", "--out", f"{o}/own.json"],
        "select": ["select", f"{i}/nine.json", "--out", f"{o}/selected.json"],
        "regress": ["regress", f"{i}/nine.json", "--covariates", "water_level_m", "--out", f"{o}/regression.csv"],
        "update": ["update", *problem, "--out", f"{o}/update.json"],
        "sample": ["sample", *problem, "--ess", "100", "--max-steps", "400", "--out", f"{o}/posterior.nc"],
        "compare": ["compare", f"{i}/run/update.json", f"{i}/run/posterior.nc", "--out", f"{o}/compare.json"],
        "sets": ["sets", *problem, "--out", f"{o}/sets.json"],
        "inform": ["inform", *problem, "--out", f"{o}/information.json"],
        "diagnose": ["diagnose", *problem, "--no-extend", "--no-sampler", "--out", f"{o}/diagnosis.json"],
        "figures": ["figures", f"{i}/nine.json", "--out", f"{o}/figures"],
        "export": ["export", f"{i}/run", "--to", "lifetime", f"{o}/lifetime", "--draws", "5", "--accept"],
        "report": ["report", f"{i}/run", "--out", f"{o}/report.html"],
    }  # fmt: skip


def command(words: list[str], back: bool = False) -> list[str]:
    return [sys.executable, *(["-c", BACK] if back else ["-m", "probupdate.cli"]), *words]


def prepared(out: Path, i: Path, verb: str) -> None:
    out.mkdir(parents=True, exist_ok=True)
    if verb == "convert" and not (out / "campaign").exists():
        shutil.copytree(i / "empty", out / "campaign")


def digest(folder: Path, steady: set[str] | None = None) -> dict[str, str]:
    """File -> what it holds; of files that state when they were made only that they are there."""
    return {p.relative_to(folder).as_posix(): "" if steady is not None and p.relative_to(folder).as_posix() not in steady
            else hashlib.sha256(p.read_bytes()).hexdigest()
            for p in sorted(folder.rglob("*")) if p.is_file() and not p.name.endswith(".part")}  # fmt: skip


def is_whole(path: Path) -> bool:
    """Whether a file that differs from the undisturbed one reads to its end."""
    try:
        if path.suffix == ".npz":
            with np.load(path) as held:
                return all(held[name] is not None for name in held.files)
        if path.suffix in (".h5", ".nc"):
            with h5py.File(path) as file:
                file.visititems(lambda _, one: one[()] if isinstance(one, h5py.Dataset) else None)
            return True
        return path.suffix == ".json" and json.loads(path.read_text()) is not None
    except (OSError, ValueError, KeyError):
        return False


class Tried:
    """One command: its undisturbed result, and what happened under each fault."""

    def __init__(self, verb: str, i: Path, place: Path, rng: np.random.Generator):
        self.verb, self.i, self.place, self.rng = verb, i, place, rng
        first, _, _ = self._undisturbed("first")
        # the first has read everything from the disk
        second, self.lasts, self.status = self._undisturbed("second")
        # what differs between two undisturbed runs states its time: there, but not compared
        self.steady = {name for name in first if first[name] == second.get(name)}
        self.wanted = {name: text if name in self.steady else "" for name, text in first.items()}
        self.counts: dict[str, Counter] = {}

    def _undisturbed(self, name: str):
        out, begun = self.place / name, time.monotonic()
        prepared(out, self.i, self.verb)
        ended = subprocess.run(command(self.words(out)), capture_output=True, text=True)
        if ended.returncode not in (0, 2) or (ended.returncode == 2 and "Traceback" in ended.stderr):
            raise SystemExit(f"{self.verb}: {ended.stderr[-400:]}")
        found, lasts = digest(out), time.monotonic() - begun
        shutil.rmtree(out)
        return found, lasts, ended.returncode

    def words(self, out: Path) -> list[str]:
        return commands(self.i, out)[self.verb]

    def note(self, fault: str, **what: bool) -> None:
        counter = self.counts.setdefault(fault, Counter())
        counter["tried"] += 1
        for name, happened in what.items():
            counter[name] += bool(happened)

    def judged(self, fault: str, out: Path, again: bool = True, **what: bool) -> None:
        """Files that are no part of the undisturbed result, or not whole; then, with the command again, what differs."""
        other = [name for name, text in digest(out, self.steady).items() if text != self.wanted.get(name)]
        # where a command notes how far it is, a file differs until it is done; but it is a whole one
        torn = [name for name in other if not is_whole(out / name)]
        if torn and os.environ.get("SHOW"):
            sys.stderr.write(f"{self.verb} {fault}: differs {torn}\n")
        self.note(fault, torn=bool(torn), intermediate=bool(other), **what)
        if again:
            self.again(fault, out)

    def again(self, fault: str, out: Path) -> None:
        if self.verb == "export" and out.exists():
            # an export goes into a new or empty folder
            shutil.rmtree(out / "lifetime", ignore_errors=True)
        ended = subprocess.run(command(self.words(out)), capture_output=True, text=True)
        counter = self.counts.setdefault(fault, Counter())
        counter["again differs"] += ended.returncode != self.status or digest(out, self.steady) != self.wanted
        counter["parts left"] += len(list(out.rglob("*.part")))
        if counter["again differs"] and os.environ.get("SHOW"):
            sys.stderr.write(f"{self.verb} {fault}: {ended.returncode} {ended.stderr[-300:]}\n")

    # The faults ----------------------------------------------------------------------------------------------------

    def kill(self, number: int) -> None:
        """kill -9 again and again at the same place, then one run to the end; every fourth with a second writer."""
        out = self.place / "killed"
        prepared(out, self.i, self.verb)
        for k in range(number):
            if self.verb == "export":
                shutil.rmtree(out / "lifetime", ignore_errors=True)
            two = k % 4 == 3 and self.verb != "export"
            running = [self._start(out) for _ in range(1 + two)]
            time.sleep(self.rng.uniform(0.3 * self.lasts, 1.05 * self.lasts))
            met = running[0].poll() is None
            running[0].kill()
            running[0].communicate()
            if two:
                said = running[1].communicate()[1]
                # the other goes on; one of two that find the other's unfinished work may refuse it in one line
                self.note("two writers, one killed", met=met, refused=running[1].returncode not in (0, self.status),
                          traceback="Traceback" in said)  # fmt: skip
            self.judged("kill -9", out, again=False, met=met)
        self.again("kill -9", out)
        shutil.rmtree(out)

    def _start(self, out: Path, as_others: bool = False, **options) -> subprocess.Popen:
        before = WITHOUT_RIGHTS if as_others and os.getuid() == 0 else []
        return subprocess.Popen([*before, *command(self.words(out))], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
                                **options)  # fmt: skip

    def signalled(self, kind: signal.Signals) -> None:
        out = self.place / kind.name
        prepared(out, self.i, self.verb)
        one = self._start(out, preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler))
        # the first part is Python's own start, before there is anything of this program
        time.sleep(self.rng.uniform(0.6, 0.95) * self.lasts)
        met = one.poll() is None
        one.send_signal(kind)
        said = [w for w in one.communicate()[1].splitlines() if w and not w.startswith("  ")]
        self.judged(kind.name, out, met=met, other_exit=met and one.returncode not in (130, self.status),
                    more_lines=len(said) > 1)  # fmt: skip
        shutil.rmtree(out)

    def full(self, size: int, kind: str) -> None:
        """A limit on the size of a file, or a file system of so many bytes."""
        out = self.place / "full"
        out.mkdir()
        mounted = kind == "tmpfs" and subprocess.run(
            ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(out)], capture_output=True).returncode == 0
        if kind == "tmpfs" and not mounted:
            out.rmdir()
            return
        try:
            with contextlib.suppress(OSError):
                prepared(out, self.i, self.verb)
            limit = None if mounted else (lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size)))
            self._refused(f"full disk ({kind})", out, preexec_fn=limit)
            parts = len(list(out.rglob("*.part")))
        finally:
            if mounted:
                subprocess.run(["umount", str(out)], check=True)
        self.counts[f"full disk ({kind})"]["parts left"] += parts
        if not mounted:
            self.again(f"full disk ({kind})", out)
        shutil.rmtree(out)

    def _refused(self, fault: str, out: Path, **options) -> None:
        one = self._start(out, **options)
        said = one.communicate()[1]
        lines = [w for w in said.splitlines() if w and not w.startswith("  ")]
        # what fits is no fault
        self.judged(fault, out, again=False, ended_well=one.returncode == self.status, traceback="Traceback" in said,
                    more_lines=len(lines) > 1)  # fmt: skip

    def read_only(self) -> None:
        out = self.place / "ro"
        out.mkdir()
        if subprocess.run(["mount", "-t", "tmpfs", "-o", "ro", "tmpfs", str(out)], capture_output=True).returncode:
            out.rmdir()
            return
        try:
            self._refused("read-only file system", out)
        finally:
            subprocess.run(["umount", str(out)], check=True)
        out.rmdir()

    def forbidden(self) -> None:
        """A folder that nothing may be written into, for a user without root's rights to do so all the same."""
        out = self.place / "forbidden"
        prepared(out, self.i, self.verb)
        for path in (out, *out.rglob("*")):
            path.chmod(0o555 if path.is_dir() else 0o444)
        self._refused("no permission", out, as_others=True)
        for path in (out, *out.rglob("*")):
            path.chmod(0o755)
        shutil.rmtree(out)

    def lost_input(self) -> None:
        """Each input gone before it is asked for."""
        for name in ("nine.json", "model.npz", "parameters.toml", "campaign/campaign.toml", "campaign/acceleration/a.h5",
                     "raw/20240102_000000.npy", "run/posterior.nc", "run/update.json", "convert.toml"):
            if name.split("/")[0] not in " ".join(self.words(Path("o"))) and name != "parameters.toml":
                continue
            path, away, out = self.i / name, self.i / "away", self.place / "lost"
            path.rename(away)
            try:
                prepared(out, self.i, self.verb)
                self._refused("lost input", out)
            finally:
                away.rename(path)
            shutil.rmtree(out)

    def clock_back(self) -> None:
        """The clock goes back while it runs, over results that are dated tomorrow."""
        out = self.place / "clock"
        prepared(out, self.i, self.verb)
        for _ in range(1 if self.verb == "export" else 2):
            ended = subprocess.run(command(self.words(out), back=True), capture_output=True, text=True)
            for path in out.rglob("*"):
                os.utime(path, (time.time() + 86400,) * 2)
        # files that state their own time differ by it
        self.note("clock goes back", differs=ended.returncode != self.status or digest(out, self.steady) != self.wanted,
                  traceback="Traceback" in ended.stderr)  # fmt: skip
        shutil.rmtree(out)


def tried(verb: str, i: Path, place: Path, kills: int, seed: int) -> Tried:
    one = Tried(verb, i, place, np.random.default_rng([seed, *verb.encode()]))
    one.kill(kills)
    for kind in (signal.SIGTERM, signal.SIGINT):
        one.signalled(kind)
    for size in (0, 3000):
        one.full(size, "RLIMIT_FSIZE")
    one.full(16384, "tmpfs")
    one.read_only()
    one.forbidden()
    one.lost_input()
    one.clock_back()
    return one


BAD = ("torn", "again differs", "parts left", "traceback", "more_lines", "other_exit", "refused", "differs")


def main() -> None:
    if sys.argv[1] == "table":
        (HERE / "RESULTS.md").write_text(table([json.loads(line) for line in Path(sys.argv[2]).read_text().splitlines()]))
        return
    kills, seed, chosen = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:]
    os.environ["OMP_NUM_THREADS"] = "1"
    with tempfile.TemporaryDirectory() as base:
        i = Path(base) / "in"
        inputs(i)
        verbs = chosen or list(commands(i, i))
        share = [kills // len(verbs) + (k < kills % len(verbs)) for k in range(len(verbs))]
        for verb, number in zip(verbs, share, strict=True):
            place = Path(base) / verb
            place.mkdir()
            one = tried(verb, i, place, number, seed)
            sys.stdout.write(json.dumps({"command": verb, "seconds": round(one.lasts, 1), "seed": seed,
                                         "faults": {k: dict(v) for k, v in one.counts.items()}}) + "\n")  # fmt: skip
            sys.stdout.flush()


def table(lines_of: list[dict]) -> str:
    """RESULTS.md of the lines that runs wrote."""
    found = [{f: Counter(c) for f, c in one["faults"].items()} for one in lines_of]
    faults = list(dict.fromkeys(f for one in found for f in one))
    kills = sum(one["kill -9"]["tried"] for one in found)
    lines = ["# Faults of the machine", "",
             f"By `studies/faults/faults.py`, seed {lines_of[0]['seed']}: {len(found)} commands "
             f"({', '.join(one['command'] for one in lines_of)}),", f"{kills} kills. A file is torn if it is neither absent, nor byte "
             "for byte that of an undisturbed run, nor a whole one in which", "a command notes how far it is. After the fault the "
             "command is given again, and its results are compared with those of an", "undisturbed run.", "",
             "| fault | commands | tried | met a running command | torn files | differs when given again | temporary files left | "
             "tracebacks | more than one line, or another exit code |", "|---|---|---|---|---|---|---|---|---|"]  # fmt: skip
    for fault in faults:
        mine = [one[fault] for one in found if fault in one]
        total = sum(mine, Counter())
        met = total["met"] if any("met" in m for m in mine) else "-"
        lines.append(f"| {fault} | {len(mine)} | {total['tried']} | {met} | {total['torn']} | "
                     f"{total['again differs'] + total['differs']} | {total['parts left']} | {total['traceback']} | "
                     f"{total['more_lines'] + total['other_exit'] + total['refused']} |")
    lines += ["", "Commands with anything in the last columns:", ""]
    odd = [f"- {line['command']}, {fault}: " + ", ".join(f"{k} {n}" for k, n in counter.items() if k in BAD and n)
           for line, one in zip(lines_of, found, strict=True) for fault, counter in one.items()
           if any(counter[k] for k in BAD)]  # fmt: skip
    return "\n".join([*lines, *(odd or ["- none"])]) + "\n"


if __name__ == "__main__":
    main()
