"""How long work reports that it is alive: a callable, so that the library itself prints nothing."""

from __future__ import annotations

from collections.abc import Callable

# progress(what, done, total): called now and then from long loops; done == total ends the bar.
Progress = Callable[[str, int, int], None]


def silent(what: str, done: int, total: int) -> None:
    """The default: no report."""


def renamed(progress: Progress, name: str) -> Progress:
    """The same under another name: of a step that runs again within another one."""
    return lambda what, done, total: progress(name, done, total)


def resumed_progress(progress: Progress) -> Progress:
    """The same, for a search that takes up again what it had left: what was done is not said to be undone."""
    most: dict[tuple[str, int], int] = {}

    def report_rise(what: str, done: int, total: int) -> None:
        most[what, total] = max(done, most.get((what, total), 0))
        progress(what, most[what, total], total)

    return report_rise
