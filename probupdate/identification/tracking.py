"""Modes followed over a campaign: where each one lies from block to block, and the pole that stands for it.

A mode's frequency moves with water level, temperature and amplitude, and steps when the structure changes. One centre
for a month would lose it, or be so wide that it takes in its neighbours. The path is found for the whole campaign at
once (Viterbi): poles of every block and model order vote, and moving costs in proportion to the way. A mode that is
absent for a block, a state or all the time leaves the path where it is, or NaN.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from probupdate.errors import InputError
from probupdate.identification import classification as rules
from probupdate.identification.classification import ClassifierSettings, PoleComparison, PoleStack
from probupdate.identification.reference import ReferenceModes
from probupdate.identification.settings import CONSTANTS
from probupdate.modal.modes import mac, pair_by_mac
from probupdate.runtime.arrays import frozen_array

GRID, VOTE_WIDTH, FLOOR, COST = CONSTANTS.track_grid, CONSTANTS.vote_width, CONSTANTS.vote_floor, CONSTANTS.move_cost
LEAST_CLEAR = CONSTANTS.least_clear
NEARNESS = CONSTANTS.nearness


@dataclass(frozen=True, eq=False, kw_only=True)
class JudgedPoles:
    """One block's poles with what its own record says of them. reference: the model's modes turned to where the
    nacelle looked; bands (n_harmonic, 2) Hz that multiples of the rotor speed swept."""

    id: str
    poles: PoleStack
    comparison: PoleComparison
    verdict: np.ndarray
    bands: np.ndarray
    reference: ReferenceModes


@dataclass(frozen=True, eq=False, kw_only=True)
class Choice:
    """criterion (n_pole,) of each pole; pole (n_mode,) the pole that stands for each mode, -1 where none does; share
    (n_mode,) of the block's model orders that have the mode; independence (n_group,): 1 - MAC in the plane between
    a pair's two poles, NaN where they are not both there."""

    criterion: np.ndarray
    pole: np.ndarray
    share: np.ndarray
    independence: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class TrackedModes:
    """choices: one a block; centre_hz (n_block, n_mode): where each mode lies, NaN for one never seen; it goes on
    where the mode is absent. support (n_block, n_mode): share of the block's votes within the window."""

    labels: tuple[str, ...]
    choices: tuple[Choice, ...]
    centre_hz: np.ndarray
    support: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class Votes:
    """One block's votes on where the modes lie: per mode places ln f and weights (n,) of the poles that vote. clear:
    without what lies where the rotor's multiples passed; every: with it."""

    clear: tuple[tuple[np.ndarray, np.ndarray], ...]
    every: tuple[tuple[np.ndarray, np.ndarray], ...]


def votes_of(block: JudgedPoles, settings: ClassifierSettings) -> Votes:
    """What `paths` needs of a block, a hundredth of its poles."""
    both = []
    # where no rotor's multiples passed both are the same
    for swept in (False, True)[: 1 + bool(len(block.bands))]:
        place, weight = _votes(block, settings, swept=swept)
        both.append(tuple((place[w > 0], w[w > 0]) for w in weight.T))
    return Votes(clear=both[0], every=both[-1])


def track(blocks: Sequence[JudgedPoles], settings: ClassifierSettings) -> TrackedModes:
    """Follow every mode over the blocks, which are in the order of time, and choose its pole in each."""
    if not blocks:
        raise InputError("tracking", "there is no block", "identify at least one")
    centre, support = paths([votes_of(block, settings) for block in blocks], blocks[0].reference, settings)
    choices = tuple(choose(block, centre[k], settings) for k, block in enumerate(blocks))
    return TrackedModes(labels=blocks[0].reference.labels, choices=choices, centre_hz=frozen_array(centre),
                        support=frozen_array(support))


def paths(
    votes: Sequence[Votes], reference: ReferenceModes, settings: ClassifierSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Where each mode of `reference` lies from block to block, Hz, and the support there: centre_hz and support
    (n_block, n_mode) of `TrackedModes`."""
    n_mode = len(reference.labels)
    centre, support = np.full((len(votes), n_mode), np.nan), np.zeros((len(votes), n_mode))
    for j in range(n_mode):
        low, high = _window(reference, j, settings)
        # a mode that lies where the rotor's multiples pass in nearly every block would else be lost
        hidden = sum(v.clear[j][1].sum() for v in votes) < LEAST_CLEAR * sum(v.every[j][1].sum() for v in votes)
        own = [(v.every if hidden else v.clear)[j] for v in votes]
        path = follow(own, low, high)
        if path is not None:
            centre[:, j] = np.exp(path)
            for k, (x, w) in enumerate(own):
                support[k, j] = np.sum(w[np.abs(x - path[k]) <= settings.cluster])
    return centre, support


def _window(reference: ReferenceModes, mode: int, settings: ClassifierSettings) -> tuple[float, float]:
    """Where a mode's path may run, in ln f: over the range of its poles, or about its frequency in a model."""
    if reference.range_hz is None:
        low, high = np.log(reference.frequency_hz[mode] * np.array(settings.frequency_window))
        return float(low), float(high)
    low, high = np.log(reference.range_hz[mode])
    return float(low) - rules.RANGE_MARGIN, float(high) + rules.RANGE_MARGIN


def follow(
    votes: Sequence[tuple[np.ndarray, np.ndarray]], low: float, high: float, *, refine: bool = True
) -> np.ndarray | None:
    """The path x (n_block,) in [low, high] that maximises sum_k ln(FLOOR + v_k(x_k)) - COST sum_k |x_k - x_(k-1)|.

    votes: places and weights (n,) of each block; v_k is the largest sum of weights within a Gaussian of VOTE_WIDTH.
    None where no block votes in the range. Before the first and after the last vote the path stays. It runs on a grid;
    `refine` takes the grid's step out again.
    """
    grid = np.arange(low, high + GRID, GRID)
    reward, seen = np.full((len(votes), len(grid)), np.log(FLOOR)), False
    for k, (place, weight) in enumerate(votes):
        inside = (place >= low) & (place <= high) & (weight > 0)
        if inside.any():
            seen = True
            near = np.exp(-0.5 * ((grid[:, None] - place[inside]) / VOTE_WIDTH) ** 2) @ weight[inside]
            reward[k] = np.log(FLOOR + near)
    if not seen:
        return None
    ramp = COST * GRID * np.arange(len(grid))
    total = [reward[0]]
    for row in reward[1:]:
        before = total[-1]
        # the best of all places before, less the cost of the way there, from both sides
        rising = np.maximum.accumulate(before + ramp) - ramp
        falling = np.maximum.accumulate((before - ramp)[::-1])[::-1] + ramp
        total.append(row + np.maximum(rising, falling))
    path = np.empty(len(votes), int)
    path[-1] = int(np.argmax(total[-1]))
    for k in range(len(votes) - 2, -1, -1):
        way = COST * GRID * np.abs(np.arange(len(grid)) - path[k + 1])
        value = total[k] - way
        # among equals the nearest: nothing moves without a reason
        path[k] = int(np.argmin(np.where(value >= value.max() - 1e-9, way, np.inf)))
    return _refine_places(votes, grid[path]) if refine else grid[path]


def _refine_places(votes, path: np.ndarray) -> np.ndarray:
    """The grid's step taken out: each place moved to the weighted mean of what the blocks about it vote nearby."""
    refined = np.array(path)
    for k, centre in enumerate(path):
        some = [votes[i] for i in range(max(k - 2, 0), min(k + 3, len(path))) if abs(path[i] - centre) <= 2 * GRID]
        place = np.concatenate([x for x, _ in some])
        weight = np.concatenate([w for _, w in some]) * np.exp(-0.5 * ((place - centre) / VOTE_WIDTH) ** 2)
        if np.sum(weight) > FLOOR:
            refined[k] = np.sum(weight * place) / np.sum(weight)
    return refined


def _votes(block: JudgedPoles, settings: ClassifierSettings, *, swept: bool) -> tuple[np.ndarray, np.ndarray]:
    """ln f (n_pole,) and weights (n_pole, n_mode): each model order has one vote a mode, shared by its poles.

    A pole of a pair votes for the member it points to. What lies where the rotor's multiples passed votes only if
    `swept`, and not if it is damped as little as a line.
    """
    poles, like, reference = block.poles, block.comparison, block.reference
    weight = np.zeros((len(poles.order), len(reference.labels)))
    score = like.score(poles.damping_ratio)
    voting = (block.verdict == rules.KEPT) & rules.is_trusted(like, reference, settings)
    passed = rules.is_within(poles.frequency_hz, block.bands)
    voting &= ~(passed & (poles.damping_ratio < settings.harmonic_damping)) if swept else ~passed
    for g, group in enumerate(reference.groups):
        mine = np.flatnonzero(voting & (like.group == g))
        if not len(mine):
            continue
        toward = _squared_cosines(poles.shape[:, mine], reference.shape[:, list(group)])
        for member, j in enumerate(group):
            own = score[mine] * toward[:, member]
            for n in np.unique(poles.order[mine]):
                here = poles.order[mine] == n
                strength = toward[here, member].max()
                weight[mine[here], j] = strength * own[here] / max(own[here].sum(), 1e-300)
    weight /= max(len(poles.orders), 1)
    return np.log(poles.frequency_hz), weight


def _coordinates_in_members(shape: np.ndarray, members: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates (n_member, n_pole) of shapes in the members' space, and the members' own (n_member, n_member)."""
    basis, triangle = np.linalg.qr(members)
    return basis.T @ shape, triangle


def _squared_cosines(shape: np.ndarray, members: np.ndarray) -> np.ndarray:
    """(n_pole, n_member) squared cosine of each shape with each member, within the members' space."""
    return mac(*_coordinates_in_members(shape, members))


def choose(block: JudgedPoles, centre_hz: np.ndarray, settings: ClassifierSettings) -> Choice:
    """Harmonics and strays removed, then one pole a mode: at each model order the best, of the orders the most
    central one. centre_hz (n_mode,), NaN for a mode without a path."""
    poles, like, reference = block.poles, block.comparison, block.reference
    criterion, n_mode = block.verdict.copy(), len(reference.labels)
    chosen, share = np.full(n_mode, -1), np.zeros(n_mode)
    independence = np.full(len(reference.groups), np.nan)
    swept, score = rules.is_within(poles.frequency_hz, block.bands), like.score(poles.damping_ratio)
    criterion[swept & (block.verdict == rules.FREQUENCY)] = rules.HARMONIC
    weak = ~rules.is_trusted(like, reference, settings)
    orders = poles.orders
    for g, group in enumerate(reference.groups):
        mine = np.flatnonzero((block.verdict == rules.KEPT) & (like.group == g))
        if not len(mine):
            continue
        apart = np.abs(np.log(poles.frequency_hz[mine, None] / centre_hz[list(group)]))
        stray = ~np.any(apart <= settings.cluster, axis=1)
        line = np.all(apart > settings.harmonic_window, axis=1)
        line |= poles.damping_ratio[mine] < settings.harmonic_damping
        criterion[mine[stray]] = np.where(weak[mine[stray]], rules.SHAPE, rules.CLUSTER)
        criterion[mine[swept[mine] & (stray | line)]] = rules.HARMONIC
        left = mine[criterion[mine] == rules.KEPT]
        inside, triangle = _coordinates_in_members(poles.shape[:, left], reference.shape[:, list(group)])
        away = np.log(poles.frequency_hz[left, None] / centre_hz[list(group)])
        near = np.nan_to_num(np.exp(-0.5 * (away / NEARNESS) ** 2))
        fit = (mac(inside, triangle) if len(group) > 1 else 1.0) * near
        taken = {}
        for n in np.unique(poles.order[left]):
            here = poles.order[left] == n
            taken[n] = _assign_poles(left[here], score[left[here]], inside[:, here], near[here], fit[here], settings)
        best, found = _central({n: t for n, (t, _) in taken.items()}, poles, len(group))
        share[list(group)] = found / len(orders)
        kept_poles = {pole for t, _ in taken.values() for pole in t.values()}
        criterion[[p for p in left if p not in kept_poles]] = rules.DUPLICATE
        scarce = np.max(found, initial=0) / len(orders) < settings.least_share
        criterion[list(kept_poles)] = rules.UNSTABLE if scarce else rules.OTHER_ORDER
        if best is None or scarce:
            continue
        members, independence[g] = taken[best]
        for member, pole in members.items():
            chosen[group[member]], criterion[pole] = pole, rules.KEPT
    return Choice(criterion=criterion, pole=frozen_array(chosen, int), share=frozen_array(share),
                  independence=frozen_array(independence))


def _central(taken: dict[int, dict[int, int]], poles: PoleStack, n_member: int) -> tuple[int | None, np.ndarray]:
    """The order whose poles lie nearest to the orders' medians, and (n_member,) in how many orders each is found.

    Distances are |ln f - median| + |zeta - median|, of about equal scatter; of orders with unequal numbers of
    members, those with the number that most have."""
    value = np.full((len(taken), n_member, 2), np.nan)
    for k, members in enumerate(taken.values()):
        for member, pole in members.items():
            value[k, member] = np.log(poles.frequency_hz[pole]), poles.damping_ratio[pole]
    there = np.isfinite(value[:, :, 0])
    found = there.sum(axis=0)
    if not found.any():
        return None, found
    # members that at least half of the orders with any have
    wanted = found >= 0.5 * there.any(axis=1).sum()
    complete = np.flatnonzero(there[:, wanted].all(axis=1))
    if not len(complete):
        # as often one member as the other, never both together: one of them
        wanted = np.arange(n_member) == np.argmax(found)
        complete = np.flatnonzero(there[:, wanted].all(axis=1))
    some = value[complete][:, wanted]
    distance = np.sum(np.abs(some - np.median(some, axis=0)), axis=(1, 2))
    return list(taken)[int(complete[np.argmin(distance)])], found


def _assign_poles(left, score, inside, near, fit, settings: ClassifierSettings) -> tuple[dict[int, int], float]:
    """Member of the group -> pole, from the poles `left` (indices) of one order; and a pair's independence.

    A single mode takes the best score near its path; a pair the two with the largest product of scores and
    independence, named by their direction in the plane of the model's pair and, where their paths part, by these.
    inside (n_member, n_left): shapes in the members' space; near, fit (n_left, n_member): closeness to the members'
    paths, and that times the squared cosine with each.
    """
    strength = score * near.max(axis=1)
    if len(inside) == 1:
        return {0: int(left[np.argmax(strength)])}, np.nan
    apart = 1 - mac(inside, inside)
    together = np.outer(strength, strength) * np.where(apart >= settings.least_independence, apart, 0)
    if not np.any(together > 0):
        best = int(np.argmax(strength))
        return {int(np.argmax(fit[best])): int(left[best])}, np.nan
    two = np.array(np.unravel_index(np.argmax(together), together.shape))
    return {member: int(left[two[k]]) for k, member in pair_by_mac(fit[two])}, float(apart[two[0], two[1]])
