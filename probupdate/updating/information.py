"""Which parameters to update: how well the data identify each, before and after they are used.

Table 2's two metrics with their thresholds; the Fisher information in prior standard deviations; what it leaves of each
prior; bits; the directions the data inform; parameters that do each other's work; a recommended set and what it costs.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from probupdate.errors import InputError
from probupdate.io.files import read_json_table, write_json
from probupdate.io.json_rows import from_table, row_of
from probupdate.io.result_table import OWN_UNIT, table_of
from probupdate.runtime.arrays import frozen_array
from probupdate.updating.identifiability import BLIND, cov_of, gaussian_width
from probupdate.updating.posterior_file import Posterior
from probupdate.updating.predictive import PredictiveCheck, bits_gained
from probupdate.updating.problem import Problem
from probupdate.updating.settings import CONSTANTS

if TYPE_CHECKING:
    import pandas as pd

FORMAT = 1
METRIC_WORDS = ("negligible", "low", "medium", "high")
UNCERTAINTY_FROM = CONSTANTS.uncertainty_from
SENSITIVITY_FROM = CONSTANTS.sensitivity_from
SILENT = CONSTANTS.silent
UPDATE, CARRY, LEAVE = "update", "carry along", "leave at its value"
COMPENSATES = CONSTANTS.compensates
MOST_PAIRS = 8


@dataclass(frozen=True, kw_only=True)
class ParameterInformation:
    """One parameter. cov: of the prior, NaN where the value is zero, and no uncertainty metric then, -1; slope: the
    largest |d ln f / d ln theta| and its mode (where the value is zero, of one prior standard deviation); signal: by
    how many of their standard deviations one prior standard deviation moves the data; contraction, bits: by the
    linearised posterior, all parameters unknown; sampled_*: by draws, NaN without; role: one of UPDATE, CARRY,
    LEAVE."""

    name: str
    unit: str
    value: float
    cov: float
    uncertainty: int
    slope: float
    slope_mode: str
    sensitivity: int
    signal: float
    contraction: float
    bits: float
    sampled_contraction: float
    sampled_bits: float
    role: str


@dataclass(frozen=True, kw_only=True)
class Direction:
    """A combination of parameters, in prior standard deviations, that the data inform by themselves: `gain` is their
    information over that of the prior, `contraction` the width left, `weights` (n_param,) of unit length."""

    gain: float
    contraction: float
    bits: float
    weights: tuple[float, ...]
    text: str


@dataclass(frozen=True, kw_only=True)
class Compensation:
    """Two parameters whose posterior is correlated although their prior is not. cosine: of their effects on all data;
    by_modes: label of a group of modes -> cosine of their effects on its frequencies."""

    first: str
    second: str
    correlation: float
    cosine: float
    by_modes: dict[str, float]
    sentence: str


@dataclass(frozen=True, eq=False, kw_only=True)
class Information:
    """fisher (n_param, n_param) in prior standard deviations; total_bits: of all parameters together, less than the sum
    over parameters where they are identified only together; cost: by how much the widths of the recommended ones
    shrink, at most, when the silent ones are fixed: 1 - ratio. check: whether the prior expected the data
    (`predictive`), or None."""

    rows: tuple[ParameterInformation, ...]
    fisher: np.ndarray
    directions: tuple[Direction, ...]
    pairs: tuple[Compensation, ...]
    total_bits: float
    cost: float
    settings: dict[str, str]
    check: PredictiveCheck | None = None

    def names_with(self, role: str) -> tuple[str, ...]:
        return tuple(r.name for r in self.rows if r.role == role)

    def to_frame(self) -> pd.DataFrame:
        """A row a parameter."""
        return table_of(self.rows, units={"value": OWN_UNIT})

    @property
    def summary(self) -> str:
        return summary(self)

    def write(self, path: str | Path) -> Path:
        return write_information(self, path)


def information(
    problem: Problem, *, theta: np.ndarray | None = None, place: str = "", posterior: Posterior | None = None
) -> Information:
    """Of a problem at theta (default: the initial parameters; the data's standard deviations and modes count, not their
    values).

    All of it but the CoV is of slopes there, and slopes change over a wide prior: `place` says where that is, in words.
    `posterior` adds what was sampled; it may be of some of the parameters only.
    """
    parameters = problem.parameters
    point = np.array(parameters.initial if theta is None else theta, float)
    if point.shape != (len(parameters),):
        raise InputError("theta", f"{point.size} values for {len(parameters)} parameters", "give one a parameter")
    response, sensitivity = problem.sensitivity(point)
    root = np.linalg.cholesky(parameters.covariance)
    white = problem.whiten(sensitivity.T).T
    effect = white @ root
    fisher = effect.T @ effect
    covariance = root @ np.linalg.inv(np.eye(len(point)) + fisher) @ root.T
    width = gaussian_width(covariance, parameters)
    signal = np.linalg.norm(white, axis=0) * parameters.std
    slope, mode, relative = _slopes(problem, response, sensitivity, point)
    rows = []
    for k, p in enumerate(parameters):
        share = p.std / abs(p.initial) if p.initial else float("nan")
        role = LEAVE if signal[k] < SILENT else UPDATE if width[k] <= BLIND else CARRY
        sampled = _sampled_information(posterior, p) if posterior is not None else (float("nan"), float("nan"))
        rows.append(ParameterInformation(
            name=p.name, unit=p.unit, value=float(point[k]), cov=cov_of(p.initial, p.std, p),
            uncertainty=_metric(share, UNCERTAINTY_FROM) if np.isfinite(share) else -1, slope=float(slope[k]),
            slope_mode=problem.mode_labels[problem.used[mode[k]]], sensitivity=_metric(slope[k], SENSITIVITY_FROM),
            signal=float(signal[k]), contraction=float(width[k]), bits=float(-np.log2(width[k])),
            sampled_contraction=sampled[0], sampled_bits=sampled[1], role=role,
        ))
    zero = [p.name for p, r in zip(parameters, relative, strict=True) if not r]
    settings = {
        "set": problem.set_id, "weights": problem.weights.description,
        "evaluated at": place or ("the initial parameters" if theta is None else "the parameters given"),
        "uncertainty metric": f"CoV of the prior from {', '.join(f'{x:g}' for x in UNCERTAINTY_FROM)} on",
        "sensitivity metric": "largest change of ln f for one of ln theta, from "
        f"{', '.join(f'{x:g}' for x in SENSITIVITY_FROM)} on"
        + (f"; for one prior standard deviation of {', '.join(zero)}, whose value is zero" if zero else ""),
    }
    return Information(
        rows=tuple(rows), fisher=frozen_array(fisher), directions=_directions(fisher, parameters.names),
        pairs=_pairs(problem, white, sensitivity, covariance), settings=settings,
        total_bits=float(0.5 * np.linalg.slogdet(np.eye(len(point)) + fisher)[1] / np.log(2)),
        cost=_cost(white, parameters, rows, width),
    )


def _metric(value: float, limits: tuple[float, ...]) -> int:
    return int(np.sum(value >= np.array(limits)))


def _slopes(problem: Problem, response, sensitivity, point):
    """Largest |d ln f / d ln theta| (n_param,), its mode's position among those used, and whether it is relative."""
    n = problem.n_frequency
    frequency = np.ones(n) if problem.weights.frequencies == "log" else response[:n]
    relative = point != 0
    change = np.abs(sensitivity[:n] / frequency[:, None]) * np.where(relative, np.abs(point), problem.parameters.std)
    return change.max(axis=0), change.argmax(axis=0), relative


def _sampled_information(posterior: Posterior, parameter) -> tuple[float, float]:
    """Posterior over prior standard deviation and bits, of a parameter that was sampled."""
    if parameter.name not in posterior.names:
        return float("nan"), float("nan")
    k = posterior.names.index(parameter.name)
    draws, prior = posterior.draws[:, k], parameter.distribution
    return float(draws.std(ddof=1) / prior.std()), bits_gained(prior.cdf(draws), float(posterior.ess[k]))


def _cost(white, parameters, rows, width) -> float:
    keep = [k for k, r in enumerate(rows) if r.role != LEAVE]
    updated = [k for k, r in enumerate(rows) if r.role == UPDATE]
    if not updated:
        return 0.0
    inverse = np.linalg.inv(parameters.covariance[np.ix_(keep, keep)])
    less = np.linalg.inv(white[:, keep].T @ white[:, keep] + inverse)
    ratio = [np.sqrt(less[keep.index(k), keep.index(k)]) / parameters.std[k] / width[k] for k in updated]
    return float(1 - min(ratio))


def _directions(fisher: np.ndarray, names: tuple[str, ...]) -> tuple[Direction, ...]:
    """Those of which the data say at least a tenth of what the prior does."""
    gain, vectors = np.linalg.eigh(fisher)
    found = []
    for k in np.argsort(gain)[::-1]:
        if gain[k] < 0.1:
            break
        v = vectors[:, k] * np.sign(vectors[np.argmax(np.abs(vectors[:, k])), k])
        large = [j for j in np.argsort(np.abs(v))[::-1] if abs(v[j]) >= 0.25]
        text = " ".join(f"{v[j]:+.2f} {names[j]}" for j in large).removeprefix("+")
        found.append(Direction(gain=float(gain[k]), contraction=float(1 / np.sqrt(1 + gain[k])),
                               bits=float(0.5 * np.log2(1 + gain[k])), weights=tuple(v.tolist()), text=text))
    return tuple(found)


def _pairs(problem: Problem, white, sensitivity, covariance) -> tuple[Compensation, ...]:
    parameters = problem.parameters
    std = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(std, std)
    prior = parameters.covariance / np.outer(parameters.std, parameters.std)
    added = np.where(np.abs(prior) < 0.3, np.abs(correlation), 0.0)
    size = np.linalg.norm(white, axis=0)
    found = []
    for i, j in zip(*np.triu_indices(len(parameters), 1), strict=True):
        if added[i, j] < COMPENSATES or not (size[i] and size[j]):
            continue
        first, second = parameters.names[i], parameters.names[j]
        by_modes, start = {}, 0
        for matched, group in zip(problem.matching.groups, problem.groups, strict=True):
            rows = slice(start, start + group.size)
            start += group.size
            a, b = sensitivity[rows, i] * parameters.std[i], sensitivity[rows, j] * parameters.std[j]
            if np.linalg.norm(a) and np.linalg.norm(b):
                by_modes["+".join(problem.mode_labels[m] for m in matched.measured)] = _cosine(a, b)
        cosine = _cosine(white[:, i], white[:, j])
        found.append(Compensation(
            first=first, second=second, correlation=float(correlation[i, j]), cosine=cosine, by_modes=by_modes,
            sentence=_pair_sentence(first, second, float(correlation[i, j]), cosine, by_modes)))
    return tuple(sorted(found, key=lambda c: -abs(c.correlation))[:MOST_PAIRS])


def _cosine(a: np.ndarray, b: np.ndarray) -> float:
    return float(a @ b / np.linalg.norm(a) / np.linalg.norm(b))


def _pair_sentence(first: str, second: str, correlation: float, cosine: float, by_modes: dict[str, float]) -> str:
    same = [label for label, c in by_modes.items() if abs(c) > 0.98]
    apart = [f"{label} ({c:+.2f})" for label, c in by_modes.items() if abs(c) <= 0.98]
    text = f"{first} and {second} (posterior correlation {correlation:+.2f}, effects on all data {cosine:+.2f} alike)"
    if same and not apart:
        return f"{text} have the same effect on every frequency; shapes or the size of the changes distinguish them"
    if same:
        return f"{text} have the same effect on {', '.join(same)}, and are distinguishable on {', '.join(apart)}"
    return f"{text} are distinguishable on {', '.join(apart)}" if apart else text


def summary(found: Information) -> str:
    """The table, the directions, the pairs and the recommendation."""
    width = max(9, *(len(r.name) for r in found.rows))
    lines = [f"{'':<{width}} {'value':>10} {'CoV':>6} {'u':>2} {'slope':>6} {'of':>4} {'s':>2} {'signal':>7} "
             f"{'width':>6} {'bits':>5}  role"]
    for r in found.rows:
        cov = f"{r.cov:6.3f}" if np.isfinite(r.cov) else f"{'-':>6}"
        metric = str(r.uncertainty) if r.uncertainty >= 0 else "-"
        sampled = "" if not np.isfinite(r.sampled_bits) else \
            f" (sampled: width {r.sampled_contraction:.2f}, {r.sampled_bits:.2f} bits)"
        lines.append(f"{r.name:<{width}} {r.value:>10.4g} {cov} {metric:>2} {r.slope:6.3f} {r.slope_mode:>4} "
                     f"{r.sensitivity:>2} {r.signal:7.2f} {r.contraction:6.2f} {r.bits:5.2f}  {r.role}{sampled}")
    lines += [f"{name}: {text}" for name, text in found.settings.items()]
    lines.append("u, s: classes of the uncertainty and the sensitivity metric; slope: the largest sensitivity, and the "
                 "mode that it is of")
    lines.append("signal: shift of the data, in their standard deviations, by one prior standard deviation; width: "
                 "posterior over prior standard deviation, all parameters unknown")
    number = len(found.directions)
    lines.append(f"the data give {found.total_bits:.1f} bits, in {number} directions (prior standard deviations):")
    lines += [f"  {d.bits:5.2f} bits, width {d.contraction:.2f}: {d.text}" for d in found.directions]
    lines += [p.sentence for p in found.pairs]
    lines += recommendation(found)
    if found.check is not None:
        lines += found.check.sentences
    return "\n".join(lines)


def recommendation(found: Information) -> list[str]:
    """A sentence for each role."""
    updated, carried, left = (", ".join(found.names_with(role)) for role in (UPDATE, CARRY, LEAVE))
    lines = [f"recommended: update {updated}" if updated else "the data inform none of these parameters"]
    if carried:
        lines.append("carry along, as their uncertainty moves the data though the data do not identify them: "
                     f"{carried}")
    if left:
        lines.append(f"leave at their values: {left}; fixing them makes no recommended parameter's width smaller by "
                     f"more than {100 * found.cost:.1f} %")
    return lines


def write_information(found: Information, path: str | Path) -> Path:
    path = Path(path)
    content = {
        "format": FORMAT, "rows": [row_of(r) for r in found.rows], "fisher": found.fisher.tolist(),
        "directions": [row_of(d) for d in found.directions], "pairs": [row_of(p) for p in found.pairs],
        "total_bits": found.total_bits, "cost": found.cost, "settings": found.settings,
        "check": None if found.check is None else row_of(found.check) | {
            "responses": [row_of(r) for r in found.check.responses]},
    }
    return write_json(path, content)


def read_information(path: str | Path) -> Information:
    """Read information.json; raises InputError where it is none."""
    path, again = Path(path), "write it with `probupdate inform`"
    c = read_json_table(path, again, absent=again)
    found = from_table(Information, c, path, again, name="information.json", file_format=FORMAT)
    if found.fisher.shape != (len(found.rows), len(found.rows)):
        raise InputError(f"{path}, fisher", f"is {found.fisher.shape} for {len(found.rows)} parameters", again)
    return found
