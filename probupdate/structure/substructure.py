"""What of a structure stands below its tower: stiffness and mass with the motion of the place the tower stands on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from probupdate.errors import InputError
from probupdate.runtime.arrays import frozen_array
from probupdate.structure.affine import WeightedSum
from probupdate.structure.assembly import Softening, rigid_motion, supporting_frame, supporting_matrices
from probupdate.structure.description import Description
from probupdate.structure.frame import Frame
from probupdate.structure.subdyn_frame import SubDynFrame
from probupdate.structure.turbine_frame import build_frame

TOWER = "tower"


@dataclass(frozen=True, eq=False, kw_only=True)
class Substructure:
    """stiffness, mass (n, n). interface (6 k, n): motions of the k nodes that the transition piece joins, and rigid
    (6 k, 6) what they are when it moves by its six motions about `reference_m`. joints (n_joint,) numbers, joint_motion
    (6 n_joint, n) with `there` (n_joint, 6) False for rotations a joint does not have."""

    where: str
    stiffness: sparse.csc_array
    mass: sparse.csc_array
    interface: sparse.csr_array
    rigid: np.ndarray
    reference_m: np.ndarray
    joints: tuple[int, ...]
    joint_motion: sparse.csr_array
    there: np.ndarray


def subdyn_substructure(frame: SubDynFrame, stiffness, mass, reference_m=None) -> Substructure:
    """Of a SubDyn file, as it is assembled, at its interface joints; about their mean where no place is given."""
    file = frame.file
    if not file.interfaces:
        raise InputError(file.where, "has no interface joints", "list them (NInterf): the superelement ends there")
    nodes = [frame.node_of[i.joint] for i in file.interfaces]
    if any(frame.translation[node, 3] < 0 for node in nodes):
        raise InputError(file.where, "an interface joint is not rigid", "take rigid joints (type 1)")
    reference = np.mean(frame.node_m[nodes], axis=0) if reference_m is None else np.asarray(reference_m, float)
    own = frame.translation[: len(file.joints)]
    return Substructure(
        where=file.where, stiffness=stiffness, mass=mass,
        interface=frame.reduction[np.concatenate([frame.translation[node] for node in nodes])],
        rigid=np.vstack([rigid_motion(frame.node_m[node] - reference) for node in nodes]),
        reference_m=frozen_array(reference), joints=tuple(j.id for j in file.joints),
        joint_motion=sparse.csr_array(frame.reduction[np.maximum(own, 0).ravel()]), there=own >= 0)


class NoSubstructure(Exception):
    """A tower that stands on the ground, or on several places."""


def turbine_substructures(d: Description, updated: tuple[str, ...]) -> Callable[[Mapping[str, float]], Substructure]:
    """Of a turbine, as a function of the values of `updated` parameters: everything but the tower above its foot, with
    the soil, the water's added mass and the member forces that the whole turbine's weight makes. The foot's flange is
    in it. `joints` count the nodes of the mesh from one. Raises NoSubstructure where there is none."""
    frame, where = build_frame(d), d.name
    above, foot = split(frame, where)
    below = np.flatnonzero(~above)
    one = supporting_frame(replace(frame, prestress=()), ~above, updated=updated, values=d.values, theory=d.mesh.theory,
                           gravity_mps2=None)
    softening = Softening.assemble(frame, one.transform, ~above, updated=updated, values=d.values, theory=d.mesh.theory,
                             gravity_mps2=d.gravity_mps2 if d.mesh.geometric_stiffness else None)
    sums = tuple(WeightedSum.from_matrices(terms) for terms in (one.stiffness, one.mass))

    def substructure_at(values: Mapping[str, float]) -> Substructure:
        weights = one.coefficients(np.array([values[name] for name in updated], float))
        K, M = (sparse.csc_array(total(c)) for total, c in zip(sums, weights, strict=True))
        if softening is not None:
            K = sparse.csc_array(K + softening(d.values | values))
        motion = one.transform
        return Substructure(
            where=where, stiffness=K, mass=M, interface=motion[6 * foot : 6 * foot + 6], rigid=np.eye(6),
            reference_m=frozen_array(frame.node_m[foot]), joints=tuple(int(k) + 1 for k in below),
            joint_motion=motion[(6 * below[:, None] + np.arange(6)).ravel()], there=np.ones((len(below), 6), bool))

    return substructure_at


def with_tower(
    whole: Substructure, frame: Frame, values: Mapping[str, float], *, theory: str
) -> tuple[sparse.csc_array, sparse.csc_array]:
    """K, M of a substructure that meets the tower of a frame, at parameter values (all by name), at its one interface
    node; prestress left out. What is at the tower's foot is the substructure's."""
    above, foot = split(frame, whole.where)
    alone = replace(frame, prestress=(), bodies=tuple(b for b in frame.bodies if b.node != foot))
    kept = above.copy()
    kept[foot] = True
    K, M, motion = supporting_matrices(alone, values, kept, theory=theory, gravity_mps2=None)
    at_foot = sparse.csr_array(motion[6 * foot : 6 * foot + 6])
    own = at_foot.indices
    rest = np.setdiff1d(np.arange(K.shape[0]), own)
    n = whole.stiffness.shape[0]
    joined = sparse.lil_array((K.shape[0], n + len(rest)))
    joined[own, :n] = whole.interface
    joined[rest, n + np.arange(len(rest))] = 1.0
    joined = sparse.csr_array(joined)
    below = sparse.eye_array(n, n + len(rest), format="csr")
    return tuple(sparse.csc_array(below.T @ low @ below + joined.T @ high @ joined)
                 for low, high in ((whole.stiffness, K), (whole.mass, M)))


def split(frame: Frame, where: str) -> tuple[np.ndarray, int]:
    """(n_node,) which nodes are above the tower's foot, and the foot. Raises NoSubstructure."""
    tower = {node for beam in frame.beams if beam.group == TOWER for node in (beam.start, beam.end)}
    others = {node for beam in frame.beams if beam.group != TOWER for node in (beam.start, beam.end)}
    foot = sorted(tower & others)
    if len(foot) != 1:
        raise NoSubstructure(f"{where} has no structure below its tower" if not foot else
                           f"{where} meets its tower at several places")
    above = np.isin(np.arange(len(frame.node_m)), sorted(tower - set(foot)))
    for tie in frame.ties:
        above[tie.node] |= bool(above[tie.master])
    return above, foot[0]
