"""Measured damping ratios by the turbine's state: what was measured under operation has the rotor's damping in it, what
was measured idling has not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from probupdate.modal.modes import ModalData

# states of sets, as `identify` derives them from the power, that are of an idling and of an operating turbine
STATES_OF = {"idling": ("idling",), "operating": ("operating", "below rated", "rated")}


@dataclass(frozen=True, eq=False, kw_only=True)
class StateDamping:
    """Measured damping ratios, label of a mode -> ratio, of idling and of operating sets; `rotor`: whether the rotor's
    quasi-steady damping is added to operating states. What was measured under operation has it already."""

    idling: Mapping[str, float]
    operating: Mapping[str, float]
    rotor: bool

    @classmethod
    def alike(cls, ratios: Mapping[str, float]) -> StateDamping:
        """Of sets whose state is not known: those of a structure whose rotor stands still."""
        return cls(idling=ratios, operating=ratios, rotor=True)

    @classmethod
    def mean(cls, several: Sequence[StateDamping]) -> StateDamping:
        """Geometric means over draws."""
        def geometric_means(all_of: Sequence[Mapping[str, float]]) -> dict[str, float]:
            names = dict.fromkeys(n for d in all_of for n in d)
            return {n: float(np.exp(np.mean([np.log(d[n]) for d in all_of if n in d]))) for n in names}

        return cls(idling=geometric_means([d.idling for d in several]),
                   operating=geometric_means([d.operating for d in several]), rotor=several[0].rotor)

    def for_state(self, operating: bool) -> Mapping[str, float]:
        return self.operating if operating else self.idling


@dataclass(frozen=True, eq=False, kw_only=True)
class MeasuredDamping:
    """Of the labels that were measured: a ratio for every draw (n_draw,), the standard error of its logarithm's mean
    and the scatter of the sets' logarithms; `idling` and `operating` the ratios of the sets of those states, None where
    there are none."""

    ratio: dict[str, np.ndarray]
    error: dict[str, float]
    scatter: dict[str, float]
    idling: dict[str, np.ndarray] | None = None
    operating: dict[str, np.ndarray] | None = None

    def for_draws(self, n: int) -> list[StateDamping]:
        """For each of n draws."""
        def of_draw(values: dict[str, np.ndarray] | None, k: int) -> dict[str, float]:
            return {label: float(own[k]) for label, own in (values or {}).items()}

        if self.idling is None and self.operating is None:
            return [StateDamping.alike(of_draw(self.ratio, k)) for k in range(n)]
        result = []
        for k in range(n):
            idling = of_draw(self.idling, k)
            operating = of_draw(self.operating, k) if self.operating else idling
            result.append(StateDamping(idling=idling, operating=operating, rotor=not self.operating))
        return result

    def notes(self, assumed: float) -> list[str]:
        """Where the damping of the fatigue analysis' states comes from, for what is left out."""
        if not self.ratio:
            return [f"measured damping: no mode's was measured; {assumed:g} of fatigue.toml in all states, and the "
                    "rotor's in operating ones"]
        if self.idling is None and self.operating is None:
            return ["damping by state: the sets do not say whether the turbine operated; all states have the damping "
                    "of all sets, operating ones the rotor's quasi-steady damping as well, which may count it twice"]
        found = []
        if self.idling is None:
            found.append(f"damping of idling states: no two sets idle; {assumed:g} of fatigue.toml")
        if self.operating is None:
            found.append("damping of operating states: no two sets operate; that of idling ones with the rotor's "
                         "quasi-steady damping added")
        return found


def measured_ratios(data: ModalData, label: str, states: Sequence[str] | None = None) -> np.ndarray:
    """(n,) damping ratios above zero of a mode in all sets, or in those of these turbine states."""
    sets = [s for s in data.sets if states is None or s.environment.get("state") in states]
    found = np.array([s.damping_ratio[data.labels.index(label)] for s in sets], float)
    return found[np.isfinite(found) & (found > 0)]


def draw_ratios(ratios: np.ndarray, n: int, rng: np.random.Generator) -> np.ndarray:
    """(n,) lognormal about the geometric mean of the ratios, with its standard error."""
    log = np.log(ratios)
    return np.exp(log.mean() + log.std(ddof=1) / np.sqrt(len(log)) * rng.standard_normal(n))


def geometric_means(data: ModalData, states: Sequence[str] | None = None) -> dict[str, float]:
    """Label of a mode -> geometric mean of its damping ratios in at least two sets, all or those of these states."""
    found = {label: measured_ratios(data, label, states) for label in data.labels or ()}
    return {label: float(np.exp(np.mean(np.log(own)))) for label, own in found.items() if len(own) > 1}
