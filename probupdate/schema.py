"""One schema per result file: the annotations of the dataclass that is read. Pydantic checks every value against them."""

from __future__ import annotations

import functools
import json
import types
import typing
from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar, Union

import numpy as np

from probupdate.errors import InputError

T = TypeVar("T")
# no text or list that the program writes comes near
LONGEST_TEXT = 20_000
MOST_ITEMS = 1_000_000
# open bounds are infinite; every other number is finite, or NaN where the file has null
LARGEST = 1e150  # squares of it are numbers too
UNBOUNDED = ("lower", "upper")


def checked(result: T, path: str | Path, remedy: str) -> T:
    """The result as it is. Raises InputError naming file and key where a value is of another kind than its field: text
    for a number, an infinite number, an array of something else."""
    import pydantic

    try:
        _schema(type(result)).model_validate(result, from_attributes=True)
    except pydantic.ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise InputError(f"{path}, {place}", f"{first['input']!r:.60}: {first['msg']}", remedy) from None
    return result


def checked_table(kind: type, table: Mapping, path: str | Path, remedy: str) -> None:
    """Raises InputError where a table of JSON does not have the fields of a dataclass, or other values in them; fields
    with a default may lack, and what the dataclass does not know is left alone."""
    import pydantic

    try:
        _schema(kind).model_validate_json(json.dumps(table))
    except pydantic.ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        told = f"has no '{place}'" if first["type"] == "missing" else f"{place}, {first['input']!r:.60}: {first['msg']}"
        raise InputError(str(path), told, remedy) from None


@functools.cache
def _schema(kind: type) -> Any:
    """A strict pydantic model with the fields of a dataclass."""
    import pydantic

    hints = typing.get_type_hints(kind)
    config = pydantic.ConfigDict(strict=True, from_attributes=True, arbitrary_types_allowed=True, protected_namespaces=())
    members = {f.name: (_type(hints[f.name], f.name in UNBOUNDED), _default(f)) for f in fields(kind)}
    # names that pydantic keeps for itself
    renamed = {f"{name}_" if hasattr(pydantic.BaseModel, name) else name: value for name, value in members.items()}
    renamed = {key: (value[0], pydantic.Field(validation_alias=key.removesuffix("_"))) if key not in members else value
               for key, value in renamed.items()}  # fmt: skip
    return pydantic.create_model(kind.__name__, __config__=config, **renamed)


def _default(field: Field) -> Any:
    if field.default is not MISSING:
        return field.default
    return ... if field.default_factory is MISSING else None


def _type(hint: Any, unbounded: bool = False) -> Any:
    import pydantic

    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if hint is float:
        return Annotated[float, pydantic.AfterValidator(_any if unbounded else _not_infinite)]
    if hint is str:
        return Annotated[str, pydantic.Field(max_length=LONGEST_TEXT)]
    if hint is np.ndarray:
        return Annotated[Any, pydantic.PlainValidator(_array)]
    if isinstance(hint, type) and is_dataclass(hint):
        return _schema(hint)
    if origin in (Union, types.UnionType):
        return Union[tuple(_type(part) for part in inner)]  # noqa: UP007  of types that are made here
    if origin is tuple:
        return tuple[tuple(part if part is Ellipsis else _type(part) for part in inner)]
    if origin is list:
        return Annotated[list[_type(inner[0])], pydantic.Field(max_length=MOST_ITEMS)]
    if origin is not None and isinstance(origin, type) and issubclass(origin, Mapping):
        return Mapping[_type(inner[0]), _type(inner[1])]
    return Any if hint is object else hint


def _any(value: float) -> float:
    return value


def _not_infinite(value: float) -> float:
    # NaN passes: it is null
    if abs(value) > LARGEST:
        raise ValueError(f"is beyond {LARGEST:g}")
    return value


def _array(value: Any) -> np.ndarray:
    good = isinstance(value, np.ndarray) and value.dtype.kind in "biufc"
    if not good or (value.dtype.kind in "fc" and np.any(np.abs(value) > LARGEST)):
        raise ValueError(f"is no array of numbers up to {LARGEST:g}")
    return value
