"""Images of a posterior under exchanges of its parameters: one of them is sampled, and stands for all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# orders compared with draws at once
AT_ONCE = 500


@dataclass(frozen=True, eq=False, kw_only=True)
class Images:
    """Images of the parameters by exchanges that leave the posterior as it is: `orders` (n_image, n_param) of the
    parameters' numbers, the first as they are. Each theta is nearest to one of the images at[orders] of a point, in the
    prior's standard deviations: the posterior where the first is nearest, times their number, is all of it."""

    initial: np.ndarray
    std: np.ndarray
    at: np.ndarray
    orders: np.ndarray

    def nearest(self, theta: np.ndarray) -> np.ndarray:
        """Number of the image (n,) of theta (n, n_param)."""
        z = (theta - self.initial) / self.std
        best, found = np.full(len(z), -np.inf), np.zeros(len(z), int)
        for start in range(0, len(self.orders), AT_ONCE):
            near = z @ self.at[self.orders[start : start + AT_ONCE]].T
            own = np.argmax(near, axis=1)
            value = near[np.arange(len(z)), own]
            found, best = np.where(value > best, start + own, found), np.maximum(best, value)
        return found

    def fold(self, theta: np.ndarray) -> np.ndarray:
        """The image of theta (n, n_param) to which the first is nearest."""
        found = np.empty_like(theta)
        np.put_along_axis(found, self.orders[self.nearest(theta)], theta, axis=1)
        return found

    def spread(self, theta: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Each theta (..., n_param) in an order at random."""
        return np.take_along_axis(theta, self.orders[rng.integers(len(self.orders), size=theta.shape[:-1])], axis=-1)

    @property
    def log_number(self) -> float:
        return float(np.log(len(self.orders)))
