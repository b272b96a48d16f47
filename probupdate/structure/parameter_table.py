"""[[parameter]] tables of a TOML file -> Parameters: one reader for every form of model."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from probupdate.errors import InputError, of_file, parsing
from probupdate.files import read_toml
from probupdate.parameters import Parameter, Parameters

KEYS = ("name", "unit", "initial", "cov", "std", "lower", "upper", "prior", "update", "description")
NUMBERS = ("initial", "cov", "std", "lower", "upper")


def parameter_from_table(table: Mapping, where: str) -> Parameter:
    """One [[parameter]] table; `cov` is relative to `initial`."""
    for key in table:
        if key not in KEYS:
            close = difflib.get_close_matches(key, KEYS, n=1)
            raise InputError(where, f"unknown key '{key}'", f"did you mean '{close[0]}'?" if close else "remove it")
    for key in ("name", "initial"):
        if key not in table:
            raise InputError(where, f"'{key}' is missing", "give name, unit, initial, cov or std, lower, upper, prior")
    where = f"{where} {table['name']}"
    for key in NUMBERS:
        if key in table and (isinstance(table[key], bool) or not isinstance(table[key], int | float)):
            raise InputError(f"{where}, {key}", f"{table[key]!r} is not a number", "write a number without quotes")
    if ("cov" in table) == ("std" in table):
        raise InputError(where, "needs exactly one of 'cov' and 'std'", "keep one of them")
    initial = float(table["initial"])
    std = float(table["std"]) if "std" in table else float(table["cov"]) * abs(initial)
    if "cov" in table and initial == 0:
        raise InputError(where, "'cov' of an initial value of zero says nothing", "give 'std' in the parameter's unit")
    if not isinstance(table.get("update", True), bool):
        raise InputError(f"{where}, update", f"{table['update']!r} is neither true nor false", "write one of them")
    try:
        return Parameter(
            name=str(table["name"]),
            unit=str(table.get("unit", "-")),
            initial=initial,
            std=std,
            lower=float(table.get("lower", -np.inf)),
            upper=float(table.get("upper", np.inf)),
            prior=str(table.get("prior", "normal")),
            description=str(table.get("description", "")),
        )
    except InputError as error:
        # the parameter knows its name, not the file it came from
        raise InputError(where, error.problem, error.remedy) from None


def updated_parameters(tables: Sequence[Mapping], where: str, correlation: Mapping | None = None) -> Parameters:
    """The tables with `update` not false, in order. `correlation` maps name -> {name: value}, the rest zero."""
    if not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables):
        raise InputError(f"{where}, parameter", "is not a list of tables", "write [[parameter]] before each")
    items = tuple(
        parameter_from_table(t, f"{where}, parameter") for t in tables if t.get("update", True) is not False
    )
    if not items:
        raise InputError(f"{where}, parameter", "there are none to update", "list at least one [[parameter]] with "
                         "update = true")  # fmt: skip
    return Parameters(items, correlation_matrix(items, correlation, where) if correlation else None)


def every_parameter(path: str | Path) -> Parameters:
    """All rows of a model's file but its effects, those with `update = false` too."""
    tables = [t for t in read_toml(path).get("parameter", []) if "kind" not in t]
    return updated_parameters([t | {"update": True} for t in tables], str(path))


def correlation_matrix(items: Sequence[Parameter], table: Mapping, where: str) -> np.ndarray:
    names = [p.name for p in items]
    matrix = np.eye(len(names))
    if not isinstance(table, Mapping) or not all(isinstance(entries, Mapping) for entries in table.values()):
        raise InputError(f"{where}, correlation", "is not a table of tables", "write [correlation.<name>] and in it "
                         "<other name> = 0.5")  # fmt: skip
    for row, entries in table.items():
        for column, value in entries.items():
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise InputError(f"{where}, correlation.{row}.{column}", f"{value!r} is not a number", "give one")
            for name in (row, column):
                if name not in names:
                    raise InputError(f"{where}, correlation", f"'{name}' is no updated parameter", "mend the name")
            i, j = names.index(row), names.index(column)
            matrix[i, j] = matrix[j, i] = float(value)
    return matrix


def read_parameters(path: str | Path) -> Parameters:
    """Read a file of [[parameter]] tables (and [correlation.<name>] tables) beside a model made of matrices."""
    content = read_toml(path)
    for key in content:
        if key not in ("parameter", "correlation", "format"):
            raise InputError(str(path), f"unknown key '{key}'", "keep [[parameter]] and [correlation] only")
    if "parameter" not in content:
        raise InputError(str(path), "there is no [[parameter]]", "list at least one")
    with of_file(path), parsing(str(path), "is no file of parameters", "see parameters.toml in the README"):
        return updated_parameters(content["parameter"], str(path), content.get("correlation"))
