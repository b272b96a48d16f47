"""Which points are at one place, and which sensors at one height: by the size of what they stand on, as a bench is a
hundredth of a turbine; two that are near are one whatever digits their coordinates begin with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from probupdate.modal.sets import Sensor

# shares of the largest distance between sensors along an axis: 2 cm and 0.3 m on 100 m
SAME_PLACE, SAME_HEIGHT = 2e-4, 3e-3


def place_numbers(position: np.ndarray, near: float) -> np.ndarray:
    """(n,) numbers of the places of points (n, n_axis), counted in their order: points within `near` of another one of
    a place are there too."""
    pairs = cKDTree(position).query_pairs(near, output_type="ndarray")
    graph = sparse.coo_array((np.ones(len(pairs)), pairs.T), shape=(len(position),) * 2)
    return csgraph.connected_components(graph, directed=False)[1]


def sensors_by_place(sensors: Sequence[Sensor]) -> list[list[int]]:
    """Numbers of the sensors of each place, in the order of the first ones."""
    position = _positions(sensors)
    number = place_numbers(position, SAME_PLACE * _extent(position)) if len(position) else np.empty(0, int)
    return [np.flatnonzero(number == k).tolist() for k in range(number.max(initial=-1) + 1)]


def sensors_by_height(sensors: Sequence[Sensor]) -> list[list[int]]:
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
