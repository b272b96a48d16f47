"""Figures of the posterior: marginals, pairs, traces and ranks, correlation, contraction, predictions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator
from scipy import stats

from probupdate.model.parameters import Parameter
from probupdate.reporting.figures_updating import Mark, mark_size, plain_number, unit_label
from probupdate.reporting.style import (
    BLUE,
    FULL_IN,
    GREEN,
    GREY,
    GRID,
    HALF_IN,
    INK,
    MEASURED,
    ORANGE,
    PALE,
    POSTERIOR,
    PRIOR,
    RED,
    SKY,
    label_axes,
    new_figure,
    with_style,
)

# a marginal's window, in widths of its posterior on either side: a wider one would hide the posterior's form
WINDOW = 1.5
# parts of the chains whose ranks are compared -> colour and line style
RANKED_PARTS = (
    ("first half", BLUE, "-"), ("first half, other walkers", ORANGE, (0, (5, 2))),
    ("second half", GREEN, (0, (1, 1))), ("second half, other walkers", RED, (0, (5, 1, 1, 1))),
)


def _span(parameter: Parameter, draws: np.ndarray, marks: Sequence[float]) -> tuple[float, float]:
    low, high = np.percentile(draws, [0.2, 99.8])
    prior, room = parameter.distribution, WINDOW * (high - low)
    low, high = min(low, max(float(prior.ppf(0.02)), low - room)), max(high, min(float(prior.ppf(0.98)), high + room))
    finite = [m for m in marks if np.isfinite(m)]
    low, high = min([low, *finite]), max([high, *finite])
    room = 0.03 * (high - low)
    return max(low - room, parameter.lower - room), min(high + room, parameter.upper + room)


@with_style
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
        axes.xaxis.set_major_locator(MaxNLocator(4) if max(abs(low), abs(high)) < 1e4 else MaxNLocator(3, prune="both"))
        axes.xaxis.set_major_formatter(FuncFormatter(plain_number))
        label_axes(axes, unit_label(parameter.name, parameter.unit), "density" if k % columns == 0 else "")
    for axes in panels[len(parameters):]:
        axes.remove()
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=min(len(labels), 5), columnspacing=1.2)
    return figure


@with_style
def corner(parameters: Sequence[Parameter], draws: np.ndarray, marks: Sequence[Mark]) -> Figure:
    """Histograms and pairs of the given parameters, draws (n_draw, n): contours hold 39, 68 and 90 % of the draws;
    dashed on the diagonal: the prior."""
    n = len(parameters)
    names, units = [p.name for p in parameters], [p.unit for p in parameters]
    figure = new_figure(FULL_IN, 0.6 + 6.8 * min(1.0, n / 4))
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
                inside = np.linspace(max(low[i], parameters[i].lower), min(high[i], parameters[i].upper), 120)
                axes.plot(inside, np.exp(parameters[i].distribution.logpdf(inside)), color=PRIOR["color"],
                          ls=PRIOR["linestyle"], lw=1.1)
                axes.set_ylim(0, 1.08 * heights.max())
                axes.set_yticks([])
                axes.grid(visible=False)
            else:
                _pair(axes, draws[:, j], draws[:, i], (low[j], high[j]), (low[i], high[i]))
                for mark in marks:
                    axes.plot(mark.theta[j], mark.theta[i], ls="none", color=mark.role["color"],
                              marker=mark.role["marker"], ms=mark_size(mark), mec="white", mew=0.5, label=mark.name)
                axes.set_ylim(low[i], high[i])
                axes.yaxis.set_major_locator(MaxNLocator(3, prune="both"))
                axes.yaxis.set_major_formatter(FuncFormatter(plain_number))
            axes.set_xlim(low[j], high[j])
            axes.xaxis.set_major_locator(MaxNLocator(3 if n < 5 else 2, prune="both"))
            axes.xaxis.set_major_formatter(FuncFormatter(plain_number))
            label_axes(axes, unit_label(names[j], units[j]), "density" if i == j else unit_label(names[i], units[i]))
            axes.xaxis.label.set_size(8)
            axes.yaxis.label.set_size(7 if i == j else 8)
            axes.tick_params(labelsize=6.5)
            if i < n - 1:
                axes.tick_params(labelbottom=False)
            axes.label_outer(remove_inner_ticks=False)
            if i == j and j > 0:
                axes.set_ylabel("density", fontsize=7)
    figure.align_ylabels(panels[1:, 0])
    if n > 1 and marks:
        handles, labels = panels[1, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="upper right")
    return figure


def _pair(axes: Axes, x: np.ndarray, y: np.ndarray, span_x: tuple, span_y: tuple) -> None:
    counts, edges_x, edges_y = np.histogram2d(x, y, bins=26, range=(span_x, span_y))
    # a light smoothing so that contours of a finite sample can be read
    kernel = stats.norm.pdf(np.arange(-3, 4), scale=1.0)
    kernel /= kernel.sum()

    def smoothed(line: np.ndarray) -> np.ndarray:
        return np.convolve(line, kernel, "valid")

    smooth = np.apply_along_axis(smoothed, 0, np.pad(counts, 3, mode="edge"))
    smooth = np.apply_along_axis(smoothed, 1, smooth)
    ordered = np.sort(smooth.ravel())[::-1]
    share = np.cumsum(ordered) / ordered.sum()
    levels = sorted({float(ordered[np.searchsorted(share, q)]) for q in (0.90, 0.68, 0.39)})
    if len(levels) < 2:
        axes.plot(x[:: max(len(x) // 500, 1)], y[:: max(len(x) // 500, 1)], ".", color=BLUE, ms=1)
        return
    centre_x, centre_y = 0.5 * (edges_x[1:] + edges_x[:-1]), 0.5 * (edges_y[1:] + edges_y[:-1])
    # the outermost cells reach the frame, so that mass at a bound is not drawn as ending before it
    centre_x[[0, -1]], centre_y[[0, -1]] = edges_x[[0, -1]], edges_y[[0, -1]]
    shades = ("#dbe9f4", "#9cc7e4", "#4d97c9")[-len(levels):]
    axes.contourf(centre_x, centre_y, smooth.T, levels=[*levels, ordered[0] * 1.001 + 1e-12], colors=shades)
    axes.contour(centre_x, centre_y, smooth.T, levels=levels, colors=BLUE, linewidths=0.7)


@with_style
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


@with_style
def contraction(
    names: Sequence[str], ratio: Sequence[float] | np.ndarray, *, informed_below: float, strong_below: float
) -> Figure:
    """Posterior over prior standard deviation of each parameter: short bars were learned from the data."""
    order = [int(k) for k in np.argsort(np.asarray(ratio, float), kind="stable")]
    figure = new_figure(HALF_IN, 0.8 + 0.24 * len(names))
    axes = figure.subplots()
    for row, k in enumerate(order):
        value = ratio[k]
        strong, informed = value < strong_below, value < informed_below
        face = BLUE if strong else (SKY if informed else "white")
        axes.barh(row, value, height=0.66, color=face, edgecolor=BLUE if informed else GREY, lw=0.9,
                  hatch="" if strong else ("///" if informed else "..."))
        beside = max(value, 1.0) if value > 0.84 else value
        axes.annotate(f"{value:.2f}", (beside, row), xytext=(4, 0), textcoords="offset points", va="center", fontsize=8)
    axes.axvline(1, color=INK, lw=1.0, ls="--")
    axes.set_yticks(range(len(order)), [names[k] for k in order])
    axes.invert_yaxis()
    axes.grid(axis="y", visible=False)
    axes.set_xlim(0, max(1.18, 1.15 * float(np.max(ratio))))
    label_axes(axes, "posterior over prior standard deviation [-]", "parameter")
    return figure


@with_style
def predictive_frequencies(
    labels: Sequence[str], measured_hz: np.ndarray, measured_std_hz: np.ndarray, predicted_hz: np.ndarray
) -> Figure:
    """Posterior draws of computed frequencies (n_draw, n_mode) against the measured ones, in per cent of these."""
    figure = new_figure(FULL_IN, 0.9 + 0.42 * len(labels))
    axes = figure.subplots()
    rows = np.arange(len(labels))
    relative = 100 * (predicted_hz / measured_hz - 1)
    low5, low25, middle, high75, high95 = np.percentile(relative, [5, 25, 50, 75, 95], axis=0)
    std = 100 * measured_std_hz / measured_hz
    axes.errorbar(np.zeros(len(rows)), rows - 0.18, xerr=2 * np.nan_to_num(std), fmt=MEASURED["marker"],
                  color=MEASURED["color"], ms=4.5, lw=1.2, capsize=3, label="measured ± 2 standard deviations")
    axes.hlines(rows + 0.18, low5, high95, color=BLUE, lw=1.6)
    axes.hlines(rows + 0.18, low25, high75, color=BLUE, lw=5.0, alpha=0.55)
    axes.plot(middle, rows + 0.18, ls="none", marker=POSTERIOR["marker"], color=BLUE, mec="white", ms=5.5,
              label="posterior predictive: median, 50 %, 90 %")
    axes.axvline(0, color=INK, lw=0.8, zorder=1)
    axes.set_yticks(rows, labels)
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.grid(axis="y", visible=False)
    axes.xaxis.set_major_formatter(FuncFormatter(plain_number))
    label_axes(axes, "computed frequency minus measured [% of measured]", "mode")
    figure.legend(loc="outside upper left", ncols=3)
    return figure


@with_style
def traces_and_ranks(
    names: Sequence[str], units: Sequence[str], theta: np.ndarray, effective: np.ndarray, thinned_by: int = 1
) -> Figure:
    """Whether the chains have settled: for each parameter the ensemble by step, and the ranks of four parts of it.

    theta (n_walker, n_step, n_param), effective (n_param,). Left: median, 50 and 90 % of all walkers at every step.
    Right: how often the ranks of each part (first or second half, even or odd walkers) fall into 20 bins of all ranks,
    over what equal parts would have; grey: two standard deviations for that effective size (Vehtari et al. 2021, figure
    4).
    """
    n = len(names)
    columns = 2 if n > 1 else 1
    rows = -(-n // columns)
    figure = new_figure(FULL_IN, 0.5 + 1.12 * rows)
    panels = figure.subplots(rows, 2 * columns, squeeze=False, width_ratios=[1.5, 1] * columns)
    for k in range(n):
        trace, ranks = panels[k % rows, 2 * (k // rows)], panels[k % rows, 2 * (k // rows) + 1]
        _draw_trace(trace, *_thin_chains(theta[:, :, k], thinned_by))
        _draw_ranks(ranks, theta[:, :, k], float(effective[k]))
        last = k % rows == rows - 1 or k == n - 1
        label_axes(trace, "step after burn-in [-]" if last else "", unit_label(names[k], units[k]))
        label_axes(ranks, "rank of all draws [-]" if last else "", "share [-]")
        for axes in (trace, ranks):
            axes.tick_params(labelsize=6.5, labelbottom=last)
            axes.xaxis.label.set_size(8)
            axes.yaxis.label.set_size(8)
    for k in range(n, rows * columns):
        panels[k % rows, 2 * (k // rows)].remove()
        panels[k % rows, 2 * (k // rows) + 1].remove()
    handles, labels = (a + b for a, b in zip(panels[0, 0].get_legend_handles_labels(),
                                             panels[0, 1].get_legend_handles_labels(), strict=True))
    figure.legend(handles, labels, loc="outside upper left", ncols=4, columnspacing=1.2)
    return figure


def _draw_trace(axes: Axes, step: np.ndarray, values: np.ndarray) -> None:
    """The ensemble by step: values (n, n_step)."""
    low, lower, middle, upper, high = np.percentile(values, [5, 25, 50, 75, 95], axis=0)
    axes.fill_between(step, low, high, color=BLUE, alpha=0.2, lw=0, label="90 % of the walkers")
    axes.fill_between(step, lower, upper, color=BLUE, alpha=0.4, lw=0, label="50 %")
    axes.plot(step, middle, color=INK, lw=0.9, label="median")
    axes.set_xlim(step[0], max(step[-1], step[0] + 1))
    axes.yaxis.set_major_locator(MaxNLocator(3))
    axes.yaxis.set_major_formatter(FuncFormatter(plain_number))


def _draw_ranks(axes: Axes, chains: np.ndarray, effective: float) -> None:
    """How often the ranks of four parts of the chains (n_walker, n_step) fall into equal bins of all ranks."""
    n_walker, n_step = chains.shape
    bins, half = min(20, n_step), max(n_step // 2, 1)
    edge = np.linspace(0, 1, bins + 1)
    order = stats.rankdata(chains, axis=None).reshape(n_walker, n_step) / chains.size
    quarter = (order[::2, :half], order[1::2, :half], order[::2, half:], order[1::2, half:])
    noise = 2 * np.sqrt((bins - 1) / max(effective / 4, 1.0))
    axes.axhspan(1 - noise, 1 + noise, color=GRID, lw=0, label="to be expected")
    for (name, color, line), chain in zip(RANKED_PARTS, quarter, strict=True):
        if chain.size:
            axes.stairs(np.histogram(chain, bins=edge)[0] * bins / chain.size, edge, baseline=None, color=color,
                        ls=line, lw=1.0, label=name)
    axes.set_xlim(0, 1)
    axes.set_ylim(0, max(2.0, 1.1 + noise))
    axes.yaxis.set_major_locator(MaxNLocator(2, integer=True))


def _thin_chains(chains: np.ndarray, thinned_by: int, most: int = 120) -> tuple[np.ndarray, np.ndarray]:
    """Steps and values (n, n_step) with `most` steps at most: neighbouring steps of all walkers taken together."""
    n_walker, n_step = chains.shape
    each = -(-n_step // most)
    count = n_step // each
    together = chains[:, : count * each].reshape(n_walker, count, each).transpose(0, 2, 1).reshape(-1, count)
    return (np.arange(count) + 0.5) * each * thinned_by, together
