"""A jacket of straight legs on piles, braced on every face, with its transition piece."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from probupdate.structure import joints
from probupdate.structure.coefficient import Coefficient, parameter, product
from probupdate.structure.description import JacketTurbine, TubeEntry
from probupdate.structure.effects import Place
from probupdate.structure.frame import Body, NodeSpring, Tie
from probupdate.structure.local_functions import JointStiffness
from probupdate.structure.turbine_mesh import Member, Mesh, drive_pile


def leg_point(d: JacketTurbine, leg: int, z: float) -> np.ndarray:
    """A point of a leg's axis; legs stand on the corners of a regular polygon whose side is the leg spacing."""
    low, high, number = d.jacket.bottom, d.jacket.top, len(d.jacket.leg_names)
    along = (z - low.z_m) / (high.z_m - low.z_m)
    spacing = low.leg_spacing_m + along * (high.leg_spacing_m - low.leg_spacing_m)
    radius = spacing / (2 * np.sin(np.pi / number))
    angle = np.radians(d.jacket.first_leg_angle_deg + 360.0 * leg / number)
    return np.array([radius * np.cos(angle), radius * np.sin(angle), z])


def _add_legs(mesh: Mesh, d: JacketTurbine) -> list[dict[float, int]]:
    """-> for every leg, its nodes by level."""
    jacket = d.jacket
    levels = {jacket.bottom.z_m, jacket.top.z_m} | {z for bay in jacket.bay for z in (bay.bottom_m, bay.top_m)}
    levels = sorted(levels)
    legs = []
    for number, name in enumerate(jacket.leg_names):
        at = {z: mesh.node(leg_point(d, number, z)) for z in levels}
        for low, high in pairwise(levels):
            member = Member("leg", f"leg {name}", leg=name)
            mesh.wet_member(mesh.chain(at[low], at[high], "leg"), member, jacket.leg, flooded=jacket.flooded)
        legs.append(at)
    return legs


def _add_braces(mesh: Mesh, d: JacketTurbine, legs: list[dict[float, int]]) -> None:
    names = d.jacket.leg_names
    for number, bay in enumerate(d.jacket.bay):
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
                member = Member("brace", f"brace {d.jacket.face_between(names[first], names[second])}-{number + 1}",
                                face=d.jacket.face_between(names[left], names[right]), bay=number + 1)
                for key, leg, at_foot in ((foot, first, True), (head, second, False)):
                    end = _brace_end(mesh, corner[key], legs[leg], centre, bay.brace, member._replace(leg=names[leg]))
                    chain = mesh.chain(*((end, centre) if at_foot else (centre, end)), "brace")
                    mesh.wet_member(chain, member, bay.brace, flooded=False)


def _brace_end(
    mesh: Mesh, chord: int, leg: dict[float, int], far: int, brace: TubeEntry, member: Member
) -> int:
    """The brace's own node at the chord's axis, or the chord's where joints are rigid."""
    d = mesh.d
    assert isinstance(d, JacketTurbine)
    law = joints.joint_law(d.jacket.joints.law)
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
        law=law, chord=mesh.tube_at(on_chord, d.jacket.leg, position[2]),
        brace=mesh.tube_at(place, brace, position[2]),
        # rounded so that the equal angles of all legs share one function
        angle_rad=round(angle, 12),
    )
    common = parameter("LJF") * parameter("k_j") * mesh.warmth(on_chord) * d.steel.youngs_modulus_pa
    stiffness = tuple(
        common * product(mesh.effects.names_at("joint", place, motion=motion)) * coefficient
        for motion, coefficient in zip(("axial", "in plane", "out of plane"), function.coefficients(), strict=True)
    )
    end = mesh.node(position)
    mesh.ties.append(Tie(node=end, master=chord, released=joints.release_directions(along_chord, along_brace),
                         stiffness=stiffness))
    return end


def _add_transition_piece(mesh: Mesh, d: JacketTurbine, legs: list[dict[float, int]]) -> tuple[int, list[Body]]:
    """-> the tower's foot, lumped masses."""
    tp, foot_z = d.transition_piece, d.tower.station[0].z_m
    foot, struts = mesh.node([0, 0, tp.column_bottom_m]), mesh.node([0, 0, tp.strut_top_m])
    top = struts if foot_z == tp.strut_top_m else mesh.node([0, 0, foot_z])
    column = Member("column", "column")
    members = [(column, foot, struts, tp.column)]
    if top != struts:
        members.append((column, struts, top, tp.column))
    for name, leg in zip(d.jacket.leg_names, legs, strict=True):
        members.append((Member("strut", f"strut {name}", leg=name), leg[max(leg)], struts, tp.strut))
        members.append((Member("tie", f"tie {name}", leg=name), leg[max(leg)], foot, tp.tie))
    for member, start, end, entry in members:
        for segment in mesh.chain(start, end, member.group, cut=False):
            mesh.beam(segment, member, mesh.tube(member, entry, segment))
    return top, [Body(node=struts, mass=Coefficient(tp.lumped_mass_kg))]


def add_jacket(mesh: Mesh, d: JacketTurbine) -> tuple[int, list[Body], list[NodeSpring], int]:
    """-> the tower's foot, lumped masses, springs at the piles' tips, the head of the first pile."""
    legs = _add_legs(mesh, d)
    _add_braces(mesh, d, legs)
    entry = TubeEntry(diameter_m=d.pile.diameter_m, thickness_m=d.pile.thickness_m)
    springs = []
    for name, leg in zip(d.jacket.leg_names, legs, strict=True):
        head, member = leg[min(leg)], Member("pile", f"pile {name}", leg=name)
        chain = mesh.chain(head, mesh.node([*mesh.nodes[head][:2], d.pile.tip_m]), "pile")
        springs.append(drive_pile(mesh, chain, [entry] * len(chain), member, flooded=d.pile.flooded))
    foot, bodies = _add_transition_piece(mesh, d, legs)
    return foot, bodies, springs, legs[0][min(legs[0])]
