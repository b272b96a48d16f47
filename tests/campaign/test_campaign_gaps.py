"""Samples in a file that nobody measured: repeats, lines drawn over gaps; what a converter does itself is neither."""

import json

import h5py
import numpy as np
import pytest

from probupdate.campaign.blocks import blocks
from probupdate.campaign.checking import check
from probupdate.campaign.gaps import find_filled, find_repeated, markers, with_markers, zero_filled
from probupdate.campaign.reading import read_campaign

RATE = 20.0


def vibration(n=12000, seed=0):
    t, rng = np.arange(n) / RATE, np.random.default_rng(seed)
    return np.sin(2 * np.pi * 0.9 * t) + 0.3 * np.sin(2 * np.pi * 2.7 * t + 1) + 0.05 * rng.standard_normal(n)


def of_four_bytes(column):
    return column.astype("f4").astype(float)


@pytest.mark.parametrize("ratio", [2, 3, 1.6])
def test_a_slower_converter_repeats_and_first_values_count(ratio):
    own = np.floor(np.arange(12000) / ratio)
    first = np.concatenate([[True], np.diff(own) > 0])
    column = of_four_bytes(vibration()[np.maximum.accumulate(np.where(first, np.arange(12000), 0))])
    found = find_repeated(column, RATE)
    # but for the record's two extremes
    assert np.count_nonzero(found != ~first) <= 4


def test_a_radio_that_sends_the_last_value_again_is_found():
    again = np.random.default_rng(1).random(12000) < 0.03
    again[0] = False
    column = of_four_bytes(vibration()[np.maximum.accumulate(np.where(again, 0, np.arange(12000)))])
    assert np.count_nonzero(find_repeated(column, RATE) != again) <= 4


def test_lines_drawn_over_gaps_are_found():
    lost = np.random.default_rng(1).random(12000) < 0.1
    lost[[0, -1]] = False
    column = vibration()
    column[lost] = np.interp(np.flatnonzero(lost), np.flatnonzero(~lost), column[~lost])
    found = find_filled(of_four_bytes(column))
    assert np.count_nonzero(found != lost) <= 0.001 * len(lost)


@pytest.mark.parametrize("step", [1e-3, 0.02, 0.1, 0.5, 1.0])
def test_a_coarse_converter_measures_all_its_samples(step):
    column = np.round(vibration() / step) * step
    assert not find_repeated(column, RATE).any() and not find_filled(column).any()


def test_clipped_or_still_samples_are_no_repeats():
    clipped = np.clip(vibration(), -0.8, 0.8)
    still = of_four_bytes(vibration())
    still[3000:3100] = still[3000]
    assert not find_repeated(clipped, RATE).any() and not find_repeated(still, RATE).any()


def test_cross_spectra_with_lost_samples_are_right_on_average():
    rng = np.random.default_rng(4)
    one = rng.standard_normal(200000)
    two = 0.7 * one
    two[rng.random(len(one)) < 0.3] = np.nan
    piece = zero_filled(np.column_stack([one, two]))
    assert piece[:, 0] @ piece[:, 1] / (one @ one) == pytest.approx(0.7, abs=0.01)


def three_channels(tmp_path, change):
    data = np.column_stack([vibration(36000, k) + vibration(36000, 9) for k in range(3)])
    change(data)
    lines = ['name = "held"', f"sampling_rate_hz = {RATE}", "block_minutes = 10"]
    for k in range(3):
        lines += ["[[sensor]]", f'channel = "F{k}"', f'level = "F{k}"', f"position_m = [0.0, 0.0, {3.0 * k}]",
                  "direction = [1.0, 0.0, 0.0]", 'quantity = "acceleration"', 'unit = "m/s2"']
    (tmp_path / "campaign.toml").write_text("\n".join(lines))
    (tmp_path / "acceleration").mkdir()
    with h5py.File(tmp_path / "acceleration/a.h5", "w") as file:
        stored = file.create_dataset("data", data=(0.01 * data).astype("f4"))
        stored.attrs.update(start="2024-05-01T00:00:00Z", sampling_rate_hz=RATE,
                            channels=json.dumps(["F0", "F1", "F2"]))
    return read_campaign(tmp_path)


def test_a_held_channel_is_named_and_no_clock_is_blamed(tmp_path):
    def held(data):
        data[:, 1] = np.repeat(data[::2, 1], 2)

    campaign = three_channels(tmp_path, held)
    text = "\n".join(check(campaign).findings)
    assert "F1 repeats: 50 % of its samples equal the one before (each value stands 2 times" in text
    assert "clock" not in text
    first = next(blocks(campaign))
    assert first.repeated == pytest.approx([0, 0.5, 0], abs=1e-3) and np.isnan(first.data[1::2, 1]).mean() > 0.999


@pytest.mark.parametrize(("value", "share"), [(0.0, 0.1), (0.0, 0.04), (-9999.0, 0.3), (-9999.0, 0.001), (3.0, 0.05),
                                              (32767.0, 0.01)])
@pytest.mark.parametrize("in_runs", [False, True])
def test_a_number_that_stands_for_lost_samples_is_found(value, share, in_runs):
    rng = np.random.default_rng(2)
    lost = rng.random(12000) < share
    if in_runs:
        lost = np.repeat(rng.random(600) < max(share, 0.01), 20)
    column = np.where(lost, value, vibration())
    column = of_four_bytes(column)
    assert markers(column) == [value] and with_markers(np.column_stack([vibration(), column])).tolist() == [1]


@pytest.mark.parametrize("of", [
    vibration(), np.round(vibration() / 0.02) * 0.02, np.round(vibration()), np.clip(vibration(), -0.8, 0.8),
    np.zeros(12000), np.where(np.arange(12000) % 3000 < 40, 60.0, 1.0) * vibration(),
    np.round(np.where(np.arange(12000) < 9000, 0.02, 1.0) * vibration() / 0.1) * 0.1,
    np.clip(np.exp(-np.arange(12000) % 4000 / 40) * 500 * vibration(), -200, 200),
    np.sin(np.arange(12000) * np.pi / 10),
    np.repeat(vibration()[::2], 2),
], ids=["vibration", "converter", "few levels", "clipped", "dead", "bursts", "quiet beside coarse", "clipped impacts",
        "sine", "held"])
def test_what_a_sensor_measured_is_no_number_for_lost_samples(of):
    assert markers(of) == [] and markers(of_four_bytes(of)) == []


@pytest.mark.parametrize("value", [0.0, -9999.0])
def test_a_number_for_lost_samples_is_lost_and_said(tmp_path, value):
    def marked(data):
        data[np.random.default_rng(4).random(len(data)) < 0.1, 2] = 100 * value

    campaign = three_channels(tmp_path, marked)
    first = next(blocks(campaign))
    assert first.missing == pytest.approx([0, 0, 0.1], abs=0.01) and first.impossible[2] == np.isnan(first.data).sum()
    assert f"of F2 at {value:.6g}, a number for lost ones: counted as lost" in first.notes[0]
    text = "\n".join(check(campaign).findings)
    assert "F2 lacks 10" in text or "F2 lacks 9." in text
    assert f"at {value:.6g} (SI), far more often than beside it" in text and f"lost = [{value:.6g}]" in text
    assert "spike" not in text and "dead" not in text
