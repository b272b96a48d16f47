"""Terms of a frame whose nacelle looks elsewhere, from those of the frame as it is.

With R the turn of the master's six motions about the vertical, what hangs on it adds R N R^T to a mass where it added
N, and its weight and thrust send R f down where they sent f. Nothing else is assembled again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy import sparse

from probupdate.structure.assembly import (
    AssembledFrame,
    axial_forces_under,
    body_mass,
    geometric_stiffness,
    loads_of,
    nodal_forces,
    node_dofs,
    sum_contributions,
    transformation,
)
from probupdate.structure.frame import Frame

# stiffness and mass terms
Terms = tuple[tuple[sparse.csc_array, ...], tuple[sparse.csc_array, ...]]


def turned_terms(
    frame: Frame, assembled: AssembledFrame, turns_deg: Sequence[float], *, updated: tuple[str, ...],
    values: Mapping[str, float], theory: str, gravity_mps2: float | None,
) -> list[Terms]:
    """Stiffness and mass terms with the nacelle turned by each of these angles, counter-clockwise from where the frame
    has it; terms of which nothing turns are the same objects. All else as in `assemble`."""
    transform = transformation(frame)
    hanging = np.zeros(transform.shape[0], bool)
    hanging[node_dofs(*frame.nacelle)] = True
    (master,) = {tie.master for tie in frame.ties if tie.node in frame.nacelle}
    level, quarter = _turns(sparse.csr_array(transform)[node_dofs(master)].indices, transform.shape[1])
    heavy = sum_contributions(
        (part for body in frame.bodies if body.node in frame.nacelle for part in body_mass(body)),
        updated, values, transform)
    loads, stiff = loads_of(frame, gravity_mps2), []
    if loads:
        down = transform.T @ (hanging[:, None] * nodal_forces(frame, values, theory, loads))
        forces = axial_forces_under(frame, values, theory, np.hstack([level @ down, quarter @ down]))
        stiff = [sum_contributions(geometric_stiffness(frame, part, [load.coefficient for load in loads]), updated,
                                   values, transform) for part in np.split(forces, 2, axis=1)]
    result = []
    for angle in np.radians(turns_deg):
        cosine, sine = np.cos(angle) - 1, np.sin(angle)
        turn = sparse.eye_array(transform.shape[1]) + cosine * level + sine * quarter
        changes = ([{key: weight * term for key, term in part.items()}
                    for weight, part in zip((cosine, sine), stiff, strict=False)],
                   [{key: turn @ term @ turn.T - term for key, term in heavy.items()}])
        stiffness, mass = (_changed(terms, keys, own) for terms, keys, own in
                           zip((assembled.stiffness, assembled.mass), assembled.keys, changes, strict=True))
        result.append((stiffness, mass))
    return result


def _turns(motions: np.ndarray, size: int) -> tuple[sparse.csr_array, sparse.csr_array]:
    """C and S (size, size) of a turn about z of six motions: I + (cos a - 1) C + sin a S."""
    x, y = motions[[0, 3]], motions[[1, 4]]
    level = sparse.coo_array((np.ones(4), (np.r_[x, y], np.r_[x, y])), shape=(size, size))
    quarter = sparse.coo_array((np.repeat([-1.0, 1.0], 2), (np.r_[x, y], np.r_[y, x])), shape=(size, size))
    return sparse.csr_array(level), sparse.csr_array(quarter)


def _changed(terms: Sequence[sparse.csc_array], keys: Sequence[tuple], changes) -> tuple[sparse.csc_array, ...]:
    result, number = list(terms), {key: k for k, key in enumerate(keys)}
    for change in changes:
        for key, part in change.items():
            total = result[number[key]] + part
            result[number[key]] = sparse.csc_array(0.5 * (total + total.T))
    return tuple(result)
