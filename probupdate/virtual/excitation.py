"""Loads on the virtual turbine: turbulence at the RNA, waves on the legs, harmonics of the rotor, transients.

Random loads are made of pieces of 20 min, one every 10 min, each with the spectrum of its own weather and windows
sin(pi t / 20 min), whose squares add up to one. A piece depends on the seed and its number only: an hour can be
made alone, and joins its neighbours without a seam.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probupdate.virtual.operation import GRID_S, RATED_MPS, SLOT_S, Plan, turbulence_std

AIR_KGPM3, WATER_KGPM3, GRAVITY = 1.225, 1025.0, 9.81
KAIMAL_LENGTH_M = 340.2  # IEC 61400-1, 8.1 times 42 m
ADMITTANCE_AREA_M2 = 400.0
# N (or N m) per m/s of wind fluctuation: operating, and per (m/s)^2 while idling (drag grows with the mean)
GAIN_OPERATING = np.array([6.0e4, 1.2e4, 2.5e5, 2.5e5])
GAIN_IDLING = np.array([650.0, 450.0, 4.0e3, 4.0e3])
# harmonic amplitudes at rated speed: rows 1P, 3P, 6P; columns thrust, side (N), tilt, yaw (N m)
HARMONICS = ((1, (3.0e3, 3.0e3, 2.0e4, 2.0e4)), (3, (1.0e4, 3.0e3, 1.5e5, 1.5e5)), (6, (3.0e3, 1.0e3, 5.0e4, 5.0e4)))
INERTIA_AREA_M2 = 1.8  # of a leg with its share of braces, for Morison's inertia force
INERTIA_COEFFICIENT = 2.0
SPREADING_DEG = 30.0
BACKGROUND = 0.15  # (N/kg^0.5)/Hz^0.5 per modal coordinate at a wave height of 1 m


@dataclass(frozen=True, eq=False, kw_only=True)
class Loads:
    """rna (n, 4): thrust, side force, tilt and yaw moment in the nacelle's axes; wave (n, 2 n_leg): x then y;
    background (n, n_mode): modal forces; N, N m and N/kg^0.5."""

    rna: np.ndarray
    wave: np.ndarray
    background: np.ndarray


def piece_rng(seed: int, kind: int, number: int) -> np.random.Generator:
    """The random numbers of one piece; pieces before the start have negative numbers down to -4."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(kind, number + 4)))


def _slot(plan: Plan, number: int) -> int:
    return min(max(number, 0), plan.n_slot - 1)


def _synthesise(rng: np.random.Generator, spectrum: np.ndarray, n: int, rate: float) -> np.ndarray:
    """Complex amplitudes (n/2+1,) of a Gaussian signal of n samples with a one-sided spectrum (unit^2/Hz)."""
    z = rng.standard_normal((2, len(spectrum)))
    amplitude = np.sqrt(spectrum * n * rate / 4) * (z[0] + 1j * z[1])
    amplitude[0] = 0.0
    amplitude[-1] = 0.0
    return amplitude


def kaimal(frequency_hz: np.ndarray, wind_mps: float, area_m2: float = ADMITTANCE_AREA_M2) -> np.ndarray:
    """Spectrum of the wind felt by the rotor in (m/s)^2/Hz: Kaimal (IEC 61400-1) times Vickery's admittance."""
    wind = max(wind_mps, 1.0)
    reduced = KAIMAL_LENGTH_M / wind
    spectrum = turbulence_std(wind) ** 2 * 4 * reduced / (1 + 6 * frequency_hz * reduced) ** (5 / 3)
    return spectrum / (1 + (2 * frequency_hz * np.sqrt(area_m2) / wind) ** (4 / 3)) ** 2


def jonswap(frequency_hz: np.ndarray, height_m: float, period_s: float, peak: float = 3.3) -> np.ndarray:
    """Surface elevation spectrum (n_line,) in m^2/Hz, scaled to the significant wave height
    (Hasselmann et al. 1973)."""
    f = np.where(frequency_hz > 0, frequency_hz, 1.0)
    ratio = f * period_s
    width = np.where(ratio <= 1, 0.07, 0.09)
    shape = f**-5.0 * np.exp(-1.25 * ratio**-4.0) * peak ** np.exp(-((ratio - 1) ** 2) / (2 * width**2))
    shape = np.where(frequency_hz > 0, shape, 0.0)
    return height_m**2 / 16 * shape / (np.sum(shape) * (frequency_hz[1] - frequency_hz[0]))


def _pieces(first_s: float, n: int, rate: float):
    """Which pieces touch the samples: (number, rows of the record, rows of the piece, window)."""
    length, hop = round(2 * SLOT_S * rate), round(SLOT_S * rate)
    start = round(first_s * rate)
    window = np.sin(np.pi * (np.arange(length) + 0.5) / length)
    for number in range((start - length) // hop + 1, (start + n) // hop + 2):
        begin = (number - 1) * hop - start
        low, high = max(begin, 0), min(begin + length, n)
        if low < high:
            yield number, slice(low, high), slice(low - begin, high - begin), window[low - begin : high - begin]


def random_loads(plan: Plan, leg_xy: np.ndarray, seed: int, first_s: float, n: int, rate: float):
    """Wind fluctuations (n, 4) in m/s (along, across, and two of shear) and wave forces (n, 2 n_leg) in N."""
    wind, wave = np.zeros((n, 4)), np.zeros((n, 2 * len(leg_xy)))
    length = round(2 * SLOT_S * rate)
    frequency = np.fft.rfftfreq(length, 1 / rate)
    force = INERTIA_COEFFICIENT * WATER_KGPM3 * GRAVITY * INERTIA_AREA_M2
    for number, rows, inside, window in _pieces(first_s, n, rate):
        rng = piece_rng(seed, 1, number)
        slots = [_slot(plan, number - 1), _slot(plan, number)]
        felt = kaimal(frequency, float(np.mean(plan.wind_mps[slots])))
        for column in range(4):
            piece = np.fft.irfft(_synthesise(rng, felt, length, rate), length)
            wind[rows, column] += window * piece[inside]
        sea = jonswap(frequency, float(np.mean(plan.wave_height_m[slots])), float(np.mean(plan.wave_period_s[slots])))
        towards = np.mean(plan.wind_direction_deg[slots])
        for spread in (-SPREADING_DEG, SPREADING_DEG):
            # two trains of half the energy; deep water, k = omega^2 / g; wind from 0 deg runs along +x
            elevation = _synthesise(rng, 0.5 * sea, length, rate)
            angle = np.radians(towards + spread)
            along = np.array([np.cos(angle), -np.sin(angle)])
            wavenumber = (2 * np.pi * frequency) ** 2 / GRAVITY
            for leg, xy in enumerate(leg_xy):
                piece = window * np.fft.irfft(1j * elevation * np.exp(-1j * wavenumber * (xy @ along)), length)[inside]
                wave[rows, leg] += force * along[0] * piece
                wave[rows, len(leg_xy) + leg] += force * along[1] * piece
    return wind, wave


def mean_thrust(wind_mps: np.ndarray) -> np.ndarray:
    """Operating thrust in N, same shape as the wind: C_T 0.8 on a rotor of 126 m up to rated wind, falling beyond."""
    full = 0.5 * AIR_KGPM3 * 0.8 * np.pi * 63.0**2
    return full * np.minimum(wind_mps, RATED_MPS) ** 2 * np.minimum(1.0, RATED_MPS / np.maximum(wind_mps, 0.1)) ** 1.5


def _pulse(time: np.ndarray, centre: float, width: float) -> np.ndarray:
    return np.where(np.abs(time - centre) < width / 2, np.cos(np.pi * (time - centre) / width), 0.0)


def make_loads(
    plan: Plan, leg_xy: np.ndarray, n_mode: int, seed: int, first_s: float, n: int, rate: float
) -> Loads:
    """Loads at n samples from first_s (s after the campaign's start; may be negative) at `rate` Hz.

    leg_xy (n_leg, 2): where the legs cross the surface.
    """
    time = first_s + np.arange(n) / rate
    wind, wave = random_loads(plan, leg_xy, seed, first_s, n, rate)
    grid, slot_time = plan.grid_s, SLOT_S * (np.arange(plan.n_slot) + 0.5)
    running = np.interp(time, grid, plan.running)
    mean = np.interp(time, slot_time, plan.wind_mps)
    rna = wind * (running[:, None] * GAIN_OPERATING + ((1 - running) * mean)[:, None] * GAIN_IDLING)
    rna[:, 0] += running * mean_thrust(mean)
    rna += harmonic_loads(plan, time, running)
    for event in plan.events:
        end = event.start_s + event.duration_s
        if end + 60 < time[0] or event.start_s - 60 > time[-1]:
            continue
        if event.kind == "yaw":
            push = 4.0e5 * np.sign(event.size_deg)
            inside = (time > event.start_s) & (time < end)
            # the drive takes up its play at the start, brakes at the end, and chatters at 2.7 Hz in between
            rna[:, 3] += push * (_pulse(time, event.start_s, 3.0) - _pulse(time, end, 3.0))
            rna[:, 3] += inside * 1.0e5 * np.sin(2 * np.pi * 2.7 * (time - event.start_s))
        else:
            size = 400.0 * event.size_deg * np.interp(event.start_s, slot_time, plan.wind_mps)
            rna[:, 0] += size * (_pulse(time, event.start_s, 6.0) - _pulse(time, end, 6.0))
    level = BACKGROUND * np.sqrt(np.interp(time, slot_time, plan.wave_height_m)) * (1 + 1.5 * running)
    background = level[:, None] * np.sqrt(rate / 2) * white(seed, 2, first_s, n, n_mode, rate)
    return Loads(rna=rna, wave=wave, background=background)


def harmonic_loads(plan: Plan, time: np.ndarray, running: np.ndarray) -> np.ndarray:
    """Forces (n, 4) at 1P, 3P and 6P of the rotor's angle, growing with the square of its speed."""
    step = np.clip((time // GRID_S).astype(int), 0, len(plan.grid_s) - 2)
    rpm = np.interp(time, plan.grid_s, plan.rotor_rpm)
    since = np.clip(time, plan.grid_s[0], plan.grid_s[-1]) - plan.grid_s[step]
    turns = plan.rotor_turns[step] + 0.5 * (plan.rotor_rpm[step] + rpm) * since / 60
    strength = running * (rpm / 14.8) ** 2
    total = np.zeros((len(time), 4))
    for order, amplitude in HARMONICS:
        angle = 2 * np.pi * order * turns
        # the side force runs a quarter turn behind: the load rotates
        phases = np.column_stack([np.cos(angle), np.sin(angle), np.cos(angle + 0.7), np.sin(angle + 0.7)])
        total += strength[:, None] * phases * np.array(amplitude)
    return total


def white(seed: int, kind: int, first_s: float, n: int, width: int, rate: float) -> np.ndarray:
    """Unit white noise (n, width), float32, made slot by slot so that any span of time can be made alone."""
    per_slot = round(SLOT_S * rate)
    start = round(first_s * rate)
    out = np.empty((n, width), np.float32)
    for number in range(start // per_slot, (start + n - 1) // per_slot + 1):
        begin = number * per_slot - start
        piece = piece_rng(seed, kind, number).standard_normal((per_slot, width), dtype=np.float32)
        low, high = max(begin, 0), min(begin + per_slot, n)
        out[low:high] = piece[low - begin : high - begin]
    return out
