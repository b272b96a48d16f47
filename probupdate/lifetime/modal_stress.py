"""Modes of one parameter vector with the stresses that they make, and how these change with the parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

# modes nearer than this, relative, are a pair
CLOSE = 0.1
# of the three nominal stresses
PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
PAIR_OF = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
# of static shapes under unit loads, relative in energy's root: shapes below it are left out
SHAPE_TOLERANCE = 1e-4


@dataclass(frozen=True, eq=False, kw_only=True)
class ModalStress:
    """One parameter vector on the basis: value (n,) omega^2, U (n_basis, n), plain (n, n_frequency) the modes' dynamic
    stiffness, RK, RM (3 n_detail, n) stresses by motion and by acceleration, scale (3 n_detail, 1); `at`: K, M and
    unscaled R_K, R_M on the basis."""

    value: np.ndarray
    U: np.ndarray
    labels: tuple[str, ...]
    ratio: np.ndarray
    plain: np.ndarray
    hub: np.ndarray
    scale: np.ndarray
    RK: np.ndarray
    RM: np.ndarray
    omega: np.ndarray
    at: tuple[np.ndarray, ...]

    def set_damping(self, ratios: Mapping[str, float]) -> ModalStress:
        """With these ratios by label, others as they are."""
        n, ratio = len(self.labels), np.array(self.ratio)
        ratio[:n] = shared_damping(np.sqrt(self.value[:n]), self.labels, ratios, ratio[:n])
        plain = (self.value[:, None] - self.omega**2
                 + 2j * self.omega * (ratio * np.sqrt(self.value))[:, None])
        return replace(self, ratio=ratio, plain=plain)

    def stress(self, q: np.ndarray) -> np.ndarray:
        """(3 n_detail, n) of the modes' motion q at the first n frequencies."""
        return times(self.RK, q) - times(self.RM, self.omega[: q.shape[1]] ** 2 * q)

    def condense(self, loads: np.ndarray, slow: int) -> ModalStress:
        """The `slow` lowest modes, and in the place of all others the shapes that static loads (n_basis, n) give them,
        as modes of their own: exact in stiffness, of the first order in mass."""
        if slow >= len(self.value):
            return self
        high, root = self.U[:, slow:], np.sqrt(self.value[slow:])
        given = (high.T @ loads) / root[:, None]
        size = np.linalg.norm(given, axis=0)
        left, share, _ = np.linalg.svd(given[:, size > 0] / size[size > 0], full_matrices=False)
        shapes = left[:, share > SHAPE_TOLERANCE * share.max(initial=0.0)] / root[:, None]
        # with stiffness one, eigenvalues of the mass are one over omega^2
        slowness, turned = np.linalg.eigh(shapes.T @ shapes)
        W = shapes @ (turned / np.sqrt(slowness))

        def project(rows: np.ndarray) -> np.ndarray:
            return np.hstack([rows[..., :slow], rows[..., slow:] @ W])

        return replace(
            self, value=np.concatenate([self.value[:slow], 1 / slowness]), U=project(self.U), hub=project(self.hub),
            ratio=np.concatenate([self.ratio[:slow], np.full(len(slowness), self.ratio[slow])]), RK=project(self.RK),
            RM=project(self.RM)).set_damping({})

    def solve(self, load: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """(diag(plain) + hub rate hub^T)^-1 load at the load's frequencies (Sherman and Morrison)."""
        n = load.shape[1]
        q = load / self.plain[:, :n]
        alone = self.hub[:, None] / self.plain[:, :n]
        return q - alone * (rate[:n] * (self.hub @ q) / (1 + rate[:n] * (self.hub @ alone)))


@dataclass(frozen=True, eq=False, kw_only=True)
class Slopes:
    K: list[np.ndarray]
    M: list[np.ndarray]
    C: list[np.ndarray]
    RK: list[np.ndarray]
    RM: list[np.ndarray]
    scale: np.ndarray

    def stress_changes(self, q: np.ndarray, m: ModalStress, rate: np.ndarray) -> list[np.ndarray]:
        """Change of the stresses of a motion q (n, n_frequency) by every parameter, the load held."""
        omega = m.omega[: q.shape[1]]
        z, changes = m.stress(q), []
        for k in range(len(self.K)):
            force = times(self.K[k], q) - times(self.M[k], omega**2 * q) + times(self.C[k], 1j * omega * q)
            own = times(self.RK[k], q) - times(self.RM[k], omega**2 * q)
            changes.append(own - m.stress(m.solve(force, rate)) + (self.scale[k] / m.scale[:, 0])[:, None] * z)
        return changes


def times(real, x: np.ndarray) -> np.ndarray:
    """A real matrix times a complex one: half of what complex products cost."""
    n = x.shape[1]
    both = np.asarray(real @ np.hstack([np.real(x), np.imag(x)]))
    return both[:, :n] + 1j * both[:, n:]


def paired_moments(z: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(n, n_detail, 3, 3) sums over lines of Re(z_i conj z_j) times each of n weights (n, n_line); z (3 n_detail,
    n_line)."""
    z = z.reshape(-1, 3, z.shape[-1])
    pairs = np.stack([z[:, i].real * z[:, j].real + z[:, i].imag * z[:, j].imag for i, j in PAIRS], axis=1)
    found = (pairs.reshape(-1, z.shape[-1]) @ weights.T).reshape(*pairs.shape[:2], -1)
    return found[:, PAIR_OF].transpose(3, 0, 1, 2)


def shared_damping(frequency, labels: Sequence[str], damping: Mapping[str, float], assumed: np.ndarray) -> np.ndarray:
    """Ratios by label; modes of a close pair share their geometric mean, as the pair turns and its names change
    places."""
    known = [k for k, label in enumerate(labels) if label in damping]
    log = np.log(assumed)
    groups: list[list[int]] = []
    for k in known:
        log[k] = np.log(damping[labels[k]])
        if groups and frequency[k] < (1 + CLOSE) * frequency[groups[-1][-1]]:
            groups[-1].append(k)
        else:
            groups.append([k])
    for group in groups:
        log[group] = np.mean(log[group])
    return np.exp(log)
