"""Other models of the same structure as directions of the model's error.

What a theory leaves out acts much like a parameter: flexible joints like softer beams, shear like softer members,
weight like softer columns. Such an error has one sign, is taken in by the parameters and leaves no misfit that could
show it (Brynjarsdottir & O'Hagan 2014). Its prior is physics: the same structure by the other theory is solved at the
same parameters, and the difference is the direction along which the truth may lie, marginalised like every tolerance
(Kaipio & Somersalo 2005).
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from probupdate.errors import InputError
from probupdate.modal.matching import assign, channel_rows, close_clusters, with_stated_gravity
from probupdate.model.interface import ModalSolution, Model
from probupdate.model.uncertainty import ErrorSource, ModelUncertainty
from probupdate.runtime.arrays import frozen_array

# where the truth lies from the model (0) to the alternative (1): between them, or half as far beyond either
MEAN, STD = 0.5, 0.5
# modes beyond those asked for among which an alternative's are looked for, and the least MAC with the model's
BEYOND, LEAST_MAC = 6, 0.5


@dataclass(frozen=True, eq=False, kw_only=True)
class AlternativeModels:
    """Alternatives by name to `model`, with what else is not known of it. Parameters that an alternative has too are
    taken at the model's values, its others at their initial ones."""

    model: Model
    others: tuple[tuple[str, Model], ...]
    known: ModelUncertainty | None = None

    @cached_property
    def sources(self) -> tuple[ErrorSource, ...]:
        own = () if self.known is None else self.known.sources
        return (*own, *(ErrorSource(
            name=f"alternative: {name}", group="theory", description=f"what {name} has and this model has not",
            unit="-", std=STD, mean=MEAN, check=f"update {name} instead, or measure what distinguishes them")
            for name, _ in self.others))

    def changes(self, theta: np.ndarray, n_mode: int, clusters: tuple[tuple[int, ...], ...]) -> ModalSolution:
        if self.known is None:
            solution = self.model.solve(theta, n_mode)
            n_channel = len(solution.shape)
            before = np.zeros((n_mode, 0)), np.zeros((n_channel, n_mode, 0))
        else:
            solution = self.known.changes(theta, n_mode, clusters)
            before = solution.both_derivatives
        found = [self._difference(solution, name, other, theta) for name, other in self.others]
        return replace(
            solution, frequency_derivative=frozen_array(np.column_stack([before[0], *(f for f, _ in found)])),
            shape_derivative=frozen_array(np.concatenate([before[1], *(s[:, :, None] for _, s in found)], axis=2)))

    def _difference(self, own: ModalSolution, name: str, other: Model, theta: np.ndarray):
        """Alternative less model: frequency_hz (n_mode,) and shape (n_channel, n_mode), in the model's scale, close
        modes turned to the model's."""
        at = dict(zip(self.model.parameters.names, theta, strict=True))
        place = np.array([at.get(p.name, p.initial) for p in other.parameters])
        n_mode = own.frequency_hz.size
        solution = other.solve(place, min(n_mode + BEYOND, other.n_available))
        shape = solution.shape[channel_rows(other, self.model.channels)]
        overlap = (own.shape.T @ shape) ** 2
        mac = overlap / np.outer(np.sum(own.shape**2, axis=0), np.sum(shape**2, axis=0))
        clusters = close_clusters(own.frequency_hz)
        for cluster in clusters:
            # members of a plane are turned into each other by anything
            mac[list(cluster)] = np.minimum(mac[list(cluster)].sum(axis=0), 1.0)
        paired = assign(mac)
        least = np.min(mac[np.arange(n_mode), paired])
        if least < LEAST_MAC:
            worst = int(np.argmin(mac[np.arange(n_mode), paired]))
            raise InputError(f"alternative {name}", f"has no mode like the model's mode {worst + 1} at "
                             f"{own.frequency_hz[worst]:.3g} Hz (MAC {least:.2f})",
                             "give another model of the same structure, with the same channels and units")
        f, moved = np.empty(n_mode), np.empty(own.shape.shape)
        for cluster in clusters:
            members, partners = list(cluster), np.sort(paired[list(cluster)])
            f[members] = solution.frequency_hz[partners]
            turn = np.linalg.lstsq(shape[:, partners], own.shape[:, members], rcond=None)[0]
            moved[:, members] = shape[:, partners] @ turn
        return f - own.frequency_hz, moved - own.shape

    def with_gravity(self, felt: Mapping[str, bool]) -> AlternativeModels:
        known = None if self.known is None else self.known.with_gravity(felt)
        return replace(self, model=with_stated_gravity(self.model, felt), known=known,
                       others=tuple((name, with_stated_gravity(other, felt)) for name, other in self.others))

    def fingerprint(self) -> str:
        parts = ["" if self.known is None else self.known.fingerprint(), *(o.fingerprint() for _, o in self.others)]
        return hashlib.sha256("|".join(parts).encode()).hexdigest()
