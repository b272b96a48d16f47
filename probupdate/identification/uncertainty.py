"""Covariance factors of poles: how frequency, damping and complex shape scatter with the output covariances.

Reynders, Pintelon & De Roeck (2008), Uncertainty bounds on modal parameters obtained from stochastic subspace
identification; in the fast form of Doehler & Mevel (2013), Efficient multi-order uncertainty computation for stochastic
subspace identification. The covariances of sub-records give changes dR of R; each is carried through the block
Toeplitz matrix, its singular vectors, A and C to the poles. Nothing larger than (n_channel block_rows, order, n_sub) is
formed: of dT only its products with singular vectors, and turns of the states' basis, which no pole knows of, are left
out. Every dR that is handed in is carried through; nothing is regularised.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft, linalg

from probupdate.errors import InputError
from probupdate.identification.settings import CONSTANTS
from probupdate.identification.ssi import (
    Factorisation,
    Realisation,
    block_toeplitz,
    product_sums,
    realisations,
)
from probupdate.modal.modes import CovarianceFactors

LEAST_GAP = CONSTANTS.least_gap


def sub_record_covariances(
    data: np.ndarray, n_lag: int, sub_records: int, projection: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """R (n_lag + 1, n_channel, n_reference) of a record (n_sample, n_channel), and its changes (n_sub, ...), one for
    each of `sub_records` consecutive parts of the record.

    Scaled so that sum_j dR_j[a] dR_j[b] estimates the covariance of R's elements a and b, as if parts were
    independent: (R_j - R) / sqrt(n_sub (n_sub - 1)) for parts of equal length. Products reach over the end of a part.
    """
    n_sample = len(data)
    if not isinstance(sub_records, int | np.integer) or isinstance(sub_records, bool) or sub_records < 2:
        raise InputError("sub-records", f"{sub_records!r} is not a whole number from 2", "give one, such as 30")
    if n_sample // sub_records <= n_lag:
        raise InputError("sub-records", f"{sub_records} of {n_sample // sub_records} samples each for {n_lag} lags",
                         f"give at most {n_sample // (n_lag + 1)}, fewer block rows or a longer record")
    edges = np.round(np.linspace(0, n_sample, sub_records + 1)).astype(int)
    sums = product_sums(data, n_lag, edges, projection)
    lag = np.arange(n_lag + 1)
    total = (n_sample - lag)[:, None, None]
    covariance = sums.sum(axis=0) / total
    products = np.minimum(edges[1:, None], n_sample - lag) - edges[:-1, None]  # (n_sub, n_lag + 1)
    sums -= products[:, :, None, None] * covariance
    sums *= np.sqrt(sub_records / (sub_records - 1)) / total
    return covariance, sums


def toeplitz_products(
    change: np.ndarray, block_rows: int, right: np.ndarray, left: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """dT V and dT^T U for every sub-record, without dT: (n_channel br, n, n_sub), (n_reference br, n, n_sub).

    change (n_sub, 2 br, n_channel, n_reference); right V (n_reference br, n), left U (n_channel br, n). A block
    Toeplitz matrix times a vector is a convolution over block rows.
    """
    n_sub, _, m, r = change.shape
    n = right.shape[1]
    size = fft.next_fast_len(2 * block_rows - 1, real=True)
    lags = np.zeros((size, n_sub, m, r))
    lags[:block_rows] = change[:, block_rows: 2 * block_rows].transpose(1, 0, 2, 3)
    lags[size - block_rows + 1:] = change[:, 1:block_rows].transpose(1, 0, 2, 3)
    line = fft.rfft(lags, axis=0)
    n_line = len(line)
    v = fft.rfft(right.reshape(block_rows, r, n), n=size, axis=0)
    u = fft.rfft(left.reshape(block_rows, m, n), n=size, axis=0)
    product = np.matmul(line.reshape(n_line, n_sub * m, r), v)
    turned = np.ascontiguousarray(line.conj().transpose(0, 1, 3, 2))
    back = np.matmul(turned.reshape(n_line, n_sub * r, m), u)

    def rows(spectrum: np.ndarray, width: int) -> np.ndarray:
        found = fft.irfft(spectrum, n=size, axis=0)[:block_rows].reshape(block_rows, n_sub, width, n)
        return found.transpose(0, 2, 3, 1).reshape(block_rows * width, n, n_sub)

    return rows(product, m), rows(back, r)


@dataclass(frozen=True, eq=False, kw_only=True)
class ObservabilityChange:
    """Changes of the leading left singular vectors u_1..u_n of T, from which those of O follow for every
    order up to n.

    along (n, n_basis, n_sub): u_l^T du_i at [i, l], NaN where l is i. basis (n_channel br, n_basis): every left
    singular vector, descending; beyond (n, n_channel br, n_sub): the part of du_i outside their span, None where they
    span all. singular (n,); squared_next: s_(n + 1)^2; rounding (n,): of the squared singular values. Products are made
    of `along` for the few columns that are asked for: du_i itself, n_channel br numbers for each i and part, is never
    formed.
    """

    along: np.ndarray
    basis: np.ndarray
    beyond: np.ndarray | None
    singular: np.ndarray
    squared_next: float
    rounding: np.ndarray

    @property
    def n_sub(self) -> int:
        return self.along.shape[2]

    def known(self, order: int) -> bool:
        """False where the order parts two singular values that are equal but for rounding: O has no derivative."""
        following = np.append(self.singular**2, self.squared_next)[order]
        return bool(self.singular[order - 1] ** 2 - following > LEAST_GAP * self.rounding[order - 1])

    def times(self, state: np.ndarray) -> np.ndarray:
        """dO X (n_column, n_channel br, n_sub) for real X (order, n_column), without the part in the span of O."""
        order = len(state)
        weight = (np.sqrt(self.singular[:order])[:, None] * state).T
        mixed = (weight @ self.along[:order].reshape(order, -1)).reshape(len(weight), -1, self.n_sub)
        found = np.matmul(self.basis[:, order:], mixed[:, order:])
        if self.beyond is not None:
            found += (weight @ self.beyond[:order].reshape(order, -1)).reshape(found.shape)
        return found

    def transposed_times(self, rows: np.ndarray, order: int) -> np.ndarray:
        """dO_up^T Y (order, n_column, n_sub) for real Y (n_row, n_column), O_up being O's first n_row; likewise."""
        found = np.matmul(rows.T @ self.basis[: len(rows), order:], self.along[:order, order:])
        if self.beyond is not None:
            found += np.matmul(rows.T, self.beyond[:order, : len(rows)])
        return found * np.sqrt(self.singular[:order])[:, None, None]


def observability_change(
    covariance: np.ndarray, change: np.ndarray, factorisation: Factorisation, block_rows: int
) -> ObservabilityChange:
    """Changes of the singular vectors of all orders of a factorisation with all of them
    (`factorise(whole=True)`), from dR (n_sub, 2 br, n_channel, n_ref).

    For u_i, v_i, s_i of T = U S V^T, du_i solves (s_i^2 - T T^T) du_i = s_i dT v_i + T dT^T u_i: along another left
    singular vector u_l, that is division by s_i^2 - s_l^2.
    """
    n = factorisation.rank
    singular = factorisation.singular_value[:n]
    if factorisation.whole is None:
        raise ValueError("the factorisation has its leading singular vectors alone: factorise(..., whole=True)")
    squared, basis, rounding = factorisation.whole
    u = basis[:, :n]
    toeplitz = block_toeplitz(covariance, block_rows)
    v = toeplitz.T @ u / singular
    dt_v, dt_u = toeplitz_products(change, block_rows, v, u)
    size, n_sub = len(u), dt_v.shape[2]
    source = (toeplitz @ dt_u.reshape(len(dt_u), -1)).reshape(size, n, n_sub)
    source += dt_v * singular[:, None]
    along = (basis.T @ source.reshape(size, -1)).reshape(-1, n, n_sub)
    # gaps that are nothing but rounding are kept out by `known`; here they only must not divide by zero
    along /= _divisor(singular**2 - squared[:, None])[:, :, None]
    beyond = None
    if toeplitz.shape[0] > toeplitz.shape[1]:
        # what lies outside the span of T: there T T^T is zero
        beyond = (dt_v / singular[:, None]).reshape(size, -1)
        beyond = beyond - basis @ (basis.T @ beyond)
        beyond = np.ascontiguousarray(beyond.reshape(size, n, n_sub).transpose(1, 0, 2))
    return ObservabilityChange(
        along=np.ascontiguousarray(along.transpose(1, 0, 2)), basis=basis, beyond=beyond, singular=singular,
        squared_next=float(squared[n]) if len(squared) > n else 0.0, rounding=rounding[:n],
    )


def _divisor(gap: np.ndarray) -> np.ndarray:
    return np.where(gap == 0, np.nan, gap)


def pole_factors(
    changed: ObservabilityChange, factorisation: Factorisation, *, order: int, indices: np.ndarray
) -> CovarianceFactors:
    """Covariance factors of the poles `indices` of that order, a column a sub-record; NaN for an index of -1.

    indices (n_mode,) into the order's poles; shapes as `modes.unit_largest` scales them. NaN for all where the order
    parts two singular values that are equal but for rounding, or where a pole is a multiple one.
    """
    m = factorisation.n_channel
    indices = np.asarray(indices)
    n = min(order, factorisation.rank)
    (realisation,) = realisations(factorisation, (n,))
    n_pole = len(realisation.oscillating)
    if indices.ndim != 1 or indices.dtype.kind not in "iu" or np.any(indices < -1) or np.any(indices >= n_pole):
        raise InputError("poles", f"{indices.tolist()} are not indices of {n_pole} poles", "give 0.., or -1 for none")
    there = np.flatnonzero(indices >= 0)
    table = (len(indices), changed.n_sub)
    ln_frequency, damping = np.full(table, np.nan), np.full(table, np.nan)
    shape = np.full((m, *table), np.nan + 0j)
    if there.size and changed.known(n):
        chosen = realisation.oscillating[indices[there]]
        eigenvalue, raw = _eigen_change(factorisation.observability[:, :n], changed, realisation, chosen, m)
        mu = realisation.eigenvalue[chosen]
        pole = factorisation.sampling_rate_hz * np.log(mu)
        moved = factorisation.sampling_rate_hz * eigenvalue / mu[:, None]
        size = np.abs(pole)[:, None]
        ln_frequency[there] = (moved / pole[:, None]).real
        damping[there] = -moved.real / size + (pole.real[:, None] / size) * ln_frequency[there]
        shape[:, there] = scaled_change(realisation.output @ realisation.vector[:, chosen], raw)
    return CovarianceFactors(ln_frequency=ln_frequency, damping_ratio=damping, shape=shape)


def _eigen_change(
    observability: np.ndarray, changed: ObservabilityChange, realisation: Realisation, chosen: np.ndarray, m: int
) -> tuple[np.ndarray, np.ndarray]:
    """d mu (n_chosen, n_sub), and d(C psi) (m, n_chosen, n_sub) up to a multiple of C psi.

    dA psi = O_up^+ (dO_down - mu dO_up) psi + (O_up^T O_up)^-1 dO_up^T (O_down - mu O_up) psi: the second term is there
    because O_up A = O_down holds in least squares only.
    """
    n, n_sub, k = observability.shape[1], changed.n_sub, len(chosen)
    mu, psi = realisation.eigenvalue, realisation.vector[:, chosen]
    q, r = np.linalg.qr(observability[:-m])
    residual = observability[m:] @ psi - (observability[:-m] @ psi) * mu[chosen]
    parts = changed.times(np.column_stack([np.real(psi), np.imag(psi)]))
    turned = parts[:k] + 1j * parts[k:]  # (k, rows, n_sub): dO psi
    shift = turned[:, m:] - mu[chosen][:, None, None] * turned[:, :-m]
    first = np.matmul(q.T, shift).transpose(1, 0, 2)
    parts = changed.transposed_times(np.column_stack([np.real(residual), np.imag(residual)]), n)
    second = (parts[:, :k] + 1j * parts[:, k:]).reshape(n, -1)
    second = linalg.solve_triangular(r, second, trans="T")
    moved = linalg.solve_triangular(r, first.reshape(n, -1) + second)
    modal = np.linalg.solve(realisation.vector, moved).reshape(n, len(chosen), n_sub)
    gap = mu[chosen] - mu[:, None]  # (n, n_chosen)
    own = np.arange(n)[:, None] == chosen
    gap[own] = np.inf
    gap[gap == 0] = np.nan
    vector = (realisation.vector @ (modal / gap[:, :, None]).reshape(n, -1)).reshape(n, len(chosen), n_sub)
    output = np.tensordot(realisation.output, vector, axes=(1, 0)) + turned[:, :m].transpose(1, 0, 2)
    return modal[chosen, np.arange(len(chosen))], output


def scaled_change(shape: np.ndarray, change: np.ndarray) -> np.ndarray:
    """The change of `unit_largest(shape)` when shape (n_channel, n_mode) moves by change (...,
    n_column).

    A multiple of the shape that is added to the change, real or complex, goes out.
    """
    shape = np.asarray(shape, complex)
    turn = np.exp(-0.5j * np.angle(np.sum(shape**2, axis=0)))
    real = (shape * turn).real
    largest, mode = np.argmax(np.abs(real), axis=0), np.arange(shape.shape[1])
    scale = turn / real[largest, mode]
    unit, moved = (shape * scale)[:, :, None], change * scale[:, None]
    # the angle that the rotation to the real axis takes away: half the change of phase of sum phi^2, now real
    angle = np.sum(unit * moved, axis=0).imag / np.sum(unit**2, axis=0).real
    moved = moved - 1j * angle * unit
    return moved - unit * moved[largest, mode].real
