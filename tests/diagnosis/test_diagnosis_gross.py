"""What is far wrong with sensors: found whatever a fit without it makes of it, in the order a signal takes."""

from dataclasses import replace

import numpy as np
import pytest

import probupdate
from probupdate.diagnosis import hypotheses
from probupdate.diagnosis.adequacy import adequacy, spanning_candidates, whitening_matrix
from probupdate.diagnosis.diagnose import ALIKE_SHAPES, examine
from probupdate.diagnosis.extension import corrections
from probupdate.diagnosis.fitting import fit
from probupdate.diagnosis.hypotheses import refit_without
from probupdate.diagnosis.mode_numbers import Reference
from probupdate.diagnosis.predictor import observe
from probupdate.diagnosis.prepare import prepare
from probupdate.diagnosis.problem import IncludedEffect, diagnosis_problem
from probupdate.diagnosis.proposals import sizes_of, try_candidates
from probupdate.diagnosis.search import drawn_scores
from probupdate.effects.catalogue import Effect, measurement_effects
from probupdate.errors import InputError
from probupdate.modal.modes import ModalData, ModalSet, Sensor

SENSORS = tuple(
    Sensor(channel=f"top-{axis}", position_m=np.array([0.0, 0.0, 10.0]), direction=np.eye(3)[k], level="top")
    for k, axis in enumerate("xyz")
)


def of_sensors(data, change):
    """The record as these sensors' signals were: `change` of the shapes (n_channel, n_mode) of a set."""
    return replace(data, sets=tuple(replace(s, shape=change(np.array(s.shape))) for s in data.sets))


def exchanged(shape, first, second):
    shape[[first, second]] = shape[[second, first]]
    return shape


@pytest.fixture(scope="module")
def prepared(frame_file):
    return prepare(frame_file)


@pytest.mark.parametrize(("first", "second"), [
    pytest.param("y1", "x5", marks=pytest.mark.long), pytest.param("x4", "x5", marks=pytest.mark.long), ("x2", "y2"),
])
def test_exchanged_channels_are_named(prepared, record, first, second, validation):
    row = validation(what="exchanged channels in a frame, three pairs, one of them leaving no two shapes of a pair of "
                          "modes: verdict, cause, place, time profile", reference="what was hidden")
    data = record(11)
    rows = [data.channels.index(c) for c in (first, second)]
    found = probupdate.diagnose(prepared, of_sensors(data, lambda s: exchanged(s, *rows)), extend=False)
    (one,) = found.findings
    row.equal((found.verdict, one.cause, one.location, one.time_profile),
              ("named", "swapped channels", f"{first} and {second}", "constant"))


# inner points and parts of a beam on a bed that makes its five lowest modes lie within an octave, points with a channel
N_POINT, N_SPAN, BED, SEEN = 11, 4, 2e7, (0, 2, 4, 6, 8, 10)


def curvatures():
    """(N_POINT, N_POINT) second differences of a beam on two supports at its inner points."""
    return 2 * np.eye(N_POINT) - np.eye(N_POINT, k=1) - np.eye(N_POINT, k=-1)


@pytest.fixture(scope="module")
def beam(tmp_path_factory):
    """Bending stiffness of its quarters as parameters."""
    folder, rows = tmp_path_factory.mktemp("beam"), curvatures()
    arrays = {f"K_s{k}": 4e7 * rows[own].T @ rows[own] for k, own in
              enumerate(np.array_split(np.arange(N_POINT), N_SPAN))}
    channels = np.array([f"p{k:02d}" for k in SEEN])
    np.savez(folder / "model.npz", K0=BED * np.eye(N_POINT), M0=2e3 * np.eye(N_POINT), channel=channels,
             channel_dof=np.array(SEEN), **arrays)
    (folder / "model.toml").write_text("".join(
        f'[[parameter]]\nname = "s{k}"\nunit = "-"\ninitial = 1.0\ncov = 0.1\nlower = 0.2\nupper = 2.0\n'
        for k in range(N_SPAN)))
    return prepare(folder / "model.npz"), arrays, tuple(map(str, channels))


@pytest.mark.parametrize(("first", "second"), [
    (0, 1), (1, 2), (4, 5), *(pytest.param(*pair, marks=pytest.mark.long) for pair in ((2, 3), (0, 2), (3, 5))),
])
def test_neighbours_exchanged_where_shapes_are_more_like_other_modes_are_named(beam, first, second, validation):
    """Modes are paired as these channels show them."""
    row = validation(what="two of six channels of a beam on a bed exchanged: cause, places",
                     reference="what was hidden")
    prepared, arrays, channels = beam
    rng = np.random.default_rng([first, second])
    stiffness = BED * np.eye(N_POINT) + sum((1 + 0.03 * rng.standard_normal()) * K for K in arrays.values())
    value, phi = np.linalg.eigh(stiffness / 2e3)
    frequency, phi = np.sqrt(value[:5]) / (2 * np.pi), phi[list(SEEN), :5]
    phi = phi / np.abs(phi).max(axis=0)
    sets = []
    for b in range(24):
        shape = phi + 0.01 * (rng.standard_normal(phi.shape) + 1j * rng.standard_normal(phi.shape))
        sets.append(ModalSet(
            id=f"2026-01-{b + 1:02d}T00:00:00", frequency_hz=frequency * (1 + 2e-3 * rng.standard_normal(5)),
            shape=exchanged(shape, first, second), damping_ratio=np.full(5, 0.01),
            frequency_std_hz=2e-3 * frequency, shape_std=np.full(phi.shape, 0.01)))
    (one,) = probupdate.diagnose(prepared, ModalData(channels=channels, sets=tuple(sets)), extend=False).findings
    row.equal((one.cause, one.location), ("swapped channels", f"{channels[first]} and {channels[second]}"), "finding")
    assert one.posterior_probability > 0.95


@pytest.mark.parametrize("seeds", [range(1, 3), pytest.param(range(3, 7), marks=pytest.mark.long)])
def test_sets_in_which_another_mode_was_identified_count_for_nothing_and_are_said(prepared, record, seeds, validation):
    """Of each mode one set in twenty is off, 1 to 5 % in frequency and 20 % in every component."""
    row = validation(what="six frames with nothing hidden, one set of twenty of each mode being another mode: those "
                          "that are not taken for it, sound ones of 480 that are; silent or not",
                     reference="those made so; without these modes of these sets",
                     why="one may have four strays nearest to it")
    sound_ones = 0
    for seed in seeds:
        rng, data = np.random.default_rng(seed), record(seed)
        off = rng.random((len(data.sets), data.n_mode)) < 0.05
        there, without = [], []
        for s, own in zip(data.sets, off, strict=True):
            moved = rng.choice([-1, 1], len(own)) * rng.uniform(0.01, 0.05, len(own))
            other = s.shape + 0.2 * rng.standard_normal(s.shape.shape)
            there.append(replace(s, frequency_hz=s.frequency_hz * (1 + np.where(own, moved, 0.0)),
                                 shape=np.where(own, other, s.shape)))
            without.append(replace(s, frequency_hz=np.where(own, np.nan, s.frequency_hz),
                                   shape=np.where(own, np.nan, s.shape)))
        outcome = examine(prepared, replace(data, sets=tuple(there)), seed=seed)
        far = np.column_stack(outcome.fitted.design.noise.stray)
        made = np.column_stack([off[:, list(group)].any(axis=1) for group in outcome.problem.blocks.groups])
        row.equal(np.argwhere(made & ~far).tolist(), [], "not taken")
        sound_ones += np.sum(far & ~made)
        plain = examine(prepared, replace(data, sets=tuple(without)), seed=seed)
        # of one, a chance of 5.3 standard deviations is just beyond and just below "named"
        row.equal(outcome.diagnosis.verdict == "none", plain.diagnosis.verdict == "none", "silent or not")
        said = [note for note in outcome.diagnosis.notes if "far from both neighbours" in note]
        assert len(said) == far.any(axis=0).sum() and "(2020-01-" in said[0]
    row.error(sound_ones, 2, "sound ones")


def test_a_pair_measured_as_one_shape_is_unexplained_and_said(prepared, record):
    """An identification that gives both modes of a pair the same shape."""

    def change(shape):
        shape[:, 1] = shape[:, 0]
        return shape

    found = probupdate.diagnose(prepared, of_sensors(record(14), change), extend=False)
    assert found.verdict == "unexplained" and not found.findings
    assert any(ALIKE_SHAPES in note for note in found.notes)


def test_sets_whose_every_pair_is_one_shape_are_refused(prepared, record):
    """Not one number of theirs can be scored; nor where a few sets have two shapes, of whose noise too little is
    known (three had been enough for a false finding)."""
    data = record(14, n_mode=2)

    def change(shape):
        shape[:, 1] = shape[:, 0]
        return shape

    alike = of_sensors(data, change)
    for number in (0, 3):
        sets = (*data.sets[:number], *alike.sets[number:])
        with pytest.raises(InputError, match=f"modes: {40 - number} of 40 sets carry no information.*without shapes"):
            probupdate.diagnose(prepared, replace(data, sets=sets), extend=False)


def test_sets_that_say_nothing_since_a_time_are_not_nothing(prepared, record, validation):
    """Since a step one mode of each pair is lost, as where a channel drowns both; missed here and there is chance."""
    row = validation(what="one of each pair of modes lost since the thirtieth of 40 sets, in as many sets by chance: "
                          "verdict", reference="unexplained; none")
    data, rng = record(1), np.random.default_rng(1)
    by_chance = rng.permutation(np.arange(len(data.sets)) >= 30)
    for lost, verdict in ((np.arange(len(data.sets)) >= 30, "unexplained"), (by_chance, "none")):
        sets = []
        for s, is_lost in zip(data.sets, lost, strict=True):
            frequency, shape = np.array(s.frequency_hz), np.array(s.shape)
            if is_lost:
                frequency[1::2], shape[:, 1::2] = np.nan, np.nan
            sets.append(replace(s, frequency_hz=frequency, shape=shape))
        found = probupdate.diagnose(prepared, replace(data, sets=tuple(sets)), extend=False)
        row.equal(found.verdict, verdict)
        assert ("10 of 10 sets have modes but no information" in found.notes[0]) == (verdict == "unexplained")


def test_two_causes_at_the_end_of_what_they_can_be_are_no_explanation(prepared, record, monkeypatch):
    """Two storeys that lose more than their rows allow, against the same with rows that allow it."""
    both = record(15, storey=1, factor=0.75, from_block=0), record(15, storey=3, factor=0.75, from_block=20)
    sets = tuple(a if k < 20 else b for k, (a, b) in enumerate(zip(*(r.sets for r in both), strict=True)))
    data = replace(both[0], sets=sets)
    narrow = tuple(replace(e, lower=max(e.lower, -0.1), upper=min(e.upper, 0.1)) if e.cause == "parameter" else e
                   for e in prepared.effects)
    tight = examine(replace(prepared, effects=narrow), data).diagnosis
    at_end = [note for note in tight.notes if "stands at an end" in note]
    assert at_end and tight.verdict == "unexplained"


def test_a_reversed_channel_beside_a_wrong_gain_and_a_storey_that_loosens(prepared, record, validation):
    row = validation(what="a reversed channel beside a wrong gain and a storey that loosens: verdict, causes, places",
                     reference="what was hidden")
    data = record(12, storey=2, factor=0.85, from_block=22)
    reversed_, other = data.channels.index("x3"), data.channels.index("y5")

    def change(shape):
        shape[reversed_] *= -1
        shape[other] *= 1.4
        return shape

    found = probupdate.diagnose(prepared, of_sensors(data, change), extend=False)
    row.equal((found.verdict, {(f.cause, f.location) for f in found.findings}),
              ("named", {("sensor polarity", "x3"), ("sensor gain", "y5"), ("parameter", "k3")}))


@pytest.mark.parametrize(("seed", "reverse", "first", "second"), [
    pytest.param(100, "y5", "x4", "y4", marks=pytest.mark.long),  # alone, another exchange explains more than either
    (102, "x4", "x5", "y5"),  # a gain that the first fit is bent into, and of which nothing is left at the end
    # a share of another channel is the only one whose fit settles at first
    pytest.param(112, "y1", "x1", "y4", marks=pytest.mark.long),
])
def test_a_reversed_channel_beside_exchanged_ones(prepared, record, seed, reverse, first, second, validation):
    """Each hides the other from a search of one cause after the other."""
    row = validation(what="a reversed channel beside two exchanged ones, three records in which each hid the other: "
                          "causes, places", reference="both and nothing else")
    data = record(seed)
    rows = [data.channels.index(c) for c in (first, second)]

    def change(shape):
        shape = exchanged(shape, *rows)
        shape[data.channels.index(reverse)] *= -1
        return shape

    found = probupdate.diagnose(prepared, of_sensors(data, change), extend=False)
    assert found.verdict in ("named", "ambiguous")
    row.equal({(f.cause, f.location) for f in found.findings},
              {("sensor polarity", reverse), ("swapped channels", f"{first} and {second}")})


def test_an_exchange_that_was_none_is_given_up(prepared, record, validation):
    """Two reversed channels side by side: the scores of a fit bent to follow them lead to an exchange of others."""
    row = validation(what="two reversed channels side by side, where the first search leads to an exchange of others: "
                          "causes, places", reference="both and nothing else")
    data = record(200)
    rows = [data.channels.index(c) for c in ("x2", "x3")]

    def change(shape):
        shape[rows] *= -1
        return shape

    found = probupdate.diagnose(prepared, of_sensors(data, change), extend=False)
    assert found.verdict in ("named", "ambiguous")
    row.equal({(f.cause, f.location) for f in found.findings}, {("sensor polarity", "x2"), ("sensor polarity", "x3")})


def test_of_a_cause_that_another_explains_nothing_is_left(prepared, record, validation):
    """A gain of a channel that is right, beside one that is not; and both where both are there."""
    row = validation(what="gains included, one of them of a channel that is right, and two that are wrong: those that "
                          "make the record more probable", reference="those that are there")
    data = record(17)
    right, wrong = data.channels.index("x2"), data.channels.index("y4")
    for factor, expected in ((1.0, [1]), (0.8, [0, 1])):

        def change(shape, factor=factor):
            shape[wrong] *= 1.3
            shape[right] *= factor
            return shape

        problem, theta = diagnosis_problem(prepared, of_sensors(data, change))
        effects = {(e.cause, e.location): e for e in problem.effects}
        included = [IncludedEffect(effect=effects["sensor gain", channel], time_profile=problem.time_profiles[0],
                                   size=0.1)
                 for channel in ("x2", "y4")]
        fitted = fit(problem, theta, included)
        # what is there makes the record more probable
        there = [i for i in range(2) if refit_without(problem, fitted, i)[1] < 0]
        assert fitted.settled
        row.equal(there, expected)


def test_of_all_sizes_tried_the_true_one_explains_most(prepared, record):
    data = record(13)
    row = data.channels.index("y4")

    def change(shape):
        shape[row] *= 3.0
        return shape

    problem, _ = diagnosis_problem(prepared, of_sensors(data, change))
    best = try_candidates(problem, (), np.ones(len(problem.which), bool))[0]
    effect = problem.effects[problem.which[best.candidate, 0]]
    assert (effect.cause, effect.location) == ("sensor gain", "y4") and best.whole
    # of 0.1 times powers of two, the size itself is 2
    assert best.size == pytest.approx(1.6)


def test_sizes_tried_lie_within_the_bounds_and_reach_them():
    known = dict(kind="measurement", cause="a", location="b", unit="-", tolerance=0.0, observe=lambda s, f, x: (s, 0.0))
    only = Effect(**known, prior_scale=2.0, lower=-2.0, upper=0.0, discrete=(-2.0,))
    assert sizes_of(only) == [-2.0]
    gain = Effect(**known, prior_scale=0.1, lower=-0.98, upper=20.0)
    np.testing.assert_allclose(sizes_of(gain), [-0.8, -0.4, -0.2, -0.1, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8])
    free = Effect(**known, prior_scale=1.0)
    assert sizes_of(free) == sorted(sizes_of(free)) and np.isfinite(sizes_of(free)).all()


def test_a_sensor_turned_and_reversed_is_seen_in_the_order_of_its_signal(validation):
    """The mounting first, then the sensor's sign, then its cable, whatever was found first."""
    row = validation(what="a sensor turned, reversed and exchanged, found in either order: shapes, correction",
                     reference="product of the three matrices", why="rounding")
    effects = {(e.cause, e.location): e for e in measurement_effects([s.channel for s in SENSORS], SENSORS)}
    turn, reverse = effects["sensor rotation", "top about z"], effects["sensor polarity", "top-x"]
    swap = effects["swapped channels", "top-x and top-z"]
    shape = np.random.default_rng(3).standard_normal((3, 2)) + 0j
    c, s = np.cos(np.radians(30)), np.sin(np.radians(30))
    turned = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    sign, cable = np.diag([-1.0, 1.0, 1.0]), np.eye(3)[[2, 1, 0]]
    included = [(reverse, -2.0), (swap, 1.0), (turn, 30.0)]
    reference = Reference(tensor=np.diag([0.1, 0.2]), shape=shape)
    for order in (included, included[::-1]):
        row.error(observe([reference], order)[0].shape - cable @ sign @ turned @ shape, 1e-14, "shapes")
        found = [IncludedEffect(effect=e, time_profile=None, size=size) for e, size in order]
        A, shift = corrections(3, found, np.ones(3), 1.0)
        row.error(A - cable @ sign @ turned, 1e-14, "correction")
        assert shift == 0.0


def test_a_step_within_a_block_is_told_so(prepared, record, validation):
    """A block of which the last half has the effect is neither before nor after."""
    row = validation(what="a step half-way through a block: verdict, place, values before and after it; its own value",
                     reference="what was hidden; 0.5")
    data = record(4, storey=2, factor=0.7, from_block=19)
    half = record(4, storey=2, factor=0.85, from_block=18).sets[18]
    sets = (*data.sets[:18], half, *data.sets[19:])
    outcome = examine(prepared, replace(data, sets=sets))
    (one,) = outcome.fitted.included
    # the third storey, half of whose loss that block has
    value = one.time_profile.value
    row.equal((outcome.diagnosis.verdict, one.effect.location, value[17], value[19]), ("named", "k3", 0.0, 1.0), "name")
    row.between(value[18], 0.2, 0.8, "value")


def directions_of(outcome, at):
    """(number of the step's time profile, effects, weights) of the directions that the catalogue spans with it."""
    design = outcome.null.design
    c = next(c for c, one in enumerate(design.time_profiles) if one.kind == "step" and one.at == at)
    rows = np.flatnonzero((design.which[:, 1] == c) & spanning_candidates(outcome.problem, design))
    return c, design.which[rows, 0], whitening_matrix(design, rows)


@pytest.mark.parametrize("factor", [1.0, 1.3])
def test_blocks_tell_how_far_they_scatter_along_a_direction(stepped, factor, validation):
    """Of records drawn from the design itself, and with noise of `factor` times the variance."""
    row = validation(what="scatter of blocks along a step's directions, noise of 1 and 1.3 times the variance, mean "
                          "square of sixty records", reference="the factor",
                     why="a few hundredths that the fitted unknowns take, and four standard errors of one hundredth")
    outcome = stepped[2]
    design, rng = outcome.null.design, np.random.default_rng(8)
    noise = replace(design.noise, covariance=tuple(factor * c for c in design.noise.covariance))
    drawn, along = replace(design, noise=noise), directions_of(outcome, 18)
    found_here = [np.mean(design.scatter(drawn.simulate(rng), *along) ** 2) for _ in range(60)]
    row.error(np.mean(found_here) / factor - 1, 0.08)


def test_few_blocks_whose_noise_is_stated_say_nothing_of_their_scatter(stepped):
    """Of a few sets a contrast that is far off would be its own excuse."""
    outcome = stepped[2]
    design, along = outcome.null.design, directions_of(outcome, 18)
    stated = replace(design, noise=replace(design.noise, stated=True))
    drawn = design.simulate(np.random.default_rng(9))
    assert np.all(stated.scatter(drawn, *along) == 1.0) and not np.all(design.scatter(drawn, *along) == 1.0)


def test_one_block_gone_wrong_is_no_step_of_the_first_few(prepared, record, monkeypatch, validation):
    """Along the direction that a step of the first blocks shows best: one of them far off, and all by as much
    together."""
    row = validation(what="p of the residual: one of the first blocks far off along a direction, all of them together",
                     reference="no step, a step", why="one in a hundred is a false alarm")
    outcome = examine(prepared, record(3))
    problem, design, found = outcome.problem, outcome.null.design, outcome.first
    first = min(c.at for c in design.time_profiles if c.kind == "step")
    c, effects, weights = directions_of(outcome, first)
    signature = [E[0][:, effects] @ weights[:, -1] for E in design.effect]
    drawn = drawn_scores(design, 1)

    def p_with(blocks):
        made = [np.zeros_like(y) for y in outcome.null.centred]
        for y, one in zip(made, signature, strict=True):
            y[list(blocks)] = one
        # as large as eight standard deviations of a step
        scale = 8 / np.linalg.norm(design.scores(made)[(design.which[:, 1] == c) & np.isin(design.which[:, 0], effects)]
                                   @ weights)
        y = tuple(a + scale * b for a, b in zip(outcome.null.centred, made, strict=True))
        return adequacy(problem, replace(outcome.null, centred=y), replace(found, u=design.scores(y)), drawn)[0]

    row.between(p_with([1]), 0.01, 1.001, "one block")
    row.between(p_with(range(first)), 0.0, 0.01, "a step")
    monkeypatch.setattr("probupdate.diagnosis.linear.Design.scatter", lambda *_: 1.0)
    assert p_with([1]) < 0.01


def test_a_channel_reversed_within_a_block_is_reversed_before_or_after_it(prepared, record):
    """Half a reversal would leave nothing of the channel, and no way back to what it measured."""
    data = record(16)
    row = data.channels.index("y3")
    signs = np.ones((len(data.sets), len(data.channels), 1))
    signs[20, row], signs[21:, row] = 0.3, -1.0
    sets = tuple(replace(s, shape=sign * s.shape) for s, sign in zip(data.sets, signs, strict=True))
    outcome = examine(prepared, replace(data, sets=sets))
    reversed_there = [n for n in outcome.fitted.included if n.effect.cause == "sensor polarity"]
    assert [n.effect.location for n in reversed_there] == ["y3"]
    assert set(reversed_there[0].time_profile.value) == {0.0, 1.0} and reversed_there[0].time_profile.at in (20, 21)


def test_where_no_large_fault_fits_at_its_own_size_the_scores_choose(prepared, record, monkeypatch):
    monkeypatch.setattr(hypotheses, "large_moves", lambda *args: [])
    outcome = examine(prepared, record(7, gain=("y2", 9.81)))
    assert "sensor gain, y2" in [n.effect.name for n in outcome.fitted.included]


@pytest.mark.long
def test_the_remainder_of_records_with_nothing_wrong_is_uniform(prepared, record, monkeypatch, validation):
    """p of a thousand records drawn from the design: as many below every level as it says, as far as four hundred draws
    show a level (0.01 to 0.005). Of the directions that the catalogue spans: the mean frequencies' own p, of which
    the smaller of both counts twice, is the same for all."""
    row = validation(what="p of the residual, 1000 records with nothing wrong: share below 0.01, 0.02, 0.05, 0.2, 0.4",
                     reference="uniform", why="of 1000 records and of 400 draws", unit="standard errors")
    outcome = examine(prepared, record(3))
    monkeypatch.setattr("probupdate.diagnosis.linear.Design.scatter", lambda *_: 1.0)
    monkeypatch.setattr("probupdate.diagnosis.adequacy.PATTERN", 1.0)
    monkeypatch.setattr("probupdate.diagnosis.adequacy._frequencies", lambda *_: 1.0)
    found, drawn = replace(outcome.first, heavier=1.0), drawn_scores(outcome.null.design, 1)
    n = 1000
    p = np.array([adequacy(outcome.problem, outcome.null, replace(found, u=u), drawn)[0]
                  for u in outcome.null.design.draw(np.random.default_rng(8), n)])
    for level in (0.01, 0.02, 0.05, 0.2, 0.4):
        spread = np.sqrt(level * (1 - level) * (1 / n + 1 / 400))
        row.error((np.mean(0.5 * p <= level) - level) / spread, 3.3, case=level)
