"""Loads from measured motion, and the stresses that follow: a Wiener smoother in the frequency domain.

At each frequency line the readings are y = H p + e. p are amplitudes of unknown loads: thrust along and across the
wind, waves from two directions, and a force on each of the first modes for whatever else loads them. H = L(omega)
q(omega) holds what accelerometers read of the structure's motion, gravity through their tilt included, so that slow
bending, of which the acceleration itself is lost in noise, is seen. With densities D of the loads and N of the noise
the loads given the record are Gaussian, with mean A y and covariance P, A = D H^H (H D H^H + N)^-1, P = D - A H D;
stresses are linear in p, quasi-static response to each load included. D and N are learnt of the records in bands of
a third of an octave (expectation and maximisation), beginning at the loads that fatigue.toml states: a load that the
sensors do not see keeps its stated density, and what it adds to a stress is counted as uncertain.

Sources: Maes et al., Mech. Syst. Signal Process. 76-77 (2016) 592-611 (strains of a monopile from accelerations);
Dempster, Laird and Rubin, J. R. Stat. Soc. B 39 (1977) 1-38 (learning of D and N); MacKay, Neural Comput. 4 (1992)
415-447 (steps that do not stall where a load is far above what is stated).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from probupdate.lifetime.damping import StateDamping
from probupdate.lifetime.modal_stress import ModalStress, times
from probupdate.lifetime.stress import DYNAMIC_HZ, HIGHEST_HZ, LOWEST_HZ, WAVES_TO_HZ, Case, StressModel
from probupdate.runtime.arrays import frozen_array

# densities are constant in bands of this ratio, learnt of so many lines of each, in so many steps
BAND, LINES, STEPS = 2 ** (1 / 3), 8, 30
# the upper end of what is used of a record, over its sampling rate: below a logger's anti-aliasing filter
USED_OF_RATE = 0.4
# share of readings that the model misses, as its shapes do: the model-discrepancy standard deviation of a shape
SHAPE_ERROR = 0.01
# unit of a channel's quantity in terms of its acceleration: divisions by i omega
INTEGRATED = {"acceleration": 0, "velocity": 1, "displacement": 2}
# share of a strain gauge's stress that the model misses: its section and place, the gauge's factor
GAUGE_ERROR = 0.03
# up to so much of its sampling rate a gauge is used, whose samples are joined by lines; noise where it is not
GAUGE_OF_RATE, UNUSED = 0.1, 1e12
CHUNK = 256
# a load of which readings resolve a smaller share than this in a band stays near its stated density there; with 1 it is
# expectation and maximisation, which stalls: of sixty drawn bands with forces of 1e-4 to 1e6 times the stated density
# log-likelihood is short of the best by 9 in the median after these steps (23 at worst of nine in ten), by 356 there
HELD = 0.003
# between nodes of waves' loads: at 0.6 Hz their phase 25 m from the axis turns by 0.4 rad, of which splines miss 1e-4
NODE_HZ = 0.003
# of the lines with waves, each so many'th stands for its neighbours where shapes under their loads are made
EVERY = 16


def used_lines(n_sample: int, rate_hz: float) -> tuple[np.ndarray, np.ndarray]:
    """Numbers and frequencies (n_line,) of a record's Fourier lines that are used: from one cycle in ten minutes on."""
    line = np.fft.rfftfreq(n_sample, 1 / rate_hz)
    number = np.flatnonzero((line >= LOWEST_HZ * (1 - 1e-9)) & (line <= min(HIGHEST_HZ, USED_OF_RATE * rate_hz)))
    return number, line[number]


@dataclass(frozen=True, eq=False, kw_only=True)
class LoadedStructure:
    """A structure under unit loads at frequency lines (n_line,), in the coordinates of its modes on a basis.

    constant (n_basis, n_constant): unit forces that are alike at all frequencies; wave (2, n_basis, n_wet) and own
    (2, n_stress, n_wet): loads of a metre of wave amplitude at the first n_wet lines, and what of them does not go
    through the details' members; motion, tilt (n_channel, n_basis): rows of the channels, tilt times gravity; order
    (n_channel,) how often a channel's quantity is integrated; stated (n_input, n_line): densities of the loads
    before any record.
    """

    frequency_hz: np.ndarray
    modes: ModalStress
    constant: np.ndarray
    wave: np.ndarray
    own: np.ndarray
    motion: np.ndarray
    tilt: np.ndarray
    order: np.ndarray
    stated: np.ndarray
    names: tuple[str, ...]
    n_gauge: int = 0
    gauge_to_hz: float = np.inf
    past: np.ndarray | None = None

    def with_gauges(self, detail: np.ndarray, weight: np.ndarray, rate_hz: float) -> LoadedStructure:
        """With strain gauges as further channels, in MPa: detail (n,) that each lies at, weight (n, 3) of its nominal
        stresses, their sampling rate."""
        def rows(x: np.ndarray) -> np.ndarray:
            return np.einsum("ki,ki...->k...", weight, x.reshape(-1, 3, *x.shape[1:])[detail])

        # R_K q - omega^2 R_M q, as channels read -(omega^2 motion + tilt) q
        return replace(
            self, motion=np.vstack([self.motion, rows(self.modes.RM)]),
            tilt=np.vstack([self.tilt, -rows(self.modes.RK)]), order=np.append(self.order, np.zeros(len(detail), int)),
            n_gauge=len(detail), gauge_to_hz=GAUGE_OF_RATE * rate_hz, past=np.stack([rows(x) for x in self.own]))

    @property
    def n_constant(self) -> int:
        return self.constant.shape[1]

    def unit_motion(self, lines: np.ndarray) -> np.ndarray:
        """(n, n_basis, n_input) complex motion of the modes at these lines under each unit load."""
        plain = self.modes.plain[:, lines].T
        q = np.zeros((len(lines), plain.shape[1], self.n_constant + 2), complex)
        q[:, :, : self.n_constant] = self.constant / plain[:, :, None]
        wet = lines < self.wave.shape[2]
        q[wet, :, self.n_constant :] = self.wave[:, :, lines[wet]].transpose(2, 1, 0) / plain[wet][:, :, None]
        return q

    def read(self, lines: np.ndarray) -> np.ndarray:
        """(n, n_channel, n_input) H: what the channels read under each unit load."""
        q, omega = self.unit_motion(lines), self.modes.omega[lines]
        felt = _real_times(self.motion, q) * omega[:, None, None] ** 2 + _real_times(self.tilt, q)
        found = -felt / (1j * omega[:, None])[:, :, None] ** self.order[None, :, None]
        if self.n_gauge:
            wet = lines < self.wave.shape[2]
            found[wet, -self.n_gauge :, self.n_constant :] -= self.past[:, :, lines[wet]].transpose(2, 1, 0)
        return found

    @cached_property
    def _stress_rows(self) -> tuple[np.ndarray, np.ndarray]:
        """Stresses (n_stress, 2 n_basis) of motion and of acceleration, and one over the modes' dynamic stiffness, in
        single precision: twice as fast, and 1e-6 of a stress."""
        m = self.modes
        return np.hstack([m.RK, m.RM]).astype(np.float32), (1 / m.plain).astype(np.complex64)

    def stress(self, load: np.ndarray) -> np.ndarray:
        """(n_stress, n_line) complex nominal stress in MPa of loads (n_input, n_line)."""
        n, wet = self.n_constant, self.wave.shape[2]
        rows, flexibility = self._stress_rows
        q = times(self.constant, load[:n])
        for j in range(2):
            q[:, :wet] += self.wave[j] * load[n + j, :wet]
        q = q * flexibility
        found = times(rows, np.vstack([q, -(self.modes.omega**2) * q]).astype(np.complex64))
        for j in range(2):
            found[:, :wet] -= self.own[j] * load[n + j, :wet]
        return found

    def unit_stress(self, lines: np.ndarray) -> np.ndarray:
        """(n, n_stress, n_input) nominal stress under each unit load."""
        q, m = self.unit_motion(lines), self.modes
        found = _real_times(m.RK, q) - _real_times(m.RM, q * m.omega[lines][:, None, None] ** 2)
        wet = lines < self.wave.shape[2]
        found[wet, :, self.n_constant :] -= self.own[:, :, lines[wet]].transpose(2, 1, 0)
        return found


def wind_cases(model: StressModel, state: int, frequency_hz: np.ndarray) -> tuple[Case, Case]:
    """Loads of one of the model's states at these frequencies, along the wind and across it. Of waves the structure's
    loads are taken between nodes: their phase turns by less than half a radian from one to the next."""
    one = model.conditions.model_copy(update={"state": (model.conditions.state[state],)})
    wet = frequency_hz[frequency_hz <= WAVES_TO_HZ]
    nodes = np.linspace(wet[0], wet[-1], max(5, 1 + int(np.ceil((wet[-1] - wet[0]) / NODE_HZ))))
    thrust, elevation = replace(model, frequency_hz=frequency_hz, conditions=one).densities(one.state[0])
    model = replace(model, frequency_hz=nodes, conditions=one)

    def interpolated(case: Case) -> Case:
        load, own = (CubicSpline(nodes, x, axis=1)(wet) for x in (case.load, case.own))
        return replace(case, load=load, own=own, thrust=thrust, elevation=elevation)

    return interpolated(model.cases[0]), interpolated(model.rotate_loads().cases[0])


def loaded_structure(
    model: StressModel, theta: np.ndarray, damping: Mapping[str, float] | StateDamping, cases: tuple[Case, Case],
    frequency_hz: np.ndarray, order: np.ndarray, n_modal: int,
) -> LoadedStructure:
    """`model`, reduced both ways, at theta under the loads `wind_cases` of a state. `order` (n_channel,): see
    `Driven`; n_modal: modes with a force of their own."""
    model = replace(model, frequency_hz=frequency_hz)
    case, other = cases
    known = damping if isinstance(damping, StateDamping) else StateDamping.alike(damping)
    m = model.modes_at(theta, known.for_state(case.state.operating))
    basis = np.eye(model.model.n_dof) if model.basis is None else model.basis
    hub = basis.T @ np.column_stack([model.hub, model.across])
    some = np.hstack([part(c.load[:, ::EVERY]) for c in cases for part in (np.real, np.imag)])
    slow = max(n_modal, len(m.labels), int(np.searchsorted(m.value, (2 * np.pi * DYNAMIC_HZ) ** 2)))
    m = m.condense(np.hstack([hub, some]), slow)
    V = basis @ m.U
    n_modal = min(n_modal, V.shape[1])
    thrust = m.U.T @ hub
    wave = np.array([m.U.T @ c.load for c in (case, other)])
    elevation = np.zeros(len(frequency_hz))
    elevation[: len(case.elevation)] = case.elevation
    # what else loads a mode is taken to be as much as these, before any record
    others = thrust[:n_modal] ** 2 @ np.array([case.thrust, case.thrust])
    others[:, : wave.shape[2]] += np.sum(np.abs(wave[:, :n_modal]) ** 2, axis=0) * case.elevation
    structure = model.model
    rows = structure.channel_rows(theta) @ V
    n = len(structure.channels)
    held = np.zeros(n) if structure.gravity is None else structure.gravity.evaluate(np.asarray(theta, float))
    tilt = held[:, None] * rows[n:] if structure.tilt_matrix is not None else np.zeros_like(rows[:n])
    # a displacement transducer feels no gravity
    tilt = np.where((order < 2)[:, None], tilt, 0.0)
    return LoadedStructure(
        frequency_hz=frozen_array(frequency_hz), modes=m,
        constant=frozen_array(np.column_stack([thrust, np.eye(V.shape[1])[:, :n_modal]])),
        wave=wave, own=np.array([m.scale * c.own for c in (case, other)]),
        motion=frozen_array(rows[:n]), tilt=frozen_array(tilt), order=frozen_array(order, int),
        stated=frozen_array(_replace_zeros(np.vstack([case.thrust, case.thrust, others, elevation, elevation]))),
        names=("thrust along the wind", "thrust across the wind", *(f"mode {k + 1}" for k in range(n_modal)),
               "waves along the wind", "waves across the wind"))


@dataclass(frozen=True, eq=False, kw_only=True)
class Smoother:
    """Loads given readings: gain (n_line, n_input, n_channel); load (n_input, n_line) and noise (n_line, n_channel)
    densities as learnt; `of` the structure."""

    of: LoadedStructure
    load: np.ndarray
    noise: np.ndarray
    gain: np.ndarray

    def estimate(self, readings: np.ndarray) -> np.ndarray:
        """(n_input, n_line) expected loads given readings (n_line, n_channel) complex."""
        return np.matmul(self.gain, readings[:, :, None])[:, :, 0].T

    def unresolved_covariance(self, lines: np.ndarray) -> np.ndarray:
        """(n, n_input, n_input) covariance P of the loads given any readings, at these lines."""
        H, D = self.of.read(lines), self.load[:, lines].T
        P = -np.matmul(self.gain[lines], H * D[:, None, :])
        P[:, np.arange(P.shape[1]), np.arange(P.shape[1])] += D
        return 0.5 * (P + np.conj(P.transpose(0, 2, 1)))


def smoother(of: LoadedStructure, cross: np.ndarray, channels: np.ndarray) -> Smoother:
    """Learnt from the mean cross-spectral densities `cross` (n_line, n_channel, n_channel) of records with these
    channels (numbers) alike in load; other channels are not used."""
    f = of.frequency_hz
    band = _bands(f)
    auto = np.real(np.einsum("lcc->lc", cross))
    load, noise = np.array(of.stated), np.zeros_like(auto)
    chosen = [np.unique(np.linspace(first, last - 1, min(LINES, last - first)).astype(int)) for first, last in band]
    lines, first = np.concatenate(chosen), np.cumsum([0, *map(len, chosen[:-1])])
    stated = np.array([np.mean(of.stated[:, own], axis=1) for own in chosen])
    gauge = channels - (len(of.motion) - of.n_gauge)
    error, floor = np.where(gauge >= 0, GAUGE_ERROR, SHAPE_ERROR) ** 2, _gauge_noise(of, auto, band, gauge >= 0)
    missed = error * np.concatenate([np.tile(np.mean(auto[own], axis=0), (len(own), 1)) for own in chosen])
    D, nu = _learn(of.read(lines)[:, channels], cross[lines], first, stated, missed + floor[lines], gauge < 0)
    middle = [np.log(np.mean(f[own])) for own in chosen]
    learnt_load, learnt_noise = np.log(D / stated), np.log(nu)
    at = np.log(f)
    for i in range(len(load)):
        load[i] *= np.exp(np.interp(at, middle, learnt_load[:, i]))
    smooth = np.exp(_interpolate_bands(at, middle, np.log([np.mean(auto[a:b], axis=0) for a, b in band])))
    noise = np.exp(np.interp(at, middle, learnt_noise))[:, None] * (gauge < 0) + error * smooth + floor
    gain = np.empty((len(f), len(load), len(channels)), complex)
    for start in range(0, len(f), CHUNK):
        lines = np.arange(start, min(start + CHUNK, len(f)))
        gain[lines] = _gain(of.read(lines)[:, channels], load[:, lines].T, noise[lines])
    past = None if of.past is None else of.past[:, gauge[gauge >= 0]]
    kept = replace(of, motion=of.motion[channels], tilt=of.tilt[channels], order=of.order[channels], past=past,
                   n_gauge=int(np.sum(gauge >= 0)))
    return Smoother(of=kept, load=load, noise=noise, gain=gain)


def _gauge_noise(of: LoadedStructure, auto: np.ndarray, band: list[tuple[int, int]], gauge: np.ndarray) -> np.ndarray:
    """(n_line, n_channel) densities of gauges' own noise, none of other channels: white, as large as the least that a
    band holds, and without bound above the frequency up to which gauges are used."""
    f, floor = of.frequency_hz, np.zeros_like(auto)
    if np.any(gauge):
        within = [(a, b) for a, b in band if f[b - 1] <= of.gauge_to_hz] or band[:1]
        own = auto[:, gauge]
        floor[:, gauge] = np.maximum(np.min([np.mean(own[a:b], axis=0) for a, b in within], axis=0),
                                     np.max(own, axis=0) / UNUSED)
        floor[np.ix_(f > of.gauge_to_hz, gauge)] = UNUSED * np.max(own)
    return floor


def _replace_zeros(density: np.ndarray) -> np.ndarray:
    """A density of zero is one that no record could change."""
    return np.maximum(density, np.maximum(1e-9 * np.max(density, axis=1, keepdims=True), 1e-300))


def _bands(f: np.ndarray) -> list[tuple[int, int]]:
    """First and last number of the lines of each band; three lines at least."""
    found, start = [], 0
    while start < len(f):
        end = max(int(np.searchsorted(f, f[start] * BAND)), start + 3)
        end = len(f) if len(f) - end < 3 else end
        found.append((start, end))
        start = end
    return found


def _learn(
    H: np.ndarray, cross: np.ndarray, first: np.ndarray, load: np.ndarray, missed: np.ndarray, noisy: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Densities of the loads (n_band, n_input) and of a noise that all `noisy` channels (n_channel,) have (n_band,),
    from H (n, n_channel, n_input) and mean cross-spectral densities (n, n_channel, n_channel) at lines of which each
    band's begin at `first` (n_band,); `load` before, `missed` (n, n_channel) of the readings known not to be followed.
    Where a step changes nothing no step of expectation and maximisation does, and the records are most probable
    (MacKay 1992: a density is what is expected of the load, over the share of it that the readings resolve)."""
    count = np.diff(np.r_[first, len(H)])
    of_line = np.repeat(np.arange(len(first)), count)

    def mean(x: np.ndarray) -> np.ndarray:
        return np.add.reduceat(x, first, axis=0) / count[:, None]

    auto = np.real(np.einsum("lcc->lc", cross))
    weight = noisy / max(np.sum(noisy), 1)
    nu = 0.01 * mean(auto) @ weight + 1e-300
    unit = np.arange(H.shape[2])
    for _ in range(STEPS):
        common = nu[of_line][:, None] * noisy
        N = common + missed
        # readings over their noise, loads over their standard deviation
        root, std = 1 / np.sqrt(N), np.sqrt(load[of_line])
        B = H * root[:, :, None] * std[:, None, :]
        BH = np.conj(B.transpose(0, 2, 1))
        Q = np.matmul(BH, B)
        Q[:, unit, unit] += 1.0
        Q = np.linalg.inv(Q)
        A = np.matmul(Q, BH)
        AY = np.matmul(A, cross * root[:, :, None] * root[:, None, :])
        # expected second moments of the loads, and of what they make of the readings
        E = np.matmul(AY, np.conj(A.transpose(0, 2, 1))) + Q
        seen = np.real(np.einsum("lcj,lcj->lc", np.matmul(B, E), np.conj(B)))
        with_readings = np.real(np.einsum("lci,lic->lc", B, AY))
        residual = np.maximum(auto * root**2 - 2 * with_readings + seen, 0.0) * N
        unseen = mean(np.real(Q[:, unit, unit]))
        load = np.maximum(load * (mean(np.real(E[:, unit, unit])) - (1 - HELD) * unseen) / (1 - (1 - HELD) * unseen),
                          1e-300)
        residual = np.maximum(auto * root**2 - 2 * with_readings + seen, 0.0) * N
        share = common / N
        nu = mean(share**2 * residual + common * (1 - share)) @ weight + 1e-300
    return load, nu


def _gain(H: np.ndarray, load: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """(n, n_input, n_channel) D H^H (H D H^H + N)^-1; load (n, n_input), noise (n, n_channel)."""
    HD = H * load[:, None, :]
    S = np.matmul(HD, np.conj(H.transpose(0, 2, 1)))
    # of one scale, as channels and bands differ by many orders of magnitude
    scale = 1 / np.sqrt(np.real(np.einsum("lcc->lc", S)) + noise)
    S = S * scale[:, :, None] * scale[:, None, :]
    S[:, np.arange(S.shape[1]), np.arange(S.shape[1])] += noise * scale**2
    solved = np.linalg.solve(S, HD * scale[:, :, None])
    return np.conj(solved.transpose(0, 2, 1)) * scale[:, None, :]


def _interpolate_bands(at: np.ndarray, middle: list[float], values: np.ndarray) -> np.ndarray:
    """(n_line, n_channel) linear between bands."""
    return np.column_stack([np.interp(at, middle, values[:, c]) for c in range(values.shape[1])])


def _real_times(real: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(n, a, i) of a real matrix (a, b) times complex (n, b, i)."""
    n, _, i = x.shape
    both = np.concatenate([np.real(x), np.imag(x)], axis=2)
    found = np.matmul(real, both)
    return found[:, :, :i] + 1j * found[:, :, i:]
