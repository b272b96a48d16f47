"""Names of a model's own modes: by where their kinetic energy is where the model knows its nodes, else by sensors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse

from probupdate.modal.labels import TURBINE, mode_character
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
    # written from the last to the first
    position[column], direction[column] = np.asarray(node_m)[alone // 6], alone % 6
    return DofPlaces(position_m=frozen_array(position), direction=frozen_array(direction, int))


def full_model(model: Model) -> AffineModel | None:
    """The model whose degrees of freedom have places, itself or the one it is a reduction of; None without any."""
    full = getattr(model, "full", model)
    return full if isinstance(full, AffineModel) and full.places is not None else None


def labels_of_shapes(
    model: AffineModel, theta: np.ndarray, phi: np.ndarray, frequency_hz: np.ndarray, *,
    families: tuple[str, str, str] = TURBINE,
) -> tuple[str, ...]:
    """Of whole shapes phi (n_dof, n_mode) of a model whose degrees of freedom have places, at theta."""
    if model.places is None:
        raise ValueError("the places of the model's degrees of freedom are not known")
    _, M = model.matrices(theta)
    return energy_character(phi, M @ phi, M.diagonal(), model.places, frequency_hz=frequency_hz,
                            families=families).labels


def mode_labels(
    model: Model, solution: ModalSolution, sensors: Sequence[Sensor] = (), *,
    families: tuple[str, str, str] = TURBINE, phi: np.ndarray | None = None,
) -> tuple[str, ...]:
    """FA1, SS1, T1, ...: by kinetic energy, or where the model knows no nodes by `sensors`, each one of its channels;
    mode 1, mode 2, ... without either. Motions that nothing holds, at 0 Hz, are R1, R2, ... and no others' numbers
    count them. phi (n_dof, n_mode): the whole shapes, where they are known already."""
    frequency_hz, full = solution.frequency_hz, full_model(model)
    held = np.flatnonzero(frequency_hz > 0)
    if full is not None:
        if phi is None:
            _, phi = full.solve_full(solution.theta, frequency_hz.size)
        named = labels_of_shapes(full, solution.theta, phi[:, held], frequency_hz[held], families=families)
    elif sensors:
        rows = [model.channels.index(s.channel) for s in sensors]
        named = mode_character(solution.shape[rows][:, held], tuple(sensors), families=families).labels
    else:
        named = tuple(f"mode {j + 1}" for j in range(held.size))
    return (*(f"R{j + 1}" for j in range(frequency_hz.size - held.size)), *named)
