"""Blocks of a campaign: chunks of its recordings, one in memory at a time, with what is missing in them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from probupdate.campaign import gaps, parquet_records, zarr_records
from probupdate.campaign.parquet_records import parquet_rows
from probupdate.campaign.reading import Campaign, RecordFile, refuse_absurd
from probupdate.campaign.zarr_records import zarr_rows
from probupdate.errors import parsing
from probupdate.io.hdf5_file import refuse_outside
from probupdate.io.result_table import plural
from probupdate.runtime.arrays import frozen_array

# files that part by less are one recording, and a recording may lack as much of a block at its ends
LONGEST_BREAK_S = 1.0
BREAK_NS = round(1e9 * LONGEST_BREAK_S)
# share of a block in which a channel was measured, below which the block is not used
LEAST_MEASURED = 0.2
# why a block at the start or the end of a recording cannot be used
PART = "part of a recording"
# samples beyond it, in SI units, count as lost
COUNTED_AS_LOST = "counted as lost"
LARGEST_SI = 1e9
# of two files with samples of the same time
OVERLAP = "files overlap: the one that starts first, or of one start the first by its name, is used"
CONTRADICTION = f"{OVERLAP}, and the other says something else there: which is right?"
# room for unpacked chunks while one block is read: one of 18 channels over an hour at 25 Hz is 6.5 MB
CHUNK_CACHE_BYTES = 32 * 2**20


@dataclass(frozen=True, eq=False, kw_only=True)
class Block:
    """data (n_sample, n_channel) in SI units, NaN for every sample that was not measured: nothing is drawn over gaps.

    missing (n_channel,) share of samples lost; impossible (n_channel,) number of those that were there but beyond
    LARGEST_SI, or a number that stands for lost ones: marker (n_channel,), NaN where there is none; repeated, filled
    (n_channel,) share of samples that only repeat the one before, or lie on a straight line drawn over a gap (`gaps`),
    lost too; spikes (n_channel,) number of samples lost as they stand alone; excluded: why the block cannot be used,
    empty where it can; notes: what was done to it.
    """

    start: pd.Timestamp
    minutes: float
    sampling_rate_hz: float
    data: np.ndarray
    missing: np.ndarray
    impossible: np.ndarray
    repeated: np.ndarray
    filled: np.ndarray
    marker: np.ndarray | None = None
    spikes: np.ndarray | int = 0
    excluded: str = ""
    notes: tuple[str, ...] = ()

    @property
    def measured(self) -> np.ndarray:
        """(n_channel,) share of samples that were measured."""
        return 1 - self.missing - self.repeated - self.filled

    @property
    def id(self) -> str:
        return block_id(self.start, self.minutes)


def block_id(start: pd.Timestamp, minutes: float = 1.0) -> str:
    """Start to the minute, or to the second where blocks do not start on minutes: 2019-06-03T10:00Z; to its last digit
    where several begin in a second."""
    if minutes < 1 / 60:
        return start.strftime("%Y-%m-%dT%H:%M:%S.%f").rstrip("0") + "Z"
    return start.strftime("%Y-%m-%dT%H:%MZ" if start.second == 0 else "%Y-%m-%dT%H:%M:%SZ")


@dataclass(frozen=True, kw_only=True)
class Recording:
    """Files that follow each other without a gap of more than a second, from the first sample to the end of the
    last one."""

    files: tuple[RecordFile, ...]
    start: pd.Timestamp
    end: pd.Timestamp


def recordings(campaign: Campaign) -> list[Recording]:
    """The campaign's recordings in order."""
    step = pd.Timedelta(seconds=1 / campaign.sampling_rate_hz)
    found: list[tuple[list[RecordFile], pd.Timestamp]] = []
    for file in campaign.files:
        end = file.start + file.n_sample * step
        if found and file.start <= found[-1][1] + pd.Timedelta(seconds=LONGEST_BREAK_S):
            files, reached = found[-1]
            files.append(file)
            found[-1] = files, max(reached, end)
        else:
            found.append(([file], end))
    return [Recording(files=tuple(files), start=files[0].start, end=end) for files, end in found]


def block_files(campaign: Campaign, minutes: float | None = None) -> dict[pd.Timestamp, tuple[RecordFile, ...]]:
    """Start of each block that at least one file touches, and the files with samples in it, in the order of their
    starts. Blocks are counted from midnight 1970 UTC (the clock's half hours, which SCADA's rows keep), but from a
    recording's own start where the clock would cost half of the blocks that it holds or more: one that is as long as a
    block is one. One pass over the files, however many there are."""
    length = _length(campaign, minutes)
    step = pd.Timedelta(seconds=1 / campaign.sampling_rate_hz)
    touching: dict[int, list[RecordFile]] = {}
    for recording in recordings(campaign):
        origin = _origin(recording, length.value)
        spans, found = [], set()
        for file, (row, end) in ((f, span) for f in recording.files for span in f.spans or ((0, f.n_sample),)):
            first, last = file.start + row * step, file.start + max(end - 1, 0) * step
            # samples are placed to the nearest: a file that starts a hair before a block belongs to that block alone,
            # and the last sample may belong to the block that begins just after it
            first_block = (first.value + step.value // 2 - origin) // length.value
            found.update(range(first_block, max((last.value - origin) // length.value, first_block) + 1))
            spans.append((file, first_block, (last.value + step.value // 2 - origin) // length.value))
        for k in sorted(found):
            touching.setdefault(origin + k * length.value, [])
        for file, first_block, last_block in spans:
            for k in range(first_block, last_block + 1):
                if k in found and file not in touching[origin + k * length.value][-1:]:
                    touching[origin + k * length.value].append(file)
    return {pd.Timestamp(start, tz="UTC"): tuple(touching[start]) for start in sorted(touching)}


def count_held_blocks(recording: Recording, length: int) -> int:
    """Blocks of `length` ns from its start on, the last of which may lack a second."""
    return (recording.end.value - recording.start.value + BREAK_NS) // length


def _origin(recording: Recording, length: int) -> int:
    """From where blocks of this length are counted, in ns of the clock: 0, or the recording's start."""
    start, end, held = recording.start.value, recording.end.value, count_held_blocks(recording, length)
    on_clock = max((end + BREAK_NS) // length + (BREAK_NS - start) // length, 0)
    return start if held and 2 * on_clock <= held else 0


def block_starts(campaign: Campaign) -> list[pd.Timestamp]:
    """Starts of the blocks that at least one file touches."""
    return list(block_files(campaign))


def blocks(campaign: Campaign, minutes: float | None = None) -> Iterator[Block]:
    """Every block in order, read as it is asked for. Where files overlap, the one that starts first holds,
    and what it lost is taken from the other."""
    for start, files in block_files(campaign, minutes).items():
        yield read_block(campaign, start, files, minutes)


def read_block(
    campaign: Campaign, start: pd.Timestamp, files: tuple[RecordFile, ...], minutes: float | None = None
) -> Block:
    """One block, from the files that `block_files` names for its start."""
    length = _length(campaign, minutes)
    pieces, read = [], []
    n = round(length.total_seconds() * campaign.sampling_rate_hz)
    for file in files:
        first, source = _row_offsets(file, start, campaign.sampling_rate_hz)
        read.append((file, source, source + n - first))
        file.refuse_changed(*read[-1][1:])
        begins, rows = _stored_rows(campaign, *read[-1])
        file.refuse_other(begins)
        pieces.append((first, rows))
    for file, source, end in read:
        # once more: it may have been replaced while it was read
        file.refuse_changed(source, end)
    return _assemble(campaign, start, length, pieces)


def _stored_rows(campaign: Campaign, file: RecordFile, first: int, last: int) -> tuple[Any, np.ndarray]:
    """The start as the file states it, and rows `first` to `last` of the campaign's channels."""
    import h5py

    if file.path.suffix == parquet_records.ENDING:
        return parquet_rows(file.path, campaign.channels, first, last)
    if file.path.suffix == zarr_records.ENDING:
        begins, rows = zarr_rows(file.path, first, last)
    else:
        with (parsing(str(file.path), "cannot be read", "the file was cut or damaged: copy it again, or remove it"),
              h5py.File(file.path, "r", rdcc_nbytes=CHUNK_CACHE_BYTES) as opened):
            begins, rows = opened["data"].attrs["start"], _rows(opened, file.path, first, last)
    return begins, rows[:, campaign.columns] if campaign.left_out else rows


def _rows(opened, path: Path, first: int, last: int) -> np.ndarray:
    """Rows as they lie on disk; a file whose samples cannot be unpacked is named."""
    with parsing(str(path), f"samples {first} to {last} cannot be read",
                 "the file is damaged: copy it again, or remove it"):
        refuse_outside(str(path), opened["data"], "copy the numbers into the file")
        # bit patterns of damaged files are numbers that signal when they are converted; they count as lost below
        with np.errstate(invalid="ignore"):
            return opened["data"][first:last].astype(float)


def _length(campaign: Campaign, minutes: float | None) -> pd.Timedelta:
    minutes = campaign.block_minutes if minutes is None else minutes
    if minutes != campaign.block_minutes:
        refuse_absurd("block length", campaign.sampling_rate_hz, minutes, len(campaign.sensors))
    # two seconds, given as minutes, are two seconds again
    return pd.Timedelta(microseconds=round(6e7 * minutes))


def _row_offsets(file: RecordFile, start: pd.Timestamp, rate_hz: float) -> tuple[int, int]:
    """Row of the block at which the file begins, and row of the file that goes there; to the nearest sample."""
    offset = round((file.start - start).total_seconds() * rate_hz)
    return max(offset, 0), max(-offset, 0)


def _assemble(campaign: Campaign, start: pd.Timestamp, length: pd.Timedelta, pieces) -> Block:
    n_sample = round(length.total_seconds() * campaign.sampling_rate_hz)
    notes = []
    covered = np.zeros(n_sample, bool)
    if len(pieces) == 1 and len(pieces[0][1]) == n_sample:
        data = np.array(pieces[0][1], dtype=float)
        covered[:] = True
    else:
        data = np.full((n_sample, len(campaign.sensors)), np.nan)
        for first, piece in pieces:
            rows = slice(first, first + len(piece))
            # of several loggers each has its own channels, and the others' are lost there
            here = data[rows]
            both = np.isfinite(here) & np.isfinite(piece)
            if both.any():
                # one sample of two files may have one place by rounding
                same = both.any(axis=1).sum() == 1 or np.array_equal(here[both], piece[both])
                notes.append(OVERLAP if same else CONTRADICTION)
            data[rows] = np.where(np.isnan(here), piece, here)
            covered[rows] = True
    if np.any(campaign.unit_factor != 1):
        data *= campaign.unit_factor
    lost, impossible, marker, spikes = _without_impossible(data, campaign, notes)
    missing = lost.mean(axis=0)
    again, drawn = _mark_not_measured(data, lost, campaign.sampling_rate_hz)
    repeated, line = again.mean(axis=0), drawn.mean(axis=0)
    data[again | drawn] = np.nan
    notes += _unmeasured_notes(campaign.channels, missing, repeated, line)
    return Block(
        start=start, minutes=length.total_seconds() / 60, sampling_rate_hz=campaign.sampling_rate_hz,
        data=_make_read_only(data), missing=frozen_array(missing), impossible=frozen_array(impossible, int),
        marker=frozen_array(marker), spikes=frozen_array(spikes, int),
        repeated=frozen_array(repeated), filled=frozen_array(line), notes=tuple(notes),
        excluded=_exclusion_reason(campaign, covered, 1 - missing - repeated - line),
    )


def _without_impossible(
    data: np.ndarray, campaign: Campaign, notes: list[str]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(n_sample, n_channel) bool: what is lost of data, where it becomes NaN; and impossible, marker and spikes as of
    `Block`."""
    # no sensor measures what its square would overflow on: the bit pattern of a damaged file
    lost = ~(np.abs(data) < LARGEST_SI)
    impossible = np.sum(lost & ~np.isnan(data), axis=0)
    for name, count in zip(campaign.channels, impossible, strict=True):
        if count:
            notes.append(f"{plural(int(count), 'sample')} of {name} beyond {LARGEST_SI:g} (SI), which no sensor "
                         f"measures: {COUNTED_AS_LOST}")
    data[lost] = np.nan
    marker, spikes = np.full(len(campaign.channels), np.nan), np.zeros(len(campaign.channels), int)
    for c in gaps.with_markers(data):
        column, name = np.ascontiguousarray(data[:, c]), campaign.channels[c]
        for value in gaps.markers(column):
            at = column == value
            impossible[c] += at.sum()
            marker[c] = value
            lost[at, c] = True
            data[at, c] = np.nan
            notes.append(f"{plural(int(at.sum()), 'sample')} of {name} at {value:.6g}, a number for lost ones: "
                         f"{COUNTED_AS_LOST}")
        alone = gaps.lone_samples(data[:, c], campaign.sampling_rate_hz)
        if alone.any():
            spikes[c] = alone.sum()
            lost[alone, c] = True
            data[alone, c] = np.nan
            notes.append(f"{plural(int(spikes[c]), 'sample')} of {name} far from everything beside: {COUNTED_AS_LOST}")
    return lost, impossible, marker, spikes


def _mark_not_measured(data: np.ndarray, lost: np.ndarray, rate_hz: float) -> tuple[np.ndarray, np.ndarray]:
    """(n_sample, n_channel) bool each: samples that repeat the one before, and those on lines drawn over gaps."""
    again, drawn = np.zeros_like(lost), np.zeros_like(lost)
    repeating, straight = gaps.suspected_columns(data)
    for c in repeating:
        again[:, c] = gaps.find_repeated(np.ascontiguousarray(data[:, c]), rate_hz)
    for c in straight:
        drawn[:, c] = gaps.find_filled(np.ascontiguousarray(data[:, c]))
    return again, drawn


def _unmeasured_notes(channels: tuple[str, ...], *shares: np.ndarray) -> list[str]:
    """Shares (n_channel,) of samples that are lost, repeated and filled, in words."""
    words = ("lost", "only repeat the one before", "on straight lines drawn over gaps")
    notes = []
    for word, share in zip(words, shares, strict=True):
        some = [f"{name} {100 * x:.2g} %" for name, x in zip(channels, share, strict=True) if x > 0]
        if len(some) == len(channels) and np.ptp(share) == 0 and len(some) > 1:
            some = [f"all channels {100 * share[0]:.2g} %"]
        if some:
            notes.append(f"samples {word}: {', '.join(some)}")
    return notes


def _exclusion_reason(campaign: Campaign, covered: np.ndarray, measured: np.ndarray) -> str:
    """Why a block cannot be used: it is but a part of one, or a channel was hardly measured in it."""
    there = np.flatnonzero(covered)
    n_sample, rate = len(covered), campaign.sampling_rate_hz
    # before the first file of it or after the last one nothing was recorded, and nothing is missing
    if there.size and max(there[0], n_sample - 1 - there[-1]) > round(LONGEST_BREAK_S * rate):
        return f"{PART}: {(np.ptp(there) + 1) / rate / 60:.3g} min in it"
    bad = np.flatnonzero(measured < LEAST_MEASURED)
    if not bad.size:
        return ""
    who = "all channels" if len(bad) == len(measured) else ", ".join(campaign.channels[k] for k in bad)
    return f"gaps: only {100 * measured[bad].min():.2g} % of the samples were measured in {who}"


def _make_read_only(data: np.ndarray) -> np.ndarray:
    """Read-only without a copy: nobody else holds it."""
    data.setflags(write=False)
    return data
