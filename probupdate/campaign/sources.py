"""Files of other programs, read in pieces: CSV, Parquet, MATLAB .mat (v5 and v7.3), NumPy .npy and .npz, UFF 58.

A source says first what it states of itself, then gives pieces of (time column or None, data (n, n_channel)); never
more than PIECE rows are held, but for .mat v5, UFF and arrays that lie channel by channel, which have no other way and
are refused beyond a size. Nothing in a file is executed: no pickles, no objects.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import cast

import numpy as np

from probupdate.campaign.array_sources import read_mat, read_npy, read_npz
from probupdate.campaign.description import Description
from probupdate.campaign.stated import OwnWords
from probupdate.campaign.table_sources import PIECE, read_csv, read_parquet
from probupdate.errors import InputError
from probupdate.io.files import input_file

Pieces = Iterator[tuple[np.ndarray | None, np.ndarray]]
# what convert.toml calls the abscissa of a universal file
ABSCISSA = "abscissa"


def opened(path: Path, description: Description) -> tuple[OwnWords, Pieces]:
    """What one file says of itself, and its pieces in order; data in float64, factors not applied. Raises InputError
    naming the file."""
    readers: dict[str, Callable[[Path, Description], Iterator]] = {
        ".csv": read_csv, ".txt": read_csv, ".tsv": read_csv, ".dat": read_csv, ".parquet": read_parquet,
        ".pq": read_parquet, ".mat": read_mat, ".npy": read_npy, ".npz": read_npz, ".uff": read_uff, ".unv": read_uff,
    }
    path = input_file(path, "leave it out of `files`")
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InputError(str(path), f"'{path.suffix}' is no known kind of file", f"use {', '.join(readers)}")
    read = reader(path, description)
    # each begins with its own words
    return cast(OwnWords, next(read)), read


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
                             "name each channel's in [columns], as node and axis such as '12:+x', or by number")
        columns.append(same[0])
    yield OwnWords(channels={c: found.stated[k] for c, k in zip(d.columns, columns, strict=True)})
    time = found.first_s + np.arange(len(found.data)) / found.rate_hz
    for first in range(0, len(time), PIECE):
        rows = slice(first, first + PIECE)
        yield time[rows], found.data[rows][:, columns]
