"""Records as Parquet tables: a column a channel, start and rate in the file's metadata, read by row groups."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from probupdate.campaign.stated import refuse_other_words
from probupdate.errors import InputError, parsing
from probupdate.modal.modes import Sensor

ENDING = ".parquet"
# the asked columns of one row group, as eight-byte numbers: a group is read whole
LARGEST_GROUP = 256 * 2**20
HEAD_KEYS = ("start", "sampling_rate_hz")


def parquet_head(path: Path, sensors: Sequence[Sensor]) -> tuple[str, str, int]:
    """Start and sampling rate as they are written, and the number of samples. Raises InputError where a channel, a
    number or the package pyarrow is missing."""
    with _open_file(path) as file:
        import pyarrow

        channels = [s.channel for s in sensors]
        known = {field.name: field.type for field in file.schema_arrow}
        for channel in channels:
            if channel not in known:
                raise InputError(str(path), f"has no column '{channel}'",
                                 "give one per [[sensor]], under the channel's name")
            if not (pyarrow.types.is_floating(known[channel]) or pyarrow.types.is_integer(known[channel])):
                raise InputError(f"{path}, {channel}", f"holds {known[channel]}, not numbers", "write float32")
        found = _text(file.schema_arrow.metadata)
        refuse_other_words(str(path), sensors, found)
        for sensor in sensors:
            refuse_other_words(str(path), [sensor], _text(file.schema_arrow.field(sensor.channel).metadata))
        for key in HEAD_KEYS:
            if key not in found:
                raise InputError(str(path), f"has no '{key}' in its metadata",
                                 "write it as text beside the columns, or put the file elsewhere and let `probupdate "
                                 "convert` make records of it")
        for k in range(file.metadata.num_row_groups):
            n_row = file.metadata.row_group(k).num_rows
            if 8 * n_row * len(channels) > LARGEST_GROUP:
                raise InputError(str(path),
                                 f"row group {k + 1} has {n_row} rows, {8e-6 * n_row * len(channels):.0f} MB",
                                 "write smaller groups, such as half an hour each")
        return found["start"], found["sampling_rate_hz"], int(file.metadata.num_rows)


def _text(metadata: dict | None) -> dict[str, str]:
    return {key.decode("utf-8", "replace"): value.decode("utf-8", "replace") for key, value in (metadata or {}).items()}


def parquet_rows(path: Path, channels: Sequence[str], first: int, last: int) -> tuple[str, np.ndarray]:
    """The file's start as it is written, and rows `first` to `last` (n, n_channel) of the channels, from the row groups
    that have some of them; NaN for null."""
    with _open_file(path) as file:
        start = _text(file.schema_arrow.metadata).get("start", "")
        ends = np.cumsum([file.metadata.row_group(k).num_rows for k in range(file.metadata.num_row_groups)])
        begins = ends - np.diff(ends, prepend=0)
        touched = np.flatnonzero((ends > first) & (begins < last))
        if not len(touched):
            return start, np.empty((0, len(channels)))
        table = file.read_row_groups(touched.tolist(), columns=list(channels), use_threads=False)
        part = table.slice(max(first - int(begins[touched[0]]), 0), min(last, int(ends[-1])) - first)
        return start, np.column_stack([part[c].to_numpy().astype(float) for c in channels])


@contextmanager
def _open_file(path: Path) -> Iterator[Any]:
    try:
        from pyarrow import parquet
    except ImportError:
        raise InputError(str(path), "Parquet needs the package pyarrow, which is not installed",
                         "pip install probupdate[parquet], or write the record as HDF5") from None
    with (parsing(str(path), "cannot be read as Parquet", "write it again or remove it"),
          parquet.ParquetFile(path) as file):
        yield file
