"""Equations of unknowns that groups of numbers have for themselves, and of some that all groups share.

Groups meet in the shared unknowns alone, so that a Cholesky factor has each group's own block, what that makes of the
shared ones, and the factor of what is left of these (Schur complement; Golub & Van Loan 2013, ch. 4.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

# groups of fewer unknowns are one, as many small products take longer than a larger one
WORTH_APART = 64


@dataclass(frozen=True, eq=False, kw_only=True)
class ArrowFactor:
    """Cholesky factor: `groups` and `shared`, numbers of the unknowns; per group its root L (n, n), and `crossed`
    L^-1 A (n, n_shared); the `last` root, of the shared ones."""

    groups: tuple[np.ndarray, ...]
    shared: np.ndarray
    roots: tuple[np.ndarray, ...]
    crossed: tuple[np.ndarray, ...]
    last: np.ndarray

    @classmethod
    def factorise(cls, matrix: np.ndarray, groups: Sequence[np.ndarray], shared: np.ndarray, scale: np.ndarray,
           rounding: float) -> ArrowFactor:
        """Of I + (1 + rounding on the diagonal) * scale * matrix * scale. Raises LinAlgError where it is singular."""
        def scaled(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
            block = matrix[rows[:, None], columns]
            block *= scale[rows, None] * scale[columns]
            if rows is columns:
                diagonal = block.reshape(-1)[:: len(rows) + 1]
                diagonal *= 1.0 + rounding
                diagonal += 1.0
            return block

        own = _merge_groups(groups)
        roots = tuple(np.linalg.cholesky(scaled(rows, rows)) for rows in own)
        crossed = tuple(_lower(root, scaled(rows, shared)) for root, rows in zip(roots, own, strict=True))
        left = scaled(shared, shared)
        for part in crossed:
            left -= part.T @ part
        return cls(groups=own, shared=shared, roots=roots, crossed=crossed, last=np.linalg.cholesky(left))

    @property
    def log_diagonal(self) -> float:
        """Half of the ln determinant."""
        return float(sum(np.sum(np.log(np.diag(root))) for root in (*self.roots, self.last)))

    def half_solve(self, right: np.ndarray) -> np.ndarray:
        """L^-1 right (n, m), whose squares add up to right^T A^-1 right."""
        result = np.zeros_like(right)
        left = right[self.shared]
        for rows, root, part in zip(self.groups, self.roots, self.crossed, strict=True):
            result[rows] = own = _lower(root, right[rows])
            left -= part.T @ own
        result[self.shared] = _lower(self.last, left)
        return result

    def solve(self, right: np.ndarray) -> np.ndarray:
        """A^-1 right (n, m) or (n,)."""
        result = self.half_solve(right)
        result[self.shared] = common = _lower(self.last, result[self.shared], transposed=True)
        for rows, root, part in zip(self.groups, self.roots, self.crossed, strict=True):
            result[rows] = _lower(root, result[rows] - part @ common, transposed=True)
        return result


def _lower(root: np.ndarray, right: np.ndarray, *, transposed: bool = False) -> np.ndarray:
    if not right.size:
        return right
    # what SciPy's function does around this takes five times as long as so small equations; columns without a copy
    found, singular = linalg.lapack.dtrtrs(root.T, right, lower=0, trans=int(not transposed))
    if singular:
        raise np.linalg.LinAlgError("a factor of the unknowns' information is singular")
    return found


def _merge_groups(groups: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
    result: list[np.ndarray] = []
    for rows in groups:
        if result and len(result[-1]) + len(rows) <= WORTH_APART:
            result[-1] = np.concatenate([result[-1], rows])
        elif len(rows):
            result.append(rows)
    return tuple(result)
