"""Modes out of records: `identify.identify` a campaign, `selection.select` the sets an update may trust.

`ssi` goes from one record to its poles, `classification` decides which of them are modes of the structure.
"""

# what other rooms and users import; the other modules are this room's own
__all__ = [
    "block_poles", "block_store", "classification", "counterparts", "criteria", "harmonics", "identify", "proposal",
    "reference", "regression", "roving", "selection", "settings", "setups", "ssi", "uncertainty",
]
