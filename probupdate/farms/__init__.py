"""Many turbines over many months: one resumable graph of steps, and one page over all of them."""

from probupdate.farms.run import FarmRun, farm

__all__ = ["FarmRun", "farm"]
