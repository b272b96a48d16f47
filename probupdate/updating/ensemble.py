"""The posterior by emcee: several independent ensembles, started from draws of the proposal, run until three criteria
hold.

Any number of independent ensembles share one judgement; they may run on any executor. The chain is kept in segments
beside the result (`chain_store`): a killed run goes on where its last segment ended, with the same numbers as an
undisturbed one, whatever it runs on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import emcee
import numpy as np
from scipy import special

from probupdate.errors import InputError
from probupdate.model.parameters import Parameters
from probupdate.runtime.arrays import frozen_array
from probupdate.runtime.executors import Executor, executor, iterate_completed
from probupdate.runtime.progress import Progress, silent
from probupdate.updating.chain_store import ChainStore, Segment
from probupdate.updating.problem import Problem
from probupdate.updating.settings import CONSTANTS, SamplerSettings
from probupdate.updating.surrogate import Density, GaussianApproximation, Proposal

# steps between looks at convergence, and the unit that is written to disk
SEGMENT = 100
# walkers of an ensemble at least: a step of few costs as much as one of a dozen
LEAST_WALKERS = 12
# rounds in which walkers that begin where the model has no modes are drawn again
START_ROUNDS = 100
R_HAT_LIMIT = CONSTANTS.r_hat_limit
AUTOCORRELATION_TIMES = CONSTANTS.autocorrelation_times
BURN_IN, SPREAD_ESS = CONSTANTS.burn_in, CONSTANTS.spread_ess
# where part of what a move proposes is far: full jumps along differences of walkers carry them between modes
JUMP_SHARE = 0.1
# steps from which a chain is given up that would need so many times the most that are allowed
LEAST_STEPS, HOPELESS = 1000, 2.0
# share of proposals from the surrogate, and where its weighted draws serve by themselves
SURROGATE_SHARE, TRUSTED_SHARE = 0.5, 0.8
# proposals that do not depend on the walkers are drawn so many at once
POOL = 2000
# share of proposals of one or two parameters from their prior
PRIOR_SHARE = 0.15
# share of proposals of some parameters along differences of walkers, at most how many of them, and the share of those
# that are as long as the difference
SUBSET_SHARE, MOST_OF_SUBSET, FULL_LENGTH = 0.15, 4, 0.3


@dataclass(frozen=True, eq=False, kw_only=True)
class Chain:
    """theta (n_step, n_walker, n_param), log_posterior (n_step, n_walker), acceptance share of all moves, number of
    evaluated parameter vectors and of those that the full model answered. `first` is the first step after burn-in.

    r_hat, ess, tail, tau (n_param,): nested R-hat over ensembles (of a single one, over its halves in time) of the
    draws and of their distance from the median, the larger of both; bulk and tail effective size with walkers as
    chains, emcee's integrated autocorrelation time in steps. spread_ess (n_param,): effective size of that distance,
    which tells standard deviations.
    """

    theta: np.ndarray
    log_posterior: np.ndarray
    first: int
    acceptance: float
    evaluated: int
    fallback: int
    r_hat: np.ndarray
    ess: np.ndarray
    tail: np.ndarray
    tau: np.ndarray
    spread_ess: np.ndarray
    converged: bool
    verdict: str

    @property
    def draws(self) -> np.ndarray:
        """(n_draw, n_param) after burn-in, walker by walker within a step."""
        return self.theta[self.first :].reshape(-1, self.theta.shape[2])


def moves(
    parameters: Parameters, surrogate: Density, trusted: bool = False
) -> list[tuple[emcee.moves.Move, float]]:
    """Differential evolution, part of it with full-length jumps, and of a few parameters only; all parameters from
    the surrogate, mostly where that is trusted; one or two parameters from their prior.

    Not offered: DESnookerMove of emcee 3.1.6 leaves the wrong variance, GaussianMove with a full covariance moves all
    walkers alike.
    """
    share = TRUSTED_SHARE if trusted else SURROGATE_SHARE
    others = (1 - share) / (1 - SURROGATE_SHARE)
    return [
        (emcee.moves.DEMove(), others * (1 - JUMP_SHARE - SURROGATE_SHARE - PRIOR_SHARE - SUBSET_SHARE)),
        (emcee.moves.DEMove(gamma0=1.0), others * JUMP_SHARE),
        (SurrogateMove(surrogate), share),
        (PriorMove(parameters), others * PRIOR_SHARE),
        (SubsetMove(), others * SUBSET_SHARE),
    ]


class SubsetMove(emcee.moves.RedBlueMove):
    """One to MOST_OF_SUBSET parameters of each walker along the difference of two walkers of the other half, the others
    kept (the crossover of Vrugt's and ter Braak's adaptive chains).

    Where all parameters at once are rarely accepted, a few are; where two do each other's work, both move along.
    """

    def get_proposal(self, sample, complement, random):
        others = np.concatenate(complement, axis=0)
        n_walker, n_param = sample.shape
        number = random.randint(1, min(MOST_OF_SUBSET, n_param) + 1, size=n_walker)
        order = np.argsort(random.uniform(size=(n_walker, n_param)), axis=1)
        first = random.randint(len(others), size=n_walker)
        second = (first + random.randint(1, len(others), size=n_walker)) % len(others)
        # ter Braak's length, randomised: symmetric, so that the density alone decides
        length = 2.38 / np.sqrt(2 * number) * random.uniform(0.2, 1.2, size=n_walker)
        length = np.where(random.uniform(size=n_walker) < FULL_LENGTH, 1.0, length)
        step = length[:, None] * (others[first] - others[second])
        return sample + np.where(order < number[:, None], step, 0.0), np.zeros(n_walker)


class PriorMove(emcee.moves.RedBlueMove):
    """One or two parameters of each walker drawn again from their marginal priors, the others kept.

    Parameters the data hardly inform are redrawn at once. Where two do each other's work, as the pile's shaft and tip
    do, the posterior has arms along either that a Gaussian approximation does not have; this walks along them.
    """

    def __init__(self, parameters: Parameters):
        super().__init__()
        self._parameters = parameters
        self._pool = np.empty((0, len(parameters)))

    def get_proposal(self, sample, complement, random):
        n_walker, n_param = sample.shape
        if len(self._pool) < n_walker:
            uniform = random.uniform(size=(max(n_walker, POOL), n_param))
            drawn = np.column_stack([p.distribution.ppf(uniform[:, k]) for k, p in enumerate(self._parameters)])
            self._pool = np.clip(drawn, self._parameters.lower, self._parameters.upper)
        fresh, self._pool = self._pool[:n_walker], self._pool[n_walker:]
        order = np.argsort(random.uniform(size=(n_walker, n_param)), axis=1)
        number = 1 + (random.uniform(size=(n_walker, 1)) < 0.5)
        theta = np.where(order < number, fresh, sample)
        # what was kept cancels
        return theta, self._parameters.log_marginals(sample) - self._parameters.log_marginals(theta)


class SurrogateMove(emcee.moves.RedBlueMove):
    """Independent draws of the surrogate, a share of them from a wider one: the ratio of densities corrects for what it
    misses.

    Where the posterior's tail is heavier than the surrogate's a walker would stay for hundreds of steps, as the density
    proposed there is far too low; the wider share bounds that. Mixed with other moves it need not know everything.
    """

    def __init__(self, surrogate: Density):
        super().__init__()
        self._proposal = Proposal(approximation=surrogate) if isinstance(surrogate,
                                                                         GaussianApproximation) else surrogate
        self._pool = np.empty((0, 0))
        self._known: dict[bytes, float] = {}

    def get_proposal(self, sample, complement, random):
        n = len(sample)
        if len(self._pool) < n:
            # thousands at once cost little more than one
            self._pool = self._proposal.draw(max(n, POOL), random)
            self._known = {}
            self._remember(self._pool)
        theta, self._pool = self._pool[:n], self._pool[n:]
        # most walkers stand where one of these moves took them
        unknown = [k for k, row in enumerate(sample) if row.tobytes() not in self._known]
        if unknown:
            self._remember(sample[unknown])
        before, after = (np.array([self._known[row.tobytes()] for row in rows]) for rows in (sample, theta))
        # a draw outside the bounds has no density, and no posterior either: it is refused
        return theta, before - np.where(np.isfinite(after), after, 0.0)

    def _remember(self, theta: np.ndarray) -> None:
        self._known |= zip([row.tobytes() for row in theta], self._proposal.log_density(theta).tolist(), strict=True)


def sample(
    problem: Problem,
    surrogate: Density,
    folder: str | Path,
    settings: SamplerSettings,
    *,
    trusted: bool = False,
    parts: Mapping[str, str] | None = None,
    jobs: int | Executor = 1,
    progress: Progress = silent,
) -> Chain:
    """Draw from the posterior of `problem`, keeping segments in `folder`.

    trusted: weighted draws of the surrogate serve by themselves, so that most moves are its. `parts` stands for the
    problem where it differs from problem.parts() (a reduced model built with settings of its own). jobs: processes, or
    an executor, on which the ensembles run side by side; the numbers are the same on any.
    Raises InputError where the folder holds a chain of another problem or other settings, and says which differ.
    """
    parameters = problem.parameters
    store = _store(parameters, folder, settings, problem.parts() if parts is None else parts)
    rounds = store.read()
    with executor(jobs) as runs:
        while True:
            n_step = sum(len(r[0].theta) for r in rounds)
            if rounds:
                chain = _judge(rounds, parameters, settings)
                # as far as it is known: the worst effective size grows about with the number of steps
                forecast = n_step if chain.converged else _forecast(chain, n_step, settings)
                progress("sampling", n_step, max(min(settings.max_steps, forecast), n_step))
                if chain.converged or n_step >= settings.max_steps:
                    return chain
                if n_step >= LEAST_STEPS and forecast > HOPELESS * settings.max_steps:
                    return replace(chain, verdict=f"{chain.verdict[:-1]}, given up: about {forecast} would be needed, "
                                   f"at most {settings.max_steps} are allowed.")
                states = [segment.state for segment in rounds[-1]]
            else:
                states = [initial_state(problem, surrogate, _n_walker(parameters, settings), settings.seed, k)
                          for k in range(settings.ensembles)]
            n_more = min(SEGMENT, settings.max_steps - n_step)
            # those that a killed run finished of this round are kept
            kept = {k: store.read_one(len(rounds), k) for k in range(settings.ensembles)}
            done = {k: segment for k, segment in kept.items() if segment is not None}
            tasks = [(k, problem, surrogate, trusted, states[k], n_more) for k in kept if k not in done]
            for k, segment in iterate_completed(_run_numbered, tasks, jobs=runs, least=1):
                store.append(segment, len(rounds), k)
                done[k] = segment
            rounds.append([done[k] for k in range(settings.ensembles)])


def initial_state(problem: Problem, surrogate: Density, n_walker: int, seed: int, ensemble: int) -> emcee.State:
    """Walkers where the model has modes: from one that has none emcee knows no step."""
    own = [] if ensemble == 0 else [ensemble]
    draw, rng = getattr(surrogate, "draw_inside", surrogate.draw), np.random.default_rng([seed, 0, *own])
    start = draw(n_walker, rng)
    without = np.ones(n_walker, bool)
    for _ in range(START_ROUNDS):
        without = ~np.isfinite(problem.log_posterior(start)[0])
        if not without.any():
            break
        start[without] = draw(int(without.sum()), rng)
    else:
        raise InputError(
            "model", f"has no modes at {without.sum()} of {n_walker} starts, redrawn {START_ROUNDS} times",
            "narrow the parameters' bounds to physically possible values")
    generator = np.random.RandomState(np.random.default_rng([seed, 1, *own]).integers(2**32, size=8))
    return emcee.State(start, random_state=generator.get_state())


def _run_numbered(number: int, *segment: Any) -> tuple[int, Segment]:
    return number, _run_segment(*segment)


def _run_segment(
    problem: Problem, surrogate: Density, trusted: bool, state: emcee.State, n_step: int
) -> Segment:
    """One ensemble's next steps; nothing outside is read or changed, so that it may run anywhere."""
    counts = {"evaluated": 0, "fallback": 0}

    def log_probability(theta: np.ndarray) -> np.ndarray:
        value, fallback = problem.log_posterior(theta)
        counts["evaluated"] += int(np.isfinite(value).sum())
        counts["fallback"] += int(fallback.sum())
        return value

    # set up for every segment: nothing that the moves remember crosses from one to the next, so that a run that was
    # stopped between them goes on with the same numbers
    sampler = emcee.EnsembleSampler(
        len(state.coords), len(problem.parameters), log_probability, vectorize=True,
        moves=moves(problem.parameters, surrogate, trusted),
    )
    # emcee's wrapper of it prints a traceback of whatever ends it, also of a signal
    sampler.log_prob_fn = log_probability
    state = sampler.run_mcmc(state, n_step, skip_initial_state_check=True)
    return Segment(theta=sampler.get_chain(), log_posterior=sampler.get_log_prob(), state=state,
                   accepted=float(np.mean(sampler.acceptance_fraction)), **counts)


def _n_walker(parameters: Parameters, settings: SamplerSettings) -> int:
    n_walker = max(2 * len(parameters) + 2, LEAST_WALKERS, settings.walkers_per_parameter * len(parameters))
    return n_walker + n_walker % 2


def claim_folder(
    parameters: Parameters, folder: str | Path, settings: SamplerSettings, parts: Mapping[str, str]
) -> None:
    """Refuse a folder with another chain, as `sample` does, before any work is spent on this one."""
    _store(parameters, folder, settings, parts)


def _store(parameters, folder, settings: SamplerSettings, parts: Mapping[str, str]) -> ChainStore:
    kept = {"seed": int(settings.seed), "ensembles": settings.ensembles, "walkers": _n_walker(parameters, settings),
            "parameters": list(parameters.names), "steps of a segment": SEGMENT,
            "emcee": emcee.__version__}
    return ChainStore(Path(folder), parts, kept)


def _forecast(chain: Chain, n_step: int, settings: SamplerSettings) -> int:
    smallest = min(float(np.min(chain.ess)), float(np.min(chain.tail)))
    factor = max(
        settings.target_ess / max(smallest, 1.0),
        AUTOCORRELATION_TIMES * float(np.max(chain.tau)) / (settings.ensembles * n_step),
        1.0,
    )
    return int(np.ceil(n_step * factor / SEGMENT)) * SEGMENT


def nested_r_hat(theta: np.ndarray, n_ensemble: int) -> np.ndarray:
    """theta (n_step, n_walker, n_param), ensembles side by side -> (n_param,), on ranks turned to normal scores.

    sqrt(1 + B / W): B the variance of the ensembles' means, W the mean variance within an ensemble, over all of its
    walkers and steps. A single ensemble is held against itself, its first half against its second.
    """
    from scipy import stats

    n_step, n_walker, n_param = theta.shape
    if n_ensemble == 1:
        half = n_step // 2
        groups = np.array([theta[:half].reshape(-1, n_param), theta[n_step - half :].reshape(-1, n_param)])
    else:
        groups = theta.reshape(n_step, n_ensemble, n_walker // n_ensemble, n_param).swapaxes(0, 1)
        groups = groups.reshape(n_ensemble, -1, n_param)
    r_hat = np.full(n_param, np.inf)
    for k in range(n_param):
        values = groups[:, :, k]
        ranks = stats.rankdata(values).reshape(values.shape)
        z = special.ndtri((ranks - 0.375) / (values.size + 0.25))
        within = float(np.mean(np.var(z, axis=1, ddof=1)))
        if np.ptp(values) > 0 and within > 0:
            r_hat[k] = np.sqrt(1 + np.var(np.mean(z, axis=1), ddof=1) / within)
    return r_hat


def _judge(rounds: list[list[Segment]], parameters, settings: SamplerSettings) -> Chain:
    from probupdate.updating.posterior_file import effective_size, tail_size

    # walkers of all ensembles side by side
    theta = np.concatenate([np.concatenate([s.theta for s in r], axis=1) for r in rounds])
    log_posterior = np.concatenate([np.concatenate([s.log_posterior for s in r], axis=1) for r in rounds])
    segments = [s for r in rounds for s in r]
    n_step = len(theta)
    first = int(BURN_IN * n_step)
    kept = theta[first:]
    _, ess = effective_size(kept)
    tail = tail_size(kept)
    # an ensemble that sits in a tail has the others' middle and another width (Vehtari et al. 2021)
    folded = np.abs(kept - np.median(kept, axis=(0, 1)))
    _, spread_ess = effective_size(folded)
    r_hat = np.maximum(nested_r_hat(kept, settings.ensembles), nested_r_hat(folded, settings.ensembles))
    # tol=0: emcee only warns of short chains; the criterion below is judged here, and a walker that never moved has no
    # autocorrelation: its time is NaN, which no criterion passes
    with np.errstate(invalid="ignore"):
        tau = emcee.autocorr.integrated_time(kept, tol=0, has_walkers=True)
    times = settings.ensembles * len(kept) / float(np.max(tau))
    checks = (
        (float(np.max(r_hat)) < R_HAT_LIMIT, f"nested R-hat {np.max(r_hat):.4f} "
         f"({parameters.names[int(np.argmax(r_hat))]}), wanted below {R_HAT_LIMIT}"),
        (times > AUTOCORRELATION_TIMES, f"{times:.0f} autocorrelation times ({parameters.names[int(np.argmax(tau))]}), "
         f"wanted {AUTOCORRELATION_TIMES}"),
        (float(np.min(ess)) >= settings.target_ess, f"effective size {np.min(ess):.0f} "
         f"({parameters.names[int(np.argmin(ess))]}), wanted {settings.target_ess}"),
        (float(np.min(spread_ess)) >= min(SPREAD_ESS, settings.target_ess), f"of standard deviations "
         f"{np.min(spread_ess):.0f} ({parameters.names[int(np.argmin(spread_ess))]}), wanted "
         f"{min(SPREAD_ESS, settings.target_ess)}"),
        (float(np.min(tail)) >= settings.target_ess, f"in the tails {np.min(tail):.0f} "
         f"({parameters.names[int(np.argmin(tail))]}), wanted {settings.target_ess}"),
    )
    converged = all(held for held, _ in checks)
    if converged:
        verdict = "Converged: " + "; ".join(text.split(",")[0] for _, text in checks)
    else:
        verdict = "NOT converged: " + "; ".join(text for held, text in checks if not held)
    verdict += f"; {settings.ensembles} ensembles of {n_step} steps."
    return Chain(
        theta=frozen_array(theta), log_posterior=frozen_array(log_posterior),
        first=first, acceptance=float(np.mean([s.accepted for s in segments])),
        evaluated=sum(s.evaluated for s in segments), fallback=sum(s.fallback for s in segments),
        r_hat=frozen_array(r_hat), ess=frozen_array(ess), tail=frozen_array(tail), tau=frozen_array(tau),
        spread_ess=frozen_array(spread_ess),
        converged=converged, verdict=verdict,
    )
