"""Vibration from loads: each mode's equation of motion solved exactly for forces that are linear between samples."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from probupdate.virtual.dynamics import HeadingModes
from probupdate.virtual.excitation import Loads


def modal_response(
    frequency_hz: np.ndarray,
    damping_ratio: np.ndarray,
    force: np.ndarray,
    rate: float,
    displacement: np.ndarray,
    velocity: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Modal motion under force (n + 1, n_mode) from the given state (n_mode,) at its first sample.

    Returns acceleration (n, n_mode) at the first n samples, displacement (n + 1, n_mode) and velocity (n_mode,) at
    sample n + 1.
    With z = v - conj(lambda) q, lambda = omega (-zeta + i sqrt(1 - zeta^2)):  z' = lambda z + f, one complex
    recursion a mode; q = Im z / omega_d, v = Re z + Re(lambda) q.
    """
    from scipy.signal import lfilter

    step = 1 / rate
    omega = 2 * np.pi * frequency_hz
    root = omega * (-damping_ratio + 1j * np.sqrt(1 - damping_ratio**2))
    growth = np.exp(root * step)
    # integral of e^{lambda (h - s)} times 1 - s/h and s/h
    whole = (growth - 1) / root
    second = (growth - 1 - root * step) / (root**2 * step)
    first = whole - second
    drive = force[:-1] * first + force[1:] * second
    state = np.empty((len(drive) + 1, len(omega)), complex)
    state[0] = velocity - root.conj() * displacement
    for mode, factor in enumerate(growth):
        state[1:, mode] = lfilter([1.0], [1.0, -factor], drive[:, mode], zi=[factor * state[0, mode]])[0]
    q = np.imag(state) / root.imag
    v = np.real(state) + root.real * q
    acceleration = force[:-1] - 2 * damping_ratio * omega * v[:-1] - omega**2 * q[:-1]
    return acceleration, q, v[-1]


def spans(
    heading_deg: np.ndarray, state: np.ndarray, condition: np.ndarray
) -> Iterator[tuple[int, int, float, str, int]]:
    """Cut per-sample heading, rotor state and number of the effects' condition (n,) into (first, last + 1, heading,
    state, condition) of constant properties."""
    change = np.flatnonzero((np.diff(heading_deg) != 0) | (state[1:] != state[:-1]) | (np.diff(condition) != 0)) + 1
    for low, high in zip([0, *change], [*change, len(state)], strict=True):
        yield int(low), int(high), float(heading_deg[low]), str(state[low]), int(condition[low])


def channel_response(
    loads: Loads, heading_deg: np.ndarray, state: np.ndarray, modes, rate: float, condition: np.ndarray
) -> np.ndarray:
    """What accelerometers read (n, n_channel) as mounted, without noise; starts from rest.

    `modes(heading, condition)` -> HeadingModes. Where one of them changes, displacement and velocity go on, expressed
    in the new modes; what lies outside their space is lost. At the sensors of the reference turbine a turn of 30 deg
    costs the first pair 2e-4 of its motion, torsion 1e-3, the second pair 2 %, higher modes up to 8 %: a small
    transient within the yaw event's own.
    """
    n = len(state)
    pieces: list[np.ndarray] = []
    before: HeadingModes | None = None
    q = v = np.zeros(0)
    for low, high, heading, rotor, number in spans(heading_deg, state, condition):
        now = modes(heading, number)
        if before is None:
            q = v = np.zeros(len(now.frequency_hz))
        elif before is not now:
            change = now.momentum.T @ before.shape
            q, v = change @ q, change @ v
        rows = slice(low, min(high + 1, n))
        force = loads.rna[rows] @ now.rna_load + loads.wave[rows] @ now.wave_load + loads.background[rows]
        if high == n:
            force = np.vstack([force, force[-1]])
        acceleration, moved, v = modal_response(now.frequency_hz, now.damping_ratio[rotor], force, rate, q, v)
        pieces.append(acceleration @ now.observed_motion.T + moved[:-1] @ now.observed_tilt.T)
        q = moved[-1]
        before = now
    return np.concatenate(pieces)
