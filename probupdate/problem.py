"""The one updating problem both estimators solve: responses Lambda, their weights, the parameters and their prior.

Responses are the frequencies of the matched modes in Hz and the components of their shapes (Eq. 4). A single mode's
computed shape is scaled to the measured one; the computed shapes of a close cluster are combined linearly to the
measured plane, so that neither the data's nor the model's rotation in it matters. A measured cluster is represented by
an orthonormal basis of its plane, scaled so that its largest row is 1; a single mode by its shape with largest
component 1. Fitting k x k numbers to a group of k modes takes as many degrees of freedom from its residual.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from probupdate.errors import InputError
from probupdate.matching import Matching, assign, channel_rows, match
from probupdate.model import Model
from probupdate.modes import ModalData, ModalSet, frozen_array, rotate_to_real

# The paper: CoV of the frequencies of the first and second bending modes (Sec. 4); a shape component's deviation is
# ten times the frequency's CoV, here of the largest component, as a CoV of a component near zero means nothing.
PAPER_COV_FIRST, PAPER_COV_SECOND = 0.015, 0.017
SHAPE_FACTOR = 10.0
# the smallest deviation a measured shape component is believed to, as a share of the largest component: components
# that served as a reference have deviation zero
SHAPE_FLOOR = 0.02
# modes looked through for the measured ones at the initial parameters, beyond their number
SEARCH = 10


@dataclass(frozen=True, eq=False, kw_only=True)
class Weights:
    """Where the deviations of the responses come from; W_Lambda = diag(1 / sigma^2).

    frequency_cov (n_mode,): CoV of each mode of the data, or None for the file's frequency_std_hz. With `shape_std`
    the file's shape deviations are used where it has them; else, or where it has none, sigma of a component is
    shape_factor times the frequency's CoV times the largest component.
    """

    frequency_cov: tuple[float, ...] | None = None
    shape_std: bool = True
    shape_factor: float = SHAPE_FACTOR
    shape_floor: float = SHAPE_FLOOR

    @property
    def description(self) -> str:
        rule = f"{self.shape_factor:g} times the frequency's CoV, of the largest component"
        if self.frequency_cov is None:
            return (
                f"frequencies: deviations of the file; shape components: deviations of the file, at least "
                f"{100 * self.shape_floor:g} % of the largest component, or where it has none {rule}"
            )
        return f"frequencies: CoV {', '.join(f'{c:g}' for c in self.frequency_cov)}; shape components: {rule}"


def paper_weights(labels: tuple[str, ...], frequency_hz: np.ndarray) -> Weights:
    """CoV 0.015 for first and 0.017 for higher modes; first are those labelled FA1 or SS1, or unlabelled below 1 Hz."""
    first = [name[-1] == "1" and name[:2] in ("FA", "SS") for name in labels] if labels else frequency_hz < 1.0
    cov = tuple(PAPER_COV_FIRST if f else PAPER_COV_SECOND for f in first)
    return Weights(frequency_cov=cov, shape_std=False)


@dataclass(frozen=True, eq=False, kw_only=True)
class ResponseGroup:
    """Measured side of one group of k modes: frequencies ascending with deviations (k,), the basis of its shapes
    (n, k) and the deviation of its rows (n,), for the n rows of the model that were measured."""

    frequency_hz: np.ndarray
    frequency_std_hz: np.ndarray
    rows: np.ndarray
    basis: np.ndarray
    shape_std: np.ndarray

    @cached_property
    def scaled_basis(self) -> np.ndarray:
        return self.basis / self.shape_std[:, None]

    @cached_property
    def plane(self) -> np.ndarray:
        """Orthonormal basis of the unweighted plane: what MAC is computed with."""
        return np.linalg.qr(self.basis)[0]


@dataclass(frozen=True, eq=False, kw_only=True)
class Prediction:
    """Of n parameter vectors: response (n, n_response); computed (n, n_used) the model's modes taken for the measured
    ones; frequency_hz (n, n_used); mac (n, n_used), for members of a cluster that of its worst direction; fallback
    (n,) bool: answered by the full model because a reduced one does not cover it."""

    response: np.ndarray
    computed: np.ndarray
    frequency_hz: np.ndarray
    mac: np.ndarray
    fallback: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class Problem:
    """Measured responses Lambda_S, their deviations, and the model that predicts them; see `build_problem`."""

    model: Model
    set_id: str
    mode_labels: tuple[str, ...]
    matching: Matching
    groups: tuple[ResponseGroup, ...]
    weights: Weights

    @property
    def parameters(self):
        return self.model.parameters

    @cached_property
    def measured(self) -> np.ndarray:
        """Lambda_S (n_response,): frequencies by group, then shape components by group, mode and channel."""
        parts = [g.frequency_hz for g in self.groups] + [g.basis.T.ravel() for g in self.groups]
        return frozen_array(np.concatenate(parts))

    @cached_property
    def std(self) -> np.ndarray:
        """sigma of each response (n_response,); W_Lambda = diag(1 / sigma^2)."""
        parts = [g.frequency_std_hz for g in self.groups]
        parts += [np.tile(g.shape_std, g.basis.shape[1]) for g in self.groups]
        return frozen_array(np.concatenate(parts))

    @cached_property
    def n_frequency(self) -> int:
        return sum(g.frequency_hz.size for g in self.groups)

    @property
    def n_effective(self) -> int:
        """Responses less the numbers fitted to align shapes: the expected chi-square of a true model at truth."""
        return self.measured.size - sum(g.basis.shape[1] ** 2 for g in self.groups)

    @property
    def used(self) -> tuple[int, ...]:
        """Modes of the data, in the order of the responses' frequencies."""
        return self.matching.measured

    def predict_many(self, theta: np.ndarray) -> Prediction:
        """Lambda_M(theta) for theta (n, n_param) inside the bounds."""
        theta = np.atleast_2d(np.asarray(theta, float))
        solved = self.model.solve_many(theta, self.matching.n_mode)
        computed, criterion = self._assign(solved.shape)
        frequency = np.take_along_axis(solved.frequency_hz, computed, axis=1)
        parts, mac, start = [frequency], np.empty(computed.shape), 0
        for group in self.groups:
            k = group.basis.shape[1]
            columns = computed[:, start : start + k]
            shape = np.take_along_axis(solved.shape[:, group.rows], columns[:, None, :], axis=2)
            aligned, _, _ = _align(shape / group.shape_std[:, None], group.scaled_basis)
            aligned = aligned * group.shape_std[:, None]
            parts.append(aligned.transpose(0, 2, 1).reshape(len(theta), -1))
            if k == 1:
                mac[:, start] = np.take_along_axis(criterion[:, start], columns, axis=1)[:, 0]
            else:
                q, _ = np.linalg.qr(shape)
                mac[:, start : start + k] = (
                    np.linalg.svd(group.plane.T @ q, compute_uv=False)[:, -1:] ** 2
                )
            start += k
        return Prediction(
            response=np.concatenate(parts, axis=1), computed=computed, frequency_hz=frequency, mac=mac,
            fallback=solved.fallback,
        )

    def _assign(self, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """shape (n, n_channel, n_mode) -> computed (n, n_used) and the criterion (n, n_used, n_mode)."""
        criterion = np.empty((len(shape), self.n_frequency, shape.shape[2]))
        start = 0
        for group in self.groups:
            k = group.basis.shape[1]
            rows = shape[:, group.rows]
            inside = np.einsum("ck,ncm->nkm", group.plane, rows)
            share = np.sum(inside**2, axis=1) / np.sum(rows**2, axis=1)
            criterion[:, start : start + k] = share[:, None]
            start += k
        computed = np.array([_ascending_in_groups(assign(c), self.groups) for c in criterion])
        return computed, criterion

    def predict(self, theta: np.ndarray) -> np.ndarray:
        """Lambda_M(theta) (n_response,)."""
        return self.predict_many(theta).response[0]

    def sensitivity(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lambda_M (n_response,) and S (n_response, n_param), Eq. 5, exact, through the alignment of shapes."""
        solution = self.model.solve(theta, self.matching.n_mode)
        computed, _ = self._assign(solution.shape[None])
        clusters, start = [], 0
        for group in self.groups:
            k = group.basis.shape[1]
            clusters.append(tuple(int(i) for i in computed[0, start : start + k]))
            start += k
        solution = self.model.solve(
            theta, self.matching.n_mode, derivatives=True, clusters=tuple(c for c in clusters if len(c) > 1)
        )
        response = [solution.frequency_hz[list(c)] for c in clusters]
        slope = [solution.frequency_derivative[list(c)] for c in clusters]
        for group, columns in zip(self.groups, clusters, strict=True):
            members = list(columns)
            scale = group.shape_std[:, None]
            shape = solution.shape[group.rows][:, members] / scale
            change = solution.shape_derivative[group.rows][:, members] / scale[:, :, None]
            aligned, turn, inverse = _align(shape[None], group.scaled_basis)
            d_aligned = _align_derivative(shape, change, turn[0], inverse[0], group.scaled_basis - aligned[0])
            response.append((aligned[0] * scale).T.ravel())
            slope.append((d_aligned * scale[:, :, None]).transpose(1, 0, 2).reshape(-1, change.shape[2]))
        return np.concatenate(response), np.concatenate(slope)

    def misfit(self, response: np.ndarray) -> np.ndarray:
        """(Lambda_S - Lambda_M)^T W_Lambda (Lambda_S - Lambda_M), first term of Eq. 6; response (..., n_response)."""
        return np.sum(((self.measured - response) / self.std) ** 2, axis=-1)

    def log_likelihood(self, theta: np.ndarray) -> np.ndarray:
        """ln p(Lambda_S | theta) (n,), Gaussian with W_Lambda as inverse covariance, constants kept."""
        constant = -np.sum(np.log(self.std)) - 0.5 * self.std.size * np.log(2 * np.pi)
        return constant - 0.5 * self.misfit(self.predict_many(theta).response)

    def log_posterior(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """ln p(theta | Lambda_S) + const, and which rows fell back to a full model, both (n,); -inf out of bounds."""
        theta = np.atleast_2d(np.asarray(theta, float))
        value = self.parameters.log_density(theta)
        fallback = np.zeros(len(theta), bool)
        inside = np.isfinite(value)
        if inside.any():
            predicted = self.predict_many(theta[inside])
            constant = -np.sum(np.log(self.std)) - 0.5 * self.std.size * np.log(2 * np.pi)
            value[inside] += constant - 0.5 * self.misfit(predicted.response)
            fallback[inside] = predicted.fallback
        return value, fallback

    def with_model(self, model: Model) -> Problem:
        """The same problem answered by another model of the same modes, such as a reduced one."""
        return replace(self, model=model)

    def fingerprint(self) -> str:
        """A hash of model, prior, data and weights: two chains with the same one sample the same posterior."""
        digest = hashlib.sha256(self.model.fingerprint().encode())
        for array in (self.measured, self.std, *(g.rows.astype(np.int64) for g in self.groups)):
            digest.update(np.ascontiguousarray(array).tobytes())
        digest.update(repr((self.set_id, self.matching.measured, self.matching.n_mode)).encode())
        return digest.hexdigest()


def _ascending_in_groups(columns: np.ndarray, groups: tuple[ResponseGroup, ...]) -> np.ndarray:
    result, start = np.array(columns), 0
    for group in groups:
        k = group.basis.shape[1]
        result[start : start + k] = np.sort(result[start : start + k])
        start += k
    return result


def _align(shape: np.ndarray, basis: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Y T with T (n, k, k) that brings it closest to the basis X in the least-squares sense, T, and (Y^T Y)^-1.

    shape Y (n, n_row, k) and basis X (n_row, k), both over the rows' deviations.
    """
    # columns to unit length first: T is free, so this only helps the condition of Y^T Y
    size = np.linalg.norm(shape, axis=1, keepdims=True)
    unit = shape / size
    inverse = np.linalg.inv(np.swapaxes(unit, 1, 2) @ unit)
    inverse = inverse / (np.swapaxes(size, 1, 2) * size)
    turn = inverse @ (np.swapaxes(shape, 1, 2) @ basis)
    return shape @ turn, turn, inverse


def _align_derivative(shape, change, turn, inverse, residual) -> np.ndarray:
    """d(Y T) (n_row, k, n_param) from dY: (1 - P) dY T + Y (Y^T Y)^-1 dY^T R with the projector P and R = X - Y T."""
    moved = np.einsum("cjp,jk->ckp", change, turn)
    projected = np.einsum("cj,jl,dl,dkp->ckp", shape, inverse, shape, moved, optimize=True)
    turned = np.einsum("cj,jl,dlp,dk->ckp", shape, inverse, change, residual, optimize=True)
    return moved - projected + turned


def build_problem(
    model: Model,
    data: ModalData,
    *,
    set_id: str | None = None,
    weights: Weights | None = None,
    clusters: list[tuple[int, ...]] | None = None,
) -> Problem:
    """Match the set's modes with the model's at the initial parameters and collect its responses.

    `weights` default to the deviations in the file. `clusters` fixes which modes are compared as planes, so that many
    sets are treated alike. Raises InputError where a deviation is missing or no mode can be matched.
    """
    modal_set = data.set(set_id)
    weights = weights or Weights()
    rows = channel_rows(model, data.channels)
    solution = model.solve(model.parameters.initial, min(data.n_mode + SEARCH, model.n_available))
    matching = match(modal_set, solution, rows, labels=data.labels, clusters=clusters)
    labels = data.labels or tuple(f"mode {j + 1}" for j in range(data.n_mode))
    groups = tuple(
        _response_group(modal_set, list(group.measured), rows, weights, labels) for group in matching.groups
    )
    return Problem(
        model=model, set_id=modal_set.id, mode_labels=labels, matching=matching, groups=groups, weights=weights
    )


def _response_group(modal_set: ModalSet, members, rows, weights: Weights, labels) -> ResponseGroup:
    frequency = modal_set.frequency_hz[members]
    std = _frequency_std(modal_set, members, weights, labels)
    shape = rotate_to_real(modal_set.shape[:, members]).real
    kept = np.all(np.isfinite(shape), axis=1)
    shape = shape[kept]
    # scaled per mode to largest component 1 first, so that neither of a plane's shapes outweighs the other
    largest = np.max(np.abs(shape), axis=0)
    if np.any(largest == 0):
        raise InputError(f"set {modal_set.id}, {labels[members[0]]}", "its shape is zero everywhere",
                         "give the components, null where not measured")  # fmt: skip
    given = modal_set.shape_std[kept][:, members] / largest
    if np.any(given < 0):
        raise InputError(f"set {modal_set.id}, shape_std of {' and '.join(labels[j] for j in members)}",
                         "is negative", "give deviations, null where unknown")  # fmt: skip
    u, singular, v = np.linalg.svd(shape / largest, full_matrices=False)
    if len(members) == 1:
        basis, to_basis = shape / largest * np.sign(shape[np.argmax(np.abs(shape))]), np.eye(1)
    else:
        if singular[-1] < 1e-3 * singular[0]:
            raise InputError(
                f"set {modal_set.id}, {' and '.join(labels[j] for j in members)}",
                "their shapes are the same: they span no plane", "check that the modes are two different ones",
            )
        size = np.max(np.linalg.norm(u, axis=1))
        basis, to_basis = u / size, v.T / singular / size
    rule = weights.shape_factor * float(np.mean(std / frequency))
    sigma = np.full(len(basis), rule)
    if weights.shape_std and np.any(np.isfinite(given)):
        # deviations of the shapes carried to the basis; one per row, so that a turned basis has the same
        variance = np.mean(given**2 @ to_basis**2, axis=1)
        sigma = np.where(np.isfinite(variance), np.sqrt(variance), rule)
        sigma = np.maximum(sigma, weights.shape_floor)
    return ResponseGroup(
        frequency_hz=frozen_array(frequency), frequency_std_hz=frozen_array(std), rows=rows[kept],
        basis=frozen_array(basis), shape_std=frozen_array(sigma),
    )


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
                                 "give a share of the frequency, such as 0.015")  # fmt: skip
        return np.array(weights.frequency_cov)[members] * frequency
    std = modal_set.frequency_std_hz[members]
    for j, value in zip(members, std, strict=True):
        if not (np.isfinite(value) and value > 0):
            raise InputError(
                f"set {modal_set.id}, frequency_std_hz of {labels[j]}", "is missing or not above zero",
                "add it, or give --weights paper or --frequency-cov",
            )
    return std
