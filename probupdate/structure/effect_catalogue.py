"""The structural effects a turbine may have, each leg, face, bay and level on its own, with a prior as a candidate.

The deviations are what an engineer would call a notable case of each, not a tolerance; the bounds are what may exist.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

from probupdate.structure.beam import Tube
from probupdate.structure.description import Description, read_description
from probupdate.structure.extend import Effect
from probupdate.structure.joints import joint_law

# relative change of E per degree near room temperature: 202 GPa at 25 and 198 GPa at 100 degC for carbon steel
# (ASME BPVC II-D, table TM-1)
STEEL_PER_DEGC = -2.6e-4
# first collective flap of a 5-MW rotor's blades (Jonkman et al. 2009, table 9-1); edit it for another rotor
FLAP_HZ = 0.7


def effect_catalogue(path: str | Path, *, single_members: bool = False) -> tuple[Effect, ...]:
    """Every effect that the model of a model.toml can carry; with single_members also single braces and joints."""
    return described_catalogue(read_description(path), single_members=single_members)


def described_catalogue(d: Description, *, single_members: bool = False) -> tuple[Effect, ...]:
    found = [*_members(d), *_joints(d), *_connections(d), *_soil(d), *_water(d), *_nacelle(d), *_whole(d)]
    if single_members:
        found += _single(d)
    return tuple(found)


def _sides(d: Description) -> list[str]:
    legs = d.jacket.leg_names
    return [first + second for first, second in zip(legs, (*legs[1:], legs[0]), strict=True)]


def _factor(name: str, cause: str, location: str, on: dict, **settings) -> Effect:
    """A stiffness that may be lost or doubled."""
    lower = 0.0 if settings.get("motion") == "axial" else 0.05
    return Effect(name=name, kind="stiffness", on=on, settings=settings, std=0.3, lower=lower, upper=2.0, cause=cause,
                  location=location)  # fmt: skip


def _members(d: Description) -> Iterator[Effect]:
    bays = range(1, len(d.jacket.bay) + 1)
    for bay in bays:
        for face in _sides(d):
            # a braced face works by the braces' axial stiffness; it alone may vanish without freeing any node
            yield _factor(f"brace_{face}_{bay}", "brace loss or crack", f"face {face}, bay {bay}",
                          {"group": "brace", "face": face, "bay": bay}, motion="axial")  # fmt: skip
    for bay in bays:
        for leg in d.jacket.leg_names:
            yield _factor(f"leg_{leg}_{bay}", "leg crack", f"leg {leg}, bay {bay}",
                          {"group": "leg", "leg": leg, "bay": bay})  # fmt: skip
    for group in ("strut", "tie"):
        for leg in d.jacket.leg_names:
            yield _factor(f"{group}_{leg}", "transition-piece flexibility", f"{group} {leg}",
                          {"group": group, "leg": leg})  # fmt: skip
    yield _factor("column", "transition-piece flexibility", "column", {"group": "column"})
    for low, high in pairwise(d.tower.station):
        band = (low.z_m, high.z_m)
        yield _factor(f"tower_{low.z_m:g}", "tower stiffness", f"tower, {low.z_m:g} to {high.z_m:g} m",
                      {"group": "tower", "level_m": band})  # fmt: skip
        yield Effect(name=f"tower_mass_{low.z_m:g}", kind="mass", on={"group": "tower", "level_m": band}, std=5000.0,
                     lower=-10000.0, upper=40000.0, cause="tower mass",
                     location=f"tower, {low.z_m:g} to {high.z_m:g} m")  # fmt: skip


def _loose(name: str, location: str, on: dict) -> Effect:
    return Effect(name=name, kind="joint", on=on, std=0.7, lower=1e-3, upper=4.0, prior="lognormal",
                  cause="joint loosening", location=location)  # fmt: skip


def _joints(d: Description) -> Iterator[Effect]:
    if joint_law(d.jacket.joints.law) is None:
        return
    for bay in range(1, len(d.jacket.bay) + 1):
        for face in _sides(d):
            yield _loose(f"joint_{face}_{bay}", f"brace ends of face {face}, bay {bay}", {"face": face, "bay": bay})


def _single(d: Description) -> Iterator[Effect]:
    for bay in range(1, len(d.jacket.bay) + 1):
        for face in _sides(d):
            for part in (face, face[::-1]) if len(face) == 2 else _directions(d, face):
                brace = f"brace {part}-{bay}"
                yield _factor(f"brace_{part}_{bay}_alone", "brace loss or crack", brace, {"part": brace},
                              motion="axial")  # fmt: skip
                if joint_law(d.jacket.joints.law) is None:
                    continue
                for leg in _legs_of(d, face):
                    yield _loose(f"joint_{part}_{bay}_at_{leg}", f"{brace} at leg {leg}", {"part": brace, "leg": leg})


def _legs_of(d: Description, face: str) -> tuple[str, str]:
    names = d.jacket.leg_names
    pairs = zip(names, (*names[1:], names[0]), strict=True)
    return next(pair for pair in pairs if pair[0] + pair[1] == face)


def _directions(d: Description, face: str) -> tuple[str, str]:
    first, second = _legs_of(d, face)
    return first + second, second + first


def _bending(d: Description, diameter_m: float, thickness_m: float) -> float:
    """Flexibility in rad/(GN m) of three diameters of a tube: a connection as soft as that would be noticed."""
    tube = Tube(diameter_m=diameter_m, thickness_m=thickness_m)
    return 1e9 * 3 * diameter_m / (d.steel.youngs_modulus_pa * tube.second_moment({}))


def _stretching(d: Description, diameter_m: float, thickness_m: float) -> float:
    """The same along its axis, m/GN."""
    tube = Tube(diameter_m=diameter_m, thickness_m=thickness_m)
    return 1e9 * 3 * diameter_m / (d.steel.youngs_modulus_pa * tube.area({}))


def _connections(d: Description) -> Iterator[Effect]:
    for station in d.tower.station:
        scale = _bending(d, station.diameter_m, station.thickness_m)
        yield Effect(name=f"flange_{station.z_m:g}", kind="hinge", on={"group": "tower"},
                     settings={"at_m": station.z_m}, std=scale, lower=0.0, upper=20 * scale,
                     cause="tower-flange flexibility", location=f"tower at {station.z_m:g} m")  # fmt: skip
    head, leg = d.jacket.bottom.z_m, d.jacket.leg
    for kind, name, scale in (("hinge", "grout", _bending(d, leg.diameter_m, leg.thickness_m)),
                              ("slip", "grout_slip", _stretching(d, leg.diameter_m, leg.thickness_m))):  # fmt: skip
        for end, words, on in _places(d):
            yield Effect(name=name + end, kind=kind, on={"group": "pile"} | on, settings={"at_m": head}, std=scale,
                         lower=0.0, upper=20 * scale, cause="grout flexibility", location=words)  # fmt: skip


def _places(d: Description) -> list[tuple[str, str, dict]]:
    """(end of a name, words, on): all legs and each."""
    return [("", "all legs", {}), *((f"_{leg}", f"leg {leg}", {"leg": leg}) for leg in d.jacket.leg_names)]


def _soil(d: Description) -> Iterator[Effect]:
    deepest = 0.25 * (d.site.mudline_m - d.pile.tip_m)
    low = min((p.lower if p.update else p.initial) for p in d.parameter if p.name == "sc") if any(
        p.name == "sc" for p in d.parameter) else 0.0  # fmt: skip
    for end, words, on in _places(d):
        yield Effect(name=f"scour{end}", kind="scour", on=on, std=1.0, lower=max(-low, 0.0), upper=deepest,
                     cause="scour", location=words)  # fmt: skip
    for curve, cause in (("py", "lateral soil"), ("tz", "axial soil"), ("qw", "pile tip")):
        for end, words, on in _places(d):
            yield Effect(name=f"{cause.split()[0]}_{curve}{end}", kind="soil", on=on, settings={"curve": curve},
                         std=0.5, lower=0.05, upper=20.0, prior="lognormal", cause=cause, location=words)  # fmt: skip


def _water(d: Description) -> Iterator[Effect]:
    for end, words, on in _places(d):
        chosen = {"group": "leg"} | on if on else {}
        yield Effect(name=f"growth{end}", kind="growth", on=chosen, std=0.05, lower=0.0, upper=0.3,
                     cause="marine growth", location=words)  # fmt: skip
        yield Effect(name=f"corrosion{end}", kind="corrosion", on={"group": "leg"} | on, std=0.002, lower=0.0,
                     upper=0.2 * d.jacket.leg.thickness_m, cause="corrosion", location=words)  # fmt: skip
        if d.jacket.flooded:
            yield Effect(name=f"dry_leg{end}", kind="flooding", on={"group": "leg"} | on, std=0.5, lower=-1.0,
                         upper=0.0, cause="leg not flooded", location=words)  # fmt: skip
    for number, bay in enumerate(d.jacket.bay, 1):
        if bay.bottom_m >= d.site.water_level_m:
            continue
        yield Effect(name=f"growth_bay_{number}", kind="growth", on={"level_m": (bay.bottom_m, bay.top_m)}, std=0.05,
                     lower=0.0, upper=0.3, cause="marine growth", location=f"bay {number}")  # fmt: skip
        for face in _sides(d):
            yield Effect(name=f"flooded_{face}_{number}", kind="flooding", std=0.5, lower=0.0, upper=1.0,
                         on={"group": "brace", "face": face, "bay": number}, cause="flooded braces",
                         location=f"face {face}, bay {number}")  # fmt: skip


def _nacelle(d: Description) -> Iterator[Effect]:
    heaviest = max(d.rna, key=lambda body: body.mass_kg)
    yield Effect(name="rna_mass", kind="mass", on={"body": heaviest.name}, std=0.05 * heaviest.mass_kg,
                 lower=-0.4 * heaviest.mass_kg, upper=0.4 * heaviest.mass_kg, cause="RNA mass",
                 location=heaviest.name)  # fmt: skip
    for number, axis in enumerate("xyz"):
        yield Effect(name=f"rna_{axis}", kind="centre_of_mass", settings={"axis": axis}, std=0.5, lower=-3.0, upper=3.0,
                     cause="RNA centre of mass", location=f"nacelle {axis}")  # fmt: skip
        body = max(d.rna, key=lambda body: body.inertia_kgm2[number])
        own = body.inertia_kgm2[number]
        scale = max(own, 0.05 * max(body.inertia_kgm2))
        yield Effect(name=f"rna_i{axis}{axis}", kind="inertia", on={"body": body.name}, settings={"axis": axis},
                     std=0.2 * scale, lower=-0.9 * own, upper=2.0 * scale, cause="RNA inertia",
                     location=f"{body.name} about its {axis}")  # fmt: skip


def _whole(d: Description) -> Iterator[Effect]:
    hub = next(body for body in d.rna if body.name == "hub")
    # ice lies along the blades as their own mass does
    per_kg = tuple(inertia / hub.mass_kg for inertia in hub.inertia_kgm2)
    yield Effect(name="ice_blades", kind="mass", on={"body": "hub"}, settings={"inertia_per_kg_m2": per_kg}, std=5000.0,
                 lower=0.0, upper=30000.0, cause="icing", location="blades")  # fmt: skip
    yield Effect(name="ice_tower", kind="mass", on={"group": "tower"}, std=5000.0, lower=0.0, upper=50000.0,
                 cause="icing", location="tower")  # fmt: skip
    yield Effect(name="temperature", kind="temperature", settings={"relative_per_degc": STEEL_PER_DEGC}, std=10.0,
                 lower=-60.0, upper=60.0, cause="steel temperature", location="all steel")  # fmt: skip
    yield Effect(name="water_level", kind="water_level", std=1.0, lower=-4.0, upper=4.0, cause="water level",
                 location="all members")  # fmt: skip
    yield Effect(name="weight", kind="weight", std=0.5, lower=-1.0 if d.mesh.geometric_stiffness else 0.0, upper=2.0,
                 cause="P-delta of the weight", location="all members")  # fmt: skip
    yield Effect(name="thrust", kind="thrust", std=5e5, lower=-2e6, upper=2e6, cause="P-delta of the thrust",
                 location="all members")  # fmt: skip
    yield Effect(name="blades", kind="oscillator", on={"body": "hub"}, std=0.1, lower=1e-5, upper=0.6,
                 settings={"axis": "x", "frequency_hz": FLAP_HZ}, cause="blade coupling",
                 location="rotor, fore-aft")  # fmt: skip
