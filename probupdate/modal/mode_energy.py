"""Where the kinetic energy of a computed mode is: in translation of the structure's axis across, in rotation about it,
or in neither (single members, heave).

A mode is written as the motion of rigid sections across the structure's axis, each turning about it, and a rest: the
axis is vertical of what rises and horizontal of what spans (`long_axis`), which moves along it too. With the momentum
M phi the energy phi^T M phi divides into one share for each part, which add up to 1: what is off the axis, such as a
rotor, is counted with the tower that turns it, and what rotates counts by its inertia.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probupdate.modal.labels import LOCAL_LIMIT, SPANNING, TURBINE, ModeCharacter, number_labels
from probupdate.modal.sensor_places import place_numbers
from probupdate.runtime.arrays import frozen_array

# of the structure's extent: nodes are at one level, or on one vertical line, within this
SAME_LEVEL = 1e-4
# of its horizontal extent: a node is on the axis, or the nodes of a level spread out, by this
OFF_AXIS = 0.02
# where nodes form no levels over this share of the length, as those of an unstructured mesh or of a skew deck, sections
# are fitted to all of them at once: one for so many nodes, at most so many
GAP, NODES, MOST = 1 / 3, 4, 50


@dataclass(frozen=True, eq=False)
class DofPlaces:
    """Of each degree of freedom its node (n_dof,), the node's place position_m (n_dof, 3), and its direction (n_dof,):
    0, 1, 2 motion along x, y, z, 3, 4, 5 rotation about them, -1 neither."""

    node: np.ndarray
    position_m: np.ndarray
    direction: np.ndarray

    @property
    def moves(self) -> np.ndarray:
        """(n_dof,) whether it is a translation."""
        return (self.direction >= 0) & (self.direction < 3)


def axis_line(places: DofPlaces, mass: np.ndarray, *, bent: bool = False) -> np.ndarray:
    """(2,) or (n_dof, 2): x and y of the line of nodes along z that reaches farthest, as a tower does, or of the centre
    of mass where several reach as far; bent: where no three nodes are on one, as of an arch, of the parabola that is
    nearest to them. mass (n_dof,): the diagonal of M."""
    moves = places.moves
    position = places.position_m[moves]
    same = SAME_LEVEL * float(np.ptp(position, axis=0).max(initial=0.0)) or 1.0
    number = place_numbers(position[:, :2], same)
    low, high = (np.full(number.max() + 1, sign * np.inf) for sign in (1, -1))
    np.minimum.at(low, number, position[:, 2])
    np.maximum.at(high, number, position[:, 2])
    rise = high - low
    if bent:
        nodes = np.bincount(np.unique(np.column_stack([number, places.node[moves]]), axis=0)[:, 0])
        rise = np.where(nodes > 2, rise, 0.0)
        if not rise.any():
            degree = min(2, len(np.unique(position[:, 2])) - 1)
            fit = np.polyfit(position[:, 2], position[:, :2], degree, w=np.sqrt(mass[moves]))
            return np.vander(places.position_m[:, 2], degree + 1) @ fit
    highest = np.flatnonzero(rise >= 0.99 * rise.max())
    if len(highest) == 1:
        return position[number == highest[0], :2].mean(axis=0)
    return np.average(position[:, :2], axis=0, weights=mass[moves] if mass[moves].any() else None)


def energy_character(
    phi: np.ndarray, momentum: np.ndarray, mass: np.ndarray, places: DofPlaces, *, frequency_hz: np.ndarray,
    families: tuple[str, ...] = TURBINE, local_limit: float = LOCAL_LIMIT, axes: np.ndarray | None = None,
) -> ModeCharacter:
    """Label modes phi (n_dof, n_mode) of frequency_hz (n_mode,), ascending; momentum M phi, mass (n_dof,) the diagonal
    of M; axes (3, 3) across, up and along a structure that spans, named by SPANNING.

    Pitch goes with translation along x, roll with that along y. Sections are fitted at levels whose nodes show them: on
    the axis by its own motion, elsewhere by nodes apart from one another; between these they are interpolated. Modes
    with more than `local_limit` of their energy in the rest are L1, L2, ...
    """
    if axes is not None:
        phi, momentum, mass, places = _turn_into_axes(phi, momentum, mass, places, axes)
        families = SPANNING
    known = np.flatnonzero(places.direction >= 0)
    position = np.array(places.position_m)
    position[:, :2] -= axis_line(places, mass, bent=axes is not None)
    position = position[known]
    sections = _sections(phi[known], mass[known], position, places.direction[known])
    parts = np.zeros((len(families), *phi.shape))
    parts[:, known] = _parts(phi[known], sections, position, places.direction[known])[:len(families)]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (np.einsum("kdm,dm->km", parts, momentum) / np.sum(phi * momentum, axis=0)).T
    share = np.nan_to_num(share)
    local = 1 - share.sum(axis=1)
    return ModeCharacter(share=frozen_array(share), local=frozen_array(local),
                         labels=number_labels(share, local, families, local_limit, frequency_hz))


def _turn_into_axes(phi, momentum, mass, places: DofPlaces, axes: np.ndarray):
    """The same in axes (3, 3) in place of x, y and z. Of a node that moves along one horizontal axis alone it is along
    the nearer of the new ones."""
    phi, momentum, mass = (np.array(x, float) for x in (phi, momentum, mass))
    direction = np.array(places.direction)
    for first in (0, 3):
        direction[places.direction == first + 2] = first + 1
        row_x, row_y = (np.flatnonzero(places.direction == first + k) for k in (0, 1))
        _, i, j = np.intersect1d(places.node[row_x], places.node[row_y], return_indices=True)
        both = np.array([row_x[i], row_y[j]])
        for k, rows in ((0, np.delete(row_x, i)), (1, np.delete(row_y, j))):
            nearer = 2 * int(abs(axes[2, k]) > abs(axes[0, k]))
            direction[rows] = first + nearer
            phi[rows], momentum[rows] = (np.sign(axes[nearer, k]) * x[rows] for x in (phi, momentum))
        turn = axes[[0, 2], :2]
        for x, by in ((phi, turn), (momentum, turn), (mass, turn**2)):
            x[both] = np.einsum("ab,b...->a...", by, x[both])
        direction[both[0]], direction[both[1]] = first, first + 2
    return phi, momentum, mass, DofPlaces(node=places.node, position_m=places.position_m @ axes.T, direction=direction)


def _levels(z: np.ndarray, same: float) -> np.ndarray:
    """(n,) the mean height of each entry's level: a new one begins where the next is higher by more than `same`."""
    order = np.argsort(z)
    number = np.empty(len(z), int)
    number[order] = np.cumsum(np.diff(z[order], prepend=z[order[0]]) > same)
    return (np.bincount(number, weights=z) / np.bincount(number))[number]


def _sections(phi, mass, position, direction) -> tuple[np.ndarray, np.ndarray]:
    """Heights (n_level,) and of each level (n_level, 6, n_mode): translation along x and y, rotation about z, about y
    (pitch) and about x (roll), translation along z."""
    width, height = float(np.ptp(position[:, :2], axis=0).max()), float(np.ptp(position[:, 2]))
    same = SAME_LEVEL * max(width, height)
    spread = max(OFF_AXIS * width, same)
    on_axis = np.hypot(position[:, 0], position[:, 1]) <= spread
    found = _rigid_body_energy(phi, mass, position, direction, on_axis, _levels(position[:, 2], same), spread)
    z = np.array(list(found))
    if height > 0 and _gap(z, position[:, 2], same) > GAP * height:
        return _fit_sections(phi, mass, position, direction, on_axis)
    if not found:
        return np.zeros(1), np.zeros((1, 6, phi.shape[1]))
    return z, np.array(list(found.values()))


def _gap(found: np.ndarray, z: np.ndarray, same: float) -> float:
    """The longest way between neighbouring sections, or to an end, on which there are nodes of none."""
    none = z[np.all(np.abs(z[:, None] - found) > same, axis=1)]
    edges = np.concatenate([[z.min()], found, [z.max()]])
    after = np.clip(np.searchsorted(edges, none), 1, len(edges) - 1)
    return float(np.max(edges[after] - edges[after - 1], initial=0.0))


def _fit_sections(phi, mass, position, direction, on_axis) -> tuple[np.ndarray, np.ndarray]:
    """As `_sections`: those whose motion, linear between them, is nearest to that of all nodes."""
    z = position[:, 2]
    count = int(np.clip(len(np.unique(position, axis=0)) // NODES, 2, MOST))
    sections = np.linspace(z.min(), z.max(), count)
    # how much of each section a node's own is
    weight = np.maximum(1 - np.abs(z[:, None] - sections) / (sections[1] - sections[0]), 0.0)
    found = np.zeros((count, 6, phi.shape[1]))
    x, y = position[:, 0], position[:, 1]
    across = np.flatnonzero((direction < 2) | ((direction == 5) & on_axis))
    for first, rows, columns in (
        (0, across, (direction == 0, direction == 1, _rotation(position, direction))),
        (3, np.flatnonzero(direction == 2), (-x, y, np.ones(len(z)))),
    ):
        moved = np.stack(columns, axis=1)[rows, None, :] * weight[rows, :, None]
        found[:, first:first + 3] = _least_squares(
            phi[rows], mass[rows], moved.reshape(len(rows), 3 * count)).reshape(count, 3, phi.shape[1])
    return sections, found


def _rigid_body_energy(phi, mass, position, direction, on_axis, level, spread) -> dict[float, np.ndarray]:
    found = {}
    for z in np.unique(level):
        own = level == z
        apart = float(np.ptp(position[own, :2], axis=0).max()) > spread
        if not apart and not on_axis[own].all():
            continue
        section = np.zeros((6, phi.shape[1]))
        # on the axis the section turns as its node does; a brace's node has a rotation of its own
        across = np.flatnonzero(own & ((direction < 2) | ((direction == 5) & on_axis)))
        section[:3] = _least_squares(
            phi[across], mass[across],
            np.stack([direction[across] == 0, direction[across] == 1, _rotation(position[across], direction[across])],
                     axis=1))
        up = np.flatnonzero(own & (direction == 2))
        if len(up) > 1 or not apart:
            x, y = position[up].T[:2] if apart else np.zeros((2, len(up)))
            section[3:] = _least_squares(phi[up], mass[up], np.stack([-x, y, np.ones(len(up))], axis=1))
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
    """(4, n, n_mode): what of the motion is translation along x with pitch, along y with roll, rotation about z,
    translation along z."""
    z, of_level = sections
    flat = of_level.reshape(len(z), -1)
    at = np.searchsorted(z, position[:, 2]).clip(1, max(len(z) - 1, 1))
    if len(z) > 1:
        t = np.clip((position[:, 2] - z[at - 1]) / (z[at] - z[at - 1]), 0.0, 1.0)[:, None]
        flat = (1 - t) * flat[at - 1] + t * flat[at]
    else:
        flat = np.repeat(flat, len(position), axis=0)
    own = flat.reshape(len(position), *of_level.shape[1:])
    parts = np.zeros((4, *phi.shape))
    lift = direction == 2
    parts[3, lift] = own[lift, 5]
    for family, along, pitch in ((0, 0, 3), (1, 1, 4)):
        moves = direction == along
        parts[family, moves] = own[moves, along]
        arm = (-position[lift, 0], position[lift, 1])[family]
        parts[family, lift] = arm[:, None] * own[lift, pitch]
        rotates = direction == (4, 3)[family]
        parts[family, rotates] = phi[rotates]
    parts[2] = _rotation(position, direction)[:, None] * own[:, 2]
    return parts
