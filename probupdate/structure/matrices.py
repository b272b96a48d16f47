"""A model given as matrices: `model.npz` with K0, M0 and K_<name>, M_<name>, K(theta) = K0 + sum theta_k K_k."""

from __future__ import annotations

import difflib
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import sparse

from probupdate.errors import InputError, of_file, parsing
from probupdate.io.files import archive_arrays
from probupdate.io.result_table import plural
from probupdate.modal.mode_energy import DofPlaces
from probupdate.modal.modes import Sensor
from probupdate.model.interface import Wireframe
from probupdate.model.parameters import Parameters
from probupdate.runtime.arrays import frozen_array
from probupdate.structure.affine import AffineModel
from probupdate.structure.readings import STANDARD_MPS2, FeltGravity

SPARSE_PARTS = ("_data", "_indices", "_indptr")
# what a file holds beside K_<name> and M_<name>
ARRAYS = ("channel", "channel_dof", "channel_sign", "channel_tilt_dof", "channel_tilt_sign", "gravity",
          "node_position_m", "node_number", "dof_node", "dof_direction", "line",
          *(f"{name}{part}" for name in ("K0", "M0", "channel_row", "channel_tilt_row")
            for part in ("", *SPARSE_PARTS)))
# of the largest entry of a matrix: a spring is 1e13 N/m, and units of length and force are 1e9 apart
SMALLEST, LARGEST = 1e-30, 1e30
# entries of K - K^T beyond this share of the largest entry are a mistake, not rounding
ASYMMETRY_LIMIT = 1e-8
# of a model's rows, half of them above: slower than what floats at anchor; and times the extent, in m/s, a quarter of
# what the lowest modes of structures have at least
SLOWEST_HZ, SLOWEST_SPEED = 0.005, 0.5
# gravity over that of the matrices' unit of length, beyond which it is of another unit: inch and m are 39 apart; rows
# that must show this unit, half of them alike
OTHER_UNIT, LEAST_ROWS, ALIKE = 20.0, 6, 0.01


@dataclass(frozen=True)
class LinearCoefficients:
    """(1, theta_k for those in `order`): the affine form of matrices given per parameter."""

    stiffness_order: tuple[int, ...]
    mass_order: tuple[int, ...]

    def __call__(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        one = np.ones((*theta.shape[:-1], 1), theta.dtype)
        stiffness, mass = (np.concatenate([one, theta[..., list(order)]], axis=-1)
                           for order in (self.stiffness_order, self.mass_order))
        return stiffness, mass


def load_matrices(
    path: str | Path, parameters: Parameters, *, name: str | None = None, table: str | Path = "the parameters"
) -> AffineModel:
    """Read `model.npz` (interfaces.md, form 3); every mistake names the file and the key, and `table`, where the
    parameters stand, if it may be theirs."""
    path = Path(path)
    with of_file(path), parsing(str(path), "its arrays do not fit together", "see docs/formats/model.md"):
        return _matrices(path, parameters, name, str(table))


def _matrices(path: Path, parameters: Parameters, name: str | None, table: str) -> AffineModel:
    content = read_archive(path)
    stiffness, mass, stiffness_order, mass_order = [], [], [], []
    # those of parameters that are held at their value are part of K0 and M0
    used: set[str] = set()
    own: dict[str, dict[str, sparse.csc_array]] = {}
    for kind, matrices, order in (("K", stiffness, stiffness_order), ("M", mass, mass_order)):
        matrices.append(matrix_of(path, content, f"{kind}0", None if kind == "K" else stiffness[0].shape[0]))
        for held, value in parameters.held:
            key = f"{kind}_{held}"
            if key in content or f"{key}_data" in content:
                matrices[0] = matrices[0] + value * matrix_of(path, content, key, matrices[0].shape[0])
                used.add(held)
        for k, parameter in enumerate(parameters.names):
            key = f"{kind}_{parameter}"
            if key in content or f"{key}_data" in content:
                matrices.append(matrix_of(path, content, key, stiffness[0].shape[0]))
                order.append(k)
                own.setdefault(parameter, {})[key] = matrices[-1]
    diagonals = (_diagonal(stiffness, parameters.initial[stiffness_order]),
                 _diagonal(mass, parameters.initial[mass_order]))
    _refuse_negative_mass(path, diagonals[1])
    _refuse_exchanged(path, *diagonals, _extent(content))
    for parameter in (*parameters.names, *(name for name, _ in parameters.held)):
        if parameter not in own and parameter not in used:
            raise InputError(
                f"{path}, K_{parameter}", f"there is neither this matrix nor its M_ for '{parameter}' of {table}",
                "correct the parameter's name",
            )
    _refuse_unused(path, content, set(own) | used, table)
    _refuse_idle(path, own, table)
    n = stiffness[0].shape[0]
    channels, channel_matrix = _channels(path, content, n)
    wire, wire_matrix, wire_turn = _wireframe(path, content, n)
    places = None if wire is None else DofPlaces(
        node=frozen_array(content["dof_node"], int), position_m=frozen_array(wire.node_m[content["dof_node"]]),
        direction=frozen_array(content["dof_direction"], int))
    tilt_matrix, known = _tilts(path, content, channel_matrix)
    model = AffineModel(
        name=name or path.stem,
        parameters=parameters,
        channels=channels,
        stiffness=tuple(stiffness),
        mass=tuple(mass),
        coefficients=LinearCoefficients(tuple(stiffness_order), tuple(mass_order)),
        channel_matrix=channel_matrix,
        tilt_matrix=tilt_matrix if known.any() else None,
        gravity=_gravity(path, content, known) if known.any() else None,
        wire=wire,
        wire_matrix=wire_matrix,
        places=places,
        wire_turn=wire_turn,
        hash_key=hashlib.sha256(path.read_bytes()).hexdigest(),
    )
    return _with_gravity_of_lengths(path, model, stated="gravity" in content)


def _with_gravity_of_lengths(path: Path, model: AffineModel, *, stated: bool) -> AffineModel:
    """Gravity in the matrices' unit of length, as these and places in m show it; what is stated must agree."""
    if model.gravity is None or model.places is None:
        return model
    length = _unit_of_length(model.matrices(model.parameters.initial)[0], model.places)
    if length is None or 1 / OTHER_UNIT < model.gravity.mps2 / (STANDARD_MPS2 * length) < OTHER_UNIT:
        return model
    if not stated:
        return replace(model, gravity=replace(model.gravity, mps2=STANDARD_MPS2 * float(f"{length:.4g}")))
    raise InputError(f"{path}, gravity", f"is {model.gravity.mps2:g}, but K's rotations and translations belong to "
                     f"lengths {length:.4g} times those of node_position_m",
                     f"set gravity = {STANDARD_MPS2 * length:.6g} if node_position_m is in m, as it is to be; if it is "
                     "in mm, divide it by 1000")


def _unit_of_length(stiffness: sparse.csc_array, places: DofPlaces) -> float | None:
    """How many of the matrices' units of length are one of the places': 1000 for N/mm with places in m.

    Turning the whole about an axis strains no element: K (f t + r) = 0 but beside supports, t the translations by the
    places and r the rotations by 1. None where too few rows show f, or half of them not alike.
    """
    arm, size = places.position_m - places.position_m.mean(axis=0), abs(stiffness)
    found = []
    for about in range(3):
        moved = np.cross(np.eye(3)[about], arm)
        along = np.clip(places.direction, 0, 2)
        t = np.where((places.direction >= 0) & (places.direction < 3), moved[np.arange(len(arm)), along], 0.0)
        r = (places.direction == 3 + about).astype(float)
        by_t, by_r = stiffness @ t, stiffness @ r
        clear = (np.abs(by_t) > 1e-6 * (size @ np.abs(t))) & (np.abs(by_r) > 1e-6 * (size @ r))
        found.append(-by_r[clear] / by_t[clear])
    ratio = np.concatenate(found)
    if len(ratio) < LEAST_ROWS:
        return None
    low, middle, high = np.percentile(ratio, [25, 50, 75])
    return float(middle) if middle > 0 and high - low < ALIKE * middle else None


def _extent(content: Mapping[str, np.ndarray]) -> float:
    """Of nodes with places, 0 without; mistakes in them are found later."""
    try:
        place = np.asarray(content.get("node_position_m", np.empty((0, 3))), float)
        extent = float(np.max(np.ptp(place, axis=0))) if place.ndim == 2 and len(place) else 0.0
    except (TypeError, ValueError):
        return 0.0
    return extent if np.isfinite(extent) else 0.0


def _diagonal(matrices: Sequence[sparse.csc_array], theta: np.ndarray) -> np.ndarray:
    """(n,) of the first matrix and theta times the others."""
    return np.sum([f * m.diagonal() for f, m in zip((1.0, *theta), matrices, strict=True)], axis=0)


def _refuse_negative_mass(path: Path, mass: np.ndarray) -> None:
    """At the initial parameters: no motion has a negative kinetic energy, that of a single row neither."""
    row = int(np.argmin(mass))
    if mass[row] < 0:
        raise InputError(f"{path}, M0", f"row {row} has a negative mass ({mass[row]:.3g}) at the initial "
                         "parameters", "check its sign, and that of every M_<name>")


def _refuse_exchanged(path: Path, stiffness: np.ndarray, mass: np.ndarray, extent_m: float) -> None:
    """K_ii / M_ii is w^2 of a row held alone, in any units, no less than the lowest eigenvalue and most often far above
    it. `extent_m`: the structure's, 0 where it is not known."""
    heavy = (mass > 0) & (stiffness > 0)
    if not heavy.any():
        return
    row_hz = float(np.sqrt(np.median(stiffness[heavy] / mass[heavy])) / (2 * np.pi))
    least = SLOWEST_SPEED / extent_m if extent_m > 0 else SLOWEST_HZ
    if row_hz < least:
        of = f"a structure of {extent_m:.3g} m" if extent_m > 0 else "any structure whose nodes have no places"
        raise InputError(f"{path}, K0", f"with M0 the rows' median frequency is {row_hz:.2g} Hz, below that of {of}: "
                         "are K0 and M0 exchanged, or in units that do not belong together?",
                         "exchange them, or give N/m with kg, kN/m with t")


def _refuse_idle(path: Path, own: Mapping[str, Mapping[str, sparse.csc_array]], table: str) -> None:
    """Parameters that no measurement informs: without effect, or with the very effect of another one. `own`: name ->
    its matrices by their keys."""
    known: dict[tuple, str] = {}
    for name, matrices in own.items():
        acts = []
        for key, matrix in matrices.items():
            entries = sparse.coo_array(matrix)
            there = entries.data != 0
            if there.any():
                parts = (*entries.coords, entries.data)
                acts.append((key[0], *(part[there].astype(float).tobytes() for part in parts)))
        if not acts:
            raise InputError(f"{path}, {next(iter(matrices))}", f"is zero: the parameter '{name}' has no effect",
                             f"export it again, or leave '{name}' out of {table}")
        other = known.setdefault(tuple(acts), name)
        if other != name:
            raise InputError(f"{path}, {next(iter(matrices))}", f"is the matrix of '{other}' too: no measurement "
                             f"distinguishes '{other}' from '{name}'", "export its own, or make one parameter of both")


def read_archive(path: Path) -> dict[str, np.ndarray]:
    """The arrays of an .npz file by name; no objects."""
    return archive_arrays(path, "not a plain .npz archive", "write it with numpy.savez, without objects")


def matrix_of(path: Path, content: Mapping, key: str, n: int | None = None) -> sparse.csc_array:
    """The symmetric matrix (n, n) that an archive holds under a key, dense or in CSR parts."""
    where = f"{path}, {key}"
    if key in content:
        raw = content[key]
        if raw.ndim != 2:
            raise InputError(where, f"has shape {raw.shape}", "give a square matrix")
        if not raw.size:
            raise InputError(where, "is empty", "give a square matrix: check how it was exported")
        matrix = sparse.csc_array(_real_matrix(where, raw))
    elif all(key + part in content for part in SPARSE_PARTS):
        data, indices, indptr = (content[key + part] for part in SPARSE_PARTS)
        size = n or np.size(indptr) - 1
        if np.size(indptr) - 1 != size:
            raise InputError(where, f"has {np.size(indptr) - 1} rows, K0 has {size}", "use one size for all")
        _refuse_structure(where, data, indices, indptr, size)
        try:
            matrix = sparse.csc_array(sparse.csr_array(
                (_real_matrix(where, data), indices.astype(np.int64), indptr.astype(np.int64)), shape=(size, size)))
        except ValueError as error:
            raise InputError(where, f"its CSR parts do not fit together ({error})", "write them again") from None
    else:
        raise InputError(where, "is missing", "give it dense, or as _data, _indices, _indptr (CSR)")
    if matrix.shape[0] != matrix.shape[1] or (n is not None and matrix.shape[0] != n):
        raise InputError(where, f"has shape {matrix.shape}", f"give ({n or 'n'}, {n or 'n'}) as K0 has")
    largest = float(np.max(np.abs(matrix.data), initial=0.0))
    if np.isfinite(largest) and largest and not SMALLEST < largest < LARGEST:
        raise InputError(where, f"its largest entry is {largest:.3g}, which no stiffness or mass is in any unit",
                         "check its units, and how it was exported")
    if not np.all(np.isfinite(matrix.data)):
        raise InputError(where, "holds NaN or infinite entries", "check how it was exported")
    skew = abs(matrix - matrix.T)
    if skew.nnz and skew.max() > ASYMMETRY_LIMIT * abs(matrix).max():
        raise InputError(where, f"is not symmetric (largest difference {skew.max():.3g})", "export the full matrix")
    return sparse.csc_array(0.5 * (matrix + matrix.T))


def _refuse_structure(where: str, data: np.ndarray, indices: np.ndarray, indptr: np.ndarray, size: int) -> None:
    """What scipy's compiled loops trust: they write where these numbers point."""
    if data.ndim != 1 or not all(part.dtype.kind in "iu" and part.ndim == 1 for part in (indices, indptr)):
        raise InputError(where, "its _data is not a list of numbers, or _indices and _indptr of whole ones",
                         "write CSR parts again")
    if len(indices) != len(data) or (len(indices) and not 0 <= indices.min() <= indices.max() < size):
        raise InputError(where, "its _indices do not fit _data or the matrix size", "write CSR parts again")
    # compared, not subtracted: differences of unsigned numbers do not fall
    if size < 1 or indptr[0] != 0 or indptr[-1] != len(data) or np.any(indptr[1:] < indptr[:-1]):
        raise InputError(where, f"its _indptr does not rise from 0 to the {len(data)} entries", "write CSR parts again")


def _real_matrix(where: str, raw: np.ndarray) -> np.ndarray:
    if raw.dtype.kind not in "iufb":
        raise InputError(where, f"holds {raw.dtype}, not real numbers", "export real matrices")
    return raw.astype(float)


def _refuse_unused(path: Path, content: Mapping, used: set[str], table: str) -> None:
    """A matrix without its parameter is part of no K(theta): harmless only if that is meant, so it is said. Other
    arrays may be another tool's; one that almost is one of ours is a slip."""
    for key in content:
        close = [] if key in ARRAYS or key[:2] in ("K_", "M_") else difflib.get_close_matches(
            key, ARRAYS, n=1, cutoff=0.8)
        if close:
            raise InputError(f"{path}, {key}", "no array of a model has this name", f"did you mean '{close[0]}'?")
        if key[:2] in ("K_", "M_"):
            name = key[2:]
            for part in SPARSE_PARTS:
                name = name.removesuffix(part)
            if name not in used and key not in used:
                raise InputError(
                    f"{path}, {key}", f"no parameter is named '{name}'",
                    f"list it in {table} (update = false holds it at its initial value), or leave the matrix out of "
                    "the file",
                )


def _channels(path: Path, content: Mapping, n: int) -> tuple[tuple[str, ...], sparse.csr_array]:
    """Names, and (n_channel, n) what a channel reads of the degrees of freedom: one of them (`channel_dof`, with a
    sign), or a combination of several (`channel_row`), as an oblique sensor does."""
    if "channel" not in content:
        raise InputError(f"{path}, channel", "is missing", "name the measured channels")
    names = tuple(str(c) for c in content["channel"])
    if twice := [name for name in dict.fromkeys(names) if names.count(name) > 1]:
        raise InputError(f"{path}, channel", f"'{twice[0]}' is listed twice", "give each channel a name of its own")
    rows = _channel_rows(path, content, names, n, "channel")
    if rows is None:
        raise InputError(f"{path}, channel_dof", "is missing",
                         "give each channel's row, or combinations in channel_row")
    empty = np.flatnonzero(np.diff(rows.indptr) == 0)
    if empty.size:
        raise InputError(f"{path}, channel_row", f"channel {int(empty[0]) + 1} reads no degree of freedom",
                         "give its direction there")
    return names, rows


def _channel_rows(
    path: Path, content: Mapping, names: Sequence[str], n: int, key: str
) -> sparse.csr_array | None:
    """(n_channel, n) by <key>_row, dense or in CSR parts, or by <key>_dof, a row of the matrices each, with <key>_sign;
    None where there is neither."""
    row_keys = [k for k in (f"{key}_row", f"{key}_row_data") if k in content]
    if row_keys and (f"{key}_dof" in content or f"{key}_sign" in content):
        raise InputError(f"{path}, {row_keys[0]}", f"stands beside {key}_dof or {key}_sign", "keep one of them")
    if row_keys:
        return _combinations(path, content, f"{key}_row", len(names), n)
    if f"{key}_dof" not in content:
        return None
    # a channel whose place turns in no degree of freedom of the matrices
    least = -1 if key == "channel_tilt" else 0
    dof = np.asarray(content[f"{key}_dof"])
    if dof.shape != (len(names),) or not np.issubdtype(dof.dtype, np.integer):
        raise InputError(f"{path}, {key}_dof", f"has {dof.dtype} of shape {dof.shape}",
                         f"give {plural(len(names), 'whole number')}, a row of the matrices for each channel")
    if len(names) and (dof.min() < least or dof.max() >= n):
        worst = int(dof.min() if dof.min() < least else dof.max())
        raise InputError(f"{path}, {key}_dof", f"row {worst} is outside {least}..{n - 1}", "count rows from zero")
    sign = _real_matrix(f"{path}, {key}_sign", np.asarray(content.get(f"{key}_sign", np.ones(len(names)))))
    if sign.shape != (len(names),) or not np.all(np.abs(sign) == 1):
        raise InputError(f"{path}, {key}_sign", "is not a +1 or -1 per channel", "correct it or leave it out")
    own = np.flatnonzero(dof >= 0)
    return sparse.csr_array((sign[own], (own, dof[own])), shape=(len(names), n))


def _combinations(path: Path, content: Mapping, key: str, n_channel: int, n: int) -> sparse.csr_array:
    """(n_channel, n), dense or in CSR parts."""
    where = f"{path}, {key}"
    if key in content:
        raw = _real_matrix(where, np.asarray(content[key]))
        if raw.shape != (n_channel, n):
            raise InputError(where, f"has shape {raw.shape}", f"give ({n_channel}, {n}): a row for each channel")
        rows = sparse.csr_array(raw)
    else:
        if missing := [part for part in SPARSE_PARTS if f"{key}{part}" not in content]:
            raise InputError(f"{where}{missing[0]}", "is missing", f"give all three CSR parts, or {key} dense")
        data, indices, indptr = (content[f"{key}{part}"] for part in SPARSE_PARTS)
        if np.size(indptr) - 1 != n_channel:
            raise InputError(where, f"has {np.size(indptr) - 1} rows", f"give one for each of the {n_channel} channels")
        _refuse_structure(where, data, indices, indptr, n)
        rows = sparse.csr_array((_real_matrix(where, data), indices.astype(np.int64), indptr.astype(np.int64)),
                                shape=(n_channel, n))
    if not np.all(np.isfinite(rows.data)):
        raise InputError(where, "holds NaN or infinite entries", "check how it was exported")
    return rows


def _tilts(path: Path, content: Mapping, reads: sparse.csr_array) -> tuple[sparse.csr_array, np.ndarray]:
    """(n_channel, n) d_x theta_y - d_y theta_x of channels along d (see `readings`): as channel_tilt_dof or
    channel_tilt_row have it, else by the rotations that dof_direction names at the nodes of what channels read; and of
    which channels (n_channel,) it is known: those without a horizontal part need none."""
    n = reads.shape[1]
    names = tuple(str(c) for c in content["channel"])
    stated = _channel_rows(path, content, names, n, "channel_tilt")
    tilts, known = _tilts_by_nodes(content, reads)
    if stated is None:
        return tilts, known
    return stated, known & (np.diff(tilts.indptr) == 0) | (np.diff(stated.indptr) > 0)


def _tilts_by_nodes(content: Mapping, reads: sparse.csr_array) -> tuple[sparse.csr_array, np.ndarray]:
    n_channel, n = reads.shape
    if "dof_node" not in content or "dof_direction" not in content:
        return sparse.csr_array((n_channel, n)), np.zeros(n_channel, bool)
    node, direction = (np.asarray(content[key]).astype(int) for key in ("dof_node", "dof_direction"))
    at = {(int(a), int(k)): row for row, (a, k) in enumerate(zip(node, direction, strict=True))}
    found = sparse.lil_array((n_channel, n))
    known = np.ones(n_channel, bool)
    for channel in range(n_channel):
        own = slice(reads.indptr[channel], reads.indptr[channel + 1])
        for dof, share in zip(reads.indices[own], reads.data[own], strict=True):
            # along x about y, along y about x the other way round
            about = {0: (4, 1.0), 1: (3, -1.0)}.get(int(direction[dof]))
            row = None if about is None else at.get((int(node[dof]), about[0]))
            if about is not None and row is not None:
                found[channel, row] += about[1] * share
            elif about is not None or direction[dof] < 0:
                known[channel] = False
    return sparse.csr_array(found), known


def _gravity(path: Path, content: Mapping, known: np.ndarray) -> FeltGravity:
    """All channels taken for accelerometers, as matrices do not say what they are."""
    own = np.asarray(content.get("gravity", STANDARD_MPS2))
    if own.shape != () or own.dtype.kind not in "iuf" or not 0 < own < np.inf:
        raise InputError(f"{path}, gravity", f"{own!r:.60} is not an acceleration",
                         "give one number above zero, in the "
                         "matrices' unit of length over s2: 9.80665, or 9806.65 where that is mm")
    return FeltGravity(mps2=float(own), share=frozen_array(np.ones(len(known))), known=frozen_array(known, bool))


def channel_places(model: AffineModel) -> tuple[Sensor, ...]:
    """Where the channels of a model of matrices are, and along which direction they read, of those that read nothing
    but translations of nodes with a place (of several nodes their mean); all of one level, as matrices know no loggers;
    () without `node_position_m`."""
    if model.wire is None or model.wire_matrix is None:
        return ()
    moves, reads = sparse.coo_array(model.wire_matrix), sparse.csr_array(model.channel_matrix)
    axis_of = dict(zip(moves.col.tolist(), moves.row.tolist(), strict=True))
    found = []
    for k, channel in enumerate(model.channels):
        own = slice(reads.indptr[k], reads.indptr[k + 1])
        dof, factor = reads.indices[own], reads.data[own]
        if not len(dof) or any(int(d) not in axis_of for d in dof):
            continue
        node, axis = np.divmod([axis_of[int(d)] for d in dof], 3)
        along = factor @ np.eye(3)[axis]
        if (length := float(np.linalg.norm(along))) > 0:
            weight = np.abs(factor) / np.abs(factor).sum()
            found.append(Sensor(channel=channel, level="", position_m=weight @ model.wire.node_m[node],
                                direction=along / length))
    return tuple(found)


def _wireframe(
    path: Path, content: Mapping, n: int
) -> tuple[Wireframe | None, sparse.csr_array | None, sparse.csr_array | None]:
    """The picture, the motion of its nodes and their rotation, both (3 n_node, n)."""
    keys = ("node_position_m", "dof_node", "dof_direction")
    present = [key for key in keys if key in content]
    if not present:
        return None, None, None
    if len(present) < 3:
        missing = next(key for key in keys if key not in content)
        raise InputError(f"{path}, {missing}", "is missing", f"a picture needs {', '.join(keys)}")
    node = np.asarray(content["node_position_m"], float)
    dof_node, direction = np.asarray(content["dof_node"]), np.asarray(content["dof_direction"])
    if node.ndim != 2 or node.shape[1] != 3:
        raise InputError(f"{path}, node_position_m", f"has shape {node.shape}", "give (n_node, 3)")
    if not np.all(np.isfinite(node)):
        raise InputError(f"{path}, node_position_m", "holds NaN or infinite places", "give every node's place in m")
    for key, numbers in (("dof_node", dof_node), ("dof_direction", direction)):
        if numbers.shape != (n,) or numbers.dtype.kind not in "iuf":
            raise InputError(f"{path}, {key}", f"is not one number for each of the {n} rows of K0",
                             "give whole numbers: a node's row; 0, 1, 2 for motion along x, y, z (3, 4, 5 rotation)")
    if dof_node.dtype.kind not in "iu" or np.any((dof_node < 0) | (dof_node >= len(node))):
        raise InputError(f"{path}, dof_node", f"is not a row of node_position_m, 0..{len(node) - 1}", "count from zero")
    if np.any(direction > 5):
        raise InputError(f"{path}, dof_direction", f"{direction.max():g} is none",
                         "give 0, 1, 2 for motion along x, y, z, 3, 4, 5 for rotation, and -1 for neither")
    if len(node) > 1 and np.all(node == node[0]):
        raise InputError(f"{path}, node_position_m", f"has all {len(node)} nodes at one place",
                         "give every node's place in m, or leave the picture's arrays out")
    moves, turns = (_node_rows(dof_node, direction - first, len(node)) for first in (0, 3))
    line = np.asarray(content.get("line", np.empty((0, 2), int)))
    if line.dtype.kind not in "iu" or line.shape[1:] != (2,) or np.any((line < 0) | (line >= len(node))):
        raise InputError(f"{path}, line", "is not pairs of rows of node_position_m", "count from zero, (n_line, 2)")
    wire = Wireframe(node_m=frozen_array(node), line=frozen_array(line, int), line_group=("model",) * len(line))
    return wire, moves, turns


def _node_rows(dof_node: np.ndarray, axis: np.ndarray, n_node: int) -> sparse.csr_array:
    """(3 n_node, n) of the rows whose axis is 0, 1 or 2."""
    rows = np.flatnonzero((axis >= 0) & (axis < 3))
    return sparse.csr_array((np.ones(len(rows)), (3 * dof_node[rows] + axis[rows], rows)),
                            shape=(3 * n_node, len(axis)))
