"""Files of other programs, read in pieces: CSV, Parquet, MATLAB .mat (v5 and v7.3), NumPy .npy and .npz, UFF 58.

A source gives pieces of (time column or None, data (n, n_channel)); never more than PIECE rows are held, but for .mat
v5 and UFF, which have no other way and are refused beyond a size. Nothing in a file is executed: no pickles, no
objects.
"""

from __future__ import annotations

import csv
import json
import math
import zipfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import IO

import numpy as np
import pandas as pd

from probupdate.campaign.description import Description
from probupdate.campaign.mat_v5 import refuse_damaged
from probupdate.campaign.reading import nearest
from probupdate.errors import InputError, parsing
from probupdate.io.files import input_file
from probupdate.io.hdf5_file import open_hdf5
from probupdate.io.result_table import plural

PIECE = 200_000
# all columns of one piece, as eight-byte numbers
LARGEST_PIECE = 256 * 2**20
# a v5 variable is unpacked whole; three copies of this stay below 1 GiB
LARGEST_V5 = 300 * 2**20
# kinds of v5 variables that are read
NUMBERS = ("double", "single", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64")
# of columns, where it is not the stated one
SEPARATORS = (";", "\t", "|", ",")
Pieces = Iterator[tuple[np.ndarray | None, np.ndarray]]


def pieces(path: Path, description: Description) -> Pieces:
    """The pieces of one file in order; data in float64, factors not applied. Raises InputError naming the file."""
    readers: dict[str, Callable] = {
        ".csv": _csv, ".txt": _csv, ".tsv": _csv, ".dat": _csv, ".parquet": _parquet, ".pq": _parquet, ".mat": _mat,
        ".npy": _npy, ".npz": _npz, ".uff": _uff, ".unv": _uff,
    }
    path = input_file(path, "leave it out of `files`")
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InputError(str(path), f"'{path.suffix}' is no known kind of file", f"use {', '.join(readers)}")
    yield from reader(path, description)


def _one_by_one(items: Iterable, *said: str) -> Iterator:
    """The items of a library's reader, its errors as `parsing` says them, not those of whoever takes them."""
    items = iter(items)
    while True:
        with parsing(*said):
            item = next(items, None)
        if item is None:
            return
        yield item


# Tables -------------------------------------------------------------------------------------------------------------


def _csv(path: Path, d: Description) -> Pieces:
    said = str(path), "is no table", "check separator, header and skip_rows in convert.toml, and that it is UTF-8 text"
    with parsing(*said):
        table = pd.read_csv(
            path, sep=d.separator, decimal=d.decimal, header=0 if d.header else None, skiprows=d.skip_rows,
            chunksize=PIECE, skipinitialspace=True, encoding="utf-8-sig",
        )
    whole = False
    with table:
        for frame in _one_by_one(table, *said):
            # pandas fills a short row with NaN at its end, as it reads an empty cell, which is a gap
            if not whole and len(d.separator) == 1 and frame.iloc[:, -1].isna().any():
                with parsing(*said):
                    _refuse_short_rows(path, d, frame.shape[1])
                whole = True
            yield _from_frame(path, d, frame)


def _refuse_short_rows(path: Path, d: Description, n_column: int) -> None:
    with path.open(encoding="utf-8-sig", newline="") as stream:
        for _ in range(d.skip_rows):
            stream.readline()
        rows = csv.reader(stream, delimiter=d.separator, skipinitialspace=True)
        for row in rows:
            if 0 < len(row) < n_column and any(row):
                raise InputError(f"{path}, line {rows.line_num + d.skip_rows}",
                                 f"has {plural(len(row), 'cell')} of {n_column}",
                                 "complete it with empty cells where samples were lost, or take the line out")


def _parquet(path: Path, d: Description) -> Pieces:
    try:
        from pyarrow import parquet
    except ImportError:
        raise InputError(str(path), "Parquet needs the package pyarrow, which is not installed",
                         "pip install probupdate[parquet], or save the table as CSV") from None
    said = str(path), "cannot be read as Parquet", "write it again or remove it"
    with parsing(*said):
        opened = parquet.ParquetFile(path)
    with opened as file:
        for frame in _one_by_one((batch.to_pandas() for batch in file.iter_batches(batch_size=PIECE)), *said):
            yield _from_frame(path, d, frame)


def _from_frame(path: Path, d: Description, frame: pd.DataFrame) -> tuple[np.ndarray | None, np.ndarray]:
    frame = frame.rename(columns=lambda c: c.strip() if isinstance(c, str) else c)
    names = [_column_name(path, frame.columns, d.columns[c], c) for c in d.columns]
    data = np.empty((len(frame), len(names)))
    for k, name in enumerate(names):
        column = frame[name]
        if not pd.api.types.is_numeric_dtype(column):
            number = pd.to_numeric(column, errors="coerce")
            wrong = number.isna() & column.notna()
            if wrong.any():
                at = wrong[wrong].index[0]
                raise InputError(f"{path}, column {name}, row {at + 1}", f"'{column[at]}' is no number",
                                 "give decimal, separator or skip_rows in convert.toml, or mend the cell")
            column = number
        data[:, k] = column.to_numpy(float, na_value=np.nan)
    time = None
    if d.time is not None:
        time = frame[_column_name(path, frame.columns, d.time, "time")].to_numpy()
    return time, data


def _column_name(path: Path, names, wanted: str | int, what: str):
    names = list(names)
    if isinstance(wanted, int):
        if wanted > len(names):
            raise InputError(f"{path}, {what}", f"there is no column {wanted} among {len(names)}", "count from 1")
        return names[wanted - 1]
    if wanted not in names:
        known = tuple(map(str, names[:40]))
        if len(known) == 1 and (other := next((s for s in SEPARATORS if s in known[0]), None)) is not None:
            raise InputError(f"{path}, {what}",
                             f"there is no column '{wanted}': the whole line '{known[0]}' is one column",
                             f"give its separator in convert.toml: separator = {json.dumps(other)}")
        key = "time" if what == "time" else "[columns]"
        raise InputError(f"{path}, {what}", f"there is no column '{wanted}'",
                         f"mend {key} in convert.toml; {nearest(wanted, known)}")
    return wanted


# Arrays -------------------------------------------------------------------------------------------------------------


class _Arrays:
    """Variables of one file by name, each with rows(first, last) as float64 and a length."""

    def __init__(self, path: Path, names: tuple[str, ...], rows: Callable, shape: Callable):
        self.path, self.names, self.rows, self.shape = path, names, rows, shape


def _from_arrays(arrays: _Arrays, d: Description) -> Pieces:
    """One variable with a column a channel, or a variable a channel."""
    path = arrays.path
    time = None if d.time is None else str(d.time)
    if d.data is not None or (len(arrays.names) - (time in arrays.names) == 1 and not set(d.columns.values()) & {
            *arrays.names}):
        name = d.data or next(n for n in arrays.names if n != time)
        n_row, n_column = arrays.shape(_variable(path, arrays.names, name, "data"))
        numbers = []
        for order, (channel, column) in enumerate(d.columns.items()):
            number = column if isinstance(column, int) else order + 1
            if isinstance(column, str) and column != channel:
                raise InputError(f"{path}, {channel}", f"columns of '{name}' have no names such as '{column}'",
                                 "give their numbers, from 1, in [columns]")
            numbers.append(number - 1)
        if max(numbers) >= n_column:
            raise InputError(f"{path}, {name}", f"has {n_column} columns, column {max(numbers) + 1} is wanted",
                             "give one column a channel, or their numbers in [columns]")
        take = [(name, numbers)]
    else:
        take = [(_variable(path, arrays.names, column, channel), [0]) for channel, column in d.columns.items()]
        n_row = arrays.shape(take[0][0])[0]
        for name, _ in take:
            if arrays.shape(name)[0] != n_row:
                raise InputError(f"{path}, {name}", f"has {arrays.shape(name)[0]} samples, {take[0][0]} has {n_row}",
                                 "all channels of a file need the same number")
    if time is not None and arrays.shape(_variable(path, arrays.names, time, "time"))[0] != n_row:
        raise InputError(f"{path}, {time}", f"has {arrays.shape(time)[0]} values for {n_row} samples", "give one each")
    wide = sum(arrays.shape(name)[1] for name, _ in take)
    piece = max(min(PIECE, LARGEST_PIECE // (8 * max(wide, 1))), 1)
    for first in range(0, n_row, piece):
        last = min(first + piece, n_row)
        data = np.hstack([arrays.rows(name, first, last)[:, numbers] for name, numbers in take])
        yield (None if time is None else arrays.rows(time, first, last)[:, 0]), data


def _variable(path: Path, names: tuple[str, ...], wanted: str | int, what: str) -> str:
    if str(wanted) not in names:
        raise InputError(f"{path}, {what}", f"there is no variable '{wanted}'",
                         f"name it in convert.toml; {nearest(str(wanted), names)}")
    return str(wanted)


def _columns_of(array: np.ndarray, where: str) -> np.ndarray:
    """(n_sample, n_column) of a vector or matrix; a single row is a vector lying down."""
    if array.dtype.kind not in "iuf":
        raise InputError(where, f"holds {array.dtype}, not numbers", "save numbers")
    if array.ndim == 1:
        return array[:, None]
    if array.ndim != 2:
        raise InputError(where, f"has {array.ndim} dimensions", "give samples by channels")
    return array.T if array.shape[0] == 1 else array


def _in_memory(path: Path, found: dict[str, np.ndarray]) -> _Arrays:
    # looked at as they are asked for: what else a file holds does not matter
    def table(name: str) -> np.ndarray:
        return _columns_of(found[name], f"{path}, {name}")

    return _Arrays(path, tuple(found), lambda name, a, b: np.asarray(table(name)[a:b], float),
                   lambda name: table(name).shape)


def _npy(path: Path, d: Description) -> Pieces:
    with parsing(str(path), "is no array of numbers", "save it by numpy.save, without objects"):
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    found = {name: array[name] for name in array.dtype.names} if array.dtype.names else {"data": array}
    yield from _from_arrays(_in_memory(path, found), d)


def _npz(path: Path, d: Description) -> Pieces:
    """Members are unpacked as they are read: a compressed array is walked through, not loaded."""
    said = str(path), "is no archive of arrays", "save it by numpy.savez, without objects"
    # opened here: a ZipFile leaves its file open while a member of it is not read to the end
    with path.open("rb") as raw:
        with parsing(*said):
            archive = zipfile.ZipFile(raw)
        with parsing(*said):
            heads = {n.removesuffix(".npy"): _npy_head(archive, n) for n in archive.namelist() if n.endswith(".npy")}
            for n, (size, dtype, _) in heads.items():
                held = archive.getinfo(f"{n}.npy").file_size
                if not dtype.hasobject and not 0 <= held - dtype.itemsize * math.prod(map(int, size)) < 2**17:
                    raise InputError(f"{path}, {n}", "does not hold as many numbers as its head says", "save it again")
        streams: dict[str, tuple[int, IO[bytes]]] = {}

        def shape(name: str) -> tuple[int, int]:
            size = heads[name][0]
            if len(size) == 1 or (len(size) == 2 and size[0] == 1):
                return max(size), 1
            return size[0], size[1]

        def rows(name: str, first: int, last: int) -> np.ndarray:
            dtype, n_column = heads[name][1], shape(name)[1]
            place, stream = streams.get(name, (-1, None))
            wanted = (last - first) * n_column * dtype.itemsize
            with parsing(*said):
                if stream is None or place != first:
                    stream = archive.open(f"{name}.npy")
                    _skip_head(stream)
                    _discard(stream, first * n_column * dtype.itemsize)
                content = stream.read(wanted)
            if len(content) != wanted:
                raise InputError(f"{path}, {name}", "ends before the samples that its head promises", "save it again")
            streams[name] = (last, stream)
            return np.frombuffer(content, dtype).reshape(-1, n_column).astype(float)

        for name, (size, dtype, fortran) in heads.items():
            if dtype.kind not in "iuf" or not 1 <= len(size) <= 2:
                raise InputError(f"{path}, {name}", f"holds {dtype} of shape {size}", "save vectors or samples by "
                                 "channels, of numbers")
            if fortran and len(size) == 2 and min(size) > 1:
                raise InputError(f"{path}, {name}", "lies column by column (Fortran order)",
                                 "save numpy.ascontiguousarray of it")
        yield from _from_arrays(_Arrays(path, tuple(heads), rows, shape), d)


def _npy_head(archive: zipfile.ZipFile, name: str) -> tuple[tuple[int, ...], np.dtype, bool]:
    with archive.open(name) as stream:
        shape, fortran, dtype = _skip_head(stream)
    return shape, dtype, fortran


def _skip_head(stream) -> tuple[tuple[int, ...], bool, np.dtype]:
    version = np.lib.format.read_magic(stream)
    if version == (1, 0):
        return np.lib.format.read_array_header_1_0(stream)
    return np.lib.format.read_array_header_2_0(stream)


def _discard(stream, size: int) -> None:
    while size > 0:
        size -= len(stream.read(min(size, 2**22))) or size


def _mat(path: Path, d: Description) -> Pieces:
    import h5py

    if h5py.is_hdf5(path):
        yield from _mat73(path, d)
        return
    from scipy.io import loadmat, whosmat

    refuse_damaged(path)
    said = str(path), "cannot be read as .mat", "save it again"
    with parsing(*said):
        listed = whosmat(path)
    numbers = {name: int(np.prod(shape)) for name, shape, kind in listed if kind in NUMBERS}
    size = 8 * sum(numbers.values())
    if size > LARGEST_V5:
        raise InputError(str(path), f"is a .mat v5 file, read whole, of {size / 2**20:.0f} MB",
                         "save it with -v7.3, or in parts")
    with parsing(*said):
        found = loadmat(path, variable_names=list(numbers))
        arrays = {n: found[n] for n in numbers}
    yield from _from_arrays(_in_memory(path, arrays), d)


def _mat73(path: Path, d: Description) -> Pieces:
    import h5py

    said = str(path), "cannot be read as .mat v7.3", "save it again"
    with open_hdf5(*said) as file:
        with parsing(*said):
            sizes = {n: file[n].shape for n in file if isinstance(n, str) and isinstance(file[n], h5py.Dataset)
                     and file[n].dtype.kind in "iuf" and 1 <= file[n].ndim <= 2}

        # MATLAB stores columns first: (n_channel, n_sample) on disk
        def shape(name: str) -> tuple[int, int]:
            size = sizes[name]
            if len(size) == 1 or 1 in size:
                return max(size), 1
            return size[1], size[0]

        def rows(name: str, first: int, last: int) -> np.ndarray:
            with parsing(*said):
                dataset = file[name]
                if dataset.ndim == 1:
                    return np.asarray(dataset[first:last], float)[:, None]
                if dataset.shape[1] == 1:
                    return np.asarray(dataset[first:last], float)
                return np.asarray(dataset[:, first:last], float).T

        yield from _from_arrays(_Arrays(path, tuple(sizes), rows, shape), d)


# Universal files ----------------------------------------------------------------------------------------------------

# what convert.toml calls the abscissa of a universal file
ABSCISSA = "abscissa"


def _uff(path: Path, d: Description) -> Pieces:
    """Records in time of datasets 58; a column is a channel's name (line 1), node and axis such as '12:+x', or a
    number."""
    from probupdate.campaign.uff_file import read_uff_records

    if d.time != ABSCISSA:
        raise InputError(f"{d.path}, time", "is not the abscissa, which states a universal file's rate",
                         f'write time = "{ABSCISSA}", time_unit = "s" and start or start_pattern')
    found = read_uff_records(path)
    columns = []
    for channel, column in d.columns.items():
        same = [k for k in range(len(found.names)) if column in (found.names[k], found.places[k], k + 1)]
        if len(same) != 1:
            here = ", ".join(dict.fromkeys(n or p for n, p in zip(found.names[:12], found.places[:12], strict=True)))
            raise InputError(f"{path}, {channel}",
                             f"{len(same) or 'no'} records are called '{column}'; there are {here}",
                             "name each channel's in [columns], as node and axis such as '12:+x', or by number")
        columns.append(same[0])
    time = found.first_s + np.arange(len(found.data)) / found.rate_hz
    for first in range(0, len(time), PIECE):
        rows = slice(first, first + PIECE)
        yield time[rows], found.data[rows][:, columns]
