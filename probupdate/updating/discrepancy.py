"""The model's own error, stated before a set is updated: sources linearised where its parameters will be, and how much
the model misses at its best parameters.

Standard deviations of a measurement do not hold what the model itself gets wrong. Where they alone are stated, and are
small, the misfit at the maximum is far beyond what they expect, and the posterior is sharp about a wrong place (Kennedy
& O'Hagan 2001, Bayesian calibration of computer models). A relative standard deviation of frequencies, one of shapes
(`Weights.discrepancies`) and the local error of stiffness that mixes modes are learnt here (`scales`), and the
likelihood is averaged over what is left unknown of them. One set cannot show how much of it is the same in the next
one: see `shared_error`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from probupdate.errors import InputError
from probupdate.modal.modes import ModalData
from probupdate.model.interface import Model
from probupdate.runtime.progress import Progress, silent
from probupdate.runtime.settings import stated
from probupdate.updating.laplace import Laplace, maximum_a_posteriori, prior_residual
from probupdate.updating.problem import Problem, Weights, build_problem, paper_weights, suspected_channels, with_mistake
from probupdate.updating.responses import FORM_FREQUENCY_COV, FORM_SHAPE_STD, SHAPE_FACTOR
from probupdate.updating.scales import MOST, LearntScales, hyper_scales, learn_scales
from probupdate.updating.set_likelihoods import Coordinates
from probupdate.updating.settings import CONSTANTS
from probupdate.updating.shared_error import GaussianPrior, shared_error
from probupdate.updating.tikhonov import update

PLACE = CONSTANTS.place


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
    modes: tuple[str, ...] | None = stated(
        None, "-", "labels of the modes that are compared, or their numbers from 1; None: those of interest")
    fix: Mapping[str, float] | None = stated(None, "-", "parameters that are held, name -> value")

    @property
    def joint_covariance(self) -> bool:
        """Whether the covariance of all modes together is asked for."""
        return self.weights.covariance if isinstance(self.weights, Weights) else self.weights == "covariance"

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
            chosen = replace(chosen, at=_place(model, maximum_a_posteriori(problem, [start]).theta))
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


def _place(model: Model, theta: np.ndarray) -> tuple[float, ...]:
    """Rounded, as plain numbers within the bounds."""
    grid = PLACE * model.parameters.std
    place = np.clip(np.round(theta / grid) * grid, model.parameters.lower, model.parameters.upper)
    return tuple(float(x) for x in place)


def estimate_discrepancy(
    model: Model,
    data: ModalData,
    *,
    weights: Weights,
    set_id: str | None = None,
    clusters: list[tuple[int, ...]] | None = None,
    progress: Progress = silent,
) -> Weights:
    """The weights with `scales`: what the model misses of frequencies, of shapes and by mixing of modes, at nodes where
    the posterior of these has its mass, the parameters integrated out with responses linear about the maximum. Raises
    InputError where no share below MOST explains the misfit."""
    first = build_problem(model, data, set_id=set_id, weights=weights, clusters=clusters)
    hyper = hyper_scales(first)
    plain = replace(weights, discrepancy=hyper[0], shape_discrepancy=hyper[1], mixing=hyper[2], scales=())
    progress("model discrepancy", 0, 3)
    problem = build_problem(model, data, set_id=set_id, weights=plain, clusters=clusters)
    start = update(problem, penalty="prior").theta[-1]
    _refuse_unexplained(problem, model, data, start, set_id)
    chosen = plain
    for step in range(2):
        progress("model discrepancy", step + 1, 3)
        start = maximum_a_posteriori(problem, [start]).theta
        if weights.at is None and problem.mixing is not None:
            # modes mix where they are, not where the initial model has them
            plain = replace(plain, at=_place(model, start))
            problem = problem.with_mixing(np.array(plain.at))
        chosen = _learnt(problem, start, plain)
        problem = build_problem(model, data, set_id=set_id, weights=replace(chosen, scales=()), clusters=clusters)
    progress("model discrepancy", 3, 3)
    return chosen


def _refuse_unexplained(problem: Problem, model: Model, data: ModalData, start: np.ndarray, set_id) -> None:
    """Raises InputError where even the largest discrepancy leaves a misfit that is none of chance."""
    widest = replace(problem, scales=(MOST, SHAPE_FACTOR * MOST, 0.0))
    laplace = maximum_a_posteriori(widest, [start])
    if laplace.misfit <= expected_misfit(widest, laplace):
        return
    error = InputError(f"set {problem.set_id}", f"even a model discrepancy of {100 * MOST:g} % of every frequency "
                       "does not explain the misfit", "check pairing, channels and units")
    likely = suspected_channels(model, data, [model.parameters.initial, start], set_id=set_id,
                                absent=problem.matching.absent)
    raise error if likely is None else with_mistake(error, likely)


def _learnt(problem: Problem, theta: np.ndarray, plain: Weights) -> Weights:
    """Nodes over the scales about the maximum theta (n_param,), and the numbers that stand for them."""
    as_they_are = Coordinates(logarithmic=np.zeros(len(theta), bool), scale=problem.parameters.std)
    error = shared_error([problem], theta[None], as_they_are, alone=True)
    found = learn_scales(error, _prior_about(problem, theta))
    scales = tuple(sorted((*node.new, node.shared[2] if problem.mixing is not None else 0.0, node.log_weight)
                          for node in found.nodes))
    frequency, shape, *_, mixing = found.ends
    words = "learnt from the misfit and averaged over: " + _of_ends(frequency, "frequencies")
    if problem.measured.size > problem.n_frequency:
        words += f", {_of_ends(shape, 'shapes')}"
    if problem.mixing is not None:
        words += f", {_of_ends(mixing, 'stiffness')}"
    central = [_standing_for(problem, k, found) for k in range(2)]
    mixes = float(np.exp(found.marginal[4] @ np.log(found.axes[4]))) if problem.mixing is not None else 0.0
    return replace(plain, discrepancy=central[0], shape_discrepancy=central[1], mixing=mixes, scales=scales,
                   discrepancy_by=words)


def _of_ends(ends: tuple[float, float], what: str) -> str:
    return f"{100 * ends[0]:.2g} to {100 * ends[1]:.2g} % of {what}"


def _prior_about(problem: Problem, theta: np.ndarray) -> GaussianPrior:
    """Mean and precision of the Gaussian that has the prior's slope and curvature at theta (n_param,)."""
    residual, slope = prior_residual(problem.parameters, theta)
    return theta - np.linalg.solve(slope, residual), slope.T @ slope


def _standing_for(problem: Problem, kind: int, found: LearntScales) -> float:
    """The scale at which the responses of one kind have the summed mean inverse variance that they have on average."""
    rows = slice(0, problem.n_frequency) if kind == 0 else slice(problem.n_frequency, None)
    unit = problem.unit_discrepancy[rows] ** 2
    own = replace(problem, scales=(0.0, 0.0, 0.0)).std[rows] ** 2
    axis = found.axes[kind]
    weight = np.array([np.sum(unit / (own + t**2 * unit)) for t in axis])
    wanted = float(found.marginal[kind] @ weight)
    if not len(unit) or np.ptp(weight) == 0:
        return float(axis[0])
    return float(np.exp(np.interp(-np.log(wanted), -np.log(weight), np.log(axis))))
