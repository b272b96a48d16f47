"""What each parameter's variance is made of and what to measure next, from the update's record of it."""

from __future__ import annotations

import numpy as np

from probupdate.reporting import figures
from probupdate.reporting.elements import MISSING, Column, Element, Items, Picture, Table, decimal, number, percent
from probupdate.updating.update_file import ComponentsRecord, UpdateRecord

# a narrowing below this share is left blank
LEAST_SHOWN = 0.005


def component_items(update: UpdateRecord) -> list[Element]:
    """Figure and tables; none of an update whose record is of an older format."""
    parts = update.components
    if parts is None:
        return []
    variance = parts.std**2
    total = variance.sum(axis=0)
    share = variance / np.where(total > 0, total, 1.0)
    # a component that nothing came from is not drawn
    there = [k for k in range(len(parts.names)) if np.any(share[k] > 0)]
    names = update.parameters.names
    items: list[Element] = [
        Picture(
            svg=figures.svg_text(
                figures.variance_shares(names, [parts.names[k] for k in there], share[there]), "components"),
            caption="What each parameter's variance is made of, by the Gaussian approximation at the MAP: errors of "
            "the identification, the model's own discrepancy, tolerances by group, and what the prior leaves. A bar "
            "that is all prior was not informed by the data; where identification is large, a longer or better record "
            "helps."),
        _components_table(update, parts, share, total),
    ]
    if parts.measures:
        items.append(_measures_table(update, parts))
    items.append(_responses_table(parts))
    accused = parts.outlying_responses()
    if accused:
        items.append(Items(title="Where the model misses the data", level="warning", statements=tuple(
            f"{name}: chi-square far beyond what is expected of it." for name in accused)))
    return items


def _components_table(update: UpdateRecord, parts: ComponentsRecord, share: np.ndarray, total: np.ndarray) -> Table:
    std, at_one = np.sqrt(np.diag(update.map_covariance)), np.sqrt(total)
    averaged = not np.allclose(std, at_one, rtol=5e-3)
    columns = [Column(name="parameter", number=False), Column(name="unit", number=False),
               Column(name="standard deviation")]
    columns += [Column(name="with the model's error of its most probable size")] if averaged else []
    columns += [Column(name=name, unit="%") for name in parts.names]
    rows = tuple(
        (p.name, p.unit or "-", number(float(std[k])), *([number(float(at_one[k]))] if averaged else []),
         *(percent(s, 0) for s in share[:, k]))
        for k, p in enumerate(update.parameters)
    )
    note = "Shares of the variance at the MAP; a row adds up to 100 %."
    if averaged:
        note += (" They are those with the model's error of its most probable size; the standard deviation is averaged "
                 "over the sizes that it may have.")
    return Table(caption="Components of each parameter's variance", columns=tuple(columns), rows=rows, note=note)


def _measures_table(update: UpdateRecord, parts: ComponentsRecord) -> Table:
    columns = (Column(name="measure", number=False), *(Column(name=n, unit="%") for n in update.parameters.names))
    rows = tuple(
        (what, *(percent(g, 0) if g >= LEAST_SHOWN else MISSING for g in gain))
        for what, gain in zip(parts.measures, parts.gain, strict=True)
    )
    return Table(caption="What to measure next", columns=columns, rows=rows,
                 note="By how much the standard deviation of each parameter would fall, the most useful measure first.")


def _responses_table(parts: ComponentsRecord) -> Table:
    accused = parts.outlying_responses()
    rows = tuple(
        (name, number(float(found)), number(float(expected), 2), decimal(float(found / max(expected, 1e-12)), 2))
        for name, found, expected in zip(parts.responses, parts.chi_square, parts.expected, strict=True)
    )
    columns = (Column(name="response", number=False), Column(name="chi-square", unit="-"),
               Column(name="expected", unit="-"), Column(name="ratio", unit="-"))
    return Table(caption="Fit of each response at the MAP", columns=columns, rows=rows, width="half",
                 marked=frozenset(k for k, name in enumerate(parts.responses) if name in accused),
                 note="By its own marginal covariance. A ratio far below 1: the stated standard deviations are wider "
                 "than these errors. Emphasised: far beyond what chance allows.")
