"""What no row of the catalogue explains, as elementary parts: a spring to ground or between two points, a mass, a mass
on springs.

The parts are added to the model on its small basis and found by the same search as everything else, one of each
kind at the prior odds of one row of the catalogue. They say where and in which modes the unknown acts, not what it is.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from probupdate.diagnosis.adequacy import ADEQUATE, adequacy
from probupdate.diagnosis.diagnose import Outcome, examine
from probupdate.diagnosis.elementary import (
    FITTED,
    OWN_RESPONSE,
    PART_CAUSES,
    PLACED_HEIGHTS,
    Part,
    parts_of,
    scores_of_parts,
)
from probupdate.diagnosis.evidence import sizes_std
from probupdate.diagnosis.expected import residuals_at
from probupdate.diagnosis.fitting import Fit, with_candidates
from probupdate.diagnosis.gain import measures
from probupdate.diagnosis.prepare import Prepared
from probupdate.diagnosis.problem import DiagnosisProblem, IncludedEffect
from probupdate.diagnosis.results import Finding
from probupdate.diagnosis.search import drawn_scores, search
from probupdate.diagnosis.small_model import Attachment, SmallModel, TunedMass
from probupdate.diagnosis.time_profiles import TimeProfile
from probupdate.effects.catalogue import Effect
from probupdate.errors import ConvergenceError
from probupdate.modal.modes import ModalData
from probupdate.model.parameters import Parameters
from probupdate.runtime.executors import SERIAL, Executor
from probupdate.runtime.progress import Progress, renamed, silent

# parts of each kind that the search is given: those that promise most beside the model as it is
N_KEPT = 40
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


def promising_parts(
    problem: DiagnosisProblem, fitted: Fit, parts: Sequence[Part]
) -> tuple[list[int], list[IncludedEffect]]:
    """Numbers of the parts that promise most to first order beside a fit, N_KEPT of each kind, and what to begin with,
    the FITTED best of each."""
    profiles = [time_profile for time_profile in problem.time_profiles if time_profile.kind in ("constant", "step")]
    gain, size, _ = scores_of_parts(problem, fitted, parts, profiles)
    order, kept, begun = np.argsort(-gain.max(axis=1), kind="stable"), set(), []
    for cause in PART_CAUSES:
        of_kind = [int(k) for k in order if parts[k][0].cause == cause]
        kept |= {*of_kind[:N_KEPT]}
        for k in parts_at_different_places(parts, of_kind, FITTED):
            c = int(np.argmax(gain[k]))
            if gain[k, c] > 0:
                begun.append(IncludedEffect(effect=parts[k][0], time_profile=profiles[c], size=0.0)
                             .with_start_size(size[k, c]))
            kept.add(k)
    return sorted(kept), begun


def parts_at_different_places(parts: Sequence[Part], order: Sequence[int], most: int) -> list[int]:
    """The first of these parts; of masses on springs the first of each place that move both ways, and one way."""
    first: dict[Hashable, int] = {}
    for k in order:
        key = parts[k][1].key
        first.setdefault(key if key.tuned_hz is None else (key.at, key.way is None), k)
        if len(first) == most:
            break
    return [*first.values()]


def with_tuned_mass(
    problem: DiagnosisProblem, part: Part, profile: TimeProfile, size: float
) -> tuple[DiagnosisProblem, TunedMass, IncludedEffect]:
    """The problem with a mass on springs, whose frequency is one more of the parameters; that mass in the model, and
    along a time profile to begin a fit with."""
    small = problem.predictor.small.attach_parts([part[1]])
    (hung,) = small.tuned
    return (replace(problem, predictor=replace(problem.predictor, small=small), effects=(*problem.effects, part[0]),
                    updated=(*problem.updated, hung.tuning), prior=_with_tunings(problem.prior, small)),
            hung, IncludedEffect(effect=part[0], time_profile=profile, size=0.0).with_start_size(size))


def model_with_parts(prepared: Prepared, parts: Sequence[Part]) -> Prepared:
    """The model with these parts as further effects; how masses on springs are tuned is estimated as its parameters
    are."""
    small = prepared.small.attach_parts([attachment for _, attachment in parts])
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
    kept, begun = promising_parts(known.problem, known.null, parts)
    wider = model_with_parts(prepared, [parts[k] for k in kept])
    try:
        outcome = examine(wider, data, most=MOST_PARTS, begun=begun, seed=seed, runs=runs,
                          progress=renamed(progress, "looking for elementary parts"))
    except ConvergenceError:
        return None
    if not any(n.effect.cause in PART_CAUSES for n in outcome.fitted.included):
        return None
    placed = {parts[k][0].key: parts[k][1] for k in kept}
    return FreeForm(prepared=wider, outcome=outcome, content=_content(outcome, placed))


def _content(outcome: Outcome, placed: Mapping[Hashable, Attachment]) -> dict:
    problem, fitted = outcome.problem, outcome.fitted
    std = sizes_std(problem, fitted)
    rows = []
    for number, (n, own, found) in enumerate(zip(fitted.included, std, outcome.proposed, strict=True)):
        rows.append(part_row(problem, n.effect, n.time_profile) | {
            "size": n.size, "size_std": own, **place_probabilities(found, placed),
            "modes": modes_moved(outcome, number), **tuned_frequency(outcome, n)})
    return {"parts": rows, "complete": outcome.diagnosis.verdict != "unexplained",
            "adequacy_p": outcome.diagnosis.adequacy_p}


def part_row(problem: DiagnosisProblem, effect: Effect, profile: TimeProfile) -> dict:
    """What diagnosis.json says of any part: what and where it is, since when."""
    return {"cause": effect.cause, "location": effect.location, "unit": effect.unit + profile.unit,
            "time_profile": profile.name, "since": problem.blocks.ids[profile.at] if profile.kind == "step" else "",
            "elementary": effect.cause in (*PART_CAUSES, OWN_RESPONSE)}


def channel_response_content(outcome: Outcome, *, seed: int = 1) -> dict:
    """What `free_form` says of elementary parts, of channels with a frequency response of their own."""
    own = outcome.own_response
    if own is None:
        raise ValueError("no channel of this outcome has a frequency response of its own")
    problem, fitted = own.problem, with_candidates(own.problem, own.fitted)
    profile = next(n.time_profile for n in fitted.included if n.effect.cause == OWN_RESPONSE)
    row = part_row(problem, own.row, profile) | {
        "posterior_probability": min(
            (a.posterior_probability for k in own.numbers for a in outcome.proposed[k].alternatives
             if a.key == own.row.key), default=own.probability),
        "check": own.row.check, "factors": own.factors(),
        "channels": [problem.blocks.channels[k] for k in own.row.channels_changed],
    }
    found = search(problem, fitted, seed=seed, heavier=outcome.first.heavier)
    p, _ = adequacy(problem, fitted, found, drawn_scores(fitted.design, seed))
    return {"parts": [row], "complete": p >= ADEQUATE, "adequacy_p": p,
            "gain": measures(problem, outcome.null, fitted, noise=outcome.null.design.noise)}


def place_probabilities(found: Finding, placed: Mapping[Hashable, Attachment]) -> dict:
    """The probability of a part's place, and what may be meant instead with more than POSSIBLE: masses on springs at
    one place are one, whatever their frequency. `placed`: the parts by the identity of their rows."""
    together: dict[Hashable, dict] = {}
    for f in (found, *found.alternatives):
        part = placed.get(f.key)
        key, where = (f.key, f.location) if part is None else (part.key.without_tuning, part.where)
        row = together.setdefault(key, {"cause": f.cause, "location": where, "posterior_probability": 0.0})
        row["posterior_probability"] += f.posterior_probability
    # the part itself stands first
    own, *others = together.values()
    return {"posterior_probability": own["posterior_probability"],
            "alternatives": sorted((row for row in others if row["posterior_probability"] > POSSIBLE),
                                   key=lambda row: -row["posterior_probability"])}


def tuned_frequency(outcome: Outcome, n: IncludedEffect) -> dict[str, float]:
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
