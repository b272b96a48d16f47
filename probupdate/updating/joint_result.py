"""From the joint estimate and posterior of a farm to rows and sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import stats

from probupdate.runtime.executors import Executor
from probupdate.runtime.progress import Progress, silent
from probupdate.updating.joint_draws import weighted_quantile
from probupdate.updating.joint_file import (
    TRUSTED_K,
    FarmJoint,
    MonthValue,
    NextRow,
    PopulationRow,
    TurbineRow,
)
from probupdate.updating.joint_inference import (
    DEFAULT,
    JointEstimate,
    JointPosterior,
    JointSettings,
    TurbineSets,
    estimate_farm,
    sample_farm,
)
from probupdate.updating.joint_next import next_measurements
from probupdate.updating.joint_odd import odd_sentences
from probupdate.updating.joint_system import OWN, VARYING

# share of draws that are effective from which weights hardly differ, and the shape of their tail says nothing; share of
# draws without a solution beyond which parts of the posterior may be missing
ALIKE, MOST_LOST = 0.9, 0.05
# a month's value has changed by so many standard deviations of both months
UNLIKE = 3.0
INTERVAL = (0.05, 0.5, 0.95)


def infer_farm(
    turbines: Sequence[TurbineSets], *, common: Sequence[str], varying: Sequence[str],
    earlier: Sequence[TurbineSets] = (), settings: JointSettings = DEFAULT, jobs: int | Executor = 1,
    progress: Progress = silent,
) -> FarmJoint:
    """Both estimators for turbines of one design (at least two), each by its last month; `earlier` months of the same
    turbines are worked out by themselves, given what the turbines share. Raises InputError where their parameters
    differ, or `common` and `varying` name none of them."""
    estimate = estimate_farm(turbines, common=common, varying=varying, settings=settings, progress=progress)
    posterior = sample_farm(estimate, seed=settings.seed, jobs=jobs, progress=progress)
    names = tuple(t.name for t in turbines)
    corrected = posterior.lost <= MOST_LOST and (
        posterior.pareto_k <= TRUSTED_K or posterior.effective >= ALIKE * len(posterior.weight))
    weight = posterior.weight if corrected else posterior.equal_weights
    k = posterior.pareto_k
    return FarmJoint(
        turbines=names, odd_probability=tuple(float(p) for p in estimate.odd.probability),
        population=tuple(_population(estimate, posterior, weight, settings)),
        rows=tuple(_turbine_rows(estimate, posterior, weight, names)),
        months=tuple(_months(estimate, turbines, earlier)),
        next=tuple(NextRow(**vars(row)) for row in next_measurements(estimate, names)),
        settled=estimate.settled, converged=posterior.chain.converged, corrected=bool(corrected), pareto_k=float(k),
        effective=posterior.effective, draws=len(weight), verdict=_verdict(estimate, posterior, bool(corrected)),
        notes=tuple(_notes(estimate, names, bool(corrected))),
        settings={
            "common": ", ".join(common), "varying": ", ".join(varying), "own": ", ".join(estimate.roles.own),
            "weights": estimate.error.problems[0].weights.description, "sets": str(len(estimate.error.problems)),
            "hyper-prior of tau": f"half-normal, scale {settings.spread:g} prior standard deviations",
            "odd turbines": f"a share of {settings.odd_share:g} a priori, off by {settings.odd_wide:g} prior standard "
                            "deviations in one parameter", "seed": str(settings.seed)})


def _verdict(estimate: JointEstimate, posterior: JointPosterior, corrected: bool) -> str:
    ended = f"converged after {estimate.rounds} linearisations" if estimate.settled else \
        f"did NOT converge in {estimate.rounds} linearisations"
    k = posterior.pareto_k
    if not np.isfinite(k):
        weighed = "no draw has a density under the true models" if k > 0 else "the linear posterior is exact"
    else:
        n = len(posterior.weight)
        weighed = f"of {n} draws moved to the true models {posterior.effective:.0f} are effective, Pareto k {k:.2f}"
    weighed += f", {100 * posterior.lost:.2g} % without a solution" if posterior.lost > 0 else ""
    failed = "" if corrected else ": THEY DO NOT REPRESENT THE POSTERIOR, intervals are those of the unweighted draws"
    return f"stacked estimate {ended}; scatter {posterior.chain.verdict}; {weighed}{failed}"


def _notes(estimate: JointEstimate, names: Sequence[str], corrected: bool) -> list[str]:
    shared = estimate.roles.shared

    def words(i: int, k: int) -> str:
        number = estimate.parameters.index(shared[k])
        one, others = estimate.scores.some([number]), estimate.z[k : k + 1]
        before, after = float(one.back(others)[0]), float(one.back(others + estimate.odd.shift[i, k])[0])
        if _is_relative(estimate, number):
            return f"{100 * (after / before - 1):+.2g} %"
        return f"{after - before:+.3g} {estimate.parameters.items[number].unit}"

    notes = odd_sentences(estimate.odd, names, shared, words)
    for k in np.flatnonzero(np.any(estimate.at_bound, axis=0)):
        p, where = estimate.parameters.items[k], ", ".join(names[i] for i in np.flatnonzero(estimate.at_bound[:, k]))
        notes.append(f"{p.name} is estimated at a bound of its prior ({p.lower:g} to {p.upper:g} {p.unit}) at {where}: "
                     "the bound sets its value there, not the data")
    if not corrected:
        notes.append("widen the bounds or the model, hold parameters that the data hardly identify, or update turbines "
                     "one by one: this farm's responses are too nonlinear over their posterior's width, or have "
                     "several solutions")
    return notes


def _population(estimate: JointEstimate, posterior: JointPosterior, weight, settings: JointSettings):
    roles, parameters = estimate.roles, estimate.parameters
    draws, rng = posterior.draws, np.random.default_rng([settings.seed, 41])
    inherited = parameters.draw(rng, len(weight))
    place = {name: k for k, name in enumerate(roles.shared)}
    joint = estimate.system.conditional(estimate.tau, estimate.common_std)
    z_std = np.sqrt(np.diag(joint.solve(np.eye(len(joint.mean))[:, : len(place)])[: len(place)]))
    means, stds = parameters.moments
    for number, p in enumerate(parameters):
        name, role, nan = p.name, roles.role(p.name), float("nan")
        one, relative = estimate.scores.some([number]), _is_relative(estimate, number)
        row = dict.fromkeys(("tikhonov", "tikhonov_std", "mean", "std", "low", "high", "tau", "tau_low", "tau_high",
                             "tau_prior"), nan)
        if role != OWN:
            z = draws.z[:, [place[name]]]
            value, at = one.back(z), one.back(estimate.z[[place[name]]])
            row |= dict(tikhonov=float(at[0]), tikhonov_std=float(z_std[place[name]] * one.rate(at)[0]),
                        **_moments(value[:, 0], weight))
            new = z
            if role == VARYING:
                tau = draws.tau[:, [roles.varying.index(name)]]
                # scatter of scores as that of the parameter about the mean
                per_score = one.rate(value) / (value if relative else 1.0)
                low, middle, high = weighted_quantile((tau * per_score)[:, 0], weight, INTERVAL)
                spread = estimate.scales.spread[roles.varying.index(name)]
                row |= dict(tau=float(middle), tau_low=float(low), tau_high=float(high),
                            tau_prior=float(stats.norm.ppf(0.75) * spread * (weight @ per_score[:, 0])))
                new = z + tau * rng.standard_normal(tau.shape)
            inherited[:, number] = one.back(new)[:, 0]
        of_new = _moments(inherited[:, number], weight)
        yield PopulationRow(
            parameter=name, unit=p.unit, role=role, prior_mean=float(means[number]), prior_std=float(stds[number]),
            tau_relative=relative,
            **row, **{f"inherited_{key}": value for key, value in of_new.items()})


def _is_relative(estimate: JointEstimate, number: int) -> bool:
    """Whether differences of a parameter are given as shares of it: what bounds or prior keep positive."""
    p = estimate.parameters.items[number]
    return bool(p.initial > 0 and (p.lower >= 0 or p.prior == "lognormal"))


def _moments(values: np.ndarray, weight: np.ndarray) -> dict[str, float]:
    mean = float(weight @ values)
    low, _, high = weighted_quantile(values, weight, INTERVAL)
    return dict(mean=mean, std=float(np.sqrt(weight @ (values - mean) ** 2)), low=float(low), high=float(high))


def _turbine_rows(estimate: JointEstimate, posterior: JointPosterior, weight, names: Sequence[str]):
    roles, scores, parameters, tau = estimate.roles, estimate.scores, estimate.parameters, estimate.tau
    system, odd = estimate.system, estimate.odd
    _, covariance, *_ = system.of_turbines(tau, system.conditional(tau, estimate.common_std))
    shared, value, at_bound = list(roles.shared), estimate.theta, estimate.at_bound
    theta, rate = scores.back(posterior.draws.u), scores.rate(value)
    for i, turbine in enumerate(names):
        alone = system.select([i])
        own = alone.of_turbines(tau, alone.conditional(tau, estimate.common_std))[1][0]
        for k, p in enumerate(parameters):
            role = roles.role(p.name)
            probability, limit = float("nan"), float("nan")
            if role != OWN:
                at = shared.index(p.name)
                probability = float(odd.share[i, at])
                if np.isfinite(odd.limit[i, at]):
                    shifted = scores.some([k]).back(estimate.u[i, [k]] + odd.limit[i, at])
                    limit = float(shifted[0] - value[i, k])
            yield TurbineRow(
                turbine=turbine, parameter=p.name, unit=p.unit, role=role, tikhonov=float(value[i, k]),
                tikhonov_std=float(np.sqrt(covariance[i, k, k]) * rate[i, k]), **_moments(theta[:, i, k], weight),
                alone_std=float(np.sqrt(own[k, k]) * rate[i, k]), odd=probability, limit=limit,
                at_bound=bool(at_bound[i, k]))


def _months(estimate: JointEstimate, turbines: Sequence[TurbineSets], earlier: Sequence[TurbineSets]):
    """Of turbines with earlier months, in the order of time."""
    names = [t.name for t in turbines]
    months = [m for t in turbines if any(e.name == t.name for e in earlier)
              for m in (*(e for e in earlier if e.name == t.name), t)]
    if not months:
        return
    u, std = estimate.of_months(months, [names.index(m.name) for m in months])
    theta = estimate.scores.back(u)
    rate = estimate.scores.rate(theta)
    for j, month in enumerate(months):
        follows = j > 0 and months[j - 1].name == month.name
        for k, p in enumerate(estimate.parameters):
            if estimate.roles.role(p.name) not in (OWN, VARYING):
                continue
            yield MonthValue(
                turbine=month.name, month=month.month, parameter=p.name, unit=p.unit, value=float(theta[j, k]),
                std=float(std[j, k] * rate[j, k]),
                changed=bool(follows and abs(u[j, k] - u[j - 1, k]) > UNLIKE * np.hypot(std[j, k], std[j - 1, k])))
