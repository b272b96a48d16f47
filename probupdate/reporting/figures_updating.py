"""Figures of the update: frequencies, where each parameter went, history of the iterations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from probupdate.model.parameters import Parameter
from probupdate.reporting.style import (
    BLUE,
    FULL_IN,
    GREEN,
    GREY,
    GRID,
    HALF_IN,
    INK,
    MAP,
    ORANGE,
    POSTERIOR,
    PRIOR,
    PRIOR_UPDATE,
    PURPLE,
    RED,
    SKY,
    STEP_UPDATE,
    Role,
    label_axes,
    new_figure,
    with_style,
)

_LINES = ("-", (0, (5, 2)), (0, (1, 1)), (0, (5, 1, 1, 1)), (0, (3, 1, 1, 1, 1, 1)))
_COLORS = (BLUE, ORANGE, GREEN, RED, PURPLE, SKY, INK, GREY)
_MARKERS = ("o", "s", "^", "v", "D", "P", "X", "*")


@dataclass(frozen=True, kw_only=True)
class Mark:
    """A point estimate to be drawn: its name in legends, theta (n_param,), and a role of style.py."""

    name: str
    theta: np.ndarray
    role: Role


def mark_size(mark: Mark) -> float:
    """A star's area is small for its width."""
    return 9.0 if mark.role["marker"] == "*" else 6.0


def unit_label(name: str, unit: str) -> str:
    return f"{name} [{unit or '-'}]"


def plain_number(value: float, _position: int | None = None) -> str:
    return f"{value:g}".replace("-", "−")


@with_style
def frequency_errors(
    labels: Sequence[str], measured_hz: Sequence[float] | np.ndarray,
    computed_hz: Mapping[str, Sequence[float] | np.ndarray],
) -> Figure:
    """Computed over measured frequency minus one, in per cent, for each mode and each state of the model."""
    figure = new_figure(HALF_IN, 1.2 + 0.15 * len(computed_hz) + 0.32 * len(labels))
    axes = figure.subplots()
    measured_hz = np.asarray(measured_hz, float)
    roles = (PRIOR, STEP_UPDATE, PRIOR_UPDATE, MAP, POSTERIOR)
    rows = np.arange(len(labels))
    axes.axvline(0, color=INK, lw=1.2, zorder=2)
    for k, (name, values) in enumerate(computed_hz.items()):
        role = POSTERIOR if name.startswith("posterior") else roles[k % len(roles)]
        error = 100 * (np.asarray(values, float) / measured_hz - 1)
        offset = 0.16 * (k - 0.5 * (len(computed_hz) - 1))
        axes.hlines(rows + offset, 0, error, color=role["color"], lw=1.2, alpha=0.6)
        axes.plot(error, rows + offset, ls="none", color=role["color"], marker=role["marker"], ms=5.5, label=name)
    axes.set_yticks(rows, labels)
    axes.set_ylim(len(labels) - 0.5, -0.5)
    axes.xaxis.set_major_formatter(FuncFormatter(plain_number))
    axes.grid(axis="y", visible=False)
    label_axes(axes, "computed frequency minus measured [% of measured]", "mode")
    figure.legend(loc="outside upper left")
    return figure


@with_style
def parameter_shifts(parameters: Sequence[Parameter], draws: np.ndarray | None, marks: Sequence[Mark]) -> Figure:
    """Every parameter's estimates and posterior on one scale: shift from the initial value in prior std."""
    figure = new_figure(FULL_IN, 0.9 + 0.32 * len(parameters))
    axes = figure.subplots()
    initial = np.array([p.initial for p in parameters])
    std = np.array([p.std for p in parameters])
    rows = np.arange(len(parameters))
    axes.barh(rows, 2.0, left=-1.0, height=0.62, color=GRID, label="prior, ± 1 standard deviation", zorder=1)
    if draws is not None:
        low5, low25, middle, high75, high95 = np.percentile((draws - initial) / std, [5, 25, 50, 75, 95], axis=0)
        axes.hlines(rows, low5, high95, color=BLUE, lw=1.4, zorder=3)
        axes.hlines(rows, low25, high75, color=BLUE, lw=5.0, alpha=0.55, zorder=3, label="posterior, 50 % and 90 %")
        axes.plot(middle, rows, ls="none", marker="|", color=INK, ms=8, mew=1.4, zorder=4, label="median")
    for order, mark in enumerate(marks):
        offset = 0.17 * (order - 0.5 * (len(marks) - 1))
        axes.plot((mark.theta - initial) / std, rows + offset, ls="none", color=mark.role["color"], mec="white",
                  mew=0.4, ms=mark_size(mark), marker=mark.role["marker"], zorder=5, label=mark.name)
    axes.axvline(0, color=INK, lw=0.9, zorder=2)
    axes.set_yticks(rows, [p.name for p in parameters])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.grid(axis="y", visible=False)
    axes.xaxis.set_major_formatter(FuncFormatter(plain_number))
    label_axes(axes, "shift from the initial value [prior standard deviations]", "parameter")
    figure.legend(loc="outside upper left", ncols=3, columnspacing=1.2)
    return figure


@with_style
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
    middle_in = max(2.4, 0.3 + 0.145 * len(names))
    figure = new_figure(FULL_IN, 4.2 + middle_in)
    panels = figure.subplots(3, len(schemes), squeeze=False, sharex="col", sharey="row",
                             height_ratios=(2.2, middle_in, 1.5))
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
        top.yaxis.set_major_formatter(FuncFormatter(plain_number))
        top.yaxis.set_minor_formatter(FuncFormatter(lambda *_: ""))
        for k, name in enumerate(names):
            path = theta[scheme][:, k] / scale[k]
            # colour and marker together distinguish 64 parameters, and the marker alone eight
            middle.plot(np.arange(len(path)), path, color=_COLORS[k % 8], ls=_LINES[(k // 8 + k) % 5],
                        marker=_MARKERS[(k + 3 * (k // 8)) % 8], mfc="white" if k // 8 % 2 else None, ms=4,
                        lw=1.1, markevery=max(len(path) // 10, 1), label=name)
        apart = np.maximum(distance[scheme], 1e-3)
        bottom.plot(np.arange(len(apart)), apart, color=INK, marker="o", ms=3.5, markevery=max(len(apart) // 10, 1))
        bottom.set_yscale("log")
        bottom.yaxis.set_major_formatter(FuncFormatter(plain_number))
        bottom.yaxis.set_minor_formatter(FuncFormatter(lambda *_: ""))
        bottom.xaxis.set_major_locator(MaxNLocator(integer=True))
        label_axes(top, "", "J [-]" if column == 0 else "", scheme)
        label_axes(middle, "", relative if column == 0 else "")
        label_axes(bottom, "iteration", "distance to MAP\n[post. standard deviations]" if column == 0 else "")
    panels[1, -1].legend(loc="center left", bbox_to_anchor=(1.01, 0.5), fontsize=7.5, labelspacing=0.25)
    if objective:
        panels[0, -1].legend(loc="center left", bbox_to_anchor=(1.01, 0.5), title="terms of J", title_fontsize=8,
                             fontsize=7.5)
    figure.align_ylabels(panels[:, 0])
    return figure


@with_style
def estimate_paths(
    parameters: Sequence[Parameter], chosen: Sequence[tuple[int, int]], draws: np.ndarray | None,
    printed: np.ndarray, closest: int, alpha: np.ndarray, over_alpha: np.ndarray, mark: Mark,
) -> Figure:
    """Where Eq. 7 as printed goes over its iterations and the anchored update over alpha, against the posterior.

    One panel for each pair of parameters in `chosen`; draws (n, n_param) of the posterior or None; printed
    (n_iteration + 1, n_param), of which `closest` is nearest to the maximum; over_alpha (n_alpha, n_param).
    """
    figure = new_figure(FULL_IN, 3.6)
    panels = figure.subplots(1, len(chosen), squeeze=False)[0]
    for axes, (i, j) in zip(panels, chosen, strict=True):
        if draws is not None:
            shown = draws[:: max(1, len(draws) // 1500)]
            axes.plot(shown[:, i], shown[:, j], ls="none", marker=".", ms=2.5, color=POSTERIOR["color"], alpha=0.25,
                      mec="none", label="posterior", zorder=1)
        axes.plot(printed[:, i], printed[:, j], color=STEP_UPDATE["color"], marker="x", ms=4, lw=1.0, zorder=3,
                  label="Eq. 7 as printed, an iteration each")
        axes.plot(printed[closest, i], printed[closest, j], ls="none", marker="o", ms=10, mfc="none",
                  mec=STEP_UPDATE["color"], zorder=4, label=f"its iteration {closest}, closest to the MAP")
        axes.plot(over_alpha[:, i], over_alpha[:, j], color=PRIOR_UPDATE["color"], marker="v", ms=4, lw=1.0, zorder=3,
                  label=f"anchored, alpha {alpha[0]:g} to {alpha[-1]:g}")
        for k in (0, len(alpha) - 1):
            axes.annotate(f"{alpha[k]:g}", (over_alpha[k, i], over_alpha[k, j]), xytext=(4, 4),
                          textcoords="offset points", fontsize=7.5, color=INK)
        axes.plot(mark.theta[i], mark.theta[j], ls="none", color=mark.role["color"], marker=mark.role["marker"],
                  ms=mark_size(mark), mec="white", mew=0.4, zorder=5, label=mark.name)
        axes.plot(parameters[i].initial, parameters[j].initial, ls="none", marker="s", ms=5, color=INK, zorder=5,
                  label="initial")
        label_axes(axes, *(unit_label(parameters[k].name, parameters[k].unit) for k in (i, j)))
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=3, columnspacing=1.2)
    return figure


@with_style
def variance_shares(names: Sequence[str], components: Sequence[str], share: np.ndarray) -> Figure:
    """What each parameter's variance is made of: share (n_component, n_param) of its variance, columns sum to one."""
    figure = new_figure(FULL_IN, 0.9 + 0.27 * len(names))
    axes = figure.subplots()
    rows, left = np.arange(len(names)), np.zeros(len(names))
    hatches = ("", "///", "...", "xx", "\\\\\\", "++", "oo", "--")
    for k, component in enumerate(components):
        axes.barh(rows, 100 * share[k], left=left, height=0.66, color=_COLORS[k % 8], hatch=hatches[k % 8],
                  edgecolor="white", lw=0.4, label=component)
        left = left + 100 * share[k]
    axes.set_yticks(rows, names)
    axes.set_xlim(0, 100)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.grid(axis="y", visible=False)
    label_axes(axes, "share of the variance at the MAP [%]", "parameter")
    figure.legend(loc="outside upper left", ncols=4, columnspacing=1.2)
    return figure
