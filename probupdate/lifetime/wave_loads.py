"""Where waves load the wet members, and the motion of the water there (Airy 1845)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from probupdate.lifetime.conditions import wave_number
from probupdate.lifetime.details import Detail
from probupdate.runtime.arrays import frozen_array
from probupdate.structure import beam as beams
from probupdate.structure.assembly import node_dofs
from probupdate.structure.description import MonopileTurbine, Offshore
from probupdate.structure.frame import Beam, Frame

# points of Gauss and Legendre along an element under water: at least three, and so many metres each; the shortest waves
# are 4.3 m long
LEAST_POINTS, POINT_EVERY_M = 3, 1.2


@dataclass(frozen=True, eq=False, kw_only=True)
class Waves:
    """Points of the wet members: position_m, along (n_point, 3), diameter_m with growth and length_m that each stands
    for (n_point,); spread (n_free, 3 n_point): forces at the points as loads on the free degrees of freedom; of_details
    (3 n_detail, 3 n_point): what they take from a detail's member forces."""

    position_m: np.ndarray
    along: np.ndarray
    diameter_m: np.ndarray
    length_m: np.ndarray
    spread: sparse.csr_array
    of_details: sparse.csr_array

    def normal_velocity(
        self, frequency_hz: np.ndarray, heading_deg: float, depth_m: float, gravity: float, still_m: float
    ):
        """(n_point, 3, n_frequency), complex, across the member per metre of amplitude; e^(i omega t), Airy."""
        omega = 2 * np.pi * frequency_hz
        k = wave_number(omega, depth_m, gravity)
        z = self.position_m[:, 2:] - still_m
        up, down = np.exp(k * z), np.exp(-k * (z + 2 * depth_m))
        whole = 1 - np.exp(-2 * k * depth_m)
        way = np.array([np.cos(np.radians(heading_deg)), np.sin(np.radians(heading_deg))])
        turn = omega * np.exp(-1j * k * (self.position_m[:, :2] @ way)[:, None])
        flat, rise = turn * (up + down) / whole, 1j * turn * (up - down) / whole
        v = np.stack([flat * way[0], flat * way[1], rise], axis=1)
        return v - self.along[:, :, None] * np.einsum("pi,pif->pf", self.along, v)[:, None, :]


def waves_on_turbine(
    d: Offshore, frame: Frame, transform, details: Sequence[Detail], values: Mapping[str, float]
) -> Waves:
    """Of a turbine's members below the still water level; transform: from the frame's degrees of freedom to the free
    ones. values: of all parameters, by name."""
    still, growth = d.site.water_level_m, float(values["mg"])
    of_beam: dict[int, list[int]] = {}
    for row, detail in enumerate(details):
        of_beam.setdefault(detail.number, []).append(row)
    position, along, diameter, length, blocks, own = [], [], [], [], [], []
    for number, b in enumerate(frame.beams):
        start, end = frame.node_m[b.start], frame.node_m[b.end]
        if not _is_in_waves(d, b, 0.5 * (start[2] + end[2])) or 0.5 * (start[2] + end[2]) >= still:
            continue
        span = end - start
        size = float(np.linalg.norm(span))
        axes = beams.axes(start, end)
        grown = 0.5 * (start[2] + end[2]) < d.hydrodynamics.growth_top_m
        outer = float(b.tube.outer(values)) + (2 * growth if grown else 0.0)
        root, share = np.polynomial.legendre.leggauss(max(LEAST_POINTS, int(np.ceil(size / POINT_EVERY_M))))
        for xi, weight in zip(0.5 * (1 + root), 0.5 * share, strict=True):
            # nodal loads that do the work of a force at xi (Bernoulli-Euler shapes)
            local = beams.interpolation(float(xi), size)[:3].T @ axes
            nodal = np.kron(np.eye(4), axes).T @ local
            column = len(position)
            blocks.append((node_dofs(b.start, b.end), 3 * column + np.arange(3), nodal))
            own += [
                (3 * row + np.arange(3), 3 * column + np.arange(3), details[row].rows() @ nodal)
                for row in of_beam.get(number, ())
            ]
            position.append(start + xi * span)
            along.append(span / size)
            diameter.append(outer)
            length.append(weight * size)
    n = 3 * len(position)
    spread = placed_blocks(blocks, (transform.shape[0], n))
    return Waves(
        position_m=frozen_array(np.array(position).reshape(-1, 3)),
        along=frozen_array(np.array(along).reshape(-1, 3)),
        diameter_m=frozen_array(diameter),
        length_m=frozen_array(length),
        spread=sparse.csr_array(transform.T @ spread),
        of_details=placed_blocks(own, (3 * len(details), n)),
    )


def _is_in_waves(d: Offshore, b: Beam, z_m: float) -> bool:
    """Legs and braces, or what of a monopile stands free; where a sleeve is around it, the sleeve."""
    if not isinstance(d, MonopileTurbine):
        return b.group in ("leg", "brace")
    sleeve = d.transition_piece
    inside = sleeve is not None and b.group == "pile" and z_m > sleeve.bottom_m
    return b.group in ("pile", "column") and b.springs is None and not inside


def placed_blocks(blocks, shape) -> sparse.csr_array:
    if not blocks:
        return sparse.csr_array(shape)
    rows = np.concatenate([np.repeat(r, len(c)) for r, c, _ in blocks])
    columns = np.concatenate([np.tile(c, len(r)) for r, c, _ in blocks])
    values = np.concatenate([m.ravel() for _, _, m in blocks])
    return sparse.csr_array(sparse.coo_array((values, (rows, columns)), shape=shape))
