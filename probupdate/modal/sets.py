"""Sensors, modal sets and what an identification says of its modes: the words that measurement and model share.

Mode shapes are columns: (n_channel, n_mode). NaN marks a mode or a component that was not measured.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from difflib import get_close_matches
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from probupdate.errors import InputError
from probupdate.io.result_table import table_of
from probupdate.modal.mode_choice import ModeChoice
from probupdate.runtime.arrays import frozen_array

if TYPE_CHECKING:
    import pandas as pd
    import xarray

QUANTITIES = ("acceleration", "velocity", "displacement")
OTHER_QUANTITIES = ("strain", "inclination", "tilt", "rotation", "angular velocity", "force", "pressure", "temperature")

NOT_STATED = frozen_array(())
# no sensor is farther from the origin of its model
FARTHEST_M = 1e7
# label of a member's own modes
LOCAL = "L"
# of a measured mode that is surely one of the model's: as in common practice MAC from 0.9 and frequencies within 10 %,
# and no other candidate
SURE_PROBABILITY, SURE_MAC, SURE_DEVIATION = 0.95, 0.9, 0.1


@dataclass(frozen=True, eq=False, kw_only=True)
class Sensor:
    """One measured channel; position and direction in model axes, z = 0 at mean sea level. `gravity`: whether its
    readings hold gravity's component through the tilt of its place, as those of accelerometers and geophones do; where
    it is not stated (None) acceleration and velocity hold it, a displacement does not."""

    channel: str
    level: str
    position_m: np.ndarray
    direction: np.ndarray
    quantity: str = "acceleration"
    unit: str = "m/s2"
    gravity: bool | None = None

    def __post_init__(self):
        where = f"sensor {self.channel}"
        odd = [x for part in (self.position_m, self.direction) if isinstance(part, list) for x in part
               if isinstance(x, bool | str)]
        if odd:
            raise InputError(where, f"position_m or direction holds {odd[0]!r:.40}, which is no number",
                             "give [x, y, z]")
        try:
            position, direction = frozen_array(self.position_m), frozen_array(self.direction)
        except (TypeError, ValueError):
            raise InputError(where, "position_m or direction is not three numbers", "give [x, y, z]") from None
        if position.shape != (3,) or not np.all(np.abs(position) < FARTHEST_M):
            raise InputError(where, f"position_m {self.position_m} is not three numbers", "give [x, y, z] in metres")
        if (direction.shape != (3,) or not np.all(np.abs(direction) < 2)
                or not abs(np.linalg.norm(direction) - 1) < 1e-3):
            raise InputError(where, f"direction {self.direction} is not a unit vector",
                             "give three numbers whose squares add up to 1")
        if self.quantity not in QUANTITIES:
            known = f"choose from {', '.join(QUANTITIES)}"
            if self.quantity in OTHER_QUANTITIES:
                raise InputError(where, f"measures {self.quantity}, which is not a motion of a point: its shapes "
                                 "cannot be compared with other sensors or a model",
                                 "convert the other channels alone")
            raise InputError(where, f"quantity '{self.quantity}' is unknown", known)
        if self.gravity is not None and not isinstance(self.gravity, bool):
            raise InputError(f"{where}, gravity", f"{self.gravity!r} is neither true nor false",
                             "write false where gravity was taken out of the readings, or leave it out")
        object.__setattr__(self, "position_m", position)
        object.__setattr__(self, "direction", direction)
        if self.gravity is None:
            object.__setattr__(self, "gravity", self.quantity != "displacement")

    def with_gravity(self, felt: Mapping[str, bool]) -> Sensor:
        """With what is stated of some channels' gravity."""
        return replace(self, gravity=felt.get(self.channel, self.gravity))


@dataclass(frozen=True, eq=False, kw_only=True)
class CovarianceFactors:
    """Covariance factors of one set's modes, a column for each part of the record they were estimated from.

    Scaled so that the covariance of any two of the quantities a and b, rows (n_column,), is the plain sum a @ b; within
    one mode or between two, which for a close pair is not nothing. ln_frequency, damping_ratio (n_mode, n_column);
    shape (n_channel, n_mode, n_column) complex, in the scaling of the set's shape. NaN: a mode not measured, or one
    whose factors could not be estimated. The rank of a joint covariance is below the number of columns: a
    covariance of more quantities than that is singular.
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

    def load(self) -> CovarianceFactors:
        return self

    def of_modes(self, columns: Sequence[int]) -> CovarianceFactors:
        """Of these modes alone; a column of -1 is a mode that was not measured."""
        return CovarianceFactors(ln_frequency=_columns(self.ln_frequency, columns, 0), damping_ratio=_columns(
            self.damping_ratio, columns, 0), shape=_columns(self.shape, columns, 1))

    def of_channels(self, rows: Sequence[int]) -> CovarianceFactors:
        """Of shapes at these channels alone."""
        return replace(self, shape=self.shape[list(rows)])


@dataclass(frozen=True, eq=False, kw_only=True)
class StoredFactors:
    """`CovarianceFactors` that lie on the disk and are read by `read` each time that they are asked for: those of a
    year are most of a gigabyte. `loaded` has them in memory. taken: whether their set has its standard deviations
    from them."""

    read: Callable[[], CovarianceFactors]
    taken: bool = False

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

    def load(self) -> CovarianceFactors:
        return self.read()

    def of_modes(self, columns: Sequence[int]) -> StoredFactors:
        return replace(self, read=partial(_factors_of_modes, self.read, tuple(int(j) for j in columns)))

    def of_channels(self, rows: Sequence[int]) -> StoredFactors:
        return replace(self, read=partial(_factors_of_channels, self.read, tuple(int(k) for k in rows)))


# functions of the module, as those of a process go to another by name
def _factors_of_modes(read: Callable[[], CovarianceFactors], columns: Sequence[int]) -> CovarianceFactors:
    return read().of_modes(columns)


def _factors_of_channels(read: Callable[[], CovarianceFactors], rows: Sequence[int]) -> CovarianceFactors:
    return read().of_channels(rows)


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
    shape_std (n_channel, n_mode), the standard deviation of the real part in the shape's own scaling. NaN: not
    measured. Where `covariance_factors` are given, standard deviations that are NaN are taken from it; given ones stay,
    as a set may be weighted by another scatter than that within its record.
    """

    id: str
    frequency_hz: np.ndarray
    shape: np.ndarray
    damping_ratio: np.ndarray
    frequency_std_hz: np.ndarray
    shape_std: np.ndarray
    environment: Mapping[str, float] = field(default_factory=dict)
    damping_ratio_std: np.ndarray = field(default_factory=lambda: NOT_STATED)
    covariance_factors: CovarianceFactors | StoredFactors | None = None

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
        factors = self.covariance_factors
        if isinstance(factors, CovarianceFactors):
            self._take_std(factors)
        elif factors is not None and (not factors.taken or self._lacks_std()):
            self._take_std(factors.load())
            object.__setattr__(self, "covariance_factors", replace(factors, taken=True))

    def __reduce__(self):
        # to another process: as it was given, its arrays read-only there too
        given = {f.name: getattr(self, f.name) for f in fields(self)}
        given["environment"] = dict(self.environment)
        given["covariance_factors"] = None if self.covariance_factors is None else self.covariance_factors.load()
        return _modal_set, (given,)

    def _lacks_std(self) -> bool:
        pairs = ((self.frequency_hz, self.frequency_std_hz), (self.damping_ratio, self.damping_ratio_std),
                 (self.shape, self.shape_std))
        return any(bool(np.any(np.isfinite(value) & np.isnan(std))) for value, std in pairs)

    def _take_std(self, covariance_factors: CovarianceFactors) -> None:
        if covariance_factors.shape.shape[:2] != self.shape.shape:
            raise InputError(f"set {self.id}",
                             f"its covariance is of {covariance_factors.shape.shape[:2]} channels and modes",
                             f"give {self.shape.shape} as for the shape")
        estimated = {
            "frequency_std_hz": self.frequency_hz * np.sqrt(np.sum(covariance_factors.ln_frequency**2, axis=1)),
            "damping_ratio_std": np.sqrt(np.sum(covariance_factors.damping_ratio**2, axis=1)),
            "shape_std": np.sqrt(np.sum(np.real(covariance_factors.shape) ** 2, axis=2)),
        }
        for name, value in estimated.items():
            given = getattr(self, name)
            object.__setattr__(self, name, frozen_array(np.where(np.isnan(given), value, given)))

    def refuse_zero_shapes(self, where: str) -> None:
        """Raises InputError for a measured mode of which every known component is zero: it is like no shape."""
        known = np.isfinite(self.shape)
        zero = self.measured & known.any(axis=0) & ~np.any(known & (self.shape != 0), axis=0)
        if zero.any():
            raise InputError(where, f"the shape of mode {int(np.argmax(zero)) + 1} is zero at every channel",
                             "leave shapes that were not measured out (null)")

    def of_modes(self, columns: Sequence[int]) -> ModalSet:
        """The same set with these modes alone; a column of -1 is a mode that was not measured."""
        taken = {name: _columns(getattr(self, name), columns, 0)
                 for name in ("frequency_hz", "damping_ratio", "frequency_std_hz", "damping_ratio_std")}
        return replace(self, **taken, shape=_columns(self.shape, columns, 1),
                       shape_std=_columns(self.shape_std, columns, 1),
                       covariance_factors=None if self.covariance_factors is None
                       else self.covariance_factors.of_modes(columns))

    def of_channels(self, rows: Sequence[int]) -> ModalSet:
        """The same set with shapes at these channels alone, in the scaling that they had."""
        rows, factors = list(rows), self.covariance_factors
        return replace(self, shape=self.shape[rows], shape_std=self.shape_std[rows],
                       covariance_factors=None if factors is None else factors.of_channels(rows))

    def with_std(self, frequency: float | None, shape: float | None) -> ModalSet:
        """The same set with standard deviations where none above zero is stated: shares of the frequencies, of the
        largest component of each shape."""
        frequency_std, shape_std = np.array(self.frequency_std_hz), np.array(self.shape_std)
        if frequency is not None:
            frequency_std = np.where(frequency_std > 0, frequency_std, frequency * self.frequency_hz)
        if shape is not None and shape_std.size:
            largest = np.nanmax(np.abs(self.shape), axis=0, initial=0.0)
            stated = np.any(shape_std > 0, axis=0)
            shape_std = np.where(stated | ~np.isfinite(self.shape), shape_std, shape * largest)
        return replace(self, frequency_std_hz=frequency_std, shape_std=shape_std)

    @property
    def measured(self) -> np.ndarray:
        """(n_mode,) bool: modes with a frequency."""
        return np.isfinite(self.frequency_hz)

    @property
    def where(self) -> str:
        """What sentences call it."""
        return set_words(self.id)


def set_words(set_id: str) -> str:
    """What sentences call a set: `set 5`; of several `the mean of 12 blocks`, `36 of 36 sets`."""
    if set_id.startswith("mean of "):
        return f"the {set_id}"
    return set_id if set_id.endswith(" sets") else f"set {set_id}"


def _modal_set(given: dict) -> ModalSet:
    return ModalSet(**given)


@dataclass(frozen=True, kw_only=True)
class ModeRecord:
    """What an identification says of one mode of a campaign.

    frequency_hz, frequency_std_hz, damping_ratio: mean, scatter and median over the `found` of `blocks` usable blocks
    that have it; detection: turbine state -> (found, blocks). pair: compared by the plane with its mate. match:
    'alike', 'unlike' or 'none', of the model that it was held against; '' without one. model_label, model_frequency_hz:
    its counterpart there; mac: mean over the blocks of the MAC (of a pair, S2MAC to the measured plane), mac_std its
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

    @property
    def is_surely_matched(self) -> bool:
        """Whether it is beyond doubt one mode of the model, so that it is compared though nobody asked for it: found in
        most blocks, single, with no other candidate, as alike and as near as modes are usually paired. A member's own
        mode is not: it depends on joints and water that a global model does not describe."""
        label, probability = next(iter(self.alternatives), ("", 0.0))
        return (self.match == "alike" and not self.pair and label == self.model_label
                and not label.startswith(LOCAL) and probability >= SURE_PROBABILITY and self.mac >= SURE_MAC
                and abs(self.frequency_ratio - 1) <= SURE_DEVIATION and 2 * self.found > self.blocks)


@dataclass(frozen=True, kw_only=True)
class ModelMode:
    """A mode of the model that no measured one is; expected: whether the excitation should show it; hardly_seen: it
    would, but the sensors are near the mode's nodes."""

    label: str
    frequency_hz: float
    expected: bool
    hardly_seen: bool = False


@dataclass(frozen=True, eq=False, kw_only=True)
class ModalData:
    """What `modes.json` holds: channels, sets, and optionally the set an update should start from; of an identification
    also a record a mode, and the modes of the model that it did not find.

    Column j is the same physical mode in every set; `labels` may name them (FA1, SS1, ...). `gravity` (n_channel,):
    whether the channels' readings hold gravity (see `Sensor`); () where it is not stated. `choice`: the poles that were
    picked as modes by hand, where they were.
    """

    channels: tuple[str, ...]
    sets: tuple[ModalSet, ...]
    labels: tuple[str, ...] = ()
    reference_set: str | None = None
    records: tuple[ModeRecord, ...] = ()
    model_only: tuple[ModelMode, ...] = ()
    gravity: tuple[bool, ...] = ()
    choice: ModeChoice | None = None

    @property
    def felt(self) -> dict[str, bool]:
        """`gravity` by channels; empty where it is not stated."""
        return dict(zip(self.channels, self.gravity, strict=True)) if self.gravity else {}

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
            twice = next(i for i, n in Counter(ids).items() if n > 1)
            raise InputError(f"modal data, set {twice}", "two sets share one id", "give each set its own")
        if self.labels and len(self.labels) != n_mode:
            raise InputError("modal data", f"{len(self.labels)} labels for {n_mode} modes", "give one label a mode")
        if self.gravity and len(self.gravity) != len(self.channels):
            raise InputError("modal data, gravity", f"has {len(self.gravity)} values for {len(self.channels)} channels",
                             "give one a channel, or leave it out")
        if self.records and len(self.records) != n_mode:
            raise InputError("modal data", f"{len(self.records)} records for {n_mode} modes", "give one a mode")
        if self.reference_set is not None and self.reference_set not in ids:
            raise InputError("modal data", f"reference_set '{self.reference_set}' is not a set's id",
                             "name one of them")

    def to_frame(self) -> pd.DataFrame:
        """A row a set and mode: frequency, damping ratio, their standard deviations; NaN where not measured."""
        names = self.labels or tuple(str(j + 1) for j in range(self.n_mode))
        return table_of([
            {"id": s.id, "mode": names[j], "frequency_hz": s.frequency_hz[j], "frequency_std_hz": s.frequency_std_hz[j],
             "damping_ratio": s.damping_ratio[j], "damping_ratio_std": s.damping_ratio_std[j]}
            for s in self.sets for j in range(self.n_mode)
        ])

    def to_xarray(self) -> xarray.Dataset:
        """The sets as an xarray dataset that `to_netcdf` writes: frequency_hz, damping_ratio and their standard
        deviations (set, mode), shape_re, shape_im, shape_std (set, channel, mode), and each of the sets' conditions
        (set,) by its name, numbers as numbers and words as text; NaN or '' where not known. Units are attributes."""
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
            known = ["" if v is None else str(v) for v in values] if words else (
                [np.nan if v is None else v for v in values])
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

    def of_labels(self, labels: Sequence[str | int]) -> ModalData:
        """The same sets with these modes alone, in the order of the file; by their numbers, from 1, where they have no
        labels. Raises InputError for one that is not there."""
        known = self.labels or tuple(str(j + 1) for j in range(self.n_mode))
        labels = [str(label) for label in labels]
        for label in labels:
            if label not in known:
                near = get_close_matches(label, known, n=1)
                raise InputError(f"mode {label}", "is to be compared, but there is none of that label",
                                 f"did you mean '{near[0]}'? there are {', '.join(known)}" if near else
                                 f"there are {', '.join(known)}")
        chosen = self.of_modes([j for j, label in enumerate(known) if label in labels])
        # who names a mode has it compared, whatever identification says of its counterpart
        return replace(chosen, records=tuple(replace(r, match="") for r in chosen.records))

    def without_channels(self, names: Sequence[str]) -> ModalData:
        """The same sets without these channels. Raises InputError for one that is not there, or where none is left."""
        if not names:
            return self
        for name in names:
            if name not in self.channels:
                raise InputError(f"channel {name}", "is to be left out, but there is none of that name",
                                 f"there are {', '.join(self.channels) or 'no channels at all'}")
        rows = [k for k, name in enumerate(self.channels) if name not in names]
        if self.channels and not rows:
            raise InputError("channels", "all of them are to be left out", "keep those that can be trusted")
        return replace(self, channels=tuple(self.channels[k] for k in rows),
                       gravity=tuple(self.gravity[k] for k in rows if self.gravity),
                       sets=tuple(s.of_channels(rows) for s in self.sets))

    def frequencies_alone(self) -> ModalData:
        """The same sets without their shapes."""
        return replace(self, channels=(), sets=tuple(s.of_channels([]) for s in self.sets))

    def with_std(self, frequency: float | None = None, shape: float | None = None) -> ModalData:
        """The same sets where every frequency without a standard deviation above zero has `frequency` times itself, and
        every component of a shape `shape` times the shape's largest."""
        if frequency is None and shape is None:
            return self
        for name, share in (("frequency_std", frequency), ("shape_std", shape)):
            if share is not None and not 0 < share < 1:
                raise InputError(name, f"{share:g} is no share between 0 and 1",
                                 f"give a share, such as {0.01 * share:g} for {share:g} %" if 1 <= share < 100 else
                                 "give a share, such as 0.005")
        given = replace(self, sets=tuple(s.with_std(frequency, shape) for s in self.sets))
        for name, share, stated, kind in (("frequency_std", frequency, "frequency_std_hz", "frequency"),
                                          ("shape_std", shape, "shape_std", "shape")):
            if share is not None and all(np.array_equal(getattr(one, stated), getattr(two, stated), equal_nan=True)
                                         for one, two in zip(self.sets, given.sets, strict=True)):
                raise InputError(name, f"would do nothing: no {kind} lacks a standard deviation above zero",
                                 f"leave it out, or write null for the {stated} that it is to replace")
        return given

    def compared(self, every: bool = False, sure: bool = False) -> ModalData:
        """The modes that are compared with a model: those of interest, by their names; with `sure` also numbered ones
        that are surely another mode of the model, with `every` all that look like one. All, where no identification
        says what they are."""
        if not any(r.match for r in self.records):
            return self
        kept = [j for j, r in enumerate(self.records)
                if not r.label.isdigit() or (sure and r.is_surely_matched) or (every and r.match == "alike")]
        return self if len(kept) in (0, self.n_mode) else self.of_modes(kept)

    def set(self, id: str | None = None) -> ModalSet:
        """The set of that id; without one the reference set, or the first."""
        wanted = id or self.reference_set or self.sets[0].id
        for s in self.sets:
            if s.id == wanted:
                return s
        ids = ", ".join(s.id for s in self.sets[:9]) + (", ..." if len(self.sets) > 9 else "")
        raise InputError(f"set {wanted}", "there is none of that id", f"there are {ids}")
