"""Arrays of results that are not meant to change."""

from __future__ import annotations

import numpy as np


def frozen_array(value, dtype=float) -> np.ndarray:
    """A read-only copy: what a frozen result holds."""
    array = np.array(value, dtype=dtype)
    array.setflags(write=False)
    return array
