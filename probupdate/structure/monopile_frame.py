"""A monopile in the soil with its grouted or bolted transition piece, and the foundation of a tower on land."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from probupdate.structure.coefficient import Coefficient, parameter, product
from probupdate.structure.description import (
    FoundationTurbine,
    Grout,
    MonopileTurbine,
    Sleeve,
    TubeEntry,
    station_pairs,
    tube_between_stations,
)
from probupdate.structure.frame import Body, LineMass, NodeSpring, Tie
from probupdate.structure.turbine_mesh import Member, Mesh, Segment, drive_pile

PILE, SLEEVE = Member("pile", "monopile"), Member("column", "transition piece")
# what holds the foot of a tower on land: no beam, but a place where effects act
GROUND = Member("column", "foundation")
# relative motions of two tubes at one point: along x, y, z and about them
EACH_WAY = np.eye(6)


def add_monopile(mesh: Mesh, d: MonopileTurbine) -> tuple[int, list[Body], list[NodeSpring], int]:
    """-> the tower's foot, lumped masses, the spring at the tip, the pile's node at the mudline."""
    sleeve = d.transition_piece
    top = mesh.node([0, 0, d.monopile.station[-1].z_m])
    overlap = () if sleeve is None or sleeve.connection == "bolted" else (sleeve.bottom_m,)
    chain: list[Segment] = []
    entries: list[TubeEntry] = []
    above = top
    for low, high in reversed(station_pairs(d.monopile.station)):
        below = mesh.node([0, 0, low.z_m])
        own = mesh.chain(above, below, "pile", at_m=overlap)
        chain, entries = [*chain, *own], [*entries, *(tube_between_stations(low, high, s.z_m) for s in own)]
        above = below
    dry = [k for k, s in enumerate(chain) if s.z_m > d.site.mudline_m]
    for k in dry:
        tube = mesh.tube(PILE, entries[k], chain[k])
        water = mesh.water(chain[k], PILE, tube, flooded=d.monopile.flooded)
        if overlap and chain[k].z_m > overlap[0]:
            # growth and water are around the sleeve there
            water = tuple(mass for mass in water if not (mass.grown or mass.transverse_only))
        mesh.beam(chain[k], PILE, tube, carried=water)
    wet = chain[len(dry):]
    tip = drive_pile(mesh, wet, entries[len(dry):], PILE, flooded=d.monopile.flooded, single=True)
    foot, bodies = (top, []) if sleeve is None else _add_sleeve(mesh, d, sleeve, [top, *(s.end for s in chain)])
    return foot, bodies, [tip], wet[0].start


def _add_sleeve(mesh: Mesh, d: MonopileTurbine, sleeve: Sleeve, pile: list[int]) -> tuple[int, list[Body]]:
    """The transition piece on the pile's nodes, from above; -> its top, lumped masses."""
    foot_z = d.tower.station[0].z_m
    common = parameter("k_c") * mesh.warmth(mesh.place(SLEEVE, sleeve.bottom_m)) * product(
        mesh.effects.names_at("joint", mesh.place(SLEEVE, sleeve.bottom_m), motion="all"))
    bodies = []
    inside = [node for node in reversed(pile) if mesh.nodes[node][2] >= sleeve.bottom_m - 1e-9]
    own = [mesh.node(mesh.nodes[node]) for node in inside]
    if sleeve.flange is not None:
        stiffness = common * sleeve.flange.bending_stiffness_nmprad
        mesh.ties.append(Tie(node=own[0], master=inside[0], released=EACH_WAY[3:5], stiffness=(stiffness, stiffness)))
        bodies.append(Body(node=inside[0], mass=Coefficient(sleeve.flange.mass_kg)))
    else:
        assert sleeve.grout is not None
        z = np.array([mesh.nodes[node][2] for node in inside])
        # of each node the half of what lies between it and its neighbours
        share = 0.5 * (np.diff(z, prepend=z[0]) + np.diff(z, append=z[-1]))
        per_metre = grout_stiffness(sleeve.grout, sleeve.tube.diameter_m - 2 * sleeve.tube.thickness_m)
        for node, master, length in zip(own, inside, share, strict=True):
            mesh.ties.append(Tie(node=node, master=master, released=EACH_WAY,
                                 stiffness=tuple(common * float(k * length) for k in per_metre)))
    levels = sorted({z for z in (sleeve.lumped_mass_m, foot_z) if z > mesh.nodes[own[-1]][2] + 1e-9})
    nodes = [*own, *(mesh.node([0, 0, z]) for z in levels)]
    carried = () if sleeve.grout is None else (LineMass(per_metre=Coefficient(grout_mass(sleeve)), dry=True),)
    for k, (low, high) in enumerate(pairwise(nodes)):
        # along the grout it has the pile's nodes
        overlapping = k < len(own) - 1
        for segment in mesh.chain(low, high, "column", cut=not overlapping, number=1 if overlapping else None):
            tube = mesh.tube(SLEEVE, sleeve.tube, segment)
            filled = carried if overlapping else ()
            around = mesh.water(segment, SLEEVE, tube, flooded=False)
            mesh.beam(segment, SLEEVE, tube, carried=(*filled, *around))
    at = min(nodes, key=lambda node: abs(mesh.nodes[node][2] - sleeve.lumped_mass_m))
    bodies.append(Body(node=at, mass=Coefficient(sleeve.lumped_mass_kg)))
    return nodes[-1], bodies


def grout_stiffness(grout: Grout, outer_m: float) -> tuple[float, ...]:
    """Stiffness per metre of overlap of an annulus of grout inside a tube of inner diameter outer_m, for relative
    motion along x, y, z (N/m per m) and about them (N m/rad per m).

    A layer of thickness t, thin beside its radius, resists by (1 - nu) E / ((1 + nu) (1 - 2 nu)) / t across and by
    G / t along (confined elastic layer). Summed over the circumference: pi R (normal + shear) sideways, 2 pi R shear
    along the axis, pi R^3 shear for tilting and 2 pi R^3 shear for twisting.
    """
    e, nu, t = grout.youngs_modulus_pa, grout.poisson_ratio, grout.thickness_m
    radius = 0.5 * (outer_m - t)
    normal, shear = e * (1 - nu) / ((1 + nu) * (1 - 2 * nu)) / t, e / (2 * (1 + nu)) / t
    sideways, tilting = np.pi * radius * (normal + shear), np.pi * radius**3 * shear
    return (sideways, sideways, 2 * np.pi * radius * shear, tilting, tilting, 2 * tilting)


def grout_mass(sleeve: Sleeve) -> float:
    """kg per metre of overlap."""
    assert sleeve.grout is not None
    mean = sleeve.tube.diameter_m - 2 * sleeve.tube.thickness_m - sleeve.grout.thickness_m
    return float(sleeve.grout.density_kgpm3 * np.pi * mean * sleeve.grout.thickness_m)


def add_foundation(mesh: Mesh, d: FoundationTurbine) -> tuple[int, list[Body], list[NodeSpring], bool]:
    """-> the tower's foot, the foundation's mass, its springs, whether the foot is held."""
    own = d.foundation
    foot = mesh.node([0, 0, d.tower.station[0].z_m])
    bodies = [Body(node=foot, mass=Coefficient(own.mass_kg), inertia_kgm2=np.diag(own.inertia_kgm2))]
    springs = []
    if own.support == "springs":
        rows = ((own.horizontal_npm, (0, 1)), (own.vertical_npm, (2,)), (own.rocking_nmprad, (3, 4)),
                (own.torsion_nmprad, (5,)))
        factor = parameter("k_f") * product(
            mesh.effects.names_at("joint", mesh.place(GROUND, d.tower.station[0].z_m), motion="all"))
        for value, directions in rows:
            springs += [NodeSpring(node=foot, direction=EACH_WAY[k], stiffness=factor * float(value or 0.0))
                        for k in directions]
    return foot, bodies, springs, own.support == "clamped"
