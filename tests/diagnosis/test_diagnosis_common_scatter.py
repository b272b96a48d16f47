"""Without a model: frequencies that wander together, and sensors with a frequency response of their own; records drawn
here from plain numbers and closed forms of filters."""

import datetime

import numpy as np
import pytest

from probupdate.diagnosis.without_model import diagnose_without_model
from probupdate.modal.modes import ModalData, ModalSet, Sensor

FREQUENCY_HZ = np.array([15.57, 44.69, 70.70, 87.33, 104.2, 121.5, 139.8])
START = datetime.datetime(2024, 5, 1)


def wandering(seed, n=70, change_percent=(0.0, 0.0, 0.0, 0.0), at=40, lost=0.0):
    """n sets of as many frequencies as changes, with a common first-order autoregression of 0.17 %, 0.03 % of their
    own and a step; each is missing from a set by chance in a share of `lost`."""
    rng = np.random.default_rng(seed)
    common = np.zeros(n)
    for i in range(1, n):
        common[i] = 0.7 * common[i - 1] + 0.0012 * rng.standard_normal()
    step = 0.01 * np.outer(np.arange(n) >= at, change_percent)
    m = len(change_percent)
    frequency = FREQUENCY_HZ[:m] * (1 + common[:, None] + 3e-4 * rng.standard_normal((n, m)) + step)
    frequency[rng.random(frequency.shape) < lost] = np.nan
    nothing = {"damping_ratio": np.full(m, np.nan), "frequency_std_hz": np.full(m, np.nan), "shape": np.zeros((0, m)),
               "shape_std": np.zeros((0, m))}
    return ModalData(channels=(), sets=tuple(ModalSet(id=name_of(i), frequency_hz=f, **nothing)
                                             for i, f in enumerate(frequency)))


def name_of(number):
    return (START + datetime.timedelta(minutes=10 * number)).strftime("%Y-%m-%dT%H:%MZ")


@pytest.mark.parametrize("seed, change_percent, at, n", [
    (1, (-0.18, 0.23, 0.15, 0.03), 40, 70), (2, (-0.18, 0.23, 0.15, 0.03), 40, 70), (3, (0.0, 0.2, 0.0, 0.0), 25, 60)])
def test_a_step_below_the_common_scatter_is_found(seed, change_percent, at, n, validation):
    row = validation(what="without a model, steps of 0.2 % where all frequencies wander by 0.17 %: found at their time",
                     reference="what was hidden")
    found = diagnose_without_model(wandering(seed, n, change_percent, at))
    row.count(found.verdict == "unexplained" and [c["since"] for c in found.details["changes"]] == [name_of(at)], 1, 1,
              case=(found.verdict, found.details["changes"]))


@pytest.mark.parametrize("lost", [0.15, 0.28])
def test_a_step_is_found_where_sets_lack_modes(lost, validation):
    """Of seven modes with 28 % of each missing a set in ten has all; any two are together in half."""
    row = validation(what="without a model, steps of 0.2 % where seven modes wander together and are missing from 15 "
                          "or 28 % of the sets: found within a set",
                     reference="what was hidden")
    since = [diagnose_without_model(wandering(seed, 70, (0.0, 0.23, -0.2, 0.0, 0.0, 0.0, 0.0), 30, lost)).details[
        "changes"] for seed in range(50, 56)]
    found = [[c["since"] for c in one] in ([name_of(29)], [name_of(30)], [name_of(31)]) for one in since]
    row.count(sum(found), 6, 5, case=since)


@pytest.mark.parametrize("lost", [0.15, 0.28])
def test_missing_modes_are_no_change(lost):
    silent = [diagnose_without_model(wandering(seed, change_percent=(0.0,) * 7, lost=lost)).verdict == "none"
              for seed in range(120, 126)]
    assert sum(silent) >= 5


def test_the_change_of_a_ratio_is_stated_with_its_size(validation):
    found = diagnose_without_model(wandering(2, 70, (-0.18, 0.23, 0.15, 0.03)))
    ratio = max(found.details["changes"][0]["frequencies"], key=lambda m: abs(m["z"]))
    first, second = (int(word) - 1 for word in ratio["mode"].replace("mode ", "").split(" over "))
    expected = (-0.18, 0.23, 0.15, 0.03)[first] - (-0.18, 0.23, 0.15, 0.03)[second]
    validation(what="without a model, change of a ratio of two frequencies", reference="what was hidden",
               why="standard deviations", unit="").error(
        (ratio["change_percent"] - expected) / ratio["std_percent"], below=4.0)


def test_frequencies_that_wander_together_are_no_change(validation):
    """Twelve records at a level of 3 %: three alarms would come by chance in five of a thousand tries."""
    silent = [diagnose_without_model(wandering(seed)).verdict == "none" for seed in range(100, 112)]
    validation(what="without a model, frequencies that wander together, nothing hidden: silent", reference="none",
               why="a level of 3 %").count(sum(silent), 12, 10)


SHAPES = np.array([[1.0, 0.02, -0.6, 0.4], [0.02, 1.0, 0.05, 0.6], [0.6, 0.0, 1.0, 0.3], [0.02, 0.6, -0.05, -1.0],
                   [0.3, 0.01, 0.7, -0.3], [0.01, 0.3, -0.04, -0.8]])
LEVELS = {"TP": 15.0, "L2": 8.0, "L1": 2.0}


def filtered(seed, level, response):
    """Twelve sets of four modes at three levels, one of which, or one channel, shows what happens through a filter."""
    rng, hz = np.random.default_rng(seed), np.array([0.33, 0.36, 1.25, 2.2])
    sensors = tuple(Sensor(channel=f"{name}-{axis}", level=name, position_m=(0.0, 0.0, z), direction=direction,
                           quantity="acceleration")
                    for name, z in LEVELS.items() for axis, direction in (("x", (1.0, 0, 0)), ("y", (0, 1.0, 0))))
    rows = [k for k, s in enumerate(sensors) if level in (s.level, s.channel)]
    sets = []
    for i in range(12):
        f = hz * (1 + 1e-3 * rng.standard_normal(4))
        shape = SHAPES + 3e-3 * (rng.standard_normal((6, 4)) + 1j * rng.standard_normal((6, 4)))
        shape[rows] *= response(f)
        sets.append(ModalSet(id=name_of(i), frequency_hz=f, damping_ratio=np.full(4, 0.01), frequency_std_hz=1e-3 * hz,
                             shape=shape, shape_std=np.full((6, 4), 3e-3)))
    return ModalData(channels=tuple(s.channel for s in sensors), sets=tuple(sets)), sensors


@pytest.mark.parametrize("seed, level, response", [
    (4, "L2", lambda f: 1j * f / (0.3 + 1j * f)),                        # first-order high-pass at 0.3 Hz
    (5, "TP", lambda f: -(f**2) / (0.2**2 - f**2 + 2j * 0.7 * 0.2 * f)),  # seismometer of 0.2 Hz
    (6, "L2-y", lambda f: 1j * f / (0.5 + 1j * f)),
    (7, "L1-x", lambda f: 1j * f / (0.15 + 1j * f)),
])
def test_a_high_pass_at_one_level_or_channel_is_a_response_of_its_own(seed, level, response, validation):
    row = validation(what="without a model, a high-pass at one level or channel: a frequency response of its own, "
                          "there",
                     reference="what was hidden")
    found = diagnose_without_model(*filtered(seed, level, response))
    row.equal([(f.cause, f.location) for f in found.findings], [("frequency response of its own", level)])


def test_the_gain_of_one_channels_high_pass_is_stated(validation):
    """Of a whole level it is not known, as that may move as it likes; a channel has others beside it."""
    found = diagnose_without_model(*filtered(6, "L2-y", lambda f: 1j * f / (0.5 + 1j * f)))
    note = next(n for n in found.notes if n.startswith("L2-y shows the modes"))
    gain = float(note.split(" times")[0].split()[-1])
    validation(what="without a model, gain of one channel's high-pass at 0.345 Hz", reference="its transfer function",
               why="symmetry of a level to 5 %").error(gain - abs(0.345j / (0.5 + 0.345j)), below=0.08)


def test_phases_of_a_high_pass_are_those_of_its_transfer_function(validation):
    found = diagnose_without_model(*filtered(4, "L2", lambda f: 1j * f / (0.3 + 1j * f)))
    note = next(n for n in found.notes if n.startswith("L2 shows the modes"))
    leads = [float(part.split(" deg")[0].split()[-1]) for part in note.split(", ")]
    expected = np.degrees(np.arctan2(0.3, [0.345, 1.25, 2.2]))
    validation(what="without a model, leads of a high-pass at three frequencies", reference="its transfer function",
               why="three standard deviations of a prior of 0.1 rad and scatter", unit="deg").error(
        np.array(leads) - expected, below=4.0)
