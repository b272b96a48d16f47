"""SubDyn models: elements, joints, links and masses against theory and a second route; parameters; the `modes` verb."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eigh

import probupdate
from probupdate.cli import main
from probupdate.errors import InputError
from probupdate.io.subdyn_file import read_subdyn
from probupdate.modal.modes import Sensor
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.load import load_model
from probupdate.structure.subdyn_frame import box as box_section
from probupdate.structure.subdyn_frame import (
    build_subdyn_frame,
    direction_cosines,
    plain_matrices,
    rigid_body_mass,
    tube,
)
from tests.subdyn_text import FRAME_GROUPS, FRAME_SENSORS, STEEL, subdyn

OC4 = Path(__file__).resolve().parents[3] / "shared" / "reference" / "oc4"
CLAMPED = "1 1 1 1 1 1 1"


def written(folder, *args, **more):
    path = folder / "structure.dat"
    path.write_text(subdyn(*args, **more))
    return path


def frequencies(path, count=6):
    return probupdate.model_modes(path, count).frequency_hz


def manual_beam(section, length, shear):
    """The stiffness and mass of SubDyn's manual, written out for u_x, u_y, u_z, r_x, r_y, r_z, axis along z."""
    s, L = section, length
    E, G, A, rho = s.e, s.g, s.area, s.density
    kx = 12 * E * s.i_yy / (G * s.kappa_x * A * L**2) if shear else 0.0
    ky = 12 * E * s.i_xx / (G * s.kappa_y * A * L**2) if shear else 0.0
    K, M = np.zeros((12, 12)), np.zeros((12, 12))
    for u, r, second, k, sign in ((0, 4, s.i_yy, kx, 1), (1, 3, s.i_xx, ky, -1)):
        index = [u, r, u + 6, r + 6]
        turn = np.diag([1, sign, 1, sign])
        stiffness = E * second / (L**3 * (1 + k)) * np.array(
            [[12, 6 * L, -12, 6 * L], [6 * L, (4 + k) * L**2, -6 * L, (2 - k) * L**2],
             [-12, -6 * L, 12, -6 * L], [6 * L, (2 - k) * L**2, -6 * L, (4 + k) * L**2]])
        mass = rho * A * L / 420 * np.array(
            [[156, 22 * L, 54, -13 * L], [22 * L, 4 * L**2, 13 * L, -3 * L**2],
             [54, 13 * L, 156, -22 * L], [-13 * L, -3 * L**2, -22 * L, 4 * L**2]])
        rotary = rho * second / (30 * L) * np.array(
            [[36, 3 * L, -36, 3 * L], [3 * L, 4 * L**2, -3 * L, -(L**2)],
             [-36, -3 * L, 36, -3 * L], [3 * L, -(L**2), -3 * L, 4 * L**2]])
        K[np.ix_(index, index)] += turn @ stiffness @ turn
        M[np.ix_(index, index)] += turn @ (mass + rotary) @ turn
    for u, stiffness, mass in ((2, E * A, rho * A), (5, G * s.torsion, rho * s.polar)):
        K[np.ix_([u, u + 6], [u, u + 6])] = stiffness / L * np.array([[1, -1], [-1, 1]])
        M[np.ix_([u, u + 6], [u, u + 6])] = mass * L / 6 * np.array([[2, 1], [1, 2]])
    return K, M


@pytest.mark.parametrize("fem", [1, 3])
def test_an_inclined_beam_has_the_matrices_of_the_manual(tmp_path, fem, validation):
    row = validation(what="inclined arbitrary beam with spin, Euler-Bernoulli and Timoshenko",
                     reference="the manual's matrices written out", why="rounding, of the largest entry")
    values = "2.1e11 8.1e10 7850 0.3 0.15 0.1 0.02 0.03 0.06 0.04"
    path = written(tmp_path, ["1 2 3", "3 5 9"], ["1 2 4 4 4 30"], [CLAMPED], fem=fem, arbitrary=[f"4 {values}"])
    file = read_subdyn(path)
    (element,) = build_subdyn_frame(file).elements
    from probupdate.structure.subdyn_frame import any_section

    K, M = manual_beam(any_section(*map(float, values.split())), 7.0, fem == 3)
    turn = np.kron(np.eye(4), direction_cosines(np.array([1.0, 2, 3]), np.array([3.0, 5, 9]), 30.0))
    stiffness, mass = plain_matrices(file, element)
    row.error((stiffness - turn @ K @ turn.T) / np.abs(K).max(), below=1e-11, of="K")
    row.error((mass - turn @ M @ turn.T) / np.abs(M).max(), below=1e-12, of="M")


def test_sections_against_their_formulas():
    solid = tube(2.1e11, 8.1e10, 7850, 0.5, 0.0)
    assert solid.area == pytest.approx(np.pi * 0.0625) and solid.torsion == pytest.approx(np.pi * 0.5**4 / 32)
    thin = tube(2.1e11, 2.1e11 / 2.6, 7850, 1.0, 1e-6)
    # Steinboeck's limit for a thin tube, whatever nu: half of the area; Cowper's is 0.53
    assert thin.kappa_x == pytest.approx(0.5, rel=1e-5)
    square = box_section(2.1e11, 8.1e10, 7850, 0.4, 0.4, 0.01)
    assert square.i_xx == pytest.approx((0.4**4 - 0.38**4) / 12) and square.i_xx == pytest.approx(square.i_yy)
    assert square.torsion == pytest.approx(0.39**3 * 0.01)
    assert box_section(2.1e11, 8.1e10, 7850, 0.2, 0.2, 0.0).torsion == pytest.approx(0.1406 * 0.2**4, rel=2e-3)


def test_a_clamped_tower_with_a_tip_mass_has_its_textbook_frequencies(tmp_path, validation):
    row = validation(what="tower with tip mass", reference="frequency equation, rotary inertia by Rayleigh",
                     why="Rayleigh's shape")
    # L 72, tube 6 x 0.04, tip 378 t: 0.545181 and 5.466367 Hz without rotary inertia (1 + cosh b cos b + ... = 0); its
    # kinetic energy is that of 1.2 m (r / L)^2 = 0.435 t beside 478 t (Rayleigh, static shape): 4.55e-4 of f_1
    path = written(tmp_path, ["0 0 0", "0 0 72"], ["1 2 1 1 1c 0"], [CLAMPED], div=12,
                   circular=[f"1 {STEEL} 6.0 0.04"], mass=["2 378000 0 0 0"])
    found = frequencies(path, 4)
    row.error(found[0] / (0.545181 * (1 - 4.55e-4)) - 1, below=2e-5)
    assert 0.98 * 5.466367 < found[2] < 5.466367


def test_a_tapered_member_takes_sizes_averaged_between_the_ends_of_each_element(tmp_path):
    tapered = written(tmp_path, ["0 0 0", "0 0 30"], ["1 2 1 2 1c 0"], [CLAMPED], div=3,
                      circular=[f"1 {STEEL} 3.0 0.06", f"2 {STEEL} 1.5 0.03"])
    whole = frequencies(tapered)
    middles = [3.0 - 1.5 * k for k in (1 / 6, 0.5, 5 / 6)]
    steps = written(tmp_path, ["0 0 0", "0 0 10", "0 0 20", "0 0 30"],
                    [f"{k} {k + 1} {k} {k} 1c 0" for k in (1, 2, 3)], [CLAMPED],
                    circular=[f"{k} {STEEL} {d} {d / 50}" for k, d in enumerate(middles, 1)])
    np.testing.assert_allclose(frequencies(steps), whole, rtol=1e-9)


def test_a_rigid_link_carries_an_offset_mass_as_its_inertia_says(tmp_path, validation):
    row = validation(what="rigid link with an offset mass", reference="the same mass with the sum of offsets",
                     why="eigensolver")
    beam = [f"1 {STEEL} 2.0 0.03"]
    linked = written(tmp_path, ["0 0 0", "0 0 20", "1 2 23"], ["1 2 1 1 1c 0", "2 3 9 9 3 0"], [CLAMPED], div=4,
                     circular=beam, rigid=["9 0.0"], mass=["3 5e4 1e5 2e5 3e5 1e3 2e3 3e3 0.1 0.2 0.3"])
    first = frequencies(linked)
    offset = written(tmp_path, ["0 0 0", "0 0 20"], ["1 2 1 1 1c 0"], [CLAMPED], div=4, circular=beam,
                     mass=["2 5e4 1e5 2e5 3e5 1e3 2e3 3e3 1.1 2.2 3.3"])
    row.error(frequencies(offset) / first - 1, below=1e-8)


def test_the_mass_matrix_of_an_offset_body_is_that_of_its_particles(validation):
    row = validation(what="mass matrix of an offset body", reference="sum over 20 particles", why="rounding")
    # a body of particles: its 6x6 matrix at the joint is the sum of theirs
    rng = np.random.default_rng(1)
    place, mass = rng.normal(size=(20, 3)), rng.uniform(1, 2, 20)
    expected = np.zeros((6, 6))
    for p, m in zip(place, mass, strict=True):
        motion = np.hstack([np.eye(3), [[0, p[2], -p[1]], [-p[2], 0, p[0]], [p[1], -p[0], 0]]])
        expected += m * motion.T @ motion
    centre = mass @ place / mass.sum()
    d = place - centre
    inertia = np.einsum("i,ijk->jk", mass, (d**2).sum(1)[:, None, None] * np.eye(3) - d[:, :, None] * d[:, None, :])
    j = [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]
    found = rigid_body_mass([mass.sum(), *j, *centre])
    row.error((found - expected) / (1 + np.abs(expected)), below=1e-10)


# pinned-pinned Euler-Bernoulli beam: f = pi / 2 sqrt(EI / (m L^4)); guided by ball joints at both ends
@pytest.mark.parametrize("kind", ["4", "3 0 1 0", "2"])
def test_joints_let_members_turn(tmp_path, kind, validation):
    row = validation(what="ball, revolute, universal joints", reference="simply supported and clamped beam",
                     why="eight elements, stubs")
    joint = {"4": "4 0 0 0 0", "3 0 1 0": "3 0 1 0 0", "2": "2 0 0 0 0"}[kind]
    # two ball joints would let the beam spin
    top = joint.replace("4 0", "2 0", 1)
    # two clamped stubs, a beam between them that turns at both joints: bending in the x-z plane as if simply supported
    joints = ["0 0 -0.1", f"0 0 0 {joint}", f"0 0 10 {top}", "0 0 10.1"]
    members = ["1 2 2 2 1c 0", "2 3 1 1 1c 0", "3 4 2 2 1c 0"]
    path = written(tmp_path, joints, members, [CLAMPED, CLAMPED.replace("1", "4", 1)], div=8,
                   circular=[f"1 {STEEL} 0.1 0.005", f"2 {STEEL} 0.5 0.1"])
    section = tube(2.1e11, 8.076923e10, 7850, 0.1, 0.005)
    simple = np.pi / 2 * np.sqrt(2.1e11 * section.i_xx / (7850 * section.area * 1e4))
    found = frequencies(path, 6)
    row.error(np.min(np.abs(found / simple - 1)), below=1e-3, of="simply supported")
    if kind == "3 0 1 0":
        # about x the revolute joint holds: clamped-clamped, 22.3733 / pi^2 times as high
        row.error(np.min(np.abs(found / (simple * 22.3733 / np.pi**2) - 1)), below=2e-3, of="clamped")
    if kind == "2":
        # the twist goes through a universal joint: no mode of free spinning
        row.error(found[0] / simple - 1, below=1e-3, of="simply supported")


def test_a_stiff_spring_in_a_joint_makes_it_rigid(tmp_path):
    joints, members = ["0 0 0", "0 0 5 {}", "0 0 10"], ["1 2 1 1 1c 0", "2 3 1 1 1c 0"]
    rigid = frequencies(written(tmp_path, [j.format("1 0 0 0 0") for j in joints], members, [CLAMPED],
                                circular=[f"1 {STEEL} 0.5 0.01"]))
    for kind in ("4 0 0 0 1e14", "3 1 0 0 1e14", "2 0 0 0 1e14"):
        sprung = written(tmp_path, [j.format(kind) for j in joints], members, [CLAMPED],
                         circular=[f"1 {STEEL} 0.5 0.01"])
        np.testing.assert_allclose(frequencies(sprung), rigid, rtol=1e-5)


def test_springs_cables_and_soil_are_where_they_are_said_to_be(tmp_path):
    # a rigid mass on a spring element: sqrt(k / m)
    stiffness = [4e6 if i == j else 0.0 for i in range(6) for j in range(i, 6)]
    path = written(tmp_path, ["0 0 0", "0 0 0"], ["1 2 3 3 5 -1"], [CLAMPED], mass=["2 1e3 1e3 1e3 1e3"],
                   spring=["3 " + " ".join(map(str, stiffness))])
    np.testing.assert_allclose(frequencies(path, 4), np.sqrt(4e3) / (2 * np.pi), rtol=1e-9)
    # the same stiffness as soil
    (tmp_path / "soil.txt").write_text("\n".join(f"4e6 K{a}{a}" for a in ("x", "y", "z", "tx", "ty", "tz")))
    path = written(tmp_path, ["0 0 0", "0 0 1"], ["1 2 9 9 3 0"], ["1 0 0 0 0 0 0 soil.txt"], rigid=["9 0.0"],
                   mass=["1 1e3 1e3 1e3 1e3"])
    np.testing.assert_allclose(frequencies(path, 4), np.sqrt(4e3) / (2 * np.pi), rtol=1e-9)
    # a cable holds the top of a pendulum column: its axial stiffness EA / L0 with L0 = L / (1 + T0 / EA)
    path = written(tmp_path, ["0 0 0", "0 0 1", "10 0 1"], ["1 2 1 1 1c 0", "2 3 5 5 2 -1"],
                   [CLAMPED, CLAMPED.replace("1", "3", 1)], circular=["1 2.1e5 8e4 1e-3 0.1 0.01"],
                   cable=["5 1e6 1e-9 1e5 0"], mass=["2 1e3 1e-6 1e-6 1e-6"])
    assert np.min(np.abs(frequencies(path, 4) / (np.sqrt(1e6 / (10 / 1.1) / 1e3) / (2 * np.pi)) - 1)) < 1e-3


def test_the_sparse_modes_are_those_of_the_dense_matrices(tmp_path, validation):
    row = validation(what="constraints eliminated, Lanczos", reference="stiff penalty, LAPACK", why="penalty")
    # second route: the same matrices unreduced, constraints by a stiff penalty, all modes by LAPACK
    path = written(tmp_path, ["0 0 0", "4 0 0", "2 1 9", "2 1 10"],
                   ["1 3 1 1 1c 0", "2 3 1 1 1c 0", "3 4 9 9 3 0"], [CLAMPED, CLAMPED.replace("1", "2", 1)], div=2,
                   circular=[f"1 {STEEL} 0.5 0.01"], rigid=["9 20.0"], mass=["4 500 10 20 30"])
    frame = build_subdyn_frame(read_subdyn(path))
    n = frame.n_full
    K, M = np.zeros((n, n)), np.zeros((n, n))
    for dofs, element in zip(frame.dofs, frame.elements, strict=True):
        stiffness, mass = plain_matrices(frame.file, element)
        K[np.ix_(dofs, dofs)] += stiffness
        M[np.ix_(dofs, dofs)] += mass
    dofs = frame.node_dofs(3)
    M[np.ix_(dofs, dofs)] += rigid_body_mass(frame.file.masses[0].values)
    motion = np.eye(6)
    motion[0, 4], motion[1, 3] = 1.0, -1.0
    tie = np.zeros((6, n))
    tie[:, dofs], tie[:, frame.node_dofs(2)] = np.eye(6), -motion
    K += 1e15 * tie.T @ tie
    free = [d for d in range(n) if d not in {*frame.node_dofs(0), *frame.node_dofs(1)}]
    value = eigh(K[np.ix_(free, free)], M[np.ix_(free, free)], eigvals_only=True)[:6]
    row.error(frequencies(path) / (np.sqrt(value) / (2 * np.pi)) - 1, below=1e-5)


# SubDyn's own Full_frequencies of two cases of OpenFAST's r-test, as their SD.sum.yaml prints them (seven digits)


def test_subdyns_own_frequencies_of_the_oc3_monopile(tmp_path, validation):
    # 5MW_OC3Mnpl_Linear: Timoshenko, three members in three elements each, clamped
    row = validation(what="SubDyn's Full_frequencies: OC3 monopile (Timoshenko, NDiv 3)",
                     reference="r-test, 5MW_OC3Mnpl_Linear", why="seven printed digits")
    path = written(tmp_path, ["0 0 -20.0001", "0 0 -10", "0 0 0", "0 0 10"],
                   ["1 2 1 1 1c 0", "2 3 1 1 1c 0", "3 4 1 1 1c 0"], [CLAMPED], div=3, fem=3, interface=[4],
                   circular=["1 2.1e11 8.08e10 8500 6.0 0.06"])
    own = [6.072686, 6.072686, 25.72555, 28.32034, 28.32034, 41.47330, 58.59113, 58.59113, 77.96200, 83.40462]
    row.error(frequencies(path, 10) / own - 1, below=2e-7)


def test_subdyns_own_frequencies_with_a_rigid_link(tmp_path, validation):
    # SD_Rigid: a rigid link beside the middle one of three beams
    row = validation(what="SubDyn's Full_frequencies: a rigid link beside a beam", reference="r-test, SD_Rigid",
                     why="seven printed digits")
    path = written(tmp_path, ["0 0 0", "0 0 10", "0 0 20", "0 0 30"],
                   ["1 2 1 1 1c 0", "2 3 1 1 1c 0", "3 4 1 1 1c 0", "2 3 1 1 3 0"], [CLAMPED], fem=3, interface=[4],
                   circular=["1 2.1e11 8.0769e10 7850 1.0 0.05"], rigid=["1 0.0"])
    own = [1.187525, 1.187525, 11.10164, 11.10164, 21.96484, 21.96484, 32.60645, 52.57639, 106.5510, 106.5510]
    row.error(frequencies(path, 10) / own - 1, below=5e-7)


def test_subdyns_own_frequencies_of_a_free_pendulum_with_a_sprung_revolute_joint(tmp_path, validation):
    # SD_PendulumDamp: Timoshenko, nothing held, so dense; six rigid motions come before
    row = validation(what="SubDyn's Full_frequencies: free pendulum with sprung revolute joint",
                     reference="r-test, SD_PendulumDamp", why="seven printed digits")
    path = written(tmp_path, ["0 0 0", "0 0 -1 3 0 1 0 100", "0 0 -6"], ["1 2 1 1 1c 0", "2 3 1 1 1c 0"], [], fem=3,
                   interface=[1], circular=["1 2.1e11 8.0769e10 7850 0.2 0.02"])
    model = load_model(path)
    K, M = (matrix.toarray() for matrix in model.matrices(np.zeros(0)))
    value = eigh(K, M, eigvals_only=True)
    own = [0.3810060, 35.30662, 51.01476, 117.7512, 170.4280, 285.4026, 380.1668, 460.1985, 1001.558, 1095.818,
           1766.957]
    row.error(np.sqrt(value[6:17]) / (2 * np.pi * np.array(own)) - 1, below=2e-6)
    assert np.abs(value[:6]).max() < 1e-9 * value[-1]
    found = frequencies(path, 12)
    assert found[:6].tolist() == [0.0] * 6
    row.error(found[6:] / own[:6] - 1, below=2e-6)


def test_mechanisms_and_wrong_geometry_are_refused_with_the_line(tmp_path):
    cases = {
        "no length": (["0 0 0", "0 0 0"], ["1 2 1 1 1c 0"], {}),
        "m long": (["0 0 0", "0 0 1"], ["1 2 3 3 5 -1"], {"spring": ["3 " + "1 " * 21]}),
        "universal joint 2 has 3": (["0 0 0", "0 0 1 2 0 0 0 0", "0 0 2", "1 0 2"],
                                    ["1 2 1 1 1c 0", "2 3 1 1 1c 0", "2 4 1 1 1c 0"], {}),
    }
    for words, (joints, members, sets) in cases.items():
        path = written(tmp_path, joints, members, [CLAMPED], **({"circular": [f"1 {STEEL} 0.5 0.01"]} | sets))
        with pytest.raises(InputError, match=words) as error:
            probupdate.model_modes(path, 2)
        assert "structure.dat, line" in str(error.value)
    loose = written(tmp_path, ["0 0 0", "0 0 9"], ["1 2 1 1 1c 0"], [], circular=[f"1 {STEEL} 0.5 0.01"])
    found = probupdate.model_modes(loose, 8)
    assert found.frequency_hz[:6].tolist() == [0.0] * 6 and found.frequency_hz[6] > 1
    assert any("6 of these are motions that nothing holds" in note for note in found.notes)
    with pytest.raises(InputError, match="mechanism"):
        load_model(loose).solve(np.zeros(0), 2)


# parameters --------------------------------------------------------------------------------------------------------

TOML = f"""
name = "a frame"
[subdyn]
file = "structure.dat"
nacelle = [4]
{FRAME_GROUPS}"""
PARAMETERS = {
    "stiffness": ("legs", "-", 1.1), "density": ("brace", "-", 1.2), "thickness": ("legs", "-", 0.9),
    "wall_loss": ("brace", "m", 0.002), "line_mass": ("legs", "kg/m", 30.0), "mass": ("top", "-", 1.3),
    "added_mass": ("deck", "kg", 2e3), "soil_lateral": ("soil", "-", 0.5), "soil_vertical": ("soil", "-", 2.0),
}


@pytest.fixture
def framed(tmp_path):
    (tmp_path / "soil.txt").write_text("1e8 Kxx\n1e8 Kyy\n2e8 Kzz\n1e9 Ktxtx\n1e9 Ktyty\n1e8 Ktztz\n-1e7 Kxty\n")
    written(tmp_path, ["0 0 0", "4 0 0", "4 0 8", "0 0 8"],
            ["1 4 1 1 1c 0", "2 3 1 1 1c 0", "1 3 2 2 1c 0", "4 3 2 2 1c 0"],
            ["1 0 0 0 0 0 0 soil.txt", "2 1 1 1 1 1 1"], div=2, fem=3,
            circular=[f"1 {STEEL} 0.5 0.02", f"2 {STEEL} 0.3 0.01"], mass=["4 2e3 1e3 9e3 1e3 0 0 0 0.4 0 0"])
    text = TOML
    for acts, (group, unit, value) in PARAMETERS.items():
        text += f'[[parameter]]\nname = "p_{acts}"\nacts = "{acts}"\non = "{group}"\nunit = "{unit}"\n'
        text += f"initial = {value}\nstd = {0.1 * value}\nlower = {0.2 * value}\nupper = {5 * value}\n"
    path = tmp_path / "model.toml"
    path.write_text(text + FRAME_SENSORS)
    return path


def edited(framed):
    """The same values put into the file itself."""
    folder = framed.parent / "edited"
    folder.mkdir(exist_ok=True)
    (folder / "soil.txt").write_text("0.5e8 Kxx\n0.5e8 Kyy\n4e8 Kzz\n5e8 Ktxtx\n5e8 Ktyty\n1e8 Ktztz\n-5e6 Kxty\n")
    leg = "2.31e11 8.8846153e10"
    area, lost = tube(1, 1, 1, 0.5, 0.018).area, tube(1, 1, 1, 0.3 - 0.004, 0.008).area
    plain = tube(2.1e11, 8.076923e10, 7850, 0.3, 0.01)
    # line mass as density would carry rotary inertia too: the legs get it as cables beside them, which have none
    assert area > 0 and lost > 0 and plain.area > 0
    written(folder, ["0 0 0", "4 0 0", "4 0 8", "0 0 8"],
            ["1 4 1 1 1c 0", "2 3 1 1 1c 0", "1 3 3 3 1c 0", "4 3 2 2 1c 0"],
            ["1 0 0 0 0 0 0 soil.txt", "2 1 1 1 1 1 1"], div=2, fem=3,
            circular=[f"1 {leg} 7850 0.5 0.018", f"2 {STEEL} 0.3 0.01", "3 2.1e11 8.076923e10 9420 0.296 0.008"],
            mass=["4 2.6e3 1.3e3 11.7e3 1.3e3 0 0 0 0.4 0 0", "3 2e3 0 0 0"])
    return folder / "structure.dat"


def test_parameters_give_what_the_edited_file_gives(framed, validation):
    row = validation(what="nine parameters at once", reference="the same values edited into the file",
                     why="the file's digits")
    model = load_model(framed)
    theta = np.array(model.parameters.initial)
    # the file cannot say a line mass without rotary inertia
    theta[model.parameters.names.index("p_line_mass")] = 0.0
    row.error(model.solve(theta, 6).frequency_hz / frequencies(edited(framed)) - 1, below=1e-7)
    heavier = model.solve(model.parameters.initial, 6).frequency_hz
    assert np.all(heavier < model.solve(theta, 6).frequency_hz)


def test_derivatives_are_those_of_differences(framed, validation):
    row = validation(what="derivatives by each parameter", reference="central differences", why="step")
    model = load_model(framed)
    theta = np.array(model.parameters.initial)
    exact = model.solve(theta, 5, derivatives=True).frequency_derivative
    for k in range(theta.size):
        step = 1e-5 * theta[k] * np.eye(theta.size)[k]
        slope = (model.solve(theta + step, 5).frequency_hz - model.solve(theta - step, 5).frequency_hz) / (2 * step[k])
        # beside its own a tenth of the largest
        row.error((exact[:, k] - slope) / (np.abs(slope) + 0.1 * np.abs(exact[:, k]).max()), below=2e-5)
    many = model.solve_many(np.array([theta, 1.1 * theta]), 5).frequency_hz
    np.testing.assert_allclose(many[0], model.solve(theta, 5).frequency_hz, rtol=1e-12)


def test_sensors_follow_their_joint_or_the_nearest_beam(framed):
    own = load_model(framed).solve(load_model(framed).parameters.initial, 4).shape
    placed = (Sensor(channel="A", level="top", position_m=[0, 0, 8], direction=[1, 0, 0]),
              Sensor(channel="new", level="half", position_m=[0.25, 0, 4], direction=[0, 1, 0]))
    model = load_model(framed, sensors=placed)
    assert model.channels == ("A", "new")
    shape = model.solve(model.parameters.initial, 4).shape
    np.testing.assert_allclose(shape[0], own[0], atol=1e-12)
    far = (Sensor(channel="far", level="", position_m=[50, 0, 4], direction=[0, 1, 0]),)
    with pytest.raises(InputError, match="far"):
        load_model(framed, sensors=far)


def test_the_nacelle_turns_where_it_is_named(framed):
    model = load_model(framed)
    straight, turned = (load_model(framed, nacelle_angle_deg=a).solve(model.parameters.initial, 4) for a in (0, 90))
    assert np.abs(turned.frequency_hz / straight.frequency_hz - 1).max() > 1e-4
    back = load_model(framed, nacelle_angle_deg=360.0).solve(model.parameters.initial, 4)
    np.testing.assert_allclose(back.frequency_hz, straight.frequency_hz, rtol=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "answer"),
    [
        ('on = "legs"', 'on = "leg"', ["there is no [group.leg]", "did you mean 'legs'"]),
        ('acts = "stiffness"', 'acts = "stifness"', ["'stifness' is unknown", "did you mean 'stiffness'"]),
        ('acts = "mass"\non = "top"', 'acts = "mass"\non = "legs"', ["one of members", "acts on masses"]),
        ('unit = "m"', 'unit = "mm"', ["unit", "in m"]),
        ("members = [3]", "members = [33]", ["group.brace", "33"]),
        ("members = [3]", "", ["group.brace", "names nothing"]),
        ("reactions = [1]", "reactions = [2]", ["no effect"]),
        ('file = "structure.dat"', 'file = "../structure.dat"', ["leaves the folder"]),
        ("lower = 0.22000000000000003", "lower = -1.0", ["lower bound", "above 0"]),
        ("nacelle = [4]", "nacelle = [2]", ["no concentrated mass at joint 2"]),
        ('joint = 3', 'joint = 30', ["joint 30"]),
        ('name = "a frame"', 'nam = "a frame"', ["nam"]),
    ],
)
def test_mistakes_in_the_toml_are_named(framed, old, new, answer):
    text = framed.read_text()
    assert old in text
    framed.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as error:
        load_model(framed)
    assert "model.toml" in str(error.value)
    for words in answer:
        assert words in str(error.value)


def test_a_tower_from_tables_is_the_textbooks_and_has_its_groups(tmp_path, validation):
    row = validation(what="tower from tables with a tip mass",
                     reference="frequency equation, rotary inertia by Rayleigh", why="Rayleigh's shape")
    written(tmp_path, ["0 0 0", "0 0 10"], ["1 2 9 9 3 0"], [CLAMPED.replace("1", "1", 1)], rigid=["9 0.0"])
    section = tube(2.1e11, 8.076923e10, 7850, 6.0, 0.04)
    columns = {"mass_kgpm": 7850 * section.area, "stiffness_fa_nm2": 2.1e11 * section.i_xx,
               "stiffness_ss_nm2": 2.1e11 * section.i_xx}
    text = 'name = "tower"\n[subdyn]\nfile = "structure.dat"\n[tower]\njoint = 2\ntop_m = 82.0\nelements = 12\n'
    text += "fraction = [0.0, 1.0]\n" + "".join(f"{k} = [{v}, {v}]\n" for k, v in columns.items())
    text += "youngs_modulus_pa = 2.1e11\nshear_modulus_pa = 8.076923e10\ndensity_kgpm3 = 7850.0\n"
    body = ("[rotor_nacelle]\nmass_kg = 378000.0\ncentre_m = [0.0, 0.0, 0.0]\n"
            "inertia_kgm2 = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]\n")
    parameters = "".join(
        f'[[parameter]]\nname = "{n}"\nacts = "{a}"\non = "{on}"\nunit = "-"\ninitial = 1.0\ncov = 0.1\nlower = 0.5\n'
        for n, a, on in (("k_t", "stiffness", "tower"), ("m_h", "mass", "rotor_nacelle")))
    path = tmp_path / "tower.toml"
    path.write_text(text + body + parameters)
    model = load_model(path)
    first = model.solve(np.ones(2), 2, derivatives=True, clusters=((0, 1),))
    row.error(first.frequency_hz[0] / (0.545181 * (1 - 4.55e-4)) - 1, below=2e-5)
    # the sum rule: all stiffness is the tower's
    np.testing.assert_allclose(first.frequency_derivative[:, 0] / first.frequency_hz, 0.5, rtol=1e-9)
    for old, new, answer in (("joint = 2", "joint = 7", "joint 7"),
                             ("top_m = 82.0", "top_m = 5.0", "not above the foot"),
                             ("fraction = [0.0, 1.0]", "fraction = [0.0, 0.9]", "does not rise"),
                             ("fraction = [0.0, 1.0]\n", "", "has neither elastodyn")):
        path.write_text((text + body).replace(old, new))
        with pytest.raises(InputError, match=answer):
            load_model(path)
    path.write_text(text)
    with pytest.raises(InputError, match="rotor_nacelle"):
        load_model(path)


# the verb ------------------------------------------------------------------------------------------------------------


def test_modes_prints_one_json_object_for_every_form_of_model(framed, capsys):
    for path in (framed, framed.with_name("structure.dat")):
        assert main(["modes", str(path), "--count", "4", "--json"]) == 0
        answer = json.loads(capsys.readouterr().out)
        assert len(answer["frequency_hz"]) == len(answer["label"]) == 4
        assert np.shape(answer["shape"]) == (len(answer["channel"]), 4)
        assert np.abs(answer["shape"]).max() == 1.0
    assert main(["modes", "as_built", "--count", "5"]) == 0
    assert "FA1" in capsys.readouterr().out
    np.savez(framed.with_name("matrices.npz"), K0=np.diag([1.0, 4.0, 9.0, 16.0]), M0=np.eye(4),
             K_a=np.diag([1.0, 0, 0, 0]), channel=np.array(["x"]), channel_dof=np.array([0]))
    framed.with_name("parameters.toml").write_text('[[parameter]]\nname = "a"\ninitial = 0.5\nstd = 0.1\n')
    assert main(["modes", str(framed.with_name("matrices.npz")), "--count", "2", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["frequency_hz"] == pytest.approx(np.sqrt([1.5, 4.0]) / (2 * np.pi)) and answer["label"][0] == "mode 1"
    one = Parameters((Parameter(name="k", unit="-", initial=2.0, std=0.1),))
    called = probupdate.model_modes(lambda theta: (np.array([theta[0], 3.0]), np.eye(2)), 2, parameters=one)
    assert called.frequency_hz.tolist() == [2.0, 3.0]


def test_torsion_of_a_single_pile_moves_none_of_its_joints(tmp_path):
    path = written(tmp_path, ["0 0 0", "0 0 10", "0 0 20"], ["1 2 1 1 1c 0", "2 3 1 1 1c 0"], [CLAMPED], interface=[3],
                   div=4, circular=[f"1 {STEEL} 3.0 0.05"])
    found = probupdate.model_modes(path, 8)
    seen = np.abs(found.shape).max(axis=0)
    (twist,) = np.flatnonzero(seen == 0)
    # a quarter of a wave: sqrt(G / rho) / 4 L
    assert found.frequency_hz[twist] == pytest.approx(np.sqrt(8.076923e10 / 7850) / 80, rel=2e-3)
    assert found.labels[twist] == "T1"
    assert any("T1" in note and "moves none of the sensors" in note for note in found.notes)


def test_modes_refuses_what_is_no_model_in_one_line(tmp_path, capsys):
    for name, text in (("none.dat", None), ("empty.dat", ""), ("table.csv", "1,2\n")):
        if text is not None:
            (tmp_path / name).write_text(text)
        assert main(["modes", str(tmp_path / name), "--json"]) == 2
        captured = capsys.readouterr()
        assert captured.out == "" and name in captured.err and captured.err.count("\n") == 1


def test_an_input_of_another_module_is_named(tmp_path):
    (tmp_path / "water.dat").write_text("------- HydroDyn Input File -----\na jacket\nFalse Echo\n")
    with pytest.raises(InputError, match="HydroDyn, not of SubDyn; give the file that SubFile names"):
        probupdate.model_modes(tmp_path / "water.dat")


@pytest.mark.parametrize(("verb", "problem"), [("update", "no parameters to update"),
                                               ("diagnose", "no parameters, so that")])
def test_a_model_without_parameters_is_not_updated(framed, tmp_path, capsys, verb, problem):
    modes = tmp_path / "modes.json"
    modes.write_text(json.dumps({"channels": ["J4x", "J4y"], "sets": [{
        "id": "a", "frequency_hz": [5.0], "damping_ratio": [0.01], "frequency_std_hz": [0.1],
        "shape_re": [[1.0, 0.0]], "shape_std": [[0.1, 0.1]]}]}))
    assert main([verb, "--model", str(framed.with_name("structure.dat")), "--modes", str(modes), "--out",
                 str(tmp_path / f"{verb}.json")]) == 2
    assert problem in capsys.readouterr().err


@pytest.mark.skipif(not OC4.exists(), reason="the OC4 input files of ../shared/reference/oc4 are not here")
@pytest.mark.parametrize(
    ("name", "expected"),
    [
        # this project's own values, kept so that a change shows; SubDyn's own are compared outside this repository
        ("OC4_Jacket_SD_Input", [2.755477, 2.755477, 5.004339, 5.413331]),
        ("jk_fix_eb", [2.767504, 2.767504, 5.093112, 5.494798]),
        ("jk_soil_eb", [1.897125, 1.899148, 3.364368, 4.500388]),
        ("owt_fix_eb", [0.3178276, 0.3199424, 1.142163, 1.170266]),
        ("owt_soil_eb", [0.3004183, 0.3021138, 0.9462863, 0.9648232]),
    ],
)
def test_the_oc4_models_have_their_frequencies(name, expected):
    np.testing.assert_allclose(frequencies(OC4 / f"{name}.dat", 4), expected, rtol=5e-7)


def test_commands_say_what_of_a_foreign_file_has_no_effect(framed, tmp_path, capsys):
    """Once a run, on standard error; `modes` has it among its results."""
    file = framed.with_name("structure.dat")
    file.write_text(file.read_text().replace("2 1 1 1 1 1 1\n", "2 1 1 1 1 1 1 soil.txt\n"))
    found = probupdate.model_modes(framed, 3)
    assert sum("soil" in note and "no effect" in note for note in found.notes) == 1
    sets = [{"id": "a", "frequency_hz": found.frequency_hz.tolist(), "damping_ratio": [0.01] * 3,
             "frequency_std_hz": (0.01 * found.frequency_hz).tolist(), "shape_re": found.shape.T.tolist(),
             "shape_std": [[0.01] * len(found.channels)] * 3}]
    (tmp_path / "modes.json").write_text(json.dumps({"channels": list(found.channels), "gravity": False, "sets": sets}))
    given = ["--model", str(framed), "--modes", str(tmp_path / "modes.json")]
    assert main(["inform", *given, "--json", "--out", str(tmp_path / "information.json")]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out) and said.err.count("no effect") == said.err.count("note: ") == 1
    assert main(["modes", str(framed), "--count", "3"]) == 0
    assert capsys.readouterr().err == ""
