"""farm_joint.json: one inference for the turbines of a design, as rows for tables and in words."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from probupdate.errors import InputError
from probupdate.io.files import read_json_table, write_json
from probupdate.io.json_rows import from_table, row_of
from probupdate.io.result_table import OWN_UNIT, table_of
from probupdate.updating.settings import CONSTANTS

if TYPE_CHECKING:
    import pandas as pd

FORMAT = 1
TRUSTED_K = CONSTANTS.trusted_k
# rows of what to measure next that are said
SHOWN = 5


@dataclass(frozen=True, kw_only=True)
class PopulationRow:
    """One parameter. tikhonov, tikhonov_std: the stacked estimate; mean, std, low, high: posterior of a common
    parameter or of a varying one's mean, with 90 % interval, NaN of a turbine's own; tau, tau_low, tau_high: scatter
    between turbines, median and 90 % interval, tau_prior the hyper-prior's median, a CoV where tau_relative, else in
    `unit`; inherited_*: of a turbine without sensors."""

    parameter: str
    unit: str
    role: str
    prior_mean: float
    prior_std: float
    tikhonov: float
    tikhonov_std: float
    mean: float
    std: float
    low: float
    high: float
    tau: float
    tau_low: float
    tau_high: float
    tau_prior: float
    tau_relative: bool
    inherited_mean: float
    inherited_std: float
    inherited_low: float
    inherited_high: float


@dataclass(frozen=True, kw_only=True)
class TurbineRow:
    """One parameter of one turbine: estimate, posterior with 90 % interval; alone_std: what this turbine's data alone
    would leave; odd: probability that it is unlike the others in this parameter, limit the shift that is found in 95 %
    of cases, both NaN of a turbine's own; at_bound: the estimate lies at a bound of the prior."""

    turbine: str
    parameter: str
    unit: str
    role: str
    tikhonov: float
    tikhonov_std: float
    mean: float
    std: float
    low: float
    high: float
    alone_std: float
    odd: float
    limit: float
    at_bound: bool


@dataclass(frozen=True, kw_only=True)
class MonthValue:
    """A varying or own parameter of one turbine by one month's sets alone, given what all turbines have in common;
    changed: since the month before by more than three standard deviations of both."""

    turbine: str
    month: str
    parameter: str
    unit: str
    value: float
    std: float
    changed: bool


@dataclass(frozen=True, kw_only=True)
class NextRow:
    """A measurement, its turbine ('' for one without sensors so far), and what it is expected to say in bits: about
    what all turbines share, about all parameters of that turbine."""

    turbine: str
    measurement: str
    farm_bits: float
    turbine_bits: float


@dataclass(frozen=True, eq=False, kw_only=True)
class FarmJoint:
    """turbines with the probability of each to be unlike the others (`odd_probability`); population, rows, months and
    next: tables; pareto_k, effective, draws: of the weights that correct the linearisation (k null where there was
    nothing to correct); corrected: whether they are applied; settled: the stacked estimate; converged: the chain."""

    turbines: tuple[str, ...]
    odd_probability: tuple[float, ...]
    population: tuple[PopulationRow, ...]
    rows: tuple[TurbineRow, ...]
    months: tuple[MonthValue, ...]
    next: tuple[NextRow, ...]
    settled: bool
    converged: bool
    corrected: bool
    pareto_k: float
    effective: float
    draws: int
    verdict: str
    notes: tuple[str, ...]
    settings: dict[str, str]

    def to_frame(self) -> pd.DataFrame:
        """farm_joint.csv: a row a turbine and parameter."""
        values = ("tikhonov", "mean", "low", "high", "alone_std", "limit")
        return table_of(self.rows, units=dict.fromkeys((*values, "std", "tikhonov_std"), OWN_UNIT))

    @property
    def summary(self) -> str:
        return "\n".join(sentences(self))

    def write(self, path: str | Path) -> Path:
        return write_joint(self, path)


def sentences(found: FarmJoint) -> list[str]:
    """What the joint inference says: what is shared, who is odd, what to measure next, what not to trust."""
    lines = [f"joint inference of {len(found.turbines)} turbines: {found.verdict}"]
    for row in found.population:
        if row.role == "own":
            continue
        what = row.parameter if row.role == "common" else f"{row.parameter}, mean over turbines,"
        unit = "" if row.unit == "-" else f" {row.unit}"
        text = f"{what} {row.mean:.4g}{unit} ({row.low:.4g} to {row.high:.4g}; prior {row.prior_mean:.4g} +- " \
               f"{row.prior_std:.3g}, Tikhonov {row.tikhonov:.4g} +- {row.tikhonov_std:.2g})"
        if row.role == "varying":
            scatter = " a share of it" if row.tau_relative else unit
            text += f"; scatter between turbines {row.tau:.2g}{scatter}" \
                    f" ({row.tau_low:.2g} to {row.tau_high:.2g}; hyper-prior's median {row.tau_prior:.2g})"
        lines.append(text)
    lines += found.notes
    lines += [f"{m.turbine}, {m.month}: {m.parameter} has changed since the month before, to {m.value:.4g} +- "
              f"{m.std:.2g}{'' if m.unit == '-' else ' ' + m.unit}" for m in found.months if m.changed]
    if found.next:
        lines.append("what to measure next, by expected information about what all turbines share: " + "; ".join(
            f"{r.measurement} at {r.turbine or 'a turbine without sensors'} ({r.farm_bits:.2f} bits, "
            f"{r.turbine_bits:.2f} about that turbine)" for r in found.next[:SHOWN]))
    return lines


def write_joint(found: FarmJoint, path: str | Path) -> Path:
    content = row_of_plain(found)
    return write_json(Path(path), {"format": FORMAT, **content})


def row_of_plain(found: FarmJoint) -> dict:
    plain = {name: getattr(found, name) for name in FarmJoint.__dataclass_fields__}
    tables = {name: [row_of(r) for r in plain[name]] for name in ("population", "rows", "months", "next")}
    k = found.pareto_k if np.isfinite(found.pareto_k) else None
    return plain | tables | {"pareto_k": k}


def read_joint(path: str | Path) -> FarmJoint:
    """Read farm_joint.json; raises InputError where it is none."""
    path, again = Path(path), "write it with `probupdate farm` of a farm.toml with [joint]"
    c = read_json_table(path, again, absent=again)
    found = from_table(FarmJoint, c, path, again, name="farm_joint.json", file_format=FORMAT)
    if len(found.odd_probability) != len(found.turbines):
        raise InputError(str(path), "does not hold one probability for each turbine", again)
    return found
