"""The modes of a model that identified poles are held against, as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probupdate.errors import InputError
from probupdate.modes import frozen_array


@dataclass(frozen=True, eq=False, kw_only=True)
class ReferenceModes:
    """Modes of interest: labels (FA1, SS1, ...), frequency_hz (n_mode,), shape (n_channel, n_mode) real, at the
    campaign's channels and in its quantity's proportions. `pairs`: modes so close that only their plane is told by
    the data; every other mode stands alone.
    """

    labels: tuple[str, ...]
    frequency_hz: np.ndarray
    shape: np.ndarray
    pairs: tuple[tuple[int, int], ...] = ()

    def __post_init__(self):
        frequency, shape = frozen_array(self.frequency_hz), frozen_array(self.shape)
        n_mode = len(self.labels)
        if n_mode == 0 or len(set(self.labels)) < n_mode:
            raise InputError("reference modes", f"labels {self.labels} are none or repeat", "give each mode one name")
        if frequency.shape != (n_mode,) or not np.all(frequency > 0):
            raise InputError("reference modes", f"frequency_hz {self.frequency_hz} is not {n_mode} positive numbers",
                             "give one per label")
        if shape.ndim != 2 or shape.shape[1] != n_mode or not np.all(np.isfinite(shape)):
            raise InputError("reference modes", f"shape is {shape.shape} or holds NaN", f"give {n_mode} finite columns")
        members = [i for pair in self.pairs for i in pair]
        if len(set(members)) < len(members) or not set(members) <= set(range(n_mode)):
            raise InputError("reference modes", f"pairs {self.pairs} share a mode or name one that is not there",
                             "name each mode in one pair at most")
        object.__setattr__(self, "frequency_hz", frequency)
        object.__setattr__(self, "shape", shape)

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Pairs and single modes, by their first mode."""
        paired = {i for pair in self.pairs for i in pair}
        return tuple(sorted([*self.pairs, *((i,) for i in range(len(self.labels)) if i not in paired)]))

    def group_hz(self, group: tuple[int, ...]) -> float:
        return float(np.mean(self.frequency_hz[list(group)]))
