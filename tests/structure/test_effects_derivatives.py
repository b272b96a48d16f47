"""Every kind of effect: exact derivatives against differences, neutral and off neutral, one by one and together."""

import numpy as np
import pytest
from effects_turbine import SAMPLES, model, plain, sample, with_effects

from probupdate.structure.description import NEUTRAL
from probupdate.structure.effect_kinds import KINDS
from probupdate.structure.reduced import reduce_basis

N_MODE = 7


def derivatives_agree(turbine, theta, names, row):
    exact = turbine.solve(theta, N_MODE, derivatives=True)
    # how far each value is from its neutral one or from zero, the scale on which a factor's function bends
    std = {n: min(abs(SAMPLES[n][3] - KINDS[SAMPLES[n][0]].neutral), abs(SAMPLES[n][3])) for n in names}
    for name in names:
        k = turbine.parameters.index(name)
        # four points, fourth order; the step is small against the gap of the closest pair and the soil's kinks
        h = 1e-3 * std[name]
        d_frequency, d_shape = 0.0, 0.0
        for step, weight in ((1, 8), (-1, -8), (2, -1), (-2, 1)):
            moved = theta.copy()
            moved[k] += step * h
            at = turbine.solve(moved, N_MODE)
            sign = np.where(np.sum(at.shape * exact.shape, axis=0) < 0, -1, 1)
            d_frequency = d_frequency + weight * at.frequency_hz / (12 * h)
            d_shape = d_shape + weight * sign * at.shape / (12 * h)
        found, scale = exact.frequency_derivative[:, k], exact.frequency_hz / std[name]
        # rounding: eigenvalues of these matrices are good to 2e-10, over the step
        row.error((found - d_frequency) / (50 * np.abs(d_frequency) + scale), 2e-7, "frequencies", case=name)
        size = np.abs(d_shape).max(axis=0) + 1e-3 * np.abs(exact.shape).max(axis=0) / std[name]
        row.error((exact.shape_derivative[:, :, k] - d_shape) / size, 2e-4, "shapes", case=name)


# effects that would be added up at one place stay apart
BATCHES = [[n for n in SAMPLES if n != "blades"][k::3] for k in range(3)] + [["blades"]]


@pytest.mark.parametrize("batch", BATCHES, ids=lambda batch: batch[0])
def test_off_neutral_one_by_one(batch, validation):
    row = validation(what="derivatives for every kind of effect, frequencies (beside 1e-5 of each) and shapes, over "
                          "the effect's scale", reference="fourth-order differences", why="the differences' rounding")
    turbine = model(with_effects([sample(n) for n in batch]))
    for k, name in enumerate(batch):
        theta = turbine.parameters.initial.copy()
        theta[k] = SAMPLES[name][3]
        derivatives_agree(turbine, theta, [name], row)


def test_neutral_without_a_bound_in_the_way(validation):
    """Where the neutral value lies on a bound or a kink the model exists on one side only: seen in the next test."""
    row = validation(what="the same at the neutral value, of effects that have no bound there",
                     reference="fourth-order differences", why="the differences' rounding")
    inside = [n for n, (kind, _, _, _, (low, high)) in SAMPLES.items()
              if low < KINDS[kind].neutral < high and kind not in ("oscillator", "water_level")]
    turbine = model(with_effects([sample(n) for n in inside]))
    derivatives_agree(turbine, turbine.parameters.initial, inside, row)


@pytest.mark.parametrize("name", ["flange", "slip", "scour", "flooding", "corrosion", "ice", "water"])
def test_neutral_at_a_bound_by_one_sided_differences(name):
    turbine = model(with_effects([sample(name)]))
    exact = turbine.solve(turbine.parameters.initial, N_MODE, derivatives=True)
    h = 1e-3 * abs(SAMPLES[name][3])
    f = [turbine.solve(np.array([k * h]), N_MODE).frequency_hz for k in range(3)]
    one_sided = (-1.5 * f[0] + 2 * f[1] - 0.5 * f[2]) / h
    span = exact.frequency_hz / abs(SAMPLES[name][3])
    assert np.all(np.abs(exact.frequency_derivative[:, 0] - one_sided) < 1e-4 * np.abs(one_sided) + 1e-7 * span)


def test_all_kinds_together_off_neutral(validation):
    """Products of effects on one element, sums of them in one spring: a few at a time would not show a mixed term."""
    row = validation(what="the same with all kinds together off neutral", reference="fourth-order differences",
                     why="the differences' rounding")
    names = [n for n in SAMPLES if n != "blades"]
    turbine = model(with_effects([sample(n) for n in names]))
    theta = np.array([SAMPLES[n][3] for n in names])
    mixed = ("brace_axial", "joint", "joint_in_plane", "leg_bending", "soil_py", "scour_B", "growth", "corrosion",
             "warmth", "com_x", "com_y", "water", "dry_leg")
    derivatives_agree(turbine, theta, mixed, row)


@pytest.mark.parametrize("theory", ["bernoulli-euler", "timoshenko"])
def test_neutral_leaves_the_structure_as_described(theory, validation):
    """To rounding where no element is cut; bands that cut elements change the mesh alone."""
    row = validation(what="neutral effects, no element cut", reference="the model without them",
                     why="rounding; beams that the water may leave carry it with Bernoulli-Euler shapes")
    cutting = [n for n, (_, on, _, _, _) in SAMPLES.items() if "level_m" in on]
    raw = with_effects([sample(n) for n in SAMPLES if n not in (*cutting, "blades")])
    bare = with_effects([])
    raw["mesh"]["theory"] = bare["mesh"]["theory"] = theory
    reference, neutral = plain(bare), model(raw)
    expected, found = (m.solve(m.parameters.initial, N_MODE) for m in (reference, neutral))
    assert neutral.n_dof == reference.n_dof
    # beams that the water may leave carry it with Bernoulli-Euler shapes in both theories
    tolerance = 1e-10 if theory == "bernoulli-euler" else 1e-6
    row.error(found.frequency_hz / expected.frequency_hz - 1, below=tolerance, of=theory)
    assert np.abs(found.shape) == pytest.approx(np.abs(expected.shape), abs=1e3 * tolerance)
    raw["parameter"] += [sample(n) for n in cutting]
    finer = model(raw)
    assert finer.n_dof > reference.n_dof
    found = finer.solve(finer.parameters.initial, N_MODE)
    # one element per brace is coarse: more nodes lower local modes by some per cent, the towers' hardly
    assert found.frequency_hz == pytest.approx(expected.frequency_hz, rel=0.05)
    assert found.frequency_hz[:2] == pytest.approx(expected.frequency_hz[:2], rel=1e-4)


def test_many_points_at_once_are_those_one_by_one():
    names = ["brace_axial", "scour_B", "flange", "water", "com_y"]
    turbine = model(with_effects([sample(n) for n in names]))
    rng = np.random.default_rng(1)
    lower, upper = turbine.parameters.lower, turbine.parameters.upper
    theta = lower + rng.random((4, len(names))) * (upper - lower)
    many = turbine.coefficients(theta)
    for k, row in enumerate(theta):
        for whole, single in zip(many, turbine.coefficients(row), strict=True):
            assert np.array_equal(whole[k], single)


def test_a_reduced_basis_follows_effects(validation):
    """Where one leg and one face differ no symmetry is left to split the basis: it holds all the same."""
    checked = validation(what="reduced basis over five parameters, one leg and one face apart", reference="full model",
                         why="what is promised")
    raw = with_effects([sample(n) for n in ("brace_axial", "scour_B", "com_y")])
    for row in raw["parameter"]:
        row["update"] = row["name"] not in NEUTRAL or row["name"] in ("k_t", "tz")
    turbine = model(raw)
    box = (np.array([0.8, 0.7, 0.05, -0.7, -2.0]), np.array([1.2, 1.5, 1.5, 4.0, 2.0]))
    reduced = reduce_basis(turbine, n_mode=6, box=box, frequency_tolerance=1e-4, n_snapshot=64, n_verify=32)
    theta = box[0] + np.random.default_rng(0).random((20, 5)) * (box[1] - box[0])
    fast, exact = reduced.solve_many(theta, 6), turbine.solve_many(theta, 6)
    assert not fast.fallback.any()
    checked.error(fast.frequency_hz / exact.frequency_hz - 1, below=1e-4)
