"""Guyan and Craig-Bampton superelements of a structure at its transition piece, as .npz and for OpenFAST's ExtPtfm.

u_L = Phi_R u_TP + Phi_m q: static shapes of the interface's six rigid motions and the lowest modes with it held
(Craig & Bampton 1968), as SubDyn reduces; damping is what a SubDyn file says (JDampings, GuyanDampMod), none otherwise.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy import linalg, sparse
from scipy.sparse import linalg as sparse_linalg

from probupdate.errors import InputError
from probupdate.io.files import archive_arrays, write_arrays, write_text
from probupdate.io.fortran_text import number, read_lines
from probupdate.io.subdyn_file import SubDynFile
from probupdate.runtime.arrays import frozen_array
from probupdate.structure.eigen import lowest_modes
from probupdate.structure.subdyn_model import assembled_file
from probupdate.structure.substructure import Substructure, subdyn_substructure

# frequencies of what is read back and those written: text keeps 17 digits
READ_BACK = 1e-6


@dataclass(frozen=True, eq=False, kw_only=True)
class Superelement:
    """stiffness, mass, damping (6 + n_mode, 6 + n_mode): surge, sway, heave, roll, pitch, yaw of the reference point in
    N, m, rad, kg, then the modes with the interface held, at unit modal mass. recovery (n_joint, 6, 6 + n_mode): motion
    of each joint (rotations of one that turns are NaN). frequency_hz (n,): with the interface free, of the
    superelement; full_hz (n,): of the structure it stands for, so that their difference is the truncation error."""

    reference_m: np.ndarray
    stiffness: np.ndarray
    mass: np.ndarray
    damping: np.ndarray
    recovery: np.ndarray
    joints: tuple[int, ...]
    frequency_hz: np.ndarray
    full_hz: np.ndarray

    @property
    def truncation(self) -> np.ndarray:
        """(n,) relative error of each frequency, not negative but for rounding."""
        return self.frequency_hz / self.full_hz - 1

    @property
    def guyan(self) -> Superelement:
        """Of the six motions alone."""
        stiffness, mass = self.stiffness[:6, :6], self.mass[:6, :6]
        own = frequencies(stiffness, mass)[: len(self.full_hz)]
        return replace(self, stiffness=stiffness, mass=mass, damping=self.damping[:6, :6],
                       recovery=self.recovery[..., :6], frequency_hz=frozen_array(own),
                       full_hz=self.full_hz[: len(own)])


def superelement(file: SubDynFile, *, n_mode: int, reference_m=None, compared: int = 6) -> Superelement:
    """Reduce a structure to its interface joints, taken as rigidly fixed to the reference point (their mean where none
    is given), and `n_mode` modes; 0 is Guyan's reduction. Damping is what the file says. Raises InputError where there
    is not an interface."""
    whole = subdyn_substructure(*assembled_file(file), reference_m)
    return reduce_model(whole, n_mode=n_mode, compared=compared, damping=partial(_damping, file))


def reduce_model(
    whole: Substructure, *, n_mode: int, compared: int = 6,
    damping: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray] | None = None,
) -> Superelement:
    """The same of any structure. `damping`: from stiffness and mass (6 + n_mode,) squared and the modes' angular
    frequencies (n_mode,); None: zero."""
    K, M, rows, rigid = whole.stiffness, whole.mass, whole.interface, whole.rigid
    # rows of the interface in what is left after constraints, and their rigid motion with the reference point
    boundary = np.unique(sparse.coo_array(rows).coords[1])
    motion, *_ = np.linalg.lstsq(rows[:, boundary].toarray(), rigid, rcond=None)
    if np.abs(rows[:, boundary] @ motion - rigid).max() > 1e-8 * np.abs(rigid).max():
        raise InputError(whole.where, "the interface cannot move as a rigid body: a reaction holds it",
                         "free the interface joints at the reactions")
    inner = np.setdiff1d(np.arange(K.shape[0]), boundary)
    KLL, MLL = (sparse.csc_array(X[inner][:, inner]) for X in (K, M))
    if n_mode < 0 or n_mode >= len(inner) - 1:
        raise InputError("modes", f"{n_mode} modes are asked for, and it has {len(inner)} inner degrees of freedom",
                         "ask for fewer")
    load = (K[inner][:, boundary] @ motion)
    guyan = -sparse_linalg.splu(sparse.csc_matrix(KLL)).solve(np.asarray(load))
    value, shape = (np.zeros(0), np.zeros((len(inner), 0)))
    if n_mode:
        value, shape = lowest_modes(KLL, MLL, n_mode, whole.where)
    basis = np.zeros((K.shape[0], 6 + n_mode))
    basis[boundary, :6], basis[inner, :6], basis[inner, 6:] = motion, guyan, shape
    stiffness, mass = (_symmetrise(basis.T @ (X @ basis)) for X in (K, M))
    # what is zero and one by construction
    stiffness[:6, 6:], stiffness[6:, :6], stiffness[6:, 6:] = 0.0, 0.0, np.diag(value)
    mass[6:, 6:] = np.eye(n_mode)
    full = np.sqrt(_positive(lowest_modes(K, M, min(compared, K.shape[0] - 2), whole.where)[0])) / (2 * np.pi)
    own = frequencies(stiffness, mass)[: len(full)]
    recovery = (whole.joint_motion @ basis).reshape(len(whole.joints), 6, 6 + n_mode)
    recovery[~whole.there] = np.nan
    damped = np.zeros_like(stiffness) if damping is None else damping(stiffness, mass, np.sqrt(value))
    return Superelement(
        reference_m=frozen_array(whole.reference_m), stiffness=frozen_array(stiffness), mass=frozen_array(mass),
        damping=frozen_array(damped), recovery=frozen_array(recovery), joints=whole.joints,
        frequency_hz=frozen_array(own), full_hz=frozen_array(full[: len(own)]),
    )


def _symmetrise(matrix: np.ndarray) -> np.ndarray:
    return 0.5 * (matrix + matrix.T)


def _positive(value: np.ndarray) -> np.ndarray:
    return np.maximum(value, 0.0)


def frequencies(stiffness: np.ndarray, mass: np.ndarray) -> np.ndarray:
    """(n,) in Hz, ascending, of a superelement with its interface free."""
    return np.sqrt(_positive(linalg.eigh(stiffness, mass, eigvals_only=True))) / (2 * np.pi)


def _damping(file: SubDynFile, stiffness, mass, angular) -> np.ndarray:
    damping = np.zeros_like(stiffness)
    mode = int(float(file.settings.get("GuyanDampMod", "0")))
    if mode == 1:
        alpha, beta = (number(w) for w in file.settings["RayleighDamp"].split())
        damping[:6, :6] = alpha * mass[:6, :6] + beta * stiffness[:6, :6]
    elif mode == 2:
        rows = [file.settings[f"GuyanDampMat{k + 1}"].split() for k in range(int(file.settings["GuyanDampSize"]))]
        if len(rows) != 6:
            raise InputError(file.where, f"its Guyan damping matrix is of size {len(rows)}",
                             "give 6: one transition piece")
        damping[:6, :6] = [[number(w) for w in row] for row in rows]
    percent = [number(w) for w in file.settings.get("JDampings", "").split()] or [0.0]
    ratio = np.array((percent + [percent[-1]] * len(angular))[: len(angular)]) / 100
    damping[6:, 6:] = np.diag(2 * ratio * angular)
    return damping


def write_superelement(one: Superelement, folder: Path, name: str, remark: str) -> tuple[Path, Path]:
    """<name>.npz with every array, and <name>.dat, the reduced file of ExtPtfm; both read back and their frequencies
    compared."""
    archive, text = folder / f"{name}.npz", folder / f"{name}.dat"
    write_arrays(archive, {
        "reference_m": one.reference_m, "K": one.stiffness, "M": one.mass, "C": one.damping, "recovery": one.recovery,
        "joint": np.array(one.joints), "frequency_hz": one.frequency_hz, "full_frequency_hz": one.full_hz,
        "remark": np.array(remark)})
    n = len(one.mass)
    lines = ["!Comment", f"!Comment {remark}", f"!Dimension: {n}", "!Time increment in simulation: 0.05",
             "!Total simulation time in file: 0", ""]
    for title, matrix in (("Mass", one.mass), ("Damping", one.damping), ("Stiffness", one.stiffness)):
        lines += [f"!{title} Matrix", f"!Dimension: {n}", *(" ".join(f"{v:.17e}" for v in row) for row in matrix), ""]
    write_text(text, "\n".join(lines) + "\n")
    held = archive_arrays(archive, "is not read back", "check the disk it was written to")
    _compare(archive, one, held["K"], held["M"])
    read = read_extptfm(text)
    _compare(text, one, read["Stiffness"], read["Mass"])
    return archive, text


def _compare(path: Path, one: Superelement, stiffness, mass) -> None:
    found = frequencies(stiffness, mass)[: len(one.frequency_hz)]
    # a free structure has motions of 0 Hz, which have no relative error
    error = np.abs(found - one.frequency_hz) / np.maximum(one.frequency_hz, 1e-3 * one.frequency_hz.max())
    if not error.max() < READ_BACK:
        raise InputError(str(path), f"what was read back has frequencies that differ by {error.max():.1e}",
                         "check the disk it was written to")


def _dimension(line: str) -> int | None:
    """Of a line '!Dimension: n'; the loads' own ('1 time column - 3 force columns') is another."""
    found = re.fullmatch(r"!dimension\s*:?\s*(\d+)", line)
    return int(found[1]) if found else None


def read_extptfm(path: str | Path) -> dict[str, np.ndarray]:
    """Mass, Damping, Stiffness (n, n) of a reduced file of OpenFAST's ExtPtfm."""
    lines, found, n, at = read_lines(path), {}, None, 0
    while at < len(lines):
        head = lines[at].strip().lower()
        at += 1
        n = _dimension(head) or n
        title = next((t for t in ("Mass", "Damping", "Stiffness") if head.startswith(f"!{t.lower()}")), None)
        if title is None:
            continue
        if at < len(lines) and _dimension(lines[at].strip().lower()):
            n = _dimension(lines[at].strip().lower())
            at += 1
        rows = [[number(w) for w in line.split()] for line in lines[at : at + (n or 0)]]
        if n is None or len(rows) != n or any(len(r) != n or None in r for r in rows):
            raise InputError(f"{path}, line {at + 1}", f"the {title} matrix is not {n} rows of {n} numbers",
                             "correct it")
        found[title] = np.array(rows)
        at += n
    missing = {"Mass", "Damping", "Stiffness"} - set(found)
    if missing:
        raise InputError(str(path), f"has no {', '.join(sorted(missing))} matrix", "give a reduced file of ExtPtfm")
    return found
