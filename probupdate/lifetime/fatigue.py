"""Damage-equivalent stress ranges and damage of every hot spot at any parameter vector, and their change with it.

All states of sea and wind on all headings are summed by their share of a year; each is stationary and Gaussian, its
ranges are Park's (or Dirlik's, or Tovo and Benasciutti's). DEL_m = (T sum_s p_s nu_s E_s[S^m] / N_ref)^(1/m), T a year.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from probupdate.errors import InputError
from probupdate.lifetime.conditions import Conditions, read_conditions, refuse_other_rotor, thrust_spectra
from probupdate.lifetime.details import Detail, HotSpot, find_details, thickness_effects, weights
from probupdate.lifetime.spectral import ranges
from probupdate.lifetime.stress import Response, StateDamping, StressModel, stress_model
from probupdate.modal.modes import Sensor
from probupdate.model.parameters import Parameters
from probupdate.runtime.arrays import frozen_array
from probupdate.runtime.progress import Progress, silent
from probupdate.structure.description import Description
from probupdate.structure.description_file import read_description
from probupdate.structure.subdyn_model import is_subdyn
from probupdate.structure.turbine_frame import build_frame

YEAR_S = 365.25 * 86400
SLOPES = (3.0, 5.0)
# complex step of moments
STEP = 1e-30


@dataclass(frozen=True, eq=False, kw_only=True)
class FatigueModel:
    """A turbine's stress models, one a heading, with the hot spots of their details."""

    models: tuple[StressModel, ...]
    details: tuple[Detail, ...]
    spots: tuple[HotSpot, ...]
    conditions: Conditions
    method: str = "park"

    @property
    def parameters(self) -> Parameters:
        return self.models[0].parameters

    @cached_property
    def shares(self) -> np.ndarray:
        """(n_heading, n_state)."""
        return np.outer([d.share for d in self.conditions.direction], [s.share for s in self.conditions.state])

    @cached_property
    def _weights(self) -> tuple[np.ndarray, np.ndarray]:
        return weights(self.spots)

    def reduce(self, thetas: Sequence[np.ndarray]) -> FatigueModel:
        """On a basis for these parameter vectors, the initial one among them."""
        all_of = [self.parameters.initial, *thetas]
        return replace(self, models=tuple(m.reduce(all_of) for m in self.models))

    def reduced_for_derivatives(self, theta: np.ndarray) -> FatigueModel:
        """On a basis for this parameter vector and derivatives at it (`StressModel.reduced_for_derivatives`)."""
        return replace(self, models=tuple(m.reduced_for_derivatives(theta) for m in self.models))

    def labelled_at(self, theta: np.ndarray) -> FatigueModel:
        """With the modes' names as they are at this parameter vector, at all that are near."""
        return replace(self, models=tuple(m.labelled_at(theta) for m in self.models))

    def select(self, spots: Sequence[int] | np.ndarray) -> FatigueModel:
        """With these hot spots only, in this order."""
        chosen = sorted({self.spots[k].detail for k in spots})
        new = {old: k for k, old in enumerate(chosen)}
        return replace(
            self,
            models=tuple(m.select(chosen) for m in self.models),
            details=tuple(self.details[k] for k in chosen),
            spots=tuple(replace(self.spots[k], detail=new[self.spots[k].detail]) for k in spots),
        )

    def solve(
        self, theta: np.ndarray, damping: Mapping[str, float] | StateDamping | None = None, *, derivatives: bool = False
    ) -> Stress:
        """Everything at one parameter vector (n_param,); damping: label of a mode -> its ratio, else the file's."""
        found = [m.solve(theta, damping or {}, derivatives=derivatives) for m in self.models]
        change = None
        if derivatives:
            change = np.stack([self._moments_at_spots(r.change) for r in found if r.change is not None], axis=1)
        return Stress(
            owner=self,
            responses=tuple(found),
            change=change,
            moments=frozen_array([self._moments_at_spots(r.moments) for r in found]),
        )

    def _moments_at_spots(self, moments: np.ndarray) -> np.ndarray:
        """(..., 14, n_detail, 3, 3) -> (..., 14, n_spot)."""
        at, w = self._weights
        flat = moments.reshape(*moments.shape[:-2], 9)
        outer = (w[:, :, None] * w[:, None, :]).reshape(-1, 9)
        return np.einsum("...si,si->...s", flat[..., at, :], outer, optimize=True)


@dataclass(frozen=True, eq=False, kw_only=True)
class Stress:
    """moments (n_heading, n_state, 14, n_spot) of hot-spot stress in MPa^2 Hz^k, k of ORDERS, change (n_param, ...) of
    them; without the thickness effect, which belongs to damage."""

    owner: FatigueModel
    responses: tuple[Response, ...]
    moments: np.ndarray
    change: np.ndarray | None = None

    @cached_property
    def _ranges(self):
        return ranges(np.moveaxis(self.moments, 2, 0), self.owner.method)

    def equivalent_mpa(self, m: float) -> np.ndarray:
        """DEL_m (n_spot,)."""
        return (YEAR_S / self.owner.conditions.life.reference_cycles * self._total(self._ranges.moment(m))) ** (1 / m)

    def _total(self, by_case: np.ndarray) -> np.ndarray:
        return np.einsum("hs,hsp->p", self.owner.shares, by_case)

    def equivalent_change(self, m: float) -> np.ndarray:
        """d ln DEL_m / d theta (n_param, n_spot), exact but for rounding. Raises ValueError without derivatives."""
        if self.change is None:
            raise ValueError("solved without derivatives")
        moments = np.moveaxis(self.moments, 2, 0)
        slope = []
        for k in range(len(moments)):
            stepped = moments.astype(complex)
            stepped[k] += 1j * STEP * moments[k]
            slope.append(np.imag(ranges(stepped, self.owner.method).moment(m)) / (STEP * moments[k]))
        total = self._total(self._ranges.moment(m))
        return np.einsum("hs,khsp,jhskp->jp", self.owner.shares, np.array(slope), self.change, optimize=True) / (
            m * total
        )

    def damage_per_year(self, factor: float | np.ndarray = 1.0) -> np.ndarray:
        """(n_spot,) Miner's sum of a year by each spot's curve and thickness effect, every range times `factor` (scalar
        or (n_spot,))."""
        found = np.zeros(len(self.owner.spots))
        names = np.array([s.curve for s in self.owner.spots])
        factor = np.asarray(factor, float) * thickness_effects(self.owner.spots)
        for name in dict.fromkeys(names.tolist()):
            there = names == name
            own = ranges(np.moveaxis(self.moments, 2, 0)[..., there], self.owner.method)
            by_case = own.damage(self.owner.conditions.law(name), factor[there])
            found[there] = YEAR_S * np.einsum("hs,hsp->p", self.owner.shares, by_case)
        return found


def fatigue_model(
    description: Description,
    where: str,
    conditions: Conditions | str | Path,
    *,
    parameters: Parameters | None = None,
    sensors: tuple[Sensor, ...] | None = None,
    method: str = "park",
    spectra: Mapping[str, tuple[np.ndarray, np.ndarray]] | None = None,
) -> FatigueModel:
    """Of a model.toml's turbine, on all degrees of freedom. `conditions`: a fatigue.toml, or what was read of one, with
    the `spectra` that its states name (state -> Hz, N^2/Hz)."""
    known, path, spectra = _read_conditions(conditions, spectra)
    frames = [build_frame(description, d.heading_deg) for d in known.direction]
    details, spots = find_details(description, frames[0], known, str(path or where))
    water = getattr(description.site, "water_level_m", 0.0)
    refuse_other_rotor(known, float(frames[0].node_m[:, 2].max()) - water, str(path or where))
    models = tuple(
        stress_model(
            description,
            where,
            details,
            known,
            heading_deg=d.heading_deg,
            parameters=parameters,
            sensors=sensors,
            spectra=spectra,
            frame=frame,
        )
        for d, frame in zip(known.direction, frames, strict=True)
    )
    return FatigueModel(models=models, details=details, spots=spots, conditions=known, method=method)


def fatigue_model_of(
    model: str | Path,
    conditions: Conditions | str | Path,
    *,
    parameters: Parameters | None = None,
    sensors: tuple[Sensor, ...] | None = None,
    method: str = "park",
    spectra: Mapping[str, tuple[np.ndarray, np.ndarray]] | None = None,
) -> FatigueModel:
    """Of a model's file: a model.toml, or the TOML of a SubDyn model. Raises InputError for models without members."""
    model = Path(model)
    if not is_subdyn(model):
        return fatigue_model(
            read_description(model), str(model), conditions, parameters=parameters, sensors=sensors, method=method,
            spectra=spectra,
        )
    from probupdate.lifetime.subdyn_stress import find_subdyn_details, open_model, subdyn_stress_model

    known, path, spectra = _read_conditions(conditions, spectra)
    own, where = open_model(model), str(path or model)
    details, spots = find_subdyn_details(own, known, where)
    if known.site is not None:
        top = max(joint.position_m[2] for joint in own.file.joints) + known.site.hub_offset_m[2]
        refuse_other_rotor(known, top - known.site.water_level_m, where)
    models = tuple(
        subdyn_stress_model(
            own, details, known, where, heading_deg=d.heading_deg, parameters=parameters, sensors=sensors,
            spectra=spectra,
        )
        for d in known.direction
    )
    return FatigueModel(models=models, details=details, spots=spots, conditions=known, method=method)


def _read_conditions(conditions: Conditions | str | Path, spectra) -> tuple[Conditions, Path | None, dict]:
    """What a fatigue.toml says, its path, and the spectra of thrust that it names."""
    if isinstance(conditions, Conditions):
        known, path, spectra = conditions, None, dict(spectra or {})
    else:
        path = Path(conditions)
        known = read_conditions(path)
        spectra = dict(thrust_spectra(known, path))
    if missing := [s.name for s in known.state if s.thrust_spectrum and s.name not in spectra]:
        raise InputError(
            f"state {missing[0]}, thrust_spectrum", "is a file beside a fatigue.toml", "give that file's path"
        )
    return known, path, spectra


def basis_error(full: FatigueModel, reduced: FatigueModel, thetas: Sequence[np.ndarray]) -> float:
    """Largest relative error of DEL_5 on the basis at unseen parameter vectors, beside the modes and static shapes of
    each, over the hot spots with at least a third of the largest; one heading, as all bases are made alike."""
    whole, one = (replace(m, models=m.models[:1], conditions=_first_direction(m.conditions)) for m in (full, reduced))
    worst = 0.0
    for theta in thetas:
        own = replace(whole, models=tuple(m.reduce([theta]) for m in whole.models))
        a, b = (m.solve(theta).equivalent_mpa(5.0) for m in (own, one))
        top = a > a.max() / 3
        worst = max(worst, float(np.max(np.abs(b / a - 1)[top])))
    return worst


def _first_direction(c: Conditions) -> Conditions:
    return c.model_copy(update={"direction": (c.direction[0].model_copy(update={"share": 1.0}),)})


@dataclass(frozen=True, eq=False, kw_only=True)
class SpotDamage:
    """What is kept of one parameter vector: equivalent_mpa (2, n_spot) of SLOPES and per_year (n_spot,), Miner's sum
    of a year."""

    equivalent_mpa: np.ndarray
    per_year: np.ndarray

    @classmethod
    def from_stress(cls, stress: Stress) -> SpotDamage:
        return cls(equivalent_mpa=frozen_array([stress.equivalent_mpa(m) for m in SLOPES]),
                   per_year=frozen_array(stress.damage_per_year()))


def damage_at_many(
    model: FatigueModel, thetas: np.ndarray, dampings: Sequence[Mapping[str, float] | StateDamping],
    progress: Progress = silent,
) -> list[SpotDamage]:
    """At every row of thetas (n, n_param), each with its own damping ratios."""
    found = []
    for k, (theta, damping) in enumerate(zip(thetas, dampings, strict=True)):
        progress("stress transfer", k, len(thetas))
        found.append(SpotDamage.from_stress(model.solve(theta, damping)))
    progress("stress transfer", len(thetas), len(thetas))
    return found
