"""Files of other programs, read in pieces: tables, arrays, universal files, and files of data loggers.

A source says first what it states of itself, then gives pieces of (times or None, data (n, n_channel)); never more than
PIECE rows are held, but for .mat v5, UFF, miniSEED and arrays that lie channel by channel, which have no other way and
are refused beyond a size. Nothing in a file is executed: no pickles, no objects.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import cast

import numpy as np
import pandas as pd

from probupdate.campaign.array_sources import read_mat, read_npy, read_npz
from probupdate.campaign.description import Description
from probupdate.campaign.logger_channels import join_on_one_clock
from probupdate.campaign.logger_files import (
    SAC_HEAD,
    mdf_channels,
    miniseed_channels,
    sac_channels,
    sac_order,
    tdms_channels,
    wav_channels,
)
from probupdate.campaign.stated import FileStatements
from probupdate.campaign.table_sources import PIECE, read_csv, read_parquet
from probupdate.errors import InputError, parsing
from probupdate.io.files import input_file

Pieces = Iterator[tuple[np.ndarray | pd.DatetimeIndex | None, np.ndarray]]
# what convert.toml calls the abscissa of a universal file
ABSCISSA = "abscissa"
TABLES = (".csv", ".txt", ".tsv", ".dat")
KINDS = {**dict.fromkeys(TABLES, "table"), ".parquet": "parquet", ".pq": "parquet", ".mat": "mat", ".npy": "npy",
         ".npz": "npz", ".uff": "uff", ".unv": "uff", ".tdms": "tdms", ".mf4": "mdf", ".mdf": "mdf",
         ".mseed": "miniseed", ".miniseed": "miniseed", ".ms": "miniseed", ".sac": "sac", ".wav": "wav"}
# of which several files, with a channel each, are read together
JOINED = ("miniseed", "sac")


def kind_of(path: Path) -> str:
    """What a file is, by its ending; miniSEED and SAC of archives, which end in a day or a channel, by their heads."""
    kind = KINDS.get(path.suffix.lower())
    if kind is None:
        with parsing(str(path), "cannot be read", "check its permissions"), path.open("rb") as file:
            head = file.read(SAC_HEAD)
        if head[:3] == b"MS\x03" or (head[:6].isdigit() and head[6:7] in b"DRQM" and head[7:8] in b" \0"):
            return "miniseed"
        if sac_order(head) is not None:
            return "sac"
        raise InputError(str(path), f"'{path.suffix}' is no known kind of file", f"use {', '.join(KINDS)}")
    return kind


def open_source(
    path: Path, description: Description, *, rate_hz: float = np.nan, joined: Sequence[Path] = ()
) -> tuple[FileStatements, Pieces]:
    """What one source says of itself, and its pieces in order; data in float64, factors not applied. rate_hz: the
    campaign's, to which channels of loggers are brought; joined: other files that are read together with the first.
    Raises InputError naming the file."""
    readers: dict[str, Callable[[Path, Description], Iterator]] = {
        "table": read_csv, "parquet": read_parquet, "mat": read_mat, "npy": read_npy, "npz": read_npz, "uff": read_uff}
    paths = [input_file(p, "leave it out of `files`") for p in (path, *joined)]
    kinds = {kind_of(p) for p in paths}
    kind = kinds.pop()
    if len(paths) > 1 and (kinds or kind not in JOINED):
        raise InputError(str(paths[0]), f"cannot be read together with {paths[1].name}",
                         f"join_pattern is of {' and '.join(JOINED)} files, of one kind at a time: correct it "
                         "or `files`")
    read = (readers[kind](paths[0], description) if kind in readers else
            _logger(kind, paths, description, rate_hz))
    # each begins with its own words
    return cast(FileStatements, next(read)), read


def _logger(kind: str, paths: Sequence[Path], d: Description, rate_hz: float) -> Iterator:
    where = str(paths[0])
    if kind in ("tdms", "mdf"):
        with (tdms_channels if kind == "tdms" else mdf_channels)(paths[0]) as (found, utc):
            yield from join_on_one_clock(found, d, rate_hz, where, utc=utc)
        return
    found = (wav_channels(paths[0]) if kind == "wav" else miniseed_channels(paths) if kind == "miniseed" else
             sac_channels(paths))
    yield from join_on_one_clock(found, d, rate_hz, where)


def read_uff(path: Path, d: Description) -> Iterator:
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
                             f"{d.column_remedy(channel)}; a record's name is its node and axis, such as '12:+x', "
                             "or its number")
        columns.append(same[0])
    left = tuple(n or p for k, (n, p) in enumerate(zip(found.names, found.places, strict=True)) if k not in columns)
    yield FileStatements(channels={c: found.stated[k] for c, k in zip(d.columns, columns, strict=True)}, unused=left)
    time = found.first_s + np.arange(len(found.data)) / found.rate_hz
    for first in range(0, len(time), PIECE):
        rows = slice(first, first + PIECE)
        yield time[rows], found.data[rows][:, columns]
