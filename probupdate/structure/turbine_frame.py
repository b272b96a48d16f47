"""From the description of a jacket turbine to its frame.

Members are cut where the surroundings change (water level, growth, splash zone, mudline) and then to at most their
length over `elements_per_member`, so that every element has one section and one surrounding. Parameters act so:
k_j on E of legs, braces and their joints; k_t on E of the tower; k_TP on E of column, struts and ties; k_p on E of
the piles; LJF multiplies joint stiffness; D_l, t_l, D_b, t_b scale diameters and walls; sc lowers the mudline; corr
is the external wall loss of legs and braces in the splash zone; mg is the growth's thickness; a_m multiplies added
mass; m_h is the hub's mass, its inertia kept; py, tz, qw stretch the displacement axis of the soil curves, so that
the springs' stiffness goes with 1/factor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from probupdate.structure import hydrodynamics, joints, soil
from probupdate.structure.beam import Tube
from probupdate.structure.coefficient import Coefficient, Factor, Values, inverse, parameter
from probupdate.structure.description import Description, TubeEntry
from probupdate.structure.frame import (
    Beam,
    Body,
    Frame,
    LineMass,
    LineSpring,
    NodeSpring,
    Tie,
)  # fmt: skip

STIFFNESS = {"leg": "k_j", "brace": "k_j", "pile": "k_p", "column": "k_TP", "strut": "k_TP", "tie": "k_TP",
             "tower": "k_t"}  # fmt: skip
SAME_POINT_M = 1e-6


@dataclass(frozen=True, kw_only=True)
class Water:
    """A picklable mass per metre of what surrounds or fills a tube; see hydrodynamics."""

    kind: str
    tube: Tube
    density_kgpm3: float
    coefficient: float = 1.0
    grown: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        growth = ("mg",) if self.grown or self.kind == "growth" else ()
        return (*self.tube.names, *growth)

    def __call__(self, values: Values):
        if self.kind == "flooding":
            return hydrodynamics.flooding_mass(self.tube.inner(values), self.density_kgpm3)
        outer, growth = self.tube.outer(values), values["mg"] if self.grown or self.kind == "growth" else 0.0
        if self.kind == "growth":
            return hydrodynamics.growth_mass(outer, growth, self.density_kgpm3)
        return hydrodynamics.added_mass(outer, growth, self.coefficient, self.density_kgpm3)

    def coefficient_of(self) -> Coefficient:
        return Coefficient(1.0, (Factor(key=("water", self), names=self.names, function=self),))


@dataclass(frozen=True, kw_only=True)
class JointStiffness:
    """(..., 3) stiffness over E of one brace end; picklable."""

    law: joints.JointLaw
    chord: Tube
    brace: Tube
    angle_rad: float

    def __call__(self, values: Values):
        chord_diameter, chord_wall = self.chord.outer(values), self.chord.wall(values)
        return 1.0 / self.law(chord_diameter, chord_wall, self.brace.outer(values), self.angle_rad)


@dataclass(frozen=True, kw_only=True, eq=False)
class PileMoments:
    """Soil or exposure moments of all elements of a pile, flattened to (..., n_element * n_moment); picklable."""

    springs: soil.PileSprings
    kind: str

    def __call__(self, values: Values):
        moments = getattr(self.springs, self.kind)(np.asarray(values["sc"]))
        return moments.reshape(*moments.shape[:-2], -1)


class _Mesh:
    """Collects nodes and members while the frame is built."""

    def __init__(self, description: Description):
        self.d = description
        self.nodes: list[np.ndarray] = []
        self.beams: list[Beam] = []
        self.ties: list[Tie] = []
        site, water, splash = description.site, description.hydrodynamics, description.corrosion
        self.cuts = (site.water_level_m, water.growth_top_m, splash.bottom_m, splash.top_m, site.mudline_m)

    def node(self, position) -> int:
        self.nodes.append(np.array(position, float))
        return len(self.nodes) - 1

    def chain(self, start: int, end: int, group: str, *, cut: bool = True) -> list[int]:
        """Nodes from start to end, both included."""
        a, b = self.nodes[start], self.nodes[end]
        stops = {0.0, 1.0}
        rise = b[2] - a[2]
        if cut and abs(rise) > SAME_POINT_M:
            at = [(z - a[2]) / rise for z in self.cuts]
            stops |= {t for t in at if SAME_POINT_M < t * abs(rise) < abs(rise) - SAME_POINT_M}
        stops = sorted(stops)
        number = self.d.mesh.elements_per_member[group]
        fractions = []
        for low, high in pairwise(stops):
            n = int(np.ceil((high - low) * number - 1e-9))
            fractions += [low + (high - low) * k / n for k in range(1, n + 1)]
        inner = [self.node(a + t * (b - a)) for t in fractions[:-1]]
        return [start, *inner, end]

    def beam(self, start: int, end: int, group: str, part: str, tube: Tube, **kwargs) -> None:
        steel = self.d.steel
        self.beams.append(Beam(
            start=start, end=end, group=group, part=part, tube=tube, youngs_modulus_pa=steel.youngs_modulus_pa,
            poisson_ratio=steel.poisson_ratio, density_kgpm3=steel.density_kgpm3,
            stiffness=parameter(STIFFNESS[group]), **kwargs,
        ))  # fmt: skip

    def middle(self, start: int, end: int) -> float:
        return 0.5 * (self.nodes[start][2] + self.nodes[end][2])

    def wet_member(self, chain: Sequence[int], group: str, part: str, entry: TubeEntry, *, flooded: bool) -> None:
        for start, end in pairwise(chain):
            z = self.middle(start, end)
            tube = self.jacket_tube(group, entry, z)
            carried = surroundings(self.d, tube, z) if z < self.d.site.water_level_m else ()
            if flooded and z < self.d.site.water_level_m:
                carried = (*carried, flooding(self.d, tube))
            self.beam(start, end, group, part, tube, carried=carried)

    def jacket_tube(self, group: str, entry: TubeEntry, z: float) -> Tube:
        splash = self.d.corrosion
        letter = "l" if group == "leg" else "b"
        return Tube(
            diameter_m=entry.diameter_m, thickness_m=entry.thickness_m, diameter_factor=f"D_{letter}",
            thickness_factor=f"t_{letter}", wall_loss="corr" if splash.bottom_m <= z <= splash.top_m else None,
        )  # fmt: skip


def surroundings(d: Description, tube: Tube, z: float) -> tuple[LineMass, ...]:
    """Growth and added mass of a tube wholly under water."""
    water = d.hydrodynamics
    grown = z < water.growth_top_m
    added = Water(kind="added", tube=tube, density_kgpm3=d.site.water_density_kgpm3,
                  coefficient=water.added_mass_coefficient, grown=grown)  # fmt: skip
    masses = [LineMass(per_metre=added.coefficient_of() * parameter("a_m"), transverse_only=True)]
    if grown:
        growth = Water(kind="growth", tube=tube, density_kgpm3=water.growth_density_kgpm3)
        masses.append(LineMass(per_metre=growth.coefficient_of()))
    return tuple(masses)


def flooding(d: Description, tube: Tube) -> LineMass:
    return LineMass(
        per_metre=Water(kind="flooding", tube=tube, density_kgpm3=d.site.water_density_kgpm3).coefficient_of()
    )


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
            chain = mesh.chain(at[low], at[high], "leg")
            mesh.wet_member(chain, "leg", f"leg {name}", jacket.leg, flooded=jacket.flooded)
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
            )}  # fmt: skip
            p = {key: mesh.nodes[k] for key, k in corner.items()}
            low, high = (np.linalg.norm(p[f"{z} right"] - p[f"{z} left"]) for z in ("low", "high"))
            # the diagonals of a trapezoid divide each other as its parallel sides
            centre = mesh.node(p["low left"] + low / (low + high) * (p["high right"] - p["low left"]))
            for foot, head, first, second in (("low left", "high right", left, right),
                                              ("low right", "high left", right, left)):  # fmt: skip
                part = f"brace {names[first]}{names[second]}-{number + 1}"
                for key, leg, at_foot in ((foot, first, True), (head, second, False)):
                    end = _brace_end(mesh, corner[key], legs[leg], centre, bay.brace)
                    chain = mesh.chain(*((end, centre) if at_foot else (centre, end)), "brace")
                    mesh.wet_member(chain, "brace", part, bay.brace, flooded=False)


def _brace_end(mesh: _Mesh, chord: int, leg: dict[float, int], far: int, brace: TubeEntry) -> int:
    """The brace's own node at the chord's axis, or the chord's where joints are rigid."""
    law = joints.joint_law(mesh.d.jacket.joints.law)
    if law is None:
        return chord
    position = mesh.nodes[chord]
    feet = [mesh.nodes[k] for k in (leg[min(leg)], leg[max(leg)])]
    along_chord = (feet[1] - feet[0]) / np.linalg.norm(feet[1] - feet[0])
    along_brace = (mesh.nodes[far] - position) / np.linalg.norm(mesh.nodes[far] - position)
    angle = float(np.arccos(abs(along_chord @ along_brace)))
    chord_tube = mesh.jacket_tube("leg", mesh.d.jacket.leg, position[2])
    brace_tube = mesh.jacket_tube("brace", brace, position[2])
    # rounded so that the equal angles of all legs share one function
    function = JointStiffness(law=law, chord=chord_tube, brace=brace_tube, angle_rad=round(angle, 12))
    names = tuple(sorted({*chord_tube.names, *brace_tube.names}))
    common = parameter("LJF") * parameter("k_j") * mesh.d.steel.youngs_modulus_pa
    stiffness = tuple(
        common * Coefficient(1.0, (Factor(key=("joint", function), names=names, function=function, component=k),))
        for k in range(3)
    )
    end = mesh.node(position)
    mesh.ties.append(Tie(node=end, master=chord, released=joints.release_directions(along_chord, along_brace),
                         stiffness=stiffness))  # fmt: skip
    return end


def _add_piles(mesh: _Mesh, legs: list[dict[float, int]]) -> list[NodeSpring]:
    d = mesh.d
    tube = Tube(diameter_m=d.pile.diameter_m, thickness_m=d.pile.thickness_m)
    clay = soil.Clay(
        submerged_unit_weight_npm3=d.soil.submerged_unit_weight_npm3,
        strength_at_mudline_pa=d.soil.undrained_shear_strength_pa.at_mudline,
        strength_gradient_papm=d.soil.undrained_shear_strength_pa.gradient_per_m,
        strain_50=d.soil.strain_50, matlock_j=d.soil.matlock_j,
    )  # fmt: skip
    tips, shared = [], None
    for name, leg in zip(d.jacket.leg_names, legs, strict=True):
        head = leg[min(leg)]
        tip = mesh.node([*mesh.nodes[head][:2], d.pile.tip_m])
        chain = mesh.chain(head, tip, "pile")
        if shared is None:
            shared = _pile_tables(mesh, chain, clay)
        for k, (start, end) in enumerate(pairwise(chain)):
            z = mesh.middle(start, end)
            carried = [LineMass(per_metre=mass.per_metre, transverse_only=mass.transverse_only,
                                moments=tuple(mass.per_metre * m for m in shared["exposed_moments"][k]))
                       for mass in surroundings(d, tube, z)]  # fmt: skip
            if d.pile.flooded:
                carried.append(flooding(d, tube))
            springs = LineSpring(
                lateral=tuple(m * inverse("py") for m in shared["lateral_moments"][k]),
                axial=tuple(m * inverse("tz") for m in shared["axial_moments"][k]),
            )
            mesh.beam(start, end, "pile", f"pile {name}", tube, carried=tuple(carried), springs=springs)
        depth = d.site.mudline_m - d.pile.tip_m
        stiffness = inverse("qw") * float(soil.tip_stiffness(clay, d.pile.diameter_m, depth))
        tips.append(NodeSpring(node=tip, direction=np.eye(6)[2], stiffness=stiffness))
    return tips


def _pile_tables(mesh: _Mesh, chain: Sequence[int], clay: soil.Clay) -> dict[str, list[list[Coefficient]]]:
    """For each kind of moment, coefficients by element and order; all piles share them."""
    z = np.array([mesh.nodes[k][2] for k in chain])
    springs = soil.PileSprings(
        clay=clay, diameter_m=mesh.d.pile.diameter_m, top_depth_m=tuple(mesh.d.site.mudline_m - z[:-1]),
        length_m=tuple(z[:-1] - z[1:]),
    )  # fmt: skip
    tables = {}
    for kind, order in (("lateral_moments", 7), ("axial_moments", 3), ("exposed_moments", 7)):
        function = PileMoments(springs=springs, kind=kind)
        tables[kind] = [
            [Coefficient(1.0, (Factor(key=("pile", kind), names=("sc",), function=function,
                                      component=order * k + m),))
             for m in range(order)]
            for k in range(len(z) - 1)
        ]  # fmt: skip
    return tables


def _add_transition_piece(mesh: _Mesh, legs: list[dict[float, int]]) -> tuple[int, list[Body]]:
    """-> the tower's foot, lumped masses."""
    tp, foot_z = mesh.d.transition_piece, mesh.d.tower.station[0].z_m
    foot, struts = mesh.node([0, 0, tp.column_bottom_m]), mesh.node([0, 0, tp.strut_top_m])
    top = struts if foot_z == tp.strut_top_m else mesh.node([0, 0, foot_z])
    members = [("column", "column", foot, struts, tp.column)]
    if top != struts:
        members.append(("column", "column", struts, top, tp.column))
    for name, leg in zip(mesh.d.jacket.leg_names, legs, strict=True):
        members.append(("strut", f"strut {name}", leg[max(leg)], struts, tp.strut))
        members.append(("tie", f"tie {name}", leg[max(leg)], foot, tp.tie))
    for group, part, start, end, entry in members:
        tube = Tube(diameter_m=entry.diameter_m, thickness_m=entry.thickness_m)
        chain = mesh.chain(start, end, group, cut=False)
        for a, b in pairwise(chain):
            mesh.beam(a, b, group, part, tube)
    return top, [Body(node=struts, mass=Coefficient(tp.lumped_mass_kg))]


def _add_tower(mesh: _Mesh, foot: int) -> tuple[int, list[Body]]:
    """-> the tower's top, flanges. Each element takes diameter and wall of its middle."""
    stations = mesh.d.tower.station
    secondary = LineMass(per_metre=Coefficient(mesh.d.tower.secondary_steel_kgpm), dry=True)
    bodies, below = [Body(node=foot, mass=Coefficient(stations[0].flange_kg))], foot
    for low, high in pairwise(stations):
        above = mesh.node([0, 0, high.z_m])
        chain = mesh.chain(below, above, "tower", cut=False)
        for a, b in pairwise(chain):
            t = (mesh.middle(a, b) - low.z_m) / (high.z_m - low.z_m)
            tube = Tube(
                diameter_m=low.diameter_m + t * (high.diameter_m - low.diameter_m),
                thickness_m=low.thickness_m + t * (high.thickness_m - low.thickness_m),
            )
            mesh.beam(a, b, "tower", "tower", tube, carried=(secondary,))
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
    bodies += flanges
    turn = Rotation.from_euler("z", nacelle_angle_deg, degrees=True).as_matrix()
    for entry in description.rna:
        node = mesh.node(mesh.nodes[top] + turn @ np.array(entry.offset_m))
        mass = parameter("m_h") if entry.name == "hub" else Coefficient(entry.mass_kg)
        bodies.append(Body(node=node, mass=mass, inertia_kgm2=turn @ np.diag(entry.inertia_kgm2) @ turn.T))
        mesh.ties.append(Tie(node=node, master=top))
    return Frame(
        node_m=np.array(mesh.nodes), beams=tuple(mesh.beams), ties=tuple(mesh.ties), bodies=tuple(bodies),
        springs=tuple(springs), pile_head=legs[0][min(legs[0])], pile_part=f"pile {description.jacket.leg_names[0]}",
    )  # fmt: skip
