"""The virtual turbine's structure: nodes, Timoshenko tubes, lumped masses, soil springs -> K, M, channels.

It is built from the same drawing (model.toml) as the model that is updated, and shares no code with it: finer mesh,
lumped mass, Timoshenko tubes, the soil laws of `soil`, drawn tolerances. The nacelle's heading turns the two masses
at the tower top. Hidden effects act at the moment's amounts. Not modelled: the frame's softening by its own weight
(but for the tower's as an effect), joint offsets at the chords, blades.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from probupdate.errors import InputError
from probupdate.virtual import beam, observation, soil
from probupdate.virtual.effects import ALL, HiddenEffects
from probupdate.virtual.mesh import Mesh
from probupdate.virtual.sections import Materials
from probupdate.virtual.truth import Truth
from probupdate.virtual.turbine_file import TurbineFile

WAVE_DEPTH_M = 6.0  # where the resultant of a wave of some seconds acts on a leg
ICE_RADIUS_M = 25.0  # of gyration of ice on the blades
SMALLEST_OSCILLATOR_KG = 1e-3  # what stays of an oscillator of amount zero: the degrees of freedom do not change


@dataclass(frozen=True, eq=False, kw_only=True)
class Oscillator:
    """A mass on a spring, one degree of freedom `dof`: its displacement relative to a node's point at `arm_m`, along
    `direction` or, where that is None, along the nacelle's axis. The node carries the mass already."""

    dof: int
    node: int
    arm_m: np.ndarray
    direction: np.ndarray | None
    mass_kg: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Structure:
    """Six degrees of freedom a node, then one for each oscillator. stiffness, mass (n_dof, n_dof) csc, the mass
    without what sits at the tower top; channel (n_channel, n_dof) csr as the sensors are mounted, nominal_channel as
    the drawing says; tilt, nominal_tilt (n_channel, n_dof) m/s2 that gravity adds to their readings for displacements;
    sensor_motion (3 n_channel, n_dof) a sensor's point along x, y, z, sensor_tilt the same there; top the top's node;
    surface (n_leg,) the leg nodes that waves load; pile_heads (n_leg,) nodes; elements (node, node, tube)."""

    node_m: np.ndarray
    stiffness: sparse.csc_array
    mass: sparse.csc_array
    nominal_channel: sparse.csr_array
    channel: sparse.csr_array
    tilt: sparse.csr_array
    nominal_tilt: sparse.csr_array
    sensor_motion: sparse.csr_array
    sensor_tilt: sparse.csr_array
    top: int
    surface: np.ndarray
    rna: tuple[tuple[float, np.ndarray, np.ndarray], ...]
    pile_heads: np.ndarray
    elements: tuple[tuple[int, int, beam.Tube], ...]
    oscillators: tuple[Oscillator, ...] = ()


def _leg_point(file: TurbineFile, leg: int, z: float) -> np.ndarray:
    low, high = file.value("jacket", "bottom"), file.value("jacket", "top")
    along = (z - low["z_m"]) / (high["z_m"] - low["z_m"])
    spacing = low["leg_spacing_m"] + along * (high["leg_spacing_m"] - low["leg_spacing_m"])
    n_leg = len(file.value("jacket", "leg_names"))
    angle = np.radians(file.number("jacket", "first_leg_angle_deg") + 360 / n_leg * leg)
    radius = spacing / (2 * np.sin(np.pi / n_leg))
    return np.array([radius * np.cos(angle), radius * np.sin(angle), z])


def _sensor_levels(file: TurbineFile, hidden: HiddenEffects, part: str, rise: float = 1.0) -> set[float]:
    """Where a part's sensors are, as drawn and wherever they truly sit at some time, so that there is a node there;
    `rise` of the part per metre along it."""
    levels = set()
    for sensor, own in zip(file.sensors, file.parts, strict=True):
        if own == part:
            farther = [e["height_m"] for e in hidden.effects
                       if e["kind"] == "sensor_height" and e["level"] in (sensor.level, ALL)]
            levels |= {sensor.position_m[2] + rise * h for h in (0.0, *farther)}
    return levels


def _flexibility(length_m: float, tube: beam.Tube) -> np.ndarray | None:
    """Flexibility (6,) about both bending axes of a length of tube; None for none."""
    turn = length_m / (tube.youngs_modulus_pa * tube.second_moment_m4)
    return np.array([0.0, 0.0, 0.0, 0.0, turn, turn]) if length_m else None


def _legs(mesh: Mesh, file: TurbineFile, steel: Materials) -> None:
    jacket, hidden = file.value("jacket"), steel.hidden
    low, high = jacket["bottom"]["z_m"], jacket["top"]["z_m"]
    levels = {bay[key] for bay in jacket["bay"] for key in ("bottom_m", "top_m")}
    levels |= {file.number("site", "water_level_m"), file.number("hydrodynamics", "growth_top_m"),
               file.number("corrosion", "bottom_m"), file.number("corrosion", "top_m")}
    for leg, name in enumerate(jacket["leg_names"]):
        foot, head = _leg_point(file, leg, low), _leg_point(file, leg, high)
        own = _sensor_levels(file, hidden, f"leg {name}", float((high - low) / np.linalg.norm(head - foot)))
        at = [(z - low) / (high - low) for z in levels | own]
        filled = float(np.clip(bool(jacket.get("flooded", False)) + hidden.total("leg_water", leg=name), 0.0, 1.0))

        def section(x, half_m=0.0, name=name, filled=filled):
            bays = [k for k, bay in enumerate(jacket["bay"], start=1) if bay["bottom_m"] < x[2] < bay["top_m"]]
            left = hidden.factor("leg_stiffness", leg=name, bay=bays[0]) if bays else 1.0
            return steel.section("leg", jacket["leg"], leg=name, flooded=filled, stiffness=left)(x, half_m)

        ends = tuple(_flexibility(hidden.total(kind, leg=name), section(point))
                     for kind, point in (("grout_flexibility", foot), ("tp_flexibility", head)))
        mesh.member(foot, head, "leg", section, at=at, ends=ends, part=f"leg {name}")


def _braces(mesh: Mesh, file: TurbineFile, steel: Materials, truth: Truth) -> None:
    jacket, p, hidden = file.value("jacket"), steel.p, steel.hidden
    names = jacket["leg_names"]
    law = jacket["joints"]["law"]
    if law not in ("fessler", "rigid"):
        raise InputError(f"{file.path}, jacket.joints.law", f"'{law}' is unknown", "choose fessler or rigid")
    for number, bay in enumerate(jacket["bay"], start=1):
        for leg, name in enumerate(names):
            other = (leg + 1) % len(names)
            face = f"{name}{names[other]}"
            left = [_leg_point(file, leg, bay[k]) for k in ("bottom_m", "top_m")]
            right = [_leg_point(file, other, bay[k]) for k in ("bottom_m", "top_m")]
            below, above = np.linalg.norm(right[0] - left[0]), np.linalg.norm(right[1] - left[1])
            crossing = left[0] + below / (below + above) * (right[1] - left[0])
            filled = min(hidden.total("brace_flooding", bay=number, face=face), 1.0)
            both = hidden.factor("brace_stiffness", bay=number, face=face)
            # all four half braces of a face and bay, each from its leg to the crossing
            for corner, chord, end, brace_number, at_leg in (
                (left[0], left, "bottom", 1, name), (left[1], left, "top", 2, name),
                (right[0], right, "bottom", 2, names[other]), (right[1], right, "top", 1, names[other]),
            ):
                chord_axis = (chord[1] - chord[0]) / np.linalg.norm(chord[1] - chord[0])
                one = hidden.factor("single_brace", bay=number, face=face, brace=brace_number)
                tight = hidden.factor("joint_stiffness", bay=number, face=face, leg=at_leg, end=end)
                section = steel.section("brace", bay["brace"], stiffness=both * one, flooded=filled)
                flexibility = None
                if law == "fessler" or tight != 1.0:
                    along = (crossing - corner) / np.linalg.norm(crossing - corner)
                    leg_tube = steel.tube("leg", jacket["leg"]["diameter_m"], jacket["leg"]["thickness_m"], corner[2])
                    brace = steel.tube("brace", bay["brace"]["diameter_m"], bay["brace"]["thickness_m"], corner[2])
                    flexibility = soil.joint_flexibility(
                        brace.diameter_m, leg_tube.diameter_m, leg_tube.thickness_m,
                        float(np.arccos(abs(along @ chord_axis))), leg_tube.youngs_modulus_pa,
                    ) * truth.tolerances.joint_flexibility / p["LJF"]
                    if tight != 1.0:
                        flexibility = flexibility * (1 / tight - (law == "rigid"))
                mesh.member(corner, crossing, "brace", section, ends=(flexibility, None), beside=chord_axis)
            for _, weight in hidden.acting("odd_mass", bay=number, face=face):
                mesh.point_mass(mesh.node(crossing), weight)


def _piles(mesh: Mesh, file: TurbineFile, steel: Materials, truth: Truth) -> list[int]:
    pile, head_z, hidden = file.value("pile"), file.value("jacket", "bottom")["z_m"], steel.hidden
    ground, heads, names = steel.mudline(), [], file.value("jacket", "leg_names")
    softened = np.exp(-hidden.total("soil_softening"))
    for leg, factor in enumerate(truth.tolerances.leg_soil):
        name = names[leg]
        scour, mudline = hidden.total("scour", leg=name), steel.mudline(name)
        clay = soil.Clay(
            strength_mudline_pa=file.number("soil", "undrained_shear_strength_pa", "at_mudline", positive=True),
            strength_gradient_papm=file.number("soil", "undrained_shear_strength_pa", "gradient_per_m"),
            unit_weight_npm3=file.number("soil", "submerged_unit_weight_npm3", positive=True),
            strain_50=file.number("soil", "strain_50", positive=True),
            scour_m=steel.p["sc"] + scour,
        )
        part = {d: factor * softened * hidden.factor("soil_stiffness", leg=name, direction=d)
                for d in ("lateral", "axial", "tip")}
        head = _leg_point(file, leg, head_z)
        tip = np.array([head[0], head[1], pile["tip_m"]])
        # the cut stays where the ground is without a scour hole: the same mesh whatever the hole
        at = [(head_z - ground) / (head_z - pile["tip_m"])]
        section = steel.section("pile", pile, leg=name, flooded=float(bool(pile.get("flooded", False))))
        numbers = mesh.member(head, tip, "pile", section, at=at)
        heads.append(numbers[0])
        for i, j in itertools.pairwise(numbers):
            top, bottom = mudline - mesh.nodes[i][2], mudline - mesh.nodes[j][2]
            if scour:
                top, bottom = max(top, 0.0), max(bottom, 0.0)
            depth = np.array([0.75 * top + 0.25 * bottom, 0.25 * top + 0.75 * bottom])
            share = 0.5 * (bottom - top)
            lateral = part["lateral"] * share * soil.lateral_stiffness(clay, pile["diameter_m"], depth) / steel.p["py"]
            axial = part["axial"] * share * soil.axial_stiffness(clay, depth) / steel.p["tz"]
            for node, k in ((i, 0), (j, 1)):
                mesh.spring(node, np.array([lateral[k], lateral[k], axial[k]]))
        end = part["tip"] * soil.tip_stiffness(clay, pile["diameter_m"], mudline - pile["tip_m"]) / steel.p["qw"]
        mesh.spring(numbers[-1], np.array([0.0, 0.0, end]))
    return heads


def _transition(mesh: Mesh, file: TurbineFile, steel: Materials, truth: Truth) -> None:
    piece, top_z = file.value("transition_piece"), file.value("jacket", "top")["z_m"]
    low, foot = piece["column_bottom_m"], file.value("tower", "station")[0]["z_m"]
    own = _sensor_levels(file, steel.hidden, "column")
    at = [(z - low) / (foot - low) for z in {piece["strut_top_m"]} | own]
    column, strut, tie = (
        steel.section(part, piece[part], stiffness=steel.hidden.factor("tp_stiffness", part=part))
        for part in ("column", "strut", "tie")
    )
    mesh.member([0, 0, low], [0, 0, foot], "column", column, at=at, part="column")
    for leg in range(len(file.value("jacket", "leg_names"))):
        corner = _leg_point(file, leg, top_z)
        mesh.member(corner, [0, 0, piece["strut_top_m"]], "strut", strut)
        mesh.member(corner, [0, 0, low], "tie", tie)
    mesh.point_mass(mesh.node([0, 0, piece["strut_top_m"]]),
                    piece["lumped_mass_kg"] * truth.tolerances.secondary_steel
                    + steel.hidden.total("tp_mass"))


def _tower(mesh: Mesh, file: TurbineFile, steel: Materials, truth: Truth) -> int:
    stations, hidden = file.value("tower", "station"), steel.hidden
    z = np.array([s["z_m"] for s in stations])
    diameter, wall = ([s[key] for s in stations] for key in ("diameter_m", "thickness_m"))
    carried = file.number("tower", "secondary_steel_kgpm") * truth.tolerances.secondary_steel
    own = _sensor_levels(file, hidden, "tower")

    def section(x, half_m=0.0):
        left, more = 1.0, 0.0
        for _, factor in hidden.acting_in_band("tower_stiffness", x[2]):
            left *= factor
        for effect, weight in hidden.acting_in_band("tower_mass", x[2]):
            more += weight / (min(effect.get("top_m", z[-1]), z[-1]) - max(effect.get("bottom_m", z[0]), z[0]))
        return steel.tube("tower", np.interp(x[2], z, diameter), np.interp(x[2], z, wall), x[2], carried=carried + more,
                          stiffness=left)

    at = [(level - z[0]) / (z[-1] - z[0]) for level in {*z, *own}]
    soft = {round(float(level), 6): _flexibility(hidden.total("flange_flexibility", station=k), section([0, 0, level]))
            for k, level in enumerate(z, start=1) if hidden.acting("flange_flexibility", station=k)}
    mesh.member([0, 0, z[0]], [0, 0, z[-1]], "tower", section, at=at, inner=soft, part="tower")
    for station in stations:
        mesh.point_mass(mesh.node([0, 0, station["z_m"]]), station.get("flange_kg", 0.0))
    return mesh.node([0, 0, z[-1]])


def _bodies(file: TurbineFile, truth: Truth, hidden: HiddenEffects) -> tuple[tuple[float, np.ndarray, np.ndarray], ...]:
    """Weight, offset from the tower top, inertia of nacelle and hub."""
    moved = np.array([hidden.total("rna_offset", axis=axis) for axis in "xyz"])
    turning = np.array([hidden.total("rna_inertia", axis=axis) for axis in "xyz"])
    ice, heavier = hidden.total("icing"), hidden.total("rna_mass")
    bodies = []
    for body in file.value("rna"):
        hub = body["name"] == "hub"
        weight = truth.parameters["m_h"] if hub else body["mass_kg"] * truth.tolerances.nacelle_mass
        weight += ice if hub else heavier
        offset = np.array(body["offset_m"], float) + truth.tolerances.rna_offset_m + moved
        # a turning rotor carries no inertia about its axis
        inertia = np.array(body["inertia_kgm2"], float)
        inertia = inertia + (0.5 * ice * ICE_RADIUS_M**2 * np.array([0.0, 1.0, 1.0]) if hub else turning)
        bodies.append((float(weight), offset, np.diag(inertia)))
    return tuple(bodies)


def _soften_by_weight(mesh: Mesh, hidden: HiddenEffects, bodies) -> None:
    """The weight above on each tower element: geometric stiffness of a string, which a fine mesh makes a beam's."""
    scale = hidden.total("p_delta")
    if not scale:
        return
    among = set(mesh.part["tower"])
    above = 9.81 * sum(weight for weight, _, _ in bodies)
    for i, j, tube in reversed([e for e in mesh.elements if e[0] in among and e[1] in among]):
        length = float(np.linalg.norm(mesh.nodes[j] - mesh.nodes[i]))
        above += 9.81 * length * (tube.density_kgpm3 * tube.area_m2 + tube.carried_kgpm)
        for axis in np.eye(3)[:2]:
            mesh.spring_along(i, axis, -scale * above / length, j)


def _add_foreign_springs(mesh: Mesh, file: TurbineFile, hidden: HiddenEffects) -> None:
    """Springs that no drawing has."""
    names = file.value("jacket", "leg_names")
    for effect, stiffness in hidden.acting("cable"):
        for name in names:
            if effect["leg"] in (name, "all"):
                leg = mesh.nearest(mesh.part[f"leg {name}"], _leg_point(file, names.index(name), effect["z_m"]))
                tower = mesh.nearest(mesh.part["tower"], np.array([0, 0, effect["tower_z_m"]]))
                along = mesh.nodes[tower] - mesh.nodes[leg]
                mesh.spring_along(leg, along / np.linalg.norm(along), stiffness, tower)
    for effect, stiffness in hidden.acting("fender"):
        for name in names:
            if effect["leg"] in (name, "all"):
                leg = mesh.nearest(mesh.part[f"leg {name}"], _leg_point(file, names.index(name), effect["z_m"]))
                mesh.spring_along(leg, _horizontal(effect["direction_deg"]), stiffness)


def _horizontal(angle_deg: float) -> np.ndarray:
    return np.array([np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg)), 0.0])


def _oscillators(mesh: Mesh, file: TurbineFile, hidden: HiddenEffects, top: int, hub_m: np.ndarray) -> tuple[
        tuple[Oscillator, float], ...]:
    """Blades (part of the hub, coupled along the rotor's axis), tuned masses and second structures, each with its
    spring in N/m."""
    hung: list[tuple[Mapping, float, int, list[np.ndarray | None]]] = []
    for effect, weight in hidden.acting("blade_coupling"):
        hung.append((effect, weight, top, [None]))
    for effect, weight in hidden.acting("tuned_mass"):
        node = mesh.nearest(mesh.part["tower"], np.array([0, 0, effect["z_m"]]))
        hung.append((effect, weight, node, [_horizontal(effect["direction_deg"])]))
    names = file.value("jacket", "leg_names")
    for effect, weight in hidden.acting("second_structure"):
        for name in names:
            if effect["leg"] in (name, "all"):
                node = mesh.nearest(mesh.part[f"leg {name}"], _leg_point(file, names.index(name), effect["z_m"]))
                hung.append((effect, weight, node, [_horizontal(0.0), _horizontal(90.0)]))
    found = []
    for effect, given, node, directions in hung:
        weight = max(given, SMALLEST_OSCILLATOR_KG)
        if directions[0] is not None:
            mesh.point_mass(node, weight)
        for along in directions:
            oscillator = Oscillator(dof=6 * len(mesh.nodes) + len(found), node=node, direction=along, mass_kg=weight,
                                    arm_m=hub_m if along is None else np.zeros(3))
            found.append((oscillator, weight * (2 * np.pi * effect["frequency_hz"]) ** 2))
    return tuple(found)


def build_structure(
    file: TurbineFile, truth: Truth, amount: Sequence[float] | np.ndarray | None = None, *, coarseness: float = 1.0
) -> Structure:
    """Assemble the turbine of the drawing as it is in truth, each effect at its amount (n_effect,); None: all at 1.
    coarseness: how many times longer than usual elements may be."""
    hidden = HiddenEffects(effects=truth.effects,
                           amount=tuple(np.ones(len(truth.effects)) if amount is None else amount))
    mesh = Mesh(coarseness)
    steel = Materials(file=file, p=truth.parameters, truth=truth, hidden=hidden)
    _legs(mesh, file, steel)
    _braces(mesh, file, steel, truth)
    heads = _piles(mesh, file, steel, truth)
    _transition(mesh, file, steel, truth)
    top = _tower(mesh, file, steel, truth)
    bodies = _bodies(file, truth, hidden)
    _soften_by_weight(mesh, hidden, bodies)
    _add_foreign_springs(mesh, file, hidden)
    hub = next(k for k, body in enumerate(file.value("rna")) if body["name"] == "hub")
    sprung = _oscillators(mesh, file, hidden, top, bodies[hub][1])
    stiffness, mass = mesh.matrices()
    if sprung:
        stiffness = sparse.csc_array(sparse.block_diag([stiffness, np.diag([k for _, k in sprung])]))
        mass = sparse.csc_array(sparse.block_diag([mass, np.diag([o.mass_kg for o, _ in sprung])]))
    nodes = np.array(mesh.nodes)
    surface_z = file.number("site", "water_level_m") - WAVE_DEPTH_M
    surface = np.array([
        mesh.nearest(mesh.part[f"leg {name}"], _leg_point(file, leg, surface_z))
        for leg, name in enumerate(file.value("jacket", "leg_names"))
    ])
    nominal, attached = observation.attachments(mesh, file), observation.attachments(mesh, file, hidden)
    n_dof = stiffness.shape[0]
    direction, gain = observation.mounted_direction(file, truth, hidden)
    channel = observation.reading_rows(attached, direction, gain, n_dof)
    mixing = observation.channel_mixing(file, hidden)
    nominal_direction, felt = observation.nominal_direction(file), observation.felt_gravity(file, hidden)
    tilt = observation.tilting_rows(attached, direction, gain * felt, n_dof)
    every, axes = [a for a in attached for _ in range(3)], np.tile(np.eye(3), (len(attached), 1))
    return Structure(
        node_m=nodes, stiffness=stiffness, mass=mass,
        nominal_channel=observation.reading_rows(nominal, nominal_direction, np.ones(len(nominal)), n_dof),
        channel=channel if mixing is None else sparse.csr_array(mixing @ channel.toarray()),
        tilt=tilt if mixing is None else sparse.csr_array(mixing @ tilt.toarray()),
        nominal_tilt=observation.tilting_rows(nominal, nominal_direction, felt, n_dof),
        sensor_motion=observation.reading_rows(every, axes, np.ones(len(every)), n_dof),
        sensor_tilt=observation.tilting_rows(every, axes, np.repeat(felt, 3), n_dof), top=top,
        surface=surface, rna=bodies, pile_heads=np.array(heads), elements=tuple(mesh.elements),
        oscillators=tuple(o for o, _ in sprung),
    )
