"""The whole deterministic update of a modal data file, and the whole sampling run, as two functions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from probupdate.errors import ConvergenceError, InputError
from probupdate.modal.channel_mistakes import ChannelMistake
from probupdate.modal.modes import ModalData, ModalSet, set_words
from probupdate.model.interface import Model
from probupdate.runtime.arrays import frozen_array
from probupdate.runtime.executors import Executor
from probupdate.runtime.progress import Progress, silent
from probupdate.structure.affine import AffineModel
from probupdate.structure.reduced import reduce_basis, whole_basis
from probupdate.updating.alpha import AlphaPath, alpha_path, choose
from probupdate.updating.baseline import LearntError
from probupdate.updating.components import misfit_by_response, source_std, variance_components
from probupdate.updating.discrepancy import learnt_error
from probupdate.updating.ensemble import BURN_IN, Chain, claim_folder, sample
from probupdate.updating.evidence import Evidence, LaplaceCheck, check_laplace, estimate_evidence
from probupdate.updating.exchanges import images_about
from probupdate.updating.identifiability import is_too_narrow, too_narrow_sentence
from probupdate.updating.importance import Agreement, Mixture, agree, fitted_proposal, importance_sample
from probupdate.updating.laplace import (
    Laplace,
    distinct_maxima,
    maximum_a_posteriori,
    probable_draws,
    search_maxima,
)
from probupdate.updating.posterior_file import MAX_DRAWS, Posterior
from probupdate.updating.problem import Prediction, Problem, Weights, build_problem
from probupdate.updating.set_matching import suspected_channels
from probupdate.updating.set_wise_updates import update_sets
from probupdate.updating.settings import CONSTANTS, SamplerSettings, UpdateSettings
from probupdate.updating.surrogate import GaussianApproximation, Proposal, fit_surrogate
from probupdate.updating.tikhonov import TikhonovUpdate, update
from probupdate.updating.update_file import (
    BASELINE,
    SCHEME_NAMES,
    AlphaRecord,
    ComponentsRecord,
    ScatterRecord,
    SchemeRecord,
    UpdateRecord,
    beyond_chance,
)

REDUCE_FROM = CONSTANTS.reduce_from
FREQUENCY_TOLERANCE = CONSTANTS.frequency_tolerance
BOX_STD, BOX_TOLERANCE = CONSTANTS.box_std, CONSTANTS.box_tolerance
# checks of the first basis, on which nothing but the Gaussian approximation depends
N_COARSE = 32
# draws of the Gaussian approximation that stand for the region
N_REGION = 400
# posterior draws answered by the full model too, as a check of the reduced one
N_CHECK = 24
SETTLING_MAC = CONSTANTS.settling_mac
# draws whose responses are kept for pictures
N_PREDICTED = 300


def deterministic_update(
    model: Model,
    data: ModalData,
    *,
    set_id: str | None = None,
    weights: Weights | None = None,
    settings: UpdateSettings | None = None,
    every: ModalData | None = None,
    seen_hz: Sequence[float] = (),
    model_at: Callable[[ModalSet], Model] | None = None,
    jobs: int | Executor = 1,
    progress: Progress = silent,
) -> UpdateRecord:
    """Both readings of Eq. 7 and the maximum of the posterior for one set, then each of `every` (None: of the data).
    seen_hz: frequencies that were identified and are not among these data's.

    `model` stands in that one set's environmental conditions; `model_at` gives it in another set's. jobs: processes, or
    an executor, for the sets.
    """
    settings = settings or UpdateSettings()
    problem = build_problem(model, data, set_id=set_id, weights=weights)
    path = alpha_path(problem, progress=progress)
    runs, alpha = _both_tikhonov_updates(problem, path, settings, progress)
    laplace = find_maximum(problem, [run.theta[-1] for run in runs.values()] + [model.parameters.initial])
    schemes = tuple(_scheme(problem, key, run, laplace) for key, run in runs.items())
    sets = _scatter(problem, every or data, schemes[0].closest_iteration, laplace, model_at, jobs, progress)
    predicted = problem.predict_many(np.array([model.parameters.initial, laplace.theta]))
    modal_set = data.set(set_id)
    computed = _order_as_data(problem, np.array(problem.matching.computed, float) + 1, data.n_mode)
    error = learnt_error(problem, laplace.theta)
    likely, seen_hz = _suspected_mistake(problem, data, laplace, set_id), [*_unused_hz(problem, modal_set), *seen_hz]
    return UpdateRecord(
        model=model.name, fingerprint=problem.fingerprint(), parameters=model.parameters, set_id=modal_set.id,
        labels=problem.mode_labels,
        measured_hz=modal_set.frequency_hz,
        measured_std_hz=_order_as_data(problem, problem.frequency_std_hz, data.n_mode),
        initial_hz=_order_as_data(problem, predicted.frequency_hz[0], data.n_mode),
        initial_mac=_order_as_data(problem, predicted.mac[0], data.n_mode),
        initial_misfit=float(problem.misfit(predicted.response[0])),
        computed_mode=np.nan_to_num(computed),
        schemes=schemes,
        pairs=problem.matching.pairs,
        left_out=problem.matching.left_out,
        map_theta=laplace.theta, map_covariance=laplace.covariance, map_resolution=laplace.resolution,
        map_at_bound=laplace.at_bound, map_misfit=laplace.misfit,
        map_hz=_order_as_data(problem, predicted.frequency_hz[1], data.n_mode),
        map_mac=_order_as_data(problem, predicted.mac[1], data.n_mode),
        n_response=problem.measured.size - problem.n_tied, n_effective=problem.n_effective,
        other_maxima=laplace.others,
        derived=_derived_values(model, initial=model.parameters.initial, step=runs["step"].theta[-1],
                                prior=runs["prior"].theta[-1], map=laplace.theta),
        sets=sets,
        settings={"weights": problem.weights.description, "alpha": alpha,
                  "iterations at most": str(settings.iterations), "anchored by": settings.method,
                  **_baseline_settings(problem, error)},
        map_gradient=laplace.projected_gradient,
        alpha_path=_alpha_record(path),
        components=_components(problem, laplace, seen_hz),
        suspected="" if likely is None else f"{likely.sentence}; {likely.remedy}",
        identified_std_hz=_order_as_data(problem, _identified_std_hz(problem), data.n_mode),
        model_error=error,
    )


def _baseline_settings(problem: Problem, error: LearntError | None) -> dict[str, str]:
    """What of earlier states is used, and how much of the model's error all states resolve."""
    if problem.bare is None or error is None:
        return {}
    used, end, n = [], 0, len(problem.unknowns.names)
    every = problem.bare.error_covariance
    for one in problem.weights.baseline:
        end += one.matrix.shape[1]
        both = [*range(end - len(one.names), end), *range(len(every) - n, len(every))]
        used.append(problem.unknowns.used_words(one, every[np.ix_(both, both)]))
    resolved = f"share of the model's error (variance) that these states resolve: {error.resolved_words()}"
    common = ", ".join(problem.weights.common)
    counted = f"one number in all states: {common}" if common else (
        "parameters count as numbers of their own in each state")
    held = "where that is little the intervals hold the error in full"
    return {BASELINE: "; ".join([*used, resolved, held, counted])}


def _both_tikhonov_updates(
    problem: Problem, path: AlphaPath, settings: UpdateSettings, progress: Progress
) -> tuple[dict[str, TikhonovUpdate], str]:
    """Eq. 7 as printed and anchored at the prior, and which alpha was taken."""
    by_rule = isinstance(settings.alpha, str)
    alpha = choose(path, settings.alpha) if isinstance(settings.alpha, str) else settings.alpha
    runs = {
        key: update(problem, penalty=key, alpha=alpha, max_iteration=settings.iterations, progress=progress,
                    method=settings.method if key == "prior" else "gauss-newton")
        for key in ("step", "prior")
    }
    return runs, f"{alpha:g} ({settings.alpha if by_rule else 'by hand'})"


def _suspected_mistake(problem: Problem, data: ModalData, laplace: Laplace,
                       set_id: str | None) -> ChannelMistake | None:
    """Channels that would explain shapes unlike the model's, at its initial parameters or at the maximum."""
    return suspected_channels(problem.model, data, [problem.parameters.initial, laplace.theta], set_id=set_id,
                              absent=problem.matching.absent)


def _identified_std_hz(problem: Problem) -> np.ndarray:
    """Of the frequencies used, without the model's discrepancy."""
    total = np.concatenate([g.frequency_std_hz for g in problem.groups])
    missed = np.concatenate([g.frequency_discrepancy_hz for g in problem.groups])
    return np.sqrt(np.maximum(total**2 - missed**2, 0.0))


def _scatter(
    problem: Problem, data: ModalData, iterations: int, together: Laplace,
    model_at: Callable[[ModalSet], Model] | None, jobs: int | Executor, progress: Progress,
) -> ScatterRecord | None:
    """Every set of the data updated by itself, the printed reading of Eq. 7 as often as came closest to the maximum;
    None where fewer than two can be."""
    if len(data.sets) < 2:
        return None
    clusters = [group.measured for group in problem.matching.groups]
    scatter = update_sets(problem.model, data, weights=problem.weights, clusters=clusters,
                          iterations=max(1, iterations), start=together.theta,
                          model_at=model_at, jobs=jobs, progress=progress)
    if len(scatter.ids) < 2:
        return None
    return ScatterRecord(**{name: getattr(scatter, name) for name in ScatterRecord.__dataclass_fields__})


def _derived_values(model: Model, **theta: np.ndarray) -> dict[str, dict[str, float]]:
    """What the model derives from parameters (n_param,), such as the stiffness of a pile's head: name -> state ->
    value."""
    return {name: {state: float(compute(values)) for state, values in theta.items()}
            for name, compute in getattr(model, "derived", {}).items()}


def _alpha_record(path: AlphaPath) -> AlphaRecord:
    return AlphaRecord(alpha=path.alpha, theta=path.theta, misfit=path.misfit, penalty=path.penalty,
                       log_evidence=path.log_evidence, chosen=path.chosen, remarks=path.remarks)


def _unused_hz(problem: Problem, modal_set: ModalSet) -> list[float]:
    """Frequencies that the set has and the responses have not."""
    return [float(modal_set.frequency_hz[j]) for j in np.flatnonzero(modal_set.measured) if j not in problem.used]


def _components(problem: Problem, laplace: Laplace, seen_hz: Sequence[float]) -> ComponentsRecord:
    parts = variance_components(problem, laplace, seen_hz)
    responses, chi_square, expected = misfit_by_response(problem, laplace)
    n_param = len(parts.parameters)
    return ComponentsRecord(
        names=parts.names, std=parts.std, source_names=parts.source_names, source_std=parts.source_std,
        measures=tuple(m.what for m in parts.measures),
        gain=frozen_array(np.array([m.gain for m in parts.measures]).reshape(-1, n_param)),
        responses=responses, chi_square=frozen_array(chi_square), expected=frozen_array(expected),
    )


def find_maximum(problem: Problem, starts: list[np.ndarray]) -> Laplace:
    """`maximum_a_posteriori` from these starts and `probable_draws`; where it does not settle because shapes are not
    this model's, that is the user's."""
    try:
        return maximum_a_posteriori(problem, [*starts, *probable_draws(problem)])
    except ConvergenceError as error:
        mac = problem.predict_many(np.array([problem.parameters.initial, error.estimate])).mac
        if mac.max(axis=0).min() >= SETTLING_MAC:
            raise
        listed = ", ".join(f"{problem.mode_labels[j]} {a:.2f} and {b:.2f}"
                           for j, a, b in zip(problem.used, *mac, strict=True))
        raise InputError(
            set_words(problem.set_id), "the update did not converge, and its modes may not be this model's: MACs at "
            f"the initial and the best parameters are {listed}", "check the order, names and signs of the channels, "
            "and that the model is of this structure",
        ) from None


def _order_as_data(problem: Problem, values: np.ndarray, n_mode: int) -> np.ndarray:
    result = np.full(n_mode, np.nan)
    result[list(problem.used)] = values
    return frozen_array(result)


def _scheme(problem: Problem, key: str, run: TikhonovUpdate, laplace: Laplace) -> SchemeRecord:
    n_mode = len(problem.mode_labels)
    apart = run.theta - laplace.theta
    distance = np.sqrt(np.einsum("ij,jk,ik->i", apart, laplace.precision, apart) / apart.shape[1])
    return SchemeRecord(
        key=key, name=SCHEME_NAMES[key], theta=run.theta,
        objective={"responses": run.misfit, "parameters": run.penalty, "total": run.objective},
        distance_to_map=frozen_array(distance), share=run.share,
        frequency_hz=_order_as_data(problem, run.frequency_hz[-1], n_mode),
        mac=_order_as_data(problem, run.mac[-1], n_mode), at_bound=run.at_bound, converged=run.converged,
        status=run.status, alpha=run.alpha,
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class Approach:
    """What a chain needs: the problem on a fast model, a Gaussian approximation of the posterior about the maximum that
    was known, the `highest` of all that were found (n_param,), a frozen proposal with `solved` points that it was
    fitted to, and what to say of them."""

    problem: Problem
    surrogate: GaussianApproximation
    highest: np.ndarray
    proposal: Mixture
    solved: int
    notes: dict[str, Any]


def approach(problem: Problem, laplace: Laplace, seed: int, progress: Progress = silent) -> Approach:
    """Approximate the posterior by a Gaussian and reduce the model for it.

    A first basis covers BOX_STD prior standard deviations to BOX_TOLERANCE; with it the Gaussian approximation is
    fitted, and where that lies a second basis holds to FREQUENCY_TOLERANCE. Models that are small or cannot be reduced
    stay as they are.
    """
    model, parameters = problem.model, problem.parameters
    rng = np.random.default_rng([seed, 2])
    if not isinstance(model, AffineModel) or model.n_dof < REDUCE_FROM:
        if isinstance(model, AffineModel):
            # many solutions at once; the basis leaves nothing out
            problem = problem.with_model(whole_basis(model, problem.matching.n_mode))
        surrogate, share = fit_surrogate(problem, laplace, rng, progress)
        text = "none: every evaluation solves the model as it is"
        return _approach(problem, laplace, surrogate, rng, {"reduced basis": text, "approximation": share}, progress)
    # data may hold a parameter far from its prior: the box goes where the posterior does
    own = np.sqrt(np.diag(laplace.covariance))
    lower = np.minimum(parameters.initial - BOX_STD * parameters.std, laplace.theta - BOX_STD * own)
    upper = np.maximum(parameters.initial + BOX_STD * parameters.std, laplace.theta + BOX_STD * own)
    lower, upper = np.maximum(lower, parameters.lower), np.minimum(upper, parameters.upper)
    options = {"n_mode": problem.matching.n_mode, "seed": seed, "progress": progress}
    coarse = reduce_basis(model, frequency_tolerance=BOX_TOLERANCE, n_verify=N_COARSE, box=(lower, upper), **options)
    # the first approximations of a sharp posterior reach far out of the box: the basis answers there too, worse, as
    # nothing but the Gaussian approximation depends on it; the full model took a minute for what the next round
    # corrects
    unbounded = {"lower": np.full_like(lower, -np.inf), "upper": np.full_like(upper, np.inf)}
    surrogate, share = fit_surrogate(problem.with_model(replace(coarse, **unbounded)), laplace, rng, progress)
    points = surrogate.draw(N_REGION, rng)
    box = np.minimum(lower, points.min(axis=0)), np.maximum(upper, points.max(axis=0))
    reduced = reduce_basis(model, frequency_tolerance=FREQUENCY_TOLERANCE, points=points, box=box, **options)
    r = reduced.verification
    text = (
        f"{r.size} vectors; on {r.n_verify} points not used to build it the frequencies differ by at most "
        f"{r.max_frequency_error:.1e} of their value where the posterior lies and {r.max_box_error:.1e} within "
        f"{BOX_STD:g} prior standard deviations; the MAC is at least {r.min_mac:.6f}"
    )
    notes = {"reduced basis": text, "approximation": share}
    return _approach(problem.with_model(reduced), laplace, surrogate, rng, notes, progress,
                     problem.with_model(replace(reduced, **unbounded)))


def _approach(problem: Problem, laplace: Laplace, surrogate: GaussianApproximation, rng, notes,
              progress: Progress, everywhere: Problem | None = None) -> Approach:
    """Further maxima from draws of the prior, and a proposal for all of them; of those that are alike as parameters
    may be exchanged, for one."""
    maxima, n_start, unseen = search_maxima(problem, laplace, rng)
    images, words = None, ""
    if len(maxima) > 1:
        images, words = images_about(problem, laplace)
    if images is not None:
        maxima = distinct_maxima(problem, laplace, images.fold(np.array([one.theta for one in maxima])))
    approximations = [surrogate]
    for other in maxima:
        if other is not laplace:
            approximations.append(fit_surrogate(problem, other, rng, progress)[0])
    problem = replace(problem, images=images)
    proposal, solved = fitted_proposal(problem, [Proposal(approximation=x) for x in approximations], rng, progress,
                                       everywhere=everywhere)
    notes = notes | {"maxima": len(maxima), "starts": n_start, "unseen": unseen, "exchanges": words}
    highest = max(maxima, key=lambda one: one.log_posterior).theta
    return Approach(problem=problem, surrogate=surrogate, highest=highest, proposal=proposal, solved=solved,
                    notes=notes)


def sample_posterior(
    model: Model,
    data: ModalData,
    folder: str | Path,
    *,
    set_id: str | None = None,
    weights: Weights | None = None,
    settings: SamplerSettings | None = None,
    jobs: int | Executor = 1,
    progress: Progress = silent,
) -> Posterior:
    """Maximum, reduced basis, chain, its check against the full model, evidence. The chain's segments are kept in
    `folder`; jobs: processes or an executor for its ensembles."""
    settings = settings or SamplerSettings()
    problem = build_problem(model, data, set_id=set_id, weights=weights)
    parts = problem.parts() | {"reduction": f"{FREQUENCY_TOLERANCE:g} {BOX_STD:g} {BOX_TOLERANCE:g}"}
    claim_folder(problem.parameters, folder, settings, parts)
    anchored = update(problem, penalty="prior", progress=progress)
    laplace = find_maximum(problem, [anchored.theta[-1], model.parameters.initial])
    prepared = approach(problem, laplace, settings.seed, progress)
    fast = prepared.problem
    if np.any(prepared.highest != laplace.theta):
        # of the reduced model, a little beside the full one's
        laplace = find_maximum(problem, [prepared.highest, laplace.theta])
    # numbers of their own, so that a chain's length changes none of the others
    weighted = importance_sample(fast, prepared.proposal, np.random.default_rng([settings.seed, 6]),
                                 evaluated=prepared.solved, progress=progress)
    chain = sample(fast, prepared.proposal, folder, settings, trusted=weighted.good, parts=parts, jobs=jobs,
                   progress=progress)
    kept = chain.theta[chain.first :]
    log_posterior = chain.log_posterior[chain.first :]
    checked_laplace = check_laplace(fast, laplace, np.random.default_rng([settings.seed, 4]), progress)
    # what a chain that has not converged says of it is not stated
    evidence = None
    if chain.converged:
        evidence = estimate_evidence(fast.parameters, prepared.proposal, weighted.log_weight, kept, log_posterior)
    thin = max(1, int(np.ceil(kept.shape[0] * kept.shape[1] / MAX_DRAWS)))
    kept = kept[::thin]
    rng = np.random.default_rng([settings.seed, 3])
    if fast.images is not None:
        kept, log_posterior = fast.images.spread(kept, rng), log_posterior - fast.images.log_number
    flat = kept.reshape(-1, kept.shape[2])
    shown = flat[rng.choice(len(flat), size=min(N_PREDICTED, len(flat)), replace=False)]
    predicted = fast.predict_many(shown)
    found = _SampledChain(
        problem=problem, laplace=laplace, prepared=prepared, chain=chain, thin=thin, theta=kept,
        log_posterior=log_posterior[::thin], agreement=agree(weighted, chain),
        laplace_check=checked_laplace, evidence=evidence, predicted=predicted,
        against=_compare_with_full(problem, predicted, shown[:N_CHECK]),
        likely=_suspected_mistake(problem, data, laplace, set_id),
    )
    return _posterior(found, data, settings, rng)


@dataclass(frozen=True, eq=False, kw_only=True)
class _SampledChain:
    """A chain, every `thin`-th step of it after burn-in (theta, log_posterior), and what it stands beside: the problem
    on the full model, the maximum, the approach, weighted draws, the evidence (None: not stated), predictions at some
    draws and those of the full model, channels that may be mistaken."""

    problem: Problem
    laplace: Laplace
    prepared: Approach
    chain: Chain
    thin: int
    theta: np.ndarray
    log_posterior: np.ndarray
    agreement: Agreement
    laplace_check: LaplaceCheck
    evidence: Evidence | None
    predicted: Prediction
    against: _AgainstFull
    likely: ChannelMistake | None


def _posterior(found: _SampledChain, data: ModalData, settings: SamplerSettings, rng: np.random.Generator) -> Posterior:
    """What is kept of a run: its draws, draws of the prior, predictions, verdict and record."""
    problem, chain, agreement, predicted = found.problem, found.chain, found.agreement, found.predicted
    parameters = problem.parameters
    log_prior = parameters.log_density(found.theta)
    error = learnt_error(problem, found.laplace.theta)
    n_own = problem.measured.size - problem.n_tied
    return Posterior(
        names=parameters.names,
        theta=frozen_array(found.theta.transpose(1, 0, 2)),
        log_likelihood=frozen_array((found.log_posterior - log_prior).T),
        log_posterior=frozen_array(found.log_posterior.T),
        prior=frozen_array(parameters.draw(rng, 4000)),
        response_labels=tuple(_response_labels(problem)),
        measured=problem.measured[:n_own],
        std=problem.whole_std[:n_own],
        predicted=frozen_array(predicted.response[:, :n_own]),
        frequency_hz=frozen_array(predicted.frequency_hz),
        mode_labels=tuple(problem.mode_labels[j] for j in problem.used),
        r_hat=chain.r_hat,
        ess=chain.ess,
        converged=chain.converged and agreement.agrees,
        verdict=chain.verdict if agreement.agrees else f"NOT converged: {agreement.sentence}",
        fingerprint=problem.fingerprint(),
        record=_run_record(found, settings, error), model_error=error,
    )


def _run_record(found: _SampledChain, settings: SamplerSettings, error: LearntError | None) -> dict[str, Any]:
    """How the draws came about and what to read before them, as posterior.nc keeps it."""
    problem, laplace, chain, predicted = found.problem, found.laplace, found.chain, found.predicted
    unstated = "ln evidence is not stated, as the chain has not converged"
    statements = [*_baseline_settings(problem, error).values(),
                  *_warnings(problem, laplace, found.likely, found.prepared.notes),
                  *_too_narrow(problem, laplace, found.theta), found.agreement.sentence,
                  found.laplace_check.sentence, unstated if found.evidence is None else found.evidence.sentence]
    likely = found.likely
    return found.prepared.notes | {
        "set_id": problem.set_id, "weights": problem.weights.description, "seed": settings.seed,
        "walkers": chain.theta.shape[1], "steps": chain.theta.shape[0], "thinned by": found.thin,
        "left out at the start": f"{100 * BURN_IN:g} % of the steps", "acceptance": chain.acceptance,
        "evaluated": chain.evaluated, "fallback": chain.fallback,
        "autocorrelation time": float(np.max(chain.tau)),
        "full model on posterior draws": found.against.sentence,
        "map": laplace.theta.tolist(), "n_effective": problem.n_effective, "model": problem.model.name,
        "median misfit": float(np.median(problem.misfit(predicted.response))),
        "worst mac": float(np.min(predicted.mac)), "laplace": asdict(found.laplace_check),
        **({} if found.evidence is None else {"evidence": asdict(found.evidence)}),
        **({} if likely is None else {"suspected": f"{likely.sentence}; {likely.remedy}"}),
        "importance sampling": asdict(found.agreement), "tail effective size": chain.tail.tolist(),
        "ensembles": settings.ensembles, "projected gradient at the map": laplace.projected_gradient,
        "statements": statements, "notes": _notes(problem, laplace, found.against),
        **({} if problem.weights.baseline else {"likelihood": problem.weights.to_table()}),
    }


class _AgainstFull(NamedTuple):
    """Of n posterior draws answered by the full model too: largest relative difference of a frequency, of the
    log-likelihood; and the share of all draws that pair a measured mode with the highest mode computed."""

    n: int
    frequency: float
    log_likelihood: float
    at_highest: float

    @property
    def sentence(self) -> str:
        return (f"{self.n} draws: frequencies within {self.frequency:.1e}, "
                f"log-likelihood within {self.log_likelihood:.1e}")


def _compare_with_full(problem: Problem, predicted: Prediction, checked: np.ndarray) -> _AgainstFull:
    """`predicted`: by the reduced model, the first of them at `checked`."""
    n, full = len(checked), problem.predict_many(checked)
    at_highest = float(np.mean(predicted.computed.max(axis=1) == problem.matching.n_mode - 1))
    # where the model itself has no further modes, none was left out of the search
    if problem.matching.n_mode >= getattr(problem.model, "full", problem.model).n_available:
        at_highest = 0.0
    return _AgainstFull(
        n=n, at_highest=at_highest,
        frequency=float(np.max(np.abs(predicted.frequency_hz[:n] / full.frequency_hz - 1))),
        log_likelihood=0.5 * float(
            np.max(np.abs(problem.misfit(predicted.response[:n]) - problem.misfit(full.response)))),
    )


def _warnings(
    problem: Problem, laplace: Laplace, likely: ChannelMistake | None, found: dict[str, Any]
) -> list[str]:
    """What is to be read before any number of the posterior."""
    said = [found["exchanges"]] if found["exchanges"] else []
    if found["maxima"] > 1:
        said.append(f"{found['maxima']} separate maxima of the posterior, found by {found['starts']} starts and all of "
                    f"them sampled; a further start finds a new one with probability {found['unseen']:.2g}, and ln "
                    "evidence counts those found")
    if likely is not None:
        said.append(f"SUSPECT: the measured shapes are not this model's, and {likely.sentence}; {likely.remedy}")
    if laplace.misfit > beyond_chance(problem.n_effective):
        said.append(f"MISFIT BEYOND CHANCE: chi-square at the maximum {laplace.misfit:.4g} for {problem.n_effective} "
                    "effective responses; the posterior is not to be trusted")
    return said


def _too_narrow(problem: Problem, laplace: Laplace, theta: np.ndarray) -> list[str]:
    """Of draws (n_step, n_walker, n_param)."""
    std, approximate = np.std(theta, axis=(0, 1), ddof=1), np.sqrt(np.diag(laplace.covariance))
    of_sources = source_std(problem, laplace)
    narrow = is_too_narrow(std, of_sources, approximate, laplace.theta, problem.parameters)
    return [too_narrow_sentence(problem.parameters.names[k], std[k], float(np.linalg.norm(of_sources[:, k])),
                                approximate[k]) for k in np.flatnonzero(narrow)]


def _notes(problem: Problem, laplace: Laplace, against: _AgainstFull) -> list[str]:
    notes = []
    if against.at_highest > 0:
        notes.append(f"in {100 * against.at_highest:.0f} % of draws a measured mode pairs with the highest mode "
                     "computed: a still higher one might fit better")
    if against.log_likelihood > 0.1:
        notes.append(f"the reduced basis shifts the log-likelihood by up to {against.log_likelihood:.2g} on posterior "
                     "draws")
    if laplace.others:
        notes.append(f"the posterior has further maxima, {', '.join(f'{x:g}' for x in laplace.others)} below in ln p")
    notes += list(problem.matching.left_out)
    return notes


def _response_labels(problem: Problem) -> list[str]:
    frequency = "ln f" if problem.weights.frequencies == "log" else "f"
    labels = [f"{frequency} {problem.mode_labels[j]}" for j in problem.used]
    channels = problem.model.channels
    for matched, group in zip(problem.matching.groups, problem.groups, strict=True):
        if group.shapes == "none":
            continue
        name = "+".join(problem.mode_labels[j] for j in matched.measured)
        for k in range(group.basis.shape[1]):
            labels += [f"shape {name} {k + 1} {channels[row]}" for row in group.rows]
    return labels
