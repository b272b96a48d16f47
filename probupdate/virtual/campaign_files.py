"""Writes a virtual campaign: campaign.toml, scada.csv, acceleration/*.h5 and the truth."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from probupdate.io.files import write_text
from probupdate.io.hdf5_file import new_hdf5
from probupdate.modal.modes import Sensor


def toml_value(value) -> str:
    """TOML text of a number, string, bool, list or inline table; JSON's strings are TOML's."""
    if isinstance(value, (bool, np.bool_)):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value)
    if isinstance(value, (int, np.integer)):
        return str(int(value))
    if isinstance(value, (float, np.floating)):
        # repr is exact; TOML wants a digit on both sides of an exponent's mantissa point, which repr gives or omits
        return repr(float(value))
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{json.dumps(k)} = {toml_value(v)}" for k, v in value.items()) + " }"
    return "[" + ", ".join(toml_value(v) for v in value) + "]"


def toml_text(content: Mapping) -> str:
    """A document of plain keys, then [tables], then [[arrays of tables]]; one level deep, inline below that."""
    plain, tables, arrays = [], [], []
    for key, value in content.items():
        if isinstance(value, Mapping):
            tables += [f"\n[{key}]", *(f"{k} = {toml_value(v)}" for k, v in value.items())]
        elif isinstance(value, (list, tuple)) and value and all(isinstance(v, Mapping) for v in value):
            for entry in value:
                arrays += [f"\n[[{key}]]", *(f"{k} = {toml_value(v)}" for k, v in entry.items())]
        else:
            plain.append(f"{key} = {toml_value(value)}")
    return "\n".join([*plain, *tables, *arrays]) + "\n"


def write_campaign_toml(
    folder: Path, *, name: str, sensors: tuple[Sensor, ...], rate_hz: float, block_minutes: int, water_depth_m: float
) -> None:
    """campaign.toml with the sensors in column order, as the drawing places them."""
    text = toml_text({
        "name": name,
        "sampling_rate_hz": rate_hz,
        "block_minutes": block_minutes,
        "water_depth_m": water_depth_m,
        "sensor": [
            {"channel": s.channel, "level": s.level, "position_m": s.position_m, "direction": s.direction,
             "quantity": s.quantity, "unit": s.unit, "gravity": bool(s.gravity)}
            for s in sensors
        ],
    })
    write_text(folder / "campaign.toml", text)


def write_acceleration(
    path: Path, data: np.ndarray, start: np.datetime64, rate_hz: float, channels: Sequence[str] = ()
) -> None:
    """One file: dataset `data` (n_sample, n_channel) float32 with `start` (ISO 8601, UTC), the sampling rate and, where
    given, the names of its columns.

    It gets its name only when complete, so that an interrupted run can be taken up again.
    """
    with new_hdf5(path) as file:
        dataset = file.create_dataset("data", data=np.asarray(data, np.float32))
        dataset.attrs["start"] = f"{start.astype('datetime64[ms]')}Z"
        dataset.attrs["sampling_rate_hz"] = float(rate_hz)
        if channels:
            dataset.attrs["channels"] = json.dumps(list(channels), ensure_ascii=False)
