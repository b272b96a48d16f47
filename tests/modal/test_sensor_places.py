"""Sensors of one place and of one height, whatever the size of the structure and wherever its origin is."""

import numpy as np
import pytest

from probupdate.effects.catalogue import positions, sensor_groups
from probupdate.modal.modes import Sensor
from probupdate.modal.sensor_places import sensors_by_height, sensors_by_place


def sensors(points, names="abcdef", scale=1.0):
    return [Sensor(channel=name, level="", position_m=scale * np.array(point), direction=np.array([1.0, 0, 0]),
                   quantity="acceleration", unit="m/s2") for name, point in zip(names, points, strict=False)]


POINTS = [(0, 0, 0.145), (0, 0, 0.14500001), (0.5, 0, 0.1451), (0, 0, 80.0), (0.3, 0, 80.0)]


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_places_and_heights_hang_on_the_size(scale):
    there = sensors(POINTS, scale=scale)
    assert sensors_by_place(there) == [[0, 1], [2], [3], [4]]
    assert sensors_by_height(there) == [[0, 1, 2], [3, 4]]


def test_no_digit_parts_what_is_together():
    """4.995 and 5.005 m round to other hundredths, 0.049 and 0.051 m to other tenths."""
    there = sensors([(0, 0, 4.995), (0, 0, 5.004), (0, 0, 0.049), (2, 0, 0.051), (0, 0, 60.0)])
    assert sensors_by_place(there) == [[0, 1], [2], [3], [4]]
    assert sensors_by_height(there) == [[2, 3], [0, 1], [4]]


def test_one_place_alone_and_none():
    assert sensors_by_place([]) == sensors_by_height([]) == []
    assert sensors_by_place(sensors([(1, 2, 3), (1, 2, 3)])) == sensors_by_height(sensors([(1, 2, 3),
                                                                                           (1, 2, 3)])) == [[0, 1]]


def test_places_whose_channels_begin_alike_have_names_of_their_own():
    there = sensors([(0, 0, 0), (0, 0, 0), (0, 0, 9), (0, 0, 9), (0, 0, 20)], names=("A1", "A2", "A3", "A4", "A"))
    rows = {s.channel: k for k, s in enumerate(there)}
    assert [(name, own) for name, own, _ in positions(there, rows)] == [
        ("A1 and A2", (0, 1)), ("A3 and A4", (2, 3)), ("A", (4,))]


def test_a_height_is_one_logger_where_no_level_is_stated():
    there = sensors([(0, 0, 9.0), (4, 0, 9.0), (4, 4, 9.001), (0, 0, 2.0), (4, 0, 2.0)])
    rows = {s.channel: k for k, s in enumerate(there)}
    assert dict(sensor_groups(there, rows)) == {
        "a": (0,), "b": (1,), "c": (2,), "d": (3,), "e": (4,), "all of z = 9 m": (0, 1, 2), "all of z = 2 m": (3, 4)}
