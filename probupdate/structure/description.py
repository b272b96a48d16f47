"""The description of a turbine as model.toml states it: its tables, their keys and the values that each may have."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, ClassVar, Literal, TypeVar

import numpy as np
from pydantic import Field, Strict

from probupdate.modal.modes import Sensor
from probupdate.model.parameters import Parameters
from probupdate.structure.effect_kinds import EffectKeys
from probupdate.structure.parameter_table import KEYS, updated_parameters
from probupdate.structure.schema import NotNegative, Number, PoissonRatio, Positive, Table, Vector

Group = Literal["leg", "brace", "pile", "column", "strut", "tie", "tower"]

# Table 2 of the paper: name -> the value at which it leaves the described structure as it is; m_h stands for the mass
# of the body named "hub" and so has no such value
NEUTRAL = {
    "k_j": 1.0, "k_t": 1.0, "k_TP": 1.0, "k_p": 1.0, "LJF": 1.0, "D_l": 1.0, "t_l": 1.0, "D_b": 1.0, "t_b": 1.0,
    "sc": 0.0, "corr": 0.0, "mg": 0.0, "a_m": 1.0, "m_h": None, "py": 1.0, "tz": 1.0, "qw": 1.0,
}
# and what a monopile's transition piece and a tower's foundation have beside
ALL_NEUTRAL = NEUTRAL | {"k_c": 1.0, "k_f": 1.0}
# the lowest value each can take in any structure: factors must stay above zero, depths and thicknesses not below it
POSITIVE = ("k_j", "k_t", "k_TP", "k_p", "LJF", "D_l", "t_l", "D_b", "t_b", "m_h", "py", "tz", "qw", "k_c", "k_f")


class TubeEntry(Table):
    diameter_m: Positive
    thickness_m: Positive


class OnLand(Table):
    gravity_mps2: Positive


class Site(OnLand):
    mudline_m: Number
    water_level_m: Number
    water_density_kgpm3: Positive


class Steel(Table):
    youngs_modulus_pa: Positive
    poisson_ratio: PoissonRatio
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

    def face_between(self, first: str, second: str) -> str:
        """Name of a face or brace of two legs: "AB"; "A-BC" where legs A, BC, AB and C would have two faces "ABC"."""
        pairs = list(zip(self.leg_names, (*self.leg_names[1:], self.leg_names[0]), strict=True))
        # a run of hyphens longer than any name leaves no two alike
        for dash in ("-" * k for k in range(2 + max(map(len, self.leg_names)))):
            if len({x for a, b in pairs for x in (a + dash + b, b + dash + a)}) == 2 * len(pairs):
                break
        return first + dash + second

    @property
    def faces(self) -> dict[str, tuple[str, str]]:
        """Name of each face -> its two legs, in their order."""
        return {self.face_between(a, b): (a, b)
                for a, b in zip(self.leg_names, (*self.leg_names[1:], self.leg_names[0]), strict=True)}


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
    at_mudline: NotNegative
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


class Section(Table):
    """A tube's size at a level; between levels it changes linearly."""

    z_m: Number
    diameter_m: Positive
    thickness_m: Positive


S = TypeVar("S", bound=Section)


def station_pairs(stations: Sequence[S]) -> list[tuple[S, S]]:
    """Neighbours between which a tube stands: two stations at one level are a step of its wall or diameter."""
    return [(low, high) for low, high in pairwise(stations) if low.z_m < high.z_m]


def tube_between_stations(low: Section, high: Section, z_m: float) -> TubeEntry:
    """The tube at a level between two stations."""
    t = (z_m - low.z_m) / (high.z_m - low.z_m)
    return TubeEntry(diameter_m=low.diameter_m + t * (high.diameter_m - low.diameter_m),
                     thickness_m=low.thickness_m + t * (high.thickness_m - low.thickness_m))


class Station(Section):
    flange_kg: NotNegative


class Tower(Table):
    secondary_steel_kgpm: NotNegative
    station: Annotated[tuple[Station, ...], Field(min_length=2)]


class Monopile(Table):
    """A pile driven from its lowest station (the tip) to its highest, above the water."""

    flooded: Annotated[bool, Strict()]
    station: Annotated[tuple[Section, ...], Field(min_length=2)]


class Grout(Table):
    thickness_m: Positive
    youngs_modulus_pa: Positive
    poisson_ratio: PoissonRatio
    density_kgpm3: Positive


class Flange(Table):
    bending_stiffness_nmprad: Positive
    mass_kg: NotNegative


class Sleeve(Table):
    """A monopile's transition piece: a tube from bottom_m to the tower's foot, grouted around the pile's top end or
    bolted on it."""

    connection: Literal["grouted", "bolted"]
    bottom_m: Number
    tube: TubeEntry
    lumped_mass_kg: NotNegative
    lumped_mass_m: Number
    grout: Grout | None = None
    flange: Flange | None = None


class Foundation(Table):
    """What a tower on land stands on: held, or on springs at its foot."""

    support: Literal["clamped", "springs"]
    mass_kg: NotNegative = 0.0
    inertia_kgm2: tuple[NotNegative, NotNegative, NotNegative] = (0.0, 0.0, 0.0)
    horizontal_npm: Positive | None = None
    vertical_npm: Positive | None = None
    rocking_nmprad: Positive | None = None
    torsion_nmprad: Positive | None = None


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
    """model.toml of a turbine, checked: what every one has. Lengths in m, z = 0 at mean sea level, masses in kg,
    stresses in Pa. `stands_on`: its substructure, in words."""

    format: Literal[1]
    name: str
    steel: Steel
    mesh: Mesh
    tower: Tower
    rna: Annotated[tuple[Body, ...], Field(min_length=1)]
    sensor: tuple[SensorEntry, ...] = ()
    parameter: Annotated[tuple[ParameterEntry, ...], Field(min_length=1)]
    correlation: dict[str, dict[str, Annotated[float, Strict(), Field(ge=-1, le=1)]]] | None = None

    stands_on: ClassVar[str] = ""
    # groups of its members, of which mesh.elements_per_member says how finely they are cut
    groups: ClassVar[tuple[Group, ...]] = ("tower",)

    @property
    @abstractmethod
    def gravity_mps2(self) -> float:
        """Where the structure stands."""

    @property
    @abstractmethod
    def own_parameters(self) -> tuple[str, ...]:
        """Parameters of the whole structure that act in this one."""

    @property
    def tapers(self) -> dict[str, tuple[Section, ...]]:
        """Parts whose size changes linearly between stations, from below upwards."""
        return {"tower": self.tower.station}

    @property
    def effects(self) -> tuple[ParameterEntry, ...]:
        """The parameters that act at a place of their own."""
        return tuple(p for p in self.parameter if p.kind is not None)

    @property
    def values(self) -> dict[str, float]:
        """All parameters and the effects at the file's initial values; rows not listed act neutrally."""
        # a file without a hub is refused by a check, which comes after others that ask for values
        hub = next((body.mass_kg for body in self.rna if body.name == "hub"), 0.0)
        neutral = {name: hub if ALL_NEUTRAL[name] is None else ALL_NEUTRAL[name] for name in self.own_parameters}
        return neutral | {p.name: p.initial for p in self.parameter}


def described_sensors(description: Description) -> tuple[Sensor, ...]:
    """The file's own sensors, which a campaign's may replace."""
    return tuple(Sensor(**s.model_dump(exclude={"part"})) for s in description.sensor)


class Offshore(Description):
    """A turbine in the sea, on piles."""

    site: Site
    hydrodynamics: Hydrodynamics
    corrosion: Corrosion
    soil: Soil

    @property
    def gravity_mps2(self) -> float:
        return self.site.gravity_mps2

    @property
    @abstractmethod
    def pile_tip_m(self) -> float:
        """Lowest point of its piles."""


class JacketTurbine(Offshore):
    jacket: Jacket
    pile: Pile
    transition_piece: TransitionPiece

    stands_on: ClassVar[str] = "jacket"
    groups: ClassVar[tuple[Group, ...]] = ("leg", "brace", "pile", "column", "strut", "tie", "tower")

    @property
    def own_parameters(self) -> tuple[str, ...]:
        return tuple(NEUTRAL)

    @property
    def pile_tip_m(self) -> float:
        return self.pile.tip_m


class MonopileTurbine(Offshore):
    monopile: Monopile
    transition_piece: Sleeve | None = None

    stands_on: ClassVar[str] = "monopile"
    groups: ClassVar[tuple[Group, ...]] = ("pile", "column", "tower")

    @property
    def own_parameters(self) -> tuple[str, ...]:
        piece = () if self.transition_piece is None else ("k_TP", "k_c")
        return ("k_t", *piece, "k_p", "sc", "corr", "mg", "a_m", "m_h", "py", "tz", "qw")

    @property
    def tapers(self) -> dict[str, tuple[Section, ...]]:
        return super().tapers | {"monopile": self.monopile.station}

    @property
    def pile_tip_m(self) -> float:
        return self.monopile.station[0].z_m


class FoundationTurbine(Description):
    """A tower on land."""

    site: OnLand
    foundation: Foundation

    stands_on: ClassVar[str] = "foundation"

    @property
    def gravity_mps2(self) -> float:
        return self.site.gravity_mps2

    @property
    def own_parameters(self) -> tuple[str, ...]:
        return ("k_t", "m_h", *(("k_f",) if self.foundation.support == "springs" else ()))


# the table of model.toml that says what the turbine stands on
SUBSTRUCTURES: dict[str, type[Description]] = {
    kind.stands_on: kind for kind in (JacketTurbine, MonopileTurbine, FoundationTurbine)}


def updatable_parameters(description: Description, where: str) -> Parameters:
    """The parameters with update = true and their prior, in the file's order."""
    tables = [p.model_dump(exclude_none=True, include=set(KEYS)) for p in description.parameter]
    return updated_parameters(tables, where, description.correlation)
