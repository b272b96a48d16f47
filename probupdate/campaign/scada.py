"""SCADA: ten-minute rows read, gathered over a block, and the turbine's state derived from them."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd

from probupdate.campaign.last_line import open_beginning, unfinished_line
from probupdate.campaign.scada_columns import COMPASS, ENDINGS, usable_columns
from probupdate.campaign.stated import NOT_A_NUMBER
from probupdate.errors import InputError, parsing
from probupdate.io.files import LARGEST_TEXT, input_file
from probupdate.io.schema import Range
from probupdate.modal.conditions import COLUMNS, misspelt
from probupdate.modal.modes import refuse_no_celsius

LONGEST_NUMBER = 300
ROW_MINUTES = 10
# of any time that a file may state; what counts nanoseconds ends in 2262
EARLIEST, LATEST = pd.Timestamp("1900-01-01", tz="UTC"), pd.Timestamp("2200-01-01", tz="UTC")
# a block's state is that of its rows, if more than this share of them have one
MOST_ROWS_KNOWN = 0.5
STATES = ("idling", "below rated", "rated")
# a rotor slower than this (rpm) excites nothing at its multiples
SLOWEST_RPM = 3.0
# a row's variance over the largest that its mean and ends allow (Bhatia-Davis), from which the rotor stood and turned
# in it; where it passed all speeds alike the share is a third
AT_ENDS = 0.6


@dataclass(frozen=True, kw_only=True)
class StateRule:
    """Turbine states by power, as the paper has them: shares of the rated power, and that power if it is known.

    A row at or below `idling_share` idles or is parked, one at or above `rated_share` runs at rated power. Without
    rated_power_kw the highest power recorded stands for it, which calls a calm day's best ten minutes rated.
    """

    idling_share: float = 0.005
    rated_share: float = 0.97
    rated_power_kw: float | None = None


@dataclass(frozen=True, kw_only=True)
class StatedScada:
    """[scada] of campaign.toml: factor: column -> what its numbers are multiplied with to be in the unit of its name;
    shift_minutes: what is added to its times."""

    factor: Mapping[str, Annotated[float, Range(-1e6, 1e6, nonzero=True)]] = field(default_factory=dict)
    shift_minutes: Annotated[float, Range(-1e6, 1e6)] = 0.0


AS_WRITTEN = StatedScada()


def read_scada(
    path: str | Path, *, rated_power_kw: float | None = None, stated: StatedScada = AS_WRITTEN
) -> pd.DataFrame:
    """Rows indexed by `time` (UTC, start of the interval), ascending, one a time: of several, the first value of each
    column; `.attrs["contradicted"]`: how many rows were left out that do not say the same as the one kept; ["notes"]:
    what of its columns, or of a last line that is cut off, is not used, one sentence each; ["path"]: the file.

    Columns beyond the known ones stay. Raises InputError on a missing time column, a time or a number that is none.
    """
    path = input_file(path, "give the scada.csv of the campaign", largest=LARGEST_TEXT)
    with parsing(str(path), "not a table", "write comma-separated columns with a header"):
        size, cut = unfinished_line(path)
        with open_beginning(path, "utf-8", size) as stream:
            table = pd.read_csv(stream, dtype={"time": str}, low_memory=False)
    if "time" not in table:
        if len(table.columns) == 1 and re.search(r"[;\t|]", str(table.columns[0])):
            raise InputError(str(path), f"has one column, '{table.columns[0]:.60}'",
                             "separate columns by commas, and write decimals with a point")
        close = difflib.get_close_matches("time", [str(c).strip().lower() for c in table], n=1, cutoff=0.6)
        raise InputError(str(path), "has no column 'time'", "add the start of each interval in UTC, ISO 8601"
                         + (f", or rename '{close[0]}' to it" if close else ""))
    for known, given in misspelt(table.columns).items():
        raise InputError(str(path), f"unknown column '{given}'", f"did you mean '{known}'? Rename it, or give it a "
                         "name that is not so near")
    try:
        time = pd.to_datetime(table["time"], utc=True, format="ISO8601")
    except (ValueError, TypeError) as error:
        wrong = pd.to_datetime(table["time"], utc=True, format="ISO8601", errors="coerce").isna()
        row = int(np.argmax(wrong))
        raise InputError(f"{path}, row {row + 2}, time", f"'{table['time'].iloc[row]}' is not a time",
                         "write ISO 8601, UTC; a row may have more cells than the header") from error
    if time.isna().any():
        raise InputError(f"{path}, row {int(np.argmax(time.isna())) + 2}", "has no time", "give it or drop the row")
    absurd = (time < EARLIEST) | (time > LATEST)
    if absurd.any():
        row = int(np.argmax(absurd))
        raise InputError(f"{path}, row {row + 2}, time", f"'{table['time'].iloc[row]}' is not between "
                         f"{EARLIEST:%Y} and {LATEST:%Y}", "correct it, or drop the row")
    # blocks may start between the units that the file is written in
    time = time.dt.as_unit("ns")
    table = table.drop(columns="time").set_index(pd.DatetimeIndex(time, name="time")).sort_index(kind="stable")
    for column in table:
        if len(table) and column.startswith(COLUMNS):
            table[column] = _numbers(f"{path}, {column}", table[column])
    table = _convert_units(table, stated, f"{path}")
    found = usable_columns(table, rated_power_kw)
    table = found.table
    if "air_temperature_c" in table:
        refuse_no_celsius(str(path), table["air_temperature_c"].to_numpy(float))
    again = table.index.duplicated()
    kept, contradicted = (_merge_equal_times(table) if again.any() else (table, 0))
    kept.attrs["path"] = str(path)
    kept.attrs["contradicted"] = contradicted
    kept.attrs["notes"] = (*found.notes, *([f"{path.name}: {cut}"] if cut else []), *_middle_stamps(kept.index))
    return kept


def _middle_stamps(times: pd.DatetimeIndex) -> list[str]:
    """A sentence where rows of ten minutes begin five minutes past the tens: what a logger stamps in the middle."""
    past = (times - times.floor(f"{ROW_MINUTES}min")) / pd.Timedelta(minutes=ROW_MINUTES)
    if len(times) < 2 or not (past == 0.5).all():
        return []
    return [f"suspect: all times in SCADA are {ROW_MINUTES / 2:g} min past the tens: are they the middles of the ten "
            f"minutes? If so, state [scada] shift_minutes = {-ROW_MINUTES / 2:g} in campaign.toml"]


def _numbers(where: str, column: pd.Series) -> pd.Series:
    """As floats; a filler of thirty digits, which is not a number of a machine, too."""
    text = column.astype(str)
    # pandas takes so many digits for an integer, which no float holds
    number = pd.to_numeric(column.mask(text.str.len() > LONGEST_NUMBER), errors="coerce")
    wrong = (number.isna() & column.notna() & ~text.str.strip().str.lower().isin(NOT_A_NUMBER)).to_numpy()
    if wrong.any():
        first = text.iloc[int(np.argmax(wrong))]
        raise InputError(where, f"'{first:.80}' is not a number", "write decimals with a point" if re.fullmatch(
            r"\s*-?\d+,\d+\s*", first) else "correct it, or leave the cell empty where it is unknown")
    return number.astype(float)


def _convert_units(table: pd.DataFrame, stated: StatedScada, path: str) -> pd.DataFrame:
    for column, factor in stated.factor.items():
        if column not in table:
            raise InputError(f"{path}, {column}", "campaign.toml states its factor under [scada], and it is not there",
                             "correct [scada] in campaign.toml")
        for name in (f"{column}{e}" for e in ENDINGS if f"{column}{e}" in table):
            table[name] = table[name] * factor
    if stated.shift_minutes:
        table.index = table.index + pd.Timedelta(minutes=stated.shift_minutes)
    return table


def _merge_equal_times(table: pd.DataFrame) -> tuple[pd.DataFrame, int]:
    """Rows of one time as one, an empty cell filled from the next of them, and how many contradict the one kept."""
    first = table.groupby(level=0).first()
    beside = first.reindex(table.index)
    unlike = (table.notna() & beside.notna() & (table != beside)).any(axis=1)
    return first[table.columns], int(unlike.sum())


def renaming(column: str | None) -> str:
    """What to say behind the name of a column that is absent, of one that may be it."""
    return "" if column is None else f" (rename '{column}' if that is it)"


def with_rated_power(rule: StateRule, scada: pd.DataFrame | None) -> StateRule:
    """The rule with the highest recorded power where the rated one is not given (unchanged without power)."""
    if rule.rated_power_kw is not None or scada is None or "power_kw" not in scada:
        return rule
    power = scada["power_kw"].to_numpy(float)
    if not np.any(np.isfinite(power)):
        return rule
    return StateRule(idling_share=rule.idling_share, rated_share=rule.rated_share,
                     rated_power_kw=max(float(np.nanmax(power)), 0.0))


def row_states(scada: pd.DataFrame, rule: StateRule) -> np.ndarray:
    """(n_row,) state of each row; 'unknown' where the power was not recorded."""
    rule = with_rated_power(rule, scada)
    if "power_kw" not in scada or rule.rated_power_kw is None:
        return np.full(len(scada), "unknown", dtype=object)
    power = scada["power_kw"].to_numpy(float)
    with np.errstate(invalid="ignore"):
        idling = power <= rule.idling_share * rule.rated_power_kw
        rated = power >= rule.rated_share * rule.rated_power_kw
    state = np.where(idling, STATES[0], np.where(rated, STATES[2], STATES[1]))
    return np.where(np.isfinite(power), state, "unknown").astype(object)


def block_conditions(
    scada: pd.DataFrame | None, start: pd.Timestamp, minutes: float, rule: StateRule
) -> Mapping[str, float | str]:
    """What the turbine and the weather did during a block: the rows that begin in it, or the one in which it lies.

    Means under the columns' own names (compass angles on the circle); `<column>_max` and `_min` the extremes, taken
    from those columns where recorded, else from the means; `<column>_range` for pitch and heading;
    `rotor_speed_rpm_turning_min` and `_max`: between which the rotor turned, where it stood too; `state`: the rows'
    common state, 'mixed' where they differ, 'unknown' where most have no power; `scada_rows`, `scada_coverage`.
    """
    wanted = max(int(minutes // ROW_MINUTES), 1)
    found: dict[str, float | str] = {"state": "unknown", "scada_rows": 0.0, "scada_coverage": 0.0}
    if scada is None:
        return found
    end = start + pd.Timedelta(minutes=minutes)
    first, last = scada.index.searchsorted(start), scada.index.searchsorted(end)
    if first == last:
        # a block of a few minutes lies within a row
        middle = start + (end - start) / 2
        last = scada.index.searchsorted(middle, side="right")
        first = scada.index.searchsorted(middle - pd.Timedelta(minutes=ROW_MINUTES), side="right")
    rows = scada.iloc[first:last]
    if rows.empty:
        return found
    found["scada_rows"], found["scada_coverage"] = float(len(rows)), min(len(rows) / wanted, 1.0)
    for column in COLUMNS:
        if column not in rows:
            continue
        values = rows[column].to_numpy(float)
        values = values[np.isfinite(values)]
        if not len(values):
            continue
        if column in COMPASS:
            mean = np.angle(np.mean(np.exp(1j * np.radians(values))))
            turned = np.degrees(np.angle(np.exp(1j * (np.radians(values) - mean))))
            found[column] = float(np.degrees(mean) % 360)
            found[f"{column}_range"] = float(np.ptp(turned))
            continue
        found[column] = float(np.mean(values))
        ends: dict[str, float] = {}
        for ending, extreme in (("max", np.max), ("min", np.min)):
            recorded = rows[f"{column}_{ending}"].to_numpy(float) if f"{column}_{ending}" in rows else values
            recorded = recorded[np.isfinite(recorded)]
            ends[f"{column}_{ending}"] = float(extreme(np.concatenate([recorded, values])))
        found |= ends
        if column == "pitch_deg":
            found["pitch_deg_range"] = ends["pitch_deg_max"] - ends["pitch_deg_min"]
    turning = _turning_speeds(scada, first, last) if "rotor_speed_rpm" in rows else []
    if turning:
        span = {"min": min(low for low, _ in turning), "max": max(high for _, high in turning)}
        found |= {f"rotor_speed_rpm_turning_{end}": x for end, x in span.items()
                  if x != found[f"rotor_speed_rpm_{end}"]}
    states = set(row_states(rows, rule)) if rule.rated_power_kw is not None else {"unknown"}
    if len(states) > 1 and np.mean(row_states(rows, rule) != "unknown") > MOST_ROWS_KNOWN:
        states.discard("unknown")
    found["state"] = states.pop() if len(states) == 1 else "mixed"
    return found


def turning_range(conditions: Mapping[str, float | str]) -> tuple[float, float]:
    """Lowest and highest speed (rpm) at which the rotor turned in a block by its conditions, NaN where not recorded."""
    ends = (conditions.get(f"rotor_speed_rpm_turning_{end}", conditions.get(f"rotor_speed_rpm_{end}"))
            for end in ("min", "max"))
    low, high = (float(x) if x is not None else np.nan for x in ends)
    return low, high


def _turning_speeds(scada: pd.DataFrame, first: int, last: int) -> list[tuple[float, float]]:
    """Speeds (lowest, highest) at which the rotor turned, of each row from first to last in which it did. A row of
    starting or stopping that states a mean alone, at which the rotor never turned, takes the speed beside it."""
    before = max(first - 1, 0)
    rows = scada.iloc[before: last + 1]
    mean = rows["rotor_speed_rpm"].to_numpy(float)

    def recorded(ending: str) -> np.ndarray:
        name = f"rotor_speed_rpm_{ending}"
        return rows[name].to_numpy(float) if name in rows else np.full(len(mean), np.nan)

    low, high, std = np.fmin(recorded("min"), mean), np.fmax(recorded("max"), mean), recorded("std")
    spans = []
    for k in np.flatnonzero(high[first - before: last - before] >= SLOWEST_RPM) + first - before:
        beside = [mean[j] for j in (k - 1, k + 1) if 0 <= j < len(mean) and np.isfinite(mean[j])]
        turned = max((x for x in beside if x > mean[k]), default=np.nan)
        stood = low[k] < SLOWEST_RPM or (np.isnan(recorded("min")[k]) and min(beside, default=np.inf) < SLOWEST_RPM)
        if stood and std[k] ** 2 >= AT_ENDS * (high[k] - mean[k]) * (mean[k] - low[k]) > 0:
            # at the lowest for a share of the time and at one speed else: what that speed is by mean and variance
            spans.append((min(mean[k] + std[k] ** 2 / (mean[k] - low[k]), high[k]), high[k]))
        elif stood and np.isnan(std[k]) and np.isfinite(turned):
            spans.append((turned, max(turned, high[k])))
        else:
            spans.append((max(low[k], SLOWEST_RPM), high[k]))
    return spans
