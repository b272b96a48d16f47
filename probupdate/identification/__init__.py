"""Modes out of records: `identify.identify` a campaign, `selection.select` the sets an update may trust.

`ssi` goes from one record to its poles, `physical` finds the modes that a campaign's poles come back at, `chosen_poles`
which pole stands for each mode in each block, `naming` what the modes are called.
"""

# what other rooms and users import; the other modules are this room's own
__all__ = [
    "block_poles", "block_store", "classification", "counterparts", "criteria", "environment", "hand_picked",
    "harmonics", "identify", "imported_modes", "proposal", "reference", "refinement", "regression", "roving",
    "selection", "settings", "setups", "spectral_likelihood", "ssi", "summary", "uncertainty",
]
