"""Calibration of intervals where the model's form is wrong: frames whose joints, shear or weight the model leaves out.

    python -m studies.calibration.model_form --kind joints --draws 40

Drawn plane frames, solved here by themselves: truth with shear flexibility, springs between beams and columns, the
weight's geometric stiffness, or every member and mass off by 3 %; the model has none of it. Of each kind the share of
90 % intervals (maximum and Laplace approximation of the default options) that hold the truth, parameter by parameter,
without and with a baseline of the same frame whose parameters were known to 1 %, and beside other models of it.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, sparse

from probupdate.effects.alternatives import AlternativeModels
from probupdate.errors import InputError
from probupdate.modal.modes import ModalData, ModalSet
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.affine import AffineModel
from probupdate.structure.functions import FunctionModel
from probupdate.updating.discrepancy import estimate_discrepancy, learnt_error, weights_by_name
from probupdate.updating.laplace import maximum_a_posteriori
from probupdate.updating.problem import build_problem

NAMES = ("columns below", "columns above", "beams", "base", "mass")
PRIOR_STD = np.array([0.15, 0.15, 0.15, 0.3, 0.05])
KNOWN, IDENTIFIED, IDENTIFIED_SHAPE, N_MODE = 0.01, 2e-3, 1e-2, 4
KINDS = ("none", "local", "shear", "joints", "weight", "all")
HEIGHT, E, G = 3.5, 3e10, 9.81


def beam(EI: float, length: float, shear: float = 0.0, joint: float = np.inf, force: float = 0.0) -> np.ndarray:
    """Stiffness (4, 4) of a beam with a shear parameter 12 EI / (G A L^2), springs at both ends, an axial force."""
    L, phi = length, shear
    K = EI / L**3 / (1 + phi) * np.array([
        [12, 6 * L, -12, 6 * L], [6 * L, (4 + phi) * L**2, -6 * L, (2 - phi) * L**2],
        [-12, -6 * L, 12, -6 * L], [6 * L, (2 - phi) * L**2, -6 * L, (4 + phi) * L**2]])
    if np.isfinite(joint):
        # rotations of the beam behind the springs, condensed
        whole, inner = np.zeros((6, 6)), [0, 4, 2, 5]
        whole[np.ix_(inner, inner)] = K
        for outside, behind in ((1, 4), (3, 5)):
            whole[np.ix_([outside, behind], [outside, behind])] += joint * np.array([[1, -1], [-1, 1]])
        K = whole[:4, :4] - whole[:4, 4:] @ np.linalg.solve(whole[4:, 4:], whole[4:, :4])
    return K - force / L / 30 * np.array([[36, 3 * L, -36, 3 * L], [3 * L, 4 * L**2, -3 * L, -L**2],
                                          [-36, -3 * L, 36, -3 * L], [3 * L, -L**2, -3 * L, 4 * L**2]])


@dataclass(frozen=True, eq=False, kw_only=True)
class Missed:
    """What the model leaves out: shear parameters, spring over EI / L, whether weight counts, factors of members."""

    shear: tuple[float, float] = (0.0, 0.0)
    joint: float = np.inf
    weight: bool = False
    columns: np.ndarray
    beams: np.ndarray
    masses: np.ndarray


class Frame:
    """One bay; sways of n floors and rotations of both columns."""

    def __init__(self, rng: np.random.Generator):
        self.n, self.bay = int(rng.integers(4, 9)), rng.uniform(5, 8)
        self.column, self.girder = E * rng.uniform(0.4, 0.6) ** 4 / 12, 0.3 * E * rng.uniform(0.4, 0.6) ** 3 / 12
        self.mass, self.base = rng.uniform(15e3, 30e3), 4 * rng.uniform(1, 5) * self.column / HEIGHT

    def missed(self, rng: np.random.Generator, kind: str) -> Missed:
        n, off = self.n, 0.03 * (kind in ("local", "all"))
        found = Missed(columns=1 + off * rng.standard_normal((2, n)), beams=1 + off * rng.standard_normal(n),
                       masses=1 + off * rng.standard_normal(n), weight=kind in ("weight", "all"))
        if kind in ("shear", "all"):
            found = replace(found, shear=(rng.uniform(0.02, 0.08), rng.uniform(0.01, 0.05)))
        return replace(found, joint=rng.uniform(20, 100)) if kind in ("joints", "all") else found

    def matrices(self, theta: np.ndarray, missed: Missed | None = None) -> tuple[np.ndarray, np.ndarray]:
        n = self.n
        one = missed or Missed(columns=np.ones((2, n)), beams=np.ones(n), masses=np.ones(n))
        K = np.zeros((n + 2 * (n + 1),) * 2)
        for side in (0, 1):
            first = n + side * (n + 1)
            for floor in range(n):
                EI = theta[0 if floor < n // 2 else 1] * self.column * one.columns[side, floor]
                force = 0.5 * (n - floor) * self.mass * G * one.weight
                rows = np.array([floor - 1, first + floor, floor, first + floor + 1])
                there = rows >= 0
                K[np.ix_(rows[there], rows[there])] += beam(EI, HEIGHT, one.shear[0], force=force)[np.ix_(there, there)]
            K[first, first] += theta[3] * self.base
        for floor in range(n):
            EI = theta[2] * self.girder * one.beams[floor]
            rows = [n + floor + 1, 2 * n + floor + 2]
            spring = one.joint * EI / self.bay if np.isfinite(one.joint) and EI else np.inf
            K[np.ix_(rows, rows)] += beam(EI, self.bay, one.shear[1], spring)[np.ix_([1, 3], [1, 3])]
        return K, np.diag(np.concatenate([theta[4] * self.mass * one.masses, np.zeros(2 * (n + 1))]))

    def modes(self, theta: np.ndarray, missed: Missed) -> tuple[np.ndarray, np.ndarray]:
        """All frequencies, and shapes of unit modal mass of the floors."""
        (K, M), n = self.matrices(theta, missed), self.n
        sway = K[:n, :n] - K[:n, n:] @ np.linalg.solve(K[n:, n:], K[n:, :n])
        value, shape = linalg.eigh(sway, M[:n, :n])
        return np.sqrt(value) / (2 * np.pi), shape

    def measured(self, theta: np.ndarray, missed: Missed, rng: np.random.Generator) -> ModalData:
        hz, shape = (found[..., :N_MODE] for found in self.modes(theta, missed))
        shape, n = shape / np.abs(shape).max(axis=0), self.n
        one = ModalSet(
            id="state", frequency_hz=hz * (1 + IDENTIFIED * rng.standard_normal(N_MODE)),
            frequency_std_hz=IDENTIFIED * hz,
            damping_ratio=np.full(N_MODE, 0.01), shape=shape + IDENTIFIED_SHAPE * rng.standard_normal(shape.shape),
            shape_std=np.full(shape.shape, IDENTIFIED_SHAPE))
        return ModalData(channels=tuple(f"x{k}" for k in range(n)), sets=(one,))

    def model(self, std: np.ndarray, missed: Missed | None = None):
        n = self.n
        channels = tuple(f"x{k}" for k in range(n))
        parameters = Parameters(tuple(Parameter(name=name, unit="-", initial=1.0, std=s, lower=0.05, upper=6.0)
                                      for name, s in zip(NAMES, std, strict=True)))
        if missed is not None:
            return FunctionModel(name="frame", parameters=parameters, channels=channels, version="1",
                                 function=lambda theta: self.modes(theta, missed))
        nothing = self.matrices(np.zeros(5))[0]
        parts = [self.matrices(row)[0] - nothing for row in np.eye(5)[:4]]
        mass = self.matrices(np.ones(5))[1] + np.diag(np.repeat([0.0, 1e-6 * self.mass], [n, 2 * (n + 1)]))
        pick = sparse.csr_array((np.ones(n), (np.arange(n), np.arange(n))), shape=(n, len(mass)))
        return AffineModel(
            name="frame", channels=channels, channel_matrix=pick, parameters=parameters,
            stiffness=tuple(sparse.csc_array(K) for K in parts), mass=(sparse.csc_array(mass),),
            coefficients=lambda theta: (theta[..., :4], theta[..., 4:]), hash_key=f"{n} {self.mass} {self.column}")


def with_alternatives(frame: Frame, model: AffineModel) -> AffineModel:
    """Beside the same frame with usual springs in its joints, with usual shear, and with its weight: nothing of what
    was drawn."""
    n = frame.n
    plain = Missed(columns=np.ones((2, n)), beams=np.ones(n), masses=np.ones(n))
    others = {"flexible joints": replace(plain, joint=40.0), "shear": replace(plain, shear=(0.05, 0.03)),
              "weight": replace(plain, weight=True)}
    return replace(model, uncertainty=AlternativeModels(model=model, others=tuple(
        (name, frame.model(np.array([p.std for p in model.parameters]), one)) for name, one in others.items())))


def estimated(model: AffineModel, data: ModalData, baseline=()):
    known = getattr(model, "uncertainty", None) is not None
    weights = replace(weights_by_name("measured", data, tolerances=known), baseline=baseline)
    problem = build_problem(model, data, weights=estimate_discrepancy(model, data, weights=weights))
    return problem, maximum_a_posteriori(problem, [model.parameters.initial])


def draw(seed: int, kind: str) -> np.ndarray:
    """Of the three ways (3, 3, 5): error and standard deviation over the prior's, and whether the interval holds."""
    rng = np.random.default_rng([seed, 3])
    frame = Frame(rng)
    theta = 1 + PRIOR_STD * np.clip(rng.standard_normal(5), -2.5, 2.5)
    missed = frame.missed(rng, kind)
    known = 1 + KNOWN * rng.standard_normal(5)
    before, now = frame.measured(known, missed, rng), frame.measured(theta, missed, rng)
    problem, maximum = estimated(frame.model(np.full(5, KNOWN)), before)
    error = learnt_error(problem, maximum.theta)
    rows = []
    model = frame.model(PRIOR_STD)
    for one, baseline in ((model, ()), (model, (error,)), (with_alternatives(frame, model), ())):
        found = estimated(one, now, baseline)[1]
        std, off = np.sqrt(np.diag(found.covariance)), found.theta - theta
        rows.append([off / PRIOR_STD, std / PRIOR_STD, np.abs(off) < 1.645 * std])
    return np.array(rows)


def main():
    p = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    p.add_argument("--kind", choices=KINDS, nargs="+", default=KINDS)
    p.add_argument("--first", type=int, default=0)
    p.add_argument("--draws", type=int, default=40)
    a = p.parse_args()
    print("| missed | draws | baseline | all | " + " | ".join(NAMES) + " | error of beams | width of beams |")
    for kind in a.kind:
        found = []
        for seed in range(a.first, a.first + a.draws):
            try:
                found.append(draw(seed, kind))
            except InputError as error:
                print(f"{kind} {seed}: {error}", flush=True)
        rows = np.array(found)
        for k, name in enumerate(("none", "known to 1 %", "none, alternatives")):
            held = 100 * rows[:, k, 2].mean(axis=0)
            print(f"| {kind} | {len(rows)} | {name} | {held.mean():.0f} | " + " | ".join(f"{h:.0f}" for h in held)
                  + f" | {rows[:, k, 0, 2].mean():+.2f} | {np.median(rows[:, k, 1, 2]):.2f} |", flush=True)


if __name__ == "__main__":
    main()
