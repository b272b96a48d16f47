"""Scalar functions of the parameters that stand before the constant matrices of K and M."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

Values = Mapping[str, float | np.ndarray]

# of each function the values at the last few points are kept: a fit moves few parameters at a time, and what depends on
# the others is the same; of many points at once those are found that differ in what a function reads, from so many on
N_KEPT, MANY_POINTS = 6, 8


@dataclass(frozen=True, kw_only=True, eq=False)
class Factor:
    """One scalar function of the parameters `names`.

    `function` maps {name: value (...)} to (...), or to (..., n) of which `component` is taken; factors with the
    same `key` share one evaluation of it. It must hold for complex values (its derivatives are complex steps).
    """

    key: tuple
    names: tuple[str, ...]
    function: Callable[[Values], float | np.ndarray]
    component: int | None = None

    def component_value(self, evaluated: float | np.ndarray) -> float | np.ndarray:
        return evaluated if self.component is None else np.asarray(evaluated)[..., self.component]


@dataclass(frozen=True, eq=False)
class Coefficient:
    """scale times the product of factors."""

    scale: float = 1.0
    factors: tuple[Factor, ...] = ()

    def __mul__(self, other: Coefficient | float) -> Coefficient:
        if isinstance(other, Coefficient):
            return Coefficient(self.scale * other.scale, self.factors + other.factors)
        return Coefficient(self.scale * other, self.factors)

    def value(self, values: Values) -> float | np.ndarray:
        product = self.scale
        for factor in self.factors:
            product = product * factor.component_value(factor.function(values))
        return product


def _pick(name: str, values: Values):
    return values[name]


def _invert(name: str, values: Values):
    return 1.0 / values[name]


@dataclass(frozen=True)
class _OfParameter:
    """A picklable function of one parameter."""

    rule: Callable
    name: str

    def __call__(self, values: Values):
        return self.rule(self.name, values)


def parameter(name: str) -> Coefficient:
    """The parameter itself."""
    return Coefficient(1.0, (Factor(key=("value", name), names=(name,), function=_OfParameter(_pick, name)),))


def inverse(name: str) -> Coefficient:
    """One over the parameter: a factor on the displacement axis of a curve divides its stiffness."""
    return Coefficient(1.0, (Factor(key=("inverse", name), names=(name,), function=_OfParameter(_invert, name)),))


def product(names: Iterable[str]) -> Coefficient:
    """The parameters multiplied."""
    result = Coefficient()
    for name in names:
        result = result * parameter(name)
    return result


@dataclass(frozen=True, eq=False, kw_only=True)
class Coefficients:
    """theta (..., n_param) -> stiffness coefficients (..., n_K) and mass coefficients (..., n_M).

    `names` are the updated parameters in theta's order, `fixed` the values of the others; `tables` the distinct
    functions with the names that each `reads`, and each term a product of (table, component) pairs.
    """

    names: tuple[str, ...]
    fixed: Mapping[str, float]
    tables: tuple[Callable[[Values], float | np.ndarray], ...]
    reads: tuple[tuple[str, ...], ...]
    stiffness_terms: tuple[tuple[tuple[int, int | None], ...], ...]
    mass_terms: tuple[tuple[tuple[int, int | None], ...], ...]

    @cached_property
    def _plan(self) -> tuple[list[tuple[int, list[int] | None]], list[list[np.ndarray]]]:
        """Which components of which table are needed, in the order in which they are put side by side (a one behind
        them); and of stiffness and mass per factor where it stands for every term."""
        both = (self.stiffness_terms, self.mass_terms)
        needed: dict[int, set] = {}
        for table, component in (pair for terms in both for term in terms for pair in term):
            needed.setdefault(table, set()).add(component)
        columns, place = [], {}
        for table, components in needed.items():
            ordered = None if components == {None} else sorted(components)
            columns.append((table, ordered))
            for component in ordered or [None]:
                place[table, component] = len(place)
        factors = []
        for terms in both:
            depth = max(map(len, terms), default=0)
            padded = [[place[pair] for pair in term] + [len(place)] * (depth - len(term)) for term in terms]
            factors.append(list(np.array(padded, int).reshape(len(terms), depth).T))
        return columns, factors

    def __call__(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        theta = np.asarray(theta)
        values = dict(self.fixed) | {name: theta[..., k] for k, name in enumerate(self.names)}
        columns, factors = self._plan
        lead = theta.shape[:-1]
        used = [np.ones((*lead, 0), dtype=np.result_type(theta.dtype, float))]
        for table, components in columns:
            found = self._value(table, theta, values)
            found = found[..., None] if components is None else found[..., components]
            used.append(np.broadcast_to(found, (*lead, found.shape[-1])))
        side_by_side = np.concatenate([*used, np.ones((*lead, 1))], axis=-1)

        def weights(terms, places):
            result = np.ones((*lead, len(terms)), dtype=side_by_side.dtype)
            for place in places:
                result *= side_by_side[..., place]
            return result

        return weights(self.stiffness_terms, factors[0]), weights(self.mass_terms, factors[1])

    @cached_property
    def _columns(self) -> list[np.ndarray]:
        """Of every table the places in theta of what it reads."""
        place = {name: k for k, name in enumerate(self.names)}
        return [np.array([place[name] for name in own if name in place], int) for own in self.reads]

    @cached_property
    def _cache(self) -> list[dict[bytes, tuple[np.ndarray, np.ndarray | None]]]:
        return [{} for _ in self.tables]

    def __getstate__(self) -> dict[str, object]:
        # other processes begin afresh
        return {name: value for name, value in vars(self).items() if name != "_cache"}

    def _value(self, number: int, theta: np.ndarray, values: Values) -> np.ndarray:
        """What a table is at theta (..., n_param)."""
        table, columns = self.tables[number], self._columns[number]
        if isinstance(table, _OfParameter) and table.rule is _pick and len(columns):
            return theta[..., columns[0]]
        if not (theta.ndim == 1 or (theta.ndim == 2 and len(theta) >= MANY_POINTS)):
            return np.asarray(table(values))
        own, kept = theta[..., columns], self._cache[number]
        key = own.tobytes()
        if key not in kept:
            if len(kept) >= N_KEPT:
                kept.pop(next(iter(kept)))
            kept[key] = self._evaluate_table(number, own, values)
        found, place = kept[key]
        return found if place is None else found[place]

    def _evaluate_table(self, number: int, own: np.ndarray, values: Values) -> tuple[np.ndarray, np.ndarray | None]:
        """A table at points `own` of what it reads, and where each point's value stands in it, unless as they come: in
        the steps of derivatives, one parameter at a time, most points have the same values of the others."""
        for usual in (0, -1) if own.ndim == 2 else ():
            other = np.flatnonzero((own != own[usual]).any(axis=1))
            if 4 * len(other) < len(own):
                place = np.zeros(len(own), int)
                place[other] = 1 + np.arange(len(other))
                few = own[np.concatenate([[usual % len(own)], other])]
                names = [self.names[k] for k in self._columns[number]]
                return np.asarray(self.tables[number](dict(values) | dict(zip(names, few.T, strict=True)))), place
        return np.asarray(self.tables[number](values)), None


class TermCollector:
    """Sums contributions by what of their coefficient varies: constants go into the number, equal products merge."""

    def __init__(self, updated: tuple[str, ...], initial: Mapping[str, float]):
        self.updated, self.initial = frozenset(updated), initial
        self._frozen: dict[tuple, float | np.ndarray] = {}
        self.keys: dict[tuple, list] = {}
        self.factors: dict[tuple, Factor] = {}

    def split(self, coefficient: Coefficient) -> tuple[float, tuple]:
        """The constant part and the identity of the varying part."""
        number, varying = coefficient.scale, []
        for factor in coefficient.factors:
            if self.updated.intersection(factor.names):
                self.factors.setdefault(factor.key, factor)
                varying.append((factor.key, factor.component))
                continue
            if factor.key not in self._frozen:
                self._frozen[factor.key] = factor.function(self.initial)
            number *= float(factor.component_value(self._frozen[factor.key]))
        return number, tuple(sorted(varying, key=repr))

    def add(self, coefficient: Coefficient, payload: Callable[[float], object]) -> None:
        number, key = self.split(coefficient)
        if number != 0.0:
            self.keys.setdefault(key, []).append(payload(number))


def build_coefficients(
    stiffness: TermCollector, mass: TermCollector, names: tuple[str, ...], fixed: Mapping[str, float]
) -> Coefficients:
    """The callable for the terms that two collectors hold, in their order."""
    factors = stiffness.factors | mass.factors
    number = {key: k for k, key in enumerate(factors)}

    def terms(collector):
        return tuple(tuple((number[key], component) for key, component in term) for term in collector.keys)

    return Coefficients(
        names=names,
        fixed=dict(fixed),
        tables=tuple(factor.function for factor in factors.values()),
        reads=tuple(factor.names for factor in factors.values()),
        stiffness_terms=terms(stiffness),
        mass_terms=terms(mass),
    )
