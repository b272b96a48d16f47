"""Records as arrays of other programs: NumPy .npy and .npz, MATLAB .mat (v5 and v7.3), fields of its structures too."""

from __future__ import annotations

import math
import re
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np

from probupdate.campaign.description import Description
from probupdate.campaign.mat_v5 import refuse_damaged
from probupdate.campaign.reading import suggest
from probupdate.campaign.stated import UNIT_KEYS, ChannelStatement, FileStatements, keyed_rate, texts_of, unit_in
from probupdate.campaign.table_sources import COLUMNS, FEWEST, PIECE, ROWS
from probupdate.errors import InputError, parsing
from probupdate.io.hdf5_file import open_hdf5

# all columns of one piece, as eight-byte numbers
LARGEST_PIECE = 256 * 2**20
# what is unpacked whole; three copies of this stay below 1 GiB
LARGEST_WHOLE = 300 * 2**20
# kinds of v5 variables that are read: numbers, words on them, and structures of both
NUMBERS = ("double", "single", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64")
WORDS, STRUCTURES = ("char", "cell"), ("struct",)
# fields of structures that are looked at, and how deep
MOST_FIELDS, DEEPEST = 10_000, 8


@dataclass(frozen=True, eq=False, kw_only=True)
class Arrays:
    """Arrays of one file by name: shape(name) and rows(name, first, last), samples by channels as `orientation` has it.
    texts: words that the file keeps beside them; unread: names with their kinds."""

    path: Path
    names: tuple[str, ...]
    shape: Callable[[str], tuple[int, int]]
    rows: Callable[[str, int, int], np.ndarray]
    texts: Mapping[str, Sequence[str]] = field(default_factory=dict)
    unread: tuple[str, ...] = ()


def _from_arrays(arrays: Arrays, d: Description) -> Iterator:
    """One variable with a column a channel, or a variable a channel."""
    path = arrays.path
    time = None if d.time is None else str(d.time)
    if not arrays.names:
        raise InputError(str(path), "holds no array of numbers" + (
            f"; it holds {', '.join(arrays.unread[:12])}" if arrays.unread else ""),
            "save the samples as a numeric matrix, or in fields of a structure")
    single = [n for n in arrays.names if arrays.shape(n) == (1, 1)]
    many = [n for n in arrays.names if n not in single and n != time]
    if d.data is not None or (len(many) == 1 and not set(d.columns.values()) & {*arrays.names}):
        take, n_row = _table_parts(arrays, d, d.data or many[0])
    else:
        take = [(_variable(arrays, d, column, channel), [0]) for channel, column in d.columns.items()]
        n_row = arrays.shape(take[0][0])[0]
        for name, _ in take:
            if arrays.shape(name)[0] != n_row:
                raise InputError(f"{path}, {name}", f"has {arrays.shape(name)[0]} samples, {take[0][0]} has {n_row}",
                                 "all channels of a file need the same number")
    if time is not None and arrays.shape(_variable(arrays, d, time, "time"))[0] != n_row:
        raise InputError(f"{path}, {time}", f"has {arrays.shape(time)[0]} values for {n_row} samples", "give one each")
    yield _file_statements(arrays, d, take, {n: float(arrays.rows(n, 0, 1)[0, 0]) for n in single})
    wide = sum(arrays.shape(name)[1] for name, _ in take)
    piece = max(min(PIECE, LARGEST_PIECE // (8 * max(wide, 1))), 1)
    for first in range(0, n_row, piece):
        last = min(first + piece, n_row)
        data = np.hstack([arrays.rows(name, first, last)[:, numbers] for name, numbers in take])
        yield (None if time is None else arrays.rows(time, first, last)[:, 0]), data


def _table_parts(arrays: Arrays, d: Description, wanted: str) -> tuple[list[tuple[str, list[int]]], int]:
    name = _variable(arrays, d, wanted, "data")
    where = f"{arrays.path}, {name}"
    n_row, n_column = arrays.shape(name)
    if n_column > n_row and (d.orientation is None or n_row < FEWEST):
        rows, columns = (n_column, n_row) if d.orientation == ROWS else (n_row, n_column)
        remedy = (f'if a row is a channel, write orientation = "{ROWS}" in convert.toml, else "{COLUMNS}"'
                  if d.orientation is None else "correct orientation in convert.toml")
        raise InputError(where, f"has {rows} rows and {columns} columns, which are {n_row} samples of {n_column} "
                         f"channels{' as stated' if d.orientation else ''}", remedy)
    numbers = []
    for order, (channel, column) in enumerate(d.columns.items()):
        if isinstance(column, str) and column != channel:
            raise InputError(f"{arrays.path}, {channel}", f"columns of '{name}' have no names such as '{column}'",
                             "give their numbers, from 1, in [columns]")
        numbers.append(column - 1 if isinstance(column, int) else order)
    if max(numbers) >= n_column:
        raise InputError(where, f"has {n_column} channels, number {max(numbers) + 1} is wanted",
                         "give one column a channel, or their numbers in [columns]")
    return [(name, numbers)], n_row


def _file_statements(arrays: Arrays, d: Description, take, single: Mapping[str, float]) -> FileStatements:
    """A rate among the single numbers; units from a text (or one a column) of that name, or in a variable's name."""
    stated = {name[: -len(last)]: list(t) for name, t in arrays.texts.items()
              if (last := re.split(r"[./]", name)[-1]).lower() in UNIT_KEYS}
    found = {}
    for k, channel in enumerate(d.columns):
        name, numbers = take[0] if len(take) == 1 else take[k]
        number = numbers[k] if len(take) == 1 else k
        # of several structures each states its own
        own = max((place for place in stated if name.startswith(place)), key=len, default=None)
        units = stated[own] if own is not None else next(iter(stated.values()), []) if len(stated) == 1 else []
        text = units[0] if len(units) == 1 else units[number] if number < len(units) else unit_in(name)
        found[channel] = ChannelStatement(unit=text or None)
    taken = {(name, k) for name, numbers in take for k in numbers}
    left = [(n, k) for n in arrays.names if n not in single and n != str(d.time) for k in range(arrays.shape(n)[1])
            if (n, k) not in taken]
    unused = tuple(n if arrays.shape(n)[1] == 1 else f"{n} {k + 1}" for n, k in left)
    return FileStatements(channels=found, rate_hz=keyed_rate(single), unused=unused)


def _variable(arrays: Arrays, d: Description, wanted: str | int, what: str) -> str:
    if str(wanted) not in arrays.names:
        unread = next((u for u in arrays.unread if u.split(" ")[0] == str(wanted)), None)
        raise InputError(f"{arrays.path}, {what}",
                         f"there is no variable '{wanted}'" if unread is None else f"{unread} is not read",
                         f"{d.column_remedy(what)}; {suggest(str(wanted), arrays.names[:40])}")
    return str(wanted)


def _sample_and_channel_count(size: Sequence[int], turned: bool) -> tuple[int, int]:
    """(n_sample, n_channel) of an array of one or two dimensions; a single row is a vector lying down."""
    if len(size) < 2 or 1 in size:
        return math.prod(size), 1
    return (size[1], size[0]) if turned else (size[0], size[1])


def _describe_arrays(path: Path, d: Description, found: Mapping[str, np.ndarray], texts: Mapping | None = None,
               unread: Sequence[str] = ()) -> Arrays:
    arrays = {n: a for n, a in found.items() if a.dtype.kind in "iuf" and a.ndim <= 2}
    turned = d.orientation == ROWS

    def table(name: str) -> np.ndarray:
        """(n_sample, n_channel) of a vector or matrix."""
        array = arrays[name]
        if array.ndim < 2 or 1 in array.shape:
            return array.reshape(-1, 1)
        return array.T if turned else array

    others = [f"{n} ({a.dtype} of shape {a.shape})" for n, a in found.items() if n not in arrays]
    return Arrays(path=path, names=tuple(arrays), shape=lambda name: table(name).shape, texts=texts or {},
                  rows=lambda name, a, b: np.asarray(table(name)[a:b], float), unread=(*others, *unread))


# NumPy --------------------------------------------------------------------------------------------------------------


def read_npy(path: Path, d: Description) -> Iterator:
    with parsing(str(path), "is not an array of numbers", "save it by numpy.save, without objects"):
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    found = {name: array[name] for name in array.dtype.names} if array.dtype.names else {"data": array}
    yield from _from_arrays(_describe_arrays(path, d, found), d)


def read_npz(path: Path, d: Description) -> Iterator:
    """Members are unpacked as they are read: a compressed array is walked through; one that lies channel by channel is
    loaded."""
    said = str(path), "is not an archive of arrays", "save it by numpy.savez, without objects"
    # opened here: a ZipFile leaves its file open while a member of it is not read to the end
    with path.open("rb") as raw:
        with parsing(*said):
            archive = zipfile.ZipFile(raw)
            members = _Members(path, archive, d.orientation == ROWS, said)
        texts = {}
        with parsing(*said):
            for name, (size, dtype, _) in members.words.items():
                if dtype.kind == "U" and math.prod(size) * dtype.itemsize < 2**16:
                    with archive.open(f"{name}.npy") as stream:
                        texts[name] = texts_of(np.lib.format.read_array(stream, allow_pickle=False))
        unread = tuple(f"{n} ({dtype} of shape {size})" for n, (size, dtype, _) in members.words.items())
        yield from _from_arrays(Arrays(path=path, names=tuple(members.heads), shape=members.shape, rows=members.rows,
                                       texts=texts, unread=unread), d)


class _Members:
    """Arrays of an .npz file: heads of those of numbers, words: of others (size, kind, Fortran order)."""

    def __init__(self, path: Path, archive: zipfile.ZipFile, turned: bool, said: Sequence[str]):
        self.path, self.archive, self.turned, self.said = path, archive, turned, said
        self.streams: dict[str, tuple[int, IO[bytes]]] = {}
        self.loaded: dict[str, np.ndarray] = {}
        self.heads: dict[str, tuple[tuple[int, ...], np.dtype, bool]] = {}
        self.words: dict[str, tuple[tuple[int, ...], np.dtype, bool]] = {}
        for member in archive.namelist():
            if not member.endswith(".npy"):
                continue
            name = member.removesuffix(".npy")
            with archive.open(member) as stream:
                size, fortran, dtype = _skip_head(stream)
            held = archive.getinfo(member).file_size
            if not dtype.hasobject and not 0 <= held - dtype.itemsize * math.prod(map(int, size)) < 2**17:
                raise InputError(f"{path}, {name}", "holds another number of values than its header states",
                                 "save it again")
            of_numbers = dtype.kind in "iuf" and len(size) <= 2
            (self.heads if of_numbers else self.words)[name] = size, dtype, fortran

    def shape(self, name: str) -> tuple[int, int]:
        return _sample_and_channel_count(self.heads[name][0], self.turned)

    def rows(self, name: str, first: int, last: int) -> np.ndarray:
        size, dtype, fortran = self.heads[name]
        if len(size) == 2 and 1 not in size and fortran != self.turned:
            return np.asarray(self._whole(name)[first:last], float)
        n_column = self.shape(name)[1]
        place, stream = self.streams.get(name, (-1, None))
        wanted = (last - first) * n_column * dtype.itemsize
        with parsing(*self.said):
            if stream is None or place != first:
                stream = self.archive.open(f"{name}.npy")
                _skip_head(stream)
                _discard(stream, first * n_column * dtype.itemsize)
            content = stream.read(wanted)
        if len(content) != wanted:
            raise InputError(f"{self.path}, {name}", "is truncated: its header states more samples", "save it again")
        self.streams[name] = (last, stream)
        return np.frombuffer(content, dtype).reshape(-1, n_column).astype(float)

    def _whole(self, name: str) -> np.ndarray:
        """One that lies channel by channel."""
        if name not in self.loaded:
            size, dtype, _ = self.heads[name]
            if math.prod(size) * dtype.itemsize > LARGEST_WHOLE:
                raise InputError(f"{self.path}, {name}", "is stored channel by channel and too large to read at once "
                                 f"({LARGEST_WHOLE // 2**20} MB)", "save it in row order with numpy.ascontiguousarray")
            with parsing(*self.said), self.archive.open(f"{name}.npy") as stream:
                array = np.lib.format.read_array(stream, allow_pickle=False)
            self.loaded = {name: array.T if self.turned else array}
        return self.loaded[name]


def _skip_head(stream) -> tuple[tuple[int, ...], bool, np.dtype]:
    version = np.lib.format.read_magic(stream)
    if version == (1, 0):
        return np.lib.format.read_array_header_1_0(stream)
    return np.lib.format.read_array_header_2_0(stream)


def _discard(stream, size: int) -> None:
    while size > 0:
        size -= len(stream.read(min(size, 2**22))) or size


# MATLAB -------------------------------------------------------------------------------------------------------------


def read_mat(path: Path, d: Description) -> Iterator:
    import h5py

    if h5py.is_hdf5(path):
        yield from _mat73(path, d)
        return
    from scipy.io import loadmat, whosmat

    size = refuse_damaged(path)
    said = str(path), "cannot be read as .mat", "save it again"
    with parsing(*said):
        listed = whosmat(path)
    size = max(size, 8 * sum(math.prod(map(int, shape)) for _, shape, kind in listed if kind in NUMBERS))
    if size > LARGEST_WHOLE:
        raise InputError(str(path), f"is a .mat v5 file, read whole, of {size / 2**20:.0f} MB",
                         "save it with -v7.3, or in parts")
    wanted = [name for name, _, kind in listed if kind in (*NUMBERS, *WORDS, *STRUCTURES)]
    arrays: dict[str, np.ndarray] = {}
    texts: dict[str, list[str]] = {}
    unread = [f"{name} ({kind})" for name, _, kind in listed if name not in wanted]
    with parsing(*said):
        found = loadmat(path, variable_names=wanted)
        for name in wanted:
            _collect_values(name, found[name], arrays, texts, unread)
    yield from _from_arrays(_describe_arrays(path, d, arrays, texts, unread), d)


def _collect_values(name: str, value: Any, arrays: dict, texts: dict, unread: list, depth: int = 0) -> None:
    """Numbers and texts of a variable, those in fields of structures under such names as 's.acc' or 's(2).acc'."""
    plain = type(value) is np.ndarray
    if plain and value.dtype.names and depth < DEEPEST:
        for k, one in enumerate(value.flat, 1):
            for key in value.dtype.names:
                if len(arrays) + len(texts) + len(unread) > MOST_FIELDS:
                    return
                number = f"({k})" if value.size > 1 else ""
                _collect_values(f"{name}{number}.{key}", one[key], arrays, texts, unread, depth + 1)
    elif plain and value.dtype.kind in "iuf":
        arrays[name] = value
    elif plain and value.dtype.kind == "U":
        texts[name] = texts_of(value)
    elif plain and value.dtype == object and all(
            type(v) is np.ndarray and v.dtype.kind == "U" and v.size == 1 for v in value.flat):
        texts[name] = [str(v.flat[0]).strip() for v in value.flat]
    else:
        unread.append(f"{name} (of another kind)")


def _mat73(path: Path, d: Description) -> Iterator:
    import h5py

    said = str(path), "cannot be read as .mat v7.3", "save it again"
    with open_hdf5(*said) as file:
        sizes, texts, unread = {}, {}, []

        def look(place: str, item: Any) -> None:
            if not isinstance(item, h5py.Dataset) or place.startswith("#"):
                return
            name, kind = place.replace("/", "."), item.attrs.get("MATLAB_class", b"")
            if kind == b"char" and item.size < 1000:
                texts[name] = ["".join(map(chr, np.ravel(item[()]))).strip()]
            elif kind != b"char" and item.dtype.kind in "iuf" and 1 <= item.ndim <= 2:
                sizes[name] = item.shape
            else:
                unread.append(f"{name} ({kind.decode('utf-8', 'replace') or item.dtype})")

        with parsing(*said):
            file.visititems(look)
        turned = d.orientation == ROWS

        def rows(name: str, first: int, last: int) -> np.ndarray:
            with parsing(*said):
                dataset = file[name.replace(".", "/")]
                if dataset.ndim == 1 or 1 in dataset.shape:
                    long = dataset[first:last] if dataset.ndim == 1 or dataset.shape[1] == 1 else dataset[:, first:last]
                    return np.asarray(long, float).reshape(-1, 1)
                # MATLAB stores columns first: (n_column, n_row) on disk
                return np.asarray(dataset[first:last] if turned else dataset[:, first:last].T, float)

        yield from _from_arrays(Arrays(path=path, names=tuple(sizes), rows=rows, texts=texts, unread=tuple(unread),
                                       shape=lambda name: _sample_and_channel_count(sizes[name], not turned)), d)
