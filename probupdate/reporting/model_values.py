"""The model's modes at its initial and updated parameters, put in the measured modes' order for the pictures."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from probupdate.modal.matching import (
    MIN_MAC,
    SPARE,
    ModeGroup,
    channel_rows,
    close_clusters,
    match,
    with_stated_gravity,
)
from probupdate.modal.modes import ModalData, ModalSet, rotate_to_real
from probupdate.model.interface import Model
from probupdate.reporting.values import ModelValues, mode_labels
from probupdate.reporting.viewer import ShapedModes
from probupdate.updating.joint_set import joint_set
from probupdate.updating.set_matching import solution_beyond
from probupdate.updating.update_file import UpdateRecord

# modes drawn of a model that nothing was measured on
N_PLAIN = 6


def compared_modes(data: ModalData | None, update: UpdateRecord | None) -> ModalData | None:
    """The measured modes that stand beside the model's: those of the update, or those that one would take."""
    if data is None or update is None or not data.labels or not set(update.labels) <= set(data.labels):
        return None if data is None else data.compared(sure=True)
    return data.of_modes([data.labels.index(label) for label in update.labels])


def update_set(data: ModalData | None, update: UpdateRecord | None) -> ModalSet | None:
    """The set that was updated on, or, where it is not among these, the one an update would take: all that are
    comparable, together."""
    if data is None:
        return None
    if update is not None and update.set_id in {s.id for s in data.sets}:
        return data.set(update.set_id)
    return joint_set(data).data.set()


def model_values(model: Model, data: ModalData | None, update: UpdateRecord | None) -> ModelValues:
    """The model's modes that belong to the measured ones, or its first few where nothing was measured.

    Without geometry only the shapes at the channels are known. Raises InputError where a measured channel is not
    among the model's.
    """
    theta = {"initial": model.parameters.initial}
    n_plain = min(N_PLAIN, model.n_available)
    if update is not None:
        theta["updated"] = update.map_theta
    wire = model.wireframe(theta["initial"])
    chosen = update_set(data, update)
    if data is None or chosen is None or not chosen.measured.any():
        labels = tuple(f"mode {k + 1}" for k in range(n_plain))
        states = {name: _first_modes(model, values, n_plain) for name, values in theta.items()}
        return ModelValues(model=model, wire=wire, labels=labels, pairs=(), states=states)
    clusters = close_clusters(chosen.frequency_hz)
    if update is None:
        n_mode = len(solution_beyond(with_stated_gravity(model, data.felt), chosen).frequency_hz)
    else:
        # the modes that the update looked through, so that the same ones are drawn
        n_mode = int(update.computed_mode.max()) + SPARE
        single = set(range(chosen.frequency_hz.size)) - {j for pair in update.pairs for j in pair}
        clusters = [*update.pairs, *((j,) for j in sorted(single))]
    n_mode = min(n_mode, model.n_available)
    labels = mode_labels(data)
    states = {name: _matched_modes(model, values, n_mode, data, chosen, clusters) for name, values in theta.items()}
    pairs = tuple(c for c in clusters if len(c) > 1)
    return ModelValues(model=model, wire=wire, labels=labels, pairs=pairs, states=states)


def _first_modes(model: Model, theta: np.ndarray, n_mode: int) -> ShapedModes:
    solution = model.solve(theta, n_mode)
    return ShapedModes(
        frequency_hz=solution.frequency_hz, shape=solution.shape, displacement=_displacement(model, theta, n_mode)
    )


def _displacement(model: Model, theta: np.ndarray, n_mode: int) -> np.ndarray:
    """(n_node, 3, n_mode), without a node where the model has no geometry."""
    drawn = model.wireframe(theta, n_mode)
    if drawn is None:
        return np.zeros((0, 3, n_mode))
    # modes were asked for
    assert drawn.displacement is not None
    return drawn.displacement


def _matched_modes(
    model: Model, theta: np.ndarray, n_mode: int, data: ModalData, chosen: ModalSet, clusters: list[tuple[int, ...]]
) -> ShapedModes:
    solution, drawn = with_stated_gravity(model, data.felt).solve(theta, n_mode), _displacement(model, theta, n_mode)
    rows = channel_rows(model, data.channels)
    # whatever resembles the measured mode least badly first, so that a poor model is no error here ...
    matching = match(chosen, solution, rows, labels=data.labels, clusters=clusters, min_mac=0.0, refuse=False)
    frequency = np.full(data.n_mode, np.nan)
    shape = np.full((len(data.channels), data.n_mode), np.nan)
    moved = np.full((len(drawn), 3, data.n_mode), np.nan)
    measured = np.real(rotate_to_real(chosen.shape))
    for j, own in _columns_by_mode(matching.groups).items():
        # ... and then only what an update would accept is drawn
        if matching.criterion[j, own[0]] >= MIN_MAC:
            turn, known = np.ones(1), np.isfinite(measured[:, j])
            if len(own) > 1:
                turn = np.linalg.lstsq(solution.shape[rows[known]][:, own], measured[known, j], rcond=None)[0]
                turn = turn / np.linalg.norm(turn)
            frequency[j] = np.linalg.norm(turn * solution.frequency_hz[own])
            shape[:, j] = solution.shape[rows][:, own] @ turn
            moved[:, :, j] = drawn[:, :, own] @ turn
    return ShapedModes(frequency_hz=frequency, shape=shape, displacement=moved)


def _columns_by_mode(groups: tuple[ModeGroup, ...]) -> Mapping[int, list[int]]:
    """measured mode -> the computed ones whose combination it is compared with: one, or of one of a pair two."""
    return {j: [i, *group.mates] for group in groups for j, i in zip(group.measured, group.computed, strict=True)}
