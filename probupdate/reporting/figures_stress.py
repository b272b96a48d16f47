"""Figures of stresses from measured motion: history, damage over wind and direction, measured beside stated loads."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from probupdate.lifetime.gauges import GaugeCheck
from probupdate.reporting.style import (
    BLUE,
    FULL_IN,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PURPLE,
    RED,
    label_axes,
    new_figure,
    styled,
)

COLOURS = (BLUE, ORANGE, GREEN, RED, PURPLE, GREY)
MARKERS = "os^vDP"
# hot spots that are drawn by name
SHOWN = 3
SECTORS = 12
# of a history that is laid over a gauge's
MINUTES_S = 600.0


@styled
def history(table: pd.DataFrame, block: str) -> Figure:
    """Stress of the worst hot spots over time. table: time_s and a column hot_spot_N_mpa each."""
    columns = [c for c in table if c != "time_s"][:SHOWN]
    figure = new_figure(FULL_IN, 1.4 * len(columns) + 0.6)
    axes = figure.subplots(len(columns), 1, sharex=True, squeeze=False)[:, 0]
    for k, (axis, name) in enumerate(zip(axes, columns, strict=True)):
        axis.plot(table["time_s"] / 60, table[name], color=COLOURS[k], linewidth=0.5)
        last = axis is axes[-1]
        label_axes(axis, f"minutes from {block}" if last else "", f"spot {name.split('_')[2]} [MPa]")
    return figure


@styled
def over_gauges(check: GaugeCheck) -> Figure:
    """Estimated stress over what strain gauges measured, ten minutes of a block; gauges took no part in it."""
    shown = np.flatnonzero(np.isfinite(check.measured).all(axis=0))[:SHOWN]
    some = check.time_s <= check.time_s[0] + MINUTES_S
    figure = new_figure(FULL_IN, 1.4 * len(shown) + 0.6)
    axes = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
    for axis, k in zip(axes, shown, strict=True):
        axis.plot(check.time_s[some] / 60, check.measured[some, k], color=GREY, linewidth=1.4, label="gauge")
        axis.plot(check.time_s[some] / 60, check.estimated[some, k], color=BLUE, linewidth=0.7, label="estimate")
        label_axes(axis, f"minutes from {check.block}" if axis is axes[-1] else "",
                   f"spot {check.spots[k] + 1} [MPa]")
    axes[0].legend(frameon=False, fontsize="small", ncols=2)
    return figure


@styled
def over_wind(blocks: pd.DataFrame) -> Figure | None:
    """Damage of an hour at the worst hot spot over the wind, by state; None where no wind was recorded."""
    own = blocks[blocks["hot_spot"] == blocks["hot_spot"].iloc[0]]
    if own["wind_speed_mps"].isna().all():
        return None
    figure = new_figure(FULL_IN, 2.8)
    axis = figure.subplots()
    for k, (state, rows) in enumerate(own.groupby("state", sort=False)):
        axis.scatter(rows["wind_speed_mps"].astype(float), rows["damage_per_hour"], s=14, color=COLOURS[k % 6],
                     marker=MARKERS[k % 6], label=str(state), rasterized=len(own) > 2500)
    axis.set_yscale("log")
    label_axes(axis, "wind [m/s]", f"damage of an hour, spot {own['hot_spot'].iloc[0]} [-]")
    axis.legend(frameon=False, fontsize="small")
    return figure


@styled
def rose(blocks: pd.DataFrame) -> Figure | None:
    """Where the wind came from while damage was done at the worst hot spot; None where no heading was recorded."""
    own = blocks[blocks["hot_spot"] == blocks["hot_spot"].iloc[0]]
    known = own["nacelle_heading_deg"].astype(float)
    if known.isna().all():
        return None
    sector = np.round(known / (360 / SECTORS)) % SECTORS
    total = own["damage_per_hour"].groupby(sector).sum()
    figure = new_figure(3.4, 3.4)
    # matplotlib's annotations know of no polar axes here
    axis: Any = figure.add_subplot(projection="polar")
    axis.set_theta_zero_location("N")
    axis.set_theta_direction(-1)
    axis.bar(np.radians(total.index.to_numpy(float) * 360 / SECTORS), 100 * total / total.sum(),
             width=2 * np.pi / SECTORS, color=BLUE, edgecolor=INK, linewidth=0.4)
    axis.set_title(f"damage by nacelle heading, spot {own['hot_spot'].iloc[0]} [%]", fontsize="small")
    return figure


@styled
def measured_and_stated(spots: pd.DataFrame) -> Figure:
    """Damage of a year from the measured motion, with intervals, beside that of the stated loads, worst of each
    side."""
    own = spots.drop_duplicates(["member", "side"]).head(12)
    figure = new_figure(FULL_IN, 3.2)
    axis = figure.subplots()
    at = np.arange(len(own))
    middle = own["p50"].to_numpy(float)
    low, high = middle - own["p05"], own["p95"] - middle
    axis.errorbar(at, middle, yerr=[low, high], fmt="o", color=BLUE, capsize=2, label="measured motion, 90 % interval")
    axis.scatter(at, own["stated_damage_per_year"], marker="D", color=GREY, label="stated loads", zorder=3)
    axis.set_yscale("log")
    axis.set_xticks(at, [f"{m}\n{s}" for m, s in zip(own["member"], own["side"], strict=True)], rotation=60,
                    ha="right", fontsize=6)
    label_axes(axis, "", "damage of a year [-]")
    axis.legend(frameon=False, fontsize="small")
    return figure


def stress_figures(
    spots: pd.DataFrame, blocks: pd.DataFrame, histories: dict[str, pd.DataFrame], gauges: GaugeCheck | None = None
) -> Iterator[tuple[str, Figure]]:
    """Names and figures of what there is."""
    if gauges is not None:
        yield "stress_over_gauges", over_gauges(gauges)
    for block, table in histories.items():
        yield "stress_history", history(table, block)
    for name, figure in (("damage_over_wind", over_wind(blocks)), ("damage_rose", rose(blocks))):
        if figure is not None:
            yield name, figure
    yield "measured_and_stated", measured_and_stated(spots)
