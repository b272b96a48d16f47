"""Modes of the virtual turbine at a nacelle heading, with the damping of a rotor state.

Heading: degrees clockwise seen from above, 0 where the rotor looks along -x as the drawing has it, so that wind
from -x is wind from 0 deg. Fore-aft is the direction the nacelle looks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from probupdate.runtime.arrays import frozen_array
from probupdate.virtual.frame import Structure
from probupdate.virtual.observation import rotation

N_MODE = 20
# aerodynamic dashpots at the hub in N s/m, along (FA) and across (SS) the rotor axis; operating: near dT/dU
AERO_DAMPING = {"idling": (6.0e3, 4.0e3), "operating": (5.0e4, 1.0e4)}


@dataclass(frozen=True, eq=False, kw_only=True)
class HeadingModes:
    """Modes at one heading, unit modal mass. frequency_hz (n_mode,); damping_ratio {state: (n_mode,)};
    nominal_shape (n_channel, n_mode) what ideal sensors read of a mode in free vibration over its acceleration,
    observed_shape the same with gains and rotations as mounted, of which observed_motion is that of the sensors'
    places and observed_tilt what gravity adds, in m/s2 for a displacement of one;
    rna_load (4, n_mode): modal force of unit thrust, side force, tilt moment, yaw moment; wave_load
    (2 n_leg, n_mode): unit x, then y force on each leg; shape (n_dof, n_mode), momentum M phi (n_dof, n_mode)."""

    heading_deg: float
    frequency_hz: np.ndarray
    damping_ratio: dict[str, np.ndarray]
    nominal_shape: np.ndarray
    observed_shape: np.ndarray
    observed_motion: np.ndarray
    observed_tilt: np.ndarray
    rna_load: np.ndarray
    wave_load: np.ndarray
    shape: np.ndarray
    momentum: np.ndarray


def rna_mass(structure: Structure, heading_deg: float) -> np.ndarray:
    """Mass matrix (6, 6) about the tower-top node of bodies at offsets r, turned with the nacelle."""
    turn = rotation(np.array([0.0, 0.0, -np.radians(heading_deg)]))
    total = np.zeros((6, 6))
    for weight, offset, inertia in structure.rna:
        x, y, z = turn @ offset
        # the body's centre moves by u + theta x r = u - S theta
        skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        carry = np.hstack([np.eye(3), -skew])
        total += weight * carry.T @ carry
        total[3:, 3:] += turn @ inertia @ turn.T
    return total


def head_mass(structure: Structure, heading_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """What turns with the nacelle or oscillates: rows of the mass matrix (n,) and what they add (n, n)."""
    turn = rotation(np.array([0.0, 0.0, -np.radians(heading_deg)]))
    dofs = [6 * structure.top + np.arange(6)]
    for each in structure.oscillators:
        dofs += [6 * each.node + np.arange(6), np.array([each.dof])]
    rows = np.unique(np.concatenate(dofs))
    added = np.zeros((len(rows), len(rows)))
    at = np.searchsorted(rows, dofs[0])
    added[np.ix_(at, at)] = rna_mass(structure, heading_deg)
    for each in structure.oscillators:
        along, arm = (turn[:, 0], turn @ each.arm_m) if each.direction is None else (each.direction, each.arm_m)
        # momentum of the mass moving relative to a point of a node that moves u + theta x r
        lever = each.mass_kg * np.concatenate([along, np.cross(arm, along)])
        node, own = np.searchsorted(rows, 6 * each.node + np.arange(6)), np.searchsorted(rows, each.dof)
        added[node, own] += lever
        added[own, node] += lever
    return rows, added


def full_mass(structure: Structure, heading_deg: float) -> sparse.csc_array:
    """Mass matrix (n_dof, n_dof) with what sits at the tower top and what oscillates."""
    rows, added = head_mass(structure, heading_deg)
    entries = (added.ravel(), (np.repeat(rows, len(rows)), np.tile(rows, len(rows))))
    return sparse.csc_array(structure.mass + sparse.coo_array(entries, shape=structure.mass.shape))


def heading_modes(structure: Structure, damping_ratio: np.ndarray, heading_deg: float, factor=None) -> HeadingModes:
    """Solve for the lowest modes. damping_ratio (n_mode,) of the structure itself; `factor` a splu of K to reuse."""
    size, top = structure.stiffness.shape[0], 6 * structure.top
    dofs = top + np.arange(6)
    mass = full_mass(structure, heading_deg)
    factor = factorise(structure) if factor is None else factor
    inverse = LinearOperator((size, size), matvec=factor.solve, dtype=float)
    # a fixed start vector: ARPACK's own is random, and the same seed must give the same bytes
    start = np.cos(np.arange(size))
    value, shape = eigsh(structure.stiffness, k=len(damping_ratio), M=mass, sigma=0.0, OPinv=inverse, v0=start)
    order = np.argsort(value)
    value, shape = value[order], shape[:, order]
    shape = shape / np.sqrt(np.einsum("ij,ij->j", shape, mass @ shape))
    largest = np.argmax(np.abs(shape), axis=0)
    shape = shape * np.sign(shape[largest, np.arange(shape.shape[1])])
    angular = np.sqrt(value)
    turn = rotation(np.array([0.0, 0.0, -np.radians(heading_deg)]))
    head = shape[dofs]
    fore_aft, side = turn[:, 0] @ head[:3], turn[:, 1] @ head[:3]
    rna_load = np.array([fore_aft, side, turn[:, 1] @ head[3:], head[5]])
    legs = 6 * structure.surface
    damping = {
        state: frozen_array(damping_ratio + (along * fore_aft**2 + across * side**2) / (2 * angular))
        for state, (along, across) in AERO_DAMPING.items()
    }
    return HeadingModes(
        heading_deg=float(heading_deg),
        frequency_hz=frozen_array(angular / (2 * np.pi)),
        damping_ratio=damping,
        # a free vibration's acceleration is -angular^2 times its displacement
        nominal_shape=frozen_array(structure.nominal_channel @ shape - structure.nominal_tilt @ shape / value),
        observed_shape=frozen_array(structure.channel @ shape - structure.tilt @ shape / value),
        observed_motion=frozen_array(structure.channel @ shape),
        observed_tilt=frozen_array(structure.tilt @ shape),
        rna_load=frozen_array(rna_load),
        wave_load=frozen_array(np.vstack([shape[legs], shape[legs + 1]])),
        shape=frozen_array(shape),
        momentum=frozen_array(mass @ shape),
    )


def factorise(structure: Structure):
    """LU of K; it does not depend on the heading."""
    return splu(structure.stiffness, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}, diag_pivot_thresh=0.0)
