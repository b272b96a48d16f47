"""Lines of OpenFAST's text files: words as Fortran reads them, and replacing one of them without touching the rest."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from probupdate.errors import InputError
from probupdate.io.files import read_bytes, write_bytes

# a quoted word, or what stands between blanks and commas
WORD = re.compile(r"\"[^\"]*\"|'[^']*'|[^\s,\"']+")
LARGEST = 64 * 2**20
TRUE, FALSE = ("true", "t", ".true.", ".t."), ("false", "f", ".false.", ".f.")


def read_lines(path: str | Path) -> tuple[str, ...]:
    """The lines of a text file without their ends; raises InputError where there is none."""
    # bytes: carriage returns are cut below, so that a lone form feed or the like does not count as a line
    text = read_bytes(path, largest=LARGEST).decode("utf-8", errors="surrogateescape")
    if "\0" in text:
        raise InputError(str(path), "is not a text file", "give OpenFAST's input file")
    refuse_cut_number(path, text)
    return tuple(line.rstrip("\r") for line in text.removesuffix("\n").split("\n"))


def refuse_cut_number(path: str | Path, text: str) -> None:
    """Raises InputError where a text ends in a number without a line's end, as one that was cut off within it does."""
    last = re.split(r"[\s,]", text[-40:])[-1]
    if number(last) is not None:
        raise InputError(str(path), f"ends in the number {last} without a line's end, so that digits may lack",
                         "copy it again, or end its last line")


def write_lines(path: str | Path, lines: Sequence[str]) -> Path:
    return write_bytes(path, ("\n".join(lines) + "\n").encode("utf-8", errors="surrogateescape"))


def words(line: str) -> list[str]:
    """The words before a comment (a word that begins with ! or #), quotes kept."""
    found = []
    for match in WORD.finditer(line):
        if match[0][0] in "!#":
            break
        found.append(match[0])
    return found


def strip_quotes(word: str) -> str:
    return word[1:-1].strip() if len(word) > 1 and word[0] in "\"'" else word


def number(word: str) -> float | None:
    """None where the word is no finite number; exponents may be written with D."""
    try:
        value = float(re.sub("[dD]", "e", word))
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def integer(word: str) -> int | None:
    value = number(word)
    return None if value is None or value != int(value) else int(value)


def logical(word: str) -> bool | None:
    lowered = strip_quotes(word).lower()
    return True if lowered in TRUE else False if lowered in FALSE else None


def replace_words(line: str, changes: Mapping[int, str]) -> str:
    """The line with word k (from zero) replaced; blanks, other words and the comment stay."""
    spans = [m.span() for m in WORD.finditer(line)]
    for k in sorted(changes, reverse=True):
        start, end = spans[k]
        line = line[:start] + changes[k] + line[end:]
    return line
