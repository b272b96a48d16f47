"""Reversed sensors of a line: along something that bends, the lowest mode changes its sign at no single sensor.

A cantilever with a free top, and a beam between two supports, move to one side in their lowest mode; a sensor that
alone goes the other way, by as much as its neighbours suggest, is suspected of a reversed sign. Higher modes, and the
lowest of several spans, do change their sign, but then a sensor goes where its neighbours' shape continues: that is
asked of the lowest mode and of the next, so that a record in which the lowest mode does not show raises no suspicion.
Sensors that stand much farther apart than the others are not judged. Those of a grid (a floor, two girders) are judged
along each of its lines."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import combinations

import numpy as np

from probupdate.campaign.spectra import CrossSpectra
from probupdate.modal.modes import Sensor, rotate_to_real

# share of a line's length by which its sensors may lie beside it
BESIDE = 0.05
# of the sensors' whole extent, from which a line is the structure's length
WHOLE = 0.9
# fewest sensors of a line that stands upright (one sign of the lowest mode is certain where its top is free) and of any
FEWEST_UPRIGHT, FEWEST = 3, 4
# a peak of the line's motion stands out so many times from the median of so many lines to each side ...
PEAK, BESIDE_LINES = 3.0, 20
# ... and is one motion in which a channel takes part by this share of its own
PART, ONE_MOTION, REAL = 0.5, 0.8, 0.95
# |moved + said| over |moved - said| of a reversed sensor, in the mean (of logarithms) over the modes asked: it moves by
# two fifths to two and a half times what its neighbours say
ALIKE = 0.4
# distance to the neighbours over the largest among the others
LARGEST_GAP = 1.6
# a shape that grows with height may fall by so much of its largest
FALL = 0.1


def reversed_in_line(spectra: CrossSpectra, sensors: Sequence[Sensor], alive: Sequence[int]) -> list[int]:
    """Sensors (indices) of which each alone has a sign that no neighbour shares, in the lowest modes of most of the
    lines of sensors along one direction that it is in. Nothing where the lines are too short or show no mode."""
    judged: Counter[int] = Counter()
    found: Counter[int] = Counter()
    for members, place, sign in _lines(sensors, alive):
        density = spectra.density[:, members][:, :, members] * np.outer(sign, sign)
        upright = _is_upright(sensors, members)
        shapes = _lowest_shapes(density, FEWEST_UPRIGHT if upright else FEWEST)
        if not shapes:
            continue
        judged.update(members)
        if (one := _reversed_sensor(place, shapes, upright)) is not None:
            found[members[one]] += 1
    return [k for k, n in found.items() if 2 * n > judged[k]]


def whole_line(sensors: Sequence[Sensor], members: Sequence[int]) -> bool:
    """Whether some sensors are a line of one direction as long as all sensors reach: the structure's length and no
    rigid part of it."""
    extent = np.linalg.norm(np.ptp([s.position_m for s in sensors], axis=0))
    return any(len(line) == len(members) and np.ptp(place) > WHOLE * extent
               for line, place, _ in _lines(sensors, members))


def _lines(sensors: Sequence[Sensor], alive: Sequence[int]) -> list[tuple[list[int], np.ndarray, np.ndarray]]:
    """Members along one direction at different places of a straight line, in their order, with their coordinate and
    sign. Of sensors that are no line the lines among them, where these lie wider than high."""
    left, found = list(alive), []
    while left:
        first = sensors[left[0]].direction
        group = [i for i in left if abs(float(sensors[i].direction @ first)) > 0.9]
        left = [i for i in left if i not in group]
        for members, along in _straight_lines(sensors, group):
            sign = np.sign([float(sensors[i].direction @ first) for i in members])
            found.append((members, along, sign))
    return found


def _straight_lines(sensors: Sequence[Sensor], group: list[int]) -> list[tuple[list[int], np.ndarray]]:
    """Straight lines of sensors (indices, in their order) at different places, with their coordinate."""
    position = np.array([sensors[i].position_m for i in group])
    extent = np.ptp(position, axis=0)
    if (whole := _order_along_line(position)) is not None:
        lines = [whole]
    elif extent[2] > np.hypot(*extent[:2]):
        return []
    else:
        lines = []
        for i, j in combinations(range(len(group)), 2):
            axis = position[j] - position[i]
            if not np.any(axis):
                continue
            axis = axis / np.linalg.norm(axis)
            away = position - position[i]
            near = np.linalg.norm(away - np.outer(away @ axis, axis), axis=1) < BESIDE * np.linalg.norm(extent)
            members = np.flatnonzero(near)
            if (one := _order_along_line(position[members])) is not None:
                lines.append((members[one[0]], one[1]))
    unique = {tuple(int(k) for k in order): along for order, along in lines}
    return [([group[k] for k in order], along) for order, along in unique.items()
            if not any(set(order) < set(other) for other in unique)]


def _order_along_line(position: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Order (n,) and coordinate (n,) of positions (n, 3) on a straight line; None where they are none."""
    if len(position) < FEWEST_UPRIGHT:
        return None
    centred = position - position.mean(axis=0)
    _, extent, axes = np.linalg.svd(centred, full_matrices=False)
    along = centred @ axes[0]
    length = float(np.ptp(along))
    aside = centred - np.outer(along, axes[0])
    if extent[0] <= 0 or np.abs(aside).max() > BESIDE * length:
        return None
    along = along * np.sign(axes[0][2] if abs(axes[0][2]) > 1e-6 else 1.0)
    order = np.argsort(along, kind="stable")
    if np.diff(along[order]).min() < 0.01 * length:
        return None
    return order, along[order]


def _is_upright(sensors: Sequence[Sensor], members: Sequence[int]) -> bool:
    extent = np.ptp([sensors[i].position_m for i in members], axis=0)
    return bool(extent[2] > 2 * np.hypot(*extent[:2]) and abs(sensors[members[0]].direction[2]) < 0.3)


def _lowest_shapes(density: np.ndarray, fewest: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Real shapes (n,), largest 1, at the two lowest peaks in which the line has one motion, and (n,) whether a channel
    has so much part in it that its sign is known."""
    power = np.real(np.einsum("fii->fi", density))
    total = (power / np.maximum(power.sum(axis=0), 1e-300)).sum(axis=1)
    found: list[tuple[np.ndarray, np.ndarray]] = []
    for f in range(1, len(total) - 1):
        near = total[max(f - BESIDE_LINES, 0): f + BESIDE_LINES + 1]
        around = total[max(f - 3, 0): f + 4]
        if total[f] < around.max() or total[f] < PEAK * np.median(near):
            continue
        shape = _shape(density[f - 1: f + 2].mean(axis=0), fewest)
        if shape is None:
            continue
        real = np.real(shape[0])
        if np.sum(real[shape[1]] ** 2) < REAL * np.sum(np.abs(shape[0][shape[1]]) ** 2):
            # where some channel has a phase of its own, the lowest modes show no signs, and higher ones change theirs
            break
        found.append((real / np.abs(real).max(), shape[1]))
        if len(found) == 2:
            break
    return found


def _shape(density: np.ndarray, fewest: int) -> tuple[np.ndarray, np.ndarray] | None:
    scale = np.sqrt(np.real(np.diag(density)))
    value, vector = np.linalg.eigh(density / np.outer(scale, scale))
    part = value[-1] * np.abs(vector[:, -1]) ** 2
    known = part > PART
    if known.sum() < fewest or part[known].mean() < ONE_MOTION:
        return None
    # conj(X_i) X_j is density[i, j]: the shape is the conjugate of its eigenvector
    return rotate_to_real((scale * vector[:, -1]).conj()[:, None])[:, 0], known


def _reversed_sensor(
    place: np.ndarray, shapes: list[tuple[np.ndarray, np.ndarray]], upright: bool
) -> int | None:
    """The one sensor of the line that is reversed; None."""
    first, members = shapes[0]
    known = np.flatnonzero(members)
    sign, size = np.sign(first[known]), np.abs(first[known])
    alone = [int(known[np.flatnonzero(sign == s)[0]]) for s in (1.0, -1.0) if np.sum(sign == s) == 1]
    if upright and np.any(np.maximum.accumulate(size) - size > FALL):
        return None
    found = []
    # where nothing is known of supports a sensor need not be the only one of its sign, if two modes say so
    for k in alone if alone or upright else known:
        if len(known) < FEWEST_UPRIGHT or not _is_near_neighbours(place[known], int(np.flatnonzero(known == k)[0])):
            continue
        votes = [_vote(place, shape, k, upright) for shape, members in shapes if members[k]]
        # what goes on where its neighbours point in one of the two modes is no reversed sensor
        if any(with_them < against / 2 for against, with_them in votes):
            continue
        ratio = [against / max(with_them, 1e-300) for against, with_them in votes]
        if min(ratio, default=1.0) < ALIKE if upright else (k in alone or len(ratio) > 1) and np.prod(
                ratio) < ALIKE ** len(ratio):
            found.append(int(k))
    return found[0] if found and (upright or len(found) == 1) else None


def _is_near_neighbours(place: np.ndarray, k: int) -> bool:
    """Whether a sensor is as near to its neighbours as others are to theirs."""
    gap = np.diff(place)
    own, others = gap[max(k - 1, 0): k + 1], np.delete(gap, range(max(k - 1, 0), min(k + 1, len(gap))))
    return len(others) > 0 and own.max() <= LARGEST_GAP * others.max()


def _vote(place: np.ndarray, shape: np.ndarray, k: int, upright: bool) -> tuple[float, float]:
    """|moved + said| and |moved - said| of what the nearest sensors say: between two of them, or straight on and along
    a parabola at an end, whichever is nearer either way; above a foot, that it goes where the next one goes."""
    others = np.delete(np.arange(len(place)), k)
    if k == 0 and upright:
        said = [float(np.copysign(shape[0], shape[1]))]
    elif 0 < k < len(place) - 1:
        said = [float(np.interp(place[k], place[others], shape[others]))]
    else:
        nearest = others[np.argsort(np.abs(place[others] - place[k]))]
        said = [float(np.polyval(np.polyfit(place[nearest[:n]], shape[nearest[:n]], n - 1), place[k]))
                for n in (2, 3) if len(nearest) >= n]
    return min(abs(shape[k] + v) for v in said), min(abs(shape[k] - v) for v in said)
