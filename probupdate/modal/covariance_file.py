"""`<stem>.deviations.h5` beside `modes.json`: a group a set, in it ln_frequency, damping_ratio and shape, float32."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from probupdate.errors import InputError
from probupdate.io.files import path_inside
from probupdate.io.hdf5_file import new_hdf5, open_hdf5

# name -> (number of axes, dtype in the file)
DATASETS = {"ln_frequency": (2, np.float32), "damping_ratio": (2, np.float32), "shape": (3, np.complex64)}
# their axes, as scales that xarray knows; readers here do not ask for them
AXES = {"ln_frequency": ("mode", "column"), "damping_ratio": ("mode", "column"), "shape": ("channel", "mode", "column")}


def _group_name(set_id: str) -> str:
    """A set's id as one HDF5 name: a slash would open a group inside, a lone dot or nothing name none."""
    escaped = set_id.replace("%", "%25").replace("/", "%2F")
    return escaped if escaped.strip(".") else escaped.replace(".", "%2E") + "%"


def write_factors(factors: Mapping[str, Any], modes_file: Path) -> str:
    """Write the covariance factors (id -> value whose `loaded()` has the three arrays) beside modes_file; the new
    file's name.

    Whole under another name first: a killed run leaves the old file or the new one.
    """
    path = modes_file.with_name(f"{modes_file.stem}.deviations.h5")
    with new_hdf5(path) as file:
        for set_id, kept in factors.items():
            covariance_factors = kept.loaded()
            group = file.create_group(_group_name(set_id))
            group.attrs["id"] = set_id
            for name, (_, dtype) in DATASETS.items():
                written = group.create_dataset(name, data=np.asarray(getattr(covariance_factors, name)).astype(dtype))
                for k, axis in enumerate(AXES[name]):
                    if axis not in group:
                        group.create_dataset(axis, data=np.arange(written.shape[k], dtype=np.int32)).make_scale(axis)
                    if len(group[axis]) == written.shape[k]:
                        written.dims[k].attach_scale(group[axis])
    return path.name


def read_factors(modes_file: Path, name: object) -> dict[str, dict[str, np.ndarray]]:
    """id -> the three arrays, of the file `name` in the folder of modes_file."""
    where = f"{modes_file}, deviations"
    if not isinstance(name, str) or not name or Path(name).name != name or name in (".", ".."):
        raise InputError(where, f"{name!r} is no file name", "name a file in the same folder")
    path = modes_file.with_name(name)
    if "\0" in name or not path.exists():
        raise InputError(where, f"{path} does not exist", "put it back beside the file, or take the key out")
    path_inside(path, modes_file.parent)
    again = "make it again with `probupdate identify`"
    with open_hdf5(path, "no file of covariance factors", again, whole=True) as file:
        return {str(group.attrs["id"]): {key: _array(path, group, key) for key in DATASETS}
                for group in file.values()}


def _array(path: Path, group, key: str) -> np.ndarray:
    array = group[key][()]
    if array.ndim != DATASETS[key][0] or array.dtype.kind not in "fc" or np.any(np.isinf(array)):
        raise InputError(f"{path}, {group.attrs['id']}", f"{key} is no table of {DATASETS[key][0]} axes of numbers",
                         "make it again with `probupdate identify`")
    return array
