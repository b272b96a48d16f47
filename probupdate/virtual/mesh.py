"""Collects nodes, element matrices and masses of the virtual turbine; turned into matrices once, at the end."""

from __future__ import annotations

import itertools

import numpy as np
from scipy import sparse

from probupdate.virtual import beam

LONGEST_M = {"leg": 1.75, "brace": 2.0, "pile": 1.0, "column": 1.0, "strut": 2.0, "tie": 2.0, "tower": 2.0}


class Mesh:
    """Six degrees of freedom a node. `coarseness` lengthens the longest elements."""

    def __init__(self, coarseness: float = 1.0):
        self.longest_m = {group: coarseness * length for group, length in LONGEST_M.items()}
        self.nodes: list[np.ndarray] = []
        self.found: dict[tuple, int] = {}
        self.part: dict[str, list[int]] = {}
        self.blocks: list[tuple[np.ndarray, np.ndarray]] = []
        self.mass_blocks: list[tuple[int, np.ndarray]] = []
        self.elements: list[tuple[int, int, beam.Tube]] = []

    def node(self, position) -> int:
        key = tuple(np.round(position, 6))
        if key not in self.found:
            self.found[key] = len(self.nodes)
            self.nodes.append(np.asarray(position, float))
        return self.found[key]

    def member(self, start, end, group, section, *, at=(), ends=(None, None), inner=None, beside=None, part=None):
        """A straight member cut at the fractions `at` and to the longest element -> node numbers along it.

        section(position, half height) -> Tube; ends: flexibility (6,) at its first and last node; inner: flexibility
        above a node, by its level.
        """
        start, end = np.asarray(start, float), np.asarray(end, float)
        stops = sorted({0.0, 1.0, *(round(float(t), 9) for t in at if 1e-6 < t < 1 - 1e-6)})
        length = np.linalg.norm(end - start)
        cuts = [0.0]
        for a, b in itertools.pairwise(stops):
            n = max(1, int(np.ceil((b - a) * length / self.longest_m[group] - 1e-9)))
            cuts.extend(a + (b - a) * np.arange(1, n + 1) / n)
        numbers = [self.node(start + t * (end - start)) for t in cuts]
        for k, (i, j) in enumerate(itertools.pairwise(numbers)):
            a, b = self.nodes[i], self.nodes[j]
            tube = section(0.5 * (a + b), 0.5 * abs(b[2] - a[2]))
            axes, step = beam.local_axes(a, b, beside)
            local = beam.local_stiffness(tube, step)
            first = ends[0] if k == 0 else None
            last = ends[1] if k == len(numbers) - 2 else None
            if inner and first is None:
                first = inner.get(round(float(a[2]), 6))
            if first is not None or last is not None:
                local = beam.soften_ends(local, np.zeros(6) if first is None else first,
                                         np.zeros(6) if last is None else last)
            self.blocks.append((self._dofs(i, j), beam.to_global(local, axes)))
            half = beam.lumped_mass(tube, step, axes)
            self.mass_blocks += [(i, half), (j, half)]
            self.elements.append((i, j, tube))
        if part is not None:
            self.part.setdefault(part, []).extend(numbers)
        return numbers

    @staticmethod
    def _dofs(*numbers: int) -> np.ndarray:
        return np.concatenate([6 * n + np.arange(6) for n in numbers])

    def point_mass(self, number: int, mass_kg: float) -> None:
        self.mass_blocks.append((number, np.diag([mass_kg] * 3 + [0.0] * 3)))

    def spring(self, number: int, translational: np.ndarray) -> None:
        """translational (3,) in N/m along x, y, z."""
        self.blocks.append((self._dofs(number), np.diag([*translational, 0.0, 0.0, 0.0])))

    def spring_along(self, number: int, direction: np.ndarray, stiffness: float, other: int | None = None) -> None:
        """A spring in N/m along a unit direction (3,), from a node to the ground or to another node."""
        own = stiffness * np.outer(direction, direction)
        if other is None:
            self.blocks.append((6 * number + np.arange(3), own))
            return
        dofs = np.concatenate([6 * number + np.arange(3), 6 * other + np.arange(3)])
        self.blocks.append((dofs, np.block([[own, -own], [-own, own]])))

    def nearest(self, among: list[int], point: np.ndarray) -> int:
        return among[int(np.argmin(np.linalg.norm(np.array([self.nodes[n] for n in among]) - point, axis=1)))]

    def matrices(self) -> tuple[sparse.csc_array, sparse.csc_array]:
        size = 6 * len(self.nodes)

        def build(blocks):
            rows = np.concatenate([np.repeat(d, len(d)) for d, _ in blocks])
            columns = np.concatenate([np.tile(d, len(d)) for d, _ in blocks])
            values = np.concatenate([m.ravel() for _, m in blocks])
            return sparse.coo_array((values, (rows, columns)), shape=(size, size)).tocsc()

        return build(self.blocks), build([(self._dofs(n), m) for n, m in self.mass_blocks])
