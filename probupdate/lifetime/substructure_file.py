"""The SubDyn file of what stands below a turbine's tower, written, read back and solved again under its tower."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from probupdate.errors import InputError
from probupdate.io.subdyn_file import read_subdyn, write_subdyn
from probupdate.structure.assembly import supporting_matrices
from probupdate.structure.description import Description
from probupdate.structure.eigen import lowest_modes
from probupdate.structure.frame import Frame
from probupdate.structure.subdyn_model import assembled_file
from probupdate.structure.subdyn_writing import structure_alone, subdyn_file_of
from probupdate.structure.substructure import split, subdyn_substructure, with_tower
from probupdate.structure.turbine_frame import build_frame

NAME = "substructure.dat"
# modes of the turbine that are compared, and by how much they may differ: the piles' mass is condensed, what members
# carry is lumped
N_COMPARED, DIFFERENT = 6, 0.01


def write_substructure(d: Description, folder: Path, remark: str, frame: Frame | None = None) -> list[Path]:
    """Of a turbine (`frame`: where it has been built already) -> the paths, SubDyn's file first. Raises NoSubstructure
    where the tower stands on no structure, NoSubDynKeyword where it is more than SubDyn can be given."""
    frame = build_frame(d) if frame is None else frame
    above, foot = split(frame, d.name)
    file = subdyn_file_of(frame, d.values, above, foot, theory=d.mesh.theory, title=f"{d.name} | {remark}")
    return [write_subdyn(file, folder / NAME), *(folder / name for name in file.soil)]


def differences(d: Description, path: Path) -> np.ndarray:
    """(n,) relative, of the turbine's lowest frequencies with what is read from `path` below its tower from those of
    its frame without what the file leaves out (`subdyn_writing.NOT_WRITTEN`). Raises InputError where it is another
    structure."""
    frame, theory = build_frame(d), d.mesh.theory
    alone, read = structure_alone(frame), read_subdyn(path)
    found = with_tower(subdyn_substructure(*assembled_file(read)), alone, d.values, theory=theory)
    every = np.ones(len(frame.node_m), bool)
    K, M, _ = supporting_matrices(alone, d.values, every, theory=theory, gravity_mps2=None)
    own, again = (np.sqrt(lowest_modes(*pair, N_COMPARED, d.name)[0]) for pair in ((K, M), found))
    difference = again / own - 1
    if not np.abs(difference).max() < DIFFERENT:
        raise InputError(str(path), f"the turbine on what was read back has frequencies that differ by "
                         f"{np.abs(difference).max():.1e}", "report this: the file is not what the model is")
    return difference
