"""A diagnosis by the data alone: what changes along the record, what follows the environmental and operational
conditions, which sensor is off.

Structural causes cannot be named without a model: a change of frequencies that no column of the environmental and
operational conditions explains is *unexplained*, with the modes that moved, by how much and since when. """

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from scipy.special import logsumexp

from probupdate.campaign.rigid_bodies import name_levels
from probupdate.diagnosis.blocks import Blocks, gather, with_derived
from probupdate.diagnosis.empirical_reference import look
from probupdate.diagnosis.empirical_search import Odds, ReferencedBlocks, log_prior_of_profiles, odds_of, watch
from probupdate.diagnosis.engine.library import Unknown, sizes
from probupdate.diagnosis.engine.verdict import POWER, SURE, verdict_of
from probupdate.diagnosis.level_shapes import OWN_RESPONSE, LevelAnswer, judge_levels, level_reference
from probupdate.diagnosis.results import Alternative, DetectableSize, Diagnosis, Finding
from probupdate.diagnosis.sensor_changes import Change, changes_of_sensors
from probupdate.diagnosis.time_profiles import EDGE, TimeProfile, blocks_between_steps, make_time_profiles, step_profile
from probupdate.effects.catalogue import Effect, measurement_effects
from probupdate.errors import InputError
from probupdate.modal.joined_modes import join_modes
from probupdate.modal.modes import ModalData, Sensor
from probupdate.runtime.progress import Progress, silent

# odds of nothing below which something changes: records with nothing hidden come there in as many, or in twice as many
# with stated columns, by Markov's inequality (a mean of Bayes factors is one), and in one of a hundred where they were
# drawn. What changes and what is constant share it, and after each change half of it is left
NOTHING, NEXT_SHARE = 0.1, 0.5
# times of a step that are tried at first
STEPS = 64
# blocks before a change of which shapes are a mean
FEWEST_BEFORE = 4
# changes taken out one after the other
MOST_CHANGES = 6
# numbers of a pair's frequencies
PARTS = (" axis 1", " axis 2", " between")
# column -> (cause, location, check) in the catalogue's words
CAUSES = {
    "water_level_m": ("wetted length", "all members", "tide gauge against the second bending"),
    "air_temperature_c": ("temperature of the steel", "all members", "steel temperature sensors"),
    "thrust_share": ("rotor thrust", "hub", "tower bending strain"),
    "frost_degc": ("icing", "rotor", "ice detector, power curve"),
    # of the vibration or of the waves; soil and joints soften with it, or mass follows it, which no column says
    "rms_mps2": ("frequencies follow the amplitude", "all modes", "storms of equal wind, other sea"),
    "wave_height_m": ("frequencies follow the amplitude", "all modes", "storms of equal wind, other sea"),
    "wind_speed_mps": ("frequencies follow the wind", "rotor", "blocks of equal state, other wind"),
}
# numbers of the environment that describe the block or the operation, not the environmental and operational conditions
NOT_CONDITIONS = ("nacelle_", "block_", "power_kw", "pitch_deg", "rotor_speed", "wave_period", "wind_direction",
                  "yaw_", "n_", "sampling_")


def moved_frequencies(followed: ReferencedBlocks, column: int) -> tuple[dict, ...]:
    """Of every number of the frequencies, of their mean, and of the two single modes of which one moves most clearly
    against the other: its change for the profile's unit, with standard deviation and z."""
    blocks, d = followed.blocks, followed.directions
    rows, names = [], []
    for q, own in enumerate(followed.log_numbers):
        names += [blocks.group_name(q) + part for part in (("",) if len(own) == 1 else PARTS)]
        rows += list(np.eye(d.turn.shape[1])[own])
        if len(own) == 3:
            names.append(blocks.group_name(q))
            rows.append(0.5 * (rows[-3] + rows[-2]))
    single = [rows[names.index(blocks.group_name(q))] for q in range(len(blocks.groups))]
    if len(single) > 1:
        names.append("all modes")
        rows.append(_best_mean(followed, single, column))
    moved = [_moved_mode(name, *_change_along(followed, row, column)) for name, row in zip(names, rows, strict=True)]
    against = [_moved_mode(f"{blocks.group_name(b)} over {blocks.group_name(a)}",
                           *_change_along(followed, single[b] - single[a], column))
               for a, b in combinations(range(len(single)), 2)
               if len(blocks.groups[a]) == len(blocks.groups[b]) == 1]
    against = sorted((m for m in against if np.isfinite(m["std_percent"])), key=lambda m: -abs(m["z"]))
    return (*(m for m in moved if np.isfinite(m["std_percent"])), *against[:1])


def _change_along(followed: ReferencedBlocks, row: np.ndarray, column: int) -> tuple[float, float]:
    """Change of a sum of responses by their shares `row`, per unit of the profile, and its standard deviation."""
    share = followed.directions.back.T @ row
    amount, variance = followed.along.amounts
    used = np.abs(share) > 1e-12
    spread = float(np.sqrt(np.sum(share[used] ** 2 * variance[used, column])))
    return float(share[used] @ amount[used, column]) / followed.span[column], spread / followed.span[column]


def _best_mean(followed: ReferencedBlocks, rows: Sequence[np.ndarray], column: int) -> np.ndarray:
    """The mean of several by how well each is known."""
    std = np.array([_change_along(followed, row, column)[1] for row in rows])
    weight = np.where(np.isfinite(std), 1 / np.where(np.isfinite(std), std, 1.0) ** 2, 0.0)
    return np.array(rows).T @ (weight / max(weight.sum(), 1e-300))


def _moved_mode(mode: str, change: float, std: float) -> dict:
    return {"mode": mode, "change_percent": 100 * change, "std_percent": 100 * std,
            "z": change / std if 0 < std < np.inf else 0.0}


def _profile_probabilities(time_profiles: Sequence[TimeProfile], log_odds: np.ndarray) -> dict[str, float]:
    """How probable it is that what changes goes with a profile of each name, the most probable first."""
    probability, names = np.exp(log_odds - logsumexp(log_odds)), {}
    for time_profile, p in zip(time_profiles, probability, strict=True):
        names[time_profile.name] = names.get(time_profile.name, 0.0) + float(p)
    return dict(sorted(names.items(), key=lambda item: -item[1]))


def _cause(name: str) -> tuple[str, str, str]:
    """(cause, location, check) of what goes with a time profile of that name."""
    if name in ("step", "ramp"):
        return f"unexplained {name} of frequencies", "structure", "a model is needed to name it"
    return CAUSES.get(name, (f"frequencies follow {name}", "all modes", f"look at what {name} stands for"))


def _sharpen_step(followed: ReferencedBlocks, time_profile: TimeProfile, known: np.ndarray,
                  sensors: Sequence[Sensor]) -> TimeProfile:
    """The step near one of those tried that is the most probable: of a long record not all times are tried."""
    n = len(followed.blocks)
    if time_profile.kind != "step" or n - 2 * EDGE < STEPS:
        return time_profile
    reach = blocks_between_steps(n, STEPS)
    near = [step_profile(n, at) for at in range(max(EDGE, time_profile.at - reach), min(n - EDGE,
                                                                                        time_profile.at + reach) + 1)]
    finer = watch(followed.blocks, (), sensors, known, near)
    return near[int(np.argmax(finer.unknown().any_unknown))]


def _condition(
    followed: ReferencedBlocks, unknown: Unknown, odds: Odds, known: np.ndarray, sensors: Sequence[Sensor]
) -> Change:
    """What no effect of sensors explains: the column that it goes with, or since when it is there."""
    names = _profile_probabilities(followed.profiles, odds.unknown)
    name = next(iter(names))
    best = int(np.argmax(np.where([c.name == name for c in followed.profiles], odds.unknown, -np.inf)))
    time_profile = _sharpen_step(followed, followed.profiles[best], known, sensors)
    if unknown.frequencies[best] <= 0:
        return Change(finding=None, time_profile=time_profile, moved=())
    moved = moved_frequencies(followed, best)
    if time_profile.kind == "step" and time_profile.at != followed.profiles[best].at:
        moved = moved_frequencies(watch(followed.blocks, (), sensors, known, [time_profile]), 0)
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


def condition_columns(blocks: Blocks) -> tuple[str, ...]:
    """Columns of the environment that may move frequencies: the known ones, and a user's own."""
    names = dict.fromkeys(k for e in blocks.environment for k, v in e.items()
                          if isinstance(v, int | float) and not isinstance(v, bool))
    own = [n for n in names if n not in CAUSES and not n.startswith(NOT_CONDITIONS)]
    return (*(n for n in CAUSES if n in names), *own)


def diagnose_without_model(
    data: ModalData, sensors: Sequence[Sensor] | None = None, *, campaign_check: Sequence[Mapping] | None = None,
    effects: Sequence[Effect] = (), progress: Progress = silent,
) -> Diagnosis:
    """Measurement and environmental and operational conditions only: what modes.json shows of itself.

    `sensors`: where channels are; without them only gains along the record can be judged. `campaign_check`: findings in
    the raw records (see `campaign_tests.campaign_tests`), listed and counted. `effects`: a user's own of sensors.
    """
    data, as_one = join_modes(data)
    blocks = with_derived(gather(data))
    placed = tuple(s for s in sensors or () if s.channel in blocks.channels)
    of_sensors = measurement_effects(blocks.channels, placed, float(np.nanmax(blocks.frequency_hz)))
    rows = tuple(e for e in (*of_sensors, *effects)
                 if e.observe is not None and not e.discrete and set(e.time_profiles) != {"constant"})
    whole = tuple(e for e in of_sensors if e.discrete)
    # what moves as one body is a matter of places, whatever these are called
    placed = name_levels(placed)
    columns = (*condition_columns(blocks), *(c for e in effects for c in e.time_profiles))
    time_profiles = [c for c in make_time_profiles(blocks, tuple(dict.fromkeys(columns)), STEPS)
                     if c.kind != "constant"]
    if not time_profiles:
        raise _too_few_blocks_error(blocks)
    # what changes along the record and constant shapes share the false alarms
    share = NOTHING / (2 if placed else 1)
    changes, blocks, followed, total, left = _remove_changes(
        blocks, time_profiles, rows, whole, placed, share, progress)
    unexplained = [c for c in changes if c.finding is None]
    answer, detectable_sizes = (_steady_shapes(blocks, placed, (*rows, *whole), share, unexplained) if placed else
                                (None, []))
    findings = [c.finding for c in changes if c.finding is not None and not c.within_tolerance]
    detectable_sizes = [*_detectable_sizes(followed, share), *detectable_sizes]
    # by Markov's inequality: steps and drifts, and columns where any is stated, are each as probable before as nothing
    log_prior = float(logsumexp(log_prior_of_profiles(time_profiles)))
    p_value, notes = min(1.0, float(np.exp(log_prior - total)) * NOTHING / share), [*as_one, *blocks.notes]
    if answer is not None:
        findings += answer.findings
        p_value = min(p_value, 2 * float(np.exp(-max(answer.log_odds, 0.0))))
    verdict = "unexplained" if unexplained or left else verdict_of(findings)
    details = {"without_model": True, "changes": [_change_table(blocks, c) for c in unexplained],
               "constant_shapes_unexplained": answer is not None and answer.unexplained,
               "measurement": [dict(m) for m in campaign_check or ()]}
    notes += [f"{f.cause}, {f.location} changes by {f.size:.2g} {f.unit} at {f.time_profile_start}: within its "
              "tolerance, taken out" for c in changes if c.within_tolerance and (f := c.finding) is not None]
    notes += _notes(blocks, placed, unexplained, answer)
    return Diagnosis(
        verdict=verdict, p_value=p_value, findings=tuple(findings), detectable_sizes=tuple(detectable_sizes),
        threshold=float(np.min(_threshold(followed, share))), adequacy_p=float("nan"), notes=tuple(notes),
        parameters=(),
        splits=tuple(f.check for f in findings if f.posterior_probability < SURE), details=details,
    )


def _too_few_blocks_error(blocks: Blocks) -> InputError:
    shown = "1 set is" if len(blocks) == 1 else f"{len(blocks)} sets are"
    return InputError("modes", f"{shown} too few to tell a change from chance: without a model sets are compared with "
                      "one another alone",
                      "give more sets (ten and more), or a model of the structure (--model)")


def _remove_changes(
    blocks: Blocks, time_profiles: Sequence[TimeProfile], rows: Sequence[Effect], whole: Sequence[Effect],
    placed: Sequence[Sensor], share: float, progress: Progress,
) -> tuple[list[Change], Blocks, ReferencedBlocks, float, bool]:
    """What changes along the record, one after the other, and the blocks without what sensors were found to do; what
    the first look followed and its ln odds over nothing, and whether the last one still found something."""
    known = np.zeros((len(blocks), 0))
    catalogue = (*rows, *whole)
    prior = dict(zip((p.kind for p in time_profiles), log_prior_of_profiles(time_profiles) - np.log(2), strict=True))
    changes: list[Change] = []
    first: tuple[ReferencedBlocks, float] | None = None
    for number in range(MOST_CHANGES + 1):
        progress("diagnosing", number, MOST_CHANGES + 1)
        followed = watch(blocks, rows, placed, known, time_profiles)
        unknown = followed.unknown()
        odds = odds_of(followed, unknown)
        # after a change as beside a model's findings: the searches that follow have half of the false alarms
        found = odds.total > -np.log(share * NEXT_SHARE if number else share)
        first = first or (followed, odds.total)
        # shapes may still say what is wrong with sensors all through the record, if it is known where they are
        if not number and not (placed or followed.along.usable.any()):
            raise _too_few_blocks_error(blocks)
        if number == MOST_CHANGES or not found:
            break
        step = _step(followed, odds, known, placed)
        of_sensors = None if step is None else changes_of_sensors(blocks, known, placed, catalogue, step,
                                                                prior[step.kind])
        if of_sensors is None and float(logsumexp(odds.unknown)) < 0:
            # nothing but what chance would make as well
            found = False
            break
        if of_sensors is not None:
            changes += of_sensors[0]
            blocks = of_sensors[1]
        else:
            changes.append(_condition(followed, unknown, odds, known, placed))
            known = np.column_stack([known, changes[-1].time_profile.value])
    progress("diagnosing", MOST_CHANGES + 1, MOST_CHANGES + 1)
    return changes, blocks, *first, bool(found)


def _step(
    followed: ReferencedBlocks, odds: Odds, known: np.ndarray, sensors: Sequence[Sensor]
) -> TimeProfile | None:
    """The step along which effects of sensors are looked for: the most probable profile, if it is one and there are
    sensors."""
    if odds.weighed is None:
        return None
    every = odds.unknown.copy()
    for (_, h), own in zip(odds.weighed.rows, odds.of_sensors, strict=True):
        every[h] = np.logaddexp(every[h], own)
    best = followed.profiles[int(np.argmax(every))]
    return _sharpen_step(followed, best, known, sensors) if best.kind == "step" else None


def _steady_shapes(
    blocks: Blocks, placed: Sequence[Sensor], rows: Sequence[Effect], share: float, unexplained: Sequence[Change]
) -> tuple[LevelAnswer, list[DetectableSize]]:
    """Of the shapes before anything changed that has no cause: a mean of two states is neither's. With the minimum
    detectable sizes in them."""
    begun = np.max([c.time_profile.value != 0 for c in unexplained], axis=0).astype(float) if unexplained else None
    begun = None if begun is None or np.sum(begun == 0) < FEWEST_BEFORE else begun
    # a shift of all frequencies, or a turn of all sensors, is not a constant that shapes alone could show
    able = [e for e in rows if e.cause not in ("sampling rate", "rotated sensor frame")]
    levels = level_reference(look(blocks, placed, begun).mean, blocks.channels, placed, able)
    answer = judge_levels(levels, able, share)
    return answer, [
        _limit_to_bounds(DetectableSize(kind=e.kind, cause=e.cause, location=e.location, time_profile="constant",
                                      unit=e.unit, size=(t.needed + POWER) * t.size_std, share_left=t.share_left,
                                      z=t.z), e) for e, t in answer.tested]


def _change_table(blocks: Blocks, change: Change) -> dict:
    start = blocks.ids[change.time_profile.at] if change.time_profile.kind == "step" else ""
    return {"time_profile": change.time_profile.name, "since": start, "frequencies": [dict(m) for m in change.moved],
            "what": "frequencies" if change.moved else "shapes"}


def _notes(blocks: Blocks, placed: Sequence[Sensor], unexplained: Sequence[Change],
           answer: LevelAnswer | None) -> list[str]:
    notes = ["without a model: structural causes are not identified, constant ones are not detected"]
    if not placed:
        notes.append("without the sensors' places: levels, loggers and directions are not judged, and what a sensor "
                     "did wrong all along (a gain, a sign, exchanged cables) is not seen")
    for change in unexplained:
        when = f" from {blocks.ids[change.time_profile.at]} on" if change.time_profile.kind == "step" else ""
        moved = [m for m in change.moved if abs(m["z"]) > 3]
        what = ", ".join(f"{m['mode']} by {m['change_percent']:+.2g} +- {m['std_percent']:.1g} %" for m in moved)
        notes.append(f"unexplained {change.time_profile.name}{when}: {what or 'shapes change, frequencies do not'}; no "
                     "environmental or operational condition correlates with it, and a model is needed to identify "
                     "it")
    for f in () if answer is None else answer.findings:
        if f.cause == OWN_RESPONSE:
            _, response = f.key
            notes.append(f"{f.location} shows the modes with {response.words()}")
    if answer is not None and answer.unexplained:
        notes.append("the levels' constant motion is not that of a rigid, symmetric structure, and no one sensor "
                     "explains it: a model is needed to say what does")
    return notes


def _threshold(followed: ReferencedBlocks, share: float) -> np.ndarray:
    """(n_profile,) |z| at which one number alone would be found: where Student's t outweighs the prior odds and the
    width of the amount's prior."""
    names = [p.name for p in followed.profiles]
    wanted = np.log([names.count(name) * len(set(names)) / share for name in names])
    degrees = float(np.max(followed.along.degrees))
    needed = wanted + np.log(4) + 0.5 * np.log1p(followed.along.a[0].max(axis=0))
    return np.sqrt(degrees * np.expm1(2 * needed / degrees))


def _detectable_sizes(followed: ReferencedBlocks, share: float) -> tuple[DetectableSize, ...]:
    """The least change of every frequency, and size of every sensor's effect, that would be found along each time
    profile."""
    needed = _threshold(followed, share) + POWER
    result: list[DetectableSize] = []

    def add(z: float, column: int, std: float, **words) -> None:
        result.append(DetectableSize(time_profile=followed.profiles[column].name, share_left=1.0, z=z,
                                     size=float(needed[column] * std), **words))

    # of the times of a step the one that shows the most
    _, variance = followed.along.amounts
    known = np.sum(1 / variance, axis=0)
    names = [p.name for p in followed.profiles]
    best = [max((k for k, n in enumerate(names) if n == name), key=lambda k: known[k]) for name in dict.fromkeys(names)]
    size, std = sizes(followed.along, followed.signature)
    for column in best:
        profile = followed.profiles[column]
        kind, cause = ("structural", f"{profile.name} of frequency") if profile.name in ("step", "ramp") else (
            "environmental", _cause(profile.name)[0])
        for m in moved_frequencies(followed, column):
            if " over " not in m["mode"]:
                add(m["z"], column, m["std_percent"], kind=kind, cause=cause, location=m["mode"],
                    unit=f"% of frequency{profile.unit}")
        for e, effect in enumerate(followed.effects):
            if profile.name in effect.time_profiles and np.isfinite(std[e, column]):
                add(float(size[e, column] / std[e, column]), column, float(std[e, column] / followed.span[column]),
                    kind=effect.kind, cause=effect.cause, location=effect.location, unit=effect.unit + profile.unit)
    bounds = {(e.cause, e.location): e for e in followed.effects}
    return tuple(x if (effect := bounds.get((x.cause, x.location))) is None else _limit_to_bounds(x, effect)
                 for x in result)


def _limit_to_bounds(x: DetectableSize, effect: Effect) -> DetectableSize:
    size = max(x.size, effect.tolerance)
    return replace(x, size=size if size <= max(-effect.lower, effect.upper) else np.inf)
