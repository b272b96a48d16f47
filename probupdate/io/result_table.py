"""Results as pandas tables with their units, and as the one JSON object that a command's --json prints."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pandas as pd

# of a column, by the end of its name; "-" of all others: shares, ratios, counts, texts
UNIT_OF_ENDING = {
    "hz": "Hz",
    "m": "m",
    "s": "s",
    "ms": "ms",
    "h": "h",
    "deg": "deg",
    "kg": "kg",
    "mps": "m/s",
    "mps2": "m/s2",
    "kw": "kW",
    "db": "dB",
    "mpa": "MPa",
    "a": "a",
}
# of rows whose numbers have the unit that stands beside them
OWN_UNIT = "as `unit` says"


def table_of(
    rows: Iterable[Any], columns: Sequence[str] = (), *, units: Mapping[str, str] | None = None
) -> pd.DataFrame:
    """A table of dataclasses or mappings, its columns in their order (`columns` where there is no row), with the unit
    of each in `attrs["units"]`: as given, else by the end of its name."""
    import pandas as pd

    rows = [dict(r) if isinstance(r, Mapping) else asdict(r) for r in rows]
    return with_units(pd.DataFrame(rows, columns=list(columns) or (list(rows[0]) if rows else [])), units)


def with_units(table: pd.DataFrame, units: Mapping[str, str] | None = None) -> pd.DataFrame:
    """A copy of the table with `attrs["units"]`."""
    labelled = table.copy(deep=False)
    known = dict(units or {})
    labelled.attrs = {"units": {str(c): known.get(str(c)) or _unit(str(c)) for c in labelled.columns}}
    return labelled


def _unit(name: str) -> str:
    stem, _, ending = name.removesuffix("_std").rpartition("_")
    return UNIT_OF_ENDING.get(ending, "-") if stem else "-"


def files_table(**kinds: Iterable[Path]) -> pd.DataFrame:
    """A row a file: what it is (the argument's name) and its path."""
    return table_of([{"what": what, "path": str(p)} for what, paths in kinds.items() for p in paths], ("what", "path"))


def json_object(command: str, summary: str, table: pd.DataFrame, files: Iterable[Any] = (), **more: Any) -> str:
    """One JSON object: command, summary (lines), files (written), table {columns: [{name, unit}], rows: [[...]]}, and
    what else a command says of its own. null stands for what is not a number."""
    units = table.attrs.get("units", {})
    content = {
        "command": command,
        "summary": summary.splitlines(),
        "files": [str(f) for f in files],
        "table": {
            "columns": [{"name": str(c), "unit": units.get(str(c), "-")} for c in table.columns],
            "rows": [[plain_value(v) for v in row] for row in table.itertuples(index=False, name=None)],
        },
    }
    return json.dumps(content | {k: plain_value(v) for k, v in more.items()}, allow_nan=False)


def plain_value(value: Any) -> Any:
    """As JSON has it: numbers that are none and missing times as null, times as ISO 8601, arrays as lists."""
    if isinstance(value, Mapping):
        return {str(k): plain_value(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return plain_value(value.tolist())
    if isinstance(value, list | tuple | set):
        return [plain_value(v) for v in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, complex):
        return [plain_value(value.real), plain_value(value.imag)]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    if value is None or isinstance(value, str):
        return value
    if hasattr(value, "isoformat"):
        return value.isoformat() if value == value else None
    return str(value)


def plural(count: int, noun: str) -> str:
    """A number of things, in words: '1 file', '2 files'."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
