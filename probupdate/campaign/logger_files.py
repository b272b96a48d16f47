"""Files of data loggers as channels with their own rates and starts: TDMS (npTDMS), MDF (asammdf), miniSEED (pymseed),
SAC and WAV. Each library is imported where a file of its kind is read."""

from __future__ import annotations

import struct
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd

from probupdate.campaign.logger_channels import LoggerChannel, Segment
from probupdate.campaign.stated import ChannelStatement
from probupdate.errors import InputError, parsing

# what is read whole, as eight-byte numbers
LARGEST_WHOLE = 300 * 2**20
FULL_SCALE = "full scale"


def _library(name: str, path: Path, kind: str, extra: str) -> ModuleType:
    try:
        return import_module(name)
    except ImportError:
        raise InputError(str(path), f"{kind} needs the package {name}, which is not installed",
                         f"pip install probupdate[{extra}]") from None


def _refuse_large(path: Path, n_value: int) -> None:
    if 8 * n_value > LARGEST_WHOLE:
        raise InputError(str(path), f"holds {n_value} samples, too many to read at once",
                         "export it in parts, such as hours")


# TDMS ---------------------------------------------------------------------------------------------------------------

START_KEY = b"wf_start_time"
TIMESTAMP = 0x44


@contextmanager
def tdms_channels(path: Path) -> Iterator[tuple[list[LoggerChannel], bool]]:
    """Channels '<group>/<channel>' of a TDMS file and that its times are UTC; those with a waveform's properties have a
    start and a rate."""
    nptdms = _library("nptdms", path, "TDMS", "tdms")
    said = str(path), "cannot be read as TDMS", "write it again or remove it"
    # given a path, the package leaves a damaged file open, and believes an index file beside it
    with path.open("rb") as raw:
        with parsing(*said):
            _refuse_restarts(path)
            file = nptdms.TdmsFile.open(raw)
        with file:
            with parsing(*said):
                found = [_tdms_channel(path, c, said) for g in file.groups() for c in g.channels()]
            yield found, True


def _tdms_channel(path: Path, channel, said: Sequence[str]) -> LoggerChannel:
    own = channel.properties
    step = float(own.get("wf_increment") or 0.0)
    start = own.get("wf_start_time")
    if start is not None:
        start = int(np.datetime64(start, "ns").astype(np.int64)) + round(float(own.get("wf_start_offset") or 0.0) * 1e9)
        # LabVIEW writes 1904 where the start was not set
        start = start if start > 0 else None
    unit = own.get("unit_string") or own.get("NI_UnitDescription")

    def values(first: int, last: int) -> np.ndarray:
        with parsing(*said):
            found = np.asarray(channel[first:last])
        if found.dtype.kind == "M":
            return found
        return _numbers(found, path, channel.name)

    one = Segment(path=path, size=len(channel), values=values, start_ns=start, rate_hz=1 / step if step > 0 else None)
    return LoggerChannel(names=(f"{channel.group_name}/{channel.name}", channel.name), segments=(one,),
                         stated=ChannelStatement(unit=str(unit) if unit else None))


def _numbers(values: np.ndarray, path: Path, name: str) -> np.ndarray:
    if values.dtype.kind not in "iufb" or values.ndim != 1:
        raise InputError(f"{path}, {name}", f"holds {values.dtype} of {values.ndim} dimensions, not numbers in a row",
                         "name another channel in [columns]")
    return _floats(values)


def _floats(values: np.ndarray) -> np.ndarray:
    # any pattern of bits may be read as a number, some only with a warning
    with np.errstate(invalid="ignore"):
        return np.asarray(values, float)


def _refuse_restarts(path: Path) -> None:
    """A writer that appends may state another start; libraries keep the last one and put the samples in one row."""
    known: set[bytes] = set()
    size, place, number = path.stat().st_size, 0, 0
    with path.open("rb") as file:
        while place + 28 <= size:
            file.seek(place)
            head = file.read(28)
            if head[:4] != b"TDSm":
                return
            order = ">" if head[4] & 64 else "<"
            following, raw = struct.unpack(f"{order}QQ", head[12:])
            text = file.read(min(raw, size - place))
            starts = set()
            for part in text.split(START_KEY)[1:]:
                if len(part) >= 20 and struct.unpack(f"{order}I", part[:4])[0] == TIMESTAMP:
                    starts.add(part[4:20])
            if number and starts - known:
                raise InputError(str(path), f"its segment {number + 1} states another start than those before: it "
                                 "holds several recordings in a row", "save each recording to a file of its own")
            known |= starts
            number += bool(starts)
            if following >= size:
                return
            place += 28 + following


# MDF ----------------------------------------------------------------------------------------------------------------


@contextmanager
def mdf_channels(path: Path) -> Iterator[tuple[list[LoggerChannel], bool]]:
    """Channels '<group>/<channel>', groups counted from 1, each with the time of every sample; and whether those state
    their zone. Samples that the file marks as invalid are NaN."""
    asammdf = _library("asammdf", path, "MDF", "mdf")
    said = str(path), "cannot be read as MDF", "write it again or remove it"
    with parsing(*said):
        file = asammdf.MDF(path)
    with file:
        with parsing(*said):
            start = pd.Timestamp(file.start_time)
            zero = int(start.as_unit("ns").value) if start.tzinfo is None else int(
                start.tz_convert("UTC").as_unit("ns").value)
            found = []
            for g, group in enumerate(file.groups):
                master = file.masters_db.get(g)
                if master is None or not group.channel_group.cycles_nr:
                    continue
                times = np.asarray(file.get_master(g), float)
                moments = zero + np.round(times * 1e9).astype(np.int64)
                found += [_mdf_channel(path, file, g, k, c, moments, said) for k, c in enumerate(group.channels)
                          if k != master]
        yield found, start.tzinfo is not None


def _mdf_channel(path: Path, file, group: int, index: int, channel, moments: np.ndarray, said) -> LoggerChannel:
    def values(first: int, last: int) -> np.ndarray:
        with parsing(*said):
            found = file.get(group=group, index=index, record_offset=first, record_count=last - first,
                             ignore_invalidation_bits=True)
        numbers, invalid = _numbers(np.asarray(found.samples), path, channel.name), found.invalidation_bits
        return numbers if invalid is None else np.where(np.asarray(invalid, bool), np.nan, numbers)

    one = Segment(path=path, size=len(moments), values=values, moments=moments)
    return LoggerChannel(names=(f"{group + 1}/{channel.name}", channel.name), segments=(one,),
                         stated=ChannelStatement(unit=str(channel.unit or "").strip() or None))


# miniSEED -----------------------------------------------------------------------------------------------------------


def begins_miniseed(head: bytes) -> bool:
    """Whether a file begins with a record of version 3 or 2."""
    return head[:3] == b"MS\x03" or (head[:6].isdigit() and head[6:7] in b"DRQM" and head[7:8] in b" \0")


def miniseed_channels(paths: Sequence[Path]) -> list[LoggerChannel]:
    """Channels by their identifiers, 'FDSN:XX_TP_00_H_N_X' and 'XX.TP.00.HNX', a segment a record; whole numbers are
    counts."""
    pymseed = _library("pymseed", paths[0], "miniSEED", "miniseed")
    segments: dict[str, list[Segment]] = {}
    counts: dict[str, bool] = {}
    total = 0
    for path in paths:
        with parsing(str(path), "cannot be read as miniSEED", "fetch it again or remove it"):
            for record in pymseed.MS3Record.from_file(str(path), unpack_data=True):
                if not record.numsamples or record.sampletype == "t":
                    continue
                total += record.numsamples
                _refuse_large(path, total)
                data = np.array(record.np_datasamples)
                segments.setdefault(record.sourceid, []).append(Segment(
                    path=path, size=len(data), start_ns=int(record.starttime), rate_hz=float(record.samprate),
                    values=lambda a, b, data=data: data[a:b].astype(float)))
                counts[record.sourceid] = counts.get(record.sourceid, False) or data.dtype.kind in "iu"
    return [LoggerChannel(names=(name, *_short_identifier(name)), segments=tuple(found),
                          stated=ChannelStatement(unit="counts" if counts[name]
                                                  else None)) for name, found in segments.items()]


def _short_identifier(name: str) -> tuple[str, ...]:
    """'XX.TP.00.HNX' of 'FDSN:XX_TP_00_H_N_X'."""
    parts = name.removeprefix("FDSN:").split("_")
    return (".".join([*parts[:3], "".join(parts[3:])]),) if len(parts) == 6 else ()


# SAC ----------------------------------------------------------------------------------------------------------------

# of the header of 632 bytes: words of 4 bytes, then text; -12345 is not given
SAC_HEAD, SAC_NONE = 632, -12345
# kinds of ordinate; SAC keeps motion in nanometres
SAC_KINDS = {6: ChannelStatement(quantity="displacement", unit="nm"),
             7: ChannelStatement(quantity="velocity", unit="nm/s"),
             8: ChannelStatement(quantity="acceleration", unit="nm/s2"), 50: ChannelStatement(unit="V")}


def sac_channels(paths: Sequence[Path]) -> list[LoggerChannel]:
    """Channels 'XX.TP.00.HNX' (network, station, location, component as far as given) of evenly sampled SAC files,
    version 6 or 7, of either byte order."""
    found: dict[str, tuple[ChannelStatement, list[Segment]]] = {}
    for path in paths:
        name, stated, segment = _sac(path)
        known = found.setdefault(name, (stated, []))
        if known[0] != stated:
            raise InputError(f"{path}, {name}", f"states another kind of ordinate than {known[1][0].path}",
                             "correct IDEP of one of them")
        known[1].append(segment)
    return [LoggerChannel(names=(name, name.split(".")[-1]), stated=stated, segments=tuple(segments))
            for name, (stated, segments) in found.items()]


def sac_order(head: bytes) -> str | None:
    """'<' or '>' of a SAC file's head; None where it is none."""
    if len(head) < SAC_HEAD:
        return None
    return next((o for o in "<>" if struct.unpack(f"{o}i", head[304:308])[0] in (6, 7)), None)


def _sac(path: Path) -> tuple[str, ChannelStatement, Segment]:
    with parsing(str(path), "cannot be read", "check its permissions"), path.open("rb") as file:
        head = file.read(SAC_HEAD)
        file.seek(0, 2)
        size = file.tell()
    order = sac_order(head)
    if order is None:
        raise InputError(str(path), "is not a SAC file of version 6 or 7", "export it again, as binary SAC")
    numbers, whole = np.frombuffer(head, f"{order}f4", 70), np.frombuffer(head, f"{order}i4", 40, 280)
    n_sample, even, delta, begins = int(whole[9]), int(whole[35]), float(numbers[0]), float(numbers[5])
    if even != 1 or whole[15] not in (1, SAC_NONE):
        raise InputError(str(path), "is not an evenly sampled time series (LEVEN, IFTYPE)", "export time series")
    footer = 22 * 8 if whole[6] == 7 else 0
    if n_sample < 1 or size != SAC_HEAD + 4 * n_sample + footer:
        raise InputError(str(path), f"does not hold the {n_sample} samples that its head states", "export it again")
    if footer:
        with path.open("rb") as file:
            file.seek(SAC_HEAD + 4 * n_sample)
            delta, begins = np.frombuffer(file.read(16), f"{order}f8").tolist()
    if not 1e-9 < delta < 1e9 or not np.isfinite(begins):
        raise InputError(str(path), f"invalid time step ({delta:g} s) or start ({begins:g} s)", "export it again")
    text = [head[at: at + 8].decode("ascii", "replace").strip(" \0") for at in (608, 440, 464, 600)]
    name = ".".join("" if t == str(SAC_NONE) else t for t in text).strip(".") or path.stem
    samples = np.memmap(path, f"{order}f4", "r", SAC_HEAD, (n_sample,))
    # a step in single precision is known to seven digits
    rate = float(f"{1 / delta:.7g}")
    one = Segment(path=path, size=n_sample, rate_hz=rate, start_ns=_sac_start(path, whole[:6], begins),
                  values=lambda a, b: _floats(samples[a:b]))
    return name, SAC_KINDS.get(int(whole[16]), NOTHING), one


NOTHING = ChannelStatement()


def _sac_start(path: Path, date: np.ndarray, begins: float) -> int | None:
    year, day, hour, minute, second, ms = (int(v) for v in date)
    if SAC_NONE in (year, day):
        return None
    clock = [0 if v == SAC_NONE else v for v in (hour, minute, second, ms)]
    if not (1900 <= year < 2200 and 1 <= day <= 366 and 0 <= clock[0] < 24 and 0 <= clock[1] < 60
            and 0 <= clock[2] <= 60 and 0 <= clock[3] < 1000):
        raise InputError(str(path), f"its start, day {day} of {year} at {clock}, is not a time", "correct its header")
    zero = int(pd.Timestamp(year=year, month=1, day=1).as_unit("ns").value) + (day - 1) * 86400 * 10**9
    return zero + ((clock[0] * 60 + clock[1]) * 60 + clock[2]) * 10**9 + clock[3] * 10**6 + round(begins * 1e9)


# WAV ----------------------------------------------------------------------------------------------------------------


def wav_channels(path: Path) -> list[LoggerChannel]:
    """Channels '1', '2', ...; whole numbers as shares of full scale, whatever their width; a WAV states no start."""
    from scipy.io import wavfile

    damaged = str(path), "cannot be read as WAV", "export it again as PCM or float"
    with parsing(*damaged), warnings.catch_warnings():
        # chunks of notes beside the samples are passed over; what ends early is damaged
        warnings.filterwarnings("ignore", "Chunk .*not understood", wavfile.WavFileWarning)
        warnings.filterwarnings("error", "Reached EOF", wavfile.WavFileWarning)
        try:
            rate, data = wavfile.read(path, mmap=True)
        except ValueError:
            # 24 bits have no counterpart in memory
            _refuse_large(path, path.stat().st_size // 3)
            rate, data = wavfile.read(path)
    data = data.reshape(len(data), -1)
    kind = data.dtype
    scale = 1.0 if kind.kind == "f" else 2.0 ** (1 - 8 * kind.itemsize)
    zero = 128.0 if kind == np.uint8 else 0.0
    stated = NOTHING if kind.kind == "f" else ChannelStatement(unit=FULL_SCALE)
    return [LoggerChannel(names=(str(k + 1),), stated=stated, segments=(Segment(
        path=path, size=len(data), rate_hz=float(rate),
        values=lambda a, b, k=k: (_floats(data[a:b, k]) - zero) * scale),)) for k in range(data.shape[1])]
