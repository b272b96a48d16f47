"""Modes that are measured and that the model does not have: programs drop one of a symmetric pair, or move one way."""

import numpy as np
import pytest

from probupdate import verbs
from probupdate.modal.modes import ModalData, ModalSet
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.functions import FunctionModel

CHANNELS, TRUTH = ("ax", "ay", "bx", "by", "cx", "cy"), 0.85
SHAPES = np.array([[0.35, 0.7, 1.0], [-0.6, -0.1, 1.0], [0.6, -0.7, 1.0]])
PARAMETERS = Parameters((Parameter(name="E", unit="-", initial=1.0, std=0.2, lower=0.5, upper=1.5),))


def modes(e):
    """Three bending modes in two planes, equal both ways: f (6,), shapes (6 channels, 6)."""
    f, shape = [], np.zeros((6, 6))
    for k, line in enumerate(SHAPES):
        for direction in (0, 1):
            f.append((0.8, 5.0, 14.0)[k] * np.sqrt(e))
            shape[direction::2, 2 * k + direction] = line
    return np.array(f), shape


def updated(kept, angle_deg=0.0):
    model = FunctionModel(name="t", parameters=PARAMETERS, channels=CHANNELS, version="1",
                          function=lambda theta: tuple(x[..., kept] for x in modes(theta[0])))
    f, shape = (x[..., :4] for x in modes(TRUTH))
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    shape = shape @ np.kron(np.eye(2), [[c, -s], [s, c]])
    one = ModalSet(id="a", frequency_hz=f * [1, 1.01, 1, 1.01], damping_ratio=np.full(4, 0.01), shape=shape,
                   frequency_std_hz=0.005 * f, shape_std=np.full(shape.shape, 0.02))
    return verbs.update(model, ModalData(channels=CHANNELS, sets=(one,)))


@pytest.mark.parametrize(("kept", "lost", "angle"), [
    ([0, 1, 2, 3, 4, 5], (), 0), ([1, 2, 3, 4, 5], (1,), 0), ([0, 2, 3, 4, 5], (2,), 0), ([0, 1, 3, 4, 5], (3,), 0),
    ([0, 2, 4], (2, 4), 0), ([1, 3, 5], (1, 3), 0), ([0, 1, 2, 4, 5], (4,), 15),
])
def test_the_other_of_a_pair_is_used_and_the_missing_mode_named(kept, lost, angle):
    record = updated(kept, angle)
    assert record.map_theta[0] == pytest.approx(TRUTH, abs=0.02)
    assert not record.suspected
    named = [number for number in range(1, 5) if f"no mode for the measured mode {number};" in record.summary]
    assert tuple(named) == lost
    assert np.isfinite(record.map_hz).sum() == 4 - len(lost)
