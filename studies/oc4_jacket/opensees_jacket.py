"""The OC4 jacket with tower and rotor-nacelle assembly in OpenSees, from the tables of its SubDyn file.

Another theory and other code than the model that is diagnosed: Timoshenko tubes, several to a member, lumped mass
without rotary inertia, the water's mass across each member and up to the waterline only, pile heads as springs at
the depth that their coupled stiffness has. The tables are read here by rows and columns; nothing of `probupdate` is
used. """

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))
import opensees_loader

INPUT, SOIL = "owt_soil_eb.dat", "OC4_Jacket_SD_SSI.txt"
PIECE_M = 2.5  # no longer element in the jacket
WATER_KGPM3, GROWTH_KGPM3 = 1025.0, 1100.0
ADDED_MASS = 1.0  # coefficient of the displaced water, across a member
PER_KELVIN = -3.6e-4  # of E and G of steel, as in the virtual turbine
TRANSITION, TOP = 100, 135  # joints: middle of the transition piece, tower top
TABLES = ("STRUCTURE JOINTS", "BASE REACTION", "MEMBERS", "CIRC", "ARB", "CM")
PRODUCT_ARM_M = 2.0  # of the two bodies that carry the assembly's product of inertia


def read_tables(path: Path) -> dict[str, list[list[str]]]:
    """Rows of words of each table of a SubDyn file, by the heading's first words; a table is a count and two lines of
    headings."""
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    tables, heading, k = {}, "", 0
    while k < len(lines):
        line = lines[k]
        words = line.split()
        if line.startswith("--"):
            heading = line.strip("- ").strip()
        elif heading in TABLES and heading not in tables and words:
            count = int(words[0])
            tables[heading] = [row.split() for row in lines[k + 3 : k + 3 + count]]
            k += 2 + count
        k += 1
    return tables


@dataclass(frozen=True)
class Description:
    """What the tables say: joints' places in m; members (id, joints, set, kind); circular sets (E, G, density,
    diameter, wall); arbitrary sets (E, G, density, A, shear areas, second moments, torsion); masses; piles with
    their soil."""

    place: dict[int, np.ndarray]
    circular: dict[int, tuple[int, int, int]]
    tower: dict[int, tuple[int, int, int]]
    rigid: tuple[tuple[int, int], ...]
    tubes: dict[int, tuple[float, ...]]
    sections: dict[int, tuple[float, ...]]
    masses: dict[int, tuple[float, ...]]
    piles: tuple[int, ...]
    soil: dict[str, float]


def read_description(folder: Path) -> Description:
    t = read_tables(folder / INPUT)
    members = {int(r[0]): (int(r[1]), int(r[2]), int(r[3]), r[5]) for r in t["MEMBERS"]}
    numbers = {}
    for line in (folder / SOIL).read_text(encoding="utf-8").splitlines():
        words = line.split()
        if len(words) >= 2 and words[1][0] == "K":
            numbers[words[1]] = float(words[0])
    return Description(
        place={int(r[0]): np.array([float(x) for x in r[1:4]]) for r in t["STRUCTURE JOINTS"]},
        circular={k: m[:3] for k, m in members.items() if m[3] == "1c"},
        tower={k: m[:3] for k, m in members.items() if m[3] == "4"},
        rigid=tuple(m[:2] for m in members.values() if m[3] == "3"),
        tubes={int(r[0]): tuple(map(float, r[1:6])) for r in t["CIRC"]},
        sections={int(r[0]): tuple(map(float, r[1:11])) for r in t["ARB"]},
        masses={int(r[0]): tuple(map(float, r[1:11])) for r in t["CM"]},
        piles=tuple(int(r[0]) for r in t["BASE REACTION"]),
        soil=numbers,
    )


@dataclass(frozen=True, kw_only=True)
class Attached:
    """What stands in no table: between a joint and `other` (None: the ground) a spring in N/m along the line between
    them or along `direction`; or at the joint a mass in kg that swings both ways by itself at a frequency in Hz."""

    joint: int
    other: int | None = None
    direction: tuple[float, float, float] | None = None
    stiffness: float = 0.0
    mass: float = 0.0
    frequency_hz: float = 0.0


@dataclass(frozen=True, kw_only=True)
class State:
    """What is true in one half hour, all neutral by default: factors on E and G of members and on the walls of tubes;
    growth in m on members; factors on a pile's lateral and axial stiffness and m by which its springs lie deeper;
    factors on the tower's E and G, the rotor-nacelle mass, that of the transition piece, the water's mass; water level
    in m, steel's temperature above the water in K beyond the mean; what is attached."""

    stiffness: Mapping[int, float] = field(default_factory=dict)
    wall: Mapping[int, float] = field(default_factory=dict)
    growth_m: Mapping[int, float] = field(default_factory=dict)
    lateral: Mapping[int, float] = field(default_factory=dict)
    axial: Mapping[int, float] = field(default_factory=dict)
    deeper_m: Mapping[int, float] = field(default_factory=dict)
    tower: float = 1.0
    rna: float = 1.0
    transition: float = 1.0
    water_mass: float = 1.0
    water_level_m: float = 0.0
    warmer_k: float = 0.0
    attached: tuple[Attached, ...] = ()


def tube_section(diameter: float, wall: float) -> tuple[float, float]:
    """Area and second moment."""
    outer, inner = diameter / 2, diameter / 2 - wall
    return math.pi * (outer**2 - inner**2), math.pi / 4 * (outer**4 - inner**4)


def cowper(diameter: float, wall: float, nu: float) -> float:
    """Shear coefficient of a circular tube (Cowper 1966)."""
    m2 = (1 - 2 * wall / diameter) ** 2
    return 6 * (1 + nu) * (1 + m2) ** 2 / ((7 + 6 * nu) * (1 + m2) ** 2 + (20 + 12 * nu) * m2)


class Build:
    """One OpenSees model of one state; OpenSees keeps a single model, the last one built."""

    def __init__(self, d: Description, state: State, *, dry: bool = False):
        self.ops, self.d, self.state, self.dry = opensees_loader.load_opensees(), d, state, dry
        self.place = dict(d.place)
        self.mass: dict[int, np.ndarray] = {}
        self.element = 0
        self.ops.wipe()
        self.ops.model("basic", "-ndm", 3, "-ndf", 6)
        for joint, at in d.place.items():
            self.ops.node(joint, *map(float, at))
        for member, (one, two, number) in d.circular.items():
            self._tube(member, one, two, d.tubes[number])
        for _, (one, two, number) in d.tower.items():
            self._tower(one, two, d.sections[number])
        followers = {b: a for a, b in d.rigid}
        for joint, lead in followers.items():
            self.ops.rigidLink("beam", lead, joint)
        for joint, row in d.masses.items():
            self._body(joint, row)
        for pile in d.piles:
            self._pile(pile)
        for one in state.attached:
            self._attach(one)
        for node, values in self.mass.items():
            self.ops.mass(node, *map(float, values))

    def _node(self, at: np.ndarray) -> int:
        tag = max(max(self.place), 1000) + 1
        self.place[tag] = at
        self.ops.node(tag, *map(float, at))
        return tag

    def _carry(self, node: int, mass: np.ndarray | float) -> None:
        own = self.mass.setdefault(node, np.zeros(6))
        own[:3] += mass

    def _line(self, a: int, b: int, *, e, g, area, torsion, second, shear) -> None:
        along = self.place[b] - self.place[a]
        across = np.eye(3)[np.argmin(np.abs(along))]
        self.element += 1
        self.ops.geomTransf("Linear", self.element, *map(float, np.cross(along, across)))
        self.ops.element(
            "ElasticTimoshenkoBeam", self.element, a, b, e, g, area, torsion, second, second, shear, shear, self.element
        )

    def _warm(self, z: float) -> float:
        return 1 + PER_KELVIN * self.state.warmer_k * (z > self.state.water_level_m)

    def _tube(self, member, one, two, values) -> None:
        e, g, density, diameter, wall = values
        wall *= self.state.wall.get(member, 1.0)
        factor = self.state.stiffness.get(member, 1.0)
        area, second = tube_section(diameter, wall)
        shear = cowper(diameter, wall, e / (2 * g) - 1) * area
        start, end = self.place[one], self.place[two]
        n = max(1, math.ceil(np.linalg.norm(end - start) / PIECE_M))
        nodes = [one, *(self._node(start + (end - start) * k / n) for k in range(1, n)), two]
        along = (end - start) / np.linalg.norm(end - start)
        length = np.linalg.norm(end - start) / n
        for a, b in pairwise(nodes):
            warm = factor * self._warm(0.5 * (self.place[a][2] + self.place[b][2]))
            self._line(a, b, e=e * warm, g=g * warm, area=area, torsion=2 * second, second=second, shear=shear)
            # what the water adds moves across the member only
            water = self._per_metre(member, diameter, a, b) * (1 - along**2)
            grown = self._growth_per_metre(member, diameter)
            for node in (a, b):
                self._carry(node, 0.5 * length * (density * area + grown + water))

    def _growth_per_metre(self, member, diameter) -> float:
        t = self.state.growth_m.get(member, 0.0)
        return GROWTH_KGPM3 * math.pi * t * (diameter + t)

    def _per_metre(self, member, diameter, a, b) -> float:
        """Added mass of the water by the wetted share of a length."""
        if self.dry:
            return 0.0
        low, high = sorted((self.place[a][2], self.place[b][2]))
        level = self.state.water_level_m
        wet = float(low < level) if high - low < 1e-9 else float(np.clip((level - low) / (high - low), 0.0, 1.0))
        grown = diameter + 2 * self.state.growth_m.get(member, 0.0)
        return wet * self.state.water_mass * ADDED_MASS * WATER_KGPM3 * math.pi / 4 * grown**2

    def _tower(self, one, two, values) -> None:
        e, g, density, area, *_, ixx, _, j0, torsion = values
        factor = self.state.tower * self._warm(self.place[one][2])
        self._line(one, two, e=e * factor, g=g * factor, area=area, torsion=torsion, second=ixx, shear=values[4])
        length = float(np.linalg.norm(self.place[two] - self.place[one]))
        half = 0.5 * length * density
        for node in (one, two):
            own = self.mass.setdefault(node, np.zeros(6))
            own += half * np.array([area, area, area, ixx, ixx, j0])

    def _body(self, joint, row) -> None:
        """A rigid body with a product of inertia about its centre: OpenSees takes diagonal terms, so that two smaller
        bodies beside it carry J_xz."""
        m, *inertia = row[:4]
        factor = {TOP: self.state.rna, TRANSITION: self.state.transition}[joint]
        jxy, jxz, jyz = row[4:7]
        if jxy or jyz:
            raise ValueError(f"mass at joint {joint}: products of inertia other than xz have no bodies here")
        offset = np.array(row[7:10])
        centre = joint
        if np.any(offset):
            centre = self._node(self.place[joint] + offset)
            self.ops.rigidLink("beam", joint, centre)
        inertia = np.array(inertia)
        if jxz:
            # the matrix has -(sum of m x z) there
            a = PRODUCT_ARM_M
            each = abs(jxz) / (2 * a**2)
            for sign in (1, -1):
                arm = sign * np.array([a, 0.0, -a * np.sign(jxz)])
                body = self._node(self.place[centre] + arm)
                self.ops.rigidLink("beam", joint, body)
                self._carry(body, factor * each)
            m, inertia = m - 2 * each, inertia - 2 * each * a**2 * np.array([1.0, 2.0, 1.0])
        own = self.mass.setdefault(centre, np.zeros(6))
        own += factor * np.r_[m, m, m, inertia]

    def _pile(self, pile) -> None:
        """Kxx, Kyy and their coupling with rotation are springs at the depth Kytx / Kyy below the pile's head."""
        k, s = self.d.soil, self.state
        lateral = 0.5 * (k["Kxx"] + k["Kyy"])
        depth = 0.5 * (k["Kytx"] - k["Kxty"]) / lateral
        turning = 0.5 * (k["Ktxtx"] + k["Ktyty"]) - lateral * depth**2
        own, axial = s.lateral.get(pile, 1.0), s.axial.get(pile, 1.0)
        at = self.place[pile] - [0, 0, depth + s.deeper_m.get(pile, 0.0)]
        low, ground = self._node(at), self._node(at)
        self.ops.rigidLink("beam", pile, low)
        self.ops.fix(ground, *[1] * 6)
        self.element += 1
        values = [lateral * own, lateral * own, k["Kzz"] * axial, turning * own, turning * own, k["Ktztz"] * own]
        for axis, value in enumerate(values):
            self.ops.uniaxialMaterial("Elastic", 10 * self.element + axis, float(value))
        self.ops.element(
            "zeroLength",
            self.element,
            ground,
            low,
            "-mat",
            *[10 * self.element + axis for axis in range(6)],
            "-dir",
            1,
            2,
            3,
            4,
            5,
            6,
        )

    def _attach(self, one: Attached) -> None:
        self.element += 1
        spring = 10 * self.element
        if one.mass:
            swings = self._node(self.place[one.joint])
            self.ops.fix(swings, 0, 0, 1, 1, 1, 1)
            self._carry(swings, one.mass)
            self.ops.uniaxialMaterial("Elastic", spring, one.mass * (2 * math.pi * one.frequency_hz) ** 2)
            self.ops.element("zeroLength", self.element, one.joint, swings, "-mat", spring, spring, "-dir", 1, 2)
        elif one.other is not None:
            length = float(np.linalg.norm(self.place[one.other] - self.place[one.joint]))
            self.ops.uniaxialMaterial("Elastic", spring, one.stiffness * length)
            self.ops.element("Truss", self.element, one.joint, one.other, 1.0, spring)
        else:
            ground, (x, y, _) = self._node(self.place[one.joint]), one.direction
            self.ops.fix(ground, *[1] * 6)
            self.ops.uniaxialMaterial("Elastic", spring, one.stiffness)
            self.ops.element("zeroLength", self.element, ground, one.joint, "-mat", spring, "-dir", 1,
                             "-orient", x, y, 0.0, -y, x, 0.0)

    def modes(self, n: int, joints) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies (n,) in Hz and translations (n_joint, 3, n) at joints."""
        self.ops.constraints("Transformation")
        self.ops.numberer("RCM")
        self.ops.system("BandGen")
        value = np.array(self.ops.eigen("-genBandArpack", n))
        shape = np.array([[self.ops.nodeEigenvector(joint, k + 1)[:3] for k in range(n)] for joint in joints])
        return np.sqrt(value) / (2 * np.pi), shape.transpose(0, 2, 1)
