"""Stiffness and mass as finite-element programs write them, with what each file says of its rows.

What is read is what stands there: one triangle only, held rows, rows of nodes that the deck does not have. Mending is
`structure.matrix_import`'s. CalculiX writes .sti, .mas and .dof beside its deck; Abaqus and others coordinates in
.mtx; Nastran DMIG cards in .pch. MatrixMarket, Harwell and Boeing, MATLAB are read through scipy; ANSYS' .full and
Nastran's .op4 through the packages that know them (extras `ansys`, `nastran`).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import nullcontext, redirect_stderr
from dataclasses import dataclass
from importlib import import_module
from io import StringIO
from pathlib import Path

import numpy as np
from scipy import sparse

from probupdate.errors import InputError, parsing
from probupdate.io.files import read_text
from probupdate.io.fortran_text import refuse_cut_number

# names of a file or variable that mean stiffness or mass
STIFFNESS, MASS = ("stif", "stiff", "kaa", "kgg", "k0", "k"), ("mass", "maa", "mgg", "m0", "m")
ENDINGS = (".sti", ".mtx", ".mat", ".full", ".op4", ".pch", ".rb", ".rsa", ".rua", ".hb", ".npz")
# no model of this many rows is updated here, and a damaged file may ask for any number
MOST_ROWS = 2_000_000


@dataclass(frozen=True, eq=False, kw_only=True)
class ProgramMatrices:
    """K, M (n, n) as read; node and direction (n,) of each row, direction 1 to 6, None where the file does not say;
    place, node -> (3,), and line, pairs of nodes that elements join, as far as known; frequency_hz: what the program
    printed of the same model, if it did; notes; model_arrays: of a model.npz, its channels and places as its archive
    has them.
    """

    stiffness: sparse.csc_array
    mass: sparse.csc_array
    node: np.ndarray | None = None
    direction: np.ndarray | None = None
    place: dict[int, np.ndarray] | None = None
    frequency_hz: np.ndarray | None = None
    notes: tuple[str, ...] = ()
    line: tuple[tuple[int, int], ...] = ()
    model_arrays: dict[str, np.ndarray] | None = None


def read_program_matrices(files: Sequence[Path]) -> ProgramMatrices:
    """Of one file that holds or names both matrices, or of two, stiffness first. Raises InputError where a file is not
    of a form that is known, or its other half is missing."""
    first = files[0]
    ending = first.suffix.lower()
    if ending not in ENDINGS:
        raise InputError(str(first), "is not a matrix file that is known",
                         f"give one of {', '.join(ENDINGS)} (CalculiX: the .sti of SOLVER=MATRIXSTORAGE)")
    for path in files:
        if not path.is_file():
            raise InputError(str(path), "does not exist", "correct the path")
    with parsing(str(first), "cannot be read as matrices", "write it again, or export MatrixMarket (.mtx) instead"):
        if ending == ".sti":
            return _calculix(first)
        if ending == ".full":
            return _ansys(first)
        if len(files) == 1:
            both = _pair_of_matrices(first)
            if both is not None:
                return both
        second = files[1] if len(files) > 1 else _partner(first)
        with parsing(str(second), "cannot be read as a matrix", "write it again"):
            return _pair(first, second)


def _text(path: Path) -> str:
    text = read_text(path)
    refuse_cut_number(path, text)
    return text


def _triplets(path: Path, offset: int = 1) -> sparse.csc_array:
    """Rows of 'row column value', from 1."""
    rows = np.loadtxt(_text(path).splitlines(), ndmin=2)
    if rows.shape[1] != 3:
        raise InputError(str(path), f"has {rows.shape[1]} numbers a line, not row, column and value", "write it again")
    return _assemble_entries(path, rows[:, 0] - offset, rows[:, 1] - offset, rows[:, 2])


def _assemble_entries(path: Path, row, column, value) -> sparse.csc_array:
    row, column = np.asarray(row), np.asarray(column)
    if not np.all(np.isfinite(value)):
        raise InputError(str(path), "has an entry that is not a number", "write it again")
    size = int(max(row.max(), column.max())) + 1
    if row.min() < 0 or column.min() < 0 or size > MOST_ROWS:
        raise InputError(str(path), f"has rows from {int(min(row.min(), column.min())) + 1} to {size}",
                         f"count them from 1, up to {MOST_ROWS}")
    return sparse.csc_array(sparse.coo_array((value, (row.astype(int), column.astype(int))), shape=(size, size)))


# CalculiX ------------------------------------------------------------------------------------------------------------


def _calculix(path: Path) -> ProgramMatrices:
    mass, rows = path.with_suffix(".mas"), path.with_suffix(".dof")
    for other in (mass, rows):
        if not other.is_file():
            raise InputError(str(other), "is missing beside the .sti", "run *FREQUENCY, SOLVER=MATRIXSTORAGE again")
    K, M = _triplets(path), _triplets(mass)
    words = [w.split(".") for w in _text(rows).split()]
    node, direction = (np.array([int(w[k]) for w in words]) for k in (0, 1))
    n = max(K.shape[0], M.shape[0], len(node))
    if len(node) != n:
        raise InputError(str(rows), f"names {len(node)} rows, the matrices have {n}",
                         "keep the files of one run together")
    deck = path.with_suffix(".inp")
    place, said = _deck_nodes(deck) if deck.is_file() else (
        None, (f"{deck.name} does not lie beside it: nodes have no places",))
    printed = path.with_suffix(".dat")
    return ProgramMatrices(
        stiffness=_grow_matrix(K, n), mass=_grow_matrix(M, n), node=node, direction=direction, place=place,
        frequency_hz=_calculix_frequencies(printed) if printed.is_file() else None,
        notes=said)


# cards of a deck that change what nodes' places or rows mean, and are not read
OTHER_AXES = {"*TRANSFORM": "rows of its nodes may be along the axes that it states, not along x, y, z",
              "*SYSTEM": "places of the nodes behind it are in axes of its own",
              "*INCLUDE": "nodes of the file that it names have no places: put their *NODE card into the deck"}


def _deck_nodes(path: Path) -> tuple[dict[int, np.ndarray], tuple[str, ...]]:
    """Places of the nodes of *NODE cards of a CalculiX or Abaqus deck, also in cylindrical coordinates, and sentences
    on cards that are not read."""
    found: dict[int, np.ndarray] = {}
    reading, round_about, said = False, False, {}
    for at, line in enumerate(_text(path).splitlines(), 1):
        text = line.strip()
        if text.startswith("**") or not text:
            continue
        if text.startswith("*"):
            words = text.upper().replace(" ", "").split(",")
            reading, system = words[0] == "*NODE", next((w[7:] for w in words if w.startswith("SYSTEM=")), "R")
            round_about = reading and system == "C"
            if words[0] in OTHER_AXES:
                said.setdefault(words[0], f"{path.name}, line {at}: {words[0]} is not read: {OTHER_AXES[words[0]]}")
            if reading and system not in ("R", "C"):
                raise InputError(f"{path}, line {at}", f"gives nodes in SYSTEM={system}", "give them in x, y, z")
            continue
        if reading:
            numbers = [w for w in text.split(",") if w.strip()]
            place = np.zeros(3)
            place[: len(numbers) - 1] = [float(w) for w in numbers[1:4]]
            if round_about:
                radius, angle = place[0], np.radians(place[1])
                place[:2] = radius * np.cos(angle), radius * np.sin(angle)
            found[int(numbers[0])] = place
    return found, tuple(said.values())


def _calculix_frequencies(path: Path) -> np.ndarray | None:
    """Cycles per time of the table of eigenvalues, None where there is none."""
    text = _text(path)
    at = text.find("E I G E N V A L U E   O U T P U T")
    if at < 0:
        return None
    found = []
    for line in text[at:].splitlines()[1:]:
        words = line.split()
        if len(words) == 5 and words[0].isdigit():
            found.append(float(words[3]))
        elif found:
            break
    return np.array(found) if found else None


# coordinates, MatrixMarket, Harwell and Boeing, MATLAB ---------------------------------------------------------------


def _pair(stiffness: Path, mass: Path) -> ProgramMatrices:
    if _is_abaqus(stiffness) and _is_abaqus(mass):
        return _abaqus(stiffness, mass)
    K, M = _single_matrix(stiffness), _single_matrix(mass)
    n = max(K.shape[0], M.shape[0])
    return ProgramMatrices(stiffness=_grow_matrix(K, n), mass=_grow_matrix(M, n))


def _single_matrix(path: Path) -> sparse.csc_array:
    ending = path.suffix.lower()
    if ending == ".mtx":
        if _text(path)[:14].lower() == "%%matrixmarket":
            from scipy.io import mmread

            return sparse.csc_array(mmread(path, spmatrix=False))
        return _triplets(path)
    if ending in (".rb", ".rsa", ".rua", ".hb"):
        from scipy.io import hb_read

        return sparse.csc_array(hb_read(path, spmatrix=False))
    if ending == ".op4":
        (one,) = _op4(path).values()
        return one
    held = _variables(path)
    if len(held) != 1:
        raise InputError(str(path), f"holds {', '.join(sorted(held)) or 'no matrix'}", "give a file of one matrix")
    return next(iter(held.values()))


def _variables(path: Path) -> dict[str, sparse.csc_array]:
    """Square matrices of a .mat or .npz by name."""
    if path.suffix.lower() == ".mat":
        from scipy.io import loadmat

        raw = loadmat(path, spmatrix=False)
    else:
        from probupdate.io.files import archive_arrays

        raw = archive_arrays(path, "not a plain .npz archive", "write it with numpy.savez, without objects")
    found = {}
    for name, value in raw.items():
        if not name.startswith("__") and getattr(value, "ndim", 0) == 2 and value.shape[0] == value.shape[1] > 1:
            found[name] = sparse.csc_array(value)
    return found


def _pair_of_matrices(path: Path) -> ProgramMatrices | None:
    """Of a file that holds K and M under names that say so; None where it is one of two files."""
    ending = path.suffix.lower()
    if ending not in (".mat", ".npz", ".op4", ".pch"):
        return None
    node = direction = None
    if ending == ".op4":
        held = _op4(path)
    elif ending == ".pch":
        held, node, direction = _dmig(path)
    else:
        held = _variables(path)
    K, M = (_find_matrix(held, names) for names in (STIFFNESS, MASS))
    if K is None or M is None:
        if len(held) == 1:
            return None
        raise InputError(str(path), f"holds {', '.join(sorted(held)) or 'no square matrix'}: which are stiffness and "
                         "mass?", "name them K and M, or give two files, stiffness first")
    if K.shape != M.shape:
        raise InputError(str(path), f"K has {K.shape[0]} rows, M {M.shape[0]}", "export both of one model")
    return ProgramMatrices(stiffness=K, mass=M, node=node, direction=direction)


def _find_matrix(held: dict[str, sparse.csc_array], names: Sequence[str]) -> sparse.csc_array | None:
    for wanted in names:
        match = [k for k in held if k.lower() == wanted or (len(wanted) > 2 and k.lower().startswith(wanted))]
        if match:
            return held[match[0]]
    return None


def _partner(path: Path) -> Path:
    """The mass beside a stiffness file, by its name: STIF1 and MASS1, K and M."""
    name = path.name
    swaps = ((r"(?i)stiffness", "mass"), (r"(?i)stif", "mass"), (r"(?i)\bk(?=[._\d]|gg|aa)", "m"),
             (r"(?i)_k(?=[._\d])", "_m"))
    tried = []
    for pattern, word in swaps:
        for way in (word, word.upper(), word.capitalize()):
            other = re.sub(pattern, way, name, count=1)
            if other != name:
                tried.append(other)
                if (path.parent / other).is_file():
                    return path.parent / other
    raise InputError(str(path), "is one matrix, and no mass matrix was found beside it"
                     + (f" ({', '.join(dict.fromkeys(tried))})" if tried else ""),
                     "give both files, stiffness first")


def _is_abaqus(path: Path) -> bool:
    """Node, direction, node, direction, value: what *MATRIX GENERATE writes as MATRIX INPUT."""
    if path.suffix.lower() != ".mtx":
        return False
    lines = [x for x in _text(path)[:4000].splitlines() if x.strip() and not x.startswith(("*", "%"))]
    return bool(lines) and "," in lines[0] and len(lines[0].split(",")) == 5


def _abaqus(stiffness: Path, mass: Path) -> ProgramMatrices:
    """Rows named by node and direction; both triangles of each symmetric entry, or one."""
    entries = []
    for path in (stiffness, mass):
        lines = [x for x in _text(path).splitlines() if x.strip() and not x.startswith("*")]
        entries.append(np.loadtxt(lines, delimiter=",", ndmin=2))
    ends = np.vstack([own[:, pair] for own in entries for pair in ((0, 1), (2, 3))]).astype(int)
    # rows of negative nodes are multipliers or internal ones: what they hold is not free
    keys = np.unique(ends, axis=0)
    number = {tuple(k): i for i, k in enumerate(keys.tolist())}
    made = []
    for own in entries:
        row, column = ([number[int(a), int(b)] for a, b in own[:, pair]] for pair in ((0, 1), (2, 3)))
        made.append(sparse.csc_array(sparse.coo_array((own[:, 4], (row, column)), shape=(len(keys), len(keys)))))
    deck = next((p for p in stiffness.parent.glob("*.inp") if stiffness.stem.startswith(p.stem)), None)
    place, said = (None, ()) if deck is None else _deck_nodes(deck)
    return ProgramMatrices(stiffness=made[0], mass=made[1], node=keys[:, 0], direction=keys[:, 1], place=place,
                           notes=said)


# through packages ----------------------------------------------------------------------------------------------------


def _package(name: str, extra: str):
    try:
        return import_module(name)
    except ImportError:
        raise InputError(name, "is not installed", f"pip install probupdate[{extra}], or export MatrixMarket") from None


def _ansys(path: Path) -> ProgramMatrices:
    reader = _package("ansys.mapdl.reader", "ansys")
    rows, K, M = reader.read_binary(str(path)).load_km(as_sparse=True, sort=True)
    return ProgramMatrices(stiffness=sparse.csc_array(K), mass=sparse.csc_array(M), node=np.array(rows[:, 0], int),
                           direction=np.array(rows[:, 1], int) + 1)


def opensees_matrices(ops=None) -> ProgramMatrices:
    """Of the model that OpenSeesPy holds: K and M as its own assembly has them, rows named by node and direction.

    ops: `openseespy.opensees`, imported where it is not given. Constraints are transformed; the analysis of the model
    is replaced. Raises InputError where there is no model."""
    ops = ops or _package("openseespy.opensees", "opensees")

    def assemble(mass: float, stiffness: float) -> np.ndarray:
        ops.wipeAnalysis()
        ops.constraints("Transformation")
        ops.numberer("Plain")
        ops.system("FullGeneral")
        ops.algorithm("Linear")
        ops.integrator("GimmeMCK", mass, 0.0, stiffness)
        ops.analysis("Transient", "-noWarnings")
        # OpenSees complains of a singular matrix, as M is where nodes have no mass; it is assembled all the same
        with redirect_stderr(StringIO()) if mass else nullcontext():
            ops.analyze(1, 0.0)
        n = ops.systemSize()
        return np.array(ops.printA("-ret")).reshape(n, n)

    tags = ops.getNodeTags()
    if not tags:
        raise InputError("OpenSees", "holds no model", "build it first")
    K, M = assemble(0.0, 1.0), assemble(1.0, 0.0)
    node, direction = np.zeros(len(K), int), np.zeros(len(K), int)
    # of a node that follows others, as a diaphragm's do, OpenSees lists its free directions first, then the equations
    # of those it follows, which have their names from them
    follows = {tag: ops.getConstrainedDOFs(tag) for tag in np.atleast_1d(ops.getConstrainedNodes()).tolist()}
    for tag in tags:
        equations = ops.nodeDOFs(tag)
        own = [k for k in range(1, len(equations) + 1) if k not in np.atleast_1d(follows.get(tag, ()))]
        for k, equation in zip(own, equations, strict=False):
            if 0 <= equation < len(K):
                node[equation], direction[equation] = tag, k
    ops.wipeAnalysis()
    planar = len(ops.nodeCoord(tags[0])) == 2
    if planar:
        # of a plane model the third is the rotation about z
        direction = np.where(direction == 3, 6, direction)
    place = {tag: np.pad(np.array(ops.nodeCoord(tag), float), (0, 3))[:3] for tag in tags}
    ends = [tuple(np.atleast_1d(ops.eleNodes(element)).tolist()) for element in ops.getEleTags() or ()]
    return ProgramMatrices(stiffness=sparse.csc_array(K), mass=sparse.csc_array(M), node=node, direction=direction,
                           place=place, line=tuple(pair for pair in ends if len(pair) == 2))


def _op4(path: Path) -> dict[str, sparse.csc_array]:
    op4 = _package("pyNastran.op4.op4", "nastran")
    held = op4.read_op4(str(path))
    found = {}
    for name, value in held.items():
        matrix = value.data if hasattr(value, "data") and hasattr(value, "form") else value[1]
        if isinstance(matrix, list):
            raise InputError(str(path), f"holds several matrices named '{name}'",
                             "give names that differ within eight letters")
        found[name] = sparse.csc_array(matrix)
    return found


def _dmig(path: Path):
    """Matrices of a punch file's DMIG cards by name, and node and direction of the rows (0 of scalar points: 1). Read
    here: the package that reads bulk data does not load beside numpy 2.4."""
    entries: dict[str, list[tuple[tuple[int, int], tuple[int, int], float]]] = {}
    name, column = "", (0, 0)
    for line in _text(path).splitlines():
        fields = _bulk_fields(line)
        if fields is None:
            continue
        first, rest = fields
        if first.startswith("DMIG"):
            if rest[1].strip() == "0":
                # the card of the whole matrix
                entries.setdefault(rest[0].strip(), [])
                continue
            name, column = rest[0].strip(), (int(rest[1]), int(rest[2] or 0))
            rest = rest[4:] if not first.endswith("*") else []
        elif not (first == "" or first.startswith(("*", "+"))) or not name:
            name = ""
            continue
        for k in range(0, len(rest) - 2, 4):
            if rest[k].strip():
                at = (int(rest[k]), int(rest[k + 1] or 0))
                entries.setdefault(name, []).append((at, column, float(re.sub(r"[dD]", "E", rest[k + 2]))))
    keys = sorted({key for own in entries.values() for entry in own for key in entry[:2]})
    number, n = {key: k for k, key in enumerate(keys)}, len(keys)
    found = {}
    for label, own in entries.items():
        row, place, value = ([number[e[0]] for e in own], [number[e[1]] for e in own], [e[2] for e in own])
        found[label] = sparse.csc_array(sparse.coo_array((value, (row, place)), shape=(n, n)))
    rows = np.array(keys, int).reshape(-1, 2)
    return found, rows[:, 0], np.maximum(rows[:, 1], 1)


def _bulk_fields(line: str) -> tuple[str, list[str]] | None:
    """Name and fields of a line of bulk data, of 8 or 16 letters each, or parted by commas; None of a comment."""
    text = line.split("$")[0].rstrip()
    if not text:
        return None
    if "," in text:
        first, *rest = (w.strip() for w in text.split(","))
        return first.upper(), rest
    first, width = text[:8].strip().upper(), 16 if "*" in text[:8] else 8
    return first, [text[k : k + width].strip() for k in range(8, 72, width)]


def _grow_matrix(matrix: sparse.csc_array, n: int) -> sparse.csc_array:
    """(n, n): trailing rows without entries are not written by all programs."""
    if matrix.shape == (n, n):
        return matrix
    grown = sparse.csc_array(matrix)
    grown.resize((n, n))
    return grown
