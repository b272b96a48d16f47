"""Masses that water and growth add to a member, per metre of its length.

Growth and flooding water move with the member but do not spin about its axis; added mass acts transverse to it only.
"""

from __future__ import annotations

import numpy as np


def added_mass(outer_m, growth_m, coefficient: float, water_density_kgpm3: float):
    """C_a rho_w pi D^2 / 4 in kg/m on the diameter D with growth, Morison's inertia term (DNV-RP-C205)."""
    return coefficient * water_density_kgpm3 * np.pi / 4 * (outer_m + 2 * growth_m) ** 2


def growth_mass(outer_m, growth_m, growth_density_kgpm3: float):
    """Mass of a ring of growth of the given thickness, kg/m."""
    return growth_density_kgpm3 * np.pi * growth_m * (outer_m + growth_m)


def flooding_mass(inner_m, water_density_kgpm3: float):
    """Mass of the water inside a flooded member, kg/m."""
    return water_density_kgpm3 * np.pi / 4 * inner_m**2
