"""A model at every nacelle angle on one small basis: modes and exact derivatives in milliseconds.

The mass terms of rotor and nacelle are polynomials of second degree in the cosine and sine of the nacelle's angle, so
that five angles give them at any other exactly. The basis holds modes from all over the prior, of every effect and
angle, and the first-order change of the wanted modes with every parameter; how far it may be trusted is measured on
points that took no part in it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg, sparse

from probupdate.errors import ConvergenceError, InputError
from probupdate.modes import frozen_array
from probupdate.parameters import Parameters
from probupdate.structure.affine import AffineModel
from probupdate.structure.eigen import lowest_modes, mode_derivatives

# angles that determine a trigonometric polynomial of second degree
TURNS_DEG = tuple(72.0 * k for k in range(5))
# modes a snapshot holds beyond those looked for: modes may trade places
SPARE = 4
# points spread over the prior and over one effect each; verified on so many others
N_VERIFY = 6
# relative frequency error the basis may have: a tenth of what a block's identification leaves
TOLERANCE = 3e-4
# singular values of the snapshots, as a share of the largest, below which directions are left out
CUT = 1e-7


@dataclass(frozen=True, eq=False, kw_only=True)
class SmallModes:
    """All modes of the basis at one point: frequency_hz (r,), vectors (r, r) of unit modal mass."""

    frequency_hz: np.ndarray
    vectors: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class SmallModel:
    """K and M on the basis: stiffness (n_term, r, r) and mass (n_term, r, r) where they do not turn; `turning` holds
    for the mass terms that do the five coefficients (5, r, r) of 1, cos a, sin a, cos 2a, sin 2a.

    `frequency_error` is the largest relative error found against the full model on points not used for the basis.
    """

    name: str
    parameters: Parameters
    channels: tuple[str, ...]
    coefficients: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    stiffness: np.ndarray
    mass: np.ndarray
    turning_stiffness: dict[int, np.ndarray]
    turning_mass: dict[int, np.ndarray]
    at_channels: np.ndarray
    n_search: int
    frequency_error: float
    fingerprint: str

    def terms(self, angle_deg: float) -> tuple[np.ndarray, np.ndarray]:
        """Stiffness and mass terms (n_term, r, r) with the nacelle at that angle."""
        wave = _harmonics(angle_deg)
        return (_turned(self.stiffness, self.turning_stiffness, wave), _turned(self.mass, self.turning_mass, wave))

    def solve(self, theta: np.ndarray, angle_deg: float = 0.0) -> SmallModes:
        """All modes of the basis at theta (n_param,)."""
        cK, cM = self.coefficients(np.asarray(theta, float))
        Kt, Mt = self.terms(angle_deg)
        K, M = np.tensordot(cK, Kt, 1), np.tensordot(cM, Mt, 1)
        try:
            value, vectors = linalg.eigh(K, M)
        except linalg.LinAlgError as error:
            raise ConvergenceError(f"{self.name}: no modes on the small basis ({error})", theta) from None
        return SmallModes(frequency_hz=np.sqrt(np.maximum(value, 0)) / (2 * np.pi), vectors=vectors)

    def shapes(self, modes: SmallModes, count: int) -> np.ndarray:
        """(n_channel, count) of the lowest modes."""
        return self.at_channels @ modes.vectors[:, :count]

    def derivatives(
        self, theta: np.ndarray, angle_deg: float, modes: SmallModes, members: Sequence[int]
    ) -> tuple[np.ndarray, np.ndarray]:
        """For one cluster of modes, ascending: d(Phi^T K Phi - lambda Phi^T M Phi) (k, k, n_param) between its members, lambda the
        mean of the two, and d shape (n_channel, k, n_param) without their rotation into each other."""
        theta = np.asarray(theta, float)
        stepped = theta + 1e-30j * np.eye(theta.size)
        cK, cM = self.coefficients(stepped)
        dcK, dcM = np.imag(cK) / 1e-30, np.imag(cM) / 1e-30
        Kt, Mt = self.terms(angle_deg)
        phi, own = modes.vectors, modes.vectors[:, list(members)]
        moved_k, moved_m = dcK != 0, dcM != 0
        use_k, use_m = moved_k.any(axis=0), moved_m.any(axis=0)
        dK = np.einsum("pt,trj->prj", dcK[:, use_k], Kt[use_k] @ own)
        dM = np.einsum("pt,trj->prj", dcM[:, use_m], Mt[use_m] @ own)
        dK, dM = phi.T @ dK, phi.T @ dM
        value = (2 * np.pi * modes.frequency_hz) ** 2
        own_value = value[list(members)]
        change = dK - own_value * dM
        gap = own_value[None, :] - value[:, None]
        inside = np.zeros(len(value), bool)
        inside[list(members)] = True
        share = np.zeros_like(gap)
        share[~inside] = 1.0 / gap[~inside]
        amount = change * share
        amount[:, inside] = -0.5 * dM[:, inside]
        d_shape = (self.at_channels @ phi) @ amount
        mean = 0.5 * (own_value[:, None] + own_value[None, :])
        coupling = dK[:, inside] - mean * dM[:, inside]
        return coupling.transpose(1, 2, 0), d_shape.transpose(1, 2, 0)


def _harmonics(angle_deg: float) -> np.ndarray:
    a = np.radians(angle_deg)
    return np.array([1.0, np.cos(a), np.sin(a), np.cos(2 * a), np.sin(2 * a)])


def _turned(fixed: np.ndarray, turning: dict[int, np.ndarray], wave: np.ndarray) -> np.ndarray:
    if not turning:
        return fixed
    result = fixed.copy()
    for term, part in turning.items():
        result[term] = np.tensordot(wave, part, 1)
    return result


def _differ(a: sparse.csc_array, b: sparse.csc_array) -> bool:
    apart = abs(a - b)
    return bool(apart.nnz) and apart.max() > 1e-12 * abs(a).max()


def small_model(
    models: Sequence[AffineModel], *, n_mode: int, effects: Sequence[int], reach: np.ndarray, seed: int = 0
) -> SmallModel:
    """Project `models`, one for each of TURNS_DEG (or a single one that does not turn), on a common basis.

    n_mode: the lowest modes that must be right. `effects`: which parameters are effects, drawn one at a time within
    `reach` (n_param, 2); the others are drawn from their prior. Raises ConvergenceError where the basis stays
    worse than TOLERANCE.
    """
    first = models[0]
    if len(models) not in (1, len(TURNS_DEG)):
        raise InputError(first.name, f"{len(models)} angles given", f"give 1 or {len(TURNS_DEG)}")
    rng = np.random.default_rng([seed, 11])
    count = min(n_mode + SPARE, first.n_available)
    points = _points(first.parameters, effects, reach, rng)
    vectors = [_modes(models[k % len(models)], theta, count)[1] for k, theta in enumerate(points)]
    for model in models[: 3 if len(models) > 1 else 1]:
        vectors.append(_change(model, model.parameters.initial, count))
    check = _points(first.parameters, effects, reach, rng)
    check = check[rng.permutation(len(check))[:N_VERIFY]]
    K0, _ = first.matrices(first.parameters.initial)
    for _ in range(3):
        basis = _energy_basis(np.hstack(vectors), K0)
        small = _project(models, basis, n_mode)
        error, worse = 0.0, []
        for k, theta in enumerate(check):
            model = models[k % len(models)]
            exact, phi = _modes(model, theta, count)
            found = small.solve(theta, TURNS_DEG[k % len(models)]).frequency_hz[:n_mode]
            apart = float(np.max(np.abs(found / exact[:n_mode] - 1)))
            error = max(error, apart)
            if apart > TOLERANCE:
                worse.append(phi)
        if error <= TOLERANCE:
            break
        vectors += worse
        more = _points(first.parameters, effects, reach, rng)
        vectors += [_modes(models[k % len(models)], theta, count)[1] for k, theta in enumerate(more)]
        check = _points(first.parameters, effects, reach, rng)
        check = check[rng.permutation(len(check))[:N_VERIFY]]
    else:
        raise ConvergenceError(
            f"{first.name}: the small basis of {basis.shape[1]} vectors misses frequencies by {error:.1e} where "
            f"{TOLERANCE:g} is needed", error)  # fmt: skip
    return SmallModel(**{**small.__dict__, "frequency_error": error})


def _points(parameters: Parameters, effects: Sequence[int], reach: np.ndarray, rng) -> np.ndarray:
    """One prior draw for each effect, which alone is moved, and as many as a dozen more without any."""
    number = len(effects) + 12
    theta = parameters.draw(rng, number)
    # draws of a prior that is cut and broad lie too near its centre for a basis: stretched by half
    centre = parameters.initial
    theta = np.clip(centre + 1.5 * (theta - centre), parameters.lower, parameters.upper)
    theta[:, list(effects)] = centre[list(effects)]
    for row, k in enumerate(effects):
        theta[row, k] = rng.uniform(*reach[k])
    return theta


def _modes(model: AffineModel, theta: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    value, phi = lowest_modes(*model.matrices(theta), count, model.name)
    return np.sqrt(value) / (2 * np.pi), phi


def _change(model: AffineModel, theta: np.ndarray, count: int) -> np.ndarray:
    """First-order change of the lowest modes with every parameter (n_dof, count * n_param), scaled to the modes."""
    K, M = model.matrices(theta)
    value, phi = lowest_modes(K, M, count, model.name)
    dcK, dcM = model.coefficient_derivatives(theta)
    dK = np.einsum("tnj,tk->njk", np.array([Kt @ phi for Kt in model.stiffness]), dcK)
    dM = np.einsum("tnj,tk->njk", np.array([Mt @ phi for Mt in model.mass]), dcM)
    close = [[0]]
    for j in range(1, count):
        if value[j] < 1.2 * value[close[-1][-1]]:
            close[-1].append(j)
        else:
            close.append([j])
    _, d_phi = mode_derivatives(K, M, value, phi, dK, dM, tuple(tuple(c) for c in close if len(c) > 1))
    change = d_phi.reshape(len(phi), -1)
    size = np.sqrt(np.maximum(np.einsum("ij,ij->j", change, K @ change), 1e-300))
    # unit energy would blow rounding of parameters without effect up to a direction
    kept = size > 1e-8 * size.max()
    scale = np.sqrt(value.mean())
    return np.hstack([phi, change[:, kept] / size[kept] * scale])


def _energy_basis(vectors: np.ndarray, K: sparse.csc_array) -> np.ndarray:
    """K-orthonormal directions of the snapshots (n_dof, r)."""
    gram = vectors.T @ (K @ vectors)
    size = np.sqrt(np.diag(gram))
    value, turn = np.linalg.eigh(gram / np.outer(size, size))
    kept = value > CUT * value[-1]
    return (vectors / size) @ (turn[:, kept] / np.sqrt(value[kept]))


def _project(models: Sequence[AffineModel], basis: np.ndarray, n_mode: int) -> SmallModel:
    first = models[0]

    def onto(term) -> np.ndarray:
        small = basis.T @ (term @ basis)
        return 0.5 * (small + small.T)

    fixed, turning = [], []
    for kind in ("stiffness", "mass"):
        terms = getattr(first, kind)
        fixed.append(np.array([onto(t) for t in terms]))
        moved = {}
        for number, term in enumerate(terms):
            if any(_differ(term, getattr(m, kind)[number]) for m in models[1:2]):
                at = np.array([onto(getattr(m, kind)[number]) for m in models])
                moved[number] = np.tensordot(np.linalg.inv([_harmonics(a) for a in TURNS_DEG]), at, 1)
        turning.append(moved)
    return SmallModel(
        name=first.name, parameters=first.parameters, channels=first.channels, coefficients=first.coefficients,
        stiffness=frozen_array(fixed[0]), mass=frozen_array(fixed[1]), turning_stiffness=turning[0],
        turning_mass=turning[1], at_channels=frozen_array(first.channel_matrix @ basis), n_search=n_mode,
        frequency_error=np.nan, fingerprint=first.fingerprint(),
    )  # fmt: skip
