"""What all sets of a structure have in common: the sources of the model's error and its discrepancy.

Residuals of set s about its centre are r_s = J_s d + B_s e + v_s + eps_s: e, drawn once per structure, are the sources
and the part of the discrepancy that every set repeats, v_s is the part that is new in each set, eps_s identification.
Stacked over the sets the covariance is a block of ones times the common part plus each set's own, and e is integrated
out once over all of them (Woodbury): forty-eight sets then narrow what is new in each by seven and the model's error
not at all. Inner products of r, J and B, summed over the sets, hold all of it, so that a further scale of the common
part costs one small factorisation whatever the number of sets.

How much is common and how much new are two half-Student scales for frequencies and two for shapes: scatter of residuals
over sets shows what is new, what is left of their mean shows what is common (Kennedy & O'Hagan 2001; Kaipio & Somersalo
2005). Nodes over all of them are averaged over, not chosen from.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg, special

from probupdate.errors import InputError
from probupdate.model.uncertainty import ResponseError, marginal_root
from probupdate.runtime.arrays import frozen_array
from probupdate.updating.discrepancy import LEAST_SHARE, MOST, SPAN, hyper_scales, log_half_student
from probupdate.updating.hierarchical import Coordinates, Population, SetLikelihoods
from probupdate.updating.problem import Problem
from probupdate.updating.responses import SHAPE_FACTOR

# what stands for the prior of u: mean (n_param,) and precision (n_param, n_param)
GaussianPrior = tuple[np.ndarray, np.ndarray]
# scales looked at along each axis, one after another, then of a grid about where the posterior is: of what is new, each
# of which sums over the sets again, and of what is shared
N_SCAN, SWEEPS, N_GRID, ROUNDS = 9, 2, (5, 5, 9, 9), 2


@dataclass(frozen=True, kw_only=True)
class Scales:
    """Shares of each frequency and of each shape's largest component that the model misses: `new` in each set, `shared`
    by all; log_weight is the hyper-prior's."""

    new: tuple[float, float]
    shared: tuple[float, float]
    log_weight: float = 0.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Inner:
    """Inner products of whitened (r, J, B) summed over some sets, (1 + n_param + n_common) squared, about one `middle`
    (n_param,) in u; constant: ln of the density at no misfit."""

    middle: np.ndarray
    products: np.ndarray
    constant: float

    def known(self, e: np.ndarray) -> Inner:
        """With what is common taken as known, e (n_common,) in its own units."""
        n = len(self.middle) + 1
        turn = np.zeros((len(self.products), n))
        turn[:n] = np.eye(n)
        turn[n:, 0] = -e
        return Inner(middle=self.middle, products=turn.T @ self.products @ turn, constant=self.constant)

    def without_sources(self, n_source: int) -> Inner:
        """With the first of e, each standard normal, integrated out."""
        if not n_source:
            return self
        n = len(self.middle) + 1
        known, rest = np.arange(n, n + n_source), np.r_[:n, n + n_source : len(self.products)]
        inner = np.eye(n_source) + self.products[np.ix_(known, known)]
        root = linalg.cholesky(inner, lower=True)
        across = linalg.solve_triangular(root, self.products[np.ix_(known, rest)], lower=True)
        return Inner(middle=self.middle, products=self.products[np.ix_(rest, rest)] - across.T @ across,
                     constant=self.constant - float(np.sum(np.log(np.diag(root)))))

    def reduced(self, common_std: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """ln p = value + gradient d - d^T precision d / 2 of one d for all, with e ~ N(0, common_std^2) integrated out:
        (n,), (n, n_param), (n, n_param, n_param) of n common_std (n, n_common)."""
        n = len(self.middle) + 1
        inner = np.eye(common_std.shape[1]) + common_std[:, :, None] * self.products[n:, n:] * common_std[:, None, :]
        across = common_std[:, :, None] * self.products[n:, :n]
        left = self.products[:n, :n] - np.swapaxes(across, 1, 2) @ np.linalg.solve(inner, across)
        value = self.constant - 0.5 * left[:, 0, 0] - 0.5 * np.linalg.slogdet(inner)[1]
        return value, left[:, 1:, 0], left[:, 1:, 1:]

    def evidence(self, common_std: np.ndarray, prior: GaussianPrior) -> np.ndarray:
        """ln of the integral over d too (n,), with a Gaussian for its prior, + const."""
        value, gradient, precision = self.reduced(common_std)
        return value + integrated(gradient, precision, self.middle, prior)


def integrated(gradient, precision, middle: np.ndarray, prior: GaussianPrior) -> np.ndarray:
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
    of shapes; form (n_common,): what the model misses by its form, in the same units as the scales."""

    problems: tuple[Problem, ...]
    centre: np.ndarray
    residual: tuple[np.ndarray, ...]
    slope: tuple[np.ndarray, ...]
    effect: tuple[np.ndarray, ...]
    kind: np.ndarray
    form: np.ndarray

    @cached_property
    def middle(self) -> np.ndarray:
        return self.centre.mean(axis=0)

    @property
    def n_source(self) -> int:
        return int(np.sum(self.kind == 0))

    def common_std(self, shared: np.ndarray) -> np.ndarray:
        """Of each common unknown (n, n_common), of shared scales (n, 2)."""
        scale = np.column_stack([np.ones(len(shared)), shared])[:, self.kind]
        return np.where(self.kind == 0, 1.0, np.hypot(scale, self.form))

    def each(self, new: tuple[float, float], tau: np.ndarray | None = None) -> list[Inner]:
        """Of every set; with `tau` (n_param,) its own parameters, scattered by that, are integrated out too."""
        found = []
        for problem, centre, r, J, B in zip(self.problems, self.centre, self.residual, self.slope, self.effect,
                                            strict=True):
            noise = problem.noise_alone(new)
            columns = np.column_stack([r - J @ (self.middle - centre), J, B])
            root, lost = noise.noise_root, 0.0
            if tau is not None:
                root, lost = marginal_root(root, J * tau)
            white = root @ columns if noise.root is not None or tau is not None else columns / noise.std[:, None]
            left = noise.taken_by_alignment - problem.taken_by_alignment
            found.append(Inner(middle=self.middle, products=white.T @ white,
                               constant=noise.log_constant + left - 0.5 * lost))
        return found

    @cached_property
    def _stacked(self) -> tuple[np.ndarray, ...]:
        """Rows r, J, B of all sets; of each row its own variance, the least, what a discrepancy of one does, its kind,
        and how much it counts; of independent responses."""
        rows, own = [], []
        for problem, centre, r, J, B in zip(self.problems, self.centre, self.residual, self.slope, self.effect,
                                            strict=True):
            noise = problem.noise_alone((0.0, 0.0))
            form = noise.form_std if noise.form else np.zeros(len(r))
            variance, least = noise.own_variance
            rows.append(np.column_stack([r - J @ (self.middle - centre), J, B]))
            own.append(np.column_stack([variance + form**2, least, noise.unit_discrepancy,
                                        np.arange(len(r)) >= noise.n_frequency, noise.counted]))
        return np.concatenate(rows), *np.concatenate(own).T

    def summed(self, new: tuple[float, float]) -> Inner:
        """Of all sets: as `total(each(new))`, at once where responses are independent."""
        first = self.problems[0]
        if first.weights.covariance or first.weights.shapes == "mac":
            return total(self.each(new))
        rows, own, least, unit, kind, counted = self._stacked
        std = np.sqrt(np.maximum(own + (np.where(kind > 0, new[1], new[0]) * unit) ** 2, least))
        white = rows / std[:, None]
        return Inner(middle=self.middle, products=white.T @ white,
                     constant=-float(counted @ (np.log(std) + 0.5 * np.log(2 * np.pi)))
                     - sum(p.taken_by_alignment for p in self.problems))

    def likelihoods(self, inner: Inner, scales: Sequence[Scales]) -> Averaged:
        """Of the sets summed in `inner` at one common u, averaged over the scales."""
        std = self.common_std(np.array([s.shared for s in scales]))[:, self.n_source :]
        return averaged(inner.middle, [s.log_weight for s in scales],
                        *inner.without_sources(self.n_source).reduced(std))

    def expected(self, new, shared: Sequence[Scales], tau: np.ndarray, prior: GaussianPrior) -> np.ndarray:
        """Posterior mean of what is common (n_common,), each set's own parameters scattered by tau."""
        found = self._common_posterior(new, shared, tau, prior)
        return sum(share * std * e for share, std, e, *_ in found)

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

    def lent(
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
            held = inner.known(expected).evidence(nothing, prior)[0]
            return float(held - special.logsumexp(weight + inner.evidence(std, prior)))

        rest = [Inner(middle=self.middle, products=whole.products - one.products,
                      constant=whole.constant - one.constant) for one in each]
        return gap(whole) - np.array([gap(one) for one in rest])

    def without(self, expected: np.ndarray, new: tuple[float, float]) -> list[Problem]:
        """Each set with what is new in it alone, and what is common (n_common,) taken as known."""
        found = []
        for problem, B in zip(self.problems, self.effect, strict=True):
            noise = problem.noise_alone(new)
            error = noise.error or ResponseError(sources=(), factor=np.zeros((len(B), 0)), mean=np.zeros(len(B)),
                                                 theta=noise.parameters.initial)
            found.append(replace(noise, error=replace(error, mean=frozen_array(error.mean + B @ expected))))
        return found

    def widened(
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
class Averaged:
    """ln p of some sets at one common u: ln of the weighted mean over nodes of exp(value + gradient d - d^T precision
    d / 2), d = u - middle; log_weight, value (n_node,), gradient (n_node, n_param), precision (n_node, n_param,
    n_param)."""

    middle: np.ndarray
    log_weight: np.ndarray
    value: np.ndarray
    gradient: np.ndarray
    precision: np.ndarray

    def at(self, u: np.ndarray) -> np.ndarray:
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
        value = self.log_weight + self.value + integrated(self.gradient, self.precision, self.middle, prior)
        return np.exp(value - special.logsumexp(value))


def averaged(middle, log_weight, value, gradient, precision) -> Averaged:
    return Averaged(middle=frozen_array(middle), log_weight=frozen_array(log_weight), value=frozen_array(value),
                    gradient=frozen_array(gradient), precision=frozen_array(precision))


def joined(parts: Sequence[Averaged]) -> Averaged:
    """All nodes of several."""
    return averaged(parts[0].middle, *(np.concatenate([getattr(p, name) for p in parts]) for name in
                                       ("log_weight", "value", "gradient", "precision")))


def total(parts: Sequence[Inner]) -> Inner:
    return Inner(middle=parts[0].middle, products=np.sum([p.products for p in parts], axis=0),
                 constant=sum(p.constant for p in parts))


def shared_error(problems: Sequence[Problem], theta: np.ndarray, coordinates: Coordinates) -> SharedError:
    """Of the problems of several sets, about theta (n_set, n_param)."""
    names = {tuple(s.name for s in p.error_sources) for p in problems}
    if len(names) > 1:
        raise InputError("sets", "state different sources of the model's error", "give all sets one model")
    residual, slope = [], []
    for problem, point in zip(problems, theta, strict=True):
        response, sensitivity = problem.sensitivity(point)
        residual.append(problem.measured - response)
        slope.append(sensitivity * coordinates.rate(point))
    effect, kind, form = _common_discrepancy(problems)
    n_source = problems[0].factor.shape[1]
    return SharedError(
        problems=tuple(problems), centre=frozen_array(coordinates.to(np.asarray(theta))), residual=tuple(residual),
        slope=tuple(slope), effect=tuple(np.column_stack([p.factor, e]) for p, e in zip(problems, effect, strict=True)),
        kind=np.concatenate([np.zeros(n_source, int), kind]), form=np.concatenate([np.zeros(n_source), form]))


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


@dataclass(frozen=True, eq=False, kw_only=True)
class LearntScales:
    """Nodes over what is new in each set and what is shared, where the posterior has its mass; `new` stands for the
    first where one number is wanted, `shared` are nodes over the second alone, at that. `ends`: 5 and 95 % of each
    axis, new and shared, of frequencies and of shapes."""

    nodes: tuple[Scales, ...]
    new: tuple[float, float]
    shared: tuple[Scales, ...]
    ends: tuple[tuple[float, float], ...]
    learnt: bool


def learn_scales(error: SharedError, prior: GaussianPrior, tau: np.ndarray | None = None) -> LearntScales:
    """Scales of the discrepancy of several sets at one common u, or each at its own, scattered by `tau` (n_param,)."""
    weights = error.problems[0].weights
    if not weights.scales:
        new, shared = (tuple(float(np.sqrt(part) * x) for x in weights.discrepancies)
                       for part in (1 - weights.shared, weights.shared))
        one = Scales(new=new, shared=shared)
        return LearntScales(nodes=(one,), new=new, shared=(one,), learnt=False,
                            ends=tuple((x, x) for x in (*new, *shared)))
    grid = _Grid(error, prior, tau)
    axes = grid.scanned()
    for _ in range(ROUNDS):
        value = grid.values(axes)
        axes = [_about(axis, special.logsumexp(value, axis=_others(k)), N_GRID[k]) for k, axis in enumerate(axes)]
    value = grid.values(axes)
    share = np.exp(value - special.logsumexp(value))
    marginal = [share.sum(axis=_others(k)) for k in range(4)]
    new = tuple(float(np.exp(m @ np.log(axis))) for m, axis in zip(marginal[:2], axes[:2], strict=True))
    nodes = [Scales(new=(axes[0][a], axes[1][b]), shared=(axes[2][c], axes[3][d]),
                    log_weight=float(grid.log_prior(axes)[a, b, c, d]))
             for a, b, c, d in np.argwhere(share > LEAST_SHARE * share.max())]
    along = share.sum(axis=(0, 1))
    shared = [Scales(new=new, shared=(axes[2][c], axes[3][d]), log_weight=float(grid.log_prior(axes)[0, 0, c, d]))
              for c, d in np.argwhere(along > LEAST_SHARE * along.max())]
    ends = tuple(tuple(float(np.exp(np.interp(q, np.cumsum(m) - 0.5 * m, np.log(axis)))) for q in (0.05, 0.95))
                 for m, axis in zip(marginal, axes, strict=True))
    return LearntScales(nodes=tuple(nodes), new=new, shared=tuple(shared), ends=ends, learnt=True)


def _others(axis: int) -> tuple[int, ...]:
    return tuple(k for k in range(4) if k != axis)


def _about(axis: np.ndarray, log_share: np.ndarray, number: int) -> np.ndarray:
    """`number` scales over where the marginal has its mass, a step beyond to either side."""
    if len(axis) == 1:
        return axis
    inside = np.flatnonzero(log_share > log_share.max() + np.log(10 * LEAST_SHARE))
    return np.geomspace(axis[max(inside[0] - 1, 0)], axis[min(inside[-1] + 1, len(axis) - 1)], number)


class _Grid:
    """ln posterior of scales over four axes: new of frequencies and shapes, shared of frequencies and shapes."""

    def __init__(self, error: SharedError, prior: GaussianPrior, tau: np.ndarray | None):
        self.error, self.prior, self.tau = error, prior, tau
        hyper = hyper_scales(error.problems[0].weights)
        # both parts together are as large a priori as what one set misses
        self.hyper = tuple(h / np.sqrt(2) for h in (*hyper, *hyper))
        self.present = [bool(np.any(error.kind == k)) for k in (1, 2)] * 2
        self.kept: dict[tuple[float, float], Inner] = {}

    def evidence(self, new: tuple[float, float], shared: np.ndarray) -> np.ndarray:
        """(n,) of shared scales (n, 2)."""
        if new not in self.kept:
            every = self.error.summed(new) if self.tau is None else total(self.error.each(new, self.tau))
            self.kept[new] = every.without_sources(self.error.n_source)
        return self.kept[new].evidence(self.error.common_std(shared)[:, self.error.n_source :], self.prior)

    def values(self, axes: Sequence[np.ndarray]) -> np.ndarray:
        """ln of evidence, hyper-prior and steps over the grid of the axes."""
        shared = np.stack(np.meshgrid(*axes[2:], indexing="ij"), axis=-1)
        found = [[self.evidence((float(a), float(b)), shared.reshape(-1, 2)) for b in axes[1]] for a in axes[0]]
        return np.array(found).reshape([len(axis) for axis in axes]) + self.log_prior(axes)

    def scanned(self) -> list[np.ndarray]:
        """Where each scale's conditional has its mass, the others at their best so far."""
        tops = (MOST, SHAPE_FACTOR * MOST) * 2
        full = [np.geomspace(SPAN * h, top, N_SCAN) if there else np.array([h])
                for h, top, there in zip(self.hyper, tops, self.present, strict=True)]
        at, axes = [np.array([h]) for h in self.hyper], list(full)
        for _ in range(SWEEPS):
            for k, axis in enumerate(full):
                if len(axis) > 1:
                    found = self.values([*at[:k], axis, *at[k + 1 :]]).ravel()
                    at[k], axes[k] = axis[[np.argmax(found)]], _about(axis, found, N_GRID[k])
        return axes

    def log_prior(self, axes: Sequence[np.ndarray]) -> np.ndarray:
        """ln of hyper-prior times steps over the grid; the step of an axis of one number counts nothing."""
        value = np.zeros([len(axis) for axis in axes])
        for k, (axis, h) in enumerate(zip(axes, self.hyper, strict=True)):
            step = 0.0 if len(axis) == 1 else np.log(np.log(axis[1] / axis[0]))
            own = step + log_half_student(axis, h)
            value = value + own.reshape([-1 if j == k else 1 for j in range(4)])
        return value
