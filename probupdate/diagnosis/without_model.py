"""A diagnosis by the data alone: what changes along the record, what follows the environmental and operational
conditions, which sensor is off.

Structural causes cannot be named without a model: a change of frequencies that no column of the environmental and
operational conditions explains is *unexplained*, with the modes that moved, by how much and since when. """

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import logsumexp

from probupdate.campaign.rigid_bodies import levelled
from probupdate.diagnosis.blocks import Blocks, gather, with_derived
from probupdate.diagnosis.diagnose import CHANCE, POWER, SURE, verdict_of
from probupdate.diagnosis.empirical_reference import look, residuals
from probupdate.diagnosis.empirical_search import (
    ALL,
    DIRECTION,
    FALSE_ALARM,
    Followed,
    Found,
    Scores,
    allowed_profiles,
    log_change_along,
    log_change_of_structure,
    make_contrasts,
    score,
    search,
    watch,
)
from probupdate.diagnosis.level_responses import OWN_RESPONSE
from probupdate.diagnosis.level_shapes import judge_levels, mean_shapes
from probupdate.diagnosis.results import Alternative, DetectableSize, Diagnosis, Finding
from probupdate.diagnosis.search import FALSE_ALARM as MODEL_FALSE_ALARM
from probupdate.diagnosis.search import FALSE_NEXT
from probupdate.diagnosis.sensor_changes import Change, changes_of_sensors
from probupdate.diagnosis.time_profiles import (
    EDGE,
    TimeProfile,
    between_steps,
    make_time_profiles,
    step_profile,
)
from probupdate.effects.catalogue import Effect, measurement_effects
from probupdate.errors import InputError
from probupdate.modal.joined_modes import join_modes
from probupdate.modal.modes import ModalData, Sensor
from probupdate.runtime.progress import Progress, silent

# false alarms of a search that follows a change, over the first one's, as with a model
NEXT_SHARE = FALSE_NEXT / MODEL_FALSE_ALARM
# times of a step that are tried: between two of them a step of thirty standard deviations would look like slow scatter
STEPS = 48
# blocks before a change of which shapes are a mean
FEWEST_BEFORE = 4
# changes taken out one after the other
MOST_CHANGES = 6
# what competes with constant effects of sensors
ODD = "structure less symmetric or less rigid than is normal"
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


def moved_frequencies(followed: Followed, scores: Scores, column: int) -> tuple[dict, ...]:
    """Per number of the frequencies, and for the two of which one moves most clearly against the other: its change for
    the time profile's unit, with standard deviation and z."""
    blocks = followed.blocks
    rows = []
    for k, (q, i) in enumerate(followed.names[: followed.along_directions.start]):
        rows.append(_moved(series_name(blocks, q, i), scores.size[k, column], scores.size_std[k, column]))
    return (*(r for r in rows if np.isfinite(r["std_percent"])), *_moved_against(followed, scores, column))


def _moved(mode: str, change: float, std: float) -> dict:
    return {"mode": mode, "change_percent": 100 * float(change), "std_percent": 100 * float(std),
            "z": float(change / std) if 0 < std < np.inf else 0.0}


def _moved_against(followed: Followed, scores: Scores, column: int) -> tuple[dict, ...]:
    """The ratio of two single modes' frequencies that changes most clearly, where all directions show it: what both do
    alike is not in it."""
    if not followed.directions.joint:
        return ()
    at, turn = followed.along_directions, followed.directions.turn
    std = scores.size_std[at, column]
    single = [k for k, q in enumerate(followed.directions.group_of) if len(followed.blocks.groups[q]) == 1]
    # of each pair the contributions (n_pair, n_direction) of the directions to the logarithm of the ratio
    pairs = list(combinations(single, 2))
    against = np.array([turn[:, b] - turn[:, a] for a, b in pairs]).reshape(len(pairs), len(turn))
    pairs = [p for p, row in zip(pairs, against, strict=True) if np.all(np.isfinite(std[np.abs(row) > 0]))]
    if not pairs:
        return ()
    against = np.array([turn[:, b] - turn[:, a] for a, b in pairs])
    change, spread = against @ scores.size[at, column], np.sqrt(against**2 @ np.where(np.isfinite(std), std, 0.0) ** 2)
    best = int(np.argmax(np.abs(change) / np.maximum(spread, 1e-300)))
    a, b = (followed.blocks.group_name(int(followed.directions.group_of[k])) for k in pairs[best])
    return (_moved(f"{b} over {a}", change[best], spread[best]),)


def series_name(blocks: Blocks, q: int, i: int) -> str:
    """Modes whose frequency a series follows."""
    if q == ALL:
        return "all modes"
    return blocks.group_name(q) + ("" if len(blocks.groups[q]) == 1 else (" axis 1", " axis 2", " between", "")[i])


def profile_probability(followed: Followed, found: Found, time_profiles: Sequence[TimeProfile],
                        best: int) -> np.ndarray:
    """(n_profile,) how probable it is that the frequencies go with each time profile, all at the best one's scatter;
    the times of a step share one prior."""
    rows = list(range(followed.n_frequency))[followed.along_directions]
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
    empirical, sizes = followed.empirical, [len(g) for g in blocks.groups]
    return log_change_of_structure(residuals(empirical, known), followed.noise, empirical.nuisance(known),
                                   time_profiles, sizes) < np.log(2)


def _sharpened(followed: Followed, time_profile: TimeProfile, known: np.ndarray) -> TimeProfile:
    """The step near one of those tried at which a change of the structure is most probable: a long record is tried at
    every other block or fewer."""
    n, reach, empirical = len(followed.blocks), between_steps(len(followed.blocks)), followed.empirical
    near = [step_profile(n, at) for at in range(max(EDGE, time_profile.at - reach + 1),
                                                min(n - EDGE, time_profile.at + reach - 1) + 1)]
    along = log_change_along(residuals(empirical, known), followed.noise, empirical.nuisance(known), near,
                             [len(g) for g in followed.blocks.groups])
    return near[int(np.argmax(along))]


def _condition(
    followed: Followed, found: Found, time_profiles: Sequence[TimeProfile], known: np.ndarray
) -> Change:
    """What the frequencies go with."""
    rows = followed.classes[0]
    best = int(np.argmax(np.max(found.over[rows], axis=0)))
    probability = profile_probability(followed, found, time_profiles, int(best))
    names = _by_name(time_profiles, probability)
    name = next(iter(names))
    best = int(np.argmax(np.where([c.name == name for c in time_profiles], probability, -1)))
    time_profile, moved = time_profiles[best], moved_frequencies(followed, found.scores, best)
    if time_profile.kind == "step":
        time_profile = _sharpened(followed, time_profile, known)
        contrasts = make_contrasts(followed.weight, followed.empirical.nuisance(known), [time_profile],
                                   followed.blocks.hours)
        moved = moved_frequencies(followed, score(contrasts, followed.series, followed.pools), 0)
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
    effects: Sequence[Effect] = (), seed: int = 1, progress: Progress = silent,
) -> Diagnosis:
    """Measurement and environmental and operational conditions only: what modes.json shows of itself.

    `sensors`: where channels are; without them only gains along the record can be judged. `campaign_check`: findings in
    the raw records (see `campaign_tests.campaign_tests`), listed and counted. `effects`: a user's own of sensors.
    """
    data, as_one = join_modes(data)
    blocks = with_derived(gather(data))
    placed = tuple(s for s in sensors or () if s.channel in blocks.channels)
    rows = tuple(e for e in (*measurement_effects(blocks.channels, placed), *effects)
                 if e.observe is not None and not e.discrete and set(e.time_profiles) != {"constant"})
    whole = tuple(e for e in measurement_effects(blocks.channels, placed) if e.discrete)
    # what moves as one body is a matter of places, whatever these are called
    placed = levelled(placed)
    columns = (*condition_columns(blocks), *(c for e in effects for c in e.time_profiles))
    time_profiles = [c for c in make_time_profiles(blocks, tuple(dict.fromkeys(columns)), STEPS)
                     if c.kind != "constant"]
    if not time_profiles:
        raise _too_few(blocks)
    # frequencies, sensors along the record, and constant shapes share the false alarms
    share = FALSE_ALARM / (3 if placed else 2)
    changes, blocks, followed, found, left = _taken_out(blocks, time_profiles, rows, whole, placed, share, seed,
                                                        progress)
    unexplained = [c for c in changes if c.finding is None]
    steady = _steady(blocks, placed, rows, whole, share, seed, unexplained) if placed else None
    findings = [c.finding for c in changes if c.finding is not None and not c.within_tolerance]
    detectable_sizes = list(_detectable_sizes(followed, found, time_profiles))
    p_value, notes = found.p_value, [*as_one, *blocks.notes]
    if steady is not None:
        findings += steady.findings
        detectable_sizes += steady.detectable_sizes
        p_value = min(p_value, min(1.0, steady.p_value * FALSE_ALARM / share))
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
    shown = "1 set is" if len(blocks) == 1 else f"{len(blocks)} sets are"
    return InputError("modes", f"{shown} too few to tell a change from chance: without a model sets are compared with "
                      "one another alone",
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
        of_sensors = changes_of_sensors(blocks, followed, found, time_profiles, known, placed, rows, whole)
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
                change = _condition(followed, found, time_profiles, known)
            else:
                _, best = np.unravel_index(int(np.argmax(found.over)), found.over.shape)
                own = time_profiles[int(best)]
                own = _sharpened(followed, own, known) if own.kind == "step" else own
                change = Change(finding=None, time_profile=own, moved=())
            changes.append(change)
            known = np.column_stack([known, change.time_profile.value])
        followed, found = looked_at(number)
    progress("diagnosing", MOST_CHANGES + 1, MOST_CHANGES + 1)
    return changes, blocks, *first, bool(np.max(found.over) > 1)


@dataclass(frozen=True, eq=False, kw_only=True)
class Steady:
    """What constant shapes show: findings, minimum detectable sizes, p of the largest score, what is left over its
    threshold, notes."""

    findings: tuple[Finding, ...]
    detectable_sizes: tuple[DetectableSize, ...]
    p_value: float
    unexplained: float
    notes: tuple[str, ...]


def _steady(blocks: Blocks, placed, rows: Sequence[Effect], whole, false_alarm: float, seed: int,
            unexplained: Sequence[Change]) -> Steady:
    """Of the shapes before anything changed that has no cause: a mean of two states is neither's."""
    begun = np.max([c.time_profile.value != 0 for c in unexplained], axis=0).astype(float) if unexplained else None
    begun = None if begun is None or np.sum(begun == 0) < FEWEST_BEFORE else begun
    # a shift of all frequencies, or a turn of all sensors, is no constant that shapes alone could show
    able = [e for e in rows if e.cause not in ("sampling rate", "rotated sensor frame")]
    answer = judge_levels(mean_shapes(look(blocks, placed, begun).mean, blocks.channels, placed), able, whole,
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
                  unexplained=answer.unexplained,
                  notes=tuple(f"{r.effect.location} shows the modes with {r.effect.observe.words()}" for (r, *_), f in
                              zip(answer.found, findings, strict=True) if f.cause == OWN_RESPONSE))


def _change_table(blocks: Blocks, change: Change) -> dict:
    start = blocks.ids[change.time_profile.at] if change.time_profile.kind == "step" else ""
    return {"time_profile": change.time_profile.name, "since": start, "frequencies": [dict(m) for m in change.moved],
            "what": "frequencies" if change.moved else "shapes"}


def _notes(blocks: Blocks, placed: Sequence[Sensor], unexplained: Sequence[Change],
           steady: Steady | None) -> list[str]:
    notes = ["without a model: structural causes are not named, constant ones of the structure are not seen"]
    if not placed:
        notes.append("without the sensors' places: levels, loggers and directions are not judged, and what a sensor "
                     "did wrong all along (a gain, a sign, exchanged cables) is not seen")
    for change in unexplained:
        when = f" from {blocks.ids[change.time_profile.at]} on" if change.time_profile.kind == "step" else ""
        moved = [m for m in change.moved if abs(m["z"]) > 3]
        what = ", ".join(f"{m['mode']} by {m['change_percent']:+.2g} +- {m['std_percent']:.1g} %" for m in moved)
        notes.append(f"unexplained {change.time_profile.name}{when}: {what or 'shapes change, frequencies do not'}; no "
                     "environmental or operational condition goes with it, and a model would be needed to name "
                     "it")
    if steady is not None:
        notes += steady.notes
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
            if followed.names[k][0] == DIRECTION:
                continue
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
