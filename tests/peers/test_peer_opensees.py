"""The product's frame against OpenSees, element for element: compliance, frequencies, and where the two must differ."""

from dataclasses import replace

import numpy as np
import opensees_builder
import opensees_loader
import pytest
from scipy import sparse
from scipy.sparse import linalg as sparse_linalg
from small_turbine import small_turbine

from probupdate.modal.modes import Sensor
from probupdate.structure import beam as beams
from probupdate.structure.assembly import assemble, node_dofs
from probupdate.structure.channels import channel_rows
from probupdate.structure.description_file import parse_description
from probupdate.structure.eigen import lowest_modes
from probupdate.structure.frame import Support, tube_property
from probupdate.structure.readings import channel_readings
from probupdate.structure.turbine_frame import build_frame


def frame_of(law="rigid", *, held_at_the_piles=True):
    raw = small_turbine()
    raw["mesh"]["elements_per_member"]["pile"] = 24
    raw["jacket"]["joints"]["law"] = law
    if law == "rigid":
        raw["parameter"] = [p for p in raw["parameter"] if p["name"] != "LJF"]
    description = parse_description(raw, "model.toml")
    frame = build_frame(description)
    if held_at_the_piles:
        heads = {b.start for b in frame.beams if b.group == "pile" and frame.node_m[b.start][2] > -19.5}
        below = {n for b in frame.beams if b.group == "pile" for n in (b.start, b.end)} | heads
        frame = replace(frame, beams=tuple(b for b in frame.beams if b.group != "pile"), springs=(),
                        supports=tuple(Support(node=n) for n in sorted(below)))
    return frame, description.values


def dry(frame):
    return replace(frame, beams=tuple(replace(b, carried=()) for b in frame.beams))


def solve(frame, values, n_mode, *, rotary=True):
    """Our frequencies; without the rotary inertia of cross-sections in bending, which OpenSees' element leaves out."""
    assembled = assemble(frame, updated=(), values=values)
    M = assembled.mass[0]
    if not rotary:
        size = 6 * len(frame.node_m)
        spin = np.zeros((size, size))
        for b in frame.beams:
            start, end = frame.node_m[b.start], frame.node_m[b.end]
            local = beams.rotary_mass(float(np.linalg.norm(end - start)))[0]
            inertia = b.density_kgpm3 * float(tube_property(b.tube, "second_moment").value(values))
            dofs = node_dofs(b.start, b.end)
            spin[np.ix_(dofs, dofs)] += inertia * beams.to_global(local, beams.axes(start, end))
        T = assembled.transform.toarray()
        M = sparse.csc_array(M.toarray() - T.T @ spin @ T)
    value, _ = lowest_modes(assembled.stiffness[0], M, n_mode)
    return np.sqrt(value) / (2 * np.pi)


def displacement(frame, values, node, load):
    """(n_node, 6) for a load (6,) at a node."""
    assembled = assemble(frame, updated=(), values=values)
    force = np.zeros(6 * len(frame.node_m))
    force[node_dofs(node)] = load
    q = sparse_linalg.spsolve(assembled.stiffness[0], assembled.transform.T @ force)
    return (assembled.transform @ q).reshape(-1, 6)


LOAD = np.array([1e6, 5e5, -2e6, 1e6, 3e6, 4e6])


def tower_top(frame):
    return int(np.flatnonzero(np.all(np.abs(frame.node_m - [0, 0, 50.0]) < 1e-9, axis=1))[0])


def static_error(ops, frame, values):
    """Largest error of displacements and of rotations under LOAD, of their largest."""
    top = tower_top(frame)
    ours = displacement(frame, values, top, LOAD)
    opensees_builder.build(ops, frame, values)
    opensees_builder.static(ops, top, LOAD)
    nodes = sorted({n for b in frame.beams for n in (b.start, b.end)})
    theirs = np.array([[ops.nodeDisp(n, k) for k in range(1, 7)] for n in nodes])
    return max(
        np.abs(ours[nodes][:, part] - theirs[:, part]).max() / np.abs(theirs[:, part]).max()
        for part in (slice(0, 3), slice(3, 6))
    )


def test_compliance_with_rigid_joints(ops, validation):
    row = validation(what="compliance of the small turbine, rigid joints", reference="OpenSees",
                     why="two sparse solvers")
    frame, values = frame_of()
    row.error(static_error(ops, frame, values), 1e-8)


def test_compliance_with_flexible_joints(ops, validation):
    """A penalty of 1e14 N/m stands for what a joint does not release."""
    row = validation(what="compliance with flexible joints", reference="OpenSees with penalties of 1e14 N/m",
                     why="the penalty")
    frame, values = frame_of("fessler")
    rigid, _ = frame_of()
    row.error(static_error(ops, frame, values), 1e-6)
    # and the joints are felt: more than a hundred times the tolerance
    soft, stiff = (displacement(f, values, tower_top(f), LOAD)[tower_top(f)] for f in (frame, rigid))
    assert abs(soft[0] / stiff[0] - 1) > 1e-3


def test_frequencies_where_the_formulations_agree(ops, validation):
    """Dry, rigid joints, held at the pile heads, our rotary inertia taken away: one formulation in two programs."""
    row = validation(what="ten frequencies, one formulation in two programs", reference="OpenSees", why="eigensolvers")
    frame, values = frame_of()
    frame = dry(frame)
    opensees_builder.build(ops, frame, values)
    theirs = opensees_builder.frequencies(ops, 10)
    row.error(solve(frame, values, 10, rotary=False) / theirs - 1, 1e-9)


def test_rotary_inertia_is_the_difference_of_the_dry_frames(ops, validation):
    row = validation(what="ten frequencies of the dry frame: how much rotary inertia lowers the first, all; the most",
                     reference="OpenSees, which has none", why="inertia only slows")
    frame, values = frame_of()
    frame = dry(frame)
    opensees_builder.build(ops, frame, values)
    theirs = opensees_builder.frequencies(ops, 10)
    loss = 1 - solve(frame, values, 10) / theirs
    # inertia only slows; a short tower of 5 m diameter feels it more than a slender one
    row.between(loss[0], 0, 1e-3, "first")
    row.between(loss, 0, 5e-3, "all")
    row.least(loss.max(), 1e-4, "most")


def test_water_moves_across_and_does_not_spin(ops, validation):
    """OpenSees lets water, growth and added mass move along the member and spin about it: no mode of ours is slower."""
    row = validation(what="water that moves across only: how much higher the first pair, ten frequencies are; the most",
                     reference="OpenSees, where it moves along and spins too",
                     why="sway moves the legs mostly across")
    frame, values = frame_of()
    opensees_builder.build(ops, frame, values, water=True)
    theirs = opensees_builder.frequencies(ops, 10)
    ours = solve(frame, values, 10, rotary=False)
    gain = ours / theirs - 1
    # sway moves the legs mostly across: little there, more where members spin or move along
    row.between(gain[:2], -1e-6, 1e-4, "first pair")
    row.between(gain, -1e-6, 5e-3, "all")
    row.least(gain.max(), 1e-5, "most")


def test_lumped_soil_springs_stay_close_to_consistent_ones(ops, validation):
    row = validation(what="consistent soil springs, four frequencies", reference="OpenSees, lumped springs",
                     why="lumping on 24 elements")
    frame, values = frame_of(held_at_the_piles=False)
    frame = dry(frame)
    opensees_builder.build(ops, frame, values)
    theirs = opensees_builder.frequencies(ops, 4)
    row.error(solve(frame, values, 4, rotary=False) / theirs - 1, 5e-3)


def test_an_opensees_that_cannot_be_loaded_gives_its_reason(monkeypatch):
    def fail(name):
        try:
            raise ImportError("libgfortran.so.5: cannot open shared object file")
        except ImportError:
            raise RuntimeError("Failed to import openseespy on Linux.")  # noqa: B904

    monkeypatch.setattr(opensees_loader.importlib, "import_module", fail)
    monkeypatch.setattr(opensees_loader.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r"libgfortran\.so\.5: cannot open"):
        opensees_loader.load_opensees()


def test_accelerometers_read_what_opensees_rotations_say(ops, validation):
    """Reading over motion of the first pair, both directions together as the pair is turned anyhow."""
    row = validation(what="accelerometers on the small jacket turbine, first bending: reading over motion",
                     reference="motions and rotations of OpenSees", why="rotary inertia, which it leaves out")
    frame, values = frame_of()
    frame = dry(frame)
    heights = {b.start for b in frame.beams if b.group in ("tower", "column")}
    tops = {b.end for b in frame.beams if b.group == "leg" and abs(frame.node_m[b.end][2] - 8.0) < 1e-9}
    nodes = sorted(heights | tops)
    sensors = tuple(Sensor(channel=f"{n}{a}", level="", position_m=frame.node_m[n], direction=np.eye(3)[a])
                    for n in nodes for a in (0, 1))
    assembled = assemble(frame, updated=(), values=values)
    value, phi = lowest_modes(assembled.stiffness[0], assembled.mass[0], 2)
    seen = channel_rows(frame, sensors, {}, "m")[0] @ assembled.transform @ phi
    ours = channel_readings(seen, value, np.full(len(sensors), 9.81)), seen[: len(sensors)]
    opensees_builder.build(ops, frame, values)
    square = (2 * np.pi * opensees_builder.frequencies(ops, 2)) ** 2
    motion = np.array([[ops.nodeEigenvector(n, j + 1, a + 1) for j in (0, 1)] for n in nodes for a in (0, 1)])
    # along x with the rotation about y, along y against that about x
    turn = np.array([[sign * ops.nodeEigenvector(n, j + 1, about) for j in (0, 1)]
                     for n in nodes for about, sign in ((5, 1.0), (4, -1.0))])
    theirs = motion + 9.81 / square * turn, motion
    ratio, expected = (np.linalg.norm(read, axis=1) / np.linalg.norm(plain, axis=1) for read, plain in (ours, theirs))
    assert expected.min() > 1.003
    row.error(ratio / expected - 1, below=3e-4)
