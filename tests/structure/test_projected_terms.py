"""Terms on a basis, held as they are on the full model: against each of them projected, densely."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

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
@pytest.mark.parametrize("without", [(), (0, 3)])
def test_sums_and_products_are_those_of_dense_terms(terms, n_added, without):
    basis = RNG.standard_normal((N_DOF, R))
    added = [a + a.T for a in RNG.standard_normal((n_added, R, R))]
    held = ProjectedTerms.of(terms, basis, without=without).with_added(added)
    dense = np.array([basis.T @ (t @ basis) * (k not in without) for k, t in enumerate(terms)] + added)
    assert len(held) == len(dense)
    weight = RNG.standard_normal(len(dense)) * (RNG.random(len(dense)) < 0.6)
    np.testing.assert_allclose(held.total(weight), np.tensordot(weight, dense, 1), atol=1e-11)
    weights = RNG.standard_normal((5, len(dense))) * (RNG.random((5, len(dense))) < 0.4)
    weights[2] = 0.0
    vectors = RNG.standard_normal((R, 6))
    np.testing.assert_allclose(held.times(weights, vectors), np.tensordot(weights, dense, 1) @ vectors, atol=1e-11)
    assert all(a is b for a, b in zip(held.added, added, strict=True))


def test_equal_matrices_of_two_models_are_held_once():
    model = load_model(reference_model("as_built"))
    own = [t.copy() for t in model.stiffness]
    own[3] = own[3] * 1.5
    other = replace(model, stiffness=tuple(own), mass=tuple(t.copy() for t in model.mass))
    shared = other.sharing(model)
    assert all(a is b for a, b in zip(shared.mass, model.mass, strict=True))
    assert [a is b for a, b in zip(shared.stiffness, model.stiffness, strict=True)].count(False) == 1
    theta = model.parameters.initial
    for a, b in zip(shared.matrices(theta), other.matrices(theta), strict=True):
        assert (a != b).nnz == 0
