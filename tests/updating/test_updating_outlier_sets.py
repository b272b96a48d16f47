"""Sets that are none of the others' population are named with their probability, and leave it as it is."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, stats
from updating_cases import LINEAR_HZ, linear_data, linear_model

from probupdate import verbs
from probupdate.modal.modes import ModalData, ModalSet
from probupdate.updating.discrepancy import LikelihoodSettings
from probupdate.updating.outlier_sets import outlier_sets, step_between_sets

NOISE = 0.003
# the model of these tests misses nothing, and which sets are left out does not hang on what one may miss
EXACT = LikelihoodSettings(discrepancy=0.0)


def measured(seed, n_set=9, scatter=NOISE):
    return LINEAR_HZ * np.exp(scatter * np.random.default_rng(seed).standard_normal((n_set, 5)))


@pytest.mark.parametrize(("off", "n_set", "stated"), [
    (1.1, 9, NOISE), (0.9, 9, 1e-5), (1.04, 12, NOISE), (1.1, 7, NOISE)])
def test_a_set_with_a_frequency_far_off_is_named(off, n_set, stated):
    hits = 0
    for seed in range(20):
        y = measured(seed, n_set)
        y[3, 2] *= off
        found = outlier_sets(linear_data(y, cov=stated))
        hits += found.numbers == (3,) and found.mode[3] == 2
    assert hits >= 19


def test_five_sets_are_too_few_to_leave_one_out():
    """Its probability is said to be high and stays below what is as good as sure."""
    y = measured(2, 5)
    y[3, 2] *= 1.1
    found = outlier_sets(linear_data(y, cov=NOISE))
    assert found.numbers == () and 0.8 < found.probability[3] < 0.95


@pytest.mark.parametrize("n_set", [9, 16])
def test_a_set_of_another_mode_is_an_outlier_however_far_it_is(n_set):
    """Half as much again and twice as much had probability 0.002: the tail of the others' Student t was above it."""
    probability = []
    for off in (1.1, 1.2, 1.5, 2.0, 4.0):
        y = measured(3, n_set)
        y[3, 2] *= off
        found = outlier_sets(linear_data(y, cov=NOISE))
        assert found.numbers == (3,)
        probability.append(found.probability[3])
    assert np.all(np.diff(probability) >= -1e-9)


def test_one_of_four_sets_is_named_with_the_probability_of_quadrature():
    """Nothing is stated; the others' scatter is integrated over a prior uniform in its logarithm. Half of all outliers
    are so by a shape, which is like the others' here."""
    y = measured(2, 4)[:, :1] * np.array([1.0, 1.0, 1.0, 1.06])[:, None]
    data = replace(linear_data(np.hstack([y, np.full((4, 4), np.nan)]), cov=np.nan))
    found, ln = outlier_sets(data), np.log(y[:, 0])
    others, value = ln[:3], ln[3]
    spread = np.geomspace(1e-6, 10, 20001)
    known = spread**-3.0 * np.exp(-np.sum((others - others.mean()) ** 2) / (2 * spread**2))
    next_one = stats.norm.pdf(value, others.mean(), spread * np.sqrt(4 / 3))
    regular = integrate.trapezoid(known * next_one, spread) / integrate.trapezoid(known, spread)
    odds = 0.5 * 0.05 / 0.95 * stats.cauchy.pdf(value, others.mean(), np.hypot(0.05, others.std(ddof=1))) / regular
    assert found.probability[3] == pytest.approx(odds / (1 + odds), rel=0.02)
    (one,) = found.sentences
    assert f"set 3 may be an outlier, with probability {found.probability[3]:.2f}" in one and "5.7 %" in one
    assert found.numbers == ()


def test_sets_of_one_population_are_hardly_ever_outliers(validation):
    row = validation(what="sets of one population called outliers, 100 campaigns of nine sets", reference="none",
                     unit="sets of 900")
    found = [outlier_sets(linear_data(measured(seed), cov=NOISE)) for seed in range(100)]
    row.error(sum(len(x.numbers) for x in found), below=5)
    assert sum(len(x.sentences) for x in found) <= 9


def test_two_outliers_do_not_hide_one_another_and_identical_sets_are_none():
    y = measured(1)
    y[2, 0] *= 1.1
    y[6, 4] *= 0.93
    assert outlier_sets(linear_data(y, cov=NOISE)).numbers == (2, 6)
    assert outlier_sets(linear_data(np.tile(LINEAR_HZ, (6, 1)), cov=NOISE)).numbers == ()
    y[4, 1] = np.nan
    assert outlier_sets(linear_data(y, cov=NOISE)).numbers == (2, 6)


@pytest.mark.parametrize("step", [0.01, 0.05])
def test_rounded_frequencies_are_no_outliers_and_hide_none(step):
    """As reports print them, without standard deviations: most sets have one and the same value."""
    named = []
    for seed in range(20):
        y = measured(seed)
        assert outlier_sets(linear_data(np.round(y / step) * step, cov=np.nan)).numbers == ()
        y[3, 2] *= 1.1
        named.append(outlier_sets(linear_data(np.round(y / step) * step, cov=np.nan)).numbers)
    assert named.count((3,)) >= 19


def test_one_of_three_sets_far_off_is_said_and_used():
    """Two others show next to nothing of their scatter; of sound sets hardly anything is said."""
    named = 0
    for seed in range(20):
        y = measured(seed, 3)
        y[1, 1] *= 1.2
        found = outlier_sets(linear_data(y, cov=NOISE))
        named += any("set 1 may be an outlier" in one and "3 sets do not decide" in one for one in found.sentences)
        assert found.numbers == ()
    assert named >= 15
    assert sum(len(outlier_sets(linear_data(measured(seed, 3), cov=NOISE)).sentences) for seed in range(100)) <= 5


def test_the_population_is_what_the_others_say():
    """The first set, which is the reference, is the outlier."""
    y = measured(5, 7)
    clean = verbs.sets(linear_model(), linear_data(y[1:], cov=NOISE), likelihood=EXACT)
    y[0, 3] *= 1.1
    found = verbs.sets(linear_model(), linear_data(y, cov=NOISE), likelihood=EXACT)
    assert found.ids == tuple(f"set {k}" for k in range(1, 7))
    assert [n for n in found.notes if "set 0 is an outlier with probability" in n and "10 % above" in n]
    for a, b in zip(found.rows, clean.rows, strict=True):
        assert a.joint_mean == pytest.approx(b.joint_mean, abs=0.3 * b.joint_cov * abs(b.joint_mean))
    assert ("varies between sets by" in found.summary) == ("varies between sets by" in clean.summary)


def test_many_sets_that_differ_alike_are_one_sentence():
    y = measured(4, 16)
    y[12:, 1] *= 0.95
    (one,) = outlier_sets(linear_data(y, cov=NOISE)).sentences
    assert "4 of 16 sets, set 12 to set 15" in one and "5.1 % below" in one and "`diagnose`" in one


def moved(course, seed=3):
    """Sets whose frequencies follow a course (n_set,) of ln f, beside what each scatters by itself."""
    return linear_data(measured(seed, len(course)) * np.exp(course)[:, None], cov=NOISE)


@pytest.mark.parametrize("at", [3, 14, 21])
def test_a_step_between_sets_is_said_with_its_set(at: int):
    data = moved(np.where(np.arange(24) < at, 0.0, -0.04))
    words = step_between_sets(data)
    assert f"step between sets {data.sets[at - 1].id} and {data.sets[at].id} " in words and "neither state" in words


def test_a_step_is_said_of_the_modes_that_are_used():
    y = measured(3, 24)
    y[14:, 1:] *= 0.96
    data = replace(linear_data(y, cov=NOISE), labels=tuple("ABCDE"))
    assert "B by -4" in step_between_sets(data, ("A", "B")) and "C by" not in step_between_sets(data, ("A", "B"))
    assert not step_between_sets(data, ("A",))
    said = verbs.update(linear_model(), data, likelihood=EXACT).settings["step between the sets"]
    assert said == step_between_sets(data) and "C by" in said


def test_a_step_does_not_hide_behind_the_scatter_that_it_made():
    """`select` states the scatter over the campaign, a step in it, and keeps the identification's beside it."""
    step = moved(np.where(np.arange(10) < 5, 0.0, -0.04))
    data = replace(step, labels=tuple("ABCDE"), sets=tuple(
        replace(s, frequency_std_hz=0.02 * s.frequency_hz,
                environment={f"own_std_hz_{x}": NOISE * f for x, f in zip("ABCDE", s.frequency_hz, strict=True)})
        for s in step.sets))
    assert f"step between sets {data.sets[4].id} and {data.sets[5].id} " in step_between_sets(data)


def test_drift_and_daily_waves_are_no_step():
    hours = np.arange(24)
    for change in (0.04 * hours / 24, 0.02 * np.sin(2 * np.pi * hours / 24), 0.02 * np.cos(2 * np.pi * hours / 24)):
        assert not step_between_sets(moved(change))


def test_sets_of_one_population_hardly_ever_show_a_step():
    """Of six sets a step of six times the scatter is a t of 7.3 with four degrees of freedom: 0.2 % a frequency."""
    n_draw, n_mode = 300, len(LINEAR_HZ)
    alarms = sum(bool(step_between_sets(moved(np.zeros(6), seed))) for seed in range(n_draw))
    chance = n_mode * 2 * stats.t.sf(6 / np.sqrt(2 / 3), 4)
    assert alarms <= stats.binom.ppf(0.999, n_draw, chance)


def shaped(seed, *, n_set=9, off=0.0, noise=0.01, n_channel=8, turned=0.5, decimals=None):
    """Four modes, the first two a close pair that turns within its plane from set to set; the third's shape is off in
    set 3 by `off` of its length, its frequency is not."""
    rng = np.random.default_rng(seed)
    own, sets = np.linalg.qr(rng.standard_normal((n_channel, 4)))[0], []
    for k in range(n_set):
        shape, angle = own.copy(), turned * rng.standard_normal()
        shape[:, :2] = own[:, :2] @ [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        shape += noise * rng.standard_normal(shape.shape)
        if k == 3:
            away = rng.standard_normal(n_channel)
            shape[:, 2] += off * away / np.linalg.norm(away)
        frequency = np.array([1.0, 1.04, 3.0, 5.0]) * np.exp(NOISE * rng.standard_normal(4))
        scale = rng.uniform(0.5, 2.0, 4) * np.exp(1j * rng.uniform(0, 6, 4))
        shape = shape * scale if decimals is None else np.round(shape / np.abs(shape).max(axis=0), decimals)
        sets.append(ModalSet(id=f"set {k}", frequency_hz=frequency, shape=shape, damping_ratio=np.full(4, 0.01),
                             frequency_std_hz=NOISE * frequency, shape_std=np.full(shape.shape, np.nan)))
    return ModalData(channels=tuple(f"c{i}" for i in range(n_channel)), sets=tuple(sets))


@pytest.mark.parametrize("kind", [{}, {"n_set": 14}, {"noise": 1e-3}, {"n_channel": 5}, {"decimals": 2}])
def test_a_shape_that_is_off_alone_is_named(kind):
    """By ten times what it scatters by."""
    size = 10 * kind.get("noise", 0.01) * np.sqrt(kind.get("n_channel", 8))
    found = [outlier_sets(shaped(seed, off=size, **kind)) for seed in range(10)]
    hits = [x for x in found if x.numbers == (3,) and x.mode[3] == 2 and "its shape of mode 3 is" in x.sentences[0]]
    assert len(hits) >= 8


def test_shapes_of_one_population_are_hardly_ever_outliers():
    kinds = ({}, {"decimals": 2}, {"turned": 1.5}, {"noise": 0.05}, {"n_channel": 4})
    assert sum(len(outlier_sets(shaped(seed, **kind)).numbers) for seed in range(8) for kind in kinds) <= 2


def test_channels_that_some_sets_lack_and_one_sensor_say_nothing_of_shapes():
    data = shaped(1, off=0.5)
    lost = [replace(s, shape=np.where(np.arange(8)[:, None] == k % 3, np.nan, s.shape))
            for k, s in enumerate(data.sets)]
    assert outlier_sets(replace(data, sets=tuple(lost))).numbers == (3,)
    one = tuple(s.of_channels([0]) for s in data.sets)
    assert outlier_sets(ModalData(channels=data.channels[:1], sets=one)).numbers == ()
