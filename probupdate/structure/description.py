"""The description of a turbine in model.toml: its schema, and one line for the first mistake in it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Literal, get_args

import numpy as np
from pydantic import Field, Strict, ValidationError

from probupdate.errors import InputError
from probupdate.parameters import Parameters
from probupdate.structure.effects import GROUPS, KINDS, SETTINGS, EffectKeys, check_effect, check_sums
from probupdate.structure.parameter_table import KEYS, read_toml, updated_parameters
from probupdate.structure.schema import Mistake, NotNegative, Number, Positive, Table, Vector, nearest

# Table 2 of the paper: name -> the value at which it leaves the described structure as it is; m_h stands for the
# mass of the body named "hub" and so has no such value
NEUTRAL = {
    "k_j": 1.0, "k_t": 1.0, "k_TP": 1.0, "k_p": 1.0, "LJF": 1.0, "D_l": 1.0, "t_l": 1.0, "D_b": 1.0, "t_b": 1.0,
    "sc": 0.0, "corr": 0.0, "mg": 0.0, "a_m": 1.0, "m_h": None, "py": 1.0, "tz": 1.0, "qw": 1.0,
}  # fmt: skip
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
    elements_per_member: dict[Literal["leg", "brace", "pile", "column", "strut", "tie", "tower"],
                              Annotated[int, Strict(), Field(ge=1, le=200)]]  # fmt: skip


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


class ParameterEntry(EffectKeys):
    name: str
    unit: str
    initial: Number
    cov: Positive | None = None
    std: Positive | None = None
    # unbounded ones are written inf and -inf in TOML
    lower: Annotated[float, Strict(), Field(allow_inf_nan=True)] = -np.inf
    upper: Annotated[float, Strict(), Field(allow_inf_nan=True)] = np.inf
    prior: Literal["normal", "lognormal"] = "normal"
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


def updated(description: Description, where: str) -> Parameters:
    """The parameters with update = true and their prior, in the file's order."""
    tables = [p.model_dump(exclude_none=True, include=set(KEYS)) for p in description.parameter]
    return updated_parameters(tables, where, description.correlation)


def read_description(path: str | Path) -> Description:
    """model.toml -> Description; raises one InputError with the first mistake and the number of the others."""
    path = Path(path)
    return parse_description(read_toml(path), str(path))


def parse_description(raw: dict, where: str) -> Description:
    try:
        description = Description.model_validate(raw)
    except ValidationError as error:
        raise _first([_translate(e) for e in error.errors()], where) from None
    mistakes = [m for check in CHECKS for m in check(description)]
    if mistakes:
        raise _first(mistakes, where)
    return description


def _first(mistakes: list[Mistake], where: str) -> InputError:
    # a key that is missing may be there misspelt, which says more
    key, problem, remedy = min(mistakes, key=lambda m: m[1].startswith("is missing"))
    rest = len(mistakes) - 1
    more = f" ({rest} more mistake{'s' if rest > 1 else ''} in this file)" if rest else ""
    return InputError(f"{where}: {key}" if key else where, problem, remedy + more)


def _known_keys(location: tuple) -> set[str]:
    """The keys the schema allows in the table that `location` lies in."""
    model = Description
    for step in location[:-1]:
        if isinstance(step, int):
            continue
        field = model.model_fields.get(step)
        candidates = [] if field is None else _tables(field.annotation)
        if not candidates:
            return set()
        model = candidates[0]
    return set(model.model_fields)


def _tables(annotation) -> list[type[Table]]:
    if isinstance(annotation, type):
        return [annotation] if issubclass(annotation, Table) else []
    return [table for argument in get_args(annotation) for table in _tables(argument)]


def _translate(error: dict) -> Mistake:
    location = tuple(step for step in error["loc"] if step != "[key]")
    key = ""
    for step in location:
        key += f"[{step + 1}]" if isinstance(step, int) else f".{step}" if key else str(step)
    kind, value = error["type"], error["input"]
    if kind == "extra_forbidden":
        return key, "is not a key of this file", nearest(str(location[-1]), _known_keys(location))
    if kind == "missing":
        return key, "is missing", "add it"
    if kind == "finite_number":
        return key, f"{value} is not a finite number", "give a number in SI units"
    message = error["msg"].removeprefix("Value error, ")
    shown = repr(value) if not isinstance(value, dict | list | tuple) else f"a {type(value).__name__}"
    return key, f"{shown} is wrong: {message[0].lower()}{message[1:]}", "correct the value"


def _tubes(d: Description) -> Iterator[tuple[str, float, float]]:
    yield "jacket.leg", d.jacket.leg.diameter_m, d.jacket.leg.thickness_m
    for k, bay in enumerate(d.jacket.bay):
        yield f"jacket.bay[{k + 1}].brace", bay.brace.diameter_m, bay.brace.thickness_m
    yield "pile", d.pile.diameter_m, d.pile.thickness_m
    for name in ("column", "strut", "tie"):
        tube = getattr(d.transition_piece, name)
        yield f"transition_piece.{name}", tube.diameter_m, tube.thickness_m
    for k, station in enumerate(d.tower.station):
        yield f"tower.station[{k + 1}]", station.diameter_m, station.thickness_m


def _check_walls(d: Description) -> Iterator[Mistake]:
    for key, diameter, wall in _tubes(d):
        if wall >= diameter / 2:
            yield (f"{key}.thickness_m", f"{wall} m does not fit into a tube of {diameter} m (at most half of it)",
                   "check the unit: metres")  # fmt: skip


def _check_levels(d: Description) -> Iterator[Mistake]:
    jacket, tp = d.jacket, d.transition_piece
    ordered = (
        ("pile.tip_m", d.pile.tip_m, "site.mudline_m", d.site.mudline_m),
        ("site.mudline_m", d.site.mudline_m, "site.water_level_m", d.site.water_level_m),
        ("jacket.bottom.z_m", jacket.bottom.z_m, "jacket.top.z_m", jacket.top.z_m),
        ("corrosion.bottom_m", d.corrosion.bottom_m, "corrosion.top_m", d.corrosion.top_m),
        ("transition_piece.column_bottom_m", tp.column_bottom_m, "transition_piece.strut_top_m", tp.strut_top_m),
        ("jacket.top.z_m", jacket.top.z_m, "transition_piece.strut_top_m", tp.strut_top_m),
    )
    for low_key, low, high_key, high in ordered:
        if not low < high:
            yield low_key, f"{low} is not below {high_key} = {high}", "put the levels in order, upwards"
    if not d.site.mudline_m <= jacket.bottom.z_m:
        yield ("jacket.bottom.z_m", f"{jacket.bottom.z_m} is below the mudline {d.site.mudline_m}",
               "let the pile heads stand at or above the mudline")  # fmt: skip
    if not tp.strut_top_m <= d.tower.station[0].z_m:
        yield ("transition_piece.strut_top_m", f"{tp.strut_top_m} is above the tower's foot {d.tower.station[0].z_m}",
               "end the struts on the column")  # fmt: skip
    for k, (a, b) in enumerate(zip(d.tower.station[:-1], d.tower.station[1:], strict=True)):
        if not a.z_m < b.z_m:
            yield f"tower.station[{k + 2}].z_m", f"{b.z_m} is not above {a.z_m}", "list the stations upwards"


def _check_bays(d: Description) -> Iterator[Mistake]:
    low, high = d.jacket.bottom.z_m, d.jacket.top.z_m
    for k, bay in enumerate(d.jacket.bay):
        key = f"jacket.bay[{k + 1}]"
        if not bay.bottom_m < bay.top_m:
            yield f"{key}.bottom_m", f"{bay.bottom_m} is not below top_m = {bay.top_m}", "swap them"
        if bay.bottom_m < low or bay.top_m > high:
            yield (key, f"from {bay.bottom_m} to {bay.top_m} m it reaches beyond the legs, {low} to {high} m",
                   "move the bay or lengthen the legs")  # fmt: skip
    for k, (a, b) in enumerate(zip(d.jacket.bay[:-1], d.jacket.bay[1:], strict=True)):
        if b.bottom_m < a.top_m:
            yield (f"jacket.bay[{k + 2}].bottom_m", f"{b.bottom_m} lies below the top {a.top_m} of the bay before",
                   "list bays upwards, without overlap")  # fmt: skip


def _check_names(d: Description) -> Iterator[Mistake]:
    missing = sorted(set(GROUPS) - set(d.mesh.elements_per_member))
    if missing:
        yield "mesh.elements_per_member", f"{', '.join(missing)} missing", "give a number for each group"
    for key, names in (
        ("jacket.leg_names", list(d.jacket.leg_names)),
        ("rna", [body.name for body in d.rna]),
        ("sensor", [sensor.channel for sensor in d.sensor]),
        ("parameter", [p.name for p in d.parameter]),
    ):
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            yield key, f"'{twice[0]}' is listed twice", "keep one of them, or give them different names"
    if "hub" not in [body.name for body in d.rna]:
        yield "rna", "no body is named 'hub', whose mass is the parameter m_h", "name the hub and rotor so"


def _check_sensors(d: Description) -> Iterator[Mistake]:
    for k, sensor in enumerate(d.sensor):
        length = float(np.linalg.norm(np.clip(sensor.direction, -1e6, 1e6)))
        if abs(length - 1) > 1e-3:
            yield (f"sensor[{k + 1}] {sensor.channel}.direction", f"its length is {length:.3g}, not 1",
                   "give a unit vector")  # fmt: skip


def _check_parameters(d: Description) -> Iterator[Mistake]:
    for k, p in enumerate(d.parameter):
        key = f"parameter[{k + 1}] {p.name}"
        if p.kind is None and p.name not in NEUTRAL:
            yield (key, f"'{p.name}' is not a parameter of this model",
                   nearest(p.name, NEUTRAL) + " (an effect at a place needs a kind)")  # fmt: skip
            continue
        if p.kind is not None and p.name in NEUTRAL:
            yield f"{key}.kind", f"'{p.name}' is a parameter of the whole structure", "give the effect another name"
            continue
        if p.kind is None and (p.on.given or any(getattr(p, name) is not None for name in SETTINGS)):
            yield key, "says where or how it acts, but not of which kind it is", f"add kind: {', '.join(KINDS)}"
        if (p.cov is None) == (p.std is None):
            both = "neither cov nor std" if p.cov is None else "both cov and std"
            yield key, f"{both} given", "give one of them"
        elif p.cov is not None and p.initial == 0:
            yield f"{key}.cov", "is relative to an initial value of 0", "give std in the parameter's unit"
        yield from check_effect(p, key, d) if p.kind is not None else _check_lowest(p, key)
        if not p.lower <= p.initial <= p.upper:
            yield f"{key}.initial", f"{p.initial} is outside [{p.lower}, {p.upper}]", "widen the bounds"
    updated = [p.name for p in d.parameter if p.update]
    if not updated:
        yield "parameter", "none has update = true", "let at least one vary"
    for name, row in (d.correlation or {}).items():
        for other in (name, *row):
            if other not in updated:
                yield f"correlation.{name}", f"'{other}' is not an updated parameter", nearest(other, updated)


def _check_lowest(p: ParameterEntry, key: str) -> Iterator[Mistake]:
    lowest = "above" if p.name in POSITIVE else "not below"
    for name in ("lower", "initial") if p.update else ("initial",):
        value = getattr(p, name)
        if value < 0 or (value == 0 and p.name in POSITIVE):
            yield f"{key}.{name}", f"{value} makes no structure: it must be {lowest} 0", "raise it"


def _check_section_range(d: Description) -> Iterator[Mistake]:
    """Walls of legs and braces at the ends of the updated parameters' bounds; the pile below the deepest scour."""
    low, high = d.values, d.values
    for p in d.parameter:
        if p.update:
            low[p.name], high[p.name] = p.lower, p.upper
    walls = [("D_l", "t_l", "jacket.leg", d.jacket.leg)]
    walls += [("D_b", "t_b", f"jacket.bay[{k + 1}].brace", bay.brace) for k, bay in enumerate(d.jacket.bay)]
    for diameter_name, wall_name, key, tube in walls:
        thinnest = tube.thickness_m * low[wall_name] - high["corr"]
        if thinnest <= 0:
            yield (key, f"{wall_name} and corr at their bounds leave a wall of {1000 * thinnest:.1f} mm",
                   f"raise the lower bound of {wall_name} or lower the upper bound of corr")  # fmt: skip
        bore = tube.diameter_m * low[diameter_name] - 2 * tube.thickness_m * high[wall_name]
        if bore <= 0:
            yield (key, f"{diameter_name} and {wall_name} at their bounds close the bore",
                   f"lower the upper bound of {wall_name}")  # fmt: skip
    if high["sc"] >= d.site.mudline_m - d.pile.tip_m:
        yield "parameter sc", f"scour of {high['sc']} m lays the pile tip bare", "lower its upper bound"


CHECKS: tuple[Callable[[Description], Iterator[Mistake]], ...] = (
    _check_walls, _check_levels, _check_bays, _check_names, _check_sensors, _check_parameters, _check_section_range,
    check_sums,
)  # fmt: skip
