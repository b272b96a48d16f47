"""The basis of a small model: from all over prior, effects and nacelle angles, enlarged until the full model's answers
at points that took no part in it are met."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, sparse

from probupdate.diagnosis.small_model import TURNS_DEG, SmallModel, angle_harmonics
from probupdate.errors import ConvergenceError, InputError
from probupdate.model.parameters import Parameters
from probupdate.runtime.arrays import frozen_array
from probupdate.structure.affine import AffineModel
from probupdate.structure.eigen import available_modes, lowest_modes, mode_derivatives
from probupdate.structure.projected_terms import Expansion, ProjectedTerms, union_pattern

# modes a snapshot holds beyond those looked for: modes may trade places
SPARE = 1
# the highest of the modes looked through are there to be distinguished from others, and may be less exact
UNSURE = 2
# eigenvalues closer than this ratio are of one cluster, and how many modes are asked for to find its end
CLOSE, BEYOND = 1.2, 12
# points spread over prior and effects, and others to verify on; with so many the size of the basis hardly hangs on the
# draw (four seeds: 199 to 214 vectors; with 36 points 189 to 272)
N_POINT, N_VERIFY = 54, 6
# relative frequency error the basis may have far from where it was built: a twentieth of what model form leaves
TOLERANCE = 1.5e-4
# share of a parameter below which it is all but lost, what of it is left then at least, and from which it is many times
# itself
LOST, LEAST, MANY = 0.2, 0.02, 2.0
# and the error of what one effect does to ln f, as a share of it or in all, that goes unseen beside a signature's own
N_CHANGE, CHANGE, UNSEEN = 16, 0.1, 1e-4
# how often what a basis misses joins what it is made from
MOST_ROUNDS = 5
# energy of a direction, as a share of one mode's, below which it is left out of the basis; tried one after the other
CUTS = (3e-3, 1e-3, 7e-4, 5e-4, 3e-4, 2e-4, 1.5e-4, 1e-4)
# share of the largest mass of any motion of the basis below which one has none
MASSLESS = 1e-14


def _term_harmonics(terms: Sequence[sparse.csc_array], turn: np.ndarray) -> list[sparse.csc_array]:
    """Harmonics of a term that is known at all TURNS_DEG; what does not turn in it has none but the first."""
    pattern, entry = union_pattern(terms)
    at = entry.toarray()
    found = turn @ at
    found[1:][np.abs(found[1:]) < 1e-14 * np.abs(at).max(axis=0)] = 0.0
    parts = []
    for own in found:
        part = sparse.csc_array((own, pattern.indices, pattern.indptr), shape=pattern.shape, copy=True)
        part.eliminate_zeros()
        parts.append(part)
    return parts


def _differ(a: sparse.csc_array, b: sparse.csc_array) -> bool:
    if a is b:
        return False
    apart = abs(a - b)
    return bool(apart.nnz) and apart.max() > 1e-12 * abs(a).max()


def small_model(
    first: AffineModel, *, n_mode: int, effects: Sequence[int], reach: np.ndarray
) -> SmallModel:
    """Project a model, with its nacelle as it is and `turned` by the other TURNS_DEG where it turns, on a common basis.

    n_mode: the lowest modes that must be right. `effects`: which parameters are effects, drawn one at a time within
    `reach` (n_param, 2); the others are drawn from their prior. They (where there are none, all that the structure
    feels) are in the basis at the ends of their reach too. A basis that misses is enlarged by what it missed. Raises
    ConvergenceError where it stays worse than TOLERANCE.
    """
    if len(first.turned) not in (0, len(TURNS_DEG) - 1):
        raise InputError(first.name, f"is turned by {len(first.turned)} angles", f"give none or {len(TURNS_DEG) - 1}")
    sums = [_Sum(first, *terms) for terms in ((first.stiffness, first.mass), *first.turned)]
    rng = np.random.default_rng([0, 11])
    available = available_modes(*sums[0].stiffness_and_mass(first.parameters.initial))
    count = min(n_mode + SPARE, available)
    felt = np.setdiff1d(np.arange(len(first.parameters)), first.of_channels)
    points = _points(first.parameters, felt, effects, reach, rng)
    moved = effects if len(effects) else felt.tolist()
    points = np.vstack([points, _range_points(first.parameters, moved, reach)])
    size = np.where(np.isin(np.arange(len(first.parameters)), effects), np.ptp(reach, axis=1) / 2, first.parameters.std)
    check = _points(first.parameters, felt, effects, reach, rng)
    sure = max(1, n_mode - UNSURE)
    # the snapshots, thousands of vectors, go with the call
    K = sums[0].stiffness_and_mass(first.parameters.initial)[0]
    energy, directions = energy_directions(_snapshots(sums, points, count, n_mode, size, available), K)
    basis, error, wrong = directions[:, :0], np.inf, np.inf
    for _ in range(MOST_ROUNDS):
        verified = _VerifiedPoints.solve(sums, check[rng.permutation(len(check))[:N_VERIFY]],
                                         _single_effect_points(first.parameters, effects, reach, rng), count, sure)
        # each basis holds the ones before it
        projected = verified.project(directions[:, energy > min(CUTS)])
        for cut in CUTS:
            basis = directions[:, energy > cut]
            error, wrong = verified.errors(projected, basis.shape[1])
            if error <= TOLERANCE and wrong <= CHANGE:
                return replace(_project(first, basis, n_mode), frequency_error=error)
        # what was missed joins what the basis is made from, and others verify
        seen = energy > 0
        kept = directions[:, seen] * np.sqrt(energy[seen])
        energy, directions = energy_directions(np.hstack([kept, verified.modes]), K)
        check = _points(first.parameters, felt, effects, reach, rng)
    raise ConvergenceError(
        f"{first.name}: the small basis of {basis.shape[1]} vectors misses frequencies by {error:.1e} where "
        f"{TOLERANCE:g} is needed, and what an effect does to them by {100 * wrong:.0f} % where {100 * CHANGE:.0f} % "
        "is", error)


@dataclass(frozen=True, eq=False, kw_only=True)
class _VerifiedPoints:
    """The full model's answers at points that took no part in the basis: K and M of `unseen` ones with the `sure`
    lowest frequencies there, of effects by themselves (the first without any) with ln f, and all their modes (n_dof, n)
    of unit energy."""

    unseen: list[tuple[sparse.csc_array, sparse.csc_array]]
    frequency_hz: list[np.ndarray]
    alone: list[tuple[sparse.csc_array, sparse.csc_array]]
    log_frequency: list[np.ndarray]
    modes: np.ndarray
    sure: int

    @classmethod
    def solve(cls, sums: Sequence[_Sum], check, alone, count: int, sure: int) -> _VerifiedPoints:
        unseen = [sums[k % len(sums)].stiffness_and_mass(theta) for k, theta in enumerate(check)]
        lonely = [sums[0].stiffness_and_mass(theta) for theta in alone]
        solved = [_modes(matrices, count, sums[0].model.name) for matrices in (*unseen, *lonely)]
        found = [f[:sure] for f, _ in solved]
        return cls(unseen=unseen, frequency_hz=found[: len(unseen)], alone=lonely,
                   log_frequency=[np.log(f) for f in found[len(unseen) :]], modes=np.hstack([phi for _, phi in solved]),
                   sure=sure)

    def project(self, basis: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """K and M (r, r) of all points on a basis (n_dof, r)."""
        return [(basis.T @ (K @ basis), basis.T @ (M @ basis)) for K, M in (*self.unseen, *self.alone)]

    def errors(self, projected: Sequence[tuple[np.ndarray, np.ndarray]], size: int) -> tuple[float, float]:
        """On the last `size` vectors of the basis: largest relative error of a frequency, and of what an effect does to
        ln f as a share of it; those up to the first point at which either is too large."""
        error = wrong = 0.0
        found = (_frequencies(K[-size:, -size:], M[-size:, -size:], self.sure) for K, M in projected)
        for exact, own in zip(self.frequency_hz, found, strict=False):
            error = max(error, float(np.max(np.abs(own / exact - 1))))
            if error > TOLERANCE:
                return error, wrong
        nothing = np.log(next(found))
        for exact, own in zip(self.log_frequency[1:], found, strict=True):
            wrong = max(wrong, _wrong_share(np.log(own) - nothing, exact - self.log_frequency[0]))
            if wrong > CHANGE:
                break
        return error, wrong


def _snapshots(
    sums: Sequence[_Sum], points: np.ndarray, count: int, n_mode: int, size: np.ndarray, available: int
) -> np.ndarray:
    """Lowest `count` modes at the nacelle's angles in turn at the points, and of the first two `_change` with steps of
    this size: (n_dof, n_snapshot)."""
    n_point, n_change, model = len(points) * count, n_mode * (1 + len(size)), sums[0].model
    result = np.empty((model.n_dof, n_point + n_change * len(sums[:2])))
    for k, point in enumerate(points):
        matrices = sums[k % len(sums)].stiffness_and_mass(point)
        result[:, k * count : (k + 1) * count] = _modes(matrices, count, model.name)[1]
    for start, one in zip((n_point, n_point + n_change), sums[:2], strict=False):
        result[:, start : start + n_change] = _change(one, model.parameters.initial, n_mode, size, available)
    return result


def energy_directions(snapshots: np.ndarray, K: sparse.csc_array) -> tuple[np.ndarray, np.ndarray]:
    """Principal directions of snapshots S (n_dof, n_snapshot) in the energy norm: energies (n,) and directions
    (n_dof, n) of unit energy, n the lesser of the two sizes.

    Eigenvectors of S^T K S where snapshots are few; of L^T S S^T L with K = L L^T, which has the same eigenvalues,
    where they are more than degrees of freedom: the effects' changes alone are some thousands. """
    n_dof, n_snapshot = snapshots.shape
    if n_snapshot <= n_dof:
        energy, turn = np.linalg.eigh(snapshots.T @ (K @ snapshots))
        seen = np.where(energy > 0, energy, np.inf)
        return energy, snapshots @ (turn / np.sqrt(seen))
    outer = snapshots @ snapshots.T
    del snapshots
    root = np.linalg.cholesky(K.toarray())
    outer = root.T @ outer
    outer = outer @ root
    outer += outer.T
    outer *= 0.5
    energy, turn = np.linalg.eigh(outer)
    del outer
    return energy, linalg.solve_triangular(root, turn, lower=True, trans="T", overwrite_b=True)


def _range_points(parameters: Parameters, numbers: Sequence[int], reach: np.ndarray) -> np.ndarray:
    """Each of these parameters by itself (n, n_param) where it is all but lost at the end of its reach, and where it is
    many times as large: members of little stiffness and all their mass have modes of their own among the lowest, which
    no other point holds."""
    ends = []
    for k in numbers:
        least, initial = max(reach[k, 0], LEAST * parameters.initial[k]), parameters.initial[k]
        ends += [(k, least)] if 0 < least < LOST * initial else []
        ends += [(k, reach[k, 1])] if initial > 0 and MANY * initial <= reach[k, 1] < np.inf else []
    theta = np.tile(parameters.initial, (len(ends), 1))
    for row, (k, value) in zip(theta, ends, strict=True):
        row[k] = value
    return theta


def _single_effect_points(parameters: Parameters, effects: Sequence[int], reach: np.ndarray, rng) -> np.ndarray:
    """The prior's centre, and some of the effects by themselves there, half as strong as may be and stronger."""
    chosen = rng.permutation(np.asarray(effects, int))[:N_CHANGE]
    theta = np.tile(parameters.initial, (1 + len(chosen), 1))
    for row, k in zip(theta[1:], chosen, strict=True):
        row[k] += rng.uniform(0.5, 1.0) * max(reach[k] - row[k], key=abs)
    return theta


def _wrong_share(found: np.ndarray, exact: np.ndarray) -> float:
    """Error of a change of ln f as a share of the change; none where it is UNSEEN."""
    error = np.linalg.norm(found - exact)
    return float(error / np.linalg.norm(exact)) if error > UNSEEN else 0.0


def _frequencies(K: np.ndarray, M: np.ndarray, count: int) -> np.ndarray:
    masses = linalg.eigvalsh(M)
    if masses[0] < MASSLESS * masses[-1]:
        raise InputError("the model's mass matrix", "gives some motions no mass, which the diagnosis cannot follow",
                         "condense the degrees of freedom without mass out of its matrices")
    value = linalg.eigh(K, M, eigvals_only=True, subset_by_index=(0, count - 1))
    return np.sqrt(np.maximum(value, 0)) / (2 * np.pi)


class _Sum:
    """K(theta) and M(theta) of a model with many terms at one angle of its nacelle, summed on one pattern."""

    def __init__(self, model: AffineModel, stiffness: Sequence[sparse.csc_array], mass: Sequence[sparse.csc_array]):
        self.model = model
        self._parts = [union_pattern(terms) for terms in (stiffness, mass)]

    def stiffness_and_mass(self, theta: np.ndarray) -> tuple[sparse.csc_array, sparse.csc_array]:
        cK, cM = self.model.coefficients(theta)
        return self._weighted_sum(0, cK), self._weighted_sum(1, cM)

    def _weighted_sum(self, kind: int, weight: np.ndarray) -> sparse.csc_array:
        pattern, data = self._parts[kind]
        return sparse.csc_array((weight @ data, pattern.indices, pattern.indptr), shape=pattern.shape)

    def times(self, kind: int, weights: np.ndarray, phi: np.ndarray) -> np.ndarray:
        """(n_dof, n_mode, n) of the sums with `weights` (n_term, n) on phi (n_dof, n_mode)."""
        result = np.empty((*phi.shape, weights.shape[1]))
        for k, weight in enumerate(weights.T):
            result[:, :, k] = self._weighted_sum(kind, weight) @ phi
        return result


def _points(
    parameters: Parameters, felt: np.ndarray, effects: Sequence[int], reach: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Prior draws of the parameters `felt` by the structure, in each of which a few of the effects have moved too."""
    theta = np.tile(parameters.initial, (N_POINT, 1))
    correlation = parameters.correlation
    drawn = Parameters(tuple(parameters.items[k] for k in felt),
                       None if correlation is None else correlation[np.ix_(felt, felt)])
    theta[:, felt] = drawn.draw(rng, N_POINT)
    # draws of a prior that is cut and broad lie too near its centre for a basis: stretched by half
    centre = parameters.initial
    theta = np.clip(centre + 1.5 * (theta - centre), parameters.lower, parameters.upper)
    theta[:, list(effects)] = centre[list(effects)]
    for place, k in enumerate(rng.permutation(np.asarray(effects, int))):
        low, high = reach[k]
        theta[place % N_POINT, k] = rng.uniform(low, high)
    return theta


def _modes(matrices: tuple[sparse.csc_array, sparse.csc_array], count: int, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (count,) and shapes (n_dof, count) of unit energy from K and M of the model of that name."""
    value, phi = lowest_modes(*matrices, count, name)
    return np.sqrt(value) / (2 * np.pi), phi / np.sqrt(value)


def _change(one: _Sum, theta: np.ndarray, count: int, size: np.ndarray, available: int) -> np.ndarray:
    """The lowest modes and their first-order change when a parameter moves by its `size` (n_param,), of unit energy.

    A mode's change towards one that is close is left out, as both are in the basis; the close ones of the last mode may
    go on beyond it, up to the widest gap that follows."""
    K, M = one.stiffness_and_mass(theta)
    value, phi = lowest_modes(K, M, min(count + BEYOND, available), one.model.name)
    ratio = value[1:] / value[:-1]
    goes_on = len(value) > count and ratio[count - 1] < CLOSE
    last = count + (int(np.argmax(ratio[count - 1 :])) if goes_on else 0)
    dcK, dcM = one.model.coefficient_derivatives(theta)
    dK, dM = one.times(0, dcK * size, phi[:, :count]), one.times(1, dcM * size, phi[:, :count])
    close = np.split(np.arange(last), 1 + np.flatnonzero(ratio[: last - 1] >= CLOSE))
    _, change = mode_derivatives(K, M, value[:last], phi[:, :last], dK, dM,
                                 tuple(tuple(c.tolist()) for c in close if len(c) > 1))
    del dK, dM
    value, phi = value[:count], phi[:, :count]
    change /= np.sqrt(value)[:, None]
    return np.hstack([phi / np.sqrt(value), change.reshape(len(phi), -1)])


def _project(first: AffineModel, basis: np.ndarray, n_mode: int) -> SmallModel:
    basis, turn = frozen_array(basis), np.linalg.inv([angle_harmonics(a) for a in TURNS_DEG])

    def harmonic_terms(terms: Sequence[sparse.csc_array], *turned: Sequence[sparse.csc_array]):
        # one that is empty for all that do not turn: the places of a thousand of them are more than all entries
        nothing = sparse.csc_array(terms[0].shape)
        waves = [list(terms), *([nothing] * len(terms) for _ in turned)]
        for number, at_all in enumerate(zip(terms, *turned, strict=True)):
            if any(_differ(at_all[0], other) for other in at_all[1:2]):
                for wave, part in zip(waves, _term_harmonics(at_all, turn), strict=True):
                    wave[number] = part
        return tuple(ProjectedTerms.project(wave, basis) for wave in waves)

    stiffness, mass = (harmonic_terms(*t) for t in zip((first.stiffness, first.mass), *first.turned, strict=True))
    about = Expansion.from_matrices(first.parameters, first.coefficients, (stiffness[0], mass[0]))
    return SmallModel(
        name=first.name, parameters=first.parameters, channels=first.channels, coefficients=first.coefficients,
        stiffness=stiffness, mass=mass, about=about,
        at_channels=frozen_array(first.rows @ basis), moved=tuple(m.project(basis) for m in first.moved),
        gravity=first.gravity, n_search=n_mode,
        frequency_error=np.nan, fingerprint=first.fingerprint(), wire=first.wire,
        at_nodes=None if first.wire is None else frozen_array(first.wire_matrix @ basis),
    )
