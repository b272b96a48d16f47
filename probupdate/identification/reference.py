"""The modes of a model that identified poles are held against, as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from probupdate.errors import InputError
from probupdate.modes import Sensor, frozen_array


@dataclass(frozen=True, eq=False, kw_only=True)
class ReferenceModes:
    """Modes of interest: labels (FA1, SS1, ...), frequency_hz (n_mode,), shape (n_channel, n_mode) real, at the
    campaign's channels and in its quantity's proportions. `pairs`: modes so close that only their plane is told by
    the data; every other mode stands alone.
    """

    labels: tuple[str, ...]
    frequency_hz: np.ndarray
    shape: np.ndarray
    pairs: tuple[tuple[int, int], ...] = ()

    def __post_init__(self):
        frequency, shape = frozen_array(self.frequency_hz), frozen_array(self.shape)
        n_mode = len(self.labels)
        if n_mode == 0 or len(set(self.labels)) < n_mode:
            raise InputError("reference modes", f"labels {self.labels} are none or repeat", "give each mode one name")
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

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Pairs and single modes, by their first mode."""
        paired = {i for pair in self.pairs for i in pair}
        return tuple(sorted([*self.pairs, *((i,) for i in range(len(self.labels)) if i not in paired)]))

    def group_hz(self, group: tuple[int, ...]) -> float:
        return float(np.mean(self.frequency_hz[list(group)]))


def turned(reference: ReferenceModes, sensors: tuple[Sensor, ...], angle_deg: float) -> ReferenceModes:
    """The reference with every pair FAk, SSk turned in its plane by angle_deg, counter-clockwise seen from above.

    Fore-aft is where the nacelle looks: the model has it along x, a block at its heading. The plane stays the same;
    only which direction in it is called fore-aft turns. Pairs of other names stay.
    """
    shape = np.array(reference.shape)
    turn = np.radians(angle_deg)
    for first, second in reference.pairs:
        names = reference.labels[first], reference.labels[second]
        if {name[:2] for name in names} != {"FA", "SS"} or names[0][2:] != names[1][2:]:
            continue
        i, j = (first, second) if names[0].startswith("FA") else (second, first)
        fore, side = horizontal(shape[:, i], sensors), horizontal(shape[:, j], sensors)
        # side-side is to turn counter-clockwise from fore-aft at the levels that move
        sign = np.sign(np.sum(fore[:, 0] * side[:, 1] - fore[:, 1] * side[:, 0])) or 1.0
        a, s = np.array(shape[:, i]), sign * shape[:, j]
        s = s * np.linalg.norm(a) / np.linalg.norm(s)
        shape[:, i], shape[:, j] = np.cos(turn) * a + np.sin(turn) * s, np.cos(turn) * s - np.sin(turn) * a
    return replace(reference, shape=shape)


def horizontal(shape: np.ndarray, sensors: tuple[Sensor, ...]) -> np.ndarray:
    """(n_level, 2) mean horizontal motion of each level with both directions; shape (n_channel,)."""
    height = np.array([round(float(s.position_m[2]), 1) for s in sensors])
    direction = np.array([s.direction[:2] for s in sensors])
    found = []
    for z in np.unique(height):
        rows = np.flatnonzero(height == z)
        if np.linalg.matrix_rank(direction[rows], tol=0.1) == 2:
            found.append(np.linalg.lstsq(direction[rows], shape[rows], rcond=None)[0])
    return np.array(found).reshape(-1, 2)
