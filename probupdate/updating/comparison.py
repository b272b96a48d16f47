"""Where the deterministic update and the posterior part, and why: one row and one sentence for each parameter."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from probupdate.errors import InputError
from probupdate.io.files import read_json_table, write_json
from probupdate.io.json_rows import from_table
from probupdate.io.result_table import OWN_UNIT, table_of
from probupdate.modal.modes import set_words
from probupdate.updating.identifiability import (
    BLIND,
    PARTLY,
    PRIOR,
    STRONG,
    cov_of,
    gaussian_width,
    identifiability,
    is_too_narrow,
    sampled_width,
    too_narrow_sentence,
)
from probupdate.updating.posterior_file import Posterior
from probupdate.updating.settings import CONSTANTS
from probupdate.updating.update_file import BLIND_RESOLUTION, UpdateRecord, fit_sentence, gaussian_kinds, is_unproven

if TYPE_CHECKING:
    import pandas as pd

FORMAT = 1
CLOSE = CONSTANTS.close
SAME = CONSTANTS.same
HIGH_CORRELATION = CONSTANTS.high_correlation
RIDGE = CONSTANTS.ridge


# of a row's numbers those in the parameter's unit
IN_UNIT = ("prior_mean", "prior_std", "initial", "step", "anchored", "map", "mean", "median", "std", "low", "high",
           "nine_mean")


@dataclass(frozen=True, kw_only=True)
class ComparisonRow:
    """One parameter. `step`, `anchored` are the ends of Eq. 7 as printed and anchored; low, high the 5 and 95 %
    quantiles; distances are from the posterior mean in posterior standard deviations; contraction is the posterior over
    the prior standard deviation (of the prior as cut by its bounds); nine_* the updates of all sets, total_cov by the
    law of total variance; resolution the diagonal R_jj at the maximum."""

    name: str
    unit: str
    prior_mean: float
    prior_std: float
    initial: float
    step: float
    anchored: float
    map: float
    mean: float
    median: float
    std: float
    cov: float
    low: float
    high: float
    skewness: float
    step_distance: float
    anchored_distance: float
    map_distance: float
    contraction: float
    resolution: float
    nine_mean: float
    nine_cov: float
    total_cov: float
    identified: str
    flags: tuple[str, ...]
    sentence: str


@dataclass(frozen=True, eq=False, kw_only=True)
class Comparison:
    """rows by parameter; correlation (n_param, n_param) of the posterior; derived: quantity -> estimate -> value, with
    "mean" and "cov" of the posterior; notes: what holds for the whole, uncertain things first."""

    names: tuple[str, ...]
    rows: tuple[ComparisonRow, ...]
    correlation: np.ndarray
    derived: Mapping[str, Mapping[str, float]]
    notes: tuple[str, ...]
    converged: bool
    settings: Mapping[str, str] = field(default_factory=dict)

    def to_frame(self) -> pd.DataFrame:
        """A row a parameter; what is about its value in its `unit`, shares and distances without."""
        return table_of(self.rows, units=dict.fromkeys(IN_UNIT, OWN_UNIT))

    @property
    def summary(self) -> str:
        width = max(5, *(len(r.name) for r in self.rows))
        columns = "".join(f" {name:>10}" for name in ("Eq. 7", "anchored", "MAP", "mean"))
        head = f"{'':<{width}} {'prior':>16}{columns} {'CoV':>7} {'width':>6} {'R':>5}  identifiability"
        lines = [head]
        for r in self.rows:
            prior = f"{r.initial:.4g}+-{r.prior_std:.2g}"
            lines.append(
                f"{r.name:<{width}} {prior:>16} {r.step:>10.4g} {r.anchored:>10.4g} {r.map:>10.4g} {r.mean:>10.4g} "
                f"{r.cov if np.isfinite(r.cov) else '-':>7.3} {r.contraction:>6.2f} {r.resolution:>5.2f}  "
                f"{'; '.join((r.identified, *r.flags))}"
            )
        lines.append("Eq. 7: the sensitivity-based update as the paper prints it, anchored: with its penalty on the "
                     "distance from the prior; MAP and mean: of the posterior; width: posterior over prior standard "
                     "deviation, both within the bounds (+- above); R: share of the MAP that the data determine "
                     "(resolution); identifiability: by the posterior's draws")
        return "\n".join([*lines, *self.notes])

    def write(self, path: str | Path) -> Path:
        return write_comparison(self, path)


def compare(
    update: UpdateRecord, posterior: Posterior, derived: Mapping[str, Callable[[np.ndarray], float]] | None = None
) -> Comparison:
    """Put both estimators side by side. `derived` (quantity -> callable of theta) is evaluated over the posterior.

    Raises InputError where the two belong to different problems: other model, data, weights or prior.
    """
    if update.fingerprint != posterior.fingerprint:
        raise InputError(
            "the posterior", f"does not fit the update: it is of {_difference(update, posterior)}",
            "run `update` and `sample` with the same --model, --modes, --set and weights",
        )
    draws = posterior.draws
    correlation = np.corrcoef(draws.T) if draws.shape[1] > 1 else np.ones((1, 1))
    width = sampled_width(draws, update.parameters)
    rows = tuple(
        _row(k, update, posterior, float(width[k]), correlation[k]) for k in range(len(posterior.names))
    )
    values: dict[str, dict[str, float]] = {name: dict(states) for name, states in update.derived.items()}
    for name, compute in (derived or {}).items():
        chosen = draws[:: max(1, len(draws) // 200)]
        found = np.array([compute(theta) for theta in chosen])
        values.setdefault(name, {}).update(mean=float(found.mean()), cov=_cov(found))
        if update.sets is not None and name in update.sets.derived:
            each = update.sets.derived[name]
            values[name].update(nine_mean=float(each.mean()), nine_cov=_cov(each))
    return Comparison(
        names=posterior.names, rows=rows, correlation=correlation, derived=values,
        notes=tuple(_notes(update, posterior, rows)), converged=posterior.converged,
        settings={"weights": update.settings.get("weights", ""), "set": update.set_id},
    )


def _cov(values: np.ndarray) -> float:
    """Standard deviation over |mean|, NaN where the mean is zero."""
    mean = float(np.mean(values))
    return float(np.std(values, ddof=1)) / abs(mean) if mean else float("nan")


def _row(
    k: int, update: UpdateRecord, posterior: Posterior, contraction: float, correlation: np.ndarray
) -> ComparisonRow:
    from scipy import stats

    parameter, draws = update.parameters.items[k], posterior.draws[:, k]
    mean, std = float(draws.mean()), float(draws.std(ddof=1))
    prior_mean, prior_std = (float(x[k]) for x in update.parameters.moments)
    step, anchored = float(update.scheme("step").theta[-1, k]), float(update.scheme("prior").theta[-1, k])
    top = float(update.map_theta[k])
    others = np.where(np.arange(len(correlation)) == k, 0.0, correlation)
    partner = int(np.argmax(np.abs(others)))
    low, high = np.quantile(draws, [0.05, 0.95])
    flags = []
    if update.map_at_bound[k]:
        side = "lower" if abs(top - parameter.lower) <= abs(parameter.upper - top) else "upper"
        flags.append(f"pinned at its {side} bound at the MAP")
    for key, name in (("step", "Eq. 7 as printed"), ("prior", "the anchored update")):
        if update.scheme(key).at_bound[k] and not update.map_at_bound[k]:
            flags.append(f"{name} ends at a bound")
    if abs(others[partner]) > HIGH_CORRELATION:
        flags.append(f"absorbed by {posterior.names[partner]}: correlation {others[partner]:+.2f}")
    narrow = _too_narrow(update, posterior)[k]
    width = max(contraction, gaussian_width(update.map_covariance, update.parameters)[k]) if narrow else contraction
    if narrow:
        flags.append("too narrow: see the notes")
    identified = identifiability(width, at_bound=bool(update.map_at_bound[k]), unproven=is_unproven(update),
                                 description=parameter.description)
    if width < STRONG and identified == PARTLY:
        flags.append("its narrow interval rests on the stated standard deviations, which this fit does not confirm")
    sets = update.sets
    row: dict[str, Any] = dict(
        name=parameter.name, unit=parameter.unit, prior_mean=prior_mean, prior_std=prior_std,
        initial=parameter.initial, step=step, anchored=anchored, map=top, mean=mean, median=float(np.median(draws)),
        std=std, cov=cov_of(mean, std, parameter), low=float(low), high=float(high),
        skewness=float(stats.skew(draws)), step_distance=(step - mean) / std, anchored_distance=(anchored - mean) / std,
        map_distance=(top - mean) / std, contraction=contraction, resolution=float(update.map_resolution[k]),
        nine_mean=float(sets.theta_map[:, k].mean()) if sets else float("nan"),
        nine_cov=float(sets.cov[k]) if sets else float("nan"),
        total_cov=cov_of(float(sets.theta_map[:, k].mean()), float(sets.total_std[k]), parameter) if sets else (
            float("nan")),
        identified=identified, flags=tuple(flags),
    )
    sentence = _sentence(row, parameter, update, posterior.names[partner], float(others[partner]))
    return ComparisonRow(sentence=sentence, **row)


def _sentence(row: dict, parameter, update: UpdateRecord, partner: str, correlation: float) -> str:
    """Why the estimates part, or that they do not."""
    name, parts = row["name"], []
    if row["identified"] == PRIOR:
        parts.append(f"the data do not inform {name}: its posterior is {100 * row['contraction']:.0f} % as wide as its "
                     "prior")
    gap = abs(row["map_distance"])
    if gap > CLOSE:
        reason = _mean_beside_map(row, parameter, partner, correlation)
        parts.append(f"MAP and mean differ by {gap:.1f} posterior standard deviations: {reason}")
    if abs(row["anchored"] - row["map"]) > SAME * row["std"]:
        away = abs(row["anchored"] - row["map"]) / row["std"]
        parts.append(f"the anchored update ends {away:.2f} posterior standard deviations from the MAP: "
                     f"{_anchored_beside_map(update)}")
    apart = abs(row["step"] - row["map"]) / row["std"]
    if apart > CLOSE:
        text = (f"Eq. 7 as printed ends {apart:.1f} posterior standard deviations from the MAP: it penalises the step, "
                f"and after {len(update.scheme('step').theta) - 1} iterations has forgotten the prior")
        if row["resolution"] < 0.5:
            text += " that the data do not replace"
        parts.append(text)
    parts += _width_beside_resolution(row)
    if not parts:
        return f"All estimates of {name} agree within {CLOSE:g} posterior standard deviations."
    text = "; ".join(parts)
    return text[0].upper() + text[1:] + "."


def _mean_beside_map(row: dict, parameter, partner: str, correlation: float) -> str:
    """Why the posterior's mean is not its maximum."""
    if any("pinned" in flag for flag in row["flags"]):
        return "the density is highest at the bound while its mass lies inside"
    cut = abs(row["prior_mean"] - parameter.initial) > 0.1 * row["prior_std"]
    if row["identified"] == PRIOR and cut:
        return f"the bounds cut the prior, whose mean is {row['prior_mean']:.3g} for a mode of {parameter.initial:.3g}"
    if abs(row["skewness"]) > 0.3:
        return f"the posterior is skewed ({row['skewness']:+.1f})"
    if abs(correlation) > RIDGE:
        return f"the posterior is a ridge with {partner} (correlation {correlation:+.2f}), whose top is not its middle"
    return "other parameters' bounds and skewness shift the mass along with them"


def _anchored_beside_map(update: UpdateRecord) -> str:
    """Why the update that is anchored at the prior does not end at the maximum."""
    scheme = update.scheme("prior")
    if scheme.alpha != 1:
        return f"alpha is {scheme.alpha:g}, not 1"
    other = sorted({p.prior for p in update.parameters} - {"normal"})
    if other:
        return f"Eq. 6 knows Gaussian priors only, the posterior has {' and '.join(other)} ones"
    if not scheme.converged:
        return f"the update did not converge ({scheme.status})"
    return "it converged to another maximum"


def _width_beside_resolution(row: dict) -> list[str]:
    """Where the posterior's width and what the data determine at the maximum say different things."""
    if row["resolution"] < BLIND_RESOLUTION and row["contraction"] < BLIND:
        return [f"narrower than its prior ({100 * row['contraction']:.0f} %) though the data hardly determine it at "
                f"the maximum (resolution {row['resolution']:.2f}): bounds and curvature away from the maximum do it"]
    if row["resolution"] > STRONG and row["contraction"] > BLIND:
        return [f"as wide as its prior ({100 * row['contraction']:.0f} %) though the data determine it at the "
                f"maximum (resolution {row['resolution']:.2f}): another one does the same, "
                "or the maximum is not typical"]
    return []


def _notes(update: UpdateRecord, posterior: Posterior, rows: tuple[ComparisonRow, ...]) -> list[str]:
    notes = [posterior.verdict] if not posterior.converged else []
    notes.append(fit_sentence(update))
    pinned = [r.name for r in rows if any("pinned" in f for f in r.flags)]
    if pinned:
        notes.append(f"pinned at a bound at the MAP: {', '.join(pinned)}; their results depend on those bounds")
    notes += [f"{r.name} has no CoV, as its mean is within two standard deviations of zero: {r.mean:.3g} +- "
              f"{r.std:.2g} {'' if r.unit == '-' else r.unit}".rstrip() for r in rows if np.isnan(r.cov)]
    approximate = np.sqrt(np.diag(update.map_covariance))
    notes += [too_narrow_sentence(row.name, row.std, _of_sources(update)[k], approximate[k])
              for k, row in enumerate(rows) if _too_narrow(update, posterior)[k]]
    notes += _otherwise_at_the_map(update, rows)
    printed = update.scheme("step")
    worst = max(rows, key=lambda r: abs(r.step - r.map) / r.std)
    ended = "" if printed.converged else "did NOT converge, so that its column holds no estimate; it "
    notes.append(
        f"Eq. 7 as printed {ended}passes closest to the MAP at iteration {printed.closest_iteration} "
        f"({printed.distance_to_map[printed.closest_iteration]:.2f} posterior standard deviations a parameter) "
        f"and ends {printed.distance_to_map[-1]:.2f} away; farthest is {worst.name}, "
        f"{abs(worst.step - worst.map) / worst.std:.2f}"
    )
    anchored = update.scheme("prior")
    notes.append(f"the anchored update ends {anchored.distance_to_map[-1]:.1e} posterior standard deviations from the "
                 "MAP")
    if update.sets is not None:
        notes.append(
            f"CoVs over {len(update.sets.ids)} sets show how updates scatter, not how uncertain a parameter is: "
            "one that the data do not inform hardly scatters (see its resolution)"
        )
    notes += list(update.left_out)
    return notes


def _of_sources(update: UpdateRecord) -> np.ndarray:
    """(n_param,) standard deviation of the estimate by the model's stated error sources."""
    parts = update.components
    return np.zeros(len(update.parameters)) if parts is None else np.linalg.norm(parts.source_std, axis=0)


def _too_narrow(update: UpdateRecord, posterior: Posterior) -> np.ndarray:
    return is_too_narrow(np.std(posterior.draws, axis=0, ddof=1), _of_sources(update)[None],
                         np.sqrt(np.diag(update.map_covariance)), update.map_theta, update.parameters)


def _otherwise_at_the_map(update: UpdateRecord, rows: tuple[ComparisonRow, ...]) -> list[str]:
    """Where `update` says otherwise of a parameter: the same scale, of the only width that it has."""
    kinds = gaussian_kinds(update)
    other = [f"{r.name} {kinds[r.name]}" for r in rows if kinds[r.name] != r.identified]
    return [f"by the Gaussian approximation at the MAP, as `update` has it, {', '.join(other)}: it knows neither "
            "bounds nor skewness, the draws do"] if other else []


def _difference(update: UpdateRecord, posterior: Posterior) -> str:
    """What the posterior is of that the update is not, as far as both files name it."""
    if update.parameters.names != posterior.names:
        return f"other parameters: {', '.join(posterior.names)}; the update of {', '.join(update.parameters.names)}"
    weights = update.settings.get("weights")
    named = [(set_words(str(posterior.record.get("set_id", update.set_id))), set_words(update.set_id)),
             (f"model {posterior.record.get('model', update.model)}", f"model {update.model}"),
             # which a set of its own may change
             (f"weights '{posterior.record.get('weights', weights)}'", f"weights '{weights}'")]
    said = next((f"{its}, the update of {own}" for its, own in named if its != own), None)
    return said or ("the same set, and of another model of that name, prior or modes file, or of other numbers for "
                    "the weights")


def write_comparison(comparison: Comparison, path: str | Path) -> Path:
    path = Path(path)
    content = {
        "format": FORMAT, "names": list(comparison.names), "rows": [_nulls(asdict(r)) for r in comparison.rows],
        "correlation": comparison.correlation.tolist(),
        "derived": {k: _nulls(v) for k, v in comparison.derived.items()}, "notes": list(comparison.notes),
        "converged": comparison.converged, "settings": dict(comparison.settings),
    }
    return write_json(path, content)


def _nulls(table: Mapping) -> dict:
    return {k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in table.items()}


def read_comparison(path: str | Path) -> Comparison:
    """Read compare.json; raises InputError where it is none, or its parts do not fit together."""
    path, again = Path(path), "write it again with `probupdate compare`"
    content = read_json_table(path, again, absent="write it with `probupdate compare`")
    found = from_table(Comparison, content, path, again, name="compare.json", file_format=FORMAT)
    n = len(found.names)
    if tuple(r.name for r in found.rows) != found.names or found.correlation.shape != (n, n):
        raise InputError(str(path), f"its rows or its correlation do not fit its {n} parameters", again)
    return found
