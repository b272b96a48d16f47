"""A function theta -> modes as matrices: in its own modes at the initial parameters, linear in theta.

With unit modal masses K = diag(lambda) and M = 1. A parameter that changes eigenvalue j by d lambda_j and its shape by
sum_i phi_i c_ij has M_ij = -(c_ij + c_ji) and K_ij = c_ij (lambda_j - lambda_i) + lambda_j M_ij (first-order
perturbation, Fox & Kapoor 1968), whatever the function does inside. What changes of shapes lies outside the modes has
coordinates of its own, above them in frequency; the nearer they are, the less they do to second order. Shapes are
brought to unit modal masses as far as their changes show it: where stiffnesses alone change, c_ij = -c_ji.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from scipy import linalg

from probupdate.io.files import write_arrays, write_text
from probupdate.model.interface import Model
from probupdate.model.parameters import Parameters
from probupdate.structure.extend_matrices import parameters_text

# modes that are taken at most; coordinates outside them lie so many times above the highest
MOST_MODES, ABOVE_HIGHEST = 20, 1.5
# of the largest change of a shape, what is left outside the modes that needs no coordinate
LEAST_RESIDUAL = 1e-6
# standard deviations that stand for an open bound; corners of the bounds that are looked at; steps of narrowing
FARTHEST, MOST_CORNERS = 8.0, 1024
SHRUNK, LEAST_SHARE = 0.8, 1e-3


@dataclass(frozen=True, eq=False, kw_only=True)
class Tangent:
    """`path` of the matrices, with their parameters' table beside it; `note`: how far it holds."""

    path: Path
    note: str


def write_tangent(model: Model, path: str | Path) -> Tangent:
    """Write the model's tangent at its initial parameters as `path` (.npz) and its parameters beside it (.toml)."""
    path = Path(path)
    n_mode = min(MOST_MODES, model.n_available)
    arrays = _matrices(model, n_mode)
    parameters, share = _positive_bounds(model.parameters, arrays)
    write_arrays(path, arrays | {"channel": np.array(model.channels)})
    write_text(path.with_suffix(".toml"), parameters_text(parameters))
    note = (f"{model.name} is a function: diagnosed is its tangent at the initial parameters by differences, {n_mode} "
            f"modes, whose frequencies are within {100 * _error(model, arrays, n_mode):.2g} % one prior standard "
            "deviation away; causes are its parameters and the sensors, as the parts of the structure are not known")
    if share < 1:
        note += (f"; the distance of its parameters' bounds is narrowed to a share of {share:.2f}, where the tangent "
                 "has masses and stiffnesses above zero")
    return Tangent(path=path, note=note)


def _matrices(model: Model, n_mode: int) -> dict[str, np.ndarray]:
    """K0, M0, K_<name>, M_<name> and channel_row of the tangent."""
    theta = np.array(model.parameters.initial)
    at = model.solve(theta, n_mode, derivatives=True)
    of_frequency, of_shape = at.both_derivatives
    value = (2 * np.pi * at.frequency_hz) ** 2
    scale = _unit_mass(_coefficients(at.shape, of_shape)[0])
    shape, of_shape = at.shape * scale, of_shape * scale[:, None]
    inside, outside = _coefficients(shape, of_shape)
    new = _basis_outside(outside)
    n, size = n_mode, n_mode + new.shape[1]
    high = np.full(new.shape[1], ABOVE_HIGHEST**2 * value.max())
    found = {"K0": np.diag(np.r_[value, high]), "M0": np.eye(size), "channel_row": np.hstack([shape, new])}
    for k, name in enumerate(model.parameters.names):
        c = inside[:, :, k]
        mass, stiffness = np.zeros((size, size)), np.zeros((size, size))
        mass[:n, :n] = -(c + c.T)
        stiffness[:n, :n] = c * (value[None, :] - value[:, None]) + mass[:n, :n] * value[None, :]
        stiffness[np.arange(n), np.arange(n)] = 8 * np.pi**2 * at.frequency_hz * of_frequency[:, k]
        across = (new.T @ outside[:, :, k]) * (value[None, :] - high[:, None])
        stiffness[n:, :n], stiffness[:n, n:] = across, across.T
        found[f"K_{name}"] = 0.5 * (stiffness + stiffness.T)
        if np.abs(mass).max() > 0:
            found[f"M_{name}"] = mass
        found["K0"] = found["K0"] - theta[k] * found[f"K_{name}"]
        found["M0"] = found["M0"] - theta[k] * mass
    return found


def _coefficients(shape: np.ndarray, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """c (n_mode, n_mode, n_param) of changes (n_channel, n_mode, n_param) in the other modes of shape, without what
    scales a shape, and what is left of them."""
    n_mode = shape.shape[1]
    inside, outside = np.zeros((n_mode, *change.shape[1:])), np.zeros_like(change)
    for j in range(n_mode):
        own, others = shape[:, j], [i for i in range(n_mode) if i != j]
        moved = change[:, j] - np.outer(own, own @ change[:, j]) / (own @ own)
        found = np.linalg.lstsq(shape[:, others], moved, rcond=1e-8)[0]
        inside[others, j] = found
        outside[:, j] = moved - shape[:, others] @ found
    return inside, outside


def _unit_mass(c: np.ndarray) -> np.ndarray:
    """What each shape (n_mode,) is to be multiplied by so that c (n_mode, n_mode, n_param) is as antisymmetric as can
    be: of shapes s_i as large as those of unit modal mass, -c_ji / c_ij = (s_i / s_j)^2."""
    n = len(c)
    i, j = np.triu_indices(n, 1)
    there, back = c[i, j], c[j, i]
    both = there * back < 0
    ratio = np.where(both, 0.5 * np.log(np.where(both, -back / np.where(both, there, 1.0), 1.0)), 0.0)
    weight = np.where(both, np.sqrt(np.abs(there * back)), 0.0)
    rows, right = [], []
    for pair in range(len(i)):
        if weight[pair].any():
            row = np.zeros(n)
            row[i[pair]], row[j[pair]] = 1.0, -1.0
            rows.append(weight[pair].sum() * row)
            right.append(weight[pair] @ ratio[pair])
    return np.exp(-np.linalg.lstsq(np.array(rows), np.array(right), rcond=None)[0]) if rows else np.ones(n)


def _basis_outside(outside: np.ndarray) -> np.ndarray:
    """Orthonormal columns (n_channel, n) for changes (n_channel, n_mode, n_param) that no mode has."""
    flat = outside.reshape(len(outside), -1)
    u, s, _ = np.linalg.svd(flat, full_matrices=False)
    return u[:, s > LEAST_RESIDUAL * max(s.max(initial=0.0), 1e-300)] if np.abs(flat).max(initial=0) > 1e-12 else (
        np.zeros((len(outside), 0)))


def _matrix(arrays: dict[str, np.ndarray], kind: str, names: tuple[str, ...], theta: np.ndarray) -> np.ndarray:
    return arrays[f"{kind}0"] + sum(t * arrays[f"{kind}_{name}"] for t, name in zip(theta, names, strict=True)
                                    if f"{kind}_{name}" in arrays)


def _positive_bounds(parameters: Parameters, arrays: dict[str, np.ndarray]) -> tuple[Parameters, float]:
    """The parameters with bounds at whose corners the tangent's matrices are positive definite, which they are within
    then, and the share of their distance from the initial values that is left."""
    initial, names, n = np.array(parameters.initial), parameters.names, len(parameters)
    room = np.array([np.where(np.isfinite(e), e - initial, s * FARTHEST * parameters.std)
                     for e, s in ((parameters.lower, -1), (parameters.upper, 1))])
    if 2**n <= MOST_CORNERS:
        corner = np.array(list(product((0, 1), repeat=n)))
    else:
        corner = np.random.default_rng(0).integers(0, 2, (MOST_CORNERS, n))
    ends = np.take_along_axis(room, corner, axis=0)

    def positive(share: float) -> bool:
        each = initial + share * ends
        return all(np.linalg.eigvalsh(np.array([_matrix(arrays, kind, names, theta) for theta in each])).min() > 0
                   for kind in "KM")

    share = 1.0
    while not positive(share) and share > LEAST_SHARE:
        share *= SHRUNK
    if share == 1.0:
        return parameters, share
    low, high = initial + share * room
    items = tuple(replace(p, lower=float(a), upper=float(b)) for p, a, b in zip(parameters, low, high, strict=True))
    return Parameters(items, parameters.correlation), share


def _error(model: Model, arrays: dict[str, np.ndarray], n_mode: int) -> float:
    """The largest relative difference of a frequency from the function's, one standard deviation up or down."""
    worst, names = 0.0, model.parameters.names
    for k, std in enumerate(model.parameters.std):
        for sign in (-1.0, 1.0):
            theta = np.array(model.parameters.initial)
            theta[k] = np.clip(theta[k] + sign * std, model.parameters.lower[k], model.parameters.upper[k])
            K, M = (_matrix(arrays, kind, names, theta) for kind in "KM")
            if linalg.eigvalsh(M)[0] <= 0:
                return float("nan")
            square = linalg.eigvalsh(K, M)[:n_mode]
            exact = model.solve(theta, n_mode).frequency_hz
            worst = max(worst, float(np.max(np.abs(np.sqrt(np.abs(square)) / (2 * np.pi * exact) - 1))))
    return worst
