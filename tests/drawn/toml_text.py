"""TOML of plain tables, as a user's editor would hold it."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping


def value(x) -> str:
    if isinstance(x, bool):
        return str(x).lower()
    if isinstance(x, str):
        return json.dumps(x, ensure_ascii=False)
    if isinstance(x, int):
        return str(x)
    if isinstance(x, float):
        return repr(float(x))
    if isinstance(x, Mapping):
        return "{ " + ", ".join(f"{json.dumps(k)} = {value(v)}" for k, v in x.items()) + " }"
    return "[" + ", ".join(value(v) for v in x) + "]"


def text(tables: Mapping, header: str = "") -> str:
    """Scalars first, then tables, lists of tables as [[...]]."""
    plain = {k: v for k, v in tables.items() if not isinstance(v, Mapping) and not _rows(v)}
    lines = [f"{k} = {value(v)}" for k, v in plain.items()]
    for key, entry in tables.items():
        key = key if re.fullmatch("[A-Za-z0-9_-]+", key) else json.dumps(key)
        name = f"{header}.{key}" if header else key
        if isinstance(entry, Mapping):
            lines += ["", f"[{name}]", text(entry, name)]
        elif _rows(entry):
            for row in entry:
                lines += ["", f"[[{name}]]", text(row, name)]
    return "\n".join(lines).strip("\n") + "\n"


def _rows(x) -> bool:
    return isinstance(x, (list, tuple)) and bool(x) and all(isinstance(row, Mapping) for row in x)
