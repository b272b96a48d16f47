"""Tables of an export: CSV with remarks behind #, as they are written and read back."""

from __future__ import annotations

import csv
import re
from pathlib import Path

from probupdate.errors import InputError, parsing
from probupdate.io.files import read_own_text


def read_table(path: str | Path) -> dict[str, list]:
    """A CSV of an export: column -> values, whole numbers, floats, texts, None where empty."""
    lines = [line for line in read_own_text(path, "export it again").splitlines() if not line.startswith("#")]
    with parsing(str(path), "is not a table", "export it again"):
        rows = list(csv.reader(lines))
        if not rows or any(len(row) != len(rows[0]) for row in rows):
            raise InputError(str(path), "has rows of different length, or none", "export it again")

    def value(text: str):
        if text == "":
            return None
        if re.fullmatch(r"-?\d{1,18}", text):
            return int(text)
        try:
            return float(text)
        except ValueError:
            return text

    return {name: [value(row[k]) for row in rows[1:]] for k, name in enumerate(rows[0])}
