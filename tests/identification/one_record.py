"""Poles of one record in one call, for the tests of what is estimated."""

import numpy as np

from probupdate.identification.ssi import Poles, factorise, output_covariances, poles, stability


def identify_poles(
    data: np.ndarray, rate_hz: float, *, order: int, block_rows: int, spread: int = 0
) -> tuple[Poles, np.ndarray]:
    """Poles of one record (n_sample, n_channel) at one model order, and their stability (n_pole,) over the even
    distances up to `spread` below and above it (1 without)."""
    covariance = output_covariances(data, 2 * block_rows - 1)
    highest = min(order + spread, data.shape[1] * (block_rows - 1))
    around = tuple(n for n in range(order - spread, highest + 1, 2) if n != order and n >= 2)
    found = poles(factorise(covariance, block_rows, max(order, highest), rate_hz), (order, *around))
    return found[0], stability(found[0], found[1:]) if around else np.ones(len(found[0].frequency_hz))
