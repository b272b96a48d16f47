"""Stiffness of one pile at its head, what an engineer can judge the soil factors by (Table 6 of the paper)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy import sparse
from scipy.sparse import linalg as sparse_linalg

from probupdate.structure.assembly import AssembledFrame, assemble, node_dofs
from probupdate.structure.frame import Frame


def pile_frame(frame: Frame) -> Frame:
    """The pile alone with its springs; nodes keep their order among themselves."""
    if frame.pile_head is None:
        raise ValueError("a frame without piles has no pile of its own")
    kept = [beam for beam in frame.beams if beam.part == frame.pile_part]
    nodes = sorted({node for beam in kept for node in (beam.start, beam.end)})
    number = {node: k for k, node in enumerate(nodes)}

    def renumber(item, *names):
        values = {name: getattr(item, name) for name in item.__dataclass_fields__}
        return type(item)(**(values | {name: number[values[name]] for name in names}))

    return Frame(
        node_m=frame.node_m[nodes],
        beams=tuple(renumber(beam, "start", "end") for beam in kept),
        springs=tuple(renumber(spring, "node") for spring in frame.springs if spring.node in number),
        pile_head=number[frame.pile_head],
        pile_part=frame.pile_part,
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class PileHead:
    """theta -> stiffness in N/m of the pile's head in one direction, its other motions held; picklable.

    `direction` counts among the head's six motions: 0 for k_xy (rotation held), 2 for k_z.
    """

    pile: AssembledFrame
    head: int
    direction: int

    def __call__(self, theta: np.ndarray) -> float:
        return float(head_stiffness(self.pile, self.head, np.asarray(theta, float))[self.direction, self.direction])


def head_stiffness(pile: AssembledFrame, head: int, theta: np.ndarray) -> np.ndarray:
    """(6, 6): the pile's stiffness condensed to its head node."""
    weights, _ = pile.coefficients(theta)
    K = sparse.csc_matrix(sum(w * term for w, term in zip(weights, pile.stiffness, strict=True)))
    held = node_dofs(head)
    # without the soil a pile may spin freely about its axis below a held head; it does not, the head is held
    free = np.setdiff1d(np.arange(K.shape[0]), held)
    coupling = K[np.ix_(free, held)].toarray()
    return K[np.ix_(held, held)].toarray() - coupling.T @ sparse_linalg.spsolve(K[np.ix_(free, free)], coupling)


def pile_head_stiffness(frame: Frame, *, updated, values, theory: str) -> dict[str, PileHead]:
    """{"k_xy": ..., "k_z": ...}, callables of theta in N/m, for any one of the equal piles."""
    pile = pile_frame(frame)
    assembled = assemble(pile, updated=updated, values=values, theory=theory)
    head = cast(int, pile.pile_head)
    return {name: PileHead(pile=assembled, head=head, direction=k) for name, k in (("k_xy", 0), ("k_z", 2))}
