"""The model's modes at its initial and updated parameters, put in the measured modes' order for the pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from probupdate.estimators.update_file import UpdateRecord
from probupdate.model import ModalSolution, Model
from probupdate.modes import ModalData, ModalSet, mac, pair_by_mac, rotate_to_real, subspace_mac
from probupdate.reporting.values import ModelValues
from probupdate.reporting.viewer import ShapedModes

# computed modes beyond the measured ones: local modes of single members lie between the global ones
SPARE_MODES = 9


def partners(
    measured: np.ndarray, measured_hz: np.ndarray, computed: np.ndarray, pairs: Sequence[tuple[int, ...]] = ()
) -> dict[int, int]:
    """Measured mode -> computed mode by shape, one to one; shapes (n_channel, n_mode) real, computed ones ascending.

    Modes of a close pair are scored by how far a computed shape lies within the plane of the measured pair, as
    single shapes of such a pair are ill-defined; within the pair the lower frequency goes with the lower.
    """
    score = mac(measured, computed)
    for pair in pairs:
        rows = list(pair)
        score[rows] = subspace_mac(computed, measured[:, rows])
    found = dict(pair_by_mac(score))
    for pair in pairs:
        ascending = sorted(pair, key=lambda j: measured_hz[j])
        found |= dict(zip(ascending, sorted(found[j] for j in pair if j in found), strict=False))
    return found


def drawn_set(data: ModalData | None, update: UpdateRecord | None) -> ModalSet | None:
    """The set that was updated on, or, where it is not among these, the one an update would take."""
    if data is None:
        return None
    return data.set(update.set_id if update is not None and update.set_id in {s.id for s in data.sets} else None)


def model_values(
    model: Model,
    theta: Mapping[str, np.ndarray],
    modal_set: ModalSet | None,
    channels: Sequence[str],
    labels: Sequence[str] = (),
    pairs: Sequence[tuple[int, ...]] = (),
    n_plain: int = 6,
) -> ModelValues:
    """theta: "initial" and perhaps "updated". A model without geometry is not solved, as nothing is drawn of it.

    Without a modal set the first `n_plain` modes are taken as they come.
    """
    wire = model.wireframe(theta["initial"])
    states = {} if wire is None else {
        name: _state(model, values, modal_set, channels, pairs, n_plain) for name, values in theta.items()
    }
    if modal_set is None or not labels:
        n_mode = n_plain if modal_set is None else modal_set.frequency_hz.size
        labels = tuple(f"mode {k + 1}" for k in range(n_mode))
    return ModelValues(model=model, name=model.name, wire=wire, labels=tuple(labels), states=states)


def _state(model, theta, modal_set, channels, pairs, n_plain) -> ShapedModes:
    n_mode = n_plain if modal_set is None else modal_set.frequency_hz.size + SPARE_MODES
    solution: ModalSolution = model.solve(theta, n_mode)
    displacement = model.wireframe(theta, n_mode).displacement
    if modal_set is None:
        return ShapedModes(frequency_hz=solution.frequency_hz, shape=solution.shape, displacement=displacement)
    rows = [model.channels.index(c) for c in channels if c in model.channels]
    kept = [k for k, c in enumerate(channels) if c in model.channels]
    measured = rotate_to_real(modal_set.shape[kept]).real
    known = [j for j in range(modal_set.frequency_hz.size) if modal_set.measured[j]]
    inside = [tuple(known.index(j) for j in pair) for pair in pairs if all(j in known for j in pair)]
    found = partners(measured[:, known], modal_set.frequency_hz[known], solution.shape[rows], inside)
    frequency = np.full(modal_set.frequency_hz.size, np.nan)
    shape = np.full((len(channels), frequency.size), np.nan)
    moved = np.full((displacement.shape[0], 3, frequency.size), np.nan)
    for position, computed in found.items():
        j = known[position]
        frequency[j] = solution.frequency_hz[computed]
        shape[kept, j] = solution.shape[rows, computed]
        moved[:, :, j] = displacement[:, :, computed]
    return ShapedModes(frequency_hz=frequency, shape=shape, displacement=moved)
