"""`<stem>.deviations.h5` beside `modes.json`: a group a set, in it ln_frequency, damping_ratio and shape, float32."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from probupdate.errors import InputError
from probupdate.io.checksum import checksum_of_arrays, checksum_of_table
from probupdate.io.files import path_inside
from probupdate.io.hdf5_file import new_hdf5, open_hdf5
from probupdate.modal.sets import CovarianceFactors, ModalSet, StoredFactors

# name -> dtype in the file
DATASETS = {"ln_frequency": np.float32, "damping_ratio": np.float32, "shape": np.complex64}
# attribute of a group, of its arrays; of the file, of its groups' ids and checksums
CHECKSUM = "checksum"
# a file up to that size (bytes) is kept in memory, a larger one read set by set as it is asked for
KEPT_IN_MEMORY = 8 * 2**20
AGAIN = "run again what wrote it and its modes: `probupdate identify`, `select` or `diagnose`"
# their axes, as scales that xarray knows; readers here do not ask for them
AXES = {"ln_frequency": ("mode", "column"), "damping_ratio": ("mode", "column"), "shape": ("channel", "mode", "column")}


def _group_name(set_id: str) -> str:
    """A set's id as one HDF5 name: a slash would open a group inside, a lone dot or nothing name none."""
    escaped = set_id.replace("%", "%25").replace("/", "%2F")
    return escaped if escaped.strip(".") else escaped.replace(".", "%2E") + "%"


def write_factors(factors: Mapping[str, Any], modes_file: Path) -> str:
    """Write the covariance factors (id -> value whose `load()` has the three arrays) beside modes_file; the new
    file's name.

    Whole under another name first: a killed run leaves the old file or the new one.
    """
    path = modes_file.with_name(f"{modes_file.stem}.deviations.h5")
    whole: dict[str, str] = {}
    with new_hdf5(path) as file:
        for set_id, kept in factors.items():
            covariance_factors = kept.load()
            group = file.create_group(_group_name(set_id))
            group.attrs["id"] = set_id
            arrays = {name: np.asarray(getattr(covariance_factors, name)).astype(dtype)
                      for name, dtype in DATASETS.items()}
            group.attrs[CHECKSUM] = whole[set_id] = checksum_of_arrays(arrays).hex()
            for name, array in arrays.items():
                written = group.create_dataset(name, data=array)
                for k, axis in enumerate(AXES[name]):
                    if axis not in group:
                        group.create_dataset(axis, data=np.arange(written.shape[k], dtype=np.int32)).make_scale(axis)
                    if len(group[axis]) == written.shape[k]:
                        written.dims[k].attach_scale(group[axis])
        file.attrs[CHECKSUM] = checksum_of_table(whole)
    return path.name


@contextmanager
def opened_factors(modes_file: Path, name: object) -> Iterator[FactorsFile]:
    """The covariance factors in the file `name` in the folder of modes_file."""
    where = f"{modes_file}, deviations"
    if not isinstance(name, str) or not name or Path(name).name != name or name in (".", ".."):
        raise InputError(where, f"{name!r} is not a file name", "name a file in the same folder")
    path = modes_file.with_name(name)
    if "\0" in name or not path.exists():
        raise InputError(where, f"{path} does not exist", "put it back beside the file, or take the key out")
    path_inside(path, modes_file.parent)
    with _open_store(path) as file:
        if CHECKSUM not in file.attrs:
            raise InputError(str(path), "has no checksum: an earlier version wrote it", AGAIN)
        groups = {str(group.attrs.get("id")): name for name, group in file.items()}
        if file.attrs[CHECKSUM] != checksum_of_table({set_id: str(file[name].attrs.get(CHECKSUM))
                                                      for set_id, name in groups.items()}):
            raise _damage_error(path)
        yield FactorsFile(path=path, state=_state(path), file=file, groups=groups)


@dataclass(frozen=True, eq=False, kw_only=True)
class FactorsFile:
    """An open file of covariance factors, as it was then; groups: id of a set -> its group."""

    path: Path
    state: tuple[int, ...]
    file: Any
    groups: Mapping[str, str]

    def read(self, set_id: str) -> dict[str, np.ndarray] | None:
        """The three arrays of a set; None of one that has none here."""
        return _arrays(self.path, self.file[self.groups[set_id]]) if set_id in self.groups else None

    def keep(self, modal_set: ModalSet) -> ModalSet:
        """The set with its arrays in memory, or of a large file with where they are."""
        if self.state[0] <= KEPT_IN_MEMORY or modal_set.id not in self.groups:
            return modal_set
        read = partial(_stored_factors, self.path, self.state, self.groups[modal_set.id])
        return replace(modal_set, covariance_factors=StoredFactors(read=read, taken=True))


def _stored_factors(path: Path, state: tuple[int, ...], group: str) -> CovarianceFactors:
    if not path.exists() or _state(path) != state:
        raise InputError(str(path), "has changed since its modes were read", "run again, while nothing writes there")
    with _open_store(path) as file:
        return CovarianceFactors(**_arrays(path, file[group]))


def _state(path: Path) -> tuple[int, ...]:
    found = path.stat()
    return found.st_size, found.st_mtime_ns, found.st_ino


def _open_store(path: Path) -> Any:
    return open_hdf5(path, "is not a file of covariance factors", AGAIN, whole=True)


def _arrays(path: Path, group: Any) -> dict[str, np.ndarray]:
    found = {key: group[key][()] for key in DATASETS if key in group}
    if checksum_of_arrays(found).hex() != group.attrs[CHECKSUM]:
        raise _damage_error(path)
    return found


def _damage_error(path: Path) -> InputError:
    return InputError(str(path), "does not hold what was written: it was damaged or changed", AGAIN)
