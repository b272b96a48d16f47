"""Building blocks of model.toml's schema: strict tables and numbers."""

from __future__ import annotations

import difflib
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, Strict

Number = Annotated[float, Strict()]
Positive = Annotated[float, Strict(), Field(gt=0)]
NotNegative = Annotated[float, Strict(), Field(ge=0)]
# what no structural metal, water, soil or tube is beyond, wide on purpose: a value outside is in another unit. Of a
# key, or of a name wherever it stands; zero is each key's own
RANGES = {
    "steel.youngs_modulus_pa": (1e10, 1e12, "Pa: steel has 2.1e11"),
    "steel.density_kgpm3": (500.0, 25e3, "kg/m3: steel has 7850"),
    "site.water_density_kgpm3": (500.0, 5000.0, "kg/m3: sea water has 1025"),
    "site.gravity_mps2": (1.0, 30.0, "m/s2: 9.81 on this planet"),
    "site.mudline_m": (-1000.0, 1000.0, "m"),
    "transition_piece.grout.youngs_modulus_pa": (1e9, 1e11, "Pa: grout has 2e10 to 6e10"),
    "transition_piece.grout.density_kgpm3": (500.0, 25e3, "kg/m3: grout has 2400"),
    "soil.submerged_unit_weight_npm3": (1000.0, 25e3, "N/m3: clay has some 9000"),
    "soil.strain_50": (1e-3, 0.05, "strain: clay has 0.004 to 0.02, which is 0.4 to 2 per cent"),
    "soil.matlock_j": (0.1, 2.0, "Matlock's J: 0.25 to 0.5"),
    "hydrodynamics.added_mass_coefficient": (0.1, 4.0, "the displaced mass: a cylinder has 1"),
    "hydrodynamics.growth_density_kgpm3": (500.0, 3000.0, "kg/m3: marine growth has 1100 to 1400"),
    "jacket.first_leg_angle_deg": (-360.0, 360.0, "degrees"),
    "diameter_m": (0.005, 30.0, "m"),
    "thickness_m": (1e-4, 0.4, "m"),
    "leg_spacing_m": (0.05, 200.0, "m"),
    "z_m": (-1000.0, 1000.0, "m"),
    "tip_m": (-1000.0, 1000.0, "m"),
}
# of an isotropic material that does not grow thicker when it is pulled, as no structural one does
PoissonRatio = Annotated[float, Strict(), Field(ge=0, lt=0.5)]
Vector = tuple[Number, Number, Number]

# one mistake: key path, what is wrong, what to do
Mistake = tuple[str, str, str]


class Table(BaseModel):
    """A TOML table: no unknown keys, no infinities, not changed after it is read."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def suggest(name: str, known) -> str:
    """The remedy for an unknown name."""
    close = difflib.get_close_matches(name, list(known), n=1, cutoff=0.5)
    return f"did you mean '{close[0]}'?" if close else f"choose from {', '.join(sorted(known))}"
