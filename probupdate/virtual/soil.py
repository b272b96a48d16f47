"""The virtual turbine's soil and joints: laws of its own, in the range of the standards' but not equal to them.

Lateral: a hyperbolic p-y curve whose bearing factor grows smoothly with depth (Murff & Hamilton 1993),
initial stiffness STEEPNESS p_u / y_c. Axial: Randolph & Wroth 1978, 2 pi G / zeta. Tip: a rigid disc on an elastic
half space, 4 G R / (1 - nu), nu = 1/2. All take the clay of model.toml; G is RIGIDITY_INDEX s_u.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

STEEPNESS = 2.2
RIGIDITY_INDEX = 190.0
LOAD_TRANSFER = 4.0  # zeta = ln(r_m / r_0)


@dataclass(frozen=True, kw_only=True)
class Clay:
    """Undrained clay; depth below the (scoured) mudline in m, strengths in Pa, unit weight in N/m3."""

    strength_mudline_pa: float
    strength_gradient_papm: float
    unit_weight_npm3: float
    strain_50: float
    scour_m: float = 0.0

    def strength(self, depth_m: np.ndarray) -> np.ndarray:
        """s_u in Pa at depths (n,) below the present mudline: scour uncovers the soil that was there."""
        return self.strength_mudline_pa + self.strength_gradient_papm * (depth_m + self.scour_m)


def lateral_stiffness(clay: Clay, diameter_m: float, depth_m: np.ndarray) -> np.ndarray:
    """Initial p-y stiffness in N/m per m of pile, same shape as depth_m; zero above the mudline; bearing by
    Murff and Hamilton (1993)."""
    depth = np.maximum(depth_m, 0.0)
    strength = clay.strength(depth)
    # bearing factor 9 - 7 e^(-xi z/D) with xi = .25 + .05 lambda, lambda = s_u0 / (gradient D), at most .55
    growth = clay.strength_gradient_papm * diameter_m
    xi = 0.55 if growth <= 0 else min(0.25 + 0.05 * clay.strength_mudline_pa / growth, 0.55)
    bearing = np.minimum(9 - 7 * np.exp(-xi * depth / diameter_m) + clay.unit_weight_npm3 * depth / strength, 9.0)
    stiffness = STEEPNESS * bearing * strength / (2.5 * clay.strain_50)
    return np.where(depth_m > 0, stiffness, 0.0)


def axial_stiffness(clay: Clay, depth_m: np.ndarray) -> np.ndarray:
    """Initial t-z stiffness in N/m per m of pile, same shape as depth_m; zero above the mudline."""
    stiffness = 2 * np.pi * RIGIDITY_INDEX * clay.strength(np.maximum(depth_m, 0.0)) / LOAD_TRANSFER
    return np.where(depth_m > 0, stiffness, 0.0)


def tip_stiffness(clay: Clay, diameter_m: float, depth_m: float) -> float:
    """Initial q-z stiffness of the pile's tip in N/m."""
    return float(8 * RIGIDITY_INDEX * clay.strength(np.asarray(depth_m)) * diameter_m / 2)


def joint_flexibility(
    brace_m: float, chord_m: float, chord_thickness_m: float, angle: float, youngs_modulus_pa: float
) -> np.ndarray:
    """Fessler 1986 for a single brace: (6,) flexibilities along u, v, w, rx, ry (out of plane), rz (in plane).

    z is normal to the plane of brace and chord; `angle` between their axes in rad. Axial along the brace.
    """
    gamma, beta, sine = chord_m / (2 * chord_thickness_m), brace_m / chord_m, np.sin(angle)
    axial = 1.95 * gamma**2.15 * (1 - beta) ** 1.3 * sine**2.19 / (youngs_modulus_pa * chord_m)
    cube = youngs_modulus_pa * chord_m**3
    out_of_plane = 85.5 * gamma**2.2 * np.exp(-3.85 * beta) * sine**2.16 / cube
    in_plane = 134 * gamma**1.73 * np.exp(-4.52 * beta) * sine**1.22 / cube
    return np.array([axial, 0.0, 0.0, 0.0, out_of_plane, in_plane])
