"""Effects as parameters of a turbine: what `kind` a [[parameter]] may be, and the keys that say where it acts.

A parameter without `kind` is a row of Table 2 and acts everywhere. One with a kind acts where its table `on` says: on
members of a group, leg, face, bay, part or band of levels, on a body of the rotor-nacelle assembly, or on the whole. At
its kind's neutral value the structure is as described.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, Strict

from probupdate.structure.schema import Number, Positive, Table

GROUPS = ("leg", "brace", "pile", "column", "strut", "tie", "tower")
WET_GROUPS = ("leg", "brace", "pile", "column")
MEMBER_KEYS = ("group", "leg", "face", "bay", "part", "level_m")


class Place(Table):
    """Where an effect acts; every key that is given narrows the choice.

    group; leg (a name; for joints the leg at the brace's end); face (its two legs, "AB"); bay (counted from the lowest,
    1); part ("brace AB-1", "tower"); level_m, the lower and upper end of a band; body of the rotor-nacelle assembly.
    """

    group: Literal["leg", "brace", "pile", "column", "strut", "tie", "tower"] | None = None
    leg: str | None = None
    face: str | None = None
    bay: Annotated[int, Strict(), Field(ge=1)] | None = None
    part: str | None = None
    level_m: tuple[Number, Number] | None = None
    body: str | None = None

    @property
    def given(self) -> tuple[str, ...]:
        return tuple(key for key in type(self).model_fields if getattr(self, key) is not None)


class EffectKeys(Table):
    """The keys that a [[parameter]] with a kind has beside those of every parameter."""

    kind: str | None = None
    on: Place = Place()
    motion: Literal["all", "axial", "bending", "in plane", "out of plane"] | None = None
    curve: Literal["all", "py", "tz", "qw"] | None = None
    at_m: Number | None = None
    axis: Literal["x", "y", "z"] | None = None
    relative_per_degc: Number | None = None
    inertia_per_kg_m2: tuple[Number, Number, Number] | None = None
    frequency_hz: Positive | None = None
    channels: tuple[str, ...] | None = None


SETTINGS = ("motion", "curve", "at_m", "axis", "relative_per_degc", "inertia_per_kg_m2", "frequency_hz", "channels")


@dataclass(frozen=True, kw_only=True)
class Kind:
    """One way of acting. `lowest` is the least value that makes a structure (`above`: it must lie above it); `keys`
    are those of `on` that it knows, `needs` and `may` the settings it must and may have, `groups` what it acts on."""

    neutral: float
    unit: str
    lowest: float
    meaning: str
    above: bool = False
    keys: tuple[str, ...] = ()
    groups: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    may: tuple[str, ...] = ()
    motions: tuple[str, ...] = ()


KINDS: Mapping[str, Kind] = MappingProxyType({
    "stiffness": Kind(
        neutral=1.0, unit="-", lowest=0.0, above=True, keys=MEMBER_KEYS, groups=GROUPS, may=("motion",),
        motions=("all", "axial", "bending"),
        meaning="factor on E and G of members; motion = \"axial\" or \"bending\" (with torsion) for one of them alone",
    ),
    "shear": Kind(
        neutral=0.0, unit="-", lowest=0.0, keys=MEMBER_KEYS, groups=GROUPS,
        meaning="share of the members' flexibility in shear that is counted beyond what mesh.theory does (1: all that "
                "Timoshenko's theory says, where mesh.theory is \"bernoulli-euler\")",
    ),
    "joint": Kind(
        neutral=1.0, unit="-", lowest=0.0, keys=("leg", "face", "bay", "part"), groups=("brace", "column"),
        may=("motion",),
        motions=("all", "axial", "in plane", "out of plane"),
        meaning="factor on the stiffness of brace-to-leg joints, 0 for an end that is released; of a monopile, on that "
                "of its connection (part = \"transition piece\"), on land on the springs of the \"foundation\"",
    ),
    "hinge": Kind(
        neutral=0.0, unit="rad/(GN m)", lowest=0.0, keys=("group", "leg", "part"), groups=GROUPS, needs=("at_m",),
        meaning="flexibility in bending of a connection (flange, grout) at the level at_m of the members",
    ),
    "slip": Kind(
        neutral=0.0, unit="m/GN", lowest=0.0, keys=("group", "leg", "part"), groups=GROUPS, needs=("at_m",),
        meaning="flexibility along the members of a connection (grout) at the level at_m",
    ),
    "soil": Kind(
        neutral=1.0, unit="-", lowest=0.0, above=True, keys=("leg", "level_m"), groups=("pile",), needs=("curve",),
        meaning="factor on the stiffness of the soil's p-y, t-z or q-z springs, or of all",
    ),
    "scour": Kind(
        neutral=0.0, unit="m", lowest=-np.inf, keys=("leg",), groups=("pile",),
        meaning="scour depth beyond the parameter sc",
    ),
    "growth": Kind(
        neutral=0.0, unit="m", lowest=-np.inf, keys=MEMBER_KEYS, groups=WET_GROUPS,
        meaning="thickness of marine growth beyond the parameter mg, where growth is",
    ),
    "corrosion": Kind(
        neutral=0.0, unit="m", lowest=-np.inf, keys=MEMBER_KEYS, groups=GROUPS,
        meaning="external wall loss beyond the parameter corr",
    ),
    "added_mass": Kind(
        neutral=1.0, unit="-", lowest=0.0, keys=MEMBER_KEYS, groups=WET_GROUPS,
        meaning="factor on the added mass of the surrounding water",
    ),
    "flooding": Kind(
        neutral=0.0, unit="-", lowest=-1.0, keys=MEMBER_KEYS, groups=("leg", "brace", "pile"),
        meaning="share of the submerged bore that holds water, beyond what the file says (-1: a flooded one is dry)",
    ),
    "mass": Kind(
        neutral=0.0, unit="kg", lowest=-np.inf, keys=(*MEMBER_KEYS, "body"), groups=GROUPS, may=("inertia_per_kg_m2",),
        meaning="mass added to a body, or evenly along members",
    ),
    "temperature": Kind(
        neutral=0.0, unit="degC", lowest=-np.inf, keys=MEMBER_KEYS, groups=GROUPS, needs=("relative_per_degc",),
        meaning="steel temperature above that of the file's E: factor 1 + relative_per_degc x value on E and G of "
                "members and joints",
    ),
    "centre_of_mass": Kind(
        neutral=0.0, unit="m", lowest=-np.inf, keys=("body",), needs=("axis",),
        meaning="shift of a body's (without `on`: all bodies') centre of mass along the nacelle's axis",
    ),
    "inertia": Kind(
        neutral=0.0, unit="kg m2", lowest=-np.inf, keys=("body",), needs=("axis",),
        meaning="moment of inertia added to a body about the nacelle's axis",
    ),
    "oscillator": Kind(
        neutral=1e-4, unit="-", lowest=0.0, above=True, keys=("body",), needs=("axis", "frequency_hz"),
        meaning="share of a body's mass that swings by itself along the axis (blades); at the neutral value it is "
                "too light to be seen",
    ),
    "water_level": Kind(
        neutral=0.0, unit="m", lowest=-np.inf,
        meaning="rise of the water above site.water_level_m: length with added mass and flooding; growth stays",
    ),
    "weight": Kind(
        neutral=0.0, unit="-", lowest=-np.inf,
        meaning="share of the dry weight whose geometric stiffness is added to what mesh.geometric_stiffness says",
    ),
    "thrust": Kind(
        neutral=0.0, unit="N", lowest=-np.inf,
        meaning="mean rotor thrust along the nacelle's x axis at the hub: geometric stiffness of the member forces",
    ),
    "sensor_height": Kind(
        neutral=0.0, unit="m", lowest=-np.inf, needs=("channels",),
        meaning="how much farther up along their member the sensors of these channels sit than position_m says: the "
                "structure is as it is, what is read of it is not",
    ),
    "sensor_gravity": Kind(
        neutral=0.0, unit="-", lowest=-np.inf, needs=("channels",),
        meaning="share by which the readings of these channels hold the other of what `gravity` states: 1 where they "
                "hold it though they should not, or the other way round",
    ),
})
