"""convert.toml: which columns of which files become which channel, and what their times mean."""

from __future__ import annotations

import json
import re
import zoneinfo
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from datetime import UTC, timedelta, timezone, tzinfo
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal

from probupdate.campaign.name_pattern import name_pattern
from probupdate.campaign.reading import suggest
from probupdate.errors import InputError
from probupdate.io.files import read_toml
from probupdate.io.schema import Length, Range, table_as

# unit of a numeric time column -> seconds, or the two programs' day numbers
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "day": 86400.0}
LOGGER = "logger"
DAY_NUMBERS = {"matlab": 719529.0, "excel": 25569.0}


Text = Annotated[str, Length(1)]


@dataclass(frozen=True, kw_only=True)
class _Written:
    """convert.toml as it is written: kinds and bounds of its keys."""

    files: Text
    time: Text | int | None = None
    time_format: Text | None = None
    time_unit: Literal["iso", "s", "ms", "us", "ns", "day", "matlab", "excel"] = "iso"
    zone: Text | None = None
    start: Text | None = None
    start_pattern: Text | None = None
    start_format: Text | None = None
    data: Text | None = None
    orientation: Literal["channels in columns", "channels in rows"] | None = None
    columns: Mapping[str, Text | Annotated[int, Range(1)]] = field(default_factory=dict)
    factor: Mapping[str, Annotated[float, Range(-1e12, 1e12, nonzero=True)]] = field(default_factory=dict)
    separator: Text = ","
    decimal: Text = "."
    encoding: Text = "utf-8"
    header: bool = True
    skip_rows: Annotated[int, Range(0, 1e9)] = 0
    units_row: Annotated[int, Range(1, 1e9)] | None = None
    lost: tuple[float | str, ...] = ()
    overrule: tuple[Literal["unit", "quantity", "direction", "rate", "start", "offset", "overlap"], ...] = ()
    join_pattern: Text | None = None
    decimate: bool = False
    fill_seconds: Annotated[float, Range(0, 1e9)] = 60.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Description:
    """Where the samples of every channel are.

    files: pattern below the folder of the sources. time: name of the time column, or None where `start` or
    `start_pattern` (a pattern with one group in the file's name, read by start_format) gives a file's first sample and
    the campaign's rate the others. time_unit: "iso", or the unit of a number counted from `start`, from 1970 where no
    start is given, or "matlab"/"excel" day numbers; time_format: strptime's codes of times that are not ISO 8601. zone:
    of every time that does not state its own. data: variable that holds all channels, as columns or as rows where
    `orientation` says so. columns: channel -> name, or number from 1, of its column; without an entry the channel's own
    name. factor: channel -> what its numbers are multiplied with to be in the unit of campaign.toml, where it is given.
    encoding: of a table's text; units_row: its line, from 1, that states the columns' units. lost: numbers and words
    that stand for a lost sample. overrule: what the sources say of themselves and is wrong ("unit", "quantity",
    "direction", "rate", "start"), "offset" of channels from each other's samples, "overlap" that differs. join_pattern:
    files in whose names its group is the same hold a channel each, and are read together. decimate: channels sampled at
    a multiple of the campaign's rate are low-pass filtered and thinned. fill_seconds: gaps up to so long are filled
    with NaN within a file.
    """

    path: Path
    files: str
    time: str | int | None
    time_format: str | None
    time_unit: str
    zone: tzinfo | None
    start: str | None
    start_pattern: str | None
    start_format: str | None
    data: str | None
    orientation: str | None
    columns: Mapping[str, str | int]
    factor: Mapping[str, float]
    separator: str
    decimal: str
    encoding: str
    header: bool
    skip_rows: int
    units_row: int | None
    lost: tuple[float | str, ...]
    overrule: tuple[str, ...]
    join_pattern: str | None
    decimate: bool
    fill_seconds: float

    def column_remedy(self, what: str) -> str:
        """Where the name is to be corrected that the files have not; what: a channel, "time" or "data"."""
        if what not in self.columns:
            return f"correct {what} in {self.path.name}"
        if self.columns[what] != what:
            return f"correct [columns] in {self.path.name}"
        return (f"correct channel of its [[sensor]] in campaign.toml, or name its column in {self.path.name}: "
                f"[columns] {json.dumps(what, ensure_ascii=False)} = ...; where another logger's files of that "
                "time have it, give each logger a table [[logger]] with its files and its [logger.columns]")


def read_descriptions(path: str | Path, channels: tuple[str, ...]) -> list[Description]:
    """Read convert.toml: one description of all channels; or one for each [[logger]], of the channels of its columns,
    beside keys that hold for all. Raises InputError for unknown keys, wrong kinds, a zone that is none, a path that
    leaves, and for channels of no logger or of two."""
    path = Path(path)
    raw = read_toml(path, absent=(
        "`probupdate convert --describe RAW --out NEW/campaign.toml` writes one from your records: copy it and fill in "
        'every "?", or write it as docs/formats/convert.md has it'))
    if LOGGER not in raw:
        return [_description(path, raw, channels, str(path))]
    common, tables, found = {k: v for k, v in raw.items() if k != LOGGER}, raw[LOGGER], []
    if not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables):
        raise InputError(f"{path}, {LOGGER}", "is not a list of tables", "write [[logger]] above the keys of each")
    for number, table in enumerate(tables, 1):
        where = f"{path}, logger {number}"
        named = table.get("columns")
        if not isinstance(named, dict) or not named:
            raise InputError(where, "does not say which channels are its own",
                             'list them: [logger.columns], then "channel" = "column"')
        own = tuple(c for c in channels if c in named) or channels
        found.append(_description(path, common | table, own, where))
    for channel in channels:
        if (n := sum(channel in d.columns for d in found)) != 1:
            raise InputError(f"{path}, {channel}", f"is a column of {'several loggers' if n else 'no logger'}",
                             "list it in [logger.columns] of the one [[logger]] that recorded it, or take its "
                             "[[sensor]] out of campaign.toml")
    return found


def _description(path: Path, raw: Mapping, channels: tuple[str, ...], where: str) -> Description:
    """One table of convert.toml, of these channels."""
    described = table_as(_Written, raw, where)
    files = described.files
    if PurePosixPath(files).is_absolute() or ".." in PurePosixPath(files).parts or "\\" in files:
        raise InputError(f"{path}, files", f"'{files}' leaves the folder of the sources", "give a pattern below it")
    if described.time is None and described.start is None and described.start_pattern is None:
        raise InputError(str(path), "does not state the time", "add time (a column), start, or start_pattern")
    if described.start is not None and described.start_pattern is not None:
        raise InputError(str(path), "has both start and start_pattern", "keep one")
    for key in ("start_pattern", "join_pattern"):
        if getattr(described, key) is not None:
            name_pattern(getattr(described, key), f"{path}, {key}")
    for key in ("columns", "factor"):
        for channel in getattr(described, key):
            if channel not in channels:
                raise InputError(f"{path}, {key}", f"'{channel}' is not a channel of campaign.toml",
                                 suggest(channel, channels))
    columns = {c: described.columns.get(c, c) for c in channels}
    twice = [c for c in channels if list(columns.values()).count(columns[c]) > 1]
    if twice:
        raise InputError(f"{path}, columns", f"{' and '.join(twice)} are the same column", "give each channel its own")
    for channel, column in columns.items():
        if described.time is not None and column == described.time:
            raise InputError(f"{path}, columns, {channel}", f"{column!r} is the column of time",
                             "name the channel's own")
    same = {f.name: getattr(described, f.name) for f in fields(described)}
    return Description(**(same | {
        "path": path, "zone": _zone(path, described.zone), "columns": columns,
        "encoding": _checked_encoding(path, described.encoding)}))


def _checked_encoding(path: Path, text: str) -> str:
    """A text encoding that Python knows; a byte order mark is not a letter."""
    try:
        "a".encode(text)
    except (LookupError, UnicodeError, ValueError):
        raise InputError(f"{path}, encoding", f"'{text}' is not an encoding", "use utf-8, cp1252 or utf-16") from None
    return "utf-8-sig" if text.lower().replace("_", "-") in ("utf-8", "utf8") else text


def _zone(path: Path, text: str | None) -> tzinfo | None:
    """UTC, +02:00 or a name of the zones' data base."""
    if text is None:
        return None
    if fixed := re.fullmatch(r"([+-])(\d{2}):?(\d{2})", text):
        minutes = int(fixed[2]) * 60 + int(fixed[3])
        return timezone(timedelta(minutes=minutes if fixed[1] == "+" else -minutes))
    if text.upper() in ("UTC", "Z"):
        return UTC
    try:
        return zoneinfo.ZoneInfo(text)
    except (zoneinfo.ZoneInfoNotFoundError, ValueError, OSError):
        raise InputError(f"{path}, zone", f"'{text}' is not a time zone", "use UTC, +02:00 or Europe/Berlin") from None
