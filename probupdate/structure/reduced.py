"""A reduced basis for an affine model: many parameter vectors a second, with a bound that holds where it was built.

POD of full solutions in the K-energy norm, enriched greedily where an a-posteriori bound on the eigenvalues is worst,
then verified against the full model on points that took no part. Outside its box the full model answers instead,
row by row, and every such row is flagged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg import lapack
from scipy.sparse import linalg as sparse_linalg
from scipy.stats import qmc

from probupdate.errors import ConvergenceError, InputError
from probupdate.model import ManySolutions, ModalSolution, Wireframe
from probupdate.modes import frozen_array, plane_mac
from probupdate.progress import Progress, silent
from probupdate.structure.affine import AffineModel

# modes beyond those asked for that the basis carries too, so that a crossing at the upper end is not a surprise
BUFFER = 2
# eigenfrequencies closer than this share are judged as one plane
CLUSTER_GAP = 0.05


@dataclass(frozen=True, eq=False, kw_only=True)
class ReductionReport:
    """What was promised and what was found. Errors of frequencies are relative.

    bound: worst a-posteriori bound over the `n_candidate` points it was driven down on. max_frequency_error and
    min_mac: worst over `n_verify` points that were not used to build the basis.
    """

    size: int
    n_snapshot: int
    n_candidate: int
    bound: float
    n_verify: int
    max_frequency_error: float
    min_mac: float
    frequency_tolerance: float


@dataclass(frozen=True, eq=False, kw_only=True)
class ReducedModel:
    """Implements `model.Model` for the box [lower, upper]; `full` answers outside it."""

    full: AffineModel
    projected: AffineModel
    basis: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    n_mode: int
    stiffness: np.ndarray
    mass: np.ndarray
    at_channels: np.ndarray
    report: ReductionReport

    @property
    def name(self) -> str:
        return self.full.name

    @property
    def parameters(self):
        return self.full.parameters

    @property
    def channels(self) -> tuple[str, ...]:
        return self.full.channels

    @property
    def derived(self):
        return self.full.derived

    def covers(self, theta: np.ndarray) -> np.ndarray:
        """(...,) bool: inside the box the basis was built and verified for."""
        return np.all((theta >= self.lower) & (theta <= self.upper), axis=-1)

    def solve(
        self,
        theta: np.ndarray,
        n_mode: int,
        *,
        derivatives: bool = False,
        clusters: tuple[tuple[int, ...], ...] = (),
    ) -> ModalSolution:
        inside = n_mode <= self.n_mode and bool(self.covers(np.asarray(theta, float)))
        model = self.projected if inside else self.full
        return model.solve(theta, n_mode, derivatives=derivatives, clusters=clusters)

    def solve_many(self, theta: np.ndarray, n_mode: int) -> ManySolutions:
        theta = np.atleast_2d(np.asarray(theta, float))
        if n_mode > self.n_mode:
            raise InputError(self.name, f"{n_mode} modes asked of a basis for {self.n_mode}", "build it for more modes")
        inside = self.covers(theta)
        frequency = np.empty((len(theta), n_mode))
        shape = np.empty((len(theta), len(self.channels), n_mode))
        if inside.any():
            frequency[inside], shape[inside] = self._solve_inside(theta[inside], n_mode)
        for row in np.flatnonzero(~inside):
            solution = self.full.solve(theta[row], n_mode)
            frequency[row], shape[row] = solution.frequency_hz, solution.shape
        return ManySolutions(frequency_hz=frequency, shape=shape, fallback=~inside)

    def _solve_inside(self, theta, n_mode):
        size = self.basis.shape[1]
        cK, cM = self.full.coefficients(theta)
        K = (cK @ self.stiffness.reshape(len(self.stiffness), -1)).reshape(-1, size, size)
        M = (cM @ self.mass.reshape(len(self.mass), -1)).reshape(-1, size, size)
        value = np.empty((len(theta), n_mode))
        vector = np.empty((len(theta), size, n_mode))
        for i in range(len(theta)):
            # K and M are symmetric, so the transposed (Fortran-ordered) view is the matrix itself: no copy
            w, z, found, _, info = lapack.dsygvx(
                K[i].T, M[i].T, range="I", il=1, iu=n_mode, overwrite_a=1, overwrite_b=1
            )
            if info != 0 or found != n_mode:
                raise ConvergenceError(f"{self.name}: reduced eigenproblem failed (dsygvx info {info})", theta[i])
            value[i], vector[i] = w[:n_mode], z[:, :n_mode]
        return np.sqrt(value) / (2 * np.pi), self.at_channels @ vector

    def wireframe(self, theta: np.ndarray, n_mode: int = 0) -> Wireframe | None:
        return self.full.wireframe(theta, n_mode)

    def fingerprint(self) -> str:
        """That of the full model: the reduction is an approximation of the same answers, within its report."""
        return self.full.fingerprint()


def reduce_basis(
    model: AffineModel,
    *,
    n_mode: int,
    box: tuple[np.ndarray, np.ndarray],
    frequency_tolerance: float,
    points: np.ndarray | None = None,
    n_snapshot: int = 96,
    n_candidate: int = 96,
    n_verify: int = 48,
    max_size: int = 120,
    seed: int = 0,
    progress: Progress = silent,
) -> ReducedModel:
    """Build and verify a basis for the lowest `n_mode` modes over box = (lower, upper), each (n_param,).

    `points` (n, n_param) inside the box, such as draws of an approximate posterior, are where half of the
    snapshots, candidates and verification points are taken; the others fill the box evenly. Raises
    ConvergenceError, with the last basis as estimate, where the tolerance is not met with `max_size` vectors.
    """
    lower, upper = (np.asarray(b, float) for b in box)
    if lower.shape != (len(model.parameters),) or np.any(~np.isfinite(lower + upper)) or np.any(lower >= upper):
        raise InputError(f"{model.name}, reduced basis", "the box is empty or unbounded", "give finite lower < upper")
    draw = _PointSource(lower, upper, points, seed)
    n_kept = n_mode + BUFFER
    reference = 0.5 * (lower + upper) if points is None else np.median(points, axis=0)
    K_ref, _ = model.matrices(reference)
    snapshots = []
    theta = np.vstack([reference[None], draw(n_snapshot - 1)])
    for i, row in enumerate(theta):
        snapshots.append(model.solve_full(row, n_kept)[1])
        progress("reduced basis: snapshots", i + 1, len(theta))
    candidates = draw(n_candidate)
    factors = [sparse_linalg.splu(sparse.csc_matrix(model.matrices(row)[0])) for row in candidates]

    def worst_bounds(basis: np.ndarray) -> np.ndarray:
        return np.array([
            _ritz_bound(model, basis, row, factor, n_mode) for row, factor in zip(candidates, factors, strict=True)
        ])

    for _ in range(8):
        basis, bounds = _smallest_basis(snapshots, K_ref, worst_bounds, frequency_tolerance, max_size, progress)
        reduced = _project(model, basis, lower, upper, n_mode)
        fresh = draw(n_verify)
        error, mac, truth = _verify(reduced, fresh, n_mode, progress)
        report = ReductionReport(
            size=basis.shape[1], n_snapshot=len(snapshots), n_candidate=n_candidate, bound=float(bounds.max()),
            n_verify=n_verify, max_frequency_error=float(error.max()), min_mac=mac,
            frequency_tolerance=frequency_tolerance,
        )
        reduced = _project(model, basis, lower, upper, n_mode, report)
        if report.max_frequency_error <= frequency_tolerance and report.bound <= frequency_tolerance:
            return reduced
        # greedy: what was worst joins the snapshots; the next verification uses new points
        snapshots += [truth[row] for row in np.flatnonzero(error > frequency_tolerance)]
        for row in np.argsort(bounds)[::-1][:12]:
            if bounds[row] > frequency_tolerance:
                snapshots.append(model.solve_full(candidates[row], n_kept)[1])
    raise ConvergenceError(
        f"{model.name}: a basis of {basis.shape[1]} vectors leaves a relative frequency error of "
        f"{report.max_frequency_error:.1e} (bound {report.bound:.1e}) where {frequency_tolerance:.0e} is wanted; "
        "narrow the box or allow more vectors",
        reduced,
    )


class _PointSource:
    """Successive points: even numbers fill the box (scrambled Sobol), odd ones come from the given cloud."""

    def __init__(self, lower, upper, cloud, seed):
        self._sobol = qmc.Sobol(len(lower), seed=np.random.default_rng(seed))
        self._rng = np.random.default_rng([seed, 1])
        self._lower, self._upper, self._cloud = lower, upper, cloud

    def __call__(self, n: int) -> np.ndarray:
        # Sobol sequences want powers of two; the surplus is dropped
        unit = self._sobol.random(1 << max(0, int(n - 1).bit_length()))[:n]
        theta = self._lower + unit * (self._upper - self._lower)
        if self._cloud is not None:
            rows = np.arange(1, n, 2)
            theta[rows] = np.clip(
                self._cloud[self._rng.integers(len(self._cloud), size=len(rows))], self._lower, self._upper
            )
        return theta


def _smallest_basis(snapshots, K, worst_bounds, tolerance, max_size, progress):
    """The smallest POD basis (bisection over its size) whose bound holds at every candidate, or the largest."""
    full = _proper_orthogonal(np.hstack(snapshots), K, max_size)
    low, high = 0, full.shape[1]
    basis, bounds = full, worst_bounds(full)
    while bounds.max() <= tolerance and high - low > 2:
        middle = (low + high) // 2
        trial = worst_bounds(full[:, :middle]) if middle > 8 else np.array([np.inf])
        progress("reduced basis: size", full.shape[1] - (high - low), full.shape[1])
        if trial.max() <= tolerance:
            high, basis, bounds = middle, full[:, :middle], trial
        else:
            low = middle
    return basis, bounds


def _proper_orthogonal(snapshots, K, max_size):
    """POD basis (n_dof, r), K-orthonormal, the most energetic vector first."""
    snapshots = snapshots / np.sqrt(np.einsum("ij,ij->j", snapshots, K @ snapshots))
    # the squared singular values of K^(1/2) S are the eigenvalues of S^T K S
    energy, vector = np.linalg.eigh(snapshots.T @ (K @ snapshots))
    energy, vector = energy[::-1], vector[:, ::-1]
    size = min(max_size, int(np.sum(energy > 1e-13 * energy[0])))
    return _orthonormal(snapshots @ (vector[:, :size] / np.sqrt(energy[:size])), K)


def _orthonormal(basis, K):
    """K-orthonormal basis of the same space; twice, as once leaves rounding of the order of the condition."""
    for _ in range(2):
        factor = np.linalg.cholesky(basis.T @ (K @ basis))
        basis = np.linalg.solve(factor, basis.T).T
    return basis


def _project(model, basis, lower, upper, n_mode, report=None) -> ReducedModel:
    stiffness = np.array([basis.T @ (Kt @ basis) for Kt in model.stiffness])
    mass = np.array([basis.T @ (Mt @ basis) for Mt in model.mass])
    stiffness, mass = (0.5 * (a + a.transpose(0, 2, 1)) for a in (stiffness, mass))
    at_channels = model.channel_matrix @ basis
    projected = AffineModel(
        name=f"{model.name} (reduced)",
        parameters=model.parameters,
        channels=model.channels,
        stiffness=tuple(sparse.csc_array(a) for a in stiffness),
        mass=tuple(sparse.csc_array(a) for a in mass),
        coefficients=model.coefficients,
        channel_matrix=sparse.csr_array(at_channels),
        hash_key=model.hash_key,
        derived=model.derived,
    )
    return ReducedModel(
        full=model, projected=projected, basis=frozen_array(basis), lower=frozen_array(lower),
        upper=frozen_array(upper), n_mode=n_mode, stiffness=frozen_array(stiffness), mass=frozen_array(mass),
        at_channels=frozen_array(at_channels), report=report,
    )  # fmt: skip


def _ritz(model, basis, theta, n_mode):
    """Ritz values and vectors (n_dof, n_mode) at theta, with the full K and M."""
    K, M = model.matrices(theta)
    a, b = basis.T @ (K @ basis), basis.T @ (M @ basis)
    value, y, *_ = lapack.dsygvx(0.5 * (a + a.T), 0.5 * (b + b.T), range="I", il=1, iu=n_mode)
    return K, M, value[:n_mode], basis @ y[:, :n_mode]


def eigenvalue_bound(K, M, factor, value, phi, n_mode) -> np.ndarray:
    """Bound on the relative frequency error of the first n_mode Ritz pairs.

    With mu = 1 / lambda the residual of K^(-1/2) M K^(-1/2) has the norm eps mu, eps^2 = r^T K^-1 r / lambda,
    r = K phi - lambda M phi; the error of mu is at most eps^2 / gamma, gamma the relative gap to the nearest
    eigenvalue of another cluster (Kato-Temple; Parlett 1998, ch. 10), and f moves half as much as lambda.
    """
    residual = K @ phi - (M @ phi) * value
    eps = np.sqrt(np.maximum(np.einsum("ij,ij->j", residual, factor.solve(residual)), 0) / value)
    bound = np.empty(n_mode)
    for j in range(n_mode):
        relative_gap = np.abs(value[j] / value - 1)
        others = relative_gap[relative_gap > 2 * CLUSTER_GAP]
        gamma = others.min() if others.size else 2 * CLUSTER_GAP
        bound[j] = 0.5 * eps[j] ** 2 / gamma
    return bound


def _ritz_bound(model, basis, theta, factor, n_mode) -> float:
    K, M, value, phi = _ritz(model, basis, theta, n_mode + BUFFER)
    return float(eigenvalue_bound(K, M, factor, value, phi, n_mode).max())


def clusters_of(frequency_hz: Sequence[float], gap: float = CLUSTER_GAP) -> list[list[int]]:
    """Runs of modes whose neighbours are closer than `gap` of the frequency."""
    groups = [[0]]
    for j in range(1, len(frequency_hz)):
        if frequency_hz[j] - frequency_hz[j - 1] < gap * frequency_hz[j]:
            groups[-1].append(j)
        else:
            groups.append([j])
    return groups


def _verify(reduced: ReducedModel, theta, n_mode, progress):
    """Relative frequency error per point, the worst (plane) MAC at the channels, and the full modes (n_dof, .)."""
    fast_frequency, fast_shape = reduced._solve_inside(theta, n_mode)
    error, worst, full = np.empty(len(theta)), 1.0, []
    for i, row in enumerate(theta):
        value, phi = reduced.full.solve_full(row, n_mode + 1)
        frequency = np.sqrt(value) / (2 * np.pi)
        full.append(phi[:, :n_mode])
        error[i] = np.max(np.abs(fast_frequency[i] / frequency[:n_mode] - 1))
        shape = reduced.full.channel_matrix @ phi
        for group in clusters_of(frequency):
            # a cluster cut off at the upper end has no plane of its own to compare
            if group[-1] < n_mode:
                worst = min(worst, plane_mac(fast_shape[i][:, group], shape[:, group]))
        progress("reduced basis: verification", i + 1, len(theta))
    return error, worst, full
