"""Columns of SCADA against one another: numbers that stand for nothing, angles averaged across north, other units. What
cannot be what its name says is not used, and the sentence says what it may be and how to state it."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import pandas as pd

from probupdate.io.result_table import plural

ENDINGS = ("", "_std", "_min", "_max")
COMPASS = ("wind_direction_deg", "nacelle_heading_deg")
# what the weather and a turbine can have, in the columns' units: beyond it a number stands for none
POSSIBLE = {
    "wind_speed_mps": (0.0, 120.0), "wind_direction_deg": (-720.0, 1080.0), "power_kw": (-1e5, 5e7),
    "rotor_speed_rpm": (-50.0, 1e4), "pitch_deg": (-180.0, 360.0), "nacelle_heading_deg": (-1e4, 1e4),
    "yaw_rate_degps": (-100.0, 100.0), "water_level_m": (-100.0, 1000.0), "air_temperature_c": (-90.0, 400.0),
    "wave_height_m": (0.0, 50.0), "wave_period_s": (0.0, 100.0),
}
# numbers that programs write for none: nines, the ends of integers, the fill value of NetCDF
NINES = re.compile(r"-?9{3,}(\.9+|\.0+)?|-?9{2,}\.9{1,}")
ENDS = (-32768, 32767, 65535, -65535, -2147483648, 2147483647, 4294967295, 6999)
# such a number is one if it is first or last of its column and nothing else is this near to it (share of its size)
NEAR = 0.1
# rotor area by rated power (W/m2), and the speed of blade tips while it runs (m/s)
POWER_DENSITY, TIP_SPEED = 350.0, (30.0, 130.0)
USUAL_TIP_SPEED = 75.0
# a turbine runs in this wind (m/s) and, if large, at this speed (rpm); what large is, in kW
RUNS_ABOVE, CUT_OUT, TURNS, LARGE_RPM, LARGE_KW = 8.0, 24.0, 3.0, 30.0, 300.0
# least wind (m/s) of rated power, of 200 to 600 W/m2 of rotor and power coefficients of 0.38 to 0.47
RATED_WIND = (8.5, 14.0)
# power in that wind, as a share of rated, that is none of a turbine that runs, and what is more than it can give
LEAST_SHARE, MOST_SHARE = 0.02, 1.6
# share of rated power from which speed is held
RATED_SHARE = 0.97
WIND_UNITS = {"knots": 0.514444, "miles an hour": 0.44704, "km/h": 1 / 3.6}
# pitch (degrees) of blades that are feathered
FEATHERED = (60.0, 95.0)
# a table in which a wind stays the same so long is rarer than this
CHANCE = 1e-3
# fewest rows of which something is said
FEW = 3
# rows whose angle is so far from those before and after, which agree within SAME and are so near north
TURNED, SAME, NORTH = 90.0, 45.0, 75.0
# the nacelle follows the wind within this, while it runs
FOLLOWS = 45.0
# a heading that takes so many values is not one at which the nacelle stood, nor rounded to whole degrees near north
DIFFERENT = 8
# air warmer than this in the middle of the rows (C) is rarer than degrees Fahrenheit
WARM_C = 33.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Columns:
    """table: what is used; notes: what is not, one sentence each."""

    table: pd.DataFrame
    notes: tuple[str, ...]


def usable_columns(table: pd.DataFrame, rated_power_kw: float | None) -> Columns:
    """The table without fillers, angles averaged across north and columns in other units than their names say."""
    table, notes = table.copy(), []
    if table.empty:
        return Columns(table=table, notes=())
    notes += _check_rows_of_one_number(table)
    for column, (low, high) in POSSIBLE.items():
        for name in (column + e for e in ENDINGS if column + e in table):
            spread = name.endswith("_std")
            notes += _without_fillers(table, name, 0.0 if spread else low, high - low if spread else high)
    for column in COMPASS:
        notes += _check_angle_means(table, column)
    notes += [*_check_stillness(table, rated_power_kw), *_check_frozen_wind(table),
              *_check_frozen_rotor(table, rated_power_kw)]
    for test in (_exchanged_columns, _power_unit, _rotor_unit, _wind_unit, _pitch_unit):
        for column, sentence in test(table, rated_power_kw):
            table = table.drop(columns=[column + e for e in ENDINGS if column + e in table])
            notes.append(f"suspect: {sentence}; the column is not used")
    notes += [*_check_no_power(table, rated_power_kw), *_compass_unit(table, rated_power_kw), *_temperature_unit(table)]
    return Columns(table=table, notes=tuple(notes))


# Numbers that stand for none ----------------------------------------------------------------------------------------


def _check_rows_of_one_number(table: pd.DataFrame) -> list[str]:
    """All columns at the same number, 0 or -1 or nines: what an interface writes that has no values."""
    known = table[[c for c in POSSIBLE if c in table]]
    gone = ((known.min(axis=1) == known.max(axis=1)) & (known.notna().sum(axis=1) >= FEW)).to_numpy()
    if not gone.any():
        return []
    shown = ", ".join(f"{v:g}" for v in np.unique(known.max(axis=1)[gone])[:3])
    table.loc[gone] = np.nan
    return [f"{plural(int(gone.sum()), 'row')} of SCADA with one number in all columns ({shown}): taken as missing"]


def _without_fillers(table: pd.DataFrame, name: str, low: float, high: float) -> list[str]:
    values = table[name].to_numpy(float)
    # infinite ones too; of NaN both are false
    gone = (values < low) | (values > high)
    for value in np.unique(values[np.isfinite(values) & ~gone]):
        if _is_filler(float(value), values[~gone]):
            gone |= values == value
    if not gone.any():
        return []
    shown = ", ".join(f"{v:g}" for v in np.unique(values[gone])[:3])
    table[name] = np.where(gone, np.nan, values)
    if len(np.unique(values[gone])) > max(0.5 * np.isfinite(values).sum(), FEW):
        return [f"suspect: {name} in SCADA is {np.nanmedian(values):.4g} in the middle of its rows, which it cannot "
                "be: another column, or another unit? What lies outside is taken as missing"]
    return [f"{plural(int(gone.sum()), 'value')} of {name} in SCADA ({shown}), a filler: taken as missing"]


def _is_filler(value: float, column: np.ndarray) -> bool:
    if not (NINES.fullmatch(f"{value:.10g}") or value in ENDS):
        return False
    others = column[np.isfinite(column) & (column != value)]
    if not len(others):
        return True
    at_end = value < others.min() or value > others.max()
    return at_end and float(np.abs(others - value).min()) > NEAR * abs(value)


def _check_stillness(table: pd.DataFrame, rated: float | None) -> list[str]:
    """Calm or a rotor that stands in a few of the rows in which the turbine gives a fifth of its power, as zeros that
    stand for none: such a row has no wind or speed."""
    power = _column(table, "power_kw")
    gives, when = power > 0.2 * _full_power(power, rated), "the turbine gives a fifth of its power or more"
    return [*_without_least(table, "wind_speed_mps", gives, 0.5 * np.cbrt(0.2) * RATED_WIND[0], when),
            *_without_least(table, "rotor_speed_rpm", gives, TURNS, when)]


def _check_no_power(table: pd.DataFrame, rated: float | None) -> list[str]:
    """No power in a few of the rows in which the rotor turns in wind that gives a fifth of it: -1 and 0 for none."""
    power, wind, rotor = (_column(table, c) for c in ("power_kw", "wind_speed_mps", "rotor_speed_rpm"))
    full = _full_power(power, rated)
    usual = rotor[(power > 0.2 * full) & np.isfinite(rotor)]
    turns = (rotor > max(0.5 * np.median(usual), TURNS)) & (wind > RUNS_ABOVE) if len(usual) else rotor > np.inf
    return _without_least(table, "power_kw", turns, LEAST_SHARE * full, f"the rotor turns in over {RUNS_ABOVE:g} m/s")


def _without_least(table: pd.DataFrame, name: str, rows: np.ndarray, least: float, when: str) -> list[str]:
    gone = rows & (_column(table, name) < least)
    if not 0 < gone.sum() < 0.5 * rows.sum():
        return []
    table[name] = table[name].where(~gone)
    return [f"{plural(int(gone.sum()), 'value')} of {name} in SCADA below {least:.2g}, in rows in which {when}, cannot "
            "be: taken as missing"]


def _check_frozen_wind(table: pd.DataFrame) -> list[str]:
    """A wind that stays the same to its last digit while power or rotor change, for longer than that happens by chance
    with how often it goes on in the shorter of its runs. Its least value is a calm's."""
    wind = _column(table, "wind_speed_mps")
    gone = np.zeros(len(wind), bool)
    for rows in _frozen_runs(table, "wind_speed_mps", ("power_kw", "rotor_speed_rpm")):
        gone[rows] |= wind[rows] > np.nanmin(wind)
    return _without_frozen(table, "wind_speed_mps", gone, "power or rotor change, as of a stuck anemometer")


def _check_frozen_rotor(table: pd.DataFrame, rated: float | None) -> list[str]:
    """A rotor that turns at the same speed, to its last digit, for so long, while the turbine both gives a fifth of its
    power and none, or at a power at which it turned otherwise in the other rows, which agree. Most turbines are held at
    one speed at much of their power, some at all of it; none stands so."""
    power, rotor = _column(table, "power_kw"), _column(table, "rotor_speed_rpm")
    gone = np.zeros(len(rotor), bool)
    for rows in _frozen_runs(table, "rotor_speed_rpm", ("power_kw", "wind_speed_mps")):
        gives, none = power[rows] > 0.2 * _full_power(power, rated), power[rows] <= 0
        if rotor[rows][0] > TURNS and (min(gives.sum(), none.sum()) >= FEW or _turns_otherwise(power, rotor, rows)):
            gone |= rotor == rotor[rows][0]
    return _without_frozen(table, "rotor_speed_rpm", gone, "the turbine gives power and stands, or turned otherwise at "
                           "that power, as of a stuck sensor")


def _turns_otherwise(power: np.ndarray, rotor: np.ndarray, rows: slice) -> bool:
    """Whether the one speed of these rows is not that of the others nearest in power, as many of less as of more."""
    known = np.isfinite(power) & np.isfinite(rotor)
    mine = power[rows][known[rows]]
    known[rows] = False
    others = np.flatnonzero(known)
    if len(others) < 2 * FEW:
        return False
    order = others[np.argsort(power[others], kind="stable")]
    mine = mine[(mine > power[order[0]]) & (mine < power[order[-1]])]
    at = np.clip(np.searchsorted(power[order], mine), FEW, len(order) - FEW)
    near = rotor[order][at[:, None] + np.arange(-FEW, FEW)]
    unlike = (near.min(axis=1) > rotor[rows][0]) | (near.max(axis=1) < rotor[rows][0])
    # one of seven alike is the least or greatest in two rows of seven
    return bool(unlike.sum() >= max(FEW, len(mine) / 2))


def _frozen_runs(table: pd.DataFrame, name: str, beside: tuple[str, ...]) -> list[slice]:
    """Rows in which a column stays the same while one beside it changes, for longer than by chance."""
    value, driven = _column(table, name), np.column_stack([_column(table, c) for c in beside])
    again = np.concatenate([[False], np.diff(value) == 0, [False]])
    first, end = np.flatnonzero(again[1:] & ~again[:-1]), np.flatnonzero(again[:-1] & ~again[1:])
    changes = np.append(0, np.cumsum((np.abs(np.diff(driven, axis=0)) > 0).any(axis=1)))
    length, found = changes[end] - changes[first], []
    for start, last, steps in zip(first, end, length, strict=True):
        shorter = length[(length < steps) & (length > 0)]
        goes_on = (np.sum(shorter - 1) + 1) / (np.sum(shorter) + 2)
        if len(value) * goes_on**steps < CHANCE:
            found.append(slice(start, last + 1))
    return found


def _without_frozen(table: pd.DataFrame, name: str, gone: np.ndarray, when: str) -> list[str]:
    if not gone.any():
        return []
    table[name] = table[name].where(~gone)
    begins = table.index[int(np.argmax(gone))].strftime("%Y-%m-%d %H:%M")
    return [f"{plural(int(gone.sum()), 'value')} of {name} in SCADA, first {begins}, stay the same while {when}: taken "
            "as missing"]


# Angles -------------------------------------------------------------------------------------------------------------


def _difference(a, b):
    """In -180 to 180."""
    return (np.asarray(a) - np.asarray(b) + 180.0) % 360.0 - 180.0


def _typical_difference(a: np.ndarray, b: np.ndarray) -> float:
    """Median of the angle between a and b; infinite where nowhere both are known."""
    apart = np.abs(_difference(a, b))
    return float(np.median(apart[np.isfinite(apart)])) if np.isfinite(apart).any() else np.inf


def _check_angle_means(table: pd.DataFrame, column: str) -> list[str]:
    """A mean of 359 and 1 that is 180: its own extremes lie on both sides of north, or it is far from the rows around
    it, which are north. Such a row has no angle."""
    if column not in table:
        return []
    value = table[column].to_numpy(float)
    before, after = np.roll(value, 1), np.roll(value, -1)
    with np.errstate(invalid="ignore"):
        gone = ((np.abs(_difference(value, before)) > TURNED) & (np.abs(_difference(value, after)) > TURNED)
                & (np.abs(_difference(before, after)) < SAME) & (np.abs(_difference(before, 0)) < NORTH))
        gone[[0, -1]] = False
        if f"{column}_min" in table and f"{column}_max" in table:
            low, high = (table[f"{column}_{e}"].to_numpy(float) % 360.0 for e in ("min", "max"))
            gone |= (high - low > 180.0) & (np.abs(_difference(value, 0)) > TURNED)
    if not gone.any():
        return []
    table[column] = np.where(gone, np.nan, value)
    first = table.index[int(np.argmax(gone))].strftime("%Y-%m-%d %H:%M")
    return [f"{plural(int(gone.sum()), 'row')} of {column} in SCADA, first {first}, look away while those around them "
            "look north: averaged across north by the logger, taken as missing"]


def _compass_unit(table: pd.DataFrame, rated_power_kw: float | None) -> list[str]:
    """Headings in radians: all of them within one turn of radians though they change, which is a window of a few
    degrees about north, unless the other compass column says that it is just that window."""
    known = {c: table[c].to_numpy(float) for c in COMPASS if c in table and np.isfinite(table[c]).sum() >= FEW}
    narrow = [c for c, v in known.items() if np.nanmax(np.abs(v)) <= 2 * np.pi + 0.01 and len(np.unique(
        v[np.isfinite(v)])) >= DIFFERENT]
    found, runs = [], _runs(table, rated_power_kw)
    rows = runs if runs.sum() >= FEW else np.ones(len(table), bool)
    for name in narrow:
        other = [v for c, v in known.items() if c not in narrow]
        apart = [_typical_difference(f * known[name][rows], v[rows]) for v in other for f in (1.0, 180 / np.pi)]
        if not other or apart[1] < min(FOLLOWS, apart[0]):
            found.append(f"suspect: {name} in SCADA stays between {np.nanmin(known[name]):.3g} and "
                         f"{np.nanmax(known[name]):.3g}{' beside the other' if other else ''}: is it in radians? "
                         + _factor_remedy(name, 180 / np.pi))
    return found or _heading_beside_wind(table, rated_power_kw)


def _heading_beside_wind(table: pd.DataFrame, rated_power_kw: float | None) -> list[str]:
    if not set(COMPASS) <= set(table.columns):
        return []
    runs = _runs(table, rated_power_kw)
    heading, wind = (table[c].to_numpy(float)[runs] for c in ("nacelle_heading_deg", "wind_direction_deg"))
    apart = _difference(heading, wind)
    apart = apart[np.isfinite(apart)]
    if len(apart) < FEW or not np.median(np.abs(apart)) > FOLLOWS:
        return []
    offset = float(np.degrees(np.angle(np.mean(np.exp(1j * np.radians(apart))))))
    return [f"suspect: while the turbine runs, nacelle_heading_deg in SCADA is {offset:+.0f} deg from "
            "wind_direction_deg in the mean: another zero or another sense of one of them?"]


# Units --------------------------------------------------------------------------------------------------------------


def _column(table: pd.DataFrame, name: str) -> np.ndarray:
    return table[name].to_numpy(float) if name in table else np.full(len(table), np.nan)


def _full_power(power: np.ndarray, rated: float | None) -> float:
    return rated or (float(np.nanmax(power)) if np.isfinite(power).any() else np.nan)


def _runs(table: pd.DataFrame, rated_power_kw: float | None) -> np.ndarray:
    """(n_row,) where power, or else wind and rotor, say that the turbine runs."""
    power, wind, rotor = (_column(table, c) for c in ("power_kw", "wind_speed_mps", "rotor_speed_rpm"))
    with np.errstate(invalid="ignore"):
        if np.isfinite(power).any():
            rated = rated_power_kw or float(np.nanmax(power))
            return power > 0.05 * rated
        return (rotor > TURNS) & ~(wind < 4.0) if np.isfinite(rotor).any() else (wind > RUNS_ABOVE) & (wind < CUT_OUT)


def _factor_remedy(column: str, factor: float) -> str:
    return f"if so, state [scada] factor = {{ {column} = {factor:.6g} }} in campaign.toml"


def _exchanged_columns(table: pd.DataFrame, rated: float | None) -> list[tuple[str, str]]:
    """Wind and rotor at rated power: the rotor is held at one speed there, the wind is not."""
    power, wind, rotor = (_column(table, c) for c in ("power_kw", "wind_speed_mps", "rotor_speed_rpm"))
    at = (power > RATED_SHARE * _full_power(power, rated)) & np.isfinite(wind) & np.isfinite(rotor) & (wind > 0)
    speed = np.log(np.maximum(rotor[at], TURNS))
    if at.sum() < 2 * FEW or np.ptp(speed) < NEAR or np.std(speed) < np.ptp(np.log(wind[at])):
        return []
    text = ("is as steady at rated power as a rotor, and rotor_speed_rpm as unsteady as a wind: are the two exchanged? "
            "If so, exchange their names in scada.csv")
    return [("wind_speed_mps", f"wind_speed_mps in SCADA {text}"),
            ("rotor_speed_rpm", "rotor_speed_rpm in SCADA is as unsteady at rated power as a wind")]


def _power_unit(table: pd.DataFrame, rated: float | None) -> list[tuple[str, str]]:
    """Power beside rated power, in wind or at a rotor speed in which a turbine runs."""
    power, wind, rotor = (_column(table, c) for c in ("power_kw", "wind_speed_mps", "rotor_speed_rpm"))
    if not np.isfinite(power).any():
        return []
    with np.errstate(invalid="ignore"):
        turning = (rotor > TURNS) & ~(wind < RUNS_ABOVE) if np.isfinite(rotor).any() else (
            wind > RUNS_ABOVE) & (wind < CUT_OUT)
        slow = np.isfinite(rotor).any() and float(np.nanmax(rotor)) < LARGE_RPM
    at = np.flatnonzero(turning & np.isfinite(power))
    most = float(np.nanmax(power))
    full = rated or LARGE_KW
    # no turbine has a hundred megawatts, whatever else is known of it
    high = most / full > MOST_SHARE if rated else most > 1e5
    if rated is None and not slow and not high:
        return []
    # below the share of a wind only a curtailed turbine stays in it: another unit is asked about where one fits
    strongest = RUNS_ABOVE if rated else float(np.fmax.reduce(wind[at], initial=RUNS_ABOVE))
    least = min(strongest / RATED_WIND[1], 1.0) ** 3
    if not high and (len(at) < FEW or float(np.max(power[at])) > least * full):
        return []
    k = int(np.nanargmax(power)) if high or not len(at) else int(at[np.argmax(power[at])])
    share = f" ({100 * power[k] / rated:.2g} % of rated_power_kw)" if rated else ""
    beside = " and ".join(f"{v[k]:.3g} {unit}" for v, unit in ((wind, "m/s"), (rotor, "rpm")) if np.isfinite(v[k]))
    text = f"power_kw in SCADA reaches {power[k]:.6g}{share}{' at ' + beside if beside else ''}: "
    units = (("MW", 1e3), ("W", 1e-3), ("percent of rated power", full / 100), ("a share of rated power", full))
    if rated is None and not high and most > 30:
        return [("power_kw", text + "is it in percent of rated power? State rated_power_kw in campaign.toml, and "
                 "`check` gives the factor")] if most < 130 else []
    fits = [(name, factor) for name, factor in units if 0.3 < factor * power[k] / full < 1.3] if rated else (
        [("MW", 1e3)] if not high else [("W", 1e-3)])
    if not fits:
        curtailed = not high and float(np.max(power[at])) > LEAST_SHARE * full
        return [] if curtailed else [("power_kw", text + "another unit?")]
    return [("power_kw", text + f"is it in {fits[0][0]}? {_factor_remedy('power_kw', fits[0][1])}")]


def _rotor_unit(table: pd.DataFrame, rated: float | None) -> list[tuple[str, str]]:
    """The speed of the blades' tips while the turbine gives power: by its rated power the rotor has a size."""
    rotor, power, wind = (_column(table, c) for c in ("rotor_speed_rpm", "power_kw", "wind_speed_mps"))
    full = _full_power(power, rated)
    if not np.isfinite(rotor).any() or not full > LARGE_KW:
        return []
    with np.errstate(invalid="ignore"):
        at = (power > 0.5 * full) if np.isfinite(power).any() else (wind > 12.0) & (wind < CUT_OUT)
    at &= np.isfinite(rotor)
    if at.sum() < FEW:
        return []
    middle = float(np.median(rotor[at]))
    radius = np.sqrt(1e3 * full / (np.pi * POWER_DENSITY))
    tip = abs(middle) * 2 * np.pi / 60 * radius
    if TIP_SPEED[0] <= tip <= TIP_SPEED[1] or not tip > 0.1:
        return []
    text = (f"rotor_speed_rpm in SCADA is {middle:.4g} while the turbine gives power: the blades' tips would go "
            f"{tip:.3g} m/s, where {TIP_SPEED[0]:g} to {TIP_SPEED[1]:g} are usual of {full:g} kW: ")
    units = (("rad/s", 60 / (2 * np.pi)), ("turns a second", 60.0), ("deg/s", 1 / 6))
    fits = [(name, factor) for name, factor in units if TIP_SPEED[0] <= factor * tip <= TIP_SPEED[1]]
    if fits:
        return [("rotor_speed_rpm", text + f"is it in {fits[0][0]}? {_factor_remedy('rotor_speed_rpm', fits[0][1])}")]
    gear = tip / USUAL_TIP_SPEED
    if gear > 10:
        return [("rotor_speed_rpm", text + f"is it the generator's, with a gear of about {gear:.2g}? "
                 + _factor_remedy("rotor_speed_rpm", 1 / gear) + ", with one over the gear's own ratio")]
    return [("rotor_speed_rpm", text + "another unit?")]


def _wind_unit(table: pd.DataFrame, rated: float | None) -> list[tuple[str, str]]:
    """The wind of rated power, by the cube of the wind from rows at a part of it. Curtailed rows have too much wind for
    their power, and where rated power is not known the highest is too little: neither makes the least wind too high."""
    power, wind = _column(table, "power_kw"), _column(table, "wind_speed_mps")
    full = _full_power(power, rated)
    with np.errstate(invalid="ignore"):
        at = (power > 0.2 * full) & (power < 0.8 * full) & np.isfinite(wind)
        runs = (power > 0.2 * full) & np.isfinite(wind)
    if runs.sum() >= FEW and float(np.median(wind[runs])) > CUT_OUT:
        middle = float(np.median(wind[runs]))
        return _wind_sentence(f"{middle:.3g} in the middle of the rows in which the turbine gives power, and turbines "
                              f"stop above {CUT_OUT:g} m/s: ", middle, (0.5 * RATED_WIND[0], CUT_OUT))
    if at.sum() < 2 * FEW:
        return []
    of_rated = wind[at] / np.cbrt(power[at] / full)
    least, middle = np.quantile(of_rated, [0.1, 0.5])
    if least <= RATED_WIND[1] and (middle >= RATED_WIND[0] or not rated):
        return []
    return _wind_sentence(f"{np.median(wind[at]):.3g} where the turbine gives a part of its power, and would be "
                          f"{middle:.3g} at rated power, which {RATED_WIND[0]:g} to {RATED_WIND[1]:g} m/s give: ",
                          float(middle), RATED_WIND)


def _wind_sentence(text: str, middle: float, possible: tuple[float, float]) -> list[tuple[str, str]]:
    fits = [(name, f) for name, f in WIND_UNITS.items() if possible[0] <= f * middle <= possible[1]]
    remedy = "; ".join(_factor_remedy("wind_speed_mps", f) + (f" for {name}" if len(fits) > 1 else "")
                       for name, f in fits)
    question = f"is it in {' or '.join(n for n, _ in fits)}? {remedy}" if fits else "another unit?"
    return [("wind_speed_mps", f"wind_speed_mps in SCADA is {text}{question}")]


def _pitch_unit(table: pd.DataFrame, rated: float | None) -> list[tuple[str, str]]:
    """The pitch while the rotor stands or idles: blades are feathered then."""
    pitch, rotor = _column(table, "pitch_deg"), _column(table, "rotor_speed_rpm")
    with np.errstate(invalid="ignore"):
        at = ~_runs(table, rated) & ~(rotor > TURNS) & np.isfinite(pitch)
    if at.sum() < FEW or not FEATHERED[0] <= np.degrees(float(np.median(pitch[at]))) <= FEATHERED[1]:
        return []
    middle = float(np.median(pitch[at]))
    return [("pitch_deg", f"pitch_deg in SCADA is {middle:.3g} where the turbine idles, at which blades are feathered: "
             f"is it in radians? {_factor_remedy('pitch_deg', 180 / np.pi)}")]


def _temperature_unit(table: pd.DataFrame) -> list[str]:
    """Nothing else in the table knows how warm it was: what no climate has in the middle of day and night is asked."""
    known = _column(table, "air_temperature_c")
    known = known[np.isfinite(known)]
    if len(known) < FEW or np.median(known) <= WARM_C:
        return []
    middle = float(np.median(known))
    return [f"suspect: air_temperature_c in SCADA is {middle:.3g} in the middle of its rows: is it in degrees "
            f"Fahrenheit ({(middle - 32) / 1.8:.3g} C)? If so, write (value - 32) / 1.8"]
