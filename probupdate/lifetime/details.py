"""Where fatigue is looked at: ends of braces at legs and crossings, girth welds; hot spots round their circumference.

Hot-spot stress after DNV-RP-C203 (2011), eq. 3.3.1, at eight places from crown to saddle: the axial stress by factors
of crown and saddle and their mean between, bending in plane by the cosine and out of plane by the sine of the place's
angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from probupdate.errors import InputError
from probupdate.lifetime.conditions import Conditions, Factors
from probupdate.modes import frozen_array
from probupdate.structure.beam import Tube
from probupdate.structure.description import nearest
from probupdate.structure.frame import Beam, Frame

PLACES = 8
SAME_POINT_M = 1e-6
# how far a girth weld may be from the end of an element
REACH_M = 0.5


@dataclass(frozen=True, eq=False, kw_only=True)
class Detail:
    """A member's end: `number` of its element in the frame, `end` 0 or 1, the weld's `joint` and place; along (3,) from
    the element's start to its end, crown (3,) and saddle (3,) unit vectors across it. chord: the wall on the other
    side; section: whose A and I stress is of."""

    name: str
    joint: str
    part: str
    chord_part: str
    level_m: float
    at: str
    bay: int | None
    upper: bool
    leg: str
    number: int
    end: int
    along: np.ndarray
    crown: np.ndarray
    saddle: np.ndarray
    beam: Beam
    chord: Beam | None
    section: Tube

    def rows(self) -> np.ndarray:
        """(3, 12): axial force and the moments that pull at crown and saddle, from the element's end forces, global.

        Stress at a point r of the section is N / A + M (r x along) / I, M on the face that looks along the member."""
        sign = 1.0 if self.end else -1.0
        found = np.zeros((3, 12))
        at = 6 * self.end
        found[0, at : at + 3] = sign * self.along
        found[1, at + 3 : at + 6] = sign * np.cross(self.crown, self.along)
        found[2, at + 3 : at + 6] = sign * np.cross(self.saddle, self.along)
        return found


@dataclass(frozen=True, eq=False, kw_only=True)
class HotSpot:
    """One of eight places (1 is the crown, 3 the saddle) of one side of a detail: weight (3,) of its nominal stresses,
    thickness effect included; the curve's name."""

    detail: int
    side: str
    place: int
    weight: np.ndarray
    curve: str

    def angle_deg(self) -> float:
        return 45.0 * (self.place - 1)


def brace_ends(frame: Frame) -> list[Detail]:
    """Every end of a brace at a leg or at its crossing, by bays' names as the frame has them."""
    legs = {}
    for b in frame.beams:
        if b.group == "leg":
            for node in (b.start, b.end):
                legs.setdefault(_key(frame.node_m[node]), b)
    members: dict[str, list[int]] = {}
    for number, b in enumerate(frame.beams):
        if b.group == "brace":
            members.setdefault(b.part, []).append(number)
    at_node: dict[tuple, list[int]] = {}
    for numbers in members.values():
        for number in numbers:
            for node in (frame.beams[number].start, frame.beams[number].end):
                at_node.setdefault(_key(frame.node_m[node]), []).append(number)
    found = []
    for part, numbers in members.items():
        middle = (
            np.mean([frame.node_m[frame.beams[k].start][2] + frame.node_m[frame.beams[k].end][2] for k in numbers]) / 2
        )
        for number in numbers:
            b = frame.beams[number]
            for end, node in enumerate((b.start, b.end)):
                place = frame.node_m[node]
                key = _key(place)
                others = [k for k in at_node[key] if frame.beams[k].part != part]
                if key in legs:
                    chord, at = legs[key], "leg"
                elif others:
                    chord, at = frame.beams[others[0]], "crossing"
                else:
                    continue
                found.append(_brace_end(frame, number, end, chord, at, bool(place[2] > middle)))
    return found


def _brace_end(frame: Frame, number: int, end: int, chord: Beam, at: str, upper: bool) -> Detail:
    b = frame.beams[number]
    start, stop = frame.node_m[b.start], frame.node_m[b.end]
    along = (stop - start) / np.linalg.norm(stop - start)
    axis = frame.node_m[chord.end] - frame.node_m[chord.start]
    axis = axis * (1.0 if axis[2] >= 0 else -1.0)
    crown = axis - along * (axis @ along)
    crown /= np.linalg.norm(crown)
    away = along if end == 0 else -along
    place = (start, stop)[end]
    bay = b.part.rsplit("-", 1)[-1]
    joint = f"{chord.part} at {place[2]:.2f} m" if at == "leg" else f"crossing {b.part} and {chord.part}"
    half = "" if at == "leg" else f", {'lower' if end else 'upper'} half"
    return Detail(
        name=f"{b.part}, {joint if at == 'leg' else 'crossing'}{half}",
        joint=joint,
        part=b.part,
        chord_part=chord.part,
        level_m=float(place[2]),
        at=at,
        bay=int(bay) if bay.isdigit() else None,
        upper=upper,
        leg=chord.part.removeprefix("leg ") if at == "leg" else "",
        number=number,
        end=end,
        along=frozen_array(along),
        crown=frozen_array(crown),
        saddle=frozen_array(np.cross(away, crown)),
        beam=b,
        chord=chord,
        section=b.tube,
    )


def girth(frame: Frame, part: str, z_m: float, where: str) -> Detail:
    """The end of an element of `part` nearest to the level; place 1 looks along x, the angle counts
    counter-clockwise."""
    ends = [
        (abs(frame.node_m[node][2] - z_m), number, end)
        for number, b in enumerate(frame.beams)
        if b.part == part
        for end, node in enumerate((b.start, b.end))
    ]
    if not ends:
        raise InputError(where, f"part '{part}' is not in the model", nearest(part, frame.parts))
    gap, number, end = min(ends)
    b = frame.beams[number]
    if gap > REACH_M or b.springs is not None:
        problem = f"its nearest element ends {gap:.2f} m from {z_m:g} m" if b.springs is None else "is a pile in soil"
        raise InputError(where, problem, "choose the level of an element's end, of a member above the soil")
    start, stop = frame.node_m[b.start], frame.node_m[b.end]
    along = (stop - start) / np.linalg.norm(stop - start)
    upward = along if along[2] >= 0 else -along
    helper = np.array([1.0, 0.0, 0.0]) if abs(along[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    crown = helper - along * (helper @ along)
    crown /= np.linalg.norm(crown)
    level = float((start, stop)[end][2])
    return Detail(
        name=f"{part} at {level:.2f} m",
        joint=f"{part} at {level:.2f} m",
        part=part,
        chord_part=part,
        level_m=level,
        at="girth",
        bay=None,
        upper=False,
        leg="",
        number=number,
        end=end,
        along=frozen_array(along),
        crown=frozen_array(crown),
        saddle=frozen_array(np.cross(upward, crown)),
        beam=b,
        chord=None,
        section=b.tube,
    )


def find_details(frame: Frame, conditions: Conditions, where: str) -> tuple[tuple[Detail, ...], tuple[HotSpot, ...]]:
    """What [[joint]] and [[girth]] choose; raises InputError where a table chooses nothing, or two the same side."""
    ends = brace_ends(frame)
    details: list[Detail] = []
    spots: list[HotSpot] = []
    number: dict[tuple, int] = {}
    sides: set[tuple[int, str]] = set()

    def index(detail: Detail) -> int:
        key = (detail.number, detail.end)
        if key not in number:
            number[key] = len(details)
            details.append(detail)
        return number[key]

    for k, entry in enumerate(conditions.joint):
        here = f"{where}: joint[{k + 1}]"
        chosen = [
            d
            for d in ends
            if d.at == entry.at
            and (not entry.bay or d.bay in entry.bay)
            and (not entry.leg or d.leg in entry.leg)
            and (entry.end == "all" or d.upper == (entry.end == "upper"))
        ]
        if not chosen:
            raise InputError(here, "chooses no brace end of the model", "widen bay, leg or end")
        for detail in chosen:
            for side, factors in (("chord", entry.chord), ("brace", entry.brace)):
                if factors is None:
                    continue
                at = index(detail)
                if (at, side) in sides:
                    raise InputError(
                        here,
                        f"{detail.name}, {side} side, is chosen by a table before it too",
                        "let each end be chosen once",
                    )
                sides.add((at, side))
                tube = (detail.beam if side == "brace" else detail.chord).tube
                spots += _round(at, side, factors, _thickness(conditions, entry.curve, tube.thickness_m), entry.curve)
    for k, entry in enumerate(conditions.girth):
        detail = girth(frame, entry.part, entry.z_m, f"{where}: girth[{k + 1}]")
        by = Factors(
            axial_crown=entry.factor, axial_saddle=entry.factor, in_plane=entry.factor, out_of_plane=entry.factor
        )
        at = index(detail)
        wall = detail.beam.tube.thickness_m
        spots += _round(at, "weld", by, _thickness(conditions, entry.curve, wall), entry.curve)
    return tuple(details), tuple(spots)


def _round(at: int, side: str, f: Factors, scale: float, curve: str) -> list[HotSpot]:
    spots = []
    for k in range(PLACES):
        angle = np.pi / 4 * k
        axial = (f.axial_crown, 0.5 * (f.axial_crown + f.axial_saddle), f.axial_saddle)[(0, 1, 2, 1)[k % 4]]
        weight = scale * np.array([axial, f.in_plane * np.cos(angle), f.out_of_plane * np.sin(angle)])
        spots.append(HotSpot(detail=at, side=side, place=k + 1, weight=frozen_array(weight), curve=curve))
    return spots


def _thickness(conditions: Conditions, curve: str, wall_m: float) -> float:
    """(t / t_ref)^k of walls above t_ref, else 1 (DNV-RP-C203, eq. 2.4.3)."""
    law = conditions.curve[curve]
    return max(1.0, wall_m / law.reference_thickness_m) ** law.thickness_exponent


def weights(spots: Sequence[HotSpot]) -> tuple[np.ndarray, np.ndarray]:
    """Detail of each hot spot (n_spot,), weights (n_spot, 3)."""
    return np.array([s.detail for s in spots]), np.array([s.weight for s in spots])


def _key(position: np.ndarray) -> tuple:
    return tuple(np.round(position / SAME_POINT_M / 10).astype(np.int64).tolist())
