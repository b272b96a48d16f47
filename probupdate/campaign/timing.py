"""Times of a source's rows: what they mean, whether they are regular, where each row goes on the campaign's clock."""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import ndimage

from probupdate.campaign.description import DAY_NUMBERS, TIME_UNITS, Description
from probupdate.errors import InputError
from probupdate.io.result_table import plural

# rates as near are one; a quartz differs by a hundredth of it
RATE_TOLERANCE = 1e-3
# rows more than so far from where they should be, in samples, are a gap or irregular
OFF = 0.75
# where rows come at an even pace, the rate of rows over span may differ by this: beyond any quartz
DRIFT_TOLERANCE = 1.5e-4
# an even pace leaves so many samples about a line at most; rows of a running median, which jitter does not move; points
# of a short source
EVEN, AROUND, FEWEST = 1.5, 15, 8
# standard deviation of the steps, in samples, from which it is said, and beyond which a source is refused
UNEVEN_SAID, UNEVEN = 0.05, 0.3
# seconds from 1970 that 64 bits of nanoseconds hold: 1678 to 2261
MOST_S = 9.2e9
# seconds from 1970 before which no record was made: what counts less has another origin
FIRST_S = 3.1e7


def file_clock(path: Path, described: Description, rate_hz: float) -> Clock:
    """The clock of one source; its start from the description or the file's name."""
    start = None
    if described.start is not None:
        start = _localise_time(_parse_time(described.start, f"{described.path}, start"), described,
                               f"{described.path}, start")
    elif described.start_pattern is not None:
        found = re.search(described.start_pattern, path.name)
        if found is None:
            raise InputError(str(path), f"its name does not hold '{described.start_pattern}'",
                             "correct start_pattern or files")
        start = _localise_time(_parse_name(found[1], described, path), described, str(path))
    return Clock(path, described, rate_hz, start)


def _parse_time(text: str, where: str) -> pd.Timestamp:
    try:
        time = pd.Timestamp(text)
    except ValueError:
        time = pd.NaT
    if time is pd.NaT:
        raise InputError(where, f"'{text}' is not a time", "write ISO 8601, such as 2019-06-03T10:00:00")
    return time


def _parse_name(text: str, described: Description, path: Path) -> pd.Timestamp:
    if described.start_format is None:
        return _parse_time(text, str(path))
    try:
        return pd.Timestamp(datetime.strptime(text, described.start_format))
    except ValueError as error:
        raise InputError(str(path), f"'{text}' is not of start_format '{described.start_format}' ({error})",
                         "see the codes of strptime") from None


def _missing_zone(where: str, described: Description) -> InputError:
    return InputError(where, "its time zone is not stated", f'add it to {described.path}, such as zone = "UTC"')


def _localise_time(time: pd.Timestamp, described: Description, where: str) -> pd.Timestamp:
    if time.tzinfo is not None:
        return time.tz_convert("UTC").as_unit("ns")
    if described.zone is None:
        raise _missing_zone(where, described)
    try:
        return time.tz_localize(described.zone).tz_convert("UTC").as_unit("ns")
    except ValueError as error:
        # the hour that is there twice, or never, when clocks change
        raise InputError(where, f"is not a single moment in that zone ({error})", "give times in UTC") from None


class Clock:
    """Places rows: `placed` yields (start of a new chunk or None, rows), gaps filled with NaN or cut."""

    def __init__(self, path: Path, described: Description, rate_hz: float, start: pd.Timestamp | None):
        self.path, self.described, self.rate, self.start = path, described, rate_hz, start
        self.anchor: int | None = None  # nanoseconds of the current chunk's first row
        self.next_row = 0  # rows of it so far
        self.first_row = 0  # rows of the source so far
        self.last_ns: int | None = None
        self.grain = 0.0  # what the times are rounded to, in samples, where that is coarse
        self.late = 0.0  # samples by which the last row's time is later than its number says
        self.origin: tuple[int, int] | None = None  # of rounded times: nanoseconds and row at which they first change
        self.held: tuple[np.ndarray, np.ndarray] | None = None  # rows of the last ones
        self.filled = self.cuts = self.shifts = self.unknown = self.twice = 0
        self.uneven = 0.0
        self.points: list[tuple[int, int, int]] = []  # row, its nanoseconds, rows that are missing up to it
        self.before, self.missing = 0, 0.0  # nanoseconds of the last row, rows that are missing up to it

    def place(
        self, time: np.ndarray | pd.DatetimeIndex | None, data: np.ndarray
    ) -> Iterator[tuple[pd.Timestamp | None, np.ndarray]]:
        if time is None:
            new = self.start if self.first_row == 0 else None
            self.first_row += len(data)
            yield new, data
            return
        if not len(data):
            return
        moment, data = self._without_doubles(self._nanoseconds(time), data)
        self._inspect(moment)
        self._pace(moment)
        self.first_row += len(data)
        if not self.grain:
            yield from self._runs(moment, data)
            return
        if self.held is not None:
            moment, data = (np.concatenate(pair) for pair in zip(self.held, (moment, data), strict=True))
        whole = int(np.flatnonzero(np.diff(moment, prepend=moment[0] - 1))[-AROUND:][0])
        yield from self._between_stamps(moment, data, whole)
        self.held = moment[whole:], data[whole:]

    def finish(self) -> Iterator[tuple[pd.Timestamp | None, np.ndarray]]:
        """What `place` still holds when the source has ended."""
        if self.held is not None:
            yield from self._between_stamps(*self.held, len(self.held[1]))

    def notes(self) -> list[str]:
        said = []
        if self.filled:
            said.append(f"{self.filled} missing rows filled with NaN")
        if self.cuts:
            said.append(f"{plural(self.cuts, 'gap')} longer than {self.described.fill_seconds:g} s, each begins "
                        "another file")
        if self.shifts:
            said.append(f"its clock and the stated rate drift by one sample {self.shifts} times; a file begins at each")
        if self.uneven > UNEVEN_SAID:
            said.append(f"its steps are uneven by {self.uneven:.2f} samples (standard deviation); "
                        "rows were put at equal steps")
        if self.grain:
            said.append(f"times are rounded to {self.grain / self.rate:.3g} s; rows were counted between them")
        if self.twice:
            said.append(f"{self.twice} rows stand twice, with the same time and values: one of each was used")
        if self.unknown:
            said.append(f"{self.unknown} rows have the rounded time of rows that are missing: where they belong is not "
                        "known, and they count as lost")
        return said

    def _without_doubles(self, moment: np.ndarray, data: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where every row that has the time of the one before has its values too; rounded times have others."""
        at_once = np.diff(moment) == 0
        like = ((data[1:] == data[:-1]) | (np.isnan(data[1:]) & np.isnan(data[:-1]))).all(axis=1)
        if not at_once.any() or not like[at_once].all():
            return moment, data
        self.twice += int(at_once.sum())
        kept = np.append(True, ~at_once)
        return moment[kept], data[kept]

    def _nanoseconds(self, time: np.ndarray | pd.DatetimeIndex) -> np.ndarray:
        """(n,) int64 since 1970 UTC."""
        where, described = f"{self.path}, time", self.described
        if isinstance(time, pd.DatetimeIndex):
            return self._to_utc(time, where)
        if np.asarray(time).dtype.kind in "iuf" and described.time_format is None:
            value = np.asarray(time, float)
            if not np.isfinite(value).all():
                raise InputError(where, f"row {self._row(~np.isfinite(value))} has no time", "drop it or give its time")
            if described.time_unit == "iso":
                raise InputError(where, "holds numbers, and time_unit is not stated",
                                 f"add time_unit, one of {', '.join((*TIME_UNITS, *DAY_NUMBERS))}")
            origin, unit, offset = 0.0, 86400.0, None
            if described.time_unit in DAY_NUMBERS:
                origin = DAY_NUMBERS[described.time_unit]
            else:
                unit, offset = TIME_UNITS[described.time_unit], self.start
                if offset is None and 0 <= value[0] * unit < FIRST_S:
                    raise InputError(where,
                                     f"its first value is {value[0]:g} {described.time_unit}: it counts from the "
                                     "beginning of the record, which is not stated",
                                     f'add start to {described.path}, such as start = "2024-05-01T00:00:00Z"')
            if offset is None and described.zone is None:
                raise _missing_zone(where, described)
            wrong = np.abs(value - origin + (0.0 if offset is None else offset.value / 1e9 / unit)) > MOST_S / unit
            if wrong.any():
                first = f"row {self._row(wrong)} has {value[wrong][0]:g}, which is not a plausible date"
                raise InputError(where, first, "check time_unit, or drop the row")
            seconds = (value - origin) * unit
            whole = np.floor(seconds)
            since = whole.astype(np.int64) * 10**9 + np.round((seconds - whole) * 1e9).astype(np.int64)
            if offset is not None:
                return since + offset.value
            return self._to_utc(pd.DatetimeIndex(since.astype("datetime64[ns]")), where)
        form = described.time_format or "ISO8601"
        try:
            texts = pd.Series(time)
            index = pd.DatetimeIndex(pd.to_datetime(texts.astype(str) if described.time_format else texts, format=form))
        except (ValueError, TypeError) as error:
            raise InputError(where, f"is not a time ({str(error).splitlines()[0].partition('. You')[0]})",
                             "write ISO 8601, numbers with time_unit, or state time_format, such as "
                             "\"%d.%m.%Y %H:%M:%S.%f\", in convert.toml") from None
        if index.hasnans:
            row = self._row(np.asarray(index.isna()))
            raise InputError(where, f"row {row} has no time", "drop it or give its time")
        moment = self._to_utc(index, where)
        if moment[0] < FIRST_S * 1e9:
            raise InputError(where, f"row {self.first_row + 1} is of {index[0]:%Y}, when nothing was recorded: a time "
                             "of day without its date?",
                             "write the date into the same column, or leave time out and state start or start_pattern, "
                             'such as start = "2024-05-01T00:00:00Z"')
        return moment

    def _to_utc(self, index: pd.DatetimeIndex, where: str) -> np.ndarray:
        try:
            index = index.as_unit("ns")
        except ValueError as error:
            raise InputError(where, f"is not a plausible date ({str(error).splitlines()[0]})",
                             "drop the row or correct its time") from None
        if index.tz is None:
            if self.described.zone is None:
                raise _missing_zone(where, self.described)
            try:
                index = index.tz_localize(self.described.zone)
            except ValueError as error:
                raise InputError(where, f"is not a single moment in that zone ({str(error).splitlines()[0]})",
                                 "give times in UTC") from None
        return index.tz_convert("UTC").asi8

    def _row(self, wrong: np.ndarray) -> int:
        return self.first_row + int(np.argmax(wrong)) + 1

    def _inspect(self, moment: np.ndarray) -> None:
        """Refuse what is not regular: rows that go back, another rate, steps of all lengths."""
        previous = moment if self.last_ns is None else np.concatenate([[self.last_ns], moment])
        step = np.diff(previous)
        back = step < 0
        if back.any():
            offset = 2 if self.last_ns is None else 1
            row = self.first_row + int(np.argmax(back)) + offset
            raise InputError(f"{self.path}, time", f"row {row} is earlier than the one before",
                             "sort the rows; local time runs back in autumn: give UTC")
        self.last_ns = int(moment[-1])
        if len(step) < 2:
            return
        same = float(np.mean(step == 0))
        sample = 1e9 / self.rate
        if same > 0.05:
            self.grain = max(self.grain, float(np.median(step[step > 0])) / sample if (step > 0).any() else 0.0)
            if not self.grain:
                raise InputError(f"{self.path}, time", "does not advance", "give the time of each row")
            return
        usual = step < 1.5 * sample
        if usual.mean() < 0.05:
            raise InputError(f"{self.path}, time", f"rows come every {np.median(step) / 1e9:.6g} s, campaign.toml says "
                             f"{1 / self.rate:.6g}", self._rate_remedy(1e9 / float(np.median(step))))
        uneven, least = float(np.std(step[usual] / sample)), float(step[step > 0].min())
        if uneven > UNEVEN and uneven < 0.5 * least / sample and np.ptp((step / least + 0.5) % 1) < UNEVEN_SAID:
            # as rounding to whole multiples of the least step makes them
            self.grain = max(self.grain, least / sample)
            return
        self.uneven = max(self.uneven, uneven)
        if uneven > UNEVEN:
            raise InputError(f"{self.path}, time", f"is irregular: its steps deviate by {uneven:.2f} samples",
                             "resample to equal steps first: this is not done silently")

    def _rate_remedy(self, rate_hz: float) -> str:
        stated = TIME_UNITS.get(self.described.time_unit)
        unit = next((name for name, s in TIME_UNITS.items()
                     if stated not in (None, s) and abs(self.rate / rate_hz * s / stated - 1) < RATE_TOLERANCE), "")
        if unit:
            return f'write time_unit = "{unit}" in convert.toml, if the times count in it'
        return f"write sampling_rate_hz = {rate_hz:.8g} into campaign.toml, if the times are right"

    def _pace(self, moment: np.ndarray) -> None:
        """Refuse a source whose rows come at an even pace of another rate: rows, rate and span decide, also where rows
        are missing. Where times are rounded down, the rows at which they change are known to a sample."""
        step = np.diff(moment, prepend=moment[0] if not self.points else self.before) * self.rate / 1e9
        # rows that are missing for all to see count
        usual = np.median(step[step < 1.5]) if (step < 1.5).any() else 1.0
        seen = np.where((step > 1.5 + 2 * self.uneven) & (not self.grain), np.round(step / max(usual, 0.5)) - 1, 0.0)
        missing = self.missing + np.cumsum(seen)
        self.before, self.missing = int(moment[-1]), float(missing[-1])
        rows = np.flatnonzero(np.diff(moment)) + 1 if self.grain else np.arange(len(moment))
        rows = rows[:: max(min(round(self.rate / (self.grain or 1.0)), len(rows) // FEWEST), 1)]
        self.points += [(self.first_row + int(k), int(moment[k]), int(missing[k])) for k in rows]
        if len(self.points) < 3:
            return
        number, time, missing = np.array(self.points, dtype=np.int64).T
        seconds, place = (time - time[0]) / 1e9, number + missing
        count, took = np.diff(place), np.diff(seconds)
        if not took.min() > 0 or (missing[-1] and self.uneven > UNEVEN_SAID) or abs(
                np.ptp(number) - self.rate * seconds[-1]) <= EVEN + self.uneven:
            # as many rows as their span asks for; how many are missing times that jitter do not say
            return
        # one slope, and another start after each loss
        section = np.append(0, np.cumsum(np.abs(count - np.median(count / took) * took) > EVEN + self.uneven))
        x, y = (v - (np.bincount(section, v) / np.bincount(section))[section] for v in (seconds, place - place[0]))
        slope = float(x @ y) / max(float(x @ x), 1e-9)
        # of one section its seconds
        length = float(np.sqrt(12 * (x @ x) / len(x) * (1 + section[-1])))
        drift = abs(slope / self.rate - 1)
        if np.quantile(np.abs(y - slope * x), 0.9) > 0.5 + self.uneven or drift < DRIFT_TOLERANCE or (
                drift * self.rate * length < 2 * EVEN):
            return
        # known to half a row over the span
        rate = next((r for r in (round(slope, k) for k in range(9)) if abs(r - slope) * length <= 0.5), slope)
        whole = section[-1] == 0 and missing[-1] == 0
        raise InputError(f"{self.path}, time", f"{np.ptp(number)} rows in {seconds[-1]:.6g} s come at "
                         f"{rate:.8g} Hz {'without a gap' if whole else 'between those that are missing'}, "
                         f"campaign.toml says {self.rate:.6g} Hz", self._rate_remedy(rate))

    def _between_stamps(self, moment: np.ndarray, data: np.ndarray, size: int) -> Iterator:
        """The first `size` rows by times of their own, counted between rounded ones. Rows of a rounded time that lacks
        some, for good, are lost: which of its rows are missing is not known."""
        first = np.flatnonzero(np.diff(moment, prepend=moment[0] - 1))
        if self.origin is None:
            if len(first) < 2:
                return
            self.origin = int(moment[first[1]]), int(first[1])
        sample, number = 1e9 / self.rate, self.first_row - len(moment) + first
        late = (moment[first] - self.origin[0]) / sample - (number - self.origin[1])
        if number[0] == 0:
            late[0] = late[1]
        # times that jitter come back, rows that are missing do not
        late = ndimage.minimum_filter1d(late, AROUND, origin=-(AROUND // 2), mode="nearest")
        lost = np.append(np.diff(late) > 0.5, False)
        stamp = np.repeat(np.arange(len(first)), np.diff(np.append(first, len(moment))))[:size]
        self.unknown += int(np.sum(lost[stamp]))
        own = number[0] + np.arange(size) - self.origin[1] + late[stamp]
        yield from self._runs(self.origin[0] + np.round(own * sample).astype(np.int64),
                              np.where(lost[stamp][:, None], np.nan, data[:size]))

    def _runs(self, moment: np.ndarray, data: np.ndarray) -> Iterator[tuple[pd.Timestamp | None, np.ndarray]]:
        """Cut where time leaves the count of rows by more than OFF samples: NaN for rows that are missing, another file
        after a long gap or where a clock drifts."""
        if not len(data):
            return
        sample = 1e9 / self.rate
        own = (moment - moment[0]) / sample - np.arange(len(data))
        if self.uneven > UNEVEN_SAID:
            # a single time that is off is no gap: the count of rows goes on
            own = ndimage.median_filter(own, AROUND, mode="nearest")
        at = 0
        while at < len(data):
            new = None
            if self.anchor is None:
                self.anchor, self.next_row = int(moment[0] + round((own[at] + at) * sample)), 0
                new = pd.Timestamp(self.anchor, tz="UTC")
            late = own[at:] + ((moment[0] - self.anchor) / sample + at - self.next_row)
            # where two rounded times are as near, either is written
            leaving = (late > OFF) | (late < -OFF - (0.5 if self.grain else 0.0))
            stop = at + int(np.argmax(leaving)) if leaving.any() else len(data)
            if stop > at or new is not None:
                stop = max(stop, at + 1)
                yield new, data[at:stop]
                self.late = float(late[stop - at - 1])
                self.next_row += stop - at
                at = stop
                continue
            gap = float(late[0])
            jump = own[at] - own[at - AROUND] if at >= AROUND else gap - self.late
            if gap > OFF and jump > 0.5 and gap / self.rate <= self.described.fill_seconds:
                missing = round(gap)
                self.filled += missing
                yield None, np.full((missing, data.shape[1]), np.nan)
                self.next_row += missing
                continue
            self.cuts += gap / self.rate > self.described.fill_seconds
            self.shifts += gap / self.rate <= self.described.fill_seconds
            self.anchor = None
