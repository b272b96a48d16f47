"""Which of a model's modes the modes of a set are, and what a mistake of channels would explain where none fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from probupdate.errors import InputError
from probupdate.modal.channel_mistakes import ChannelMistake, ComputedModes, channel_mistake
from probupdate.modal.matching import APART, Matching, channel_rows, match, with_stated_gravity
from probupdate.modal.modes import ModalData, ModalSet
from probupdate.model.interface import ModalSolution, Model
from probupdate.updating.settings import CONSTANTS

SEARCH = CONSTANTS.search
# where these end below the highest measured mode, up to so many times as many
MOST_SEARCHED = 8


def match_set(
    model: Model, data: ModalData, modal_set: ModalSet, *, clusters: list[tuple[int, ...]] | None, planes: bool
) -> Matching:
    """The set's modes beside the model's at the initial parameters, as channels of `data` read these. `clusters` and
    `planes` as in `match`. Raises InputError where no mode can be matched or either of two may be meant, with the
    mistake of channels that would explain it."""
    rows, solution = channel_rows(model, data.channels), solution_beyond(model, modal_set)

    def likely() -> ChannelMistake | None:
        return channel_mistake(modal_set, data.channels, [
            ComputedModes(shape=solution.shape[rows], frequency_hz=solution.frequency_hz)])

    try:
        matching = match(modal_set, solution, rows, labels=data.labels, clusters=clusters, planes=planes,
                         prior_cov=lambda: _prior_cov(model, len(solution.frequency_hz)))
    except InputError as error:
        _refuse_mistake(error, likely())
        raise
    if matching.uncertain is not None:
        _refuse_mistake(matching.uncertain, likely())
    return matching


def _prior_cov(model: Model, n_mode: int) -> np.ndarray:
    """(n_mode, n_mode) covariance of ln f by the prior, to first order."""
    solution = model.solve(model.parameters.initial, n_mode, derivatives=True)
    slope = solution.both_derivatives[0] / solution.frequency_hz[:, None]
    return slope @ model.parameters.covariance @ slope.T


def solution_beyond(model: Model, modal_set: ModalSet) -> ModalSolution:
    """The model's modes among which the measured ones are looked for, SEARCH more than these or all up to the highest
    of them: a structure of many members has many modes below the next that is identified."""
    n_mode = min(modal_set.frequency_hz.size + SEARCH, model.n_available)
    most = min(MOST_SEARCHED * n_mode, model.n_available)
    highest = np.max(modal_set.frequency_hz[modal_set.measured], initial=0.0) * np.exp(APART)
    while True:
        solution = model.solve(model.parameters.initial, n_mode)
        if n_mode == most or solution.frequency_hz[-1] > highest:
            return solution
        n_mode = min(2 * n_mode, most)


def with_mistake(error: InputError, likely: ChannelMistake) -> InputError:
    """The same refusal with what would explain it."""
    return InputError(error.where, f"{error.problem}; {likely.sentence}", likely.remedy)


def _refuse_mistake(error: InputError, likely: ChannelMistake | None) -> None:
    """Raises it with the channels' mistake that would explain it, where there is one."""
    if likely is not None:
        raise with_mistake(error, likely) from None


def suspected_channels(
    model: Model, data: ModalData, theta: Sequence[np.ndarray], *, set_id: str | None = None,
    absent: Sequence[int] = (),
) -> ChannelMistake | None:
    """An exchange or reversal of channels with which the set's shapes would be the model's at one of theta
    (n_param,); of modes that are `absent` in the model no sensor is to blame."""
    rows = channel_rows(model, data.channels)
    model, modal_set = with_stated_gravity(model, data.felt), data.set(set_id)
    n_mode = len(solution_beyond(model, modal_set).frequency_hz)
    if len(absent):
        shape = np.array(modal_set.shape)
        shape[:, list(absent)] = np.nan
        frequency = np.array(modal_set.frequency_hz)
        frequency[list(absent)] = np.nan
        modal_set = replace(modal_set, shape=shape, frequency_hz=frequency)
    solved = [model.solve(t, n_mode) for t in theta]
    return channel_mistake(modal_set, data.channels, [
        ComputedModes(shape=one.shape[rows], frequency_hz=one.frequency_hz) for one in solved])
