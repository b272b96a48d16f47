"""Which of a model's modes is which measured one, wherever the parameters are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from probupdate.modal.matching import APART, CLEAR, assign
from probupdate.modal.modes import OWN_DIRECTIONS, modes_of_plane
from probupdate.updating.responses import ResponseGroup


# within wide bounds a function may answer with a frequency below zero
@np.errstate(invalid="ignore", divide="ignore")
def paired_modes(
    groups: Sequence[ResponseGroup], frequency_hz: np.ndarray, shape: np.ndarray, least_motion: float
) -> tuple[np.ndarray, np.ndarray]:
    """frequency_hz (n, n_mode), shape (n, n_channel, n_mode) -> the computed modes of all groups (n, n_used), ascending
    in each, and the share of each mode's shape in each one's plane (n, n_used, n_mode), -1 of those that move the
    measured channels by less than `least_motion`.

    Of modes about as alike the nearer in frequency is taken, as `match` does, and of a pair two that span its plane: on
    few levels a mode of thrice the frequency may have the shape of one of them.
    """
    measured = np.unique(np.concatenate([group.rows for group in groups]))
    # what hardly moves the channels has a shape there by chance
    unseen = np.sum(shape[:, measured] ** 2, axis=1) < least_motion**2
    criterion, score, chosen, doubtful = [], [], [], np.zeros(len(shape), bool)
    log = np.log(frequency_hz)
    for group in groups:
        rows = shape[:, group.rows]
        length = np.linalg.norm(rows, axis=1)
        still = unseen | ~((length > 0) & (length < np.inf))
        inside = np.einsum("ck,ncm->nkm", group.plane, rows) / np.where(still, 1.0, length)[:, None]
        share = np.where(still, -1.0, np.sum(inside**2, axis=1))
        criterion += [share] * group.size
        off = np.abs(log - np.log(group.frequency_hz).mean())
        score += [share - CLEAR * np.fmin(off / APART, 1.0)] * group.size
        best = np.sort(np.argsort(-score[-1], axis=1, kind="stable")[:, : group.size], axis=1)
        if group.size == 2:
            a, b = np.take_along_axis(inside, best[:, None], axis=2).transpose(2, 1, 0)
            doubtful |= 0.5 * np.sum(a**2 + b**2, axis=0) - np.abs(a[0] * b[1] - a[1] * b[0]) >= OWN_DIRECTIONS
        chosen.append(best)
    computed, scores = np.concatenate(chosen, axis=1), np.stack(score, axis=1)
    # mostly every group's best columns are its own: no sum can be larger, and no assignment problem need be solved
    in_order = np.sort(computed, axis=1)
    for n in np.flatnonzero(doubtful | np.any(in_order[:, 1:] == in_order[:, :-1], axis=1)):
        computed[n] = _assign_columns(groups, scores[n], shape[n])
    return computed, np.stack(criterion, axis=1)


def _assign_columns(groups: Sequence[ResponseGroup], score: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Columns (n_used,) of score (n_used, n_mode), one to one, ascending in each group."""
    result, start = assign(score), 0
    for group in groups:
        there = slice(start, start + group.size)
        own = tuple(sorted(int(i) for i in result[there]))
        if len(own) == 2:
            own = modes_of_plane(group.plane, shape[group.rows], score[start], own, set(result.tolist()))
        result[there] = sorted(own)
        start += group.size
    return result
