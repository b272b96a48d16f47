"""What the model with named effects expects of every block, and how measured blocks depart from it.

Steps and constants enter the reference as they are, so that strong effects are no matter of first order; ramps and
covariates enter through their fingerprint.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from probupdate.effects.catalogue import Effect
from probupdate.diagnosis.departures import Reference, numbers_of
from probupdate.diagnosis.field import Field, effect_fingerprints, observed
from probupdate.diagnosis.setting import Named, Setting
from probupdate.diagnosis.small_model import LocalModel

# fingerprints are computed at headings this far apart; between these by straight lines
NODE_DEG = 10.0


def departures_at(
    setting: Setting, theta: np.ndarray, named: Sequence[Named], plain: PlainReferences | None = None
) -> tuple[np.ndarray, ...]:
    """Per group departures (n_block, n_response) of the measured numbers from the model's with constants and steps in
    it, zero where nothing is told. `plain`: what the model was asked for before, kept between calls."""
    expected = _expected(setting, theta, named, plain or PlainReferences(setting.field))
    return tuple(np.where(used[:, None], y - there, 0.0) for y, used, there in
                 zip(*setting.measured, expected, strict=True))  # fmt: skip


class PlainReferences:
    """Expected modes of every group by parameters and angle, before sensors see them, each computed once."""

    def __init__(self, field: Field):
        self._field, self._local, self._known = field, {}, {}

    def __call__(self, theta: np.ndarray, angle_deg: float) -> tuple[Reference, ...]:
        state = theta.tobytes()
        if (state, angle_deg) not in self._known:
            if state not in self._local:
                self._local[state] = self._field.small.at(theta)
            self._known[state, angle_deg] = self._field.references(self._local[state], angle_deg)
        return self._known[state, angle_deg]


def _expected(
    setting: Setting, theta: np.ndarray, named: Sequence[Named], plain: PlainReferences
) -> list[np.ndarray]:
    """Per group the numbers of the expected modes in every block (n_block, n_response), as the sensors see them."""
    exact = [n for n in named if n.exact]
    levels = np.column_stack([*(n.course.value for n in exact), setting.angles])
    found, place = np.unique(levels, axis=0, return_inverse=True)
    place = place.ravel()
    seen_there = []
    for level in found:
        moved, seen = _state(setting.field, theta, exact, level[:-1])
        seen_there.append([observed(r, seen) for r in plain(moved, level[-1])])
    result = []
    for q, axes in enumerate(setting.field.axes):
        own = Reference(tensor=np.array([r[q].tensor for r in seen_there]),
                        shape=np.array([r[q].shape for r in seen_there]))  # fmt: skip
        result.append(numbers_of(own, axes)[place])
    return result


def local_at(
    field: Field, theta: np.ndarray, named: Sequence[Named], values: Sequence[float]
) -> tuple[LocalModel, list[tuple[Effect, float]]]:
    """The model with the named effects where their courses have these values, and what the sensors then do."""
    moved, seen = _state(field, theta, named, values)
    return field.small.at(moved), seen


def _state(field: Field, theta: np.ndarray, named: Sequence[Named], values: Sequence[float]):
    """Parameters with the named effects where their courses have these values, and what the sensors then do."""
    moved = np.array(theta)
    names = field.parameters.names
    seen = []
    for n, value in zip(named, values, strict=True):
        for name, amount in n.effect.increments:
            moved[names.index(name)] += n.size * value * amount
        if n.effect.observe is not None and value:
            seen.append((n.effect, n.size * value))
    return np.clip(moved, field.parameters.lower, field.parameters.upper), seen


def fingerprints_at(
    field: Field, local: LocalModel, effects: Sequence[Effect], names: tuple[str, ...], angles_deg: np.ndarray,
    seen: Sequence[tuple[Effect, float]] = (),
) -> list[np.ndarray]:
    """Per group (n_angle, n_response, n_effect): fingerprints at nodes of NODE_DEG, straight lines between them.
    `names`: the parameters that the effects move."""
    place = np.asarray(angles_deg) / NODE_DEG
    before = np.floor(place).astype(int)
    share = place - before
    n_node = round(360 / NODE_DEG)
    needed = np.unique(np.concatenate([before, before[share > 0] + 1]) % n_node)
    slopes = local.slopes([field.parameters.names.index(name) for name in names])
    table: list[dict[int, np.ndarray]] = [{} for _ in field.axes]
    for node, found in zip(needed, field.slopes(local, needed * NODE_DEG, slopes), strict=True):
        for rows, axes, (reference, tensor, shape) in zip(table, field.axes, found, strict=True):
            rows[node] = effect_fingerprints(effects, names, reference, tensor, shape, axes, seen)
    result = []
    for rows in table:
        low = np.array([rows[k % n_node] for k in before])
        high = np.array([rows[(k + (s > 0)) % n_node] for k, s in zip(before, share, strict=True)])
        result.append(low + share[:, None, None] * (high - low))
    return result


class DeparturesBeside:
    """Departures at one theta with other effects and sizes in the reference than those of `named`, whose ramps and
    covariates are taken off as they are there; what the model is asked for is kept between calls."""

    def __init__(self, setting: Setting, theta: np.ndarray, named: Sequence[Named]):
        self._setting, self._theta, self._plain = setting, theta, PlainReferences(setting.field)
        nothing = [np.zeros((len(setting.blocks), floor.size)) for floor in setting.floor]
        self._along = _without_linear(setting, theta, named, nothing)

    def __call__(self, named: Sequence[Named]) -> tuple[np.ndarray, ...]:
        found = departures_at(self._setting, self._theta, named, self._plain)
        return tuple(y + a for y, a in zip(found, self._along, strict=True))


def all_departures(setting: Setting, theta: np.ndarray, named: Sequence[Named]) -> tuple[np.ndarray, ...]:
    """`departures_at` less what ramps and covariates make."""
    return DeparturesBeside(setting, theta, named)(named)


def _without_linear(setting, theta, named, departures):
    """Takes off what ramps and covariates make, by the fingerprints at theta without them."""
    linear = [n for n in named if not n.exact]
    if not linear:
        return departures
    result = [np.array(y) for y in departures]
    centres, bin_of = setting.bins
    names = tuple(dict.fromkeys(name for n in linear for name, _ in n.effect.increments))
    local = setting.field.small.at(theta)
    for made, y in zip(fingerprints_at(setting.field, local, [n.effect for n in linear], names, centres), result,
                       strict=True):  # fmt: skip
        for k, n in enumerate(linear):
            y -= n.size * n.course.value[:, None] * made[bin_of][:, :, k]
    return tuple(result)
