"""Where a point of a turbine is, in words: leg, face and bay, monopile, transition piece, tower."""

from __future__ import annotations

import math

import numpy as np

from probupdate.structure.description import Description, JacketTurbine, MonopileTurbine
from probupdate.structure.effects import bay_at
from probupdate.structure.jacket_frame import leg_point

# a point within this share of the legs' spacing of a leg's axis is on it, and so for the axis of the tower
NEAR_AXIS = 0.15
# points nearer to one another than this share of the structure's extent are one
SAME_PLACE = 0.012


def decimals(length_m: float) -> int:
    """With how many decimals lengths are written of which such a one shows; at least one."""
    return max(1, math.ceil(-math.log10(length_m))) if 0 < length_m < math.inf else 1


def coordinates(point: np.ndarray, digits: int) -> str:
    """"(0.0, 2.5, 12.0) m" of a point (3,) in m."""
    # no minus before a zero
    return "({}) m".format(", ".join(f"{round(float(v), digits) + 0.0:.{digits}f}" for v in point))


def place_of(d: Description, point: np.ndarray) -> str:
    """"leg A, z = -3.0 m", "face AB, bay 2", "monopile, z = 2.0 m", "tower, z = 42.0 m"; empty where none of these is
    near. point (3,) in m."""
    x, y, z = (float(v) for v in point)
    extent = max(station.z_m for station in d.tower.station) - _lowest_m(d)
    level, wide = f"z = {z:.{decimals(SAME_PLACE * extent)}f} m", d.tower.station[0].diameter_m
    if isinstance(d, JacketTurbine):
        if found := _jacket_place(d, x, y, z, level):
            return found
        wide = NEAR_AXIS * d.jacket.top.leg_spacing_m
    if np.hypot(x, y) >= wide:
        return ""
    if z >= d.tower.station[0].z_m:
        return f"tower, {level}"
    on_pile = isinstance(d, MonopileTurbine) and (d.transition_piece is None or z < d.transition_piece.bottom_m)
    return f"{'monopile' if on_pile else 'transition piece'}, {level}"


def _lowest_m(d: Description) -> float:
    """Of what stands above the ground."""
    if isinstance(d, JacketTurbine):
        return d.jacket.bottom.z_m
    return d.site.mudline_m if isinstance(d, MonopileTurbine) else d.tower.station[0].z_m


def _jacket_place(d: JacketTurbine, x: float, y: float, z: float, level: str) -> str:
    if not d.jacket.bottom.z_m - 1e-6 <= z <= d.jacket.top.z_m + 1e-6:
        return ""
    legs = np.array([leg_point(d, k, z) for k in range(len(d.jacket.leg_names))])
    near = NEAR_AXIS * float(np.linalg.norm(legs[0] - legs[1]))
    away = np.linalg.norm(legs[:, :2] - [x, y], axis=1)
    if away.min() < near:
        return f"leg {d.jacket.leg_names[int(np.argmin(away))]}, {level}"
    bay = bay_at(d, z)
    for face, first, second in zip(d.jacket.faces, legs, (*legs[1:], legs[0]), strict=True):
        way = (second - first)[:2]
        off = np.array([x, y]) - first[:2]
        if bay is not None and abs(way[0] * off[1] - way[1] * off[0]) / np.linalg.norm(way) < near:
            return f"face {face}, bay {bay}"
    return ""
