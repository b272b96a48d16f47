"""Steps from results to their readers: diagnose, export, report, figures."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from probupdate.campaign.reading import read_campaign
from probupdate.campaign.scada import StateRule, row_states
from probupdate.campaign.usable import left_out_notes
from probupdate.errors import InputError, names_files
from probupdate.io.files import sha256
from probupdate.io.result_table import files_table
from probupdate.modal.modes import ModalData, read_modes
from probupdate.reporting import report as write_report
from probupdate.reporting.run_files import run_places
from probupdate.runtime.executors import Executor
from probupdate.runtime.progress import Progress, resumed_progress, silent
from probupdate.structure.load import load_model, model_files
from probupdate.structure.subdyn_model import is_subdyn
from probupdate.structure.tangent import Tangent, write_tangent
from probupdate.updating.discrepancy import LikelihoodSettings
from probupdate.updating.joint_set import joint_set
from probupdate.updating.posterior_file import Posterior, read_posterior
from probupdate.updating.problem import Problem, Weights, build_problem
from probupdate.verbs.estimating import Case, compared_modes, refuse_other_kinds
from probupdate.verbs.finished_run import finished_run
from probupdate.verbs.models import GivenModel, ModelAt, model_path, parts_elsewhere

if TYPE_CHECKING:
    import pandas as pd

    from probupdate.diagnosis.prepare import Prepared
    from probupdate.diagnosis.results import Diagnosis
    from probupdate.lifetime.export import Export
    from probupdate.model.interface import Model


@names_files("modes")
def diagnose(
    model: GivenModel | Prepared | None,
    modes: str | Path | ModalData,
    *,
    campaign: str | Path | None = None,
    parameters: str | Path | None = None,
    without: Sequence[str] | None = None,
    shapes: str = "all",
    frequency_std: float | None = None,
    shape_std: float | None = None,
    seed: int = 1,
    progress: Progress = silent,
    **options,
) -> Diagnosis:
    """What the simulation, or the measurement, gets wrong: verdict, causes with place and size, what would not be seen.

    `model` None: measurement and environmental and operational conditions only; of a function its tangent at the
    initial parameters, written beside `out`, with these as causes. `campaign` says where the sensors are, and its raw
    records are tested too. `without`: channels that the modes have and that are not to be looked at, as a diagnosis
    has found that they are wrong. `shapes` "none": frequencies alone. `frequency_std`, `shape_std`:
    standard deviations of what states none, as shares of each frequency and of a shape's largest component; from eight
    sets on their own scatter says it. `options`: `only` (labels of the modes to take), `sensors`, `groups`, `effects`,
    `discrepancy` of `diagnosis.run.ModelSource` (own effects, groups of parameters, the model's error), and those of
    `diagnosis.run.diagnose_files`.
    """
    from probupdate.diagnosis.blocks import gather, of_model
    from probupdate.diagnosis.prepare import Prepared
    from probupdate.diagnosis.run import ModelSource, diagnose_files

    if model is not None and not isinstance(model, Prepared):
        refuse_other_kinds(model, modes)
    data = modes if isinstance(modes, ModalData) else read_modes(modes)
    records = read_campaign(campaign) if campaign else None
    only = options.pop("only", None)
    data = (data.of_labels(only) if only else data).without_channels(without or ())
    # modes that were identified before campaign.toml left them out still have them
    unused = [] if records is None else [c for c in records.left_out if c in data.channels]
    data, notes = data.without_channels(unused), left_out_notes(unused)
    data = (data.frequencies_alone() if shapes == "none" else data).with_std(frequency_std, shape_std)
    # before a minute of preparation is spent on them
    gather(data if model is None else of_model(data)[0], "modes" if isinstance(modes, ModalData) else str(modes))
    path = model_path(model) if isinstance(model, str | Path) else model
    if path is not None and not isinstance(path, Path | Prepared):
        with _write_tangent(path, options.get("out")) as tangent:
            found = diagnose(tangent.path, data, campaign=campaign, seed=seed, progress=progress, **options)
        return replace(found, notes=(tangent.note, *notes, *found.notes), inputs=_inputs(None, None, modes))
    of_model = {key: options.pop(key) for key in ("sensors", "groups", "effects", "discrepancy") if key in options}
    source = ModelSource(model=path, parameters=parameters, **of_model)
    # before the work: a file may be written again meanwhile
    inputs = _inputs(path.path if isinstance(path, Prepared) else path, parameters, modes)
    found = diagnose_files(source, data, campaign=records, seed=seed, progress=resumed_progress(progress), **options)
    return replace(found, notes=(*notes, *found.notes), inputs=inputs)


@contextmanager
def _write_tangent(model: Model, out: str | Path | None) -> Iterator[Tangent]:
    """A function's matrices beside diagnosis.json, which extended models name, or for the time of the run."""
    if out is not None:
        yield write_tangent(model, Path(out).with_name(f"{Path(out).stem}.tangent.npz"))
        return
    with tempfile.TemporaryDirectory() as folder:
        yield write_tangent(model, Path(folder) / "tangent.npz")


def _inputs(model: object, parameters: str | Path | None, modes: object) -> dict[str, dict[str, str]]:
    """Of model and modes the files, name -> SHA-256; none of a value that was given in their place."""
    return {"model": {p.name: sha256(p) for p in model_files(model, parameters)} if isinstance(model, Path) else {},
            "modes": {Path(modes).name: sha256(modes)} if isinstance(modes, str | Path) else {}}


@names_files("run", "run")
def export(
    run: str | Path, out: str | Path, *, to: str = "lifetime", draws: int = 100, superelement_modes: int = 10,
    accept: bool = False, seed: int = 1, fatigue: str | Path | None = None, progress: Progress = silent,
    **elsewhere: str | Path | None,
) -> Export:
    """What a lifetime-extension analysis takes of a run directory: draws, joint distribution, models, superelements and
    modes, each read back and checked. A run that did not converge, whose diagnosis is unexplained, or whose structure
    changed within the records, needs `accept`.

    elsewhere: `model`, `parameters`, where these lie, if not in the directory, as of `report`.
    fatigue: a fatigue.toml with sea and wind states, details, S-N curves and uncertainties; then damage-equivalent
    stress ranges of every hot spot and draw, model factors and reliability over the years are written too."""
    from probupdate.lifetime.conditions import read_conditions
    from probupdate.lifetime.export import (
        ExportSettings,
        RunResults,
        export_lifetime,
        refuse_unfit,
        refuse_without_members,
    )

    if to != "lifetime":
        raise InputError("to", f"'{to}' is unknown", "choose lifetime")
    folder, given = Path(run), parts_elsewhere(**elsewhere)
    # before minutes of work are spent on the rest, or on a posterior
    if fatigue is not None:
        read_conditions(fatigue)
        if "model" in (there := run_places(folder, given)):
            refuse_without_members(there["model"])
    finished = finished_run(folder, given)
    places, found, parameters = finished.places, finished.diagnosis, finished.places.get("parameters")
    causes = () if found is None else tuple(f"{f['cause']} {f['location']}".strip() for f in found["findings"])
    verdict = None if found is None else found["verdict"]
    settings = ExportSettings(n_draw=draws, n_mode=superelement_modes, accept=accept, seed=seed)
    results = RunResults(
        posterior=finished.posterior, model=load_model(places["model"], parameters=parameters),
        path=places["model"], parameters_file=parameters,
        modes=read_modes(places["modes.json"]) if "modes.json" in places else None, diagnosis=verdict, findings=causes,
        in_draws=finished.included, changes=finished.changes, source=places)
    refuse_unfit(results, Path(out), settings, reliability=fatigue is not None)
    results = replace(results, problem=_sampled_problem(folder, places, found, results.posterior, progress))
    return export_lifetime(
        results, Path(out), settings, progress=progress,
        fatigue=None if fatigue is None else _fatigue_input(folder, places, Path(fatigue), found, results.problem,
                                                               results.posterior))


def _sampled_problem(
    folder: Path, places: Mapping[str, Path], diagnosis: Mapping | None, posterior: Posterior, progress: Progress
) -> Problem | None:
    """With the weights that posterior.nc states, else those that `sample` has by default, of the set that was sampled:
    the diagnosis's mean of the blocks in which its findings act, that of nine.json, or of modes.json; None where none
    of them is there."""
    likelihood = LikelihoodSettings()
    mean = (((diagnosis or {}).get("extension") or {}).get("files") or {}).get("mean")
    given = [folder / mean] if mean and (folder / mean).is_file() else []
    own = [places[name] for name in ("nine.json", "modes.json") if name in places]
    covariance, stated = likelihood.joint_covariance, posterior.record.get("likelihood")
    weights = Weights.from_table(stated) if stated else None
    if weights is not None:
        covariance = weights.covariance

    def choices_of(path: Path) -> tuple[tuple[str, ...] | None, ...]:
        """The modes of this file that may have been named: those that were sampled, where it has them, or none, of
        which some, as a torsion that nothing shows, may be without a number."""
        named = set(posterior.mode_labels) <= set(read_modes(path).labels)
        return (posterior.mode_labels, None) if named else (None,)

    def is_sampled(path: Path, only: tuple[str, ...] | None) -> bool:
        one = joint_set(compared_modes(path, None, False, only), covariance=covariance)
        return one.data.set().id == posterior.record.get("set_id")

    problem = None
    # the selected sets and all sets may have one id
    choices = [(path, only) for path in (*given, *own) for only in choices_of(path) if is_sampled(path, only)]
    for modes, only in choices or [(path, choices_of(path)[0]) for path in own[:1]]:
        if weights is None:
            case = Case.prepare(places["model"], modes, replace(likelihood, modes=only),
                                parameters=places.get("parameters"), progress=progress)
        else:
            data = compared_modes(modes, None, False, only)
            case = Case(data=data, joint=joint_set(data, covariance=covariance), weights=weights,
                        model_at=ModelAt(places["model"], places.get("parameters"), str(modes), data.felt))
        problem = build_problem(case.model, case.joint.data, weights=case.weights)
        if problem.fingerprint() == posterior.fingerprint:
            break
    return problem


def _fatigue_input(folder: Path, places, fatigue: Path, diagnosis, problem: Problem | None, posterior: Posterior):
    """The one model's problem at its maximum; set-wise updates of update.json; and the diagnosis's extended model with
    its draws, where they are there."""
    from probupdate.lifetime.fatigue_files import FatigueInput, NamedCause
    from probupdate.structure.description_file import read_description
    from probupdate.updating.laplace import maximum_a_posteriori
    from probupdate.updating.runs import find_maximum
    from probupdate.updating.update_file import read_update

    laplace = None
    if problem is not None and problem.fingerprint() == posterior.fingerprint and "map" in posterior.record:
        # the highest of all that the sampler's starts found
        laplace = maximum_a_posteriori(problem, [np.array(posterior.record["map"])])
    elif problem is not None:
        at = problem.weights.at
        laplace = find_maximum(problem, [problem.model.parameters.initial if at is None else np.array(at)])
    updates = read_update(places["update.json"]).sets if "update.json" in places else None
    named, left_out = None, ""
    extended = diagnosis and diagnosis.get("extended_model")
    if extended and (folder / extended).is_file() and not is_subdyn(places["model"]):
        path, drawn = folder / extended, folder / "diagnosis.posterior.nc"
        effects = {p.name: p.description for p in read_description(path).effects}
        own = {p.name for p in read_description(places["model"]).effects}
        causes = tuple((n, words or n) for n, words in effects.items() if n not in own)
        if drawn.is_file() and causes:
            posterior = read_posterior(drawn)
            named = NamedCause(path=path, names=tuple(posterior.names), draws=posterior.draws, causes=causes)
        elif causes:
            left_out = (f"{', '.join(words for _, words in causes)}: no part of fatigue, as {drawn.name} is not in the "
                        "run; run the `sample` that diagnosis.json states")
    return FatigueInput(file=fatigue, problem=problem, laplace=laplace, named=named, left_out=left_out,
                        set_updates=None if updates is None else np.asarray(updates.theta_map))


@dataclass(frozen=True)
class Written:
    """A file that a step wrote."""

    path: Path

    def __str__(self) -> str:
        return str(self.path)

    @property
    def summary(self) -> str:
        return f"wrote {self.path}"

    def to_frame(self) -> pd.DataFrame:
        """One row."""
        return files_table(page=(self.path,))


def report(
    run: str | Path, out: str | Path, *, campaign: str | Path | None = None, model: str | Path | None = None,
    parameters: str | Path | None = None, jobs: int | Executor = 1, progress: Progress = silent,
) -> Written:
    """One self-contained page of a run directory; campaign, model, parameters: where these lie, if not in it. jobs:
    processes, or an executor, for its sections; the page is the same on any."""
    return Written(write_report(run, out, campaign=campaign, model=None if model is None else model_path(model),
                                parameters=parameters, jobs=jobs, progress=progress))


@dataclass(frozen=True)
class Figures:
    """Files of a folder of figures."""

    files: tuple[Path, ...]

    def to_frame(self) -> pd.DataFrame:
        """A row a file."""
        return files_table(figure=self.files[:-1], legend=self.files[-1:])

    @property
    def summary(self) -> str:
        tables = sum(path.suffix == ".csv" for path in self.files)
        drawn = f"{len(self.files) - 1 - tables} figures" + (f" and {tables} tables" if tables else "")
        return f"{drawn} in {self.files[0].parent}, what they show in {self.files[-1].name}"


@names_files("modes")
def figures(
    modes: str | Path, out: str | Path, *, campaign: str | Path | None = None, block: str | None = None,
    kind: str = "png", progress: Progress = silent,
) -> Figures:
    """Figures of a run's report as files, its tables as CSV, where `modes` is the directory of a run; else of an
    identification: Figs. 4-7, stabilisation of one block, maps of MAC and MPC, Argand plots,
    frequency against conditions. Poles and blocks are taken from beside modes.json, wind and rotor from the campaign.
    """
    from probupdate.reporting.identification_pictures import write_figures
    from probupdate.reporting.run_files import POLE_COLUMNS, read_table

    modes = Path(modes)
    if modes.is_dir():
        from probupdate.reporting.report_figures import write_report_figures
        from probupdate.reporting.run_files import read_run

        given = {} if campaign is None else {"campaign": Path(campaign)}
        return Figures(files=tuple(write_report_figures(read_run(modes, progress, given), out, kind, progress)))
    table, scada = modes.with_name(f"{modes.stem}.poles.csv"), None
    if campaign is not None and (opened := read_campaign(campaign)).scada is not None:
        state = row_states(opened.scada, StateRule(rated_power_kw=opened.rated_power_kw))
        scada = opened.scada.tz_localize(None).reset_index().assign(state=state)
    return Figures(files=tuple(write_figures(
        modes, out, modes=read_modes(modes), scada=scada, block_id=block, kind=kind,
        poles=read_table(table, POLE_COLUMNS, time="time") if table.exists() else None)))
