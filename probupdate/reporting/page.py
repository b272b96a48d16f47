"""Sections to one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from probupdate.reporting.elements import Picture, Section

_FOLDER = Path(__file__).parent


def render(sections: Sequence[Section], *, title: str, subtitle: str = "", footer: str = "") -> str:
    """The page as text. Every string is escaped; only the drawings, the style and the script are taken as they are."""
    environment = Environment(
        loader=FileSystemLoader(_FOLDER), autoescape=True, undefined=StrictUndefined, trim_blocks=False
    )
    trusted = [
        replace(s, items=tuple(replace(i, svg=Markup(i.svg)) if isinstance(i, Picture) else i for i in s.items))
        for s in sections
    ]
    return environment.get_template("page.html").render(
        sections=trusted,
        title=title,
        subtitle=subtitle,
        kicker="Model updating report",
        footer=footer,
        css=Markup((_FOLDER / "page.css").read_text(encoding="utf-8")),
        script=Markup((_FOLDER / "viewer.js").read_text(encoding="utf-8")),
    )
