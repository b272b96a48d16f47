"""Arrays of results that are not meant to change."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, DTypeLike


def frozen_array(value: ArrayLike, dtype: DTypeLike = float) -> np.ndarray:
    """A read-only copy: what a frozen result holds."""
    array = np.array(value, dtype=dtype)
    array.setflags(write=False)
    return array
