"""What the model with named effects expects of every block, and how measured blocks depart from it.

Steps and constants enter the reference as they are, so that strong effects are no matter of first order; ramps and
covariates enter through their fingerprint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from probupdate.diagnosis.catalogue import Effect
from probupdate.diagnosis.departures import Reference, departure, log_scales, n_response
from probupdate.diagnosis.field import Field, effect_fingerprints, observed
from probupdate.diagnosis.noise import Noise, factored
from probupdate.diagnosis.setting import Named, Setting
from probupdate.diagnosis.small_model import LocalModel

# fingerprints are computed at headings this far apart; between these by straight lines
NODE_DEG = 10.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Departures:
    """Of all blocks from what is expected, per group: y (n_block, n_response), zero where nothing is told; used
    (n_block,), which blocks tell; log_scale (n_block,), ln |dy / d shape| of each real number of the shapes outside the
    group's plane, zero where nothing is told; n_outside, how many such numbers a shape has."""

    y: tuple[np.ndarray, ...]
    used: tuple[np.ndarray, ...]
    log_scale: tuple[np.ndarray, ...]
    n_outside: tuple[int, ...]

    def units(self, noise: Noise) -> float:
        """ln of how much larger departures are than changes of the measured shapes, over all that counts: what a
        density of departures is multiplied by to be one of the measured shapes. A shape that is expected wrongly is
        projected to a shorter one, and its scatter with it, which by itself would look like a better fit."""
        return sum(n * float(s[w > 0].sum()) for n, s, w in
                   zip(self.n_outside, self.log_scale, noise.weight, strict=True))  # fmt: skip


def departures_at(
    setting: Setting, theta: np.ndarray, named: Sequence[Named], plain: PlainReferences | None = None
) -> Departures:
    """Departures from the model with constants and steps in it. `plain`: what the model was asked for before, kept
    between calls."""
    blocks = setting.blocks
    n_channel = len(blocks.channels)
    result = [np.zeros((len(blocks), n_response(len(g), n_channel))) for g in blocks.groups]
    used = [np.array(blocks.present[:, q]) for q in range(len(blocks.groups))]
    scale = [np.zeros(len(blocks)) for _ in blocks.groups]
    expected = _expected(setting, theta, named, plain or PlainReferences(setting.field))
    for q, (group, reference) in enumerate(zip(blocks.groups, expected, strict=True)):
        rows, members = np.flatnonzero(blocks.present[:, q]), list(group)
        if len(rows):
            shape, own = blocks.shape[rows][:, :, members], _of_blocks(reference, rows)
            y, independent = departure(blocks.frequency_hz[rows][:, members], shape, own)
            result[q][rows] = np.where(independent[:, None], y, 0.0)
            used[q][rows] &= independent
            scale[q][rows[independent]] = log_scales(shape[independent], _of_blocks(own, independent))
    return Departures(y=tuple(result), used=tuple(used), log_scale=tuple(scale),
                      n_outside=tuple(2 * (n_channel - len(g)) for g in blocks.groups))  # fmt: skip


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
) -> list[Reference]:
    """What each group's modes are in every block, as the sensors see them."""
    exact = [n for n in named if n.exact]
    levels = np.column_stack([*(n.course.value for n in exact), setting.angles])
    found, place = np.unique(levels, axis=0, return_inverse=True)
    place = place.ravel()
    seen_there = []
    for level in found:
        moved, seen = _state(setting.field, theta, exact, level[:-1])
        seen_there.append([observed(r, seen) for r in plain(moved, level[-1])])
    return [Reference(tensor=np.array([r[q].tensor for r in seen_there])[place],
                      shape=np.array([r[q].shape for r in seen_there])[place], peak=seen_there[0][q].peak)
            for q in range(len(setting.blocks.groups))]  # fmt: skip


def _of_blocks(reference: Reference, rows: np.ndarray) -> Reference:
    return Reference(tensor=reference.tensor[rows], shape=reference.shape[rows], peak=reference.peak)


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
        for rows, (reference, tensor, shape) in zip(table, found, strict=True):
            rows[node] = effect_fingerprints(effects, names, reference, tensor, shape, seen)
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

    def __call__(self, named: Sequence[Named]) -> Departures:
        found = departures_at(self._setting, self._theta, named, self._plain)
        return replace(found, y=tuple(y + a for y, a in zip(found.y, self._along, strict=True)))


def all_departures(setting: Setting, theta: np.ndarray, named: Sequence[Named]) -> Departures:
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


def stated_covariance(
    setting: Setting, theta: np.ndarray, named: Sequence[Named] = ()
) -> list[np.ndarray | None]:
    """Per group the mean over blocks of what the identification says its responses' covariance is, None without;
    named effects at their mean."""
    blocks = setting.blocks
    known = [k for k, d in enumerate(blocks.deviations) if d is not None]
    if len(known) < len(blocks) / 2:
        return [None] * len(blocks.groups)
    exact = [n for n in named if n.exact]
    local, seen = local_at(setting.field, theta, exact, [float(np.mean(n.course.value)) for n in exact])
    centres, bin_of = setting.bins
    references = [[observed(r, seen) for r in setting.field.references(local, angle)] for angle in centres]
    result = []
    for q, group in enumerate(blocks.groups):
        members, rows, number = list(group), [], 0
        for k in known:
            d, weight = blocks.deviations[k], blocks.relative_std[k, q] ** -2.0
            ln_f, shape = d.ln_frequency[members], d.shape[:, members]
            if not blocks.present[k, q] or not (np.all(np.isfinite(ln_f)) and np.all(np.isfinite(shape))):
                continue
            sizes = np.max(np.abs(shape), axis=(0, 1))
            h = 1e-4 / max(float(np.max(np.abs(ln_f))), float(np.max(sizes)), 1e-12)
            sides = [
                departure(blocks.frequency_hz[k, members] * np.exp(s * h * ln_f.T),
                          blocks.shape[k][:, members] + s * h * shape.transpose(2, 0, 1), references[bin_of[k]][q])
                for s in (1, -1)
            ]  # fmt: skip
            if sides[0][1].all() and sides[1][1].all():
                columns = (sides[0][0] - sides[1][0]) / (2 * h)
                rows.append(np.sqrt(weight) * columns)
                number += 1
        # each block's deviations come from few parts of it
        told = factored(np.concatenate(rows)) * sum(map(len, rows)) / number if number >= len(blocks) / 3 else None
        result.append(told)
    return result
