"""What a file declares is bounded before a parser or an allocation sees it."""

import json
import time

import h5py
import numpy as np
import pytest
from peer_packages import peer

from probupdate.campaign.reading import read_campaign
from probupdate.errors import InputError
from probupdate.io.files import read_json, read_toml

DEEP = (
    "a" + ".a" * 100_000 + " = 1\n", "[" + "a." * 5000 + "a]\n", "x = {" + "a." * 90 + "a = 1}\n",
    '"a b"' + ' . "c"' * 80 + " = 1\n", "x = " + "[" * 100_000 + "\n",
)


@pytest.mark.parametrize("text", DEEP, ids=["dotted", "table", "inline", "quoted", "brackets"])
def test_a_deep_toml_file_is_refused_before_it_is_parsed(tmp_path, text):
    path = tmp_path / "deep.toml"
    path.write_text(text)
    begun = time.process_time()
    with pytest.raises(InputError, match=r"deep\.toml: not TOML \(nested deeper than 64 levels\)"):
        read_toml(path)
    assert time.process_time() - begun < 2.0


def test_points_in_texts_comments_and_numbers_are_no_depth(tmp_path):
    path = tmp_path / "wide.toml"
    lines = ('d = "' + "." * 300 + '"', 'e = """' + r"a.b\"" * 200 + '"""', "f = '''" + "a.\n" * 200 + "'''",
             "q = [" + ", ".join(["1.5"] * 300) + "]", "# " + "." * 100, "x.y.z = 1.0")
    path.write_text("\n".join(lines) + "\n")
    assert len(read_toml(path)["q"]) == 300


HEAD = """name = "x"
sampling_rate_hz = 10.0
block_minutes = 1
[[sensor]]
channel = "a"
level = "a"
position_m = [0.0, 0.0, 1.0]
direction = [1.0, 0.0, 0.0]
"""


@pytest.mark.parametrize("rows", [2**60, 2**44, -1, 1.5, "many"])
def test_an_array_that_declares_absurd_rows_is_named(tmp_path, rows):
    zarr = peer("zarr")
    (tmp_path / "campaign.toml").write_text(HEAD)
    path = tmp_path / "acceleration/a.zarr"
    path.parent.mkdir()
    array = zarr.create_array(path, shape=(600, 1), dtype="float32", chunks=(600, 1), fill_value=np.nan,
                              attributes={"start": "2024-01-01T00:00Z", "sampling_rate_hz": 10.0})
    array[:] = np.zeros((600, 1), np.float32)
    head = json.loads((path / "zarr.json").read_text())
    (path / "zarr.json").write_text(json.dumps(head | {"shape": [rows, 1]}))
    with pytest.raises(InputError, match=r"a\.zarr"):
        read_campaign(tmp_path)


def test_an_hdf5_file_that_declares_a_century_is_named(tmp_path):
    (tmp_path / "campaign.toml").write_text(HEAD)
    (tmp_path / "acceleration").mkdir()
    with h5py.File(tmp_path / "acceleration/a.h5", "w") as file:
        data = file.create_dataset("data", shape=(2**44, 1), dtype="f4", chunks=(2**16, 1))
        data.attrs.update(start="2024-01-01T00:00Z", sampling_rate_hz=10.0)
    with pytest.raises(InputError, match=r"a\.h5"):
        read_campaign(tmp_path)


@pytest.mark.parametrize(("head", "word"), [(b"\x89HDF\r\n\x1a\n", "posterior.nc"), (b"PK\x03\x04\xff", "ZIP"),
                                            (b"\x1f\x8b\x08\xff", "gzip")])
@pytest.mark.parametrize(("read", "kind"), [(read_json, "JSON"), (read_toml, "TOML")])
def test_a_binary_file_in_place_of_text_is_named(head: bytes, word: str, read, kind: str, tmp_path):
    path = tmp_path / "update.json"
    path.write_bytes(head + bytes(range(128, 256)))
    with pytest.raises(InputError) as error:
        read(path)
    assert word in error.value.problem and kind in error.value.problem
