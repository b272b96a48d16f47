"""What all sets of a structure have in common: the sources of the model's error and its discrepancy.

Residuals of set s about its centre are r_s = J_s d + B_s e + v_s + eps_s: e, drawn once per structure, are the sources
and the part of the discrepancy that every set repeats, v_s is the part that is new in each set, eps_s identification.
Stacked over the sets the covariance is a block of ones times the common part plus each set's own, and e is integrated
out once over all of them (Woodbury): forty-eight sets then narrow what is new in each by seven and the model's error
not at all. Inner products of r, J and B, summed over the sets, hold all of it, so that a further scale of the common
part costs one small factorisation whatever the number of sets.

What is common of frequencies and of components of shapes each has its scale, and so has what mixes modes
(`problem.mix_modes`), which goes together over the structure; how large they are is learnt in `scales`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy import special

from probupdate.errors import InputError
from probupdate.model.uncertainty import ResponseError, marginal_root
from probupdate.runtime.arrays import frozen_array
from probupdate.updating.problem import Problem
from probupdate.updating.set_likelihoods import Coordinates, SetLikelihoods
from probupdate.updating.solved_once import solved_once

if TYPE_CHECKING:
    from probupdate.updating.hierarchical import Population

# what stands for the prior of u: mean (n_param,) and precision (n_param, n_param)
GaussianPrior = tuple[np.ndarray, np.ndarray]
# of a common unknown: a source, the discrepancy of a frequency or of a component of a shape, a mixing of two modes
SOURCE, FREQUENCY, COMPONENT, MIXING = range(4)


@dataclass(frozen=True, kw_only=True)
class Scales:
    """Shares of each frequency and of each shape's largest component that the model misses: `new` in each set, `shared`
    by all, which holds the local error of stiffness that mixes modes too; log_weight is the hyper-prior's."""

    new: tuple[float, float]
    shared: tuple[float, float, float]
    log_weight: float = 0.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Inner:
    """Inner products of whitened (r, J, B) summed over some sets, (1 + n_param + n_common) squared, about one `middle`
    (n_param,) in u; constant: ln of the density at no misfit; kind (n_common,) as of `SharedError`."""

    middle: np.ndarray
    products: np.ndarray
    constant: float
    kind: np.ndarray

    def given_error(self, e: np.ndarray) -> Inner:
        """With what is common taken as known, e (n_common,) in its own units."""
        n = len(self.middle) + 1
        turn = np.zeros((len(self.products), n))
        turn[:n] = np.eye(n)
        turn[n:, 0] = -e
        return replace(self, products=turn.T @ self.products @ turn, kind=self.kind[:0])

    def reduce(self, common_std: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """ln p = value + gradient d - d^T precision d / 2 of one d for all, with e ~ N(0, common_std^2) integrated out:
        (n,), (n, n_param), (n, n_param, n_param) of n common_std (n, n_common).

        What no other response shares, the discrepancies of independent ones, goes first, one by one; then sources, once
        for all nodes that differ in mixing alone.
        """
        n, kind = len(self.middle) + 1, self.kind
        own, source, mixing = (np.flatnonzero(k) for k in (
            (kind == FREQUENCY) | (kind == COMPONENT), kind == SOURCE, kind == MIXING))
        before = np.r_[source, own]
        unique, which = _unique_rows(common_std[:, before])
        rest, log_det = self._without_own(own, np.r_[:n, n + source, n + mixing], unique[:, len(source) :])
        still = np.r_[:n, n + len(source) : rest.shape[1]]
        rest, more = _eliminate_unknowns(rest, still, np.arange(n, n + len(source)), unique[:, : len(source)])
        left, most = _without_mixing(rest, n, which, common_std[:, mixing[:1]])
        value = self.constant - 0.5 * left[:, 0, 0] - 0.5 * ((log_det + more)[which] + most)
        return value, left[:, 1:, 0], left[:, 1:, 1:]

    def _without_own(self, own: np.ndarray, keep: np.ndarray, std: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Products of `keep` with the discrepancies `own` integrated out, of std (n, n_own), and ln det."""
        rows = len(self.middle) + 1 + own
        inner = self.products[np.ix_(rows, rows)]
        if np.any(inner != np.diag(np.diag(inner))):
            order = np.r_[keep, rows]
            whole = np.broadcast_to(self.products[np.ix_(order, order)], (len(std), len(order), len(order)))
            return _eliminate_unknowns(whole, np.arange(len(keep)), np.arange(len(keep), len(order)), std)
        grown = 1 + std**2 * np.diag(inner)
        across = self.products[np.ix_(rows, keep)]
        taken = np.array([(across.T * weight) @ across for weight in std**2 / grown])
        return self.products[np.ix_(keep, keep)] - taken, np.sum(np.log(grown), axis=1)

    def evidence(self, common_std: np.ndarray, prior: GaussianPrior) -> np.ndarray:
        """ln of the integral over d too (n,), with a Gaussian for its prior, + const."""
        value, gradient, precision = self.reduce(common_std)
        return value + log_gaussian_integral(gradient, precision, self.middle, prior)


def _without_mixing(products: np.ndarray, n: int, which: np.ndarray, size: np.ndarray):
    """As `_eliminate_unknowns`, of all but the first n unknowns of products (n_unique, k, k), all of one size (n, 1),
    each with the products that `which` (n,) names: one decomposition for any number of sizes."""
    left = products[:, :n, :n][which]
    if not size.shape[1]:
        return left, np.zeros(len(which))
    value, vector = np.linalg.eigh(products[:, n:, n:])
    across = (np.swapaxes(vector, 1, 2) @ products[:, n:, :n])[which]
    grown = 1 + size**2 * np.maximum(value, 0.0)[which]
    taken = np.swapaxes(across, 1, 2) @ (across * (size**2 / grown)[:, :, None])
    return left - taken, np.sum(np.log(grown), axis=1)


def _unique_rows(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Different rows, and which of them each is."""
    if not rows.shape[1]:
        return rows[:1], np.zeros(len(rows), int)
    found, which = np.unique(rows, axis=0, return_inverse=True)
    return found, which.ravel()


def _eliminate_unknowns(
    products: np.ndarray, keep: np.ndarray, gone: np.ndarray, std: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """products (n, k, k) of `keep` with unknowns `gone`, of std (n, n_gone), integrated out, and ln det (n,)."""
    if not len(gone):
        return products[:, keep][:, :, keep], np.zeros(len(products))
    across = std[:, :, None] * products[:, gone][:, :, keep]
    inner = np.eye(len(gone)) + std[:, :, None] * products[:, gone][:, :, gone] * std[:, None, :]
    left = products[:, keep][:, :, keep] - np.swapaxes(across, 1, 2) @ np.linalg.solve(inner, across)
    return left, np.linalg.slogdet(inner)[1]


def log_gaussian_integral(gradient, precision, middle: np.ndarray, prior: GaussianPrior) -> np.ndarray:
    """ln of the integral of exp(gradient d - d^T precision d / 2) over d = u - middle, u with a Gaussian prior, up to a
    constant: (n,) of gradient (n, n_param), precision (n, n_param, n_param)."""
    off = prior[0] - middle
    whole, pull = precision + prior[1], gradient + prior[1] @ off
    step = np.linalg.solve(whole, pull[..., None])[..., 0]
    return 0.5 * np.sum(pull * step, axis=1) - 0.5 * off @ prior[1] @ off - 0.5 * np.linalg.slogdet(whole)[1]


@dataclass(frozen=True, eq=False, kw_only=True)
class SharedError:
    """Of each set about its centre (n_set, n_param) in u: residual r (n,), slope J (n, n_param), effect B (n, n_common)
    of the sources and of the common discrepancy; `kind` (n_common,): 0 a source, 1 and 2 discrepancy of frequencies and
    of shapes, 3 mixing of modes; form (n_common,): what the model misses by its form, in the same units as the scales.
    alone: of one set, whose discrepancy of frequencies and components is all `new`."""

    problems: tuple[Problem, ...]
    centre: np.ndarray
    residual: tuple[np.ndarray, ...]
    slope: tuple[np.ndarray, ...]
    effect: tuple[np.ndarray, ...]
    kind: np.ndarray
    form: np.ndarray
    alone: bool = False

    @cached_property
    def middle(self) -> np.ndarray:
        return self.centre.mean(axis=0)

    def common_std(self, shared: np.ndarray) -> np.ndarray:
        """Of each common unknown (n, n_common), of shared scales (n, 3)."""
        scale = np.column_stack([np.ones(len(shared)), shared])[:, self.kind]
        return np.where(self.kind == SOURCE, 1.0, np.hypot(scale, self.form))

    def each(self, new: tuple[float, float], tau: np.ndarray | None = None) -> list[Inner]:
        """Of every set; with `tau` (n_param,) its own parameters, scattered by that, are integrated out too."""
        found = []
        for problem, centre, r, J, B in zip(self.problems, self.centre, self.residual, self.slope, self.effect,
                                            strict=True):
            noise = problem.noise_alone(new, alone=self.alone)
            columns = np.column_stack([r - J @ (self.middle - centre), J, B])
            root, lost = noise.noise_root, 0.0
            if tau is not None:
                root, lost = marginal_root(root, J * tau)
            diagonal = tau is None and not noise.weights.covariance
            white = columns / noise.std[:, None] if diagonal else root @ columns
            left = noise.taken_by_alignment - problem.taken_by_alignment
            found.append(Inner(middle=self.middle, products=white.T @ white, kind=self.kind,
                               constant=noise.log_constant + left - 0.5 * lost))
        return found

    @cached_property
    def _stacked_rows(self) -> tuple[np.ndarray, ...]:
        """Rows r, J, B of all sets; of each row its own variance, the least, what a discrepancy of one does, its kind,
        and how much it counts; of independent responses."""
        rows, own = [], []
        for problem, centre, r, J, B in zip(self.problems, self.centre, self.residual, self.slope, self.effect,
                                            strict=True):
            noise = problem.noise_alone((0.0, 0.0), alone=self.alone)
            form = noise.form_std if noise.form else np.zeros(len(r))
            variance, least = noise.own_variance
            rows.append(np.column_stack([r - J @ (self.middle - centre), J, B]))
            own.append(np.column_stack([variance + form**2, least, noise.unit_discrepancy,
                                        np.arange(len(r)) >= noise.n_frequency, noise.kept_shares]))
        return np.concatenate(rows), *np.concatenate(own).T

    def sum_sets(self, new: tuple[float, float]) -> Inner:
        """Of all sets: as `total(each(new))`, at once where responses are independent."""
        first = self.problems[0]
        if first.weights.covariance or first.weights.shapes == "mac":
            return total(self.each(new))
        rows, own, least, unit, kind, counted = self._stacked_rows
        std = np.sqrt(np.maximum(own + (np.where(kind > 0, new[1], new[0]) * unit) ** 2, least))
        white = rows / std[:, None]
        return Inner(middle=self.middle, products=white.T @ white, kind=self.kind,
                     constant=-float(counted @ (np.log(std) + 0.5 * np.log(2 * np.pi)))
                     - sum(p.taken_by_alignment for p in self.problems))

    def likelihoods(self, inner: Inner, scales: Sequence[Scales]) -> AveragedDensity:
        """Of the sets summed in `inner` at one common u, averaged over the scales."""
        std = self.common_std(np.array([s.shared for s in scales]))
        return average_density(inner.middle, [s.log_weight for s in scales], *inner.reduce(std))

    def expected_common(self, new, shared: Sequence[Scales], tau: np.ndarray, prior: GaussianPrior) -> np.ndarray:
        """Posterior mean of what is common (n_common,), each set's own parameters scattered by tau."""
        found = self._common_posterior(new, shared, tau, prior)
        return np.sum([share * std * e for share, std, e, *_ in found], axis=0)

    def _common_posterior(self, new, shared: Sequence[Scales], tau: np.ndarray, prior: GaussianPrior):
        """Of each node: its probability, standard deviations of what is common a priori, mean and covariance of e in
        these, and the shift of the population's mean per unit of it (n_param, n_common)."""
        inner = total(self.each(new, tau))
        n, G = len(self.middle) + 1, inner.products
        each = self.common_std(np.array([s.shared for s in shared]))
        value = np.array([s.log_weight for s in shared]) + inner.evidence(each, prior)
        found = []
        for share, std in zip(np.exp(value - special.logsumexp(value)), each, strict=True):
            K, C = G[1:n, 1:n] + prior[1], G[1:n, n:] * std
            N = np.eye(len(std)) + std[:, None] * G[n:, n:] * std
            shift = -np.linalg.solve(K, C)
            covariance = np.linalg.inv(N + C.T @ shift)
            pull = G[1:n, 0] + prior[1] @ (prior[0] - self.middle)
            mean = covariance @ (std * G[n:, 0] + shift.T @ pull)
            found.append((share, std, mean, 0.5 * (covariance + covariance.T), shift))
        return found

    def optimism(
        self, expected: np.ndarray, new: tuple[float, float], shared: Sequence[Scales], tau: np.ndarray,
        prior: GaussianPrior,
    ) -> np.ndarray:
        """How much too high ln p of each set given the others is (n_set,) where what is common is taken as `expected`
        from all sets, the one left out among them."""
        each = self.each(new, tau)
        whole = total(each)
        std = self.common_std(np.array([s.shared for s in shared]))
        weight = np.array([s.log_weight for s in shared])
        nothing = np.zeros((1, 0))

        def gap(inner: Inner) -> float:
            held = inner.given_error(expected).evidence(nothing, prior)[0]
            return float(held - special.logsumexp(weight + inner.evidence(std, prior)))

        rest = [replace(whole, products=whole.products - one.products, constant=whole.constant - one.constant)
                for one in each]
        return gap(whole) - np.array([gap(one) for one in rest])

    def conditional_problems(self, expected: np.ndarray, new: tuple[float, float]) -> list[Problem]:
        """Each set with what is new in it alone, and what is common (n_common,) taken as known."""
        found = []
        for problem, B in zip(self.problems, self.effect, strict=True):
            noise = problem.noise_alone(new)
            error = noise.error or ResponseError(sources=(), factor=np.zeros((len(B), 0)), mean=np.zeros(len(B)),
                                                 theta=noise.parameters.initial)
            found.append(replace(noise, error=replace(error, mean=frozen_array(error.mean + B @ expected))))
        return found

    def widen(
        self, population: Population, expected: np.ndarray, new: tuple[float, float], shared: Sequence[Scales],
        prior: GaussianPrior, rng: np.random.Generator,
    ) -> Population:
        """The population of sets `without` what is `expected`, with its mean where what is common allows it: that moves
        all sets alike, so that the scatter stays. Each draw's mean is shifted by what a draw of e, given the data, does
        to it at the population's median tau."""
        found = self._common_posterior(new, shared, np.median(population.tau, axis=0), prior)
        chosen = rng.choice(len(found), size=len(population.mean), p=[node[0] for node in found])
        mean = np.array(population.mean)
        for number in np.unique(chosen):
            _, std, middle, covariance, shift = found[number]
            rows = np.flatnonzero(chosen == number)
            root = np.linalg.cholesky(covariance)
            known = np.divide(expected, std, out=np.zeros_like(std), where=std > 0)
            e = middle - known + rng.standard_normal((len(rows), len(std))) @ root.T
            mean[rows] += e @ shift.T
        return replace(population, mean=frozen_array(mean))


@dataclass(frozen=True, eq=False, kw_only=True)
class AveragedDensity:
    """ln p of some sets at one common u: ln of the weighted mean over nodes of exp(value + gradient d - d^T precision
    d / 2), d = u - middle; log_weight, value (n_node,), gradient (n_node, n_param), precision (n_node, n_param,
    n_param)."""

    middle: np.ndarray
    log_weight: np.ndarray
    value: np.ndarray
    gradient: np.ndarray
    precision: np.ndarray

    def evaluate(self, u: np.ndarray) -> np.ndarray:
        """(n,) of u (n, n_param)."""
        d = u - self.middle
        i, j = np.triu_indices(d.shape[1])
        quadratic = -self.precision[:, i, j] * np.where(i == j, 0.5, 1.0)
        each = d @ self.gradient.T + (d[:, i] * d[:, j]) @ quadratic.T + self.value + self.log_weight
        return special.logsumexp(each, axis=1)

    def node(self, number: int) -> SetLikelihoods:
        """One of them, as the likelihood of a set."""
        return SetLikelihoods(
            ids=("all",), centre=frozen_array(self.middle[None]), value=self.value[number : number + 1],
            gradient=self.gradient[number : number + 1], precision=self.precision[number : number + 1])

    def shares(self, prior: GaussianPrior) -> np.ndarray:
        """Posterior probability of each node (n_node,), with a Gaussian for the prior of u."""
        value = self.log_weight + self.value + log_gaussian_integral(self.gradient, self.precision, self.middle, prior)
        return np.exp(value - special.logsumexp(value))


def average_density(middle, log_weight, value, gradient, precision) -> AveragedDensity:
    return AveragedDensity(middle=frozen_array(middle), log_weight=frozen_array(log_weight), value=frozen_array(value),
                           gradient=frozen_array(gradient), precision=frozen_array(precision))


def join_densities(parts: Sequence[AveragedDensity]) -> AveragedDensity:
    """All nodes of several."""
    return average_density(parts[0].middle, *(np.concatenate([getattr(p, name) for p in parts]) for name in
                                              ("log_weight", "value", "gradient", "precision")))


def total(parts: Sequence[Inner]) -> Inner:
    return replace(parts[0], products=np.sum([p.products for p in parts], axis=0),
                   constant=sum(p.constant for p in parts))


def shared_error(
    problems: Sequence[Problem], theta: np.ndarray, coordinates: Coordinates, *, alone: bool = False
) -> SharedError:
    """Of the problems of several sets, or of one alone, about theta (n_set, n_param)."""
    names = {tuple(s.name for s in p.error_sources) for p in problems}
    if len(names) > 1:
        raise InputError("sets", "state different sources of the model's error", "give all sets one model")
    residual, slope = [], []
    for problem, point in zip(solved_once(problems), theta, strict=True):
        response, sensitivity = problem.sensitivity(point)
        residual.append(problem.measured - response)
        slope.append(sensitivity * coordinates.rate(point))
    if alone:
        effect, kind, form = [np.zeros((p.measured.size, 0)) for p in problems], np.zeros(0, int), np.zeros(0)
    else:
        effect, kind, form = _common_discrepancy(problems)
    mixing = _common_mixing(problems)
    n_source, n_pair = problems[0].factor.shape[1], mixing[0].shape[1]
    return SharedError(
        problems=tuple(problems), centre=frozen_array(coordinates.transform(np.asarray(theta))),
        residual=tuple(residual),
        slope=tuple(slope), effect=tuple(np.column_stack([p.factor, e, m]) for p, e, m in
                                         zip(problems, effect, mixing, strict=True)),
        kind=np.concatenate([np.full(n_source, SOURCE), kind, np.full(n_pair, MIXING)]),
        form=np.concatenate([np.zeros(n_source), form, np.zeros(n_pair)]), alone=alone)


def _common_discrepancy(problems: Sequence[Problem]) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """How each set's responses (n, n_common) follow from one discrepancy of each frequency and of each component of a
    shape, in the first set's scale and turn of the shapes that has them; kind and form (n_common,). Modes and channels
    are known by their names: sets of several turbines may number them otherwise."""
    keys: dict[tuple, tuple[int, float, float]] = {}
    bases: dict[tuple[str, ...], dict[str, np.ndarray]] = {}
    entries = []
    for problem in problems:
        own = list(_responses(problem, bases))
        for _, key, _, unit, kind, form in own:
            keys.setdefault(key, (kind, form, unit))
        entries.append(own)
    order = {key: k for k, key in enumerate(keys)}
    effect = []
    for problem, own in zip(problems, entries, strict=True):
        B = np.zeros((problem.measured.size, len(order)))
        for row, key, size, *_ in own:
            # one unit for all sets: a share of each set's own frequency could shrink their scatter
            B[row, order[key]] += size * keys[key][2]
        effect.append(B)
    kinds = np.array([keys[key][0] for key in order], int)
    return effect, kinds, np.array([keys[key][1] for key in order])


def _common_mixing(problems: Sequence[Problem]) -> list[np.ndarray]:
    """How each set's responses (n, n_pair) follow from the mixing of two of the model's modes, one number for all."""
    keys = {pair: None for p in problems for pair in p.mixed_pairs}
    order = {pair: k for k, pair in enumerate(keys)}
    found = []
    for problem in problems:
        M = np.zeros((problem.measured.size, len(order)))
        if problem.mixing is not None:
            M[:, [order[pair] for pair in problem.mixed_pairs]] = problem.mixing
        found.append(M)
    return found


def _responses(problem: Problem, bases: dict) -> Iterator[tuple[int, tuple, float, float, int, float]]:
    """Row of a response, name of the unknown, how the row follows it, what a discrepancy of one does there, its kind
    and what is missed by form: `bases` are those of the sets before, by a group's labels, a row a channel."""
    unit = problem.unit_discrepancy
    form = np.where(unit > 0, problem.form_std / np.where(unit > 0, unit, 1.0), 0.0) * problem.form_is_shared
    labels = problem.mode_labels
    for row, mode in enumerate(problem.used):
        yield row, ("f", labels[mode]), 1.0, float(unit[row]), 1, float(form[row])
    start = problem.n_frequency
    for matched, group in zip(problem.matching.groups, problem.groups, strict=True):
        if group.shapes in ("plane", "components"):
            n, k, modes = len(group.rows), group.size, tuple(labels[m] for m in matched.measured)
            channels = [problem.model.channels[c] for c in group.rows]
            first = bases.setdefault(modes, dict(zip(channels, group.basis, strict=True)))
            both = [number for number, channel in enumerate(channels) if channel in first]
            # this set's basis is the first one turned and scaled
            turn = np.linalg.lstsq(np.array([first[channels[j]] for j in both]), group.basis[both],
                                   rcond=None)[0] if both else np.eye(k)
            for to in range(k):
                for of in range(k):
                    for number, channel in enumerate(channels):
                        row = start + to * n + number
                        yield row, ("s", modes, of, channel), float(turn[of, to]), float(unit[row]), 2, float(form[row])
        start += group.shape_response.size
