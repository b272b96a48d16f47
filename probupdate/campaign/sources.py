"""Files of other programs, read in pieces: tables, arrays, universal files, and files of data loggers.

A source says first what it states of itself, then gives pieces of (times or None, data (n, n_channel)); never more than
PIECE rows are held, but for .mat v5, UFF, miniSEED and arrays that lie channel by channel, which have no other way and
are refused beyond a size. Nothing in a file is executed: no pickles, no objects.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
import pandas as pd

from probupdate.campaign.array_sources import read_mat, read_npy, read_npz
from probupdate.campaign.description import Description
from probupdate.campaign.logger_channels import LoggerChannel, join_on_one_clock
from probupdate.campaign.logger_files import (
    SAC_HEAD,
    begins_miniseed,
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


@dataclass(frozen=True, kw_only=True)
class Reader:
    """A record format. `read` (paths, description, the campaign's rate in Hz) gives what the file says of itself
    (FileStatements), then its pieces in order. Of a logger's format `channels` (paths) opens the channels that its
    files state and whether their times are UTC; `joined`: several files, with a channel each, are read together.
    `begins`: whether a file begins as one of this format, for endings that many programs use."""

    endings: tuple[str, ...]
    read: Callable[[Sequence[Path], Description, float], Iterator]
    channels: Callable[[Sequence[Path]], AbstractContextManager[tuple[list[LoggerChannel], bool]]] | None = None
    joined: bool = False
    begins: Callable[[bytes], bool] | None = None


def kind_of(path: Path) -> str:
    """What a file is, by its ending; miniSEED and SAC of archives, which end in a day or a channel, by their heads."""
    ending = path.suffix.lower()
    kind = next((kind for kind, reader in READERS.items() if ending in reader.endings), None)
    if kind is None:
        with parsing(str(path), "cannot be read", "check its permissions"), path.open("rb") as file:
            head = file.read(SAC_HEAD)
        kind = next((kind for kind, reader in READERS.items() if reader.begins and reader.begins(head)), None)
    if kind is None:
        known = ", ".join(ending for reader in READERS.values() for ending in reader.endings)
        raise InputError(str(path), f"'{path.suffix}' is no known kind of file", f"use {known}")
    return kind


def open_source(
    path: Path, description: Description, *, rate_hz: float = np.nan, joined: Sequence[Path] = ()
) -> tuple[FileStatements, Pieces]:
    """What one source says of itself, and its pieces in order; data in float64, factors not applied. rate_hz: the
    campaign's, to which channels of loggers are brought; joined: other files that are read together with the first.
    Raises InputError naming the file."""
    paths = [input_file(p, "leave it out of `files`") for p in (path, *joined)]
    kinds = {kind_of(p) for p in paths}
    kind = kinds.pop()
    if len(paths) > 1 and (kinds or not READERS[kind].joined):
        together = " and ".join(kind for kind, reader in READERS.items() if reader.joined)
        raise InputError(str(paths[0]), f"cannot be read together with {paths[1].name}",
                         f"join_pattern is of {together} files, of one kind at a time: correct it or `files`")
    read = READERS[kind].read(paths, description, rate_hz)
    # each begins with its own words
    return cast(FileStatements, next(read)), read


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


def _one_file(endings: tuple[str, ...], read: Callable[[Path, Description], Iterator]) -> Reader:
    return Reader(endings=endings, read=lambda paths, description, rate_hz: read(paths[0], description))


def _logger(endings: tuple[str, ...], channels, **more) -> Reader:
    def read(paths, description, rate_hz):
        with channels(paths) as (found, utc):
            yield from join_on_one_clock(found, description, rate_hz, str(paths[0]), utc=utc)

    return Reader(endings=endings, read=read, channels=channels, **more)


# a format of records is a reader in a file of its own, and a line here
READERS: dict[str, Reader] = {
    "table": _one_file(TABLES, read_csv),
    "parquet": _one_file((".parquet", ".pq"), read_parquet),
    "mat": _one_file((".mat",), read_mat),
    "npy": _one_file((".npy",), read_npy),
    "npz": _one_file((".npz",), read_npz),
    "uff": _one_file((".uff", ".unv"), read_uff),
    "tdms": _logger((".tdms",), lambda paths: tdms_channels(paths[0])),
    "mdf": _logger((".mf4", ".mdf"), lambda paths: mdf_channels(paths[0])),
    "miniseed": _logger((".mseed", ".miniseed", ".ms"), lambda paths: nullcontext((miniseed_channels(paths), True)),
                        joined=True, begins=begins_miniseed),
    "sac": _logger((".sac",), lambda paths: nullcontext((sac_channels(paths), True)), joined=True,
                   begins=lambda head: sac_order(head) is not None),
    "wav": _logger((".wav",), lambda paths: nullcontext((wav_channels(paths[0]), True))),
}
