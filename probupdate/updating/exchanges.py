"""Parameters that may be exchanged without a change of any response: maxima that a posterior has by construction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from probupdate.runtime.arrays import frozen_array
from probupdate.updating.images import Images
from probupdate.updating.laplace import Laplace, is_same_maximum
from probupdate.updating.problem import Problem

# responses that change by less, in standard deviations, are the same
SWAPPED = 1e-4
# pairs of exchanges that are tried at once, and orders of parameters that are counted, at most
MOST_EXCHANGES, MOST_ORDERS = 2000, 50_000

Exchange = tuple[tuple[str, str], ...]


def exchangeable(problem: Problem, theta: np.ndarray) -> list[Exchange]:
    """Exchanges of parameters with the same prior, correlation included, that leave all responses as they are, at theta
    (n_param,): of two parameters, or of two pairs at once, as of substructures that are built alike."""
    parameters = problem.parameters
    correlation = np.eye(len(parameters)) if parameters.correlation is None else parameters.correlation
    # no two parameters at one value, at a bound neither
    step = 0.1 * parameters.std * np.arange(1, len(theta) + 1) / len(theta)
    at = np.maximum(np.where(theta + step > parameters.upper, theta - step, theta + step), parameters.lower)
    names, items = parameters.names, parameters.items
    pairs = [(i, j) for i, j in combinations(range(len(names)), 2)
             if replace(items[i], name=names[j], description=items[j].description) == items[j]]

    def unchanged(exchanges: list[tuple[tuple[int, int], ...]]) -> list[tuple[tuple[int, int], ...]]:
        order = np.tile(np.arange(len(at)), (len(exchanges), 1))
        for row, exchange in zip(order, exchanges, strict=True):
            for i, j in exchange:
                row[[i, j]] = j, i
        alike = [k for k, row in enumerate(order) if np.allclose(correlation[np.ix_(row, row)], correlation)]
        exchanges, order = [exchanges[k] for k in alike], order[alike]
        if not exchanges:
            return []
        off = problem.whiten(problem.predict_many(at[order]).response - problem.predict(at))
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


def images_about(problem: Problem, laplace: Laplace) -> tuple[Images | None, str]:
    """Images by exchanges that lead from the maximum to another, and a sentence on them; None where there are none, or
    too many to follow."""
    alike = exchangeable(problem, laplace.theta)
    parameters = problem.parameters
    if not alike:
        return None, ""
    text = f"{_groups_words(alike)} may be exchanged without a change of any response: "
    number = {name: k for k, name in enumerate(parameters.names)}

    def numbers(exchanges: Sequence[Exchange]) -> np.ndarray:
        return np.array([[number[name] for name in order] for order in orders(exchanges, parameters.names)])

    every = numbers(alike)
    if len(every) >= MOST_ORDERS:
        return None, f"{text}more than {MOST_ORDERS} orders, and ln evidence counts the maxima that were found"
    # those that are alike at the maximum share it
    same = [one for one in alike if is_same_maximum(laplace.theta[numbers([one])[1]], laplace)]
    at = np.mean(((laplace.theta - parameters.initial) / parameters.std)[numbers(same)], axis=0)
    _, first = np.unique(np.round(at[every], 9), axis=0, return_index=True)
    if len(first) == 1:
        return None, ""
    found = Images(initial=parameters.initial, std=parameters.std, at=frozen_array(at),
                   orders=every[np.sort(first)])
    return found, f"{text}{len(first)} maxima alike, each of them sampled and counted in ln evidence"
