"""Samples that were not measured: lost ones, values that a converter or a radio repeated, straight lines over gaps.

A number that stands in a file need not be a sample. A converter slower than the table repeats its values, a radio that
loses a packet sends the last one again, or a zero, and who exports a record may draw straight lines over what is
missing.
"""

from __future__ import annotations

import numpy as np

# values equal to the one before (or on the line between their neighbours) are no chance where they are so many, and so
# many times more than those that miss it by the next step of the converter
FEWEST, PILE = 20, 10.0
# rounding of four-byte numbers, as a share of the largest
ROUNDING = 4e-7
# one value for longer is a sensor that stands still, a finding of its own
LONGEST_REPEAT_S, LONGEST_REPEAT = 1.0, 20
# a channel of which more lies on lines was made so, and is not a record with gaps
MOST_FILLED = 0.9
# smallest step of a converter, in standard deviations of the record, from which lines are no sign of anything
COARSE = 0.05
# of so many samples one is looked at before all are
EACH = 12
# samples among which a number that stands for lost ones is looked for, and the largest share that may be lost so
LOOKED_AT, MOST_MARKED = 2500, 0.5
# a number so many robust standard deviations away that stands so often, and is reached from near the middle, is none
# that a sensor measured
FAR, OFTEN, NEAR = 30.0, 3, 0.3
# one so many times above what surrounds it within half a second is none either: an impact rings, a logger does not
ALONE = 4.0


def runs(flags: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Starts and ends (one past the last) of the runs of True in (n,) bool."""
    edge = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return edge[::2], edge[1::2]


def suspected_columns(data: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Columns of data (n, n_channel) worth a look by `find_repeated` and by `find_filled`, in one quick pass each; a
    twelfth of a record is enough to see whether any samples lie on lines."""
    again = np.count_nonzero(data[1:] == data[:-1], axis=0) >= FEWEST
    kink = np.abs(data[2::EACH] - 2 * data[1:-1:EACH] + data[:-2:EACH])
    return np.flatnonzero(again), np.flatnonzero((kink <= ROUNDING * np.abs(data[1:-1:EACH])).any(axis=0))


def with_markers(data: np.ndarray) -> np.ndarray:
    """Columns of data (n, n_channel) worth a look by `markers`, in one quick pass."""
    if len(data) < 2 * FEWEST:
        return np.zeros(0, int)
    # those that are lost come last
    some = np.sort(np.ascontiguousarray(data[:: max(len(data) // LOOKED_AT, 1)].T))
    often = (some[:, FEWEST - 1:] == some[:, : some.shape[1] - FEWEST + 1]).any(axis=1)
    known = np.count_nonzero(some == some, axis=1)
    place = (np.array([[1], [2], [3]]) * known // 4).clip(max=some.shape[1] - 1)
    quarter, middle, upper = some[np.arange(len(some)), place]
    # of rows side by side, which is one pass through memory
    wide = data[: len(data) // EACH * EACH].reshape(-1, EACH * data.shape[1])
    high, low = (of.reduce(wide, axis=0).reshape(EACH, -1) for of in (np.fmax, np.fmin))
    away = np.maximum(np.fmax.reduce(high, axis=0) - middle, middle - np.fmin.reduce(low, axis=0))
    # of a normal distribution the quartiles lie 1.35 standard deviations apart
    return np.flatnonzero(often | ~(away <= FAR * (upper - quarter) / 1.35))


def markers(column: np.ndarray) -> list[float]:
    """Numbers that stand for lost samples in column (n,), NaN where lost: one that is far more frequent than those next
    to it, and one far outside that comes again and again, as 0 and -9999. What a record is clipped at is neither."""
    known = column[np.isfinite(column)]
    some = known[:: max(len(known) // LOOKED_AT, 1)]
    if len(some) < 2 * FEWEST:
        return []
    low, high = float(known.min()), float(known.max())
    middle = float(np.median(some))
    spread = 1.4826 * float(np.median(np.abs(some - middle)))
    found = [x for x in (low, high) if abs(x - middle) > FAR * spread > 0 and _has_repeated_jumps(known, x, middle)]
    value, count = np.unique(some[~np.isin(some, found)], return_counts=True)
    if len(value) < FEWEST or np.diff(value).min() > COARSE * np.std(value):
        return found
    k = int(np.argmax(count))
    usual = count[max(k - 1, 0): k + 2].sum() - count[k]
    if count[k] >= FEWEST and PILE * usual < count[k] <= MOST_MARKED * len(some) and (
            value[k] not in (low, high) or _has_repeated_jumps(known, value[k], middle)):
        found.append(float(value[k]))
    return found


def _has_repeated_jumps(known: np.ndarray, value: float, middle: float) -> bool:
    """Whether the record stands at a value several times, coming from near its middle."""
    at = known == value
    starts, _ = runs(at)
    before = known[starts[starts > 0] - 1]
    return bool(np.count_nonzero(at) >= OFTEN and len(before)
                and np.median(np.abs(before - middle)) < NEAR * abs(value - middle))


def lone_samples(column: np.ndarray, rate_hz: float) -> np.ndarray:
    """(n,) bool: samples of column (n,), NaN where lost, that stand alone far from its middle."""
    known = column[np.isfinite(column)]
    return find_lone_samples(np.abs(column - np.median(known)) if len(known) else column, rate_hz, 1)


def find_lone_samples(size: np.ndarray, rate_hz: float, margin: int, least_std: float = FAR) -> np.ndarray:
    """(n,) bool: of size (n,), NaN where lost, those of so many robust standard deviations that nothing within half a
    second comes near, `margin` samples to each side left out."""
    found = np.zeros(len(size), bool)
    finite = size[np.isfinite(size)]
    spread = 1.4826 * float(np.median(finite)) if len(finite) else 0.0
    if spread <= 0:
        return found
    reach = max(int(rate_hz / 2), 3)
    with np.errstate(invalid="ignore"):
        candidates = np.flatnonzero(size > least_std * spread)
    # a record full of them is not a record with spikes
    for k in candidates[:1000]:
        if k > 0 and size[k - 1] > size[k]:
            continue
        around = np.concatenate([size[max(k - reach, 0): max(k - margin, 0)], size[k + 1 + margin: k + reach]])
        around = around[np.isfinite(around)]
        found[k] = len(around) > 0 and size[k] > ALONE * around.max()
    return found


def find_repeated(column: np.ndarray, rate_hz: float) -> np.ndarray:
    """(n,) bool: samples that only repeat the one before; column (n,), NaN where lost.

    Steps of zero are held against those of the smallest size there is: a coarse converter has both. What stands at the
    record's largest or smallest value is clipped, and what stands for a second stands still: neither is a repeat.
    """
    none = np.zeros(len(column), bool)
    step = np.abs(np.diff(column))
    if np.count_nonzero(step == 0) < FEWEST or not _is_beyond_chance(step, 0.0):
        return none
    same = np.concatenate([[False], step == 0])
    same &= (column != np.nanmax(column)) & (column != np.nanmin(column))
    starts, ends = runs(same)
    for a, b in zip(starts, ends, strict=True):
        if b - a >= max(LONGEST_REPEAT_S * rate_hz, LONGEST_REPEAT):
            same[a:b] = False
    return same


def find_filled(column: np.ndarray) -> np.ndarray:
    """(n,) bool: samples on the straight line between their neighbours, beyond chance; column (n,), NaN where lost."""
    none = np.zeros(len(column), bool)
    if len(column) < 3:
        return none
    step = np.diff(column)
    kink = np.abs(np.diff(step))
    # a value that stands, or is a repeat, lies on no line that anybody drew
    kink[(step[:-1] == 0) | (step[1:] == 0)] = np.nan
    tolerance = ROUNDING * float(np.nanmax(np.abs(column), initial=0.0))
    size = np.abs(step[np.abs(step) > tolerance])
    # on few levels many samples lie on lines
    if not len(size) or size.min() > COARSE * np.nanstd(column):
        return none
    on = kink <= tolerance
    count = np.count_nonzero(on)
    if not FEWEST <= count <= MOST_FILLED * len(column) or not _is_beyond_chance(kink, tolerance):
        return none
    return np.concatenate([[False], on, [False]])


def _is_beyond_chance(size: np.ndarray, tolerance: float) -> bool:
    """Whether far more of `size` are within the tolerance of zero than at the smallest size beyond it."""
    known = size[np.isfinite(size)]
    beyond = known[known > tolerance]
    if not len(beyond):
        return False
    near = np.count_nonzero(beyond <= 1.5 * beyond.min())
    return bool(len(known) - len(beyond) > PILE * near and near < 0.5 * len(beyond))


def zero_filled(piece: np.ndarray) -> np.ndarray:
    """piece (n, n_channel) about its mean, zero where a sample is missing, and divided by the share that was measured:
    cross-spectra with other channels are right on average, and what was lost is noise of the channel's own."""
    known = np.isfinite(piece)
    if known.all():
        return piece - piece.mean(axis=0)
    share = np.maximum(known.mean(axis=0), 1 / len(piece))
    centred = np.where(known, piece, 0.0)
    centred -= centred.mean(axis=0) / share
    return np.where(known, centred, 0.0) / share


def fill_short_gaps(data: np.ndarray, longest: int) -> tuple[np.ndarray, np.ndarray]:
    """data (n, n_channel) with straight lines over gaps of up to `longest` samples, values held at the ends; and
    (n_channel,) the longest gap left, 0 for none. For what needs a whole record and says so."""
    found, left = np.array(data), np.zeros(data.shape[1], int)
    for c in np.flatnonzero(~np.isfinite(data).all(axis=0)):
        lost = ~np.isfinite(data[:, c])
        starts, ends = runs(lost)
        short = ends - starts <= longest
        left[c] = int(np.max((ends - starts)[~short], initial=0))
        good = np.flatnonzero(~lost)
        if len(good):
            drawn = np.zeros(len(lost), bool)
            for a, b in zip(starts[short], ends[short], strict=True):
                drawn[a:b] = True
            found[drawn, c] = np.interp(np.flatnonzero(drawn), good, data[good, c])
    return found, left
