"""Figures of an identification: stabilisation, MAC and MPC maps, shapes on the Argand plane, frequency against
conditions. Plain arrays in, a matplotlib Figure out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from probupdate.reporting.figures_measurement import mode_mark, scatter
from probupdate.reporting.style import FULL_IN, GREY, HALF_IN, INK, PALE, RED, label_axes, new_figure, with_style

# how a pole stands to those of the order below -> (marker, colour, size): distinguished in grey by their markers
STEADINESS = {
    "stable in f, damping and shape": ("o", INK, 11.0), "stable in f": ("+", GREY, 16.0), "new": (".", PALE, 7.0),
}
# panels in a row
ACROSS = 5


@with_style
def stabilisation(
    line_hz, spectrum, order, frequency_hz, steadiness: Sequence[str], *, chosen_hz: Mapping[str, float] | None = None,
    harmonics_hz: Mapping[str, tuple[float, float]] | None = None, unit: str = "m/s²",
) -> Figure:
    """Poles of every model order over the power spectral density summed over channels.

    line_hz, spectrum (n_line,) in unit² per Hz; order, frequency_hz, steadiness (n_pole,) with keys of STEADINESS;
    chosen_hz: mode -> its frequency in this block; harmonics_hz: name -> the band that a multiple of the rotor swept.
    """
    figure = new_figure(FULL_IN, 3.9)
    axes = figure.subplots()
    density = axes.twinx()
    # the spectrum behind the poles
    axes.set_zorder(density.get_zorder() + 1)
    axes.patch.set_visible(False)
    line_hz, spectrum = np.asarray(line_hz, float), np.asarray(spectrum, float)
    upper = float(line_hz[-1])
    inside = (line_hz > 0) & (line_hz <= upper) & (spectrum > 0)
    density.semilogy(line_hz[inside], spectrum[inside], color=PALE, lw=1.3)
    # matplotlib writes powers of ten as math text, which this style does not parse
    density.yaxis.set_major_formatter(lambda value, _: f"{value:.0e}")
    density.yaxis.set_minor_formatter(lambda value, _: "")
    density.grid(visible=False)
    density.spines["right"].set_visible(True)
    density.set_ylabel(f"sum of spectral densities [({unit})²/Hz]")
    order, frequency_hz = np.asarray(order, float), np.asarray(frequency_hz, float)
    kind = np.asarray(steadiness, dtype=object)
    for name, (marker, color, size) in STEADINESS.items():
        rows = (kind == name) & (frequency_hz <= upper)
        scatter(axes, frequency_hz[rows], order[rows], color=color, marker=marker, size=size, label=name, zorder=3)
    for _, (low, high) in (harmonics_hz or {}).items():
        if low < upper:
            axes.axvspan(low, high, color=GREY, alpha=0.18, lw=0, zorder=1)
    height = axes.get_xaxis_transform()
    # names of neighbours would overprint: each to its own row
    shelf, last = 0, -np.inf
    for name, value in sorted((chosen_hz or {}).items(), key=lambda item: item[1]):
        if not np.isfinite(value) or value > upper:
            continue
        shelf = (shelf + 1) % 3 if value - last < 0.06 * upper else 0
        last = value
        axes.axvline(value, color=RED, lw=0.8, ls="--", zorder=2)
        axes.annotate(name, (value, 0.985 - 0.055 * shelf), xycoords=height, fontsize=7.5, xytext=(2, 0), va="top",
                      textcoords="offset points", color=RED)
    for name, (low, high) in (harmonics_hz or {}).items():
        if low < upper:
            axes.annotate(name, ((low + min(high, upper)) / 2, 0.01), xycoords=height, fontsize=7.5, ha="center")
    axes.set_xlim(0, upper)
    axes.set_ylim(0, order.max(initial=2) * 1.12)
    label_axes(axes, "frequency [Hz]", "model order [-]")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return figure


@with_style
def mac_map(value: np.ndarray, rows: Sequence[str], columns: Sequence[str], *, across: str, up: str) -> Figure:
    """MAC of every row's mode with every column's (n_row, n_column), dark for 1, with its number; NaN blank."""
    value = np.asarray(value, float)
    figure = new_figure(HALF_IN, 0.9 + 0.42 * len(rows))
    axes = figure.subplots()
    axes.imshow(np.ma.masked_invalid(value), cmap="Greys", vmin=0, vmax=1, aspect="auto")
    for i, j in np.ndindex(value.shape):
        if np.isfinite(value[i, j]):
            axes.text(j, i, f"{value[i, j]:.2f}", ha="center", va="center", fontsize=7.5,
                      color="white" if value[i, j] > 0.55 else INK)
    axes.set_xticks(range(len(columns)), columns)
    axes.set_yticks(range(len(rows)), rows)
    axes.grid(visible=False)
    label_axes(axes, across, up)
    return figure


@with_style
def mpc_map(time, labels: Sequence[str], mpc: np.ndarray) -> Figure:
    """Modal phase collinearity of every mode (row) in every block (column of pixels), dark for 1; hatched: not found.

    time (n_block,), mpc (n_block, n_mode). Blocks stand one beside the other, gaps between them left out.
    """
    mpc = np.asarray(mpc, float)
    figure = new_figure(FULL_IN, 1.1 + 0.3 * len(labels))
    axes = figure.subplots()
    image = axes.imshow(np.ma.masked_invalid(mpc.T), cmap="Greys", vmin=0, vmax=1, aspect="auto",
                        interpolation="nearest", extent=(0.5, len(mpc) + 0.5, len(labels) - 0.5, -0.5))
    # shows through where there is no pixel
    axes.patch.set(hatch="////", edgecolor=GREY, linewidth=0)
    axes.set_yticks(range(len(labels)), labels)
    axes.grid(visible=False)
    axes.locator_params(axis="x", integer=True)
    first, last = (np.datetime_as_string(np.asarray(time, "datetime64[m]")[k]).replace("T", " ") for k in (0, -1))
    label_axes(axes, f"block [-], {first} to {last} UTC", "mode")
    figure.colorbar(image, ax=axes, label="MPC [-]", fraction=0.04)
    return figure


@with_style
def argand(labels: Sequence[str], shape: np.ndarray, note: Sequence[str] = ()) -> Figure:
    """Components of each mode's shape on the complex plane, a panel a mode; shape (n_channel, n_mode), largest 1.

    A shape of a normal mode lies on the real axis; note: a line above each panel.
    """
    n_mode = len(labels)
    columns = min(n_mode, ACROSS)
    lines = -(-n_mode // columns)
    figure = new_figure(FULL_IN, 0.3 + 1.75 * lines)
    panels = figure.subplots(lines, columns, squeeze=False, sharex=True, sharey=True).ravel()
    for j, axes in enumerate(panels[:n_mode]):
        column = shape[:, j][np.isfinite(shape[:, j])]
        axes.axhline(0, color=GREY, lw=0.7)
        axes.axvline(0, color=GREY, lw=0.7)
        for z in column:
            axes.plot([0, z.real], [0, z.imag], color=PALE, lw=0.7, zorder=2)
        color, marker = mode_mark(labels[j], j)
        scatter(axes, np.real(column), np.imag(column), color=color, marker=marker, size=11.0, zorder=3)
        axes.set_aspect("equal", adjustable="box")
        axes.set_xlim(-1.15, 1.15)
        axes.set_ylim(-1.15, 1.15)
        axes.set_title(f"{labels[j]}{': ' + note[j] if note else ''}", fontsize=8)
        label_axes(axes, "real part [-]", "imaginary [-]")
        axes.label_outer()
    for axes in panels[n_mode:]:
        axes.remove()
    return figure


@with_style
def against_conditions(
    labels: Sequence[str], frequency_hz: np.ndarray, std_hz: np.ndarray, conditions: Mapping[str, np.ndarray]
) -> Figure:
    """Difference of each mode's frequency from its median against each condition: a row a mode, a column a condition.

    frequency_hz, std_hz (n_block, n_mode), NaN where not found or not known; conditions: name with unit -> (n_block,).
    """
    # a mode that no block has is no row
    names, found = list(conditions), np.flatnonzero(np.isfinite(frequency_hz).any(axis=0))
    figure = new_figure(FULL_IN, 0.6 + 1.15 * len(found))
    panels = figure.subplots(len(found), len(names), squeeze=False, sharey="row", sharex="col")
    for row, j in enumerate(found):
        label, middle = labels[j], np.nanmedian(frequency_hz[:, j])
        away = 100 * (frequency_hz[:, j] / middle - 1)
        color, marker = mode_mark(label, j)
        for k, name in enumerate(names):
            axes: Axes = panels[row, k]
            rows = np.isfinite(away) & np.isfinite(conditions[name])
            axes.errorbar(conditions[name][rows], away[rows], yerr=100 * np.nan_to_num(std_hz[rows, j] / middle),
                          fmt="none", ecolor=PALE, elinewidth=0.6, zorder=1)
            scatter(axes, conditions[name][rows], away[rows], color=color, marker=marker, size=7.0, zorder=3)
            label_axes(axes, name, f"{label} [%]" if k == 0 else "")
            axes.xaxis.label.set_fontsize(7.5)
            axes.tick_params(labelsize=7)
            axes.label_outer()
        finite = away[np.isfinite(away)]
        if len(finite):
            # a few strays must not flatten what the others show
            reach = 1.3 * np.percentile(np.abs(finite), 97) or 1.0
            panels[row, 0].set_ylim(-reach, reach)
    return figure
