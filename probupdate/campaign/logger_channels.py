"""Channels of logger files, each with its own rate and starts, brought to the campaign's clock: nothing is
interpolated, and decimated only where convert.toml says so."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd

from probupdate.campaign.description import Description
from probupdate.campaign.reading import suggest
from probupdate.campaign.stated import SAME_RATE, ChannelStatement, FileStatements
from probupdate.campaign.table_sources import PIECE
from probupdate.errors import InputError
from probupdate.io.result_table import plural

# what convert.toml calls the times that a file states itself
OWN_TIME = "file"
# share of a sample by which channels may start apart on one clock: 7 degrees at a fifth of the rate; said above the
# second
OFFSET, OFFSET_SAID = 0.1, 0.01
# two copies of a sample are one to single precision, in which records are written
SAME_VALUE = 1e-6
# of the decimating filter: taps on each side per output sample, middle of its flank over the new Nyquist frequency, and
# Kaiser's beta: within 0.1 % up to 0.69 of that frequency, 80 dB down above it
REACH, FLANK, BETA = 16, 0.845, 7.857


@dataclass(frozen=True, eq=False, kw_only=True)
class Segment:
    """Samples of a channel in a row: values(first, last) gives (n,) of them. start_ns: of the first, since 1970; None,
    as rate_hz, where the file does not say. moments: (size,) the time of each, where the file gives those instead."""

    path: Path
    size: int
    values: Callable[[int, int], np.ndarray]
    start_ns: int | None = None
    rate_hz: float | None = None
    moments: np.ndarray | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class LoggerChannel:
    """names: in full, then shorter ones that may not be the only ones; segments in the order of the file."""

    names: tuple[str, ...]
    stated: ChannelStatement
    segments: tuple[Segment, ...]

    @property
    def name(self) -> str:
        return self.names[0]


@dataclass(frozen=True, eq=False, kw_only=True)
class _Run:
    """Segments that follow on without a gap; parts: (first row in the run, first row in the segment, segment)."""

    channel: str
    parts: list[tuple[int, int, Segment]] = field(default_factory=list)

    @property
    def start_ns(self) -> int:
        return int(self.parts[0][2].start_ns or 0)

    @property
    def size(self) -> int:
        row, skipped, last = self.parts[-1]
        return row + last.size - skipped

    def end_ns(self, rate_hz: float) -> float:
        last = self.parts[-1][2]
        return float(last.start_ns or 0) + last.size * 1e9 / rate_hz

    def values(self, first: int, last: int) -> np.ndarray:
        """(last - first,) samples; NaN for rows outside."""
        found = np.full(last - first, np.nan)
        for row, skipped, segment in self.parts:
            a, b = max(first, row), min(last, row + segment.size - skipped)
            if a < b:
                found[a - first: b - first] = segment.values(a - row + skipped, b - row + skipped)
        return found


def join_on_one_clock(
    found: Sequence[LoggerChannel], d: Description, rate_hz: float, where: str, *, utc: bool = True
) -> Iterator:
    """FileStatements, then pieces of (times or None, data (n, n_channel)) of the channels that convert.toml names.

    utc: False where the file states local times without their zone. Raises InputError for unequal rates (but for
    `decimate`), channels whose samples lie between each other's, and overlaps that differ."""
    chosen = {channel: _choose_channel(found, column, where, d, channel) for channel, column in d.columns.items()}
    clock = None if d.time in (None, OWN_TIME) else _choose_channel(found, d.time, where, d, "time")
    own = _channel_statements(found, chosen, clock)
    if clock is not None:
        yield own
        yield from _row_by_row(clock.segments[0].values, list(chosen.values()), clock.segments[0].size)
        return
    moments = [c.segments[0].moments for c in chosen.values() if len(c.segments) == 1]
    first = moments[0] if moments else None
    if d.time == OWN_TIME and first is not None and len(moments) == len(chosen) and all(
            m is not None and np.array_equal(m, first) for m in moments):
        yield own
        yield from _row_by_row(lambda a, b: _index(first[a:b], utc), list(chosen.values()), len(first))
        return
    own_start = _refuse_start(where, d, [s for c in chosen.values() for s in c.segments])
    notes: list[str] = []
    even = {c.name: [e for s in c.segments for e in _split_at_gaps(c.name, s, d, rate_hz)] for c in chosen.values()}
    steps = _decimation(where, even, d, rate_hz)
    runs = [r for name, segments in even.items()
            for r in _join_segments(name, segments, steps[name] * rate_hz, d.overrule, notes)]
    recordings = _recordings(runs, steps, rate_hz)
    if not own_start and len(recordings) > 1:
        raise InputError(where, "has gaps that its own times locate", f'write time = "{OWN_TIME}" in convert.toml')
    placed = [_place_runs(where, recording, steps, rate_hz, d, notes) for recording in recordings]
    for name, step in steps.items():
        if step > 1:
            notes.append(f"{name}: decimated {step}:1 with zero phase, flat up to {0.345 * rate_hz:.3g} Hz; {REACH} "
                         "samples at each end and beside each gap are lost to the filter")
    yield replace(own, notes=tuple(notes))
    order = {c.name: k for k, c in enumerate(chosen.values())}
    for anchor, rows in placed:
        yield from _pieces(anchor if own_start else None, rows, order, steps, rate_hz, d, utc)


def _channel_statements(
    found: Sequence[LoggerChannel], chosen: Mapping[str, LoggerChannel], clock: LoggerChannel | None
) -> FileStatements:
    return FileStatements(channels={channel: c.stated for channel, c in chosen.items()},
                    unused=tuple(c.name for c in found if c not in (clock, *chosen.values())))


def _index(moments: np.ndarray, utc: bool) -> pd.DatetimeIndex:
    return pd.DatetimeIndex(moments.astype("datetime64[ns]"), tz="UTC" if utc else None)


def _choose_channel(
    found: Sequence[LoggerChannel], wanted: str | int, where: str, d: Description, what: str
) -> LoggerChannel:
    same = found[wanted - 1: wanted] if isinstance(wanted, int) else [c for c in found if wanted in c.names]
    if len(same) != 1:
        known = tuple(c.name for c in (same or found)[:40])
        raise InputError(f"{where}, {what}", f"{len(same) or 'no'} channels are called '{wanted}'",
                         f"{d.column_remedy(what)}; {suggest(str(wanted), known)}; files that hold a channel "
                         "each are read together by join_pattern")
    return same[0]


def _row_by_row(times: Callable[[int, int], object], chosen: Sequence[LoggerChannel], size: int) -> Iterator:
    """Channels that share the times of their samples."""
    for c in chosen:
        if len(c.segments) != 1 or c.segments[0].size != size:
            raise InputError(f"{c.segments[0].path}, {c.name}", f"has {c.segments[0].size} samples for {size} times",
                             "its sampling rate differs: leave the channel out, or name the channel of its own times")
    for first in range(0, size, PIECE):
        last = min(first + PIECE, size)
        yield times(first, last), np.column_stack([c.segments[0].values(first, last) for c in chosen])


def _refuse_start(where: str, d: Description, segments: Sequence[Segment]) -> bool:
    """Whether the file's own times are used."""
    silent = next((s for s in segments if s.start_ns is None and s.moments is None), None)
    if d.time == OWN_TIME and silent is None:
        return True
    if d.time == OWN_TIME and d.start is None and d.start_pattern is None:
        raise InputError(str(silent.path), "does not state when it starts",
                         "write start or start_pattern in convert.toml, or name its channel of times as time")
    if silent is None and "start" not in d.overrule:
        s = segments[0]
        own = int(s.moments[0]) if s.start_ns is None and s.moments is not None else s.start_ns
        raise InputError(where, f"states its own start, {pd.Timestamp(own)}, and convert.toml another",
                         f'write time = "{OWN_TIME}" in its place; where the file is wrong, overrule = ["start"]')
    return False


def _split_at_gaps(name: str, segment: Segment, d: Description, rate_hz: float) -> Iterator[Segment]:
    """The segment itself, or those into which the gaps of its times cut it."""
    moments = segment.moments
    if moments is None or len(moments) < 2:
        rate = segment.rate_hz if segment.rate_hz and "rate" not in d.overrule else None
        yield Segment(path=segment.path, size=segment.size, values=segment.values, rate_hz=rate or rate_hz,
                      start_ns=segment.start_ns if moments is None else int(moments[0]))
        return
    step = np.diff(moments)
    usual = float(np.median(step))
    if usual <= 0 or step.min() <= 0:
        raise InputError(f"{segment.path}, {name}", "its times do not advance",
                         "correct them, or leave the channel out")
    edges = [0, *(np.flatnonzero(step > 1.5 * usual) + 1), len(moments)]
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        rate = 1e9 * (b - a - 1) / float(moments[b - 1] - moments[a]) if b - a > 1 else 1e9 / usual
        off = np.abs(moments[a:b] - moments[a] - np.arange(b - a) * 1e9 / rate).max() * rate / 1e9
        if off > OFFSET and "offset" not in d.overrule:
            raise InputError(f"{segment.path}, {name}", f"its times are uneven by {off:.2g} samples and not those of "
                             "the other channels", "export them at common sample times: nothing is interpolated")
        yield Segment(path=segment.path, size=int(b - a), rate_hz=rate, start_ns=int(moments[a]),
                      values=lambda i, j, a=a: segment.values(a + i, a + j))


def _decimation(where: str, even: dict[str, list[Segment]], d: Description, rate_hz: float) -> dict[str, int]:
    """Channel -> how many of its samples make one of the campaign's. Raises InputError where that is not a whole
    number, or decimation is not asked for."""
    rates = {name: float(np.median([s.rate_hz for s in segments])) for name, segments in even.items()}
    steps = {name: max(round(rate / rate_hz), 1) for name, rate in rates.items()}
    fits = all(abs(s.rate_hz / (steps[name] * rate_hz) - 1) <= SAME_RATE
               for name, segments in even.items() for s in segments)
    if fits and (d.decimate or max(steps.values()) == 1):
        return steps
    groups: dict[str, list[str]] = {}
    for name, segments in even.items():
        for text in dict.fromkeys(f"{s.rate_hz:g} Hz" for s in segments):
            groups.setdefault(text, []).append(name)
    said = "; ".join(f"{', '.join(names[:4])} {'...' if len(names) > 4 else ''}{text}"
                     for text, names in groups.items())
    slow = [name for name, rate in rates.items() if rate < rate_hz * (1 - SAME_RATE)]
    lowest = min(rates.values())
    multiples = all(abs(r / lowest / round(r / lowest) - 1) <= SAME_RATE for r in rates.values())
    remedy = ("write decimate = true in convert.toml (zero phase), or the file's rate as sampling_rate_hz" if fits else
              f"take {', '.join(slow)} out of campaign.toml" + (
                  ", or write the slowest rate as sampling_rate_hz and decimate = true in convert.toml (zero phase)"
                  if multiples else "") + "; nothing is interpolated" if slow else
              "write a rate as sampling_rate_hz of which all are whole multiples, and decimate = true in convert.toml "
              '(zero phase); where the file\'s rate is wrong, overrule = ["rate"]')
    kind = "holds channels of unequal rates" if len(groups) > 1 else "states another rate"
    raise InputError(where, f"{kind}: {said}; campaign.toml says {rate_hz:g} Hz", remedy)


# Runs without a gap -------------------------------------------------------------------------------------------------


def _join_segments(
    name: str, segments: Sequence[Segment], rate_hz: float, overruled: Sequence[str], notes: list[str]
) -> list[_Run]:
    """Segments of a channel, at rate_hz, in the order of their starts; what two of them hold once."""
    runs: list[_Run] = []
    twice = 0
    for s in sorted((s for s in segments if s.size), key=lambda s: s.start_ns or 0):
        run = runs[-1] if runs else None
        ahead = np.inf if run is None else ((s.start_ns or 0) - run.end_ns(rate_hz)) * rate_hz / 1e9
        if run is None or ahead > 0.5:
            runs.append(_Run(channel=name, parts=[(0, 0, s)]))
            continue
        shared = max(round(-ahead), 0)
        if shared:
            if "overlap" not in overruled:
                _refuse_differing(run, s, shared)
            twice += min(shared, s.size)
        if shared < s.size:
            run.parts.append((run.size, shared, s))
    for run in runs:
        row, skipped, last = run.parts[-1]
        off = ((last.start_ns or 0) - run.start_ns) * rate_hz / 1e9 - (row - skipped)
        far = max(abs(off), *(abs(s.rate_hz / rate_hz - 1) * s.size for _, _, s in run.parts)) if rate_hz else 0.0
        if far > 0.5 and far > SAME_VALUE * run.size:
            own = rate_hz * (row - skipped) / (row - skipped + off) if abs(off) > 0.5 else last.rate_hz
            raise InputError(f"{last.path}, {name}", f"its samples come at {own:.9g} Hz without a gap, campaign.toml "
                             f"says {rate_hz:g} Hz", "write that rate into campaign.toml, if the times are right")
    words = "; the one that starts first is used" if "overlap" in overruled else ", agree and were joined"
    if twice:
        notes.append(f"{name}: {plural(twice, 'sample')} stand twice{words}")
    return runs


def _refuse_differing(run: _Run, s: Segment, shared: int) -> None:
    first = run.size - shared
    count = min(shared, s.size)
    one, other = run.values(first, first + count), s.values(0, count)
    scale = np.nanmax(np.abs([one, other]), initial=0.0)
    same = (np.abs(one - other) <= SAME_VALUE * scale) | (np.isnan(one) & np.isnan(other))
    if not same.all():
        before = next(p for row, skipped, p in reversed(run.parts) if row <= first)
        raise InputError(f"{s.path}, {run.channel}",
                         f"overlaps {before.path} by {plural(count, 'sample')} from {pd.Timestamp(s.start_ns)} and "
                         f"differs from it in {int(np.sum(~same))}", "keep the right one of the two, or write "
                         'overrule = ["overlap"] in convert.toml, which uses the one that starts first')


def _recordings(runs: Sequence[_Run], steps: dict[str, int], rate_hz: float) -> list[list[_Run]]:
    """Runs of all channels that overlap or follow on, in order."""
    found: list[list[_Run]] = []
    end = -np.inf
    for run in sorted(runs, key=lambda r: r.start_ns):
        if run.start_ns > end + 0.5e9 / rate_hz:
            found.append([])
        found[-1].append(run)
        end = max(end, run.end_ns(steps[run.channel] * rate_hz))
    return found


def _place_runs(
    where: str, recording: Sequence[_Run], steps: dict[str, int], rate_hz: float, d: Description, notes: list[str]
):
    """(start_ns, [(run, its first sample in steps of its own rate)]); the samples of channels that are not decimated
    give the clock."""
    reference = min(recording, key=lambda r: (steps[r.channel], r.start_ns))
    places, most, off_most = [], 0.0, reference
    for run in recording:
        fine = steps[run.channel]
        place = (run.start_ns - reference.start_ns) * fine * rate_hz / 1e9
        off = abs(place - round(place)) / fine
        if off > most:
            most, off_most = off, run
        places.append(round(place))
    said = (f"samples of {off_most.channel} lie {most:.2f} samples ({1e3 * most / rate_hz:.3g} ms) from those of "
            f"{reference.channel}")
    if most > OFFSET and "offset" not in d.overrule:
        raise InputError(where, said, "resample the channel to the other's clock first, or take the nearest sample by "
                         'overrule = ["offset"] in convert.toml')
    if most > OFFSET_SAID:
        notes.append(f"{said}; the nearest was taken")
    earliest = min(-(-place // steps[r.channel]) for r, place in zip(recording, places, strict=True))
    anchor = reference.start_ns + round(earliest * 1e9 / rate_hz)
    return anchor, [(r, place - earliest * steps[r.channel]) for r, place in zip(recording, places, strict=True)]


def _pieces(anchor: int | None, rows, order, steps, rate_hz: float, d: Description, utc: bool) -> Iterator:
    n_row = max(-(-(place + run.size) // steps[run.channel]) for run, place in rows)
    length = max(PIECE // max(steps.values()), 1000)
    for first in range(0, n_row, length):
        last = min(first + length, n_row)
        data = np.full((last - first, len(order)), np.nan)
        for run, place in rows:
            step = steps[run.channel]
            found = _decimate_run(run, place, step, first, last, d) if step > 1 else run.values(first - place,
                                                                                                last - place)
            column = data[:, order[run.channel]]
            np.copyto(column, found, where=np.isfinite(found))
        since = np.round(np.arange(first, last) * (1e9 / rate_hz)).astype(np.int64)
        yield (None if anchor is None else _index(anchor + since, utc)), data


def _decimate_run(run: _Run, place: int, step: int, first: int, last: int, d: Description) -> np.ndarray:
    """Every step-th sample of the run, low-pass filtered by a symmetric filter; NaN where it reaches what is lost."""
    from scipy import signal

    reach = REACH * step
    taps = signal.firwin(2 * reach + 1, FLANK / step, window=("kaiser", BETA))
    values = run.values(first * step - place - reach, (last - 1) * step - place + reach + 1)
    markers = [v for v in d.lost if not isinstance(v, str)]
    values = np.where(np.isin(values, markers), np.nan, values)
    return signal.upfirdn(taps, values, 1, step)[2 * REACH: 2 * REACH + last - first]
