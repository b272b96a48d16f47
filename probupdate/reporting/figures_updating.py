"""Figures of the update and of the posterior: history, marginals, corner, correlation, contraction, predictions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator
from scipy import stats

from probupdate.parameters import Parameter
from probupdate.reporting.style import (
    BLUE,
    FULL_IN,
    GREEN,
    GREY,
    GRID,
    HALF_IN,
    INK,
    MAP,
    MEASURED,
    ORANGE,
    PALE,
    POSTERIOR,
    PRIOR,
    PRIOR_UPDATE,
    PURPLE,
    RED,
    SKY,
    STEP_UPDATE,
    label_axes,
    new_figure,
    styled,
)

_LINES = ("-", (0, (5, 2)), (0, (1, 1)), (0, (5, 1, 1, 1)), (0, (3, 1, 1, 1, 1, 1)))
_COLORS = (BLUE, ORANGE, GREEN, RED, PURPLE, SKY, INK, GREY)
_MARKERS = ("o", "s", "^", "v", "D", "P", "X", "*")


@dataclass(frozen=True, kw_only=True)
class Mark:
    """A point estimate to be drawn: its name in legends, theta (n_param,), and a role of style.py."""

    name: str
    theta: np.ndarray
    role: Mapping


def _size(mark: Mark) -> float:
    """A star's area is small for its width."""
    return 9.0 if mark.role["marker"] == "*" else 6.0


def unit_label(name: str, unit: str) -> str:
    return f"{name} [{unit or '-'}]"


def _plain(value: float, _position: int | None = None) -> str:
    return f"{value:g}".replace("-", "−")


@styled
def frequency_errors(labels: Sequence[str], measured_hz, computed_hz: Mapping[str, Sequence[float]]) -> Figure:
    """Computed over measured frequency minus one, in per cent, for each mode and each state of the model."""
    figure = new_figure(FULL_IN, 0.9 + 0.36 * len(labels))
    axes = figure.subplots()
    measured_hz = np.asarray(measured_hz, float)
    roles = (PRIOR, STEP_UPDATE, PRIOR_UPDATE, MAP, POSTERIOR)
    rows = np.arange(len(labels))
    axes.axvline(0, color=INK, lw=1.2, zorder=2)
    for k, (name, values) in enumerate(computed_hz.items()):
        role = roles[k % len(roles)]
        error = 100 * (np.asarray(values, float) / measured_hz - 1)
        offset = 0.16 * (k - 0.5 * (len(computed_hz) - 1))
        axes.hlines(rows + offset, 0, error, color=role["color"], lw=1.2, alpha=0.6)
        axes.plot(error, rows + offset, ls="none", color=role["color"], marker=role["marker"], ms=5.5, label=name)
    axes.set_yticks(rows, labels)
    axes.set_ylim(len(labels) - 0.5, -0.5)
    axes.xaxis.set_major_formatter(FuncFormatter(_plain))
    axes.grid(axis="y", visible=False)
    label_axes(axes, "computed frequency minus measured [% of measured]", "mode")
    figure.legend(loc="outside upper left", ncols=5)
    return figure


@styled
def departures(parameters: Sequence[Parameter], draws: np.ndarray | None, marks: Sequence[Mark]) -> Figure:
    """Every parameter's estimates and posterior on one scale: departure from the initial value in prior deviations."""
    figure = new_figure(FULL_IN, 0.9 + 0.32 * len(parameters))
    axes = figure.subplots()
    initial = np.array([p.initial for p in parameters])
    std = np.array([p.std for p in parameters])
    rows = np.arange(len(parameters))
    axes.barh(rows, 2.0, left=-1.0, height=0.62, color=GRID, label="prior, ± 1 deviation", zorder=1)
    if draws is not None:
        low5, low25, middle, high75, high95 = np.percentile((draws - initial) / std, [5, 25, 50, 75, 95], axis=0)
        axes.hlines(rows, low5, high95, color=BLUE, lw=1.4, zorder=3)
        axes.hlines(rows, low25, high75, color=BLUE, lw=5.0, alpha=0.55, zorder=3, label="posterior, 50 % and 90 %")
        axes.plot(middle, rows, ls="none", marker="|", color=INK, ms=8, mew=1.4, zorder=4, label="median")
    for order, mark in enumerate(marks):
        offset = 0.17 * (order - 0.5 * (len(marks) - 1))
        axes.plot((mark.theta - initial) / std, rows + offset, ls="none", color=mark.role["color"], mec="white",
                  mew=0.4, ms=_size(mark), marker=mark.role["marker"], zorder=5, label=mark.name)
    axes.axvline(0, color=INK, lw=0.9, zorder=2)
    axes.set_yticks(rows, [p.name for p in parameters])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.grid(axis="y", visible=False)
    axes.xaxis.set_major_formatter(FuncFormatter(_plain))
    label_axes(axes, "departure from the initial value [prior deviations]", "parameter")
    figure.legend(loc="outside upper left", ncols=3, columnspacing=1.2)
    return figure


@styled
def update_history(
    objective: Mapping[str, Mapping[str, np.ndarray]], theta: Mapping[str, np.ndarray], names: Sequence[str],
    initial: np.ndarray, distance: Mapping[str, np.ndarray],
) -> Figure:
    """What each iteration did, a column per scheme: terms of J, parameters over their initial values, distance to the
    posterior's maximum.

    objective: scheme -> term -> (n_iteration + 1,); theta: scheme -> (n_iteration + 1, n_param); distance: scheme ->
    (n_iteration + 1,). Where an initial value is zero the parameter itself is drawn.
    """
    schemes = list(theta)
    figure = new_figure(FULL_IN, 6.6)
    panels = figure.subplots(3, len(schemes), squeeze=False, sharex="col", sharey="row", height_ratios=(1, 1.1, 0.7))
    scale = np.where(initial == 0, 1.0, initial)
    relative = "relative change [-]" if np.all(initial == 0) else "value over initial [-]"
    roles = {"responses": BLUE, "parameters": ORANGE, "total": INK}
    styles = {"responses": "-", "parameters": (0, (4, 2)), "total": (0, (1, 1))}
    for column, scheme in enumerate(schemes):
        top, middle, bottom = panels[:, column]
        for k, (term, values) in enumerate(objective.get(scheme, {}).items()):
            # the parameters' term is zero at the start: no point on a logarithmic axis
            shown = np.where(np.asarray(values) > 0, values, np.nan)
            top.plot(np.arange(len(values)), shown, color=roles.get(term, _COLORS[k]),
                     ls=styles.get(term, _LINES[k % 5]), marker=_MARKERS[k], ms=3.5,
                     markevery=max(len(shown) // 10, 1), label=term)
        top.set_yscale("log")
        top.yaxis.set_major_formatter(FuncFormatter(_plain))
        top.yaxis.set_minor_formatter(FuncFormatter(lambda *_: ""))
        for k, name in enumerate(names):
            path = theta[scheme][:, k] / scale[k]
            middle.plot(np.arange(len(path)), path, color=_COLORS[k % 8], ls=_LINES[(k // 8 + k) % 5],
                        marker=_MARKERS[k % 8], ms=3.5, markevery=max(len(path) // 10, 1), label=name)
        apart = np.maximum(distance[scheme], 1e-3)
        bottom.plot(np.arange(len(apart)), apart, color=INK, marker="o", ms=3.5, markevery=max(len(apart) // 10, 1))
        bottom.set_yscale("log")
        bottom.yaxis.set_major_formatter(FuncFormatter(_plain))
        bottom.yaxis.set_minor_formatter(FuncFormatter(lambda *_: ""))
        bottom.xaxis.set_major_locator(MaxNLocator(integer=True))
        label_axes(top, "", "J [-]" if column == 0 else "", scheme)
        label_axes(middle, "", relative if column == 0 else "")
        label_axes(bottom, "iteration", "distance to MAP\n[post. deviations]" if column == 0 else "")
    handles, labels = panels[1, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right lower", fontsize=7.5)
    if objective:
        handles, labels = panels[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside right upper", title="terms of J", title_fontsize=8)
    return figure


def _span(parameter: Parameter, draws: np.ndarray, marks: Sequence[float]) -> tuple[float, float]:
    low, high = np.percentile(draws, [0.2, 99.8])
    prior = parameter.distribution
    low, high = min(low, float(prior.ppf(0.02))), max(high, float(prior.ppf(0.98)))
    finite = [m for m in marks if np.isfinite(m)]
    low, high = min([low, *finite]), max([high, *finite])
    room = 0.03 * (high - low)
    return max(low - room, parameter.lower - room), min(high + room, parameter.upper + room)


@styled
def marginals(parameters: Sequence[Parameter], draws: np.ndarray, marks: Sequence[Mark]) -> Figure:
    """Posterior histogram (n_draw, n_param), prior density and point estimates, one panel a parameter."""
    columns = 4 if len(parameters) > 6 else 3
    rows = -(-len(parameters) // columns)
    figure = new_figure(FULL_IN, 0.5 + 1.55 * rows)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for k, (parameter, axes) in enumerate(zip(parameters, panels, strict=False)):
        low, high = _span(parameter, draws[:, k], [m.theta[k] for m in marks])
        grid = np.linspace(low, high, 300)
        heights, edges = np.histogram(draws[:, k], bins=36, range=(low, high), density=True)
        axes.stairs(heights, edges, fill=True, color=POSTERIOR["color"], alpha=0.30, label="posterior")
        axes.stairs(heights, edges, color=POSTERIOR["color"], lw=1.0)
        inside = (grid >= parameter.lower) & (grid <= parameter.upper)
        density = np.where(inside, np.exp(parameter.distribution.logpdf(np.where(inside, grid, parameter.initial))), 0)
        axes.plot(grid, density, color=PRIOR["color"], ls=PRIOR["linestyle"], lw=1.2, label="prior")
        top = 1.32 * max(heights.max(), density.max())
        for order, mark in enumerate(marks):
            axes.plot([mark.theta[k]] * 2, [0, (0.99 - 0.075 * order) * top], color=mark.role["color"],
                      ls=mark.role["linestyle"], lw=1.3, marker=mark.role["marker"], ms=4.5, markevery=[1],
                      label=mark.name)
        for bound in (parameter.lower, parameter.upper):
            if low <= bound <= high:
                outside = (low, bound) if bound == parameter.lower else (bound, high)
                axes.axvspan(*outside, color=PALE, alpha=0.6, lw=0)
        axes.set_ylim(0, 1.04 * top)
        axes.set_xlim(low, high)
        axes.set_yticks([])
        axes.grid(visible=False)
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.xaxis.set_major_formatter(FuncFormatter(_plain))
        label_axes(axes, unit_label(parameter.name, parameter.unit), "density" if k % columns == 0 else "")
    for axes in panels[len(parameters):]:
        axes.remove()
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=min(len(labels), 5), columnspacing=1.2)
    return figure


def most_correlated(draws: np.ndarray, count: int) -> list[int]:
    """Positions, ascending, of the `count` parameters that take part in the strongest correlations."""
    n = draws.shape[1]
    correlation = np.abs(np.corrcoef(draws.T)) if n > 1 else np.ones((1, 1))
    np.fill_diagonal(correlation, 0)
    chosen: list[int] = []
    for flat in np.argsort(-np.triu(correlation), axis=None, kind="stable"):
        for k in divmod(int(flat), n):
            if k not in chosen and len(chosen) < min(count, n):
                chosen.append(k)
        if len(chosen) >= min(count, n):
            break
    return sorted(chosen)


@styled
def corner(names: Sequence[str], units: Sequence[str], draws: np.ndarray, marks: Sequence[Mark]) -> Figure:
    """Histograms and pairs of the given parameters (n_draw, n): contours hold 39, 68 and 90 % of the draws."""
    n = len(names)
    figure = new_figure(FULL_IN, 7.2)
    panels = figure.subplots(n, n, squeeze=False, sharex="col")
    low, high = np.percentile(draws, [0.3, 99.7], axis=0)
    for i in range(n):
        for j in range(n):
            axes = panels[i, j]
            if j > i:
                axes.remove()
                continue
            if i == j:
                heights, edges = np.histogram(draws[:, i], bins=34, range=(low[i], high[i]), density=True)
                axes.stairs(heights, edges, fill=True, color=BLUE, alpha=0.3)
                axes.stairs(heights, edges, color=BLUE, lw=1.0)
                axes.set_yticks([])
                axes.grid(visible=False)
            else:
                _pair(axes, draws[:, j], draws[:, i], (low[j], high[j]), (low[i], high[i]))
                for mark in marks:
                    axes.plot(mark.theta[j], mark.theta[i], ls="none", color=mark.role["color"],
                              marker=mark.role["marker"], ms=_size(mark), mec="white", mew=0.5, label=mark.name)
                axes.set_ylim(low[i], high[i])
                axes.yaxis.set_major_locator(MaxNLocator(3, prune="both"))
                axes.yaxis.set_major_formatter(FuncFormatter(_plain))
            axes.set_xlim(low[j], high[j])
            axes.xaxis.set_major_locator(MaxNLocator(3, prune="both"))
            axes.xaxis.set_major_formatter(FuncFormatter(_plain))
            label_axes(axes, unit_label(names[j], units[j]), "density" if i == j else unit_label(names[i], units[i]))
            axes.tick_params(labelsize=7)
            if i < n - 1:
                axes.tick_params(labelbottom=False)
            axes.label_outer(remove_inner_ticks=False)
            if i == j and j > 0:
                axes.set_ylabel("density", fontsize=7)
    if n > 1 and marks:
        handles, labels = panels[1, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="upper right")
    return figure


def _pair(axes: Axes, x: np.ndarray, y: np.ndarray, span_x: tuple, span_y: tuple) -> None:
    counts, edges_x, edges_y = np.histogram2d(x, y, bins=26, range=(span_x, span_y))
    # a light smoothing so that contours of a finite sample can be read
    kernel = stats.norm.pdf(np.arange(-3, 4), scale=1.0)
    kernel /= kernel.sum()
    smooth = np.apply_along_axis(np.convolve, 0, np.pad(counts, 3, mode="edge"), kernel, "valid")
    smooth = np.apply_along_axis(np.convolve, 1, smooth, kernel, "valid")
    ordered = np.sort(smooth.ravel())[::-1]
    share = np.cumsum(ordered) / ordered.sum()
    levels = sorted({float(ordered[np.searchsorted(share, q)]) for q in (0.90, 0.68, 0.39)})
    if len(levels) < 2:
        axes.plot(x[:: max(len(x) // 500, 1)], y[:: max(len(x) // 500, 1)], ".", color=BLUE, ms=1)
        return
    centre_x, centre_y = 0.5 * (edges_x[1:] + edges_x[:-1]), 0.5 * (edges_y[1:] + edges_y[:-1])
    shades = ("#dbe9f4", "#9cc7e4", "#4d97c9")[-len(levels):]
    axes.contourf(centre_x, centre_y, smooth.T, levels=[*levels, ordered[0] * 1.001 + 1e-12], colors=shades)
    axes.contour(centre_x, centre_y, smooth.T, levels=levels, colors=BLUE, linewidths=0.7)


@styled
def correlation_map(names: Sequence[str], correlation: np.ndarray) -> Figure:
    """Posterior correlation (n_param, n_param): numbers in every cell, so that a grey print can be read."""
    n = len(names)
    side = min(max(0.30 * n + 1.1, HALF_IN), FULL_IN)
    figure = new_figure(side, 0.92 * side)
    axes = figure.subplots()
    image = axes.imshow(correlation, cmap="RdBu_r", vmin=-1, vmax=1)
    for i in range(n):
        for j in range(n):
            value = correlation[i, j]
            if i != j and abs(value) >= 0.005:
                text = f"{value:.2f}".replace("0.", ".").replace("-", "−")
                axes.text(j, i, text, ha="center", va="center", fontsize=6.5,
                          color="white" if abs(value) > 0.6 else INK)
    axes.set_xticks(range(n), names, rotation=60 if n > 6 else 0, ha="right" if n > 6 else "center")
    axes.set_yticks(range(n), names)
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)
    label_axes(axes, "parameter", "parameter")
    bar = figure.colorbar(image, ax=axes, shrink=0.8)
    bar.set_label("posterior correlation [-]")
    return figure


@styled
def contraction(names: Sequence[str], ratio: Sequence[float], *, informed_below: float, strong_below: float) -> Figure:
    """Posterior over prior standard deviation of each parameter: short bars were learned from the data."""
    order = np.argsort(np.asarray(ratio, float), kind="stable")
    figure = new_figure(HALF_IN, 0.8 + 0.24 * len(names))
    axes = figure.subplots()
    for row, k in enumerate(order):
        value = ratio[k]
        strong, informed = value < strong_below, value < informed_below
        face = BLUE if strong else (SKY if informed else "white")
        axes.barh(row, value, height=0.66, color=face, edgecolor=BLUE if informed else GREY, lw=0.9,
                  hatch="" if strong else ("///" if informed else "..."))
        axes.annotate(f"{value:.2f}", (value, row), xytext=(4, 0), textcoords="offset points", va="center", fontsize=8,
                      bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6})
    axes.axvline(1, color=INK, lw=1.0, ls="--")
    axes.set_yticks(range(len(order)), [names[k] for k in order])
    axes.invert_yaxis()
    axes.grid(axis="y", visible=False)
    axes.set_xlim(0, max(1.12, 1.08 * float(np.max(ratio))))
    label_axes(axes, "posterior over prior standard deviation [-]", "parameter")
    return figure


@styled
def predictive_frequencies(
    labels: Sequence[str], measured_hz: np.ndarray, measured_std_hz: np.ndarray, predicted_hz: np.ndarray,
    initial_hz: np.ndarray | None = None,
) -> Figure:
    """Posterior draws of computed frequencies (n_draw, n_mode) against the measured ones, in per cent of these."""
    figure = new_figure(FULL_IN, 0.9 + 0.42 * len(labels))
    axes = figure.subplots()
    rows = np.arange(len(labels))
    relative = 100 * (predicted_hz / measured_hz - 1)
    low5, low25, middle, high75, high95 = np.percentile(relative, [5, 25, 50, 75, 95], axis=0)
    std = 100 * measured_std_hz / measured_hz
    axes.errorbar(np.zeros(len(rows)), rows - 0.18, xerr=2 * np.nan_to_num(std), fmt=MEASURED["marker"],
                  color=MEASURED["color"], ms=4.5, lw=1.2, capsize=3, label="measured ± 2 deviations")
    axes.hlines(rows + 0.18, low5, high95, color=BLUE, lw=1.6)
    axes.hlines(rows + 0.18, low25, high75, color=BLUE, lw=5.0, alpha=0.55)
    axes.plot(middle, rows + 0.18, ls="none", marker=POSTERIOR["marker"], color=BLUE, mec="white", ms=5.5,
              label="posterior predictive: median, 50 %, 90 %")
    if initial_hz is not None:
        axes.plot(100 * (initial_hz / measured_hz - 1), rows, ls="none", marker=PRIOR["marker"], mfc="white",
                  color=PRIOR["color"], ms=5, label="initial model")
    axes.axvline(0, color=INK, lw=0.8, zorder=1)
    axes.set_yticks(rows, labels)
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.grid(axis="y", visible=False)
    axes.xaxis.set_major_formatter(FuncFormatter(_plain))
    label_axes(axes, "computed frequency minus measured [% of measured]", "mode")
    figure.legend(loc="outside upper left", ncols=3)
    return figure
