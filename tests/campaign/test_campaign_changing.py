"""Records that change while they are used: what was scanned is what is read, or the file is named."""

import os

import h5py
import numpy as np
import pytest

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
