"""A SubDyn input file as a model: alone, or with a TOML that names groups in it and attaches parameters and sensors."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, Strict, ValidationError
from scipy import sparse

from probupdate.errors import InputError
from probupdate.io.elastodyn_file import ElastoDyn, read_elastodyn
from probupdate.io.files import resolve_path
from probupdate.io.subdyn_file import BEAMS, SubDynFile, read_subdyn
from probupdate.modal.mode_energy import DofPlaces
from probupdate.modal.modes import Sensor
from probupdate.model.interface import Wireframe
from probupdate.model.parameters import Parameters
from probupdate.runtime.arrays import frozen_array
from probupdate.structure import beam as beams
from probupdate.structure.affine import AffineModel
from probupdate.structure.mode_labels import dof_places
from probupdate.structure.parameter_table import KEYS, read_toml, updated_parameters
from probupdate.structure.plausible_size import top_words
from probupdate.structure.readings import STANDARD_MPS2, FeltGravity, rotation_reading
from probupdate.structure.schema import Number, Table, Vector, suggest
from probupdate.structure.subdyn_frame import (
    SAME_PLACE,
    Element,
    SubDynFrame,
    build_subdyn_frame,
    cross_matrix,
    mass_factors,
    mass_units,
    plain_matrices,
    rigid_body_mass,
    sizes_at,
    stiffness_factors,
    stiffness_units,
    tube,
)
from probupdate.structure.subdyn_tower import (
    RotorNacelleEntry,
    TowerEntry,
    body_of,
    check_material,
    mount_tower,
    tables_of,
)

# raise it when the same files give other matrices
FORMULATION = 2
# wind blows along x, and an upwind rotor looks against it
UPWIND_DEG = 180.0
# how far from a member's surface a sensor may sit, as a share of the structure's extent
REACH = 0.02
WholeNumber = Annotated[int, Strict(), Field(ge=1)]


@dataclass(frozen=True, kw_only=True)
class Act:
    """What a parameter does: on which sort of group, in which unit, the value at which it leaves the file as it is."""

    on: str
    unit: str
    neutral: float
    text: str


ACTS = {
    "stiffness": Act(on="members", unit="-", neutral=1.0, text="factor on the stiffness (E and G) of members"),
    "density": Act(on="members", unit="-", neutral=1.0, text="factor on the density of beams"),
    "thickness": Act(on="members", unit="-", neutral=1.0, text="factor on the wall of circular beams, diameter kept"),
    "wall_loss": Act(on="members", unit="m", neutral=0.0, text="wall lost outside of circular beams"),
    "line_mass": Act(on="members", unit="kg/m", neutral=0.0, text="mass per metre that beams carry along"),
    "mass": Act(on="masses", unit="-", neutral=1.0, text="factor on concentrated masses with their inertia"),
    "added_mass": Act(on="joints", unit="kg", neutral=0.0, text="a mass more at each joint"),
    "soil": Act(on="reactions", unit="-", neutral=1.0, text="factor on the whole soil stiffness"),
    "soil_lateral": Act(on="reactions", unit="-", neutral=1.0, text="factor on its x, y, tx, ty terms"),
    "soil_vertical": Act(on="reactions", unit="-", neutral=1.0, text="factor on its z term"),
    "soil_torsional": Act(on="reactions", unit="-", neutral=1.0, text="factor on its tz term"),
}
# directions of each part of a soil matrix
SOIL_PARTS = {"soil_lateral": (0, 1, 3, 4), "soil_vertical": (2,), "soil_torsional": (5,)}


class GroupEntry(Table):
    members: tuple[WholeNumber, ...] = ()
    property_sets: tuple[WholeNumber, ...] = ()
    kind: Literal["circular", "rectangular", "arbitrary", "cable", "rigid", "spring"] = "circular"
    reactions: tuple[WholeNumber, ...] = ()
    masses: tuple[WholeNumber, ...] = ()
    joints: tuple[WholeNumber, ...] = ()


class SensorEntry(Table):
    channel: str
    level: str = ""
    joint: WholeNumber | None = None
    position_m: Vector | None = None
    direction: Vector
    quantity: Literal["acceleration", "velocity", "displacement"] = "acceleration"
    unit: str = "m/s2"
    # None: as the quantity has it
    gravity: Annotated[bool, Strict()] | None = None


class ParameterEntry(Table):
    name: str
    acts: str
    on: str | tuple[str, ...]
    unit: str = "-"
    initial: Number
    cov: Number | None = None
    std: Number | None = None
    lower: Annotated[float, Strict(), Field(allow_inf_nan=True)] = -np.inf
    upper: Annotated[float, Strict(), Field(allow_inf_nan=True)] = np.inf
    prior: Literal["normal", "lognormal", "uniform"] = "normal"
    update: Annotated[bool, Strict()] = True
    description: str = ""

    @property
    def groups(self) -> tuple[str, ...]:
        return (self.on,) if isinstance(self.on, str) else self.on


class FileEntry(Table):
    file: str
    # joints whose masses turn with the nacelle
    nacelle: tuple[WholeNumber, ...] = ()


class SubDynDescription(Table):
    """model.toml of a SubDyn file."""

    format: int = 1
    name: str | None = None
    subdyn: FileEntry
    tower: TowerEntry | None = None
    rotor_nacelle: RotorNacelleEntry | None = None
    group: dict[str, GroupEntry] = {}
    parameter: tuple[ParameterEntry, ...] = ()
    correlation: dict[str, dict[str, Number]] = {}
    sensor: tuple[SensorEntry, ...] = ()


def read_description(raw: dict, path: Path) -> SubDynDescription:
    try:
        return SubDynDescription.model_validate(raw)
    except ValidationError as error:
        first, *rest = error.errors()
        key = ".".join(str(step) for step in first["loc"])
        more = f" ({len(rest)} more mistakes in this file)" if rest else ""
        problem = "is not a key here" if first["type"] == "extra_forbidden" else first["msg"]
        raise InputError(f"{path}: {key}", problem, f"see docs/formats/model.md, a SubDyn file{more}") from None


def named_file(path: Path, name: str, key: str) -> Path:
    """A file that a TOML names: in its folder or below."""
    return resolve_path(name, path.resolve().parent, f"{path}: {key}")


def with_tower(description: SubDynDescription, path: Path) -> tuple[SubDynFile, SubDynDescription]:
    """The SubDyn file of a TOML with the tower it describes, whose groups are called tower and rotor_nacelle."""
    file = read_subdyn(named_file(path, description.subdyn.file, "subdyn.file"), path.parent)
    entry, body = description.tower, description.rotor_nacelle
    if entry is None:
        if body is not None:
            raise InputError(f"{path}: rotor_nacelle", "there is no [tower] under it", "add one, or a concentrated "
                             "mass to the SubDyn file")
        return file, description
    for name in ("tower", "rotor_nacelle"):
        if name in description.group:
            raise InputError(f"{path}: group.{name}", "is the name of what [tower] adds", "give the group another name")
    check_material(entry, str(path))
    platform = None
    if entry.elastodyn is not None:
        read = read_elastodyn(named_file(path, entry.elastodyn, "tower.elastodyn"), path.parent)
        tower, carried, platform = read.tower, read.rotor_nacelle if body is None else body_of(body), read.platform
        file = replace(file, notes=(*file.notes, *_elastodyn_notes(file, entry, read, body is None)))
    else:
        if entry.joint is None:
            raise InputError(f"{path}: tower.joint", "is missing", "name the joint the tower stands on")
        foot = next((j.position_m[2] for j in file.joints if j.id == entry.joint), 0.0)
        tower = tables_of(entry, foot, str(path))
        if body is None:
            raise InputError(f"{path}: rotor_nacelle", "is missing", "give mass_kg, centre_m and inertia_kgm2")
        carried = body_of(body)
    whole = mount_tower(file, entry, tower, carried, platform, str(path))
    height = tower.top_m - tower.base_m
    tower_kg = height * np.trapezoid(tower.mass_kgpm, tower.fraction) + tower.point_mass[:, 1].sum()
    top = ("rotor and nacelle", carried.mass_kg, float(carried.inertia_kgm2.max()))
    odd = top_words([top], float(tower_kg), height)
    groups = {"tower": GroupEntry(members=whole.members), "rotor_nacelle": GroupEntry(masses=(whole.mass,))}
    nacelle = description.subdyn.model_copy(update={"nacelle": (*description.subdyn.nacelle, whole.mass)})
    noted = replace(whole.file, notes=(*whole.file.notes, *(f"{path}: {words}" for words in odd)))
    return noted, description.model_copy(update={"group": {**description.group, **groups}, "subdyn": nacelle})


def _elastodyn_notes(file: SubDynFile, entry: TowerEntry, read: ElastoDyn, own_body: bool) -> Iterator[str]:
    """What of ElastoDyn acts elsewhere than it may seem, or not at all."""
    where = entry.elastodyn
    if read.platform is not None:
        ids = {row.joint for row in file.interfaces} | ({entry.joint} if entry.joint is not None else set())
        there = sorted({row.id for row in file.masses if row.id in ids and row.values[0] > 0})
        place = f"joint {entry.joint}" if entry.joint is not None else "the transition piece"
        yield f"{where}: PtfmMass {read.platform.mass_kg:g} kg and its inertia act at {place}" + (
            f"; the SubDyn file has a concentrated mass at joint {', '.join(map(str, there))} too: make sure that it "
            "is not the same one" if there else "")
    if read.yaw_deg and own_body:
        yield (f"{where}: NacYaw turns rotor and nacelle by {read.yaw_deg:g} degrees: in the model as it is the "
               f"nacelle looks {read.looks_deg % 360:g} degrees from x, for a set that states nacelle_angle_deg there")
    if not own_body:
        yield f"{where}: rotor and nacelle are those of [rotor_nacelle]; the file's own (and NacYaw) are not used"
    yield from read.notes


def is_subdyn(path: Path) -> bool:
    """Whether a model file is SubDyn's, or a TOML that names one."""
    return path.suffix.lower() == ".dat" or (path.suffix == ".toml" and "subdyn" in read_toml(path))


def subdyn_sensors(path: Path) -> tuple[Sensor, ...]:
    """The channels the model of a file answers at: those of its TOML, or the motions of all joints."""
    if path.suffix != ".toml":
        return joint_sensors(read_subdyn(path))
    return _file_sensors(*with_tower(read_description(read_toml(path), path), path), path)


def subdyn_angle_deg(path: Path) -> float:
    """Where the nacelle looks in a model's file as it is, counter-clockwise from the model's x axis: along -x, as of an
    ElastoDyn file whose rotor is upwind (OverHang below zero), turned by NacYaw; a downwind one the other way round."""
    raw = read_toml(path) if path.suffix == ".toml" else {}
    return _looks_deg(read_description(raw, path), path) if "subdyn" in raw else UPWIND_DEG


def _looks_deg(description: SubDynDescription, path: Path) -> float:
    entry = description.tower
    if entry is None or entry.elastodyn is None or description.rotor_nacelle is not None:
        return UPWIND_DEG
    return read_elastodyn(named_file(path, entry.elastodyn, "tower.elastodyn"), path.parent).looks_deg


def turns_nacelle(path: Path) -> bool:
    """Whether a model with members has a nacelle: a model.toml, or a TOML of SubDyn's that states it or a tower."""
    if not is_subdyn(path):
        return True
    if path.suffix != ".toml":
        return False
    description = read_description(read_toml(path), path)
    return bool(description.subdyn.nacelle) or description.tower is not None


def subdyn_model(path: Path, *, sensors: Sequence[Sensor] | None = None, root: Path | None = None) -> AffineModel:
    """A SubDyn file with nothing beside it: no parameters; channels are its joints' motions, or the sensors'. Its SSI
    files lie in `root` (its own folder where None) or below."""
    file = read_subdyn(path, root)
    return _model(file, SubDynDescription(subdyn=FileEntry(file=path.name)), path, Parameters(()), sensors, 0.0)


def described_model(
    raw: dict, path: Path, *, parameters: Parameters | None = None, sensors: Sequence[Sensor] | None = None,
    nacelle_angle_deg: float | None = None,
) -> AffineModel:
    """The model of a TOML with [subdyn]; `parameters` and `sensors` replace its own."""
    own = read_description(raw, path)
    file, description = with_tower(own, path)
    turn = 0.0 if nacelle_angle_deg is None else nacelle_angle_deg - _looks_deg(own, path)
    if parameters is None:
        tables = [{k: v for k, v in t.items() if k in KEYS} for t in raw.get("parameter", [])]
        # a model may be opened for its modes alone
        some = any(t.get("update", True) for t in tables)
        parameters = updated_parameters(tables, str(path), raw.get("correlation")) if some else Parameters(())
    return _model(file, description, path, parameters, sensors, turn)


def _model(file, description: SubDynDescription, path: Path, parameters: Parameters, sensors, angle_deg: float):
    frame = build_subdyn_frame(file)
    targets = targets_of(file, description, path)
    values = {p.name: p.initial for p in description.parameter}
    for name in (*parameters.names, *(name for name, _ in parameters.held)):
        if name not in values:
            raise InputError(f"{path}: parameter {name}", "the model has no such parameter", suggest(name, values))
    values |= dict(parameters.held)
    _check_bounds(description, parameters, path)
    fixed = {name: value for name, value in values.items() if name not in parameters.names}
    terms = _terms(frame, description, targets, path, angle_deg)
    chosen = tuple(sensors) if sensors is not None else _file_sensors(file, description, path)
    joints = {s.channel: s.joint for s in description.sensor if s.joint is not None}
    text = [FORMULATION, list(file.lines), [asdict(row) for row in (*file.sets["arbitrary"], *file.masses)],
            [joint.position_m for joint in file.joints],
            {k: list(s.lines) for k, s in file.soil.items()}, angle_deg, fixed,
            description.model_dump(mode="json", exclude={"parameter", "correlation", "sensor"}),
            [p.model_dump(mode="json", include={"name", "acts", "on"}) for p in description.parameter],
            [[s.channel, s.position_m.tolist(), s.direction.tolist()] for s in chosen]]
    wire, wire_matrix, wire_turn = _wireframe(frame)
    rows, known = _channel_rows(frame, chosen, joints, path)
    return AffineModel(
        name=description.name or path.stem,
        parameters=parameters,
        channels=tuple(s.channel for s in chosen),
        stiffness=tuple(terms["K"].values()),
        mass=tuple(terms["M"].values()),
        coefficients=Coefficients(parameters.names, tuple(terms["K"]), tuple(terms["M"]), tuple(fixed.items())),
        channel_matrix=rows[: len(chosen)],
        tilt_matrix=rows[len(chosen) :],
        gravity=FeltGravity(mps2=STANDARD_MPS2, share=frozen_array([float(s.gravity) for s in chosen]),
                            known=frozen_array(known, bool)),
        wire=wire,
        wire_matrix=wire_matrix,
        places=_places(frame),
        wire_turn=wire_turn,
        hash_key=hashlib.sha256(json.dumps(text, sort_keys=True).encode(errors="surrogateescape")).hexdigest(),
    )


# what a parameter acts on ---------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Targets:
    """What acts where: (act, id) -> names of parameters."""

    names: Mapping[tuple[str, int], tuple[str, ...]]

    def __call__(self, act: str, id: int) -> tuple[str, ...]:
        return self.names.get((act, id), ())


def targets_of(file: SubDynFile, description: SubDynDescription, path: Path) -> Targets:
    groups = {name: group_of(file, name, entry, path) for name, entry in description.group.items()}
    names: dict[tuple[str, int], tuple[str, ...]] = {}
    seen = set()
    for p in description.parameter:
        where = f"{path}: parameter {p.name}"
        if p.name in seen:
            raise InputError(where, "is listed twice", "keep one")
        seen.add(p.name)
        if p.acts not in ACTS:
            raise InputError(f"{where}, acts", f"'{p.acts}' is unknown", suggest(p.acts, ACTS))
        act = ACTS[p.acts]
        if p.unit != act.unit:
            raise InputError(f"{where}, unit", f"is '{p.unit}', but {p.acts} is a {act.text} in {act.unit}",
                             f"write unit = \"{act.unit}\" and values in it")
        for group in p.groups:
            if group not in groups:
                raise InputError(f"{where}, on", f"there is no [group.{group}]", suggest(group, groups or {"(none)"}))
            sort, ids = groups[group]
            if sort != act.on:
                raise InputError(f"{where}, on", f"[group.{group}] is one of {sort}, but {p.acts} acts on {act.on}",
                                 f"name a group of {act.on}")
            for id in ids:
                _check_target(file, p.acts, id, where)
                names[p.acts, id] = (*names.get((p.acts, id), ()), p.name)
    return Targets(names=names)


def group_of(file: SubDynFile, name: str, entry: GroupEntry, path: Path) -> tuple[str, tuple[int, ...]]:
    """('members', 'reactions', 'masses' or 'joints', ids)."""
    where = f"{path}: group.{name}"
    given = [k for k in ("members", "property_sets", "reactions", "masses", "joints") if getattr(entry, k)]
    if len(given) != 1:
        raise InputError(where, f"names {' and '.join(given) or 'nothing'}",
                         "name one of members, property_sets, reactions, masses, joints")
    sort, wanted = given[0], getattr(entry, given[0])
    known = {"members": [m.id for m in file.members], "property_sets": [r.id for r in file.sets[entry.kind]],
             "reactions": [r.joint for r in file.reactions], "masses": [r.id for r in file.masses],
             "joints": [j.id for j in file.joints]}[sort]
    for id in wanted:
        if id not in known:
            by = ", by their joints" if sort in ("masses", "reactions") else ""
            listed = ", ".join([*map(str, known[:8]), *["..."] * (len(known) > 8)]) or "none"
            raise InputError(f"{where}.{sort}", f"{id} is not in {file.where}", f"it has {sort}{by}: {listed}")
    if sort == "property_sets":
        members = tuple(m.id for m in file.members if m.kind == entry.kind and set(m.sets) & set(wanted))
        if not members:
            raise InputError(f"{where}.{sort}", f"no member has these {entry.kind} sets", "correct them, or `kind`")
        return "members", members
    return sort, tuple(dict.fromkeys(wanted))


def _check_target(file: SubDynFile, acts: str, id: int, where: str) -> None:
    if acts in ("thickness", "wall_loss", "density", "line_mass", "stiffness"):
        kind = next(m.kind for m in file.members if m.id == id)
        fit = {"thickness": ("circular",), "wall_loss": ("circular",), "density": BEAMS, "line_mass": BEAMS,
               "stiffness": (*BEAMS, "cable", "spring")}[acts]
        if kind not in fit:
            raise InputError(where, f"{acts} does not act on member {id}, which is {kind}", "take it out of the group")
        if acts in ("thickness", "wall_loss") and kind == "circular":
            member = next(m for m in file.members if m.id == id)
            if any(file.set_of(member, end).values[4] == 0 for end in (0, 1)):
                raise InputError(where, f"member {id} is solid and has no wall", "take it out of the group")
    if acts.startswith("soil"):
        reaction = next(r for r in file.reactions if r.joint == id)
        if reaction.ssi is None or all(reaction.fixed):
            raise InputError(where, f"the soil of joint {id} has no effect: " + (
                "no SSI file" if reaction.ssi is None else "all its directions are held"),
                "give joints with an SSI file and free directions")
        if acts in SOIL_PARTS:
            stiffness, inside = file.soil[reaction.ssi].stiffness, np.zeros((6, 6), bool)
            for part in SOIL_PARTS.values():
                inside[np.ix_(part, part)] = True
            if np.abs(stiffness[~inside]).max() > 1e-6 * np.abs(stiffness).max():
                raise InputError(where, f"the SSI file '{reaction.ssi}' couples its lateral, vertical and torsional "
                                 "parts", "use acts = \"soil\"")


def _check_bounds(description: SubDynDescription, parameters: Parameters, path: Path) -> None:
    for p in parameters:
        act = ACTS[next(e.acts for e in description.parameter if e.name == p.name)]
        if p.lower < 0 or (act.neutral == 1.0 and p.lower == 0):
            least = "above 0" if act.neutral == 1.0 else "of 0 or more"
            raise InputError(f"{path}: parameter {p.name}", f"its lower bound is {p.lower:g}, but it is a {act.text}",
                             f"give lower {least}")


# K(theta), M(theta) ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Product:
    """The product of parameters; 1 of none."""

    names: tuple[str, ...] = ()

    def __call__(self, values: Mapping):
        result = 1.0
        for name in self.names:
            result = result * values[name]
        return result


@dataclass(frozen=True, kw_only=True)
class TubePart:
    """One factor of a circular beam whose wall is a parameter: number `index` of `stiffness_factors`, or of
    `mass_factors` where `length_m` is None, times a product."""

    tube: tuple[float, float, float, float, float]
    thickness: tuple[str, ...]
    wall_loss: tuple[str, ...]
    times: Product
    index: int
    length_m: float | None = None
    shear: bool = False

    def __call__(self, values: Mapping):
        e, g, density, diameter, wall = self.tube
        loss = sum((values[name] for name in self.wall_loss), 0.0)
        section = tube(e, g, density, diameter - 2 * loss, wall * Product(names=self.thickness)(values) - loss)
        if self.length_m is None:
            return self.times(values) * mass_factors(section)[self.index]
        return self.times(values) * stiffness_factors(section, self.length_m, self.shear)[self.index]


@dataclass(frozen=True)
class Coefficients:
    """theta (..., n_param) -> (..., n_stiffness), (..., n_mass); what is not updated stands at its value."""

    names: tuple[str, ...]
    stiffness: tuple[Product | TubePart, ...]
    mass: tuple[Product | TubePart, ...]
    fixed: tuple[tuple[str, float], ...]

    def __call__(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values = dict(self.fixed) | {name: theta[..., k] for k, name in enumerate(self.names)}
        one = np.ones(theta.shape[:-1], theta.dtype)
        stiffness, mass = (np.stack([one * f(values) for f in factors], axis=-1)
                           for factors in (self.stiffness, self.mass))
        return stiffness, mass


def _terms(frame: SubDynFrame, description, targets: Targets, path: Path, angle_deg: float):
    """'K' and 'M' -> {factor: reduced matrix}, the constant one first."""
    parts: dict[str, dict] = {"K": {Product(): []}, "M": {Product(): []}}

    def add(kind, factor, dofs, matrix):
        parts[kind].setdefault(factor, []).append((dofs, matrix))

    file = frame.file
    for dofs, element in zip(frame.dofs, frame.elements, strict=True):
        for kind, factor, matrix in element_terms(file, element, targets):
            add(kind, factor, dofs, matrix)
    for reaction in file.reactions:
        if reaction.ssi is None or all(reaction.fixed):
            continue
        dofs, soil = frame.node_dofs(frame.node_of[reaction.joint]), file.soil[reaction.ssi]
        whole = targets("soil", reaction.joint)
        rest = np.array(soil.stiffness)
        for act, index in SOIL_PARTS.items():
            own = targets(act, reaction.joint)
            if own:
                part = np.zeros((6, 6))
                part[np.ix_(index, index)] = rest[np.ix_(index, index)]
                rest -= part
                add("K", Product(names=(*whole, *own)), dofs, part)
        add("K", Product(names=whole), dofs, rest)
        add("M", Product(), dofs, soil.mass)
    angle = np.radians(angle_deg)
    turn = np.kron(np.eye(2), [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    for row in file.masses:
        body = rigid_body_mass(row.values)
        if row.id in description.subdyn.nacelle:
            body = turn @ body @ turn.T
        add("M", Product(names=targets("mass", row.id)), frame.node_dofs(frame.node_of[row.id]), body)
    for joint in file.joints:
        for name in targets("added_mass", joint.id):
            add("M", Product(names=(name,)), frame.node_dofs(frame.node_of[joint.id])[:3], np.eye(3))
    terms = {kind: {factor: frame.assemble(rows) for factor, rows in found.items()} for kind, found in parts.items()}
    terms["K"][Product()] = sparse.csc_array(terms["K"][Product()] + frame.joint_springs)
    for joint in description.subdyn.nacelle:
        if joint not in {row.id for row in file.masses}:
            raise InputError(f"{path}: subdyn.nacelle", f"there is no concentrated mass at joint {joint}", "correct it")
    return terms


def element_terms(
    file: SubDynFile, element: Element, targets: Targets
) -> Iterator[tuple[str, Product | TubePart, np.ndarray]]:
    """'K' or 'M', factor and (12, 12) global matrix of everything an element is made of."""
    id, length = element.member.id, element.length_m
    stiff, dense = (Product(names=targets(act, id)) for act in ("stiffness", "density"))
    wall, loss = targets("thickness", id), targets("wall_loss", id)
    if wall or loss:
        material, sizes = sizes_at(file, element)
        common = {"tube": (*material, *sizes), "thickness": wall, "wall_loss": loss}
        for k, unit in enumerate(stiffness_units(length)):
            # without shear the length is in the matrix alone, and elements of all lengths share a term
            own = float(f"{length:.12g}") if file.shear else 1.0
            factor = TubePart(times=stiff, index=k, length_m=own, shear=file.shear, **common)
            yield "K", factor, element.to_global(unit)
        for k, unit in enumerate(mass_units(length)):
            yield "M", TubePart(times=dense, index=k, **common), element.to_global(unit)
    else:
        stiffness, mass = plain_matrices(file, element)
        yield "K", stiff, stiffness
        yield "M", dense, mass
    for name in targets("line_mass", id):
        yield "M", Product(names=(name,)), element.to_global(mass_units(length)[0])


def assembled_file(file: SubDynFile) -> tuple[SubDynFrame, sparse.csc_array, sparse.csc_array]:
    """A SubDyn file's frame with its stiffness and mass, soil and masses in them."""
    frame = build_subdyn_frame(file)
    entry = SubDynDescription(subdyn=FileEntry(file=file.where))
    terms = _terms(frame, entry, Targets(names={}), Path(file.where), 0.0)
    return frame, terms["K"][Product()], terms["M"][Product()]


# sensors and picture -----------------------------------------------------------------------------------------------


def joint_sensors(file: SubDynFile) -> tuple[Sensor, ...]:
    """The three displacements of every joint as channels J<id>x, J<id>y, J<id>z."""
    return tuple(
        Sensor(channel=f"J{joint.id}{axis}", level=f"{joint.position_m[2]:g} m", position_m=np.array(joint.position_m),
               direction=np.eye(3)[k], quantity="displacement", unit="m")
        for joint in file.joints for k, axis in enumerate("xyz")
    )


def _file_sensors(file: SubDynFile, description: SubDynDescription, path: Path) -> tuple[Sensor, ...]:
    if not description.sensor:
        return joint_sensors(file)
    places = {joint.id: joint.position_m for joint in file.joints}
    result = []
    for entry in description.sensor:
        if entry.joint is None and entry.position_m is None:
            raise InputError(f"{path}: sensor {entry.channel}", "has neither joint nor position_m", "give one of them")
        if entry.joint is not None and entry.joint not in places:
            raise InputError(f"{path}: sensor {entry.channel}", f"joint {entry.joint} is not in {file.where}",
                             "correct its number")
        at = places[entry.joint] if entry.joint is not None and not entry.position_m else entry.position_m
        result.append(Sensor(channel=entry.channel, level=entry.level, direction=np.array(entry.direction),
                             position_m=np.array(at), quantity=entry.quantity, unit=entry.unit, gravity=entry.gravity))
    names = [s.channel for s in result]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise InputError(f"{path}: sensor {twice[0]}", "is listed twice", "keep one")
    return tuple(result)


def _channel_rows(frame: SubDynFrame, sensors: Sequence[Sensor], joints: Mapping[str, int], path: Path):
    """(2 n_channel, n_free) motions and below them tilts: a sensor follows its joint rigidly, or the nearest beam where
    no joint is named; and whether the rotation there is known (n_channel,), which it is not at a joint that turns."""
    n = len(sensors)
    rows, known = sparse.lil_array((2 * n, frame.n_full)), np.ones(n, bool)
    places = {tuple(joint.position_m): joint for joint in frame.file.joints}
    for number, sensor in enumerate(sensors):
        joint = joints.get(sensor.channel)
        at = places.get(tuple(float(x) for x in sensor.position_m))
        if joint is None and at is not None:
            joint = at.id
        if joint is None:
            dofs, motion = _sensor_on_beam(frame, sensor, path)
        else:
            dofs, motion, known[number] = _sensor_at_joint(frame, sensor, joint, path)
        across = rotation_reading(sensor.direction)
        known[number] |= not across.any()
        for dof, along, tilt in zip(dofs, sensor.direction @ motion[:3], across @ motion[3:], strict=True):
            rows[number, dof] += along
            rows[n + number, dof] += tilt
    return sparse.csr_array(sparse.csr_array(rows) @ frame.reduction), known


def _sensor_at_joint(frame: SubDynFrame, sensor: Sensor, joint: int, path: Path) -> tuple[np.ndarray, np.ndarray, bool]:
    """Degrees of freedom (n,), (6, n) motion and rotation at the sensor, and whether the joint has one rotation."""
    node = frame.node_of[joint]
    arm = sensor.position_m - frame.node_m[node]
    dofs = frame.node_dofs(node)
    turns = bool(dofs[-1] < 0)
    if turns and np.linalg.norm(arm) > SAME_PLACE * _extent(frame):
        raise InputError(f"{path}: sensor {sensor.channel}", f"is offset from joint {joint}, which is not rigid",
                         "put it at the joint, or on another")
    return dofs[dofs >= 0], _lever_matrix(arm)[:, dofs >= 0], not turns


def _lever_matrix(arm: np.ndarray) -> np.ndarray:
    """(6, 6) motion and rotation of a point at `arm` from those of what carries it."""
    return np.block([[np.eye(3), -cross_matrix(arm)], [np.zeros((3, 3)), np.eye(3)]])


def _extent(frame: SubDynFrame) -> float:
    return float(np.max(np.ptp(frame.node_m, axis=0)))


def _sensor_on_beam(frame: SubDynFrame, sensor: Sensor, path: Path) -> tuple[np.ndarray, np.ndarray]:
    best = None
    for dofs, element in zip(frame.dofs, frame.elements, strict=True):
        if element.member.kind not in BEAMS:
            continue
        start, end = (frame.node_m[n] for n in element.nodes)
        span = end - start
        xi = float(np.clip((sensor.position_m - start) @ span / (span @ span), 0.0, 1.0))
        arm = sensor.position_m - (start + xi * span)
        distance = float(np.linalg.norm(arm))
        radius = 0.5 * sizes_at(frame.file, element)[1][0] if element.member.kind == "circular" else 0.0
        gap = max(0.0, distance - radius)
        if best is None or (gap, distance) < best[0]:
            best = (gap, distance), dofs, element, xi, arm
    reach = REACH * _extent(frame)
    if best is None or best[0][0] > reach:
        far = "no beam is there" if best is None else f"{best[0][0]:.3g} m from any beam (at most {reach:.3g} m)"
        raise InputError(f"{path}: sensor {sensor.channel}", far,
                         "check position_m, or name its joint in the model's [[sensor]]")
    _, dofs, element, xi, arm = best
    turn = np.kron(np.eye(4), element.axes[:, [2, 0, 1]].T)
    at_axis = turn[:6, :6].T @ beams.interpolation(xi, element.length_m) @ turn
    return dofs, _lever_matrix(arm) @ at_axis


def _places(frame: SubDynFrame) -> DofPlaces:
    own = np.flatnonzero(frame.translation.ravel() >= 0)
    pick = sparse.csr_array((np.ones(len(own)), (own, frame.translation.ravel()[own])),
                            shape=(6 * len(frame.node_m), frame.n_full))
    return dof_places(frame.node_m, pick @ frame.reduction)


def _wireframe(frame: SubDynFrame) -> tuple[Wireframe, sparse.csr_array, sparse.csr_array]:
    """With the motion of its nodes and their rotation, nothing where a joint has several."""
    lines = np.array([e.nodes for e in frame.elements])
    n = len(frame.node_m)
    dofs = frame.translation[:, :3].ravel()
    pick = sparse.csr_array((np.ones(3 * n), (np.arange(3 * n), dofs)), shape=(3 * n, frame.n_full))
    wire = Wireframe(node_m=frame.node_m, line=frozen_array(lines, int),
                     line_group=tuple(e.member.kind for e in frame.elements))
    turns = np.array([frame.node_dofs(k)[3:] for k in range(n)]).ravel()
    own = np.flatnonzero(turns >= 0)
    turn = sparse.csr_array((np.ones(len(own)), (own, turns[own])), shape=(3 * n, frame.n_full))
    return wire, sparse.csr_array(pick @ frame.reduction), sparse.csr_array(turn @ frame.reduction)
