"""Building blocks of model.toml's schema: strict tables and numbers."""

from __future__ import annotations

import difflib
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, Strict

Number = Annotated[float, Strict()]
Positive = Annotated[float, Strict(), Field(gt=0)]
NotNegative = Annotated[float, Strict(), Field(ge=0)]
Vector = tuple[Number, Number, Number]

# one mistake: key path, what is wrong, what to do
Mistake = tuple[str, str, str]


class Table(BaseModel):
    """A TOML table: no unknown keys, no infinities, not changed after it is read."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def nearest(name: str, known) -> str:
    """The remedy for an unknown name."""
    close = difflib.get_close_matches(name, list(known), n=1, cutoff=0.5)
    return f"did you mean '{close[0]}'?" if close else f"choose from {', '.join(sorted(known))}"
