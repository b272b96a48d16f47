"""Records as Zarr arrays: start and rate among the array's attributes, read by the chunks that a block touches."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from probupdate.campaign.stated import refuse_other_words
from probupdate.errors import InputError, parsing
from probupdate.io.files import read_json_table
from probupdate.modal.modes import Sensor

ENDING, HEAD = ".zarr", "zarr.json"
# a chunk as eight-byte numbers: it is read whole
LARGEST_CHUNK = 256 * 2**20
# ten years at 100 kHz
MOST_SAMPLES = 2**45
HEAD_KEYS = ("start", "sampling_rate_hz")
# what turns chunks into numbers; others are the file's own choice of code to run
CODECS = frozenset({"bytes", "transpose", "blosc", "gzip", "zstd", "crc32c", "sharding_indexed"})
AGAIN = "write it again as zarr.create_array does, or remove it"


def zarr_head(path: Path, sensors: Sequence[Sensor]) -> tuple[Any, Any, Any, int, tuple[tuple[int, int], ...]]:
    """Start, sampling rate and names of the channels (None where they are not said) as they are written, the number of
    samples, and the rows (first, end) of which chunks are there. Raises InputError where a number or the package zarr
    is missing."""
    files, n_channel = set(zarr_files(path)), len(sensors)
    if HEAD not in files:
        raise InputError(str(path), "holds no zarr.json", "write a Zarr array of format 3")
    head = read_json_table(path / HEAD, AGAIN, nan=True)
    attributes = _checked_attributes(path, head)
    shape = head.get("shape")
    if not isinstance(shape, list) or len(shape) != 2 or not all(
            type(n) is int and 0 <= n <= MOST_SAMPLES for n in shape):
        raise InputError(f"{path}, zarr.json", f"its shape is {shape!r:.60}", "write samples by channels")
    array = _open_array(path)
    if array.ndim != 2 or array.shape[1] != n_channel:
        raise InputError(str(path), f"is {array.shape}, campaign.toml lists {n_channel} channels",
                         "give one column per [[sensor]], in that order")
    if array.dtype.kind not in "iuf":
        raise InputError(str(path), f"holds {array.dtype}, not numbers", "write float32")
    if 8 * math.prod(array.chunks) > LARGEST_CHUNK:
        raise InputError(str(path), f"has chunks {array.chunks}, {8e-6 * math.prod(array.chunks):.0f} MB",
                         "write smaller chunks, such as half an hour each")
    for key in HEAD_KEYS:
        if key not in attributes:
            raise InputError(str(path), f"has no '{key}' among its attributes", "write it beside the samples")
    if not np.isnan(array.fill_value) and array.nchunks_initialized < array.nchunks:
        raise InputError(str(path), f"{array.nchunks - array.nchunks_initialized} of {array.nchunks} chunks are not "
                         f"there and would be read as {array.fill_value:g}",
                         "write them, or give the array the fill_value NaN")
    refuse_other_words(str(path), sensors, attributes)
    names = attributes.get("channels")
    return (attributes["start"], attributes["sampling_rate_hz"],
            json.dumps(names) if isinstance(names, list) else names, int(array.shape[0]),
            _stored_spans(path, files, array))


def _stored_spans(path: Path, files: Iterable[str], array: Any) -> tuple[tuple[int, int], ...]:
    """Rows (first, end) of chunks beside one another that are there, by the first number of a chunk's name."""
    size, n_row = (array.shards or array.chunks)[0], int(array.shape[0])
    there = np.unique([int(place.group()) for name in files if (place := re.search(r"\d+", name))]).astype(int)
    there = there[there * size < n_row]
    if n_row and not len(there):
        raise InputError(str(path), f"none of its {array.nchunks} chunks is there", "copy them too, or remove it")
    parts = np.split(there, np.flatnonzero(np.diff(there) > 1) + 1)
    return tuple((int(p[0]) * size, min(int(p[-1] + 1) * size, n_row)) for p in parts if len(p))


def zarr_rows(path: Path, first: int, last: int) -> tuple[Any, np.ndarray]:
    """The array's start as it is written, and its rows `first` to `last` (n, n_channel), from the chunks that have some
    of them."""
    with parsing(str(path), f"samples {first} to {last} cannot be read",
                 "the array is damaged: copy it again, or remove it"), np.errstate(invalid="ignore"):
        array = _open_array(path)
        return array.attrs["start"], np.asarray(array[first:last], float)


def last_change(path: Path, first: int = 0, last: int | None = None) -> int:
    """When any of an array's files and folders, or of those that hold rows `first` to `last`, was last changed in any
    way (ns): chunks take the place of others of their size and time in a sync."""
    if last is None:
        parts = [path / name for name in zarr_files(path)]
    else:
        array = _open_array(path)
        rows, columns = (array.shards or array.chunks)
        parts = [path / HEAD, *(path / array.metadata.encode_chunk_key((i, j))
                                for i in range(first // rows, -(-min(last, array.shape[0]) // rows))
                                for j in range(-(-array.shape[1] // columns)))]
    # a chunk that has gone has changed its folder
    touched = {*(p for p in parts if p.exists()), *(p.parent for p in parts if p.parent != path and p.parent.exists())}
    return max((t for p in touched for t in (p.stat().st_mtime_ns, p.stat().st_ctime_ns)), default=0)


def zarr_files(path: Path) -> list[str]:
    """Names of an array's files below its folder, sorted. Raises InputError where one is not a file, or a link."""
    return sorted(_paths_below(path, ""))


def _paths_below(path: Path, ahead: str) -> Iterator[str]:
    try:
        with os.scandir(path) as entries:
            for entry in entries:
                if entry.is_dir(follow_symlinks=False):
                    yield from _paths_below(path / entry.name, f"{ahead}{entry.name}/")
                elif entry.is_file(follow_symlinks=False):
                    yield ahead + entry.name
                else:
                    raise InputError(str(path / entry.name), "is not a file of an array, but a link or a device",
                                     "copy the file there")
    except OSError as error:
        raise InputError(str(path), f"cannot be read ({error.strerror})", AGAIN) from None


def _checked_attributes(path: Path, head: dict[str, Any]) -> dict[str, Any]:
    """The attributes of an array whose head asks for nothing but arrays and the usual codecs."""
    if head.get("zarr_format") != 3 or head.get("node_type") != "array":
        raise InputError(str(path), "is not a Zarr array of format 3", AGAIN)
    unknown = sorted(_codecs(head.get("codecs")) - CODECS)
    if unknown or head.get("storage_transformers"):
        raise InputError(str(path), f"is stored by {', '.join(unknown) or 'a storage transformer'}",
                         f"use {', '.join(sorted(CODECS))}")
    attributes = head.get("attributes", {})
    if not isinstance(attributes, dict):
        raise InputError(str(path), "its attributes are no table", AGAIN)
    return attributes


def _codecs(content: Any) -> set[str]:
    """Names of all codecs, those inside of shards too."""
    if isinstance(content, list):
        return set().union(*(_codecs(part) for part in content))
    if not isinstance(content, dict):
        return {str(content)}
    own = content.get("configuration")
    inside = (_codecs(own[key]) for key in ("codecs", "index_codecs") if isinstance(own, dict) and key in own)
    return {str(content.get("name"))}.union(*inside)


def _open_array(path: Path) -> Any:
    try:
        import zarr
    except ImportError:
        raise InputError(str(path), "Zarr needs the package zarr, which is not installed",
                         "pip install probupdate[zarr], or write the record as HDF5") from None
    with parsing(str(path), "cannot be read as Zarr", AGAIN):
        return zarr.open_array(path, mode="r")
