"""A farm's months that are not finished, on an executor or as one shard of an array; then what is known of all of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from probupdate.errors import InputError, ProbupdateError
from probupdate.farms.description import Farm, Month, read_farm
from probupdate.farms.joint import JointRun, refuse_other_parameters, run_joint
from probupdate.farms.month import MonthState, ended_month, is_done, month_sources, read_state, run_month
from probupdate.farms.page import write_page
from probupdate.farms.records import read_kept, record_table
from probupdate.farms.summary import FAILED, LEFT_OUT, WAITING, MonthRow, farm_rows, rows_table, write_rows
from probupdate.io.files import is_empty_folder, read_json_table, remove_stale, write_json
from probupdate.runtime.executors import Executor, Shard, executor
from probupdate.runtime.progress import Progress, silent

if TYPE_CHECKING:
    import pandas as pd

HEAD, TABLE, PAGE = "farm.json", "farm.csv", "farm.html"
ANEW = "give an empty directory, or the farm's own"


@dataclass(frozen=True, eq=False, kw_only=True)
class FarmRun:
    """rows: what is known of every turbine and month; run: how many months were worked on now; joint: the inference for
    all turbines, None where farm.toml asks for none or this was a shard; folder holds farm.csv, farm.html, of a joint
    inference farm_joint.json and farm_joint.csv, and a folder per turbine and month."""

    folder: Path
    rows: tuple[MonthRow, ...]
    run: int
    joint: JointRun | None = None

    @property
    def failed(self) -> tuple[MonthRow, ...]:
        return tuple(row for row in self.rows if row.state == FAILED)

    def to_frame(self) -> pd.DataFrame:
        """farm.csv: a row a turbine and month."""
        return rows_table(self.rows)

    @property
    def summary(self) -> str:
        months = [row for row in self.rows if row.state != LEFT_OUT]
        done = sum(row.state not in (FAILED, WAITING) for row in months)
        waiting = sum(row.state == WAITING for row in self.rows)
        turbines = len({row.turbine for row in self.rows})
        lines = [f"{turbines} turbines, {len(months)} turbine-months: {done} done ({self.run} worked on now), "
                 f"{len(self.failed)} failed, {waiting} waiting"]
        lines += [f"{row.turbine}, {row.month}: failed at {row.failed_step}: {row.failed}" for row in self.failed]
        lines += [f"{row.turbine}, {row.month}: {'; '.join(row.changes)}" for row in self.rows if row.changes]
        lines += [f"{row.turbine}, {row.month}: left out: {row.failed}" for row in self.rows if row.state == LEFT_OUT]
        if self.joint is not None:
            lines.append(self.joint.found.summary if self.joint.found else f"joint inference: {self.joint.failed}")
        return "\n".join([*lines, f"open {self.folder / PAGE}"])


def farm(
    description: str | Path, out: str | Path, *, shard: str | Shard | None = None, jobs: int | Executor = 1,
    progress: Progress = silent,
) -> FarmRun:
    """The steps of every turbine and month of a farm.toml into `out`; those that are finished are not repeated, a month
    that fails is one line of the result and is tried again by the next run, the others go on.

    A month's results are made again where its records, its model, the options, the seed or the version have changed;
    the joint inference of [joint] where a month's result has.
    shard: '3/8', the share of one job of an array; all jobs write into the same `out`. jobs: processes, or an executor.
    Raises InputError where the description is wrong or `out` holds something else.
    """
    description, out = Path(description), Path(out)
    read = read_farm(description)
    if read.joint is not None:
        refuse_other_parameters(read)
    share = Shard.parse(shard) if isinstance(shard, str) else shard
    claim_folder(out, read)
    known = {month: _stored_state(out / month.folder) for month in read.months}
    mine = list(read.months) if share is None else share.chunk(read.months)
    # the records of a month that was never begun are read where it is worked on
    todo = [month for month in mine
            if known[month] is None or not is_done(known[month], read, _input_hashes(month, read, out / month.folder))]
    progress("turbine-months", len(mine) - len(todo), len(mine))
    with executor(jobs) as runs:
        lost = partial(_ended_from_outside, farm=read, out=out)
        results = runs.as_completed(run_one, [(month, read, out) for month in todo], least=1, lost=lost)
        for count, (month, state) in enumerate(results, 1):
            known[month] = state
            progress("turbine-months", len(mine) - len(todo) + count, len(mine))
        # what other shards finished meanwhile
        known = {month: state if month in todo else _stored_state(out / month.folder) for month, state in known.items()}
        # of all turbines: no shard's, which know not of one another
        joint = run_joint(read, known, out, jobs=runs, progress=progress) if read.joint and share is None else None
    rows = farm_rows(read, known, out)
    write_rows(rows, out / TABLE)
    write_page(read, rows, out / PAGE, joint)
    remove_stale(out)
    return FarmRun(folder=out, rows=tuple(rows), run=len(todo), joint=joint)


def run_one(month: Month, farm: Farm, out: Path) -> tuple[Month, MonthState]:
    return month, run_month(month, farm, out)


def _ended_from_outside(task: tuple, *, farm: Farm, out: Path) -> tuple[Month, MonthState]:
    return task[0], ended_month(task[0], farm, out)


def _input_hashes(month: Month, farm: Farm, folder: Path) -> dict[str, str]:
    try:
        return month_sources(month, farm, record_table(month.campaign / "acceleration", read_kept(folder)))
    except (ProbupdateError, OSError):
        # said by the month itself
        return {}


def _stored_state(folder: Path) -> MonthState | None:
    try:
        return read_state(folder)
    except InputError as error:
        return MonthState(format=0, made_of={}, finished={}, failed_step="the state kept", failed=str(error))


def claim_folder(out: Path, farm: Farm) -> None:
    """Refuses a folder of something else, and one of another farm by name."""
    path = out / HEAD
    # asked before the head: another shard may write that one meanwhile
    foreign = not is_empty_folder(out)
    if path.exists():
        found = read_json_table(path, ANEW).get("name")
        if found != farm.name:
            raise InputError(str(out), f"holds the results of the farm '{found}', not of '{farm.name}'", ANEW)
    elif foreign:
        raise InputError(str(out), "is not empty and holds no farm's results", ANEW)
    else:
        write_json(path, {"format": 1, "name": farm.name})
