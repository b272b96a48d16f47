"""Plans drawn at random of what is written as matrices or as a SubDyn file: buildings, trusses, girder bridges, lattice
towers, monopiles, bare jackets, tripods."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from drawn.skeleton import Body, Member, Skeleton, Spring, Steel


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A factor `what` on everything whose tags hold `on`, 1 as designed."""

    name: str
    what: str
    on: dict
    std: float
    lower: float = 0.05
    upper: float = 3.0


@dataclass(frozen=True, kw_only=True)
class Reading:
    """A channel: the translation along an axis (0, 1, 2) of a node."""

    channel: str
    level: str
    node: str
    axis: int


@dataclass(frozen=True, kw_only=True)
class Plan:
    """`dofs`: which of a node's six motions there are; `anchors`: nodes at which something unknown may be fastened, and
    along which axis; `n_mode` measured."""

    kind: str
    skeleton: Skeleton
    parameters: tuple[Parameter, ...]
    readings: tuple[Reading, ...]
    n_mode: int
    anchors: tuple[tuple[str, int], ...]
    dofs: tuple[int, ...] = (0, 1, 2, 3, 4, 5)
    # elements of a member in the user's files
    pieces: int = 1


def draw(kind: str, rng: np.random.Generator, extent: float, *, bars: bool = True) -> Plan:
    """A plan of that kind whose largest measure is about `extent` metres; bars: braces are bars and not beams."""
    if kind in ("lattice", "jacket"):
        return {"lattice": lattice, "jacket": jacket}[kind](rng, extent, bars)
    return {"building": building, "truss": truss, "bridge": bridge, "monopile": monopile, "tripod": tripod}[kind](
        rng, extent)


def _read(at, axes, label, level=None) -> list[Reading]:
    return [Reading(channel=f"{label}-{'xyz'[a]}", level=level or label, node=at, axis=a) for a in axes]


def _row(name, on, std=0.05, what="stiffness") -> Parameter:
    return Parameter(name=name, what=what, on=on, std=std)


def building(rng, extent) -> Plan:
    """A space frame of two by one bays; columns of each storey and beams of each floor."""
    n = int(rng.integers(2, 7))
    h = extent / n if n > 2 else extent / 3
    wide, deep = h * rng.uniform(1.0, 2.0), h * rng.uniform(0.8, 1.6)
    D, steel = h / rng.uniform(16, 26), Steel()
    place, members, bodies = {}, [], []
    floor_mass = 3.0 * steel.density * math.pi * D**2 * 0.1 * h
    for s in range(n + 1):
        for i in range(3):
            for j in range(2):
                place[f"{s}{i}{j}"] = np.array([i * wide, j * deep, s * h])
                if s:
                    bodies.append(Body(node=f"{s}{i}{j}", mass=floor_mass * rng.uniform(0.7, 1.3),
                                       tags={"floor": s}))
    for s in range(1, n + 1):
        for i in range(3):
            for j in range(2):
                members.append(Member(a=f"{s - 1}{i}{j}", b=f"{s}{i}{j}", diameter=D, wall=D / 12, steel=steel,
                                      tags={"column": s, "side": j}))
        for i, j, k, q in ((0, 0, 1, 0), (1, 0, 2, 0), (0, 1, 1, 1), (1, 1, 2, 1), (0, 0, 0, 1), (1, 0, 1, 1),
                           (2, 0, 2, 1)):
            members.append(Member(a=f"{s}{i}{j}", b=f"{s}{k}{q}", diameter=0.9 * D, wall=D / 16, steel=steel,
                                  tags={"beam": s}))
    parameters = [_row(f"columns_{s}{'fb'[j]}", {"column": s, "side": j}) for s in range(1, n + 1) for j in range(2)]
    parameters += [_row(f"beams_{s}", {"beam": s}) for s in range(1, n + 1)]
    parameters += [_row("mass_top", {"floor": n}, what="mass")]
    floors = sorted({n, *rng.choice(np.arange(1, n + 1), min(n, 3), replace=False).tolist()})
    readings = [r for s in floors for r in (*_read(f"{s}00", (0, 1), f"F{s}a", f"F{s}"),
                                            *_read(f"{s}21", (0, 1), f"F{s}c", f"F{s}"))]
    return Plan(kind="building", parameters=tuple(parameters), readings=tuple(readings), n_mode=min(3 * n, 6),
                skeleton=Skeleton(place=place, members=tuple(members), bodies=tuple(bodies),
                                  held=tuple(k for k in place if k[0] == "0")),
                anchors=tuple((f"{s}20", int(rng.integers(2))) for s in range(1, n + 1)))


def truss(rng, extent) -> Plan:
    """A plane truss of parallel chords on a bearing and a spring; bars alone."""
    n = int(rng.choice([6, 8, 10]))
    panel, steel = extent / n, Steel()
    depth, D = panel * rng.uniform(0.7, 1.3), panel / rng.uniform(12, 20)
    place = {f"b{i}": np.array([i * panel, 0.0, 0.0]) for i in range(n + 1)}
    place |= {f"t{i}": np.array([i * panel, 0.0, depth]) for i in range(1, n)}
    bars = [(f"b{i}", f"b{i + 1}", {"chord": f"low {i * 3 // n}"}) for i in range(n)]
    bars += [(f"t{i}", f"t{i + 1}", {"chord": f"top {i * 3 // n}"}) for i in range(1, n - 1)]
    bars += [(f"b{i}", f"t{i}", {"post": i}) for i in range(1, n)] + [("b0", "t1", {"end": 0}),
                                                                       (f"b{n}", f"t{n - 1}", {"end": 1})]
    bars += [(f"b{i}", f"t{i + 1}", {"diagonal": i}) if i < n // 2 else (f"b{i + 1}", f"t{i}", {"diagonal": i})
             for i in range(1, n - 1)]
    members = tuple(Member(a=a, b=b, diameter=D, wall=D / (6 if "chord" in tags or "end" in tags else 12), steel=steel,
                           tags=tags, pinned=True) for a, b, tags in bars)
    EA = steel.E * math.pi * D * D / 12
    k = float(rng.uniform(1, 5)) * EA / extent
    deck = steel.density * D * D * panel * float(rng.uniform(0.2, 1.5))
    bodies = tuple(Body(node=f"b{i}", mass=deck, tags={"deck": i * 2 // (n + 1)}) for i in range(n + 1))
    springs = (Spring(node="b0", stiffness=(1e3 * k, 0, 1e3 * k, 0, 0, 0)),
               Spring(node=f"b{n}", stiffness=(0, 0, k, 0, 0, 0), tags={"bearing": 1}))
    parameters = [_row(f"{side}{i}", {"chord": f"{side} {i}"}, 0.03) for side in ("low", "top") for i in range(3)]
    parameters += [_row(f"d{i}", {"diagonal": i}, 0.03) for i in range(1, n - 1)]
    parameters += [_row("bearing", {"bearing": 1}, 0.15, "spring"), _row("deck", {"deck": 1}, 0.05, "mass")]
    readings = [Reading(channel=f"V{i}", level="deck left" if i <= n // 2 else "deck right", node=f"b{i}", axis=2)
                for i in range(1, n + 1)]
    readings.append(Reading(channel=f"H{n}", level="deck right", node=f"b{n}", axis=0))
    return Plan(kind="truss", skeleton=Skeleton(place=place, members=members, bodies=bodies, springs=springs),
                parameters=tuple(parameters), readings=tuple(readings), n_mode=int(rng.integers(4, 7)), dofs=(0, 2),
                anchors=(("b2", 2), (f"b{n // 2}", 2), (f"t{n // 2}", 0)))


def bridge(rng, extent) -> Plan:
    """A plane girder over two to four spans on piers, with a bearing's spring at each abutment."""
    spans, per = int(rng.integers(2, 5)), 6
    h, steel = extent / (spans * per), Steel(E=3.5e10, G=1.45e10, density=2500.0)
    D = extent / spans / rng.uniform(12, 20)
    height = extent / spans * float(rng.uniform(0.2, 0.7))
    place = {f"g{k}": np.array([k * h, 0.0, 0.0]) for k in range(spans * per + 1)}
    members = [Member(a=f"g{k}", b=f"g{k + 1}", diameter=D, wall=D / 10, steel=steel,
                      tags={"span": k // per + 1, "half": k % per // (per // 2)}) for k in range(spans * per)]
    held = []
    for p in range(1, spans):
        place[f"p{p}"] = np.array([p * per * h, 0.0, -height])
        members.append(Member(a=f"p{p}", b=f"g{p * per}", diameter=0.8 * D, wall=D / 8, steel=steel, tags={"pier": p}))
        held.append(f"p{p}")
    k = 30 * steel.E * math.pi / 8 * D**4 / 10 / extent**3 * spans**3
    springs = tuple(Spring(node=node, stiffness=(20 * k, 0, 200 * k, 0, 0, 0), tags={"abutment": name})
                    for node, name in (("g0", "west"), (f"g{spans * per}", "east")))
    parameters = [_row(f"span{s}{'lr'[b]}", {"span": s, "half": b}, 0.04) for s in range(1, spans + 1)
                  for b in range(2)]
    parameters += [_row(f"pier{p}", {"pier": p}, 0.1) for p in range(1, spans)]
    parameters += [_row(f"abutment_{name}", {"abutment": name}, 0.2, "spring") for name in ("west", "east")]
    readings = []
    for s in range(spans):
        for q in (2, 3, 5):
            readings.append(Reading(channel=f"S{s + 1}.{q}z", level=f"span {s + 1}", node=f"g{s * per + q}", axis=2))
    readings.append(Reading(channel="S1.3x", level="span 1", node="g3", axis=0))
    return Plan(kind="bridge", parameters=tuple(parameters), readings=tuple(readings), n_mode=int(rng.integers(3, 7)),
                skeleton=Skeleton(place=place, members=tuple(members), springs=springs, held=tuple(held)),
                dofs=(0, 2, 4), anchors=(("g3", 2), (f"g{per + 2}", 2), (f"g{per}", 0)))


def lattice(rng, extent, bars) -> Plan:
    """A tapered tower of three or four legs with X braces and horizontals on every face, a platform's mass on top."""
    legs, n = int(rng.choice([3, 4])), int(rng.integers(2, 5))
    low, high = extent / rng.uniform(4, 8), extent / rng.uniform(14, 24)
    D, steel, heavy = extent / rng.uniform(70, 110), Steel(), float(rng.uniform(0.6, 1.5))
    place, members = _lattice_nodes(legs, n, extent, low, high), []
    for b in range(1, n + 1):
        for k in range(legs):
            q, face = (k + 1) % legs, f"{k + 1}{(k + 1) % legs + 1}"
            members.append(Member(a=f"{b - 1}.{k}", b=f"{b}.{k}", diameter=D, wall=D / 16, steel=steel,
                                  tags={"leg": k + 1, "bay": b}))
            for one, two in ((k, q), (q, k)):
                members.append(Member(a=f"{b - 1}.{one}", b=f"{b}.{two}", diameter=0.6 * D, wall=D / 20, steel=steel,
                                      tags={"face": face, "bay": b}, pinned=bars))
            members.append(Member(a=f"{b}.{k}", b=f"{b}.{q}", diameter=0.6 * D, wall=D / 20, steel=steel,
                                  tags={"ring": b}, pinned=bars))
    total = sum(m.steel.density * math.pi * m.diameter * m.wall * np.linalg.norm(place[m.b] - place[m.a])
                for m in members)
    bodies = tuple(Body(node=f"{n}.{k}", mass=float(total) * heavy / legs, tags={"platform": 1}) for k in range(legs))
    parameters = [_row(f"leg{k}_{b}", {"bay": b, "leg": k}, 0.03) for b in range(1, n + 1) for k in range(1, legs + 1)]
    faces = [f"{k + 1}{(k + 1) % legs + 1}" for k in range(legs)]
    parameters += [_row(f"face{f}_{b}", {"bay": b, "face": f}, 0.05) for b in range(1, n + 1) for f in faces]
    parameters.append(_row("platform", {"platform": 1}, 0.05, "mass"))
    levels = sorted({n, max(1, n // 2), max(1, n - 1)})
    readings = [r for b in levels for k in range(2)
                for r in _read(f"{b}.{k}", (0, 1, 2) if b == n else (0, 1), f"L{b}{'AB'[k]}", f"L{b}")]
    return Plan(kind="lattice", parameters=tuple(parameters), readings=tuple(readings), n_mode=5,
                skeleton=Skeleton(place=place, members=tuple(members), bodies=bodies,
                                  held=tuple(f"0.{k}" for k in range(legs))),
                anchors=tuple((f"{b}.1", int(rng.integers(2))) for b in levels))


def _lattice_nodes(legs: int, n: int, extent: float, low: float, high: float) -> dict:
    place = {}
    for b in range(n + 1):
        side = low + (high - low) * b / n
        radius = side / (2 * math.sin(math.pi / legs))
        for k in range(legs):
            angle = math.radians(30 + 360 * k / legs)
            place[f"{b}.{k}"] = np.array([radius * math.cos(angle), radius * math.sin(angle), extent * b / n])
    return place


def monopile(rng, extent) -> Plan:
    """A pile with springs along it, a transition piece and a tower of one line, the rotor and nacelle as a body on
    top; `extent` from the pile's tip to the tower's top."""
    D, steel = extent / rng.uniform(18, 24), Steel()
    soil_depth, water = extent * float(rng.uniform(0.15, 0.22)), extent * float(rng.uniform(0.12, 0.2))
    top = extent - soil_depth
    n_soil, n_water, n_tower = 6, 3, 8
    z = np.r_[np.linspace(-soil_depth, 0, n_soil + 1), np.linspace(0, 1.2 * water, n_water + 1)[1:],
              np.linspace(1.2 * water, top, n_tower + 1)[1:]]
    place = {f"n{k}": np.array([0.0, 0.0, float(v) - water]) for k, v in enumerate(z)}
    members, springs = [], []
    for k in range(len(z) - 1):
        part = "pile" if k < n_soil else ("shaft" if k < n_soil + n_water else "tower")
        high = max(0, k - n_soil - n_water) / n_tower
        members.append(Member(a=f"n{k}", b=f"n{k + 1}", diameter=D * (1 - 0.4 * high), wall=D / (75 + 60 * high),
                              steel=steel, tags={"part": part, "third": f"{part} {int(3 * high)}"},
                              across_kgpm=1025 * math.pi / 4 * D**2 if part == "shaft" and k < n_soil + n_water - 1
                              else 0.0))
    piece, stiff = soil_depth / n_soil, 8e7 * float(rng.uniform(0.4, 1.5))
    for k in range(n_soil + 1):
        share = (0.5 if k in (0, n_soil) else 1.0) * (1.0 + 2.0 * (n_soil - k) / n_soil)
        springs.append(Spring(node=f"n{k}", stiffness=(stiff * piece * share,) * 2 + (0.5 * stiff * piece * share,)
                              + (0.0, 0.0, stiff * piece * share * D**2 / 8),
                              tags={"soil": "upper" if k > n_soil // 2 else "lower"}))
    mass = steel.density * math.pi * D * D / 75 * extent
    bodies = (Body(node=f"n{len(z) - 1}", mass=float(mass * rng.uniform(0.2, 0.4)), tags={"top": 1},
                   inertia=tuple(float(mass * D * D * x) for x in (1.0, 0.6, 0.8))),
              Body(node=f"n{n_soil + n_water}", mass=0.1 * float(mass), tags={"piece": 1}))
    parameters = [_row("pile", {"part": "pile"}, 0.05), _row("shaft", {"part": "shaft"}, 0.05)]
    parameters += [_row(f"tower{k + 1}", {"third": f"tower {k}"}, 0.04) for k in range(3)]
    parameters += [_row(f"soil_{half}", {"soil": half}, 0.3, "spring") for half in ("upper", "lower")]
    parameters += [_row("rna", {"top": 1}, 0.03, "mass"), _row("transition", {"piece": 1}, 0.1, "mass")]
    foot = n_soil + n_water
    nodes = [foot, foot + 3, foot + 5, len(z) - 1]
    readings = [r for k, node in enumerate(nodes) for r in _read(f"n{node}", (0, 1), f"M{k + 1}")]
    return Plan(kind="monopile", parameters=tuple(parameters), readings=tuple(readings), n_mode=int(rng.choice([4, 6])),
                skeleton=Skeleton(place=place, members=tuple(members), bodies=bodies, springs=tuple(springs)),
                anchors=((f"n{foot}", 0), (f"n{foot + 4}", 1), (f"n{n_soil + 2}", 0)))


def jacket(rng, extent, bars) -> Plan:
    """A bare jacket on springs with a deck's mass on a stiff column: three or four legs, one to five bays."""
    legs, n = int(rng.choice([3, 4])), int(rng.integers(1, 5))
    height = 0.55 * extent
    low, high = height / rng.uniform(1.8, 3.5), height / rng.uniform(5, 8)
    D, steel = height / rng.uniform(30, 42), Steel()
    place = _lattice_nodes(legs, n, height, low, high)
    place |= {"hub": np.array([0, 0, 1.05 * height]), "mid": np.array([0, 0, 0.5 * (1.05 * height + extent)]),
              "top": np.array([0, 0, extent])}
    members = []
    for k in range(legs):
        q, face = (k + 1) % legs, f"{k + 1}{(k + 1) % legs + 1}"
        for b in range(1, n + 1):
            members.append(Member(a=f"{b - 1}.{k}", b=f"{b}.{k}", diameter=D, wall=D / 30, steel=steel,
                                  tags={"leg": k + 1, "bay": b}))
            members += [Member(a=f"{b - 1}.{one}", b=f"{b}.{two}", diameter=0.6 * D, wall=D / 45, steel=steel,
                               tags={"face": face, "bay": b}, pinned=bars) for one, two in ((k, q), (q, k))]
        members += [Member(a=f"{n}.{k}", b=end, diameter=d * D, wall=D / w, steel=steel, tags={"frame": 1})
                    for end, d, w in ((f"{n}.{q}", 1.2, 20), ("hub", 1.6, 18))]
    for a, b, name in (("hub", "mid", "lower"), ("mid", "top", "upper")):
        members.append(Member(a=a, b=b, diameter=4.2 * D, wall=D / 45, steel=steel, tags={"tower": name}))
    mass = sum(m.steel.density * math.pi * m.diameter * m.wall * np.linalg.norm(place[m.b] - place[m.a])
               for m in members)
    bodies = (Body(node="top", mass=0.45 * float(mass), tags={"top": 1}, inertia=(0.05 * float(mass) * high**2,) * 3),
              Body(node="hub", mass=0.3 * float(mass), tags={"deck": 1}))
    k = 3.0 * steel.E * math.pi * D * D / 30 / height * float(rng.uniform(0.5, 2.0))
    springs = tuple(Spring(node=f"0.{i}", tags={"foot": i + 1},
                           stiffness=(0.15 * k, 0.15 * k, k, 0.02 * k * D**2, 0.02 * k * D**2, 0.02 * k * D**2))
                    for i in range(legs))
    faces = [f"{i + 1}{(i + 1) % legs + 1}" for i in range(legs)]
    parameters = [_row(f"face{f}_{b}", {"face": f, "bay": b}) for b in range(1, n + 1) for f in faces]
    parameters += [_row(f"leg{i + 1}_{b}", {"leg": i + 1, "bay": b}, 0.03)
                   for b in range(1, n + 1) for i in range(legs)]
    parameters += [_row(f"foot{i + 1}", {"foot": i + 1}, 0.1, "spring") for i in range(legs)]
    parameters += [_row("tower_lower", {"tower": "lower"}, 0.03), _row("tower_upper", {"tower": "upper"}, 0.03),
                   _row("top", {"top": 1}, 0.03, "mass")]
    readings = [r for i in range(2) for r in _read(f"{n}.{i}", (0, 1, 2), f"D{'AB'[i]}", "deck")]
    readings += [*_read("mid", (0, 1), "M"), *_read("top", (0, 1), "T")]
    return Plan(kind="jacket", parameters=tuple(parameters), readings=tuple(readings), n_mode=5,
                skeleton=Skeleton(place=place, members=tuple(members), bodies=bodies, springs=springs),
                anchors=((f"{n}.1", 0), ("mid", 1), (f"{max(1, n - 1)}.0", 1)))


def tripod(rng, extent) -> Plan:
    """A central column on three legs and three lower braces, a tower on it; names that read alike, or differ in case,
    blank or hyphen. As designed its heave moves no horizontal sensor; feet that differ let it be measured."""
    D, steel, place, members = extent / rng.uniform(22, 28), Steel(), {}, []
    for name, share in (("low", 0.06), ("mid", 0.18), ("head", 0.36), ("t1", 0.6), ("t2", 0.8), ("top", 1.0)):
        place[name] = np.array([0.0, 0.0, share * extent])
    angles = [2 + 2 * math.pi * k / 3 for k in range(3)]
    place |= {f"foot{k}": 0.28 * extent * np.array([math.cos(x), math.sin(x), 0.0]) for k, x in enumerate(angles)}
    for a, b, wide, tags in (("low", "mid", 1.2, {"column": "A"}), ("mid", "head", 1.2, {"column": "a"}),
                             ("head", "t1", 1.1, {"tower": 0}), ("t1", "t2", 1.0, {"tower": 1}),
                             ("t2", "top", 0.8, {"tower": 1}),
                             *((f"foot{k}", "mid", 0.6, {"leg": k}) for k in range(3)),
                             *((f"foot{k}", "low", 0.5, {"brace": k}) for k in range(3))):
        members.append(Member(a=a, b=b, diameter=wide * D, wall=D / 55, steel=steel, tags=tags))
    mass = steel.density * math.pi * D * D / 60 * extent
    bodies = (Body(node="top", mass=0.5 * mass, inertia=(0.08 * mass * D * D,) * 3, tags={"top": 1}),
              Body(node="head", mass=0.15 * mass, tags={"deck": 1}))
    k = 2 * steel.E * math.pi * D * D / 40 / extent * float(rng.uniform(0.7, 1.4))
    springs = tuple(Spring(node=f"foot{i}", tags={"foot": i}, stiffness=(0.3 * k, 0.3 * k, k, *(0.02 * k * D * D,) * 3))
                    for i in range(3))
    parameters = [_row(name, {"column": name}) for name in ("A", "a")]
    parameters += [_row(name, {"leg": i}, 0.1) for i, name in enumerate(("A 1", "A-1", "A_1"))]
    parameters += [_row(name, {"foot": i}, 0.2, "spring") for i, name in enumerate(("foot 1", "foot_1", "FOOT 1"))]
    parameters += [_row("tower", {"tower": 0}, 0.03), _row("Tower", {"tower": 1}, 0.03),
                   _row("face AB, bay 1", {"top": 1}, 0.03, "mass"), _row("deck", {"deck": 1}, 0.2, "mass")]
    readings = [r for node in ("mid", "head", "t1", "top") for r in _read(node, (0, 1), node)]
    readings += [*_read("foot0", (0,), "foot 0", "feet"), *_read("foot1", (1,), "foot-0", "feet")]
    return Plan(kind="tripod", parameters=tuple(parameters), readings=tuple(readings), n_mode=5,
                skeleton=Skeleton(place=place, members=tuple(members), bodies=bodies, springs=springs),
                anchors=(("head", 0), ("t1", 1)))
