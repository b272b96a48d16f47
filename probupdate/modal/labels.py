"""Names for the global modes of a structure: FA1, SS1, T1, FA2, ... of a turbine, X1, Y1, T1, X2, ... of what rises
without a nacelle, H1, V1, T1, A1, H2, ... of what spans, L1, L2, ... of single members. Here they come from what
sensors see; a model's own modes have theirs from the whole shape (`mode_energy`)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from probupdate.modal.long_axis import horizontal_axes, spans
from probupdate.modal.sensor_places import sensors_by_height, sensors_by_place
from probupdate.modal.sets import LOCAL, Sensor
from probupdate.modal.shape_criteria import mac
from probupdate.runtime.arrays import frozen_array

# more than this share of a mode in neither bending nor torsion makes it one of single members
LOCAL_LIMIT = 0.5
# modes within this of each other's frequency, of which one has more than this share across its own direction
OBLIQUE_GAP, OBLIQUE = 0.02, 0.3
# shapes at the sensors of a higher MAC are alike, and modes that move them less than this share of the most are unseen
ALIKE_MAC, UNSEEN = 0.9, 1e-4
# of the median motion at the sensors: a bridge's bending with the sensors at its nodes has 0.1, its modes that were
# found 0.4 or more
LITTLE = 0.2
# bending along x, bending along y, torsion: fore-aft is where a nacelle looks, and without one there is no fore-aft; of
# a structure along a horizontal axis (`long_axis`) bending to the side, bending up and down, torsion, motion along it
TURBINE, NEUTRAL, SPANNING = ("FA", "SS", "T"), ("X", "Y", "T"), ("H", "V", "T", "A")
# which of these a family is
FAMILY = {name: k for names in (TURBINE, NEUTRAL, SPANNING) for k, name in enumerate(names)}
OTHER_AXIS = {first: second for pair in (TURBINE[:2], NEUTRAL[:2], SPANNING[:2])
              for first, second in (pair, pair[::-1])}


def family(label: str) -> str:
    """A label without its number."""
    return label.rstrip("0123456789")


def is_bending(label: str) -> bool:
    return family(label) in OTHER_AXIS


def label_across(label: str) -> str | None:
    """The label of bending in the other direction, of the same number; None of a label that is none of bending."""
    return OTHER_AXIS[family(label)] + label[len(family(label)) :] if is_bending(label) else None


def is_along_x(label: str) -> bool:
    """Whether it is the first of a pair of bending modes."""
    return FAMILY.get(family(label)) == 0


def about_vertical(label: str) -> bool:
    """Whether it is bending of what rises, whose two directions are alike as a nacelle turns."""
    return is_bending(label) and family(label) not in SPANNING


@dataclass(frozen=True, eq=False, kw_only=True)
class ModeCharacter:
    """How each mode moves: share (n_mode, n_family) of its kinetic energy, or of the squared motion at the sensors,
    that is of each family of names: fore-aft (with pitch), side-side (with roll) and rotation about the axis of each
    section as a rigid plane, of what spans its motion along the axis too; `local` (n_mode,) is the rest. They add up
    to 1.
    """

    share: np.ndarray
    local: np.ndarray
    labels: tuple[str, ...]


def mode_character(
    shape: np.ndarray, sensors: tuple[Sensor, ...], *, families: tuple[str, ...] = TURBINE,
    local_limit: float = LOCAL_LIMIT, axes: np.ndarray | None = None,
) -> ModeCharacter:
    """Label modes (n_channel, n_mode), ascending in frequency, rows in the sensors' order; `families` names bending
    along x, along y and torsion. axes (3, 3): across, up and along a structure that spans, named by SPANNING.

    Channels of one level, or section (see `sensors_by_height`), are fitted by a rigid plane's motion about the vertical
    axis through the origin, or the axis through the sensors' middle. A level with a single sensor position shows
    translation only. Modes with `local` above `local_limit` get labels L1, L2, ...: they belong to single members, not
    to the structure.
    """
    shape = np.asarray(shape, float)
    if axes is not None:
        sensors, families = _sensors_in_axes(axes, sensors), SPANNING
    direction = np.array([s.direction for s in sensors])
    position = np.array([s.position_m for s in sensors])
    place = {k: number for number, there in enumerate(sensors_by_place(sensors)) for k in there}
    n_mode = shape.shape[1]
    part = np.zeros((n_mode, len(families)))
    total = np.sum(shape**2, axis=0)
    for rows in sensors_by_height(sensors):
        d, (x, y, _) = direction[rows], position[rows].T
        several = len({place[k] for k in rows}) > 1
        # u = (u_x + ... , u_y + ..., r_x y - r_y x) of a rigid plane; pitch goes with FA, roll with SS
        motions = [(0, d[:, 0]), (1, d[:, 1])]
        if several:
            motions += [(0, -d[:, 2] * x), (1, d[:, 2] * y), (2, d[:, 1] * x - d[:, 0] * y)]
        if len(families) > 3:
            motions.append((3, d[:, 2]))
        motions = [(family, column) for family, column in motions if np.any(np.abs(column) > 1e-9)]
        if not motions:
            continue
        columns = np.column_stack([column for _, column in motions])
        amplitude, *_ = np.linalg.lstsq(columns, shape[rows], rcond=None)
        for family in range(len(families)):
            chosen = [k for k, (f, _) in enumerate(motions) if f == family]
            part[:, family] += np.sum((columns[:, chosen] @ amplitude[chosen]) ** 2, axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(total[:, None] > 0, part / total[:, None], 0.0)
    # a level that is not symmetric about the axis couples the three; then their sum may pass 1 a little
    share = share / np.maximum(share.sum(axis=1, keepdims=True), 1.0)
    local = 1 - share.sum(axis=1)
    return ModeCharacter(share=frozen_array(share), local=frozen_array(local),
                         labels=number_labels(share, local, families, local_limit))


def _sensors_in_axes(axes: np.ndarray, sensors: tuple[Sensor, ...]) -> tuple[Sensor, ...]:
    """Sensors in axes (3, 3) through the middle of their places."""
    places = np.array([sensors[there[0]].position_m for there in sensors_by_place(sensors)])
    middle = (places.min(axis=0) + places.max(axis=0)) / 2
    return tuple(Sensor(channel=s.channel, level=s.level, position_m=axes @ (s.position_m - middle),
                        direction=axes @ s.direction) for s in sensors)


def sensed_character(
    frequency_hz: np.ndarray, shape: np.ndarray, sensors: tuple[Sensor, ...], families: tuple[str, ...] = TURBINE
) -> ModeCharacter:
    """Of unit-mass shapes (n_channel, n_mode) whose frequencies (n_mode,) are known. Without a nacelle it spans if its
    sensors lie so, and give way as what spans does: the sum of phi^2 / omega^2 under loads along x, y and z."""
    axes = horizontal_axes(np.array([s.position_m for s in sensors])) if families != TURBINE else None
    toward = np.array([s.direction for s in sensors]) ** 2
    gives = np.sum((shape / frequency_hz) ** 2, axis=1) @ toward / np.maximum(toward.sum(axis=0), 1e-300)
    return mode_character(shape, sensors, families=families, axes=axes if spans(gives) else None)


def number_labels(
    share: np.ndarray, local: np.ndarray, families: tuple[str, ...], local_limit: float = LOCAL_LIMIT,
    frequency_hz: np.ndarray | None = None,
) -> tuple[str, ...]:
    """Names of modes, ascending in frequency, by where most of each is: share (n_mode, n_family), local (n_mode,).
    Where the frequencies (n_mode,) are given, two close modes that bend obliquely are one of either direction: in a
    symmetric structure no direction is preferred, and both may lean to the same."""
    kind = np.where(local > local_limit, len(families), np.argmax(share, axis=1)) if len(share) else np.zeros(0, int)
    # without frequencies none are close
    apart = np.full(len(kind), np.inf)
    if frequency_hz is not None:
        # free motions are at 0 Hz
        apart = np.diff(frequency_hz, prepend=-np.inf) / np.maximum(frequency_hz, np.finfo(float).tiny)
    for j in range(1, len(kind)):
        i, own, close = j - 1, kind[j], apart[j] < OBLIQUE_GAP
        if own == kind[i] and own < 2 and close and max(share[k, 1 - own] for k in (i, j)) > OBLIQUE:
            kind[i if share[i, 1 - own] > share[j, 1 - own] else j] = 1 - own
    names, count = (*families, LOCAL), dict.fromkeys(range(len(families) + 1), 0)
    labels = []
    for k in map(int, kind):
        count[k] += 1
        labels.append(f"{names[k]}{count[k]}")
    return tuple(labels)


def hardly_seen(shape: np.ndarray) -> np.ndarray:
    """(n_mode,) bool: modes of unit modal mass, shape (n_channel, n_mode), that hardly move a sensor beside others."""
    size = np.linalg.norm(shape, axis=0)
    return size <= UNSEEN * size.max(initial=0.0)


def moves_little(shape: np.ndarray) -> np.ndarray:
    """(n_mode,) bool: modes of unit modal mass, shape (n_channel, n_mode), that the sensors hardly see: they move these
    by a small share of what most modes do."""
    size = np.linalg.norm(shape, axis=0)
    return size < LITTLE * np.median(size)


def indistinguishable(labels: tuple[str, ...], frequency_hz: np.ndarray, shape: np.ndarray) -> tuple[str, ...]:
    """Sentences on modes that sensors, shape (n_channel, n_mode), do not see or do not distinguish."""
    if not len(shape):
        return ()
    hidden = hardly_seen(shape)
    named = [f"{label} ({f:.4g} Hz)" for label, f in zip(labels, frequency_hz, strict=True)]
    said = [f"{name} moves none of the sensors" for name, none in zip(named, hidden, strict=True) if none]
    alike = mac(shape, shape)
    for i, j in combinations(np.flatnonzero(~hidden), 2):
        if alike[i, j] > ALIKE_MAC:
            said.append(f"{named[i]} and {named[j]} have one shape at the sensors (MAC {alike[i, j]:.3f}): "
                        "distinguished by frequency alone")
    return tuple(said)


def close_pairs(frequency_hz: np.ndarray, labels: tuple[str, ...], gap: float = 0.1) -> tuple[tuple[int, int], ...]:
    """Pairs of bending, (FAk, SSk), (Xk, Yk) or (Hk, Vk), whose frequencies differ by less than `gap` of their mean: to
    be compared as a plane."""
    pairs = []
    for i, label in enumerate(labels):
        partner = label_across(label) if is_along_x(label) else None
        if partner in labels:
            j = labels.index(partner)
            if abs(frequency_hz[i] - frequency_hz[j]) < gap * 0.5 * (frequency_hz[i] + frequency_hz[j]):
                pairs.append((min(i, j), max(i, j)))
    return tuple(sorted(pairs))
