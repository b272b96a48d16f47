"""Acceleration, velocity, displacement: against motions whose derivatives are written down."""

import numpy as np
import pandas as pd
import pytest

from probupdate.campaign.blocks import Block
from probupdate.campaign.quantity import Band, convert_quantity
from probupdate.errors import InputError
from probupdate.modal.modes import Sensor

RATE, N = 25.0, 45000
QUANTITY = ("displacement", "velocity", "acceleration")


def motion(rng, lowest=0.25, highest=4.0, count=60) -> dict[str, np.ndarray]:
    """(n_sample,) of each quantity: a sum of sines of random phase, with equal power in acceleration."""
    frequency, phase = rng.uniform(lowest, highest, count), rng.uniform(0, 2 * np.pi, count)
    angle = 2 * np.pi * frequency * np.arange(N)[:, None] / RATE + phase
    omega = 2 * np.pi * frequency
    return {"displacement": -np.cos(angle) @ omega**-2, "velocity": np.sin(angle) @ omega**-1,
            "acceleration": np.cos(angle).sum(axis=1)}


def sensors(*quantities: str) -> tuple[Sensor, ...]:
    unit = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s2"}
    return tuple(Sensor(channel=f"c{k}", level="a", position_m=[0, 0, k], direction=[1, 0, 0], quantity=q, unit=unit[q])
                 for k, q in enumerate(quantities))


def block_of(*columns) -> Block:
    data = np.column_stack(columns)
    return Block(start=pd.Timestamp("2019-06-03T10:00Z"), minutes=30.0, sampling_rate_hz=RATE, data=data,
                 missing=np.zeros(data.shape[1]), impossible=np.zeros(data.shape[1], int),
                 repeated=np.zeros(data.shape[1]), filled=np.zeros(data.shape[1]))


@pytest.mark.parametrize("wanted", QUANTITY)
def test_each_quantity_becomes_each_other_as_written_down(wanted, validation):
    row = validation(what="acceleration, velocity, displacement into one another", reference="sums of sines",
                     why="what lies beyond the ends is not known")
    true = motion(np.random.default_rng(5))
    found = convert_quantity(block_of(*(true[q] for q in QUANTITY)), sensors(*QUANTITY), wanted).data
    scale = np.std(true[wanted])
    # what lies beyond the ends is not known: its trace fades over the answer of the band's lower flank, which falls
    # with the third power of time: one minute is six periods of that limit
    error = np.abs(found - true[wanted][:, None]) / scale
    row.error(error[1500:-1500], below=0.01, of="one minute inside the ends")
    row.error(error[3000:-3000], below=0.0015, of="two minutes")


def test_a_slow_drift_and_an_offset_do_not_run_away_when_integrated():
    true = motion(np.random.default_rng(6))
    drifting = true["acceleration"] + 5.0 + np.linspace(0, 3, N)
    found = convert_quantity(block_of(drifting, true["displacement"]), sensors("acceleration", "displacement"),
                             "displacement").data
    inner = slice(1500, -1500)
    assert np.max(np.abs(found[inner, 0] - true["displacement"][inner])) < 0.05 * np.std(true["displacement"])


def test_nothing_is_done_where_nothing_is_to_be_done():
    block = block_of(np.arange(10.0), np.arange(10.0))
    assert convert_quantity(block, sensors("velocity", "velocity"), "velocity") is block


def test_all_channels_keep_the_same_band_and_the_note_says_so():
    rng = np.random.default_rng(7)
    slow = np.sin(2 * np.pi * 0.03 * np.arange(N) / RATE)
    fast = motion(rng)["acceleration"]
    block = convert_quantity(block_of(fast + slow, motion(rng)["velocity"]), sensors("acceleration", "velocity"),
                             "acceleration", band=Band(lowest_hz=0.2, highest_hz=8.0))
    assert np.std(block.data[1500:-1500, 0] - fast[1500:-1500]) < 2e-3 * np.std(fast)
    assert block.notes == ("c1 converted to acceleration; all channels cut to 0.2-8 Hz",)
    with pytest.raises(ValueError, match="read-only"):
        block.data[0] = 0


def test_a_channel_with_lost_samples_is_lost_and_the_others_are_not():
    true = motion(np.random.default_rng(8))
    holed = true["velocity"].copy()
    holed[20000:20100] = np.nan
    found = convert_quantity(block_of(true["acceleration"], holed), sensors("acceleration", "velocity"),
                             "acceleration").data
    assert np.isnan(found[:, 1]).all() and np.isfinite(found[:, 0]).all()


def test_mistakes_are_refused():
    true = motion(np.random.default_rng(9))
    block, two = block_of(true["velocity"], true["velocity"]), sensors("velocity", "velocity")
    with pytest.raises(InputError, match="'jerk' is unknown"):
        convert_quantity(block, two, "jerk")
    with pytest.raises(InputError, match="2 channels, 1 sensors"):
        convert_quantity(block, two[:1], "acceleration")
    for band in (Band(lowest_hz=0.0), Band(lowest_hz=3.0, highest_hz=2.0), Band(highest_hz=12.0)):
        with pytest.raises(InputError, match="is no band of a 25 Hz record"):
            convert_quantity(block, two, "acceleration", band=band)
    short = block_of(np.zeros(2000), np.zeros(2000))
    with pytest.raises(InputError, match=r"shorter than ten periods of 0\.1 Hz"):
        convert_quantity(short, two, "acceleration")
