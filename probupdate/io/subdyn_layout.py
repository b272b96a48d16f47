"""A SubDyn file of v3 or v4 in the layout of v5: the same structure, columns and tables that came since put in."""

from __future__ import annotations

from probupdate.errors import InputError
from probupdate.io.fortran_text import logical, replaced, words
from probupdate.io.subdyn_file import BEAMS, SETS, SubDynFile, reparsed

EMPTY = ("names of columns", "(units)")
INITIAL = ("---------------- INITIAL RIGID-BODY POSITION ----------------", "Surge Sway Heave Roll Pitch Yaw",
           "(m) (m) (m) (deg) (deg) (deg)", " 0.0 0.0 0.0 0.0 0.0 0.0")
OLD_LINES = ("CBMOD", "GUYANLOADCORRECTION")


def as_v5(file: SubDynFile) -> SubDynFile:
    """The file as SubDyn of OpenFAST v5 reads it; one that is v5 as it is. Raises InputError for a beam turned by a
    cosine matrix, which v5 turns by an angle."""
    if file.layout == "v5":
        return file
    lines: list[str | None] = list(file.lines)
    inserted: dict[int, list[str]] = {}
    for k, line in enumerate(file.lines[: file.joints[0].line]):
        found = words(line)
        if len(found) > 1 and found[1].upper() in OLD_LINES and logical(found[0]) is not None:
            lines[k] = None
    # above the joints' heading: three lines stand between it and the first joint
    inserted[file.joints[0].line - 5] = list(INITIAL)
    for joint in file.joints:
        if len(words(file.lines[joint.line - 1])) < 9:
            lines[joint.line - 1] = _longer(file.lines[joint.line - 1], 4, "1 0.0 0.0 0.0 0.0")
    for reaction in file.reactions:
        if len(words(file.lines[reaction.line - 1])) < 7:
            lines[reaction.line - 1] = _longer(file.lines[reaction.line - 1], 1, "1 1 1 1 1 1")
    for interface in file.interfaces:
        text = file.lines[interface.line - 1]
        if len(words(text)) < 7:
            lines[interface.line - 1] = _longer(text, 1, "1 1 1 1 1 1 1")
        else:
            lines[interface.line - 1] = replaced(text, {0: f"{interface.joint} 1"})
    if file.layout != "v4.1":
        _members(file, lines)
        for row in file.sets["arbitrary"]:
            text = file.lines[row.line - 1]
            if len(words(text)) < 11:
                lines[row.line - 1] = replaced(text, {9: f"{words(text)[9]} {row.values[9]!r}"})
    _tables(file, inserted)
    result = []
    for k, line in enumerate(lines):
        result += inserted.get(k, [])
        result += [] if line is None else [line]
    return reparsed(file, result)


def _longer(text: str, n: int, more: str) -> str:
    """The row with words behind its n-th one, where a comment may follow."""
    return replaced(text, {n - 1: f"{words(text)[n - 1]} {more}"})


def _members(file: SubDynFile, lines: list[str | None]) -> None:
    for member in file.members:
        text = file.lines[member.line - 1]
        if member.kind in BEAMS and member.cosine is not None and member.kind != "circular":
            raise InputError(f"{file.where}, line {member.line}", f"member {member.id} is turned by a cosine matrix",
                             "v5 turns beams by an angle (MSpin): write it by hand")
        kind = "1c" if member.kind == "circular" else words(text)[5]
        last = "0" if member.kind in BEAMS else str(member.cosine or -1)
        given = words(text)
        # a short row gets what it lacks behind its own words, before a comment
        tail = " ".join([given[4], kind, last]) if len(given) == 5 else f"{kind} {last}" if len(given) == 6 else None
        lines[member.line - 1] = replaced(text, {5: kind, 6: last} if tail is None else {len(given) - 1: tail})


def _tables(file: SubDynFile, inserted: dict[int, list[str]]) -> None:
    """Tables the file does not have yet, empty, before the one that follows them."""
    waiting: list[str] = []
    for kind, (_, count) in SETS.items():
        if kind not in file.counts:
            waiting += [f"---------------- {kind.upper()} ----------------", f"   0   {count}", *EMPTY]
        elif waiting:
            # its heading is the line above its count
            inserted.setdefault(file.counts[kind] - 2, []).extend(waiting)
            waiting = []
