"""A model of matrices with one parameter more for each named group of its own, whose members move together, and with
channels that read another place."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import sparse

from probupdate.errors import InputError
from probupdate.io.files import write_arrays, write_text
from probupdate.model.parameters import Parameters
from probupdate.structure.extend import parameter_text
from probupdate.structure.load import matrices_file
from probupdate.structure.matrices import SPARSE_PARTS, matrix_of, read_archive

# what of a file says what its channels read
CHANNEL_ARRAYS = ("channel_dof", "channel_sign", "channel_tilt_dof", "channel_tilt_sign",
                  *(f"{key}{part}" for key in ("channel_row", "channel_tilt_row") for part in ("", *SPARSE_PARTS)))


@dataclass(frozen=True, kw_only=True)
class Group:
    """`parts`: member -> its change for a value of one of the group's parameter, which is neutral at zero; its prior's
    centre `initial` and `std`, `lower` and `upper` are in that unit."""

    name: str
    parts: Mapping[str, float]
    std: float
    initial: float = 0.0
    lower: float = -np.inf
    upper: float = np.inf
    unit: str = "-"
    description: str = ""

    def bounds(self, parameters: Parameters) -> tuple[float, float]:
        """Those given, and no farther than takes a member from its initial value to its own bound."""
        lower, upper = self.lower, self.upper
        for name, change in self.parts.items():
            if change:
                p = parameters.items[parameters.index(name)]
                ends = sorted(((p.lower - p.initial) / change, (p.upper - p.initial) / change))
                lower, upper = max(lower, ends[0]), min(upper, ends[1])
        return float(lower), float(upper)


def group_parameter(name: str, taken: Sequence[str]) -> str:
    """What the group is called in the file, unlike the names taken: letters, digits and underscores, as it is part of
    a matrix's name."""
    short = re.sub(r"\W+", "_", name).strip("_") or "group"
    # an ending like that of CSR parts would be taken for one
    if short.endswith(SPARSE_PARTS) or short == "0":
        short += "_group"
    while short in taken:
        short += "_group"
    return short


def write_grouped(
    path: str | Path, parameters: Parameters, groups: Sequence[Group], out: str | Path, *,
    channel_rows: sparse.csr_array | None = None,
) -> Path:
    """Write the model at `path` (model.npz, or a model.toml with [matrices]) with the groups as further parameters:
    `out` (.toml) and the matrices beside it, <stem>.npz. `load_model` reads it.

    K(theta, g) = K0 + sum theta_k K_k + g sum a_k K_k, M likewise. `parameters`: the model's own, as they are to stand
    in the file; `channel_rows` (n_channel, n), or with tilts below (2 n_channel, n): what the channels read, where
    that is not what the file says. Raises
    InputError where a group leaves the matrices as they are, or would be written over its source.
    """
    source, name = matrices_file(path)
    out = Path(out)
    target = out.with_suffix(".npz")
    if target.resolve() == source.resolve() or out.resolve() == Path(path).resolve():
        raise InputError(str(out), "is the model itself", "write the extended one to another place")
    content = read_archive(source)
    if channel_rows is not None:
        content = {key: array for key, array in content.items() if key not in CHANNEL_ARRAYS}
        n = len(content["channel"])
        content |= _csr_parts("channel_row", channel_rows[:n])
        if channel_rows.shape[0] > n:
            content |= _csr_parts("channel_tilt_row", channel_rows[n:])
    content = _hold_parameters(source, content, parameters.held)
    tables = [_table(p) for p in parameters]
    for group in groups:
        called = group_parameter(group.name, [t["name"] for t in tables])
        added = _sum_group(source, content, group, called)
        if not added:
            raise InputError(f"group {group.name}", "its members' matrices add up to nothing", "correct its changes")
        content |= added
        lower, upper = group.bounds(parameters)
        description = group.description or f"{group.name}: {', '.join(f'{a:+g} {k}' for k, a in group.parts.items())}"
        tables.append({"name": called, "description": description, "unit": group.unit,
                       "initial": float(np.clip(group.initial, lower, upper)), "std": float(group.std), "lower": lower,
                       "upper": upper, "prior": "normal", "update": True})
    write_arrays(target, content)
    text = f"name = {json.dumps(name)}\n\n[matrices]\nfile = {json.dumps(target.name)}\n\n"
    return write_text(out, text + "\n".join(parameter_text(t) for t in tables) + _correlation_text(parameters))


def _hold_parameters(source: Path, content: Mapping, held: Sequence[tuple[str, float]]) -> dict[str, np.ndarray]:
    """The arrays with the matrices of parameters that are held at a value added to K0 and M0, in CSR parts."""
    result = dict(content)
    for kind in ("K", "M"):
        total = matrix_of(source, content, f"{kind}0")
        own = [(f"{kind}_{name}", value) for name, value in held
               if f"{kind}_{name}" in content or f"{kind}_{name}_data" in content]
        for key, value in own:
            total = total + value * matrix_of(source, content, key)
        if own:
            taken = [key + part for key in (f"{kind}0", *(k for k, _ in own)) for part in ("", *SPARSE_PARTS)]
            result = {key: array for key, array in result.items() if key not in taken}
            result |= _csr_parts(f"{kind}0", sparse.csr_array(total))
    return result


def _sum_group(source: Path, content: Mapping, group: Group, called: str) -> dict[str, np.ndarray]:
    """K_<called> and M_<called>, dense or in CSR parts as K0 and M0 are; none that is zero."""
    result = {}
    for kind in ("K", "M"):
        total = None
        for name, change in group.parts.items():
            key = f"{kind}_{name}"
            if change and (key in content or f"{key}_data" in content):
                one = float(change) * matrix_of(source, content, key)
                total = one if total is None else total + one
        if total is None or not abs(total).max():
            continue
        if f"{kind}0" in content:
            result[f"{kind}_{called}"] = total.toarray()
        else:
            result |= _csr_parts(f"{kind}_{called}", sparse.csr_array(total))
    return result


def _csr_parts(key: str, rows: sparse.csr_array) -> dict[str, np.ndarray]:
    return {f"{key}{part}": values
            for part, values in zip(SPARSE_PARTS, (rows.data, rows.indices, rows.indptr), strict=True)}


def parameters_text(parameters: Parameters) -> str:
    """The TOML of a model's parameters, as `read_parameters` reads it."""
    return "\n".join(parameter_text(_table(p)) for p in parameters) + _correlation_text(parameters)


def _table(p) -> dict:
    return {"name": p.name, "description": p.description, "unit": p.unit, "initial": float(p.initial),
            "std": float(p.std), "lower": float(p.lower), "upper": float(p.upper), "prior": p.prior,
            "update": True}


def _correlation_text(parameters: Parameters) -> str:
    if parameters.correlation is None:
        return ""
    text, names = "", parameters.names
    for i, name in enumerate(names):
        pairs = [(names[j], parameters.correlation[i, j]) for j in range(i) if parameters.correlation[i, j]]
        if pairs:
            text += f"\n[correlation.{json.dumps(name)}]\n"
            text += "".join(f"{json.dumps(other)} = {float(value)!r}\n" for other, value in pairs)
    return text
