"""The last line of a table that a logger was stopped in, or a copy broke off in."""

from __future__ import annotations

import io
import re
from pathlib import Path

from probupdate.campaign.description import Description
from probupdate.campaign.stated import NOT_A_NUMBER
from probupdate.campaign.table_layout import is_number, row_cells

# bytes at the end that are looked at; those of a character at most
END, ALIGNED = 65536, 4
MARKED = {"utf-16": 2, "utf-32": 4}


class _Beginning(io.RawIOBase):
    """The first bytes of a file."""

    def __init__(self, path: Path, size: int):
        self.file, self.left = path.open("rb"), size

    def readable(self) -> bool:
        return True

    def readinto(self, buffer) -> int:
        piece = self.file.read(min(len(buffer), self.left))
        buffer[: len(piece)] = piece
        self.left -= len(piece)
        return len(piece)

    def close(self) -> None:
        self.file.close()
        super().close()


def beginning(path: Path, encoding: str, size: int) -> io.TextIOWrapper:
    """The text of the first `size` bytes."""
    return io.TextIOWrapper(io.BufferedReader(_Beginning(path, size)), encoding=encoding, newline="")


def unfinished_line(path: Path, d: Description) -> tuple[int, str]:
    """(bytes of the file before its last line where that line is cut off, else of all; what there is to say).

    A last line without an end is cut where it has fewer cells than those before, or its last cell fewer decimals than
    any of theirs; where their decimals differ in number, or there are none, this does not show."""
    size = path.stat().st_size
    lines, width = last_lines(path, d.encoding)
    if len(lines) < 2 or lines[-1].endswith(("\n", "\r")) or not lines[-1].strip():
        return size, ""
    last, *before = (_row(line, d) or ("",) for line in reversed(lines) if line.strip())
    cells = [row[-1] for row in before if len(row) == len(before[0]) and row[-1]]
    numeric = [c for c in cells if is_number(c, d.decimal) and not _is_lost(c, d)]
    # of a table's only row the line above are names
    cells = numeric or cells[:-1]
    if not cells or len(last) == len(before[0]) and _is_lost(last[-1], d):
        return size, ""
    said = f"its last line has no end and is cut off ('...{lines[-1].strip()[-20:]}')"
    least, most = min(_decimals(c, d) for c in cells), max(_decimals(c, d) for c in cells)
    strange = numeric and not is_number(last[-1], d.decimal)
    if len(last) < len(before[0]) or not last[-1] or strange or _decimals(last[-1], d) < least:
        return size - width, f"{said}: it was left out"
    return size, "" if least == most > 0 else "its last line has no end, and was taken as whole"


def last_lines(path: Path, encoding: str) -> tuple[list[str], int]:
    """The last lines as text with their ends, and bytes of the very last."""
    size, mark = path.stat().st_size, MARKED.get(encoding.lower().replace("_", "-"), 0)
    with path.open("rb") as file:
        head = file.read(mark)
        file.seek(max(size - END - size % ALIGNED, mark) if mark else max(size - END, 0))
        cut = file.tell() > mark
        end = file.read()
    text = (head + end).decode(encoding, errors="ignore")
    lines = list(io.StringIO(text, newline=""))[1 if cut else 0:]
    if mark and lines:
        # with what there is of a last character
        return lines, len(lines[-1].encode(encoding)) - mark + size % mark
    return lines, len(end) - 1 - max(end.rfind(b"\n"), end.rfind(b"\r"))


def _row(line: str, d: Description) -> tuple[str, ...]:
    return row_cells(line, d.separator) if len(d.separator) == 1 else tuple(re.split(d.separator, line.strip()))


def _is_lost(cell: str, d: Description) -> bool:
    return cell.lower() in NOT_A_NUMBER or cell in d.lost


def _decimals(cell: str, d: Description) -> int:
    """Characters behind the decimal sign; all characters of what is not a number."""
    whole, sign, behind = cell.partition(d.decimal)
    return len(behind) if sign else 0 if is_number(cell, d.decimal) else len(whole)
