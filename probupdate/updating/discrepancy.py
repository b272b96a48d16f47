"""The model's own error, stated before a set is updated: sources linearised where its parameters will be, and how much
the model misses at its best parameters.

Standard deviations of a measurement do not hold what the model itself gets wrong. Where they alone are stated, and are
small, the misfit at the maximum is far beyond what they expect, and the posterior is sharp about a wrong place (Kennedy
& O'Hagan 2001, Bayesian calibration of computer models). The simplest remedy, one relative standard deviation for all
responses (`Weights.discrepancy`), is estimated here by moments: so that the misfit at the maximum is what it expects.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from probupdate.errors import InputError
from probupdate.modal.modes import ModalData
from probupdate.model.interface import Model
from probupdate.runtime.progress import Progress, silent
from probupdate.runtime.settings import stated
from probupdate.updating.laplace import Laplace, maximum_a_posteriori
from probupdate.updating.problem import Problem, Weights, build_problem, paper_weights, suspected_channels, with_mistake
from probupdate.updating.responses import FORM_FREQUENCY_COV, FORM_SHAPE_STD
from probupdate.updating.settings import CONSTANTS
from probupdate.updating.tikhonov import update

PLACE = CONSTANTS.place
LEAST, MOST = CONSTANTS.least_discrepancy, CONSTANTS.most_discrepancy
ACCURACY = CONSTANTS.discrepancy_accuracy


@dataclass(frozen=True, eq=False, kw_only=True)
class LikelihoodSettings:
    """What is compared and what is stated of its error: one value, the same for every estimator that is given it."""

    weights: str | tuple[float, ...] | Weights = stated(
        "measured", "-", "standard deviations of the responses: 'measured', 'covariance', 'paper', or a CoV a mode")
    frequencies: str = stated("hz", "-", "frequencies are compared as they are ('hz') or as logarithms ('log')")
    shapes: str = stated("plane", "-", "shapes are compared as 'plane', 'components', 'mac' or 'none'")
    discrepancy: float | str | None = stated(
        None, "-", "share of every frequency that the model may miss, and ten times that of shapes; 'auto' for as much "
        "as the misfit says; None: 'auto' with the measurement's own standard deviations, else 0")
    tolerances: bool | None = stated(
        None, "-", "stated tolerances of structure, soil, rotor-nacelle assembly and sensors are marginalised; None: "
        "with the measurement's own standard deviations")

    def stated_for(
        self, model: Model, data: ModalData, *, set_id: str | None = None, progress: Progress = silent
    ) -> Weights:
        """As plain numbers, of this set (the reference set where None)."""
        chosen = stated_weights(self.weights, data, frequencies=self.frequencies, shapes=self.shapes,
                                tolerances=self.tolerances)
        discrepancy = self.discrepancy
        if discrepancy is None:
            own = isinstance(self.weights, str) and self.weights in ("measured", "covariance")
            discrepancy = "auto" if own else 0.0
        return state_model_error(model, data, weights=chosen, discrepancy=discrepancy, set_id=set_id, progress=progress)


def expected_misfit(problem: Problem, laplace: Laplace) -> float:
    """Of the data at the maximum, where responses are linear: effective responses less the parameters they decide."""
    return problem.n_effective - float(np.sum(laplace.resolution))


def state_model_error(
    model: Model,
    data: ModalData,
    *,
    weights: Weights,
    discrepancy: float | str = 0.0,
    set_id: str | None = None,
    progress: Progress = silent,
) -> Weights:
    """The weights with all that is stated of the model's error: `at`, where the effect of its sources is taken (the
    maximum of this set's posterior, found twice), and the discrepancy, a share or 'auto'.

    The result is plain numbers: every estimator that is given them sees the same likelihood.
    """
    chosen = weights
    if isinstance(discrepancy, str):
        if discrepancy != "auto":
            raise InputError("discrepancy", f"'{discrepancy}' is unknown", "give a share such as 0.005, or auto")
    elif discrepancy:
        chosen = replace(weights, discrepancy=float(discrepancy))
    if chosen.tolerances and getattr(model, "uncertainty", None) is not None:
        for step in range(2):
            progress("model error", step, 2)
            problem = build_problem(model, data, set_id=set_id, weights=chosen)
            start = update(problem, penalty="prior").theta[-1] if chosen.at is None else np.array(chosen.at)
            found = maximum_a_posteriori(problem, [start]).theta
            grid = PLACE * model.parameters.std
            place = np.clip(np.round(found / grid) * grid, model.parameters.lower, model.parameters.upper)
            chosen = replace(chosen, at=tuple(float(x) for x in place))
    if discrepancy == "auto":
        chosen = estimate_discrepancy(model, data, weights=chosen, set_id=set_id, progress=progress)
    return chosen


def stated_weights(
    weights: str | tuple[float, ...] | Weights, data: ModalData, *, frequencies: str = "hz", shapes: str = "plane",
    tolerances: bool | None = None,
) -> Weights:
    """'measured', 'covariance', 'paper', or a CoV a mode; and what is compared (see `responses`).

    tolerances None: marginalised with standard deviations that are the measurement's alone, not with the paper's or
    stated ones, which are W_Lambda as it is.
    """
    if isinstance(weights, Weights):
        return weights
    of_measurement = weights in ("measured", "covariance")
    known = of_measurement if tolerances is None else tolerances
    compared = {"frequencies": frequencies, "shapes": shapes, "tolerances": known}
    if known:
        compared |= {"least_frequency_cov": FORM_FREQUENCY_COV, "least_shape_std": FORM_SHAPE_STD}
    if of_measurement:
        return Weights(covariance=weights == "covariance", **compared)
    if weights == "paper":
        return paper_weights(data.labels, data.set().frequency_hz, **compared)
    if isinstance(weights, str):
        raise InputError("weights", f"'{weights}' is unknown",
                         "choose from measured, covariance, paper, or give a CoV a mode")
    return Weights(frequency_cov=tuple(float(w) for w in weights), shape_std=False, **compared)


def default_likelihood(
    model: Model, data: ModalData, *, set_id: str | None = None, progress: Progress = silent
) -> Weights:
    """What `update` and `sample` take where no option is given."""
    return LikelihoodSettings().stated_for(model, data, set_id=set_id, progress=progress)


def estimate_discrepancy(
    model: Model,
    data: ModalData,
    *,
    weights: Weights,
    set_id: str | None = None,
    clusters: list[tuple[int, ...]] | None = None,
    progress: Progress = silent,
) -> Weights:
    """The weights with the discrepancy at which the misfit at the maximum is `expected_misfit`; 0 where it is no more
    without. Raises InputError where no share below MOST explains the misfit."""
    from scipy import optimize

    excess: dict[float, float] = {}
    problem = build_problem(model, data, set_id=set_id, weights=replace(weights, discrepancy=0.0), clusters=clusters)
    start = update(problem, penalty="prior").theta[-1]

    def beyond(share: float) -> float:
        nonlocal start
        if share not in excess:
            progress("model discrepancy", len(excess), len(excess) + 1)
            chosen = replace(weights, discrepancy=share)
            problem = build_problem(model, data, set_id=set_id, weights=chosen, clusters=clusters)
            laplace = maximum_a_posteriori(problem, [start])
            start = laplace.theta
            excess[share] = laplace.misfit / expected_misfit(problem, laplace) - 1
        return excess[share]

    words = "estimated so that the misfit at the maximum is what is expected"
    if beyond(0.0) <= 0:
        return replace(weights, discrepancy=0.0)
    if beyond(MOST) > 0:
        error = InputError(f"set {problem.set_id}", f"even a model discrepancy of {100 * MOST:g} % of every frequency "
                           "does not explain the misfit", "check pairing, channels and units")
        likely = suspected_channels(model, data, [model.parameters.initial, start], set_id=set_id)
        raise error if likely is None else with_mistake(error, likely)
    if beyond(LEAST) <= 0:
        return replace(weights, discrepancy=LEAST, discrepancy_by=words)
    found = optimize.brentq(lambda s: beyond(float(np.exp(s))), np.log(LEAST), np.log(MOST), xtol=ACCURACY)
    return replace(weights, discrepancy=float(np.exp(found)), discrepancy_by=words)
