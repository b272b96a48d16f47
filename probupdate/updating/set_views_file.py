"""sets.json: the four views of a campaign's sets, what they say in words, and the table for a terminal."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from probupdate.errors import InputError
from probupdate.io.files import read_json_table, write_json
from probupdate.io.json_rows import from_table, row_of
from probupdate.io.result_table import OWN_UNIT, table_of
from probupdate.updating.predictive import LeaveOneOut
from probupdate.updating.settings import CONSTANTS

if TYPE_CHECKING:
    import pandas as pd

FORMAT = 1
IDENTIFIED_BITS = CONSTANTS.hyper_prior_bits
RECOMMENDED_SHARE = CONSTANTS.recommended_share
POOLED, ONE, MANY = "each set alone", "one value for all sets", "a population"


@dataclass(frozen=True, kw_only=True)
class SetsRow:
    """One parameter or derived quantity. scatter_*: of the maxima; pooled_*: law of total variance; joint_*: one
    posterior of all sets; mean_*: of the population's middle, tau_*: its scatter between sets (median, 5 and 95 %),
    tau_prior the hyper-prior's median, tau_bits what the data say of it; tau_relative: these are a CoV, of a parameter
    that is positive by its bounds, else standard deviations in `unit`; population_cov: of a set not yet measured,
    uncertainty of the middle included. NaN where it does not apply."""

    name: str
    unit: str
    prior_cov: float
    scatter_mean: float
    scatter_cov: float
    resolution: float
    pooled_mean: float
    pooled_cov: float
    joint_mean: float
    joint_cov: float
    mean: float
    mean_cov: float
    tau: float
    tau_low: float
    tau_high: float
    tau_prior: float
    tau_bits: float
    population_cov: float
    sentence: str
    # files from before this key have all over the mean
    tau_relative: bool = True


@dataclass(frozen=True, kw_only=True)
class ModeScatter:
    """ln f of one mode over the sets: its standard deviation, what identification states (root mean square), the
    variation left (0 where the scatter is less than stated) with its 90 % interval, and p of no variation at all."""

    label: str
    n_set: int
    scatter: float
    stated: float
    variation: float
    low: float
    high: float
    p_value: float


@dataclass(frozen=True, eq=False, kw_only=True)
class SetViews:
    """rows by parameter, then derived quantities; scores: view -> ln p of sets left out; population: how its sampling
    ended; linear_share (n_set,): effective share of draws that the full model confirms; correlation (n_param, n_param):
    the population's, its median, where it was asked for."""

    ids: tuple[str, ...]
    rows: tuple[SetsRow, ...]
    modes: tuple[ModeScatter, ...]
    scores: LeaveOneOut
    converged: bool
    verdict: str
    linear_share: np.ndarray
    correlation: np.ndarray | None
    notes: tuple[str, ...]
    advice: str
    settings: dict[str, str]

    def to_frame(self) -> pd.DataFrame:
        """A row a parameter, then derived quantities."""
        return table_of(self.rows, units=dict.fromkeys(("scatter_mean", "pooled_mean", "joint_mean", "mean"), OWN_UNIT))

    @property
    def summary(self) -> str:
        return summary(self)

    def write(self, path: str | Path) -> Path:
        return write_views(self, path)


def tau_interval(row: SetsRow) -> str:
    """5 to 95 % of tau; an upper limit alone where the sets identify none, or where none at all is as probable."""
    if not np.isfinite(row.tau):
        return ""
    shown = varies(row.tau_bits, row.tau_low, row.tau)
    return f"{row.tau_low:.3f}-{row.tau_high:.3f}" if shown else f"< {row.tau_high:.3f}"


def varies(bits: float, low: float, middle: float) -> bool:
    """Whether the sets show a parameter's variation: tau with its 5 % quantile, and what the data say of it."""
    return bits >= IDENTIFIED_BITS and low >= 0.2 * middle


def parameter_sentence(row: dict) -> str:
    """What the sets say of one parameter's variation."""
    name, unit = row["name"], row["unit"]
    if np.isnan(row["tau"]):
        return f"{name} is one number in all sets, as stated"
    of = "CoV" if row["tau_relative"] else "standard deviation"
    low, mid, high, prior = (f"{row[key]:.2g}{'' if row['tau_relative'] or unit == '-' else f' {unit}'}"
                             for key in ("tau_low", "tau", "tau_high", "tau_prior"))
    if row["tau_bits"] < IDENTIFIED_BITS:
        text = (f"the sets do not identify how {name} varies: tau, its {of} between sets, is below {high} (95 %), "
                f"which is the hyper-prior's own (median {prior})")
        if row["resolution"] < 0.1:
            text += ", nor what it is"
        return text
    if not varies(row["tau_bits"], row["tau_low"], row["tau"]):
        return f"{name} varies between sets by a {of} of at most {high} (95 %), perhaps not at all"
    return f"{name} varies between sets by a {of} of {mid} ({low} to {high})"


def advice(rows: list[SetsRow], scores: LeaveOneOut, linear_share: np.ndarray) -> str:
    """Which view for what, with what the scores say of it; (d) is not recommended where its linearised sets do not
    stand for the full model."""
    gain, error = scores.difference(MANY, ONE)
    varying = [r.name for r in rows if varies(r.tau_bits, r.tau_low, r.tau)]
    better = gain > 2 * error and gain > 1
    by = f"sets left out, ln p of a population over one value {gain:+.1f} +- {error:.1f}"
    if varying:
        which = (f"{', '.join(varying)} {'vary' if len(varying) > 1 else 'varies'} between sets"
                 f"{'' if better else ', more than sets left out could confirm'} ({by}): the structure, or what the "
                 "model lacks, differs from set to set.")
    elif better:
        which = f"Sets differ more than one value explains ({by}), no single parameter clearly so."
    else:
        which = f"No variation between sets shows beyond what is new in each of them ({by})."
    silent_names = [r.name for r in rows if np.isfinite(r.tau_bits) and r.tau_bits < IDENTIFIED_BITS]
    worst = float(np.min(linear_share))
    if worst < RECOMMENDED_SHARE:
        for_life = (f"(d) is not recommended: of its draws an effective share of {100 * worst:.0f} % stands for the "
                    "full model in the worst set; for a lifetime analysis take (b), which is an upper figure.")
    else:
        for_life = ("For a lifetime analysis take (d): the middle with its standard deviation for what is the same in "
                    "all conditions, and the population CoV where every condition (a month, a sea state) has its own "
                    "value; it has the middle's uncertainty, so that nothing is added to it.")
    text = (
        f"{which} {for_life} (c) is the uncertainty of a parameter that cannot "
        "differ between sets, such as a mass; it is too narrow where the structure differs from set to set. An error "
        "of the model that all sets repeat is in (c) and (d), however many the sets are. (b) counts the noise of each "
        "set twice and is an upper figure. (a), the paper's Table 7, says how repeatable an update is, "
        "not how well a parameter is known: with resolution near 0 it is near 0."
    )
    if silent_names:
        text += (f" Of {', '.join(silent_names)} the sets show no variation: there (d) returns its hyper-prior, which "
                 "is an assumption and should be stated as one.")
    return text


def summary(views: SetViews) -> str:
    """The table and the paragraph."""
    width = max(9, *(len(r.name) for r in views.rows))
    head = (f"{'':<{width}} {'prior':>6} | {'(a) mean':>10} {'CoV':>6} | {'(b) mean':>10} {'CoV':>6} | "
            f"{'(c) mean':>10} {'CoV':>6} | {'(d) mean':>10} {'CoV':>6} {'tau':>6} {'5-95 %':>14} {'new CoV':>7}")
    lines = [head]
    for r in views.rows:
        interval = tau_interval(r)
        lines.append(
            f"{r.name:<{width}} {_digits(r.prior_cov)} | {r.scatter_mean:>10.4g} {_digits(r.scatter_cov)} | "
            f"{r.pooled_mean:>10.4g} {_digits(r.pooled_cov)} | {r.joint_mean:>10.4g} {_digits(r.joint_cov)} | "
            f"{r.mean:>10.4g} {_digits(r.mean_cov)} {_digits(r.tau)} {interval:>14} {_digits(r.population_cov):>7}"
        )
    lines.append("(a) scatter of the updates, (b) posteriors pooled, (c) one posterior for all, (d) population: its "
                 "middle, its scatter tau between sets, and the CoV of a set not yet measured")
    absolute = [r.name for r in views.rows if not r.tau_relative and np.isfinite(r.tau)]
    if absolute:
        lines.append(f"tau is a CoV, but of {', '.join(absolute)} a standard deviation in the parameter's unit")
    lines += [r.sentence for r in views.rows if np.isfinite(r.resolution)]
    lines += [f"{m.label}: scatter of f {100 * m.scatter:.3f} %, stated noise {100 * m.stated:.3f} %, variation "
              f"{100 * m.variation:.3f} % ({100 * m.low:.3f} to {100 * m.high:.3f}), p {m.p_value:.2g}"
              for m in views.modes]
    total = {name: float(np.sum(v)) for name, v in views.scores.score.items()}
    lines.append("ln p of sets left out: " + ", ".join(f"{name} {value:.1f}" for name, value in total.items()))
    lines.append(f"population {views.verdict}; {int(views.scores.refitted.sum())} of {len(views.ids)} refitted without "
                 f"their set (Pareto k up to {np.max(views.scores.pareto_k):.2f}); full model confirms a share of "
                 f"{np.min(views.linear_share):.2f} or more")
    return "\n".join([*lines, *views.notes, views.advice])


def _digits(value: float) -> str:
    return f"{value:6.3f}" if np.isfinite(value) else f"{'':6}"


def write_views(views: SetViews, path: str | Path) -> Path:
    path = Path(path)
    scores = {"score": {k: v.tolist() for k, v in views.scores.score.items()},
              "pareto_k": _nulls(views.scores.pareto_k.tolist()), "refitted": views.scores.refitted.tolist()}
    content = {
        "format": FORMAT, "ids": list(views.ids), "rows": [row_of(r) for r in views.rows],
        "modes": [row_of(m) for m in views.modes], "scores": scores, "converged": views.converged,
        "verdict": views.verdict, "linear_share": views.linear_share.tolist(),
        "correlation": None if views.correlation is None else views.correlation.tolist(), "notes": list(views.notes),
        "advice": views.advice, "settings": views.settings,
    }
    return write_json(path, content)


def _nulls(values: list[float]) -> list[float | None]:
    return [v if np.isfinite(v) else None for v in values]


def read_views(path: str | Path) -> SetViews:
    """Read sets.json; raises InputError where it is none."""
    path, again = Path(path), "write it with `probupdate sets`"
    c = read_json_table(path, again, absent=again)
    if isinstance(scores := c.get("scores"), dict):
        c["scores"] = {"ids": c.get("ids"), **scores}
    views = from_table(SetViews, c, path, again, name="sets.json", file_format=FORMAT)
    left_out, ids = views.scores, views.ids
    if any(np.shape(v) != (len(ids),) for v in (*left_out.score.values(), left_out.pareto_k, views.linear_share)):
        raise InputError(str(path), f"does not hold one score for each of its {len(ids)} sets", again)
    return views
