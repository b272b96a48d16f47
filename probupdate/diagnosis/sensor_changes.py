"""Effects of sensors that change along the record, without a model: which one, since when, how large, and how probable
beside a change of the structure and beside chance."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
from scipy import linalg
from scipy.special import logsumexp

from probupdate.diagnosis.blocks import Blocks
from probupdate.diagnosis.diagnose import CHANCE
from probupdate.diagnosis.empirical_reference import look, mended, own_noise, residuals, stated_patterns
from probupdate.diagnosis.empirical_search import (
    LEFT,
    Followed,
    Found,
    Scores,
    allowed_profiles,
    log_change_of_structure,
    log_common_change,
    log_density,
    make_contrasts,
    score,
    watch,
)
from probupdate.diagnosis.evidence import log_weight_of_size, size_at_bound, size_by_secant
from probupdate.diagnosis.results import Alternative, Finding
from probupdate.diagnosis.time_profiles import EDGE, N_STEP, TimeProfile, between_steps, step_profile
from probupdate.effects.catalogue import Effect
from probupdate.modal.modes import Sensor

# effects of sensors at one time
MOST_AT_ONCE = 3
# effects that explain nearly as much (share of the best one's) are tried, at most so many
ALIKE, MOST_TRIED = 0.8, 3
# what lies across its axis but for this is compared too where causes compete
ACROSS = 0.01
# exchanged or reversed channels that are tried at every time
MOST_WHOLE = 8
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


def _finer(blocks: Blocks, followed: Followed, known: np.ndarray, row: int, time_profile: TimeProfile) -> TimeProfile:
    """The step's block found among all, by least squares: scores do not serve, as each time profile has a noise of its
    own, which a step at a wrong place may make small."""
    if time_profile.kind != "step":
        return time_profile
    n = len(blocks)
    at = np.arange(EDGE, n - EDGE + 1)
    root = np.sqrt(followed.weight[row])
    nuisance = root[:, None] * followed.empirical.nuisance(known)
    both = root[:, None] * np.column_stack([followed.series[row], np.arange(n)[:, None] >= at])
    rest = both - nuisance @ np.linalg.lstsq(nuisance, both, rcond=None)[0]
    own = np.sum(rest[:, 1:] ** 2, axis=0)
    # what offset and turning explain nearly is no step that could be found
    usable = own > LEFT * np.sum((both - root[:, None] * (root @ both / (root @ root)))[:, 1:] ** 2, axis=0)
    taken = np.where(usable, (rest[:, 0] @ rest[:, 1:]) ** 2 / np.where(usable, own, 1.0), 0.0)
    # of times between which the series is not measured the last: the first block that shows it
    best = np.flatnonzero(taken > (1 - 1e-9) * taken.max())
    return step_profile(n, int(at[best[-1]])) if np.any(taken) else time_profile


def _apart(blocks: Blocks, sensors: Sequence[Sensor]) -> float:
    """By how much the blocks' modes differ from their own mean ones in all (sum of squares): in standard deviations one
    block at which a channel is reversed would outweigh all others."""
    return sum(float(np.sum(y**2)) for y in look(blocks, sensors, least=ACROSS).differences)


def _from_block(blocks: Blocks, effect: Effect, size: float, at: int) -> Blocks:
    """The blocks with an effect of this size taken out from one block on."""
    return mended(blocks, effect, size * step_profile(len(blocks), at).value, factors=False)


def _sharper(n: int, at: int, left: Callable[[int], float]) -> int:
    """Of n blocks the one from which `left` is least, by halved steps from one of a coarse grid."""
    left = cache(left)
    step = between_steps(n)
    while True:
        at = min((k for k in (at, at - step, at + step) if EDGE <= k <= n - EDGE), key=left)
        if step == 1:
            break
        step = -(-step // 2)
    # the last step once more, as long as it leads on
    while (best := min((k for k in (at, at - 1, at + 1) if EDGE <= k <= n - EDGE), key=left)) != at:
        at = best
    return at


def _sharper_profile(
    blocks: Blocks, known: np.ndarray, sensors: Sequence[Sensor], mended_by: _Mended
) -> TimeProfile:
    """The step from which an effect of its size leaves least of all residuals, in standard deviations, a block far off
    counting the logarithm: beside a strong effect blocks that look elsewhere stand apart, and the series alone does not
    show on which side of the step they are."""
    # as blocks scatter once the effect is out: both states together have other axes
    noise = watch(mended_by.blocks, (), sensors, known).noise

    def left(at: int) -> float:
        rest = residuals(look(_from_block(blocks, mended_by.effect, mended_by.size, at), sensors), known)
        return sum(y.shape[1] * float(np.sum(np.log1p(np.sum((y @ P) * y, axis=1) * w / y.shape[1])))
                   for y, P, w in zip(rest, noise.precision, noise.weight, strict=True))

    return step_profile(len(blocks), _sharper(len(blocks), mended_by.time_profile.at, left))


def mend(
    blocks: Blocks, followed: Followed, known: np.ndarray, sensors: Sequence[Sensor], row: int,
         time_profile: TimeProfile
) -> tuple[Blocks, float, float]:
    """The blocks without the effect of series `row` that goes with the time profile, its size and standard deviation:
    the size is right when nothing of it is left beside what was before."""
    effect = followed.effects[row - followed.n_frequency]
    nuisance = followed.empirical.nuisance(known)

    def left(size: float) -> tuple[float, float]:
        seen = watch(mended(blocks, effect, size * time_profile.value), (effect,), sensors, known,
                     time_profile=time_profile.value)
        own = [seen.n_frequency]
        contrasts = make_contrasts(seen.weight[own], nuisance, [time_profile], blocks.hours)
        scores = score(contrasts, seen.series[own], [[0]])
        return float(scores.size[0, 0]), float(scores.size_std[0, 0])

    size, std = size_by_secant(effect, left)
    return mended(blocks, effect, size * time_profile.value), size, std


def left_at(
    blocks: Blocks, followed: Followed, known: np.ndarray, sensors: Sequence[Sensor], time_profile: TimeProfile,
            found: Found
) -> tuple[float, float]:
    """The largest score over its threshold that blocks still have along one time profile: of frequencies, of
    sensors."""
    seen = watch(blocks, followed.effects, sensors, known)
    nuisance = seen.empirical.nuisance(known)
    scores = score(make_contrasts(seen.weight, nuisance, [time_profile], blocks.hours), seen.series, seen.pools)
    over = np.abs(scores.z[:, 0]) / found.threshold
    return float(np.max(over[: seen.n_frequency])), float(np.max(over[seen.n_frequency :], initial=0.0))


@dataclass(frozen=True, eq=False, kw_only=True)
class _Mended:
    """An effect of sensors taken out along a time profile: its size and standard deviation, the largest score that is
    left there over its threshold, the blocks without it."""

    effect: Effect
    time_profile: TimeProfile
    size: float
    size_std: float
    left: float
    blocks: Blocks


def _sensor(
    blocks: Blocks,
    followed: Followed,
    found: Found,
    time_profiles: Sequence[TimeProfile],
    known: np.ndarray,
    sensors: Sequence[Sensor],
    whole: Sequence[Effect],
    *,
    whole_alone: bool,
) -> tuple[list[Change], Blocks] | None:
    """Effects of sensors that leave nothing along their time profile; None where they do not explain it. `whole`:
    effects that are there or not, the only ones asked first if `whole_alone`."""
    time_profile = _step_of_sensors(blocks, followed, found, time_profiles, known)
    if time_profile is None:
        return None
    changes, now = [], blocks
    for number in range(MOST_AT_ONCE):
        seen, fit, scores = _explained(now, followed, known, sensors, time_profile, found)
        if not number:
            # by what was before the step, its time is estimated better
            finer = _finer(now, seen, known, int(np.argmax(fit)), time_profile)
            if finer.at != time_profile.at:
                time_profile = finer
                seen, fit, scores = _explained(now, followed, known, sensors, time_profile, found)
        tried = []
        if number or not whole_alone:
            tried = _mended_one_by_one(now, followed, known, sensors, time_profile, found, seen, fit)
        if tried and not number:
            sharper = _sharper_profile(now, known, sensors, tried[0][1])
            if sharper.at != time_profile.at:
                time_profile = sharper
                seen, fit, scores = _explained(now, followed, known, sensors, time_profile, found)
                tried = _mended_one_by_one(now, followed, known, sensors, time_profile, found, seen, fit)
        row, best = tried[0] if tried else (int(np.argmax(fit)), None)
        probability = {row: 1.0}
        if best is not None:
            probability = _probability_of_series(seen, fit, scores, row, [k for k, _ in tried[1:]])
        if best is None or best.left > 1:
            other = _as_a_whole(now, followed, known, sensors, time_profile, found, whole, once=not number)
            if other is not None and (best is None or other.left < best.left):
                best, time_profile, probability = other, other.time_profile, {row: 1.0}
        if best is None:
            return None
        changes.append(_change_of_sensor(blocks, seen, best, row, float(scores.z[row, 0]), probability))
        now = best.blocks
        if best.left <= 1:
            return changes, now
    return None


def changes_of_sensors(
    blocks: Blocks, followed: Followed, found: Found, time_profiles: Sequence[TimeProfile], known: np.ndarray,
    sensors: Sequence[Sensor], rows: Sequence[Effect], whole: Sequence[Effect],
) -> tuple[list[Change], Blocks] | None:
    """Effects of sensors as `_sensor`, with the structure and chance among their alternatives; none where chance is
    more probable, None where the structure is. A channel reversed half of the time makes series of which a small gain
    explains enough."""
    tried = []
    for whole_alone in (False, True):
        of_sensors = _sensor(blocks, followed, found, time_profiles, known, sensors, whole, whole_alone=whole_alone)
        if of_sensors is not None:
            tried.append(_beside_the_structure(blocks, of_sensors, (*rows, *whole), sensors, followed, time_profiles,
                                               known))
    return max(tried, key=lambda one: one[0])[1] if tried else None


def _beside_the_structure(
    blocks: Blocks, of_sensors: tuple[list[Change], Blocks], catalogue: Sequence[Effect], sensors: Sequence[Sensor],
    followed: Followed, time_profiles: Sequence[TimeProfile], known: np.ndarray,
) -> tuple[float, tuple[list[Change], Blocks] | None]:
    """Their ln posterior probability over that of no change, and the same with what the structure and chance leave of
    it: three small effects of sensors mend much of what a change of the structure does. None where that change is the
    more probable, nothing where chance is."""
    changes, now = of_sensors
    # on the axes of what was before all of them, which are the same with and without them: a mean of both states has
    # another largest component, and what is left of thousands of standard deviations another length. All blocks: what
    # makes some unlike all others, so that they are compared no longer, has not explained them
    begun = np.max([c.time_profile.value for c in changes], axis=0)
    empirical, as_measured = look(now, sensors, begun, least=ACROSS), look(blocks, sensors, begun, least=ACROSS)
    rest, before = residuals(empirical, known), residuals(as_measured, known)
    noise = own_noise(now, empirical, rest, stated_patterns(now, empirical))
    nuisance = empirical.nuisance(known)
    of_key = {e.key: e for e in catalogue}
    # by itself in each mode, or in all alike, which is as probable
    sizes = [len(g) for g in blocks.groups]
    structure = np.logaddexp(log_change_of_structure(before, noise, nuisance, time_profiles, sizes),
                             log_common_change(before, noise, nuisance, time_profiles, sizes)) - np.log(2)
    total = sum(e.prior_odds("step") for e in catalogue)
    n_step = max(sum(c.kind == "step" for c in time_profiles), 1)
    own = log_density(rest, noise) - log_density(before, noise) - np.log(n_step)
    for f, acting in [(c.finding, c.time_profile.value != 0) for c in changes if c.finding is not None]:
        effect = of_key[f.key]
        own += np.log(effect.prior_odds("step") / total) + log_weight_of_size(effect, f.size, f.size_std)
        # what was measured is what is asked: a gain of a half halves the scatter too
        own -= _log_stretch(effect, f.size, acting, blocks, as_measured.used, empirical.axes)
    # sensors and the structure are as probable before as each other, no change as both, and both at one of the times
    # by chance: what sensors leave is more than theirs
    both = log_change_of_structure(rest, noise, nuisance, [changes[0].time_profile], sizes) - np.log(3 * n_step)
    structure = np.logaddexp(structure, own + both)
    each = np.array([own, structure, np.log(2)])
    share, of_structure, chance = map(float, np.exp(each - logsumexp(each)))
    if share < max(of_structure, chance):
        return own, None if of_structure > chance else ([], blocks)
    others = [Alternative(cause=cause, location=place, posterior_probability=probability) for cause, place, probability
              in ((STRUCTURE, "structure", of_structure), (CHANCE, "", chance)) if probability > 1e-3]
    return own, ([c if c.finding is None else replace(c, finding=_less_probable(c.finding, share, others))
                  for c in changes], now)


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


def _less_probable(finding: Finding, share: float, others: Sequence[Alternative]) -> Finding:
    """With alternatives to all that it was compared with, which leave it so large a share."""
    known = [replace(a, posterior_probability=share * a.posterior_probability) for a in finding.alternatives]
    return replace(finding, posterior_probability=share * finding.posterior_probability,
                   alternatives=(*known, *others))


def _step_of_sensors(
    blocks: Blocks, followed: Followed, found: Found, time_profiles: Sequence[TimeProfile], known: np.ndarray
) -> TimeProfile | None:
    """The time profile along which effects of sensors are looked for: the step of the largest score, or where that is
    one of frequencies, of the largest of sensors along it; None where there is none."""
    row, best = map(int, np.unravel_index(int(np.argmax(found.over)), found.over.shape))
    if row < followed.n_frequency:
        rows = followed.classes[1]
        if not rows or not np.max(found.over[rows][:, best]) > 1:
            return None
        row = rows[int(np.argmax(found.over[rows][:, best]))]
    time_profile = _finer(blocks, followed, known, row, time_profiles[best])
    return time_profile if time_profile.kind == "step" else None


def _mended_one_by_one(
    now: Blocks, followed: Followed, known: np.ndarray, sensors: Sequence[Sensor], time_profile: TimeProfile,
                       found: Found,
    seen: Followed, fit: np.ndarray,
) -> list[tuple[int, _Mended]]:
    """The effects that explain nearly as much as the best one (`fit`, as `_explained`) with the number of their series,
    those first that leave least; none of them leaves anything of the frequencies."""
    tried: list[tuple[int, _Mended]] = []
    for row in map(int, np.argsort(-fit)[:MOST_TRIED]):
        if fit[row] <= ALIKE * fit.max() or (tried and tried[0][1].left <= 1):
            break
        then, size, std = mend(now, seen, known, sensors, row, time_profile)
        of_frequencies, left = left_at(then, followed, known, sensors, time_profile, found)
        # what is left of frequencies no sensor does, and what ends at a bound is something else
        effect = seen.effects[row - seen.n_frequency]
        if of_frequencies <= 1 and np.isfinite(std) and not size_at_bound(effect, size):
            tried.append((row,
                          _Mended(effect=effect, time_profile=time_profile, size=size,
                                       size_std=std, left=left, blocks=then)))
            tried.sort(key=lambda t: t[1].left)
    return tried


def _probability_of_series(
    seen: Followed, fit: np.ndarray, scores: Scores, row: int, mended_worse: Sequence[int]
) -> dict[int, float]:
    """How probable it is that each series of sensors, but for those that were found to mend less, is what `row` shows,
    all at the scatter that is usual for sensors."""
    usual = max(1.0, float(np.median(scores.noise[seen.classes[1], 0])))
    competing = [k for k in seen.classes[1] if fit[k] > 0.25 * fit[row] and k not in mended_worse]
    gain = (fit[competing] - fit[row]) / usual
    return {k: float(p) for k, p in zip(competing, np.exp(gain - logsumexp(gain)), strict=True)}


def _change_of_sensor(
    blocks: Blocks, seen: Followed, mended_by: _Mended, row: int, z: float, probability: Mapping[int, float]
) -> Change:
    """The change with its finding; `probability` of each series, `row` the one that was taken out."""
    effect, time_profile = mended_by.effect, mended_by.time_profile
    others = sorted((k for k in probability if k != row and probability[k] > 1e-3), key=lambda k: -probability[k])
    finding = Finding(
        kind=effect.kind, cause=effect.cause, location=effect.location, size=mended_by.size,
        size_std=mended_by.size_std, unit=effect.unit, time_profile=time_profile.name,
                      time_profile_start=blocks.ids[time_profile.at], z=z,
        posterior_probability=probability[row],
        alternatives=tuple(
            Alternative(cause=e.cause, location=e.location, posterior_probability=probability[k], key=e.key)
            for k in others for e in [seen.effects[k - seen.n_frequency]]),
        check=effect.check, key=effect.key)
    return Change(finding=finding, time_profile=time_profile, moved=(),
                  within_tolerance=abs(mended_by.size) <= effect.tolerance)


def _explained(
    now: Blocks, followed: Followed, known: np.ndarray, sensors: Sequence[Sensor], time_profile: TimeProfile,
    found: Found,
) -> tuple[Followed, np.ndarray, Scores]:
    """What is followed beside what was before the time profile; (n_series,) by how much each effect of sensors would
    better the fit (half a chi-square), all at the scatter that was estimated for a block, as that of the series itself
    counts what other effects do to it, zero for those whose own score is not beyond chance where others' are; scores.
    """
    seen = watch(now, followed.effects, sensors, known, time_profile=time_profile.value)
    nuisance = seen.empirical.nuisance(known)
    contrasts = make_contrasts(seen.weight, nuisance, [time_profile], seen.blocks.hours)
    scores = score(contrasts, seen.series, seen.pools)
    can = allowed_profiles(seen, [time_profile])[:, 0] & contrasts.usable[:, 0]
    can[: seen.n_frequency] = False
    for k in np.flatnonzero(can):
        effect = seen.effects[k - seen.n_frequency]
        can[k] = effect.lower < 0 if scores.size[k, 0] < 0 else effect.upper > 0
    strong = can & (np.abs(scores.z[:, 0]) > found.threshold)
    can = strong if strong.any() else can
    variance = np.where(can, contrasts.white_var[:, 0], 1.0)
    return seen, np.where(can, 0.5 * scores.size[:, 0] ** 2 / variance, 0.0), scores


def _likely_as_a_whole(blocks: Blocks, whole: Sequence[Effect], times: Collection[int]) -> list[Effect]:
    """Of exchanged and reversed channels, pairs of which are many, those by which the planes of the modes before one of
    the times come nearest to those after it."""
    identity, apart = np.eye(len(blocks.channels), dtype=complex), np.full(len(whole), np.inf)
    done = [np.real(effect.observation(identity, 1.0, effect.discrete[0])[0]) for effect in whole]
    planes = []
    for q, group in enumerate(blocks.groups):
        there = np.flatnonzero(blocks.present[:, q])
        basis = np.linalg.qr(blocks.shape[there][:, :, list(group)])[0]
        planes.append((there, np.einsum("nck,ndk->ncd", basis, basis.conj()).real))
    for at in times:
        left = np.zeros(len(whole))
        for there, plane in planes:
            if np.any(there < at) and np.any(there >= at):
                before, after = plane[there < at].mean(axis=0), plane[there >= at].mean(axis=0)
                left += [float(np.sum((after - S @ before @ S.T) ** 2)) for S in done]
        apart = np.minimum(apart, left)
    return [whole[k] for k in np.argsort(apart, kind="stable")[:MOST_WHOLE]]


def _as_a_whole(
    now: Blocks, followed: Followed, known: np.ndarray, sensors: Sequence[Sensor], time_profile: TimeProfile,
                found: Found, whole: Sequence[Effect], *, once: bool,
) -> _Mended | None:
    """Of the exchanged or reversed channels those that leave least of all residuals; the time profile's time is theirs
    where nothing else was taken out along it (`once`)."""
    n, tried = len(now), []

    def left_by(effect: Effect, at: int) -> float:
        return _apart(_from_block(now, effect, effect.discrete[0], at), sensors)

    # a channel reversed half of the time has no mean, and its scores are at wrong times: a coarse grid of them is asked
    grid = {time_profile.at, *map(int, np.linspace(EDGE, n - EDGE, N_STEP))} if once else {time_profile.at}
    for effect in _likely_as_a_whole(now, whole, grid):
        least, at = min((left_by(effect, at), at) for at in grid)
        tried.append((least, at, effect))
    tried.sort(key=lambda t: t[:2])
    # one block on the wrong side of a step outweighs what tells two of them from each other
    sharper = [(left_by(effect, at), at, effect) for _, first, effect in tried[:MOST_TRIED]
               for at in [_sharper(n, first, partial(left_by, effect)) if once else first]]
    if not sharper:
        return None
    least, at, effect = min(sharper, key=lambda t: t[:2])
    if least >= _apart(now, sensors):
        return None
    own = step_profile(n, at) if once else time_profile
    then = mended(now, effect, effect.discrete[0] * own.value)
    left = max(max(left_at(then, followed, known, sensors, one, found)) for one in (time_profile, own))
    return _Mended(effect=effect, time_profile=own, size=effect.discrete[0], size_std=0.0, left=left, blocks=then)
