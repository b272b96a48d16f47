"""A published example of Bayesian updating: the two-storey steel frame of SimCenter's quoFEM, example qfem-0008.

Five pairs of eigenvalue and mode-shape ratio were made by scattering those of the true frame (both moments of inertia
1190 in^4); its script divides by standard deviations of 54.203 and 0.0705, 5 % of each, and weighs all five pairs. Its
page states what DREAM found. Here: the same likelihood by quadrature, and the product's chain on the mean of the five.

    python studies/anchors/frame.py
"""

from __future__ import annotations

import sys
import tempfile

import numpy as np

from probupdate.modal.modes import ModalData, ModalSet
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.functions import FunctionModel
from probupdate.updating.ensemble import SamplerSettings, sample
from probupdate.updating.laplace import maximum_a_posteriori
from probupdate.updating.problem import Weights, build_problem
from probupdate.updating.surrogate import fit_surrogate

EIGENVALUE = np.array([1025.21, 1138.11, 1099.39, 1002.41, 1052.69])  # (rad/s)^2
RATIO = np.array([1.53, 1.24, 1.38, 1.50, 1.35])  # roof over first floor
EIGENVALUE_STD, RATIO_STD = 54.203, 0.0705
MODULUS_KSI, HEIGHT_IN, MASS = 29000.0, 120.0, (0.26, 0.13)  # kip s^2 / in of half a frame's floors
LOWER, UPPER = 500.0, 2000.0
PUBLISHED = {"Ic1": (1229.1, 192.407), "Ic2": (1404.03, 253.584)}
N_GRID = 300


def modes(first, second):
    """Eigenvalues (2, ...) and ratios roof over floor (2, ...) of two storeys on two columns each, beams rigid."""
    k1, k2 = (24 * MODULUS_KSI * inertia / HEIGHT_IN**3 for inertia in (first, second))
    a, b = (k1 + k2) / MASS[0], k2 / MASS[1]
    root = np.sqrt((a - b) ** 2 / 4 + k2**2 / (MASS[0] * MASS[1]))
    value = np.array([(a + b) / 2 - root, (a + b) / 2 + root])
    return value, (k1 + k2 - value * MASS[0]) / k2


def quadrature() -> np.ndarray:
    """Mean and standard deviation (2, 2) of both inertias under uniform priors; rows are the inertias."""
    node, weight = np.polynomial.legendre.leggauss(N_GRID)
    at = 0.5 * (LOWER + UPPER) + 0.5 * (UPPER - LOWER) * node
    first, second = np.meshgrid(at, at, indexing="ij")
    value, ratio = (x[0] for x in modes(first, second))
    misfit = sum(((v - value) / EIGENVALUE_STD) ** 2 + ((r - ratio) / RATIO_STD) ** 2
                 for v, r in zip(EIGENVALUE, RATIO, strict=True))
    density = np.exp(-0.5 * (misfit - misfit.min())) * np.outer(weight, weight)
    density /= density.sum()
    found = []
    for inertia in (first, second):
        mean = np.sum(density * inertia)
        found.append((mean, np.sqrt(np.sum(density * (inertia - mean) ** 2))))
    return np.array(found)


def by_chain(seed: int = 1) -> np.ndarray:
    """The same from the product: one frequency and one shape, the means of five."""
    # a normal prior so wide that it is flat between the bounds
    parameters = Parameters(tuple(
        Parameter(name=name, unit="in^4", initial=1250.0, std=1e6, lower=LOWER, upper=UPPER) for name in PUBLISHED
    ))

    def function(theta):
        value, ratio = modes(*theta)
        return np.sqrt(value) / (2 * np.pi), np.stack([1 / ratio, np.ones(2)])

    model = FunctionModel(name="frame", parameters=parameters, channels=("floor", "roof"), function=function,
                          version="1")
    value, ratio = EIGENVALUE.mean(), RATIO.mean()
    frequency = np.sqrt(value) / (2 * np.pi)
    root = np.sqrt(len(RATIO))
    # the roof is the shape's unit and has no standard deviation of its own: the smallest that the weights allow
    one = ModalSet(
        id="mean of five", frequency_hz=np.array([frequency]), shape=np.array([[1 / ratio], [1.0]]),
        damping_ratio=np.array([0.01]), frequency_std_hz=np.array([0.5 * frequency * EIGENVALUE_STD / value / root]),
        shape_std=np.array([[RATIO_STD / ratio**2 / root], [0.0]]),
    )
    data = ModalData(channels=model.channels, sets=(one,))
    problem = build_problem(model, data, weights=Weights(least_shape_std=1e-3))
    top = maximum_a_posteriori(problem, [parameters.initial])
    outline, _ = fit_surrogate(problem, top, np.random.default_rng(seed))
    with tempfile.TemporaryDirectory() as folder:
        chain = sample(problem, outline, folder, SamplerSettings(seed=seed, target_ess=2000, max_steps=4000))
    return np.column_stack([chain.draws.mean(axis=0), chain.draws.std(axis=0)])


def main() -> int:
    exact, drawn = quadrature(), by_chain()
    sys.stdout.write("| | quadrature | chain | published (DREAM) | truth |\n|---|---|---|---|---|\n")
    for k, (name, published) in enumerate(PUBLISHED.items()):
        cells = [f"{m:.0f} ± {s:.0f}" for m, s in (exact[k], drawn[k], published)]
        sys.stdout.write(f"| {name} | {' | '.join(cells)} | 1190 |\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
