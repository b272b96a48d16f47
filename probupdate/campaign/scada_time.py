"""SCADA's clock against the records: with the right times the structure moves most when wind and power are high, and
the rotor's lines are there while it turns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import fft

from probupdate.campaign.blocks import Block
from probupdate.campaign.rotor_lines import HARMONICS, SLOWEST_RPM, STEADIEST, line_height
from probupdate.campaign.scada import ROW_MINUTES
from probupdate.campaign.sensor_findings import SIGMA

# rows of this length; of a shorter block one row
ROW_S, SHORTEST_S = 60.0 * ROW_MINUTES, 60.0
# lines are sought below, and a spectrum has lines of at least this width
HIGHEST_HZ, STEP_HZ = 2.5, 1 / ROW_S
# shifts that are tried: a day's time zones and summer time, in rows; nearer ones are the wind's own delay
LONGEST, NEAREST = 14 * 6, 3
# ln likelihood by which a shift must be better than none, beyond what the best of so many reaches by chance
MARGIN = 12.0
FEWEST_ROWS, LEAST_OVERLAP = 24, 0.5
# rows from which the motion's size counts, ln likelihood by which the best must be more than chance, rpm of one line
LONG_ROWS, CLEAR, SPEED_STEP = 432, 4.0, 0.1
DRIVERS = ("wind_speed_mps", "power_kw", "rotor_speed_rpm")


@dataclass(frozen=True, eq=False, kw_only=True)
class RecordRow:
    """Ten minutes of a record: when they began, ln of the motion's size and of its spectrum (n_line,), on lines of
    STEP_HZ from 0, each channel with one vote."""

    start: pd.Timestamp
    size: float
    level: np.ndarray


def record_rows(block: Block) -> list[RecordRow]:
    """Of a block, without channels that have lost samples."""
    rate, found = block.sampling_rate_hz, []
    n = min(round(ROW_S * rate), len(block.data))
    if n < SHORTEST_S * rate:
        return found
    for first in range(0, len(block.data) - n + 1, n):
        piece = block.data[first : first + n]
        piece = piece[:, np.isfinite(piece).all(axis=0)]
        piece = piece - piece.mean(axis=0)
        size = piece.std(axis=0)
        piece, size = piece[:, size > 0], size[size > 0]
        if not len(size):
            continue
        power = np.abs(fft.rfft(piece / size * np.hanning(n)[:, None], axis=0)) ** 2
        level = np.log(power + 1e-12 * power.max(axis=0)).mean(axis=1)
        at = np.arange(0, min(HIGHEST_HZ, 0.4 * rate), STEP_HZ)
        level = np.interp(at, fft.rfftfreq(n, 1 / rate), level)
        found.append(RecordRow(start=block.start + pd.Timedelta(seconds=first / rate),
                               size=float(np.mean(np.log(size))), level=level))
    return found


def time_findings(rows: Sequence[RecordRow], scada: pd.DataFrame | None) -> list[str]:
    """A sentence where SCADA fits the records at another time than its own."""
    if scada is None or len(rows) < FEWEST_ROWS or len(scada) < FEWEST_ROWS:
        return []
    beside = _AlignedRecord(rows, scada)
    if found := beside.followed_speed():
        return [found]
    shifts = np.arange(-LONGEST, LONGEST + 1)
    gain = np.array([beside.likelihood(int(k)) for k in shifts])
    near = np.abs(shifts) < NEAREST
    if not np.isfinite(gain[near]).any():
        return []
    best = int(np.nanargmax(gain))
    if near[best] or gain[best] - np.nanmax(gain[near]) < MARGIN or not beside.is_clear(int(shifts[best])):
        return []
    minutes = int(shifts[best]) * ROW_MINUTES
    return [f"suspect: SCADA fits the records (their size beside wind and power, the rotor's lines) "
            f"{abs(minutes) / 60:.2g} h {'later' if minutes > 0 else 'earlier'} than its own times: another time zone? "
            f"If so, state [scada] shift_minutes = {minutes} in campaign.toml"]


class _AlignedRecord:
    """Records and SCADA on one grid of ten minutes; `likelihood` of SCADA moved by so many rows of it."""

    def __init__(self, rows: Sequence[RecordRow], scada: pd.DataFrame):
        first = min(rows[0].start, scada.index[0])
        step = pd.Timedelta(minutes=ROW_MINUTES)
        at = np.round((pd.DatetimeIndex([r.start for r in rows]) - first) / step).astype(int)
        theirs = np.round((scada.index - first) / step).astype(int)
        self.at, self.n = at, int(max(at.max(), theirs.max())) + 1
        self.size = np.array([r.size for r in rows])
        self.columns = {}
        for column in (c for c in DRIVERS if c in scada):
            self.columns[column] = np.full(self.n, np.nan)
            self.columns[column][theirs] = scada[column].to_numpy(float)
        self.heights: dict[float, np.ndarray] = {}
        self.level = np.array([r.level for r in rows])

    def _shifted_column(self, column: str, shift: int) -> np.ndarray:
        """(n_row,) the column at the records' rows, as it is said of so many rows earlier."""
        k = self.at - shift
        inside = (k >= 0) & (k < self.n)
        return np.where(inside, self.columns[column][np.clip(k, 0, self.n - 1)], np.nan)

    def _pairs(self, shift: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """Causes and effects: turning beside the height of the rotor's lines; of long records also wind and power
        beside the motion's size, as both wander slowly."""
        found = []
        if len(self.size) >= LONG_ROWS:
            found += [(self._shifted_column(c, shift), self.size) for c in DRIVERS[:2] if c in self.columns]
        if "rotor_speed_rpm" in self.columns:
            rotor = self._shifted_column("rotor_speed_rpm", shift)
            turns = rotor > SLOWEST_RPM
            if 0 < turns.sum() < np.isfinite(rotor).sum():
                usual = float(np.median(rotor[turns]))
                speed = np.round(np.where(turns, rotor, usual) / SPEED_STEP) * SPEED_STEP
                height = np.zeros(len(rotor))
                for v in np.unique(speed):
                    height[speed == v] = self._height(float(v))[speed == v]
                found.append((np.where(np.isfinite(rotor), turns, np.nan), height))
        return found

    def likelihood(self, shift: int) -> float:
        """ln likelihood ratio of what causes explain; NaN where too few rows have both."""
        pairs = self._pairs(shift)
        known = max((int((np.isfinite(c) & np.isfinite(e)).sum()) for c, e in pairs), default=0)
        if known < max(FEWEST_ROWS // 2, LEAST_OVERLAP * len(self.size)):
            return np.nan
        return sum(_log_likelihood_ratio(*pair) for pair in pairs) * len(self.size) / known

    def is_clear(self, shift: int) -> bool:
        """Whether what is explained there is more than two series have by chance that each follow themselves."""
        return max((_effective_log_likelihood(*pair) for pair in self._pairs(shift)), default=0.0) > CLEAR

    def followed_speed(self) -> str:
        """A sentence where the rotor's lines in the records follow the speed of a neighbouring row, or another column,
        rather than the stated speed, where these are two lines; else ''. Fixed lines, as of modes, do not count."""
        if "rotor_speed_rpm" not in self.columns:
            return ""
        level = self.level - self.level.mean(axis=0)
        stated = self._shifted_column("rotor_speed_rpm", 0)
        own, best = self._line_heights(level, stated), (SIGMA, "")
        for column, shift in [*(("rotor_speed_rpm", k) for k in range(1 - NEAREST, NEAREST) if k), (DRIVERS[0], 0)]:
            if column not in self.columns:
                continue
            speed = self._shifted_column(column, shift)
            gain = self._line_heights(level, speed) - own
            gain = gain[np.isfinite(gain) & (np.abs(speed - stated) > STEADIEST * np.abs(stated))]
            if len(gain) < FEWEST_ROWS // 2 or not (t := np.sqrt(len(gain)) * gain.mean() / gain.std()) > best[0]:
                continue
            minutes = shift * ROW_MINUTES
            best = t, (
                f"suspect: the rotor's lines in the records follow rotor_speed_rpm in SCADA {abs(minutes)} min "
                f"{'later' if minutes > 0 else 'earlier'} than its times ({len(gain)} rows): "
                f"{'are they the ends of the ten minutes' if shift == -1 else 'another clock'}? If so, state [scada] "
                f"shift_minutes = {minutes} in campaign.toml" if shift else
                f"suspect: the rotor's lines in the records follow {column} in SCADA as if it were rotor_speed_rpm "
                f"({len(gain)} rows): are the two exchanged? If so, exchange their names in scada.csv")
        return best[1]

    def _line_heights(self, level: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """(n_row,) height of level (n_row, n_line) at the multiples of each row's speed (rpm); NaN where it stands."""
        return np.array([line_height(row, rpm / 60 / STEP_HZ) if rpm > SLOWEST_RPM else np.nan
                         for row, rpm in zip(level, speed, strict=True)])

    def _height(self, rpm: float) -> np.ndarray:
        """(n_row,) mean height of the rotor's lines above what surrounds them."""
        if rpm not in self.heights:
            found = []
            for n in HARMONICS:
                k = round(n * rpm / 60 / STEP_HZ)
                if 12 < k < self.level.shape[1] - 13:
                    beside = np.median(self.level[:, np.r_[k - 12 : k - 4, k + 5 : k + 13]], axis=1)
                    found.append(self.level[:, k - 1 : k + 2].max(axis=1) - beside)
            self.heights[rpm] = np.mean(found, axis=0) if found else np.zeros(len(self.level))
        return self.heights[rpm]


def _pair_known_values(cause: np.ndarray, effect: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Both without their means, where both are known and move."""
    good = np.isfinite(cause) & np.isfinite(effect)
    x, y = cause[good] - cause[good].mean() if good.any() else cause[good], effect[good]
    if len(x) < FEWEST_ROWS // 2 or not np.ptp(x) > 0 or not np.ptp(y) > 0:
        return None
    return x, y - y.mean()


def _log_likelihood_ratio(cause: np.ndarray, effect: np.ndarray) -> float:
    """ln likelihood ratio of a line that rises, with as many residuals as are independent of the one before."""
    known = _pair_known_values(cause, effect)
    if known is None:
        return 0.0
    x, y = known
    left = y - (x @ y) / (x @ x) * x
    follow = float(np.clip(left[1:] @ left[:-1] / max(left @ left, 1e-300), 0.0, 0.95))
    return -0.5 * len(x) * (1 - follow) / (1 + follow) * _log_unexplained_share(x, y)


def _effective_log_likelihood(cause: np.ndarray, effect: np.ndarray) -> float:
    """The same with as many values as two series have that follow themselves (Bartlett)."""
    known = _pair_known_values(cause, effect)
    if known is None:
        return 0.0
    x, y = known
    follow = [float(np.clip(v[1:] @ v[:-1] / (v @ v), 0.0, 0.999)) for v in (x, y)]
    both = follow[0] * follow[1]
    return -0.5 * len(x) * (1 - both) / (1 + both) * _log_unexplained_share(x, y)


def _log_unexplained_share(x: np.ndarray, y: np.ndarray) -> float:
    """ln of the share of y that a rising line over x leaves."""
    share = max(float(x @ y / np.sqrt((x @ x) * (y @ y))), 0.0)
    return float(np.log(max(1 - share**2, 1e-6)))
