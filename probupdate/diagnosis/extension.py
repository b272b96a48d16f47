"""The model with the findings in it: files to go on with, and whether the findings are identified.

Structural and environmental findings become parameters of the model's file; so does a group of the parameters of a
model of matrices. The prior of one that was found by a change within the record is the size found, with its standard
deviation: no later set shows that change again. One that was there throughout has the catalogue's prior, as the same
sets give its size. Findings of the measurement are taken out of the modal sets: no sensor table can say "from the tenth
on". What `update` and `sample` are given is the mean of the blocks in which all findings act and the nacelle looked one
way, with the standard deviations of that mean.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import sparse

from probupdate.diagnosis.blocks import of_model
from probupdate.diagnosis.diagnose import Outcome
from probupdate.diagnosis.evidence import sizes_std
from probupdate.diagnosis.expected import local_at
from probupdate.diagnosis.fitting import Fit
from probupdate.diagnosis.mode_numbers import Reference, modes_with, numbers_of
from probupdate.diagnosis.predictor import observe
from probupdate.diagnosis.prepare import Prepared, places_tried
from probupdate.diagnosis.problem import DiagnosisProblem, IncludedEffect, local_std
from probupdate.diagnosis.results import Diagnosis
from probupdate.diagnosis.wording import WITH_FINDINGS
from probupdate.errors import InputError
from probupdate.modal.modes import CovarianceFactors, ModalData, ModalSet, write_modes
from probupdate.structure.extend import EffectParameter, write_extended
from probupdate.structure.extend_matrices import Group, group_parameter, write_grouped
from probupdate.structure.load import load_model
from probupdate.structure.subdyn_model import is_subdyn
from probupdate.updating.identifiability import DIAGNOSED

# a parameter is identified by the data if its standard deviation falls below this share of its prior's, and if no other
# goes with it
IDENTIFIED, TOO_ALIKE = 0.5, 0.95
# a parameter's way to or from its prior that is worth a word, in prior standard deviations
NOTABLE = 0.3
# time profiles by which a size is known without an absolute value
CHANGES = ("step", "ramp")


@dataclass(frozen=True, kw_only=True)
class Extension:
    """`model`: name of the file written beside diagnosis.json (None: not needed, or no place given); content: plain
    numbers for diagnosis.json, its `files` the names of all that were written."""

    model: str | None
    content: dict


def extend(
    prepared: Prepared, outcome: Outcome, data: ModalData, out: str | Path | None = None, *,
    parameters_file: str | Path | None = None, seed: int = 1,
) -> Extension:
    """Put the findings of a diagnosis into model and data. `out`: diagnosis.json's place; the files go beside it as
    <its stem>.model.toml (and .model.npz of a model of matrices with a group), <its stem>.modes.json (sets corrected
    for what the sensors did) and <its stem>.mean.json (the mean to update with). `parameters_file` (where the model's
    parameters came from, if from another file) and `seed` are for the commands that are given."""
    problem, fitted = outcome.problem, outcome.fitted
    sizes = sizes_std(problem, fitted)
    added = _AddedParameters.from_fit(prepared, fitted, sizes)
    mean, n_block = mean_set(problem, fitted)
    averaged = ModalData(channels=problem.blocks.channels, sets=(mean,), labels=problem.blocks.labels,
                         gravity=gravity_found(prepared, problem.blocks.channels, fitted.included))
    out = None if out is None else Path(out)
    places, unwritten = ({}, "") if out is None else _write_files(prepared, outcome, data, added, averaged, out)
    content = {
        "files": {key: places[key].name if key in places else None for key in ("model", "modes", "mean")},
        "added": [_added_table(added, n) | {"size_std": std}
                  for n, std in zip(fitted.included, sizes, strict=True)],
        "mean_of_blocks": n_block,
        "joint": finding_precision(problem, fitted),
        "commands": [],
    }
    content["statements"] = statements(outcome.diagnosis, content["joint"])
    if unwritten:
        content["statements"].append(f"no model file was written: {unwritten}")
    elif prepared.description is not None and "model" in places and parameters_file is not None:
        # commands that would update another problem are none
        content["statements"].append(f"{places['model'].name} has the parameters of {prepared.path}, not those of "
                                     f"{parameters_file}, with which the findings were made: put these in before it is "
                                     "used")
    elif out is not None:
        given = {"model": places.get("model", prepared.path), "modes": places["mean"],
                 "parameters": None if "model" in places else parameters_file}
        content["commands"] = [_command("update", given | {"out": out.with_name(f"{out.stem}.update.json")}),
                               _command("sample", given | {"out": out.with_name(f"{out.stem}.posterior.nc"),
                                                           "seed": seed})]
        content["statements"].append(f"{WITH_FINDINGS}: {'; '.join(content['commands'])}")
    return Extension(model=content["files"]["model"], content=content)


def _command(verb: str, given: Mapping[str, object]) -> str:
    """What is typed for a step."""
    return " ".join([f"probupdate {verb}", *(f"--{name} {shlex.quote(str(value))}" for name, value in given.items()
                                             if value is not None)])


def _write_files(
    prepared: Prepared, outcome: Outcome, data: ModalData, added: _AddedParameters, averaged: ModalData, out: Path
) -> tuple[dict[str, Path], str]:
    """The files that were written beside `out`, and why the model's was not where it could not be."""
    unwritten, included = "", outcome.fitted.included
    seen = [n for n in included if n.effect.observe is not None]
    out.parent.mkdir(parents=True, exist_ok=True)
    places = {"mean": out.with_name(f"{out.stem}.mean.json")}
    write_modes(averaged, places["mean"])
    if added:
        try:
            places["model"] = added.write(prepared, out.with_name(f"{out.stem}.model.toml"))
        except InputError as error:
            # minutes of work are not lost for a file that stands in its own way
            unwritten = str(error)
    if seen or any(map(is_gravity_finding, included)):
        places["modes"] = out.with_name(f"{out.stem}.modes.json")
        mended = correct_sensors(outcome.problem, data, seen)
        write_modes(replace(mended, gravity=gravity_found(prepared, mended.channels, included)), places["modes"])
    return places, unwritten


@dataclass(frozen=True, kw_only=True)
class _AddedParameters:
    """What the model gets for the findings: effects of a turbine; or groups of the parameters of a model of matrices,
    each with its name in the file, and sensors `moved` to where they were found."""

    effects: tuple[EffectParameter, ...] = ()
    groups: tuple[tuple[IncludedEffect, Group], ...] = ()
    moved: tuple[IncludedEffect, ...] = ()

    @classmethod
    def from_fit(cls, prepared: Prepared, fitted: Fit, sizes: Sequence[float]) -> _AddedParameters:
        """`sizes`: standard deviation of each included effect's size."""
        if prepared.description is not None:
            return cls(effects=tuple(describe_parameter(n.effect.adds, n, std)
                                     for n, std in zip(fitted.included, sizes, strict=True)
                                     if n.effect.adds is not None and not is_gravity_finding(n)))
        groups, taken = [], list(prepared.prior.names)
        for n, std in zip(fitted.included, sizes, strict=True):
            if n.effect.parts:
                e = n.effect
                centre, width = (n.size, std) if is_known_by_change(n, std) else (0.0, e.prior_scale)
                name = group_parameter(e.location or e.cause, taken)
                taken.append(name)
                members = ", ".join(f"{change:+g} {member}" for member, change in e.parts)
                words = f"{e.cause}: {e.location} ({members} for one); {_diagnosed_words(n, std)}"
                groups.append((n, Group(name=name, parts=dict(e.parts), initial=centre, std=width, lower=e.lower,
                                        upper=e.upper, unit=e.unit, description=words)))
        return cls(groups=tuple(groups), moved=tuple(n for n in fitted.included
                                                     if n.effect.adds is not None and not is_gravity_finding(n)))

    def __bool__(self) -> bool:
        return bool(self.effects or self.groups or self.moved)

    def name_of(self, included: IncludedEffect) -> str | None:
        """The new parameter of a finding that is a group."""
        return next((group.name for n, group in self.groups if n is included), None)

    def write(self, prepared: Prepared, out: Path) -> Path:
        if self.moved and is_subdyn(prepared.path):
            raise InputError(str(prepared.path), "says by its own tables where its sensors are",
                             "put them where they were found in its [[sensor]] tables, or in position_m")
        if self.groups or self.moved:
            return write_grouped(prepared.path, prepared.prior, [group for _, group in self.groups], out,
                                 channel_rows=self._channel_rows(prepared) if self.moved else None)
        return write_extended(prepared.path, self.effects, out)

    def _channel_rows(self, prepared: Prepared) -> sparse.csr_array:
        """(n_row, n_dof) the channels' motion and tilt (`AffineModel.rows`) where they were found to be."""
        model, _ = places_tried(prepared.path, load_model(prepared.path, parameters=prepared.prior), prepared.sensors)
        theta, names = np.array(model.parameters.initial), model.parameters.names
        for n in self.moved:
            for name, share in n.effect.increments:
                theta[names.index(name)] = share * n.size
        return model.channel_rows(theta)


def is_known_by_change(included: IncludedEffect, size_std: float) -> bool:
    """Whether a size is known from a change within the record, and not only as a share of absolute values."""
    return included.time_profile.kind in CHANGES and size_std > 0


def describe_parameter(added: EffectParameter, included: IncludedEffect, size_std: float) -> EffectParameter:
    """The parameter that the model gets for a finding, its time profile stated in its description."""
    stated = replace(added, location=f"{added.location}; {_diagnosed_words(included, size_std)}")
    if not is_known_by_change(included, size_std):
        return stated
    centre = min(max(added.neutral + included.size, added.lower), added.upper)
    return replace(stated, initial=centre, std=size_std, prior="normal")


def _diagnosed_words(included: IncludedEffect, size_std: float) -> str:
    start = DIAGNOSED if is_known_by_change(included, size_std) else "diagnosed"
    return f"{start} as {_profile_words(included)}"


def _profile_words(included: IncludedEffect) -> str:
    time_profile, size = included.time_profile, f"{included.size:.4g} {included.effect.unit.removeprefix('-')}".strip()
    return {
        "constant": f"{size} all through the record it was found in",
        "step": f"{size} from block {time_profile.at + 1} of the record on",
        "ramp": f"{size} at the end of the record, growing evenly",
        "covariate": f"{size}{time_profile.unit} of {time_profile.column} about its mean {time_profile.centre:.4g}",
    }[time_profile.kind]


def _added_table(added: _AddedParameters, included: IncludedEffect) -> dict:
    """What became of one finding."""
    effect = included.effect
    described_by = {"cause": effect.cause, "location": effect.location, "size": included.size,
                    "unit": effect.unit, "time_profile": included.time_profile.name}
    if is_gravity_finding(included):
        return described_by | {"as": "what the modal sets state of gravity"}
    if included in added.moved:
        return described_by | {"as": "another place of the sensor in the model"}
    name = effect.adds.name if effect.adds is not None else added.name_of(included)
    if name is not None:
        return described_by | {"as": "parameter", "parameter": name}
    if effect.observe is not None:
        return described_by | {"as": "correction of the modal sets"}
    names = [name for name, _ in effect.increments]
    return described_by | {"as": "the model's own parameter, whose prior is in question", "parameter": ", ".join(names)}


# Gravity in the readings ---------------------------------------------------------------------------------------------


def is_gravity_finding(included: IncludedEffect) -> bool:
    """Whether an effect is that what is stated of gravity is wrong."""
    return included.effect.adds is not None and included.effect.adds.kind == "sensor_gravity"


def gravity_found(
    prepared: Prepared, channels: Sequence[str], included: Sequence[IncludedEffect]
) -> tuple[bool, ...]:
    """What is to be stated of the channels' gravity, behind the findings; () of a model that knows nothing of it."""
    gravity = prepared.small.gravity
    if gravity is None:
        return ()
    held = dict(zip(prepared.small.channels, gravity.share > 0.5, strict=True))
    for n in included:
        if is_gravity_finding(n) and n.size > 0.5:
            held |= {c: not held[c] for c in n.effect.adds.settings["channels"] if c in held}
    return tuple(bool(held[c]) for c in channels)


# Modal sets --------------------------------------------------------------------------------------------------------


def corrections(n_channel: int, included: Sequence[IncludedEffect], values: Sequence[float] | np.ndarray,
                frequency_hz: float) -> tuple[np.ndarray, float]:
    """A (n_channel, n_channel) that sensors with these effects make of shapes near a frequency, and what they add to
    ln f; `values` of the effects' time profiles."""
    A, shift = np.eye(n_channel, dtype=complex), 0.0
    for n, value in sorted(zip(included, values, strict=True), key=lambda pair: pair[0].effect.stage):
        if value:
            A, more = n.effect.observation(A, frequency_hz, n.size * value)
            shift += more
    return A, shift


def correct_sensors(problem: DiagnosisProblem, data: ModalData, included: Sequence[IncludedEffect]) -> ModalData:
    """The sets that the diagnosis used, without what it found the sensors to do."""
    blocks, (data, _) = problem.blocks, of_model(data)
    rows = [data.channels.index(c) for c in blocks.channels]
    known = {s.id: s for s in data.sets}
    sets = []
    for b, name in enumerate(blocks.ids):
        s = known[name]
        shape, std = np.array(s.shape), np.array(s.shape_std)
        frequency, frequency_std = np.array(s.frequency_hz), np.array(s.frequency_std_hz)
        changes = None if s.covariance_factors is None else np.array(s.covariance_factors.shape)
        for j in np.flatnonzero(np.isfinite(frequency)):
            A, shift = corrections(len(rows), included, [n.time_profile.value[b] for n in included],
                                   float(frequency[j]))
            undo = np.linalg.inv(A)
            # a channel that was not measured stays so, and takes along only those that were mixed with it
            shape[rows, j] = _apply_matrix(undo, shape[rows, j])
            std[rows, j] = np.sqrt(np.real(_apply_matrix(np.abs(undo) ** 2, std[rows, j] ** 2)))
            if changes is not None:
                changes[rows, j] = np.column_stack([_apply_matrix(undo, c) for c in changes[rows, j].T])
            frequency[j] *= np.exp(-shift)
            frequency_std[j] *= np.exp(-shift)
        covariance_factors = s.covariance_factors
        if covariance_factors is not None and changes is not None:
            covariance_factors = CovarianceFactors(ln_frequency=covariance_factors.ln_frequency,
                                                   damping_ratio=covariance_factors.damping_ratio,
                                                   shape=changes)
        sets.append(replace(s, shape=shape, shape_std=std, frequency_hz=frequency, frequency_std_hz=frequency_std,
                            covariance_factors=covariance_factors))
    chosen = data.reference_set if data.reference_set in blocks.ids else None
    return replace(data, sets=tuple(sets), reference_set=chosen)


def _apply_matrix(A: np.ndarray, x: np.ndarray) -> np.ndarray:
    """A x, NaN only where an entry that counts is NaN."""
    lost = np.isnan(x)
    result = A @ np.where(lost, 0.0, x)
    return np.where((np.abs(A) > 1e-12)[:, lost].any(axis=1), np.nan, result)


def mean_set(problem: DiagnosisProblem, fitted: Fit) -> tuple[ModalSet, int]:
    """Mean modes of the blocks after every step of the fit and where the nacelle mostly looked then, without what
    sensors were found to do; and their number. Standard deviations are those of the mean alone: what the model misses
    is for the likelihood to state. Covariates are at their mean in the record."""
    blocks, design = problem.blocks, fitted.design
    later = np.ones(len(blocks), bool)
    for n in fitted.included:
        if n.time_profile.kind == "step":
            later &= np.asarray(n.time_profile.value) > 0.5
    centres, bin_of = problem.bins
    usable = later & np.all([w > 0 for w in design.noise.weight], axis=0)
    usable = usable if usable.any() else later
    usual = int(np.argmax(np.bincount(bin_of[usable], minlength=len(centres))))
    chosen = later & (bin_of == usual)
    exact = [n for n in fitted.included if n.exact]
    predictor, local, _ = local_at(problem, fitted.theta, exact, np.ones(len(exact)))
    seen = [n for n in fitted.included if n.effect.observe is not None and n.time_profile.kind != "covariate"]
    n_channel, n_mode = len(blocks.channels), len(blocks.labels)
    frequency, frequency_std = np.full(n_mode, np.nan), np.full(n_mode, np.nan)
    shape, std = np.full((n_channel, n_mode), np.nan, complex), np.full((n_channel, n_mode), np.nan)
    references = predictor.references(local, float(centres[usual]))
    seen_there = observe(references, [(n.effect, n.size) for n in seen])
    for q, group in enumerate(blocks.groups):
        weight = np.where(chosen, design.noise.weight[q], 0.0)
        if not weight.any():
            continue
        k, members = len(group), list(group)
        n_log = 1 if k == 1 else 3
        mean = weight @ fitted.residuals[q] / weight.sum()
        variance = design.noise.covariance[q] / weight.sum()
        near = float(np.exp(np.trace(references[q].tensor) / k))
        expected = seen_there[q]
        A, shift = corrections(n_channel, seen, np.ones(len(seen)), near)
        axes = problem.predictor.axes[q]
        there = Reference(tensor=expected.tensor[None], shape=expected.shape[None])
        measured = modes_with(numbers_of(there, axes)[0] + mean, axes)
        described_by = np.linalg.solve(A, measured.shape)
        value, V = np.linalg.eigh(measured.tensor - shift * np.eye(k))
        slope = V.T**2 if k == 1 else np.column_stack([V[0] ** 2, V[1] ** 2, np.sqrt(2) * V[0] * V[1]])
        frequency[members] = np.exp(value)
        frequency_std[members] = np.exp(value) * np.sqrt(
            np.einsum("ia,ab,ib->i", slope, variance[:n_log, :n_log], slope))
        shape[:, members] = described_by @ V
        own = np.diag(variance)[n_log : n_log + k * n_channel].reshape(k, n_channel).T
        std[:, members] = np.sqrt(own @ V**2)
    return ModalSet(
        id=f"mean of {int(chosen.sum())} blocks from {blocks.ids[int(np.flatnonzero(chosen)[0])]} on",
        frequency_hz=frequency, shape=shape, damping_ratio=np.full(n_mode, np.nan), frequency_std_hz=frequency_std,
        shape_std=std, environment={"nacelle_angle_deg": float((centres[usual] + 180.0) % 360.0 - 180.0)},
    ), int(chosen.sum())


# What it says -----------------------------------------------------------------------------------------------------


def _indistinguishable(names: Sequence[str], correlation: np.ndarray) -> list[dict]:
    return [{"first": names[i], "second": names[j], "correlation": float(correlation[i, j])}
            for i in range(len(names)) for j in range(i) if abs(correlation[i, j]) > TOO_ALIKE]


def finding_precision(problem: DiagnosisProblem, fitted: Fit) -> dict:
    """From the whole record, of each finding its standard deviation over its prior's, and pairs of parameters that go
    together."""
    design, n_own = fitted.design, len(problem.updated)
    free = [n for n in fitted.included if not n.effect.discrete]
    rows = design.fitted_unknowns(n_own)
    covariance = design.unknowns_cov(rows)
    std = np.sqrt(np.diag(covariance))
    prior = [local_std(problem.prior, i, fitted.theta[k]) for i, k in enumerate(problem.updated)]
    share = std / np.concatenate([prior, [n.prior_std for n in free]])
    names = (*problem.prior.names, *(n.effect.name for n in free))
    return {
        "findings": [{"name": n.effect.name, "share_of_prior_std": float(s), "identified": bool(s < IDENTIFIED)}
                     for n, s in zip(free, share[n_own:], strict=True)],
        "too_alike": _indistinguishable(names, covariance / np.outer(std, std)),
    }


def statements(found: Diagnosis, joint: Mapping) -> list[str]:
    """What the findings do to what the model knows, in words; `joint` as of `finding_precision`."""
    said = []
    if found.verdict == "ambiguous":
        said.append("the verdict is ambiguous: the model is extended with the most probable cause")
    for row in joint["findings"]:
        kept = "its size is identified" if row["identified"] else "its size is not identified"
        said.append(f"{row['name']}: {kept}, posterior over prior standard deviation "
                    f"{row['share_of_prior_std']:.2f}")
    for pair in joint["too_alike"]:
        said.append(f"{pair['first']} and {pair['second']} are identified only together "
                    f"(correlation {pair['correlation']:.2f})")
    before, after = ({p["name"]: p[key] for p in found.parameters} for key in ("prior_shift", "prior_shift_after"))
    size = [np.sqrt(np.mean(np.square([*side.values()]))) for side in (before, after)]
    back = [n for n in before if abs(before[n]) - abs(after[n]) > NOTABLE]
    away = [n for n in before if abs(after[n]) - abs(before[n]) > NOTABLE]
    direction = "back towards" if size[1] < size[0] - 0.05 else "away from" if size[1] > size[0] + 0.05 else "neither"
    where = "the other parameters move neither towards nor from their prior" if direction == "neither" else (
        f"the other parameters move {direction} their prior")
    said.append(f"{where}: {size[0]:.2f} prior standard deviations from it before, {size[1]:.2f} after (root mean "
                "square)"
                + (f"; back: {', '.join(back)}" if back else "") + (f"; away: {', '.join(away)}" if away else ""))
    return said
