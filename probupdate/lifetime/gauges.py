"""Strain gauges held out of an estimate of stresses: their stress beside the estimated one, block by block."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from probupdate.campaign.last_line import refuse_unfinished
from probupdate.errors import InputError, parsing
from probupdate.io.files import read_text
from probupdate.lifetime.spectral import rainflow
from probupdate.runtime.arrays import frozen_array

COLUMN = re.compile(r"hot_spot_([1-9]\d*)_mpa")
TEN_MINUTES_S = 600.0
# bytes of a table at most: a month of ten gauges at 10 Hz is 3 GB, of an hour 5 MB
LARGEST = 2**31
# share of a block that a gauge must have recorded, evenly
WHOLE = 0.98
# no steel bears it: a filler, or pascals
STRONGEST_MPA = 1e4
# standard deviations of a gauge's stress: a nanostrain is less than any resolves, and half of the yield stress is more
# than any structure stands
LEAST_MPA, MOST_MPA = 2.1e-4, 300.0


@dataclass(frozen=True, kw_only=True)
class GaugeFiles:
    """Tables of strain gauges: held_out of the estimate, to be held against it; joined with the accelerations in it."""

    held_out: str | Path | None = None
    joined: str | Path | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class GaugeCheck:
    """rows: what `gauge_comparison` says of every block and gauge. Of the first block that gauges recorded, its id,
    time_s (n,) and estimated and measured stress (n, n_gauge) at the hot spots (n_gauge,)."""

    rows: tuple[dict, ...]
    block: str
    spots: np.ndarray
    time_s: np.ndarray
    estimated: np.ndarray
    measured: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class Gauges:
    """Stress at hot spots (n_gauge,), numbers from 0, over time_s (n,) since 1970: stress_mpa (n, n_gauge), NaN where
    nothing was recorded."""

    time_s: np.ndarray
    spots: np.ndarray
    stress_mpa: np.ndarray

    def at_times(self, start: pd.Timestamp, time_s: np.ndarray) -> np.ndarray:
        """(n_sample, n_gauge) at times since a block's start, about each gauge's mean; NaN of those that lack more than
        2 % of it."""
        at = start.timestamp() + time_s
        found = np.full((len(at), len(self.spots)), np.nan)
        inside = (self.time_s >= at[0]) & (self.time_s <= at[-1])
        for k, own in enumerate(self.stress_mpa.T):
            known = inside & np.isfinite(own)
            if known.sum() < 2:
                continue
            known_at = self.time_s[known]
            # a gap of more than two seconds, or of three samples, is not bridged
            gaps = np.diff(np.r_[at[0], known_at, at[-1]])
            if gaps[gaps > max(2.0, 3 * float(np.median(np.diff(known_at))))].sum() > (1 - WHOLE) * (at[-1] - at[0]):
                continue
            record = np.interp(at, known_at, own[known])
            found[:, k] = record - record.mean()
        return found


def read_gauges(path: str | Path, n_spot: int) -> Gauges:
    """A CSV of `time` (UTC, ISO 8601) and a column hot_spot_N_mpa for each gauge, N a number of hot_spots.csv; empty
    where nothing was recorded. Raises InputError."""
    where, again = str(path), "give a CSV with the columns time and hot_spot_N_mpa, N as in hot_spots.csv"
    text = read_text(path, again, largest=LARGEST)
    refuse_unfinished(Path(path))
    with parsing(where, "is not a table of gauges", again):
        table = pd.read_csv(io.StringIO(text), comment="#", dtype={"time": str})
    names = [name for name in table if COLUMN.fullmatch(str(name))]
    other = [str(name) for name in table if name not in names and name != "time"]
    if "time" not in table or not names or other:
        lacking = f"has the column {other[0]}" if other else "has no column of times or none of a gauge"
        raise InputError(where, lacking, again)
    spots = np.array([int(COLUMN.sub(r"\1", name)) - 1 for name in names])
    if spots.max() >= n_spot:
        raise InputError(f"{where}: {names[int(spots.argmax())]}", f"there are {n_spot} hot spots", again)
    with parsing(where, "has times or stresses that are none", again):
        time = pd.to_datetime(table["time"], utc=True, format="ISO8601")
        time_s = (time - pd.Timestamp(0, tz="UTC")).dt.total_seconds().to_numpy(float)
        stress = table[names].to_numpy(float)
    if len(time_s) < 2 or not np.all(np.diff(time_s) > 0):
        raise InputError(where, "has times that do not rise", "sort its rows by time, each once")
    if np.any(np.abs(stress) > STRONGEST_MPA):
        raise InputError(where, f"has a stress of {np.nanmax(np.abs(stress)):.3g} MPa, beyond {STRONGEST_MPA:g} MPa",
                         "give MPa, and leave out what stands for lost samples")
    for name, own in zip(names, stress.T, strict=True):
        std = float(np.std(own[np.isfinite(own)])) if np.isfinite(own).any() else 0.0
        # zero: it recorded nothing
        if 0 < std < LEAST_MPA or std > MOST_MPA:
            raise InputError(f"{where}: {name}", f"varies by {std:.2g} MPa (standard deviation), which no gauge "
                             f"{'resolves' if std < LEAST_MPA else 'on steel does'}",
                             "give stress in MPa: strain times Young's modulus (210000 MPa), kPa over 1000")
    return Gauges(time_s=frozen_array(time_s), spots=frozen_array(spots, int), stress_mpa=frozen_array(stress))


def gauge_comparison(
    block: str, time_s: np.ndarray, estimated: np.ndarray, measured: np.ndarray, spots: np.ndarray
) -> list[dict]:
    """A row a gauge: standard deviations and damage-equivalent ranges (m = 3, 5) of the estimated (n, n_gauge) over the
    measured stress (n, n_gauge), both counted in pieces of ten minutes, and their correlation."""
    rows, step = [], float(np.median(np.diff(time_s)))
    ten = max(round(TEN_MINUTES_S / step), 2)
    for k, spot in enumerate(spots):
        own, gauge = estimated[:, k], measured[:, k]
        if np.isnan(gauge).any() or not np.any(gauge):
            continue
        ratios = {f"del_m{m}_over_measured": (_count_damage(own, ten, m) / _count_damage(gauge, ten, m)) ** (1 / m)
                  for m in (3, 5)}
        rows.append({"block": block, "hot_spot": int(spot) + 1, "std_over_measured": float(own.std() / gauge.std()),
                     **ratios, "correlation": float(np.corrcoef(own, gauge)[0, 1])})
    return rows


def _count_damage(record: np.ndarray, ten: int, m: float) -> float:
    pieces = [record[a : a + ten] for a in range(0, max(len(record) - ten + 1, 1), ten)]
    return sum(float(np.sum(count * size**m)) for size, count in map(rainflow, pieces))
