"""What the error of one problem's responses is made of, by the modes that each part belongs to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from probupdate.model.interface import ModalSolution
from probupdate.runtime.arrays import frozen_array
from probupdate.updating.error_states import (
    FREQUENCY,
    FREQUENCY_FORM,
    KINDS,
    MIXING,
    SHAPE,
    SHAPE_FORM,
    SOURCE,
    ErrorOrigins,
)
from probupdate.updating.mixing import signs_as_mixed
from probupdate.updating.responses import ResponseGroup


def error_origins(
    solution: ModalSolution,
    groups: Sequence[tuple[ResponseGroup, Sequence[int]]],
    pairs: Sequence[tuple[int, int]],
    effects: Mapping[str, np.ndarray],
    *,
    channels: Sequence[str],
    sources: Sequence[str],
    modes: np.ndarray,
) -> ErrorOrigins:
    """Of responses in groups, each with its computed modes. effects: of each kind (n_response, n) in the order of the
    responses, of `pairs` of modes that mix, of `sources`."""
    n_mode, frequency, shape, label = len(solution.frequency_hz), [], [], []
    for group, members in groups:
        own = np.eye(n_mode)[:, list(members)]
        over = solution.shape[group.rows][:, list(members)]
        if group.n_mates:
            turn = (np.linalg.pinv(over / group.shape_std[:, None]) @ group.scaled_basis)[:, :1]
            frequency.append(own @ turn / np.linalg.norm(turn))
        else:
            frequency.append(own)
        if group.shapes != "none":
            u, _, v = np.linalg.svd(np.linalg.lstsq(over, group.basis, rcond=None)[0], full_matrices=False)
            shape.append(np.repeat(own @ u @ v, len(group.rows), axis=1))
            label += [channels[c] for c in group.rows] * group.size
    nothing = np.zeros((n_mode, 0))
    of_frequencies, of_shapes = np.hstack(frequency), np.hstack([nothing, *shape])
    mixed = np.diag(signs_as_mixed(solution.shape)) if pairs else np.eye(n_mode)
    first, second = (mixed[:, [pair[k] for pair in pairs]] for k in range(2))
    blank = np.zeros((n_mode, len(sources)))
    each = {FREQUENCY: (of_frequencies, of_frequencies, [""] * of_frequencies.shape[1]),
            SHAPE: (of_shapes, of_shapes, label), MIXING: (first, second, [""] * len(pairs)),
            SOURCE: (blank, blank, sources)}
    each |= {FREQUENCY_FORM: each[FREQUENCY], SHAPE_FORM: each[SHAPE]}
    kept = [kind for kind in KINDS if np.any(effects[kind])]
    return ErrorOrigins(
        kind=tuple(kind for kind in kept for _ in each[kind][2]),
        label=tuple(text for kind in kept for text in each[kind][2]), channels=tuple(channels),
        first=frozen_array(np.hstack([nothing, *(each[kind][0] for kind in kept)])),
        second=frozen_array(np.hstack([nothing, *(each[kind][1] for kind in kept)])),
        effect=frozen_array(np.hstack([effects[kind] for kind in kept])),
        modes=frozen_array(modes), seen=frozen_array(solution.shape))
