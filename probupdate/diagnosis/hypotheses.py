"""Best-first search over hypotheses: sets of up to three (effect, time profile), each fitted, all compared by evidence.

From every hypothesis that is looked at, one effect is added, exchanged or left out. What such a move promises is known
to first order for all candidates at once; the most promising are fitted. Probabilities are over all that were fitted,
the model as it is among them.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence, Set
from dataclasses import dataclass, replace

import numpy as np

from probupdate.diagnosis.adequacy import explains
from probupdate.diagnosis.evidence import error_scale_mean, linear_evidence, log_size_prior
from probupdate.diagnosis.expected import parameters_with, residuals_at
from probupdate.diagnosis.fitting import Fit, fitted_without_candidates, linearise
from probupdate.diagnosis.problem import DiagnosisProblem, IncludedEffect
from probupdate.diagnosis.proposals import (
    SHARE_STEP,
    TriedCandidate,
    changed_together,
    sharpen_time,
    sharpened_again,
    try_candidates,
    with_crosstalk,
)
from probupdate.diagnosis.ranking import CLOSE, Hypothesis, Ranking, hypothesis_of, key_of
from probupdate.diagnosis.search import MARGIN, Search, conditional_scores, gains, model_error_dispersion, search
from probupdate.effects.catalogue import Effect
from probupdate.errors import ConvergenceError
from probupdate.runtime.executors import Executor
from probupdate.runtime.progress import Progress

# hypotheses of one number of effects from which moves are made; of one kind of move, how many are fitted
WIDTH, MOST_MOVES = 2, 6
# scores from which first order says little: large faults are tried at their own size, and the noise is estimated again
LARGE = 20.0
# share of the most that any large fault explains from which another one is fitted; least share of a signature's
# length that must be left once all that is normal has taken its part
SHARE, LEAST_LEFT = 0.25, 1e-3
# score correlation with a large effect from which another one is tried in its place
ALIKE = 0.7
# hypotheses from which moves are made, at most
MOST_LOOKED = 10
# how often the times of steps are found again with what they make of the fit
MOST_SHARPENED = 3
# blocks by which two steps may lie apart and be one
SAME_TIME = 2


@dataclass(frozen=True, eq=False, kw_only=True)
class Exploration:
    """All that was fitted, the most probable first, with the ln posterior of each relative to it (n,); the first search
    (the model as it is) and that at the most probable one, without their draws. `one_more`: whether one more effect may
    make the record more probable there: it promises to, and was not shown not to. `problem` with the crosstalks that
    were taken up."""

    problem: DiagnosisProblem
    hypotheses: tuple[Hypothesis, ...]
    log_posterior: np.ndarray
    first: Search
    last: Search
    one_more: bool


@dataclass(frozen=True, eq=False, kw_only=True)
class Move:
    """From one hypothesis to another: `candidates` of the new one with their scores, effects to begin with, ln
    posterior that is promised relative to where it is made from, parameters to begin with if not those of there."""

    candidates: tuple[int, ...]
    z: tuple[float, ...]
    included: tuple[IncludedEffect, ...]
    promise: float
    theta: np.ndarray | None = None


def refit_without(problem: DiagnosisProblem, fitted: Fit, number: int) -> tuple[Fit, float]:
    """The fit with the effect of that number taken out where it is, and the ln evidence relative to it with all
    parameters to first order about there."""
    included = tuple(n for i, n in enumerate(fitted.included) if i != number)
    noise = fitted.design.noise
    there = residuals_at(problem, fitted.theta, included)
    design, residuals, centred = linearise(problem, fitted.theta, included, noise, there)
    rest = replace(fitted, included=included, design=design, residuals=residuals, centred=centred)
    return rest, _about_itself(rest) - _about_itself(fitted)


def _about_itself(fitted: Fit) -> float:
    return log_size_prior(fitted.included) + error_scale_mean(
        fitted.design, lambda d: linear_evidence(d, fitted.centred)
    )


def moves_from(problem: DiagnosisProblem, here: Hypothesis, *, add: bool, best: float) -> list[Move]:
    """What may be made of a hypothesis, the most promising first: one effect added (if `add`), left out or exchanged;
    of each the MOST_MOVES most promising whose ln posterior, as promised, may come near `best`. A large effect may be
    exchanged for what looks like it too, whatever first order promises."""
    priors = np.log(problem.prior_shares)
    effect_of, names = problem.which[:, 0], [problem.time_profiles[c].name for _, c in problem.which]
    least, result = best - MARGIN - here.log_posterior, []
    for out in (*([None] if add else []), *range(len(here.candidates))):
        # one state at a time, as their designs are as large as all else together
        base, lost = (here.fitted, 0.0) if out is None else refit_without(problem, here.fitted, out)
        others = tuple(k for i, k in enumerate(here.candidates) if i != out)
        scores = tuple(z for i, z in enumerate(here.z) if i != out)
        # a stiffness that is nearly lost explains many times what its score promised where it was proposed
        explained = 0.0 if out is None else np.sqrt(max(-2 * lost, 0.0))
        lost -= 0.0 if out is None else priors[here.candidates[out]]
        if out is not None and lost > least:
            result.append(Move(candidates=others, z=scores, included=base.included, promise=lost))
        usable, z, gain, size = _to_first_order(problem, base, others, scores)
        scale = model_error_dispersion(float(np.abs(z).max()))
        if out is None:
            promise = gain / scale + priors
            # first order errs by a few of the odds between two that explain as much, and by a share of what is large
            promises, enough = [promise], max(least, min(promise.max() - 2 * MARGIN, SHARE * promise.max()))
        else:
            # beside what the effect itself promises there
            own = here.candidates[out]
            promised = gain[own] if usable[own] else 0.0
            # of a large score first order says nothing at all
            promises, enough = [], least
            if abs(here.z[out]) <= LARGE:
                promises.append((gain - promised) / scale + priors - priors[own])
            if max(abs(here.z[out]), explained) > LARGE:
                promises.append(_score_correlation(base, own, usable))
            # the hypothesis itself, but for the time of a step
            itself = (effect_of == effect_of[own]) & np.array([name == names[own] for name in names])
            promises = [np.where(itself, -np.inf, p) for p in promises]
        chosen = {k: float(p[k]) for p in reversed(promises) for k in _promising_candidates(problem, p, enough)}
        for k, promise in chosen.items():
            added = _begin_effect(problem, base, k, size[k])
            result.append(Move(candidates=(*others, k), z=(*scores, float(z[k])), promise=promise,
                               included=(*base.included, added), theta=_restore_parameters(problem, base.theta, added)))
    return sorted(result, key=lambda m: -m.promise)


def _to_first_order(
    problem: DiagnosisProblem, base: Fit, included: Sequence[int], z_included: Sequence[float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of every candidate (n_candidate,) beside those `included` in a fit: whether it can be added there, its z, its ln
    Bayes factor and its size."""
    effect_of = problem.which[:, 0]
    u, v = conditional_scores(problem, base.design, base.centred, base.included, z_included)
    usable = (base.design.share_left > LEAST_LEFT) & (v > 0) & ~np.isin(effect_of, effect_of[list(included)])
    z = np.where(usable, u / np.sqrt(np.where(usable, v, 1.0)), 0.0)
    return usable, z, *gains(problem, u, np.where(usable, v, 0.0))


def _is_one_more_promising(problem: DiagnosisProblem, here: Hypothesis, found: Search) -> bool:
    """Whether what a search beside a hypothesis found beyond its threshold promises, before any fit, to make the record
    more probable."""
    if not found.statistic.max() > found.threshold:
        return False
    _, z, gain, _ = _to_first_order(problem, here.fitted, here.candidates, here.z)
    promise = gain / model_error_dispersion(float(np.abs(z).max())) + np.log(problem.prior_shares)
    return bool(promise.max() > 0)


def _score_correlation(base: Fit, own: int, usable: np.ndarray) -> np.ndarray:
    """(n_candidate,) what is promised by an exchange of the large effect of candidate `own`, by its score correlation
    alone: what a large effect leaves is beyond first order. -inf but for what looks like it."""
    information = base.design.information
    size_of = np.sqrt(np.maximum(information, 1e-300))
    alike = np.abs(base.design.overlap([own], range(len(information)))[0]) / (size_of * size_of[own])
    return np.where(usable & (alike > ALIKE), alike, -np.inf)


def _promising_candidates(problem: DiagnosisProblem, promise: np.ndarray, enough: float) -> list[int]:
    """Of every effect the candidate that promises most, of these the MOST_MOVES first that promise `enough`."""
    order = np.argsort(-promise, kind="stable")
    _, first = np.unique(problem.which[order, 0], return_index=True)
    return [int(k) for k in order[np.sort(first)][:MOST_MOVES] if promise[k] > enough]


def _begin_effect(problem: DiagnosisProblem, base: Fit, candidate: int, size: float) -> IncludedEffect:
    """A candidate to begin a fit with beside `base`: well within its bounds, a step at its best time."""
    j, c = problem.which[candidate]
    effect, time_profile = problem.effects[j], problem.time_profiles[c]
    if time_profile.kind == "step":
        time_profile = sharpen_time(problem, base, int(j), time_profile)
    return IncludedEffect(effect=effect, time_profile=time_profile, size=0.0).with_start_size(size)


def _restore_parameters(problem: DiagnosisProblem, theta: np.ndarray, added: IncludedEffect) -> np.ndarray | None:
    """Parameters to begin a fit with beside an effect that changes them: without it they were bent to follow its mean
    over the record, and are taken back by that, but not beyond where the prior expects them. None beside others."""
    if not added.exact or not added.effect.increments:
        return None
    begun, parameters = np.array(theta), problem.predictor.parameters
    back = parameters_with(parameters, theta, [added], [-float(np.mean(added.time_profile.value))])
    updated, expected = list(problem.updated), parameters.initial
    begun[updated] = np.clip(back, np.minimum(theta, expected), np.maximum(theta, expected))[updated]
    return begun


def large_moves(problem: DiagnosisProblem, here: Hypothesis, found: Search, n_searched: int) -> list[Move]:
    """An effect added that was tried at its own size, where first order says little: the parameters of the fit without
    it were bent to follow."""
    theta = np.array(problem.predictor.parameters.initial)
    included = here.fitted.included
    taken = np.isin(problem.which[:, 0], problem.which[list(here.candidates), 0])
    free = ~taken & (np.arange(len(problem.which)) < n_searched)
    try:
        tried = try_candidates(problem, included, free)
    except ConvergenceError:
        # where the prior expects the parameters the model has no modes that pair with the measured ones
        return []
    least = SHARE * max(tried[0].gain, 0.0)
    return [Move(candidates=(*here.candidates, t.candidate), theta=theta, promise=0.5 * t.gain,
                 z=(*here.z, float(found.z[t.candidate])), included=(*included, _initial_effect(problem, t)))
            for t in [t for t in tried if t.whole and t.gain > least][:MOST_MOVES]]


def _fit_at_last(
    problem: DiagnosisProblem, known: dict[frozenset, Hypothesis], best: Hypothesis, first: Search, most: int,
    runs: Executor,
) -> None:
    """Adds to `known` what of the structure changed together, beside what the most probable hypothesis says of sensors,
    since the time that all of it shows; and large effects that were not tried at their own size yet, as a model that
    had bent far enough leaves no large score."""
    start = known[frozenset()].with_design(problem)
    moves = _changed_together(problem, best, first, most)
    if not first.statistic.max() > LARGE:
        moves += large_moves(problem, start, first, len(first.z))
    fit_moves(problem, start, moves, known, noise_anew=True, runs=runs)
    for key in {key_of(problem, move.candidates) for move in moves} & known.keys():
        known[key] = _renew_hypothesis(problem, known[key])


def _changed_together(problem: DiagnosisProblem, best: Hypothesis, first: Search, most: int) -> list[Move]:
    """From the model as it is to several effects of the structure that begin where the most probable hypothesis has
    one, else where the highest score as a step does: the first of them, the first two and so on."""
    of_sensors = [i for i, n in enumerate(best.fitted.included) if n.effect.observe is not None]
    kept = tuple(best.fitted.included[i] for i in of_sensors)
    since = next((n.time_profile for n in best.fitted.included
                  if n.effect.observe is None and n.time_profile.kind == "step"), None)
    steps = [problem.effects[j].observe is None and problem.time_profiles[c].kind == "step"
             for j, c in problem.which[: len(first.z)]]
    score = np.where(steps, first.statistic, 0.0)
    if since is None:
        since = problem.time_profiles[problem.which[int(np.argmax(score)), 1]]
    grid = min((profile for profile in problem.time_profiles if profile.kind == "step"),
               key=lambda profile: abs(profile.at - since.at), default=None)
    if grid is None or not score.max() > LARGE:
        return []
    rows = [int(k) for k in np.flatnonzero(steps) if problem.time_profiles[problem.which[k, 1]] is grid]
    try:
        theta, parts = changed_together(problem, kept, rows, since, most - len(kept))
    except ConvergenceError:
        return []
    return [Move(candidates=(*(best.candidates[i] for i in of_sensors), *(t.candidate for t in parts[:n])),
                 z=(*(best.z[i] for i in of_sensors), *(float(first.z[t.candidate]) for t in parts[:n])),
                 included=(*kept, *(replace(_initial_effect(problem, t), time_profile=since) for t in parts[:n])),
                 theta=theta, promise=np.inf) for n in range(1, len(parts) + 1)]


def _initial_effect(problem: DiagnosisProblem, tried: TriedCandidate) -> IncludedEffect:
    effect = problem.effects[problem.which[tried.candidate, 0]]
    return IncludedEffect(effect=effect, time_profile=tried.time_profile, size=tried.size)


def explore(
    problem: DiagnosisProblem, null: Fit, *, most: int, seed: int, runs: Executor, progress: Progress,
    begun: Sequence[IncludedEffect] = (),
) -> Exploration:
    """Fit the hypotheses that matter, from the model as it is (`null`) on, with at most so many effects; those that do
    not need one another side by side on the executor `runs`. `begun`: effects tried first, each at its size."""
    n_searched = len(problem.which)
    # what a design is asked for is as large as all else together, and goes with the search that asked for it
    null = replace(null, design=replace(null.design))
    searches: dict[frozenset, Search] = {}
    compared, renewed, at_last = Ranking(runs), set(), False
    first = search(problem, null, seed=seed)

    def search_beside(here: Hypothesis) -> Search:
        return search(problem, here.fitted, seed=seed, z_included=here.z, heavier=first.heavier)

    known = _explore_first(problem, null, [_first_move(problem, n, first) for n in begun], runs)
    while len(searches) < MOST_LOOKED:
        keys, relative = compared.order(problem, known)
        key = _choose_next(keys, relative, searches)
        if key is None and (at_last or not _leaves_much(problem, known[keys[0]], searches[keys[0]], seed)):
            break
        if key is None:
            at_last = True
            _fit_at_last(problem, known, known[keys[0]], first, most, runs)
            continue
        if key and key not in renewed:
            renewed.add(key)
            known |= _renewed_with_similar_effects(problem, known, key, renewed)
            # what its own noise and times made less probable is looked at when its turn comes again
            if dict(zip(*compared.order(problem, known), strict=True))[key] < -MARGIN:
                continue
        here = known[key].with_design(problem)
        progress("diagnosing", min(len(key), most), most + 1)
        found = searches[key] = search_beside(here) if key else first
        add = len(here.candidates) < most and (bool(found.statistic.max() > found.threshold) or found.scores_impossible)
        if not key and not add:
            break
        if add:
            problem, fitted, found = with_crosstalk(problem, here.fitted, found, seed=seed, z_included=here.z)
            here, searches[key] = replace(here, fitted=fitted), found
            known[key] = here.without_design()
        large = _is_large(problem, found, key)
        best = max(h.log_posterior for h in known.values())
        moves = [*(large_moves(problem, here, found, n_searched) if add and large else ()),
                 *moves_from(problem, here, add=add, best=best)]
        fit_moves(problem, here.not_asked(), moves, known, noise_anew=large, runs=runs)
    keys, relative = _ordered_at_last(problem, compared, known, renewed)
    last = known[keys[0]] = known[keys[0]].with_design(problem)
    found = searches.get(keys[0]) or search_beside(last)
    # what was promised and, fitted, is less probable is none more
    tried = keys[0] in searches and len(keys[0]) < most
    return Exploration(problem=problem, hypotheses=tuple(known[k] for k in keys), log_posterior=np.array(relative),
                       first=first, last=found, one_more=not tried and _is_one_more_promising(problem, last, found))


def _explore_first(
    problem: DiagnosisProblem, null: Fit, moves: Sequence[Move], runs: Executor
) -> dict[frozenset, Hypothesis]:
    """The model as it is, and where these moves from it lead."""
    start = hypothesis_of(problem, (), (), null)
    known: dict[frozenset, Hypothesis] = {frozenset(): start}
    fit_moves(problem, start.not_asked(), moves, known, noise_anew=True, runs=runs)
    return known


def _first_move(problem: DiagnosisProblem, n: IncludedEffect, first: Search) -> Move:
    """From the model as it is to that with one effect of this size and time profile, begun where the prior expects the
    parameters."""
    k = next(k for k, (j, c) in enumerate(problem.which)
             if problem.effects[j] is n.effect and problem.time_profiles[c].name == n.time_profile.name
             and np.array_equal(problem.time_profiles[c].value, n.time_profile.value))
    return Move(candidates=(k,), z=(float(first.z[k]),), included=(n,), promise=np.inf,
                theta=np.array(problem.predictor.parameters.initial))


def _is_large(problem: DiagnosisProblem, found: Search, key: frozenset) -> bool:
    # of frequencies alone first order says which of two equal modes moves, where either may
    return found.scores_impossible or bool(found.statistic.max() > LARGE) or not (key or problem.blocks.channels)


def _leaves_much(problem: DiagnosisProblem, one: Hypothesis, found: Search, seed: int) -> bool:
    """What is not known of a strong effect hides others that change with it from the scores, and not from this test."""
    return (not one.fitted.settled or bool(found.statistic.max() > found.threshold)
            or not explains(problem, one.with_design(problem).fitted, found, seed))


def _choose_next(
    keys: Sequence[frozenset], relative: Sequence[float], looked_at: Collection[frozenset]
) -> frozenset | None:
    """The most probable hypothesis, else another of the WIDTH of its number of effects that come near it, from which no
    moves were made; None where there is none. `keys` the most probable first, with the ln posterior relative to it."""
    levels = [len(k) for k in looked_at]
    return next((k for k, r in zip(keys, relative, strict=True)
                 if k not in looked_at and (k == keys[0] or (r > -MARGIN and levels.count(len(k)) < WIDTH))), None)


def _renewed_with_similar_effects(
    problem: DiagnosisProblem, known: Mapping[frozenset, Hypothesis], key: frozenset, renewed: Set[frozenset]
) -> dict[frozenset, Hypothesis]:
    """That hypothesis renewed, and with its noise and times those of as many effects that were not."""
    here = _renew_hypothesis(problem, known[key])
    return {k: transfer_noise_and_times(h, known[key], here) for k, h in known.items()
            if len(k) == len(key) and k not in renewed} | {key: here}


def _ordered_at_last(
    problem: DiagnosisProblem, compared: Ranking, known: dict[frozenset, Hypothesis], renewed: set[frozenset]
) -> tuple[list[frozenset], list[float]]:
    """`compared.order` with the most probable one renewed, which the last one looked at may have led to."""
    keys, relative = compared.order(problem, known)
    while keys[0] and keys[0] not in renewed:
        renewed.add(keys[0])
        known |= _renewed_with_similar_effects(problem, known, keys[0], renewed)
        keys, relative = compared.order(problem, known)
    return keys, relative


def fit_moves(
    problem: DiagnosisProblem, here: Hypothesis, moves: Sequence[Move], known: dict[frozenset, Hypothesis], *,
    noise_anew: bool, runs: Executor,
) -> None:
    """Adds to `known` where the moves lead that were not fitted before, or from a place that promises more than that
    fit came to: of large effects one that began without the others may have ended anywhere."""
    there = [key_of(problem, move.candidates) for move in moves]

    def worth_it(number: int) -> bool:
        before = known.get(there[number])
        return before is None or here.log_posterior + moves[number].promise >= before.log_posterior + CLOSE

    # what is very wrong makes the noise of the fit without it wrong too
    base = None if noise_anew else replace(here.fitted, design=replace(here.fitted.design))
    numbers = [number for number in range(len(moves)) if worth_it(number)]
    tasks = [(here.fitted.theta if moves[k].theta is None else moves[k].theta, moves[k]) for k in numbers]
    for number, fitted in zip(numbers, runs.in_order(_fit_move, tasks, shared=(problem, base)), strict=True):
        if fitted is None or not worth_it(number):
            continue
        before = known.get(there[number])
        if before is None or fitted.log_posterior > before.log_posterior:
            known[there[number]] = _restore_fit_state(fitted, moves[number], base)


def _fit_move(problem: DiagnosisProblem, base: Fit | None, theta: np.ndarray, move: Move) -> Hypothesis | None:
    """The hypothesis that a move leads to, from these parameters and with the noise of `base` if that is given; None
    where the model has no modes there or nothing is left of an effect."""
    try:
        fitted = fitted_without_candidates(problem, theta, move.included, base=base)
    except ConvergenceError:
        return None
    if any(not n.effect.discrete and abs(n.size) < 1e-6 * n.prior_scale for n in fitted.included):
        # it cannot be on the side that the score asked for
        return None
    return hypothesis_of(problem, move.candidates, move.z, fitted).without_design()


def _restore_fit_state(one: Hypothesis, move: Move, base: Fit | None) -> Hypothesis:
    """The same with the effects, time profiles and noise that it was fitted with, of which another process returns
    copies: which one is meant is known by the object itself."""
    design = one.fitted.design if base is None else replace(one.fitted.design, noise=base.design.noise)

    def own(included: Sequence[IncludedEffect]) -> tuple[IncludedEffect, ...]:
        return tuple(replace(known, size=n.size) for known, n in zip(move.included, included, strict=True))

    return replace(one, fitted=replace(one.fitted, included=own(one.fitted.included), design=design),
                   stored=None if one.stored is None else own(one.stored))


def _renew_hypothesis(problem: DiagnosisProblem, here: Hypothesis) -> Hypothesis:
    """The same with its own noise, as what a strong effect does to the shapes changes how they scatter, and with the
    times of its steps found again; where the model then has no modes, as it was, marked as not settled."""
    try:
        fitted = fitted_without_candidates(problem, here.fitted.theta, here.fitted.included)
        for _ in range(MOST_SHARPENED):
            included = sharpened_again(problem, fitted)
            if all(np.abs(a.time_profile.value - b.time_profile.value).max() < 2 * SHARE_STEP
                   for a, b in zip(included, fitted.included, strict=True)):
                break
            # what theory does not know of an effect follows the time it had
            fitted = fitted_without_candidates(problem, fitted.theta, included)
    except ConvergenceError:
        fitted = replace(here.with_design(problem).fitted, last_step=np.inf)
    return hypothesis_of(problem, here.candidates, here.z, fitted).without_design()


def transfer_noise_and_times(one: Hypothesis, before: Hypothesis, after: Hypothesis) -> Hypothesis:
    """A competing hypothesis with the noise and the times of steps that were found again for another one: it is not
    less probable for what it was not offered. An effect of both takes its own time, one in another's place that
    one's."""
    steps = [n for n in after.fitted.included if n.time_profile.kind == "step"]
    theirs, included = {n.effect for n in one.fitted.included}, []
    for n in one.fitted.included:
        offered = [s for s in steps if s.effect is n.effect] or [s for s in steps if s.effect not in theirs]
        near = [s.time_profile for s in offered
                if n.time_profile.kind == "step" and abs(s.time_profile.at - n.time_profile.at) <= SAME_TIME
                and (not n.effect.discrete or np.isin(s.time_profile.value, (0.0, 1.0)).all())]
        nearest = min(near, key=lambda profile: abs(profile.at - n.time_profile.at), default=n.time_profile)
        included.append(replace(n, time_profile=nearest))
    # a design that is made again is of the times that the effects have
    stored = one.stored and tuple(replace(n, time_profile=own.time_profile)
                                  for n, own in zip(one.stored, included, strict=True))
    return replace(one, fitted=replace(one.fitted, included=tuple(included)), stored=stored,
                   log_evidence=one.log_evidence + after.log_evidence - before.log_evidence)


def exchange_effect(explored: Exploration, number: int) -> tuple[list[Effect | None], list[float], list[float]]:
    """What may be meant instead of an effect of the most probable hypothesis: the effect itself, others, none of them
    (None), each with its most probable time profile beside all the other effects; ln evidence and ln prior of each
    relative to it."""
    problem, best = explored.problem, explored.hypotheses[0]
    effect_of = problem.which[:, 0]
    own = int(effect_of[best.candidates[number]])
    rest = frozenset(int(effect_of[k]) for i, k in enumerate(best.candidates) if i != number)
    prior = np.array([h.log_prior for h in explored.hypotheses])
    evidence = explored.log_posterior - prior
    # of time profiles of one effect the most probable stands first
    first: dict[frozenset, int] = {}
    for row, h in enumerate(explored.hypotheses):
        first.setdefault(frozenset(int(effect_of[k]) for k in h.candidates), row)
    found: dict[int | None, int] = {}
    for held, row in first.items():
        other = held - rest
        if rest <= held and own not in held and len(other) <= 1:
            found[next(iter(other), None)] = row
    effects: list[Effect | None] = [problem.effects[own]]
    apart, before = [0.0], [0.0]
    for j, row in found.items():
        effects.append(None if j is None else problem.effects[j])
        apart.append(float(evidence[row] - evidence[0]))
        before.append(float(prior[row] - prior[0]))
    return effects, apart, before
