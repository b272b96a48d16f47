"""Evidence of numbers that are measured once, in closed form.

Numbers y (n,) scatter with stated standard deviations about what unknowns make of them, y = U c + e, each of the c
normal with a standard deviation of one: an effect's score and information, and the density of the numbers as they were
measured or as they were without an effect (Woodbury; Rasmussen & Williams 2006, ch. 2.7).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg


@dataclass(frozen=True, eq=False, kw_only=True)
class Once:
    """numbers (n,), their standard deviations std (n,), unknowns U (n, m)."""

    numbers: np.ndarray
    std: np.ndarray
    unknowns: np.ndarray

    @cached_property
    def _scaled_rows(self) -> np.ndarray:
        return self.unknowns / self.std[:, None]

    @cached_property
    def _factor(self) -> tuple[np.ndarray, bool]:
        return linalg.cho_factor(np.eye(self.unknowns.shape[1]) + self._scaled_rows.T @ self._scaled_rows, lower=True)

    def _solve_noise(self, white: np.ndarray) -> np.ndarray:
        return white - self._scaled_rows @ linalg.cho_solve(self._factor, self._scaled_rows.T @ white)

    @cached_property
    def log_density(self) -> float:
        """But for powers of 2 pi."""
        return float(-0.5 * self.misfits(self.numbers[:, None])[0] - np.sum(np.log(np.diag(self._factor[0])))
                     - np.sum(np.log(self.std)))

    def misfits(self, others: np.ndarray) -> np.ndarray:
        """(k,) chi-square of other numbers (n, k) with the same unknowns."""
        white = others / self.std[:, None]
        return np.sum(white * self._solve_noise(white), axis=0)

    def scores(self, signature: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Score (k,) and information (k, k) of effects of these signatures (n, k)."""
        white = signature / self.std[:, None]
        solved = self._solve_noise(white)
        return solved.T @ (self.numbers / self.std), white.T @ solved

    def log_wider(self, extra: np.ndarray) -> float:
        """ln Bayes factor of numbers that each scatter by an extra standard deviation (n,)."""
        return replace(self, std=np.hypot(self.std, extra)).log_density - self.log_density
