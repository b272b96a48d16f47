"""Equally weighted draws of a posterior and their joint distribution by marginals and Gaussian correlation (Nataf)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from probupdate.errors import InputError
from probupdate.modes import frozen_array

# points of a marginal's quantile function
LEVELS = 201


@dataclass(frozen=True, eq=False, kw_only=True)
class Joint:
    """Nataf: theta_k = q_k(Phi(z_k)), z Gaussian with `correlation` (n_param, n_param); quantile (LEVELS, n_param) at
    level (LEVELS,), linear between. mean, std (n_param,) and rank correlation are those of the draws."""

    names: tuple[str, ...]
    level: np.ndarray
    quantile: np.ndarray
    correlation: np.ndarray
    mean: np.ndarray
    std: np.ndarray
    rank_correlation: np.ndarray

    def sample(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """(n, n_param)."""
        z = rng.standard_normal((n, len(self.names))) @ np.linalg.cholesky(self.correlation).T
        u = stats.norm.cdf(z)
        return np.column_stack([np.interp(u[:, k], self.level, self.quantile[:, k]) for k in range(len(self.names))])


def equal_draws(draws: np.ndarray, n: int, rng: np.random.Generator) -> np.ndarray:
    """n of the posterior's draws (n_draw, n_param), each as likely as any other, none twice; in the order drawn."""
    if n < 1 or n > len(draws):
        raise InputError("draws", f"{n} are asked for, the posterior has {len(draws)}", "ask for as many or fewer")
    return draws[rng.choice(len(draws), size=n, replace=False)]


def joint_of(names: tuple[str, ...], draws: np.ndarray) -> Joint:
    """The joint distribution of all draws: every marginal as it is, the dependence Gaussian with the correlation of
    normal scores."""
    n = len(draws)
    level = np.linspace(0.0, 1.0, LEVELS)
    score = stats.norm.ppf((stats.rankdata(draws, axis=0) - 0.5) / n)
    correlation = np.atleast_2d(np.corrcoef(score, rowvar=False))
    return Joint(
        names=names, level=frozen_array(level), quantile=frozen_array(np.quantile(draws, level, axis=0)),
        correlation=frozen_array(correlation), mean=frozen_array(draws.mean(axis=0)),
        std=frozen_array(draws.std(axis=0, ddof=1)),
        rank_correlation=frozen_array(np.atleast_2d(np.corrcoef(stats.rankdata(draws, axis=0), rowvar=False))),
    )  # fmt: skip
