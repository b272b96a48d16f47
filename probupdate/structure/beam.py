"""3D beam elements of circular tubes as constant matrices: Bernoulli-Euler, or Timoshenko through phi.

Degrees of freedom per node: u_x, u_y, u_z, r_x, r_y, r_z; local x runs along the member. All matrices here are (12, 12)
in local axes and depend on the length L only; what multiplies them (EA, EI, GJ, masses) is a scalar.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache, wraps
from typing import TypeVar

import numpy as np

from probupdate.structure.coefficient import Values

_Matrices = TypeVar("_Matrices", Mapping[str, np.ndarray], np.ndarray)

AXIAL = np.array([0, 6])
TORSION = np.array([3, 9])
# bending in x-y carries (u_y, r_z); in x-z (u_z, r_y) with r_y = -du_z/dx
PLANES = ((np.array([1, 5, 7, 11]), np.ones(4)), (np.array([2, 4, 8, 10]), np.array([1.0, -1.0, 1.0, -1.0])))

# polynomial coefficients in xi = x/L, lowest power first; rows v_1, r_1/L, v_2, r_2/L
_DEFLECTION = np.array([[1, 0, -3, 2], [0, 1, -2, 1], [0, 0, 3, -2], [0, 0, -1, 1]], float)
_DEFLECTION_SHEAR = np.array([[1, -1, 0, 0], [0, 0.5, -0.5, 0], [0, 1, 0, 0], [0, -0.5, 0.5, 0]], float)
# section rotation times L
_ROTATION = np.array([[0, -6, 6], [1, -4, 3], [0, 6, -6], [0, -2, 3]], float)
_ROTATION_SHEAR = np.array([[0, 0, 0], [1, -1, 0], [0, 0, 0], [0, 1, 0]], float)


@dataclass(frozen=True, kw_only=True)
class Tube:
    """A circular tube; the names of the parameters that scale its diameter and wall, and of those whose sum is its
    external wall loss.

    Geometry in m at given parameter values; an absent name acts neutrally.
    """

    diameter_m: float
    thickness_m: float
    diameter_factor: str | None = None
    thickness_factor: str | None = None
    wall_loss: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        return (*(n for n in (self.diameter_factor, self.thickness_factor) if n is not None), *self.wall_loss)

    def loss(self, values: Values):
        return sum((values[name] for name in self.wall_loss), 0.0)

    def wall(self, values: Values):
        factor = 1.0 if self.thickness_factor is None else values[self.thickness_factor]
        return self.thickness_m * factor - self.loss(values)

    def outer(self, values: Values):
        factor = 1.0 if self.diameter_factor is None else values[self.diameter_factor]
        return self.diameter_m * factor - 2 * self.loss(values)

    def inner(self, values: Values):
        return self.outer(values) - 2 * self.wall(values)

    def area(self, values: Values):
        return np.pi / 4 * (self.outer(values) ** 2 - self.inner(values) ** 2)

    def second_moment(self, values: Values):
        """I about a diameter; the torsion constant is 2 I."""
        return np.pi / 64 * (self.outer(values) ** 4 - self.inner(values) ** 4)

    def shear_flexibility(self, values: Values, length_m: float, poisson_ratio: float):
        """phi = 12 E I / (kappa G A L^2), kappa of a hollow circle after Cowper (1966)."""
        ratio = (self.inner(values) / self.outer(values)) ** 2
        nu = poisson_ratio
        kappa = 6 * (1 + nu) * (1 + ratio) ** 2 / ((7 + 6 * nu) * (1 + ratio) ** 2 + (20 + 12 * nu) * ratio)
        return 24 * (1 + nu) * self.second_moment(values) / (kappa * self.area(values) * length_m**2)


def _pair(index: np.ndarray, block: np.ndarray) -> np.ndarray:
    matrix = np.zeros((12, 12))
    matrix[np.ix_(index, index)] = block
    return matrix


def _expand_to_both_planes(block: np.ndarray) -> np.ndarray:
    """block (..., 4, 4) for (v_1, r_1, v_2, r_2) -> both bending planes (..., 12, 12)."""
    matrix = np.zeros((*block.shape[:-2], 12, 12))
    for index, sign in PLANES:
        matrix[..., index[:, None], index] += block * np.outer(sign, sign)
    return matrix


def _scale(length_m: float) -> np.ndarray:
    return np.array([1.0, length_m, 1.0, length_m])


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Polynomial products of every pair of rows: (n, m, degree)."""
    result = np.zeros((len(a), len(b), a.shape[1] + b.shape[1] - 1))
    for k in range(a.shape[1]):
        for j in range(b.shape[1]):
            result[:, :, k + j] += np.outer(a[:, k], b[:, j])
    return result


def _integrate(product: np.ndarray) -> np.ndarray:
    return product @ (1.0 / np.arange(1, product.shape[2] + 1))


def _cache_by_length(matrices: Callable[[float], _Matrices]) -> Callable[[float], _Matrices]:
    """Kept by length, read-only: elements of one length are many, and a turbine is assembled at several headings."""

    @lru_cache(maxsize=1024)
    @wraps(matrices)
    def read_only(length_m: float) -> _Matrices:
        found = matrices(length_m)
        for array in found.values() if isinstance(found, Mapping) else (found,):
            array.setflags(write=False)
        return found

    return read_only


@_cache_by_length
def stiffness_matrices(length_m: float) -> Mapping[str, np.ndarray]:
    """K = EA axial + GJ torsion + EI / (1 + phi) (bending + phi shear), phi = 0 for Bernoulli-Euler."""
    rod = np.array([[1.0, -1.0], [-1.0, 1.0]]) / length_m
    scale = _scale(length_m)
    bending = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]]) / length_m**3
    shear = np.array([[0, 0, 0, 0], [0, 1, 0, -1], [0, 0, 0, 0], [0, -1, 0, 1]]) / length_m**3
    return {
        "axial": _pair(AXIAL, rod),
        "torsion": _pair(TORSION, rod),
        "bending": _expand_to_both_planes(bending * np.outer(scale, scale)),
        "shear": _expand_to_both_planes(shear * np.outer(scale, scale)),
    }


@_cache_by_length
def axial_mass(length_m: float) -> np.ndarray:
    """Times mass per metre: what moves along the member."""
    return _pair(AXIAL, np.array([[2.0, 1.0], [1.0, 2.0]]) * length_m / 6)


@_cache_by_length
def torsional_mass(length_m: float) -> np.ndarray:
    """Times rho J: what spins about the member's axis."""
    return _pair(TORSION, np.array([[2.0, 1.0], [1.0, 2.0]]) * length_m / 6)


def _shear_integrals(plain: np.ndarray, shear: np.ndarray) -> np.ndarray:
    """(3, 4, 4): the integrals of (plain + phi shear)^2 by powers of phi, for an element of length 1."""
    cross = _product(plain, shear)
    parts = (_product(plain, plain), cross + cross.transpose(1, 0, 2), _product(shear, shear))
    return np.array([_integrate(part) for part in parts])


_TRANSVERSE = _shear_integrals(_DEFLECTION, _DEFLECTION_SHEAR)
_ROTARY = _shear_integrals(_ROTATION, _ROTATION_SHEAR)
_MOMENTS = np.moveaxis(_product(_DEFLECTION, _DEFLECTION), 2, 0)


@_cache_by_length
def transverse_mass(length_m: float) -> np.ndarray:
    """(3, 12, 12): times mass per metre and phi^0, phi^1, phi^2 over (1 + phi)^2."""
    return _expand_to_both_planes(_TRANSVERSE * np.outer(_scale(length_m), _scale(length_m)) * length_m)


@_cache_by_length
def rotary_mass(length_m: float) -> np.ndarray:
    """(3, 12, 12): times rho I and phi^0, phi^1, phi^2 over (1 + phi)^2, rotation of the cross-sections."""
    return _expand_to_both_planes(_ROTARY * np.outer(_scale(length_m), _scale(length_m)) / length_m)


def geometric_stiffness(length_m: float) -> np.ndarray:
    """Times the axial force (tension positive): the string stiffness of a Bernoulli-Euler element."""
    return rotary_mass(length_m)[0]


@_cache_by_length
def transverse_moments(length_m: float) -> np.ndarray:
    """(7, 12, 12): sum_m mu_m C_m is the matrix of a transverse density q(xi), mu_m = int q xi^m dx, 0 <= xi <= 1."""
    return _expand_to_both_planes(_MOMENTS * np.outer(_scale(length_m), _scale(length_m)))


@_cache_by_length
def axial_moments(length_m: float) -> np.ndarray:
    """(3, 12, 12): as `transverse_moments` for a density along the member."""
    rod = np.array([[1.0, -1.0], [0.0, 1.0]])
    product = _product(rod, rod)
    return np.array([_pair(AXIAL, product[:, :, m]) for m in range(product.shape[2])])


@_cache_by_length
def torsional_moments(length_m: float) -> np.ndarray:
    """(3, 12, 12): as `axial_moments` for a density about the member's axis."""
    rod = np.array([[1.0, -1.0], [0.0, 1.0]])
    product = _product(rod, rod)
    return np.array([_pair(TORSION, product[:, :, m]) for m in range(product.shape[2])])


def interpolation(xi: float, length_m: float) -> np.ndarray:
    """(6, 12): displacement and rotation at xi from the end motions, Bernoulli-Euler shapes."""
    powers = xi ** np.arange(4)
    matrix = np.zeros((6, 12))
    for row in (0, 3):
        matrix[row, row], matrix[row, row + 6] = 1 - xi, xi
    deflection = (_DEFLECTION @ powers) * _scale(length_m)
    rotation = (_ROTATION @ powers[:3]) * _scale(length_m) / length_m
    for (index, sign), u_row, r_row in zip(PLANES, (1, 2), (5, 4), strict=True):
        matrix[u_row, index] = deflection * sign
        # in x-z, r_y = -du_z/dx
        matrix[r_row, index] = rotation * sign * (1.0 if r_row == 5 else -1.0)
    return matrix


def axes(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """(3, 3), rows the local x, y, z axes; for tubes any pair of transverse axes serves."""
    x = (end - start) / np.linalg.norm(end - start)
    helper = np.eye(3)[np.argmin(np.abs(x))]
    y = _cross(helper, x)
    y /= np.linalg.norm(y)
    return np.array([x, y, _cross(x, y)])


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    # numpy's own costs ten times as much for two vectors
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def to_global(local: np.ndarray, frame_axes: np.ndarray) -> np.ndarray:
    """(..., 12, 12) in local axes -> global."""
    turn = np.zeros((12, 12))
    for k in range(0, 12, 3):
        turn[k : k + 3, k : k + 3] = frame_axes
    return turn.T @ local @ turn
