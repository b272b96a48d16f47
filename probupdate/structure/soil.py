"""Clay after API RP 2GEO (2011): p-y (static), t-z and q-z curves and their initial (secant) stiffness.

Depths in m below the present seabed; every function takes complex arguments, as derivatives go by complex steps.
Strengths in Pa, curves per metre of pile where it says so.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# tabulated curves: p / pu at y / y_c; t / t_max at z / D; Q / Q_p at z / D
PY = ((0.0, 0.1, 0.3, 1.0, 3.0, 8.0), (0.0, 0.23, 0.33, 0.5, 0.72, 1.0))
TZ = ((0.0, 0.0016, 0.0031, 0.0057, 0.008, 0.01), (0.0, 0.30, 0.50, 0.75, 0.90, 1.0))
QZ = ((0.0, 0.002, 0.013, 0.042, 0.073, 0.1), (0.0, 0.25, 0.5, 0.75, 0.9, 1.0))


@dataclass(frozen=True, kw_only=True)
class Clay:
    """Undrained strength linear with depth below the *original* mudline; the rest constant."""

    submerged_unit_weight_npm3: float
    strength_at_mudline_pa: float
    strength_gradient_papm: float
    strain_50: float
    matlock_j: float

    def strength(self, depth_below_mudline):
        """s_u in Pa; scour removes soil but does not weaken what stays."""
        return self.strength_at_mudline_pa + self.strength_gradient_papm * depth_below_mudline


def lesser(a, b):
    """Minimum by the real parts, as needed under a complex step."""
    return np.where(np.real(a) <= np.real(b), a, b)


def ultimate_lateral(clay: Clay, diameter_m, depth, scour=0.0):
    """p_u in N per metre of pile: min(3 s_u + g' z + J s_u z / D, 9 s_u) D (Matlock 1970; API RP 2GEO)."""
    strength, z = clay.strength(depth), depth - scour
    wedge = 3 * strength + clay.submerged_unit_weight_npm3 * z + clay.matlock_j * strength * z / diameter_m
    return lesser(wedge, 9 * strength) * diameter_m


def reference_deflection(clay: Clay, diameter_m):
    """y_c = 2.5 epsilon_50 D."""
    return 2.5 * clay.strain_50 * diameter_m


def lateral_stiffness(clay: Clay, diameter_m, depth, scour=0.0):
    """Initial k in N/m per metre of pile: the secant to the first tabulated point, 2.3 p_u / y_c.

    The cube-root curve itself starts with an infinite slope. `depth` counts from the original mudline; general
    scour takes the overburden of the removed layer away.
    """
    secant = PY[1][1] / PY[0][1]
    return secant * ultimate_lateral(clay, diameter_m, depth, scour) / reference_deflection(clay, diameter_m)


def shaft_friction(clay: Clay, depth, scour=0.0):
    """t_max in Pa: alpha s_u with alpha = 0.5 psi^-0.5 (psi <= 1) or 0.5 psi^-0.25, at most 1; psi = s_u / sigma'_v."""
    strength = clay.strength(depth)
    overburden = clay.submerged_unit_weight_npm3 * (depth - scour)
    # alpha s_u, which is defined where clay has no strength
    soft = np.real(strength) <= np.real(overburden)
    friction = 0.5 * np.where(soft, np.sqrt(strength * overburden), strength**0.75 * overburden**0.25)
    return lesser(friction, strength)


def axial_stiffness(clay: Clay, depth, scour=0.0):
    """Initial k in N/m per metre of pile: secant to the first t-z point times the circumference; D cancels."""
    return TZ[1][1] / TZ[0][1] * np.pi * shaft_friction(clay, depth, scour)


def tip_stiffness(clay: Clay, diameter_m: float, depth: float) -> float:
    """Initial k in N/m of the pile tip: secant to the first q-z point, Q_p = 9 s_u A of the plugged pile."""
    capacity = 9 * clay.strength(depth) * np.pi * diameter_m**2 / 4
    return QZ[1][1] * capacity / (QZ[0][1] * diameter_m)


def clip_real(value, low: float, high: float):
    """value clipped to [low, high] by its real part; at the bounds only the upper one is exclusive, so that the
    derivative of a mudline that lies on a node is counted in one element."""
    value = np.asarray(value)
    value = np.where(np.real(value) >= high - 1e-12, high, value)
    return np.where(np.real(value) < low - 1e-12, low, value)


@dataclass(frozen=True, eq=False, kw_only=True)
class PileSprings:
    """Winkler springs of a vertical pile as moments of their density over each element, for scour (...).

    diameter_m (n_element,); top_depth_m (n_element,): depth of each element's upper end below the original mudline,
    negative above it; length_m (n_element,). xi = 0 at the upper end. Each is a picklable function of the scour depth.
    """

    clay: Clay
    diameter_m: tuple[float, ...]
    top_depth_m: tuple[float, ...]
    length_m: tuple[float, ...]

    def exposed_share(self, scour):
        """(..., n_element): xi of the present seabed in each element, 0 fully buried, 1 fully exposed."""
        top, length = np.array(self.top_depth_m), np.array(self.length_m)
        return clip_real((np.asarray(scour)[..., None] - top) / length, 0.0, 1.0)

    def exposed_moments(self, scour):
        """(..., n_element, 7): int xi^m dx over the part above the seabed, m = 0..6."""
        edge = self.exposed_share(scour)[..., None]
        order = np.arange(1, 8)
        return np.array(self.length_m)[:, None] * edge**order / order

    def _moments(self, density, scour, n_moment: int):
        # xi = edge + (1 - edge) s^4: the shaft friction starts like the fourth root of depth, smooth in s
        s, weight = np.polynomial.legendre.leggauss(20)
        s, weight = 0.5 * (s + 1), 0.5 * weight
        edge = self.exposed_share(scour)[..., None]
        xi = edge + (1 - edge) * s**4
        top, length = np.array(self.top_depth_m)[:, None], np.array(self.length_m)[:, None]
        depth = top + xi * length
        scour = np.asarray(scour)[..., None, None]
        buried = np.real(edge) < 1
        # an element wholly above the seabed has no spring; its depth is set to any legal one
        depth = np.where(buried, depth, scour + 1.0)
        step = np.where(buried, weight * 4 * s**3 * (1 - edge) * length, 0.0)
        value = density(depth, scour) * step
        return np.stack([np.sum(value * xi**m, axis=-1) for m in range(n_moment)], axis=-1)

    def lateral_moments(self, scour):
        """(..., n_element, 7): int k_y xi^m dx in N/m."""
        diameter = np.array(self.diameter_m)[:, None]
        return self._moments(lambda z, sc: lateral_stiffness(self.clay, diameter, z, sc), scour, 7)

    def axial_moments(self, scour):
        """(..., n_element, 3): int k_z xi^m dx in N/m."""
        return self._moments(lambda z, sc: axial_stiffness(self.clay, z, sc), scour, 3)
