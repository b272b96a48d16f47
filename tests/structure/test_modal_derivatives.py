"""Derivatives of frequencies and shapes: analytic against finite differences, for every parameter and close pairs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg, sparse
from small_turbine import ORDER, small_turbine

from probupdate.errors import InputError
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure import eigen
from probupdate.structure.affine import AffineModel
from probupdate.structure.description_file import parse_description
from probupdate.structure.load import turbine_model
from probupdate.structure.matrices import LinearCoefficients

N_MODE = 6


@pytest.fixture(scope="module")
def turbine():
    return turbine_model(parse_description(small_turbine(), "model.toml"), where="model.toml")


@pytest.fixture(scope="module")
def analytic(turbine):
    return turbine.solve(turbine.parameters.initial, N_MODE, derivatives=True)


def signed(shape, reference):
    # of two equal eigenvalues the other one may come first, at right angles: its sign is then free, but is not zero
    return shape * np.where(np.sum(shape * reference, axis=0) < 0, -1, 1)


def difference(model, theta, k, h, reference, clusters):
    """Fourth-order central difference of frequencies and (signed or turned) shapes."""
    total_f, total_s = 0.0, 0.0
    for step, weight in ((1, 8), (-1, -8), (2, -1), (-2, 1)):
        moved = theta.copy()
        moved[k] += step * h
        solution = model.solve(moved, reference.shape[1])
        shape = signed(solution.shape, reference)
        for cluster in clusters:
            members = list(cluster)
            turn, _ = linalg.orthogonal_procrustes(shape[:, members], reference[:, members])
            shape[:, members] = shape[:, members] @ turn
        total_f = total_f + weight * solution.frequency_hz
        total_s = total_s + weight * shape
    return total_f / (12 * h), total_s / (12 * h)


@pytest.mark.parametrize("name", ORDER)
def test_frequencies_and_shapes_of_the_turbine(turbine, analytic, name, validation):
    row = validation(what="derivatives of frequencies and shapes, each of 17 parameters",
                     reference="fourth-order differences", why="the differences' own error and rounding")
    theta, k = turbine.parameters.initial, turbine.parameters.index(name)
    exact = analytic
    # small against the gap of the closest pair, large against rounding: eigenvalues are good to 1e-12
    h = 3e-3 * turbine.parameters.std[k]
    d_frequency, d_shape = difference(turbine, theta, k, h, exact.shape, ())
    # rounding: 1e-12 of f over the step
    floor = 1e-9 * exact.frequency_hz / turbine.parameters.std[k]
    error = exact.frequency_derivative[:, k] - d_frequency
    row.error(error / (np.abs(d_frequency) + 1e6 * floor), below=1e-6, of="f, and its rounding")
    for j in range(N_MODE):
        scale = np.abs(d_shape[:, j]).max() + 1e-3 * np.abs(exact.shape[:, j]).max() / turbine.parameters.std[k]
        row.error((exact.shape_derivative[:, j, k] - d_shape[:, j]) / scale, below=1e-4, of="shapes")


def chain(gap, n=6):
    """Two equal chains side by side, weakly different by `gap` and coupled by theta: a pair as close as one likes."""
    line = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    K0 = 1e4 * linalg.block_diag(line, line * (1 + gap))
    soft = np.zeros((2 * n, 2 * n))
    soft[:n, :n] = 1e4 * np.diag([1.0] + [0.0] * (n - 1))
    tie = np.zeros((2 * n, 2 * n))
    v = np.zeros(2 * n)
    v[1], v[n + min(3, n - 1)] = 1.0, -1.0
    tie += 3e3 * np.outer(v, v)
    mass = np.eye(2 * n)
    heavy = np.diag(np.r_[np.linspace(0, 1, n), np.linspace(1, 0, n)])
    items = tuple(
        Parameter(name=name, unit="-", initial=value, std=0.1, lower=-0.5, upper=2.0)
        for name, value in (("soft", 0.0), ("tie", 0.0), ("heavy", 0.0))
    )
    return AffineModel(
        name="chains", parameters=Parameters(items), channels=tuple(f"c{i}" for i in range(2 * n)),
        stiffness=tuple(sparse.csc_array(a) for a in (K0, soft, tie)),
        mass=tuple(sparse.csc_array(a) for a in (mass, heavy)), coefficients=LinearCoefficients((0, 1), (2,)),
        channel_matrix=sparse.csr_array(np.eye(2 * n)), hash_key=f"chains {gap}",
    )


PAIRS = ((0, 1), (2, 3))


@pytest.mark.parametrize("gap", [1e-2, 1e-3, 1e-6, 0.0])
def test_close_pairs_down_to_exactly_equal_ones(gap, validation):
    row = validation(what="the same for pairs down to exactly equal ones", reference="differences turned onto the pair",
                     why="the differences' own error")
    model = chain(gap)
    theta = np.zeros(3)
    exact = model.solve(theta, 4, derivatives=True, clusters=PAIRS)
    assert np.all(np.isfinite(exact.shape_derivative))
    h = 1e-4
    for k in range(3):
        _, d_shape = difference(model, theta, k, h, exact.shape, PAIRS)
        scale = np.abs(d_shape).max()
        row.error((exact.shape_derivative[:, :, k] - d_shape) / scale, below=2e-6, of="shapes")
        # trace of the pair's eigenvalues is smooth whatever the gap
        for pair in PAIRS:
            total = 0.0
            for step, weight in ((1, 8), (-1, -8), (2, -1), (-2, 1)):
                moved = theta.copy()
                moved[k] += step * h
                f = model.solve(moved, 4).frequency_hz[list(pair)]
                total += weight * np.sum(f**2) / (12 * h)
            ours = np.sum(2 * exact.frequency_hz[list(pair)] * exact.frequency_derivative[list(pair), k])
            row.error((ours - total) / max(abs(total), exact.frequency_hz[pair[0]]), below=1e-7, of="eigenvalues' sums")


@pytest.mark.parametrize("gap", [1e-2, 1e-3])
def test_single_derivatives_of_a_pair_that_is_merely_close(gap):
    model = chain(gap)
    theta = np.zeros(3)
    exact = model.solve(theta, 4, derivatives=True)
    for k in range(3):
        d_frequency, d_shape = difference(model, theta, k, 2e-3 * gap, exact.shape, ())
        assert exact.frequency_derivative[:, k] == pytest.approx(d_frequency, rel=1e-6, abs=1e-6)
        assert np.abs(exact.shape_derivative[:, :, k] - d_shape).max() < 2e-4 * np.abs(d_shape).max()


def test_a_cluster_leaves_out_the_rotation_and_nothing_else():
    model = chain(1e-3)
    plain, paired = (model.solve(np.zeros(3), 4, derivatives=True, clusters=c) for c in ((), PAIRS))
    assert paired.frequency_derivative == pytest.approx(plain.frequency_derivative, rel=1e-9)
    for pair in PAIRS:
        shape = paired.shape[:, list(pair)]
        gap = (plain.shape_derivative - paired.shape_derivative)[:, list(pair), 1]
        # the tie turns the pair fast: what the cluster leaves out is large and is a rotation of the pair
        turn = shape.T @ gap
        assert np.linalg.norm(shape @ turn - gap) < 1e-8 * np.linalg.norm(gap)
        assert turn + turn.T == pytest.approx(np.zeros((2, 2)), abs=1e-8 * np.abs(turn).max())
        assert np.abs(turn).max() > 1.0
        assert np.abs(paired.shape_derivative[:, list(pair), 1]).max() < 0.3 * np.abs(gap).max()


def test_degenerate_frame_turns_as_a_plane():
    """A symmetric turbine: the sway pair has no shapes of its own, but its plane and the derivative of it."""
    raw = small_turbine()
    for body in raw["rna"]:
        body |= {"offset_m": [0.0, 0.0, body["offset_m"][2]], "inertia_kgm2": [1e6, 1e6, 1e6]}
    for entry in raw["parameter"]:
        entry["update"] = entry["name"] in ("k_t", "k_j", "py")
    model = turbine_model(parse_description(raw, "model.toml"), where="model.toml")
    theta = model.parameters.initial
    exact = model.solve(theta, 4, derivatives=True, clusters=((0, 1), (2, 3)) if _pair(model, 2) else ((0, 1),))
    assert _pair(model, 0)
    for k in range(3):
        d_frequency, d_shape = difference(model, theta, k, 1e-4, exact.shape, ((0, 1),))
        assert exact.frequency_derivative[:2, k] == pytest.approx(d_frequency[:2], rel=1e-6)
        # which two shapes the solver takes in the plane is chance, and so how the two ways turn them along
        shape, gap = exact.shape[:, :2], exact.shape_derivative[:, :2, k] - d_shape[:, :2]
        turn = np.linalg.lstsq(shape, gap, rcond=None)[0]
        limit = 1e-5 * np.abs(d_shape).max()
        assert np.abs(gap - shape @ turn).max() < limit
        assert np.abs(shape @ (turn + turn.T)).max() < limit


def _pair(model, j):
    f = model.solve(model.parameters.initial, 4).frequency_hz
    return f[j + 1] / f[j] - 1 < 1e-9


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(4, 12))
def test_random_pencils(seed, n):
    """Mass-orthonormal modes, derivative of phi^T M phi = 1, dense against Lanczos, for random SPD pencils."""
    rng = np.random.default_rng(seed)

    def spd():
        a = rng.standard_normal((n, n))
        return a @ a.T + 0.5 * np.eye(n)

    K, dK, M = spd(), spd(), spd()
    items = (Parameter(name="a", unit="-", initial=0.3, std=0.1, lower=0.0, upper=1.0),)
    model = AffineModel(
        name="random", parameters=Parameters(items), channels=tuple(map(str, range(n))),
        stiffness=(sparse.csc_array(K), sparse.csc_array(dK)), mass=(sparse.csc_array(M), sparse.csc_array(0.1 * dK)),
        coefficients=LinearCoefficients((0,), (0,)), channel_matrix=sparse.csr_array(np.eye(n)), hash_key=str(seed),
    )
    solution = model.solve(np.array([0.3]), 2, derivatives=True)
    total_K, total_M = K + 0.3 * dK, M + 0.03 * dK
    value = linalg.eigh(total_K, total_M, eigvals_only=True)[:2]
    assert (2 * np.pi * solution.frequency_hz) ** 2 == pytest.approx(value, rel=1e-9)
    phi, d_phi = solution.shape, solution.shape_derivative[:, :, 0]
    assert phi.T @ total_M @ phi == pytest.approx(np.eye(2), abs=1e-9)
    change = 2 * np.einsum("ij,ij->j", phi, total_M @ d_phi) + np.einsum("ij,ij->j", phi, 0.1 * dK @ phi)
    assert change == pytest.approx(np.zeros(2), abs=1e-8 * (1 + np.abs(d_phi).max()))


@pytest.mark.parametrize(
    ("theta", "problem"),
    [([-1.8, 0.0, 0.0], "the stiffness matrix is not positive definite"), ([0.0, 0.0], r"theta has shape \(2,\)"),
     ([np.nan, 0.0, 0.0], "theta is not finite")],
)
def test_errors_name_the_model_and_the_values(theta, problem):
    with pytest.raises(InputError, match=problem) as caught:
        chain(1e-3, n=2).solve(np.array(theta), 1)
    assert "chains" in str(caught.value)
    if "positive" in problem:
        assert "soft=-1.8" in str(caught.value)


def test_too_many_modes():
    with pytest.raises(InputError, match="5 modes asked of 4 degrees of freedom"):
        chain(1e-3, n=2).solve(np.zeros(3), 5)


def test_mechanism_is_said():
    free = sparse.csc_array(np.array([[1.0, -1, 0, 0], [-1, 1, 0, 0], [0, 0, 1, -1], [0, 0, -1, 1]]))
    items = (Parameter(name="a", unit="-", initial=1.0, std=0.1),)
    model = AffineModel(
        name="free", parameters=Parameters(items), channels=("x",), stiffness=(sparse.csc_array((4, 4)), free),
        mass=(sparse.csc_array(np.eye(4)),), coefficients=LinearCoefficients((0,), ()),
        channel_matrix=sparse.csr_array(np.eye(1, 4)), hash_key="free",
    )
    with pytest.raises(InputError, match="mechanism"):
        model.solve(np.array([1.0]), 1)


def test_solve_many_is_solve_row_by_row(turbine):
    rng = np.random.default_rng(3)
    theta = turbine.parameters.initial + 0.2 * turbine.parameters.std * rng.standard_normal((3, 17))
    many = turbine.solve_many(theta, 4)
    assert not many.fallback.any()
    for row, values in enumerate(theta):
        single = turbine.solve(values, 4)
        assert np.array_equal(many.frequency_hz[row], single.frequency_hz)
        assert np.array_equal(many.shape[row], single.shape)


@pytest.mark.parametrize("clusters", [(), ((0, 1), (3, 4))])
def test_derivatives_by_three_factorisations(turbine, monkeypatch, clusters, validation):
    """Beside the eigenvalue, bordered and pivoted, and bordered of full matrices."""
    row = validation(what="derivatives by a factorisation beside the eigenvalue, and of full matrices",
                     reference="bordered, pivoted", why="rounding times condition")
    K, M = turbine.matrices(turbine.parameters.initial)
    value, phi = turbine.solve_full(turbine.parameters.initial, N_MODE)
    rng = np.random.default_rng(0)
    dK, dM = (rng.uniform(0.5, 1.5, (len(phi), 1, 3)) * (A @ phi)[..., None] for A in (K, M))
    options = (value, phi, dK, dM, clusters)
    quick = eigen.mode_derivatives(K, M, *options)
    full = eigen.mode_derivatives(K.toarray(), M.toarray(), *options)
    monkeypatch.setattr(eigen, "_solve_deflated", lambda *_: None)
    bordered = eigen.mode_derivatives(K, M, *options)
    size = np.abs(bordered[1]).max(axis=0)
    # rounding times the condition of the equations, and a mate 1 % off adds a hundredfold
    for other in (quick, full):
        row.error(other[0] / bordered[0] - 1, below=1e-12, of="eigenvalues")
        row.error((other[1] - bordered[1]) / size, below=1e-7, of="shapes")
    assert np.max(np.abs(quick[1] - bordered[1]) / size) > 0


def test_an_answer_that_is_remembered_is_the_one_computed():
    """Values where derivatives are asked next, and again after others have pushed them out."""
    model = turbine_model(parse_description(small_turbine(), "model.toml"), where="model.toml")
    fresh = turbine_model(parse_description(small_turbine(), "model.toml"), where="model.toml")
    theta = model.parameters.initial
    first = model.solve(theta, N_MODE)
    after = model.solve(theta, N_MODE, derivatives=True)
    plain = fresh.solve(theta, N_MODE, derivatives=True)
    np.testing.assert_array_equal(first.frequency_hz, after.frequency_hz)
    np.testing.assert_array_equal(after.shape_derivative, plain.shape_derivative)
    turned = model.solve(theta, N_MODE, derivatives=True, clusters=((0, 1),))
    assert np.max(np.abs(turned.shape_derivative - after.shape_derivative)) > 0
    assert model.solve(theta, N_MODE - 1).frequency_hz.size == N_MODE - 1
    with pytest.raises(ValueError, match="read-only"):
        model.solve_full(theta, N_MODE)[1][0] = 0
