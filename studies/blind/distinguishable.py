"""Which hidden effects can be distinguished from their nearest alternative at all, whatever is then said about them.

python studies/blind/distinguishable.py LINES.jsonl

Adds to every effect of the lines `nearest`, the row of the catalogue that would explain most of it instead, and
`apart`, how much log evidence lies between the two for a record without noise, the error of a fingerprint counted as
the diagnosis counts it. Below ln(0.95 / 0.05) = 2.9 two rows are not distinguished, and either may come first. From the
design of one typical record and the truth, to first order in the sizes; no outcome is looked at.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from probupdate.diagnosis.fitting import Fit, fit
from probupdate.diagnosis.problem import DiagnosisProblem, IncludedEffect, diagnosis_problem
from probupdate.diagnosis.search import model_error_dispersion

# of what follows the surroundings: the column, and the catalogue's size over the simulator's (a softening is told per
# hundredth of a m/s2 there)
OWN = {"soil softens with amplitude": ("rms_mps2", -100.0), "wetted length": ("water_level_m", 1.0),
       "temperature of the steel": ("air_temperature_c", 1.0)}


def row_of(problem: DiagnosisProblem, fitted: Fit, effect: dict) -> int | None:
    """The candidate that the hidden effect is, a step at the block where it is told best."""
    name = OWN[effect["cause"]][0] if effect["time_profile"] == "own" else effect["time_profile"]
    rows = [k for k, (j, c) in enumerate(problem.which) if problem.time_profiles[c].name == name
            and (problem.effects[j].cause, problem.effects[j].location) == (effect["cause"], effect["location"])]
    return max(rows, key=lambda k: fitted.design.information[k], default=None)


def nearest(problem: DiagnosisProblem, fitted: Fit, effect: dict) -> tuple[str, float] | None:
    """Rival and log evidence apart; None where the catalogue has no such row."""
    design, k = fitted.design, row_of(problem, fitted, effect)
    if k is None:
        return None
    unit = np.sqrt(np.maximum(design.information, 1e-300))
    z = effect["size"] * OWN.get(effect["cause"], ("", 1.0))[1] * unit[k]
    best, apart = "", np.inf
    others = np.flatnonzero((problem.which[:, 0] != problem.which[k, 0]) & (design.share_left > 1e-3))
    for other, r in zip(others, design.overlap([k], others)[0] / (unit[k] * unit[others]), strict=True):
        competitor, time_profile = problem.effects[problem.which[other, 0]], problem.time_profiles[problem.which[other,
                                                                                                                 1]]
        sizes = competitor.discrete or np.clip(
            r * z / unit[other], *IncludedEffect(effect=competitor, time_profile=time_profile, size=0.0).bounds
        )
        for own in np.atleast_1d(sizes) * unit[other]:
            loss = 0.5 * (z**2 + own**2 - 2 * r * z * own)
            if loss < apart:
                best, apart = competitor.name, loss
    return best, float(apart / model_error_dispersion(z))


def main() -> None:
    sys.path.insert(0, str(Path(__file__).resolve().parent))
    from cases import make_case
    from run import prepared, simulated

    path = Path(sys.argv[1])
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    problem, theta = diagnosis_problem(prepared(), simulated(make_case("null", 0)).data)
    fitted = fit(problem, theta)
    for line in lines:
        for effect in line["effects"]:
            distinguishable = nearest(problem, fitted, effect)
            effect["nearest"], effect["apart"] = distinguishable if distinguishable else ("", None)
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))


if __name__ == "__main__":
    main()
