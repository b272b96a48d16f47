"""The same sets read in four ways, side by side: (a) scatter of their updates, (b) their posteriors pooled, (c) one
posterior for all, (d) a population whose mean and scatter are inferred. What each is for stands beside it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import optimize, special, stats

from probupdate.errors import InputError
from probupdate.modal.modes import ModalData, ModalSet
from probupdate.model.interface import Model
from probupdate.model.parameters import Parameters
from probupdate.runtime.arrays import frozen_array
from probupdate.runtime.progress import Progress, silent
from probupdate.updating.hierarchical import SPREAD, Population, sample_population, scatter_interval
from probupdate.updating.identifiability import cov_of
from probupdate.updating.importance import GOOD_K, Mixture
from probupdate.updating.laplace import Laplace, prior_residual, start_of_sets
from probupdate.updating.outlier_sets import without_outliers
from probupdate.updating.predictive import (
    LeaveOneOut,
    bits_gained,
    population_left_out,
    population_score,
)
from probupdate.updating.problem import Problem, Weights, build_problem
from probupdate.updating.scales import LearntScales, learn_scales
from probupdate.updating.set_likelihoods import Coordinates, SetLikelihoods, coordinates_of, linearise
from probupdate.updating.set_views_file import (
    MANY,
    ONE,
    POOLED,
    ModeScatter,
    SetsRow,
    SetViews,
    advice,
    parameter_sentence,
)
from probupdate.updating.set_wise_updates import iterate_sets
from probupdate.updating.settings import CONSTANTS
from probupdate.updating.shared_error import (
    AveragedDensity,
    GaussianPrior,
    Inner,
    SharedError,
    join_densities,
    shared_error,
    total,
)
from probupdate.updating.surrogate import GaussianApproximation, Proposal, TruncatedGaussian
from probupdate.updating.weight_smoothing import smoothed_weights

# draws of the posterior of all linearised sets and of some, how often their proposal is fitted to them again, and the
# nodes whose Gaussians propose, by their share of the posterior from the widest on
N_DRAW, N_ALONE, ROUNDS = 8000, 4000, 4
PROPOSED = (0.02, 0.2, 0.5, 0.85)
TRUSTED_K = CONSTANTS.trusted_k
# draws of the prior whose covariance stands for it where the shared error shifts the mean
N_PRIOR = 20_000
# draws of the population that the full model answers too, and of derived quantities
N_CHECK, N_DERIVED = 40, 120
# effective sizes of the population at the first linearisation and at the last
FIRST_ESS, LAST_ESS = 150, 500
# where only a mean is taken to linearise about
FIRST_R_HAT = 1.1
LINEAR_SHARE = CONSTANTS.linear_share


@dataclass(frozen=True, eq=False)
class _WeightedDraws:
    """Draws theta (n, n_param) with normalised weights (n,), ln evidence, Pareto k."""

    theta: np.ndarray
    weight: np.ndarray
    log_evidence: float
    pareto_k: float

    def mean(self) -> np.ndarray:
        return self.weight @ self.theta

    def variance(self) -> np.ndarray:
        return self.weight @ (self.theta - self.mean()) ** 2

    def resample(self, n: int, rng: np.random.Generator) -> np.ndarray:
        return self.theta[rng.choice(len(self.theta), size=n, p=self.weight)]


def joint_posterior(
    likelihoods: AveragedDensity, parameters: Parameters, coordinates: Coordinates, prior: GaussianPrior,
    rng: np.random.Generator, n_draw: int = N_DRAW,
) -> _WeightedDraws:
    """One posterior of all these sets by importance sampling: Gaussians of a few nodes propose, narrow and wide ones,
    then one fitted to the draws."""
    powers = tuple(0 if x else 1 for x in coordinates.logarithmic)
    share = likelihoods.shares(prior)
    order = np.argsort(np.linalg.slogdet(likelihoods.precision + prior[1])[1])
    below = np.cumsum(share[order])
    picked = sorted({int(order[np.searchsorted(below, q * below[-1])]) for q in PROPOSED})
    proposals = [_gaussian(likelihoods.node(k), parameters, coordinates) for k in picked]
    tried: list[_WeightedDraws] = []
    for _ in range(ROUNDS):
        each = [Proposal(approximation=GaussianApproximation(
            gaussian=gaussian, powers=powers, lower=parameters.lower, upper=parameters.upper,
            origin=np.zeros(len(parameters)))) for gaussian in proposals]
        proposal = Mixture(parameters=parameters, components=tuple(each),
                           weight=frozen_array(np.full(len(each), 1 / len(each))))
        theta = proposal.draw(n_draw, rng)
        u = coordinates.transform(theta)
        log_weight = parameters.log_density(theta) + likelihoods.evaluate(u) - proposal.log_density(theta)
        smooth, k = smoothed_weights(log_weight)
        peak = log_weight.max()
        evidence = float(peak + np.log(np.mean(np.exp(log_weight - peak))))
        found = _WeightedDraws(theta, np.exp(smooth), evidence, k)
        tried.append(found)
        if k < GOOD_K:
            break
        middle = found.weight @ u
        covariance = (u - middle).T @ (found.weight[:, None] * (u - middle))
        fitted = TruncatedGaussian(
            centre=middle, gradient=np.zeros(len(parameters)), lower=proposals[0].lower, upper=proposals[0].upper,
            precision=np.linalg.inv(covariance * 1.2 + 1e-12 * np.diag(coordinates.scale**2)))
        proposals = [*proposals[: len(picked)], fitted]
    return min(tried, key=lambda one: one.pareto_k)


def _gaussian(likelihoods: SetLikelihoods, parameters: Parameters, coordinates: Coordinates):
    """The Gaussian at the maximum of all these sets' posterior in u, found by Newton steps held within the bounds."""
    lower, upper = coordinates.transform(parameters.lower), coordinates.transform(parameters.upper)
    u = coordinates.transform(parameters.initial)
    step_limit = 2 * coordinates.scale
    for _ in range(60):
        gradient, precision = _slopes(likelihoods, parameters, coordinates, u)
        scaled = precision * np.outer(coordinates.scale, coordinates.scale)
        room_low = np.maximum((lower - u) / coordinates.scale, -step_limit / coordinates.scale)
        room_high = np.minimum((upper - u) / coordinates.scale, step_limit / coordinates.scale)
        root = np.linalg.cholesky(scaled).T
        right = np.linalg.solve(root.T, gradient * coordinates.scale)
        step = optimize.lsq_linear(root, right, bounds=(np.minimum(room_low, -1e-12), np.maximum(room_high, 1e-12)))
        u = np.clip(u + coordinates.scale * step.x, lower, upper)
        if np.max(np.abs(step.x)) < 1e-6:
            break
    gradient, precision = _slopes(likelihoods, parameters, coordinates, u)
    return TruncatedGaussian(centre=u, gradient=gradient, precision=precision, lower=lower, upper=upper)


def _slopes(likelihoods, parameters, coordinates, u):
    theta = coordinates.back(u)
    residual, slope = prior_residual(parameters, theta)
    slope = slope * coordinates.rate(theta)
    d = u - likelihoods.centre
    gradient = (likelihoods.gradient - np.einsum("jk,jkl->jl", d, likelihoods.precision)).sum(axis=0)
    return (gradient - slope.T @ residual + coordinates.logarithmic,
            likelihoods.precision.sum(axis=0) + slope.T @ slope)


def view_sets(
    model: Model,
    data: ModalData,
    *,
    weights: Weights | None = None,
    model_at: Callable[[ModalSet], Model] | None = None,
    common: Sequence[str] = (),
    correlated: bool = False,
    spread: float = SPREAD,
    seed: int = 1,
    progress: Progress = silent,
) -> SetViews:
    """All four views of the sets of `data`, with the model in each set's conditions where `model_at` gives it.

    common: parameters that are one number in all sets of the population, such as a mass in two states of temperature.
    correlated: the others vary together between sets (n (n - 1) / 2 numbers more, of which nine sets show little).
    spread: of tau's hyper-prior, in prior standard deviations. Raises InputError with fewer than two usable sets.
    """
    own = _spread_of_each(model.parameters, common, spread)
    data, outliers = without_outliers(data)
    reference = build_problem(model if model_at is None else model_at(data.set()), data, weights=weights)
    clusters = [group.measured for group in reference.matching.groups]
    failed: list[str] = []
    found = list(iterate_sets(model, data, weights=reference.weights, clusters=clusters, model_at=model_at,
                              start=start_of_sets(reference), failed=failed, progress=progress))
    if len(found) < 2:
        raise _too_few_sets_error(len(found), len(data.sets), failed)
    problems, maxima = [p for p, _ in found], [x for _, x in found]
    parameters, coordinates = model.parameters, coordinates_of(model.parameters)
    rng = np.random.default_rng([seed, 31])
    options = {"seed": seed, "correlated": correlated, "spread": own, "progress": progress}
    prior, tau = gaussian_prior(parameters, coordinates), own * coordinates.scale
    centres = np.array([_hold_inside_bounds(x.theta, parameters, coordinates) for x in maxima])
    shared = shared_error(problems, centres, coordinates)
    scales = learn_scales(shared, prior, tau)
    noise = shared.conditional_problems(shared.expected_common(scales.new, scales.shared, tau, prior), scales.new)
    first = sample_population(linearise(noise, centres, coordinates), parameters, coordinates, target_ess=FIRST_ESS,
                              r_hat_limit=FIRST_R_HAT, **options)
    # once more about where the population puts each set
    middle = linearise(noise, centres, coordinates).draw_own(first.mean[::20], first.factor[::20], rng).mean(axis=0)
    centres = np.array([_hold_inside_bounds(x, parameters, coordinates) for x in coordinates.back(middle)])
    shared = shared_error(problems, centres, coordinates)
    expected = shared.expected_common(scales.new, scales.shared, np.median(first.tau, axis=0), prior)
    likelihoods = linearise(noise := shared.conditional_problems(expected, scales.new), centres, coordinates)
    population = sample_population(likelihoods, parameters, coordinates, target_ess=LAST_ESS, **options)
    at_one = Common.from_error(_linearise_at_one(shared, scales, parameters, coordinates, prior), prior)
    sampled = (parameters, coordinates, prior, rng)
    alone = [joint_posterior(each, *sampled, n_draw=N_ALONE) for each in at_one.each_set_density(shared)]
    joint = joint_posterior(at_one.all_sets_density(), *sampled)
    lent = shared.optimism(expected, scales.new, scales.shared, np.median(population.tau, axis=0), prior)
    scores = _cross_validate(likelihoods, at_one, population, lent, alone, sampled, options)
    share = _effective_shares(noise, likelihoods, population, coordinates, parameters, rng)
    population = shared.widen(population, expected, scales.new, scales.shared, prior, rng)
    rows = _rows(parameters, coordinates, maxima, alone, joint, population, own, rng)
    rows += _derived_rows(model, maxima, alone, joint, population, coordinates, parameters, rng)
    modes = tuple(mode_scatter(data))
    notes = _notes(data, problems, parameters, scores, share, population, alone, joint, modes, failed, coordinates)
    return SetViews(
        ids=likelihoods.ids, rows=tuple(rows), modes=modes, scores=scores, converged=population.converged,
        verdict=population.verdict, linear_share=frozen_array(share), notes=(*outliers, *notes),
        correlation=_correlation(population) if correlated else None, advice=advice(rows, scores, share), settings={
            "weights": reference.weights.description, "seed": str(seed), "correlated": str(correlated).lower(),
            "hyper-prior of tau": f"half-normal, scale {spread:g} prior standard deviations", "model": model.name,
        } | ({"one number in all sets": ", ".join(common)} if common else {}),
    )


def _linearise_at_one(
    error: SharedError, scales: LearntScales, parameters: Parameters, coordinates: Coordinates, prior: GaussianPrior
) -> SharedError:
    """Linear about one place, for one value in all sets. Slopes at the sets' own places differ as these do: far from
    all of them the one would make up for the other."""
    place = coordinates.back(error.middle)
    for _ in range(2):
        place = _hold_inside_bounds(place, parameters, coordinates)
        error = shared_error(error.problems, np.tile(place, (len(error.problems), 1)), coordinates)
        density = error.likelihoods(error.sum_sets(scales.new), scales.shared)
        likeliest = density.node(int(np.argmax(density.shares(prior))))
        place = coordinates.back(_gaussian(likeliest, parameters, coordinates).centre)
    return error


def _spread_of_each(parameters: Parameters, common: Sequence[str], spread: float) -> np.ndarray:
    """Of the hyper-prior of each parameter's scatter (n_param,): zero where it is one number in all sets."""
    if not (np.isfinite(spread) and spread > 0):
        raise InputError("spread", f"{spread} is not above zero",
                         "give the scale of tau in prior standard deviations, as 0.25")
    for name in common:
        parameters.index(name)
    if len(set(common)) == len(parameters):
        raise InputError("common", "leaves no parameter that varies between sets",
                         "take view (c), one posterior for all sets, which needs no common parameters")
    return np.where(np.isin(parameters.names, common), 0.0, spread)


def _too_few_sets_error(n_found: int, n_set: int, failed: Sequence[str]) -> InputError:
    why = f" ({'; '.join(failed)})" if failed else ""
    return InputError("sets",
                      f"{n_found} of {n_set} can be updated{why}, and views of several sets compare at least two",
                      "give two sets or more")


def _correlation(population: Population) -> np.ndarray:
    """Between parameters over sets (n_param, n_param): the median of the draws of the population."""
    # of one number in all sets there is none
    tau = np.where(population.tau > 0, population.tau, np.inf)
    each = population.factor @ np.swapaxes(population.factor, 1, 2) / (tau[:, :, None] * tau[:, None, :])
    return frozen_array(np.median(each, axis=0))


def _hold_inside_bounds(theta, parameters: Parameters, coordinates: Coordinates) -> np.ndarray:
    """Held within the bounds, and off zero where a logarithm is taken."""
    low = np.where(coordinates.logarithmic, np.maximum(parameters.lower, 1e-3 * parameters.std), parameters.lower)
    return np.clip(theta, low, parameters.upper)


@dataclass(frozen=True, eq=False)
class Common:
    """Likelihoods of some or all sets at one common u: `scales` of all of them, `each` set's inner products at what
    stands for the new part."""

    error: SharedError
    scales: LearntScales
    each: list[Inner]

    @classmethod
    def from_error(cls, error: SharedError, prior: GaussianPrior) -> Common:
        scales = learn_scales(error, prior)
        return cls(error, scales, error.each(scales.new))

    def each_set_density(self, error: SharedError) -> list[AveragedDensity]:
        """Of every set by itself, about its place in `error`."""
        each = replace(self, error=error, each=error.each(self.scales.new))
        return [each.of_sets([j]) for j in range(len(self.each))]

    def of_sets(self, keep: Sequence[int]) -> AveragedDensity:
        """At one scale of what is new, that all sets together have shown."""
        return self.error.likelihoods(total([self.each[k] for k in keep]), self.scales.shared)

    def all_sets_density(self) -> AveragedDensity:
        """Averaged over the scales of what is new too."""
        by_new: dict[tuple[float, float], list] = {}
        for scales in self.scales.nodes:
            by_new.setdefault(scales.new, []).append(scales)
        return join_densities([self.error.likelihoods(self.error.sum_sets(new), rows) for new, rows in by_new.items()])


def gaussian_prior(parameters: Parameters, coordinates: Coordinates) -> GaussianPrior:
    """Mean and precision in u of the prior within its bounds."""
    drawn = coordinates.transform(parameters.draw(np.random.default_rng(0), N_PRIOR))
    return drawn.mean(axis=0), np.linalg.inv(np.atleast_2d(np.cov(drawn.T)))


def _cross_validate(likelihoods, common: Common, population: Population, lent, alone, sampled, options) -> LeaveOneOut:
    n, (parameters, coordinates, _, _) = len(likelihoods.ids), sampled
    one, many = np.empty(n), np.empty(n)
    k, refitted = np.empty(n), np.zeros(n, bool)
    whole = joint_posterior(common.of_sets(range(n)), *sampled).log_evidence
    for j in range(n):
        rest = likelihoods.leave_out(j)
        others = common.of_sets([k for k in range(n) if k != j])
        one[j] = whole - joint_posterior(others, *sampled, n_draw=N_ALONE).log_evidence
        many[j], k[j] = population_left_out(population, j)
        if k[j] > TRUSTED_K and n > 2:
            again = sample_population(rest, parameters, coordinates, target_ess=FIRST_ESS, **options)
            many[j], refitted[j] = population_score(again, likelihoods, j), True
    # the others count shapes by what their alignment leaves
    taken = [p.noise_alone(common.scales.new).taken_by_alignment - p.taken_by_alignment
             for p in common.error.problems]
    score = {POOLED: [x.log_evidence for x in alone], ONE: one, MANY: many - lent + np.array(taken)}
    return LeaveOneOut(ids=likelihoods.ids, score={name: frozen_array(v) for name, v in score.items()},
                   pareto_k=frozen_array(k), refitted=frozen_array(refitted, bool))


def _effective_shares(problems, likelihoods, population, coordinates, parameters, rng) -> np.ndarray:
    """Effective share of draws of each set's own parameters when the full model's likelihood weighs them (n_set,)."""
    pick = np.linspace(0, len(population.mean) - 1, N_CHECK).astype(int)
    own = likelihoods.draw_own(population.mean[pick], population.factor[pick], rng)
    quick, shares = likelihoods.own(own), []
    for j, problem in enumerate(problems):
        theta = coordinates.back(own[:, j])
        inside = parameters.inside(theta)
        weight = np.zeros(len(theta))
        if inside.any():
            off = problem.log_likelihood(theta[inside]) - quick[inside, j]
            weight[inside] = np.exp(off - off.max())
        shares.append(weight.sum() ** 2 / np.sum(weight**2) / len(weight) if weight.any() else 0.0)
    return np.array(shares)


def _cov(values: np.ndarray, weight: np.ndarray | None = None) -> tuple[float, float]:
    mean = float(np.average(values, weights=weight))
    std = float(np.sqrt(np.average((values - mean) ** 2, weights=weight)))
    return mean, std / abs(mean) if mean else float("nan")


def _rows(parameters, coordinates, maxima: list[Laplace], alone, joint, population: Population, spread, rng):
    theta_map = np.array([x.theta for x in maxima])
    new = np.clip(coordinates.back(population.draw_new(rng)), parameters.lower, parameters.upper)
    middle = coordinates.back(population.mean)
    rows = []
    for k, p in enumerate(parameters):
        within = float(np.mean([x.variance()[k] for x in alone]))
        means = np.array([x.mean()[k] for x in alone])
        # of a change about zero a CoV would be over a mean of next to nothing
        tau = population.tau[:, k]
        hyper = spread[k] * coordinates.scale[k]
        mid = low = high = bits = np.nan
        if hyper > 0:
            # of the hyper-prior's distribution function; tau of the chain is autocorrelated, by its worst number
            bits = bits_gained(2 * special.ndtr(tau / hyper) - 1, population.ess)
            (low, high), mid = scatter_interval(tau), np.median(tau)
        scatter = float(theta_map[:, k].mean())

        def cov(mean: Any, variance: Any, p=p) -> float:
            return cov_of(float(mean), float(np.sqrt(variance)), p)

        prior_mean, prior_std = (float(x[k]) for x in parameters.moments)
        row: dict[str, Any] = dict(
            name=p.name, unit=p.unit, prior_cov=cov_of(prior_mean, prior_std, p),
            scatter_mean=scatter, scatter_cov=cov(scatter, np.var(theta_map[:, k], ddof=1)),
            resolution=float(np.mean([x.resolution[k] for x in maxima])), pooled_mean=float(means.mean()),
            pooled_cov=cov(means.mean(), within + np.var(means, ddof=1)),
            joint_mean=float(joint.mean()[k]),
            joint_cov=cov(joint.mean()[k], joint.variance()[k]), mean=float(middle[:, k].mean()),
            mean_cov=cov(middle[:, k].mean(), middle[:, k].var()), tau=float(mid), tau_low=float(low),
            tau_high=float(high), tau_prior=float(stats.norm.ppf(0.75) * hyper) if hyper > 0 else np.nan,
            tau_bits=float(bits),
            population_cov=cov(new[:, k].mean(), new[:, k].var()), tau_relative=bool(coordinates.logarithmic[k]),
        )
        rows.append(SetsRow(sentence=parameter_sentence(row), **row))
    return rows


def _ratio(std: float, mean: float) -> float:
    return std / abs(mean) if mean else float("nan")


def _derived_rows(model, maxima, alone, joint, population, coordinates, parameters, rng):
    derived = getattr(model, "derived", {})
    if not derived:
        return []
    n = N_DERIVED
    per_set = max(2, n // len(alone))
    pick = rng.choice(len(population.mean), size=n)
    new = np.clip(coordinates.back(population.draw_new(rng)), parameters.lower, parameters.upper)[pick]
    middle, shared = coordinates.back(population.mean)[pick], joint.resample(n, rng)
    own = [x.resample(per_set, rng) for x in alone]
    nan, rows = float("nan"), []
    for name, compute in derived.items():
        tops = np.array([compute(x.theta) for x in maxima])
        each = np.array([[compute(t) for t in theta] for theta in own])
        pooled = np.sqrt(each.var(axis=1).mean() + each.mean(axis=1).var(ddof=1))
        one, centre, fresh = (np.array([compute(t) for t in theta]) for theta in (shared, middle, new))
        rows.append(SetsRow(
            name=name, unit="N/m", prior_cov=nan, scatter_mean=float(tops.mean()),
            scatter_cov=_ratio(float(tops.std(ddof=1)), float(tops.mean())), resolution=nan,
            pooled_mean=float(each.mean()), pooled_cov=_ratio(float(pooled), float(each.mean())),
            joint_mean=_cov(one)[0], joint_cov=_cov(one)[1], mean=_cov(centre)[0], mean_cov=_cov(centre)[1], tau=nan,
            tau_low=nan, tau_high=nan, tau_prior=nan, tau_bits=nan, population_cov=_cov(fresh)[1],
            sentence=f"{name} follows from the parameters, {n} draws a view",
        ))
    return rows


def mode_scatter(data: ModalData) -> list[ModeScatter]:
    """Scatter of each frequency over the sets against what identification states of each set (Cochran's Q, its interval
    of the variation by Viechtbauer 2007); nothing where no set states it."""
    found = []
    labels = data.labels or tuple(f"mode {j + 1}" for j in range(data.n_mode))
    for j, label in enumerate(labels):
        ln, std = [], []
        for s in data.sets:
            if s.covariance_factors is not None and np.isfinite(s.frequency_hz[j]):
                stated = float(np.sqrt(np.sum(s.covariance_factors.ln_frequency[j] ** 2)))
                if stated > 0:
                    ln.append(np.log(s.frequency_hz[j]))
                    std.append(stated)
        if len(ln) < 3:
            continue
        ln, variance, free = np.array(ln), np.array(std) ** 2, len(ln) - 1

        def excess(tau2: float, ln=ln, variance=variance) -> float:
            weight = 1 / (variance + tau2)
            return float(np.sum(weight * (ln - np.sum(weight * ln) / weight.sum()) ** 2))

        def find_tau(quantile: float, excess=excess, ln=ln) -> float:
            """tau whose Q is that quantile, 0 where even none is too much."""
            if excess(0.0) <= quantile:
                return 0.0
            top = np.var(ln)
            while excess(top) > quantile:
                top *= 4
            return float(np.sqrt(optimize.brentq(lambda t: excess(t) - quantile, 0.0, top)))

        low, high = find_tau(float(stats.chi2.ppf(0.95, free))), find_tau(float(stats.chi2.ppf(0.05, free)))
        found.append(ModeScatter(
            label=label, n_set=len(ln), scatter=float(np.std(ln, ddof=1)), stated=float(np.sqrt(variance.mean())),
            variation=find_tau(float(free)), low=low, high=high, p_value=float(stats.chi2.sf(excess(0.0), free))))
    return found


def _notes(
    data, problems: list[Problem], parameters, scores, share, population, alone, joint, modes, failed, coordinates
) -> list[str]:
    notes = [] if population.converged else [f"population: {population.verdict}"]
    notes += [f"no update: {text}" for text in failed]
    if np.min(share) < LINEAR_SHARE:
        worst = int(np.argmin(share))
        notes.append("linearised about where the population puts them, sets do not stand for the full model: effective "
                     f"share {share[worst]:.2f} of draws in set {scores.ids[worst]}; take (b) to (d) as rough")
    untrusted = [x.pareto_k for x in (*alone, joint) if x.pareto_k > TRUSTED_K]
    if untrusted:
        notes.append(f"{len(untrusted)} of the posteriors behind (b) and (c) have Pareto k up to {max(untrusted):.2f}: "
                     "their standard deviations are rough")
    at_bound = coordinates.back(population.mean)
    width = np.minimum(parameters.std, parameters.upper - parameters.lower)
    near = np.mean((at_bound - parameters.lower < 0.02 * width) | (parameters.upper - at_bound < 0.02 * width), axis=0)
    names = [p.name for p, x in zip(parameters, near, strict=True) if x > 0.2]
    if names:
        notes.append(f"the population's middle lies at a bound: {', '.join(names)}; its tau depends on that bound")
    counted = _scatter_ratio(data, problems)
    if counted > 1.5:
        notes.append(f"the weights' frequency standard deviations are {counted:.1f} times what identification states: "
                     "scatter between sets is counted as noise there, and tau is only what exceeds it; for tau use the "
                     "weights covariance")
    if modes:
        varying = [m.label for m in modes if m.p_value < 0.05]
        notes.append("frequencies that scatter over the sets more than identification states (p < 0.05): "
                     + (", ".join(varying) if varying else "none"))
    else:
        notes.append("the sets state no covariances of identification's own (an HDF5 file beside modes.json): noise "
                     "and variation of frequencies are not separated here")
    notes.append("sets that were selected for their agreement scatter less than the campaign: tau is theirs")
    return notes


def _scatter_ratio(data: ModalData, problems: list[Problem]) -> float:
    """Median of the weights' standard deviation of ln f over identification's own; NaN where that is not stated."""
    ratios = []
    for problem in problems:
        modal_set = data.set(problem.set_id)
        if modal_set.covariance_factors is None:
            continue
        own = np.sqrt(np.sum(modal_set.covariance_factors.ln_frequency**2, axis=1))[list(problem.used)]
        used = problem.frequency_std_hz / np.concatenate([g.frequency_hz for g in problem.groups])
        ratios += (used / own).tolist()
    return float(np.nanmedian(ratios)) if ratios else float("nan")
