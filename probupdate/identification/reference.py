"""The modes that identified poles are held against, as plain arrays: a model's, or those the poles themselves show."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from probupdate.errors import InputError
from probupdate.modal.labels import about_vertical, is_along_x, label_across
from probupdate.modal.modes import Sensor
from probupdate.modal.sensor_places import sensors_by_height
from probupdate.runtime.arrays import frozen_array


@dataclass(frozen=True, eq=False, kw_only=True)
class ReferenceModes:
    """Modes of interest: labels (FA1, SS1, ...), frequency_hz (n_mode,), shape (n_channel, n_mode) real, at the
    campaign's channels and in its quantity's proportions. `pairs`: modes so close that only their plane is identified
    by the data; every other mode stands alone. turning: pairs (fore-aft, side-side) that turn with the nacelle;
    without, those labelled FAk, SSk. range_hz (n_mode, 2): where each mode's poles lie over the campaign, where known.
    """

    labels: tuple[str, ...]
    frequency_hz: np.ndarray
    shape: np.ndarray
    pairs: tuple[tuple[int, int], ...] = ()
    turning: tuple[tuple[int, int], ...] | None = None
    range_hz: np.ndarray | None = None

    def __post_init__(self):
        frequency, shape = frozen_array(self.frequency_hz), frozen_array(self.shape)
        n_mode = len(self.labels)
        if n_mode == 0 or len(set(self.labels)) < n_mode:
            raise InputError("reference modes", f"labels {self.labels} are empty or repeated",
                             "give each mode one name")
        if frequency.shape != (n_mode,) or not np.all(frequency > 0):
            raise InputError("reference modes", f"frequency_hz {self.frequency_hz} is not {n_mode} positive numbers",
                             "give one per label")
        if shape.ndim != 2 or shape.shape[1] != n_mode or not np.all(np.isfinite(shape)):
            raise InputError("reference modes", f"shape is {shape.shape} or holds NaN", f"give {n_mode} finite columns")
        members = [i for pair in self.pairs for i in pair]
        if len(set(members)) < len(members) or not set(members) <= set(range(n_mode)):
            raise InputError("reference modes", f"pairs {self.pairs} share a mode or name one that is not there",
                             "name each mode in one pair at most")
        object.__setattr__(self, "frequency_hz", frequency)
        object.__setattr__(self, "shape", shape)
        if self.range_hz is not None:
            span = frozen_array(self.range_hz)
            if span.shape != (n_mode, 2) or not np.all((span[:, 0] > 0) & (span[:, 0] <= span[:, 1])):
                raise InputError("reference modes", f"range_hz has shape {span.shape} or an empty range",
                                 f"give ({n_mode}, 2), the lower end first")
            object.__setattr__(self, "range_hz", span)
        if self.turning is None:
            labelled = (self._labelled_pair(pair) for pair in self.pairs)
            object.__setattr__(self, "turning", tuple(pair for pair in labelled if pair))

    def _labelled_pair(self, pair: tuple[int, int]) -> tuple[int, int] | None:
        """(along x, along y) of a pair whose labels say so: of a turbine (fore-aft, side-side)."""
        first, second = (self.labels[i] for i in pair)
        if label_across(first) != second or not about_vertical(first):
            return None
        return pair if is_along_x(first) else (pair[1], pair[0])

    def select(self, chosen, labels: tuple[str, ...] | None = None, *, number: bool = False) -> ReferenceModes:
        """The modes `chosen`, in that order; renumbered, or with `labels`. A pair that loses a mode is none."""
        chosen = [int(i) for i in chosen]
        place = {old: new for new, old in enumerate(chosen)}

        def renumber(pairs: tuple[tuple[int, int], ...]) -> tuple[tuple[int, int], ...]:
            return tuple((place[i], place[j]) for i, j in pairs if i in place and j in place)

        names = tuple(str(k + 1) for k in range(len(chosen))) if number else tuple(self.labels[i] for i in chosen)
        return ReferenceModes(
            labels=labels or names, frequency_hz=self.frequency_hz[chosen], shape=self.shape[:, chosen],
            pairs=tuple(sorted((min(pair), max(pair)) for pair in renumber(self.pairs))),
            turning=renumber(self.turning or ()),
            range_hz=None if self.range_hz is None else self.range_hz[chosen])

    def join(self, others: ReferenceModes) -> ReferenceModes:
        """These modes and after them the others."""
        n = len(self.labels)
        return ReferenceModes(
            labels=(*self.labels, *others.labels),
            frequency_hz=np.concatenate([self.frequency_hz, others.frequency_hz]),
            shape=np.concatenate([self.shape, others.shape], axis=1),
            pairs=(*self.pairs, *((i + n, j + n) for i, j in others.pairs)),
            turning=(*(self.turning or ()), *((i + n, j + n) for i, j in others.turning or ())))

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Pairs and single modes, by their first mode."""
        paired = {i for pair in self.pairs for i in pair}
        return tuple(sorted([*self.pairs, *((i,) for i in range(len(self.labels)) if i not in paired)]))

    def group_hz(self, group: tuple[int, ...]) -> float:
        return float(np.mean(self.frequency_hz[list(group)]))


def turn_reference(reference: ReferenceModes, sensors: tuple[Sensor, ...], angle_deg: float) -> ReferenceModes:
    """The reference with every turning pair turned in its plane by angle_deg, counter-clockwise seen from above.

    Fore-aft is where the nacelle looks: the reference has it along x, a block at its heading. The plane stays the same;
    only which direction in it is called fore-aft turns.
    """
    shape = np.array(reference.shape)
    turn = np.radians(angle_deg)
    for i, j in reference.turning or ():
        fore, side = horizontal(shape[:, i], sensors), horizontal(shape[:, j], sensors)
        # side-side is to turn counter-clockwise from fore-aft at the levels that move
        sign = np.sign(np.sum(fore[:, 0] * side[:, 1] - fore[:, 1] * side[:, 0])) or 1.0
        a, s = np.array(shape[:, i]), sign * shape[:, j]
        s = s * np.linalg.norm(a) / np.linalg.norm(s)
        shape[:, i], shape[:, j] = np.cos(turn) * a + np.sin(turn) * s, np.cos(turn) * s - np.sin(turn) * a
    return replace(reference, shape=shape)


def shapes_along_axes(plane: np.ndarray, sensors: tuple[Sensor, ...]) -> np.ndarray | None:
    """(n_channel, 2): of a plane (n_channel, 2) the shapes that move along x and along y; None where its motion is not
    horizontal in two directions, or no level has sensors in both."""
    motion = np.array([horizontal(column, sensors) for column in plane.T])  # (2, n_level, 2)
    if motion.shape[1] == 0:
        return None
    along = [np.linalg.svd(motion[:, :, 1 - axis].T)[2][-1] for axis in range(2)]
    axes = plane @ np.column_stack(along)
    size = np.array([np.linalg.norm(horizontal(column, sensors), axis=0) for column in axes.T])  # (shape, axis)
    across = np.array([size[0, 1], size[1, 0]]) / np.maximum(np.diag(size), 1e-300)
    least = 0.3 * np.linalg.norm(axes, axis=0) * np.sqrt(motion.shape[1] / len(plane))
    if np.any(across > 0.5) or np.any(np.diag(size) < least):
        return None
    # both with the sense of the largest horizontal motion along their axis: a quarter turn takes one to the other
    for axis in range(2):
        along_it = horizontal(axes[:, axis], sensors)[:, axis]
        axes[:, axis] *= np.sign(along_it[np.argmax(np.abs(along_it))])
    return axes / np.abs(axes).max(axis=0)


def heading_of_motion(shape: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """(n,) direction in rad, counter-clockwise from x and up to half a turn, of shapes (n_channel, n) in the plane of
    `axes` (`shapes_along_axes`): the phase of the first harmonic of their real coordinates."""
    size = np.linalg.norm(axes, axis=0)
    inside = np.linalg.lstsq(axes / size, shape, rcond=None)[0]
    inside = inside * np.exp(-0.5j * np.angle(np.sum(inside**2, axis=0)))
    return np.arctan2(inside[1].real, inside[0].real)


def horizontal(shape: np.ndarray, sensors: tuple[Sensor, ...]) -> np.ndarray:
    """(n_level, 2) mean horizontal motion of each level with both directions; shape (n_channel,)."""
    direction = np.array([s.direction[:2] for s in sensors])
    found = []
    for rows in sensors_by_height(sensors):
        if np.linalg.matrix_rank(direction[rows], tol=0.1) == 2:
            found.append(np.linalg.lstsq(direction[rows], shape[rows], rcond=None)[0])
    return np.array(found).reshape(-1, 2)
