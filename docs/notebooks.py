"""Notebooks as pages of the site: their cells are run in this process, with what they print and draw below each.

The notebooks in docs/tutorials hold no output; tests/test_tutorials.py runs them too.
"""

from __future__ import annotations

import ast
import contextlib
import io
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Ran:
    """A cell after its run: kind 'markdown' or 'code', its source, what it printed, its figures as PNG."""

    kind: str
    source: str
    printed: str = ""
    figures: tuple[bytes, ...] = ()


def run(path: Path, folder: Path) -> Iterator[Ran]:
    """The cells in order, one namespace, in `folder`; the last expression of a cell is shown as a notebook does."""
    import matplotlib

    matplotlib.use("Agg")
    names: dict = {"__name__": "__main__"}
    before = Path.cwd()
    os.chdir(folder)
    try:
        for number, cell in enumerate(json.loads(path.read_text(encoding="utf-8"))["cells"], 1):
            source = "".join(cell["source"])
            if cell["cell_type"] != "code":
                yield Ran(cell["cell_type"], source)
                continue
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed):
                _execute(source, f"{path.name}, cell {number}", names)
            yield Ran("code", source, printed.getvalue().rstrip(), tuple(_drawn()))
    finally:
        os.chdir(before)


def _execute(source: str, where: str, names: dict) -> None:
    body = ast.parse(source).body
    # a semicolon at the end keeps a value to itself
    last = body.pop() if body and isinstance(body[-1], ast.Expr) and not source.rstrip().endswith(";") else None
    exec(compile(ast.Module(body, []), where, "exec"), names)
    shown = None if last is None else eval(compile(ast.Expression(last.value), where, "eval"), names)
    if shown is not None:
        print(shown.to_string() if hasattr(shown, "to_string") else repr(shown))


def _drawn() -> Iterator[bytes]:
    """Every open figure, which is closed."""
    from matplotlib import pyplot

    for number in pyplot.get_fignums():
        stream = io.BytesIO()
        pyplot.figure(number).savefig(stream, format="png", dpi=90, bbox_inches="tight")
        yield stream.getvalue()
    pyplot.close("all")


def page(path: Path, folder: Path) -> tuple[str, dict[str, bytes]]:
    """Markdown of a notebook that has been run, and its figures by the names it gives them."""
    parts, figures = [], {}
    for cell in run(path, folder):
        if cell.kind == "markdown":
            parts.append(cell.source)
            continue
        parts.append(f"```python\n{cell.source}\n```")
        if cell.printed:
            parts.append(f"```text\n{cell.printed}\n```")
        for content in cell.figures:
            name = f"{path.stem}_{len(figures) + 1}.png"
            figures[name] = content
            parts.append(f"![Figure {len(figures)} of {path.stem}]({name})")
    parts.append(f"[The notebook]({path.name})")
    return "\n\n".join(parts) + "\n", figures
