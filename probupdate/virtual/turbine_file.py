"""Reads what the virtual turbine needs from a model.toml, by itself: no schema is shared with the updated model."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from probupdate.errors import InputError, of_file, parsing
from probupdate.io import files
from probupdate.modal.modes import Sensor
from probupdate.model.parameters import Parameter

# Table 2 of the paper and the value that leaves the described structure as it is; m_h is the hub's own mass
NEUTRAL = MappingProxyType({
    "k_j": 1.0, "k_t": 1.0, "k_TP": 1.0, "k_p": 1.0, "LJF": 1.0, "D_l": 1.0, "t_l": 1.0, "D_b": 1.0, "t_b": 1.0,
    "sc": 0.0, "corr": 0.0, "mg": 0.0, "a_m": 1.0, "py": 1.0, "tz": 1.0, "qw": 1.0,
})


@dataclass(frozen=True, eq=False, kw_only=True)
class TurbineFile:
    """A parsed model.toml: `raw` the tables, `sensors` the channels in column order with the part each sits on,
    `parameters` every [[parameter]] by name."""

    path: Path
    raw: Mapping
    sensors: tuple[Sensor, ...]
    parts: tuple[str, ...]
    parameters: Mapping[str, Parameter]

    def value(self, *keys: str) -> Any:
        """The entry under a path of keys; a missing one is the user's mistake."""
        here: Any = self.raw
        for depth, key in enumerate(keys):
            if not isinstance(here, Mapping) or key not in here:
                raise InputError(f"{self.path}, {'.'.join(keys[: depth + 1])}", "is missing", "add it to the model")
            here = here[key]
        return here

    def number(self, *keys: str, positive: bool = False) -> float:
        value = self.value(*keys)
        where = f"{self.path}, {'.'.join(keys)}"
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
            raise InputError(where, f"{value!r} is not a finite number", "give one in SI units")
        if positive and value <= 0:
            raise InputError(where, f"{value} is not positive", "give a number above zero")
        return float(value)

    def is_updated(self, name: str) -> bool:
        """Whether the file lets the parameter vary: only those are drawn from their prior."""
        return any(entry["name"] == name and entry.get("update", True) for entry in self.raw["parameter"])

    def initial_parameters(self) -> dict[str, float]:
        """Every parameter of Table 2 at the file's initial value; those it does not list act neutrally."""
        hub = [body for body in self.value("rna") if body.get("name") == "hub"]
        if len(hub) != 1:
            raise InputError(f"{self.path}, rna", f"{len(hub)} bodies are named 'hub'", "name exactly one so")
        values = {**NEUTRAL, "m_h": float(hub[0]["mass_kg"])}
        return values | {name: p.initial for name, p in self.parameters.items()}


def reference_file() -> Path:
    """The packaged reference turbine in its updated state: what a virtual campaign measures unless stated otherwise."""
    return Path(__file__).resolve().parents[1] / "reference" / "updated.toml"


def read_toml(path: Path, what: str) -> dict:
    """Parse a TOML file; every way in which that fails is one line."""
    return files.read_toml(path, absent=f"give the {what} itself")


def unknown_name(where: str, name: str, known) -> InputError:
    near = difflib.get_close_matches(name, known, n=1)
    remedy = f"did you mean '{near[0]}'?" if near else f"choose from {', '.join(known)}"
    return InputError(where, f"'{name}' is unknown", remedy)


def read_turbine(path: str | Path) -> TurbineFile:
    """Read a model.toml that describes the turbine by its geometry."""
    path = Path(path)
    with of_file(path), parsing(str(path), "is not a model of a turbine", "see docs/formats/model.md"):
        return _turbine(path)


def _turbine(path: Path) -> TurbineFile:
    raw = read_toml(path, "model file")
    if "jacket" not in raw:
        form = next((f"describes a turbine with [{name}]" for name in ("monopile", "foundation") if name in raw),
                    "describes no turbine by its geometry")
        raise InputError(str(path), f"{form}, and the virtual turbine is built on jackets alone",
                         "give a model.toml with [jacket] (`probupdate template jacket OUT`), or measured records")
    sensors, parts = [], []
    for number, entry in enumerate(raw.get("sensor", [])):
        where = f"{path}, sensor {entry.get('channel', number)}"
        missing = [key for key in ("channel", "level", "part", "position_m", "direction") if key not in entry]
        if missing:
            raise InputError(where, f"{', '.join(missing)} is missing", "add it")
        known = ("channel", "level", "position_m", "direction", "quantity", "unit", "gravity")
        kept = {key: entry[key] for key in known if key in entry}
        sensors.append(Sensor(**kept))
        parts.append(str(entry["part"]))
        if sensors[-1].quantity != "acceleration":
            raise InputError(where, f"measures {sensors[-1].quantity}", "the virtual loggers write acceleration only")
    if not sensors:
        raise InputError(str(path), "lists no [[sensor]]", "add the channels to be measured")
    parameters = {}
    for entry in raw.get("parameter", []):
        known = (*NEUTRAL, "m_h")
        name = entry.get("name", "")
        where = f"{path}, parameter {name}"
        if name not in known:
            raise unknown_name(where, name, known)
        if "initial" not in entry:
            raise InputError(where, "initial is missing", "add it")
        if "std" not in entry and "cov" not in entry:
            raise InputError(where, "std and cov are missing", "give one of them")
        parameters[name] = Parameter(
            name=name,
            unit=str(entry.get("unit", "-")),
            initial=float(entry["initial"]),
            std=float(entry["std"] if "std" in entry else entry["cov"] * abs(entry["initial"])),
            lower=float(entry.get("lower", -np.inf)),
            upper=float(entry.get("upper", np.inf)),
            prior=str(entry.get("prior", "normal")),
        )
    return TurbineFile(
        path=path, raw=MappingProxyType(raw), sensors=tuple(sensors), parts=tuple(parts),
        parameters=MappingProxyType(parameters),
    )
