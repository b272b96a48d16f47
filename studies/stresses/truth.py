"""Records and stresses of the OC4 jacket by OpenSees' matrices and loads of its own: what `stresses` is held
against.

The structure is that of `studies/oc4_jacket` (Timoshenko tubes, several to a member, lumped mass); its response is
summed over OpenSees' modes with the static rest, frequency line by frequency line. Wind is von Karman's turbulence
with a moment at the hub, waves are two trains on members by Airy's theory and the inertia of Morison's load; sensors
read specific force and have noise. Nothing of `probupdate` is used here.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import linalg, sparse

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "oc4_jacket"))
import opensees_jacket as jacket

GRAVITY, WATER, DEPTH = 9.80665, 1025.0, 50.0
N_MODE, INERTIA = 90, 2.0


class Recorded(jacket.Build):
    """Keeps each element's nodes and section."""

    def __init__(self, *args, **options):
        self.pieces: dict[int, tuple[int, int, dict]] = {}
        self.outer: dict[int, float] = {}
        super().__init__(*args, **options)

    def _line(self, a, b, **section):
        super()._line(a, b, **section)
        self.pieces[self.element] = (a, b, section)

    def _tube(self, member, one, two, values):
        before = set(self.pieces)
        super()._tube(member, one, two, values)
        self.outer |= {k: values[3] for k in set(self.pieces) - before}


@dataclass(frozen=True)
class Structure:
    """K, M (n, n) of OpenSees' equations; equation (node -> 6 numbers, -1 where held); build."""

    stiffness: np.ndarray
    mass: np.ndarray
    equation: dict[int, np.ndarray]
    follows: dict[int, tuple[int, np.ndarray]]
    build: Recorded

    def rows(self, node: int) -> np.ndarray:
        """(6, n) displacement and rotation of a node; of a rigidly linked one those of its leader."""
        found = np.zeros((6, len(self.stiffness)))
        if node in self.follows:
            lead, arm = self.follows[node]
            of = self.rows(lead)
            cross = np.array([[0, -arm[2], arm[1]], [arm[2], 0, -arm[0]], [-arm[1], arm[0], 0]])
            found[:3], found[3:] = of[:3] - cross @ of[3:], of[3:]
            return found
        for k, e in enumerate(self.equation[node]):
            if e >= 0:
                found[k, e] = 1.0
        return found


def structure(folder: Path) -> Structure:
    b = Recorded(jacket.read_description(folder), jacket.State(), dry=True)
    return equations(b, {lead for lead, _ in b.d.rigid} | set(b.d.piles) | set(b.d.masses))


def equations(b, leaders: set[int]) -> Structure:
    """K and M of a model that stands in OpenSees. b: its `ops`, `place` of nodes, `pieces` and `outer` of elements;
    leaders: nodes that others follow rigidly."""
    ops = b.ops

    def matrix(m: float, k: float) -> np.ndarray:
        ops.wipeAnalysis()
        ops.constraints("Transformation")
        ops.numberer("Plain")
        ops.system("FullGeneral")
        ops.algorithm("Linear")
        ops.integrator("GimmeMCK", m, 0.0, k)
        ops.analysis("Transient")
        ops.analyze(1, 0.0)
        n = ops.systemSize()
        return np.array(ops.printA("-ret")).reshape(n, n)

    K, M = matrix(0.0, 1.0), matrix(1.0, 0.0)
    equation = {node: np.array(ops.nodeDOFs(node)) for node in ops.getNodeTags()}
    at = {tuple(equation[node]): node for node in leaders}
    # a node that is linked rigidly has its leader's equations
    follows = {node: (at[tuple(own)], b.place[node] - b.place[at[tuple(own)]]) for node, own in equation.items()
               if node not in leaders and tuple(own) in at and own[0] >= 0}
    return Structure(0.5 * (K + K.T), 0.5 * (M + M.T), equation, follows, b)


def von_karman(f: np.ndarray, wind: float, turbulence: float, length: float) -> np.ndarray:
    """One-sided spectrum of the longitudinal turbulence, (m/s)^2/Hz."""
    x = f * length / wind
    return (turbulence * wind) ** 2 * 4 * length / wind / (1 + 70.8 * x**2) ** (5 / 6)


def pierson_jonswap(f: np.ndarray, hs: float, tp: float) -> np.ndarray:
    """JONSWAP with a peak factor of 3.3, scaled to its significant height, m^2/Hz."""
    fp = 1 / tp
    peak = np.exp(-0.5 * ((f / fp - 1) / np.where(f > fp, 0.09, 0.07)) ** 2)
    shape = f**-5.0 * np.exp(-1.25 * (fp / f) ** 4) * 3.3**peak
    shape[f > 0.6] = 0.0
    return shape * (hs / 4) ** 2 / np.trapezoid(shape, f)


def wave_number(omega: np.ndarray) -> np.ndarray:
    k = np.maximum(omega**2 / GRAVITY, 1e-6)
    for _ in range(60):
        k = omega**2 / GRAVITY / np.tanh(np.clip(k * DEPTH, 1e-9, 300)) * 0.5 + 0.5 * k
    return k


@dataclass(frozen=True)
class Wet:
    """Pieces under water: middles and directions (n_piece, 3), volume of each, and half of each one's load at both
    of its ends, (n, 3 n_piece)."""

    middle: np.ndarray
    along: np.ndarray
    volume: np.ndarray
    spread: sparse.csr_array

    def forces(self, f: np.ndarray, heading: float) -> np.ndarray:
        """(3 n_piece, n_line) complex force of a metre of amplitude: Morison's inertia across the piece, Airy's
        waves."""
        omega, k = 2 * np.pi * f, wave_number(2 * np.pi * f)
        way = np.array([np.cos(heading), np.sin(heading)])
        z = self.middle[:, 2:]
        deep = np.minimum(k * DEPTH, 300)
        c = np.cosh(np.minimum(k * (z + DEPTH), 300)) / np.sinh(deep)
        h = np.sinh(np.minimum(k * (z + DEPTH), 300)) / np.sinh(deep)
        phase = np.exp(-1j * k * (self.middle[:, :2] @ way)[:, None])
        speed = np.stack([omega * c * way[0] * phase, omega * c * way[1] * phase, 1j * omega * h * phase], axis=1)
        speed -= self.along[:, :, None] * np.einsum("pi,pif->pf", self.along, speed)[:, None, :]
        return (WATER * INERTIA * self.volume[:, None, None] * 1j * omega * speed).reshape(-1, len(f))


def wet_pieces(s: Structure) -> Wet:
    middle, along, volume, blocks = [], [], [], []
    for number, diameter in s.build.outer.items():
        a, b, _ = s.build.pieces[number]
        pa, pb = s.build.place[a], s.build.place[b]
        if 0.5 * (pa + pb)[2] >= 0:
            continue
        length = np.linalg.norm(pb - pa)
        middle.append(0.5 * (pa + pb))
        along.append((pb - pa) / length)
        volume.append(np.pi / 4 * diameter**2 * length)
        blocks.append(sparse.csr_array(0.5 * (s.rows(a)[:3] + s.rows(b)[:3]).T))
    return Wet(np.array(middle), np.array(along), np.array(volume), sparse.csr_array(sparse.hstack(blocks)))


def end_forces(s: Structure, number: int) -> np.ndarray:
    """(12, n) forces and moments, global, at the ends of an element: Timoshenko's stiffness with lumped mass."""
    a, b, q = s.build.pieces[number]
    span = s.build.place[b] - s.build.place[a]
    L = float(np.linalg.norm(span))
    x = span / L
    y = np.cross(np.eye(3)[np.argmin(np.abs(x))], x)
    y /= np.linalg.norm(y)
    R = np.kron(np.eye(4), np.array([x, y, np.cross(x, y)]))
    EA, GJ, EI, GA = q["e"] * q["area"], q["g"] * q["torsion"], q["e"] * q["second"], q["g"] * q["shear"]
    k = np.zeros((12, 12))
    for i, c in ((0, EA / L), (3, GJ / L)):
        k[i, i] = k[i + 6, i + 6] = c
        k[i, i + 6] = k[i + 6, i] = -c
    soft = 12 * EI / (GA * L**2)
    e = EI / (L**3 * (1 + soft))
    for v, r, sign in ((1, 5, 1.0), (2, 4, -1.0)):
        at = [v, r, v + 6, r + 6]
        block = e * np.array([[12, 6 * L, -12, 6 * L], [6 * L, (4 + soft) * L**2, -6 * L, (2 - soft) * L**2],
                              [-12, -6 * L, 12, -6 * L], [6 * L, (2 - soft) * L**2, -6 * L, (4 + soft) * L**2]])
        turn = np.diag([1.0, sign, 1.0, sign])
        k[np.ix_(at, at)] += turn @ block @ turn
    return R.T @ k @ R @ np.vstack([s.rows(a), s.rows(b)])


@dataclass(frozen=True)
class Sea:
    wind_mps: float
    turbulence: float
    thrust_n_per_mps: float
    hs_m: float
    tp_s: float
    heading: float


@dataclass(frozen=True)
class World:
    """What is asked for, as rows of the modes (n_out, n_mode) and of the flexibility: of the hub's six forces
    (n_out, 6) and of the wet pieces' (n_out, 3 n_piece); the modes' loads of the same."""

    value: np.ndarray
    damping: np.ndarray
    wet: Wet
    n_channel: int
    of_modes: np.ndarray
    of_hub: np.ndarray
    of_waves: np.ndarray
    hub_modes: np.ndarray
    wave_modes: np.ndarray

    def record(self, sea: Sea, seconds: float, rate: float, noise: float, rng) -> tuple[np.ndarray, np.ndarray]:
        """Readings (n_sample, n_channel) in m/s2 and nominal stresses (n_sample, n_stress) in MPa."""
        # twice as long, and cut: nothing of it is periodic
        n = round(2 * seconds * rate)
        f = np.fft.rfftfreq(n, 1 / rate)[1:]
        f = f[f <= 4.0]

        def drawn(density):
            z = rng.standard_normal((2, len(f)))
            return np.sqrt(density * rate * n / 4) * (z[0] + 1j * z[1])

        gust = von_karman(f, sea.wind_mps, sea.turbulence, 150.0) / (1 + (6 * f * 60 / sea.wind_mps) ** (4 / 3)) ** 2
        c, t = np.cos(sea.heading), np.sin(sea.heading)
        along, across = (sea.thrust_n_per_mps * drawn(x * gust) for x in (1.0, 0.15))
        # shear over the rotor: a moment about the horizontal axis, partly with the thrust
        pitch = 12.0 * along + 20.0 * sea.thrust_n_per_mps * drawn(0.2 * gust)
        hub = np.zeros((6, len(f)), complex)
        hub[0], hub[1], hub[3], hub[4] = c * along - t * across, t * along + c * across, -t * pitch, c * pitch
        trains = [(sea.heading + turn, drawn(share * pierson_jonswap(f, sea.hs_m, sea.tp_s)))
                  for turn, share in ((0.0, 0.8), (0.6, 0.2))]
        nc = self.n_channel
        readings = np.zeros((nc, n // 2 + 1), complex)
        stress = np.zeros((len(self.of_modes) - 2 * nc, n // 2 + 1), complex)
        for start in range(0, len(f), 400):
            part = slice(start, min(start + 400, len(f)))
            omega = 2 * np.pi * f[part]
            waves = sum(self.wet.forces(f[part], heading) * x[part] for heading, x in trains)
            modal = self.hub_modes @ hub[:, part] + self.wave_modes @ waves
            plain = self.value[:, None] - omega**2 + 2j * omega * (self.damping * np.sqrt(self.value))[:, None]
            out = (self.of_modes @ (modal / plain - modal / self.value[:, None]) + self.of_hub @ hub[:, part]
                   + self.of_waves @ waves)
            at = slice(1 + part.start, 1 + part.stop)
            readings[:, at] = -out[:nc] * omega**2 - GRAVITY * out[nc : 2 * nc]
            stress[:, at] = out[2 * nc :]
        half = slice(n // 4, n // 4 + n // 2)
        found = np.fft.irfft(readings, n).T[half]
        return found + noise * np.sqrt(rate / 2) * rng.standard_normal(found.shape), np.fft.irfft(stress, n).T[half]


def world(folder: Path, sensors, details, hub_offset=(-5.0191, 0.0, 2.4), seed: int = 5) -> World:
    """sensors: (joint, axis 0 or 1); details: place, unit vector along the member, crown, saddle, end 0 or 1."""
    s = structure(folder)
    small = 1e-9 * np.max(s.mass) * np.eye(len(s.mass))
    value, phi = linalg.eigh(s.stiffness, s.mass + small, subset_by_index=(0, N_MODE - 1))
    rng = np.random.default_rng(seed)
    motion, tilt = [], []
    for joint, axis in sensors:
        rows = s.rows(joint)
        motion.append(rows[axis])
        # along x a tilt about y reads +g theta_y beside w^2 u_x, along y -g theta_x beside w^2 u_y
        tilt.append(rows[4] if axis == 0 else -rows[3])
    pieces = [nominal(s, *d) for d in details]
    rows = np.vstack([motion, tilt, *(stress @ end_forces(s, number) for number, stress in pieces)])
    r = np.array(hub_offset)
    top, cross = s.rows(jacket.TOP), np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])
    hub = np.vstack([top[:3] - cross @ top[3:], top[3:]])
    wet = wet_pieces(s)
    flexible = linalg.cho_solve(linalg.cho_factor(s.stiffness), rows.T).T
    return World(value=value, damping=0.01 * np.exp(0.2 * rng.standard_normal(N_MODE)), wet=wet, n_channel=len(motion),
                 of_modes=rows @ phi, of_hub=flexible @ hub.T, of_waves=flexible @ wet.spread, hub_modes=phi.T @ hub.T,
                 wave_modes=phi.T @ wet.spread)


def nominal(s: Structure, place, along, crown, saddle, end: int) -> tuple[int, np.ndarray]:
    """A piece's number, and (3, 12) axial stress and bending stress at crown and saddle, MPa, of its end forces."""
    for number in s.build.outer:
        a, b, q = s.build.pieces[number]
        x = s.build.place[b] - s.build.place[a]
        x = x / np.linalg.norm(x)
        for node, own in ((a, 0), (b, 1)):
            if np.linalg.norm(s.build.place[node] - place) < 1e-3 and abs(x @ along) > 0.9999:
                # the piece that lies on the member's side of the joint
                away = x if own == 0 else -x
                wanted = along if end == 0 else -along
                if away @ wanted < 0:
                    continue
                # on the face that looks along the member, as the details count it
                sign = 1.0 if end else -1.0
                bending = s.build.outer[number] / 2 / q["second"]
                found = np.zeros((3, 12))
                found[0, 6 * own : 6 * own + 3] = sign * along / q["area"]
                found[1, 6 * own + 3 : 6 * own + 6] = sign * bending * np.cross(crown, along)
                found[2, 6 * own + 3 : 6 * own + 6] = sign * bending * np.cross(saddle, along)
                return number, 1e-6 * found
    raise LookupError(f"no piece at {place} along {along}")
