"""Numbers of modes, measured or expected: frequencies, the tensor of a close pair, aligned complex shapes.

A single mode gives ln f and its shape, scaled by one complex number. A close pair gives the tensor R diag(ln f) R^T in
fixed axes (it is smooth where the two frequencies meet, the single modes are not) and its two shapes combined linearly.
Shapes are estimated from fixed shapes of the group's own, its axes (n_channel, k), real and with largest components of
one: S (A^+ S)^-1 - A is what lies outside their plane, real parts first, then imaginary parts. A residual is the
difference of measured and expected numbers, so that neither rescales the other's scatter.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from probupdate.errors import ConvergenceError
from probupdate.runtime.arrays import frozen_array

# a measured pair whose shapes are nearer to each other than this (smallest singular value of the unit shapes' frame)
# does not give its tensor: what the noise does to it grows with the square of one over this
INDEPENDENCE = 0.5
# modes whose ln f differ by less are equal but for rounding
EQUAL = 1e-9
ACROSS = "a mode shape of the model is orthogonal to the measured one that it is paired with"


@dataclass(frozen=True, eq=False, kw_only=True)
class Reference:
    """Expected modes of one group: tensor (k, k) of ln f in the axes of `shape` (n_channel, k), possibly complex; of n
    blocks with n in front."""

    tensor: np.ndarray
    shape: np.ndarray

    @cached_property
    def members(self) -> tuple[np.ndarray, np.ndarray]:
        """Frequency (k,) of each of its modes, and their directions (k, k), columns, in the axes. A clock or a filter
        turns the phase of each by its own frequency: at 54 ms two that are 4 % apart differ by more than noise."""
        log, turn = np.linalg.eigh(self.tensor)
        return np.exp(log), turn


def n_response(k: int, n_channel: int) -> int:
    """Numbers a group of k modes gives."""
    return (1 if k == 1 else 3) + 2 * n_channel * k


def labels_of(names: str, k: int, channels: tuple[str, ...]) -> tuple[str, ...]:
    """What each response of a group is, in order."""
    tensor = (f"ln f {names}",) if k == 1 else tuple(f"ln f {names} {part}" for part in ("11", "22", "12"))
    shapes = tuple(f"{part} {names} {i + 1} {c}" for part in ("shape", "phase") for i in range(k) for c in channels)
    return tensor + shapes


def tensor_numbers(tensor: np.ndarray) -> np.ndarray:
    """(..., k, k) symmetric -> (..., 1 or 3), so that squares add up to the tensor's."""
    if tensor.shape[-1] == 1:
        return tensor[..., 0]
    return np.stack([tensor[..., 0, 0], tensor[..., 1, 1], np.sqrt(0.5) * (tensor[..., 0, 1] + tensor[..., 1, 0])], -1)


def _stack(tensor: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """tensor (..., k, k) and complex shape parts (..., n_channel, k) as numbers."""
    *lead, n_channel, k = shape.shape
    flat = np.swapaxes(shape, -1, -2).reshape(*lead, n_channel * k)
    return np.concatenate([tensor_numbers(tensor), np.real(flat), np.imag(flat)], axis=-1)


def _inverse(shape: np.ndarray) -> np.ndarray:
    """Pseudo-inverse (k, n_channel) of (n_channel, k) with columns far from alike."""
    return np.linalg.solve(shape.T.conj() @ shape, shape.T.conj())


def directions_in(axes: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """(n, k, k) unit directions, columns, of complex shapes (n, n_channel, k) in the plane of the axes (n_channel, k),
    each along its own main phase."""
    in_plane = _inverse(axes) @ shape
    turned = in_plane * np.exp(-0.5j * np.angle(np.sum(in_plane**2, axis=1)))[:, None, :]
    return turned.real / np.linalg.norm(turned.real, axis=1, keepdims=True)


def independence(directions: np.ndarray) -> np.ndarray:
    """(n,) how far directions (n, k, k) are from one: their smallest singular value."""
    return np.linalg.svd(directions, compute_uv=False)[:, -1]


def numbers_of_modes(
    frequency_hz: np.ndarray, shape: np.ndarray, axes: np.ndarray, least: float = INDEPENDENCE
) -> tuple[np.ndarray, np.ndarray]:
    """Of n blocks, frequency_hz (n, k) and complex shape (n, n_channel, k) with the group's axes (n_channel, k) -> (n,
    n_response) and independent (n,) bool: False where the pair's shapes are too alike to say anything, or a single one
    lies across its axis (by `least`); zero there."""
    k = frequency_hz.shape[1]
    log = np.log(frequency_hz)
    independent = np.ones(len(shape), bool)
    if not axes.size:
        # frequencies alone
        return log, independent
    in_plane = _inverse(axes) @ shape
    if k == 1:
        # a shape across the axis, scaled to it, would be as large as one over what is along it
        along = np.abs(in_plane[:, 0, 0]) * np.linalg.norm(axes)
        independent = along >= least * np.linalg.norm(shape[:, :, 0], axis=1)
        tensor = log[:, :, None]
    else:
        left, singular, right = np.linalg.svd(directions_in(axes, shape))
        independent = singular[:, -1] >= least
        turn = left @ right
        tensor = np.einsum("nik,nk,njk->nij", turn, log, turn)
    # what is not stated is not looked at; it may have no inverse
    in_plane = np.where(independent[:, None, None], in_plane, np.eye(k))
    aligned = np.swapaxes(np.linalg.solve(np.swapaxes(in_plane, 1, 2), np.swapaxes(shape, 1, 2)), 1, 2)
    result = _stack(tensor, aligned - axes)
    return np.where(independent[:, None], result, 0.0), independent


def numbers_of(reference: Reference, axes: np.ndarray) -> np.ndarray:
    """(n, n_response) of n blocks' expected modes. One that lies across the measured mode it is paired with is as far
    off as it is: it has no noise that its numbers would amplify, and one without numbers would explain any shape."""
    value, turn = np.linalg.eigh(reference.tensor)
    try:
        return numbers_of_modes(np.exp(value), reference.shape @ turn, axes, least=0.0)[0]
    except np.linalg.LinAlgError:
        raise ConvergenceError(ACROSS, axes) from None


def tensor_turn(shape: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """(3, 3) of a pair's tensor in the axes of its shapes (n_channel, 2) the numbers that it has in others: a turn of
    the plane, nearly the same for any tensor."""
    each = np.array([[[1.0, 0.0], [0.0, 0.0]], [[0.0, 0.0], [0.0, 1.0]], [[0.0, 1.0], [1.0, 0.0]]])
    each[2] *= np.sqrt(0.5)
    found = numbers_of(Reference(tensor=each, shape=np.broadcast_to(shape, (3, *shape.shape))), axes)
    return np.ascontiguousarray(found[:, :3].T)


def modes_with(numbers: np.ndarray, axes: np.ndarray) -> Reference:
    """The inverse, of one block's numbers (n_response,)."""
    k = axes.shape[1]
    n_log = 1 if k == 1 else 3
    tensor = np.array([[numbers[0]]]) if k == 1 else np.array(
        [[numbers[0], np.sqrt(0.5) * numbers[2]], [np.sqrt(0.5) * numbers[2], numbers[1]]])
    real, imaginary = np.split(numbers[n_log:], 2)
    return Reference(tensor=tensor, shape=axes + (real + 1j * imaginary).reshape(k, -1).T)


def signature(
    reference: Reference, tensor_change: np.ndarray, shape_change: np.ndarray, axes: np.ndarray
) -> np.ndarray:
    """First-order change of the numbers (..., n_response, n) with changes of the tensor (..., k, k, n) in the
    reference's own axes and of its shapes (..., n_channel, k, n), both without regard to what the alignment takes
    away; of a reference of as many places as stand in front."""
    if not axes.size:
        return frozen_array(_stack_columns(tensor_change, shape_change))
    onto = _inverse(axes)
    in_plane = onto @ reference.shape
    try:
        back = np.linalg.inv(in_plane)
    except np.linalg.LinAlgError:
        raise ConvergenceError(ACROSS, axes) from None
    plane_change = _times_columns(onto, shape_change)
    turning, aligned = _turn_columns(plane_change, back), _turn_columns(shape_change, back)
    outside = aligned - _times_columns(reference.shape @ back, turning)
    tensor = tensor_change
    if in_plane.shape[-1] > 1:
        tensor = _tensor_change(reference, tensor_change, in_plane, plane_change)
    return frozen_array(_stack_columns(tensor, outside))


def _stack_columns(tensor: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """`_stack` (..., n_response, n) of changes (..., k, k, n) and (..., n_channel, k, n)."""
    return np.swapaxes(_stack(np.moveaxis(tensor, -1, -3), np.moveaxis(shape, -1, -3)), -1, -2)


def _times_columns(matrix: np.ndarray, change: np.ndarray) -> np.ndarray:
    """(..., m, k, n) of matrix (..., m, l) and change (..., l, k, n)."""
    *lead, n_row, k, n = change.shape
    product = matrix @ change.reshape(*lead, n_row, k * n)
    return product.reshape(*product.shape[:-1], k, n)


def _turn_columns(change: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """(..., m, k, n) of change (..., m, k, n) of columns that are then multiplied with turn (..., k, k)."""
    return sum(change[..., [j], :] * turn[..., None, j, :, None] for j in range(turn.shape[-1]))


def _tensor_change(
    reference: Reference, tensor_change: np.ndarray, in_plane: np.ndarray, plane_change: np.ndarray
) -> np.ndarray:
    """(..., k, k, n) change of R diag(ln f) R^T, R the rotation nearest to the modes' directions (its polar factor, of
    which the derivative solves a Lyapunov equation; Higham, Functions of Matrices, 2008, ch. 8), with changes of the
    tensor in the reference's own axes and of its shapes in the plane (..., k, k, n)."""
    log, turn = np.linalg.eigh(reference.tensor)
    of_modes = np.einsum("...ia,...ijn,...jb->...abn", turn, tensor_change, turn)
    apart, itself = log[..., None, :] - log[..., None], np.eye(log.shape[-1])[:, :, None] > 0
    # modes turn by one over this, and the tensor by this times their turn: equal ones are as good as a little apart
    below = np.where(np.tri(log.shape[-1], k=-1) > 0, -1, 1)
    apart = np.where(np.abs(apart) < EQUAL, EQUAL * below, apart)[..., None]
    shape = in_plane @ turn
    change = _turn_columns(plane_change, turn) + _times_columns(shape, np.where(itself, 0.0, of_modes / apart))
    phase = np.exp(-0.5j * np.angle(np.sum(shape**2, axis=-2)))[..., None, :]
    shape, change = (shape * phase).real, (change * phase[..., None]).real
    length = np.linalg.norm(shape, axis=-2)[..., None, :]
    direction = shape / length
    along = np.sum(direction[..., None] * change, axis=-3, keepdims=True)
    change = (change - direction[..., None] * along) / length[..., None]
    left, singular, right = np.linalg.svd(direction)
    rotation = left @ right
    spin = np.einsum("...ia,...ijn,...bj->...abn", left, change, right)
    spin = (spin - np.swapaxes(spin, -3, -2)) / (singular[..., None] + singular[..., None, :])[..., None]
    spin = np.einsum("...ai,...abn,...bj->...ijn", right, spin, right)
    return np.einsum("...ia,...abn,...jb->...ijn", rotation, np.where(itself, of_modes, spin * apart), rotation)


def stated_covariance_columns(
    frequency_hz: np.ndarray, shape: np.ndarray, d_log: np.ndarray, d_shape: np.ndarray, axes: np.ndarray
) -> np.ndarray | None:
    """What the identification's standard deviations of one block, d_log (k, n) of ln f and d_shape (n_channel, k, n),
    make of its numbers (n, n_response); None where they are not known or the pair says nothing."""
    largest = max(np.max(np.abs(d_log), initial=0.0), np.max(np.abs(d_shape), initial=0.0))
    if not (np.isfinite(largest) and largest > 0):
        return None
    h = 1e-4 / largest
    (up, sure), (down, sure_too) = (
        numbers_of_modes(frequency_hz * np.exp(s * d_log.T), shape + s * d_shape.transpose(2, 0, 1), axes)
        for s in (h, -h)
    )
    return (up - down) / (2 * h) if sure.all() and sure_too.all() else None
