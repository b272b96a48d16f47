"""Channels compared with one another without a model: flipped, swapped, turned, dead, copied or wrongly scaled ones.

Two facts are used. What is fixed to one level moves, at low frequencies, as one rigid body. And a tower or jacket
bends, in its lowest motion, to one side over its whole height: more the higher, and it leans to where it goes. What
breaks either fact and is corrected by one change of one or two channels is suspected of just that. Of structures that
keep neither (a bridge's deck, a plane frame) lines of sensors are judged by themselves (`sensor_lines`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from probupdate.campaign.rigid_bodies import RIGID_SHARE, explain_motion, motions, name_levels, rigid_motions
from probupdate.campaign.sensor_lines import reversed_in_line, whole_line
from probupdate.campaign.spectra import CrossSpectra
from probupdate.evidence.gains import outside_share
from probupdate.modal.modes import Sensor

FLIPPED, SWAPPED, TURNED, SCALED, DEAD, LEVEL_SCALED = "flipped", "swapped", "turned", "scaled", "dead", "level scaled"
COPIED = "copied"
# cosine of the angle up to which two sensors count as of one direction
ALONG = 0.9
# the lowest motion is sought above this; the waves' own motion of a tower is to one side as well, and may serve
LOWEST_HZ = 0.15
# a level is rigid up to so many times the lowest motion's frequency
RIGID_UP_TO = 8.0
# share of a level's motion (channels scaled alike) that a rigid body does not explain: a change of one channel or a
# swap is believed if it leaves less than this, and less than half of what was before
MENDED_SHARE, MENDED_RATIO = 0.05, 0.5
# gain of one direction against the other, of a vertical channel against its level; legs and braces move by themselves
PROFILE_LIMIT, VERTICAL_LIMIT = 1.5, 2.0
# direction in which a channel's motion goes, against its own: one that is fixed askew, one that is another's
TURNED_DEG, ACROSS_DEG, FLIPPED_DEG = 20.0, 55.0, 145.0
# a channel's direction is judged where noise leaves it to so many degrees (one standard deviation) and it follows at
# all
DIRECTION_STD_DEG, FOLLOWING = 5.0, 0.05
# phase in the lowest motion from which a gain is a filter's
FILTERED_DEG = 10.0
# highest coherence (over frequencies) with any other channel below which a channel has nothing in common with them
DEAD_COHERENCE = 0.25
# coherence at every frequency from which two channels are one signal: of two sensors each has noise of its own, which
# at some frequency is more than the hundredth of the motion that this allows
COPIED_COHERENCE = 0.9999


@dataclass(frozen=True, kw_only=True)
class Suspicion:
    """kind; the channels it concerns; size: gain as recorded against as it should be, or the angle in deg; lead_deg: of
    a gain, how far its phase is ahead of the others' in the lowest motion, which a scale does not make."""

    kind: str
    channels: tuple[str, ...]
    size: float = float("nan")
    lead_deg: float = 0.0
    ambiguous_with: tuple[str, ...] = field(default=())


def suspicions(spectra: CrossSpectra, sensors: tuple[Sensor, ...]) -> list[Suspicion]:
    """What one block says against its channels; all of one quantity. Nothing where nothing can be said. Levels are
    those of the sensors' positions, whatever their names."""
    sensors = name_levels(sensors)
    power = np.einsum("fii->i", np.real(spectra.density))
    alive = [i for i in range(len(sensors)) if power[i] > 0]
    set_aside = [*_dead_channels(spectra, sensors, alive), *_find_copies(spectra, sensors, alive)]
    alive = [i for i in alive if sensors[i].channel not in {c for s in set_aside for c in s.channels}]
    lowest = lowest_motion_hz(spectra, sensors, alive)
    if lowest is None:
        return set_aside
    level, mended = [], {}
    for members in _rigid_levels(sensors, alive):
        for one in _rigid_body_suspicions(spectra, sensors, members, lowest):
            level.append(one)
            if not one.ambiguous_with:
                mended |= dict.fromkeys(one.channels, one)
    bending = [s for s in _cantilever_suspicions(spectra, sensors, alive, lowest) if not set(s.channels) & set(mended)]
    named = {c for s in bending for c in s.channels}
    # what the rigid body leaves open, the bending may have named
    level = [s for s in level if not (s.ambiguous_with and named & {*s.channels, *s.ambiguous_with})]
    return set_aside + [_add_lead(spectra, sensors, s, lowest) for s in level + bending]


def _add_lead(spectra: CrossSpectra, sensors: tuple[Sensor, ...], one: Suspicion, lowest: float) -> Suspicion:
    """A gain with its phase against all others along its direction, whatever the signs, -90 to 90, and its size by it:
    real parts alone are too small by the cosine."""
    if one.kind != SCALED:
        return one
    kept = _lowest_lines(spectra, lowest)
    own = [i for i, s in enumerate(sensors) if s.channel in one.channels]
    cross = [np.sum(spectra.density[kept, j, i] ** 2) for i in own for j, s in enumerate(sensors)
             if j not in own and abs(float(s.direction @ sensors[i].direction)) > ALONG]
    lead = float(np.angle(np.sum([c / abs(c) for c in cross if c != 0]))) / 2
    if abs(np.degrees(lead)) < FILTERED_DEG:
        return one
    return replace(one, size=one.size / max(np.cos(lead), 0.1), lead_deg=float(np.degrees(lead)))


def _lowest_lines(spectra: CrossSpectra, lowest: float) -> np.ndarray:
    """(n_line,) bool: lines of the lowest motion."""
    return (spectra.frequency_hz > lowest / 1.25) & (spectra.frequency_hz < lowest * 1.25)


def _rigid_levels(sensors: tuple[Sensor, ...], alive: list[int]) -> list[list[int]]:
    """Channels by level, horizontal and vertical ones apart, without lines that are the structure's length."""
    along = {"horizontal": [i for i in alive if _horizontal(sensors[i])],
             "vertical": [i for i in alive if _is_vertical(sensors[i])]}
    # apart, as vertical channels are often little more than noise
    apart = [m for some in along.values() for m in levels(sensors, some).values()]
    # oblique ones see both
    oblique = {sensors[i].level for i in alive if not _horizontal(sensors[i]) and not _is_vertical(sensors[i])}
    apart = [m for m in apart if sensors[m[0]].level not in oblique]
    apart += [m for level, m in levels(sensors, alive).items() if level in oblique]
    return [m for m in apart if not whole_line(sensors, m)]


def _cantilever_suspicions(
    spectra: CrossSpectra, sensors: tuple[Sensor, ...], alive: list[int], lowest: float
) -> list[Suspicion]:
    """By the whole height as a cantilever, and by each line of sensors: where modes of both directions and of torsion
    lie close together no level's motion explains the others', but a line's shape has one sign all the same."""
    found, place = _cantilever(spectra, sensors, alive, lowest), {s.channel: s for s in sensors}
    for i in reversed_in_line(spectra, sensors, alive):
        one = sensors[i]
        if any(one.channel in s.channels for s in found):
            continue
        # signs are relative: where the reference is reversed, all others along its direction seem to be
        found = [s for s in found if s.kind != FLIPPED or not any(
            abs(float(place[c].direction @ one.direction)) > ALONG for c in s.channels)]
        found.append(Suspicion(kind=FLIPPED, channels=(one.channel,)))
    return found


def levels(sensors: tuple[Sensor, ...], alive: list[int]) -> dict[str, list[int]]:
    found: dict[str, list[int]] = {}
    for i in alive:
        found.setdefault(sensors[i].level, []).append(i)
    return found


def is_upright(sensors: tuple[Sensor, ...]) -> bool:
    """Whether the sensors stand above one another: twice as high as wide."""
    extent = np.ptp([s.position_m for s in sensors], axis=0)
    return bool(extent[2] > 2 * np.hypot(extent[0], extent[1]))


def _horizontal(sensor: Sensor) -> bool:
    return abs(sensor.direction[2]) < 0.3


def _is_vertical(sensor: Sensor) -> bool:
    return abs(sensor.direction[2]) > ALONG


def lowest_motion_hz(spectra: CrossSpectra, sensors: tuple[Sensor, ...], alive: list[int]) -> float | None:
    """Where the horizontal channels' displacement is largest; every level has one vote in its own scale, so that
    neither a wrong unit nor many sensors on the transition piece decide."""
    frequency, density = spectra.frequency_hz, spectra.density
    chosen = [i for i in alive if _horizontal(sensors[i])] or alive
    kept = frequency >= LOWEST_HZ
    if not kept.any() or not chosen:
        return None
    votes = []
    for members in levels(sensors, chosen).values():
        own = np.stack([np.real(density[kept, i, i]) / frequency[kept] ** 4 for i in members])
        votes.append((own / own.sum(axis=1, keepdims=True)).mean(axis=0))
    return float(frequency[kept][np.argmax(np.sum(votes, axis=0))])


def _dead_channels(spectra: CrossSpectra, sensors: tuple[Sensor, ...], alive: list[int]) -> list[Suspicion]:
    """Channels coherent with no other at any frequency; with few segments chance alone is coherent."""
    if len(alive) < 3 or spectra.n_segment < 30:
        return []
    squared = spectra.coherence(alive)
    squared[:, range(len(alive)), range(len(alive))] = 0
    # the mean of three neighbouring frequencies: chance peaks are narrow
    smooth = (squared[:-2] + squared[1:-1] + squared[2:]) / 3
    highest = smooth.max(axis=(0, 2))
    return [Suspicion(kind=DEAD, channels=(sensors[i].channel,), size=float(c))
            for i, c in zip(alive, highest, strict=True) if c < DEAD_COHERENCE]


def _find_copies(spectra: CrossSpectra, sensors: tuple[Sensor, ...], alive: list[int]) -> list[Suspicion]:
    """Pairs that are one signal, whatever its scale; size: the first's over the second's."""
    power = np.einsum("fii->i", np.real(spectra.density))
    found = []
    for i, j in combinations(alive, 2):
        if np.all(spectra.coherence([i, j])[:, 0, 1] >= COPIED_COHERENCE):
            ratio = float(np.sqrt(power[i] / power[j]))
            found.append(Suspicion(kind=COPIED, channels=(sensors[i].channel, sensors[j].channel), size=ratio))
    return found


# One level as a rigid body ------------------------------------------------------------------------------------------


def _rigid_body_suspicions(spectra: CrossSpectra, sensors, members: list[int], lowest: float) -> list[Suspicion]:
    own = [sensors[i] for i in members]
    kept = (spectra.frequency_hz > LOWEST_HZ) & (spectra.frequency_hz < RIGID_UP_TO * lowest)
    samples = motions(spectra.density[kept][None, :, members][:, :, :, members])
    # two at least must be redundant
    if not len(samples) or len(own) <= np.linalg.matrix_rank(rigid_motions(own), tol=1e-6) + 1:
        return []
    # along one line alike, so that vertical channels count as well
    along = np.abs([[a.direction @ b.direction for b in own] for a in own]) > ALONG
    std = np.sqrt(np.mean(samples**2, axis=0))
    scale = np.array([np.median(std[row]) for row in along])
    samples, motion = samples / scale, rigid_motions(own) / scale[:, None]
    if outside_share(samples, motion) < RIGID_SHARE:
        return []
    found, share, before = explain_motion(samples, motion, [(i,) for i in range(len(own))],
                                  list(combinations(range(len(own)), 2)))
    if share > MENDED_SHARE or share > MENDED_RATIO * before:
        return []
    result = []
    for one, others in found:
        kind = SWAPPED if one.kind == "exchange" else FLIPPED if one.gain < 0 else SCALED
        names = tuple(own[i].channel for i in one.members)
        result.append(Suspicion(kind=kind, channels=names, size=np.nan if kind == SWAPPED else one.gain,
                                ambiguous_with=tuple(dict.fromkeys(own[i].channel for t in others for i in t.members
                                                                   if i not in one.members))))
    return result


# The whole height as a cantilever -----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, kw_only=True)
class _Bending:
    """Each channel's motion on the reference level's two: along (n_channel, 2), NaN where it does not follow;
    expected (n_channel, 2) the direction it should have."""

    members: list[int]
    along: np.ndarray
    expected: np.ndarray
    reference: str

    def angle_deg(self) -> np.ndarray:
        """(n_channel,) counter-clockwise from expected to found, -180 to 180."""
        turn = np.arctan2(self.along[:, 1], self.along[:, 0])
        turn -= np.arctan2(self.expected[:, 1], self.expected[:, 0])
        return np.degrees((turn + np.pi) % (2 * np.pi) - np.pi)


def _cantilever(spectra: CrossSpectra, sensors, alive: list[int], lowest: float) -> list[Suspicion]:
    """Nothing where no level sees two directions, or the sensors do not stand above one another."""
    if not is_upright(sensors):
        return []
    kept = _lowest_lines(spectra, lowest)
    covariance = np.real(spectra.density[kept]).mean(axis=0)
    # real and imaginary part of each frequency of each segment; half overlapping ones share a good part
    n_free = max(int(kept.sum()) * spectra.n_segment, 1)
    candidates = []
    for level, members in levels(sensors, alive).items():
        across = [i for i in members if _horizontal(sensors[i])]
        plane = np.array([sensors[i].direction[:2] for i in across])
        if len(across) >= 2 and np.linalg.svd(plane, compute_uv=False)[-1] > 0.5:
            candidates.append(_bending_regression(covariance, sensors, alive, across, plane, level, n_free))
    if not candidates:
        return []
    # a level that is wrong itself agrees with few others; among about equal ones the highest, which moves most
    height = {s.level: s.position_m[2] for s in sensors}
    agree = [int(np.sum(np.abs(b.angle_deg()) < TURNED_DEG)) for b in candidates]
    sound = [b for b, n in zip(candidates, agree, strict=True) if n >= max(agree) - 2]
    best = max(sound, key=lambda b: height[b.reference])
    found = [*_directions(best, sensors), *_profile(best, sensors)]
    # a level that agrees with no other may be the one that is wrong
    level = [sensors[i].level for i in best.members]
    agrees = [v for v, a in zip(level, np.abs(best.angle_deg()), strict=True) if v != best.reference and a < TURNED_DEG]
    if agrees:
        return found
    own = tuple(sensors[i].channel for i, v in zip(best.members, level, strict=True) if v == best.reference)
    return [replace(s, ambiguous_with=tuple(dict.fromkeys((*s.ambiguous_with, *own)))) for s in found]


def _bending_regression(covariance, sensors, alive, across, plane, level, n_free) -> _Bending:
    """Regression of every channel on the level's two motions; n_free independent values are in the covariance."""
    back = np.linalg.pinv(plane)
    own = back @ covariance[np.ix_(across, across)] @ back.T
    cross = covariance[np.ix_(alive, across)] @ back.T
    along = cross @ np.linalg.pinv(own)
    total = np.diag(covariance)[alive]
    explained = np.clip(np.einsum("ij,ij->i", along, cross) / total, 0.0, 1.0)
    # what noise does to the direction: the coefficient's standard deviation across it; large where the motion had one
    # direction
    across_it = np.stack([-along[:, 1], along[:, 0]], axis=1)
    size = np.maximum(np.einsum("ij,ij->i", along, along), 1e-300)
    spread = np.einsum("ij,jk,ik->i", across_it, np.linalg.pinv(own), across_it) / size
    # of a singular covariance rounding may leave less than nothing
    std_deg = np.degrees(np.sqrt(np.maximum((1 - explained) * total * spread, 0.0) / (n_free * size)))
    along = np.where(((explained > FOLLOWING) & (std_deg < DIRECTION_STD_DEG))[:, None], along, np.nan)
    return _Bending(members=list(alive), along=along, expected=_expected_directions(sensors, alive), reference=level)


def _expected_directions(sensors, alive) -> np.ndarray:
    """(n_channel, 2) direction of motion of the whole that drives each channel positively: a horizontal one its own; a
    vertical one off the axis moves down where the structure leans to its side."""
    centre = {level: np.mean(np.unique([sensors[i].position_m[:2] for i in members], axis=0), axis=0)
              for level, members in levels(sensors, alive).items()}
    found = np.full((len(alive), 2), np.nan)
    for row, i in enumerate(alive):
        sensor = sensors[i]
        if _horizontal(sensor):
            found[row] = sensor.direction[:2]
        elif _is_vertical(sensor):
            arm = sensor.position_m[:2] - centre[sensor.level]
            if np.hypot(*arm) > 0.5:
                found[row] = -arm * np.sign(sensor.direction[2])
    norm = np.linalg.norm(found, axis=1, keepdims=True)
    return found / norm


def _directions(bending: _Bending, sensors) -> list[Suspicion]:
    """Channels that move to another side than their own."""
    angle = bending.angle_deg()
    name = [sensors[i].channel for i in bending.members]
    vertical = np.array([not _horizontal(sensors[i]) for i in bending.members])
    wrong = [r for r in range(len(name)) if abs(angle[r]) > TURNED_DEG * (1 + 2 * vertical[r])]
    found, done = [], set()
    for a, b in combinations(wrong, 2):
        if {a, b} & done or vertical[a] != vertical[b]:
            continue
        exchanged = _Bending(members=[], along=bending.along[[a, b]], expected=bending.expected[[b, a]], reference="")
        if max(abs(angle[a]), abs(angle[b])) > ACROSS_DEG and np.all(
                np.abs(exchanged.angle_deg()) < TURNED_DEG * (1 + 2 * vertical[a])):
            found.append(Suspicion(kind=SWAPPED, channels=(name[a], name[b])))
            done |= {a, b}
    for r in wrong:
        if r in done:
            continue
        kind = FLIPPED if abs(angle[r]) > FLIPPED_DEG else TURNED
        if kind == TURNED and vertical[r] and abs(angle[r]) < ACROSS_DEG:
            continue
        mates = [q for q in wrong if q not in done and q != r and kind == TURNED and not vertical[r]
                 and sensors[bending.members[q]].level == sensors[bending.members[r]].level
                 and abs(angle[q]) <= FLIPPED_DEG and abs(angle[q] - angle[r]) < TURNED_DEG]
        rows = [r, *mates]
        found.append(Suspicion(kind=kind, channels=tuple(name[q] for q in sorted(rows)),
                               size=float(np.mean(angle[rows]))))
        done |= set(rows)
    return found


def _profile(bending: _Bending, sensors) -> list[Suspicion]:
    """How far each level goes along x and along y: the two in one proportion everywhere, and in between what a
    cantilever does; and how far the vertical channels of a level go for their distance from the axis."""
    reach, upright = _reach(bending, sensors)
    found = _scaled_verticals(upright)
    mean = {key: float(np.exp(np.mean(np.log(list(values.values()))))) for key, values in reach.items()}
    height = {s.level: float(s.position_m[2]) for s in sensors}
    both = sorted({v for _, v in mean if ("x", v) in mean and ("y", v) in mean}, key=lambda v: height[v])
    if len(both) < 3:
        return found
    proportion = {v: np.log(mean["x", v] / mean["y", v]) for v in both}
    usual = np.median(list(proportion.values()))
    off = {v: float(p - usual) for v, p in proportion.items()}
    names = _exchanged_levels(reach, mean, both, off)
    if names:
        return [*found, Suspicion(kind=SWAPPED, channels=names)]
    odd = {v: p for v, p in off.items() if abs(p) > np.log(PROFILE_LIMIT)}
    if odd:
        found += [_scaled_level(reach, mean, [v for v in both if v == level or v not in odd], height, level, p)
                  for level, p in odd.items() if min(len(reach["x", level]), len(reach["y", level])) == 1]
        return found
    typical = {v: np.sqrt(mean["x", v] * mean["y", v]) for v in both}
    for level in both[1:-1]:
        least, most = _bounds(both, typical, height, level)
        if not least / 2 < typical[level] < 2 * most:
            names = (*reach["x", level], *reach["y", level])
            size = typical[level] / (most if typical[level] > most else least)
            found.append(Suspicion(kind=LEVEL_SCALED, channels=names, size=float(size)))
    return found


def _bounds(order, reach, height, level) -> tuple[float, float]:
    """Least and most reach of a level between others. A cantilever's first mode bends to one side: below the straight
    line of the two neighbours, above the one below it and above lines through two levels on one side, however soft
    what stands on it is."""
    k = order.index(level)

    def line(a, b) -> float:
        slope = (reach[b] - reach[a]) / max(height[b] - height[a], 1e-9)
        return reach[a] + slope * (height[level] - height[a])

    beyond = [line(*order[i : i + 2]) for i in (k - 2, k + 1) if 0 <= i < len(order) - 1]
    most = line(order[k - 1], order[k + 1])
    # others that contradict one another, as one of them is wrong, ask no more than the straight line
    return min(max([reach[order[k - 1]], *beyond]), most), most


def _reach(bending: _Bending, sensors) -> tuple[dict[tuple[str, str], dict[str, float]], dict[str, dict[str, float]]]:
    """How far channels go, by name: horizontal ones by axis and level, vertical ones by level."""
    reach: dict[tuple[str, str], dict[str, float]] = {}
    upright: dict[str, dict[str, float]] = {}
    for row, i in enumerate(bending.members):
        size = float(np.linalg.norm(bending.along[row]))
        if not np.isfinite(size) or size == 0 or not np.isfinite(bending.expected[row]).all():
            continue
        if _horizontal(sensors[i]):
            axis = "x" if abs(sensors[i].direction[0]) >= abs(sensors[i].direction[1]) else "y"
            reach.setdefault((axis, sensors[i].level), {})[sensors[i].channel] = size
        else:
            upright.setdefault(sensors[i].level, {})[sensors[i].channel] = size
    return reach, upright


def _scaled_verticals(upright: dict[str, dict[str, float]]) -> list[Suspicion]:
    """Vertical channels unlike the others of their level, of four at least."""
    return [Suspicion(kind=SCALED, channels=(channel,), size=value / np.median(list(values.values())))
            for values in upright.values() if len(values) >= 4 for channel, value in values.items()
            if not 1 / VERTICAL_LIMIT < value / np.median(list(values.values())) < VERTICAL_LIMIT]


def _exchanged_levels(reach, mean, both: list[str], off: dict[str, float]) -> tuple[str, ...]:
    """Channels of two levels exchanged along one axis: they are off by the same factor to opposite sides, and reach
    rises with height once they are put back."""
    mild = {v: p for v, p in off.items() if abs(p) > 0.75 * np.log(PROFILE_LIMIT)}
    if len(mild) != 2:
        return ()
    (a, off_a), (b, off_b) = mild.items()
    if not abs(off_a + off_b) < 0.35 * max(abs(off_a), abs(off_b)):
        return ()
    for axis in ("x", "y"):
        order = [mean[axis, v] for v in both]
        changed = [mean[axis, b if v == a else a if v == b else v] for v in both]
        alone = all(len(reach[axis, v]) == 1 for v in (a, b))
        if order != sorted(order) and changed == sorted(changed) and alone:
            return (*reach[axis, a], *reach[axis, b])
    return ()


def _scaled_level(reach, mean, usual: list[str], height, level: str, off: float) -> Suspicion:
    """The channel of a level whose two axes are out of proportion: the one that is farther from what its neighbours
    among the `usual` levels say."""
    away = {}
    for axis in ("x", "y"):
        wanted = _expected_reach(usual, {v: mean[axis, v] for v in usual}, height, level)
        away[axis] = abs(np.log(mean[axis, level] / wanted)) if wanted else 0.0
    axis = "x" if away["x"] >= away["y"] else "y"
    sure = abs(away["x"] - away["y"]) > 0.5 * abs(off)
    other = reach["y" if axis == "x" else "x", level]
    return Suspicion(kind=SCALED, channels=tuple(reach[axis, level]), size=float(np.exp(off if axis == "x" else -off)),
                     ambiguous_with=() if sure else tuple(other))


def _expected_reach(order, reach, height, level) -> float | None:
    """Reach of a level by its neighbours': midway between a straight line and a clamped cantilever's curve; at the top
    the straight line of the two below it goes on."""
    order = [v for v in order if v in reach]
    k = order.index(level)
    if k == 0 or len(order) < 3:
        return None
    low, high = (order[k - 1], order[k + 1]) if k + 1 < len(order) else (order[k - 2], order[k - 1])
    rise = height[high] - height[low]
    if rise <= 0:
        return None
    s = (height[level] - height[low]) / rise
    curve = s * s * (3 - s) / 2 if s <= 1 else s
    value = reach[low] + (reach[high] - reach[low]) * (s + curve) / 2
    return value if value > 0 else None
