"""Importance sampling of the posterior: fast draws and the evidence where a proposal fits, and a check of the chain.

The proposal is a mixture: a truncated Gaussian approximation for every maximum that was found, Student t distributions
fitted to weighted draws in rounds (population Monte Carlo: Cappe, Guillin, Marin & Robert 2004), and a share of the
prior, which bounds the weights and shows a mode that was missed (defensive mixture: Hesterberg 1995). Where few draws
count, the first fit is to maxima of randomised posteriors (`randomised`), and weights are taken to a power at which
enough draws count: a fit to what few draws found about the maximum would keep to that part. It is frozen before the
draws that count: estimates from the draws it was fitted to would be biased.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import linalg, special

from probupdate.model.parameters import Parameters
from probupdate.runtime.arrays import frozen_array
from probupdate.runtime.progress import Progress, silent
from probupdate.updating.evidence import TRUSTED_K, log_prior_constant, pareto_shape
from probupdate.updating.problem import Problem
from probupdate.updating.randomised import randomised_maxima
from probupdate.updating.settings import CONSTANTS
from probupdate.updating.surrogate import Density, Proposal
from probupdate.updating.transport import Transport, fit_transport

GOOD_K = CONSTANTS.good_k
# draws that count, and those of one round of fitting; rounds at most, and the fewest whose proposals serve, as one
# round's draws may miss an arm of the posterior, and the effective share from which they do
N_DRAW, N_ROUND, ROUNDS, FEWEST, ENOUGH = 4000, 2000, 40, 4, 0.4
# rounds whose draws are kept, and those without a higher power or a larger share of draws that count before they end
KEPT, PATIENCE = 5, 4
# share of draws from the prior, and the least of any other component
PRIOR_SHARE, LEAST_PART = 0.05, 0.02
# Student t distributions: degrees of freedom (tails heavier than any posterior's of a few stiffnesses), how much wider
# than the weighted draws, and how many a maximum
DEGREES, SPREAD, PER_MAXIMUM = 5.0, 1.2, 4
EM_STEPS = 15
MOST_Z, LEAST_APART = CONSTANTS.most_z, CONSTANTS.least_apart
# the power of the weights is the largest at which so many draws count for each coefficient of a map, and no fewer, by
# steps of a factor down to the least
PER_COEFFICIENT, LEAST_COUNT, POWER_STEP, LEAST_POWER = 6, 400, 0.8, 1e-3
# of the randomised maxima, how many are kept to look whether the proposal reaches them; posterior over proposal, over
# its mean, from which it does not: one draw there would outweigh all others, and none shows it; how many of these are
# no chance
N_PROBE, UNREACHED, FEW = 40, float(N_DRAW), 2
# variance of the thinnest direction, over that of the draws
THINNEST = 1e-10
CHUNK = 500


@dataclass(frozen=True, eq=False)
class PriorDensity:
    """The prior's own marginals, without their correlation."""

    parameters: Parameters

    def draw(self, n: int, random) -> np.ndarray:
        uniform = random.uniform(size=(n, len(self.parameters)))
        drawn = np.column_stack([p.distribution.ppf(uniform[:, k]) for k, p in enumerate(self.parameters)])
        return np.clip(drawn, self.parameters.lower, self.parameters.upper)

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        value = np.full(len(theta), -np.inf)
        inside = self.parameters.inside(theta)
        value[inside] = self.parameters.log_marginals(theta[inside])
        return value


@dataclass(frozen=True, eq=False, kw_only=True)
class StudentT:
    """A multivariate Student t of DEGREES in u = ln(theta) where `logarithmic` (n_param,), else theta. Draws may lie
    outside the parameters' bounds, where the posterior is zero."""

    centre: np.ndarray
    factor: np.ndarray
    logarithmic: np.ndarray

    def draw(self, n: int, random) -> np.ndarray:
        # inverse distribution functions, so that any generator of uniform numbers serves
        size = len(self.centre)
        z = special.ndtri(random.uniform(size=(n, size)))
        chi = 2 * special.gammaincinv(0.5 * DEGREES, random.uniform(size=n))
        u = self.centre + (z / np.sqrt(chi / DEGREES)[:, None]) @ self.factor.T
        with np.errstate(over="ignore"):
            return np.where(self.logarithmic, np.exp(np.where(self.logarithmic, u, 0.0)), u)

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        known = np.all(np.where(self.logarithmic, theta > 0, True), axis=1)
        value = np.full(len(theta), -np.inf)
        u = coordinates(theta[known], self.logarithmic)
        value[known] = self.of_coordinates(u) - np.sum(np.where(self.logarithmic, u, 0.0), axis=1)
        return value

    def of_coordinates(self, u: np.ndarray) -> np.ndarray:
        """Per du, (n,) of u (n, n_param)."""
        n = len(self.centre)
        z = linalg.solve_triangular(self.factor, (u - self.centre).T, lower=True)
        constant = special.gammaln(0.5 * (DEGREES + n)) - special.gammaln(0.5 * DEGREES)
        constant -= 0.5 * n * np.log(DEGREES * np.pi) + np.sum(np.log(np.diag(self.factor)))
        return constant - 0.5 * (DEGREES + n) * np.log1p(np.sum(z**2, axis=0) / DEGREES)


def coordinates(theta: np.ndarray, logarithmic: np.ndarray) -> np.ndarray:
    """u (n, n_param)."""
    return np.where(logarithmic, np.log(np.where(logarithmic, theta, 1.0)), theta)


@dataclass(frozen=True, eq=False, kw_only=True)
class Mixture:
    """Components with their weights (n,); draws may lie outside the bounds of the parameters. probes (n, n_param):
    points that it ought to reach."""

    parameters: Parameters
    components: tuple[Density, ...]
    weight: np.ndarray
    probes: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))

    def draw(self, n: int, random) -> np.ndarray:
        chosen = np.searchsorted(np.cumsum(self.weight)[:-1], random.uniform(size=n), side="right")
        found = np.empty((n, len(self.parameters)))
        for k, component in enumerate(self.components):
            rows = np.flatnonzero(chosen == k)
            if rows.size:
                found[rows] = component.draw(len(rows), random)
        return found

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        """(n,) of theta (n, n_param), inside the bounds; -inf outside, where nobody asks for it."""
        value = np.full(len(theta), -np.inf)
        inside = self.parameters.inside(theta)
        if inside.any():
            parts = [np.log(w) + c.log_density(theta[inside])
                     for w, c in zip(self.weight, self.components, strict=True)]
            value[inside] = np.logaddexp.reduce(parts)
        return value

    def draw_inside(self, n: int, random) -> np.ndarray:
        """n draws (n, n_param) within the bounds."""
        found = np.empty((0, len(self.parameters)))
        while len(found) < n:
            fresh = self.draw(2 * n, random)
            found = np.vstack([found, fresh[self.parameters.inside(fresh)]])
        return found[:n]


@dataclass(frozen=True, eq=False, kw_only=True)
class WeightedDraws:
    """theta (n, n_param) with normalised weights (n,), their effective number and Pareto k; log_evidence with its
    standard deviation; evaluated: how many points were solved in all; unreached: of the proposal's probes, how many it
    would hardly ever draw, which no weight shows."""

    names: tuple[str, ...]
    theta: np.ndarray
    weight: np.ndarray
    effective: float
    pareto_k: float
    log_evidence: float
    log_evidence_std: float
    evaluated: int
    without_modes: int
    unreached: int = 0

    @property
    def mean(self) -> np.ndarray:
        return self.weight @ self.theta

    @property
    def std(self) -> np.ndarray:
        return np.sqrt(self.weight @ (self.theta - self.mean) ** 2)

    @property
    def std_error(self) -> np.ndarray:
        """Standard error (n_param,) of the standard deviations, by the weights."""
        squares = (self.theta - self.mean) ** 2
        return np.sqrt(self.weight**2 @ (squares - self.std**2) ** 2) / (2 * self.std)

    @property
    def mean_error(self) -> np.ndarray:
        """Standard error (n_param,) of the means, by the weights."""
        return np.sqrt(self.weight**2 @ (self.theta - self.mean) ** 2)

    def quantile(self, share: Sequence[float]) -> np.ndarray:
        """(n_share, n_param)."""
        found = np.empty((len(share), self.theta.shape[1]))
        for k in range(self.theta.shape[1]):
            order = np.argsort(self.theta[:, k])
            below = np.cumsum(self.weight[order]) - 0.5 * self.weight[order]
            found[:, k] = np.interp(share, below, self.theta[order, k])
        return found

    @property
    def log_weight(self) -> np.ndarray:
        """ln of posterior over proposal (n,), -inf where the posterior is zero; their mean is the evidence."""
        with np.errstate(divide="ignore"):
            return np.log(self.weight * len(self.weight)) + self.log_evidence

    @property
    def good(self) -> bool:
        """Whether these draws stand for the posterior by themselves."""
        return self.pareto_k < GOOD_K and self.unreached < FEW


def log_posterior(problem: Problem, theta: np.ndarray, what: str, progress: Progress) -> np.ndarray:
    """(n,), -inf outside the bounds."""
    value = np.full(len(theta), -np.inf)
    inside = np.flatnonzero(problem.inside(theta))
    for start in range(0, inside.size, CHUNK):
        progress(what, start, inside.size)
        rows = inside[start : start + CHUNK]
        value[rows] = problem.log_posterior(theta[rows])[0]
    progress(what, inside.size, inside.size)
    return value


@dataclass(frozen=True, eq=False, kw_only=True)
class _Round:
    """A proposal with its draws inside the bounds (n, n_param) of `number`, and ln of the posterior there (n,)."""

    proposal: Density
    number: int
    theta: np.ndarray
    value: np.ndarray
    known: dict[int, np.ndarray] = field(default_factory=dict)

    def density_at(self, other: _Round) -> np.ndarray:
        """ln of the proposal's density at another round's draws, computed once."""
        if id(other) not in self.known:
            self.known[id(other)] = self.proposal.log_density(other.theta)
        return self.known[id(other)]


def _round(problem: Problem, proposal: Density, number: int, rng: np.random.Generator, progress: Progress) -> _Round:
    theta = proposal.draw(number, rng)
    value = log_posterior(problem, theta, "proposal", progress)
    known = np.isfinite(value)
    return _Round(proposal=proposal, number=number, theta=theta[known], value=value[known])


def fitted_proposal(
    problem: Problem, approximations: Sequence[Proposal], rng: np.random.Generator, progress: Progress = silent, *,
    everywhere: Problem | None = None,
) -> tuple[Mixture, int]:
    """A frozen mixture for this posterior, and how many points were solved for it; `everywhere`: the same problem on a
    model that answers as fast far from the posterior, if less exactly.

    The Gaussian approximations as they are where their draws serve; else rounds of Student t distributions and maps,
    fitted first to maxima of randomised posteriors and then to the weighted draws of the last rounds, each weighed by
    the mixture of all that proposed them, at the power of these weights at which enough draws count.
    """
    parameters = problem.parameters
    n, prior, logarithmic = len(parameters), PriorDensity(parameters), parameters.lower >= 0
    wanted = max(LEAST_COUNT, PER_COEFFICIENT * (n + 1) * (n + 2) // 2)
    rounds = [_round(problem, _weigh_components(parameters, [*approximations], prior), N_ROUND, rng, progress)]
    best, best_share, since, served, solved = rounds[0].proposal, 0.0, 0, 0, N_ROUND
    points, power = np.empty((0, n)), 0.0
    pooled: Mixture | None = None
    for number in range(ROUNDS):
        kept = rounds[-KEPT:]
        theta, value = (np.concatenate([getattr(r, k) for r in kept]) for k in ("theta", "value"))
        known = np.array([np.concatenate([r.density_at(other) for other in kept]) for r in kept])
        drawn = np.array([r.number for r in kept])
        proposed = special.logsumexp(known.T + np.log(drawn / drawn.sum()), axis=1)
        before = power
        power, weight = _temper_weights(value - proposed, wanted)
        if number == 0 and 1 / np.sum(_weights(value - proposed) ** 2) < wanted:
            points, more = randomised_maxima(everywhere or problem, rng, progress)
            points = points if problem.images is None else problem.images.fold(points)
            solved += more
        if len(points) > n and number == 0:
            theta, weight = points, np.full(len(points), 1 / len(points))
        elif power < 1.0:
            pooled = _join_proposals(parameters, [r.proposal for r in kept], np.ones(len(kept)))
            since = 0 if power > before else since + 1
        else:
            share = _shares(value, known, value - proposed)
            pooled = _join_proposals(parameters, [r.proposal for r in kept], share)
            since += 1
            # of the same draws, so that shares can be compared
            j = int(np.argmax(share))
            if best_share < share[j]:
                best, best_share, since = kept[j].proposal, share[j], 0
            served += int(best_share >= ENOUGH)
        if served >= FEWEST or since >= PATIENCE:
            break
        parts = _fit(coordinates(theta, logarithmic), weight, PER_MAXIMUM * len(approximations), logarithmic, rng)
        bent = _transports(theta, weight, approximations)
        current = _weigh_components(parameters, [*bent, *parts, *approximations], prior, (theta, weight))
        # where the last ones served, fewer show whether an arm was missed
        more = N_ROUND if len(points) or best_share < ENOUGH else N_ROUND // 4
        rounds.append(_round(problem, current, more, rng, progress))
        solved += more
    # a way that was long ends with fits that each miss something: what one misses another has
    return replace(best if not len(points) or pooled is None else pooled, probes=points[:N_PROBE]), solved


def _transports(theta: np.ndarray, weight: np.ndarray, approximations: Sequence[Proposal]) -> list[Transport]:
    """One a maximum, fitted to the weighted points (n, n_param), (n,) that are nearest to it."""
    nearest = np.argmax([a.log_density(theta) for a in approximations], axis=0)
    found = []
    for k, one in enumerate(approximations):
        own = weight[nearest == k]
        if own.sum() ** 2 > len(theta.T) * np.sum(own**2):
            found.append(fit_transport(theta[nearest == k], own / own.sum(), one.approximation))
    return found


def _weigh_components(
    parameters: Parameters, components: Sequence[Density], prior: PriorDensity,
    points: tuple[np.ndarray, np.ndarray] | None = None,
) -> Mixture:
    """The components beside the prior, by how well they explain weighted points (n, n_param), (n,): expectation
    maximisation of their shares (Cappe, Douc, Guillin, Marin & Robert 2008). Alike where there are none."""
    share = np.full(len(components), 1 / len(components))
    if points is not None:
        theta, weight = points
        known = np.array([c.log_density(theta) for c in components])
        for _ in range(EM_STEPS):
            log_p = known + np.log(share)[:, None]
            share = np.maximum(np.exp(log_p - special.logsumexp(log_p, axis=0)) @ weight, LEAST_PART)
            share /= share.sum()
    return Mixture(parameters=parameters, components=(*components, prior),
                   weight=frozen_array([*((1 - PRIOR_SHARE) * share), PRIOR_SHARE]))


def _join_proposals(parameters: Parameters, proposals: Sequence[Density], share: np.ndarray) -> Mixture:
    """One mixture of several, by their shares (n,); a component of many of them is one."""
    parts: dict[int, Density] = {}
    weight: dict[int, float] = {}
    for proposal, own in zip(proposals, share / share.sum(), strict=True):
        mixed = isinstance(proposal, Mixture)
        for part, w in zip(proposal.components, proposal.weight, strict=True) if mixed else [(proposal, 1.0)]:
            parts[id(part)], weight[id(part)] = part, weight.get(id(part), 0.0) + float(own * w)
    return Mixture(parameters=parameters, components=tuple(parts.values()), weight=frozen_array(list(weight.values())))


def _shares(value: np.ndarray, known: np.ndarray, log_weight: np.ndarray) -> np.ndarray:
    """The effective share that draws of each proposal would have, (n_proposal,), from all draws of all of them.

    (int p)^2 / int p^2 / q by importance sampling from their mixture: a proposal is judged on what the others found
    too, as its own draws do not show what it misses. value, log_weight (n,), known (n_proposal, n) ln densities.
    """
    total = 2 * special.logsumexp(log_weight) - np.log(value.size)
    return np.exp([total - special.logsumexp(log_weight + value - q) for q in known])


def importance_sample(
    problem: Problem, proposal: Density, rng: np.random.Generator, *, evaluated: int = 0, progress: Progress = silent
) -> WeightedDraws:
    """N_DRAW fresh draws of a frozen proposal."""
    theta = proposal.draw(N_DRAW, rng)
    value = log_posterior(problem, theta, "importance sampling", progress)
    constant, unknown = log_prior_constant(problem.parameters)
    log_weight = log_ratio(value, proposal, theta) + constant
    weight = _weights(log_weight)
    log_evidence = float(special.logsumexp(log_weight) - np.log(N_DRAW))
    return WeightedDraws(
        names=problem.parameters.names, theta=frozen_array(theta), weight=frozen_array(weight),
        effective=float(1 / np.sum(weight**2)),
        pareto_k=float(pareto_shape(log_weight[np.isfinite(log_weight)])), log_evidence=log_evidence,
        log_evidence_std=float(np.hypot(np.std(weight * N_DRAW) / np.sqrt(N_DRAW), unknown)),
        evaluated=evaluated + N_DRAW,
        without_modes=int(np.sum(problem.inside(theta) & ~np.isfinite(value))),
        unreached=_count_unreached(problem, proposal, getattr(proposal, "probes", np.empty((0, 0))),
                                   log_evidence - constant),
    )


def _count_unreached(problem: Problem, proposal: Density, probes: np.ndarray, level: float) -> int:
    """Of probes (n, n_param), at how many the posterior over the proposal is far above exp(level)."""
    if not len(probes):
        return 0
    ratio = log_ratio(problem.log_posterior(probes)[0], proposal, probes)
    return int(np.sum(ratio > level + np.log(UNREACHED)))


def log_ratio(value: np.ndarray, proposal: Density, theta: np.ndarray) -> np.ndarray:
    """ln of posterior over proposal (n,), -inf where the posterior is zero."""
    ratio = np.full(len(theta), -np.inf)
    inside = np.isfinite(value)
    ratio[inside] = value[inside] - proposal.log_density(theta[inside])
    return ratio


def _weights(log_weight: np.ndarray) -> np.ndarray:
    relative = np.exp(log_weight - np.max(log_weight))
    return relative / relative.sum()


def _temper_weights(log_weight: np.ndarray, wanted: float) -> tuple[float, np.ndarray]:
    """The largest power, 1 at most, of weights at which `wanted` of the draws count, and the weights there (n,), none
    larger than the root of n times their mean (Ionides 2008)."""

    def weights(power: float) -> np.ndarray:
        value = power * log_weight
        return _weights(np.minimum(value, special.logsumexp(value) - 0.5 * np.log(len(value))))

    power = 1.0
    while 1 / np.sum(weights(power) ** 2) < wanted and power > LEAST_POWER:
        power *= POWER_STEP
    return power, weights(power)


def _fit(u, weight, count: int, logarithmic, rng) -> list[StudentT]:
    """`count` Student t distributions, by expectation maximisation on weighted points u (n, n_param).
    """
    n_param = u.shape[1]
    mean = weight @ u
    scale = np.sqrt(weight @ (u - mean) ** 2) + 1e-12 * (1 + np.abs(mean))
    x = (u - mean) / scale
    whole = (x * weight[:, None]).T @ x
    centres = x[rng.choice(len(x), size=count, p=weight)]
    covariances, share = [whole.copy() for _ in range(count)], np.full(count, 1 / count)
    for _ in range(EM_STEPS):
        log_p, distance = np.empty((count, len(x))), np.empty((count, len(x)))
        for k in range(count):
            factor = linalg.cholesky(covariances[k] + THINNEST * np.eye(n_param), lower=True)
            z = linalg.solve_triangular(factor, (x - centres[k]).T, lower=True)
            distance[k] = np.sum(z**2, axis=0)
            log_p[k] = np.log(share[k]) - np.sum(np.log(np.diag(factor)))
            log_p[k] -= 0.5 * (DEGREES + n_param) * np.log1p(distance[k] / DEGREES)
        belongs = np.exp(log_p - special.logsumexp(log_p, axis=0)) * weight
        share = np.maximum(belongs.sum(axis=1), 1e-3)
        share = share / share.sum()
        for k in range(count):
            near = belongs[k] * (DEGREES + n_param) / (DEGREES + distance[k])
            centres[k] = near @ x / max(near.sum(), 1e-300)
            d = x - centres[k]
            own = (d * near[:, None]).T @ d / max(belongs[k].sum(), 1e-300)
            # a component of few points leans on the whole
            lean = n_param / (n_param + belongs[k].sum() ** 2 / max(np.sum(belongs[k] ** 2), 1e-300))
            covariances[k] = (1 - lean) * own + lean * whole
    parts = []
    for k in range(count):
        factor = linalg.cholesky(SPREAD * covariances[k] + THINNEST * np.eye(n_param), lower=True)
        parts.append(StudentT(centre=frozen_array(mean + scale * centres[k]),
                              factor=frozen_array(scale[:, None] * factor), logarithmic=logarithmic))
    return parts


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """Importance sampling beside a chain: effective draws of N_DRAW, Pareto k, ln evidence (None where the weights or
    the chain say otherwise), and the largest difference of the two means of a parameter, in standard errors of both
    (`z`) and in posterior standard deviations (`apart`); of their mean absolute deviations from the median, `spread_z`
    and by which share they differ, `spread_apart`."""

    effective: float
    n_draw: int
    pareto_k: float
    log_evidence: float | None
    log_evidence_std: float | None
    evaluated: int
    z: float
    apart: float
    parameter: str
    spread_z: float
    spread_apart: float
    spread_parameter: str
    without_modes: int
    unreached: int = 0

    @property
    def agrees(self) -> bool:
        """False where both claim an answer and the answers differ, one of them has missed a part of the posterior; or
        where both begin with a proposal that does not reach all of it."""
        if self.unreached >= FEW:
            return False
        same_mean = self.z < MOST_Z or self.apart < LEAST_APART
        same_spread = self.spread_z < MOST_Z or abs(self.spread_apart) < LEAST_APART
        return self.pareto_k >= GOOD_K or (same_mean and same_spread)

    @property
    def sentence(self) -> str:
        text = (f"importance sampling: {self.effective:.0f} effective of {self.n_draw} draws, Pareto k "
                f"{self.pareto_k:.2f}")
        if self.log_evidence is not None:
            text += f", ln evidence {self.log_evidence:.3f} +- {self.log_evidence_std:.3f}"
        if self.without_modes:
            text += (f"; {self.without_modes} draws within the bounds have no modes and probability zero: the bounds "
                     "allow what is not a structure, such as a negative stiffness")
        if self.unreached >= FEW:
            return (f"{text}; PARTS OF THE POSTERIOR ARE MISSED: {self.unreached} points that the data "
                    "lead to from draws of the prior are hardly ever proposed; give parameters that the data do not "
                    "separate a narrower prior, or fix one of them")
        if self.pareto_k >= TRUSTED_K:
            return f"{text}: its weights are too heavy-tailed to check the chain"
        text += (f"; its means are within {self.apart:.2f} posterior standard deviations of the chain's "
                 f"({self.parameter}, {self.z:.1f} standard errors), its mean distances from the median within "
                 f"{100 * abs(self.spread_apart):.0f} % ({self.spread_parameter})")
        return text if self.agrees else f"{text}: THEY DISAGREE, use neither"


def agree(weighted: WeightedDraws, chain) -> Agreement:
    """Of a chain with draws (n_draw, n_param) and effective sizes ess (n_param,)."""
    draws = chain.draws
    std = draws.std(axis=0, ddof=1)
    gap = np.abs(weighted.mean - draws.mean(axis=0))
    error = np.hypot(weighted.mean_error, std / np.sqrt(np.maximum(chain.ess, 1.0)))
    worst = int(np.argmax(gap / error))
    # squares of a far maximum that holds one in a hundred thousand would be most of a standard deviation
    middle = np.median(draws, axis=0)
    folded, far = np.abs(draws - middle), np.abs(weighted.theta - middle)
    width, other = folded.mean(axis=0), weighted.weight @ far
    spread_error = np.hypot(np.sqrt(weighted.weight**2 @ (far - other) ** 2),
                            folded.std(axis=0, ddof=1) / np.sqrt(np.maximum(chain.spread_ess, 1.0)))
    wide = int(np.argmax(np.abs(other - width) / spread_error))
    # heavy weights understate their own error, and what a chain that has not converged confirms is nothing
    stated = weighted.unreached < FEW and weighted.pareto_k < (TRUSTED_K if chain.converged else GOOD_K)
    return Agreement(
        effective=weighted.effective, n_draw=len(weighted.theta), pareto_k=weighted.pareto_k,
        log_evidence=weighted.log_evidence if stated else None,
        log_evidence_std=weighted.log_evidence_std if stated else None, evaluated=weighted.evaluated,
        spread_z=float(np.abs(other - width)[wide] / spread_error[wide]),
        spread_apart=float(other[wide] / width[wide] - 1),
        spread_parameter=weighted.names[wide],
        z=float(gap[worst] / error[worst]), apart=float(gap[worst] / std[worst]), parameter=weighted.names[worst],
        without_modes=weighted.without_modes, unreached=weighted.unreached,
    )
