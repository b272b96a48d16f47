"""Parameter values put into a SubDyn file itself: property sets, soil files and masses as they are at theta."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import prod
from pathlib import Path

import numpy as np

from probupdate.io.fortran_text import replace_words, words
from probupdate.io.ssi_file import scaled_ssi
from probupdate.io.subdyn_file import BEAMS, SubDynFile, parse_again, read_subdyn
from probupdate.structure.parameter_table import read_toml
from probupdate.structure.subdyn_frame import SECTIONS
from probupdate.structure.subdyn_model import (
    SOIL_PARTS,
    ParameterEntry,
    SubDynDescription,
    named_file,
    read_description,
    targets_of,
)


def carried_masses(path: Path) -> tuple[str, ...]:
    """The parameters that act as line_mass in the SubDyn file of a TOML with [subdyn]."""
    if path.suffix != ".toml":
        return ()
    return tuple(p.name for p in _parameters_in_file(read_description(read_toml(path), path)) if p.acts == "line_mass")


def _parameters_in_file(description: SubDynDescription) -> tuple[ParameterEntry, ...]:
    """Those that do not act on its [tower]."""
    return tuple(p for p in description.parameter if description.tower is None
                 or not set(p.groups) & {"tower", "rotor_nacelle"})


def apply_values(path: Path, values: Mapping[str, float], remark: str = "") -> tuple[SubDynFile, tuple[str, ...]]:
    """The SubDyn file of a TOML with [subdyn] as it is at the values of its parameters (those not named stand at their
    initial value), and the names of parameters that act on its [tower] and so are not in it. `remark` goes into the
    file's second line. A line_mass is a raised density, the only word SubDyn has for it, with its rotary inertia."""
    path = Path(path)
    description = read_description(read_toml(path), path)
    file = read_subdyn(named_file(path, description.subdyn.file, "subdyn.file"), path.parent)
    own = _parameters_in_file(description)
    above = tuple(p.name for p in description.parameter if p not in own)
    targets = targets_of(file, description.model_copy(update={"parameter": own}), path)
    known = {p.name: p.initial for p in description.parameter} | {name: float(v) for name, v in values.items()}
    edit = _Edit(file)

    def factor(act: str, id: int) -> float:
        return prod(known[name] for name in targets(act, id))

    def total(act: str, id: int) -> float:
        return sum(known[name] for name in targets(act, id))

    for member in file.members:
        if member.kind == "rigid":
            continue
        ends = [_section(member.kind, file.set_of(member, end).values, stiff=factor("stiffness", member.id),
                         dense=factor("density", member.id), wall=factor("thickness", member.id),
                         loss=total("wall_loss", member.id)) for end in (0, 1)]
        carried = total("line_mass", member.id)
        for end, values in enumerate(_with_carried_mass(member.kind, ends, carried) if carried else ends):
            edit.set_of(member, end, values)
    for reaction in file.reactions:
        if reaction.ssi is None or all(reaction.fixed):
            continue
        stiffness = np.array(file.soil[reaction.ssi].stiffness)
        for act, index in SOIL_PARTS.items():
            stiffness[np.ix_(index, index)] *= factor(act, reaction.joint)
        edit.soil(reaction, stiffness * factor("soil", reaction.joint))
    for row in file.masses:
        edit.mass(row, factor("mass", row.id))
    for joint in file.joints:
        more = total("added_mass", joint.id)
        if more:
            edit.rows.setdefault("mass", []).append(f"{joint.id} {more!r} " + " ".join(["0.0"] * 9))
    return edit.file(remark), above


def _section(kind: str, old: tuple[float, ...], *, stiff: float, dense: float, wall: float, loss: float):
    """Numbers of a property set with stiffness, density and wall as factors, `loss` (m) off the outer wall."""
    if kind in BEAMS:
        thinner = old[3:5] if wall == 1 and not loss else (old[3] - 2 * loss, old[4] * wall - loss)
        return (old[0] * stiff, old[1] * stiff, old[2] * dense, *thinner, *old[5:])
    if kind == "cable":
        # the pretension with it, so that the rest length stays
        return (old[0] * stiff, old[1], old[2] * stiff, *old[3:])
    return tuple(v * stiff for v in old)


def _with_carried_mass(kind: str, ends: list[tuple[float, ...]], per_metre: float) -> list[tuple[float, ...]]:
    """Both ends of a beam with the density raised by a mass per metre."""
    middle = tuple(0.5 * (a + b) for a, b in zip(*ends, strict=True))
    # Simpson's rule: exact, as sizes change linearly between the ends and areas with their squares
    area = sum(w * SECTIONS[kind](*values).area for w, values in zip((1, 4, 1), (ends[0], middle, ends[1]),
                                                                     strict=True)) / 6
    return [(*values[:2], float(values[2] + per_metre / area), *values[3:]) for values in ends]


class _Edit:
    """Words replaced and rows added, put into the text at the end."""

    def __init__(self, file: SubDynFile):
        self.source = file
        self.words: dict[int, dict[int, str]] = {}
        self.rows: dict[str, list[str]] = {}
        self.soils = {}
        self._sets: dict[tuple, int] = {}

    def set_of(self, member, end: int, values: tuple[float, ...]) -> None:
        row = self.source.set_of(member, end)
        if values == row.values:
            return
        key = (member.kind, values)
        if key not in self._sets:
            used = [r.id for r in self.source.sets[member.kind]]
            self._sets[key] = max(used) + 1 + sum(kind == member.kind for kind, _ in self._sets)
            # older files have a column less
            width = sum(1 for w in words(self.source.lines[row.line - 1])[1:]) if member.kind == "arbitrary" else (
                len(values))
            shown = values[: min(width, len(values))]
            new_row = " ".join([str(self._sets[key]), *(repr(float(v)) for v in shown)])
            self.rows.setdefault(member.kind, []).append(new_row)
        self.words.setdefault(member.line, {})[3 + end] = str(self._sets[key])

    def soil(self, reaction, stiffness: np.ndarray) -> None:
        old = self.source.soil[reaction.ssi]
        if np.array_equal(stiffness, old.stiffness):
            return
        place = Path(reaction.ssi.replace("\\", "/"))
        name = place.with_name(f"{place.stem}_{reaction.joint}{place.suffix}").as_posix()
        if name in self.source.soil:
            name = place.with_name(f"{place.stem}_{reaction.joint}_new{place.suffix}").as_posix()
        self.soils[name] = replace(scaled_ssi(old, stiffness, old.mass), name=name)
        self.words.setdefault(reaction.line, {})[7] = f'"{name}"'

    def mass(self, row, factor: float) -> None:
        if factor == 1:
            return
        given = len(words(self.source.lines[row.line - 1]))
        for k in range(1, min(given, 8)):
            self.words.setdefault(row.line, {})[k] = repr(float(row.values[k - 1] * factor))

    def file(self, remark: str) -> SubDynFile:
        lines = [replace_words(text, self.words[at]) if at in self.words else text
                 for at, text in enumerate(self.source.lines, 1)]
        if remark:
            lines[1] = f"{lines[1]} | {remark}"
        tables = {**self.source.sets, "mass": self.source.masses}
        # from below, so that lines above keep their numbers
        for kind in sorted(self.rows, key=lambda k: -self.source.counts[k]):
            at, had = self.source.counts[kind], len(tables[kind])
            lines[at - 1] = replace_words(lines[at - 1], {0: str(had + len(self.rows[kind]))})
            below = at + 2 + had
            lines[below:below] = [f"  {row}" for row in self.rows[kind]]
        return parse_again(self.source, lines, self.soils)
