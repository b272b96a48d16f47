"""Lowest modes of sparse K, M and their exact derivatives, also for close pairs."""

from __future__ import annotations

import numpy as np
from scipy import linalg, sparse
from scipy.sparse import linalg as sparse_linalg

from probupdate.errors import InputError

# |lambda K^-1 M phi - phi| in the norm of M, free of units and of the mesh: above the first, modes are solved again
# with residuals in extended precision; above the second, refused. It bounds an eigenvalue's relative error, which is of
# its square once the modes are solved again
ACCURATE, REFUSED_ERROR = 1e-9, 1e-6
REPEATS = 4
# an eigenvalue below so many roundings of the entries it sums up is none but rounding: a free motion
ROUNDINGS = 30.0
# below so many degrees of freedom, or of a model on a basis, whose matrices are full, a dense solution is ten times
# faster than Lanczos' bookkeeping
DENSE_BELOW = 80
FULL_BELOW, FULL_SHARE = 500, 0.25
# SuperLU's symmetric mode: an ordering that suits a frame (four times fewer entries than its default), and no pivoting
# for positive definite matrices, hardly any for others
SYMMETRIC = {"permc_spec": "MMD_AT_PLUS_A", "options": {"SymmetricMode": True}}
# of a shape derivative's equation, relative: where corrections stop, and above which a pivoted factorisation is taken
REFINED_RESIDUAL, REFUSED_RESIDUAL = 1e-11, 1e-9
CORRECTIONS = 20
# of solutions corrected in extended precision, each by the same factor: after a correction so small the next one is of
# its square
CORRECTED = 1e-7
# share of the stiffest degree of freedom's K_ii / M_ii that holds free motions at first, and of the shift below which
# what is left is zero
SOFT, FREE = 1e-10, 1e-8
# share of the largest 1 / lambda, or of the largest eigenvalue of M, below which there is no mass: rounding alone
# leaves some 1e-16
MASSLESS = 1e-14
# eigenvalues nearer to each other (relative) are equal but for rounding
EQUAL = 1e-9
SUPPORTS = ("check supports, bounds and zero stiffness factors; of what was tested hanging free, model the soft "
            "springs too")


def lowest_modes(
    K: sparse.csc_array, M: sparse.csc_array, n_mode: int, where: str = "model", *, refused: float = REFUSED_ERROR,
    shift: float = 0.0
):
    """Eigenvalues lambda (n_mode,) ascending and shapes phi (n_dof, n_mode) of K phi = lambda M phi, phi^T M phi = 1;
    with a `shift` of K + shift M, to the digits that K and M have of their own.

    Shift-invert Lanczos at zero with one symmetric-ordering factorisation and a fixed start vector, or, for small
    matrices, a dense solution; solved again by subspace iteration where that is not accurate. Raises InputError where
    K is singular or indefinite, or a mode's error |lambda K^-1 M phi - phi| stays above `refused`, in the norm of M.
    """
    n, dense = K.shape[0], _solved_dense(K)
    # Lanczos leaves two modes out, a dense solution none
    if n_mode > (n if dense else n - 2):
        raise InputError(where, f"{n_mode} modes asked of {n} degrees of freedom", "ask for fewer")
    if dense:
        # of twenty degrees of freedom the bookkeeping of sparse arrays takes ten times as long as the solution
        K, M = _array(K), _array(M)
    # powers of four: exact, and no product overflows in whatever units the matrices are
    scales = _power_of_four(K, where, "stiffness"), _power_of_four(M, where, "mass")
    K, M = K / scales[0], M / scales[1]
    extended = K
    if shift:
        shift = shift * (scales[1] / scales[0])
        # entries of the sum are rounded, as the digits of K are not
        extended, K = K.astype(np.longdouble) + shift * M.astype(np.longdouble), K + shift * M
    if dense:
        value, phi = _dense(K, M, n_mode, where)
        solve = _cholesky(K)
    else:
        factor = _definite_factor(K, where)
        value, phi = _lanczos(K, M, n_mode, factor, where)
        solve = factor.solve
    value, phi = _normalise(value, phi, M)
    _refuse_rounding(K, value, phi, where)
    value, phi = _refine_modes(extended, M, value, phi, solve, where, refused)
    largest = np.argmax(np.abs(phi), axis=0)
    with np.errstate(over="ignore"):
        value, phi = value * (scales[0] / scales[1]), phi * np.sign(phi[largest, np.arange(n_mode)]) / scales[1] ** 0.5
    if not (np.all(np.isfinite(value)) and np.all(value > 0)):
        raise InputError(where, "its eigenvalues exceed the range of double precision", "check the units of K and M")
    return value, phi


def modes_with_free_motions(K: sparse.csc_array, M: sparse.csc_array, n_mode: int, where: str = "model"):
    """As `lowest_modes` for a structure that may float: eigenvalues (n_mode,), exactly zero for the motions that
    nothing holds, shapes (n_dof, n_mode), and how many are free. Raises InputError where a stiffness is negative.

    The modes of K + s M less s. s is first a small share of the stiffest degree of freedom's K_ii / M_ii (no more than
    the highest eigenvalue, in any units), then the lowest eigenvalue above zero, beside which all of them keep their
    digits.
    """
    stiffness, mass = K.diagonal(), M.diagonal()
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        stiffest = np.max(np.where(mass > 0, stiffness / mass, 0.0), initial=0.0)
    if not 0 < stiffest < np.inf:
        raise InputError(where, "no motion has both stiffness and mass", "check K and M")
    shift, size = SOFT * stiffest, abs(K)
    # the first modes only say where the lowest eigenvalue above zero is
    for refused in (np.inf, REFUSED_ERROR):
        value, phi = lowest_modes(K, M, n_mode, where, refused=refused, shift=shift)
        rounding = np.maximum(_rounding_error(size, phi), FREE * shift)
        value = value - shift
        if value[0] < -rounding[0]:
            raise InputError(where, "the stiffness matrix is not positive definite and no motion is free",
                             "look for a negative stiffness")
        held = value > rounding
        if not held.any():
            break
        shift = value[held][0]
    return np.where(held, value, 0.0), phi, int(np.sum(~held))


def _power_of_four(matrix, where: str, kind: str) -> float:
    """The power of four nearest to the largest entry."""
    largest = np.max(np.abs(matrix.data if sparse.issparse(matrix) else matrix), initial=0.0)
    if not 0 < largest < np.inf:
        raise InputError(where, f"the {kind} matrix is {'singular: zero' if largest == 0 else 'not finite'}",
                         "check the parameters' bounds and the units")
    return float(4.0 ** np.clip(np.round(np.log2(largest) / 2), -500, 500))


def _refine_modes(K, M, value, phi, solve, where: str, refused: float):
    """The modes (ascending, of unit modal mass) to what double precision holds.

    A solution of K x = b by its factors is wrong by the condition of K, which grows with the fourth power of a mesh's
    fineness. Corrected with residuals in extended precision it is not, and neither is a Rayleigh-Ritz step on solutions
    y of K y = M phi, which needs no product with K: y^T K y = y^T M phi.
    """
    for _ in range(REPEATS):
        force = value * (M @ phi)
        y, K = _solve_refined(K, force, solve)
        error = _change(M, phi, y)
        if np.all(error < ACCURATE):
            return value, phi
        try:
            mu, turn = linalg.eigh(y.T @ (M @ y), _symmetrise(y.T @ force))
        except linalg.LinAlgError:
            break
        if not mu[0] > 0:
            break
        value, phi = _normalise(1 / mu, y @ turn, M)
        if np.all(error < refused):
            return value, phi
    worst = int(np.argmax(error))
    raise InputError(where, f"mode {worst + 1} has a relative rounding error of {error[worst]:.1e} with these matrices",
                     "check them for entries of unlike size: very stiff beside very soft parts, or a mesh far too fine")


def _change(M, phi, y) -> np.ndarray:
    """(n_mode,) norm of y - phi, but for what it has of lower modes: these are orthogonal to phi by construction, and
    K^-1 makes more of their rounding by the ratio of eigenvalues."""
    shared = phi.T @ (M @ y)
    beyond = _norm(M, y - phi @ shared)
    return np.sqrt(beyond**2 + np.sum(np.tril(shared - np.eye(phi.shape[1])) ** 2, axis=0))


def _solve_refined(K, force, solve):
    """x (n, k) of K x = force, corrected until nothing is left to correct, and K in extended precision."""
    x = solve(force)
    extended = K.astype(np.longdouble, copy=False)
    before = np.inf
    for _ in range(CORRECTIONS):
        step = solve(np.asarray(force - extended @ x.astype(np.longdouble), float))
        change = float(np.max(np.linalg.norm(step, axis=0) / np.linalg.norm(x, axis=0)))
        # rounding ends it, or a matrix too near to a singular one
        if not change < 0.5 * before:
            break
        x, before = x + step, change
        if change < CORRECTED:
            break
    return x, extended


def _normalise(value, phi, M):
    order = np.argsort(value)
    phi = phi[:, order]
    return value[order], phi / _norm(M, phi)


def _norm(M, phi) -> np.ndarray:
    """(n_mode,); what is semi-definite may be below zero by rounding."""
    return np.sqrt(np.maximum(np.einsum("ij,ij->j", phi, M @ phi), 0.0))


def _symmetrise(matrix: np.ndarray) -> np.ndarray:
    return 0.5 * (matrix + matrix.T)


def _rounding_error(size, phi) -> np.ndarray:
    """(n_mode,) what roundings of K, of entries `size`, may make of phi^T K phi = 0, of unit modal mass."""
    squares = phi**2
    total = np.einsum("ij,ij->j", squares, size.power(2) @ squares if sparse.issparse(size) else size**2 @ squares)
    return ROUNDINGS * np.finfo(float).eps * np.sqrt(total)


def _refuse_rounding(K, value, phi, where: str) -> None:
    free = int(np.sum(value <= _rounding_error(abs(K), phi)))
    if free:
        raise InputError(where, f"the stiffness matrix is singular to rounding: {free} of the lowest motions "
                         f"{'is' if free == 1 else 'are'} unrestrained, a mechanism or a missing support",
                         SUPPORTS)


def available_modes(K, M) -> int:
    """How many modes `lowest_modes` gives: of small models one for each degree of freedom that has mass."""
    n = K.shape[0]
    if not _solved_dense(K):
        return n - 2
    # the rank of M, whose rows are brought to one size first: rotations have other units
    mass = _array(M)
    size = np.sqrt(np.maximum(np.diag(mass), 0.0))
    size[size > 0] = 1 / size[size > 0]
    share = linalg.eigvalsh(mass * np.outer(size, size))
    return int(np.sum(share > MASSLESS * share[-1])) if share[-1] > 0 else n


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
            SUPPORTS,
        ) from None
    # with a symmetric permutation and no pivoting the signs of U's diagonal are the inertia of K
    if np.any(factor.U.diagonal() <= 0):
        raise _indefinite_error(where)
    return factor


def _indefinite_error(where: str) -> InputError:
    return InputError(
        where, "the stiffness matrix is not positive definite: a mechanism or a negative stiffness factor",
        "check supports and the parameters' bounds",
    )


def _cholesky(K):
    factor, _ = linalg.cho_factor(K)
    # without the checks of cho_solve, which take longer than a small solution
    return lambda force: linalg.lapack.dpotrs(factor, force)[0]


def _lanczos(K, M, n_mode: int, factor, where: str):
    n = K.shape[0]
    inverse = sparse_linalg.LinearOperator((n, n), factor.solve, dtype=float)
    start = np.cos(np.arange(n))
    try:
        return sparse_linalg.eigsh(
            sparse.csc_matrix(K), k=n_mode, M=sparse.csc_matrix(M), sigma=0.0, OPinv=inverse, v0=start, tol=1e-12,
            ncv=min(n, max(2 * n_mode + 8, 24)),
        )
    except sparse_linalg.ArpackError as error:
        raise InputError(where, f"its modes do not converge ({error})", "check that M is positive semi-definite and "
                         "both matrices are in one set of units") from None


def _dense(K, M, n_mode: int, where: str):
    """M phi = mu K phi with mu = 1 / lambda: K is positive definite, M need not be (massless degrees of freedom)."""
    n = K.shape[0]
    try:
        mu, phi = linalg.eigh(M, K, subset_by_index=(n - n_mode, n - 1))
    except linalg.LinAlgError:
        raise _indefinite_error(where) from None
    if mu[0] <= MASSLESS * mu[-1]:
        raise InputError(where, f"fewer than {n_mode} modes have a positive mass: the mass matrix is indefinite or has "
                         "too many massless degrees of freedom", "check M0 and every M_<name>")
    return 1 / mu, phi


def mode_derivatives(K, M, value, phi, dK_phi, dM_phi, clusters):
    """d lambda (n_mode, n_param) and d phi (n_dof, n_mode, n_param) of the lowest n_mode modes of `value` and `phi`,
    which may hold more: those that clusters name.

    dK_phi, dM_phi (n_dof, n_mode, n_param): (dK/d theta_k) phi_j and likewise for M. Each mode's shape derivative is
        d phi_j = v - 1/2 Phi_c Phi_c^T dM phi_j,  (K - lambda_j M) v = -(dK - lambda_j dM) phi_j,  Phi_c^T M v = 0,
    the equation for v within the range of its matrix (Nelson 1976, bordered by the whole cluster). For a cluster of one
    this is the plain derivative; for several, and for modes equal to rounding, the rotation among them is left out.
    """
    n, n_mode = dK_phi.shape[:2]
    cluster_of: dict[int, tuple[int, ...]] = {j: (j,) for j in range(n_mode)}
    for cluster in clusters:
        for j in cluster:
            cluster_of[j] = tuple(cluster)
    for j in range(n_mode):
        own = cluster_of[j]
        # of equal modes any combination is one: how they turn into each other has no derivative
        equal = np.flatnonzero(np.abs(value - value[j]) <= EQUAL * np.abs(value[j]))
        cluster_of[j] = tuple(sorted({*own, *equal.tolist()}))
    d_value = np.empty((n_mode, dK_phi.shape[2]))
    d_phi = np.empty((n, n_mode, dK_phi.shape[2]))
    full = _solved_dense(K)
    if full:
        K, M = _array(K), _array(M)
    for j in range(n_mode):
        basis = phi[:, list(cluster_of[j])]
        change = dK_phi[:, j] - value[j] * dM_phi[:, j]
        d_value[j] = phi[:, j] @ change
        right = basis @ (basis.T @ change)
        right = M @ right - change
        solution = None if full else _solve_deflated(K, M, value[j], basis, right)
        if solution is None:
            solution = _solve_bordered(K - value[j] * M, M, M @ basis, right)
        d_phi[:, j] = solution - 0.5 * basis @ (basis.T @ dM_phi[:, j])
    return d_value, d_phi


def cluster_coupling(value, phi, dK_phi, dM_phi, d_value, clusters):
    """(n_mode, n_mode, n_param): phi_i^T (dK - lambda dM) phi_j between the modes of a cluster, lambda the mean of the
    two, on the diagonal d lambda (n_mode, n_param); zero between others."""
    n_mode = len(value)
    result = np.zeros((n_mode, n_mode, d_value.shape[1]))
    result[np.arange(n_mode), np.arange(n_mode)] = d_value
    for cluster in clusters:
        for j in cluster:
            for i in set(cluster) - {j}:
                result[i, j] = phi[:, i] @ (dK_phi[:, j] - 0.5 * (value[i] + value[j]) * dM_phi[:, j])
    return result


def _solve_deflated(K, M, value: float, basis, right):
    """v (n, n_param) of (K - value M) v = right, basis^T M v = 0, or None where it is not found to REFUSED.

    The matrix is factorised as it is, singular to rounding: what that makes too large lies along the cluster, as in
    inverse iteration, and is taken out. Five times faster than factorising the bordered matrix, whose border fills in.
    """
    matrix = sparse.csc_matrix(K - value * M)
    try:
        factor = sparse_linalg.splu(matrix, diag_pivot_thresh=0.01, **SYMMETRIC)
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
        if error < REFINED_RESIDUAL:
            break
    return solution if error < REFUSED_RESIDUAL else None


def _solve_bordered(matrix, mass, border, right):
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
        return _solve_bordered(matrix, mass, np.column_stack([border, mass @ mate]), right)
    return linalg.lapack.dgetrs(factors, pivots, np.vstack([right, below]))[0][: len(right)]
