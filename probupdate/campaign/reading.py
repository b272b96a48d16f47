"""A campaign directory read: its sensors, its files in the order of their starts, its SCADA. No record is loaded."""

from __future__ import annotations

import difflib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, NoReturn

import numpy as np
import pandas as pd

from probupdate.campaign import parquet_records, zarr_records
from probupdate.campaign.parquet_records import parquet_head
from probupdate.campaign.scada import EARLIEST, LATEST, StatedScada, read_scada
from probupdate.campaign.stated import UNITS, refuse_other_words
from probupdate.campaign.zarr_records import zarr_head
from probupdate.errors import InputError, parsing
from probupdate.io.files import input_file, input_folder, path_inside, present, read_toml
from probupdate.io.hdf5_file import open_hdf5
from probupdate.io.schema import Length, Range, table_as
from probupdate.modal.modes import Sensor

# how long a block must be its rate decides, by the samples that identify a mode at all: a laboratory's kHz record may
# be of seconds; what is longer than a day is not a block
FEWEST_SAMPLES, LONGEST_BLOCK_MINUTES = 100, 1440.0
HIGHEST_RATE_HZ = 1e5
# of one file: ten years
LONGEST_RECORD_S = 3.2e8
# what one block may take in memory, at eight bytes a sample; reading and checking hold a few copies of it
LARGEST_BLOCK_BYTES = 128 * 2**20
# what stands in a campaign.toml that is to be filled in
BLANK = "?"
WAIT = "wait until what copies or moves records is done, and run again"


@dataclass(frozen=True, kw_only=True)
class WrittenSensor:
    """A [[sensor]] of campaign.toml as it is written; position_m, direction and gravity `Sensor` checks, wherever they
    come from."""

    channel: Annotated[str, Length(1)]
    level: str
    position_m: object
    direction: object
    quantity: str = "acceleration"
    unit: str = "m/s2"
    gravity: object = None


Positive = Annotated[float, Range(0, above=True)]


@dataclass(frozen=True, kw_only=True)
class WrittenCampaign:
    """campaign.toml as it is written: kinds and bounds of its keys."""

    sampling_rate_hz: Positive
    block_minutes: Positive
    name: str | None = None
    # no sea is deeper
    water_depth_m: Annotated[float, Range(0, 11_000, above=True)] | None = None
    rated_power_kw: Positive | None = None
    x_axis_heading_deg: Annotated[float, Range(-360, 360)] = 180.0
    leave_out: tuple[str, ...] = ()
    scada: Mapping[str, object] = field(default_factory=dict)
    sensor: tuple[Mapping[str, object], ...] = ()


@dataclass(frozen=True, kw_only=True)
class RecordFile:
    """One HDF5 or Parquet file or Zarr array of the campaign; `start` is UTC. size, changed_ns: of the file when it was
    scanned, before its head was read; of an array size of its head, and the last change of any of its files. spans:
    rows (first, end) of which an array has chunks; all of the file where empty."""

    path: Path
    start: pd.Timestamp
    n_sample: int
    size: int
    changed_ns: int
    spans: tuple[tuple[int, int], ...] = ()

    def refuse_changed(self, first: int, last: int) -> None:
        """Raises InputError where the file, or of an array what holds rows `first` to `last`, is no more what was
        scanned: a copy or a sync that goes on would put another hour's samples in its place."""
        with parsing(str(self.path), "was there when the campaign was scanned and cannot be read now", WAIT):
            if self.path.suffix == zarr_records.ENDING:
                good = ((self.path / zarr_records.HEAD).stat().st_size == self.size
                        and zarr_records.last_change(self.path, first, last) <= self.changed_ns)
            else:
                good = _state(self.path) == (self.size, self.changed_ns)
        if not good:
            self.refuse()

    def refuse_other(self, start: object) -> None:
        """Raises InputError where the start that was read with the samples is not the one that was scanned: a sync may
        keep size and time of a file."""
        if parse_time(_text(start), f"{self.path}, start") != self.start:
            self.refuse()

    def refuse(self) -> NoReturn:
        raise InputError(str(self.path), "changed while it was used: it is not the file that was scanned at the start "
                         "of this run", WAIT)

    @property
    def parts(self) -> tuple[Path, ...]:
        """The file itself, or those of an array."""
        if self.path.suffix != zarr_records.ENDING:
            return (self.path,)
        return tuple(self.path / name for name in zarr_records.zarr_files(self.path))


def _state(path: Path) -> tuple[int, int]:
    """Size and time of the last change of a file; of an array those of its head and of any of its files."""
    if path.suffix == zarr_records.ENDING:
        return (path / zarr_records.HEAD).stat().st_size, zarr_records.last_change(path)
    found = path.stat()
    return found.st_size, found.st_mtime_ns


@dataclass(frozen=True, eq=False, kw_only=True)
class Campaign:
    """What was measured and where it lies; `files` ordered by start, `scada` indexed by UTC time or None.

    rated_power_kw distinguishes idling from operation; None: the highest power recorded stands for it.
    x_axis_heading_deg: the compass heading (clockwise) of the model's x axis; 180 unless campaign.toml gives it, so
    that a nacelle of heading 0 looks along -x. columns:
    where the sensors' samples are in the files; left_out: channels of the files that campaign.toml says not to use.
    turned: channels whose samples are taken with the other sign, as their direction here is the opposite of the stated.
    """

    path: Path
    name: str
    sensors: tuple[Sensor, ...]
    sampling_rate_hz: float
    block_minutes: float
    water_depth_m: float | None
    rated_power_kw: float | None
    x_axis_heading_deg: float
    files: tuple[RecordFile, ...]
    scada: pd.DataFrame | None
    columns: tuple[int, ...]
    left_out: tuple[str, ...] = ()
    turned: tuple[str, ...] = ()

    @property
    def channels(self) -> tuple[str, ...]:
        return tuple(s.channel for s in self.sensors)

    @property
    def unit_factor(self) -> np.ndarray:
        """(n_channel,) what the records are multiplied with to be in SI."""
        return np.array([UNITS[s.quantity][s.unit] * (-1 if s.channel in self.turned else 1) for s in self.sensors])


def suggest(key: str, known: tuple[str, ...]) -> str:
    close = difflib.get_close_matches(key, known, n=1, cutoff=0.6)
    if not known:
        return "there are none"
    return f"did you mean '{close[0]}'?" if close else f"known are {', '.join(known)}"


@dataclass(frozen=True, eq=False, kw_only=True)
class CampaignHead:
    """What campaign.toml alone says."""

    written: WrittenCampaign
    sensors: tuple[Sensor, ...]

    @property
    def channels(self) -> tuple[str, ...]:
        return tuple(s.channel for s in self.sensors)

    @property
    def sampling_rate_hz(self) -> float:
        return self.written.sampling_rate_hz

    @property
    def block_minutes(self) -> float:
        return self.written.block_minutes


def campaign_toml(place: str | Path) -> Path:
    """That of a campaign's folder, or the file itself."""
    path = Path(place)
    return path / "campaign.toml" if path.is_dir() else path


def read_head(path: str | Path) -> CampaignHead:
    """Read campaign.toml. Raises InputError where a key, a unit or a number is not what the campaign's layout says."""
    path = Path(path)
    raw = read_toml(path, absent="write it, or give the folder that holds it")
    _refuse_blanks(path, raw)
    written = table_as(WrittenCampaign, raw, str(path))
    sensors = _sensors(path, written.sensor)
    refuse_absurd(path, written.sampling_rate_hz, written.block_minutes, len(sensors))
    return CampaignHead(written=written, sensors=sensors)


def read_campaign(path: str | Path) -> Campaign:
    """Read campaign.toml, scada.csv (may be absent) and the heads of acceleration/*.h5, *.parquet and *.zarr.

    Raises InputError where a key, a unit or a file is not what the campaign's layout says.
    """
    path = input_folder(path, remedy="give the folder that holds campaign.toml")
    where = path_inside(path / "campaign.toml", path)
    head = read_head(where)
    written, scada = head.written, path / "scada.csv"
    left_out = _excluded_channels(where, written.leave_out, head.channels)
    columns = tuple(k for k, c in enumerate(head.channels) if c not in left_out)
    return Campaign(
        path=path,
        name=path.name if written.name is None else written.name,
        sensors=tuple(head.sensors[k] for k in columns),
        sampling_rate_hz=head.sampling_rate_hz,
        block_minutes=head.block_minutes,
        water_depth_m=written.water_depth_m,
        rated_power_kw=written.rated_power_kw,
        x_axis_heading_deg=written.x_axis_heading_deg,
        files=_record_files(path / "acceleration", head.sampling_rate_hz, head.sensors),
        scada=_scada(where, written, path_inside(scada, path)) if present(scada) else None,
        columns=columns,
        left_out=left_out,
    )


def _refuse_blanks(path: Path, raw: Mapping) -> None:
    tables = raw.get("sensor")
    left = [key for key, value in raw.items() if value == BLANK]
    for number, table in enumerate(tables if isinstance(tables, list) else (), 1):
        blank = [key for key, value in table.items() if value == BLANK] if isinstance(table, dict) else []
        left += [f"{', '.join(blank)} of {table.get('channel', f'sensor {number}')}"] if blank else []
    if left:
        raise InputError(str(path), f'"{BLANK}" is still to be filled in: {"; ".join(left)}',
                         "write what was measured where, as docs/formats/campaign.md has it")


def _scada(where: Path, written: WrittenCampaign, path: Path) -> pd.DataFrame:
    stated = table_as(StatedScada, written.scada, f"{where}, scada")
    return read_scada(path, rated_power_kw=written.rated_power_kw, stated=stated)


def _excluded_channels(where: Path, names: Sequence[str], channels: tuple[str, ...]) -> tuple[str, ...]:
    """Channels that are in the files but not to be used, such as dead ones."""
    for name in names:
        if name not in channels:
            raise InputError(f"{where}, leave_out", f"'{name}' is not a channel", suggest(name, channels))
    if len(set(names)) == len(channels):
        raise InputError(f"{where}, leave_out", "leaves no channel", "leave out fewer")
    return tuple(c for c in channels if c in names)


def refuse_absurd(where: Path | str, rate_hz: float, block_minutes: float, n_channel: int) -> None:
    """Raises InputError for blocks that hold next to nothing or more than memory should, and for rates of no sensor."""
    if rate_hz > HIGHEST_RATE_HZ:
        raise InputError(f"{where}, sampling_rate_hz", f"{rate_hz:g} Hz is above {HIGHEST_RATE_HZ:g}",
                         "give samples a second")
    here = f"{where}, block_minutes"
    if block_minutes > LONGEST_BLOCK_MINUTES:
        raise InputError(here, f"{block_minutes:g} is more than a day", "give minutes, such as 30")
    n_sample = round(block_minutes * 60 * rate_hz)
    if n_sample < FEWEST_SAMPLES:
        raise InputError(here, f"{block_minutes:g} minutes at {rate_hz:g} Hz are fewer than {FEWEST_SAMPLES} samples",
                         f"give at least {FEWEST_SAMPLES / (60 * rate_hz):.3g} minutes, and many periods of the lowest "
                         "mode")
    if 8 * n_sample * n_channel > LARGEST_BLOCK_BYTES:
        longest = LARGEST_BLOCK_BYTES / (8 * n_channel * 60 * rate_hz)
        raise InputError(here, f"{block_minutes:g} minutes of {n_channel} channels at {rate_hz:g} Hz are "
                         f"{8e-6 * n_sample * n_channel:.0f} MB a block", f"give at most {longest:.3g} minutes")


def _sensors(where: Path, tables: Sequence[Mapping]) -> tuple[Sensor, ...]:
    if not tables:
        raise InputError(str(where), "there is no [[sensor]]", "write one table per channel, in column order")
    sensors: list[Sensor] = []
    for number, table in enumerate(tables, 1):
        here = f"{where}, sensor {table.get('channel', number)}"
        written = table_as(WrittenSensor, table, here)
        try:
            sensor = Sensor(**vars(written))
        except InputError as error:
            # the sensor knows its name, not the file it came from
            raise InputError(here, error.problem, error.remedy) from None
        known = tuple(UNITS[sensor.quantity])
        if sensor.unit not in known:
            raise InputError(here, f"unit '{sensor.unit}' is none of {sensor.quantity}", f"use {', '.join(known)}")
        if sensor.channel in {s.channel for s in sensors}:
            raise InputError(here, "the channel is listed twice", "name each column once")
        sensors.append(sensor)
    return tuple(sensors)


def _record_files(folder: Path, rate_hz: float, sensors: tuple[Sensor, ...]) -> tuple[RecordFile, ...]:
    endings = (".h5", parquet_records.ENDING, zarr_records.ENDING)
    paths = sorted(path for ending in endings for path in folder.glob(f"*{ending}"))
    if not paths:
        raise InputError(str(folder), "holds no .h5 file", "put the records there, or convert them")
    files = []
    for path in paths:
        path_inside(path, folder.parent)
        files.append(_scan_file(path, rate_hz, sensors))
    return tuple(sorted(files, key=lambda f: (f.start, f.path.name)))


def _scan_file(path: Path, rate_hz: float, sensors: tuple[Sensor, ...]) -> RecordFile:
    array, table = (path.suffix == kind.ENDING for kind in (zarr_records, parquet_records))
    input_folder(path, remedy="remove it") if array else input_file(path, "remove it")
    # before the head is read: what takes the file's place meanwhile is not what was scanned
    with parsing(str(path), "cannot be read", "write it again or remove it"):
        state = _state(path)
    spans = ()
    if table:
        start, rate, n_sample = parquet_head(path, sensors)
    elif array:
        start, rate, names, n_sample, spans = zarr_head(path, sensors)
        if names is not None:
            _refuse_renamed(path, names, tuple(s.channel for s in sensors))
    else:
        with open_hdf5(path, "cannot be opened as HDF5", "write it again or remove it") as file:
            start, rate, n_sample = _hdf5_head(path, file, sensors)
    return replace(_check_file(path, n_sample, start, rate, rate_hz, state), spans=spans)


def channels_attribute(channels: tuple[str, ...]) -> str:
    """What the attribute `channels` of a dataset holds: a JSON list of its columns' names."""
    return json.dumps(channels, ensure_ascii=False)


def _hdf5_head(path: Path, file, sensors: tuple[Sensor, ...]) -> tuple[Any, Any, int]:
    import h5py

    n_channel = len(sensors)
    data = file.get("data")
    if not isinstance(data, h5py.Dataset):
        raise InputError(str(path), "holds no dataset 'data'", "write the samples under that name")
    if data.ndim != 2 or data.shape[1] != n_channel:
        raise InputError(
            str(path), f"'data' is {data.shape}, campaign.toml lists {n_channel} channels",
            "give one column per [[sensor]], in that order",
        )
    for key in ("start", "sampling_rate_hz"):
        if key not in data.attrs:
            raise InputError(str(path), f"'data' has no attribute '{key}'", "write it beside the samples")
    if data.dtype.kind not in "iuf":
        raise InputError(str(path), f"'data' holds {data.dtype}, not numbers", "write float32")
    # files of other programs need not have it
    if "channels" in data.attrs:
        _refuse_renamed(path, data.attrs["channels"], tuple(s.channel for s in sensors))
    refuse_other_words(str(path), sensors, data.attrs)
    return data.attrs["start"], data.attrs["sampling_rate_hz"], int(data.shape[0])


def _refuse_renamed(path: Path, attribute: Any, channels: tuple[str, ...]) -> None:
    where = f"{path}, attribute channels"
    with parsing(where, "is not a JSON list of names", "write it as `convert` does, or leave it out"):
        own = [str(name) for name in json.loads(attribute)]
    if own == list(channels):
        return
    if len(own) != len(channels):
        raise InputError(where, f"names {len(own)} channels, campaign.toml lists {len(channels)}",
                         "correct the one that is wrong")
    k = next(k for k, name in enumerate(own) if name != channels[k])
    if sorted(own) == sorted(channels):
        raise InputError(where, f"column {k + 1} is '{own[k]}', campaign.toml has '{channels[k]}' there: the "
                         "[[sensor]] tables were put in another order",
                         f"order them {', '.join(own)}, or convert again")
    raise InputError(where, f"column {k + 1} is '{own[k]}', campaign.toml calls it '{channels[k]}': a [[sensor]] was "
                     "renamed or replaced after the files were written", f"name it '{own[k]}' again, or convert again "
                     "into a new folder")


def _check_file(
    path: Path, n_sample: int, start: object, own_rate: Any, rate_hz: float, state: tuple[int, int]
) -> RecordFile:
    try:
        own = float(own_rate)
    except (TypeError, ValueError):
        raise InputError(f"{path}, sampling_rate_hz", f"{own_rate!r} is not a number",
                         "write Hz beside the samples") from None
    if not abs(own - rate_hz) <= 1e-6 * rate_hz:
        raise InputError(str(path), f"is sampled at {own:g} Hz, campaign.toml says {rate_hz:g} Hz",
                         "correct the one that is wrong")
    begins = parse_time(_text(start), f"{path}, start")
    # whatever the format, before anything of the length that is declared is made
    if n_sample / rate_hz > LONGEST_RECORD_S:
        raise InputError(str(path), f"declares {n_sample} samples, {n_sample / rate_hz / 86400:.3g} days at "
                         f"{rate_hz:g} Hz", "the file is damaged: write it again, or remove it")
    return RecordFile(path=path, start=begins, n_sample=n_sample, size=state[0], changed_ns=state[1])


def _text(value: object) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def parse_time(text: str, where: str) -> pd.Timestamp:
    """ISO 8601 to UTC; without a zone it is UTC."""
    try:
        time = pd.Timestamp(text)
    except (ValueError, TypeError, OverflowError):
        time = pd.NaT
    if time is pd.NaT:
        raise InputError(where, f"'{text}' is not a time", "write ISO 8601, such as 2019-06-03T10:00:00Z")
    if not EARLIEST.year <= time.year < LATEST.year:
        raise InputError(where, f"'{text}' is not between {EARLIEST:%Y} and {LATEST:%Y}", "correct the time")
    return time.tz_localize("UTC") if time.tzinfo is None else time.tz_convert("UTC")
