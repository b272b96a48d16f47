"""What is very wrong, tried at its own size.

A frame turned by twenty degrees or two exchanged channels are nowhere near linear: the fit without them bends its
parameters to follow, and the scores there favour whatever is left. Sensors see all modes alike, so that a size costs no
new modes and every one can be tried; of the structure, whose sizes cost modes, those that promise most to first order.
Everything else that is unknown follows to first order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from probupdate.diagnosis.expected import ModelAnswers, residuals_at, residuals_of_sizes
from probupdate.diagnosis.fitting import kept, linearised, noise_of
from probupdate.diagnosis.linear import Design
from probupdate.diagnosis.predictor import MATE
from probupdate.diagnosis.problem import DiagnosisProblem, IncludedEffect
from probupdate.diagnosis.search import gains
from probupdate.effects.catalogue import Effect
from probupdate.errors import ConvergenceError

# of an effect's prior scale: a gain of 20, half a turn
DOUBLINGS = 7
# of -2 ln posterior that another one explains beside the best, for both to be estimated together; turns taken at that
ANOTHER, MOST_TURNS = 400.0, 6
# effects of the structure that are solved at their own size, the best to first order; of frequencies alone, which say
# less to first order
MOST_SOLVED, MOST_SOLVED_ALONE = 6, 12


@dataclass(frozen=True, eq=False, kw_only=True)
class Tried:
    """A candidate with the size that explains most, and by how much it lowers -2 ln posterior with the scale of all
    noise as the record then asks for. `whole`: at that size itself, not to first order."""

    candidate: int
    size: float
    gain: float
    whole: bool


def sizes_of(effect: Effect) -> list[float]:
    """What is tried: the only size, or one, two, four ... of the effect's standard deviations either way within its
    bounds."""
    if effect.discrete:
        return list(effect.discrete)
    steps = effect.prior_scale * 2.0 ** np.arange(DOUBLINGS + 1)
    return [float(s) for s in (*-steps[::-1], *steps) if effect.lower <= s <= effect.upper]


def tried_whole(problem: DiagnosisProblem, included: Sequence[IncludedEffect], candidates: np.ndarray) -> list[Tried]:
    """The `candidates` (bool) beside what is included already, each effect's best time profile of every kind, the most
    telling first. All where the prior expects the parameters, as those of a fit were bent to follow what is wrong."""
    theta = np.array(problem.predictor.parameters.initial)
    answers = ModelAnswers(problem.predictor)
    here = residuals_at(problem, theta, included, answers)
    noise = noise_of(problem, here)
    design, residuals, centred = linearised(problem, theta, included, noise, here)
    centre = [y - c for y, c in zip(residuals, centred, strict=True)]
    count = sum(
        int(np.count_nonzero(w > 0)) * f.size for w, f in zip(noise.weight, problem.discrepancy_std, strict=True)
    )

    def surprise(each: Sequence[Sequence[IncludedEffect]]) -> np.ndarray:
        """-2 ln posterior with the scale of all noise as it then must be, but for a constant."""
        left = kept(residuals_of_sizes(problem, theta, each, answers), noise)
        return count * np.log(design.misfits(tuple(y - c for y, c in zip(left, centre, strict=True)), []))

    misfit, before = design.misfit(centred, []), surprise([included])[0]
    size, lower = _linear(problem, design, centred)
    exchanged = _pairs_exchanged(problem, theta, centred)
    if exchanged is not None:
        other, more = _linear(problem, design, exchanged)
        size, lower = np.where(more > lower, other, size), np.maximum(more, lower)
    linear = count * (np.log(misfit) - np.log(np.maximum(misfit - lower, 1e-9 * misfit)))

    def at_its_size(k: int, sizes: Sequence[float]) -> Tried:
        effect, time_profile = problem.effects[problem.which[k, 0]], problem.time_profiles[problem.which[k, 1]]
        gain = before - surprise([(*included, IncludedEffect(effect=effect, time_profile=time_profile, size=s))
                                  for s in sizes])
        best = int(np.argmax(gain))
        return Tried(candidate=k, size=sizes[best], gain=float(gain[best]), whole=True)

    result, structural = [], []
    for rows in _by_effect_and_kind(problem, candidates):
        k = rows[np.argmax(lower[rows])]
        effect, time_profile = problem.effects[problem.which[k, 0]], problem.time_profiles[problem.which[k, 1]]
        if time_profile.kind not in ("constant", "step"):
            result.append(Tried(candidate=k, size=float(size[k]), gain=float(linear[k]), whole=False))
        elif effect.observe is None:
            structural.append(Tried(candidate=k, size=float(size[k]), gain=float(linear[k]), whole=False))
        else:
            result.append(at_its_size(k, sizes_of(effect)))
    # a structure's size costs modes: the most promising ones
    structural.sort(key=lambda t: -t.gain)
    n_solved = MOST_SOLVED if problem.blocks.channels else MOST_SOLVED_ALONE
    for t in structural[:n_solved]:
        sizes = _about(problem.effects[problem.which[t.candidate, 0]], t.size)
        result.append(at_its_size(t.candidate, sizes) if sizes else t)
    return sorted([*result, *structural[n_solved:]], key=lambda t: -t.gain)


def _pairs_exchanged(
    problem: DiagnosisProblem, theta: np.ndarray, centred: Sequence[np.ndarray]
) -> list[np.ndarray] | None:
    """Of frequencies alone the residuals with those of neighbours exchanged that the model has close to each other:
    what stiffens either of two equal modes makes it the upper one, and first order says so of one only. None
    where there are shapes, or no neighbours so close."""
    if problem.blocks.channels:
        return None
    predictor = problem.predictor
    log = np.array([float(r.tensor[0, 0]) for r in predictor.references(predictor.small.at(theta), 0.0)])
    result, at = list(centred), 0
    while at < len(log) - 1:
        if log[at + 1] - log[at] < MATE and len(result[at]) == len(result[at + 1]):
            result[at], result[at + 1] = result[at + 1], result[at]
            at += 1
        at += 1
    return result if any(a is not b for a, b in zip(result, centred, strict=True)) else None


def _about(effect: Effect, size: float) -> list[float]:
    """Sizes on the side that a linear estimate points to, from half of the effect's standard deviation to as large as
    is allowed: a storey of eight times its stiffness changes the modes by no more than one of twice it promises."""
    end = effect.upper if size > 0 else effect.lower
    steps = np.sign(size) * np.minimum(effect.prior_scale * 2.0 ** np.arange(-1, DOUBLINGS), abs(end))
    return [float(s) for s in dict.fromkeys(steps) if s]


def tried_together(
    problem: DiagnosisProblem, included: Sequence[IncludedEffect], candidates: np.ndarray, alone: Sequence[Tried]
) -> tuple[Tried, list[Tried]] | None:
    """The candidates once more, beside one that is as large: of two faults each hides the other, and what explains most
    `alone` may be neither. The best and the best beside it by turns until neither changes: one of them, and the
    candidates beside it, the best first; None where the first one stays."""
    first, result = alone[0], None
    for _ in range(MOST_TURNS):
        try:
            beside = _beside(problem, included, candidates, first)
            if not beside or not beside[0].whole or beside[0].gain < ANOTHER:
                break
            again = _beside(problem, included, candidates, beside[0])
        except ConvergenceError:
            # beside a size at which the model has no such modes stands nothing
            break
        if not again[0].whole or problem.which[again[0].candidate, 0] == problem.which[first.candidate, 0]:
            break
        first, result = again[0], (beside[0], again)
    return result


def _beside(
    problem: DiagnosisProblem, included: Sequence[IncludedEffect], candidates: np.ndarray, one: Tried
) -> list[Tried]:
    """`tried_whole` with one of them included at its size."""
    j, c = problem.which[one.candidate]
    known = IncludedEffect(effect=problem.effects[j], time_profile=problem.time_profiles[c], size=one.size)
    return tried_whole(problem, (*included, known), candidates & (problem.which[:, 0] != j))


def _by_effect_and_kind(problem: DiagnosisProblem, candidates: np.ndarray) -> list[list[int]]:
    """Numbers of the candidates that are the same effect with the same kind of time profile."""
    groups: dict[tuple[int, str], list[int]] = {}
    for k in np.flatnonzero(candidates):
        j, c = problem.which[k]
        groups.setdefault((int(j), problem.time_profiles[c].kind), []).append(int(k))
    return list(groups.values())


def _linear(problem: DiagnosisProblem, design: Design, centred: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """To first order the size of every candidate that explains most, and how much less misfit."""
    u, v = design.scores(centred), design.information
    usable = design.share_left > 1e-3
    gain, size = gains(problem, u, np.where(usable, v, 0.0))
    return size, np.where(usable, np.maximum(2 * gain, 0.0), 0.0)
