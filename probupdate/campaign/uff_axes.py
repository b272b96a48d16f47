"""Units, nodes and coordinate systems of a universal file (datasets 164, 15 or 2411, 18 or 2420): places in m and
components in the file's own axes, whatever local axes its nodes have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from probupdate.errors import InputError, parsing

NODES, UNITS, SYSTEMS = (15, 2411), 164, (18, 2420)
# kinds of coordinate systems
CARTESIAN, CYLINDRICAL = 0, 1
# systems that refer to one another
DEEPEST = 32
# of what is taken for three axes
SQUARE = 1e-4


@dataclass(frozen=True, eq=False, kw_only=True)
class System:
    """axes (3, 3): its directions as rows, in the file's axes; origin (3,) in m."""

    kind: int
    axes: np.ndarray
    origin: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class Geometry:
    """places: node -> (3,) in m, in the file's axes; turns: node -> (3, 3) directions of its components, as rows;
    length_m: the file's unit of length, None where it is not stated."""

    places: Mapping[int, np.ndarray] = field(default_factory=dict)
    turns: Mapping[int, np.ndarray] = field(default_factory=dict)
    length_m: float | None = None

    def axes_at(self, node: int) -> np.ndarray:
        """(3, 3) the directions of the components at a node, as rows."""
        return self.turns.get(node, np.eye(3))


def number_of(value: Any, where: str, what: str) -> float:
    """A finite number, whatever the parser made of it."""
    with parsing(where, f"its {what} is not a number", "write it again"):
        number = float(np.real(value))
    if not np.isfinite(number):
        raise InputError(where, f"its {what} is {number}", "write it again")
    return number


def whole_of(value: Any, where: str, what: str) -> int:
    number = number_of(value, where, what)
    if number != int(number) or abs(number) >= 2**53:
        raise InputError(where, f"its {what} is {number:g}, not a whole number", "write it again")
    return int(number)


def geometry(path: Path, found: Sequence[Mapping]) -> Geometry:
    """Of all datasets of a file. Raises InputError for a system that is not there, or whose axes are none."""
    length = _length(path, found)
    scale = 1.0 if length is None else length
    written = _systems(path, found)
    systems = {number: _resolve_system(path, number, written, scale, 0) for number in written}
    places, turns, asked = {}, {}, set()
    for d in found:
        if d.get("type") not in NODES:
            continue
        rows = [np.atleast_1d(d.get(key, ())) for key in ("node_nums", "def_cs", "disp_cs", "x", "y", "z")]
        for number, of_place, of_motion, *xyz in zip(*rows, strict=False):
            node = whole_of(number, f"{path}, nodes", "number")
            where = f"{path}, node {node}"
            of_place, of_motion = (whole_of(v, where, "coordinate system") for v in (of_place, of_motion))
            asked |= {of_place, of_motion}
            at = np.array([number_of(v, where, "position") for v in xyz])
            places[node] = _position_in_system(at * _lengths(systems.get(of_place), scale), systems.get(of_place))
            turns[node] = _axes_at(where, places[node], systems.get(of_motion))
    unknown = sorted(asked - set(systems) - {0})
    # where all share one that is nowhere defined it is the file's own; beside others it is not known what it is
    if unknown and len(asked) > 1:
        raise InputError(str(path), f"nodes are in coordinate system {unknown[0]}, which the file does not define",
                         "export the coordinate systems too (dataset 18 or 2420), or all in the global one")
    return Geometry(places=places, turns=turns, length_m=length)


def _length(path: Path, found: Sequence[Mapping]) -> float | None:
    """m per unit of length; the dataset has its inverse."""
    units = [d for d in found if d.get("type") == UNITS]
    if not units:
        return None
    factor = number_of(units[-1].get("length"), f"{path}, units (dataset {UNITS})", "length factor")
    if not 1e-6 < factor < 1e9:
        raise InputError(f"{path}, units (dataset {UNITS})", f"its length factor is {factor:g}", "write it again")
    return 1 / factor


def _systems(path: Path, found: Sequence[Mapping]) -> dict[int, tuple[int, int, np.ndarray, np.ndarray]]:
    """Number -> (kind, number of what it refers to, origin, axes as rows), as written."""
    systems = {}
    for d in found:
        where = f"{path}, coordinate systems"
        if d.get("type") == 18:
            rows = zip(*(np.atleast_1d(d.get(k, ())) for k in ("cs_num", "cs_type", "ref_cs_num")),
                       *(np.reshape(d.get(k, ()), (-1, 3)) for k in ("ref_o", "x_point", "xz_point")), strict=False)
            for number, kind, other, origin, on_x, on_xz in rows:
                axes = _axes_from_vectors(where, np.array(on_x, float) - origin, np.array(on_xz, float) - origin)
                systems[whole_of(number, where, "number")] = (
                    whole_of(kind, where, "kind"), whole_of(other, where, "reference"), np.array(origin, float), axes)
        elif d.get("type") == 2420:
            rows = zip(*(d.get(k, ()) for k in ("CS_sys_labels", "CS_types", "CS_matrices")), strict=False)
            for number, kind, matrix in rows:
                matrix = np.asarray(matrix, float)
                if matrix.shape != (4, 3) or not np.abs(matrix[:3] @ matrix[:3].T - np.eye(3)).max() < SQUARE:
                    raise InputError(where, f"system {number} has no three axes of length 1 at right angles",
                                     "write it again")
                systems[whole_of(number, where, "number")] = (whole_of(kind, where, "kind"), 0, matrix[3], matrix[:3])
    return systems


def _axes_from_vectors(where: str, x: np.ndarray, on_xz: np.ndarray) -> np.ndarray:
    """(3, 3) axes as rows from a vector along x and one in the plane of x and z, on its side of z."""
    y = np.cross(on_xz, x)
    if not np.linalg.norm(y) > 1e-9 * max(np.linalg.norm(x) * np.linalg.norm(on_xz), 1e-300):
        raise InputError(where, "three points of a system lie on a line", "write it again")
    x, y = x / np.linalg.norm(x), y / np.linalg.norm(y)
    return np.array([x, y, np.cross(x, y)])


def _resolve_system(path: Path, number: int, written: Mapping, scale: float, depth: int) -> System:
    kind, other, origin, axes = written[number]
    if kind not in (CARTESIAN, CYLINDRICAL):
        raise InputError(f"{path}, coordinate system {number}", "is spherical or unknown",
                         "export motions in Cartesian axes")
    if other == 0:
        return System(kind=kind, axes=axes, origin=origin * scale)
    if other not in written or depth > DEEPEST:
        raise InputError(f"{path}, coordinate system {number}", f"refers to {other}, which cannot be resolved",
                         "export the systems that it refers to")
    base = _resolve_system(path, other, written, scale, depth + 1)
    if base.kind != CARTESIAN:
        raise InputError(f"{path}, coordinate system {number}", "refers to one that is not Cartesian",
                         "define it in the global one")
    return System(kind=kind, axes=axes @ base.axes, origin=base.origin + origin * scale @ base.axes)


def _lengths(system: System | None, scale: float) -> np.ndarray:
    """What a node's three coordinates are multiplied with: the second of a cylinder is an angle."""
    return np.array([scale, 1.0 if system is not None and system.kind == CYLINDRICAL else scale, scale])


def _position_in_system(at: np.ndarray, system: System | None) -> np.ndarray:
    if system is None:
        return at
    if system.kind == CYLINDRICAL:
        angle = np.radians(at[1])
        at = np.array([at[0] * np.cos(angle), at[0] * np.sin(angle), at[2]])
    return system.origin + at @ system.axes


def _axes_at(where: str, place: np.ndarray, system: System | None) -> np.ndarray:
    if system is None:
        return np.eye(3)
    if system.kind == CARTESIAN:
        return system.axes
    out = system.axes @ (place - system.origin)
    radius = float(np.hypot(out[0], out[1]))
    if not radius > 0:
        raise InputError(where, "lies on the axis of its cylindrical coordinate system, where no radius has a "
                         "direction", "export its motion in Cartesian axes")
    c, s = out[0] / radius, out[1] / radius
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ system.axes
