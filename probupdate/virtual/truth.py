"""What is true of one virtual turbine: parameters, tolerances, effects; drawn once, written beside the campaign."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Literal

import numpy as np

from probupdate.errors import InputError, of_file, parsing
from probupdate.io.schema import Range, table_as, validate
from probupdate.runtime.arrays import frozen_array
from probupdate.virtual.effects import read_effect
from probupdate.virtual.turbine_file import TurbineFile, read_toml, unknown_name

# of a written truth.toml, a record, and read back only as far as it is given
RECORDED = ("format", "name", "model", "seed", "drawn", "mode_set", "mode_set_end", "condition", "idling_hz", "state",
            "event", "gap", "summary")
DEPTHS = ("sc", "corr", "mg")  # may be zero


@dataclass(frozen=True, kw_only=True)
class _ToleranceTable:
    scale: Annotated[float, Range(0, 3)] = 1.0


@dataclass(frozen=True, kw_only=True)
class _OperationTable:
    """What a campaign's operation is built from; without a key, as drawn."""

    maintenance_hours: list[tuple[float, float]] = field(default_factory=list)
    wind_speed_mean_mps: Annotated[float, Range(2, 20)] = 9.0
    missing_hours: list[int] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class _GivenTables:
    """A user's truth.toml as it is written: kinds and bounds of its keys."""

    parameters: Mapping[str, Annotated[float, Range(0, 1e9)]] = field(default_factory=dict)
    parameters_from: Literal["initial", "prior"] = "initial"
    tolerances: Mapping[str, object] = field(default_factory=dict)
    operation: Mapping[str, object] = field(default_factory=dict)
    effect: list[Mapping[str, object]] = field(default_factory=list)


@dataclass(frozen=True, eq=False, kw_only=True)
class GivenTruth:
    """A user's truth.toml: parameter values, where the others come from, the tolerances' scale, effects."""

    parameters: Mapping[str, float]
    parameters_from: str
    tolerance_scale: float
    operation: Mapping
    effects: tuple[Mapping, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class Tolerances:
    """Differences of the built turbine from its drawings; factors unless a unit is named."""

    tower_wall: float
    leg_wall: float
    brace_wall: float
    pile_wall: float
    nacelle_mass: float
    secondary_steel: float
    joint_flexibility: float
    leg_soil: np.ndarray  # (n_leg,)
    rna_offset_m: np.ndarray  # (3,)
    frame_rotation_deg: float
    sensor_gain: np.ndarray  # (n_channel,)
    sensor_rotation_deg: np.ndarray  # (n_channel, 3), equal within a position


@dataclass(frozen=True, eq=False, kw_only=True)
class Truth:
    """Everything that holds for the whole campaign. damping_ratio (n_mode,) is that of structure, soil and water."""

    parameters: Mapping[str, float]
    tolerances: Tolerances
    damping_ratio: np.ndarray
    noise_std_mps2: np.ndarray  # (n_channel,)
    offset_mps2: np.ndarray  # (n_channel,)
    effects: tuple[Mapping, ...]


def read_truth(path: str | Path | None, file: TurbineFile) -> GivenTruth:
    """Read a truth.toml; None means the model's initial values with tolerances and no effect.

    The record that `simulate` writes can be given too: its parameters, effects and operation hold, the rest is
    drawn again (the same seed draws the same).
    """
    if path is None:
        return parse_truth({}, file)
    with of_file(path), parsing(str(path), "is not a truth file", "write it as truth.toml of `simulate`"):
        return parse_truth(read_toml(Path(path), "truth file"), file, path)


def parse_truth(raw: Mapping, file: TurbineFile, path: object = "truth") -> GivenTruth:
    """The same from a truth.toml's content; `path` names it in errors."""
    written = raw.get("format") == 1 and "drawn" in raw
    tables = table_as(_GivenTables, {k: v for k, v in raw.items() if not (written and k in RECORDED)}, str(path))
    known = tuple(file.initial_parameters())
    for name, value in tables.parameters.items():
        if name not in known:
            raise unknown_name(f"{path}, parameters", name, known)
        if value == 0 and name not in DEPTHS:
            raise InputError(f"{path}, parameters, {name}", f"{value} is not positive", "give a value above zero")
    table_as(_OperationTable, tables.operation, f"{path}, operation")
    return GivenTruth(
        parameters=MappingProxyType(tables.parameters),
        parameters_from=tables.parameters_from,
        tolerance_scale=table_as(_ToleranceTable, tables.tolerances, f"{path}, tolerances").scale,
        operation=MappingProxyType(dict(tables.operation)),
        effects=tuple(read_effect(path, number, entry, file) for number, entry in enumerate(tables.effect)),
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class TruthModes:
    """The true modes at one nacelle heading: frequency_hz, damping_ratio_* (n_mode,), shape (n_channel, n_mode) of
    ideal sensors where the drawing has them, scaled to unit modal mass. labels: FA1, SS1, T1, ... with fore-aft
    where the nacelle looks."""

    heading_deg: float
    labels: tuple[str, ...]
    frequency_hz: np.ndarray
    damping_ratio_idling: np.ndarray
    damping_ratio_operating: np.ndarray
    shape: np.ndarray


def read_truth_modes(path: str | Path) -> tuple[TruthModes, ...]:
    """The mode sets of a written truth.toml, one per heading that the nacelle had, ascending."""
    raw = read_toml(Path(path), "truth file")
    if not raw.get("mode_set"):
        raise InputError(str(path), "holds no [[mode_set]]", "give the truth.toml that simulate wrote")
    with parsing(str(path), "is not a truth file", "give the truth.toml that simulate wrote"):
        found = tuple(_truth_modes(entry) for entry in raw["mode_set"])
    for number, modes in enumerate(found, 1):
        validate(modes, f"{path}, mode_set {number}", "give the truth.toml that simulate wrote")
        each = (modes.frequency_hz, modes.damping_ratio_idling, modes.damping_ratio_operating)
        n_mode = len(modes.labels)
        if modes.shape.ndim != 2 or modes.shape.shape[1] != n_mode or any(a.shape != (n_mode,) for a in each):
            raise InputError(f"{path}, mode_set {number}", "its modes differ in number", "give the file of simulate")
    return found


def _truth_modes(entry: Mapping) -> TruthModes:
    return TruthModes(
        heading_deg=entry["heading_deg"],
        labels=tuple(entry["labels"]),
        frequency_hz=frozen_array(entry["frequency_hz"]),
        damping_ratio_idling=frozen_array(entry["damping_ratio_idling"]),
        damping_ratio_operating=frozen_array(entry["damping_ratio_operating"]),
        shape=frozen_array(entry["shape"]).T,
    )


def _draw_clipped(rng: np.random.Generator, std: float, shape=None, limit: float = 2.0):
    """Normal of standard deviation std cut at `limit` standard deviations by clipping: a manufacturer's tolerance has
    an end."""
    return std * np.clip(rng.standard_normal(shape), -limit, limit)


def draw_truth(given: GivenTruth, file: TurbineFile, rng: np.random.Generator, n_mode: int) -> Truth:
    """Draw what the truth file leaves open. Every number is drawn in a fixed order, whatever was given."""
    values = file.initial_parameters()
    for name, parameter in file.parameters.items():
        drawn = float(parameter.distribution.rvs(random_state=rng))
        if given.parameters_from == "prior" and file.is_updated(name):
            values[name] = drawn
    values |= given.parameters
    s = given.tolerance_scale
    n_leg, n_channel = len(file.value("jacket", "leg_names")), len(file.sensors)
    wall = s * _draw_clipped(rng, 0.01, 4)
    positions = [tuple(sensor.position_m) for sensor in file.sensors]
    turn = {position: s * _draw_clipped(rng, 1.0, 3) for position in dict.fromkeys(positions)}
    tolerances = Tolerances(
        tower_wall=1 + wall[0],
        leg_wall=1 + wall[1],
        brace_wall=1 + wall[2],
        pile_wall=1 + wall[3],
        nacelle_mass=1 + s * _draw_clipped(rng, 0.01),
        secondary_steel=1 + s * _draw_clipped(rng, 0.03),
        joint_flexibility=float(np.exp(s * _draw_clipped(rng, 0.1))),
        leg_soil=frozen_array(1 + s * rng.uniform(-0.1, 0.1, n_leg)),
        rna_offset_m=frozen_array(s * _draw_clipped(rng, 0.1, 3)),
        frame_rotation_deg=float(s * _draw_clipped(rng, 1.0)),
        sensor_gain=frozen_array(1 + s * _draw_clipped(rng, 0.01, n_channel)),
        sensor_rotation_deg=frozen_array([turn[position] for position in positions]),
    )
    return Truth(
        parameters=MappingProxyType(values),
        tolerances=tolerances,
        damping_ratio=frozen_array(rng.uniform(0.010, 0.016, n_mode)),
        noise_std_mps2=frozen_array(1e-4 * rng.uniform(0.8, 1.2, n_channel)),
        offset_mps2=frozen_array(s * _draw_clipped(rng, 2e-3, n_channel)),
        effects=given.effects,
    )
