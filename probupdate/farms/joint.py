"""One inference for all turbines of a farm.toml with [joint], after the steps of each."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from probupdate import __version__, verbs
from probupdate.errors import InputError, ProbupdateError, plain
from probupdate.farms.description import Farm, JointTable, Month
from probupdate.farms.month import MonthState, chosen_sets, model_hash
from probupdate.io.files import write_table
from probupdate.modal.modes import ModalData
from probupdate.runtime.executors import Executor
from probupdate.runtime.progress import Progress
from probupdate.updating.discrepancy import LikelihoodSettings, weights_by_name
from probupdate.updating.joint_file import FarmJoint, read_joint
from probupdate.updating.joint_inference import JointSettings, TurbineSets
from probupdate.updating.joint_result import infer_farm
from probupdate.updating.joint_system import Roles
from probupdate.updating.outlier_sets import without_outliers
from probupdate.updating.problem import Weights, build_problem
from probupdate.updating.settings import CONSTANTS
from probupdate.updating.update_file import read_update
from probupdate.verbs.estimating import Case, compared_modes
from probupdate.verbs.models import ModelAt

RESULT, TABLE = "farm_joint.json", "farm_joint.csv"
MADE_OF = "made of"


@dataclass(frozen=True, kw_only=True)
class JointRun:
    """found: None where there is none, `failed` then says why; run: whether it was worked out now."""

    found: FarmJoint | None
    failed: str = ""
    run: bool = False


def _joint_table(farm: Farm) -> JointTable:
    """[joint] of a farm.toml that has one."""
    assert farm.joint is not None
    return farm.joint


def refuse_other_parameters(farm: Farm) -> None:
    """Raises InputError, before any work, where [joint] names what is not a parameter of a turbine's model, or turbines
    have different parameters."""
    first: tuple[str, tuple] | None = None
    asked = _joint_table(farm)
    for model, month in {month.model: month for month in farm.months}.items():
        parameters = verbs.open_model(model).parameters
        Roles(names=parameters.names, common=asked.common, varying=asked.varying)
        first = first or (month.turbine, tuple(parameters))
        if tuple(parameters) != first[1]:
            raise InputError(f"turbine {month.turbine}", f"its model has other parameters or priors than {first[0]}'s",
                             "give all turbines of [joint] the same parameters, or leave [joint] out")


def run_joint(
    farm: Farm, known: Mapping[Month, MonthState | None], out: Path, *, jobs: Executor, progress: Progress
) -> JointRun:
    """Of the months whose update is there; kept where nothing that it is made of has changed. Never raises for what is
    wrong with the turbines."""
    turbines: dict[str, list[Month]] = {}
    for month in farm.months:
        state = known[month]
        if state is not None and "update" in state.finished:
            turbines.setdefault(month.turbine, []).append(month)
    if len(turbines) < 2:
        return JointRun(found=None, failed="waits until two turbines have their update")
    try:
        made = _input_hash(farm, turbines, out)
        kept = _stored_result(out / RESULT, made)
        if kept is not None:
            return JointRun(found=kept)
        (out / RESULT).unlink(missing_ok=True)
        found = _infer_farm(farm, turbines, out, jobs, progress)
        found = replace(found, settings={**found.settings, MADE_OF: made})
        found.write(out / RESULT)
        write_table(out / TABLE, found.to_frame())
    except (ProbupdateError, OSError, np.linalg.LinAlgError) as error:
        return JointRun(found=None, failed=plain(str(error)), run=True)
    return JointRun(found=found, run=True)


def _stored_result(path: Path, made: str) -> FarmJoint | None:
    if not path.exists():
        return None
    try:
        found = read_joint(path)
    except InputError:
        # of another version, or damaged: made again
        return None
    return found if found.settings.get(MADE_OF) == made else None


def _input_hash(farm: Farm, turbines: Mapping[str, Sequence[Month]], out: Path) -> str:
    asked = asdict(_joint_table(farm)), asdict(farm.options.update)
    content = hashlib.sha256(repr((__version__, *asked, farm.seed)).encode())
    for months in turbines.values():
        for month in months:
            folder = out / month.folder
            content.update(repr((month.turbine, month.month, model_hash(verbs.model_path(month.model)))).encode())
            for path in (chosen_sets(folder), folder / "update.json"):
                content.update(hashlib.sha256(path.read_bytes()).digest())
    return content.hexdigest()


def _infer_farm(farm: Farm, turbines: Mapping[str, Sequence[Month]], out: Path, jobs: Executor, progress: Progress):
    likelihood = LikelihoodSettings(**asdict(farm.options.update))
    first = next(iter(turbines.values()))[0]
    # what the model misses is of the design: learnt once, from the first turbine's sets
    weights = Case.prepare(first.model, chosen_sets(out / first.folder), likelihood, progress=progress).weights
    tasks = [(k, month, out, likelihood, weights) for k, month in enumerate(m for ms in turbines.values() for m in ms)]
    sets: dict[int, tuple[TurbineSets, list[str]]] = {}
    for done, (k, one, notes) in enumerate(jobs.as_completed(month_sets, tasks, least=1), 1):
        sets[k] = one, notes
        progress("months of the joint inference", done, len(tasks))
    ordered = [sets[k] for k in range(len(tasks))]
    last, table = {one.name: one for one, _ in ordered}, _joint_table(farm)
    settings = JointSettings(spread=table.spread, odd_share=table.odd_share, odd_wide=table.odd_wide, seed=farm.seed)
    found = infer_farm(list(last.values()), common=table.common, varying=table.varying, settings=settings, jobs=jobs,
                       earlier=[one for one, _ in ordered if one is not last[one.name]], progress=progress)
    return replace(found, notes=(*found.notes, *(note for _, notes in ordered for note in notes)))


# models of this process by path and what the sets state of gravity
_OPENED: dict[tuple, ModelAt] = {}


def month_sets(
    number: int, month: Month, out: Path, likelihood: LikelihoodSettings, weights: Weights
) -> tuple[int, TurbineSets, list[str]]:
    """A month's selected sets as problems, about the estimate of its update, and sentences on sets that are left out.
    """
    path, where = chosen_sets(out / month.folder), f"{month.turbine}, {month.month}"
    theta = read_update(out / month.folder / "update.json").map_theta
    data, outliers = without_outliers(compared_modes(path, None))
    notes = [f"{where}: {text}" for text in outliers]
    model_at = _open_model(month.model, path, data)
    weights = _weights(likelihood, weights, data, theta, model_at)
    problems = tuple(_problems(model_at, data, weights, where, notes))
    if not problems:
        raise InputError(where, f"has no set that the joint inference can use ({'; '.join(notes[-3:])})",
                         "correct what is said, or take the month out of the folder")
    return number, TurbineSets(name=month.turbine, month=month.month, problems=problems, theta=theta), notes


def _open_model(model: str, path: Path, data: ModalData) -> ModelAt:
    key = model, repr(sorted(data.felt.items()))
    if key not in _OPENED:
        _OPENED[key] = ModelAt(model, None, str(path), data.felt)
    return _OPENED[key]


def _weights(
    likelihood: LikelihoodSettings, weights: Weights, data: ModalData, theta: np.ndarray, model_at: ModelAt
) -> Weights:
    """As of the first turbine, the sources of error linear about this one's estimate; numbers of its own modes where
    the weights state some."""
    if weights.frequency_cov:
        weights = weights_by_name(likelihood.weights, data, frequencies=likelihood.frequencies,
                                  shapes=likelihood.shapes,
                                  tolerances=likelihood.tolerances)
    if weights.at is None:
        return weights
    parameters = model_at(data.set()).parameters
    grid = CONSTANTS.place * parameters.std
    place = np.clip(np.round(theta / grid) * grid, parameters.lower, parameters.upper)
    return replace(weights, at=tuple(float(x) for x in place))


def _problems(model_at: ModelAt, data: ModalData, weights: Weights, name: str, notes: list[str]):
    reference = build_problem(model_at(data.set()), data, weights=weights)
    clusters = [group.measured for group in reference.matching.groups]
    for modal_set in data.sets:
        try:
            yield build_problem(model_at(modal_set), data, set_id=modal_set.id, weights=weights, clusters=clusters)
        except ProbupdateError as error:
            notes.append(f"{name}: set {modal_set.id} is left out: {error}")
