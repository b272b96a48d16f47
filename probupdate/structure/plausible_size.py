"""Whether a lowest frequency and an extent can be those of one structure, or a unit is wrong.

The product of the two is a speed, a share of that of waves in the material: 40 m/s for a jacket with its turbine, 50
for buildings, 100 for footbridges; a bar of steel alone has 1280, a quarter of the speed of sound in it.
"""

from __future__ import annotations

# m/s, wide on purpose
LEAST_SPEED, MOST_SPEED = 2.0, 500.0
# lowest frequency, Hz, where the extent is not known
LEAST_HZ, MOST_HZ = 0.02, 1000.0
# longer than structures are between their joints
MOST_EXTENT_M = 3000.0
UNITS_ADVICE = ("check the units (N, m, kg, Pa: E in MPa makes 0.001 of it, densities or masses in t 32 times of it) "
                "and that K and M are not exchanged")
PLACES = {1e-3: "are the nodes' places in mm? they are to be in m", 1e3: "are the nodes' places a thousandth of m?"}


def implausible_size(lowest_hz: float, extent_m: float = 0.0) -> str:
    """A sentence where the lowest frequency above zero is none of a structure, or none of one of this greatest extent
    (0: not known); empty where it may be."""
    if extent_m <= 0:
        usual = "" if LEAST_HZ <= lowest_hz <= MOST_HZ else f"{LEAST_HZ:g} to {MOST_HZ:g} Hz is usual for structures"
    elif LEAST_SPEED <= lowest_hz * extent_m <= MOST_SPEED:
        usual = "" if extent_m <= MOST_EXTENT_M else f"an extent of {extent_m:.3g} m is more than structures have"
    else:
        usual = (f"{LEAST_SPEED / extent_m:.2g} to {MOST_SPEED / extent_m:.2g} Hz is usual for an extent of "
                 f"{extent_m:.3g} m")
    if not usual:
        return ""
    # a frequency that may be one, and places that are it in another unit
    likely = [words for factor, words in PLACES.items() if LEAST_HZ <= lowest_hz <= MOST_HZ and extent_m > 0
              and LEAST_SPEED <= lowest_hz * factor * extent_m <= MOST_SPEED and factor * extent_m <= MOST_EXTENT_M]
    return f"implausible: the lowest frequency is {lowest_hz:.3g} Hz; {usual}: {likely[0] if likely else UNITS_ADVICE}"
