"""From the description of a jacket turbine to its frame.

Members are cut where what surrounds them changes (water level, growth, splash zone, mudline) and then to at most their
length over `elements_per_member`, so that every element has one section and one surrounding. Rows of Table 2 act
so: k_j on E of legs, braces and their joints; k_t on E of the tower; k_TP on E of column, struts and ties; k_p on E of
the piles; LJF multiplies joint stiffness; D_l, t_l, D_b, t_b scale diameters and walls; sc lowers the mudline; corr
is the external wall loss of legs and braces in the splash zone; mg is the growth's thickness; a_m multiplies added
mass; m_h is the hub's mass, its inertia kept; py, tz, qw scale the displacement axis of the soil curves, so that
the springs' stiffness goes with 1/factor. Effects (see `effects`) act on the elements that they choose; where their
bands end, elements are cut once more without changing what they are made of.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple, cast

import numpy as np
from scipy.spatial.transform import Rotation

from probupdate.structure import joints, soil
from probupdate.structure.beam import Tube
from probupdate.structure.coefficient import Coefficient, inverse, parameter, product
from probupdate.structure.description import Description, Group, TubeEntry
from probupdate.structure.effects import Effects, Place, bay_at, ends
from probupdate.structure.frame import (
    Beam,
    Body,
    Frame,
    LineMass,
    LineSpring,
    NodeSpring,
    Tie,
)
from probupdate.structure.frame_effects import check_effects, hang_masses, loosen, prestress
from probupdate.structure.local_functions import JointStiffness, PileMoments, Warmth, Water, Wetting
from probupdate.structure.nacelle import nacelle_bodies

STIFFNESS = {"leg": "k_j", "brace": "k_j", "pile": "k_p", "column": "k_TP", "strut": "k_TP", "tie": "k_TP",
             "tower": "k_t"}
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


class _Mesh:
    """Collects nodes and members while the frame is built."""

    def __init__(self, description: Description):
        self.d = description
        self.effects = Effects(description)
        self.nodes: list[np.ndarray] = []
        self.beams: list[Beam] = []
        self.places: list[Place] = []
        self.ties: list[Tie] = []
        site, water, splash = description.site, description.hydrodynamics, description.corrosion
        self.cuts = (site.water_level_m, water.growth_top_m, splash.bottom_m, splash.top_m, site.mudline_m)
        rises = self.effects.on_all("water_level")
        self.rise = tuple(p.name for p in rises)
        self.tide = (site.water_level_m + sum(min(ends(p)[0], 0.0) for p in rises),
                     site.water_level_m + sum(max(ends(p)[1], 0.0) for p in rises))

    def node(self, position) -> int:
        self.nodes.append(np.array(position, float))
        return len(self.nodes) - 1

    def chain(self, start: int, end: int, group: str, *, cut: bool = True) -> list[Segment]:
        """Elements from start to end."""
        a, b = self.nodes[start], self.nodes[end]
        stops = {0.0, 1.0}
        rise = b[2] - a[2]
        if cut and abs(rise) > SAME_POINT_M:
            stops |= _inside(self.cuts, a[2], rise)
        number = self.d.mesh.elements_per_member[cast(Group, group)]
        fractions = [0.0]
        for low, high in pairwise(sorted(stops)):
            n = int(np.ceil((high - low) * number - 1e-9))
            fractions += [low + (high - low) * k / n for k in range(1, n + 1)]
        segments, below = [], start
        for low, high in pairwise(fractions):
            # cuts for effects leave the element's section as it is
            extra = sorted(t for t in _inside(self.effects.levels(group), a[2], rise) if low < t < high)
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

    def between(self, segment: Segment, member: Member) -> Place:
        return self.place(member, 0.5 * (self.nodes[segment.start][2] + self.nodes[segment.end][2]))

    def beam(self, segment: Segment, member: Member, tube: Tube, **kwargs) -> None:
        steel, place = self.d.steel, self.between(segment, member)
        named = {motion: self.effects.at("stiffness", place, motion=motion) for motion in ("axial", "bending")}
        both = tuple(name for name in named["axial"] if name in named["bending"])
        one = {motion: product(n for n in names if n not in both) for motion, names in named.items()}
        self.places.append(place)
        self.beams.append(Beam(
            start=segment.start, end=segment.end, group=member.group, part=member.part, tube=tube,
            youngs_modulus_pa=steel.youngs_modulus_pa, poisson_ratio=steel.poisson_ratio,
            density_kgpm3=steel.density_kgpm3, shear=self.effects.at("shear", place),
            stiffness=parameter(STIFFNESS[member.group]) * product(both) * self.warmth(place), **one, **kwargs,
        ))

    def warmth(self, place: Place) -> Coefficient:
        names = self.effects.at("temperature", place)
        entries = tuple((p.name, p.relative_per_degc) for p in self.effects.of("temperature") if p.name in names)
        return Warmth(entries=entries).coefficient_of() if entries else Coefficient()

    def tube(self, member: Member, entry: TubeEntry, segment: Segment) -> Tube:
        """Of the entry's size; that of legs and braces follows Table 2."""
        place = self.between(segment, member)
        return self.tube_at(place, entry, segment.z_m)

    def tube_at(self, place: Place, entry: TubeEntry, z: float) -> Tube:
        loss, factors = self.effects.at("corrosion", place), {}
        if place.group in ("leg", "brace"):
            letter, splash = place.group[0], self.d.corrosion
            factors = {"diameter_factor": f"D_{letter}", "thickness_factor": f"t_{letter}"}
            loss = (*(("corr",) if splash.bottom_m <= z <= splash.top_m else ()), *loss)
        return Tube(diameter_m=entry.diameter_m, thickness_m=entry.thickness_m, wall_loss=loss, **factors)

    def wet_member(self, chain: Sequence[Segment], member: Member, entry: TubeEntry, *, flooded: bool) -> None:
        for segment in chain:
            tube = self.tube(member, entry, segment)
            self.beam(segment, member, tube, carried=self.water(segment, member, tube, flooded=flooded))

    def water(self, segment: Segment, member: Member, tube: Tube, *, flooded: bool) -> tuple[LineMass, ...]:
        """Growth, added mass and flooding of an element of a leg or brace."""
        place = self.between(segment, member)
        start, end = (self.nodes[k] for k in (segment.start, segment.end))
        low, high = sorted((start[2], end[2]))
        tidal = bool(self.rise) and low < self.tide[1] and high > self.tide[0]
        if not tidal and segment.z_m >= self.d.site.water_level_m:
            return ()
        masses = water_and_growth(self.d, self.effects, tube, place, segment.z_m)
        fills = ((Coefficient(),) if flooded else ())
        fills += tuple(parameter(name) for name in self.effects.at("flooding", place))
        filling = [LineMass(per_metre=flooding(self.d, tube) * fill) for fill in fills]
        if not tidal:
            return (*masses, *filling)
        wetting = Wetting(
            start_m=round(start[2], 9), end_m=round(end[2], 9), length_m=round(float(np.linalg.norm(end - start)), 9),
            still_m=self.d.site.water_level_m, rise=self.rise,
        ).moments()
        # growth stays where it has grown
        return tuple(mass if mass.grown else covered(mass, wetting) for mass in (*masses, *filling))


def _inside(levels, start: float, rise: float) -> set[float]:
    """Fractions of a member from level `start` over `rise` at which it passes levels."""
    if abs(rise) <= SAME_POINT_M:
        return set()
    return {t for t in ((z - start) / rise for z in levels) if SAME_POINT_M < t * abs(rise) < abs(rise) - SAME_POINT_M}


def covered(mass: LineMass, moments: Sequence[Coefficient]) -> LineMass:
    """A mass along the part of a beam that the moments (7) cover."""
    return LineMass(per_metre=mass.per_metre, transverse_only=mass.transverse_only, grown=mass.grown,
                    moments=tuple(mass.per_metre * m for m in moments))


def water_and_growth(d: Description, effects: Effects, tube: Tube, place: Place, z: float) -> tuple[LineMass, ...]:
    """Growth and added mass of a tube wholly under water; z is that of its section."""
    water = d.hydrodynamics
    growth = ("mg", *effects.at("growth", place)) if z < water.growth_top_m else ()
    added = Water(kind="added", tube=tube, density_kgpm3=d.site.water_density_kgpm3,
                  coefficient=water.added_mass_coefficient, growth=growth)
    factor = parameter("a_m") * product(effects.at("added_mass", place))
    masses = [LineMass(per_metre=added.coefficient_of() * factor, transverse_only=True)]
    if growth:
        grown = Water(kind="growth", tube=tube, density_kgpm3=water.growth_density_kgpm3, growth=growth)
        masses.append(LineMass(per_metre=grown.coefficient_of(), grown=True))
    return tuple(masses)


def flooding(d: Description, tube: Tube) -> Coefficient:
    return Water(kind="flooding", tube=tube, density_kgpm3=d.site.water_density_kgpm3).coefficient_of()


def leg_point(d: Description, leg: int, z: float) -> np.ndarray:
    """A point of a leg's axis; legs stand on the corners of a regular polygon whose side is the leg spacing."""
    low, high, number = d.jacket.bottom, d.jacket.top, len(d.jacket.leg_names)
    along = (z - low.z_m) / (high.z_m - low.z_m)
    spacing = low.leg_spacing_m + along * (high.leg_spacing_m - low.leg_spacing_m)
    radius = spacing / (2 * np.sin(np.pi / number))
    angle = np.radians(d.jacket.first_leg_angle_deg + 360.0 * leg / number)
    return np.array([radius * np.cos(angle), radius * np.sin(angle), z])


def _add_legs(mesh: _Mesh) -> list[dict[float, int]]:
    """-> for every leg, its nodes by level."""
    jacket = mesh.d.jacket
    levels = {jacket.bottom.z_m, jacket.top.z_m} | {z for bay in jacket.bay for z in (bay.bottom_m, bay.top_m)}
    levels = sorted(levels)
    legs = []
    for number, name in enumerate(jacket.leg_names):
        at = {z: mesh.node(leg_point(mesh.d, number, z)) for z in levels}
        for low, high in pairwise(levels):
            member = Member("leg", f"leg {name}", leg=name)
            mesh.wet_member(mesh.chain(at[low], at[high], "leg"), member, jacket.leg, flooded=jacket.flooded)
        legs.append(at)
    return legs


def _add_braces(mesh: _Mesh, legs: list[dict[float, int]]) -> None:
    names = mesh.d.jacket.leg_names
    for number, bay in enumerate(mesh.d.jacket.bay):
        for left in range(len(legs)):
            right = (left + 1) % len(legs)
            corner = {key: legs[leg][z] for key, leg, z in (
                ("low left", left, bay.bottom_m), ("low right", right, bay.bottom_m),
                ("high left", left, bay.top_m), ("high right", right, bay.top_m),
            )}
            p = {key: mesh.nodes[k] for key, k in corner.items()}
            low, high = (np.linalg.norm(p[f"{z} right"] - p[f"{z} left"]) for z in ("low", "high"))
            # the diagonals of a trapezoid divide each other as its parallel sides
            centre = mesh.node(p["low left"] + low / (low + high) * (p["high right"] - p["low left"]))
            for foot, head, first, second in (("low left", "high right", left, right),
                                              ("low right", "high left", right, left)):
                member = Member("brace", f"brace {names[first]}{names[second]}-{number + 1}",
                                face=names[left] + names[right], bay=number + 1)
                for key, leg, at_foot in ((foot, first, True), (head, second, False)):
                    end = _brace_end(mesh, corner[key], legs[leg], centre, bay.brace, member._replace(leg=names[leg]))
                    chain = mesh.chain(*((end, centre) if at_foot else (centre, end)), "brace")
                    mesh.wet_member(chain, member, bay.brace, flooded=False)


def _brace_end(
    mesh: _Mesh, chord: int, leg: dict[float, int], far: int, brace: TubeEntry, member: Member
) -> int:
    """The brace's own node at the chord's axis, or the chord's where joints are rigid."""
    law = joints.joint_law(mesh.d.jacket.joints.law)
    if law is None:
        return chord
    position = mesh.nodes[chord]
    feet = [mesh.nodes[k] for k in (leg[min(leg)], leg[max(leg)])]
    along_chord = (feet[1] - feet[0]) / np.linalg.norm(feet[1] - feet[0])
    along_brace = (mesh.nodes[far] - position) / np.linalg.norm(mesh.nodes[far] - position)
    angle = float(np.arccos(abs(along_chord @ along_brace)))
    # the joint's stiffness is that of the chord's wall
    on_chord = Place(group="leg", part=f"leg {member.leg}", leg=member.leg, bay=member.bay, z_m=position[2])
    place = mesh.place(member, position[2])
    function = JointStiffness(
        law=law, chord=mesh.tube_at(on_chord, mesh.d.jacket.leg, position[2]),
        brace=mesh.tube_at(place, brace, position[2]),
        # rounded so that the equal angles of all legs share one function
        angle_rad=round(angle, 12),
    )
    common = parameter("LJF") * parameter("k_j") * mesh.warmth(on_chord) * mesh.d.steel.youngs_modulus_pa
    stiffness = tuple(
        common * product(mesh.effects.at("joint", place, motion=motion)) * coefficient
        for motion, coefficient in zip(("axial", "in plane", "out of plane"), function.coefficients(), strict=True)
    )
    end = mesh.node(position)
    mesh.ties.append(Tie(node=end, master=chord, released=joints.release_directions(along_chord, along_brace),
                         stiffness=stiffness))
    return end


def _add_piles(mesh: _Mesh, legs: list[dict[float, int]]) -> list[NodeSpring]:
    d = mesh.d
    entry = TubeEntry(diameter_m=d.pile.diameter_m, thickness_m=d.pile.thickness_m)
    clay = soil.Clay(
        submerged_unit_weight_npm3=d.soil.submerged_unit_weight_npm3,
        strength_at_mudline_pa=d.soil.undrained_shear_strength_pa.at_mudline,
        strength_gradient_papm=d.soil.undrained_shear_strength_pa.gradient_per_m,
        strain_50=d.soil.strain_50, matlock_j=d.soil.matlock_j,
    )
    tips = []
    depth = d.site.mudline_m - d.pile.tip_m
    for name, leg in zip(d.jacket.leg_names, legs, strict=True):
        head, member = leg[min(leg)], Member("pile", f"pile {name}", leg=name)
        tip = mesh.node([*mesh.nodes[head][:2], d.pile.tip_m])
        chain = mesh.chain(head, tip, "pile")
        moments = _pile_moments(mesh, chain, clay, ("sc", *mesh.effects.at("scour", mesh.place(member, d.pile.tip_m))))
        for k, segment in enumerate(chain):
            place, tube = mesh.between(segment, member), mesh.tube(member, entry, segment)
            carried = [covered(mass, moments["exposed_moments"][k])
                       for mass in water_and_growth(d, mesh.effects, tube, place, segment.z_m)]
            if d.pile.flooded:
                carried.append(LineMass(per_metre=flooding(d, tube)))
            lateral, axial = (inverse(curve) * product(mesh.effects.at("soil", place, curve=curve))
                              for curve in ("py", "tz"))
            springs = LineSpring(
                lateral=tuple(m * lateral for m in moments["lateral_moments"][k]),
                axial=tuple(m * axial for m in moments["axial_moments"][k]),
            )
            mesh.beam(segment, member, tube, carried=tuple(carried), springs=springs)
        at_tip = mesh.effects.at("soil", mesh.place(member, d.pile.tip_m), curve="qw")
        stiffness = inverse("qw") * product(at_tip) * float(soil.tip_stiffness(clay, d.pile.diameter_m, depth))
        tips.append(NodeSpring(node=tip, direction=np.eye(6)[2], stiffness=stiffness))
    return tips


def _pile_moments(
    mesh: _Mesh, chain: Sequence[Segment], clay: soil.Clay, scour: tuple[str, ...]
) -> dict[str, list[list[Coefficient]]]:
    """For each kind of moment, coefficients by element and order; equal piles with the same scour share them."""
    z = np.array([mesh.nodes[k][2] for k in (chain[0].start, *(segment.end for segment in chain))])
    springs = soil.PileSprings(
        clay=clay, diameter_m=mesh.d.pile.diameter_m, top_depth_m=tuple(mesh.d.site.mudline_m - z[:-1]),
        length_m=tuple(z[:-1] - z[1:]),
    )
    return {
        kind: PileMoments(springs=springs, kind=kind, scour=scour).coefficients(len(chain), order)
        for kind, order in (("lateral_moments", 7), ("axial_moments", 3), ("exposed_moments", 7))
    }


def _add_transition_piece(mesh: _Mesh, legs: list[dict[float, int]]) -> tuple[int, list[Body]]:
    """-> the tower's foot, lumped masses."""
    tp, foot_z = mesh.d.transition_piece, mesh.d.tower.station[0].z_m
    foot, struts = mesh.node([0, 0, tp.column_bottom_m]), mesh.node([0, 0, tp.strut_top_m])
    top = struts if foot_z == tp.strut_top_m else mesh.node([0, 0, foot_z])
    column = Member("column", "column")
    members = [(column, foot, struts, tp.column)]
    if top != struts:
        members.append((column, struts, top, tp.column))
    for name, leg in zip(mesh.d.jacket.leg_names, legs, strict=True):
        members.append((Member("strut", f"strut {name}", leg=name), leg[max(leg)], struts, tp.strut))
        members.append((Member("tie", f"tie {name}", leg=name), leg[max(leg)], foot, tp.tie))
    for member, start, end, entry in members:
        for segment in mesh.chain(start, end, member.group, cut=False):
            mesh.beam(segment, member, mesh.tube(member, entry, segment))
    return top, [Body(node=struts, mass=Coefficient(tp.lumped_mass_kg))]


def _add_tower(mesh: _Mesh, foot: int) -> tuple[int, list[Body]]:
    """-> the tower's top, flanges. Each element takes diameter and wall of its middle."""
    stations, member = mesh.d.tower.station, Member("tower", "tower")
    secondary = LineMass(per_metre=Coefficient(mesh.d.tower.secondary_steel_kgpm), dry=True)
    bodies, below = [Body(node=foot, mass=Coefficient(stations[0].flange_kg))], foot
    for low, high in pairwise(stations):
        above = mesh.node([0, 0, high.z_m])
        for segment in mesh.chain(below, above, "tower", cut=False):
            t = (segment.z_m - low.z_m) / (high.z_m - low.z_m)
            entry = TubeEntry(
                diameter_m=low.diameter_m + t * (high.diameter_m - low.diameter_m),
                thickness_m=low.thickness_m + t * (high.thickness_m - low.thickness_m),
            )
            mesh.beam(segment, member, mesh.tube(member, entry, segment), carried=(secondary,))
        bodies.append(Body(node=above, mass=Coefficient(high.flange_kg)))
        below = above
    return below, bodies


def build_frame(description: Description, nacelle_angle_deg: float = 0.0) -> Frame:
    """Mesh the described turbine. Bodies of the nacelle and rotor are tied rigidly to the tower's top, turned about
    the vertical from where the description has them by nacelle_angle_deg, counter-clockwise seen from above."""
    mesh = _Mesh(description)
    legs = _add_legs(mesh)
    _add_braces(mesh, legs)
    springs = _add_piles(mesh, legs)
    foot, bodies = _add_transition_piece(mesh, legs)
    top, flanges = _add_tower(mesh, foot)
    hang_masses(mesh)
    loosen(mesh)
    turn = Rotation.from_euler("z", nacelle_angle_deg, degrees=True).as_matrix()
    nacelle = nacelle_bodies(description, mesh.effects, mesh.nodes[top], turn)
    number = len(mesh.nodes)
    mesh.nodes += nacelle.positions
    mesh.ties += [Tie(node=number + k, master=top, released=released, stiffness=stiffness)
                  for k, (released, stiffness) in enumerate(nacelle.released)]
    bodies += [*flanges, *(replace(body, node=number + body.node) for body in nacelle.bodies)]
    hub = number + [entry.name for entry in description.rna].index("hub")
    frame = Frame(
        node_m=np.array(mesh.nodes), beams=tuple(mesh.beams), ties=tuple(mesh.ties), bodies=tuple(bodies),
        springs=tuple(springs), prestress=prestress(description, mesh.effects, hub, turn[:, 0]),
        pile_head=legs[0][min(legs[0])], pile_part=f"pile {description.jacket.leg_names[0]}",
    )
    check_effects(mesh)
    return frame
