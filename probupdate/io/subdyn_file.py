"""SubDyn's input file (OpenFAST v3, v4 and v5) with its SSI files: read, changed, written, nothing lost.

SubDyn reads by position; headings are free text there. So does this reader: it distinguishes the layouts by what stands
where, and every mistake names file and line. The text is kept line by line, changes replace words in it.
Source of the layout: OpenFAST's SubDyn manual, section input files, and its reader's order (Apache-2.0).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import NoReturn

import numpy as np

from probupdate.errors import InputError
from probupdate.io.files import resolve_path
from probupdate.io.fortran_text import integer, logical, number, read_lines, strip_quotes, words, write_lines
from probupdate.io.ssi_file import SsiFile, read_ssi, write_ssi

# in the first line of files that are easily taken for SubDyn's
OTHER_MODULE = re.compile(r"\b(?:(?:Elasto|Hydro|Beam|Aero|Servo|Moor|Soil)Dyn|SeaState|InflowWind|OpenFAST)\b", re.I)
JOINT_KINDS = {1: "cantilever", 2: "universal", 3: "revolute", 4: "ball"}
MEMBER_KINDS = {"1": "circular", "1c": "circular", "1r": "rectangular", "-1": "rectangular", "2": "cable", "3": "rigid",
                "4": "arbitrary", "5": "spring"}
BEAMS = ("circular", "rectangular", "arbitrary")
# the tables behind the members: kind -> numbers of columns, the name of the count
SETS = {"circular": ((6,), "NPropSets"), "rectangular": ((7,), "NPropSets"), "arbitrary": ((10, 11), "NXPropSets"),
        "cable": ((4, 5), "NCablePropSets"), "rigid": ((2,), "NRigidPropSets"), "spring": ((22,), "NSpringPropSets"),
        "cosine": ((10,), "NCOSMs"), "mass": ((5, 11), "NCmass")}
# what the heading of one alone says, also in older files
HEADED = {"cable": "CABLE PROP", "rigid": "RIGID LINK", "spring": "SPRING ELEM", "cosine": "COSINE MATRICES",
          "mass": "CONCENTRATED MASS"}
# how many of them a file has shows its layout
ORDERS = {
    4: ("circular", "arbitrary", "cosine", "mass"),
    6: ("circular", "arbitrary", "cable", "rigid", "cosine", "mass"),
    7: ("circular", "arbitrary", "cable", "rigid", "spring", "cosine", "mass"),
    8: ("circular", "rectangular", "arbitrary", "cable", "rigid", "spring", "cosine", "mass"),
}


@dataclass(frozen=True, kw_only=True)
class Joint:
    id: int
    position_m: tuple[float, float, float]
    kind: str
    direction: tuple[float, float, float]
    stiffness: float
    line: int


@dataclass(frozen=True, kw_only=True)
class Reaction:
    """`fixed` (6,): the directions held; `ssi` is the name of its soil file."""

    joint: int
    fixed: tuple[bool, ...]
    ssi: str | None
    line: int


@dataclass(frozen=True, kw_only=True)
class Interface:
    joint: int
    transition_piece: int
    line: int


@dataclass(frozen=True, kw_only=True)
class Member:
    """From joint to joint with a property set at either end; `spin_deg` about its own axis, or `cosine` an id."""

    id: int
    joints: tuple[int, int]
    sets: tuple[int, int]
    kind: str
    spin_deg: float
    cosine: int | None
    line: int


@dataclass(frozen=True, kw_only=True)
class Row:
    """A row of a table: its id (a joint's for concentrated masses) and the numbers behind it."""

    id: int
    values: tuple[float, ...]
    line: int


@dataclass(frozen=True, eq=False, kw_only=True)
class SubDynFile:
    """What a SubDyn input file says. Lines count from one. `sets`: kind -> property sets as rows; `settings`: name ->
    word, for what stands above the joints; `counts`: table behind the members -> line of its count; `layout`: v3, v4.0
    (members by cosine matrices), v4.1 (with rectangular sections and spin) or v5 (with transition pieces). `soil`: name
    -> SSI file. `notes`: what SubDyn takes otherwise than it looks.
    """

    where: str
    layout: str
    settings: Mapping[str, str]
    joints: tuple[Joint, ...]
    reactions: tuple[Reaction, ...]
    interfaces: tuple[Interface, ...]
    members: tuple[Member, ...]
    sets: Mapping[str, tuple[Row, ...]]
    masses: tuple[Row, ...]
    cosines: tuple[Row, ...]
    soil: Mapping[str, SsiFile]
    notes: tuple[str, ...]
    lines: tuple[str, ...]
    counts: Mapping[str, int]

    @property
    def n_div(self) -> int:
        return int(self.settings["NDiv"])

    @property
    def shear(self) -> bool:
        """Timoshenko, not Euler-Bernoulli, beams."""
        return self.settings["FEMMod"] == "3"

    def set_of(self, member: Member, end: int = 0) -> Row:
        """The property set at an end of a member."""
        return self._rows[member.kind, member.sets[end]]

    @cached_property
    def _rows(self) -> dict[tuple[str, int], Row]:
        return {(kind, row.id): row for kind, rows in self.sets.items() for row in rows}


def read_subdyn(path: str | Path, root: Path | None = None) -> SubDynFile:
    """Read a SubDyn input file and the SSI files it names, which lie in the folder `root` (its own where None) or
    below."""
    path = Path(path)
    lines = read_lines(path)
    try:
        return parse_subdyn(lines, str(path), lambda name, line: _read_soil(path, name, line, root))
    except InputError:
        other = OTHER_MODULE.search(lines[0])
        if other is None or "subdyn" in lines[0].lower():
            raise
        raise InputError(f"{path}, line 1", f"is an input file of {other[0]}, not of SubDyn", "give the file that "
                         "SubFile names in the .fst; ElastoDyn's goes under [tower] of a TOML beside it") from None


def _read_soil(path: Path, name: str, line: int, root: Path | None) -> SsiFile:
    file = resolve_path(name, path.resolve().parent, f"{path}, line {line}", root=root,
                        remedy="put the SSI file beside the input file or below, or the model's TOML above both")
    if not file.is_file():
        raise InputError(f"{path}, line {line}", f"there is no SSI file '{name}'", "put it beside the input file")
    return read_ssi(file, name)


# what older files have behind the columns of a table
EXTRA = {"the joints": "JointDamp is not used, a damping of the joint"}


class _Reader:
    """The lines one after another; errors name file and line."""

    def __init__(self, lines: Sequence[str], where: str):
        self.lines, self.where, self.at = lines, where, 0
        self.beyond: dict[str, list[int]] = {}

    def fail(self, problem: str, remedy: str, line: int | None = None) -> NoReturn:
        raise InputError(f"{self.where}, line {line or self.at}", problem, remedy)

    def line(self, what: str) -> str:
        if self.at >= len(self.lines):
            raise InputError(f"{self.where}, line {len(self.lines)}", f"the file ends where {what} is expected",
                             "complete it; SubDyn's input has all its sections, empty ones too")
        self.at += 1
        return self.lines[self.at - 1]

    def peek(self) -> str:
        return self.lines[self.at] if self.at < len(self.lines) else ""

    def heading(self, what: str) -> str:
        text = self.line(f"the heading '{what}'")
        found = words(text)
        if found and number(found[0]) is not None:
            self.fail(f"'{text.strip()[:40]}' stands where the heading '{what}' is expected",
                      "check the count of the table above it")
        return text

    def word(self, name: str) -> str:
        found = words(self.line(name))
        if not found:
            self.fail(f"{name} is missing", f"write '<value> {name}'")
        return strip_quotes(found[0])

    def whole(self, name: str, least: int | None = None) -> int:
        word = self.word(name)
        value = integer(word)
        if value is None or (least is not None and value < least):
            bound = "" if least is None else f" of at least {least}"
            self.fail(f"{name} is '{word}', no whole number{bound}", f"write '<number> {name}'; check that no line "
                      "above is missing or too many")
        return value

    def table(self, title: str, count: str, least: int = 0) -> list[tuple[int, list[str]]]:
        """The rows (line, words) of a table behind its heading."""
        n = self.whole(count, least)
        counted = self.at
        for what in ("names", "units"):
            found = words(self.line(f"the columns' {what} of {title}"))
            if len(found) > 1 and all(number(w) is not None for w in found):
                self.fail(f"a row stands where the columns' {what} of {title} are expected", "put that line back")
        rows = []
        for k in range(n):
            text = self.line(f"row {k + 1} of {n} of {title}")
            found = words(text)
            if not found or integer(found[0]) is None:
                self.fail(f"row {k + 1} of {n} of {title} is expected, not '{text.strip()[:40]}'",
                          f"check {count} in line {counted}")
            rows.append((self.at, found))
        return rows

    def numbers(self, line: int, found: list[str], allowed: Sequence[int], title: str) -> list[float]:
        """The leading numbers of a row, as many as the table has columns; what stands behind them SubDyn passes over,
        and numbers above zero there are reported (`skipped_tables`)."""
        values = []
        for word in found:
            value = number(word)
            if value is None:
                break
            values.append(value)
        most = max(allowed)
        # between two widths a row of the wider one lacks its end
        if len(values) < most and len(values) not in allowed:
            wanted = " or ".join(str(n) for n in allowed)
            odd = f", the next is '{found[len(values)]}'" if len(values) < len(found) else ""
            self.fail(f"{len(values)} numbers in a row of {title}{odd}, {wanted} expected", "complete the row", line)
        if any(values[most:]):
            self.beyond.setdefault(title, []).append(line)
        return values[:most]

    def skipped_tables(self) -> list[str]:
        """A sentence for each table with numbers behind its columns."""
        return [f"{self.where}, line {at[0]}: SubDyn passes over what stands behind the columns of {title}"
                f"{f' (and in {len(at) - 1} more lines)' if at[1:] else ''}: {EXTRA.get(title, 'not used here either')}"
                for title, at in self.beyond.items()]

    def id(self, line: int, word: str, title: str) -> int:
        value = integer(word)
        if value is None or value < 1:
            self.fail(f"'{word}' is no identity number in {title}", "write a whole number above zero", line)
        return value


def parse_subdyn(lines: Sequence[str], where: str, soil_of) -> SubDynFile:
    """`soil_of(name, line)` gives an SSI file of that name."""
    r, notes = _Reader(lines, where), []
    settings, has_initial = _settings(r)
    joints, old_joints = _joints(r)
    r.heading("BASE REACTION JOINTS")
    reactions = _reactions(r)
    r.heading("INTERFACE JOINTS")
    interfaces, pieces = _interfaces(r, notes)
    r.heading("MEMBERS")
    member_rows = r.table("the members", "NMembers", 1)
    tables, counts = _sets(r)
    order = tuple(counts)
    spin = "rectangular" in order
    layout = "v5" if has_initial or pieces else "v4.1" if spin else "v3" if len(order) < 7 or old_joints else "v4.0"
    members = _members(r, member_rows, spin)
    if r.at >= len(lines) or not any(words(line) for line in lines[r.at :]):
        notes.append(f"{where}: ends before its OUTPUT section; SubDyn itself will not read it")
    notes += r.skipped_tables()
    notes += _list_unused(where, settings, tables["cable"])
    file = SubDynFile(
        where=where, layout=layout, settings=settings, joints=joints, reactions=reactions, interfaces=interfaces,
        members=members, sets={k: rows for k, rows in tables.items() if k not in ("cosine", "mass")},
        masses=tables["mass"], cosines=tables["cosine"], soil={}, notes=(), lines=tuple(lines), counts=counts,
    )
    _check_references(r, file)
    _check_sizes(r, file)
    soil = {}
    for reaction in reactions:
        if reaction.ssi is not None and reaction.ssi not in soil:
            soil[reaction.ssi] = soil_of(reaction.ssi, reaction.line)
    notes += _soil_notes(where, reactions, soil)
    return replace(file, soil=soil, notes=tuple(notes))


def _settings(r: _Reader) -> tuple[dict[str, str], bool]:
    for text in ("header line 1", "header line 2"):
        r.line(text)
    settings = {}
    r.heading("SIMULATION CONTROL")
    for name in ("Echo", "SDdeltaT", "IntMethod", "SttcSolve"):
        settings[name] = r.word(name)
    # v3 and early v4 have one more there
    if _is_logical(r.peek()):
        settings["GuyanLoadCorrection"] = r.word("GuyanLoadCorrection")
    r.heading("FEA and CRAIG-BAMPTON PARAMETERS")
    settings["FEMMod"] = str(r.whole("FEMMod"))
    if settings["FEMMod"] not in ("1", "3"):
        r.fail(f"FEMMod {settings['FEMMod']} is not built",
               "take 1 (Euler-Bernoulli) or 3 (Timoshenko), as SubDyn does")
    settings["NDiv"] = str(r.whole("NDiv", 1))
    # and here
    if _is_logical(r.peek()):
        settings["CBMod"] = r.word("CBMod")
    n_modes = r.whole("Nmodes")
    settings["Nmodes"] = str(n_modes)
    settings["JDampings"] = " ".join(_mode_dampings(r, n_modes))
    if words(r.peek()) and number(words(r.peek())[0]) is not None:
        settings |= _guyan_damping(r)
    r.heading("STRUCTURE JOINTS, or INITIAL RIGID-BODY POSITION")
    following = words(r.peek())
    if following and integer(following[0]) is not None and not (
        len(following) >= 6 and all(number(w) is not None for w in following[:6])
    ):
        return settings, False
    for what in ("names", "units"):
        r.line(f"the {what} of the initial position")
    found = words(r.line("the initial position"))
    if len(found) < 6 or any(number(w) is None for w in found[:6]):
        r.fail("the initial rigid-body position is not six numbers", "write six; for a file of v4 check that NJoints "
               "stands below the heading of the joints")
    settings["InitialPosition"] = " ".join(found[:6])
    r.heading("STRUCTURE JOINTS")
    return settings, True


def _mode_dampings(r: _Reader, n_modes: int) -> list[str]:
    """JDampings, read on as Fortran does where a line has too few numbers and nothing else."""
    ratios = words(r.line("JDampings"))
    given = [w for w in ratios if number(w) is not None]
    while (len(given) == len(ratios) and len(given) < n_modes and words(r.peek())
           and number(words(r.peek())[0]) is not None):
        following = words(r.peek())
        if len(following) > 1 and number(following[1]) is None and "guyan" in following[1].lower():
            break
        ratios = words(r.line("JDampings"))
        given += [w for w in ratios if number(w) is not None]
        if len(given) < n_modes and any(number(w) is None for w in ratios):
            break
    return given


def _guyan_damping(r: _Reader) -> dict[str, str]:
    settings = {"GuyanDampMod": str(r.whole("GuyanDampMod"))}
    pair = [w for w in words(r.line("RayleighDamp")) if number(w) is not None][:2]
    settings["RayleighDamp"] = " ".join(pair)
    size = r.whole("GuyanDampSize", 0)
    settings["GuyanDampSize"] = str(size)
    for row in range(size):
        found = words(r.line(f"row {row + 1} of the Guyan damping matrix"))
        if len(found) < size or any(number(w) is None for w in found[:size]):
            r.fail(f"row {row + 1} of the Guyan damping matrix has not {size} numbers", "complete it")
        settings[f"GuyanDampMat{row + 1}"] = " ".join(found[:size])
    return settings


def _is_logical(text: str) -> bool:
    found = words(text)
    return bool(found) and logical(found[0]) is not None


def _joints(r: _Reader) -> tuple[tuple[Joint, ...], bool]:
    rows = r.table("the joints", "NJoints", 2)
    joints, seen, old = [], {}, False
    for line, found in rows:
        values = r.numbers(line, found, (4, 9), "the joints")
        old = old or len(values) == 4
        values += [1.0, 0.0, 0.0, 0.0, 0.0][: 9 - len(values)]
        id = r.id(line, found[0], "the joints")
        if id in seen:
            r.fail(f"joint {id} stands in line {seen[id]} already", "number each joint once", line)
        seen[id] = line
        kind = JOINT_KINDS.get(int(values[4]))
        if kind is None or values[4] != int(values[4]):
            r.fail(f"joint {id} is of type {values[4]:g}", "take 1 cantilever, 2 universal, 3 revolute, 4 ball", line)
        if kind == "revolute" and not any(values[5:8]):
            r.fail(f"joint {id} is revolute about no axis", "give JointDirX, JointDirY, JointDirZ", line)
        if kind == "cantilever" and values[8] > 0:
            r.fail(f"joint {id} is rigid and has a stiffness of {values[8]:g}", "write 0; SubDyn refuses it too", line)
        joints.append(Joint(id=id, position_m=(values[1], values[2], values[3]), kind=kind,
                            direction=(values[5], values[6], values[7]), stiffness=values[8], line=line))
    return tuple(joints), old


def _reactions(r: _Reader) -> tuple[Reaction, ...]:
    result = []
    for line, found in r.table("the base reaction joints", "NReact"):
        id = r.id(line, found[0], "the base reaction joints")
        flags = []
        for word in found[1:7]:
            flag = integer(word)
            if flag is None and (said := logical(word)) is not None:
                flag = int(said)
            if flag not in (0, 1):
                r.fail(f"'{word}' is not a flag of joint {id}", "write 1 (held) or 0 (free)", line)
            flags.append(bool(flag))
        if len(flags) not in (0, 6):
            r.fail(f"{len(flags)} flags of joint {id}, 6 expected", "complete the row", line)
        rest = found[7:8]
        name = strip_quotes(rest[0]) if rest else ""
        result.append(Reaction(joint=id, fixed=tuple(flags) or (True,) * 6, ssi=name or None, line=line))
    seen = {}
    for reaction in result:
        if reaction.joint in seen:
            r.fail(f"joint {reaction.joint} stands in line {seen[reaction.joint]} already", "keep one", reaction.line)
        seen[reaction.joint] = reaction.line
    return tuple(result)


def _interfaces(r: _Reader, notes: list[str]) -> tuple[tuple[Interface, ...], bool]:
    result, widths = [], set()
    for line, found in r.table("the interface joints", "NInterf"):
        values = r.numbers(line, found, (1, 2, 7, 8), "the interface joints")
        widths.add(len(values))
        id = r.id(line, found[0], "the interface joints")
        with_piece = len(values) in (2, 8)
        flags = values[2:] if with_piece else values[1:]
        if not all(flags):
            notes.append(f"{r.where}, line {line}: SubDyn wants every direction of an interface joint locked to the "
                         "transition piece and will not read this row")
        result.append(Interface(joint=id, transition_piece=int(values[1]) if with_piece else 1, line=line))
    if len(widths & {2, 8}) and len(widths & {1, 7}):
        r.fail("some interface joints name a transition piece and others do not", "give TPID in every row or in none",
               result[-1].line)
    return tuple(result), bool(widths & {2, 8})


def _members(r: _Reader, rows, spin: bool) -> tuple[Member, ...]:
    members, seen = [], {}
    for line, found in rows:
        if len(found) < 5:
            r.fail(f"{len(found)} words in a row of the members, 7 expected", "complete the row", line)
        id, *rest = (r.id(line, word, "the members") for word in found[:5])
        if id in seen:
            r.fail(f"member {id} stands in line {seen[id]} already", "number each member once", line)
        seen[id] = line
        kind = MEMBER_KINDS.get(strip_quotes(found[5]).lower() if len(found) > 5 else "1c")
        if kind is None:
            r.fail(f"member {id} is of type '{found[5]}'", "take 1c, 1r, 2 cable, 3 rigid, 4 arbitrary, 5 spring", line)
        last = number(found[6]) if len(found) > 6 else -1.0
        if last is None:
            r.fail(f"the spin or cosine matrix of member {id} is '{found[6]}', no number", "write 0, or -1", line)
        turned = kind in BEAMS and spin
        if not turned and last != int(last):
            r.fail(f"the cosine matrix of member {id} is {last:g}", "write its whole number, or -1", line)
        if rest[0] == rest[1]:
            r.fail(f"member {id} begins and ends at joint {rest[0]}", "correct its joints", line)
        if kind not in ("circular", "rectangular") and rest[2] != rest[3]:
            r.fail(f"member {id} ({kind}) has two property sets", "give it one at both ends, as SubDyn wants", line)
        cosine = None if turned or kind in ("cable", "rigid") or last <= 0 else int(last)
        members.append(Member(id=id, joints=(rest[0], rest[1]), sets=(rest[2], rest[3]), kind=kind, cosine=cosine,
                              spin_deg=last if turned else 0.0, line=line))
    return tuple(members)


def _sets(r: _Reader) -> tuple[dict[str, tuple[Row, ...]], dict[str, int]]:
    """The tables behind the members up to the OUTPUT section, which begins with a logical; and, for those the file has,
    the lines of their counts."""
    found, titles = [], []
    while r.at < len(r.lines):
        start = r.at
        heading = r.heading(f"table {len(found) + 1} behind the members")
        following = words(r.peek())
        if not following or integer(following[0]) is None:
            if any(words(line) for line in r.lines[start:]) and not _is_logical(r.peek()):
                r.fail(f"'{heading.strip()[:40]}' is neither the heading of a table, with its count below, nor that of "
                       "the OUTPUT section, with SumPrint below", "take out blank lines and comments between tables: "
                       "SubDyn reads by place")
            r.at = start
            break
        titles.append(heading.upper())
        found.append((r.at + 1, r.table(f"'{heading.strip(' -')[:40]}'", "the count of the table")))
    order = ORDERS.get(len(found))
    if len(found) == 7 and any("RECT" in title for title in titles):
        order = tuple(kind for kind in ORDERS[8] if kind != "spring")
    if order is None:
        r.fail(f"{len(found)} tables between the members and the OUTPUT section, {', '.join(map(str, ORDERS))} "
               "expected (circular, rectangular, arbitrary, cable, rigid, spring, cosine matrices, masses)",
               "put back the missing one, with a count of 0 if it is empty")
    tables = {kind: () for kind in SETS}
    for kind, title, (at, rows) in zip(order, titles, found, strict=True):
        named = {own for own, words_of in HEADED.items() if words_of in title}
        if rows and named and kind not in named:
            r.fail(f"the heading '{title.strip(' -')[:40]}' stands where SubDyn reads the {kind} table",
                   f"bring the tables into SubDyn's order: {', '.join(order)}", at - 1)
        columns, result, seen = SETS[kind][0], [], {}
        for line, row in rows:
            values = r.numbers(line, row, columns, f"the {kind} table")
            id = r.id(line, row[0], f"the {kind} table")
            if kind != "mass" and id in seen:
                r.fail(f"{kind} set {id} stands in line {seen[id]} already", "number each set once", line)
            seen[id] = line
            if kind == "mass":
                values += [0.0] * (11 - len(values))
            elif kind == "arbitrary" and len(values) == 10:
                # older files have no torsion constant of its own
                values.append(values[9])
            result.append(Row(id=id, values=tuple(values[1:]), line=line))
        tables[kind] = tuple(result)
    return tables, {kind: line for kind, (line, _) in zip(order, found, strict=True)}


def _check_references(r: _Reader, file: SubDynFile) -> None:
    joints = {joint.id: joint for joint in file.joints}
    for what, rows in (("reaction", file.reactions), ("interface", file.interfaces)):
        for row in rows:
            if row.joint not in joints:
                r.fail(f"{what} joint {row.joint} is not among the joints", "correct its number", row.line)
    _check_members(r, file, joints)
    used = {joint for member in file.members for joint in member.joints}
    for joint in file.joints:
        if joint.id not in used:
            r.fail(f"joint {joint.id} is at no member", "connect it or take it out", joint.line)
    for row in file.masses:
        if row.id not in joints:
            r.fail(f"a concentrated mass is at joint {row.id}, which is not among the joints", "correct it", row.line)
        if joints[row.id].kind != "cantilever":
            r.fail(f"a concentrated mass is at joint {row.id}, which is {joints[row.id].kind}",
                   "put it on a rigid joint (type 1), in SubDyn too", row.line)


def _check_members(r: _Reader, file: SubDynFile, joints: Mapping[int, Joint]) -> None:
    sets = {kind: {row.id: row for row in rows} for kind, rows in file.sets.items()}
    cosines = {row.id for row in file.cosines}
    for member in file.members:
        for joint in member.joints:
            if joint not in joints:
                r.fail(f"member {member.id} is at joint {joint}, which is not among the joints", "correct its number",
                       member.line)
            if member.kind == "rigid" and joints[joint].kind != "cantilever":
                r.fail(f"the rigid link {member.id} is at joint {joint}, which is {joints[joint].kind}",
                       "rigid links want rigid joints (type 1), in SubDyn too", member.line)
        for number_ in member.sets:
            if number_ not in sets[member.kind]:
                r.fail(f"member {member.id} wants {member.kind} property set {number_}, which is not in that table",
                       "correct its property set or its type", member.line)
        if member.cosine is not None and member.cosine not in cosines:
            r.fail(f"member {member.id} wants cosine matrix {member.cosine}, which is not in the file",
                   "correct its number, or write -1", member.line)
        if member.kind in ("circular", "rectangular"):
            one, two = (sets[member.kind][k].values for k in member.sets)
            if one[:3] != two[:3]:
                r.fail(f"the two ends of member {member.id} differ in E, G or density", "give them one material, as "
                       "SubDyn wants", member.line)


# of a moment of inertia that was shifted from the joint to the centre
ROUNDING = 1e-6
# names of a set's numbers, what must be above zero, and what must not be below
SIZES = {
    "circular": (("YoungE", "ShearG", "MatDens", "XsecD", "XsecT"), (0, 1, 3), (2, 4)),
    "rectangular": (("YoungE", "ShearG", "MatDens", "XsecSa", "XsecSb", "XsecT"), (0, 1, 3, 4), (2, 5)),
    "arbitrary": (("YoungE", "ShearG", "MatDens", "XsecA", "XsecAsx", "XsecAsy", "XsecJxx", "XsecJyy", "XsecJ0",
                   "XsecJt"), (0, 1, 3, 6, 7, 8, 9), (2, 4, 5)),
    "cable": (("EA", "MatDens", "T0"), (0,), (1,)),
    "rigid": (("MatDens",), (), (0,)),
    "spring": ((), (), ()),
}


def _check_sizes(r: _Reader, file: SubDynFile) -> None:
    """Property sets that are used: no beam without stiffness or with a wall thicker than itself."""
    for kind, line, values in {(m.kind, file.set_of(m, end).line, file.set_of(m, end).values)
                               for m in file.members for end in (0, 1)}:
        names, positive, not_negative = SIZES[kind]
        for k in (*positive, *not_negative):
            if values[k] < 0 or (values[k] == 0 and k in positive):
                r.fail(f"{names[k]} of a {kind} set is {values[k]:g}",
                       f"give a number {'above zero' if k in positive else 'of zero or more'}", line)
        if kind == "circular" and 2 * values[4] > values[3] * (1 + 1e-9):
            r.fail(f"the wall {values[4]:g} is thicker than half of the diameter {values[3]:g}", "correct one of them; "
                   "0 is a solid section", line)
        if kind == "rectangular" and 2 * values[5] > min(values[3:5]) * (1 + 1e-9):
            r.fail(f"the wall {values[5]:g} is thicker than half of a side", "correct it; 0 is a solid section", line)
        if kind == "arbitrary" and file.shear and not values[4] * values[5]:
            r.fail("a shear area is 0, but FEMMod 3 counts shear", "give XsecAsx and XsecAsy, or FEMMod 1", line)
        if kind == "cable" and values[0] + values[2] <= 0:
            r.fail(f"T0 {values[2]:g} presses the cable by more than EA", "correct it", line)
    for row in file.masses:
        if row.values[0] < 0:
            r.fail(f"a concentrated mass is {row.values[0]:g} kg", "give zero or more", row.line)
        m, jxx, jyy, jzz, jxy, jxz, jyz, *centre = row.values
        least, _, most = np.linalg.eigvalsh([[jxx, jxy, jxz], [jxy, jyy, jyz], [jxz, jyz, jzz]])
        # but for rounding where it was computed from that about the joint
        if least < -ROUNDING * max(most, m * float(np.dot(centre, centre))):
            r.fail(f"the inertia of the concentrated mass at joint {row.id} has a principal moment of {least:.3g}",
                   "correct JMXX to JMYZ: they are about its centre, and no body has one below zero", row.line)


def _list_unused(where: str, settings: Mapping[str, str], cables: Sequence[Row]) -> list[str]:
    """What SubDyn does with the structure beyond its stiffness and mass."""
    notes = []
    if any(number(word) for word in settings.get("InitialPosition", "").split()):
        notes.append(f"{where}: the initial rigid-body position ({settings['InitialPosition']}) is not used: the "
                     "structure stands where its joints are, its soil along the same axes")
    led = [row for row in cables if len(row.values) > 3 and row.values[3] > 0]
    if led:
        notes.append(f"{where}, line {led[0].line}: CtrlChannel is not used: the cable keeps its T0, which a "
                     "controller would change")
    return notes


DIRECTIONS = ("x", "y", "z", "tx", "ty", "tz")


def _soil_notes(where: str, reactions: Sequence[Reaction], soil: Mapping[str, SsiFile]) -> list[str]:
    """What of the SSI files has no effect (openfast#1713), and what SubDyn makes of the rest."""
    notes = []
    fixed = [r for r in reactions if r.ssi and all(r.fixed)]
    if fixed:
        joints = ", ".join(str(r.joint) for r in fixed)
        notes.append(f"{where}, line {fixed[0].line}: the SSI file of joint {joints} has no effect, as all six "
                     "directions are held (flag 1); write 0 where the soil is to act")
    for r in reactions:
        if r.ssi and any(r.fixed) and not all(r.fixed):
            held = [k for k in range(6) if r.fixed[k] and (soil[r.ssi].stiffness[k].any() or soil[r.ssi].mass[k].any())]
            if held:
                notes.append(f"{where}, line {r.line}: the terms of '{r.ssi}' in "
                             f"{', '.join(DIRECTIONS[k] for k in held)} have no effect, as joint {r.joint} is held "
                             "there")
        if r.ssi is None and not any(r.fixed):
            notes.append(f"{where}, line {r.line}: reaction joint {r.joint} is free and has no SSI file: nothing holds "
                         "it")
    for file in soil.values():
        notes += file.notes
        if not file.stiffness.any() and not file.mass.any():
            notes.append(f"{where}: the SSI file '{file.name}' holds no term: it has no effect")
    return notes


def parse_again(file: SubDynFile, lines: Sequence[str], soil: Mapping[str, SsiFile] | None = None) -> SubDynFile:
    held = dict(file.soil) | dict(soil or {})
    return parse_subdyn(lines, file.where, lambda name, line: held[name])


def write_subdyn(file: SubDynFile, path: str | Path, root: Path | None = None) -> Path:
    """Write the file and, under their own names relative to it, its SSI files; none of them outside the folder `root`
    (the file's own where None)."""
    path = Path(path)
    folder = (path.parent if root is None else root).resolve()
    targets = {}
    for name in file.soil:
        targets[name] = (path.resolve().parent / name.replace("\\", "/")).resolve()
        if not targets[name].is_relative_to(folder):
            raise InputError(str(path), f"its SSI file '{name}' would be written outside {folder}",
                             "keep the folders' arrangement")
    for name, soil in file.soil.items():
        write_ssi(soil, targets[name])
    return write_lines(path, file.lines)
