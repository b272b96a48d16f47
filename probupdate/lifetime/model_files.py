"""The model at every draw of an export, with its tolerances there, as files that are read back and solved again."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy import sparse

from probupdate.errors import InputError
from probupdate.io.elastodyn_file import referenced_files
from probupdate.io.files import read_text, write_arrays, write_text
from probupdate.io.fortran_text import read_lines, write_lines
from probupdate.io.subdyn_file import SubDynFile, read_subdyn, write_subdyn
from probupdate.lifetime.factors import tolerance_draws
from probupdate.lifetime.substructure_file import NAME, differences, write_substructure
from probupdate.lifetime.superelement import READ_BACK
from probupdate.model.interface import ModalSolution, Model
from probupdate.runtime.progress import Progress
from probupdate.structure.assembly import Softening, transformation
from probupdate.structure.description_file import read_description as read_turbine
from probupdate.structure.eigen import lowest_modes
from probupdate.structure.extend import EffectParameter, extended_description, extended_model, parameter_text
from probupdate.structure.frame import Frame
from probupdate.structure.load import load_model, matrices_file
from probupdate.structure.matrices import read_archive
from probupdate.structure.parameter_table import read_toml
from probupdate.structure.subdyn_model import is_subdyn, named_file, subdyn_model
from probupdate.structure.subdyn_values import apply_values, carried_masses
from probupdate.structure.subdyn_writing import NOT_WRITTEN, UNSPOKEN, NoSubDynKeyword
from probupdate.structure.substructure import NoSubstructure
from probupdate.structure.turbine_frame import build_frame
from probupdate.updating.problem import Problem

# a SubDyn file at a draw; a name of its own, as the user's file may lie beside it
AT_DRAW = "subdyn_at_draw.dat"


@dataclass(frozen=True, eq=False, kw_only=True)
class DrawnModels:
    """What is written of each draw: `model` at theta (n_draw, n_param), the updated parameters of the file at `path`
    and behind them `effects`, tolerances of the structure; unknown (n_draw, n_source): all sources of the problem's
    error given data and draw, as if all were linear in them, None without a problem with some; differences (n_draw,
    n_source): of the models' values, and of sensors, from what is stated."""

    path: Path
    parameters_file: Path | None
    model: Model
    theta: np.ndarray
    effects: tuple[EffectParameter, ...] = ()
    unknown: np.ndarray | None = None
    differences: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    @classmethod
    def from_posterior(
        cls, path: Path, parameters_file: Path | None, model: Model, draws: np.ndarray, problem: Problem | None,
        rng: np.random.Generator,
    ) -> DrawnModels:
        """Draws of a posterior with tolerances of `problem` drawn given each of them: parameters alone leave out what
        data moved of soil or walls, and have other frequencies than were measured."""
        sources = () if problem is None else problem.error_sources
        if problem is None or not sources:
            return cls(path=path, parameters_file=parameters_file, model=model, theta=draws)
        # of a SubDyn model's structure, and of matrices, none are stated
        rows = getattr(getattr(problem.model, "uncertainty", None), "tolerances", ())
        # no scour below nothing; factors keep above zero by themselves
        least = {row.source.name: row.effect.lower - row.effect.neutral for row in rows if row.effect.neutral != 1}
        unknown = tolerance_draws(problem, draws, rng, lowest=np.array([least.get(s.name, -np.inf) for s in sources]))
        if not rows:
            return cls(path=path, parameters_file=parameters_file, model=model, theta=draws, unknown=unknown,
                       differences=unknown)
        names, effects = [s.name for s in sources], tuple(row.effect for row in rows)
        differences, at = np.array(unknown), [names.index(row.source.name) for row in rows]
        values = np.column_stack([_value(e, unknown[:, k]) for e, k in zip(effects, at, strict=True)])
        differences[:, at] = values - [e.neutral for e in effects]
        return cls(path=path, parameters_file=parameters_file, theta=np.hstack([draws, values]), effects=effects,
                   model=extended_model(path, effects, parameters=model.parameters), unknown=unknown,
                   differences=differences)

    @property
    def n_own(self) -> int:
        """Parameters that the file has itself."""
        return self.theta.shape[1] - len(self.effects)

    def values(self, k: int) -> dict[str, float]:
        """Of the file's parameters at a draw."""
        return dict(zip(self.model.parameters.names[: self.n_own], self.theta[k].tolist(), strict=False))

    def tables(self, k: int) -> list[dict]:
        """[[parameter]] tables of the tolerances at a draw."""
        found = []
        for effect, value in zip(self.effects, self.theta[k, self.n_own :].tolist(), strict=True):
            held = replace(effect, initial=value, lower=min(effect.lower, value), upper=max(effect.upper, value))
            found.append({key: x for key, x in (held.table() | {"update": False}).items() if x != ""})
        return found

    @cached_property
    def frame(self) -> Frame | None:
        """Of a turbine's model.toml, else None. Parameters' values are no part of it: it is that of every draw."""
        if self.path.suffix != ".toml" or is_subdyn(self.path) or "matrices" in read_toml(self.path):
            return None
        return build_frame(extended_description(self.path, self.effects))

    @cached_property
    def _softening(self) -> tuple[Softening, dict[str, float], np.ndarray] | None:
        """What a turbine's weight makes of its stiffness, initial values, and the member forces of these, which the run
        has; None where it makes nothing."""
        if self.frame is None:
            return None
        description = extended_description(self.path, self.effects)
        values = description.values | dict(self.model.parameters.held) | {
            p.name: p.initial for p in self.model.parameters}
        found = Softening.assemble(
            self.frame, transformation(self.frame)[: 6 * len(self.frame.node_m)], np.ones(len(self.frame.node_m), bool),
            updated=tuple(self.model.parameters.names), values=values, theory=description.mesh.theory,
            gravity_mps2=description.gravity_mps2 if description.mesh.geometric_stiffness else None)
        return None if found is None else (found, values, found.forces(values))

    def softened_hz(self, k: int, n: int) -> np.ndarray:
        """(n,) frequencies at a draw whose own values make the weight's softening."""
        if self._softening is None:
            return self.model.solve(self.theta[k], n).frequency_hz
        softening, values, forces = self._softening
        K, M = self.model.matrices(self.theta[k])
        drawn = values | dict(zip(self.model.parameters.names, self.theta[k], strict=True))
        K = sparse.csc_array(K + softening.matrix(softening.forces(drawn) - forces, drawn))
        return np.sqrt(lowest_modes(K, M, n, self.model.name)[0]) / (2 * np.pi)


def _value(effect: EffectParameter, change: np.ndarray) -> np.ndarray:
    """Of an effect's parameter for changes (n,): of a factor they are its logarithm's, as several factors of one soil
    multiply, and changes that cancel in sum would not."""
    return np.exp(change) if effect.neutral == 1 else effect.neutral + change


def write_models(files, drawn: DrawnModels, left_out: list[str], progress: Progress) -> list[ModalSolution]:
    """models/NNN, read back: SubDyn files and the first draw's TOML are solved again, the others' TOML is held against
    the run's, as it differs by initial values only; returns the modes of every draw."""
    n = min(10, drawn.model.n_available)
    solved, own, raised = [], 0.0, 0.0
    carried = carried_masses(drawn.path) if is_subdyn(drawn.path) else ()
    for k, theta in enumerate(drawn.theta):
        progress("writing models", k, len(drawn.theta))
        folder = files.folder / "models" / f"{k + 1:03d}"
        folder.mkdir(parents=True)
        solved.append(drawn.model.solve(theta, n))
        expected = solved[-1].frequency_hz
        written = _model_files(folder, drawn, k, files.status.remark, left_out if k == 0 else None)
        # the run has the weight's softening by the initial values
        own_weight = drawn.softened_hz(k, n)
        own = max(own, float(np.max(np.abs(own_weight / expected - 1))))
        for entry, opened in written.items():
            checked_to = READ_BACK if opened else None
            if not isinstance(opened, bool):
                found = opened.solve(opened.parameters.initial, n).frequency_hz
                error = float(np.max(np.abs(found / own_weight - 1)))
                if carried and entry.endswith(AT_DRAW):
                    raised = checked_to = max(raised, error, READ_BACK)
                elif not error < READ_BACK:
                    raise InputError(str(folder / entry),
                                     f"what was read back has frequencies that differ by {error:.1e}",
                                     "report this: the model was not written as it is")
            files.add(folder / entry, f"the model at draw {k + 1}", "SI", checked_to=checked_to)
    progress("writing models", len(drawn.theta), len(drawn.theta))
    if carried:
        left_out.append(f"models/*/{AT_DRAW} and superelements: {', '.join(carried)} as a mass without rotary inertia "
                        "and even along tapered members; SubDyn's only word for it is a raised density" + (
                            f": frequencies differ by up to {raised:.1e}" if raised else "; see model.toml"))
    if own > READ_BACK:
        left_out.append("models/*: that their own masses change the weight's softening (mesh.geometric_stiffness) is "
                        f"in them and not in the run: frequencies differ by up to {own:.1e}")
    return solved


def _model_files(
    folder: Path, drawn: DrawnModels, k: int, remark: str, left_out: list[str] | None
) -> dict[str, Model | bool]:
    """Write a model at one draw; name of each file -> the model opened again from it, True where its text was compared,
    False where it is a part of one. `left_out`: of the first draw, where what all of them lack is said."""
    said: list[str] = [] if left_out is None else left_out
    path, values = drawn.path, drawn.values(k)
    if is_subdyn(path):
        written: dict[str, Model | bool] = {}
        tower = "tower" in read_toml(path)
        file, above = apply_values(path, values, remark)
        place = path_in_draw(path)
        target = write_subdyn(_with_remark(file, remark), folder / place, folder)
        for name in file.soil:
            written[_join_path(place.parent, name)] = False
        written[place.as_posix()] = False if tower else subdyn_model(target, root=folder)
        if above:
            said.append(f"{', '.join(above)} in models/*/{AT_DRAW}: they act on the tower; see model.toml")
        if tower:
            written |= _toml_model(folder, path, values, remark, left_out is not None)
        return written
    if path.suffix == ".npz":
        _copy_archive(path, folder / "model.npz", remark)
        usual = (path.with_suffix(".toml"), path.with_name("parameters.toml"))
        own = drawn.parameters_file or next(p for p in usual if p.exists())
        text = f"# {remark}\n" + with_initial(read_text(own), values, str(own))
        write_text(folder / "parameters.toml", text)
        return {"parameters.toml": False, "model.npz": load_model(folder / "model.npz")}
    written = _toml_model(folder, path, values, remark, left_out is not None, drawn.tables(k))
    return written if drawn.frame is None else written | _substructure(folder, remark, left_out, drawn)


def _substructure(
    folder: Path, remark: str, left_out: list[str] | None, drawn: DrawnModels
) -> dict[str, Model | bool]:
    """SubDyn's file of a turbine's draw; that of the first draw is solved again, for what it says of all."""
    described = read_turbine(folder / "model.toml")
    # of a lighter member the file would hold a negative mass
    odd = {e.name: e.neutral for e in drawn.effects if e.kind in (*UNSPOKEN, "mass")}
    described = described.model_copy(update={"parameter": tuple(
        p.model_copy(update={"initial": odd[p.name]}) if p.name in odd else p for p in described.parameter)})
    try:
        paths = write_substructure(described, folder, remark, drawn.frame)
    except (NoSubstructure, NoSubDynKeyword) as error:
        if left_out is not None:
            left_out.append(f"models as SubDyn files: {error}")
        return {}
    if left_out is not None:
        worst = float(np.abs(differences(described, paths[0])).max())
        lacking = [*NOT_WRITTEN, *(["tolerances of hinges, slips, shear and weights"] if odd else [])]
        left_out.append(f"in models/*/{NAME}: {'; '.join(lacking)}; without these, read back below the tower of "
                        f"the first draw, the turbine's lowest frequencies are the model's within {worst:.1e}")
    return {p.name: False for p in paths}


def _toml_model(
    folder: Path, path: Path, values, remark: str, first: bool, tolerances: Sequence[dict] = ()
) -> dict[str, Model | bool]:
    """The user's TOML with the draw as initial values, its tolerances behind it, and the files it names."""
    raw = read_toml(path)
    written: dict[str, Model | bool] = {}
    if "matrices" in raw:
        source, _ = matrices_file(path)
        written[raw["matrices"]["file"]] = False
        _copy_archive(source, folder / raw["matrices"]["file"], remark)
    if "subdyn" in raw:
        file = read_subdyn(named_file(path, raw["subdyn"]["file"], "subdyn.file"), path.parent)
        target = folder / raw["subdyn"]["file"]
        target.parent.mkdir(parents=True, exist_ok=True)
        lines = [f"{line} | {remark}" if k == 1 else line for k, line in enumerate(file.lines)]
        write_subdyn(_with_remark(replace(file, lines=tuple(lines)), remark), target, folder)
        own = Path(raw["subdyn"]["file"])
        written |= dict.fromkeys((own.as_posix(), *(_join_path(own.parent, name) for name in file.soil)), False)
        if "elastodyn" in raw.get("tower", {}):
            root = path.resolve().parent
            for source in referenced_files(named_file(path, raw["tower"]["elastodyn"], "tower.elastodyn"), root):
                name = source.relative_to(root)
                written[name.as_posix()] = False
                _copy_openfast(source, folder / name, remark)
    text = f"# {remark}\n" + with_initial(read_text(path), values, str(path))
    target = folder / "model.toml"
    write_text(target, text.rstrip("\n") + "\n" + "".join(f"\n{parameter_text(table)}" for table in tolerances))
    if read_toml(target) != _with_values(raw, values, tolerances):
        raise InputError(str(target), "what was read back differs from the run's model by more than initial values",
                         "report this: the model was not written as it is")
    return written | {"model.toml": load_model(target) if first else True}


def _with_values(raw: Mapping, values: Mapping[str, float], tolerances: Sequence[dict]) -> dict:
    """A TOML's content with a draw as initial values, its tolerances behind; `cov` becomes the std it stood for."""
    def with_value(p: Mapping) -> Mapping:
        if p.get("name") not in values:
            return p
        kept = {key: v for key, v in p.items() if key != "cov"}
        std = {"std": float(p["cov"]) * abs(float(p["initial"]))} if "cov" in p else {}
        return kept | std | {"initial": float(values[p["name"]])}

    own = [with_value(p) for p in raw["parameter"]] if "parameter" in raw else []
    return dict(raw) | ({"parameter": [*own, *tolerances]} if own or tolerances else {})


def path_in_draw(path: Path) -> Path:
    """Where a TOML's SubDyn file stands at a draw, relative to the draw's folder: beside where the user's own would be,
    so that the names of its soil files mean the same."""
    return Path(read_toml(path)["subdyn"]["file"]).parent / AT_DRAW


def _join_path(folder: Path, name: str) -> str:
    return Path(os.path.normpath(folder / name.replace("\\", "/"))).as_posix()


def _with_remark(file: SubDynFile, remark: str) -> SubDynFile:
    """SSI files with the verdict in a comment."""
    return replace(file, soil={k: replace(one, lines=(f"! {remark}", *one.lines)) for k, one in file.soil.items()})


def _copy_archive(source: Path, target: Path, remark: str) -> None:
    write_arrays(target, read_archive(source) | {"remark": np.array(remark)})


def _copy_openfast(source: Path, target: Path, remark: str) -> None:
    """OpenFAST's files have a line of free text, the second."""
    write_lines(target, [f"{line} | {remark}" if k == 1 else line for k, line in enumerate(read_lines(source))])


def with_initial(text: str, values: Mapping[str, float], where: str) -> str:
    """A TOML text with `initial` of its [[parameter]] tables replaced; `cov` becomes the std it stood for, and bounds
    that the value lies on stay. Raises InputError where a parameter's table is not found."""
    tables = re.split(r"(?=^\[)", text, flags=re.M)
    left = dict(values)
    for k, table in enumerate(tables):
        name = re.search(r'^name\s*=\s*["\']([^"\']+)["\']', table, flags=re.M)
        if not table.startswith("[[parameter]]") or name is None or name[1] not in left:
            continue
        value, old = float(left.pop(name[1])), re.search(r"^initial\s*=\s*([^\s#]+)", table, flags=re.M)
        cov = re.search(r"^cov\s*=\s*([^\s#]+)", table, flags=re.M)
        table = re.sub(r"^initial\s*=\s*[^\s#]+", f"initial = {value!r}", table, count=1, flags=re.M)
        if cov is not None and old is not None:
            std = float(cov[1]) * abs(float(old[1]))
            table = re.sub(r"^cov\s*=\s*[^\s#]+", f"std = {std!r}", table, count=1, flags=re.M)
        tables[k] = table
    if left:
        raise InputError(where, f"no [[parameter]] table of {', '.join(left)} was found",
                         "write name = \"...\" on a line")
    return "".join(tables)
