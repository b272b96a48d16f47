"""What the variance of every parameter's estimate is made of, and what to measure next to narrow it.

With responses linear about the maximum, the estimate is theta = P S^T W (y - g) + P W_Theta theta_0 with P the
posterior's covariance and W = W_Lambda. Its error is the sum of independent parts: of identification, of the model's
discrepancy, of each source of the model's error, and of what the prior has left. Their variances add up to P exactly,
as P S^T W S P + P W_Theta P = P.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from probupdate.modal.labels import moves_little
from probupdate.runtime.arrays import frozen_array
from probupdate.updating.laplace import Laplace, prior_residual
from probupdate.updating.problem import Problem

IDENTIFICATION, DISCREPANCY, PRIOR = "identification", "model discrepancy", "prior"
# a measure that narrows no parameter by this share is not worth a line
LEAST_GAIN = 0.02
MOST_MEASURES = 12
# of ln f, within which a mode of the model at the maximum may be one that was identified
NEAR = 0.1


@dataclass(frozen=True, kw_only=True)
class Measure:
    """What one more measurement, or a better known quantity, would narrow: `what` to do, and by which share the
    standard deviation of each parameter would fall, (n_param,)."""

    what: str
    gain: tuple[float, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class VarianceComponents:
    """names of the components; std (n_component, n_param) of each in the parameters' estimate; their squares add up to
    those of total (n_param,), the Gauss-Newton standard deviation at the maximum. sources: the same for every single
    source of the model's error (n_source, n_param), with its `source_names`. measures: what to measure next, the most
    useful first."""

    parameters: tuple[str, ...]
    names: tuple[str, ...]
    std: np.ndarray
    total: np.ndarray
    source_names: tuple[str, ...]
    source_std: np.ndarray
    measures: tuple[Measure, ...]


def _gain(whitened: WhitenedResponses) -> np.ndarray:
    """P X^T (I + B B^T)^-1: what a whitened response of one does to the estimate."""
    X, B = whitened.slope, whitened.factor
    return whitened.covariance() @ (X.T - (X.T @ B) @ np.linalg.solve(whitened.inner(), B.T))


def source_std(problem: Problem, laplace: Laplace) -> np.ndarray:
    """(n_source, n_param) of every source of the model's error in the parameters' estimate."""
    whitened = whitened_at(problem, laplace)
    return np.abs(_gain(whitened) @ whitened.factor)[:, : len(problem.error_sources)].T


def variance_components(problem: Problem, laplace: Laplace, seen_hz: Sequence[float] = ()) -> VarianceComponents:
    """Of one problem at the maximum of its posterior. seen_hz: frequencies that were identified and are not among the
    responses: no mode near one of them is to be measured next."""
    whitened = whitened_at(problem, laplace)
    _, prior_slope = prior_residual(problem.parameters, laplace.theta)
    P, gain = whitened.covariance(), _gain(whitened)
    of_sources = gain @ whitened.factor
    sources = problem.error_sources
    noise = problem.unmixed_root * problem.discrepancy_std
    discrepancy = np.sum((gain @ noise) ** 2, axis=1) + np.sum(of_sources[:, len(sources) :] ** 2, axis=1)
    identification = np.maximum(np.sum(gain**2, axis=1) - np.sum((gain @ noise) ** 2, axis=1), 0.0)
    groups: dict[str, np.ndarray] = {}
    for k, source in enumerate(sources):
        groups[source.group] = groups.get(source.group, 0.0) + of_sources[:, k] ** 2
    parts = {IDENTIFICATION: identification, DISCREPANCY: discrepancy, **groups,
             PRIOR: np.sum((P @ prior_slope.T) ** 2, axis=1)}
    return VarianceComponents(
        parameters=problem.parameters.names, names=tuple(parts),
        std=frozen_array(np.sqrt(np.array(list(parts.values())))), total=frozen_array(np.sqrt(np.diag(P))),
        source_names=tuple(s.description for s in sources),
        source_std=frozen_array(np.abs(of_sources[:, : len(sources)].T)),
        measures=_rank_measures(problem, laplace, whitened, seen_hz),
    )


def misfit_by_response(problem: Problem, laplace: Laplace) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """Names of the responses (each frequency, each group's shapes), chi-square of each by its own marginal covariance
    at the maximum, and what is expected of it; they do not add up where errors go together."""
    residual = problem.measured - problem.predict(laplace.theta)
    covariance = np.linalg.pinv(problem.noise_root.T @ problem.noise_root) + problem.factor @ problem.factor.T
    names, chi_square, expected = [], [], []
    frequency, shape = 0, problem.n_frequency
    for group in problem.groups:
        labels = [problem.mode_labels[problem.used[frequency + k]] for k in range(group.size)]
        for k, label in enumerate(labels):
            row = frequency + k
            names.append(f"frequency of {label}")
            chi_square.append(residual[row] ** 2 / covariance[row, row])
            expected.append(1.0)
        size = group.shape_response.size
        if size:
            rows = slice(shape, shape + size)
            own = residual[rows]
            names.append(f"shape of {' and '.join(labels)}")
            mac = group.shapes == "mac"
            chi_square.append(own @ own / problem.std[shape] ** 2 if mac else
                              own @ np.linalg.pinv(covariance[rows, rows], hermitian=True) @ own)
            expected.append(float(group.n_effective - group.size))
        frequency, shape = frequency + group.size, shape + size
    return tuple(names), np.array(chi_square), np.array(expected)


@dataclass(frozen=True, eq=False)
class WhitenedResponses:
    """Responses linear about a maximum, over their noise: slope X (n, n_param), factor B (n, n_source + n_pair) per
    standard deviation of each source, then of what mixes modes, and the prior's precision (n_param, n_param)."""

    slope: np.ndarray
    factor: np.ndarray
    prior: np.ndarray

    def inner(self) -> np.ndarray:
        return np.eye(self.factor.shape[1]) + self.factor.T @ self.factor

    def covariance(self, left_out: np.ndarray | None = None) -> np.ndarray:
        """P, with the sources of these columns known exactly."""
        X, B = self.slope, self.factor
        if left_out is not None:
            B = np.delete(B, left_out, axis=1)
        XB = X.T @ B
        inner = np.eye(B.shape[1]) + B.T @ B
        return np.linalg.inv(X.T @ X - XB @ np.linalg.solve(inner, XB.T) + self.prior)

    def with_rows(self, slope: np.ndarray, factor: np.ndarray) -> WhitenedResponses:
        return WhitenedResponses(np.vstack([self.slope, slope]), np.vstack([self.factor, factor]), self.prior)

    def scale_noise(self, rows: np.ndarray, by: float) -> WhitenedResponses:
        """With the noise of some responses smaller by a factor; rows are of independent noise."""
        scale = np.ones(len(self.slope))
        scale[rows] = by
        return WhitenedResponses(self.slope * scale[:, None], self.factor * scale[:, None], self.prior)


def whitened_at(problem: Problem, laplace: Laplace) -> WhitenedResponses:
    """Of one problem at the maximum of its posterior."""
    _, sensitivity = problem.sensitivity(laplace.theta)
    _, prior_slope = prior_residual(problem.parameters, laplace.theta)
    common = np.column_stack([problem.factor, problem.mixing_factor])
    return WhitenedResponses(problem.unmixed_root @ sensitivity, problem.unmixed_root @ common,
                             prior_slope.T @ prior_slope)


@dataclass(frozen=True, eq=False, kw_only=True)
class Candidate:
    """One more measurement, or a quantity better known: `what` to do, the parameters' covariance (n_param, n_param)
    with it, and the numbers of the sources of error that it makes `known` (empty for more data)."""

    what: str
    covariance: np.ndarray
    known: tuple[int, ...] = ()


def _rank_measures(
    problem: Problem, laplace: Laplace, now: WhitenedResponses, seen_hz: Sequence[float]
) -> tuple[Measure, ...]:
    before = np.sqrt(np.diag(now.covariance()))
    found = []
    for one in candidates(problem, laplace, now, seen_hz):
        gain = 1 - np.sqrt(np.diag(one.covariance)) / before
        if gain.max() >= LEAST_GAIN:
            found.append(Measure(what=one.what, gain=tuple(float(g) for g in gain)))
    return tuple(sorted(found, key=lambda m: -max(m.gain))[:MOST_MEASURES])


def candidates(
    problem: Problem, laplace: Laplace, now: WhitenedResponses, seen_hz: Sequence[float] = ()
) -> Iterator[Candidate]:
    """What could be measured next: each tolerance checked, each mode identified better, a mode of the model's more."""
    sources = problem.error_sources
    checks: dict[tuple[str, str], list[int]] = {}
    for k, source in enumerate(sources):
        checks.setdefault((source.group, source.check), []).append(k)
    for (group, check), columns in checks.items():
        names = [sources[k].description for k in columns]
        what = names[0] if len(names) == 1 else f"{len(names)} tolerances of {group}, such as {names[0]}"
        yield Candidate(what=f"determine {what}{f' ({check})' if check else ''}",
                        covariance=now.covariance(np.array(columns)), known=tuple(columns))
    if not problem.weights.covariance:
        yield from _better_identified(problem, now)
    yield from _further_modes(problem, laplace, now, seen_hz)


def _better_identified(problem: Problem, now: WhitenedResponses) -> Iterator[Candidate]:
    """A mode whose frequency, or shape, is identified to half its standard deviation."""
    frequency, shape = 0, problem.n_frequency
    variance, missed = problem.std**2, problem.discrepancy_std**2
    for group in problem.groups:
        names = " and ".join(problem.mode_labels[problem.used[frequency + k]] for k in range(group.size))
        size = group.shape_response.size
        for what, rows in (("frequency", np.arange(frequency, frequency + group.size)),
                           ("shape", np.arange(shape, shape + size))):
            if rows.size:
                halved = (variance[rows] - missed[rows]) / 4 + missed[rows]
                by = float(np.sqrt(np.mean(variance[rows]) / np.mean(halved)))
                yield Candidate(what=f"identify the {what} of {names} twice as exactly",
                                covariance=now.scale_noise(rows, by).covariance())
        frequency, shape = frequency + group.size, shape + size


def _further_modes(
    problem: Problem, laplace: Laplace, now: WhitenedResponses, seen_hz: Sequence[float]
) -> Iterator[Candidate]:
    """The frequency of a mode of the model that the data do not have and the sensors would see, as exactly as the
    median of those they have."""
    n_mode = problem.matching.n_mode
    solution = problem.model.solve(laplace.theta, n_mode, derivatives=True)
    taken = {int(i) for i in problem._assign(solution.frequency_hz[None], solution.shape[None])[0][0]}
    highest = max(taken)
    seen = np.array(seen_hz, float)
    rows = np.unique(np.concatenate([group.rows for group in problem.groups]))
    hidden = moves_little(solution.shape[rows])
    share = float(np.median([s / f for g in problem.groups for s, f in
                             zip(g.frequency_std_hz, g.frequency_hz, strict=True)]))
    unknown = getattr(problem.model, "uncertainty", None)
    change = None
    if problem.error_sources and unknown is not None:
        change = unknown.changes(laplace.theta, min(n_mode, highest + 2), ()).frequency_derivative
        change = change * np.array([s.std for s in problem.error_sources])
    for i in range(min(n_mode, highest + 2)):
        f = solution.frequency_hz[i]
        if i in taken or hidden[i] or np.any(np.abs(np.log(seen / f)) < NEAR):
            continue
        factor = np.zeros((1, now.factor.shape[1]))
        if change is not None:
            factor[:, : change.shape[1]] = change[i : i + 1] / (share * f)
        slope = solution.both_derivatives[0][i : i + 1] / (share * f)
        yield Candidate(what=f"identify the model's mode at {f:.3g} Hz (its frequency)",
                        covariance=now.with_rows(slope, factor).covariance())
