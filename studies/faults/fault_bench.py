"""A command under trial: its undisturbed result, and the judgement of what a fault left."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import shutil
import signal
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
from fault_inputs import LONG, commands
from fault_processes import HANGS_S, ORPHAN_S, Ended, Forked, Shell, of_sessions, processor_s


def digest(folder: Path) -> dict[str, str]:
    """File -> SHA-256 of what it holds; without temporary files and folders, and without what says who writes."""
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest()
            for p in sorted(folder.rglob("*")) if p.is_file() and p.suffix != ".lock"
            and not any(part.endswith(".part") for part in p.relative_to(folder).parts)}


def is_whole(path: Path) -> bool:
    """Whether a file that differs from the undisturbed one reads to its end."""
    try:
        if path.suffix == ".npz":
            # numpy leaves a file open that is not an archive
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
        if finished and self.verb not in ("export", "stresses"):
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
              before: Callable[[], object] = lambda: None) -> Shell | Forked:
        """The command in a session of its own; `before` is called in the new process."""
        self.running = (Shell if shell else Forked)(self.words, self.temporary, rights, stdout, before)
        self.sessions.append(self.running.pid)
        return self.running

    def run(self, **options) -> Ended:
        return self.start(**options).ended()

    def torn(self) -> list[str]:
        """Files that are neither those of an undisturbed run nor whole ones (how far a command is, when it was
        made)."""
        found = digest(self.out)
        return [name for name, text in found.items()
                if not (name in self.steady and text == self.wanted[name]) and not is_whole(self.out / name)]

    def again(self, always: bool = False) -> dict:
        """The command once more, undisturbed: whether it ends as it should, what it leaves. Not of commands that take
        long, but where `always` says so."""
        if self.slow and not always:
            return {}
        self.fill()
        ended = self.run()
        found = digest(self.out)
        differ = sorted({name for name in self.wanted.keys() | found.keys()
                         if (name in self.wanted) != (name in found)
                         or (name in self.steady and found[name] != self.wanted[name])})
        parts = [p.name for p in self.out.rglob("*.part")]
        what = {"again_differs": ended.code != self.status or bool(differ), "parts_left": len(parts),
                "temporary_left": len(list(self.temporary.iterdir()))}
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
                "more_lines": len(lines) > 1, "other_exit": ended.code not in (self.status, 1, 2, 130)}
        if what["traceback"] or what["more_lines"] or what["other_exit"]:
            what["words"] = f"{ended.code} {ended.said[-400:]}"
        return what
