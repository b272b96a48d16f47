"""Turbines of one design as one linear-Gaussian system: what they share, what varies between them, what is one's own.

Of turbine i, linear about one middle: y_i = J_i d_i + B_i e + noise, d_i = u_i - middle of normal scores u. e is the
error of the model that all turbines of the design share (`shared_error`); common parameters are one number for all, a
varying one is drawn from N(mu, tau^2), an own one from its prior. With z = (common, mu), d_i = offset + Z (z + a_i) + X
xi_i: a_i scatters by tau, xi_i is standard normal (what an own parameter's prior leaves beside the shared ones). a_i
and xi_i are integrated out in closed form (Schur complements of inner products), e and z too: what is left is a density
of tau and of the discrepancy's scales alone (hierarchical linear model, Lindley & Smith 1972).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg

from probupdate.errors import InputError
from probupdate.runtime.arrays import frozen_array
from probupdate.updating.shared_error import GaussianPrior, Inner

# directions of the common error that move all data together by less than this, squared standard deviations, are left
# out
SILENT = 1e-7
# from this size on substitution saves more than one call for many matrices
LARGE = 60
COMMON, VARYING, OWN = "common", "varying", "own"


def lower_solve(root: np.ndarray, right: np.ndarray) -> np.ndarray:
    """L^-1 right of many lower factors (n, m, m), right (n, m, k); of large ones one after another, by substitution."""
    if root.shape[-1] < LARGE:
        return np.linalg.solve(root, right)
    return np.array([linalg.solve_triangular(a, b, lower=True) for a, b in zip(root, right, strict=True)])


@dataclass(frozen=True, kw_only=True)
class Roles:
    """Which parameters are one number for all turbines, which vary between them; the others are a turbine's own."""

    names: tuple[str, ...]
    common: tuple[str, ...]
    varying: tuple[str, ...]

    def __post_init__(self):
        twice = [n for n in self.common if n in self.varying]
        if twice:
            raise InputError("[joint]", f"{', '.join(twice)} is common and varying", "list it once")
        absent = [n for n in (*self.common, *self.varying) if n not in self.names]
        if absent:
            raise InputError("[joint]", f"{', '.join(absent)} is not a parameter that is updated",
                             f"choose from {', '.join(self.names)}")
        if not (self.common or self.varying):
            raise InputError("[joint]", "names no parameter that turbines have in common",
                             f"list some of {', '.join(self.names)} as common or varying")

    @property
    def shared(self) -> tuple[str, ...]:
        """z: the common ones, then the means of those that vary."""
        return (*self.common, *self.varying)

    def role(self, name: str) -> str:
        return COMMON if name in self.common else VARYING if name in self.varying else OWN

    def numbers(self, names: Sequence[str]) -> list[int]:
        return [self.names.index(n) for n in names]

    @property
    def own(self) -> tuple[str, ...]:
        return tuple(n for n in self.names if self.role(n) == OWN)


@dataclass(frozen=True, eq=False, kw_only=True)
class Layout:
    """d_i = offset + shared (z + a_i) + own xi_i: offset (n_param,), shared (n_param, n_z), own (n_param, n_own); prior
    mean and precision of z; `varying`: places in z of those that scatter."""

    offset: np.ndarray
    shared: np.ndarray
    own: np.ndarray
    prior: GaussianPrior
    varying: np.ndarray

    @classmethod
    def from_roles(cls, roles: Roles, covariance: np.ndarray, middle: np.ndarray) -> Layout:
        """covariance (n_param, n_param): the prior's of u, whose mean is zero; middle (n_param,)."""
        mean = -middle
        s, o = roles.numbers(roles.shared), roles.numbers(roles.own)
        across = np.linalg.solve(covariance[np.ix_(s, s)], covariance[np.ix_(s, o)]).T
        left = covariance[np.ix_(o, o)] - across @ covariance[np.ix_(s, o)]
        n = len(mean)
        offset, shared, own = np.zeros(n), np.zeros((n, len(s))), np.zeros((n, len(o)))
        shared[s, range(len(s))] = 1.0
        shared[o] = across
        offset[o] = mean[o] - across @ mean[s]
        if o:
            own[o] = np.linalg.cholesky(left)
        return cls(offset=frozen_array(offset), shared=frozen_array(shared), own=frozen_array(own),
                   prior=(mean[s], np.linalg.inv(covariance[np.ix_(s, s)])),
                   varying=np.arange(len(roles.common), len(s)))


@dataclass(frozen=True, eq=False, kw_only=True)
class Conditional:
    """z and e given tau and scales, jointly normal: precision of (z, e) by its lower factor, mean."""

    mean: np.ndarray
    root: np.ndarray
    n_z: int

    def solve(self, right: np.ndarray) -> np.ndarray:
        return linalg.cho_solve((self.root, True), right)


@dataclass(frozen=True, eq=False, kw_only=True)
class FarmSystem:
    """products (n_turbine, n_a, n_a): inner products of whitened (r, J Z, B) of each turbine, xi integrated out, n_a =
    1 + n_z + n_e; constant (n_turbine,); own_rows (n_turbine, n_own, n_a) and own_root (n_turbine, n_own, n_own) give
    xi back; wide (n_turbine, n_z): how much farther than tau a turbine that is unlike the others may be; kind, form
    (n_e,) of the common unknowns as in `SharedError`."""

    layout: Layout
    products: np.ndarray
    constant: np.ndarray
    own_rows: np.ndarray
    own_root: np.ndarray
    wide: np.ndarray
    kind: np.ndarray
    form: np.ndarray

    @classmethod
    def assemble(
        cls, inners: Sequence[Inner], layout: Layout, kind: np.ndarray | None = None, form: np.ndarray | None = None
    ) -> FarmSystem:
        """inners: one a turbine, all about the middle that the layout is of; kind None: e is standard normal."""
        n, n_z, n_own = len(layout.offset) + 1, layout.shared.shape[1], layout.own.shape[1]
        n_e = len(inners[0].products) - n
        n_a = 1 + n_z + n_e
        turn = np.zeros((n + n_e, n_a + n_own))
        turn[0, 0] = 1.0
        turn[1:n, 0] = -layout.offset
        turn[1:n, 1 : 1 + n_z] = layout.shared
        turn[n:, 1 + n_z : n_a] = np.eye(n_e)
        turn[1:n, n_a:] = layout.own
        products, constant, rows, roots = [], [], [], []
        for inner in inners:
            whole = turn.T @ inner.products @ turn
            root = np.linalg.cholesky(np.eye(n_own) + whole[n_a:, n_a:])
            half = linalg.solve_triangular(root, whole[n_a:, :n_a], lower=True)
            products.append(whole[:n_a, :n_a] - half.T @ half)
            constant.append(inner.constant - np.sum(np.log(np.diag(root))))
            rows.append(whole[n_a:, :n_a])
            roots.append(root)
        return cls(layout=layout, products=frozen_array(products), constant=frozen_array(constant),
                   own_rows=frozen_array(rows), own_root=frozen_array(roots),
                   wide=frozen_array(np.zeros((len(inners), n_z))), kind=np.zeros(n_e, int) if kind is None else kind,
                   form=np.zeros(n_e) if form is None else form)

    def with_odd_scale(self, wide: np.ndarray) -> FarmSystem:
        return replace(self, wide=frozen_array(wide))

    def select(self, keep: Sequence[int] | np.ndarray) -> FarmSystem:
        """Of some of the turbines."""
        k = list(keep)
        return replace(self, products=self.products[k], constant=self.constant[k], own_rows=self.own_rows[k],
                       own_root=self.own_root[k], wide=self.wide[k])

    @property
    def n_z(self) -> int:
        return self.layout.shared.shape[1]

    @cached_property
    def _whole(self) -> np.ndarray:
        return self.products.sum(axis=0)

    @cached_property
    def columns(self) -> np.ndarray:
        """Places in z of what may differ between turbines."""
        far = np.flatnonzero(np.any(self.wide > 0, axis=0))
        return np.union1d(self.layout.varying, far).astype(int)

    def spread(self, tau: np.ndarray) -> np.ndarray:
        """Standard deviation of a_i in `columns` (..., n_turbine, n_column), of tau (..., n_varying)."""
        std = np.zeros((*tau.shape[:-1], 1, self.n_z))
        std[..., 0, self.layout.varying] = tau
        return np.hypot(std, self.wide)[..., self.columns]

    @cached_property
    def _rows(self) -> np.ndarray:
        """Of products, those of `columns` (n_turbine, n_column, n_a)."""
        return self.products[:, 1 + self.columns]

    def scatter_factors(self, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """X (..., n_turbine, n_column, n_a), products - X^T X are those with a_i integrated out; and ln of what that
        costs (..., n_turbine); tau (..., n_varying)."""
        root = np.linalg.cholesky(self._inner(tau))
        X = np.linalg.solve(root, self.spread(tau)[..., None] * self._rows)
        return X, np.log(np.diagonal(root, axis1=-2, axis2=-1)).sum(axis=-1)

    def _inner(self, tau: np.ndarray) -> np.ndarray:
        std = self.spread(tau)
        return np.eye(len(self.columns)) + std[..., None] * self._rows[:, :, 1 + self.columns] * std[..., None, :]

    def whole(self, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Products (..., n_a, n_a) and constant (...,) of all turbines together, of tau (..., n_varying)."""
        X, lost = self.scatter_factors(tau)
        X = X.reshape(*X.shape[:-3], -1, X.shape[-1])
        return self._whole - np.swapaxes(X, -1, -2) @ X, np.sum(self.constant) - lost.sum(axis=-1)

    def inner(self, tau: np.ndarray) -> Inner:
        """Of all turbines together, about z = 0."""
        products, constant = self.whole(tau)
        return Inner(middle=np.zeros(self.n_z), products=products, constant=float(constant), kind=self.kind)

    def each(self, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Products (n_turbine, n_a, n_a) and constant (n_turbine,) of every turbine, a_i integrated out."""
        X, lost = self.scatter_factors(tau)
        return self.products - np.swapaxes(X, 1, 2) @ X, self.constant - lost

    def evidences(
        self, products: np.ndarray, constant: np.ndarray, common_std: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """ln p (n,) of several such products (n, n_a, n_a), z and e integrated out, up to a constant; lower factor L of
        the precision of (z, e) and L^T times their mean, before it. common_std (n_e,) or (n, n_e)."""
        mean, prior = self.layout.prior
        precision, right = np.array(products[:, 1:, 1:]), np.array(products[:, 1:, 0])
        precision[:, : self.n_z, : self.n_z] += prior
        own = np.arange(self.n_z, precision.shape[1])
        precision[:, own, own] += 1 / common_std**2
        right[:, : self.n_z] += prior @ mean
        root = np.linalg.cholesky(precision)
        half = lower_solve(root, right[..., None])[..., 0]
        value = constant - 0.5 * products[:, 0, 0] + 0.5 * np.sum(half**2, axis=1)
        value = value - np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1) - np.log(common_std).sum(axis=-1)
        return value, half, root

    def log_density(self, tau: np.ndarray, common_std: np.ndarray) -> np.ndarray:
        """ln p(all data | tau, scales) (n,), up to a constant: z, e, every a_i and xi_i integrated out; tau (n,
        n_varying), common_std (n, n_e)."""
        return self.evidences(*self.whole(tau), common_std)[0]

    def conditional(self, tau: np.ndarray, common_std: np.ndarray) -> Conditional:
        """z and e, given all data."""
        products, constant = self.whole(tau)
        _, half, root = self.evidences(products[None], constant[None], common_std)
        mean = linalg.solve_triangular(root[0], half[0], lower=True, trans=1)
        return Conditional(mean=mean, root=root[0], n_z=self.n_z)

    def draw(
        self, tau: np.ndarray, common_std: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """z (n, n_z), e (n, n_e) and d (n, n_turbine, n_param), of tau (n, n_varying), common_std (n, n_e): exactly of
        the posterior given these."""
        _, half, root = self.evidences(*self.whole(tau), common_std)
        normal = half + rng.standard_normal(half.shape)
        joint = np.linalg.solve(np.swapaxes(root, 1, 2), normal[..., None])[..., 0]
        n_c, n_own = len(self.columns), self.layout.own.shape[1]
        a_normal = rng.standard_normal((len(tau), len(self.products), n_c, 1))
        own_normal = rng.standard_normal((len(tau), len(self.products), n_own, 1))
        known = np.column_stack([np.ones(len(tau)), -joint])
        std = self.spread(tau)
        inner = np.linalg.cholesky(self._inner(tau))
        half = np.linalg.solve(inner, (std * np.einsum("ica,na->nic", self._rows, known))[..., None]) + a_normal
        a = std * np.linalg.solve(np.swapaxes(inner, -1, -2), half)[..., 0]
        shift = np.zeros((*a.shape[:-1], self.n_z))
        shift[..., self.columns] = a
        own = np.einsum("ioa,na->nio", self.own_rows, known) - np.einsum(
            "iok,nik->nio", self.own_rows[:, :, 1 : 1 + self.n_z], shift)
        half = np.linalg.solve(self.own_root, own[..., None]) + own_normal
        own = np.linalg.solve(np.swapaxes(self.own_root, 1, 2), half)[..., 0]
        z, e = joint[:, : self.n_z], joint[:, self.n_z :]
        d = self.layout.offset + (z[:, None] + shift) @ self.layout.shared.T + own @ self.layout.own.T
        return z, e, d

    def common_std(self, shared: np.ndarray) -> np.ndarray:
        """Of each common unknown (..., n_e) a priori, of shared scales (..., 3)."""
        scale = np.concatenate([np.ones((*shared.shape[:-1], 1)), shared], axis=-1)[..., self.kind]
        return np.where(self.kind == 0, 1.0, np.hypot(scale, self.form))

    def keep_informed(self, shared: np.ndarray, learnt: bool) -> tuple[FarmSystem, np.ndarray]:
        """The same in fewer common unknowns, standard normal: directions of which the data say anything; and the turn
        (n_e, n_kept) back to e. Those whose scale is learnt stay as they are."""
        std = self.common_std(shared)
        fixed = self.kind == 0 if learnt else np.ones(len(self.kind), bool)
        known = np.flatnonzero(fixed)
        whole = self._whole[1 + self.n_z :, 1 + self.n_z :][np.ix_(known, known)] * np.outer(std[known], std[known])
        gain, vectors = np.linalg.eigh(whole)
        kept = vectors[:, gain > SILENT]
        turn = np.zeros((len(std), kept.shape[1] + np.sum(~fixed)))
        turn[known, : kept.shape[1]] = std[known, None] * kept
        turn[~fixed, kept.shape[1] :] = np.eye(np.sum(~fixed))
        none = np.zeros(kept.shape[1])
        return self.rotate_errors(turn, np.concatenate([none.astype(int), self.kind[~fixed]]),
                           np.concatenate([none, self.form[~fixed]])), turn

    def rotate_errors(self, turn: np.ndarray, kind: np.ndarray, form: np.ndarray) -> FarmSystem:
        """With e = turn e', turn (n_e, n_kept)."""
        full = linalg.block_diag(np.eye(1 + self.n_z), turn)
        return replace(self, products=frozen_array(full.T @ self.products @ full), kind=kind, form=form,
                       own_rows=frozen_array(self.own_rows @ full))

    def _known(self, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of tau: how d (n_turbine, n_param) follows from (1, -z, -e), (n_turbine, n_param, n_a), and what of its
        covariance is left where these are known."""
        std, c, n_z = self.spread(tau), self.columns, self.n_z
        among = std[:, :, None] * np.linalg.inv(self._inner(tau)) * std[:, None, :]
        a = among @ self._rows
        inverse = np.linalg.inv(self.own_root @ np.swapaxes(self.own_root, 1, 2))
        own = self.layout.own @ inverse
        # of a: by itself, and through what own parameters follow of it
        through = self.layout.shared[:, c] - own @ self.own_rows[:, :, 1 + c]
        known = through @ a + own @ self.own_rows
        known[:, :, 1 : 1 + n_z] -= self.layout.shared
        return known, through @ among @ np.swapaxes(through, 1, 2) + own @ self.layout.own.T

    def means(self, tau: np.ndarray, joint: Conditional) -> np.ndarray:
        """Of d (n_turbine, n_param), given tau."""
        known, _ = self._known(tau)
        return self.layout.offset + known[:, :, 0] - known[:, :, 1:] @ joint.mean

    def of_turbines(self, tau: np.ndarray, joint: Conditional) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Given tau: mean (n_turbine, n_param) and covariance (n_turbine, n_param, n_param) of d, its covariance with z
        (n_turbine, n_param, n_z), and what of the covariance is left where z and e are known."""
        (known, left), n_z = self._known(tau), self.n_z
        slope = -known[:, :, 1:]
        mean = self.layout.offset + known[:, :, 0] + slope @ joint.mean
        both = np.array([joint.solve(one.T) for one in slope])
        return mean, left + slope @ both, np.swapaxes(both[:, :n_z], 1, 2), left
