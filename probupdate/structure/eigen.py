"""Lowest modes of sparse K, M and their exact derivatives, also for close pairs."""

from __future__ import annotations

import numpy as np
from scipy import linalg, sparse
from scipy.sparse import linalg as sparse_linalg

from probupdate.errors import InputError

# relative residual |K phi - lambda M phi| / |K phi| above which an eigenpair is refused; Lanczos in double
# precision leaves 1e-10 on these matrices
RESIDUAL_LIMIT = 1e-6
# below so many degrees of freedom a dense solution is ten times faster than Lanczos' bookkeeping
DENSE_BELOW = 80


def lowest_modes(K: sparse.csc_array, M: sparse.csc_array, n_mode: int, where: str = "model"):
    """Eigenvalues lambda (n_mode,) ascending and shapes phi (n_dof, n_mode) of K phi = lambda M phi, phi^T M phi = 1.

    Shift-invert Lanczos at zero with one symmetric-ordering factorisation and a fixed start vector, or, for small
    matrices, a dense solution. Raises InputError where K is singular or indefinite.
    """
    n = K.shape[0]
    if n_mode >= n - 1:
        raise InputError(where, f"{n_mode} modes asked of {n} degrees of freedom", "ask for fewer")
    try:
        factor = sparse_linalg.splu(
            sparse.csc_matrix(K), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )
    except RuntimeError as error:
        raise InputError(
            where, f"the stiffness matrix is singular ({error}): a mechanism or a missing support",
            "check supports, bounds and zero stiffness factors",
        ) from None
    # with a symmetric permutation and no pivoting the signs of U's diagonal are the inertia of K
    if np.any(factor.U.diagonal() <= 0):
        raise InputError(
            where, "the stiffness matrix is not positive definite: a mechanism or a negative stiffness factor",
            "check supports and the parameters' bounds",
        )
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
    mu, phi = linalg.eigh(M.toarray(), K.toarray(), subset_by_index=(n - n_mode, n - 1))
    # rounding alone leaves some 1e-16 of the largest where there is no mass
    if mu[0] <= 1e-14 * mu[-1]:
        raise InputError(where, f"fewer than {n_mode} modes have a positive mass: the mass matrix is indefinite or has "
                         "too many massless degrees of freedom", "check M0 and every M_<name>")  # fmt: skip
    return 1 / mu, phi


def mode_derivatives(K, M, value, phi, dK_phi, dM_phi, clusters):
    """d lambda (n_mode, n_param) and d phi (n_dof, n_mode, n_param).

    dK_phi, dM_phi (n_dof, n_mode, n_param): (dK/d theta_k) phi_j and likewise for M. Each mode's shape derivative
    solves the bordered system (Nelson 1976, bordered by the whole cluster):
        [K - lambda_j M, M Phi_c; Phi_c^T M, 0] [v; mu] = [-(dK - lambda_j dM) phi_j; 0],
        d phi_j = v - 1/2 Phi_c Phi_c^T dM phi_j.
    For a cluster of one this is the plain derivative; for several the rotation inside the cluster is left out.
    """
    n, n_mode = phi.shape
    n_param = dK_phi.shape[2]
    cluster_of = {j: (j,) for j in range(n_mode)}
    for cluster in clusters:
        for j in cluster:
            cluster_of[j] = tuple(cluster)
    d_value = np.empty((n_mode, n_param))
    d_phi = np.empty((n, n_mode, n_param))
    for j in range(n_mode):
        members = list(cluster_of[j])
        basis = phi[:, members]
        weighted = sparse.csc_matrix(M @ basis)
        change = dK_phi[:, j] - value[j] * dM_phi[:, j]
        d_value[j] = phi[:, j] @ change
        bordered = sparse.bmat([[K - value[j] * M, weighted], [weighted.T, None]], format="csc")
        right = np.vstack([-change, np.zeros((len(members), n_param))])
        solution = sparse_linalg.splu(bordered, permc_spec="COLAMD").solve(right)[:n]
        d_phi[:, j] = solution - 0.5 * basis @ (basis.T @ dM_phi[:, j])
    return d_value, d_phi
