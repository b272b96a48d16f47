"""What no row of the catalogue explains, as elementary parts: a spring to ground or between two points, a mass, a mass
on springs.

The parts are added to the model on its small basis and found by the same search as everything else, one of each
kind at the prior odds of one row of the catalogue. They say where and in which modes the unknown acts, not what it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from probupdate.diagnosis.adequacy import ADEQUATE, adequacy
from probupdate.diagnosis.diagnose import Outcome, examine
from probupdate.diagnosis.elementary import (
    BOTH_WAYS,
    FITTED,
    OWN_RESPONSE,
    PART_CAUSES,
    PLACED_HEIGHTS,
    Part,
    parts_of,
    place_and_direction,
    scores_of_parts,
)
from probupdate.diagnosis.evidence import sizes_std
from probupdate.diagnosis.expected import residuals_at
from probupdate.diagnosis.fitting import Fit, first_steps, with_candidates
from probupdate.diagnosis.gain import measures
from probupdate.diagnosis.noise import Noise
from probupdate.diagnosis.prepare import Prepared
from probupdate.diagnosis.problem import DiagnosisProblem, IncludedEffect
from probupdate.diagnosis.results import Finding
from probupdate.diagnosis.search import drawn_scores, search
from probupdate.diagnosis.small_model import SmallModel, TunedMass
from probupdate.diagnosis.time_profiles import TimeProfile
from probupdate.errors import ConvergenceError
from probupdate.modal.modes import ModalData
from probupdate.model.parameters import Parameters
from probupdate.runtime.executors import SERIAL, Executor
from probupdate.runtime.progress import Progress, silent

# parts of each kind that the search is given: those that promise most beside the model as it is
N_KEPT = 40
# masses on springs with which the search begins, beside FITTED of each kind that promise most to first order
N_BEGUN = 8
# masses on springs that go MORE_STEPS of a fit, from BEGUN_AT of their prior's standard deviation, and at how many
# places those that move along one direction do
N_AGAIN, MORE_STEPS, BEGUN_AT, N_ONE_WAY = 20, 4, 0.5, 4
# probability from which what may be meant instead of a part is said
POSSIBLE = 0.05
# parts at once
MOST_PARTS = 2
# a mode is acted on where its ln f moves by so many standard deviations of a block's
ACTS = 1.0


@dataclass(frozen=True, eq=False, kw_only=True)
class FreeForm:
    """The model with elementary parts, fitted: `outcome` of the search with them, `prepared` with them, `content` plain
    numbers for diagnosis.json."""

    prepared: Prepared
    outcome: Outcome
    content: dict


def most_promising(
    problem: DiagnosisProblem, fitted: Fit, parts: Sequence[Part], runs: Executor = SERIAL
) -> tuple[list[int], list[IncludedEffect]]:
    """Numbers of the parts that promise most, N_KEPT of each kind, and what to begin with, the FITTED best of each:
    to first order beside a fit, and masses on springs that are there throughout by the first steps of fits with them
    too (half of the kept, N_BEGUN)."""
    profiles = [time_profile for time_profile in problem.time_profiles if time_profile.kind in ("constant", "step")]
    gain, size, _ = scores_of_parts(problem, fitted, parts, profiles)
    order, kept, begun = np.argsort(-gain.max(axis=1), kind="stable"), set(), []

    def included(k: int, profile: TimeProfile, own: float) -> IncludedEffect:
        return IncludedEffect(effect=parts[k][0], time_profile=profile, size=0.0).begun_at(own)

    for cause in PART_CAUSES:
        of_kind = [int(k) for k in order if parts[k][0].cause == cause]
        hung = bool(of_kind) and parts[of_kind[0]][1].tuned_hz is not None
        kept |= {*of_kind[: N_KEPT // 2 if hung else N_KEPT]}
        for k in at_different_places(parts, of_kind, FITTED):
            c = int(np.argmax(gain[k]))
            begun += [included(k, profiles[c], size[k, c])] if gain[k, c] > 0 else []
            kept.add(k)
    stepped = hung_at_first_steps(problem, fitted.design.noise, parts, runs)
    kept |= {*[*stepped][: N_KEPT // 2]}
    constant = next(profile for profile in profiles if profile.kind == "constant")
    for k in at_different_places(parts, [*stepped], N_BEGUN):
        # steps may lead to a mass of a few kilograms that shares a mode: from where they began a fit may lead elsewhere
        begun += [included(k, constant, own) for own in (stepped[k], BEGUN_AT * parts[k][0].prior_scale)]
        kept.add(k)
    return sorted(kept), begun


def at_different_places(parts: Sequence[Part], order: Sequence[int], most: int) -> list[int]:
    """The first of these parts; of masses on springs the first of each place that move both ways, and one way."""
    first: dict[tuple, int] = {}
    for k in order:
        hung = parts[k][1].tuned_hz is not None
        place, way = place_and_direction(parts[k][0].location) if hung else (parts[k][0].location, "")
        first.setdefault((place, way == BOTH_WAYS), k)
        if len(first) == most:
            break
    return [*first.values()]


def hung_at_first_steps(
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
    rows = at_one_heading(problem)
    shared = problem.taken(rows), noise.taken(rows)
    hung: dict[tuple[str, str], list[int]] = {}
    for k, part in enumerate(parts):
        if part[1].tuned_hz is not None:
            hung.setdefault(place_and_direction(part[0].location), []).append(k)

    def steps(numbers: Sequence[int], count: int) -> list[tuple[float, int, float, float]]:
        found = zip(numbers, runs.in_order(_stepped, [(parts[k], count) for k in numbers], shared=shared), strict=True)
        return sorted((one[0], k, *one[1:]) for k, one in found if one is not None)

    both_ways = any(way == BOTH_WAYS for _, way in hung)
    first = steps([k for (_, way), own in hung.items() if way == BOTH_WAYS or not both_ways for k in own[::2]], 1)
    again = [k for _, k, _, _ in first[:N_AGAIN]]
    best: dict[str, float] = {}
    for _, k, _, hz in first:
        best.setdefault(place_and_direction(parts[k][0].location)[0], hz)
    for place, hz in [*best.items()][:N_ONE_WAY]:
        for own in (own for (there, way), own in hung.items() if there == place and way != BOTH_WAYS):
            again.append(min(own, key=lambda k: abs(np.log((parts[k][1].tuned_hz or 0.0) / hz))))
    return {k: size for _, k, size, _ in steps(again, MORE_STEPS)}


def at_one_heading(problem: DiagnosisProblem) -> np.ndarray:
    """Numbers of the blocks of the heading at which most are known."""
    _, bin_of = problem.bins
    return np.flatnonzero(bin_of == np.argmax(np.bincount(bin_of)))


def _stepped(
    problem: DiagnosisProblem, noise: Noise, part: Part, count: int
) -> tuple[float, float, float] | None:
    """-2 ln posterior, mass and frequency where so many steps with a mass on springs lead; None where the model has no
    modes there."""
    constant = next(profile for profile in problem.time_profiles if profile.kind == "constant")
    alone, hung, n = with_hung(problem, part, constant, BEGUN_AT * part[0].prior_scale)
    try:
        theta, (n,), misfit = first_steps(alone, np.array(alone.predictor.parameters.initial), [n], noise, count)
    except ConvergenceError:
        return None
    return misfit, n.size, hung.hz * float(np.exp(theta[hung.tuning]))


def with_hung(
    problem: DiagnosisProblem, part: Part, profile: TimeProfile, size: float
) -> tuple[DiagnosisProblem, TunedMass, IncludedEffect]:
    """The problem with a mass on springs, whose frequency is one more of the parameters; that mass in the model, and
    along a time profile to begin a fit with."""
    small = problem.predictor.small.attached([part[1]])
    (hung,) = small.tuned
    return (replace(problem, predictor=replace(problem.predictor, small=small), effects=(*problem.effects, part[0]),
                    updated=(*problem.updated, hung.tuning), prior=_with_tunings(problem.prior, small)),
            hung, IncludedEffect(effect=part[0], time_profile=profile, size=0.0).begun_at(size))


def prepared_with(prepared: Prepared, parts: Sequence[Part]) -> Prepared:
    """The model with these parts as further effects; how masses on springs are tuned is estimated as its parameters
    are."""
    small = prepared.small.attached([attachment for _, attachment in parts])
    return replace(prepared, small=small, prior=_with_tunings(prepared.prior, small),
                   updated=(*prepared.updated, *(one.tuning for one in small.tuned)),
                   effects=(*prepared.effects, *(effect for effect, _ in parts)))


def _with_tunings(prior: Parameters, small: SmallModel) -> Parameters:
    """The prior of the updated parameters with those of how masses on springs are tuned."""
    own = [small.parameters.items[one.tuning] for one in small.tuned]
    correlation = prior.correlation
    if correlation is not None:
        correlation = linalg.block_diag(correlation, np.eye(len(own)))
    return Parameters((*prior.items, *own), correlation)


def free_form(
    prepared: Prepared, known: Outcome, data: ModalData, *, seed: int = 1, runs: Executor = SERIAL,
    progress: Progress = silent,
) -> FreeForm | None:
    """The same search with elementary parts in the catalogue; None where the model has no picture to place them in, or
    where none of them is taken in. `known`: what the catalogue made of the record."""
    parts = parts_of(prepared, heights=PLACED_HEIGHTS)
    if not parts:
        return None
    kept, begun = most_promising(known.problem, known.null, parts, runs)
    wider = prepared_with(prepared, [parts[k] for k in kept])
    try:
        outcome = examine(wider, data, most=MOST_PARTS, begun=begun, seed=seed, runs=runs, progress=progress)
    except ConvergenceError:
        return None
    if not any(n.effect.cause in PART_CAUSES for n in outcome.fitted.included):
        return None
    return FreeForm(prepared=wider, outcome=outcome, content=_content(outcome))


def _content(outcome: Outcome) -> dict:
    problem, fitted = outcome.problem, outcome.fitted
    std = sizes_std(problem, fitted)
    rows = []
    for number, (n, own, found) in enumerate(zip(fitted.included, std, outcome.proposed, strict=True)):
        step = n.time_profile.kind == "step"
        rows.append({
            "cause": n.effect.cause, "location": n.effect.location, "size": n.size, "size_std": own,
            "unit": n.effect.unit + n.time_profile.unit, "time_profile": n.time_profile.name,
            "since": problem.blocks.ids[n.time_profile.at] if step else "", "elementary": n.effect.cause in PART_CAUSES,
            **by_place(found), "modes": modes_moved(outcome, number), **tuned(outcome, n),
        })
    return {"parts": rows, "complete": outcome.diagnosis.verdict != "unexplained",
            "adequacy_p": outcome.diagnosis.adequacy_p}


def own_response_content(outcome: Outcome, *, seed: int = 1) -> dict:
    """What `free_form` says of elementary parts, of channels with a frequency response of their own."""
    own = outcome.own_response
    if own is None:
        raise ValueError("no channel of this outcome has a frequency response of its own")
    problem, fitted = own.problem, with_candidates(own.problem, own.fitted)
    profile = next(n.time_profile for n in fitted.included if n.effect.cause == OWN_RESPONSE)
    row = {
        "cause": own.row.cause, "location": own.row.location, "unit": "-", "time_profile": profile.name,
        "since": problem.blocks.ids[profile.at] if profile.kind == "step" else "", "elementary": True,
        "posterior_probability": min(
            (a.posterior_probability for k in own.numbers for a in outcome.proposed[k].alternatives
             if (a.cause, a.location) == (own.row.cause, own.row.location)), default=own.probability),
        "check": own.row.check, "factors": own.factors(),
    }
    found = search(problem, fitted, seed=seed, heavier=outcome.first.heavier)
    p, _ = adequacy(problem, fitted, found, drawn_scores(fitted.design, seed))
    return {"parts": [row], "complete": p >= ADEQUATE, "adequacy_p": p,
            "gain": measures(problem, outcome.null, fitted, noise=outcome.null.design.noise)}


def by_place(found: Finding) -> dict:
    """The probability of a part's place, and what may be meant instead with more than POSSIBLE: masses on springs at
    one place are one, whatever their frequency."""
    probability: dict[tuple[str, str], float] = {}
    for f in (found, *found.alternatives):
        key = f.cause, ", ".join(place_and_direction(f.location)) if f.cause == PART_CAUSES[3] else f.location
        probability[key] = probability.get(key, 0.0) + f.posterior_probability
    # the part itself stands first
    own = probability.pop(next(iter(probability)))
    return {"posterior_probability": own,
            "alternatives": [{"cause": cause, "location": location, "posterior_probability": p}
                             for (cause, location), p in sorted(probability.items(), key=lambda pair: -pair[1])
                             if p > POSSIBLE]}


def tuned(outcome: Outcome, n: IncludedEffect) -> dict[str, float]:
    """The frequency of a mass on springs as fitted, and its standard deviation."""
    problem, fitted = outcome.problem, outcome.fitted
    small = problem.predictor.small
    one = next((t for t in small.tuned if small.parameters.names[t.column] == n.effect.parameter), None)
    if one is None:
        return {}
    hz = one.hz * float(np.exp(fitted.theta[one.tuning]))
    variance = fitted.design.unknowns_cov([problem.updated.index(one.tuning)])[0, 0]
    return {"frequency_hz": hz, "frequency_std_hz": hz * float(np.sqrt(variance))}


def modes_moved(outcome: Outcome, number: int) -> list[dict]:
    """By how much an effect of the fit moves each group of modes (mean ln f in per cent, where it acts), the largest
    first, of those that move by more than a block scatters."""
    problem, fitted = outcome.problem, outcome.fitted
    n = fitted.included[number]
    if not n.exact:
        return []
    others = [x for k, x in enumerate(fitted.included) if k != number and x.exact]
    with_it, without = (residuals_at(problem, fitted.theta, included) for included in ([*others, n], others))
    acting = np.flatnonzero(n.time_profile.value > 0.5)
    rows = []
    for q, (a, b) in enumerate(zip(with_it, without, strict=True)):
        k = len(problem.blocks.groups[q])
        there = [i for i in acting if fitted.design.noise.weight[q][i] > 0]
        if not there:
            continue
        change = float(np.mean((b - a)[there][:, :k]))
        std = float(np.sqrt(np.mean(np.diag(fitted.design.noise.covariance[q])[:k])))
        if abs(change) > ACTS * std:
            rows.append({"mode": problem.blocks.group_name(q), "frequency_percent": 100 * change})
    return sorted(rows, key=lambda r: -abs(r["frequency_percent"]))
