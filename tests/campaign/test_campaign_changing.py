"""Records that change while they are used: what was scanned is what is read, or the file is named."""

import os
import time

import h5py
import numpy as np
import pytest
from peer_packages import peer

from probupdate.campaign.blocks import block_files, read_block
from probupdate.campaign.reading import read_campaign
from probupdate.errors import InputError

TWO_FILES = [(0, np.ones((6000, 2))), (3600, 2 * np.ones((6000, 2)))]


def test_a_file_that_another_hours_replaces_is_refused(campaign_folder):
    folder = campaign_folder(TWO_FILES)
    campaign = read_campaign(folder)
    starts = block_files(campaign)
    first = next(iter(starts))
    # as a sync does: a new file takes the name
    os.replace(folder / "acceleration/1.h5", folder / "acceleration/0.h5")
    with pytest.raises(InputError, match=r"0\.h5: changed while it was used"):
        read_block(campaign, first, starts[first])


@pytest.mark.parametrize("how", ["cut", "gone", "rewritten"])
def test_a_file_that_is_cut_moved_or_written_again_is_named(campaign_folder, how):
    folder = campaign_folder(TWO_FILES)
    campaign, path = read_campaign(folder), folder / "acceleration/0.h5"
    starts = block_files(campaign)
    first = next(iter(starts))
    assert len(read_block(campaign, first, starts[first]).data) == 6000
    if how == "cut":
        os.truncate(path, path.stat().st_size // 2)
    elif how == "gone":
        path.unlink()
    else:
        with h5py.File(path, "r+") as file:
            file["data"][:] = 3.0
        os.utime(path)
    with pytest.raises(InputError, match=r"0\.h5"):
        read_block(campaign, first, starts[first])


def test_a_folder_with_other_times_of_change_is_read_as_it_is(campaign_folder):
    folder = campaign_folder(TWO_FILES)
    os.utime(folder / "acceleration/0.h5", (1e9, 1e9))
    campaign = read_campaign(folder)
    assert all(len(read_block(campaign, s, files).data) == 6000 for s, files in block_files(campaign).items())


def _kept_times(path, now):
    os.utime(path, ns=(now.st_atime_ns, now.st_mtime_ns))


@pytest.mark.parametrize("ending", ["h5", "parquet"])
def test_a_file_of_the_same_size_and_time_is_known_by_its_start(campaign_folder, ending):
    folder = campaign_folder(TWO_FILES)
    one, other = (folder / f"acceleration/{k}.{ending}" for k in (0, 1))
    if ending == "parquet":
        pyarrow = peer("pyarrow")
        from pyarrow import parquet

        for k, hour in enumerate((10, 11)):
            table = pyarrow.table({c: np.full(6000, k + 1.0) for c in ("a-x", "a-y")})
            (folder / f"acceleration/{k}.h5").unlink()
            parquet.write_table(table.replace_schema_metadata(
                {"start": f"2019-06-03T{hour}:00Z", "sampling_rate_hz": "10.0"}), (one, other)[k])
    campaign, now = read_campaign(folder), one.stat()
    starts = block_files(campaign)
    first = next(iter(starts))
    os.replace(other, one)
    _kept_times(one, now)
    assert one.stat().st_size == now.st_size
    with pytest.raises(InputError, match=rf"0\.{ending}: changed while it was used"):
        read_block(campaign, first, starts[first])


@pytest.mark.parametrize("how", ["replaced", "gone", "head"])
def test_a_chunk_of_an_array_that_changes_is_named(campaign_folder, how):
    zarr = peer("zarr")
    folder = campaign_folder([])
    path = folder / "acceleration/a.zarr"
    path.parent.mkdir()
    array = zarr.create_array(path, shape=(12000, 2), dtype="float32", chunks=(6000, 2), fill_value=np.nan,
                              attributes={"start": "2019-06-03T10:00Z", "sampling_rate_hz": 10.0})
    array[:] = np.random.default_rng(1).standard_normal((12000, 2))
    campaign = read_campaign(folder)
    starts = block_files(campaign)
    first, second = starts
    chunk, now = path / "c/0/0", (path / "c/0/0").stat()
    # file systems count some milliseconds as one time
    time.sleep(0.05)
    if how == "replaced":
        os.replace(path / "c/1/0", chunk)
        _kept_times(chunk, now)
    elif how == "gone":
        chunk.unlink()
    else:
        head = path / "zarr.json"
        head.write_text(head.read_text().replace("T10:00Z", "T11:00Z"))
    with pytest.raises(InputError, match=r"a\.zarr: changed while it was used"):
        read_block(campaign, first, starts[first])
    if how == "gone":
        assert len(read_block(campaign, second, starts[second]).data) == 6000
