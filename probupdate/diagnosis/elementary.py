"""Elementary parts that a model may lack: a spring to ground or between two points, a mass, a mass on springs; and
channels with a frequency response of their own.

Of one kind all together are as probable before the data as one row of the catalogue. They stand for what no row
describes: as competing hypotheses of every finding about the structure or about single sensors, and, where the record
stays unexplained, as what says where and in which modes the unknown acts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy import linalg
from scipy.special import logsumexp

from probupdate.diagnosis.evidence import sizes_std
from probupdate.diagnosis.fitting import Fit, design_with_more, fitted_without_candidates
from probupdate.diagnosis.hypotheses import LEAST_LEFT, SAME_TIME, Exploration, refit_without
from probupdate.diagnosis.linear import Design
from probupdate.diagnosis.part_places import (
    N_DIRECTION,
    Direction,
    PartKey,
    directions,
    place_words,
    words_of,
)
from probupdate.diagnosis.prepare import Prepared
from probupdate.diagnosis.problem import DiagnosisProblem, IncludedEffect
from probupdate.diagnosis.proposals import problem_with_effects
from probupdate.diagnosis.ranking import Hypothesis, Ranking, hypothesis_of, key_of, log_prior
from probupdate.diagnosis.search import MARGIN, gains, model_error_dispersion
from probupdate.diagnosis.small_model import TUNING_STD, Attachment, SmallModel
from probupdate.diagnosis.time_profiles import TimeProfile
from probupdate.effects.catalogue import GAIN_RANGE, Effect, FrequencyResponse, Gain
from probupdate.errors import ConvergenceError
from probupdate.modal.matching import close_clusters
from probupdate.model.interface import Wireframe
from probupdate.runtime.executors import Executor
from probupdate.structure.places import SAME_PLACE

# points of the structure where a part may sit
N_POINT = 48
# heights of masses on springs that compete with findings, and of those that are placed: a bay between them is too far
COMPETING_HEIGHTS, PLACED_HEIGHTS = 10, 16
# horizontal directions of a mass on springs: it splits a pair of modes along its own. How far its frequencies are apart
# (in ln f): twice the standard deviation with which each is estimated; where no mode is within the larger distance,
# that one
N_HUNG_DIRECTION, TUNED_APART, FAR_APART = 8, 2 * TUNING_STD, 0.36
# prior standard deviation of a spring over the static stiffness of its points, of a mass over the least modal mass
# there, of one on springs over the least where any may hang; its upper bound in these, and that of one on springs
SHARE, MOST, MOST_HUNG = 0.1, 100.0, 10.0
# parts that are scored at once, and how many of a kind are fitted
CHUNK, FITTED = 160, 3
# ln by which first order may err where the other parameters were bent to follow what a part does
FIRST_ORDER_ERRS = 20.0
# score correlation from which a part does what the row itself does: a mass on the nacelle is the nacelle's
SAME = 0.98
# of motions, as a share: rounding
ALONG = 1e-9
# wire groups that are no place to attach anything: soil is the catalogue's, the rotor turns
NOT_THERE = ("pile", "rna")
PART_CAUSES = ("spring to ground", "spring between two points", "added mass at a point", "mass on springs")
OWN_RESPONSE = "frequency response of its own"
# prior scale of what channels show of one mode, in phase and a quarter of a period ahead: that of a gain
RESPONSE_SCALE = 0.1
# channels of a finding of which each is also tried alone: those of one sensor
MOST_ALONE = 3
# how a mass on springs moves that is on one along either horizontal axis
BOTH_WAYS = "horizontal"


# an elementary part: its row, and where it acts on the small basis
Part = tuple[Effect, Attachment]


def points(wire: Wireframe, most: int = N_POINT) -> np.ndarray:
    """Numbers of the nodes (n,) where parts may sit: where members meet or end, then those farthest from all others."""
    def line_nodes(barred: bool) -> set[int]:
        return {int(k) for line, group in zip(wire.line, wire.line_group, strict=True)
                if (group in NOT_THERE) == barred for k in line}

    barred = line_nodes(True)
    used = np.array(sorted(line_nodes(False))) if len(wire.line) else np.arange(len(wire.node_m))
    extent = float(np.max(np.ptp(wire.node_m[used], axis=0)))
    clusters: list[list[int]] = []
    for k in used:
        near = [c for c in clusters if np.linalg.norm(wire.node_m[c[0]] - wire.node_m[k]) < SAME_PLACE * extent]
        near[0].append(int(k)) if near else clusters.append([int(k)])
    member = {k: number for number, c in enumerate(clusters) for k in c}
    ends = np.zeros(len(clusters), int)
    for line in wire.line:
        a, b = (member.get(int(k)) for k in line)
        # a line within a cluster is an eccentricity or a joint
        for one in {a, b} if a != b else ():
            if one is not None:
                ends[one] += 1
    chief = np.array([next((k for k in c if k not in barred), c[0]) for c in clusters])
    place = wire.node_m[chief]
    chosen = [int(i) for i in np.flatnonzero((ends >= 3) | (ends == 1))]
    chosen = chosen or [int(np.argmax(place[:, 2]))]
    away = np.min(np.linalg.norm(place[:, None] - place[chosen][None], axis=2), axis=1)
    if len(chosen) > most:
        chosen = farthest(place, chosen, most)
    while len(chosen) < min(most, len(clusters)):
        new = int(np.argmax(away))
        if away[new] < 2 * SAME_PLACE * extent:
            break
        chosen.append(new)
        away = np.minimum(away, np.linalg.norm(place - place[new], axis=1))
    return np.sort(chief[chosen])


def farthest(place: np.ndarray, among: Sequence[int], count: int) -> list[int]:
    """`count` of the rows `among` of place (n, 3), each the one farthest from those before it."""
    result = [max(among, key=lambda i: place[i, 2])]
    while len(result) < min(count, len(among)):
        away = np.min(np.linalg.norm(place[list(among)][:, None] - place[result][None], axis=2), axis=1)
        result.append(among[int(np.argmax(away))])
    return result


def extent_of(wire: Wireframe) -> float:
    """The largest dimension of a structure's picture along an axis, in m."""
    return float(np.max(np.ptp(wire.node_m, axis=0)))


def _group_heights(z_m: np.ndarray, apart_m: float) -> list[np.ndarray]:
    """Numbers of heights (n,), lowest first: those that follow one another by no more than that are one."""
    order = np.argsort(z_m, kind="stable")
    return [np.sort(one) for one in np.split(order, np.flatnonzero(np.diff(z_m[order]) > apart_m) + 1)]


def hanging_points(wire: Wireframe, nodes: np.ndarray, most: int) -> list[tuple[int, int]]:
    """Which of these nodes (n,) a mass on springs may hang at, at most so many heights of the structure, and along how
    many horizontal directions: many where nothing else is at that height; of several nodes there those that are
    farthest from one another, as many as directions."""
    place = wire.node_m[nodes]
    own = _group_heights(place[:, 2], SAME_PLACE * extent_of(wire))
    heights = np.array([[0.0, 0.0, place[k, 2].mean()] for k in own])
    result = []
    for number in sorted(farthest(heights, range(len(own)), most)):
        there = own[number]
        several = len(there) > 1
        chosen = farthest(place, [int(k) for k in there], N_DIRECTION) if several else there
        result += [(int(nodes[k]), N_DIRECTION if several else N_HUNG_DIRECTION) for k in chosen]
    return result


def elementary(
    small: SmallModel, place: Callable[[np.ndarray], str], *, heights: int = 0, tuned_hz: Sequence[float] = ()
) -> list[tuple[Effect, Attachment]]:
    """Every part that may be added: its row and where it acts on the small basis; at the channels of a model without a
    picture. `place`: point (3,) -> words; `heights`: masses on springs at so many heights too, at `tuned_hz` or,
    without these, at frequencies from below the lowest mode to above those looked through."""
    K, M = small.evaluate(small.parameters.initial).matrices()
    value, shape = linalg.eigh(K, M, subset_by_index=(0, small.n_search - 1))
    tuned_hz = tuple(tuned_hz) or tuple(map(float, tunings(np.sqrt(value) / (2 * np.pi))))
    if small.wire is None:
        return _share_odds_by_kind(_channel_parts(small, K, shape, tuned_hz if heights else ()))
    wire, at_nodes = small.picture
    nodes = points(wire)
    flexibility = linalg.cho_factor(K)
    rows = {int(k): at_nodes[3 * k : 3 * k + 3] for k in nodes}
    there = dict(zip(map(int, nodes), words_of(wire.node_m[nodes], place, extent_of(wire)), strict=True))
    result = []

    def spring(key: PartKey, words: str, b: np.ndarray) -> None:
        gives_way = float(b @ linalg.cho_solve(flexibility, b))
        # a point that the model holds, or knows no motion of that way
        if not gives_way > 0:
            return
        stiffness = 1 / gives_way
        result.append(_part(key, words, SHARE * stiffness, stiffness=b[None]))

    for k, own in rows.items():
        for way, b in _distinct_directions(own, directions()):
            spring(PartKey(cause=PART_CAUSES[0], at=(k,), way=way.number), f"{there[k]}, {way.words}", b)
        moved = float(np.max(np.sum((own @ shape) ** 2, axis=0)))
        if not moved > 0:
            continue
        modal_mass = 1 / moved
        result.append(_part(PartKey(cause=PART_CAUSES[2], at=(k,)), there[k], SHARE * modal_mass, mass=own))
    lined = {frozenset(map(int, line)) for line in wire.line}
    for a, b in combinations(map(int, nodes), 2):
        way = wire.node_m[b] - wire.node_m[a]
        if frozenset((a, b)) not in lined:
            spring(PartKey(cause=PART_CAUSES[1], at=(a, b)), f"{there[a]} and {there[b]}",
                   way / np.linalg.norm(way) @ (rows[b] - rows[a]))
    hung = hanging_points(wire, nodes, heights) if heights else []
    # what hangs where little moves is no heavier for that
    most = max((float(np.max(np.sum((rows[k][:2] @ shape) ** 2, axis=0))) for k, _ in hung), default=0.0)
    for k, n in hung if most > 0 else ():
        one_way = [(way.number, way.words, b[None]) for way, b in _distinct_directions(rows[k], directions(n)[:-1])]
        # where there is motion one way only, both ways are that one
        for way, words, own in [*one_way, *([(None, BOTH_WAYS, rows[k][:2])] if len(one_way) > 1 else [])]:
            for hz in tuned_hz:
                key = PartKey(cause=PART_CAUSES[3], at=(k,), way=way, tuned_hz=hz)
                result.append(_part(key, f"{there[k]}, {words}", SHARE / most, MOST_HUNG, mass=own))
    return _share_odds_by_kind(result)


def _distinct_directions(own: np.ndarray, ways: Sequence[Direction]) -> list[tuple[Direction, np.ndarray]]:
    """Of these directions those along which a node of motions `own` (3, r) on the basis moves, each with the motion
    (r,): of those along which it moves alike, as where the model knows no motion across its plane, the nearest to
    it."""
    moved = [way.unit @ own for way in ways]
    length = np.array([np.linalg.norm(b) for b in moved])
    chosen: list[int] = []
    for k in np.argsort(-length, kind="stable"):
        if length[k] > ALONG * length.max() and all(
            abs(moved[k] @ moved[i]) < (1 - ALONG) * length[k] * length[i] for i in chosen
        ):
            chosen.append(int(k))
    return [(ways[k], moved[k]) for k in sorted(chosen)]


def _share_odds_by_kind(parts: Sequence[Part]) -> list[Part]:
    """The parts with the odds of one row for all of a kind together."""
    number = Counter(effect.cause for effect, _ in parts)
    return [(replace(effect, odds=1 / number[effect.cause]), attachment) for effect, attachment in parts]


def _channel_parts(small: SmallModel, K: np.ndarray, shape: np.ndarray, tuned_hz: Sequence[float]) -> list[Part]:
    """Of a model without a picture: parts at its channels, along each, that is a spring to ground, a mass that moves
    that way, and masses on springs of these frequencies. K of the basis, the modes' shapes (r, n) on it."""
    flexibility, result = linalg.cho_factor(K), []
    moved = np.sum((small.motions @ shape) ** 2, axis=1)
    for k, (name, row, own) in enumerate(zip(small.channels, small.motions, moved, strict=True)):
        # a channel that no mode moves is not a place for anything
        if own > 0:
            stiffness, there = 1 / float(row @ linalg.cho_solve(flexibility, row)), f"channel {name}, along it"
            spring, mass, hung = (PartKey(cause=PART_CAUSES[c], at=(k,), way=0) for c in (0, 2, 3))
            result += [_part(spring, there, SHARE * stiffness, stiffness=row[None]),
                       _part(mass, there, SHARE / float(own), mass=row[None]),
                       *(_part(replace(hung, tuned_hz=hz), there, SHARE / float(moved.max()), MOST_HUNG, mass=row[None])
                         for hz in tuned_hz)]
    return result


def tuned_masses_near(prepared: Prepared, tuned_hz: Sequence[float]) -> list[Part]:
    """Masses on springs tuned to these frequencies."""
    return [part for part in parts_of(prepared, heights=COMPETING_HEIGHTS, tuned_hz=tuned_hz)
            if part[0].cause == PART_CAUSES[3]]


def tunings(frequency_hz: np.ndarray) -> np.ndarray:
    """Frequencies of masses on springs for modes of these: TUNED_APART from each other where a mode is within
    FAR_APART, and that far apart where none is."""
    log = np.log(frequency_hz)
    result = [float(log.min() - FAR_APART)]
    while result[-1] < log.max() + 0.5 * FAR_APART:
        near = np.min(np.abs(log - result[-1] - TUNED_APART)) < FAR_APART
        result.append(result[-1] + (TUNED_APART if near else FAR_APART))
    return np.exp(result)


def _part(key: PartKey, where: str, std: float, most: float = MOST, **rows: np.ndarray) -> Part:
    """Of a prior scale `std`, at most so many times that; `rows` of its stiffness or mass, as an attachment has
    them."""
    about = "" if key.tuned_hz is None else f", about {key.tuned_hz:.3g} Hz"
    attachment = Attachment(key=key, where=where, unit="N/m" if "stiffness" in rows else "kg", std=std, lower=0.0,
                            upper=most * std, **rows)
    effect = Effect(kind="structural", cause=key.cause, location=f"{where}{about}", unit=attachment.unit, tolerance=0.0,
                    prior_scale=std, lower=0.0, upper=attachment.upper, parameter=key.parameter,
                    time_profiles=("constant", "step"), check="look there for what the model does not have")
    return effect, attachment


def parts_of(prepared: Prepared, *, heights: int = 0, tuned_hz: Sequence[float] = ()) -> list[Part]:
    """Every part that may be added to a model (see `elementary`); none where it has parts already."""
    if any(effect.cause in PART_CAUSES for effect in prepared.effects):
        return []
    small = prepared.small
    extent = 0.0 if small.wire is None else extent_of(small.wire)
    return elementary(small, place_words(prepared.description, extent), heights=heights, tuned_hz=tuned_hz)


def with_parts(
    problem: DiagnosisProblem, fitted: Fit, parts: Sequence[Part], profiles: Sequence[TimeProfile]
) -> tuple[DiagnosisProblem, Fit]:
    """Problem and fit with these parts as further effects along these time profiles, none of them there. The last rows
    of the problem's `which` are theirs, those of one part after the other."""
    small = problem.predictor.small.attach_parts([attachment for _, attachment in parts])
    wider = problem_with_effects(replace(problem, predictor=replace(problem.predictor, small=small)),
                                 [effect for effect, _ in parts], [profiles] * len(parts))
    padded = replace(fitted, theta=np.pad(fitted.theta, (0, len(small.parameters) - len(fitted.theta))))
    return wider, replace(padded, design=design_with_more(wider, padded, len(problem.effects)))


def scores_of_parts(
    problem: DiagnosisProblem, fitted: Fit, parts: Sequence[Part], profiles: Sequence[TimeProfile],
    own: Sequence[int] = (),
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of every part along every time profile (n_part, n_profile) beside a fit: ln Bayes factor and size to first order,
    and the largest score correlation with the effects of the numbers `own` along the first of these (zero without);
    -inf where nothing of the signature is left beside all that is normal. By chunks, as all parts at once take
    gigabytes."""
    gain, size, alike = (np.zeros((len(parts), len(profiles))) for _ in range(3))
    for start in range(0, len(parts), CHUNK):
        chunk = parts[start : start + CHUNK]
        wider, there = with_parts(problem, fitted, chunk, profiles)
        first, n = len(problem.effects), len(chunk) * len(profiles)
        rows = [(first + j, c) for j in range(len(chunk)) for c in range(len(profiles))]
        rows += [(j, 0) for j in own]
        asked = {"time_profiles": tuple(profiles), "which": np.array(rows)}
        design = replace(there.design, **asked)
        u, v = design.scores(fitted.centred), np.where(design.share_left > LEAST_LEFT, design.information, 0.0)
        found = gains(replace(wider, **asked), u, v)
        here = slice(start, start + len(chunk)), slice(None)
        gain[here], size[here] = (x[:n].reshape(len(chunk), -1) for x in found)
        if own:
            alike[here] = _correlations(design, range(n, len(rows)))[:n].reshape(len(chunk), -1)
    return gain, size, alike


def _correlations(design: Design, rows: Sequence[int]) -> np.ndarray:
    """(n_candidate,) largest score correlations with any of some candidates, without sign."""
    length = np.sqrt(np.maximum(design.information, 1e-300))
    overlap = design.overlap(rows, range(len(length))) / (length * length[list(rows)][:, None])
    return np.max(np.abs(overlap), axis=0)


def replaceable_groups(included: Sequence[IncludedEffect]) -> list[tuple[int, ...]]:
    """Numbers of effects that one part may stand for: each that is constant or a step, and all sets of those that are
    so throughout, or since the same time. What a spring does that no row has is bought as two soils and a brace, or as
    a crosstalk."""
    each = [k for k, n in enumerate(included) if n.exact]

    def coincide(chosen: tuple[int, ...]) -> bool:
        profiles = [included[k].time_profile for k in chosen]
        return all(a.name == b.name and abs(a.at - b.at) <= SAME_TIME for a, b in combinations(profiles, 2))

    return [chosen for count in range(1, len(each) + 1) for chosen in combinations(each, count) if coincide(chosen)]


def _strongest_effect(hypothesis: Hypothesis, numbers: Sequence[int]) -> int:
    """Of the effects of these numbers the one of the largest score: what stands in their place takes its time."""
    return max(numbers, key=lambda k: abs(hypothesis.z[k]))


def alternative_parts(
    parts: Sequence[Part], problem: DiagnosisProblem, best: Hypothesis, numbers: tuple[int, ...]
) -> list[tuple[Effect, float, float]]:
    """What of each kind of part may be meant instead of these effects of the most probable hypothesis, one or several
    `replaceable_groups`: of the few that promise most the one that, fitted, explains most, its ln evidence and ln prior
    relative to theirs. It stands for all of its kind: its prior odds are theirs, each weighed by what it explains
    beside it, or promises to first order where it was not fitted, less what fits of the others fell short of that.
    Parts that do what one of the effects does are not estimated from it and are left out."""
    if not parts:
        return []
    chief = _strongest_effect(best, numbers)
    n, rest, lost = best.fitted.included[chief], best.fitted, 0.0
    for k in sorted(numbers, reverse=True):
        rest, more = refit_without(problem, rest, k)
        lost += more
    own = [int(problem.which[best.candidates[k], 0]) for k in numbers]
    gain, size, alike = (x[:, 0] for x in scores_of_parts(problem, rest, parts, (n.time_profile,), own))
    # the effects themselves have what they lost where they were taken out
    dispersion = model_error_dispersion(best.z[chief])
    odds = np.log([effect.odds for effect, _ in parts])
    promise = np.where(alike < SAME, (gain + lost) / dispersion + odds, -np.inf)
    # one part has its odds once, each of the effects had its own
    before = np.log(n.effect.prior_odds(n.time_profile.name)) + log_prior(
        problem, [best.candidates[k] for k in numbers if k != chief])
    result = []
    for cause in PART_CAUSES:
        of_kind = [k for k, (effect, _) in enumerate(parts) if effect.cause == cause and np.isfinite(promise[k])]
        together = logsumexp(promise[of_kind]) if of_kind else -np.inf
        if together - before < -FIRST_ORDER_ERRS:
            continue
        # where first order is against all of them the most promising one is asked
        count = FITTED if together - before > -MARGIN else 1
        most = sorted(of_kind, key=lambda k: -promise[k])[:count]
        found = {k: _compare_part(problem, best, rest, numbers, parts[k], float(size[k])) for k in most}
        fitted = {k: there for k, there in found.items() if there is not None}
        if not fitted:
            continue
        value = {k: apart / dispersion + odds[k] for k, (apart, _) in fitted.items()}
        short = np.mean([value[k] - promise[k] for k in fitted])
        together = logsumexp([value.get(k, promise[k] + short) for k in of_kind])
        k = max(fitted, key=lambda k: value[k])
        # ln of how many times as probable all of them are as that one alone
        more = float(together - value[k])
        apart, prior = fitted[k]
        result.append((replace(parts[k][0], odds=float(np.exp(more + odds[k]))), apart, prior + more))
    return result


def _compare_part(
    problem: DiagnosisProblem, best: Hypothesis, rest: Fit, numbers: tuple[int, ...], part: Part, size: float
) -> tuple[float, float] | None:
    """ln evidence and ln prior of the most probable hypothesis with a part in place of these effects (`rest` is the fit
    without them), relative to it; None where the model has no modes there."""
    chief = _strongest_effect(best, numbers)
    profile = best.fitted.included[chief].time_profile
    wider, fitted = with_parts(problem, best.fitted, [part], (profile,))
    _, base = with_parts(problem, rest, [part], (profile,))
    begun = IncludedEffect(effect=part[0], time_profile=profile, size=0.0).with_start_size(size)
    try:
        found = fitted_without_candidates(wider, base.theta, (*rest.included, begun), base=base)
    except ConvergenceError:
        return None
    candidates = (*(c for i, c in enumerate(best.candidates) if i not in numbers), len(wider.which) - 1)
    z = (*(z for i, z in enumerate(best.z) if i not in numbers), best.z[chief])
    one, here = hypothesis_of(wider, candidates, z, found), replace(best, fitted=fitted)
    apart, prior = _relative(wider, one, here), one.log_prior - here.log_prior
    return float(apart - prior), float(prior)


@dataclass(frozen=True, eq=False, kw_only=True)
class OwnResponse:
    """Channels with a frequency response of their own in place of the findings `numbers` of the most probable
    hypothesis: `row` stands for all of `fitted`'s effects of one mode each, whose factors it names. ln evidence and ln
    prior relative to that hypothesis; `problem` with these effects. `probability` among all channels, where it stands
    in place of no finding."""

    row: Effect
    numbers: tuple[int, ...]
    problem: DiagnosisProblem
    fitted: Fit
    log_evidence: float
    log_prior: float
    probability: float = np.nan

    def factors(self) -> list[dict]:
        """Per group of modes the factor and the phase of what the channels show over what they should, with standard
        deviations: plain numbers."""
        sizes = zip(self.fitted.included, sizes_std(self.problem, self.fitted), strict=True)
        own, std = zip(*((n, s) for n, s in sizes if n.effect.cause == OWN_RESPONSE), strict=True)
        result = []
        for k in range(0, len(own), 2):
            value = (1 + own[k].size) * (1 + 1j * own[k + 1].size)
            # to first order, of the two that are multiplied
            ahead = 1 + own[k + 1].size ** 2
            of_factor = np.hypot(std[k] * np.sqrt(ahead), (1 + own[k].size) * own[k + 1].size * std[k + 1]
                                 / np.sqrt(ahead))
            result.append({"mode": own[k].effect.location, "factor": float(abs(value)), "factor_std": float(of_factor),
                           "phase_deg": float(np.degrees(np.angle(value))),
                           "phase_std_deg": float(np.degrees(std[k + 1] / ahead))})
        return result


def channel_responses(explored: Exploration) -> list[OwnResponse]:
    """Each set of channels of which a finding of the most probable hypothesis says that all of them are wrong alike
    (a gain, a clock, a filter, a crosstalk), and each of a sensor's alone, with a response of its own in place of
    all that is said of any of these channels: what differs from mode to mode in a way that no row describes (a
    mount that resonates) is bought as two or three rows that hold in every mode."""
    problem, best = explored.problem, explored.hypotheses[0]
    included = best.fitted.included
    every = len(problem.blocks.channels)
    alike = [n.effect.channels_changed for n in included if n.exact and n.effect.one_for_all]
    # one channel of a sensor is bought as a clock or a filter of all of them
    alone = [(k,) for rows in alike if len(rows) <= MOST_ALONE for k in rows]
    found = []
    for rows in dict.fromkeys((*alike, *alone)):
        numbers = tuple(k for k, n in enumerate(included)
                        if n.exact and set(rows) & set(n.effect.channels_changed))
        one = _with_own_response(explored, rows, numbers) if 0 < len(rows) < every else None
        found += [one] if one is not None else []
    return found


def channel_response_of_one(explored: Exploration, runs: Executor) -> OwnResponse | None:
    """Of all channels the one whose own response throughout the record is most probable beside the most probable
    hypothesis, and more so than that alone; None where none is. Of those that promise most to first order, FITTED."""
    problem, fitted = explored.problem, explored.hypotheses[0].fitted
    factors = [mode_factor_effects(problem, (k,)) for k in range(len(problem.blocks.channels))]
    constant = next(one for one in problem.time_profiles if one.kind == "constant")
    effects = [effect for own in factors for effect in own]
    wider = problem_with_effects(problem, effects, [[constant]] * len(effects))
    asked = {"which": wider.which[len(problem.which):]}
    design = replace(design_with_more(wider, fitted, len(problem.effects)), **asked)
    gain, _ = gains(replace(wider, **asked), design.scores(fitted.centred), design.information)
    promise = np.maximum(gain, 0.0).reshape(len(factors), -1).sum(axis=1)
    tasks = [((int(k),), ()) for k in np.argsort(-promise, kind="stable")[:FITTED]]
    found = [one for one in runs.in_order(_with_own_response, tasks, shared=(explored,)) if one is not None]
    weight = np.array([one.log_evidence + one.log_prior for one in found])
    if not len(weight) or weight.max() <= 0:
        return None
    best = int(np.argmax(weight))
    return replace(found[best], probability=float(np.exp(weight[best] - logsumexp(weight))))


def _with_own_response(explored: Exploration, rows: tuple[int, ...], numbers: tuple[int, ...]) -> OwnResponse | None:
    """Throughout where it is in place of no effect. None where the model has no modes there."""
    best, first = explored.hypotheses[0], len(explored.problem.effects)
    effects = mode_factor_effects(explored.problem, rows)
    profiles = explored.problem.time_profiles
    profile = (best.fitted.included[_strongest_effect(best, numbers)].time_profile if numbers else
               next(one for one in profiles if one.kind == "constant"))
    problem = problem_with_effects(explored.problem, effects, [[profile]] * len(effects))
    base = replace(best.fitted, design=design_with_more(problem, best.fitted, first))
    kept = [k for k in range(len(best.candidates)) if k not in numbers]
    gain = sum(n.size for n in (best.fitted.included[k] for k in numbers)
               if isinstance(n.effect.observe, Gain) and n.effect.channels_changed == rows)
    begun = (*(best.fitted.included[k] for k in kept),
             *(IncludedEffect(effect=effect, time_profile=profile, size=gain if k % 2 == 0 else 0.0)
               for k, effect in enumerate(effects)))
    try:
        fitted = fitted_without_candidates(problem, base.theta, begun, base=base)
    except ConvergenceError:
        return None
    rest, n_known = tuple(best.candidates[k] for k in kept), len(explored.problem.which)
    candidates = (*rest, *range(n_known, n_known + len(effects)))
    one = hypothesis_of(problem, candidates, (*(best.z[k] for k in kept), *(0.0 for _ in effects)), fitted)
    # they are one thing that may be, of as many as there are channels
    single = replace(problem, effects=problem.effects[: first + 1], which=problem.which[: n_known + 1])
    one = replace(one, log_prior=log_prior(single, (*rest, n_known)))
    prior = one.log_prior - best.log_prior
    row = replace(effects[0], location=", ".join(problem.blocks.channels[k] for k in rows))
    return OwnResponse(row=row, numbers=numbers, problem=problem, fitted=fitted, log_prior=prior,
                       log_evidence=_relative(problem, one, best) - prior)


def _relative(problem: DiagnosisProblem, one: Hypothesis, best: Hypothesis) -> float:
    """ln posterior of a hypothesis relative to another one."""
    known = {key_of(problem, h.candidates): h for h in (best, one)}
    relative = dict(zip(*Ranking().order(problem, known), strict=True))
    return relative[key_of(problem, one.candidates)] - relative[key_of(problem, best.candidates)]


def mode_factor_effects(problem: DiagnosisProblem, rows: tuple[int, ...]) -> list[Effect]:
    """Of every group of modes, the lowest first and those that are close as one, what these channels show in phase and
    a quarter of a period ahead at its mean frequency; two modes of a pair differ as the line to the next group says."""
    hz = np.exp([own.mean() for own in problem.predictor.log_frequency])
    close = close_clusters(hz)
    at = tuple(float(hz[list(cluster)].mean()) for cluster in close)
    names = [" and ".join(problem.blocks.group_name(int(q)) for q in cluster) for cluster in close]
    return [Effect(kind="measurement", cause=OWN_RESPONSE, location=name, unit="-",
                   tolerance=0.0, prior_scale=RESPONSE_SCALE, lower=-GAIN_RANGE[1], upper=GAIN_RANGE[1],
                   observe=FrequencyResponse(rows, at, k, along), step_of_size=1e-3,
                   odds=1 / len(problem.blocks.channels), check="look at its mount, its cable and its filter")
            for k, name in enumerate(names) for along in (1.0, 1.0j)]
