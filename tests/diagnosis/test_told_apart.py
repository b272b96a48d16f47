"""What the blind study says cannot be told apart, against the misfit of written-out records."""

import sys
from pathlib import Path

import numpy as np
from scipy import optimize

from probupdate.diagnosis.fitting import fit
from probupdate.diagnosis.problem import IncludedEffect, diagnosis_problem
from probupdate.diagnosis.search import model_error_dispersion

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "studies" / "blind"))
from told_apart import nearest, row_of


def written_out(design, row):
    """Departures of a record without noise in which a candidate has the size one, courses centred over the blocks."""
    effect, course = design.which[row]
    values = design.courses[course].value
    result = []
    for fingerprint, weight in zip(design.effect, design.noise.weight, strict=True):
        h = values if design.courses[course].kind == "constant" else values - np.average(values, weights=weight)
        result.append((weight > 0)[:, None] * h[:, None] * fingerprint[design.bin_of, :, effect])
    return result


def test_the_nearest_rival_is_the_one_that_leaves_least(stepped):
    prepared, data, _ = stepped
    problem, theta = diagnosis_problem(prepared, data)
    fitted = fit(problem, theta)
    design = fitted.design
    for cause, place, course, size in (("sensor gain", "x2", "constant", 0.12), ("parameter", "k3", "step", -0.06)):
        effect = {"cause": cause, "location": place, "course": course, "size": size}
        row = row_of(problem, fitted, effect)
        truth = [size * y for y in written_out(design, row)]
        name, apart = nearest(problem, fitted, effect)
        left = {}
        for other in np.flatnonzero((design.which[:, 0] != design.which[row, 0]) & (design.share_left > 1e-3)):
            rival, along = problem.effects[design.which[other, 0]], problem.courses[design.which[other, 1]]
            pairs = list(zip(truth, written_out(design, other), strict=True))

            def misfit(a, pairs=pairs):
                return 0.5 * design.misfit([y - a * x for y, x in pairs], ())

            bounds = np.clip(IncludedEffect(effect=rival, course=along, size=0.0).bounds, -1e4, 1e4)
            least = (min(map(misfit, rival.discrete)) if rival.discrete
                     else optimize.minimize_scalar(misfit, bounds=bounds, method="bounded",
                                                   options={"xatol": 1e-9}).fun)
            left[rival.name] = min(least, left.get(rival.name, np.inf))
        # of the same noise-free record, in units of what a fingerprint's error hides; the search's own accuracy
        z = size * np.sqrt(design.information[row])
        assert left[name] < min(left.values()) + 1e-3 * max(1.0, left[name])
        assert abs(apart * model_error_dispersion(z) - min(left.values())) < 1e-3 * max(1.0, min(left.values()))
