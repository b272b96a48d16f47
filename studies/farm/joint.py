"""Drawn farms in one inference: do 90 % intervals hold, are odd turbines found, do widths shrink as theory says?

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python studies/farm/joint.py OUT [--farms 200] [--sizes 3 10 30]
                                                                          [--first SEED]

A turbine is a chain of springs and masses, solved with scipy; ln of six frequencies is measured three times. Two
stiffnesses are common, two parameters vary between turbines with a scatter drawn from its hyper-prior, two are each
turbine's own, and one error of every frequency is the same for all. In every third farm one turbine's common or varying
parameter is off by 1 to 2 times the limit that is stated for it without this turbine's data. Truth is drawn from the
prior, responses are linear (`--curved`: they are not, and the linear system is made at the prior's centre).

The second route to the widths: all unknowns of a farm in one dense Gaussian at the true scatter, by plain numpy.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import linalg

from probupdate.updating.joint_draws import JointDraws, draw_linear, weighted_quantile
from probupdate.updating.joint_odd import SURE, odd_turbines
from probupdate.updating.joint_scales import Scales, sample_scales
from probupdate.updating.joint_system import FarmSystem, Layout, Roles
from probupdate.updating.shared_error import Inner

NAMES = ("base", "steel", "grout", "growth", "scour", "mass")
STD = np.array([0.3, 0.1, 0.3, 0.2, 0.2, 0.05])
ROLES = Roles(names=NAMES, common=("steel", "grout"), varying=("base", "growth"))
SHARED, OWN = [1, 2, 0, 3], [4, 5]
N_MASS, N_MODE, N_SET, NOISE, ERROR, SPREAD, WIDE = 9, 6, 3, 0.003, 0.003, 0.25, 1.0
# turbines differ in their springs by this share, known of each
KNOWN = 0.1
LAYOUT = Layout.from_roles(ROLES, np.diag(STD**2), np.zeros(6))
SCALES = Scales(spread=SPREAD * STD[[0, 3]], hyper=np.zeros(3), learnt=False)
WIDTH = WIDE * STD[SHARED]


def ln_frequencies(theta: np.ndarray, known: np.ndarray) -> np.ndarray:
    """ln of the lowest frequencies (6,) of a chain whose springs (9,) are known up to theta (6,)."""
    base, steel, grout, growth, scour, mass = theta
    factor = np.ones(N_MASS)
    factor[0] = np.exp(base + scour)
    factor[1] = np.exp(scour)
    factor[2:6] = np.exp(steel)
    factor[6:] = np.exp(grout)
    spring = known * factor
    K = np.diag(spring)
    K[:-1, :-1] += np.diag(spring[1:])
    K -= np.diag(spring[1:], 1) + np.diag(spring[1:], -1)
    M = np.ones(N_MASS)
    M[1:4] *= np.exp(growth)
    M[-1] *= 2 * np.exp(mass)
    return 0.5 * np.log(linalg.eigh(K, np.diag(M), eigvals_only=True)[:N_MODE])


def slopes(known: np.ndarray) -> np.ndarray:
    """(6, 6) by differences at the prior's centre."""
    step = 1e-4
    return np.column_stack([(ln_frequencies(step * e, known) - ln_frequencies(-step * e, known)) / (2 * step)
                            for e in np.eye(6)])


@dataclass(frozen=True, eq=False)
class DrawnFarm:
    """u (n, 6) of the turbines, mu and common in z (4,), tau (2,), slopes (n, 6, 6), y (n, N_SET, 6) about the prior's
    centre."""

    u: np.ndarray
    z: np.ndarray
    tau: np.ndarray
    slope: np.ndarray
    y: np.ndarray

    def system(self) -> FarmSystem:
        inners = []
        for A, rows in zip(self.slope, self.y, strict=True):
            white = np.vstack([np.column_stack([row, A, ERROR * np.eye(N_MODE)]) for row in rows]) / NOISE
            inners.append(Inner(middle=np.zeros(6), products=white.T @ white, constant=0.0,
                                kind=np.zeros(N_MODE, int)))  # SOURCE: standard normal
        return FarmSystem.assemble(inners, LAYOUT)

    def shifted(self, i: int, k: int, size: float) -> DrawnFarm:
        """With turbine i's parameter SHARED[k] off by `size`."""
        u, y = self.u.copy(), self.y.copy()
        u[i, SHARED[k]] += size
        y[i] += size * self.slope[i][:, SHARED[k]]
        return DrawnFarm(u, self.z, self.tau, self.slope, y)

    def dense_std(self) -> np.ndarray:
        """Posterior standard deviations (4,) of z at the true scatter: everything stacked."""
        n = len(self.u)
        size = 4 + 4 * n
        prior = np.zeros((size, size))
        prior[range(4), range(4)] = STD[SHARED] ** 2
        A = np.zeros((n, N_SET, N_MODE, size))
        for i in range(n):
            own = 4 + 4 * i + np.arange(4)
            prior[own, own] = np.r_[self.tau**2, STD[OWN] ** 2]
            A[i, :, :, :4] = self.slope[i][:, SHARED]
            A[i][:, :, own] = self.slope[i][:, [0, 3, 4, 5]]
        A = A.reshape(-1, size)
        # about the error that all have in common nothing is known but its size
        C = np.kron(np.ones((n * N_SET, n * N_SET)), ERROR**2 * np.eye(N_MODE)) + NOISE**2 * np.eye(len(A))
        gain = linalg.solve(A @ prior @ A.T + C, A @ prior, assume_a="pos")
        return np.sqrt(np.diag(prior - prior @ A.T @ gain)[:4])


def drawn_farm(n: int, rng: np.random.Generator, curved: bool) -> DrawnFarm:
    z = STD[SHARED] * rng.standard_normal(4)
    tau = np.abs(SCALES.spread * rng.standard_normal(2))
    u = np.column_stack([z[2] + tau[0] * rng.standard_normal(n), np.full(n, z[0]), np.full(n, z[1]),
                         z[3] + tau[1] * rng.standard_normal(n), STD[4] * rng.standard_normal(n),
                         STD[5] * rng.standard_normal(n)])
    known = 1 + KNOWN * rng.uniform(-1, 1, (n, N_MASS))
    slope = np.array([slopes(k) for k in known])
    exact = np.einsum("ijk,ik->ij", slope, u)
    if curved:
        exact = np.array([ln_frequencies(t, k) - ln_frequencies(0 * t, k) for t, k in zip(u, known, strict=True)])
    error = ERROR * rng.standard_normal(N_MODE)
    y = exact[:, None] + error + NOISE * rng.standard_normal((n, N_SET, N_MODE))
    return DrawnFarm(u, z, tau, slope, y)


def one_farm(n: int, seed: int, curved: bool) -> dict:
    """Hits of 90 % intervals by kind, widths, and what is said of odd turbines."""
    rng = np.random.default_rng([seed, n])
    farm, odd = drawn_farm(n, rng, curved), None
    if seed % 3 == 0:
        limit = odd_turbines(farm.system(), SCALES, WIDTH, seed=seed).limit
        i, k = int(rng.integers(n)), int(rng.integers(4))
        if np.isfinite(limit[i, k]):
            odd = i, k
            farm = farm.shifted(i, k, float(rng.choice([-1, 1]) * rng.uniform(1, 2) * limit[i, k]))
    system = farm.system()
    found = odd_turbines(system, SCALES, WIDTH, seed=seed)
    system = system.with_odd_scale(found.outlier_scale(WIDTH))
    chain = sample_scales(SCALES, system, SCALES.maximum(system), seed=seed)
    drawn = draw_linear(system, SCALES, chain, seed=seed, n=1000)
    draws = JointDraws(z=drawn.z, e=drawn.e, tau=drawn.tau, u=drawn.d, log_weight=np.zeros(1000))
    weight, _ = draws.weigh()
    hits = {}
    for kind, values, truth in (
            ("common", draws.z[:, :2], farm.z[:2]), ("mean of varying", draws.z[:, 2:], farm.z[2:]),
            ("scatter", draws.tau, farm.tau), ("varying", draws.u[:, :, [0, 3]], farm.u[:, [0, 3]]),
            ("own", draws.u[:, :, OWN], farm.u[:, OWN])):
        low, high = weighted_quantile(values, weight, (0.05, 0.95))
        inside = (low <= truth) & (truth <= high)
        hits[kind] = [int(inside.sum()), int(inside.size)]
    named = [int(i) for i in found.numbers]
    return {"hits": hits, "odd": odd, "named": named, "std": (draws.z.std(axis=0)).tolist(),
            "dense": farm.dense_std().tolist(), "converged": chain.converged}


def table(rows: list[dict]) -> dict:
    kinds = rows[0]["hits"]
    coverage = {k: sum(r["hits"][k][0] for r in rows) / sum(r["hits"][k][1] for r in rows) for k in kinds}
    # turbines of one farm share its common part: the standard error is that over farms
    error = {k: float(np.std([r["hits"][k][0] / r["hits"][k][1] for r in rows]) / np.sqrt(len(rows))) for k in kinds}
    with_odd = [r for r in rows if r["odd"]]
    std, dense = (np.array([r[name] for r in rows]) for name in ("std", "dense"))
    return {
        "farms": len(rows), "coverage": coverage, "coverage_se": error, "with_odd": len(with_odd),
        "odd_named": sum(r["odd"][0] in r["named"] for r in with_odd),
        "wrong_farms": sum(bool(set(r["named"]) - {r["odd"][0] if r["odd"] else None}) for r in rows),
        "wrong_turbines": sum(len(set(r["named"]) - {r["odd"][0] if r["odd"] else None}) for r in rows),
        "turbines": sum(r["hits"]["own"][1] // 2 for r in rows),
        "std": np.exp(np.log(std).mean(axis=0)).tolist(),
        "std_over_dense": np.exp(np.log(std / dense)[[not r["odd"] for r in rows]].mean(axis=0)).tolist(),
        "not_converged": sum(not r["converged"] for r in rows)}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--farms", type=int, default=200)
    parser.add_argument("--sizes", type=int, nargs="+", default=[3, 10, 30])
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--curved", action="store_true")
    a = parser.parse_args()
    a.out.mkdir(parents=True, exist_ok=True)
    for n in a.sizes:
        begun, rows = time.process_time(), []
        kept = a.out / f"farms_of_{n}{'_curved' if a.curved else ''}.jsonl"
        if kept.exists():
            rows = [json.loads(line) for line in kept.read_text(encoding="utf-8").splitlines()]
        with kept.open("a", encoding="utf-8") as stream:
            for seed in range(a.first + len(rows), a.first + a.farms):
                rows.append(one_farm(n, seed, a.curved))
                print(json.dumps(rows[-1]), file=stream, flush=True)
        found = table(rows[: a.farms])
        cover = ", ".join(f"{k} {100 * v:.1f} +- {100 * found['coverage_se'][k]:.1f} %"
                          for k, v in found["coverage"].items())
        print(f"{n} turbines, {found['farms']} farms: {cover}")
        print(f"  odd turbines named {found['odd_named']} of {found['with_odd']}; others named "
              f"{found['wrong_turbines']} of {found['turbines']} turbines, in {found['wrong_farms']} farms "
              f"(named from {SURE:g} on)")
        print("  standard deviations of " + ", ".join(
            f"{NAMES[k]} {s:.4f} ({r:.3f} of the dense)" for k, s, r in zip(SHARED, found["std"],
                                                                            found["std_over_dense"], strict=True)))
        print(f"  chains not converged {found['not_converged']}; {time.process_time() - begun:.0f} s of processor time",
              flush=True)


if __name__ == "__main__":
    main()
