"""A diagnosis from files: which of the four ways is meant, and where the extended model goes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from probupdate.campaign.reading import Campaign
from probupdate.campaign.usable import lacking_notes
from probupdate.diagnosis.campaign_tests import campaign_tests, rate_finding, with_true_rate
from probupdate.diagnosis.diagnose import Outcome, examine
from probupdate.diagnosis.extension import extend as extend_model
from probupdate.diagnosis.free_form import channel_response_content, free_form
from probupdate.diagnosis.gain import gains, measures
from probupdate.diagnosis.hypotheses import MOST_MOVES
from probupdate.diagnosis.model_error import LARGER_ERRORS
from probupdate.diagnosis.prepare import Prepared, prepare
from probupdate.diagnosis.problem import DISCREPANCY_LOG, DISCREPANCY_SHAPE
from probupdate.diagnosis.residuals import residuals
from probupdate.diagnosis.results import Diagnosis, Finding
from probupdate.diagnosis.splitting import splits
from probupdate.diagnosis.stated_gravity import with_gravity_test
from probupdate.diagnosis.unmatched import unmatched_modes, with_unmatched
from probupdate.diagnosis.without_model import diagnose_without_model
from probupdate.diagnosis.wording import larger_error_words, nearest_part_words
from probupdate.effects.catalogue import Effect
from probupdate.errors import ConvergenceError, InputError
from probupdate.modal.joined_modes import highest_frequency_hz
from probupdate.modal.modes import ModalData, Sensor
from probupdate.runtime.executors import Executor, executor
from probupdate.runtime.progress import Progress, renamed, silent
from probupdate.structure.parameter_table import read_parameters, read_toml
from probupdate.structure.readings import lacking_words, tilt_length_m

if TYPE_CHECKING:
    from probupdate.model.interface import Model

# g / w^2 of the lowest mode beside the model's height, or in metres where that is not known, from which it is said that
# the model has no tilt of its channels: a tenth of a per cent of their motion is seen by none
SEEN_TILT = 0.001
# how much parameters of a group change together, in any unit from shares to N/m
LEAST_CHANGE, MOST_CHANGE = 1e-9, 1e9


@dataclass(frozen=True, eq=False, kw_only=True)
class ModelSource:
    """Which model a diagnosis is of, and what goes with it: `model` a file, or one made ready by `prepare` for many
    records; None: measurement and environmental and operational conditions only. `sensors`: where they are, if the
    campaign does not say. `parameters`: of a model of matrices. `groups`: name -> {parameter: change}, or a TOML file
    of them. `effects`: a user's own; see `prepare`. `discrepancy`: what the model leaves out of every frequency, a
    share above zero, with shapes in proportion (None: 0.003, as is usual of a model of beams)."""

    model: Path | Model | Prepared | None
    sensors: tuple[Sensor, ...] | None = None
    parameters: str | Path | None = None
    groups: str | Path | Mapping[str, Mapping[str, float]] | None = None
    effects: Sequence[Effect] = ()
    discrepancy: float | None = None

    def __post_init__(self):
        if self.discrepancy is not None and not 0 < self.discrepancy < 1:
            raise InputError("discrepancy", f"{self.discrepancy:g} is not a share of a frequency above zero",
                             "give the model discrepancy of every frequency, such as 0.005")

    def prepare(self, sensors: tuple[Sensor, ...] | None, data: ModalData, progress: Progress) -> Prepared:
        """With what the modal sets state of gravity. Raises InputError where the model has no matrices."""
        if isinstance(self.model, Prepared):
            made = self.model if self.discrepancy is None else replace(self.model, discrepancy=self.discrepancy)
            return made.with_stated_gravity(data)
        if not isinstance(self.model, Path):
            raise InputError("diagnose", "a model that is a Python function has no matrices to put effects into",
                             "export its matrices as model.npz")
        own = read_parameters(self.parameters) if self.parameters else None
        groups = read_groups(self.groups) if isinstance(self.groups, str | Path) else self.groups
        made = prepare(self.model, parameters=own, sensors=sensors, groups=groups, effects=self.effects,
                       felt=data.felt, highest_hz=highest_frequency_hz(data), progress=progress)
        return replace(made, discrepancy=self.discrepancy).with_stated_gravity(data)

    def refuse_without_model(self) -> None:
        own = [e for e in self.effects if e.adds is not None]
        for name, value in (("parameters", self.parameters), ("groups", self.groups), ("effects", own),
                            ("discrepancy", self.discrepancy)):
            if value:
                raise InputError("diagnose", f"{name} is given without a model",
                                 f"give --model, or leave {name} out")


def diagnose_files(
    source: ModelSource,
    data: ModalData,
    *,
    campaign: Campaign | None = None,
    extend: bool = True,
    seed: int = 1,
    out: str | Path | None = None,
    jobs: int | Executor = 1,
    progress: Progress = silent,
) -> Diagnosis:
    """`campaign`: its raw records are tested too, and say where the sensors are if `source` does not. `extend`: measure
    what each finding gains on held-out blocks and put the findings into model and data, written beside `out`
    (diagnosis.json's place), or where no row explains the record look for elementary parts that do. `jobs`: processes,
    or an executor, for records and hypotheses; the numbers are the same on any."""
    sensors = campaign.sensors if source.sensors is None and campaign is not None else source.sensors
    with executor(jobs) as runs:
        # processes import while what they are given is made ready
        runs.prepare(MOST_MOVES, __name__)
        tests = campaign_tests(campaign, runs=runs, progress=progress) if campaign is not None else []
        wrong_rate = rate_finding(tests)
        data = data if wrong_rate is None else with_true_rate(data, wrong_rate)
        if source.model is None:
            source.refuse_without_model()
            found = diagnose_without_model(data, sensors, campaign_check=tests, effects=source.effects,
                                           progress=progress)
        else:
            prepared = source.prepare(sensors, data, progress)
            found = _whole(prepared, data=data, seed=seed, extended=extend, out=out, runs=runs,
                           parameters_file=source.parameters, progress=progress)
            own = lacking_notes(prepared.small.channels, [campaign]) if campaign is not None else []
            asked = [f"the model is {prepared.question}"] if prepared.question else []
            found = replace(found, notes=(*found.notes, *asked, *_without_tilt(prepared, data), *own))
    return _with_tests(found, tests, wrong_rate)


def _without_tilt(prepared: Prepared, data: ModalData) -> list[str]:
    """What the model does not know of gravity in the readings, where that may be seen."""
    small = prepared.small
    lowest = float(np.nanmin([np.nanmin(s.frequency_hz) for s in data.sets if np.any(s.measured)]))
    height = 0.0 if small.wire is None else float(np.ptp(small.wire.node_m[:, 2]))
    if tilt_length_m(lowest) < SEEN_TILT * (height or 1.0):
        return []
    channels = [c for c in data.channels if c in small.channels]
    return [f"gravity: {words}" for words in lacking_words(small, channels, data.felt, lowest, height or None)]


def _with_tests(found: Diagnosis, tests: Sequence[dict], wrong_rate: Finding | None) -> Diagnosis:
    """What the raw records say beside what the modes say. A wrong rate was taken out of the modes before."""
    details = {**found.details, "measurement": list(tests)} if tests else found.details
    if wrong_rate is None:
        return replace(found, details=details)
    note = (f"rotor lines: the records' clock runs fast by {100 * wrong_rate.size:+.2g} %; all frequencies were "
            "corrected by that before anything else was tested")
    return replace(found, verdict="named" if found.verdict == "none" else found.verdict, details=details,
                   findings=(wrong_rate, *found.findings), notes=(*found.notes, note))


def _whole(
    prepared: Prepared, *, data: ModalData, seed: int, extended: bool, parameters_file: str | Path | None,
    out: str | Path | None, runs: Executor, progress: Progress,
) -> Diagnosis:
    """The diagnosis with what remains before and after its findings, for the report."""
    outcome = examine(prepared, data, seed=seed, runs=runs, progress=progress)
    beyond = unmatched_modes(prepared, outcome, data, seed=seed, runs=runs, progress=progress)
    found = with_unmatched(outcome.diagnosis, beyond)
    few = outcome.problem.blocks.few
    able = extended and bool(found.findings)
    if able and few:
        found = replace(found, notes=(*found.notes, "too few sets to hold any out: the predictive gain was not "
                                      "computed, and the model was not extended"))
    able = able and not few and bool(outcome.fitted.included)
    if able:
        found = _with_gains(found, gains(outcome, runs=runs, progress=progress))
    details = {**found.details, "residuals": residuals(outcome, prepared.sensors)}
    if extended and found.verdict == "unexplained" and not few and "free_form" not in details:
        content = _unknown_cause(prepared, outcome, data, seed=seed, runs=runs, progress=progress)
        if content.get("gain", {}).get("significant", False):
            details["free_form"] = content
        elif content:
            found = replace(found, notes=(*found.notes, nearest_part_words(content)))
    if extended and found.verdict == "unexplained" and not few and prepared.discrepancy is None:
        found = replace(found, notes=(*found.notes, *_with_larger_error(prepared, data, seed, runs, progress)))
    found = with_gravity_test(outcome, replace(found, splits=found.splits or splits(outcome), details=details))
    if not able:
        return found
    # last, as it writes files: a run that is interrupted leaves those that stand beside an earlier diagnosis
    more = extend_model(prepared, outcome, data, out, parameters_file=parameters_file, seed=seed)
    return replace(found, extended_model=more.model, extension=more.content)


def _with_larger_error(
    prepared: Prepared, data: ModalData, seed: int, runs: Executor, progress: Progress
) -> list[str]:
    """What to say where the least of a few larger errors of the model explains the record, and what is found beside it:
    what begins within the record is there whatever the model misses throughout. What the largest leaves unexplained no
    smaller one explains."""
    said: list[str] = []
    for scale in LARGER_ERRORS:
        share = scale * DISCREPANCY_LOG
        try:
            found = examine(replace(prepared, discrepancy=share), data, seed=seed, runs=runs,
                            progress=renamed(progress, f"diagnosing with {scale:g} times the model's error")).diagnosis
        except ConvergenceError:
            # of a model that far off nothing is said
            continue
        if found.verdict == "unexplained":
            break
        said = [larger_error_words({"frequency": share, "shape": scale * DISCREPANCY_SHAPE}, found.content())]
    return said


def _unknown_cause(
    prepared: Prepared, outcome: Outcome, data: ModalData, *, seed: int, runs: Executor, progress: Progress
) -> dict:
    """What no row describes, of sensors or, where these are as they should be, of the structure, and what it gains on
    held-out blocks."""
    if outcome.own_response is not None:
        return channel_response_content(outcome, seed=seed)
    free = free_form(prepared, outcome, data, seed=seed, runs=runs, progress=progress)
    if free is None:
        return {}
    null, fitted = free.outcome.null, free.outcome.fitted
    return {**free.content, "gain": measures(free.outcome.problem, null, fitted, noise=null.design.noise)}


def _with_gains(found: Diagnosis, gains_of: Sequence[dict]) -> Diagnosis:
    findings = tuple(replace(f, gain=gain) for f, gain in zip(found.findings, gains_of, strict=True))
    notes = tuple(f"{f.name}: {f.gain['statement']}; the verdict stands on the whole record alone"
                  for f in findings if not f.gain.get("significant", False))
    return replace(found, findings=findings, notes=(*found.notes, *notes))


def read_groups(path: str | Path) -> dict[str, dict[str, float]]:
    """Group -> its parameters and their changes for a size of one, of a groups.toml; raises InputError."""
    table = read_toml(path)
    for name, parts in table.items():
        numbers = isinstance(parts, dict) and parts and all(
            isinstance(v, int | float) and not isinstance(v, bool) for v in parts.values())
        if not numbers:
            raise InputError(f"{path}: {name}", "is not a table of parameters with their change",
                             "write [name] k_1 = 0.1")
        far = next((f"{key} = {v:g}" for key, v in parts.items() if not LEAST_CHANGE <= abs(v) <= MOST_CHANGE), None)
        if far is not None:
            raise InputError(f"{path}: {name}", f"{far} is not a plausible change of a parameter ({LEAST_CHANGE:g} to "
                             f"{MOST_CHANGE:g}, up or down)", "write its change that goes with those of the others")
    return table
