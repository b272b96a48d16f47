"""farm.html: one table and one figure over all turbines and months, in one file that needs no other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from probupdate.diagnosis.wording import probability_words
from probupdate.farms.description import Farm
from probupdate.farms.joint import JointRun
from probupdate.farms.joint_page import joint_section
from probupdate.farms.summary import DONE, FAILED, LEFT_OUT, WAITING, MonthRow, labels_of, months_of, rows_by_turbine
from probupdate.io.files import write_text
from probupdate.io.result_table import plural
from probupdate.reporting.elements import MISSING, Column, Element, Items, Picture, Section, Table, number, percent

if TYPE_CHECKING:
    from matplotlib.artist import Artist

# verdict -> name of its colour in the style of figures, and its marker
MARKS = {"none": ("GREEN", "o"), "named": ("RED", "X"), "ambiguous": ("ORANGE", "^"), "unexplained": ("PURPLE", "s"),
         "": ("GREY", ".")}
PANEL_IN, MOST_NAMED = 1.5, 12


def write_page(farm: Farm, rows: Sequence[MonthRow], path: Path, joint: JointRun | None = None) -> Path:
    from probupdate.reporting.page import render

    failed, left_out = ([row for row in rows if row.state == state] for state in (FAILED, LEFT_OUT))
    rows = [row for row in rows if row.state != LEFT_OUT]
    changed = [row for row in rows if row.changes]
    count = {state: sum(row.state == state for row in rows) for state in (DONE, FAILED, WAITING)}
    items: list[Element] = []
    if failed:
        items.append(Items(title="Failed", level="warning", statements=tuple(
            f"{row.turbine}, {row.month}, at {row.failed_step}: {row.failed}" for row in failed)))
    if left_out:
        items.append(Items(title="Folders left out", level="warning", statements=tuple(
            f"{row.turbine}, {row.month}: {row.failed}" for row in left_out)))
    if changed:
        items.append(Items(title="Changed since the month before", statements=tuple(
            f"{row.turbine}, {row.month}: {'; '.join(row.changes)}" for row in changed)))
    items.append(_table(rows))
    if labels_of(rows):
        items.append(_picture(rows))
    lead = (f"{plural(len(rows_by_turbine(rows)), 'turbine')}, {plural(len(rows), 'turbine-month')}: "
            f"{count[DONE]} done, {count[FAILED]} failed, {count[WAITING]} waiting.")
    section = Section(anchor="farm", title="All turbines", items=tuple(items), lead=lead, shown=len(items))
    footer = "Written by probupdate. This page needs no network and no other file."
    sections = [section] if joint is None else [section, joint_section(joint)]
    return write_text(path, render(sections, title=farm.name, subtitle=", ".join(farm.steps), footer=footer))


def _table(rows: Sequence[MonthRow]) -> Table:
    labels = labels_of(rows)
    columns = [Column(name="turbine", number=False), Column(name="month", number=False),
               Column(name="state", number=False), Column(name="blocks")]
    for label in labels:
        columns += [Column(name=label, unit="Hz"), Column(name="change", unit="%")]
    columns += [Column(name="verdict", number=False), Column(name="findings", number=False)]
    lines = []
    for row in rows:
        line = [row.turbine, row.month, row.state, str(row.blocks) if row.blocks else MISSING]
        for label in labels:
            found = row.frequency.get(label)
            line += [number(found.hz, 4) if found else MISSING, percent(row.change.get(label), 2, sign=True)]
        verdict = f"{row.verdict} ({probability_words(row.p_value)})" if row.verdict else MISSING
        lines.append((*line, verdict, "; ".join(row.findings) or MISSING))
    marked = frozenset(k for k, row in enumerate(rows) if row.state == FAILED or row.verdict not in ("none", ""))
    return Table(
        caption="Frequencies and verdicts", columns=tuple(columns), rows=tuple(lines), marked=marked,
        note="Frequencies: medians over a month's blocks. Change: since the month before of the same turbine; said "
             "above where it is larger than the blocks of both months scatter and than three standard errors. Marked: "
             "failed, or a verdict other than none.")


def _picture(rows: Sequence[MonthRow]) -> Picture:
    from probupdate.reporting.style import svg_text

    return Picture(
        svg=svg_text(frequency_figure(rows), "farm"),
        caption="Frequencies of every turbine beside its first month. Marks: the month's verdict.",
        alt="Relative change of each mode's frequency over the months, a line a turbine")


def frequency_figure(rows: Sequence[MonthRow]):
    """A panel a mode: a line a turbine, its frequency beside that of its first month in per cent, marked by verdict.

    Returns a matplotlib Figure.
    """
    import numpy as np

    from probupdate.reporting import style

    @style.with_style
    def draw():
        labels, months = labels_of(rows), months_of(rows)
        figure = style.new_figure(style.FULL_IN, 0.9 + PANEL_IN * len(labels))
        panels = figure.subplots(len(labels), 1, sharex=True, squeeze=False)[:, 0]
        seen: dict[str, Artist] = {}
        for axes, label in zip(panels, labels, strict=True):
            for turbine, mine in rows_by_turbine(rows).items():
                found = [row for row in mine if label in row.frequency]
                if not found:
                    continue
                x = [months.index(row.month) for row in found]
                y = [100 * (row.frequency[label].hz / found[0].frequency[label].hz - 1) for row in found]
                error = [100 * row.frequency[label].std_hz / found[0].frequency[label].hz for row in found]
                axes.errorbar(x, y, yerr=np.nan_to_num(error), color=style.PALE, linewidth=1.0, elinewidth=0.7,
                              zorder=1)
                for place, value, row in zip(x, y, found, strict=True):
                    color, marker = MARKS.get(row.verdict, MARKS[""])
                    seen[row.verdict] = axes.scatter([place], [value], color=getattr(style, color), marker=marker, s=16,
                                                     zorder=2)
                if len(rows_by_turbine(rows)) <= MOST_NAMED:
                    axes.annotate(turbine, (x[-1], y[-1]), xytext=(5, 0), textcoords="offset points", fontsize=7,
                                  va="center")
            style.label_axes(axes, "", f"{label} [%]")
        panels[-1].set_xticks(range(len(months)), months, rotation=30 if len(months) > 4 else 0)
        # one month alone is a column of dots
        panels[-1].set_xlim(-0.5, max(len(months) - 0.5, 0.5))
        figure.legend(list(seen.values()), [verdict or "not diagnosed" for verdict in seen], loc="outside upper right",
                      ncols=len(seen))
        return figure

    return draw()
