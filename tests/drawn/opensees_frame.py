"""Modes of a skeleton by OpenSees: Timoshenko tubes of several elements each, mass lumped at their ends."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import opensees_loader

from drawn.skeleton import Skeleton, tube

RIGID = 1e13  # N/m and N m/rad where a spring joins rigidly
LEAST = 1e-3  # kg and kg m2 of a node that carries none: the Lanczos solver asks for a mass


class Build:
    """One model of OpenSees, which keeps a single one; of_member: nodes, member and shear area of each element.
    in_shear: factor on shear areas, large where a model neglects shear."""

    def __init__(self, s: Skeleton, in_shear: float = 1.0):
        self.in_shear = in_shear
        self.ops, self.s = opensees_loader.load_opensees(), s
        self.ops.wipe()
        self.ops.model("basic", "-ndm", 3, "-ndf", 6)
        self.tag = {name: k + 1 for k, name in enumerate(s.place)}
        self.at = {self.tag[name]: np.asarray(p, float) for name, p in s.place.items()}
        for tag, at in self.at.items():
            self.ops.node(tag, *map(float, at))
        self.mass: dict[int, np.ndarray] = {}
        self.of_member: dict[int, tuple] = {}
        self.element = 0
        for member in s.members:
            self._member(member)
        for body in s.bodies:
            own = self.mass.setdefault(self.tag[body.node], np.zeros(6))
            own += np.r_[[body.mass] * 3, body.inertia]
        for name in s.held:
            self.ops.fix(self.tag[name], *[1] * 6)
        for name in s.level_only:
            self.ops.fix(self.tag[name], 0, 0, 1, 1, 1, 1)
        for lead, follower in s.rigid:
            self.ops.rigidLink("beam", self.tag[lead], self.tag[follower])
        for spring in s.springs:
            self._spring(spring)
        for a, b, stiffness in s.bars:
            self._bar(self.tag[a], self.tag[b], stiffness)
        for tag, values in self.mass.items():
            self.ops.mass(tag, *map(float, values))

    def _node(self, at: np.ndarray) -> int:
        tag = len(self.at) + 1
        self.at[tag] = at
        self.ops.node(tag, *map(float, at))
        return tag

    def _member(self, m) -> None:
        start, end = self.at[self.tag[m.a]], self.at[self.tag[m.b]]
        nodes = [self.tag[m.a], *(self._node(start + (end - start) * k / m.pieces) for k in range(1, m.pieces)),
                 self.tag[m.b]]
        area, second = tube(m.diameter, m.wall)
        nu, ratio = m.steel.poisson, (1 - 2 * m.wall / m.diameter) ** 2
        # Cowper (1966)
        shear = area * 6 * (1 + nu) * (1 + ratio) ** 2 / ((7 + 6 * nu) * (1 + ratio) ** 2 + (20 + 12 * nu) * ratio)
        shear *= self.in_shear
        length = float(np.linalg.norm(end - start)) / m.pieces
        axis = (end - start) / np.linalg.norm(end - start)
        across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        half = 0.5 * length * (m.steel.density * area + m.along_kgpm + m.across_kgpm * (1 - axis**2))
        # of the steel's section, 2 I about the axis and I across it, as far as a diagonal holds it
        turning = 0.5 * length * m.steel.density * second * (1 + axis**2)
        for a, b in pairwise(nodes):
            self.element += 1
            self.ops.geomTransf("Linear", self.element, *map(float, across))
            self.ops.element("ElasticTimoshenkoBeam", self.element, a, b, m.steel.E, m.steel.G, area, 2 * second,
                             second, second, shear, shear, self.element)
            self.of_member[self.element] = (a, b, m, shear)
            for node in (a, b):
                self.mass.setdefault(node, np.zeros(6))[:] += np.r_[half, turning]

    def _spring(self, p) -> None:
        other = self.tag[p.other] if p.other else self._node(self.at[self.tag[p.node]])
        if p.other is None:
            self.ops.fix(other, *[1] * 6)
        self.element += 1
        kept = [k for k in range(6) if p.stiffness[k] > 0]
        for k in kept:
            self.ops.uniaxialMaterial("Elastic", 10 * self.element + k, float(min(p.stiffness[k], RIGID)))
        if kept:
            self.ops.element("zeroLength", self.element, other, self.tag[p.node], "-mat",
                             *[10 * self.element + k for k in kept], "-dir", *[k + 1 for k in kept], "-orient", *p.x,
                             *p.y)

    def _bar(self, a: int, b: int, stiffness: float) -> None:
        self.element += 1
        length = float(np.linalg.norm(self.at[b] - self.at[a]))
        self.ops.uniaxialMaterial("Elastic", 10 * self.element, stiffness * length)
        self.ops.element("Truss", self.element, a, b, 1.0, 10 * self.element)


def modes(s: Skeleton, count: int, names) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (count,) in Hz and motions (n_node, 6, count), translations and rotations, at the named nodes."""
    build = Build(s)
    ops = build.ops
    ops.constraints("Transformation")
    ops.numberer("RCM")
    ops.system("UmfPack")
    value = np.array(ops.eigen("-genBandArpack", count))
    shape = np.array([[ops.nodeEigenvector(build.tag[name], k + 1) for k in range(count)] for name in names])
    return np.sqrt(value) / (2 * np.pi), shape.transpose(0, 2, 1)
