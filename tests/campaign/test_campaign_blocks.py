"""Blocks: every sample in its place whatever the files, gaps left open and named, memory of one block."""

import tracemalloc

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from probupdate.campaign.blocks import CONTRADICTION, OVERLAP, block_starts, blocks
from probupdate.campaign.reading import read_campaign
from probupdate.errors import InputError

G = 9.80665


def read(folder):
    return list(blocks(read_campaign(folder)))


def test_blocks_follow_the_clock_and_not_the_first_sample(campaign_folder, signal):
    found = read(campaign_folder([(120, signal(21000))]))
    assert [b.id for b in found] == [f"2019-06-03T10:{m}0Z" for m in range(4)]
    assert found[0].data.shape == (6000, 2)
    assert np.isnan(found[0].data[:1200]).all()
    assert found[0].data[1200, 0] == 0 and found[1].data[0, 0] == 4800
    # nothing was lost there: the recording began two minutes later
    assert found[0].excluded == "part of a recording: 8 min in it"
    assert found[0].missing == pytest.approx([0.2, 0.2])


def test_recordings_as_long_as_a_block_are_blocks_wherever_they_begin(campaign_folder, signal):
    """Loggers that are started by hand, or every three hours at seven past; the last one lost its last sample."""
    files = [(427.3, signal(6000, 1)), (11227.34, signal(6000, 20001)), (22000, signal(5999, 40001))]
    found = read(campaign_folder(files))
    assert [b.id for b in found] == ["2019-06-03T10:07:07Z", "2019-06-03T13:07:07Z", "2019-06-03T16:06:40Z"]
    assert not any(b.excluded for b in found)
    assert [b.data[0, 0] for b in found] == [1, 20001, 40001] and found[1].data[-1, 0] == 26000


@given(start=st.integers(0, 12000), n=st.integers(1, 26000))
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_more_than_half_of_what_a_recording_holds_is_used(tmp_path_factory, write_file, head, signal, start, n):
    """Of blocks of 6000 samples; every sample is in one block, in its place."""
    folder = tmp_path_factory.mktemp("one")
    (folder / "campaign.toml").write_text(head)
    write_file(folder, "one.h5", pd.Timestamp("2019-06-03T10:00Z") + pd.Timedelta(seconds=start / 10), signal(n, 7))
    found = read(folder)
    whole, held = sum(not b.excluded for b in found), n // 6000
    assert 2 * whole > held or held == whole == 0
    values = np.concatenate([b.data[:, 0] for b in found])
    assert set(range(7, 7 + n)) <= set(values[np.isfinite(values)])
    starts = [b.start for b in found]
    assert all(b - a >= pd.Timedelta(minutes=10) for a, b in zip(starts[:-1], starts[1:], strict=True))


def test_units_become_si(campaign_folder, signal):
    (block,) = read(campaign_folder([(0, signal(6000))]))
    assert block.data[:, 1] == pytest.approx(-G * np.arange(6000), rel=1e-6)
    assert block.excluded == "" and block.notes == ()


@given(cuts=st.lists(st.integers(1, 17999), unique=True, max_size=6), shuffle=st.randoms())
@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_cutting_and_naming_the_files_changes_nothing(tmp_path_factory, write_file, head, signal, cuts, shuffle):
    folder = tmp_path_factory.mktemp("cut")
    (folder / "campaign.toml").write_text(head)
    edges = [0, *sorted(cuts), 18000]
    names = [f"{k}.h5" for k in range(len(edges) - 1)]
    shuffle.shuffle(names)
    for name, a, b in zip(names, edges[:-1], edges[1:], strict=True):
        write_file(folder, name, pd.Timestamp("2019-06-03T10:00Z") + pd.Timedelta(seconds=a / 10), signal(b - a, a))
    found = read(folder)
    assert len(found) == 3
    assert np.concatenate([b.data[:, 0] for b in found]) == pytest.approx(np.arange(18000))


@pytest.mark.parametrize(("more", "note"), [(0.0, OVERLAP), (1e6, CONTRADICTION)])
def test_where_files_overlap_the_first_holds_and_it_is_said(campaign_folder, signal, more, note):
    (block,) = read(campaign_folder([(0, signal(4000)), (300, signal(3000, 3000) + more)]))
    assert block.data[3999, 0] == 3999 and block.data[4000, 0] == more + 4000
    assert block.notes == (note,)


def test_a_gap_stays_open_however_short_and_is_said(campaign_folder, signal):
    data = signal(6000)
    data[100:110, 0] = np.nan
    data[-300:, 1] = np.nan
    (block,) = read(campaign_folder([(0, data)]))
    assert block.excluded == "" and np.isnan(block.data).sum(axis=0).tolist() == [10, 300]
    assert block.missing == pytest.approx([10 / 6000, 300 / 6000])
    assert block.notes == ("samples lost: a-x 0.17 %, a-y 5 %",)


def test_a_channel_hardly_measured_excludes_the_block_by_name(campaign_folder, signal):
    data = signal(6000)
    data[500:5400, 1] = np.nan
    (block,) = read(campaign_folder([(0, data)]))
    assert block.excluded == "gaps: only 18 % of the samples were measured in a-y"


def test_blocks_without_any_file_are_not_made_up(campaign_folder, signal):
    campaign = read_campaign(campaign_folder([(0, signal(6000)), (86400, signal(6000))]))
    assert len(block_starts(campaign)) == 2 == len(list(blocks(campaign)))


def test_a_file_half_a_sample_off_the_grid_goes_to_the_nearest_sample(campaign_folder, signal):
    (block,) = read(campaign_folder([(0.04, signal(6000))]))
    assert block.data[0, 0] == 0 and block.excluded == ""


def test_another_length_of_block(campaign_folder, signal):
    campaign = read_campaign(campaign_folder([(0, signal(12000))]))
    assert [len(b.data) for b in blocks(campaign, minutes=5)] == [3000] * 4
    with pytest.raises(InputError, match="0 minutes at 10 Hz are fewer than 100 samples"):
        next(blocks(campaign, minutes=0))


def test_memory_does_not_grow_with_the_number_of_blocks(campaign_folder, signal):
    campaign = read_campaign(campaign_folder([(0, signal(40 * 6000))]))
    tracemalloc.start()
    for block in blocks(campaign):
        size = block.data.nbytes
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # a handful of copies of one block; all forty together would be 40
    assert peak < 12 * size


def test_data_of_a_block_cannot_be_changed(campaign_folder, signal):
    (block,) = read(campaign_folder([(0, signal(6000))]))
    with pytest.raises(ValueError, match="read-only"):
        block.data[0, 0] = 1


@pytest.mark.parametrize("seconds", [0.2, 2.0])
def test_a_laboratorys_plateau_of_seconds_is_a_block(campaign_folder, write_file, head, seconds):
    """Files of one block each at 1 kHz; two blocks of one second have ids of their own."""
    text = head.replace("sampling_rate_hz = 10.0", "sampling_rate_hz = 1000.0").replace(
        "block_minutes = 10", f"block_minutes = {seconds / 60}")
    folder = campaign_folder([], head=text)
    for k in range(3):
        write_file(folder, f"{k}.h5", pd.Timestamp("2019-06-03T10:00Z") + pd.Timedelta(seconds=10 * k),
                   np.ones((round(1000 * seconds), 2)), rate=1000.0)
    found = list(blocks(read_campaign(folder)))
    assert [len(b.data) for b in found] == [round(1000 * seconds)] * 3
    assert len({b.id for b in found}) == 3
