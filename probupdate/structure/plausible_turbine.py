"""What of a turbine's description no turbine is likely to have beside its other numbers, as digits and units miswritten
give: walls beside diameters, members beside those that they meet, masses beside what carries them.

Each is said and none refused: a structure may be the first of its kind.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np

from probupdate.structure.description import (
    Description,
    FoundationTurbine,
    JacketTurbine,
    MonopileTurbine,
    Offshore,
    Section,
    Steel,
)
from probupdate.structure.description_checks import tubes_of
from probupdate.structure.plausible_size import top_words

# key, what it is there, so many times what, from, to
Ratio = tuple[str, float, str, float, float]
# diameters over walls: API's and ISO's of members in water end at 120, towers' at 320
LEAST_SLENDER, MOST_SLENDER, MOST_SLENDER_DRY = 8.0, 200.0, 400.0
# of sections one above the other
NEXT_DIAMETER, NEXT_WALL = 3.0, 4.0
# m/s along a bar (concrete has 3500, carbon fibres 10000), and its density
STEEL_SOUND, STEEL_KGPM3 = 5172.0, 7850.0


def odd_sizes(d: Description) -> tuple[str, ...]:
    """Sentences on what is out of proportion, '()' where nothing is."""
    said = [f"{key} is implausible: {value:.3g} times {other}, {low:g} to {high:g} are usual; check its digits and unit"
            for ratios in RATIOS for key, value, other, low, high in ratios(d) if not low <= value <= high]
    return (*said, *_tops(d))


def _walls(d: Description) -> Iterator[Ratio]:
    for key, diameter, wall in tubes_of(d):
        dry = key.startswith(("tower", "monopile", "transition_piece"))
        yield (f"{key}.thickness_m = {wall:g}", wall / diameter, f"the diameter of {diameter:g} m",
               1 / (MOST_SLENDER_DRY if dry else MOST_SLENDER), 1 / LEAST_SLENDER)


def _next_to_each_other(d: Description) -> Iterator[Ratio]:
    for part, stations in d.tapers.items():
        for k, (a, b) in enumerate(pairwise(stations)):
            for name, most in (("diameter_m", NEXT_DIAMETER), ("thickness_m", NEXT_WALL)):
                one, other = getattr(b, name), getattr(a, name)
                yield f"{part}.station[{k + 2}].{name} = {one:g}", one / other, "the one below", 1 / most, most


def _jacket(d: Description) -> Iterator[Ratio]:
    if not isinstance(d, JacketTurbine):
        return
    jacket, tp, leg, foot = d.jacket, d.transition_piece, d.jacket.leg, d.tower.station[0]
    for k, bay in enumerate(jacket.bay):
        yield (f"jacket.bay[{k + 1}].brace.diameter_m = {bay.brace.diameter_m:g}",
               bay.brace.diameter_m / leg.diameter_m, f"the leg's {leg.diameter_m:g} m", 0.15, 1.05)
    for key, own, other, what, low, high in (
        ("pile.diameter_m", d.pile.diameter_m, leg.diameter_m, "the leg's", 0.5, 5.0),
        ("transition_piece.column.diameter_m", tp.column.diameter_m, foot.diameter_m, "the tower's foot's", 0.3, 3.0),
        ("transition_piece.strut.diameter_m", tp.strut.diameter_m, tp.column.diameter_m, "the column's", 0.05, 1.05),
        ("transition_piece.tie.diameter_m", tp.tie.diameter_m, tp.column.diameter_m, "the column's", 0.03, 1.05),
        ("jacket.top.leg_spacing_m", jacket.top.leg_spacing_m, leg.diameter_m, "the leg's diameter,", 1.5, 40.0),
        ("jacket.bottom.leg_spacing_m", jacket.bottom.leg_spacing_m, jacket.top.leg_spacing_m, "that at the top,",
         0.5, 8.0),
        ("jacket.bottom.leg_spacing_m", jacket.bottom.leg_spacing_m, jacket.top.z_m - jacket.bottom.z_m,
         "the jacket's height of", 0.05, 2.0),
    ):
        yield f"{key} = {own:g}", own / other, f"{what} {other:g} m", low, high
    yield from _embedded(d, "pile.tip_m", d.pile.diameter_m, 2.0, 150.0)


def _embedded(d: Offshore, key: str, diameter: float, low: float, high: float) -> Iterator[Ratio]:
    depth = d.site.mudline_m - d.pile_tip_m
    yield (f"{key} = {d.pile_tip_m:g}, {depth:g} m below the mudline,", depth / diameter,
           f"the pile's diameter of {diameter:g} m", low, high)


def _monopile(d: Description) -> Iterator[Ratio]:
    if not isinstance(d, MonopileTurbine):
        return
    yield from _embedded(d, "monopile.station[1].z_m", d.monopile.station[0].diameter_m, 1.0, 25.0)
    top, foot, piece = d.monopile.station[-1], d.tower.station[0], d.transition_piece
    if piece is None:
        yield (f"tower.station[1].diameter_m = {foot.diameter_m:g}", foot.diameter_m / top.diameter_m,
               f"the monopile's top's {top.diameter_m:g} m", 0.5, 2.0)
        return
    tube = piece.tube
    yield (f"transition_piece.tube.diameter_m = {tube.diameter_m:g}", tube.diameter_m / foot.diameter_m,
           f"the tower's foot's {foot.diameter_m:g} m", 0.5, 2.0)
    if piece.flange is not None:
        # bending stiffness of a tube over one diameter
        tube_nmprad = d.steel.youngs_modulus_pa * np.pi / 8 * tube.diameter_m**2 * tube.thickness_m
        yield (f"transition_piece.flange.bending_stiffness_nmprad = {piece.flange.bending_stiffness_nmprad:g}",
               piece.flange.bending_stiffness_nmprad / tube_nmprad, "that of a diameter of the tube", 0.1, np.inf)
        yield from _flange("transition_piece.flange.mass_kg", piece.flange.mass_kg, tube.diameter_m, tube.thickness_m,
                           d.steel)


def _flange(key: str, mass_kg: float, diameter: float, wall: float, steel: Steel) -> Iterator[Ratio]:
    if mass_kg > 0:
        line = steel.density_kgpm3 * np.pi * (diameter - wall) * wall
        yield f"{key} = {mass_kg:g}", mass_kg / line, f"the tube's {line:.3g} kg a metre", 0.02, 20.0


def _tower(d: Description) -> Iterator[Ratio]:
    stations = d.tower.station
    height, foot = stations[-1].z_m - stations[0].z_m, stations[0]
    yield (f"tower.station[{len(stations)}].z_m = {stations[-1].z_m:g}, {height:g} m above the foot,",
           height / foot.diameter_m, f"the foot's diameter of {foot.diameter_m:g} m", 2.0, 60.0)
    for k, s in enumerate(stations):
        yield from _flange(f"tower.station[{k + 1}].flange_kg", s.flange_kg, s.diameter_m, s.thickness_m, d.steel)
    if d.tower.secondary_steel_kgpm > 0:
        line = tower_kg(d, 0.0) / height
        yield (f"tower.secondary_steel_kgpm = {d.tower.secondary_steel_kgpm:g}", d.tower.secondary_steel_kgpm / line,
               f"the tube's {line:.3g} kg a metre", 1e-3, 1.0)
    for body in d.rna:
        far = float(np.max(np.abs(body.offset_m)))
        yield f"rna {body.name}.offset_m, {far:g} m at most,", far / height, "the tower's height", 0.0, 1 / 3


def _levels(d: Description) -> Iterator[Ratio]:
    """Levels between tip and tower's top as shares of that length."""
    if not isinstance(d, Offshore):
        return
    length = d.tower.station[-1].z_m - d.pile_tip_m
    for key, level in (("hydrodynamics.growth_top_m", d.hydrodynamics.growth_top_m),
                       ("corrosion.bottom_m", d.corrosion.bottom_m), ("corrosion.top_m", d.corrosion.top_m)):
        yield (f"{key} = {level:g}", (level - d.pile_tip_m) / length,
               f"the length of {length:.3g} m upwards from the pile's tip", 0.0, 1.0)


def _masses(d: Description) -> Iterator[Ratio]:
    total = sum(body.mass_kg for body in d.rna)
    piece = getattr(d, "transition_piece", None)
    if piece is not None and piece.lumped_mass_kg > 0 and total > 0:
        yield (f"transition_piece.lumped_mass_kg = {piece.lumped_mass_kg:g}", piece.lumped_mass_kg / total,
               f"rotor and nacelle's {total:g} kg", 1e-3, 3.0)
    for body in d.rna:
        x, y, z = body.inertia_kgm2
        if body.mass_kg > 0 and max(x, y, z) > 0:
            ball = 0.4 * body.mass_kg * (0.75 * body.mass_kg / (np.pi * STEEL_KGPM3)) ** (2 / 3)
            yield (f"rna {body.name}.inertia_kgm2, {max(x, y, z):g} at most,", max(x, y, z) / ball,
                   f"a steel ball's of its mass ({ball:.2g} kg m2)", 1.0, np.inf)
        if y > 0 and z > 0:
            yield f"rna {body.name}.inertia_kgm2, {y:g} about y,", y / z, f"{z:g} about z", 1 / 6, 6.0
            yield f"rna {body.name}.inertia_kgm2, {x:g} about x,", x / (y + z), "those about y and z together", 0.0, 1.0
        if body.name == "hub" and body.mass_kg > 0:
            yield (f"rna hub.mass_kg = {body.mass_kg:g}", body.mass_kg / d.values["m_h"],
                   f"parameter m_h's {d.values['m_h']:g} kg, which stands for it,", 0.5, 2.0)


def _materials(d: Description) -> Iterator[Ratio]:
    grout = getattr(getattr(d, "transition_piece", None), "grout", None)
    for key, material in (("steel", d.steel), ("transition_piece.grout", grout)):
        if material is not None:
            speed = (material.youngs_modulus_pa / material.density_kgpm3) ** 0.5
            yield (f"{key}.youngs_modulus_pa = {material.youngs_modulus_pa:g} with density_kgpm3 = "
                   f"{material.density_kgpm3:g}", speed / STEEL_SOUND, "the speed of sound in steel", 0.4, 2.4)
            if material.poisson_ratio > 0:
                yield f"{key}.poisson_ratio = {material.poisson_ratio:g}", material.poisson_ratio, "one", 0.1, 0.5


def _foundation(d: Description) -> Iterator[Ratio]:
    if isinstance(d, FoundationTurbine) and d.foundation.rocking_nmprad is not None:
        foot = d.tower.station[0]
        tube = d.steel.youngs_modulus_pa * np.pi / 8 * foot.diameter_m**2 * foot.thickness_m
        yield (f"foundation.rocking_nmprad = {d.foundation.rocking_nmprad:g}", d.foundation.rocking_nmprad / tube,
               "that of a diameter of the tower's foot", 0.01, np.inf)


RATIOS: tuple[Callable[[Description], Iterator[Ratio]], ...] = (
    _walls, _next_to_each_other, _jacket, _monopile, _tower, _levels, _masses, _materials, _foundation)


def tower_kg(d: Description, secondary_kgpm: float) -> float:
    """Of its tubes, straight between stations, and other steel along it."""
    def line(s: Section) -> float:
        return secondary_kgpm + d.steel.density_kgpm3 * np.pi * (s.diameter_m - s.thickness_m) * s.thickness_m

    return float(sum((b.z_m - a.z_m) * 0.5 * (line(a) + line(b)) for a, b in pairwise(d.tower.station)))


def _tops(d: Description) -> tuple[str, ...]:
    """Rotor and nacelle beside the tower, by `top_words`."""
    kg = {body.name: body.mass_kg for body in d.rna} | {"hub": d.values["m_h"]}
    stations = d.tower.station
    tower = tower_kg(d, d.tower.secondary_steel_kgpm) + sum(s.flange_kg for s in stations)
    return top_words([(f"rna {body.name}", kg[body.name], max(body.inertia_kgm2)) for body in d.rna], tower,
                     stations[-1].z_m - stations[0].z_m)
