"""Where the kinetic energy of a computed mode is: in translation of the structure's axis along x and y, in rotation
about it, or in neither (single members, heave).

A mode is written as the motion of rigid horizontal sections, each turning about the vertical axis of the structure, and
a rest. With the momentum M phi the energy phi^T M phi divides into one share for each part, which add up to 1: what
is off the axis, such as a rotor, is counted with the tower that turns it, and what rotates counts by its inertia.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probupdate.modal.labels import LOCAL_LIMIT, TURBINE, ModeCharacter, numbered
from probupdate.modal.sensor_places import place_numbers
from probupdate.runtime.arrays import frozen_array

# of the structure's extent: nodes are at one level, or on one vertical line, within this
SAME_LEVEL = 1e-4
# of its horizontal extent: a node is on the axis, or the nodes of a level spread out, by this
OFF_AXIS = 0.02
# bands into which the height is cut where nodes form no levels, as those of an unstructured mesh
BANDS = 50


@dataclass(frozen=True, eq=False)
class DofPlaces:
    """Of each degree of freedom the place of its node, position_m (n_dof, 3), and its direction (n_dof,): 0, 1, 2
    motion along x, y, z, 3, 4, 5 rotation about them, -1 neither."""

    position_m: np.ndarray
    direction: np.ndarray


def vertical_axis(places: DofPlaces, mass: np.ndarray) -> np.ndarray:
    """(2,): x and y of the vertical line of nodes that rises farthest, as a tower does, or of the centre of mass where
    several rise as far. mass (n_dof,): the diagonal of M."""
    moves = (places.direction >= 0) & (places.direction < 3)
    position = places.position_m[moves]
    same = SAME_LEVEL * float(np.ptp(position, axis=0).max(initial=0.0)) or 1.0
    number = place_numbers(position[:, :2], same)
    low, high = (np.full(number.max() + 1, sign * np.inf) for sign in (1, -1))
    np.minimum.at(low, number, position[:, 2])
    np.maximum.at(high, number, position[:, 2])
    rise = high - low
    highest = np.flatnonzero(rise >= 0.99 * rise.max())
    if len(highest) == 1:
        return position[number == highest[0], :2].mean(axis=0)
    return np.average(position[:, :2], axis=0, weights=mass[moves])


def energy_character(
    phi: np.ndarray, momentum: np.ndarray, mass: np.ndarray, places: DofPlaces, *, frequency_hz: np.ndarray,
    families: tuple[str, str, str] = TURBINE, local_limit: float = LOCAL_LIMIT,
) -> ModeCharacter:
    """Label modes phi (n_dof, n_mode) of frequency_hz (n_mode,), ascending; momentum M phi, mass (n_dof,) the diagonal
    of M.

    Pitch goes with translation along x, roll with that along y. Sections are fitted at levels whose nodes show them: on
    the axis by its own motion, elsewhere by nodes apart from one another; between these they are interpolated. Modes
    with more than `local_limit` of their energy in the rest are L1, L2, ...
    """
    known = np.flatnonzero(places.direction >= 0)
    position = places.position_m[known] - np.append(vertical_axis(places, mass), 0.0)
    sections = _sections(phi[known], mass[known], position, places.direction[known])
    parts = np.zeros((3, *phi.shape))
    parts[:, known] = _parts(phi[known], sections, position, places.direction[known])
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (np.einsum("kdm,dm->km", parts, momentum) / np.sum(phi * momentum, axis=0)).T
    share = np.nan_to_num(share)
    local = 1 - share.sum(axis=1)
    return ModeCharacter(share=frozen_array(share), local=frozen_array(local),
                         labels=numbered(share, local, families, local_limit, frequency_hz))


def _levels(z: np.ndarray, same: float) -> np.ndarray:
    """(n,) the mean height of each entry's level: a new one begins where the next is higher by more than `same`."""
    order = np.argsort(z)
    number = np.empty(len(z), int)
    number[order] = np.cumsum(np.diff(z[order], prepend=z[order[0]]) > same)
    return (np.bincount(number, weights=z) / np.bincount(number))[number]


def _sections(phi, mass, position, direction) -> tuple[np.ndarray, np.ndarray]:
    """Heights (n_level,) and of each level (n_level, 5, n_mode): translation along x and y, rotation about z, about y
    (pitch) and about x (roll)."""
    width, height = float(np.ptp(position[:, :2], axis=0).max()), float(np.ptp(position[:, 2]))
    on_axis = np.hypot(position[:, 0], position[:, 1]) <= OFF_AXIS * width
    found = _rigid(phi, mass, position, direction, on_axis, _levels(position[:, 2], SAME_LEVEL * max(width, height)))
    if len(found) < 2 and not on_axis.all():
        found = _rigid(phi, mass, position, direction, on_axis, _levels(position[:, 2], height / BANDS)) or found
    if not found:
        return np.zeros(1), np.zeros((1, 5, phi.shape[1]))
    return np.array(list(found)), np.array(list(found.values()))


def _rigid(phi, mass, position, direction, on_axis, level) -> dict[float, np.ndarray]:
    found = {}
    least = OFF_AXIS * float(np.ptp(position[:, :2], axis=0).max())
    for z in np.unique(level):
        own = level == z
        apart = float(np.ptp(position[own, :2], axis=0).max()) > least
        if not apart and not on_axis[own].all():
            continue
        section = np.zeros((5, phi.shape[1]))
        # on the axis the section turns as its node does; a brace's node has a rotation of its own
        across = np.flatnonzero(own & ((direction < 2) | ((direction == 5) & on_axis)))
        section[:3] = _least_squares(
            phi[across], mass[across],
            np.stack([direction[across] == 0, direction[across] == 1, _rotation(position[across], direction[across])],
                     axis=1))
        up = np.flatnonzero(own & (direction == 2)) if apart else np.zeros(0, int)
        if len(up) > 1:
            x, y = position[up, 0], position[up, 1]
            section[3:] = _least_squares(phi[up], mass[up], np.stack([-x, y, np.ones(len(up))], axis=1))[:2]
        found[float(z)] = section
    return found


def _rotation(position: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """What a unit rotation about the axis moves: -y along x, x along y, 1 about z."""
    return np.select([direction == 0, direction == 1, direction == 5], [-position[:, 1], position[:, 0], 1.0], 0.0)


def _least_squares(motion: np.ndarray, mass: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Weighted by mass, which a rotation's inertia is in its own unit."""
    weight = np.sqrt(np.maximum(mass, 0.0))[:, None]
    return np.linalg.lstsq(columns * weight, motion * weight, rcond=None)[0]


def _parts(phi, sections, position, direction) -> np.ndarray:
    """(3, n, n_mode): what of the motion is translation along x with pitch, along y with roll, rotation about z."""
    z, of_level = sections
    flat = of_level.reshape(len(z), -1)
    at = np.searchsorted(z, position[:, 2]).clip(1, max(len(z) - 1, 1))
    if len(z) > 1:
        t = np.clip((position[:, 2] - z[at - 1]) / (z[at] - z[at - 1]), 0.0, 1.0)[:, None]
        flat = (1 - t) * flat[at - 1] + t * flat[at]
    else:
        flat = np.repeat(flat, len(position), axis=0)
    own = flat.reshape(len(position), *of_level.shape[1:])
    parts = np.zeros((3, *phi.shape))
    for family, along, pitch in ((0, 0, 3), (1, 1, 4)):
        moves = direction == along
        parts[family, moves] = own[moves, along]
        lift = direction == 2
        arm = (-position[lift, 0], position[lift, 1])[family]
        parts[family, lift] = arm[:, None] * own[lift, pitch]
        rotates = direction == (4, 3)[family]
        parts[family, rotates] = phi[rotates]
    parts[2] = _rotation(position, direction)[:, None] * own[:, 2]
    return parts
