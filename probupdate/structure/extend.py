"""A turbine's model with more parameters: effects put into the description, and into the user's file."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy import linalg

from probupdate.errors import InputError
from probupdate.io.files import read_text, write_text
from probupdate.modal.modes import Sensor
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.affine import AffineModel
from probupdate.structure.description import Description
from probupdate.structure.description import updatable_parameters as updated_parameters_of
from probupdate.structure.description_file import parse_description
from probupdate.structure.effect_kinds import KINDS
from probupdate.structure.load import turbine_model, turn_to
from probupdate.structure.parameter_table import read_toml
from probupdate.structure.schema import suggest


@dataclass(frozen=True, kw_only=True)
class EffectParameter:
    """A parameter that a turbine's model gets for an effect: a kind (see `effect_kinds.KINDS`), where it acts (`on`)
    and the kind's own settings.

    `std`, `lower`, `upper` and `prior` are its prior when it is used as a candidate; `initial` the prior's centre where
    that is not the neutral value; `cause` and `location` say it in words.
    """

    name: str
    kind: str
    on: Mapping[str, object] = field(default_factory=dict)
    settings: Mapping[str, object] = field(default_factory=dict)
    std: float
    lower: float
    upper: float
    prior: str = "normal"
    initial: float | None = None
    cause: str = ""
    location: str = ""

    def __post_init__(self):
        if self.kind not in KINDS:
            raise InputError(f"effect {self.name}", f"the kind '{self.kind}' is unknown", suggest(self.kind, KINDS))

    @property
    def neutral(self) -> float:
        """The value at which the structure is as described."""
        return KINDS[self.kind].neutral

    @property
    def unit(self) -> str:
        return KINDS[self.kind].unit

    @property
    def description(self) -> str:
        return f"{self.cause}: {self.location}" if self.cause and self.location else self.cause

    @property
    def parameter(self) -> Parameter:
        """As a candidate, neutral at first."""
        return Parameter(name=self.name, unit=self.unit, initial=self.neutral, std=self.std, lower=self.lower,
                         upper=self.upper, prior=self.prior, description=self.description)

    def table(self) -> dict:
        """As a [[parameter]] of model.toml."""
        table: dict[str, object] = {"name": self.name, "description": self.description, "kind": self.kind}
        if self.on:
            table["on"] = {key: list(v) if isinstance(v, tuple) else v for key, v in self.on.items()}
        table |= {key: list(v) if isinstance(v, tuple) else v for key, v in self.settings.items()}
        return table | {
            "unit": self.unit, "initial": float(self.neutral if self.initial is None else self.initial),
            "std": float(self.std), "lower": float(self.lower), "upper": float(self.upper), "prior": self.prior,
            "update": True,
        }


def extended_description(path: str | Path, effects: Sequence[EffectParameter]) -> Description:
    """The model file's description with the effects as further parameters."""
    raw = read_toml(path)
    if "matrices" in raw:
        raise InputError(str(path), "a model of matrices takes no effects", "its own parameters are its effects")
    tables = raw.get("parameter", [])
    tables = tables if isinstance(tables, list) else [tables]
    return parse_description(raw | {"parameter": [*tables, *(effect.table() for effect in effects)]}, str(path))


def extended_model(
    path: str | Path,
    effects: Sequence[EffectParameter],
    *,
    parameters: Parameters | None = None,
    sensors: Sequence[Sensor] | None = None,
    nacelle_angle_deg: float | None = None,
    turns_deg: Sequence[float] = (),
) -> AffineModel:
    """The turbine of a model.toml with the effects as parameters behind its own, at the centres of their priors.

    `parameters` replaces the updated ones of the file (not the effects); `sensors` and `nacelle_angle_deg` as in
    `load_model`, `turns_deg` as in `turbine_model`. The model that `write_extended` writes is this one.
    """
    description = extended_description(path, effects)
    if parameters is not None:
        parameters = _append_effects(parameters, description, effects)
    return turbine_model(description, where=str(path), parameters=parameters, sensors=sensors,
                         turn_deg=turn_to(description, nacelle_angle_deg), turns_deg=turns_deg)


def _append_effects(parameters: Parameters, description: Description, effects: Sequence[EffectParameter]) -> Parameters:
    names = {effect.name for effect in effects}
    added = tuple(p for p in updated_parameters_of(description, description.name) if p.name in names)
    correlation = parameters.correlation
    if correlation is not None:
        correlation = linalg.block_diag(correlation, np.eye(len(added)))
    return Parameters((*parameters.items, *added), correlation, parameters.held)


def extended_text(path: str | Path, effects: Sequence[EffectParameter]) -> str:
    """The user's file as it is, with a [[parameter]] table per effect at its end."""
    extended_description(path, effects)
    own = read_text(path)
    own += "" if own.endswith("\n") else "\n"
    return own + "".join(f"\n{parameter_text(effect.table())}" for effect in effects)


def write_extended(path: str | Path, effects: Sequence[EffectParameter], out: str | Path) -> Path:
    """Write the extended model file to `out`; `load_model` reads it."""
    return write_text(out, extended_text(path, effects))


def parameter_text(table: Mapping) -> str:
    """A [[parameter]] table in TOML."""
    return "[[parameter]]\n" + "".join(f"{key} = {_toml(value)}\n" for key, value in table.items() if value != "")


def _toml(value) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        # JSON's escapes are TOML's
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return repr(value) if math.isfinite(value) else f"{value:+}".replace("infinity", "inf")
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_toml(v)}" for key, v in value.items()) + " }"
    return "[" + ", ".join(_toml(v) for v in value) + "]"
