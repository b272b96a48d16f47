"""The virtual turbine's own tube element: Timoshenko stiffness, lumped mass, flexible ends by condensation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

BENDING_Y, BENDING_Z = np.ix_((1, 5, 7, 11), (1, 5, 7, 11)), np.ix_((2, 4, 8, 10), (2, 4, 8, 10))


@dataclass(frozen=True, kw_only=True)
class Tube:
    """A tube's section and what moves with it; SI units.

    `carried_kgpm` (steel excluded: growth, flood water, secondary steel) moves with the member in every direction
    but does not spin; `added_kgpm` (surrounding water) moves across the member only.
    """

    diameter_m: float
    thickness_m: float
    youngs_modulus_pa: float
    poisson_ratio: float
    density_kgpm3: float
    carried_kgpm: float = 0.0
    added_kgpm: float = 0.0

    @property
    def area_m2(self) -> float:
        return float(np.pi * self.thickness_m * (self.diameter_m - self.thickness_m))

    @property
    def second_moment_m4(self) -> float:
        inner = self.diameter_m - 2 * self.thickness_m
        return float(np.pi / 64 * (self.diameter_m**4 - inner**4))

    @property
    def shear_modulus_pa(self) -> float:
        return self.youngs_modulus_pa / (2 * (1 + self.poisson_ratio))

    @property
    def shear_coefficient(self) -> float:
        """Cowper 1966, thin-walled tube: 2 (1 + nu) / (4 + 3 nu)."""
        return 2 * (1 + self.poisson_ratio) / (4 + 3 * self.poisson_ratio)


def local_axes(start: np.ndarray, end: np.ndarray, beside: np.ndarray | None = None) -> tuple[np.ndarray, float]:
    """Rows x (along), y, z of the element's axes (3, 3), and its length; z is normal to x and `beside`."""
    along = end - start
    length = float(np.linalg.norm(along))
    x = along / length
    if beside is None or np.linalg.norm(_cross(x, beside)) < 1e-6:
        beside = np.array([0.0, 0.0, 1.0]) if abs(x[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    z = _cross(x, beside)
    z /= np.linalg.norm(z)
    return np.array([x, _cross(z, x), z]), length


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """numpy's own takes ten times as long for three numbers."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def local_stiffness(tube: Tube, length: float) -> np.ndarray:
    """Static stiffness (12, 12) of a Timoshenko tube: u, v, w, rx, ry, rz at either end (Przemieniecki 1968)."""
    e, area, inertia = tube.youngs_modulus_pa, tube.area_m2, tube.second_moment_m4
    phi = 12 * e * inertia / (tube.shear_coefficient * area * tube.shear_modulus_pa * length**2)
    k = np.zeros((12, 12))
    axial, torsion = e * area / length, tube.shear_modulus_pa * 2 * inertia / length
    for dof, value in ((0, axial), (3, torsion)):
        k[dof, dof] = k[dof + 6, dof + 6] = value
        k[dof, dof + 6] = k[dof + 6, dof] = -value
    bending = e * inertia / (length**3 * (1 + phi)) * np.array([
        [12, 6 * length, -12, 6 * length],
        [6 * length, (4 + phi) * length**2, -6 * length, (2 - phi) * length**2],
        [-12, -6 * length, 12, -6 * length],
        [6 * length, (2 - phi) * length**2, -6 * length, (4 + phi) * length**2],
    ])
    k[BENDING_Y] += bending
    sign = np.array([1.0, -1.0, 1.0, -1.0])  # w' = -ry
    k[BENDING_Z] += bending * np.outer(sign, sign)
    return k


def soften_ends(stiffness: np.ndarray, start_flexibility: np.ndarray, end_flexibility: np.ndarray) -> np.ndarray:
    """Put springs of the given flexibilities (6,) between the element's ends and its nodes, and condense them.

    f = K (u - F f)  ->  (I + K F)^-1 K; a zero flexibility is exactly rigid, so no penalty number is needed.
    """
    flexibility = np.concatenate([start_flexibility, end_flexibility])
    softened = np.linalg.solve(np.eye(12) + stiffness * flexibility, stiffness)
    return 0.5 * (softened + softened.T)


def lumped_mass(tube: Tube, length: float, axes: np.ndarray) -> np.ndarray:
    """Mass (6, 6) in global axes that either end receives: half of the element.

    Rotational inertia of the steel only: rho I L / 2 across, rho J L / 2 about the axis; no m L^3 term, so the
    mesh has to be fine and the mass error is O(h^2).
    """
    along = np.outer(axes[0], axes[0])
    across = np.eye(3) - along
    every = tube.density_kgpm3 * tube.area_m2 + tube.carried_kgpm
    rotary = tube.density_kgpm3 * tube.second_moment_m4
    mass = np.zeros((6, 6))
    mass[:3, :3] = 0.5 * length * (every * np.eye(3) + tube.added_kgpm * across)
    mass[3:, 3:] = 0.5 * length * rotary * (across + 2 * along)
    return mass


def to_global(stiffness: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Turn a local (12, 12) matrix into global axes."""
    turn = np.zeros((12, 12))
    for k in range(0, 12, 3):
        turn[k : k + 3, k : k + 3] = axes
    return turn.T @ stiffness @ turn
