"""Modes, measured or computed: what other rooms and users import of sensors, modal sets, `modes.json` and shape
criteria."""

from probupdate.modal.modes_file import read_modes, refuse_no_celsius, write_modes
from probupdate.modal.sets import (
    QUANTITIES,
    CovarianceFactors,
    ModalData,
    ModalSet,
    ModelMode,
    ModeRecord,
    Sensor,
    StoredFactors,
    set_words,
)
from probupdate.modal.shape_criteria import (
    OWN_DIRECTIONS,
    criteria_within_plane,
    mac,
    modal_phase_collinearity,
    modes_of_plane,
    pair_by_mac,
    plane_mac,
    rotate_to_real,
    subspace_mac,
    unit_largest,
)

__all__ = [
    "OWN_DIRECTIONS", "QUANTITIES",
    "ModalData", "CovarianceFactors", "ModalSet", "ModeRecord", "ModelMode", "Sensor", "StoredFactors", "set_words",
    "mac", "modal_phase_collinearity", "pair_by_mac", "plane_mac", "read_modes", "refuse_no_celsius",
    "rotate_to_real", "modes_of_plane", "subspace_mac", "unit_largest", "criteria_within_plane", "write_modes",
]
