"""One schema per file: the annotations of the dataclass that is read. Pydantic checks every value against them.

Results, which the program writes, are `checked`; what a user writes is made of `table_as`, whose mistakes name the key,
what was probably meant and what to write.
"""

from __future__ import annotations

import difflib
import functools
import json
import types
import typing
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar, Union, cast

import numpy as np

from probupdate.errors import InputError

T = TypeVar("T")
# no text or list that the program writes comes near
LONGEST_TEXT = 20_000
MOST_ITEMS = 1_000_000
# open bounds are infinite; every other number is finite, or NaN where the file has null
LARGEST = 1e150  # squares of it are numbers too
UNBOUNDED = ("lower", "upper")
# what numbers of a result can be, by the last word of their field's name; null, which is no number, may stand for any.
# A MAC, a correlation and a probability are computed, and end by rounding beside their bounds.
ROUNDED = 1e-6
SHARES, AMOUNTS = (-ROUNDED, 1 + ROUNDED), (0.0, LARGEST)
QUANTITIES = {
    **dict.fromkeys(("mac", "probability", "p", "p_value", "share_left", "odd"), SHARES),
    **dict.fromkeys(("hz", "std", "std_after", "cov", "variance", "misfit", "square", "contraction", "tau", "ess",
                     "mode"), AMOUNTS),
    **dict.fromkeys(("correlation", "cosine"), (-1 - ROUNDED, 1 + ROUNDED)),
}
# of every parameter, whatever the data are
NEEDED = ("theta", "covariance")
SYMMETRIC = ("covariance", "correlation", "fisher")
# each stands for one row of what is beside it
UNIQUE = ("names", "labels", "ids", "turbines")


@dataclass(frozen=True)
class Range:
    """What a number that a user gives may be, as in `Annotated[float, Range(0, 90)]`; above: without `low` itself."""

    low: float
    high: float = np.inf
    above: bool = False
    nonzero: bool = False

    def check(self, value: float) -> float:
        if not self.low <= value <= self.high or (self.above and value == self.low) or (self.nonzero and value == 0):
            if self.high < np.inf:
                raise ValueError(f"is not in {self.low:g} to {self.high:g}" + " and not zero" * self.nonzero
                                 + f" and above {self.low:g}" * self.above)
            raise ValueError(f"is not a number {'above' if self.above else 'from'} {self.low:g}")
        return value


class Flags:
    """Of an array: true and false, which no other array holds."""

    def check(self, value: object) -> object:
        if not isinstance(value, np.ndarray) or value.dtype.kind != "b":
            raise ValueError("is not an array of true and false")
        return value


BoolArray = Annotated[np.ndarray, Flags()]


@dataclass(frozen=True)
class Length:
    """How long a text that a user gives is at least."""

    least: int

    def check(self, value: str) -> str:
        if len(value) < self.least:
            raise ValueError("is empty")
        return value


def validate(result: T, path: str | Path, remedy: str) -> T:
    """The result as it is. Raises InputError naming file and key where a value is of another kind than its field: text
    for a number, an infinite number, an array of something else."""
    import pydantic

    try:
        _schema(type(result)).model_validate(result, from_attributes=True)
    except pydantic.ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise InputError(f"{path}, {place}", f"{first['input']!r:.60}: {_words(first)}", remedy) from None
    return result


def _words(mistake: Mapping) -> str:
    return str(mistake["msg"]).removeprefix("Value error, ")


def checked_table(kind: type, table: Mapping, path: str | Path, remedy: str) -> None:
    """Raises InputError where a table of JSON does not have the fields of a dataclass, or other values in them; fields
    with a default may lack, and what the dataclass does not know is left alone."""
    import pydantic

    try:
        _schema(kind).model_validate_json(json.dumps(table))
    except pydantic.ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        message = (f"has no '{place}'" if first["type"] == "missing"
                   else f"{place}, {first['input']!r:.60}: {_words(first)}")
        raise InputError(str(path), message, remedy) from None


def table_as(kind: type[T], table: object, where: str, **defaults: object) -> T:
    """A table that a user wrote as a dataclass of plain values; `defaults` stand for keys that it does not have.

    Raises InputError naming the key: unknown (with what was probably meant), missing, or of another kind than its
    annotation, whose `Annotated` bounds and `Literal` words are held to.
    """
    import pydantic

    known = [f.name for f in fields(cast(Any, kind))]
    if not isinstance(table, Mapping):
        raise InputError(where, f"{table!r:.60} is not a table", f"write lines such as {known[0]} = ...")
    refuse_unknown(table, known, where)
    try:
        # through JSON, where a list is a tuple and a date, which none of these has, is not text
        text = json.dumps(dict(table), default=lambda value: {"date": str(value)})
        found = _schema(kind, False).model_validate_json(text)
    except pydantic.ValidationError as error:
        raise _mistake(error.errors(include_url=False), known, where) from None
    except (TypeError, ValueError) as error:
        raise InputError(where, f"holds what is not a number, text or list ({error})", "see docs/formats") from None
    given = {name: getattr(found, f"{name}_" if hasattr(pydantic.BaseModel, name) else name) for name in known
             if name in table}
    return kind(**(defaults | given))


def refuse_unknown(table: Mapping, known: Iterable[str], where: str) -> None:
    """Raises InputError for a key that is none of `known`, with the one that was probably meant."""
    known = list(known)
    for key in table:
        if key not in known:
            close = difflib.get_close_matches(str(key), known, n=1)
            raise InputError(where, f"unknown key '{key}'",
                             f"did you mean '{close[0]}'?" if close else f"known are {', '.join(known)}")


# kind of mistake, as pydantic names it -> what is wrong, what to write
TEXT, NUMBER, LIST = "is not text", "is not a number", "is not a list"
WORDS = {
    "float_type": (NUMBER, "write a number without quotes"),
    "int_type": (NUMBER, "write a whole number without quotes"),
    "int_from_float": ("is not a whole number", "write one"), "finite_number": ("is not finite", "give a number"),
    "string_type": (TEXT, "write it in quotes"), "bool_type": ("is not true or false", "write one of them"),
    "tuple_type": (LIST, 'write ["..."], or [1.0, 2.0]'), "list_type": (LIST, 'write ["..."], or [1.0, 2.0]'),
    "dict_type": ("is not a table", "write name = value below a line with its name in brackets"),
    "mapping_type": ("is not a table", "write name = value below a line with its name in brackets"),
}


def _mistake(errors: list, known: list[str], where: str) -> InputError:
    """The first mistake as an error of the user's. Of a field of several kinds, each complains: the words of all."""
    first = errors[0]
    key = str(first["loc"][0]).removesuffix("_") if first["loc"] else known[0]
    same = [e for e in errors if e["loc"][:1] == first["loc"][:1]]
    if first["type"] == "missing":
        return InputError(where, f"'{key}' is missing", f"add it; known are {', '.join(known)}")
    inner = [str(part) for part in first["loc"][1:] if isinstance(part, int) or len(same) == 1]
    where = ", ".join([where, key, *(p if not p.isdigit() else f"entry {int(p) + 1}" for p in inner)])
    value, kind = first["input"], first["type"]
    shown = f"{value!r:.80}"
    if kind == "literal_error":
        choices = [c.strip("'") for c in first["ctx"]["expected"].replace(" or ", ", ").split(", ")]
        close = difflib.get_close_matches(str(value), choices, n=1)
        return InputError(where, f"{shown} is unknown",
                          f"did you mean '{close[0]}'?" if close else f"choose from {', '.join(choices)}")
    if len({e["type"] for e in same}) > 1:
        return InputError(where, f"{shown} has the wrong type", "; or ".join(
            dict.fromkeys(WORDS[e["type"]][1] for e in same if e["type"] in WORDS)) or "see docs/formats")
    if kind in ("list_type", "tuple_type") and isinstance(value, Mapping):
        return InputError(where, "is one table where a list of them belongs", f"write [[{key}]] before each")
    problem, remedy = WORDS.get(kind, (_words(first), "give another one"))
    return InputError(where, f"{shown} {problem}", remedy)


@functools.cache
def _schema(kind: type, result: bool = True) -> Any:
    """A strict pydantic model with the fields of a dataclass; of a result, names of fields say what numbers can be."""
    import pydantic

    hints = typing.get_type_hints(kind, include_extras=True)
    config = pydantic.ConfigDict(strict=True, from_attributes=True, arbitrary_types_allowed=True,
                                 protected_namespaces=())
    members = {f.name: (_type(hints[f.name], f.name if result or f.name in UNBOUNDED else ""), _default(f))
               for f in fields(kind)}
    # names that pydantic keeps for itself
    renamed: dict[str, Any] = {f"{name}_" if hasattr(pydantic.BaseModel, name) else name: value
                               for name, value in members.items()}
    renamed = {key: (value[0], pydantic.Field(validation_alias=key.removesuffix("_"))) if key not in members else value
               for key, value in renamed.items()}
    return pydantic.create_model(kind.__name__, __config__=config, **renamed)


def _default(field: Field) -> Any:
    if field.default is not MISSING:
        return field.default
    return ... if field.default_factory is MISSING else None


def _type(hint: Any, name: str = "") -> Any:
    """What pydantic holds a value to; name: of the field, which says what quantity its numbers are."""
    import pydantic

    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if hint is float:
        return Annotated[float, pydantic.AfterValidator(functools.partial(_check_number, name))]
    if hint is str:
        return Annotated[str, pydantic.Field(max_length=LONGEST_TEXT)]
    if hint is np.ndarray:
        return Annotated[Any, pydantic.PlainValidator(functools.partial(_check_array, name))]
    if isinstance(hint, type) and is_dataclass(hint):
        return _schema(hint)
    if origin is Annotated:
        # a number with bounds of its own may be infinite where they are; NaN is within none
        return Annotated[inner[0], *(pydantic.AfterValidator(m.check) for m in inner[1:])]
    if origin in (Union, types.UnionType):
        return Union[tuple(_type(part, name) for part in inner)]  # noqa: UP007  of types that are made here
    if origin is tuple:
        # rows of rows have names of their own
        items: Any = tuple[tuple(part if part is Ellipsis else _type(part, "" if typing.get_args(part) else name)
                                 for part in inner)]
        return Annotated[items, pydantic.AfterValidator(_check_unique)] if _last_word(name) in UNIQUE else items
    if origin is list:
        return Annotated[list[_type(inner[0], name)], pydantic.Field(max_length=MOST_ITEMS)]
    if origin is not None and isinstance(origin, type) and issubclass(origin, Mapping):
        return Mapping[_type(inner[0]), _type(inner[1])]
    return Any if hint is object else hint


def _last_word(name: str) -> str:
    return name.rpartition("_")[2]


def _check_number(name: str, value: float) -> float:
    # NaN passes: it is null
    if name not in UNBOUNDED:
        _check_quantity(name, np.asarray(value))
    return value


def _check_array(name: str, value: Any) -> np.ndarray:
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "iufc":
        raise ValueError("is not an array of numbers")
    _check_quantity(name, value)
    if set(NEEDED) & set(name.split("_")) and np.any(np.isnan(value)):
        raise ValueError("lacks a number")
    if _last_word(name) in SYMMETRIC and value.ndim == 2 and not (
            value.shape == value.T.shape and np.allclose(value, value.T, equal_nan=True)):
        raise ValueError("is not symmetric")
    return value


def _check_quantity(name: str, value: np.ndarray) -> None:
    if np.any(np.abs(value) > LARGEST):
        raise ValueError(f"is beyond {LARGEST:g}")
    bounds = QUANTITIES.get(name, QUANTITIES.get(_last_word(name)))
    if bounds is not None and np.any((value < bounds[0]) | (value > bounds[1])):
        low, high = (float(f"{b:.3g}") for b in bounds)
        raise ValueError("is negative" if high == LARGEST else f"is not in {low:g} to {high:g}")


def _check_unique(values: tuple) -> tuple:
    twice = [value for k, value in enumerate(values) if value in values[:k]]
    if twice:
        raise ValueError(f"holds {twice[0]!r} twice")
    return values
