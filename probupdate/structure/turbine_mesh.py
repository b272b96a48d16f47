"""The mesh of a turbine while it is made: members cut into elements, with what surrounds and fills them, piles in the
soil, and the tower. What stands below a tower adds its own (`jacket_frame`, `monopile_frame`).

Members are cut where what surrounds them changes (water level, growth, splash zone, mudline) and then to at most their
length over `elements_per_member`, so that every element has one section and one surrounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple, cast

import numpy as np

from probupdate.structure import soil
from probupdate.structure.beam import Tube
from probupdate.structure.coefficient import Coefficient, inverse, parameter, product
from probupdate.structure.description import Description, Group, Offshore, TubeEntry, tube_between_stations
from probupdate.structure.effects import Effects, Place, bay_at, ends
from probupdate.structure.frame import Beam, Body, LineMass, LineSpring, NodeSpring, Tie
from probupdate.structure.local_functions import PileMoments, Warmth, Water, Wetting

# Rows of Table 2 that act on E of members of a group
STIFFNESS = {"leg": "k_j", "brace": "k_j", "pile": "k_p", "column": "k_TP", "strut": "k_TP", "tie": "k_TP",
             "tower": "k_t"}
# groups on whose walls corr acts in the splash zone
CORRODES = {"jacket": ("leg", "brace"), "monopile": ("pile", "column")}
SAME_POINT_M = 1e-6


class Segment(NamedTuple):
    """An element to be: its nodes, and the level at whose section, water and growth it is built."""

    start: int
    end: int
    z_m: float


class Member(NamedTuple):
    """What an element is part of; leg for those of one leg, face and bay (None: of the legs, by the level)."""

    group: str
    part: str
    leg: str | None = None
    face: str | None = None
    bay: int | None = None


class Mesh:
    """Collects nodes and members while the frame is built."""

    def __init__(self, description: Description):
        self.d = description
        self.effects = Effects(description)
        self.nodes: list[np.ndarray] = []
        self.beams: list[Beam] = []
        self.places: list[Place] = []
        self.ties: list[Tie] = []
        self.cuts: tuple[float, ...] = ()
        self.rise: tuple[str, ...] = ()
        if isinstance(description, Offshore):
            site, water, splash = description.site, description.hydrodynamics, description.corrosion
            self.cuts = (site.water_level_m, water.growth_top_m, splash.bottom_m, splash.top_m, site.mudline_m)
            rises = self.effects.on_all("water_level")
            self.rise = tuple(p.name for p in rises)
            self.tide = (site.water_level_m + sum(min(ends(p)[0], 0.0) for p in rises),
                         site.water_level_m + sum(max(ends(p)[1], 0.0) for p in rises))

    def node(self, position) -> int:
        self.nodes.append(np.array(position, float))
        return len(self.nodes) - 1

    def chain(
        self, start: int, end: int, group: str, *, cut: bool = True, at_m: tuple[float, ...] = (),
        number: int | None = None,
    ) -> list[Segment]:
        """Elements from start to end, with nodes at the levels at_m too; `number` of them at least, in place of
        elements_per_member."""
        a, b = self.nodes[start], self.nodes[end]
        stops = {0.0, 1.0}
        rise = b[2] - a[2]
        if cut and abs(rise) > SAME_POINT_M:
            stops |= _levels_inside((*self.cuts, *at_m), a[2], rise)
        number = number or self.d.mesh.elements_per_member[cast(Group, group)]
        fractions = [0.0]
        for low, high in pairwise(sorted(stops)):
            n = int(np.ceil((high - low) * number - 1e-9))
            fractions += [low + (high - low) * k / n for k in range(1, n + 1)]
        segments, below = [], start
        for low, high in pairwise(fractions):
            # cuts for effects leave the element's section as it is
            extra = sorted(t for t in _levels_inside(self.effects.levels(group), a[2], rise) if low < t < high)
            inner = [t for t in extra if min(t - low, high - t) * abs(rise) > SAME_POINT_M]
            middle = a[2] + 0.5 * (low + high) * rise
            for t in (*inner, high):
                above = end if t == fractions[-1] else self.node(a + t * (b - a))
                segments.append(Segment(below, above, middle))
                below = above
        return segments

    def place(self, member: Member, z_m: float) -> Place:
        bay = bay_at(self.d, z_m) if member.group == "leg" else member.bay
        return Place(group=member.group, part=member.part, z_m=z_m, leg=member.leg, face=member.face, bay=bay)

    def place_between(self, segment: Segment, member: Member) -> Place:
        return self.place(member, 0.5 * (self.nodes[segment.start][2] + self.nodes[segment.end][2]))

    def beam(self, segment: Segment, member: Member, tube: Tube, **kwargs) -> None:
        steel, place = self.d.steel, self.place_between(segment, member)
        named = {motion: self.effects.names_at("stiffness", place, motion=motion) for motion in ("axial", "bending")}
        both = tuple(name for name in named["axial"] if name in named["bending"])
        one = {motion: product(n for n in names if n not in both) for motion, names in named.items()}
        self.places.append(place)
        self.beams.append(Beam(
            start=segment.start, end=segment.end, group=member.group, part=member.part, tube=tube,
            youngs_modulus_pa=steel.youngs_modulus_pa, poisson_ratio=steel.poisson_ratio,
            density_kgpm3=steel.density_kgpm3, shear=self.effects.names_at("shear", place),
            stiffness=parameter(STIFFNESS[member.group]) * product(both) * self.warmth(place), **one, **kwargs,
        ))

    def warmth(self, place: Place) -> Coefficient:
        names = self.effects.names_at("temperature", place)
        entries = tuple((p.name, p.relative_per_degc) for p in self.effects.of_kind("temperature") if p.name in names)
        return Warmth(entries=entries).coefficient_of() if entries else Coefficient()

    def tube(self, member: Member, entry: TubeEntry, segment: Segment) -> Tube:
        """Of the entry's size; that of legs and braces follows Table 2."""
        place = self.place_between(segment, member)
        return self.tube_at(place, entry, segment.z_m)

    def tube_at(self, place: Place, entry: TubeEntry, z: float) -> Tube:
        loss, factors = self.effects.names_at("corrosion", place), {}
        if place.group in ("leg", "brace"):
            letter = place.group[0]
            factors = {"diameter_factor": f"D_{letter}", "thickness_factor": f"t_{letter}"}
        if isinstance(self.d, Offshore) and place.group in CORRODES[self.d.stands_on]:
            splash = self.d.corrosion
            loss = (*(("corr",) if splash.bottom_m <= z <= splash.top_m else ()), *loss)
        return Tube(diameter_m=entry.diameter_m, thickness_m=entry.thickness_m, wall_loss=loss, **factors)

    def wet_member(self, chain: Sequence[Segment], member: Member, entry: TubeEntry, *, flooded: bool) -> None:
        for segment in chain:
            tube = self.tube(member, entry, segment)
            self.beam(segment, member, tube, carried=self.water(segment, member, tube, flooded=flooded))

    def water(self, segment: Segment, member: Member, tube: Tube, *, flooded: bool) -> tuple[LineMass, ...]:
        """Growth, added mass and flooding of an element above the seabed."""
        place = self.place_between(segment, member)
        start, end = (self.nodes[k] for k in (segment.start, segment.end))
        low, high = sorted((start[2], end[2]))
        tidal = bool(self.rise) and low < self.tide[1] and high > self.tide[0]
        if not isinstance(self.d, Offshore) or (not tidal and segment.z_m >= self.d.site.water_level_m):
            return ()
        masses = water_and_growth(self.d, self.effects, tube, place, segment.z_m)
        fills = ((Coefficient(),) if flooded else ())
        fills += tuple(parameter(name) for name in self.effects.names_at("flooding", place))
        filling = [LineMass(per_metre=flooding(self.d, tube) * fill) for fill in fills]
        if not tidal:
            return (*masses, *filling)
        wetting = Wetting(
            start_m=round(start[2], 9), end_m=round(end[2], 9), length_m=round(float(np.linalg.norm(end - start)), 9),
            still_m=self.d.site.water_level_m, rise=self.rise,
        ).moments()
        # growth stays where it has grown
        return tuple(mass if mass.grown else covered_mass(mass, wetting) for mass in (*masses, *filling))


def _levels_inside(levels, start: float, rise: float) -> set[float]:
    """Fractions of a member from level `start` over `rise` at which it passes levels."""
    if abs(rise) <= SAME_POINT_M:
        return set()
    return {t for t in ((z - start) / rise for z in levels) if SAME_POINT_M < t * abs(rise) < abs(rise) - SAME_POINT_M}


def covered_mass(mass: LineMass, moments: Sequence[Coefficient]) -> LineMass:
    """A mass along the part of a beam that the moments (7) cover."""
    return LineMass(per_metre=mass.per_metre, transverse_only=mass.transverse_only, grown=mass.grown,
                    moments=tuple(mass.per_metre * m for m in moments))


def water_and_growth(d: Offshore, effects: Effects, tube: Tube, place: Place, z: float) -> tuple[LineMass, ...]:
    """Growth and added mass of a tube wholly under water; z is that of its section."""
    water = d.hydrodynamics
    growth = ("mg", *effects.names_at("growth", place)) if z < water.growth_top_m else ()
    added = Water(kind="added", tube=tube, density_kgpm3=d.site.water_density_kgpm3,
                  coefficient=water.added_mass_coefficient, growth=growth)
    factor = parameter("a_m") * product(effects.names_at("added_mass", place))
    masses = [LineMass(per_metre=added.coefficient_of() * factor, transverse_only=True)]
    if growth:
        grown = Water(kind="growth", tube=tube, density_kgpm3=water.growth_density_kgpm3, growth=growth)
        masses.append(LineMass(per_metre=grown.coefficient_of(), grown=True))
    return tuple(masses)


def flooding(d: Offshore, tube: Tube) -> Coefficient:
    return Water(kind="flooding", tube=tube, density_kgpm3=d.site.water_density_kgpm3).coefficient_of()


def drive_pile(
    mesh: Mesh, chain: Sequence[Segment], entries: Sequence[TubeEntry], member: Member, *, flooded: bool,
    single: bool = False,
) -> NodeSpring:
    """A vertical pile of segments from above downwards, each with its tube, in the soil; -> the spring at its tip. A
    single one is held against spinning by its shaft's friction: as along it, at the radius; of several the
    jacket holds each."""
    d = mesh.d
    assert isinstance(d, Offshore)  # land has no piles
    clay = soil.Clay(
        submerged_unit_weight_npm3=d.soil.submerged_unit_weight_npm3,
        strength_at_mudline_pa=d.soil.undrained_shear_strength_pa.at_mudline,
        strength_gradient_papm=d.soil.undrained_shear_strength_pa.gradient_per_m,
        strain_50=d.soil.strain_50, matlock_j=d.soil.matlock_j,
    )
    at_tip = mesh.place(member, d.pile_tip_m)
    diameters = tuple(entry.diameter_m for entry in entries)
    moments = _pile_moments(mesh, chain, clay, diameters, ("sc", *mesh.effects.names_at("scour", at_tip)))
    for k, (segment, entry) in enumerate(zip(chain, entries, strict=True)):
        place, tube = mesh.place_between(segment, member), mesh.tube(member, entry, segment)
        carried = [covered_mass(mass, moments["exposed_moments"][k])
                   for mass in water_and_growth(d, mesh.effects, tube, place, segment.z_m)]
        fills = (Coefficient(),) if flooded else ()
        fills += tuple(parameter(name) for name in mesh.effects.names_at("flooding", place))
        carried += [LineMass(per_metre=flooding(d, tube) * fill) for fill in fills]
        lateral, axial = (inverse(curve) * product(mesh.effects.names_at("soil", place, curve=curve))
                          for curve in ("py", "tz"))
        springs = LineSpring(
            lateral=tuple(m * lateral for m in moments["lateral_moments"][k]),
            axial=tuple(m * axial for m in moments["axial_moments"][k]),
            torsional=tuple(m * axial * (0.5 * entry.diameter_m) ** 2 for m in moments["axial_moments"][k])
            if single else (),
        )
        mesh.beam(segment, member, tube, carried=tuple(carried), springs=springs)
    depth = d.site.mudline_m - d.pile_tip_m
    stiffness = inverse("qw") * product(mesh.effects.names_at("soil", at_tip, curve="qw")) * float(
        soil.tip_stiffness(clay, diameters[-1], depth))
    return NodeSpring(node=chain[-1].end, direction=np.eye(6)[2], stiffness=stiffness)


def _pile_moments(
    mesh: Mesh, chain: Sequence[Segment], clay: soil.Clay, diameter_m: tuple[float, ...], scour: tuple[str, ...]
) -> dict[str, list[list[Coefficient]]]:
    """For each kind of moment, coefficients by element and order; equal piles with the same scour share them."""
    assert isinstance(mesh.d, Offshore)
    z = np.array([mesh.nodes[k][2] for k in (chain[0].start, *(segment.end for segment in chain))])
    springs = soil.PileSprings(
        clay=clay, diameter_m=diameter_m, top_depth_m=tuple(mesh.d.site.mudline_m - z[:-1]),
        length_m=tuple(z[:-1] - z[1:]),
    )
    return {
        kind: PileMoments(springs=springs, kind=kind, scour=scour).coefficients(len(chain), order)
        for kind, order in (("lateral_moments", 7), ("axial_moments", 3), ("exposed_moments", 7))
    }


def add_tower(mesh: Mesh, foot: int) -> tuple[int, list[Body]]:
    """-> the tower's top, flanges. Each element takes diameter and wall of its middle."""
    stations, member = mesh.d.tower.station, Member("tower", "tower")
    secondary = LineMass(per_metre=Coefficient(mesh.d.tower.secondary_steel_kgpm), dry=True)
    bodies, below = [Body(node=foot, mass=Coefficient(stations[0].flange_kg))], foot
    for low, high in pairwise(stations):
        if low.z_m < high.z_m:
            above = mesh.node([0, 0, high.z_m])
            for segment in mesh.chain(below, above, "tower", cut=False):
                entry = tube_between_stations(low, high, segment.z_m)
                mesh.beam(segment, member, mesh.tube(member, entry, segment), carried=(secondary,))
            below = above
        bodies.append(Body(node=below, mass=Coefficient(high.flange_kg)))
    return below, bodies
