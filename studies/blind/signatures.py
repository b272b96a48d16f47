"""How far the model's signatures are those of the virtual turbine: effects at their true size, put into the model.

python studies/blind/signatures.py [--each 3]

A line for each effect: length of what it does to the modes in standard deviations of a block's noise and model form,
the share of it that is left when the model has the effect at its true size, the share left at the factor on the size
that leaves least, and of that the share that changes with the heading.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
from cases import KINDS, draw_effect
from run import prepared

from probupdate.diagnosis.expected import residuals_at
from probupdate.diagnosis.problem import IncludedEffect, diagnosis_problem
from probupdate.virtual.modal_blocks import simulate_modes

BASE = {"seed": 5, "days": 30.0, "n_block": 16, "states": ("idling",), "missing_share": 0.0, "scatter": 0.0}
FACTORS = (0.6, 0.7, 0.8, 0.9, 0.95, 1.0, 1.05, 1.1, 1.2, 1.3, 1.5)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--each", type=int, default=3, help="draws of place and size of every kind")
    each = parser.parse_args().each
    model = prepared()
    before = simulate_modes(truth={}, **BASE)
    problem, theta = diagnosis_problem(model, before.data)
    noisy, _ = diagnosis_problem(
        model, simulate_modes(truth={}, **BASE | {"scatter": 1.0, "n_block": 40}).data
    )
    root = [np.linalg.inv(np.linalg.cholesky(c + 0.1 * np.diag(f**2)))
            for c, f in zip(noisy.stated, noisy.discrepancy_std, strict=True)]

    plain = residuals_at(problem, theta, ())

    def shift(own, included=()) -> np.ndarray:
        """What lies between each block of a record and of the plain one (n_block, n), in standard deviations."""
        found = residuals_at(own, theta, included)
        return np.hstack([(b - a) @ W.T for W, a, b in zip(root, plain, found, strict=True)])

    rng, shares, turning = np.random.default_rng(3), [], []
    for kind in KINDS:
        if kind.klass == "environmental" or "constant" not in kind.time_profiles:
            continue
        for _ in range(each):
            hidden, words = draw_effect(rng, kind)
            hidden = {k: v for k, v in hidden.items() if k not in ("time_profile", "at_hour", "from_hour", "to_hour")}
            (effect,) = [e for e in problem.effects if (e.cause, e.location) == (kind.cause, words["location"])]
            record = simulate_modes(truth={"effect": [hidden]}, **BASE)
            own = dataclasses.replace(diagnosis_problem(model, record.data)[0], predictor=problem.predictor)
            length = _rms(shift(own))
            there = {f: shift(own, (IncludedEffect(effect=effect, time_profile=problem.time_profiles[0],
                                                   size=f * words["size"]),)) for f in FACTORS}
            left = {f: _rms(y) for f, y in there.items()}
            best = min(FACTORS, key=lambda f: left[f])
            shares.append(left[1.0] / length)
            turning.append(_rms(there[best] - there[best].mean(axis=0)) / left[best])
            print(f"{kind.cause:26s}{words['location']:24s}{words['size']:10.3g} length {length:8.1f} "
                  f"left {shares[-1]:.3f}, {left[best] / length:.3f} at {best:g} of the size, "
                  f"{turning[-1]:.2f} of it with the heading", flush=True)
    half, most = np.quantile(shares, [0.5, 0.9])
    print(f"{len(shares)} effects: half below {half:.3f}, nine of ten below {most:.3f}, all below {max(shares):.3f}; "
          f"of what is left half below {np.median(turning):.2f} with the heading, all below {max(turning):.2f}")


def _rms(y: np.ndarray) -> float:
    """Length of a block's numbers (n_block, n), root mean square over the blocks."""
    return float(np.sqrt(np.mean(np.sum(y**2, axis=1))))


if __name__ == "__main__":
    main()
