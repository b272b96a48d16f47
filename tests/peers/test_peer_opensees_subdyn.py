"""SubDyn files against OpenSees: the same nodes, sections and soil in a code of others."""

from pathlib import Path

import numpy as np
import opensees_loader
import pytest

from probupdate.io.subdyn_file import read_subdyn
from probupdate.structure.load import load_model
from probupdate.structure.subdyn_frame import build_subdyn_frame, section_at
from tests.subdyn_text import STEEL, subdyn

OC4 = Path(__file__).resolve().parents[3] / "shared" / "reference" / "oc4"


@pytest.fixture(scope="module")
def ops():
    try:
        return opensees_loader.load_opensees()
    except (ImportError, OSError) as error:
        pytest.skip(f"OpenSees cannot be loaded: {error}")


def build(ops, file) -> None:
    frame = build_subdyn_frame(file)
    ops.wipe()
    ops.model("basic", "-ndm", 3, "-ndf", 6)
    for k, place in enumerate(frame.node_m):
        ops.node(k, *map(float, place))
    for reaction in file.reactions:
        ops.fix(frame.node_of[reaction.joint], *map(int, reaction.fixed))
    for k, element in enumerate(frame.elements, 1):
        s = section_at(file, element)
        ops.geomTransf("Linear", k, *map(float, element.axes[:, 0]))
        mass = ("-mass", s.density * s.area, "-cMass")
        if file.shear:
            ops.element("ElasticTimoshenkoBeam", k, *element.nodes, s.e, s.g, s.area, s.torsion, s.i_yy, s.i_xx,
                        s.kappa_y * s.area, s.kappa_x * s.area, k, *mass)
        else:
            ops.element("elasticBeamColumn", k, *element.nodes, s.area, s.e, s.g, s.torsion, s.i_yy, s.i_xx, k, *mass)


@pytest.mark.skipif(not OC4.exists(), reason="the OC4 input files of ../shared/reference/oc4 are not here")
@pytest.mark.parametrize("name", ["jk_fix_eb", "OC4_Jacket_SD_Input"])
def test_the_clamped_jackets_frequencies_are_those_of_opensees(ops, name, validation):
    row = validation(what="OC4 jacket clamped, Euler-Bernoulli and Timoshenko, six frequencies: how much lower",
                     reference="OpenSees, element for element", why="it leaves rotary inertia out")
    # OpenSees leaves out the rotary inertia of cross-sections, which lowers ours by up to 4e-4 here; its Timoshenko
    # mass is another too
    file = read_subdyn(OC4 / f"{name}.dat")
    build(ops, file)
    peer = np.sqrt(ops.eigen("-genBandArpack", 6)) / (2 * np.pi)
    ops.wipe()
    own = load_model(OC4 / f"{name}.dat").solve(np.zeros(0), 6).frequency_hz
    row.between(1 - own / peer, -1e-6, 6e-4)


UNITS = {"acceleration": "m/s2", "velocity": "m/s", "displacement": "m"}
# kg along three axes, kg m2 about them, of the head of a mast
TOP = (90e3, 90e3, 90e3, 3e6, 2e6, 4e6)


def lattice(n_leg, height, foot, seed):
    """A tapered lattice of three bays with a mast, as SubDyn input; the joints of its sensors and those sensors:
    (channel, joint, direction, quantity, what is stated of gravity). Six of them look anywhere from one joint."""
    rng, angle = np.random.default_rng(seed), 2 * np.pi * np.arange(n_leg) / n_leg + 0.3
    levels = ((0.0, 1.0), (0.17, 0.8), (0.34, 0.6), (0.47, 0.4))
    rings = [[[foot * r * np.cos(a), foot * r * np.sin(a), height * z] for a in angle] for z, r in levels]
    place = [*sum(rings, []), *([0.0, 0.0, z] for z in height * np.array([0.47, 0.7, 1.0]))]
    top = 4 * n_leg + 1
    rods = [(k + 1, k + 1 + n_leg, 1) for k in range(3 * n_leg)]
    rods += [(i * n_leg + a + 1, (i + 1) * n_leg + b + 1, 2) for i in range(3) for k in range(n_leg)
             for a, b in ((k, (k + 1) % n_leg), ((k + 1) % n_leg, k))]
    rods += [(3 * n_leg + k + 1, 3 * n_leg + (k + 1) % n_leg + 1, 2) for k in range(n_leg)]
    rods += [(3 * n_leg + k + 1, top, 3) for k in range(n_leg)] + [(top, top + 1, 3), (top + 1, top + 2, 3)]
    text = subdyn([" ".join(f"{x:.6f}" for x in at) for at in place], [f"{a} {b} {s} {s} 1c 0" for a, b, s in rods],
                  [f"{k + 1} 1 1 1 1 1 1" for k in range(n_leg)], fem=3, div=2,
                  circular=[f"1 {STEEL} 0.9 0.025", f"2 {STEEL} 0.5 0.012", f"3 {STEEL} 2.4 0.02"],
                  mass=[" ".join(map(str, [top + 2, *TOP[2:], *[0] * 6]))])
    kinds = [("acceleration", None), ("velocity", None), ("displacement", None), ("displacement", True),
             ("acceleration", False), ("velocity", False)]
    sensors = [(f"{joint}-{k}", joint, d / np.linalg.norm(d), *kind)
               for joint, those in ((top + 1, kinds), (top + 2, kinds[:2]), (n_leg + 2, kinds[:2]))
               for k, (kind, d) in enumerate(zip(those, rng.standard_normal((len(those), 3)), strict=True))]
    return text, sensors


@pytest.mark.parametrize("drawn", [(3, 85.0, 7.0, 71), (4, 60.0, 9.0, 72)])
def test_oblique_sensors_read_what_opensees_rotations_say(ops, tmp_path, drawn, validation):
    """What the model's pair does not explain of OpenSees' one, and of a model that knows no gravity far more."""
    row = validation(what="oblique sensors of acceleration, velocity and displacement on SubDyn lattices, six at a "
                          "joint, of which gravity is stated or not: readings of the first pair",
                     reference="motions and rotations of OpenSees", why="rotary inertia, which it leaves out")
    text, sensors = lattice(*drawn)
    (tmp_path / "lattice.dat").write_text(text)
    (tmp_path / "model.toml").write_text('[subdyn]\nfile = "lattice.dat"\n' + "".join(
        f'[[sensor]]\nchannel = "{name}"\njoint = {joint}\ndirection = {d.tolist()}\nquantity = "{quantity}"\n'
        f'unit = "{UNITS[quantity]}"\n' + ("" if felt is None else f"gravity = {str(felt).lower()}\n")
        for name, joint, d, quantity, felt in sensors))
    file = read_subdyn(tmp_path / "lattice.dat")
    build(ops, file)
    node_of = build_subdyn_frame(file).node_of
    ops.mass(node_of[max(joint for _, joint, *_ in sensors)], *TOP)
    square = np.array(ops.eigen("-genBandArpack", 8))
    theirs = []
    for _, joint, d, quantity, felt in sensors:
        v = np.array([ops.nodeEigenvector(node_of[joint], k + 1) for k in range(8)]).T
        held = quantity != "displacement" if felt is None else felt
        theirs.append(d @ v[:3] + held * 9.80665 / square * (d[0] * v[4] - d[1] * v[3]))
    ops.wipe()
    model = load_model(tmp_path / "model.toml")
    own = model.solve(np.zeros(0), 8)
    row.error(own.frequency_hz / np.sqrt(square) * 2 * np.pi - 1, 6e-4, "frequency")
    without = model.with_gravity(dict.fromkeys(model.channels, False)).solve(np.zeros(0), 8).shape
    theirs = np.array(theirs)[:, :2]
    # a pair is turned anyhow
    with_it, without_it = (float(np.linalg.norm(theirs - seen[:, :2] @ np.linalg.lstsq(seen[:, :2], theirs)[0])
                                 / np.linalg.norm(theirs)) for seen in (own.shape, without))
    row.error(with_it, 1e-4, "readings")
    assert without_it > 0.005
