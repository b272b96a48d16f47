"""The structural and environmental rows of the catalogue for a turbine: each leg, face, bay and level on its own row.

A missing neighbour is named falsely, so that every place has its row. Tolerances are what drawings, fabrication
standards and site reports allow: plate and wall 1 %, soil of one leg 10 % of its springs (uniform), scour 0.1 m, RNA
mass 1 % and its centre 0.1 m. Prior scales are what an engineer would call a notable case of each; bounds what may
exist.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import pairwise
from typing import cast

import numpy as np

from probupdate.effects.catalogue import WARMS_ODDS, Effect, sensor_groups
from probupdate.effects.gravity import gravity_effects
from probupdate.modal.modes import Sensor
from probupdate.structure.beam import Tube
from probupdate.structure.channels import attachments, line_of
from probupdate.structure.description import (
    Description,
    FoundationTurbine,
    JacketTurbine,
    MonopileTurbine,
    Offshore,
    TubeEntry,
    described_sensors,
    station_pairs,
)
from probupdate.structure.effect_kinds import KINDS
from probupdate.structure.extend import EffectParameter
from probupdate.structure.joints import joint_law
from probupdate.structure.readings import rotation_reading
from probupdate.structure.turbine_frame import build_frame

# (1 - E(T)/E) per degree: steel loses about 0.036 % of its modulus per degree at room temperature
STEEL_PER_DEGC = -3.6e-4
# inertia of a kg of ice over that of a kg of the rotor: 1 where ice lies as the blades' own mass; 4.8 where it grows to
# mid-span and is even from there (GL 2010: radius of gyration 0.66 R; rotor of Jonkman et al. 2009: 0.30 R)
ICE_OUTWARD = 3.0
# first collective flap of a 5-MW rotor's blades (Jonkman et al. 2009, table 9-1); edit it for another rotor
FLAP_HZ = 0.7
# a platform or a flange mistaken for the next one, or a height above another zero; judgement. What drawings leave open
# of a height, 0.1 m, changes a channel by less than its gain's tolerance. A sensor whose member ends at both sides
# within the least reach has no row
HEIGHT_SCALE_M, HEIGHT_REACH_M, LEAST_REACH_M = 1.5, 10.0, 1.0


def turbine_effects(d: Description, *, sensors: Sequence[Sensor] | None = None) -> tuple[Effect, ...]:
    """Every row for this turbine, with those of its sensors that the model answers for (`sensors`: others than the
    file's)."""
    placed = described_sensors(d) if sensors is None else sensors
    level = [(s.channel, bool(s.gravity)) for s in placed if rotation_reading(s.direction).any()]
    rows = [*_theory(d)]
    if isinstance(d, JacketTurbine):
        rows += [*_jacket(d), *_transition_piece(d), *_flanges(d), *_pile_heads(d)]
    elif isinstance(d, MonopileTurbine):
        rows += [*_monopile(d), *_sleeve(d), *_flanges(d)]
    elif isinstance(d, FoundationTurbine):
        rows += [*_foundation(d), *_flanges(d)]
    if isinstance(d, Offshore):
        rows += [*_soil(d), *_water(d)]
    rows += [*_masses(d), *_environment(d), *_heights(d, placed),
             *gravity_effects(level, placed, [p.name for p in d.parameter])]
    return tuple(rows)


def _row(name, kind, cause, location, *, low, high, prior_scale, on=None, settings=None, group="structural", unit="",
         **row) -> Effect:
    """An effect with a parameter of its own; `row`: what else an Effect has."""
    neutral = KINDS[kind].neutral
    adds = EffectParameter(name=name, kind=kind, on=on or {}, settings=settings or {}, std=prior_scale,
                           lower=neutral + low,
                           upper=neutral + high, cause=cause, location=location)
    return Effect(kind=group, cause=cause, location=location, unit=unit or KINDS[kind].unit, prior_scale=prior_scale,
                  lower=low, upper=high, adds=adds, **row)


def _legs(d: Description) -> tuple[str, ...]:
    """Of a jacket; a single pile has no rows beside those of the whole."""
    return d.jacket.leg_names if isinstance(d, JacketTurbine) else ()


def _soil_part(d: Description) -> str:
    """What stands in the soil."""
    return "all legs" if isinstance(d, JacketTurbine) else d.stands_on


def _bays(d: JacketTurbine) -> range:
    return range(1, len(d.jacket.bay) + 1)


# axial and bending alike: with the axial part alone a lost brace passed for the loosened joints at its ends
def _brace(name: str, location: str, on: dict) -> Effect:
    return _row(name, "stiffness", "brace stiffness lost", location, on=on, low=-0.98,
                high=0.0, tolerance=0.01, prior_scale=0.5, signature="torsion falls, FA and SS couple",
                check="inspect the braces and their nodes")


def _joint(name: str, location: str, on: dict) -> Effect:
    return _row(name, "joint", "joints loosened", location, on=on, low=-0.98, high=0.0, tolerance=0.1, prior_scale=0.5,
                signature="as the braces there, weaker", check="inspect the weld toes of these nodes")


def _jacket(d: JacketTurbine) -> Iterator[Effect]:
    for bay in _bays(d):
        for face in d.jacket.faces:
            yield _brace(f"brace_{face}_{bay}", f"face {face}, bay {bay}", {"group": "brace", "face": face, "bay": bay})
    if joint_law(d.jacket.joints.law) is not None:
        for bay in _bays(d):
            for face in d.jacket.faces:
                yield _joint(f"joint_{face}_{bay}", f"face {face}, bay {bay}", {"face": face, "bay": bay})
    for bay in _bays(d):
        for leg in d.jacket.leg_names:
            yield _row(f"leg_{leg}_{bay}", "stiffness", "leg stiffness lost", f"leg {leg}, bay {bay}",
                       on={"group": "leg", "leg": leg, "bay": bay}, low=-0.9, high=0.0, tolerance=0.01, prior_scale=0.3,
                       signature="bending of the jacket towards one diagonal", check="inspect the leg: cracks, dents")


def _flexibility_of_three_diameters(d: Description, diameter_m: float, thickness_m: float) -> tuple[float, float]:
    """Flexibility of three diameters of a tube in bending, rad/(GN m), and along its axis, m/GN: a connection as soft
    as that is noticed."""
    tube = Tube(diameter_m=diameter_m, thickness_m=thickness_m)
    length = 1e9 * 3 * diameter_m / d.steel.youngs_modulus_pa
    # numbers, as the tube's own sizes are
    return cast(float, length / tube.second_moment({})), cast(float, length / tube.area({}))


def _theory(d: Description) -> Iterator[Effect]:
    """Bernoulli-Euler members do not deform in shear, real ones do: normal, and far from nothing where they are
    stout. Without this row a month of sets sees a column or a tower's foot that is softer than the model."""
    if d.mesh.theory == "bernoulli-euler":
        foot = d.jacket.top.z_m if isinstance(d, JacketTurbine) else -np.inf
        stout = {"level_m": (foot, d.tower.station[-1].z_m)} if isinstance(d, JacketTurbine) else {}
        where = "above the jacket" if stout else "all members"
        yield _row("shear", "shear", "shear deformation", where, on=stout, low=0.0, high=3.0,
                   tolerance=1.0, prior_scale=1.0, time_profiles=("constant",),
                   signature="stout members give way: transition piece, tower's foot",
                   check='set mesh.theory = "timoshenko" in the model file and update again')


def _transition_piece(d: JacketTurbine) -> Iterator[Effect]:
    for group in ("strut", "tie"):
        for leg in d.jacket.leg_names:
            yield _row(f"{group}_{leg}", "stiffness", "transition-piece flexibility", f"{group} {leg}",
                       on={"group": group, "leg": leg}, low=-0.95, high=1.0, tolerance=0.01, prior_scale=0.3,
                       signature="second bending falls, one side", check="inspect the transition piece's welds")
    yield _row("column", "stiffness", "transition-piece flexibility", "column", on={"group": "column"}, low=-0.95,
               high=1.0, tolerance=0.01, prior_scale=0.3, signature="slope jumps at the transition piece",
               check="inspect the column's welds")


def _flanges(d: Description) -> Iterator[Effect]:
    for number, (station, _) in enumerate(station_pairs(d.tower.station)):
        soft, _ = _flexibility_of_three_diameters(d, station.diameter_m, station.thickness_m)
        yield _row(f"hinge_{station.z_m:g}".replace(".", "_"), "hinge", "tower flange flexibility",
                   f"tower at {station.z_m:g} m", settings={"at_m": station.z_m}, on={"group": "tower"}, low=0.0,
                   high=5 * soft, tolerance=0.01 * soft, prior_scale=0.25 * soft,
                   signature=f"slope jumps at the tower's {'flange' if number else 'foot'}",
                   check="bolt forces, gap measurement at the flange")


def _pile_heads(d: JacketTurbine) -> Iterator[Effect]:
    head = d.jacket.bottom.z_m
    soft, long = _flexibility_of_three_diameters(d, d.jacket.leg.diameter_m, d.jacket.leg.thickness_m)
    for kind, name, words, scale in (("hinge", "hinge_pile", "grout flexibility in bending", soft),
                                     ("slip", "slip_pile", "grout flexibility along the pile", long)):
        for leg in d.jacket.leg_names:
            yield _row(f"{name}_{leg}", kind, words, f"pile head {leg}", settings={"at_m": head},
                       on={"group": "pile", "leg": leg}, low=0.0, high=20 * scale, tolerance=0.02 * scale,
                       prior_scale=scale,
                       signature="as softer soil of one leg", check="inspect the grout seal")


def _bands(d: MonopileTurbine) -> Iterator[tuple[str, str, tuple[float, float]]]:
    """Of the monopile between its stations, as far as it stands above the mudline: number, words, levels."""
    free = [z for z in (d.site.mudline_m, *(s.z_m for s in d.monopile.station)) if z >= d.site.mudline_m]
    for number, (low, high) in enumerate(pairwise(sorted(set(free))), 1):
        yield str(number), f"{low:g} to {high:g} m", (low, high)


def _monopile(d: MonopileTurbine) -> Iterator[Effect]:
    for number, words, band in _bands(d):
        yield _row(f"monopile_{number}", "stiffness", "monopile stiffness lost", words,
                   on={"group": "pile", "level_m": band}, low=-0.9, high=1.0, tolerance=0.01, prior_scale=0.2,
                   signature="curvature of the shapes below the tower", check="wall thicknesses, cracks, dents")
    section = d.monopile.station[-1]
    own = _tube_mass(d, section.diameter_m, section.thickness_m, section.z_m - d.site.mudline_m)
    yield _row("monopile_mass", "mass", "monopile mass", "above the mudline",
               on={"group": "pile", "level_m": (d.site.mudline_m, section.z_m)}, low=-0.3 * own, high=2.0 * own,
               tolerance=0.02 * own, prior_scale=0.1 * own,
               signature="second bending falls", check="weight report: anodes, attached structures, ballast")


def _sleeve(d: MonopileTurbine) -> Iterator[Effect]:
    sleeve = d.transition_piece
    if sleeve is None:
        return
    yield _row("column", "stiffness", "transition-piece flexibility", "transition piece", on={"group": "column"},
               low=-0.95, high=1.0, tolerance=0.01, prior_scale=0.3, signature="slope jumps at the transition piece",
               check="wall thicknesses, welds")
    grouted = sleeve.connection == "grouted"
    yield _row("connection", "joint", "grouted connection loosened" if grouted else "bolted connection loosened",
               "monopile to transition piece", on={"part": "transition piece"}, low=-0.98, high=3.0, tolerance=0.1,
               prior_scale=0.5, time_profiles=("constant", "step", "ramp"),
               signature="slope jumps at the connection", check="relative displacement at the grout's ends, its cracks"
               if grouted else "bolt forces, gap measurement at the flange")


def _foundation(d: FoundationTurbine) -> Iterator[Effect]:
    if d.foundation.support == "clamped":
        return
    yield _row("foundation", "joint", "foundation stiffness", "tower's foot", on={"part": "foundation"}, low=-0.95,
               high=3.0, tolerance=0.1, prior_scale=0.5, time_profiles=("constant", "step", "ramp"),
               signature="first and second bending fall, the foot moves",
               check="gaps around the foundation, groundwater")


def _soil(d: Offshore) -> Iterator[Effect]:
    yield _row("scour_all", "scour", "scour", _soil_part(d), low=0.0, high=6.0, tolerance=0.1, prior_scale=1.5,
               time_profiles=("constant", "step", "ramp"), signature="second bending falls, base turns more",
               check="bathymetric survey")
    for leg in _legs(d):
        yield _row(f"scour_{leg}", "scour", "scour", f"leg {leg}", on={"leg": leg}, low=0.0, high=6.0, tolerance=0.1,
                   prior_scale=1.5, time_profiles=("constant", "step", "ramp"),
                   signature="second bending falls, one side",
                   check="bathymetric survey")
    for curve, cause in (("all", "soil stiffness"), ("py", "lateral soil stiffness"), ("tz", "axial soil stiffness"),
                         ("qw", "pile tip's soil stiffness")):
        # what is normal is each curve's own; along a single pile all of them are the lateral one
        own = {"settings": {"curve": curve}, "low": -0.95, "high": 3.0, "tolerance": 0.0 if curve == "all" else 0.06,
               "prior_scale": 0.5}
        for leg in _legs(d):
            yield _row(f"soil_{curve}_{leg}", "soil", cause, f"leg {leg}", on={"leg": leg}, **own,
                       signature="one side of the base softer or stiffer",
                       check="pile records, cone test at that leg")
        if not _legs(d) and curve != "all":
            yield _row(f"soil_{curve}", "soil", cause, _soil_part(d), **own, time_profiles=("constant", "step", "ramp"),
                       signature="base softer or stiffer", check="pile records, cone test")


def _tube_mass(d: Description, diameter: float, wall: float, length: float) -> float:
    return d.steel.density_kgpm3 * np.pi * (diameter - wall) * wall * length


def _largest_corrosion(d: Offshore) -> float:
    """Loss of wall in m that leaves a tenth of the thinnest tube of the splash zone where the file's own parameters
    leave it least; legs may lose as much once more by themselves."""
    low = {p.name: p.lower if p.update else p.initial for p in d.parameter}
    own = max((p.upper if p.update else p.initial for p in d.parameter if p.name == "corr"), default=0.0)

    def wall_left(entry, letter: str) -> float:
        return entry.thickness_m * low.get(f"t_{letter}", d.values.get(f"t_{letter}", 1.0)) - own

    if isinstance(d, JacketTurbine):
        band = [bay for bay in d.jacket.bay if bay.bottom_m <= d.corrosion.top_m and bay.top_m >= d.corrosion.bottom_m]
        walls = [wall_left(d.jacket.leg, "l") / 2, *(wall_left(bay.brace, "b") for bay in band)]
    else:
        walls = [wall_left(tube, "") for tube in _tubes_of_splash_zone(d)]
    return 0.9 * max(min(walls), 0.0)


def _tubes_of_splash_zone(d: Offshore) -> list[TubeEntry]:
    if not isinstance(d, MonopileTurbine):
        return []
    piece = () if d.transition_piece is None else (d.transition_piece.tube,)
    return [*(TubeEntry(diameter_m=s.diameter_m, thickness_m=s.thickness_m) for s in d.monopile.station
              if s.z_m > d.site.mudline_m), *piece]


def _water(d: Offshore) -> Iterator[Effect]:
    """What the sea brings: growth, corrosion, water inside."""
    growth = {"high": 0.3, "tolerance": 0.005, "prior_scale": 0.05, "check": "ROV survey",
              "time_profiles": ("constant", "step", "ramp")}
    yield _row("growth_all", "growth", "marine growth", "all members", low=-d.values["mg"],
               signature="second bending falls", **growth)
    # less than assumed on a leg, in a bay and everywhere at once would be less than none
    for leg in _legs(d) if _reaches(d, below=d.hydrodynamics.growth_top_m) else ():
        yield _row(f"growth_{leg}", "growth", "marine growth", f"leg {leg}", low=0.0,
                   on={"group": "leg", "leg": leg}, signature="second bending falls, one side", **growth)
    band = (d.corrosion.bottom_m, d.corrosion.top_m)
    corroded = {"low": 0.0, "high": min(0.008, _largest_corrosion(d)), "tolerance": 5e-4, "prior_scale": 2e-3,
                "time_profiles": ("constant", "step", "ramp"), "check": "measure wall thickness"}
    yield _row("corrosion_all", "corrosion", "corrosion", "legs and braces in the splash zone" if _legs(d) else
               "monopile in the splash zone", on={"level_m": band},
               signature="stiffness and mass at the water line", **corroded)
    for leg in _legs(d) if _reaches(d, below=band[1], above=band[0]) else ():
        yield _row(f"corrosion_{leg}", "corrosion", "corrosion", f"leg {leg}",
                   on={"group": "leg", "leg": leg, "level_m": band}, signature="as a crack of that leg, small",
                   **corroded)
    flooded = {"tolerance": 0.0, "prior_scale": 0.5, "check": "flooded-member detection by ultrasound"}
    if isinstance(d, JacketTurbine):
        yield from _water_of_bays(d, growth, flooded)
    elif isinstance(d, MonopileTurbine) and d.monopile.flooded:
        yield _row("flood_monopile", "flooding", "monopile not flooded", "monopile",
                   on={"group": "pile", "level_m": (d.site.mudline_m, d.site.water_level_m)}, low=-1.0, high=0.0,
                   signature="second bending rises", **(flooded | {"check": "water level inside"}))


def _reaches(d: Offshore, below: float, above: float = -np.inf) -> bool:
    """Whether a jacket's legs have a part between two levels."""
    return isinstance(d, JacketTurbine) and d.jacket.bottom.z_m < below and d.jacket.top.z_m > above


def _water_of_bays(d: JacketTurbine, growth: dict, flooded: dict) -> Iterator[Effect]:
    for bay in _bays(d):
        levels = d.jacket.bay[bay - 1].bottom_m, d.jacket.bay[bay - 1].top_m
        if levels[0] < d.hydrodynamics.growth_top_m:
            yield _row(f"growth_bay_{bay}", "growth", "marine growth", f"bay {bay}", low=0.0, on={"level_m": levels},
                       signature="second bending falls", **growth)
        if levels[0] >= d.site.water_level_m:
            continue
        for face in d.jacket.faces:
            yield _row(f"flood_brace_{face}_{bay}", "flooding", "flooded braces", f"face {face}, bay {bay}",
                       on={"group": "brace", "face": face, "bay": bay}, low=0.0, high=1.0,
                       signature="second bending falls", **flooded)
    if d.jacket.flooded:
        for leg in d.jacket.leg_names:
            yield _row(f"flood_leg_{leg}", "flooding", "leg not flooded", f"leg {leg}",
                       on={"group": "leg", "leg": leg}, low=-1.0, high=0.0,
                       signature="second bending rises, one side", **flooded)


def _masses(d: Description) -> Iterator[Effect]:
    heaviest = max(d.rna, key=lambda b: b.mass_kg)
    yield _row("rna_mass", "mass", "nacelle mass", heaviest.name, on={"body": heaviest.name},
               low=-0.3 * heaviest.mass_kg, high=0.5 * heaviest.mass_kg, tolerance=0.01 * heaviest.mass_kg,
               prior_scale=0.1 * heaviest.mass_kg, signature="first bending falls",
               check="weighing protocol of the nacelle")
    for axis in "xyz":
        yield _row(f"rna_{axis}", "centre_of_mass", "RNA centre of mass", f"along the nacelle's {axis}",
                   settings={"axis": axis}, low=-3.0, high=3.0, tolerance=0.1, prior_scale=0.5,
                   signature="torsion couples with bending", check="weighing protocol of the nacelle")
    # what turns with the rotor is stated in many ways, so that one range serves all axes
    most = max(sum(body.inertia_kgm2[k] for body in d.rna) for k in range(3))
    for axis, k in zip("xyz", range(3), strict=True):
        inertia = sum(body.inertia_kgm2[k] for body in d.rna) + 1e6
        yield _row(f"rna_i{axis}", "inertia", "RNA inertia", f"about the nacelle's {axis}", on={"body": heaviest.name},
                   settings={"axis": axis}, low=-0.5 * heaviest.inertia_kgm2[k], high=3.0 * most,
                   tolerance=0.02 * inertia, prior_scale=0.3 * most,
                   signature="torsion (about z), split of FA and SS (about x, y)", check="the maker's data sheet")
    for low, high in station_pairs(d.tower.station):
        own = _tube_mass(d, 0.5 * (low.diameter_m + high.diameter_m), 0.5 * (low.thickness_m + high.thickness_m),
                         high.z_m - low.z_m)
        band = (low.z_m, high.z_m)
        where = f"{low.z_m:g} to {high.z_m:g} m"
        yield _row(f"tower_mass_{low.z_m:g}".replace(".", "_"), "mass", "tower mass", where,
                   on={"group": "tower", "level_m": band}, low=-0.3 * own, high=2.0 * own, tolerance=0.02 * own,
                   prior_scale=0.2 * own, signature="first or second bending falls",
                   check="weight report: platforms, cables, damper")
        yield _row(f"tower_stiffness_{low.z_m:g}".replace(".", "_"), "stiffness", "tower stiffness", where,
                   on={"group": "tower", "level_m": band}, low=-0.8, high=1.0, tolerance=0.01, prior_scale=0.2,
                   signature="curvature of the tower's shapes", check="wall thicknesses, cracks")
    own = _transition_piece_mass(d)
    if own:
        yield _row("tp_mass", "mass", "transition-piece mass", "column" if isinstance(d, JacketTurbine) else
                   "transition piece", on={"group": "column"}, low=-0.5 * own,
                   high=3.0 * own, tolerance=0.03 * own, prior_scale=0.5 * own,
                   signature="second bending falls", check="weight report of the transition piece")
    if any(body.name == "hub" for body in d.rna):
        yield _row("blades", "oscillator", "blade coupling", "rotor, fore-aft", on={"body": "hub"}, low=0.0, high=0.6,
                   settings={"axis": "x", "frequency_hz": FLAP_HZ}, tolerance=0.01, prior_scale=0.1,
                   signature="fore-aft alone, shape at the top",
                   check="the blades' flapwise frequency, edge sensors")


def _transition_piece_mass(d: Description) -> float:
    """kg; 0 without one."""
    if isinstance(d, JacketTurbine):
        top = d.transition_piece
        return top.lumped_mass_kg + _tube_mass(
            d, top.column.diameter_m, top.column.thickness_m, top.strut_top_m - top.column_bottom_m)
    if isinstance(d, MonopileTurbine) and d.transition_piece is not None:
        own = d.transition_piece
        return own.lumped_mass_kg + _tube_mass(d, own.tube.diameter_m, own.tube.thickness_m,
                                               d.tower.station[0].z_m - own.bottom_m)
    return 0.0


def _ice_inertia(d: Description) -> tuple[float, ...]:
    """m2 about the hub's axes per kg of ice on the blades."""
    hub = next(body for body in d.rna if body.name == "hub")
    return tuple(ICE_OUTWARD * inertia / hub.mass_kg for inertia in hub.inertia_kgm2)


def _environment(d: Description) -> Iterator[Effect]:
    row = partial(_row, group="environmental")
    if isinstance(d, Offshore):
        yield row("water", "water_level", "wetted length", "all members", low=-6.0, high=6.0, tolerance=0.0,
                  prior_scale=1.0, time_profiles=("water_level_m",), unit="m",
                  signature="second bending falls with the water level",
                  check="tide gauge against the second bending")
        dry = {"level_m": (d.site.water_level_m, d.tower.station[-1].z_m)}
    else:
        dry = {"level_m": (d.tower.station[0].z_m, d.tower.station[-1].z_m)}
    # steel under water has the sea's temperature, which hardly moves within a month
    yield row("warm", "temperature", "temperature of the steel",
              "above the water" if isinstance(d, Offshore) else "tower", on=dry, low=-80.0, high=80.0,
              tolerance=0.0, prior_scale=1.5, settings={"relative_per_degc": STEEL_PER_DEGC},
              time_profiles=("air_temperature_c",), unit="degC", odds=WARMS_ODDS,
              signature="all frequencies fall with temperature", check="steel temperature sensors")
    # along a straight tower a force across it is not an axial one: there is nothing whose geometric stiffness it
    # changes
    if isinstance(d, JacketTurbine):
        yield row("thrust", "thrust", "rotor thrust", "hub", low=-5e6, high=5e6, tolerance=0.0, prior_scale=5e5,
                  time_profiles=("thrust_share",), signature="first bending falls with thrust",
                  check="tower bending strain")
    yield row("weight", "weight", "P-delta of the weight", "all members", tolerance=0.0, prior_scale=0.5,
              time_profiles=("constant",), low=-1.0 if d.mesh.geometric_stiffness else 0.0, high=2.0,
              signature="first bending falls", check="whether the model's mesh.geometric_stiffness is on")
    yield row("ice_tower", "mass", "icing", "tower", on={"group": "tower"}, low=0.0, high=4e4, tolerance=0.0,
              prior_scale=5e3, time_profiles=("step", "frost_degc"),
              signature="first and second bending fall while it freezes",
              check="ice detector, inspection")
    yield row("ice", "mass", "icing", "rotor", on={"body": "hub"}, settings={"inertia_per_kg_m2": _ice_inertia(d)},
              low=0.0, high=4e4, tolerance=0.0, prior_scale=5e3, time_profiles=("step", "frost_degc"),
              signature="first bending and torsion fall while it freezes", check="ice detector, power curve")
    if isinstance(d, Offshore):
        yield from _softening_effect(d)


def _softening_effect(d: Offshore) -> Iterator[Effect]:
    row, whole = partial(_row, group="environmental"), _soil_part(d)
    for curve, where in (("all", whole), ("py", f"{whole}, lateral"), ("tz", f"{whole}, axial")):
        yield row(f"soft_{curve}", "soil", "soil softens with amplitude", where,
                  settings={"curve": curve}, low=-0.95, high=3.0, tolerance=0.0, prior_scale=0.3,
                  time_profiles=("rms_mps2", "wave_height_m"),
                  signature="second bending falls in storms, not with thrust",
                  check="storms of equal wind, other sea")


def _heights(d: Description, sensors: Sequence[Sensor]) -> Iterator[Effect]:
    """Of every sensor, and of a level's together: the model shows how the shapes go on along the member."""
    frame = build_frame(d)
    found = attachments(frame, sensors, {s.channel: s.part for s in d.sensor}, d.name)
    lines = [line_of(frame, at) for at in found]
    numbers = {s.channel: k for k, s in enumerate(sensors)}
    taken: set[str] = set()
    for name, rows in sensor_groups(sensors, numbers):
        own = [line.ends for k in rows if (line := lines[k]) is not None]
        if len(own) < len(rows):
            continue
        low = max(-HEIGHT_REACH_M, *(low for low, _ in own))
        high = min(HEIGHT_REACH_M, *(high for _, high in own))
        # a sensor at a member's end is there but for rounding
        low, high = round(min(low, 0.0), 2), round(max(high, 0.0), 2)
        if max(-low, high) < LEAST_REACH_M:
            continue
        parameter = f"height_{re.sub(r'[^0-9A-Za-z]+', '_', name)}"
        while parameter in taken:
            parameter += "_"
        taken.add(parameter)
        yield _row(parameter, "sensor_height", "sensor at another height", name, group="measurement",
                   settings={"channels": tuple(sensors[k].channel for k in rows)}, low=low, high=high, tolerance=0.0,
                   prior_scale=HEIGHT_SCALE_M,
                   signature="all channels of one place show the shapes of another height: each mode by its own share",
                   check="measure the sensor's height on site, against position_m in the campaign's description")
