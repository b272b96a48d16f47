"""How long work reports that it is alive: a callable, so that the library itself prints nothing."""

from __future__ import annotations

from collections.abc import Callable

# progress(what, done, total): called now and then from long loops; done == total ends the bar.
Progress = Callable[[str, int, int], None]


def silent(what: str, done: int, total: int) -> None:
    """The default: no report."""
