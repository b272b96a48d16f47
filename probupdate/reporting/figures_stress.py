"""Figures of stresses from measured motion: history, damage over wind and direction, life with it and without."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

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
    with_style,
)

COLOURS = (BLUE, ORANGE, GREEN, RED, PURPLE, GREY)
MARKERS = "os^vDP"
# hot spots that are drawn by name
SHOWN = 3
SECTORS = 12
# of a history that is laid over a gauge's
MINUTES_S = 600.0


@with_style
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


@with_style
def stress_over_gauges(table: pd.DataFrame, block: str) -> Figure:
    """Estimated stress over what strain gauges measured, ten minutes of a block. table: time_s, and of each gauge
    hot_spot_N_mpa and hot_spot_N_estimated_mpa."""
    some = table[table["time_s"] <= table["time_s"].iloc[0] + MINUTES_S]
    names = [c.removesuffix("_estimated_mpa") for c in table if c.endswith("_estimated_mpa")][:SHOWN]
    figure = new_figure(FULL_IN, 1.4 * len(names) + 0.6)
    axes = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    for axis, name in zip(axes, names, strict=True):
        axis.plot(some["time_s"] / 60, some[f"{name}_mpa"], color=GREY, linewidth=1.4, label="gauge")
        axis.plot(some["time_s"] / 60, some[f"{name}_estimated_mpa"], color=BLUE, linewidth=0.7, label="estimate")
        label_axes(axis, f"minutes from {block}" if axis is axes[-1] else "", f"spot {name.split('_')[2]} [MPa]")
    axes[0].legend(frameon=False, fontsize="small", ncols=2)
    return figure


@with_style
def damage_over_wind(blocks: pd.DataFrame) -> Figure | None:
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


@with_style
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


@with_style
def life(spots: pd.DataFrame) -> Figure:
    """Years to a Miner's sum of one with the measured months, with intervals, and without them, by the stated loads;
    the worst spot of each side."""
    own = spots[spots["p05"] > 0].drop_duplicates(["member", "side"]).head(12)
    figure = new_figure(FULL_IN, 3.2)
    axis = figure.subplots()
    at = np.arange(len(own))
    middle, early, late = (1 / own[name].to_numpy(float) for name in ("p50", "p95", "p05"))
    axis.errorbar(at, middle, yerr=[middle - early, late - middle], fmt="o", color=BLUE, capsize=2,
                  label="with the measured motion, 90 % interval")
    stated = own["stated_damage_per_year"].to_numpy(float)
    axis.scatter(at[stated > 0], 1 / stated[stated > 0], marker="D", color=GREY, label="without, by stated loads",
                 zorder=3)
    axis.set_yscale("log")
    axis.set_xticks(at, [f"{m}\n{s}" for m, s in zip(own["member"], own["side"], strict=True)], rotation=60,
                    ha="right", fontsize=6)
    label_axes(axis, "hot spot, the worst of each side", "life [a]")
    axis.legend(frameon=False, fontsize="small")
    return figure


def stress_figures(
    spots: pd.DataFrame, blocks: pd.DataFrame, histories: dict[str, pd.DataFrame],
    gauges: tuple[str, pd.DataFrame] | None = None,
) -> Iterator[tuple[str, Figure, str]]:
    """Names, figures and captions of what there is. histories: table by block; gauges: block and table."""
    if gauges is not None:
        yield ("stress_over_gauges", stress_over_gauges(gauges[1], gauges[0]),
               "Stress from the measured motion over strain gauges', ten minutes.")
    for block, table in histories.items():
        yield ("stress_history", history(table, block),
               "Stress of the worst hot spots in the block that did most damage.")
    for name, figure, caption in (
        ("damage_over_wind", damage_over_wind(blocks),
         "Damage of an hour at the worst hot spot over the wind, by state."),
        ("damage_rose", rose(blocks), "Share of the worst hot spot's damage by nacelle heading.")):
        if figure is not None:
            yield name, figure, caption
    yield ("life", life(spots),
           "Life with and without the measured motion: years to a Miner's sum of one, of the measured states alone.")
