"""Every kind of SubDyn element against closed forms, a released summary, and an assembly written out here."""

import numpy as np
import pytest
from scipy.linalg import eigh

import probupdate
from probupdate.errors import InputError
from tests.subdyn_text import subdyn

CLAMPED = "1 1 1 1 1 1 1"
STEEL = (2.1e11, 8.076923e10, 7850.0)
PENALTY = 1e17


def modes_of(folder, text, count):
    (folder / "structure.dat").write_text(text)
    return probupdate.model_modes(folder / "structure.dat", count)


# cables -------------------------------------------------------------------------------------------------------------


def test_the_released_summary_of_five_joints_and_two_cables(tmp_path, validation):
    # SD_Cable_5Joints: Full_frequencies of its SD.sum.yaml (2022), seven digits; the first is the free twist
    row = validation(what="SubDyn's Full_frequencies: two pretensioned cables work against each other",
                     reference="r-test, SD_Cable_5Joints", why="seven printed digits")
    found = modes_of(tmp_path, subdyn(
        ["-10.1 0 0", "-0.1 0 0", "0 0 0", "0.1 0 0", "10.1 0 0"],
        ["1 2 12 12 2 -1", "2 3 1 1 1 -1", "3 4 1 1 1 -1", "4 5 43 43 2 -1"], [CLAMPED, "5 1 1 1 1 1 1"],
        interface=[3], fem=3, circular=["1 2.1e11 8.0769e10 7850 5 1.75"],
        cable=["12 210e7 7850 1e7 0", "43 420e7 7850 1e7 0"]), 11)
    own = [0.1022544, 0.1022545, 0.7668034, 0.7668034, 14.12838, 298.8378, 298.8378, 732.5690, 732.5690, 5559.708]
    assert found.frequency_hz[0] == 0 and any("1 of these are motions" in note for note in found.notes)
    row.error(found.frequency_hz[1:] / own - 1, below=1e-6)


def test_the_released_summary_of_a_spar_that_nothing_holds(tmp_path, validation):
    """Twenty elements of a solid rod along a stated cosine matrix, between six free motions."""
    row = validation(what="SubDyn's Full_frequencies: a floating rod of 150 m along a cosine matrix",
                     reference="r-test, SD_SparHanging", why="seven printed digits")
    found = modes_of(tmp_path, subdyn(["0 0 75", "0 0 0", "0 0 -75"], ["1 2 1 1 1 10", "2 3 1 1 1 10"], [],
                                      interface=[1], fem=3, div=10, circular=["1 2.1e11 8e10 7850 2.4164 1.2082"],
                                      cosine=["10 1 0 0 0 -1 0 0 0 -1"], mass=["1 0 0 0 0 0 0 0 0 0 0"]), 20)
    own = [0.4941340, 0.4941340, 1.360329, 1.360329, 2.661805, 2.661805, 4.389474, 4.389474, 6.538158, 6.538158,
           9.101742, 9.101742, 10.65210, 12.07396]
    assert not found.frequency_hz[:6].any()
    row.error(found.frequency_hz[6:] / own - 1, below=2e-7)


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (1.0, 2.0, 2.0)])
def test_a_chain_of_cables_has_the_frequencies_of_a_taut_string(tmp_path, direction, validation):
    row = validation(what="forty pretensioned cable elements in a line: first four pairs",
                     reference="taut string, n / 2L sqrt(T / m)", why="length of an element over the wave's, squared")
    n, length, tension, density = 40, 80.0, 2.0e5, 30.0
    along = np.array(direction) / np.linalg.norm(direction) * length / n
    joints = [" ".join(map(str, k * along)) for k in range(n + 1)]
    # cables turn freely: of which kind the joints are does not matter
    joints[1:-1:2] = [f"{joint} 4 0 0 0 0" for joint in joints[1:-1:2]]
    members = [f"{k} {k + 1} 7 7 2 -1" for k in range(1, n + 1)]
    text = subdyn(joints, members, [CLAMPED, f"{n + 1} 1 1 1 1 1 1"], cable=[f"7 4e8 {density} {tension} 0"])
    # mass per metre is that of the rest length
    stretched = density / (1 + tension / 4e8)
    expected = np.repeat(np.arange(1, 5), 2) / (2 * length) * np.sqrt(tension / stretched)
    found = modes_of(tmp_path, text, 8).frequency_hz
    row.error(found / expected - 1, below=0.01)


@pytest.mark.parametrize(("tension", "expected"), [(5.0e5, 0.1334454), (1.0, 0.0717123), (0.0, 0.0717120)])
def test_two_guys_across_hold_a_column_by_their_tension(tmp_path, tension, expected):
    E, D, t, H, L, m = 2.1e11, 0.5, 0.02, 30.0, 20.0, 1.0e5
    text = subdyn(["0 0 0", f"0 0 {H}", f"0 {-L} {H}", f"0 {L} {H}"], ["1 2 1 1 1 -1", "3 2 1 1 2 -1", "4 2 1 1 2 -1"],
                  [CLAMPED, "3 1 1 1 1 1 1", "4 1 1 1 1 1 1"], div=4, circular=[f"1 {E} 8.1e10 1.0 {D} {t}"],
                  cable=[f"1 1e9 0.001 {tension} 0"], mass=[f"2 {m} 1 1 1 0 0 0 0 0 0"])
    second = np.pi / 64 * (D**4 - (D - 2 * t) ** 4)
    by_hand = np.sqrt((3 * E * second / H**3 + 2 * tension / L) / m) / (2 * np.pi)
    found = modes_of(tmp_path, text, 3).frequency_hz[0]
    # the column's own mass, 900 kg of 100 t, is in the model
    assert found == pytest.approx(by_hand, rel=2e-4) and found == pytest.approx(expected, rel=2e-4)


def test_a_cable_pressed_beyond_its_tangent_buckles_and_is_refused(tmp_path):
    text = subdyn(["0 0 0", "0 0 30", "0 20 30"], ["1 2 1 1 1 -1", "3 2 1 1 2 -1"], [CLAMPED, "3 1 1 1 1 1 1"],
                  circular=["1 2.1e11 8.1e10 1.0 0.5 0.02"], cable=["1 1e9 0.001 -9e6 0"],
                  mass=["2 1e5 1 1 1 0 0 0 0 0 0"])
    with pytest.raises(InputError, match="not positive definite"):
        modes_of(tmp_path, text, 2)


# one structure of every kind, assembled by hand -------------------------------------------------------------------


def turn_of(a, b):
    """Rows: axes of an element from a to b as the manual has them, x level."""
    z = (b - a) / np.linalg.norm(b - a)
    level = np.hypot(z[0], z[1])
    x = np.array([1.0, 0, 0]) if level < 1e-12 else np.array([z[1], -z[0], 0]) / level
    return np.array([x, np.cross(z, x), z])


def tube_matrices(length, diameter, wall):
    """K, M (12, 12) of an Euler-Bernoulli tube along z with rotary inertia, by integrating shape functions."""
    E, G, rho = STEEL
    A = np.pi / 4 * (diameter**2 - (diameter - 2 * wall) ** 2)
    second = np.pi / 64 * (diameter**4 - (diameter - 2 * wall) ** 4)
    K, M = np.zeros((12, 12)), np.zeros((12, 12))
    points, weights = np.polynomial.legendre.leggauss(6)
    for s, w in zip(0.5 * (points + 1), 0.5 * weights * length, strict=True):
        N = np.array([1 - 3 * s**2 + 2 * s**3, length * (s - 2 * s**2 + s**3), 3 * s**2 - 2 * s**3,
                      length * (s**3 - s**2)])
        slope = np.array([-6 * s + 6 * s**2, length * (1 - 4 * s + 3 * s**2), 6 * s - 6 * s**2,
                          length * (3 * s**2 - 2 * s)]) / length
        curve = np.array([-6 + 12 * s, length * (-4 + 6 * s), 6 - 12 * s, length * (6 * s - 2)]) / length**2
        # in x-z the rotation about y is dx/dz, in y-z that about x is -dy/dz
        for dofs, sign in (((0, 4, 6, 10), 1.0), ((1, 3, 7, 9), -1.0)):
            signs = np.array([1, sign, 1, sign])
            at = np.ix_(dofs, dofs)
            K[at] += w * E * second * np.outer(signs * curve, signs * curve)
            M[at] += w * rho * (A * np.outer(signs * N, signs * N) + second * np.outer(signs * slope, signs * slope))
        rod, gradient = np.array([1 - s, s]), np.array([-1, 1]) / length
        for dofs, stiffness, mass in (((2, 8), E * A, rho * A), ((5, 11), G * 2 * second, rho * 2 * second)):
            K[np.ix_(dofs, dofs)] += w * stiffness * np.outer(gradient, gradient)
            M[np.ix_(dofs, dofs)] += w * mass * np.outer(rod, rod)
    return K, M


class ByHand:
    """Six degrees of freedom a node, constraints by penalties."""

    def __init__(self, nodes):
        self.at = np.array(nodes, float)
        self.K, self.M = (np.zeros((6 * len(nodes),) * 2) for _ in "KM")

    def dofs(self, *nodes):
        return np.concatenate([6 * k + np.arange(6) for k in nodes])

    def add(self, nodes, K=0.0, M=0.0, turn=None):
        wide = np.eye(6 * len(nodes)) if turn is None else np.kron(np.eye(2 * len(nodes)), turn)
        at = np.ix_(self.dofs(*nodes), self.dofs(*nodes))
        self.K[at] += wide.T @ (K + np.zeros_like(wide)) @ wide
        self.M[at] += wide.T @ (M + np.zeros_like(wide)) @ wide

    def beam(self, a, b, diameter, wall, pieces=1):
        K, M = tube_matrices(np.linalg.norm(self.at[b] - self.at[a]), diameter, wall)
        self.add((a, b), K, M, turn_of(self.at[a], self.at[b]))

    def equal(self, a, b, rows):
        """Relative motion along `rows` (k, 6) is none."""
        rows = np.hstack([rows, -rows])
        self.add((a, b), PENALTY * rows.T @ rows)

    def frequencies(self, held, count):
        free = [d for d in range(len(self.K)) if d not in set(self.dofs(*held))]
        K, M = self.K[np.ix_(free, free)], self.M[np.ix_(free, free)]
        # 1 / lambda: links may have no mass
        value = 1 / eigh(M, K, eigvals_only=True)[::-1][:count]
        return np.sqrt(value) / (2 * np.pi)


def test_a_structure_of_every_kind_is_that_assembled_by_hand(tmp_path, validation):
    """Beams of two diameters, a cable, a turned spring, a rigid link with an offset mass, a sprung revolute joint, a
    coupled pile-head stiffness and mass."""
    row = validation(what="a structure of every kind of element, with a coupled SSI file: twelve frequencies",
                     reference="assembled by hand, constraints by penalties", why="penalty")
    rng = np.random.default_rng(6)
    root = rng.normal(size=(6, 6)) * np.array([1.0, 1, 1, 3, 3, 3])[:, None] * 1e3
    soil, spring = 5e1 * root @ root.T, rng.normal(size=(6, 6)) * 2e3
    spring = spring @ spring.T + 1e6 * np.eye(6)
    head = np.diag([2e3, 2e3, 1e3, 4e3, 4e3, 3e3])
    head[0, 4] = head[4, 0] = 500.0
    c, s = np.cos(0.7), np.sin(0.7)
    cosine = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]]) @ np.array([[1, 0, 0], [0, 0.8, 0.6], [0, -0.6, 0.8]])
    names = ("x", "y", "z", "tx", "ty", "tz")
    (tmp_path / "soil.txt").write_text("\n".join(
        f"{float(matrix[i, j])!r} {kind}{a}{b}" for kind, matrix in (("K", soil), ("M", head))
        for j, b in enumerate(names) for i, a in enumerate(names[: j + 1])))
    joints = ["0 0 0", "8 0 0", "1 0.5 10", "7 0 9 3 0 1 0 4e5", "4 1 12", "4.5 1.5 13", "20 0 12", "4 1 12"]
    text = subdyn(
        joints, ["1 3 1 1 1c 0", "2 4 1 1 1c 0", "3 4 2 2 1c 0", "4 5 2 2 1c 0", "3 5 1 1 1c 0", "5 6 5 5 3 -1",
                 "5 7 6 6 2 -1", "8 5 9 9 5 3"],
        ["1 0 0 0 0 0 0 soil.txt", "2 1 1 1 1 1 1", "7 1 1 1 1 1 1", "8 1 1 1 1 1 1"],
        circular=["1 2.1e11 8.076923e10 7850 0.5 0.02", "2 2.1e11 8.076923e10 7850 0.3 0.015"],
        cable=["6 2e7 12.0 3e5 0"], rigid=["5 40.0"],
        spring=["9 " + " ".join(repr(float(spring[i, j])) for i in range(6) for j in range(i, 6))],
        cosine=["3 " + " ".join(repr(float(v)) for v in cosine.ravel())],
        mass=["6 3e3 400 500 600 10 20 30 0.2 0.1 0.5"])
    found = modes_of(tmp_path, text, 12).frequency_hz
    # three ends at joint 4 turn about y: two more nodes there
    own = ByHand([[float(x) for x in joint.split()[:3]] for joint in joints] + [[7, 0, 9]] * 2)
    for a, b, diameter, wall in ((0, 2, 0.5, 0.02), (1, 3, 0.5, 0.02), (2, 8, 0.3, 0.015), (9, 4, 0.3, 0.015),
                                 (2, 4, 0.5, 0.02)):
        own.beam(a, b, diameter, wall)
    for other in (8, 9):
        own.equal(3, other, np.eye(6)[[0, 1, 2, 3, 5]])
    about = np.zeros(6)
    about[4] = 1.0
    # SubDyn's joint stiffness acts between each two ends
    for a, b in ((3, 8), (3, 9), (8, 9)):
        pair = np.concatenate([about, -about])
        own.add((a, b), 4e5 * np.outer(pair, pair))
    arm = own.at[5] - own.at[4]
    rigid = np.eye(6)
    rigid[:3, 3:] = np.array([[0, arm[2], -arm[1]], [-arm[2], 0, arm[0]], [arm[1], -arm[0], 0]])
    rows = np.hstack([rigid, -np.eye(6)])
    own.add((4, 5), PENALTY * rows.T @ rows)
    line = np.kron(np.array([[13 / 35, 9 / 70], [9 / 70, 13 / 35]]), np.diag([1, 1, 0, 0, 0, 0])) + np.kron(
        np.array([[1 / 3, 1 / 6], [1 / 6, 1 / 3]]), np.diag([0, 0, 1, 0, 0, 0]))
    own.add((4, 5), M=40.0 * np.linalg.norm(arm) * line, turn=turn_of(own.at[4], own.at[5]))
    length = np.linalg.norm(own.at[6] - own.at[4])
    rest = length / (1 + 3e5 / 2e7)
    pull = np.kron(np.array([[1, -1], [-1, 1]]), np.diag([3e5 / length, 3e5 / length, 2e7 / rest, 0, 0, 0]))
    own.add((4, 6), pull, 12.0 * rest * line, turn_of(own.at[4], own.at[6]))
    own.add((7, 4), np.kron(np.array([[1, -1], [-1, 1]]), spring), turn=cosine)
    own.add((0,), soil, head)
    r = np.array([0.2, 0.1, 0.5])
    cross = np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])
    inertia = np.array([[400, 10, 20], [10, 500, 30], [20, 30, 600.0]])
    own.add((5,), M=np.block([[3e3 * np.eye(3), -3e3 * cross], [3e3 * cross, inertia - 3e3 * cross @ cross]]))
    row.error(found / own.frequencies((1, 6, 7), 12) - 1, below=1e-5)


# joints and free motions ---------------------------------------------------------------------------------------------


def test_a_tenth_column_of_the_joints_is_passed_over_and_said(tmp_path):
    joints = ["0 0 -40", "0 0 0", "0 0 20"]
    rest = (["1 2 1 1 1 -1", "2 3 1 1 1 -1"], [CLAMPED])
    sets = {"circular": ["1 2.1e11 8.08e10 7850 9.4 0.04"], "interface": [3]}
    nine = modes_of(tmp_path, subdyn(joints, *rest, **sets), 6)
    for damping, said in (("0", False), ("250.0", True)):
        found = modes_of(tmp_path, subdyn([f"{j} 1 0 0 0 0 {damping}" for j in joints], *rest, **sets), 6)
        np.testing.assert_array_equal(found.frequency_hz, nine.frequency_hz)
        assert any("JointDamp is not used" in note for note in found.notes) is said


@pytest.mark.parametrize("stub", [None, 0.05, 1e-3])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_a_floating_pile_of_any_size_has_six_free_motions(tmp_path, scale, stub, validation):
    row = validation(what="floating pile of 80 mm to 80 km, with and without a stub: frequency times length",
                     reference="that of 80 m", why="rounding")
    heights = [20.0, 10, 0, -20, -40, -60] if stub is None else [20.0 + stub, 20, 10, 0, -20, -40, -60]
    n = len(heights)

    def found(scale):
        return modes_of(tmp_path, subdyn([f"0 0 {z * scale!r}" for z in heights],
                                         [f"{k} {k + 1} 1 1 1 -1" for k in range(1, n)], [], fem=3,
                                         circular=[f"1 2.1e11 8.08e10 7850 {9.4 * scale!r} {0.04 * scale!r}"]), 8)

    own = found(scale)
    assert own.frequency_hz[:6].tolist() == [0.0] * 6
    assert any("6 of these are motions that nothing holds" in note for note in own.notes)
    # a free pile bends about its middle first, and is numbered from there
    assert own.labels[:6] == tuple(f"R{k}" for k in range(1, 7))
    assert set(own.labels[6:8]) == {"X1", "Y1"}
    row.error(own.frequency_hz[6:] * scale / found(1.0).frequency_hz[6:] - 1, below=1e-6)
    large = found(1.0)
    assert large.frequency_hz[6] == pytest.approx(8.72, abs=0.02)
    assert not any(note.startswith("implausible") for note in large.notes)


def test_settings_and_columns_without_effect_are_said(tmp_path):
    text = subdyn(["0 0 0", "0 0 30", "0 20 30"], ["1 2 1 1 1 -1", "3 2 1 1 2 -1"], [CLAMPED, "3 1 1 1 1 1 1"],
                  circular=["1 2.1e11 8.1e10 7850 0.5 0.02"], cable=["1 1e9 0.1 1e5 2"])
    text = text.replace(" 0.0 0.0 0.0 0.0 0.0 0.0", " 0.0 0.0 1.5 0.0 0.0 0.0", 1)
    notes = " ".join(modes_of(tmp_path, text, 2).notes)
    assert "initial rigid-body position" in notes and "CtrlChannel is not used" in notes


def test_comments_and_numbers_behind_a_row_change_nothing(tmp_path):
    text = subdyn(["0 0 0", "0 0 30"], ["1 2 1 2 1 -1"], [CLAMPED],
                  circular=["1 2.1e11 8.1e10 7850 0.5 0.02", "2 2.1e11 8.1e10 7850 0.4 0.02"])
    plain = modes_of(tmp_path, text, 4)
    noted = text.replace("0 0 30 1 0 0 0 0", "0.0, 0.0, 3.0D1 1 0 0 0 0 ! top").replace(
        "2.1e11 8.1e10 7850 0.4 0.02", "2.1e11\t8.1e10\t7850\t0.4\t0.02  # upper")
    assert noted != text
    np.testing.assert_array_equal(modes_of(tmp_path, noted, 4).frequency_hz, plain.frequency_hz)


def column_on_a_link(folder, reactions, links=("1 4 5 5 3 -1",)):
    """A column of two members with a rigid link at its foot, joint 1, to joint 4."""
    return modes_of(folder, subdyn(["0 0 0", "0 0 15", "0 0 30", "3 0 0"], ["1 2 1 1 1 -1", "2 3 1 1 1 -1", *links],
                                   reactions, circular=["1 2.1e11 8.1e10 7850 2.0 0.03"], rigid=["5 0"]), 4)


@pytest.mark.parametrize("reactions", [["4 1 1 1 1 1 1"], [CLAMPED, "4 1 1 1 1 1 1"], [CLAMPED, "4 1 1 0 0 0 0"]])
def test_a_column_clamped_through_a_rigid_link_is_clamped(tmp_path, reactions):
    """Whichever joint of the link is held, and whichever comes first in the file."""
    np.testing.assert_allclose(column_on_a_link(tmp_path, reactions).frequency_hz,
                               column_on_a_link(tmp_path, [CLAMPED]).frequency_hz, rtol=1e-9)


def test_two_partly_held_joints_of_a_rigid_link_are_refused_with_the_remedy(tmp_path):
    with pytest.raises(InputError, match="neither is held in all six directions; hold one of them so"):
        column_on_a_link(tmp_path, ["1 1 1 1 0 0 0", "4 1 1 1 0 0 0"])


@pytest.mark.parametrize(("rows", "fits"), [("1 0 0 0 1 0 0 0 1", True), ("0 0 1 1 0 0 0 1 0", False),
                                            ("1 0 0 0 -1 0 0 0 -1", False)])
def test_a_cosine_matrix_that_turns_a_beam_off_its_axis_is_refused(tmp_path, rows, fits):
    """SubDyn takes it as it stands: the beam is stiff along another line than that between its joints."""
    text = subdyn(["0 0 0", "0 0 30"], ["1 2 1 1 1 3"], [CLAMPED], layout="v4.0", cosine=[f"3 {rows}"],
                  circular=["1 2.1e11 8.1e10 7850 2.0 0.03"])
    if fits:
        plain = modes_of(tmp_path, text.replace("1 2 1 1 1 3", "1 2 1 1 1 -1"), 4).frequency_hz
        np.testing.assert_allclose(modes_of(tmp_path, text, 4).frequency_hz, plain, rtol=1e-12)
        return
    with pytest.raises(InputError, match="third row of the cosine matrix 3 is not along member 1 from joint 1 to 2"):
        modes_of(tmp_path, text, 4)
