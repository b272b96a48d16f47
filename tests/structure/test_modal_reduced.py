"""The reduced basis against the full model on points that took no part in building it, and outside its box."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import linalg, sparse
from small_turbine import small_turbine

from probupdate.errors import ConvergenceError, InputError
from probupdate.modal.modes import plane_mac
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.affine import AffineModel
from probupdate.structure.description_file import parse_description
from probupdate.structure.load import turbine_model
from probupdate.structure.matrices import LinearCoefficients, load_matrices
from probupdate.structure.parameter_table import read_parameters
from probupdate.structure.reduced import clusters_of, reduce_basis

REPOSITORY = Path(__file__).resolve().parents[2]
BRIDGE = REPOSITORY.parent / "shared" / "data" / "footbridge"
UPDATED = ("k_j", "k_t", "k_TP", "LJF", "m_h", "py", "tz")
N_MODE = 6


@pytest.fixture(scope="module")
def full():
    raw = small_turbine()
    for entry in raw["parameter"]:
        entry["update"] = entry["name"] in UPDATED
    return turbine_model(parse_description(raw, "model.toml"), where="model.toml")


@pytest.fixture(scope="module")
def cloud(full):
    """Draws of a posterior that knows the tower well and the soil badly, in logarithms."""
    spread = np.array([0.03, 0.02, 0.3, 0.4, 0.02, 0.5, 0.5])
    return full.parameters.initial * np.exp(spread * np.random.default_rng(5).standard_normal((600, 7)))


@pytest.fixture(scope="module")
def reduced(full, cloud):
    box = (cloud.min(axis=0), cloud.max(axis=0))
    return reduce_basis(full, n_mode=N_MODE, box=box, frequency_tolerance=1e-5, points=cloud, n_snapshot=64,
                        n_verify=48)


def compare(reduced, full, theta, n_mode):
    """Largest relative frequency error (n,) and least plane MAC of clusters that are not cut."""
    fast, error, least = reduced.solve_many(theta, n_mode), [], 1.0
    for row, values in enumerate(theta):
        exact = full.solve(values, n_mode + 1)
        error.append(np.abs(fast.frequency_hz[row] / exact.frequency_hz[:n_mode] - 1).max())
        for group in clusters_of(exact.frequency_hz):
            if group[-1] < n_mode:
                least = min(least, plane_mac(fast.shape[row][:, group], exact.shape[:, group]))
    return np.array(error), least


def test_a_mesh_is_where_its_nodes_are():
    """Models of as many degrees of freedom are of one mesh where the nacelle looks elsewhere, not where legs stand
    elsewhere; of matrices without places where the same degrees of freedom are joined."""
    raw, wider = small_turbine(), small_turbine()
    wider["jacket"]["bottom"]["leg_spacing_m"] *= 1.05
    here, turned, other = (
        turbine_model(parse_description(one, "model.toml"), where="model.toml", turn_deg=angle)
        for one, angle in ((raw, 0.0), (raw, 65.0), (wider, 0.0)))
    assert here.n_dof == turned.n_dof == other.n_dof
    assert here.mesh == turned.mesh != other.mesh
    plain = replace(here, places=None)
    assert plain.mesh == replace(plain, mass=tuple(2 * m for m in plain.mass)).mesh
    order = np.random.default_rng(1).permutation(plain.n_dof)
    exchanged = tuple(sparse.csc_array(K[order][:, order]) for K in plain.stiffness)
    assert plain.mesh != replace(plain, stiffness=exchanged).mesh


def test_report_keeps_the_promise(reduced):
    report = reduced.report
    assert report.max_frequency_error <= 1e-5 and report.max_box_error <= 1e-4 and report.min_mac >= 0.9999
    assert report.size == reduced.basis.shape[1] < reduced.full.n_dof / 4
    assert report.n_verify == 48 and report.frequency_tolerance == 1e-5


def test_likely_points_not_used_in_building(reduced, full, cloud, validation):
    row = validation(what="reduced basis where the posterior lies, 60 unseen points of a small turbine",
                     reference="full model", why="what is promised")
    rng = np.random.default_rng(77)
    theta = cloud[rng.integers(len(cloud), size=60)]
    # between the draws, as a sampler moves
    theta = theta + 0.5 * (cloud[rng.integers(len(cloud), size=60)] - theta)
    error, least_mac = compare(reduced, full, theta, N_MODE)
    row.error(error, below=1e-5, of="frequency")
    row.least(least_mac, above=0.9999, of="MAC")
    assert not reduced.solve_many(theta, N_MODE).fallback.any()


def test_prior_box_without_a_cloud(full, validation):
    row = validation(what="reduced basis over three prior standard deviations, 40 unseen points",
                     reference="full model", why="what is promised")
    parameters = full.parameters
    box = (np.maximum(parameters.lower, parameters.initial - 3 * parameters.std),
           np.minimum(parameters.upper, parameters.initial + 3 * parameters.std))
    found = reduce_basis(full, n_mode=N_MODE, box=box, frequency_tolerance=1e-4, n_snapshot=48, n_verify=32)
    theta = box[0] + (box[1] - box[0]) * np.random.default_rng(8).random((40, 7))
    error, least_mac = compare(found, full, theta, N_MODE)
    row.error(error, below=1e-4, of="frequency")
    row.least(least_mac, above=0.9999, of="MAC")


def test_outside_the_box_the_full_model_answers_and_is_flagged(reduced, full, cloud):
    theta = cloud[:5].copy()
    theta[1, 0], theta[3, 5] = reduced.upper[0] * 1.01, reduced.lower[5] * 0.99
    many = reduced.solve_many(theta, N_MODE)
    assert many.fallback.tolist() == [False, True, False, True, False]
    for row in (1, 3):
        exact = full.solve(theta[row], N_MODE)
        assert np.array_equal(many.frequency_hz[row], exact.frequency_hz)
        assert np.array_equal(many.shape[row], exact.shape)
        assert np.array_equal(reduced.solve(theta[row], N_MODE).frequency_hz, exact.frequency_hz)


def test_shapes_have_unit_modal_mass(reduced, full, cloud):
    fast, exact = reduced.solve_many(cloud[:3], N_MODE), full.solve_many(cloud[:3], N_MODE)
    top = slice(7, 9)
    # both sway modes together: their plane does not depend on how a close pair is turned
    motion = [np.linalg.norm(s.shape[:, top, :2], axis=(1, 2)) for s in (fast, exact)]
    assert motion[0] == pytest.approx(motion[1], rel=1e-4)


def test_one_answer_many_answers_and_fewer_modes_agree(reduced, cloud):
    many = reduced.solve_many(cloud[:70], N_MODE)
    few = reduced.solve_many(cloud[:70], 3)
    assert few.frequency_hz == pytest.approx(many.frequency_hz[:, :3], rel=1e-9)
    for row in (0, 69):
        single = reduced.solve(cloud[row], N_MODE)
        assert single.frequency_hz == pytest.approx(many.frequency_hz[row], rel=1e-8)
        assert np.abs(single.shape) == pytest.approx(np.abs(many.shape[row]), rel=1e-4, abs=1e-7)


def test_derivatives_of_the_reduced_model(reduced, full, cloud):
    theta = np.median(cloud, axis=0)
    clusters = ((0, 1),)
    fast, exact = (m.solve(theta, 4, derivatives=True, clusters=clusters) for m in (reduced, full))
    scale = full.parameters.std
    assert fast.frequency_derivative * scale == pytest.approx(
        exact.frequency_derivative * scale, abs=1e-4 * np.abs(exact.frequency_derivative * scale).max())


def test_blocks_of_a_symmetric_structure_do_not_couple(reduced):
    assert len(reduced.blocks) >= 2
    rows = np.concatenate([block.rows for block in reduced.blocks])
    assert sorted(rows) == list(range(reduced.basis.shape[1]))
    for terms in (reduced.full.stiffness, reduced.full.mass):
        for term in terms:
            whole = reduced.basis.T @ (term @ reduced.basis)
            for block in reduced.blocks:
                others = np.setdiff1d(rows, block.rows)
                assert np.abs(whole[np.ix_(block.rows, others)]).max() < 1e-5 * np.abs(whole).max()


def test_same_seed_same_basis_and_the_full_models_fingerprint(reduced, full, cloud):
    box = (cloud.min(axis=0), cloud.max(axis=0))
    again = reduce_basis(full, n_mode=N_MODE, box=box, frequency_tolerance=1e-5, points=cloud, n_snapshot=64,
                         n_verify=48)
    assert np.array_equal(again.basis, reduced.basis)
    assert np.array_equal(again.solve_many(cloud[:4], N_MODE).shape, reduced.solve_many(cloud[:4], N_MODE).shape)
    assert reduced.fingerprint() == full.fingerprint()
    assert (reduced.name, reduced.channels) == (full.name, full.channels)
    assert reduced.derived["k_z"](cloud[0]) == full.derived["k_z"](cloud[0])
    assert reduced.wireframe(cloud[0], 1).displacement.shape[2] == 1


def test_more_modes_than_built_for(reduced, cloud):
    with pytest.raises(InputError, match="7 modes asked of a basis for 6; build it for more modes"):
        reduced.solve_many(cloud[:2], 7)
    assert reduced.solve(cloud[0], 7).frequency_hz.shape == (7,)


def test_box_without_room(full):
    low = full.parameters.lower
    for box in ((low, low), (low, np.full(7, np.inf)), (low[:3], low[:3] + 1)):
        with pytest.raises(InputError, match="the box is empty or unbounded"):
            reduce_basis(full, n_mode=2, box=box, frequency_tolerance=1e-3)


def test_a_basis_that_is_too_small_says_so_and_is_handed_over(full, cloud):
    box = (cloud.min(axis=0), cloud.max(axis=0))
    with pytest.raises(ConvergenceError, match="a basis of 10 vectors leaves a relative frequency error of") as caught:
        reduce_basis(full, n_mode=4, box=box, frequency_tolerance=1e-7, n_snapshot=8, n_verify=4, max_size=10)
    assert caught.value.estimate.basis.shape[1] == 10


def test_progress_is_reported(full, cloud):
    seen = []
    box = (cloud.min(axis=0), cloud.max(axis=0))
    reduce_basis(full, n_mode=2, box=box, frequency_tolerance=1e-2, n_snapshot=8, n_verify=4,
                 progress=lambda what, done, total: seen.append((what, done, total)))
    assert seen[7] == ("reduced basis: snapshots", 8, 8)
    assert any("verification" in what and done == total for what, done, total in seen)


def crossing():
    """Two chains that do not couple: the second softens with theta, so that its modes pass those of the first."""
    n = 12
    line = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    zero = np.zeros((n, n))
    items = (Parameter(name="first", unit="-", initial=1.0, std=0.2, lower=0.5, upper=2.0),
             Parameter(name="second", unit="-", initial=1.0, std=0.5, lower=0.25, upper=2.0))
    return AffineModel(
        name="two chains", parameters=Parameters(items), channels=tuple(f"c{i}" for i in range(2 * n)),
        stiffness=tuple(sparse.csc_array(linalg.block_diag(*a)) for a in ((zero, zero), (line, zero), (zero, line))),
        mass=(sparse.csc_array(np.eye(2 * n)),), coefficients=LinearCoefficients((0, 1), ()),
        channel_matrix=sparse.csr_array(np.eye(2 * n)), hash_key="two chains",
    )


def test_modes_that_cross_are_not_missed():
    """One of the lowest four modes is the first chain's where the second is soft, three where it is stiff. Every shape
    is constant here, so that the basis is exact, at the box's corners too."""
    model = crossing()
    found = reduce_basis(model, n_mode=4, box=(np.array([0.5, 0.25]), np.array([2.0, 2.0])), frequency_tolerance=1e-9,
                         n_snapshot=64, n_verify=16)
    assert len(found.blocks) >= 2
    rng = np.random.default_rng(0)
    theta = found.lower + (found.upper - found.lower) * rng.random((200, 2))
    theta[:2] = [[2.0, 0.25], [0.5, 2.0]]
    exact = model.solve_many(theta, 4).frequency_hz
    # a block that was not asked for enough modes is asked again
    found = replace(found, blocks=tuple(replace(block, n_mode=1) for block in found.blocks))
    assert found.solve_many(theta, 4).frequency_hz == pytest.approx(exact, rel=1e-9)


@pytest.mark.skipif(not BRIDGE.exists(), reason="the pedestrian bridge's data are not beside the repository")
def test_pedestrian_bridge_with_its_soft_deck(validation):
    row = validation(what="reduced basis of the footbridge, 17 parameters, 20 unseen points", reference="full model",
                     why="what is promised")
    parameters = read_parameters(REPOSITORY / "studies" / "footbridge" / "parameters.toml")
    model = load_matrices(BRIDGE / "model.npz", parameters)
    # a posterior's width: half of each prior standard deviation
    low, high = (np.clip(parameters.initial + s * 0.5 * parameters.std, parameters.lower, parameters.upper)
                 for s in (-1, 1))
    found = reduce_basis(model, n_mode=6, box=(low, high), frequency_tolerance=1e-4, n_snapshot=48, n_verify=24)
    theta = low + (high - low) * np.random.default_rng(2).random((20, 17))
    error, least_mac = compare(found, model, theta, 6)
    row.error(error, below=1e-4, of="frequency")
    row.least(least_mac, above=0.9999, of="MAC")
