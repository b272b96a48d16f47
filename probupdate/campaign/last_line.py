"""The last line of a table that a logger was stopped in, or a copy broke off in."""

from __future__ import annotations

import io
import re
from collections.abc import Collection
from pathlib import Path

from probupdate.campaign.stated import NOT_A_NUMBER
from probupdate.campaign.table_layout import is_number, row_cells
from probupdate.errors import InputError

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


def open_beginning(path: Path, encoding: str, size: int) -> io.TextIOWrapper:
    """The text of the first `size` bytes."""
    return io.TextIOWrapper(io.BufferedReader(_Beginning(path, size)), encoding=encoding, newline="")


def refuse_unfinished(path: Path, encoding: str = "utf-8", separator: str = ",", decimal: str = ".") -> None:
    """Raises InputError for a table whose last line is cut off."""
    size, note = unfinished_line(path, encoding, separator, decimal)
    if size < path.stat().st_size:
        raise InputError(str(path), note.partition(":")[0], "copy the file again, or end that line if it is whole")


def unfinished_line(
    path: Path, encoding: str = "utf-8", separator: str = ",", decimal: str = ".", lost: Collection[float | str] = ()
) -> tuple[int, str]:
    """(bytes of the file before its last line where that line is cut off, else of all; what there is to say).

    A last line without an end is cut where it has fewer cells than those before, or its last cell fewer decimals than
    any of theirs; where their decimals differ in number, or there are none, this does not show."""
    size = path.stat().st_size
    lines, width = last_lines(path, encoding)
    if len(lines) < 2 or lines[-1].endswith(("\n", "\r")) or not lines[-1].strip():
        return size, ""
    last, *before = (_row(line, separator) or ("",) for line in reversed(lines) if line.strip())
    cells = [row[-1] for row in before if len(row) == len(before[0]) and row[-1]]
    numeric = [c for c in cells if is_number(c, decimal) and not _is_lost(c, lost)]
    # of a table's only row the line above are names
    cells = numeric or cells[:-1]
    if not cells or len(last) == len(before[0]) and _is_lost(last[-1], lost):
        return size, ""
    said = f"its last line has no end and is cut off ('...{lines[-1].strip()[-20:]}')"
    least, most = (pick(_decimals(c, decimal) for c in cells) for pick in (min, max))
    strange = numeric and not is_number(last[-1], decimal)
    if len(last) < len(before[0]) or not last[-1] or strange or _decimals(last[-1], decimal) < least:
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


def _row(line: str, separator: str) -> tuple[str, ...]:
    return row_cells(line, separator) if len(separator) == 1 else tuple(re.split(separator, line.strip()))


def _is_lost(cell: str, lost: Collection[float | str]) -> bool:
    return cell.lower() in NOT_A_NUMBER or cell in lost


def _decimals(cell: str, decimal: str) -> int:
    """Characters behind the decimal sign; all characters of what is not a number."""
    whole, sign, behind = cell.partition(decimal)
    return len(behind) if sign else 0 if is_number(cell, decimal) else len(whole)
