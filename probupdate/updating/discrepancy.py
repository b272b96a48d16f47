"""The model's own error, stated before a set is updated: sources linearised where its parameters will be, and how much
the model misses at its best parameters.

Standard deviations of a measurement do not hold what the model itself gets wrong. Where they alone are stated, and are
small, the misfit at the maximum is far beyond what they expect, and the posterior is sharp about a wrong place (Kennedy
& O'Hagan 2001, Bayesian calibration of computer models). A relative standard deviation of frequencies and one of shapes
(`Weights.discrepancies`) are learnt here, with a hyper-prior that keeps them realistic (Brynjarsdottir & O'Hagan 2014),
and the likelihood is averaged over what is left unknown of them, as in nested Laplace approximations (Rue, Martino &
Chopin 2009). One set cannot show how much of it is the same in the next one: see `shared_error`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from probupdate.errors import InputError
from probupdate.modal.modes import ModalData
from probupdate.model.interface import Model
from probupdate.runtime.progress import Progress, silent
from probupdate.runtime.settings import stated
from probupdate.updating.laplace import Laplace, gaussian_at, maximum_a_posteriori, prior_residual
from probupdate.updating.problem import Problem, Weights, build_problem, paper_weights, suspected_channels, with_mistake
from probupdate.updating.responses import FORM_FREQUENCY_COV, FORM_SHAPE_STD, SHAPE_FACTOR
from probupdate.updating.settings import CONSTANTS
from probupdate.updating.tikhonov import update

PLACE = CONSTANTS.place
MOST = CONSTANTS.most_discrepancy
# scales that are looked at first, from this share of the hyper-prior's on; then those where the posterior has its mass
SPAN, N_COARSE, N_FINE, ROUNDS = 0.02, 10, 7, 2
# of the largest: nodes with less are left out
LEAST_SHARE = 2e-3


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


def hyper_scales(weights: Weights) -> tuple[float, float]:
    """Of the half-Student hyper-priors of frequencies and of shapes: beside stated tolerances what the form misses is
    all that is left."""
    if weights.tolerances:
        return FORM_FREQUENCY_COV, FORM_SHAPE_STD
    return CONSTANTS.frequency_discrepancy, CONSTANTS.shape_discrepancy


def log_half_student(scale: np.ndarray, hyper: float) -> np.ndarray:
    """ln of the density of ln(scale), the scale half-Student with three degrees of freedom (Gelman 2006): flat towards
    zero, and a tail that lets the data say three times as much, not thirty times."""
    return np.log(4 / (np.pi * np.sqrt(3))) + np.log(scale / hyper) - 2 * np.log1p((scale / hyper) ** 2 / 3)


def estimate_discrepancy(
    model: Model,
    data: ModalData,
    *,
    weights: Weights,
    set_id: str | None = None,
    clusters: list[tuple[int, ...]] | None = None,
    progress: Progress = silent,
) -> Weights:
    """The weights with `scales`: what the model misses of frequencies and of shapes, each with its own half-Student
    hyper-prior, at nodes where the posterior of the two has its mass, the parameters integrated out with responses
    linear about the maximum. Raises InputError where no share below MOST explains the misfit."""
    hyper = hyper_scales(weights)
    plain = replace(weights, discrepancy=hyper[0], shape_discrepancy=hyper[1], scales=())
    progress("model discrepancy", 0, 3)
    problem = build_problem(model, data, set_id=set_id, weights=plain, clusters=clusters)
    start = update(problem, penalty="prior").theta[-1]
    _refuse_unexplained(problem, model, data, start, set_id)
    chosen = plain
    for step in range(2):
        progress("model discrepancy", step + 1, 3)
        laplace = maximum_a_posteriori(problem, [start])
        start = laplace.theta
        chosen = _learnt(problem, start, hyper, plain)
        problem = build_problem(model, data, set_id=set_id, weights=replace(chosen, scales=()), clusters=clusters)
    progress("model discrepancy", 3, 3)
    return chosen


def _refuse_unexplained(problem: Problem, model: Model, data: ModalData, start: np.ndarray, set_id) -> None:
    """Raises InputError where even the largest discrepancy leaves a misfit that is none of chance."""
    widest = replace(problem, scales=(MOST, SHAPE_FACTOR * MOST))
    laplace = maximum_a_posteriori(widest, [start])
    if laplace.misfit <= expected_misfit(widest, laplace):
        return
    error = InputError(f"set {problem.set_id}", f"even a model discrepancy of {100 * MOST:g} % of every frequency "
                       "does not explain the misfit", "check pairing, channels and units")
    likely = suspected_channels(model, data, [model.parameters.initial, start], set_id=set_id,
                                absent=problem.matching.absent)
    raise error if likely is None else with_mistake(error, likely)


def _learnt(problem: Problem, theta: np.ndarray, hyper: tuple[float, float], plain: Weights) -> Weights:
    """Nodes over the scales about the maximum theta (n_param,), and the two numbers that stand for them."""
    evidence = ScaleEvidence.of(problem, theta)
    has_shapes = problem.measured.size > problem.n_frequency
    tops = (MOST, SHAPE_FACTOR * MOST)
    axes = [np.geomspace(h * SPAN, top, N_COARSE) for h, top in zip(hyper, tops, strict=True)]
    if not has_shapes:
        axes[1] = np.array([hyper[1]])
    for _ in range(ROUNDS):
        value = _log_posterior(evidence, axes, hyper)
        axes = [_narrowed(axis, special.logsumexp(value, axis=1 - k)) for k, axis in enumerate(axes)]
    value = _log_posterior(evidence, axes, hyper)
    share = np.exp(value - special.logsumexp(value))
    frequency, shape = np.meshgrid(*axes, indexing="ij")
    prior = _log_prior(axes, hyper)
    kept = share > LEAST_SHARE * share.max()
    scales = tuple(sorted((float(a), float(b), float(w)) for a, b, w in
                          zip(frequency[kept], shape[kept], prior[kept], strict=True)))
    central = tuple(_standing_for(problem, k, axis, share.sum(axis=1 - k)) for k, axis in enumerate(axes))
    low, high = _ends(axes[0], share.sum(axis=1))
    words = f"learnt from the misfit and averaged over: {100 * low:.2g} to {100 * high:.2g} % of frequencies"
    if has_shapes:
        low, high = _ends(axes[1], share.sum(axis=0))
        words += f", {100 * low:.2g} to {100 * high:.2g} % of shapes"
    return replace(plain, discrepancy=central[0], shape_discrepancy=central[1], scales=scales, discrepancy_by=words)


def _log_prior(axes: list[np.ndarray], hyper: tuple[float, float]) -> np.ndarray:
    """ln of hyper-prior times step of ln(scale), (n_frequency, n_shape); an axis of one number has weight one."""
    parts = [np.zeros(1) if len(axis) == 1 else log_half_student(axis, h) + np.log(np.log(axis[1] / axis[0]))
             for axis, h in zip(axes, hyper, strict=True)]
    return parts[0][:, None] + parts[1][None, :]


def _log_posterior(evidence: ScaleEvidence, axes: list[np.ndarray], hyper: tuple[float, float]) -> np.ndarray:
    found = np.array([[evidence.at((float(a), float(b))) for b in axes[1]] for a in axes[0]])
    return found + _log_prior(axes, hyper)


def _narrowed(axis: np.ndarray, log_share: np.ndarray) -> np.ndarray:
    """N_FINE scales over where the marginal has its mass, one step beyond to either side."""
    if len(axis) == 1:
        return axis
    inside = np.flatnonzero(log_share > log_share.max() + np.log(LEAST_SHARE))
    return np.geomspace(axis[max(inside[0] - 1, 0)], axis[min(inside[-1] + 1, len(axis) - 1)], N_FINE)


def _ends(axis: np.ndarray, share: np.ndarray) -> np.ndarray:
    """5 and 95 % of the marginal."""
    below = np.cumsum(share) - 0.5 * share
    return np.exp(np.interp([0.05, 0.95], below, np.log(axis)))


def _standing_for(problem: Problem, kind: int, axis: np.ndarray, share: np.ndarray) -> float:
    """The scale at which the responses of one kind have the summed mean inverse variance that they have on average."""
    rows = slice(0, problem.n_frequency) if kind == 0 else slice(problem.n_frequency, None)
    unit = problem.unit_discrepancy[rows] ** 2
    own = replace(problem, scales=(0.0, 0.0)).std[rows] ** 2
    weight = np.array([np.sum(unit / (own + t**2 * unit)) for t in axis])
    wanted = float(share @ weight)
    if not len(unit) or np.ptp(weight) == 0:
        return float(axis[0])
    return float(np.exp(np.interp(-np.log(wanted), -np.log(weight), np.log(axis))))


@dataclass(frozen=True, eq=False)
class ScaleEvidence:
    """ln p(data | scales) of one problem linear about theta, its parameters integrated out over their Gaussian prior:
    residual (n_response,), slope (n_response, n_param); prior_precision, prior_pull (n_param,) the slope of ln p."""

    problem: Problem
    residual: np.ndarray
    slope: np.ndarray
    prior_precision: np.ndarray
    prior_pull: np.ndarray

    @classmethod
    def of(cls, problem: Problem, theta: np.ndarray) -> ScaleEvidence:
        response, slope = problem.sensitivity(theta)
        residual, prior_slope = prior_residual(problem.parameters, theta)
        return cls(problem, problem.measured - response, slope, prior_slope.T @ prior_slope, -prior_slope.T @ residual)

    def at(self, scales: tuple[float, float]) -> float:
        ((taken, node),) = replace(self.problem, weights=replace(
            self.problem.weights, scales=((*scales, 0.0),))).nodes
        return taken + gaussian_at(node, self.residual, self.slope, self.prior_precision, self.prior_pull)[0]
