"""The small basis of a diagnosis: modes in equal pairs at the end of those wanted, and a basis that misses at first."""

import numpy as np
import pytest
from scipy import sparse

from probupdate.diagnosis import small_basis
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.affine import AffineModel

FLOOR, N_ARM, N_PIECE = 20, 12, 4
N_MODE = 9


def with_arms(n_arm: int) -> AffineModel:
    """Two equal chains of FLOOR masses, from which equal arms hang whose stiffnesses are parameters: local modes
    among the lowest, all of them in pairs."""
    half = FLOOR + N_PIECE * n_arm // 2
    n = 2 * half
    ends = np.concatenate([start + np.arange(FLOOR) for start in (0, half)])

    def spring(i: int, j: int | None, k: float) -> sparse.csc_array:
        side = np.zeros((n, 1))
        side[i] = 1.0
        if j is not None:
            side[j] = -1.0
        return sparse.csc_array(k * side @ side.T)

    still = sum(spring(s, None, 1e8) + sum(spring(s + i, s + i + 1, 1e8) for i in range(FLOOR - 1)) for s in (0, half))
    terms = [sparse.csc_array(still)]
    for arm in range(n_arm):
        s = half * (arm % 2)
        own, root = s + FLOOR + N_PIECE * (arm // 2), s + arm // 2 * 2 * FLOOR // n_arm
        terms.append(sparse.csc_array(spring(own, root, 3e6)
                                      + sum(spring(own + k + 1, own + k, 3e6) for k in range(N_PIECE - 1))))
    mass = np.full(n, 1e3)
    mass[ends] = 1e4
    return AffineModel(
        name="chains with arms", channels=("top",), hash_key=f"{n_arm}",
        parameters=Parameters(tuple(Parameter(name=f"arm {k}", unit="-", initial=1.0, std=0.2, lower=0.3, upper=1.9)
                                    for k in range(n_arm))),
        stiffness=tuple(terms), mass=(sparse.csc_array(np.diag(mass)),),
        coefficients=lambda theta: (np.concatenate([np.ones_like(theta[..., :1]), theta], -1),
                                    np.ones_like(theta[..., :1])),
        channel_matrix=sparse.csr_array(np.eye(n)[[FLOOR - 1]]),
    )


def on_basis(model: AffineModel, n_mode: int):
    reach = np.column_stack([model.parameters.lower, model.parameters.upper])
    return small_basis.small_model(model, n_mode=n_mode, effects=(), reach=reach)


def worst(model: AffineModel, small, n_mode: int) -> float:
    """Largest relative error of frequencies at ten draws that nobody looked at."""
    theta = model.parameters.draw(np.random.default_rng(5), 10)
    return max(float(np.max(np.abs(small.evaluate(row).solve(0.0, n_mode).frequency_hz
                                   / model.solve(row, n_mode).frequency_hz - 1))) for row in theta)


@pytest.mark.parametrize("n_mode", [N_MODE, N_MODE + 1])
def test_the_last_mode_may_be_one_of_an_equal_pair(n_mode, validation):
    """Its first-order change towards its twin, which nobody asked for, had no bound and drowned all other directions:
    a lattice tower of 106 m ended with frequencies off by 0.6."""
    row = validation(what="small basis of a model whose modes come in equal pairs, an odd and an even number of them "
                          "wanted: frequencies", reference="the full model at other draws")
    model = with_arms(N_ARM)
    row.error(worst(model, on_basis(model, n_mode), n_mode - small_basis.UNSURE), 2 * small_basis.TOLERANCE)


def test_a_basis_that_misses_is_enlarged(monkeypatch, validation):
    row = validation(what="small basis of a model with local modes, from six points instead of 54: frequencies",
                     reference="the full model at other draws")
    monkeypatch.setattr(small_basis, "N_POINT", 6)
    model = with_arms(2 * N_ARM)
    row.error(worst(model, on_basis(model, N_MODE), N_MODE - small_basis.UNSURE), 5 * small_basis.TOLERANCE)
