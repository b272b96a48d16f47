"""Records as Zarr arrays: the blocks of the same records as HDF5, only the chunks of a block read, mistakes named."""

import json
import shutil
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from probupdate.campaign import zarr_records
from probupdate.campaign.blocks import block_files, blocks
from probupdate.campaign.reading import read_campaign
from probupdate.errors import InputError
from probupdate.identification.block_store import sources

sys.path.append(str(Path(__file__).resolve().parents[1] / "readers"))
from reader_cases import campaign_files, same_blocks

zarr = pytest.importorskip("zarr", reason="the extra `zarr` is not installed")


def as_zarr(folder, *, n_row=700, attributes=None, dtype="float32", **more):
    """Every HDF5 record of a campaign as an array in chunks of some rows."""
    import h5py

    for path in sorted((folder / "acceleration").glob("*.h5")):
        with h5py.File(path) as file:
            data, start = file["data"][()], file["data"].attrs["start"]
        told = {"start": start, "sampling_rate_hz": 5.0} if attributes is None else attributes
        array = zarr.create_array(path.with_suffix(".zarr"), shape=data.shape, dtype=dtype, fill_value=np.nan,
                                  chunks=(n_row, data.shape[1]), attributes=told, **more)
        array[:] = data
        path.unlink()


@pytest.fixture
def folder(tmp_path):
    campaign_files(tmp_path)
    return tmp_path


def changed(path, **entries):
    head = json.loads((path / "zarr.json").read_text())
    (path / "zarr.json").write_text(json.dumps(head | entries))


def test_blocks_are_those_of_the_same_records_as_hdf5(folder):
    same_blocks(folder, partial(as_zarr, shards=(1400, 3)))


@pytest.mark.parametrize(("first", "last"), [(0, 3000), (650, 1450), (700, 1400), (2999, 3600), (3000, 3600)])
def test_rows_are_read_by_the_chunks_that_have_them(folder, first, last):
    whole = np.concatenate([b.data for b in blocks(read_campaign(folder))])[:3000]
    as_zarr(folder)
    path = folder / "acceleration" / "a.zarr"
    # what is not needed may be damaged
    for k in range(5):
        if not (700 * k < last and min(700 * (k + 1), 3000) > first):
            (path / "c" / str(k) / "0").write_bytes(b"no chunk")
    assert np.array_equal(zarr_records.zarr_rows(path, first, last)[1], whole[first:last])


def test_a_damaged_chunk_is_named(folder):
    as_zarr(folder)
    (folder / "acceleration" / "a.zarr" / "c" / "1" / "0").write_bytes(b"no chunk")
    with pytest.raises(InputError, match=r"a\.zarr: samples 0 to 3000 cannot be read"):
        list(blocks(read_campaign(folder)))


def test_a_chunk_that_is_not_there_is_lost_and_never_zero(folder):
    as_zarr(folder)
    path = folder / "acceleration" / "a.zarr"
    shutil.rmtree(path / "c" / "1")
    first = next(iter(blocks(read_campaign(folder))))
    assert np.isnan(first.data[700:1400]).all() and np.isfinite(first.data[:700]).all()
    changed(path, fill_value=0.0)
    with pytest.raises(InputError, match=r"a\.zarr: 1 of 5 chunks are not there and would be read as 0"):
        read_campaign(folder)


def test_blocks_of_which_no_chunk_is_there_are_not_read(folder):
    """Rows for a year are declared, of which the first chunks and one at the end are there."""
    as_zarr(folder)
    path, n_block = folder / "acceleration" / "a.zarr", len(list(blocks(read_campaign(folder))))
    changed(path, shape=[150_000_000, json.loads((path / "zarr.json").read_text())["shape"][1]])
    shutil.move(path / "c" / "4", path / "c" / "200000")
    assert len(block_files(read_campaign(folder))) <= n_block + 2


def test_a_copied_array_holds_the_same_record_and_a_changed_chunk_another(folder, tmp_path):
    as_zarr(folder)
    before = [sources((file,)) for file in read_campaign(folder).files]
    shutil.copytree(folder / "acceleration", tmp_path / "copy")
    shutil.rmtree(folder / "acceleration")
    shutil.copytree(tmp_path / "copy", folder / "acceleration")
    assert [sources((file,)) for file in read_campaign(folder).files] == before
    chunk = folder / "acceleration" / "a.zarr" / "c" / "2" / "0"
    chunk.write_bytes(chunk.read_bytes()[:-1] + b"x")
    after = [sources((file,)) for file in read_campaign(folder).files]
    assert after[0] != before[0] and after[1:] == before[1:]


@pytest.mark.parametrize(("attributes", "said"), [
    ({"start": "2020-01-01T00:00:00Z"}, "has no 'sampling_rate_hz' among its attributes"),
    ({"start": "never", "sampling_rate_hz": 5}, "'never' is not a time"),
    ({"start": "2020-01-01T00:00:00Z", "sampling_rate_hz": "fast"}, "'fast' is not a number"),
    ({"start": "2020-01-01T00:00:00Z", "sampling_rate_hz": 6}, "is sampled at 6 Hz, campaign.toml says 5 Hz"),
    ({"start": "2020-01-01T00:00:00Z", "sampling_rate_hz": 5, "channels": ["T-x", "T-z", "T-y"]},
     "column 2 is 'T-z', campaign.toml has 'T-y' there"),
])
def test_mistakes_are_named(folder, attributes, said):
    as_zarr(folder, attributes=attributes)
    with pytest.raises(InputError) as error:
        read_campaign(folder)
    assert said in str(error.value) and "a.zarr" in str(error.value)


def test_other_arrays_links_and_codecs_that_run_code_are_refused(folder, monkeypatch):
    as_zarr(folder)
    path = folder / "acceleration" / "a.zarr"
    kept = (path / "zarr.json").read_text()
    for entries, said in (({"zarr_format": 2}, "is not a Zarr array of format 3"),
                          ({"node_type": "group"}, "is not a Zarr array of format 3"),
                          ({"codecs": [{"name": "numcodecs.pickle"}]}, "is stored by numcodecs.pickle; use blosc, "),
                          ({"codecs": [{"name": "sharding_indexed", "configuration": {"codecs": ["own"]}}]},
                           "is stored by own; "),
                          ({"data_type": "bool", "fill_value": False}, "holds bool, not numbers"),
                          ({"shape": [3000, 4]}, r"is \(3000, 4\), campaign.toml lists 3 channels")):
        changed(path, **entries)
        with pytest.raises(InputError, match=said):
            read_campaign(folder)
        (path / "zarr.json").write_text(kept)
    with monkeypatch.context() as m:
        m.setattr(zarr_records, "LARGEST_CHUNK", 8 * 600 * 3)
        with pytest.raises(InputError, match=r"has chunks \(700, 3\), .* write smaller chunks"):
            read_campaign(folder)
    (path / "c" / "0" / "0").unlink()
    (path / "c" / "0" / "0").symlink_to("/dev/zero")
    with pytest.raises(InputError, match="is not a file of an array, but a link or a device"):
        read_campaign(folder)
    shutil.rmtree(path)
    path.write_bytes(b"")
    with pytest.raises(InputError, match=r"a\.zarr"):
        read_campaign(folder)


def test_without_the_package_its_name_and_the_way_round_are_said(folder, monkeypatch):
    as_zarr(folder)
    monkeypatch.setitem(sys.modules, "zarr", None)
    with pytest.raises(InputError,
                       match=r"needs the package zarr, .* pip install probupdate\[zarr\], or write .* HDF5"):
        read_campaign(folder)
