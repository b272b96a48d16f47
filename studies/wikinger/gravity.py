"""What the paper's update would have given with gravity in its accelerometers' readings and in its model.

The measured modes are the updated state's, read by accelerometers; the as-built model is updated with them as the paper
does, reading motions, and as it should be. `python studies/wikinger/gravity.py` prints the table of RESULTS.md.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
from paper_update import COV, table_3_as_modes

from probupdate.modal.modes import ModalData
from probupdate.structure.load import load_model, reference_model
from probupdate.updating.laplace import maximum_a_posteriori
from probupdate.updating.problem import Weights, build_problem

SHAPE_STD = 0.02


def readings() -> ModalData:
    """Table 3's frequencies with the updated state's shapes as accelerometers read them, SHAPE_STD of the largest."""
    data = table_3_as_modes()
    one = data.sets[0]
    return replace(data, sets=(replace(one, shape_std=np.full(one.shape.shape, SHAPE_STD)),))


def updated(read: ModalData, held: bool):
    """Parameters, values, standard deviations and misfit of the as-built model whose channels hold gravity, or not."""
    model = load_model(reference_model("as_built"))
    data = replace(read, gravity=(held,) * len(read.channels))
    problem = build_problem(model, data, weights=Weights(frequency_cov=COV))
    found = maximum_a_posteriori(problem, [model.parameters.initial])
    heads = {name: float(compute(found.theta)) for name, compute in model.derived.items()}
    return model.parameters, found.theta, np.sqrt(np.diag(found.covariance)), found.misfit, heads


def main() -> None:
    data = readings()
    parameters, with_it, std, misfit, heads = updated(data, held=True)
    _, without, _, misfit_without, heads_without = updated(data, held=False)
    for k, p in enumerate(parameters):
        apart = (without[k] - with_it[k]) / std[k]
        sys.stdout.write(f"| {p.name} | {with_it[k]:.4g} | {without[k]:.4g} | {apart:+.2f} |\n")
    for name, value in heads.items():
        sys.stdout.write(f"| {name} (N/m) | {value:.3g} | {heads_without[name]:.3g} | "
                         f"{100 * (heads_without[name] / value - 1):+.0f} % |\n")
    sys.stdout.write(f"misfit {misfit:.2f} and {misfit_without:.2f}\n")


if __name__ == "__main__":
    main()
