"""model.toml read: one line for the first mistake in it, of the schema or of what its tables say together."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import get_args

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from probupdate.errors import InputError
from probupdate.structure.description import SUBSTRUCTURES, Description
from probupdate.structure.description_checks import CHECKS
from probupdate.structure.parameter_table import read_toml
from probupdate.structure.schema import Mistake, Table, suggest

# of further mistakes the keys that are named
LISTED = 20


def read_description(path: str | Path) -> Description:
    """model.toml -> Description; raises one InputError with the first mistake and the number of the others."""
    path = Path(path)
    return parse_description(read_toml(path), str(path))


def parse_description(raw: dict, where: str) -> Description:
    if raw and raw.keys() <= {"parameter", "correlation"}:
        raise InputError(where, "states parameters and no model",
                         "give the model that they are of (the model.npz beside it, or a model.toml)")
    kind = _kind(raw, where)
    try:
        description = kind.model_validate(raw)
    except ValidationError as error:
        raise _first_mistake([_translate(e, kind) for e in error.errors() if not _follows(e)], where) from None
    mistakes = [m for check in CHECKS for m in check(description)]
    if mistakes:
        raise _first_mistake(mistakes, where)
    return description


def _kind(raw: dict, where: str) -> type[Description]:
    """Which tables the file has, by what the turbine stands on."""
    found = [name for name in SUBSTRUCTURES if name in raw]
    tables = ", ".join(f"[{name}]" for name in SUBSTRUCTURES)
    if len(found) > 1:
        raise InputError(f"{where}: {found[1]}", f"stands beside [{found[0]}]", "keep one: a turbine stands on one of "
                         f"{tables}")
    if not found:
        close = [name for key in raw for name in difflib.get_close_matches(key, SUBSTRUCTURES, n=1, cutoff=0.7)]
        # only a jacket stands on several piles, which have a table of their own
        missing = close[0] if close else "jacket" if "pile" in raw else "jacket, monopile or foundation"
        raise InputError(f"{where}: {missing}", "is missing",
                         f"add it: what the turbine stands on, one of {tables} ('probupdate template' writes each)")
    return SUBSTRUCTURES[found[0]]


def _first_mistake(mistakes: list[Mistake], where: str) -> InputError:
    # a key that is missing may be there misspelt, which says more
    key, problem, remedy = min(mistakes, key=lambda m: m[1].startswith("is missing"))
    others = list(dict.fromkeys(m[0] for m in mistakes if m[0] != key))
    listed = f"{', '.join(others[:LISTED])}{', ...' if len(others) > LISTED else ''}"
    more = f" ({len(others)} more mistake{'s' if len(others) > 1 else ''} in this file: {listed})" if others else ""
    return InputError(f"{where}: {key}" if key else where, problem, remedy + more)


def _known_keys(location: tuple, kind: type[Table]) -> set[str]:
    """The keys the schema of `kind` allows in the table that `location` lies in."""
    model = kind
    for step in location[:-1]:
        if isinstance(step, int):
            continue
        field = model.model_fields.get(step)
        candidates = [] if field is None else nested_tables(field.annotation)
        if not candidates:
            return set()
        model = candidates[0]
    return set(model.model_fields)


def nested_tables(annotation) -> list[type[Table]]:
    """The tables that a field's annotation names, itself or as an argument."""
    if isinstance(annotation, type):
        return [annotation] if issubclass(annotation, Table) else []
    return [table for argument in get_args(annotation) for table in nested_tables(argument)]


def _follows(error: ErrorDetails) -> bool:
    """Whether a list is only short of the entries that have mistakes of their own."""
    return error["type"] == "too_short" and len(error["input"]) >= error["ctx"]["min_length"]


def _translate(error: ErrorDetails, of: type[Table]) -> Mistake:
    location = tuple(step for step in error["loc"] if step != "[key]")
    key = ""
    for step in location:
        key += f"[{step + 1}]" if isinstance(step, int) else f".{step}" if key else str(step)
    kind, value = error["type"], error["input"]
    if kind == "extra_forbidden":
        return key, "is not a key of this file", suggest(str(location[-1]), _known_keys(location, of))
    if kind == "missing":
        return key, "is missing", "add it"
    if kind in ("model_type", "model_attributes_type"):
        inner = ", ".join(f"{name} = ..." for name in sorted(_known_keys((*location, ""), of)))
        return key, f"{value!r:.60} is not a table", f"write {location[-1]} = {{ {inner} }}"
    if kind == "too_short":
        return key, f"has {len(value)} of at least {error['ctx']['min_length']} entries", f"add another [[{key}]]"
    if kind == "finite_number":
        return key, f"{value} is not a finite number", "give a number in SI units"
    message = error["msg"].removeprefix("Value error, ")
    shown = repr(value) if not isinstance(value, dict | list | tuple) else f"a {type(value).__name__}"
    return key, f"{shown} is wrong: {message[0].lower()}{message[1:]}", "correct the value"
