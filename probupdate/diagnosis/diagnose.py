"""The whole diagnosis of a record: fit what is normal, test every effect, name what is beyond it, say what is not seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from probupdate.diagnosis.blocks import Blocks, gather
from probupdate.diagnosis.catalogue import Effect
from probupdate.diagnosis.courses import Course, make_courses
from probupdate.diagnosis.departures import n_response
from probupdate.diagnosis.field import build_field
from probupdate.diagnosis.fitting import Fit, Named, Setting, fit, local_std
from probupdate.diagnosis.prepare import Prepared
from probupdate.diagnosis.results import Alternative, Diagnosis, Finding, Limit
from probupdate.modes import ModalData
from probupdate.progress import Progress, silent

# false alarms of the whole search, and effects taken in one after the other
FALSE_ALARM, MOST_EFFECTS = 0.05, 3
# a limit is the size found in so many of a hundred records: normal quantile of 0.9
POWER = 1.2815515655446004
N_BOOTSTRAP = 400
# departures of a model of beams that nothing listed explains: ln f, its cross term in a pair, share of a shape's
# largest component, phase in rad
FLOOR_LOG, FLOOR_CROSS, FLOOR_SHAPE, FLOOR_PHASE = 3e-3, 2e-3, 1e-2, 1e-2


def settle(prepared: Prepared, data: ModalData) -> tuple[Setting, np.ndarray]:
    """The setting of a diagnosis and the parameters it starts from."""
    blocks = gather(data)
    theta = np.array(prepared.small.parameters.initial)
    field = build_field(prepared.small, blocks, theta)
    effects = tuple(e for e in prepared.effects if not e.discrete)
    courses = make_courses(with_derived(blocks), _columns(effects))
    which = _candidates(effects, courses)
    n_channel = len(blocks.channels)
    floor = tuple(_floor(len(g), n_channel) for g in blocks.groups)
    form = tuple(np.zeros((n_response(len(g), n_channel), 0)) for g in blocks.groups)
    return Setting(field=field, blocks=blocks, effects=effects, updated=prepared.updated, prior=prepared.prior,
                   courses=courses, which=which, form=form, floor=floor), theta  # fmt: skip


def with_derived(blocks: Blocks) -> Blocks:
    """Adds to every block's environment what follows from it: share of rated thrust, degrees of frost."""
    environment = []
    power = np.array([e.get("power_kw", np.nan) for e in blocks.environment], float)
    wind = np.array([e.get("wind_speed_mps", np.nan) for e in blocks.environment], float)
    with np.errstate(invalid="ignore", divide="ignore"):
        thrust = np.maximum(power, 0) / np.maximum(wind, 1.0)
    highest = np.nanmax(thrust) if np.isfinite(thrust).any() else np.nan
    for k, old in enumerate(blocks.environment):
        new = dict(old)
        if highest > 0 and np.isfinite(thrust[k]):
            new["thrust_share"] = float(thrust[k] / highest)
        air = old.get("air_temperature_c")
        if isinstance(air, int | float):
            new["frost_degc"] = max(0.0, -float(air))
        environment.append(new)
    return replace(blocks, environment=tuple(environment))


def _columns(effects: Sequence[Effect]) -> tuple[str, ...]:
    known = ("constant", "step", "ramp")
    return tuple(dict.fromkeys(c for e in effects for c in e.courses if c not in known))


def _candidates(effects: Sequence[Effect], courses: Sequence[Course]) -> np.ndarray:
    return np.array([(j, c) for j, e in enumerate(effects) for c, course in enumerate(courses)
                     if course.name in e.courses])  # fmt: skip


def _floor(k: int, n_channel: int) -> np.ndarray:
    logs = [FLOOR_LOG] if k == 1 else [FLOOR_LOG, FLOOR_LOG, FLOOR_CROSS]
    return np.array([*logs, *[FLOOR_SHAPE] * (k * n_channel), *[FLOOR_PHASE] * (k * n_channel)])


@dataclass(frozen=True, eq=False, kw_only=True)
class Search:
    """Scores of all candidates at a fit: z signed, the size that fits best and its deviation; `allowed` bool where that
    size lies on a side the effect can be on; threshold and p of the largest |z| by bootstrap."""

    z: np.ndarray
    size: np.ndarray
    size_std: np.ndarray
    allowed: np.ndarray
    usable: np.ndarray
    threshold: float
    p_value: float
    maxima: np.ndarray

    @property
    def statistic(self) -> np.ndarray:
        """|z| where the candidate can be what it says, else 0."""
        return np.where(self.allowed & self.usable, np.abs(self.z), 0.0)


def search(setting: Setting, fitted: Fit, *, seed: int, n_draw: int = N_BOOTSTRAP) -> Search:
    """Score every candidate at the fit and calibrate the largest."""
    design = fitted.design
    u, v = design.scores(fitted.centred), design.information
    usable = design.share_left > 1e-3
    std = np.where(usable, 1 / np.sqrt(np.where(usable, v, 1.0)), np.inf)
    z = np.where(usable, u * np.where(usable, std, 0.0), 0.0)
    lower = np.array([setting.effects[j].lower for j, _ in setting.which])
    upper = np.array([setting.effects[j].upper for j, _ in setting.which])
    constant = np.array([setting.courses[c].kind == "constant" for _, c in setting.which])
    # along the record an effect may begin or end: either sign, and a covariate's sense is not known beforehand
    both = ~constant
    can = lambda values: np.where(values > 0, both | (upper > 0), both | (lower < 0))  # noqa: E731
    rng = np.random.default_rng([seed, 21])
    drawn = design.draw(rng, n_draw) * np.where(usable, std, 0.0)
    maxima = np.max(np.where(can(drawn), np.abs(drawn), 0.0), axis=1)
    largest = float(np.max(np.where(can(z) & usable, np.abs(z), 0.0)))
    return Search(z=z, size=np.where(usable, u / np.where(usable, v, 1.0), 0.0), size_std=std, allowed=can(z),
                  usable=usable, threshold=float(np.quantile(maxima, 1 - FALSE_ALARM)),
                  p_value=tail(maxima, largest), maxima=maxima)  # fmt: skip


def tail(maxima: np.ndarray, value: float) -> float:
    """P(max >= value): the share of draws, or beyond them a Gumbel tail fitted to their upper half."""
    above = int(np.sum(maxima >= value))
    if above >= 10:
        return (above + 1) / (len(maxima) + 1)
    location, scale = stats.gumbel_r.fit(maxima)
    return float(stats.gumbel_r.sf(value, location, scale))


def diagnose(prepared: Prepared, data: ModalData, *, seed: int = 1, progress: Progress = silent) -> Diagnosis:
    """Find what the model gets wrong in these blocks."""
    setting, theta = settle(prepared, data)
    named: tuple[Named, ...] = ()
    findings: list[Finding] = []
    first: Search | None = None
    for number in range(MOST_EFFECTS + 1):
        progress("diagnosing", number, MOST_EFFECTS + 1)
        fitted = fit(setting, theta, named)
        found = search(setting, fitted, seed=seed)
        first = first or found
        best = int(np.argmax(found.statistic))
        if found.statistic[best] <= found.threshold or number == MOST_EFFECTS:
            break
        effect, course = (setting.effects[setting.which[best, 0]], setting.courses[setting.which[best, 1]])
        findings.append(_finding(setting, fitted, found, best))
        size = float(np.clip(found.size[best], effect.lower, effect.upper))
        named = (*fitted.named, Named(effect=effect, course=course, size=size))
        theta = fitted.theta
    progress("diagnosing", MOST_EFFECTS + 1, MOST_EFFECTS + 1)
    verdict = "none" if not findings else "ambiguous" if any(f.alternatives for f in findings) else "named"
    return Diagnosis(
        verdict=verdict, p_value=first.p_value, findings=tuple(findings), limits=_limits(setting, first, fitted),
        threshold=first.threshold, adequacy_p=1.0, notes=setting.blocks.notes,
        parameters=tuple(_parameters(setting, fitted)),
    )  # fmt: skip


def _finding(setting: Setting, fitted: Fit, found: Search, best: int) -> Finding:
    effect, course = setting.effects[setting.which[best, 0]], setting.courses[setting.which[best, 1]]
    rivals = np.argsort(-found.statistic)[:40]
    likeness = fitted.design.likeness(rivals)[list(rivals).index(best)]
    seen, alternatives = {effect.name}, []
    for k, r in zip(rivals, likeness, strict=True):
        other = setting.effects[setting.which[k, 0]]
        if abs(r) > 0.95 and other.name not in seen and found.statistic[k] > 0:
            seen.add(other.name)
            alternatives.append(Alternative(cause=other.cause, location=other.location, posterior_probability=np.nan))
    start = setting.blocks.ids[course.at] if course.kind == "step" else ""
    return Finding(
        kind=effect.kind, cause=effect.cause, location=effect.location, size=float(found.size[best]),
        size_std=float(found.size_std[best]), unit=effect.unit + course.unit, course=course.name, course_start=start,
        z=float(found.z[best]), posterior_probability=np.nan, alternatives=tuple(alternatives), check=effect.check,
    )  # fmt: skip


def _limits(setting: Setting, found: Search, fitted: Fit) -> tuple[Limit, ...]:
    best: dict[tuple[int, str], int] = {}
    for k, (j, c) in enumerate(setting.which):
        key = (int(j), setting.courses[c].name)
        if key not in best or found.size_std[k] < found.size_std[best[key]]:
            best[key] = k
    limits = []
    left = fitted.design.share_left
    for (j, name), k in best.items():
        effect = setting.effects[j]
        size = (found.threshold + POWER) * found.size_std[k]
        reachable = size <= max(-effect.lower, effect.upper)
        limits.append(Limit(kind=effect.kind, cause=effect.cause, location=effect.location, course=name,
                            limit=float(size) if reachable else np.inf,
                            unit=effect.unit + setting.courses[setting.which[k, 1]].unit, share_left=float(left[k]),
                            z=float(found.z[k])))  # fmt: skip
    return tuple(limits)


def _parameters(setting: Setting, fitted: Fit):
    solved = fitted.design.unknowns_cov(range(len(setting.updated)))
    for i, k in enumerate(setting.updated):
        p = setting.prior.items[i]
        std = local_std(setting.prior, i, fitted.theta[k])
        yield {"name": p.name, "value": fitted.theta[k], "std": float(np.sqrt(solved[i, i])), "prior": p.initial,
               "prior_std": p.std, "pushed": float((fitted.theta[k] - p.initial) / std)}  # fmt: skip
