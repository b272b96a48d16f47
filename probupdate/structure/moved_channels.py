"""Channels that a parameter moves along the structure: rows that read the motion elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

# a matrix of some channels (n, n_dof), sparse over degrees of freedom or dense on a basis
Rows = Any


@dataclass(frozen=True, eq=False, kw_only=True)
class MovedChannels:
    """With parameter number `column` at h between knots[i] and knots[i + 1], at the share t of the way, the channels
    read C + onto sum_p t^p powers[i][p] of the motion, C (n_row, n_dof) where h is 0 (`AffineModel.rows`): beams' own
    shapes are cubic between their nodes. onto (n_row, n) has a one where a row of the powers belongs to one of C."""

    column: int
    knots: np.ndarray
    onto: Rows
    powers: tuple[tuple[Rows, ...], ...]

    def change(self, h: float) -> Rows:
        """(n_row, n_dof)"""
        i, t, _ = self._piece(h)
        return self.onto @ sum(t**p * power for p, power in enumerate(self.powers[i]))

    def slope(self, h: float) -> Rows:
        """Of `change` with h."""
        i, t, length = self._piece(h)
        return self.onto @ sum(p * t ** (p - 1) / length * power for p, power in enumerate(self.powers[i]) if p)

    def _piece(self, h: float) -> tuple[int, float, float]:
        i = int(np.clip(np.searchsorted(self.knots, h) - 1, 0, len(self.powers) - 1))
        length = float(self.knots[i + 1] - self.knots[i])
        return i, float(h - self.knots[i]) / length, length

    def project(self, basis: Rows) -> MovedChannels:
        """The same of motions that are combinations of the basis (n_dof, r)."""
        return replace(self, powers=tuple(tuple(power @ basis for power in piece) for piece in self.powers))


def rows_moved(rows: Rows, moved: Sequence[MovedChannels], theta: np.ndarray) -> Rows:
    """What the channels read at theta of what they read as described."""
    for m in moved:
        if theta[m.column]:
            rows = rows + m.change(float(theta[m.column]))
    return rows
