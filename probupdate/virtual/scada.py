"""Ten-minute SCADA statistics of a plan, in the columns of a campaign's scada.csv."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from probupdate.virtual.operation import PER_SLOT, Plan

if TYPE_CHECKING:
    import pandas


def scada_table(plan: Plan, start: np.datetime64, rng: np.random.Generator) -> pandas.DataFrame:
    """One row per ten minutes, `time` the start of the interval (ISO 8601, UTC).

    Wind, power, rotor speed and pitch come with _std, _min, _max; the yaw rate with _max of its size. The
    wind vane and the heading are compass angles in [0, 360) whose mean is taken on the circle.
    """
    import pandas

    table: dict[str, object] = {}
    times = start + (600 * np.arange(plan.n_slot)).astype("timedelta64[s]")
    table["time"] = [f"{t}Z" for t in times.astype("datetime64[s]")]

    def statistics(name: str, values: np.ndarray, digits: int) -> None:
        rows = values.reshape(plan.n_slot, PER_SLOT)
        table[name] = rows.mean(axis=1).round(digits)
        for ending, value in (("std", rows.std(axis=1)), ("min", rows.min(axis=1)), ("max", rows.max(axis=1))):
            table[f"{name}_{ending}"] = value.round(digits)

    statistics("wind_speed_mps", plan.fast_wind_mps, 3)
    vane = plan.wind_direction_deg + 1.5 * rng.standard_normal(plan.n_slot)
    table["wind_direction_deg"] = np.mod(vane.round(1), 360)
    statistics("power_kw", plan.power_kw, 1)
    statistics("rotor_speed_rpm", plan.rotor_rpm, 3)
    statistics("pitch_deg", plan.pitch_deg, 3)
    turned = np.exp(1j * np.radians(plan.heading_deg)).reshape(plan.n_slot, PER_SLOT).mean(axis=1)
    table["nacelle_heading_deg"] = np.mod(np.degrees(np.angle(turned)).round(1), 360)
    rate = np.abs(plan.yaw_rate_degps).reshape(plan.n_slot, PER_SLOT)
    table["yaw_rate_degps"] = rate.mean(axis=1).round(4)
    table["yaw_rate_degps_max"] = rate.max(axis=1).round(4)
    for name, digits in (("water_level_m", 3), ("air_temperature_c", 2)):
        table[name] = getattr(plan, name).round(digits)
    # a wave radar's scatter
    table["wave_height_m"] = (plan.wave_height_m * (1 + 0.03 * rng.standard_normal(plan.n_slot))).round(3)
    table["wave_period_s"] = plan.wave_period_s.round(2)
    return pandas.DataFrame(table)
