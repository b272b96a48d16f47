"""The IASC-ASCE phase I benchmark frame by equations of its own: 12 and 120 degrees of freedom, damage patterns.

Four storeys of 0.9 m, two bays of 1.25 m each way; floors rigid in their plane. The frame of 120 degrees of
freedom keeps vertical motion and rotations about x and y of its 36 free nodes; the shear building of 12
holds these. Numbers: Johnson, Lam, Katafygiotis and Beck (2004), J. Eng. Mech. 130(1), 3-15, as they stand in the task
group's own generator of data (RESULTS.md).

Nothing of `probupdate` is used here.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy import linalg

BAY_M, STOREY_M = 1.25, 0.9
N_STOREY, N_PLAN = 4, 9
YOUNGS_PA, POISSON, DENSITY_KGPM3 = 2.0e11, 0.3, 7800.0
# area; second moments about the strong and the weak axis; torsion constant
COLUMN = (1.133e-3, 1.97e-6, 0.664e-6, 8.01e-9)  # B100x9, strong axis resists motion in x
BEAM = (1.430e-3, 1.22e-6, 0.249e-6, 3.82e-8)  # S75x11, strong axis resists vertical bending
BRACE = (0.141e-3, 0.0, 0.0, 0.0)  # L25x25x3, bars
SLAB_KG = (800.0, 600.0, 600.0, 400.0)  # each of four to a floor
HEAVY_KG = 550.0  # the roof's slab at -x, -y where mass is asymmetric
FACES = ("x-", "x+", "y-", "y+")  # where the face stands: x = 0, x = 2.5 m, y = 0, y = 2.5 m
# braces of a storey, lower and upper end in the plan's numbers 0 to 8 (x first): two to a face
BRACES = {"y-": ((0, 1), (2, 1)), "x+": ((2, 5), (8, 5)), "y+": ((8, 7), (6, 7)), "x-": ((6, 3), (0, 3))}
BEAMS = tuple((3 * j + i, 3 * j + i + 1) for j in range(3) for i in range(2)) + tuple(
    (3 * j + i, 3 * j + i + 3) for i in range(3) for j in range(2)
)
# an accelerometer in the middle of each face of each floor, along the face: plan number and axis
SENSORS = ((1, 0), (5, 1), (7, 0), (3, 1))
CHANNELS = tuple(f"floor {s + 1}, {'xy'[axis]} at {['y-', 'x+', 'y+', 'x-'][k]}"
                 for s in range(N_STOREY) for k, (_, axis) in enumerate(SENSORS))


@dataclass(frozen=True)
class Member:
    """`kind` column, beam or brace; its storey (floor) from 1; ends as numbers of nodes, 9 to a level from the base;
    `face` of a brace and which of two; `hinge`: whether its first end transmits no moment."""

    kind: str
    storey: int
    ends: tuple[int, int]
    face: str = ""
    number: int = 0
    hinge: bool = False


def position_m(node: int) -> np.ndarray:
    level, plan = divmod(node, N_PLAN)
    return np.array([plan % 3 * BAY_M, plan // 3 * BAY_M, level * STOREY_M])


@cache
def members() -> tuple[Member, ...]:
    result = []
    for s in range(1, N_STOREY + 1):
        top, foot = N_PLAN * s, N_PLAN * (s - 1)
        result += [Member("column", s, (foot + k, top + k)) for k in range(N_PLAN)]
        result += [Member("beam", s, (top + a, top + b)) for a, b in BEAMS]
        result += [Member("brace", s, (foot + a, top + b), face, k)
                   for face, pair in BRACES.items() for k, (a, b) in enumerate(pair)]
    return tuple(result)


def element(member: Member, part: str = "all") -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and lumped mass (12, 12) of a member in global axes: u, v, w and three rotations at either end. `part`:
    "all", or of a column what resists motion in "x" or "y" by bending."""
    a, b = (position_m(n) for n in member.ends)
    length = float(np.linalg.norm(b - a))
    area, strong, weak, torsion = {"column": COLUMN, "beam": BEAM, "brace": BRACE}[member.kind]
    along = (b - a) / length
    # the direction in which the strong axis resists: x of a column, z of a beam
    stiff = np.array([1.0, 0.0, 0.0]) if member.kind == "column" else np.array([0.0, 0.0, 1.0])
    stiff = stiff - (stiff @ along) * along
    stiff /= np.linalg.norm(stiff)
    across = np.cross(along, stiff)
    shear = YOUNGS_PA / (2 * (1 + POISSON))
    K, M = np.zeros((12, 12)), np.zeros((12, 12))
    ends = np.array([[1.0, -1.0], [-1.0, 1.0]])
    for constant, first in ((YOUNGS_PA * area, 0), (shear * torsion, 3)) if part == "all" else ():
        # elongation and twist: one number an end
        v = np.zeros((12, 2))
        v[first : first + 3, 0] = v[6 + first : 9 + first, 1] = along
        K += constant / length * v @ ends @ v.T
    for second, way in ((strong, stiff), (weak, across)):
        if part != "all" and abs(way["xy".index(part)]) < 0.5:
            continue
        # v, dv/ds at either end: the slope of motion along `way` is the rotation about along x way
        normal = np.cross(along, way)
        v = np.zeros((12, 4))
        v[0:3, 0] = v[6:9, 2] = way
        v[3:6, 1] = v[9:12, 3] = normal
        L = length
        bending = np.array([[12, 6 * L, -12, 6 * L], [6 * L, 4 * L**2, -6 * L, 2 * L**2],
                            [-12, -6 * L, 12, -6 * L], [6 * L, 2 * L**2, -6 * L, 4 * L**2]])
        K += YOUNGS_PA * second / L**3 * v @ bending @ v.T
    if member.hinge:
        # moments at the first end are zero: its rotations condensed out, torsion with them
        keep, lost = [0, 1, 2, *range(6, 12)], [3, 4, 5]
        rest = K[np.ix_(keep, keep)] - K[np.ix_(keep, lost)] @ np.linalg.solve(
            K[np.ix_(lost, lost)], K[np.ix_(lost, keep)])
        K = np.zeros((12, 12))
        K[np.ix_(keep, keep)] = rest
    half = DENSITY_KGPM3 * area * length / 2
    polar = (strong + weak) / area
    block = np.zeros((6, 6))
    block[:3, :3], block[3:, 3:] = np.eye(3), polar * np.outer(along, along)
    M[:6, :6] = M[6:, 6:] = half * block
    return K, M


@cache
def transformation(n_dof: int) -> np.ndarray:
    """(216, n_dof): motion of the 36 free nodes from u, v and the rotation about z of each floor's centre (12), and in
    the frame of 120 also w and the rotations about x and y of each node."""
    T = np.zeros((6 * N_STOREY * N_PLAN, 12 + 3 * N_STOREY * N_PLAN))
    for k in range(N_STOREY * N_PLAN):
        floor, row = k // N_PLAN, 6 * k
        x, y, _ = position_m(N_PLAN + k) - np.array([BAY_M, BAY_M, 0.0])
        T[row, 3 * floor], T[row, 3 * floor + 2] = 1.0, -y
        T[row + 1, 3 * floor + 1], T[row + 1, 3 * floor + 2] = 1.0, x
        T[row + 5, 3 * floor + 2] = 1.0
        T[row + 2 : row + 5, 12 + 3 * k : 15 + 3 * k] = np.eye(3)
    if n_dof not in (12, 120):
        raise ValueError(f"{n_dof} degrees of freedom: the benchmark has 12 and 120")
    return T[:, :n_dof]


def stiffness(chosen, factors, n_dof: int, part: str = "all") -> np.ndarray:
    """(n_dof, n_dof) of `chosen` members times `factors`; `part` as in `element`."""
    K = np.zeros((6 * N_PLAN * (N_STOREY + 1),) * 2)
    for member, factor in zip(chosen, factors, strict=True):
        rows = np.concatenate([np.arange(6 * n, 6 * n + 6) for n in member.ends])
        K[np.ix_(rows, rows)] += factor * element(member, part)[0]
    T = transformation(n_dof)
    return T.T @ K[6 * N_PLAN :, 6 * N_PLAN :] @ T


@cache
def mass(n_dof: int, heavy: bool) -> np.ndarray:
    """(n_dof, n_dof) of members and slabs; `heavy`: one slab of the roof weighs 550 kg instead of 400."""
    M = np.zeros((6 * N_PLAN * (N_STOREY + 1),) * 2)
    for member in members():
        rows = np.concatenate([np.arange(6 * n, 6 * n + 6) for n in member.ends])
        M[np.ix_(rows, rows)] += element(member)[1]
    T = transformation(n_dof)
    M = T.T @ M[6 * N_PLAN :, 6 * N_PLAN :] @ T
    for floor, slab in enumerate(SLAB_KG):
        for sx in (-1, 1):
            for sy in (-1, 1):
                m = HEAVY_KG if heavy and floor == N_STOREY - 1 and sx == sy == -1 else slab
                # the slab's centre moves with the floor's u, v and rotation; its own inertia is a square plate's
                reach = np.array([[1.0, 0.0, -sy * BAY_M / 2], [0.0, 1.0, sx * BAY_M / 2]])
                own = np.diag([0.0, 0.0, m * BAY_M**2 / 6])
                M[3 * floor : 3 * floor + 3, 3 * floor : 3 * floor + 3] += m * reach.T @ reach + own
    return M


@cache
def channel_rows(n_dof: int) -> np.ndarray:
    """(16, n_dof): what each accelerometer reads of the degrees of freedom."""
    rows = [6 * (N_PLAN * floor + plan) + axis for floor in range(N_STOREY) for plan, axis in SENSORS]
    return transformation(n_dof)[rows]


def modes(K: np.ndarray, M: np.ndarray, n_mode: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (n_mode,) in Hz and shapes (n_dof, n_mode) of unit modal mass. Rotations about x and y have next to
    no mass in the frame of 120: the pencil is turned over, so that it is definite."""
    value, phi = linalg.eigh(M, K)
    value, phi = value[::-1][:n_mode], phi[:, ::-1][:, :n_mode]
    return 1 / np.sqrt(value) / (2 * np.pi), phi / np.sqrt(np.einsum("im,ij,jm->m", phi, M, phi))
