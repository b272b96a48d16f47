"""Modes out of records: `identify.identify` a campaign, `selection.select` the sets an update may trust.

`ssi` goes from one record to its poles, `classification` tells which of them are modes of the structure.
"""
