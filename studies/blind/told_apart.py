"""Which hidden effects can be told from their nearest rival at all, whatever is then said about them.

python studies/blind/told_apart.py LINES.jsonl

Adds to every effect of the lines `nearest`, the row of the catalogue that would explain most of it instead, and
`apart`, how much log evidence lies between the two for a record without noise, the error of a fingerprint counted as
the diagnosis counts it. Below ln(0.95 / 0.05) = 2.9 two rows are not told apart, and either may come first. From the
design of one typical record and the truth, to first order in the sizes; no outcome is looked at.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from probupdate.diagnosis.diagnose import undecided
from probupdate.diagnosis.fitting import Fit, fit
from probupdate.diagnosis.setting import Named, Setting, settle

# of what follows the surroundings: the column, and the catalogue's size over the simulator's (a softening is told per
# hundredth of a m/s2 there)
OWN = {"soil softens with amplitude": ("rms_mps2", -100.0), "wetted length": ("water_level_m", 1.0),
       "temperature of the steel": ("air_temperature_c", 1.0)}  # fmt: skip


def row_of(setting: Setting, fitted: Fit, effect: dict) -> int | None:
    """The candidate that the hidden effect is, a step at the block where it is told best."""
    name = OWN[effect["cause"]][0] if effect["course"] == "own" else effect["course"]
    rows = [k for k, (j, c) in enumerate(setting.which) if setting.courses[c].name == name
            and (setting.effects[j].cause, setting.effects[j].location) == (effect["cause"], effect["location"])]
    return max(rows, key=lambda k: fitted.design.information[k], default=None)


def nearest(setting: Setting, fitted: Fit, effect: dict) -> tuple[str, float] | None:
    """Rival and log evidence apart; None where the catalogue has no such row."""
    design, k = fitted.design, row_of(setting, fitted, effect)
    if k is None:
        return None
    unit = np.sqrt(np.maximum(design.information, 1e-300))
    z = effect["size"] * OWN.get(effect["cause"], ("", 1.0))[1] * unit[k]
    best, apart = "", np.inf
    others = np.flatnonzero((setting.which[:, 0] != setting.which[k, 0]) & (design.share_left > 1e-3))
    for other, r in zip(others, design.overlap([k], others)[0] / (unit[k] * unit[others]), strict=True):
        rival, course = setting.effects[setting.which[other, 0]], setting.courses[setting.which[other, 1]]
        sizes = rival.discrete or np.clip(r * z / unit[other], *Named(effect=rival, course=course, size=0.0).bounds)
        for own in np.atleast_1d(sizes) * unit[other]:
            loss = 0.5 * (z**2 + own**2 - 2 * r * z * own)
            if loss < apart:
                best, apart = rival.name, loss
    return best, float(apart / undecided(z))


def main() -> None:
    sys.path.insert(0, str(Path(__file__).resolve().parent))
    from cases import make_case
    from run import prepared, simulated

    path = Path(sys.argv[1])
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    setting, theta = settle(prepared(), simulated(make_case("null", 0)).data)
    fitted = fit(setting, theta)
    for line in lines:
        for effect in line["effects"]:
            told = nearest(setting, fitted, effect)
            effect["nearest"], effect["apart"] = told if told else ("", None)
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))


if __name__ == "__main__":
    main()
