"""Clay, piles on it and tubular joints against check values, closed forms and a second integration."""

import numpy as np
import pytest
from scipy import integrate

from probupdate.errors import InputError
from probupdate.structure import beam, joints, soil
from probupdate.structure.assembly import assemble
from probupdate.structure.coefficient import Coefficient
from probupdate.structure.description_file import parse_description
from probupdate.structure.frame import Beam, Frame, LineSpring, NodeSpring
from probupdate.structure.local_functions import PileMoments
from probupdate.structure.pile_head import head_stiffness, pile_head_stiffness
from probupdate.structure.turbine_frame import build_frame

CLAY = soil.Clay(submerged_unit_weight_npm3=9e3, strength_at_mudline_pa=60e3, strength_gradient_papm=0.0,
                 strain_50=0.01, matlock_j=0.5)
STIFFENING = soil.Clay(submerged_unit_weight_npm3=9e3, strength_at_mudline_pa=20e3, strength_gradient_papm=1800.0,
                       strain_50=0.01, matlock_j=0.5)
TUBE = beam.Tube(diameter_m=2.5, thickness_m=0.060)
E = 2.1e11


def test_lateral_clay_check_values(validation):
    row = validation(what="p-y of clay (API RP 2GEO)", reference="its equations by an independent script",
                     why="the printed digits")
    assert soil.ultimate_lateral(CLAY, 2.5, 5.0) == pytest.approx(712.5e3, rel=1e-12)
    assert soil.reference_deflection(CLAY, 2.5) == pytest.approx(0.0625, rel=1e-12)
    row.error(soil.lateral_stiffness(CLAY, 2.5, 5.0) / 26220e3 - 1, below=1e-9, of="initial stiffness")
    # Matlock's cube root at a tenth of y_c; the tabulated point beside it
    assert np.power(0.1, 1 / 3) * 356.25 == pytest.approx(165.36, abs=0.005)


def test_wedge_and_flow_meet_at_the_transition_depth():
    depth = 6 * 2.5 / (CLAY.submerged_unit_weight_npm3 * 2.5 / 60e3 + CLAY.matlock_j)
    assert soil.ultimate_lateral(CLAY, 2.5, depth) == pytest.approx(9 * 60e3 * 2.5, rel=1e-9)
    assert soil.ultimate_lateral(CLAY, 2.5, depth - 1) < 9 * 60e3 * 2.5
    assert soil.ultimate_lateral(CLAY, 2.5, depth + 1) == pytest.approx(9 * 60e3 * 2.5, rel=1e-12)


def test_axial_clay_check_values(validation):
    row = validation(what="t-z, q-z of clay, stiffness", reference="its equations by an independent script",
                     why="the printed digits")
    friction = soil.shaft_friction(CLAY, np.array(5.0))
    assert friction / 60e3 == pytest.approx(0.4653, abs=5e-5)
    assert friction == pytest.approx(27.918e3, abs=0.5)
    row.error(soil.axial_stiffness(CLAY, np.array(5.0)) / 16445e3 - 1, below=5e-5, of="t-z")
    assert soil.axial_stiffness(CLAY, np.array(5.0)) == pytest.approx(187.5 * np.pi * friction, rel=1e-12)
    row.error(soil.tip_stiffness(CLAY, 2.5, 5.0) / 132536e3 - 1, below=5e-6, of="q-z")


def test_shaft_friction_is_at_most_the_strength_and_continuous_where_psi_is_one():
    # psi = 60 / (9 z): alpha = 1 below psi = 1/4, 0.5 at psi = 1
    assert soil.shaft_friction(CLAY, np.array(40.0)) == pytest.approx(60e3, rel=1e-12)
    assert soil.shaft_friction(CLAY, np.array(1.0)) == pytest.approx(60e3 * 0.5 * (60 / 9) ** -0.25, rel=1e-12)
    edge = 60 / 9
    below, above = (soil.shaft_friction(CLAY, np.array(edge + step)) for step in (-1e-7, 1e-7))
    assert below == pytest.approx(0.5 * 60e3, rel=1e-6)
    assert above == pytest.approx(below, rel=1e-6)


def test_scour_takes_overburden_but_not_strength():
    # a layer of 2 m gone: as a clay 2 m shallower whose strength starts higher
    shallower = soil.Clay(submerged_unit_weight_npm3=9e3, strength_at_mudline_pa=20e3 + 2 * 1800,
                          strength_gradient_papm=1800.0, strain_50=0.01, matlock_j=0.5)
    assert soil.lateral_stiffness(STIFFENING, 2.5, 7.0, 2.0) == pytest.approx(
        soil.lateral_stiffness(shallower, 2.5, 5.0), rel=1e-12)
    assert soil.axial_stiffness(STIFFENING, np.array(7.0), 2.0) == pytest.approx(
        soil.axial_stiffness(shallower, np.array(5.0)), rel=1e-12)


@pytest.mark.parametrize("scour", [0.0, 0.8, 3.1])
def test_moments_of_the_springs_by_a_second_quadrature(scour):
    springs = soil.PileSprings(clay=STIFFENING, diameter_m=(2.5,) * 3, top_depth_m=(-1.0, 0.0, 2.0),
                               length_m=(1.0, 2.0, 3.0))
    lateral, axial = springs.lateral_moments(np.array(scour)), springs.axial_moments(np.array(scour))
    exposed = springs.exposed_moments(np.array(scour))
    for k, (top, length) in enumerate(zip(springs.top_depth_m, springs.length_m, strict=True)):
        low = max(top, scour)
        for m in range(7):
            def density(z, law, m=m, top=top, length=length):
                return law(z) * ((z - top) / length) ** m

            if low < top + length:
                exact, _ = integrate.quad(
                    density, low, top + length, args=(lambda z: soil.lateral_stiffness(STIFFENING, 2.5, z, scour),),
                    epsrel=1e-11)
            else:
                exact = 0.0
            assert lateral[k, m] == pytest.approx(exact, rel=1e-8)
            bare = min(max(scour - top, 0.0), length)
            assert exposed[k, m] == pytest.approx(length * (bare / length) ** (m + 1) / (m + 1), rel=1e-12)
            if m < 3 and low < top + length:
                exact, _ = integrate.quad(
                    density, low, top + length,
                    args=(lambda z: float(soil.axial_stiffness(STIFFENING, np.array(z), scour)),),
                    epsrel=1e-10, limit=200, points=[low + 1e-6, low + 1e-3])
                # 20 Gauss points across the kinks of alpha
                assert axial[k, m] == pytest.approx(exact, rel=2e-3)


def test_springs_differentiate_by_complex_step(validation):
    row = validation(what="soil springs' derivatives", reference="differences against complex step",
                     why="the differences' rounding, of the largest")
    springs = soil.PileSprings(clay=STIFFENING, diameter_m=(2.5,) * 3, top_depth_m=(-1.0, 0.0, 2.0),
                               length_m=(1.0, 2.0, 3.0))
    for name in ("lateral_moments", "axial_moments", "exposed_moments"):
        moments = getattr(springs, name)
        step = np.imag(moments(np.array(0.8 + 1e-30j))) / 1e-30
        difference = (moments(np.array(0.8 + 1e-5)) - moments(np.array(0.8 - 1e-5))) / 2e-5
        row.error((step - difference) / np.abs(step).max(), below=1e-6)
        # at a node the derivative of one side, never none and never both
        at_node = np.imag(moments(np.array(2.0 + 1e-30j))) / 1e-30
        sides = [np.sum((moments(np.array(2.0 + h)) - moments(np.array(2.0))) / h, axis=0) for h in (1e-6, -1e-6)]
        gap = [np.abs(np.sum(at_node, axis=0)[0] / side[0] - 1) for side in sides]
        assert min(gap) < 1e-4


def winkler_pile(length, number, lateral, axial, tip=0.0):
    """A pile with constant springs, integrated with the shape functions; head at node 0."""
    step = length / number
    moments = step / np.arange(1, 8)
    springs = LineSpring(lateral=tuple(Coefficient(lateral * m) for m in moments),
                         axial=tuple(Coefficient(axial * m) for m in moments[:3]))
    nodes = np.zeros((number + 1, 3))
    nodes[:, 2] = -np.linspace(0, length, number + 1)
    beams = tuple(Beam(start=k, end=k + 1, group="pile", part="pile", tube=TUBE, youngs_modulus_pa=E,
                       poisson_ratio=0.3, density_kgpm3=7850.0, springs=springs) for k in range(number))
    tips = (NodeSpring(node=number, direction=np.eye(6)[2], stiffness=Coefficient(tip)),)
    frame = Frame(node_m=nodes, beams=beams, springs=tips, pile_head=0, pile_part="pile")
    return head_stiffness(assemble(frame, updated=(), values={}), 0, np.empty(0))


def test_long_pile_is_hetenyis(validation):
    row = validation(what="long pile on springs, head stiffness", reference="Hetenyi", why="mesh")
    EI = TUBE.second_moment({}) * E
    assert float(EI) == pytest.approx(7.19221e10, rel=1e-6)
    stiffness = (2e7 / (4 * EI)) ** 0.25
    assert stiffness == pytest.approx(0.09131, abs=5e-6)
    head = winkler_pile(120.0, 120, 2e7, 1e6)
    row.error(head[0, 0] / 2.190297e8 - 1, below=1e-6)
    row.error(abs(head[0, 4]) / 1.199351e9 - 1, below=1e-6)
    row.error(head[4, 4] / 1.313467e10 - 1, below=1e-6)
    assert head[1, 1] == pytest.approx(head[0, 0], rel=1e-9)
    # a free head gives way as k / (2 l) says
    row.error(1 / np.linalg.inv(head)[0, 0] / (2e7 / (2 * stiffness)) - 1, below=1e-6)


def test_finite_pile_and_the_convergence_of_consistent_springs(validation):
    row = validation(what="finite pile, 80 elements; exponent of convergence", reference="closed form; fourth power")
    exact = np.array([2.129163e8, 1.166180e9, 1.292261e10])

    def error(number):
        head = winkler_pile(30.0, number, 2e7, 1e6)
        return np.array([head[0, 0], abs(head[0, 4]), head[4, 4]]) / exact - 1

    row.error(error(80), below=5e-7, of="head stiffness")
    assert error(10)[0] == pytest.approx(2.5e-5, rel=0.05)
    finest = winkler_pile(30.0, 160, 2e7, 1e6)[0, 0]
    rate = np.log2((winkler_pile(30.0, 5, 2e7, 1e6)[0, 0] - finest) / (winkler_pile(30.0, 10, 2e7, 1e6)[0, 0] - finest))
    row.error(rate - 4, below=0.2, of="exponent")


def test_strength_from_nothing_at_the_mudline(raw):
    """Normally consolidated clay: s_u = k z, so that psi, and with it alpha, is one number."""
    clay = soil.Clay(submerged_unit_weight_npm3=5e3, strength_at_mudline_pa=0.0, strength_gradient_papm=1500.0,
                     strain_50=0.02, matlock_j=0.5)
    z = np.array([0.0, 1.0, 20.0])
    assert soil.shaft_friction(clay, z) == pytest.approx(0.5 * (1500 / 5e3) ** -0.5 * 1500 * z, rel=1e-12)
    soft = []
    for strength in (0.0, 200.0):
        raw["soil"]["undrained_shear_strength_pa"] = {"at_mudline": strength, "gradient_per_m": 1500.0}
        description = parse_description(raw, "model.toml")
        heads = pile_head_stiffness(build_frame(description), updated=(), values={**description.values, "sc": 0.0},
                                    theory="bernoulli-euler")
        soft.append([heads[name](np.empty(0)) for name in ("k_xy", "k_z")])
    # 200 Pa are what the clay has 13 cm down
    assert np.all(np.isfinite(soft)) and soft[0] == pytest.approx(soft[1], rel=0.03)


@pytest.mark.parametrize(("tip", "exact"), [(2e8, 9.693886e8), (0.0, 8.245606e8)])
def test_axial_pile(tip, exact, validation):
    row = validation(what="axial pile, with and without tip", reference="closed form", why="mesh")
    row.error(winkler_pile(30.0, 160, 2e7, 3e7, tip)[2, 2] / exact - 1, below=1e-6)


def test_pile_head_of_the_turbine_by_its_own_assembly(raw, validation):
    """k_z from the whole frame's pile against the closed form where the soil is made constant with depth."""
    raw["soil"] = {"submerged_unit_weight_npm3": 9e3, "strain_50": 0.01, "matlock_j": 0.0,
                   "undrained_shear_strength_pa": {"at_mudline": 60e3, "gradient_per_m": 0.0}}
    raw["jacket"]["bottom"]["z_m"] = -20.0
    description = parse_description(raw, "model.toml")
    # under an absurd overburden, which no file may state, alpha is 1 and p_u 9 s_u D from the seabed down
    heavy = description.soil.model_copy(update={"submerged_unit_weight_npm3": 1e12})
    description = description.model_copy(update={"soil": heavy})
    values = {**description.values, "sc": 0.0}
    heads = pile_head_stiffness(build_frame(description), updated=(), values=values, theory="bernoulli-euler")
    tube = beam.Tube(diameter_m=1.6, thickness_m=0.04)
    EA, EI, length = E * tube.area({}), E * tube.second_moment({}), 25.0
    k, base = 187.5 * np.pi * 60e3, 0.25 * 9 * 60e3 * np.pi * 1.6**2 / 4 / (0.002 * 1.6)
    m = np.sqrt(k / EA)
    closed = EA * m * (base + EA * m * np.tanh(m * length)) / (EA * m + base * np.tanh(m * length))
    row = validation(what="k_z, k_xy of a turbine's pile in uniform soil", reference="closed forms",
                     why="mesh, finite length")
    row.error(heads["k_z"](np.empty(0)) / closed - 1, below=1e-3, of="k_z")
    # 25 m is a long pile: Hetenyi
    k = 2.3 * 9 * 60e3 * 1.6 / (2.5 * 0.01 * 1.6)
    lam = (k / (4 * EI)) ** 0.25
    row.error(heads["k_xy"](np.empty(0)) / (4 * EI * lam**3) - 1, below=5e-3, of="k_xy")


def test_soil_factors_divide_the_pile_head_stiffness(raw):
    description = parse_description(raw, "model.toml")
    names = ("k_p", "py", "tz", "qw")
    heads = pile_head_stiffness(build_frame(description), updated=names, values=description.values,
                                theory="bernoulli-euler")
    base = np.ones(4)
    for name in ("k_xy", "k_z"):
        start = heads[name](base)
        slopes = np.array([np.log(heads[name](base * np.exp(1e-4 * e)) / start) / 1e-4 for e in np.eye(4)])
        # the stiffness is homogeneous of degree one in E and 1 / factor
        assert slopes[0] - slopes[1:].sum() == pytest.approx(1.0, abs=1e-3)
        softened = {"k_xy": slopes[1], "k_z": slopes[2] + slopes[3]}[name]
        assert -1 < softened < -0.2


def test_pile_moments_come_flat_and_in_the_elements_order():
    springs = soil.PileSprings(clay=CLAY, diameter_m=(2.5,) * 2, top_depth_m=(0.0, 2.0), length_m=(2.0, 3.0))
    flat = PileMoments(springs=springs, kind="axial_moments")({"sc": 0.5})
    assert flat == pytest.approx(springs.axial_moments(np.array(0.5)).ravel(), rel=1e-15)
    many = PileMoments(springs=springs, kind="axial_moments")({"sc": np.array([0.5, 1.0])})
    assert many.shape == (2, 6)
    assert many[0] == pytest.approx(flat, rel=1e-15)


def test_fessler_check_values(validation):
    row = validation(what="Fessler's joint flexibilities", reference="its equations by an independent script",
                     why="the printed digits")
    axial, in_plane, out_of_plane = joints.fessler(1.2, 0.04, 0.6, np.pi / 4) / 2.1e11
    row.error(np.array([axial, out_of_plane, in_plane]) / [4.96894e-10, 6.28745e-9, 2.73430e-9] - 1, below=5e-6)


def test_release_directions_are_orthonormal_and_follow_their_names():
    chord, brace = np.array([0.0, 0.0, 1.0]), np.array([np.sin(0.8), 0.0, np.cos(0.8)])
    along, in_plane, out_of_plane = joints.release_directions(chord, brace)
    assert along == pytest.approx([*brace, 0, 0, 0])
    assert np.abs(in_plane) == pytest.approx([0, 0, 0, 0, 1, 0])
    # the axis of out-of-plane bending lies in the plane of chord and brace, across the brace
    assert out_of_plane[3:] @ brace == pytest.approx(0, abs=1e-12)
    assert out_of_plane[4] == pytest.approx(0, abs=1e-12)
    rows = np.array([along, in_plane, out_of_plane])
    assert rows @ rows.T == pytest.approx(np.eye(3), abs=1e-12)


def test_joint_laws_by_name():
    assert joints.joint_law("rigid") is None
    assert joints.joint_law("fessler") is joints.fessler
    with pytest.raises(InputError, match=r"jacket\.joints\.law: 'buitrago' is unknown; choose from fessler, rigid"):
        joints.joint_law("buitrago")
    assert joints.joint_law("own", {"own": joints.fessler}) is joints.fessler
