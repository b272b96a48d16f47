"""Modes that are in most sets and none of the model's, searched for with all other data.

Either the model lacks a mass on springs (a tuned mass, a machine, a second structure), which must have that mode with
its frequency and shape and leave all other modes as they are measured; or the mode is of something else, whose
frequency and shape say nothing. The second is the price of the first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from probupdate.diagnosis.adequacy import ADEQUATE, adequacy
from probupdate.diagnosis.blocks import FEWEST, find_unmatched_modes, mode_words, unmatched_words
from probupdate.diagnosis.diagnose import Outcome
from probupdate.diagnosis.elementary import FITTED, Part, tuned_masses_near
from probupdate.diagnosis.evidence import log_evidence, marginal_evidence, sizes_std
from probupdate.diagnosis.fitting import Fit, first_steps, fitted_without_candidates, noise_of, with_candidates
from probupdate.diagnosis.free_form import (
    POSSIBLE,
    modes_moved,
    part_row,
    parts_at_different_places,
    tuned_frequency,
    with_tuned_mass,
)
from probupdate.diagnosis.gain import measures
from probupdate.diagnosis.mode_numbers import modes_with
from probupdate.diagnosis.noise import Noise
from probupdate.diagnosis.part_places import PartKey
from probupdate.diagnosis.prepare import Prepared
from probupdate.diagnosis.problem import DISCREPANCY_PHASE, DiagnosisProblem, IncludedEffect, diagnosis_problem
from probupdate.diagnosis.ranking import log_prior
from probupdate.diagnosis.results import Diagnosis
from probupdate.diagnosis.search import drawn_scores, search
from probupdate.diagnosis.time_profiles import TimeProfile
from probupdate.errors import ConvergenceError
from probupdate.modal.joined_modes import join_modes
from probupdate.modal.modes import ModalData, ModeRecord, mac
from probupdate.runtime.executors import SERIAL, Executor
from probupdate.runtime.progress import Progress, silent

# frequencies at which a mass on springs is tried over the measured one, in ln f: they move from there
NEAR = (-0.1, 0.0, 0.1)
# masses on springs that go MORE_STEPS of a fit, from BEGUN_AT of their prior's standard deviation, and at how many
# places those that move along one direction do
N_AGAIN, MORE_STEPS, BEGUN_AT, N_ONE_WAY = 20, 4, 0.5, 4
# probability from which a mass on springs is said to be what has the mode
PROBABLE = 0.5
# probability with which sets before the first that has a mode have missed it, below which it began there
BY_CHANCE = 0.01


@dataclass(frozen=True, eq=False, kw_only=True)
class TunedMassFit:
    """A mass on springs fitted with a mode that is none of the model's as one more group: ln evidence of all modes."""

    part: Part
    problem: DiagnosisProblem
    fitted: Fit
    log_evidence: float


@dataclass(frozen=True, eq=False, kw_only=True)
class UnmatchedMode:
    """What is said of one mode: probabilities that a mass on springs has it (`of_mass`) and that it is the model's own,
    which was not recognised (`of_model`), the rest being something else; p of what a mass leaves (`adequacy_p`);
    `content` of diagnosis.json, empty where a mass does not explain the mode; `instead`: what was found is no more
    probable beside the mass than without it."""

    record: ModeRecord
    of_mass: float
    of_model: float
    adequacy_p: float
    content: dict
    instead: bool = False


def unmatched_modes(
    prepared: Prepared, known: Outcome, data: ModalData, *, seed: int = 1, runs: Executor = SERIAL,
    progress: Progress = silent,
) -> list[UnmatchedMode]:
    """Every mode that is none of the model's, by itself, beside what the diagnosis of all others (`known`) found."""
    ids = set(known.problem.blocks.ids)
    data, _ = join_modes(data)
    data = replace(data, sets=tuple(s for s in data.sets if s.id in ids))
    records = find_unmatched_modes(data)
    compared = len(known.problem.blocks.labels)
    if known.problem.blocks.few or compared >= prepared.small.n_search:
        return []
    result = []
    for number, record in enumerate(records):
        progress("modes that the model lacks", number, len(records))
        hz = tuple(float(record.frequency_hz * np.exp(shift)) for shift in NEAR)
        problem, parts = _with_mode(prepared, known, data, record.label), tuned_masses_near(prepared, hz)
        if problem is not None and parts:
            result.append(_explain_mode(known, problem, record, parts, seed=seed, runs=runs))
    return result


def _with_mode(prepared: Prepared, known: Outcome, data: ModalData, label: str) -> DiagnosisProblem | None:
    """The problem with that mode as one more group; None where too few sets have its frequency and its shape in all
    channels that are compared."""
    problem, _ = diagnosis_problem(prepared, data, (label,))
    blocks, before = problem.blocks, known.problem.blocks
    if (blocks.ids, blocks.channels) != (before.ids, before.channels) or label not in blocks.labels:
        return None
    if len(blocks.channels) < 2 or np.count_nonzero(problem.measured[1][group_of_label(problem, label)]) < FEWEST:
        return None
    return replace(problem, effects=known.problem.effects, which=known.problem.which,
                   time_profiles=known.problem.time_profiles)


def with_unmatched(found: Diagnosis, modes: Sequence[UnmatchedMode]) -> Diagnosis:
    """The diagnosis with what is said of modes that are none of the model's: where a mass on springs has one, the model
    lacks it, whatever else was found."""
    if not modes:
        return found
    notes = {unmatched_words(one.record): _words(one) for one in modes}
    explained = [one for one in modes if one.content]
    if any(one.instead for one in explained):
        found = found.left_unexplained()
    details = dict(found.details)
    if explained:
        details["free_form"] = explained[0].content | {
            "parts": [part for one in explained for part in one.content["parts"]]}
    return replace(found, details=details, notes=tuple(notes.get(note, note) for note in found.notes),
                   verdict="unexplained" if explained and found.verdict == "none" else found.verdict)


def _words(one: UnmatchedMode) -> str:
    known = unmatched_words(one.record)
    if one.content:
        return (f"{mode_words(one.record)}, has no counterpart in the model: a mass on springs explains it, with "
                f"probability {one.of_mass:.3g} over one of the model's own and something else")
    if one.of_model >= PROBABLE:
        return (f"{mode_words(one.record)}, was taken for none of the model's and is not compared; with all other "
                f"data it is one that no measured mode was recognised as (probability {one.of_model:.3g})")
    if one.of_mass < PROBABLE:
        return f"{known}; no mass on springs at any of the places tried has its frequency and shape"
    return (f"{known}; a mass on springs comes near it, but leaves more than chance allows "
            f"(p = {one.adequacy_p:.2g})")


def _explain_mode(
    known: Outcome, problem: DiagnosisProblem, record: ModeRecord, parts: Sequence[Part], *, seed: int, runs: Executor,
) -> UnmatchedMode:
    profile = _beginning_profile(problem, record.label)
    there = np.flatnonzero(profile.value > 0)
    noise = noise_of_sets(problem).select_blocks(there)
    stepped = initialise_tuned_mass(problem.select_blocks(there), noise, parts, runs)
    begun = [(parts[k], size) for k in parts_at_different_places(parts, [*stepped], FITTED)
             for size in (stepped[k], BEGUN_AT * parts[k][0].prior_scale)]
    shared = problem, _effects_found(known), profile
    found = [one for one in runs.in_order(_fit_with_part, begun, shared=shared) if one is not None]
    if not found:
        return UnmatchedMode(record=record, of_mass=0.0, of_model=0.0, adequacy_p=0.0, content={})
    best = max(found, key=lambda one: one.log_evidence)
    best, instead = _substitute_for_findings(problem, best)
    noise = best.fitted.design.noise
    # one place and direction begun twice is one
    value: dict[PartKey, float] = {}
    for one in found:
        evidence = marginal_evidence(one.problem, one.fitted.theta, one.fitted.included, noise)
        value[one.part[1].key] = max(value.get(one.part[1].key, -np.inf), evidence)
    with_it = float(special.logsumexp([*value.values()]) - np.log(len(parts)))
    of_mass, of_model, _ = special.softmax([with_it, *_evidence_without_mass(known, problem, noise, record.label)])
    scored = with_candidates(best.problem, best.fitted)
    left = search(best.problem, scored, seed=seed, heavier=known.first.heavier)
    p, _ = adequacy(best.problem, scored, left, drawn_scores(scored.design, seed))
    where = {one.part[1].key.without_tuning: one.part[1].where for one in found}
    content = _content(known, best, record, value, where) if of_mass >= PROBABLE and p >= ADEQUATE else {}
    return UnmatchedMode(record=record, of_mass=float(of_mass), of_model=float(of_model), adequacy_p=p, instead=instead,
                         content=content and {**content, "complete": True, "adequacy_p": p})


def _substitute_for_findings(
    problem: DiagnosisProblem, best: TunedMassFit
) -> tuple[TunedMassFit, bool]:
    """The mass with what was found beside it, or by itself where that is as probable: a row of the catalogue may have
    stood for what the mass does to the other modes."""
    beside = best.fitted.included[:-1]
    n = best.fitted.included[-1]
    alone = _fit_with_part(problem, (), n.time_profile, best.part, n.size, best.fitted.theta) if beside else None
    if alone is None:
        return best, False
    noise = best.fitted.design.noise
    value = [marginal_evidence(one.problem, one.fitted.theta, one.fitted.included, noise) for one in (best, alone)]
    candidates = [next(k for k, (j, c) in enumerate(problem.which)
                       if problem.effects[j] is x.effect and problem.time_profiles[c].name == x.time_profile.name)
                  for x in beside]
    if value[1] < value[0] + log_prior(problem, candidates):
        return best, False
    return alone, True


def _evidence_without_mass(known: Outcome, problem: DiagnosisProblem, noise: Noise, label: str) -> tuple[float, float]:
    """ln evidence of all modes without a mass: where that of this label is the model's own, one that is left by all
    others, and where it is of something else."""
    number = group_of_label(problem, label)
    others = noise.of_groups([q for q in range(len(noise.weight)) if q != number])
    elsewhere = marginal_evidence(known.problem, known.fitted.theta, known.fitted.included, others)
    try:
        own = fitted_without_candidates(problem, known.fitted.theta, _effects_found(known))
        of_model = marginal_evidence(problem, own.theta, own.included, noise)
    except ConvergenceError:
        of_model = -np.inf
    return of_model, elsewhere + anywhere(problem, noise, number)


def group_of_label(problem: DiagnosisProblem, label: str) -> int:
    """Number of the group of modes that has this label."""
    return next(q for q in range(len(problem.blocks.groups)) if problem.blocks.group_name(q) == label)


def _effects_found(known: Outcome) -> tuple[IncludedEffect, ...]:
    """What was found beside the mode; what does not explain the record is nothing."""
    return () if known.diagnosis.verdict == "unexplained" else known.fitted.included


def _beginning_profile(problem: DiagnosisProblem, label: str) -> TimeProfile:
    """The step with which a mode begins, the constant where sets before its first one may have missed it by chance."""
    blocks = problem.blocks
    found = blocks.have((blocks.labels.index(label),))
    first = int(np.argmax(found))
    missed = 1.0 - float(np.mean(found[first:]))
    steps = [profile for profile in problem.time_profiles if profile.kind == "step"]
    if steps and first and missed**first < BY_CHANCE:
        return min(steps, key=lambda profile: abs(profile.at - first))
    return next(profile for profile in problem.time_profiles if profile.kind == "constant")


def noise_of_sets(problem: DiagnosisProblem) -> Noise:
    """From the sets' own scatter: whatever is expected of them does not change from one set to the next."""
    return noise_of(problem, tuple(np.where(used[:, None], y, 0.0) for y, used in zip(*problem.measured, strict=True)))


def initialise_tuned_mass(
    problem: DiagnosisProblem, noise: Noise, parts: Sequence[Part], runs: Executor = SERIAL
) -> dict[int, float]:
    """Numbers of masses on springs that are there throughout, by what the first steps of a fit with each of them
    explain, the most telling first, and the masses to which they lead: at the blocks of one heading, from where the
    prior expects the parameters.

    A mode more, and modes that are shared by two, are nowhere near linear in the mass, and in the fit without it all
    else is bent to follow (beside a step what was there before it holds the fit). Those that move both ways go one
    step, at every place and every second frequency (where none does, those that move one way); where they explain most
    they go some more, and those that move along one direction too.
    """
    rows = blocks_at_one_heading(problem)
    shared = problem.select_blocks(rows), noise.select_blocks(rows)
    hung: dict[PartKey, list[int]] = {}
    for k, part in enumerate(parts):
        if part[1].tuned_hz is not None:
            hung.setdefault(part[1].key.without_tuning, []).append(k)

    def steps(numbers: Sequence[int], count: int) -> list[tuple[float, int, float, float]]:
        found = zip(numbers, runs.in_order(_fit_tuned_mass, [(parts[k], count) for k in numbers], shared=shared),
                    strict=True)
        return sorted((one[0], k, *one[1:]) for k, one in found if one is not None)

    both_ways = any(key.way is None for key in hung)
    first = steps([k for key, own in hung.items() if key.way is None or not both_ways for k in own[::2]], 1)
    again = [k for _, k, _, _ in first[:N_AGAIN]]
    best: dict[tuple[int, ...], float] = {}
    for _, k, _, hz in first:
        best.setdefault(parts[k][1].key.at, hz)
    for at, hz in [*best.items()][:N_ONE_WAY]:
        for own in (own for key, own in hung.items() if key.at == at and key.way is not None):
            again.append(min(own, key=lambda k: abs(np.log((parts[k][1].tuned_hz or 0.0) / hz))))
    return {k: size for _, k, size, _ in steps(again, MORE_STEPS)}


def blocks_at_one_heading(problem: DiagnosisProblem) -> np.ndarray:
    """Numbers of the blocks of the heading at which most are known."""
    _, bin_of = problem.bins
    return np.flatnonzero(bin_of == np.argmax(np.bincount(bin_of)))


def _fit_tuned_mass(
    problem: DiagnosisProblem, noise: Noise, part: Part, count: int
) -> tuple[float, float, float] | None:
    """-2 ln posterior, mass and frequency where so many steps with a mass on springs lead; None where the model has no
    modes there."""
    constant = next(profile for profile in problem.time_profiles if profile.kind == "constant")
    alone, hung, n = with_tuned_mass(problem, part, constant, BEGUN_AT * part[0].prior_scale)
    try:
        theta, (n,), misfit = first_steps(alone, np.array(alone.predictor.parameters.initial), [n], noise, count)
    except ConvergenceError:
        return None
    return misfit, n.size, hung.hz * float(np.exp(theta[hung.tuning]))


def _fit_with_part(
    problem: DiagnosisProblem, included: Sequence[IncludedEffect], profile: TimeProfile, part: Part, size: float,
    theta: np.ndarray | None = None,
) -> TunedMassFit | None:
    """From theta, or where the prior expects the parameters; None where the model has no modes on the way."""
    wider, _, n = with_tuned_mass(problem, part, profile, size)
    try:
        fitted = fitted_without_candidates(wider, wider.predictor.parameters.initial if theta is None else theta,
                                           (*included, n))
    except ConvergenceError:
        return None
    return TunedMassFit(part=part, problem=wider, fitted=fitted, log_evidence=log_evidence(wider, fitted))


def anywhere(problem: DiagnosisProblem, noise: Noise, number: int) -> float:
    """ln p of a group of one mode that is of something else, as `log_evidence` counts: any frequency among those
    compared is as probable, any direction of its shape too."""
    y, used = problem.measured[0][number], problem.measured[1][number]
    (own,) = problem.blocks.groups[number]
    hz = np.nanmedian(problem.blocks.frequency_hz, axis=0)
    others = np.log(np.delete(hz, own))
    reach = max(float(np.ptp(np.append(others, np.log(hz[own])))), 1.0)
    axis = problem.predictor.axes[number][:, 0]
    n = len(axis)
    root = np.zeros((y.shape[1], y.shape[1]))
    # normal densities that are where it was measured as dense as the uniform ones
    root[0, 0] = reach / np.sqrt(2 * np.pi)
    if n > 1:
        half_sphere = np.pi ** (n / 2) / special.gamma(n / 2)
        std = (np.linalg.norm(axis) ** (n - 1) * half_sphere) ** (1 / (n - 1)) / np.sqrt(2 * np.pi)
        root[1 : 1 + n, 1 : 1 + n] = std * (np.eye(n) - np.outer(axis, axis) / (axis @ axis))
        root[1 + n :, 1 + n :] = DISCREPANCY_PHASE * np.eye(n)
    weight = np.where(used, noise.weight[number], 0.0)
    y = y - np.array([np.average(y[:, 0], weights=weight), *np.zeros(y.shape[1] - 1)])
    P = noise.precision[number]
    score = root.T @ P @ (weight @ y)
    information = np.eye(len(root)) + weight.sum() * root.T @ P @ root
    misfit = float(np.sum((y @ P) * y, axis=1) @ weight - score @ np.linalg.solve(information, score))
    there = weight[weight > 0]
    log_noise = len(there) * np.linalg.slogdet(noise.covariance[number])[1] - y.shape[1] * np.sum(np.log(there))
    return float(-0.5 * (misfit + np.linalg.slogdet(information)[1] + log_noise))


def _content(
    known: Outcome, best: TunedMassFit, record: ModeRecord, value: dict[PartKey, float], where: dict[PartKey, str]
) -> dict:
    """What `free_form` says of elementary parts, of the mass on springs that has a mode; what it gains in the modes
    that the model has. `where`: words for the places."""
    problem, fitted = best.problem, best.fitted
    n, std = fitted.included[-1], sizes_std(problem, fitted)[-1]
    total = special.logsumexp([*value.values()])
    places: dict[PartKey, float] = {}
    for key, own in value.items():
        places[key.without_tuning] = places.get(key.without_tuning, 0.0) + float(np.exp(own - total))
    here = best.part[1].key.without_tuning
    number = group_of_label(problem, record.label)
    used = problem.measured[1][number]
    expected = np.mean((problem.measured[0][number] - fitted.residuals[number])[used], axis=0)
    axes = problem.predictor.axes[number]
    computed = modes_with(expected, axes)
    outcome = replace(known, problem=problem, fitted=fitted)
    row = part_row(problem, n.effect, n.time_profile) | {
        "location": where[here], "size": n.size, "size_std": std,
        "posterior_probability": places.pop(here),
        "alternatives": [{"cause": n.effect.cause, "location": where[place], "posterior_probability": p}
                         for place, p in sorted(places.items(), key=lambda pair: -pair[1]) if p > POSSIBLE],
        **tuned_frequency(outcome, n),
        "has_mode": {"label": record.label, "frequency_hz": record.frequency_hz,
                     "computed_hz": float(np.exp(computed.tensor[0, 0])),
                     "mac": float(mac(axes, computed.shape)[0, 0])},
    }
    # how it moves the modes that the model has, and predicts them
    one = _fit_with_part(known.problem, fitted.included[:-1], n.time_profile, best.part, n.size, fitted.theta)
    if one is None:
        return {"parts": [row]}
    moved = modes_moved(replace(known, problem=one.problem, fitted=one.fitted), len(one.fitted.included) - 1)
    gain = measures(known.problem, known.null, one.fitted, noise=known.null.design.noise)
    return {"parts": [row | {"modes": moved}], "gain": gain}
