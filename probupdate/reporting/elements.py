"""What a page is made of: sections of texts, notices, tiles, tables, pictures and the mode viewer, all plain values."""

from __future__ import annotations

import math
import re
from collections.abc import Collection
from dataclasses import dataclass, field

MISSING = "–"


@dataclass(frozen=True, kw_only=True)
class Text:
    """Paragraphs of running text."""

    paragraphs: tuple[str, ...]
    kind: str = field(default="text", init=False)


@dataclass(frozen=True, kw_only=True)
class Notice:
    """A line set apart; level "missing", "warning", "caution" or "good"."""

    level: str
    text: str
    kind: str = field(default="notice", init=False)


@dataclass(frozen=True, kw_only=True)
class Tile:
    """A key number of the verdict box; level "good", "caution", "warning" or "plain"."""

    label: str
    value: str
    detail: str = ""
    level: str = "plain"


@dataclass(frozen=True, kw_only=True)
class Tiles:
    items: tuple[Tile, ...]
    kind: str = field(default="tiles", init=False)


@dataclass(frozen=True, kw_only=True)
class Items:
    """A list of short statements under a heading; level "warning" sets it apart; `width` "full" or "half"."""

    title: str
    statements: tuple[str, ...]
    level: str = "plain"
    width: str = "full"
    kind: str = field(default="items", init=False)


@dataclass(frozen=True, kw_only=True)
class Column:
    """A table's column. `number` aligns right; `paper` marks columns that hold the paper's values."""

    name: str
    unit: str = ""
    number: bool = True
    paper: bool = False


@dataclass(frozen=True, kw_only=True)
class Table:
    """Cells are finished strings; `marked` rows are shown emphasised; `width` "full" or "half" of the page."""

    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""
    marked: frozenset[int] = frozenset()
    width: str = "full"
    kind: str = field(default="table", init=False)

    def __post_init__(self):
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"table '{self.caption}': {len(row)} cells for {len(self.columns)} columns")


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A drawing as SVG text; `width` "full" or "half" of the page; `alt` is read out for it, the caption without."""

    svg: str
    caption: str
    width: str = "full"
    alt: str = ""
    kind: str = field(default="picture", init=False)


@dataclass(frozen=True, kw_only=True)
class Viewer:
    """What the mode viewer draws (see viewer.viewer_data)."""

    data: dict
    caption: str
    kind: str = field(default="viewer", init=False)


@dataclass(frozen=True, kw_only=True)
class Panel:
    """A place that the page's own script fills: the parts of a page that is worked with, by their names (explore.js);
    `data`: what they are filled from, once a page."""

    names: tuple[str, ...]
    data: dict | None = None
    kind: str = field(default="panel", init=False)


Element = Text | Notice | Tiles | Items | Table | Picture | Viewer | Panel


@dataclass(frozen=True, kw_only=True)
class Section:
    """`headline` stands above the lead in large letters, in its `level`'s colour. The first `shown` items stand open,
    the others in a fold."""

    anchor: str
    title: str
    items: tuple[Element, ...]
    lead: str = ""
    headline: str = ""
    level: str = "plain"
    shown: int = 0


def full_sentence(text: str, names: Collection[str] = ()) -> str:
    """A capital first and a full stop last; a name (one of `names`, or what is not a plain word, such as k_t) stays as
    it is written."""
    first = re.split(r"[\s,;:=(]", text, maxsplit=1)[0]
    plain = re.fullmatch(r"[a-z][a-z'-]*", first) and first not in names
    return (text[0].upper() + text[1:] if plain else text) + ("" if text.endswith((".", "?", "!")) else ".")


def number(value: float | None, significant: int = 3) -> str:
    """A number with that many significant digits, thousands set apart, a power of ten only below 0.001 and from ten
    million; a dash for none."""
    if value is None or not math.isfinite(value):
        return MISSING
    if value == 0:
        return "0"
    rounded = float(f"{value:.{significant - 1}e}")
    exponent = math.floor(math.log10(abs(rounded)))
    if exponent < -3 or exponent > 6:
        power = str(exponent).translate(_RAISED)
        return f"{decimal(rounded / 10.0**exponent, significant - 1)} × 10{power}"
    if exponent < 3:
        return decimal(rounded, max(significant - 1 - exponent, 0))
    # a narrow space that no line breaks at
    return f"{rounded:,.0f}".replace(",", "\u202f").replace("-", "−")


def plain_text(text: str) -> str:
    """What `number` and `decimal` wrote, as other programs read it: "−2.50 × 10⁻⁴" is "-2.50e-4"."""
    text = text.replace("\u202f", "").replace("−", "-")
    return re.sub(r" × 10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)", lambda m: f"e{m[1].translate(_LOWERED)}", text)


_LOWERED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def decimal(value: float | None, decimals: int) -> str:
    """A number with that many decimals, a true minus sign, a dash for none."""
    if value is None or not math.isfinite(value):
        return MISSING
    text = f"{value:.{decimals}f}"
    # "-0.00" is not a number a reader wants
    if float(text) == 0:
        text = text.lstrip("-")
    return text.replace("-", "−")


def percent(value: float | None, decimals: int = 1, sign: bool = False) -> str:
    """A share as per cent without the unit (it stands in the header)."""
    if value is None or not math.isfinite(value):
        return MISSING
    text = decimal(100 * value, decimals)
    return f"+{text}" if sign and value > 0 and float(text) != 0 else text


def count(value: float) -> str:
    """A whole number, thousands set apart."""
    return f"{value:,.0f}".replace(",", "\u202f")


