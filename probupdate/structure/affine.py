"""A model whose K and M are sums of constant matrices times scalar functions of its parameters."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from probupdate.errors import InputError
from probupdate.modal.mode_energy import DofPlaces
from probupdate.model.interface import ManySolutions, ModalSolution, Wireframe
from probupdate.model.parameters import Parameters
from probupdate.model.uncertainty import ModelUncertainty
from probupdate.runtime.arrays import frozen_array
from probupdate.structure.eigen import DENSE_BELOW, available_modes, cluster_coupling, lowest_modes, mode_derivatives
from probupdate.structure.moved_channels import MovedChannels, rows_moved
from probupdate.structure.readings import FeltGravity, channel_readings, reading_slopes

# imaginary step of the complex-step derivative: no subtraction, so it is exact to rounding (Squire & Trapp 1998)
STEP = 1e-30
# bytes of solutions and of derivatives that are remembered, at least REMEMBERED_LEAST of them: optimisers ask again
# where they have been
REMEMBERED, REMEMBERED_LEAST = 8e6, 4
# bytes of products of terms with modes that are summed up at once
PRODUCTS = 4e6


@dataclass(frozen=True, eq=False, kw_only=True)
class AffineModel:
    """K(theta) = sum_t c_t(theta) K_t, M(theta) likewise; implements `model.Model`.

    `coefficients` maps theta (..., n_param), real or complex, to (..., n_stiffness) and (..., n_mass) and must be
    analytic where it is used, as its derivatives are taken by complex steps. `channel_matrix` (n_channel, n_dof)
    picks the measured motion and `tilt_matrix` (n_channel, n_dof) what the channels read of gravity (`gravity`, see
    `readings`; both None where the model has no rotations); parameters may move these rows elsewhere (`moved`, of both
    one below the other: `channel_rows`). `wire_matrix` (3 n_node, n_dof) is the motion of the picture's nodes,
    `wire_turn` their rotation. `derived` holds named scalars of theta, such as pile-head stiffness. `hash_key`
    stands for all that went into the matrices. `places`: where its degrees of freedom are, if known. `uncertainty`:
    what is not known of the model itself (`model_error`). `turned`: stiffness and mass terms with the nacelle at other
    angles, where these were asked for.
    """

    name: str
    parameters: Parameters
    channels: tuple[str, ...]
    stiffness: tuple[sparse.csc_array, ...]
    mass: tuple[sparse.csc_array, ...]
    coefficients: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    channel_matrix: sparse.csr_array
    hash_key: str
    wire: Wireframe | None = None
    wire_matrix: sparse.csr_array | None = None
    derived: Mapping[str, Callable[[np.ndarray], float]] = field(default_factory=dict)
    uncertainty: ModelUncertainty | None = None
    moved: tuple[MovedChannels, ...] = ()
    places: DofPlaces | None = None
    tilt_matrix: sparse.csr_array | None = None
    gravity: FeltGravity | None = None
    wire_turn: sparse.csr_array | None = None
    turned: tuple[tuple[tuple[sparse.csc_array, ...], tuple[sparse.csc_array, ...]], ...] = ()

    def with_gravity(self, felt: Mapping[str, bool]) -> AffineModel:
        """With what is stated of channels by their names: whether their readings hold gravity."""
        if self.gravity is None:
            return self
        stated = self.gravity.with_gravity(felt, self.channels)
        if np.array_equal(stated.share, self.gravity.share):
            return self
        known = None if self.uncertainty is None else self.uncertainty.with_gravity(felt)
        return replace(self, gravity=stated, uncertainty=known)

    @property
    def n_dof(self) -> int:
        return self.stiffness[0].shape[0]

    @cached_property
    def mesh(self) -> tuple[bytes, ...]:
        """Equal for models of one mesh: where degrees of freedom are, or, if that is not known, which are joined."""
        if self.places is None:
            return tuple(part.tobytes() for K in self.stiffness for part in (K.indptr, K.indices))
        return self.places.position_m.tobytes(), self.places.direction.tobytes()

    @property
    def n_available(self) -> int:
        # a type checker takes no cached property for the interface's own
        return self._n_available

    @cached_property
    def _n_available(self) -> int:
        return available_modes(*self.matrices(self.parameters.initial))

    def _theta(self, theta) -> np.ndarray:
        theta = np.asarray(theta, float)
        if theta.shape[-1:] != (len(self.parameters),):
            raise InputError(self.name, f"theta has shape {theta.shape}", f"give {len(self.parameters)} values")
        if not np.all(np.isfinite(theta)):
            raise InputError(self.name, "theta is not finite", "check the parameters")
        return theta

    def matrices(self, theta: np.ndarray) -> tuple[sparse.csc_array, sparse.csc_array]:
        """K and M at theta (n_param,)."""
        cK, cM = self.coefficients(self._theta(theta))
        return sparse.csc_array(self._sums[0](cK)), sparse.csc_array(self._sums[1](cM))

    @cached_property
    def _sums(self) -> tuple[WeightedSum, WeightedSum]:
        return WeightedSum.from_matrices(self.stiffness), WeightedSum.from_matrices(self.mass)

    @property
    def of_channels(self) -> tuple[int, ...]:
        """Numbers of the parameters that change what channels read and nothing of the structure."""
        felt = () if self.gravity is None else tuple(column for column, _ in self.gravity.reversed_by)
        return (*(m.column for m in self.moved), *felt)

    @cached_property
    def rows(self) -> sparse.csr_array:
        """(n_channel, n_dof) motion of the channels as described or, where it is known, (2 n_channel, n_dof) with their
        tilt below it."""
        if self.tilt_matrix is None:
            return self.channel_matrix
        return sparse.vstack([self.channel_matrix, self.tilt_matrix], format="csr")

    def channel_rows(self, theta: np.ndarray) -> sparse.csr_array:
        """`rows` at theta (n_param,)."""
        return rows_moved(self.rows, self.moved, self._theta(theta))

    def read(self, theta: np.ndarray, value: np.ndarray, phi: np.ndarray) -> np.ndarray:
        """(n_channel, n_mode) what the channels read at theta of modes phi (n_dof, n_mode) of these eigenvalues."""
        theta = self._theta(theta)
        return channel_readings(self.channel_rows(theta) @ phi, value, self._last_solution(theta))

    def _last_solution(self, theta: np.ndarray) -> np.ndarray | None:
        return None if self.gravity is None else self.gravity.evaluate(theta)

    def coefficient_derivatives(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """d c_K (n_stiffness, n_param) and d c_M (n_mass, n_param) at theta, by complex steps."""
        theta = self._theta(theta)
        stepped = theta + 1j * STEP * np.eye(theta.size)
        cK, cM = self.coefficients(stepped)
        return np.imag(cK).T / STEP, np.imag(cM).T / STEP

    def _describe_theta(self, theta) -> str:
        values = ", ".join(f"{n}={v:.4g}" for n, v in zip(self.parameters.names, theta, strict=True))
        return f"{self.name} at {values}"

    def solve_full(self, theta, n_mode):
        """lambda (n_mode,) and phi (n_dof, n_mode)."""
        theta = self._theta(theta)

        def solved():
            matrices = [total(c) for total, c in zip(self._sums, self.coefficients(theta), strict=True)]
            value, phi = lowest_modes(*matrices, n_mode, self._describe_theta(theta))
            return frozen_array(value), frozen_array(phi)

        return self._recent_solutions["modes"]((theta.tobytes(), n_mode), solved)

    def stiffness_and_modes(self, theta: np.ndarray, n_mode: int) -> tuple[sparse.csc_array, np.ndarray]:
        return self.matrices(theta)[0], self.solve_full(theta, n_mode)[1]

    @cached_property
    def _recent_solutions(self) -> dict[str, _Recent]:
        return {"modes": _Recent(), "derivatives": _Recent()}

    def solve(
        self,
        theta: np.ndarray,
        n_mode: int,
        *,
        derivatives: bool = False,
        clusters: tuple[tuple[int, ...], ...] = (),
    ) -> ModalSolution:
        theta = self._theta(theta)
        value, phi = self.solve_full(theta, n_mode)
        frequency = np.sqrt(value) / (2 * np.pi)
        result = {"theta": frozen_array(theta), "frequency_hz": frozen_array(frequency),
                  "shape": frozen_array(self.read(theta, value, phi))}
        if derivatives:
            change = self._recent_solutions["derivatives"](
                (theta.tobytes(), n_mode, clusters), lambda: self._derivatives(theta, value, phi, clusters))
            result |= {"frequency_derivative": change[0], "shape_derivative": change[1]}
        return ModalSolution(**result)

    def _derivatives(self, theta, value, phi, clusters):
        """d frequency_hz (n_mode, n_param) and d shape (n_channel, n_mode, n_param)."""
        K, M = self.matrices(theta)
        dcK, dcM = self.coefficient_derivatives(theta)
        dK_phi, dM_phi = _products(self.stiffness, phi, dcK), _products(self.mass, phi, dcM)
        d_value, d_phi = mode_derivatives(K, M, value, phi, dK_phi, dM_phi, clusters)
        n, m, p = d_phi.shape
        rows = self.channel_rows(theta)
        at_channels = (rows @ d_phi.reshape(n, m * p)).reshape(-1, m, p)
        for own in self.moved:
            at_channels[:, :, own.column] += own.slope(float(theta[own.column])) @ phi
        if self.gravity is not None:
            coupling = cluster_coupling(value, phi, dK_phi, dM_phi, d_value, clusters)
            at_channels = self._slopes_as_read(theta, value, rows @ phi, at_channels, coupling)
        # lambda = (2 pi f)^2, so df = d lambda / (8 pi^2 f)
        return frozen_array(d_value / (4 * np.pi * np.sqrt(value)[:, None])), frozen_array(at_channels)

    def _slopes_as_read(self, theta, value, seen, change, coupling):
        result = reading_slopes(seen, change, value, coupling, self._last_solution(theta))
        for column, slope in () if self.gravity is None else self.gravity.slopes():
            result[:, :, column] += slope[:, None] * seen[len(slope) :] / value
        return result

    def solve_many(self, theta: np.ndarray, n_mode: int) -> ManySolutions:
        theta = self._theta(np.atleast_2d(theta))
        solutions = [self.solve(row, n_mode) for row in theta]
        return ManySolutions(
            frequency_hz=np.array([s.frequency_hz for s in solutions]),
            shape=np.array([s.shape for s in solutions]),
            fallback=np.zeros(len(theta), bool),
        )

    def wireframe(self, theta: np.ndarray, n_mode: int = 0) -> Wireframe | None:
        if self.wire is None or not n_mode:
            return self.wire
        _, phi = self.solve_full(theta, n_mode)
        displacement = (self.wire_matrix @ phi).reshape(-1, 3, n_mode)
        return Wireframe(
            node_m=self.wire.node_m, line=self.wire.line, line_group=self.wire.line_group,
            displacement=frozen_array(displacement),
        )

    def fingerprint(self) -> str:
        text = [self.name, self.hash_key, *self.channels]
        if self.gravity is not None and np.any(self.gravity.share):
            # without any the answers are those of a model that knows nothing of it
            text.append(f"gravity {self.gravity.mps2!r} {self.gravity.share.tolist()}")
        for p in (*self.parameters, *self.parameters.held):
            text.append(repr(p))
        if self.parameters.correlation is not None:
            text.append(self.parameters.correlation.tobytes().hex())
        return hashlib.sha256("\n".join(text).encode()).hexdigest()


def _products(terms: Sequence[sparse.csc_array], phi: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """sum_t weights_tp K_t phi (n_dof, n_mode, n_param) for phi (n_dof, n_mode), some terms at a time."""
    at_once, total = max(1, int(PRODUCTS / phi.nbytes)), np.zeros((*phi.shape, weights.shape[1]))
    for first in range(0, len(terms), at_once):
        part = slice(first, first + at_once)
        total += np.tensordot(np.array([term @ phi for term in terms[part]]), weights[part], (0, 0))
    return total


class _Recent:
    """Pairs of arrays by key, the latest ones; what is remembered is what would be computed."""

    def __init__(self):
        self._kept: dict[tuple, tuple[np.ndarray, np.ndarray]] = {}

    def __call__(self, key: tuple, compute: Callable[[], tuple[np.ndarray, np.ndarray]]):
        found = self._kept.get(key)
        if found is None:
            found = compute()
            most = max(REMEMBERED_LEAST, int(REMEMBERED / sum(a.nbytes for a in found)))
            while len(self._kept) >= most:
                del self._kept[next(iter(self._kept))]
            self._kept[key] = found
        return found

    def __reduce__(self):
        # other processes begin afresh
        return _Recent, ()


@dataclass(frozen=True, eq=False, kw_only=True)
class WeightedSum:
    """weight (n_term,) -> sum of weight times constant matrices, an array where it is solved as one (`eigen`): all
    their entries in one list, as hundreds of sparse additions cost more. Entry k of the list belongs to term[k] and to
    place slot[k] of the joint pattern."""

    value: np.ndarray
    term: np.ndarray
    slot: np.ndarray
    indices: np.ndarray
    indptr: np.ndarray

    @classmethod
    def from_matrices(cls, matrices) -> WeightedSum:
        n = matrices[0].shape[0]
        parts = [sparse.coo_array(matrix) for matrix in matrices]
        place = np.concatenate([part.col.astype(np.int64) * n + part.row for part in parts])
        joint, slot = np.unique(place, return_inverse=True)
        return cls(
            value=np.concatenate([part.data for part in parts]),
            term=np.repeat(np.arange(len(parts)), [part.nnz for part in parts]),
            slot=slot, indices=joint % n, indptr=np.searchsorted(joint, n * np.arange(n + 1)),
        )

    @cached_property
    def column(self) -> np.ndarray:
        return np.repeat(np.arange(len(self.indptr) - 1), np.diff(self.indptr))

    def __call__(self, weight: np.ndarray) -> sparse.csc_array | np.ndarray:
        n = len(self.indptr) - 1
        data = np.bincount(self.slot, weights=self.value * weight[self.term], minlength=len(self.indices))
        if n < DENSE_BELOW:
            matrix = np.zeros((n, n))
            matrix[self.indices, self.column] = data
            return matrix
        matrix = sparse.csc_array((data, self.indices.copy(), self.indptr.copy()), shape=(n, n))
        matrix.eliminate_zeros()
        return matrix
