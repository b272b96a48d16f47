"""Numbers and words that decide something, as fields of frozen values: each with its unit, its effect and its
source."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import field, fields
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Any, Union, get_args, get_origin, get_type_hints

from probupdate.errors import InputError

# of one value, and of several
WORDS = {int: ("a whole number", "whole numbers"), float: ("a finite number", "finite numbers"),
         str: ("a word", "words"), bool: ("True or False", "True or False"), NoneType: ("None", "None")}

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def setting(default: Any, unit: str, effect: str, source: str = "") -> Any:
    """A field of a frozen dataclass: its default, the unit, what it does, and where the value comes from ('' where it
    is this program's own choice)."""
    return field(default=default, metadata={"unit": unit, "effect": effect, "source": source})


def rows(settings: DataclassInstance) -> Iterator[dict[str, Any]]:
    """name, value, unit, effect and source of every field of such a value that was `setting`."""
    for f in fields(settings):
        if "effect" in f.metadata:
            yield {"name": f.name, "value": getattr(settings, f.name), **f.metadata}


def refuse_other_types(settings: DataclassInstance) -> None:
    """Raises InputError for a field whose value is of no type that the field states."""
    kinds = get_type_hints(type(settings))
    for f in fields(settings):
        refuse_other_type(f.name, getattr(settings, f.name), kinds[f.name], f.default, f.metadata.get("effect", ""))


def refuse_other_type(name: str, value: object, kind: Any, default: object, effect: str) -> None:
    """Raises InputError where a value is not of a kind: int, float, str, bool, a class, tuples, mappings and unions of
    these. A list serves as a tuple; True is no number."""
    if not _has_type(value, kind):
        raise InputError(name, f"{value!r} is not {_words(kind)}", f"the default is {default!r}: {effect}")


def _has_type(value: object, kind: Any) -> bool:
    origin, parts = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        return any(_has_type(value, part) for part in parts)
    if origin is tuple:
        return isinstance(value, tuple | list) and all(_has_type(item, parts[0]) for item in value)
    if origin is Mapping:
        return isinstance(value, Mapping) and all(
            _has_type(k, parts[0]) and _has_type(v, parts[1]) for k, v in value.items())
    if kind in (int, float):
        return (isinstance(value, Integral if kind is int else Real) and not isinstance(value, bool)
                and math.isfinite(value))
    return isinstance(value, kind)


def _words(kind: Any, many: bool = False) -> str:
    origin, parts = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        words = list(dict.fromkeys(_words(part, many) for part in parts))
        return " or ".join([", ".join(words[:-1]), words[-1]])
    if origin is tuple:
        return f"a tuple of {_words(parts[0], many=True)}"
    if origin is Mapping:
        return f"a mapping of {_words(parts[0], many=True)} to {_words(parts[1], many=True)}"
    return WORDS[kind][many] if kind in WORDS else kind.__name__
