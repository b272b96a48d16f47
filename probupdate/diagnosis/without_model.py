"""A diagnosis by the data alone: what changes along the record, what follows the environmental and operational
conditions, which sensor is off.

Structural causes cannot be named without a model: a change of frequencies that no column of the environmental and
operational conditions explains is *unexplained*, with the modes that moved, by how much and since when. """

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.special import logsumexp

from probupdate.campaign.rigid_bodies import levelled
from probupdate.diagnosis.blocks import Blocks, gather, with_derived
from probupdate.diagnosis.diagnose import CHANCE, POWER, SURE, verdict_of
from probupdate.diagnosis.empirical_reference import look, mended, own_noise, residuals
from probupdate.diagnosis.empirical_search import (
    ALL,
    FALSE_ALARM,
    LEFT,
    MEAN,
    Followed,
    Found,
    Scores,
    allowed_profiles,
    log_change_of_structure,
    log_density,
    make_contrasts,
    score,
    search,
    watch,
)
from probupdate.diagnosis.level_shapes import judge_levels, mean_shapes
from probupdate.diagnosis.results import Alternative, DetectableSize, Diagnosis, Finding
from probupdate.diagnosis.search import FALSE_ALARM as MODEL_FALSE_ALARM
from probupdate.diagnosis.search import FALSE_NEXT
from probupdate.diagnosis.time_profiles import EDGE, N_STEP, TimeProfile, make_time_profiles, step_profile
from probupdate.effects.catalogue import Effect, measurement_effects
from probupdate.errors import InputError
from probupdate.modal.modes import ModalData, Sensor
from probupdate.runtime.progress import Progress, silent

# false alarms of a search that follows a change, over the first one's, as with a model
NEXT_SHARE = FALSE_NEXT / MODEL_FALSE_ALARM
# changes taken out one after the other; effects of sensors at one time
MOST_CHANGES, MOST_AT_ONCE = 6, 3
# what competes with effects of sensors
STRUCTURE, ODD = "unexplained change of frequencies and shapes", "structure less symmetric or less rigid than is normal"
# effects that explain nearly as much (share of the best one's) are tried, at most so many
ALIKE, MOST_TRIED = 0.8, 3
# column -> (cause, location, check) in the catalogue's words
CAUSES = {
    "water_level_m": ("wetted length", "all members", "tide gauge against the second bending"),
    "air_temperature_c": ("temperature of the steel", "all members", "steel temperature sensors"),
    "thrust_share": ("rotor thrust", "hub", "tower bending strain"),
    "frost_degc": ("icing", "rotor", "ice detector, power curve"),
    "rms_mps2": ("softening with amplitude", "soil or joints", "storms of equal wind, other sea"),
    "wave_height_m": ("softening with amplitude", "soil or joints", "storms of equal wind, other sea"),
    "wind_speed_mps": ("frequencies follow the wind", "rotor", "blocks of equal state, other wind"),
}
# numbers of the environment that describe the block or the operation, not the environmental and operational conditions
NOT_CONDITIONS = ("nacelle_", "block_", "power_kw", "pitch_deg", "rotor_speed", "wave_period", "wind_direction",
                  "yaw_", "n_", "sampling_")


# What a change is ---------------------------------------------------------------------------------------------------


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
    nuisance = root[:, None] * np.column_stack([np.ones(n), followed.empirical.turning, known])
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
    return sum(float(np.sum(y**2)) for y in look(blocks, sensors).differences)


def _from_block(blocks: Blocks, effect: Effect, size: float, at: int) -> Blocks:
    """The blocks with an effect of this size taken out from one block on."""
    return mended(blocks, effect, size * step_profile(len(blocks), at).value)


def _sharper(n: int, at: int, left: Callable[[int], float]) -> int:
    """Of n blocks the one from which `left` is least, by halved steps from one of a coarse grid."""
    left = cache(left)
    step = -(-(n - 2 * EDGE) // N_STEP)
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
    blocks: Blocks, followed: Followed, known: np.ndarray, sensors: Sequence[Sensor], mended_by: _Mended
) -> TimeProfile:
    """The step from which an effect of its size leaves least of all residuals, in standard deviations, a block far off
    counting the logarithm: beside a strong effect blocks that look elsewhere stand apart, and the series alone does not
    show on which side of the step they are."""
    noise = followed.noise

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
    the size is right when nothing of it is left."""
    effect = followed.effects[row - followed.n_frequency]
    n = len(blocks)
    nuisance = np.column_stack([np.ones(n), followed.empirical.turning, known])
    size, std, now, seen = 0.0, np.inf, blocks, followed
    for _ in range(6):
        contrasts = make_contrasts(seen.weight[[row]], nuisance, [time_profile], blocks.hours)
        left = score(contrasts, seen.series[[row]], [[0]])
        more, std = float(left.size[0, 0]), float(left.size_std[0, 0])
        size = float(np.clip(size + more, 0.95 * max(effect.lower, -1e300), min(effect.upper, 1e300)))
        now = mended(blocks, effect, size * time_profile.value)
        if abs(more) < 0.1 * std:
            break
        seen, row = watch(now, (effect,), sensors, known, stated=followed.stated), followed.n_frequency
    return now, size, std


def left_at(
    blocks: Blocks, followed: Followed, known: np.ndarray, sensors: Sequence[Sensor], time_profile: TimeProfile,
            found: Found
) -> tuple[float, float]:
    """The largest score over its threshold that blocks still have along one time profile: of frequencies, of
    sensors."""
    seen = watch(blocks, followed.effects, sensors, known, stated=followed.stated)
    nuisance = np.column_stack([np.ones(len(blocks)), seen.empirical.turning, known])
    scores = score(make_contrasts(seen.weight, nuisance, [time_profile], blocks.hours), seen.series, seen.pools)
    over = np.abs(scores.z[:, 0]) / found.threshold
    return float(np.max(over[: seen.n_frequency])), float(np.max(over[seen.n_frequency :], initial=0.0))


def moved_frequencies(followed: Followed, scores: Scores, column: int) -> tuple[dict, ...]:
    """Per number of the frequencies: its change for the time profile's unit, with standard deviation and z."""
    blocks = followed.blocks
    rows = []
    for k, (q, i) in enumerate(followed.names):
        rows.append({"mode": series_name(blocks, q, i), "change_percent": 100 * float(scores.size[k, column]),
                     "std_percent": 100 * float(scores.size_std[k, column]), "z": float(scores.z[k, column])})
    return tuple(r for r in rows if np.isfinite(r["std_percent"]))


def series_name(blocks: Blocks, q: int, i: int) -> str:
    """Modes whose frequency a series follows."""
    if q == ALL:
        return "all modes"
    return blocks.group_name(q) + ("" if len(blocks.groups[q]) == 1 else (" axis 1", " axis 2", " between", "")[i])


def profile_probability(followed: Followed, found: Found, time_profiles: Sequence[TimeProfile],
                        best: int) -> np.ndarray:
    """(n_profile,) how probable it is that the frequencies go with each time profile, all at the best one's scatter;
    the times of a step share one prior."""
    rows = [k for k, (q, i) in enumerate(followed.names) if q != ALL and i != MEAN]
    noise, slow = found.scores.noise[rows, best], found.scores.slow_error[rows, best]
    c = found.contrasts
    variance = noise[:, None] * c.white_var[rows] + slow[:, None] * c.slow_var[rows]
    good = c.usable[rows] & (variance > 0)
    gain = 0.5 * np.sum(np.where(good, found.scores.size[rows] ** 2 / np.where(good, variance, 1.0), 0.0), axis=0)
    n_step = max(sum(x.kind == "step" for x in time_profiles), 1)
    gain = gain - np.array([np.log(n_step) if x.kind == "step" else 0.0 for x in time_profiles])
    return np.exp(gain - logsumexp(gain))


def _by_name(time_profiles: Sequence[TimeProfile], probability: np.ndarray) -> dict[str, float]:
    names: dict[str, float] = {}
    for time_profile, p in zip(time_profiles, probability, strict=True):
        names[time_profile.name] = names.get(time_profile.name, 0.0) + float(p)
    return dict(sorted(names.items(), key=lambda item: -item[1]))


def _cause(name: str) -> tuple[str, str, str]:
    """(cause, location, check) of what goes with a time profile of that name."""
    if name in ("step", "ramp"):
        return f"unexplained {name} of frequencies", "structure", "a model is needed to name it"
    return CAUSES.get(name, (f"frequencies follow {name}", "all modes", f"look at what {name} stands for"))


def _by_chance(
    blocks: Blocks, followed: Followed, time_profiles: Sequence[TimeProfile], known: np.ndarray
) -> bool:
    """Whether no change is more probable than any change of frequencies and shapes, at the scatter that all numbers
    together say a block has: of so many series of a few blocks one scatters little by chance, and its z is large."""
    nuisance = np.column_stack([np.ones(len(blocks)), followed.empirical.turning, known])
    return log_change_of_structure(residuals(followed.empirical, known), followed.noise, nuisance, time_profiles,
                                   [len(g) for g in blocks.groups]) < np.log(2)


def _condition(followed: Followed, found: Found, time_profiles: Sequence[TimeProfile]) -> Change:
    """What the frequencies go with."""
    rows = followed.classes[0]
    best = int(np.argmax(np.max(found.over[rows], axis=0)))
    probability = profile_probability(followed, found, time_profiles, int(best))
    names = _by_name(time_profiles, probability)
    name = next(iter(names))
    best = int(np.argmax(np.where([c.name == name for c in time_profiles], probability, -1)))
    time_profile, moved = time_profiles[best], moved_frequencies(followed, found.scores, best)
    if time_profile.kind in ("step", "ramp") and names[name] >= SURE:
        return Change(finding=None, time_profile=time_profile, moved=moved)
    cause, location, check = _cause(name)
    competing = [(n, p) for n, p in list(names.items())[1:] if p > 1e-3]
    strongest = max(moved, key=lambda r: abs(r["z"]))
    split = ""
    if competing:
        split = f"blocks in which {' and '.join([name, *[n for n, _ in competing[:2]]])} do not go together"
    finding = Finding(
        kind="structural" if time_profile.kind in ("step", "ramp") else "environmental", cause=cause, location=location,
        size=strongest["change_percent"], size_std=strongest["std_percent"],
        unit=f"% of the frequency of {strongest['mode']}{time_profile.unit}", time_profile=name,
        time_profile_start=followed.blocks.ids[time_profile.at] if time_profile.kind == "step" else "",
                      z=strongest["z"],
        posterior_probability=names[name],
        alternatives=tuple(Alternative(cause=_cause(n)[0], location=_cause(n)[1], posterior_probability=p)
                           for n, p in competing),
        check=split if names[name] < SURE else check,
    )
    return Change(finding=finding, time_profile=time_profile, moved=moved)


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
        seen = watch(now, followed.effects, sensors, known, stated=followed.stated, time_profile=time_profile.value)
        fit, scores = _explained(seen, known, time_profile, found)
        if not number:
            # by what was before the step, its time is estimated better
            finer = _finer(now, seen, known, int(np.argmax(fit)), time_profile)
            if finer.at != time_profile.at:
                time_profile = finer
                seen = watch(now, followed.effects, sensors, known, stated=followed.stated,
                             time_profile=time_profile.value)
                fit, scores = _explained(seen, known, time_profile, found)
        tried = []
        if number or not whole_alone:
            tried = _mended_one_by_one(now, followed, known, sensors, time_profile, found, seen, fit)
        if tried and not number:
            sharper = _sharper_profile(now, followed, known, sensors, tried[0][1])
            if sharper.at != time_profile.at:
                time_profile = sharper
                seen = watch(now, followed.effects, sensors, known, stated=followed.stated,
                             time_profile=time_profile.value)
                fit, scores = _explained(seen, known, time_profile, found)
                tried = _mended_one_by_one(now, followed, known, sensors, time_profile, found, seen, fit)
        row, best = tried[0] if tried else (int(np.argmax(fit)), None)
        probability = {row: 1.0}
        if best is not None:
            probability = _probability_of_series(seen, fit, scores, row, [k for k, _ in tried[1:]])
        if best is None or best.left > 1:
            other = _as_a_whole(now, followed, known, sensors, time_profile, found, whole, seen, fit, once=not number)
            if other is not None and (best is None or other.left < best.left):
                best, time_profile, probability = other, other.time_profile, {row: 1.0}
        if best is None:
            return None
        changes.append(_change_of_sensor(blocks, seen, best, row, float(scores.z[row, 0]), probability))
        now = best.blocks
        if best.left <= 1:
            return changes, now
    return None


def _more_probable_than_the_structure(
    blocks: Blocks, followed: Followed, found: Found, time_profiles: Sequence[TimeProfile], known: np.ndarray,
    sensors: Sequence[Sensor], rows: Sequence[Effect], whole: Sequence[Effect],
) -> tuple[list[Change], Blocks] | None:
    """Effects of sensors as `_sensor`, with the structure and chance among their alternatives; none where chance is
    more probable, None where the structure is. A channel reversed half of the time makes series of which a small gain
    explains enough."""
    for whole_alone in (False, True):
        of_sensors = _sensor(blocks, followed, found, time_profiles, known, sensors, whole, whole_alone=whole_alone)
        if of_sensors is not None:
            of_sensors = _beside_the_structure(blocks, of_sensors, (*rows, *whole), sensors, followed, time_profiles,
                                               known)
        if of_sensors is not None:
            return of_sensors
    return None


def _beside_the_structure(
    blocks: Blocks, of_sensors: tuple[list[Change], Blocks], catalogue: Sequence[Effect], sensors: Sequence[Sensor],
    followed: Followed, time_profiles: Sequence[TimeProfile], known: np.ndarray,
) -> tuple[list[Change], Blocks] | None:
    """The same with what the structure and chance leave of their probability: three small effects of sensors mend much
    of what a change of the structure does. None where that change is the more probable, nothing where chance is."""
    changes, now = of_sensors
    empirical = look(now, sensors)
    rest = residuals(empirical, known)
    noise = own_noise(now, empirical, rest, followed.stated)
    before = residuals(look(blocks, sensors), known)
    nuisance = np.column_stack([np.ones(len(blocks)), empirical.turning, known])
    structure = log_change_of_structure(before, noise, nuisance, time_profiles, [len(g) for g in blocks.groups])
    of_name = {(e.cause, e.location): e for e in catalogue}
    total = sum(e.prior_odds("step") for e in catalogue)
    findings = [c.finding for c in changes if c.finding is not None]
    own = log_density(rest, noise) - log_density(before, noise)
    own -= np.log(max(sum(c.kind == "step" for c in time_profiles), 1))
    for f in findings:
        effect = of_name[f.cause, f.location]
        own += np.log(effect.prior_odds("step") / total)
        if not effect.discrete:
            # the posterior's width times the Cauchy density of the size's prior
            ratio = f.size / effect.prior_scale
            own += np.log(f.size_std * np.sqrt(2 / np.pi) / effect.prior_scale) - np.log1p(ratio**2)
            own += np.log(2 / len(effect.signs))
    # sensors and the structure are as probable before as each other, no change as both
    each = np.array([own, structure, np.log(2)])
    share, of_structure, chance = map(float, np.exp(each - logsumexp(each)))
    if share < max(of_structure, chance):
        return None if of_structure > chance else ([], blocks)
    others = [Alternative(cause=cause, location=place, posterior_probability=probability) for cause, place, probability
              in ((STRUCTURE, "structure", of_structure), (CHANCE, "", chance)) if probability > 1e-3]
    return [c if c.finding is None else replace(c, finding=_less_probable(c.finding, share, others))
            for c in changes], now


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
        if of_frequencies <= 1 and np.isfinite(std):
            tried.append((row,
                          _Mended(effect=seen.effects[row - seen.n_frequency], time_profile=time_profile, size=size,
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
        alternatives=tuple(Alternative(cause=e.cause, location=e.location, posterior_probability=probability[k])
                           for k in others for e in [seen.effects[k - seen.n_frequency]]),
        check=effect.check)
    return Change(finding=finding, time_profile=time_profile, moved=(),
                  within_tolerance=abs(mended_by.size) <= effect.tolerance)


def _explained(seen: Followed, known: np.ndarray, time_profile: TimeProfile, found: Found) -> tuple[np.ndarray, Scores]:
    """(n_series,) by how much each effect of sensors would better the fit (half a chi-square), all at the scatter that
    was estimated for a block: that of the series itself counts what other effects do to it. Zero for those whose own
    score is not beyond chance where others' are."""
    nuisance = np.column_stack([np.ones(len(seen.blocks)), seen.empirical.turning, known])
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
    return np.where(can, 0.5 * scores.size[:, 0] ** 2 / variance, 0.0), scores


def _as_a_whole(
    now: Blocks, followed: Followed, known: np.ndarray, sensors: Sequence[Sensor], time_profile: TimeProfile,
                found: Found,
    whole: Sequence[Effect], seen: Followed, fit: np.ndarray, *, once: bool,
) -> _Mended | None:
    """Of the exchanged or reversed channels those that leave least of all residuals; the time profile's time is theirs
    where nothing else was taken out along it (`once`)."""
    strong = {seen.effects[k - seen.n_frequency].location for k in np.argsort(-fit)[:8]
              if seen.effects[k - seen.n_frequency].cause == "sensor gain"}
    n, tried = len(now), []
    # a channel reversed half of the time has no mean, and its scores are at wrong times: a coarse grid of them is asked
    grid = {time_profile.at, *map(int, np.linspace(EDGE, n - EDGE, N_STEP))} if once else {time_profile.at}
    for effect in whole:
        names = effect.location.split(" and ")
        # pairs are many: those of channels whose gains explain much
        if len(names) == 1 or all(name in strong for name in names):
            tried += [(_apart(_from_block(now, effect, effect.discrete[0], at), sensors), at, effect) for at in grid]
    if not tried:
        return None
    least, at, effect = min(tried, key=lambda t: t[:2])
    if least >= _apart(now, sensors):
        return None
    own = time_profile
    if once:
        own = step_profile(n, _sharper(n, at, lambda k: _apart(_from_block(now, effect, effect.discrete[0], k),
                                                               sensors)))
    then = mended(now, effect, effect.discrete[0] * own.value)
    left = max(max(left_at(then, followed, known, sensors, one, found)) for one in (time_profile, own))
    return _Mended(effect=effect, time_profile=own, size=effect.discrete[0], size_std=0.0, left=left, blocks=then)


def condition_columns(blocks: Blocks) -> tuple[str, ...]:
    """Columns of the environment that may move frequencies: the known ones, and a user's own."""
    names = dict.fromkeys(k for e in blocks.environment for k, v in e.items()
                          if isinstance(v, int | float) and not isinstance(v, bool))
    own = [n for n in names if n not in CAUSES and not n.startswith(NOT_CONDITIONS)]
    return (*(n for n in CAUSES if n in names), *own)


def diagnose_without_model(
    data: ModalData, sensors: Sequence[Sensor] | None = None, *, campaign_check: Sequence[Mapping] | None = None,
    effects: Sequence[Effect] = (), seed: int = 1, progress: Progress = silent,
) -> Diagnosis:
    """Measurement and environmental and operational conditions only: what modes.json shows of itself.

    `sensors`: where channels are; without them only gains along the record can be judged. `campaign_check`: findings in
    the raw records (see `campaign_tests.campaign_tests`), listed and counted. `effects`: a user's own of sensors.
    """
    blocks = with_derived(gather(data))
    placed = tuple(s for s in sensors or () if s.channel in blocks.channels)
    rows = tuple(e for e in (*measurement_effects(blocks.channels, placed), *effects)
                 if e.observe is not None and not e.discrete and set(e.time_profiles) != {"constant"})
    whole = tuple(e for e in measurement_effects(blocks.channels, placed) if e.discrete)
    # what moves as one body is a matter of places, whatever these are called
    placed = levelled(placed)
    columns = (*condition_columns(blocks), *(c for e in effects for c in e.time_profiles))
    time_profiles = [c for c in make_time_profiles(blocks, tuple(dict.fromkeys(columns))) if c.kind != "constant"]
    if not time_profiles:
        raise _too_few(blocks)
    # frequencies, sensors along the record, and constant shapes share the false alarms
    share = FALSE_ALARM / (3 if placed else 2)
    changes, blocks, followed, found, left = _taken_out(blocks, time_profiles, rows, whole, placed, share, seed,
                                                        progress)
    steady = _steady(blocks, placed, rows, whole, share, seed) if placed else None
    findings = [c.finding for c in changes if c.finding is not None and not c.within_tolerance]
    detectable_sizes, p_value, notes = list(_detectable_sizes(followed, found,
                                                              time_profiles)), found.p_value, list(blocks.notes)
    if steady is not None:
        findings += steady.findings
        detectable_sizes += steady.detectable_sizes
        p_value = min(p_value, min(1.0, steady.p_value * FALSE_ALARM / share))
    unexplained = [c for c in changes if c.finding is None]
    verdict = "unexplained" if unexplained or left else verdict_of(findings)
    details = {"without_model": True, "changes": [_change_table(blocks, c) for c in unexplained],
               "constant_shapes_over_threshold": 0.0 if steady is None else steady.unexplained,
               "measurement": [dict(m) for m in campaign_check or ()]}
    notes += [f"{f.cause}, {f.location} changes by {f.size:.2g} {f.unit} at {f.time_profile_start}: within its "
              "tolerance, taken out" for c in changes if c.within_tolerance and (f := c.finding) is not None]
    notes += _notes(blocks, placed, unexplained, steady)
    return Diagnosis(
        verdict=verdict, p_value=p_value, findings=tuple(findings), detectable_sizes=tuple(detectable_sizes),
        threshold=float(np.min(found.threshold)), adequacy_p=float("nan"), notes=tuple(notes), parameters=(),
        splits=tuple(f.check for f in findings if f.posterior_probability < SURE), details=details,
    )


def _too_few(blocks: Blocks) -> InputError:
    shown = "1 set shows" if len(blocks) == 1 else f"{len(blocks)} sets show"
    return InputError("modes", f"{shown} no change along the record that chance would not make too: without a model "
                      "sets are compared with one another alone",
                      "give more sets (ten and more), or a model of the structure (--model)")


def _taken_out(
    blocks: Blocks, time_profiles: Sequence[TimeProfile], rows: Sequence[Effect], whole: Sequence[Effect],
    placed: Sequence[Sensor], share: float, seed: int, progress: Progress,
) -> tuple[list[Change], Blocks, Followed, Found, bool]:
    """What changes along the record, one after the other, and the blocks without what sensors were found to do; what
    the first look followed and found there, and whether the last one still found something."""
    known = np.zeros((len(blocks), 0))

    def looked_at(number: int) -> tuple[Followed, Found]:
        progress("diagnosing", number, MOST_CHANGES + 1)
        followed = watch(blocks, rows, placed, known)
        # after a change as beside a model's findings: the searches that follow have half of the false alarms
        own = share * NEXT_SHARE if number else share
        return followed, search(followed, time_profiles, known, seed, own)

    changes: list[Change] = []
    followed, found = first = looked_at(0)
    # shapes may still say what is wrong with sensors all through the record, if it is known where they are
    if not (placed or np.isfinite(found.threshold).any()):
        raise _too_few(blocks)
    for number in range(1, MOST_CHANGES + 1):
        if not np.max(found.over) > 1:
            break
        of_sensors = _more_probable_than_the_structure(blocks, followed, found, time_profiles, known, placed, rows,
                                                       whole)
        of_frequencies = np.max(found.over[followed.classes[0]]) > 1
        if (of_sensors is None or not of_sensors[0]) and _by_chance(blocks, followed, time_profiles, known):
            # nothing more but what chance would make as well
            progress("diagnosing", MOST_CHANGES + 1, MOST_CHANGES + 1)
            return changes, blocks, *first, False
        if of_sensors is not None and of_sensors[0]:
            changes += of_sensors[0]
            blocks = of_sensors[1]
        else:
            if of_frequencies:
                change = _condition(followed, found, time_profiles)
            else:
                _, best = np.unravel_index(int(np.argmax(found.over)), found.over.shape)
                change = Change(finding=None, time_profile=time_profiles[int(best)], moved=())
            changes.append(change)
            known = np.column_stack([known, change.time_profile.value])
        followed, found = looked_at(number)
    progress("diagnosing", MOST_CHANGES + 1, MOST_CHANGES + 1)
    return changes, blocks, *first, bool(np.max(found.over) > 1)


@dataclass(frozen=True, eq=False, kw_only=True)
class Steady:
    """What constant shapes show: findings, minimum detectable sizes, p of the largest score, what is left over its
    threshold."""

    findings: tuple[Finding, ...]
    detectable_sizes: tuple[DetectableSize, ...]
    p_value: float
    unexplained: float


def _steady(blocks: Blocks, placed, rows: Sequence[Effect], whole, false_alarm: float, seed: int) -> Steady:
    # a shift of all frequencies, or a turn of all sensors, is no constant that shapes alone could show
    able = [e for e in rows if e.cause not in ("sampling rate", "rotated sensor frame")]
    answer = judge_levels(mean_shapes(look(blocks, placed).mean, blocks.channels, placed), able, whole,
                          false_alarm=false_alarm, seed=seed)
    findings = []
    for competing, structure in zip(answer.found, answer.structure, strict=True):
        best = competing[0]
        each = np.array([*(r.log_posterior for r in competing), structure, 0.0])
        probability = np.exp(each - logsumexp(each))
        others = [(r, float(p)) for r, p in zip(competing[1:], probability[1:-2], strict=True) if p > 1e-3]
        beyond = [Alternative(cause=cause, location=place, posterior_probability=float(p)) for cause, place, p in
                  zip((ODD, CHANCE), ("structure", ""), probability[-2:], strict=True) if p > 1e-3]
        names = " or ".join([best.effect.name, *(r.effect.name for r, _ in others[:3])])
        findings.append(Finding(
            kind=best.effect.kind, cause=best.effect.cause, location=best.effect.location, size=best.size,
            size_std=best.size_std, unit=best.effect.unit, time_profile="constant", time_profile_start="", z=best.z,
            posterior_probability=float(probability[0]),
            alternatives=(*(Alternative(cause=r.effect.cause, location=r.effect.location, posterior_probability=p)
                            for r, p in others), *beyond),
            check=best.effect.check if probability[0] >= SURE else f"check on site: {names}"))
    detectable_sizes = []
    for k, (size, left, z) in answer.detectable_sizes.items():
        e = able[k]
        detectable_sizes.append(DetectableSize(kind=e.kind, cause=e.cause, location=e.location, time_profile="constant",
                                               unit=e.unit,
                            size=size if size <= max(-e.lower, e.upper) else np.inf, share_left=left,
                            z=z))
    return Steady(findings=tuple(findings), detectable_sizes=tuple(detectable_sizes), p_value=answer.p_value,
                  unexplained=answer.unexplained)


def _change_table(blocks: Blocks, change: Change) -> dict:
    start = blocks.ids[change.time_profile.at] if change.time_profile.kind == "step" else ""
    return {"time_profile": change.time_profile.name, "since": start, "frequencies": [dict(m) for m in change.moved],
            "what": "frequencies" if change.moved else "shapes"}


def _notes(blocks: Blocks, placed: Sequence[Sensor], unexplained: Sequence[Change],
           steady: Steady | None) -> list[str]:
    notes = ["without a model: structural causes are not named, constant ones of the structure are not seen"]
    if not placed:
        notes.append("without the sensors' places: levels, loggers and directions are not judged")
    for change in unexplained:
        when = f" from {blocks.ids[change.time_profile.at]} on" if change.time_profile.kind == "step" else ""
        moved = [m for m in change.moved if abs(m["z"]) > 3]
        what = ", ".join(f"{m['mode']} by {m['change_percent']:+.2g} +- {m['std_percent']:.1g} %" for m in moved)
        notes.append(f"unexplained {change.time_profile.name}{when}: {what or 'shapes change, frequencies do not'}; no "
                     "environmental or operational condition goes with it, and a model would be needed to name "
                     "it")
    if steady is not None and steady.unexplained:
        notes.append("the levels' constant motion is not that of a rigid, symmetric structure, and no one sensor "
                     "explains it: a model is needed to say what does")
    return notes


def _detectable_sizes(followed: Followed, found: Found, time_profiles: Sequence[TimeProfile]) -> tuple[DetectableSize,
                                                                                                       ...]:
    """The least change of every frequency, and size of every sensor's effect, that would be found along each time
    profile."""
    allowed = allowed_profiles(followed, time_profiles)
    best: dict[tuple[int, str], int] = {}
    for k, c in zip(*np.nonzero(allowed & np.isfinite(found.scores.size_std)), strict=True):
        key = (int(k), time_profiles[c].name)
        if key not in best or found.scores.size_std[k, c] < found.scores.size_std[k, best[key]]:
            best[key] = int(c)
    detectable_sizes = []
    for (k, name), c in best.items():
        size = (found.threshold[k] + POWER) * found.scores.size_std[k, c]
        if k < followed.n_frequency:
            q, i = followed.names[k]
            kind, cause = ("structural", f"{name} of frequency") if name in ("step", "ramp") else (
                "environmental", _cause(name)[0])
            place = series_name(followed.blocks, q, i)
            detectable_sizes.append(DetectableSize(kind=kind, cause=cause, location=place, time_profile=name,
                                                   size=float(100 * size),
                                unit=f"% of frequency{time_profiles[c].unit}", share_left=1.0, z=float(found.z[k, c])))
            continue
        effect = followed.effects[k - followed.n_frequency]
        size = max(size, effect.tolerance)
        reachable = size <= max(-effect.lower, effect.upper)
        detectable_sizes.append(DetectableSize(kind=effect.kind, cause=effect.cause, location=effect.location,
                                               time_profile=name,
                            size=float(size) if reachable else np.inf, unit=effect.unit + time_profiles[c].unit,
                            share_left=1.0, z=float(found.z[k, c])))
    return tuple(detectable_sizes)
