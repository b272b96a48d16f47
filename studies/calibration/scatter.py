"""Calibration of the scatter between sets: 90 % intervals of tau from campaigns whose sets scatter by a known tau.

    python -m studies.calibration.scatter [--campaigns 200] [--first 0]

One parameter, sets identified to sigma (a twentieth of its prior's standard deviation), drawn about one mean with
tau = 0, 0.5, 1, 3 sigma. The density is the package's (`SetLikelihoods.marginal`, its hyper-prior) on a grid of mean
and tau; `scatter_interval` is given draws of it. The chain is checked against quadrature in the tests.
"""

from __future__ import annotations

import argparse

import numpy as np

from probupdate.updating.hierarchical import SPREAD, scatter_interval
from probupdate.updating.set_likelihoods import SetLikelihoods

SIGMA = 0.05
N_SETS, RATIOS = (3, 9, 30), (0.0, 0.5, 1.0, 3.0)
N_DRAW, N_MEAN = 1000, 61
TAU = np.concatenate([[0.0], np.geomspace(1e-3, 5 * SPREAD, 80)])


def campaign(seed: int, n_set: int, ratio: float) -> tuple[float, float]:
    """Interval of tau in prior standard deviations."""
    rng = np.random.default_rng([seed, n_set, int(10 * ratio)])
    y = 1 + rng.standard_normal() + SIGMA * np.hypot(1, ratio) * rng.standard_normal(n_set)
    sets = SetLikelihoods(ids=tuple(map(str, range(n_set))), centre=y[:, None], value=np.zeros(n_set),
                          gradient=np.zeros((n_set, 1)), precision=np.full((n_set, 1, 1), SIGMA**-2))
    reach = np.sqrt((np.var(y) + SIGMA**2) / n_set)
    near = y.mean() + reach * np.linspace(-8, 8, N_MEAN)
    mean, tau = (x.ravel() for x in np.meshgrid(near, TAU, indexing="ij"))
    value = sets.marginal(mean[:, None], tau[:, None, None]).sum(axis=1)
    value += -0.5 * (mean - 1) ** 2 - 0.5 * (tau / SPREAD) ** 2
    density = np.exp(value - value.max()).reshape(N_MEAN, -1).sum(axis=0)
    below = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(TAU))])
    return scatter_interval(np.interp((np.arange(N_DRAW) + 0.5) / N_DRAW * below[-1], below, TAU))


def coverage(campaigns: range, n_set: int, ratio: float) -> float:
    """Share of campaigns whose interval holds tau."""
    found = np.array([campaign(k, n_set, ratio) for k in campaigns])
    return float(np.mean((found[:, 0] <= ratio * SIGMA) & (ratio * SIGMA <= found[:, 1])))


def table(campaigns: range) -> str:
    lines = ["| sets | " + " | ".join(f"tau / sigma {r:g}" for r in RATIOS) + " |", "|---" * (1 + len(RATIOS)) + "|"]
    lines += [f"| {n} | " + " | ".join(f"{100 * coverage(campaigns, n, r):.0f}" for r in RATIOS) + " |" for n in N_SETS]
    return "\n".join(lines)


def main():
    p = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    p.add_argument("--campaigns", type=int, default=200)
    p.add_argument("--first", type=int, default=0)
    a = p.parse_args()
    print(table(range(a.first, a.first + a.campaigns)))


if __name__ == "__main__":
    main()
