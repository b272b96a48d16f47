"""Whether a lowest frequency and an extent can be those of one structure, and places a model's, or a unit is wrong, or
another axis than z points upwards.

The product of the two is a speed, a share of that of waves in the material: 40 m/s for a jacket with its turbine, 50
for buildings, 100 for footbridges; a bar of steel alone has 1280, a quarter of the speed of sound in it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy import sparse

# m/s, wide on purpose
LEAST_SPEED, MOST_SPEED = 2.0, 500.0
# lowest frequency, Hz, where the extent is not known
LEAST_HZ, MOST_HZ = 0.02, 1000.0
# longer than structures are between their joints, higher than any (the tallest building has 828 m)
MOST_EXTENT_M, MOST_RISE_M = 3000.0, 1000.0
UNITS_ADVICE = ("check the units (N, m, kg, Pa: E in MPa makes 0.001 of it, densities or masses in t 32 times of it) "
                "and that K and M are not exchanged")
PLACES = {1e-3: "are the nodes' places in mm? they are to be in m", 1e3: "are the nodes' places a thousandth of m?"}
# a tower over rotor and nacelle: 0.8 to 2.4 of the reference turbines of 3.4 to 22 MW; in t they are a thousandth
FEW, MANY = 1 / 6, 12.0
# share of a row's stiffness below which a force is rounding
ROUNDING = 1e-6
# m in what places are stated in by mistake; share of them that then lie where the model has them, and that now may
UNITS_M = {"mm": 1e-3, "cm": 1e-2, "dm": 0.1, "feet": 0.3048}
FITTING, FITTING_NOW = 0.8, 0.5


def implausible_size(lowest_hz: float, extent_m: float = 0.0) -> str:
    """A sentence where the lowest frequency above zero is none of a structure, or none of one of this greatest extent
    (0: not known); empty where it may be."""
    if extent_m <= 0:
        usual = "" if LEAST_HZ <= lowest_hz <= MOST_HZ else f"{LEAST_HZ:g} to {MOST_HZ:g} Hz is usual for structures"
    elif LEAST_SPEED <= lowest_hz * extent_m <= MOST_SPEED:
        usual = implausible_extent(extent_m)
    else:
        usual = (f"{LEAST_SPEED / extent_m:.2g} to {MOST_SPEED / extent_m:.2g} Hz is usual for an extent of "
                 f"{extent_m:.3g} m")
    if not usual:
        return ""
    # a frequency that may be one, and places that are it in another unit
    likely = [words for factor, words in PLACES.items() if LEAST_HZ <= lowest_hz <= MOST_HZ and extent_m > 0
              and LEAST_SPEED <= lowest_hz * factor * extent_m <= MOST_SPEED and factor * extent_m <= MOST_EXTENT_M]
    return f"implausible: the lowest frequency is {lowest_hz:.3g} Hz; {usual}: {likely[0] if likely else UNITS_ADVICE}"


def implausible_extent(extent_m: float, rise_m: float = 0.0) -> str:
    """Words where a greatest extent, or one upwards, is none of a structure, '' where it may be."""
    if extent_m > MOST_EXTENT_M:
        return f"an extent of {extent_m:.3g} m is more than structures have"
    return f"a height of {rise_m:.4g} m is more than structures have" if rise_m > MOST_RISE_M else ""


def other_unit_words(distance_m: Callable[[float], np.ndarray], near_m: float) -> str:
    """A sentence where one factor brings sensors' places to within `near_m` of where the model has them, '' where they
    are there or none does. distance_m: of a factor, the distances (n,) of the places times it."""
    if np.mean(distance_m(1.0) <= near_m) >= FITTING_NOW:
        return ""
    asked = {size: f"in {name}? state metres" for name, size in UNITS_M.items()}
    asked |= {1 / size: f"is the model in {name}? it is to be in metres" for name, size in UNITS_M.items()}
    factor = min(asked, key=lambda f: float(np.median(distance_m(f))))
    if np.mean(distance_m(factor) <= near_m) < FITTING:
        return ""
    return f"places are {1 / factor:.4g} times the model's: {asked[factor]}"


def lying_words(stiffness: sparse.csc_array, position_m: np.ndarray, direction: np.ndarray) -> str:
    """A question where what holds a structure is in its lower half of y and on both sides of its middle in z, as many
    programs have y upwards; '' elsewhere. Of each row of the stiffness (n, n) the place (n, 3) and the direction (n,),
    0 to 2 of a translation. Moving the whole along an axis strains only what holds it."""
    held = np.zeros(len(direction), bool)
    for axis in range(3):
        moved = (direction == axis).astype(float)
        held |= (np.abs(stiffness @ moved) > ROUNDING * (abs(stiffness) @ moved)) & (moved > 0)
    moves = (direction >= 0) & (direction < 3)
    if not held.any():
        return ""
    (_, low_y, low_z), (_, high_y, high_z) = (end(position_m[moves], axis=0) for end in (np.min, np.max))
    y, z = position_m[held, 1], position_m[held, 2]
    if np.max(y) >= (low_y + high_y) / 2 or not np.min(z) < (low_z + high_z) / 2 < np.max(z):
        return ""
    return ("held at low y, on both sides of its middle in z: is y upwards there? z is here, in the names of modes and "
            "in what sensors feel of gravity; turn the model, or in model.npz give node_position_m as (z, x, y) and 1, "
            "2, 0, 4, 5, 3 for dof_direction 0 to 5")


def top_words(bodies: Sequence[tuple[str, float, float]], tower_kg: float, height_m: float) -> tuple[str, ...]:
    """Sentences on bodies on a tower (name, mass in kg, greatest inertia about its centre in kg m2): one whose inertia
    is more than a rotor's can be, as blades end above the ground and are no heavier outwards (length / sqrt 3
    from their root); all of them together beside the tower."""
    said = [f"{name}: {mass:g} kg with {inertia:g} kg m2 lie {(inertia / mass) ** 0.5:.3g} m from their centre, on a "
            f"tower of {height_m:.3g} m: give kg, not t" for name, mass, inertia in bodies
            if mass > 0 and inertia > mass * height_m**2 / 3]
    total = sum(mass for _, mass, _ in bodies)
    if total > 0 and not FEW < tower_kg / total < MANY:
        said.append(f"rotor and nacelle weigh {total:g} kg on a tower of {tower_kg:.3g} kg: give kg, not t, unless the "
                    "tower stands without them")
    return tuple(said)
