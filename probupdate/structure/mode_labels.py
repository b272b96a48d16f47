"""Names of a model's own modes: by where their kinetic energy is where the model knows its nodes, else by sensors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse
from scipy.sparse import linalg

from probupdate.modal.labels import TURBINE, sensed_character
from probupdate.modal.long_axis import horizontal_axes, spans
from probupdate.modal.mode_energy import DofPlaces, energy_character
from probupdate.modal.modes import Sensor
from probupdate.model.interface import ModalSolution, Model
from probupdate.runtime.arrays import frozen_array
from probupdate.structure.affine import AffineModel


def dof_places(node_m: np.ndarray, motion: sparse.sparray) -> DofPlaces:
    """From the six motions of every node, motion (6 n_node, n_dof) with node_m (n_node, 3): a degree of freedom that is
    itself one of them is at that node. One that several nodes follow is at the first."""
    rows = sparse.csr_array(motion)
    alone = np.flatnonzero(np.diff(rows.indptr) == 1)[::-1]
    alone = alone[rows.data[rows.indptr[alone]] == 1.0]
    column = rows.indices[rows.indptr[alone]]
    position, direction = np.zeros((rows.shape[1], 3)), np.full(rows.shape[1], -1)
    node = np.full(rows.shape[1], -1)
    # written from the last to the first
    node[column], position[column], direction[column] = alone // 6, np.asarray(node_m)[alone // 6], alone % 6
    return DofPlaces(node=frozen_array(node, int), position_m=frozen_array(position),
                     direction=frozen_array(direction, int))


def full_model(model: Model) -> AffineModel | None:
    """The model whose degrees of freedom have places, itself or the one it is a reduction of; None without any."""
    full = getattr(model, "full", model)
    return full if isinstance(full, AffineModel) and full.places is not None else None


def labels_of_shapes(
    model: AffineModel, theta: np.ndarray, phi: np.ndarray, frequency_hz: np.ndarray, *,
    families: tuple[str, ...] = TURBINE,
) -> tuple[str, ...]:
    """Of whole shapes phi (n_dof, n_mode) of a model whose degrees of freedom have places, at theta."""
    if model.places is None:
        raise ValueError("the places of the model's degrees of freedom are not known")
    _, M = model.matrices(theta)
    return energy_character(phi, M @ phi, M.diagonal(), model.places, frequency_hz=frequency_hz, families=families,
                            axes=_axes(model, model.places, (2 * np.pi * frequency_hz.min(initial=np.inf)) ** 2)).labels


def _axes(model: AffineModel, places: DofPlaces, lowest: float) -> np.ndarray | None:
    """(3, 3) across, up and along a structure that spans, None of others: by its nodes' places and by how far its
    weight moves it along x, y and z at the initial parameters. lowest: eigenvalue of a mode, in (rad/s)^2."""
    axes = horizontal_axes(places.position_m[places.moves])
    if axes is None or not np.isfinite(lowest):
        return None
    K, M = (sparse.csc_array(matrix) for matrix in model.matrices(model.parameters.initial))
    load = M @ np.column_stack([places.direction == k for k in range(3)]).astype(float)
    # with what is free held as loosely as the lowest mode holds its mass
    moved = linalg.spsolve(sparse.csc_array(K + lowest * M), load)
    return axes if spans(np.sum(load * moved, axis=0)) else None


def mode_labels(
    model: Model, solution: ModalSolution, sensors: Sequence[Sensor] = (), *,
    families: tuple[str, ...] = TURBINE, phi: np.ndarray | None = None,
) -> tuple[str, ...]:
    """FA1, SS1, T1, ... or H1, V1, T1, ...: by kinetic energy, or where the model knows no nodes by `sensors`, each one
    of its channels; mode 1, mode 2, ... without either. Motions that nothing holds, at 0 Hz, are R1, R2, ... and no
    others' numbers count them. phi (n_dof, n_mode): the whole shapes, where they are known already."""
    frequency_hz, full = solution.frequency_hz, full_model(model)
    held = np.flatnonzero(frequency_hz > 0)
    if full is not None:
        if phi is None:
            _, phi = full.solve_full(solution.theta, frequency_hz.size)
        named = labels_of_shapes(full, solution.theta, phi[:, held], frequency_hz[held], families=families)
    elif sensors:
        rows = [model.channels.index(s.channel) for s in sensors]
        named = sensed_character(frequency_hz[held], solution.shape[rows][:, held], tuple(sensors), families).labels
    else:
        named = tuple(f"mode {j + 1}" for j in range(held.size))
    return (*(f"R{j + 1}" for j in range(frequency_hz.size - held.size)), *named)
