"""The model a step is given, and as it stood while a set was measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, is_dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TypeGuard

import numpy as np

from probupdate.effects.alternatives import AlternativeModels
from probupdate.effects.tolerances import SensorUncertainty, TurbineUncertainty
from probupdate.errors import InputError, names_files
from probupdate.io.files import read_bytes
from probupdate.modal.matching import with_stated_gravity
from probupdate.modal.modes import ModalData, ModalSet, Sensor
from probupdate.model.interface import Model
from probupdate.model.parameters import Parameters
from probupdate.structure.functions import FunctionModel
from probupdate.structure.load import REFERENCE_STATES, load_model, model_sensors, nacelle_angle_deg, reference_model
from probupdate.structure.own_modes import OwnModes, lying_doubt, modes_of_model, unused_of
from probupdate.structure.readings import gravity_words
from probupdate.structure.subdyn_model import is_subdyn, subdyn_sensors, turns_nacelle

# what steps are given: a file or the name of a state of the reference turbine, or a model already made
GivenModel = str | Path | Model


def model_path(model: str | Path) -> Path:
    """A file, or one of 'design', 'as_built', 'updated' for the reference turbine."""
    return reference_model(str(model)) if str(model) in REFERENCE_STATES else Path(model)


def parts_elsewhere(model: str | Path | None = None, parameters: str | Path | None = None) -> dict[str, Path]:
    """Parts of a run that lie elsewhere -> where."""
    given = {"model": None if model is None else model_path(model), "parameters": parameters}
    return {name: Path(path) for name, path in given.items() if path is not None}


def refuse_no_model(model: object) -> None:
    """Raises InputError for what is neither a file's path nor a model."""
    if isinstance(model, str | Path) or (hasattr(model, "solve") and hasattr(model, "parameters")):
        return
    kind = type(model).__name__
    if isinstance(model, ModalData):
        raise InputError("model", "modal data were given in the model's place", "give the model first, then the modes")
    raise InputError("model", f"a {kind} is not a model", "give a path, a model or a FunctionModel around a function")


def refuse_other_value(name: str, value: object, kind: type) -> None:
    """Raises InputError where a step is given another value than its settings, such as a word or another step's."""
    if not isinstance(value, kind):
        raise InputError(name, f"a value of type {type(value).__name__}, where {kind.__name__} is expected",
                         f"give probupdate.{kind.__name__}(...)")


def open_model(
    model: GivenModel, parameters: str | Path | Parameters | None = None, sensors: tuple[Sensor, ...] | None = None, *,
    nacelle_angle_deg: float | None = None, fix: Mapping[str, float] | None = None,
) -> Model:
    """A path, a name of the reference turbine's states, or a model already made (such as a FunctionModel); `fix`:
    parameters that are held at a value."""
    if not isinstance(model, str | Path):
        refuse_no_model(model)
        if not fix:
            return model
        if not isinstance(model, FunctionModel):
            raise InputError("fix", f"parameters cannot be held in a {type(model).__name__} that was opened before",
                             "give the model's file, or a FunctionModel")
        return model.hold_parameters(fix)
    place = {"sensors": sensors, "nacelle_angle_deg": nacelle_angle_deg}
    opened = load_model(model_path(model), parameters=parameters, **place)
    return load_model(model_path(model), parameters=opened.parameters.hold_parameters(fix), **place) if fix else opened


@dataclass(frozen=True, eq=False)
class ModelAt:
    """The model as it stood while a set was measured: a turbine's rotor and nacelle look where they did then. `felt`:
    what the modal sets state of gravity in their channels' readings; `fix`: parameters that are held at a value;
    `sensors`: the model's own where None; `alternatives`: other models of the same structure."""

    model: GivenModel
    parameters: str | Path | None
    where: str
    felt: Mapping[str, bool] = field(default_factory=dict)
    fix: Mapping[str, float] | None = None
    sensors: tuple[Sensor, ...] | None = None
    alternatives: tuple[GivenModel, ...] = ()

    def angle_deg(self, modal_set: ModalSet) -> float | None:
        """None, as in the model's file, where the set does not state it and for models that cannot be turned."""
        return nacelle_angle_deg(modal_set.environment, f"{self.where}, set {modal_set.id}") if self.turns else None

    @cached_property
    def turns(self) -> bool:
        if not has_geometry(self.model):
            return False
        path = model_path(self.model)
        return not path.is_file() or turns_nacelle(path)

    def __call__(self, modal_set: ModalSet) -> Model:
        angle = self.angle_deg(modal_set)
        if angle not in self._open_models:
            opened = open_model(self.model, self.parameters, self.sensors, nacelle_angle_deg=angle, fix=self.fix)
            known = self.with_alternatives(self.with_uncertainty(opened, angle), angle)
            self._open_models[angle] = with_stated_gravity(known, self.felt)
        return self._open_models[angle]

    def with_uncertainty(self, opened: Model, angle_deg: float | None) -> Model:
        """The model with the sources of its error: a turbine's tolerances, and sensors' where there is no more to
        know."""
        if not is_dataclass(opened) or getattr(opened, "uncertainty", self) is not None:
            return opened
        path = model_path(self.model) if isinstance(self.model, str | Path) else None
        if path is not None and path.is_file() and is_subdyn(path):
            # its TOML states no tolerances of the structure
            known = SensorUncertainty(model=opened, sensors=subdyn_sensors(path))
        elif path is not None and self.turns:
            known = TurbineUncertainty.from_description(path, opened, None, angle_deg)
        else:
            known = SensorUncertainty(model=opened)
        return replace(opened, uncertainty=known)

    def with_alternatives(self, opened: Model, angle_deg: float | None) -> Model:
        """The model with what other models of the structure have and it has not among the sources of its error."""
        if not self.alternatives:
            return opened
        if not is_dataclass(opened):
            raise InputError("alternatives", f"a {type(opened).__name__} has no place for sources of its error",
                             "give the model's file, or a FunctionModel")
        others = [open_model(one, self.parameters, self.sensors, nacelle_angle_deg=angle_deg)
                  for one in self.alternatives]
        named = tuple((Path(given).stem if isinstance(given, str | Path) else other.name, other)
                      for given, other in zip(self.alternatives, others, strict=True))
        known = AlternativeModels(model=opened, others=named, known=getattr(opened, "uncertainty", None))
        return replace(opened, uncertainty=known)

    @cached_property
    def _open_models(self) -> dict[float | None, Model]:
        return {}

    def setting(self, modal_set: ModalSet, channels: Sequence[str]) -> dict[str, str]:
        """What to say of it beside a result."""
        said = {"gravity": gravity_note(self(modal_set), channels, self.felt, modal_set)}
        if self.fix:
            said["held"] = ", ".join(f"{name} at {value:g}" for name, value in self.fix.items())
        if self.alternatives:
            names = (Path(one).stem if isinstance(one, str | Path) else one.name for one in self.alternatives)
            said["alternatives"] = f"the truth may lie anywhere from this model to {', '.join(names)}"
        if not self.turns:
            return said
        angle = self.angle_deg(modal_set)
        return said | {"nacelle": "as in the model: the set does not state where it looked" if angle is None
                       else f"{angle:g} deg counter-clockwise of the model's x axis"}


def gravity_note(model: Model, channels: Sequence[str], felt: Mapping[str, bool], modal_set: ModalSet) -> str:
    """What is taken of gravity in the readings of these channels, and a question where another axis may be upwards."""
    drawn = model.wireframe(model.parameters.initial)
    height = 0.0 if drawn is None else float(np.ptp(drawn.node_m[:, 2]))
    words = gravity_words(model, channels, felt, float(np.nanmin(modal_set.frequency_hz)), height or None)
    return "; ".join(said for said in (words, lying_doubt(model)) if said)


def has_geometry(model: object) -> TypeGuard[str | Path]:
    """Whether sensors can be placed on it: a model.toml with members, not matrices or a callable."""
    if not isinstance(model, str | Path):
        return False
    path = model_path(model)
    # what cannot be read is reported by whoever reads it
    return not path.is_file() or path.suffix.lower() == ".dat" or (
        path.suffix == ".toml" and b"[matrices]" not in read_bytes(path))


def channels_of_model(model: GivenModel, opened: Model) -> tuple[str, ...]:
    """The channels that a model has of its own: of one with members those of its file, wherever the sensors are that
    it was opened with."""
    return tuple(s.channel for s in model_sensors(model_path(model)) or ()) if has_geometry(model) else opened.channels


def model_notes(model: str | Path) -> tuple[str, ...]:
    """What the files of a model hold that is not used; () where they cannot be read, which whoever opens it says."""
    try:
        return unused_of(model_path(model))
    except (InputError, OSError):
        return ()


@names_files("model")
def model_modes(
    model: GivenModel | Callable, count: int | None = None, *, parameters: str | Path | None = None
) -> OwnModes:
    """A model's own frequencies, labels and shapes; the command `modes`. `model`: a file in any form, a model, or a
    function theta -> (frequency_hz, shape) with `parameters`."""
    return modes_of_model(model_path(model) if isinstance(model, str | Path) else model, count, parameters=parameters)
