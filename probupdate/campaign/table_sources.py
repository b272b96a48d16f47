"""Records as tables of other programs: text (CSV, TOA5 and the like) and Parquet."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from probupdate.campaign.description import Description
from probupdate.campaign.last_line import open_beginning, unfinished_line
from probupdate.campaign.reading import suggest
from probupdate.campaign.stated import (
    NOT_A_NUMBER,
    UNIT_KEYS,
    ChannelStatement,
    FileStatements,
    keyed_rate,
    parse_unit,
    unit_in,
    without_unit,
)
from probupdate.campaign.table_layout import MOST_LINES, SEPARATORS, TOA5, TableLayout, first_lines, table_layout
from probupdate.errors import InputError, parsing
from probupdate.io.result_table import plural

ROWS, COLUMNS = "channels in rows", "channels in columns"
# fewer samples than this in all are no record
FEWEST = 20
PIECE = 200_000
# lines of a table of Campbell's loggers
TOA5_NAMES, TOA5_UNITS, TOA5_HEAD = 1, 2, 4
# what a rate looks like in the lines before the table
RATE_LINE = re.compile(r"(?:sampl\w*[ _]*(?:rate|freq\w*)|abtast\w*|\bfs\b)[^\d\n]{0,20}?([\d.]+)\s*(k?hz)?\b",
                       re.IGNORECASE)
# what pandas calls an index without a name in a Parquet file, and what it is called here
NAMELESS_INDEX, INDEX = "__index_level_0__", "index"
UNREADABLE = "cannot be read as Parquet", "write it again or remove it"


def iterate_with_errors(items: Iterable, *said: str) -> Iterator:
    """The items of a library's reader, its errors as `parsing` says them, not those of whoever takes them."""
    items = iter(items)
    while True:
        with parsing(*said):
            item = next(items, None)
        if item is None:
            return
        yield item


# Text ---------------------------------------------------------------------------------------------------------------


def read_csv(path: Path, d: Description) -> Iterator:
    """FileStatements, then pieces of a table as text."""
    said = str(path), "is not a table", "check separator, header, skip_rows and encoding in convert.toml"
    head = _head_lines(path, d)
    with parsing(*said):
        size, note = unfinished_line(path, d.encoding, d.separator, d.decimal, d.lost)
    names, units, skipped = _layout(path, d, head)
    if d.header and names is None:
        _refuse_other_head(path, d, skipped)
    with open_beginning(path, d.encoding, size) as stream:
        with parsing(*said):
            table = pd.read_csv(
                stream, sep=d.separator, decimal=d.decimal, header=0 if d.header else None, skiprows=sorted(skipped),
                chunksize=PIECE, skipinitialspace=True, low_memory=False, na_values=_lost_markers(d),
            )
        whole = first = False
        with table:
            for frame in iterate_with_errors(table, *said):
                if names is not None and len(names) == frame.shape[1]:
                    frame.columns = names
                if not first:
                    _refuse_channels_in_rows(path, d, frame)
                    words = _table_words(path, d, list(frame.columns), units, _rate_of(head[: d.skip_rows]))
                    yield replace(words, notes=(*words.notes, note)) if note else words
                    first = True
                # pandas fills a short row with NaN at its end, as it reads an empty cell, which is a gap
                if not whole and len(d.separator) == 1 and frame.iloc[:, -1].isna().any():
                    with parsing(*said):
                        _refuse_short_rows(path, d, frame.shape[1], skipped, size)
                    whole = True
                yield _from_frame(path, d, frame)
    if not first:
        yield FileStatements()


def _refuse_channels_in_rows(path: Path, d: Description, frame: pd.DataFrame) -> None:
    """A table of fewer samples than a record has and more channels than that."""
    n_row, n_column = frame.shape
    if n_row < FEWEST <= n_column and d.orientation != COLUMNS:
        raise InputError(str(path), f"has {plural(n_row, 'sample')} of {n_column} channels",
                         "if a row is a channel, write the table with a row a sample, else orientation = "
                         f'"{COLUMNS}" in convert.toml')


def _refuse_other_head(path: Path, d: Description, skipped: set[int]) -> None:
    """Where the names that convert.toml gives stand in another line than the first that is read, which has to."""
    found = table_layout(path)
    wanted = {c for c in (d.time, *d.columns.values()) if isinstance(c, str)}
    if found is None or not wanted or not wanted <= {*found.names, *map(without_unit, found.names)}:
        return
    # empty lines are passed over
    read = next((k for k, line in enumerate(first_lines(path, d.encoding)[0]) if k not in skipped and line.strip()), 0)
    if read != found.skip_rows:
        also = "" if found.separator == d.separator else f" and separator = {json.dumps(found.separator)}"
        raise InputError(str(path), f"has its columns' names in line {found.skip_rows + 1}, not in line {read + 1}",
                         f"write skip_rows = {found.skip_rows}{also} into convert.toml")


def _lost_markers(d: Description) -> list[str]:
    return ["NAN", *(w for w in d.lost if isinstance(w, str))]


def _head_lines(path: Path, d: Description) -> list[str]:
    """The first lines: those before the table, and that of its units."""
    wanted = max(min(d.skip_rows, MOST_LINES), d.units_row or 0, TOA5_HEAD)
    try:
        with path.open(encoding=d.encoding, newline="") as stream:
            return [line for _, line in zip(range(wanted), stream, strict=False)]
    except UnicodeError as error:
        raise InputError(str(path), f"is not text in {d.encoding.removesuffix('-sig')} ({str(error)[:80]})",
                         'state its encoding in convert.toml, such as encoding = "cp1252" or "utf-16"') from None


def _layout(path: Path, d: Description, head: Sequence[str]):
    """(names of the columns where not from their head, cells with units or None, numbers of lines to skip)."""
    skipped, names, units = set(range(d.skip_rows)), None, None
    row = d.units_row
    if row is not None and row > len(head):
        raise InputError(f"{d.path}, units_row", f"{path.name} has {len(head)} lines", "count lines from 1")
    if head and next(csv.reader(head[:1], delimiter=d.separator), [""])[:1] == [TOA5]:
        if d.header and d.skip_rows <= TOA5_NAMES:
            skipped = set(range(TOA5_HEAD)) - {TOA5_NAMES}
        elif not d.header and d.skip_rows == TOA5_HEAD:
            names = _cells(head[TOA5_NAMES], d)
        row = row or TOA5_UNITS + 1
    if row is not None:
        units = _cells(head[row - 1], d)
        skipped.add(row - 1)
    return names, units, skipped


def _cells(line: str, d: Description) -> list[str]:
    return [cell.strip() for cell in next(csv.reader([line], delimiter=d.separator[:1], skipinitialspace=True), [])]


def _rate_of(lines: Sequence[str]) -> float | None:
    for line in lines:
        found = RATE_LINE.search(line)
        if found:
            try:
                return float(found[1]) * (1e3 if (found[2] or "").lower() == "khz" else 1.0) or None
            except ValueError:
                continue
    return None


def _table_words(
    path: Path, d: Description, names: list, units: Sequence[str] | None, rate: float | None
) -> FileStatements:
    """Units by their row, else in brackets behind a column's name."""
    found = {}
    left = dict(enumerate(str(n + 1 if isinstance(n, int) else n) for n in names))
    if d.time is not None:
        left.pop(_column(path, d, names, d.time, "time"))
    for channel, wanted in d.columns.items():
        k = _column(path, d, names, wanted, channel)
        left.pop(k, None)
        text = units[k] if units is not None and k < len(units) else unit_in(str(names[k]))
        found[channel] = ChannelStatement(unit=text or None)
    return FileStatements(channels=found, rate_hz=rate, unused=tuple(left.values()))


def _refuse_short_rows(path: Path, d: Description, n_column: int, skipped: set[int], size: int) -> None:
    with open_beginning(path, d.encoding, size) as stream:
        lines = (line for k, line in enumerate(stream) if k not in skipped)
        rows = csv.reader(lines, delimiter=d.separator, skipinitialspace=True)
        for row in rows:
            if 0 < len(row) < n_column and any(row):
                raise InputError(f"{path}, line {rows.line_num + len(skipped)}",
                                 f"has {plural(len(row), 'cell')} of {n_column}",
                                 "complete it with empty cells where samples were lost, or take the line out")


# Parquet ------------------------------------------------------------------------------------------------------------


def read_parquet(path: Path, d: Description) -> Iterator:
    """FileStatements, then pieces of a Parquet table; the index of a DataFrame is a column like any other."""
    with _opened_parquet(path) as (file, names, units):
        with parsing(str(path), *UNREADABLE):
            own = _plain(file.schema_arrow.metadata)
        yield _table_words(path, d, names, units, keyed_rate({k: _number(v) for k, v in own.items()}))
        batches = (batch.to_pandas(ignore_metadata=True) for batch in file.iter_batches(batch_size=PIECE))
        for frame in iterate_with_errors(batches, str(path), *UNREADABLE):
            frame.columns = names
            yield _from_frame(path, d, frame)


def parquet_layout(path: Path) -> TableLayout:
    """As that of a table of text, without separators: its first rows as text."""
    with _opened_parquet(path) as (file, names, units):
        batch = next(iterate_with_errors(file.iter_batches(batch_size=MOST_LINES), str(path), *UNREADABLE), None)
        frame = pd.DataFrame() if batch is None else batch.to_pandas(ignore_metadata=True)
    if frame.empty:
        raise InputError(str(path), "has no rows", "leave it out")
    cells = [[x.isoformat() if isinstance(x, pd.Timestamp) else str(x) for x in frame.iloc[:, k]]
             for k in range(frame.shape[1])]
    return TableLayout(separator="", decimal=".", encoding="utf-8", skip_rows=0, names=tuple(names), units_row=None,
                       units=tuple(units), rows=tuple(zip(*cells, strict=True)))


@contextmanager
def _opened_parquet(path: Path) -> Iterator[tuple[Any, list[str], list[str]]]:
    """The file, its columns' names and their units, '' where none is stated."""
    try:
        from pyarrow import parquet
    except ImportError:
        raise InputError(str(path), "Parquet needs the package pyarrow, which is not installed",
                         "pip install probupdate[parquet], or save the table as CSV") from None
    with parsing(str(path), *UNREADABLE):
        opened = parquet.ParquetFile(path)
    with opened as file:
        with parsing(str(path), *UNREADABLE):
            fields = list(file.schema_arrow)
        names = [INDEX if f.name == NAMELESS_INDEX and INDEX not in file.schema_arrow.names else f.name for f in fields]
        units = [next((v for k, v in _plain(f.metadata).items() if k in UNIT_KEYS), None) for f in fields]
        yield file, names, [u or unit_in(n) or "" for u, n in zip(units, names, strict=True)]


def _plain(metadata: dict | None) -> dict[str, str]:
    return {k.decode("utf-8", "replace").lower(): v.decode("utf-8", "replace") for k, v in (metadata or {}).items()
            if len(v) < 1000}


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return np.nan


# Columns ------------------------------------------------------------------------------------------------------------


def _from_frame(path: Path, d: Description, frame: pd.DataFrame) -> tuple[np.ndarray | None, np.ndarray]:
    names = [c.strip() if isinstance(c, str) else c for c in frame.columns]
    data = np.empty((len(frame), len(d.columns)))
    for k, (channel, wanted) in enumerate(d.columns.items()):
        column = frame.iloc[:, _column(path, d, names, wanted, channel)]
        if not pd.api.types.is_numeric_dtype(column):
            column = _numbers(column, d, f"{path}, column {wanted}")
        data[:, k] = column.to_numpy(float, na_value=np.nan)
    time = None if d.time is None else frame.iloc[:, _column(path, d, names, d.time, "time")].to_numpy()
    return time, data


def _numbers(column: pd.Series, d: Description, where: str) -> pd.Series:
    """A column of text as numbers; words that stand for a lost sample are NaN."""
    words = {w.strip().lower() for w in d.lost if isinstance(w, str)} | NOT_A_NUMBER
    text = column.where(column.isna(), column.astype(str).str.strip())
    text = text.mask(text.str.lower().isin(words))
    if d.decimal != ".":
        # the text that remains has the file's decimal sign, and no other
        text = text.str.replace(".", "?", regex=False).str.replace(d.decimal, ".", regex=False)
    number = pd.to_numeric(text, errors="coerce")
    wrong = number.isna() & text.notna()
    if wrong.any():
        at = wrong[wrong].index[0]
        if at == 0 and d.header and parse_unit(str(column[at])):
            raise InputError(f"{where}, row 1", f"'{column[at]}' is a unit",
                             f"state the line that has the units: units_row = {d.skip_rows + 2} in convert.toml")
        raise InputError(f"{where}, row {at + 1}", f"'{column[at]}' is not a number",
                         "give decimal, separator or skip_rows in convert.toml, correct the cell, or declare it lost: "
                         f"lost = [{json.dumps(str(column[at]).strip()[:20])}]")
    return number


def _column(path: Path, d: Description, names: Sequence, wanted: str | int, what: str) -> int:
    """The number, from 0, of a channel's column or that of time, which convert.toml names or counts from 1."""
    if isinstance(wanted, int):
        if not 1 <= wanted <= len(names):
            raise InputError(f"{path}, {what}", f"there is no column {wanted} among {len(names)}", "count from 1")
        return wanted - 1
    # "F1x [mg]" is the column F1x, its unit is read beside
    bare = [without_unit(str(n)) for n in names]
    if wanted not in names and bare.count(wanted) == 1:
        return bare.index(wanted)
    if wanted not in names:
        # without a line of names pandas counts from 0, convert.toml from 1
        known = tuple(str(n + 1 if isinstance(n, int) else without_unit(n)) for n in names[:40])
        if len(known) == 1 and (other := next((s for s in SEPARATORS if s in known[0]), None)) is not None:
            raise InputError(f"{path}, {what}",
                             f"there is no column '{wanted}': the whole line '{known[0]}' is one column",
                             f"give its separator in convert.toml: separator = {json.dumps(other)}")
        raise InputError(f"{path}, {what}", f"there is no column '{wanted}'",
                         f"{d.column_remedy(what)}; {suggest(wanted, known)}")
    return list(names).index(wanted)
