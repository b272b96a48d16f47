"""A mode that an identification holds for two: where a channel is reversed or exchanged amid a record, or much
stiffness is lost, shapes of later sets are unlike those before, and who follows shapes has a new mode. And two that it
holds for one: who follows shapes alone mixes modes that few sensors show alike."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from probupdate.modal.sets import ModalData, ModalSet
from probupdate.modal.shape_criteria import mac

# fewer sets show no change of one mode for another
FEWEST = 8
# the first is there in at least, and the second in at most such shares of the sets before the change, and the other
# way round after it
PRESENT, ABSENT = 0.8, 0.25
# what an id that is a time begins with
TIME = re.compile(r"\d{4}-\d\d")
# in ln f: this near whatever the shapes are, and so far times MAC squared: half the stiffness moves a mode of the same
# shape by a third
SAME_FREQUENCY, MOVED_FREQUENCY = 0.02, 0.4


def separate_modes(data: ModalData) -> tuple[ModalData, list[str]]:
    """Each of two modes that stand in one column of the sets, further apart than one mode moves, in a column of its
    own, by the label of the column and its frequency; and what to say of it."""
    labels = data.labels or tuple(f"mode {j + 1}" for j in range(data.n_mode))
    hz = np.array([s.frequency_hz for s in data.sets]).reshape(-1, data.n_mode)
    columns, names, parents, notes = [], [], [], []
    for j, (label, lower) in enumerate(zip(labels, _lower_modes(hz), strict=True)):
        there = np.isfinite(hz[:, j])
        kinds = [there & lower, there & ~lower] if lower.any() else [there]
        around = [float(np.median(hz[k, j])) if k.any() else np.nan for k in kinds]
        columns += [np.where(k, j, -1) for k in kinds]
        names += [label] if len(kinds) == 1 else [f"{label} near {centre:.4g} Hz" for centre in around]
        parents += [j] * len(kinds)
        if len(kinds) > 1:
            notes.append(f"{label} is near {around[0]:.4g} Hz in {kinds[0].sum()} sets and near {around[1]:.4g} Hz in "
                         f"{kinds[1].sum()}: taken as two modes that the sensors show alike")
    if not notes:
        return data, []
    sets = tuple(s.of_modes([int(column[k]) for column in columns]) for k, s in enumerate(data.sets))
    records = tuple(replace(data.records[j], label=name) for j, name in zip(parents, names, strict=True)
                    ) if data.records else ()
    return replace(data, sets=sets, labels=tuple(names), records=records), notes


def _lower_modes(hz: np.ndarray) -> np.ndarray:
    """(n_mode, n_set) where a column of `hz` (n_set, n_mode) has the lower of two modes; none where it has one. What
    all modes of a set are off by together (its clock, its unit) is no reason for two."""
    log = np.log(hz)
    centre = np.array([np.median(c[np.isfinite(c)]) if np.isfinite(c).any() else np.nan for c in log.T])
    away = log - centre
    own = away - np.array([np.median(r[np.isfinite(r)]) if np.isfinite(r).any() else np.nan for r in away])[:, None]
    result = np.zeros(hz.T.shape, bool)
    for column, lower in zip(own.T, result, strict=True):
        order = np.sort(column[np.isfinite(column)])
        fewest = max(2, int(np.ceil(0.1 * len(order))))
        if len(order) < max(FEWEST, 2 * fewest):
            continue
        steps = np.diff(order)[fewest - 1:len(order) - fewest]
        at = int(np.argmax(steps))
        if steps[at] > MOVED_FREQUENCY:
            lower[:] = column <= order[fewest - 1 + at]
    return result


def highest_frequency_hz(data: ModalData) -> float:
    """Of the modes that are compared with a model, median over the sets [Hz]; 0 where there is none."""
    hz = np.array([s.frequency_hz for s in separate_modes(data.compared())[0].sets])
    found = [float(np.median(one[np.isfinite(one)])) for one in hz.T if np.isfinite(one).any()]
    return max(found, default=0.0)


def join_modes(data: ModalData) -> tuple[ModalData, list[str]]:
    """Such modes as one, by the name of the one that has one; and what to say of it. Two that have each a name are left
    as they are: of a close pair now one is found and now the other. Modes that stand in one column are separated
    first."""
    data, separated = separate_modes(data)
    data, joined = _join(data)
    return data, [*separated, *joined]


def _join(data: ModalData) -> tuple[ModalData, list[str]]:
    labels = data.labels or tuple(f"mode {j + 1}" for j in range(data.n_mode))
    hours = hours_of(tuple(s.id for s in data.sets))
    order = np.argsort(np.arange(len(data.sets)) if hours is None else hours, kind="stable")
    sets = [data.sets[k] for k in order]
    pairs = [(a, b, k) for a, b, k in modes_with_two_numbers(sets)
             if not data.labels or labels[a].isdigit() or labels[b].isdigit()]
    if not pairs:
        return data, []
    kept = {(a, b): b if labels[a].isdigit() and not labels[b].isdigit() else a for a, b, _ in pairs}
    left = [j for j in range(data.n_mode) if j not in {a + b - kept[a, b] for a, b, _ in pairs}]
    mode_in_column = columns_of(len(sets), data.n_mode, {(a, b, k): kept[a, b] for a, b, k in pairs})
    columns = {s.id: mode_in_column[k, left].tolist() for k, s in enumerate(sets)}
    return (replace(data.of_modes(left), sets=tuple(s.of_modes(columns[s.id]) for s in data.sets)),
            _notes(sets, labels, pairs))


def modes_with_two_numbers(sets: Sequence[ModalSet]) -> list[tuple[int, int, int]]:
    """Modes (first, second, the set from which on the second is found instead) of sets in the order of time."""
    from scipy import optimize

    used = [k for k, s in enumerate(sets) if s.measured.any()]
    if len(used) < FEWEST:
        return []
    there = np.array([sets[k].measured for k in used])
    n_mode = there.shape[1]
    change, cost = np.zeros((n_mode, n_mode), int), np.full((n_mode, n_mode), np.inf)
    for a, b in zip(*np.nonzero(~np.eye(n_mode, dtype=bool)), strict=True):
        k = _instead(there[:, a], there[:, b])
        if k is not None:
            change[a, b] = used[k]
            cost[a, b] = _difference([sets[i].of_modes([a]) for i in used[:k]],
                                     [sets[i].of_modes([b]) for i in used[k:]])
    rows, columns = optimize.linear_sum_assignment(np.where(np.isfinite(cost), cost, 1e6))
    return [(int(a), int(b), int(change[a, b])) for a, b in zip(rows, columns, strict=True) if np.isfinite(cost[a, b])]


def columns_of(n_set: int, n_mode: int, kept: Mapping[tuple[int, int, int], int]) -> np.ndarray:
    """(n_set, n_mode) the mode that stands in each column of each set: of each (first, second, change) in the column of
    the one that is kept the first before the change and the second from it on, in the other's -1, none."""
    columns = np.tile(np.arange(n_mode), (n_set, 1))
    for (a, b, change), keeps in kept.items():
        columns[:, a + b - keeps] = -1
        columns[:, keeps] = np.where(np.arange(n_set) < change, a, b)
    return columns


def _notes(sets: Sequence[ModalSet], labels: Sequence[str], pairs: Sequence[tuple[int, int, int]]) -> list[str]:
    """What to say of them, a sentence for each change."""
    said = []
    for change in sorted({k for _, _, k in pairs}):
        those = [pair for pair in pairs if pair[2] == change]
        before, after = ([labels[pair[end]] for pair in those] for end in (0, 1))
        said.append(f"from {sets[change].id} on {', '.join(after)} instead of {', '.join(before)} "
                    f"{joined_mode_words([frequencies_around(sets, pair) for pair in those])}")
    return said


def frequencies_around(sets: Sequence[ModalSet], pair: tuple[int, int, int]) -> tuple[float, float]:
    """Median frequency [Hz] of the first mode before the change and of the second from it on."""
    a, b, k = pair
    return (float(np.nanmedian([s.frequency_hz[a] for s in sets[:k]])),
            float(np.nanmedian([s.frequency_hz[b] for s in sets[k:]])))


def joined_mode_words(around: Sequence[tuple[float, float]]) -> str:
    """Why modes are taken as one: `around` their frequencies before and after the change."""
    same = "taken as the same mode" + "s" * (len(around) > 1)
    if all(abs(np.log(after / before)) <= SAME_FREQUENCY for before, after in around):
        return f"with another shape near the same frequency: {same}, as the structure or the sensors changed then"
    moved = ", ".join(f"{before:.4g}, then {after:.4g} Hz, {100 * (after / before - 1):+.2g} %"
                      for before, after in around)
    ways = {after > before for before, after in around if abs(np.log(after / before)) > SAME_FREQUENCY}
    both = ("; some rise and some fall, as one stiffness lost or one mass added cannot make them: one of them may be "
            "another mode (`probupdate explore` shows their shapes)" if len(ways) > 1 else "")
    return f"with a similar shape at another frequency ({moved}): {same}, as the structure changed then{both}"


def hours_of(ids: tuple[str, ...]) -> np.ndarray | None:
    """Hours since the first id where all of them are times (ISO 8601); a number is not a year."""
    if not all(TIME.match(i) for i in ids):
        return None
    try:
        times = np.array([np.datetime64(i.removesuffix("Z").removesuffix("+00:00"), "s") for i in ids])
    except ValueError:
        return None
    return (times - times.min()) / np.timedelta64(1, "h")


def _instead(first: np.ndarray, second: np.ndarray) -> int | None:
    """The set from which on the second of two modes is found in place of the first, of both (n_set,) bool; None where
    it is not so."""
    n, fewest = len(first), max(2, int(np.ceil(0.1 * len(first))))
    k = np.arange(fewest, n - fewest + 1)
    share = []
    for one in (first, second):
        total = np.concatenate([[0], np.cumsum(one)])
        share.append((total[k] / k, (total[-1] - total[k]) / (n - k)))
    (a_before, a_after), (b_before, b_after) = share
    good = (a_before >= PRESENT) & (b_after >= PRESENT) & (a_after <= ABSENT) & (b_before <= ABSENT)
    return int(k[np.argmax(np.where(good, a_before - a_after + b_after - b_before, -9.0))]) if good.any() else None


def _difference(before: Sequence[ModalSet], after: Sequence[ModalSet]) -> float:
    """How much the modes of sets of one mode each differ; infinite where they may not be one."""
    away = abs(np.log(np.nanmedian([s.frequency_hz[0] for s in after])
                      / np.nanmedian([s.frequency_hz[0] for s in before])))
    a, b = (np.column_stack([s.shape for s in sets if s.measured[0]]) for sets in (before, after))
    alike = mac(a, b)
    # frequencies alone are alike in shape to none
    median_mac = float(np.median(alike[np.isfinite(alike)])) if np.isfinite(alike).any() else 0.0
    same = away <= max(SAME_FREQUENCY, MOVED_FREQUENCY * median_mac**2)
    return away / SAME_FREQUENCY + 1 - median_mac if same else np.inf
