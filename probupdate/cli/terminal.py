"""What a command says: results on standard output, progress and errors on standard error."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from probupdate.errors import plain
from probupdate.runtime.progress import Progress

SECONDS_BETWEEN_LINES = 10
# files of one folder that are listed one by one
MOST_LISTED = 20


@contextlib.contextmanager
def terminal_progress() -> Iterator[Progress]:
    """A bar per task on a terminal; elsewhere a line every ten seconds, so that a log shows life too. Both say how
    long the task still takes at its rate."""
    if not sys.stderr.isatty():
        yield _lines()
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bars

    columns = (TextColumn("  {task.description:<34}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Bars(*columns, console=Console(stderr=True), transient=True) as bars:
        tasks: dict[str, TaskID] = {}

        def bar(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bars.add_task(what, total=total)
            bars.update(tasks[what], completed=done, total=total)

        yield bar


def _lines() -> Progress:
    # of each task: when it began, when it was last said, how much was done then
    tasks: dict[str, tuple[float, float, int]] = {}

    def line(what: str, done: int, total: int) -> None:
        now = time.monotonic()
        began, said, before = tasks.get(what, (now, now, 0))
        if done < before:
            # the same task once more
            began = said = now
        if now - said >= SECONDS_BETWEEN_LINES:
            said = now
            sys.stderr.write(f"  {what}: {done} of {total}{time_left(now - began, done, total)}\n")
            sys.stderr.flush()
        tasks[what] = began, said, done

    return line


def time_left(seconds: float, done: int, total: int) -> str:
    """", about 3 min left": of a task that took so many seconds until now; empty where nothing shows its rate."""
    if not 0 < done < total:
        return ""
    left = seconds * (total - done) / done
    return f", about {left:.0f} s left" if left < 100 else f", about {left / 60:.0f} min left"


def say(text: str) -> None:
    """Results go to standard output, progress and errors to standard error."""
    if sys.stdout is None:
        return
    # names out of files may hold what a terminal obeys, or what its encoding has not
    text = plain(text.rstrip("\n"), keep="\n\t") + "\n"
    encoding = sys.stdout.encoding or "utf-8"
    sys.stdout.write(text.encode(encoding, "backslashreplace").decode(encoding))
    sys.stdout.flush()


def complain(text: str) -> None:
    """One line on standard error, if that is still there."""
    with contextlib.suppress(OSError, AttributeError, ValueError):
        sys.stderr.write(plain(text) + "\n")
        sys.stderr.flush()


def answer(a: argparse.Namespace, result, files: Sequence = (), *, first: bool = True, **more) -> None:
    """What a step found: the lines of its summary and the files it wrote (first, or behind it), or with --json one
    object with its table and `more` keys."""
    if a.json:
        from probupdate.io.result_table import json_object

        say(json_object(a.verb, result.summary, result.to_frame(), files, **more))
        return
    written = written_lines(files)
    say("\n".join([*written, result.summary] if first else [result.summary, *written]))


def written_lines(files: Sequence) -> list[str]:
    """A line a file; of a folder with many of them, below what they all have in common, one line."""
    paths = [Path(path) for path in files]
    shared = os.path.commonprefix([path.parent.parts for path in paths])
    folders: dict[Path, list[Path]] = {}
    for path in paths:
        folder = Path(*path.parts[: len(shared) + 1]) if len(path.parts) > len(shared) + 1 else path.parent
        folders.setdefault(folder, []).append(path)
    lines = []
    for folder, inside in folders.items():
        if len(inside) <= MOST_LISTED:
            lines += [f"wrote {path}" for path in inside]
        else:
            first, last = (path.relative_to(folder) for path in (inside[0], inside[-1]))
            lines.append(f"wrote {len(inside)} files in {folder}, {first} to {last}")
    return lines
