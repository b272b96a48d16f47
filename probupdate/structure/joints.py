"""Local flexibility of tubular joints: a registry of laws from chord and brace geometry to three flexibilities.

A law takes chord and brace diameter, chord wall and the angle between the axes and returns flexibility times E for
(force along the brace, in-plane bending, out-of-plane bending). It sees one brace at a time: what another brace at
the same node does to the chord wall is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from probupdate.errors import InputError

JointLaw = Callable[..., np.ndarray]


def fessler(chord_diameter_m, chord_wall_m, brace_diameter_m, angle_rad: float) -> np.ndarray:
    """(..., 3): E x flexibility along the brace (1/m), in plane and out of plane (1/m^3), of a joint of one brace
    (Fessler, Mockford and Webster 1986).

    The axial one is along the brace, hence sin^2.19 where the chord-normal one has sin^0.19.
    """
    gamma, beta = chord_diameter_m / (2 * chord_wall_m), brace_diameter_m / chord_diameter_m
    sine = np.sin(angle_rad)
    axial = 1.95 * gamma**2.15 * (1 - beta) ** 1.3 * sine**2.19 / chord_diameter_m
    in_plane = 134.0 * gamma**1.73 * np.exp(-4.52 * beta) * sine**1.22 / chord_diameter_m**3
    out_of_plane = 85.5 * gamma**2.2 * np.exp(-3.85 * beta) * sine**2.16 / chord_diameter_m**3
    return np.stack(np.broadcast_arrays(axial, in_plane, out_of_plane), axis=-1)


# None stands for a rigid joint: brace axes meet the chord axis without springs
LAWS: Mapping[str, JointLaw | None] = MappingProxyType({"fessler": fessler, "rigid": None})


def joint_law(name: str, laws: Mapping[str, JointLaw | None] = LAWS) -> JointLaw | None:
    if name not in laws:
        raise InputError("jacket.joints.law", f"'{name}' is unknown", f"choose from {', '.join(laws)}")
    return laws[name]


def release_directions(chord: np.ndarray, brace: np.ndarray) -> np.ndarray:
    """(3, 6): the brace end's motions relative to the chord that the law softens, from unit axes in space.

    Along the brace; rotation about the normal of the plane of both axes (in plane); rotation about the axis in that
    plane perpendicular to the brace (out of plane).
    """
    normal = np.cross(chord, brace)
    normal /= np.linalg.norm(normal)
    zero = np.zeros(3)
    return np.array([[*brace, *zero], [*zero, *normal], [*zero, *np.cross(brace, normal)]])
