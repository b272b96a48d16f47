"""Scalar functions of the parameters that belong to one place: water and growth, joints, springs of a pile, hinges.

Each is a picklable callable of the parameters by name, values (...), real or complex, and knows the `names` it reads.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probupdate.structure import hydrodynamics, joints, soil
from probupdate.structure.beam import Tube
from probupdate.structure.coefficient import Coefficient, Factor, Values


def total(names: tuple[str, ...], values: Values):
    """The sum of the parameters `names`."""
    return sum((values[name] for name in names), 0.0)


@dataclass(frozen=True, kw_only=True)
class Water:
    """A mass per metre of what surrounds or fills a tube; see hydrodynamics. `growth`: whose sum is its thickness."""

    kind: str
    tube: Tube
    density_kgpm3: float
    coefficient: float = 1.0
    growth: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        return (*self.tube.names, *self.growth)

    def __call__(self, values: Values):
        if self.kind == "flooding":
            return hydrodynamics.flooding_mass(self.tube.inner(values), self.density_kgpm3)
        outer, growth = self.tube.outer(values), total(self.growth, values)
        if self.kind == "growth":
            return hydrodynamics.growth_mass(outer, growth, self.density_kgpm3)
        return hydrodynamics.added_mass(outer, growth, self.coefficient, self.density_kgpm3)

    def coefficient_of(self) -> Coefficient:
        return Coefficient(1.0, (Factor(key=("water", self), names=self.names, function=self),))


@dataclass(frozen=True, kw_only=True)
class Wetting:
    """(..., 7): int xi^m dx over the part of a beam below the water, m = 0..6, xi from the beam's start.

    The water stands at still_m plus the sum of the parameters `rise`; start_m and end_m are levels.
    """

    start_m: float
    end_m: float
    length_m: float
    still_m: float
    rise: tuple[str, ...]

    def __call__(self, values: Values):
        level = self.still_m + np.asarray(total(self.rise, values))
        low, high = sorted((self.start_m, self.end_m))
        # a level on a node belongs to the element above it alone, so that its derivative is counted once
        wet = soil.clip_real((level - low) / (high - low), 0.0, 1.0)[..., None]
        order = np.arange(1, 8)
        if self.start_m < self.end_m:
            return self.length_m * wet**order / order
        return self.length_m * (1 - (1 - wet) ** order) / order

    def moments(self) -> list[Coefficient]:
        return [Coefficient(1.0, (Factor(key=("wetting", self), names=self.rise, function=self, component=m),))
                for m in range(7)]


@dataclass(frozen=True, kw_only=True)
class JointStiffness:
    """(..., 3) stiffness over E of one brace end."""

    law: joints.JointLaw
    chord: Tube
    brace: Tube
    angle_rad: float

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(sorted({*self.chord.names, *self.brace.names}))

    def __call__(self, values: Values):
        chord_diameter, chord_wall = self.chord.outer(values), self.chord.wall(values)
        return 1.0 / self.law(chord_diameter, chord_wall, self.brace.outer(values), self.angle_rad)

    def coefficients(self) -> list[Coefficient]:
        return [Coefficient(1.0, (Factor(key=("joint", self), names=self.names, function=self, component=k),))
                for k in range(3)]


@dataclass(frozen=True, kw_only=True, eq=False)
class PileMoments:
    """Soil or exposure moments of all elements of a pile, flattened to (..., n_element * n_moment), in a seabed that
    the sum of `scour` has lowered."""

    springs: soil.PileSprings
    kind: str
    scour: tuple[str, ...] = ("sc",)

    def __call__(self, values: Values):
        moments = getattr(self.springs, self.kind)(np.asarray(total(self.scour, values)))
        return moments.reshape(*moments.shape[:-2], moments.shape[-2] * moments.shape[-1])

    def coefficients(self, n_element: int, n_order: int) -> list[list[Coefficient]]:
        """By element and order."""
        factor = {"key": ("pile", self.kind, self.scour), "names": self.scour, "function": self}
        return [[Coefficient(1.0, (Factor(**factor, component=n_order * k + m),)) for m in range(n_order)]
                for k in range(n_element)]


@dataclass(frozen=True, kw_only=True)
class Warmth:
    """1 + sum of relative changes per degree times temperatures; entries (name, change per degree)."""

    entries: tuple[tuple[str, float], ...]

    def __call__(self, values: Values):
        return 1.0 + sum(change * values[name] for name, change in self.entries)

    def coefficient_of(self) -> Coefficient:
        names = tuple(name for name, _ in self.entries)
        return Coefficient(1.0, (Factor(key=("warmth", self), names=names, function=self),))
