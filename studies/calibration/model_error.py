"""Calibration of intervals where the model is wrong: linear problems through the package's own functions.

    python studies/calibration/model_error.py OUT --replicates 200 [--minutes 20]

A line of JSON for each replicate and cell; a run that is stopped goes on. A replicate's numbers depend on its number
alone. Cells: responses x sets x model error x how the sets have it. Of each cell the shares of 90 % intervals that hold
the truth, parameters and two frequencies that were not used, and their widths over those of whoever knows the error's
covariance; beside it what others do: ignore the error, scale all standard deviations up until the misfit is what is
expected, and a discrepancy whose scale is plugged in at its most probable value (Kennedy & O'Hagan, modular).
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import optimize, special

from probupdate.modal.modes import ModalData, ModalSet
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.functions import FunctionModel
from probupdate.updating.laplace import maximum_a_posteriori
from probupdate.updating.mixing import OWN_CHANGE
from probupdate.updating.problem import Weights, build_problem
from probupdate.updating.responses import response_group
from probupdate.updating.scales import learn_scales
from probupdate.updating.set_likelihoods import coordinates_of
from probupdate.updating.shared_error import MIXING, Scales, join_densities, shared_error

N_MODE, N_HELD, N_CHANNEL = 5, 2, 12
FREQUENCY_HZ = np.array([1.0, 1.7, 3.1, 4.6, 7.3, 9.9, 13.0])
PRIOR_STD = np.array([0.3, 0.2, 0.1])
IDENTIFIED, IDENTIFIED_SHAPE = 1e-3, 5e-3
ERRORS, SETS = (0.0, 0.003, 0.01, 0.03), (1, 9, 48)
# variance of the error: the part that all sets repeat
KINDS = {"shared": 1.0, "new": 0.0, "half": 0.5}
PARAMETERS = Parameters(tuple(Parameter(name=f"p{k}", unit="-", initial=1.0, std=s) for k, s in enumerate(PRIOR_STD)))
COORDINATES = coordinates_of(PARAMETERS)
PRIOR = PARAMETERS.initial, np.diag(PRIOR_STD**-2.0)
SINGLE = [(j,) for j in range(N_MODE)]
# of frequencies, components and stiffness: that they are learnt, not how large they are
LEARN = (0.01, 0.01, 0.02)
METHODS = ("ours", "knows", "ignores", "scales up", "plugged in")


def cells():
    for shapes, n_set, error in itertools.product((False, True), SETS, ERRORS):
        for kind in ("shared",) if n_set == 1 or error == 0 else KINDS:
            yield shapes, n_set, error, kind


class Structure:
    """Frequencies and shapes linear in three parameters; the truth misses them by `error`."""

    def __init__(self, rng: np.random.Generator):
        self.slope = FREQUENCY_HZ[:, None] * 0.5 * rng.dirichlet(np.ones(3), size=len(FREQUENCY_HZ))
        self.shape = np.linalg.qr(rng.standard_normal((N_CHANNEL, len(FREQUENCY_HZ))))[0]
        self.turn = 0.15 * rng.standard_normal((N_CHANNEL, len(FREQUENCY_HZ), 3))
        self.theta = PARAMETERS.initial + PRIOR_STD * rng.standard_normal(3)
        self.missed = rng.standard_normal(len(FREQUENCY_HZ)), rng.standard_normal((N_CHANNEL, N_MODE))

    def solve(self, theta):
        away = np.asarray(theta) - 1.0
        return FREQUENCY_HZ + self.slope @ away, self.shape + self.turn @ away

    def model(self):
        return FunctionModel(name="linear", parameters=PARAMETERS, channels=tuple(f"c{k}" for k in range(N_CHANNEL)),
                             function=self.solve, version="1")

    def measured(self, rng, n_set: int, error: float, share: float):
        """Data of some sets, and the two held-out frequencies of one set more."""
        f, shape = self.solve(self.theta)
        largest = np.abs(shape).max(axis=0)
        sets = []
        for k in range(n_set + 1):
            own = rng.standard_normal(len(f)), rng.standard_normal((N_CHANNEL, N_MODE))
            off = [error * (np.sqrt(share) * a + np.sqrt(1 - share) * b) for a, b in zip(self.missed, own, strict=True)]
            here = f * (1 + off[0] + IDENTIFIED * rng.standard_normal(len(f)))
            seen = shape[:, :N_MODE] + largest[:N_MODE] * (
                off[1] + IDENTIFIED_SHAPE * rng.standard_normal((N_CHANNEL, N_MODE)))
            std = IDENTIFIED_SHAPE * np.tile(largest[:N_MODE], (N_CHANNEL, 1))
            sets.append((here, ModalSet(
                id=f"set {k}", frequency_hz=here[:N_MODE], damping_ratio=np.full(N_MODE, 0.01), shape=seen,
                frequency_std_hz=IDENTIFIED * f[:N_MODE], shape_std=std)))
        channels = tuple(f"c{k}" for k in range(N_CHANNEL))
        return ModalData(channels=channels, sets=tuple(s for _, s in sets[:-1])), sets[-1][0][N_MODE:]


class Mixed:
    """Gaussians of theta with their weights, and of a held-out frequency what is not theta's: relative std a node."""

    def __init__(self, weight, mean, cov, missed):
        self.weight, self.mean, self.cov, self.missed = weight, mean, cov, missed

    def quantiles(self, row, centre, extra):
        """5 and 95 % of centre + row @ (theta - 1), with variances `extra` (n_node,) beside."""
        mean = centre + (self.mean - 1.0) @ row
        std = np.sqrt(np.einsum("i,kij,j->k", row, self.cov, row) + extra)
        low, high = np.min(mean - 8 * std), np.max(mean + 8 * std)
        return [optimize.brentq(lambda x, q=q: self.weight @ special.ndtr((x - mean) / std) - q, low, high)
                for q in (0.05, 0.95)]

    def judged(self, structure: Structure, held):
        inside, width = [], []
        for k in range(3):
            low, high = self.quantiles(np.eye(3)[k], 1.0, 0.0)
            inside.append(bool(low < structure.theta[k] < high))
            width.append(high - low)
        f = FREQUENCY_HZ[N_MODE:]
        for j in range(N_HELD):
            extra = (self.missed**2 + IDENTIFIED**2) * f[j] ** 2
            low, high = self.quantiles(structure.slope[N_MODE + j], f[j], extra)
            inside.append(bool(low < held[j] < high))
            width.append(high - low)
        return {"inside": inside, "width": width}


def of_quadratics(found, missed) -> Mixed:
    """Of `Averaged` likelihoods with the Gaussian prior."""
    whole = found.precision + PRIOR[1]
    cov = np.linalg.inv(whole)
    mean = found.middle + np.einsum("kij,kj->ki", cov, found.gradient + PRIOR[1] @ (PRIOR[0] - found.middle))
    return Mixed(found.shares(PRIOR), mean, cov, np.asarray(missed))


def off_by(scales: Scales, error) -> float:
    """Relative standard deviation of what a frequency of a set that was not measured is off by."""
    new, shared = scales.new[0], 0.0 if error.alone else scales.shared[0]
    return float(np.sqrt(new**2 + shared**2 + (OWN_CHANGE * scales.shared[2] * np.any(error.kind == MIXING)) ** 2))


def at(error, scales: Scales) -> Mixed:
    found = error.likelihoods(error.sum_sets(scales.new), [scales])
    return of_quadratics(found, [off_by(scales, error)])


def problems_of(model, data: ModalData, weights: Weights) -> list:
    """As `build_problem` of every set: all have the same modes at the same channels, so one is matched."""
    first = build_problem(model, data, weights=weights, clusters=SINGLE)
    rows = np.arange(N_CHANNEL)
    others = [replace(first, set_id=s.id, groups=tuple(
        response_group(s, list(g.measured), rows, weights, first.mode_labels) for g in first.matching.groups))
        for s in data.sets[1:]]
    return [first, *(p.with_mixing(PARAMETERS.initial) for p in others)]


def error_of(model, data: ModalData, weights: Weights):
    """Of all sets about the first one's maximum. Of frequencies alone the model's slopes and the stated standard
    deviations are the same in all sets, so that residuals are all that differs."""
    whole = problems_of(model, data if weights.shapes != "none" else replace(data, sets=data.sets[:1]), weights)
    # shapes of unit largest component are linear about where the parameters are
    top = maximum_a_posteriori(whole[0], [PARAMETERS.initial]).theta
    error = shared_error(whole, np.tile(top, (len(whole), 1)), COORDINATES)
    if weights.shapes != "none":
        return whole, top, error
    n = len(data.sets)
    off = [s.frequency_hz[:N_MODE] - data.sets[0].frequency_hz[:N_MODE] for s in data.sets]
    return whole, top, replace(error, problems=error.problems * n, centre=np.tile(error.centre, (n, 1)),
                               residual=tuple(error.residual[0] + d for d in off), slope=error.slope * n,
                               effect=error.effect * n)


def replicate(number: int, shapes: bool, n_set: int, size: float, kind: str) -> dict:
    structure = Structure(np.random.default_rng([number, 1]))
    rng = np.random.default_rng([number, 2, n_set, int(1e6 * size), list(KINDS).index(kind)])
    data, held = structure.measured(rng, n_set, size, KINDS[kind])
    model = structure.model()
    begin = time.process_time()
    # of a single set as `estimate_discrepancy` has it
    weights = Weights(shapes="plane" if shapes else "none", least_shape_std=1e-4, mixing=LEARN[2],
                      scales=((*LEARN, 0.0),))
    problems, top, error = error_of(model, data, weights)
    own = shared_error(problems, top[None], COORDINATES, alone=True) if n_set == 1 else error
    learnt = learn_scales(own, PRIOR)
    by_new = defaultdict(list)
    for one in learnt.nodes:
        by_new[one.new].append(one)
    parts = [own.likelihoods(own.sum_sets(new), rows) for new, rows in by_new.items()]
    missed = [off_by(s, own) for rows in by_new.values() for s in rows]
    found = {"ours": of_quadratics(join_densities(parts), missed)}
    seconds = time.process_time() - begin
    # the error is of the largest component, as the scales are
    share = KINDS[kind]
    known = tuple(np.sqrt(x) * size for x in (1 - share, share))
    found["knows"] = at(error, Scales(new=(known[0],) * 2, shared=(known[1], known[1], 0.0)))
    none = Scales(new=(0.0, 0.0), shared=(0.0, 0.0, 0.0))
    found["ignores"] = at(error, none)
    quiet = found["ignores"]
    inner = error.sum_sets(none.new)
    _, gradient, precision = inner.reduce(error.common_std(np.zeros((1, 3))))
    d = quiet.mean[0] - inner.middle
    misfit = inner.products[0, 0] - 2 * gradient[0] @ d + d @ precision[0] @ d
    free = sum(p.n_effective for p in error.problems) - np.trace(quiet.cov[0] @ precision[0])
    factor = max(1.0, misfit / free)
    loose = np.linalg.inv(precision[0] / factor + PRIOR[1])
    mean = inner.middle + loose @ (gradient[0] / factor + PRIOR[1] @ (PRIOR[0] - inner.middle))
    found["scales up"] = Mixed(np.ones(1), mean[None], loose[None], np.array([np.sqrt(factor - 1) * IDENTIFIED]))
    grid = np.geomspace(1e-5, 0.2, 60)
    pairs = np.array([(s, s, 0.0) for s in grid])
    best = grid[np.argmax(inner.evidence(error.common_std(pairs), PRIOR))]
    found["plugged in"] = at(error, Scales(new=(0.0, 0.0), shared=(float(best), float(best), 0.0)))
    return {"seconds": seconds, **{name: one.judged(structure, held) for name, one in found.items()}}


def read(path: Path) -> dict:
    kept = {}
    if path.exists():
        for line in path.read_text().splitlines():
            row = json.loads(line)
            kept[tuple(row["cell"]), row["number"]] = row
    return kept


def table(kept: dict) -> str:
    """Coverage of each method, of parameters / held-out frequencies, and our width over that of who knows."""
    lines = ["| responses | sets | error | in the sets | replicates | " + " | ".join(METHODS) + " | width |",
             "|---" * (6 + len(METHODS)) + "|"]
    for cell in cells():
        rows = [row for (key, _), row in kept.items() if key == cell]
        if not rows:
            continue
        texts = []
        for name in METHODS:
            inside = np.array([row[name]["inside"] for row in rows])
            texts.append(f"{100 * inside[:, :3].mean():.0f} / {100 * inside[:, 3:].mean():.0f}")
        ratio = np.array([row["ours"]["width"] for row in rows]) / [row["knows"]["width"] for row in rows]
        shapes, n_set, error, kind = cell
        width = f"{np.median(ratio[:, :3]):.2f} / {np.median(ratio[:, 3:]):.2f}"
        lines.append(f"| {'frequencies, shapes' if shapes else 'frequencies'} | {n_set} | {100 * error:g} % | {kind} | "
                     f"{len(rows)} | {' | '.join(texts)} | {width} |")
    return "\n".join(lines)


def main():
    p = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    p.add_argument("out", type=Path)
    p.add_argument("--replicates", type=int, default=200)
    p.add_argument("--first", type=int, default=0)
    p.add_argument("--responses", choices=("frequencies", "shapes"), help="cells of these alone")
    p.add_argument("--minutes", type=float, default=1e9, help="of processor time")
    a = p.parse_args()
    a.out.mkdir(parents=True, exist_ok=True)
    path = a.out / "model_error.jsonl"
    kept = read(path)
    with path.open("a") as out:
        for number in range(a.first, a.first + a.replicates):
            for cell in cells():
                if (cell, number) in kept or time.process_time() > 60 * a.minutes:
                    continue
                if a.responses and cell[0] != (a.responses == "shapes"):
                    continue
                row = {"cell": cell, "number": number, **replicate(number, *cell)}
                kept[cell, number] = row
                out.write(json.dumps(row) + "\n")
                out.flush()
    print(table(kept))


if __name__ == "__main__":
    main()
