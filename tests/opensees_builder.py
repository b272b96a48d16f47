"""The product's frame in OpenSees, element for element: the same nodes, tubes, ties, masses and joint springs."""

from __future__ import annotations

from collections.abc import Mapping
from types import ModuleType

import numpy as np

from probupdate.structure import beam as beams
from probupdate.structure.frame import Beam, Frame

# stiffness of what a joint does not release, N/m and N m/rad: 1e4 times the stiffest member
PENALTY = 1e14


def line_mass(beam: Beam, values: Mapping[str, float], *, water: bool) -> float:
    """Mass per metre in kg/m: OpenSees knows one, which moves along, across and about the axis."""
    mass = beam.density_kgpm3 * beam.tube.area(values)
    if water:
        length_free = [m.per_metre for m in beam.carried if m.moments is None]
        mass += sum(float(coefficient.value(values)) for coefficient in length_free)
    return float(mass)


def build(ops: ModuleType, frame: Frame, values: Mapping[str, float], *, water: bool = False) -> None:
    """Nodes keep their numbers; held ones that nothing joins are left out. Soil springs are lumped at the nodes."""
    ops.wipe()
    ops.model("basic", "-ndm", 3, "-ndf", 6)
    joined = {node for beam in frame.beams for node in (beam.start, beam.end)} | {tie.node for tie in frame.ties}
    for number in sorted(joined):
        ops.node(number, *map(float, frame.node_m[number]))
    for support in frame.supports:
        if support.node in joined:
            ops.fix(support.node, *map(int, support.held))
    for number, beam in enumerate(frame.beams):
        _member(ops, number, beam, frame, values, line_mass(beam, values, water=water))
    tag = len(frame.beams)
    for tie in frame.ties:
        if len(tie.released) and set(np.abs(tie.released).sum(axis=1)) == {1.0}:
            tag = _connection(ops, tag, tie, values)
        elif len(tie.released):
            tag = _joint(ops, tag, tie, values)
        else:
            ops.rigidLink("beam", tie.master, tie.node)
    for node, mass in _point_masses(frame, values).items():
        ops.mass(node, *map(float, mass))
    _soil(ops, tag, frame, values)


def _member(ops, number, beam, frame, values, mass) -> None:
    axes = beams.axes(frame.node_m[beam.start], frame.node_m[beam.end])
    E = beam.youngs_modulus_pa * float(beam.stiffness.value(values))
    # OpenSees takes the products with E: factors on one stiffness go into the section
    area = float(beam.tube.area(values) * beam.axial.value(values))
    second = float(beam.tube.second_moment(values) * beam.bending.value(values))
    ops.geomTransf("Linear", number + 1, *map(float, axes[2]))
    ops.element("elasticBeamColumn", number + 1, beam.start, beam.end, area, E, E / (2 * (1 + beam.poisson_ratio)),
                2 * second, second, second, number + 1, "-mass", mass, "-cMass")


def _joint(ops, tag, tie, values) -> int:
    """A zero-length element in the axes of the law: x along the brace, y about the out-of-plane axis, z in plane."""
    along, in_plane, out_of_plane = tie.released
    axial, bend_in, bend_out = (float(c.value(values)) for c in tie.stiffness)
    x, y = along[:3], out_of_plane[3:]
    assert np.abs(np.abs(np.cross(x, y)) - np.abs(in_plane[3:])).max() < 1e-9
    springs = (axial, PENALTY, PENALTY, PENALTY, bend_out, bend_in)
    for k, stiffness in enumerate(springs):
        ops.uniaxialMaterial("Elastic", 10 * tag + k + 1, stiffness)
    ops.element("zeroLength", tag + 1, tie.master, tie.node, "-mat", *[10 * tag + k + 1 for k in range(6)],
                "-dir", 1, 2, 3, 4, 5, 6, "-orient", *map(float, x), *map(float, y))
    return tag + 1


def _connection(ops, tag, tie, values) -> int:
    """A zero-length element in global axes: springs in some directions, stiff in the others."""
    springs = np.full(6, PENALTY)
    for direction, coefficient in zip(tie.released, tie.stiffness, strict=True):
        springs[int(np.argmax(direction))] = float(coefficient.value(values))
    for k, stiffness in enumerate(springs):
        ops.uniaxialMaterial("Elastic", 10 * tag + k + 1, float(stiffness))
    ops.element("zeroLength", tag + 1, tie.master, tie.node, "-mat", *[10 * tag + k + 1 for k in range(6)],
                "-dir", 1, 2, 3, 4, 5, 6)
    return tag + 1


def _point_masses(frame: Frame, values) -> dict[int, np.ndarray]:
    masses: dict[int, np.ndarray] = {}
    for body in frame.bodies:
        own = np.array([float(body.mass.value(values))] * 3 + list(np.diag(body.inertia_kgm2)))
        assert np.count_nonzero(body.inertia_kgm2 - np.diag(np.diag(body.inertia_kgm2))) == 0
        masses[body.node] = masses.get(body.node, 0) + own
    return masses


def _soil(ops, tag, frame: Frame, values) -> None:
    """Springs to the ground at nodes: half of each element's total at either end, and those at the tips."""
    total: dict[int, np.ndarray] = {}
    for beam in frame.beams:
        if beam.springs is not None:
            lateral, axial = (float(c[0].value(values)) for c in (beam.springs.lateral, beam.springs.axial))
            around = float(beam.springs.torsional[0].value(values)) if beam.springs.torsional else 0.0
            for node in (beam.start, beam.end):
                total[node] = total.get(node, np.zeros(6)) + 0.5 * np.array([lateral, lateral, axial, 0, 0, around])
    for spring in frame.springs:
        stiffness = float(spring.stiffness.value(values)) * np.abs(spring.direction)
        total[spring.node] = total.get(spring.node, np.zeros(6)) + stiffness
    ground = len(frame.node_m)
    for node, stiffness in total.items():
        ops.node(ground, *map(float, frame.node_m[node]))
        ops.fix(ground, *[1] * 6)
        directions = [k for k in range(6) if stiffness[k] > 0]
        for k in directions:
            ops.uniaxialMaterial("Elastic", 10 * tag + k + 1, float(stiffness[k]))
        if directions:
            ops.element("zeroLength", tag + 1, ground, node, "-mat", *[10 * tag + k + 1 for k in directions],
                        "-dir", *[k + 1 for k in directions])
        ground, tag = ground + 1, tag + 1


def static(ops: ModuleType, node: int, load: np.ndarray) -> None:
    """Solve for a load (6,) at a node."""
    ops.timeSeries("Linear", 1)
    ops.pattern("Plain", 1, 1)
    ops.load(node, *map(float, load))
    ops.system("UmfPack")
    ops.numberer("RCM")
    ops.constraints("Transformation")
    ops.algorithm("Linear")
    ops.integrator("LoadControl", 1.0)
    ops.analysis("Static", "-noWarnings")
    assert ops.analyze(1) == 0


def frequencies(ops: ModuleType, n_mode: int) -> np.ndarray:
    """Hz."""
    ops.constraints("Transformation")
    ops.system("UmfPack")
    ops.numberer("RCM")
    return np.sqrt(np.array(ops.eigen("-genBandArpack", n_mode))) / (2 * np.pi)
