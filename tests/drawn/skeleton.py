"""A space frame as plain tables, and the state that it is in: what every drawn frame is solved and written from."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Steel:
    """E and G in Pa, density in kg/m3."""

    E: float = 2.1e11
    G: float = 2.1e11 / 2.6
    density: float = 7850.0

    @property
    def poisson(self) -> float:
        return self.E / (2 * self.G) - 1


@dataclass(frozen=True, kw_only=True)
class Member:
    """A tube between two nodes, `pieces` elements of it; kg/m that move with it, and across it only."""

    a: str
    b: str
    diameter: float
    wall: float
    steel: Steel
    tags: Mapping[str, object] = field(default_factory=dict)
    along_kgpm: float = 0.0
    across_kgpm: float = 0.0
    pieces: int = 1
    pinned: bool = False


@dataclass(frozen=True, kw_only=True)
class Body:
    """A mass in kg with diagonal inertia in kg m2 at a node."""

    node: str
    mass: float
    inertia: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tags: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Spring:
    """Six stiffnesses between a node and another at its place, or the ground, in axes x and y; inf joins rigidly."""

    node: str
    other: str | None = None
    stiffness: tuple[float, ...] = (0.0,) * 6
    x: tuple[float, float, float] = (1.0, 0.0, 0.0)
    y: tuple[float, float, float] = (0.0, 1.0, 0.0)
    tags: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Skeleton:
    """`place` of each node in m; `rigid`: (lead, follower); `held`: nodes that do not move; `bars`: (node, node, N/m)
    along the line between two nodes."""

    place: Mapping[str, np.ndarray]
    members: tuple[Member, ...]
    bodies: tuple[Body, ...] = ()
    springs: tuple[Spring, ...] = ()
    rigid: tuple[tuple[str, str], ...] = ()
    held: tuple[str, ...] = ()
    bars: tuple[tuple[str, str, float], ...] = ()
    # nodes that move along x and y only
    level_only: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Change:
    """`what` is changed at everything whose tags hold all of `on`; factors are multiplied, amounts added."""

    what: str
    on: Mapping[str, object]
    value: float

    def acts_on(self, tags: Mapping[str, object]) -> bool:
        return all(tags.get(key) == value for key, value in self.on.items())


@dataclass(frozen=True, kw_only=True)
class Attached:
    """What stands in no file: a spring in N/m from a node to the ground (`direction`) or to another node, or a mass in
    kg that swings both ways at a frequency in Hz."""

    node: str
    other: str | None = None
    direction: tuple[float, float, float] | None = None
    stiffness: float = 0.0
    mass: float = 0.0
    frequency_hz: float = 0.0


@dataclass(frozen=True, kw_only=True)
class State:
    changes: tuple[Change, ...] = ()
    attached: tuple[Attached, ...] = ()

    def factor(self, what: str, tags: Mapping[str, object]) -> float:
        return math.prod(c.value for c in self.changes if c.what == what and c.acts_on(tags))

    def amount(self, what: str, tags: Mapping[str, object]) -> float:
        return sum(c.value for c in self.changes if c.what == what and c.acts_on(tags))

    def with_changes(self, *changes: Change) -> State:
        return replace(self, changes=(*self.changes, *changes))


def tube(diameter: float, wall: float) -> tuple[float, float]:
    """Area and second moment."""
    outer, inner = diameter / 2, diameter / 2 - wall
    return math.pi * (outer**2 - inner**2), math.pi / 4 * (outer**4 - inner**4)


def in_state(s: Skeleton, state: State) -> Skeleton:
    """With factors on stiffness and wall of members, on masses and springs, kg spread over members or put on nodes,
    and what is attached."""
    members = []
    for m in s.members:
        E = state.factor("stiffness", m.tags)
        steel = replace(m.steel, E=m.steel.E * E, G=m.steel.G * E)
        length = float(np.linalg.norm(s.place[m.b] - s.place[m.a]))
        more = state.amount("line mass", m.tags)
        members.append(replace(m, steel=steel, wall=m.wall * state.factor("wall", m.tags),
                               along_kgpm=m.along_kgpm + more,
                               across_kgpm=m.across_kgpm * state.factor("water", m.tags)))
        assert length > 0, m
    bodies = [replace(b, mass=b.mass * state.factor("mass", b.tags) + state.amount("body mass", b.tags),
                      inertia=tuple(i * state.factor("mass", b.tags) for i in b.inertia)) for b in s.bodies]
    springs = [replace(p, stiffness=tuple(k * state.factor("spring", p.tags) * state.factor(f"spring {n}", p.tags)
                                          for n, k in enumerate(p.stiffness))) for p in s.springs]
    return _attach(replace(s, members=tuple(members), bodies=tuple(bodies), springs=tuple(springs)), state.attached)


def _attach(s: Skeleton, attached) -> Skeleton:
    place, bodies, springs, bars, level = dict(s.place), [*s.bodies], [*s.springs], [*s.bars], [*s.level_only]
    for number, one in enumerate(attached):
        if one.mass:
            swings = f"swinging {number}"
            place[swings] = place[one.node]
            k = one.mass * (2 * math.pi * one.frequency_hz) ** 2
            bodies.append(Body(node=swings, mass=one.mass))
            springs.append(Spring(node=swings, other=one.node, stiffness=(k, k, 0, 0, 0, 0)))
            level.append(swings)
        elif one.other is not None:
            bars.append((one.node, one.other, one.stiffness))
        else:
            x, y, _ = one.direction
            springs.append(Spring(node=one.node, stiffness=(one.stiffness, 0, 0, 0, 0, 0), x=(x, y, 0.0),
                                  y=(-y, x, 0.0)))
    return replace(s, place=place, bodies=tuple(bodies), springs=tuple(springs), bars=tuple(bars),
                   level_only=tuple(level))
