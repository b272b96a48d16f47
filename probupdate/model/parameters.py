"""Parameters of a model and their prior: name, unit, initial value, standard deviation, bounds, distribution."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import linalg
from scipy.special import ndtr

from probupdate.errors import InputError
from probupdate.model.box_probability import draws_in_box, log_box_probability

PRIORS = ("normal", "lognormal", "uniform")
# draws that moments of a correlated prior within its bounds are taken from
N_MOMENT = 20_000


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One scalar the model depends on.

    `std` is the prior standard deviation in `unit`; for "lognormal" it is the standard deviation of the variable
    itself, not of its logarithm, and `initial` its median, so that both priors are centred on the same model. "uniform"
    is flat between its bounds: its standard deviation is theirs, whatever is given, and `initial` a place to start.
    """

    name: str
    unit: str
    initial: float
    std: float = np.nan
    lower: float = -np.inf
    upper: float = np.inf
    prior: str = "normal"
    description: str = ""

    def __post_init__(self):
        where = f"parameter {self.name}"
        if not np.isfinite(self.initial):
            raise InputError(where, f"initial value {self.initial} is not finite", "give a number")
        if self.prior == "uniform" and self.lower < self.upper:
            if not np.isfinite(self.upper - self.lower):
                raise InputError(where, "a uniform prior needs both bounds", "give lower and upper")
            object.__setattr__(self, "std", float((self.upper - self.lower) / np.sqrt(12)))
        if not (np.isfinite(self.std) and self.std > 0):
            raise InputError(where, f"standard deviation {self.std} is not positive", "give cov or std above zero")
        if not self.lower < self.upper:
            raise InputError(where, f"bounds [{self.lower}, {self.upper}] are empty", "give lower below upper")
        if not self.lower <= self.initial <= self.upper:
            raise InputError(
                where, f"initial value {self.initial} is outside [{self.lower}, {self.upper}]", "widen the bounds"
            )
        if self.prior not in PRIORS:
            raise InputError(where, f"prior '{self.prior}' is unknown", f"choose one of {', '.join(PRIORS)}")
        if self.prior == "lognormal" and self.initial <= 0:
            raise InputError(where, "a lognormal prior needs a positive initial value", "use prior = \"normal\"")

    @property
    def log_std(self) -> float:
        """Standard deviation of ln(theta) for a lognormal of median `initial` and standard deviation `std`."""
        # Var = m^2 (e^{s^2} - 1) e^{s^2}; solved for e^{s^2}
        ratio = (self.std / self.initial) ** 2
        return float(np.sqrt(np.log(0.5 + np.sqrt(0.25 + ratio))))

    @cached_property
    def distribution(self) -> Any:
        """The marginal prior cut at the bounds, as a frozen scipy.stats distribution (normal) of theta."""
        from scipy import stats

        if self.prior == "uniform":
            return stats.uniform(self.lower, self.upper - self.lower)
        if self.prior == "normal":
            a, b = (self.lower - self.initial) / self.std, (self.upper - self.initial) / self.std
            return stats.truncnorm(a, b, loc=self.initial, scale=self.std)
        low = np.log(self.lower / self.initial) / self.log_std if self.lower > 0 else -np.inf
        high = np.log(self.upper / self.initial) / self.log_std if np.isfinite(self.upper) else np.inf
        return _LogTruncated(stats.truncnorm(low, high), self.initial, self.log_std)


@dataclass(frozen=True)
class _LogTruncated:
    """theta = median exp(log_std z), z a truncated standard normal: the lognormal cut at the bounds."""

    z: Any  # scipy's frozen truncnorm, of which its stubs know no methods
    scale: float
    log_std: float

    def _standard(self, theta):
        with np.errstate(divide="ignore"):
            return np.log(np.maximum(theta, 0) / self.scale) / self.log_std

    def logpdf(self, theta):
        theta = np.asarray(theta, float)
        positive = theta > 0
        safe = np.where(positive, theta, self.scale)
        value = self.z.logpdf(self._standard(safe)) - np.log(safe * self.log_std)
        return np.where(positive, value, -np.inf)

    def ppf(self, q):
        return self.scale * np.exp(self.log_std * self.z.ppf(q))

    def cdf(self, theta):
        return self.z.cdf(self._standard(np.asarray(theta, float)))

    def median(self):
        return self.ppf(0.5)

    def rvs(self, size=None, random_state=None):
        return self.scale * np.exp(self.log_std * self.z.rvs(size=size, random_state=random_state))

    def _moment(self, order: int) -> float:
        # E[e^{k s z}] of a standard normal cut to [a, b] is e^{k^2 s^2 / 2} P(a < z + k s < b) / P(a < z < b)
        a, b = self.z.support()
        shift = order * self.log_std
        inside = ndtr(b) - ndtr(a)
        moved = ndtr(b - shift) - ndtr(a - shift)
        return float(self.scale**order * np.exp(shift**2 / 2) * moved / inside)

    def mean(self):
        return self._moment(1)

    def std(self):
        return float(np.sqrt(self._moment(2) - self._moment(1) ** 2))


@dataclass(frozen=True, eq=False)
class Parameters:
    """The parameters that are updated, in order, with an optional prior correlation (n, n).

    Every method takes theta of shape (..., n). With a correlation the prior is the joint Gaussian (in theta, or
    in ln theta for the lognormal ones) cut at the bounds; its normalising constant is then left out and
    `log_density` says so through `normalised`. A model may have none: then it has modes and nothing to update.
    `held`: names and values of those that its file lists with `update = false`, or that a user holds (`holding`).
    """

    items: tuple[Parameter, ...]
    correlation: np.ndarray | None = None
    held: tuple[tuple[str, float], ...] = ()

    def __post_init__(self):
        names = [p.name for p in self.items]
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise InputError("parameters", f"{', '.join(twice)} listed twice", "keep one entry each")
        if self.correlation is not None:
            c = np.array(self.correlation, float)
            n = len(names)
            if c.shape != (n, n) or not np.allclose(c, c.T) or not np.allclose(np.diag(c), 1):
                raise InputError(
                    "parameters.correlation",
                    f"shape {c.shape} is not a symmetric ({n}, {n}) matrix with ones on its diagonal",
                    "give one row per updated parameter",
                )
            flat = [k for k, p in enumerate(self.items) if p.prior == "uniform" and np.any(np.delete(c[k], k))]
            if flat:
                raise InputError("parameters.correlation", f"{names[flat[0]]} has a uniform prior and no correlation",
                                 "set its row to zero, or give it a normal prior")
            if np.linalg.eigvalsh(c)[0] <= 0:
                raise InputError("parameters.correlation", "the matrix is not positive definite", "lower its entries")
            c.setflags(write=False)
            object.__setattr__(self, "correlation", c)

    def __len__(self):
        return len(self.items)

    def __iter__(self):
        return iter(self.items)

    @cached_property
    def names(self) -> tuple[str, ...]:
        return tuple(p.name for p in self.items)

    def _column(self, attribute: str) -> np.ndarray:
        value = np.array([getattr(p, attribute) for p in self.items], float)
        value.setflags(write=False)
        return value

    @cached_property
    def initial(self) -> np.ndarray:
        """theta_0 (n,), the prior's mode before the bounds cut it."""
        return self._column("initial")

    @cached_property
    def std(self) -> np.ndarray:
        return self._column("std")

    @cached_property
    def lower(self) -> np.ndarray:
        """Lower bounds; a lognormal's is zero at least."""
        value = np.where([p.prior == "lognormal" for p in self.items], np.maximum(self._column("lower"), 0.0),
                         self._column("lower"))
        value.setflags(write=False)
        return value

    @cached_property
    def _zero_at_bound(self) -> np.ndarray:
        """Parameters whose density is zero at their lower bound of zero."""
        return np.array([p.prior == "lognormal" and p.lower <= 0 for p in self.items], bool)

    @cached_property
    def upper(self) -> np.ndarray:
        return self._column("upper")

    @cached_property
    def covariance(self) -> np.ndarray:
        """Sigma_theta (n, n) in theta's units; W_Theta of Eq. 6 is its inverse."""
        c = np.eye(len(self)) if self.correlation is None else self.correlation
        return c * np.outer(self.std, self.std)

    @property
    def normalised(self) -> bool:
        return self.correlation is None

    def index(self, name: str) -> int:
        if name not in self.names:
            raise InputError(f"parameter {name}", "not among the updated ones", f"choose from {', '.join(self.names)}")
        return self.names.index(name)

    def hold_parameters(self, values: Mapping[str, float]) -> Parameters:
        """The others alone, these held at values of their own. Raises InputError for a name that is not among them, a
        value outside its bounds, one that the prior correlates with another, or where none is left."""
        for name, value in values.items():
            if name not in self.names:
                near = difflib.get_close_matches(name, self.names, n=1)
                raise InputError(f"fix, {name}", "is not an updated parameter",
                                 f"did you mean '{near[0]}'?" if near else
                                 f"choose from {', '.join(self.names)}")
            own = self.items[self.index(name)]
            if not own.lower <= value <= own.upper:
                raise InputError(f"fix, {name}", f"{value:g} is outside its bounds",
                                 f"give a value from {own.lower:g} to {own.upper:g}")
        kept = [k for k, p in enumerate(self.items) if p.name not in values]
        if not kept:
            raise InputError("fix", "no parameter is left to update", "hold fewer of them")
        correlation = self.correlation
        if correlation is not None:
            across = np.delete(correlation[kept], kept, axis=1)
            if np.any(across != 0):
                row, column = np.argwhere(across != 0)[0]
                other = [n for n in self.names if n in values][column]
                raise InputError(f"fix, {other}", f"its prior is correlated with that of {self.items[kept[row]].name}",
                                 "hold both, or take it out of [correlation]")
            correlation = correlation[np.ix_(kept, kept)]
        held = (*self.held, *((name, float(value)) for name, value in values.items()))
        return Parameters(tuple(self.items[k] for k in kept), correlation, held)

    def inside(self, theta: np.ndarray) -> np.ndarray:
        """Which rows of theta (..., n) lie within the bounds, where the density is above zero -> (...,) bool."""
        theta = np.asarray(theta)
        return np.all((theta >= self.lower) & (theta <= self.upper) & ~(self._zero_at_bound & (theta == 0)), axis=-1)

    @cached_property
    def _ends(self) -> tuple[np.ndarray, np.ndarray]:
        """The bounds in standardised coordinates (n,), in which the prior is the joint Gaussian."""
        low, high = np.full(len(self), -np.inf), np.full(len(self), np.inf)
        for k, p in enumerate(self.items):
            if p.prior == "normal":
                low[k], high[k] = (p.lower - p.initial) / p.std, (p.upper - p.initial) / p.std
            elif p.prior == "lognormal":
                low[k] = np.log(p.lower / p.initial) / p.log_std if p.lower > 0 else -np.inf
                high[k] = np.log(p.upper / p.initial) / p.log_std
        return low, high

    @cached_property
    def log_mass(self) -> tuple[float, float]:
        """ln of the share of a correlated prior that lies within its bounds, and its standard deviation; (0, 0) of an
        independent one, whose marginals are normalised there."""
        if self.correlation is None:
            return 0.0, 0.0
        return log_box_probability(*self._ends, self.correlation, np.random.default_rng(0))

    @cached_property
    def moments(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation (n_param,) of each parameter under the joint prior within all bounds."""
        if self.correlation is None:
            return tuple(np.array([float(getattr(p.distribution, name)()) for p in self]) for name in ("mean", "std"))
        drawn = self.draw(np.random.default_rng(0), N_MOMENT)
        return drawn.mean(axis=0), drawn.std(axis=0, ddof=1)

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        """ln p(theta) (...,), -inf outside the bounds."""
        theta = np.asarray(theta, float)
        inside = self.inside(theta)
        safe = np.where(inside[..., None], theta, self.initial)
        if self.correlation is None:
            value = self.log_marginals(safe)
        else:
            z, log_jacobian = self._standardise(safe)
            factor = linalg.cholesky(self.correlation, lower=True)
            white = linalg.solve_triangular(factor, np.moveaxis(z, -1, 0).reshape(len(self), -1), lower=True)
            value = -0.5 * np.sum(white**2, axis=0).reshape(z.shape[:-1]) + log_jacobian
        return np.where(inside, value, -np.inf)

    def log_marginals(self, theta: np.ndarray) -> np.ndarray:
        """Sum of the own ln p(theta_k) (...,), ln p(theta) itself without correlation; inside the bounds only."""
        # a few operations for all parameters together: chains ask for this once a step
        z, log_jacobian = self._standardise(theta)
        return log_jacobian - 0.5 * np.sum(z**2, axis=-1) + self._log_constant

    @cached_property
    def _log_constant(self) -> float:
        """What the distributions, normalised within the bounds, add."""
        z, log_jacobian = self._standardise(self.initial)
        exact = sum(float(p.distribution.logpdf(p.initial)) for p in self.items)
        return exact - float(log_jacobian - 0.5 * np.sum(z**2))

    def _standardise(self, theta):
        z = np.empty_like(theta)
        log_jacobian = np.zeros(theta.shape[:-1])
        for k, p in enumerate(self.items):
            if p.prior == "normal":
                z[..., k] = (theta[..., k] - p.initial) / p.std
            elif p.prior == "lognormal":
                z[..., k] = np.log(theta[..., k] / p.initial) / p.log_std
                log_jacobian -= np.log(theta[..., k] * p.log_std)
            else:
                z[..., k] = 0.0
        return z, log_jacobian

    def draw(self, rng: np.random.Generator, n: int) -> np.ndarray:
        """n draws from the prior (n, n_param)."""
        if self.correlation is None:
            return np.column_stack([p.distribution.rvs(size=n, random_state=rng) for p in self.items])
        z = draws_in_box(*self._ends, self.correlation, rng, n)
        theta = np.empty_like(z)
        for k, p in enumerate(self.items):
            if p.prior == "normal":
                theta[:, k] = p.initial + p.std * z[:, k]
            elif p.prior == "lognormal":
                theta[:, k] = p.initial * np.exp(p.log_std * z[:, k])
            else:
                theta[:, k] = p.distribution.rvs(size=n, random_state=rng)
        # rounding may leave a draw a hair outside
        return np.clip(theta, self.lower, self.upper)
