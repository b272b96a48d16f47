"""What the model with included effects expects of every block, and how measured blocks differ from it.

Steps and constants enter the reference as they are, so that strong effects are no matter of first order; ramps and
covariates enter through their signature.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from probupdate.diagnosis.mode_numbers import Reference, numbers_of
from probupdate.diagnosis.predictor import ModalPredictor, effect_signatures, observe, shares_of_nominal
from probupdate.diagnosis.problem import DiagnosisProblem, IncludedEffect
from probupdate.diagnosis.small_model import N_KNOWN, LocalModel
from probupdate.effects.catalogue import Effect
from probupdate.model.parameters import Parameters

# signatures are computed at headings this far apart; between these by straight lines
NODE_DEG = 10.0
N_NODE = round(360 / NODE_DEG)


class ModelAnswers:
    """What a model is asked for more than once: references by parameters and angle, slopes by parameters, before
    sensors see them."""

    def __init__(self):
        self._references: dict[tuple, tuple[Reference, ...]] = {}
        self._slopes: dict[tuple, list] = {}

    def references(self, predictor: ModalPredictor, theta: np.ndarray, angle_deg: float) -> tuple[Reference, ...]:
        """Expected modes of every group."""
        key = predictor.state, theta.tobytes(), angle_deg
        if key not in self._references:
            self._references[key] = predictor.references(predictor.small.evaluate(theta), angle_deg)
        return self._references[key]

    def slopes(
        self, predictor: ModalPredictor, theta: np.ndarray, names: tuple[str, ...], nodes: np.ndarray
    ) -> list:
        """`ModalPredictor.slopes` of the parameters `names` at these numbers of NODE_DEG."""
        key = predictor.state, theta.tobytes(), names, nodes.tobytes()
        if key not in self._slopes:
            self._slopes[key] = _node_slopes(predictor, predictor.small.evaluate(theta), names, nodes)
        return self._slopes[key]


def residuals_at(
    problem: DiagnosisProblem,
    theta: np.ndarray,
    included: Sequence[IncludedEffect],
    answers: ModelAnswers | None = None,
) -> tuple[np.ndarray, ...]:
    """Per group residuals (n_block, n_response) of the measured numbers from the model's with all that is included,
    zero where nothing is measured. `answers`: what the model was asked for before, kept between calls."""
    return tuple(y[0] for y in residuals_of_sizes(problem, theta, [included], answers))


def residuals_of_sizes(
    problem: DiagnosisProblem,
    theta: np.ndarray,
    each: Sequence[Sequence[IncludedEffect]],
    answers: ModelAnswers | None = None,
) -> tuple[np.ndarray, ...]:
    """`residuals_at` (n, n_block, n_response) of n times the same effects with the same time profiles, whose sizes
    alone differ."""
    expected = _expected_numbers(problem, theta, each, answers or ModelAnswers())
    return tuple(np.where(used[:, None], y - there, 0.0) for y, used, there in
                 zip(*problem.measured, expected, strict=True))


def _expected_numbers(
    problem: DiagnosisProblem, theta: np.ndarray, each: Sequence[Sequence[IncludedEffect]], answers: ModelAnswers
) -> list[np.ndarray]:
    """Per group the numbers of the expected modes in every block (n, n_block, n_response), as the sensors see them."""
    exact = [[n for n in included if n.exact] for included in each]
    levels = np.column_stack([*(n.time_profile.value for n in exact[0]), problem.angles])
    found, place = np.unique(levels, axis=0, return_inverse=True)
    place = place.ravel()
    n_group = len(problem.predictor.axes)
    # the levels of one state, which come one after the other, are seen alike
    states = [(value, list(there)) for value, there in groupby(found, key=lambda level: tuple(level[:-1]))]
    seen_there: list[Reference] = []
    for included in exact:
        for value, levels_there in states:
            predictor, moved, seen = _state(problem, theta, included, value)
            seen_there += observe(
                [r for level in levels_there for r in answers.references(predictor, moved, level[-1])], seen)
    result = []
    for q, axes in enumerate(problem.predictor.axes):
        own = seen_there[q::n_group]
        numbers = numbers_of(Reference(tensor=np.array([r.tensor for r in own]),
                                       shape=np.array([r.shape for r in own])), axes)
        result.append(numbers.reshape(len(each), len(found), -1)[:, place])
    for k, included in enumerate(each):
        linear = [n for n in included if not n.exact]
        if linear:
            _add_linear(problem, theta, exact[k], linear, answers, [y[k] for y in result])
    return result


def _add_linear(
    problem: DiagnosisProblem, theta: np.ndarray, exact: Sequence[IncludedEffect], linear: Sequence[IncludedEffect],
    answers: ModelAnswers, expected: list[np.ndarray],
) -> None:
    """Adds what ramps and covariates make, by their signatures at what else is included there: beside a reversed
    channel they move the channel the other way."""
    centres, bin_of = problem.bins
    names = tuple(dict.fromkeys(name for n in linear for name, _ in n.effect.increments))
    values = np.column_stack([np.zeros(len(bin_of)), *(n.time_profile.value for n in exact)])
    states, state_of = np.unique(values, axis=0, return_inverse=True)
    place, nodes, share = _nodes(centres)
    of_nominal = shares_of_nominal(problem.predictor.parameters, theta, names)
    for number, state in enumerate(states):
        rows = np.flatnonzero(state_of.ravel() == number)
        predictor, moved, seen = _state(problem, theta, exact, state[1:])
        at_nodes = answers.slopes(predictor, moved, names, nodes)
        signature = _numbers_between_nodes(
            predictor, at_nodes, [n.effect for n in linear], names, of_nominal, nodes, (place, share), seen
        )
        for made, y in zip(signature, expected, strict=True):
            for k, n in enumerate(linear):
                y[rows] += n.size * n.time_profile.value[rows, None] * made[bin_of[rows]][:, :, k]


def local_at(
    problem: DiagnosisProblem, theta: np.ndarray, included: Sequence[IncludedEffect],
    values: Sequence[float] | np.ndarray,
) -> tuple[ModalPredictor, LocalModel, list[tuple[Effect, float]]]:
    """The predictor in the state of the included effects where their time profiles have these values, the model with
    them there, and what the sensors then do."""
    predictor, moved, seen = _state(problem, theta, included, values)
    return predictor, predictor.small.evaluate(moved), seen


def _state(
    problem: DiagnosisProblem, theta: np.ndarray, included: Sequence[IncludedEffect],
    values: Sequence[float] | np.ndarray,
) -> tuple[ModalPredictor, np.ndarray, list[tuple[Effect, float]]]:
    """The predictor and the parameters with the included effects where their time profiles have these values, and what
    the sensors then do."""
    predictor = problem.predictor_at_state(included, values)
    moved = parameters_with(predictor.parameters, theta, included, values)
    seen = [(n.effect, n.size * value) for n, value in zip(included, values, strict=True)
            if n.effect.observe is not None and value]
    moved = np.clip(moved, predictor.parameters.lower, predictor.parameters.upper)
    return predictor.matched_as_measured(predictor.small.evaluate(moved), seen) if seen else predictor, moved, seen


def parameters_with(
    parameters: Parameters, theta: np.ndarray, included: Sequence[IncludedEffect], values: Sequence[float] | np.ndarray
) -> np.ndarray:
    """theta with the included effects where their time profiles have these values, beyond any bounds."""
    moved = np.array(theta)
    for n, value in zip(included, values, strict=True):
        names = [name for name, _ in n.effect.increments]
        of_nominal = shares_of_nominal(parameters, theta, names) if n.effect.parts else np.ones(len(names))
        for (name, amount), share in zip(n.effect.increments, of_nominal, strict=True):
            moved[parameters.index(name)] += n.size * value * amount * share
    return moved


def signatures_at(
    predictor: ModalPredictor,
    local: LocalModel,
    effects: Sequence[Effect],
    names: tuple[str, ...],
    angles_deg: np.ndarray,
    seen: Sequence[tuple[Effect, float]] = (),
    theta: np.ndarray | None = None,
) -> list[np.ndarray]:
    """Per group (n_angle, n_response, n_effect): signatures at nodes of NODE_DEG, straight lines between them.
    `names`: the parameters that the effects move. `theta`: the parameters without what is included, where they are not
    the local model's."""
    place, nodes, share = _nodes(angles_deg)
    at_nodes = _node_slopes(predictor, local, names, nodes)
    of_nominal = shares_of_nominal(predictor.parameters, local.theta if theta is None else theta, names)
    return _numbers_between_nodes(predictor, at_nodes, effects, names, of_nominal, nodes, (place, share), seen)


def _nodes(angles_deg: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The node below each angle, the nodes that are needed, and the share of the way to the next node."""
    place = np.asarray(angles_deg) / NODE_DEG
    before = np.floor(place).astype(int)
    share = place - before
    return before, np.unique(np.concatenate([before, before[share > 0] + 1]) % N_NODE), share


def _node_slopes(predictor: ModalPredictor, local: LocalModel, names: tuple[str, ...], nodes: np.ndarray) -> list:
    """`ModalPredictor.slopes` there; the last few are kept, as hypotheses are compared at the same parameters."""
    key, known = (predictor.state, local.theta.tobytes(), names, nodes.tobytes()), predictor.known
    if key not in known:
        if len(known) >= N_KNOWN:
            known.pop(next(iter(known)))
        known[key] = _slopes_at(predictor, local, names, nodes)
    return known[key]


def _slopes_at(predictor: ModalPredictor, local: LocalModel, names: tuple[str, ...], nodes: np.ndarray) -> list:
    slopes = local.slopes([predictor.parameters.names.index(name) for name in names])
    return predictor.slopes(local, nodes * NODE_DEG, slopes)


def _numbers_between_nodes(
    predictor: ModalPredictor,
    at_nodes: list,
    effects: Sequence[Effect],
    names: tuple[str, ...],
    of_nominal: np.ndarray,
    nodes: np.ndarray,
    angles: tuple[np.ndarray, np.ndarray],
    seen: Sequence[tuple[Effect, float]],
) -> list[np.ndarray]:
    before, share = angles
    places = [place for found in at_nodes for place in zip(found, predictor.axes, strict=True)]
    made = effect_signatures(effects, names, places, seen, of_nominal)
    result = []
    for q in range(len(predictor.axes)):
        rows = dict(zip(nodes, made[q :: len(predictor.axes)], strict=True))
        low = np.array([rows[k % N_NODE] for k in before])
        high = np.array([rows[(k + (s > 0)) % N_NODE] for k, s in zip(before, share, strict=True)])
        result.append(low + share[:, None, None] * (high - low))
    return result
