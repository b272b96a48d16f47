"""Parameters that may be exchanged without a change of any response: maxima that a posterior has by construction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from probupdate.updating.importance import WeightedDraws
from probupdate.updating.problem import Problem

# responses that change by less, in standard deviations, are the same
SWAPPED = 1e-4
# pairs of exchanges that are tried at once, and orders of parameters that are counted, at most
MOST_EXCHANGES, MOST_ORDERS = 2000, 50_000
# orders compared with the draws at once, and by what share parameters that are alike are set apart, in prior std
AT_ONCE, APART = 500, 1e-6
# share of the orders that draws fall on from which none of them is missed
ALL = 0.9

Exchange = tuple[tuple[str, str], ...]


def exchangeable(problem: Problem, theta: np.ndarray) -> list[Exchange]:
    """Exchanges of parameters with the same prior that leave all responses as they are, at theta (n_param,): of two
    parameters, or of two pairs at once, as of substructures that are built alike."""
    parameters = problem.parameters
    if parameters.correlation is not None:
        return []
    # no two parameters at one value, at a bound neither
    step = 0.1 * parameters.std * np.arange(1, len(theta) + 1) / len(theta)
    at = np.maximum(np.where(theta + step > parameters.upper, theta - step, theta + step), parameters.lower)
    names, items = parameters.names, parameters.items
    pairs = [(i, j) for i, j in combinations(range(len(names)), 2)
             if replace(items[i], name=names[j], description=items[j].description) == items[j]]

    def unchanged(exchanges: list[tuple[tuple[int, int], ...]]) -> list[tuple[tuple[int, int], ...]]:
        if not exchanges:
            return []
        swapped = np.tile(at, (len(exchanges), 1))
        for row, exchange in zip(swapped, exchanges, strict=True):
            for i, j in exchange:
                row[[i, j]] = at[[j, i]]
        off = problem.weighted(problem.predict_many(swapped).response - problem.predict(at))
        return [one for one, apart in zip(exchanges, off, strict=True) if np.all(np.abs(apart) < SWAPPED)]

    single = unchanged([(pair,) for pair in pairs])
    left = [pair for pair in pairs if (pair,) not in single]
    both = [(a, b) for a, b in combinations(left, 2) if not {*a} & {*b}]
    found = [*single, *unchanged(both[:MOST_EXCHANGES])]
    return [tuple((names[i], names[j]) for i, j in one) for one in found]


def _groups_words(exchanges: Sequence[Exchange]) -> str:
    """Parameters that any exchange of two reaches side by side, then pairs that go together."""
    groups: list[set[str]] = []
    for pair in (one[0] for one in exchanges if len(one) == 1):
        reached = [g for g in groups if g & {*pair}]
        groups = [g for g in groups if not g & {*pair}] + [{*pair}.union(*reached)]
    together = [", ".join(f"{a} with {b}" for a, b in one) + " at once" for one in exchanges if len(one) > 1]
    return " and ".join([*(" = ".join(sorted(group)) for group in groups), *together])


def orders(exchanges: Sequence[Exchange], names: Sequence[str]) -> list[tuple[str, ...]]:
    """The orders of the parameters that these exchanges lead to, one after another, the given one first; no more than
    about MOST_ORDERS."""
    found = {tuple(names): None}
    fresh = list(found)
    while fresh and len(found) < MOST_ORDERS:
        order = fresh.pop()
        for exchange in exchanges:
            swap = dict(exchange) | {b: a for a, b in exchange}
            moved = tuple(swap.get(name, name) for name in order)
            if moved not in found:
                found[moved] = None
                fresh.append(moved)
    return list(found)


def orders_drawn(
    problem: Problem, theta: np.ndarray, weighted: WeightedDraws, every: Sequence[tuple[str, ...]]
) -> float:
    """On how many of the orders the draws fall, each counted by its share: each draw belongs to the order whose image
    of theta (n_param,) is nearest. Two draws meet in one order as often as there are few (Simpson's index without the
    pairs of a draw with itself)."""
    parameters = problem.parameters
    z = (weighted.theta - parameters.initial) / parameters.std
    at = (theta - parameters.initial) / parameters.std + APART * np.arange(len(theta))
    number = {name: k for k, name in enumerate(parameters.names)}
    best, nearest = np.full(len(z), -np.inf), np.zeros(len(z), int)
    for start in range(0, len(every), AT_ONCE):
        images = np.array([[at[number[name]] for name in order] for order in every[start : start + AT_ONCE]])
        near = z @ images.T
        own = np.argmax(near, axis=1)
        value = near[np.arange(len(z)), own]
        nearest, best = np.where(value > best, start + own, nearest), np.maximum(best, value)
    share, alone = np.bincount(nearest, weights=weighted.weight), np.sum(weighted.weight**2)
    return float((1 - alone) / max(np.sum(share**2) - alone, 1 / len(every) ** 2))


def exchange_words(problem: Problem, theta: np.ndarray, weighted: WeightedDraws) -> str:
    """Which parameters may be exchanged at the maximum theta (n_param,), and how much ln evidence lacks of what that
    makes; nothing where none may."""
    alike = exchangeable(problem, theta)
    if not alike:
        return ""
    every = orders(alike, problem.parameters.names)
    drawn = orders_drawn(problem, theta, weighted, every)
    text = (f"; {_groups_words(alike)} may be exchanged without a change of any response: {len(every)} orders by "
            "construction, and draws fall on ")
    if drawn > ALL * len(every):
        return f"{text}all of them, so that ln evidence lacks none"
    return f"{text}about {drawn:.0f} of them: ln evidence lacks {np.log(len(every) / max(drawn, 1.0)):.2f}"
