"""A beam that carries masses, measured in many states: what its model misses is the same in all of them, and is learnt
from one whose masses are known. The beam is by Timoshenko's theory on a soft clamp, its model by Euler and Bernoulli's
on a rigid one."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg
from updating_cases import modal_set

from probupdate.modal.modes import ModalData
from probupdate.structure.load import load_model
from probupdate.updating.discrepancy import estimate_discrepancy, learnt_error, weights_by_name
from probupdate.updating.laplace import maximum_a_posteriori
from probupdate.updating.problem import build_problem

LENGTH, BENDING, LINE, PLACES = 1.0, 1000.0, 8.0, np.array([0.5, 0.75, 1.0])
STD_HZ, STD_SHAPE = 5e-4, 5e-3
NAMES = ("m1", "m2", "m3")
# kg; what a mass may be, and how well one is known that was weighed
CARRIED, WEIGHED = 0.6, 0.005


def beam(n, shear=0.0, rotary=0.0, clamp=np.inf):
    """K, M (2 n + 1 or 2 n degrees of freedom) of n elements, deflection and rotation of each node but the clamped
    deflection; shear: 12 EI / (kGA) in m2, rotary: I / A in m2, clamp: N m / rad."""
    h, size = LENGTH / n, 2 * n + 2
    phi = shear / h**2
    k = BENDING / (h**3 * (1 + phi)) * np.array([
        [12, 6 * h, -12, 6 * h], [6 * h, (4 + phi) * h * h, -6 * h, (2 - phi) * h * h],
        [-12, -6 * h, 12, -6 * h], [6 * h, (2 - phi) * h * h, -6 * h, (4 + phi) * h * h]])
    m = LINE * h / 420 * np.array([[156, 22 * h, 54, -13 * h], [22 * h, 4 * h * h, 13 * h, -3 * h * h],
                                   [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h * h, -22 * h, 4 * h * h]])
    m += LINE * rotary / (30 * h) * np.array([[36, 3 * h, -36, 3 * h], [3 * h, 4 * h * h, -3 * h, -h * h],
                                              [-36, -3 * h, 36, -3 * h], [3 * h, -h * h, -3 * h, 4 * h * h]])
    K, M = np.zeros((size, size)), np.zeros((size, size))
    for e in range(n):
        K[2 * e: 2 * e + 4, 2 * e: 2 * e + 4] += k
        M[2 * e: 2 * e + 4, 2 * e: 2 * e + 4] += m
    if np.isinf(clamp):
        return K[2:, 2:], M[2:, 2:]
    K[1, 1] += clamp
    return K[1:, 1:], M[1:, 1:]


def write_model(folder, std):
    K, M = beam(8)
    deflection = 2 * np.round(PLACES * 8).astype(int) - 2
    each = {f"M_{name}": np.diag((np.arange(len(M)) == at).astype(float))
            for name, at in zip(NAMES, deflection, strict=True)}
    np.savez(folder / "model.npz", K0=K, M0=M, channel=[f"c{k}" for k in range(3)], channel_dof=deflection, **each)
    (folder / "parameters.toml").write_text("".join(
        f'[[parameter]]\nname = "{name}"\nunit = "kg"\ninitial = 0.0\nstd = {std}\nlower = -5.0\nupper = 5.0\n'
        'prior = "normal"\n' for name in NAMES))
    return load_model(folder / "model.npz")


def measured(mass, error, rng):
    """Four modes of the beam with these masses at its places."""
    K, M = beam(32, **error)
    at = 2 * np.round(PLACES * 32).astype(int) - 1
    M[at, at] += mass
    value, vector = linalg.eigh(K, M)
    hz = np.sqrt(value[:4]) / (2 * np.pi)
    shape = vector[at, :4] / np.abs(vector[at, :4]).max(axis=0)
    return ModalData(channels=("c0", "c1", "c2"), sets=(modal_set(
        hz * (1 + STD_HZ * rng.standard_normal(4)), shape + STD_SHAPE * rng.standard_normal(shape.shape),
        std=STD_HZ * hz, shape_std=np.full(shape.shape, STD_SHAPE)),))


def estimated(model, data, baseline=()):
    weights = replace(weights_by_name("measured", data), baseline=baseline)
    problem = build_problem(model, data, weights=estimate_discrepancy(model, data, weights=weights))
    return problem, maximum_a_posteriori(problem, [np.zeros(3)])


def held_masses(tmp_path, error, carried, states, seed=2):
    """Which masses (states, 3) lie in their 90 % intervals, given a weighed state."""
    rng = np.random.default_rng(seed)
    (tmp_path / "known").mkdir()
    known, wide = write_model(tmp_path / "known", WEIGHED), write_model(tmp_path, carried)
    problem, weighed = estimated(known, measured(WEIGHED * rng.standard_normal(3), error, rng))
    learnt, inside, width = learnt_error(problem, weighed.theta), [], []
    for _ in range(states):
        mass = np.abs(carried * rng.standard_normal(3))
        data = measured(mass, error, rng)
        _, now = estimated(wide, data, (learnt,))
        std = np.sqrt(np.diag(now.covariance))
        inside.append(np.abs(now.theta - mass) < 1.645 * std)
        width.append(std / carried)
    return np.array(inside), np.median(width, axis=0)


@pytest.mark.long
@pytest.mark.parametrize(("error", "carried"), [
    ({"shear": 2e-3, "rotary": 1e-4, "clamp": 2e5}, 0.6), ({"clamp": 2e4}, 0.3),
    ({"shear": 1e-2, "rotary": 5e-4, "clamp": 4e4}, 0.3)], ids=["1 to 3 % off", "8 % off", "6 to 12 % off"])
def test_masses_on_a_beam_lie_in_intervals_that_a_weighed_state_makes(error, carried, tmp_path):
    """90 % intervals of 6 states: masses turn the modes, and a tenth of the model's error with them."""
    inside, width = held_masses(tmp_path, error, carried, 6)
    # binomial of eighteen, three standard deviations below nine tenths
    assert np.sum(inside) >= 18 * 0.9 - 3 * np.sqrt(18 * 0.09)
    # of what each mass may be
    assert np.all(width < 0.15)
