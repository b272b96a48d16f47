"""Hypotheses, sets of effects with their time profiles that were fitted beside the model, and their ranking by
posterior probability."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from probupdate.diagnosis.evidence import log_evidence, marginal_evidence, promised_evidence
from probupdate.diagnosis.expected import ModelAnswers
from probupdate.diagnosis.fitting import Fit, design_at
from probupdate.diagnosis.noise import Noise
from probupdate.diagnosis.problem import DiagnosisProblem, IncludedEffect
from probupdate.errors import ConvergenceError
from probupdate.runtime.executors import SERIAL, Executor

# ln evidence within which two hypotheses are compared about the same parameters
CLOSE = 40.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Hypothesis:
    """Effects with their time profiles beside the model (`candidates`, rows of the problem's `which`, in the order of
    `fitted.included`), fitted; score z of each when it was proposed; ln prior probability of the set; ln evidence by
    Laplace's method at its own noise, and what of it is `promised_evidence`, and what it has for ways that it leaves
    free (`not_predicted`). `stored`: the effects that its design, which is not kept, was made with."""

    candidates: tuple[int, ...]
    z: tuple[float, ...]
    fitted: Fit
    log_prior: float
    log_evidence: float
    promised: float
    not_predicted: float = 0.0
    stored: tuple[IncludedEffect, ...] | None = None

    @property
    def log_posterior(self) -> float:
        return self.log_evidence + self.log_prior

    @property
    def predicted(self) -> float:
        """ln posterior with all that was measured counted, what it leaves free too."""
        return self.log_posterior - self.not_predicted

    def without_design(self) -> Hypothesis:
        """The same without the signatures of its design, of which some dozen would be as large as all else."""
        if self.stored is not None:
            return self
        return replace(self, fitted=replace(self.fitted, design=self.fitted.design.without_signatures()),
                       stored=self.fitted.included)

    def not_asked(self) -> Hypothesis:
        """The same without what its design was asked for, which is as large as its signatures."""
        return replace(self, fitted=replace(self.fitted, design=replace(self.fitted.design)))

    def with_design(self, problem: DiagnosisProblem) -> Hypothesis:
        """The same with its design made again, as for this problem, which may have taken up crosstalks since."""
        fitted = self.fitted
        if self.stored is None and len(fitted.design.which) == len(problem.which):
            return self
        included = fitted.included if self.stored is None else self.stored
        design = design_at(problem, fitted.theta, included, fitted.design.noise)
        return replace(self, fitted=replace(fitted, design=design), stored=None)


def log_prior(problem: DiagnosisProblem, candidates: Sequence[int]) -> float:
    """ln prior probability of these effects and time profiles over that of none: a change is as probable as not, shared
    out by the catalogue's odds, and at any of a step's times alike."""
    return float(np.sum(np.log(problem.prior_shares[list(candidates)])))


def key_of(problem: DiagnosisProblem, candidates: Sequence[int]) -> frozenset:
    """Effects with the kinds of their time profiles: steps of other times are one hypothesis."""
    return frozenset((int(j), problem.time_profiles[c].name) for j, c in problem.which[list(candidates)])


def hypothesis_of(
    problem: DiagnosisProblem, candidates: tuple[int, ...], z: tuple[float, ...], fitted: Fit
) -> Hypothesis:
    """A hypothesis of these candidates, whose effects were fitted, with its evidence and prior."""
    own = log_evidence(problem, fitted)
    return Hypothesis(candidates=candidates, z=z, fitted=fitted, log_prior=log_prior(problem, candidates),
                      log_evidence=own, promised=promised_evidence(problem, fitted),
                      not_predicted=_unpredicted_evidence(problem, fitted, own))


def _unpredicted_evidence(problem: DiagnosisProblem, fitted: Fit, log_evidence_of: float) -> float:
    """What the ln evidence of a fit is larger by for what it leaves free and need not explain."""
    noise = fitted.design.noise
    if not noise.free:
        return 0.0
    all_counted = replace(noise, precision=tuple(map(np.linalg.inv, noise.covariance)), free=())
    design = replace(fitted.design, noise=all_counted)
    return max(0.0, log_evidence_of - log_evidence(problem, replace(fitted, design=design)))


class Ranking:
    """Hypotheses by posterior probability, those near the best with their evidence relative to its, each pair about the
    parameters of both fits, whichever is the better for each, and at the best one's noise. Signatures of all that is
    marginalised differ from one fit's parameters to the next, which alone moves evidence by ten and more, of both
    alike; and far from its own fit neither is linear. What one of two leaves free says nothing of either: a mode that a
    small mass puts beside a measured one would else be evidence for that mass, as it need not explain that one's
    shape."""

    def __init__(self, runs: Executor = SERIAL):
        self._runs = runs
        # with the objects whose numbers stand in the key, so that these stay theirs
        self._known: dict[tuple, tuple[float, Hypothesis, Noise]] = {}
        self._noises: dict[tuple[int, int], tuple[Noise, Hypothesis, Hypothesis]] = {}

    def order(
        self, problem: DiagnosisProblem, known: dict[frozenset, Hypothesis]
    ) -> tuple[list[frozenset], list[float]]:
        """Keys, the most probable first, with the ln posterior relative to it. A fit that has not settled stands where
        it stopped, below what its hypothesis could reach."""
        best = known[max(known, key=lambda k: known[k].predicted)]
        self._evaluate(problem, [h for h in known.values() if _is_close(h, best)], best)
        relative = {k: self._relative(h, best) for k, h in known.items()}
        top = max(relative.values())
        keys = sorted(relative, key=lambda k: -relative[k])
        return keys, [relative[k] - top for k in keys]

    def _noise(self, one: Hypothesis, best: Hypothesis) -> Noise:
        """The best one's, with what the other leaves free too."""
        key = id(one), id(best)
        if key not in self._noises:
            self._noises[key] = best.fitted.design.noise.also_free(one.fitted.design.noise), one, best
        return self._noises[key][0]

    def _evaluate(self, problem: DiagnosisProblem, close: Sequence[Hypothesis], best: Hypothesis) -> None:
        """The evidence of each of the hypotheses and of the best one, about the parameters of either; side by side
        places, as at one of them the model is solved once for all."""
        asked: dict[tuple[bytes, int], tuple[np.ndarray, Noise, dict[int, Hypothesis]]] = {}
        for one in close:
            noise = self._noise(one, best)
            for theta, h in ((p.fitted.theta, h) for p in (one, best) for h in (one, best)):
                place = theta.tobytes()
                if (place, id(h), id(noise)) not in self._known:
                    asked.setdefault((place, id(noise)), (theta, noise, {}))[2][id(h)] = h
        tasks = [(theta, noise, [h.fitted.included for h in there.values()]) for theta, noise, there in asked.values()]
        values = self._runs.in_order(_evidence_about, tasks, shared=(problem,))
        for ((place, _), (_, noise, there)), found in zip(asked.items(), values, strict=True):
            self._known |= {(place, number, id(noise)): (value, h, noise)
                            for (number, h), value in zip(there.items(), found, strict=True)}

    def _relative(self, one: Hypothesis, best: Hypothesis) -> float:
        apart = one.log_posterior - best.log_posterior
        if not _is_close(one, best):
            return apart
        noise = self._noise(one, best)

        def about(place: Hypothesis, h: Hypothesis) -> float:
            return self._known[place.fitted.theta.tobytes(), id(h), id(noise)][0]

        own, other = (max(about(place, h) for place in (one, best)) for h in (one, best))
        if not np.isfinite([own, other]).all():
            return apart
        return own - other - (one.promised - best.promised) + one.log_prior - best.log_prior


def _is_close(one: Hypothesis, best: Hypothesis) -> bool:
    return one is not best and one.log_posterior - best.predicted >= -CLOSE


def _evidence_about(
    problem: DiagnosisProblem, theta: np.ndarray, noise: Noise, hypotheses: Sequence[Sequence[IncludedEffect]]
) -> list[float]:
    """`marginal_evidence` of each of the hypotheses, -inf where no modes of the model pair with the measured ones."""
    found, answers = [], ModelAnswers()
    for included in hypotheses:
        try:
            found.append(marginal_evidence(problem, theta, included, noise, answers))
        except ConvergenceError:
            found.append(-np.inf)
    return found
