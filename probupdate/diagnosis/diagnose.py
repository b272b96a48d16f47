"""The diagnosis of a record: fit what is normal, test every effect, name what is beyond it, say what is not seen."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from scipy import special, stats

from probupdate.diagnosis.adequacy import (
    ADEQUATE,
    FREQUENCIES,
    SHAPES,
    adequacy,
    explains,
    frequencies_off,
    shapes_off,
    span_left,
)
from probupdate.diagnosis.blocks import FEWEST
from probupdate.diagnosis.elementary import (
    COMPETING_HEIGHTS,
    OWN_RESPONSE,
    PART_CAUSES,
    OwnResponse,
    alternative_parts,
    channel_response_of_one,
    channel_responses,
    parts_of,
    replaceable_groups,
)
from probupdate.diagnosis.engine.verdict import CHANCE, POWER, verdict_of
from probupdate.diagnosis.evidence import log_evidence, sizes_in_own_std, sizes_std
from probupdate.diagnosis.fitting import Fit, design_at, error_scale, fit, fitted_without_candidates
from probupdate.diagnosis.hypotheses import Exploration, exchange_effect, explore, refit_without
from probupdate.diagnosis.model_error import (
    DISCREPANCY_SCALES,
    FREQUENCY_SCALES,
    LARGER_ERROR,
    constant,
    error_factors,
    error_without,
    larger_error,
    stated_error,
)
from probupdate.diagnosis.prepare import Prepared
from probupdate.diagnosis.problem import (
    DiagnosisProblem,
    IncludedEffect,
    diagnosis_problem,
    local_std,
    prior_shift,
)
from probupdate.diagnosis.ranking import Hypothesis, key_of
from probupdate.diagnosis.results import Alternative, DetectableSize, Diagnosis, Finding
from probupdate.diagnosis.search import (
    Search,
    conditional_scores,
    drawn_scores,
    least_by_chance,
    model_error_dispersion,
    search,
)
from probupdate.diagnosis.time_profiles import DAY_H, DAY_STD, TIME_OF_DAY
from probupdate.diagnosis.wording import NOT_SETTLED, error_words
from probupdate.effects.catalogue import Effect
from probupdate.errors import ConvergenceError, InputError
from probupdate.io.result_table import plural
from probupdate.modal.modes import ModalData
from probupdate.runtime.executors import SERIAL, Executor
from probupdate.runtime.progress import Progress, silent

# effects of one hypothesis
MOST_EFFECTS = 3
# chance alone makes a largest score as high so seldom that it is no explanation, however improbable each cause
NOT_BY_CHANCE = 1e-3
# sets of which nothing is compared are said where they are so many, as a share of all, on one side of a time, and this
# share of that side
LOST_SHARE, MOSTLY = 0.1, 0.8
# share of a stiffness from which it is lost altogether
TOTAL_LOSS = 0.9
# standard deviations from zero at which something within its tolerance is said; within which nothing is left of a size
NOTED_STD, UNCERTAIN_STD = 3.0, 2.0
# standard deviations of its prior by which a parameter may be shifted in a fit that explains the record
FARTHEST = 6.0
# share of days with a larger wave of the temperature, below which it is said
ODD_DAY = 0.05
NOT_TESTED = ("too few effects span the residuals' directions: of the residuals only the mean frequencies were "
              "tested")
NO_PLACES = ("where the sensors are is not known: rotations, clocks, filters and the sampling rate were not looked "
             "for; give node_position_m, dof_node and dof_direction in the model, or --campaign")
ALIKE_SHAPES = "measured shapes of modes that the model distinguishes are the same, so that they carry no information"


@dataclass(frozen=True, eq=False, kw_only=True)
class Outcome:
    """The diagnosis with what it was read from: the findings of the most probable hypothesis (`proposed`), which are
    none of the diagnosis where that explains too little; the fit of the model as it is (`null`), the fit with
    everything proposed (`fitted`, its `included` in that order), and the first and the last search. `own_response`:
    that of channels, where it is more probable than what the catalogue says of them."""

    diagnosis: Diagnosis
    proposed: tuple[Finding, ...]
    problem: DiagnosisProblem
    null: Fit
    fitted: Fit
    first: Search
    last: Search
    own_response: OwnResponse | None = None


def diagnose(prepared: Prepared, data: ModalData, *, seed: int = 1, progress: Progress = silent) -> Diagnosis:
    """Find what the model gets wrong in these blocks."""
    return examine(prepared, data, seed=seed, progress=progress).diagnosis


def examine(
    prepared: Prepared, data: ModalData, *, most: int = MOST_EFFECTS, begun: Sequence[IncludedEffect] = (),
    seed: int = 1, runs: Executor = SERIAL, progress: Progress = silent,
) -> Outcome:
    """`diagnose` with all that its pictures, the gain and the extended model need; of at most so many effects, those
    that are `begun` tried first (see `explore`). Hypotheses that do not need one another are fitted side by side on the
    executor `runs`."""
    problem, theta = diagnosis_problem(prepared, data)
    progress("diagnosing", 0, most + 1)
    null, explored = _explore_scales(problem, theta, most=most, begun=begun, seed=seed, runs=runs, progress=progress)
    explored, findings, refuted = _exclude_chance(explored, seed)
    findings, own_response = _add_elementary_parts(prepared, explored, findings, refuted, runs)
    problem, chosen = explored.problem, explored.hypotheses[0]
    first, found, fitted = explored.first, explored.last, chosen.fitted
    if len(problem.which) > len(null.design.which):
        # crosstalks were taken up on the way
        null = replace(null, design=design_at(problem, null.theta, (), null.design.noise))
    fits, remaining = adequacy(problem, fitted, found, drawn_scores(fitted.design, seed))
    if remaining[SHAPES] < ADEQUATE and not findings:
        # what no row describes of a single channel is not a row's neighbour either
        own_response = channel_response_of_one(explored, runs)
    progress("diagnosing", most + 1, most + 1)
    silent, lost, foreign = _silent_groups(fitted), _missing_numbers_note(problem), _other_part_statements(findings)
    parameters = tuple(_parameters(problem, null, fitted))
    day = _day(problem, fitted) if not findings else ()
    far = _extreme_parameters_note(parameters) + ([] if day else _implausible_temperature_note(problem, fitted))
    beyond, beyond_chance = _threshold_note(found), not findings and first.p_value < NOT_BY_CHANCE
    unexplained = (fits < ADEQUATE or beyond_chance or explored.one_more or silent or far or beyond or foreign
                   or _is_distorted_by_others(problem, fitted) or not fitted.settled or (lost and not findings))
    verdict = "unexplained" if unexplained else verdict_of([*findings, *day])
    diagnosis = Diagnosis(
        verdict=verdict,
        findings=(*findings, *day),
        p_value=_p_value(problem, null, first, seed) if findings else _p_without_findings(first, fits, day),
        detectable_sizes=_detectable_sizes(problem, first, null),
        threshold=first.threshold,
        adequacy_p=fits,
        notes=(
            *lost,
            *problem.notes,
            *chance_note(explored),
            *([] if remaining.keys() - {FREQUENCIES, SHAPES} else [NOT_TESTED]),
            *(frequencies_off(problem, fitted) if remaining[FREQUENCIES] < ADEQUATE else []),
            *(shapes_off(problem, fitted) if remaining[SHAPES] < ADEQUATE else []),
            *([] if verdict == "unexplained" else _tolerances_noted(problem, fitted)),
            *_bound_notes(fitted),
            *far,
            *foreign,
            *beyond,
            *_short_size_statements(fitted, [f.size_std for f in findings]),
            *_open_questions(verdict, prepared, fitted),
            *(f"modes {problem.blocks.group_name(q)}: {ALIKE_SHAPES}" for q in silent),
            *_strays(problem, fitted),
        ),
        parameters=parameters,
        details={"adequacy": remaining, **error_without(problem, chosen)},
    )
    if verdict == "unexplained":
        diagnosis = diagnosis.left_unexplained()
    return Outcome(diagnosis=diagnosis, proposed=tuple(findings), problem=problem, null=null, fitted=fitted,
                   first=first, last=found, own_response=own_response)


def _open_questions(verdict: str, prepared: Prepared, fitted: Fit) -> list[str]:
    """What was not looked for in a record that is unexplained, and whether the fit settled."""
    not_looked_for = verdict == "unexplained" and not prepared.sensors
    return [*([NO_PLACES] if not_looked_for else []), *([] if fitted.settled else [NOT_SETTLED])]


def _add_elementary_parts(
    prepared: Prepared, explored: Exploration, findings: list[Finding], refuted: Collection[int], runs: Executor
) -> tuple[list[Finding], OwnResponse | None]:
    """The findings with elementary parts among their competing hypotheses, and the frequency response of channels that
    is more probable than what the catalogue says of them, and than any part in place of findings."""
    if not findings:
        return findings, None
    parts, best = parts_of(prepared, heights=COMPETING_HEIGHTS), explored.hypotheses[0]
    together = replaceable_groups(best.fitted.included)
    found_instead = runs.in_order(alternative_parts, [(numbers,) for numbers in together],
                                  shared=(parts, explored.problem, best))
    instead = dict(zip(together, found_instead, strict=True))
    for numbers in together:
        if constant(best, numbers):
            instead[numbers] = [*instead[numbers], larger_error(explored.problem, best, numbers)]
    most = max((evidence + prior for found in instead.values() for _, evidence, prior in found), default=-np.inf)
    responses = [one for one in channel_responses(explored) if one.log_evidence + one.log_prior > most]
    if responses or any(instead.values()):
        findings = findings_of(explored, instead, refuted, responses)
    return findings, _most_probable_response(findings, responses)


def _explore_scales(
    problem: DiagnosisProblem, theta: np.ndarray, *, most: int, begun: Sequence[IncludedEffect], seed: int,
    runs: Executor, progress: Progress,
) -> tuple[Fit, Exploration]:
    """The model as it is, fitted, and all that was fitted beside it. A few sets show no scatter that would say by how
    much the model is wrong everywhere: the scale of its discrepancy is then an unknown too, alike before the data, and
    the one with the most probable hypothesis is kept; of frequencies, whose share of it differs from one structure to
    another, once more beside that of the shapes."""
    if not problem.blocks.few:
        null = _fitted_null(problem, theta)
        return null, explore(problem, null, most=most, begun=begun, seed=seed, runs=runs, progress=progress)
    tried: dict[tuple[float, float], tuple[Fit, Exploration]] = {}
    failures = []

    def explore_at(frequencies: float, shapes: float) -> None:
        scaled = _scale_discrepancy(problem, frequencies, shapes)
        try:
            null = _fitted_null(scaled, theta)
            tried[frequencies, shapes] = null, explore(scaled, null, most=most, begun=begun, seed=seed, runs=runs,
                                                            progress=progress)
        except ConvergenceError as error:
            failures.append(error)

    for scale in DISCREPANCY_SCALES:
        explore_at(scale, scale)
    if not tried:
        raise failures[-1]
    common, shapes = _most_probable_scales(tried)
    found = tried[common, shapes][1]
    # its effects may be crosstalks that were taken up on the way
    wider = replace(problem, effects=found.problem.effects, which=found.problem.which)
    alone = {f: log_evidence(wider, fitted) for f in FREQUENCY_SCALES
             if (fitted := _fitted_at(_scale_discrepancy(wider, f, shapes), found.hypotheses[0].fitted)) is not None}
    frequencies = max(alone, key=lambda f: alone[f], default=common)
    if frequencies != common:
        explore_at(frequencies, shapes)
    return tried[_most_probable_scales(tried)]


def _fitted_null(problem: DiagnosisProblem, theta: np.ndarray) -> Fit:
    """The model as it is, fitted; raises InputError where hardly a set says anything of any group of modes: the scatter
    between fewer than FEWEST, or half of a short record, is no noise that effects could be tested against."""
    null = fit(problem, theta)
    n, say = len(problem.blocks), int(np.count_nonzero(np.any(null.design.noise.weight, axis=0)))
    if say < (1 if problem.blocks.few else min(FEWEST, n // 2)):
        raise InputError("modes", f"{n - say} of {n} sets carry no information: in each group of modes one is missing "
                         "or not distinguishable; too little is left to compare",
                         "identify both modes of each pair, or give frequencies without shapes")
    return null


def _most_probable_scales(tried: Mapping[tuple[float, float], tuple[Fit, Exploration]]) -> tuple[float, float]:
    return max(tried, key=lambda scales: tried[scales][1].hypotheses[0].log_posterior)


def _fitted_at(problem: DiagnosisProblem, nearby: Fit) -> Fit | None:
    try:
        return fitted_without_candidates(problem, nearby.theta, nearby.included)
    except ConvergenceError:
        return None


def _scale_discrepancy(problem: DiagnosisProblem, frequencies: float, shapes: float) -> DiagnosisProblem:
    """The problem with so many times the usual discrepancy of frequencies and of shapes, and a note that says so."""
    if frequencies == shapes == 1:
        return problem
    scaled = replace(problem, discrepancy_std=tuple(
        std * factor for std, factor in zip(problem.discrepancy_std, error_factors(problem, frequencies, shapes),
                                            strict=True)))
    times = f"{shapes:g}" if frequencies == shapes else f"{frequencies:g} and {shapes:g}"
    note = (f"the model discrepancy is taken {times} times as large as "
            f"{'usual' if problem.discrepancy_scale == 1 else 'stated'} ({error_words(stated_error(scaled))}): this "
            "makes the measured modes most probable")
    return replace(scaled, blocks=replace(problem.blocks, notes=(*problem.blocks.notes, note)))


def _exclude_chance(explored: Exploration, seed: int) -> tuple[Exploration, list[Finding], set[int]]:
    """What was explored with the most probable hypothesis whose findings all are more probable than chance alone, and
    these: evidence counts each in full, their probabilities by what theory does not know of so strong signatures.
    Chance is no explanation where what it leaves is none while the finding explains it, as what theory does not know is
    part of that test too: such findings' numbers are the last value."""
    refuted: set[int] = set()
    while True:
        best, findings = explored.hypotheses[0], findings_of(explored, refuted=refuted)
        chance = [sum(a.posterior_probability for a in f.alternatives if a.cause == CHANCE) - f.posterior_probability
                  for f in findings]
        if not findings or max(chance) <= 0:
            return explored, findings, refuted
        problem, out = explored.problem, int(np.argmax(chance))
        rest = key_of(problem, [k for number, k in enumerate(best.candidates) if number != out])
        row = next((k for k, h in enumerate(explored.hypotheses) if key_of(problem, h.candidates) == rest), None)
        if row is None:
            return explored, findings, refuted
        # crosstalks may have been taken up after it
        there = explored.hypotheses[row].with_design(problem)
        found = search(problem, there.fitted, seed=seed, z_included=there.z, heavier=explored.first.heavier)
        if not explains(problem, there.fitted, found, seed) and explains(problem, best.fitted, explored.last, seed):
            refuted.add(out)
            continue
        refuted = set()
        kept = [row, *(k for k in range(1, len(explored.hypotheses)) if k != row)]
        rows = (there, *(explored.hypotheses[k] for k in kept[1:]))
        explored = replace(explored, hypotheses=rows, last=found, one_more=False,
                           log_posterior=explored.log_posterior[kept] - explored.log_posterior[row])


def findings_of(
    explored: Exploration,
    instead: Mapping[tuple[int, ...], Sequence[tuple[Effect | Alternative, float, float]]] = MappingProxyType({}),
    refuted: Collection[int] = (), responses: Sequence[OwnResponse] = (),
) -> list[Finding]:
    """The effects of the most probable hypothesis, each with its probability among all that differ from it in this
    effect alone. `instead`: what else may be meant by the effects of these numbers, with ln evidence and ln prior
    relative to them; `responses`: what channels may show instead. `refuted`: numbers of effects in whose place nothing
    at all explains the record no longer."""
    problem, best = explored.problem, explored.hypotheses[0]
    result = []
    determined = sizes_in_own_std(best.fitted)
    for number, (n, std) in enumerate(zip(best.fitted.included, sizes_std(problem, best.fitted), strict=True)):
        # evidence counts by what the best fit leaves, as in quasi-likelihood, and by what theory does not know of so
        # strong a signature, nor of those that stand beside it
        k, z = best.candidates[number], best.z[number]
        left, directions = span_left(problem, best.fitted, problem.which[k, 1])
        others, evidence, prior = exchange_effect(explored, number)
        for numbers, parts in instead.items():
            for other, apart, before in parts if number in numbers else ():
                others, evidence, prior = [*others, other], [*evidence, apart], [*prior, before]
        if number in refuted and None in others:
            nothing = others.index(None)
            for row in (others, evidence, prior):
                del row[nothing]
        own_error = model_error_dispersion(min(abs(z), determined[number]), error_scale(n.effect))
        dispersion = max(left / directions, own_error, _shared_error_share(problem, best, number))
        explains = [value / dispersion for value in evidence]
        for one in responses:
            # a signature's error is in its evidence, and factors of their own have no signature
            if number in one.numbers:
                others, prior = [*others, one.row], [*prior, one.log_prior]
                explains.append(one.log_evidence / max(left / directions, 1.0))
        log_odds = np.add(explains, prior)
        if None in others and len(best.candidates) == 1:
            # noise that was itself estimated makes large scores by chance more often than its evidence knows
            nothing, least = others.index(None), least_by_chance(explored.first.p_value)
            causes = special.logsumexp(np.delete(log_odds, nothing))
            log_odds[nothing] = max(log_odds[nothing], causes + np.log(max(least, 1e-300)))
        probability = special.softmax(log_odds)
        effect, time_profile = n.effect, n.time_profile
        start = problem.blocks.ids[time_profile.at] if time_profile.kind == "step" else ""
        result.append(Finding(
            kind=effect.kind, cause=effect.cause, location=effect.location, size=n.size, size_std=std,
            unit=effect.unit + time_profile.unit, time_profile=time_profile.name, time_profile_start=start, z=z,
            posterior_probability=float(probability[0]), prior_probability=float(special.softmax(prior)[0]),
            alternatives=_alternatives(others[1:], probability[1:]), check=effect.check, key=effect.key))
    return result


def _alternatives(
    others: Sequence[Effect | Alternative | None], probability: Sequence[float]
) -> tuple[Alternative, ...]:
    """The most probable first; the same part in place of one finding and of several is one."""
    together: dict[Hashable, Alternative] = {}
    for other, p in zip(others, probability, strict=True):
        key, cause, where = (CHANCE, CHANCE, "") if other is None else (other.key, other.cause, other.location)
        before = together[key].posterior_probability if key in together else 0.0
        together[key] = Alternative(cause=cause, location=where, posterior_probability=before + float(p), key=key)
    return tuple(sorted((one for one in together.values() if one.posterior_probability > 1e-3),
                        key=lambda one: -one.posterior_probability))


def _shared_error_share(problem: DiagnosisProblem, best: Hypothesis, number: int) -> float:
    """How much less the record says of one effect of a hypothesis for what theory does not know of the others."""
    if len(best.candidates) == 1:
        return 1.0
    rest, _ = refit_without(problem, best.fitted, number)
    z = [value for i, value in enumerate(best.z) if i != number]
    _, known = conditional_scores(problem, rest.design, rest.centred, rest.included, z)
    k = best.candidates[number]
    return float(rest.design.information[k] / known[k]) if known[k] > 0 else 1.0


def chance_note(explored: Exploration) -> list[str]:
    """What to say of a score beyond the threshold that no effect makes probable."""
    last = explored.last
    if explored.one_more or not last.statistic.max() > last.threshold:
        return []
    j, c = last.which[int(np.argmax(last.statistic))]
    # of searches beside findings fewer may alarm than of the first one, whose threshold the summary states
    beside = explored.hypotheses[0].candidates
    where = " beside the findings" if beside else ""
    threshold = (f"the threshold of {last.threshold:.1f} that holds there (of the first search "
                 f"{explored.first.threshold:.1f})" if beside else f"the threshold of {last.threshold:.1f}")
    return [
        f"{explored.problem.effects[j].name} ({explored.problem.time_profiles[c].name}) scores |z| = "
        f"{last.statistic.max():.1f}{where}, beyond {threshold}; by their evidence and prior odds "
        "no effect of the catalogue is more probable than chance"
    ]


def _silent_groups(fitted: Fit) -> list[int]:
    """Groups of which no block says anything at the fit."""
    return [q for q, weight in enumerate(fitted.design.noise.weight) if not weight.any()]


def _missing_numbers_note(problem: DiagnosisProblem) -> list[str]:
    """What to say where since a set, or up to it, hardly any has a number of any group of modes although modes were
    identified, and others have: what happened is not followed, and is not nothing. By the hypergeometric probability of
    so many of all such sets on one side, for every set and either side."""
    lost = ~np.any(problem.measured[1], axis=0)
    n, total = len(lost), int(lost.sum())
    if problem.blocks.few or not total:
        return []
    at = np.arange(1, n)
    before = np.cumsum(lost)[:-1]
    sides = np.concatenate([n - at, at]), np.concatenate([total - before, before])
    chance = stats.hypergeom.sf(sides[1] - 1, n, total, sides[0])
    chance[(sides[0] <= LOST_SHARE * n) | (sides[1] < MOSTLY * sides[0])] = 1.0
    best = int(np.argmin(chance))
    if len(chance) * chance[best] > NOT_BY_CHANCE:
        return []
    ids, since = problem.blocks.ids, best < n - 1
    when = f"since {ids[at[best]]}" if since else f"before {ids[at[best - n + 1]]}"
    side, silent = int(sides[0][best]), int(sides[1][best])
    return [f"{when} {silent} of {side} sets have modes but no information: in each group of modes one is missing or "
            f"not distinguishable; of the others {total - silent} of {n - side}: a sensor or the structure may have "
            "changed; look at the levels of the channels before and since"]


def _strays(problem: DiagnosisProblem, fitted: Fit) -> list[str]:
    """What to say of sets that are far from both their neighbours."""
    result = []
    for q, stray in enumerate(fitted.design.noise.stray):
        ids = [problem.blocks.ids[k] for k in np.flatnonzero(stray)]
        if ids:
            result.append(f"modes {problem.blocks.group_name(q)}: {plural(len(ids), 'set')} far from both neighbours, "
                          f"as where another mode was identified, {'has' if len(ids) == 1 else 'have'} almost no "
                          f"weight ({', '.join(ids[:3])}{', ...' * (len(ids) > 3)})")
    return result


def _is_at_bound(included: IncludedEffect) -> bool:
    return not included.effect.discrete and bool(np.isclose(included.size, included.bounds, rtol=1e-3).any())


def _is_total_loss(included: IncludedEffect) -> bool:
    """Whether a size at an end is all there can be: a stiffness or a joint that is lost, a member full of water."""
    share = included.effect.unit in ("", "-") and included.time_profile.kind != "covariate"
    # what may rise as well as fall is at its upper end by far more than was expected, not in full
    falls = all(amount * included.size <= 0 for _, amount in included.effect.increments)
    whole = falls or included.bounds[0] >= 0
    return share and whole and TOTAL_LOSS <= abs(included.size) <= 1


def _is_distorted_by_others(problem: DiagnosisProblem, fitted: Fit) -> bool:
    """Whether something else is bent into a row of the structure: its size stands at an end where a larger one may be
    meant, or is no better known than from zero there."""
    return any(
        _is_at_bound(n) and n.effect.kind != "measurement"
        and (not _is_total_loss(n) or abs(n.size) <= UNCERTAIN_STD * std)
        for n, std in zip(fitted.included, sizes_std(problem, fitted), strict=True)
    )


def _bound_notes(fitted: Fit) -> list[str]:
    """What to say of sizes that stand at an end of what their row allows."""
    return [
        f"{n.effect.name} is {'there in full' if n.bounds[0] >= 0 else 'as good as lost altogether'}: no larger size "
        "can be meant, and its interval ends there" if _is_total_loss(n) else
        f"the size of {n.effect.name} stands at an end of what its row allows ({n.bounds[0]:.3g} to {n.bounds[1]:.3g} "
        f"{n.effect.unit}{n.time_profile.unit}): its interval is not to be trusted, a larger size may be meant"
        for n in fitted.included if _is_at_bound(n)
    ]


def _extreme_parameters_note(parameters: Sequence[dict]) -> list[str]:
    """What to say of parameters that only a fit bent into something else would need."""
    return [
        f"{p['name']} would be {p['value_after']:.3g} {p['unit']}, {abs(p['prior_shift_after']):.1f} standard "
        "deviations of its prior away: nothing that follows from it is explained"
        for p in parameters
        if abs(p["prior_shift_after"]) > FARTHEST
    ]


def _weather_sizes(problem: DiagnosisProblem, fitted: Fit) -> tuple[np.ndarray, slice]:
    """Sizes of the waves of a temperature that nobody recorded (n_wave,), and where they stand among the unknowns."""
    rows = slice(fitted.design.sizes.stop, fitted.design.sizes.stop + len(problem.unrecorded))
    return fitted.design.unknowns(fitted.centred)[rows], rows


def _weather_p(problem: DiagnosisProblem, size: np.ndarray, numbers: Sequence[int]) -> float:
    """p of waves of these numbers as large as that, of weather."""
    std = np.array([problem.unrecorded[k][2] for k in numbers])
    return float(stats.chi2.sf(np.sum((size[list(numbers)] / std) ** 2), len(std))) if len(std) else 1.0


def _daily_waves(problem: DiagnosisProblem) -> list[int]:
    """Numbers of the waves of a day and of half a day."""
    return [k for k, (_, p, _) in enumerate(problem.unrecorded) if p.column == TIME_OF_DAY]


def _day(problem: DiagnosisProblem, fitted: Fit) -> tuple[Finding, ...]:
    """A temperature that nobody recorded, as a finding, where it follows the time of day by more than weather does, and
    but for that is weather: of more than two days, as a day alone shows no rhythm."""
    size, rows = _weather_sizes(problem, fitted)
    daily = _daily_waves(problem)
    slow = [k for k in range(len(size)) if k not in daily]
    std = np.array([own for _, _, own in problem.unrecorded])
    if (len(daily) < 2 or np.ptp(problem.blocks.hours) < 2 * DAY_H or _weather_p(problem, size, daily) > ODD_DAY
            or _weather_p(problem, size, slow) <= ADEQUATE or np.any(np.abs(size) > FARTHEST * std)):
        return ()
    first = daily[:2]
    effect, own = problem.effects[problem.unrecorded[first[0]][0]], size[first]
    covariance = fitted.design.unknowns_cov([rows.start + k for k in first])
    amplitude = float(np.linalg.norm(own))
    amplitude_std = float(np.sqrt(own @ covariance @ own)) / amplitude
    return (Finding(kind=effect.kind, cause=effect.cause, location=effect.location, size=amplitude,
                    size_std=amplitude_std, unit=effect.unit, time_profile=TIME_OF_DAY, time_profile_start="",
                    z=amplitude / amplitude_std, posterior_probability=1.0, alternatives=(), check=effect.check,
                    key=effect.key),)


def _implausible_temperature_note(problem: DiagnosisProblem, fitted: Fit) -> list[str]:
    """What to say of a temperature that nobody recorded and that no weather has."""
    size, _ = _weather_sizes(problem, fitted)
    if _weather_p(problem, size, range(len(size))) > ADEQUATE:
        return []
    effects = [problem.effects[j] for j, _, _ in problem.unrecorded]
    warm = sum(a / e.prior_scale * p.value for a, e, (_, p, _) in zip(size, effects, problem.unrecorded, strict=True))
    usual = effects[0].prior_scale
    share = f"{100 * usual:.2g} % of the stiffness" if effects[0].unit == "-" else f"{usual:.2g} degC of the steel"
    return [f"the temperature, which too few sets state, would have run over {np.ptp(warm):.0f} degC or more, at "
            f"{share} per degC, to move the frequencies together as they do: weather of "
            f"{DAY_STD:g} degC (standard deviation) does not; with that column it is tested"]


def _other_part_statements(findings: Sequence[Finding]) -> list[str]:
    """What to say of findings for which an elementary part that no row describes is more probable."""
    instead: dict[Hashable, list[tuple[Finding, Alternative]]] = {}
    for f in findings:
        part = _likelier_part(f)
        if part is not None:
            instead.setdefault(part.key, []).append((f, part))
    result = []
    for pairs in instead.values():
        _, part = pairs[0]
        names = " and ".join(f"{f.name}," for f, _ in pairs)
        least, most = min(p.posterior_probability for _, p in pairs), max(f.posterior_probability for f, _ in pairs)
        what, meaning = f"an elementary part, {part.cause}", "no row of the catalogue describes what is there"
        if part.cause == LARGER_ERROR:
            what, meaning = f"a {part.cause}", "compare with another model of that part, or state it with --discrepancy"
        result.append(f"{names} {'is' if len(pairs) == 1 else 'are'} less probable ({most:.2g}) than {what}: "
                      f"{part.location} ({least:.2g}); {meaning}")
    return result


def _likelier_part(found: Finding) -> Alternative | None:
    """The most probable elementary part, where it is more probable than a finding."""
    part = next((a for a in found.alternatives if a.cause in (*PART_CAUSES, OWN_RESPONSE, LARGER_ERROR)), None)
    return part if part is not None and part.posterior_probability > found.posterior_probability else None


def _most_probable_response(findings: Sequence[Finding], responses: Sequence[OwnResponse]) -> OwnResponse | None:
    """The most probable of those that are more probable than a finding in whose place they are."""
    likelier = [one for one in responses for part in map(_likelier_part, (findings[k] for k in one.numbers))
                if part is not None and part.key == one.row.key]
    return max(likelier, key=lambda one: one.log_evidence + one.log_prior, default=None)


def _p_value(problem: DiagnosisProblem, null: Fit, first: Search, seed: int) -> float:
    """Of the model as it is, by its largest score; by what it leaves where scores say nothing."""
    if first.scores_impossible:
        return adequacy(problem, null, first, drawn_scores(null.design, seed))[0]
    return first.p_value


def _p_without_findings(first: Search, fits: float, day: Sequence[Finding]) -> float:
    """Of the largest score and of what is left together, and of a day's wave where there is one."""
    return float(min(1.0, 2 * min(first.p_value, fits), *(stats.chi2.sf(f.z**2, 2) for f in day)))


def _threshold_note(found: Search) -> list[str]:
    """What to say where scores need a threshold beyond sense."""
    if not found.scores_impossible:
        return []
    return [f"the threshold |z| = {found.threshold:.0f} is too high for {len(found.z)} candidates: the uncertainty of "
            "the model moves these modes beyond the linear range, so that the record is "
            "inconclusive; give the parameters a narrower prior, or leave out modes that nearly meet"]


def _tolerances_noted(problem: DiagnosisProblem, fitted: Fit) -> list[str]:
    """What is within its tolerance, so no finding, and yet surely there: structural rows of more than half their
    tolerance, NOTED_STD of their own standard deviations from zero."""
    chosen = [k for k, j in enumerate(problem.effects_with_tolerance) if problem.effects[j].kind == "structural"]
    rows = len(problem.updated) + np.array(chosen, int)
    size = fitted.design.unknowns(fitted.centred)[rows]
    std = np.sqrt(np.diag(fitted.design.unknowns_cov(rows)))
    result = []
    for k, value, own in zip(chosen, size, std, strict=True):
        effect = problem.effects[problem.effects_with_tolerance[k]]
        if abs(value) > max(NOTED_STD * own, 0.5 * effect.tolerance):
            result.append(f"{effect.name}: {value:.3g} +- {own:.2g} {effect.unit}, within what is normal (tolerance "
                          f"{effect.tolerance:.2g}) and so no finding, but the record shows it; {effect.check}")
    return result


def _short_size_statements(fitted: Fit, sizes_std: Sequence[float]) -> list[str]:
    """Sizes that the fit left short of where its equations point, by a standard deviation that counts."""
    return [f"{n.effect.name}: the fit of its size stopped {short:.2g} {n.effect.unit} short of its linear solution; "
            "the interval includes that"
            for n, short, std in zip(fitted.included, fitted.short, sizes_std, strict=True)
            if short > 0.5 * std > 0]


def _detectable_sizes(problem: DiagnosisProblem, found: Search, fitted: Fit) -> tuple[DetectableSize, ...]:
    best: dict[tuple[int, str], int] = {}
    for k, (j, c) in enumerate(found.which):
        key = (int(j), problem.time_profiles[c].name)
        if key not in best or found.size_std[k] < found.size_std[best[key]]:
            best[key] = k
    detectable_sizes = []
    left = fitted.design.share_left
    for (j, name), k in best.items():
        effect = problem.effects[j]
        size = (found.threshold + POWER) * found.size_std[k]
        here = IncludedEffect(effect=effect, time_profile=problem.time_profiles[problem.which[k, 1]], size=0.0)
        reachable = size <= max(-here.bounds[0], here.bounds[1])
        detectable_sizes.append(DetectableSize(
            kind=effect.kind, cause=effect.cause, location=effect.location, time_profile=name,
            size=float(size) if reachable else np.inf, unit=effect.unit + here.time_profile.unit,
            share_left=float(left[k]), z=float(found.z[k]), key=effect.key))
    return tuple(detectable_sizes)


def _parameters(problem: DiagnosisProblem, null: Fit, fitted: Fit):
    """Every updated parameter before and after effects were taken in, and its standardised shift from the prior."""
    rows = range(len(problem.updated))
    std = [np.sqrt(np.diag(f.design.unknowns_cov(rows))) for f in (null, fitted)]
    for i, k in enumerate(problem.updated):
        p = problem.prior.items[i]
        shift = [float(-prior_shift(problem, f.theta)[i] / local_std(problem.prior, i, f.theta[k]))
                 for f in (null, fitted)]
        yield {"name": p.name, "unit": p.unit, "prior": p.initial, "prior_std": p.std, "value": float(null.theta[k]),
               "std": float(std[0][i]), "prior_shift": shift[0], "value_after": float(fitted.theta[k]),
               "std_after": float(std[1][i]), "prior_shift_after": shift[1]}
