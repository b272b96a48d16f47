"""Effects in OpenSees: the frame with effects off neutral, element for element, statically and dry in motion."""

from dataclasses import replace

import numpy as np
import opensees_builder
import pytest
from effects_turbine import entry, with_effects
from scipy import sparse
from scipy.sparse import linalg as sparse_linalg

from probupdate.structure import beam as beams
from probupdate.structure.assembly import assemble, node_dofs
from probupdate.structure.description_file import parse_description
from probupdate.structure.eigen import lowest_modes
from probupdate.structure.frame import Support
from probupdate.structure.turbine_frame import build_frame

MEMBERS = {
    "brace": ("stiffness", {"group": "brace", "face": "BC"}, {"motion": "axial"}, 0.1),
    "leg": ("stiffness", {"group": "leg", "leg": "D", "bay": 1}, {}, 0.5),
    "tower": ("stiffness", {"group": "tower", "level_m": [20.0, 41.0]}, {"motion": "bending"}, 0.8),
    "warmth": ("temperature", {"group": "strut"}, {"relative_per_degc": -1e-3}, 60.0),
    "ice": ("mass", {"body": "hub"}, {}, 8000.0),
    "corrosion": ("corrosion", {"group": "leg", "leg": "A"}, {}, 0.008),
}
JOINTS = {"joint": ("joint", {"leg": "A"}, {}, 0.05), "bend": ("joint", {"face": "CD"}, {"motion": "in plane"}, 0.1)}


def frame_of(effects, law):
    """Held at the pile heads, dry; its values off neutral and neutral."""
    raw = with_effects([entry(name, kind, on, settings, (1e-3, 2.0) if kind in ("stiffness", "joint") else (0, 1e4))
                        for name, (kind, on, settings, _) in effects.items()])
    for row in raw["parameter"]:
        if row.get("kind") == "corrosion":
            row["upper"] = 0.02
    raw["jacket"]["joints"]["law"] = law
    raw["parameter"] = [row for row in raw["parameter"] if law != "rigid" or row["name"] != "LJF"]
    description = parse_description(raw, "model.toml")
    frame = build_frame(description)
    below = {n for b in frame.beams if b.group == "pile" for n in (b.start, b.end)}
    kept = tuple(replace(b, carried=()) for b in frame.beams if b.group != "pile")
    frame = replace(frame, beams=kept, springs=(), supports=tuple(Support(node=n) for n in sorted(below)))
    neutral = description.values
    return frame, neutral | {name: value for name, (*_, value) in effects.items()}, neutral


def top_of(frame):
    return int(np.flatnonzero(np.all(np.abs(frame.node_m - [0, 0, 50.0]) < 1e-9, axis=1))[0])


def top_displacement(frame, values, load):
    assembled = assemble(frame, updated=(), values=values)
    force = np.zeros(6 * len(frame.node_m))
    force[node_dofs(top_of(frame))] = load
    q = sparse_linalg.spsolve(assembled.stiffness[0], assembled.transform.T @ force)
    return (assembled.transform @ q)[node_dofs(top_of(frame))]


@pytest.mark.parametrize(("effects", "law", "tolerance"), [(MEMBERS, "rigid", 1e-8), (JOINTS, "fessler", 1e-6)])
def test_compliance(ops, effects, law, tolerance, validation):
    row = validation(what="compliance with effects off neutral, of members with rigid joints and of joints",
                     reference="OpenSees", why="two sparse solvers; the penalty for what a joint does not release")
    frame, values, neutral = frame_of(effects, law)
    load = np.array([1e6, 5e5, -2e6, 1e6, 3e6, 4e7])
    ours, before = (top_displacement(frame, v, load) for v in (values, neutral))
    opensees_builder.build(ops, frame, values)
    opensees_builder.static(ops, top_of(frame), load)
    theirs = np.array([ops.nodeDisp(top_of(frame), k) for k in range(1, 7)])
    for part in (slice(0, 3), slice(3, 6)):
        scale = np.abs(theirs[part]).max()
        row.error((ours[part] - theirs[part]) / scale, tolerance, "members" if law == "rigid" else "joints")
        # the effects are felt a thousand times more than that
        assert np.abs(ours[part] - before[part]).max() > 1e3 * tolerance * scale


def test_frequencies(ops, validation):
    """Rigid joints; the rotary inertia of cross-sections, which OpenSees' element leaves out, taken away. It spins
    m J / A about the axis: factors on A or I alone would change that, so members are softened whole."""
    row = validation(what="eight frequencies with effects off neutral, rotary inertia taken away", reference="OpenSees",
                     why="eigensolvers")
    whole = {name: (kind, on, {} if kind == "stiffness" else settings, value)
             for name, (kind, on, settings, value) in MEMBERS.items()}
    frame, values, neutral = frame_of(whole, "rigid")
    opensees_builder.build(ops, frame, values)
    theirs = opensees_builder.frequencies(ops, 8)
    row.error(without_rotary(frame, values, 8) / theirs - 1, 1e-9)
    assert np.abs(without_rotary(frame, neutral, 8) / theirs - 1).max() > 1e-2


def without_rotary(frame, values, n_mode):
    assembled = assemble(frame, updated=(), values=values)
    rows, columns, entries = [], [], []
    for b in frame.beams:
        start, end = frame.node_m[b.start], frame.node_m[b.end]
        local = beams.rotary_mass(float(np.linalg.norm(end - start)))[0]
        inertia = b.density_kgpm3 * float(b.tube.second_moment(values))
        dofs = node_dofs(b.start, b.end)
        rows.append(np.repeat(dofs, 12))
        columns.append(np.tile(dofs, 12))
        entries.append((inertia * beams.to_global(local, beams.axes(start, end))).ravel())
    size = 6 * len(frame.node_m)
    spin = sparse.coo_array((np.concatenate(entries), (np.concatenate(rows), np.concatenate(columns))), (size, size))
    T = assembled.transform
    M = sparse.csc_array(assembled.mass[0] - T.T @ sparse.csr_array(spin) @ T)
    value, _ = lowest_modes(assembled.stiffness[0], M, n_mode)
    return np.sqrt(value) / (2 * np.pi)
