"""Stress concentration factors of simple tubular joints by Efthymiou's parametric equations.

Efthymiou, Development of SCF formulae and generalised influence functions for use in fatigue analysis (Recent
Developments in Tubular Joints Technology, Surrey 1988), as DNV-RP-C203 (2011), appendix B, tables B-1 to B-3 print
them: T and Y joints with chord ends of stated fixity, X joints under balanced loads, K joints with a gap under balanced
axial load and unbalanced bending. Overlapped, stiffened, grouted and multiplanar joints are not in them.

beta = d / D, gamma = D / (2 T), tau = t / T, alpha = 2 L / D, zeta = g / D; D, T, L: the chord's, d, t: the brace's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# validity ranges: DNV-RP-C203, B.1
RANGES = {
    "beta": (0.2, 1.0),
    "tau": (0.2, 1.0),
    "gamma": (8.0, 32.0),
    "alpha": (4.0, 40.0),
    "theta": (20.0, 90.0),
    "zeta": (0.0, 1.0),
}
# a chord shorter than this many radii is stiffened by its ends
SHORT = 12.0
# fixity of a chord whose ends are fixed
FIXED = 0.5


@dataclass(frozen=True, kw_only=True)
class Geometry:
    """One brace on its chord; lengths in m, angle_deg between their axes, at most 90."""

    chord_diameter_m: float
    chord_wall_m: float
    chord_length_m: float
    brace_diameter_m: float
    brace_wall_m: float
    angle_deg: float

    @property
    def beta(self) -> float:
        return self.brace_diameter_m / self.chord_diameter_m

    @property
    def gamma(self) -> float:
        return self.chord_diameter_m / (2 * self.chord_wall_m)

    @property
    def tau(self) -> float:
        return self.brace_wall_m / self.chord_wall_m

    @property
    def alpha(self) -> float:
        return 2 * self.chord_length_m / self.chord_diameter_m

    @property
    def sine(self) -> float:
        return float(np.sin(np.radians(self.angle_deg)))


@dataclass(frozen=True, kw_only=True)
class SideFactors:
    """Of one side of a weld: axial load at crown and saddle, bending in plane (at the crown) and out of plane (at the
    saddle)."""

    axial_crown: float
    axial_saddle: float
    in_plane: float
    out_of_plane: float


def validity_violations(g: Geometry, gap_m: float | None = None) -> list[str]:
    """What of a joint lies outside the equations' ranges, in words; empty where nothing does."""
    values = {"beta": g.beta, "tau": g.tau, "gamma": g.gamma, "alpha": g.alpha, "theta": g.angle_deg}
    if gap_m is not None:
        values["zeta"] = gap_m / g.chord_diameter_m
    found = []
    for name, value in values.items():
        low, high = RANGES[name]
        # sizes in millimetres make a beta of 1 a little more
        if not low * (1 - 1e-9) <= value <= high * (1 + 1e-9):
            found.append(f"{name} = {value:.3g} is not within {low:g} to {high:g}")
    return found


def tee(g: Geometry, fixity: float) -> tuple[SideFactors, SideFactors]:
    """(chord, brace) of a T or Y joint, table B-1: axial equations 5, 6, 3, 7, in plane 8, 9, out of plane 10, 11.
    fixity C of the chord's ends: 0.5 fixed to 1 pinned."""
    b, c, t, a, s = g.beta, g.gamma, g.tau, g.alpha, g.sine
    double = float(np.sin(2 * np.radians(g.angle_deg)))
    chord_saddle = c * t**1.1 * (1.11 - 3 * (b - 0.52) ** 2) * s**1.6
    chord_saddle += 2 * (fixity - 0.5) * (0.8 * a - 6) * t * b**2 * np.sqrt(max(1 - b**2, 0.0)) * double**2
    chord_crown = c**0.2 * t * (2.65 + 5 * (b - 0.65) ** 2) + t * b * (0.5 * fixity * a - 3) * s
    brace_saddle = 1.3 + c * t**0.52 * a**0.1 * (0.187 - 1.25 * b**1.1 * (b - 0.96)) * s ** (2.7 - 0.01 * a)
    brace_crown = _crown(g) + b * t * (0.2 * fixity * a - 1.2)
    short = _short_axial(g, fixity)
    bent = c * t * b * (1.7 - 1.05 * b**3) * s**1.6 * _short_bending(g)
    return (
        _side(chord_crown, chord_saddle * short, _chord_in_plane(g), bent),
        _side(brace_crown, brace_saddle * short, _brace_in_plane(g), bent * _to_brace(g)),
    )


def cross(g: Geometry, fixity: float) -> tuple[SideFactors, SideFactors]:
    """(chord, brace) of an X joint under balanced axial load and bending, table B-2: 12 to 15, 8, 9, 16, 17. fixity of
    the chord's ends as for `tee`."""
    b, c, t, s = g.beta, g.gamma, g.tau, g.sine
    chord_saddle = 3.87 * c * t * b * (1.10 - b**1.8) * s**1.7
    chord_crown = c**0.2 * t * (2.65 + 5 * (b - 0.65) ** 2) - 3 * t * b * s
    brace_saddle = 1 + 1.9 * c * t**0.5 * b**0.9 * (1.09 - b**1.7) * s**2.5
    short = _short_axial(g, fixity)
    bent = c * t * b * (1.56 - 1.34 * b**4) * s**1.6 * _short_bending(g)
    return (
        _side(chord_crown, chord_saddle * short, _chord_in_plane(g), bent),
        _side(_crown(g), brace_saddle * short, _brace_in_plane(g), bent * _to_brace(g)),
    )


def kay(g: Geometry, other: Geometry, gap_m: float) -> tuple[SideFactors, SideFactors]:
    """(chord, brace) of brace g of a K joint with brace `other` across a gap, table B-3: balanced axial load 20, 21
    (one value all round), unbalanced bending in plane 8, 9 and out of plane 23, 24."""
    b, c, t, s = g.beta, g.gamma, g.tau, g.sine
    sines = sorted((s, other.sine))
    betas = sorted((b, other.beta))
    zeta = gap_m / g.chord_diameter_m
    axial = t**0.9 * c**0.5 * (0.67 - b**2 + 1.16 * b) * s * (sines[1] / sines[0]) ** 0.3 * (betas[1] / betas[0]) ** 0.3
    axial *= 1.64 + 0.29 * b**-0.38 * np.arctan(8 * zeta)
    brace_axial = 1 + axial * (1.97 - 1.57 * b**0.25) * t**-0.14 * s**0.7
    x = 1 + zeta * s / b
    bent = _bending_alone(g) * (1 - 0.08 * np.sqrt(other.beta * c) * np.exp(-0.8 * x))
    bent += (
        _bending_alone(other)
        * (1 - 0.08 * np.sqrt(b * c) * np.exp(-0.8 * x))
        * 2.05
        * np.sqrt(betas[1])
        * np.exp(-1.3 * x)
    )
    if g.alpha < SHORT:
        bent *= 1 - 1.07 * b**1.88 * np.exp(-0.16 * c**-1.06 * g.alpha**2.4)
    return (
        _side(axial, axial, _chord_in_plane(g), bent),
        _side(brace_axial, brace_axial, _brace_in_plane(g), bent * _to_brace(g)),
    )


def _side(crown: float, saddle: float, in_plane: float, out_of_plane: float) -> SideFactors:
    return SideFactors(
        axial_crown=float(crown), axial_saddle=float(saddle), in_plane=float(in_plane), out_of_plane=float(out_of_plane)
    )


def _crown(g: Geometry) -> float:
    return 3 + g.gamma**1.2 * (0.12 * np.exp(-4 * g.beta) + 0.011 * g.beta**2 - 0.045)


def _chord_in_plane(g: Geometry) -> float:
    return 1.45 * g.beta * g.tau**0.85 * g.gamma ** (1 - 0.68 * g.beta) * g.sine**0.7


def _brace_in_plane(g: Geometry) -> float:
    power = 1.09 - 0.77 * g.beta
    return 1 + 0.65 * g.beta * g.tau**0.4 * g.gamma**power * g.sine ** (0.06 * g.gamma - 1.16)


def _bending_alone(g: Geometry) -> float:
    return g.gamma * g.tau * g.beta * (1.7 - 1.05 * g.beta**3) * g.sine**1.6


def _to_brace(g: Geometry) -> float:
    return g.tau**-0.54 * g.gamma**-0.05 * (0.99 - 0.47 * g.beta + 0.08 * g.beta**4)


def _short_axial(g: Geometry, fixity: float) -> float:
    """F1 of fixed chord ends, F2 of all others."""
    if g.alpha >= SHORT:
        return 1.0
    b = g.beta
    if fixity == FIXED:
        return 1 - (0.83 * b - 0.56 * b**2 - 0.02) * g.gamma**0.23 * np.exp(-0.21 * g.gamma**-1.16 * g.alpha**2.5)
    return 1 - (1.43 * b - 0.97 * b**2 - 0.03) * g.gamma**0.04 * np.exp(-0.71 * g.gamma**-1.38 * g.alpha**2.5)


def _short_bending(g: Geometry) -> float:
    """F3."""
    if g.alpha >= SHORT:
        return 1.0
    return 1 - 0.55 * g.beta**1.8 * g.gamma**0.16 * np.exp(-0.49 * g.gamma**-0.89 * g.alpha**1.8)
