"""From sensors to rows that read the frame's motion: u + theta x r of the nearest point of the named part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from probupdate.errors import InputError
from probupdate.modal.modes import Sensor
from probupdate.structure import beam as beams
from probupdate.structure.assembly import node_dofs, rigid_motion
from probupdate.structure.frame import Beam, Frame
from probupdate.structure.schema import nearest

# how far from a part's surface a sensor may sit
REACH_M = 2.0


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


def channel_rows(
    frame: Frame, sensors: tuple[Sensor, ...], parts: dict[str, str], where: str
) -> sparse.csr_array:
    """(n_channel, 6 n_node). `parts`: the part each channel sits on; a channel without one takes the nearest."""
    rows, columns, values = [], [], []
    for number, sensor in enumerate(sensors):
        label = f"{where}: sensor {sensor.channel}"
        part = parts.get(sensor.channel)
        if part is not None and part not in frame.parts:
            raise InputError(label, f"part '{part}' is not in the model", nearest(part, frame.parts))
        found = attach(frame, sensor.position_m, part)
        if found.gap_m > REACH_M:
            raise InputError(
                label, f"{found.gap_m:.1f} m from the surface of {part or 'any part'} (at most {REACH_M:.0f} m)",
                "check position_m: model axes, metres, z = 0 at mean sea level",
            )
        start, end = frame.node_m[found.beam.start], frame.node_m[found.beam.end]
        turn = np.kron(np.eye(4), beams.axes(start, end))
        at_axis = turn[:6, :6].T @ beams.interpolation(found.xi, float(np.linalg.norm(end - start))) @ turn
        row = sensor.direction @ (rigid_motion(found.arm_m) @ at_axis)[:3]
        rows.append(np.full(12, number))
        columns.append(node_dofs(found.beam.start, found.beam.end))
        values.append(row)
    shape = (len(sensors), 6 * len(frame.node_m))
    if not sensors:
        return sparse.csr_array(shape)
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return sparse.csr_array(sparse.coo_array(entries, shape=shape))
