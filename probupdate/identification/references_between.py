"""References of setups held against one another before anything is merged: signs, order, gains, frequencies.

A mode's shape at the references is the same in every setup but for its scale. A reference that was reversed, exchanged
with another or amplified differently in one of them makes all its modes unlike those of the others there, and all of
them alike again once it is corrected: what one change explains in all modes is no chance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from probupdate.errors import InputError
from probupdate.modal.modes import Sensor, mac

# modes of two setups are one where they are this close (ln f), beside a shift of all up to the other
SAME_MODE, LARGEST_SHIFT = 0.03, 0.06
# mean and largest 1 - MAC at the references from which setups disagree, and the share of the mean that a change that
# explains it leaves at most
UNLIKE, MOST_UNLIKE, REMAINING = 0.02, 0.08, 0.2
# gains that are tried, and from which one is said; a sign or an exchange explains as well with fewer numbers
GAINS = np.exp(np.linspace(np.log(0.05), np.log(20.0), 121))
LEAST_GAIN, BETTER = 1.1, 0.5
# a channel's phase is asked in the modes that move it most, if that is this share of what moves most; and the share of
# its motion that is out of phase
OF_ITS_MOST, SEEN, OUT_OF_PHASE = 0.3, 0.03, 0.8
# modes whose signs, and references whose reversals, are tried in all combinations; turns in which an order settles;
# 1 - MAC that rounding leaves
MOST_SIGNED, ROUNDS, ROUNDING = 7, 6, 1e-4
# ln f by which all modes of a setup differ from those of another, from which it is said
SHIFT = 0.008


@dataclass(frozen=True, eq=False, kw_only=True)
class SetupModes:
    """A setup's modes by itself: frequency_hz (n_mode,), shape (n_channel, n_mode) at its own sensors, complex as
    identified and turned to the real axis."""

    name: str
    sensors: tuple[Sensor, ...]
    frequency_hz: np.ndarray
    shape: np.ndarray

    def at_channels(self, channels: Sequence[str]) -> np.ndarray:
        """(len(channels), n_mode) the shapes at some channels."""
        mine = [s.channel for s in self.sensors]
        return np.real(self.shape[[mine.index(c) for c in channels]])


def compare_references(setups: Sequence[SetupModes], references: Sequence[str]) -> list[str]:
    """What setups say of themselves that have equal shapes and other frequencies, references all against their other
    sensors, or shapes that no change explains; references are channels of two or more. Raises InputError where changes
    of one reference or two explain why a setup's modes are unlike those of another, or a channel is out of phase."""
    notes = []
    for setup in setups:
        _refuse_out_of_phase(setup)
    for first, second in combinations(setups, 2):
        shared = _shared_references(first, second, references)
        if len(shared) < 2 or len(pairs := _pairs(first, second, shared)) < 2:
            continue
        one, two = first.at_channels(shared)[:, pairs[:, 0]], second.at_channels(shared)[:, pairs[:, 1]]
        against = [k for k, c in enumerate(shared) if _sense(first, c) * _sense(second, c) < 0]
        mended = _Change(order=tuple(range(len(shared))), reversed_=tuple(against)).apply(two)
        # of modes that move along one direction each a reversal changes little, and that as a whole
        if _disagree(one, two) or _mac_deficit(one, mended).mean() < REMAINING * _mac_deficit(one, two).mean():
            notes.append(_refuse_explained(first, second, shared, one, two))
            continue
        if against:
            notes.append(f"{', '.join(shared[k] for k in against)} move with the other sensors of their directions in "
                         f"one of the setups {first.name} and {second.name}, and against them in the other: if no mode "
                         "does so, they are reversed there, and so is its part of the shapes; turn their directions in "
                         "its campaign.toml")
        if away := _ln_shift(first, second, pairs):
            notes.append(f"the frequencies of {second.name} are {100 * abs(away):.2g} % "
                         f"{'above' if away > 0 else 'below'} those of {first.name}, with equal shapes: the "
                         "structure changed in between (temperature, mass), or a logger's rate is off")
    return notes


def frequency_shifts(setups: Sequence[SetupModes], references: Sequence[str]) -> dict[str, float]:
    """ln f by which all modes of a setup differ from the mean of all, by name, where shapes at the references are
    equal; along a chain of setups that share modes."""
    shift = dict.fromkeys((s.name for s in setups[:1]), 0.0)
    for second in setups[1:]:
        for first in (s for s in setups if s.name in shift):
            shared = _shared_references(first, second, references)
            if len(shared) > 1 and len(pairs := _pairs(first, second, shared)) > 1 and not _disagree(
                    first.at_channels(shared)[:, pairs[:, 0]], second.at_channels(shared)[:, pairs[:, 1]]):
                shift[second.name] = shift[first.name] + _ln_shift(first, second, pairs)
                break
        shift.setdefault(second.name, 0.0)
    middle = float(np.mean(list(shift.values()))) if shift else 0.0
    return {name: away - middle for name, away in shift.items()}


def _shared_references(first: SetupModes, second: SetupModes, references: Sequence[str]) -> list[str]:
    here = [{s.channel for s in one.sensors} for one in (first, second)]
    return [c for c in references if c in here[0] & here[1]]


def _disagree(one: np.ndarray, two: np.ndarray) -> bool:
    """Whether shapes at the references, columns, are of two kinds."""
    unlike = _mac_deficit(one, two)
    return bool(unlike.mean() > UNLIKE and unlike.max() > MOST_UNLIKE)


def _ln_shift(first: SetupModes, second: SetupModes, pairs: np.ndarray) -> float:
    """Mean of ln f of the second over the first's, 0 where modes do not differ alike."""
    away = np.log(second.frequency_hz[pairs[:, 1]] / first.frequency_hz[pairs[:, 0]])
    return float(np.mean(away)) if np.abs(away).min() > SHIFT and np.ptp(np.sign(away)) == 0 else 0.0


def _refuse_out_of_phase(setup: SetupModes) -> None:
    """A velocity beside accelerations is a quarter of a period late in every mode, as no motion of a structure is."""
    size = np.abs(setup.shape)
    most = (size / size.max(axis=0)).max(axis=1, keepdims=True)
    moves = (size / size.max(axis=0) > OF_ITS_MOST * most) & (most > SEEN)
    quarter = np.abs(np.imag(setup.shape)) > OUT_OF_PHASE * size
    wrong = [s.channel for s, there, late in zip(setup.sensors, moves, quarter, strict=True)
             if there.sum() > 1 and late[there].all()]
    if wrong:
        raise InputError(f"setup {setup.name}, {', '.join(wrong)}", "a quarter of a period from the other channels in "
                         "every mode: velocities beside accelerations, or the other way round?",
                         "state quantity and unit of each [[sensor]] in its campaign.toml as they were measured")


def _pairs(first: SetupModes, second: SetupModes, shared: Sequence[str]) -> np.ndarray:
    """(n, 2) modes that are one, beside a shift of ln f that all have: the one at which most are near one of alike
    shape at the `shared` references, as a shift may be as large as a pair's modes are apart."""
    away = np.log(second.frequency_hz / first.frequency_hz[:, None])
    alike = 0.5 + 0.5 * np.nan_to_num(mac(first.at_channels(shared), second.at_channels(shared)))

    def similarity(shift: float) -> np.ndarray:
        return alike * np.exp(-0.5 * ((away - shift) / SHIFT) ** 2)

    shifts = sorted([0.0, *away[np.abs(away) <= LARGEST_SHIFT]], key=abs)
    best = max(shifts, key=lambda s: round(float(similarity(s).max(axis=1).sum()), 2))
    own = similarity(best)
    return np.array([(i, j) for i, j in enumerate(np.argmax(own, axis=1))
                     if np.argmax(own[:, j]) == i and abs(away[i, j] - best) <= SAME_MODE], int).reshape(-1, 2)


def _mac_deficit(one: np.ndarray, two: np.ndarray) -> np.ndarray:
    """(n_mode,) 1 - MAC of columns."""
    return 1 - np.diag(mac(one, two))


@dataclass(frozen=True, kw_only=True)
class _Change:
    """What may make one setup's shapes at the references those of another: which of its rows stands for each
    reference, and which of these are then reversed."""

    order: tuple[int, ...]
    reversed_: tuple[int, ...] = ()

    def apply(self, shape: np.ndarray) -> np.ndarray:
        mended = shape[list(self.order)]
        mended[list(self.reversed_)] *= -1
        return mended

    @property
    def cycles(self) -> list[tuple[int, ...]]:
        """References in one another's places: each has what is called the next one."""
        found: list[tuple[int, ...]] = []
        for start in range(len(self.order)):
            cycle = [start]
            while (then := self.order[cycle[-1]]) != start:
                cycle.append(then)
            if len(cycle) > 1 and start == min(cycle):
                found.append(tuple(cycle))
        return found

    @property
    def size(self) -> int:
        """Number of exchanges of two and of reversals that make it."""
        return sum(len(c) - 1 for c in self.cycles) + len(self.reversed_)

    def words(self, names: Sequence[str], first: str, second: str) -> str:
        turned = [names[c] for c in self.reversed_]
        said = [f"{names[c[0]]} and {names[c[1]]} are exchanged" if len(c) == 2 else
                f"{', '.join(names[k] for k in c)} are in one another's places ("
                + ", ".join(f"{names[self.order[k]]} of {second} is {names[k]} of {first}" for k in c) + ")"
                for c in self.cycles]
        said += [f"{' and '.join(turned)} {'is' if len(turned) == 1 else 'are'} reversed"] if turned else []
        return " and ".join(said) + " between the setups"


def _changes(one: np.ndarray, two: np.ndarray) -> list[_Change]:
    """Single reversals and exchanges of references, and where three modes or more show them the order and signs that
    make `two` (n, n_mode) most like `one` as a whole, with each part of them: an assignment for the scale of every
    mode, which follows from it in turn, begun with all signs of the modes."""
    # half a second of every command's start otherwise
    from scipy import optimize

    n, n_mode = one.shape
    same = tuple(range(n))
    found = [_Change(order=same, reversed_=(c,)) for c in range(n)]
    for a, b in combinations(range(n), 2):
        order = list(same)
        order[a], order[b] = b, a
        found.append(_Change(order=tuple(order)))
    if n_mode < 3:
        return found
    first, second = (s / np.linalg.norm(s, axis=0) for s in (one, two))
    best, most = None, -1.0
    for sign in product((1.0, -1.0), repeat=min(n_mode, MOST_SIGNED) - 1):
        scale = np.array([1.0, *sign, *[0.0] * (n_mode - MOST_SIGNED)])
        for _ in range(ROUNDS):
            alike = (first * scale) @ second.T
            _, order = optimize.linear_sum_assignment(-np.abs(alike))
            signs = np.where(alike[range(n), order] < 0, -1.0, 1.0)
            scale = np.sum(first * signs[:, None] * second[order], axis=0)
        if scale @ scale > most * (1 + 1e-9):
            best, most = (tuple(int(k) for k in order), signs), float(scale @ scale)
    whole = _Change(order=best[0])
    for kept in product((False, True), repeat=len(whole.cycles)):
        order = list(same)
        for cycle, takes_part in zip(whole.cycles, kept, strict=True):
            for k in cycle if takes_part else ():
                order[k] = whole.order[k]
        for turned in (best[1] < 0, best[1] > 0):
            rows = np.flatnonzero(turned)[:MOST_SIGNED]
            found += [_Change(order=tuple(order), reversed_=tuple(int(c) for c in some))
                      for size in range(len(rows) + 1) for some in combinations(rows, size)]
    # a shape has no sign of its own: all references reversed are none
    return [c for c in dict.fromkeys(found) if c.size and len(c.reversed_) < n]


def _refuse_explained(
    first: SetupModes, second: SetupModes, references: Sequence[str], one: np.ndarray, two: np.ndarray
) -> str:
    """What is said where no change explains it."""
    before = _mac_deficit(one, two).mean()
    n = len(references)
    found = [(_mac_deficit(one, change.apply(two)).mean(), change) for change in _changes(one, two)]
    # one exchange or reversal more is believed where it leaves so much less
    left, change = min(found, key=lambda x: max(x[0], ROUNDING) / BETTER ** (2 * x[1].size))
    scaled, gain, row = min(((_mac_deficit(one, _times(two, c, g)).mean(), g, c) for c in range(n) for g in GAINS),
                            key=lambda x: x[0])
    amplified = scaled < BETTER * left and abs(np.log(gain)) > np.log(LEAST_GAIN)
    both = f"setups {first.name} and {second.name}"
    like = f"have a MAC of {1 - before:.2f} at the references on average"
    if min(scaled, left) > REMAINING * before:
        return (f"{both}: their {one.shape[1]} modes {like}, and no change of references explains it: run `probupdate "
                "check` on each")
    said = f"as they are the setups' {one.shape[1]} modes {like}, with that corrected {1 - min(scaled, left):.3f}"
    if amplified:
        raise InputError(f"{both}, reference {references[row]}", f"{references[row]} reads {1 / gain:.3g} times as "
                         f"much in {second.name} as in {first.name}: {said}",
                         "correct its unit in the campaign.toml of the one that is wrong")
    # of references some explain it as well as others
    alike = [c for rest, c in found if rest <= 1.01 * left + 1e-12 and c.order == change.order
             and len(c.reversed_) == len(change.reversed_)]
    chosen, others = _likely_reversals(first, second, references, alike)
    named = [references[c] for c in dict.fromkeys((*sum(chosen.cycles, ()), *chosen.reversed_))]
    instead = f" (or {', or '.join(' and '.join(references[c] for c in o.reversed_) for o in others)} reversed instead)"
    remedy = ["put their [[sensor]] tables in one another's place in the campaign.toml of one of them, or, if its "
              "files were converted, their columns in its convert.toml, and convert again"] if chosen.cycles else []
    if chosen.reversed_:
        turned = ", ".join(f"{_opposite(second, references[c])} for {references[c]}" for c in chosen.reversed_)
        remedy.append(f"turn the direction in the campaign.toml of one of them (direction = {turned} in {second.name})")
    raise InputError(f"{both}, reference{'s' if len(named) > 1 else ''} {' and '.join(named)}",
                     f"{chosen.words(references, first.name, second.name)}{instead if others else ''}: {said}",
                     f"{'; then '.join(remedy)}, and they are merged with that")


def _times(shape: np.ndarray, row: int, gain: float) -> np.ndarray:
    scaled = shape.copy()
    scaled[row] *= gain
    return scaled


def _likely_reversals(first: SetupModes, second: SetupModes, references: Sequence[str], alike: list[_Change]
         ) -> tuple[_Change, list[_Change]]:
    """Of reversals that explain it alike the one of references that go against the sensors of their direction in one
    setup and with them in the other, in the lowest mode in which they move; no others then."""
    against = [change for change in alike if change.reversed_ and not change.cycles and all(
        _sense(first, references[c]) * _sense(second, references[c]) < 0 for c in change.reversed_)]
    return (against[0], []) if len(against) == 1 else (alike[0], alike[1:])


def _sense(setup: SetupModes, channel: str) -> float:
    """Sign of the motion of others of its direction when the channel moves along it, in the lowest mode that moves it
    most."""
    row = [s.channel for s in setup.sensors].index(channel)
    along = np.array([float(s.direction @ setup.sensors[row].direction) for s in setup.sensors])
    others = np.flatnonzero((np.abs(along) > 0.9) & (np.arange(len(along)) != row))
    if not len(others):
        return 0.0
    shape = np.real(setup.shape)
    share = np.abs(shape[row]) / np.abs(shape).max(axis=0)
    mode = int(np.argmax(share > 0.5 * share.max()))
    return float(np.sign(shape[row, mode] * (along[others] @ shape[others, mode])))


def _opposite(setup: SetupModes, channel: str) -> list[float]:
    direction = next(s.direction for s in setup.sensors if s.channel == channel)
    return [float(-x) + 0.0 for x in np.asarray(direction)]
