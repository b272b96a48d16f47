"""Where fatigue is looked at: ends of braces at legs and crossings, girth welds; hot spots round their circumference.

Hot-spot stress after DNV-RP-C203 (2011), section 3.3, at eight places from crown to saddle: the axial stress by factors
of crown and saddle and their mean between, bending in plane by the cosine and out of plane by the sine of the place's
angle.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, cast

import numpy as np

from probupdate.errors import InputError
from probupdate.lifetime import efthymiou
from probupdate.lifetime.conditions import Conditions, Efthymiou, Factors, Sides
from probupdate.modal.sensor_places import place_numbers
from probupdate.runtime.arrays import frozen_array
from probupdate.structure.beam import Tube
from probupdate.structure.coefficient import Values
from probupdate.structure.description import Description, station_pairs, tube_between_stations
from probupdate.structure.description import Section as Station
from probupdate.structure.frame import Beam, Frame
from probupdate.structure.schema import suggest

PLACES = 8
SAME_POINT_M = 1e-5
# how far a girth weld may be from the end of an element
REACH_M = 0.5
# two braces of a K joint lie in one plane with their chord, to the cosine of half a degree
ONE_PLANE = 0.99996


class Section(Hashable, Protocol):
    """A circular section as stress needs it, of any kind of model; m, m^2, m^4 at given parameter values."""

    @property
    def diameter_m(self) -> float: ...

    @property
    def thickness_m(self) -> float: ...

    def outer(self, values: Values) -> Any: ...

    def area(self, values: Values) -> Any: ...

    def second_moment(self, values: Values) -> Any: ...


class WalledMember(Protocol):
    """A member with such a section."""

    @property
    def tube(self) -> Section: ...


@dataclass(frozen=True, eq=False, kw_only=True)
class Detail:
    """A member's end: `number` of its element in the frame, `end` 0 or 1, the weld's `joint` and place; along (3,) from
    the element's start to its end, crown (3,) and saddle (3,) unit vectors across it. chord: the wall on the other
    side; section: whose A and I stress is of."""

    name: str
    joint: str
    part: str
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
    beam: WalledMember
    chord: WalledMember | None
    section: Section
    place_m: np.ndarray
    chord_along: np.ndarray | None = None

    @property
    def along_brace(self) -> np.ndarray:
        """(3,) from the weld along the brace."""
        return -self.along if self.end else self.along

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
    """One of eight places (1 is the crown, 3 the saddle) of one side of a detail: weight (3,) of its nominal stresses;
    the curve's name, and the thickness_effect by which stress ranges are multiplied before the curve is read."""

    detail: int
    side: str
    place: int
    weight: np.ndarray
    curve: str
    thickness_effect: float

    def angle_deg(self) -> float:
        return 45.0 * (self.place - 1)


def brace_ends(frame: Frame) -> list[Detail]:
    """Every end of a brace at a leg or at its crossing, by bays' names as the frame has them."""
    place_of, legs = place_numbers(frame.node_m, SAME_POINT_M).tolist(), {}
    for b in frame.beams:
        if b.group == "leg":
            for node in (b.start, b.end):
                legs.setdefault(place_of[node], b)
    members: dict[str, list[int]] = {}
    for number, b in enumerate(frame.beams):
        if b.group == "brace":
            members.setdefault(b.part, []).append(number)
    at_place: dict[int, list[int]] = {}
    for numbers in members.values():
        for number in numbers:
            for node in (frame.beams[number].start, frame.beams[number].end):
                at_place.setdefault(place_of[node], []).append(number)
    found = []
    for part, numbers in members.items():
        middle = (
            np.mean([frame.node_m[frame.beams[k].start][2] + frame.node_m[frame.beams[k].end][2] for k in numbers]) / 2
        )
        for number in numbers:
            b = frame.beams[number]
            for end, node in enumerate((b.start, b.end)):
                place = place_of[node]
                others = [k for k in at_place[place] if frame.beams[k].part != part]
                if place in legs:
                    chord, at = legs[place], "leg"
                elif others:
                    chord, at = frame.beams[others[0]], "crossing"
                else:
                    continue
                found.append(_brace_end(frame, number, end, chord, at, bool(frame.node_m[node][2] > middle)))
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
        place_m=frozen_array(place),
        chord_along=frozen_array(axis / np.linalg.norm(axis)),
    )


def _tube_at(tube: Tube, stations: Sequence[Station], z_m: float, middle_m: float) -> Tube:
    """An element's tube with the size of its own end: elements between stations have that of their middle, which also
    says on which side of a step the end is."""
    for low, high in station_pairs(stations):
        if low.z_m <= middle_m <= high.z_m:
            size = tube_between_stations(low, high, z_m)
            return replace(tube, diameter_m=size.diameter_m, thickness_m=size.thickness_m)
    return tube


def girth(frame: Frame, tapers: Mapping[str, Sequence[Station]], part: str, z_m: float, where: str) -> Detail:
    """The end of an element of `part` nearest to the level, at a step that with the thinner wall; place 1 looks along
    x, the angle counts counter-clockwise."""
    def section(number: int, end: int) -> Tube:
        b = frame.beams[number]
        levels = [float(frame.node_m[node][2]) for node in (b.start, b.end)]
        return _tube_at(b.tube, tapers.get(part, ()), levels[end], 0.5 * sum(levels))

    ends = [
        (abs(frame.node_m[node][2] - z_m), round(section(number, end).thickness_m, 9), number, end)
        for number, b in enumerate(frame.beams)
        if b.part == part
        for end, node in enumerate((b.start, b.end))
    ]
    if not ends:
        raise InputError(where, f"part '{part}' is not in the model", suggest(part, frame.parts))
    gap, _, number, end = min(ends)
    b = frame.beams[number]
    if gap > REACH_M:
        level = float(frame.node_m[b.start if end == 0 else b.end][2])
        raise InputError(where, f"{z_m:g} m is no element's end, the nearest is at {level:.6g} m",
                         "choose the level of an element's end")
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
        section=section(number, end),
        place_m=frozen_array((start, stop)[end]),
    )


def find_details(
    d: Description, frame: Frame, conditions: Conditions, where: str
) -> tuple[tuple[Detail, ...], tuple[HotSpot, ...]]:
    """What [[joint]] and [[girth]] choose; raises InputError where a table chooses nothing, or two the same side."""
    refuse_tables(conditions, where, "member_end", "site", reason="is for SubDyn models; this one is a model.toml's")
    ends = brace_ends(frame)
    chosen = []
    for k, entry in enumerate(conditions.joint):
        chosen.append(
            (
                f"{where}: joint[{k + 1}]",
                entry,
                [
                    one
                    for one in ends
                    if one.at == entry.at
                    and (not entry.bay or one.bay in entry.bay)
                    and (not entry.leg or one.leg in entry.leg)
                    and (entry.end == "all" or one.upper == (entry.end == "upper"))
                ],
            )
        )
    welds = [[girth(frame, d.tapers, e.part, e.z_m, f"{where}: girth[{k + 1}]")]
             for k, e in enumerate(conditions.girth)]
    return hot_spots(conditions, chosen, ends, welds)


def refuse_tables(conditions: Conditions, where: str, *names: str, reason: str) -> None:
    """Raises InputError where a fatigue.toml has tables of another kind of model."""
    for name in names:
        if getattr(conditions, name):
            raise InputError(f"{where}: {name}", reason, "take it out")


def hot_spots(
    conditions: Conditions,
    chosen: Sequence[tuple[str, Sides, Sequence[Detail]]],
    ends: Sequence[Detail],
    welds: Sequence[Sequence[Detail]],
) -> tuple[tuple[Detail, ...], tuple[HotSpot, ...]]:
    """Of brace ends that tables (where, table, details) choose among all `ends`, and of the girth welds (a list for
    each [[girth]])."""
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

    for here, entry, found in chosen:
        if not found:
            raise InputError(here, "chooses no brace end of the model",
                             "widen what narrows it, or name welds of a structure without braces by [[girth]]")
        for detail in found:
            for side, factors in _factors(entry, detail, ends, here):
                at = index(detail)
                if (at, side) in sides:
                    raise InputError(
                        here,
                        f"{detail.name}, {side} side, is chosen by an earlier table already",
                        "let each end be chosen once",
                    )
                sides.add((at, side))
                tube = detail.section if side == "brace" else _chord(detail).tube
                spots += _round(at, side, factors, entry.curve, _thickness(conditions, entry.curve, tube.thickness_m))
    for entry, found in zip(conditions.girth, welds, strict=True):
        by = Factors(
            axial_crown=entry.factor, axial_saddle=entry.factor, in_plane=entry.factor, out_of_plane=entry.factor
        )
        for detail in found:
            at = index(detail)
            wall = detail.section.thickness_m
            # inner and outer toe of one weld are two
            before = sum(where == at for where, _ in sides)
            side = f"weld {before + 1}" if before else "weld"
            sides.add((at, side))
            spots += _round(at, side, by, entry.curve, _thickness(conditions, entry.curve, wall))
    return tuple(details), tuple(spots)


def _factors(entry: Sides, detail: Detail, ends: Sequence[Detail], where: str) -> list[tuple[str, Factors]]:
    """(side, factors) as stated, or by Efthymiou's equations."""
    if entry.efthymiou is None:
        return [(side, f) for side, f in (("chord", entry.chord), ("brace", entry.brace)) if f is not None]
    return list(zip(("chord", "brace"), _geometry_factors(entry.efthymiou, detail, ends, where), strict=True))


def _geometry_factors(entry: Efthymiou, detail: Detail, ends: Sequence[Detail], where: str) -> tuple[Factors, Factors]:
    """(chord, brace), none below the stated least. Raises InputError outside the equations' ranges, and of a K without
    a second brace."""
    own = _geometry(entry, detail)
    if beyond := efthymiou.validity_violations(own, entry.gap_m):
        raise InputError(
            f"{where}.efthymiou",
            f"{detail.name}: {'; '.join(beyond)}, for which the equations hold",
            "give chord and brace factors of such joints, of a finite-element model",
        )
    if entry.kind == "T/Y":
        both = efthymiou.tee(own, entry.chord_fixity)
    elif entry.kind == "X":
        both = efthymiou.cross(own, entry.chord_fixity)
    else:
        partner = _partner(detail, ends)
        if partner is None:
            raise InputError(
                f"{where}.efthymiou",
                f"{detail.name}: there is no second brace in its plane, on its side of "
                "the chord, that leans the other way",
                'take kind = "T/Y"',
            )
        both = efthymiou.kay(own, _geometry(entry, partner), cast(float, entry.gap_m))
    chord, brace = (
        Factors(**{name: max(entry.least, getattr(one, name)) for name in Factors.model_fields}) for one in both
    )
    return chord, brace


def _chord(detail: Detail) -> WalledMember:
    if detail.chord is None:
        raise ValueError(f"{detail.name} is a weld round a member: it has no chord")
    return detail.chord


def _geometry(entry: Efthymiou, detail: Detail) -> efthymiou.Geometry:
    chord, brace = _chord(detail).tube, detail.beam.tube
    return efthymiou.Geometry(
        chord_diameter_m=chord.diameter_m,
        chord_wall_m=chord.thickness_m,
        chord_length_m=entry.chord_length_m,
        brace_diameter_m=brace.diameter_m,
        brace_wall_m=brace.thickness_m,
        angle_deg=float(np.degrees(np.arccos(min(1.0, abs(detail.along @ detail.chord_along))))),
    )


def _partner(detail: Detail, ends: Sequence[Detail]) -> Detail | None:
    """The other brace of a K: at the same place of the same chord, in its plane and on its side, leaning the other way;
    the nearest in diameter where there are several."""

    def normal_to_chord(one: Detail) -> np.ndarray:
        return one.along_brace - detail.chord_along * (detail.chord_along @ one.along_brace)

    mine = normal_to_chord(detail)
    found = []
    for other in ends:
        if other.part == detail.part or other.at != detail.at or np.linalg.norm(other.place_m - detail.place_m) > 1e-3:
            continue
        theirs = normal_to_chord(other)
        cosine = mine @ theirs / (np.linalg.norm(mine) * np.linalg.norm(theirs))
        leaning = (detail.along_brace @ detail.chord_along) * (other.along_brace @ detail.chord_along)
        if cosine > ONE_PLANE and leaning < 0:
            found.append(other)
    if not found:
        return None
    size = detail.beam.tube.diameter_m
    return min(found, key=lambda d: abs(d.beam.tube.diameter_m - size))


def _round(at: int, side: str, f: Factors, curve: str, thickness: float) -> list[HotSpot]:
    spots = []
    for k in range(PLACES):
        angle = np.pi / 4 * k
        axial = (f.axial_crown, 0.5 * (f.axial_crown + f.axial_saddle), f.axial_saddle)[(0, 1, 2, 1)[k % 4]]
        weight = np.array([axial, f.in_plane * np.cos(angle), f.out_of_plane * np.sin(angle)])
        spots.append(HotSpot(detail=at, side=side, place=k + 1, weight=frozen_array(weight), curve=curve,
                             thickness_effect=thickness))
    return spots


def _thickness(conditions: Conditions, curve: str, wall_m: float) -> float:
    """(t / t_ref)^k of walls above t_ref, else 1 (DNV-RP-C203, eq. 2.4.3)."""
    law = conditions.curve[curve]
    return max(1.0, wall_m / law.reference_thickness_m) ** law.thickness_exponent


def weights(spots: Sequence[HotSpot]) -> tuple[np.ndarray, np.ndarray]:
    """Detail of each hot spot (n_spot,), weights (n_spot, 3)."""
    return np.array([s.detail for s in spots]), np.array([s.weight for s in spots])


def thickness_effects(spots: Sequence[HotSpot]) -> np.ndarray:
    """(n_spot,)."""
    return np.array([s.thickness_effect for s in spots])
