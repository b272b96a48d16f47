"""OpenFAST's ElastoDyn file with its tower and blade files: what a model of the support structure takes from them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from probupdate.errors import InputError, parsing
from probupdate.io.elastodyn_keys import unused_keys
from probupdate.io.files import resolve_path
from probupdate.io.fortran_text import logical, number, read_lines, strip_quotes, words
from probupdate.runtime.arrays import frozen_array

# keys a rigid rotor-nacelle assembly is made of
NACELLE = ("NacMass", "NacCMxn", "NacCMyn", "NacCMzn", "NacYIner", "YawBrMass", "Twr2Shft", "OverHang", "ShftTilt",
           "HubMass", "HubIner", "HubCM", "NumBl", "TipRad", "HubRad")
PLATFORM = ("PtfmMass", "PtfmRIner", "PtfmPIner", "PtfmYIner", "PtfmCMxt", "PtfmCMyt", "PtfmCMzt", "PtfmXYIner",
            "PtfmXZIner", "PtfmYZIner")


@dataclass(frozen=True, eq=False, kw_only=True)
class Tower:
    """From base to top, heights above ground or mean sea level in m; fraction (n,) of the height between, mass_kgpm,
    stiffness_fa_nm2 and stiffness_ss_nm2 (n,) with the file's factors on them. point_mass (n_point, 2): fraction of the
    height and kg of concentrated masses."""

    base_m: float
    top_m: float
    fraction: np.ndarray
    mass_kgpm: np.ndarray
    stiffness_fa_nm2: np.ndarray
    stiffness_ss_nm2: np.ndarray
    point_mass: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class RigidBody:
    """Mass in kg, centre (3,) in m, inertia (3, 3) about the centre in kg m2; x downwind, z up. Rotor and nacelle are
    placed from the tower's top, the platform from the tower's axis at mean sea level."""

    mass_kg: float
    centre_m: np.ndarray
    inertia_kgm2: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class ElastoDyn:
    """`yaw_deg` (NacYaw) is in rotor_nacelle already; `looks_deg`: where the nacelle looks, counter-clockwise from x,
    which points downwind (OverHang is below zero upwind). `platform`: what SubDyn's interface carries, None without
    mass and inertia. `notes`: what of the files would change stiffness or mass and is not used."""

    tower: Tower
    rotor_nacelle: RigidBody
    yaw_deg: float
    looks_deg: float
    platform: RigidBody | None
    notes: tuple[str, ...]


class _Keys:
    """Lines of 'value name - text'; every mistake names file and line."""

    def __init__(self, path: Path, root: Path | None = None):
        self.path, self.root = path, (root or path.parent).resolve()
        self.lines = read_lines(path)
        self.found, self.used, self.files = {}, set(), [self]
        for at, line in enumerate(self.lines, 1):
            parts = words(line)
            # a heading may have a key's name: ------ FURLING ------
            if len(parts) > 1 and not parts[0].startswith(("--", "==")):
                self.found.setdefault(parts[1].lower(), (at, parts[0]))

    def word(self, name: str) -> tuple[int, str]:
        if name.lower() not in self.found:
            raise InputError(str(self.path), f"{name} is missing", f"add a line '<value> {name}'")
        self.used.add(name.lower())
        return self.found[name.lower()]

    def number(self, name: str, missing: float | None = None) -> float:
        if missing is not None and name.lower() not in self.found:
            return missing
        at, word = self.word(name)
        value = number(word)
        if value is None:
            raise InputError(f"{self.path}, line {at}", f"{name} is '{word}', no number", "write a number")
        return value

    def referenced_file(self, name: str) -> Path:
        at, word = self.word(name)
        file = resolve_path(strip_quotes(word), self.path.resolve().parent, f"{self.path}, line {at}, {name}",
                            root=self.root, remedy="put it into that folder, or the model's TOML above both")
        if not file.is_file():
            raise InputError(f"{self.path}, line {at}", f"there is no file '{strip_quotes(word)}'", "put it beside")
        return file

    def opened(self, name: str) -> _Keys:
        file = _Keys(self.referenced_file(name), self.root)
        self.files.append(file)
        return file

    def notes(self) -> tuple[str, ...]:
        """What is not used of this file and of those opened from it."""
        return tuple(dict.fromkeys(note for file in self.files
                                   for note in unused_keys(file.lines, str(file.path), file.used)))

    def not_negative(self, name: str) -> float:
        """A number that must not be negative, 0 where it is not given."""
        value = self.number(name, 0.0)
        if value < 0:
            raise InputError(f"{self.path}, line {self.word(name)[0]}", f"{name} is {value:g}", "give zero or more")
        return value

    def stations(self, count: str, first: str, columns: int) -> np.ndarray:
        """The table whose line of names begins with `first`, a fraction that rises from 0 to 1."""
        start = next((k for k, line in enumerate(self.lines) if line.split()[:1] == [first]), None)
        if start is None:
            raise InputError(str(self.path), f"no table begins with {first}", "check the file")
        table = self.rows(start, count, columns)
        if len(table) < 2 or np.any(np.diff(table[:, 0]) <= 0) or abs(table[0, 0]) > 1e-6 or abs(
                table[-1, 0] - 1) > 1e-6:
            raise InputError(f"{self.path}, line {start + 3}", f"{first} does not rise from 0 to 1",
                             "correct the column")
        return table

    def rows(self, start: int, count: str, columns: int) -> np.ndarray:
        """The rows below a line of names, the `start`-th from zero, and one of units, leading `columns` numbers."""
        n, rows = int(self.number(count)), []
        for k in range(start + 2, start + 2 + n):
            values = [number(w) for w in words(self.lines[k])] if k < len(self.lines) else []
            if len(values) < columns or None in values[:columns]:
                raise InputError(f"{self.path}, line {k + 1}", f"row {k - start - 1} of {n} ({count}) has not "
                                 f"{columns} numbers", "complete it, or correct the count")
            rows.append(values[:columns])
        return np.array(rows)


def read_elastodyn(path: str | Path, root: Path | None = None) -> ElastoDyn:
    """Read an ElastoDyn file, its tower file and, for the rotor's mass, its blade files; all of them in the folder
    `root` or below (the file's own where None)."""
    keys = _Keys(Path(path), root)
    with parsing(str(path), "holds numbers of no turbine", "correct the largest of them"), np.errstate(
            over="raise", invalid="raise", divide="raise"):
        _refuse_furling(keys)
        yaw = keys.number("NacYaw", 0.0)
        return ElastoDyn(tower=_tower(keys), rotor_nacelle=turned_body(_rotor_nacelle(keys), yaw), yaw_deg=yaw,
                         looks_deg=yaw + (180.0 if keys.number("OverHang") < 0 else 0.0),
                         platform=_platform(keys), notes=keys.notes())


def turned_body(body: RigidBody, angle_deg: float) -> RigidBody:
    """The body counter-clockwise about z."""
    c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return RigidBody(mass_kg=body.mass_kg, centre_m=frozen_array(turn @ body.centre_m),
                     inertia_kgm2=frozen_array(turn @ body.inertia_kgm2 @ turn.T))


def _refuse_furling(keys: _Keys) -> None:
    if "furling" not in keys.found:
        return
    at, word = keys.word("Furling")
    if logical(word) is not False:
        raise InputError(f"{keys.path}, line {at}", f"Furling is '{word}': the masses of tail and furling rotor "
                         "stand in FurlFile, which is not read", "give [rotor_nacelle] with them in the model's TOML "
                         "and write False")


def _platform(keys: _Keys) -> RigidBody | None:
    """The rigid platform on SubDyn's interface. Products of inertia (newer files) are the tensor's own entries,
    -int x y dm."""
    mass, roll, pitch, yaw = (keys.not_negative(name) for name in PLATFORM[:4])
    x, y, z, xy, xz, yz = (keys.number(name, 0.0) for name in PLATFORM[4:])
    inertia = np.array([[roll, xy, xz], [xy, pitch, yz], [xz, yz, yaw]])
    if not mass and not inertia.any():
        return None
    return RigidBody(mass_kg=mass, centre_m=frozen_array([x, y, z]), inertia_kgm2=frozen_array(inertia))


def referenced_files(path: str | Path, root: Path | None = None) -> tuple[Path, ...]:
    """The files that `read_elastodyn` reads, resolved, the given one first."""
    keys = _Keys(Path(path), root)
    blades = (keys.referenced_file(_blade_key(keys, k)) for k in range(1, int(keys.number("NumBl")) + 1))
    return tuple(dict.fromkeys((Path(path).resolve(), keys.referenced_file("TwrFile"), *blades)))


def _blade_key(keys: _Keys, blade: int) -> str:
    return f"BldFile{blade}" if f"bldfile{blade}" in keys.found else f"BldFile({blade})"


def _tower(keys: _Keys) -> Tower:
    file = keys.opened("TwrFile")
    table = file.stations("NTwInpSt", "HtFract", 4)
    factors = [file.number(name, 1.0) for name in ("AdjTwMa", "AdjFASt", "AdjSSSt")]
    base, top = keys.number("TowerBsHt"), keys.number("TowerHt")
    if not base < top:
        raise InputError(str(keys.path), f"TowerHt {top:g} is not above TowerBsHt {base:g}", "correct them")
    for k, name in enumerate(("TMassDen", "TwFAStif", "TwSSStif"), 1):
        if np.any(table[:, k] <= 0):
            raise InputError(str(file.path), f"{name} is not above zero everywhere", "correct the column")
    mass, fore_aft, side_side = (frozen_array(table[:, k + 1] * factors[k]) for k in range(3))
    return Tower(base_m=base, top_m=top, fraction=frozen_array(table[:, 0]), mass_kgpm=mass,
                 stiffness_fa_nm2=fore_aft, stiffness_ss_nm2=side_side, point_mass=_point_masses(file))


def _point_masses(file: _Keys) -> np.ndarray:
    """The tower file's concentrated masses (newer files), below the line of their number."""
    if not file.not_negative("NTwCMass"):
        return np.zeros((0, 2))
    line = file.word("NTwCMass")[0]
    table = file.rows(line, "NTwCMass", 2)
    if np.any((table < 0) | (table > [1, np.inf])):
        raise InputError(f"{file.path}, line {line + 3}", "a concentrated mass of the tower is below zero, or its "
                         "height not between 0 and 1 of the tower's", "correct its row")
    return frozen_array(table)


def _rotor_nacelle(keys: _Keys) -> RigidBody:
    """Nacelle, yaw bearing, hub and blades as particles, with the inertia the file states about its axes; the rotor
    does not turn about its shaft, and what is on the fast shaft is left out."""
    v = {name: keys.number(name) for name in NACELLE}
    for name in ("NacMass", "YawBrMass", "HubMass", "HubIner", "TipRad", "HubRad"):
        keys.not_negative(name)
    tilt = math.radians(v["ShftTilt"])
    shaft, up = np.array([math.cos(tilt), 0.0, math.sin(tilt)]), np.array([-math.sin(tilt), 0.0, math.cos(tilt)])
    apex = np.array([0.0, 0.0, v["Twr2Shft"]]) + v["OverHang"] * shaft
    nacelle = np.array([v["NacCMxn"], v["NacCMyn"], v["NacCMzn"]])
    points, masses = [nacelle, np.zeros(3), apex + v["HubCM"] * shaft], [v["NacMass"], v["YawBrMass"], v["HubMass"]]
    own = v["HubIner"] * np.outer(shaft, shaft)
    # about the yaw axis, so that what its mass has there comes off
    least = v["NacMass"] * (nacelle[0] ** 2 + nacelle[1] ** 2)
    if v["NacYIner"] < least:
        raise InputError(f"{keys.path}, line {keys.word('NacYIner')[0]}", f"NacYIner is {v['NacYIner']:g}, below the "
                         f"{least:g} kg m2 of NacMass at NacCMxn and NacCMyn", "give it about the yaw axis; ElastoDyn "
                         "refuses it too")
    own[2, 2] += v["NacYIner"] - least
    count = int(v["NumBl"])
    for blade in range(1, count + 1):
        file = keys.opened(_blade_key(keys, blade))
        table = file.stations("NBlInpSt", "BlFract", 3) if _column(file, "StrcTwst") == 1 else file.stations(
            "NBlInpSt", "BlFract", 4)[:, [0, 1, 3]]
        density = table[:, 2] * file.number("AdjBlMs", 1.0)
        cone = math.radians(keys.number(f"PreCone({blade})"))
        angle = 2 * math.pi * (blade - 1) / count
        along = math.cos(cone) * (math.cos(angle) * up + math.sin(angle) * np.array([0.0, 1.0, 0.0]))
        along = along + math.sin(cone) * shaft
        length = v["TipRad"] - v["HubRad"]
        # linear density between stations: Simpson's points carry mass and inertia exactly enough
        for a, b, da, db in zip(table[:-1, 0], table[1:, 0], density[:-1], density[1:], strict=True):
            for share, weight in ((0.0, 1 / 6), (0.5, 4 / 6), (1.0, 1 / 6)):
                radius = v["HubRad"] + (a + share * (b - a)) * length
                points.append(apex + radius * along)
                masses.append(weight * (da + share * (db - da)) * (b - a) * length)
        tip = keys.not_negative(f"TipMass({blade})")
        points.append(apex + v["TipRad"] * along)
        masses.append(tip)
    points, masses = np.array(points), np.array(masses)
    total = float(masses.sum())
    if total <= 0:
        raise InputError(str(keys.path), "rotor and nacelle have no mass", "check NacMass, HubMass and the blade files")
    centre = masses @ points / total
    d = points - centre
    inertia = own + (masses * (d**2).sum(1)).sum() * np.eye(3) - np.einsum("i,ij,ik->jk", masses, d, d)
    return RigidBody(mass_kg=total, centre_m=frozen_array(centre), inertia_kgm2=frozen_array(inertia))


def _column(file: _Keys, name: str) -> int:
    """Where a blade table has a column: older files have the pitch axis before the twist."""
    header = next((line.split() for line in file.lines if line.split()[:1] == ["BlFract"]), [])
    return header.index(name) if name in header else 1
