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

from probupdate.diagnosis.diagnose import Outcome, examine
from probupdate.diagnosis.elementary import PART_CAUSES, Part, hung_at_size, parts_of, scores_of_parts
from probupdate.diagnosis.evidence import sizes_std
from probupdate.diagnosis.expected import residuals_at
from probupdate.diagnosis.fitting import Fit
from probupdate.diagnosis.prepare import Prepared
from probupdate.diagnosis.problem import DiagnosisProblem, IncludedEffect
from probupdate.diagnosis.time_profiles import TimeProfile
from probupdate.errors import ConvergenceError
from probupdate.modal.modes import ModalData
from probupdate.model.parameters import Parameters
from probupdate.runtime.executors import SERIAL, Executor
from probupdate.runtime.progress import Progress, silent

# parts of each kind that the search is given: those that promise most beside the model as it is
N_KEPT = 40
# masses on springs from whose own size the search begins, each at another place
N_BEGUN = 6
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
    problem: DiagnosisProblem, fitted: Fit, parts: Sequence[Part]
) -> tuple[list[int], list[IncludedEffect]]:
    """Numbers of the parts that promise most beside a fit, N_KEPT of each kind to first order, and of masses on springs
    as many again at their own size; the N_BEGUN of these that explain most, to begin with."""
    profiles = [time_profile for time_profile in problem.time_profiles if time_profile.kind in ("constant", "step")]
    gain, _, _ = scores_of_parts(problem, fitted, parts, profiles)
    order = np.argsort(-gain.max(axis=1), kind="stable")
    kept = {int(k) for cause in PART_CAUSES for k in [k for k in order if parts[k][0].cause == cause][:N_KEPT]}
    step = max((c for c in range(len(profiles)) if profiles[c].kind == "step"), key=lambda c: gain[:, c].max(),
               default=None)
    along = [p for c, p in enumerate(profiles) if p.kind == "constant" or c == step]
    begun: dict[int, IncludedEffect] = {}
    # a strong one bends the fit without it, whose frequencies may all the same be nearer than the prior's
    for theta in (problem.predictor.parameters.initial, fitted.theta):
        try:
            tried = hung_at_size(problem, theta, parts, along)
        except ConvergenceError:
            # where the model has no modes there that pair with the measured ones
            continue
        kept |= {k for _, k, _, _ in tried[:N_KEPT // 2]}
        best: dict[str, tuple[float, int, float, TimeProfile]] = {}
        for one in tried:
            best.setdefault(parts[one[1]][0].location.rsplit(", ", 2)[0], one)
        begun |= {k: IncludedEffect(effect=parts[k][0], time_profile=profile, size=size)
                  for _, k, size, profile in [*best.values()][:N_BEGUN]}
    return sorted(kept.union(begun)), [*begun.values()]


def prepared_with(prepared: Prepared, parts: Sequence[Part]) -> Prepared:
    """The model with these parts as further effects; how masses on springs are tuned is estimated as its parameters
    are."""
    small = prepared.small.attached([attachment for _, attachment in parts])
    tunings = tuple(one.tuning for one in small.tuned)
    prior = Parameters((*prepared.prior.items, *(small.parameters.items[k] for k in tunings)),
                       None if prepared.prior.correlation is None
                       else linalg.block_diag(prepared.prior.correlation, np.eye(len(tunings))))
    return replace(prepared, small=small, prior=prior, updated=(*prepared.updated, *tunings),
                   effects=(*prepared.effects, *(effect for effect, _ in parts)))


def free_form(
    prepared: Prepared, known: Outcome, data: ModalData, *, seed: int = 1, runs: Executor = SERIAL,
    progress: Progress = silent,
) -> FreeForm | None:
    """The same search with elementary parts in the catalogue; None where the model has no picture to place them in, or
    where none of them is taken in. `known`: what the catalogue made of the record."""
    parts = parts_of(prepared, on_springs=True)
    if not parts:
        return None
    kept, begun = most_promising(known.problem, known.null, parts)
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
    for number, (n, own) in enumerate(zip(fitted.included, std, strict=True)):
        step = n.time_profile.kind == "step"
        rows.append({
            "cause": n.effect.cause, "location": n.effect.location, "size": n.size, "size_std": own,
            "unit": n.effect.unit + n.time_profile.unit, "time_profile": n.time_profile.name,
            "since": problem.blocks.ids[n.time_profile.at] if step else "", "elementary": n.effect.cause in PART_CAUSES,
            "modes": modes_moved(outcome, number), **_tuned(outcome, n),
        })
    return {"parts": rows, "complete": outcome.diagnosis.verdict != "unexplained",
            "adequacy_p": outcome.diagnosis.adequacy_p}


def _tuned(outcome: Outcome, n: IncludedEffect) -> dict[str, float]:
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
