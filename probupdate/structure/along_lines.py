"""Channels of a model that is known at its nodes alone, moved along the straight lines between these, or read with
what is stated of gravity reversed: parameters that its matrices know nothing of."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy import linalg, sparse

from probupdate.modal.modes import Sensor
from probupdate.model.interface import Wireframe
from probupdate.model.parameters import Parameter, Parameters
from probupdate.runtime.arrays import frozen_array
from probupdate.structure.affine import AffineModel
from probupdate.structure.moved_channels import MovedChannels
from probupdate.structure.readings import FeltGravity, rotation_reading

# cosine from which two lines are one; of what a channel reads, the share within which it is its node's motion
STRAIGHT, AT_NODE = 0.999, 1e-9
# metres to which a way goes on beyond the next node
REACH_M = 10.0
# nodes that elements join with one, on average, at most
MOST_NEIGHBOURS = 16


@dataclass(frozen=True, eq=False, kw_only=True)
class Way:
    """A straight line of nodes through the one that some channels (by number) are at: `node` numbers and how far along
    they are, in metres, zero at the channels' own and negative on its other side; `end_m` (3,) the place of the
    last."""

    channels: tuple[int, ...]
    node: tuple[int, ...]
    along_m: np.ndarray
    end_m: np.ndarray


@dataclass(frozen=True)
class _Leading:
    """Coefficients of a model that knows nothing of the parameters behind its own."""

    own: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    n: int

    def __call__(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.own(theta[..., : self.n])


def ways(
    model: AffineModel, sensors: Sequence[Sensor], beside: Mapping[int, Sequence[int]]
) -> tuple[Way, ...]:
    """Of sensors at one place, along every line that ends or passes at their node; none of a place where a channel
    reads anything else than its node's motion, and none towards a node that does not move. `beside`: see
    `neighbouring_nodes`."""
    if model.wire is None:
        return ()
    place, rows = model.wire.node_m, sparse.csr_array(model.channel_matrix)
    number = {channel: k for k, channel in enumerate(model.channels)}
    node = int(np.argmin(np.linalg.norm(place - sensors[0].position_m, axis=1)))
    for s in sensors:
        own = rows[[number[s.channel]]]
        apart = abs(own - _motion(model, node, s.direction))
        if apart.nnz and apart.max() > AT_NODE * abs(own).max():
            return ()
    result, taken = [], set()
    for other in beside.get(node, ()):
        if other in taken:
            continue
        onward = _straight_run(model, place, beside, node, other)
        back = next((k for k in beside[node] if _cosine(place, node, other, k) < -STRAIGHT), None)
        behind = [] if back is None else _straight_run(model, place, beside, node, back)
        taken |= {other, back}
        # towards the higher end, if both move
        if not onward or (behind and tuple(place[behind[-1]][::-1]) > tuple(place[onward[-1]][::-1])):
            behind, onward = onward, behind
        found = (*reversed(behind), node, *onward)
        along = np.linalg.norm(place[list(found)] - place[node], axis=1) * np.r_[[-1] * len(behind), 0,
                                                                                 [1] * len(onward)]
        if len(found) > 1:
            result.append(Way(channels=tuple(number[s.channel] for s in sensors), node=found,
                              along_m=frozen_array(along), end_m=place[found[-1]]))
    return tuple(result)


def move_channels(model: AffineModel, added: Sequence[tuple[Parameter, Way]], sensors: Sequence[Sensor]) -> AffineModel:
    """The model with a parameter behind its own for each way: how many metres along it its channels are. What is read
    between two nodes is a straight line's, as the model has no other there."""
    n, directions = len(model.parameters), {s.channel: s.direction for s in sensors}
    n_row, moved = model.rows.shape[0], []
    for column, (_, way) in enumerate(added, start=n):
        own = [directions[model.channels[k]] for k in way.channels]
        read = [_reading_rows(model, node, own) for node in way.node]
        here = read[int(np.flatnonzero(way.along_m == 0)[0])]
        taken = [*way.channels, *(len(model.channels) + k for k in way.channels)][: here.shape[0]]
        onto = sparse.csr_array((np.ones(len(taken)), (taken, np.arange(len(taken)))), shape=(n_row, len(taken)))
        moved.append(MovedChannels(column=column, knots=way.along_m, onto=onto,
                                   powers=tuple((a - here, b - a) for a, b in pairwise(read))))
    return replace(_append_parameters(model, [p for p, _ in added]), moved=(*model.moved, *moved))


def with_reversed_gravity(model: AffineModel, added: Sequence[tuple[Parameter, Sequence[str]]]) -> AffineModel:
    """The model with a parameter behind its own for each of these groups of channels, that makes at its value 1 of what
    is stated of gravity in their readings the other. Raises ValueError where the model has no tilts."""
    if model.gravity is None:
        raise ValueError(f"{model.name} has no rotations")
    own = [(len(model.parameters) + k, frozen_array([float(c in channels) for c in model.channels]))
           for k, (_, channels) in enumerate(added)]
    gravity: FeltGravity = replace(model.gravity, reversed_by=(*model.gravity.reversed_by, *own))
    return replace(_append_parameters(model, [p for p, _ in added]), gravity=gravity)


def _append_parameters(model: AffineModel, added: Sequence[Parameter]) -> AffineModel:
    """With parameters behind its own that its matrices know nothing of."""
    correlation = model.parameters.correlation
    if correlation is not None:
        correlation = linalg.block_diag(correlation, np.eye(len(added)))
    return replace(model, parameters=Parameters((*model.parameters.items, *added), correlation),
                   coefficients=_Leading(model.coefficients, len(model.parameters)))


def _motion(model: AffineModel, node: int, direction: np.ndarray) -> sparse.csr_array:
    """(1, n_dof) the motion of a node along a direction."""
    return sparse.csr_array(direction[None]) @ sparse.csr_array(model.wire_matrix)[3 * node : 3 * node + 3]


def _reading_rows(model: AffineModel, node: int, directions: Sequence[np.ndarray]) -> sparse.csr_array:
    """(n, n_dof) what channels along these directions read of a node's motion, below it of its tilt where the model's
    channels have theirs (2 n, n_dof)."""
    rows = [_motion(model, node, d) for d in directions]
    if model.tilt_matrix is not None:
        turn = sparse.csr_array(model.wire_turn)[3 * node : 3 * node + 3]
        rows += [sparse.csr_array(rotation_reading(d)[None]) @ turn for d in directions]
    return sparse.vstack(rows, format="csr")


def neighbouring_nodes(model: AffineModel) -> dict[int, list[int]]:
    """The nodes at the other ends of the lines from each node; none of a model without places."""
    if model.wire is None or model.wire_matrix is None:
        return {}
    place, result = model.wire.node_m, {}
    for a, b in _lines(model, model.wire).tolist():
        if np.any(place[a] != place[b]):
            result.setdefault(a, {})[b] = None
            result.setdefault(b, {})[a] = None
    return {node: list(others) for node, others in result.items()}


def _lines(model: AffineModel, wire: Wireframe) -> np.ndarray:
    """(n_line, 2) nodes that a line joins: those of the picture, else those that the stiffness couples, unless it
    couples far more than elements do, as condensed matrices have it."""
    if len(wire.line):
        return wire.line
    moves = abs(sparse.csr_array(model.wire_matrix))
    node = sparse.kron(sparse.eye_array(len(wire.node_m)), np.ones((1, 3)), format="csr") @ moves
    coupled = sparse.triu(node @ abs(model.matrices(model.parameters.initial)[0]) @ node.T, k=1, format="coo")
    coupled.eliminate_zeros()
    few = coupled.nnz <= MOST_NEIGHBOURS / 2 * len(wire.node_m)
    return np.column_stack([coupled.row, coupled.col]) if few else np.empty((0, 2), int)


def _cosine(place: np.ndarray, at: int, one: int, other: int) -> float:
    """Of the angle between two lines from a node."""
    first, second = place[one] - place[at], place[other] - place[at]
    return float(first @ second / np.sqrt((first @ first) * (second @ second)))


def _straight_run(
    model: AffineModel, place: np.ndarray, beside: Mapping[int, Sequence[int]], start: int, first: int
) -> list[int]:
    """The nodes from one on, its neighbour first, as far as the line is straight, moves and is within reach."""
    found, at = [], first
    moves = sparse.csr_array(model.wire_matrix)
    while True:
        far = float(np.linalg.norm(place[at] - place[start]))
        if (found and far > REACH_M) or not moves[3 * at : 3 * at + 3].nnz:
            return found
        found.append(at)
        on = [k for k in beside[at] if np.linalg.norm(place[k] - place[start]) > far
              and _cosine(place, start, at, k) > STRAIGHT]
        if not on:
            return found
        at = min(on, key=lambda k: np.linalg.norm(place[k] - place[start]))
