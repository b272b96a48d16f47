"""Whole files of other programs: matrices, SubDyn, ElastoDyn, universal files, tables of poles."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

HERE = Path(__file__).resolve().parent
# a case: makes its files in a folder, names those to be spoilt, and the call that reads them
Made = tuple[list[Path], Callable[[], object]]
SHAPE = np.random.default_rng(4).standard_normal((6, 3)) + 1j


def module_of(folder: str, name: str):
    spec = importlib.util.spec_from_file_location(f"{folder}_{name}", HERE.parent / folder / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def calculix(folder: Path) -> Made:
    from probupdate.structure.matrix_import import import_matrices

    for name, scale in (("job", 1.0), ("more", 1.5)):
        rows = [(k, k, 2.0 * scale) for k in range(1, 7)] + [(k, k + 1, -1.0 * scale) for k in range(1, 6)]
        (folder / f"{name}.sti").write_text("".join(f"{i} {j} {1e4 * v!r}\n" for i, j, v in rows))
        (folder / f"{name}.mas").write_text("".join(f"{k} {k} 1.0\n" for k in range(1, 7)))
        (folder / f"{name}.dof").write_text("".join(f"{k}.1\n" for k in range(1, 7)))
    (folder / "job.inp").write_text("*NODE\n" + "".join(f"{k}, {k}., 0.\n" for k in range(1, 6)) + "*END STEP\n")
    (folder / "groups.toml").write_text(
        '[[channel]]\nname = "a"\nnode = 2\ndirection = "-x"\n[[parameter]]\nname = "k"\ncov = 0.1\nlower = 0.2\n'
        'upper = 3.0\nruns = [{ file = "more.sti", value = 1.5 }]\n')
    paths = [folder / name for name in ("job.sti", "job.mas", "job.dof", "job.inp", "more.sti", "groups.toml")]

    def read() -> object:
        for old in ("model.npz", "parameters.toml"):
            (folder / "out" / old).unlink(missing_ok=True)
        return import_matrices([folder / "job.sti"], folder / "out" / "model.npz", groups=folder / "groups.toml")

    return paths, read


def punch(folder: Path) -> Made:
    from probupdate.io.program_matrices import read_program_matrices

    lines = []
    for name in ("KAA", "MAA"):
        lines.append(f"DMIG    {name:<8}{0:>8}{6:>8}{2:>8}{0:>8}")
        for k in range(1, 5):
            lines += [f"DMIG*   {name:<16}{k:>16}{1:>16}", f"*       {k:>16}{1:>16}{'2.0D+00':>16}"]
    (folder / "both.pch").write_text("\n".join(lines) + "\n")
    return [folder / "both.pch"], lambda: read_program_matrices([folder / "both.pch"])


def subdyn(folder: Path) -> Made:
    from subdyn_text import STEEL
    from subdyn_text import subdyn as text

    from probupdate.structure.load import load_model

    (folder / "soil.txt").write_text("5.0E+08\tKxx ! lateral\n! a comment\nKyy 6.0D8\n1e9 Kzz\n2e3 Mxx\n")
    (folder / "structure.dat").write_text(text(
        ["0 0 0", "0 0 10"], ["1 2 7 7 1c 0"], reactions=['1 0 0 0 1 1 1 "soil.txt" ! held'], interface=[2],
        circular=[f"7 {STEEL} 1.0 0.02 extra"]))
    return [folder / "structure.dat", folder / "soil.txt"], lambda: load_model(folder / "structure.dat")


def elastodyn(folder: Path) -> Made:
    from probupdate.io.elastodyn_file import read_elastodyn

    path = module_of("io", "test_elastodyn_file").write(folder)
    return [path, *(p for p in folder.iterdir() if p != path)], lambda: read_elastodyn(path)


def uff(kind: str):
    def make(folder: Path) -> Made:
        import pytest

        pytest.importorskip("pyuff", reason="pyuff is not installed (pip install probupdate[uff])")
        cases = module_of("campaign", "test_uff_file")
        if kind == "modes":
            cases.write_uff_modes(cases.modes(), cases.sensors(), folder / "modes.uff")
            return [folder / "modes.uff"], lambda: cases.read_uff_modes(folder / "modes.uff", cases.sensors())
        cases.records(folder, n=50)
        path = next(folder.glob("*.uff"))
        return [path], lambda: cases.read_uff_records(path)

    return make


def pole_tables(suffix: str):
    def make(folder: Path) -> Made:
        from scipy.io import savemat

        from probupdate.campaign.pole_tables import read_pole_tables

        arrays = {"f": np.array([0.8, 2.1, 3.4]), "xi": np.full(3, 0.01), "phi": SHAPE.real[:4]}
        path, toml = folder / f"poles{suffix}", folder / "poles.toml"
        words, rows = 'shape = "phi"\n', "[channels]\na = 1\nb = 3\n"
        if suffix == ".csv":
            words, rows = 'block = "k"\ncomponents = "real and imaginary"\n', '[channels]\na = ["a", "b"]\nb = "c"\n'
            pd.DataFrame({"k": [1, 1, 2], "f": arrays["f"], "xi": arrays["xi"], **dict(zip("abcd", arrays["phi"],
                          strict=True))}).to_csv(path, index=False)
        elif suffix == ".npz":
            np.savez(path, **arrays)
        else:
            savemat(path, arrays)
        toml.write_text('frequency = "f"\nfrequency_unit = "Hz"\ndamping = "xi"\ndamping_unit = "ratio"\n'
                        + words + rows)
        return [path, toml], lambda: read_pole_tables(path, description=toml)

    return make
