"""Records as Parquet: the blocks of the same records as HDF5, only the row groups of a block read, mistakes named."""

import sys
from pathlib import Path

import numpy as np
import pytest

from probupdate.campaign import parquet_records
from probupdate.campaign.blocks import blocks
from probupdate.campaign.reading import read_campaign
from probupdate.errors import InputError

sys.path.append(str(Path(__file__).resolve().parents[1] / "readers"))
from reader_cases import campaign_files, same_blocks

pyarrow = pytest.importorskip("pyarrow", reason="the extra `parquet` is not installed")


def as_parquet(folder, *, n_row=700, names=("T-z", "more", "T-x", "T-y"), meta=None, ending="parquet"):
    """Every HDF5 record of a campaign as a table with its columns in another order and one that nobody asks for."""
    import h5py
    from pyarrow import parquet

    for path in sorted((folder / "acceleration").glob("*.h5")):
        with h5py.File(path) as file:
            data, start = file["data"][()], file["data"].attrs["start"]
        columns = {"T-x": data[:, 0], "T-y": data[:, 1], "T-z": data[:, 2], "more": np.zeros(len(data))}
        table = pyarrow.table({name: columns[name] for name in names})
        table = table.replace_schema_metadata({"start": start, "sampling_rate_hz": "5.0"} if meta is None else meta)
        parquet.write_table(table, path.with_suffix(f".{ending}"), row_group_size=n_row)
        path.unlink()


@pytest.fixture
def folder(tmp_path):
    campaign_files(tmp_path)
    return tmp_path


def test_blocks_are_those_of_the_same_records_as_hdf5(folder):
    same_blocks(folder, as_parquet)


@pytest.mark.parametrize(("first", "last"), [(0, 3000), (650, 1450), (700, 1400), (2999, 3600), (3000, 3600)])
def test_rows_are_read_by_the_row_groups_that_have_them(folder, monkeypatch, first, last):
    from pyarrow import parquet

    whole = np.concatenate([b.data for b in blocks(read_campaign(folder))])[:3000]
    as_parquet(folder)
    asked = []
    real = parquet.ParquetFile.read_row_groups
    monkeypatch.setattr(parquet.ParquetFile, "read_row_groups",
                        lambda self, groups, **more: asked.extend(groups) or real(self, groups, **more))
    _, rows = parquet_records.parquet_rows(folder / "acceleration" / "a.parquet", ("T-x", "T-y", "T-z"), first, last)
    assert np.array_equal(rows, whole[first:last])
    assert asked == [k for k in range(5) if 700 * k < last and min(700 * (k + 1), 3000) > first]


def test_null_is_a_lost_sample(folder):
    from pyarrow import parquet

    as_parquet(folder)
    path = folder / "acceleration" / "a.parquet"
    table = parquet.read_table(path)
    values = table["T-x"].to_pylist()
    values[10] = None
    holed = table.set_column(table.column_names.index("T-x"), "T-x", pyarrow.array(values, pyarrow.float32()))
    parquet.write_table(holed, path)
    block = next(iter(blocks(read_campaign(folder))))
    assert np.isnan(block.data).sum(axis=0).tolist() == [1, 0, 0]


@pytest.mark.parametrize(("changed", "said"), [
    ({"names": ("T-x", "T-z")}, "has no column 'T-y'; give one per"),
    ({"meta": {"start": "2020-01-01T00:00:00Z"}}, "has no 'sampling_rate_hz' in its metadata"),
    ({"meta": {"start": "never", "sampling_rate_hz": "5"}}, "'never' is not a time"),
    ({"meta": {"start": "2020-01-01T00:00:00Z", "sampling_rate_hz": "fast"}}, "'fast' is not a number"),
    ({"meta": {"start": "2020-01-01T00:00:00Z", "sampling_rate_hz": "6"}},
     "is sampled at 6 Hz, campaign.toml says 5 Hz"),
])
def test_mistakes_are_named(folder, changed, said):
    as_parquet(folder, **changed)
    with pytest.raises(InputError) as error:
        read_campaign(folder)
    assert said in str(error.value) and "a.parquet" in str(error.value)


def test_row_groups_beyond_memory_and_other_files_are_refused(folder, monkeypatch):
    as_parquet(folder)
    monkeypatch.setattr(parquet_records, "LARGEST_GROUP", 8 * 600 * 3)
    with pytest.raises(InputError, match="row group 1 has 700 rows, .* write smaller groups"):
        read_campaign(folder)
    (folder / "acceleration" / "a.parquet").write_bytes(b"PAR1 no table")
    with pytest.raises(InputError, match=r"a\.parquet: cannot be read as Parquet"):
        read_campaign(folder)


def test_without_the_package_its_name_and_the_way_round_are_said(folder, monkeypatch):
    as_parquet(folder)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(InputError,
                       match=r"needs the package pyarrow, .* pip install probupdate\[parquet\], or write .* HDF5"):
        read_campaign(folder)
