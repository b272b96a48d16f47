"""The virtual turbine's element, joints and soil against closed forms and check values."""

import numpy as np
import pytest
from scipy.linalg import eigh, expm
from scipy.optimize import brentq

from probupdate.virtual import beam, soil

E, NU, RHO = 2.1e11, 0.3, 7850.0


def tube(diameter=6.0, wall=0.04, **more):
    return beam.Tube(
        diameter_m=diameter, thickness_m=wall, youngs_modulus_pa=E, poisson_ratio=NU, density_kgpm3=RHO, **more
    )


def chain(section, start, end, n):
    """K, M of n elements from start to end, ends free."""
    points = np.linspace(start, end, n + 1)
    stiffness, mass = np.zeros((6 * n + 6,) * 2), np.zeros((6 * n + 6,) * 2)
    for k in range(n):
        axes, length = beam.local_axes(points[k], points[k + 1])
        here = slice(6 * k, 6 * k + 12)
        stiffness[here, here] += beam.to_global(beam.local_stiffness(section, length), axes)
        for node in (k, k + 1):
            block = slice(6 * node, 6 * node + 6)
            mass[block, block] += beam.lumped_mass(section, length, axes)
    return stiffness, mass


def bending_frequency(section, length, n, tip_kg=0.0):
    stiffness, mass = chain(section, [0, 0, 0], [0, 0, length], n)
    mass[-6:-3, -6:-3] += tip_kg * np.eye(3)
    value = eigh(stiffness[6:, 6:], mass[6:, 6:], eigvals_only=True, subset_by_index=(0, 7))
    return np.sqrt(value) / (2 * np.pi)


def test_tip_deflection_has_bending_and_shear():
    section, length, load = tube(), 12.0, 1e6
    stiffness, _ = chain(section, [0, 0, 0], [3.0, 4.0, 0.0] / np.float64(5) * length, 3)
    force = np.zeros(18)
    force[14] = load
    tip = np.linalg.solve(stiffness[6:, 6:], force)[14]
    bending = load * length**3 / (3 * E * section.second_moment_m4)
    shear = load * length / (section.shear_coefficient * section.area_m2 * section.shear_modulus_pa)
    assert tip == pytest.approx(bending + shear, rel=1e-10)
    assert shear > 0.1 * bending  # or the line above could not see shear


def test_slender_cantilever_meets_euler():
    section, length = tube(1.0, 0.02), 72.0
    found = bending_frequency(section, length, 96)[[0, 2]]
    wave = np.array([1.875104, 4.694091]) / length
    euler = wave**2 / (2 * np.pi) * np.sqrt(E * section.second_moment_m4 / (RHO * section.area_m2))
    # shear and rotary inertia lower mode k by about (1 + E/kG) (b r / L)^2 / 2, r the radius of gyration
    radius2 = section.second_moment_m4 / section.area_m2
    lower = 0.5 * (1 + 2 * (1 + NU) / section.shear_coefficient) * (wave**2 * radius2)
    assert np.all(np.abs(found / euler - 1) < 2e-4 + 3 * lower)
    assert found[0] < euler[0]


def exact_timoshenko(section, length, tip_kg, near_hz, stiffer=1.0):
    """First frequency of a cantilever with a tip mass from the differential equations: state w, psi, M, V along x."""
    shear = stiffer * section.shear_coefficient * section.area_m2 * section.shear_modulus_pa
    bending = E * section.second_moment_m4

    def residual(frequency):
        omega2 = (2 * np.pi * frequency) ** 2
        slope = np.array([
            [0, 1, 0, 1 / shear],
            [0, 0, 1 / bending, 0],
            [0, -RHO * section.second_moment_m4 * omega2, 0, -1],
            [-RHO * section.area_m2 * omega2, 0, 0, 0],
        ])
        end = expm(slope * length)
        free = np.array([end[2, 2:], end[3, 2:] - tip_kg * omega2 * end[0, 2:]])
        return np.linalg.det(free)

    return brentq(residual, 0.9 * near_hz, 1.1 * near_hz, xtol=1e-12)


def test_tower_with_tip_mass():
    # formulas.md: L 72, tube 6 x 0.04, tip 378 t; 0.545181 Hz without shear and rotary inertia
    section = tube()
    exact = exact_timoshenko(section, 72.0, 378e3, 0.545181)
    # lumping moves the frequency by O((h/L)^2), here 1.9e-4 times a factor below one
    assert bending_frequency(section, 72.0, 72, 378e3)[0] == pytest.approx(exact, rel=5e-5)
    assert 0.985 * 0.545181 < exact < 0.545181
    # without shear only rotary inertia is left; Rayleigh with the shape of a tip load, int w'^2 = 6/5 / L,
    # int w^2 = 33/140 L
    modal = 378e3 + 33 / 140 * RHO * section.area_m2 * 72.0
    lower = 0.5 * RHO * section.second_moment_m4 * 1.2 / 72.0 / modal
    rotary = 1 - exact_timoshenko(section, 72.0, 378e3, 0.545181, stiffer=1e4) / 0.545181
    assert rotary == pytest.approx(lower, rel=0.03)


def test_lumped_mass_converges_with_the_square_of_the_element():
    section = tube(2.0, 0.03)
    reference = bending_frequency(section, 30.0, 256)[2]
    errors = [abs(bending_frequency(section, 30.0, n)[2] - reference) for n in (8, 16, 32)]
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all((rates > 1.8) & (rates < 2.3))


def test_rigid_motion_costs_nothing_and_weighs_the_member():
    section = tube(carried_kgpm=300.0, added_kgpm=1600.0)
    end = np.array([4.0, -3.0, 12.0])
    stiffness, mass = chain(section, [0, 0, 0], end, 4)
    assert np.abs(stiffness - stiffness.T).max() < 1e-12 * np.abs(stiffness).max()
    points = np.linspace([0, 0, 0], end, 5)
    scale = np.abs(stiffness).max()
    for axis in np.eye(3):
        shift = np.concatenate([np.r_[axis, 0, 0, 0] for _ in points])
        spin = np.concatenate([np.r_[np.cross(axis, x), axis] for x in points])
        assert np.abs(stiffness @ shift).max() < 1e-9 * scale
        assert np.abs(stiffness @ spin).max() < 1e-8 * scale
    length, along = np.linalg.norm(end), end / np.linalg.norm(end)
    across = np.cross(along, [1.0, 0, 0])
    across /= np.linalg.norm(across)
    own = RHO * section.area_m2 + 300.0
    for axis, weight in ((along, own), (across, own + 1600.0)):
        shift = np.tile(np.r_[axis, 0, 0, 0], 5)
        assert shift @ mass @ shift == pytest.approx(weight * length, rel=1e-12)
    # water and growth do not spin about the member
    spin = np.tile(np.r_[0, 0, 0, along], 5)
    assert spin @ mass @ spin == pytest.approx(2 * RHO * section.second_moment_m4 * length, rel=1e-12)


def test_soft_ends_equal_explicit_springs():
    section, length = tube(0.6, 0.02), 8.0
    local = beam.local_stiffness(section, length)
    flexibility = np.array([3e-9, 0, 0, 0, 4e-9, 2e-9])
    softened = beam.soften_ends(local, flexibility, np.zeros(6))
    # the long way: an inner node on springs (very stiff where rigid), condensed
    springs = np.diag(np.where(flexibility > 0, 1 / np.where(flexibility > 0, flexibility, 1), 1e14))
    whole = np.zeros((18, 18))
    whole[:6, :6] += springs
    whole[:6, 6:12] -= springs
    whole[6:12, :6] -= springs
    whole[6:12, 6:12] += springs
    inner = np.r_[6:12, 12:18]
    whole[np.ix_(inner, inner)] += local
    keep, drop = np.r_[0:6, 12:18], np.r_[6:12]
    condensed = whole[np.ix_(keep, keep)] - whole[np.ix_(keep, drop)] @ np.linalg.solve(
        whole[np.ix_(drop, drop)], whole[np.ix_(drop, keep)]
    )
    # the penalty springs are 1e14 against 1e9..1e10 of the tube
    assert np.abs(softened - condensed).max() < 1e-4 * np.abs(local).max()
    assert softened[0, 0] == pytest.approx(1 / (length / (E * section.area_m2) + 3e-9), rel=1e-12)
    assert np.allclose(beam.soften_ends(local, np.zeros(6), np.zeros(6)), local)


def test_joint_flexibility_check_values():
    # formulas.md: d .6, D 1.2, T .04, 45 deg
    found = soil.joint_flexibility(0.6, 1.2, 0.04, np.pi / 4, E)
    assert found[[0, 4, 5]] == pytest.approx([4.96894e-10, 6.28745e-9, 2.73430e-9], rel=1e-5)


def test_soil_is_in_the_range_of_the_standard_and_not_the_standard():
    # formulas.md: D 2.5, su 60 kPa, z 5: API 26 220 kN/m2, 16 445 kN/m2, 132 536 kN/m
    clay = soil.Clay(strength_mudline_pa=60e3, strength_gradient_papm=0.0, unit_weight_npm3=9e3, strain_50=0.01)
    ratio = np.array([
        soil.lateral_stiffness(clay, 2.5, np.array([5.0]))[0] / 26.22e6,
        soil.axial_stiffness(clay, np.array([5.0]))[0] / 16.445e6,
        soil.tip_stiffness(clay, 2.5, 5.0) / 132.536e6,
    ])
    assert np.all((ratio > 0.6) & (ratio < 1.7))
    assert np.all(np.abs(ratio - 1) > 0.02)
    assert soil.lateral_stiffness(clay, 2.5, np.array([-0.1]))[0] == 0
    # scour uncovers stronger soil
    graded = [
        soil.Clay(strength_mudline_pa=20e3, strength_gradient_papm=1500.0, unit_weight_npm3=9e3, strain_50=0.01,
                  scour_m=s).strength(np.array([2.0]))[0]
        for s in (0.0, 3.0)
    ]
    assert graded[1] - graded[0] == pytest.approx(4500.0)
