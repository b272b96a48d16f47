"""Many constant matrices on one basis, held as the few entries that each has on the full model.

A term of an effect touches some dozen of a thousand degrees of freedom; on a basis of two hundred vectors it is full. A
thousand of them would be hundreds of megabytes there, and are two as they are: their sums are projected, not they.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from probupdate.model.parameters import Parameters
from probupdate.runtime.arrays import frozen_array

# degrees of freedom from which on what a parameter does is kept as a whole; a weight this far from a straight line, as
# a share of it, is on it
WIDELY_FELT, ROUNDED = 100, 1e-14


@dataclass(frozen=True, eq=False, kw_only=True)
class ProjectedTerms:
    """B^T K_t B for constant symmetric K_t (n_dof, n_dof) and a basis B (n_dof, r), and behind them parts F^T F that
    are given on the basis by their few rows F. row, column (n_entry,): places of the terms' joint pattern; entry
    (n_term, n_entry): sparse, what each term has there; added: F (n, r) of each part."""

    basis: np.ndarray
    row: np.ndarray
    column: np.ndarray
    entry: sparse.csr_array
    added: tuple[np.ndarray, ...] = ()

    @classmethod
    def project(cls, terms: Sequence[sparse.csc_array], basis: np.ndarray) -> ProjectedTerms:
        pattern, entry = union_pattern(terms)
        column = np.repeat(np.arange(pattern.shape[1]), np.diff(pattern.indptr))
        # a basis that is read-only is shared
        basis = frozen_array(basis) if basis.flags.writeable else basis
        return cls(basis=basis, row=pattern.indices, column=column, entry=entry)

    def __len__(self) -> int:
        return self.entry.shape[0] + len(self.added)

    def with_added(self, factors: Sequence[np.ndarray]) -> ProjectedTerms:
        """With further terms F^T F, of F (n, r), which are not copied."""
        return replace(self, added=(*self.added, *factors))

    def total(self, weight: np.ndarray) -> np.ndarray:
        """sum_t weight_t B^T K_t B (r, r) for weight (n_term,)."""
        return self._sum_observed(weight, lambda rows: rows)

    def project_between(self, weight: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        """sum_t weight_t X^T B^T K_t B X (k, k) for weight (n_term,) and X (r, k): for few vectors, or few entries."""
        return self._sum_observed(weight, lambda rows: rows @ vectors)

    def _sum_observed(self, weight: np.ndarray, motion: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """The sum of all terms with what rows (n_row, r) on the basis become by `motion` (n_row, k): (k, k)."""
        rows, whole = self._whole(weight)
        moved = motion(self.basis[rows])
        found = moved.T @ (whole @ moved)
        for value, factor in zip(weight[self.entry.shape[0] :], self.added, strict=True):
            if value:
                stretched = motion(factor)
                found += value * (stretched.T @ stretched)
        return 0.5 * (found + found.T)

    def rows(self, weight: np.ndarray) -> np.ndarray:
        """Degrees of freedom in which sum_t weight_t K_t has entries."""
        return self._whole(weight)[0]

    def _whole(self, weight: np.ndarray) -> tuple[np.ndarray, sparse.csr_array]:
        """The rows in which sum_t weight_t K_t has entries, and what it has there (n_row, n_row)."""
        sums = self._by_entry @ weight[: self.entry.shape[0]]
        places = np.flatnonzero(sums)
        # entries stand column by column; what is symmetric has the same rows
        starts = np.searchsorted(places, self._starts)
        rows = np.flatnonzero(np.diff(starts))
        number = np.empty(len(self.basis), self.row.dtype)
        number[rows] = np.arange(len(rows))
        whole = sparse.csr_array((sums[places], number[self.row[places]], np.append(starts[rows], len(places))),
                                 shape=(len(rows), len(rows)))
        return rows, whole

    @cached_property
    def _by_entry(self) -> sparse.csc_array:
        """(n_entry, n_term), the same numbers."""
        return self.entry.T

    @cached_property
    def moved(self) -> np.ndarray:
        """Numbers of the terms that have entries."""
        return np.flatnonzero(np.diff(self.entry.indptr))

    @cached_property
    def _starts(self) -> np.ndarray:
        """(n_dof + 1,): where each column's entries begin, and their end."""
        return np.searchsorted(self.column, np.arange(len(self.basis) + 1)).astype(self.row.dtype)

    def times(self, weights: np.ndarray, vectors: np.ndarray, onto: np.ndarray) -> np.ndarray:
        """sum_t weights_pt X^T B^T K_t B Y (n, k, m) for weights (n, n_term), X (r, k) and Y (r, m) `onto`: for each of
        the n sums only the rows of B are touched that its terms have entries in."""
        own, size = self.entry.shape[0], len(self.basis)
        result = np.zeros((len(weights), vectors.shape[1], onto.shape[1]))
        sums = sparse.csr_array(sparse.csr_array(weights[:, :own]) @ self.entry)
        sums.sort_indices()
        # the rows that have entries, of the symmetric sums one below the other; what is symmetric has the same columns
        sum_of, row = np.repeat(np.arange(len(weights)), np.diff(sums.indptr)), self.column[sums.indices]
        first = np.flatnonzero(np.diff(sum_of * size + row, prepend=-1))
        number = np.zeros(size, self.row.dtype)
        number[row] = 1
        felt = self.basis[np.flatnonzero(number)]
        number = np.cumsum(number, dtype=number.dtype) - 1
        touched = sparse.csr_array((sums.data, number[self.row[sums.indices]], np.append(first, sums.nnz)),
                                   shape=(len(first), len(felt))) @ (felt @ vectors)
        there, row = felt @ onto, number[row[first]]
        ends = np.searchsorted(sum_of[first], np.arange(len(weights) + 1))
        for p in np.flatnonzero(np.diff(ends)):
            part = slice(ends[p], ends[p + 1])
            result[p] = touched[part].T @ there[row[part]]
        for p, k in zip(*np.nonzero(weights[:, own:]), strict=True):
            factor = self.added[k]
            result[p] += weights[p, own + k] * ((factor @ vectors).T @ (factor @ onto))
        return result


@dataclass(frozen=True, eq=False, kw_only=True)
class Expansion:
    """sum_t weight_t(theta) B^T K_t B about parameters `theta`, where terms have `weight` (n_term,) and make `total`
    (r, r). `slopes`: by number of the parameter what one unit of it adds to both, for those that many degrees of
    freedom feel and whose weights are straight lines. Theirs are summed up; of all others what they differ by is
    projected, which has entries in few rows."""

    theta: np.ndarray
    weight: np.ndarray
    total: np.ndarray
    slopes: dict[int, tuple[np.ndarray, np.ndarray]]

    @classmethod
    def from_matrices(
        cls, parameters: Parameters, coefficients: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
        both: tuple[ProjectedTerms, ProjectedTerms],
    ) -> tuple[Expansion, Expansion]:
        """Of stiffness and mass about the parameters' initial values."""
        theta, result = parameters.initial, []
        step = 0.5 * (np.clip(theta + parameters.std, parameters.lower, parameters.upper) - theta)
        moved = np.flatnonzero(step)
        steps = np.diag(step)[moved]
        for terms, about, near, far in zip(both, *map(coefficients, (theta, theta + steps, theta + 2 * steps)),
                                           strict=True):
            straight = np.all(np.abs(far - 2 * near + about) <= ROUNDED * (np.abs(far) + np.abs(about)), axis=1)
            slopes = {int(k): (one - about) / step[k] for k, one in zip(moved[straight], near[straight], strict=True)}
            kept = {k: (frozen_array(slope), frozen_array(terms.total(slope))) for k, slope in slopes.items()
                    if len(terms.rows(slope)) >= WIDELY_FELT}
            result.append(cls(theta=theta, weight=frozen_array(about), total=frozen_array(terms.total(about)),
                              slopes=kept))
        return result[0], result[1]

    def evaluate(self, theta: np.ndarray, terms: ProjectedTerms, weight: np.ndarray) -> np.ndarray:
        """(r, r) at theta, where the terms have `weight`; parts may have been added behind both."""
        rest, n = np.array(weight), len(self.weight)
        rest[:n] -= self.weight
        scale, total = np.abs(weight[:n]) + np.abs(self.weight), np.array(self.total)
        for k, (slope, made) in self.slopes.items():
            amount = theta[k] - self.theta[k]
            if amount:
                rest[:n] -= amount * slope
                scale += np.abs(amount * slope)
                total += amount * made
        rest[:n][np.abs(rest[:n]) <= ROUNDED * scale] = 0.0
        return total + terms.total(rest)


def union_pattern(terms: Sequence[sparse.csc_array]) -> tuple[sparse.csc_array, sparse.csr_array]:
    """The union of the terms' patterns, and their entries on it (n_term, n_entry)."""
    n = terms[0].shape[0]
    keys = []
    for term in terms:
        columns = np.repeat(np.arange(n), np.diff(term.indptr))
        keys.append(columns.astype(np.int64) * n + term.indices)
    union = np.unique(np.concatenate(keys))
    place = np.concatenate([np.searchsorted(union, k) for k in keys])
    rows = np.repeat(np.arange(len(terms)), [len(k) for k in keys])
    data = sparse.csr_array(
        sparse.coo_array((np.concatenate([t.data for t in terms]), (rows, place)), shape=(len(terms), len(union)))
    )
    indptr = np.concatenate([[0], np.cumsum(np.bincount(union // n, minlength=n))])
    return sparse.csc_array((np.ones(len(union)), union % n, indptr), shape=(n, n)), data
