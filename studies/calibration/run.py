"""Simulation-based calibration of the whole chain; a JSON line a replicate, so that a stopped run goes on.

    python studies/calibration/run.py OUT --case turbine-paper-normal --replicates 300 [--part 0 --parts 2]

A case is structure-noise-prior (see `chain`); `--theory bernoulli-euler` updates a model whose members do not give way
in shear, as the virtual turbine's do, with the same draws (in a folder of its own). Several processes share a case by
`--part`; `tables.py OUT` says what came out. Replicate k of a case has the same numbers whoever computes it, in
whichever order.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from chain import CARRIED, NOISES, PRIORS, RECORDED, STRUCTURES, Bench, make_bench, measure
from posterior import Pool, gaussian_rank, make_pool, place_of_truth, printed_interval, set_wise_scatter

from probupdate.cli.terminal import time_left
from probupdate.errors import InputError, ProbupdateError
from probupdate.updating.laplace import Laplace, maximum_a_posteriori
from probupdate.updating.problem import Problem, Weights, build_problem

# with the paper's noise every so many replicates have deterministic updates too; one in so many nine sets
MAXIMUM_EVERY, NINE_EVERY = 5, 20


def replicate(bench: Bench, pool: Pool, case: str, number: int) -> dict:
    """One line: what was drawn and where it lies; `refused` where the measured modes are not the model's."""
    structure, noise, prior = case.split("-")
    full, fast = bench.with_prior(prior)
    stream = np.random.SeedSequence([STRUCTURES.index(structure), NOISES.index(noise), PRIORS.index(prior), number])
    rng = np.random.default_rng(stream)
    theta = full.parameters.draw(rng, 1)[0]
    line = {"case": case, "number": number, "names": list(full.parameters.names), "theta": theta.tolist()}
    begun = time.perf_counter()
    try:
        nine = noise not in RECORDED and number % NINE_EVERY == 0
        with tempfile.TemporaryDirectory() as folder:
            measured = measure(bench, theta, structure, noise, rng, 9 if nine else 1, Path(folder) / "campaign")
        problem = build_problem(full, measured.data, set_id=measured.data.sets[0].id, weights=measured.weights)
        line["left_out"] = list(problem.matching.left_out)
        if max(problem.matching.computed) >= CARRIED:
            raise InputError("structure", "one of its modes pairs with one beyond the basis", "draw another")
        problem, top = problem.with_model(fast), None
        if noise != "paper" or number % MAXIMUM_EVERY == 0:
            start = full.parameters.initial if problem.weights.at is None else np.array(problem.weights.at)
            top = maximum_a_posteriori(problem, [start])
            line["discrepancy"] = problem.weights.discrepancy
            if noise == "default":
                line["stated_std"] = _stated_alone(full, measured, fast, top)
            line |= _deterministic(problem, top, theta)
        if nine:
            scatter = set_wise_scatter(fast, full, measured, problem, top)
            line["rank_nine"] = gaussian_rank(theta, top.theta, scatter).tolist()
        place = place_of_truth(problem, pool, theta, rng, number, top)
        line |= {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in vars(place).items()}
    except ProbupdateError as error:
        line["refused"] = f"{type(error).__name__}: {error}"
    line["seconds"] = round(time.perf_counter() - begun, 2)
    return line


def _stated_alone(full, measured, fast, top: Laplace) -> list[float]:
    """Gauss-Newton standard deviations where the measurement's own are all that is stated."""
    alone = build_problem(full, measured.data, set_id=measured.data.sets[0].id, weights=Weights()).with_model(fast)
    return np.sqrt(np.diag(maximum_a_posteriori(alone, [top.theta]).covariance)).tolist()


def _deterministic(problem: Problem, top: Laplace, theta: np.ndarray) -> dict:
    own = np.sqrt(np.diag(top.covariance))
    return {"rank_printed": gaussian_rank(theta, *printed_interval(problem)).tolist(),
            "rank_map": gaussian_rank(theta, top.theta, own).tolist(), "resolution": top.resolution.tolist(),
            "map": top.theta.tolist()}


def read_lines(folder: Path, case: str) -> list[dict]:
    """Finished replicates of all parts, by number; the half line of a killed process is left out."""
    found = {}
    for path in sorted(folder.glob(f"{case}.*.jsonl")):
        for text in path.read_text(encoding="utf-8").split("\n")[:-1]:
            line = json.loads(text)
            found[line["number"]] = line
    return [found[k] for k in sorted(found)]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--case", action="append", required=True, help="structure-noise-prior, may be repeated")
    parser.add_argument("--replicates", type=int, default=300)
    parser.add_argument("--theory", choices=("bernoulli-euler", "timoshenko"), default="timoshenko",
                        help="of the members of the model that is updated")
    parser.add_argument("--first", type=int, default=0, help="number of the first replicate: others are other draws")
    parser.add_argument("--part", type=int, default=0)
    parser.add_argument("--parts", type=int, default=1)
    a = parser.parse_args()
    for case in a.case:
        words = case.split("-")
        groups = (STRUCTURES, NOISES, PRIORS)
        if len(words) != 3 or any(w not in group for w, group in zip(words, groups, strict=True)) or \
                (words[0] == "own" and words[1] in RECORDED) or (words[0] == "other" and words[1] not in RECORDED):
            sys.stderr.write(f"{case}: choose from {STRUCTURES} - {NOISES} - {PRIORS}; a record is a turbine's\n")
            return 2
    a.out.mkdir(parents=True, exist_ok=True)
    noises = {case: case.split("-")[1] for case in a.case}
    shared = {noise: _shared(a.out, noise, a.theory) for noise in set(noises.values())}
    done = {case: {line["number"] for line in read_lines(a.out, case)} for case in a.case}
    # cases take turns, so that a run that is stopped has some of each
    tasks = [(number, case) for number in range(a.first + a.part, a.first + a.replicates, a.parts) for case in a.case
             if number not in done[case]]
    begun = time.monotonic()
    for k, (number, case) in enumerate(tasks, start=1):
        path = a.out / f"{case}.{a.part}of{a.parts}.jsonl"
        _mend(path)
        line = replicate(*shared[noises[case]], case, number)
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
        sys.stdout.write(f"{case} {number}: {line['seconds']} s {line.get('refused', line.get('by'))}"
                         f"{time_left(time.monotonic() - begun, k, len(tasks))}\n")
        sys.stdout.flush()
    return 0


def _shared(folder: Path, noise: str, theory: str) -> tuple[Bench, Pool]:
    bench = make_bench(folder, noise, theory)
    # a sharp posterior has no use for draws of the prior
    return bench, make_pool(bench.reduced, **({} if noise == "paper" else {"n": 2000}))


def _mend(path: Path) -> None:
    """Cut off the half line that a killed process left."""
    if path.exists():
        text = path.read_text(encoding="utf-8")
        if text and not text.endswith("\n"):
            path.write_text(text[: text.rfind("\n") + 1], encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
