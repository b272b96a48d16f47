"""A reversed sensor among those of one line, without a model; sound lines stay silent. Motion by scipy alone."""

import numpy as np
import pytest
from scipy import linalg, signal

from probupdate.campaign.checking import check
from probupdate.campaign.mounting import suspicions
from probupdate.campaign.reading import read_campaign
from probupdate.campaign.spectra import cross_spectra
from probupdate.modal.modes import Sensor

RATE = 20.0
EVEN, HIGHER = (1, 1, 1, 1, 1), (0.05, 1, 1, 0.5, 0.5)


def chain(n=5):
    """Frequencies (first 1) and shapes of equal storeys, at their floors."""
    stiffness = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    stiffness[-1, -1] = 1
    value, shape = linalg.eigh(stiffness)
    return np.sqrt(value / value[0]), shape, np.arange(1, n + 1) / n


def beam(root, shape, places):
    places = np.asarray(places)
    return np.asarray(root) ** 2 / root[0] ** 2, np.array([shape(b, places) for b in root]).T, places


def cantilever(places):
    def shape(b, x):
        k = (np.cosh(b) + np.cos(b)) / (np.sinh(b) + np.sin(b))
        return np.cosh(b * x) - np.cos(b * x) - k * (np.sinh(b * x) - np.sin(b * x))

    return beam((1.87510407, 4.69409113, 7.85475744), shape, places)


def supported(places):
    return beam(np.pi * np.arange(1, 5), lambda b, x: np.sin(b * x), places)


def moved(structure, weight, seed, noise=0.02, first_hz=0.6, n=12000):
    ratio, shape, _ = structure
    rng = np.random.default_rng(seed)
    y = np.zeros((n, len(shape)))
    for j in np.flatnonzero(first_hz * ratio < 0.4 * RATE):
        w = 2 * np.pi * first_hz * ratio[j]
        pole = np.exp((-0.01 + 1j) * w / RATE)
        q = signal.lfilter([1, 0, -1], np.poly([pole, pole.conj()]).real, rng.standard_normal(n + 2000))[2000:]
        y += weight[j] * np.outer(q / q.std(), shape[:, j] / np.abs(shape[:, j]).max())
    return y + noise * y.std(axis=0).max() * rng.standard_normal(y.shape)


def sensors_of(places, upright):
    return tuple(Sensor(channel=f"A{k + 1}", level="", position_m=[0, 0, 15 * x] if upright else [15 * x, 0, 0],
                        direction=[1, 0, 0] if upright else [0, 0, 1]) for k, x in enumerate(places))


def flipped(structure, upright, data):
    found = suspicions(cross_spectra(data, RATE, 0.4 * RATE), sensors_of(structure[2], upright))
    return [s.channels[0] for s in found if s.kind == "flipped"]


LINES = {
    "storeys": (chain(), True), "four storeys": (chain(4), True), "mast": (cantilever([0.2, 0.4, 0.6, 0.8, 1.0]), True),
    "uneven mast": (cantilever([0.25, 0.45, 0.6, 0.85, 1.0]), True),
    "beam": (supported(np.arange(1, 6) / 6), False),
}


@pytest.mark.parametrize("weight", [EVEN, HIGHER], ids=["even", "higher modes"])
@pytest.mark.parametrize("name", LINES)
def test_each_reversed_sensor_of_a_line_is_named_and_sound_ones_are_silent(name, weight):
    structure, upright = LINES[name]
    data = moved(structure, weight, 11)
    assert flipped(structure, upright, data) == []
    for k in range(data.shape[1]):
        turned = data * np.where(np.arange(data.shape[1]) == k, -1, 1)
        assert flipped(structure, upright, turned) == [f"A{k + 1}"]


@pytest.mark.parametrize("noise", [0.003, 0.3])
@pytest.mark.parametrize("weight", [(0, 1, 1, 1, 1), (0, 0, 1, 1, 1), (1, 0, 0, 0, 0)], ids=str)
@pytest.mark.parametrize("name", LINES)
def test_a_sound_line_is_silent_whatever_modes_it_shows(name, weight, noise):
    structure, upright = LINES[name]
    assert flipped(structure, upright, moved(structure, weight, 12, noise)) == []


@pytest.mark.parametrize("places", [(1 / 6, 2 / 6, 3 / 6, 4 / 6, 5 / 6, 1), (0.2, 0.4, 0.7, 1), (1 / 3, 2 / 3, 1)])
def test_the_lowest_sensor_of_a_chimney_is_named_where_it_is_reversed(places):
    structure = cantilever(places)
    data = moved(structure, EVEN, 11)
    assert flipped(structure, True, data) == []
    data[:, 0] *= -1
    assert flipped(structure, True, data) == ["A1"]


def test_a_first_mode_of_two_spans_is_no_reversed_sensor():
    """Over a support in the middle the lowest mode changes its sign; one sensor is beyond it."""
    places = np.array([0.1, 0.2, 0.3, 0.4, 0.6])
    structure = (np.array([1.0, 4.0]), np.array([np.sin(2 * np.pi * places), np.sin(4 * np.pi * places)]).T, places)
    assert flipped(structure, False, moved(structure, EVEN, 13)) == []


def test_a_filter_at_one_sensor_makes_no_other_sensor_reversed():
    """Its lead hides the signs of the lowest mode; those of the next change along the line as they should."""
    structure = (np.array([1.0, 3.6]), np.array([[0.3, -0.8], [0.6, -1.0], [1.0, 0.9]]), np.array([0.13, 0.53, 1.0]))
    data = moved(structure, EVEN, 16)
    b, a = signal.butter(1, 0.6, "high", fs=RATE)
    data[:, 1] = signal.lfilter(b, a, data[:, 1])
    assert flipped(structure, True, data) == []


def two_spans():
    """Two equal spans, sensors in both: the lowest mode goes up in one and down in the other."""
    x = np.array([0.1, 0.2, 0.3, 0.4, 0.6, 0.7, 0.8, 0.9])
    b, s = 3.926602, np.abs(2 * x - 1)
    ratio = (np.cosh(b) - np.cos(b)) / (np.sinh(b) - np.sin(b))
    second = np.cosh(b * s) - np.cos(b * s) - ratio * (np.sinh(b * s) - np.sin(b * s))
    shape = np.column_stack([np.sin(2 * np.pi * x), second, np.sin(4 * np.pi * x)])
    return np.array([1.0, (b / np.pi) ** 2, 4.0]), shape, [[40 * a, 0, 0] for a in x]


def floor():
    """A simply supported plate, four by three sensors."""
    at = np.array([(x, y) for y in (1.5, 3.5, 5.5) for x in (1.5, 3.5, 5.5, 7.5)])
    m, n = np.array([(1, 1), (2, 1), (1, 2), (2, 2)]).T
    value = (m / 9) ** 2 + (n / 7) ** 2
    return value / value[0], np.sin(np.pi * np.outer(at[:, 0], m) / 9) * np.sin(np.pi * np.outer(at[:, 1], n) / 7), [
        [x, y, 0] for x, y in at]


def girders():
    """A deck's bending and torsion, five sensors on each of two girders."""
    at = np.array([(x, y) for y in (-3.0, 3.0) for x in (6, 13, 20, 27, 34)])
    first, second = np.sin(np.pi * np.outer(at[:, 0], (1, 2)) / 40).T
    return np.array([1.0, 1.7, 4.0, 5.1]), np.column_stack(
        [first, first * at[:, 1] / 3, second, second * at[:, 1] / 3]), [[x, y, 0] for x, y in at]


@pytest.mark.parametrize("structure", [two_spans, floor, girders])
def test_reversed_sensors_of_spans_floors_and_girders(structure):
    """Nothing of a sound one; of each sensor reversed in turn it or nothing, and of most it."""
    ratio, shape, position = structure()
    data = moved((ratio, shape, None), EVEN, 15, first_hz=1.0)
    sensors = tuple(Sensor(channel=f"A{k}", level="", position_m=p, direction=[0, 0, 1])
                    for k, p in enumerate(position))

    def named(record):
        found = suspicions(cross_spectra(record, RATE, 0.4 * RATE), sensors)
        return [s.channels for s in found if s.kind == "flipped"]

    assert named(data) == []
    every = [named(data * np.where(np.arange(len(sensors)) == k, -1, 1)) for k in range(len(sensors))]
    assert all(found in ([], [(f"A{k}",)]) for k, found in enumerate(every))
    assert sum(map(len, every)) > 0.6 * len(every)


def test_check_says_which_of_five_is_reversed_and_what_to_do(campaign_folder):
    head = 'name = "Storeys"\nsampling_rate_hz = 20.0\nblock_minutes = 10\n' + "".join(
        f'[[sensor]]\nchannel = "F{k}"\nlevel = "F{k}"\nposition_m = [0.0, 0.0, {3.0 * k}]\n'
        f'direction = [1.0, 0.0, 0.0]\nquantity = "acceleration"\nunit = "m/s2"\n' for k in range(1, 6))
    data = moved(chain(), EVEN, 14, n=36000)
    data[:, 2] *= -1
    import h5py

    folder = campaign_folder([(0, data)], head=head)
    with h5py.File(folder / "acceleration" / "0.h5", "a") as file:
        file["data"].attrs["sampling_rate_hz"] = RATE
    found = [text for text in check(read_campaign(folder)).findings if "flipped" in text]
    assert len(found) == 1 and found[0].startswith("suspect: F3 looks flipped")
    assert "turn its direction in campaign.toml" in found[0] and "(in 3 of 3 blocks compared)" in found[0]


def test_a_reversed_sensor_of_a_building_measured_both_ways_at_one_corner():
    """Modes along x, along y and of torsion lie close together, and a corner sees torsion in both directions."""
    storeys = chain(4)
    u, v, turn = (moved(storeys, EVEN, seed, first_hz=hz) for seed, hz in ((3, 0.6), (4, 0.7), (5, 0.9)))
    data = np.hstack([u - 0.5 * turn, v + turn])
    sensors = tuple(Sensor(channel=f"{axis}{k + 1}", level=f"F{k + 1}", position_m=[8, 4, 15 * x], direction=direction)
                    for axis, direction in (("x", [1, 0, 0]), ("y", [0, 1, 0])) for k, x in enumerate(storeys[2]))

    def found(record):
        return [s.channels for s in suspicions(cross_spectra(record, RATE, 0.4 * RATE), sensors)]

    assert found(data) == []
    for k, sensor in enumerate(sensors):
        assert found(data * np.where(np.arange(8) == k, -1, 1)) == [(sensor.channel,)]
