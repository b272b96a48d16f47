"""Which blocks an update may trust: the criteria of the paper's Table 1, and the most consistent of those that pass."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from probupdate.campaign.scada import StateRule, block_conditions, with_rated_power
from probupdate.errors import InputError
from probupdate.modes import ModalData, ModalSet, plane_mac, write_modes

PAPER_COV = {"FA1": 0.015, "SS1": 0.015, "FA2": 0.017, "SS2": 0.017}


@dataclass(frozen=True, kw_only=True)
class SelectionCriteria:
    """Thresholds of Table 1.

    No yawing: yaw rate up to yaw_rate_degps and headings of the rows within heading_range_deg. No pitching: blade
    angle within pitch_range_deg. Idling or parked: state 'idling' by power, and rotor_speed_rpm at most. The modes
    of `required` identified (None: all that are labelled FA or SS, or all). FA/SS perpendicular: the shapes of one
    number at least least_angle_deg apart, the angle whose squared cosine is their MAC within their level's motion.
    """

    yaw_rate_degps: float = 0.05
    heading_range_deg: float = 1.0
    pitch_range_deg: float = 2.0
    rotor_speed_rpm: float = 2.0
    required: tuple[str, ...] | None = None
    least_angle_deg: float = 60.0
    unresolved_angle_deg: float = 30.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Selection:
    """data: the chosen sets, most consistent first among equals in time order, `reference_set` the most consistent.

    table: a row a block with id, state, criterion (empty where it passed), score (NaN where it did not), selected,
    angle1_deg, ... ; cov: mode -> state (or 'all', 'selected') -> CoV of the frequency; notes: what SCADA lacked.
    """

    data: ModalData
    table: pd.DataFrame
    cov: dict[str, dict[str, float]]
    criteria: SelectionCriteria
    notes: tuple[str, ...]
    summary: str

    def write(self, out: str | Path) -> list[Path]:
        """nine.json, and selection.csv beside it."""
        out = Path(out)
        table = out.with_name("selection.csv")
        out.parent.mkdir(parents=True, exist_ok=True)
        write_modes(self.data, out)
        self.table.to_csv(table, index=False, float_format="%.6g", lineterminator="\n")
        return [out, table]


def select(
    data: ModalData,
    scada: pd.DataFrame | None = None,
    *,
    criteria: SelectionCriteria | None = None,
    count: int = 9,
    state_rule: StateRule | None = None,
) -> Selection:
    """Keep the `count` most consistent of the blocks that pass every criterion; fewer where fewer pass.

    With `scada` the conditions of each block are gathered anew, else those kept in the sets are used. What a
    criterion needs and does not find is said, and that criterion is then not asked. Each chosen set gets
    frequency_std_hz: the CoV of the mode over all blocks in which it was identified, every state together as the
    paper did, times the set's own frequency. Raises InputError where no block passes.
    """
    criteria = criteria or SelectionCriteria()
    if count < 1:
        raise InputError("count", f"{count} sets cannot be selected", "give at least 1")
    required = _required(data, criteria)
    sets = data.sets if scada is None else _with_conditions(data.sets, scada, state_rule or StateRule())
    notes: list[str] = []
    tests = _asked(sets, criteria, notes)
    pairs = _pairs(data.labels)
    angles = np.array([[pair_angle_deg(s, i, j) for i, j in pairs] for s in sets]).reshape(len(sets), len(pairs))
    apart = np.array([[resolved(s, i, j) for i, j in pairs] for s in sets]).reshape(angles.shape)
    least = np.where(apart, criteria.least_angle_deg, criteria.unresolved_angle_deg)
    reasons = []
    for s, angle, limit in zip(sets, angles, least, strict=True):
        reason = "no data" if s.environment.get("excluded") else ""
        reason = reason or next((name for name, passes in tests if not passes(s)), "")
        lacking = [data.labels[j] if data.labels else str(j + 1) for j in required if not s.measured[j]]
        reason = reason or ("modes not identified" if lacking else "")
        reason = reason or ("planes not perpendicular" if np.any(angle < limit) else "")
        reasons.append(reason)
    passed = np.array([not r for r in reasons])
    if not passed.any():
        counts = ", ".join(f"{n} {name}" for name, n in pd.Series(reasons).value_counts().items())
        raise InputError("selection", f"none of {len(sets)} blocks passes ({counts})", "relax one, or measure on")
    score = np.full(len(sets), np.nan)
    score[passed] = inconsistency([s for s, p in zip(sets, passed, strict=True) if p], required, pairs)
    order = np.argsort(np.where(passed, score, np.inf), kind="stable")[: min(count, int(passed.sum()))]
    cov = _scatter(data.labels, sets, passed)
    overall = np.array([_cov([s.frequency_hz[j] for s in sets]) for j in range(data.n_mode)])
    chosen = tuple(replace(sets[k], frequency_std_hz=_deviation(sets[k], overall)) for k in sorted(order))
    result = ModalData(channels=data.channels, sets=chosen, labels=data.labels, reference_set=sets[order[0]].id)
    table = pd.DataFrame({
        "id": [s.id for s in sets], "state": [str(s.environment.get("state", "unknown")) for s in sets],
        "criterion": reasons, "score": score, "selected": np.isin(np.arange(len(sets)), order),
    })
    for k, (i, j) in enumerate(pairs):
        table[f"angle_{data.labels[i]}_{data.labels[j]}_deg"] = angles[:, k]
    return Selection(data=result, table=table, cov=cov, criteria=criteria, notes=tuple(notes),
                     summary=_summary(result, table, cov, overall, count, notes))


def _deviation(s: ModalSet, cov: np.ndarray) -> np.ndarray:
    """CoV times frequency; what the set came with where one block alone gives no CoV."""
    return np.where(np.isfinite(cov), cov * s.frequency_hz, s.frequency_std_hz)


def _required(data: ModalData, criteria: SelectionCriteria) -> list[int]:
    if criteria.required is None:
        bending = [j for j, label in enumerate(data.labels) if label.startswith(("FA", "SS"))]
        return bending or list(range(data.n_mode))
    for label in criteria.required:
        if label not in data.labels:
            raise InputError("selection, required modes", f"'{label}' is no mode of the data",
                             f"choose from {', '.join(data.labels)}")
    return [data.labels.index(label) for label in criteria.required]


def _pairs(labels: tuple[str, ...]) -> list[tuple[int, int]]:
    return [(j, labels.index("SS" + t[2:])) for j, t in enumerate(labels) if t[:2] == "FA" and "SS" + t[2:] in labels]


def _with_conditions(sets, scada: pd.DataFrame, rule: StateRule) -> tuple[ModalSet, ...]:
    rule = with_rated_power(rule, scada)
    result = []
    for s in sets:
        try:
            start = pd.Timestamp(s.id)
            minutes = float(s.environment["block_minutes"])
        except (ValueError, KeyError, TypeError):
            raise InputError(f"set {s.id}", "its id is no time, or its environment has no block_minutes, so SCADA "
                             "cannot be joined", "leave --scada out, or name sets by their start in UTC") from None
        start = start.tz_localize("UTC") if start.tzinfo is None else start
        result.append(replace(s, environment=dict(s.environment) | block_conditions(scada, start, minutes, rule)))
    return tuple(result)


def _asked(sets, criteria: SelectionCriteria, notes: list[str]) -> list[tuple[str, Callable[[ModalSet], bool]]]:
    """Criteria on conditions that the sets can answer, in the order of Table 1; a block without the number fails."""
    limits = [
        ("yawing", "yaw_rate_degps_max", criteria.yaw_rate_degps),
        ("yawing", "nacelle_heading_deg_range", criteria.heading_range_deg),
        ("pitching", "pitch_deg_range", criteria.pitch_range_deg),
        ("not idling", "state", "idling"),
        ("not idling", "rotor_speed_rpm_max", criteria.rotor_speed_rpm),
    ]
    known = [s for s in sets if not s.environment.get("excluded")]
    asked: list[tuple[str, Callable[[ModalSet], bool]]] = []
    said: set[str] = set()
    for name, key, limit in limits:
        values = [s.environment.get(key) for s in known]
        if all(v is None or v == "unknown" for v in values):
            said.add(f"{name}|{key}")
            continue
        if not asked:
            asked.append(("no SCADA", lambda s: float(s.environment.get("scada_rows") or 0) > 0))
        asked.append((name, _limit(key, limit)))
    for name in ("yawing", "pitching", "not idling"):
        without = [t.split("|")[1] for t in sorted(said) if t.startswith(name)]
        if without and not any(n == name for n, _ in asked):
            notes.append(f"'{name}' was not asked: no {' and no '.join(without)} in SCADA")
    return asked


def _limit(key: str, limit) -> Callable[[ModalSet], bool]:
    def passes(s: ModalSet) -> bool:
        value = s.environment.get(key)
        if isinstance(limit, str):
            return value == limit
        return value is not None and bool(value <= limit)

    return passes


def pair_angle_deg(s: ModalSet, i: int, j: int) -> float:
    """Angle between two shapes of a set, acos sqrt(MAC): 90 where they are perpendicular; NaN where one is missing."""
    if not (s.measured[i] and s.measured[j]):
        return np.nan
    a, b = s.shape[:, i], s.shape[:, j]
    ok = np.isfinite(a) & np.isfinite(b)
    cosine = abs(np.vdot(a[ok], b[ok])) / (np.linalg.norm(a[ok]) * np.linalg.norm(b[ok]))
    return float(np.degrees(np.arccos(min(cosine, 1.0))))


def resolved(s: ModalSet, i: int, j: int) -> bool:
    """Two modes of a set lie further apart than their half-power bandwidths reach: |f1 - f2| >= zeta1 f1 + zeta2 f2."""
    f, zeta = s.frequency_hz[[i, j]], s.damping_ratio[[i, j]]
    return bool(abs(f[1] - f[0]) >= np.sum(zeta * f))


def inconsistency(sets: list[ModalSet], required: list[int], pairs: list[tuple[int, int]]) -> np.ndarray:
    """(n_set,) distance of each set from the middle of them all, in robust deviations; small is consistent.

    Root mean square, over the required modes, of (f - median) / scale and, over pairs, of the angle between the set's
    plane and the mean plane over its scale. Scales are 1.4826 median absolute deviations; zero scatter counts as 0.
    """
    frequency = np.array([s.frequency_hz[required] for s in sets])
    terms = [(frequency - np.median(frequency, axis=0)) / _scale(frequency - np.median(frequency, axis=0))]
    for i, j in pairs:
        if i not in required or j not in required:
            continue
        rows = np.all([np.isfinite(s.shape[:, [i, j]]).all(axis=1) for s in sets], axis=0)
        if rows.sum() < 3:
            continue
        planes = [np.linalg.qr(s.shape[rows][:, [i, j]].real)[0] for s in sets]
        # the plane closest to all of them: leading eigenvectors of the mean projector
        mean = np.linalg.eigh(np.mean([q @ q.T for q in planes], axis=0))[1][:, -2:]
        angle = np.array([np.arccos(np.sqrt(min(plane_mac(q, mean), 1.0))) for q in planes])[:, None]
        terms.append(angle / _scale(angle))
    return np.sqrt(np.mean(np.concatenate(terms, axis=1) ** 2, axis=1))


def _scale(deviation: np.ndarray) -> np.ndarray:
    scale = 1.4826 * np.median(np.abs(deviation), axis=0)
    return np.where(scale > 0, scale, np.inf)


def _cov(values) -> float:
    values = np.asarray(values, float)
    values = values[np.isfinite(values)]
    return float(np.std(values, ddof=1) / np.mean(values)) if len(values) > 1 else np.nan


def _scatter(labels, sets, passed: np.ndarray) -> dict[str, dict[str, float]]:
    names = labels or tuple(str(j + 1) for j in range(sets[0].frequency_hz.size))
    states = np.array([str(s.environment.get("state", "unknown")) for s in sets], dtype=object)
    table = {}
    for j, label in enumerate(names):
        f = np.array([s.frequency_hz[j] for s in sets])
        table[label] = {"all": _cov(f)} | {state: _cov(f[states == state]) for state in dict.fromkeys(states)}
        table[label]["passed"] = _cov(f[passed])
    return table


def _summary(data: ModalData, table: pd.DataFrame, cov, overall, count: int, notes) -> str:
    counts = table["criterion"].value_counts(sort=False)
    lines = [f"{int((table['criterion'] == '').sum())} of {len(table)} blocks pass, {len(data.sets)} kept"]
    lines += [f"  {n} left out: {name}" for name, n in counts.items() if name]
    if len(data.sets) < count:
        lines.append(f"fewer than {count} pass: all of them were kept")
    lines.append(f"most consistent: {data.reference_set}")
    for (label, row), value in zip(cov.items(), overall, strict=True):
        paper = f" (paper {PAPER_COV[label]})" if label in PAPER_COV else ""
        states = ", ".join(f"{k} {v:.4f}" for k, v in row.items() if k != "all" and np.isfinite(v))
        lines.append(f"CoV of {label} over all blocks {value:.4f}{paper}; {states}" if np.isfinite(value)
                     else f"{label}: too few for a CoV")
    lines.append("frequency_std_hz of every kept set is the CoV over all blocks times its frequency")
    return "\n".join([*lines, *notes])
