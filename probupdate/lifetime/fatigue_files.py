"""Fatigue and reliability of an export: fatigue.csv, its sensitivities, model_factors.csv, reliability.csv."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from probupdate.lifetime.conditions import Conditions
from probupdate.lifetime.factors import PARTS, Gains, gains, tolerance_draws, variance_shares
from probupdate.lifetime.fatigue import (
    SLOPES,
    FatigueModel,
    SpotDamage,
    Stress,
    basis_error,
    damage_at_many,
    fatigue_model,
    fatigue_model_of,
)
from probupdate.lifetime.model_files import DrawnModels
from probupdate.lifetime.reliability import (
    DamageCurve,
    Reliability,
    life_quantiles,
    reliability,
    simulated_index,
    survival,
)
from probupdate.lifetime.stress import StateDamping
from probupdate.model.parameters import Parameters
from probupdate.runtime.progress import Progress, silent
from probupdate.structure.description_file import read_description
from probupdate.structure.extend import extended_description
from probupdate.updating.laplace import Laplace
from probupdate.updating.problem import Problem

# sides of details whose reliability is computed, the worst first; years for which FORM is simulated
WORST, PRIOR_DRAWS, CAUSE_DRAWS = 12, 60, 30
SIMULATED = 40_000
BASIS_OF = 10
# what to measure next: so many lines
MEASURES = 6
# differences with respect to tolerances, in their standard deviations
STEP = 0.02
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


@dataclass(frozen=True, eq=False, kw_only=True)
class NamedCause:
    """A cause that the diagnosis named: the extended model's file, its draws, and which parameter is the cause."""

    path: Path
    names: tuple[str, ...]
    draws: np.ndarray
    causes: tuple[tuple[str, str], ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class FatigueInput:
    """What fatigue needs beside the draws: fatigue.toml, the one model's problem with its maximum (None: no modes lie
    in the run), set-wise updates (n_set, n_param), and named causes. left_out: why those of a diagnosis are not there,
    '' where it has none or they are."""

    file: Path
    problem: Problem | None = None
    laplace: Laplace | None = None
    set_updates: np.ndarray | None = None
    named: NamedCause | None = None
    left_out: str = ""

    @property
    def updated(self) -> tuple[Problem, Laplace] | None:
        """Problem and maximum; None where no modes lie in the run."""
        return None if self.problem is None or self.laplace is None else (self.problem, self.laplace)


@dataclass(frozen=True, eq=False, kw_only=True)
class FatigueResult:
    """model: all hot spots; design, draws: their damage; worst (n,): hot spots whose reliability is computed;
    factors ln X_dyn of the worst: mean and std (n,), parts; indices by case; left_out."""

    model: FatigueModel
    design: SpotDamage
    draws: tuple[SpotDamage, ...]
    worst: np.ndarray
    curve: DamageCurve
    log_factor: Mapping[str, tuple[np.ndarray, np.ndarray]]
    parts: Mapping[str, np.ndarray] | None
    slope: np.ndarray
    direct: np.ndarray | None
    gains: Gains | None
    index: Mapping[str, Reliability]
    measures: tuple[tuple[str, np.ndarray, Reliability], ...]
    summary: Mapping[str, object]
    left_out: tuple[str, ...]


def assess(
    given: FatigueInput,
    path: Path,
    full: FatigueModel,
    drawn: DrawnModels,
    dampings: Sequence[StateDamping],
    *,
    seed: int,
    progress: Progress = silent,
) -> FatigueResult:
    """Of `full`, the model at `path`: fatigue and reliability at the design (initial parameters, the file's damping),
    over the prior and over the drawn models, each with its tolerances and damping ratios."""
    draws, unknown = drawn.theta[:, : drawn.n_own], drawn.unknown
    rng = np.random.default_rng(seed)
    parameters = full.parameters
    prior = parameters.draw(rng, PRIOR_DRAWS)
    half = BASIS_OF // 2
    model = full.reduce([*draws[rng.permutation(len(draws))[:half]], *prior[:half]])
    design = model.solve(parameters.initial)
    planned = SpotDamage.from_stress(design)
    wide, own = _models_of_draws(full, path, drawn, rng) if drawn.effects else (full, model)
    updated = damage_at_many(own, drawn.theta, dampings, progress)
    worst = worst_spots(model, np.maximum(planned.per_year, np.mean([s.per_year for s in updated], axis=0)), WORST)
    curve = DamageCurve.from_stress(_select_spots(model, design, worst))
    few = model.select(worst)
    left_out: list[str] = []
    factor = {
        "updated": [curve.factor(np.log(s.per_year[worst])) for s in updated],
        "design": [curve.factor(np.log(few.solve(theta).damage_per_year())) for theta in prior],
    }
    damping = StateDamping.mean(dampings)
    mean = draws.mean(axis=0)
    about_mean = full.select(worst).reduced_for_derivatives(mean)
    slope = about_mean.solve(mean, damping, derivatives=True).equivalent_change(SLOPES[1]).T
    parts, direct, gain = None, None, None
    if given.updated is None:
        left_out.append("parts of model factors: no modes lie in the run, or none of them is matched")
    else:
        parts, direct, gain = _variance_parts(given, path, few, slope, damping, progress)
        if direct is not None:
            problem = given.updated[0]
            unknown = tolerance_draws(problem, draws, rng) if unknown is None else unknown
            # models that were drawn with their tolerances have them in their stresses
            fitted = np.zeros_like(unknown) if drawn.effects else unknown
            factor = _with_tolerances(factor, direct, problem, fitted, rng)
    moments = _moments(factor, None if parts is None else parts["set_to_set"])
    if given.named is not None:
        moments |= _with_causes(given.named, given.file, few, curve, dampings, progress, left_out)
    c = model.conditions
    index = {name: _index(curve, *m, c) for name, m in moments.items()}
    agreement = _agreement(curve, moments["updated"], index["updated"], c, rng)
    return FatigueResult(
        model=model, design=planned, draws=tuple(updated), worst=worst, curve=curve, log_factor=moments, parts=parts,
        slope=slope, direct=direct, gains=gain, index=index,
        measures=_next_measurements(given, slope, direct, parts, curve, moments["updated"], c),
        left_out=tuple(left_out),
        summary={
            "basis_error": basis_error(wide, own, [drawn.theta[-1]]), "form_minus_monte_carlo": agreement[0],
            "monte_carlo_standard_error": agreement[1], "target_annual_index": c.target.annual_index,
            "cases": list(index)},
    )


def _models_of_draws(
    full: FatigueModel, path: Path, drawn: DrawnModels, rng: np.random.Generator
) -> tuple[FatigueModel, FatigueModel]:
    """With the tolerances that are drawn as parameters behind its own, whole and on a basis; of the same hot spots,
    though the mesh may be finer. Without them frequencies are not those measured, and with these damage is another."""
    first = full.models[0]
    wide = fatigue_model(extended_description(path, drawn.effects), str(path), full.conditions,
                         parameters=drawn.model.parameters, sensors=first.sensors, spectra=first.spectra)
    wide = wide.select(matching_spots(wide, full))
    return wide, wide.reduce(drawn.theta[rng.permutation(len(drawn.theta))[:BASIS_OF]])


def _variance_parts(
    given: FatigueInput, path: Path, few: FatigueModel, slope: np.ndarray, damping, progress: Progress
) -> tuple[dict[str, np.ndarray], np.ndarray | None, Gains]:
    """Parts of the variance of ln X_dyn of `few` hot spots by the one model; d ln DEL_5 / d u of its sources of error,
    None where it has none; what moves its estimate."""
    if given.updated is None:
        raise ValueError("parts of a variance are those about a maximum: give the problem and its maximum")
    gain = gains(*given.updated)
    direct = tolerance_slopes(path, few, given, damping, progress) if gain.sources else None
    parts = gain.parts(slope, direct)
    parts["set_to_set"] = _scatter_between_sets(slope, given.set_updates, parts["measurement"])
    return parts, direct, gain


def _with_tolerances(
    factor: Mapping[str, list[np.ndarray]], direct: np.ndarray, problem: Problem, unknown: np.ndarray, rng
) -> dict[str, list[np.ndarray]]:
    """ln X_dyn of every draw with what tolerances add to it: given the data, of the updated; as stated, of the
    design."""
    updated, design = np.array(factor["updated"]), np.array(factor["design"])
    stated = np.array([s.std for s in problem.error_sources])
    drawn = stated * rng.standard_normal((len(design), len(stated)))
    return {"updated": list(updated + unknown @ direct.T), "design": list(design + drawn @ direct.T)}


def _moments(
    factor: Mapping[str, list[np.ndarray]], set_to_set: np.ndarray | None
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Mean and standard deviation of ln X_dyn over the draws; set_to_set: the updated one's from set to set."""
    moments = {name: (np.mean(v, axis=0), np.std(v, axis=0, ddof=1)) for name, v in factor.items()}
    if set_to_set is not None:
        # what holds from set to set is in no single set's draws
        moments["updated"] = (moments["updated"][0], np.hypot(moments["updated"][1], set_to_set))
    return moments


def _index(curve: DamageCurve, mean: np.ndarray, std: np.ndarray, c: Conditions) -> Reliability:
    return reliability(curve, mean, std, c.uncertainty, years=c.life.years, target=c.target.annual_index)


def _next_measurements(
    given: FatigueInput, slope: np.ndarray, direct: np.ndarray | None, parts: Mapping[str, np.ndarray] | None,
    curve: DamageCurve, moments: tuple[np.ndarray, np.ndarray], c: Conditions,
) -> tuple[tuple[str, np.ndarray, Reliability], ...]:
    """What to measure next: standard deviation of ln X_dyn that it leaves, and the reliability then. What varies from
    set to set no single measurement takes away."""
    if given.updated is None:
        return ()
    mean, std = moments
    set_to_set = 0.0 if parts is None else parts["set_to_set"] ** 2
    found = []
    for what, share in variance_shares(*given.updated, slope, direct)[:MEASURES]:
        left = np.sqrt(np.maximum(std**2 - set_to_set, 0.0) * (1 - share) + set_to_set)
        found.append((what, left, _index(curve, mean, left, c)))
    return tuple(found)


def worst_spots(model: FatigueModel, damage: np.ndarray, n: int) -> np.ndarray:
    """(n,) hot spots of most damage (n_spot,), one of each side of a detail, the worst first."""
    seen, found = set(), []
    for k in np.argsort(-damage):
        key = (model.spots[k].detail, model.spots[k].side)
        if key not in seen:
            seen.add(key)
            found.append(int(k))
        if len(found) == n:
            break
    return np.array(found)


def _select_spots(model: FatigueModel, stress: Stress, spots: np.ndarray) -> Stress:
    return Stress(owner=model.select(spots), responses=stress.responses, moments=stress.moments[..., spots])


def _scatter_between_sets(slope: np.ndarray, updates: np.ndarray | None, measurement: np.ndarray) -> np.ndarray:
    """Scatter of single sets' updates beyond what identification explains, (n_quantity,)."""
    if updates is None or len(updates) < 3:
        return np.zeros(len(slope))
    scatter = np.std(updates @ slope.T, axis=0, ddof=1)
    return np.sqrt(np.maximum(scatter**2 - measurement**2, 0.0))


def tolerance_slopes(
    path: Path, few: FatigueModel, given: FatigueInput, damping, progress: Progress = silent
) -> np.ndarray:
    """d ln DEL_5 / d u (n_spot, n_source) per unit of each source, by differences of a fiftieth of a standard
    deviation from the maximum, under the heading of the largest share; zero of sensors' sources, which load nothing."""
    if given.updated is None:
        raise ValueError("tolerances have an effect about a maximum: give the problem and its maximum")
    problem, laplace = given.updated
    uncertainty = getattr(problem.model, "uncertainty", None)
    rows = getattr(uncertainty, "tolerances", ())
    if uncertainty is None or not rows:
        # a SubDyn model's TOML states none of the structure
        return np.zeros((len(few.spots), len(problem.error_sources)))
    base = few.parameters
    description = extended_description(path, [row.effect for row in rows])
    model = uncertainty.extended
    by_name = {p.name: p for p in model.parameters}
    parameters = Parameters((*base, *(by_name[row.effect.name] for row in rows)))
    most = max(few.conditions.direction, key=lambda d: d.share)
    one = few.conditions.model_copy(update={"direction": (most.model_copy(update={"share": 1.0}),)})
    wide = fatigue_model(
        description, str(path), one, parameters=parameters, sensors=few.models[0].sensors, spectra=few.models[0].spectra
    )
    neutral = np.array([*laplace.theta, *(row.effect.neutral for row in rows)])
    # steps of a fiftieth of a tolerance change no mode's name
    wide = wide.select(matching_spots(wide, few)).reduced_for_derivatives(neutral).labelled_at(neutral)
    std = np.array([row.source.std for row in rows])
    n = len(base)
    found = np.zeros((len(few.spots), len(problem.error_sources)))
    names = [s.name for s in problem.error_sources]
    middle = np.log(wide.solve(neutral, damping).equivalent_mpa(SLOPES[1]))
    for k, row in enumerate(rows):
        progress("tolerances' effect on stress", k, len(rows))
        theta, step = neutral.copy(), STEP * std[k]
        theta[n + k] += step if neutral[n + k] + step <= row.effect.upper else -step
        there = np.log(wide.solve(theta, damping).equivalent_mpa(SLOPES[1]))
        found[:, names.index(row.source.name)] = (there - middle) / (theta[n + k] - neutral[n + k])
    progress("tolerances' effect on stress", len(rows), len(rows))
    return found


def matching_spots(other: FatigueModel, own: FatigueModel) -> list[int]:
    """Numbers of `own`'s hot spots in another model of the turbine, whose mesh may be finer."""
    number = {(other.details[s.detail].name, s.side, s.place): k for k, s in enumerate(other.spots)}
    return [number[own.details[s.detail].name, s.side, s.place] for s in own.spots]


def _with_causes(
    named: NamedCause, file: Path, few: FatigueModel, curve: DamageCurve, dampings: Sequence[StateDamping],
    progress: Progress, left_out: list[str],
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """ln X_dyn of `few` hot spots with one named cause as it was found and the others away: mean, standard
    deviation."""
    description = read_description(named.path)
    model = fatigue_model_of(named.path, file)
    if tuple(model.parameters.names) != tuple(named.names):
        left_out.append(f"causes in reliability.csv: {named.path.name} has other parameters than its posterior")
        return {}
    few = model.select(matching_spots(model, few))
    draws = named.draws[np.linspace(0, len(named.draws) - 1, CAUSE_DRAWS).astype(int)]
    few = few.reduce([*draws[:: max(1, CAUSE_DRAWS // BASIS_OF)]])
    found = {}
    neutral = {p.name: p.initial for p in description.effects}
    places = [few.parameters.index(n) for n, _ in named.causes]
    for name, words in named.causes:
        at = few.parameters.index(name)
        values = []
        for k, theta in enumerate(draws):
            progress(f"with {words}", k, len(draws))
            one = np.array(theta)
            for other in places:
                one[other] = neutral.get(few.parameters.names[other], one[other]) if other != at else one[other]
            values.append(curve.factor(np.log(few.solve(one, dampings[k % len(dampings)]).damage_per_year())))
        found[f"with {words}"] = np.mean(values, axis=0), np.std(values, axis=0, ddof=1)
    return found


def _agreement(curve, moments, index: Reliability, c: Conditions, rng) -> tuple[float, float]:
    """Largest difference of FORM's and Monte Carlo's cumulative index at the worst hot spot, at the present age, and at
    the horizon; and the standard error there."""
    mean, std = (m[:1] for m in moments)
    simulated, error = simulated_index(
        curve.select([0]), mean, std, c.uncertainty, years=c.life.years, n=SIMULATED, rng=rng
    )
    gap = np.abs(simulated - index.cumulative[:1])
    k = int(np.argmax(gap))
    return float(gap.ravel()[k]), float(error.ravel()[k])


def frequency_factors(
    given: FatigueInput,
    labels: Sequence[Sequence[str]],
    frequency_hz: Sequence[np.ndarray],
    design: tuple[Sequence[str], np.ndarray],
    gain: Gains | None,
    label_modes,
) -> list[dict]:
    """Rows of model_factors.csv: X = frequency at the draws over that at the design, for modes that all have.
    label_modes: ModalSolution -> labels."""
    slope, direct = np.zeros((0, 0)), None
    at: Sequence[str] = ()
    if gain is not None and given.problem is not None:
        model, n = given.problem.model, len(design[0])
        one = model.solve(gain.theta, n, derivatives=True)
        at, slope = label_modes(one), one.both_derivatives[0] / one.frequency_hz[:, None]
        unknown = getattr(model, "uncertainty", None)
        if gain.sources and unknown is not None:
            direct = unknown.changes(gain.theta, n, ()).frequency_derivative / one.frequency_hz[:, None]
    rows = []
    for k, label in enumerate(design[0]):
        if not all(label in own for own in labels):
            continue
        ratio = np.log([f[list(own).index(label)] / design[1][k] for own, f in zip(labels, frequency_hz, strict=True)])
        row = {
            "quantity": "frequency",
            "of": label,
            "bias": float(np.exp(ratio.mean())),
            "cov": float(ratio.std(ddof=1)) if len(ratio) > 1 else 0.0,
        }
        if gain is not None and label in at:
            j = list(at).index(label)
            parts = gain.parts(slope[j : j + 1], None if direct is None else direct[j : j + 1])
            row |= {name: float(v[0]) for name, v in parts.items()}
            scatter = _scatter_between_sets(slope[j : j + 1], given.set_updates, parts["measurement"])
            row["set_to_set"] = float(scatter[0])
        rows.append(row)
    return rows


def write_fatigue(files, result: FatigueResult, draws: np.ndarray, solved_factors: Sequence[dict]) -> None:
    """hot_spots.csv, fatigue.csv, fatigue_sensitivity.csv, model_factors.csv, reliability.csv, remaining_life.csv."""
    _write_hot_spots(files, result.model)
    _write_ranges(files, result)
    _write_sensitivity(files, result)
    _write_factors(files, result, solved_factors)
    _write_reliability(files, result)
    _write_next_measurements(files, result)
    _write_remaining_life(files, result)


def _write_hot_spots(files, model: FatigueModel) -> None:
    text = {"unit": "-", "type": "string"}
    files.table(
        "hot_spots.csv",
        [
            {"name": "hot_spot", "unit": "-"},
            {"name": "joint", **text},
            {"name": "member", **text},
            {"name": "side", **text},
            {"name": "place", "unit": "-"},
            {"name": "angle_deg", "unit": "deg"},
            {"name": "level_m", "unit": "m"},
            {"name": "axial", "unit": "-"},
            {"name": "crown", "unit": "-"},
            {"name": "saddle", "unit": "-"},
            {"name": "curve", **text},
            {"name": "thickness_effect", "unit": "-"},
        ],
        [
            [
                k + 1,
                model.details[s.detail].joint,
                model.details[s.detail].name,
                s.side,
                s.place,
                s.angle_deg(),
                float(model.details[s.detail].level_m),
                *map(float, s.weight),
                s.curve,
                s.thickness_effect,
            ]
            for k, s in enumerate(model.spots)
        ],
        what="hot spots; place 1 is the crown (of a girth weld: along x), 3 the saddle; axial, crown, saddle: factors "
        "of nominal stress; thickness_effect: by which ranges are multiplied for damage, not in del_m3 and del_m5",
    )


def _write_ranges(files, result: FatigueResult) -> None:
    first, rows = result.design, []
    for number, one in enumerate((first, *result.draws)):
        block = np.column_stack([*one.equivalent_mpa, *one.equivalent_mpa / first.equivalent_mpa, one.per_year,
                                 one.per_year / first.per_year])
        rows += [[number, k + 1, *row] for k, row in enumerate(block.tolist())]
    files.table(
        "fatigue.csv",
        [
            {"name": "draw", "unit": "-"},
            {"name": "hot_spot", "unit": "-"},
            {"name": "del_m3", "unit": "MPa"},
            {"name": "del_m5", "unit": "MPa"},
            {"name": "ratio_m3", "unit": "-"},
            {"name": "ratio_m5", "unit": "-"},
            {"name": "damage_per_year", "unit": "1/a"},
            {"name": "damage_ratio", "unit": "-"},
        ],
        rows,
        what="damage-equivalent ranges and Miner's sum of a year; draw 0 is the design, ratios are updated over design",
    )


def _write_sensitivity(files, result: FatigueResult) -> None:
    parameters = result.model.parameters
    files.table(
        "fatigue_sensitivity.csv",
        [
            {"name": "hot_spot", "unit": "-"},
            *({"name": f"dlnDEL_d{p.name}", "unit": f"1/({p.unit})"} for p in parameters),
        ],
        [[int(k) + 1, *row] for k, row in zip(result.worst, result.slope.tolist(), strict=True)],
        what="d ln DEL_5 / d parameter at the draws' mean, of the worst hot spots",
    )


def _write_factors(files, result: FatigueResult, solved_factors: Sequence[dict]) -> None:
    columns = [
        {"name": "quantity", "unit": "-", "type": "string"},
        {"name": "of", "unit": "-", "type": "string"},
        {"name": "bias", "unit": "-"},
        {"name": "cov", "unit": "-"},
        *({"name": f"cov_{p}", "unit": "-", "type": ["number", "null"]} for p in PARTS),
    ]
    rows = [[f["quantity"], f["of"], f["bias"], f["cov"], *(f.get(p) for p in PARTS)] for f in solved_factors]
    mean, std = result.log_factor["updated"]
    for j, k in enumerate(result.worst):
        spot = result.model.spots[k]
        parts = [None] * len(PARTS) if result.parts is None else [float(result.parts[p][j]) for p in PARTS]
        rows.append(
            [
                "stress range",
                f"hot spot {k + 1}: {result.model.details[spot.detail].name}, {spot.side}, {spot.place}",
                float(np.exp(mean[j])),
                float(std[j]),
                *parts,
            ]
        )
    files.table(
        "model_factors.csv",
        columns,
        rows,
        what="X_dyn, updated over design: bias is the median of X, cov the standard deviation of ln X, its parts those "
        "of the one model in squares; of frequency and damping cov is that of the draws",
    )


def _write_reliability(files, result: FatigueResult) -> None:
    rows = []
    for name, index in result.index.items():
        for j, k in enumerate(result.worst):
            first = int(index.first_below[j]) or None
            rows += [
                [name, int(k) + 1, int(year), float(index.cumulative[j, t]), float(index.annual[j, t]), first]
                for t, year in enumerate(index.year)
            ]
    target = result.model.conditions.target.annual_index
    files.table(
        "reliability.csv",
        [
            {"name": "case", "unit": "-", "type": "string"},
            {"name": "hot_spot", "unit": "-"},
            {"name": "year", "unit": "a"},
            {"name": "cumulative_index", "unit": "-"},
            {"name": "annual_index", "unit": "-"},
            {"name": "first_year_below_target", "unit": "a", "type": ["integer", "null"]},
        ],
        rows,
        what=f"reliability indices of the {len(result.worst)} worst hot spots, by FORM; target: annual {target:g}; "
        "empty: not within the years",
    )


def _write_next_measurements(files, result: FatigueResult) -> None:
    if not result.measures:
        return
    rows = [
        [
            what,
            int(k) + 1,
            float(result.log_factor["updated"][1][j]),
            float(left[j]),
            int(result.index["updated"].first_below[j]) or None,
            int(index.first_below[j]) or None,
        ]
        for what, left, index in result.measures
        for j, k in enumerate(result.worst)
    ]
    files.table(
        "next_measurement.csv",
        [
            {"name": "measure", "unit": "-", "type": "string"},
            {"name": "hot_spot", "unit": "-"},
            {"name": "cov_now", "unit": "-"},
            {"name": "cov_then", "unit": "-"},
            {"name": "first_year_below_target_now", "unit": "a", "type": ["integer", "null"]},
            {"name": "first_year_below_target_then", "unit": "a", "type": ["integer", "null"]},
        ],
        rows,
        what="standard deviation of ln X_dyn now and with one more measurement, its median held: what it is worth on "
        "average, as far as the variance goes",
    )


def _write_remaining_life(files, result: FatigueResult) -> None:
    c, age = result.model.conditions, result.model.conditions.life.age_years
    # no crack at an inspection: failure is as much later as the damage was smaller
    proven = age if c.inspection is None else max(age, c.inspection.age_years / c.inspection.detectable_share)
    rows = []
    for name, (mean, std) in result.log_factor.items():
        lives = life_quantiles(result.curve, mean, std, c.uncertainty, np.array(QUANTILES), survived_years=proven)
        now = np.full((result.curve.n_spot, 1), np.log(max(age, 1e-9)))
        log_survival = survival(result.curve, mean, std, c.uncertainty, now)[:, 0]
        index = result.index[name]
        # what is known to be survived has no years below the target
        below = (index.annual < c.target.annual_index) & (index.year > proven)
        rows += [
            [name, int(k) + 1, *(lives[j] - age).tolist(), float(np.exp(log_survival[j])),
             max(float(index.year[np.argmax(below[j])]) - 1, proven) - age if below[j].any() else None]
            for j, k in enumerate(result.worst)
        ]
    condition = f"given that it stands at the age of {age:g} years"
    if c.inspection is not None:
        condition += (f" and that no crack was found at {c.inspection.age_years:g} years, where one would have been "
                      f"seen from {c.inspection.detectable_share:g} of the damage at failure on")
    files.table(
        "remaining_life.csv",
        [
            {"name": "case", "unit": "-", "type": "string"},
            {"name": "hot_spot", "unit": "-"},
            *({"name": f"q{round(100 * q):02d}", "unit": "a"} for q in QUANTILES),
            {"name": "survival_to_age", "unit": "-"},
            {"name": "years_to_target", "unit": "a", "type": ["number", "null"]},
        ],
        rows,
        what=f"quantiles of years from now to failure, {condition}; survival_to_age: its probability before that was "
        f"known; years_to_target: years from now until the annual index, given the same, falls below "
        f"{c.target.annual_index:g}, empty where it does not within {c.life.years} years of life",
    )
