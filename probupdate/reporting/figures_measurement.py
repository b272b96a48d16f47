"""Figures of what was measured: sensors, wind and turbine state, poles, selection, frequencies by block."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import matplotlib.dates as dates
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from probupdate.modal.modes import Sensor
from probupdate.model.interface import Wireframe
from probupdate.reporting.style import (
    BLUE,
    FULL_IN,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PALE,
    PURPLE,
    RED,
    SKY,
    label_axes,
    new_figure,
    with_style,
)

# turbine state -> (colour, marker, size, filled)
STATES = {
    "idling": (BLUE, "o", 16, True),
    "below rated": (ORANGE, "^", 20, True),
    "rated": (RED, "s", 15, False),
    "unknown": (GREY, "x", 16, True),
}
MODE_MARKS = {
    "FA1": (BLUE, "o"), "SS1": (ORANGE, "s"), "T1": (GREY, "D"), "FA2": (GREEN, "^"), "SS2": (RED, "v"),
}
_OTHER_MARKS = ((BLUE, "o"), (ORANGE, "s"), (GREEN, "^"), (RED, "v"), (PURPLE, "P"), (SKY, "X"), (INK, "*"))
MANY = 2500  # markers above which a scatter becomes an image inside the figure


def mode_mark(label: str, position: int) -> tuple[str, str]:
    return MODE_MARKS.get(label) or _OTHER_MARKS[position % len(_OTHER_MARKS)]


def scatter(axes: Axes, x, y, *, color: str, marker: str, size: float, filled: bool = True, **more) -> None:
    line_only = marker in "x+|_"
    face = {"color": color} if line_only else {"facecolors": color if filled else "none", "edgecolors": color}
    width = 0.9 if line_only or not filled else 0.4
    axes.scatter(x, y, s=size, marker=marker, linewidths=width, rasterized=len(x) > MANY, **face, **more)


def _time_axis(axes: Axes) -> None:
    locator = dates.AutoDateLocator(minticks=4, maxticks=9)
    axes.xaxis.set_major_locator(locator)
    # ConciseDateFormatter asks for math text where parsing is on; it is off in this style
    axes.xaxis.set_major_formatter(dates.ConciseDateFormatter(locator))


@with_style
def sensor_layout(wire: Wireframe | None, sensors: Sequence[Sensor]) -> Figure:
    """Elevations seen along y and along x and a plan, with an arrow per channel."""
    figure = new_figure(FULL_IN, 4.6)
    left, middle, right = figure.subplots(1, 3, width_ratios=(0.8, 1.5, 1.3))
    place = np.array([s.position_m for s in sensors]).reshape(-1, 3)
    way = np.array([s.direction for s in sensors]).reshape(-1, 3)
    everything = place if wire is None else np.vstack([place, wire.node_m])
    height = float(np.ptp(everything[:, 2])) or 1.0
    views = ((left, 0, 2, "x", "z", "seen from the side"), (middle, 1, 2, "y", "z", "seen from the front"))
    for axes, a, b, name_a, name_b, title in views:
        if wire is not None:
            lines = list(wire.node_m[wire.line][:, :, [a, b]])
            axes.add_collection(LineCollection(lines, colors=PALE, lw=0.9, zorder=1))
            axes.autoscale_view()
        _arrows(axes, place[:, [a, b]], way[:, [a, b]], 0.06 * height)
        axes.set_aspect("equal", adjustable="datalim")
        label_axes(axes, f"{name_a} [m]", f"{name_b} [m]", title)
    _name_levels(middle, sensors, place, height)
    if wire is not None:
        right.add_collection(LineCollection(list(wire.node_m[wire.line][:, :, :2]), colors=PALE, lw=0.9, zorder=1))
        right.autoscale_view()
    spread = max(float(np.ptp(place[:, :2], axis=0).max()), 1.0)
    _arrows(right, place[:, :2], way[:, :2], 0.22 * spread)
    right.set_aspect("equal", adjustable="datalim")
    right.margins(0.08)
    label_axes(right, "x [m]", "y [m]", "seen from above, all levels")
    return figure


def _name_levels(axes: Axes, sensors: Sequence[Sensor], place: np.ndarray, height: float) -> None:
    """The level's name right of its sensors; levels closer than their letters are high are moved apart."""
    levels = list(dict.fromkeys(s.level for s in sensors))
    rows = {name: [k for k, s in enumerate(sensors) if s.level == name] for name in levels}
    levels.sort(key=lambda name: place[rows[name], 2].mean())
    lowest = -np.inf
    for name in levels:
        here = rows[name]
        z = max(float(place[here, 2].mean()), lowest)
        lowest = z + 0.05 * height
        axes.annotate(f"{name}: {len(here)} ch", (place[here, 1].max() + 0.07 * height, z), fontsize=7.5, va="center",
                      xytext=(6, 0), textcoords="offset points")


def _arrows(axes: Axes, place: np.ndarray, way: np.ndarray, length: float) -> None:
    axes.plot(place[:, 0], place[:, 1], "o", color=RED, ms=3.2, zorder=4)
    seen = np.linalg.norm(way, axis=1) > 0.2
    if np.any(seen):
        axes.quiver(
            place[seen, 0], place[seen, 1], way[seen, 0] * length, way[seen, 1] * length, color=RED, zorder=3,
            angles="xy", scale_units="xy", scale=1, units="inches", width=0.018, headwidth=4.5,
        )


def _project(place: np.ndarray, azimuth: float = -0.95, elevation: float = 0.2) -> np.ndarray:
    """Orthographic projection of points (..., 3) to (..., 2): right and up, both in metres."""
    right = -np.sin(azimuth) * place[..., 0] + np.cos(azimuth) * place[..., 1]
    away = np.cos(azimuth) * place[..., 0] + np.sin(azimuth) * place[..., 1]
    return np.stack([right, np.cos(elevation) * place[..., 2] - np.sin(elevation) * away], axis=-1)


def _draw_wire(axes: Axes, place: np.ndarray, line: np.ndarray, **look) -> None:
    """Lines between nodes (n_node, 2), or the nodes themselves where no line joins them."""
    if len(line):
        axes.add_collection(LineCollection(list(place[line]), **look))
    else:
        axes.plot(place[:, 0], place[:, 1], ls="none", marker="o", ms=1.8, color=look["colors"])


@with_style
def mode_shapes(
    wire: Wireframe, titles: Sequence[str], states: Mapping[str, np.ndarray], points_m: np.ndarray | None = None,
    measured: np.ndarray | None = None,
) -> Figure:
    """Fig. 3: every mode at its largest displacement, seen obliquely.

    states: "initial" and "updated" -> displacement (n_node, 3, n_mode) in metres as drawn; points_m (n_point, 3) and
    measured (n_point, 3, n_mode): sensors and their motion, in the same scale, NaN where not measured.
    """
    # one of which nothing is known is no panel
    seen = [*states.values(), *([] if measured is None else [measured])]
    shown = [j for j in range(len(titles)) if any(np.isfinite(x[:, :, j]).any() for x in seen)] or [*range(len(titles))]
    n_mode = len(shown)
    extent = np.ptp(wire.node_m, axis=0)
    wide = extent[2] < 0.5 * extent[:2].max()
    columns = min(n_mode, 2 if wide else 5)
    rows = -(-n_mode // columns)
    figure = new_figure(FULL_IN, rows * (1.9 if wide else 3.6))
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    looks = {"initial": {"colors": "#8a6d3b", "linewidths": 0.7, "linestyles": (0, (4, 2))},
             "updated": {"colors": BLUE, "linewidths": 1.0}}
    for j, axes in zip(shown, panels, strict=False):
        _draw_wire(axes, _project(wire.node_m), wire.line, colors=PALE, linewidths=0.6)
        for name, displacement in states.items():
            if np.all(np.isfinite(displacement[:, :, j])):
                drawn = _project(wire.node_m + displacement[:, :, j])
                _draw_wire(axes, drawn, wire.line, **looks[name])
        if measured is not None:
            moved = _project(points_m + measured[:, :, j])
            axes.plot(moved[:, 0], moved[:, 1], ls="none", marker="o", ms=3.6, mfc="white", mec=RED, mew=1.1)
        axes.autoscale_view()
        axes.set_aspect("equal", adjustable="box")
        axes.set_title(titles[j], fontsize=8.5)
        axes.grid(visible=False)
        label_axes(axes, "across [m]", "up [m]")
        axes.label_outer()
        axes.tick_params(labelsize=7)
    for axes in panels[n_mode:]:
        axes.remove()
    return figure


@with_style
def shapes_by_channel(
    titles: Sequence[str], measured: np.ndarray, measured_std: np.ndarray, computed: Mapping[str, np.ndarray]
) -> Figure:
    """Mode shapes channel by channel, for models without geometry: a panel a mode.

    measured, measured_std and every computed state (n_channel, n_mode), in one scale a mode; NaN where not measured.
    """
    n_channel, n_mode = measured.shape
    figure = new_figure(FULL_IN, 0.6 + 1.25 * n_mode)
    panels = figure.subplots(n_mode, 1, sharex=True, squeeze=False)[:, 0]
    number = np.arange(1, n_channel + 1)
    looks = {"initial": {"color": "#8a6d3b", "marker": "x"}, "updated": {"color": BLUE, "marker": "s", "mfc": "none"}}
    for j, axes in enumerate(panels):
        axes.axhline(0, color=GREY, lw=0.7)
        for name, shape in computed.items():
            axes.plot(number, shape[:, j], ls="none", ms=4.5, label=f"{name} model", **looks[name])
        axes.errorbar(number, measured[:, j], yerr=2 * np.nan_to_num(measured_std[:, j]), fmt="o", ms=2.6, color=RED,
                      lw=0.9, label="measured ± 2 standard deviations", zorder=1.5)
        axes.set_xlim(0, n_channel + 1)
        label_axes(axes, "channel number [-]", "shape [-]", titles[j])
        axes.label_outer()
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=3)
    return figure


@with_style
def wind_and_state(
    time, wind_mps, state: Sequence[str], *, cut_in_mps: float | None = None, rated_mps: float | None = None
) -> Figure:
    """Fig. 4: wind speed of every SCADA interval, marked by the turbine's state."""
    figure = new_figure(FULL_IN, 2.7)
    axes = figure.subplots()
    states = np.asarray(state, dtype=object)
    time, wind_mps = np.asarray(time), np.asarray(wind_mps, float)
    order = [*STATES, *sorted(set(states) - set(STATES))]
    for name in order:
        rows = states == name
        if not rows.any():
            continue
        color, marker, size, filled = STATES.get(name, STATES["unknown"])
        scatter(axes, time[rows], wind_mps[rows], color=color, marker=marker, size=size, filled=filled,
                 label=f"{name} ({rows.sum()})", zorder=3)
    for value, name in ((cut_in_mps, "cut-in"), (rated_mps, "rated")):
        if value is not None:
            axes.axhline(value, color=INK, lw=0.9, ls="--", zorder=2)
            axes.annotate(f"{name} {value:g} m/s", (1.0, value), xycoords=("axes fraction", "data"), fontsize=7.5,
                          xytext=(3, 0), textcoords="offset points", va="center", annotation_clip=False)
    _time_axis(axes)
    axes.set_ylim(bottom=0)
    label_axes(axes, "time [UTC]", "wind speed [m/s]")
    figure.legend(loc="outside upper left", ncols=4)
    return figure


@with_style
def poles(
    groups: Mapping[str, tuple[np.ndarray, np.ndarray]],
    marks: Mapping[str, tuple[str, str, float, bool]] | None = None,
    *,
    upper_hz: float = 2.5,
    harmonics_hz: Mapping[str, float] | None = None,
    title: str = "",
    width_in: float = FULL_IN,
    height_in: float = 2.7,
) -> Figure:
    """Figs. 5-7: frequency of every pole against time.

    groups: legend entry -> (time, frequency_hz); marks: entry -> (colour, marker, size, filled);
    harmonics_hz: name -> upper bound of that P-frequency, drawn dashed.
    """
    figure = new_figure(width_in, height_in)
    axes = figure.subplots()
    for k, (name, (time, frequency)) in enumerate(groups.items()):
        time, frequency = np.asarray(time), np.asarray(frequency, float)
        inside = frequency <= upper_hz
        if marks and name in marks:
            color, marker, size, filled = marks[name]
        else:
            (color, marker), size, filled = mode_mark(name, k), 9.0, True
        scatter(axes, time[inside], frequency[inside], color=color, marker=marker, size=size, filled=filled,
                 label=f"{name} ({int(inside.sum())})", zorder=3 + 0.01 * k)
    for name, value in (harmonics_hz or {}).items():
        if value < upper_hz:
            axes.axhline(value, color=INK, lw=0.8, ls="--", zorder=2)
            axes.annotate(name, (1.0, value), xycoords=("axes fraction", "data"), xytext=(3, 0), fontsize=7.5,
                          textcoords="offset points", va="center", annotation_clip=False)
    _time_axis(axes)
    axes.set_ylim(0, upper_hz)
    label_axes(axes, "start of block [UTC]", "frequency [Hz]", title)
    if groups:
        columns = min(len(groups), 6 if width_in > 6 else 3)
        figure.legend(loc="outside upper left", ncols=columns, handletextpad=0.2, columnspacing=1.2)
    return figure


@with_style
def selection_steps(names: Sequence[str], excluded: Sequence[int], total: int) -> Figure:
    """How many blocks each criterion took away, in the order in which the criteria were asked."""
    figure = new_figure(FULL_IN, 0.6 + 0.34 * (len(names) + 2))
    axes = figure.subplots()
    left = total
    rows = ["all blocks", *names, "selectable"]
    for k, name in enumerate(rows):
        if name in ("all blocks", "selectable") and k in (0, len(rows) - 1):
            axes.barh(k, left, color=BLUE, height=0.62)
            axes.annotate(str(left), (left, k), xytext=(4, 0), textcoords="offset points", va="center", fontsize=8)
            continue
        gone = int(excluded[k - 1])
        axes.barh(k, gone, left=left - gone, color="white", edgecolor=RED, hatch="////", height=0.62, lw=0.9)
        axes.barh(k, left - gone, color=PALE, height=0.62)
        axes.annotate(f"−{gone}", (left, k), xytext=(4, 0), textcoords="offset points", va="center", fontsize=8)
        left -= gone
    axes.set_yticks(range(len(rows)), rows)
    axes.invert_yaxis()
    axes.grid(axis="y", visible=False)
    axes.margins(x=0.08)
    axes.locator_params(axis="x", integer=True)
    label_axes(axes, "number of blocks", "criterion")
    return figure


@with_style
def frequencies_by_block(
    time, frequency_hz: np.ndarray, labels: Sequence[str], selected: np.ndarray,
    truth_hz: Sequence[float] | np.ndarray | None = None,
) -> Figure:
    """Identified frequency of each mode against time, one panel a mode, selected blocks filled.

    time (n_block,), frequency_hz (n_block, n_mode), selected (n_block,) bool, truth_hz (n_mode,).
    """
    n_mode = len(labels)
    figure = new_figure(FULL_IN, 0.5 + 1.05 * n_mode)
    panels = figure.subplots(n_mode, 1, sharex=True, squeeze=False)[:, 0]
    time = np.asarray(time)
    for j, axes in enumerate(panels):
        color, marker = mode_mark(labels[j], j)
        scatter(axes, time[~selected], frequency_hz[~selected, j], color=GREY, marker=marker, size=12, filled=False)
        scatter(axes, time[selected], frequency_hz[selected, j], color=color, marker=marker, size=22, zorder=4)
        if truth_hz is not None and np.isfinite(truth_hz[j]):
            axes.axhline(truth_hz[j], color=INK, lw=0.9, ls="--")
        _time_axis(axes)
        label_axes(axes, "", f"{labels[j]} [Hz]")
        axes.set_xlabel("start of block [UTC]")
        axes.label_outer()
    figure.align_ylabels(panels)
    return figure
