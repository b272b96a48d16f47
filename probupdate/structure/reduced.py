"""A reduced basis for an affine model: many parameter vectors a second where it was built and verified.

Proper orthogonal decomposition of full solutions in the K-energy norm; the smallest basis that answers points it has
not seen within the tolerance, verified on yet other points. A plane of symmetry splits it into blocks that do not
couple, which halves the size of what has to be solved. Outside its box the full model answers instead, row by
row, and every such row is flagged (`reduced_model`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import cycle, islice
from typing import Any

import numpy as np
from scipy import linalg, sparse
from scipy.sparse import csgraph

from probupdate.errors import ConvergenceError, InputError
from probupdate.modal.modes import plane_mac
from probupdate.runtime.progress import Progress, silent
from probupdate.structure.affine import AffineModel
from probupdate.structure.reduced_model import CHUNK, ReducedModel, ReductionReport, project

# a point that only fills the box, where a cloud of likely points is given, may be off by this much more
BOX_ALLOWANCE = 10.0
# (plane) MAC between reduced and full shapes at the channels, at every verification point
LEAST_MAC = 0.9999
# modes that move the channels less than this share of what the mode they see best does (local modes of braces) have
# no shape there that a MAC could judge; their frequencies are held to the tolerance like all others
SEEN_MOTION = 0.05
# eigenfrequencies closer than this share are judged as one plane
CLUSTER_GAP = 0.05
# shares of the tolerance within which the points that decide the size and those that verify it must lie: errors have
# a long tail, and what is promised is the tolerance at points that nobody has looked at
MARGIN = 0.2
VERIFIED = 0.5
# modes closer than this share of their frequency may have been turned into each other by the eigensolver
MIXED_GAP = 2e-3
# snapshots, scaled to unit energy, that have less than this in common belong to different families of symmetry
COUPLING = 1e-7
# share of the checks that decides which of them are far out
TYPICAL = 0.9
MAX_ROUNDS = 8
# points at which each of several models of one basis is verified, at least
FEWEST_EACH = 12
# sizes that are tried: the first, and its growth before the smallest is sought between two
FIRST_SIZE, GROWTH = 32, 1.3


def reduce_basis(model: AffineModel, **wanted: Any) -> ReducedModel:
    """`reduce_alike` of one model, with its keywords."""
    return reduce_alike([model], **wanted)[0]


def reduce_alike(
    models: Sequence[AffineModel],
    *,
    n_mode: int,
    box: tuple[np.ndarray, np.ndarray],
    frequency_tolerance: float,
    points: np.ndarray | None = None,
    n_snapshot: int = 96,
    n_verify: int = 96,
    max_size: int = 240,
    seed: int = 0,
    progress: Progress = silent,
) -> list[ReducedModel]:
    """Build and verify a basis for the lowest `n_mode` modes over box = (lower, upper), each (n_param,), of models of
    one mesh and the same parameters, such as turbines of a design whose nacelles look elsewhere: one basis for all, of
    snapshots that they take in turn, each verified at its share of the points.

    `points` (n, n_param), such as draws of an approximate posterior, are where the tolerance on the relative frequency
    error holds and half of all snapshots and checks are taken; the other half fills the box evenly, with
    BOX_ALLOWANCE times the tolerance. Without points the tolerance holds all over the box. Raises ConvergenceError,
    with the last basis as estimate, where it is not met with `max_size` vectors.
    """
    model = models[0]
    lower, upper = (np.asarray(b, float) for b in box)
    if lower.shape != (len(model.parameters),) or np.any(~np.isfinite(lower + upper)) or np.any(lower >= upper):
        raise InputError(f"{model.name}, reduced basis", "the box is empty or unbounded", "give finite lower < upper")
    extremes, likely = _split_extremes(points, len(lower))
    draw = _PointSource(lower, upper, likely, seed, frequency_tolerance)
    n_each = max(FEWEST_EACH, -(-n_verify // len(models))) if len(models) > 1 else n_verify
    K, _ = model.matrices(0.5 * (lower + upper) if points is None else np.median(points, axis=0))
    at = _snapshot_points(draw(n_snapshot)[0], extremes, lower, upper)
    snapshots = _solve_full(models, at, n_mode, "snapshots", progress)

    def projected(basis, family) -> list[ReducedModel]:
        return [project(one, basis, family, (lower, upper), n_mode, frequency_tolerance) for one in models]

    checks = [_Checks.solve(one, *draw(n_each), n_mode, "size", progress) for one in models]
    largest = projected(*_proper_orthogonal(_unmix_modes(snapshots, K), K, max_size))
    # a few points far out would cost many vectors: their own solutions join the snapshots instead
    typical = _smallest_size(largest, checks, TYPICAL)
    if typical is not None:
        snapshots += _worst_points(checks, [one.truncate(typical) for one in largest])
    for _ in range(MAX_ROUNDS):
        basis, family = _proper_orthogonal(_unmix_modes(snapshots, K), K, max_size)
        largest = projected(basis, family)
        size = _smallest_size(largest, checks, 1.0)
        if size is None:
            # what was worst joins the snapshots
            snapshots += _worst_points(checks, largest)
            continue
        reduced = [one.with_shares(c.theta)
                   for one, c in zip(projected(basis[:, :size], family[:size]), checks, strict=True)]
        final = [_Checks.solve(one, *draw(n_each), n_mode, "verification", progress) for one in models]
        reports = [c.report(one, frequency_tolerance, len(snapshots)) for c, one in zip(final, reduced, strict=True)]
        if all(reports):
            return [replace(one, report=report) for one, report in zip(reduced, reports, strict=True)]
        # points that have decided once decide the size from now on; the next verification takes new ones
        snapshots += _worst_points(final, reduced)
        checks = [c.join(other) for c, other in zip(checks, final, strict=True)]
    error, least_mac = max((c.judge(one) for c, one in zip(checks, largest, strict=True)), key=lambda e: e[0].max())
    raise ConvergenceError(
        f"{model.name}: a basis of {largest[0].basis.shape[1]} vectors leaves a relative frequency error of "
        f"{error.max():.1e} and a MAC of {least_mac:.5f} where {frequency_tolerance:.0e} is wanted; narrow the box or "
        "allow more vectors",
        largest[0],
    )


def whole_basis(model: AffineModel, n_mode: int) -> ReducedModel:
    """A small model on all of its own degrees of freedom, turned so that K is one at the initial parameters: nothing is
    left out, and many parameter vectors are solved at once."""
    K = model.matrices(model.parameters.initial)[0]
    root = np.linalg.cholesky(K.toarray() if sparse.issparse(K) else K)
    basis = np.linalg.solve(root, np.eye(len(root))).T
    everywhere = np.full(len(model.parameters), np.inf)
    return project(model, basis, np.zeros(len(root), int), (-everywhere, everywhere), n_mode, 0.0)


def _split_extremes(points, n_param):
    """The points with the least and the largest value of each parameter (n, n_param), and the others or None."""
    if points is None:
        return np.empty((0, n_param)), None
    rows = np.unique(np.concatenate([points.argmin(axis=0), points.argmax(axis=0)]))
    others = np.delete(points, rows, axis=0)
    return points[rows], others if len(others) else points


def _snapshot_points(theta: np.ndarray, extremes: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """The tails are where a basis fails: of points theta (n, n_param) every other one of the box moves to one of its
    faces, and the cloud's extremes are all taken."""
    faces = np.arange(0, len(theta), 4)
    column = (faces // 4) % len(lower)
    theta[faces, column] = np.where((faces // 4) // len(lower) % 2 == 0, lower[column], upper[column])
    return np.vstack([theta, np.clip(extremes, lower, upper)])


class _PointSource:
    """Successive points (n, n_param) and the tolerance at each (n,): even rows fill the box (scrambled Sobol), odd
    ones come from the cloud, each once before any comes again."""

    def __init__(self, lower, upper, cloud, seed, tolerance):
        from scipy.stats import qmc

        self._sobol = qmc.Sobol(len(lower), seed=np.random.default_rng(seed))
        self._order = iter(()) if cloud is None else cycle(np.random.default_rng([seed, 1]).permutation(len(cloud)))
        self._lower, self._upper, self._cloud, self._tolerance = lower, upper, cloud, tolerance

    def __call__(self, n: int) -> tuple[np.ndarray, np.ndarray]:
        # Sobol sequences want powers of two; the surplus is dropped
        unit = self._sobol.random(1 << max(0, int(n - 1).bit_length()))[:n]
        theta = self._lower + unit * (self._upper - self._lower)
        if self._cloud is None:
            return theta, np.full(n, self._tolerance)
        rows = np.arange(1, n, 2)
        likely = list(islice(self._order, len(rows)))
        theta[rows] = np.clip(self._cloud[likely], self._lower, self._upper)
        tolerance = np.full(n, BOX_ALLOWANCE * self._tolerance)
        tolerance[rows] = self._tolerance
        return theta, tolerance


def _solve_full(models, theta, n_mode, what, progress):
    """(lambda, phi) of one mode more than asked for: it shows whether the last ones are a pair cut in two; the models
    take turns."""
    solved = []
    for row, model in zip(theta, cycle(models), strict=False):
        solved.append(model.solve_full(row, n_mode + 1))
        progress(f"reduced basis: {what}", len(solved), len(theta))
    return solved


@dataclass(frozen=True, eq=False, kw_only=True)
class _Checks:
    """Points with the full model's answers there and the tolerance at each."""

    model: AffineModel
    theta: np.ndarray
    tolerance: np.ndarray
    frequency_hz: np.ndarray
    solved: list[tuple[np.ndarray, np.ndarray]]

    @classmethod
    def solve(cls, model, theta, tolerance, n_mode, what, progress):
        solved = _solve_full([model], theta, n_mode, what, progress)
        frequency = np.sqrt([value for value, _ in solved]) / (2 * np.pi)
        return cls(model=model, theta=theta, tolerance=tolerance, frequency_hz=frequency, solved=solved)

    def judge(self, reduced: ReducedModel) -> tuple[np.ndarray, float]:
        """Largest relative frequency error per point (n,), least (plane) MAC of all."""
        error, fast_shape = self._frequency_error(reduced, slice(None))
        return error, self._least_mac(reduced, fast_shape, range(len(self.theta)))

    def holds(self, reduced: ReducedModel, share: float) -> bool:
        """Within MARGIN of the tolerance at a share of the points, with LEAST_MAC at those; stops at too many
        misses."""
        allowed = int((1 - share) * len(self.theta))
        for start in range(0, len(self.theta), CHUNK):
            rows = slice(start, start + CHUNK)
            error, fast_shape = self._frequency_error(reduced, rows)
            good = error <= MARGIN * self.tolerance[rows]
            allowed -= int(np.sum(~good))
            near = start + np.flatnonzero(good)
            if allowed < 0 or self._least_mac(reduced, fast_shape[good], near) < LEAST_MAC:
                return False
        return True

    def _frequency_error(self, reduced, rows):
        fast, fast_shape = reduced._solve_inside(self.theta[rows], reduced.n_mode)
        return np.abs(fast / self.frequency_hz[rows, : reduced.n_mode] - 1).max(axis=1), fast_shape

    def _least_mac(self, reduced, fast_shape, rows):
        n_mode, worst = reduced.n_mode, 1.0
        for row, quick in zip(rows, fast_shape, strict=True):
            shape = self.model.read(self.theta[row], *self.solved[row])
            motion = np.linalg.norm(shape, axis=0)
            for group in clusters_of(self.frequency_hz[row]):
                # a cluster cut off at the upper end has no plane of its own to compare
                if group[-1] < n_mode and np.all(motion[group] > SEEN_MOTION * motion.max()):
                    worst = min(worst, plane_mac(quick[:, group], shape[:, group]))
        return worst

    def worst(self, reduced: ReducedModel) -> list[tuple[np.ndarray, np.ndarray]]:
        """Solutions at the points that fail or come close to it, one at least."""
        error, _ = self.judge(reduced)
        rows = np.flatnonzero(error > MARGIN * self.tolerance)
        return [self.solved[row] for row in (rows if rows.size else [np.argmax(error)])]

    def report(self, reduced: ReducedModel, tolerance: float, n_snapshot: int) -> ReductionReport | None:
        """None where it does not hold."""
        error, least_mac = self.judge(reduced)
        if not (np.all(error <= VERIFIED * self.tolerance) and least_mac >= LEAST_MAC):
            return None
        return ReductionReport(
            size=reduced.basis.shape[1], n_snapshot=n_snapshot, n_verify=len(self.theta),
            max_frequency_error=float(error[self.tolerance == tolerance].max()), max_box_error=float(error.max()),
            min_mac=least_mac, frequency_tolerance=tolerance)

    def join(self, other: _Checks) -> _Checks:
        return _Checks(
            model=self.model, theta=np.vstack([self.theta, other.theta]),
            tolerance=np.concatenate([self.tolerance, other.tolerance]),
            frequency_hz=np.vstack([self.frequency_hz, other.frequency_hz]), solved=self.solved + other.solved,
        )


def _worst_points(checks: Sequence[_Checks], reduced: Sequence[ReducedModel]) -> list[tuple[np.ndarray, np.ndarray]]:
    return [found for c, one in zip(checks, reduced, strict=True) for found in c.worst(one)]


def _smallest_size(largest: Sequence[ReducedModel], checks: Sequence[_Checks], share: float) -> int | None:
    """Size of the smallest leading part of the basis that holds at a share of each model's checks; from below, as small
    problems are quickly solved."""
    low, high = largest[0].n_mode, FIRST_SIZE
    size = largest[0].basis.shape[1]

    def is_accurate(size: int) -> bool:
        return all(c.holds(one.truncate(size), share) for c, one in zip(checks, largest, strict=True))

    while not is_accurate(min(high, size)):
        if high >= size:
            return None
        low, high = high, int(GROWTH * high)
    high = min(high, size)
    while high - low > 4:
        middle = (low + high) // 2
        low, high = (low, middle) if is_accurate(middle) else (middle, high)
    return high


def _unmix_modes(snapshots, K) -> np.ndarray:
    """Modes of all snapshots (n_dof, n) of unit K-energy, close ones turned so that families of symmetry stay apart.

    With C_k the energies that modes of family k share with a group V of close modes, sum_k w_k C_k^T C_k is diagonal
    in the modes of pure symmetry, whatever the weights: its eigenvectors turn V back into them.
    """
    clean, close = [], []
    for value, phi in snapshots:
        for group in clusters_of(np.sqrt(value), MIXED_GAP):
            # the mode beyond those asked for may be one of a pair cut in two
            if group[0] < len(value) - 1:
                (clean if len(group) == 1 else close).append(phi[:, group])
    if not clean or not close:
        return _unit_energy(np.hstack(clean + close), K)
    pure = _unit_energy(np.hstack(clean), K)
    n_family, family = _families(pure.T @ (K @ pure))
    weight = (1.0 + np.arange(n_family))[family] / np.bincount(family)[family]
    turned = []
    for group in close:
        shared = pure.T @ (K @ group)
        turned.append(group @ np.linalg.eigh(shared.T @ (weight[:, None] * shared))[1])
    return np.hstack([pure, _unit_energy(np.hstack(turned), K)])


def _unit_energy(vectors, K):
    return vectors / np.sqrt(np.einsum("ij,ij->j", vectors, K @ vectors))


def _families(gram):
    """Number of families and the family of each vector (n,)."""
    return csgraph.connected_components(sparse.csr_array(np.abs(gram) > COUPLING), directed=False)


def _proper_orthogonal(snapshots, K, max_size):
    """POD basis (n_dof, r), K-orthonormal, the most energetic vector first, and the family of each (r,)."""
    # the squared singular values of K^(1/2) S are the eigenvalues of S^T K S
    gram = snapshots.T @ (K @ snapshots)
    n_family, family = _families(gram)
    vectors, energies, families = [], [], []
    for k in range(n_family):
        members = np.flatnonzero(family == k)
        last = len(members) - 1
        inside = gram[np.ix_(members, members)]
        energy, vector = linalg.eigh(inside, subset_by_index=(max(0, last + 1 - max_size), last))
        kept = np.flatnonzero(energy > 1e-12 * energy[-1])[::-1]
        vectors.append(_orthonormal(snapshots[:, members] @ (vector[:, kept] / np.sqrt(energy[kept])), K))
        energies.append(energy[kept[: vectors[-1].shape[1]]])
        families.append(np.full(vectors[-1].shape[1], k))
    order = np.argsort(np.concatenate(energies))[::-1][:max_size]
    return np.hstack(vectors)[:, order], np.concatenate(families)[order]


def _orthonormal(basis, K):
    """K-orthonormal basis of the same space; twice, as once leaves rounding of the order of the condition. It ends
    before the first vector of which rounding hides the energy: elements a few millimetres long are that stiff."""
    for _ in range(2):
        factor, failed = linalg.lapack.dpotrf(basis.T @ (K @ basis), lower=1)
        n = failed - 1 if failed else basis.shape[1]
        basis = linalg.solve_triangular(factor[:n, :n], basis[:, :n].T, lower=True).T
    return basis


def clusters_of(frequency_hz: Sequence[float] | np.ndarray, gap: float = CLUSTER_GAP) -> list[list[int]]:
    """Runs of modes whose neighbours are closer than `gap` of the frequency."""
    groups = [[0]]
    for j in range(1, len(frequency_hz)):
        if frequency_hz[j] - frequency_hz[j - 1] < gap * frequency_hz[j]:
            groups[-1].append(j)
        else:
            groups.append([j])
    return groups
