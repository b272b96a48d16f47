"""Numbers and words that decide something, as fields of frozen values: each with its unit, its effect and its
source."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field, fields
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def stated(default: Any, unit: str, effect: str, source: str = "") -> Any:
    """A field of a frozen dataclass: its default, the unit, what it does, and where the value comes from ('' where it
    is this program's own choice)."""
    return field(default=default, metadata={"unit": unit, "effect": effect, "source": source})


def rows(settings: DataclassInstance) -> Iterator[dict[str, Any]]:
    """name, value, unit, effect and source of every field of such a value that was `stated`."""
    for f in fields(settings):
        if "effect" in f.metadata:
            yield {"name": f.name, "value": getattr(settings, f.name), **f.metadata}
