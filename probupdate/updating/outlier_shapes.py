"""Sets whose mode shape is unlike the other sets', whatever their frequencies say.

What a set's shape has beside the others' own, of modes near in frequency beside their common plane, is compared in size
with that of the others: a ratio F of as many degrees of freedom as their residuals have directions, wider by WIDE where
the set is an outlier. As everywhere in `outlier_sets`, each is judged by the others alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probupdate.modal.modes import ModalData
from probupdate.modal.rounding import rounding_std
from probupdate.runtime.arrays import frozen_array
from probupdate.updating.settings import CONSTANTS

WIDE = CONSTANTS.outlier_shape_wide
# modes nearer than this in ln f turn within the plane that they span
NEAR = 0.1
# of a shape of unit length, where nothing is stated and all sets agree to the last digit
LEAST = 1e-5
# a shape so many times farther off than half of the sets' does not count to begin with
FAR = 5.0


@dataclass(frozen=True, eq=False, kw_only=True)
class ShapeTable:
    """Shapes of unit length (n_set, n_row, n_mode) at the channels that every set has, NaN where not measured; their
    stated variance, summed over the channels (n_set, n_mode); near (n_mode, n_mode): modes that turn within a plane."""

    shape: np.ndarray
    variance: np.ndarray
    near: np.ndarray

    @classmethod
    def from_sets(cls, data: ModalData, ln_frequency: np.ndarray) -> ShapeTable:
        shape = np.array([s.shape for s in data.sets])
        std = np.nan_to_num(np.array([s.shape_std for s in data.sets], float))
        there = np.isfinite(shape)
        rows = np.flatnonzero(np.all(there | ~there.any(axis=1, keepdims=True), axis=(0, 2)))
        shape, std = shape[:, rows], std[:, rows]
        # of rounded shapes the others' scatter is the grid's, or none at all
        parts = np.concatenate([shape.real.ravel(), shape.imag.ravel()])
        std = np.hypot(std, rounding_std(parts))
        length = np.sqrt(np.sum(np.abs(shape) ** 2, axis=1, keepdims=True))
        with np.errstate(invalid="ignore", divide="ignore"):
            shape, std = shape / length, std / length
        variance = np.maximum(np.nan_to_num(np.sum(std**2, axis=1)), LEAST**2)
        middle = np.array([np.median(x[np.isfinite(x)]) if np.isfinite(x).any() else np.nan for x in ln_frequency.T])
        return cls(shape=frozen_array(shape, complex), variance=frozen_array(variance),
                   near=np.abs(middle[:, None] - middle) < NEAR)

    def measured(self, j: int) -> np.ndarray:
        """(n_set,) bool."""
        return np.isfinite(self.shape[:, :, j]).all(axis=1) & (self.shape.shape[1] > 0)

    def residual(self, j: int, sets: np.ndarray, others: np.ndarray) -> np.ndarray:
        """What the shapes of some sets (n,) have beside what the others span, (n, n_row); no column where these leave
        nothing."""
        known = []
        for i in np.flatnonzero(self.near[j]):
            some = self.shape[others & self.measured(i), :, i]
            if len(some):
                known.append(np.linalg.eigh(some.T @ some.conj())[1][:, -1:])
        basis = np.linalg.qr(np.concatenate(known, axis=1))[0]
        if basis.shape[1] >= self.shape.shape[1]:
            return np.zeros((len(sets), 0), complex)
        own = self.shape[sets][:, :, j]
        return own - own @ basis.conj() @ basis.T

    def median_sets(self) -> np.ndarray:
        """Sets (n_set,) to begin with."""
        alike = np.ones(len(self.shape), bool)
        for j in range(self.shape.shape[2]):
            there = self.measured(j)
            size = np.sum(np.abs(self.residual(j, np.flatnonzero(there), there)) ** 2, axis=1) if there.any() else []
            if len(size):
                alike[there] &= size <= FAR**2 * np.maximum(np.median(size), self.variance[there, j])
        return alike

    def log_ratio(self, s: int, j: int, others: np.ndarray) -> tuple[float, float]:
        """ln of the density of set s as an outlier by the shape of mode j over that as one of the others, and
        its MAC with what they span; -inf where a shape says nothing."""
        number = np.flatnonzero(others)
        left, own = self.residual(j, number, others), self.residual(j, np.array([s]), others)
        if not left.shape[1]:
            return -np.inf, 1.0
        size, far = np.sum(np.abs(left) ** 2, axis=1), float(np.sum(np.abs(own) ** 2))
        excess = max(float(size.mean()) - float(self.variance[number, j].mean()), 0.0)
        expected = self.variance[s, j] + excess
        directions = max(float(size.sum() ** 2 / max(np.sum(np.abs(left.T @ left.conj()) ** 2), 1e-300)), 1.0)
        ratio, wider, rest = far / expected, 1 + WIDE**2 / expected, directions * (len(number) - 1)
        # ln of F of `directions` and `rest` degrees of freedom at ratio / wider, over wider, less that at ratio
        odds = 0.5 * (directions + rest) * np.log((1 + ratio * directions / rest) / (
            1 + ratio * directions / (wider * rest))) - 0.5 * directions * np.log(wider)
        return float(odds), 1 - far
