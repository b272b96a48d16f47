"""What remains before and after the findings, as plain numbers for diagnosis.json: per mode, per channel, along the
record and against its environmental and operational conditions; shifts from the prior; what the sensors say."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg, stats

from probupdate.diagnosis.adequacy import (
    Residual,
    block_sizes,
    chunk_share,
    free_directions,
    push,
    residual_of,
    slope_share,
)
from probupdate.diagnosis.blocks import with_derived
from probupdate.diagnosis.diagnose import Outcome
from probupdate.diagnosis.fitting import Fit
from probupdate.diagnosis.mode_numbers import labels_of
from probupdate.diagnosis.problem import DiagnosisProblem
from probupdate.diagnosis.search import Search
from probupdate.modal.modes import Sensor

# a series over time has at most so many points, all series together so many numbers
MOST_POINTS, MOST_NUMBERS = 400, 9000
# bins of a covariate, with equally many blocks
N_BIN = 8
# components of shapes shown over time: those that move most
N_MOVED = 6
# environmental and operational conditions that residuals are drawn against where they are known, with their units
COVARIATES = {
    "water_level_m": "m", "air_temperature_c": "degC", "wind_speed_mps": "m/s", "thrust_share": "of full thrust",
    "rms_mps2": "m/s2", "wave_height_m": "m", "frost_degc": "degC of frost", "rotor_speed_rpm": "rpm",
}


def residuals(outcome: Outcome, sensors: Sequence[Sensor] = ()) -> dict:
    """All of it as plain numbers for diagnosis.json. `sensors` show which way the axes of a close pair point."""
    problem = outcome.problem
    n_own = len(problem.updated)
    before = residual_of(outcome.null, n_own)
    after = residual_of(outcome.fitted, n_own) if outcome.fitted.included else None
    both = [before] if after is None else [before, after]
    words = _words(problem, sensors)
    return {
        "states": ["before", "after"][: len(both)],
        "n_block": len(problem.blocks),
        "modes": _modes(both, words),
        "channels": _channels(both, problem),
        "bands": [_bands(r, problem) for r in both],
        "time": _time(both, problem, words) | {"sizes": [] if after is None else _sizes(outcome, after)},
        "covariates": _covariates(both, problem, words),
        "prior_shift": _prior_shifts(problem, [outcome.null, outcome.fitted][: len(both)]),
        "sensors": _sensors(problem, sensors),
        "measurement": _measurement(problem, outcome.first),
    }


# Names -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Words:
    """Of one group: its modes, and which of its first responses are ln f (1) or the tensor's 11, 22, 12 (3)."""

    group: str
    parts: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"{self.group} {p}".strip() for p in self.parts)


def _words(problem: DiagnosisProblem, sensors: Sequence[Sensor]) -> tuple[Words, ...]:
    blocks = problem.blocks
    result = []
    for q, group in enumerate(blocks.groups):
        parts: tuple[str, ...] = ("",)
        if len(group) == 2:
            ways = [_direction(problem.predictor.axes[q][:, k], blocks.channels, sensors) for k in range(2)]
            if ways[0] == ways[1]:
                ways = ["axis 1", "axis 2"]
            parts = (*(way or f"axis {k + 1}" for k, way in enumerate(ways)), "coupling")
        result.append(Words(group=blocks.group_name(q), parts=parts))
    return tuple(result)


def _direction(shape: np.ndarray, channels: Sequence[str], sensors: Sequence[Sensor]) -> str | None:
    """Azimuth from the model's x, 0 to 180 deg, of the motion at the highest level, or vertical; None if not known."""
    placed = [(s, channels.index(s.channel)) for s in sensors if s.channel in channels]
    if not placed:
        return None
    top = max(s.position_m[2] for s, _ in placed)
    moved = sum((np.array(s.direction) * shape[k].real for s, k in placed if s.position_m[2] > top - 0.5),
                np.zeros(3))
    if np.linalg.norm(moved) < 1e-3 * np.max(np.abs(shape)):
        return None
    if abs(moved[2]) > np.linalg.norm(moved[:2]):
        return "vertical"
    return f"along {round(np.degrees(np.arctan2(moved[1], moved[0]))) % 180} deg"


def _sensors(problem: DiagnosisProblem, sensors: Sequence[Sensor]) -> list[dict]:
    known = {s.channel: s for s in sensors}
    return [{"channel": c, "level": known[c].level, "position_m": [float(x) for x in known[c].position_m],
             "direction": [float(x) for x in known[c].direction]} for c in problem.blocks.channels if c in known]


# Means over the record ---------------------------------------------------------------------------------------------


def _modes(both: Sequence[Residual], words: Sequence[Words]) -> list[dict]:
    """ln f, or the tensor of a pair, of every group: residual in per cent, standard deviation expected of it, z."""
    rows = []
    for q, word in enumerate(words):
        states_of = [r.share_mean(q, r.mean_share(q)) for r in both]
        for i, name in enumerate(word.names):
            rows.append({"mode": name, "percent": [_three(100 * v[i]) for v, _ in states_of],
                         "expected_percent": [_three(100 * s[i]) for _, s in states_of],
                         "z": [_two(v[i] / s[i]) for v, s in states_of]})
    return rows


def _channels(both: Sequence[Residual], problem: DiagnosisProblem) -> list[dict]:
    """Per mode, channel and part ("in phase", "out of phase"): residual in per cent of the shape's largest component,
    standard deviation expected of it, z."""
    blocks = problem.blocks
    n_channel = len(blocks.channels)
    rows = []
    for q, group in enumerate(blocks.groups):
        states_of = [r.share_mean(q, r.mean_share(q)) for r in both]
        n_log = states_of[0][0].size - 2 * n_channel * len(group)
        for half, part in enumerate(("in phase", "out of phase")):
            for k, mode in enumerate(group):
                at = n_log + (half * len(group) + k) * n_channel
                rows.append({
                    "mode": blocks.labels[mode], "part": part, "channels": list(blocks.channels),
                    "percent": [[_three(100 * x) for x in v[at : at + n_channel]] for v, _ in states_of],
                    "z": [[_two(x) for x in (v / s)[at : at + n_channel]] for v, s in states_of],
                })
    return rows


def _bands(r: Residual, problem: DiagnosisProblem) -> dict:
    """Shares of independent directions within the bands that hold 50 and 90 % of them when nothing is wrong: of the
    means over the record, and of single blocks about them."""
    free = [free_directions(axes, 1 if axes.shape[1] == 1 else 3) for axes in problem.predictor.axes]
    # a group of which no block shows has no directions
    free = [part if w.any() else part[:, :0] for part, w in zip(free, r.design.noise.weight, strict=True)]
    mean, covariance = r.means
    keep = linalg.block_diag(*free)
    white = whiten(keep.T @ covariance @ keep, keep.T @ mean)
    single = []
    for q, part in enumerate(free):
        if not part.size:
            continue
        weight = r.design.noise.weight[q]
        rows = np.flatnonzero(weight > 0)
        if len(rows) < 2:
            continue
        about = (r.left[q][rows] - r.mean_share(q) @ r.left[q]) @ part
        own = part.T @ r.design.noise.covariance[q] @ part
        # a block is part of the mean that was taken off
        size = np.sqrt(1 / weight[rows] - 1 / weight.sum())
        single.append((whiten(own, about.T) / size).ravel())
    return {
        "means": _shares(white) | {"p": _two(stats.chi2.sf(float(white @ white), white.size))},
        "blocks": _shares(np.concatenate(single) if single else np.zeros(0)),
    }


def whiten(covariance: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (n, ...) along the covariance's own directions, over their standard deviations; directions that rounding
    alone fills are left out. Each is scaled by its own standard deviation first, as frequencies and shapes are powers
    of ten apart."""
    variance = np.diag(covariance)
    # beside a turn of which nothing is known what remains of a variance may be rounding
    there = variance > 0
    covariance, values, std = covariance[np.ix_(there, there)], values[there], np.sqrt(variance[there])
    scaled = values / std.reshape(-1, *[1] * (values.ndim - 1))
    value, turn = np.linalg.eigh(covariance / np.outer(std, std))
    kept = value > 1e-9 * value[-1]
    return (turn[:, kept] / np.sqrt(value[kept])).T @ scaled


def _shares(white: np.ndarray) -> dict:
    result = {"directions": int(white.size)}
    if not white.size:
        return result
    for level in (0.5, 0.9):
        inside = np.abs(white) < stats.norm.ppf(0.5 + level / 2)
        expected = [float(stats.binom.ppf(t, white.size, level) / white.size) for t in (0.025, 0.975)]
        name = f"within_{100 * level:.0f}"
        result |= {name: _three(float(inside.mean())), f"{name}_expected": [_three(x) for x in expected]}
    return result


# Along the record --------------------------------------------------------------------------------------------------


def _drawn_residuals(
    both: Sequence[Residual], problem: DiagnosisProblem, words: Sequence[Words]
) -> list[tuple[int, int, str, float]]:
    """(group, response, name, z) of what is drawn over time: frequencies, and the parts of shapes that move most."""
    blocks = problem.blocks
    shown, moved = [], []
    for q, word in enumerate(words):
        shown += [(q, i, name, np.nan) for i, name in enumerate(word.names)]
        labels = labels_of(blocks.group_name(q), len(blocks.groups[q]), blocks.channels)
        largest = np.zeros(len(labels))
        for time_profile in problem.time_profiles:
            if time_profile.kind != "constant":
                value, std = both[0].share_mean(q, slope_share(both[0], q, time_profile.value))
                largest = np.maximum(largest, np.abs(value / std))
        moved += [(q, i, _shape_name(problem, q, i, len(word.names)), float(largest[i]))
                  for i in range(len(word.names), len(labels))]
    return shown + sorted(moved, key=lambda row: -row[3])[:N_MOVED]


def _shape_name(problem: DiagnosisProblem, q: int, response: int, n_log: int) -> str:
    blocks = problem.blocks
    n_channel, group = len(blocks.channels), blocks.groups[q]
    number, channel = divmod(response - n_log, n_channel)
    half, member = divmod(number, len(group))
    part = ("in phase", "out of phase")[half]
    return f"{blocks.labels[group[member]]} at {blocks.channels[channel]}, {part}"


def _time(both: Sequence[Residual], problem: DiagnosisProblem, words: Sequence[Words]) -> dict:
    """Series of what is shown, in per cent about their mean, with the standard deviation expected of each point."""
    blocks = problem.blocks
    shown = _drawn_residuals(both, problem, words)
    most = max(20, min(MOST_POINTS, MOST_NUMBERS // max(1, (len(both) + 1) * len(shown))))
    chunks = np.array_split(np.arange(len(blocks)), min(len(blocks), most))
    masks = [np.isin(np.arange(len(blocks)), p) for p in chunks]
    tables = _tables(both, masks)
    n_tried = sum(y.shape[1] for y in both[0].left) * sum(c.kind != "constant" for c in problem.time_profiles)
    return {
        "start": blocks.ids[0], "hours": [_four(blocks.hours[p].mean()) for p in chunks],
        "blocks_a_point": _three(len(blocks) / len(chunks)),
        "by_chance": _two(stats.norm.isf(0.025 / max(n_tried, 1))),
        "series": [{"name": name, "moved_z": _two(z), **_series(tables, q, i, len(both))} for q, i, name, z in shown],
    }


def _sizes(outcome: Outcome, after: Residual) -> list[dict]:
    """Of every effect taken in: the size that each block by itself shows, one Newton step from the fit and about its
    level; `time_profile` as it was found. `against`: the covariate that the time profile follows, if it follows one."""
    problem = outcome.problem
    blocks = problem.blocks
    rows = []
    for included in outcome.fitted.included:
        number = next(j for j, e in enumerate(problem.effects) if e is included.effect)
        more, std = block_sizes(after, number)
        weight = np.where(np.isfinite(std), std**-2.0, 0.0)
        # an offset of the model is no size: blocks show the time profile about the level of the fit
        more = more - (weight @ more) / weight.sum()
        time_profile, covariate = included.size * included.time_profile.value, included.time_profile.kind == "covariate"
        order = np.argsort(included.time_profile.value, kind="stable") if covariate else np.arange(len(blocks))
        states_of = []
        for p in np.array_split(order, min(len(blocks), MOST_POINTS // 2)):
            total = float(weight[p].sum())
            if total > 0:
                share = weight[p] / total
                states_of.append((blocks.hours[p].mean(), share @ (time_profile + more)[p], total**-0.5,
                                  share @ time_profile[p],
                                  share @ included.time_profile.value[p] + included.time_profile.centre))
        hours, size, size_std, line, against = (list(map(_four, column)) for column in zip(*states_of, strict=True))
        rows.append(
            {
                "cause": included.effect.cause,
                "location": included.effect.location,
                "unit": included.effect.unit,
                "hours": hours,
                "size": size,
                "size_std": size_std,
                "time_profile": line,
                "time_profile_name": included.time_profile.name,
                "against": against if covariate else None,
                "against_unit": COVARIATES.get(included.time_profile.column, "") if covariate else None,
            }
        )
    return rows


def _tables(both: Sequence[Residual], masks: Sequence[np.ndarray]):
    """[state][group] -> per chunk (value (m,), std (m,)) or None."""
    return [[[None if (share := chunk_share(r, q, mask)) is None else r.share_mean(q, share) for mask in masks]
             for q in range(len(r.left))] for r in both]


def _series(tables, q: int, i: int, n_state: int) -> dict:
    values = [[None if cell is None else _three(100 * cell[0][i]) for cell in tables[s][q]] for s in range(n_state)]
    std = [None if cell is None else _two(100 * cell[1][i]) for cell in tables[-1][q]]
    return {"percent": values, "expected_percent": std}


def _covariates(both: Sequence[Residual], problem: DiagnosisProblem, words: Sequence[Words]) -> list[dict]:
    """Frequencies in bins of each covariate that is known and varies, in per cent about their mean, and the z of a
    slope before and after."""
    blocks = with_derived(problem.blocks)
    found = []
    for column, unit in COVARIATES.items():
        values = blocks.covariate(column)
        if values is None:
            continue
        order = np.argsort(values, kind="stable")
        chunks = [p for p in np.array_split(order, min(N_BIN, max(2, len(order) // 4))) if len(p)]
        masks = [np.isin(np.arange(len(blocks)), p) for p in chunks]
        tables = _tables(both, masks)
        series = []
        for q, word in enumerate(words):
            slopes = [r.share_mean(q, slope_share(r, q, values)) for r in both]
            series += [
                {"name": name, **_series(tables, q, i, len(both)), "slope_z": [_two(v[i] / s[i]) for v, s in slopes],
                 "slope_percent": [_three(100 * v[i]) for v, _ in slopes]}
                for i, name in enumerate(word.names)
            ]
        found.append({"column": column, "unit": unit, "centre": [_four(values[p].mean()) for p in chunks],
                      "blocks": [len(p) for p in chunks], "series": series})
    return found


# Shifts from the prior, and what the sensors say
# --------------------------------------------------------------------------


def _prior_shifts(problem: DiagnosisProblem, fits: Sequence[Fit]) -> dict:
    """How far each parameter is shifted, in prior standard deviations, the standard deviation that the data would shift
    it by if the prior were right, and p of all parameters together."""
    names = [problem.predictor.parameters.names[k] for k in problem.updated]
    states_of = [push(problem, f) for f in fits]
    return {
        "parameters": [
            {"name": n, "prior_shift": [_three(p[i]) for p, _, _ in states_of],
             "expected": [_three(e[i]) for _, e, _ in states_of]}
            for i, n in enumerate(names)
        ],
        "p_together": [_two(p) for _, _, p in states_of],
    }


def _measurement(problem: DiagnosisProblem, first: Search) -> list[dict]:
    """The measurement's own tests at the fit of the model as it is: of each cause and time profile the place that
    stands out most, with the number that were tried."""
    groups: dict[tuple[str, str], list[int]] = {}
    for k, (j, c) in enumerate(first.which):
        effect = problem.effects[j]
        if effect.kind == "measurement" and first.usable[k]:
            groups.setdefault((effect.cause, problem.time_profiles[c].name), []).append(k)
    rows = []
    for (cause, time_profile), members in groups.items():
        best = max(members, key=lambda k: first.statistic[k])
        effect = problem.effects[problem.which[best, 0]]
        rows.append({
            "cause": cause, "time_profile": time_profile, "location": effect.location, "z": _three(first.z[best]),
            "size": _three(first.size[best]), "size_std": _three(first.size_std[best]),
            "unit": effect.unit + problem.time_profiles[problem.which[best, 1]].unit, "tolerance": effect.tolerance,
            "tried": len({int(problem.which[k, 0]) for k in members}),
        })
    return rows


def _rounding_to(digits: int) -> Callable[[float], float | None]:
    def rounded(value: float) -> float | None:
        return float(f"{value:.{digits - 1}e}") if np.isfinite(value) else None

    return rounded


_two, _three, _four = _rounding_to(2), _rounding_to(3), _rounding_to(4)
