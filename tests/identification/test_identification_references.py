"""References of setups before merging: reversed, exchanged, amplified ones by name; what is right stays silent."""

import re
from dataclasses import replace

import numpy as np
import pytest

from probupdate.errors import InputError
from probupdate.identification.references_between import SetupModes, compare_references
from probupdate.modal.modes import Sensor

FREQUENCY = np.array([1.30, 1.42, 1.95, 4.1])
HEIGHT = np.arange(1, 6) / 5
TURN = np.column_stack([0.004 * HEIGHT, -0.003 * HEIGHT, 0.2 * np.sin(np.pi / 2 * HEIGHT), 0.004 * HEIGHT])
ALONG_X = np.column_stack([np.sin(np.pi / 2 * HEIGHT), 0.1 * HEIGHT, 0.02 * HEIGHT, np.sin(1.5 * np.pi * HEIGHT)])
ALONG_Y = np.column_stack([-0.08 * HEIGHT, np.sin(np.pi / 2 * HEIGHT), 0.03 * HEIGHT, 0.05 * HEIGHT])
X, Y = ALONG_X - 4 * TURN, ALONG_Y + 6 * TURN
# a second pair of references elsewhere on the top floor
X2, Y2 = ALONG_X + 5 * TURN, ALONG_Y - 3 * TURN


def setup(name, levels, seed, more=False, error=0.01):
    rows = [X[4], Y[4], *([X2[4], Y2[4]] if more else []), *(s[k - 1] for k in levels for s in (X, Y))]
    channels = ["R1-x", "R1-y", *(["R2-x", "R2-y"] if more else []), *(f"F{k}-{d}" for k in levels for d in "xy")]
    sensors = tuple(Sensor(channel=c, level=c[:2], position_m=[0, 0, 3.0], quantity="acceleration", unit="m/s2",
                           direction=[1, 0, 0] if c.endswith("x") else [0, 1, 0]) for c in channels)
    shape = np.array(rows)
    shape = shape / np.abs(shape).max(axis=0) * [1, -1, 1, -1]
    rng = np.random.default_rng(seed)
    return SetupModes(name=name, sensors=sensors, frequency_hz=FREQUENCY * (1 + 1e-3 * rng.standard_normal(4)),
                      shape=shape + error * rng.standard_normal(shape.shape))


def changed(one, rows, factor=1.0, order=None):
    shape = one.shape.copy()
    shape[rows] = factor * shape[rows if order is None else order]
    return replace(one, shape=shape)


@pytest.mark.parametrize("more", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_setups_that_agree_are_silent(more, seed):
    one, two = setup("one", (1, 2), seed, more, 0.03), setup("two", (3, 4), 100 + seed, more, 0.03)
    assert compare_references([one, two], [s.channel for s in one.sensors[: 4 if more else 2]]) == []


@pytest.mark.parametrize(("more", "row"), [(False, 0), (False, 1), (True, 0), (True, 2), (True, 3)])
def test_a_reversed_reference_is_named_with_what_mends_it(more, row):
    one, two = setup("one", (1, 2), 1, more), changed(setup("two", (3, 4), 2, more), [row], -1.0)
    references = [s.channel for s in one.sensors[: 4 if more else 2]]
    with pytest.raises(InputError, match=f"{references[row]} is reversed between the setups: as .*direction = "):
        compare_references([one, two], references)


@pytest.mark.parametrize("row", [None, 0, 1])
def test_a_reversal_shows_where_each_mode_moves_along_one_direction(row):
    """Of a chimney, references at its top: what a reversal changes is a twentieth of the motion, yet of each mode."""
    height, both = np.arange(1, 7) / 6, []
    along_x = np.column_stack([height**2, 0.05 * height**2, height * np.sin(4.9 * height), 0.05 * height])
    along_y = np.column_stack([-0.05 * height**2, height**2, 0.05 * height, height * np.sin(4.7 * height)])
    for name, levels, seed in (("one", (1, 2, 3), 1), ("two", (4, 5), 2)):
        rows = [s[k - 1] for k in (6, *levels) for s in (along_x, along_y)]
        names = [f"T{k}-{d}" for k in (6, *levels) for d in "xy"]
        noise = 3e-3 * np.random.default_rng(seed).standard_normal((len(rows), 4))
        sensors = tuple(Sensor(channel=c, level=c[:2], position_m=[0, 0, 10.0], quantity="acceleration", unit="m/s2",
                               direction=[1, 0, 0] if c.endswith("x") else [0, 1, 0]) for c in names)
        both.append(SetupModes(name=name, sensors=sensors, frequency_hz=FREQUENCY, shape=np.array(rows) + noise))
    if row is None:
        assert compare_references(both, ["T6-x", "T6-y"]) == []
        return
    with pytest.raises(InputError, match=f"{['T6-x', 'T6-y'][row]} is reversed between the setups"):
        compare_references([both[0], changed(both[1], [row], -1.0)], ["T6-x", "T6-y"])


def test_exchanged_references_are_named():
    one, two = setup("one", (1, 2), 1, True), changed(setup("two", (3, 4), 2, True), [0, 3], order=[3, 0])
    with pytest.raises(InputError, match="R1-x and R2-y are exchanged between the setups"):
        compare_references([one, two], ["R1-x", "R1-y", "R2-x", "R2-y"])


TURNED = [
    ([0, 1], -1.0, [0, 1], r"R1-x and R1-y are reversed between the setups: .*\[-1.0, 0.0, 0.0\] for R1-x, "),
    ([0, 1], [[1.0], [-1.0]], [1, 0], r"R1-x and R1-y are exchanged and (R1-x|R1-y) is reversed between the setups"),
    ([0, 1, 2, 3], 1.0, [2, 3, 0, 1], "R1-x and R2-x are exchanged and R1-y and R2-y are exchanged"),
    ([0, 2], -1.0, [0, 2], "R1-x and R2-x are reversed"),
    ([0, 2, 3], [[1.0], [1.0], [-1.0]], [2, 0, 3], "R1-x and R2-x are exchanged and R2-y is reversed"),
    ([0, 1, 2, 3], [[-1.0], [-1.0], [1.0], [1.0]], [2, 3, 0, 1],
     "exchanged and R1-y and R2-y are exchanged and R.-x and R.-y are reversed"),
    ([0, 1, 2], 1.0, [1, 2, 0], r"R1-x, R2-x, R1-y are in one another's places \(R2-x of two is R1-x of one, "),
]


@pytest.mark.parametrize(("rows", "factor", "order", "said"), TURNED,
                         ids=["half a turn", "a quarter", "places exchanged", "two places", "a third too",
                              "places and half a turn", "three in turn"])
def test_boxes_that_were_turned_or_exchanged_are_named(rows, factor, order, said):
    one, two = setup("one", (1, 2), 1, True), changed(setup("two", (3, 4), 2, True), rows, np.array(factor), order)
    with pytest.raises(InputError, match=said):
        compare_references([one, two], ["R1-x", "R1-y", "R2-x", "R2-y"])


def test_a_quarter_turn_of_the_only_references_is_named():
    one, two = setup("one", (1, 2), 1), changed(setup("two", (3, 4), 2), [0, 1], np.array([[1.0], [-1.0]]), [1, 0])
    with pytest.raises(InputError, match=r"exchanged and .* is reversed .*\(or R1-[xy] reversed instead\)"):
        compare_references([one, two], ["R1-x", "R1-y"])


def test_references_that_are_all_reversed_are_said():
    one, two = setup("one", (1, 2), 1), changed(setup("two", (3, 4), 2), [0, 1], -1.0)
    (said,) = compare_references([one, two], ["R1-x", "R1-y"])
    assert said.startswith("R1-x, R1-y move with the other sensors of their directions in one of the setups one and ")


@pytest.mark.parametrize("rows", ([0], [0, 1], [2]))
def test_a_velocity_stated_as_an_acceleration_is_refused(rows):
    one, two = setup("one", (1, 2), 1), setup("two", (3, 4), 2)
    late = two.shape.astype(complex)
    late[rows] /= 2j * np.pi * FREQUENCY
    with pytest.raises(InputError, match="setup two, .*a quarter of a period from the other channels"):
        compare_references([one, replace(two, shape=late)], ["R1-x", "R1-y"])


def test_shapes_that_no_change_explains_are_said():
    rng = np.random.default_rng(3)
    one, two = setup("one", (1, 2), 1, True), setup("two", (3, 4), 2, True)
    two = replace(two, shape=np.vstack([rng.standard_normal((4, 4)), two.shape[4:]]))
    (said,) = compare_references([one, two], ["R1-x", "R1-y", "R2-x", "R2-y"])
    assert "no change of references explains it" in said


def test_a_reference_with_another_gain_is_named_with_its_size():
    one, two = setup("one", (1, 2), 1, True), changed(setup("two", (3, 4), 2, True), [2], 3.0)
    with pytest.raises(InputError, match=r"R2-x reads (2\.[89]|3|3\.[01])\d* times as much in two as in one"):
        compare_references([one, two], ["R1-x", "R1-y", "R2-x", "R2-y"])


def test_frequencies_two_per_cent_apart_with_equal_shapes_are_said():
    one, two = setup("one", (1, 2), 1), setup("two", (3, 4), 2)
    (said,) = compare_references([one, replace(two, frequency_hz=1.02 * two.frequency_hz)], ["R1-x", "R1-y"])
    assert re.match(r"the frequencies of two are (1\.9|2|2\.1) % above those of one, with equal shapes", said)
