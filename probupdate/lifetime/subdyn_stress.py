"""Nominal stresses of a SubDyn model: its details, waves on its circular members, and the stress model of one heading.

K and M are those of the model that is updated: SubDyn's own, without the water's added mass, which is the user's to add
(a parameter that acts as line_mass). Waves load the part of every circular member below the still water level.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import sparse

from probupdate.errors import InputError
from probupdate.io.subdyn_file import SubDynFile
from probupdate.lifetime.conditions import Conditions, Girth, MemberEnd, Site
from probupdate.lifetime.details import ONE_PLANE, REACH_M, SAME_POINT_M, Detail, HotSpot, hot_spots, refuse_tables
from probupdate.lifetime.stress import StressModel, frequency_grid
from probupdate.lifetime.wave_loads import LEAST_POINTS, POINT_EVERY_M, Waves, placed_blocks
from probupdate.modal.modes import Sensor
from probupdate.modal.sensor_places import place_numbers
from probupdate.model.parameters import Parameters
from probupdate.runtime.arrays import frozen_array
from probupdate.structure import beam as beams
from probupdate.structure.load import model_sensors
from probupdate.structure.parameter_table import read_toml
from probupdate.structure.schema import suggest
from probupdate.structure.subdyn_frame import Element, SubDynFrame, build_subdyn_frame, cross_matrix, sizes_at
from probupdate.structure.subdyn_model import (
    Coefficients,
    Product,
    SubDynDescription,
    Targets,
    described_model,
    element_terms,
    group_of,
    read_description,
    subdyn_angle_deg,
    targets_of,
    with_tower,
)


@dataclass(frozen=True, kw_only=True)
class SubDynTube:
    """A circular member's section; the parameters whose product scales its wall, diameter kept, and whose sum is lost
    outside, as `subdyn_model.TubePart` takes them. Geometry in m at given parameter values."""

    diameter_m: float
    thickness_m: float
    factors: tuple[str, ...] = ()
    losses: tuple[str, ...] = ()

    def outer(self, values: Mapping):
        return self.diameter_m - 2 * self._thickness_loss(values)

    def _thickness_loss(self, values: Mapping):
        return sum((values[name] for name in self.losses), 0.0)

    def _inner(self, values: Mapping):
        wall = self.thickness_m * Product(names=self.factors)(values) - self._thickness_loss(values)
        # no wall: a solid bar, as SubDyn has it
        return self.outer(values) - 2 * wall if self.thickness_m else 0.0

    def area(self, values: Mapping):
        return np.pi / 4 * (self.outer(values) ** 2 - self._inner(values) ** 2)

    def second_moment(self, values: Mapping):
        return np.pi / 64 * (self.outer(values) ** 4 - self._inner(values) ** 4)


@dataclass(frozen=True, eq=False, kw_only=True)
class Piece:
    """A member as a detail knows it."""

    tube: SubDynTube


@dataclass(frozen=True, eq=False, kw_only=True)
class OpenedModel:
    """A TOML of a SubDyn model, opened: the file with its tower, frame, what acts where, and its groups of members."""

    path: Path
    raw: dict
    file: SubDynFile
    description: SubDynDescription
    frame: SubDynFrame
    targets: Targets

    def members(self, group: str, where: str) -> tuple[int, ...]:
        """Ids of a group. Raises InputError where it is none of circular members."""
        groups = self.description.group
        if group not in groups:
            raise InputError(where, f"there is no [group.{group}] in {self.path}", suggest(group, groups or {"(none)"}))
        sort, ids = group_of(self.file, group, groups[group], self.path)
        kinds = {m.id: m.kind for m in self.file.members}
        odd = [id for id in ids if kinds.get(id) != "circular"] if sort == "members" else list(ids)
        if odd:
            what = f"member {odd[0]} is {kinds[odd[0]]}" if sort == "members" else f"it is one of {sort}"
            raise InputError(where, f"[group.{group}] is not of circular members: {what}", "stress needs their section")
        return ids

    def tube(self, element: Element, end: int | None = None) -> SubDynTube:
        """Of an element's middle, or of an end."""
        id, (_, (diameter, wall)) = element.member.id, sizes_at(self.file, element, end)
        return SubDynTube(
            diameter_m=float(diameter),
            thickness_m=float(wall),
            factors=self.targets("thickness", id),
            losses=self.targets("wall_loss", id),
        )


def open_model(path: str | Path) -> OpenedModel:
    path = Path(path)
    if path.suffix != ".toml":
        raise InputError(
            str(path), "has no groups of members", "name them in a TOML beside it (README, OpenFAST models)"
        )
    raw = read_toml(path)
    file, description = with_tower(read_description(raw, path), path)
    return OpenedModel(
        path=path,
        raw=raw,
        file=file,
        description=description,
        frame=build_subdyn_frame(file),
        targets=targets_of(file, description, path),
    )


# details ---------------------------------------------------------------------------------------------------------


def find_subdyn_details(
    own: OpenedModel, conditions: Conditions, where: str
) -> tuple[tuple[Detail, ...], tuple[HotSpot, ...]]:
    """What [[member_end]] and [[girth]] choose; raises InputError where a table chooses nothing, or two the same
    side."""
    refuse_tables(
        conditions, where, "joint", reason="is for a turbine of a model.toml; SubDyn models have [[member_end]]"
    )
    known = {j.id for j in own.file.joints}
    every, chosen = [], []
    for k, entry in enumerate(conditions.member_end):
        here = f"{where}: member_end[{k + 1}]"
        if missing := [j for j in entry.joints if j not in known]:
            raise InputError(f"{here}.joints", f"joint {missing[0]} is not in {own.file.where}", "correct its number")
        found = _brace_ends(own, entry, here)
        every += found
        chosen.append((here, entry, [d for d in found if not entry.joints or int(d.joint.split()[-1]) in entry.joints]))
    welds = [_girths(own, e, f"{where}: girth[{k + 1}]") for k, e in enumerate(conditions.girth)]
    return hot_spots(conditions, chosen, every, welds)


def _ends(own: OpenedModel, ids: Sequence[int]) -> list[tuple[int, int, int]]:
    """(element, end, joint) of the members' ends."""
    wanted, found = set(ids), []
    for number, e in enumerate(own.frame.elements):
        if e.member.id in wanted:
            found += [(number, 0, e.member.joints[0])] * (e.share[0] == 0.0)
            found += [(number, 1, e.member.joints[1])] * (e.share[1] == 1.0)
    return found


def _direction(own: OpenedModel, element: Element) -> np.ndarray:
    start, stop = (own.frame.node_m[n] for n in element.nodes)
    return (stop - start) / np.linalg.norm(stop - start)


def _brace_ends(own: OpenedModel, entry: MemberEnd, where: str) -> list[Detail]:
    braces, chords = own.members(entry.braces, f"{where}.braces"), own.members(entry.chords, f"{where}.chords")
    at_joint: dict[int, list[int]] = {}
    for number, _, joint in _ends(own, chords):
        at_joint.setdefault(joint, []).append(number)
    # where members of one group cross, no others meet: at a leg that is the chord
    mixed = {j for m in own.file.members if m.id not in set(braces) for j in m.joints} if braces == chords else set()
    found = []
    for number, end, joint in _ends(own, braces):
        if joint in mixed:
            continue
        element = own.frame.elements[number]
        along = _direction(own, element)
        # a brace goes on behind a crossing: its other half is not its chord
        across = [
            n
            for n in at_joint.get(joint, ())
            if own.frame.elements[n].member.id != element.member.id
            and abs(_direction(own, own.frame.elements[n]) @ along) < ONE_PLANE
        ]
        if not across:
            continue
        # of chords of several sizes (a can) the thickest
        chord = own.frame.elements[max(across, key=lambda n: own.tube(own.frame.elements[n]).thickness_m)]
        found.append(_detail(own, number, end, joint, chord))
    return found


def _detail(own: OpenedModel, number: int, end: int, joint: int, chord: Element | None) -> Detail:
    element = own.frame.elements[number]
    along, place = _direction(own, element), own.frame.node_m[element.nodes[end]]
    name = f"member {element.member.id}"
    middle = np.mean([own.frame.node_m[own.frame.node_of[j]][2] for j in element.member.joints])
    if chord is None:
        axis = along if along[2] >= 0 else -along
        helper = np.array([1.0, 0.0, 0.0]) if abs(along[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
        crown = helper - along * (helper @ along)
        saddle = np.cross(axis, crown / np.linalg.norm(crown))
    else:
        axis = _direction(own, chord)
        axis = axis * (1.0 if axis[2] >= 0 else -1.0)
        crown = axis - along * (axis @ along)
        saddle = np.cross(-along if end else along, crown / np.linalg.norm(crown))
    tube = own.tube(element, end)
    at = f"joint {joint}" if joint else f"{place[2]:.2f} m"
    return Detail(
        name=f"{name}, {at}",
        joint=at,
        part=name,
        level_m=float(place[2]),
        at="joint" if chord else "girth",
        bay=None,
        upper=bool(place[2] > middle),
        leg="",
        number=number,
        end=end,
        along=frozen_array(along),
        crown=frozen_array(crown / np.linalg.norm(crown)),
        saddle=frozen_array(saddle),
        beam=Piece(tube=tube),
        chord=Piece(tube=own.tube(chord)) if chord else None,
        section=tube,
        place_m=frozen_array(place),
        chord_along=frozen_array(axis) if chord else None,
    )


def _girths(own: OpenedModel, entry: Girth, where: str) -> list[Detail]:
    """Round every member of the group `part` that has an element's end at that level, one at each place."""
    wanted = set(own.members(entry.part, f"{where}.part"))
    gaps: list[tuple[float, int, int]] = []
    for number, e in enumerate(own.frame.elements):
        if e.member.id in wanted:
            gaps += [(abs(own.frame.node_m[node][2] - entry.z_m), number, end) for end, node in enumerate(e.nodes)]
    nearest_gap = min(gaps)[0]
    if nearest_gap > REACH_M:
        raise InputError(
            where,
            f"the nearest element of [group.{entry.part}] ends {nearest_gap:.2f} m from {entry.z_m:g} m",
            "choose the level of an element's end",
        )
    place_of = place_numbers(own.frame.node_m, SAME_POINT_M)
    found: dict[int, Detail] = {}
    for gap, number, end in sorted(gaps):
        if gap < nearest_gap + SAME_POINT_M:
            place = int(place_of[own.frame.elements[number].nodes[end]])
            found.setdefault(place, _detail(own, number, end, 0, None))
    return list(found.values())


# one heading -----------------------------------------------------------------------------------------------------


def subdyn_stress_model(
    own: OpenedModel,
    details: Sequence[Detail],
    conditions: Conditions,
    where: str,
    *,
    heading_deg: float,
    parameters: Parameters | None = None,
    sensors: tuple[Sensor, ...] | None = None,
    spectra: Mapping[str, tuple[np.ndarray, np.ndarray]] | None = None,
) -> StressModel:
    """Of one heading of wind and waves (and of what turns with the nacelle), on all degrees of freedom."""
    if conditions.site is None:
        raise InputError(
            f"{where}: site",
            "is missing: a SubDyn file says nothing of the water and of the hub",
            "add [site] with water_density_kgpm3, gravity_mps2, mudline_m, water_level_m, growth_m and hub_offset_m",
        )
    model = described_model(own.raw, own.path, parameters=parameters, sensors=sensors,
                            nacelle_angle_deg=heading_deg + subdyn_angle_deg(own.path))
    rows: dict[str, dict] = {"K": {}, "M": {}}
    for row, detail in enumerate(details):
        dofs, pick = own.frame.dofs[detail.number], detail.rows()
        for kind, factor, matrix in element_terms(own.file, own.frame.elements[detail.number], own.targets):
            rows[kind].setdefault(factor, []).append((3 * row + np.arange(3), dofs, pick @ matrix))
    size = (3 * len(details), own.frame.n_full)
    held = {
        kind: tuple(sparse.csr_array(placed_blocks(blocks, size) @ own.frame.reduction) for blocks in found.values())
        for kind, found in rows.items()
    }
    names = model.parameters.names
    fixed = {p.name: p.initial for p in own.description.parameter if p.name not in names}
    site = conditions.site
    return StressModel(
        model=model,
        sensors=sensors if sensors is not None else model_sensors(own.path) or (),
        frame=own.frame,
        details=tuple(details),
        heading_deg=float(heading_deg),
        conditions=conditions,
        site=(site.water_density_kgpm3, site.gravity_mps2, site.water_level_m - site.mudline_m, site.water_level_m),
        stiffness_rows=held["K"],
        mass_rows=held["M"],
        coefficients=Coefficients(names, tuple(rows["K"]), tuple(rows["M"]), tuple(fixed.items())),
        waves=_waves(own, site, details),
        hub=_hub(own, site, heading_deg, 0.0, where),
        across=_hub(own, site, heading_deg, 90.0, where),
        frequency_hz=frequency_grid(model, conditions.damping.ratio),
        spectra=dict(spectra or {}),
    )


def _hub(own: OpenedModel, site: Site, heading_deg: float, from_wind_deg: float, where: str) -> np.ndarray:
    """A force of 1 N at the hub, turned from the wind's way counter-clockwise, as loads on the free degrees of freedom;
    the hub follows its joint and turns with the heading."""
    joint = site.hub_joint
    if joint is None:
        if own.description.tower is None:
            raise InputError(
                f"{where}: site.hub_joint",
                "is missing, and the model's TOML has no [tower]",
                "name the joint that carries the rotor and nacelle",
            )
        joint = own.file.masses[-1].id
    if joint not in own.frame.node_of:
        raise InputError(f"{where}: site.hub_joint", f"joint {joint} is not in {own.file.where}", "correct its number")
    angle = np.radians(heading_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    way = angle + np.radians(from_wind_deg)
    wind = np.array([np.cos(way), np.sin(way), 0.0])
    dofs = own.frame.node_dofs(own.frame.node_of[joint])
    if dofs[-1] < 0:
        raise InputError(f"{where}: site.hub_joint", f"joint {joint} is not rigid", "take a rigid joint")
    force = np.zeros(own.frame.n_full)
    force[dofs[:3]] = wind
    force[dofs[3:]] = cross_matrix(turn @ np.array(site.hub_offset_m)) @ wind
    return frozen_array(own.frame.reduction.T @ force)


def _waves(own: OpenedModel, site: Site, details: Sequence[Detail]) -> Waves:
    of_element: dict[int, list[int]] = {}
    for row, detail in enumerate(details):
        of_element.setdefault(detail.number, []).append(row)
    position, along, diameter, length, blocks, taken = [], [], [], [], [], []
    for number, e in enumerate(own.frame.elements):
        if e.member.kind != "circular":
            continue
        start, end = (own.frame.node_m[n] for n in e.nodes)
        wet = _wet_part(start[2], end[2], site)
        if wet is None:
            continue
        span, axes = end - start, e.axes[:, [2, 0, 1]].T
        outer = own.tube(e).diameter_m + 2 * site.growth_m
        size = e.length_m * (wet[1] - wet[0])
        root, share = np.polynomial.legendre.leggauss(max(LEAST_POINTS, int(np.ceil(size / POINT_EVERY_M))))
        for at, weight in zip(wet[0] + (wet[1] - wet[0]) * 0.5 * (1 + root), 0.5 * share, strict=True):
            # nodal loads that do the work of a force there (Bernoulli-Euler shapes)
            local = beams.interpolation(float(at), e.length_m)[:3].T @ axes
            nodal = np.kron(np.eye(4), axes).T @ local
            column = 3 * len(position) + np.arange(3)
            blocks.append((own.frame.dofs[number], column, nodal))
            taken += [
                (3 * row + np.arange(3), column, details[row].rows() @ nodal) for row in of_element.get(number, ())
            ]
            position.append(start + at * span)
            along.append(span / e.length_m)
            diameter.append(outer)
            length.append(weight * size)
    n = 3 * len(position)
    spread = placed_blocks(blocks, (own.frame.n_full, n))
    return Waves(
        position_m=frozen_array(np.array(position).reshape(-1, 3)),
        along=frozen_array(np.array(along).reshape(-1, 3)),
        diameter_m=frozen_array(diameter),
        length_m=frozen_array(length),
        spread=sparse.csr_array(own.frame.reduction.T @ spread),
        of_details=placed_blocks(taken, (3 * len(details), n)),
    )


def _wet_part(low: float, high: float, site: Site) -> tuple[float, float] | None:
    """Shares of an element's length, from its start, between mudline and still water; None where there is no such."""
    if abs(high - low) < 1e-9:
        return (0.0, 1.0) if site.mudline_m <= low <= site.water_level_m else None
    ends = sorted((z - low) / (high - low) for z in (site.mudline_m, site.water_level_m))
    a, b = max(ends[0], 0.0), min(ends[1], 1.0)
    return (a, b) if b - a > 1e-9 else None
