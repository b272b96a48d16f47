"""Figures of a regression of modes: what it leaves, over time and over each covariate."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from probupdate.identification.regression import SIXTHS, ModalRegression, Regression
from probupdate.reporting.style import BLUE, FULL_IN, GREY, INK, RED, label_axes, new_figure, save_figure, with_style


@with_style
def residuals(label: str, fit: Regression, hours: np.ndarray, columns: dict[str, np.ndarray]) -> Figure:
    """One mode's response: residual over hours (n_set,) with the steps that were found, and over each covariate
    (n_set,) with means of its sixths and their standard errors, were blocks independent."""
    known = np.isfinite(fit.residual)
    shown = {name: x for name, x in columns.items() if len(np.unique(x[known & np.isfinite(x)])) > 1}
    unit, size = ("%", 100.0) if fit.response == "ln frequency" else ("-", 1.0)
    rest = size * fit.residual
    figure = new_figure(FULL_IN, 1.9 * (1 + (len(shown) + 1) // 2))
    grid = figure.add_gridspec(1 + (len(shown) + 1) // 2, 2)
    axis = figure.add_subplot(grid[0, :])
    axis.plot(hours[known], rest[known], "o", color=BLUE, markersize=2.5, rasterized=len(rest) > 2500)
    for shape in fit.shapes:
        if shape.kind == "step":
            axis.axvline(shape.constant, color=RED, linewidth=0.8)
    axis.axhline(0.0, color=INK, linewidth=0.6)
    axis.set_title(f"{label}, {fit.response}")
    label_axes(axis, "hours from the first block", f"residual [{unit}]")
    for k, (name, x) in enumerate(shown.items()):
        axis = figure.add_subplot(grid[1 + k // 2, k % 2])
        there = known & np.isfinite(x)
        axis.plot(x[there], rest[there], "o", color=GREY, markersize=2.0, rasterized=len(rest) > 2500)
        part = np.searchsorted(np.quantile(x[there], np.linspace(0, 1, SIXTHS + 1)[1:-1]), x[there])
        for sixth in np.unique(part):
            own, at = rest[there][part == sixth], x[there][part == sixth].mean()
            axis.errorbar(at, own.mean(), yerr=own.std() / np.sqrt(len(own)), fmt="s", color=RED, markersize=4)
        axis.axhline(0.0, color=INK, linewidth=0.6)
        label_axes(axis, name, f"residual [{unit}]")
    return figure


def write_regression_figures(found: ModalRegression, folder: str | Path) -> list[Path]:
    """A picture a mode and response, named by them."""
    written = []
    for label, fits in found.fits.items():
        for fit in fits:
            name = "".join(c if c.isalnum() else "_" for c in f"residual {label} {fit.response}")
            path = Path(folder) / f"{name}.png"
            save_figure(residuals(label, fit, found.hours, dict(found.columns)), path)
            written.append(path)
    return written
