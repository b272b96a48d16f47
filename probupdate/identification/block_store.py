"""Poles of a campaign's blocks on disk, a file a block, so that a killed run goes on where it stopped.

Every file is written under another name and then renamed: it is there whole or not at all. A head says what campaign
and what settings the blocks belong to; each block names the records it was made of.
"""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from probupdate.campaign.blocks import block_files
from probupdate.campaign.reading import Campaign, RecordFile
from probupdate.campaign.scada import StateRule, block_conditions
from probupdate.errors import InputError, of_file
from probupdate.identification.block_poles import (
    WITHOUT_ARRAYS,
    BlockFactors,
    BlockPoles,
    BlockSettings,
    common_quantity,
    identify_block,
    identify_factors,
)
from probupdate.identification.order_average import ModePoles, single_pole_key
from probupdate.identification.ssi import Poles
from probupdate.io.checksum import checksum_of_arrays
from probupdate.io.files import PART, archive, read_json_table, remove_stale, write_arrays, write_json
from probupdate.modal.modes import CovarianceFactors
from probupdate.runtime.arrays import frozen_array
from probupdate.runtime.executors import Executor, Shard, iterate_completed
from probupdate.runtime.progress import Progress, silent

FORMAT = 8
HEAD = "store.json"
# endings of a block's two files: its poles, and the covariance factors of some of them
POLES, FACTORS = ".poles.npz", ".deviations.npz"
# unpacked arrays of one block
LARGEST_BLOCK = 512 * 2**20
# a record up to this size is known by all its bytes, a larger one by so many pieces of that size, head and tail too
WHOLE_BYTES, PIECES, PIECE_BYTES = 16 * 2**20, 64, 64 * 2**10
CHECKSUM, ROTOR = "checksum", "rotor "
# blocks shorter than that (minutes) may begin several in a second
SECOND_MIN = 1 / 60
ANEW = "give another --out, or delete that folder to start again"


class OtherBlocks(InputError):
    """A folder holds blocks of other channels or settings."""


def store_head(campaign: Campaign, settings: BlockSettings) -> dict:
    """What must be equal for stored blocks to be taken: the channels, the clock and the settings of identification."""
    return {
        "format": FORMAT,
        "channels": [f"{s.channel} [{s.quantity}, {s.unit}{', turned' if s.channel in campaign.turned else ''}]"
                     for s in campaign.sensors],
        "quantity": common_quantity(campaign.sensors),
        "sampling_rate_hz": campaign.sampling_rate_hz,
        "block_minutes": campaign.block_minutes,
        "settings": asdict(settings),
    }


def sources(files: tuple[RecordFile, ...]) -> list[str]:
    """The records behind a block: name, start, length, size and content of each file, so that a copied or moved folder
    holds the same records whatever the time of its files.

    The content is a hash (BLAKE2) of all bytes up to 16 MB, which an hour of 18 channels at 25 Hz does not reach. Of a
    larger file it is that of 64 pieces of 64 kB, evenly spread from its first byte to its last: what was changed
    between the pieces, without a change of the file's size, is not seen.
    """
    return [f"{_words(file)}, content {_content(file)}" for file in files]


def content_hash(path: Path) -> str:
    """The hash by which `sources` recognises a file's content; read once a process as long as size and times stay."""
    stat = path.stat()
    return _hash(path, stat.st_size, (stat.st_mtime_ns, stat.st_ctime_ns, stat.st_ino))


def _content(file: RecordFile) -> str:
    """`content_hash` of a file; of a Zarr array, whose chunks are files, that of their names and sizes, and of all of
    them up to 16 MB together, of more of 64 of them."""
    parts = file.parts
    if parts == (file.path,):
        return content_hash(file.path)
    found = hashlib.blake2b(digest_size=16)
    found.update("\n".join(f"{p.relative_to(file.path).as_posix()}, {p.stat().st_size}" for p in parts).encode())
    whole = sum(p.stat().st_size for p in parts) <= WHOLE_BYTES
    for part in parts if whole else [parts[k] for k in np.linspace(0, len(parts) - 1, PIECES).astype(int)]:
        found.update(content_hash(part).encode())
    return found.hexdigest()


# `state` is a key of the cache only: of times that of the last change of any kind, which nobody sets back
@functools.lru_cache(maxsize=4096)
def _hash(path: Path, size: int, state: tuple[int, ...]) -> str:
    found = hashlib.blake2b(digest_size=16)
    with path.open("rb", buffering=0) as stream:
        if size <= WHOLE_BYTES:
            while piece := stream.read(2**20):
                found.update(piece)
        else:
            for k in range(PIECES):
                stream.seek(k * (size - PIECE_BYTES) // (PIECES - 1))
                found.update(stream.read(PIECE_BYTES))
    return found.hexdigest()


def _words(file: RecordFile) -> str:
    size = sum(part.stat().st_size for part in file.parts)
    return f"{file.path.name}, {file.start.isoformat()}, {file.n_sample} samples, {size} bytes"


def rotor_range(campaign: Campaign, start: pd.Timestamp) -> tuple[float, float] | None:
    """Lowest and highest rotor speed in a block by SCADA, rpm; None where it was not recorded."""
    found = block_conditions(campaign.scada, start, campaign.block_minutes, StateRule())
    low, high = found.get("rotor_speed_rpm_min"), found.get("rotor_speed_rpm_max")
    return None if low is None or high is None else (float(low), float(high))


class BlockStore:
    """A folder of blocks of one campaign under one set of settings; opening another's is refused, saying what differs.
    """

    def __init__(self, folder: str | Path, campaign: Campaign, settings: BlockSettings):
        self.folder, self._campaign, self._settings = Path(folder), campaign, settings
        self._files = block_files(campaign)
        head = store_head(campaign, settings)
        path = self.folder / HEAD
        # asked before the head: another run may write that one meanwhile
        foreign = self.folder.exists() and (
            not self.folder.is_dir() or any(p.suffix != PART for p in self.folder.iterdir()))
        if path.exists():
            _refuse_other(self.folder, _read_head(path), head)
            remove_stale(self.folder)
        elif foreign:
            raise InputError(str(self.folder), "holds something else than identified blocks", ANEW)
        else:
            write_json(path, head)

    def _stem(self, start: pd.Timestamp) -> str:
        return _stem(start, self._campaign.block_minutes)

    @property
    def starts(self) -> tuple[pd.Timestamp, ...]:
        """Every block of the campaign, in order."""
        return tuple(self._files)

    def pending_blocks(self) -> list[pd.Timestamp]:
        """Blocks still to be identified: those without a file, or with a damaged one, and those for which a record came
        since.

        Raises InputError where a stored block was made of records that have changed or gone.
        """
        names = {self._stem(start): start for start in self._files}
        found = {path.name.split(".")[0] for path in self.folder.glob("*.npz")}
        stray = sorted(found - set(names))
        if stray:
            raise InputError(f"{self.folder}, {stray[0]}", "is a block of which the campaign has no record", ANEW)
        todo = []
        for name, start in names.items():
            path = self.folder / (name + POLES)
            before = _whole_sources(path)
            if before is None:
                todo.append(start)
                continue
            now = self.origin(start)
            if before == now:
                continue
            gone = [text for text in before if text not in now]
            if gone:
                raise InputError(str(path), f"was made of other records: then {gone[0]}; now "
                                 f"{'; '.join(now) or 'none'}", ANEW)
            todo.append(start)
        return todo

    def fill(self, *, jobs: int | Executor = 1, shard: Shard | None = None, progress: Progress = silent) -> int:
        """Identify what is pending, in up to `jobs` processes or on an executor; returns how many blocks were
        identified. shard: of that share of the campaign's blocks only.

        Blocks know nothing of one another: the files are the same for any number of processes that run linear
        algebra in one thread each.
        """
        todo = self._shard_blocks(self.pending_blocks(), shard)
        tasks = [(self.folder / (self._stem(t) + POLES), *self._task(t)) for t in todo]
        self._run("identifying blocks", _make_poles, tasks, len(self._files), jobs, progress)
        return len(todo)

    def fill_factors(
        self, wanted: Mapping[pd.Timestamp, Sequence[tuple[int, int]]], *, jobs: int | Executor = 1,
        shard: Shard | None = None, progress: Progress = silent,
    ) -> int:
        """Covariance factors of the poles (model order, index within it) of each block, where those of just these are
        not stored yet: what the spectra say of a mode depends on the modes beside it."""
        tasks = []
        for start in self._shard_blocks(list(wanted), shard):
            if set(wanted[start]) != self._factors_there(start):
                keys = tuple(sorted(wanted[start]))
                poles, path = (self.folder / (self._stem(start) + ending) for ending in (POLES, FACTORS))
                tasks.append((path, poles, *self._task(start), keys))
        self._run("standard deviations of modes", _make_factors, tasks, len(wanted), jobs, progress)
        return len(tasks)

    def without_factors(self, wanted: Mapping[pd.Timestamp, Sequence[tuple[int, int]]]) -> int:
        """How many blocks lack the covariance factors of just the wanted poles."""
        return sum(set(some) != self._factors_there(start) for start, some in wanted.items())

    def _factors_there(self, start: pd.Timestamp) -> set[tuple[int, int]]:
        path = self.folder / (self._stem(start) + FACTORS)
        return _stored_keys(path)

    def _shard_blocks(self, some: list[pd.Timestamp], shard: Shard | None) -> list[pd.Timestamp]:
        """Those of a shard's share of all blocks, whatever is there already."""
        if shard is None:
            return some
        mine = set(shard.share(self.starts))
        return [start for start in some if start in mine]

    def _task(self, start: pd.Timestamp) -> tuple:
        """What a block is made of; without what other blocks are made of, as it is sent to other processes."""
        slim = replace(self._campaign, files=(), scada=None)
        return slim, start, self._files[start], self._settings, self._rotor(start)

    def _rotor(self, start: pd.Timestamp) -> tuple[float, float] | None:
        return rotor_range(self._campaign, start) if self._settings.harmonics == "remove" else None

    def origin(self, start: pd.Timestamp) -> list[str]:
        """The records that a block is made of, as they are now, in words."""
        return [*sources(self._files[start]), *_rotor_words(self._rotor(start))]

    def _run(self, what: str, function, tasks: list, total: int, jobs: int | Executor, progress: Progress) -> None:
        done = total - len(tasks)
        progress(what, done, total)
        for count, _ in enumerate(iterate_completed(function, tasks, jobs=jobs), 1):
            progress(what, done + count, total)
        # the last of a killed run's processes may have gone since
        remove_stale(self.folder)

    def identify_one(self, start: pd.Timestamp) -> BlockPoles:
        """One block alone, where it is not stored yet."""
        _make_poles(self.folder / (self._stem(start) + POLES), *self._task(start))
        return self.read(start)

    def std_of(self, block: BlockPoles) -> dict[tuple[int, int], tuple[float, float]]:
        """`BlockFactors.std` of every pole of a block, each by itself; reads its record."""
        keys = tuple((p.order, single_pole_key(k)) for p in block.every_order for k in range(len(p.frequency_hz)))
        if not keys or not self._settings.sub_records:
            return {}
        return identify_factors(*self._task(block.start), block, keys).std

    def hash_of(self, start: pd.Timestamp) -> str:
        """The hash of a block's stored poles."""
        return _hash_and_sources(self.folder / (self._stem(start) + POLES))[0]

    def read(self, start: pd.Timestamp, *, spectra: bool = True) -> BlockPoles:
        return read_block_poles(self.folder / (self._stem(start) + POLES), spectra=spectra)

    def read_head(self, start: pd.Timestamp) -> BlockPoles:
        """A block without its poles and spectra, which are most of a file."""
        with _open_block(self.folder / (self._stem(start) + POLES)) as content:
            return _block_of(content, **WITHOUT_ARRAYS)

    def read_factors(self, start: pd.Timestamp) -> BlockFactors:
        return read_block_factors(self.folder / (self._stem(start) + FACTORS))


def stored_block(folder: Path, block_id: str) -> BlockPoles | None:
    """The block of that id in a folder of blocks; None where there is none, or the id is not a time."""
    path = _block_path(folder, block_id)
    return None if path is None else read_block_poles(path)


def stored_ids(folder: Path) -> tuple[str, ...]:
    """Ids of the blocks in a folder that have poles, in the order of time."""
    blocks = (read_block_poles(path) for path in sorted(folder.glob(f"*{POLES}")))
    return tuple(block.id for block in blocks if block.poles is not None)


def stored_settings(folder: Path) -> dict:
    """The settings of identification (`BlockSettings`) that a folder of blocks belongs to."""
    return _read_head(folder / HEAD).get("settings") or {}


def choice_head(folder: Path, ids: Sequence[str]) -> dict:
    """What a choice among the poles of a folder of blocks carries beside them: its channels, settings and of each of
    these blocks its id, the hash of its poles and the records that it was made of."""
    head = _read_head(folder / HEAD)
    blocks = []
    for block_id in ids:
        path = _block_path(folder, block_id)
        if path is None:
            raise InputError(f"block {block_id}", f"is not kept in {folder}", "name another, or identify again")
        digest, records = _hash_and_sources(path)
        blocks.append({"id": block_id, "poles_hash": digest, "records": records})
    return {"channels": head.get("channels") or [], "settings": head.get("settings") or {}, "blocks": blocks}


def stored_std(folder: Path, block_id: str) -> dict[tuple[int, int], tuple[float, float]]:
    """(model order, index) -> standard deviations of frequency (Hz) and damping ratio of the poles of a block of which
    they are stored."""
    poles = _block_path(folder, block_id)
    path = None if poles is None else poles.with_name(poles.name.replace(POLES, FACTORS))
    if path is None or not path.exists():
        return {}
    return read_block_factors(path).std


def start_of(block_id: str) -> pd.Timestamp | None:
    """When a block of that id starts, UTC; None where the id is not a time."""
    try:
        start = pd.Timestamp(block_id)
    except ValueError:
        return None
    return None if start is pd.NaT else start.tz_localize("UTC") if start.tzinfo is None else start


def _block_path(folder: Path, block_id: str) -> Path | None:
    start = start_of(block_id)
    if start is None:
        return None
    # ids have a fraction where blocks are shorter than a second
    path = folder / (_stem(start, 0.0 if start.microsecond else SECOND_MIN) + POLES)
    return path if path.exists() else None


def forget_changed(folder: Path, files: tuple[RecordFile, ...], changed: Collection[str] = ()) -> int:
    """Remove stored blocks that were made of records which are none of `files` any more, or are named in `changed`, for
    whoever wants them again without asking; returns how many."""
    there, count = set(sources(files)), 0
    for path in folder.glob(f"*{POLES}"):
        made_of = _whole_sources(path)
        if made_of is not None and all(
                text.startswith(ROTOR) or (text in there and text.split(", ")[0] not in changed) for text in made_of):
            continue
        path.unlink()
        path.with_name(path.name.replace(POLES, FACTORS)).unlink(missing_ok=True)
        count += 1
    return count


def _rotor_words(rotor_rpm: tuple[float, float] | None) -> list[str]:
    """SCADA is a source too where harmonics are removed."""
    return [] if rotor_rpm is None else [f"{ROTOR}{rotor_rpm[0]:g} to {rotor_rpm[1]:g} rpm"]


def _make_poles(
    path: Path, campaign: Campaign, start: pd.Timestamp, files, settings: BlockSettings, rotor_rpm
) -> None:
    # before the records are read: a file that changes meanwhile is found out by the next run
    origin = [*sources(files), *_rotor_words(rotor_rpm)]
    if _whole_sources(path) == origin:
        # by another run on this folder, or by a worker that was lost before it could say so
        return
    block = identify_block(campaign, start, files, settings, rotor_rpm)
    # factors of what the block was before more records came
    path.with_name(path.name.replace(POLES, FACTORS)).unlink(missing_ok=True)
    write_block_poles(path, block, origin)


def _make_factors(
    path: Path, poles: Path, campaign: Campaign, start: pd.Timestamp, files, settings: BlockSettings, rotor_rpm, keys
) -> None:
    if set(keys) == _stored_keys(path):
        return
    known = read_block_poles(poles)
    write_block_factors(path, identify_factors(campaign, start, files, settings, rotor_rpm, known, keys))


def _stem(start: pd.Timestamp, minutes: float) -> str:
    """Name of a block's files: its start to the second, to the microsecond where several blocks begin in one."""
    return f"{start:%Y%m%dT%H%M%SZ}" if minutes >= SECOND_MIN else f"{start:%Y%m%dT%H%M%S%fZ}"


def write_block_factors(path: Path, found: BlockFactors) -> None:
    poles, factors = found.poles, found.poles.factors
    content = {
        "key": np.array(found.key, np.int32).reshape(-1, 2), "frequency_hz": poles.frequency_hz,
        "damping_ratio": poles.damping_ratio, "shape": poles.shape.astype(np.complex64), "kurtosis": found.kurtosis,
        "ln_frequency_factor": factors.ln_frequency.astype(np.float32),
        "damping_factor": factors.damping_ratio.astype(np.float32), "shape_factor": factors.shape.astype(np.complex64),
        "by_likelihood": found.by_likelihood,
    }
    write_arrays(path, content | {CHECKSUM: _checksum(content)})


def read_block_factors(path: Path) -> BlockFactors:
    with of_file(path), _open_block(path) as content:
        return BlockFactors(
            key=tuple((int(a), int(b)) for a, b in content["key"]), kurtosis=frozen_array(content["kurtosis"]),
            by_likelihood=frozen_array(content["by_likelihood"], bool),
            poles=ModePoles(
                frequency_hz=content["frequency_hz"], damping_ratio=content["damping_ratio"],
                shape=frozen_array(content["shape"], complex), factors=CovarianceFactors(
                    ln_frequency=frozen_array(content["ln_frequency_factor"]),
                    damping_ratio=frozen_array(content["damping_factor"]),
                    shape=frozen_array(content["shape_factor"], complex))))


def _stored_keys(path: Path) -> set[tuple[int, int]]:
    """None of a file that is absent or damaged."""
    keys = _whole_array(path, "key")
    return set() if keys is None else {(int(a), int(b)) for a, b in keys}


def write_block_poles(path: Path, block: BlockPoles, origin: list[str]) -> None:
    """One npz file; shapes in single precision, far below their scatter, as most of a month's bytes are theirs."""
    every = block.every_order
    head = {
        "id": block.id, "start": block.start.isoformat(), "minutes": block.minutes, "quantity": block.quantity,
        "excluded": block.excluded, "notes": list(block.notes), "rms": None if np.isnan(block.rms) else block.rms,
        "sources": origin, "unmeasured": block.unmeasured.tolist(),
    }
    content = {
        "head": np.frombuffer(json.dumps(head).encode(), np.uint8),
        "order": np.array([p.order for p in every], np.int32),
        "count": np.array([len(p.frequency_hz) for p in every], np.int32),
        "frequency_hz": _join_arrays([p.frequency_hz for p in every]),
        "damping_ratio": _join_arrays([p.damping_ratio for p in every]),
        "shape": np.concatenate([p.shape.T for p in every]).astype(np.complex64) if every else np.zeros((0, 0)),
        "line_hz": block.line_hz, "spectrum": block.spectrum.astype(np.float32),
        "singular": block.singular.astype(np.float32),
    }
    write_arrays(path, content | {CHECKSUM: _checksum(content)})


def _checksum(content: Mapping[str, np.ndarray]) -> np.ndarray:
    return np.frombuffer(checksum_of_arrays({n: array for n, array in content.items() if n != CHECKSUM}), np.uint8)


def _refuse_damaged(path: Path, content: Mapping) -> None:
    """Raises InputError where a stored file's arrays are not what was written."""
    arrays = {name: content[name] for name in content}
    if CHECKSUM not in arrays or not np.array_equal(arrays[CHECKSUM], _checksum(arrays)):
        raise InputError(str(path), "does not hold what was written: it was damaged or changed",
                         "run `probupdate identify` again, which makes this block anew")


def _whole_array(path: Path, name: str) -> np.ndarray | None:
    """An array of a stored file; None where the file is absent or damaged: it is made again."""
    if not path.exists():
        return None
    try:
        with _open_block(path) as content:
            return content[name]
    except InputError:
        return None


def _whole_sources(path: Path) -> list[str] | None:
    """The records that a stored block was made of; None of one that is absent or damaged."""
    head = _whole_array(path, "head")
    return None if head is None else list(_store_head(head)["sources"])


def read_block_poles(path: Path, *, spectra: bool = True) -> BlockPoles:
    """spectra: with those that a page draws, which no choice among poles needs."""
    with _open_block(path) as content:
        every = _split(content)
        names = ("line_hz", "spectrum", "singular") if spectra else ()
        return _block_of(content, **WITHOUT_ARRAYS | {"poles": every[0] if every else None, "others": tuple(every[1:])}
                         | {name: frozen_array(content[name]) for name in names})


def _block_of(content: Mapping, **arrays: Any) -> BlockPoles:
    head = _store_head(content["head"])
    return BlockPoles(
        id=head["id"], start=pd.Timestamp(head["start"]), minutes=head["minutes"], quantity=head["quantity"],
        excluded=head["excluded"], notes=tuple(head["notes"]), rms=np.nan if head["rms"] is None else head["rms"],
        unmeasured=frozen_array(head["unmeasured"]), **arrays)


def _split(content: Mapping) -> list[Poles]:
    ends = np.cumsum(content["count"])
    frequency, damping, shape = content["frequency_hz"], content["damping_ratio"], content["shape"]
    return [
        Poles(order=int(order), frequency_hz=frozen_array(frequency[a:b]), damping_ratio=frozen_array(damping[a:b]),
              shape=frozen_array(shape[a:b].T, complex))
        for order, a, b in zip(content["order"], ends - content["count"], ends, strict=True)
    ]


def _join_arrays(arrays: list[np.ndarray]) -> np.ndarray:
    return np.concatenate(arrays) if arrays else np.zeros(0)


def _store_head(head: np.ndarray) -> dict:
    return json.loads(head.tobytes().decode())


def _hash_and_sources(path: Path) -> tuple[str, list[str]]:
    with _open_block(path) as content:
        return content[CHECKSUM].tobytes().hex(), list(_store_head(content["head"])["sources"])


def _open_block(path: Path) -> AbstractContextManager[Mapping]:
    """The arrays of one block's file as they were written, each read as it is asked for; what is missing in them is
    said like what cannot be read."""
    return archive(path, "is not an identified block", "delete it: it is identified again", largest=LARGEST_BLOCK,
                   check=_refuse_damaged)


def _read_head(path: Path) -> dict:
    found = read_json_table(path, ANEW)
    if not isinstance(found.get("settings") or {}, dict) or not isinstance(found.get("channels") or [], list):
        raise InputError(str(path), "is not a head of identified blocks", ANEW)
    return found


def _refuse_other(folder: Path, found: dict, head: dict) -> None:
    differ = [f"{key} {_shorten(found.get(key))} there, {_shorten(head[key])} here"
              for key in head if key not in ("settings", "channels") and found.get(key) != head[key]]
    there, here = found.get("settings") or {}, head["settings"]
    differ += [f"{key} {there.get(key)} there, {here[key]} here" for key in here if there.get(key) != here[key]]
    differ += _channel_difference_text(found.get("channels") or [], head["channels"])
    if differ:
        raise OtherBlocks(str(folder), f"holds blocks of another identification: {'; '.join(differ)}", ANEW)


def _channel_difference_text(there: list, here: list) -> list[str]:
    if there == here:
        return []
    if len(there) != len(here):
        return [f"{len(there)} channels there, {len(here)} here"]
    a, b = next((a, b) for a, b in zip(there, here, strict=True) if a != b)
    return [f"channel {a} there, {b} here"]


def _shorten(value) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)

