"""A finite-element program's matrices as `model.npz` with `parameters.toml`: corrected where a program leaves them in
its own form, refused where they cannot be right, and solved again beside what the program printed."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import ValidationError
from scipy import sparse

from probupdate.errors import InputError
from probupdate.io.files import read_text, read_toml, write_arrays, write_text
from probupdate.io.program_matrices import ProgramMatrices, opensees_matrices, read_program_matrices
from probupdate.io.result_table import plural, table_of
from probupdate.runtime.arrays import frozen_array
from probupdate.structure.eigen import lowest_modes
from probupdate.structure.matrices import SPARSE_PARTS, load_matrices, read_archive
from probupdate.structure.parameter_table import read_parameters, updated_parameters
from probupdate.structure.plausible_size import implausible_size, lying_words
from probupdate.structure.schema import Number, Positive, Table

if TYPE_CHECKING:
    import pandas as pd

AXES = ("x", "y", "z", "rx", "ry", "rz")
# directions of a plane model, numbered from one -> the same where it stands upright
IN_PLANE = {1: 1, 2: 3, 6: 5}
# asymmetry of a matrix, of its largest entry, that is rounding of printed digits
ROUNDING = 1e-8
# a diagonal so many times the next lower one, with nothing beside it, stands for a held row
PENALTY = 1e6
# largest difference of two runs' derivatives, of the derivative itself, that printed digits explain
LINEAR = 1e-4
# difference from the program's own frequencies that is refused: beyond what another eigensolver or printed digits make
REFUSED_DIFFERENCE = 0.02
COUNT = 8
# channels that are written where none are named
MOST_CHANNELS = 12
# names of a model's matrices in its archive
MATRIX_KEYS = ("K0", "M0", "K_", "M_")


class ChannelRow(Table):
    """A sensor: its name, the program's node number, and the direction, with a minus where it reads against it."""

    name: str
    node: int
    direction: Literal["x", "y", "z", "rx", "ry", "rz", "-x", "-y", "-z", "-rx", "-ry", "-rz"]


class RunRow(Table):
    """A run of the same model with one parameter at another value; `mass` where the mass is another file."""

    file: str
    value: Number
    mass: str | None = None


class GroupRow(Table):
    """A parameter, as in parameters.toml, with the runs that show what it does."""

    name: str
    runs: tuple[RunRow, ...]
    unit: str = "-"
    initial: Number = 1.0
    cov: Positive | None = None
    std: Positive | None = None
    lower: Number
    upper: Number
    prior: Literal["normal", "lognormal", "uniform"] = "normal"
    description: str = ""


class Check(Table):
    """What the program printed of the model whose file is given."""

    frequencies_hz: tuple[Positive, ...]


class Groups(Table):
    """groups.toml: channels, parameters with their runs, frequencies to compare with, and how many metres the program's
    unit of length is (nodes' places are written in m)."""

    unit_of_length_m: Positive = 1.0
    channel: tuple[ChannelRow, ...] = ()
    parameter: tuple[GroupRow, ...] = ()
    check: Check | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class ImportedMatrices:
    """files written; n rows; frequency_hz computed again; printed, what the program gave (or None); notes: what was
    corrected, left out or not checked."""

    files: tuple[Path, ...]
    n_row: int
    channels: tuple[str, ...]
    parameters: tuple[str, ...]
    frequency_hz: np.ndarray
    printed_hz: np.ndarray | None
    notes: tuple[str, ...]

    @property
    def summary(self) -> str:
        known = ", ".join(f"{f:.5g}" for f in self.frequency_hz[:5])
        lines = [f"{self.n_row} degrees of freedom, {plural(len(self.channels), 'channel')}, "
                 f"{plural(len(self.parameters), 'parameter')} ({', '.join(self.parameters)})",
                 f"frequencies: {known} Hz"]
        if self.printed_hz is None:
            lines.append("the program's own frequencies are not known: hold these against what it prints")
        else:
            n = min(len(self.printed_hz), len(self.frequency_hz))
            worst = float(np.max(np.abs(self.frequency_hz[:n] / self.printed_hz[:n] - 1)))
            lines.append(f"within {worst:.1e} of the {n} frequencies that the program printed")
        return "\n".join([*lines, *(f"note: {text}" for text in self.notes)])

    def to_frame(self) -> pd.DataFrame:
        """A row a mode: computed again, and as printed."""
        given = [] if self.printed_hz is None else self.printed_hz.tolist()
        rows = [{"mode": k + 1, "frequency_hz": float(f), "printed_hz": given[k] if k < len(given) else np.nan}
                for k, f in enumerate(self.frequency_hz)]
        return table_of(rows, ("mode", "frequency_hz", "printed_hz"))


def import_matrices(
    source: Sequence[str | Path], out: str | Path, *, groups: str | Path | None = None
) -> ImportedMatrices:
    """Write `out` (an .npz) and parameters.toml beside it. `source`: one file that holds or names both matrices (a
    model.npz too), or stiffness and mass; `groups`: a groups.toml. Raises InputError where a file is missing, not of a
    known form, or cannot be right."""
    files = [Path(s) for s in source]
    return write_matrices(_read_files(files), out, files=files, groups=groups)


def from_opensees(out: str | Path, *, ops=None, groups: str | Path | None = None) -> ImportedMatrices:
    """The model that OpenSeesPy holds, as `import_matrices` writes it. ops: `openseespy.opensees`; a groups.toml may
    name channels here; runs of parameters are of files, such as those that this writes."""
    return write_matrices(_stand_upright(opensees_matrices(ops)), out, files=[Path("OpenSees")], groups=groups)


def _read_files(files: Sequence[Path]) -> ProgramMatrices:
    """Of a program's files, or of a model.npz."""
    path = files[0]
    if len(files) == 1 and path.suffix.lower() == ".npz" and path.is_file():
        content = read_archive(path)
        if "K0_data" in content or ("K0" in content and ("channel" in content or any(
                key[:2] in ("K_", "M_") for key in content))):
            return _model_matrices(path, content)
    return _stand_upright(read_program_matrices(files))


def _stand_upright(given: ProgramMatrices) -> ProgramMatrices:
    """A model whose nodes lie in one plane of x and y and move in it alone, with its y as z: programs draw plane frames
    with y upwards, and z is upwards here."""
    direction, place = given.direction, given.place
    moves = set() if direction is None else set(np.unique(direction).tolist())
    if direction is None or not place or not {1} < moves <= set(IN_PLANE):
        return given
    if np.ptp([at[2] for at in place.values()]):
        return given
    # a turn from x to y about z is one from x to z, against that about y
    sign = sparse.diags_array(np.where(direction == 6, -1.0, 1.0))
    return replace(
        given, stiffness=sparse.csc_array(sign @ given.stiffness @ sign),
        mass=sparse.csc_array(sign @ given.mass @ sign),
        direction=np.array([IN_PLANE.get(int(d), int(d)) for d in direction]),
        place={node: np.array([x, -z, y]) for node, (x, y, z) in place.items()},
        notes=(*given.notes, "a plane model stands upright: its y is z here, also in groups.toml, its rotation about z "
                             "the one about y, reversed"))


def _model_matrices(path: Path, content: dict[str, np.ndarray]) -> ProgramMatrices:
    """K and M of a model.npz at the initial values of the parameters.toml beside it (at 1 of the factor on all
    stiffness that was written where no parameters were named), and its other arrays as they are."""
    table = path.with_name("parameters.toml")
    parameters = read_parameters(table) if table.exists() or not _is_default(content) else None
    if _is_default(content) and (parameters is None or "stiffness" not in parameters.names):
        table = path
        parameters = updated_parameters(tomllib.loads(_parameters_text(Groups()))["parameter"], str(path))
    model = load_matrices(path, parameters, table=table)
    stiffness, mass = model.matrices(parameters.initial)
    node = direction = None
    if "node_number" in content:
        number = np.asarray(content["node_number"])
        if number.shape != (len(content.get("node_position_m", ())),) or number.dtype.kind not in "iu":
            raise InputError(f"{path}, node_number", "is not a whole number for each row of node_position_m",
                             "correct it, or leave it out")
        node, direction = number[content["dof_node"]], np.asarray(content["dof_direction"]).astype(int) + 1
    return ProgramMatrices(stiffness=stiffness, mass=mass, node=node, direction=direction, model_arrays={
        key: value for key, value in content.items() if not key.startswith(MATRIX_KEYS)})


def _is_default(content: dict[str, np.ndarray]) -> bool:
    """Whether K is nothing but a factor 'stiffness' times a matrix, and M constant."""
    scaled = {key.removesuffix(part) for key in content if key.startswith(("K_", "M_")) for part in SPARSE_PARTS
              if key.endswith(part)}
    return scaled == {"K_stiffness"} and not np.any(content.get("K0_data", 1.0))


def write_matrices(
    given: ProgramMatrices, out: str | Path, *, files: Sequence[Path], groups: str | Path | None = None
) -> ImportedMatrices:
    """`import_matrices` of what was read already; files: what it came from."""
    out = Path(out)
    if out.suffix.lower() != ".npz":
        raise InputError(str(out), "is not named .npz", "give a name such as model.npz")
    beside = out.with_name("parameters.toml")
    if out.exists():
        raise InputError(str(out), "already exists", "give another name, or remove it")
    asked = Groups() if groups is None else _groups(Path(groups))
    table = _parameters_text(asked)
    # several models of one folder share what is the same
    former = read_text(beside) if beside.exists() else table
    if former not in (table, _parameters_text(Groups())):
        raise InputError(str(beside), f"already exists, with other parameters than {out.name} would have",
                         f"write {out.name} into another folder, or remove it")
    notes: list[str] = []
    if former != table:
        notes.append(f"{beside} held the factor on all stiffness that is written where no parameters are named: "
                     "replaced; models that were written with it still serve as base and runs")
    kept, base = _clean_matrices(given, str(files[0]), notes)
    terms = _terms(asked, Path(groups) if groups else files[0], base, kept, files, notes)
    arrays = _channels_and_places(asked, base, str(groups or files[0]), notes)
    if "dof_node" in arrays and (said := lying_words(
            base.stiffness, arrays["node_position_m"][arrays["dof_node"]], arrays["dof_direction"])):
        notes.append(f"the model is {said}")
    printed = given.frequency_hz if asked.check is None else np.array(asked.check.frequencies_hz)
    found = _solve_and_check(base, str(files[0]), printed)
    out.parent.mkdir(parents=True, exist_ok=True)
    stiffness, mass = base.stiffness, base.mass
    for name, initial, K, M in terms:
        arrays |= _csr(f"K_{name}", K) | ({} if M is None else _csr(f"M_{name}", M))
        stiffness = stiffness - initial * K
        mass = mass if M is None else mass - initial * M
    arrays |= _csr("K0", stiffness) | _csr("M0", mass)
    write_arrays(out, arrays)
    write_text(beside, table)
    place = arrays.get("node_position_m", np.zeros((1, 3)))
    if said := implausible_size(float(found[0]), float(np.max(np.ptp(place, axis=0)))):
        notes.append(said + ("; set unit_of_length_m in groups.toml" if "nodes' places" in said else ""))
    return ImportedMatrices(
        files=(out, beside), n_row=base.stiffness.shape[0], channels=tuple(str(c) for c in arrays["channel"]),
        parameters=tuple(name for name, *_ in terms), frequency_hz=frozen_array(found), printed_hz=printed,
        notes=(*given.notes, *notes))


def _groups(path: Path) -> Groups:
    try:
        return Groups.model_validate(read_toml(path, absent="name the groups.toml, or leave --parameters out: all "
                                               "stiffness is one parameter then"))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(k) for k in first["loc"])
        raise InputError(f"{path}: {key}", first["msg"].lower(),
                         "see docs/howto/matrices.md for the keys of groups.toml") from None


# mending -------------------------------------------------------------------------------------------------------------


def _clean_matrices(given: ProgramMatrices, where: str, notes: list[str]) -> tuple[np.ndarray, ProgramMatrices]:
    """Numbers of the rows that are free (n,), and the matrices of these: both triangles, without held rows."""
    K, M = (_mirror_triangle(x, f"{where}, {name}", name, notes)
            for x, name in ((given.stiffness, "stiffness"), (given.mass, "mass")))
    if K.shape != M.shape:
        raise InputError(where, f"the stiffness has {K.shape[0]} rows, the mass {M.shape[0]}",
                         "export both of one run")
    empty = (_largest(K) == 0) & (_largest(M) == 0)
    held = _penalty_rows(K) & ~empty
    if given.model_arrays is not None:
        # a model's rows are what its channels and nodes count
        empty = held = np.zeros(K.shape[0], bool)
    for rows, words in ((empty, "held rows, kept as zeros by the program, are left out"),
                        (held, "rows held by a penalty are left out")):
        if rows.any():
            notes.append(f"{plural(int(rows.sum()), 'row')}: {words}")
    kept = np.flatnonzero(~(empty | held))
    if not len(kept):
        raise InputError(where, "no row is free", "check which file is the stiffness")
    K, M = (sparse.csc_array(x[kept][:, kept]) for x in (K, M))
    massless = int(np.sum(_largest(M) == 0))
    if massless:
        notes.append(f"{massless} of {len(kept)} rows have no mass: they follow the others statically")
    node, direction = (None if x is None else x[kept] for x in (given.node, given.direction))
    if given.model_arrays is None and direction is not None and not np.all((direction >= 1) & (direction <= 6)):
        raise InputError(where, f"has a row of direction {int(direction[(direction < 1) | (direction > 6)][0])}",
                         "export displacements and rotations alone (1 to 6)")
    return kept, replace(given, stiffness=K, mass=M, node=node, direction=direction)


def _largest(matrix: sparse.csc_array) -> np.ndarray:
    """(n,) largest entry of each row, absolute."""
    return np.asarray(abs(matrix).max(axis=1).todense()).ravel()


def _mirror_triangle(matrix: sparse.csc_array, where: str, name: str, notes: list[str]) -> sparse.csc_array:
    """Both triangles."""
    matrix = sparse.csc_array(matrix.astype(float)) if not np.iscomplexobj(matrix) else _real_matrix(matrix, where)
    if matrix.shape[0] != matrix.shape[1]:
        raise InputError(where, f"has shape {matrix.shape}", "give a square matrix")
    if not matrix.nnz:
        raise InputError(where, "is empty", "export it again")
    if not np.all(np.isfinite(matrix.data)):
        raise InputError(where, "has an entry that is not a number", "export it again")
    upper, lower = sparse.triu(matrix, 1), sparse.tril(matrix, -1)
    one_sided = [side for side, other in ((upper, lower), (lower, upper)) if side.nnz and not _has_entries(other)]
    if one_sided and _has_entries(one_sided[0]):
        notes.append(f"one triangle of the {name} was written; the other is its mirror image")
        return sparse.csc_array(matrix + one_sided[0].T)
    apart = abs(matrix - matrix.T).max() / abs(matrix).max()
    if apart > ROUNDING:
        raise InputError(where, f"is not symmetric: entries differ by {apart:.1e} of the largest",
                         "export a run without contact, followers or gyroscopic terms")
    return sparse.csc_array(0.5 * (matrix + matrix.T))


def _has_entries(matrix) -> bool:
    return bool(matrix.nnz) and bool(np.any(matrix.data != 0))


def _real_matrix(matrix, where: str) -> sparse.csc_array:
    if abs(matrix.imag).max() > ROUNDING * abs(matrix).max():
        raise InputError(where, "has complex entries", "export it without damping")
    return sparse.csc_array(matrix.real)


def _penalty_rows(K: sparse.csc_array) -> np.ndarray:
    """(n,) whether a row is but a diagonal far above all others."""
    diagonal = np.abs(K.diagonal())
    alone = _largest(K - sparse.diags_array(K.diagonal())) == 0
    others = diagonal[~alone]
    if not alone.any() or not len(others):
        return np.zeros(len(diagonal), bool)
    return alone & (diagonal > PENALTY * np.max(others))


# what the groups ask for ---------------------------------------------------------------------------------------------


def _terms(asked: Groups, where: Path, base: ProgramMatrices, kept: np.ndarray, files: Sequence[Path], notes):
    """(name, initial, K_k, M_k or None) of each parameter; of none that is asked for, all stiffness as one."""
    if not asked.parameter:
        notes.append("no parameters are named: 'stiffness' scales all of K; name groups with runs of their own in a "
                     "groups.toml (--parameters)")
        return [("stiffness", 1.0, base.stiffness, None)]
    found = []
    for row in asked.parameter:
        if not row.runs:
            raise InputError(f"{where}: parameter {row.name}", "has no runs", "give runs = [{file = ..., value = ...}]")
        slopes = [_slope(row, run, where, base, kept, files) for run in row.runs]
        size = abs(slopes[0][0]).max()
        mass_size = abs(slopes[0][1]).max()
        for K, M in slopes[1:]:
            apart = max(abs(K - slopes[0][0]).max() / max(size, 1e-300),
                        abs(M - slopes[0][1]).max() / max(mass_size, 1e-300) if mass_size else 0.0)
            if apart > LINEAR:
                raise InputError(f"{where}: parameter {row.name}", f"its runs' derivatives differ by {apart:.1e}: the "
                                 "matrices are not linear in it", "take a factor on a modulus or a density, or values "
                                 "nearer to the initial one with a model that is linear there")
        if len(slopes) == 1:
            notes.append(f"{row.name}: one run, so that it is linear was not checked; a second value would show it")
        K, M = slopes[0]
        if size == 0 and mass_size == 0:
            raise InputError(f"{where}: parameter {row.name}", f"its run has the matrices of {files[0].name}",
                             "check which group was scaled")
        found.append((row.name, row.initial, K, M if mass_size else None))
    return found


def _slope(row: GroupRow, run: RunRow, where: Path, base: ProgramMatrices, kept, files):
    """dK and dM by a parameter's unit."""
    if run.value == row.initial:
        raise InputError(f"{where}: parameter {row.name}", f"'{run.file}' is of the initial value {run.value:g}, which "
                         f"the file on the command line ({files[0].name}) has", "leave it out of `runs`, which name "
                         "models at other values alone; `initial` is 1 where it is not given")
    paths = [where.parent / run.file]
    if run.mass is not None:
        paths.append(where.parent / run.mass)
    elif len(files) > 1:
        # the stiffness alone was run again
        paths.append(files[1])
    for path in paths:
        if path != (files[1] if len(files) > 1 else None) and not path.resolve().is_relative_to(where.resolve().parent):
            raise InputError(f"{where}: parameter {row.name}", f"'{run.file}' leaves the folder", "put it beside it")
    if missing := [p for p in paths if not p.is_file()]:
        raise InputError(f"{where}: parameter {row.name}", f"its run {missing[0].name} does not exist",
                         f"set what {row.name} scales to {run.value:g} in the program and write its matrices there "
                         "(OpenSeesPy: `from_opensees` of that path, without groups), or correct the path")
    other = _read_files(paths)
    quiet: list[str] = []
    K, M = (_mirror_triangle(x, str(paths[0]), "matrix", quiet) for x in (other.stiffness, other.mass))
    if max(kept) >= K.shape[0] or (other.node is not None and base.node is not None
                                   and not np.array_equal(other.node[kept], base.node)):
        raise InputError(str(paths[0]), f"has other rows than {files[0].name}",
                         "change nothing but the group's property")
    step = run.value - row.initial
    own = [sparse.csc_array(x[kept][:, kept] - y) / step for x, y in ((K, base.stiffness), (M, base.mass))]
    return tuple(_drop_roundoff(x, y) for x, y in zip(own, (base.stiffness, base.mass), strict=True))


def _drop_roundoff(change: sparse.csc_array, base: sparse.csc_array) -> sparse.csc_array:
    """Without what the printed digits of equal entries leave."""
    change = sparse.csc_array(change)
    change.data[np.abs(change.data) < 1e-12 * abs(base).max()] = 0.0
    change.eliminate_zeros()
    return change


def _channels_and_places(asked: Groups, base: ProgramMatrices, where: str, notes: list[str]) -> dict[str, np.ndarray]:
    """The arrays of a model beside its matrices; those of a model.npz stay where groups.toml names no channels."""
    own = base.model_arrays
    arrays = dict(_geometry(base, notes) if own is None else own)
    if "node_position_m" in arrays:
        arrays["node_position_m"] = asked.unit_of_length_m * np.asarray(arrays["node_position_m"], float)
    elif asked.unit_of_length_m != 1:
        raise InputError(f"{where}: unit_of_length_m", "there are no nodes' places", "leave it out")
    if own is not None and not asked.channel:
        return arrays
    names, rows, signs = _channels(asked, base, where, notes)
    places = {k: v for k, v in arrays.items() if not k.startswith("channel")}
    return {"channel": np.array(names), "channel_dof": rows, "channel_sign": signs, **places}


def _channels(asked: Groups, base: ProgramMatrices, where: str, notes: list[str]):
    """Names, rows and signs (n_channel,)."""
    if not asked.channel:
        rows = np.arange(base.stiffness.shape[0])
        if base.direction is not None:
            rows = rows[base.direction <= 3]
        rows = rows[np.unique(np.linspace(0, len(rows) - 1, min(MOST_CHANNELS, len(rows))).round().astype(int))]
        notes.append(f"no channels are named: {len(rows)} rows of the model stand for them; name node and direction of "
                     "your sensors in a groups.toml (--parameters)")
        return [_row_name(base, r) for r in rows], rows, np.ones(len(rows))
    if base.node is None or base.direction is None:
        raise InputError(f"{where}: channel", "the matrices do not say which row is which node",
                         "set channel_dof in the .npz yourself, or export a form that names rows (.sti with .dof)")
    number = {(int(n), int(d)): k for k, (n, d) in enumerate(zip(base.node, base.direction, strict=True))}
    rows, signs = [], []
    for c in asked.channel:
        axis = c.direction.lstrip("-")
        key = (c.node, AXES.index(axis) + 1)
        if key not in number:
            raise _no_row(base, f"{where}: channel {c.name}", c.node, axis)
        rows.append(number[key])
        signs.append(-1.0 if c.direction.startswith("-") else 1.0)
    return [c.name for c in asked.channel], np.array(rows), np.array(signs)


def _no_row(base: ProgramMatrices, where: str, node: int, axis: str) -> InputError:
    """What to say where no row is that node's along that axis: a file of matrices alone knows no node that is held."""
    moving = np.unique(base.node)
    span = f"nodes that move have numbers {moving[0]} to {moving[-1]}"
    there = [AXES[d - 1] for d in sorted(base.direction[base.node == node])]
    if there:
        return InputError(where, f"node {node} has no free row along {axis}", f"free there: {', '.join(there)}; of a "
                          "node that follows another, as in a diaphragm, write channel_row into the .npz")
    if node in (base.place or {}):
        return InputError(where, f"node {node} has no free row: it is held, or follows another node",
                          f"name a node that moves (of one on a rigid link the one it follows), or write channel_row "
                          f"into the .npz: what the channel reads of the free rows (docs/formats/model.md); {span}")
    if base.place:
        return InputError(where, f"the model has no node {node}", f"correct node; {span}")
    return InputError(where, f"no row is of node {node}: the model does not have it, or it is held there",
                      f"correct node; {span}")


def _row_name(base: ProgramMatrices, row: int) -> str:
    if base.node is None or base.direction is None:
        return f"row-{row}"
    return f"{base.node[row]}-{AXES[base.direction[row] - 1]}"


def _geometry(base: ProgramMatrices, notes: list[str]) -> dict[str, np.ndarray]:
    """Places of the rows' nodes; a node that the deck does not have stands where what it is joined to lies."""
    if base.node is None or base.direction is None or not base.place:
        return {}
    nodes, index = np.unique(base.node, return_inverse=True)
    place = np.array([base.place.get(int(n), np.full(3, np.nan)) for n in nodes])
    internal = np.isnan(place[:, 0])
    if internal.any():
        notes.append(f"{plural(int(internal.sum()), 'node')} of the matrices, not in the deck (expanded beams, "
                     "incompatible modes): drawn amid the nodes that they are joined to")
    joined = sparse.csr_array(base.stiffness != 0)
    for k in np.flatnonzero(internal):
        own = np.unique(joined[np.flatnonzero(index == k)].nonzero()[1])
        near = place[np.unique(index[own])]
        near = near[~np.isnan(near[:, 0])]
        place[k] = near.mean(axis=0) if len(near) else np.nanmean(place, axis=0)
    found = {"node_position_m": place, "node_number": nodes, "dof_node": index, "dof_direction": base.direction - 1}
    # of nodes that have rows: what the others do, held or tied to some, is not known here
    number = {int(n): k for k, n in enumerate(nodes)}
    line = [(number[a], number[b]) for a, b in base.line if a in number and b in number]
    line = [(a, b) for a, b in line if not np.array_equal(place[a], place[b])]
    return found | ({"line": np.array(line)} if line else {})


def _solve_and_check(base: ProgramMatrices, where: str, printed: np.ndarray | None) -> np.ndarray:
    """(n,) Hz of the corrected matrices, held against what the program printed."""
    n = min(max(COUNT, 0 if printed is None else len(printed)), base.stiffness.shape[0] - 2,
            int(np.sum(_largest(base.mass) > 0)))
    if n < 1:
        raise InputError(where, f"has {base.stiffness.shape[0]} free rows, {np.sum(_largest(base.mass) > 0)} with mass",
                         "give a model of three rows and more, with masses")
    value, _ = lowest_modes(base.stiffness, base.mass, n, where)
    found = np.sqrt(value) / (2 * np.pi)
    if printed is not None:
        m = min(len(found), len(printed))
        worst = int(np.argmax(np.abs(found[:m] / printed[:m] - 1)))
        if abs(found[worst] / printed[worst] - 1) > REFUSED_DIFFERENCE:
            raise InputError(where, f"mode {worst + 1} is {found[worst]:.5g} Hz by these matrices, "
                             f"{printed[worst]:.5g} Hz as the program printed it", "check that both are of one "
                             "run, with one set of boundary conditions and units")
    return found


def _csr(name: str, matrix) -> dict[str, np.ndarray]:
    rows = sparse.csr_array(matrix)
    return {f"{name}{part}": values
            for part, values in zip(SPARSE_PARTS, (rows.data, rows.indices, rows.indptr), strict=True)}


def _parameters_text(asked: Groups) -> str:
    if not asked.parameter:
        return ('# a factor on all stiffness; see groups.toml for groups of your own\n[[parameter]]\n'
                'name = "stiffness"\nunit = "-"\n'
                'initial = 1.0\ncov = 0.1\nlower = 0.5\nupper = 1.5\nprior = "normal"\n')
    text = []
    tables = []
    for row in asked.parameter:
        table = {k: v for k, v in row.model_dump(exclude={"runs"}).items() if v not in (None, "")}
        tables.append(table)
        lines = [f"{k} = {_quote(v)}" for k, v in table.items()]
        text.append("[[parameter]]\n" + "\n".join(lines) + "\n")
    updated_parameters(tables, "groups.toml")
    return "\n".join(text)


def _quote(value: object) -> str:
    return json.dumps(value) if isinstance(value, str) else repr(value)
