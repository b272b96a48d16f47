"""Criteria of mode shapes: MAC, planes, phase collinearity, scaling, and pairs by the MAC.

Shapes are columns (n_channel, n_mode). Components that are NaN in either shape are left out of every criterion.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

# of a pair's two modes what they lack of 2 in spanning its plane, as at 65 degrees, that other two need not have
OWN_DIRECTIONS = 0.1


def mac(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Modal assurance criterion |a^H b|^2 / (a^H a b^H b) of each column of a with each of b -> (n_a, n_b).

    a (n_channel, n_a), b (n_channel, n_b), real or complex (Allemang & Brown 1982). NaN where a pair shares no
    measured component.
    """
    a, b = np.atleast_2d(np.asarray(a).T).T, np.atleast_2d(np.asarray(b).T).T
    ok_a, ok_b = np.isfinite(a), np.isfinite(b)
    x, y = np.where(ok_a, a, 0), np.where(ok_b, b, 0)
    cross = np.abs(x.conj().T @ y) ** 2
    norm_a = (np.abs(x) ** 2).T @ ok_b.astype(float)
    norm_b = ok_a.astype(float).T @ np.abs(y) ** 2
    with np.errstate(invalid="ignore", divide="ignore"):
        return cross / (norm_a * norm_b)


def subspace_mac(shape: np.ndarray, plane: np.ndarray) -> np.ndarray:
    """S2MAC: the largest MAC of each column of `shape` with any vector of the space that `plane` spans.

    shape (n_channel, n_mode), plane (n_channel, 2 or more) -> (n_mode,) (D'Ambrogio & Fregolent 2003). NaN where a
    column shares no more components with the plane than this has columns, or is zero at them.
    """
    shape = np.atleast_2d(np.asarray(shape).T).T
    value = np.full(shape.shape[1], np.nan)
    ok = np.isfinite(shape) & np.all(np.isfinite(plane), axis=1)[:, None]
    # columns that are measured at the same channels together, but for those that do not move there
    left = [j for j, column in enumerate(shape.T) if column[ok[:, j]].any()]
    while left:
        rows = ok[:, left[0]]
        own = [j for j in left if np.array_equal(ok[:, j], rows)]
        left = [j for j in left if j not in own]
        if rows.sum() > plane.shape[1]:
            basis, seen = np.linalg.qr(plane[rows])[0], shape[rows][:, own]
            value[own] = np.sum(np.abs(basis.conj().T @ seen) ** 2, axis=0) / np.sum(np.abs(seen) ** 2, axis=0)
    return value


def plane_mac(a: np.ndarray, b: np.ndarray) -> float:
    """Squared cosine of the largest principal angle between the planes of a and b, both (n_channel, 2 or more)."""
    ok = np.all(np.isfinite(a), axis=1) & np.all(np.isfinite(b), axis=1)
    qa, _ = np.linalg.qr(a[ok])
    qb, _ = np.linalg.qr(b[ok])
    return float(np.linalg.svd(qa.conj().T @ qb, compute_uv=False)[-1] ** 2)


def criteria_within_plane(plane: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """(n_mode, n_mode) how far each two columns of `shape` (n_channel, n_mode) are the directions of an orthonormal
    plane (n_channel, 2), 2 at most: half the squared sum of their cosines with two directions at right angles, turned
    in the plane for the best. That is half of both shares in the plane and the area between them: two that look alike
    have half of what they have one by one."""
    inside = plane.T @ shape / np.sqrt(np.maximum(np.sum(np.abs(shape) ** 2, axis=0), 1e-300))
    share = np.sum(np.abs(inside) ** 2, axis=0)
    crossed = inside[0][:, None] * inside[1]
    area = np.abs(crossed - crossed.T)
    return 0.5 * (share[:, None] + share) + area


def modes_of_plane(
    plane: np.ndarray, shape: np.ndarray, score: np.ndarray, own: tuple[int, ...], taken: Collection[int]
) -> tuple[int, ...]:
    """The two modes of a measured plane (n_channel, 2): `own`, or of these and those that are not `taken` the two that
    lie along directions of their own in it. Two that look alike to the sensors, as a bending and a torsion in which the
    sensors show that bending, would each be its best half. `score` (n_search,) of each by itself."""
    beside = criteria_within_plane(plane, shape[:, own])
    free = [i for i in range(len(score)) if score[i] > 0 and (i not in taken or i in own)]
    # no other two are better together than these are one by one
    if np.trace(beside) - beside[0, 1] < OWN_DIRECTIONS or len(free) < 3:
        return own
    first, second = np.triu_indices(len(free), 1)
    together = criteria_within_plane(plane, shape[:, free])
    near = score[free] - np.diag(together)
    total = near[first] + near[second] + together[first, second]
    best = int(np.argmax(total))
    return free[first[best]], free[second[best]]


def modal_phase_collinearity(shape: np.ndarray) -> np.ndarray:
    """MPC of each column (n_mode,): 1 for a shape that is real up to a phase, 0 for an even spread of phases.

    ((S_xx - S_yy)^2 + 4 S_xy^2) / (S_xx + S_yy)^2 with x, y the real and imaginary parts (Pappa 1993).
    """
    shape = np.atleast_2d(np.asarray(shape, complex).T).T
    x, y = np.nan_to_num(np.real(shape)), np.nan_to_num(np.imag(shape))
    sxx, syy, sxy = (x * x).sum(0), (y * y).sum(0), (x * y).sum(0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return ((sxx - syy) ** 2 + 4 * sxy**2) / (sxx + syy) ** 2


def rotate_to_real(shape: np.ndarray) -> np.ndarray:
    """Turn each complex column so that its components lie closest to the real axis (largest component positive)."""
    shape = np.array(np.atleast_2d(np.asarray(shape, complex).T).T)
    for j in range(shape.shape[1]):
        column = shape[:, j]
        ok = np.isfinite(column)
        if not ok.any():
            continue
        # the angle that maximises sum Re^2 is half the phase of sum phi^2
        column = column * np.exp(-0.5j * np.angle(np.sum(column[ok] ** 2)))
        largest = np.argmax(np.where(ok, np.abs(column), -1))
        shape[:, j] = column * (1 if column[largest].real >= 0 else -1)
    return shape


def unit_largest(shape: np.ndarray) -> np.ndarray:
    """Columns turned to lie along the real axis, the largest real part +1 (what imaginary part is left stays)."""
    turned = rotate_to_real(shape)
    real = np.real(turned)
    largest = np.argmax(np.abs(np.nan_to_num(real)), axis=0)
    return turned / real[largest, np.arange(real.shape[1])]


def pair_by_mac(criterion: np.ndarray) -> list[tuple[int, int]]:
    """One-to-one pairs (row, column) that maximise the summed criterion (n_row, n_column); NaN never pairs."""
    from scipy import optimize

    score = np.nan_to_num(criterion, nan=-1.0)
    rows, columns = optimize.linear_sum_assignment(-score)
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if score[i, j] > -1]


def share_within(shape: np.ndarray, plane: np.ndarray) -> float:
    """The share of the shape (n_channel,) squared that lies within the plane (n_channel, n): of one column, the MAC."""
    known = np.isfinite(shape)
    left = shape[known] - plane[known] @ np.linalg.lstsq(plane[known], shape[known], rcond=None)[0]
    return float(1 - left @ left / (shape[known] @ shape[known]))


def assign(criterion: np.ndarray) -> np.ndarray:
    """Column of each row (n_row,) with the largest sum of criteria (n_row, n_column), one to one."""
    from scipy import optimize

    score = np.nan_to_num(criterion, nan=-1.0)
    best = np.argmax(score, axis=1)
    # mostly every row's best column is its own, and no assignment problem need be solved
    if len(set(best.tolist())) == best.size:
        return best
    _, columns = optimize.linear_sum_assignment(-score)
    return columns
