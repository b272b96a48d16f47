"""Accuracy of modes: free of units and mesh, against closed forms; free motions; matrices of absurd size."""

import numpy as np
import pytest
from scipy import sparse
from scipy.optimize import brentq

from probupdate.errors import InputError
from probupdate.structure.eigen import lowest_modes, modes_with_free_motions

# a beam in a plane: flexural stiffness in N m2, mass in kg/m, mass at its tip in kg
EI, MU, TOP = 2.0e12, 8.0e3, 3.0e5


def beam(n, length=100.0, unit=1.0, top=TOP, clamped=True, stub=None):
    """K and M of n Bernoulli-Euler elements (v, theta at each node) in length units of `unit` m, the mass in units that
    belong to them (mm, N, t). `stub`: length of the first element, in m."""
    lengths = np.full(n, length / n) if stub is None else np.array([stub, *np.full(n - 1, (length - stub) / (n - 1))])
    L, one = lengths[:, None, None], np.ones(n)[:, None, None]
    stiffness = EI / L**3 * np.block([[12 * one, 6 * L, -12 * one, 6 * L], [6 * L, 4 * L * L, -6 * L, 2 * L * L],
                                      [-12 * one, -6 * L, 12 * one, -6 * L], [6 * L, 2 * L * L, -6 * L, 4 * L * L]])
    mass = MU * L / 420 * np.block([[156 * one, 22 * L, 54 * one, -13 * L], [22 * L, 4 * L * L, 13 * L, -3 * L * L],
                                    [54 * one, 13 * L, 156 * one, -22 * L],
                                    [-13 * L, -3 * L * L, -22 * L, 4 * L * L]])
    mass[-1, 2, 2] += top
    dofs = 2 * np.arange(n)[:, None] + np.arange(4)
    places = np.repeat(dofs, 4, axis=1).ravel(), np.tile(dofs, 4).ravel()
    size = 2 * n + 2
    K, M = (sparse.csc_array(sparse.coo_array((a.ravel(), places), shape=(size, size))) for a in (stiffness, mass))
    turn = sparse.diags_array(np.tile([unit, 1.0], n + 1))
    first = 2 if clamped else 0
    K, M = (sparse.csc_array(turn @ a @ turn)[first:, first:] / unit for a in (K, M))
    return 0.5 * (K + K.T), 0.5 * (M + M.T)


def frequency(value):
    return np.sqrt(value) / (2 * np.pi)


def textbook(length=100.0):
    """First frequency of the clamped beam with its tip mass: 1 + cos cosh + r b (cos sinh - sin cosh) = 0."""
    r = TOP / (MU * length)
    root = brentq(lambda b: 1 + np.cos(b) * np.cosh(b) + r * b * (np.cos(b) * np.sinh(b) - np.sin(b) * np.cosh(b)),
                  0.5, 1.8)
    return (root / length) ** 2 * np.sqrt(EI / MU) / (2 * np.pi)


@pytest.mark.parametrize("unit", [1.0, 1e-3], ids=["m-N-kg", "mm-N-t"])
@pytest.mark.parametrize("n", [60, 300, 1000, 2000])
def test_fine_meshes_have_the_textbook_frequency_in_any_units(n, unit, validation):
    row = validation(what="clamped beam with a tip mass, 60 to 2000 elements, m-N-kg and mm-N-t: first frequency",
                     reference="frequency equation", why="rounding of the entries of K")
    value, _ = lowest_modes(*beam(n, unit=unit), 4)
    # an entry of K over the bending energy of its element goes with the fourth power of their number: so do roundings
    row.error(frequency(value[0]) / textbook() - 1, below=1e-8 * max(1.0, n / 1000) ** 4)


@pytest.mark.parametrize("length", [1e-3, 1.0, 1e5])
def test_a_beam_of_any_extent_has_its_textbook_frequency(length):
    value, _ = lowest_modes(*beam(80, length=length, top=TOP * length / 100), 3)
    # a tip mass in the same proportion to the beam's own
    expected = textbook() * (100 / length) ** 2
    assert frequency(value[0]) == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("factor", [(1e290, 1.0), (1e-290, 1.0), (1.0, 1e290), (1e250, 1e250), (1e-250, 1e-250)])
def test_matrices_scaled_by_huge_factors_keep_their_frequencies(factor):
    K, M = beam(60)
    value, phi = lowest_modes(K * factor[0], M * factor[1], 3)
    root = np.sqrt(factor[0]) / np.sqrt(factor[1])
    assert frequency(value[0]) / root == pytest.approx(textbook(), rel=1e-8)
    phi = phi * np.sqrt(factor[1])
    np.testing.assert_allclose(np.diag(phi.T @ (M @ phi)), 1.0, rtol=1e-9)


@pytest.mark.parametrize("factor", [(1e200, 1e-200), (1e-200, 1e200), (np.inf, 1.0), (0.0, 1.0)])
def test_frequencies_beyond_all_numbers_are_refused_in_one_line(factor):
    K, M = beam(60)
    with pytest.raises(InputError, match="units"), np.errstate(invalid="ignore"):
        lowest_modes(K * factor[0], M * factor[1], 3)


def test_a_mesh_too_fine_for_double_precision_is_refused():
    with pytest.raises(InputError, match="far too fine|unrestrained|not positive definite"):
        lowest_modes(*beam(20_000), 4)


@pytest.mark.parametrize("stub", [None, 1e-3])
@pytest.mark.parametrize(("length", "unit"), [(1e-3, 1.0), (100.0, 1.0), (100.0, 1e-3), (1e5, 1.0)])
def test_a_floating_beam_has_two_free_motions_and_its_own(length, unit, stub, validation):
    row = validation(what="floating beam of 1 mm to 100 km, with and without a stub: frequencies above 0",
                     reference="free-free beam", why="rounding of the entries of K")
    K, M = beam(60, length=length, unit=unit, top=0.0, clamped=False, stub=None if stub is None else stub * length)
    value, _, free = modes_with_free_motions(K, M, 4)
    assert free == 2 and value[:2].tolist() == [0.0, 0.0]
    roots = np.array([4.730040744862704, 7.853204624095838])
    expected = (roots / length) ** 2 * np.sqrt(EI / MU) / (2 * np.pi)
    row.error(frequency(value[2:]) / expected - 1, below=1e-6)


@pytest.mark.parametrize("unit", [1.0, 1e-3], ids=["m-N-kg", "mm-N-t"])
def test_a_floating_beam_of_a_fine_mesh_keeps_eight_digits(unit, validation):
    row = validation(what="floating beam of 500 elements: lowest frequency above 0", reference="free-free beam",
                     why="rounding of the entries of K")
    value, _, free = modes_with_free_motions(*beam(500, unit=unit, top=0.0, clamped=False), 3)
    assert free == 2
    row.error(frequency(value[2]) / ((4.730040744862704 / 100) ** 2 * np.sqrt(EI / MU) / (2 * np.pi)) - 1, below=1e-8)


def test_free_motions_alone_are_found_where_no_more_are_asked():
    value, _, free = modes_with_free_motions(*beam(60, top=0.0, clamped=False), 2)
    assert free == 2 and not value.any()


def test_a_free_motion_that_rounding_holds_is_refused_as_one():
    K, M = beam(60, top=0.0, clamped=False)
    # what rounding of another order of assembly may leave
    K = K + 2e-16 * sparse.diags_array(K.diagonal())
    with pytest.raises(InputError, match="mechanism.*hanging free, model the soft springs"):
        lowest_modes(K, M, 3)


def test_a_negative_stiffness_is_no_free_motion():
    K, M = beam(60)
    K = K.tolil()
    K[-2, -2] -= 2 * 3 * EI / 100.0**3
    with pytest.raises(InputError, match="not positive definite"):
        modes_with_free_motions(sparse.csc_array(K), M, 3)


@pytest.mark.parametrize("n", [3, 30])
def test_small_floating_models_are_solved_densely_alike(n):
    value, _, free = modes_with_free_motions(*beam(n, top=0.0, clamped=False), 4)
    assert free == 2
    # Bernoulli-Euler elements converge with the fourth power of their number
    assert frequency(value[2]) == pytest.approx((4.730040744862704 / 100) ** 2 * np.sqrt(EI / MU) / (2 * np.pi),
                                                rel=0.05 * (3 / n) ** 4 + 1e-6)
