"""Clocks compared: how late each channel is, from the slope of phase over frequency.

Channels of one direction move, at frequencies where they are coherent, in phase or in antiphase. A clock that is late
by tau turns that phase by -2 pi f tau. Twice the phase knows nothing of the sign; its slope gives the delay of each
pair, and the pairs together that of each channel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft, sparse
from scipy.sparse import csgraph

from probupdate.campaign.spectra import CrossSpectra
from probupdate.modal.modes import Sensor
from probupdate.runtime.arrays import frozen_array

# delays are sought up to this; within a segment of 40 s such a delay still leaves coherence
LARGEST_DELAY_S = 2.0
# frequencies that are less coherent say little about phase; at more than the other, damping and crosstalk limit
LEAST_COHERENCE, MOST_COHERENCE = 0.3, 0.99
# a pair's phases gather around a line at least so well (1: on it)
GATHERED = 0.7
# what the phases of real structures (damping that is not proportional, rotating loads) may feign, in s: channels of one
# level, of two
MOTION_STD_S = {True: 0.0005, False: 0.003}


@dataclass(frozen=True, eq=False, kw_only=True)
class Delays:
    """delay_s (n_channel,) how late each channel is against the median of those it can be compared with, NaN where
    none; std_s (n_channel,) what coherence and similarity of motion leave open; group (n_channel,) number of the set of
    channels that are compared with one another, -1 for none."""

    delay_s: np.ndarray
    std_s: np.ndarray
    group: np.ndarray


def delays(spectra: CrossSpectra, sensors: tuple[Sensor, ...], avoid_hz: np.ndarray | None = None) -> Delays:
    """Delay of every channel. avoid_hz (n_band, 2): frequencies of the rotor, whose loads rotate and bend phases."""
    n, frequency = len(sensors), spectra.frequency_hz
    kept = np.ones(len(frequency), bool)
    for low, high in () if avoid_hz is None else avoid_hz:
        kept &= (frequency < low) | (frequency > high)
    pairs = [(i, j) for i in range(n) for j in range(i) if _comparable(sensors[i], sensors[j])]
    matrix, value, weight = [], [], []
    for i, j in pairs:
        found = _pair_delay(spectra, i, j, kept)
        if found is None:
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
    for number, members in enumerate(_connected(rows)):
        mine = np.any(rows[:, members] != 0, axis=1)
        normal = (rows[mine].T * weights[mine]) @ rows[mine]
        inverse = np.linalg.pinv(normal[np.ix_(members, members)], hermitian=True)
        answer = inverse @ ((rows[mine][:, members].T * weights[mine]) @ values[mine])
        delay[members] = answer - np.median(answer)
        std[members] = np.sqrt(np.diag(inverse))
        group[members] = number
    return Delays(delay_s=frozen_array(delay), std_s=frozen_array(std), group=frozen_array(group, int))


def _comparable(a: Sensor, b: Sensor) -> bool:
    return abs(float(a.direction @ b.direction)) > 0.9


def _pair_delay(spectra: CrossSpectra, i: int, j: int, kept: np.ndarray) -> tuple[float, float] | None:
    """(delay of i after j, its standard deviation) in s; None where the two are not coherent over a range of
    frequencies."""
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
    delay, gathered = _steepest(double, frequency)
    if gathered < GATHERED * weight.sum():
        return None
    phase = np.zeros(int(used.sum()))
    for _ in range(3):
        phase = np.angle(double[used] * np.exp(4j * np.pi * frequency[used] * delay)) / 2
        delay -= float(weight[used] @ (frequency[used] * phase) / (2 * np.pi * (weight[used] @ frequency[used] ** 2)))
    spread = float(weight[used] @ phase**2 / weight.sum())
    lever = float(weight[used] @ frequency[used] ** 2 / weight.sum())
    return delay, np.sqrt(spread / (max(used.sum() / 2, 1) * lever)) / (2 * np.pi)


def _steepest(double: np.ndarray, frequency: np.ndarray) -> tuple[float, float]:
    """Delay that gathers the doubled phases best, and the gathered weight; frequencies are multiples of their step.

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
    good = np.flatnonzero(score > 0.9 * score.max())
    k = int(good[np.argmin(np.abs(time[good]))])
    # climb to the top of that hill
    while 0 < k < len(score) - 1 and max(score[k - 1], score[k + 1]) > score[k]:
        k += 1 if score[k + 1] > score[k - 1] else -1
    return float(time[k]), float(score[k])


def _connected(rows: np.ndarray) -> list[np.ndarray]:
    """Channels joined by pairs, as index arrays, largest set first."""
    number, label = csgraph.connected_components(sparse.csr_array(np.abs(rows).T @ np.abs(rows)), directed=False)
    sets = [np.flatnonzero(label == k) for k in range(number)]
    return sorted((members for members in sets if len(members) > 1), key=len, reverse=True)
