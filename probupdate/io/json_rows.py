"""Results as rows of JSON and back: null stands for what is not a number, which JSON does not have.

Back, the annotations of the dataclass say what a list, a table or a null becomes, and `checked` holds the values to
them. A result has every field of its dataclass: one that lacks was lost, or the file is an older version's.
"""

from __future__ import annotations

import functools
import typing
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, TypeVar, Union

import numpy as np

from probupdate.errors import InputError, of_file, parsing
from probupdate.io.schema import validate
from probupdate.runtime.arrays import frozen_array

T = TypeVar("T")
# what null stands for; every other number has none
NULLS = {"lower": -np.inf, "upper": np.inf}


def row_of(result: Any) -> dict:
    """A dataclass of plain values as a table."""
    return {k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in asdict(result).items()}


def from_table(kind: type[T], table: Mapping, path: str | Path, remedy: str, *, name: str, file_format: int) -> T:
    """A result as the file's table has it, checked; parts that are results already stay. name: what such a file is.
    Raises InputError naming file and key where the format is another, a key lacks or is unknown, or a value is of
    another kind than its annotation."""
    found = table.get("format")
    if found != file_format or isinstance(found, bool):
        raise InputError(f"{path}, format", f"is not {name}, or of another version's format ({found!r:.40})", remedy)
    with of_file(path), parsing(str(path), f"is not {name}", remedy):
        result = _row(kind, {k: v for k, v in table.items() if k != "format"}, name, remedy)
    return validate(result, path, remedy)


def _value(hint: Any, value: Any, place: str, remedy: str) -> Any:
    """The value as its annotation has it; one of another kind stays as it is, for the schema to refuse by its key."""
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        return _value(inner[0], value, place, remedy)
    if origin in (Union, UnionType):
        if value is None and NoneType in inner:
            return None
        return _value(next(part for part in inner if part is not NoneType), value, place, remedy)
    if value is None and hint is float:
        return NULLS.get(place.rpartition(".")[2], np.nan)
    if type(value) is int and hint is float:
        return float(value)
    if isinstance(value, list) and hint is np.ndarray:
        return _array(value)
    if isinstance(value, list) and origin is tuple:
        kinds = inner[:1] * len(value) if inner[1:] == (...,) else inner
        if len(kinds) != len(value):
            return value
        return tuple(_value(k, v, f"{place}.{number}", remedy) for number, (k, v) in enumerate(
            zip(kinds, value, strict=True)))
    if not isinstance(value, Mapping):
        return value
    if is_dataclass(hint):
        return _row(hint, value, place, remedy)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return {k: _value(inner[1], v, f"{place}.{k}", remedy) for k, v in value.items()}
    return value


def _row(kind: Any, table: Mapping, place: str, remedy: str) -> Any:
    hints = _hints(kind)
    known = [f.name for f in fields(kind)]
    wrong = [f"has no '{k}'" for k in known if k not in table] + [f"has an unknown '{k}'" for k in table
                                                                  if k not in known]
    if wrong:
        raise InputError(place, f"{wrong[0]}: damaged, or of another version", remedy)
    return kind(**{k: _value(hints[k], v, f"{place}.{k}", remedy) for k, v in table.items()})


@functools.cache
def _hints(kind: type) -> dict[str, Any]:
    return typing.get_type_hints(kind, include_extras=True)


def _array(value: list) -> Any:
    """A list of numbers, null where there is none, or of true and false."""
    filled = np.array(value, dtype=object)
    kinds = {type(x) for x in filled.flat}
    if kinds and kinds <= {bool}:
        return frozen_array(filled, bool)
    if not kinds <= {int, float, NoneType}:
        return value
    return frozen_array(np.where(filled == None, np.nan, filled))  # noqa: E711
