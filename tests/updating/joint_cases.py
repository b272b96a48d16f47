"""Drawn farms on a model linear in its parameters, and their posterior by one dense joint Gaussian."""

from __future__ import annotations

import numpy as np
from scipy import linalg
from updating_cases import modal_set

from probupdate.modal.modes import ModalData
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.functions import FunctionModel
from probupdate.updating.joint_inference import TurbineSets
from probupdate.updating.problem import Weights, build_problem

HZ = np.array([1.0, 2.0, 4.0, 8.0, 16.0, 32.0])
SLOPE = HZ[:, None] * np.array([[0.02, 0.03, 0.01], [0.03, -0.01, 0.02], [0.01, 0.02, -0.03], [0.04, 0.01, 0.01],
                                [-0.01, 0.03, 0.02], [0.02, -0.02, 0.03]])
STD, SHARED, NEW = 0.004 * HZ, 0.5, 0.01
PARAMETERS = Parameters(tuple(Parameter(name=n, unit="-", initial=0.0, std=s) for n, s in
                              (("steel", 1.0), ("soil", 1.5), ("scour", 0.8))))
ROLES = {"common": ("steel",), "varying": ("soil",)}
N_SPARE = 12


def linear_model(parameters: Parameters = PARAMETERS, bend: float = 0.0) -> FunctionModel:
    """Frequencies HZ + SLOPE theta, and `bend` times HZ theta_1^2; shapes that never change."""
    n = len(HZ) + N_SPARE
    shape = np.linalg.qr(np.random.default_rng(5).standard_normal((n, n)))[0]

    def function(theta):
        own = HZ + SLOPE @ theta + bend * HZ * theta[1] ** 2
        return np.concatenate([own, 100.0 * 1.5 ** np.arange(N_SPARE)]), shape

    return FunctionModel(name="linear", parameters=parameters, channels=tuple(f"c{k}" for k in range(n)),
                         function=function, version=str(bend))


def drawn_farm(n_turbine: int, n_set: int, seed: int, *, tau=0.4, bend=0.0, shift=0.0, wrong=0.0, noise=1.0):
    """y (n_turbine, n_set, 6) and the truth (n_turbine, 3); turbine 0's soil is off by `shift`; `wrong`: standard
    deviation of the error that all have in common, a share of each frequency."""
    rng = np.random.default_rng(seed)
    truth = np.column_stack([np.full(n_turbine, rng.normal(0, 1.0)),
                             rng.normal(0, 1.5) + tau * rng.standard_normal(n_turbine),
                             0.8 * rng.standard_normal(n_turbine)])
    truth[0, 1] += shift
    exact = HZ + truth @ SLOPE.T + bend * HZ * truth[:, 1:2] ** 2 + wrong * HZ * rng.standard_normal(6)
    return exact[:, None] + noise * STD * rng.standard_normal((n_turbine, n_set, 6)), truth


def farm_problems(y: np.ndarray, *, weights: Weights | None = None, model=None, noise=1.0) -> list[TurbineSets]:
    """As the inference takes them, about the prior's centre."""
    model = linear_model() if model is None else model
    shape = model.solve(np.zeros(3), 6).shape
    found = []
    for i, rows in enumerate(y):
        data = ModalData(channels=model.channels, sets=tuple(
            modal_set(row, shape, id=f"{i}-{k}", std=noise * STD) for k, row in enumerate(rows)))
        problems = tuple(build_problem(model, data, set_id=s.id, weights=weights or Weights(shapes="none"),
                                       clusters=[(j,) for j in range(6)]) for s in data.sets)
        found.append(TurbineSets(name=f"T{i}", month="1", problems=problems,
                                 theta=np.zeros(3)))
    return found


def dense(y: np.ndarray, tau: float, shared_std: np.ndarray, new_std: np.ndarray, odd=None):
    """Mean and covariance of (steel, mu, soil_i, scour_i), ln p(y | tau): everything stacked, nothing eliminated. One
    error of standard deviation shared_std (6,) for all turbines, new_std (6,) or (n, m, 6) in each set.
    odd (turbine, 0 or 1): its steel or soil is off by a normal as wide as the prior."""
    n, m, _ = y.shape
    size = 2 + 2 * n
    prior = np.zeros((size, size))
    prior[0, 0], prior[1, 1] = 1.0, 1.5**2
    soil, scour = np.arange(2, 2 + n), np.arange(2 + n, 2 + 2 * n)
    prior[1, soil] = prior[soil, 1] = 1.5**2
    prior[np.ix_(soil, soil)] = 1.5**2 + tau**2 * np.eye(n)
    prior[scour, scour] = 0.8**2
    A = np.zeros((n, m, 6, size))
    for i in range(n):
        A[i, :, :, 0], A[i, :, :, soil[i]], A[i, :, :, scour[i]] = SLOPE.T[:, None]
    A = A.reshape(-1, size)
    C = np.tile(np.diag(shared_std**2), (n * m, n * m)) + np.diag((np.ones((n, m, 1)) * new_std).ravel() ** 2)
    S = A @ prior @ A.T + C
    residual = (y - HZ).ravel()
    if odd is not None:
        i, k = odd
        rows = np.repeat(np.arange(n) == i, m)[:, None] * (SLOPE[:, k] * (1.0, 1.5)[k])
        S = S + np.outer(rows, rows)
    gain = linalg.solve(S, A @ prior, assume_a="pos").T
    log_p = -0.5 * (residual @ linalg.solve(S, residual, assume_a="pos") + np.linalg.slogdet(2 * np.pi * S)[1])
    return gain @ residual, prior - gain @ A @ prior, log_p
