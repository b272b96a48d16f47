"""The joint inference on farm.html: what is shared, a row a turbine with its parameters and intervals, odd ones, months
over time, what to measure next."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from probupdate.farms.description import natural_order
from probupdate.farms.joint import JointRun
from probupdate.reporting.elements import MISSING, Column, Element, Items, Notice, Picture, Section, Table, number
from probupdate.updating.joint_file import FarmJoint, MonthValue, TurbineRow
from probupdate.updating.settings import CONSTANTS

SURE = CONSTANTS.outlier_sure
ROW_IN, MOST_NAMED, LINES = 0.16, 12, 10
# rows of what to measure next
SHOWN = 10


def joint_section(joint: JointRun) -> Section:
    title, anchor = "All turbines in one inference", "joint"
    found = joint.found
    if found is None:
        return Section(anchor=anchor, title=title, items=(Notice(level="warning", text=joint.failed),), shown=1)
    items: list[Element] = []
    if not (found.settled and found.converged and found.corrected):
        items.append(Notice(level="warning", text=found.verdict))
    if found.notes:
        items.append(Items(title="Notes on turbines and sets", statements=found.notes, level="warning"))
    changed = tuple(f"{m.turbine}, {m.month}: {m.parameter} is now {number(m.value)} ± {number(m.std, 2)} {m.unit}"
                    for m in found.months if m.changed)
    if changed:
        items.append(Items(title="Parameters changed since the month before", statements=changed))
    items += [_population(found), _turbines(found), turbine_picture(found)]
    if found.months:
        items.append(month_picture(found.months))
    items.append(_next_measurement_rows(found))
    lead = f"{len(found.turbines)} turbines, {found.settings['sets']} sets; {found.verdict}."
    return Section(anchor=anchor, title=title, items=tuple(items), lead=lead, shown=len(items))


def _interval_text(low: float, high: float) -> str:
    return f"{number(low)} to {number(high)}" if np.isfinite(low) else MISSING


def _population(found: FarmJoint) -> Table:
    words = [Column(name=name, number=False) for name in ("parameter", "unit", "role")]
    columns = (*words, *(Column(name=name) for name in (
        "prior", "Tikhonov", "mean", "90 %", "scatter between turbines", "90 %", "a turbine without sensors", "90 %")))
    lines = [(r.parameter, r.unit, r.role, f"{number(r.prior_mean)} ± {number(r.prior_std, 2)}", number(r.tikhonov),
              number(r.mean), _interval_text(r.low, r.high), number(r.tau, 2), _interval_text(r.tau_low, r.tau_high),
              number(r.inherited_mean), _interval_text(r.inherited_low, r.inherited_high))
             for r in found.population]
    return Table(caption="What turbines share, and what one without sensors inherits", columns=columns,
                 rows=tuple(lines), note="Of a varying parameter: the mean over turbines, and its scatter (a share of "
                 "the value where the parameter is positive by its bounds).")


def _turbines(found: FarmJoint) -> Table:
    names = [r.parameter for r in found.population if r.role != "common"]
    units = {r.parameter: r.unit for r in found.population}
    columns = [Column(name="turbine", number=False), Column(name="unlike the others")]
    for name in names:
        columns += [Column(name=name, unit=units[name]), Column(name="90 %")]
    lines, marked = [], set()
    for k, (turbine, odd) in enumerate(zip(found.turbines, found.odd_probability, strict=True)):
        own = {r.parameter: r for r in found.rows if r.turbine == turbine}
        line = [turbine, f"{odd:.3f}"]
        for name in names:
            line += [number(own[name].mean), _interval_text(own[name].low, own[name].high)]
        lines.append(tuple(line))
        if odd >= SURE:
            marked.add(k)
    return Table(caption="Turbines", columns=tuple(columns), rows=tuple(lines), marked=frozenset(marked),
                 note=f"Marked: unlike the others with a probability of {SURE:g} or more.")


def _next_measurement_rows(found: FarmJoint) -> Table:
    columns = (Column(name="measurement", number=False), Column(name="turbine", number=False),
               Column(name="about what all share", unit="bit"), Column(name="about that turbine", unit="bit"))
    lines = [(r.measurement, r.turbine or "one without sensors", f"{r.farm_bits:.2f}", f"{r.turbine_bits:.2f}")
             for r in found.next[:SHOWN]]
    return Table(caption="What to measure next", columns=columns, rows=tuple(lines),
                 note="Expected information of the linear system; a survey states a parameter to a tenth of its "
                 "prior's standard deviation.")


def turbine_picture(found: FarmJoint) -> Picture:
    """A panel a parameter: a row a turbine with its 90 % interval, the population's behind."""
    from probupdate.reporting import style

    @style.with_style
    def draw():
        columns = [r for r in found.population if r.role != "common"] or list(found.population)
        figure = style.new_figure(style.FULL_IN, 0.8 + ROW_IN * len(found.turbines))
        panels = figure.subplots(1, len(columns), sharey=True, squeeze=False)[0]
        y = np.arange(len(found.turbines))[::-1]
        for axes, population in zip(panels, columns, strict=True):
            rows = [_row(found.rows, turbine, population.parameter) for turbine in found.turbines]
            axes.axvspan(population.inherited_low, population.inherited_high, color=style.PALE, zorder=0)
            for place, row, odd in zip(y, rows, found.odd_probability, strict=True):
                color = style.RED if odd >= SURE and row.odd >= 0.05 else style.BLUE
                axes.plot([row.low, row.high], [place, place], color=color, linewidth=1.4)
                axes.plot([row.mean], [place], color=color, marker="o", markersize=3, linestyle="")
                axes.plot([row.tikhonov], [place], color=style.GREY, marker="|", markersize=6, linestyle="")
            style.label_axes(axes, f"{population.parameter} [{population.unit}]", "")
        panels[0].set_yticks(y, found.turbines)
        for label, odd in zip(panels[0].get_yticklabels(), found.odd_probability, strict=True):
            label.set_color(style.RED if odd >= SURE else label.get_color())
        panels[0].set_ylim(-0.6, len(y) - 0.4)
        return figure

    return Picture(svg=style.svg_text(draw(), "turbines"), alt="Parameters of every turbine with 90 % intervals",
                   caption="A row a turbine: posterior mean and 90 % interval, Tikhonov estimate (|). Band: a turbine "
                   "without sensors. Red: unlike the others in this parameter.")


def _row(rows: Sequence[TurbineRow], turbine: str, parameter: str) -> TurbineRow:
    return next(r for r in rows if r.turbine == turbine and r.parameter == parameter)


def month_picture(months: Sequence[MonthValue]) -> Picture:
    """A panel a parameter: a line a turbine over its months."""
    from probupdate.reporting import style

    @style.with_style
    def draw():
        names = list(dict.fromkeys(m.parameter for m in months))
        times = sorted({m.month for m in months}, key=natural_order)
        figure = style.new_figure(style.FULL_IN, 0.9 + 1.3 * len(names))
        panels = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
        turbines = list(dict.fromkeys(m.turbine for m in months))
        for axes, name in zip(panels, names, strict=True):
            ends: dict[str, float] = {}
            for turbine in turbines:
                mine = [m for m in months if m.parameter == name and m.turbine == turbine]
                far = [m for m in mine if m.changed]
                x, color = [times.index(m.month) for m in mine], style.RED if far else style.GREY
                axes.errorbar(x, [m.value for m in mine], yerr=[m.std for m in mine], color=color, linewidth=1.0,
                              elinewidth=0.7, marker=".", zorder=3 if far else 2)
                axes.plot([times.index(m.month) for m in far], [m.value for m in far], color=style.RED, marker="X",
                          linestyle="", zorder=4)
                if far or len(turbines) <= MOST_NAMED:
                    ends[turbine] = mine[-1].value
            # names that would lie on one another are moved apart
            least = np.diff(axes.get_ylim())[0] / LINES
            at = -np.inf
            for turbine, value in sorted(ends.items(), key=lambda pair: pair[1]):
                at = max(value, at + least)
                axes.annotate(turbine, (len(times) - 1, value), xytext=(len(times) - 0.9, at), fontsize=7, va="center",
                              annotation_clip=False)
            unit = next(m.unit for m in months if m.parameter == name)
            style.label_axes(axes, "", f"{name} [{unit}]")
        panels[-1].set_xlim(-0.3, len(times) - 0.5)
        panels[-1].set_xticks(range(len(times)), times, rotation=30 if len(times) > 4 else 0)
        return figure

    return Picture(svg=style.svg_text(draw(), "months"), alt="Parameters of every turbine over its months",
                   caption="By each month's sets alone, given what all turbines share; one standard deviation. "
                   "Red, with a name: changed since the month before, at the crosses.")
