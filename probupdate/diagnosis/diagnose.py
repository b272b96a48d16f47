"""The diagnosis of a record: fit what is normal, test every effect, name what is beyond it, say what is not seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from probupdate.diagnosis.adequacy import adequacy, span_left
from probupdate.diagnosis.crosstalk import beside_crosstalk
from probupdate.diagnosis.evidence import Rival, log_evidence, ranked, rival_of, sizes_std
from probupdate.diagnosis.fitting import FINGERPRINT, Fit, design_at, fit
from probupdate.diagnosis.gross import Tried, tried_together, tried_whole
from probupdate.diagnosis.prepare import Prepared
from probupdate.diagnosis.results import Alternative, Diagnosis, Finding, Limit
from probupdate.diagnosis.search import Search, chance, search, taken
from probupdate.diagnosis.setting import Named, Setting, local_std, prior_shift, settle
from probupdate.diagnosis.step_time import sharpened, sharpened_again
from probupdate.errors import ConvergenceError
from probupdate.modes import ModalData
from probupdate.progress import Progress, silent

# effects that are named together; rounds of taking one in for each, as the next may show that it was none
MOST_EFFECTS, ROUNDS = 3, 2
# a limit is the size found in so many of a hundred records: normal quantile of 0.9
POWER = 1.2815515655446004
# candidates whose z correlates by more with the best one's may be meant instead, and are refitted; at most so many
ALIKE, MOST_RIVALS = 0.7, 8
# unless their scores are below this share of the best and so much log evidence behind
NEAR, BEHIND = 0.85, 12.0
# a cause is named from this probability among its rivals; a remainder as unlikely as this is not explained
SURE, ADEQUATE = 0.95, 0.01
# scores from which a rival's own noise is told
GROSS = 20.0
# of what is gross, candidates that explain less than this share of what the best one does are not refitted
GROSS_SHARE = 0.5
# directions among which the error of a fingerprint is shared out
DIRECTIONS = 4
# deviations from zero at which something within its tolerance is said; within which nothing is left of a size
TOLD, LEFT = 3.0, 2.0
# standard deviations of its prior by which a parameter may be pushed in a fit that explains the record; largest
# threshold of |z| that a catalogue can need (of ten million independent candidates it is 5.9)
FARTHEST, SENSIBLE = 6.0, 12.0
CHANCE = "chance alone"
NOT_SETTLED = "the fit did not settle: the residuals are too large for the model to follow"
ALIKE_SHAPES = "the measured shapes are as good as one where the model expects two, so that they carry no information"


def refit(
    setting: Setting, base: Fit, found: Search, candidate: int, tried: Tried | None = None
) -> Rival | None:
    """The model with one more effect, fitted anew; None where it has no modes or nothing is left of the effect.
    `tried`: where to begin with what is gross."""
    j, c = setting.which[candidate]
    effect, course = setting.effects[j], setting.courses[c]
    if course.kind == "step":
        course = sharpened(setting, base, j, course)
    extra = Named(effect=effect, course=course, size=effect.discrete[0] if effect.discrete else 0.0)
    if not effect.discrete:
        extra = replace(extra, size=float(np.clip(found.size[candidate], *np.multiply(0.6, extra.bounds))))
    theta = base.theta
    if tried is not None:
        # the parameters of the fit without it were bent to follow it
        extra, theta = replace(extra, size=tried.size), np.array(setting.field.parameters.initial)
    try:
        # what is grossly wrong makes the noise of the fit without it wrong too
        known = base if found.statistic.max() < GROSS else None
        fitted = fit(setting, theta, (*base.named, extra), base=known)
    except ConvergenceError:
        return None
    return rival_of(setting, candidate, fitted)


def beside_the_last(
    setting: Setting, fitted: Fit, searches: Sequence[Search], rivals: Sequence[Sequence[Rival]],
    findings: Sequence[Finding],
) -> tuple[Fit, list[Sequence[Rival]], list[Finding]]:  # fmt: skip
    """Every earlier finding's rivals once more, now that the last effect is known too; one that is then more probable
    takes its place. So the evidence is that of pairs, not of the first choice alone."""
    rivals, findings = list(rivals), list(findings)
    for i, (found, own) in enumerate(zip(searches[:-1], rivals[:-1], strict=True)):
        others = (*fitted.named[:i], *fitted.named[i + 1 :])
        apart = [r for r in own if all(r.fitted.named[-1].effect is not n.effect for n in others)]
        if len(apart) < 2:
            continue
        tried = []
        for r in apart:
            # what was chosen, as it is by now
            extra = fitted.named[i] if r is own[0] else r.fitted.named[-1]
            try:
                again = fit(setting, fitted.theta, (*others, extra), base=fitted)
            except ConvergenceError:
                continue
            tried.append(rival_of(setting, r.candidate, again))
        kept = ranked(setting, tried)
        if not kept:
            continue
        if kept[0].candidate != own[0].candidate:
            named = (*others[:i], kept[0].fitted.named[-1], *others[i:])
            try:
                fitted = fit(setting, kept[0].fitted.theta, named)
            except ConvergenceError:
                continue
        rivals[i], findings[i] = kept, finding(setting, found, kept)
    return fitted, rivals, findings


def still_there(setting: Setting, fitted: Fit) -> list[int]:
    """Numbers of the named effects of which something is left: what was bent into a cause that is known by now is zero
    beside it, or of one size only and the record is more probable without it. The last one was only just found."""
    there = sorted({*_told_from_zero(setting, fitted), len(fitted.named) - 1})
    for i in [i for i in there[:-1] if fitted.named[i].effect.discrete]:
        rest = [k for k in there if k != i]
        try:
            without = fit(setting, fitted.theta, [fitted.named[k] for k in rest])
        except ConvergenceError:
            continue
        if without.settled and log_evidence(setting, without) > log_evidence(setting, fitted):
            there = rest
    return there


def _told_from_zero(setting: Setting, fitted: Fit) -> list[int]:
    return [i for i, (n, std) in enumerate(zip(fitted.named, sizes_std(setting, fitted), strict=True))
            if n.effect.discrete or abs(n.size) > LEFT * std]  # fmt: skip


def undecided(z: float) -> float:
    """What log evidence between rivals is divided by: the error of a fingerprint of z deviations lies along a few
    directions, and between two rivals is one of them."""
    return 1 + (FINGERPRINT * z) ** 2 / DIRECTIONS


def rivals_of(setting: Setting, fitted: Fit, found: Search, best: int) -> list[int]:
    """The candidates that might be meant instead of the best: alike after what is normal has taken its part, the best
    course of each effect, the highest scores first."""
    order = np.argsort(-found.statistic, kind="stable")
    _, first = np.unique(setting.which[order, 0], return_index=True)
    order = order[np.sort(first)]
    z, strongest = found.statistic[order], found.statistic[best]
    behind = 0.5 * (strongest**2 - z**2) / undecided(strongest)
    # a strong effect is not linear: scores that are not far apart may change places
    order = order[(z > NEAR * strongest) | (behind < BEHIND)]
    order = order[found.statistic[order] > 0.5 * strongest]
    likeness = np.abs(fitted.design.likeness(order)[list(order).index(best)])
    # what is grossly wrong is nowhere near linear: its score alone counts, not how alike small ones would be
    high = (strongest > GROSS) & (found.statistic[order] > NEAR * strongest)
    return [int(k) for k, r, h in zip(order, likeness, high, strict=True) if k == best or r > ALIKE or h][:MOST_RIVALS]


def meant(
    setting: Setting, fitted: Fit, found: Search, best: int, n_searched: int
) -> tuple[list[tuple[int, Tried | None]], bool]:
    """The candidates to refit; of what is gross, one of the first `n_searched`, with where its fit begins: of those
    offered beside them a share of another channel as large as the channel's own bends into anything. Whether they
    stand in the order in which they explain the record beside another one that is not found yet."""
    if found.statistic[best] < GROSS:
        return [(k, None) for k in rivals_of(setting, fitted, found, best)], False
    free = ~taken(setting, fitted.named) & (np.arange(len(setting.which)) < n_searched)
    try:
        tried = tried_whole(setting, fitted.named, free)
    except ConvergenceError:
        # where the prior expects the parameters the model has no modes that pair with the measured ones
        return [(k, None) for k in rivals_of(setting, fitted, found, best)], False
    together = tried_together(setting, fitted.named, free, tried) if tried[0].whole else []
    tried = together or tried
    least = GROSS_SHARE * max(tried[0].gain, 0.0)
    result = [(t.candidate, t) for t in tried if t.whole and t.gain > least][:MOST_RIVALS]
    if not together and (not result or any(t.gain > least for t in tried if not t.whole)):
        known = [k for k, _ in result]
        result += [(k, None) for k in rivals_of(setting, fitted, found, best) if k not in known]
    return result, bool(together)


@dataclass(frozen=True, eq=False, kw_only=True)
class Outcome:
    """The diagnosis with what it was read from: the fit of the model as it is (`null`), the fit with everything found
    (`fitted`, its `named` in the order of the findings), and the first and the last search."""

    diagnosis: Diagnosis
    setting: Setting
    null: Fit
    fitted: Fit
    first: Search
    last: Search


def diagnose(prepared: Prepared, data: ModalData, *, seed: int = 1, progress: Progress = silent) -> Diagnosis:
    """Find what the model gets wrong in these blocks."""
    return examine(prepared, data, seed=seed, progress=progress).diagnosis


def examine(
    prepared: Prepared, data: ModalData, *, most: int = MOST_EFFECTS, seed: int = 1, progress: Progress = silent
) -> Outcome:
    """`diagnose` with all that its pictures, the gain and the extended model need; of at most so many effects."""
    setting, theta = settle(prepared, data)
    progress("diagnosing", 0, most + 1)
    fitted = fit(setting, theta)
    null, first = fitted, None
    findings: list[Finding] = []
    searches, rivals = [], []
    n_searched = len(setting.which)
    for number in range(ROUNDS * most + 1):
        progress("diagnosing", min(number, most), most + 1)
        found = search(setting, fitted, seed=seed, heavier=first.heavier if first else None)
        first = first or found
        best = int(np.argmax(found.statistic))
        if found.statistic[best] <= found.threshold or len(findings) == most or number == ROUNDS * most:
            break
        n_before = len(setting.which)
        setting, fitted, found = beside_crosstalk(setting, fitted, found, best, seed=seed)
        if len(setting.which) > n_before:
            null = replace(null, design=design_at(setting, null.theta, (), null.design.noise)) if findings else fitted
        kept = _refitted(setting, fitted, found, best, n_searched, range(n_before, len(setting.which)))
        if not kept:
            break
        findings.append(finding(setting, found, kept))
        searches.append(found)
        rivals.append(kept)
        fitted = _anew(setting, kept[0].fitted)
        fitted, rivals, findings = beside_the_last(setting, fitted, searches, rivals, findings)
        there = still_there(setting, fitted)
        if len(there) < len(findings):
            fitted = _anew(setting, replace(fitted, named=tuple(fitted.named[i] for i in there)))
            searches, rivals, findings = ([x[i] for i in there] for x in (searches, rivals, findings))
    # with all of them in place
    findings = [replace(f, size=n.size, size_std=std)
                for f, n, std in zip(findings, fitted.named, sizes_std(setting, fitted), strict=True)]  # fmt: skip
    fits, remaining = adequacy(setting, fitted, found)
    progress("diagnosing", most + 1, most + 1)
    left_over = found.statistic[best] > found.threshold
    silent, pinned = _silent(fitted), _pinned(fitted)
    # one cause may be at its end, as a brace that is gone; two at once are what something else is bent into, and so is
    # one that is told no better than zero there
    bent = len(pinned) > 1 or (pinned and len(_told_from_zero(setting, fitted)) < len(findings))
    parameters = tuple(_parameters(setting, null, fitted))
    far = _far(parameters)
    beyond = _beyond_sense(found)
    if fits < ADEQUATE or left_over or silent or bent or far or beyond or not fitted.settled:
        verdict = "unexplained"
    elif not findings:
        verdict = "none"
    else:
        verdict = "ambiguous" if any(f.posterior_probability < SURE for f in findings) else "named"
    named = () if verdict == "unexplained" else tuple(findings)
    details = {"adequacy": remaining}
    told = _told(setting, fitted)
    if verdict == "unexplained":
        # what a fit tells that does not follow the record is nothing to say
        details["nearest"], told = [f"{f.cause}, {f.location}" for f in findings], []
    diagnosis = Diagnosis(
        verdict=verdict, findings=named,
        p_value=min(1.0, 2 * min(first.p_value, fits)) if not findings else first.p_value,
        limits=_limits(setting, first, null), threshold=first.threshold, adequacy_p=fits,
        notes=(*setting.blocks.notes, *told, *pinned, *far, *beyond, *_short(fitted, [f.size_std for f in findings]),
               *([] if fitted.settled else [NOT_SETTLED]),
               *(f"modes {setting.blocks.group_name(q)}: {ALIKE_SHAPES}" for q in silent)),
        parameters=parameters, details=details,
    )  # fmt: skip
    return Outcome(diagnosis=diagnosis, setting=setting, null=null, fitted=fitted, first=first, last=found)


def _refitted(
    setting: Setting, fitted: Fit, found: Search, best: int, n_searched: int, offered: Sequence[int]
) -> list[Rival]:
    """What may be meant and what is `offered` beside it, refitted, the most probable first; where no fit leads from
    what is gross at its own size, what the scores choose, from the fit without it."""
    chosen, together = meant(setting, fitted, found, best, n_searched)
    tried = [refit(setting, fitted, found, k, whole) for k, whole in chosen]
    from_the_fit = {k for k, whole in chosen if whole is None}
    if len(from_the_fit) < len(chosen) and all(r is None for r in tried):
        rest = [k for k in rivals_of(setting, fitted, found, best) if k not in from_the_fit]
        from_the_fit |= set(rest)
        tried += [refit(setting, fitted, found, k) for k in rest]
    elif together:
        # alone none is probable: told again beside the next one
        return [r for r in tried if r is not None]
    kept = ranked(setting, tried)
    beside = [refit(setting, fitted, found, k) for k in offered if k not in from_the_fit]
    if kept and not kept[0].fitted.settled:
        # that one has settled is worth nothing where it explains less than what has not
        beside = [r for r in beside if r is not None and r.log_posterior > kept[0].log_posterior]
    return ranked(setting, [*tried, *beside])


def _silent(fitted: Fit) -> list[int]:
    """Groups of which no block tells anything at the fit."""
    return [q for q, weight in enumerate(fitted.design.noise.weight) if not weight.any()]


def _pinned(fitted: Fit) -> list[str]:
    """What to say of sizes that stand at an end of what their row allows."""
    return [
        f"the size of {n.effect.name} stands at an end of what its row allows ({n.bounds[0]:.3g} to {n.bounds[1]:.3g} "
        f"{n.effect.unit}{n.course.unit}): its interval is not to be trusted, a larger size may be meant"
        for n in fitted.named if not n.effect.discrete and np.isclose(n.size, n.bounds, rtol=1e-3).any()
    ]


def _far(parameters: Sequence[dict]) -> list[str]:
    """What to say of parameters that only a fit bent into something else would need."""
    return [f"{p['name']} would be {p['value_after']:.3g} {p['unit']}, {abs(p['pushed_after']):.1f} standard deviations "
            "of its prior away: nothing that follows from it is explained"
            for p in parameters if abs(p["pushed_after"]) > FARTHEST]  # fmt: skip


def _beyond_sense(found: Search) -> list[str]:
    """What to say where scores that are standard normal by construction need a threshold that no such numbers reach."""
    if found.threshold <= SENSIBLE:
        return []
    return [f"the threshold |z| = {found.threshold:.0f} is beyond what {len(found.z)} candidates can need: what is not "
            "known of the model moves these modes by more than the linear equations hold for, so that the record tells "
            "nothing either way; give the parameters a narrower prior, or leave out modes that nearly meet"]


def _told(setting: Setting, fitted: Fit) -> list[str]:
    """What is within its tolerance, so no finding, and yet surely there: structural rows of more than half their
    tolerance, TOLD of their own deviations from zero."""
    chosen = [k for k, j in enumerate(setting.tolerated) if setting.effects[j].kind == "structural"]
    rows = len(setting.updated) + np.array(chosen, int)
    size = fitted.design.unknowns(fitted.centred)[rows]
    std = np.sqrt(np.diag(fitted.design.unknowns_cov(rows)))
    result = []
    for k, value, own in zip(chosen, size, std, strict=True):
        effect = setting.effects[setting.tolerated[k]]
        if abs(value) > max(TOLD * own, 0.5 * effect.tolerance):
            result.append(f"{effect.name}: {value:.3g} +- {own:.2g} {effect.unit}, within what is normal (tolerance "
                          f"{effect.tolerance:.2g}) and so no finding, but the record tells it; {effect.check}")
    return result


def _short(fitted: Fit, sizes_std: Sequence[float]) -> list[str]:
    """Sizes that the fit left short of where its equations point, by a deviation that counts."""
    return [f"{n.effect.name}: the fit of its size leads no farther down, though its equations would by {short:.2g} "
            f"{n.effect.unit}; the interval counts it"
            for n, short, std in zip(fitted.named, fitted.short, sizes_std, strict=True)
            if short > 0.5 * std > 0]  # fmt: skip


def _anew(setting: Setting, chosen: Fit) -> Fit:
    """The same with its own noise, as what a strong effect does to the shapes changes how they scatter, and with the
    times of its steps told anew; where the model then has no modes, the fit as it was, marked as not settled."""
    try:
        fitted = fit(setting, chosen.theta, chosen.named)
        named = sharpened_again(setting, fitted)
        same = all(np.array_equal(a.course.value, b.course.value) for a, b in zip(named, fitted.named, strict=True))
        return fitted if same else fit(setting, fitted.theta, named)
    except ConvergenceError:
        return replace(chosen, last_step=np.inf)


def finding(setting: Setting, found: Search, rivals: list[Rival]) -> Finding:
    """The most probable of the rivals; those that are not excluded stand beside it."""
    best = rivals[0]
    j, c = setting.which[best.candidate]
    effect, course = setting.effects[j], best.fitted.named[-1].course
    # evidence counts by what the best fit leaves, as in quasi-likelihood, and by what theory does not know of so
    # strong a fingerprint
    left, directions = span_left(setting, best.fitted, c)
    dispersion = max(left / directions, undecided(found.z[best.candidate]))
    evidence, odds = np.array([r.log_evidence for r in rivals]), np.array([r.log_odds for r in rivals])
    told = (evidence - evidence.max()) / dispersion
    # nothing but chance is a rival too
    none = chance(found.p_value)
    probability = (1 - none) * special.softmax(told + odds)
    alternatives = tuple(
        Alternative(cause=other.cause, location=other.location, posterior_probability=float(p))
        for r, p in zip(rivals[1:], probability[1:], strict=True)
        for other in [setting.effects[setting.which[r.candidate, 0]]] if p > 1e-3
    )  # fmt: skip
    if none > 1e-3:
        alternatives = (*alternatives, Alternative(cause=CHANCE, location="", posterior_probability=none))
    start = setting.blocks.ids[course.at] if course.kind == "step" else ""
    return Finding(
        kind=effect.kind, cause=effect.cause, location=effect.location, size=best.size, size_std=best.size_std,
        unit=effect.unit + course.unit, course=course.name, course_start=start, z=float(found.z[best.candidate]),
        posterior_probability=float(probability[0]), prior_probability=float(special.softmax(odds)[0]),
        alternatives=alternatives, check=effect.check,
    )  # fmt: skip


def _limits(setting: Setting, found: Search, fitted: Fit) -> tuple[Limit, ...]:
    best: dict[tuple[int, str], int] = {}
    for k, (j, c) in enumerate(found.which):
        key = (int(j), setting.courses[c].name)
        if key not in best or found.size_std[k] < found.size_std[best[key]]:
            best[key] = k
    limits = []
    left = fitted.design.share_left
    for (j, name), k in best.items():
        effect = setting.effects[j]
        size = (found.threshold + POWER) * found.size_std[k]
        here = Named(effect=effect, course=setting.courses[setting.which[k, 1]], size=0.0)
        reachable = size <= max(-here.bounds[0], here.bounds[1])
        limits.append(Limit(kind=effect.kind, cause=effect.cause, location=effect.location, course=name,
                            limit=float(size) if reachable else np.inf,
                            unit=effect.unit + setting.courses[setting.which[k, 1]].unit, share_left=float(left[k]),
                            z=float(found.z[k])))  # fmt: skip
    return tuple(limits)


def _parameters(setting: Setting, null: Fit, fitted: Fit):
    """Every updated parameter before and after effects were taken in, and how far from its prior it was pushed."""
    rows = range(len(setting.updated))
    std = [np.sqrt(np.diag(f.design.unknowns_cov(rows))) for f in (null, fitted)]
    for i, k in enumerate(setting.updated):
        p = setting.prior.items[i]
        pushed = [float(-prior_shift(setting, f.theta)[i] / local_std(setting.prior, i, f.theta[k]))
                  for f in (null, fitted)]  # fmt: skip
        yield {"name": p.name, "unit": p.unit, "prior": p.initial, "prior_std": p.std, "value": float(null.theta[k]),
               "std": float(std[0][i]), "pushed": pushed[0], "value_after": float(fitted.theta[k]),
               "std_after": float(std[1][i]), "pushed_after": pushed[1]}  # fmt: skip
