"""How frequencies and damping follow wind, rotor speed, temperature, water level and amplitude over a campaign.

Generalised least squares: each block's value has the standard deviation that identification states, up to a common
factor, and the blocks share a slow error (an Ornstein-Uhlenbeck process), for what moves a structure and is no
covariate. Leaving it out would make standard errors several times too small where weather and error both last for
hours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from probupdate.errors import InputError
from probupdate.identification.covariate_shapes import Shape, choose_shapes, find_lone_rows
from probupdate.identification.settings import CONSTANTS
from probupdate.identification.slow_error import whiten_columns
from probupdate.io.files import write_table
from probupdate.io.result_table import with_units
from probupdate.modal.joined_modes import TIME
from probupdate.modal.modes import ModalData, ModalSet
from probupdate.modal.rounding import rounding_std
from probupdate.runtime.arrays import frozen_array

COVARIATES = ("wind_speed_mps", "rotor_speed_rpm", "air_temperature_c", "water_level_m", "rms_mps2")
LEAST_KNOWN = CONSTANTS.least_known
COLLINEAR = CONSTANTS.collinear
OUTLIER = CONSTANTS.outlier
# sizes of the slow error beside the noise that a fit weighs, and how many lengths of it
RATIOS, N_HOURS = (0.0, 0.1, 0.25, 0.5, 1.0, 2.0, 5.0), 9
# at most so many rounds of leaving outliers out
ROUNDS = 10
# words in the name of an angle that goes round, whatever part of the turn was measured; parts of a covariate's range
# between which a residual may differ
ROUND, SIXTHS = ("heading", "direction", "azimuth"), 6
SPARE_ROWS = CONSTANTS.spare_rows


@dataclass(frozen=True, eq=False, kw_only=True)
class Regression:
    """y = intercept + sum_k coefficient_k (x_k - mean_k) + slow error + noise, of one mode.

    names (n_covariate,) used; coefficient, std_error, p_value, inflation (n_covariate,): per unit of each covariate,
    and its variance inflation by the others (1: none); mean, spread (n_covariate,) of the covariates; intercept with
    intercept_std at their means. n rows used, n_outlier left out as outliers, n_missing for want of a covariate.
    explained: share of the weighted scatter that the covariates take away; noise_factor: the noise over the stated
    standard deviations (its size where none are stated); slow_std, slow_hours: of the slow error. residual (n_row,) of
    all rows, NaN where not used. joint: pairs that are confounded or of one angle, with p of both together. shapes:
    how the response follows covariates otherwise than along a line (names are then of the shape's columns). notes:
    what was left out and what is confounded.
    """

    response: str
    names: tuple[str, ...]
    coefficient: np.ndarray
    std_error: np.ndarray
    p_value: np.ndarray
    inflation: np.ndarray
    mean: np.ndarray
    spread: np.ndarray
    intercept: float
    intercept_std: float
    n: int
    n_outlier: int
    n_missing: int
    explained: float
    noise_factor: float
    slow_std: float
    slow_hours: float
    residual: np.ndarray
    joint: tuple[tuple[tuple[str, str], float], ...]
    shapes: tuple[Shape, ...]
    notes: tuple[str, ...]


def regress(
    response: str,
    value: np.ndarray,
    time_h: np.ndarray,
    covariates: Mapping[str, np.ndarray],
    std: np.ndarray | None = None,
) -> Regression:
    """Fit value (n_row,), NaN where not measured, at time_h (n_row,) ascending, on covariates {name: (n_row,)}.

    std (n_row,): stated standard deviations; rows without one get the median of the others. Raises InputError where
    fewer rows are left than the coefficients and eight more.
    """
    from scipy import stats

    value, time_h = np.asarray(value, float), np.asarray(time_h, float)
    if np.any(np.diff(time_h) <= 0):
        raise InputError(f"regression of {response}", "times do not rise", "sort the blocks by time, each once")
    notes: list[str] = []
    there = np.isfinite(value)
    names, columns = _usable_covariates(_round_about(covariates), there, notes)
    known = there & np.all([np.isfinite(c) for c in columns], axis=0) if names else there
    names, columns = _independent(names, columns, known, notes)
    _refuse_few(response, value[known], names)
    noise, plain = _noise(std, known), np.column_stack([np.ones(len(value)), *columns])
    rows = known.copy()
    rows[known] = ~find_lone_rows(value[known], noise[known], plain[known], 2 * OUTLIER)
    chosen = choose_shapes(value[rows], noise[rows], time_h[rows],
                           {name: column[rows] for name, column in zip(names, columns, strict=True)})
    own = 1 + np.arange(len(chosen.names))
    table = np.zeros((len(value), 1 + len(chosen.names) + len(chosen.nuisances)))
    table[rows] = np.column_stack([np.ones(int(rows.sum())), *chosen.columns, *chosen.nuisances])
    mean = table[rows, 1:].mean(axis=0)
    table[:, 1:] -= mean
    seen = dict(zip(names, plain[:, 1:].T, strict=True))
    for name, behind in chosen.followed.items():
        seen[f"what it follows of {name}"] = np.full(len(value), np.nan)
        seen[f"what it follows of {name}"][rows] = behind
    fit, rows = _without_outliers(table, value, noise, time_h, rows)
    residual = np.full(len(value), np.nan)
    residual[rows] = value[rows] - table[rows] @ fit.coefficient
    error = np.sqrt(np.diag(fit.covariance)[own] + np.diag(chosen.spread))
    free = int(rows.sum()) - table.shape[1]
    inflation = _inflation(table[rows][:, own])
    joint = _confounded_pairs(chosen.names, table[rows][:, own], inflation, fit, free, notes)
    notes += [_shape_words(shape) for shape in chosen.shapes]
    notes += _follows_still(seen, table, fit, noise, time_h, value, rows)
    return Regression(
        response=response, names=chosen.names, coefficient=frozen_array(fit.coefficient[own]),
        std_error=frozen_array(error), p_value=frozen_array(2 * stats.t.sf(np.abs(fit.coefficient[own] / error), free)),
        inflation=frozen_array(inflation), mean=frozen_array(mean[own - 1]),
        spread=frozen_array(table[rows][:, own].std(axis=0, ddof=1)), intercept=float(fit.coefficient[0]),
        intercept_std=float(np.sqrt(fit.covariance[0, 0])), n=int(rows.sum()),
        n_outlier=int(known.sum() - rows.sum()), n_missing=int(there.sum() - known.sum()),
        explained=_explained_variance(value[rows], residual[rows], noise[rows]),
        noise_factor=float(fit.scale if std is not None else fit.scale * np.median(noise[rows])),
        slow_std=float(fit.scale * fit.ratio), slow_hours=float(fit.hours),
        residual=frozen_array(residual), joint=joint, shapes=chosen.shapes, notes=tuple(notes),
    )


def _refuse_few(response: str, value: np.ndarray, names: Sequence[str]) -> None:
    if len(value) < 1 + len(names) + SPARE_ROWS:
        raise InputError(f"regression of {response}", f"{len(value)} blocks have the mode and "
                         f"{', '.join(names) or 'no covariate'}; "
                         f"{1 + len(names)} coefficients need {1 + len(names) + SPARE_ROWS}",
                         "use fewer covariates or a longer campaign")
    if np.ptp(value) <= 1e-12 * np.max(np.abs(value)):
        raise InputError(f"regression of {response}", f"it is {value[0]:.4g} in all {len(value)} blocks",
                         "give it as identified in each block")


def _round_about(covariates: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Angles that go round (directions, headings, and others in degrees that span half a turn) as cosine and sine."""
    found: dict[str, np.ndarray] = {}
    for name, column in covariates.items():
        column = np.asarray(column, float)
        some = column[np.isfinite(column)]
        turns = name.endswith("_deg") and len(some) and np.ptp(some) > 0 and (
            any(word in name for word in ROUND) or np.ptp(some) > 180)
        if turns:
            angle = np.radians(column)
            found |= {f"cos {name}": np.cos(angle), f"sin {name}": np.sin(angle)}
        else:
            found[name] = column
    return found


def _shape_words(shape: Shape) -> str:
    size = f"{shape.constant:.3g} +- {shape.constant_std:.1g}"
    odds = f"(odds e^{shape.ln_odds:.0f})"
    return {
        "lag": f"follows {shape.covariate} {size} h behind, as a first-order low-pass {odds}",
        "bend": f"bends at {shape.covariate} {size} {odds}",
        "saturation": f"follows {shape.covariate} on one side of {size} only {odds}",
        "hysteresis": f"follows {shape.covariate} with hysteresis of width {size} {odds}",
        "harmonic": f"follows {shape.covariate} twice a turn {odds}",
        "day": f"has a daily period that no covariate explains {odds}",
        "tide": f"has a period of about half a day, as of the tide, that no covariate explains {odds}",
        "drift": f"drifts steadily, which no covariate explains {odds}",
        "step": f"steps {size} h after the first block {odds}",
    }[shape.kind]


def _follows_still(columns: Mapping[str, np.ndarray], table, fit: _Fit, noise, time_h, value, rows) -> list[str]:
    """Covariates {name: (n_row,)} whose sixths the residual still differs between: Wald's F in the fit's errors."""
    from scipy import stats

    decay, said = np.exp(-np.diff(time_h[rows]) / fit.hours), []
    for name, x in ((name, column[rows]) for name, column in columns.items()):
        part = np.searchsorted(np.quantile(x, np.linspace(0, 1, SIXTHS + 1)[1:-1]), x)
        marks = (part[:, None] == np.arange(1, SIXTHS)).astype(float)
        white, _ = whiten_columns(np.column_stack([table[rows], value[rows], marks]), noise[rows], fit.ratio, decay)
        q = np.linalg.qr(white[:, : table.shape[1]])[0]
        y, m = (part - q @ (q.T @ part) for part in np.split(white[:, table.shape[1]:], [1], axis=1))
        taken, _, rank, _ = np.linalg.lstsq(m, y, rcond=1e-8)
        free = len(y) - table.shape[1] - rank
        if rank == 0 or free < SPARE_ROWS:
            continue
        rest = float(np.sum((y - m @ taken) ** 2))
        p = float(stats.f.sf((float(np.sum(y**2)) - rest) / rank / (rest / free), rank, free))
        if p < 1e-3 / len(columns):
            said.append(f"the residual still follows {name} (p = {p:.1g}): in none of the shapes that were tried")
    return said


def _without_outliers(table, value, noise, time_h, rows) -> tuple[_Fit, np.ndarray]:
    """The fit after its outliers were left out, round by round as long as enough rows stay, and the rows that stay."""
    rows, number = rows.copy(), 0
    while True:
        fit = _fit(table[rows], value[rows], noise[rows], time_h[rows])
        far, number = np.abs(fit.innovation) > OUTLIER, number + 1
        if not far.any() or rows.sum() - far.sum() < table.shape[1] + SPARE_ROWS:
            return fit, rows
        rows[np.flatnonzero(rows)[far]] = False
        if number == ROUNDS:
            return fit, rows


def _confounded_pairs(
    names: Sequence[str], table: np.ndarray, inflation: np.ndarray, fit: _Fit, free: int, notes: list[str]
) -> tuple[tuple[tuple[str, str], float], ...]:
    """Pairs of confounded covariates, each once, with p of the two together (Wald's F): either alone may seem
    to count for nothing where both do."""
    joint: dict[tuple[str, str], float] = {}
    for k, name in enumerate(names):
        if name.startswith("cos ") and "sin " + name[4:] in names:
            joint[name, "sin " + name[4:]] = _wald(fit, [1 + k, 1 + names.index("sin " + name[4:])], free)
    for k in np.flatnonzero(inflation >= COLLINEAR):
        other = np.corrcoef(table.T)[k] * (np.arange(len(names)) != k)
        twin = int(np.argmax(np.abs(other)))
        first, second = sorted((int(k), twin))
        pair = (names[first], names[second])
        if pair in joint:
            continue
        both = [1 + first, 1 + second]
        joint[pair] = _wald(fit, both, free)
        notes.append(f"{pair[0]} and {pair[1]} are indistinguishable (correlation {other[twin]:.2f}, variance "
                     f"inflation {inflation[k]:.0f}): each coefficient alone is hardly known, the two together count "
                     f"with p = {joint[pair]:.2g}")
    return tuple(joint.items())


def _wald(fit: _Fit, both: list[int], free: int) -> float:
    from scipy import stats

    coefficient = fit.coefficient[both]
    statistic = float(coefficient @ np.linalg.solve(fit.covariance[np.ix_(both, both)], coefficient)) / 2
    return float(stats.f.sf(statistic, 2, free))


def _usable_covariates(covariates, there, notes) -> tuple[list[str], list[np.ndarray]]:
    names, columns = [], []
    for name, column in covariates.items():
        column = np.asarray(column, float)
        known = np.isfinite(column) & there
        if known.sum() < LEAST_KNOWN * there.sum() or not known.any():
            notes.append(f"{name} left out: known in {int(known.sum())} of {int(there.sum())} blocks")
        elif np.ptp(column[known]) <= 1e-9 * max(np.abs(column[known]).max(), 1e-300):
            notes.append(f"{name} left out: it does not change")
        else:
            names.append(name), columns.append(column)
    return names, columns


def _independent(names, columns, rows, notes) -> tuple[list[str], list[np.ndarray]]:
    """Covariates that are no combination of those before them."""
    kept: list[int] = []
    for k in range(len(names)):
        some = np.column_stack([columns[i][rows] for i in [*kept, k]])
        some = (some - some.mean(axis=0)) / np.maximum(some.std(axis=0), 1e-300)
        if len(some) and np.linalg.matrix_rank(some, tol=1e-6 * np.sqrt(len(some))) == len(kept) + 1:
            kept.append(k)
        else:
            notes.append(f"{names[k]} left out: a combination of {', '.join(names[i] for i in kept) or 'nothing'}")
    return [names[k] for k in kept], [columns[k] for k in kept]


def _noise(std, rows) -> np.ndarray:
    """Stated standard deviations, the median of the others for a row without; ones where none is stated."""
    if std is None:
        return np.ones(len(rows))
    std = np.asarray(std, float)
    good = np.isfinite(std) & (std > 0)
    middle = float(np.median(std[good & rows])) if np.any(good & rows) else 1.0
    return np.where(good, std, middle)


@dataclass(frozen=True, eq=False)
class _Fit:
    coefficient: np.ndarray
    covariance: np.ndarray
    scale: float
    ratio: float
    hours: float
    innovation: np.ndarray


def _fit(table, value, noise, time_h) -> _Fit:
    """Covariance scale^2 (diag(noise^2) + ratio^2 exp(-|dt| / hours)); ratio and hours integrated out.

    A campaign of days shows poorly how long its slow error lasts, and the most likely answer is too short on average:
    standard errors taken there are too small. Every point of a grid (uniform in the logarithms) therefore counts by its
    restricted likelihood; ratio and hours of the result are the likeliest point's.
    """
    step, unit = np.diff(time_h), float(np.median(noise))
    both = np.column_stack([table, value])
    free = len(value) - table.shape[1]
    # from the shortest distance of two blocks to the whole campaign; from none to all of the scatter
    hours = np.geomspace(step.min(), max(time_h[-1] - time_h[0], 4 * step.min()), N_HOURS)
    points = []
    for last in hours:
        decay = np.exp(-step / last)
        for ratio in RATIOS:
            white, log_determinant = whiten_columns(both, noise, unit * ratio, decay)
            q, r = np.linalg.qr(white[:, :-1])
            target = q.T @ white[:, -1]
            left = white[:, -1] - q @ target
            variance = max(left @ left / free, 1e-300)
            likely = -0.5 * (free * np.log(variance) + log_determinant) - np.sum(np.log(np.abs(np.diag(r))))
            inverse = np.linalg.inv(r)
            points.append((likely, inverse @ target, variance * inverse @ inverse.T, variance, ratio, last, left))
    likely = np.array([point[0] for point in points])
    weight = np.exp(likely - likely.max())
    weight /= weight.sum()
    coefficient = np.sum([w * point[1] for w, point in zip(weight, points, strict=True)], axis=0)
    apart = [point[1] - coefficient for point in points]
    covariance = np.sum([w * (point[2] + np.outer(a, a)) for w, point, a in zip(weight, points, apart, strict=True)],
                        axis=0)
    *_, variance, ratio, last, left = points[int(np.argmax(likely))]
    return _Fit(coefficient=coefficient, covariance=covariance, scale=np.sqrt(variance), ratio=unit * ratio, hours=last,
                innovation=left / np.sqrt(variance))


def mean_over_time(value: np.ndarray, time_h: np.ndarray) -> tuple[float, float]:
    """Mean of value (n_row,) at time_h (n_row,) ascending, and its standard deviation: errors that last from block to
    block are averaged over (`_fit`); fewer rows than a regression needs do not show them and count as independent."""
    if len(value) < 1 + SPARE_ROWS or np.any(np.diff(time_h) <= 0):
        return float(np.mean(value)), float(np.std(value, ddof=1) / np.sqrt(len(value)))
    fit = _fit(np.ones((len(value), 1)), value, np.ones(len(value)), time_h)
    return float(fit.coefficient[0]), float(np.sqrt(fit.covariance[0, 0]))


def _inflation(table: np.ndarray) -> np.ndarray:
    """1 / (1 - R^2) of each column on the others (centred)."""
    if table.shape[1] < 2:
        return np.ones(table.shape[1])
    return np.diag(np.linalg.inv(np.corrcoef(table.T)))


def _explained_variance(value, residual, noise) -> float:
    weight = 1 / noise**2
    about = value - np.sum(weight * value) / np.sum(weight)
    whole = np.sum(weight * about**2)
    return float(1 - np.sum(weight * residual**2) / whole) if whole > 0 else 0.0


@dataclass(frozen=True, eq=False, kw_only=True)
class ModalRegression:
    """fits: label -> (of ln f, of the damping ratio), those that could be made; notes: those that could not, and what
    was left out. table: a row a mode, response and covariate. hours (n_set,) since the first, columns: covariate ->
    (n_set,)."""

    fits: Mapping[str, tuple[Regression, ...]]
    table: pd.DataFrame
    hours: np.ndarray
    columns: Mapping[str, np.ndarray]
    notes: tuple[str, ...]

    def to_frame(self) -> pd.DataFrame:
        """`table`: a row a mode, response and covariate."""
        return with_units(self.table)

    @property
    def summary(self) -> str:
        lines = []
        for label, fits in self.fits.items():
            for fit in fits:
                clear = [f"{name} {c:+.2g} +- {e:.1g}" for name, c, e, p in
                         zip(fit.names, fit.coefficient, fit.std_error, fit.p_value, strict=True) if p < 0.01]
                seen = {name for name, p in zip(fit.names, fit.p_value, strict=True) if p < 0.01}
                clear += [f"{_pair_words(pair)} (together p = {p:.1g})" for pair, p in fit.joint
                          if p < 0.01 and not seen & set(pair)]
                lines.append(f"{label}, {fit.response}: {', '.join(clear) or 'follows none clearly'} ({fit.n} blocks, "
                             f"{100 * fit.explained:.0f} % explained)")
        return "\n".join([*lines, *self.notes])

    def write(self, out: str | Path) -> Path:
        return write_table(out, self.table)


def _pair_words(pair: tuple[str, str]) -> str:
    return pair[0][4:] if pair[0].startswith("cos ") and pair[1] == "sin " + pair[0][4:] else " or ".join(pair)


def regress_modes(
    data: ModalData, *, covariates: Sequence[str] = COVARIATES, state: str | None = None
) -> ModalRegression:
    """Regress ln f and damping of every mode on what the sets' environment has; sets are named by their start.

    state: blocks of that turbine state only. Stated standard deviations weight the blocks where sets have them. Raises
    InputError where no set has a time or no mode can be fitted.
    """
    sets, hours = _sets_by_time(data, state)
    columns = _columns(sets, covariates)
    labels = data.labels or tuple(str(j + 1) for j in range(data.n_mode))
    fits: dict[str, tuple[Regression, ...]] = {}
    notes: list[str] = []
    for j, label in enumerate(labels):
        made, said = _fits_of_mode(sets, j, hours, columns)
        notes += [f"{label}{text}" for text in said]
        if made:
            fits[label] = made
    if not fits:
        raise InputError("regression", "no mode can be fitted", f"the first: {notes[0]}")
    rows = [row for label, made in fits.items() for fit in made for row in _table_rows(label, fit)]
    return ModalRegression(fits=fits, table=pd.DataFrame(rows), hours=frozen_array(hours),
                           columns={name: frozen_array(x) for name, x in columns.items()},
                           notes=tuple(dict.fromkeys(notes)))


def _sets_by_time(data: ModalData, state: str | None) -> tuple[list[ModalSet], np.ndarray]:
    """Usable sets of that turbine state by their start, and hours (n_set,) since the first."""
    sets = [s for s in data.sets if not s.environment.get("excluded")]
    sets = [s for s in sets if state is None or s.environment.get("state") == state]
    if not sets:
        raise InputError("regression", f"no usable block in state '{state}'" if state else "no usable block",
                         "name another state, or none")
    hours = hours_of_sets(sets)
    if hours is None:
        other = next((s.id for s in sets if not TIME.match(s.id)), sets[0].id)
        raise InputError("regression", f"sets such as '{other}' are not named by a time",
                         "name sets by their start in UTC, ISO 8601")
    order = np.argsort(hours, kind="stable")
    return [sets[k] for k in order], hours[order]


def hours_of_sets(sets: Sequence[ModalSet]) -> np.ndarray | None:
    """Hours (n_set,) of each since the first, None where they are not named by times: a number is not a year."""
    if not all(TIME.match(s.id) for s in sets):
        return None
    try:
        time = pd.to_datetime([s.id for s in sets], utc=True, format="ISO8601")
    except (ValueError, TypeError):
        return None
    return (time - time.min()).total_seconds().to_numpy() / 3600


def _columns(sets: Sequence[ModalSet], covariates: Sequence[str]) -> dict[str, np.ndarray]:
    """Covariates (n_set,), NaN where a set lacks one. The standard ones may be absent, and that is noted; a name that
    no set knows and nobody listed is a slip."""
    columns = {name: np.array([_number(s.environment.get(name)) for s in sets]) for name in covariates}
    unknown = [name for name in covariates if name not in COVARIATES and not np.isfinite(columns[name]).any()]
    if unknown:
        known = sorted({key for s in sets for key, v in s.environment.items() if np.isfinite(_number(v))})
        raise InputError(f"covariate {unknown[0]}", "is not a number in any set", f"choose from {', '.join(known)}")
    return columns


def _fits_of_mode(
    sets: Sequence[ModalSet], j: int, hours: np.ndarray, columns: Mapping[str, np.ndarray]
) -> tuple[tuple[Regression, ...], list[str]]:
    """The regressions of ln f and of damping that can be made, and what is to be said after the mode's label."""
    f, zeta = np.array([s.frequency_hz[j] for s in sets]), np.array([s.damping_ratio[j] for s in sets])
    # of rounded frequencies the rounding is part of what is stated; where nothing is, of what is found
    rounding = rounding_std(np.array([s.frequency_hz for s in sets]))[j]
    f_std = np.hypot([s.frequency_std_hz[j] for s in sets], rounding) / f
    zeta_std = np.array([s.damping_ratio_std[j] for s in sets])
    made, said = [], []
    for response, value, std in (("ln frequency", np.log(f), f_std), ("damping ratio", zeta, zeta_std)):
        try:
            fit = regress(response, value, hours, columns, std if np.isfinite(std).any() else None)
        except InputError as error:
            said.append(f": {error}")
            continue
        made.append(fit)
        said += [f", {response}: {note}" for note in fit.notes]
    return tuple(made), said


def _number(value) -> float:
    return float(value) if isinstance(value, int | float) else np.nan


def _table_rows(label: str, fit: Regression) -> list[dict]:
    common = {"mode": label, "response": fit.response}
    shape = {name: s.kind for s in fit.shapes for name in s.names}
    constant = {name: (s.constant, s.constant_std) for s in fit.shapes for name in s.names}
    about = {"n": fit.n, "n_outlier": fit.n_outlier, "n_missing": fit.n_missing, "explained": fit.explained,
             "noise_factor": fit.noise_factor, "slow_std": fit.slow_std, "slow_hours": fit.slow_hours}
    rows = [common | {"covariate": "intercept", "coefficient": fit.intercept, "std_error": fit.intercept_std} | about]
    for k, name in enumerate(fit.names):
        rows.append(common | {
            "covariate": name, "coefficient": fit.coefficient[k], "std_error": fit.std_error[k],
            "p_value": fit.p_value[k], "inflation": fit.inflation[k], "covariate_mean": fit.mean[k],
            "covariate_std": fit.spread[k], "shape": shape.get(name, "line"),
            "shape_constant": constant.get(name, (np.nan,) * 2)[0],
            "shape_constant_std": constant.get(name, (np.nan,) * 2)[1],
        } | about)
    return rows
