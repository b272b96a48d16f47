"""Files of other programs brought into a campaign's layout: acceleration/*.h5 that match its campaign.toml."""

from __future__ import annotations

import contextlib
import hashlib
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import ndimage

from probupdate.campaign.clocks import put_in_time
from probupdate.campaign.description import Description, read_descriptions
from probupdate.campaign.logger_channels import OFFSET, SAME_VALUE
from probupdate.campaign.plausible import refuse_time
from probupdate.campaign.reading import WAIT, CampaignHead, channels_attribute, read_head
from probupdate.campaign.sources import open_source
from probupdate.campaign.stated import UNITS, ChannelStatement, FileStatements, channel_factor, refuse_other_rate
from probupdate.campaign.timing import file_clock
from probupdate.errors import InputError, parsing
from probupdate.io.files import input_file, read_json, remove_stale, write_json
from probupdate.io.hdf5_file import new_hdf5, open_hdf5
from probupdate.io.result_table import files_table, plural
from probupdate.runtime.progress import Progress, silent

# a file written holds at most so much time, so that no reader is asked for more and a kill loses little
FILE_S = 3600.0
RECORD = "converted.json"
# of a source in that file, while it is converted
UNFINISHED = "unfinished"
# columns that are named of those not used
MOST_NAMED = 12
# of a sample, by which a logger's samples may miss the grid; samples over which what a spline takes beyond an end
# decays to a thousandth (its largest pole is 0.43)
ON_GRID, SPLINE = 0.01, 8


@dataclass(frozen=True, kw_only=True)
class Conversion:
    """files: the records written, in order of time; kept: those an earlier run had written; notes: what was done to
    gaps, times and numbers, one sentence each."""

    files: tuple[Path, ...]
    kept: tuple[Path, ...]
    samples: int
    notes: tuple[str, ...]

    def to_frame(self) -> pd.DataFrame:
        """A row a file of records, written or kept from before."""
        return files_table(written=self.files, kept=self.kept)

    @property
    def summary(self) -> str:
        text = (f"{plural(len(self.files), 'file')} written, {len(self.kept)} kept from before, "
                f"{self.samples} samples a channel")
        return "\n".join([text, *(f"  {n}" for n in self.notes)])


def convert(
    sources: str | Path, campaign: str | Path, *, description: str | Path | None = None, progress: Progress = silent
) -> Conversion:
    """Write acceleration/*.h5 of the campaign from the files below `sources` that its convert.toml describes.

    campaign holds campaign.toml (which names the channels, in order, and the rate) and, unless `description` names
    another, convert.toml. Of several loggers each has files of its own, in which the others' channels are lost, on the
    campaign's grid of times: blocks join them. Each source is done whole and entered in acceleration/converted.json: a
    run that was killed goes on with the source it was at, and a source that changed since is refused, as is any file in
    the way. Gaps up to fill_seconds become NaN, longer ones another file. Raises InputError for irregular sampling,
    another rate, times that run back, a zone that is not stated, and whatever else would have to be guessed.
    """
    sources, campaign = Path(sources), Path(campaign)
    head = read_head(campaign / "campaign.toml")
    loggers = read_descriptions(description or campaign / "convert.toml", head.channels)
    named = _sources_by_name(sources, loggers)
    folder = campaign / "acceleration"
    folder.mkdir(exist_ok=True)
    remove_stale(folder)
    record = _read_record(folder / RECORD)
    written: list[Path] = []
    kept: list[Path] = []
    notes: list[tuple[pd.Timestamp, list[str]]] = []
    unused: Counter[str] = Counter()
    samples = 0
    spans: list[tuple[pd.Timestamp, pd.Timestamp, str]] = []
    for number, (name, (paths, described)) in enumerate(named.items()):
        progress("converting files", number, len(named))
        before = [_state(p) for p in paths]
        key = _key(paths, _words(described, head))
        entry, removed = record.get(name), []
        if entry is not None and entry.get(UNFINISHED):
            removed = _remove_leftover_files(folder, name, entry["key"], key)
            entry = None
        if entry is not None:
            if entry["key"] != key:
                raise InputError(str(paths[0]), "it, campaign.toml or convert.toml is no longer what was converted",
                                 f"delete what came of it ({', '.join(entry['files'][:3])} ...) and its entry in "
                                 f"{folder / RECORD}, or convert into a new folder")
            lost = [f for f in entry["files"] if not (folder / f).is_file()]
            if lost:
                raise InputError(str(folder / lost[0]), f"is gone, though {name} was converted",
                                 f"delete the entry of {name} in {RECORD} to convert it again")
            kept += [folder / f for f in entry["files"]]
            samples += entry["samples"]
            spans += [(pd.Timestamp(a), pd.Timestamp(b), name) for a, b in entry["spans"]]
            continue
        record[name] = {"key": key, "files": [], "samples": 0, "spans": [], UNFINISHED: True}
        _write_record(folder / RECORD, record)
        outputs, count, said, own, left = _read_source(paths, name, described, head, folder, key)
        beside = [one for one in spans if named[one[2]][1] is described]
        unused.update(left)
        _refuse_changed(paths, before, outputs)
        joined = _overlap_sentence(own, outputs, beside, folder, record, described.overrule, head.sampling_rate_hz,
                           str(paths[0]))
        record[name] = {"key": key, "files": [p.name for p in outputs], "samples": count,
                        "spans": [[a.isoformat(), b.isoformat()] for a, b in own]}
        _write_record(folder / RECORD, record)
        written += outputs
        samples += count
        notes.append((own[0][0], [*removed, *said, *joined]))
        spans += [(a, b, name) for a, b in own]
    progress("converting files", len(named), len(named))
    return Conversion(files=tuple(sorted(written)), kept=tuple(sorted(kept)), samples=samples,
                      notes=(*_notes_once(notes), *_unused_words(unused)))


def _sources_by_name(
    sources: Path, loggers: Sequence[Description]
) -> dict[str, tuple[tuple[Path, ...], Description]]:
    """The files of every source and the logger they are of, by what converted.json calls it."""
    above, named = sources if sources.is_dir() else sources.parent, {}
    for described in loggers:
        for paths in _group_sources(sources, described):
            name = " + ".join(p.relative_to(above).as_posix() for p in paths)
            if name in named:
                raise InputError(str(paths[0]), "is a file of two loggers",
                                 "give each [[logger]] a pattern of its own files")
            named[name] = paths, described
    return named


def _words(described: Description, head: CampaignHead) -> bytes:
    """What besides its content decides what becomes of a source; whether overlaps are taken as they are does not."""
    same = replace(described, path=Path(), overrule=tuple(w for w in described.overrule if w != "overlap"))
    return repr((same, head.channels, head.sampling_rate_hz)).encode()


def _unused_words(unused: Mapping[str, int]) -> list[str]:
    """One sentence on columns that no [[sensor]] reads, name -> number of files converted now that have it."""
    some = [f"{name} ({plural(n, 'file')})" for name, n in unused.items()][:MOST_NAMED]
    more = [f"{len(unused) - len(some)} more"] if len(unused) > len(some) else []
    words = "columns not used, as no [[sensor]] of campaign.toml has them"
    return [f"{words}: {', '.join([*some, *more])}"] if some else []


def _group_sources(sources: Path, described: Description) -> list[tuple[Path, ...]]:
    """The described files, in order of their names, those that join_pattern joins together; none may lie outside
    through a link."""
    if sources.is_file():
        return [(sources,)]
    if not sources.is_dir():
        raise InputError(str(sources), "is neither a folder nor a file", "give where the files to convert lie")
    inside = sources.resolve()
    # what is not a file but a folder, or leads nowhere, is asked about: records are not left out in silence
    found = sorted(p for p in sources.glob(described.files) if not p.is_dir())
    if not found:
        raise InputError(str(sources), f"holds no file that matches '{described.files}'",
                         f"correct files in {described.path}")
    for path in found:
        input_file(path, f"remove it, or correct files in {described.path}")
        if not path.resolve().is_relative_to(inside):
            raise InputError(str(path), "leads out of the folder of the sources", "copy the file there")
    if described.join_pattern is None:
        return [(path,) for path in found]
    joined: dict[str, list[Path]] = {}
    for path in found:
        alike = re.search(described.join_pattern, path.name)
        if alike is None:
            raise InputError(str(path), f"its name does not hold '{described.join_pattern}'",
                             "correct join_pattern or files")
        joined.setdefault(alike[1] or "", []).append(path)
    return [tuple(paths) for paths in joined.values()]


def _key(paths: Sequence[Path], words: bytes) -> str:
    # what it holds, not its time: a copy of a folder is the same source
    content = ""
    for path in paths:
        with parsing(str(path), "cannot be read", "check its permissions"), path.open("rb") as file:
            content += f"{hashlib.file_digest(file, 'sha256').hexdigest()}\n"
    return hashlib.sha256(content.encode() + words).hexdigest()


def _state(path: Path) -> tuple[int, ...]:
    with parsing(str(path), "cannot be read", "check its permissions"):
        found = path.stat()
    return found.st_size, found.st_mtime_ns, found.st_ino


def _refuse_changed(paths: Sequence[Path], before: list[tuple[int, ...]], outputs: Sequence[Path]) -> None:
    for path, state in zip(paths, before, strict=True):
        if _state(path) != state:
            for written in outputs:
                written.unlink()
            raise InputError(str(path), "changed while it was converted", WAIT)


def _remove_leftover_files(folder: Path, name: str, former: str, key: str) -> list[str]:
    """A sentence where files are removed that a conversion which did not end made of other content or words."""
    remains = [path for path in folder.glob(f"*Z-{former[:6]}.h5")] if former != key else []
    for path in remains:
        path.unlink()
    return [f"{name}: {plural(len(remains), 'file')} of an unfinished conversion removed, as the source or its "
            "description has changed since"] if remains else []


def _read_record(path: Path) -> dict:
    if not path.exists():
        return {}
    record, good = {}, False
    with contextlib.suppress(InputError, TypeError):
        record = read_json(path)
        good = isinstance(record, dict) and all({"key", "files", "samples", "spans"} <= set(e) for e in record.values())
    if not good:
        raise InputError(str(path), "is not what `convert` writes", "delete the folder's records and convert again")
    return record


def _write_record(path: Path, record: dict) -> None:
    # in one order, whatever was converted first
    write_json(path, dict(sorted(record.items())))


def _notes_once(notes: Sequence[tuple[pd.Timestamp, list[str]]]) -> list[str]:
    """Each note 'file: what was done' once, in order of the files' starts, with the number of files that share it where
    they are more than two."""
    files: dict[str, list[str]] = {}
    for note in (text for _, texts in sorted(notes, key=itemgetter(0)) for text in texts):
        name, _, text = note.partition(": ")
        files.setdefault(text or note, []).append(name if text else "")
    found = []
    for text, names in files.items():
        if len(names) > 2 and all(names):
            found.append(f"{len(names)} files ({names[0]} to {names[-1]}): {text}")
        else:
            found += [f"{name}: {text}" if name else text for name in names]
    return found


def _overlap_sentence(
    own: Sequence[tuple[pd.Timestamp, pd.Timestamp]], outputs: Sequence[Path],
    spans: Sequence[tuple[pd.Timestamp, pd.Timestamp, str]], folder: Path, record: Mapping, overruled: Sequence[str],
    rate_hz: float, source: str,
) -> list[str]:
    """A sentence where records of this source and of earlier ones overlap and agree; where they do not, its files are
    removed and InputError names both."""
    said: dict[str, int] = {}
    earlier = {name: list(zip(e["files"], e["spans"], strict=True)) for name, e in record.items()}
    for (start, end), path in zip(own, outputs, strict=True):
        for other in dict.fromkeys(name for a, b, name in spans if a < end and start < b):
            for file, (a, b) in earlier[other]:
                begin, last = max(start, pd.Timestamp(a)), min(end, pd.Timestamp(b))
                count = round((last - begin).total_seconds() * rate_hz)
                if count < 1:
                    continue
                since = (begin - start, begin - pd.Timestamp(a))
                if "overlap" not in overruled and not _hold_same_samples(path, folder / file, since, count, rate_hz):
                    for written in outputs:
                        written.unlink()
                    anew = ("where each file counts from its own beginning, take that from its name by start_pattern; "
                            "else ") if since[0] == since[1] else ""
                    raise InputError(source, f"overlaps {other} by {count} samples from {begin:%Y-%m-%dT%H:%M:%S.%fZ} "
                                     "and differs from it there", anew + "keep the right one of the two in `files`, or "
                                     'write overrule = ["overlap"] in convert.toml, which uses what starts first')
                said[other] = said.get(other, 0) + count
    words = "where the one that starts first is used" if "overlap" in overruled else "which agree"
    return [f"{source} and {other} overlap by {count} samples, {words}" for other, count in said.items()]


def _hold_same_samples(one: Path, other: Path, since, count: int, rate_hz: float) -> bool:
    """Whether two records hold the same, a lost sample being like any; since: from the start of each."""
    first = [round(s.total_seconds() * rate_hz) for s in since]
    if abs((since[0] - since[1]).total_seconds() * rate_hz - (first[0] - first[1])) > OFFSET:
        return False
    found = []
    for path, row in zip((one, other), first, strict=True):
        with open_hdf5(path, "cannot be read", "convert again") as file:
            found.append(file["data"][row: row + count].astype(float))
    size = min(len(f) for f in found)
    a, b = found[0][:size], found[1][:size]
    scale = np.nanmax(np.abs([a, b]), initial=0.0)
    # where either is lost the comparison is False
    return not np.any(np.abs(a - b) > SAME_VALUE * scale)


# One source ---------------------------------------------------------------------------------------------------------


def _read_source(paths: Sequence[Path], name: str, described: Description, head: CampaignHead, folder: Path, key: str):
    """(files, samples, notes, (start, end) of each, columns not used): the source's samples on the campaign's clock."""
    path, every = paths[0], head
    head = replace(every, sensors=tuple(s for s in every.sensors if s.channel in described.columns))
    clock = file_clock(path, described, head.sampling_rate_hz)
    writer = _Writer(folder, name, key, every, [every.channels.index(c) for c in head.channels])
    own, pieces = open_source(path, described, rate_hz=head.sampling_rate_hz, joined=paths[1:])
    refuse_other_rate(str(path), own, head.sampling_rate_hz, described.overrule)
    factor, words = _factors(path, own, head, described)
    lost, markers = 0, [v for v in described.lost if not isinstance(v, str)]
    for number, (time, data) in enumerate(pieces):
        if number == 0:
            refuse_time(str(path), head.channels, data)
        if markers:
            data = np.where(np.isin(data, markers), np.nan, data)
        if number == 0:
            _refuse_counts(str(path), data, factor, head, described)
        # what single precision does not hold is not an acceleration: lost, and counted below
        with np.errstate(over="ignore", invalid="ignore"):
            data = (data * factor).astype(np.float32)
        gone = ~np.isfinite(data)
        data[gone] = np.nan
        lost += int(np.sum(gone))
        for start, rows in clock.place(time, data):
            writer.add(start, rows)
    for start, rows in clock.finish():
        writer.add(start, rows)
    outputs, spans, count = writer.close()
    if not count:
        raise InputError(str(path), "holds no sample", "leave it out of `files`")
    notes = [f"{name}: {text}" for text in (*own.notes, *words, *clock.notes())]
    if lost:
        notes.append(f"{name}: {plural(lost, 'value')} lost (NaN)")
    return outputs, count, notes, spans, own.unused


def _factors(
    path: Path, own: FileStatements, head: CampaignHead, described: Description
) -> tuple[np.ndarray, list[str]]:
    """(n_channel,) what the samples are multiplied with, and what the file's own words changed."""
    found = [channel_factor(str(path), s, own.channels.get(s.channel, ChannelStatement()),
                            described.factor.get(s.channel),
                            described.overrule) for s in head.sensors]
    return np.array([f for f, _ in found]), [text for _, text in found if text is not None]


def _refuse_counts(path: str, data: np.ndarray, factor: np.ndarray, head: CampaignHead, described: Description) -> None:
    """Raises InputError for whole numbers in m/s2, g, m/s or m, which is how a converter counts and nothing vibrates; a
    factor in convert.toml, 1 too, says what one is."""
    for sensor, column, f in zip(head.sensors, data.T, factor, strict=True):
        known = column[np.isfinite(column)]
        if sensor.channel not in described.factor and abs(f) * UNITS[sensor.quantity][sensor.unit] >= 1 and len(
                np.unique(known)) > 2 and np.all(known == np.round(known)):
            raise InputError(f"{path}, {sensor.channel}", f"holds whole numbers from {known.min():g} to "
                             f"{known.max():g}, as a converter's counts, and campaign.toml says {sensor.unit}",
                             f"give {sensor.unit} per count under [factor] in convert.toml, or 1.0")


class _Writer:
    """Rows with the start of their chunk, gathered into files of up to FILE_S; each gets its name when complete."""

    def __init__(self, folder: Path, source: str, key: str, head: CampaignHead, columns: Sequence[int]):
        """columns: of the campaign's channels those that the source has."""
        self.folder, self.source, self.key, self.head, self.columns = folder, source, key, head, list(columns)
        self.longest = round(FILE_S * head.sampling_rate_hz)
        self.start: pd.Timestamp | None = None
        self.rows: list[np.ndarray] = []
        self.size = 0
        self.files: list[Path] = []
        self.spans: list[tuple[pd.Timestamp, pd.Timestamp]] = []
        self.count = 0

    def add(self, start: pd.Timestamp | None, rows: np.ndarray) -> None:
        """start: where a new chunk begins; None where the rows follow on."""
        if start is not None:
            self._write()
            self.start = start
        while len(rows):
            room = self.longest - self.size
            self.rows.append(rows[:room].astype(np.float32))
            self.size += len(self.rows[-1])
            rows = rows[room:]
            if self.size == self.longest:
                following = self.start + pd.Timedelta(seconds=self.size / self.head.sampling_rate_hz)
                self._write()
                self.start = following

    def close(self):
        self._write()
        return self.files, self.spans, self.count

    def _write(self) -> None:
        if not self.size:
            return
        assert self.start is not None, "the first rows begin a chunk"
        data = np.concatenate(self.rows)
        if len(self.columns) < len(self.head.channels):
            self.start, data = self._on_grid(self.start, data)
        # two sources may start at one time: the key's head distinguishes their files
        path = self.folder / f"{self.start.strftime('%Y%m%dT%H%M%S.%f')[:-3]}Z-{self.key[:6]}.h5"
        if path.exists():
            with open_hdf5(path, "is there already and cannot be read", "move it away") as file:
                mine = "data" in file and file["data"].attrs.get("source_key") == self.key
            if not mine:
                raise InputError(str(path), "already exists and comes from another source", "move it away")
        with new_hdf5(path) as file:
            made = file.create_dataset("data", data=data)
            made.attrs["start"] = self.start.isoformat().replace("+00:00", "Z")
            made.attrs["sampling_rate_hz"] = self.head.sampling_rate_hz
            made.attrs["channels"] = channels_attribute(self.head.channels)
            made.attrs["source"], made.attrs["source_key"] = self.source, self.key
        self.files.append(path)
        self.spans.append((self.start, self.start + pd.Timedelta(seconds=self.size / self.head.sampling_rate_hz)))
        self.count += self.size
        self.rows, self.size = [], 0

    def _on_grid(self, start: pd.Timestamp, own: np.ndarray) -> tuple[pd.Timestamp, np.ndarray]:
        """Start and samples of one logger of several at the multiples of the campaign's step since 1970, where the
        others' are put too, in their columns; by splines, and lost beside gaps and ends, which these do not bear."""
        rate = self.head.sampling_rate_hz
        put = pd.Timestamp(round(round(start.value * 1e-9 * rate) / rate * 1e9), tz="UTC")
        late = (put - start).total_seconds()
        if abs(late) * rate > ON_GRID:
            beside = ndimage.binary_dilation(np.isnan(own), np.ones((2 * SPLINE + 1, 1)), border_value=1)
            own = put_in_time(own.astype(float), rate, np.full(own.shape[1], late), np.zeros(own.shape[1]))
            own[beside] = np.nan
        data = np.full((len(own), len(self.head.channels)), np.nan, np.float32)
        data[:, self.columns] = own
        return put, data
