"""convert.toml: which columns of which files become which channel, and what their times mean."""

from __future__ import annotations

import re
import zoneinfo
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, timedelta, timezone, tzinfo
from pathlib import Path, PurePosixPath

from probupdate.campaign.name_pattern import name_pattern
from probupdate.campaign.reading import nearest
from probupdate.errors import InputError
from probupdate.files import read_toml

DESCRIPTION_KEYS = (
    "files", "time", "time_unit", "zone", "start", "start_pattern", "start_format", "data", "columns", "factor",
    "separator", "decimal", "header", "skip_rows", "lost", "fill_seconds",
)  # fmt: skip
# unit of a numeric time column -> seconds, or the two programs' day numbers
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "day": 86400.0}
DAY_NUMBERS = {"matlab": 719529.0, "excel": 25569.0}


@dataclass(frozen=True, eq=False, kw_only=True)
class Description:
    """Where the samples of every channel are.

    files: pattern below the folder of the sources. time: name of the time column, or None where `start` or
    `start_pattern` (a pattern with one group in the file's name, read by start_format) tells a file's first sample and
    the campaign's rate the others. time_unit: "iso", or the unit of a number counted from `start`, from 1970 where no
    start is given, or "matlab"/"excel" day numbers. zone: of every time that does not state its own. data: variable
    that holds all channels as columns. columns: channel -> name, or number from 1, of its column; without an entry the
    channel's own name. factor: channel -> what its numbers are multiplied with to be in the unit of campaign.toml.
    lost: numbers that stand for a lost sample. fill_seconds: gaps up to so long are filled with NaN within a file.
    """

    path: Path
    files: str
    time: str | int | None
    time_unit: str
    zone: tzinfo | None
    start: str | None
    start_pattern: str | None
    start_format: str | None
    data: str | None
    columns: Mapping[str, str | int]
    factor: Mapping[str, float]
    separator: str
    decimal: str
    header: bool
    skip_rows: int
    lost: tuple[float, ...]
    fill_seconds: float


def read_description(path: str | Path, channels: tuple[str, ...]) -> Description:
    """Read convert.toml. Raises InputError for unknown keys, wrong kinds, a zone that is none, a path that leaves."""
    path = Path(path)
    raw = read_toml(path)
    for key in raw:
        if key not in DESCRIPTION_KEYS:
            raise InputError(str(path), f"unknown key '{key}'", nearest(key, DESCRIPTION_KEYS))
    files = _text(path, raw, "files")
    if files is None:
        raise InputError(str(path), "'files' is missing", "add a pattern such as files = \"*.csv\"")
    if PurePosixPath(files).is_absolute() or ".." in PurePosixPath(files).parts or "\\" in files:
        raise InputError(f"{path}, files", f"'{files}' leaves the folder of the sources", "give a pattern below it")
    time = raw.get("time")
    if time is not None and (isinstance(time, bool) or not isinstance(time, str | int)):
        raise InputError(f"{path}, time", f"{time!r} is no column", "give its name, or its number from 1")
    start, pattern = _text(path, raw, "start"), _text(path, raw, "start_pattern")
    if time is None and start is None and pattern is None:
        raise InputError(str(path), "says nothing of time", "add time (a column), start, or start_pattern")
    if start is not None and pattern is not None:
        raise InputError(str(path), "has both start and start_pattern", "keep one")
    unit = _text(path, raw, "time_unit") or "iso"
    if unit not in ("iso", *TIME_UNITS, *DAY_NUMBERS):
        known = ", ".join((*TIME_UNITS, *DAY_NUMBERS))
        raise InputError(f"{path}, time_unit", f"'{unit}' is unknown", f"use iso, {known}")
    if pattern is not None:
        name_pattern(pattern, f"{path}, start_pattern")
    return Description(
        path=path, files=files, time=time, time_unit=unit, zone=_zone(path, raw), start=start, start_pattern=pattern,
        start_format=_text(path, raw, "start_format"), data=_text(path, raw, "data"),
        columns=_columns(path, raw, channels), factor=_factors(path, raw, channels),
        separator=_text(path, raw, "separator") or ",", decimal=_text(path, raw, "decimal") or ".",
        header=_flag(path, raw, "header", True), skip_rows=int(_number(path, raw, "skip_rows", 0)),
        lost=_lost(path, raw), fill_seconds=_number(path, raw, "fill_seconds", 60.0),
    )


def _text(path: Path, raw: Mapping, key: str) -> str | None:
    value = raw.get(key)
    if value is not None and not (isinstance(value, str) and value):
        raise InputError(f"{path}, {key}", f"{value!r} is no text", "write it in quotes")
    return value


def _flag(path: Path, raw: Mapping, key: str, default: bool) -> bool:
    value = raw.get(key, default)
    if not isinstance(value, bool):
        raise InputError(f"{path}, {key}", f"{value!r} is not true or false", "write one of them")
    return value


def _number(path: Path, raw: Mapping, key: str, default: float) -> float:
    value = raw.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < 1e9:
        raise InputError(f"{path}, {key}", f"{value!r} is no number from 0", "give one")
    return float(value)


def _lost(path: Path, raw: Mapping) -> tuple[float, ...]:
    value = raw.get("lost", [])
    if not isinstance(value, list) or not all(isinstance(v, int | float) and not isinstance(v, bool) for v in value):
        raise InputError(f"{path}, lost", f"{value!r} is no list of numbers", "write such as [-999.0]")
    return tuple(float(v) for v in value)


def _zone(path: Path, raw: Mapping) -> tzinfo | None:
    """UTC, +02:00 or a name of the zones' data base."""
    text = _text(path, raw, "zone")
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
        raise InputError(f"{path}, zone", f"'{text}' is no time zone", "use UTC, +02:00 or Europe/Berlin") from None


def _columns(path: Path, raw: Mapping, channels: tuple[str, ...]) -> dict[str, str | int]:
    table = _table(path, raw, "columns", channels)
    for channel, column in table.items():
        good = isinstance(column, str) or (isinstance(column, int) and not isinstance(column, bool) and column > 0)
        if not good:
            raise InputError(f"{path}, columns, {channel}", f"{column!r} is no column",
                             "give a name, or a number from 1")
    found = {c: table.get(c, c) for c in channels}
    twice = [c for c in channels if list(found.values()).count(found[c]) > 1]
    if twice:
        raise InputError(f"{path}, columns", f"{' and '.join(twice)} are the same column", "give each channel its own")
    return found


def _factors(path: Path, raw: Mapping, channels: tuple[str, ...]) -> dict[str, float]:
    table = _table(path, raw, "factor", channels)
    for channel, value in table.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < abs(value) < 1e12:
            raise InputError(f"{path}, factor, {channel}", f"{value!r} is no factor", "give a number other than 0")
    return {c: float(table.get(c, 1.0)) for c in channels}


def _table(path: Path, raw: Mapping, key: str, channels: tuple[str, ...]) -> Mapping:
    table = raw.get(key, {})
    if not isinstance(table, dict):
        raise InputError(f"{path}, {key}", "is no table", f"write [{key}] and one line a channel")
    for channel in table:
        if channel not in channels:
            raise InputError(f"{path}, {key}", f"'{channel}' is no channel of campaign.toml",
                             nearest(channel, channels))
    return table
