"""The description of a turbine as model.toml states it: its tables, their keys and the values that each may have."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, Strict

from probupdate.modal.modes import Sensor
from probupdate.model.parameters import Parameters
from probupdate.structure.effect_kinds import EffectKeys
from probupdate.structure.parameter_table import KEYS, updated_parameters
from probupdate.structure.schema import NotNegative, Number, Positive, Table, Vector

Group = Literal["leg", "brace", "pile", "column", "strut", "tie", "tower"]

# Table 2 of the paper: name -> the value at which it leaves the described structure as it is; m_h stands for the
# mass of the body named "hub" and so has no such value
NEUTRAL = {
    "k_j": 1.0, "k_t": 1.0, "k_TP": 1.0, "k_p": 1.0, "LJF": 1.0, "D_l": 1.0, "t_l": 1.0, "D_b": 1.0, "t_b": 1.0,
    "sc": 0.0, "corr": 0.0, "mg": 0.0, "a_m": 1.0, "m_h": None, "py": 1.0, "tz": 1.0, "qw": 1.0,
}
# the lowest value each can take in any structure: factors must stay above zero, depths and thicknesses not below it
POSITIVE = ("k_j", "k_t", "k_TP", "k_p", "LJF", "D_l", "t_l", "D_b", "t_b", "m_h", "py", "tz", "qw")


class TubeEntry(Table):
    diameter_m: Positive
    thickness_m: Positive


class Site(Table):
    mudline_m: Number
    water_level_m: Number
    water_density_kgpm3: Positive
    gravity_mps2: Positive


class Steel(Table):
    youngs_modulus_pa: Positive
    poisson_ratio: Annotated[float, Strict(), Field(gt=-1, lt=0.5)]
    density_kgpm3: Positive


class Mesh(Table):
    theory: Literal["bernoulli-euler", "timoshenko"]
    geometric_stiffness: Annotated[bool, Strict()]
    elements_per_member: dict[Group,
                              Annotated[int, Strict(), Field(ge=1, le=200)]]


class Level(Table):
    z_m: Number
    leg_spacing_m: Positive


class Bay(Table):
    bottom_m: Number
    top_m: Number
    brace: TubeEntry


class Joints(Table):
    law: str


class Jacket(Table):
    leg_names: Annotated[tuple[str, ...], Field(min_length=3)]
    first_leg_angle_deg: Number
    bottom: Level
    top: Level
    leg: TubeEntry
    flooded: Annotated[bool, Strict()]
    bay: Annotated[tuple[Bay, ...], Field(min_length=1)]
    joints: Joints


class Hydrodynamics(Table):
    added_mass_coefficient: NotNegative
    growth_density_kgpm3: NotNegative
    growth_top_m: Number


class Corrosion(Table):
    bottom_m: Number
    top_m: Number


class Pile(Table):
    tip_m: Number
    diameter_m: Positive
    thickness_m: Positive
    flooded: Annotated[bool, Strict()]


class Strength(Table):
    at_mudline: Positive
    gradient_per_m: NotNegative


class Soil(Table):
    submerged_unit_weight_npm3: Positive
    undrained_shear_strength_pa: Strength
    strain_50: Positive
    matlock_j: NotNegative


class TransitionPiece(Table):
    column_bottom_m: Number
    column: TubeEntry
    strut_top_m: Number
    strut: TubeEntry
    tie: TubeEntry
    lumped_mass_kg: NotNegative


class Station(Table):
    z_m: Number
    diameter_m: Positive
    thickness_m: Positive
    flange_kg: NotNegative


class Tower(Table):
    secondary_steel_kgpm: NotNegative
    station: Annotated[tuple[Station, ...], Field(min_length=2)]


class Body(Table):
    name: str
    mass_kg: NotNegative
    offset_m: Vector
    inertia_kgm2: tuple[NotNegative, NotNegative, NotNegative]


class SensorEntry(Table):
    channel: str
    level: str
    part: str
    position_m: Vector
    direction: Vector
    quantity: Literal["acceleration", "velocity", "displacement"] = "acceleration"
    unit: str = "m/s2"
    # None: as the quantity has it
    gravity: Annotated[bool, Strict()] | None = None


class ParameterEntry(EffectKeys):
    name: str
    unit: str
    initial: Number
    cov: Positive | None = None
    std: Positive | None = None
    # unbounded ones are written inf and -inf in TOML
    lower: Annotated[float, Strict(), Field(allow_inf_nan=True)] = -np.inf
    upper: Annotated[float, Strict(), Field(allow_inf_nan=True)] = np.inf
    prior: Literal["normal", "lognormal", "uniform"] = "normal"
    update: Annotated[bool, Strict()] = True
    description: str = ""


class Description(Table):
    """model.toml of a turbine, checked. Lengths in m, z = 0 at mean sea level, masses in kg, stresses in Pa."""

    format: Literal[1]
    name: str
    site: Site
    steel: Steel
    mesh: Mesh
    jacket: Jacket
    hydrodynamics: Hydrodynamics
    corrosion: Corrosion
    pile: Pile
    soil: Soil
    transition_piece: TransitionPiece
    tower: Tower
    rna: Annotated[tuple[Body, ...], Field(min_length=1)]
    sensor: tuple[SensorEntry, ...] = ()
    parameter: Annotated[tuple[ParameterEntry, ...], Field(min_length=1)]
    correlation: dict[str, dict[str, Annotated[float, Strict(), Field(ge=-1, le=1)]]] | None = None

    @property
    def effects(self) -> tuple[ParameterEntry, ...]:
        """The parameters that act at a place of their own."""
        return tuple(p for p in self.parameter if p.kind is not None)

    @property
    def values(self) -> dict[str, float]:
        """All 17 parameters and the effects at the file's initial values; rows not listed act neutrally."""
        # a file without a hub is refused by a check, which comes after others that ask for values
        hub = next((body.mass_kg for body in self.rna if body.name == "hub"), 0.0)
        neutral = {name: hub if value is None else value for name, value in NEUTRAL.items()}
        return neutral | {p.name: p.initial for p in self.parameter}


def described_sensors(description: Description) -> tuple[Sensor, ...]:
    """The file's own sensors, which a campaign's may replace."""
    return tuple(Sensor(**s.model_dump(exclude={"part"})) for s in description.sensor)


def updated(description: Description, where: str) -> Parameters:
    """The parameters with update = true and their prior, in the file's order."""
    tables = [p.model_dump(exclude_none=True, include=set(KEYS)) for p in description.parameter]
    return updated_parameters(tables, where, description.correlation)
