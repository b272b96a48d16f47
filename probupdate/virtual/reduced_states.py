"""Modes of the virtual turbine at many states of its hidden effects and headings, in one small basis.

Stiffness and mass are taken at up to three amounts of every effect that varies and interpolated between them, effect
by effect; the tower top's mass is turned exactly. `tests/virtual` holds the error against full solutions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh, null_space, qr

from probupdate.virtual.dynamics import factorise, head_mass, heading_modes
from probupdate.virtual.frame import Structure

N_BASIS = 20  # modes kept of every structure
HEADINGS_DEG = (0.0, 45.0)  # at which they are solved; what a turn adds is near their span and static shapes


@dataclass(frozen=True, eq=False, kw_only=True)
class _Variation:
    """An effect's nodes (n_node,) and, at each, what differs from the base: stiffness, mass (n, n), structure."""

    column: int
    node: np.ndarray
    stiffness: np.ndarray
    mass: np.ndarray
    structure: tuple[Structure, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class ReducedStates:
    """`basis` (n_dof, n); stiffness and mass (n, n) of the base structure without its head's mass."""

    base: Structure
    basis: np.ndarray
    stiffness: np.ndarray
    mass: np.ndarray
    variation: tuple[_Variation, ...]

    def modes(
        self, amount: np.ndarray, heading_deg: float, n_mode: int, *, held: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies (n_mode,) in Hz and shapes in the basis (n, n_mode), unit modal mass; where it is `held`, what
        hangs on springs does not move relative to its node."""
        stiffness, mass = self.stiffness.copy(), self.mass.copy()
        head = _reduced_head(self.base, heading_deg, self.basis)
        total = head.copy()
        for each in self.variation:
            weight = _lagrange(each.node, amount[each.column])
            stiffness += np.tensordot(weight, each.stiffness, 1)
            mass += np.tensordot(weight, each.mass, 1)
            for share, structure in zip(weight, each.structure, strict=True):
                if structure is not self.base and share:
                    total += share * (_reduced_head(structure, heading_deg, self.basis) - head)
        mass += total
        still = null_space(self.basis[[o.dof for o in self.base.oscillators]]) if held else np.eye(len(mass))
        value, shape = eigh(still.T @ stiffness @ still, still.T @ mass @ still, subset_by_index=[0, n_mode - 1])
        return np.sqrt(value) / (2 * np.pi), still @ shape


def _lagrange(node: np.ndarray, x: float) -> np.ndarray:
    weight = np.ones(len(node))
    for k in range(len(node)):
        for j in range(len(node)):
            if j != k:
                weight[k] *= (x - node[j]) / (node[k] - node[j])
    return weight


def _reduced_head(structure: Structure, heading_deg: float, basis: np.ndarray) -> np.ndarray:
    rows, added = head_mass(structure, heading_deg)
    return basis[rows].T @ added @ basis[rows]


def _nodes(values: np.ndarray) -> np.ndarray:
    """One to three amounts that stand for all."""
    found = np.unique(values)
    if len(found) <= 3:
        return found
    return np.array([found[0], 0.5 * (found[0] + found[-1]), found[-1]])


def reduce_states(
    build: Callable[[np.ndarray], Structure], amount: np.ndarray, acts: np.ndarray, damping_ratio: np.ndarray
) -> ReducedStates:
    """build(amount (n_effect,)) -> Structure; amount (n_state, n_effect); acts (n_effect,) bool: on the structure."""
    start = amount[0].copy() if len(amount[0]) else np.zeros(0)
    nodes = {k: _nodes(amount[:, k]) for k in range(amount.shape[1]) if acts[k] and np.ptp(amount[:, k]) > 0}
    for k, node in nodes.items():
        start[k] = node[0]
    base = build(start)
    structures = {}
    for k, node in nodes.items():
        structures[k] = [base]
        for value in node[1:]:
            changed = start.copy()
            changed[k] = value
            structures[k].append(build(changed))
    every = [base, *(s for group in structures.values() for s in group[1:])]
    columns = []
    for structure in every:
        solver = factorise(structure)
        for heading in HEADINGS_DEG:
            columns.append(heading_modes(structure, damping_ratio, heading, solver).shape[:, :N_BASIS])
        if structure is base:
            # shapes under static loads at the tower top: what a turned mass calls for
            loads = np.zeros((structure.stiffness.shape[0], 6))
            loads[6 * structure.top + np.arange(6), np.arange(6)] = 1.0
            columns.append(solver.solve(loads))
    stacked = np.hstack(columns)
    scale = np.sqrt(np.einsum("ij,ij->j", stacked, base.mass @ stacked))
    # with pivoting: without, what follows a dependent column may lean on the direction it leaves behind
    basis, triangle, _ = qr(stacked / scale, mode="economic", pivoting=True)
    size = np.abs(np.diag(triangle))
    basis = basis[:, size > 1e-8 * size[0]]
    stiffness, mass = (basis.T @ (m @ basis) for m in (base.stiffness, base.mass))
    variation = tuple(
        _Variation(
            column=k, node=nodes[k], structure=tuple(structures[k]),
            stiffness=np.array([basis.T @ ((s.stiffness - base.stiffness) @ basis) for s in structures[k]]),
            mass=np.array([basis.T @ ((s.mass - base.mass) @ basis) for s in structures[k]]),
        )
        for k in nodes
    )
    return ReducedStates(base=base, basis=basis, stiffness=stiffness, mass=mass, variation=variation)
