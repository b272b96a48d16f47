"""Which blocks an update may trust: the criteria of the paper's Table 1, and the most consistent of those that pass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd

from probupdate.campaign.scada import StateRule, block_conditions, renaming, with_rated_power
from probupdate.errors import InputError
from probupdate.identification.criteria import (
    SelectionCriteria,
    condition_tests,
    failed_criteria,
    pair_angle_deg,
    perpendicular_pairs,
    required_modes,
)
from probupdate.io.files import write_table
from probupdate.io.result_table import with_units
from probupdate.modal.conditions import COLUMNS, KNOWN_COLUMNS, SIMILAR, find_misnamed, of_turbine
from probupdate.modal.labels import TURBINE, family, is_bending
from probupdate.modal.modes import ModalData, ModalSet, plane_mac, write_modes
from probupdate.modal.rounding import UNIFORM, robust_std, rounding_std, rounding_step, rounding_steps

PAPER_COV = {"FA1": 0.015, "SS1": 0.015, "FA2": 0.017, "SS2": 0.017}
# where the standard deviations that a kept set carries come from
CAMPAIGN, OWN = "campaign", "identification"
# share of selections in which a set is unlike the others by chance
FALSE_ODD = 1e-3


def sets_between(data: ModalData, since: str | None = None, before: str | None = None) -> ModalData:
    """The sets that begin at `since` (UTC, ISO 8601) or later and before `before`. Raises InputError where the sets are
    not named by times, a limit is no time, or none is left."""
    limits = {}
    for name, text in (("since", since), ("before", before)):
        if text is not None:
            try:
                limits[name] = pd.to_datetime(text, utc=True, format="ISO8601")
            except (ValueError, TypeError):
                raise InputError(f"--{name}", f"'{text}' is not a time", "write it as 2025-11-03T12:00Z, UTC") from None
    if not limits:
        return data
    try:
        time = pd.to_datetime([s.id for s in data.sets], utc=True, format="ISO8601")
    except (ValueError, TypeError):
        raise InputError("--since, --before", f"sets such as {data.sets[0].id} are not named by times",
                         "name sets by their start in UTC, ISO 8601") from None
    kept = tuple(s for s, t in zip(data.sets, time, strict=True)
                 if t >= limits.get("since", t) and ("before" not in limits or t < limits["before"]))
    if not kept:
        raise InputError("--since, --before", f"no set is left of those from {time.min()} to {time.max()}",
                         "choose times within these")
    reference = data.reference_set if any(s.id == data.reference_set for s in kept) else None
    return replace(data, sets=kept, reference_set=reference)


@dataclass(frozen=True, eq=False, kw_only=True)
class Selection:
    """data: the chosen sets in the order of time, `reference_set` the most consistent.

    table: a row a block with id, state, criterion (the first it failed, empty where it passed), failed (all of them),
    score (NaN where it did not pass), selected, angle_..._deg. scatter: a row a mode and state ('all', 'passed' and
    each state): n, mean_hz, cov, own_cov (root mean square of the standard deviations that identification states,
    relative), paper_cov. cov: the same as mode -> state -> CoV. notes: what SCADA lacked.
    """

    data: ModalData
    table: pd.DataFrame
    scatter: pd.DataFrame
    criteria: SelectionCriteria
    std_from: str
    notes: tuple[str, ...]
    summary: str

    @property
    def cov(self) -> dict[str, dict[str, float]]:
        return {mode: dict(zip(rows["state"], rows["cov"], strict=True))
                for mode, rows in self.scatter.groupby("mode", sort=False)}

    def to_frame(self) -> pd.DataFrame:
        """`table`: a row a block."""
        return with_units(self.table)

    def write(self, out: str | Path) -> list[Path]:
        """nine.json, and selection.csv and selection.cov.csv beside it, as a report finds them; a selection of another
        name has that before its tables', so that two in one folder do not take one another's place."""
        out = Path(out)
        own = "" if out.name == "nine.json" else f"{out.stem}."
        table, scatter = out.with_name(f"{own}selection.csv"), out.with_name(f"{own}selection.cov.csv")
        written = write_modes(self.data, out)
        write_table(table, self.table)
        write_table(scatter, self.scatter)
        return [*written, table, scatter]


def select(
    data: ModalData,
    scada: pd.DataFrame | None = None,
    *,
    criteria: SelectionCriteria | None = None,
    count: int = 9,
    state_rule: StateRule | None = None,
    std_from: str = CAMPAIGN,
) -> Selection:
    """Keep the `count` most consistent of the blocks that pass every criterion; fewer where fewer pass.

    With `scada` the conditions of each block are gathered again, else those kept in the sets are used. What a
    criterion needs and does not find is said, and that criterion is then not asked.

    std_from: what the kept sets carry and `--weights measured` takes. "campaign", as the paper: frequency_std_hz is
    the CoV of the mode over all blocks in which it was identified, every state together, times the set's frequency;
    damping_ratio_std the scatter over the same blocks; shape_std the scatter over the blocks that pass, pairs turned
    onto each other. It holds what changes between half hours too. "identification": what each set came with, the
    noise within its own half hour. Both are kept: what a set came with stays in its environment, as
    own_std_hz_<mode>, and its `covariance_factors` are untouched. Raises InputError where no block passes.
    """
    criteria = criteria or SelectionCriteria()
    if count < 1:
        raise InputError("count", f"{count} sets cannot be selected", "give at least 1")
    if std_from not in (CAMPAIGN, OWN):
        raise InputError("selection", f"'{std_from}' is not a source of standard deviations",
                         f"choose {CAMPAIGN} or {OWN}")
    labels = data.labels or tuple(str(j + 1) for j in range(data.n_mode))
    required = required_modes(data.labels, data.n_mode, criteria, data.sets)
    sets = data.sets if scada is None else _with_conditions(data.sets, scada, state_rule or StateRule())
    tests, notes = condition_tests(sets, criteria)
    families = {family(t) for t in labels}
    # named as what has no nacelle; modes by number may be a turbine's
    if families - {""} and families.isdisjoint(TURBINE[:2]) and not any(of_turbine(s.environment) for s in sets):
        notes = []
    if scada is not None:
        notes += [f"SCADA has no {known}{renaming(given)}"
                  for known, given in find_misnamed(scada.columns, SIMILAR).items()]
    bending = any(map(is_bending, labels))
    seldom = [label for j, label in enumerate(labels) if j not in required and (is_bending(label) or not bending)]
    if criteria.required is None and seldom:
        notes.append(f"modes not required, as fewer than {100 * criteria.required_share:g} % of the blocks have them: "
                     f"{', '.join(seldom)}")
    notes += _rounding_notes(sets, labels)
    pairs = perpendicular_pairs(data.labels)
    failed = [failed_criteria(s, tests, required, pairs, criteria) for s in sets]
    passed = np.array([not names for names in failed])
    if not passed.any():
        raise _no_set_error(failed)
    good = [s for s, p in zip(sets, passed, strict=True) if p]
    score, odd = np.full(len(sets), np.nan), np.zeros(len(sets), bool)
    score[passed] = inconsistency(good, required, pairs)
    odd[passed] = outlying_sets(good, required)
    kept = passed & ~odd
    order = np.argsort(np.where(kept, score, np.inf), kind="stable")[: min(count, int(kept.sum()))]
    notes += _odd_notes(sets, odd, kept, required, labels)
    wrong = wrong_values(sets)
    notes += _wrong_notes(sets, wrong, labels)
    scatter = _scatter(labels, sets, passed, odd, wrong)
    chosen = [_with_own_std(sets[k], labels) for k in sorted(order)]
    if std_from == CAMPAIGN:
        overall = scatter[scatter["state"] == "all"]["cov"].to_numpy()
        good = [s for s, k in zip(sets, kept, strict=True) if k]
        damping = np.where(wrong | odd[:, None], np.nan, [s.damping_ratio for s in sets])
        chosen = _with_campaign_scatter(chosen, damping, good, overall, pairs)
    else:
        chosen = _with_rounding(chosen, sets)
    result = replace(data, sets=tuple(chosen), reference_set=sets[order[0]].id)
    table = _table(sets, failed, score, order, labels, pairs)
    return Selection(data=result, table=table, scatter=scatter, criteria=criteria, std_from=std_from,
                     notes=tuple(notes),
                     summary=_summary(result, table, scatter, count, std_from, notes, int(odd.sum())))


def _rounding_notes(sets: Sequence[ModalSet], labels: Sequence[str], share: float = 0.1) -> list[str]:
    """Of the modes whose rounding is this share of their scatter at least."""
    steps: dict[float, list[str]] = {}
    frequency = np.array([s.frequency_hz for s in sets])
    for label, values, step in zip(labels, frequency.T, rounding_steps(frequency), strict=True):
        if step > 0 and UNIFORM * step >= share * np.nanstd(values):
            steps.setdefault(float(f"{step:.4g}"), []).append(label)
    return [f"frequencies of {', '.join(some)} are rounded to {step:g} Hz: {UNIFORM * step:.2g} Hz is counted as the "
            "standard deviation of that" for step, some in steps.items()]


def _odd_notes(
    sets: Sequence[ModalSet], odd: np.ndarray, kept: np.ndarray, required: list[int], labels: Sequence[str],
    most: int = 5,
) -> list[str]:
    frequency = np.array([s.frequency_hz for s in sets])
    middle = np.median(frequency[kept], axis=0)
    said = []
    for k in np.flatnonzero(odd)[:most]:
        j = max(required, key=lambda j: abs(np.log(frequency[k, j] / middle[j])))
        said.append(f"not kept, as unlike the others: {sets[k].id}, {labels[j]} at {frequency[k, j]:.4g} Hz (median of "
                    f"the others {middle[j]:.4g} Hz)")
    return said + [f"and {int(odd.sum()) - most} more"] * bool(odd.sum() > most)


def _no_set_error(failed: Sequence[Sequence[str]]) -> InputError:
    counts = pd.Series([names[0] for names in failed]).value_counts()
    text = ", ".join(f"{n} {name}" for name, n in counts.items())
    return InputError("selection", f"none of {len(failed)} blocks passes ({text})",
                      "relax a criterion, or use a longer campaign")


def _table(
    sets: Sequence[ModalSet], failed: Sequence[Sequence[str]], score: np.ndarray, order: np.ndarray,
    labels: Sequence[str], pairs: Sequence[tuple[int, int]],
) -> pd.DataFrame:
    """A row a block: what it failed, its score (NaN where it failed), and the angles of its pairs; order: those
    kept."""
    table = pd.DataFrame({
        "id": [s.id for s in sets], "state": [str(s.environment.get("state", "unknown")) for s in sets],
        "criterion": [names[0] if names else "" for names in failed], "failed": ["; ".join(names) for names in failed],
        "score": score, "selected": np.isin(np.arange(len(sets)), order),
    })
    for i, j in pairs:
        table[f"angle_{labels[i]}_{labels[j]}_deg"] = [pair_angle_deg(s, i, j) for s in sets]
    return table


def _with_own_std(s: ModalSet, labels: tuple[str, ...]) -> ModalSet:
    """The set with the standard deviations it came with in its environment, where it came with any."""
    own = {f"own_std_hz_{label}": float(std) for label, std in zip(labels, s.frequency_std_hz, strict=True)
           if np.isfinite(std)}
    return replace(s, environment=dict(s.environment) | own)


def _with_rounding(chosen: Sequence[ModalSet], sets: Sequence[ModalSet]) -> list[ModalSet]:
    """What a set states of its frequencies, and their rounding beside it."""
    rounding = UNIFORM * rounding_steps(np.array([s.frequency_hz for s in sets]))
    return [replace(s, frequency_std_hz=np.hypot(s.frequency_std_hz, rounding)) for s in chosen]


def _with_campaign_scatter(chosen, damping: np.ndarray, good, cov: np.ndarray, pairs) -> list[ModalSet]:
    """Frequency, damping and shapes with the scatter over the campaign; where it cannot be estimated (one block alone),
    what a set came with stays. damping (n_set, n_mode): of the campaign."""
    spread = column_scatter(damping)
    shape = shape_scatter(good, pairs)
    return [replace(
        s, frequency_std_hz=np.where(np.isfinite(cov), cov * s.frequency_hz, s.frequency_std_hz),
        damping_ratio_std=np.where(np.isfinite(spread), spread, s.damping_ratio_std),
        shape_std=np.where(np.isfinite(shape) & np.isfinite(s.shape), shape, s.shape_std),
    ) for s in chosen]


def shape_scatter(sets: list[ModalSet], pairs: list[tuple[int, int]], least: int = 5) -> np.ndarray:
    """(n_channel, n_mode) standard deviation of each component over the sets, largest component 1; NaN from fewer than
    `least`.

    Each set's shape is first brought onto the mean of all: a single mode by a factor, a pair by the combination within
    its plane that comes closest, as only the plane is identified by the data.
    """
    n_channel, n_mode = sets[0].shape.shape
    found = np.full((n_channel, n_mode), np.nan)
    paired = {j for pair in pairs for j in pair}
    for group in [*pairs, *((j,) for j in range(n_mode) if j not in paired)]:
        columns = [np.real(s.shape[:, list(group)]) for s in sets if s.measured[list(group)].all()]
        if len(columns) < least or not n_channel:
            continue
        rows = np.all([np.isfinite(c).all(axis=1) for c in columns], axis=0)
        if not rows.any():
            continue
        middle = columns[0][rows]
        for _ in range(5):  # each is brought onto the mean, the mean is taken again
            onto = [c[rows] @ np.linalg.lstsq(c[rows], middle, rcond=None)[0] for c in columns]
            middle = np.mean(onto, axis=0)
            middle = middle / np.abs(middle).max(axis=0)
        onto = [c[rows] @ np.linalg.lstsq(c[rows], middle, rcond=None)[0] for c in columns]
        # as they are printed, shapes may be the same in most sets
        rounding = UNIFORM * rounding_step(np.ravel(columns))
        scatter = np.maximum(np.std(onto, axis=0, ddof=1), rounding / np.median(np.abs(columns).max(axis=1), axis=0))
        found[np.ix_(rows, list(group))] = np.where(scatter > 1e-12, scatter, np.nan)
    return found


def _with_conditions(sets, scada: pd.DataFrame, rule: StateRule) -> tuple[ModalSet, ...]:
    """The sets with what this table says of their blocks, and nothing that another one said."""
    if not set(KNOWN_COLUMNS) & set(scada.columns):
        raise InputError(scada.attrs.get("path", "SCADA"),
                         f"has none of SCADA's columns, but {', '.join(map(str, scada.columns[:4]))}",
                         f"name them {', '.join(COLUMNS[:4])} and so on (docs/formats/campaign.md)")
    rule = with_rated_power(rule, scada)
    result = []
    for s in sets:
        try:
            start = pd.Timestamp(s.id)
            minutes = float(s.environment["block_minutes"])
        except (ValueError, KeyError, TypeError):
            raise InputError(f"set {s.id}", "its id is not a time, or its environment has no block_minutes, so SCADA "
                             "cannot be joined", "leave --scada out, or name sets by their start in UTC") from None
        start = start.tz_localize("UTC") if start.tzinfo is None else start
        kept = {key: value for key, value in s.environment.items() if not key.startswith(COLUMNS)}
        result.append(replace(s, environment={**kept, **block_conditions(scada, start, minutes, rule)}))
    return tuple(result)


def inconsistency(sets: list[ModalSet], required: list[int], pairs: list[tuple[int, int]]) -> np.ndarray:
    """(n_set,) distance of each set from the middle of them all, in robust standard deviations; small is consistent.

    Root mean square, over the required modes, of (f - median) / scale and, over pairs, of the angle between the set's
    plane and the mean plane over its scale. Scales are 1.4826 median absolute deviations, the standard deviation of
    rounding at least: of the numbers that a report prints to 0.01 Hz half are often the same one.
    """
    frequency = np.array([s.frequency_hz[required] for s in sets])
    residual = frequency - np.median(frequency, axis=0)
    terms = [residual / robust_std(residual, rounding_std(frequency))]
    for i, j in pairs:
        if i not in required or j not in required:
            continue
        rows = np.all([np.isfinite(s.shape[:, [i, j]]).all(axis=1) for s in sets], axis=0)
        if rows.sum() < 3:
            continue
        shapes = np.real([s.shape[rows][:, [i, j]] for s in sets])
        planes = [np.linalg.qr(shape)[0] for shape in shapes]
        # the plane closest to all of them: leading eigenvectors of the mean projector
        mean = np.linalg.eigh(np.mean([q @ q.T for q in planes], axis=0))[1][:, -2:]
        angle = np.array([np.arccos(np.sqrt(min(plane_mac(q, mean), 1.0))) for q in planes])[:, None]
        terms.append(angle / robust_std(angle, _angle_of_rounding(shapes)))
    return np.sqrt(np.mean(np.concatenate(terms, axis=1) ** 2, axis=1))


def outlying_sets(sets: list[ModalSet], required: list[int]) -> np.ndarray:
    """(n_set,) bool: one of its required frequencies is an outlier among theirs (generalised extreme Studentised
    deviate, Rosner 1983); by chance in one of a thousand selections is any."""
    odd, frequency = np.zeros(len(sets), bool), np.array([s.frequency_hz for s in sets])
    for values, rounding in zip(frequency.T[required], rounding_std(frequency)[required], strict=True):
        odd |= find_outliers(values, FALSE_ODD / len(required), rounding)
    return odd


def find_outliers(values: np.ndarray, false_alarm: float, rounding: float) -> np.ndarray:
    """(n,) bool: which of normally distributed values (n,), whose rounding has the standard deviation `rounding`, are
    outliers: a third of them at most, however they mask one another."""
    from scipy import stats

    left, order, found = np.arange(len(values)), [], 0
    n = len(values) - np.arange(len(values) // 3)
    limits = stats.t.isf(false_alarm / (2 * n), np.maximum(n - 2, 1))
    for limit in limits:
        far = int(np.argmax(np.abs(values[left] - values[left].mean())))
        n, order = len(left), [*order, left[far]]
        left = np.delete(left, far)
        others = values[left]
        # of rounded values the scatter is that of rounding at least
        error = max(float(np.std(others, ddof=1)), rounding) * np.sqrt(n / (n - 1))
        if abs(values[order[-1]] - others.mean()) > error * limit:
            found = len(order)
    return np.isin(np.arange(len(values)), order[:found])


def wrong_values(sets: Sequence[ModalSet]) -> np.ndarray:
    """(n_set, n_mode) bool: frequencies that are outliers (`find_outliers`) among those of the same state, whether
    or not their block passes: one of them would be most of a CoV."""
    frequency = np.array([s.frequency_hz for s in sets])
    states = np.array([str(s.environment.get("state", "unknown")) for s in sets], dtype=object)
    wrong, rounding = np.zeros(frequency.shape, bool), rounding_std(frequency)
    for name, j in product(dict.fromkeys(states), range(frequency.shape[1])):
        own = np.flatnonzero((states == name) & np.isfinite(frequency[:, j]))
        wrong[own, j] = find_outliers(frequency[own, j], FALSE_ODD / frequency.shape[1], rounding[j])
    return wrong


def _wrong_notes(sets: Sequence[ModalSet], wrong: np.ndarray, labels: Sequence[str]) -> list[str]:
    found = []
    for j in np.flatnonzero(wrong.any(axis=0)):
        own = [sets[k] for k in np.flatnonzero(wrong[:, j])]
        found.append(f"{len(own)} of {labels[j]} ({own[0].frequency_hz[j]:.4g} Hz in {own[0].id})")
    return [f"not in the CoV, as unlike the others of their state: {', '.join(found)}"] * bool(found)


def _angle_of_rounding(shapes: np.ndarray) -> float:
    """Angle (rad) by which the rounding of shapes (n_set, n_row, 2) turns their plane; an angle is known to the square
    root of double precision."""
    size = np.median(np.linalg.norm(shapes, axis=1))
    return max(rounding_std(shapes.ravel()) * np.sqrt(shapes.shape[1]) / size, np.sqrt(np.finfo(float).eps))


def scatter_of(values: np.ndarray, step: float) -> float:
    """Scatter of values rounded to `step`, that of their rounding at least; NaN from fewer than two, and where all are
    one to the last digit: copies of one number say nothing of its scatter."""
    values = np.asarray(values, float)
    values = values[np.isfinite(values)]
    if len(values) < 2:
        return np.nan
    std = max(float(np.std(values, ddof=1)), UNIFORM * step)
    return std if std > 1e-12 * np.max(np.abs(values)) else np.nan


def column_scatter(columns: np.ndarray) -> np.ndarray:
    """`scatter_of` each column (n_column,) of what one program wrote (n_row, n_column)."""
    return np.array([scatter_of(*both) for both in zip(columns.T, rounding_steps(columns), strict=True)])


def _scatter(labels, sets, passed: np.ndarray, odd: np.ndarray, wrong: np.ndarray) -> pd.DataFrame:
    states = np.array([str(s.environment.get("state", "unknown")) for s in sets], dtype=object)
    usable = np.array([not s.environment.get("excluded") for s in sets]) & ~odd
    subsets = {"all": usable, **{name: usable & (states == name) for name in dict.fromkeys(states[usable])},
               "passed": passed & ~odd}
    rows = []
    frequency = np.array([s.frequency_hz for s in sets])
    steps, right = rounding_steps(frequency), np.where(wrong, np.nan, frequency)
    for j, (label, f, step) in enumerate(zip(labels, right.T, steps, strict=True)):
        own = np.array([s.frequency_std_hz[j] for s in sets]) / f
        for state, chosen in subsets.items():
            some, stated = f[chosen & np.isfinite(f)], own[chosen & np.isfinite(own)]
            mean = float(np.mean(some)) if len(some) else np.nan
            rows.append({
                "mode": label, "state": state, "blocks": int(chosen.sum()), "n": len(some),
                "mean_hz": mean, "cov": scatter_of(some, step) / mean,
                # the median: where an order parts a mode in two, a few blocks state many times the usual
                "own_cov": float(np.median(stated)) if len(stated) else np.nan,
                "paper_cov": PAPER_COV.get(label, np.nan),
            })
    return pd.DataFrame(rows)


def _summary(data: ModalData, table: pd.DataFrame, scatter: pd.DataFrame, count: int, std_from: str, notes,
             odd: int) -> str:
    counts = table["criterion"].value_counts(sort=False)
    lines = [f"{int((table['criterion'] == '').sum())} of {len(table)} blocks pass, {len(data.sets)} kept"]
    lines += [f"  {n} left out: {name}" for name, n in counts.items() if name]
    if len(data.sets) < count:
        lines.append(f"fewer than {count} pass{' and are like one another' if odd else ''}: all of them were kept")
    lines.append(f"most consistent: {data.reference_set}")
    for label, rows in scatter.groupby("mode", sort=False):
        value = rows["cov"].iloc[0]
        if not np.isfinite(value):
            lines.append(f"{label}: too few for a CoV")
            continue
        paper = f" (paper {PAPER_COV[label]})" if label in PAPER_COV else ""
        # what no SCADA says, and what is the same as all blocks, is left out
        states = "".join(f"; {k} {v:.4f}" for k, v in zip(rows["state"][1:], rows["cov"][1:], strict=True)
                         if np.isfinite(v) and k != "unknown" and (k != "passed" or v != value))
        own = rows["own_cov"].iloc[0]
        stated = f"; identification itself states {own:.4f} (median)" if np.isfinite(own) else ""
        lines.append(f"CoV of {label} over all blocks {value:.4f}{paper}{states}{stated}")
    if std_from == CAMPAIGN:
        lines.append("frequency_std_hz of every kept set is the CoV over all blocks times its frequency; --weights "
                     "measured takes that")
    else:
        lines.append("frequency_std_hz of every kept set is what identification states of its half hour; --weights "
                     "measured takes that; what changes between half hours is not in it")
        if any(np.isnan(s.frequency_std_hz[s.measured]).any() for s in data.sets):
            lines.append("some modes of the kept sets came without a standard deviation of their own")
    return "\n".join([*lines, *notes])
