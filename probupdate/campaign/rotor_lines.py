"""The records' clock against the rotor: lines at multiples of the rotor speed give the true sampling rate.

SCADA says how fast the rotor turned in each ten minutes; once and three times a turn the tower is excited. If the lines
lie at r times where they should, the true sampling rate is the stated one divided by r.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import fft

from probupdate.campaign.blocks import Block
from probupdate.campaign.gaps import zero_filled
from probupdate.campaign.scada import SLOWEST_RPM

ROW_S = 600.0
# of a shorter block lines are sought if it is at least so long
SHORTEST_S = 60.0
HARMONICS = (1, 3, 6, 9)
# the ratio is sought from a half to twice, in steps of 0.05 %
RATIOS = np.exp(np.arange(np.log(0.45), np.log(2.2), 5e-4))
# a rotor that turns less steadily (standard deviation in ten minutes over mean) makes no line
STEADIEST = 0.06
# mean height above the neighbouring frequencies (natural logarithm of power) that lines must have, and lead over any
# other ratio
HEIGHT, LEAD = 0.7, 1.5
FEWEST_ROWS = 6
# and lines are sought in so many at most
MOST_ROWS = 720
# ten-minute means of a rotor speed that varies leave so much open, however many there are
LEAST_STD = 0.002


@dataclass(frozen=True, kw_only=True)
class RateRatio:
    """ratio: lines found at ratio times the frequency that SCADA's rotor speed gives; std its standard deviation; rows:
    how many ten minutes with a turning rotor were used. NaN where no line stood out."""

    ratio: float
    std: float
    rows: int


def line_scores(block: Block, scada: pd.DataFrame) -> list[np.ndarray]:
    """(n_ratio,) height of the spectrum along each ratio, one for every ten-minute row in which the rotor turned; of a
    shorter block one, of the row that it lies in. Channels measured for less than half of a row are left out."""
    found: list[np.ndarray] = []
    if "rotor_speed_rpm" not in scada:
        return found
    rate = block.sampling_rate_hz
    end = block.start + pd.Timedelta(minutes=block.minutes)
    short = 60 * block.minutes < ROW_S
    first_row = block.start - pd.Timedelta(seconds=ROW_S - 60 * block.minutes) if short else block.start
    last = scada.index.searchsorted(block.start, "right") if short else scada.index.searchsorted(end)
    rows = scada.iloc[scada.index.searchsorted(first_row): last]
    n = len(block.data) if short else round(ROW_S * rate)
    if n < SHORTEST_S * rate:
        return found
    for time, row in rows.iterrows():
        rpm = float(row["rotor_speed_rpm"])
        unsteady = float(row.get("rotor_speed_rpm_std", np.nan)) / rpm if rpm > 0 else np.inf
        first = 0 if short else round((time - block.start).total_seconds() * rate)
        piece = block.data[first: first + n]
        if not rpm >= SLOWEST_RPM or unsteady > STEADIEST or len(piece) < n:
            continue
        piece = zero_filled(piece[:, 2 * np.isfinite(piece).sum(axis=0) >= n])
        if not piece.shape[1]:
            continue
        found.append(_score(piece, rate, rpm / 60, 0.01 if np.isnan(unsteady) else unsteady))
    return found


def _score(piece: np.ndarray, rate: float, turning_hz: float, unsteady: float) -> np.ndarray:
    """Height of the summed spectrum at the harmonics over what surrounds them, at every ratio."""
    piece = piece - piece.mean(axis=0)
    channel_std = piece.std(axis=0)
    moving = channel_std > 0
    if not moving.any():
        return np.zeros(len(RATIOS))
    window = np.hanning(len(piece))[:, None]
    power = np.abs(fft.rfft(piece[:, moving] / channel_std[moving] * window, axis=0)) ** 2
    # each channel has one vote: the logarithm is taken before the mean
    step = rate / len(piece)
    level = np.log(power + 1e-12 * power.max(axis=0)).mean(axis=1)
    return _comb(level, turning_hz * RATIOS / step, unsteady)


def _comb(level: np.ndarray, turning: np.ndarray, unsteady: float) -> np.ndarray:
    """Mean height of a level (n_line,) at the harmonics of turning (n,), in lines, over what surrounds them."""
    return np.mean([_excess_over_neighbours(level, n * turning, np.maximum(1.5, unsteady * n * turning))
                    for n in HARMONICS], axis=0)


def line_height(level: np.ndarray, turning: float, unsteady: float = 0.01) -> float:
    """Mean level (n_line,) at the multiples of one speed, in lines, over their neighbours'; unsteady: the speed's
    standard deviation over its mean."""
    return float(_comb(level, np.array([turning]), unsteady)[0])


def _excess_over_neighbours(level: np.ndarray, centre: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Mean of level within half bins of centre, less that of the bands of twice that width on both sides."""
    summed = np.concatenate([[0.0], np.cumsum(level)])

    def mean(low, high):
        low = np.clip(np.round(low).astype(int), 1, len(level) - 2)
        high = np.clip(np.round(high).astype(int), low + 1, len(level) - 1)
        return (summed[high] - summed[low]) / (high - low)

    inside = mean(centre - half, centre + half + 1)
    beside = 0.5 * (mean(centre - 5 * half, centre - 2 * half) + mean(centre + 2 * half + 1, centre + 5 * half + 1))
    return np.where(centre + 5 * half < len(level), inside - beside, 0.0)


def rate_ratio(scores: list[np.ndarray]) -> RateRatio:
    """The ratio at which lines stand out over all rows, if one does; NaN elsewhere. scores: of each row (n_ratio,)."""
    nothing = RateRatio(ratio=float("nan"), std=float("nan"), rows=len(scores))
    if len(scores) < FEWEST_ROWS:
        return nothing
    stack = np.array(scores)
    total = stack.mean(axis=0)
    best = int(np.argmax(total))
    away = np.abs(np.log(RATIOS / RATIOS[best])) > 0.1
    if total[best] < HEIGHT or total[best] < LEAD * total[away].max():
        return nothing
    # standard deviation by leaving out groups of rows
    groups = min(len(scores), 10)
    left = [_top(np.delete(stack, slice(g, None, groups), axis=0).mean(axis=0), best) for g in range(groups)]
    value = _top(total, best)
    std = float(np.sqrt((groups - 1) / groups * np.sum((np.array(left) - np.mean(left)) ** 2)))
    return RateRatio(ratio=value, std=max(std, LEAST_STD), rows=len(scores))


def _top(total: np.ndarray, best: int) -> float:
    """Centre of the hill around the best ratio: mean of ratios weighted by what stands above half its height."""
    near = slice(max(best - 40, 0), best + 41)
    weight = np.clip(total[near] - 0.5 * total[near].max(), 0, None)
    return float(weight @ RATIOS[near] / weight.sum())
