"""A model on a reduced basis: many parameter vectors a second inside the box it was built for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.linalg import lapack
from scipy.sparse import csgraph

from probupdate.errors import ConvergenceError, InputError
from probupdate.model.interface import ManySolutions, ModalSolution, Wireframe
from probupdate.runtime.arrays import frozen_array
from probupdate.structure.affine import AffineModel
from probupdate.structure.moved_channels import MovedChannels
from probupdate.structure.readings import channel_readings

# what families of basis vectors share by rounding, as a share of a term's largest entry; frequencies feel its square
ROUNDING = 1e-5
# rows that are assembled at once: few enough for the processor's cache
CHUNK = 64


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
    projections stiffness, mass (n_term, k, k) and of the channels' rows (`AffineModel.rows`), at_channels (n_row, k),
    which parameters may move (`moved`).

    `n_mode`: how many modes are computed at first, one more than it had among the lowest at any check.
    """

    rows: np.ndarray
    n_mode: int
    stiffness: np.ndarray
    mass: np.ndarray
    at_channels: np.ndarray
    moved: tuple[MovedChannels, ...] = ()

    def truncate(self, size: int) -> Block:
        """Without the vectors from number `size` on."""
        k = int(np.sum(self.rows < size))
        return replace(self, rows=self.rows[:k], stiffness=self.stiffness[:, :k, :k], mass=self.mass[:, :k, :k],
                       at_channels=self.at_channels[:, :k],
                       moved=tuple(m.project(np.eye(len(self.rows), k)) for m in self.moved))

    def shapes(self, theta: np.ndarray, vector: np.ndarray) -> np.ndarray:
        """(n, n_row, n_mode) at theta (n, n_param) of vectors (n, k, n_mode)."""
        shape = self.at_channels @ vector
        for m in self.moved:
            for row in np.flatnonzero(theta[:, m.column]):
                shape[row] += m.change(float(theta[row, m.column])) @ vector[row]
        return shape


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
    def n_available(self) -> int:
        return self.n_mode

    @property
    def parameters(self):
        return self.full.parameters

    @property
    def channels(self) -> tuple[str, ...]:
        return self.full.channels

    @property
    def derived(self):
        return self.full.derived

    @property
    def verification(self) -> ReductionReport:
        """`report`. Raises ValueError where the basis was not verified."""
        if self.report is None:
            raise ValueError("the basis was not verified: make it by reduce_basis")
        return self.report

    def with_gravity(self, felt: Mapping[str, bool]) -> ReducedModel:
        """As `AffineModel.with_gravity`; the basis is the same."""
        return replace(self, full=self.full.with_gravity(felt), projected=self.projected.with_gravity(felt))

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
        value = np.concatenate([own for own, _ in solved], axis=-1)
        seen = np.concatenate([block.shapes(theta, vector)
                               for block, (_, vector) in zip(self.blocks, solved, strict=True)], axis=-1)
        order = np.argsort(value, axis=1)[:, :n_mode]
        value, seen = np.take_along_axis(value, order, 1), np.take_along_axis(seen, order[:, None, :], 2)
        gravity = self.full.gravity
        seen = channel_readings(seen, value, None if gravity is None else gravity.evaluate(theta))
        exhausted = np.zeros(len(theta), bool)
        for block, n, (own, _) in zip(self.blocks, numbers, solved, strict=True):
            if n < min(n_mode, len(block.rows)):
                exhausted |= own[:, -1] <= value[:, -1]
        return value, seen, exhausted

    def with_shares(self, theta) -> ReducedModel:
        """With every block's n_mode from these points."""
        blocks = []
        cK, cM = self.full.coefficients(theta)
        solved = [_solve_block(block, cK, cM, self.n_mode)[0] for block in self.blocks]
        last = np.sort(np.concatenate(solved, axis=1), axis=1)[:, self.n_mode - 1]
        for block, value in zip(self.blocks, solved, strict=True):
            most = int(np.sum(value <= last[:, None], axis=1).max())
            blocks.append(replace(block, n_mode=min(most + 1, self.n_mode)))
        return replace(self, blocks=tuple(blocks))

    def truncate(self, size: int) -> ReducedModel:
        """With the first `size` vectors of the basis only, for `solve_many`."""
        blocks = tuple(block.truncate(size) for block in self.blocks if block.rows[0] < size)
        return replace(self, basis=self.basis[:, :size], blocks=blocks)

    def stiffness_and_modes(self, theta: np.ndarray, n_mode: int) -> tuple[sparse.csc_array, np.ndarray]:
        return self.full.stiffness_and_modes(theta, n_mode)

    def wireframe(self, theta: np.ndarray, n_mode: int = 0) -> Wireframe | None:
        return self.full.wireframe(theta, n_mode)

    def fingerprint(self) -> str:
        """That of the full model: the reduction is an approximation of the same answers, within its report."""
        return self.full.fingerprint()


def _solve_block(block: Block, cK, cM, n_mode):
    """lambda (n, k) and vectors (n, size, k) of a block, k = n_mode or its size if that is less."""
    size = len(block.rows)
    n_mode = min(n_mode, size)
    K, M = np.tensordot(cK, block.stiffness, 1), np.tensordot(cM, block.mass, 1)
    value, vector = np.empty((len(K), n_mode)), np.empty((len(K), size, n_mode))
    for row in range(len(K)):
        # the largest 1 / lambda: a mass may be singular, and the lowest modes keep their digits. A symmetric C-ordered
        # matrix is its own Fortran-ordered transpose: no copy
        w, z, found, _, info = lapack.dsygvx(M[row].T, K[row].T, range="I", il=size - n_mode + 1, iu=size,
                                             overwrite_a=1, overwrite_b=1)
        if info != 0 or found != n_mode or w[0] <= 0:
            raise ConvergenceError(f"reduced eigenproblem failed (dsygvx info {info})", (cK[row], cM[row]))
        value[row] = 1 / w[n_mode - 1 :: -1]
        vector[row] = z[:, n_mode - 1 :: -1] * np.sqrt(value[row])
    return value, vector


def project(model, basis, family, box, n_mode, tolerance) -> ReducedModel:
    """The model on a basis (n_dof, r) whose vectors belong to families (r,) of symmetry."""
    stiffness, mass = (
        np.array([0.5 * (a + a.T) for a in (basis.T @ (term @ basis) for term in terms)])
        for terms in (model.stiffness, model.mass)
    )
    at_channels, moved = model.rows @ basis, tuple(m.project(basis) for m in model.moved)
    motion = len(model.channels)
    projected = AffineModel(
        name=f"{model.name} (reduced)",
        parameters=model.parameters,
        channels=model.channels,
        stiffness=tuple(sparse.csc_array(a) for a in stiffness),
        mass=tuple(sparse.csc_array(a) for a in mass),
        coefficients=model.coefficients,
        channel_matrix=sparse.csr_array(at_channels[:motion]),
        tilt_matrix=None if model.tilt_matrix is None else sparse.csr_array(at_channels[motion:]),
        gravity=model.gravity,
        hash_key=model.hash_key,
        derived=model.derived,
        moved=moved,
    )
    blocks = []
    for rows in _uncoupled_families(np.concatenate([stiffness, mass]), family):
        blocks.append(Block(
            rows=rows, n_mode=n_mode, stiffness=frozen_array(stiffness[:, rows[:, None], rows]),
            mass=frozen_array(mass[:, rows[:, None], rows]), at_channels=frozen_array(at_channels[:, rows]),
            moved=tuple(m.project(np.eye(len(basis.T))[:, rows]) for m in moved),
        ))
    return ReducedModel(
        full=model, projected=projected, basis=frozen_array(basis), lower=frozen_array(box[0]),
        upper=frozen_array(box[1]), n_mode=n_mode, blocks=tuple(blocks), frequency_tolerance=tolerance,
    )


def _uncoupled_families(terms: np.ndarray, family: np.ndarray) -> list[np.ndarray]:
    """The families' rows, those joined that any term couples."""
    number = family.max() + 1
    member = np.eye(number)[family]
    largest = np.abs(terms).max(axis=(1, 2))
    coupled = np.any(np.abs(terms) > ROUNDING * largest[:, None, None], axis=0)
    between = member.T @ coupled @ member > 0
    n_block, label = csgraph.connected_components(sparse.csr_array(between), directed=False)
    return [np.flatnonzero(label[family] == k) for k in range(n_block)]
