"""What is known of every turbine and month, a row each: frequencies, verdict, and what changed since the month
before."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from probupdate.diagnosis.results import read_diagnosis
from probupdate.diagnosis.wording import finding_words, name_of
from probupdate.errors import InputError
from probupdate.farms.description import Farm, Month, natural_order
from probupdate.farms.month import MonthState
from probupdate.io.files import write_table
from probupdate.io.result_table import with_units
from probupdate.modal.modes import read_modes
from probupdate.modal.rounding import robust_std, rounding_std
from probupdate.updating.update_file import read_update

if TYPE_CHECKING:
    import pandas as pd

# left out: a folder that the pattern finds and that is not a campaign
DONE, FAILED, WAITING, LEFT_OUT = "done", "failed", "waiting", "left out"
# standard error of a median beside that of a mean, and by how many of them medians must differ to be said
MEDIAN_ERROR, ERRORS = 1.2533, 3.0
# fewest blocks whose scatter says something
LEAST_BLOCKS = 3


@dataclass(frozen=True, kw_only=True)
class Frequency:
    """A mode's median frequency over a month's blocks, their standard deviation (of the median absolute deviation, so
    that single wrong poles do not count; NaN for fewer than three blocks), and in how many it was found."""

    hz: float
    std_hz: float
    blocks: int


@dataclass(frozen=True, kw_only=True)
class MonthRow:
    """state: done, failed, waiting or left out. frequency: label -> of the modes of interest; parameters: name -> most
    probable value and standard deviation. p_value None where nothing was diagnosed. changes: since the month before of
    this turbine that is known, in words; change: label -> relative change of the frequency."""

    turbine: str
    month: str
    state: str
    failed_step: str = ""
    failed: str = ""
    blocks: int = 0
    frequency: Mapping[str, Frequency]
    parameters: Mapping[str, tuple[float, float]]
    verdict: str = ""
    p_value: float | None = None
    findings: tuple[str, ...] = ()
    causes: tuple[str, ...] = ()
    change: Mapping[str, float]
    changes: tuple[str, ...] = ()


def farm_rows(farm: Farm, known: Mapping[Month, MonthState | None], out: Path) -> list[MonthRow]:
    """In the farm's order."""
    rows: list[MonthRow] = []
    before: dict[str, MonthRow] = {}
    for month in farm.months:
        row = _row(month, farm, known[month], out / month.folder)
        if row.frequency and month.turbine in before:
            row = _with_shift_note(before[month.turbine], row)
        if row.frequency:
            before[month.turbine] = row
        rows.append(row)
    return rows + [replace(_empty_row(turbine, name), state=LEFT_OUT, failed=why)
                   for turbine, name, why in farm.left_out]


def _empty_row(turbine: str, month: str) -> MonthRow:
    return MonthRow(turbine=turbine, month=month, state=WAITING, frequency={}, parameters={}, change={})


def _row(month: Month, farm: Farm, state: MonthState | None, folder: Path) -> MonthRow:
    nothing = _empty_row(month.turbine, month.month)
    if state is None:
        return nothing
    row = replace(nothing, failed_step=state.failed_step, failed=state.failed)
    try:
        if "identify" in state.finished:
            data = read_modes(folder / "modes.json")
            row = replace(row, blocks=len(data.sets), frequency={
                label: found for k, label in enumerate(data.labels)
                if not label.isdigit() and (found := _frequency([s.frequency_hz[k] for s in data.sets])) is not None})
        if "update" in state.finished:
            record = read_update(folder / "update.json")
            row = replace(row, parameters={
                name: (float(value), float(std)) for name, value, std in zip(
                    record.parameters.names, record.map_theta, np.sqrt(np.diag(record.map_covariance)), strict=True)})
        if "diagnose" in state.finished:
            content = read_diagnosis(folder / "diagnosis.json")
            row = replace(row, verdict=content["verdict"], p_value=content["p_value"],
                          findings=tuple(finding_words(f, content) for f in content["findings"]),
                          causes=tuple(name_of(f) for f in content["findings"]))
    except InputError as error:
        row = replace(row, failed_step=row.failed_step or "summary", failed=row.failed or str(error))
    finished = all(step in state.finished for step in farm.steps)
    return replace(row, state=FAILED if row.failed else DONE if finished else WAITING)


def _frequency(values: Sequence[float]) -> Frequency | None:
    found = np.array([v for v in values if np.isfinite(v)])
    if not len(found):
        return None
    middle = float(np.median(found))
    enough = len(found) >= LEAST_BLOCKS
    std = float(robust_std(found - middle, rounding_std(found))) if enough else float("nan")
    return Frequency(hz=middle, std_hz=std, blocks=len(found))


def _with_shift_note(before: MonthRow, row: MonthRow) -> MonthRow:
    """Said of a frequency where the medians differ by more than the blocks of both months scatter and by more than
    three standard errors; of a verdict where it is another one; of causes where one is new or gone."""
    change, words = {}, []
    for label, now in row.frequency.items():
        then = before.frequency.get(label)
        if then is None:
            words.append(f"{label} found at {now.hz:.4g} Hz")
            continue
        change[label] = now.hz / then.hz - 1
        scatter = float(np.hypot(now.std_hz, then.std_hz)) / then.hz
        error = MEDIAN_ERROR * float(np.hypot(*(f.std_hz / np.sqrt(f.blocks) for f in (now, then)))) / then.hz
        if abs(change[label]) > max(scatter, ERRORS * error):
            words.append(f"{label} {100 * change[label]:+.2g} % (scatter {100 * scatter:.2g} %)")
    words += [f"{label} not found" for label in before.frequency if label not in row.frequency]
    if row.verdict and before.verdict and row.verdict != before.verdict:
        words.append(f"verdict {before.verdict} -> {row.verdict}")
    if row.verdict and before.verdict:
        words += [f"new: {cause}" for cause in row.causes if cause not in before.causes]
        words += [f"gone: {cause}" for cause in before.causes if cause not in row.causes]
    return replace(row, change=change, changes=tuple(words))


def labels_of(rows: Sequence[MonthRow]) -> tuple[str, ...]:
    """The modes of interest of all rows, in the order in which they come up."""
    return tuple(dict.fromkeys(label for row in rows for label in row.frequency))


def rows_table(rows: Sequence[MonthRow]) -> pd.DataFrame:
    """A row a turbine and month; frequencies, their standard deviations and changes a column a mode, parameters
    two columns each."""
    import pandas as pd

    names = tuple(dict.fromkeys(name for row in rows for name in row.parameters))
    lines = []
    for row in rows:
        line: dict[str, object] = {"turbine": row.turbine, "month": row.month, "state": row.state, "blocks": row.blocks}
        for label in labels_of(rows):
            found = row.frequency.get(label)
            line |= {f"{label}_hz": found and found.hz, f"{label}_std_hz": found and found.std_hz,
                     f"{label}_blocks": found.blocks if found else 0, f"{label}_change": row.change.get(label)}
        for name in names:
            value, std = row.parameters.get(name, (None, None))
            line |= {name: value, f"{name}_std": std}
        lines.append(line | {
            "verdict": row.verdict, "p_value": row.p_value, "findings": "; ".join(row.findings),
            "changes": "; ".join(row.changes), "failed_step": row.failed_step, "failed": row.failed})
    return with_units(pd.DataFrame(lines))


def write_rows(rows: Sequence[MonthRow], path: Path) -> Path:
    """farm.csv: `rows_table`."""
    return write_table(path, rows_table(rows))


def months_of(rows: Sequence[MonthRow]) -> tuple[str, ...]:
    return tuple(sorted({row.month for row in rows}, key=natural_order))


def rows_by_turbine(rows: Sequence[MonthRow]) -> dict[str, list[MonthRow]]:
    found: dict[str, list[MonthRow]] = {}
    for row in rows:
        found.setdefault(row.turbine, []).append(row)
    return found
