"""Clocks compared: how late each channel is, from the slope of phase over frequency.

Channels of one direction move, at frequencies where they are coherent, in phase or in antiphase. A clock that is late
by tau turns that phase by -2 pi f tau. Twice the phase knows nothing of the sign; its slope gives the delay of each
pair, and the pairs together that of each channel. A clock that drifts by a good part of a period within a block leaves
no coherence: its drift is the slope of what the phase gains from segment to segment, which neither signs nor a delay
change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft, ndimage, sparse
from scipy.sparse import csgraph

from probupdate.campaign.gaps import zero_filled
from probupdate.campaign.mounting import ALONG
from probupdate.campaign.sensor_findings import SIGMA
from probupdate.campaign.spectra import CrossSpectra, segment_lines, segment_samples
from probupdate.modal.modes import Sensor
from probupdate.runtime.arrays import frozen_array

# delays are sought up to this; within a segment of 40 s such a delay still leaves coherence
LARGEST_DELAY_S = 2.0
# frequencies that are less coherent say little about phase; at more than the other, damping and crosstalk limit
LEAST_COHERENCE, MOST_COHERENCE = 0.3, 0.99
# phase at zero frequency, and scatter about a delay's line (rad), from which they are no clock's, if beyond chance
BENT = 0.15
# periods by which a drift turns a pair within a block that it leaves without coherence
TURNED = 0.25
# what the phases of real structures (damping that is not proportional, rotating loads) may feign, in s: channels of one
# level, of two
MOTION_STD_S = {True: 0.0005, False: 0.003}


@dataclass(frozen=True, eq=False, kw_only=True)
class Delays:
    """delay_s (n_channel,) how late each channel is against the median of those it can be compared with, NaN where
    none; std_s (n_channel,) what coherence, similarity of motion and the pairs' scatter leave open, infinite where a
    channel moves with compared ones, more than there are such as itself, and its phase against them is no clock's;
    group (n_channel,) number of the set of channels that are compared with one another, -1 for none."""

    delay_s: np.ndarray
    std_s: np.ndarray
    group: np.ndarray


def delays(spectra: CrossSpectra, sensors: tuple[Sensor, ...], avoid_hz: np.ndarray | None = None) -> Delays:
    """Delay of every channel. avoid_hz (n_band, 2): frequencies of the rotor, whose loads rotate and bend phases."""
    n, frequency = len(sensors), spectra.frequency_hz
    kept = np.ones(len(frequency), bool)
    for low, high in () if avoid_hz is None else avoid_hz:
        kept &= (frequency < low) | (frequency > high)
    pairs = [(i, j) for i in range(n) for j in range(i) if are_comparable(sensors[i], sensors[j])]
    matrix, value, weight, bent = [], [], [], []
    for i, j in pairs:
        found = _pair_delay(spectra, i, j, kept)
        if found is None:
            continue
        if np.isinf(found[1]):
            bent += [(i, j), (j, i)]
            continue
        row = np.zeros(n)
        row[i], row[j] = 1.0, -1.0
        matrix.append(row)
        value.append(found[0])
        weight.append(1 / (found[1] ** 2 + MOTION_STD_S[sensors[i].level == sensors[j].level] ** 2))
    delay, std, group = np.full(n, np.nan), np.full(n, np.nan), np.full(n, -1)
    if not matrix:
        return Delays(delay_s=frozen_array(delay), std_s=frozen_array(std), group=frozen_array(group, int))
    rows, values, weights = np.array(matrix), np.array(value), np.array(weight)
    for number, members in enumerate(_connected_groups(rows)):
        mine = np.any(rows[:, members] != 0, axis=1)
        normal = (rows[mine].T * weights[mine]) @ rows[mine]
        inverse = np.linalg.pinv(normal[np.ix_(members, members)], hermitian=True)
        answer = inverse @ ((rows[mine][:, members].T * weights[mine]) @ values[mine])
        delay[members] = answer - np.median(answer)
        # pairs of one channel share its motion: what they disagree by is not averaged away
        own, apart = np.abs(rows[mine][:, members]).T * weights[mine], values[mine] - rows[mine][:, members] @ answer
        std[members] = np.sqrt(np.diag(inverse) + own @ apart**2 / own.sum(axis=1))
        group[members] = number
    # whose phase is no clock's show the channels that agree: two of four are as likely sound, and move by close modes
    beside = {i: {int(group[j]) for k, j in bent if k == i and group[j] >= 0} for i, _ in bent if group[i] < 0}
    for i, groups in beside.items():
        if np.isin(group, list(groups)).sum() > sum(bool(groups & others) for others in beside.values()):
            std[i] = np.inf
    return Delays(delay_s=frozen_array(delay), std_s=frozen_array(std), group=frozen_array(group, int))


def drifts(
    data: np.ndarray, rate_hz: float, highest_hz: float, sensors: Sequence[Sensor], wanted: np.ndarray
) -> np.ndarray:
    """(n_channel,) how much later the `wanted` channels of a block (n_sample, n_channel) become against the others, in
    s per s, by segments as of `cross_spectra`; NaN where no pair shows it, or segments are lost."""
    found = np.full(len(sensors), np.nan)
    length = segment_samples(len(data), rate_hz, highest_hz)
    frequency = fft.rfftfreq(length, 1 / rate_hz)
    kept = np.flatnonzero((frequency > 0) & (frequency <= highest_hz))
    lines = np.array(segment_lines(data, length, kept))
    if len(lines) < len(range(0, len(data) - length + 1, length // 2)):
        return found
    unit = np.exp(1j * np.angle(lines))
    for i in np.flatnonzero(wanted):
        partners = [j for j in np.flatnonzero(~wanted) if are_comparable(sensors[i], sensors[j])]
        each = [_pair_drift(unit[:, :, i] * unit[:, :, j].conj(), frequency[kept], length / 2 / rate_hz)
                for j in partners]
        each = [r for r in each if r is not None]
        if 2 * len(each) > len(partners):
            found[i] = float(np.median(each))
    return found


def _pair_drift(cross: np.ndarray, frequency: np.ndarray, step_s: float) -> float | None:
    """Drift of a pair from the phases of its cross-spectra (n_segment, n_line), a step apart: over one step, then over
    twice as many as long as it gathers them (Lank, Reed and Pollon 1973). None where it does not."""
    drift, lag = None, 1
    while lag < len(cross):
        gain = np.sum(cross[lag:] * cross[:-lag].conj(), axis=0)
        last = drift or 0.0
        for _ in range(4):
            left = gain * np.exp(2j * np.pi * frequency * last * lag * step_s)
            # lines of one motion go together; those of noise are as many to either side
            weight = frequency * np.abs(gain) ** 2
            last -= float(weight @ np.angle(left) / (2 * np.pi * lag * step_s * (weight @ frequency)))
        left = gain * np.exp(2j * np.pi * frequency * last * lag * step_s)
        # twice what counts: no pair has a drift by chance
        if np.sum(left.real) < 2 * SIGMA * np.sqrt(0.5 * len(frequency) * (len(cross) - lag)):
            break
        drift, lag, centre = last, 2 * lag, float(weight @ frequency / weight.sum())
    # less leaves coherence: something else takes it away
    return drift if drift is not None and abs(drift) * len(cross) * step_s * centre > TURNED else None


def far_delays(data: np.ndarray, rate_hz: float, sensors: Sequence[Sensor], wanted: np.ndarray) -> np.ndarray:
    """(n_channel,) s by which `wanted` channels of a block (n_sample, n_channel) are late by up to half of it, by where
    most of their partners' phase correlation (Knapp and Carter 1976) stands out; NaN where it does not."""
    found, n = np.full(len(sensors), np.nan), len(data)
    lines = fft.rfft(zero_filled(data), 2 * n, axis=0)
    unit = lines / np.maximum(np.abs(lines), 1e-300)
    lag = np.append(np.arange(n // 2), np.arange(-n // 2, 0))
    for i in np.flatnonzero(wanted):
        partners = [j for j in np.flatnonzero(~wanted) if are_comparable(sensors[i], sensors[j])]
        each = []
        for j in partners:
            size = np.abs(fft.irfft(unit[:, i] * unit[:, j].conj(), 2 * n))[lag]
            # twice what counts, as for a drift
            if size.max() > 2 * SIGMA * np.sqrt(np.mean(size**2)):
                each.append(lag[int(np.argmax(size))] / rate_hz)
        middle = float(np.median(each)) if each else np.nan
        agree = np.abs(np.array(each) - middle) < LARGEST_DELAY_S
        # what is nearer, and has no delay, has a phase of its own
        if 2 * agree.sum() > len(partners) and abs(middle) > LARGEST_DELAY_S:
            found[i] = middle
    return found


def apart(late: Delays, sensors: Sequence[Sensor]) -> np.ndarray:
    """(n_channel,) bool: channels that could be compared with some of a larger group, and move with none of it: the
    only one of its logger, or several that move with one another."""
    # groups are numbered by size
    rank = np.where(late.group < 0, len(sensors), late.group)
    return np.array([any(other < own and are_comparable(a, b) for b, other in zip(sensors, rank, strict=True))
                     for a, own in zip(sensors, rank, strict=True)], bool)


def put_in_time(data: np.ndarray, rate_hz: float, delay_s: np.ndarray, drift: np.ndarray) -> np.ndarray:
    """Data (n_sample, n_channel) with the channels of which a delay in the middle of the block, or a drift, is not zero
    as a right clock would have recorded them; lost where they recorded nothing."""
    moved, sample = data.copy(), np.arange(len(data))
    for c in np.flatnonzero((delay_s != 0) | (drift != 0)):
        at = [sample + rate_hz * delay_s[c] + drift[c] * (sample - len(data) / 2)]
        known = np.isfinite(data[:, c])
        value = np.where(known, data[:, c] - data[known, c].mean(), 0.0)
        lost = ndimage.map_coordinates(1.0 - known, at, order=1, cval=1.0) > 0
        # splines of degree five are flat to four fifths of the highest frequency
        moved[:, c] = np.where(lost, np.nan, ndimage.map_coordinates(value, at, order=5))
    return moved


def are_comparable(a: Sensor, b: Sensor) -> bool:
    return abs(float(a.direction @ b.direction)) > ALONG


def _pair_delay(spectra: CrossSpectra, i: int, j: int, kept: np.ndarray) -> tuple[float, float] | None:
    """(delay of i after j, its standard deviation) in s, infinite where no clock makes their phases; None where the two
    are not coherent over a range of frequencies."""
    g, frequency = spectra.density, spectra.frequency_hz
    cross, coherence = g[:, j, i], spectra.coherence([i, j])[:, 0, 1]
    # chance is coherent too: with n segments by 1 / n
    least = max(LEAST_COHERENCE, 4 / spectra.n_segment)
    used = kept & (coherence > least)
    if used.sum() < 5:
        return None
    capped = np.minimum(coherence[used], MOST_COHERENCE)
    weight = np.zeros(len(frequency))
    weight[used] = capped / (1 - capped)
    # no peak of one mode decides alone
    weight = np.minimum(weight, 10 * np.median(weight[used]))
    double = np.zeros(len(frequency), complex)
    double[used] = weight[used] * np.exp(2j * np.angle(cross[used]))
    delay = _best_delay(double, frequency)
    phase = np.zeros(int(used.sum()))
    for _ in range(3):
        phase = np.angle(double[used] * np.exp(4j * np.pi * frequency[used] * delay)) / 2
        delay -= float(weight[used] @ (frequency[used] * phase) / (2 * np.pi * (weight[used] @ frequency[used] ** 2)))
    mine, f = weight[used], frequency[used]
    # a line through the phases; a clock's has no phase at zero frequency, a filter's or a loose mount's lead has one
    lines = np.column_stack([np.ones(len(f)), -2 * np.pi * f])
    inverse = np.linalg.pinv((lines.T * mine) @ lines)
    at_zero, slope = inverse @ (lines.T @ (mine * phase))
    left = float(mine @ (phase - lines @ (at_zero, slope)) ** 2) / max(len(f) / 2, 1)
    # of phases by chance this much is to be expected, by the coherence
    chance = len(f) / (2 * spectra.n_segment * mine.sum())
    if abs(at_zero) > max(BENT, SIGMA * np.sqrt(left * inverse[0, 0])) or (
            mine @ phase**2 / mine.sum() > BENT**2 + SIGMA * chance):
        return delay, np.inf
    lever = float(mine @ f**2)
    return delay, np.sqrt(float(mine @ phase**2) / (max(len(f) / 2, 1) * lever)) / (2 * np.pi)


def _best_delay(double: np.ndarray, frequency: np.ndarray) -> float:
    """Delay that gathers the doubled phases best; frequencies are multiples of their step.

    The smallest delay within a tenth of the best is taken: a narrow band repeats itself every half period.
    """
    step = frequency[1] - frequency[0]
    first = round(frequency[0] / step)
    size = 2 ** int(np.ceil(np.log2(8 * (len(double) + first))))
    line = np.zeros(size, complex)
    line[first: first + len(double)] = double
    score = (fft.ifft(line) * size).real
    time = np.where(np.arange(size) < size // 2, np.arange(size), np.arange(size) - size) / (2 * step * size)
    near = np.abs(time) <= LARGEST_DELAY_S
    order = np.argsort(time[near])
    score, time = score[near][order], time[near][order]
    # in a band of few low lines no delay may gather them
    good = np.flatnonzero(score >= score.max() - 0.1 * abs(score.max()))
    k = int(good[np.argmin(np.abs(time[good]))])
    # climb to the top of that hill
    while 0 < k < len(score) - 1 and max(score[k - 1], score[k + 1]) > score[k]:
        k += 1 if score[k + 1] > score[k - 1] else -1
    return float(time[k])


def _connected_groups(rows: np.ndarray) -> list[np.ndarray]:
    """Channels joined by pairs, as index arrays, largest set first."""
    number, label = csgraph.connected_components(sparse.csr_array(np.abs(rows).T @ np.abs(rows)), directed=False)
    sets = [np.flatnonzero(label == k) for k in range(number)]
    return sorted((members for members in sets if len(members) > 1), key=len, reverse=True)
