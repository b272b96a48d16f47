"""OpenSees as a third formulation: the same tubes as its Timoshenko elements, joints rigid, piles held."""

import copy
from dataclasses import replace
from types import MappingProxyType

import numpy as np
from scipy.sparse.linalg import spsolve

from probupdate.virtual import beam, dynamics, frame, truth, turbine_file

AS_BUILT = turbine_file.reference_file().with_name("as_built.toml")


def test_compliance_is_that_of_opensees(ops, validation):
    row = validation(what="the virtual turbine's compliance", reference="OpenSees' Timoshenko elements",
                     why="two sparse solvers on matrices of condition 1e7 to 1e9")
    file = turbine_file.read_turbine(AS_BUILT)
    raw = copy.deepcopy(dict(file.raw))
    raw["jacket"]["joints"]["law"] = "rigid"
    file = replace(file, raw=MappingProxyType(raw))
    given = replace(truth.read_truth(None, file), tolerance_scale=1.0)
    drawn = truth.draw_truth(given, file, np.random.default_rng(2), dynamics.N_MODE)
    structure = frame.build_structure(file, drawn)
    nodes = structure.node_m
    held = nodes[:, 2] <= nodes[structure.pile_heads[0], 2] + 1e-9
    leg_top = int(np.argmin(np.linalg.norm(nodes - file.sensors[0].position_m, axis=1)))
    load = np.array([1e6, 5e5, -2e6, 1e6, 3e6, 4e6])

    free = np.flatnonzero(~np.repeat(held, 6))
    force = np.zeros(6 * len(nodes))
    force[6 * structure.top : 6 * structure.top + 6] = load
    moved = np.zeros_like(force)
    moved[free] = spsolve(structure.stiffness[free][:, free].tocsc(), force[free])

    ops.model("basic", "-ndm", 3, "-ndf", 6)
    for number, position in enumerate(nodes):
        ops.node(number, *map(float, position))
        if held[number]:
            ops.fix(number, *[1] * 6)
    for number, (i, j, tube) in enumerate(structure.elements):
        if held[i] and held[j]:
            continue
        axes, _ = beam.local_axes(nodes[i], nodes[j])
        ops.geomTransf("Linear", number + 1, *map(float, axes[2]))
        inertia, shear_area = tube.second_moment_m4, tube.shear_coefficient * tube.area_m2
        ops.element("ElasticTimoshenkoBeam", number + 1, i, j, tube.youngs_modulus_pa, tube.shear_modulus_pa,
                    tube.area_m2, 2 * inertia, inertia, inertia, shear_area, shear_area, number + 1)
    ops.timeSeries("Linear", 1)
    ops.pattern("Plain", 1, 1)
    ops.load(structure.top, *map(float, load))
    ops.system("UmfPack")
    ops.numberer("RCM")
    ops.constraints("Plain")
    ops.algorithm("Linear")
    ops.integrator("LoadControl", 1.0)
    ops.analysis("Static", "-noWarnings")
    assert ops.analyze(1) == 0
    for node in (structure.top, leg_top):
        peer = np.array([ops.nodeDisp(node, k) for k in range(1, 7)])
        ours = moved[6 * node : 6 * node + 6]
        for part in (slice(0, 3), slice(3, 6)):
            # two sparse solvers on a matrix of condition 1e7 to 1e9
            row.error((ours[part] - peer[part]) / np.abs(peer[part]).max(), 1e-6)
