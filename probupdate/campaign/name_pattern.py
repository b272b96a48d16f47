"""Patterns for file names that always come to an end: regular expressions without what makes Python's engine run
away."""

from __future__ import annotations

import re

from probupdate.errors import InputError

LONGEST = 200
# each may take every length within a name: with the place where a match begins, a name of 255 characters is gone
# through in seconds at worst
MOST_REPEATS = 3
REMEDY = r"write such as _(\d{8}_\d{6})\.csv"


def name_pattern(text: str, where: str) -> re.Pattern[str]:
    r"""The compiled pattern, of one group. Raises InputError for one that is none, for repeats within repeats such as
    (a+)+, more than three open repeats, back references and conditions."""
    if len(text) > LONGEST:
        raise InputError(where, f"has {len(text)} characters", f"give at most {LONGEST}")
    try:
        pattern = re.compile(text)
    except (re.error, OverflowError, RecursionError) as error:
        raise InputError(where, f"is not a pattern ({error})", "see Python's re") from None
    if pattern.groups != 1:
        raise InputError(where, f"has {pattern.groups} groups", "put the time in one pair of brackets")
    if re.search(r"\(\?(?!:|P<)", text) or re.search(r"\\[1-9]", text) or "(?P=" in text:
        raise InputError(where, "has a condition, a flag or a back reference, which may take forever", REMEDY)
    _refuse_runaway(text, where)
    return pattern


def _refuse_runaway(text: str, where: str) -> None:
    # without escaped characters and sets of characters, of which each stands for one
    bare = re.sub(r"\[\^?\]?(?:\\.|[^\]\\])*\]", "x", re.sub(r"\\[^\[\]]", "x", re.sub(r"\\[\[\]]", "x", text)))
    repeats, variable = 0, [False]
    closed = False
    for found in re.finditer(r"\(\?:|\(\?P<\w+>|\(|\)|\{(\d*)(,?)(\d*)\}|[*+?|]|.", bare, re.DOTALL):
        piece = found[0]
        if piece.startswith("("):
            variable.append(False)
            closed = False
        elif piece == ")":
            inner = variable.pop()
            closed = inner
            variable[-1] |= inner
        elif piece == "|":
            variable[-1] = True
            closed = False
        elif piece in "*+?" or found[2] is not None:
            fixed = found[2] == "" and found[1] != ""
            most = 1 if piece == "?" else int(found[3] or 10**6) if found[2] else int(found[1] or 0) if fixed else 10**6
            if closed and most > 1:
                raise InputError(where, "repeats what repeats or has alternatives, which may take forever", REMEDY)
            variable[-1] |= not fixed
            repeats += not fixed and most > 8
        else:
            closed = False
    if repeats > MOST_REPEATS:
        raise InputError(where, f"has {repeats} repeats of any length", f"use at most {MOST_REPEATS}")
