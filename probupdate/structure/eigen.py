"""Lowest modes of sparse K, M and their exact derivatives, also for close pairs."""

from __future__ import annotations

import numpy as np
from scipy import linalg, sparse
from scipy.sparse import linalg as sparse_linalg

from probupdate.errors import InputError

# relative residual |K phi - lambda M phi| / |K phi| above which an eigenpair is refused; Lanczos in double
# precision leaves 1e-10 on these matrices
RESIDUAL_LIMIT = 1e-6
# below so many degrees of freedom, or of a model on a basis, whose matrices are full, a dense solution is ten times
# faster than Lanczos' bookkeeping
DENSE_BELOW = 80
FULL_BELOW, FULL_SHARE = 500, 0.25
# SuperLU's symmetric mode: an ordering that suits a frame (four times fewer entries than its default), and no pivoting
# for positive definite matrices, hardly any for others
SYMMETRIC = {"permc_spec": "MMD_AT_PLUS_A", "options": {"SymmetricMode": True}}
# of a shape derivative's equation, relative: where corrections stop, and above which a pivoted factorisation is taken
REFINED, REFUSED = 1e-11, 1e-9
CORRECTIONS = 20
# share of the largest 1 / lambda below which there is no mass: rounding alone leaves some 1e-16
MASSLESS = 1e-14
# a mode's own factorisation is made this share beside its eigenvalue, where the matrix is not singular
BESIDE = 1e-6
# eigenvalues nearer to each other (relative) are equal but for rounding
EQUAL = 1e-9


def lowest_modes(K: sparse.csc_array, M: sparse.csc_array, n_mode: int, where: str = "model"):
    """Eigenvalues lambda (n_mode,) ascending and shapes phi (n_dof, n_mode) of K phi = lambda M phi, phi^T M phi = 1.

    Shift-invert Lanczos at zero with one symmetric-ordering factorisation and a fixed start vector, or, for small
    matrices, a dense solution. Raises InputError where K is singular or indefinite.
    """
    n = K.shape[0]
    # Lanczos leaves two modes out, a dense solution none
    if n_mode > (n if _solved_dense(K) else n - 2):
        raise InputError(where, f"{n_mode} modes asked of {n} degrees of freedom", "ask for fewer")
    if _is_full(K):
        value, phi = _dense(K, M, n_mode, where)
    else:
        factor = _definite_factor(K, where)
        value, phi = _dense(K, M, n_mode, where) if n < DENSE_BELOW else _lanczos(K, M, n_mode, factor)
    order = np.argsort(value)
    value, phi = value[order], phi[:, order]
    force = K @ phi
    residual = np.linalg.norm(force - (M @ phi) * value, axis=0) / np.linalg.norm(force, axis=0)
    if not np.all(residual < RESIDUAL_LIMIT):
        raise InputError(
            where, f"mode {int(np.argmax(residual)) + 1} has a relative residual of {residual.max():.1e}",
            "check units and the condition of the matrices",
        )
    phi /= np.sqrt(np.einsum("ij,ij->j", phi, M @ phi))
    largest = np.argmax(np.abs(phi), axis=0)
    return value, phi * np.sign(phi[largest, np.arange(n_mode)])


def available_modes(K, M) -> int:
    """How many modes `lowest_modes` gives: of small models one for each degree of freedom that has mass."""
    n = K.shape[0]
    if not _solved_dense(K):
        return n - 2
    try:
        mu = linalg.eigvalsh(_array(M), _array(K))
    except linalg.LinAlgError:
        # the solution itself says what is wrong with K
        return n
    # without any positive mass too
    return int(np.sum(mu > MASSLESS * mu[-1])) if mu[-1] > 0 else n


def _solved_dense(K) -> bool:
    return K.shape[0] < DENSE_BELOW or _is_full(K)


def _is_full(K) -> bool:
    return not sparse.issparse(K) or (K.shape[0] < FULL_BELOW and K.nnz > FULL_SHARE * K.shape[0] ** 2)


def _array(matrix) -> np.ndarray:
    return matrix.toarray() if sparse.issparse(matrix) else matrix


def _definite_factor(K, where: str):
    try:
        factor = sparse_linalg.splu(sparse.csc_matrix(K), diag_pivot_thresh=0.0, **SYMMETRIC)
    except RuntimeError as error:
        raise InputError(
            where, f"the stiffness matrix is singular ({error}): a mechanism or a missing support",
            "check supports, bounds and zero stiffness factors",
        ) from None
    # with a symmetric permutation and no pivoting the signs of U's diagonal are the inertia of K
    if np.any(factor.U.diagonal() <= 0):
        raise _indefinite(where)
    return factor


def _indefinite(where: str) -> InputError:
    return InputError(
        where, "the stiffness matrix is not positive definite: a mechanism or a negative stiffness factor",
        "check supports and the parameters' bounds",
    )


def _lanczos(K, M, n_mode: int, factor):
    n = K.shape[0]
    inverse = sparse_linalg.LinearOperator((n, n), factor.solve, dtype=float)
    start = np.cos(np.arange(n))
    return sparse_linalg.eigsh(
        sparse.csc_matrix(K), k=n_mode, M=sparse.csc_matrix(M), sigma=0.0, OPinv=inverse, v0=start, tol=1e-12,
        ncv=min(n, max(2 * n_mode + 8, 24)),
    )


def _dense(K, M, n_mode: int, where: str):
    """M phi = mu K phi with mu = 1 / lambda: K is positive definite, M need not be (massless degrees of freedom)."""
    n = K.shape[0]
    K, M = _array(K), _array(M)
    try:
        mu, phi = linalg.eigh(M, K, subset_by_index=(n - n_mode, n - 1))
    except linalg.LinAlgError:
        raise _indefinite(where) from None
    if mu[0] <= MASSLESS * mu[-1]:
        raise InputError(where, f"fewer than {n_mode} modes have a positive mass: the mass matrix is indefinite or has "
                         "too many massless degrees of freedom", "check M0 and every M_<name>")
    return 1 / mu, phi


def mode_derivatives(K, M, value, phi, dK_phi, dM_phi, clusters):
    """d lambda (n_mode, n_param) and d phi (n_dof, n_mode, n_param).

    dK_phi, dM_phi (n_dof, n_mode, n_param): (dK/d theta_k) phi_j and likewise for M. Each mode's shape derivative is
        d phi_j = v - 1/2 Phi_c Phi_c^T dM phi_j,  (K - lambda_j M) v = -(dK - lambda_j dM) phi_j,  Phi_c^T M v = 0,
    the equation for v within the range of its matrix (Nelson 1976, bordered by the whole cluster). For a cluster of one
    this is the plain derivative; for several, and for modes equal to rounding, the rotation among them is left out.
    """
    n, n_mode = phi.shape
    cluster_of: dict[int, tuple[int, ...]] = {j: (j,) for j in range(n_mode)}
    for cluster in clusters:
        for j in cluster:
            cluster_of[j] = tuple(cluster)
    for j, own in cluster_of.items():
        # of equal modes any combination is one: how they turn into each other has no derivative
        equal = np.flatnonzero(np.abs(value - value[j]) <= EQUAL * np.abs(value[j]))
        cluster_of[j] = tuple(sorted({*own, *equal.tolist()}))
    d_value = np.empty((n_mode, dK_phi.shape[2]))
    d_phi = np.empty((n, n_mode, dK_phi.shape[2]))
    full = n < DENSE_BELOW or _is_full(K)
    if full:
        K, M = _array(K), _array(M)
    for j in range(n_mode):
        basis = phi[:, list(cluster_of[j])]
        change = dK_phi[:, j] - value[j] * dM_phi[:, j]
        d_value[j] = phi[:, j] @ change
        right = basis @ (basis.T @ change)
        right = M @ right - change
        solution = None if full else _deflated(K, M, value[j], basis, right)
        if solution is None:
            solution = _bordered(K - value[j] * M, M, M @ basis, right)
        d_phi[:, j] = solution - 0.5 * basis @ (basis.T @ dM_phi[:, j])
    return d_value, d_phi


def _deflated(K, M, value: float, basis, right):
    """v (n, n_param) of (K - value M) v = right, basis^T M v = 0, or None where it is not found to REFUSED.

    The matrix is factorised a hair beside the eigenvalue, which Newton corrections make good; what the cluster gets by
    that is taken out. Five times faster than factorising the bordered matrix, whose border fills in.
    """
    matrix = sparse.csc_matrix(K - value * M)
    try:
        factor = sparse_linalg.splu(sparse.csc_matrix(K - (1 + BESIDE) * value * M), diag_pivot_thresh=0.01,
                                    **SYMMETRIC)
    except RuntimeError:
        return None
    weighted = M @ basis
    solution, left = np.zeros_like(right), right
    size = np.linalg.norm(right, axis=0)
    # parameters that do not move the mode have nothing to be solved for
    size[size == 0] = 1.0
    error = np.inf
    for _ in range(CORRECTIONS):
        step = factor.solve(left)
        fresh = solution + step - basis @ (weighted.T @ step)
        left = right - matrix @ fresh
        left -= weighted @ (basis.T @ left)
        now = np.max(np.linalg.norm(left, axis=0) / size)
        # rounding ends it
        if not now < 0.5 * error:
            break
        solution, error = fresh, now
        if error < REFINED:
            break
    return solution if error < REFUSED else None


def _bordered(matrix, mass, border, right):
    """v of [matrix, border; border^T, 0] [v; mu] = [right; 0], with pivoting. Where an equal mode is left that nobody
    asked for, so that there are many v, it is bordered too."""
    below = np.zeros((border.shape[1], right.shape[1]))
    if sparse.issparse(matrix):
        border = sparse.csc_matrix(border)
        whole = sparse.bmat([[matrix, border], [border.T, None]], format="csc")
        return sparse_linalg.splu(whole, permc_spec="COLAMD").solve(np.vstack([right, below]))[: len(right)]
    # the border in units of the matrix: stiffnesses are 1e9 where masses are 1; of a single degree of freedom nothing
    # is left of the matrix
    border = border * ((np.max(np.abs(matrix)) or 1.0) / np.max(np.abs(border), axis=0))
    whole = np.block([[matrix, border], [border.T, np.zeros((border.shape[1],) * 2)]])
    factors, pivots, _ = linalg.lapack.dgetrf(whole)
    rcond, _ = linalg.lapack.dgecon(factors, np.abs(whole).sum(axis=0).max())
    if rcond < np.finfo(float).eps and border.shape[1] < len(right):
        mate = linalg.svd(whole)[2][-1, : len(right)]
        return _bordered(matrix, mass, np.column_stack([border, mass @ mate]), right)
    return linalg.lapack.dgetrs(factors, pivots, np.vstack([right, below]))[0][: len(right)]
