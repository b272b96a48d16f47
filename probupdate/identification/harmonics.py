"""The rotor's harmonics taken out of a record, where the rotor's angle can be followed in the record itself.

SCADA gives ten-minute statistics, far from an angle. The line at one multiple (3P of three blades) gives speed and
angle; the angle is believed only if it predicts another multiple (6P), which had no part in finding it. What then
goes with the angle is fitted and taken out; what is random at the same frequency stays, so that a mode beside a line
survives where a notch filter would take both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probupdate.errors import InputError
from probupdate.identification.settings import CONSTANTS
from probupdate.runtime.arrays import frozen_array

FRAME_S, HOP_S, SPEED_STEP = CONSTANTS.frame_s, CONSTANTS.hop_s, CONSTANTS.speed_step
SMOOTH_S = CONSTANTS.smooth_s
LEAST_GAIN = CONSTANTS.least_gain
DECOYS_HZ = CONSTANTS.decoys_hz
LEAST_RPM = CONSTANTS.least_rpm


@dataclass(frozen=True, eq=False, kw_only=True)
class HarmonicRemoval:
    """record (n_sample, n_channel): without the harmonics, or as it was where `followed` is False, with the reason.

    speed_rpm (n_sample,): the rotor's speed as followed, NaN if not. removed: multiple -> root mean square over
    channels of what was taken out, in the record's unit; gain: multiple -> power explained by the angle over that
    explained by decoys.
    """

    record: np.ndarray
    followed: bool
    reason: str
    speed_rpm: np.ndarray
    removed: dict[int, float]
    gain: dict[int, float]


def without_harmonics(
    record: np.ndarray,
    rate_hz: float,
    speed_range_rpm: tuple[float, float],
    *,
    line: int = 3,
    multiples: tuple[int, ...] = (1, 3, 6, 9),
    tolerance: float = 0.02,
) -> HarmonicRemoval:
    """Take multiples of the rotor speed out of a record (n_sample, n_channel) that has no NaN.

    speed_range_rpm: lowest and highest speed in the block by SCADA, widened by `tolerance`. line: the multiple that is
    followed, the number of blades; multiples above 0.9 of the Nyquist frequency are left out. A multiple is taken out
    only if the angle explains at least five times what decoys do, and any only if one other than `line` does.
    """
    record = np.asarray(record, float)
    if record.ndim != 2 or not np.all(np.isfinite(record)):
        raise InputError("record", "is not a table or holds NaN", "fill short gaps first")
    low, high = speed_range_rpm

    def leave_record(reason: str) -> HarmonicRemoval:
        return HarmonicRemoval(record=frozen_array(record), followed=False, reason=reason, removed={}, gain={},
                               speed_rpm=frozen_array(np.full(len(record), np.nan)))

    if not (np.isfinite([low, high]).all() and low <= high):
        return leave_record("no rotor speed")
    if low < LEAST_RPM:
        return leave_record(f"the rotor stood or idled: {low:.1f} rpm")
    if len(record) < 10 * FRAME_S * rate_hz:
        return leave_record(f"the record is shorter than {10 * FRAME_S:g} s")
    low, high = low * (1 - tolerance) / 60, high * (1 + tolerance) / 60
    reach = 0.45 * rate_hz
    used = tuple(n for n in multiples if n * high < reach)
    others = tuple(n for n in used if n not in (line, 1))
    if line not in used or not others:
        return leave_record(f"{line}P and another multiple do not both lie below {reach:.2f} Hz")
    coarse = _coarse_speed(record, rate_hz, low, high, (line, *others))
    # of the smoothings the one by which the others go best
    angles = [_angle(record, rate_hz, coarse, line, smooth_s) for smooth_s in SMOOTH_S]
    angle = max(angles, key=lambda a: sum(_explained_power(record, a, _rotor_speed(a, rate_hz), n) for n in others))
    speed = _rotor_speed(angle, rate_hz)
    gain = {n: _gain(record, rate_hz, angle, speed, n) for n in used}
    if not any(gain[n] >= LEAST_GAIN for n in others):
        best = max(others, key=lambda n: gain[n])
        return leave_record(f"the angle estimated from {line}P does not predict {best}P (gain {gain[best]:.1f})")
    taken = tuple(n for n in used if gain[n] >= LEAST_GAIN)
    columns = [_columns(angle, speed, n) for n in taken]
    coefficient, *_ = np.linalg.lstsq(np.hstack(columns), record, rcond=None)
    removed, first, rest = {}, 0, record.copy()
    for n, own in zip(taken, columns, strict=True):
        part = own @ coefficient[first: first + own.shape[1]]
        first += own.shape[1]
        rest -= part
        removed[n] = float(np.sqrt(np.mean(part**2)))
    return HarmonicRemoval(record=frozen_array(rest), followed=True, reason="", speed_rpm=frozen_array(60 * speed),
                           removed=removed, gain=gain)


def _coarse_speed(record, rate_hz, low, high, multiples) -> np.ndarray:
    """(n_sample,) rotor frequency in Hz: the smooth path along which the multiples stand out most from the spectrum
    beside them, over frames."""
    from scipy import signal

    size, hop = round(FRAME_S * rate_hz), round(HOP_S * rate_hz)
    scaled = record / np.maximum(record.std(axis=0), 1e-300)
    frequency, time, spectrum = signal.spectrogram(
        scaled.T, rate_hz, window="hann", nperseg=size, noverlap=size - hop, nfft=4 * size)
    level = np.log(np.maximum(spectrum.sum(axis=0), 1e-300))  # (n_line, n_frame)
    # a line stands out from what lies 0.05 to 0.15 Hz beside it
    step = frequency[1]
    beside = [np.roll(level, k, axis=0) for shift in (0.06, 0.08, 0.10) for k in
              (round(shift / step), -round(shift / step))]
    above = level - np.median(beside, axis=0)
    grid = np.arange(low, high + 0.001, 0.001)
    along = (np.array([np.interp(n * grid, frequency, column) for column in above.T]) for n in multiples)
    reward = np.asarray(sum(along))
    cost = 0.5 * ((grid[:, None] - grid) / (SPEED_STEP * np.mean(grid))) ** 2
    total, came = reward[0], []
    for row in reward[1:]:
        value = total[None, :] - cost
        came.append(np.argmax(value, axis=1))
        total = row + value.max(axis=1)
    path = [int(np.argmax(total))]
    for back in reversed(came):
        path.append(int(back[path[-1]]))
    return np.interp(np.arange(len(record)) / rate_hz, time, grid[path[::-1]])


def _rotor_speed(angle, rate_hz) -> np.ndarray:
    """(n_sample,) rotor frequency in Hz."""
    return np.gradient(angle) * rate_hz / (2 * np.pi)


def _angle(record, rate_hz, coarse, line, smooth_s) -> np.ndarray:
    """(n_sample,) the rotor's angle in rad: the coarse speed integrated, then twice corrected by the phase that the
    demodulated line shows in the combination of channels that has most of it."""
    from scipy import signal

    angle = 2 * np.pi * np.cumsum(coarse) / rate_hz
    window = np.hanning(2 * round(smooth_s * rate_hz / 2) + 3)[1:-1]
    window /= window.sum()
    for _ in range(2):
        down = record * np.exp(-1j * line * angle)[:, None]
        slow = signal.fftconvolve(down, window[:, None], mode="same", axes=0)
        _, vector = np.linalg.eigh(slow.conj().T @ slow)
        # slow = amplitude(t) times a fixed shape: its projection on the leading shape has the line's phase
        phase = np.unwrap(np.angle(slow @ vector[:, -1]))
        angle = angle + phase / line
    return angle


def _columns(angle, speed, n) -> np.ndarray:
    """cos and sin of n times the angle, with amplitudes that follow the speed to second order (the structure answers
    each frequency differently) and the time likewise (wind changes the load)."""
    time = np.linspace(-1, 1, len(angle))
    change = (speed - np.mean(speed)) / max(np.std(speed), 1e-300)
    change = np.clip(change, -4, 4)
    slow = np.column_stack([np.ones(len(angle)), change, change**2, time, time**2])
    return np.hstack([np.cos(n * angle)[:, None] * slow, np.sin(n * angle)[:, None] * slow])


def _explained_power(record, angle, speed, n) -> float:
    """Power of the record, channels scaled alike, that goes with the angle's n-th multiple."""
    q, _ = np.linalg.qr(_columns(angle, speed, n))
    return float(np.sum((q.T @ record) ** 2 / np.maximum(record.var(axis=0), 1e-300)))


def _gain(record, rate_hz, angle, speed, n) -> float:
    """That power over the mean of what decoys beside the angle explain."""
    time = np.arange(len(angle)) / rate_hz
    decoys = [_explained_power(record, angle + 2 * np.pi * shift * time / n, speed, n) for shift in DECOYS_HZ]
    return _explained_power(record, angle, speed, n) / max(float(np.mean(decoys)), 1e-300)
