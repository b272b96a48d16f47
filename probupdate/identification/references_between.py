"""References of setups held against one another before anything is merged: signs, order, gains, frequencies.

A mode's shape at the references is the same in every setup but for its scale. A reference that was reversed, exchanged
with another or amplified differently in one of them makes all its modes unlike those of the others there, and all of
them alike again once it is mended: what one change explains in all modes is no chance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from probupdate.errors import InputError
from probupdate.modal.modes import Sensor, mac

# modes of two setups are one by frequency alone where they are this close (ln f)
SAME_MODE = 0.03
# mean and largest 1 - MAC at the references from which setups disagree, and the share of the mean that a change that
# explains it leaves at most
UNLIKE, MOST_UNLIKE, LEFT = 0.02, 0.08, 0.2
# gains that are tried, and from which one is said; a sign or an exchange explains as well with fewer numbers
GAINS = np.exp(np.linspace(np.log(0.05), np.log(20.0), 121))
LEAST_GAIN, BETTER = 1.1, 0.5
# ln f by which all modes of a setup differ from those of another, from which it is said
SHIFT = 0.008


@dataclass(frozen=True, eq=False, kw_only=True)
class SetupModes:
    """A setup's modes by itself: frequency_hz (n_mode,), shape (n_channel, n_mode) real, at its own sensors."""

    name: str
    sensors: tuple[Sensor, ...]
    frequency_hz: np.ndarray
    shape: np.ndarray

    def at(self, channels: Sequence[str]) -> np.ndarray:
        """(len(channels), n_mode) the shapes at some channels."""
        mine = [s.channel for s in self.sensors]
        return self.shape[[mine.index(c) for c in channels]]


def compare_references(setups: Sequence[SetupModes], references: Sequence[str]) -> list[str]:
    """What setups of equal shapes and other frequencies say of themselves; references are channels of two or more.
    Raises InputError where one change of a reference explains why a setup's modes are unlike those of another that has
    it too."""
    notes = []
    for first, second in combinations(setups, 2):
        here = [{s.channel for s in one.sensors} for one in (first, second)]
        shared = [c for c in references if c in here[0] & here[1]]
        pairs = _pairs(first.frequency_hz, second.frequency_hz)
        if len(pairs) < 2 or len(shared) < 2:
            continue
        one, two = first.at(shared)[:, pairs[:, 0]], second.at(shared)[:, pairs[:, 1]]
        unlike = _unlike(one, two)
        if unlike.mean() > UNLIKE and unlike.max() > MOST_UNLIKE:
            _refuse_explained(first, second, shared, one, two)
            continue
        away = np.log(second.frequency_hz[pairs[:, 1]] / first.frequency_hz[pairs[:, 0]])
        if np.abs(away).min() > SHIFT and np.ptp(np.sign(away)) == 0:
            notes.append(f"the frequencies of {second.name} are {100 * abs(np.mean(away)):.2g} % "
                         f"{'above' if away[0] > 0 else 'below'} those of {first.name}, with equal shapes: the "
                         "structure changed in between (temperature, mass), or a logger's rate is off")
    return notes


def _pairs(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(n, 2) modes that are nearest to one another, both ways."""
    away = np.abs(np.log(first[:, None] / second))
    return np.array([(i, j) for i, j in enumerate(np.argmin(away, axis=1))
                     if np.argmin(away[:, j]) == i and away[i, j] <= SAME_MODE], int).reshape(-1, 2)


def _unlike(one: np.ndarray, two: np.ndarray) -> np.ndarray:
    """(n_mode,) 1 - MAC of columns."""
    return 1 - np.diag(mac(one, two))


def _refuse_explained(
    first: SetupModes, second: SetupModes, references: Sequence[str], one: np.ndarray, two: np.ndarray
) -> None:
    before = _unlike(one, two)
    found = []
    n = len(references)
    for c in range(n):
        turned = two.copy()
        turned[c] *= -1
        found.append((_unlike(one, turned).mean(), "reversed", (c,), -1.0))
    for a, b in combinations(range(n), 2):
        order = np.arange(n)
        order[[a, b]] = b, a
        found.append((_unlike(one, two[order]).mean(), "exchanged", (a, b), 1.0))
    plain = min(found, key=lambda x: x[0])
    scaled = min(((_unlike(one, _times(two, c, g)).mean(), "amplified", (c,), g) for c in range(n) for g in GAINS),
                 key=lambda x: x[0])
    best = scaled if scaled[0] < BETTER * plain[0] and abs(np.log(scaled[3])) > np.log(LEAST_GAIN) else plain
    if best[0] > LEFT * before.mean():
        return
    left, kind, members, gain = best
    names = [references[c] for c in members]
    said = (f"as they are the setups' {one.shape[1]} modes have a MAC of {1 - before.mean():.2f} at the references on "
            f"average, with that mended {1 - left:.3f}")
    if kind == "reversed":
        # of two references either explains it
        others = [str(references[rows[0]]) for rest, how, rows, _ in found
                  if how == kind and rest <= 1.01 * left + 1e-12 and references[rows[0]] not in names]
        names, others = _who(first, second, names, others)
        raise InputError(
            f"setups {first.name} and {second.name}, reference {names[0]}",
            f"{names[0]} is reversed between the setups" + (f" (or {', '.join(others)} instead)" if others else "")
            + f": {said}", f"turn its direction in the campaign.toml of one of them (direction = "
            f"{_opposite(second, names[0])} in {second.name}), and they are merged with that")
    if kind == "exchanged":
        raise InputError(f"setups {first.name} and {second.name}, references {' and '.join(names)}",
                         f"{names[0]} and {names[1]} are exchanged between the setups: {said}",
                         "exchange their names in the campaign.toml of one of them")
    raise InputError(f"setups {first.name} and {second.name}, reference {names[0]}",
                     f"{names[0]} reads {1 / gain:.3g} times as much in {second.name} as in {first.name}: {said}",
                     "mend its unit in the campaign.toml of the one that is wrong")


def _times(shape: np.ndarray, row: int, gain: float) -> np.ndarray:
    scaled = shape.copy()
    scaled[row] *= gain
    return scaled


def _who(first: SetupModes, second: SetupModes, names: list[str], others: list[str]) -> tuple[list[str], list[str]]:
    """Of references that explain a reversal alike the one that goes against the sensors of its direction in one setup
    and with them in the other, in the lowest mode in which it moves; no others then."""
    against = [c for c in (*names, *others) if _sense(first, c) * _sense(second, c) < 0]
    return (against, []) if len(against) == 1 else (names, others)


def _sense(setup: SetupModes, channel: str) -> float:
    """Sign of the motion of others of its direction when the channel moves along it, in the lowest mode that moves it
    most."""
    row = [s.channel for s in setup.sensors].index(channel)
    along = np.array([float(s.direction @ setup.sensors[row].direction) for s in setup.sensors])
    others = np.flatnonzero((np.abs(along) > 0.9) & (np.arange(len(along)) != row))
    if not len(others):
        return 0.0
    share = np.abs(setup.shape[row]) / np.abs(setup.shape).max(axis=0)
    mode = int(np.argmax(share > 0.5 * share.max()))
    return float(np.sign(setup.shape[row, mode] * (along[others] @ setup.shape[others, mode])))


def _opposite(setup: SetupModes, channel: str) -> list[float]:
    direction = next(s.direction for s in setup.sensors if s.channel == channel)
    return [float(-x) + 0.0 for x in np.asarray(direction)]
