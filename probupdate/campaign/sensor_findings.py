"""One thing that sensors say of one another: what it is, of which channel, how large and how well known."""

from __future__ import annotations

from dataclasses import dataclass

# a size counts beyond so many standard deviations
SIGMA = 4.0


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
