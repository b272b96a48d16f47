"""Equally weighted draws of a posterior and their joint distribution by marginals and Gaussian correlation (Nataf)."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from probupdate.errors import InputError, parsing
from probupdate.io.files import read_json_table
from probupdate.io.schema import checked_table
from probupdate.runtime.arrays import frozen_array

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
    refuse_draws(draws, n)
    return draws[rng.choice(len(draws), size=n, replace=False)]


def refuse_draws(draws: np.ndarray, n: int) -> None:
    """Raises InputError where n cannot be taken of them."""
    if n < 1 or n > len(draws):
        raise InputError("draws", f"{n} are asked for, the posterior has {len(draws)}", "ask for as many or fewer")


def joint_of(names: tuple[str, ...], draws: np.ndarray) -> Joint:
    """The joint distribution of all draws: every marginal as it is, the dependence Gaussian with the correlation of
    normal scores."""
    n = len(draws)
    level = np.linspace(0.0, 1.0, LEVELS)
    score = stats.norm.ppf((stats.rankdata(draws, axis=0) - 0.5) / n)
    correlation = np.atleast_2d(np.corrcoef(score, rowvar=False))
    return Joint(
        names=names,
        level=frozen_array(level),
        quantile=frozen_array(np.quantile(draws, level, axis=0)),
        correlation=frozen_array(correlation),
        mean=frozen_array(draws.mean(axis=0)),
        std=frozen_array(draws.std(axis=0, ddof=1)),
        rank_correlation=frozen_array(np.atleast_2d(np.corrcoef(stats.rankdata(draws, axis=0), rowvar=False))),
    )


@dataclass(frozen=True, kw_only=True)
class JointTable:
    """What joint.json holds of the distribution."""

    kind: str
    parameters: tuple[str, ...]
    mean: tuple[float, ...]
    std: tuple[float, ...]
    level: tuple[float, ...]
    quantile: tuple[tuple[float, ...], ...]
    normal_correlation: tuple[tuple[float, ...], ...]
    rank_correlation: tuple[tuple[float, ...], ...]


def read_joint(path: str | Path) -> Joint:
    """joint.json of an export. Raises InputError where it is none, its levels or quantiles do not rise, or its
    correlation is none."""
    path, again = Path(path), "write it again with `probupdate export`"
    table = read_json_table(path, again)
    checked_table(JointTable, table, path, again)
    names, n = tuple(table["parameters"]), len(table["parameters"])
    with parsing(str(path), "its tables are not of one size", again):
        level, quantile = np.array(table["level"], float), np.array(table["quantile"], float).T
        correlation, ranks = (np.array(table[key], float) for key in ("normal_correlation", "rank_correlation"))
        mean, std = np.array(table["mean"], float), np.array(table["std"], float)
    good = n > 0 and table["kind"] == "nataf" and quantile.shape == (len(level), n) and len(level) > 1
    good = good and mean.shape == std.shape == (n,) and correlation.shape == ranks.shape == (n, n)
    if not good:
        raise InputError(str(path), "its tables are not of one size, or its kind is not nataf", again)
    if level[0] != 0 or level[-1] != 1 or np.any(np.diff(level) <= 0) or np.any(np.diff(quantile, axis=0) < 0):
        raise InputError(str(path), "its levels do not rise from 0 to 1, or its quantiles do not rise", again)
    if (
        np.abs(correlation - correlation.T).max() > 1e-9
        or np.linalg.eigvalsh(correlation)[0] <= 0
        or not np.allclose(np.diag(correlation), 1.0, atol=1e-9)
    ):
        raise InputError(str(path), "normal_correlation is not a correlation matrix", again)
    return Joint(
        names=names,
        level=frozen_array(level),
        quantile=frozen_array(quantile),
        mean=frozen_array(mean),
        std=frozen_array(std),
        correlation=frozen_array(correlation),
        rank_correlation=frozen_array(ranks),
    )


def to_openturns(joint: Joint):
    """The same distribution as an `openturns.JointDistribution`: marginals with densities constant between quantiles
    and a normal copula, for its samplers and its FORM. Needs `pip install probupdate[openturns]`."""
    try:
        ot: Any = import_module("openturns")
    except ImportError:
        raise InputError("openturns", "is not installed", "pip install probupdate[openturns]") from None
    marginals = []
    for name, column in zip(joint.names, joint.quantile.T, strict=True):
        width, share = np.diff(column), np.diff(joint.level)
        # equal quantiles, as of a bound that draws lie on, are a step a rounding wide
        least = 1e-9 * max(column[-1] - column[0], np.abs(column).max(), 1e-300)
        width = np.maximum(width, least)
        one = ot.Histogram(float(column[0]), width.tolist(), (share / width).tolist())
        one.setDescription([name])
        marginals.append(one)
    correlation = ot.CorrelationMatrix(len(joint.names), joint.correlation.ravel().tolist())
    both = ot.JointDistribution(marginals, ot.NormalCopula(correlation))
    both.setDescription(list(joint.names))
    return both
