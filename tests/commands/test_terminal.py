"""What a long task says of itself where there is no terminal: that it is alive, and how long it still takes."""

import io
import sys
from pathlib import Path

import pytest

from probupdate.cli import terminal
from probupdate.errors import plain


def said(monkeypatch, calls) -> list[str]:
    """The lines of calls (second, task, done, total)."""
    stream, now = io.StringIO(), [0.0]
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now[0])
    with terminal.terminal_progress() as progress:
        for second, task, done, total in calls:
            now[0] = second
            progress(task, done, total)
    return stream.getvalue().splitlines()


def test_a_long_task_says_how_long_it_still_takes(monkeypatch):
    calls = [(0, "blocks", 0, 40), (4, "blocks", 4, 40), (10, "blocks", 10, 40), (20, "blocks", 20, 40)]
    assert said(monkeypatch, calls) == ["  blocks: 10 of 40, about 30 s left", "  blocks: 20 of 40, about 20 s left"]
    assert said(monkeypatch, [(0, "sets", 0, 700), (70, "sets", 70, 700)]) == ["  sets: 70 of 700, about 10 min left"]


def test_a_task_done_once_more_is_timed_anew(monkeypatch):
    calls = [(0, "fit", 0, 4), (12, "fit", 4, 4), (30, "fit", 0, 4), (41, "fit", 2, 4)]
    assert said(monkeypatch, calls) == ["  fit: 4 of 4", "  fit: 2 of 4, about 11 s left"]


def test_a_task_without_a_rate_is_only_alive(monkeypatch):
    assert said(monkeypatch, [(0, "search", 0, 3), (15, "search", 0, 3)]) == ["  search: 0 of 3"]


@pytest.mark.parametrize(("count", "lines"), [(20, 21), (21, 2)])
def test_many_files_of_one_folder_are_one_line(count, lines):
    models = [Path("out") / "models" / f"draw_{k:02d}.dat" for k in range(count)]
    shown = terminal.written_lines([Path("out") / "draws.csv", *models])
    assert len(shown) == lines and shown[0] == f"wrote {Path('out') / 'draws.csv'}"
    assert lines > 2 or str(count) in shown[1]


def test_a_narrow_space_between_thousands_is_a_space_and_no_escape():
    assert plain("m_h 145\u202f000 kg") == "m_h 145 000 kg"
    assert plain("\x1b[2J\u2028") == "\\x1b[2J\\u2028"
