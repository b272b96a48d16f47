"""Checksums of what is in a file, by which a reader finds out that it is no more what was written."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping

import numpy as np


def checksum_of_arrays(arrays: Mapping[str, np.ndarray]) -> bytes:
    """Of the arrays' names, kinds, shapes and numbers."""
    found = hashlib.blake2b(digest_size=16)
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        found.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        found.update(array.tobytes())
    return found.digest()


def checksum_of_table(table: Mapping[str, object]) -> str:
    """Of a table of plain values, as JSON has them, in whatever order its keys stand."""
    return hashlib.blake2b(json.dumps(table, sort_keys=True).encode(), digest_size=16).hexdigest()
