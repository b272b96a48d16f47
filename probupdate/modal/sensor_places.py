"""Which sensors are at one place, and which at one height: by the size of what they stand on, as a bench is a hundredth
of a turbine; two that are near are one whatever digits their coordinates begin with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from probupdate.modal.sets import Sensor

# shares of the largest distance between sensors along an axis: 2 cm and 0.3 m on 100 m
SAME_PLACE, SAME_HEIGHT = 2e-4, 3e-3


def at_one_place(sensors: Sequence[Sensor]) -> list[list[int]]:
    """Numbers of the sensors of each place, in the order of the first ones."""
    position = _positions(sensors)
    near = np.linalg.norm(position[:, None] - position[None], axis=2) <= SAME_PLACE * _extent(position)
    left, found = list(range(len(position))), []
    while left:
        there = {left[0]}
        while more := set(np.flatnonzero(near[sorted(there)].any(axis=0)).tolist()) - there:
            there |= more
        found.append(sorted(there))
        left = [k for k in left if k not in there]
    return found


def at_one_height(sensors: Sequence[Sensor]) -> list[list[int]]:
    """Numbers of the sensors of each height, the lowest first."""
    position = _positions(sensors)
    if not len(position):
        return []
    order = np.argsort(position[:, 2], kind="stable")
    rises = np.diff(position[order, 2]) > SAME_HEIGHT * _extent(position)
    return [sorted(one.tolist()) for one in np.split(order, np.flatnonzero(rises) + 1)]


def _positions(sensors: Sequence[Sensor]) -> np.ndarray:
    return np.array([s.position_m for s in sensors], float).reshape(-1, 3)


def _extent(position: np.ndarray) -> float:
    return float(np.ptp(position, axis=0).max(initial=0.0)) if len(position) else 0.0
