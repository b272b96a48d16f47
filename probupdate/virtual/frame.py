"""The virtual turbine's structure: nodes, Timoshenko tubes, lumped masses, soil springs -> K, M, channels.

It is built from the same drawing (model.toml) as the model that is updated, and shares no code with it: finer mesh,
lumped mass, Timoshenko tubes, the soil laws of `soil`, drawn tolerances. The nacelle's heading turns the two masses
at the tower top. Not modelled: the frame's softening by its own weight, joint offsets at the chords, blades.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from probupdate.errors import InputError
from probupdate.virtual import beam, soil
from probupdate.virtual.truth import Truth
from probupdate.virtual.turbine_file import TurbineFile

LONGEST_M = {"leg": 1.75, "brace": 2.0, "pile": 1.0, "column": 1.0, "strut": 2.0, "tie": 2.0, "tower": 2.0}
WAVE_DEPTH_M = 6.0  # where the resultant of a wave of some seconds acts on a leg


@dataclass(frozen=True, eq=False, kw_only=True)
class Structure:
    """Six degrees of freedom a node. stiffness, mass (n_dof, n_dof) csc, the mass without what sits at the tower
    top; channel (n_channel, n_dof) csr as the sensors are mounted, nominal_channel as the drawing says; top the
    tower top's node; surface (n_leg,) the leg nodes that waves load; pile_heads (n_leg,) nodes; elements
    (node, node, tube)."""

    node_m: np.ndarray
    stiffness: sparse.csc_array
    mass: sparse.csc_array
    nominal_channel: sparse.csr_array
    channel: sparse.csr_array
    top: int
    surface: np.ndarray
    rna: tuple[tuple[float, np.ndarray, np.ndarray], ...]
    pile_heads: np.ndarray
    elements: tuple[tuple[int, int, beam.Tube], ...]


class _Mesh:
    """Collects nodes, element matrices and point masses; turned into matrices once, at the end."""

    def __init__(self):
        self.nodes: list[np.ndarray] = []
        self.found: dict[tuple, int] = {}
        self.part: dict[str, list[int]] = {}
        self.blocks: list[tuple[np.ndarray, np.ndarray]] = []
        self.mass_blocks: list[tuple[int, np.ndarray]] = []
        self.elements: list[tuple[int, int, beam.Tube]] = []

    def node(self, position) -> int:
        key = tuple(np.round(position, 6))
        if key not in self.found:
            self.found[key] = len(self.nodes)
            self.nodes.append(np.asarray(position, float))
        return self.found[key]

    def member(self, start, end, group, section, *, at=(), ends=(None, None), beside=None, part=None):
        """A straight member cut at the fractions `at` and to LONGEST_M; section(position) -> Tube; ends: flexibility
        at its first and last node -> node numbers along it."""
        start, end = np.asarray(start, float), np.asarray(end, float)
        stops = sorted({0.0, 1.0, *(round(float(t), 9) for t in at if 1e-6 < t < 1 - 1e-6)})
        length = np.linalg.norm(end - start)
        cuts = [0.0]
        for a, b in itertools.pairwise(stops):
            n = max(1, int(np.ceil((b - a) * length / LONGEST_M[group] - 1e-9)))
            cuts.extend(a + (b - a) * np.arange(1, n + 1) / n)
        numbers = [self.node(start + t * (end - start)) for t in cuts]
        for k, (i, j) in enumerate(itertools.pairwise(numbers)):
            a, b = self.nodes[i], self.nodes[j]
            tube = section(0.5 * (a + b))
            axes, step = beam.local_axes(a, b, beside)
            local = beam.local_stiffness(tube, step)
            first = ends[0] if k == 0 else None
            last = ends[1] if k == len(numbers) - 2 else None
            if first is not None or last is not None:
                local = beam.soften_ends(local, np.zeros(6) if first is None else first,
                                         np.zeros(6) if last is None else last)  # fmt: skip
            self.blocks.append((self._dofs(i, j), beam.to_global(local, axes)))
            half = beam.lumped_mass(tube, step, axes)
            self.mass_blocks += [(i, half), (j, half)]
            self.elements.append((i, j, tube))
        if part is not None:
            self.part.setdefault(part, []).extend(numbers)
        return numbers

    @staticmethod
    def _dofs(*numbers: int) -> np.ndarray:
        return np.concatenate([6 * n + np.arange(6) for n in numbers])

    def point_mass(self, number: int, mass_kg: float) -> None:
        self.mass_blocks.append((number, np.diag([mass_kg] * 3 + [0.0] * 3)))

    def spring(self, number: int, translational: np.ndarray) -> None:
        """translational (3,) in N/m along x, y, z."""
        self.blocks.append((self._dofs(number), np.diag([*translational, 0.0, 0.0, 0.0])))

    def matrices(self) -> tuple[sparse.csc_array, sparse.csc_array]:
        size = 6 * len(self.nodes)

        def build(blocks):
            rows = np.concatenate([np.repeat(d, len(d)) for d, _ in blocks])
            columns = np.concatenate([np.tile(d, len(d)) for d, _ in blocks])
            values = np.concatenate([m.ravel() for _, m in blocks])
            return sparse.coo_array((values, (rows, columns)), shape=(size, size)).tocsc()

        return build(self.blocks), build([(self._dofs(n), m) for n, m in self.mass_blocks])


@dataclass(frozen=True, kw_only=True)
class _Materials:
    """Sections of every group with parameters, tolerances and surroundings applied."""

    file: TurbineFile
    p: Mapping[str, float]
    truth: Truth

    def tube(self, group: str, diameter_m: float, thickness_m: float, z_m: float, *, stiffness: float = 1.0,
             flooded: bool = False, wet: bool = True, carried: float = 0.0) -> beam.Tube:  # fmt: skip
        f, p, t = self.file, self.p, self.truth.tolerances
        wall = {"leg": t.leg_wall, "brace": t.brace_wall, "pile": t.pile_wall, "tower": t.tower_wall}.get(group, 1.0)
        factor = {"leg": "k_j", "brace": "k_j", "pile": "k_p", "tower": "k_t"}.get(group, "k_TP")
        if group in ("leg", "brace"):
            diameter_m *= p["D_l" if group == "leg" else "D_b"]
            thickness_m *= p["t_l" if group == "leg" else "t_b"]
        thickness_m *= wall
        if group in ("leg", "brace"):
            low, high = f.number("corrosion", "bottom_m"), f.number("corrosion", "top_m")
            if low < z_m < high:
                diameter_m, thickness_m = diameter_m - 2 * p["corr"], thickness_m - p["corr"]
        if not 0 < thickness_m < diameter_m / 2:
            raise InputError(str(f.path), f"a {group} at z = {z_m:.1f} m has a wall of {thickness_m:.4f} m",
                             "mend its section, or the parameters that act on it")  # fmt: skip
        added = 0.0
        if wet and self.mudline < z_m < f.number("site", "water_level_m"):
            grown = p["mg"] if z_m < f.number("hydrodynamics", "growth_top_m") else 0.0
            outer = diameter_m + 2 * grown
            water = f.number("site", "water_density_kgpm3")
            growth = f.number("hydrodynamics", "growth_density_kgpm3") * np.pi / 4 * (outer**2 - diameter_m**2)
            added = p["a_m"] * f.number("hydrodynamics", "added_mass_coefficient") * water * np.pi / 4 * outer**2
            carried += growth
        if flooded and z_m < f.number("site", "water_level_m"):
            water = f.number("site", "water_density_kgpm3")
            carried += water * np.pi / 4 * (diameter_m - 2 * thickness_m) ** 2
        return beam.Tube(
            diameter_m=diameter_m, thickness_m=thickness_m,
            youngs_modulus_pa=f.number("steel", "youngs_modulus_pa") * p[factor] * stiffness,
            poisson_ratio=f.number("steel", "poisson_ratio"), density_kgpm3=f.number("steel", "density_kgpm3"),
            carried_kgpm=carried, added_kgpm=added,
        )  # fmt: skip

    @property
    def mudline(self) -> float:
        return self.file.number("site", "mudline_m") - self.p["sc"]

    def section(self, group: str, entry: Mapping, **kwargs):
        return lambda x: self.tube(group, entry["diameter_m"], entry["thickness_m"], x[2], **kwargs)


def _leg_point(file: TurbineFile, leg: int, z: float) -> np.ndarray:
    low, high = file.value("jacket", "bottom"), file.value("jacket", "top")
    along = (z - low["z_m"]) / (high["z_m"] - low["z_m"])
    spacing = low["leg_spacing_m"] + along * (high["leg_spacing_m"] - low["leg_spacing_m"])
    n_leg = len(file.value("jacket", "leg_names"))
    angle = np.radians(file.number("jacket", "first_leg_angle_deg") + 360 / n_leg * leg)
    radius = spacing / (2 * np.sin(np.pi / n_leg))
    return np.array([radius * np.cos(angle), radius * np.sin(angle), z])


def _legs(mesh: _Mesh, file: TurbineFile, steel: _Materials) -> None:
    jacket = file.value("jacket")
    low, high = jacket["bottom"]["z_m"], jacket["top"]["z_m"]
    levels = {bay[key] for bay in jacket["bay"] for key in ("bottom_m", "top_m")}
    levels |= {file.number("site", "water_level_m"), file.number("hydrodynamics", "growth_top_m"),
               file.number("corrosion", "bottom_m"), file.number("corrosion", "top_m")}  # fmt: skip
    for leg, name in enumerate(jacket["leg_names"]):
        own = {s.position_m[2] for s, part in zip(file.sensors, file.parts, strict=True) if part == f"leg {name}"}
        at = [(z - low) / (high - low) for z in levels | own]
        section = steel.section("leg", jacket["leg"], flooded=bool(jacket.get("flooded", False)))
        mesh.member(_leg_point(file, leg, low), _leg_point(file, leg, high), "leg", section, at=at, part=f"leg {name}")


def _braces(mesh: _Mesh, file: TurbineFile, steel: _Materials, truth: Truth) -> None:
    jacket, p = file.value("jacket"), steel.p
    names = jacket["leg_names"]
    law = jacket["joints"]["law"]
    if law not in ("fessler", "rigid"):
        raise InputError(f"{file.path}, jacket.joints.law", f"'{law}' is unknown", "choose fessler or rigid")
    lost = {(e["bay"], e["face"]): e["factor"] for e in truth.effects if e["kind"] == "brace_stiffness"}
    for number, bay in enumerate(jacket["bay"], start=1):
        for leg, name in enumerate(names):
            other = (leg + 1) % len(names)
            left = [_leg_point(file, leg, bay[k]) for k in ("bottom_m", "top_m")]
            right = [_leg_point(file, other, bay[k]) for k in ("bottom_m", "top_m")]
            below, above = np.linalg.norm(right[0] - left[0]), np.linalg.norm(right[1] - left[1])
            crossing = left[0] + below / (below + above) * (right[1] - left[0])
            stiffness = lost.get((number, f"{name}{names[other]}"), 1.0)
            section = steel.section("brace", bay["brace"], stiffness=stiffness)
            # all four half braces of a face and bay, each from its leg to the crossing
            for corner, chord in ((left[0], left), (left[1], left), (right[0], right), (right[1], right)):
                chord_axis = (chord[1] - chord[0]) / np.linalg.norm(chord[1] - chord[0])
                flexibility = None
                if law == "fessler":
                    along = (crossing - corner) / np.linalg.norm(crossing - corner)
                    leg_tube = steel.tube("leg", jacket["leg"]["diameter_m"], jacket["leg"]["thickness_m"], corner[2])
                    brace = steel.tube("brace", bay["brace"]["diameter_m"], bay["brace"]["thickness_m"], corner[2])
                    flexibility = soil.joint_flexibility(
                        brace.diameter_m, leg_tube.diameter_m, leg_tube.thickness_m,
                        float(np.arccos(abs(along @ chord_axis))), leg_tube.youngs_modulus_pa,
                    ) * truth.tolerances.joint_flexibility / p["LJF"]  # fmt: skip
                mesh.member(corner, crossing, "brace", section, ends=(flexibility, None), beside=chord_axis)


def _piles(mesh: _Mesh, file: TurbineFile, steel: _Materials, truth: Truth) -> list[int]:
    pile, head_z = file.value("pile"), file.value("jacket", "bottom")["z_m"]
    clay = soil.Clay(
        strength_mudline_pa=file.number("soil", "undrained_shear_strength_pa", "at_mudline", positive=True),
        strength_gradient_papm=file.number("soil", "undrained_shear_strength_pa", "gradient_per_m"),
        unit_weight_npm3=file.number("soil", "submerged_unit_weight_npm3", positive=True),
        strain_50=file.number("soil", "strain_50", positive=True),
        scour_m=steel.p["sc"],
    )
    mudline, heads = steel.mudline, []
    for leg, factor in enumerate(truth.tolerances.leg_soil):
        head = _leg_point(file, leg, head_z)
        tip = np.array([head[0], head[1], pile["tip_m"]])
        at = [(head_z - mudline) / (head_z - pile["tip_m"])]
        section = steel.section("pile", pile, flooded=bool(pile.get("flooded", False)))
        numbers = mesh.member(head, tip, "pile", section, at=at)
        heads.append(numbers[0])
        for i, j in itertools.pairwise(numbers):
            top, bottom = mudline - mesh.nodes[i][2], mudline - mesh.nodes[j][2]
            depth = np.array([0.75 * top + 0.25 * bottom, 0.25 * top + 0.75 * bottom])
            share = factor * 0.5 * (bottom - top)
            lateral = share * soil.lateral_stiffness(clay, pile["diameter_m"], depth) / steel.p["py"]
            axial = share * soil.axial_stiffness(clay, depth) / steel.p["tz"]
            for node, k in ((i, 0), (j, 1)):
                mesh.spring(node, np.array([lateral[k], lateral[k], axial[k]]))
        end = factor * soil.tip_stiffness(clay, pile["diameter_m"], mudline - pile["tip_m"]) / steel.p["qw"]
        mesh.spring(numbers[-1], np.array([0.0, 0.0, end]))
    return heads


def _transition(mesh: _Mesh, file: TurbineFile, steel: _Materials, truth: Truth) -> None:
    piece, top_z = file.value("transition_piece"), file.value("jacket", "top")["z_m"]
    low, foot = piece["column_bottom_m"], file.value("tower", "station")[0]["z_m"]
    own = {s.position_m[2] for s, part in zip(file.sensors, file.parts, strict=True) if part == "column"}
    at = [(z - low) / (foot - low) for z in {piece["strut_top_m"]} | own]
    column = steel.section("column", piece["column"])
    mesh.member([0, 0, low], [0, 0, foot], "column", column, at=at, part="column")
    for leg in range(len(file.value("jacket", "leg_names"))):
        corner = _leg_point(file, leg, top_z)
        mesh.member(corner, [0, 0, piece["strut_top_m"]], "strut", steel.section("strut", piece["strut"]))
        mesh.member(corner, [0, 0, low], "tie", steel.section("tie", piece["tie"]))
    mesh.point_mass(mesh.node([0, 0, piece["strut_top_m"]]),
                    piece["lumped_mass_kg"] * truth.tolerances.secondary_steel)  # fmt: skip


def _tower(mesh: _Mesh, file: TurbineFile, steel: _Materials, truth: Truth) -> int:
    stations = file.value("tower", "station")
    z = np.array([s["z_m"] for s in stations])
    diameter, wall = ([s[key] for s in stations] for key in ("diameter_m", "thickness_m"))
    carried = file.number("tower", "secondary_steel_kgpm") * truth.tolerances.secondary_steel
    own = {s.position_m[2] for s, part in zip(file.sensors, file.parts, strict=True) if part == "tower"}

    def section(x):
        return steel.tube("tower", np.interp(x[2], z, diameter), np.interp(x[2], z, wall), x[2], carried=carried)

    at = [(level - z[0]) / (z[-1] - z[0]) for level in {*z, *own}]
    mesh.member([0, 0, z[0]], [0, 0, z[-1]], "tower", section, at=at, part="tower")
    for station in stations:
        mesh.point_mass(mesh.node([0, 0, station["z_m"]]), station.get("flange_kg", 0.0))
    return mesh.node([0, 0, z[-1]])


def build_structure(file: TurbineFile, truth: Truth) -> Structure:
    """Assemble the turbine of the drawing as it is in truth."""
    mesh = _Mesh()
    steel = _Materials(file=file, p=truth.parameters, truth=truth)
    _legs(mesh, file, steel)
    _braces(mesh, file, steel, truth)
    heads = _piles(mesh, file, steel, truth)
    _transition(mesh, file, steel, truth)
    top = _tower(mesh, file, steel, truth)
    stiffness, mass = mesh.matrices()
    nodes = np.array(mesh.nodes)
    surface_z = file.number("site", "water_level_m") - WAVE_DEPTH_M
    surface = np.array([
        _nearest(nodes, mesh.part[f"leg {name}"], _leg_point(file, leg, surface_z))
        for leg, name in enumerate(file.value("jacket", "leg_names"))
    ])  # fmt: skip
    bodies = []
    for body in file.value("rna"):
        hub = body["name"] == "hub"
        weight = truth.parameters["m_h"] if hub else body["mass_kg"] * truth.tolerances.nacelle_mass
        offset = np.array(body["offset_m"], float) + truth.tolerances.rna_offset_m
        bodies.append((float(weight), offset, np.diag(np.array(body["inertia_kgm2"], float))))
    nominal, mounted = _channels(mesh, nodes, file, truth)
    return Structure(
        node_m=nodes, stiffness=stiffness, mass=mass, nominal_channel=nominal, channel=mounted, top=top,
        surface=surface, rna=tuple(bodies), pile_heads=np.array(heads), elements=tuple(mesh.elements),
    )  # fmt: skip


def _nearest(nodes: np.ndarray, among: list[int], point: np.ndarray) -> int:
    return among[int(np.argmin(np.linalg.norm(nodes[among] - point, axis=1)))]


def rotation(axis_angle: np.ndarray) -> np.ndarray:
    """Rotation matrix (3, 3) of an axis times an angle in rad (Rodrigues)."""
    angle = float(np.linalg.norm(axis_angle))
    if angle == 0:
        return np.eye(3)
    x, y, z = axis_angle / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def _channels(mesh: _Mesh, nodes: np.ndarray, file: TurbineFile, truth: Truth):
    """Rows that read u + theta x r of the part's nearest node, along the direction: nominal, and as mounted."""
    t = truth.tolerances
    gain = np.array(t.sensor_gain)
    for effect in truth.effects:
        if effect["kind"] == "sensor_gain":
            gain[[s.channel for s in file.sensors].index(effect["channel"])] *= effect["factor"]
    nominal = np.zeros((len(file.sensors), 6 * len(nodes)))
    mounted = np.zeros_like(nominal)
    frame = rotation(np.radians([0.0, 0.0, t.frame_rotation_deg]))
    for row, (sensor, part) in enumerate(zip(file.sensors, file.parts, strict=True)):
        if part not in mesh.part:
            raise InputError(f"{file.path}, sensor {sensor.channel}", f"part '{part}' is unknown",
                             f"choose from {', '.join(mesh.part)}")  # fmt: skip
        number = _nearest(nodes, mesh.part[part], sensor.position_m)
        arm = sensor.position_m - nodes[number]
        own = rotation(np.radians(t.sensor_rotation_deg[row]))
        for matrix, direction, factor in (
            (nominal, sensor.direction, 1.0),
            (mounted, frame @ own @ sensor.direction, gain[row]),
        ):
            matrix[row, 6 * number : 6 * number + 3] = factor * direction
            # d . (theta x r) = theta . (r x d)
            matrix[row, 6 * number + 3 : 6 * number + 6] = factor * np.cross(arm, direction)
    return sparse.csr_array(nominal), sparse.csr_array(mounted)
