"""Departures of measured modes from a reference: frequencies, the tensor of a close pair, aligned complex shapes.

A single mode gives ln f and its shape, scaled by one complex number to the reference. A close pair gives the tensor
R diag(ln f) R^T in the reference's fixed axes (it is smooth where the two frequencies meet, the single modes are not)
and its two shapes combined linearly to the reference's plane. Shape components are shares of each reference shape's
largest one (Reference.size); real parts first, then imaginary parts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probupdate.modes import frozen_array

# a measured pair whose shapes are nearer to each other than this (smallest singular value of the unit shapes' frame)
# does not tell its tensor: what the noise does to it grows with the square of one over this
INDEPENDENCE = 0.5


@dataclass(frozen=True, eq=False, kw_only=True)
class Reference:
    """Expected modes of one group: tensor (k, k) of ln f in the axes of `shape` (n_channel, k), possibly complex; of n
    blocks with n in front. `peak` (k,): largest component over length that the group's shapes are taken to have, None
    for this shape's own."""

    tensor: np.ndarray
    shape: np.ndarray
    peak: np.ndarray | None = None

    @property
    def size(self) -> np.ndarray:
        """(k,) what departures of the shape are shares of: its largest component, at a fixed ratio to its length. The
        component itself changes with the parameters by some per cent of the others, and all scatter would with it."""
        if self.peak is None:
            return np.max(np.abs(self.shape), axis=-2)
        return self.peak * np.linalg.norm(self.shape, axis=-2)


def peak_of(shape: np.ndarray) -> np.ndarray:
    """(k,) largest component over length of shapes (n_channel, k)."""
    return np.max(np.abs(shape), axis=0) / np.linalg.norm(shape, axis=0)


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


def _stack(tensor: np.ndarray, shape: np.ndarray, size: np.ndarray) -> np.ndarray:
    """tensor (..., k, k) and complex shape departures (..., n_channel, k) over the largest components (k,)."""
    scaled = np.swapaxes(shape / size, -1, -2)
    flat = scaled.reshape(*scaled.shape[:-2], -1)
    return np.concatenate([tensor_numbers(tensor), flat.real, flat.imag], axis=-1)


def _inverse(shape: np.ndarray) -> np.ndarray:
    """Pseudo-inverse (..., k, n_channel) of (..., n_channel, k) with columns far from alike."""
    own = np.swapaxes(shape, -1, -2).conj()
    return np.linalg.solve(own @ shape, own)


def departure(frequency_hz: np.ndarray, shape: np.ndarray, reference: Reference) -> tuple[np.ndarray, np.ndarray]:
    """Of n blocks, frequency_hz (n, k) and complex shape (n, n_channel, k) -> (n, n_response) and independent (n,)
    bool: False where the pair's shapes are too alike. One reference for all blocks, or one each."""
    k = frequency_hz.shape[1]
    target = reference.shape
    size = reference.size[..., None, :]
    in_plane = _inverse(target) @ shape
    log = np.log(frequency_hz)
    independent = np.ones(len(shape), bool)
    if k == 1:
        tensor = log[:, :, None]
    else:
        # each measured shape's direction in the plane, along its own main phase
        turned = in_plane * np.exp(-0.5j * np.angle(np.sum(in_plane**2, axis=1)))[:, None, :]
        axes = turned.real / np.linalg.norm(turned.real, axis=1, keepdims=True)
        left, singular, right = np.linalg.svd(axes)
        independent = singular[:, -1] > INDEPENDENCE
        turn = left @ right
        tensor = np.einsum("nik,nk,njk->nij", turn, log, turn)
    # what is not told is not looked at; it may have no inverse
    shape = np.where(independent[:, None, None], shape, target)
    projected = shape @ (_inverse(shape) @ target)
    return _stack(tensor - reference.tensor, projected - target, size), independent


def log_scales(shape: np.ndarray, reference: Reference) -> np.ndarray:
    """ln |d departure / d shape| of each block (n,) for shapes (n, n_channel, k), of each of the 2 (n_channel - k) real
    numbers that a shape has outside the plane."""
    onto = _inverse(shape) @ reference.shape
    return np.log(np.abs(np.linalg.det(onto))) - np.sum(np.log(reference.size), axis=-1)


def tensor_turning(target: np.ndarray, change: np.ndarray, tensor: np.ndarray) -> np.ndarray:
    """How the axes that sensors see turn with a shape change (n_channel, k, n) shifts the tensor -> (k, k, n)."""
    if target.shape[1] == 1:
        return np.zeros((1, 1, change.shape[2]))
    seen = np.einsum("kc,cjn->kjn", np.linalg.pinv(target), change).real
    spin = 0.5 * (seen - seen.transpose(1, 0, 2))
    return np.einsum("ijn,jk->ikn", spin, tensor) - np.einsum("ij,jkn->ikn", tensor, spin)


def fingerprint(reference: Reference, tensor_change: np.ndarray, shape_change: np.ndarray) -> np.ndarray:
    """First-order departure (n_response, n) for changes of the tensor (k, k, n) in the reference's axes and of the
    shapes (n_channel, k, n), both without regard to what the alignment takes away."""
    target = reference.shape
    tensor = tensor_change + tensor_turning(target, shape_change, reference.tensor)
    outside = shape_change - np.tensordot(target @ np.linalg.pinv(target), shape_change, 1)
    return frozen_array(_stack(tensor.transpose(2, 0, 1), outside.transpose(2, 0, 1), reference.size).T)
