"""Signals that end a run, answered after a block that must not be left in its midst."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator
from types import FrameType

ENDING = (signal.SIGTERM, signal.SIGINT)


@contextlib.contextmanager
def hold_back_signals() -> Iterator[None]:
    """SIGTERM and Ctrl-C within the block are answered when it ends. For libraries that call back into Python: an
    exception of a signal that is raised there comes out as another one, or is lost."""
    handlers = {number: handler for number in ENDING if callable(handler := signal.getsignal(number))}
    came: list[tuple[int, FrameType | None]] = []
    try:
        for number in handlers:
            signal.signal(number, lambda number, frame: came.append((number, frame)))
    except ValueError:
        # not the main thread, where signals are answered
        handlers = {}
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for number, frame in came[:1]:
            handlers[signal.Signals(number)](number, frame)
