"""Files spoilt as disks, copies and editors spoil them."""

from __future__ import annotations

import numpy as np


def damaged(whole: bytes, rng: np.random.Generator, number: int, head: int = 600) -> bytes:
    """By `number`: cut off; single bytes changed, anywhere or within `head`; a piece zeroed or taken out."""
    content = bytearray(whole)
    if number % 4 == 0:
        del content[rng.integers(len(content)):]
    elif number % 4 == 3:
        first, length = rng.integers(len(content)), rng.integers(1, 200)
        content[first : first + length] = b"" if rng.random() < 0.5 else bytes(length)
    else:
        reach = len(content) if number % 4 == 1 else min(len(content), head)
        for place in rng.integers(reach, size=rng.integers(1, 20)):
            content[place] = rng.integers(256)
    return bytes(content)
