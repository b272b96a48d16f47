"""What a lifetime-extension analysis takes of a run: draws, their joint distribution, models, superelements, modes.

Every file says what the run's verdict is, and is read back and checked before the manifest is written, which comes
last.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from probupdate import __version__
from probupdate.errors import InputError
from probupdate.io.files import read_bytes, read_json, refuse_filled, whole_folder, write_json, write_text
from probupdate.io.result_table import table_of
from probupdate.io.subdyn_file import read_subdyn
from probupdate.lifetime.damping import STATES_OF, MeasuredDamping, draw_ratios, measured_ratios
from probupdate.lifetime.draws import Joint, equal_draws, joint_of, refuse_draws
from probupdate.lifetime.model_files import DrawnModels, path_in_draw, write_models
from probupdate.lifetime.superelement import READ_BACK, Superelement, reduce_model, superelement, write_superelement
from probupdate.lifetime.tables import read_table
from probupdate.modal.labels import NEUTRAL, TURBINE, family
from probupdate.modal.modes import ModalData
from probupdate.model.interface import Model
from probupdate.runtime.progress import Progress, silent
from probupdate.structure.description_file import read_description as read_turbine
from probupdate.structure.load import model_sensors
from probupdate.structure.mode_labels import mode_labels
from probupdate.structure.parameter_table import read_toml
from probupdate.structure.subdyn_model import is_subdyn, named_file
from probupdate.structure.substructure import NoSubstructure, turbine_substructures
from probupdate.updating.posterior_file import Posterior
from probupdate.updating.problem import Problem

if TYPE_CHECKING:
    import pandas as pd

    from probupdate.lifetime.fatigue import FatigueModel
    from probupdate.lifetime.fatigue_files import FatigueInput

# fewer draws have no standard deviation
FEWEST_DRAWS = 2
# draws of the joint distribution that is written, for its check against the posterior's
RESAMPLED = 200_000
# what the count of ten-minute records has no cycle of
SLOW_CYCLES = ("cycles slower than ten minutes (start, stop, another mean wind): not counted; "
               "add them to the damage where they matter")
CSV, JSON_TYPE = "text/csv", "application/json"


@dataclass(frozen=True, kw_only=True)
class RunStatus:
    """How far a run may be trusted: its sampler's verdict and its diagnosis (None: there is none) with what it
    found. changes: those of its findings with which the structure itself changed within the records; sets: which the
    draws are of, in words; faults: findings on the measurement, in words -> the channels whose records are used all the
    same, () for all of them; in_draws: whether the draws are of the model with the findings."""

    converged: bool
    sampler: str
    diagnosis: str | None
    findings: tuple[str, ...] = ()
    changes: tuple[str, ...] = ()
    sets: str = ""
    faults: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    in_draws: bool = False

    @property
    def refused(self) -> str:
        """Why it needs to be accepted; empty where it does not."""
        reasons = []
        if not self.converged:
            reasons.append("the sampler did not converge")
        if self.diagnosis == "unexplained":
            reasons.append("the diagnosis is unexplained: model and measurement disagree "
                           "and no listed cause explains it")
        if self.changes:
            reasons.append(f"the structure changed within the records ({'; '.join(self.changes)}), and draws must be "
                           f"of the state after alone: these are of {self.sets}")
        reasons += [f"the records of {', '.join(channels) or 'all channels'} are used, of which diagnosis.json says: "
                    f"{words}" for words, channels in self.faults.items()]
        return "; ".join(reasons)

    @property
    def remedy(self) -> str:
        """What to do where it is refused, but for accepting it."""
        steps = []
        if not self.converged or self.diagnosis == "unexplained":
            steps.append("sample longer, or find the cause")
        elif self.changes:
            steps.append("sample the state after alone, by the `sample` that diagnosis.json states (extension, "
                         "commands): its diagnosis.posterior.nc in the run's directory is used then")
        if self.faults:
            channels = dict.fromkeys(c for own in self.faults.values() for c in own)
            without = f"leave them out (--without {shlex.join(channels)}), or " if channels else ""
            steps.append(f"{without}correct the records (factor in convert.toml; unit, direction and gravity in "
                         "campaign.toml), identify and diagnose again")
        return "; ".join(steps)

    @property
    def remark(self) -> str:
        """One line for every file."""
        text = (f"sampler: {'converged' if self.converged else 'NOT CONVERGED'}; "
                f"diagnosis: {self.diagnosis or 'not made'}")
        if self.findings:
            text += f" ({', '.join(self.findings)}: {'in' if self.in_draws else 'not in'} these draws)"
        return f"ACCEPTED ALTHOUGH {self.refused} ({text})" if self.refused else text


@dataclass(frozen=True, eq=False, kw_only=True)
class Export:
    """A written export: its folder, the files with their hashes, the run's status, and what was left out and why."""

    folder: Path
    files: Mapping[str, str]
    draws: np.ndarray
    status: RunStatus
    left_out: tuple[str, ...]
    truncation: float | None

    def content(self) -> dict:
        """What --json prints beside the files."""
        return {
            "folder": str(self.folder), "files": dict(self.files), "draws": len(self.draws),
            "verdict": self.status.remark, "converged": self.status.converged, "diagnosis": self.status.diagnosis,
            "left_out": list(self.left_out), "superelement_truncation_first_pair": self.truncation}

    def to_frame(self) -> pd.DataFrame:
        """A row a file, with its SHA-256."""
        return table_of([{"path": name, "sha256": text} for name, text in self.files.items()], ("path", "sha256"))

    @property
    def summary(self) -> str:
        lines = [f"{len(self.files)} files in {self.folder}, {len(self.draws)} draws; {self.status.remark}"]
        if self.truncation is not None:
            lines.append(f"superelements: largest truncation error of the first pair {100 * self.truncation:.2g} %")
        return "\n".join([*lines, *(f"left out: {text}" for text in self.left_out)])


@dataclass(frozen=True, eq=False, kw_only=True)
class RunResults:
    """What of a run is exported. path: the model's file; diagnosis, findings: verdict and causes of diagnosis.json,
    None and empty without one, in_draws: whether draws and model have these, changes: those of the structure within the
    records; source: files of the run by name,
    whose hashes are kept; problem: the one that was sampled, None where there are no modes to make it of."""

    posterior: Posterior
    model: Model
    path: Path
    parameters_file: Path | None = None
    modes: ModalData | None = None
    diagnosis: str | None = None
    findings: tuple[str, ...] = ()
    in_draws: bool = False
    changes: tuple[str, ...] = ()
    source: Mapping[str, Path] = field(default_factory=dict)
    problem: Problem | None = None

    def fitting_problem(self, left_out: list[str]) -> Problem | None:
        """The problem, where it is the one that was sampled, so that tolerances can be drawn of it."""
        if self.problem is None:
            left_out.append("tolerances in models: they are as stated; no modes lie in the run")
        elif self.problem.fingerprint() != self.posterior.fingerprint:
            left_out.append("tolerances in models: as stated, because posterior.nc was sampled of other modes "
                            "than nine.json (or modes.json) here, or with other settings than the defaults of "
                            "`sample`; parts of model factors are of that other problem")
        else:
            return self.problem
        return None

    @property
    def status(self) -> RunStatus:
        return RunStatus(converged=bool(self.posterior.converged), sampler=self.posterior.verdict,
                         diagnosis=self.diagnosis, findings=self.findings, changes=self.changes,
                         sets=self.posterior.sets, in_draws=self.in_draws)


@dataclass(frozen=True, kw_only=True)
class ExportSettings:
    """n_draw: draws; n_mode: Craig-Bampton modes; accept: export a run that is refused (`RunStatus.refused`)."""

    n_draw: int = 100
    n_mode: int = 10
    accept: bool = False
    seed: int = 1


def refuse_unfit(run: RunResults, out: Path, settings: ExportSettings, *, reliability: bool) -> None:
    """Raises InputError, before any work, for what would be refused after it."""
    posterior, model, status, n = run.posterior, run.model, run.status, settings.n_draw
    if status.refused and not settings.accept:
        raise InputError(str(out), f"this run is not fit to be exported: {status.refused}",
                         f"{status.remedy}; --accept exports it with that said in every file")
    if tuple(posterior.names) != tuple(model.parameters.names):
        raise InputError(str(run.path), f"has the parameters {', '.join(model.parameters.names)}, the posterior "
                         f"{', '.join(posterior.names)}", "sample again with this model")
    refuse_draws(posterior.draws, n)
    if reliability and n < FEWEST_DRAWS:
        raise InputError("draws", f"{n} shows no scatter of the posterior, which reliability is computed from",
                         f"ask for {FEWEST_DRAWS} at least, 100 as a rule, or leave the fatigue file out")
    refuse_filled(out)


def export_lifetime(
    run: RunResults, out: Path, settings: ExportSettings | None = None, *, fatigue: FatigueInput | None = None,
    progress: Progress = silent,
) -> Export:
    """Write draws.csv, joint.json, models/NNN, superelements/NNN (SubDyn models), modes.csv and manifest.json to `out`;
    with `fatigue` also fatigue.csv, model_factors.csv, reliability.csv and what belongs to them (turbines of
    model.toml).

    Raises InputError where the run is not fit to be exported and `accept` is not set, where posterior and model differ,
    or where what is read back is not what was written. Until all is written it lies in a folder beside `out`.
    """
    settings, out = settings or ExportSettings(), Path(out)
    refuse_unfit(run, out, settings, reliability=fatigue is not None)
    whole = None if fatigue is None else _fatigue_model(run, fatigue.file)
    with whole_folder(out) as folder:
        found = _write_export(run, folder, settings, (fatigue, whole), progress)
    return replace(found, folder=out)


def _write_export(
    run: RunResults, out: Path, settings: ExportSettings, fatigue: tuple[FatigueInput | None, FatigueModel | None],
    progress: Progress,
) -> Export:
    posterior, model, path, status = run.posterior, run.model, run.path, run.status
    rng = np.random.default_rng(settings.seed)
    draws = equal_draws(posterior.draws, settings.n_draw, rng)
    joint = joint_of(posterior.names, posterior.draws)
    files = _Files(out, status)
    units = {p.name: p.unit for p in model.parameters}
    files.table("draws.csv", [{"name": "draw", "unit": "-"}, *({"name": n, "unit": units[n]} for n in posterior.names)],
                [[k + 1, *row] for k, row in enumerate(draws.tolist())])
    _write_joint(files, joint, units, rng)
    left_out: list[str] = []
    drawn = DrawnModels.from_posterior(path, run.parameters_file, model, draws, run.fitting_problem(left_out), rng)
    _write_tolerances(files, drawn, run.problem)
    solved = write_models(files, drawn, left_out, progress)
    names = partial(mode_labels, families=_families(run.modes))
    labels = [names(drawn.model, one) for one in solved]
    damping = _modes(files, labels, solved, run.modes, left_out, rng)
    truncation = _superelements(files, drawn, settings.n_mode, left_out, progress)
    frequency_hz = [one.frequency_hz for one in solved]
    assessed = _fatigue(files, *fatigue, model, drawn, (labels, frequency_hz, partial(names, model)), damping, left_out,
                        settings.seed, progress)
    manifest = {
        "format": 1, "kind": "probupdate lifetime export", "version": __version__, "verdict": status.remark,
        "accepted": bool(status.refused), "converged": status.converged, "sampler": status.sampler,
        "diagnosis": status.diagnosis, "findings": list(status.findings), "seed": int(settings.seed),
        "draws": settings.n_draw,
        "model": model.name, "model_fingerprint": model.fingerprint(), "posterior_fingerprint": posterior.fingerprint,
        "superelement_truncation_first_pair": truncation, "fatigue": assessed, "left_out": left_out,
        "source": {name: _sha(p) for name, p in run.source.items() if p.is_file()}, "files": files.entries,
    }
    files.json("manifest.json", manifest, listed=False)
    _verify(out)
    return Export(folder=out, files={k: v["sha256"] for k, v in files.entries.items()}, draws=draws, status=status,
                  left_out=tuple(left_out), truncation=truncation)


def _fatigue_model(run: RunResults, fatigue: Path) -> FatigueModel:
    """Of all details. Raises InputError for those that are nowhere on the model, before anything is written."""
    from probupdate.lifetime.fatigue import fatigue_model_of

    refuse_without_members(run.path)
    return fatigue_model_of(run.path, fatigue, parameters=run.model.parameters, sensors=model_sensors(run.path) or None)


def _sha(path: Path) -> str:
    return hashlib.sha256(read_bytes(path)).hexdigest()


class _Files:
    """Files of an export with what the manifest says of each."""

    def __init__(self, folder: Path, status: RunStatus):
        self.folder, self.status, self.entries = folder, status, {}

    def add(self, path: Path, what: str, units: str, schema: Mapping | None = None, **more) -> None:
        entry = {"what": what, "units": units, "sha256": _sha(path), **more}
        if schema is not None:
            entry["schema"] = dict(schema)
        self.entries[path.relative_to(self.folder).as_posix()] = entry

    def table(self, name: str, columns: Sequence[Mapping], rows: Sequence[Sequence], what: str = "") -> None:
        """A CSV with the verdict in its first line, behind #; read back and compared."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow([c["name"] for c in columns])
        writer.writerows([["" if v is None else repr(v) if isinstance(v, float) else v for v in row] for row in rows])
        path = self.folder / name
        write_text(path, f"# {self.status.remark}\n{text.getvalue()}")
        held = read_table(path)
        for k, column in enumerate(columns):
            written = [row[k] for row in rows]
            if held[column["name"]] != written:
                raise InputError(str(path), f"column {column['name']} is not read back as it was written",
                                 "check the disk it was written to")
        types = {c["name"]: {"type": c.get("type", "number"), "description": f"unit {c['unit']}"} for c in columns}
        schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", "type": "array",
                  "items": {"type": "object", "properties": types, "required": list(types)}}
        self.add(path, what or f"{len(rows)} rows", "in the schema", schema, media_type=CSV)

    def json(self, name: str, content: Mapping, schema: Mapping | None = None, listed: bool = True) -> None:
        path = self.folder / name
        write_json(path, content)
        if read_json(path) != json.loads(json.dumps(content)):
            raise InputError(str(path), "is not read back as it was written", "check the disk it was written to")
        if listed:
            self.add(path, "one object", "in the schema", schema, media_type=JSON_TYPE)


def _write_tolerances(files: _Files, drawn: DrawnModels, problem: Problem | None) -> None:
    if problem is None or drawn.unknown is None:
        return
    columns = [{"name": "draw", "unit": "-"}, *({"name": s.name, "unit": s.unit} for s in problem.error_sources)]
    files.table("tolerances.csv", columns, [[k + 1, *row] for k, row in enumerate(drawn.differences.tolist())],
                what="tolerances given the data and the draw of draws.csv, as differences from what is stated; models, "
                     "superelements, modes.csv and fatigue.csv have those of the structure")


def _write_joint(files: _Files, joint: Joint, units: Mapping[str, str], rng) -> None:
    again = joint.sample(RESAMPLED, np.random.default_rng(rng.integers(2**63)))
    shift = float(np.max(np.abs(again.mean(axis=0) - joint.mean) / joint.std))
    # 6 standard errors of the resampled mean, and the grid's own error in the tails
    if not shift < 6 / np.sqrt(RESAMPLED) + 0.02:
        raise InputError("joint.json",
                         f"its marginals resampled miss the draws' mean by {shift:.2g} standard deviations",
                         "sample longer: the draws have too heavy tails for their number")
    content = {
        "verdict": files.status.remark, "kind": "nataf", "parameters": list(joint.names),
        "unit": [units[n] for n in joint.names], "mean": joint.mean.tolist(), "std": joint.std.tolist(),
        "level": joint.level.tolist(), "quantile": joint.quantile.T.tolist(),
        "normal_correlation": joint.correlation.tolist(), "rank_correlation": joint.rank_correlation.tolist(),
        "note": "theta_k = quantile_k(Phi(z_k)), linear between levels; z Gaussian with normal_correlation; parameters "
                "alone, without the tolerances of tolerances.csv",
    }
    numbers = {"type": "array", "items": {"type": "number"}}
    tables = {"type": "array", "items": numbers}
    schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema", "type": "object", "required": list(content),
        "properties": {"verdict": {"type": "string"}, "kind": {"const": "nataf"}, "note": {"type": "string"},
                       **{k: {"type": "array", "items": {"type": "string"}} for k in ("parameters", "unit")},
                       **{k: numbers for k in ("mean", "std", "level")},
                       **{k: tables for k in ("quantile", "normal_correlation", "rank_correlation")}},
    }
    files.json("joint.json", content, schema)


def refuse_without_members(path: Path) -> None:
    """Raises InputError for a model that has no members with groups to name: matrices, a SubDyn file alone."""
    if path.suffix != ".toml" or "matrices" in read_toml(path):
        raise InputError(str(path),
                         "has no members, and stresses are of members: matrices and a SubDyn file alone have none",
                         "`probupdate export` without --fatigue hands on what it has; for stresses describe the "
                         "structure as model.toml (`probupdate template`) or by SubDyn files with a TOML "
                         "(docs/formats/model.md), then update and sample that")


def _fatigue(files: _Files, given: FatigueInput | None, whole: FatigueModel | None, model: Model, drawn: DrawnModels,
             modes, damping: MeasuredDamping, left_out, seed: int, progress: Progress) -> dict | None:
    """fatigue.csv and what follows from it; a line of `left_out` where there is nothing to make it of. modes: of every
    draw labels and frequencies, and what names those of a solution."""
    if given is None or whole is None:
        left_out.append("fatigue.csv, reliability.csv: no fatigue.toml was given (--fatigue)")
        return None
    from probupdate.lifetime.fatigue_files import assess, frequency_factors, write_fatigue

    draws = drawn.theta[:, : drawn.n_own]
    found = assess(given, drawn.path, whole, drawn, damping.for_draws(len(draws)), seed=seed, progress=progress)
    labels, frequency_hz, named = modes
    first = model.solve(model.parameters.initial, frequency_hz[0].size)
    factors = frequency_factors(given, labels, frequency_hz, (named(first), first.frequency_hz), found.gains, named)
    assumed = found.model.conditions.damping.ratio
    left_out += damping.notes(assumed)
    left_out += [SLOW_CYCLES, *([given.left_out] if given.left_out else [])]
    for label, values in damping.ratio.items():
        factors.append({
            "quantity": "damping ratio", "of": label, "bias": float(np.exp(np.log(values).mean()) / assumed),
            "cov": float(np.hypot(damping.error[label], damping.scatter[label])), "measurement": damping.error[label],
            "tolerance": 0.0, "set_to_set": damping.scatter[label], "model_form": 0.0, "prior": 0.0})
    write_fatigue(files, found, draws, factors)
    left_out += found.left_out
    return dict(found.summary) | {"conditions": given.file.name, "conditions_sha256": _sha(given.file)}


def _families(data: ModalData | None) -> tuple[str, ...]:
    """Of modes' names, as those of the measured ones."""
    return NEUTRAL if data is not None and {*map(family, data.labels or ())} & {*NEUTRAL[:2]} else TURBINE


def _modes(files: _Files, labels, solved, data: ModalData | None, left_out, rng) -> MeasuredDamping:
    """modes.csv: frequencies of every draw with their labels; damping ratios as measured."""
    # what every draw has
    common = [label for label in labels[0] if all(label in own for own in labels)]
    damping, assessed, error, scatter = {}, {}, {}, {}
    by_state: dict[str, dict[str, np.ndarray] | None] = {"idling": None, "operating": None}
    if data is None or data.labels is None:
        left_out.append("damping in modes.csv: no modes.json with labels lies in the run")
    else:
        measured = [label for label in common if label in data.labels]
        for label in measured:
            found = measured_ratios(data, label)
            if len(found) < 2:
                continue
            assessed[label] = {"sets": len(found), "mean": float(found.mean()), "std": float(found.std(ddof=1))}
            # the scatter of sets is mostly identification's; their median is known to the standard error of its mean
            scatter[label] = float(np.log(found).std(ddof=1))
            error[label] = float(scatter[label] / np.sqrt(len(found)))
            damping[label] = draw_ratios(found, len(solved), rng)
        for kind, states in STATES_OF.items():
            own = {label: measured_ratios(data, label, states) for label in measured}
            drawn = {label: draw_ratios(found, len(solved), rng) for label, found in own.items() if len(found) > 1}
            by_state[kind] = drawn or None
    rows = [
        [k + 1, j + 1, label, float(solved[k].frequency_hz[j]), float(damping[label][k]) if label in damping else None]
        for k, own in enumerate(labels) for j, label in enumerate(own)
    ]
    columns = [{"name": "draw", "unit": "-"}, {"name": "mode", "unit": "-"},
               {"name": "label", "unit": "-", "type": "string"}, {"name": "frequency_hz", "unit": "Hz"},
               {"name": "damping_ratio", "unit": "-", "type": ["number", "null"]}]
    files.table("modes.csv", columns, rows)
    frequency = np.array([[one.frequency_hz[own.index(label)] for label in common]
                          for one, own in zip(solved, labels, strict=True)])
    both = np.column_stack([frequency, *damping.values()])
    names = [f"frequency_hz {label}" for label in common] + [f"damping_ratio {label}" for label in damping]
    numbers = {"type": "array", "items": {"type": "number"}}
    content = {
        "verdict": files.status.remark, "name": names, "mean": both.mean(axis=0).tolist(),
        "covariance": np.atleast_2d(np.cov(both, rowvar=False)).tolist() if len(both) > 1 else None,
        "damping_measured": assessed,
        "note": "frequencies of modes that every draw has; damping lognormal about the sets' geometric mean with its "
                "standard error, independent of the parameters; damping_measured.std is the scatter of single sets",
    }
    files.json("modes_covariance.json", content, {
        "$schema": "https://json-schema.org/draft/2020-12/schema", "type": "object", "required": list(content),
        "properties": {"name": {"type": "array", "items": {"type": "string"}}, "mean": numbers,
                       "covariance": {"type": ["array", "null"], "items": numbers}}})
    return MeasuredDamping(ratio=damping, error=error, scatter=scatter, **by_state)


def _superelements(
    files: _Files, drawn: DrawnModels, n_mode: int, left_out: list[str], progress: Progress
) -> float | None:
    """superelements/NNN.{guyan,cb}.{npz,dat} of the files that were written; returns the largest truncation error of
    the first two frequencies, None where none were made."""
    reduce = _reducer(drawn, files.folder / "models" / "001", left_out)
    if reduce is None:
        return None
    folder, count = files.folder / "superelements", len(drawn.theta)
    worst = 0.0
    for k in range(count):
        progress("writing superelements", k, count)
        whole, ends = reduce(files.folder / "models" / f"{k + 1:03d}", n_mode)
        folder.mkdir(exist_ok=True)
        for name, one in (("guyan", whole.guyan), ("cb", whole)):
            for written in write_superelement(one, folder, f"{k + 1:03d}.{name}", files.status.remark):
                files.add(written, f"{name} superelement of draw {k + 1} at {one.reference_m.tolist()} m, {ends}",
                          "N, m, rad, kg, s", checked_to=READ_BACK, frequency_hz=one.frequency_hz.tolist(),
                          truncation=one.truncation.tolist())
        worst = max(worst, float(whole.truncation[:2].max()))
    progress("writing superelements", count, count)
    return worst


def _reducer(
    drawn: DrawnModels, first: Path, left_out: list[str]
) -> Callable[[Path, int], tuple[Superelement, str]] | None:
    """What makes a superelement, and says where it ends, of a folder of models/, as the `first`, and a number of
    modes."""
    path, names = drawn.path, drawn.model.parameters.names
    if is_subdyn(path):
        own = named_file(path, read_toml(path)["subdyn"]["file"], "subdyn.file") if path.suffix == ".toml" else path
        if not read_subdyn(own, path.parent).interfaces:
            left_out.append(f"superelements: {own.name} has no interface joints, where they end; list them (NInterf)")
            return None

        def reduce_file(folder: Path, n_mode: int):
            file = read_subdyn(folder / path_in_draw(path), folder)
            return superelement(file, n_mode=n_mode), f"interface joints {[i.joint for i in file.interfaces]}"

        return reduce_file
    if path.suffix != ".toml" or "matrices" in read_toml(path):
        left_out.append("superelements: a model of matrices does not say at which node it would be cut")
        return None

    try:
        below = turbine_substructures(read_turbine(first / "model.toml"), names)
    except NoSubstructure as error:
        left_out.append(f"superelements: {error}")
        return None

    def reduce_turbine(folder: Path, n_mode: int):
        written = {p["name"]: float(p["initial"]) for p in read_toml(folder / "model.toml")["parameter"]}
        return reduce_model(below({name: written[name] for name in names}), n_mode=n_mode), "the tower's foot"

    return reduce_turbine


def _verify(out: Path) -> None:
    """The manifest's hashes against the disk."""
    manifest = read_json(out / "manifest.json")
    for name, entry in manifest["files"].items():
        if _sha(out / name) != entry["sha256"]:
            raise InputError(str(out / name), "is not what the manifest says", "export again")
