"""Reliability index of every hot spot over the years, from Miner's sum with stated uncertainties.

Failure by year t: ln Delta + e ln 10 - ln t - ln d(X_load X_SCF X_dyn) < 0, with Delta Miner's sum at failure, e the
error of log10 N, both slopes alike, d the damage of a year as a function of a factor on every stress range, not a power
where the curve has two slopes. FORM: the nearest point of the limit surface to the origin of standard normal space, by
the iteration of Hasofer & Lind (1974) and Rackwitz & Fiessler (1978); beta = Phi^-1(1 - P_f). The annual index is that
of failing in year t when year t - 1 was survived.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import stats
from scipy.interpolate import CubicSpline
from scipy.special import logsumexp

from probupdate.errors import ConvergenceError
from probupdate.lifetime.conditions import Lognormal, Uncertainty
from probupdate.lifetime.fatigue import Stress
from probupdate.runtime.arrays import frozen_array

# ln of the factor on stress ranges between which damage is tabulated
RANGE, STEP = 2.5, 0.05
ITERATIONS, HALVED, SETTLED = 200, 20, 1e-9
# nodes of quadrature over the factor on ranges, in standard deviations to either side: trapezoids of a normal density
# err less than rounding
REACH, N_NODE = 8.0, 161
# ln of the shortest and longest lives looked through; halvings between them
LOG_YEARS, HALVINGS = (-30.0, 80.0), 40


def form(
    limit: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]], shape: tuple[int, ...], n_variable: int
) -> tuple[np.ndarray, np.ndarray]:
    """beta (*shape) and design points u (*shape, n_variable) of many limit states in standard normal space at once.

    `limit`: u -> g (*shape) and its gradient (*shape, n_variable); failure is g < 0; beta is negative where the origin
    fails. Raises ConvergenceError where the iteration does not settle.
    """
    u = np.zeros((*shape, n_variable))
    g0, step = limit(u)[0], np.inf
    for number in range(ITERATIONS):
        g, slope = limit(u)
        size = np.sum(slope**2, axis=-1)
        new = ((np.sum(slope * u, axis=-1) - g) / size)[..., None] * slope
        step = np.max(np.abs(new - u), initial=0.0)
        # half steps where whole ones go to and fro
        u = 0.5 * (u + new) if number > HALVED else new
        if step < SETTLED:
            break
    else:
        raise ConvergenceError(f"FORM did not converge: last step {step:.1e}", u)
    return np.sign(g0) * np.linalg.norm(u, axis=-1), u


def log_std(variable: Lognormal) -> float:
    """Standard deviation of the logarithm: sqrt(ln(1 + CoV^2))."""
    return float(np.sqrt(np.log1p(variable.cov**2)))


@dataclass(frozen=True, eq=False, kw_only=True)
class DamageCurve:
    """ln of a year's damage of every hot spot as a function of ln factor on its stress ranges: a cubic spline between
    tabulated values, straight beyond."""

    at: np.ndarray
    log_damage: np.ndarray

    @classmethod
    def from_stress(cls, stress: Stress) -> DamageCurve:
        at = np.arange(-RANGE, RANGE + STEP / 2, STEP)
        with np.errstate(divide="ignore"):
            table = np.array([np.log(stress.damage_per_year(np.exp(b))) for b in at])
        return cls(at=frozen_array(at), log_damage=frozen_array(table))

    @property
    def n_spot(self) -> int:
        return self.log_damage.shape[1]

    def select(self, spots) -> DamageCurve:
        return DamageCurve(at=self.at, log_damage=frozen_array(self.log_damage[:, spots]))

    def value(self, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """ln damage and its derivative at b (n_spot, n) for each spot."""
        inside = np.clip(b, self.at[0], self.at[-1])
        value, slope = np.empty(b.shape), np.empty(b.shape)
        for k, spline in enumerate(self._splines):
            value[k], slope[k] = spline(inside[k]), spline(inside[k], 1)
        return value + slope * (b - inside), slope

    @cached_property
    def _splines(self) -> list[CubicSpline]:
        return [CubicSpline(self.at, column) for column in self.log_damage.T]

    def factor(self, log_damage: np.ndarray) -> np.ndarray:
        """(n_spot,) ln of the factor at which a year's damage has this logarithm (n_spot,)."""
        pairs = zip(log_damage, self.log_damage.T, strict=True)
        near = np.array([np.interp(v, column, self.at) for v, column in pairs])
        value, slope = self.value(near[:, None])
        # a step of Newton's: beyond the table the curve is straight
        return near + (log_damage - value[:, 0]) / slope[:, 0]


@dataclass(frozen=True, eq=False, kw_only=True)
class Reliability:
    """year (n_year,), cumulative and annual index (n_spot, n_year); first_below (n_spot,): the first year whose annual
    index is below the target, 0 where none is."""

    year: np.ndarray
    cumulative: np.ndarray
    annual: np.ndarray
    first_below: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class _Limit:
    """g of ln t for standard normal (resistance, stress factor)."""

    curve: DamageCurve
    mean: np.ndarray
    std: np.ndarray
    resistance_mean: float
    resistance_std: float
    log_time: np.ndarray

    def __call__(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        value, slope = self.curve.value(self.mean[:, None] + self.std[:, None] * u[..., 1])
        g = self.resistance_mean + self.resistance_std * u[..., 0] - self.log_time - value
        return g, np.stack([np.full(g.shape, self.resistance_std), -slope * self.std[:, None]], axis=-1)


def _limit(curve: DamageCurve, mean, std, uncertainty: Uncertainty, years: int) -> _Limit:
    load, scf, miner = uncertainty.x_load, uncertainty.x_scf, uncertainty.miner
    return _Limit(
        curve=curve,
        mean=np.asarray(mean, float) + np.log(load.median) + np.log(scf.median),
        std=np.sqrt(np.asarray(std, float) ** 2 + log_std(load) ** 2 + log_std(scf) ** 2),
        resistance_mean=float(np.log(miner.median)),
        resistance_std=float(np.hypot(log_std(miner), np.log(10) * uncertainty.log10_a_std)),
        log_time=np.log(np.arange(1, years + 1)),
    )


def annual_index(cumulative: np.ndarray) -> np.ndarray:
    """Indices of failing in a year when all before were survived, from those of failing up to it (..., n_year)."""
    survival = stats.norm.logcdf(cumulative)
    before = np.concatenate([np.zeros((*cumulative.shape[:-1], 1)), survival[..., :-1]], axis=-1)
    # 1 - S(t) / S(t - 1), without the difference of two ones
    return -stats.norm.ppf(np.clip(-np.expm1(survival - before), 1e-300, 1.0))


def reliability(
    curve: DamageCurve, mean: np.ndarray, std: np.ndarray, uncertainty: Uncertainty, *, years: int, target: float
) -> Reliability:
    """By FORM. `curve`: damage at the design; mean, std (n_spot,): of ln X_dyn, the factor on the design's stress
    ranges."""
    limit = _limit(curve, mean, std, uncertainty, years)
    cumulative, _ = form(limit, (curve.n_spot, years), 2)
    annual = annual_index(cumulative)
    below = annual < target
    first = np.where(below.any(axis=1), np.argmax(below, axis=1) + 1, 0)
    return Reliability(
        year=frozen_array(np.arange(1, years + 1), int),
        cumulative=frozen_array(cumulative),
        annual=frozen_array(annual),
        first_below=frozen_array(first, int),
    )


def simulated_index(
    curve: DamageCurve,
    mean: np.ndarray,
    std: np.ndarray,
    uncertainty: Uncertainty,
    *,
    years: int,
    n: int,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Cumulative index (n_spot, years) by Monte Carlo with draws about FORM's design point (importance sampling), and
    its standard error: every variable of its own, Miner's sum, S-N, load, stress factor and X_dyn."""
    limit = _limit(curve, mean, std, uncertainty, years)
    safe, u = form(limit, (curve.n_spot, years), 2)
    resistance = np.array([log_std(uncertainty.miner), np.log(10) * uncertainty.log10_a_std])
    index, error = np.empty(u.shape[:2]), np.empty(u.shape[:2])
    for k in range(curve.n_spot):
        stress = np.array([log_std(uncertainty.x_load), log_std(uncertainty.x_scf), float(np.asarray(std)[k])])
        one = curve.select([k])
        for t in range(years):
            # the design point in all five variables: each takes its share of the combined one
            centre = np.concatenate(
                [u[k, t, 0] * resistance / np.linalg.norm(resistance), u[k, t, 1] * stress / np.linalg.norm(stress)]
            )
            z = rng.standard_normal((n, 5)) + centre
            b = limit.mean[k] + z[:, 2:] @ stress
            g = limit.resistance_mean + z[:, :2] @ resistance - limit.log_time[t] - one.value(b[None])[0][0]
            log_weight = 0.5 * centre @ centre - z @ centre
            # whichever is the rarer: draws lie about the limit
            side = 1.0 if safe[k, t] >= 0 else -1.0
            weight = np.where(side * g < 0, np.exp(log_weight), 0.0)
            p = weight.mean()
            index[k, t] = -side * stats.norm.ppf(p)
            error[k, t] = weight.std(ddof=1) / np.sqrt(n) / stats.norm.pdf(index[k, t])
    return index, error


def survival(curve: DamageCurve, mean: np.ndarray, std: np.ndarray, uncertainty: Uncertainty,
             log_years: np.ndarray) -> np.ndarray:
    """(n_spot, n) ln of the probability that a hot spot survives exp(log_years) (n_spot, n), all uncertainties in: the
    resistance's normal distribution in closed form, that of the factor on ranges by quadrature."""
    limit = _limit(curve, mean, std, uncertainty, 1)
    node = np.linspace(-REACH, REACH, N_NODE)
    log_weight = stats.norm.logpdf(node) + np.log(node[1] - node[0])
    value = curve.value(limit.mean[:, None] + limit.std[:, None] * node)[0]
    # where nothing is uncertain a step
    scale = max(limit.resistance_std, 1e-12)
    z = (limit.resistance_mean - value[:, None, :] - log_years[:, :, None]) / scale
    return logsumexp(stats.norm.logcdf(z) + log_weight, axis=2)


def life_quantiles(
    curve: DamageCurve, mean: np.ndarray, std: np.ndarray, uncertainty: Uncertainty, levels: np.ndarray, *,
    survived_years: float = 0.0,
) -> np.ndarray:
    """(n_spot, n_level) years to Miner's sum at failure, given survival up to an age."""
    shape = (curve.n_spot, len(levels))
    known = np.zeros((curve.n_spot, 1)) if survived_years <= 0 else survival(
        curve, mean, std, uncertainty, np.full((curve.n_spot, 1), np.log(survived_years)))
    wanted = known + np.log1p(-np.asarray(levels, float))
    low = np.full(shape, np.log(survived_years) if survived_years > 0 else LOG_YEARS[0])
    high = np.full(shape, LOG_YEARS[1])
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        longer = survival(curve, mean, std, uncertainty, middle) > wanted
        low, high = np.where(longer, middle, low), np.where(longer, high, middle)
    return np.exp(0.5 * (low + high))
