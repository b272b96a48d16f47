"""A tower with rotor and nacelle on a SubDyn structure: joints, beams and a mass more, from ElastoDyn or from
tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from pydantic import Field, Strict

from probupdate.errors import InputError
from probupdate.io.elastodyn_file import RigidBody, Tower
from probupdate.io.subdyn_file import Joint, Member, Row, SubDynFile
from probupdate.structure.schema import RANGES, Number, Positive, Table, Vector
from probupdate.structure.subdyn_frame import odd_ratio

# how far the foot may be from the joint it stands on, as a share of the tower's height
GAP = 1e-4


class TowerEntry(Table):
    """[tower]: `elastodyn`, or fraction, mass_kgpm, stiffness_fa_nm2, stiffness_ss_nm2 and top_m. ElastoDyn states
    bending only: area and torsion are those of a tube of the stated material with that mass and bending stiffness.
    `joint`: what it stands on; without one, a rigid transition piece on all interface joints."""

    joint: Annotated[int, Strict(), Field(ge=1)] | None = None
    elastodyn: str | None = None
    top_m: Number | None = None
    fraction: tuple[Number, ...] = ()
    mass_kgpm: tuple[Positive, ...] = ()
    stiffness_fa_nm2: tuple[Positive, ...] = ()
    stiffness_ss_nm2: tuple[Positive, ...] = ()
    youngs_modulus_pa: Positive
    shear_modulus_pa: Positive
    density_kgpm3: Positive
    elements: Annotated[int, Strict(), Field(ge=1, le=200)]


class RotorNacelleEntry(Table):
    """[rotor_nacelle]: a rigid body at the tower's top, where ElastoDyn does not give it; inertia Jxx, Jyy, Jzz, Jxy,
    Jxz, Jyz about its centre."""

    mass_kg: Positive
    centre_m: Vector
    inertia_kgm2: tuple[Number, Number, Number, Number, Number, Number]


@dataclass(frozen=True, eq=False, kw_only=True)
class MountedTower:
    """The structure with its tower; the groups `tower` (members) and `rotor_nacelle` (masses) that come with it."""

    file: SubDynFile
    members: tuple[int, ...]
    mass: int


def tables_of(entry: TowerEntry, base_m: float, where: str) -> Tower:
    """The tower of a TOML's own tables."""
    columns = (entry.fraction, entry.mass_kgpm, entry.stiffness_fa_nm2, entry.stiffness_ss_nm2)
    if entry.top_m is None or len({len(c) for c in columns}) != 1 or len(entry.fraction) < 2:
        raise InputError(f"{where}: tower", "has neither elastodyn nor four columns of one length with top_m",
                         "give elastodyn, or fraction, mass_kgpm, stiffness_fa_nm2, stiffness_ss_nm2 and top_m")
    if np.any(np.diff(entry.fraction) <= 0) or entry.fraction[0] != 0 or entry.fraction[-1] != 1:
        raise InputError(f"{where}: tower.fraction", "does not rise from 0 to 1", "correct it")
    if entry.top_m <= base_m:
        raise InputError(f"{where}: tower.top_m", f"{entry.top_m:g} is not above the foot, {base_m:g}", "correct it")
    return Tower(base_m=base_m, top_m=entry.top_m, point_mass=np.zeros((0, 2)), **{
        name: np.array(getattr(entry, name))
        for name in ("fraction", "mass_kgpm", "stiffness_fa_nm2", "stiffness_ss_nm2")})


def check_material(entry: TowerEntry, where: str) -> None:
    """Refuse moduli and a density that no structural material has."""
    ratio = odd_ratio(entry.youngs_modulus_pa, entry.shear_modulus_pa)
    if ratio is not None:
        raise InputError(f"{where}: tower.shear_modulus_pa", f"makes Poisson's ratio {ratio:.2g} with "
                         "youngs_modulus_pa, which no structural material has",
                         "check digits and units: steel has 8.08e10 and 2.1e11 Pa")
    for name in ("youngs_modulus_pa", "density_kgpm3"):
        low, high, unit = RANGES[f"steel.{name}"]
        if not low <= getattr(entry, name) <= high:
            raise InputError(f"{where}: tower.{name}", f"{getattr(entry, name):g} is outside {low:g} to {high:g}, what "
                             "there is", f"give it in {unit}")


def body_of(entry: RotorNacelleEntry) -> RigidBody:
    xx, yy, zz, xy, xz, yz = entry.inertia_kgm2
    return RigidBody(mass_kg=entry.mass_kg, centre_m=np.array(entry.centre_m),
                        inertia_kgm2=np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))


def mount_tower(
    file: SubDynFile, entry: TowerEntry, tower: Tower, body: RigidBody, platform: RigidBody | None, where: str
) -> MountedTower:
    """Put a tower of `entry.elements` uniform beams on a joint, or on a rigid transition piece, with ElastoDyn's
    platform at its foot; numbers follow the file's highest ones."""
    if entry.joint is None:
        file, foot = _transition_piece(file, tower, where)
    else:
        foot = _foot(file, entry.joint, tower, where)
    if platform is not None:
        at = (*foot.position_m[:2], 0.0)
        file = replace(file, masses=(*file.masses, _mass(foot, platform, np.array(at))))
    n, x, y = entry.elements, *foot.position_m[:2]
    height = tower.top_m - tower.base_m
    first = max(j.id for j in file.joints) + 1
    joints = tuple(
        Joint(id=first + k, position_m=(x, y, tower.base_m + height * (k + 1) / n), kind="cantilever",
              direction=(0.0, 0.0, 0.0), stiffness=0.0, line=foot.line)
        for k in range(n)
    )
    member, number = (max((r.id for r in rows), default=0) + 1 for rows in (file.members, file.sets["arbitrary"]))
    ends = (foot.id, *(j.id for j in joints))
    members = tuple(
        Member(id=member + k, joints=(ends[k], ends[k + 1]), sets=(number + k, number + k), kind="arbitrary",
               spin_deg=0.0, cosine=None, line=foot.line)
        for k in range(n)
    )
    sets = tuple(Row(id=number + k, values=values, line=foot.line)
                 for k, values in enumerate(_sections(entry, tower, n)))
    mass = _mass(joints[-1], body, np.array(joints[-1].position_m))
    # on the nearest joint, not on that of rotor and nacelle, whose mass is a group of its own
    bearing = (foot, *joints[:-1]) if n > 1 else joints
    points = (_point_mass(bearing, (x, y, tower.base_m + share * height), kg) for share, kg in tower.point_mass)
    whole = replace(
        file, joints=(*file.joints, *joints), members=(*file.members, *members),
        masses=(*file.masses, *points, mass),
        sets={**file.sets, "arbitrary": (*file.sets["arbitrary"], *sets)},
    )
    return MountedTower(file=whole, members=tuple(m.id for m in members), mass=mass.id)


def _mass(joint: Joint, body: RigidBody, origin_m: np.ndarray) -> Row:
    """A body whose centre counts from `origin_m` (3,) as a concentrated mass of a joint."""
    inertia, offset = body.inertia_kgm2, origin_m + body.centre_m - np.array(joint.position_m)
    return Row(id=joint.id, line=joint.line, values=(
        body.mass_kg, *(float(inertia[i, j]) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))),
        *(float(c) for c in offset)))


def _point_mass(joints: Sequence[Joint], place: tuple[float, float, float], kg: float) -> Row:
    """A mass at a place, carried by the nearest of the joints."""
    nearest = min(joints, key=lambda joint: abs(joint.position_m[2] - place[2]))
    body = RigidBody(mass_kg=kg, centre_m=np.zeros(3), inertia_kgm2=np.zeros((3, 3)))
    return _mass(nearest, body, np.array(place))


def _foot(file: SubDynFile, id: int, tower: Tower, where: str) -> Joint:
    foot = next((j for j in file.joints if j.id == id), None)
    if foot is None:
        raise InputError(f"{where}: tower.joint", f"joint {id} is not in {file.where}", "correct its number")
    if foot.kind != "cantilever":
        raise InputError(f"{where}: tower.joint", f"joint {id} is {foot.kind}", "take a rigid joint")
    if abs(foot.position_m[2] - tower.base_m) > GAP * (tower.top_m - tower.base_m):
        raise InputError(f"{where}: tower.joint", f"joint {id} is at z = {foot.position_m[2]:g} m and the "
                         f"tower's base at {tower.base_m:g} m", "name the joint the tower stands on, or none: it then "
                         "stands on a rigid transition piece")
    return foot


def _transition_piece(file: SubDynFile, tower: Tower, where: str) -> tuple[SubDynFile, Joint]:
    """A joint at the tower's base, above the file's origin, with massless rigid links to all interface joints: what
    OpenFAST makes of its platform. The joint itself where it is the only one and stands there."""
    at = {joint.id: joint for joint in file.joints}
    ends = [at[row.joint] for row in file.interfaces]
    if not ends:
        raise InputError(f"{where}: tower", "has no joint, and the SubDyn file has no interface joints", "name the "
                         "joint the tower stands on")
    if len({row.transition_piece for row in file.interfaces}) > 1:
        raise InputError(f"{where}: tower", "has no joint, and the SubDyn file has several transition pieces",
                         "name the joint the tower stands on")
    turning = next((joint for joint in ends if joint.kind != "cantilever"), None)
    if turning is not None:
        raise InputError(f"{where}: tower", f"the interface joint {turning.id} is {turning.kind}", "make it rigid "
                         "(type 1)")
    place = np.array([0.0, 0.0, tower.base_m])
    for joint in ends:
        if np.linalg.norm(np.array(joint.position_m) - place) <= GAP * (tower.top_m - tower.base_m):
            foot = joint
            break
    else:
        foot = Joint(id=max(at) + 1, position_m=(0.0, 0.0, tower.base_m), kind="cantilever",
                     direction=(0.0, 0.0, 0.0), stiffness=0.0, line=ends[0].line)
        file = replace(file, joints=(*file.joints, foot))
    number = max((row.id for row in file.sets["rigid"]), default=0) + 1
    member = max(row.id for row in file.members) + 1
    links = tuple(Member(id=member + k, joints=(foot.id, joint.id), sets=(number, number), kind="rigid", spin_deg=0.0,
                         cosine=None, line=joint.line)
                  for k, joint in enumerate(joint for joint in ends if joint.id != foot.id))
    rigid = (*file.sets["rigid"], Row(id=number, values=(0.0,), line=foot.line))
    return replace(file, members=(*file.members, *links), sets={**file.sets, "rigid": rigid}), foot


def _sections(entry: TowerEntry, tower: Tower, n: int) -> Sequence[tuple[float, ...]]:
    """Values of an arbitrary section for each element, properties averaged over it (linear between stations)."""
    fine = np.linspace(0.0, 1.0, 32 * n + 1)
    middle = 0.5 * (fine[:-1] + fine[1:])
    result = []
    columns = [np.interp(middle, tower.fraction, c).reshape(n, 32) for c in
               (tower.mass_kgpm, tower.stiffness_fa_nm2, tower.stiffness_ss_nm2)]
    # mass adds up along an element, flexibility too
    mass, fore_aft, side_side = columns[0].mean(1), *(1 / (1 / c).mean(1) for c in columns[1:])
    e, g = entry.youngs_modulus_pa, entry.shear_modulus_pa
    for k in range(n):
        area = mass[k] / entry.density_kgpm3
        # about y_e bends x, fore-aft
        i_yy, i_xx = fore_aft[k] / e, side_side[k] / e
        # half of the area in shear, as of a thin tube
        values = (e, g, entry.density_kgpm3, area, area / 2, area / 2, i_xx, i_yy, i_xx + i_yy, i_xx + i_yy)
        result.append(tuple(float(v) for v in values))
    return result
