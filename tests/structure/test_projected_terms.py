"""Terms on a basis, held as they are on the full model: against each of them projected, densely."""

import pickle

import numpy as np
import pytest
from scipy import sparse

from probupdate.diagnosis.small_basis import energy_directions
from probupdate.effects.turbine import turbine_effects
from probupdate.structure import assembly
from probupdate.structure.description import described_sensors
from probupdate.structure.description_file import read_description
from probupdate.structure.extend import extended_model
from probupdate.structure.load import load_model, reference_model
from probupdate.structure.projected_terms import ProjectedTerms

RNG = np.random.default_rng(7)
N_DOF, R, N_TERM = 60, 9, 14


@pytest.fixture(scope="module")
def terms():
    found = []
    for k in range(N_TERM):
        rows = RNG.choice(N_DOF, 4 if k else N_DOF, replace=False)
        small = RNG.standard_normal((len(rows), len(rows)))
        whole = np.zeros((N_DOF, N_DOF))
        whole[np.ix_(rows, rows)] = small + small.T
        found.append(sparse.csc_array(whole))
    return found


@pytest.mark.parametrize("n_added", [0, 2])
@pytest.mark.parametrize("few", [False, True])
def test_sums_and_products_are_those_of_dense_terms(terms, n_added, few, validation):
    row = validation(what="hundreds of sparse terms on a basis: sums and products",
                     reference="each term projected, densely", why="rounding")
    basis = RNG.standard_normal((N_DOF, R))
    added = [*RNG.standard_normal((n_added, 2, R))]
    # a term that touches all, and terms without entries among those that touch little
    terms = [t * (k % 3 == 1) for k, t in enumerate(terms)] if few else terms
    held = ProjectedTerms.project(terms, basis).with_added(added)
    dense = np.array([basis.T @ (t @ basis) for t in terms] + [rows.T @ rows for rows in added])
    assert len(held) == len(dense)
    weight = RNG.standard_normal(len(dense)) * (RNG.random(len(dense)) < 0.6)
    row.error(held.total(weight) - np.tensordot(weight, dense, 1), below=1e-11)
    weights = RNG.standard_normal((5, len(dense))) * (RNG.random((5, len(dense))) < 0.4)
    weights[2] = 0.0
    vectors, onto = RNG.standard_normal((R, 6)), RNG.standard_normal((R, 4))
    sums = vectors.T @ np.tensordot(weights, dense, 1)
    row.error(held.times(weights, vectors, np.eye(R)) - sums, below=1e-11)
    row.error(held.times(weights, vectors, onto) - sums @ onto, below=1e-11)
    row.error(held.project_between(weight, vectors) - vectors.T @ np.tensordot(weight, dense, 1) @ vectors, below=1e-11)
    sparse_ones = np.abs(weight[: len(terms)])
    touched = np.flatnonzero(np.abs(sum(w * abs(t) for w, t in zip(sparse_ones, terms, strict=True))).sum(axis=0))
    assert np.array_equal(held.rows(weight), touched)
    assert all(a is b for a, b in zip(held.added, added, strict=True))


def test_terms_of_a_turned_nacelle_are_those_assembled_there(validation):
    """Rotor and nacelle with effects of mass, inertia, centre, a swinging mass, thrust and weight on them."""
    row = validation(what="stiffness and mass terms of a turbine with every effect, nacelle turned",
                     reference="the turbine assembled with its nacelle there", why="rounding of axial forces")
    path = reference_model("as_built")
    description = read_description(path)
    effects = [e.adds for e in turbine_effects(description, sensors=described_sensors(description)) if e.adds]
    turns = 144.0, 250.0
    model = extended_model(path, effects, turns_deg=turns)
    for angle, turned in zip(turns, model.turned, strict=True):
        there = extended_model(path, effects, nacelle_angle_deg=angle + 180.0)
        moved = 0
        for still, own, exact in zip((model.stiffness, model.mass), turned, (there.stiffness, there.mass), strict=True):
            moved += sum(a is not b for a, b in zip(still, own, strict=True))
            apart = [abs(a - b).max() / max(abs(b).max(), 1.0) for a, b in zip(own, exact, strict=True)]
            row.error(np.array(apart), below=1e-12, case=angle)
        assert 20 < moved < 100


def test_terms_transformed_together_or_one_by_one_are_equal(monkeypatch, validation):
    row = validation(what="terms of a turbine transformed 128 at a time", reference="one by one")
    path = reference_model("as_built")
    model = load_model(path)
    monkeypatch.setattr(assembly, "TERMS_AT_ONCE", 1)
    alone = load_model(path)
    for some, others in ((model.stiffness, alone.stiffness), (model.mass, alone.mass)):
        assert len(some) == len(others) > 1
        for a, b in zip(some, others, strict=True):
            row.equal(a.data, b.data)
            assert np.array_equal(a.indices, b.indices) and np.array_equal(a.indptr, b.indptr)


def test_coefficients_that_are_kept_are_those_computed_anew(validation):
    """What a function reads is the same at most points of a fit, and in most steps of derivatives: kept or shared, its
    values are those of the points one by one."""
    row = validation(what="coefficients of a model kept from point to point", reference="of a model asked once",
                     why="rounding of complex steps taken together")
    model = load_model(reference_model("updated"))
    start, std = model.parameters.initial, model.parameters.std

    def alone(theta: np.ndarray):
        # what was kept stays behind
        return pickle.loads(pickle.dumps(model.coefficients))(theta)

    points = [start, *(start + 0.3 * size * own for size in (1, -1) for own in np.diag(std)), start]
    for theta in points:
        for own, anew in zip(model.coefficients(theta), alone(theta), strict=True):
            assert np.array_equal(own, anew)
    stepped = points[3] + 1e-30j * np.eye(len(start))
    one_by_one = map(np.array, zip(*map(alone, stepped), strict=True))
    for own, anew in zip(model.coefficients(stepped), one_by_one, strict=True):
        scale = np.abs(anew.imag).max(axis=0) + 1e-30
        row.error((own - anew).imag / scale, below=1e-12)
        row.error(own.real / anew.real - 1, below=1e-12)


def test_directions_of_many_snapshots_are_those_of_their_own_gram_matrix(validation):
    """More snapshots than degrees of freedom: the lesser matrix has the same energies, and the directions span the
    same."""
    row = validation(what="principal directions of more snapshots than degrees of freedom",
                     reference="of the snapshots' own Gram matrix", why="rounding of the Gram matrix")
    root = RNG.standard_normal((N_DOF, N_DOF)) + 6 * np.eye(N_DOF)
    K = sparse.csc_array(root @ root.T)
    # a few strong directions, others a thousandth of them
    snapshots = RNG.standard_normal((N_DOF, N_DOF)) * np.geomspace(1, 1e-3, N_DOF) @ RNG.standard_normal((N_DOF, 90))
    energy, directions = energy_directions(snapshots, K)
    gram, turn = np.linalg.eigh(snapshots.T @ (K @ snapshots))
    row.error((energy - gram[-N_DOF:]) / gram[-1], below=1e-13, of="energies, of the largest")
    kept = energy > 1e-3 * energy[-1]
    here, there = directions[:, kept], snapshots @ (turn[:, -kept.sum():] / np.sqrt(gram[-kept.sum():]))
    row.error(here.T @ (K @ here) - np.eye(kept.sum()), below=1e-9, of="orthonormal")
    cosines = np.linalg.svd(here.T @ (K @ there), compute_uv=False)
    row.error(1 - cosines.min(), below=1e-7, of="least cosine")
    # fewer snapshots than degrees of freedom: from their own Gram matrix
    few_energy, few = energy_directions(snapshots[:, :7], K)
    assert few.shape == (N_DOF, 7) and len(few_energy) == 7
    np.testing.assert_allclose(few.T @ (K @ few), np.eye(7), atol=1e-6)
