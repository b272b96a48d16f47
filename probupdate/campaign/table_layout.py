"""How a table of text is laid out: where its columns' names and units stand, and what parts its cells."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from itertools import islice, takewhile
from pathlib import Path

from probupdate.campaign.stated import NOT_A_NUMBER, parse_unit

# of columns, where it is not the stated one
SEPARATORS = (";", "\t", "|", ",")
# lines that are looked at, and characters of each
MOST_LINES, LONGEST = 200, 100_000
# a table of Campbell's loggers begins with this word, then come its names, units and kinds of processing
TOA5 = "TOA5"
# cells of a row that are not numbers at most: date and time
TIMES = 2


@dataclass(frozen=True, eq=False, kw_only=True)
class TableLayout:
    """skip_rows: lines above the names; names () where none stand there; units: of the line units_row (from 1), () and
    None where there is none; rows: the first ones, as text."""

    separator: str
    decimal: str
    encoding: str
    skip_rows: int
    names: tuple[str, ...]
    units_row: int | None
    units: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def first_lines(path: Path, encoding: str | None = None) -> tuple[list[str], str]:
    """The first lines of a text, and the encoding in which it is one."""
    tried = (encoding,) if encoding else ("utf-8-sig", "utf-16", "cp1252")
    for name in tried:
        try:
            with path.open(encoding=name, newline="") as stream:
                return list(islice(iter(lambda: stream.readline(LONGEST), ""), MOST_LINES)), name.removesuffix("-sig")
        except UnicodeError:
            continue
    return [], tried[-1]


def table_layout(path: Path) -> TableLayout | None:
    """Of the separators the one that makes most cells of rows of numbers; None where none does."""
    lines, encoding = first_lines(path)
    found = [one for s in SEPARATORS if (one := _split_by(lines, s, encoding)) is not None]
    return max(found, key=lambda one: len(one.rows[0]) * len(one.rows), default=None)


def _split_by(lines: list[str], separator: str, encoding: str) -> TableLayout | None:
    cells = [row_cells(line, separator) for line in lines]
    # with a separator of its own a comma within a cell is the decimal sign
    decimal = "," if separator != "," and any("," in c and is_number(c, ",") for row in cells for c in row) else "."
    width = len(cells[-1]) if cells else 0
    rows = list(takewhile(lambda row: len(row) == width and _is_row(row, decimal), reversed(cells)))[::-1]
    if width < 2 or not rows:
        return None
    first = len(cells) - len(rows)
    above = list(takewhile(lambda k: len(cells[k]) == width and cells[k][0] != TOA5, range(first - 1, -1, -1)))[::-1]
    names = above[0] if above else None
    of_units = next((k for k in above[1:] if any(map(parse_unit, cells[k]))), None)
    return TableLayout(
        separator=separator, decimal=decimal, encoding=encoding, skip_rows=first if names is None else names,
        names=() if names is None else cells[names], units_row=None if of_units is None else of_units + 1,
        units=() if of_units is None else cells[of_units], rows=tuple(rows))


def row_cells(line: str, separator: str) -> tuple[str, ...]:
    try:
        return tuple(c.strip() for c in next(csv.reader([line], delimiter=separator, skipinitialspace=True), []))
    except csv.Error:
        # binary, or a cell without an end: no table's line
        return ()


def _is_row(row: tuple[str, ...], decimal: str) -> bool:
    numbers = sum(is_number(c, decimal) for c in row)
    return 0 < numbers >= len(row) - TIMES


def is_number(cell: str, decimal: str) -> bool:
    """Or one that was lost."""
    if not cell or cell.lower() in NOT_A_NUMBER:
        return True
    try:
        float(cell.replace(decimal, "."))
    except ValueError:
        return False
    return True
