"""Errors of the model that mix its modes: against drawn structures and dense Gaussians, and what intervals hold."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg, sparse, special, stats

from probupdate.modal.modes import ModalData, ModalSet
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.affine import AffineModel
from probupdate.updating.discrepancy import estimate_discrepancy
from probupdate.updating.laplace import maximum_a_posteriori
from probupdate.updating.problem import Weights, build_problem
from probupdate.updating.set_likelihoods import coordinates_of
from probupdate.updating.shared_error import Scales, shared_error, total

N_STOREY, N_MODE, SENSORS = 12, 4, [0, 2, 4, 5, 7, 9, 11]
GROUPS = (slice(0, 3), slice(3, 7), slice(7, 12))
STIFFNESS = 1000.0
PARAMETERS = Parameters(tuple(Parameter(name=n, unit="-", initial=1.0, std=0.3, lower=0.1, upper=4.0) for n in "abc"))
STATED = Weights(least_shape_std=1e-3)
IDENTIFIED, IDENTIFIED_SHAPE = 1e-3, 5e-3


def springs(k: np.ndarray) -> np.ndarray:
    """Stiffness of storeys (n,) over one another."""
    K = np.diag(k)
    K[:-1, :-1] += np.diag(k[1:])
    return K - np.diag(k[1:], 1) - np.diag(k[1:], -1)


def building() -> AffineModel:
    """Three parameters scale the stiffness of three groups of storeys."""
    terms = []
    for group in GROUPS:
        k = np.zeros(N_STOREY)
        k[group] = STIFFNESS
        terms.append(sparse.csc_array(springs(k)))
    pick = sparse.csr_array((np.ones(len(SENSORS)), (np.arange(len(SENSORS)), SENSORS)),
                            shape=(len(SENSORS), N_STOREY))
    return AffineModel(
        name="building", parameters=PARAMETERS, channels=tuple(f"s{k}" for k in SENSORS), stiffness=tuple(terms),
        mass=(sparse.csc_array(np.eye(N_STOREY)),), channel_matrix=pick, hash_key="building",
        coefficients=lambda theta: (theta, np.ones((*theta.shape[:-1], 1))))


def modes_with_errors(theta, rng: np.random.Generator, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies in Hz and shapes at all storeys where every storey's stiffness and mass is off by `size` on its own.
    """
    k = np.empty(N_STOREY)
    for value, group in zip(theta, GROUPS, strict=True):
        k[group] = STIFFNESS * value
    k, m = k * np.exp(size * rng.standard_normal(N_STOREY)), np.exp(size * rng.standard_normal(N_STOREY))
    value, shape = linalg.eigh(springs(k), np.diag(m))
    return np.sqrt(value[:N_MODE]) / (2 * np.pi), shape[:, :N_MODE]


def measured(theta, seed, size: float) -> ModalData:
    rng = np.random.default_rng(seed)
    f, shape = modes_with_errors(theta, rng, size)
    shape = shape[SENSORS] / np.abs(shape[SENSORS]).max(axis=0)
    f = f * (1 + IDENTIFIED * rng.standard_normal(N_MODE))
    shape = shape + IDENTIFIED_SHAPE * rng.standard_normal(shape.shape)
    return ModalData(channels=building().channels, sets=(ModalSet(
        id="one", frequency_hz=f, damping_ratio=np.full(N_MODE, 0.01), shape=shape, frequency_std_hz=IDENTIFIED * f,
        shape_std=np.full(shape.shape, IDENTIFIED_SHAPE)),))


def test_local_errors_of_stiffness_and_mass_mix_modes_by_as_much(validation):
    """Frequencies and shapes of 300 drawn buildings: one size explains both, to the accuracy of the ratios of sin^4 to
    sin^2 sin^2 from which it comes, as storeys are few."""
    row = validation(what="shapes' scatter by mixing of modes, its size from frequencies' scatter",
                     reference="300 drawn buildings", why="ratios of a uniform member's waves", unit="ratio less one")
    theta = np.array([1.0, 1.2, 0.8])
    problem = build_problem(building(), measured(theta, 1, 0.0), weights=replace(STATED, mixing=1.0))
    problem = problem.with_mixing(theta)
    rng = np.random.default_rng(3)
    right = modes_with_errors(theta, rng, 0.0)
    frequency, moved = [], []
    for _ in range(300):
        f, shape = modes_with_errors(theta, rng, 0.01)
        scaled = shape[SENSORS] * np.sum(shape[SENSORS] * right[1][SENSORS], axis=0) / np.sum(shape[SENSORS]**2, axis=0)
        frequency.append(f / right[0] - 1)
        moved.append((scaled - right[1][SENSORS]) / np.abs(right[1][SENSORS]).max(axis=0))
    size = np.sqrt(np.mean(np.square(frequency))) / (0.5 * np.sqrt(3))
    said = size * np.sqrt(np.sum(problem.mixing[N_MODE:] ** 2, axis=1)).reshape(N_MODE, len(SENSORS))
    drawn = np.sqrt(np.mean(np.square(moved), axis=0)).T
    row.error(np.sqrt(np.mean(said**2, axis=1) / np.mean(drawn**2, axis=1)) - 1, below=0.2)


def test_the_likelihood_is_the_dense_gaussian_averaged_over_nodes(validation):
    row = validation(what="likelihood with mixing of modes, averaged over its size", reference="dense Gaussians",
                     why="rounding", unit="nat")
    data = measured([1.1, 0.9, 1.0], 2, 0.02)
    nodes = ((0.002, 0.004, 0.01, -1.0), (0.001, 0.002, 0.03, -0.5))
    problem = build_problem(building(), data, weights=replace(STATED, discrepancy=0.001, mixing=0.02, scales=nodes))
    theta = np.array([[1.0, 1.0, 1.0], [1.1, 0.95, 1.02]])
    own, _ = problem.own_variance
    each = []
    for f, s, m, weight in nodes:
        unit = problem.by_kind((f, s)) * problem.unit_discrepancy
        covariance = np.diag(own + unit**2) + m**2 * problem.mixing @ problem.mixing.T
        # aligning shapes takes part of their residuals
        taken = (1 - problem.kept_shares) @ np.log(np.sqrt(own + unit**2) / problem.std)
        each.append([weight + taken + stats.multivariate_normal.logpdf(problem.measured, problem.predict(t), covariance)
                     for t in theta])
    row.error(problem.log_likelihood(theta) - special.logsumexp(each, axis=0), below=1e-8)


@pytest.mark.parametrize("mixing", [0.0, 0.02])
def test_modes_that_all_sets_mix_alike_are_a_block_of_ones(validation, mixing):
    """Three sets, one without the second mode, with errors new and shared: the stacked dense Gaussian."""
    row = validation(what="mixing of modes that sets share: ln p of one posterior for all",
                     reference="stacked dense Gaussian", why="rounding", unit="nat")
    sets = [measured([1.1, 0.9, 1.0], k, 0.02).sets[0] for k in range(3)]
    gone = [np.where(np.arange(N_MODE) == 1, np.nan, x) for x in (sets[1].frequency_hz, sets[1].shape)]
    sets[1] = replace(sets[1], frequency_hz=gone[0], shape=gone[1])
    data = ModalData(channels=building().channels, sets=tuple(replace(s, id=str(k)) for k, s in enumerate(sets)))
    weights = replace(STATED, mixing=1.0, at=(1.0, 1.0, 1.0))
    single = [(j,) for j in range(N_MODE)]
    problems = [build_problem(building(), data, set_id=s.id, weights=weights, clusters=single) for s in data.sets]
    coordinates, theta = coordinates_of(PARAMETERS), np.array([1.05, 0.95, 1.0])
    error = shared_error(problems, np.tile(theta, (3, 1)), coordinates)
    scales = Scales(new=(0.002, 0.003), shared=(0.004, 0.006, mixing))
    found = error.likelihoods(total(error.each(scales.new)), [scales]).evaluate(coordinates.transform(theta)[None])[0]
    std = error.common_std(np.array([scales.shared]))[0]
    B = np.vstack([e * std for e in error.effect])
    quiet = [p.noise_alone(scales.new) for p in problems]
    covariance = B @ B.T + np.diag(np.concatenate([p.std**2 for p in quiet]))
    r = np.concatenate([p.measured - p.predict(theta) for p in problems])
    taken = sum(q.taken_by_alignment - p.taken_by_alignment for p, q in zip(problems, quiet, strict=True))
    row.error(found - taken - stats.multivariate_normal.logpdf(r, np.zeros(len(r)), covariance), below=1e-7)
    # a mode that one set lacks mixes with the same numbers in the others
    assert len(error.kind) == error.effect[0].shape[1] and np.sum(error.kind == 3) == len(problems[0].mixed_pairs)


def test_intervals_hold_where_every_storey_is_off_by_some_percent(validation):
    """Twelve buildings whose storeys' stiffnesses and masses are 2 % off: 90 % intervals of three parameters. With
    errors that are independent from component to component they hold 63 %."""
    row = validation(what="storeys off by 2 % each: 90 % intervals of three parameters, 12 buildings", reference="0.9",
                     unit="standard errors of the share")
    inside = []
    for seed in range(12):
        theta = np.exp(0.2 * np.random.default_rng([seed, 7]).standard_normal(3))
        data = measured(theta, [seed, 8], 0.02)
        weights = estimate_discrepancy(building(), data, weights=STATED)
        found = maximum_a_posteriori(build_problem(building(), data, weights=weights), [PARAMETERS.initial])
        inside += list(np.abs(found.theta - theta) < 1.645 * np.sqrt(np.diag(found.covariance)))
    # parameters of one building go together: twelve times one of them
    row.error((np.mean(inside) - 0.9) / np.sqrt(0.9 * 0.1 / 12), below=2.5)
    assert "% of stiffness" in weights.description
