"""One thing that sensors say of one another: what it is, of which channel, how large and how well known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# a size counts beyond so many standard deviations
SIGMA = 4.0
# of what one sensor does from a time on: a member that is lost there changes what its place moves by as well
OR_STRUCTURE = "the structure may have changed then instead, `probupdate diagnose` weighs the two"


def std_left_out(every: np.ndarray) -> np.ndarray:
    """Standard deviations (...) of an estimate from those without each of n parts (n, ...), the jackknife's."""
    n = len(every)
    return np.sqrt((n - 1) / n * np.sum((every - np.mean(every, axis=0)) ** 2, axis=0))


@dataclass(frozen=True, kw_only=True)
class SensorFinding:
    """name: 'gain change', 'gain', 'common gain', 'reference', 'nacelle heading' or 'sampling rate'. channel: the
    channel, several with commas between them. size: gain as recorded over as it should be (degrees for a heading, a
    ratio for a rate), std its standard deviation; since: the block or piece of record from which it holds, '' for all.
    alternatives: channels that explain the records as well. message: one sentence, what to do next at its end."""

    name: str
    channel: str
    size: float
    std: float
    unit: str = "-"
    since: str = ""
    alternatives: tuple[str, ...] = ()
    message: str = ""
