"""Effects of sensors that step along the record, without a model: which one, since when, how large, and how probable
beside a change of the structure and beside chance.

What was measured is put right for an effect of a size, and compared as if the sensor had been sound (with the volume
that this gives the numbers); the structure's change is compared on the same numbers of the same blocks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy import linalg

from probupdate.diagnosis.blocks import Blocks
from probupdate.diagnosis.empirical_reference import correct_blocks, look, residuals, signatures
from probupdate.diagnosis.empirical_search import ReferencedBlocks, log_prior_of_effects, watch
from probupdate.diagnosis.engine.library import sizes
from probupdate.diagnosis.engine.verdict import CHANCE, EffectSet, findings_of
from probupdate.diagnosis.evidence import log_weight_of_size, size_at_bound, size_by_secant
from probupdate.diagnosis.results import Finding
from probupdate.diagnosis.time_profiles import EDGE, TimeProfile, blocks_between_steps, step_profile
from probupdate.effects.catalogue import Effect
from probupdate.modal.modes import Sensor

# effects of sensors at one time, and candidates that are put right for each
MOST_AT_ONCE, MOST_TRIED = 3, 6
# sizes in prior scales from which large faults start; where a size of its own is possible only, that one
STARTS = (0.3, 1.0, 3.0, 9.0)
# odds that shapes change as by effects of sensors where the structure does, which frequencies show
LOOKS_ALIKE = 0.05
# what competes with effects of sensors
STRUCTURE = "unexplained change of frequencies and shapes"


@dataclass(frozen=True, eq=False, kw_only=True)
class Change:
    """One thing that changes along the record: its finding (None: no cause is known without a model), the time profile,
    and the numbers of the frequencies that went with it. What stays within a sensor's tolerance is no finding."""

    finding: Finding | None
    time_profile: TimeProfile
    moved: tuple[dict, ...]
    within_tolerance: bool = False


@dataclass(frozen=True, eq=False, kw_only=True)
class PutRight(EffectSet):
    """Blocks without effects of sensors from one block on, ln prior of their sizes and odds."""

    blocks: Blocks
    log_prior: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Case:
    """What stays the same while effects of sensors are compared along one step: the blocks as measured, what is known
    of them, the rows of the catalogue, ln of how probable a change along this step is before, beside none."""

    blocks: Blocks
    known: np.ndarray
    sensors: Sequence[Sensor]
    catalogue: tuple[Effect, ...]
    profile: TimeProfile
    log_prior: float

    def with_reference(self, blocks: Blocks, effects: Sequence[Effect] = ()) -> ReferencedBlocks:
        """Blocks beside what was before the step."""
        return watch(blocks, effects, self.sensors, self.known, [self.profile], self.profile.value)

    def rest(self, blocks: Blocks) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
        """Residuals per group beside what was before the step, and the blocks used."""
        empirical = look(blocks, self.sensors, self.profile.value)
        return residuals(empirical, self.known), empirical.used


def changes_of_sensors(
    blocks: Blocks, known: np.ndarray, sensors: Sequence[Sensor], catalogue: Sequence[Effect], profile: TimeProfile,
    log_prior: float,
) -> tuple[list[Change], Blocks] | None:
    """Effects of sensors along a step with the blocks put right for them; None where chance or the structure is more
    probable."""
    case = Case(blocks=blocks, known=known, sensors=sensors, catalogue=tuple(catalogue), profile=profile,
                log_prior=log_prior)
    tried: dict[frozenset, PutRight] = {}
    nothing = PutRight(effects=(), size=(), size_std=(), blocks=blocks, log_prior=0.0)
    best = nothing
    judged: SetOdds | None = None
    for number in range(MOST_AT_ONCE):
        more = _add_one_effect(case, best)
        if not number and more:
            judged = _judge_hypotheses(case, more)
            sharper = _refine_step(case, max(more, key=lambda one: judged.of[one.keys]))
            if sharper.at != case.profile.at:
                case, judged = replace(case, profile=sharper), None
                more = _add_one_effect(case, best)
        if not more:
            break
        tried |= {one.keys: one for one in more}
        if number or judged is None:
            judged = _judge_hypotheses(case, list(tried.values()))
        first = max(judged.of, key=lambda key: judged.of[key])
        best = tried[first]
        if len(first) <= number or judged.left[first] < 0:
            break
    if judged is None:
        return None
    return _answer(case, tried, judged)


def _add_one_effect(case: Case, begun: PutRight) -> list[PutRight]:
    """The effects that first order or their own large size promise most beside those begun with, each put right at the
    size that leaves nothing of it."""
    seen = case.with_reference(begun.blocks, case.catalogue)
    size, std = sizes(seen.along, seen.signature)
    gain = np.where(np.isfinite(std[:, 0]), np.abs(size[:, 0] / std[:, 0]), 0.0)
    gain = np.where([bool(e.discrete) or e in begun.effects for e in case.catalogue], 0.0, gain)
    starts = {int(k): 0.0 for k in np.argsort(-gain)[: MOST_TRIED // 2] if gain[k] > 0}
    for k, start in _fit_large_sizes(begun.blocks, case.catalogue, case.profile.at)[:MOST_TRIED]:
        if case.catalogue[k] not in begun.effects:
            starts[k] = start
    tried = [_correct_effect(case, begun, seen, case.catalogue[k], start) for k, start in starts.items()]
    # what makes some blocks unlike all others, so that they are compared no longer, has not explained them
    there = sum(np.sum(q) for q in seen.empirical.used)
    return [one for one in tried if one is not None and sum(np.sum(q) for q in case.rest(one.blocks)[1]) >= there]


def _correct_effect(
    case: Case, begun: PutRight, seen: ReferencedBlocks, effect: Effect, start: float
) -> PutRight | None:
    """None where the size ends at a bound: what was measured asks for something else."""
    value = case.profile.value

    def remaining_size(size: float) -> tuple[float, float]:
        now = correct_blocks(begun.blocks, effect, size * value)
        empirical = look(now, case.sensors, value)
        then = seen.with_residuals(residuals(empirical, case.known), empirical.used)
        found, std = sizes(then.along, then.directions.turn @ signatures([effect], empirical))
        return float(found[0, 0]), float(std[0, 0])

    size, std = (effect.discrete[0], 0.0) if effect.discrete else size_by_secant(effect, remaining_size, start)
    if not np.isfinite(std) or size_at_bound(effect, size):
        return None
    odds = log_prior_of_effects(case.catalogue, "step")[case.catalogue.index(effect)]
    return PutRight(effects=(*begun.effects, effect), size=(*begun.size, size), size_std=(*begun.size_std, std),
                    blocks=correct_blocks(begun.blocks, effect, size * value),
                    log_prior=begun.log_prior + odds + log_weight_of_size(effect, size, std))


def _fit_large_sizes(blocks: Blocks, effects: Sequence[Effect], at: int) -> list[tuple[int, float]]:
    """Of effects that may be large, as many as are asked for, and the sizes at which the planes of the modes before a
    block, seen through them, come nearest to those from it on; nearest first."""
    planes, identity = [], np.eye(len(blocks.channels), dtype=complex)
    for q, group in enumerate(blocks.groups):
        there = np.flatnonzero(blocks.present[:, q])
        if np.any(there < at) and np.any(there >= at):
            members = list(group)
            basis = np.linalg.qr(blocks.shape[there][:, :, members])[0]
            projector = np.einsum("nck,ndk->ncd", basis, basis.conj())
            before = projector[there < at].mean(axis=0)
            frame = np.linalg.eigh(before)[1][:, -len(members):]
            frequency = float(np.nanmedian(blocks.frequency_hz[:, members]))
            planes.append((frame, projector[there >= at].mean(axis=0), frequency))
    result = []
    for k, effect in enumerate(effects):
        scale = [s * f * effect.prior_scale for f in STARTS for s in effect.signs]
        for size in effect.discrete or [x for x in scale if effect.lower <= x <= effect.upper]:
            apart = 0.0
            for frame, after, frequency in planes:
                seen = np.linalg.qr(effect.observation(identity, frequency, size)[0] @ frame)[0]
                apart += seen.shape[1] - float(np.einsum("ck,cd,dk->", seen.conj(), after, seen).real)
            result.append((apart, k, size))
    nearest: dict[int, float] = {}
    for _, k, size in sorted(result):
        nearest.setdefault(k, size)
    return list(nearest.items())


@dataclass(frozen=True, eq=False, kw_only=True)
class SetOdds:
    """ln posterior odds over nothing: `of` each set of sensors' effects by its keys, and of what `left` by them a
    change of the structure would explain; of the `structure` alone."""

    of: Mapping[frozenset, float]
    left: Mapping[frozenset, float]
    structure: float


def _judge_hypotheses(case: Case, hypotheses: Sequence[PutRight]) -> SetOdds:
    """All on the same numbers: in the directions in which the record scatters once the one is put right that leaves
    nothing, or that is the most probable of those that do."""
    first = _judge_numbers(case, case.with_reference(hypotheses[0].blocks), hypotheses)
    best = max(hypotheses, key=lambda one: (first.left[one.keys] < 0, first.of[one.keys]))
    return first if best is hypotheses[0] else _judge_numbers(case, case.with_reference(best.blocks), hypotheses)


def _judge_numbers(case: Case, seen: ReferencedBlocks, hypotheses: Sequence[PutRight]) -> SetOdds:
    measured, used = case.rest(case.blocks)
    rests = [case.rest(one.blocks) for one in hypotheses]
    used = [np.all(q, axis=0) for q in zip(used, *(r[1] for r in rests), strict=True)]
    as_measured = seen.with_residuals(measured, used)
    # sensors and the structure are as probable before as each other; what is with effects of sensors at one time by
    # chance is as probable as a change at this time
    structure = float(as_measured.unknown().any_unknown[0])
    acting, odds, left = case.profile.value != 0, {}, {}
    for one, (rest, _) in zip(hypotheses, rests, strict=True):
        put_right = seen.with_residuals(rest, used)
        own = put_right.log_nothing - as_measured.log_nothing + one.log_prior
        # what was measured is what is asked: a gain of a half halves the scatter too
        own -= sum(_log_stretch(e, size, acting, case.blocks, used, seen.empirical.axes)
                   for e, size in zip(one.effects, one.size, strict=True))
        odds[one.keys] = own
        unknown = put_right.unknown()
        left[one.keys] = float(np.logaddexp(unknown.any_unknown[0] + case.log_prior,
                                            unknown.frequencies[0] + np.log(LOOKS_ALIKE)))
    return SetOdds(of=odds, left=left, structure=structure)


def _answer(
    case: Case, tried: Mapping[frozenset, PutRight], judged: SetOdds
) -> tuple[list[Change], Blocks] | None:
    sets, own = list(tried.values()), [judged.of[k] for k in tried]
    # what the most probable ones leave is the structure's
    first = max(tried, key=lambda key: judged.of[key])
    structure = float(np.logaddexp(judged.structure, judged.of[first] + judged.left[first]))
    found = findings_of(sets, own, [(STRUCTURE, "structure", structure), (CHANCE, "", -case.log_prior)],
                        time_profile=case.profile.name, start=case.blocks.ids[case.profile.at])
    if found is None:
        return None
    best, findings = found
    return [Change(finding=f, time_profile=case.profile, moved=(), within_tolerance=abs(f.size) <= e.tolerance)
            for f, e in zip(findings, best.effects, strict=True)], best.blocks


def _refine_step(case: Case, one: PutRight) -> TimeProfile:
    """The step from which an effect of its size leaves least, by halved steps."""
    n, seen = len(case.blocks), replace(case.with_reference(one.blocks), profiles=())
    (effect,), (size,) = one.effects, one.size

    @cache
    def log_density(at: int) -> float:
        value = step_profile(n, at).value
        empirical = look(correct_blocks(case.blocks, effect, size * value), case.sensors, case.profile.value)
        own = seen.with_residuals(residuals(empirical, case.known), empirical.used).log_nothing
        return own - _log_stretch(effect, size, value != 0, case.blocks, empirical.used, empirical.axes)

    return step_profile(n, best_time(n, case.profile.at, log_density))


def best_time(n: int, at: int, log_density: Callable[[int], float]) -> int:
    """Of n blocks the one from which a step is most probable, by halved steps from one of a coarse grid."""
    step = blocks_between_steps(n)
    while True:
        best = max((k for k in (at, at - step, at + step) if EDGE <= k <= n - EDGE), key=log_density)
        if best == at and step == 1:
            return at
        at, step = best, max(1, -(-step // 2)) if best == at else step


def _log_stretch(
    effect: Effect, size: float, acting: np.ndarray, blocks: Blocks, used: Sequence[np.ndarray],
    axes: Sequence[np.ndarray],
) -> float:
    """ln of the volume that an effect of sensors gives to all numbers of shapes that it is `acting` (n_block,) on, over
    what it was."""
    return sum(int(np.sum(ok & acting)) * log_stretch(
        effect.observation(np.eye(len(a), dtype=complex),
                           float(np.nanmedian(blocks.frequency_hz[:, list(group)])), size)[0], a)
        for group, ok, a in zip(blocks.groups, used, axes, strict=True))


def log_stretch(seen: np.ndarray, axes: np.ndarray) -> float:
    """ln of the volume that numbers Y = S (A^+ S)^-1 - A of shapes near their axes A (n_channel, k) take where sensors
    see seen (n_channel, n_channel) @ S instead, over that of S itself; real and imaginary parts."""
    n, k = axes.shape
    if n <= k:
        return 0.0
    onto = np.linalg.pinv(axes)
    in_plane, outside = onto @ seen @ axes, linalg.null_space(onto)
    moved = seen @ (outside - axes @ np.linalg.solve(in_plane, onto @ seen @ outside))
    return float(2 * (k * np.linalg.slogdet(outside.T @ moved)[1] - (n - k) * np.linalg.slogdet(in_plane)[1]))
