"""Calibration of damage ratios: virtual turbines whose true damage over the design's is known; a JSON line a turbine,
so that a stopped run goes on.

    python studies/lifetime/calibration.py OUT [--case plain] [--case scour] [--case scour-named] [--turbines 250]
    [--minutes 25] [--jobs 2]

A truth is drawn from the prior of the as-built reference turbine, with every tolerance of the one model drawn
(structure, soil law and profile, rotor-nacelle assembly, sensors), a finer mesh, another clay (strain_50, shear
strength and its gradient of its own) and, every other turbine, Bernoulli-Euler members where the updated model has
Timoshenko's. Its modes are seen with the scatter of one half hour (virtual.modal_noise), not identified from a record;
damping is known. Loads are those of three states of fatigue.toml on one heading. Case `scour` hides 3 m of scour at all
legs in every truth; `scour-named` updates the scour beside the others (prior 0 +- 3 m).

Two intervals are told: "linear", the estimate at the parameters' maximum with the components of the one model, as the
parts in model_factors.csv, and "draws", as the export draws X: parameters from the posterior (weighted draws from
Student t distributions about the maximum), tolerances given them. Of each draw ln X is a fit to solved ones (its error
is told). `tables` at the end says what came out.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
import time
import tomllib
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy import stats

from probupdate.effects.tolerances import TurbineUncertainty
from probupdate.errors import ProbupdateError
from probupdate.lifetime.conditions import read_conditions
from probupdate.lifetime.factors import gains, tolerance_draws
from probupdate.lifetime.fatigue import FatigueModel, fatigue_model
from probupdate.lifetime.fatigue_files import FatigueInput, tolerance_slopes, worst_spots
from probupdate.lifetime.reliability import DamageCurve
from probupdate.modal.labels import mode_character
from probupdate.modal.modes import ModalData, ModalSet
from probupdate.model.parameters import Parameters
from probupdate.structure.description import Description
from probupdate.structure.description_file import parse_description, read_description
from probupdate.structure.load import load_model, model_sensors, reference_model
from probupdate.structure.reduced import reduce_basis
from probupdate.structure.reduced_model import project
from probupdate.updating.discrepancy import weights_by_name
from probupdate.updating.laplace import maximum_a_posteriori
from probupdate.updating.problem import build_problem
from probupdate.virtual.modal_blocks import BLOCK_S, LABELS
from probupdate.virtual.modal_noise import identified_modes

CASES = ("plain", "scour", "scour-named")
SCOUR_M = 3.0
N_SPOT, LEVEL = 6, 1.6448536269514722
SEARCHED = 14
FITTED, DRAWS = 260, 250
# draws a round, rounds, of the posterior; where the prior is cut, as the basis ends there
PROPOSED, ROUNDS, TAIL = 300, 3, 1e-3
# relative error of frequencies on the basis; solutions it is made of, and held against
TOLERANCE, SOLVED = 8e-4, 56
STATES = ("idling, storm", "10 m/s", "19 m/s")
# of the other clay, of the logarithm
CLAY_STD = {"strain_50": 0.25, "at_mudline": 0.15, "gradient_per_m": 0.3}


@dataclass(frozen=True, eq=False, kw_only=True)
class Fit:
    """ln X (n_spot,) as a polynomial of the second degree in ln theta (of what may be zero: theta) and third powers;
    rms (n_spot,) on draws it was not made of."""

    logarithmic: np.ndarray
    centre: np.ndarray
    scale: np.ndarray
    weight: np.ndarray
    rms: np.ndarray

    def terms(self, thetas: np.ndarray) -> np.ndarray:
        with np.errstate(divide="ignore"):
            x = np.where(self.logarithmic, np.log(np.maximum(thetas, 1e-12)), thetas)
        z = (x - self.centre) / self.scale
        first, second = np.triu_indices(z.shape[1])
        return np.column_stack([np.ones(len(z)), z, z[:, first] * z[:, second], z**3])

    def __call__(self, thetas: np.ndarray) -> np.ndarray:
        return self.terms(thetas) @ self.weight

    def slope(self, theta: np.ndarray) -> np.ndarray:
        """(n_spot, n_param), by differences."""
        h = 1e-4 * np.maximum(np.abs(theta), 0.01)
        steps = np.diag(h)
        return ((self(theta + steps) - self(theta - steps)) / (2 * h[:, None])).T


def fitted(few: FatigueModel, curve: DamageCurve, rng: np.random.Generator, n: int) -> Fit:
    thetas = few.parameters.draw(rng, n + n // 5)
    value = np.array([curve.factor(np.log(few.solve(theta).damage_per_year())) for theta in thetas])
    logarithmic = few.parameters.lower > 0
    x = np.where(logarithmic, np.log(np.maximum(thetas, 1e-12)), thetas)
    empty = Fit(
        logarithmic=logarithmic, centre=x.mean(axis=0), scale=x.std(axis=0), weight=np.zeros(0), rms=np.zeros(0)
    )
    weight, *_ = np.linalg.lstsq(empty.terms(thetas[:n]), value[:n], rcond=None)
    made = replace(empty, weight=weight)
    return replace(made, rms=np.sqrt(np.mean((made(thetas[n:]) - value[n:]) ** 2, axis=0)))


@dataclass(frozen=True, eq=False, kw_only=True)
class Bench:
    path: Path
    model: object
    fatigue: FatigueModel
    curve: DamageCurve
    direct: np.ndarray
    fast: object
    fit: Fit


def model_file(folder: Path, case: str) -> Path:
    """The file that is updated: the as-built reference; with the scour named, sc is updated too."""
    text = reference_model("as_built").read_text(encoding="utf-8")
    if case == "scour-named":
        head, tail = text.split('name = "sc"', 1)
        own, rest = tail.split("[[parameter]]", 1)
        own = own.replace("update = false", "update = true").replace("std = 1.0", "std = 3.0")
        text = f'{head}name = "sc"{own}[[parameter]]{rest}'
    path = folder / f"model.{'named' if case == 'scour-named' else 'own'}.toml"
    path.write_text(text, encoding="utf-8")
    return path


@cache
def make_bench(folder: Path, case: str) -> Bench:
    """What all turbines of a case share; `plain` and `scour` are one. Its fit and slopes are kept in the folder."""
    rng = np.random.default_rng(5)
    path = model_file(folder, case)
    model = load_model(path)
    model = replace(model, uncertainty=TurbineUncertainty.from_description(path, model, None, None))
    conditions = one_direction()
    full = fatigue_model(read_description(path), str(path), conditions)
    draws = full.parameters.draw(rng, 12)
    start = full.reduce(draws[:3])
    design = start.solve(full.parameters.initial)
    spots = [*worst_spots(start, design.damage_per_year(), N_SPOT - 1)]
    girth = [k for k, s in enumerate(full.spots) if s.side == "weld"]
    spots.append(girth[int(np.argmax(design.damage_per_year()[girth]))])
    few = full.select(spots).reduce(draws)
    curve = DamageCurve.from_stress(few.solve(few.parameters.initial))
    kept = folder / f"direct.{'named' if case == 'scour-named' else 'own'}.npy"
    if not kept.exists():
        given = FatigueInput(file=Path("fatigue.toml"), problem=_Shell(model), laplace=_At(few.parameters.initial))
        np.save(kept, tolerance_slopes(path, few, given, {}))
    kept_fit = folder / f"fit.{'named' if case == 'scour-named' else 'own'}.npz"
    if not kept_fit.exists():
        one = fitted(few, curve, rng, FITTED)
        np.savez(kept_fit, **{name: getattr(one, name) for name in Fit.__dataclass_fields__})
    with np.load(kept_fit) as held:
        fit = Fit(**{name: held[name] for name in Fit.__dataclass_fields__})
    sys.stdout.write(f"{case}: fit of ln X misses by {np.round(fit.rms, 4).tolist()}\n")
    sys.stdout.flush()
    return Bench(
        path=path,
        model=model,
        fatigue=few,
        curve=curve,
        direct=np.load(kept),
        fast=fast_model(model, np.random.default_rng(6), kept.with_name(kept.name.replace("direct", "basis"))),
        fit=fit,
    )


def fast_model(model, rng, kept: Path):
    """The model on a reduced basis over its prior, cut at TAIL. The basis with its families of symmetry is kept in a
    file: one that was verified is projected on again."""
    ends = np.array([p.distribution.ppf([TAIL, 1 - TAIL]) for p in model.parameters])
    points = np.clip(model.parameters.draw(rng, 200), *ends.T)
    box = ends[:, 0], ends[:, 1]
    if not kept.exists():
        found = reduce_basis(
            model,
            n_mode=SEARCHED,
            box=box,
            points=points,
            seed=0,
            frequency_tolerance=TOLERANCE,
            n_snapshot=SOLVED,
            n_verify=SOLVED,
        )
        family = np.zeros(found.basis.shape[1], int)
        for number, block in enumerate(found.blocks):
            family[block.rows] = number
        np.save(kept, np.vstack([family, found.basis]))
    family, *rows = np.load(kept)
    return project(model, np.array(rows), family.astype(int), box, SEARCHED, TOLERANCE).with_shares(points)


def posterior_draws(problem, top, rng, n: int = PROPOSED, rounds: int = ROUNDS) -> tuple[np.ndarray, np.ndarray, float]:
    """Equally weighted draws (n, n_param), the responses there (n, n_response), and how many the weights are worth:
    Student t distributions fitted in turn, in ln theta of what is positive (a joint's flexibility goes with 1 / LJF, so
    that its posterior is skew), else in prior standard deviations. The prior is cut where the basis ends."""
    own = problem.parameters
    logarithmic = own.lower > 0

    def theta_of(u):
        return np.where(logarithmic, np.exp(np.where(logarithmic, u, 0.0)), u * own.std)

    mean = np.where(logarithmic, np.log(np.maximum(top.theta, 1e-12)), top.theta / own.std)
    rate = np.where(logarithmic, 1 / top.theta.clip(1e-12), 1 / own.std)
    covariance = 2.0 * top.covariance * np.outer(rate, rate)
    drawn, values, sources = np.zeros((0, len(mean))), np.zeros(0), []
    responses = np.zeros((0, problem.measured.size))
    for _ in range(rounds):
        t = stats.multivariate_t(mean, covariance, df=4)
        drawn = np.vstack([drawn, np.atleast_2d(t.rvs(n, random_state=rng))])
        fresh = theta_of(drawn[-n:])
        inside = own.inside(fresh) & problem.model.covers(fresh)
        value, response = np.full(n, -np.inf), np.zeros((n, problem.measured.size))
        if inside.any():
            jacobian = np.sum(np.where(logarithmic, np.log(np.maximum(fresh[inside], 1e-300)), 0.0), axis=1)
            response[inside] = problem.predict_many(fresh[inside]).response
            misfit = problem.misfit(response[inside])
            value[inside] = own.log_density(fresh[inside]) - 0.5 * misfit + jacobian
        responses = np.vstack([responses, response])
        values, sources = np.append(values, value), [*sources, t]
        mixture = np.logaddexp.reduce([s.logpdf(drawn) for s in sources])
        log_weight = values - mixture
        weight = np.exp(log_weight - log_weight.max())
        soft = weight**0.5 if _effective(weight) < 60 else weight
        mean = soft @ drawn / soft.sum()
        covariance = 1.3 * (soft[:, None] * (drawn - mean)).T @ (drawn - mean) / soft.sum() + 1e-8 * np.eye(len(mean))
    chosen = rng.choice(len(drawn), size=n, p=weight / weight.sum())
    return theta_of(drawn[chosen]), responses[chosen], _effective(weight)


def _effective(weight: np.ndarray) -> float:
    return float(weight.sum() ** 2 / np.sum(weight**2))


@cache
def as_built():
    """The reference model as built with its tolerances."""
    model = load_model(reference_model("as_built"))
    path = reference_model("as_built")
    return replace(model, uncertainty=TurbineUncertainty.from_description(path, model, None, None))


class _Shell:
    """What tolerance_slopes asks of a problem before there is one."""

    def __init__(self, model):
        self.model = model
        self.error_sources = model.uncertainty.sources


class _At:
    def __init__(self, theta):
        self.theta = theta


def one_direction():
    known = read_conditions(Path(__file__).with_name("fatigue.toml"))
    chosen = [s for s in known.state if s.name in STATES]
    whole = sum(s.share for s in chosen)
    return known.model_copy(
        update={
            "direction": (known.direction[0].model_copy(update={"share": 1.0}),),
            "state": tuple(s.model_copy(update={"share": s.share / whole}) for s in chosen),
        }
    )


def truth(bench: Bench, case: str, number: int, rng: np.random.Generator) -> tuple[Description, np.ndarray, dict]:
    """The true turbine's description with everything in its initial values, theta, and the sensors' errors in standard
    deviations by source."""
    raw = tomllib.loads(reference_model("as_built").read_text(encoding="utf-8"))
    own = as_built()
    theta, names = own.parameters.draw(rng, 1)[0], own.parameters.names
    for p in raw["parameter"]:
        p["update"] = p["name"] == names[0]
        if p["name"] in names:
            p["initial"] = float(theta[names.index(p["name"])])
            p["lower"], p["upper"] = min(p["lower"], p["initial"]), max(p["upper"], p["initial"])
        if p["name"] == "sc" and case.startswith("scour"):
            p["initial"] = SCOUR_M
    raw["mesh"]["elements_per_member"] = {
        "leg": 2,
        "brace": 3,
        "pile": 12,
        "column": 2,
        "strut": 2,
        "tie": 2,
        "tower": 12,
    }
    raw["mesh"]["theory"] = "timoshenko" if number % 2 else "bernoulli-euler"
    strength = raw["soil"]["undrained_shear_strength_pa"]
    raw["soil"]["strain_50"] *= float(np.exp(CLAY_STD["strain_50"] * rng.standard_normal()))
    for key in ("at_mudline", "gradient_per_m"):
        strength[key] *= float(np.exp(CLAY_STD[key] * rng.standard_normal()))
    errors = {}
    for row in own.uncertainty.tolerances:
        e, std = row.effect, row.source.std
        value = float(np.clip(e.neutral + row.source.mean + std * rng.standard_normal(), e.lower, e.upper))
        raw["parameter"].append(e.table() | {"initial": value, "update": False})
    for source in bench.model.uncertainty.of_sensors.sources:
        errors[source.name] = rng.standard_normal()
    return parse_description(raw, f"truth {number}"), theta, errors


def measured(bench: Bench, fatigue: FatigueModel, errors: dict, rng: np.random.Generator) -> ModalData:
    """One half hour's modes of the truth at its sensors."""
    model = fatigue.models[0].model
    sensors = model_sensors(bench.path)
    solution = model.solve(model.parameters.initial, SEARCHED)
    labels = mode_character(solution.shape, sensors).labels
    if missing := [label for label in LABELS if label not in labels]:
        raise ProbupdateError(f"the truth has no {missing[0]}")
    chosen = [labels.index(label) for label in LABELS]
    f, shape = solution.frequency_hz[chosen], solution.shape[:, chosen]
    for e in bench.model.uncertainty.of_sensors.effects:
        amount = e.tolerance * errors[f"{e.cause}: {e.location}"]
        shape = np.column_stack([e.observe(shape[:, j : j + 1], float(f[j]), amount)[0][:, 0] for j in range(len(f))])
    hz, zeta, phi, covariance_factors = identified_modes(
        f, np.full(len(f), 0.01), shape.astype(complex), LABELS, BLOCK_S, rng)
    one = ModalSet(
        id="0",
        frequency_hz=hz,
        damping_ratio=zeta,
        shape=phi,
        covariance_factors=covariance_factors,
        environment={},
        frequency_std_hz=np.full(len(hz), np.nan),
        shape_std=np.full(phi.shape, np.nan),
    )
    return ModalData(channels=tuple(s.channel for s in sensors), sets=(one,), labels=LABELS)


def turbine(bench: Bench, case: str, number: int, rounds: int = ROUNDS) -> dict:
    """One line: true and estimated ln damage ratio of every hot spot, and what the intervals' standard deviations
    are."""
    rng = np.random.default_rng([20, CASES.index(case) if case != "scour-named" else 1, number])
    begun, line = time.process_time(), {"case": case, "number": number}
    try:
        description, theta, errors = truth(bench, case, number, rng)
        one = Parameters((description_parameter(description),))
        whole = fatigue_model(
            description,
            f"truth {number}",
            bench.fatigue.conditions,
            parameters=one,
            sensors=bench.fatigue.models[0].sensors,
        )
        names = {(whole.details[s.detail].name, s.side, s.place): k for k, s in enumerate(whole.spots)}
        whole = whole.select(
            [names[bench.fatigue.details[s.detail].name, s.side, s.place] for s in bench.fatigue.spots]
        )
        data = measured(bench, whole, errors, rng)
        true = whole.reduce([]).solve(one.initial)
        line |= {"true": bench.curve.factor(np.log(true.damage_per_year())).tolist(), "theta": theta.tolist()}
        # the floors alone: an estimated discrepancy was zero in each of the first dozen
        weights = weights_by_name("measured", data)
        start = bench.model.parameters.initial
        first = build_problem(bench.model, data, weights=replace(weights, tolerances=False)).with_model(bench.fast)
        place = maximum_a_posteriori(first, [start]).theta
        problem = build_problem(bench.model, data, weights=replace(weights, at=tuple(map(float, place)))).with_model(
            bench.fast
        )
        top = maximum_a_posteriori(problem, [place])
        mean, slope = bench.fit(top.theta[None])[0], bench.fit.slope(top.theta)
        gain = gains(problem, top)
        line["map"] = top.theta.tolist()
        line["linear"] = [mean.tolist(), np.sqrt(sum(v**2 for v in gain.parts(slope, bench.direct).values())).tolist()]
        drawn, response, line["effective"] = posterior_draws(problem, top, rng, rounds=rounds)
        drawn, response = drawn[:DRAWS], response[:DRAWS]
        value = bench.fit(drawn) + tolerance_draws(problem, drawn, rng, response=response) @ bench.direct.T
        value = value + bench.fit.rms * rng.standard_normal(value.shape)
        line["draws"] = np.quantile(value, [0.05, 0.95], axis=0).tolist()
        line["draws_mean"], line["draws_std"] = value.mean(axis=0).tolist(), value.std(axis=0).tolist()
        prior = np.hypot(
            *(
                np.sqrt(np.sum((x * s) ** 2, axis=1))
                for x, s in ((slope, bench.fatigue.parameters.std), (bench.direct, gain.source_std))
            )
        )
        line["prior"] = [np.zeros(len(mean)).tolist(), prior.tolist()]
    except ProbupdateError as error:
        line["refused"] = f"{type(error).__name__}: {error}"
    line["cpu_seconds"] = round(time.process_time() - begun, 2)
    return line


def description_parameter(description: Description):
    from probupdate.structure.description import updatable_parameters

    return next(iter(updatable_parameters(description, "truth")))


def read_lines(path: Path) -> list[dict]:
    if not path.exists():
        return []
    return [json.loads(text) for text in path.read_text(encoding="utf-8").split("\n")[:-1]]


def of_case(folder: Path, case: str) -> list[dict]:
    return [line for path in sorted(folder.glob(f"{case}.*.jsonl")) for line in read_lines(path)]


def tables(folder: Path) -> str:
    """Coverage of 90 % intervals with its standard error, by case and kind, all hot spots together and each."""
    rows = [
        "| case | turbines | interval | coverage of 90 % | by hot spot | median std of ln X | RMS error | bias |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for case in CASES:
        lines = of_case(folder, case)
        good = [line for line in lines if "refused" not in line]
        if not good:
            continue
        true = np.array([line["true"] for line in good])
        for kind in ("draws", "linear", "prior"):
            one, two = (np.array([line[kind][k] for line in good]) for k in (0, 1))
            inside = (true > one) & (true < two) if kind == "draws" else np.abs(true - one) < LEVEL * two
            mean, std = (
                (one, two)
                if kind != "draws"
                else (np.array([line["draws_mean"] for line in good]), np.array([line["draws_std"] for line in good]))
            )
            own = inside.mean(axis=1)
            error = own.std(ddof=1) / np.sqrt(len(own)) if len(own) > 1 else float("nan")
            rows.append(
                f"| {case} | {len(good)} ({len(lines) - len(good)} refused) | {kind} | {100 * inside.mean():.1f} ± "
                f"{100 * error:.1f} % | {', '.join(f'{100 * x:.0f}' for x in inside.mean(axis=0))} | "
                f"{np.median(std):.4f} | {np.sqrt(np.mean((true - mean) ** 2)):.4f} | {np.mean(mean - true):+.4f} |"
            )
    return "\n".join(rows)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--case", action="append", choices=CASES)
    parser.add_argument("--turbines", type=int, default=250)
    parser.add_argument("--minutes", type=float, default=25.0)
    parser.add_argument(
        "--rounds", type=int, default=ROUNDS, help=f"of {PROPOSED} draws of each posterior; more of them for its tails"
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes, after what they share is made")
    a = parser.parse_args()
    a.out.mkdir(parents=True, exist_ok=True)
    end = time.monotonic() + 60 * a.minutes
    benches = {case: make_bench(a.out, "plain" if case == "scour" else case) for case in a.case or CASES}

    def work(part: int) -> None:
        for number in range(part, a.turbines, a.jobs):
            for case, bench in benches.items():
                if time.monotonic() > end or number in {line["number"] for line in of_case(a.out, case)}:
                    continue
                path = a.out / f"{case}.{part}of{a.jobs}.jsonl"
                line = turbine(bench, case, number, a.rounds)
                # without the half line of a killed process
                path.write_text("".join(json.dumps(x) + "\n" for x in [*read_lines(path), line]), encoding="utf-8")
                sys.stdout.write(f"{case} {number}: {line['cpu_seconds']} s {line.get('refused', '')}; at most "
                                 f"{max(end - time.monotonic(), 0) / 60:.0f} min left\n")
                sys.stdout.flush()

    workers = [multiprocessing.get_context("fork").Process(target=work, args=(k,)) for k in range(a.jobs)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    sys.stdout.write(tables(a.out) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
