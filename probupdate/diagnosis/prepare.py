"""A model made ready for diagnosis: its catalogue as parameters, one small basis for all angles, its model form.

Preparing takes half a minute for a turbine and does not depend on the data: many records of one turbine share it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np
from scipy import sparse

from probupdate.diagnosis.small_basis import small_model
from probupdate.diagnosis.small_model import TURNS_DEG, SmallModel
from probupdate.effects.catalogue import Effect, measurement_effects, parameter_effects, temperature_effect
from probupdate.effects.gravity import gravity_effects
from probupdate.effects.places import with_places
from probupdate.effects.turbine import turbine_effects
from probupdate.errors import InputError
from probupdate.modal.matching import APART
from probupdate.modal.modes import ModalData, Sensor
from probupdate.model.parameters import Parameters
from probupdate.runtime.progress import Progress, silent
from probupdate.structure.affine import AffineModel
from probupdate.structure.along_lines import with_reversed_gravity
from probupdate.structure.description import Description, described_sensors
from probupdate.structure.description_file import read_description
from probupdate.structure.extend import extended_model
from probupdate.structure.load import load_model, model_sensors, resting_angle_deg
from probupdate.structure.matrices import channel_places
from probupdate.structure.own_modes import lying_doubt
from probupdate.structure.subdyn_model import is_subdyn, turns_nacelle

# modes looked through for the measured ones: so many, and up to the other where modes are measured above these
N_MODE, MOST_MODES = 7, 20


@dataclass(frozen=True, eq=False, kw_only=True)
class Prepared:
    """`path` of the model's file; small: the model with its effects; prior and updated (numbers in the small model) of
    the parameters an update would move; effects of structure and environmental and operational conditions; a user's
    `own` of sensors or of parameters the model has. Effects of sensors are those of the channels a record has
    (`effects_on`). `discrepancy`: what the model leaves out of every frequency, a share (None: as is usual);
    `question`: what its matrices are asked about, '' for nothing."""

    path: Path
    small: SmallModel
    prior: Parameters
    updated: tuple[int, ...]
    effects: tuple[Effect, ...]
    own: tuple[Effect, ...]
    sensors: tuple[Sensor, ...]
    description: Description | None
    discrepancy: float | None = None
    question: str = ""

    @property
    def resting_deg(self) -> float:
        """Where the nacelle looks in the model's file as it is, from the model's x axis."""
        return resting_angle_deg(self.path)

    def with_stated_gravity(self, data: ModalData) -> Prepared:
        """With what the modal sets state of their channels' gravity in place of what the sensors do."""
        if not data.felt:
            return self
        return replace(self, small=self.small.with_gravity(data.felt),
                       sensors=tuple(s.with_gravity(data.felt) for s in self.sensors))

    def effects_on(self, channels: Sequence[str], highest_hz: float = np.inf) -> tuple[Effect, ...]:
        """The whole catalogue for a record of these channels, in their order, and of modes up to `highest_hz`."""
        return (*_observed_effects(self.effects, channels), *measurement_effects(channels, self.sensors, highest_hz),
                *self.own)


def prepare(
    path: str | Path,
    *,
    parameters: Parameters | None = None,
    sensors: Sequence[Sensor] | None = None,
    groups: Mapping[str, Mapping[str, float]] | None = None,
    effects: Sequence[Effect] = (),
    felt: dict[str, bool] | None = None,
    highest_hz: float = 0.0,
    progress: Progress = silent,
) -> Prepared:
    """Read the model and put the whole catalogue into it. felt: what is stated of gravity in channels' readings, in
    place of what the sensors do. highest_hz: of the modes that will be compared with it.

    `effects` are a user's own; what is `observe`d has a row for each channel of the record, in its order. Raises
    InputError for an effect that adds a parameter where the model is not a description of a turbine.
    `groups`: named combinations of a model's parameters, name -> {parameter: change for a size of one}.
    """
    path = Path(path)
    of_matrices = model_sensors(path) is None
    # matrices have their own channels only: what is stated of sensors says where these are
    model = load_model(path, parameters=parameters, sensors=None if of_matrices else sensors)
    if not len(model.parameters):
        raise InputError(model.name, "has no parameters, so that its uncertainty is not stated",
                         "list at least one [[parameter]] in its TOML")
    felt = felt or {}
    if of_matrices and (felt or sensors is not None):
        model = model.with_gravity({s.channel: bool(s.gravity) for s in sensors or ()} | felt)
    added = [e for e in effects if e.adds is not None]
    own = (*(e for e in effects if e.adds is None), *_group_effects(groups or {}, model.parameters))
    if of_matrices or is_subdyn(path):
        if added:
            raise InputError(f"effect {added[0].name}", f"adds a parameter, which {path.name} cannot hold",
                             "name parameters that the model has (`parts`), or export it as model.toml")
        if not of_matrices and turns_nacelle(path):
            others = [load_model(path, parameters=parameters, sensors=sensors, nacelle_angle_deg=angle)
                      for angle in TURNS_DEG]
            model = replace(others[0], turned=tuple((one.stiffness, one.mass) for one in others[1:]))
        return _prepare_matrices(path, model, own, _places(path, model, sensors))
    description = read_description(path)
    placed = tuple(s.with_gravity(felt) for s in (described_sensors(description) if sensors is None else sensors))
    catalogue = (*turbine_effects(description, sensors=placed), *added)
    parameters_of = [e.adds for e in catalogue if e.adds is not None]
    progress("preparing the model", 0, 2)
    first = extended_model(path, parameters_of, parameters=parameters, sensors=sensors,
                           nacelle_angle_deg=TURNS_DEG[0], turns_deg=TURNS_DEG[1:])
    progress("preparing the model", 1, 2)
    updated = tuple(first.parameters.names.index(n) for n in model.parameters.names)
    reach = np.column_stack([first.parameters.lower, first.parameters.upper])
    moved, of_channels = [], set(first.of_channels)
    for e, its in zip(catalogue, parameters_of, strict=True):
        k = first.parameters.names.index(its.name)
        # what changes no mode asks nothing of the basis
        if k in of_channels:
            continue
        moved.append(k)
        reach[k] = its.neutral + np.clip([-1.5 * e.prior_scale, 1.5 * e.prior_scale], e.lower, e.upper)
        if its.neutral == 1.0:
            # a stiffness may be lost, and what has none left moves by itself
            reach[k, 0] = its.neutral + e.lower
    small = small_model(first, n_mode=modes_up_to(model, highest_hz), effects=moved, reach=reach)
    progress("preparing the model", 2, 2)
    effects = (*parameter_effects(model.parameters), *catalogue)
    return Prepared(path=path, small=small, prior=model.parameters, updated=updated, effects=effects, own=own,
                    sensors=placed, description=description)


def modes_up_to(model: AffineModel, highest_hz: float) -> int:
    """How many of the model's modes are looked through for measured ones up to that frequency, of which the model may
    have too high ones."""
    most = min(MOST_MODES, model.n_available)
    known = model.solve(model.parameters.initial, most).frequency_hz
    return int(np.clip(np.count_nonzero(known <= np.exp(APART) * highest_hz), min(N_MODE, most), most))


def _observed_effects(effects: Sequence[Effect], channels: Sequence[str]) -> Iterator[Effect]:
    """Without those that name channels of which the record has none, or the same as another's that is alike in all
    else."""
    known: set[tuple[object, ...]] = set()
    for e in effects:
        settings = {} if e.adds is None else e.adds.settings
        named = cast(tuple[str, ...], settings.get("channels", ()))
        own = frozenset(named) & frozenset(channels)
        key = own, settings.get("towards_m"), e.cause
        if named and (not own or key in known):
            continue
        known.add(key)
        yield e


def _places(path: Path, model: AffineModel, stated: Sequence[Sensor] | None) -> tuple[Sensor, ...]:
    """Where the channels of a model are that is not a description of a turbine: as stated, else as its file has
    them."""
    if stated is not None:
        return tuple(s for s in stated if s.channel in model.channels)
    own = model_sensors(path)
    return channel_places(model) if own is None else own


def places_tried(
    path: Path, model: AffineModel, sensors: Sequence[Sensor]
) -> tuple[AffineModel, tuple[Effect, ...]]:
    """A model that is not a description of a turbine with its sensors at other places, and the rows of the
    catalogue."""
    return with_places(model, sensors, alone=model_sensors(path) is None)


def of_channels_tried(
    path: Path, model: AffineModel, sensors: Sequence[Sensor]
) -> tuple[AffineModel, tuple[Effect, ...]]:
    """The same with what is stated of gravity in their readings reversed too."""
    model, effects = places_tried(path, model, sensors)
    if model.gravity is None or model.tilt_matrix is None:
        return model, effects
    felt = np.flatnonzero(np.diff(sparse.csr_array(model.tilt_matrix).indptr) > 0)
    stated = [(model.channels[k], bool(model.gravity.share[k] > 0.5)) for k in felt]
    rows = gravity_effects(stated, sensors, model.parameters.names)
    added = [(e.adds, tuple(e.adds.settings["channels"])) for e in rows if e.adds is not None]
    return with_reversed_gravity(model, [(p.parameter, channels) for p, channels in added]), (*effects, *rows)


def _prepare_matrices(path: Path, model: AffineModel, own: tuple[Effect, ...], sensors: tuple[Sensor, ...]) -> Prepared:
    n_mode = min(MOST_MODES, model.n_available)
    moved, of_channels = of_channels_tried(path, model, sensors)
    reach = np.column_stack([moved.parameters.lower, moved.parameters.upper])
    small = small_model(moved, n_mode=n_mode, effects=(), reach=reach)
    return Prepared(path=path, small=small, prior=model.parameters, updated=tuple(range(len(model.parameters))),
                    effects=(*parameter_effects(model.parameters), *of_channels, temperature_effect()), own=own,
                    sensors=sensors, description=None, question=lying_doubt(model))


def _group_effects(groups: Mapping[str, Mapping[str, float]], parameters: Parameters) -> tuple[Effect, ...]:
    result = []
    for name, parts in groups.items():
        unknown = [parameter for parameter in parts if parameter not in parameters.names]
        if unknown:
            raise InputError(f"group {name}: {unknown[0]}", "is not a parameter of the model",
                             f"choose from {', '.join(parameters.names)}")
        # a size of one moves every member by its amount; a standard deviation of the prior is what is normal
        allowed = min((parameters.std[parameters.index(n)] / abs(a) for n, a in parts.items() if a), default=0.0)
        if not allowed:
            raise InputError(f"group {name}", "moves no parameter", "give a change for at least one")
        # beyond the bounds of any member the model would stand still while the size went on
        ends = np.array([sorted(np.array([p.lower - p.initial, p.upper - p.initial]) / a) for n, a in parts.items() if a
                         for p in [parameters.items[parameters.index(n)]]])
        result.append(Effect(kind="structural", cause="group of parameters", location=name, unit="-", tolerance=0.0,
                             prior_scale=3 * allowed, lower=float(ends[:, 0].max()), upper=float(ends[:, 1].min()),
                             parts=tuple(parts.items()), time_profiles=("constant", "step", "ramp"),
                             signature="that of its parameters together"))
    return tuple(result)
