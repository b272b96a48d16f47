"""Results as rows of JSON and back: null stands for what is not a number, which JSON does not have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")


def row_of(result: Any) -> dict:
    """A dataclass of plain values as a table."""
    return {k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in asdict(result).items()}


def from_row(kind: type[T], row: Mapping) -> T:
    """The dataclass again; lists become tuples. Raises TypeError where the row's keys are not its fields."""
    return kind(**{k: float("nan") if v is None else tuple(v) if isinstance(v, list) else v for k, v in row.items()})
