"""What is taken out of measured modes for a sensor's sake: its size, the scatter that goes with it, the volume that its
numbers take."""

import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from scipy import linalg

from probupdate.diagnosis.blocks import SetFactors, gather
from probupdate.diagnosis.empirical_reference import correct_blocks, mean_plane_axes
from probupdate.diagnosis.empirical_search import watch
from probupdate.diagnosis.evidence import size_by_secant
from probupdate.diagnosis.mode_numbers import numbers_of_modes
from probupdate.diagnosis.sensor_changes import log_stretch
from probupdate.effects.catalogue import measurement_effects
from probupdate.modal.modes import ModalData, ModalSet, Sensor

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "studies" / "other_worlds"))
from records import draw_record

CHANNELS = ("a", "b", "c", "d", "e", "f")


def effect_named(name, channels=CHANNELS):
    return next(e for e in measurement_effects(channels, ()) if e.name == name)


@pytest.mark.parametrize("gain", [-0.9, -0.6, -0.5, -0.2, 0.3, 2.0, 9.0])
def test_a_gain_is_found_whatever_its_size(gain, validation):
    """Of 1 + g (1 + g) / (1 + s) - 1 is left where 1 + s is taken out. Sizes that were added up swung about -1/2 and
    ran away beyond it."""
    row = validation(what="size of a gain from -0.9 to 9 that is taken out step by step", reference="the gain",
                     why="a tenth of its standard deviation", unit="std")
    std = 1e-3
    size, found = size_by_secant(effect_named("sensor gain, b"),
                                 lambda s: ((1 + gain) / (1 + s) - 1, std))
    row.error((size - gain) / (std * (1 + gain)), 0.1, "size", case=gain)
    # an error of what is left is one of the size by as much as the slope says
    row.error(np.log(found / (std * (1 + gain))), 0.1, "ln std", case=gain)


def test_what_grows_as_more_is_taken_out_ends_at_its_bound_or_settles():
    gain = effect_named("sensor gain, b")
    assert size_by_secant(gain, lambda s: (5.0, 1e-3))[0] == pytest.approx(gain.upper)
    assert size_by_secant(gain, lambda s: (0.0, np.inf)) == (0.0, np.inf)


@pytest.mark.parametrize("k", [1, 2])
@pytest.mark.parametrize("what", ["gain", "rotation", "exchange", "clock"])
def test_the_volume_of_the_numbers_is_that_of_finite_differences(k, what, validation):
    row = validation(what="ln of the volume of the numbers of shapes, seen through a gain, a rotation, an exchange, a "
                          "clock", reference="determinant of finite differences", why="half the digits")
    rng = np.random.default_rng([k, 5])
    n = len(CHANNELS)
    axes = rng.standard_normal((n, k))
    axes /= np.abs(axes).max(axis=0)
    seen = np.eye(n, dtype=complex)
    if what == "gain":
        seen[2, 2] = 0.4
    elif what == "rotation":
        seen[1:3, 1:3] = [[np.cos(0.6), -np.sin(0.6)], [np.sin(0.6), np.cos(0.6)]]
    elif what == "exchange":
        seen[[1, 4]] = seen[[4, 1]]
    else:
        seen[2, 2] = seen[3, 3] = np.exp(0.3j)
    outside = linalg.null_space(np.linalg.pinv(axes))
    m = (n - k) * k
    frequency = np.array([[1.0, 1.1]])[:, :k]

    def numbers(x):
        shape = axes + outside @ (x[:m] + 1j * x[m:]).reshape(n - k, k)
        y = numbers_of_modes(frequency, (seen @ shape)[None], axes, least=0.0)[0][0, 1 if k == 1 else 3:]
        real, imaginary = np.split(y, 2)
        z = outside.T @ (real + 1j * imaginary).reshape(k, n).T
        return np.concatenate([z.real.ravel(), z.imag.ravel()])

    h = 1e-6
    derivative = np.array([(numbers(h * e) - numbers(-h * e)) / (2 * h) for e in np.eye(2 * m)])
    row.error(log_stretch(seen, axes) - np.linalg.slogdet(derivative)[1], 1e-7, "ln", case=(k, what))


def test_stated_scatter_goes_with_the_sensor():
    """Factors of a covariance are seen through a sensor as shapes are: a gain halves both, an exchange exchanges
    both."""
    record = draw_record("swap", 19)
    blocks = gather(record.data)
    assert isinstance(blocks.factors[0], SetFactors)
    first, second = blocks.channels[:2]
    row = {c: k for k, c in enumerate(blocks.channels)}
    acting = np.ones(len(blocks))
    acting[0] = 0
    halved = correct_blocks(blocks, effect_named(f"sensor gain, {first}", blocks.channels), -0.5 * acting)
    exchanged = correct_blocks(blocks, effect_named(f"swapped channels, {first} and {second}", blocks.channels), acting)
    for b in (0, 3):
        factor = 2.0 if b else 1.0
        np.testing.assert_allclose(halved.factors[b].shape[row[first]], factor * blocks.factors[b].shape[row[first]])
        np.testing.assert_allclose(halved.factors[b].shape[row[second]], blocks.factors[b].shape[row[second]])
        other = second if b else first
        np.testing.assert_allclose(exchanged.factors[b].shape[row[first]], blocks.factors[b].shape[row[other]])


def test_blocks_of_a_mended_record_are_no_strays(validation):
    """With the pattern of the record as measured eleven of sixteen blocks stood apart once the exchange was undone."""
    row = validation(what="a record of sixteen equal sets, two channels exchanged and put right: blocks that weigh "
                          "less", reference="none")
    record = draw_record("swap", 19)
    blocks = gather(record.data)
    acting = (np.arange(len(blocks)) >= 4).astype(float)
    now = correct_blocks(blocks, effect_named("swapped channels, W6 and W9", blocks.channels), acting)
    seen = watch(now, (), (), np.zeros((len(blocks), 0)), ())
    row.equal(int(np.sum(np.any(seen.directions.weight < 0.5, axis=1))), 0, "blocks")


def late_rows(highest_hz):
    """Rows of the catalogue by cause, the last place of each."""
    sensors = [Sensor(channel=f"{place}-{axis}", level=place, position_m=(0.0, 0.0, z), direction=direction)
               for place, z in (("A", 0.0), ("B", 40.0))
               for axis, direction in (("x", (1.0, 0.0, 0.0)), ("y", (0.0, 1.0, 0.0)))]
    return {e.cause: e for e in measurement_effects([s.channel for s in sensors], sensors, highest_hz)}


@pytest.mark.parametrize("highest_hz", [0.1, 2.5, 40.0, 2e4])
@pytest.mark.parametrize("cause", ["clock offset", "low-pass filter"])
def test_what_is_late_turns_phases_in_proportion_at_any_frequency(cause, highest_hz):
    """The slope was taken over 0.1 ms, at 20 kHz two periods: a late clock of 3 microseconds was *unexplained*."""
    row, shape = late_rows(highest_hz)[cause], np.ones((4, 1), complex)
    before, after = (row.observe(shape, highest_hz, sign * row.step_of_size)[0] for sign in (-1, 1))
    slope = ((after - before) / (2 * row.step_of_size))[2:, 0]
    turn = 2e-3j * np.pi * highest_hz
    np.testing.assert_allclose(slope, turn if cause == "clock offset" else -turn, rtol=1e-4)


@pytest.mark.parametrize(("highest_hz", "late_ms"), [(2.5, 200.0), (40.0, 200.0), (0.1, 5000.0)])
def test_clocks_and_filters_are_looked_for_up_to_half_a_period(highest_hz, late_ms):
    """A bridge whose modes take ten seconds has loggers that are seconds late: *unexplained* with an end of 200 ms."""
    found = late_rows(highest_hz)
    clock, low_pass = found["clock offset"], found["low-pass filter"]
    assert (clock.lower, clock.upper, low_pass.lower, low_pass.upper) == (-late_ms, late_ms, 0.0, late_ms)
    assert clock.prior_scale == low_pass.prior_scale == 0.1 * late_ms


def test_axes_of_thousands_of_sets_need_little_memory():
    """Those of the larger part of the record, in which a channel is not reversed; a table of all pairs has 72 MB."""
    rng, n = np.random.default_rng(2), 3000
    shape = np.array([0.2, 0.5, 1.0]) + 0.01 * rng.standard_normal((n, 3))
    shape[: int(0.4 * n), 1] *= -1
    frequency = 1.0 + 1e-3 * rng.standard_normal(n)
    blocks = gather(ModalData(channels=("a", "b", "c"), sets=tuple(
        ModalSet(id=str(k), frequency_hz=f[None], shape=s[:, None], damping_ratio=np.array([0.01]),
                 frequency_std_hz=np.array([1e-3]), shape_std=np.full((3, 1), 0.01))
        for k, (f, s) in enumerate(zip(frequency, shape, strict=True)))))
    tracemalloc.start()
    axes = mean_plane_axes(blocks, 0, ())
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert axes[:, 0] / axes[2, 0] == pytest.approx([0.2, 0.5, 1.0], abs=0.01)
    assert most < 20e6
