"""The model with the findings in it: files to go on with, the estimators run again, and whether they are identified.

Structural and environmental findings become parameters of the model's file; so does a group of the parameters of a
model of matrices. The prior of one that was found by a change within the record is the size found, with its standard
deviation: no later set shows that change again. One that was there throughout has the catalogue's prior, as the same
sets give its size. Findings of the measurement are taken out of the modal sets: no sensor table can say "from the tenth
on". The estimators (the Tikhonov update and the maximum of the posterior, and where it is asked for the sampler) are
given the mean of the blocks in which all findings act and the nacelle looked one way, with the standard deviations of
that mean.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import sparse

from probupdate.diagnosis.blocks import of_model
from probupdate.diagnosis.diagnose import Outcome
from probupdate.diagnosis.evidence import sizes_std
from probupdate.diagnosis.expected import local_at
from probupdate.diagnosis.extension_sampling import not_sampled, sample_extended, sampler_statements, sampling_command
from probupdate.diagnosis.fitting import Fit
from probupdate.diagnosis.mode_numbers import Reference, modes_with, numbers_of
from probupdate.diagnosis.predictor import observe
from probupdate.diagnosis.prepare import Prepared, places_tried
from probupdate.diagnosis.problem import DiagnosisProblem, IncludedEffect, local_std
from probupdate.diagnosis.results import Diagnosis
from probupdate.effects.tolerances import SensorUncertainty, TurbineUncertainty
from probupdate.errors import ConvergenceError, InputError
from probupdate.modal.modes import CovarianceFactors, ModalData, ModalSet, write_modes
from probupdate.model.parameters import Parameter
from probupdate.runtime.executors import SERIAL, Executor
from probupdate.runtime.progress import Progress, silent
from probupdate.structure.affine import AffineModel
from probupdate.structure.extend import EffectParameter, extended_model, write_extended
from probupdate.structure.extend_matrices import Group, group_parameter, write_grouped
from probupdate.structure.load import load_model
from probupdate.structure.subdyn_model import is_subdyn
from probupdate.updating.discrepancy import default_likelihood
from probupdate.updating.ensemble import SamplerSettings
from probupdate.updating.identifiability import DIAGNOSED
from probupdate.updating.problem import build_problem
from probupdate.updating.runs import find_maximum
from probupdate.updating.tikhonov import update

# a parameter is identified by the data if its standard deviation falls below this share of its prior's, and if no other
# goes with it
IDENTIFIED, TOO_ALIKE = 0.5, 0.95
# a parameter's way to or from its prior that is worth a word, in prior standard deviations
NOTABLE = 0.3
# standard deviations between the size that was found and the one an update of the mean gives, beyond which it is said
APART = 2.0
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
    sampler: SamplerSettings | None = None, parameters_file: str | Path | None = None, seed: int = 1,
    runs: Executor = SERIAL, progress: Progress = silent,
) -> Extension:
    """Put the findings of a diagnosis into model and data. `out`: diagnosis.json's place; the files go beside it as
    <its stem>.model.toml (and .model.npz of a model of matrices with a group), <its stem>.modes.json (sets corrected
    for what the sensors did), <its stem>.mean.json (the mean that the estimators were given) and
    <its stem>.posterior.nc. `sampler` None: the posterior is not sampled, and the content says so. `parameters_file`
    (where the model's parameters came from, if from another file) and `seed` are for the command that is given. On the
    executor `runs` the model as it is and with the findings are updated side by side."""
    problem, fitted = outcome.problem, outcome.fitted
    sizes = sizes_std(problem, fitted)
    added = _AddedParameters.of(prepared, fitted, sizes)
    mean, n_block = mean_set(problem, fitted)
    averaged = ModalData(channels=problem.blocks.channels, sets=(mean,), labels=problem.blocks.labels,
                         gravity=gravity_found(prepared, problem.blocks.channels, fitted.included))
    out = None if out is None else Path(out)
    angle = float(mean.environment["nacelle_angle_deg"])
    progress("updating with the findings", 0, 2)
    alone = replace(averaged, sets=(mean_set(problem, outcome.null, like=fitted)[0],),
                    gravity=gravity_found(prepared, problem.blocks.channels, ()))
    (before, _), (after, model) = runs.in_order(
        _updated_if_possible, [(_AddedParameters(), alone), (added, averaged)], shared=(prepared, angle))
    progress("updating with the findings", 2, 2)
    place = None if out is None else out.with_name(f"{out.stem}.posterior.nc")
    chain = _chain(model, averaged, sampler, place, runs, progress)
    # after all that takes long
    places, unwritten = ({}, "") if out is None else _written(prepared, outcome, data, added, averaged, out)
    foreign = prepared.description is not None and "model" in places and parameters_file is not None
    # a command that would sample another problem is none
    chain["command"] = "" if place is None or unwritten or foreign else sampling_command(
        places.get("model", prepared.path), places["mean"], place, seed if sampler is None else sampler.seed,
        parameters=None if "model" in places else parameters_file)
    files: dict[str, str | None] = {"model": None, "modes": None, "mean": None, "posterior": None}
    files |= {key: path.name for key, path in places.items()}
    if model is not None and sampler is not None and place is not None and "refused" not in chain:
        files["posterior"] = place.name
    content = {
        "files": files,
        "added": [_added_table(added, n) | {"size_std": std}
                  for n, std in zip(fitted.included, sizes, strict=True)],
        "mean_of_blocks": n_block,
        "before": before,
        "after": after,
        "sampler": chain,
        "joint": finding_precision(problem, fitted),
    }
    content["statements"] = statements(outcome.diagnosis, content)
    if unwritten:
        content["statements"].append(f"no model file was written: {unwritten}")
    if foreign:
        content["statements"].append(f"{files['model']} has the parameters of {prepared.path}, not those of "
                                     f"{parameters_file}, with which the findings were made: put these in before it is "
                                     "used")
    return Extension(model=files["model"], content=content)


def _written(
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
    if seen or any(map(of_gravity, included)):
        places["modes"] = out.with_name(f"{out.stem}.modes.json")
        mended = correct_sensors(outcome.problem, data, seen)
        write_modes(replace(mended, gravity=gravity_found(prepared, mended.channels, included)), places["modes"])
    return places, unwritten


def _chain(
    model: AffineModel | None, averaged: ModalData, sampler: SamplerSettings | None, place: Path | None,
    runs: Executor, progress: Progress,
) -> dict:
    """What the sampler says of the mean with the findings in the model, or why it was not run."""
    if sampler is None:
        return not_sampled(reason="this was not asked for")
    if model is None:
        return not_sampled(refused="the model with them was not updated")
    return sample_extended(model, averaged, sampler, place, runs, progress)


def _updated_if_possible(
    prepared: Prepared, angle_deg: float, added: _AddedParameters, data: ModalData
) -> tuple[dict, AffineModel | None]:
    """What the estimators find with this added to the model, and the model; without it where they refuse, which is a
    result: the findings stand."""
    try:
        model = added.model(prepared, angle_deg)
        return update_extended(model, data), model
    except (ConvergenceError, InputError) as error:
        return {"refused": str(error), "parameters": [], "too_alike": []}, None


@dataclass(frozen=True, kw_only=True)
class _AddedParameters:
    """What the model gets for the findings: effects of a turbine; or groups of the parameters of a model of matrices,
    each with its name in the file, and sensors `moved` to where they were found."""

    effects: tuple[EffectParameter, ...] = ()
    groups: tuple[tuple[IncludedEffect, Group], ...] = ()
    moved: tuple[IncludedEffect, ...] = ()

    @classmethod
    def of(cls, prepared: Prepared, fitted: Fit, sizes: Sequence[float]) -> _AddedParameters:
        """`sizes`: standard deviation of each included effect's size."""
        if prepared.description is not None:
            return cls(effects=tuple(describe_parameter(n.effect.adds, n, std)
                                     for n, std in zip(fitted.included, sizes, strict=True)
                                     if n.effect.adds is not None and not of_gravity(n)))
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
                                                     if n.effect.adds is not None and not of_gravity(n)))

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

    def model(self, prepared: Prepared, angle_deg: float) -> AffineModel:
        """With the sources of its error, as `update` opens it."""
        if prepared.description is not None:
            made = extended_model(prepared.path, self.effects, parameters=prepared.prior, sensors=prepared.sensors,
                                  nacelle_angle_deg=angle_deg)
            known = TurbineUncertainty.of(prepared.path, made, prepared.sensors, angle_deg, self.effects)
            return replace(made, uncertainty=known)
        if self.groups:
            # its matrices are those of the file that is written, whether a place for it was given or not
            with tempfile.TemporaryDirectory() as folder:
                made = load_model(self.write(prepared, Path(folder) / "extended.toml"))
        else:
            made = load_model(prepared.path, parameters=prepared.prior)
        if self.moved:
            rows, n = self._channel_rows(prepared), len(made.channels)
            made = replace(made, channel_matrix=rows[:n],
                           tilt_matrix=None if made.tilt_matrix is None else rows[n:])
        return replace(made, uncertainty=SensorUncertainty(model=made))

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
    if of_gravity(included):
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


def of_gravity(included: IncludedEffect) -> bool:
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
        if of_gravity(n) and n.size > 0.5:
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


def mean_set(problem: DiagnosisProblem, fitted: Fit, *, like: Fit | None = None) -> tuple[ModalSet, int]:
    """Mean modes of the blocks after every step of `like` (default: of the fit itself) and where the nacelle mostly
    looked then, without what sensors were found to do; and their number. Standard deviations are those of the mean
    alone: what the model misses is for the likelihood to state. Covariates are at their mean in the record."""
    blocks, design = problem.blocks, fitted.design
    later = np.ones(len(blocks), bool)
    for n in (like or fitted).included:
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


def update_extended(model: AffineModel, data: ModalData) -> dict:
    """Two estimators on one set: the anchored Tikhonov update, and the maximum of the posterior with its standard
    deviations by Laplace's method."""
    problem = build_problem(model, data, weights=default_likelihood(model, data))
    anchored = update(problem, penalty="prior")
    theta = anchored.theta[-1]
    laplace = find_maximum(problem, [theta, problem.parameters.initial])
    std = np.sqrt(np.diag(laplace.covariance))
    return {
        "misfit": laplace.misfit, "effective_responses": problem.n_effective, "settled": bool(anchored.converged),
        "parameters": [
            {"name": p.name, "prior": p.initial, "prior_std": p.std, "deterministic": float(theta[k]),
             "map": float(laplace.theta[k]), "std": float(std[k]),
             "prior_shift": standardised_shift(p, float(laplace.theta[k])), "at_bound": bool(laplace.at_bound[k])}
            for k, p in enumerate(problem.parameters)
        ],
        "too_alike": _indistinguishable(problem.parameters.names, laplace.covariance / np.outer(std, std)),
    }


def standardised_shift(p: Parameter, value: float) -> float:
    """How many standard deviations of its prior a parameter stands from its prior's centre."""
    if p.prior == "lognormal":
        return float(np.log(value / p.initial) / p.log_std)
    return float((value - p.initial) / p.std)


def _indistinguishable(names: Sequence[str], correlation: np.ndarray) -> list[dict]:
    return [{"first": names[i], "second": names[j], "correlation": float(correlation[i, j])}
            for i in range(len(names)) for j in range(i) if abs(correlation[i, j]) > TOO_ALIKE]


def finding_precision(problem: DiagnosisProblem, fitted: Fit) -> dict:
    """The same from the whole record: of each finding its standard deviation over its prior's, and pairs that go
    together."""
    design, n_own = fitted.design, len(problem.updated)
    free = [n for n in fitted.included if not n.effect.discrete]
    rows = design.held(n_own)
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


def statements(found: Diagnosis, content: dict) -> list[str]:
    """What the extension shows, in words."""
    said = []
    if found.verdict == "ambiguous":
        said.append("the verdict is ambiguous: the model is extended with the most probable cause")
    for row in content["joint"]["findings"]:
        kept = "its size is identified" if row["identified"] else "its size is not identified"
        said.append(f"{row['name']}: {kept}, posterior over prior standard deviation "
                    f"{row['share_of_prior_std']:.2f}")
    for pair in (*content["joint"]["too_alike"], *content["after"]["too_alike"]):
        said.append(f"{pair['first']} and {pair['second']} are identified only together "
                    f"(correlation {pair['correlation']:.2f})")
    for side, words in (("before", "as it is"), ("after", "with the findings")):
        if "refused" in content[side]:
            refused = f"the model {words} was not updated: {content[side]['refused']}"
            return [*said, refused, *sampler_statements(content["sampler"], content["after"]["parameters"])]
    described_by = {p["name"]: p["prior_shift"] for p in content["after"]["parameters"]}
    before = {p["name"]: p["prior_shift"] for p in content["before"]["parameters"]}
    size = [np.sqrt(np.mean([side[name] ** 2 for name in before])) for side in (before, described_by)]
    back = [n for n in before if abs(before[n]) - abs(described_by[n]) > NOTABLE]
    away = [n for n in before if abs(described_by[n]) - abs(before[n]) > NOTABLE]
    direction = "back towards" if size[1] < size[0] - 0.05 else "away from" if size[1] > size[0] + 0.05 else "neither"
    where = "the other parameters move neither towards nor from their prior" if direction == "neither" else (
        f"the other parameters move {direction} their prior")
    said.append(f"{where}: {size[0]:.2f} prior standard deviations from it before, {size[1]:.2f} after (root mean "
                "square)"
                + (f"; back: {', '.join(back)}" if back else "") + (f"; away: {', '.join(away)}" if away else ""))
    said += size_statements(content["added"], content["after"]["parameters"])
    return said + sampler_statements(content["sampler"], content["after"]["parameters"])


def size_statements(added: Sequence[dict], parameters: Sequence[dict]) -> list[str]:
    """Where the update of the mean gives a finding another size than the whole record did, or one that was there
    throughout ends at a bound."""
    rows, said = {p["name"]: p for p in parameters}, []
    for one in added:
        row = rows.get(one.get("parameter"))
        if one["as"] != "parameter" or row is None or one["time_profile"] not in ("constant", *CHANGES):
            continue
        change = one["time_profile"] in CHANGES
        size = row["map"] - row["prior"] + (one["size"] if change else 0.0)
        # at a bound it is the bound's, and its standard deviation says nothing of how far off that is
        bound = row["at_bound"] and not change
        if bound or abs(size - one["size"]) > APART * np.hypot(row["std"], one["size_std"]):
            why = ("the record shows it as a change, the mean after it only as one more share of an absolute value"
                   if change else "the mean lacks the tolerances that the diagnosis allows for")
            said.append(f"{row['name']}: found as {one['size']:.4g} +- {one['size_std']:.2g}, but {size:.4g} +- "
                        f"{row['std']:.2g}{', at a bound,' if bound else ''} by the update of the mean: "
                        f"{why}; take the found one")
    return said
