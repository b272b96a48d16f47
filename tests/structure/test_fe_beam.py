"""Beams, alone and in a frame, against closed forms; hydrodynamic masses against their check values."""

import numpy as np
import pytest
from scipy import linalg, optimize

from probupdate.structure import beam, hydrodynamics
from probupdate.structure.assembly import assemble, axial_forces, node_dofs
from probupdate.structure.coefficient import Coefficient
from probupdate.structure.eigen import lowest_modes
from probupdate.structure.frame import Beam, Body, Frame, LineMass, Prestress, Support, Tie

E, NU, RHO = 2.1e11, 0.3, 7850.0
UP = np.array([0.0, 0.0, 1.0])
ASKEW = np.array([0.48, -0.6, 0.64])


def line(tube, length, number, *, direction=UP, density=RHO, per_metre=0.0, bodies=(), held=(), free=False,
         ties=()):
    """A straight frame along `direction`; held: {node: (6,) bool}, by default a clamp at its start."""
    direction = np.asarray(direction) / np.linalg.norm(direction)
    nodes = np.linspace(0, length, number + 1)[:, None] * direction
    carried = (LineMass(per_metre=Coefficient(per_metre), dry=True),) if per_metre else ()
    beams = tuple(
        Beam(start=k, end=k + 1, group="tower", part="tower", tube=tube, youngs_modulus_pa=E, poisson_ratio=NU,
             density_kgpm3=density, carried=carried)
        for k in range(number)
    )
    supports = tuple(Support(node=node, held=np.array(mask, bool)) for node, mask in dict(held).items())
    if not supports and not free:
        supports = (Support(node=0),)
    return Frame(node_m=nodes, beams=beams, supports=supports, bodies=tuple(bodies), ties=tuple(ties))


def frequencies(frame, n_mode, theory="bernoulli-euler", **kwargs):
    assembled = assemble(frame, updated=(), values={}, theory=theory, **kwargs)
    value, _ = lowest_modes(assembled.stiffness[0], assembled.mass[0], n_mode)
    return np.sqrt(value) / (2 * np.pi)


def frequency_equation(b, mu):
    return 1 + np.cos(b) * np.cosh(b) + mu * b * (np.cos(b) * np.sinh(b) - np.sin(b) * np.cosh(b))


@pytest.mark.parametrize(
    ("mu", "first", "second"),
    [(0, 1.875104, 4.694091), (0.5, 1.419964, 4.111133), (1, 1.247917, 4.031139), (2, 1.076196, 3.982573)],
)
@pytest.mark.parametrize("direction", [UP, ASKEW], ids=["upright", "askew"])
def test_cantilever_with_tip_mass_has_the_roots_of_its_frequency_equation(mu, first, second, direction, validation):
    row = validation(what="cantilever with tip mass, first two pairs, upright and askew", unit="on beta L",
                     reference="roots of its frequency equation", why="the printed digits")
    tube, length, number = beam.Tube(diameter_m=0.5, thickness_m=0.02), 20.0, 24
    EI, mass = E * tube.second_moment({}), RHO * tube.area({})
    # the mass as a carried one: the frequency equation knows no rotary inertia
    body = Body(node=number, mass=Coefficient(mu * mass * length))
    found = frequencies(
        line(tube, length, number, direction=direction, density=1e-9, per_metre=mass, bodies=[body]), 4
    )
    b = np.sqrt(2 * np.pi * found * length**2 * np.sqrt(mass / EI))
    for pair, root in ((b[:2], first), (b[2:], second)):
        row.error(pair - root, below=5e-6)
        assert abs(frequency_equation(root, mu)) < 2e-4 * np.cosh(root)
        exact = optimize.brentq(frequency_equation, root - 1e-3, root + 1e-3, args=(mu,))
        assert np.all(pair >= exact * (1 - 1e-9))


def test_tower_check_values(validation):
    row = validation(what="steel tower with tip mass, 8 and 32 elements", unit="Hz",
                     reference="its equations by an independent script", why="the printed digits")
    tube, length = beam.Tube(diameter_m=6.0, thickness_m=0.04), 72.0
    mass = RHO * tube.area({})

    def found(number):
        body = Body(node=number, mass=Coefficient(378e3))
        return frequencies(line(tube, length, number, density=1e-9, per_metre=mass, bodies=[body]), 4)[::2]

    row.error(found(8) - [0.545181, 5.466589], below=1e-6, of="8")
    row.error(found(32) - [0.545181, 5.466367], below=2e-6, of="32")


def test_rotary_inertia_costs_what_it_should():
    tube, number = beam.Tube(diameter_m=6.0, thickness_m=0.04), 16
    body = Body(node=number, mass=Coefficient(378e3))
    plain = frequencies(line(tube, 72.0, number, density=1e-9, per_metre=RHO * tube.area({}), bodies=[body]), 4)
    rotary = frequencies(line(tube, 72.0, number, bodies=[body]), 4)
    loss = 1 - (rotary / plain)[::2]
    assert 5e-5 < loss[0] < 5e-4
    assert loss[1] > 5 * loss[0]


def test_frequencies_converge_with_the_fourth_power_of_the_element_length(validation):
    tube = beam.Tube(diameter_m=0.5, thickness_m=0.02)
    exact = 4.694091132974175**2 / (2 * np.pi * 400) * np.sqrt(E * tube.second_moment({}) / (RHO * tube.area({})))
    error = [
        frequencies(line(tube, 20.0, n, density=1e-9, per_metre=RHO * tube.area({})), 4)[2] / exact - 1
        for n in (4, 8, 16)
    ]
    rate = np.log2(np.array(error[:-1]) / error[1:])
    validation(what="convergence of frequencies", reference="fourth power of the element's length",
               unit="on the exponent").error(rate - 4, below=0.25)


def pinned(number):
    held = [1, 1, 1, 0, 0, 1]
    return {0: held, number: held}


@pytest.mark.parametrize("theory", ["bernoulli-euler", "timoshenko"])
def test_pinned_stocky_beam_has_the_closed_form_of_its_theory(theory, validation):
    """A beam with hinges, mode n with k = n pi / L: EI k^4 / (rho A + rho I k^2) of Rayleigh, or Timoshenko's (1922)
    quadratic. Elements with constant shear converge with the square of their length, the others with its fourth
    power; two meshes extrapolate to the limit."""
    tube, length = beam.Tube(diameter_m=2.0, thickness_m=0.05), 20.0
    A, I = tube.area({}), tube.second_moment({})
    shear = 12 * E * I / (tube.shear_flexibility({}, length, NU) * length**2)  # kappa G A, kappa tested below
    exact = []
    for n in (1, 2):
        k = n * np.pi / length
        bending, rotary = E * I * k**4, RHO * A + RHO * I * k**2
        if theory == "bernoulli-euler":
            exact.append(bending / rotary)
        else:
            a, b = RHO * I * RHO * A / shear, rotary + RHO * A * E * I * k**2 / shear
            exact.append((b - np.sqrt(b**2 - 4 * a * bending)) / (2 * a))
    exact = np.repeat(np.sqrt(exact) / (2 * np.pi), 2)
    coarse, fine = (frequencies(line(tube, length, n, held=pinned(n)), 4, theory) for n in (32, 64))
    order = 4 if theory == "bernoulli-euler" else 2
    assert np.log2((coarse / exact - 1) / (fine / exact - 1)) == pytest.approx(np.full(4, order), abs=0.05)
    validation(
        what="pinned stocky beam, Bernoulli-Euler with rotary inertia and Timoshenko", reference="closed form",
        why="what two meshes extrapolate to",
    ).error((2**order * fine - coarse) / (2**order - 1) / exact - 1, below=1e-6)


def test_shear_coefficient_is_cowpers():
    def kappa(wall):
        tube = beam.Tube(diameter_m=2.0, thickness_m=wall)
        G = E / (2 * (1 + NU))
        return 12 * E * tube.second_moment({}) / (G * tube.area({}) * 100.0 * tube.shear_flexibility({}, 10.0, NU))

    assert kappa(1e-6) == pytest.approx(2 * (1 + NU) / (4 + 3 * NU), rel=1e-5)  # thin tube
    assert kappa(1 - 1e-9) == pytest.approx(6 * (1 + NU) / (7 + 6 * NU), rel=1e-5)  # full circle


@pytest.mark.parametrize("theory", ["bernoulli-euler", "timoshenko"])
def test_tip_deflection_is_exact_with_one_element(theory, validation):
    row = validation(what="static deflection of one element, both theories", reference="closed form",
                     why="exact in theory")
    tube, length = beam.Tube(diameter_m=2.0, thickness_m=0.05), 10.0
    assembled = assemble(line(tube, length, 1, direction=ASKEW), updated=(), values={}, theory=theory)
    flexibility = np.linalg.inv(assembled.stiffness[0].toarray())
    EI, EA = E * tube.second_moment({}), E * tube.area({})
    phi = tube.shear_flexibility({}, length, NU) if theory == "timoshenko" else 0.0
    transverse = length**3 / (3 * EI) * (1 + phi / 4)  # P L / (kappa G A) = phi L^3 / (12 E I)
    x, y, _ = beam.axes(np.zeros(3), ASKEW)
    row.error(y @ flexibility[:3, :3] @ y / transverse - 1, below=1e-12, of="bending, torsion")
    # small beside bending, whose rounding it has
    row.error(x @ flexibility[:3, :3] @ x / (length / EA) - 1, below=1e-10, of="along")
    row.error(x @ flexibility[3:, 3:] @ x / (length * (1 + NU) / EI) - 1, below=1e-12, of="bending, torsion")
    turned = np.cross(x, y) @ flexibility[3:, :3] @ y
    row.error(turned / (length**2 / (2 * EI)) - 1, below=1e-12, of="bending, torsion")


@pytest.mark.parametrize("theory", ["bernoulli-euler", "timoshenko"])
def test_free_frame_has_six_rigid_motions_and_the_right_inertia(theory, validation):
    row = validation(what="six rigid motions cost nothing; mass and inertia of a free frame", reference="rigid body",
                     why="rounding, of the largest stiffness and of the inertia")
    tube, length, number = beam.Tube(diameter_m=1.4, thickness_m=0.05), 12.0, 3
    frame = line(tube, length, number, direction=ASKEW, free=True)
    assembled = assemble(frame, updated=(), values={}, theory=theory)
    K, M = assembled.stiffness[0].toarray(), assembled.mass[0].toarray()
    assert np.array_equal(K, K.T) and np.array_equal(M, M.T)
    rigid = np.vstack([_rigid(position) for position in frame.node_m])
    row.error(K @ rigid / np.abs(K).max(), below=1e-9, of="force")
    energy = np.linalg.eigvalsh(K)
    assert np.sum(np.abs(energy) < 1e-9 * energy[-1]) == 6
    assert energy[6] > 1e-7 * energy[-1]
    inertia = rigid.T @ M @ rigid
    mass = RHO * tube.area({}) * length
    row.error(inertia[:3, :3] / mass - np.eye(3), below=1e-8, of="inertia")
    across = mass * length**2 / 3 + RHO * tube.second_moment({}) * length
    along = 2 * RHO * tube.second_moment({}) * length
    x = ASKEW / np.linalg.norm(ASKEW)
    exact = across * (np.eye(3) - np.outer(x, x)) + along * np.outer(x, x)
    row.error((inertia[3:, 3:] - exact) / across, below=1e-8, of="inertia")


def _rigid(position):
    x, y, z = position
    matrix = np.eye(6)
    matrix[:3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
    return matrix


@pytest.mark.parametrize("transverse_only", [True, False])
def test_carried_mass_moves_with_the_beam_but_does_not_spin(transverse_only):
    tube, length = beam.Tube(diameter_m=1.4, thickness_m=0.05), 7.0
    member = Beam(start=0, end=1, group="leg", part="leg", tube=tube, youngs_modulus_pa=E, poisson_ratio=NU,
                  density_kgpm3=0.0,
                  carried=(LineMass(per_metre=Coefficient(900.0), transverse_only=transverse_only),))
    frame = Frame(node_m=np.array([np.zeros(3), length * ASKEW]), beams=(member,))
    M = assemble(frame, updated=(), values={}).mass[0].toarray()
    rigid = np.vstack([_rigid(position) for position in frame.node_m])
    inertia = rigid.T @ M @ rigid
    along = np.outer(ASKEW, ASKEW)
    moved = np.eye(3) - along if transverse_only else np.eye(3)
    assert inertia[:3, :3] == pytest.approx(900.0 * length * moved, abs=1e-6)
    assert ASKEW @ inertia[3:, 3:] @ ASKEW == pytest.approx(0.0, abs=1e-6)
    spin = np.concatenate([np.zeros(3), ASKEW, np.zeros(3), ASKEW])
    assert M @ spin == pytest.approx(np.zeros(12), abs=1e-6)


def test_moments_of_a_uniform_density_are_its_consistent_matrix():
    length, density = 3.7, 812.0
    moments = density * length / np.arange(1, 8)
    across = np.tensordot(moments, beam.transverse_moments(length), 1)
    assert across == pytest.approx(density * beam.transverse_mass(length)[0], rel=1e-12, abs=1e-12)
    along = np.tensordot(moments[:3], beam.axial_moments(length), 1)
    assert along == pytest.approx(density * beam.axial_mass(length), rel=1e-12, abs=1e-12)


def test_interpolation_of_rigid_motion_and_of_a_bent_beam():
    length = 5.0
    ends = np.vstack([_rigid([0, 0, 0]), _rigid([length, 0, 0])])
    for xi in (0.0, 0.3, 1.0):
        assert beam.interpolation(xi, length) @ ends == pytest.approx(_rigid([xi * length, 0, 0]), abs=1e-12)
    # constant curvature: v = x^2 / 2, r_z = x; w = x^2 / 2, r_y = -x
    bent = np.zeros(12)
    bent[[7, 11]], bent[[8, 10]] = (length**2 / 2, length), (length**2 / 2, -length)
    u = beam.interpolation(0.4, length) @ bent
    assert u == pytest.approx([0, 2.0, 2.0, 0, -2.0, 2.0])


@pytest.mark.parametrize("tension", [2e6, -2e6])
def test_geometric_stiffness_stiffens_a_pinned_beam_as_a_string_does(tension, validation):
    tube, length, number = beam.Tube(diameter_m=0.5, thickness_m=0.02), 20.0, 16
    EI, mass = E * tube.second_moment({}), RHO * tube.area({})
    frame = line(tube, length, number, held=pinned(number))
    assembled = assemble(frame, updated=(), values={})
    geometric = np.zeros((6 * (number + 1),) * 2)
    for k in range(number):
        dofs = node_dofs(k, k + 1)
        turned = beam.to_global(beam.geometric_stiffness(length / number), beam.axes(np.zeros(3), UP))
        geometric[np.ix_(dofs, dofs)] += tension * turned
    T = assembled.transform
    K = assembled.stiffness[0] + T.T @ geometric @ T
    value = linalg.eigh(K, assembled.mass[0].toarray(), eigvals_only=True)
    k = np.pi / length
    exact = (EI * k**4 + tension * k**2) / (mass + RHO * tube.second_moment({}) * k**2)
    validation(what="geometric stiffness of a tensioned pinned beam", reference="closed form",
               why="mesh").error(value[:2] / exact - 1, below=1e-5)


def test_weight_compresses_a_column_by_what_stands_on_it():
    tube, length, number, g = beam.Tube(diameter_m=6.0, thickness_m=0.04), 72.0, 6, 9.81
    body = Body(node=number, mass=Coefficient(378e3))
    frame = line(tube, length, number, bodies=[body])
    load = Prestress(coefficient=Coefficient(), gravity_mps2=g)
    (force,) = axial_forces(frame, {}, "bernoulli-euler", [load]).T
    above = 378e3 + RHO * tube.area({}) * (length - (np.arange(number) + 0.5) * length / number)
    assert force == pytest.approx(-g * above, rel=1e-9)
    # a cantilever softens by load over buckling load; its own weight counts like 0.31 of it at the top (Euler's
    # critical weight 7.84 EI / L^2 against 2.47 EI / L^2 at the tip)
    straight, sunk = (frequencies(frame, 1, gravity_mps2=value)[0] for value in (None, g))
    critical = np.pi**2 * E * tube.second_moment({}) / (4 * length**2)
    share = g * (378e3 + 2.47 / 7.84 * RHO * tube.area({}) * length) / critical
    assert (sunk / straight) ** 2 == pytest.approx(1 - share, abs=0.1 * share)


def test_rigid_arm_carries_a_body_as_mass_and_inertia_at_the_tip():
    """A body on an arm against the textbook matrix of a mass with offset at the tip of a clamped beam."""
    tube, length = beam.Tube(diameter_m=2.0, thickness_m=0.05), 30.0
    arm, mass, inertia = np.array([-4.8, 0.3, 2.2]), 144e3, np.array([1e5, 2.8e7, 2.8e7])
    frame = line(tube, length, 1, density=1e-9)
    frame = Frame(
        node_m=np.vstack([frame.node_m, frame.node_m[1] + arm]), beams=frame.beams, supports=frame.supports,
        bodies=(Body(node=2, mass=Coefficient(mass), inertia_kgm2=np.diag(inertia)),), ties=(Tie(node=2, master=1),),
    )
    M = assemble(frame, updated=(), values={}).mass[0].toarray()
    cross = np.array([[0, -arm[2], arm[1]], [arm[2], 0, -arm[0]], [-arm[1], arm[0], 0]])
    exact = np.block([[mass * np.eye(3), -mass * cross], [mass * cross, np.diag(inertia) - mass * cross @ cross]])
    assert pytest.approx(exact, rel=1e-9, abs=1e-3) == M


def test_hydrodynamic_check_values(validation):
    row = validation(what="added, flooding and growth mass", reference="its equations by an independent script",
                     unit="kg/m", why="the printed digits")
    row.error(hydrodynamics.added_mass(1.42, 0.0, 1.0, 1025.0) - 1623.27, below=0.005)
    row.error(hydrodynamics.flooding_mass(1.42 - 2 * 0.046, 1025.0) - 1419.74, below=0.005)
    row.error(hydrodynamics.growth_mass(1.42, 0.05, 1300.0) - 300.18, below=0.005)
    with_growth = hydrodynamics.added_mass(1.42, 0.05, 1.0, 1025.0) - hydrodynamics.added_mass(1.42, 0, 1.0, 1025.0)
    row.error(with_growth - 236.68, below=0.005)


def test_tube_properties_with_scaled_diameter_wall_and_loss():
    tube = beam.Tube(diameter_m=1.0, thickness_m=0.04, diameter_factor="D_l", thickness_factor="t_l",
                     wall_loss=("corr",))
    values = {"D_l": 1.1, "t_l": 0.9, "corr": 0.003}
    assert tube.outer(values) == pytest.approx(1.094)
    assert tube.wall(values) == pytest.approx(0.033)
    # external loss leaves the bore as it was
    assert tube.inner(values) == pytest.approx(1.1 - 2 * 0.036)
    assert tube.area(values) == pytest.approx(np.pi * 0.033 * (1.094 - 0.033))


def test_lanczos_agrees_with_a_dense_solution(validation):
    frame = line(beam.Tube(diameter_m=2.0, thickness_m=0.05), 30.0, 6)
    assembled = assemble(frame, updated=(), values={}, theory="timoshenko")
    value, phi = lowest_modes(assembled.stiffness[0], assembled.mass[0], 8)
    dense = linalg.eigh(assembled.stiffness[0].toarray(), assembled.mass[0].toarray(), eigvals_only=True)
    validation(what="Lanczos", reference="dense solution").error(value / dense[:8] - 1, below=1e-9)
    assert phi.T @ assembled.mass[0] @ phi == pytest.approx(np.eye(8), abs=1e-10)
