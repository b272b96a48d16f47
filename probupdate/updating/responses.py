"""What is compared, and with which weight: the responses Lambda of one group of modes and their standard deviations.

Frequencies stand in Hz or as logarithms. Shapes are taken in one of four ways (`Weights.shapes`):
"plane": a single mode by its components, a close cluster by the plane it spans, as its members turn into each other;
"components": every mode by its own components, as in the paper, close pairs too;
"mac": like "plane", but each shape or plane counts as one datum (1 - MAC over its expectation under the standard
deviations); "none": frequencies only, shapes serve the pairing.
A single mode's computed shape is scaled to the measured one, a cluster's shapes are combined linearly to the measured
plane: fitting k x k numbers to a group of k modes takes as many degrees of freedom from its residual. One of a close
pair that was measured alone lies somewhere in the plane of the computed pair: the combination Y t of the two that is
nearest is its shape, and the Rayleigh quotient sum t_i^2 f_i^2 / sum t_i^2 (of unit modal masses) its frequency
squared, which an error of the measured shape changes to second order only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy import linalg

from probupdate.errors import InputError
from probupdate.modal.labels import family, is_bending
from probupdate.modal.modes import ModalSet, rotate_to_real
from probupdate.runtime.arrays import frozen_array
from probupdate.updating.baseline import LearntError
from probupdate.updating.settings import CONSTANTS

FREQUENCIES = ("hz", "log")
SHAPES = ("plane", "components", "mac", "none")
PAPER_COV_FIRST, PAPER_COV_SECOND = CONSTANTS.paper_cov_first, CONSTANTS.paper_cov_second
SHAPE_FACTOR = CONSTANTS.shape_factor
LEAST_SHAPE_STD = CONSTANTS.least_shape_std
LEAST_FREQUENCY_COV = CONSTANTS.least_frequency_cov
FORM_FREQUENCY_COV, FORM_SHAPE_STD = CONSTANTS.form_frequency_cov, CONSTANTS.form_shape_std
SHARED = CONSTANTS.shared_discrepancy


@dataclass(frozen=True, eq=False, kw_only=True)
class Weights:
    """Which responses are compared and where their standard deviations come from; W_Lambda is the inverse of their
    covariance.

    frequency_cov (n_mode,): CoV of each mode of the data, or None for the file's frequency_std_hz. With `shape_std`
    the file's shape standard deviations are used where it has them; else, or where it has none, sigma of a component is
    shape_factor times the frequency's CoV times the largest component. With `covariance` all of these give way to the
    set's own standard deviations (ModalSet.standard deviation), joint over frequencies and shapes of all modes, plus
    independent least standard deviations.

    discrepancy: what the model itself may miss at its best parameters, a share of every frequency; shape_discrepancy:
    of the largest component of shapes (None: shape_factor times `discrepancy`); independent, added in squares to
    whatever the above give. mixing: relative local error of stiffness, which mixes the model's modes, so that what
    it does to shapes goes together over the structure (`problem.mix_modes`). `discrepancy_by` says where they come from
    (`updating.discrepancy`). `scales`: where they are learnt, rows of the three and ln of the hyper-prior's weight,
    over which likelihoods are averaged; the numbers then stand for them where one covariance is wanted (Eq. 6-7).
    `shared`: the share of a stated discrepancy's variance that is the same in all sets of a structure; of a learnt one
    the sets decide.

    tolerances: the sources of error that the model itself states (`model_error`) are marginalised, their effect taken
    at the parameters `at`, or at the initial ones. `baseline`: what other states of the structure have shown of the
    model's error (`updating.baseline`), in which the parameters `common` are the same numbers.
    """

    frequency_cov: tuple[float, ...] | None = None
    shape_std: bool = True
    shape_factor: float = SHAPE_FACTOR
    least_shape_std: float = LEAST_SHAPE_STD
    covariance: bool = False
    least_frequency_cov: float = LEAST_FREQUENCY_COV
    frequencies: str = "hz"
    shapes: str = "plane"
    discrepancy: float = 0.0
    shape_discrepancy: float | None = None
    mixing: float = 0.0
    discrepancy_by: str = "as stated"
    scales: tuple[tuple[float, float, float, float], ...] = ()
    shared: float = SHARED
    tolerances: bool = False
    at: tuple[float, ...] | None = None
    baseline: tuple[LearntError, ...] = ()
    common: tuple[str, ...] = ()

    def to_table(self) -> dict:
        """As plain numbers, but for a baseline."""
        return asdict(replace(self, baseline=(), common=()))

    @classmethod
    def from_table(cls, table: Mapping) -> Weights:
        """From what `to_table` gave, after JSON."""
        plain = {key: tuple(v) if isinstance(v, list) else v for key, v in table.items()}
        return cls(**plain | {"scales": tuple(map(tuple, table["scales"]))})

    def __post_init__(self):
        for name, value, known in (("frequencies", self.frequencies, FREQUENCIES), ("shapes", self.shapes, SHAPES)):
            if value not in known:
                raise InputError(name, f"'{value}' is unknown", f"choose from {', '.join(known)}")
        for name in ("shape_factor", "least_shape_std", "least_frequency_cov"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise InputError(name, f"{value} is not above zero", "give a share, such as 0.02")
        for value in (*self.discrepancies, self.mixing):
            if not (np.isfinite(value) and value >= 0):
                raise InputError("discrepancy", f"{value} is no share from 0 on",
                                 "give what the model may miss of a frequency, such as 0.005")
        if self.covariance and self.frequency_cov is not None:
            raise InputError("weights", "frequency CoVs are given and a full covariance is asked for", "choose one")
        if self.covariance and self.shapes == "mac":
            raise InputError("weights", "a MAC has one standard deviation, no covariance", "compare shapes as plane")
        if self.baseline and self.shapes == "mac":
            raise InputError("baseline", "knows errors of frequencies and of components; a MAC has none that is linear",
                             "compare shapes as plane, or not at all (--shapes none)")
        if self.common and not self.baseline:
            raise InputError("common", "names parameters of a baseline's states, and there is no baseline",
                             "give the runs with --baseline")

    @property
    def description(self) -> str:
        rule = f"{self.shape_factor:g} times the frequency's CoV, of the largest component"
        if self.covariance:
            text = (
                f"full covariance of the set's own identification, joint over modes, plus a model discrepancy of "
                f"{100 * self.least_frequency_cov:g} % of each frequency and {100 * self.least_shape_std:g} % of the "
                "largest component"
            )
        elif self.frequency_cov is None:
            text = (
                f"frequencies: standard deviations of the file; shape components: those of the file, at least "
                f"{100 * self.least_shape_std:g} % of the largest component, or where it has none {rule}"
            )
        else:
            text = f"frequencies: CoV {', '.join(f'{c:g}' for c in self.frequency_cov)}; shape components: {rule}"
        of_frequencies, of_shapes = self.discrepancies
        if of_frequencies or of_shapes:
            local = 100 * self.mixing
            mixed = f", and modes mixed by local errors of {local:.3g} % of stiffness" if local else ""
            text += (
                f"; model discrepancy of {100 * of_frequencies:.3g} % of each frequency and "
                f"{100 * of_shapes:.3g} % of the largest component added in squares{mixed} ({self.discrepancy_by})"
            )
        if self.tolerances:
            text += "; stated tolerances of the model and of its sensors marginalised"
        return f"{text}; {self.compared}"

    @property
    def discrepancies(self) -> tuple[float, float]:
        """Of every frequency and of the largest component of shapes, both shares."""
        own = self.shape_discrepancy
        return self.discrepancy, self.shape_factor * self.discrepancy if own is None else own

    def part(self, share: float) -> tuple[float, float]:
        """`discrepancies` of a share of the variance."""
        frequency, shape = self.discrepancies
        return float(np.sqrt(share) * frequency), float(np.sqrt(share) * shape)

    @property
    def least_std(self) -> tuple[float, float]:
        """Independent standard deviations beside a covariance: of frequencies (relative) and of shapes (of the
        largest)."""
        missed, shape_missed = self.discrepancies
        return float(np.hypot(self.least_frequency_cov, missed)), float(np.hypot(self.least_shape_std, shape_missed))

    @property
    def compared(self) -> str:
        """What the responses are, in words."""
        frequency = {"hz": "frequencies in Hz", "log": "logarithms of frequencies"}[self.frequencies]
        shape = {
            "plane": "components of shapes, close pairs as planes", "components": "components of every shape",
            "mac": "one MAC a shape, close pairs as planes", "none": "no shapes",
        }[self.shapes]
        return f"compared are {frequency}, {shape}"


def paper_weights(labels: tuple[str, ...], frequency_hz: np.ndarray, **others: Any) -> Weights:
    """CoV 0.015 for first and 0.017 for higher modes; first are those of first bending (FA1, SS1, X1, Y1), or
    unlabelled below 1 Hz."""
    first = [is_bending(name) and name == f"{family(name)}1" for name in labels] if labels else frequency_hz < 1.0
    cov = tuple(PAPER_COV_FIRST if f else PAPER_COV_SECOND for f in first)
    return Weights(frequency_cov=cov, shape_std=False, **others)


@dataclass(frozen=True, eq=False, kw_only=True)
class ResponseGroup:
    """Measured side of one group of k modes: frequencies ascending with standard deviations (k,), the basis of its
    shapes (n, k) and the standard deviation of its rows (n,), for the n rows of the model that were measured.

    `changes` (k + n k, n_column): the set's own covariance factors of the k frequencies (as responses) and of the
    basis, mode by mode; None where the standard deviations are independent. frequency_discrepancy_hz (k,),
    shape_discrepancy (n,): the part of the standard deviations that is the model's discrepancy, not the measurement's;
    shape_unit (n,): what a discrepancy of one of the largest component does to it.
    n_mates: 1 of a mode that was measured alone of a close pair and is compared with a combination of two computed
    ones.
    """

    frequency_hz: np.ndarray
    frequency_std_hz: np.ndarray
    rows: np.ndarray
    basis: np.ndarray
    shape_std: np.ndarray
    frequency_discrepancy_hz: np.ndarray
    shape_discrepancy: np.ndarray
    shape_unit: np.ndarray
    frequencies: str = "hz"
    shapes: str = "plane"
    changes: np.ndarray | None = None
    n_mates: int = 0

    @property
    def own_changes(self) -> np.ndarray:
        """`changes`. Raises ValueError where the standard deviations are independent."""
        if self.changes is None:
            raise ValueError("the group has no covariance factors: collect it with Weights(covariance=True)")
        return self.changes

    @property
    def size(self) -> int:
        """How many modes are compared together."""
        return self.basis.shape[1]

    @property
    def n_effective(self) -> int:
        """Expected chi-square of a true model at the truth."""
        shapes = {"none": 0, "mac": 1}.get(self.shapes, self.basis.size - self.size * (self.size + self.n_mates))
        return self.size + shapes

    @cached_property
    def frequency_response(self) -> np.ndarray:
        return np.log(self.frequency_hz) if self.frequencies == "log" else self.frequency_hz

    @cached_property
    def frequency_response_std(self) -> np.ndarray:
        return self.frequency_std_hz / self.frequency_hz if self.frequencies == "log" else self.frequency_std_hz

    @cached_property
    def shape_response(self) -> np.ndarray:
        """Components mode by mode (k n,), empty where shapes are not compared."""
        return np.zeros(0) if self.shapes == "none" else self.basis.T.ravel()

    @cached_property
    def shape_response_std(self) -> np.ndarray:
        return np.zeros(0) if self.shapes == "none" else np.tile(self.shape_std, self.size)

    @cached_property
    def discrepancy_std(self) -> tuple[np.ndarray, np.ndarray]:
        """Of the frequencies' responses (k,) and of the shapes' (k n,), empty where shapes are not compared."""
        scale = self.frequency_hz if self.frequencies == "log" else 1.0
        shape = np.zeros(0) if self.shapes == "none" else np.tile(self.shape_discrepancy, self.size)
        return self.frequency_discrepancy_hz / scale, shape

    @cached_property
    def unit_discrepancy(self) -> tuple[np.ndarray, np.ndarray]:
        """What a discrepancy of one does to the responses: of frequencies (k,), of shapes (k n,)."""
        frequency = np.ones(self.size) if self.frequencies == "log" else self.frequency_hz
        return frequency, np.zeros(0) if self.shapes == "none" else np.tile(self.shape_unit, self.size)

    @cached_property
    def scaled_basis(self) -> np.ndarray:
        return self.basis / self.shape_std[:, None]

    @cached_property
    def plane(self) -> np.ndarray:
        """Orthonormal basis of the unweighted plane: what MAC is computed with."""
        return np.linalg.qr(self.basis)[0]

    @cached_property
    def alignment_residual(self) -> np.ndarray:
        """What is left (n k, n k) of components mode by mode when the shapes are aligned."""
        if self.shapes == "none":
            return np.zeros((0, 0))
        taken = self.basis @ np.linalg.pinv(self.scaled_basis) / self.shape_std
        return np.kron(np.eye(self.size), np.eye(len(self.basis)) - taken)

    @cached_property
    def complement(self) -> np.ndarray:
        """Orthonormal basis (n, n - k) of what is orthogonal to the plane: where a residual carries information."""
        return linalg.null_space(self.basis.T)

    def combine_modes(self, frequency_hz: np.ndarray, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies (m, k) and shapes (m, n, k) that are compared, of the computed (m, k + n_mates) and
        (m, n, k + n_mates): of one of a pair its combination, else as they are."""
        if not self.n_mates:
            return frequency_hz, shape
        # of least norm: where no second mode is left, the pair is twice the one
        turn = np.linalg.pinv(shape / self.shape_std[:, None]) @ self.scaled_basis
        return np.sqrt(np.sum((turn[:, :, 0] * frequency_hz) ** 2, axis=1, keepdims=True)
                       / np.sum(turn**2, axis=1)), shape @ turn

    def combined_derivative(
        self, frequency_hz: np.ndarray, shape: np.ndarray, d_frequency: np.ndarray, d_shape: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """d combined: (k, n_param) and (n, k, n_param) from frequencies (c,) and shapes (n, c) of c = k + n_mates modes
        with their changes (c, n_param) and (n, c, n_param), rotation within the pair included."""
        if not self.n_mates:
            return d_frequency, d_shape
        over, d_over = shape / self.shape_std[:, None], d_shape / self.shape_std[:, None, None]
        back = np.linalg.pinv(over)
        t = (back @ self.scaled_basis)[:, 0]
        residual = self.scaled_basis[:, 0] - over @ t
        moved = np.einsum("njp,j->np", d_over, t)
        d_t = back @ back.T @ (np.einsum("njp,n->jp", d_over, residual) - over.T @ moved)
        whole, square = t @ t, (t * frequency_hz) @ (t * frequency_hz) / (t @ t)
        d_square = 2 * ((t**2 * frequency_hz) @ d_frequency + (t * (frequency_hz**2 - square)) @ d_t) / whole
        d_combined = (moved + over @ d_t) * self.shape_std[:, None]
        return d_square[None] / (2 * np.sqrt(square)), d_combined[:, None]

    def align(self, shape: np.ndarray) -> np.ndarray:
        """Computed shapes (m, n, k) combined to the measured basis: the responses of shapes (m, n, k).

        Independent errors: the combination Y T closest to the basis over its standard deviations. A covariance: the
        one whose part within the measured plane is the measured basis itself, so that all of the residual lies across
        it, where scale and rotation, that nothing determines, have no part.
        """
        if self.changes is not None:
            return shape @ np.linalg.solve(self.plane.T @ shape, self.plane.T @ self.basis)
        aligned, _, _ = align(shape / self.shape_std[:, None], self.scaled_basis)
        return aligned * self.shape_std[:, None]

    def aligned_derivative(self, shape: np.ndarray, change: np.ndarray) -> np.ndarray:
        """d aligned (n, k, n_param) from shape (n, k) and its change (n, k, n_param)."""
        if self.changes is not None:
            inside = self.plane.T @ shape
            turn = np.linalg.solve(inside, self.plane.T @ self.basis)
            moved = np.einsum("cjp,jk->ckp", change, turn)
            back = shape @ np.linalg.inv(inside)
            return moved - (back @ (self.plane.T @ moved.reshape(len(moved), -1))).reshape(moved.shape)
        scale = self.shape_std[:, None]
        over, d_over = shape / scale, change / scale[:, :, None]
        aligned, turn, inverse = align(over[None], self.scaled_basis)
        return align_derivative(over, d_over, turn[0], inverse[0], self.scaled_basis - aligned[0]) * scale[:, :, None]


def align(shape: np.ndarray, basis: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Y T with T (n, k, k) that brings it closest to the basis X in the least-squares sense, T, and (Y^T Y)^-1.

    shape Y (n, n_row, k) and basis X (n_row, k), both over the rows' standard deviations.
    """
    # columns to unit length first: T is free, so this only helps the condition of Y^T Y
    size = np.linalg.norm(shape, axis=1, keepdims=True)
    unit = shape / size
    inverse = np.linalg.inv(np.swapaxes(unit, 1, 2) @ unit)
    inverse = inverse / (np.swapaxes(size, 1, 2) * size)
    turn = inverse @ (np.swapaxes(shape, 1, 2) @ basis)
    return shape @ turn, turn, inverse


def align_derivative(shape, change, turn, inverse, residual) -> np.ndarray:
    """d(Y T) (n_row, k, n_param) from dY: (1 - P) dY T + Y (Y^T Y)^-1 dY^T R with the projector P and R = X - Y T."""
    moved = np.einsum("cjp,jk->ckp", change, turn)
    projected = (shape.T @ moved.reshape(len(shape), -1)).reshape(-1, *moved.shape[1:])
    turned = np.tensordot(change, residual, (0, 0)).transpose(0, 2, 1)
    return moved + ((shape @ inverse) @ (turned - projected).reshape(shape.shape[1], -1)).reshape(moved.shape)


def joint_root(groups: tuple[ResponseGroup, ...], least_std: tuple[float, float]) -> np.ndarray:
    """R (n_effective, n_response) with W_Lambda = R^T R, the inverse covariance of all responses together.

    Shapes count by their part across the measured planes; the least standard deviations are independent of everything.
    """
    n_frequency = sum(g.size for g in groups)
    pick, changes, least = [], [], []
    for g in groups:
        changes.append(g.own_changes[: g.size])
        least.append(least_std[0] * (np.ones(g.size) if g.frequencies == "log" else g.frequency_hz))
    for g in groups:
        if g.shapes != "none":
            across = np.kron(np.eye(g.size), g.complement.T)
            pick.append(across)
            changes.append(across @ g.own_changes[g.size :])
            least.append(np.full(len(across), least_std[1]))
    changes, least = np.vstack(changes), np.concatenate(least)
    factor = linalg.cholesky(changes @ changes.T + np.diag(least**2), lower=True)
    return linalg.solve_triangular(factor, linalg.block_diag(np.eye(n_frequency), *pick), lower=True)


def _without_shape(modal_set: ModalSet, members: list[int], rows, weights: Weights, labels) -> ResponseGroup:
    """Frequencies alone, of a set without shapes."""
    frequency, nothing = modal_set.frequency_hz[members], np.zeros((0, len(members)))
    if weights.covariance:
        raise InputError(modal_set.where, "has no shape, whose covariance is asked for",
                         "give --weights measured with --shapes none")
    least = weights.least_frequency_cov if weights.tolerances else 0.0
    missed = np.hypot(weights.discrepancy, least) * frequency
    std = np.hypot(_frequency_std(modal_set, members, weights, labels), missed)
    return ResponseGroup(
        frequency_hz=frozen_array(frequency), rows=rows, frequencies=weights.frequencies, shapes="none",
        frequency_std_hz=frozen_array(std), basis=frozen_array(nothing), shape_std=frozen_array(np.zeros(0)),
        frequency_discrepancy_hz=frozen_array(missed), shape_discrepancy=frozen_array(np.zeros(0)),
        shape_unit=frozen_array(np.zeros(0)))


def response_group(modal_set: ModalSet, members: list[int], rows, weights: Weights, labels,
                   n_mates: int = 0) -> ResponseGroup:
    """The measured side of modes that `matching.match` grouped; raises InputError where a standard deviation is
    missing."""
    where = f"{modal_set.where}, {' and '.join(labels[j] for j in members)}"
    frequency = modal_set.frequency_hz[members]
    turned = rotate_to_real(modal_set.shape[:, members])
    kept = np.all(np.isfinite(turned), axis=1)
    shape = np.real(turned)[kept]
    if not len(shape) and weights.shapes != "none":
        raise InputError(where, "has no component of its shape", "compare frequencies alone (--shapes none)")
    if not len(shape):
        return _without_shape(modal_set, members, rows[kept], weights, labels)
    # scaled per mode to largest component 1 first, so that neither of a plane's shapes outweighs the other
    largest = np.max(np.abs(shape), axis=0)
    if np.any(largest == 0):
        raise InputError(where, "its shape is zero everywhere", "give the components, null where not measured")
    given = modal_set.shape_std[kept][:, members] / largest
    if np.any(given < 0):
        raise InputError(f"{where}, shape_std", "is negative", "give standard deviations, null where unknown")
    basis, to_basis = _basis(shape, largest)
    common: dict[str, Any] = dict(
        frequency_hz=frozen_array(frequency), rows=rows[kept], frequencies=weights.frequencies, shapes=weights.shapes,
        n_mates=n_mates,
    )
    if weights.covariance:
        phase = np.nansum(modal_set.shape[:, members].conj() * turned, axis=0)
        phase = phase / np.abs(phase)
        changes = _changes_of_set(modal_set, members, kept, phase / largest, to_basis, weights, where)
        std, sigma = _std_of_changes(changes, frequency, len(basis), weights)
        return ResponseGroup(
            frequency_std_hz=frozen_array(std), basis=frozen_array(basis), shape_std=frozen_array(sigma),
            changes=frozen_array(changes), frequency_discrepancy_hz=frozen_array(weights.least_std[0] * frequency),
            shape_discrepancy=frozen_array(np.full(len(basis), weights.least_std[1])),
            shape_unit=frozen_array(np.ones(len(basis))), **common,
        )
    std = _frequency_std(modal_set, members, weights, labels)
    sigma, below = _shape_std(given, to_basis, weights, weights.shape_factor * float(np.mean(std / frequency)))
    # what no tolerance holds: of shapes it is within their least standard deviation
    least = weights.least_frequency_cov if weights.tolerances else 0.0
    share, added = weights.discrepancies
    missed, shape_missed = np.hypot(share, least) * frequency, np.hypot(below, added)
    std, sigma = np.hypot(std, missed), np.hypot(sigma, added)
    unit = np.ones(len(basis))
    if weights.shapes == "mac":
        sigma, shape_missed, unit = (_std_of_mac(basis, s, len(members)) for s in (sigma, shape_missed, unit))
        basis = basis / np.linalg.norm(basis[:, 0])
    return ResponseGroup(
        frequency_std_hz=frozen_array(std), basis=frozen_array(basis), shape_std=frozen_array(sigma),
        frequency_discrepancy_hz=frozen_array(missed), shape_discrepancy=frozen_array(shape_missed),
        shape_unit=frozen_array(unit), **common,
    )


def _basis(shape: np.ndarray, largest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What is compared of shapes (n, k), and what carries them, scaled by their largest components (k,), to it: of one
    mode its shape, of several the directions of their plane with a longest row of one."""
    if shape.shape[1] == 1:
        sign = np.sign(shape[np.argmax(np.abs(shape))])
        return shape / largest * sign, np.diag(sign)
    u, singular, v = np.linalg.svd(shape / largest, full_matrices=False)
    size = np.max(np.linalg.norm(u, axis=1))
    return u / size, v.T / singular / size


def _std_of_changes(
    changes: np.ndarray, frequency: np.ndarray, n: int, weights: Weights
) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations of frequencies (k,) and of rows of the basis (n,) by rows of factors, with the least ones."""
    spread, k = np.sqrt(np.sum(changes**2, axis=1)), len(frequency)
    own = frequency if weights.frequencies == "log" else 1.0
    std = np.hypot(spread[:k] * own, weights.least_std[0] * frequency)
    return std, np.sqrt(np.mean(spread[k:].reshape(k, n) ** 2, axis=0) + weights.least_std[1] ** 2)


def _std_of_mac(basis: np.ndarray, sigma: np.ndarray, k: int) -> np.ndarray:
    """k - sum of squared cosines is |Q - P Q|^2 of an orthonormal basis Q: over its expectation, by a standard
    deviation of each row (n,), one datum."""
    size = np.linalg.norm(basis[:, 0])
    left = 1 - np.sum((basis / size) ** 2, axis=1)
    return np.full(len(basis), np.sqrt(k * float(np.sum(sigma**2 * left)) / size**2))


def _shape_std(given: np.ndarray, to_basis: np.ndarray, weights: Weights, rule: float) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviation of each row of the basis (n,) from those of the shapes (n, k), and the part of it (n,) that
    the least standard deviation adds to what was measured."""
    if not (weights.shape_std and np.any(np.isfinite(given))):
        return np.full(len(given), rule), np.zeros(len(given))
    # standard deviations of the shapes carried to the basis; one per row, so that a turned basis has the same
    variance = np.mean(given**2 @ to_basis**2, axis=1)
    sigma = np.where(np.isfinite(variance), np.sqrt(variance), rule)
    return np.maximum(sigma, weights.least_shape_std), np.sqrt(np.maximum(weights.least_shape_std**2 - sigma**2, 0.0))


def _changes_of_set(modal_set: ModalSet, members, kept, factor, to_basis, weights: Weights, where: str) -> np.ndarray:
    """ResponseGroup.changes: the set's standard deviations carried to the responses.

    How the turn onto the real axis itself deviates is left out: it moves real parts by imaginary ones, which are small.
    """
    covariance_factors = modal_set.covariance_factors
    if covariance_factors is None:
        raise InputError(
            where, "the set has no covariance factors, which a full covariance needs",
            "keep the .deviations.h5 file that `identify` writes beside modes.json, or choose --weights measured",
        )
    ln_frequency = np.asarray(covariance_factors.ln_frequency)[members]
    shape = np.asarray(covariance_factors.shape)[kept][:, members]
    if not (np.all(np.isfinite(ln_frequency)) and np.all(np.isfinite(shape))):
        raise InputError(f"{where}, deviations", "are not given for every measured component",
                         "identify the set again, or choose --weights measured")
    real = np.real(shape * factor[None, :, None])
    basis = np.einsum("cjp,jk->kcp", real, to_basis).reshape(-1, real.shape[2])
    scale = 1.0 if weights.frequencies == "log" else modal_set.frequency_hz[members][:, None]
    return np.vstack([ln_frequency * scale, basis])


def _frequency_std(modal_set: ModalSet, members, weights: Weights, labels) -> np.ndarray:
    frequency = modal_set.frequency_hz[members]
    if weights.frequency_cov is not None:
        if len(weights.frequency_cov) != modal_set.frequency_hz.size:
            raise InputError(
                "frequency CoV", f"{len(weights.frequency_cov)} given for {modal_set.frequency_hz.size} modes",
                "give one for each mode of the file, in its order",
            )
        for j in members:
            if not (np.isfinite(weights.frequency_cov[j]) and weights.frequency_cov[j] > 0):
                raise InputError(f"frequency CoV of {labels[j]}", f"{weights.frequency_cov[j]} is not above zero",
                                 "give a share of the frequency, such as 0.015")
        return np.array(weights.frequency_cov)[members] * frequency
    std = modal_set.frequency_std_hz[members]
    for j, value in zip(members, std, strict=True):
        if not (np.isfinite(value) and value > 0):
            raise InputError(
                f"{modal_set.where}, frequency_std_hz of {labels[j]}", "is missing or not above zero",
                "add it, or give --weights paper or --frequency-cov",
            )
    return std
