"""What the blind study says cannot be distinguished, against the misfit of written-out records."""

import sys
from pathlib import Path

import numpy as np
from scipy import optimize

from probupdate.diagnosis.fitting import fit
from probupdate.diagnosis.problem import IncludedEffect, diagnosis_problem
from probupdate.diagnosis.search import model_error_dispersion

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "studies" / "blind"))
from distinguishable import nearest, row_of


def written_out(design, row):
    """Residuals of a record without noise in which a candidate has the size one, time profiles centred over the
    blocks."""
    effect, time_profile = design.which[row]
    values = design.time_profiles[time_profile].value
    result = []
    for signature, weight in zip(design.effect, design.noise.weight, strict=True):
        h = values if design.time_profiles[time_profile].kind == "constant" else values - np.average(values,
                                                                                                     weights=weight)
        result.append((weight > 0)[:, None] * h[:, None] * signature[design.bin_of, :, effect])
    return result


def test_the_nearest_rival_is_the_one_that_leaves_least(stepped, validation):
    row = validation(what="nearest competing hypothesis to a gain and to a storey's step: how much less another "
                          "leaves; how far apart they are (blind study)",
                     reference="misfit of written-out records, minimised over each competing hypothesis's size",
                     why="accuracy of the search")
    prepared, data, _ = stepped
    problem, theta = diagnosis_problem(prepared, data)
    fitted = fit(problem, theta)
    design = fitted.design
    for cause, place, time_profile, size in (("sensor gain", "x2", "constant", 0.12),
                                             ("parameter", "k3", "step", -0.06)):
        effect = {"cause": cause, "location": place, "time_profile": time_profile, "size": size}
        own = row_of(problem, fitted, effect)
        truth = [size * y for y in written_out(design, own)]
        name, apart = nearest(problem, fitted, effect)
        left = {}
        for other in np.flatnonzero((design.which[:, 0] != design.which[own, 0]) & (design.share_left > 1e-3)):
            competitor, along = problem.effects[design.which[other, 0]], problem.time_profiles[design.which[other, 1]]
            pairs = list(zip(truth, written_out(design, other), strict=True))

            def misfit(a, pairs=pairs):
                return 0.5 * design.misfit([y - a * x for y, x in pairs], ())

            bounds = np.clip(IncludedEffect(effect=competitor, time_profile=along, size=0.0).bounds, -1e4, 1e4)
            least = (min(map(misfit, competitor.discrete)) if competitor.discrete
                     else optimize.minimize_scalar(misfit, bounds=bounds, method="bounded",
                                                   options={"xatol": 1e-9}).fun)
            left[competitor.name] = min(least, left.get(competitor.name, np.inf))
        # of the same noise-free record, in units of what a signature's error hides; the search's own accuracy
        z = size * np.sqrt(design.information[own])
        least = min(left.values())
        row.error((left[name] - least) / max(1.0, left[name]), 1e-3, "less", case=name)
        row.error((apart * model_error_dispersion(z) - least) / max(1.0, least), 1e-3, "apart", case=name)
