"""Blocks described by themselves: their mean modes as reference, residuals from it, what each sensor effect would do.

No model is asked. The axes of a close pair are the directions in which the levels move to +x and +y, so that they stay
where the sensors are. What turns with the nacelle is taken up by low harmonics of its angle.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from probupdate.diagnosis.blocks import Blocks, SetFactors
from probupdate.diagnosis.mode_numbers import (
    Reference,
    modes_with,
    n_response,
    numbers_of_modes,
    stated_covariance_columns,
)
from probupdate.diagnosis.noise import Noise, estimate_noise
from probupdate.effects.catalogue import Effect
from probupdate.modal.modes import Sensor
from probupdate.runtime.arrays import frozen_array

# harmonics of the nacelle's angle are kept where they move by this share of the strongest; blocks asked for each
TURNING_SHARE, BLOCKS_A_COLUMN = 0.03, 3
# blocks of which the stated covariance is asked, twice as many at most
BLOCKS_STATED = 12
# blocks that are compared with one another, in time and memory by the square of their number
MOST_COMPARED = 500
# what a step of an effect moves the numbers by, and no more, is rounding
ROUNDING = 1e-12
# what lies across its axis but for this is compared too: a reversed channel may turn a mode so far
ACROSS = 0.01
# cosine from which two levels are said to move alike
AGREEING = 0.97


@dataclass(frozen=True, eq=False, kw_only=True)
class EmpiricalReference:
    """axes per group (n_channel, k); residuals per group (n_block, n_response), zero where not used; used per group
    (n_block,) bool; turning (n_block, n_turning) harmonics of the nacelle's angle, of mean zero; mean per group over
    all angles, as Reference."""

    axes: tuple[np.ndarray, ...]
    differences: tuple[np.ndarray, ...]
    used: tuple[np.ndarray, ...]
    turning: np.ndarray
    mean: tuple[Reference, ...]

    def nuisance(self, known: np.ndarray) -> np.ndarray:
        """(n_block, n_nuisance) along which any number may move: an offset, what turns, `known` (n_block, n_known)."""
        return np.column_stack([np.ones(len(known)), self.turning, known])


def look(
    blocks: Blocks, sensors: Sequence[Sensor] = (), time_profile: np.ndarray | None = None
) -> EmpiricalReference:
    """The blocks as their own reference. Where something is known to change by `time_profile` (n_block,), what is
    expected is what was before: where the time profile is zero. Modes that were found only after it say nothing of the
    change and are their own reference."""
    value = np.zeros(len(blocks)) if time_profile is None else time_profile
    turning = turning_columns(blocks.angle_deg)
    axes, differences, used, mean = [], [], [], []
    for q, group in enumerate(blocks.groups):
        there = np.flatnonzero(blocks.present[:, q])
        before = there[value[there] == 0]
        axes.append(mean_plane_axes(blocks.select_blocks(before if len(before) else there), q, sensors))
        members = list(group)
        y, independent = numbers_of_modes(
            blocks.frequency_hz[there][:, members], blocks.shape[there][:, :, members], axes[q], ACROSS)
        # a pair that is not distinguished has shapes, but no tensor
        there, y = there[independent], y[independent]
        columns = np.column_stack([np.ones(len(there)), turning[there], value[there] * bool(len(before))])
        slope = np.linalg.lstsq(columns, y, rcond=None)[0]
        full = np.zeros((len(blocks), y.shape[1]))
        full[there] = y - slope[0]
        differences.append(frozen_array(full))
        ok = np.zeros(len(blocks), bool)
        ok[there] = True
        used.append(frozen_array(ok, bool))
        mean.append(modes_with(slope[0], axes[q]))
    return EmpiricalReference(axes=tuple(axes), differences=tuple(differences), used=tuple(used), turning=turning,
                              mean=tuple(mean))


def turning_columns(angle_deg: np.ndarray) -> np.ndarray:
    """(n_block, n) principal parts of cos, sin of the angle and of its double, as far as they move and blocks allow.

    To first order in what is not symmetric about the tower's axis, the mass of the nacelle gives just these.
    """
    angle = np.radians(angle_deg)
    columns = np.column_stack([np.cos(angle), np.sin(angle), np.cos(2 * angle), np.sin(2 * angle)])
    columns = columns - columns.mean(axis=0)
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    # a turn by less than two degrees is none
    kept = (size > TURNING_SHARE * size[0]) & (size > 0.01 * np.sqrt(len(angle)))
    kept &= np.arange(len(size)) < len(angle) // BLOCKS_A_COLUMN - 1
    return frozen_array(left[:, kept] * np.sqrt(len(angle)))


def mean_plane_axes(blocks: Blocks, q: int, sensors: Sequence[Sensor]) -> np.ndarray:
    """Real shapes (n_channel, k) that span a group's mean plane, largest component of each 1."""
    members = list(blocks.groups[q])
    there = np.flatnonzero(blocks.present[:, q])
    basis = np.linalg.qr(blocks.shape[there][:, :, members])[0]
    projectors = np.einsum("nck,ndk->ncd", basis, basis.conj()).real
    # of two states of a record, where a channel was reversed half-way, the mean is neither's: the half that is most
    # alike
    flat = projectors.reshape(len(there), -1)
    some = flat[np.linspace(0, len(there) - 1, min(len(there), MOST_COMPARED)).astype(int)]
    middle = some[np.argmax(np.median(some @ some.T, axis=1))]
    nearest = np.argsort(-(flat @ middle), kind="stable")[: (len(there) + 1) // 2]
    plane = np.linalg.eigh(projectors[nearest].sum(axis=0))[1][:, -len(members):]
    if len(members) == 2:
        turn = _to_axes(blocks.channels, sensors, plane)
        plane = plane if turn is None else plane @ turn
    # frequencies alone have no axes
    if not len(plane):
        return frozen_array(np.zeros((0, len(members))))
    # signs stay: the largest component may be a reversed sensor's
    return frozen_array(plane / np.max(np.abs(plane), axis=0))


def _to_axes(channels, sensors: Sequence[Sensor], plane: np.ndarray) -> np.ndarray | None:
    """(2, 2) that makes the plane's first vector move the levels to x and its second to y; None where they do not say.

    Each level moves by M = s T^-1, with its own s: the direction that the levels have in common, by rank one.
    """
    row = {c: k for k, c in enumerate(channels)}
    levels: dict[str, list[Sensor]] = {}
    for s in sensors:
        if s.channel in row and abs(s.direction[2]) < 0.3:
            levels.setdefault(s.level, []).append(s)
    motions = []
    for there in levels.values():
        direction = np.array([s.direction[:2] for s in there])
        if np.linalg.matrix_rank(direction, tol=0.3) == 2:
            moved = (np.linalg.pinv(direction) @ plane[[row[s.channel] for s in there]]).ravel()
            # every level has one vote, however far it moves
            motions.append(moved / np.linalg.norm(moved))
    if not motions:
        return None
    # one that is reversed, or near a node, is not asked: the largest number of levels that agree decides
    alike = np.abs(np.array(motions) @ np.array(motions).T) > AGREEING
    agreed = np.array(motions)[alike[np.argmax(alike.sum(axis=1))]]
    common = np.linalg.svd(agreed)[2][0].reshape(2, 2)
    return None if np.linalg.cond(common) > 20 else np.linalg.inv(common)


def signatures(effects: Sequence[Effect], empirical: EmpiricalReference) -> np.ndarray:
    """(n_response of all groups, n_effect): change per unit of each effect of sensors."""
    result = []
    for axes, mean in zip(empirical.axes, empirical.mean, strict=True):
        table = np.zeros((n_response(axes.shape[1], len(axes)), len(effects)))
        # frequencies alone have no sensors
        if effects and len(axes):
            frequency, vector = mean.members
            shape, middle = mean.shape @ vector, float(np.exp(np.trace(mean.tensor) / len(mean.tensor)))
            seen = [e.observation(shape, middle, sign * e.step_of_size) for e in effects for sign in (1, -1)]
            y, _ = numbers_of_modes(np.array([frequency * np.exp(shift) for _, shift in seen]),
                                    np.array([x for x, _ in seen]), axes)
            step, moved = np.array([e.step_of_size for e in effects]), y[0::2] - y[1::2]
            # the gain of a single channel changes no shape but by rounding
            table = (np.where(np.abs(moved) > ROUNDING, moved, 0.0) / (2 * step[:, None])).T
        result.append(table)
    return np.concatenate(result)


def stated_patterns(blocks: Blocks, empirical: EmpiricalReference) -> list[np.ndarray | None]:
    """Per group the mean over blocks, a dozen or two of many, of what the identification says its responses' covariance
    is, None without."""
    result: list[np.ndarray | None] = []
    for q, group in enumerate(blocks.groups):
        members, number = list(group), 0
        total = np.zeros((empirical.differences[q].shape[1],) * 2)
        used = np.flatnonzero(empirical.used[q])
        used = used[:: max(1, len(used) // BLOCKS_STATED)]
        for b in used:
            d = blocks.factors[b]
            if d is None:
                continue
            ln_frequency, shape = d.read()
            columns = stated_covariance_columns(blocks.frequency_hz[b, members], blocks.shape[b][:, members],
                                                ln_frequency[members], shape[:, members], empirical.axes[q])
            if columns is not None:
                total, number = total + columns.T @ columns, number + 1
        result.append(total / number if number > len(used) / 2 else None)
    return result


def residuals(empirical: EmpiricalReference, known: np.ndarray) -> tuple[np.ndarray, ...]:
    """Residuals per group without what the nacelle's angle and `known` (n_block, n_known) explain.

    Response by response: as a signature turns with the nacelle too, its product with them is not a low harmonic.
    """
    columns, rest = empirical.nuisance(known), []
    for y, ok in zip(empirical.differences, empirical.used, strict=True):
        slope = np.linalg.lstsq(columns[ok], y[ok], rcond=None)[0]
        rest.append(np.where(ok[:, None], y - columns @ slope, 0.0))
    return tuple(rest)


def scatter_noise(
    blocks: Blocks, empirical: EmpiricalReference, rest: tuple[np.ndarray, ...], stated: Sequence[np.ndarray | None]
) -> Noise:
    """Scatter of a block by its residuals `rest`; `stated` patterns of it.

    What ties frequencies to shapes is left out: a real change moves both, in a proportion that noise does not have.
    """
    sizes = tuple(len(g) for g in blocks.groups)
    return drop_cross_covariance(estimate_noise(rest, empirical.used, sizes, blocks.relative_std, blocks.states(),
                                                stated,
                                std_alone=blocks.std_alone), sizes)


def drop_cross_covariance(noise: Noise, sizes: Sequence[int]) -> Noise:
    """Without covariances between frequencies and shapes."""
    covariances = []
    for k, covariance in zip(sizes, noise.covariance, strict=True):
        of_shape = np.arange(len(covariance)) >= (1 if k == 1 else 3)
        covariances.append(frozen_array(np.where(of_shape[:, None] == of_shape[None, :], covariance, 0.0)))
    precision = tuple(frozen_array(np.linalg.inv(c)) for c in covariances)
    return Noise(covariance=tuple(covariances), precision=precision, weight=noise.weight)


def correct_blocks(blocks: Blocks, effect: Effect, size: np.ndarray) -> Blocks:
    """The blocks as sensors without `effect` had seen them; size (n_block,). Such effects are linear in shapes. What is
    stated of how shapes scatter goes with them."""
    shape, frequency, stated = np.array(blocks.shape), np.array(blocks.frequency_hz), list(blocks.factors)
    centre = np.nanmedian(frequency, axis=0)
    n_channel = shape.shape[1]
    for value in np.unique(size[size != 0]):
        there, whole = size == value, np.zeros((shape.shape[2], n_channel, n_channel), complex)
        for group in blocks.groups:
            members = list(group)
            near = float(np.exp(np.mean(np.log(centre[members]))))
            seen, shift = effect.observation(np.eye(n_channel, dtype=complex), near, float(value))
            rows = np.ix_(there, np.arange(n_channel), members)
            back = whole[members] = np.linalg.inv(seen)
            shape[rows] = np.einsum("cd,bdk->bck", back, np.nan_to_num(shape[rows])) + 0 * shape[rows]
            frequency[np.ix_(there, members)] *= np.exp(-shift)
        for b in np.flatnonzero(there):
            if (own := stated[b]) is not None:
                stated[b] = SetFactors(read=partial(_put_right, own.read, whole))
    return replace(blocks, shape=frozen_array(shape, complex), frequency_hz=frozen_array(frequency),
                   factors=tuple(stated))


def _put_right(read: Callable[[], tuple[np.ndarray, np.ndarray]], back: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """back (n_mode, n_channel, n_channel): of each mode's shape."""
    ln_frequency, shape = read()
    return ln_frequency, np.swapaxes(back @ np.swapaxes(shape, 0, 1), 0, 1)
