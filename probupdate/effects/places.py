"""Sensors that sit at another place than is said, of a model that is known at its nodes alone."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from probupdate.effects.catalogue import Effect, positions
from probupdate.modal.modes import Sensor
from probupdate.model.parameters import Parameter
from probupdate.structure.affine import AffineModel
from probupdate.structure.along_lines import Way, move_channels, neighbouring_nodes, ways
from probupdate.structure.extend import EffectParameter

CAUSE = "sensor at another place"


def with_places(
    model: AffineModel, sensors: Sequence[Sensor], *, alone: bool
) -> tuple[AffineModel, tuple[Effect, ...]]:
    """Every place of sensors moved along each line of the model from its node, to the next ones, and where the model
    states a node for each channel (`alone`) each of several there by itself: the model with a parameter behind its own
    for each, and the rows of the catalogue. All rows of a place are together as probable before as one member that has
    changed."""
    placed = [s for s in sensors if s.channel in model.channels]
    effects: list[Effect] = []
    added: list[tuple[Parameter, Way]] = []
    beside = neighbouring_nodes(model)
    for name, _, there in positions(placed, {c: k for k, c in enumerate(model.channels)}):
        together = ((name, there), *([(s.channel, [s]) for s in there] if alone and len(there) > 1 else ()))
        found = [(called, own, way) for called, own in together for way in ways(model, own, beside)]
        for called, own, way in found:
            p = _parameter(called, own, way, taken=[*model.parameters.names, *(p.name for p, _ in added)])
            effects.append(_effect(p, odds=1 / len(found)))
            added.append((p.parameter, way))
    return (move_channels(model, added, placed) if added else model), tuple(effects)


def _parameter(name: str, there: Sequence[Sensor], way: Way, *, taken: Sequence[str]) -> EffectParameter:
    x, y, z = end = tuple(map(float, way.end_m))
    parameter = f"place_{re.sub(r'[^0-9A-Za-z]+', '_', name)}"
    while parameter in taken:
        parameter += "_"
    # a sensor is mounted a node from where it was meant to be as readily as a part of the way
    scale = float(np.min(np.abs(way.along_m[way.along_m != 0])))
    return EffectParameter(name=parameter, kind="sensor_height", std=scale,
                           settings={"channels": tuple(s.channel for s in there), "towards_m": end},
                           lower=float(way.along_m[0]), upper=float(way.along_m[-1]), cause=CAUSE,
                           location=f"{name}, moved towards the node at ({x:.4g}, {y:.4g}, {z:.4g}) m")


def _effect(adds: EffectParameter, *, odds: float) -> Effect:
    return Effect(kind="measurement", cause=CAUSE, location=adds.location, unit="m", tolerance=0.0,
                  prior_scale=adds.std, lower=adds.lower, upper=adds.upper, adds=adds, odds=odds,
                  signature="all channels of one place show the shapes of another: each mode by its own share",
                  check="look where the sensor is mounted, against its place in the model or in position_m")
