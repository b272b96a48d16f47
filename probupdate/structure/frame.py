"""What a structure is made of once it is meshed: nodes, beams, ties, bodies, springs. Any reader may produce it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from probupdate.structure.beam import Tube
from probupdate.structure.coefficient import Coefficient, Factor, Values


@dataclass(frozen=True)
class TubeProperty:
    """A picklable function of the parameters: one geometric property of a tube."""

    tube: Tube
    name: str

    def __call__(self, values: Values):
        return getattr(self.tube, self.name)(values)


def tube_property(tube: Tube, name: str) -> Coefficient:
    """`name` of Tube (area, second_moment, ...) as a coefficient."""
    key = ("tube", tube, name)
    return Coefficient(1.0, (Factor(key=key, names=tube.names, function=TubeProperty(tube, name)),))


@dataclass(frozen=True, eq=False, kw_only=True)
class LineMass:
    """Mass per metre that moves with a beam without spinning about its axis.

    `transverse_only` for added mass. With `moments` (7 coefficients, int c xi^m dx over the covered part of the
    beam) in place of a uniform `per_metre`, only part of the beam carries it. `dry` masses count as weight.
    """

    per_metre: Coefficient
    transverse_only: bool = False
    dry: bool = False
    grown: bool = False
    moments: tuple[Coefficient, ...] | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class LineSpring:
    """Winkler springs along a beam as moments of their density: lateral (7 coefficients), axial (3), and where it is
    held against spinning about its axis too, torsional (3)."""

    lateral: tuple[Coefficient, ...]
    axial: tuple[Coefficient, ...]
    torsional: tuple[Coefficient, ...] = ()


@dataclass(frozen=True, eq=False, kw_only=True)
class Hinge:
    """A connection at one end of a beam (0 its start, 1 its end) that gives way by the sum of the parameters `bending`
    in rad/(GN m), about both transverse axes alike, and by that of `slip` in m/GN along the beam."""

    end: int
    bending: tuple[str, ...] = ()
    slip: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, kw_only=True)
class Beam:
    """A straight uniform tube between two nodes. `stiffness` multiplies E and G, `axial` and `bending` (with torsion)
    one of both stiffnesses more; `shear` names parameters, shares of the flexibility in shear that are counted beyond
    what the theory does; `part` is the member's name."""

    start: int
    end: int
    group: str
    part: str
    tube: Tube
    youngs_modulus_pa: float
    poisson_ratio: float
    density_kgpm3: float
    stiffness: Coefficient = field(default_factory=Coefficient)
    axial: Coefficient = field(default_factory=Coefficient)
    bending: Coefficient = field(default_factory=Coefficient)
    shear: tuple[str, ...] = ()
    hinge: Hinge | None = None
    carried: tuple[LineMass, ...] = ()
    springs: LineSpring | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Tie:
    """`node` moves with `master` as one rigid body, but for the relative motions `released` (k, 6), global axes,
    which become degrees of freedom of their own with the springs `stiffness` (k coefficients)."""

    node: int
    master: int
    released: np.ndarray = field(default_factory=lambda: np.zeros((0, 6)))
    stiffness: tuple[Coefficient, ...] = ()


@dataclass(frozen=True, eq=False, kw_only=True)
class Body:
    """A point mass with an inertia tensor (3, 3) about its own centre, in global axes: the constant inertia_kgm2 and
    tensors times coefficients, `spin`. `shift`: parameters (names) that move it from its node along unit vectors (3,).
    """

    node: int
    mass: Coefficient
    inertia_kgm2: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    spin: tuple[tuple[Coefficient, np.ndarray], ...] = ()
    shift: tuple[tuple[str, np.ndarray], ...] = ()


@dataclass(frozen=True, eq=False, kw_only=True)
class Prestress:
    """Geometric stiffness of the member forces under a load times a coefficient: the dry weight under gravity_mps2,
    or with a node the force (3,) there."""

    coefficient: Coefficient
    gravity_mps2: float = 0.0
    node: int | None = None
    force_n: np.ndarray = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True, eq=False, kw_only=True)
class NodeSpring:
    """A spring to the ground along `direction` (6,), translation and rotation in global axes."""

    node: int
    direction: np.ndarray
    stiffness: Coefficient


@dataclass(frozen=True, eq=False, kw_only=True)
class Support:
    """Held motions of a node, (6,) bool."""

    node: int
    held: np.ndarray = field(default_factory=lambda: np.ones(6, bool))


@dataclass(frozen=True, eq=False, kw_only=True)
class Frame:
    """A meshed structure. node_m (n_node, 3); `pile_head` the node whose stiffness is that of the pile `pile_part`;
    `nacelle` the nodes, tied to one master, that turn with all on them about the vertical through it."""

    node_m: np.ndarray
    beams: tuple[Beam, ...]
    ties: tuple[Tie, ...] = ()
    bodies: tuple[Body, ...] = ()
    springs: tuple[NodeSpring, ...] = ()
    supports: tuple[Support, ...] = ()
    prestress: tuple[Prestress, ...] = ()
    pile_head: int | None = None
    pile_part: str | None = None
    nacelle: tuple[int, ...] = ()

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of all members, in order."""
        return tuple(dict.fromkeys(beam.part for beam in self.beams))

    def lines(self) -> tuple[np.ndarray, tuple[str, ...]]:
        """Every beam, and the arms to bodies, as pairs of nodes (n_line, 2) with their groups."""
        pairs = [(b.start, b.end) for b in self.beams]
        groups = [b.group for b in self.beams]
        carrying = {body.node for body in self.bodies}
        for tie in self.ties:
            if tie.node in carrying:
                pairs.append((tie.master, tie.node))
                groups.append("rna")
        return np.array(pairs, int).reshape(-1, 2), tuple(groups)
