"""A temperature that nobody recorded is normal; one that was recorded is tested."""

from dataclasses import replace

import numpy as np
import pytest

from probupdate.diagnosis.diagnose import examine
from probupdate.diagnosis.fitting import fit
from probupdate.diagnosis.prepare import prepare
from probupdate.diagnosis.problem import TEMPERATURE, diagnosis_problem
from probupdate.diagnosis.time_profiles import DAY_STD, weather_profiles
from probupdate.modal.modes import Sensor
from tests.diagnosis.conftest import CHANNELS

PER_DEGC = -8e-4


@pytest.fixture(scope="module")
def prepared(frame_file):
    return prepare(frame_file)


def temperature(rng, n, every_h):
    """(n,) degC: a day's wave of 3 to 8 and what wanders from day to day."""
    hours = every_h * np.arange(n)
    slow = np.cumsum(rng.standard_normal(n)) * np.sqrt(every_h / 24)
    return 8 + rng.uniform(3, 8) * np.sin(2 * np.pi * hours / 24 + rng.uniform(0, 6)) + slow


def warmed(data, value, told, every_h=6.0):
    """The record with its stiffness PER_DEGC of itself less per degree; ids as many hours apart."""
    factor = np.sqrt(1 + PER_DEGC * (value - value.mean()))
    start = np.datetime64("2020-01-01T00:00:00")
    return replace(data, sets=tuple(
        replace(s, id=str(start + np.timedelta64(round(60 * every_h * k), "m")), frequency_hz=s.frequency_hz * f,
                environment=dict(s.environment) | ({TEMPERATURE: float(t)} if told else {}))
        for k, (s, f, t) in enumerate(zip(data.sets, factor, value, strict=True))))


@pytest.mark.parametrize("every_h", [0.5, 6.0])
def test_an_unrecorded_temperature_is_normal_and_a_recorded_one_is_named(prepared, record, every_h, validation):
    row = validation(what="frames whose stiffness falls by 0.08 % per degC, over a day and over ten: silent where the "
                          "sets do not state the temperature, named where they do; slope in its standard deviations",
                     reference="what was drawn")
    silent, named = 0, 0
    for seed in range(11, 16):
        value = temperature(np.random.default_rng(seed), 40, every_h)
        untold = examine(prepared, warmed(record(seed), value, False, every_h), seed=seed).diagnosis
        silent += untold.verdict == "none"
        assert any(f"too few sets state {TEMPERATURE}" in note for note in untold.notes)
        told = examine(prepared, warmed(record(seed), value, True, every_h), seed=seed).diagnosis
        first = told.findings[0]
        named += told.verdict == "named" and (first.cause, first.time_profile) == ("stiffness with temperature",
                                                                                  TEMPERATURE)
        row.error((first.size - PER_DEGC) / first.size_std, 3, "slope")
        assert not any("sets state" in note for note in told.notes)
    row.count(silent, 5, 5, "silent")
    row.count(named, 5, 5, "named")


@pytest.mark.parametrize("every_h", [3.0, 5.0])
def test_a_strong_day_of_a_temperature_that_is_not_recorded_is_named(prepared, record, every_h):
    """1.6 % of the stiffness either way, four times what weather usually does; a day alone shows no rhythm."""
    hours = every_h * np.arange(40)
    value = 20 * np.sin(2 * np.pi * hours / 24 + 1.0)
    found = examine(prepared, warmed(record(4), value, False, every_h)).diagnosis
    (first,) = found.findings
    assert (found.verdict, first.cause, first.time_profile) == ("named", "stiffness with temperature", "time_of_day")
    assert abs(first.size - 20 * abs(PER_DEGC)) < 3 * first.size_std < 2e-3
    assert found.p_value < 0.01 and "with the time of day (amplitude)" in found.summary


def stepped_at_once(data, share):
    """All frequencies higher by a share from the middle of one day on, which does not state the temperature."""
    data = warmed(data, np.zeros(len(data.sets)), False, every_h=0.5)
    return replace(data, sets=tuple(replace(s, frequency_hz=s.frequency_hz * (1 + share * (k >= 22)))
                                    for k, s in enumerate(data.sets)))


def test_a_logger_s_rate_that_steps_is_no_weather(frame_file, record, validation):
    row = validation(what="frame, a sampling rate that steps by 2 % in a day whose temperature is not stated: verdict, "
                          "cause, time profile; size in its standard deviations", reference="what was hidden")
    sensors = [Sensor(channel=c, position_m=np.array([0.0, 0.0, 3.0 * int(c[1])]), level=c[1],
                      direction=np.eye(3)["xy".index(c[0])]) for c in CHANNELS]
    found = examine(prepare(frame_file, sensors=sensors), stepped_at_once(record(11), 0.02)).diagnosis
    first = found.findings[0]
    row.equal((found.verdict, first.cause, first.time_profile), ("named", "sampling rate", "step"), "name")
    row.error((abs(first.size) - 0.02) / first.size_std, 3, "size")


def test_what_no_weather_does_and_no_row_describes_does_not_pass_for_normal(prepared, record):
    """Without places of sensors the catalogue has no sampling rate."""
    assert examine(prepared, stepped_at_once(record(11), 0.02)).diagnosis.verdict == "unexplained"
    # a day's wave of 2 % would be 40 degC up and down
    data = warmed(record(11), np.zeros(40), False, every_h=0.5)
    wave = 1 + 0.02 * np.sin(2 * np.pi * np.arange(40) / 48)
    found = examine(prepared, replace(data, sets=tuple(
        replace(s, frequency_hz=s.frequency_hz * w) for s, w in zip(data.sets, wave, strict=True)))).diagnosis
    assert found.verdict == "unexplained" and any("(standard deviation) does not" in note for note in found.notes)


def test_what_is_not_recorded_is_one_unknown_for_each_wave(prepared, record):
    data = warmed(record(3), np.zeros(40), False)
    problem, theta = diagnosis_problem(prepared, data)
    waves = weather_profiles(problem.blocks.hours)
    assert len(problem.unrecorded) == len(waves) and {p.kind for _, p, _ in problem.unrecorded} == {"wave"}
    (number,) = {j for j, _, _ in problem.unrecorded}
    warm = problem.effects[number]
    assert warm.time_profiles == (TEMPERATURE,) and number not in problem.which[:, 0]
    assert max(std for _, _, std in problem.unrecorded) == pytest.approx(DAY_STD * warm.prior_scale)
    design = fit(problem, theta).design
    assert design.n_scatter == len(waves) and design.sizes.start == design.sizes.stop
    # a part of the record has its part of the same waves
    part = problem.select_blocks(np.arange(10, 20))
    for (_, whole, _), (_, own, _) in zip(problem.unrecorded, part.unrecorded, strict=True):
        np.testing.assert_array_equal(own.value, whole.value[10:20])


def test_waves_are_slow_of_mean_zero_and_those_that_can_be_seen():
    for hours in (np.arange(48) / 2, np.arange(1440) / 2, 6.0 * np.arange(40)):
        waves = weather_profiles(hours)
        assert all(abs(p.value.mean()) < 1e-12 and np.ptp(p.value) > 1e-6 and std > 0 for p, std in waves)
        assert len(waves) <= 10
    # of sets at noon alone nothing follows a day; two sets may differ by a day's weather
    assert [np.ptp(p.value).round(6) for p, _ in weather_profiles(np.array([12.0, 36.0]))] == [2.0]
    assert weather_profiles(np.zeros(1)) == []
