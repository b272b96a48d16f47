"""Figures of a diagnosis: what remains by channel, along the record and against the conditions, before and after the
findings; the causes; shifts from the prior; what would not have been detected. All take tables of diagnosis.json as
they are."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from itertools import product
from typing import TypedDict

import matplotlib.dates as dates
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.quiver import Quiver

from probupdate.diagnosis.wording import SHARES, column_words, name_of, time_profile_words
from probupdate.reporting.elements import number
from probupdate.reporting.style import (
    BLUE,
    FULL_IN,
    GREEN,
    GREY,
    HALF_IN,
    INK,
    ORANGE,
    PALE,
    PURPLE,
    RED,
    label_axes,
    new_figure,
    with_style,
)

KIND_COLOURS = {"structural": BLUE, "environmental": GREEN, "measurement": ORANGE}
# a residual of so many standard deviations has the map's full colour; from so many its number is written into its cell
FULL_COLOUR, WRITTEN = 5.0, 2.0
# bands hold 90 % when nothing is wrong
BAND = 1.645
MOST_CHANNELS, MOST_PANELS, MOST_LEVELS = 40, 14, 5
SIGNED = LinearSegmentedColormap.from_list("signed", ["#0b4f8a", "#7fb3d8", "#ffffff", "#f0a878", "#a53a00"])


class Look(TypedDict):
    color: str
    marker: str
    mfc: str


STATE_LOOKS: Mapping[str, Look] = {
    "before": {"color": GREY, "marker": "o", "mfc": "white"}, "after": {"color": BLUE, "marker": "s", "mfc": BLUE},
}


def _floats(values: Sequence) -> np.ndarray:
    return np.array([np.nan if v is None else v for v in values], float)


@with_style
def sizes_found(findings: Sequence[Mapping], hidden: Sequence[str] = ()) -> Figure:
    """What was found, where, since when and how sure: the size of every finding with its 90 % interval, from none at
    all; above, where it is known, what was hidden."""
    figure = new_figure(HALF_IN, 0.4 + 0.22 * len(hidden) + 1.25 * len(findings))
    for axes, f in zip(figure.subplots(len(findings), squeeze=False)[:, 0], findings, strict=True):
        # one draws a share in per cent
        scale = 100.0 if size_unit(f).startswith("%") else 1.0
        size = np.nan if f["size"] is None else scale * f["size"]
        axes.axvline(0, color=INK, lw=1.2)
        axes.errorbar(size, 0, xerr=BAND * scale * (f["size_std"] or 0.0), color=KIND_COLOURS[f["kind"]], fmt="s", ms=7,
                      capsize=4)
        axes.set_yticks([])
        axes.margins(x=0.25)
        label_axes(axes, f"size [{size_unit(f) or '-'}]", "finding")
        when = time_profile_words(f["time_profile"], f["since"])
        axes.set_title(f"{name_of(f)}, {when}\nprobability {f['posterior_probability']:.2f}{_gain_text(f)}", fontsize=8,
                       loc="left")
    if hidden:
        figure.suptitle("\n".join(f"hidden: {words}" for words in hidden), fontsize=8, x=0.02, ha="left")
    return figure


def _gain_text(finding: Mapping) -> str:
    """The gain on held-out blocks, where it was measured."""
    gain = finding.get("gain") or {}
    elpd, error = gain.get("heldout_elpd"), gain.get("heldout_elpd_se")
    return "" if elpd is None or error is None else f", gain on held-out blocks {elpd:+.0f} ± {error:.0f}"


@with_style
def causes(findings: Sequence[Mapping]) -> Figure:
    """Posterior over causes: of every finding its cause and the alternatives, one bar each."""
    rows = []
    for place, f in enumerate(findings, start=1):
        listed = [(f["cause"], f["location"], f["posterior_probability"], f["kind"], True)]
        listed += [(a["cause"], a["location"], a["posterior_probability"], "", False) for a in f["alternatives"][:5]]
        rows += [(f"{place}  " if row[-1] else "", *row) for row in listed]
    figure = new_figure(FULL_IN, 0.7 + 0.3 * len(rows))
    axes = figure.subplots()
    for k, (_, _, _, probability, kind, first) in enumerate(rows):
        color = KIND_COLOURS.get(kind, GREY) if first else PALE
        axes.barh(k, probability or 0.0, color=color, edgecolor=GREY, lw=0.5, height=0.66, hatch="" if first else "///")
        axes.annotate(f"{probability:.2f}", (probability, k), xytext=(4, 0), textcoords="offset points", va="center",
                      fontsize=8)
    axes.set_yticks(range(len(rows)), [f"{n}{cause}{', ' if where else ''}{where}" for n, cause, where, *_ in rows])
    axes.invert_yaxis()
    axes.set_xlim(0, 1.12)
    axes.grid(axis="y", visible=False)
    label_axes(axes, "posterior probability among competing hypotheses [-]", "cause, place")
    return figure


@with_style
def mode_residuals(rows: Sequence[Mapping], states: Sequence[str]) -> Figure:
    """What remains of ln f of every mode on average, with the band that holds 90 % when nothing is wrong."""
    figure = new_figure(FULL_IN, 0.8 + 0.32 * len(rows))
    axes = figure.subplots()
    axes.axvline(0, color=GREY, lw=0.8)
    for s, state in enumerate(states):
        y = np.arange(len(rows)) + 0.22 * (s - 0.5 * (len(states) - 1))
        value = _floats([r["percent"][s] for r in rows])
        band = BAND * _floats([r["expected_percent"][s] for r in rows])
        axes.barh(y, 2 * band, left=-band, height=0.2, color=PALE if s == 0 else "#cfe3f1", zorder=1)
        axes.plot(value, y, ls="none", ms=5, zorder=3, label=_state_words(state, states), **STATE_LOOKS[state])
    axes.set_yticks(range(len(rows)), [r["mode"] for r in rows])
    axes.invert_yaxis()
    axes.grid(axis="y", visible=False)
    label_axes(axes, "measured less model, mean over the record [% of f]", "mode")
    figure.legend(loc="outside upper left", ncols=2)
    return figure


def _state_words(state: str, states: Sequence[str]) -> str:
    if len(states) == 1:
        return "best update of the model"
    return "best update of the model as it is" if state == "before" else "with the findings taken in"


@with_style
def residual_map(rows: Sequence[Mapping], states: Sequence[str]) -> Figure:
    """Mode by channel: signed differences of shapes from the model, as multiples of what chance and tolerances
    leave; numbers are per cent of the shape's largest component."""
    channels = list(rows[0]["channels"])
    names = [f"{r['mode']}{'' if r['part'] == 'in phase' else ' i'}" for r in rows]
    z = np.array([[_floats(r["z"][s]) for r in rows] for s in range(len(states))])
    percent = np.array([[_floats(r["percent"][s]) for r in rows] for s in range(len(states))])
    shown = np.arange(len(channels))
    if len(channels) > MOST_CHANNELS:
        shown = np.sort(np.argsort(-np.nanmax(np.abs(z), axis=(0, 1)))[:MOST_CHANNELS])
    figure = new_figure(FULL_IN, 1.1 + 0.19 * len(shown))
    panels = figure.subplots(1, len(states), sharey=True, squeeze=False)[0]
    maps = []
    for s, axes in enumerate(panels):
        maps.append(_residual_cells(axes, z[s][:, shown].T, percent[s][:, shown].T))
        axes.set_xticks(range(len(rows)), names, rotation=90, fontsize=7)
        axes.set_yticks(range(len(shown)), [channels[k] for k in shown], fontsize=7)
        axes.grid(visible=False)
        label_axes(axes, "mode (i: out of phase)", "channel", _state_words(states[s], states))
        axes.label_outer()
    bar = figure.colorbar(maps[-1], ax=panels, shrink=0.7, pad=0.01, extend="both")
    bar.set_label("residual [std]", fontsize=8)
    bar.outline.set_linewidth(0.5)
    return figure


def _residual_cells(axes: Axes, z: np.ndarray, percent: np.ndarray) -> AxesImage:
    """Cells (n_channel, n_mode) coloured by their score, with the number in per cent where it is far off."""
    drawn = axes.imshow(z, cmap=SIGNED, norm=Normalize(-FULL_COLOUR, FULL_COLOUR), aspect="auto",
                        interpolation="nearest")
    for i, j in np.ndindex(z.shape):
        if abs(z[i, j]) >= WRITTEN:
            axes.text(j, i, f"{percent[i, j]:.0f}" if abs(percent[i, j]) >= 9.5 else f"{percent[i, j]:.1f}",
                      ha="center", va="center", fontsize=5.5,
                      color="white" if abs(z[i, j]) > 0.8 * FULL_COLOUR else INK)
    return drawn


@with_style
def residual_layout(sensors: Sequence[Mapping], rows: Sequence[Mapping], states: Sequence[str]) -> Figure:
    """Where shapes differ from the model's: every level seen from above, an arrow a channel (a ring where it looks up),
    coloured by its residual in the mode in which it differs most; those far off are named."""
    channels = list(rows[0]["channels"])
    z = np.array([[_floats(r["z"][s]) for r in rows] for s in range(len(states))])
    worst = np.take_along_axis(z, np.argmax(np.abs(np.nan_to_num(z)), axis=1)[:, None], axis=1)[:, 0]
    levels = sorted({s["level"] for s in sensors}, key=lambda n: -max(
        s["position_m"][2] for s in sensors if s["level"] == n))[:MOST_LEVELS]
    figure = new_figure(FULL_IN, 0.5 + 1.75 * len(states))
    panels = figure.subplots(len(states), len(levels), squeeze=False)
    scale = Normalize(-FULL_COLOUR, FULL_COLOUR)
    arrows = []
    for s, k in product(range(len(states)), range(len(levels))):
        axes = panels[s, k]
        here = [x for x in sensors if x["level"] == levels[k]]
        arrows.append(_level_from_above(axes, here, worst[s][[channels.index(x["channel"]) for x in here]], scale))
        if k == 0 and len(states) > 1:
            axes.set_ylabel(f"{states[s]} the findings\ny [m]")
        if s + 1 < len(states):
            axes.set_xlabel("")
    bar = figure.colorbar(arrows[-1], ax=panels, shrink=0.8, pad=0.01, extend="both")
    bar.set_label("largest over modes [standard deviations]", fontsize=8)
    return figure


def _level_from_above(axes: Axes, sensors: Sequence[Mapping], value: np.ndarray, scale: Normalize) -> Quiver:
    """The sensors of one level with their residuals (n_sensor,); returns the arrows."""
    place, way = (np.array([x[key] for x in sensors], float) for key in ("position_m", "direction"))
    centre = place[:, :2].mean(axis=0)
    reach = 1.25 * max(float(np.abs(place[:, :2] - centre).max()), 1.0)
    flat = np.hypot(way[:, 0], way[:, 1]) > 0.3
    drawn = axes.quiver(place[flat, 0], place[flat, 1], way[flat, 0], way[flat, 1], value[flat], cmap=SIGNED,
                        norm=scale, angles="xy", scale_units="xy", scale=1.6 / reach, units="inches", width=0.05,
                        edgecolor=INK, linewidth=0.4, zorder=3)
    axes.scatter(place[~flat, 0], place[~flat, 1], c=value[~flat], cmap=SIGNED, norm=scale, s=42, edgecolors=INK,
                 linewidths=0.5, zorder=4)
    for x, v, at, to in zip(sensors, value, place, way, strict=True):
        if abs(v) > 1.5 * WRITTEN:
            axes.annotate(x["channel"], (at + 0.6 * reach * to)[:2], fontsize=6.5, zorder=5, ha="center",
                          xytext=(0, 4), textcoords="offset points")
    axes.set_xlim(centre[0] - 1.7 * reach, centre[0] + 1.9 * reach)
    axes.set_ylim(centre[1] - 1.7 * reach, centre[1] + 1.9 * reach)
    axes.set_aspect("equal", adjustable="box")
    axes.tick_params(labelsize=7)
    label_axes(axes, "x [m]", "y [m]", f"{sensors[0]['level']}\nz = {place[:, 2].mean():.0f} m")
    axes.title.set_fontsize(8)
    return drawn


# Along the record ---------------------------------------------------------------------------------------------------


def _times(start: str, hours: Sequence) -> np.ndarray | None:
    """Moments, or None where the record has no times."""
    try:
        first = np.datetime64(start.removesuffix("Z").removesuffix("+00:00"), "s")
    except ValueError:
        return None
    return first + (np.array(hours, float) * 3600).astype("timedelta64[s]")


def _draw_time_axis(axes: Axes, start: str, hours: Sequence, since: Sequence[str]) -> np.ndarray:
    """The panel's horizontal axis and the steps on it; returns where to draw."""
    times = _times(start, hours)
    if times is None:
        axes.set_xlabel("place in the record [h]")
        return np.array(hours, float)
    locator = dates.AutoDateLocator(minticks=3, maxticks=6)
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(dates.ConciseDateFormatter(locator))
    axes.set_xlabel("start of block [UTC]")
    for moment in since:
        at = _times(moment, [0.0])
        if at is not None:
            axes.axvline(at[0], color=RED, lw=1.0, ls="--", zorder=2)
    return times


def _state_points(axes: Axes, x, series: Mapping, states: Sequence[str]) -> None:
    band = BAND * _floats(series["expected_percent"])
    order = np.argsort(x)
    axes.fill_between(np.asarray(x)[order], -band[order], band[order], color=PALE, alpha=0.6, lw=0, zorder=1)
    for s, state in enumerate(states):
        look = STATE_LOOKS[state]
        axes.plot(x, _floats(series["percent"][s]), ls="none", ms=2.8 if state == "before" else 2.2, mew=0.7,
                  zorder=3 + s, rasterized=len(x) > 300, **look)


@with_style
def calendar(time: Mapping, states: Sequence[str], since: Sequence[str]) -> Figure:
    """What remains block by block about its mean: first the size of each finding as every block alone gives it, then
    frequencies and the parts of shapes that move most. Dashed: where a finding begins."""
    sizes = list(time.get("sizes", ()))
    series = list(time["series"])[: MOST_PANELS - len(sizes)]
    columns = 1 if len(sizes) + len(series) < 4 else 2
    rows = -(-len(series) // columns)
    figure = new_figure(FULL_IN, 0.5 + 1.5 * len(sizes) + 1.15 * rows)
    grid = figure.add_gridspec(len(sizes) + rows, columns, height_ratios=[1.3] * len(sizes) + [1.0] * rows)
    for k, size in enumerate(sizes):
        axes = figure.add_subplot(grid[k, :])
        if size["against"]:
            x = np.array(size["against"], float)
            axes.set_xlabel(f"{column_words(size['time_profile_name'])} [{size['against_unit']}]")
        else:
            x = _draw_time_axis(axes, time["start"], size["hours"], since)
        axes.errorbar(x, _floats(size["size"]), yerr=BAND * _floats(size["size_std"]), fmt="o", ms=2.5, color=GREY,
                      lw=0.6, zorder=2)
        order = np.argsort(x)
        axes.plot(np.asarray(x)[order], _floats(size["time_profile"])[order], color=RED, lw=1.5, zorder=4,
                  drawstyle="steps-post" if size["time_profile_name"] == "step" else "default")
        where = f", {size['location']}" if size["location"] else ""
        label_axes(axes, axes.get_xlabel(), f"size [{size['unit']}]", f"{size['cause']}{where}: each block alone, and "
                   "as found (red)")
    panels = [figure.add_subplot(grid[len(sizes) + k // columns, k % columns]) for k in range(len(series))]
    for axes, one in zip(panels, series, strict=True):
        x = _draw_time_axis(axes, time["start"], time["hours"], since)
        _state_points(axes, x, one, states)
        shape = one["moved_z"] is not None
        label_axes(axes, axes.get_xlabel(), "[% of largest]" if shape else "f [%]", one["name"])
        axes.title.set_fontsize(8)
    for k, axes in enumerate(panels):
        if k + columns < len(panels):
            axes.set_xlabel("")
            axes.tick_params(labelbottom=False)
    return figure


@with_style
def against_covariates(
    tables: Sequence[Mapping], states: Sequence[str], explained: Sequence[str] = ()
) -> Figure:
    """Frequencies in bins of what was measured beside them, about their mean: of each covariate the mode that follows
    it most, before the findings where one of them has the covariate as its time profile (`explained`), after them
    else."""
    columns = min(3, len(tables))
    rows = -(-len(tables) // columns)
    figure = new_figure(FULL_IN, 0.4 + 1.9 * rows)
    panels = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for axes, table in zip(panels, tables, strict=False):
        # what a finding has explained is seen before, what is left, after
        state = 0 if table["column"] in explained else -1
        best = max(table["series"], key=lambda s: abs(s["slope_z"][state] or 0.0))
        axes.axhline(0, color=GREY, lw=0.7)
        _state_points(axes, np.array(table["centre"], float), best, states)
        listed = " → ".join(f"{z:+.1f}" for z in best["slope_z"] if z is not None)
        label_axes(axes, f"{column_words(table['column'])} [{table['unit']}]", "f [%]",
                   f"{best['name']}\nslope: z {listed}")
        axes.title.set_fontsize(8)
    for axes in panels[len(tables) :]:
        axes.remove()
    return figure


# Shifts from the prior, and what is not detected --------------------------------------------------------------------


@with_style
def prior_shifts(rows: Sequence[Mapping], states: Sequence[str]) -> Figure:
    """Every parameter's standardised shift, and the band in which the prior expects it with these data."""
    figure = new_figure(FULL_IN, 0.8 + 0.27 * len(rows))
    axes = figure.subplots()
    axes.axvline(0, color=GREY, lw=0.8)
    y = np.arange(len(rows))
    band = BAND * _floats([r["expected"][0] for r in rows])
    axes.barh(y, 2 * band, left=-band, height=0.62, color=PALE, alpha=0.7, zorder=1)
    listed = [_floats([r["prior_shift"][s] for r in rows]) for s in range(len(states))]
    if len(listed) == 2:
        axes.hlines(y, listed[0], listed[1], color=GREY, lw=0.8, zorder=2)
    for state, value in zip(states, listed, strict=True):
        axes.plot(value, y, ls="none", ms=5, zorder=3, label=_state_words(state, states), **STATE_LOOKS[state])
    axes.set_yticks(y, [r["name"] for r in rows])
    axes.invert_yaxis()
    axes.grid(axis="y", visible=False)
    label_axes(axes, "standardised shift [prior standard deviations]", "parameter")
    figure.legend(loc="outside upper left", ncols=2)
    return figure


def row_of(entry: Mapping) -> Hashable:
    """Which row of the catalogue an entry of detectable_sizes is of; by its words in files of before."""
    return entry.get("row") if entry.get("row") is not None else (entry["cause"], entry["location"])


@with_style
def detectable_sizes(entries: Sequence[Mapping], steps: Mapping[Hashable, float]) -> Figure:
    """Least size that this record excludes, a panel for each kind and unit; open marks: as a step within the record,
    which is seen far better. limits: rows of diagnosis.json in the order to be drawn; steps: `row_of` one -> size of
    a step."""
    groups: dict[tuple[str, str], list[Mapping]] = {}
    for kind in KIND_COLOURS:
        for x in entries:
            if x["kind"] == kind:
                groups.setdefault((kind, size_unit(x)), []).append(x)
    counts = [len(rows) for rows in groups.values()]
    figure = new_figure(FULL_IN, 0.7 + 0.21 * sum(counts) + 0.62 * len(groups))
    panels = np.atleast_1d(figure.subplots(len(groups), 1, height_ratios=[c + 0.4 for c in counts], squeeze=True))
    before = ""
    for axes, ((kind, unit), rows) in zip(panels, groups.items(), strict=True):
        scale = 100.0 if unit.startswith("%") else 1.0
        values = scale * np.array([abs(x["size"]) for x in rows])
        inside = scale * np.abs(np.array([steps.get(row_of(x), np.nan) for x in rows], float))
        low = np.nanmin(np.concatenate([values, inside])) / 2
        axes.barh(range(len(rows)), values - low, left=low, color=KIND_COLOURS[kind], height=0.6, alpha=0.85)
        axes.plot(inside, range(len(rows)), ls="none", marker="D", ms=3.5, mfc="white", mec=PURPLE, zorder=3)
        axes.set_xscale("log")
        axes.set_xlim(low, np.nanmax(np.concatenate([values, inside])) * 6)
        for k, x in enumerate(rows):
            axes.annotate(size_text(x), (values[k], k), xytext=(4, 0), fontsize=7, va="center",
                          textcoords="offset points")
        axes.set_yticks(range(len(rows)), [f"{x['cause']}{', ' if x['location'] else ''}{x['location']}" for x in rows],
                        fontsize=7)
        axes.set_ylim(len(rows) - 0.5, -0.5)
        axes.grid(axis="y", visible=False)
        axes.minorticks_off()
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        label_axes(axes, f"[{unit or '-'}]", "candidate", kind if kind != before else "")
        before = kind
    return figure


def size_unit(entry: Mapping) -> str:
    """The unit of a size as it is drawn: "%" of a share, "" of a number without one."""
    unit = entry["unit"]
    if entry["cause"] in SHARES and unit.startswith("-"):
        return f"%{unit[1:]}"
    return unit.removeprefix("-").strip()


def size_text(entry: Mapping) -> str:
    """"2.1 m", "56 %", "2.9 × 10⁶ kg m2"."""
    value, unit = abs(entry["size"]), entry["unit"]
    if entry["cause"] in SHARES and unit.startswith("-"):
        return f"{number(100 * value, 2)} %{unit[1:]}"
    text = number(value, 2)
    return f"{text} {unit.removeprefix('-').strip()}".strip()
