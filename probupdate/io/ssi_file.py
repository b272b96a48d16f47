"""Soil stiffness and mass of one joint in SubDyn's SSI file: lines of a value and a name such as Kxx or Mtxtx."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from probupdate.errors import InputError
from probupdate.io.fortran_text import number, read_lines, replace_words, strip_quotes, words, write_lines
from probupdate.runtime.arrays import frozen_array

AXES = ("x", "y", "z", "tx", "ty", "tz")
# SubDyn's own names: the upper triangle, column by column; of Kxy there is no Kyx
PLACES = {f"{a}{b}": (i, j) for j, b in enumerate(AXES) for i, a in enumerate(AXES[: j + 1])}
# of a matrix's terms, by the digits that they are written with
DIGITS = 0.01
# of computed terms, over the largest of translation or rotation
ROUNDING = 1e-12


@dataclass(frozen=True, eq=False, kw_only=True)
class SsiFile:
    """stiffness (6, 6) in N/m, N, N m and mass (6, 6) in kg, kg m, kg m2 at a joint: u_x, u_y, u_z, r_x, r_y, r_z.

    `lines` is the text as it was; `notes` says what SubDyn does not use of it.
    """

    name: str
    stiffness: np.ndarray
    mass: np.ndarray
    lines: tuple[str, ...]
    notes: tuple[str, ...] = ()


def read_ssi(path: str | Path, name: str | None = None) -> SsiFile:
    """Read an SSI file; terms that are not in it are zero, as in SubDyn."""
    return parse_ssi(read_lines(path), str(path), name or Path(path).name)


def parse_ssi(lines, where: str, name: str) -> SsiFile:
    matrices = {"k": np.zeros((6, 6)), "m": np.zeros((6, 6))}
    notes, seen = [], {}
    for at, line in enumerate(lines, 1):
        found = words(line)
        if not found or found[0].startswith("%"):
            continue
        key, value = _term(found)
        if value is None:
            raise InputError(f"{where}, line {at}", f"'{line.strip()}' is not a value and its name",
                             "write a line such as '5.04E+08 Kxx', comments behind !")
        place = PLACES.get(key[1:]) if key[0] in matrices else None
        if place is None:
            notes.append(f"{where}, line {at}: '{found[1]}' is none of SubDyn's names (Kxx, Kxy, Kyy, ... Ktztz, "
                         "Mxx, ...); SubDyn does not use it")
            continue
        if seen.setdefault(key, value) != value:
            raise InputError(f"{where}, line {at}", f"'{found[1]}' is given twice with different values", "keep one")
        matrix = matrices[key[0]]
        matrix[place] = matrix[place[::-1]] = value
    for word, matrix in zip(("stiffness", "mass"), matrices.values(), strict=True):
        if _least_share(matrix) < -DIGITS:
            raise InputError(where, f"its {word} is below zero for some motion, as that of no foundation is",
                             "check the signs of the diagonal and whether a coupling, such as Kxty, is too large")
    notes += _sign_words(where, matrices["k"])
    return SsiFile(name=name, stiffness=frozen_array(matrices["k"]), mass=frozen_array(matrices["m"]),
                   lines=tuple(lines), notes=tuple(notes))


def _least_share(matrix: np.ndarray) -> float:
    """The least eigenvalue (6, 6), each direction in a unit in which its own term is one. A term that is rounding
    beside others of its kind, as of a pile that nothing holds against torsion, is none."""
    own = np.abs(np.diag(matrix)).reshape(2, 3)
    unit = np.sqrt(np.maximum(own, ROUNDING * own.max(axis=1, keepdims=True))).ravel()
    unit[unit == 0] = 1.0
    return float(np.linalg.eigvalsh(matrix / np.outer(unit, unit))[0])


def _sign_words(where: str, stiffness: np.ndarray) -> list[str]:
    """Where a foundation that is pushed along x or y turns against the push, as none below its joint does."""
    for name, wrong in (("Kxty", stiffness[PLACES["xty"]] > 0), ("Kytx", stiffness[PLACES["ytx"]] < 0)):
        if wrong and abs(stiffness[PLACES[name[1:]]]) > DIGITS * np.sqrt(
                np.prod(np.diag(stiffness)[list(PLACES[name[1:]])])):
            return [f"{where}: {name} is {'above' if name == 'Kxty' else 'below'} zero: soil below its joint has Kxty "
                    "below and Kytx above zero, by the right-hand rule with z upwards; check the signs"]
    return []


def _term(found: list[str]) -> tuple[str, float | None]:
    """(lowered name, value) in either order."""
    if len(found) < 2:
        return "", None
    for value, key in ((found[0], found[1]), (found[1], found[0])):
        if number(value) is not None and number(key) is None:
            return strip_quotes(key).lower(), number(value)
    return "", None


def scaled_ssi(file: SsiFile, stiffness: np.ndarray, mass: np.ndarray) -> SsiFile:
    """The same file with other matrices (6, 6): values are replaced in their lines, terms it does not have are added
    at its end."""
    wanted: Mapping[str, np.ndarray] = {"k": np.asarray(stiffness, float), "m": np.asarray(mass, float)}
    lines, written = list(file.lines), set()
    for at, line in enumerate(lines):
        found = words(line)
        key, value = _term(found) if found and not found[0].startswith("%") else ("", None)
        if value is not None and key[0] in wanted and key[1:] in PLACES:
            written.add(key)
            new = float(wanted[key[0]][PLACES[key[1:]]])
            if new != value:
                lines[at] = replace_words(line, {0 if number(found[0]) is not None else 1: repr(new)})
    for kind, matrix in wanted.items():
        for pair, place in PLACES.items():
            if matrix[place] and kind + pair not in written:
                lines.append(f"{float(matrix[place])!r}\t{kind.upper()}{pair}")
    return parse_ssi(lines, file.name, file.name)


def write_ssi(file: SsiFile, path: str | Path) -> Path:
    return write_lines(path, file.lines)
