"""Small campaigns written to disk, so that every reader is tested on files."""

from __future__ import annotations

import h5py
import numpy as np
import pandas as pd
import pytest

HEAD = """name = "Small"
sampling_rate_hz = 10.0
block_minutes = 10
[[sensor]]
channel = "a-x"
level = "a"
position_m = [0.0, 0.0, 10.0]
direction = [1.0, 0.0, 0.0]
quantity = "acceleration"
unit = "m/s2"
[[sensor]]
channel = "a-y"
level = "a"
position_m = [0.0, 0.0, 10.0]
direction = [0.0, 1.0, 0.0]
quantity = "acceleration"
unit = "g"
"""
RATE = 10.0
START = pd.Timestamp("2019-06-03T10:00Z")


def _write_file(folder, name: str, start, data, *, rate: float = RATE, attributes=None) -> None:
    (folder / "acceleration").mkdir(exist_ok=True, parents=True)
    with h5py.File(folder / "acceleration" / name, "w") as file:
        dataset = file.create_dataset("data", data=np.asarray(data, np.float32))
        dataset.attrs["start"] = pd.Timestamp(start).isoformat()
        dataset.attrs["sampling_rate_hz"] = rate
        for key, value in (attributes or {}).items():
            dataset.attrs[key] = value


@pytest.fixture
def campaign_folder(tmp_path):
    """campaign_folder(pieces, head=, scada=): pieces are (seconds after START, data); returns the folder."""

    def write(pieces, head: str = HEAD, scada: pd.DataFrame | None = None, names=None):
        (tmp_path / "campaign.toml").write_text(head)
        for k, (seconds, data) in enumerate(pieces):
            name = names[k] if names else f"{k}.h5"
            _write_file(tmp_path, name, START + pd.Timedelta(seconds=seconds), data)
        if scada is not None:
            scada.to_csv(tmp_path / "scada.csv", index=False)
        return tmp_path

    return write


@pytest.fixture
def signal():
    """signal(n): (n, 2) whose sample k holds k and -k, so that every sample knows its place."""
    return lambda n, first=0: np.column_stack([np.arange(first, first + n), -np.arange(first, first + n)]).astype(float)


@pytest.fixture
def write_file():
    return _write_file


@pytest.fixture
def head() -> str:
    return HEAD


@pytest.fixture
def job(tmp_path, head):
    """job(description, rate=) -> (folder of sources, campaign folder) with campaign.toml and convert.toml written."""
    raw, campaign = tmp_path / "raw", tmp_path / "campaign"
    raw.mkdir()
    campaign.mkdir()

    def describe(text: str, rate: float = RATE):
        (campaign / "campaign.toml").write_text(head.replace("10.0", f"{rate}", 1))
        (campaign / "convert.toml").write_text(text)
        return raw, campaign

    return describe
