"""Sources of `convert` whose samples are known: a table of two channels at 10 Hz, and what was made of it."""

from __future__ import annotations

import h5py
import numpy as np
import pandas as pd

RATE, START = 10.0, pd.Timestamp("2019-06-03T10:00:00Z")
COLUMNS = '\n[columns]\n"a-x" = "east"\n"a-y" = "north"\n'


def noise(n=6000, seed=1) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((n, 2))


def stamps(n=6000, start=START, step="100ms") -> pd.DatetimeIndex:
    return pd.date_range(start, periods=n, freq=step)


def records(campaign) -> list[tuple[pd.Timestamp, np.ndarray]]:
    """(start, data) of each file, in order."""
    found = []
    for path in (campaign / "acceleration").glob("*.h5"):
        with h5py.File(path) as file:
            found.append((pd.Timestamp(file["data"].attrs["start"]), file["data"][:]))
    return sorted(found, key=lambda f: f[0])


def table(data, time) -> pd.DataFrame:
    return pd.DataFrame({"when": time, "east": data[:, 0], "north": data[:, 1], "other": 7.0})
