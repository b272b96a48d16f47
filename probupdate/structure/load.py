"""Open a model: a turbine's model.toml, or matrices in model.npz with a table of parameters."""

from __future__ import annotations

import difflib
import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy import sparse

from probupdate.errors import InputError
from probupdate.io.files import input_file, resolve_path
from probupdate.modal.modes import Sensor
from probupdate.model.interface import Wireframe
from probupdate.model.parameters import Parameters
from probupdate.runtime.arrays import frozen_array
from probupdate.structure.affine import AffineModel
from probupdate.structure.assembly import assemble
from probupdate.structure.channels import Move, channel_rows
from probupdate.structure.description import Description, described_sensors
from probupdate.structure.description import updatable_parameters as updated_of
from probupdate.structure.description_file import parse_description
from probupdate.structure.effect_kinds import EffectKeys
from probupdate.structure.frame import Frame
from probupdate.structure.matrices import load_matrices
from probupdate.structure.mode_labels import dof_places
from probupdate.structure.parameter_table import read_parameters, read_toml, updated_parameters
from probupdate.structure.pile_head import pile_head_stiffness
from probupdate.structure.readings import FeltGravity
from probupdate.structure.schema import suggest
from probupdate.structure.subdyn_model import (
    described_model,
    is_subdyn,
    subdyn_angle_deg,
    subdyn_model,
    subdyn_sensors,
)
from probupdate.structure.turbine_frame import build_frame, described_angle_deg
from probupdate.structure.turned_nacelle import turned_terms

REFERENCE_STATES = ("design", "as_built", "updated")
FORMS = (".toml", ".npz", ".dat")
# tables of a TOML that is a model and no table of parameters alone
OTHER_FORMS = {"site", "steel", "subdyn", "matrices"}
# part of every hash: raise it when the same description gives other matrices
FORMULATION = 1


def reference_model(state: str = "as_built") -> Path:
    """The packaged model.toml of the reference turbine in one of its three states."""
    if state not in REFERENCE_STATES:
        raise InputError("reference model", f"state '{state}' is unknown", f"choose from {', '.join(REFERENCE_STATES)}")
    path = Path(__file__).resolve().parents[1] / "reference" / f"{state}.toml"
    if not path.exists():
        raise InputError(str(path), "the package was installed without it", "reinstall probupdate")
    return path


def load_model(
    path: str | Path,
    *,
    parameters: Parameters | str | Path | None = None,
    sensors: Sequence[Sensor] | None = None,
    nacelle_angle_deg: float | None = None,
) -> AffineModel:
    """`.toml`: a turbine by its geometry, [matrices] beside its parameters, or [subdyn] with what to update of it;
    `.npz`: matrices; `.dat`: a SubDyn file, without parameters.

    `parameters` replaces the updated ones of the file; for `.npz` it is needed unless `<name>.toml` or
    `parameters.toml` lies beside it. `sensors` replaces the model's own, so that it answers at any campaign's
    channels; a channel of the same name keeps the part the file gives it, others attach to the nearest one.
    `nacelle_angle_deg`: where the nacelle looks, counter-clockwise from the model's x axis (None: as in the file); a
    model of matrices stands as it was exported.
    """
    path, table = Path(path), "the parameters"
    if isinstance(parameters, str | Path):
        parameters, table = read_parameters(parameters), str(parameters)
    if path.suffix == ".npz":
        _refuse_sensors(input_file(path, "check the path"), sensors)
        if parameters is None:
            table = str(_parameter_table(path))
            parameters = read_parameters(table)
        return load_matrices(path, parameters, table=table)
    if path.suffix.lower() == ".dat":
        if parameters is not None:
            raise InputError(str(path), "a SubDyn file alone has no parameters", "name groups and parameters in a TOML "
                             "with [subdyn] file (docs/formats/model.md)")
        return subdyn_model(path, sensors=sensors)
    if path.suffix != ".toml":
        raise _unknown_form(path)
    raw = read_toml(path)
    if "subdyn" in raw:
        return described_model(raw, path, parameters=parameters, sensors=sensors, nacelle_angle_deg=nacelle_angle_deg)
    if "matrices" in raw:
        _refuse_sensors(path, sensors)
        return _matrix_model(path, raw, parameters, table)
    description = parse_description(raw, str(path))
    return turbine_model(description, where=str(path), parameters=parameters, sensors=sensors,
                         turn_deg=turn_to(description, nacelle_angle_deg))


def _unknown_form(path: Path) -> InputError:
    """Why a path of another ending is not a model, and what was probably meant."""
    forms = "a model is a model.toml, a model.npz or a SubDyn .dat"
    meant = difflib.get_close_matches(str(path).lower(), REFERENCE_STATES, n=1, cutoff=0.6)
    if (path / "campaign.toml").is_file():
        return InputError(str(path), "is a campaign's folder, not a model's file", forms)
    if path.is_dir():
        usual = [name for name in ("model.toml", "model.npz") if (path / name).is_file()]
        # matrices before a TOML, which may be their table of parameters
        held = usual or [f.name for ending in (".npz", ".toml", ".dat") for f in sorted(path.glob(f"*{ending}"))
                         if f.name != "parameters.toml"]
        return InputError(str(path), "is a directory, not a model's file",
                          f"did you mean '{path / held[0]}'?" if held else forms)
    if not path.suffix:
        problem = "has no ending that says what it is" if path.exists() else (
            "is not a state of the reference turbine, no model's file and no command")
        return InputError(str(path), problem, f"did you mean '{meant[0]}'?" if meant else f"{forms}; states are "
                          f"{', '.join(REFERENCE_STATES)}")
    close = difflib.get_close_matches(path.suffix.lower(), FORMS, n=1, cutoff=0.5)
    there = [str(path.with_suffix(s)) for s in (*close, *FORMS) if path.with_suffix(s).is_file()]
    return InputError(str(path), f"'{path.suffix}' is not a form of model", f"did you mean '{there[0]}'?" if there else
                      forms.replace("a model is", "give"))


def model_sensors(path: str | Path) -> tuple[Sensor, ...] | None:
    """A model file's own channels with their places; () of a turbine without any; None where places are not known."""
    path = Path(path)
    if is_subdyn(path):
        return subdyn_sensors(path)
    if path.suffix != ".toml":
        return None
    raw = read_toml(path)
    if "matrices" in raw:
        return None
    description = parse_description(raw, str(path))
    return _model_sensors(description) if description.sensor else ()


def nacelle_angle_deg(environment: Mapping[str, object], where: str) -> float | None:
    """Where the nacelle looked while a set was measured, counter-clockwise from the model's x axis in -180 to 180; None
    where the set does not state it."""
    if "nacelle_angle_deg" not in environment:
        return None
    value = environment["nacelle_angle_deg"]
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        where = f"{where}, environment.nacelle_angle_deg"
        raise InputError(where, f"{value!r} is not an angle", "give degrees, or leave it out")
    return float((value + 180.0) % 360.0 - 180.0)


def _refuse_sensors(path: Path, sensors) -> None:
    if sensors is not None:
        raise InputError(str(path), "a model of matrices has its own channels only", "leave the sensors to the model")


def _candidate_tables(path: Path) -> list[Path]:
    """Where the parameters of a model.npz stand; a TOML of its name may be another form of model."""
    own = path.with_suffix(".toml")
    there = [own] if own.is_file() and not OTHER_FORMS & set(read_toml(own)) else []
    return [p for p in (*there, path.with_name("parameters.toml")) if p.is_file()]


def _parameter_table(path: Path) -> Path:
    """The table of parameters of a model.npz."""
    for found in _candidate_tables(path):
        return found
    other = path.with_suffix(".toml")
    raise InputError(
        str(path), "its parameters are not known" + (f" ({other.name} is a model itself)" if other.is_file() else ""),
        "write parameters.toml beside it, one [[parameter]] table each with name, unit, initial, cov or std, lower, "
        "upper, prior, or name such a file",
    )


def _matrix_model(path: Path, raw: dict, parameters: Parameters | None, table: str) -> AffineModel:
    allowed = ("format", "name", "matrices", "parameter", "correlation")
    for key in raw:
        if key not in allowed:
            raise InputError(f"{path}: {key}", "is not a key of a model of matrices", suggest(key, allowed))
    file = _path_from_table(path, raw)
    if parameters is None:
        if "parameter" not in raw:
            raise InputError(f"{path}: parameter", "there is none", "list at least one [[parameter]]")
        parameters, table = updated_parameters(raw["parameter"], str(path), raw.get("correlation")), str(path)
    return load_matrices(file, parameters, name=raw.get("name"), table=table)


def _path_from_table(path: Path, raw: dict) -> Path:
    table = raw["matrices"]
    if not isinstance(table, dict) or set(table) != {"file"} or not isinstance(table["file"], str):
        raise InputError(f"{path}: matrices", "is not a table with the one key 'file'", 'write file = "model.npz"')
    return resolve_path(table["file"], path.resolve().parent, f"{path}: matrices.file")


def model_files(path: str | Path, parameters: str | Path | None = None) -> tuple[Path, ...]:
    """What identifies a model on the disk, as far as it is there: its file, the one that it names, and the table of its
    parameters."""
    path = Path(path)
    raw = read_toml(path) if path.suffix == ".toml" and path.is_file() else {}
    tables = [raw[key] for key in ("matrices", "subdyn") if isinstance(raw.get(key), dict)]
    named = [path.parent / str(table.get("file")) for table in tables]
    if parameters is not None:
        named.append(Path(parameters))
    elif path.suffix == ".npz":
        named += _candidate_tables(path)[:1]
    return tuple(p for p in (path, *named) if p.is_file())


def matrices_file(path: str | Path) -> tuple[Path, str]:
    """The .npz file of a model of matrices, and the model's name; raises InputError for a turbine's model.toml."""
    path = Path(path)
    if path.suffix == ".npz":
        return path, path.stem
    raw = read_toml(path)
    if "matrices" not in raw:
        raise InputError(str(path), "is not a model of matrices", "give model.npz, or a model.toml with [matrices]")
    file = _path_from_table(path, raw)
    return file, str(raw.get("name") or file.stem)


def turn_to(description: Description, nacelle_angle_deg: float | None) -> float:
    """By how much the nacelle is turned from where it is described, so that it looks there; None: not at all."""
    return 0.0 if nacelle_angle_deg is None else (nacelle_angle_deg - described_angle_deg(description)) % 360.0


def resting_angle_deg(path: Path) -> float:
    """Where the nacelle looks in a model's file as it is, counter-clockwise from the model's x axis."""
    if is_subdyn(path):
        return subdyn_angle_deg(path)
    raw = read_toml(path) if path.suffix == ".toml" else {"matrices": {}}
    return 0.0 if "matrices" in raw else described_angle_deg(parse_description(raw, str(path)))


def turbine_model(
    description: Description,
    *,
    where: str,
    parameters: Parameters | None = None,
    sensors: Sequence[Sensor] | None = None,
    turn_deg: float = 0.0,
    frame: Frame | None = None,
    turns_deg: Sequence[float] = (),
) -> AffineModel:
    """A turbine's frame as a model of its modes, with `derived` k_xy and k_z, a pile's head stiffness in N/m. turn_deg:
    of the nacelle from where it is described. `frame`: `build_frame` of this description and turn, where it has been
    built already. `turns_deg`: by how much the nacelle looks elsewhere in the model's `turned`."""
    parameters = updated_of(description, where) if parameters is None else parameters
    known = {*description.own_parameters, *(p.name for p in description.effects)}
    values = dict(parameters.held) | {p.name: p.initial for p in parameters}
    for name in values:
        if name not in known:
            raise InputError(f"{where}: parameter {name}", "the model has no such parameter", suggest(name, known))
    values = description.values | values
    try:
        frame = build_frame(description, turn_deg) if frame is None else frame
    except InputError as error:
        # what is built knows its parameters, not the file
        raise InputError(f"{where}: {error.where}", error.problem, error.remedy) from None
    mesh = description.mesh
    stated = {"updated": parameters.names, "values": values, "theory": mesh.theory,
              "gravity_mps2": description.gravity_mps2 if mesh.geometric_stiffness else None}
    assembled = assemble(frame, **stated)
    chosen = tuple(sensors) if sensors is not None else _model_sensors(description)
    rows, moved = channel_rows(frame, chosen, {s.channel: s.part for s in description.sensor}, where,
                               _moves(description, parameters, values))
    wire, wire_rows = _wireframe(frame)
    rows = sparse.csr_array(rows @ assembled.transform)
    return AffineModel(
        name=description.name,
        parameters=parameters,
        channels=tuple(s.channel for s in chosen),
        stiffness=assembled.stiffness,
        mass=assembled.mass,
        coefficients=assembled.coefficients,
        channel_matrix=rows[: len(chosen)],
        tilt_matrix=rows[len(chosen) :],
        gravity=_felt_gravity(description, chosen, parameters, values),
        hash_key=_hash(description, values, chosen, turn_deg),
        wire=wire,
        wire_matrix=sparse.csr_array(wire_rows @ assembled.transform),
        derived={} if frame.pile_head is None else pile_head_stiffness(
            frame, updated=parameters.names, values=values, theory=mesh.theory),
        moved=tuple(m.project(assembled.transform) for m in moved),
        places=dof_places(frame.node_m, assembled.transform),
        turned=tuple(turned_terms(frame, assembled, turns_deg, **stated)) if turns_deg else (),
    )


def _moves(description: Description, parameters: Parameters, values: Mapping[str, float]) -> list[Move]:
    """Where sensors sit elsewhere than described."""
    found = []
    for p in description.effects:
        if p.kind != "sensor_height":
            continue
        if p.name in parameters.names:
            own = parameters.items[parameters.index(p.name)]
            found.append(Move(name=p.name, channels=p.channels or (), column=parameters.index(p.name), low_m=own.lower,
                              high_m=own.upper))
        elif values[p.name]:
            found.append(Move(name=p.name, channels=p.channels or (), fixed_m=values[p.name]))
    return found


def _felt_gravity(
    description: Description, sensors: Sequence[Sensor], parameters: Parameters, values: Mapping[str, float]
) -> FeltGravity:
    """What the sensors hold of gravity: as stated, and as parameters that say that this is wrong have it."""
    share, reverse = np.array([float(s.gravity) for s in sensors]), []
    for p in description.effects:
        if p.kind != "sensor_gravity":
            continue
        own = np.array([float(s.channel in (p.channels or ())) for s in sensors])
        if p.name in parameters.names:
            reverse.append((parameters.index(p.name), frozen_array(own)))
        else:
            share = share + values[p.name] * own * (1 - 2 * share)
    return FeltGravity(mps2=description.gravity_mps2, share=frozen_array(share), reversed_by=tuple(reverse),
                       known=frozen_array(np.ones(len(sensors)), bool))


def _model_sensors(description: Description) -> tuple[Sensor, ...]:
    if not description.sensor:
        raise InputError(description.name, "lists no [[sensor]]", "add the channels, or give a campaign's")
    return described_sensors(description)


def _wireframe(frame: Frame) -> tuple[Wireframe, sparse.csr_array]:
    lines, groups = frame.lines()
    size = len(frame.node_m)
    picked = (6 * np.arange(size)[:, None] + np.arange(3)).ravel()
    entries = (np.ones(3 * size), (np.arange(3 * size), picked))
    rows = sparse.csr_array(sparse.coo_array(entries, shape=(3 * size, 6 * size)))
    return Wireframe(node_m=frozen_array(frame.node_m), line=frozen_array(lines, int), line_group=groups), rows


def _hash(description: Description, values, sensors: Sequence[Sensor], turn_deg: float) -> str:
    """All that determines the matrices and rows; priors are the model's own affair and enter its fingerprint."""
    content = description.model_dump(mode="json", exclude={"parameter", "correlation", "sensor"})
    places = [[s.channel, s.position_m.tolist(), s.direction.tolist()] for s in sensors]
    parts = {s.channel: s.part for s in description.sensor}
    state = [FORMULATION, content, dict(sorted(values.items())), places, parts, turn_deg]
    if description.effects:
        keys = ("name", "lower", "upper", *EffectKeys.model_fields)
        state.append([p.model_dump(mode="json", include=set(keys)) for p in description.effects])
    text = json.dumps(state, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
