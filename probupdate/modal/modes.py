"""Modes, measured or computed: what other rooms and users import of sensors, modal sets, `modes.json` and shape
criteria."""

from probupdate.modal.modes_file import read_modes, write_modes
from probupdate.modal.sets import (
    QUANTITIES,
    ModalData,
    ModalDeviation,
    ModalSet,
    ModelMode,
    ModeRecord,
    Sensor,
    StoredDeviation,
)
from probupdate.modal.shape_criteria import (
    mac,
    modal_phase_collinearity,
    normalise,
    pair_by_mac,
    plane_mac,
    rotate_to_real,
    subspace_mac,
    unit_largest,
)

__all__ = [
    "QUANTITIES",
    "ModalData", "ModalDeviation", "ModalSet", "ModeRecord", "ModelMode", "Sensor", "StoredDeviation",
    "mac", "modal_phase_collinearity", "normalise", "pair_by_mac", "plane_mac", "read_modes", "rotate_to_real",
    "subspace_mac", "unit_largest", "write_modes",
]
