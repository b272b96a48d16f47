"""What of a turbine stands below its tower, as a SubDyn input file.

Written are tubes, rigid and flexible connections, lumped masses and the soil; each pile in the ground is one soil file
at its head, its stiffness condensed and its mass reduced by Guyan. What SubDyn has no word for, or OpenFAST computes
elsewhere, is left out: `LEFT_OUT`. Layout: OpenFAST v4 (SubDyn manual, section input files).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from probupdate.io.ssi_file import PLACES, parse_ssi
from probupdate.io.subdyn_file import SubDynFile, parse_subdyn
from probupdate.structure.assembly import Contribution, body_mass, rigid_motion, supporting_matrices
from probupdate.structure.coefficient import Values
from probupdate.structure.frame import Beam, Frame, Tie

NOT_WRITTEN = ("added mass, growth and filling of members in water, which HydroDyn computes",
            "the softening by the structure's own weight")
# kinds of effects it has no word for
UNSPOKEN = ("hinge", "slip", "shear")
# of what a connection does not release, over the stiffest beam in it: SubDyn's springs have no rigid directions
RIGID = 1e4
SAME_PLACE_M = 1e-9

HEAD = """----------- SubDyn input file --------------------------------------------------
{title}
-------------------------- SIMULATION CONTROL ---------------------------------
False            Echo        - Echo input data to "<rootname>.SD.ech" (flag)
"DEFAULT"        SDdeltaT    - Local integration step (s)
             3   IntMethod   - Integration method [1/2/3/4 = RK4/AB4/ABM4/AM2]
True             SttcSolve   - Solve dynamics about static equilibrium point
-------------------- FEA and CRAIG-BAMPTON PARAMETERS -------------------------
             {theory}   FEMMod      - [1= Euler-Bernoulli; 3= Timoshenko]
             1   NDiv        - Number of sub-elements per member
             8   Nmodes      - Number of internal modes to retain
             1   JDampings   - Damping ratios of the retained modes (%)
             0   GuyanDampMod - Guyan damping [0=none, 1=Rayleigh, 2=6x6 matrix]
  0.000, 0.000   RayleighDamp - Mass and stiffness proportional damping
             6   GuyanDampSize - Size of the Guyan damping matrix
""" + "  0.0  0.0  0.0  0.0  0.0  0.0\n" * 6
OUTPUT = """---------------------------- OUTPUT: SUMMARY & OUTFILE -------------------------
True             SumPrint    - Output a summary file (flag)
             0   OutCBModes  - Output Guyan and Craig-Bampton modes
             0   OutFEMModes - Output first 30 FEM modes
False            OutCOSM     - Output cosine matrices (flag)
False            OutAll      - Output all members' end forces (flag)
             1   OutSwtch    - [1=SD.out, 2=FAST's outfile, 3=both]
True             TabDelim    - Tab-delimited output
             1   OutDec      - Decimation of output
"ES11.4e2"       OutFmt      - Output format for numerical results
"A11"            OutSFmt     - Output format for header strings
------------------------- MEMBER OUTPUT LIST ----------------------------------
             0   NMOutputs   - Number of members whose output is given
MemberID   NOutCnt    NodeCnt
  (-)        (-)        (-)
------------------------- SDOutList -------------------------------------------
END of output channels and end of file.
"""
COLUMNS = {
    "STRUCTURE JOINTS": ("NJoints", "JointID JointXss JointYss JointZss JointType JointDirX JointDirY JointDirZ "
                         "JointStiff"),
    "BASE REACTION JOINTS": ("NReact", "RJointID RctTDXss RctTDYss RctTDZss RctRDXss RctRDYss RctRDZss SSIfile"),
    "INTERFACE JOINTS": ("NInterf", "IJointID ItfTDXss ItfTDYss ItfTDZss ItfRDXss ItfRDYss ItfRDZss"),
    "MEMBERS": ("NMembers", "MemberID MJointID1 MJointID2 MPropSetID1 MPropSetID2 MType COSMID"),
    "CIRCULAR BEAM CROSS-SECTION PROPERTIES": ("NPropSets", "PropSetID YoungE ShearG MatDens XsecD XsecT"),
    "ARBITRARY BEAM CROSS-SECTION PROPERTIES": ("NXPropSets", "PropSetID YoungE ShearG MatDens XsecA XsecAsx XsecAsy "
                                                "XsecJxx XsecJyy XsecJ0"),
    "CABLE PROPERTIES": ("NCablePropSets", "PropSetID EA MatDens T0 CtrlChannel"),
    "RIGID LINK PROPERTIES": ("NRigidPropSets", "PropSetID MatDens"),
    "SPRING ELEMENT PROPERTIES": ("NSpringPropSets", "PropSetID " + " ".join(
        f"k{i}{j}" for i in range(1, 7) for j in range(i, 7))),
    "MEMBER COSINE MATRICES": ("NCOSMs", "COSMID COSM11 COSM12 COSM13 COSM21 COSM22 COSM23 COSM31 COSM32 COSM33"),
    "JOINT ADDITIONAL CONCENTRATED MASSES": ("NCmass", "CMJointID JMass JMXX JMYY JMZZ JMXY JMXZ JMYZ MCGX MCGY MCGZ"),
}


class NoSubDynKeyword(Exception):
    """SubDyn's file has no word for something of the structure."""


def structure_alone(frame: Frame) -> Frame:
    """Without what the file leaves out: what surrounds and fills members in water, and weight's softening."""
    return replace(frame, prestress=(), beams=tuple(
        replace(b, carried=tuple(m for m in b.carried if m.dry or (b.springs is not None and not m.transverse_only)))
        for b in frame.beams))


@dataclass(eq=False, kw_only=True)
class _Tables:
    """Rows of the file while they are collected; numbers of joints by node, or by a name of those added."""

    place: dict[int | str, np.ndarray] = field(default_factory=dict)
    same: dict[int, int] = field(default_factory=dict)
    members: list[tuple[int | str, int | str, str, int]] = field(default_factory=list)
    tubes: dict[tuple[float, ...], int] = field(default_factory=dict)
    springs: list[np.ndarray] = field(default_factory=list)
    mass: dict[int, np.ndarray] = field(default_factory=dict)
    soil: dict[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    held: dict[int, np.ndarray] = field(default_factory=dict)

    def joint(self, node: int | str, at: np.ndarray) -> int | str:
        node = self.same.get(node, node) if isinstance(node, int) else node
        self.place.setdefault(node, at)
        return node

    def add_mass(self, node: int, matrix: np.ndarray) -> None:
        own = self.same.get(node, node)
        self.mass[own] = self.mass.get(own, np.zeros((6, 6))) + matrix

    def add_soil(self, node: int, stiffness: np.ndarray, mass: np.ndarray) -> None:
        own = self.same.get(node, node)
        K, M = self.soil.get(own, (np.zeros((6, 6)), np.zeros((6, 6))))
        self.soil[own] = K + stiffness, M + mass


def subdyn_file_of(frame: Frame, values: Values, above: np.ndarray, foot: int, *, theory: str,
                   title: str) -> SubDynFile:
    """The file of a frame at parameter values (all by name), but of the nodes `above` (n_node,); `foot` is its
    interface joint. Raises NoSubDynKeyword where the structure is more than SubDyn can be given."""
    frame, t = structure_alone(frame), _Tables()
    inner = _piles(frame, values, theory, t)
    kept = [k for k in np.flatnonzero(~above) if k not in inner]
    _refuse_unspeakable([b for b in frame.beams if not above[[b.start, b.end]].any()], values)
    ties = [tie for tie in frame.ties if not above[tie.node]]
    for tie in ties:
        if not len(tie.released) and np.linalg.norm(frame.node_m[tie.node] - frame.node_m[tie.master]) < SAME_PLACE_M:
            t.same[tie.node] = tie.master
    stiffest = _add_beams(frame, values, t, [b for b in frame.beams if b.springs is None
                                             and not above[[b.start, b.end]].any()])
    for number, tie in enumerate(ties):
        _add_tie(frame, values, t, tie, f"tie {number}", stiffest)
    for body in frame.bodies:
        if body.node in kept:
            t.add_mass(body.node, _sum_contributions(body_mass(body), values))
    for spring in frame.springs:
        if spring.node in kept:
            stiffness = float(spring.stiffness.value(values)) * np.outer(spring.direction, spring.direction)
            t.add_soil(spring.node, stiffness, np.zeros((6, 6)))
    t.held.update({s.node: s.held for s in frame.supports if s.node in kept})
    return _file(t, foot, 3 if theory == "timoshenko" else 1, title)


def _sum_contributions(contributions: Iterable[Contribution], values: Values) -> np.ndarray:
    """(6, 6) of contributions at one node."""
    return np.sum([float(c.value(values)) * matrix for _, matrix, c in contributions], axis=0)


def _refuse_unspeakable(beams: Sequence[Beam], values: Values) -> None:
    odd: set[str] = set()
    for b in beams:
        odd |= {name for c in (b.axial, b.bending) if c.value(values) != 1 for f in c.factors for name in f.names}
        odd |= {name for name in (*b.shear, *((*b.hinge.bending, *b.hinge.slip) if b.hinge else ())) if values[name]}
    if odd:
        raise NoSubDynKeyword(f"SubDyn has no word for what {', '.join(sorted(odd))} change")


# piles ---------------------------------------------------------------------------------------------------------------


def _piles(frame: Frame, values: Values, theory: str, t: _Tables) -> set[int]:
    """Soil at the head of every pile, its stiffness condensed and its mass by Guyan's reduction; -> the nodes below the
    heads."""
    soil = [b for b in frame.beams if b.springs is not None]
    others = {node for b in frame.beams if b.springs is None for node in (b.start, b.end)}
    others |= {node for tie in frame.ties for node in (tie.node, tie.master)}
    inside = np.zeros(len(frame.node_m), bool)
    inside[[node for b in soil for node in (b.start, b.end)]] = True
    gone = set(np.flatnonzero(inside).tolist()) - others
    # what is at a head itself is the structure's
    alone = Frame(node_m=frame.node_m, beams=tuple(soil), bodies=tuple(x for x in frame.bodies if x.node in gone),
                  springs=tuple(x for x in frame.springs if x.node in gone))
    K, M, motion = supporting_matrices(alone, values, inside, theory=theory, gravity_mps2=None)
    column = motion.argmax(axis=1) if motion.shape[1] else np.zeros(0, int)
    for nodes in _chains(soil):
        heads = [node for node in nodes if node not in gone]
        if len(heads) != 1:
            raise NoSubDynKeyword(f"a pile is joined to the structure at {len(heads)} places")
        own = np.array([heads[0], *(node for node in nodes if node in gone)])
        rows = column[(6 * own[:, None] + np.arange(6)).ravel()]
        stiffness, mass = (X[rows][:, rows].toarray() for X in (K, M))
        moved = np.vstack([np.eye(6), -np.linalg.solve(stiffness[6:, 6:], stiffness[6:, :6])])
        t.add_soil(heads[0], moved.T @ stiffness @ moved, moved.T @ mass @ moved)
    return gone


def _chains(beams: Sequence[Beam]) -> Iterator[list[int]]:
    """Nodes of beams that hang together, as each pile's do."""
    left = list(beams)
    while left:
        nodes = {left[0].start, left[0].end}
        while found := [b for b in left if b.start in nodes or b.end in nodes]:
            nodes |= {node for b in found for node in (b.start, b.end)}
            left = [b for b in left if b not in found]
        yield sorted(nodes)


# members -------------------------------------------------------------------------------------------------------------


def _add_beams(frame: Frame, values: Values, t: _Tables, beams: Sequence[Beam]) -> tuple[float, float]:
    """-> the stiffest of them along and in bending, N/m and N m/rad."""
    stiffest = [0.0, 0.0]
    for b in beams:
        start, end = frame.node_m[b.start], frame.node_m[b.end]
        length, e = float(np.linalg.norm(end - start)), b.youngs_modulus_pa * float(b.stiffness.value(values))
        outer, wall = (float(x) for x in (b.tube.outer(values), b.tube.wall(values)))
        row = (e, e / (2 * (1 + b.poisson_ratio)), b.density_kgpm3, outer, wall)
        number = t.tubes.setdefault(row, len(t.tubes) + 1)
        t.members.append((t.joint(b.start, start), t.joint(b.end, end), "1c", number))
        half = 0.5 * length * sum(float(m.per_metre.value(values)) for m in b.carried)
        for node in (b.start, b.end):
            t.add_mass(node, np.diag([half] * 3 + [0.0] * 3))
        found = e * float(b.tube.area(values)) / length, e * float(b.tube.second_moment(values)) / length
        stiffest = [max(pair) for pair in zip(stiffest, found, strict=True)]
    return stiffest[0], stiffest[1]


def _add_tie(frame: Frame, values: Values, t: _Tables, tie: Tie, name: str, stiffest: tuple[float, float]) -> None:
    at, lead = frame.node_m[tie.node], frame.node_m[tie.master]
    apart = np.linalg.norm(at - lead) >= SAME_PLACE_M
    master, node = t.joint(tie.master, lead), t.joint(tie.node, at)
    if not len(tie.released):
        if apart:
            t.members.append((master, node, "3", 1))
        return
    if apart:
        beside = t.joint(name, at)
        t.members.append((master, beside, "3", 1))
        master = beside
    way = np.asarray(tie.released)
    if not np.allclose(way @ way.T, np.eye(len(way))):
        raise NoSubDynKeyword("a connection gives way along directions that are not at right angles")
    rigid = RIGID * np.diag([stiffest[0]] * 3 + [stiffest[1]] * 3)
    held = np.eye(6) - way.T @ way
    stiffness = [float(c.value(values)) for c in tie.stiffness]
    t.springs.append(way.T @ np.diag(stiffness) @ way + held @ rigid @ held)
    t.members.append((master, node, "5", len(t.springs)))


# text ----------------------------------------------------------------------------------------------------------------


def _table(title: str, rows: Sequence[str]) -> list[str]:
    count, columns = COLUMNS[title]
    units = " ".join("(-)" for _ in columns.split())
    return [f"---------------------------- {title} ----------------------------", f"  {len(rows)}   {count}", columns,
            units, *(f"  {row}" for row in rows)]


def _words(values: Iterable[float]) -> str:
    return " ".join(f"{float(v):.15g}" for v in values)


def _body_words(matrix: np.ndarray) -> str:
    """Mass, inertia about the centre and the centre's place, of a rigid body's matrix (6, 6) at a joint."""
    m = matrix[0, 0]
    centre = np.zeros(3) if m == 0 else np.array([matrix[1, 5], matrix[2, 3], matrix[0, 4]]) / m
    arm = rigid_motion(centre)[:3, 3:]
    j = matrix[3:, 3:] - m * arm.T @ arm
    return _words([m, j[0, 0], j[1, 1], j[2, 2], j[0, 1], j[0, 2], j[1, 2], *centre])


def _file(t: _Tables, foot: int, theory: int, title: str) -> SubDynFile:
    number = {name: k for k, name in enumerate(t.place, 1)}
    soil: Mapping[str, list[str]] = {
        f"soil_{number[node]}.txt": [f"{matrix[place]:.15g} {letter}{name}" for letter, matrix in zip("KM", pair,
                                     strict=True) for name, place in PLACES.items() if matrix[place]]
        for node, pair in t.soil.items()}
    reactions = [f'{number[node]} {" ".join(str(int(x)) for x in t.held.get(node, np.zeros(6)))} "'
                 f'{f"soil_{number[node]}.txt" if node in t.soil else ""}"' for node in {**t.soil, **t.held}]
    rows = {
        "STRUCTURE JOINTS": [f"{number[name]} {_words(at)} 1 0 0 0 0" for name, at in t.place.items()],
        "BASE REACTION JOINTS": reactions,
        "INTERFACE JOINTS": [f"{number[t.same.get(foot, foot)]} 1 1 1 1 1 1"],
        "MEMBERS": [f"{k} {number[a]} {number[b]} {row} {row} {kind} -1"
                    for k, (a, b, kind, row) in enumerate(t.members, 1)],
        "CIRCULAR BEAM CROSS-SECTION PROPERTIES": [f"{k} {_words(row)}" for row, k in t.tubes.items()],
        "RIGID LINK PROPERTIES": ["1 0"] if any(m[2] == "3" for m in t.members) else [],
        "SPRING ELEMENT PROPERTIES": [f"{k} {_words(K[np.triu_indices(6)])}" for k, K in enumerate(t.springs, 1)],
        "JOINT ADDITIONAL CONCENTRATED MASSES": [f"{number[node]} {_body_words(M)}" for node, M in t.mass.items()
                                                 if M.any()],
    }
    lines = [*HEAD.format(title=title, theory=theory).splitlines(),
             *(line for name in COLUMNS for line in _table(name, rows.get(name, []))), *OUTPUT.splitlines()]
    return parse_subdyn(lines, title, lambda name, line: parse_ssi(soil[name], name, name))
