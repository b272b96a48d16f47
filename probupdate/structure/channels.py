"""From sensors to rows that read the frame's motion: u + theta x r of the nearest point of the named part, or of one
farther along its member, and the rotation theta there, through which gravity is felt."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import cast

import numpy as np
from scipy import sparse

from probupdate.errors import InputError
from probupdate.modal.modes import Sensor
from probupdate.runtime.arrays import frozen_array
from probupdate.structure import beam as beams
from probupdate.structure.assembly import node_dofs, rigid_motion
from probupdate.structure.frame import Beam, Frame
from probupdate.structure.moved_channels import MovedChannels
from probupdate.structure.plausible_size import other_unit_words
from probupdate.structure.readings import rotation_reading
from probupdate.structure.schema import suggest

# how far from a part's surface a sensor may sit
REACH_M = 2.0
# members whose nodes lie this near to one straight line are one
STRAIGHT_M = 0.01
# least rise of a member by which one end is the upper one
RISES = 0.1
# of an element, four places where a cubic is known by
THIRDS = np.array([0.0, 1 / 3, 2 / 3, 1.0])


@dataclass(frozen=True, eq=False, kw_only=True)
class Attachment:
    """Where a sensor sits: the beam, the fraction xi of its length, and the arm from its axis to the sensor."""

    beam: Beam
    xi: float
    arm_m: np.ndarray
    gap_m: float


def attach(frame: Frame, position_m: np.ndarray, part: str | None) -> Attachment:
    """The nearest point of the part (of any part where None); gap_m is the distance from its surface, 0 inside."""
    best: tuple[tuple[float, float], Attachment] | None = None
    for beam in frame.beams:
        if part is not None and beam.part != part:
            continue
        start, end = frame.node_m[beam.start], frame.node_m[beam.end]
        span = end - start
        xi = float(np.clip((position_m - start) @ span / (span @ span), 0.0, 1.0))
        arm = position_m - (start + xi * span)
        distance = float(np.linalg.norm(arm))
        gap = max(0.0, distance - 0.5 * beam.tube.diameter_m)
        if best is None or (gap, distance) < best[0]:
            best = (gap, distance), Attachment(beam=beam, xi=xi, arm_m=arm, gap_m=gap)
    if best is None:
        raise ValueError(f"the frame has no beam of part {part}")
    return best[1]


@dataclass(frozen=True, eq=False, kw_only=True)
class Line:
    """The straight line of members through a sensor's point of attachment, `up` its upward direction: each beam with
    its lower and upper end in metres from there, adjoining, from the lowest to the highest."""

    up: np.ndarray
    pieces: tuple[tuple[float, float, Beam], ...]
    arm_m: np.ndarray

    @property
    def ends(self) -> tuple[float, float]:
        return self.pieces[0][0], self.pieces[-1][1]

    def attach(self, frame: Frame, along_m: float) -> Attachment:
        """Where a sensor sits that is so much farther up, its arm as it is."""
        low, high, beam = next(p for p in self.pieces if along_m <= p[1] or p is self.pieces[-1])
        share = (along_m - low) / (high - low)
        rises = (frame.node_m[beam.end] - frame.node_m[beam.start]) @ self.up > 0
        return Attachment(beam=beam, xi=share if rises else 1 - share, arm_m=self.arm_m, gap_m=0.0)


def line_of(frame: Frame, found: Attachment) -> Line | None:
    """None where the member has no upper end."""
    start, end = frame.node_m[found.beam.start], frame.node_m[found.beam.end]
    up = (end - start) / np.linalg.norm(end - start)
    if abs(up[2]) < RISES:
        return None
    up = up * np.sign(up[2])
    away = np.asarray(frame.node_m) - (start + found.xi * (end - start))
    along = away @ up
    straight = np.linalg.norm(away - along[:, None] * up, axis=1) < STRAIGHT_M
    own = sorted(((float(along[[b.start, b.end]].min()), float(along[[b.start, b.end]].max()), b) for b in frame.beams
                  if straight[b.start] and straight[b.end]), key=lambda piece: piece[:2])
    # of two beams between the same nodes one is enough, and beyond a gap begins another member
    pieces: list[tuple[float, float, Beam]] = []
    for piece in own:
        if pieces and piece[0] > pieces[-1][1] + STRAIGHT_M:
            if pieces[-1][1] >= -STRAIGHT_M:
                break
            pieces = []
        if not pieces or piece[1] > pieces[-1][1] + STRAIGHT_M:
            pieces.append(piece)
    return Line(up=up, pieces=tuple(pieces), arm_m=found.arm_m)


@dataclass(frozen=True, kw_only=True)
class Move:
    """A parameter of the description that says how much farther up along their members channels sit: its value where it
    is fixed, or its number among the updated ones with its bounds."""

    name: str
    channels: tuple[str, ...]
    fixed_m: float = 0.0
    column: int | None = None
    low_m: float = 0.0
    high_m: float = 0.0


def channel_rows(
    frame: Frame, sensors: tuple[Sensor, ...], parts: dict[str, str], where: str, moves: Sequence[Move] = ()
) -> tuple[sparse.csr_array, tuple[MovedChannels, ...]]:
    """(2 n_channel, 6 n_node): the channels' motions and below them their tilts (see `readings`), and what the updated
    ones of `moves` make of them. `parts`: the part each channel sits on; a channel without one takes the nearest."""
    found = list(attachments(frame, sensors, parts, where))
    numbers = {sensor.channel: k for k, sensor in enumerate(sensors)}
    moved: list[MovedChannels] = []
    # what is fixed comes first: the others begin there
    for move in sorted(moves, key=lambda m: m.column is not None):
        lines = {}
        for channel in move.channels:
            if channel in numbers:
                k = numbers[channel]
                lines[k] = _channel_line(frame, found[k], move, f"{where}: parameter {move.name}", channel)
        if not lines:
            raise InputError(f"{where}: parameter {move.name}", "none of its channels is among the sensors",
                             f"name some of {', '.join(numbers) or 'the sensors, of which there are none'}")
        if move.column is None:
            for k, line in lines.items():
                found[k] = line.attach(frame, move.fixed_m)
        else:
            moved.append(_moving_channels(frame, sensors, lines, move))
    return _rows(frame, sensors, dict(enumerate(found))), tuple(moved)


def _channel_line(frame: Frame, found: Attachment, move: Move, where: str, channel: str) -> Line:
    line = line_of(frame, found)
    if line is None:
        raise InputError(where, f"the member of {channel} lies level", "leave the channel out")
    low, high = line.ends
    least, most = min(move.low_m, move.fixed_m), max(move.high_m, move.fixed_m)
    if least < low - STRAIGHT_M or most > high + STRAIGHT_M:
        raise InputError(where, f"{least:g} to {most:g} m takes {channel} off its member, which reaches from "
                         f"{low:.3g} to {high:.3g} m from there", "narrow its bounds")
    return line


def attachments(
    frame: Frame, sensors: Sequence[Sensor], parts: dict[str, str], where: str
) -> Iterator[Attachment]:
    """Of each sensor."""
    for sensor in sensors:
        label = f"{where}: sensor {sensor.channel}"
        part = parts.get(sensor.channel)
        if part is not None and part not in frame.parts:
            raise InputError(label, f"part '{part}' is not in the model", suggest(part, frame.parts))
        found = attach(frame, sensor.position_m, part)
        if found.gap_m > REACH_M:
            if scaled := other_unit_words(lambda f: _gaps(frame, sensors, parts, f), REACH_M):
                raise InputError(where, scaled, "correct position_m of every [[sensor]]")
            raise InputError(
                label, f"{found.gap_m:.1f} m from the surface of {part or 'any part'} (at most {REACH_M:.0f} m)",
                "check position_m: model axes, metres, z = 0 at mean sea level",
            )
        yield found


def _gaps(frame: Frame, sensors: Sequence[Sensor], parts: Mapping[str, str], factor: float) -> np.ndarray:
    """(n,) distances from the model's surface of sensors at their places times a factor."""
    known = (parts.get(s.channel) for s in sensors)
    return np.array([attach(frame, factor * s.position_m, part if part in frame.parts else None).gap_m
                     for s, part in zip(sensors, known, strict=True)])


def _moving_channels(frame: Frame, sensors: Sequence[Sensor], lines: Mapping[int, Line], move: Move) -> MovedChannels:
    """What sensors (by number) read that sit farther up their lines, within the bounds of `move`."""
    ends = [end for line in lines.values() for low, high, _ in line.pieces for end in (low, high)]
    inside = sorted(end for end in ends if move.low_m + STRAIGHT_M < end < move.high_m - STRAIGHT_M)
    knots = [move.low_m, *(end for k, end in enumerate(inside) if not k or end - inside[k - 1] > STRAIGHT_M),
             move.high_m]
    own = sorted(lines)
    taken = [*own, *(len(sensors) + k for k in own)]

    def read(h: float) -> sparse.csr_array:
        return _rows(frame, sensors, {k: lines[k].attach(frame, h) for k in own})[taken]

    here, powers = read(0.0), []
    for a, b in pairwise(knots):
        changes = [read(a + t * (b - a)) - here for t in THIRDS]
        powers.append(tuple(sparse.csr_array(sum(w * change for w, change in zip(weights, changes, strict=True)))
                            for weights in np.linalg.inv(THIRDS[:, None] ** np.arange(4))))
    onto = sparse.csr_array((np.ones(len(taken)), (taken, np.arange(len(taken)))),
                            shape=(2 * len(sensors), len(taken)))
    return MovedChannels(column=cast(int, move.column), knots=frozen_array(knots), onto=onto, powers=tuple(powers))


def _rows(frame: Frame, sensors: Sequence[Sensor], places: dict[int, Attachment]) -> sparse.csr_array:
    """(2 n_channel, 6 n_node) of the sensors that have a place, by number; others read nothing."""
    rows, columns, values = [], [], []
    n = len(sensors)
    for number, found in places.items():
        start, end = frame.node_m[found.beam.start], frame.node_m[found.beam.end]
        turn = np.kron(np.eye(4), beams.axes(start, end))
        at_axis = turn[:6, :6].T @ beams.interpolation(found.xi, float(np.linalg.norm(end - start))) @ turn
        moved, own = rigid_motion(found.arm_m) @ at_axis, sensors[number].direction
        for row, value in ((number, own @ moved[:3]), (n + number, rotation_reading(own) @ moved[3:])):
            rows.append(np.full(12, row))
            columns.append(node_dofs(found.beam.start, found.beam.end))
            values.append(value)
    shape = (2 * n, 6 * len(frame.node_m))
    if not rows:
        return sparse.csr_array(shape)
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return sparse.csr_array(sparse.coo_array(entries, shape=shape))
