"""The criteria of the paper's Table 1 as named thresholds: given in Python, or read from a TOML file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from probupdate.campaign.scada import STATES
from probupdate.errors import InputError
from probupdate.io.files import read_toml
from probupdate.io.schema import Range, table_as, validate
from probupdate.modal.labels import is_along_x, is_bending, label_across
from probupdate.modal.modes import ModalSet

# a threshold may be infinite, which leaves its criterion out
Threshold = Annotated[float, Range(0)]
Angle = Annotated[float, Range(0, 90)]
Share = Annotated[float, Range(0, 1)]

# a criterion by its name: does the set pass?
Test = tuple[str, Callable[[ModalSet], bool]]


@dataclass(frozen=True, kw_only=True)
class SelectionCriteria:
    """Thresholds of Table 1; `inf` leaves a criterion out.

    No yawing: yaw rate up to yaw_rate_degps and headings of the rows within heading_range_deg. No pitching: blade
    angle within pitch_range_deg. Idling or parked: the block's state, given by the power of its ten-minute rows, is one
    of `states` (empty: any), and rotor_speed_rpm at most. The modes of `required` identified (None: those labelled FA
    or SS, where none is all, that at least `required_share` of the usable blocks have, so that a mode that shows now
    and then decides nothing). FA/SS perpendicular: the shapes of one number at least least_angle_deg
    apart where the two are resolved, unresolved_angle_deg where not; the angle whose squared cosine is their MAC. """

    yaw_rate_degps: Threshold = 0.05
    heading_range_deg: Threshold = 1.0
    pitch_range_deg: Threshold = 2.0
    rotor_speed_rpm: Threshold = 2.0
    states: tuple[str, ...] = (STATES[0],)
    required: tuple[str, ...] | None = None
    required_share: Share = 0.5
    least_angle_deg: Angle = 60.0
    unresolved_angle_deg: Angle = 30.0

    def __post_init__(self):
        validate(self, "selection", "see SelectionCriteria")



# what is asked of other structures: nothing of a rotor or a nacelle
TURBINE, STRUCTURE = "turbine", "structure"
PRESETS: dict[str, SelectionCriteria] = {
    TURBINE: SelectionCriteria(),
    STRUCTURE: SelectionCriteria(yaw_rate_degps=np.inf, heading_range_deg=np.inf, pitch_range_deg=np.inf,
                                 rotor_speed_rpm=np.inf, states=()),
}


def preset_criteria(name: str) -> SelectionCriteria:
    """'turbine': Table 1 of the paper. 'structure', for a building, a bridge or a frame: only that the modes are
    identified, and perpendicular where two are labelled FA and SS. Raises InputError for another name."""
    if name not in PRESETS:
        raise InputError("preset", f"'{name}' is unknown", f"choose {' or '.join(PRESETS)}")
    return PRESETS[name]


def read_criteria(path: str | Path, preset: str = TURBINE) -> SelectionCriteria:
    """A TOML file whose keys are those of `SelectionCriteria`; what it leaves out keeps the preset's."""
    start = preset_criteria(preset)
    path = Path(path)
    content = read_toml(path, "write lines such as pitch_range_deg = 2.0", absent="name a file with criteria")
    found = table_as(SelectionCriteria, content, str(path))
    return replace(start, **{key: getattr(found, key) for key in content})


def condition_tests(sets: tuple[ModalSet, ...], criteria: SelectionCriteria) -> tuple[list[Test], list[str]]:
    """Criteria on conditions that the sets can answer, in the order of Table 1, and what could not be asked.

    A block without a number that others have fails; a number that no block has is not asked, and that is said where
    no other number gives the same.
    """
    state = "not idling" if criteria.states == (STATES[0],) else "other state"
    limits = [
        ("yawing", "yaw_rate_degps_max", criteria.yaw_rate_degps),
        ("yawing", "nacelle_heading_deg_range", criteria.heading_range_deg),
        ("pitching", "pitch_deg_range", criteria.pitch_range_deg),
        (state, "state", criteria.states),
        (state, "rotor_speed_rpm_max", criteria.rotor_speed_rpm),
    ]
    known = [s for s in sets if not s.environment.get("excluded")]
    tests: list[Test] = []
    lacking: dict[str, list[str]] = {}
    for name, key, limit in limits:
        if not limit if isinstance(limit, tuple) else np.isinf(limit):
            continue
        values = [s.environment.get(key) for s in known]
        if all(v is None or v == "unknown" for v in values):
            lacking.setdefault(name, []).append(key)
            continue
        if not tests:
            tests.append(("no SCADA", lambda s: float(s.environment.get("scada_rows") or 0) > 0))
        tests.append((name, _limit(key, limit)))
    asked = {name for name, _ in tests}
    notes = [f"'{name}' was not applied: no {' and no '.join(keys)} in SCADA"
             for name, keys in lacking.items() if name not in asked]
    return tests, notes


def _limit(key: str, limit) -> Callable[[ModalSet], bool]:
    def passes(s: ModalSet) -> bool:
        value = s.environment.get(key)
        if isinstance(limit, tuple):
            return value in limit
        return value is not None and bool(value <= limit)

    return passes


def required_modes(
    labels: tuple[str, ...], n_mode: int, criteria: SelectionCriteria, sets: Sequence[ModalSet] = ()
) -> list[int]:
    """Which modes a set must have; `sets` are all blocks, of which those with data count for required_share. Raises
    InputError for a name that is not a mode, and where no mode is in so many blocks."""
    if criteria.required is None:
        bending = [j for j, label in enumerate(labels) if is_bending(label)]
        measured = [s.measured for s in sets if not s.environment.get("excluded")]
        share = np.mean(measured, axis=0) if measured else np.ones(n_mode)
        often = [j for j in bending or range(n_mode) if share[j] >= criteria.required_share]
        if not often and not bending:
            raise InputError("selection, required modes", f"no mode is in {100 * criteria.required_share:g} % of the "
                             "blocks", "lower required_share, or name the modes in `required`")
        return often or bending
    for label in criteria.required:
        if label not in labels:
            raise InputError("selection, required modes", f"'{label}' is not a mode of the data",
                             f"choose from {', '.join(labels)}")
    return [labels.index(label) for label in criteria.required]


def perpendicular_pairs(labels: tuple[str, ...]) -> list[tuple[int, int]]:
    """(FAk, SSk), or (Xk, Yk), of one number k."""
    return [(j, labels.index(label_across(t))) for j, t in enumerate(labels)
            if is_along_x(t) and label_across(t) in labels]


def pair_angle_deg(s: ModalSet, i: int, j: int) -> float:
    """Angle between two shapes of a set, acos sqrt(MAC): 90 where they are perpendicular; NaN where one is missing, or
    seen by no channel of the other."""
    if not (s.measured[i] and s.measured[j]):
        return np.nan
    a, b = s.shape[:, i], s.shape[:, j]
    ok = np.isfinite(a) & np.isfinite(b)
    size = np.linalg.norm(a[ok]) * np.linalg.norm(b[ok])
    # no channel in common, or one that moves at none of them
    if size == 0:
        return np.nan
    cosine = abs(np.vdot(a[ok], b[ok])) / size
    return float(np.degrees(np.arccos(min(cosine, 1.0))))


def are_resolved(s: ModalSet, i: int, j: int) -> bool:
    """Two modes of a set lie further apart than their half-power bandwidths reach: |f1 - f2| >= zeta1 f1 + zeta2 f2."""
    f, zeta = s.frequency_hz[[i, j]], s.damping_ratio[[i, j]]
    return bool(abs(f[1] - f[0]) >= np.sum(zeta * f))


def failed_criteria(
    s: ModalSet, tests: list[Test], required: list[int], pairs: list[tuple[int, int]],
    criteria: SelectionCriteria,
) -> list[str]:
    """Every criterion that the set fails, in the order of Table 1, each once; empty where it passes.

    A block without data is asked nothing else.
    """
    if s.environment.get("excluded"):
        return ["no data"]
    failed = [name for name, passes in tests if not passes(s)]
    if not all(s.measured[j] for j in required):
        failed.append("modes not identified")
    for i, j in pairs:
        least = criteria.least_angle_deg if are_resolved(s, i, j) else criteria.unresolved_angle_deg
        # NaN, where one is missing, is below nothing
        if pair_angle_deg(s, i, j) < least:
            failed.append("planes not perpendicular")
    return list(dict.fromkeys(failed))
