"""What the model with included effects expects of every block, and how measured blocks depart from it.

Steps and constants enter the reference as they are, so that strong effects are no matter of first order; ramps and
covariates enter through their signature.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from probupdate.effects.catalogue import Effect
from probupdate.diagnosis.mode_numbers import Reference, numbers_of
from probupdate.diagnosis.predictor import ModalPredictor, effect_signatures, observed
from probupdate.diagnosis.problem import IncludedEffect, DiagnosisProblem
from probupdate.diagnosis.small_model import LocalModel

# signatures are computed at headings this far apart; between these by straight lines
NODE_DEG = 10.0


def departures_at(
    problem: DiagnosisProblem,
    theta: np.ndarray,
    included: Sequence[IncludedEffect],
    plain: PlainReferences | None = None,
) -> tuple[np.ndarray, ...]:
    """Per group departures (n_block, n_response) of the measured numbers from the model's with constants and steps in
    it, zero where nothing is told. `plain`: what the model was asked for before, kept between calls."""
    expected = _expected(problem, theta, included, plain or PlainReferences(problem.predictor))
    return tuple(np.where(used[:, None], y - there, 0.0) for y, used, there in
                 zip(*problem.measured, expected, strict=True))  # fmt: skip


class PlainReferences:
    """Expected modes of every group by parameters and angle, before sensors see them, each computed once."""

    def __init__(self, predictor: ModalPredictor):
        self._field, self._local, self._known = predictor, {}, {}

    def __call__(self, theta: np.ndarray, angle_deg: float) -> tuple[Reference, ...]:
        state = theta.tobytes()
        if (state, angle_deg) not in self._known:
            if state not in self._local:
                self._local[state] = self._field.small.at(theta)
            self._known[state, angle_deg] = self._field.references(self._local[state], angle_deg)
        return self._known[state, angle_deg]


def _expected(
    problem: DiagnosisProblem, theta: np.ndarray, included: Sequence[IncludedEffect], plain: PlainReferences
) -> list[np.ndarray]:
    """Per group the numbers of the expected modes in every block (n_block, n_response), as the sensors see them."""
    exact = [n for n in included if n.exact]
    levels = np.column_stack([*(n.course.value for n in exact), problem.angles])
    found, place = np.unique(levels, axis=0, return_inverse=True)
    place = place.ravel()
    seen_there = []
    for level in found:
        moved, seen = _state(problem.predictor, theta, exact, level[:-1])
        seen_there.append([observed(r, seen) for r in plain(moved, level[-1])])
    result = []
    for q, axes in enumerate(problem.predictor.axes):
        own = Reference(tensor=np.array([r[q].tensor for r in seen_there]),
                        shape=np.array([r[q].shape for r in seen_there]))  # fmt: skip
        result.append(numbers_of(own, axes)[place])
    return result


def local_at(
    predictor: ModalPredictor, theta: np.ndarray, included: Sequence[IncludedEffect], values: Sequence[float]
) -> tuple[LocalModel, list[tuple[Effect, float]]]:
    """The model with the included effects where their time profiles have these values, and what the sensors then do."""
    moved, seen = _state(predictor, theta, included, values)
    return predictor.small.at(moved), seen


def _state(predictor: ModalPredictor, theta: np.ndarray, included: Sequence[IncludedEffect], values: Sequence[float]):
    """Parameters with the included effects where their time profiles have these values, and what the sensors then
    do."""
    moved = np.array(theta)
    names = predictor.parameters.names
    seen = []
    for n, value in zip(included, values, strict=True):
        for name, amount in n.effect.increments:
            moved[names.index(name)] += n.size * value * amount
        if n.effect.observe is not None and value:
            seen.append((n.effect, n.size * value))
    return np.clip(moved, predictor.parameters.lower, predictor.parameters.upper), seen


def signatures_at(
    predictor: ModalPredictor,
    local: LocalModel,
    effects: Sequence[Effect],
    names: tuple[str, ...],
    angles_deg: np.ndarray,
    seen: Sequence[tuple[Effect, float]] = (),
) -> list[np.ndarray]:
    """Per group (n_angle, n_response, n_effect): signatures at nodes of NODE_DEG, straight lines between them.
    `names`: the parameters that the effects move."""
    place = np.asarray(angles_deg) / NODE_DEG
    before = np.floor(place).astype(int)
    share = place - before
    n_node = round(360 / NODE_DEG)
    needed = np.unique(np.concatenate([before, before[share > 0] + 1]) % n_node)
    slopes = local.slopes([predictor.parameters.names.index(name) for name in names])
    table: list[dict[int, np.ndarray]] = [{} for _ in predictor.axes]
    for node, found in zip(needed, predictor.slopes(local, needed * NODE_DEG, slopes), strict=True):
        for rows, axes, (reference, tensor, shape) in zip(table, predictor.axes, found, strict=True):
            rows[node] = effect_signatures(effects, names, reference, tensor, shape, axes, seen)
    result = []
    for rows in table:
        low = np.array([rows[k % n_node] for k in before])
        high = np.array([rows[(k + (s > 0)) % n_node] for k, s in zip(before, share, strict=True)])
        result.append(low + share[:, None, None] * (high - low))
    return result


class DeparturesBeside:
    """Departures at one theta with other effects and sizes in the reference than those of `included`, whose ramps and
    covariates are taken off as they are there; what the model is asked for is kept between calls."""

    def __init__(self, problem: DiagnosisProblem, theta: np.ndarray, included: Sequence[IncludedEffect]):
        self._setting, self._theta, self._plain = problem, theta, PlainReferences(problem.predictor)
        nothing = [np.zeros((len(problem.blocks), discrepancy_std.size)) for discrepancy_std in problem.discrepancy_std]
        self._along = _without_linear(problem, theta, included, nothing)

    def __call__(self, included: Sequence[IncludedEffect]) -> tuple[np.ndarray, ...]:
        found = departures_at(self._setting, self._theta, included, self._plain)
        return tuple(y + a for y, a in zip(found, self._along, strict=True))


def all_departures(
    problem: DiagnosisProblem, theta: np.ndarray, included: Sequence[IncludedEffect]
) -> tuple[np.ndarray, ...]:
    """`departures_at` less what ramps and covariates make."""
    return DeparturesBeside(problem, theta, included)(included)


def _without_linear(problem, theta, included, departures):
    """Takes off what ramps and covariates make, by the signatures at theta without them."""
    linear = [n for n in included if not n.exact]
    if not linear:
        return departures
    result = [np.array(y) for y in departures]
    centres, bin_of = problem.bins
    names = tuple(dict.fromkeys(name for n in linear for name, _ in n.effect.increments))
    local = problem.predictor.small.at(theta)
    for made, y in zip(signatures_at(problem.predictor, local, [n.effect for n in linear], names, centres), result,
                       strict=True):  # fmt: skip
        for k, n in enumerate(linear):
            y -= n.size * n.course.value[:, None] * made[bin_of][:, :, k]
    return tuple(result)
