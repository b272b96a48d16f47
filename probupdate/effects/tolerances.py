"""The sources of error of a model: what drawings, site reports and calibration papers leave open.

Rows of the catalogue with a tolerance, and beside them what no row of one place holds: walls and weights that differ
for all members of a group together, and the laws of the soil, on which accepted methods differ.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import cast

import numpy as np

from probupdate.effects.catalogue import Effect, Observation, measurement_effects
from probupdate.effects.turbine import turbine_effects
from probupdate.modal.matching import with_stated_gravity
from probupdate.modal.modes import Sensor
from probupdate.model.interface import ModalSolution, Model
from probupdate.model.parameters import Parameters
from probupdate.model.uncertainty import ErrorSource
from probupdate.runtime.arrays import frozen_array
from probupdate.structure.affine import AffineModel
from probupdate.structure.description import Description, Offshore, described_sensors
from probupdate.structure.description_file import read_description
from probupdate.structure.effect_kinds import KINDS
from probupdate.structure.extend import EffectParameter, extended_model

# mill and fabrication tolerance of a wall, common to the members of a group (EN 10029 allows a few per cent a plate)
WALL = 0.01
# Initial stiffness of p-y, t-z and q-z springs: API RP 2GEO against a hyperbolic p-y curve, Randolph & Wroth's t-z and
# an elastic half space for one clay differ by 10 to 45 %; evenly, and from one part of the pile to the next.
SOIL_LAW, SOIL_PROFILE = 0.3, 0.2
SOIL_BANDS = 3
# Bernoulli-Euler members leave shear out, which Timoshenko's theory has to within what shear coefficients differ by
SHEAR, SHEAR_STD = 1.0, 0.2
GROUP_OF_CAUSE = {
    "scour": "soil", "lateral soil stiffness": "soil", "axial soil stiffness": "soil",
    "pile tip's soil stiffness": "soil", "foundation stiffness": "soil",
    "marine growth": "water and growth", "corrosion": "water and growth", "nacelle mass": "rotor-nacelle assembly",
    "RNA centre of mass": "rotor-nacelle assembly", "RNA inertia": "rotor-nacelle assembly",
}
# a swinging mass of nothing is not a quantity to be uncertain about; shear has a row of its own, for all members
WITHOUT_TOLERANCE = ("blade coupling", "shear deformation")


@dataclass(frozen=True, kw_only=True)
class Tolerance:
    """A source of the model's error and the effect, a parameter of the extended model, that has its size."""

    source: ErrorSource
    effect: EffectParameter


def _common(d: Description) -> list[Tolerance]:
    """What differs at many places at once."""
    rows = []

    def add(name, kind, description, group, std, check, on=None, settings=None, mean=0.0):
        low = KINDS[kind].neutral - (0.0 if kind == "shear" else 3 * std)
        effect = EffectParameter(name=name, kind=kind, on=on or {}, settings=settings or {}, std=std, lower=low,
                             upper=KINDS[kind].neutral + 3 * std)
        source = ErrorSource(name=name, group=group, description=description, unit="-", std=std, mean=mean, check=check)
        rows.append(Tolerance(source=source, effect=effect))

    if d.mesh.theory == "bernoulli-euler":
        add("tolerance_shear", "shear", "shear deformation of all members", "theory", SHEAR_STD,
            'set mesh.theory = "timoshenko" in the model file', mean=SHEAR)
    for group in (group for group in ("tower", "leg", "brace", "pile") if group in d.groups):
        add(f"tolerance_wall_{group}", "stiffness", f"{group} walls, all alike", "structure", WALL,
            "wall thicknesses as measured", on={"group": group})
    if not isinstance(d, Offshore):
        return rows
    top, bottom = d.site.mudline_m, d.pile_tip_m
    edges = np.linspace(top, bottom, SOIL_BANDS + 1)
    for curve, word in (("py", "lateral"), ("tz", "axial"), ("qw", "tip")):
        add(f"tolerance_law_{curve}", "soil", f"{word} soil law, initial stiffness", "soil", SOIL_LAW,
            "pile load test or cone test with small-strain stiffness", settings={"curve": curve})
        if curve == "qw":
            continue
        for number, (high, low) in enumerate(zip(edges[:-1], edges[1:], strict=True), 1):
            add(f"tolerance_profile_{curve}_{number}", "soil",
                f"{word} soil stiffness, {top - high:g} to {top - low:g} m deep", "soil", SOIL_PROFILE,
                "cone test with small-strain stiffness", on={"level_m": (float(low), float(high))},
                settings={"curve": curve})
    return rows


def turbine_rows(d: Description) -> list[Tolerance]:
    """Every source of a turbine's model."""
    rows = []
    for e in turbine_effects(d):
        if e.adds is None or not e.tolerance or e.cause in WITHOUT_TOLERANCE:
            continue
        source = ErrorSource(name=e.adds.name, group=GROUP_OF_CAUSE.get(e.cause, "structure"), description=e.name,
                             unit=e.unit, std=e.tolerance, check=e.check)
        rows.append(Tolerance(source=source, effect=e.adds))
    return rows + _common(d)


@dataclass(frozen=True, eq=False, kw_only=True)
class SensorUncertainty:
    """Gains and directions of the sensors; `model` answers at `channels`."""

    model: Model
    sensors: tuple[Sensor, ...] = ()

    @cached_property
    def effects(self) -> tuple[Effect, ...]:
        # what turns phases leaves real shapes as they are
        return tuple(e for e in measurement_effects(self.model.channels, self.sensors)
                     if e.tolerance and e.unit in ("-", "deg") and e.cause != "sampling rate")

    @cached_property
    def sources(self) -> tuple[ErrorSource, ...]:
        return tuple(
            ErrorSource(name=f"{e.cause}: {e.location}", group="sensors", description=e.name, unit=e.unit,
                        std=e.tolerance, check=e.check)
            for e in self.effects
        )

    def changes(self, theta, n_mode, clusters) -> ModalSolution:
        return self.added_to(self.model.solve(theta, n_mode))

    def added_to(self, solution: ModalSolution) -> ModalSolution:
        """The same modes with derivatives with respect to the sensors' sources."""
        n_mode = solution.frequency_hz.size
        change = np.empty((*solution.shape.shape, len(self.effects)))
        for k, e in enumerate(self.effects):
            # a measurement effect enters by nothing else
            observe, h = cast(Observation, e.observe), e.step_of_size
            for j in range(n_mode):
                shape, f = solution.shape[:, j : j + 1], float(solution.frequency_hz[j])
                change[:, j, k] = np.real(observe(shape, f, h)[0] - observe(shape, f, -h)[0])[:, 0] / (2 * h)
        return replace(solution, frequency_derivative=np.zeros((n_mode, len(self.effects))), shape_derivative=change)

    def with_gravity(self, felt: Mapping[str, bool]) -> SensorUncertainty:
        return replace(self, model=with_stated_gravity(self.model, felt))

    def fingerprint(self) -> str:
        return _hash(self.sources)


@dataclass(frozen=True, eq=False, kw_only=True)
class TurbineUncertainty:
    """Tolerances of a model.toml's structure, soil, rotor-nacelle assembly and sensors: the model of the file with a
    parameter for each, at one heading of the nacelle."""

    path: Path
    parameters: Parameters
    sensors: tuple[Sensor, ...]
    nacelle_angle_deg: float | None
    description: Description = field(repr=False)

    @classmethod
    def from_description(cls, path: Path, model: Model, sensors, nacelle_angle_deg: float | None) -> TurbineUncertainty:
        """Of a model that was loaded from `path`."""
        description = read_description(path)
        placed = sensors if sensors is not None else described_sensors(description)
        return cls(path=path, parameters=model.parameters, sensors=tuple(placed), nacelle_angle_deg=nacelle_angle_deg,
                   description=description)

    @cached_property
    def tolerances(self) -> tuple[Tolerance, ...]:
        """Of structure, soil and rotor-nacelle assembly, in the order of `sources`; the sensors' follow there."""
        # a tolerance of what is updated is that parameter's own prior
        taken = {*self.parameters.names, *(p.name for p in self.description.parameter)}
        return tuple(r for r in turbine_rows(self.description) if r.effect.name not in taken)

    @cached_property
    def extended(self) -> AffineModel:
        """The model with a parameter for every tolerance."""
        base = Parameters(tuple(self.parameters), held=self.parameters.held)
        return extended_model(self.path, [r.effect for r in self.tolerances], parameters=base,
                              sensors=self.sensors, nacelle_angle_deg=self.nacelle_angle_deg)

    @cached_property
    def of_sensors(self) -> SensorUncertainty:
        return SensorUncertainty(model=self.extended, sensors=self.sensors)

    @cached_property
    def sources(self) -> tuple[ErrorSource, ...]:
        return (*(r.source for r in self.tolerances), *self.of_sensors.sources)

    def changes(self, theta, n_mode, clusters) -> ModalSolution:
        names = self.extended.parameters.names
        neutral = {r.effect.name: r.effect.neutral for r in self.tolerances}
        own = dict(zip(self.parameters.names, theta, strict=True))
        whole = np.array([own[n] if n in own else neutral[n] for n in names])
        solution = self.extended.solve(whole, n_mode, derivatives=True, clusters=clusters)
        picked = [names.index(r.effect.name) for r in self.tolerances]
        of_frequency, of_shape = solution.both_derivatives
        sensor_frequency, sensor_shape = self.of_sensors.added_to(solution).both_derivatives
        return replace(
            solution,
            frequency_derivative=frozen_array(np.hstack([of_frequency[:, picked], sensor_frequency])),
            shape_derivative=frozen_array(np.concatenate([of_shape[:, :, picked], sensor_shape], axis=2)),
        )

    def with_gravity(self, felt: Mapping[str, bool]) -> TurbineUncertainty:
        return replace(self, sensors=tuple(s.with_gravity(felt) for s in self.sensors))

    def fingerprint(self) -> str:
        return _hash(self.sources)


def _hash(sources: Sequence[ErrorSource]) -> str:
    return hashlib.sha256(repr(tuple(sources)).encode()).hexdigest()
