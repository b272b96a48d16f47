"""Small problems with known answers: a chain that sways in two directions, and a model linear in its parameters."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from probupdate.modal.modes import ModalData, ModalSet
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.affine import AffineModel
from probupdate.structure.functions import FunctionModel
from probupdate.updating.problem import Problem, Weights, build_problem

N_LEVEL = 9
LEVELS = (1, 3, 4, 6, 8)
CHANNELS = tuple(f"{axis}{level}" for axis in "xy" for level in LEVELS)
CHAIN_PARAMETERS = Parameters((
    Parameter(name="base", unit="-", initial=1.0, std=0.5, lower=0.05, upper=6.0),
    Parameter(name="upper", unit="-", initial=1.0, std=0.1, lower=0.3, upper=2.0),
    Parameter(name="top", unit="-", initial=1.0, std=0.05, lower=0.5, upper=2.0),
    Parameter(name="twist", unit="-", initial=0.02, std=0.02, lower=-0.2, upper=0.2),
))
# first and second bending pairs of the chain, away from the initial parameters
CHAIN_TRUTH = np.array([0.7, 1.06, 0.97, 0.035])


def chain_springs(spring: np.ndarray) -> np.ndarray:
    """Stiffness (N_LEVEL, N_LEVEL) of springs to the ground and between successive masses."""
    K = np.diag(spring)
    K[:-1, :-1] += np.diag(spring[1:])
    return K - np.diag(spring[1:], 1) - np.diag(spring[1:], -1)


def chain_model(parameters: Parameters = CHAIN_PARAMETERS, *, asymmetry: float = 0.02) -> AffineModel:
    """Masses on springs, in x and in y (stiffer by `asymmetry`), coupled by `twist`: FA/SS-like close pairs."""
    base, upper, coupling = np.zeros(N_LEVEL), np.zeros(N_LEVEL), np.zeros(N_LEVEL)
    base[:2], upper[2:], coupling[3] = 200.0, 400.0, 400.0
    both = np.diag([1.0, 1.0 + asymmetry])
    swap = np.array([[0.0, 1.0], [1.0, 0.0]])
    top = np.zeros(N_LEVEL)
    top[-1] = 2.0
    terms = {
        "K": (np.kron(both, chain_springs(base)), np.kron(both, chain_springs(upper)),
              np.kron(swap, chain_springs(coupling))),
        "M": (np.eye(2 * N_LEVEL), np.kron(np.eye(2), np.diag(top))),
    }
    dof = [N_LEVEL * axis + level for axis in (0, 1) for level in LEVELS]
    pick = sparse.csr_array((np.ones(len(dof)), (np.arange(len(dof)), dof)), shape=(len(dof), 2 * N_LEVEL))

    def coefficients(theta):
        mass = np.stack([np.ones_like(theta[..., 2]), theta[..., 2]], axis=-1)
        return theta[..., [0, 1, 3]], mass

    return AffineModel(
        name="two-way chain", parameters=parameters, channels=CHANNELS,
        stiffness=tuple(sparse.csc_array(k) for k in terms["K"]), mass=tuple(sparse.csc_array(m) for m in terms["M"]),
        coefficients=coefficients, channel_matrix=pick, hash_key=f"chain {asymmetry!r}",
    )


def modal_set(frequency_hz, shape, *, id="one", std=None, shape_std=None) -> ModalSet:
    frequency_hz, shape = np.asarray(frequency_hz, float), np.asarray(shape)
    return ModalSet(
        id=id, frequency_hz=frequency_hz, shape=shape, damping_ratio=np.full(frequency_hz.size, 0.01),
        frequency_std_hz=0.01 * frequency_hz if std is None else std,
        shape_std=np.full(shape.shape, np.nan) if shape_std is None else shape_std,
    )


def measured_chain(theta=CHAIN_TRUTH, *, n_mode=4, noise=0.0, seed=0, model=None, **options) -> ModalData:
    """Modes of the chain at theta, with a relative noise on frequencies and (tenfold) on shapes of unit maximum."""
    solution = (model or chain_model()).solve(np.asarray(theta, float), n_mode)
    rng = np.random.default_rng(seed)
    shape = solution.shape / np.max(np.abs(solution.shape), axis=0)
    frequency = solution.frequency_hz * (1 + noise * rng.standard_normal(n_mode))
    shape = shape + 10 * noise * rng.standard_normal(shape.shape)
    return ModalData(channels=CHANNELS, sets=(modal_set(frequency, shape, **options),))


def chain_problem(theta=CHAIN_TRUTH, *, weights: Weights | None = None, noise=0.004, seed=3, **options) -> Problem:
    return build_problem(chain_model(), measured_chain(theta, noise=noise, seed=seed, **options), weights=weights)


def turned(shape: np.ndarray, members: tuple[int, int], angle: float) -> np.ndarray:
    """The shapes with two of them rotated into each other, as a close pair's are by chance."""
    c, s = np.cos(angle), np.sin(angle)
    result = np.array(shape)
    result[:, list(members)] = result[:, list(members)] @ np.array([[c, -s], [s, c]])
    return result


# A linear model: frequencies f_0 + A theta far apart, shapes that never change

LINEAR_HZ = np.array([1.0, 2.0, 4.0, 8.0, 16.0])
N_SPARE = 12
SLOPE = np.array([[0.05, 0.02, 0.00], [0.10, -0.04, 0.00], [0.02, 0.20, 0.00], [0.30, 0.10, 0.02], [-0.20, 0.50, 0.01]])
LINEAR_PARAMETERS = Parameters((
    Parameter(name="a", unit="-", initial=1.0, std=0.5),
    Parameter(name="b", unit="-", initial=2.0, std=0.3),
    Parameter(name="c", unit="-", initial=-1.0, std=0.2),
))


def linear_model(parameters: Parameters = LINEAR_PARAMETERS, slope: np.ndarray = SLOPE) -> FunctionModel:
    n = len(LINEAR_HZ) + N_SPARE
    shape = np.linalg.qr(np.random.default_rng(5).standard_normal((n, n)))[0]
    spare = 100.0 * 1.5 ** np.arange(N_SPARE)

    def function(theta):
        return np.concatenate([LINEAR_HZ + slope @ (theta - [1.0, 2.0, -1.0]), spare]), shape

    return FunctionModel(
        name="linear", parameters=parameters, channels=tuple(f"c{k}" for k in range(n)), function=function, version="1"
    )


def linear_data(frequencies: np.ndarray, *, cov: float = 0.01) -> ModalData:
    """Sets of measured frequencies (n_set, 5), NaN for modes not measured; shapes are the model's."""
    model = linear_model()
    shape = model.solve(model.parameters.initial, LINEAR_HZ.size).shape
    sets = []
    for number, row in enumerate(np.atleast_2d(frequencies)):
        here = np.where(np.isfinite(row), shape, np.nan)
        sets.append(modal_set(row, here, id=f"set {number}", std=cov * LINEAR_HZ))
    return ModalData(channels=model.channels, sets=tuple(sets))


def linear_problem(frequency, parameters: Parameters = LINEAR_PARAMETERS, **options) -> Problem:
    return build_problem(linear_model(parameters, **options), linear_data(frequency))


def arviz_psislw():
    """ArviZ's Pareto-smoothed weights of log ratios: (log weights, k), wherever this generation keeps them."""
    try:
        from arviz_stats.base import array_stats
    except ImportError:
        # before 1.0
        from arviz import psislw

        return psislw
    # of a log-likelihood there, whose ratios are its inverses
    return lambda log_ratio: array_stats.psislw(-log_ratio)
