"""Steps from modal sets to parameters: update, sample, compare, sets, inform."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from probupdate.errors import ConvergenceError, InputError, names_files
from probupdate.io.outputs import sole_writer
from probupdate.modal.joined_modes import separate_modes
from probupdate.modal.modes import ModalData, read_modes
from probupdate.runtime.executors import Executor
from probupdate.runtime.progress import Progress, silent
from probupdate.runtime.settings import refuse_other_type
from probupdate.structure.load import load_model
from probupdate.updating.comparison import Comparison
from probupdate.updating.comparison import compare as compare_results
from probupdate.updating.discrepancy import LikelihoodSettings
from probupdate.updating.joint_set import JointSet, joint_set, single_set
from probupdate.updating.posterior_file import ENDS, Posterior, read_posterior, write_posterior
from probupdate.updating.problem import Weights, build_problem
from probupdate.updating.set_matching import suspected_channels, with_mistake
from probupdate.updating.settings import CONSTANTS, SamplerSettings, UpdateSettings
from probupdate.updating.update_file import SETS, STEP, UNLIKE, UpdateRecord, read_update
from probupdate.verbs.models import GivenModel, ModelAt, model_path, open_model, refuse_no_model, refuse_other_value

if TYPE_CHECKING:
    from probupdate.model.interface import Model
    from probupdate.updating.information import Information
    from probupdate.updating.set_views_file import SetViews

# what the steps below are given where nothing is stated
COMPARED, UPDATE, SAMPLER = LikelihoodSettings(), UpdateSettings(), SamplerSettings()
# where `inform` takes slopes
PLACES = {"initial": "the initial parameters", "map": "the maximum of the posterior"}


def refuse_other_kinds(model: object, modes: object) -> None:
    """Raises InputError where model or modes stand in the other's place, or are neither a path nor what they should
    be."""
    refuse_no_model(model)
    if hasattr(modes, "solve"):
        raise InputError("modes", "a model was given in the modes' place", "give the model first, then the modes")
    if not isinstance(modes, str | Path | ModalData):
        raise InputError("modes", f"a {type(modes).__name__} is not modal data", "give a path or ModalData")


def chosen_modes(
    modes: str | Path | ModalData, only: Sequence[str | int] | None, every_mode: bool = False
) -> ModalData:
    """Of all sets the modes that are compared with a model: those of these labels where some are chosen."""
    whole = modes if isinstance(modes, ModalData) else read_modes(modes)
    return whole.of_labels(only) if only else whole.compared(every_mode, sure=True)


def compared_modes(
    modes: str | Path | ModalData, set_id: str | None = None, every_mode: bool = False,
    only: Sequence[str | int] | None = None,
) -> ModalData:
    """Sets of which at least one of the modes that are compared was identified, as the others cannot be updated."""
    return _separated_modes(modes, set_id, every_mode, only)[0]


def _separated_modes(
    modes: str | Path | ModalData, set_id: str | None, every_mode: bool, only: Sequence[str | int] | None
) -> tuple[ModalData, list[str]]:
    """The same, and what to say of modes that stood in one column."""
    data, notes = separate_modes(chosen_modes(modes, only, every_mode))
    kept = tuple(s for s in data.sets if np.any(s.measured))
    if set_id is not None and not np.any(data.set(set_id).measured):
        raise InputError(f"set {set_id}", "has no identified mode", "choose another set, or check its identification")
    if not kept:
        where = "modes" if isinstance(modes, ModalData) else str(modes)
        raise InputError(where, "no set has an identified mode", "check the identification")
    reference = data.reference_set if any(s.id == data.reference_set for s in kept) else None
    return replace(data, sets=kept, reference_set=reference), notes


def _refuse_mistaken_channels(error: ConvergenceError, model: Model, data: ModalData) -> None:
    """Raises InputError where an exchange or reversal of channels explains that no maximum was reached."""
    places = [model.parameters.initial, *([error.estimate] if isinstance(error.estimate, np.ndarray) else [])]
    likely = suspected_channels(model, data, places)
    if likely is not None:
        raise with_mistake(InputError("modes", "no maximum of the posterior was reached", likely.remedy),
                           likely) from None


@dataclass(frozen=True, eq=False, kw_only=True)
class Case:
    """What every estimator is given: the sets that are compared, the one that an update is of (all comparable ones
    together where no set is chosen), the model as it stood while each was measured, and one likelihood."""

    data: ModalData
    joint: JointSet
    model_at: ModelAt
    weights: Weights

    @classmethod
    def prepare(
        cls, model: GivenModel, modes: str | Path | ModalData, likelihood: LikelihoodSettings, *,
        parameters: str | Path | None = None, set_id: str | None = None, every_mode: bool = False,
        progress: Progress = silent,
    ) -> Case:
        refuse_other_kinds(model, modes)
        refuse_other_value("likelihood", likelihood, LikelihoodSettings)
        data, separated = _separated_modes(modes, set_id, every_mode, likelihood.modes)
        model_at = ModelAt(model, parameters, str(modes), data.felt, likelihood.fix,
                           alternatives=likelihood.alternatives)

        def joined(data: ModalData) -> JointSet:
            return (joint_set(data, covariance=likelihood.joint_covariance) if set_id is None
                    else single_set(data, set_id))

        def weighed(data: ModalData) -> Case:
            joint = joined(data)
            joint = replace(joint, notes=(*separated, *joint.notes))
            weights = likelihood.stated_for(model_at(joint.data.set()), joint.data, progress=progress)
            return cls(data=data, joint=joint, model_at=model_at, weights=weights)

        def settled(data: ModalData) -> Case:
            try:
                return weighed(data)
            except ConvergenceError as error:
                # as a mode of uncertain pairing is, where most modes stay
                kept = [j for j in range(data.n_mode) if j not in error.modes]
                if not error.modes or 2 * len(kept) <= data.n_mode:
                    one = joined(data).data
                    _refuse_mistaken_channels(error, model_at(one.set()), one)
                    raise
                case, names = weighed(data.of_modes(kept)), data.labels or [f"mode {j + 1}" for j in range(data.n_mode)]
                words = (f"{', '.join(names[j] for j in error.modes)} left out: its counterpart among the model's "
                         "modes changes with the parameters, and with it no maximum of the posterior was reached")
                return replace(case, joint=replace(case.joint, notes=(*case.joint.notes, words)))

        named = [j for j, label in enumerate(data.labels) if not label.isdigit()]
        unasked = not every_mode and not likelihood.modes and 0 < len(named) < data.n_mode and any(
            r.match for r in data.records)
        try:
            return settled(data)
        except InputError as error:
            # nobody asked for the numbered modes
            if not unasked:
                raise
            case = settled(data.of_modes(named))
            numbers = ", ".join(label for label in data.labels if label.isdigit())
            words = f"{numbers} left out, though alike to modes of the model: with them {error.problem}"
            return replace(case, joint=replace(case.joint, notes=(*case.joint.notes, words)))

    @property
    def model(self) -> Model:
        return self.model_at(self.joint.data.set())

    @property
    def setting(self) -> dict[str, str]:
        """What to say of the model beside a result."""
        said = {SETS: "; ".join(self.joint.notes)} if self.joint.notes else {}
        return said | self.model_at.setting(self.joint.data.set(), self.data.channels)

    def step(self, used: Sequence[str]) -> dict[str, str]:
        """What to say where the frequencies of the modes used step between the sets that the mean is of."""
        from probupdate.updating.outlier_sets import step_between_sets

        sets = tuple(s for s in self.data.sets if s.id in self.joint.ids)
        words = step_between_sets(replace(self.data, sets=sets, reference_set=None), used) if len(sets) > 1 else ""
        return {STEP: words} if words else {}


def unmatched_sentences(
    modes: str | Path | ModalData, every_mode: bool = False, only: Sequence[str | int] | None = None
) -> dict[str, tuple[str, ...]]:
    """What the identification said of modes and model that do not match: sentences on measured modes that are 'left
    out', and on those that are 'taken' although they look unlike the model's."""
    from probupdate.identification.counterparts import counterpart_words, further_modes_left_out

    whole = modes if isinstance(modes, ModalData) else read_modes(modes)
    used = chosen_modes(whole, only, every_mode).labels
    left, taken = [], []
    for one in whole.records:
        if only and one.label not in only:
            continue
        place = f"{one.label} ({one.frequency_hz:.4g} Hz, in {one.found} of {one.blocks} blocks)"
        if not one.found or not one.match:
            continue
        if one.label in used and one.match == "unlike":
            taken.append(f"{place}: MAC {one.mac:.2f} with the model's {one.model_label}, which it looks unlike; a "
                         "parameter that bends that shape may be missing (probupdate diagnose)")
        elif one.label not in used and one.match == "none":
            left.append(f"{place} {counterpart_words(one)}")
    left += further_modes_left_out([one for one in whole.records if one.found and one.match not in ("", "none")
                                    and one.label not in used and not (only and one.label not in only)])
    if missed := [one for one in whole.model_only if one.expected]:
        listed = ", ".join(f"{one.label} ({one.frequency_hz:.4g} Hz)" for one in missed)
        left.append(f"the model's {listed}: in no block, although the excitation should show "
                    f"{'it' if len(missed) == 1 else 'them'}")
    return {"left out": tuple(left), "taken": tuple(taken)}


def uncompared_hz(modes: str | Path | ModalData, data: ModalData) -> list[float]:
    """Frequencies of modes that were identified and are not among those that are compared."""
    whole = modes if isinstance(modes, ModalData) else read_modes(modes)
    found = np.array([s.frequency_hz for s in whole.sets])
    other = [j for j, label in enumerate(whole.labels) if label not in data.labels and np.isfinite(found[:, j]).any()]
    return [float(np.nanmedian(found[:, j])) for j in other]


@names_files("modes")
def update(
    model: GivenModel,
    modes: str | Path | ModalData,
    *,
    parameters: str | Path | None = None,
    set_id: str | None = None,
    likelihood: LikelihoodSettings = COMPARED,
    every_mode: bool = False,
    settings: UpdateSettings = UPDATE,
    jobs: int | Executor = 1,
    progress: Progress = silent,
) -> UpdateRecord:
    """The sensitivity-based Tikhonov update (Eq. 4-7) in both readings, the MAP, and the same for every set.

    likelihood: which responses are compared and what is stated of their error. settings: alpha, method and iterations
    of Eq. 7. every_mode: also modes that identification numbered, where they are alike to one of the model's. jobs:
    processes, or an executor, for the updates of the sets; the numbers are the same on any.
    """
    from probupdate.updating.runs import deterministic_update

    refuse_other_value("settings", settings, UpdateSettings)
    case = Case.prepare(model, modes, likelihood, parameters=parameters, set_id=set_id, every_mode=every_mode,
                   progress=progress)
    record = deterministic_update(case.model, case.joint.data, weights=case.weights, settings=settings,
                                  every=case.data, seen_hz=uncompared_hz(modes, case.data), model_at=case.model_at,
                                  jobs=jobs, progress=progress)
    said = unmatched_sentences(modes, every_mode, likelihood.modes)
    used = [label for label, number in zip(record.labels, record.computed_mode, strict=True) if number > 0]
    kept = {**record.settings, **case.setting, **case.step(used)}
    # of a mode that the pairing left out in every set nothing was taken
    if taken := [text for text in said["taken"] if text.startswith(tuple(f"{label} (" for label in used))]:
        kept |= {UNLIKE: "; ".join(taken)}
    return replace(record, settings=kept, left_out=(*record.left_out, *said["left out"]))


@names_files("modes")
def sample(
    model: GivenModel,
    modes: str | Path | ModalData,
    out: str | Path,
    *,
    parameters: str | Path | None = None,
    set_id: str | None = None,
    likelihood: LikelihoodSettings = COMPARED,
    every_mode: bool = False,
    settings: SamplerSettings = SAMPLER,
    jobs: int | Executor = 1,
    progress: Progress = silent,
) -> Posterior:
    """Sample the posterior of the same problem into `out`; the chain is kept beside it (`<out>.chain/`) and goes on
    where it stopped. A second run into the same `out` at the same time is refused. jobs: processes, or an executor, for
    the `ensembles`; the numbers are the same on any."""
    from probupdate.updating.runs import sample_posterior

    refuse_other_value("settings", settings, SamplerSettings)
    out = Path(out)
    chain = out.with_name(out.name + ".chain")
    case = Case.prepare(model, modes, likelihood, parameters=parameters, set_id=set_id, every_mode=every_mode,
                   progress=progress)
    with sole_writer(chain):
        posterior = sample_posterior(case.model, case.joint.data, chain, weights=case.weights,
                                     settings=settings, jobs=jobs, progress=progress)
        held = [f"held: {case.setting['held']}"] if likelihood.fix else []
        step = case.step(posterior.mode_labels)
        states = [f"TWO STATES: {words}" for words in step.values()]
        statements = [*states, *case.joint.notes, *held, *posterior.record.get("statements", ())]
        ends = {ENDS: [case.joint.ids[0], case.joint.ids[-1]]} if len(case.joint.ids) > 1 else {}
        posterior = replace(posterior, record={**posterior.record, **case.setting, **step, **ends,
                                               "statements": statements})
        write_posterior(posterior, out)
    return posterior


@names_files("update")
def compare(
    update: str | Path | UpdateRecord,
    posterior: str | Path | Posterior,
    *,
    model: GivenModel | None = None,
    parameters: str | Path | None = None,
) -> Comparison:
    """Where update and posterior part, and why. With a model, its derived quantities (pile-head stiffness) too."""
    record = update if isinstance(update, UpdateRecord) else read_update(update)
    drawn = posterior if isinstance(posterior, Posterior) else read_posterior(posterior)
    if model is None:
        return compare_results(record, drawn)
    opened = open_model(model, record.parameters if record.parameters.held else parameters)
    if opened.parameters.names != record.parameters.names:
        raise InputError(opened.name, "has other parameters than the update", "give the model that was updated")
    return compare_results(record, drawn, getattr(opened, "derived", None))


@names_files("modes")
def sets(
    model: GivenModel,
    modes: str | Path | ModalData,
    *,
    parameters: str | Path | None = None,
    likelihood: LikelihoodSettings = COMPARED,
    common: Sequence[str] = (),
    correlated: bool = False,
    spread: float = CONSTANTS.population_spread,
    seed: int = 1,
    progress: Progress = silent,
) -> SetViews:
    """All sets of the file in four views side by side: scatter of their updates, posteriors pooled, one posterior for
    all, and a population with its scatter between sets; with scores of sets left out. `common`: parameters that are one
    number in all sets. See `updating.set_views`."""
    from probupdate.updating.outlier_sets import without_outliers
    from probupdate.updating.set_views import view_sets

    refuse_other_kinds(model, modes)
    refuse_other_value("likelihood", likelihood, LikelihoodSettings)
    for name, value, kind, default, effect in (
            ("common", common, tuple[str, ...], (), "names of parameters that are one number in all sets"),
            ("correlated", correlated, bool, False, "parameters vary together between sets"),
            ("spread", spread, float, CONSTANTS.population_spread, "scale of tau's hyper-prior, in prior std")):
        refuse_other_type(name, value, kind, default, effect)
    SamplerSettings(seed=seed)
    if likelihood.baseline:
        raise InputError("baseline", "is of one state, and `sets` learns the model's error from all sets",
                         "give it to update or sample")
    whole = compared_modes(modes, only=likelihood.modes)
    # what all sets are weighed by is not learnt from one that is none of them
    kept, _ = without_outliers(whole)
    case = Case.prepare(model, modes, likelihood, parameters=parameters, set_id=kept.set().id, progress=progress)
    return view_sets(case.model, case.data, weights=case.weights, model_at=case.model_at, common=tuple(common),
                     correlated=correlated, spread=spread, seed=seed, progress=progress)


@names_files("modes")
def inform(
    model: GivenModel,
    modes: str | Path | ModalData,
    *,
    parameters: str | Path | None = None,
    set_id: str | None = None,
    likelihood: LikelihoodSettings = COMPARED,
    every: bool = False,
    at: str = "initial",
    posterior: str | Path | Posterior | None = None,
    seed: int = 1,
    progress: Progress = silent,
) -> Information:
    """Which parameters the data inform and how much, which compensate one another, whether the prior expected the data.

    `every`: all rows of a model.toml, those with update = false too. `posterior`: adds what was sampled. `at`: where
    slopes are taken, 'initial' (before anything is measured) or 'map' (the maximum of this set's posterior)."""
    from probupdate.structure.parameter_table import every_parameter
    from probupdate.updating.information import information
    from probupdate.updating.predictive import predictive_check
    from probupdate.updating.runs import find_maximum

    if at not in PLACES:
        raise InputError("at", f"'{at}' is unknown", f"choose from {', '.join(PLACES)}")
    case = Case.prepare(model, modes, likelihood, parameters=parameters, set_id=set_id, progress=progress)
    joint = case.joint.data
    problem = build_problem(case.model, joint, weights=case.weights)
    maximum = find_maximum(problem, [problem.parameters.initial])
    check = predictive_check(problem, maximum, seed=seed)
    found = dict(zip(problem.parameters.names, maximum.theta, strict=True))
    if every:
        if not isinstance(model, str | Path) or not case.model_at.turns:
            raise InputError(str(model), "has no parameters beside the updated ones", "leave --every out")
        angle = case.model_at.angle_deg(joint.set())
        every_row = every_parameter(model_path(model)).hold_parameters(likelihood.fix or {})
        whole = load_model(model_path(model), parameters=every_row, nacelle_angle_deg=angle)
        problem = build_problem(case.model_at.with_uncertainty(whole, angle), joint,
                                weights=replace(case.weights, at=None))
    drawn = posterior if posterior is None or isinstance(posterior, Posterior) else read_posterior(posterior)
    whole = problem.parameters
    point = whole.initial if at == "initial" else np.array([found.get(p.name, p.initial) for p in whole])
    made = information(problem, theta=point, place=PLACES[at], posterior=drawn)
    said = {SETS: "; ".join(case.joint.notes)} if case.joint.notes else {}
    return replace(made, check=check, settings=made.settings | said)
