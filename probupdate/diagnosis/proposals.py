"""What the search over hypotheses tries beyond first-order scores: large faults, crosstalks, the time of a step.

A frame turned by twenty degrees or two exchanged channels are nowhere near linear: the fit without them bends its
parameters to follow, and the scores there favour whatever is left. Sensors see all modes alike, so that a size costs no
new modes and every one can be tried; of the structure, whose sizes cost modes, those that promise most to first order.
Everything else that is unknown follows to first order.

To first order a sensor that is turned is two crosstalks, one each way, and where one of its axes hardly moves it is
one. They are as many as there are ordered pairs of channels: too many for every fit to follow and for a table of
detectable sizes to list. So they cost no false alarm; a record in which nothing else stands out is not asked for them.

The search tries a few times of a step only; between which two blocks it lies a long record shows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from scipy import optimize

from probupdate.diagnosis.expected import ModelAnswers, residuals_at, residuals_of_sizes
from probupdate.diagnosis.fitting import Fit, design_at, fitted_without_candidates, kept_columns, linearise, noise_of
from probupdate.diagnosis.linear import Design
from probupdate.diagnosis.noise import Noise
from probupdate.diagnosis.predictor import MATE
from probupdate.diagnosis.problem import DiagnosisProblem, IncludedEffect
from probupdate.diagnosis.search import MARGIN, Search, conditional_scores, gains, model_error_dispersion, search
from probupdate.diagnosis.time_profiles import TimeProfile, step_profile
from probupdate.effects.catalogue import Crosstalk, Effect
from probupdate.runtime.arrays import frozen_array

# of an effect's prior scale: a gain of 20, half a turn
DOUBLINGS = 7
# effects of the structure that are solved at their own size, the best to first order; of frequencies alone, which say
# less to first order
MOST_SOLVED, MOST_SOLVED_ALONE = 6, 12


@dataclass(frozen=True, eq=False, kw_only=True)
class TriedCandidate:
    """A candidate with the time profile and size that explain most, and by how much it lowers -2 ln posterior with the
    scale of all noise as the record then asks for. `whole`: at that size itself, not to first order."""

    candidate: int
    time_profile: TimeProfile
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


@dataclass(frozen=True, eq=False, kw_only=True)
class _AtOwnSizes:
    """Candidates beside what is included already, each at its own size, where the prior expects the parameters (theta):
    those of a fit were bent to follow what is wrong. `centre`: what there is no misfit from."""

    problem: DiagnosisProblem
    included: Sequence[IncludedEffect]
    theta: np.ndarray
    design: Design
    noise: Noise
    centre: Sequence[np.ndarray]
    answers: ModelAnswers

    @cached_property
    def count(self) -> int:
        """Numbers that are compared."""
        return sum(int(np.count_nonzero(w > 0)) * f.size
                   for w, f in zip(self.noise.weight, self.problem.discrepancy_std, strict=True))

    def surprise(self, each: Sequence[Sequence[IncludedEffect]]) -> np.ndarray:
        """-2 ln posterior with the scale of all noise as it then must be, but for a constant."""
        left = kept_columns(residuals_of_sizes(self.problem, self.theta, each, self.answers), self.noise)
        return self.count * np.log(
            self.design.misfits(tuple(y - c for y, c in zip(left, self.centre, strict=True)), []))

    @cached_property
    def included_surprise(self) -> float:
        return float(self.surprise([self.included])[0])

    def at_best_size(self, t: TriedCandidate) -> TriedCandidate:
        """At that of all sizes tried that explains most."""
        effect = self.problem.effects[self.problem.which[t.candidate, 0]]
        sizes = _candidate_sizes(effect, t.size) if effect.observe is None else sizes_of(effect)
        if not sizes:
            return t
        gain = self.included_surprise - self.surprise(
            [(*self.included, IncludedEffect(effect=effect, time_profile=t.time_profile, size=s)) for s in sizes])
        best = int(np.argmax(gain))
        return replace(t, size=sizes[best], gain=float(gain[best]), whole=True)


def try_candidates(
    problem: DiagnosisProblem, included: Sequence[IncludedEffect], candidates: np.ndarray
) -> list[TriedCandidate]:
    """The `candidates` (bool) beside what is included already, each effect's best time profile of every kind, the most
    telling first. All where the prior expects the parameters, as those of a fit were bent to follow what is wrong."""
    theta = np.array(problem.predictor.parameters.initial)
    answers = ModelAnswers()
    here = residuals_at(problem, theta, included, answers)
    noise = noise_of(problem, here)
    design, residuals, centred = linearise(problem, theta, included, noise, here)
    own = _AtOwnSizes(problem=problem, included=included, theta=theta, design=design, noise=noise, answers=answers,
                      centre=[y - c for y, c in zip(residuals, centred, strict=True)])
    misfit = design.misfit(centred, [])
    size, lower = _linear(problem, design, centred)
    exchanged = _pairs_exchanged(problem, theta, centred)
    if exchanged is not None:
        other, more = _linear(problem, design, exchanged)
        size, lower = np.where(more > lower, other, size), np.maximum(more, lower)
    linear = own.count * (np.log(misfit) - np.log(np.maximum(misfit - lower, 1e-9 * misfit)))
    result, structural = [], []

    def first_trial(k: int) -> TriedCandidate:
        return TriedCandidate(candidate=k, time_profile=problem.time_profiles[problem.which[k, 1]], size=float(size[k]),
                              gain=float(linear[k]), whole=False)

    shown = _clearest_step(problem, candidates, lower)
    for rows in _group_by_effect_and_kind(problem, candidates):
        t = first_trial(int(rows[np.argmax(lower[rows])]))
        if t.time_profile.kind not in ("constant", "step"):
            result.append(t)
        elif problem.effects[problem.which[t.candidate, 0]].observe is None:
            structural.append(t)
        else:
            also = [first_trial(k) for k in rows if problem.which[k, 1] == shown and k != t.candidate]
            result.append(max(map(own.at_best_size, [t, *also]), key=lambda one: one.gain))
    # a structure's size costs modes: the most promising ones
    structural.sort(key=lambda t: -t.gain)
    n_solved = MOST_SOLVED if problem.blocks.channels else MOST_SOLVED_ALONE
    return sorted([*map(own.at_best_size, structural[:n_solved]), *structural[n_solved:], *result],
                  key=lambda t: -t.gain)


def _clearest_step(problem: DiagnosisProblem, candidates: np.ndarray, lower: np.ndarray) -> int:
    """The number of the step that any of the candidates explains most by, to first order, -1 without one: of a reversed
    sign and of exchanged channels first order finds another time than of what is like them."""
    steps = np.array([profile.kind == "step" for profile in problem.time_profiles])
    rows = np.flatnonzero(candidates & steps[problem.which[:, 1]])
    return int(problem.which[rows[np.argmax(lower[rows])], 1]) if len(rows) else -1


def _pairs_exchanged(
    problem: DiagnosisProblem, theta: np.ndarray, centred: Sequence[np.ndarray]
) -> list[np.ndarray] | None:
    """Of frequencies alone the residuals with those of neighbours exchanged that the model has close to each other:
    what stiffens either of two equal modes makes it the upper one, and first order says so of one only. None
    where there are shapes, or no neighbours so close."""
    if problem.blocks.channels:
        return None
    predictor = problem.predictor
    log = np.array([float(r.tensor[0, 0]) for r in predictor.references(predictor.small.evaluate(theta), 0.0)])
    result, at = list(centred), 0
    while at < len(log) - 1:
        if log[at + 1] - log[at] < MATE and len(result[at]) == len(result[at + 1]):
            result[at], result[at + 1] = result[at + 1], result[at]
            at += 1
        at += 1
    return result if any(a is not b for a, b in zip(result, centred, strict=True)) else None


def _candidate_sizes(effect: Effect, size: float) -> list[float]:
    """Sizes on the side that a linear estimate points to, from half of the effect's standard deviation to as large as
    is allowed: a storey of eight times its stiffness changes the modes by no more than one of twice it promises."""
    end = effect.upper if size > 0 else effect.lower
    steps = np.sign(size) * np.minimum(effect.prior_scale * 2.0 ** np.arange(-1, DOUBLINGS), abs(end))
    return [float(s) for s in dict.fromkeys(steps) if s]


def changed_together(
    problem: DiagnosisProblem, included: Sequence[IncludedEffect], rows: Sequence[int], profile: TimeProfile, most: int
) -> tuple[np.ndarray, list[TriedCandidate]]:
    """The few candidates among `rows`, at most so many, that changed together along a time profile, beside what is
    included already: all that change one parameter each are estimated at once, of which their heavy-tailed prior lets
    few be large; then those that explain most of these sizes, one after the other, members of a group as the group.
    Masses on springs are not among them: each brings modes of its own, and dozens at once more than are compared. With
    the parameters of that fit. Raises ConvergenceError where the model has no modes on the way."""
    effects = {k: problem.effects[problem.which[k, 0]] for k in rows}
    moving = {k: dict(e.increments) for k, e in effects.items() if e.observe is None and not e.discrete}
    hung = {problem.predictor.parameters.names[one.column] for one in problem.predictor.small.tuned}
    alone = {name: k for k, names in moving.items() if len(names) == 1 for name in names if name not in hung}
    own = [IncludedEffect(effect=effects[k], time_profile=profile, size=0.0) for k in alone.values()]
    fitted = fitted_without_candidates(problem, problem.predictor.parameters.initial, (*included, *own))
    size = np.array([n.size for n in fitted.included[len(included):]])
    start = fitted.design.sizes.start + sum(not n.effect.discrete for n in included)
    precision = np.linalg.inv(fitted.design.unknowns_cov(range(start, start + len(own))))
    shares = {k: np.array([names.get(name, 0.0) / moving[alone[name]][name] for name in alone])
              for k, names in moving.items() if set(names) <= set(alone)}
    chosen: list[TriedCandidate] = []
    explained = 0.0
    while len(chosen) < most:
        found = {k: _best_combination(size, precision, [*(shares[t.candidate] for t in chosen), share])
                 for k, share in shares.items() if k not in [t.candidate for t in chosen]}
        best = max(found, key=lambda k: found[k][0], default=None)
        if best is None or found[best][0] - explained < 2 * MARGIN:
            break
        (total, best_sizes), parts = found[best], [*(t.candidate for t in chosen), best]
        gained = [*(t.gain for t in chosen), total - explained]
        within = [float(np.clip(s, effects[k].lower, effects[k].upper)) for k, s in zip(parts, best_sizes, strict=True)]
        chosen = [TriedCandidate(candidate=k, time_profile=profile, size=s, gain=g, whole=True)
                  for k, s, g in zip(parts, within, gained, strict=True)]
        explained = total
    return fitted.theta, chosen


def _best_combination(size: np.ndarray, precision: np.ndarray, columns: Sequence[np.ndarray]) -> tuple[float,
                                                                                                       np.ndarray]:
    """How much of size^T precision size the best combination of these columns explains, and that combination."""
    E = np.column_stack(columns)
    right = E.T @ precision @ size
    best = np.linalg.lstsq(E.T @ precision @ E, right, rcond=None)[0]
    return float(right @ best), best


def _group_by_effect_and_kind(problem: DiagnosisProblem, candidates: np.ndarray) -> list[list[int]]:
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


# of all ordered pairs, how many are refitted
MOST_OFFERED = 2


def crosstalk_effects(channels: Sequence[str]) -> tuple[Effect, ...]:
    """The share of every channel in every other."""
    return tuple(
        Effect(kind="measurement", cause="crosstalk", location=f"{other} into {into}", unit="-", tolerance=0.0,
               prior_scale=0.1, lower=-1.0, upper=1.0, observe=Crosstalk(i, j), step_of_size=1e-3,
               signature="one channel shows a share of another, every mode alike; the other shows nothing of it",
               check=f"tap the sensor of {other} along its axis and look at {into}; measure the cables' insulation",
               odds=1 / (len(channels) * (len(channels) - 1)))
        for i, into in enumerate(channels) for j, other in enumerate(channels) if i != j
    )


def with_crosstalk(
    problem: DiagnosisProblem, fitted: Fit, found: Search, *, seed: int, z_included: Sequence[float] = ()
) -> tuple[DiagnosisProblem, Fit, Search]:
    """Problem, fit and search with the crosstalks, constant or along the time profile of the best candidate, that with
    their prior odds promise nearly as much as it does, as last candidates. The threshold is what it was without
    them."""
    best = int(np.argmax(found.statistic))
    _, c = problem.which[best]
    known = {e.key for e in problem.effects}
    rows = [e for e in crosstalk_effects(problem.blocks.channels) if e.key not in known]
    profiles = [one for k, one in enumerate(problem.time_profiles) if one.kind == "constant" or k == c]
    everything = problem_with_effects(problem, rows, [profiles] * len(rows))
    design = design_at(everything, fitted.theta, fitted.included, fitted.design.noise)
    u, v = conditional_scores(everything, design, fitted.centred, fitted.included, z_included)
    gain, _ = gains(everything, u, np.where(design.share_left > 1e-3, v, 0.0))
    odds = np.log([everything.effects[j].prior_odds(everything.time_profiles[d].name) for j, d in everything.which])
    promise = gain / model_error_dispersion(float(found.statistic.max())) + odds
    of_table = np.where(found.usable, promise[: len(problem.which)], -np.inf)
    new = promise[len(problem.which):].reshape(len(rows), len(profiles))
    strongest = [k for k in np.argsort(-new.max(axis=1), kind="stable")[:MOST_OFFERED]
                 if new[k].max() > of_table.max() - MARGIN]
    if not len(strongest):
        return problem, fitted, found
    wider = problem_with_effects(problem, [rows[k] for k in strongest],
                                 [[profiles[int(np.argmax(new[k]))]] for k in strongest])
    fitted = replace(fitted, design=design_at(wider, fitted.theta, fitted.included, fitted.design.noise))
    again = search(wider, fitted, seed=seed, z_included=z_included, heavier=found.heavier)
    return wider, fitted, replace(again, threshold=found.threshold, p_value=found.p_value, maxima=found.maxima)


def problem_with_effects(
    problem: DiagnosisProblem, rows: Sequence[Effect], profiles: Sequence[Sequence[TimeProfile]]
) -> DiagnosisProblem:
    """The problem with these effects as last candidates, each along its time profiles, those of one effect after the
    other."""
    time_profiles, which = [*problem.time_profiles], []
    for number, own in enumerate(profiles, start=len(problem.effects)):
        for profile in own:
            known = next((c for c, one in enumerate(time_profiles) if one is profile), len(time_profiles))
            time_profiles += [profile] if known == len(time_profiles) else []
            which.append((number, known))
    return replace(problem, effects=(*problem.effects, *rows), time_profiles=tuple(time_profiles),
                   which=np.vstack([problem.which, np.reshape(which, (-1, 2)).astype(int)]))


# how finely the share of a block is known that a step leaves; by how much -2 ln posterior must be lower for it to be
# within one
SHARE_STEP, WITHIN = 0.005, 16.0


def sharpen_time(problem: DiagnosisProblem, fitted: Fit, effect: int, time_profile: TimeProfile) -> TimeProfile:
    """The step of effect number `effect` that scores highest among all blocks between the neighbours of `time_profile`
    in the search's grid; blocks that lie on the wrong side of a strong step look like an effect of their own."""
    tried = _steps_between_neighbours(problem, time_profile)
    design = replace(fitted.design, time_profiles=(fitted.design.time_profiles[0], *tried),
                     which=np.array([(effect, c + 1) for c in range(len(tried))]))
    information = design.information
    score = np.abs(design.scores(fitted.centred)) / np.sqrt(np.maximum(information, 1e-300))
    return tried[int(np.argmax(np.where(information > 0, score, 0.0)))]


def sharpened_again(problem: DiagnosisProblem, fitted: Fit) -> tuple[IncludedEffect, ...]:
    """The fit's included effects, each step at the time that leaves least, where need be within a block: where another
    effect was still unknown the scores may have been misled."""
    included, answers = list(fitted.included), ModelAnswers()
    held, noise = fitted.design.fitted_unknowns(len(problem.updated)), fitted.design.noise
    for i, n in enumerate(included):
        if n.time_profile.kind != "step":
            continue

        def misfit_at(time_profile: TimeProfile, design=fitted.design, n=n, i=i) -> float:
            tried = [*included[:i], replace(n, time_profile=time_profile), *included[i + 1 :]]
            residuals = residuals_at(problem, fitted.theta, tried, answers)
            return design.misfit(kept_columns(residuals, noise), held)

        # where two leave the same the one that is there
        there = step_profile(len(problem.blocks), n.time_profile.at)
        best = min([there, *_steps_between_neighbours(problem, n.time_profile)], key=misfit_at)
        # a block between both states is far from both its neighbours, which a share of the step may explain
        counted = replace(fitted.design, noise=noise.with_usual_weights((best.at - 1, best.at)))
        remaining = partial(misfit_at, design=counted)
        # what has one size only has no share of it
        within = best if n.effect.discrete else _step_within_block(best, remaining)
        included[i] = replace(n, time_profile=within if remaining(within) < remaining(best) - WITHIN else best)
    return tuple(included)


def _step_within_block(time_profile: TimeProfile, left: Callable[[TimeProfile], float]) -> TimeProfile:
    """The step within the block before it or after it that leaves least. 0.4 for a third is twelve standard
    deviations of a clock that is 45 ms late, and had been bought as a filter."""
    def with_share(block: int, share: float) -> TimeProfile:
        value = np.array(time_profile.value, float)
        value[block] = share
        return replace(time_profile, value=frozen_array(value))

    found = []
    for block in (time_profile.at - 1, time_profile.at):
        share = optimize.minimize_scalar(lambda share, block=block: left(with_share(block, share)), bounds=(0, 1),
                                         method="bounded", options={"xatol": SHARE_STEP}).x
        found.append(with_share(block, float(share)))
    return min(found, key=left)


def _steps_between_neighbours(problem: DiagnosisProblem, time_profile: TimeProfile) -> list[TimeProfile]:
    """Steps at all blocks between the neighbours of one in the search's grid, or an end of the record."""
    n = len(problem.blocks)
    grid = np.array([1, *(c.at for c in problem.time_profiles if c.kind == "step"), n - 1])
    low = int(np.max(grid[grid < time_profile.at], initial=1))
    high = int(np.min(grid[grid > time_profile.at], initial=n - 1))
    return [step_profile(n, at) for at in range(low, high + 1)]
