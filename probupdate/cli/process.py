"""The process of a command: signals that end it, threads of its linear algebra."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from collections.abc import Iterator
from typing import Any, NoReturn

from probupdate.runtime.signals import ENDING


class InterruptedBySignal(KeyboardInterrupt):
    """Raised for a signal. Python gives up the exit code where a KeyboardInterrupt itself has passed through an `exec`,
    as where dataclasses are made, even if it is caught after that."""


@contextlib.contextmanager
def ended_by_signals() -> Iterator[None]:
    """SIGTERM ends a run as Ctrl-C does: temporary files are removed, processes ended. Where Ctrl-C is ignored, as in
    the background, it stays so. An exception that a library makes of the signal's, or prints, is the signal's all the
    same."""
    came: list[int] = []

    def end(number: int, frame: object) -> NoReturn:
        came.append(number)
        raise InterruptedBySignal

    said_before = sys.unraisablehook

    def say(unraisable: Any) -> None:
        if not came:
            said_before(unraisable)

    before = {}
    try:
        for number in ENDING:
            if signal.getsignal(number) is not signal.SIG_IGN:
                before[number] = signal.signal(number, end)
    except ValueError:
        # not in the main thread: whoever runs this there answers for signals
        yield
        return
    sys.unraisablehook = say
    try:
        yield
    except Exception as error:
        if came:
            raise InterruptedBySignal from error
        raise
    finally:
        sys.unraisablehook = said_before
        for number, handler in before.items():
            signal.signal(number, handler)


def limit_threads() -> None:
    """Of linear algebra, here and in the processes started: the same bits wherever a task runs, and no threads that
    wait for one another where several processes run. Read when numpy is first imported."""
    os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")
