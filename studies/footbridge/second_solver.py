"""The bridge's maximum of the posterior by a second route: the same objective written against K and M directly.

Nothing of the package solves it: matrices from the file, eigenvalues by scipy's eigsh, modes by MAC, shapes scaled by
weighted least squares, differences for derivatives, scipy's least_squares from several starts within the bounds. The
package's own maximum is found beside it and put into the second objective too.

    python studies/footbridge/second_solver.py [--data FOLDER] [--starts 2]
"""

from __future__ import annotations

import argparse
import json
import sys
import tomllib
from pathlib import Path

import numpy as np
from run import DATA, HERE
from scipy import optimize, sparse
from scipy.sparse.linalg import eigsh

N_MODE = 8
SHAPE_FLOOR = 0.02
STEP = 1e-4  # of the differences, in prior standard deviations


class Bridge:
    """J(theta) = chi-square of frequencies and shapes + chi-square of the prior."""

    def __init__(self, folder: Path):
        with np.load(folder / "model.npz", allow_pickle=False) as file:
            content = {key: file[key] for key in file.files}
        parameters = tomllib.loads((HERE / "parameters.toml").read_text(encoding="utf-8"))["parameter"]
        self.names = [p["name"] for p in parameters]
        self.std, self.lower, self.upper = (np.array([p[key] for p in parameters]) for key in ("std", "lower", "upper"))
        self.fixed, self.mass = _matrix(content, "K0"), _matrix(content, "M0")
        self.parts = [_matrix(content, f"K_{name}") for name in self.names]
        rows = dict(zip(content["channel"].astype(str), content["channel_dof"], strict=True))
        modes = json.loads((folder / "modes.json").read_text(encoding="utf-8"))
        self.rows = np.array([rows[name] for name in modes["channels"]])
        sign = content.get("channel_sign")
        signs = np.ones(len(rows)) if sign is None else sign
        self.sign = np.array([dict(zip(rows, signs, strict=True))[name] for name in modes["channels"]])
        (one,) = modes["sets"]
        self.frequency, self.frequency_std = (np.array(one[key], float) for key in ("frequency_hz", "frequency_std_hz"))
        shape = np.array(one["shape_re"], float)
        largest = np.nanmax(np.abs(shape), axis=1, keepdims=True)
        self.shape = shape / largest
        self.shape_std = np.maximum(np.array(one["shape_std"], float) / largest, SHAPE_FLOOR)

    def residual(self, theta: np.ndarray) -> np.ndarray:
        stiffness = self.fixed + sum(t * part for t, part in zip(theta, self.parts, strict=True))
        value, phi = eigsh(stiffness.tocsc(), k=N_MODE, M=self.mass, sigma=-1.0, v0=np.ones(self.mass.shape[0]))
        order = np.argsort(value)
        frequency, computed = np.sqrt(value[order]) / (2 * np.pi), (self.sign[:, None] * phi[self.rows][:, order]).T
        mac = np.array([[_mac(a, b) for b in computed] for a in self.shape])
        _, pair = optimize.linear_sum_assignment(-mac)
        parts = [(frequency[pair] - self.frequency) / self.frequency_std]
        for measured, std, j in zip(self.shape, self.shape_std, pair, strict=True):
            there = np.isfinite(measured)
            a, b = computed[j][there] / std[there], measured[there] / std[there]
            parts.append(a * (a @ b) / (a @ a) - b)
        return np.concatenate([*parts, theta / self.std])

    def objective(self, theta: np.ndarray) -> float:
        return float(np.sum(self.residual(theta) ** 2))

    def jacobian(self, theta: np.ndarray) -> np.ndarray:
        columns = []
        for k in range(len(theta)):
            ends = []
            for side in (-1, 1):
                moved = theta.copy()
                moved[k] = np.clip(theta[k] + side * STEP * self.std[k], self.lower[k], self.upper[k])
                ends.append((moved[k], self.residual(moved)))
            columns.append((ends[1][1] - ends[0][1]) / (ends[1][0] - ends[0][0]))
        return np.array(columns).T


def _matrix(content: dict, name: str) -> sparse.csc_array:
    if name in content:
        return sparse.csc_array(content[name])
    parts = tuple(content[f"{name}_{key}"] for key in ("data", "indices", "indptr"))
    return sparse.csr_array(parts, shape=(len(parts[2]) - 1,) * 2).tocsc()


def _mac(a: np.ndarray, b: np.ndarray) -> float:
    there = np.isfinite(a)
    return float((a[there] @ b[there]) ** 2 / (a[there] @ a[there]) / (b[there] @ b[there]))


def package_maximum(folder: Path):
    from probupdate import verbs
    from probupdate.modal.modes import read_modes
    from probupdate.updating.laplace import maximum_a_posteriori
    from probupdate.updating.problem import build_problem

    model = verbs.open_model(folder / "model.npz", HERE / "parameters.toml")
    problem = build_problem(model, read_modes(folder / "modes.json"))
    return maximum_a_posteriori(problem, [model.parameters.initial])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--starts", type=int, default=2,
                        help="the initial model, and draws within a prior standard deviation")
    a = parser.parse_args()
    bridge = Bridge(a.data)
    say = sys.stdout.write
    own = package_maximum(a.data)
    say(f"package: J {own.misfit + np.sum((own.theta / bridge.std) ** 2):.3f} by itself, "
        f"{bridge.objective(own.theta):.3f} in the second objective\n")
    sys.stdout.flush()
    rng = np.random.default_rng(1)
    best = None
    for number in range(a.starts):
        begin = np.zeros(len(bridge.std)) if number == 0 else 0.5 * bridge.std * rng.uniform(-1, 1, len(bridge.std))
        begin = np.clip(begin, bridge.lower + 1e-6, bridge.upper - 1e-6)
        found = optimize.least_squares(bridge.residual, begin, jac=bridge.jacobian, x_scale=bridge.std, max_nfev=40,
                                       bounds=(bridge.lower, bridge.upper), xtol=1e-6, ftol=1e-9)
        say(f"start {number}: J {2 * found.cost:.3f} after {found.nfev} steps ({found.message})\n")
        sys.stdout.flush()
        best = found if best is None or found.cost < best.cost else best
    apart = (best.x - own.theta) / np.sqrt(np.diag(own.covariance))
    say("| | package | second solver | apart, posterior standard deviations |\n|---|---|---|---|\n")
    for name, one, other, d in zip(bridge.names, own.theta, best.x, apart, strict=True):
        say(f"| {name} | {one:.4f} | {other:.4f} | {d:.4f} |\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
