"""Commands as processes: as a shell starts them or forked, what they use, what they leave running."""

from __future__ import annotations

import contextlib
import importlib
import os
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fault_inputs import command

RIGHTS = "-dac_override,-dac_read_search,-fowner"
WITHOUT_RIGHTS = ["setpriv", f"--bounding-set={RIGHTS}", f"--inh-caps={RIGHTS}"]
HANGS_S = 900.0
# share of a short process's time in which Python starts, before there is anything of this program
OWN_START = 0.15
SIGNALS = (signal.SIGTERM, signal.SIGINT)
# a process whose parent was killed has this long to notice it
ORPHAN_S = 10.0


@dataclass(frozen=True)
class Ended:
    """code: as of subprocess, negative for a signal. said: standard error. processor_s: of it and what it waited
    for."""

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
            stdout=subprocess.DEVNULL if stdout is None else stdout, stderr=self._to,
            env={**os.environ, "TMPDIR": str(temporary)}, start_new_session=True,
            preexec_fn=lambda: (signal.signal(signal.SIGINT, signal.default_int_handler), before()))
        os.close(self._to)
        # asked about here, with the time that it used
        self.pid, one.returncode = one.pid, 0


class Forked(_Process):
    """Forked from this process, which has imported what the commands import and done nothing with it."""

    def __init__(self, words: list[str], temporary: Path, rights: bool, stdout: int | None, before: Callable):
        super().__init__()
        start = importlib.import_module("probupdate.__main__")
        # until the program's own first line is reached a signal waits: before it there is only this fork
        signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
        self.pid = os.fork()
        if self.pid:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
            os.close(self._to)
            return
        code = 1
        try:
            os.setsid()
            nowhere = os.open(os.devnull, os.O_RDWR)
            for number, to in ((0, nowhere), (1, nowhere if stdout is None else stdout), (2, self._to)):
                os.dup2(to, number)
            sys.stdout, sys.stderr = open(1, "w", closefd=False), open(2, "w", closefd=False)  # noqa: SIM115
            os.environ["TMPDIR"] = tempfile.tempdir = str(temporary)
            before()
            sys.argv = ["probupdate", *words]
            start.ready()
            signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
            code = start.main()
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
