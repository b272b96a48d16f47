"""A model's own modes: frequencies, labels and shapes at its channels, for every form of model."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from probupdate.errors import InputError
from probupdate.io.result_table import table_of
from probupdate.io.subdyn_file import read_subdyn
from probupdate.modal.labels import FAMILY, NEUTRAL, TURBINE, indistinguishable
from probupdate.model.interface import ModalSolution, Model
from probupdate.model.parameters import Parameters
from probupdate.runtime.arrays import frozen_array
from probupdate.structure.affine import AffineModel
from probupdate.structure.description_file import parse_description
from probupdate.structure.eigen import modes_with_free_motions
from probupdate.structure.functions import FunctionModel
from probupdate.structure.load import load_model, model_sensors
from probupdate.structure.mode_labels import mode_labels
from probupdate.structure.parameter_table import read_parameters, read_toml
from probupdate.structure.plausible_size import implausible_size, lying_words
from probupdate.structure.plausible_turbine import odd_sizes
from probupdate.structure.subdyn_doubts import doubtful_rows
from probupdate.structure.subdyn_model import is_subdyn, read_description, turns_nacelle, with_tower

if TYPE_CHECKING:
    import pandas as pd

# shapes of unit modal mass smaller than this, beside the largest, are rounding
UNSEEN = 1e-9
# modes of which it is said what the sensors do not see
MODES_SAID = tuple(f"{family}{k}" for family in FAMILY for k in (1, 2))
# modes where it is not said how many
MOST_MODES = 10


@dataclass(frozen=True, eq=False, kw_only=True)
class OwnModes:
    """frequency_hz (n_mode,) ascending at the initial parameters; labels FA1, SS1, T1, L1, ... of a turbine, X1, Y1,
    T1, L1, ... of matrices whose nodes have places, H1, V1, T1, A1, L1, ... of what spans, mode 1, ... elsewhere, R1,
    ... of motions at 0 Hz; shape (n_channel, n_mode), largest component 1. `notes`: what the model's files hold that
    has no effect."""

    model: str
    frequency_hz: np.ndarray
    labels: tuple[str, ...]
    channels: tuple[str, ...]
    shape: np.ndarray
    notes: tuple[str, ...] = ()

    def content(self) -> dict:
        return {
            "model": self.model, "frequency_hz": self.frequency_hz.tolist(), "label": list(self.labels),
            "channel": list(self.channels), "shape": self.shape.tolist(), "notes": list(self.notes),
        }

    def text(self) -> str:
        """One JSON object."""
        return json.dumps(self.content())

    def to_frame(self) -> pd.DataFrame:
        """A row a mode."""
        return table_of([{"mode": k, "label": label, "frequency_hz": f} for k, (label, f) in
                         enumerate(zip(self.labels, self.frequency_hz, strict=True), 1)])

    @property
    def summary(self) -> str:
        rows = [f"{j:4d}  {f:12.6f} Hz  {label}" for j, (f, label) in
                enumerate(zip(self.frequency_hz, self.labels, strict=True), 1)]
        return "\n".join([self.model, *rows, *(f"note: {note}" for note in self.notes)])


def modes_of_model(
    model: str | Path | Model | Callable, count: int | None = None, *, parameters: Parameters | str | Path | None = None
) -> OwnModes:
    """The lowest modes of a model at its initial parameters: `count` of them, or where None is given as many as it has,
    at most MOST. Frequencies that no structure of the model's extent has are said among the notes.

    `model`: a file as `load_model` takes it, a model, or a function theta (n_param,) -> (frequency_hz, shape), which
    needs `parameters`. Raises InputError where it has fewer modes than `count`, or cannot be read.
    """
    if count is not None and count < 1:
        raise InputError("count", f"{count} modes are asked for", "ask for one or more")
    sensors, notes, turbine = None, (), True
    opened: Model
    if isinstance(model, str | Path):
        path = Path(model)
        sensors, notes = model_sensors(path), unused_of(path)
        # what has members has sensors with places, or none
        turbine = sensors is not None and turns_nacelle(path)
        opened = load_model(path, parameters=parameters, sensors=() if sensors == () else None)
    else:
        stated = read_parameters(parameters) if isinstance(parameters, str | Path) else parameters
        opened = cast("Model", model) if hasattr(model, "solve") else _wrap_function(model, stated)
    most = opened.n_available
    if count is None:
        count = min(MOST_MODES, most)
    if count > most:
        raise InputError(opened.name, f"{count} modes are asked for, it has {most}",
                         f"ask for at most {most} (--count)")
    phi = None
    try:
        solution = opened.solve(opened.parameters.initial, count)
    except InputError:
        if not isinstance(opened, AffineModel):
            raise
        solution, phi, free = _solve_with_free_motions(opened, count)
        notes = (*notes, f"{free} of these are motions that nothing holds, at 0 Hz (a mechanism or a missing support)")
    labels = mode_labels(opened, solution, sensors or (), families=TURBINE if turbine else NEUTRAL, phi=phi)
    notes = (*notes, *model_doubts(opened, solution.frequency_hz), *_distinguish_labels(labels, solution))
    shape = _without_rounding(solution.shape)
    shape = shape / np.where(np.abs(shape).max(axis=0, initial=0) > 0, np.abs(shape).max(axis=0, initial=0), 1.0)
    return OwnModes(
        model=opened.name, frequency_hz=frozen_array(solution.frequency_hz),
        labels=labels,
        channels=opened.channels, shape=frozen_array(shape), notes=notes,
    )


def model_doubts(model: Model, frequency_hz: np.ndarray) -> tuple[str, ...]:
    """A sentence where the lowest frequency above zero is none of a structure of the model's extent, one where its
    matrices may have y upwards."""
    own = frequency_hz[frequency_hz > 0]
    if not len(own):
        return ()
    wire, places = model.wireframe(model.parameters.initial), getattr(model, "places", None)
    node_m = wire.node_m if wire is not None else np.zeros((1, 3)) if places is None else places.position_m
    # the usual product is that of structures that stand: what floats bends at six times a cantilever's frequency
    extent_m = float(np.max(np.ptp(node_m, axis=0))) if len(own) == len(frequency_hz) else 0.0
    said = implausible_size(float(own[0]), extent_m)
    return tuple(words for words in (said, lying_doubt(model)) if words)


def lying_doubt(model: Model) -> str:
    """`lying_words` of a model of matrices whose rows' places are known, else ''."""
    places = getattr(model, "places", None)
    return "" if not isinstance(model, AffineModel) or places is None else lying_words(
        model.matrices(model.parameters.initial)[0], places.position_m, places.direction)


def _solve_with_free_motions(model: AffineModel, count: int) -> tuple[ModalSolution, np.ndarray, int]:
    """Modes of a structure that may float, as SubDyn's summary has them, their whole shapes, and how many are at 0
    Hz."""
    theta = model.parameters.initial
    value, phi, free = modes_with_free_motions(*model.matrices(theta), count, model.name)
    return ModalSolution(theta=theta, frequency_hz=frozen_array(np.sqrt(value) / (2 * np.pi)),
                         shape=frozen_array(model.read(theta, value, phi))), phi, free


def _wrap_function(given: object, parameters: Parameters | None) -> FunctionModel:
    if not callable(given):
        raise InputError("model", f"a {type(given).__name__} is not a model", "give a file, a model or a function")
    function: Any = given
    if parameters is None:
        raise InputError("model", "a function has no parameters of its own", "give them: parameters=Parameters(...)")
    _, shape = function(np.array(parameters.initial))
    channels = tuple(f"channel {k + 1}" for k in range(np.shape(shape)[0]))
    return FunctionModel(name=getattr(function, "__name__", "function"), parameters=parameters, channels=channels,
                         function=function, version="own modes")


def unused_of(path: Path) -> tuple[str, ...]:
    """Sentences on what a model's files hold that is not used or has no effect, which the project's own forms refuse,
    or that is hardly meant."""
    if not is_subdyn(path):
        return _odd_sizes(path) if path.suffix == ".toml" else ()
    file = with_tower(read_description(read_toml(path), path), path)[0] if path.suffix == ".toml" else read_subdyn(path)
    return (*doubtful_rows(file), *file.notes)


def _odd_sizes(path: Path) -> tuple[str, ...]:
    """Of a turbine by its geometry, what is out of proportion."""
    raw = read_toml(path)
    if "matrices" in raw:
        return ()
    return tuple(f"{path}: {words}" for words in odd_sizes(parse_description(raw, str(path))))


def _distinguish_labels(labels: tuple[str, ...], solution: ModalSolution) -> tuple[str, ...]:
    """What the model's channels do not see of its first global modes, or do not distinguish."""
    first = [j for j, label in enumerate(labels) if label in MODES_SAID]
    return indistinguishable(tuple(labels[j] for j in first), solution.frequency_hz[first], solution.shape[:, first])


def _without_rounding(shape: np.ndarray) -> np.ndarray:
    """Shapes with those that are rounding alone set to zero: a pile's torsion moves no point of its axis."""
    largest = np.abs(shape).max(axis=0, initial=0.0)
    return np.where(largest > UNSEEN * largest.max(initial=0.0), shape, 0.0)
