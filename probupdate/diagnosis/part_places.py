"""What tells elementary parts from one another, and what is said of where they act: identity is a value of numbers,
words are made of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from probupdate.structure.description import Description
from probupdate.structure.places import SAME_PLACE, coordinates, decimals, place_of

# horizontal directions of a spring
N_DIRECTION = 4


@dataclass(frozen=True, kw_only=True)
class PartKey:
    """An elementary part, whatever it is called: its cause, the nodes of the model's picture where it acts (of a model
    without one the row of the channel), the number of its direction (None: all of them alike) and the frequency of a
    mass on springs."""

    cause: str
    at: tuple[int, ...]
    way: int | None = None
    tuned_hz: float | None = None

    @property
    def without_tuning(self) -> PartKey:
        """The same at any frequency."""
        return replace(self, tuned_hz=None)

    @property
    def parameter(self) -> str:
        """The name of its parameter, which no other part has."""
        words = [self.cause, "at " + " ".join(map(str, self.at))]
        words += [f"way {self.way}"] if self.way is not None else []
        words += [f"{self.tuned_hz!r} Hz"] if self.tuned_hz is not None else []
        return ", ".join(words)


@dataclass(frozen=True, kw_only=True)
class Direction:
    """One of the directions of a part: its number, its words, the unit vector (3,)."""

    number: int
    words: str
    unit: np.ndarray


def directions(n: int = N_DIRECTION) -> list[Direction]:
    """n horizontal ones, and the vertical."""
    angle = np.arange(n) * 180.0 / n
    level = [Direction(number=k, words=f"along {a:g} deg", unit=np.array([np.cos(np.radians(a)),
                                                                         np.sin(np.radians(a)), 0.0]))
             for k, a in enumerate(angle)]
    return [*level, Direction(number=n, words="vertical", unit=np.array([0.0, 0.0, 1.0]))]


def place_words(description: Description | None, extent_m: float) -> Callable[[np.ndarray], str]:
    """Words for a point (3,) of a structure of this extent: by leg, face and bay where it is described, else by its
    coordinates."""
    digits = decimals(SAME_PLACE * extent_m)

    def words(point: np.ndarray) -> str:
        own = place_of(description, point) if description is not None else ""
        return own or coordinates(point, digits)

    return words


def words_of(points: np.ndarray, place: Callable[[np.ndarray], str], extent_m: float) -> list[str]:
    """Words for points (n, 3) of which no two read alike: to those that would, coordinates are added, and where these
    read alike too, a number."""
    digits = decimals(SAME_PLACE * extent_m)
    found = [place(point) for point in points]
    where = [coordinates(point, digits) for point in points]
    found = [f"{words}, at {at}" if words != at and many else words
             for words, at, many in zip(found, where, _find_repeated(found), strict=True)]
    count = np.zeros(len(found), int)
    for k, many in enumerate(_find_repeated(found)):
        count[k] = 1 + sum(words == found[k] for words in found[:k]) if many else 0
    return [f"{words}, no. {number}" if number else words for words, number in zip(found, count, strict=True)]


def _find_repeated(words: Sequence[str]) -> list[bool]:
    number = Counter(words)
    return [number[one] > 1 for one in words]
