"""Plans as matrices: Bernoulli-Euler tubes and bars assembled with numpy, solved by scipy, written as model.npz."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import linalg, sparse

from drawn import toml_text
from drawn.plans import Plan
from drawn.skeleton import Change, Skeleton, State, in_state, tube

# elements of a member at first and at most, where measured modes are within so much of those of a finer mesh: an
# engineer refines it until they are
PIECES, MOST_PIECES, CONVERGED = {"bridge": 2}, 3, 2e-3
LEAST_MODES = 3
UNITS = {"SI": (1.0, 1.0), "mm-N-t": (1e3, 1e-3)}  # energy in the unit of one J, metres in the unit of a length


class Assembly:
    """K and M (n, n) of a skeleton over the motions `dofs` of every node that is not held."""

    def __init__(self, s: Skeleton, dofs: tuple[int, ...], pieces: int):
        self.dofs, self.place = dofs, {name: np.asarray(p, float) for name, p in s.place.items()}
        lines = []
        for m in s.members:
            n = 1 if m.pinned else pieces
            start, end = self.place[m.a], self.place[m.b]
            inner = [f"{m.a}|{m.b}|{k}" for k in range(1, n)]
            for k, name in enumerate(inner, 1):
                self.place[name] = start + (end - start) * k / n
            nodes = [m.a, *inner, m.b]
            lines += [(m, a, b) for a, b in zip(nodes[:-1], nodes[1:], strict=True)]
        self.lines = [(a, b) for _, a, b in lines]
        free = [name for name in self.place if name not in s.held]
        self.index = {(name, d): k * len(dofs) + j for k, name in enumerate(free) for j, d in enumerate(dofs)}
        self.nodes = free
        size = len(self.index)
        self.K, self.M = np.zeros((size, size)), np.zeros((size, size))
        for m, a, b in lines:
            self._member(m, a, b)
        for p in s.springs:
            self._spring(p)
        for body in s.bodies:
            own = np.diag([body.mass] * 3 + [*body.inertia])
            self._add(self.M, (body.node,), own)
        for a, b, k in s.bars:
            way = (self.place[b] - self.place[a]) / np.linalg.norm(self.place[b] - self.place[a])
            both = np.r_[way, 0, 0, 0, -way, 0, 0, 0]
            self._add(self.K, (a, b), k * np.outer(both, both))
        # what swings has motions that nothing else shares: as fast as the fastest of the others, no faster, as rounding
        # is of the largest eigenvalue
        alone = [self.index[name, d] for name in s.level_only for d in dofs if d > 1]
        others = np.setdiff1d(np.arange(size), alone)
        fastest = np.max(np.diag(self.K)[others] / np.diag(self.M)[others])
        self.K[alone, alone], self.M[alone, alone] = fastest, 1.0

    def _add(self, matrix, nodes, own) -> None:
        rows, picked = [], []
        for k, name in enumerate(nodes):
            for d in self.dofs:
                if (name, d) in self.index:
                    rows.append(self.index[name, d])
                    picked.append(6 * k + d)
        matrix[np.ix_(rows, rows)] += own[np.ix_(picked, picked)]

    def _member(self, m, a, b) -> None:
        way = self.place[b] - self.place[a]
        length = float(np.linalg.norm(way))
        x = way / length
        helper = np.eye(3)[np.argmin(np.abs(x))]
        y = np.cross(helper, x) / np.linalg.norm(np.cross(helper, x))
        turn = np.kron(np.eye(4), np.array([x, y, np.cross(x, y)]))
        area, second = tube(m.diameter, m.wall)
        per_m = m.steel.density * area + m.along_kgpm
        if m.pinned:
            K = np.zeros((12, 12))
            K[np.ix_([0, 6], [0, 6])] = m.steel.E * area / length * np.array([[1, -1], [-1, 1]])
            M = np.zeros((12, 12))
            for axis in range(3):
                M[np.ix_([axis, axis + 6], [axis, axis + 6])] = per_m * length / 6 * np.array([[2, 1], [1, 2]])
        else:
            K = _beam_stiffness(m.steel.E, m.steel.G, area, second, length)
            M = _beam_mass(per_m, per_m + m.across_kgpm, 2 * m.steel.density * second, length)
        self._add(self.K, (a, b), turn.T @ K @ turn)
        self._add(self.M, (a, b), turn.T @ M @ turn)

    def _spring(self, p) -> None:
        x, y = np.array(p.x, float), np.array(p.y, float)
        turn = np.kron(np.eye(2), np.array([x, y, np.cross(x, y)]))
        own = turn.T @ np.diag(p.stiffness) @ turn
        if p.other is None:
            self._add(self.K, (p.node,), own)
        else:
            self._add(self.K, (p.node, p.other), np.kron(np.array([[1, -1], [-1, 1]]), own))

    def modes(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies in Hz and shapes (n, count) of unit modal mass; rows and columns are scaled to like size first,
        as translations and rotations differ by the square of a length."""
        scale = 1 / np.sqrt(np.diag(self.M))
        K, M = self.K * np.outer(scale, scale), self.M * np.outer(scale, scale)
        value, vector = linalg.eigh(K, M, subset_by_index=[0, min(count, len(K)) - 1])
        return np.sqrt(np.maximum(value, 0)) / (2 * math.pi), scale[:, None] * vector


def _beam_stiffness(E, G, area, second, h) -> np.ndarray:
    K = np.zeros((12, 12))
    for (i, j), k in (((0, 6), E * area / h), ((3, 9), 2 * G * second / h)):
        K[np.ix_([i, j], [i, j])] = k * np.array([[1, -1], [-1, 1]])
    own = E * second / h**3 * np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h * h, -6 * h, 2 * h * h],
                                        [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h * h, -6 * h, 4 * h * h]])
    return _both_planes(K, own)


def _both_planes(matrix, own) -> np.ndarray:
    """Bending along y with rotation about z, and along z with rotation about -y."""
    for rows, sign in (([1, 5, 7, 11], 1.0), ([2, 4, 8, 10], -1.0)):
        s = np.array([1, sign, 1, sign])
        matrix[np.ix_(rows, rows)] = own * np.outer(s, s)
    return matrix


def _beam_mass(along, across, polar, h) -> np.ndarray:
    M = np.zeros((12, 12))
    for (i, j), m in (((0, 6), along), ((3, 9), polar)):
        M[np.ix_([i, j], [i, j])] = m * h / 6 * np.array([[2, 1], [1, 2]])
    own = across * h / 420 * np.array([[156, 22 * h, 54, -13 * h], [22 * h, 4 * h * h, 13 * h, -3 * h * h],
                                       [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h * h, -22 * h, 4 * h * h]])
    return _both_planes(M, own)


def assembled(plan: Plan, state: State, *, finer: int = 0) -> Assembly:
    """With so many elements more in a member than the model has."""
    return Assembly(in_state(plan.skeleton, state), plan.dofs, plan.pieces + finer)


def meshed(plan: Plan) -> Plan:
    """With as many elements in a member, and as few modes measured, as a mesh needs that is converged."""
    for pieces in range(PIECES.get(plan.kind, plan.pieces), MOST_PIECES + 1):
        plan = replace(plan, pieces=pieces)
        own, finer = (assembled(plan, State(), finer=more).modes(plan.n_mode)[0] for more in (0, 1))
        good = int(np.argmin(np.append(np.abs(own / finer - 1) < CONVERGED, False)))
        if good >= min(plan.n_mode, LEAST_MODES):
            break
    return replace(plan, n_mode=max(good, LEAST_MODES))


def write(plan: Plan, folder: Path, units: str, *, as_csr: bool = False, picture: bool = True) -> list[str]:
    """model.npz and parameters.toml -> the arguments that name them."""
    folder.mkdir(parents=True, exist_ok=True)
    a = assembled(plan, State())
    energy, metre = UNITS[units]
    size = np.array([metre if d < 3 else 1.0 for _, d in a.index])
    unit = energy * np.outer(size, size)
    parts = {}
    for p in plan.parameters:
        # a factor on some members: what they alone add
        off = assembled(plan, State().with_changes(_change(p, 0.0)))
        parts[p.name] = ("K" if p.what != "mass" else "M", a.K - off.K if p.what != "mass" else a.M - off.M)
    arrays = {"K0": a.K - sum(m for k, m in parts.values() if k == "K"),
              "M0": a.M - sum((m for k, m in parts.values() if k == "M"), np.zeros_like(a.M))}
    arrays |= {f"{kind}_{name}": m for name, (kind, m) in parts.items()}
    written = {}
    for name, matrix in arrays.items():
        # rounding of what was taken apart; of a structure of millimetres rotations are that small beside translations
        own = np.sqrt(np.diag(a.K if name[0] == "K" else a.M))
        matrix = np.where(np.abs(matrix) < 1e-12 * np.outer(own, own), 0.0, matrix) * unit
        written |= _csr(name, matrix) if as_csr else {name: matrix}
    written["channel"] = np.array([r.channel for r in plan.readings])
    written["channel_dof"] = np.array([a.index[r.node, r.axis] for r in plan.readings])
    if picture:
        written["node_position_m"] = np.array([a.place[name] for name in a.nodes])
        written["dof_node"] = np.array([a.nodes.index(name) for name, _ in a.index])
        written["dof_direction"] = np.array([d for _, d in a.index])
        written["line"] = np.array([[a.nodes.index(one), a.nodes.index(two)] for one, two in a.lines
                                    if one in a.nodes and two in a.nodes])
    np.savez(folder / "model.npz", **written)
    (folder / "parameters.toml").write_text(toml_text.text({"parameter": parameter_rows(plan)}), encoding="utf-8")
    return ["--model", str(folder / "model.npz")]


def parameter_rows(plan: Plan) -> list[dict]:
    return [{"name": p.name, "unit": "-", "initial": 1.0, "std": p.std, "lower": p.lower, "upper": p.upper}
            for p in plan.parameters]


def _change(p, value: float) -> Change:
    return Change(what=p.what, on=p.on, value=value)


def _csr(name: str, matrix: np.ndarray) -> dict:
    m = sparse.csr_array(matrix)
    return {f"{name}_data": m.data, f"{name}_indices": m.indices, f"{name}_indptr": m.indptr}
