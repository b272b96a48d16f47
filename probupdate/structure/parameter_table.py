"""[[parameter]] tables of a TOML file -> Parameters: one reader for every form of model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np

from probupdate.errors import InputError, of_file
from probupdate.io.files import read_toml
from probupdate.io.schema import table_as
from probupdate.model.parameters import Parameter, Parameters


@dataclass(frozen=True, kw_only=True)
class ParameterRow:
    """One [[parameter]] table; `cov` is relative to `initial`, and one of cov and std is given, but of a uniform prior,
    whose bounds are all there is."""

    name: str
    initial: float
    unit: str = "-"
    cov: float | None = None
    std: float | None = None
    lower: float = -np.inf
    upper: float = np.inf
    prior: str = "normal"
    update: bool = True
    description: str = ""


@dataclass(frozen=True, kw_only=True)
class ParameterFile:
    """A file of parameters beside a model made of matrices."""

    parameter: list[Mapping[str, object]]
    correlation: Mapping[str, Mapping[str, float]] | None = None
    format: int = 1


KEYS = tuple(ParameterRow.__dataclass_fields__)


def parameter_from_table(table: Mapping, where: str) -> Parameter:
    """One [[parameter]] table."""
    named = table.get("name") if isinstance(table, Mapping) else None
    row = table_as(ParameterRow, table, f"{where} {named}" if isinstance(named, str) else where)
    where = f"{where} {row.name}"
    if (row.cov is None) == (row.std is None) and not (row.prior == "uniform" and row.cov is None):
        raise InputError(where, "needs exactly one of 'cov' and 'std'",
                         "give one of them" if row.cov is None else "keep one of them")
    if row.cov is not None and row.initial == 0:
        raise InputError(where, "'cov' is undefined for an initial value of zero", "give 'std' in the parameter's unit")
    std = np.nan if row.prior == "uniform" else row.std if row.cov is None else row.cov * abs(row.initial)
    try:
        return Parameter(
            name=row.name, unit=row.unit, initial=row.initial, lower=row.lower, upper=row.upper, prior=row.prior,
            std=cast(float, std), description=row.description)
    except InputError as error:
        # the parameter knows its name, not the file it came from
        raise InputError(where, error.problem, error.remedy) from None


def updated_parameters(tables: Sequence[Mapping], where: str, correlation: Mapping | None = None) -> Parameters:
    """The tables with `update` not false, in order. `correlation` maps name -> {name: value}, the rest zero."""
    if not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables):
        raise InputError(f"{where}, parameter", "is not a list of tables", "write [[parameter]] before each")
    rows = [parameter_from_table(t, f"{where}, parameter") for t in tables]
    updated = [t.get("update", True) is not False for t in tables]
    items = tuple(p for p, own in zip(rows, updated, strict=True) if own)
    held = tuple((p.name, p.initial) for p, own in zip(rows, updated, strict=True) if not own)
    if not items:
        raise InputError(f"{where}, parameter", "there are none to update", "list at least one [[parameter]] with "
                         "update = true")
    return Parameters(items, correlation_matrix(items, correlation, where) if correlation else None, held)


def every_parameter(path: str | Path) -> Parameters:
    """All rows of a model's file but its effects, those with `update = false` too."""
    tables = [t for t in read_toml(path).get("parameter", []) if "kind" not in t]
    return updated_parameters([t | {"update": True} for t in tables], str(path))


def correlation_matrix(items: Sequence[Parameter], table: Mapping, where: str) -> np.ndarray:
    """(n_param, n_param) of the priors, from [correlation.<name>] tables. Raises InputError where an entry is no number
    in -1 to 1, names no updated parameter or contradicts another."""
    names = [p.name for p in items]
    matrix, stated = np.eye(len(names)), {(name, name): 1.0 for name in names}
    if not isinstance(table, Mapping) or not all(isinstance(entries, Mapping) for entries in table.values()):
        raise InputError(f"{where}, correlation", "is not a table of tables", "write [correlation.<name>] and in it "
                         "<other name> = 0.5")
    for row, entries in table.items():
        for column, value in entries.items():
            if isinstance(value, bool) or not isinstance(value, int | float) or not -1 <= value <= 1:
                raise InputError(f"{where}, correlation.{row}.{column}", f"{value!r} is not a number in -1 to 1",
                                 "give one")
            for name in (row, column):
                if name not in names:
                    raise InputError(f"{where}, correlation", f"'{name}' is not an updated parameter",
                                     "correct the name")
            if stated.setdefault((min(row, column), max(row, column)), value) != value:
                raise InputError(f"{where}, correlation.{row}.{column}", f"is {value:g}, " + (
                    "and a parameter correlates with itself by 1" if row == column else
                    f"and [correlation.{column}] says {stated[min(row, column), max(row, column)]:g}"),
                    "state each correlation once")
            i, j = names.index(row), names.index(column)
            matrix[i, j] = matrix[j, i] = float(value)
    return matrix


def read_parameters(path: str | Path) -> Parameters:
    """Read a file of [[parameter]] tables (and [correlation.<name>] tables) beside a model made of matrices."""
    content = table_as(ParameterFile, read_toml(path), str(path))
    if content.format != 1:
        raise InputError(f"{path}, format", f"is {content.format}; this version reads 1",
                         "use the version that the file was written for")
    with of_file(path):
        return updated_parameters(content.parameter, str(path), content.correlation)
