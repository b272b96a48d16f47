"""A reduced basis for an affine model: many parameter vectors a second where it was built and verified.

Proper orthogonal decomposition of full solutions in the K-energy norm; the smallest basis that answers points it has
not seen within the tolerance, verified on yet other points. A plane of symmetry splits it into blocks that do not
couple, which halves the size of what has to be solved. Outside its box the full model answers instead, row by
row, and every such row is flagged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, sparse
from scipy.linalg import lapack
from scipy.sparse import csgraph
from scipy.stats import qmc

from probupdate.errors import ConvergenceError, InputError
from probupdate.model import ManySolutions, ModalSolution, Wireframe
from probupdate.modes import frozen_array, plane_mac
from probupdate.progress import Progress, silent
from probupdate.structure.affine import AffineModel

# a point that only fills the box, where a cloud of likely points is given, may be off by this much more
BOX_ALLOWANCE = 10.0
# (plane) MAC between reduced and full shapes at the channels, at every verification point
LEAST_MAC = 0.9999
# modes that move the channels less than this share of what the mode they see best does (local modes of braces) have
# no shape there that a MAC could judge; their frequencies are held to the tolerance like all others
SEEN = 0.05
# eigenfrequencies closer than this share are judged as one plane
CLUSTER_GAP = 0.05
# a basis that leaves this share of the tolerance unused is small enough; the rest is for points not seen
MARGIN = 0.5
# modes closer than this share of their frequency may have been turned into each other by the eigensolver
MIXED_GAP = 2e-3
# snapshots, scaled to unit energy, that have less than this in common belong to different families of symmetry
COUPLING = 1e-7
# what families of basis vectors share by rounding, as a share of a term's largest entry; frequencies feel its square
ROUNDING = 1e-5
CHUNK = 64
MAX_ROUNDS = 8


@dataclass(frozen=True, eq=False, kw_only=True)
class ReductionReport:
    """What was promised and what was found on `n_verify` points that took no part in building the basis.

    Errors of frequencies are relative. max_frequency_error and min_mac (of planes for close modes) are the worst over
    the points taken from the cloud, or from the whole box where no cloud was given; max_box_error that over all.
    """

    size: int
    n_snapshot: int
    n_verify: int
    max_frequency_error: float
    max_box_error: float
    min_mac: float
    frequency_tolerance: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Block:
    """Vectors of the basis that no other vector couples with: their numbers `rows` (k,), ascending, and the model's
    projections stiffness, mass (n_term, k, k) and at_channels (n_channel, k).

    `n_mode`: how many modes are computed at first, one more than it had among the lowest at any check.
    """

    rows: np.ndarray
    n_mode: int
    stiffness: np.ndarray
    mass: np.ndarray
    at_channels: np.ndarray

    def leading(self, size: int) -> Block:
        """Without the vectors from number `size` on."""
        k = int(np.sum(self.rows < size))
        return replace(self, rows=self.rows[:k], stiffness=self.stiffness[:, :k, :k], mass=self.mass[:, :k, :k],
                       at_channels=self.at_channels[:, :k])  # fmt: skip


@dataclass(frozen=True, eq=False, kw_only=True)
class ReducedModel:
    """Implements `model.Model` for the box [lower, upper]; `full` answers outside it.

    `basis` (n_dof, r), K-orthonormal at a middle point, the most energetic vector first; `projected` is the model on
    it, for derivatives, and `blocks` the same for many quick solutions.
    """

    full: AffineModel
    projected: AffineModel
    basis: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    n_mode: int
    blocks: tuple[Block, ...]
    frequency_tolerance: float
    report: ReductionReport | None = None

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
        """frequency_hz (n, n_mode) and shape (n, n_channel, n_mode) from the basis."""
        frequency, shape = np.empty((len(theta), n_mode)), np.empty((len(theta), len(self.channels), n_mode))
        for start in range(0, len(theta), CHUNK):
            rows = np.arange(start, min(start + CHUNK, len(theta)))
            first = [min(block.n_mode, n_mode) for block in self.blocks]
            value, shape[rows], exhausted = self._solve_chunk(theta[rows], n_mode, first)
            if exhausted.any():
                again = rows[exhausted]
                value[exhausted], shape[again], _ = self._solve_chunk(theta[again], n_mode, [n_mode] * len(first))
            frequency[rows] = np.sqrt(value) / (2 * np.pi)
        return frequency, shape

    def _solve_chunk(self, theta, n_mode, numbers):
        """lambda (n, n_mode), shapes (n, n_channel, n_mode) from `numbers` of modes of each block, and where all that
        were computed of a block are among the lowest (n,), so that more of it may be."""
        cK, cM = self.full.coefficients(theta)
        solved = [_solve_block(block, cK, cM, n) for block, n in zip(self.blocks, numbers, strict=True)]
        value, seen = (np.concatenate(part, axis=-1) for part in zip(*solved, strict=True))
        order = np.argsort(value, axis=1)[:, :n_mode]
        value, seen = np.take_along_axis(value, order, 1), np.take_along_axis(seen, order[:, None, :], 2)
        exhausted = np.zeros(len(theta), bool)
        for block, n, (own, _) in zip(self.blocks, numbers, solved, strict=True):
            if n < min(n_mode, len(block.rows)):
                exhausted |= own[:, -1] <= value[:, -1]
        return value, seen, exhausted

    def _with_shares(self, theta) -> ReducedModel:
        """With every block's n_mode from these points."""
        blocks = []
        cK, cM = self.full.coefficients(theta)
        solved = [_solve_block(block, cK, cM, self.n_mode)[0] for block in self.blocks]
        last = np.sort(np.concatenate(solved, axis=1), axis=1)[:, self.n_mode - 1]
        for block, value in zip(self.blocks, solved, strict=True):
            most = int(np.sum(value <= last[:, None], axis=1).max())
            blocks.append(replace(block, n_mode=min(most + 1, self.n_mode)))
        return replace(self, blocks=tuple(blocks))

    def wireframe(self, theta: np.ndarray, n_mode: int = 0) -> Wireframe | None:
        return self.full.wireframe(theta, n_mode)

    def fingerprint(self) -> str:
        """That of the full model: the reduction is an approximation of the same answers, within its report."""
        return self.full.fingerprint()


def _solve_block(block: Block, cK, cM, n_mode):
    """lambda (n, k) and shapes at the channels (n, n_channel, k) of a block, k = n_mode or its size if that is less."""
    size = len(block.rows)
    n_mode = min(n_mode, size)
    K, M = np.tensordot(cK, block.stiffness, 1), np.tensordot(cM, block.mass, 1)
    value, vector = np.empty((len(K), n_mode)), np.empty((len(K), size, n_mode))
    for row in range(len(K)):
        # a symmetric C-ordered matrix is its own Fortran-ordered transpose: no copy
        w, z, found, _, info = lapack.dsygvx(K[row].T, M[row].T, range="I", il=1, iu=n_mode, overwrite_a=1,
                                             overwrite_b=1)  # fmt: skip
        if info != 0 or found != n_mode:
            raise ConvergenceError(f"reduced eigenproblem failed (dsygvx info {info})", (cK[row], cM[row]))
        value[row], vector[row] = w[:n_mode], z[:, :n_mode]
    return value, block.at_channels @ vector


def reduce_basis(
    model: AffineModel,
    *,
    n_mode: int,
    box: tuple[np.ndarray, np.ndarray],
    frequency_tolerance: float,
    points: np.ndarray | None = None,
    n_snapshot: int = 96,
    n_verify: int = 96,
    max_size: int = 240,
    seed: int = 0,
    progress: Progress = silent,
) -> ReducedModel:
    """Build and verify a basis for the lowest `n_mode` modes over box = (lower, upper), each (n_param,).

    `points` (n, n_param), such as draws of an approximate posterior, are where the tolerance on the relative frequency
    error holds and half of all snapshots and checks are taken; the other half fills the box evenly, with
    BOX_ALLOWANCE times the tolerance. Without points the tolerance holds all over the box. Raises ConvergenceError,
    with the last basis as estimate, where it is not met with `max_size` vectors.
    """
    lower, upper = (np.asarray(b, float) for b in box)
    if lower.shape != (len(model.parameters),) or np.any(~np.isfinite(lower + upper)) or np.any(lower >= upper):
        raise InputError(f"{model.name}, reduced basis", "the box is empty or unbounded", "give finite lower < upper")
    draw = _PointSource(lower, upper, points, seed, frequency_tolerance)
    K, _ = model.matrices(0.5 * (lower + upper) if points is None else np.median(points, axis=0))
    theta, _ = draw(n_snapshot)
    # every other point of the box moves to one of its faces, where soil factors make the largest changes
    faces = np.arange(0, n_snapshot, 4)
    column = (faces // 4) % len(lower)
    theta[faces, column] = np.where((faces // 4) // len(lower) % 2 == 0, lower[column], upper[column])
    snapshots = _solve_full(model, theta, n_mode, "snapshots", progress)
    for _ in range(MAX_ROUNDS):
        basis, family = _proper_orthogonal(_unmixed(snapshots, K), K, max_size)
        largest = _project(model, basis, family, (lower, upper), n_mode, frequency_tolerance)
        checks = _Checks.solve(model, *draw(n_verify), n_mode, "size", progress)
        reduced = _smallest(largest, checks)
        if reduced is not None:
            final = _Checks.solve(model, *draw(n_verify), n_mode, "verification", progress)
            size = reduced.basis.shape[1]
            reduced = _project(model, basis[:, :size], family[:size], (lower, upper), n_mode, frequency_tolerance)
            reduced = reduced._with_shares(checks.theta)
            error, least_mac = final.judge(reduced)
            report = ReductionReport(
                size=size, n_snapshot=len(snapshots), n_verify=n_verify,
                max_frequency_error=float(error[final.tolerance == frequency_tolerance].max()),
                max_box_error=float(error.max()), min_mac=least_mac, frequency_tolerance=frequency_tolerance,
            )  # fmt: skip
            reduced = replace(reduced, report=report)
            if np.all(error <= final.tolerance) and least_mac >= LEAST_MAC:
                return reduced
            snapshots += final.worst(error)
        # what was worst joins the snapshots; the next round checks on new points
        snapshots += checks.worst(checks.judge(reduced or largest)[0])
    error, least_mac = checks.judge(largest)
    raise ConvergenceError(
        f"{model.name}: a basis of {largest.basis.shape[1]} vectors leaves a relative frequency error of "
        f"{error.max():.1e} and a MAC of {least_mac:.5f} where {frequency_tolerance:.0e} is wanted; narrow the box or "
        "allow more vectors",
        largest,
    )


class _PointSource:
    """Successive points (n, n_param) and the tolerance at each (n,): even rows fill the box (scrambled Sobol), odd
    ones come from the cloud."""

    def __init__(self, lower, upper, cloud, seed, tolerance):
        self._sobol = qmc.Sobol(len(lower), seed=np.random.default_rng(seed))
        self._rng = np.random.default_rng([seed, 1])
        self._lower, self._upper, self._cloud, self._tolerance = lower, upper, cloud, tolerance

    def __call__(self, n: int) -> tuple[np.ndarray, np.ndarray]:
        # Sobol sequences want powers of two; the surplus is dropped
        unit = self._sobol.random(1 << max(0, int(n - 1).bit_length()))[:n]
        theta = self._lower + unit * (self._upper - self._lower)
        if self._cloud is None:
            return theta, np.full(n, self._tolerance)
        rows = np.arange(1, n, 2)
        likely = self._cloud[self._rng.integers(len(self._cloud), size=len(rows))]
        theta[rows] = np.clip(likely, self._lower, self._upper)
        tolerance = np.full(n, BOX_ALLOWANCE * self._tolerance)
        tolerance[rows] = self._tolerance
        return theta, tolerance


def _solve_full(model, theta, n_mode, what, progress):
    """(lambda, phi) of one mode more than asked for: it shows whether the last ones are a pair cut in two."""
    solved = []
    for row in theta:
        solved.append(model.solve_full(row, n_mode + 1))
        progress(f"reduced basis: {what}", len(solved), len(theta))
    return solved


@dataclass(frozen=True, eq=False, kw_only=True)
class _Checks:
    """Points with the full model's answers there and the tolerance at each."""

    model: AffineModel
    theta: np.ndarray
    tolerance: np.ndarray
    frequency_hz: np.ndarray
    solved: list[tuple[np.ndarray, np.ndarray]]

    @classmethod
    def solve(cls, model, theta, tolerance, n_mode, what, progress):
        solved = _solve_full(model, theta, n_mode, what, progress)
        frequency = np.sqrt([value for value, _ in solved]) / (2 * np.pi)
        return cls(model=model, theta=theta, tolerance=tolerance, frequency_hz=frequency, solved=solved)

    def judge(self, reduced: ReducedModel) -> tuple[np.ndarray, float]:
        """Largest relative frequency error per point (n,), least (plane) MAC of all."""
        n_mode, worst = reduced.n_mode, 1.0
        fast, fast_shape = reduced._solve_inside(self.theta, n_mode)
        for row, (_, phi) in enumerate(self.solved):
            shape = self.model.channel_matrix @ phi
            motion = np.linalg.norm(shape, axis=0)
            for group in clusters_of(self.frequency_hz[row]):
                # a cluster cut off at the upper end has no plane of its own to compare
                if group[-1] < n_mode and np.all(motion[group] > SEEN * motion.max()):
                    worst = min(worst, plane_mac(fast_shape[row][:, group], shape[:, group]))
        return np.abs(fast / self.frequency_hz[:, :n_mode] - 1).max(axis=1), worst

    def worst(self, error: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Solutions at the points that fail, or come close to it."""
        return [self.solved[row] for row in np.flatnonzero(error > MARGIN * self.tolerance)]


def _smallest(largest: ReducedModel, checks: _Checks) -> ReducedModel | None:
    """The smallest leading part of the basis within MARGIN of the tolerance at every check, by bisection."""
    def fits(size):
        part = _leading(largest, size)
        error, least_mac = checks.judge(part)
        return part if np.all(error <= MARGIN * checks.tolerance) and least_mac >= LEAST_MAC else None

    low, high = largest.n_mode, largest.basis.shape[1]
    best = fits(high)
    while best is not None and high - low > 4:
        middle = (low + high) // 2
        part = fits(middle)
        low, high, best = (middle, high, best) if part is None else (low, middle, part)
    return best


def _leading(reduced: ReducedModel, size: int) -> ReducedModel:
    blocks = tuple(block.leading(size) for block in reduced.blocks if block.rows[0] < size)
    return replace(reduced, basis=reduced.basis[:, :size], blocks=blocks)


def _unmixed(snapshots, K) -> np.ndarray:
    """Modes of all snapshots (n_dof, n) of unit K-energy, close ones turned so that families of symmetry stay apart.

    With C_k the energies that modes of family k share with a group V of close modes, sum_k w_k C_k^T C_k is diagonal
    in the modes of pure symmetry, whatever the weights: its eigenvectors turn V back into them.
    """
    clean, close = [], []
    for value, phi in snapshots:
        for group in clusters_of(np.sqrt(value), MIXED_GAP):
            # the mode beyond those asked for may be one of a pair cut in two
            if group[0] < len(value) - 1:
                (clean if len(group) == 1 else close).append(phi[:, group])
    if not clean or not close:
        return _unit_energy(np.hstack(clean + close), K)
    pure = _unit_energy(np.hstack(clean), K)
    n_family, family = _families(pure.T @ (K @ pure))
    weight = (1.0 + np.arange(n_family))[family] / np.bincount(family)[family]
    turned = []
    for group in close:
        shared = pure.T @ (K @ group)
        turned.append(group @ np.linalg.eigh(shared.T @ (weight[:, None] * shared))[1])
    return np.hstack([pure, _unit_energy(np.hstack(turned), K)])


def _unit_energy(vectors, K):
    return vectors / np.sqrt(np.einsum("ij,ij->j", vectors, K @ vectors))


def _families(gram):
    """Number of families and the family of each vector (n,)."""
    return csgraph.connected_components(sparse.csr_array(np.abs(gram) > COUPLING), directed=False)


def _proper_orthogonal(snapshots, K, max_size):
    """POD basis (n_dof, r), K-orthonormal, the most energetic vector first, and the family of each (r,)."""
    # the squared singular values of K^(1/2) S are the eigenvalues of S^T K S
    gram = snapshots.T @ (K @ snapshots)
    n_family, family = _families(gram)
    vectors, energies, families = [], [], []
    for k in range(n_family):
        members = np.flatnonzero(family == k)
        last = len(members) - 1
        inside = gram[np.ix_(members, members)]
        energy, vector = linalg.eigh(inside, subset_by_index=(max(0, last + 1 - max_size), last))
        kept = energy > 1e-12 * energy[-1]
        vectors.append(_orthonormal(snapshots[:, members] @ (vector[:, kept] / np.sqrt(energy[kept])), K))
        energies.append(energy[kept])
        families.append(np.full(kept.sum(), k))
    order = np.argsort(np.concatenate(energies))[::-1][:max_size]
    return np.hstack(vectors)[:, order], np.concatenate(families)[order]


def _orthonormal(basis, K):
    """K-orthonormal basis of the same space; twice, as once leaves rounding of the order of the condition."""
    for _ in range(2):
        factor = np.linalg.cholesky(basis.T @ (K @ basis))
        basis = np.linalg.solve(factor, basis.T).T
    return basis


def _project(model, basis, family, box, n_mode, tolerance) -> ReducedModel:
    stiffness, mass = (
        np.array([0.5 * (a + a.T) for a in (basis.T @ (term @ basis) for term in terms)])
        for terms in (model.stiffness, model.mass)
    )
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
    blocks = []
    for rows in _uncoupled(np.concatenate([stiffness, mass]), family):
        blocks.append(Block(
            rows=rows, n_mode=n_mode, stiffness=frozen_array(stiffness[:, rows[:, None], rows]),
            mass=frozen_array(mass[:, rows[:, None], rows]), at_channels=frozen_array(at_channels[:, rows]),
        ))  # fmt: skip
    return ReducedModel(
        full=model, projected=projected, basis=frozen_array(basis), lower=frozen_array(box[0]),
        upper=frozen_array(box[1]), n_mode=n_mode, blocks=tuple(blocks), frequency_tolerance=tolerance,
    )  # fmt: skip


def _uncoupled(terms: np.ndarray, family: np.ndarray) -> list[np.ndarray]:
    """The families' rows, those joined that any term couples."""
    number = family.max() + 1
    member = np.eye(number)[family]
    largest = np.abs(terms).max(axis=(1, 2))
    coupled = np.any(np.abs(terms) > ROUNDING * largest[:, None, None], axis=0)
    between = member.T @ coupled @ member > 0
    n_block, label = csgraph.connected_components(sparse.csr_array(between), directed=False)
    return [np.flatnonzero(label[family] == k) for k in range(n_block)]


def clusters_of(frequency_hz: Sequence[float], gap: float = CLUSTER_GAP) -> list[list[int]]:
    """Runs of modes whose neighbours are closer than `gap` of the frequency."""
    groups = [[0]]
    for j in range(1, len(frequency_hz)):
        if frequency_hz[j] - frequency_hz[j - 1] < gap * frequency_hz[j]:
            groups[-1].append(j)
        else:
            groups.append([j])
    return groups
