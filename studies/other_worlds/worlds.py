"""Structures drawn at random, by equations of their own (plain numpy): storeys in two directions, a guyed mast, a plane
truss bridge, a beam on springs. Each as matrices with parameters, and the channels."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from probupdate.modal.modes import Sensor


@dataclass(frozen=True, kw_only=True)
class World:
    """`base` and `parts` (n, n): K(theta) = base + sum theta_k parts_k, all theta 1 as designed; mass (n, n); `rows`
    (n_channel, n) what the channels read; std and lower bound of each parameter; `n_mode` measured; `groups` of
    parameters that change together; `ground`: degrees of freedom to which something unknown can be fastened;
    `together`: channels of one logger; `places` and `directions` (n_channel, 3) of the sensors."""

    kind: str
    base: np.ndarray
    parts: dict[str, np.ndarray]
    mass: np.ndarray
    channels: tuple[str, ...]
    rows: np.ndarray
    std: dict[str, float]
    lower: dict[str, float]
    n_mode: int
    ground: tuple[int, ...]
    together: tuple[int, ...]
    places: np.ndarray
    directions: np.ndarray
    groups: dict[str, dict[str, float]] = field(default_factory=dict)

    def stiffness(self, theta: dict[str, float]) -> np.ndarray:
        return self.base + sum(theta.get(name, 1.0) * part for name, part in self.parts.items())

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """One at each channel; a level is a height, or half of what lies."""
        levels = [c.split("-")[0] if "-" in c else ("left" if k in self.together else "right")
                  for k, c in enumerate(self.channels)]
        return tuple(
            Sensor(channel=c, level=level, position_m=p, direction=d, quantity="acceleration", unit="m/s2")
            for c, level, p, d in zip(self.channels, levels, self.places, self.directions, strict=True))

    def write(self, folder: Path) -> Path:
        """model.npz with parameters.toml and, where there are any, groups.toml."""
        folder.mkdir(parents=True, exist_ok=True)
        arrays = {"K0": self.base, "M0": self.mass, "channel": np.array(self.channels), "channel_row": self.rows}
        np.savez(folder / "model.npz", **arrays, **{f"K_{name}": part for name, part in self.parts.items()})
        (folder / "parameters.toml").write_text("\n".join(
            f'[[parameter]]\nname = "{name}"\nunit = "-"\ninitial = 1.0\nstd = {self.std[name]}\n'
            f"lower = {self.lower[name]}\nupper = 3.0\n" for name in self.parts), encoding="utf-8")
        (folder / "groups.toml").write_text("\n".join(
            f'["{name}"]\n' + "".join(f"{p} = {change}\n" for p, change in parts.items())
            for name, parts in self.groups.items()), encoding="utf-8")
        return folder / "model.npz"


def modes(K: np.ndarray, M: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies in Hz, ascending, and shapes of unit modal mass."""
    root = np.linalg.cholesky(M)
    half = np.linalg.solve(root, K)
    value, vector = np.linalg.eigh(np.linalg.solve(root, half.T))
    return np.sqrt(np.maximum(value, 0)) / (2 * np.pi), np.linalg.solve(root.T, vector)


def draw_world(kind: str, rng: np.random.Generator) -> World:
    return {"storeys": storeys, "mast": mast, "truss": truss, "beam": beam_on_springs}[kind](rng)


def storeys(rng: np.random.Generator) -> World:
    """4 to 10 floors with two translations and a rotation each, equal in x and y or but for 0.1 %."""
    n = int(rng.integers(4, 11))
    apart, half = float(rng.choice([0.0, 1e-3])), rng.uniform(4.0, 8.0)
    mass, first = rng.uniform(5e4, 2e5), rng.uniform(0.8, 4.0)
    taper = np.linspace(1.0, rng.uniform(0.5, 1.0), n)
    K1 = sum(taper[s] * _between(n, s - 1, s) for s in range(n))
    f1 = np.sqrt(np.linalg.eigvalsh(K1 / mass)[0]) / (2 * np.pi)
    k = taper * (first / f1) ** 2
    at = np.arange(n)
    M = np.zeros((3 * n, 3 * n))
    M[3 * at, 3 * at] = M[3 * at + 1, 3 * at + 1] = mass
    M[3 * at + 2, 3 * at + 2] = mass * (2 * half) ** 2 / 6
    parts = {}
    for s in range(n):
        for axis, name in enumerate("xy"):
            one = k[s] * (1 + apart * axis) * _between(n, s - 1, s)
            part = np.zeros((3 * n, 3 * n))
            part[axis::3, axis::3] = one
            # two frames at the faces carry it: they turn the floor too
            part[2::3, 2::3] = half**2 * one
            parts[f"k{s + 1}{name}"] = part
    floors = sorted(rng.choice(n - 1, size=min(n - 1, int(rng.integers(2, 5))), replace=False).tolist()) + [n - 1]
    channels, rows, places, directions = [], [], [], []
    for s in floors:
        ways = (("x", 0, 0.0), ("y", 1, half)) + ((("z", 1, -half),) if s == n - 1 else ())
        for name, axis, arm in ways:
            row = np.zeros(3 * n)
            row[3 * s + axis], row[3 * s + 2] = 1.0, arm
            channels.append(f"F{s + 1}-{name}")
            rows.append(row)
            places.append([-half if name == "z" else half, 0.0, 3.0 * s + 3.0])
            directions.append(np.eye(3)[axis])
    std = float(rng.choice([0.03, 0.05, 0.1]))
    return World(
        kind="storeys", base=np.zeros_like(M), parts=parts, mass=M, channels=tuple(channels), rows=np.array(rows),
        std=dict.fromkeys(parts, std), lower=dict.fromkeys(parts, 0.05), n_mode=int(rng.integers(3, 8)),
        ground=tuple(3 * s + int(rng.integers(2)) for s in range(n)),
        together=tuple(k for k, c in enumerate(channels) if c.startswith(f"F{floors[0] + 1}-")),
        places=np.array(places), directions=np.array(directions),
        groups={f"storey {s + 1}": {f"k{s + 1}x": 1.0, f"k{s + 1}y": 1.0} for s in range(n)})


def _between(n: int, lower: int, upper: int) -> np.ndarray:
    """Spring of 1 between two floors, the lower of which may be the ground (-1)."""
    K = np.zeros((n, n))
    K[upper, upper] += 1.0
    if lower >= 0:
        K[lower, lower] += 1.0
        K[lower, upper] -= 1.0
        K[upper, lower] -= 1.0
    return K


def _beam(EI: float, length: float) -> np.ndarray:
    """Euler-Bernoulli: w1, rotation1, w2, rotation2."""
    h = length
    return EI / h**3 * np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h * h, -6 * h, 2 * h * h],
                                 [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h * h, -6 * h, 4 * h * h]])


def _beam_mass(total: float, length: float) -> np.ndarray:
    h = length
    return total / 420 * np.array([[156, 22 * h, 54, -13 * h], [22 * h, 4 * h * h, 13 * h, -3 * h * h],
                                   [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h * h, -22 * h, 4 * h * h]])


def mast(rng: np.random.Generator) -> World:
    """A round cantilever with two levels of three guys, in two directions; a spring at its foot."""
    n_el, height = 12, rng.uniform(30.0, 80.0)
    h, EI, mass = height / n_el, rng.uniform(0.5, 2.0) * 1e8, rng.uniform(60.0, 200.0)
    n = n_el + 1
    M, base = np.zeros((4 * n, 4 * n)), np.zeros((4 * n, 4 * n))
    parts = {f"EI{s + 1}": np.zeros_like(M) for s in range(4)}
    for e in range(n_el):
        for axis in range(2):
            own = [4 * e + 2 * axis, 4 * e + 2 * axis + 1, 4 * e + 4 + 2 * axis, 4 * e + 5 + 2 * axis]
            parts[f"EI{e // 3 + 1}"][np.ix_(own, own)] += _beam(EI, h)
            M[np.ix_(own, own)] += _beam_mass(mass * h, h)
    foot = np.zeros_like(M)
    foot[1, 1] = foot[3, 3] = rng.uniform(1.0, 5.0) * EI / height
    parts["foot"] = foot
    base[0, 0] = base[2, 2] = 1e4 * EI / height**3
    k = rng.uniform(3.0, 15.0) * EI / height**3
    for level, node in (("A", 6), ("B", 9)):
        for g, angle in enumerate(np.radians([90.0, 210.0, 330.0])):
            way, part = np.array([np.cos(angle), np.sin(angle)]), np.zeros_like(M)
            part[np.ix_([4 * node, 4 * node + 2], [4 * node, 4 * node + 2])] = k * np.outer(way, way)
            parts[f"guy{level}{g + 1}"] = part
    nodes = [3, 6, 9, 12]
    rows = np.array([np.eye(4 * n)[4 * node + 2 * axis] for node in nodes for axis in range(2)])
    std = {name: 0.1 if name[0] != "E" else 0.03 for name in parts}
    return World(
        kind="mast", base=base, parts=parts, mass=M, channels=tuple(f"L{i}-{a}" for i in (1, 2, 3, 4) for a in "xy"),
        rows=rows, std=std, lower=dict.fromkeys(parts, 0.05) | {p: 0.0 for p in parts if p[0] == "g"},
        n_mode=int(rng.choice([4, 6, 8])), ground=(4 * 4, 4 * 8 + 2, 4 * 12), together=(0, 1),
        places=np.array([[0, 0, node * h] for node in nodes for _ in "xy"]),
        directions=np.array([np.eye(3)[axis] for _ in nodes for axis in range(2)]),
        groups={f"guys {level}": {f"guy{level}{g}": 1.0 for g in (1, 2, 3)} for level in "AB"})


def truss(rng: np.random.Generator) -> World:
    """A plane truss of parallel chords; each half's chords, each panel's diagonals, and a spring under one bearing."""
    n, panel, depth = int(rng.choice([6, 8, 10])), rng.uniform(3.0, 6.0), rng.uniform(3.0, 6.0)
    lower = [(i * panel, 0.0) for i in range(n + 1)]
    upper = [(i * panel, depth) for i in range(1, n)]
    where = np.array(lower + upper)
    N = len(where)
    top = {i: n + i for i in range(1, n)}
    bars = [(f"low{'LR'[i >= n // 2]}", i, i + 1, 1.0) for i in range(n)]
    bars += [(f"top{'LR'[i >= n // 2]}", top[i], top[i + 1], 1.0) for i in range(1, n - 1)]
    bars += [("fixed", i, top[i], 0.5) for i in range(1, n)]
    bars += [("endL", 0, top[1], 0.8), ("endR", n, top[n - 1], 0.8)]
    bars += [(f"d{i + 1}", i, top[i + 1], 0.5) if i < n // 2 else (f"d{i + 1}", i + 1, top[i], 0.5)
             for i in range(1, n - 1)]
    EA = 2.1e11 * rng.uniform(0.005, 0.02)
    parts, base, M = {}, np.zeros((2 * N, 2 * N)), np.zeros((2 * N, 2 * N))
    for name, i, j, area in bars:
        way = where[j] - where[i]
        length = np.linalg.norm(way)
        direction = np.concatenate([-way, way]) / length
        own = [2 * i, 2 * i + 1, 2 * j, 2 * j + 1]
        K = base if name == "fixed" else parts.setdefault(name, np.zeros_like(base))
        K[np.ix_(own, own)] += EA * area / length * np.outer(direction, direction)
        M[own, own] += 0.5 * 7850 * EA / 2.1e11 * area * length
    deck = rng.uniform(500.0, 2000.0) * panel
    M[range(2 * (n + 1)), range(2 * (n + 1))] += deck
    base[0, 0] += 1e11
    base[1, 1] += 1e11
    bearing = np.zeros_like(base)
    bearing[2 * n + 1, 2 * n + 1] = rng.uniform(2.0, 6.0) * EA / (n * panel)
    parts["bearing"] = bearing
    rows, channels = [], []
    for i in range(1, n + 1):
        rows.append(np.eye(2 * N)[2 * i + 1])
        channels.append(f"V{i}")
    rows.append(np.eye(2 * N)[2 * n])
    channels.append(f"H{n}")
    std = {name: 0.15 if name == "bearing" else 0.03 for name in parts}
    return World(
        kind="truss", base=base, parts=parts, mass=M, channels=tuple(channels), rows=np.array(rows), std=std,
        lower=dict.fromkeys(parts, 0.05), n_mode=int(rng.integers(3, 7)), ground=(2 * 2 + 1, 2 * (n // 2) + 1, 2 * n),
        together=tuple(range(n // 2)), places=np.array([[i * panel, 0, 0] for i in (*range(1, n + 1), n)]),
        directions=np.array([*[[0, 0, 1]] * n, [1, 0, 0]], float))


def beam_on_springs(rng: np.random.Generator) -> World:
    """A free beam on springs along it: sections of bending stiffness, and of the foundation."""
    n_el, length = 24, rng.uniform(20.0, 60.0)
    h, EI, mass = length / n_el, rng.uniform(0.5, 5.0) * 1e9, rng.uniform(1e3, 5e3)
    n_soil, n = int(rng.integers(4, 9)), n_el + 1
    M = np.zeros((2 * n, 2 * n))
    parts = {f"EI{s + 1}": np.zeros_like(M) for s in range(4)} | {f"soil{s + 1}": np.zeros_like(M)
                                                                   for s in range(n_soil)}
    k = rng.uniform(50.0, 2000.0) * EI / length**4
    for e in range(n_el):
        own = list(range(2 * e, 2 * e + 4))
        parts[f"EI{e * 4 // n_el + 1}"][np.ix_(own, own)] += _beam(EI, h)
        M[np.ix_(own, own)] += _beam_mass(mass * h, h)
    for node in range(n):
        parts[f"soil{node * n_soil // n + 1}"][2 * node, 2 * node] += k * h * (0.5 if node in (0, n_el) else 1.0)
    nodes = np.linspace(0, n_el, int(rng.integers(5, 11))).astype(int)
    return World(
        kind="beam", base=np.zeros_like(M), parts=parts, mass=M, channels=tuple(f"W{i}" for i in range(len(nodes))),
        rows=np.array([np.eye(2 * n)[2 * node] for node in nodes]),
        std={name: 0.03 if name[0] == "E" else 0.15 for name in parts}, lower=dict.fromkeys(parts, 0.05),
        n_mode=int(rng.integers(3, 7)), ground=(0, 2 * (n_el // 3), 2 * n_el - 4),
        together=tuple(range(len(nodes) // 2)), places=np.array([[node * h, 0, 0] for node in nodes]),
        directions=np.array([[0.0, 0, 1]] * len(nodes)))
