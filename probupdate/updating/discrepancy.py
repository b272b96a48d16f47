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
from scipy import special

from probupdate.errors import InputError
from probupdate.modal.modes import ModalData, set_words
from probupdate.model.interface import Model
from probupdate.runtime.arrays import frozen_array
from probupdate.runtime.progress import Progress, silent
from probupdate.runtime.settings import refuse_other_types, setting
from probupdate.updating.baseline import LearntError, Rows
from probupdate.updating.baseline_file import Baseline, read_baseline
from probupdate.updating.laplace import Laplace, maximum_a_posteriori, prior_residual
from probupdate.updating.problem import Problem, Weights, build_problem, paper_weights
from probupdate.updating.responses import FORM_FREQUENCY_COV, FORM_SHAPE_STD, SHAPE_FACTOR
from probupdate.updating.scales import MOST, Evidence, LearntScales, hyper_scales, learn_scales
from probupdate.updating.set_likelihoods import Coordinates
from probupdate.updating.set_matching import suspected_channels, with_mistake
from probupdate.updating.settings import CONSTANTS
from probupdate.updating.shared_error import GaussianPrior, shared_error
from probupdate.updating.tikhonov import update

PLACE = CONSTANTS.place


@dataclass(frozen=True, eq=False, kw_only=True)
class LikelihoodSettings:
    """What is compared and what is stated of its error: one value, the same for every estimator that is given it."""

    weights: str | tuple[float, ...] | Weights = setting(
        "measured", "-", "standard deviations of the responses: 'measured', 'covariance', 'paper', or a CoV a mode")
    frequencies: str = setting("hz", "-", "frequencies are compared as they are ('hz') or as logarithms ('log')")
    shapes: str = setting("plane", "-", "shapes are compared as 'plane', 'components', 'mac' or 'none'")
    discrepancy: float | str | None = setting(
        None, "-", "share of every frequency that the model may miss, and ten times that of shapes; 'auto' for as much "
        "as the misfit says; None: 'auto' with the measurement's own standard deviations, else 0")
    tolerances: bool | None = setting(
        None, "-", "stated tolerances of structure, soil, rotor-nacelle assembly and sensors are marginalised; None: "
        "with the measurement's own standard deviations")
    modes: tuple[str | int, ...] | None = setting(
        None, "-", "labels of the modes that are compared, or their numbers from 1; None: those of interest")
    fix: Mapping[str, float] | None = setting(None, "-", "parameters that are held, name -> value")
    alternatives: tuple[object, ...] = setting(
        (), "-", "other models of the same structure (files or models): the truth may lie anywhere from this model to "
        "each, a source of error that is marginalised")
    baseline: tuple[Baseline, ...] = setting(
        (), "-", "runs of other states of the structure, whose model's error is this one's: directories or files")
    common: tuple[str, ...] = setting((), "-", "parameters that are the same number in the baseline's states")

    def __post_init__(self):
        refuse_other_types(self)

    @property
    def joint_covariance(self) -> bool:
        """Whether the covariance of all modes together is asked for."""
        return self.weights.covariance if isinstance(self.weights, Weights) else self.weights == "covariance"

    def stated_for(self, model: Model, data: ModalData, *, progress: Progress = silent) -> Weights:
        """As plain numbers, of the reference set; weights that have been stated already stay."""
        if isinstance(self.weights, Weights) and self.weights.at is not None and self.discrepancy is None:
            return self.weights
        chosen = weights_by_name(self.weights, data, frequencies=self.frequencies, shapes=self.shapes,
                                 tolerances=self.tolerances)
        if self.alternatives and not chosen.tolerances:
            raise InputError("alternatives", "are sources of the model's error, which these weights do not marginalise",
                             "give --tolerances too")
        chosen = replace(chosen, baseline=tuple(read_baseline(one) for one in self.baseline), common=self.common)
        for name in self.common:
            model.parameters.index(name)
        discrepancy = self.discrepancy
        if discrepancy is None:
            own = isinstance(self.weights, str) and self.weights in ("measured", "covariance")
            discrepancy = "auto" if own else 0.0
        return state_model_error(model, data, weights=chosen, discrepancy=discrepancy, progress=progress)


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
            problem = build_problem(model, data, set_id=set_id, weights=replace(chosen, baseline=(), common=()))
            start = update(problem, penalty="prior").theta[-1] if chosen.at is None else np.array(chosen.at)
            chosen = replace(chosen, at=_place(model, maximum_a_posteriori(problem, [start]).theta))
    if discrepancy == "auto":
        chosen = estimate_discrepancy(model, data, weights=chosen, set_id=set_id, progress=progress)
    return chosen


def weights_by_name(
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
                         "choose from measured, covariance, paper, or give one CoV per mode")
    return Weights(frequency_cov=tuple(float(w) for w in weights), shape_std=False, **compared)


def default_likelihood(model: Model, data: ModalData) -> Weights:
    """What `update` and `sample` take where no option is given."""
    return LikelihoodSettings().stated_for(model, data)


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
    baseline = {"baseline": weights.baseline, "common": weights.common}
    first = build_problem(model, data, set_id=set_id, weights=replace(weights, baseline=(), common=()),
                          clusters=clusters)
    hyper = hyper_scales(first)
    plain = replace(first.weights, discrepancy=hyper[0], shape_discrepancy=hyper[1], mixing=hyper[2], scales=())
    progress("model discrepancy", 0, 3)
    problem = build_problem(model, data, set_id=set_id, weights=plain, clusters=clusters)
    start = update(problem, penalty="prior").theta[-1]
    _refuse_unexplained(problem, model, data, start, set_id)
    chosen = plain
    for step in range(2):
        progress("model discrepancy", step + 1, 3)
        known = replace(problem, weights=replace(problem.weights, **baseline)).with_baseline()
        start = maximum_a_posteriori(known, [start]).theta
        if weights.at is None or weights.baseline:
            # modes mix and turn where they are, not where the initial model has them
            plain = replace(plain, at=_place(model, start))
            problem = build_problem(model, data, set_id=set_id, weights=replace(problem.weights, at=plain.at),
                                    clusters=clusters)
        chosen = _learnt(problem, start, plain, known)
        problem = build_problem(model, data, set_id=set_id, weights=replace(chosen, scales=()), clusters=clusters)
    progress("model discrepancy", 3, 3)
    return replace(chosen, **baseline)


def _refuse_unexplained(problem: Problem, model: Model, data: ModalData, start: np.ndarray, set_id) -> None:
    """Raises InputError where even the largest discrepancy leaves a misfit that is none of chance."""
    widest = replace(problem, scales=(MOST, SHAPE_FACTOR * MOST, 0.0))
    laplace = maximum_a_posteriori(widest, [start])
    if laplace.misfit <= expected_misfit(widest, laplace):
        return
    error = InputError(set_words(problem.set_id), f"even a model discrepancy of {100 * MOST:g} % of every frequency "
                       "does not explain the misfit", "check pairing, channels and units")
    likely = suspected_channels(model, data, [model.parameters.initial, start], set_id=set_id,
                                absent=problem.matching.absent)
    raise error if likely is None else with_mistake(error, likely)


def _learnt(problem: Problem, theta: np.ndarray, plain: Weights, known: Problem) -> Weights:
    """Nodes over the scales about the maximum theta (n_param,), and the numbers that stand for them; known: the same
    with a baseline, where there is one."""
    as_they_are = Coordinates(logarithmic=np.zeros(len(theta), bool), scale=problem.parameters.std)
    error = shared_error([problem], theta[None], as_they_are, alone=True)
    found = learn_scales(error, _prior_about(problem, theta),
                         evidence=None if known.bare is None else _evidence(known.bare, _error_alone(
                             problem, theta, error_rows(known, theta))))
    scales = tuple(sorted((*node.new, node.shared[2] if problem.mixing is not None else 0.0, node.log_weight)
                          for node in found.nodes))
    frequency, shape, *_, mixing = found.ends
    words = "learnt from the misfit and averaged over: " + _range_text(frequency, "frequencies")
    if problem.measured.size > problem.n_frequency:
        words += f", {_range_text(shape, 'shapes')}"
    if problem.mixing is not None:
        words += f", {_range_text(mixing, 'stiffness')}"
    central = [_standing_for(problem, k, found) for k in range(2)]
    mixes = float(np.exp(found.marginal[4] @ np.log(found.axes[4]))) if problem.mixing is not None else 0.0
    return replace(plain, discrepancy=central[0], shape_discrepancy=central[1], mixing=mixes, scales=scales,
                   discrepancy_by=words)


def _evidence(problem: Problem, rows: Rows) -> Evidence:
    """Of the scales, by all that is known of the error."""
    def of_scales(new: tuple[float, float], shared: np.ndarray) -> np.ndarray:
        return np.array([rows.log_evidence(replace(problem, scales=(*new, float(s[2]))).error_covariance)
                         for s in shared])
    return of_scales


def error_rows(problem: Problem, theta: np.ndarray) -> Rows:
    """What the measured responses and a baseline say of the model's errors and of the parameters, linear about theta
    (n_param,)."""
    bare = problem.bare or problem
    response, slope = bare.sensitivity(theta)
    root = bare.without_error.unmixed_root
    rows = Rows(matrix=root, value=root @ (bare.measured - response + slope @ theta), slope=root @ slope,
                parameters=problem.parameters.names)
    if problem.known is None:
        return rows
    n = problem.known.matrix.shape[1]
    return rows.place(n - root.shape[1], n).stack_below([problem.known])


def _error_alone(problem: Problem, theta: np.ndarray, rows: Rows) -> Rows:
    """With the parameters' prior about theta (n_param,) integrated out."""
    centre, precision = _prior_about(problem, theta)
    return rows.marginal(centre, np.linalg.inv(precision))


def learnt_error(problem: Problem, theta: np.ndarray) -> LearntError | None:
    """The model's error after these data and what a baseline said, about the maximum theta (n_param,); None where none
    is stated, or shapes count as MACs."""
    bare = problem.bare or problem
    if problem.weights.shapes == "mac" or not np.any(bare.error_covariance):
        return None
    every = error_rows(problem, theta)
    rows = _error_alone(problem, theta, every)
    centre, precision = _prior_about(problem, theta)
    stated = problem.weights.scales or ((*problem.weights.discrepancies, problem.weights.mixing, 0.0),)
    priors = [replace(bare, scales=scales[:3]).error_covariance for scales in stated] if problem.weights.scales else [
        bare.error_covariance]
    value = np.array([scales[3] for scales in stated]) + [rows.log_evidence(prior) for prior in priors]
    share = np.exp(value - special.logsumexp(value))
    found = [rows.posterior(prior) for prior in priors]
    means = np.array([mean for mean, _ in found])
    mean = share @ means
    prior = np.einsum("k,kij->ij", share, np.array(priors))
    covariance = np.einsum("k,kij->ij", share, np.array([c for _, c in found]))
    covariance += (share[:, None] * (means - mean)).T @ (means - mean)
    earlier, own = problem.weights.baseline, bare.unknowns
    # of all states this one is the last
    here = slice(-len(own.names), None)
    mean, covariance, before = mean[here], covariance[here, here], np.diag(prior)[here]
    unit = np.concatenate([np.ones(every.matrix.shape[1] - len(own.names)), own.unit])
    left = np.where(before > 1e-9 * before.max(), np.diag(covariance) / np.where(before > 0, before, 1.0), np.nan)
    kinds = ("frequencies", *(("shapes",) if len(own.names) > bare.n_frequency else ()),
             *(("stiffness",) if bare.mixing is not None else ()))
    return LearntError(
        model=problem.model.name, states=(*(s for one in earlier for s in one.states), problem.set_id),
        data=(*(d for one in earlier for d in one.data), own.data), tolerances=own.tolerances, names=own.names,
        origins=(*(state for one in earlier for state in one.origins), bare.error_origins(
            theta if problem.weights.at is None else np.array(problem.weights.at))),
        measured=frozen_array(own.measured), matrix=frozen_array(every.matrix * unit), left=frozen_array(left),
        value=frozen_array(every.value), slope=frozen_array(every.slope), parameters=every.parameters,
        centre=frozen_array(centre), spread=frozen_array(np.linalg.inv(precision)), mean=frozen_array(mean / own.unit),
        covariance=frozen_array(covariance / np.outer(own.unit, own.unit)),
        scales={name: _ends(np.array([s[k] for s in stated]), share) for k, name in enumerate(kinds)})


def _ends(values: np.ndarray, share: np.ndarray) -> tuple[float, float]:
    """5 and 95 % of nodes with their probabilities."""
    axis, number = np.unique(values, return_inverse=True)
    marginal = np.bincount(number, weights=share)
    if len(axis) == 1:
        return float(axis[0]), float(axis[0])
    low, high = (np.exp(np.interp(q, np.cumsum(marginal) - 0.5 * marginal, np.log(axis))) for q in (0.05, 0.95))
    return float(low), float(high)


def _range_text(ends: tuple[float, float], what: str) -> str:
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
