"""Sensors, modal sets and mode-shape criteria: the words that measurement and model share.

Mode shapes are columns: (n_channel, n_mode). NaN marks a mode or a component that was not measured.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from probupdate.errors import InputError, of_file, parsing
from probupdate.io.files import read_json, write_json_rows
from probupdate.io.result_table import table_of
from probupdate.modal.deviation_file import read_deviations, write_deviations
from probupdate.runtime.arrays import frozen_array

if TYPE_CHECKING:
    import pandas as pd
    import xarray

# of modes.json: 2 has `mode_records`, one of each mode, and `model_only`; files of format 1, or without, have neither
FORMAT = 2
QUANTITIES = ("acceleration", "velocity", "displacement")
OTHER_QUANTITIES = ("strain", "inclination", "tilt", "rotation", "angular velocity", "force", "pressure", "temperature")


NOT_STATED = frozen_array(())
# no sensor is farther from the origin of its model
FARTHEST_M = 1e7


@dataclass(frozen=True, eq=False, kw_only=True)
class Sensor:
    """One measured channel; position and direction in model axes, z = 0 at mean sea level."""

    channel: str
    level: str
    position_m: np.ndarray
    direction: np.ndarray
    quantity: str = "acceleration"
    unit: str = "m/s2"

    def __post_init__(self):
        where = f"sensor {self.channel}"
        try:
            position, direction = frozen_array(self.position_m), frozen_array(self.direction)
        except (TypeError, ValueError):
            raise InputError(where, "position_m or direction is not three numbers", "give [x, y, z]") from None
        if position.shape != (3,) or not np.all(np.abs(position) < FARTHEST_M):
            raise InputError(where, f"position_m {self.position_m} is not three numbers", "give [x, y, z] in metres")
        if direction.shape != (3,) or not np.all(np.abs(direction) < 2) or not abs(np.linalg.norm(direction) - 1) < 1e-3:
            raise InputError(where, f"direction {self.direction} is not a unit vector", "scale it to length 1")
        if self.quantity not in QUANTITIES:
            known = f"choose from {', '.join(QUANTITIES)}"
            if self.quantity in OTHER_QUANTITIES:
                raise InputError(where, f"measures {self.quantity}, which is no motion of a point: its shapes could "
                                 "not stand beside those of other sensors or of a model",
                                 "convert the other channels alone")
            raise InputError(where, f"quantity '{self.quantity}' is unknown", known)
        object.__setattr__(self, "position_m", position)
        object.__setattr__(self, "direction", direction)


@dataclass(frozen=True, eq=False, kw_only=True)
class ModalDeviation:
    """First-order deviations of one set's modes, a column for each part of the record they were estimated from.

    Scaled so that the covariance of any two of the quantities a and b, rows (n_column,), is the plain sum a @ b; within
    one mode or between two, which for a close pair is not nothing. ln_frequency, damping_ratio (n_mode, n_column);
    shape (n_channel, n_mode, n_column) complex, in the scaling of the set's shape. NaN: a mode not measured, or one
    whose deviation could not be estimated. The rank of a joint covariance is below the number of columns: a covariance
    of more quantities than that is singular.
    """

    ln_frequency: np.ndarray
    damping_ratio: np.ndarray
    shape: np.ndarray

    def __post_init__(self):
        for name, dtype in (("ln_frequency", float), ("damping_ratio", float), ("shape", complex)):
            object.__setattr__(self, name, frozen_array(getattr(self, name), dtype))
        table = self.ln_frequency.shape
        if len(table) != 2 or self.damping_ratio.shape != table or self.shape.shape[1:] != table:
            raise InputError("modal covariance", f"ln_frequency {table}, damping_ratio {self.damping_ratio.shape} and "
                             f"shape {self.shape.shape} do not belong together",
                             "give (n_mode, n_column) twice and (n_channel, n_mode, n_column)")

    @property
    def n_column(self) -> int:
        return self.ln_frequency.shape[1]

    def loaded(self) -> ModalDeviation:
        return self

    def of_modes(self, columns: Sequence[int]) -> ModalDeviation:
        """Of these modes alone; a column of -1 is a mode that was not measured."""
        return ModalDeviation(ln_frequency=_columns(self.ln_frequency, columns, 0), damping_ratio=_columns(
            self.damping_ratio, columns, 0), shape=_columns(self.shape, columns, 1))


@dataclass(frozen=True, eq=False, kw_only=True)
class StoredDeviation:
    """A `ModalDeviation` that lies on the disk and is read by `read` each time that it is asked for: those of a year are
    most of a gigabyte. `loaded` has it in memory."""

    read: Callable[[], ModalDeviation]

    @property
    def ln_frequency(self) -> np.ndarray:
        return self.read().ln_frequency

    @property
    def damping_ratio(self) -> np.ndarray:
        return self.read().damping_ratio

    @property
    def shape(self) -> np.ndarray:
        return self.read().shape

    @property
    def n_column(self) -> int:
        return self.read().n_column

    def loaded(self) -> ModalDeviation:
        return self.read()

    def of_modes(self, columns: Sequence[int]) -> StoredDeviation:
        columns = tuple(int(j) for j in columns)
        return StoredDeviation(read=lambda: self.read().of_modes(columns))


def _columns(value: np.ndarray, columns: Sequence[int], axis: int) -> np.ndarray:
    """Picked along an axis; NaN where the column is -1."""
    there = np.asarray(columns, int)
    picked = np.array(np.take(value, np.maximum(there, 0), axis=axis))
    index: list[slice | np.ndarray] = [slice(None)] * picked.ndim
    index[axis] = there < 0
    picked[tuple(index)] = np.nan
    return picked


@dataclass(frozen=True, eq=False, kw_only=True)
class ModalSet:
    """One identification: the modes of one block of data, or of a mean over blocks.

    frequency_hz, frequency_std_hz, damping_ratio, damping_ratio_std (n_mode,); shape (n_channel, n_mode) complex;
    shape_std (n_channel, n_mode), the deviation of the real part in the shape's own scaling. NaN: not measured.
    Where a `deviation` is given, deviations that are NaN are taken from it; given ones stay, as a set may be weighted
    by another scatter than that within its record.
    """

    id: str
    frequency_hz: np.ndarray
    shape: np.ndarray
    damping_ratio: np.ndarray
    frequency_std_hz: np.ndarray
    shape_std: np.ndarray
    environment: Mapping[str, float] = field(default_factory=dict)
    damping_ratio_std: np.ndarray = field(default_factory=lambda: NOT_STATED)
    deviation: ModalDeviation | StoredDeviation | None = None

    def __post_init__(self):
        n_mode = np.size(self.frequency_hz)
        if self.damping_ratio_std is None or self.damping_ratio_std is NOT_STATED:
            object.__setattr__(self, "damping_ratio_std", np.full(n_mode, np.nan))
        for name in ("frequency_hz", "damping_ratio", "frequency_std_hz", "damping_ratio_std"):
            value = frozen_array(getattr(self, name))
            if value.shape != (n_mode,):
                raise InputError(f"set {self.id}", f"{name} has shape {value.shape}", f"give {n_mode} numbers")
            object.__setattr__(self, name, value)
        shape = frozen_array(self.shape, complex)
        if shape.ndim != 2 or shape.shape[1] != n_mode:
            raise InputError(f"set {self.id}", f"shape is {shape.shape}", f"give {n_mode} columns, one a mode")
        object.__setattr__(self, "shape", shape)
        std = frozen_array(self.shape_std)
        if std.shape != shape.shape:
            raise InputError(f"set {self.id}", f"shape_std is {std.shape}", f"give {shape.shape} as for the shape")
        object.__setattr__(self, "shape_std", std)
        object.__setattr__(self, "environment", MappingProxyType(dict(self.environment)))
        if self.deviation is not None:
            self._take_deviation(self.deviation.loaded())

    def __reduce__(self):
        # to another process: as it was given, its arrays read-only there too
        given = {f.name: getattr(self, f.name) for f in fields(self)}
        given["environment"] = dict(self.environment)
        given["deviation"] = None if self.deviation is None else self.deviation.loaded()
        return _modal_set, (given,)

    def _take_deviation(self, deviation: ModalDeviation) -> None:
        if deviation.shape.shape[:2] != self.shape.shape:
            raise InputError(f"set {self.id}", f"its covariance is of {deviation.shape.shape[:2]} channels and modes",
                             f"give {self.shape.shape} as for the shape")
        estimated = {
            "frequency_std_hz": self.frequency_hz * np.sqrt(np.sum(deviation.ln_frequency**2, axis=1)),
            "damping_ratio_std": np.sqrt(np.sum(deviation.damping_ratio**2, axis=1)),
            "shape_std": np.sqrt(np.sum(np.real(deviation.shape) ** 2, axis=2)),
        }
        for name, value in estimated.items():
            given = getattr(self, name)
            object.__setattr__(self, name, frozen_array(np.where(np.isnan(given), value, given)))

    def of_modes(self, columns: Sequence[int]) -> ModalSet:
        """The same set with these modes alone; a column of -1 is a mode that was not measured."""
        taken = {name: _columns(getattr(self, name), columns, 0)
                 for name in ("frequency_hz", "damping_ratio", "frequency_std_hz", "damping_ratio_std")}
        return replace(self, **taken, shape=_columns(self.shape, columns, 1), shape_std=_columns(self.shape_std, columns, 1),
                       deviation=None if self.deviation is None else self.deviation.of_modes(columns))

    @property
    def measured(self) -> np.ndarray:
        """(n_mode,) bool: modes with a frequency."""
        return np.isfinite(self.frequency_hz)


def _modal_set(given: dict) -> ModalSet:
    return ModalSet(**given)


@dataclass(frozen=True, kw_only=True)
class ModeRecord:
    """What an identification says of one mode of a campaign.

    frequency_hz, frequency_std_hz, damping_ratio: mean, scatter and median over the `found` of `blocks` usable blocks
    that have it; detection: turbine state -> (found, blocks). pair: compared by the plane with its mate. match:
    'alike', 'unlike' or 'none', of the model that it was held against; '' without one. model_label, model_frequency_hz: its
    counterpart there; mac: mean over the blocks of the MAC (of a pair, S2MAC to the measured plane), mac_std its
    scatter, own_mac that of the single shapes; frequency_ratio, frequency_ratio_std: measured over the model's.
    alternatives: (label, probability) of the modes of the model that it may be. NaN: not known.
    """

    label: str
    frequency_hz: float = np.nan
    frequency_std_hz: float = np.nan
    damping_ratio: float = np.nan
    found: int = 0
    blocks: int = 0
    detection: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    pair: bool = False
    match: str = ""
    model_label: str = ""
    model_frequency_hz: float = np.nan
    mac: float = np.nan
    mac_std: float = np.nan
    own_mac: float = np.nan
    frequency_ratio: float = np.nan
    frequency_ratio_std: float = np.nan
    alternatives: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, kw_only=True)
class ModelMode:
    """A mode of the model that no measured one is; expected: whether the excitation should show it."""

    label: str
    frequency_hz: float
    expected: bool


@dataclass(frozen=True, eq=False, kw_only=True)
class ModalData:
    """What `modes.json` holds: channels, sets, and optionally the set an update should start from; of an identification
    also a record a mode, and the modes of the model that it did not find.

    Column j is the same physical mode in every set; `labels` may name them (FA1, SS1, ...).
    """

    channels: tuple[str, ...]
    sets: tuple[ModalSet, ...]
    labels: tuple[str, ...] = ()
    reference_set: str | None = None
    records: tuple[ModeRecord, ...] = ()
    model_only: tuple[ModelMode, ...] = ()

    def __post_init__(self):
        if not self.sets:
            raise InputError("modal data", "there is no set", "give at least one identification")
        n_mode = self.sets[0].frequency_hz.size
        for s in self.sets:
            if s.shape.shape != (len(self.channels), n_mode):
                raise InputError(
                    f"set {s.id}",
                    f"shape is {s.shape.shape}, other sets or the channel list say ({len(self.channels)}, {n_mode})",
                    "use the same channels and the same modes, null where not measured",
                )
        ids = [s.id for s in self.sets]
        if len(set(ids)) < len(ids):
            raise InputError("modal data", "two sets share one id", "give each set its own")
        if self.labels and len(self.labels) != n_mode:
            raise InputError("modal data", f"{len(self.labels)} labels for {n_mode} modes", "give one label a mode")
        if self.records and len(self.records) != n_mode:
            raise InputError("modal data", f"{len(self.records)} records for {n_mode} modes", "give one a mode")
        if self.reference_set is not None and self.reference_set not in ids:
            raise InputError("modal data", f"reference_set '{self.reference_set}' is no set's id", "name one of them")

    def to_frame(self) -> pd.DataFrame:
        """A row a set and mode: frequency, damping ratio, their standard deviations; NaN where not measured."""
        names = self.labels or tuple(str(j + 1) for j in range(self.n_mode))
        return table_of([
            {"id": s.id, "mode": names[j], "frequency_hz": s.frequency_hz[j], "frequency_std_hz": s.frequency_std_hz[j],
             "damping_ratio": s.damping_ratio[j], "damping_ratio_std": s.damping_ratio_std[j]}
            for s in self.sets for j in range(self.n_mode)
        ])

    def to_xarray(self) -> xarray.Dataset:
        """The sets as an xarray dataset that `to_netcdf` writes: frequency_hz, damping_ratio and their standard deviations
        (set, mode), shape_re, shape_im, shape_std (set, channel, mode), and each of the sets' conditions (set,) by its
        name, numbers as numbers and words as text; NaN or '' where not known. Units are attributes."""
        import xarray

        names = self.labels or tuple(str(j + 1) for j in range(self.n_mode))
        vector, table = ("set", "mode"), ("set", "channel", "mode")

        def stacked(name: str, part: Callable = np.real) -> np.ndarray:
            return np.array([part(getattr(s, name)) for s in self.sets])

        variables: dict[str, tuple] = {
            "frequency_hz": (vector, stacked("frequency_hz"), {"units": "Hz"}),
            "frequency_std_hz": (vector, stacked("frequency_std_hz"), {"units": "Hz"}),
            "damping_ratio": (vector, stacked("damping_ratio"), {"units": "1"}),
            "damping_ratio_std": (vector, stacked("damping_ratio_std"), {"units": "1"}),
            "shape_re": (table, stacked("shape"), {"units": "1"}),
            "shape_im": (table, stacked("shape", np.imag), {"units": "1"}),
            "shape_std": (table, stacked("shape_std"), {"units": "1"}),
        }
        for key in sorted({key for s in self.sets for key in s.environment}):
            if key in variables or key in table or key in vector:
                raise InputError(f"condition {key}", "has the name of something else in the dataset", "rename it")
            values = [s.environment.get(key) for s in self.sets]
            words = any(isinstance(v, str) for v in values)
            known = ["" if v is None else str(v) for v in values] if words else [np.nan if v is None else v for v in values]
            variables[key] = ("set", np.array(known, dtype=object if words else float))
        coordinates = {"set": [s.id for s in self.sets], "channel": list(self.channels), "mode": list(names)}
        return xarray.Dataset(variables, coords=coordinates)

    @property
    def n_mode(self) -> int:
        return self.sets[0].frequency_hz.size

    def of_modes(self, columns: Sequence[int]) -> ModalData:
        """The same sets with these modes alone, in this order."""
        columns = [int(j) for j in columns]
        return replace(self, sets=tuple(s.of_modes(columns) for s in self.sets),
                       labels=tuple(self.labels[j] for j in columns) if self.labels else (),
                       records=tuple(self.records[j] for j in columns) if self.records else ())

    def compared(self, every: bool = False) -> ModalData:
        """The modes that are compared with a model: those of interest, by their names; with `every` also those that
        have a number but look like another mode of the model. All, where no identification says what they are."""
        if not any(r.match for r in self.records):
            return self
        kept = [j for j, r in enumerate(self.records) if not r.label.isdigit() or (every and r.match == "alike")]
        return self if len(kept) in (0, self.n_mode) else self.of_modes(kept)

    def set(self, id: str | None = None) -> ModalSet:
        """The set of that id; without one the reference set, or the first."""
        wanted = id or self.reference_set or self.sets[0].id
        for s in self.sets:
            if s.id == wanted:
                return s
        ids = ", ".join(s.id for s in self.sets[:9]) + (", ..." if len(self.sets) > 9 else "")
        raise InputError(f"set {wanted}", "there is none of that id", f"there are {ids}")


def _numbers(where: str, value, shape: tuple[int, ...], key: str) -> np.ndarray:
    if value is None:
        return np.full(shape, np.nan)
    if not isinstance(value, list):
        raise InputError(f"{where}, {key}", f"{value!r} is no list", "use a list of numbers, null where not measured")
    flat = [x for row in value for x in (row if isinstance(row, list) else [row])]
    # JSON knows no NaN; it is a failed computation as likely as a mode that was not measured
    if any(isinstance(x, float) and np.isnan(x) for x in flat):
        raise InputError(f"{where}, {key}", "holds NaN", "use null where not measured")
    if any(isinstance(x, str | bool) for x in flat):
        wrong = next(x for x in flat if isinstance(x, str | bool))
        raise InputError(f"{where}, {key}", f"{wrong!r} is not a number", "use numbers, null where not measured")
    try:
        array = np.array(
            [[np.nan if x is None else x for x in row] if isinstance(row, list) else (np.nan if row is None else row)
             for row in value], dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(f"{where}, {key}", f"not a table of numbers ({str(error).split('.')[0]})",
                         "use numbers, null where not measured") from None
    # a whole row may be null: a mode that was not measured in this set
    if len(shape) == 2 and array.ndim == 1 and np.all(np.isnan(array)):
        array = np.full(shape, np.nan)
    if np.any(np.isinf(array)):
        raise InputError(f"{where}, {key}", "holds an infinite number", "use null where not measured")
    if array.shape != shape:
        raise InputError(f"{where}, {key}", f"has shape {array.shape}", f"give {shape}")
    return array


def _expand_null_rows(value, n: int):
    """Replace a null row of a shape table by a row of nulls."""
    return [[None] * n if row is None else row for row in value] if isinstance(value, list) else value


# numbers of all shapes of a set
LARGEST_SHAPES = 10_000_000
# a damping ratio from which nothing vibrates any more, and the largest that the modes of a whole file may have in the
# middle: structures have 0.002 to 0.1, in per cent the same numbers are 0.2 to 10
NO_VIBRATION, MIDDLE_DAMPING = 1.0, 0.2


def _refuse_per_cent(path: Path, sets: Sequence[ModalSet]) -> None:
    """Damping ratios of which the middle one, or any, is none of a structure."""
    known = np.concatenate([s.damping_ratio[np.isfinite(s.damping_ratio)] for s in sets]) if sets else np.zeros(0)
    if not len(known):
        return
    highest = max(sets, key=lambda s: np.max(s.damping_ratio, initial=-np.inf, where=np.isfinite(s.damping_ratio)))
    most = float(np.nanmax(highest.damping_ratio))
    if most >= NO_VIBRATION or np.median(known) > MIDDLE_DAMPING:
        raise InputError(f"{path}, set {highest.id}, damping_ratio", f"{most:.4g} (median of the file "
                         f"{np.median(known):.3g}) is no share of critical damping that a structure has: are these per "
                         "cent?",
                         "give fractions, 0.01 for 1 %, or null where not measured")


def _refuse_odd(where: str, environment: Mapping) -> None:
    """Conditions are numbers or words; an infinite one is a failed computation."""
    for key, value in environment.items():
        plain = value is None or isinstance(value, str | int) or (isinstance(value, float) and np.isfinite(value))
        if not plain:
            raise InputError(f"{where}, {key}", f"{value!r:.60} is neither a number nor a word", "mend it or leave it out")


SET_KEYS = {
    "id", "frequency_hz", "damping_ratio", "frequency_std_hz", "damping_ratio_std", "shape_re", "shape_im", "shape_std",
    "environment",
}


def _refuse_misspelt(where: str, table: Mapping, known: set[str]) -> None:
    """Other tools may add keys of their own; one that almost is ours is a slip and would be lost without a word."""
    for key in set(table) - known:
        close = difflib.get_close_matches(key, known, n=1, cutoff=0.8)
        if close:
            raise InputError(where, f"unknown key '{key}'", f"did you mean '{close[0]}'?")


# what a file is by its ending that is given for modal sets and is no JSON
NO_MODES = {
    ".npz": "an archive of arrays such as a model's", ".toml": "a TOML file such as a model's or a campaign's",
    ".dat": "a table such as a SubDyn file", ".csv": "a table", ".h5": "an HDF5 file such as a record",
    ".nc": "a NetCDF file such as a posterior", ".uff": "a universal file (probupdate convert --to modes)",
    ".unv": "a universal file (probupdate convert --to modes)",
}


def read_modes(path: str | Path) -> ModalData:
    """Read `modes.json` (interfaces: channels, sets; optional labels, reference_set)."""
    path = Path(path)
    with of_file(path), parsing(str(path), "is no modes.json", "see docs/formats/modes.md"):
        return _read_modes(path)


def _read_modes(path: Path) -> ModalData:
    absent = "check the path, or run `probupdate identify` first"
    try:
        content = read_json(path, absent=absent, nan=True)
    except InputError:
        kind = NO_MODES.get(path.suffix.lower())
        if kind is None or not path.is_file():
            raise
        raise InputError(str(path), f"is {kind}, not modal sets", "give a modes.json, as `probupdate identify` writes it"
                         ) from None
    if not isinstance(content, dict) or not isinstance(content.get("sets"), list) or "channels" not in content:
        raise InputError(str(path), "'channels' or 'sets' is missing", "see docs/formats/modes.md")
    _refuse_misspelt(str(path), content, {"channels", "sets", "labels", "reference_set", "deviations", "format",
                                          "mode_records", "model_only"})
    if isinstance(content.get("format"), int) and content["format"] > FORMAT:
        raise InputError(str(path), f"has the format {content['format']!r}; {FORMAT} is the newest known",
                         "read it with the version that wrote it, or identify again")
    channels = _texts(path, content, "channels")
    if len(set(channels)) < len(channels):
        raise InputError(f"{path}, channels", "a channel is listed twice", "keep one")
    deviations = read_deviations(path, content["deviations"]) if content.get("deviations") is not None else {}
    sets = []
    for number, raw in enumerate(content["sets"]):
        if not isinstance(raw, dict):
            raise InputError(f"{path}, set {number}", "is not a table", 'write {"id": ..., "frequency_hz": [...]}')
        where = f"{path}, set {raw.get('id', number)}"
        _refuse_misspelt(where, raw, SET_KEYS)
        if not isinstance(raw.get("frequency_hz"), list) or "shape_re" not in raw:
            raise InputError(where, "'frequency_hz' or 'shape_re' is missing or no list",
                             "give both; null where not measured")
        if not isinstance(raw.get("environment") or {}, dict):
            raise InputError(f"{where}, environment", "is not a table", 'write {"water_level_m": 0.2}')
        n_mode, n_channel = len(raw["frequency_hz"]), len(channels)
        table, vector = (n_mode, n_channel), (n_mode,)
        if n_mode * n_channel > LARGEST_SHAPES:
            raise InputError(where, f"{n_mode} modes at {n_channel} channels are more than a set can have", "give fewer")
        _refuse_odd(f"{where}, environment", raw.get("environment") or {})
        real = _numbers(where, _expand_null_rows(raw["shape_re"], n_channel), table, "shape_re")
        imaginary = _numbers(where, _expand_null_rows(raw.get("shape_im"), n_channel), table, "shape_im")
        frequency = _numbers(where, raw["frequency_hz"], vector, "frequency_hz")
        if np.any(frequency <= 0):
            raise InputError(f"{where}, frequency_hz", "a frequency is not positive", "use null where not measured")
        std = {key: _numbers(where, raw.get(key), vector, key) for key in ("frequency_std_hz", "damping_ratio_std")}
        for key, value in std.items():
            if np.any(value < 0):
                raise InputError(f"{where}, {key}", "a standard deviation is negative", "use null where unknown")
        deviation = deviations.get(str(raw.get("id", number)))
        sets.append(
            ModalSet(
                id=str(raw.get("id", number)),
                frequency_hz=frequency,
                shape=(real + 1j * np.nan_to_num(imaginary)).T,
                damping_ratio=_numbers(where, raw.get("damping_ratio"), vector, "damping_ratio"),
                shape_std=_numbers(
                    where, _expand_null_rows(raw.get("shape_std"), n_channel), table, "shape_std").T,
                environment=raw.get("environment") or {},
                deviation=None if deviation is None else ModalDeviation(**deviation),
                **std,
            )
        )
    _refuse_per_cent(path, sets)
    return ModalData(
        channels=channels,
        sets=tuple(sets),
        labels=_texts(path, content, "labels"),
        reference_set=_text_or_none(path, content, "reference_set"),
        records=_records(path, content, "mode_records", ModeRecord),
        model_only=_records(path, content, "model_only", ModelMode),
    )


def _text_or_none(path: Path, content: Mapping, key: str) -> str | None:
    value = content.get(key)
    if value is not None and not isinstance(value, str):
        raise InputError(f"{path}, {key}", f"{value!r:.60} is no text", "name a set's id, or leave the key out")
    return value


def _records(path: Path, content: Mapping, key: str, kind: type) -> tuple:
    """Plain values by the names of the record's fields; null is NaN; keys that are not known are other tools'."""
    rows, found = content.get(key) or [], []
    known = {f.name: f.type for f in fields(kind)}
    if not isinstance(rows, list):
        raise InputError(f"{path}, {key}", "is no list", "identify again, or leave the key out")
    for number, row in enumerate(rows):
        where = f"{path}, {key} {number + 1}"
        if not isinstance(row, dict) or not isinstance(row.get("label"), str):
            raise InputError(where, "is no table with a label", "identify again, or leave the key out")
        _refuse_misspelt(where, row, set(known))
        value = {}
        for name in set(row) & set(known):
            try:
                value[name] = _plain(row[name], known[name])
            except (TypeError, ValueError, AttributeError):
                raise InputError(f"{where}, {name}", f"{row[name]!r} is not what belongs there",
                                 "identify again, or leave the key out") from None
        try:
            found.append(kind(**value))
        except TypeError:
            raise InputError(where, f"lacks one of {', '.join(known)}",
                             "identify again, or leave the key out") from None
    return tuple(found)


def _plain(value, kind: str | type):
    """A JSON value as a field of that kind, a name as annotations are written in this module."""
    kind = str(kind)
    if kind == "float":
        return np.nan if value is None else float(value)
    if kind == "int":
        return int(value)
    if kind.startswith("Mapping"):
        return {str(state): (int(n), int(of)) for state, (n, of) in value.items()}
    if kind.startswith("tuple"):
        return tuple((str(name), float(share)) for name, share in value)
    if (kind == "bool") != isinstance(value, bool) or (kind == "str") != isinstance(value, str):
        raise ValueError
    return value


def _texts(path: Path, content: Mapping, key: str) -> tuple[str, ...]:
    value = content.get(key, [])
    if not isinstance(value, list) or not all(isinstance(x, str) for x in value):
        raise InputError(f"{path}, {key}", "is not a list of names", 'write ["TP-A-x", ...]')
    return tuple(value)


def _nulls(array: np.ndarray):
    """Nested lists with None for NaN."""
    return [_nulls(row) if np.ndim(row) else (float(row) if np.isfinite(row) else None) for row in array]


def write_modes(data: ModalData, path: str | Path) -> None:
    """Write `modes.json`, and where a set has deviations `<stem>.deviations.h5` before it; `read_modes` inverts it."""
    content: dict = {"format": FORMAT, "channels": list(data.channels)}
    if data.labels:
        content["labels"] = list(data.labels)
    if data.reference_set is not None:
        content["reference_set"] = data.reference_set
    for key, rows in (("mode_records", data.records), ("model_only", data.model_only)):
        if rows:
            content[key] = [{name: None if isinstance(x, float) and not np.isfinite(x) else x
                             for name, x in asdict(row).items()} for row in rows]
    tail = {}
    with_deviation = {s.id: s.deviation for s in data.sets if s.deviation is not None}
    if with_deviation:
        tail["deviations"] = write_deviations(with_deviation, Path(path))
    # set by set: a year's numbers as Python's are a gigabyte
    write_json_rows(path, content, "sets", map(_set_content, data.sets), tail)


def _set_content(s: ModalSet) -> dict:
    return {
        "id": s.id,
        "frequency_hz": _nulls(s.frequency_hz),
        "damping_ratio": _nulls(s.damping_ratio),
        "frequency_std_hz": _nulls(s.frequency_std_hz),
        "damping_ratio_std": _nulls(s.damping_ratio_std),
        "shape_re": _nulls(np.real(s.shape).T),
        "shape_im": _nulls(np.imag(s.shape).T),
        "shape_std": _nulls(s.shape_std.T),
        "environment": {k: (v if isinstance(v, str) or np.isfinite(v) else None) for k, v in s.environment.items()},
    }


# Criteria. Components that are NaN in either shape are left out of every one of them.


def mac(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Modal assurance criterion |a^H b|^2 / (a^H a b^H b) of each column of a with each of b -> (n_a, n_b).

    a (n_channel, n_a), b (n_channel, n_b), real or complex (Allemang & Brown 1982). NaN where a pair shares no
    measured component.
    """
    a, b = np.atleast_2d(np.asarray(a).T).T, np.atleast_2d(np.asarray(b).T).T
    ok_a, ok_b = np.isfinite(a), np.isfinite(b)
    x, y = np.where(ok_a, a, 0), np.where(ok_b, b, 0)
    cross = np.abs(x.conj().T @ y) ** 2
    norm_a = (np.abs(x) ** 2).T @ ok_b.astype(float)
    norm_b = ok_a.astype(float).T @ np.abs(y) ** 2
    with np.errstate(invalid="ignore", divide="ignore"):
        return cross / (norm_a * norm_b)


def subspace_mac(shape: np.ndarray, plane: np.ndarray) -> np.ndarray:
    """S2MAC: the largest MAC of each column of `shape` with any vector of the space that `plane` spans.

    shape (n_channel, n_mode), plane (n_channel, 2 or more) -> (n_mode,) (D'Ambrogio & Fregolent 2003).
    """
    shape = np.atleast_2d(np.asarray(shape).T).T
    value = np.full(shape.shape[1], np.nan)
    for j, column in enumerate(shape.T):
        ok = np.isfinite(column) & np.all(np.isfinite(plane), axis=1)
        if ok.sum() <= plane.shape[1]:
            continue
        basis, _ = np.linalg.qr(plane[ok])
        value[j] = np.linalg.norm(basis.conj().T @ column[ok]) ** 2 / np.linalg.norm(column[ok]) ** 2
    return value


def plane_mac(a: np.ndarray, b: np.ndarray) -> float:
    """Squared cosine of the largest principal angle between the planes of a and b, both (n_channel, 2 or more)."""
    ok = np.all(np.isfinite(a), axis=1) & np.all(np.isfinite(b), axis=1)
    qa, _ = np.linalg.qr(a[ok])
    qb, _ = np.linalg.qr(b[ok])
    return float(np.linalg.svd(qa.conj().T @ qb, compute_uv=False)[-1] ** 2)


def modal_phase_collinearity(shape: np.ndarray) -> np.ndarray:
    """MPC of each column (n_mode,): 1 for a shape that is real up to a phase, 0 for an even spread of phases.

    ((S_xx - S_yy)^2 + 4 S_xy^2) / (S_xx + S_yy)^2 with x, y the real and imaginary parts (Pappa 1993).
    """
    shape = np.atleast_2d(np.asarray(shape, complex).T).T
    x, y = np.nan_to_num(np.real(shape)), np.nan_to_num(np.imag(shape))
    sxx, syy, sxy = (x * x).sum(0), (y * y).sum(0), (x * y).sum(0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return ((sxx - syy) ** 2 + 4 * sxy**2) / (sxx + syy) ** 2


def rotate_to_real(shape: np.ndarray) -> np.ndarray:
    """Turn each complex column so that its components lie closest to the real axis (largest component positive)."""
    shape = np.array(np.atleast_2d(np.asarray(shape, complex).T).T)
    for j in range(shape.shape[1]):
        column = shape[:, j]
        ok = np.isfinite(column)
        if not ok.any():
            continue
        # the angle that maximises sum Re^2 is half the phase of sum phi^2
        column = column * np.exp(-0.5j * np.angle(np.sum(column[ok] ** 2)))
        largest = np.argmax(np.where(ok, np.abs(column), -1))
        shape[:, j] = column * (1 if column[largest].real >= 0 else -1)
    return shape


def normalise(shape: np.ndarray) -> np.ndarray:
    """Scale each column so that its largest component is +1 (complex: that component becomes real)."""
    shape = np.array(np.atleast_2d(np.asarray(shape).T).T)
    for j in range(shape.shape[1]):
        ok = np.isfinite(shape[:, j])
        if ok.any():
            largest = np.argmax(np.where(ok, np.abs(shape[:, j]), -1))
            shape[:, j] = shape[:, j] / shape[largest, j]
    return shape


def unit_largest(shape: np.ndarray) -> np.ndarray:
    """Columns turned to lie along the real axis, the largest real part +1 (what imaginary part is left stays)."""
    turned = rotate_to_real(shape)
    real = np.real(turned)
    largest = np.argmax(np.abs(np.nan_to_num(real)), axis=0)
    return turned / real[largest, np.arange(real.shape[1])]


def pair_by_mac(criterion: np.ndarray) -> list[tuple[int, int]]:
    """One-to-one pairs (row, column) that maximise the summed criterion (n_row, n_column); NaN never pairs."""
    from scipy import optimize

    score = np.nan_to_num(criterion, nan=-1.0)
    rows, columns = optimize.linear_sum_assignment(-score)
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if score[i, j] > -1]
