"""The numbers of Tables 1-7 of the paper on updating an offshore wind jacket, for the columns beside ours.

Printed values except where the text contradicts them: the mean of a_m in Table 7 is printed 8.59e+0 and is
8.59e-1 (Table 5 gives 0.84); k_TP of Table 5 is 0.341 by value and 0.36 by ratio and text, both are kept.
Stiffness of pile heads is converted from kN/m to N/m.
"""

from __future__ import annotations

MODES = ("FA1", "SS1", "FA2", "SS2")

# Table 1: (assumption, criterion)
SELECTION = (
    ("LTI system", "no yawing, pitching"),
    ("white-noise excitation", "idling or parked"),
    ("1st and 2nd modes", "four eigenmodes identified"),
    ("FA/SS symmetry planes", "perpendicular modes"),
)
SELECTED_SETS = 9

# Table 2: name -> (uncertainty metric 0-3, CoV or None, sensitivity metric 0-3)
SENSITIVITY = {
    "k_j": (1, 0.05, 1), "k_t": (2, 0.25, 2), "k_TP": (2, 0.25, 2), "k_p": (1, 0.10, 2), "LJF": (2, 0.50, 1),
    "D_l": (0, None, 2), "t_l": (1, None, 1), "D_b": (0, None, 1), "t_b": (1, None, 0), "sc": (2, None, 1),
    "corr": (2, None, 2), "mg": (2, None, 2), "a_m": (2, 0.50, 1), "m_h": (1, 0.02, 3), "py": (3, 1.00, 1),
    "tz": (3, 1.00, 2), "qw": (3, 1.00, 0),
}

# Table 3, Hz, and Table 4, MAC, in the order of MODES
FREQUENCY_HZ = {
    "measured": (0.32, 0.32, 1.96, 1.99),
    "design": (0.30, 0.30, 1.37, 1.40),
    "as-built": (0.31, 0.31, 1.57, 1.63),
    "updated": (0.32, 0.32, 1.94, 2.00),
}
MAC = {
    "design": (0.96, 0.98, 0.85, 0.93),
    "as-built": (0.97, 0.99, 0.98, 0.99),
    "updated": (0.96, 0.98, 0.99, 0.99),
}
# section 4: over idling and operating states of one month, by bending order
FREQUENCY_COV = {"FA1": 0.015, "SS1": 0.015, "FA2": 0.017, "SS2": 0.017}

# Table 5: name -> (words, unit, initial, updated, ratio)
UPDATED = {
    "k_j": ("jacket stiffness", "-", 1.0, 0.995, 0.99),
    "k_t": ("turbine stiffness", "-", 1.0, 1.83, 1.83),
    "k_TP": ("TP stiffness", "-", 1.0, 0.341, 0.36),
    "k_p": ("pile stiffness", "-", 1.0, 1.02, 1.02),
    "a_m": ("added mass", "-", 1.0, 0.84, 0.84),
    "m_h": ("hub mass", "kg", 1.44e5, 1.47e5, 1.01),
    "py": ("lateral soil, displacement axis", "-", 1.0, 0.133, 0.13),
    "tz": ("axial soil, displacement axis", "-", 1.0, 0.0696, 0.07),
    "qw": ("pile tip, displacement axis", "-", 1.0, 0.662, 0.66),
    "LJF": ("joint stiffness", "-", 1.0, 1.02, 1.02),
}

# Table 6, N/m
PILE_HEAD_NPM = {
    "design": {"k_xy": 2.8e8, "k_z": 1.0e9},
    "as-built": {"k_xy": 4.4e8, "k_z": 1.3e9},
    "updated": {"k_xy": 1.3e9, "k_z": 6.0e9},
}

# Table 7: name -> (mean, CoV of the mean, True where it is an upper limit); k in N/m
SCATTER = {
    "k_j": (0.995, 0.01, True),
    "k_t": (1.92, 0.04, False),
    "k_TP": (0.330, 0.06, False),
    "a_m": (0.859, 0.05, False),
    "m_h": (1.47e5, 0.01, True),
    "k_xy": (1.18e9, 0.12, False),
    "k_z": (5.50e9, 0.11, False),
    "LJF": (1.02, 0.02, False),
}


def is_the_jacket(parameter_names: tuple[str, ...]) -> bool:
    """Whether these are the paper's parameters: every name stands in Table 2 and most of Table 5 are there."""
    names = set(parameter_names)
    return "k_j" in names and names <= set(SENSITIVITY) and len(names & set(UPDATED)) >= 5
