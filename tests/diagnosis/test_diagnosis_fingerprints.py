"""Signatures of parameters and of sensors' effects against differences of whole identified modes, pairs mixed."""

from dataclasses import replace

import numpy as np
import pytest

from probupdate.diagnosis.blocks import gather
from probupdate.diagnosis.evidence import length_std
from probupdate.diagnosis.expected import residuals_at, signatures_at
from probupdate.diagnosis.fitting import fit, linearise, noise_of
from probupdate.diagnosis.mode_numbers import Reference, modes_with, numbers_of, numbers_of_modes, signature
from probupdate.diagnosis.part_places import PartKey
from probupdate.diagnosis.predictor import build_predictor, effect_signatures, observe
from probupdate.diagnosis.prepare import prepare
from probupdate.diagnosis.problem import IncludedEffect, diagnosis_problem
from probupdate.diagnosis.small_basis import small_model
from probupdate.diagnosis.small_model import TURNS_DEG, Attachment
from probupdate.diagnosis.time_profiles import TimeProfile
from probupdate.effects.catalogue import Delay, Effect, LowPass, Swap, measurement_effects
from probupdate.modal.modes import Sensor
from probupdate.structure.extend import extended_model
from probupdate.structure.load import load_model, reference_model
from probupdate.virtual.modal_blocks import simulate_modes

# what an identification may have turned the shapes of a pair by, each along its own phase and size
SCRAMBLE = np.array([0.3 + 0.5j, -1.2j])


@pytest.fixture(scope="module")
def prepared(frame_file):
    return prepare(frame_file)


def identified(small, field, theta, effect=None, size=0.0):
    local = small.evaluate(theta)
    modes = local.solve()
    shape, groups = field.group_members(local, modes)
    for members in groups:
        own, f = shape[:, list(members)].astype(complex), modes.frequency_hz[list(members)]
        if effect is not None:
            own, shift = effect.sensed(own, f, size)
            f = f * np.exp(shift)
        yield f, own * SCRAMBLE[: len(members)]


def test_fingerprints_are_the_differences_of_identified_modes(prepared, record, validation):
    row = validation(what="signatures of parameters and sensors, pairs mixed",
                     reference="central differences of identified modes", why="their own error, of the largest")
    blocks = gather(record())
    assert [len(g) for g in blocks.groups] == [2, 2]
    small, theta = prepared.small, np.array([1.03, 0.98, 1.0, 1.05, 0.97])
    field = build_predictor(small, blocks, theta)
    sensors = tuple(
        Sensor(channel=c, level=c[1], position_m=[0, 0, float(c[1])], direction=np.eye(3)["xy".index(c[0])])
        for c in blocks.channels
    )
    effects = (*prepared.effects, *measurement_effects(blocks.channels, sensors))
    local = small.evaluate(theta)
    (here,) = field.slopes(local, [0.0], local.slopes(range(theta.size)))
    for q in range(2):
        found = effect_signatures(effects, small.parameters.names, [(here[q], field.axes[q])])[0]
        for j, effect in enumerate(effects):
            h, sides = 1e-4 if effect.observe is None else effect.step_of_size, []
            for sign in (1, -1):
                moved = theta.copy()
                for name, amount in effect.increments:
                    moved[small.parameters.names.index(name)] += sign * h * amount
                arguments = (effect, sign * h) if effect.observe else ()
                f, shape = list(identified(small, field, moved, *arguments))[q]
                sides.append(numbers_of_modes(f[None], shape[None], field.axes[q])[0][0])
            difference = (sides[0] - sides[1]) / (2 * h)
            # central differences of second order: their own error is h^2
            row.error((difference - found[:, j]) / max(1.0, np.max(np.abs(found[:, j]))), 1e-4, case=effect.name)


@pytest.mark.parametrize("cause", ["clock offset", "low-pass filter"])
def test_a_logger_turns_each_mode_of_a_pair_by_its_own_frequency(prepared, record, cause, validation):
    """By the pair's mean frequency a clock 54 ms late was *unexplained*, and one of 27 ms was named with a second."""
    row = validation(what="numbers of pairs, behind a clock or a filter of 54 ms and an exchange of channels",
                     reference="each mode's shape turned by its own frequency", why="rounding")
    blocks = gather(record())
    small, theta = prepared.small, np.array([1.03, 0.98, 1.0, 1.05, 0.97])
    field = build_predictor(small, blocks, theta)
    late = Effect(kind="measurement", cause=cause, location="two loggers", unit="ms", tolerance=0.0, prior_scale=20.0,
                  observe=(Delay if cause == "clock offset" else LowPass)((0, 3, 4)))
    swap = Effect(kind="measurement", cause="swapped channels", location="two", unit="-", tolerance=0.0,
                  prior_scale=1.0, observe=Swap(0, 1))
    seen = observe(field.references(small.evaluate(theta), 0.0), [(late, 54.0), (swap, 1.0)])
    for q, (f, shape) in enumerate(identified(small, field, theta)):
        # the cable before the logger
        turned = late.sensed(swap.sensed(shape, f, 1.0)[0], f, 54.0)[0]
        expected = numbers_of_modes(f[None], turned[None], field.axes[q])[0]
        here = Reference(tensor=seen[q].tensor[None], shape=seen[q].shape[None])
        row.error(numbers_of(here, field.axes[q])[0] - expected, 1e-10, case=q)


def test_one_basis_serves_every_nacelle_angle(validation):
    row = validation(what="basis at a nacelle angle it was not built for: frequencies; slopes of frequencies and of "
                          "shapes per prior standard deviation", reference="the full model",
                     why="noise of a block is 0.2 % of a frequency")
    path = reference_model("as_built")
    models = [load_model(path, nacelle_angle_deg=a) for a in TURNS_DEG]
    p = models[0].parameters
    turned = tuple((m.stiffness, m.mass) for m in models[1:])
    small = small_model(replace(models[0], turned=turned), n_mode=7, effects=(),
                        reach=np.column_stack([p.lower, p.upper]))
    assert small.frequency_error < 1e-3
    # an angle that none of the five is
    exact = load_model(path, nacelle_angle_deg=37.0).solve(p.initial, 5, derivatives=True, clusters=((0, 1), (3, 4)))
    local = small.evaluate(p.initial)
    modes = local.solve(37.0)
    row.error(modes.frequency_hz[:5] / exact.frequency_hz - 1, 1e-4, "frequencies")
    slopes = local.slopes(range(len(p)))
    for members in ((0, 1), (2,), (3, 4)):
        (((coupling, change),),) = local.derivatives(slopes, [(37.0, modes, [members])])
        own = list(members)
        slope = np.array([coupling[i, i] / (8 * np.pi**2 * modes.frequency_hz[j]) for i, j in enumerate(own)])
        # what a prior standard deviation does, to a hundredth of a per cent of the frequency: noise of a block is 0.2 %
        row.error((slope - exact.frequency_derivative[own]) * p.std / exact.frequency_hz[own, None], 1e-4,
                  "slopes of frequencies")
        sign = np.sign(np.sum(local.shapes(modes, 5)[:, own] * exact.shape[:, own], axis=0))
        apart = np.abs(change * sign[:, None] - exact.shape_derivative[:, own]) * p.std
        row.error(apart / np.max(np.abs(exact.shape[:, own])), 2e-3, "slopes of shapes")


def test_matrices_about_the_priors_centre_are_those_of_all_terms(turbine, validation):
    """What many degrees of freedom feel is kept as it was projected once; the rest is what parameters differ by."""
    row = validation(what="stiffness and mass on the small basis about the prior's centre, at draws with two effects, "
                          "with a spring beside them: largest entry's share",
                     reference="the sum of all terms, projected", why="rounding")
    small, rng = turbine.small, np.random.default_rng(3)
    p = small.parameters
    kept = [{p.names[k] for k in about.slopes} for about in small.about]
    assert {"k_j", "k_p"} <= kept[0] and "a_m" in kept[1]
    spring = Attachment(key=PartKey(cause="spring", at=(0,)), std=1.0,
                        stiffness=rng.standard_normal((1, small.at_channels.shape[1])))
    wider = small.attach_parts([spring])
    for number in range(6):
        theta = p.initial.copy()
        chosen = [*turbine.updated, *rng.integers(0, len(p), 2)]
        theta[chosen] += (number > 0) * 0.3 * rng.standard_normal(len(chosen)) * p.std[chosen]
        theta = np.clip(theta, p.lower, p.upper)
        for model, at in ((small, theta), (wider, np.append(theta, 2.0)), (wider, np.append(theta, 0.0))):
            for found, terms, weight in zip(model.evaluate(at).matrices(), (model.stiffness, model.mass),
                                            model.coefficients(at), strict=True):
                plain = terms[0].total(weight)
                row.error((found - plain) / np.abs(plain).max(), 1e-11)
    bare, same = small.evaluate(theta).solve(40.0), wider.evaluate(np.append(theta, 0.0)).solve(40.0)
    assert np.array_equal(bare.frequency_hz, same.frequency_hz) and np.array_equal(bare.vectors, same.vectors)


def test_effects_do_on_the_small_basis_what_they_do_in_the_whole_model(turbine, validation):
    """A basis that holds frequencies to 1e-3 took a quarter off a leg's lost stiffness and half off a brace's."""
    row = validation(what="what single effects do on the small basis, a third of those of six causes: frequencies; "
                          "their changes, of the change and 0.001 of ln f", reference="the whole model",
                     why="what the basis promises")
    rows = [r for r in turbine.effects if r.adds and r.cause in (
        "brace stiffness lost", "joints loosened", "leg stiffness lost", "marine growth", "scour", "tower stiffness")]
    assert len(rows) > 40
    whole = extended_model(turbine.path, [r.adds for r in rows], parameters=turbine.prior, nacelle_angle_deg=0.0)
    names, small_names = whole.parameters.names, turbine.small.parameters.names
    start, small_start = np.array(whole.parameters.initial), np.array(turbine.small.parameters.initial)
    before = whole.solve(start, 5).frequency_hz
    # the coupled blades' own mode, which only the small model's catalogue has, is not a mode of the whole one
    others = [0, 1, 3, 4, 5]
    small_before = turbine.small.evaluate(small_start).solve().frequency_hz[others]
    row.error(small_before / before - 1, 3e-4, "frequencies")
    for effect in rows[::3]:
        size = effect.prior_scale if effect.upper > 0 else -effect.prior_scale
        moved, small_moved = start.copy(), small_start.copy()
        moved[names.index(effect.adds.name)] += size
        small_moved[small_names.index(effect.adds.name)] += size
        change = np.log(whole.solve(moved, 5).frequency_hz / before)
        found = np.log(turbine.small.evaluate(small_moved).solve().frequency_hz[others] / small_before)
        row.error(np.linalg.norm(found - change) / (np.linalg.norm(change) + 1e-3), 0.1, "changes", case=effect.name)


def test_what_is_left_of_a_lost_stiffness_moves_on_the_small_basis_too(turbine, validation):
    """A brace of a twelfth of its stiffness and all its mass has modes of its own beside second bending, which a basis
    made of its loss of three quarters did not hold: 0.26 of f was wrong."""
    row = validation(what="frequencies of the lowest five modes on the small basis where a fourth of all stiffnesses, "
                          "one by one, keep 0.25, 0.1, 0.05 or as little as they may", reference="the whole model",
                     why="a third of what model form leaves of ln f")
    rows = [r for r in turbine.effects if r.adds and r.adds.neutral == 1.0][::4]
    assert {"brace stiffness lost", "joints loosened", "leg stiffness lost"} <= {r.cause for r in rows}
    whole = extended_model(turbine.path, [r.adds for r in rows], parameters=turbine.prior, nacelle_angle_deg=0.0)
    names, small_names = whole.parameters.names, turbine.small.parameters.names
    for effect in rows:
        for kept in (0.25, 0.1, 0.05, 0.0):
            moved, small_moved = np.array(whole.parameters.initial), np.array(turbine.small.parameters.initial)
            k = names.index(effect.adds.name)
            moved[k] = small_moved[small_names.index(effect.adds.name)] = max(kept, whole.parameters.items[k].lower)
            found = turbine.small.evaluate(small_moved).solve().frequency_hz
            # without the coupled blades' own mode
            found = np.delete(found, np.argmin(np.abs(found - 0.7)))[:5]
            row.error(found / whole.solve(moved, 5).frequency_hz - 1, 1e-3, "frequencies", case=(effect.name, kept))


def test_sensors_move_on_the_small_basis_as_in_the_whole_model(turbine, validation):
    """At their heights, and what a step more does there."""
    row = validation(what="sensors at another height on the small basis: shapes, of their change and 0.01 of the "
                          "largest; slope with the height", reference="the whole model; central differences",
                     why="what the basis promises; the differences' own error")
    rows = [r for r in turbine.effects if r.cause == "sensor at another height"]
    assert {r.location for r in rows} == {"TP-A", "TP-B", "TP-C", "TP-D", "T18", "T66", "T90", "all of TP"}
    whole = extended_model(turbine.path, [r.adds for r in rows], parameters=turbine.prior, nacelle_angle_deg=0.0)
    small, others = turbine.small, [0, 1, 3, 4, 5]

    def sensor_at(name, h):
        theta = np.array(small.parameters.initial)
        theta[small.parameters.names.index(name)] = h
        return small.evaluate(theta)

    def like(shape, other):
        return shape * np.sign(np.sum(shape * other, axis=0))

    for effect in rows:
        name, h = effect.adds.name, 0.37 * (effect.lower if effect.lower else effect.upper)
        theta = np.array(whole.parameters.initial)
        before = whole.solve(theta, 5).shape
        theta[whole.parameters.names.index(name)] = h
        exact = whole.solve(theta, 5).shape
        local = sensor_at(name, h)
        modes = local.solve()
        found_there = like(local.shapes(modes, 6)[:, others], exact)
        length = np.abs(like(before, exact) - exact).max() + 0.01 * np.abs(exact).max()
        row.error((found_there - exact) / length, 0.05, "shapes", case=effect.location)
        column = small.parameters.names.index(name)
        (((_, change),),) = local.derivatives(local.slopes([column]), [(0.0, modes, [(0, 1)])])
        # of the same modes, which a sensor does not move: a pair as close as first bending is turned by rounding alone
        up, down = (sensor_at(name, h + d).shapes(modes, 2) for d in (1e-3, -1e-3))
        slope = (up - down) / 2e-3
        row.error((change[:, :, 0] - slope) / np.abs(slope).max(), 1e-5, "slope", case=effect.location)


def test_a_record_has_the_heights_of_its_own_channels(turbine):
    """What the record's channels make one is one, and no row is of channels that it has not."""
    def of(*channels):
        return [e.location for e in turbine.effects_on(channels) if e.cause == "sensor at another height"]

    assert of("TP-A-x", "TP-A-y", "TP-C-x", "T66-y") == ["TP-A", "TP-C", "T66", "all of TP"]
    assert of("TP-A-x", "TP-A-y", "T90-x") == ["TP-A", "T90"]
    assert of() == []


def test_fingerprints_between_the_nodes_are_those_of_the_angle_itself(turbine, validation):
    """Straight lines over 10 degrees miss an effect that turns with the heading by a hundredth (10 degrees in radians,
    squared, over eight; four times that for what turns twice as fast)."""
    row = validation(what="signatures between nodes of ten degrees", reference="those of the angle itself",
                     why="(10 deg)^2 / 8 of the largest, four times that for what turns twice as fast")
    record = simulate_modes(truth={}, seed=3, days=2.0, n_block=12).data
    problem, theta = diagnosis_problem(turbine, record)
    local = problem.predictor.small.evaluate(theta)
    names = problem.predictor.parameters.names
    angles = np.array([14.0, 187.0, 355.0, 358.0])
    lines = signatures_at(problem.predictor, local, problem.effects, names, angles)
    slopes = local.slopes(range(len(names)))
    for k, exact in enumerate(problem.predictor.slopes(local, angles, slopes)):
        owns = effect_signatures(problem.effects, names, list(zip(exact, problem.predictor.axes, strict=True)))
        for q, own in enumerate(owns):
            length = np.abs(lines[q]).max(axis=(0, 1))
            # at its usual size it must do something that could be seen at all
            seen = length * np.array([e.prior_scale for e in problem.effects]) > 1e-6
            assert seen.sum() > 0.9 * len(seen)
            row.error(np.abs(lines[q][k] - own).max(axis=0)[seen] / length[seen], 0.02)


def test_a_fingerprints_length_is_as_uncertain_as_draws_of_the_parameters_make_it(turbine, validation):
    row = validation(what="standard deviation of a signature's length along a column, from that of the parameters",
                     reference="60 draws of the parameters", why="9 % sampling, three times")
    record = simulate_modes(truth={}, seed=4, days=10.0, n_block=30).data
    problem, theta = diagnosis_problem(turbine, record)
    fitted = fit(problem, theta)
    (water,) = [e for e in problem.effects if e.cause == "wetted length"]
    (time_profile,) = [c for c in problem.time_profiles if c.column == "water_level_m"]
    found_here = length_std(problem, fitted, IncludedEffect(effect=water, time_profile=time_profile, size=1.0))
    names, rows = tuple(name for name, _ in water.increments), list(problem.updated)
    field, rng, made = problem.predictor, np.random.default_rng(2), []
    covariance = fitted.design.unknowns_cov(range(len(rows)))
    for number in range(61):
        theta = fitted.theta.copy()
        if number:
            # a tenth of the standard deviation, so that only what is of first order counts
            theta[rows] += 0.1 * rng.multivariate_normal(np.zeros(len(rows)), covariance)
        local = field.small.evaluate(np.clip(theta, field.parameters.lower, field.parameters.upper))
        made.append([f[0, :, 0] for f in signatures_at(field, local, [water], names, problem.bins[0][:1])])
    precision = fitted.design.noise.precision
    lengths = [sum(x @ P @ y for x, P, y in zip(own, precision, made[0], strict=True)) for own in made]
    drawn = 10 * np.std(lengths[1:]) / lengths[0]
    # sixty draws know a standard deviation to 9 %
    row.error(found_here / drawn - 1, 0.3)
    assert found_here > 0.05


@pytest.mark.parametrize("k", [1, 2])
def test_modes_and_their_numbers_tell_the_same(k, validation):
    row = validation(what="numbers of modes, one and a pair: of shapes scaled and turned in phase; back as "
                          "frequencies, plane, numbers", reference="the modes", why="rounding")
    rng = np.random.default_rng(k)
    axes = rng.standard_normal((9, k))
    axes = axes / np.abs(axes).max(axis=0)
    shape = axes + 0.2 * (rng.standard_normal((9, k)) + 1j * rng.standard_normal((9, k)))
    frequency = np.exp([0.3, 0.5][:k])
    (numbers,), _ = numbers_of_modes(frequency[None], shape[None], axes)
    # each mode's phase and size are the identification's own
    (again,), _ = numbers_of_modes(frequency[None], shape[None] * SCRAMBLE[:k], axes)
    row.error(again - numbers, 1e-12, "scaled and turned")
    there = modes_with(numbers, axes)
    value = np.linalg.eigvalsh(there.tensor)
    row.error(np.exp(value) / frequency - 1, 1e-12, "frequencies")
    # the same plane, and in it the same shapes to the share that the pair is not perpendicular by
    plane, _ = np.linalg.qr(there.shape)
    row.error(plane @ (plane.conj().T @ shape) - shape, 1e-12, "plane")
    back = numbers_of(Reference(tensor=there.tensor[None], shape=there.shape[None]), axes)[0]
    row.error(back - numbers, 1e-12, "back")


def test_an_expected_mode_across_the_measured_one_is_far_from_it_and_never_without_numbers(validation):
    """Two exchanged channels may lay a mode across the one that it is paired with: its numbers were zeros, which any
    measured shape is near to, and such channels explained a record of other faults (ln f off by 38 and 55 %)."""
    row = validation(what="an expected mode turned by up to 89 degrees across its axis; two of a pair that are seen "
                          "along one direction: ln f, distance of shapes",
                     reference="as not turned, the angle's tangent; 5",
                     why="rounding")
    axes, other = np.split(np.linalg.qr(np.random.default_rng(1).standard_normal((9, 3)))[0], [2], axis=1)
    for angle in (0.0, 0.5, 1.0, 1.4, 1.55):
        shape = np.cos(angle) * axes[:, :1] + np.sin(angle) * other
        numbers = numbers_of(Reference(tensor=np.array([[[0.3]]]), shape=shape[None]), axes[:, :1])[0]
        row.error(numbers[0] - 0.3, 1e-12, "ln f")
        row.error(np.linalg.norm(numbers[1:]) / max(np.tan(angle), 1.0) - min(np.tan(angle), 1.0), 1e-9, "distance")
    pair = np.column_stack([axes[:, 0], np.sin(1.55) * axes[:, 0] + np.cos(1.55) * (0.2 * axes[:, 1] + other[:, 0])])
    numbers = numbers_of(Reference(tensor=np.diag([0.3, 0.5])[None], shape=pair[None]), axes)[0]
    row.error(np.sum(numbers[:2]) - 0.8, 1e-12, "ln f of the pair")
    row.error(np.linalg.norm(numbers[3:]) - 5.0, 1e-9, "distance of the pair")
    # of measured ones, whose noise grows as much, nothing is said
    for frequency, measured, own in ((np.exp([0.3]), shape, axes[:, :1]), (np.exp([0.3, 0.5]), pair, axes)):
        said, sure = numbers_of_modes(frequency[None], measured[None].astype(complex), own)
        assert not sure.any() and not said.any()


def test_what_a_pair_of_one_frequency_is_mixed_by_changes_nothing(validation):
    row = validation(what="numbers of a pair of one frequency, mixed", reference="those of the pair unmixed",
                     why="rounding")
    rng = np.random.default_rng(7)
    axes = rng.standard_normal((9, 2))
    shape = np.linalg.qr(axes + 0.1 * rng.standard_normal((9, 2)))[0].astype(complex)
    angle = 0.7
    mixed = shape @ np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    numbers = numbers_of_modes(np.full((2, 2), 1.3), np.array([shape, mixed]), axes)[0]
    row.error(numbers[1] - numbers[0], 1e-12)


@pytest.mark.parametrize("phase", [0.0, 0.8])
def test_the_change_of_modes_whose_shapes_are_not_perpendicular_is_that_of_their_numbers(phase, validation):
    """One channel eight times too large, one a phase late: shapes at an angle of each other, as none of a frame are."""
    row = validation(what="signatures of a pair of like shapes, with a channel eight times too large and "
                          "late, in axes apart from them", reference="central differences of their numbers",
                     why="their own error, of the largest")
    rng, k, n_channel, n, h = np.random.default_rng(int(10 * phase)), 2, 7, 5, 1e-5
    factor = np.ones(n_channel, complex)
    factor[3], factor[5] = 8.0, np.exp(1j * phase)
    tensor, shape = rng.standard_normal((k, k)), factor[:, None] * rng.standard_normal((n_channel, k))
    d_tensor = rng.standard_normal((k, k, n))
    d_shape = factor[:, None, None] * rng.standard_normal((n_channel, k, n))
    tensor, d_tensor = 0.01 * (tensor + tensor.T), 0.01 * (d_tensor + d_tensor.transpose(1, 0, 2))
    axes = shape.real @ (np.eye(k) + 0.3 * rng.standard_normal((k, k))) + 0.1 * rng.standard_normal((n_channel, k))
    made = signature(Reference(tensor=tensor, shape=shape), d_tensor, d_shape, axes)

    def numbers(j, step):
        moved = tensor + step * d_tensor[:, :, j], shape + step * d_shape[:, :, j]
        return numbers_of(Reference(tensor=moved[0][None], shape=moved[1][None]), axes)[0]

    differences = np.column_stack([(numbers(j, h) - numbers(j, -h)) / (2 * h) for j in range(n)])
    row.error((made - differences) / np.abs(differences).max(axis=0), 1e-4)


def test_departures_far_from_the_model_change_as_the_design_says(prepared, record, validation):
    """Where half of a storey is amiss what is left over is large; its derivative with the parameters is still that of
    the signatures, to the second order of the differences."""
    row = validation(what="residuals half a storey away from the model: derivatives with the parameters",
                     reference="central differences of residuals", why="second order of their step, of the largest")
    problem, _ = diagnosis_problem(prepared, record(6, storey=3, factor=0.5))
    theta = np.array([1.1, 0.9, 1.2, 1.0, 0.95])
    noise = noise_of(problem, residuals_at(problem, theta, ()))
    design, residuals, _ = linearise(problem, theta, (), noise, residuals_at(problem, theta, ()))
    assert max(np.abs(y).max() for y in residuals) > 0.2
    for number, k in enumerate(problem.updated):
        sides = []
        for h in (1e-4, -1e-4):
            moved = theta.copy()
            moved[k] += h
            sides.append(residuals_at(problem, moved, ()))
        unknowns = np.zeros(design.n_unknown)
        unknowns[number] = 1.0
        for plus, minus, made, w in zip(*sides, design.expected_residuals(unknowns), noise.weight, strict=True):
            change = ((plus - minus) / 2e-4)[w > 0]
            row.error((change + made[w > 0]) / np.abs(made).max(), 1e-4)


def test_a_ramp_beside_a_reversed_channel_is_seen_through_it(prepared, record, validation):
    """What goes along a ramp enters by its signature: beside what the sensors do already, as a constant does that is as
    large as the ramp is in that block."""
    row = validation(what="a ramp of 1 % of stiffness beside a reversed channel: last block, of what it moves; first "
                          "block", reference="a constant of that block's size", why="second order of 1 %; rounding")
    problem, theta = diagnosis_problem(prepared, record(6))
    constant = next(c for c in problem.time_profiles if c.kind == "constant")
    n = len(problem.blocks)
    ramp = TimeProfile(kind="ramp", value=np.linspace(0.0, 1.0, n))
    reversed_ = next(e for e in problem.effects if e.cause == "sensor polarity")
    storey = next(e for e in problem.effects if e.observe is None)
    known = IncludedEffect(effect=reversed_, time_profile=constant, size=reversed_.discrete[0])
    size = 0.01
    plain = residuals_at(problem, theta, (known,))
    along = residuals_at(problem, theta, (known, IncludedEffect(effect=storey, time_profile=ramp, size=size)))
    whole = residuals_at(problem, theta, (known, IncludedEffect(effect=storey, time_profile=constant, size=size)))
    unseen = residuals_at(problem, theta, (IncludedEffect(effect=storey, time_profile=constant, size=size),))
    without = residuals_at(problem, theta, ())
    for a, b, c in zip(along, plain, whole, strict=True):
        moved = np.abs(c[-1] - b[-1]).max()
        # to the second order of one per cent of stiffness
        row.error((a - c)[-1] / moved, 0.02, "last")
        row.error((a - b)[0], 1e-12, "first")
    # the reversed channel matters: it moves otherwise than it would if it were not
    assert max(np.abs((c - b) - (d - e)).max() / np.abs(c - b).max()
               for b, c, d, e in zip(plain, whole, unseen, without, strict=True)) > 0.2
