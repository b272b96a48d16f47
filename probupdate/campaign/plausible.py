"""Records that are none of the channel they stand for: a column of time, or numbers in another unit than the stated
one."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from probupdate.campaign.blocks import Block
from probupdate.campaign.gaps import zero_filled
from probupdate.errors import InputError
from probupdate.modal.modes import Sensor

# a column that rises or falls steadily leaves less than this share of its range about a straight line; so many samples
# of it are looked at first
STRAIGHT, LOOKED_AT, FEWEST = 1e-4, 257, 20
# amplitude spectrum of a channel over those of its like, in the middle over all frequencies and blocks: sensors of one
# structure keep within a factor of 2.5 (18 channels of a jacket and its tower, 5 of a frame), g and m/s2 are 9.8 apart
MIDDLE_FACTOR = 4.0
# and it is so over most octaves, as a point that one mode hardly moves is moved by the others, and a tower's middle
# moves more than its ends at all frequencies from its second bending on
MOST_FREQUENCIES, MOST_FACTOR = 0.25, 2.0
# what acts along one axis moves the other less by up to this
ACROSS_FACTOR, PARALLEL = 8.0, 0.7
# of more channels than so many, one median serves all
FEW = 30
# frequencies of one comparison; segments of it at least
LINES, FEWEST_SEGMENTS = 256, 8
# vibration (m/s2, standard deviation) of a structure that is not shaken on purpose; only records stated in g are asked
# for, as it is there that numbers of m/s2 come out ten times too large
STRONG_MPS2 = 2.0
# share of its samples that a channel must have for its spectrum to be held against others
LEAST_KNOWN = 0.99


def refuse_time(where: str, channels: Sequence[str], data: np.ndarray) -> None:
    """Raises InputError for a channel of data (n_sample, n_channel) whose samples are a clock: steady and without
    any vibration about it."""
    n = len(data)
    if n < FEWEST:
        return
    some = np.linspace(0, n - 1, min(n, LOOKED_AT)).astype(int)
    few = data[some]
    for c in np.flatnonzero(_are_straight(few, some) | ~np.isfinite(few).all(axis=0)):
        seen = np.flatnonzero(np.isfinite(few[:, c]))
        if len(seen) > FEWEST and not _are_straight(few[seen, c][:, None], some[seen] - some[seen[0]])[0]:
            continue
        row = np.flatnonzero(np.isfinite(data[:, c]))
        if len(row) < FEWEST:
            continue
        column, rise = data[row, c], data[row[-1], c] - data[row[0], c]
        if _are_straight(column[:, None], row - row[0])[0] and np.all(np.diff(column) * np.sign(rise) >= 0):
            step = rise / (row[-1] - row[0])
            raise InputError(f"{where}, channel {channels[int(c)]}", f"its samples rise evenly, by {step:.6g} each: it "
                             "looks like the column of time, not like a record", "name another column for it "
                             "(convert.toml, [columns]), or correct the order of [[sensor]]")


def _are_straight(columns: np.ndarray, number: np.ndarray) -> np.ndarray:
    """(n_column,) whether each column of (n, n_column) is a straight line over `number` (n,) that is not level."""
    line = columns[0] + (columns[-1] - columns[0]) * number[:, None] / number[-1]
    extent = np.abs(columns[-1] - columns[0])
    # NaN compares as False; single precision has its own steps
    largest = np.maximum(np.abs(columns[0]), np.abs(columns[-1]))
    step = 2.0 * np.spacing(np.minimum(largest, 0.5 * np.finfo(np.float32).max).astype(np.float32))
    away = np.max(np.abs(columns - line), axis=0)
    return (extent > 0) & ((away < STRAIGHT * extent) | ((away < step) & (extent > 10 * step)))


# Units --------------------------------------------------------------------------------------------------------------


def amplitude_spectrum(block: Block) -> np.ndarray | None:
    """ln of each channel's amplitude spectrum (n_line, n_channel), on few lines. NaN for channels that stand still or
    lack more than a hundredth of their samples, which would be noise in it; None where the block is too short."""
    from scipy import signal

    data = block.data
    whole = block.measured >= LEAST_KNOWN
    length = min(4 * LINES, 2 * len(data) // (FEWEST_SEGMENTS + 1))
    if length < 32 or whole.sum() < 2:
        return None
    density = np.full((length // 2, data.shape[1]), np.nan)
    found = signal.welch(zero_filled(data[:, whole]), block.sampling_rate_hz, nperseg=length, axis=0)[1]
    # the last quarter is what an anti-aliasing filter leaves, the first line what the window does to the mean
    density[:, whole] = found[1 : length // 2 + 1]
    density = density[1 : int(0.75 * len(density))]
    with np.errstate(divide="ignore"):
        logarithm = 0.5 * np.log(density)
    logarithm[:, ~np.isfinite(logarithm).all(axis=0)] = np.nan
    return logarithm


def unit_findings(
    spectra: Sequence[np.ndarray], sensors: Sequence[Sensor], vibration: dict[str, float], mentioned: Sequence[str]
) -> list[str]:
    """Sentences on channels whose numbers may be in another unit than the stated one. spectra: of blocks, by
    `amplitude_spectrum`; vibration: channel -> standard deviation in SI. A channel that a sentence of `mentioned`
    suspects of its scale is not asked for again."""
    found = []
    odd: list[int] = []
    spectrum = _middle_spectrum(spectra)
    while spectrum is not None:
        # the oddest first: beside it, of few channels, the others look odd too
        apart = _spectrum_ratios(spectrum, sensors, odd)
        if not apart:
            break
        k = max(apart, key=lambda i: abs(np.log(apart[i])))
        like = _comparable_channels(k, sensors, odd)
        like = _axis_peers(k, sensors, like) or like
        odd.append(k)
        sensor, middle, other = sensors[k], apart[k], sensors[like[0]].channel
        if any(sensor.channel in m and ("unit" in m or "scale" in m) for m in mentioned):
            continue
        # with one other there is no telling which of the two it is
        which = " or ".join(sensors[i].channel for i in (sorted([k, *like]) if len(like) == 1 else [k]))
        beside = other if len(like) == 1 else "its like"
        place = "only a support beside it explains" if middle < 1 and _is_last(k, sensors) else (
            "a place on the structure does not explain")
        found.append(f"suspect: the spectrum of {sensor.channel} is {middle:.2g} times that of {beside} at most "
                     f"frequencies, which {place}"
                     f"{_unit_of_factor(middle)}: is {which} in {sensor.unit}, as campaign.toml says?")
    loud = [s.channel for s in sensors if s.quantity == "acceleration" and s.unit in ("g", "mg")
            and vibration.get(s.channel, 0.0) > STRONG_MPS2]
    if loud:
        most = max(vibration[c] for c in loud)
        found.append(f"suspect: {', '.join(loud)} vibrate with up to {most:.3g} m/s2 (standard deviation), as stated "
                     "in g: are these numbers m/s2?")
    return found


def _middle_spectrum(spectra: Sequence[np.ndarray]) -> np.ndarray | None:
    """(n_line, n_channel), over the blocks; NaN for a channel that fewer than half of them know."""
    if not spectra:
        return None
    stack = np.array(spectra)
    known = np.isfinite(stack[:, 0])
    middle = np.full(stack.shape[1:], np.nan)
    for c in np.flatnonzero(known.mean(axis=0) >= 0.5):
        middle[:, c] = np.median(stack[known[:, c], :, c], axis=0)
    return middle


def _spectrum_ratios(spectrum: np.ndarray, sensors: Sequence[Sensor], odd: Sequence[int]) -> dict[int, float]:
    """Channel -> its amplitude over the middle of those parallel to it, else of its like, of the channels where that is
    far from 1 and from that of its like throughout (what drives a structure may do so along one axis), and from that of
    the places nearest to it (what changes along a structure does so smoothly). spectrum (n_line,
    n_channel) in logarithms, channels of `odd` left out."""
    found = {}
    left_out = {*odd, *np.flatnonzero(np.isnan(spectrum[0]))}
    middles: dict[tuple, np.ndarray] = {}
    octave = 1 / np.arange(2.0, 2 + len(spectrum))
    octave /= octave.sum()
    for k in range(len(sensors)):
        like = _comparable_channels(k, sensors, left_out)
        if k in left_out or not like:
            continue
        group = (sensors[k].quantity, abs(sensors[k].direction[2]) > 0.7)
        if len(like) <= FEW:
            middle = np.median(spectrum[:, like], axis=1)
        else:
            # of many, the channel itself moves no median
            middle = middles.setdefault(group, np.median(spectrum[:, like], axis=1))
        ratio = spectrum[:, k] - middle
        away = float(np.median(ratio))
        if abs(away) > np.log(MIDDLE_FACTOR) and octave @ (ratio * np.sign(away) > np.log(MOST_FACTOR)) >= (
                1 - MOST_FREQUENCIES):
            along = _axis_peers(k, sensors, like)
            if not along and abs(away) < np.log(ACROSS_FACTOR):
                continue
            near, beside = (float(np.median(spectrum[:, k] - np.median(spectrum[:, some], axis=1)))
                            for some in (_nearest_channels(k, sensors, like), along or like))
            if min(near * np.sign(away), beside * np.sign(away)) > np.log(MOST_FACTOR) and not (
                    near < 2 * np.log(_reach(k, sensors)) if beside > 0 else
                    _is_last(k, sensors) and _is_shared(k, beside, spectrum, sensors, left_out)):
                found[k] = float(np.exp(beside))
    return found


def _is_last(k: int, sensors: Sequence[Sensor]) -> bool:
    """Whether the channel's place is the first or last along the sensors' greatest extent, where a support may be."""
    along = _along(sensors)
    return min(along[k] - along.min(), along.max() - along[k]) < 1e-6 * np.ptp(along)


def _reach(k: int, sensors: Sequence[Sensor]) -> float:
    """How many times as far as the nearest other place a last one is from the opposite end, 1 of any other: what is
    clamped there moves by up to the square of it."""
    if not _is_last(k, sensors):
        return 1.0
    away = np.abs(_along(sensors) - _along(sensors)[k])
    others = away[away > 1e-6 * away.max()]
    # of two places nothing says that one is a support's
    return float(away.max() / (away.max() - others.min())) if others.min() < (1 - 1e-6) * away.max() else 1.0


def _along(sensors: Sequence[Sensor]) -> np.ndarray:
    """(n_channel,) coordinate along the sensors' greatest extent."""
    place = np.array([s.position_m for s in sensors])
    return (place - place.mean(axis=0)) @ np.linalg.svd(place - place.mean(axis=0), full_matrices=False)[2][0]


def _is_shared(k: int, away: float, spectrum: np.ndarray, sensors: Sequence[Sensor], left_out: Collection[int]) -> bool:
    """Whether what moves another way at the same place, or the same way at the other end, is as far from its own
    parallels: the place's doing."""
    like = _comparable_channels(k, sensors, left_out)
    along = _axis_peers(k, sensors, like)
    for i in like:
        others = _axis_peers(i, sensors, _comparable_channels(i, sensors, left_out))
        beside = np.allclose(sensors[i].position_m, sensors[k].position_m)
        if others and (_is_last(i, sensors) if i in along else beside) and abs(float(np.median(
                spectrum[:, i] - np.median(spectrum[:, others], axis=1))) - away) < np.log(MOST_FACTOR):
            return True
    return False


def _axis_peers(k: int, sensors: Sequence[Sensor], like: Sequence[int]) -> list[int]:
    return [i for i in like if abs(sensors[i].direction @ sensors[k].direction) > PARALLEL]


def _nearest_channels(k: int, sensors: Sequence[Sensor], like: Sequence[int]) -> list[int]:
    """Those of `like` at the two places nearest to the channel's own, but for its own place."""
    distance = np.round([np.linalg.norm(sensors[i].position_m - sensors[k].position_m) for i in like], 6)
    others = np.unique(distance[distance > 0])[:2]
    return [i for i, d in zip(like, distance, strict=True) if d in others] or list(like)


def _comparable_channels(k: int, sensors: Sequence[Sensor], left_out: Collection[int]) -> list[int]:
    """Channels to compare one with: of its quantity, upright as it is or level."""
    return [i for i, s in enumerate(sensors) if i != k and i not in left_out and s.quantity == sensors[k].quantity
            and (abs(s.direction[2]) > 0.7) == (abs(sensors[k].direction[2]) > 0.7)]


def _unit_of_factor(factor: float) -> str:
    size = max(factor, 1 / factor)
    known = {"g and m/s2": 9.80665, "cm and m": 100.0, "mg and g, or mm and m": 1000.0}
    name, value = min(known.items(), key=lambda item: abs(np.log(size / item[1])))
    return f" ({name} are {value:.4g} apart)" if abs(np.log(size / value)) < np.log(2.5) else ""
