"""Sections to one self-contained HTML page."""

from __future__ import annotations

import base64
import csv
import hashlib
import io
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from urllib.parse import quote

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from probupdate.io.result_table import plural
from probupdate.reporting.elements import MISSING, Element, Picture, Section, Table, plain_text

_FOLDER = Path(__file__).parent


def render(
    sections: Sequence[Section], *, title: str, subtitle: str = "", footer: str = "",
    kicker: str = "Model updating report", scripts: Sequence[str] = ("viewer.js", "page.js"),
    styles: Sequence[str] = ("page.css",),
) -> str:
    """The page as text. Every string is escaped; only the drawings, the style and the script are taken as they are. The
    page's policy lets nothing be fetched, and no script run but this one."""
    environment = Environment(
        loader=FileSystemLoader(_FOLDER), autoescape=True, undefined=StrictUndefined, trim_blocks=False,
        finalize=_plus_minus,
    )
    environment.filters |= {"csv_link": csv_link, "csv_name": csv_name, "folded": _fold_summary}
    trusted = [replace(s, items=tuple(_accessible_drawing(i) for i in s.items)) for s in sections]
    script = "\n" + "\n".join((_FOLDER / name).read_text(encoding="utf-8") for name in scripts)
    return environment.get_template("page.html").render(
        sections=trusted,
        title=title,
        subtitle=subtitle,
        kicker=kicker,
        footer=footer,
        css=Markup("\n".join((_FOLDER / name).read_text(encoding="utf-8") for name in styles)),
        script=Markup(script),
        script_sha256=Markup(base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()),
    )


def _plus_minus(value: object) -> object:
    """Sentences are written for the terminal, where it is +-; not within drawings, style and script."""
    return value.replace("+-", "±") if isinstance(value, str) and not isinstance(value, Markup) else value


def _accessible_drawing(item: Element) -> Element:
    """A picture's drawing as it is, read out as one image with its alternative text."""
    if not isinstance(item, Picture):
        return item
    words = escape(_plus_minus(item.alt or item.caption))
    return replace(item, svg=Markup(item.svg.replace("<svg", f'<svg role="img" aria-label="{words}"', 1)))


def _fold_summary(section: Section) -> str:
    """What lies in a section's fold: "Details: 2 figures, 4 tables"."""
    inside = [i.kind for i in section.items[section.shown :]]
    counts = [plural(inside.count(kind), word) for kind, word in
              (("viewer", "moving model"), ("picture", "figure"), ("table", "table")) if kind in inside]
    return f"Details: {', '.join(counts)}" if counts else "Details"


def csv_text(table: Table) -> str:
    """The table for other programs: plain minus signs, no thousands' spaces, powers as 1e-4, nothing for a dash."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\r\n")
    writer.writerow([_escape_formula(f"{c.name} [{c.unit.strip('[]')}]" if c.unit else c.name) for c in table.columns])
    for row in table.rows:
        writer.writerow(["" if cell == MISSING else _escape_formula(plain_text(cell)) for cell in row])
    return stream.getvalue()


def _escape_formula(cell: str) -> str:
    """A spreadsheet runs what starts like a formula; a number may start with its sign."""
    formula = cell.startswith(("=", "@", "+", "-", "\t", "\r")) and not re.match(r"[+-]\s?[\d.]", cell)
    return f"'{cell}" if formula else cell


def csv_link(table: Table) -> str:
    return "data:text/csv;charset=utf-8," + quote("\ufeff" + csv_text(table), safe="")


def csv_name(table: Table) -> str:
    words = re.sub(r"[^a-z0-9]+", "-", table.caption.lower()).strip("-")
    return f"{words[:60] or 'table'}.csv"
