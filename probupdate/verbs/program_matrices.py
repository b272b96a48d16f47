"""Step from a finite-element program's matrices to a model: `matrices`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from probupdate.structure.matrix_import import ImportedMatrices, from_opensees, import_matrices


def matrices(
    source: str | Path | Sequence[str | Path], out: str | Path, *, parameters: str | Path | None = None
) -> ImportedMatrices:
    """K and M of a finite-element program as model.npz with parameters.toml beside it.

    source: one file that holds or names both matrices (CalculiX' .sti, ANSYS' .full, a .mat, .npz, .op4 or .pch with
    matrices K and M), or two, stiffness first (.mtx, .rb); parameters: a groups.toml with channels, parameters and
    their runs. Raises InputError where a file is missing or cannot be right.
    """
    several = [source] if isinstance(source, str | Path) else list(source)
    return import_matrices(several, out, groups=parameters)


# of a live model there is no file to name: probupdate.matrices.from_opensees("model.npz")
matrices.from_opensees = from_opensees  # type: ignore[attr-defined]
