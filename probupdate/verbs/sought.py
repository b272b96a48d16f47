"""The modes of a model that identification names: the global ones, as the sensors see them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import TYPE_CHECKING

import numpy as np

from probupdate.errors import InputError
from probupdate.identification.counterparts import further_modes
from probupdate.identification.criteria import SelectionCriteria
from probupdate.identification.reference import ReferenceModes
from probupdate.modal.labels import (
    FAMILY,
    TURBINE,
    close_pairs,
    family,
    hardly_seen,
    indistinguishable,
    sensed_character,
)
from probupdate.modal.modes import ModeRecord, Sensor, mac
from probupdate.structure.mode_labels import full_model, mode_labels

if TYPE_CHECKING:
    from probupdate.model.interface import ModalSolution, Model

# global modes looked for, (family, number): first and second bending pairs and the torsion between them (the paper's
# first five: FA1, SS1, T1, FA2, SS2), and of what spans the motion along it
MODES_OF_INTEREST = ((0, 1), (1, 1), (2, 1), (0, 2), (1, 2), (3, 1))
# computed modes searched for them
SEARCH = 24
# least motion of the sensors, beside the largest of a family of modes, of one that is the structure's and no member's
LOCAL = 0.03


@dataclass(frozen=True, eq=False, kw_only=True)
class SoughtModes:
    """The modes that identification looks for (None: without a model), the others that were computed to find them
    (None: no other moves the sensors), and what is to be said of what the sensors see. computed_hz: frequencies of all
    that were computed; None of a turbine, of which the bending pairs and the torsion are enough."""

    modes: ReferenceModes | None
    others: ReferenceModes | None
    notes: tuple[str, ...] = ()
    computed_hz: np.ndarray | None = None

    def lowest_note(self, records: Sequence[ModeRecord]) -> list[str]:
        """How many of the lowest modes to look for, where most blocks show all so many and some were not asked for."""
        further = [one.model_frequency_hz for one in further_modes(records)]
        if self.modes is None or self.computed_hz is None or not further:
            return []
        share = SelectionCriteria().required_share
        shown = {one.model_frequency_hz for one in records if one.match == "alike" and one.found >= share * one.blocks}
        model = self.modes if self.others is None else self.modes.join(self.others)
        ascending = sorted(zip(model.frequency_hz, model.labels, strict=True))
        lowest = list(takewhile(lambda mode: mode[0] in shown, ascending))
        if not lowest or lowest[-1][0] < min(further):
            return []
        highest, label = lowest[-1]
        return [f"`--lowest {np.sum(self.computed_hz <= highest)}` looks for all of the model's modes up to {label} at "
                f"{highest:.4g} Hz, which most blocks show"]


def reference_modes(
    model: Model, sensors: tuple[Sensor, ...], lowest: int | None = None, families: tuple[str, ...] = TURBINE
) -> SoughtModes:
    """The model's first and second bending modes and its torsion, as seen by the sensors; or its `lowest` modes,
    whatever they are. Raises InputError where the model has fewer than `lowest`, or no global mode at the sensors."""
    if lowest is not None and lowest > model.n_available:
        raise InputError(model.name, f"{lowest} modes are to be looked for (--lowest), it has {model.n_available}",
                         f"ask for at most {model.n_available}")
    solution = model.solve(model.parameters.initial, min(max(SEARCH, lowest or 0), model.n_available))
    rows = [model.channels.index(s.channel) for s in sensors]
    shape = solution.shape[rows]
    labels = global_labels(model, solution, sensors, families)
    hidden = hardly_seen(shape)
    place = {(FAMILY.get(family(x)), x.removeprefix(family(x))): j for j, x in enumerate(labels)}
    wanted = [place[k, str(number)] for k, number in MODES_OF_INTEREST if (k, str(number)) in place]
    if lowest is not None:
        wanted = list(range(min(lowest, len(solution.frequency_hz))))
    chosen = [j for j in wanted if not hidden[j]]
    if not chosen:
        raise InputError(
            f"{model.name}", f"none of its lowest {SEARCH} modes is a global one at the campaign's sensors "
            f"({', '.join(labels)})", "check the sensors' positions and directions, or name how many of the "
            "lowest modes to look for (--lowest)",
        )
    rest = [i for i in range(len(solution.frequency_hz)) if i not in chosen and not hidden[i]]
    return SoughtModes(
        modes=_reference_modes(solution.frequency_hz, shape, labels, chosen),
        others=_reference_modes(solution.frequency_hz, shape, labels, rest) if rest else None,
        computed_hz=None if families == TURBINE else solution.frequency_hz,
        notes=indistinguishable(tuple(labels[j] for j in wanted), solution.frequency_hz[wanted], shape[:, wanted]),
    )


def global_labels(
    model: Model, solution: ModalSolution, sensors: tuple[Sensor, ...], families: tuple[str, ...] = TURBINE
) -> tuple[str, ...]:
    """Names of a model's modes: by where their energy is, or, where its nodes are not known, as the sensors see them
    (`sensed_labels`)."""
    if full_model(model) is not None:
        return mode_labels(model, solution, families=families)
    rows = [model.channels.index(s.channel) for s in sensors]
    return sensed_labels(solution.frequency_hz, solution.shape[rows], sensors, families)


def sensed_labels(
    frequency_hz: np.ndarray, shape: np.ndarray, sensors: tuple[Sensor, ...], families: tuple[str, ...] = TURBINE
) -> tuple[str, ...]:
    """Names of unit-mass shapes (n_channel, n_mode) at the sensors. A member's own mode drags the level along a little
    and would pass for a bending mode: one that moves the sensors by less than LOCAL of what the largest of its family
    does, or that has the shape of a larger one within 2 % of its frequency, is local."""
    size = np.linalg.norm(shape, axis=0)
    first = sensed_character(frequency_hz, shape, sensors, families).labels
    kind = np.array([family(label) for label in first])
    largest = {name: size[kind == name].max() for name in set(kind)}
    seen = np.array([size[k] > LOCAL * largest[name] for k, name in enumerate(kind)])
    near = np.abs(np.log(frequency_hz / frequency_hz[:, None])) < 0.02
    shadowed = near & (mac(shape, shape) > 0.95) & (size > size[:, None])
    own = np.flatnonzero(seen & ~shadowed.any(axis=1))
    again = sensed_character(frequency_hz[own], shape[:, own], sensors, families).labels
    names = dict(zip(map(int, own), again, strict=True))
    last = sum(name.startswith("L") for name in names.values())
    for k in range(len(first)):
        if k not in names:
            last += 1
            names[k] = f"L{last}"
    return tuple(names[k] for k in range(len(first)))


def _reference_modes(
    frequency_hz: np.ndarray, shape: np.ndarray, labels: tuple[str, ...], chosen: list[int]
) -> ReferenceModes:
    names = tuple(labels[i] for i in chosen)
    return ReferenceModes(labels=names, frequency_hz=frequency_hz[chosen], shape=shape[:, chosen],
                          pairs=close_pairs(frequency_hz[chosen], names))
