"""What was the case while a block was measured: wind, turbine state, amplitude, where the nacelle looked."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from probupdate.campaign.reading import Campaign
from probupdate.campaign.scada import StateRule, block_conditions
from probupdate.identification.block_poles import STAY, TAKEN_OUT, BlockPoles

# the broad-band amplitude of a block goes by the unit of what was measured
AMPLITUDE = {"acceleration": "rms_mps2", "velocity": "rms_mps", "displacement": "rms_m"}


def environment_of(block: BlockPoles, campaign: Campaign, rule: StateRule) -> dict:
    conditions = dict(block_conditions(campaign.scada, block.start, block.minutes, rule))
    conditions["block_minutes"] = block.minutes
    if np.isfinite(block.rms):
        conditions[AMPLITUDE[block.quantity]] = block.rms
    if conditions.get("nacelle_heading_deg") is not None:
        # relative to the model's axes, so that a model can be turned to it without the campaign at hand
        conditions["nacelle_angle_deg"] = (fore_aft_deg(conditions, campaign) + 180.0) % 360.0 - 180.0
    if block.excluded:
        conditions["excluded"] = block.excluded
    of_harmonics = [note for note in block.notes if note.startswith((TAKEN_OUT, STAY))]
    if of_harmonics:
        conditions["harmonics"] = of_harmonics[0]
    return conditions


def fore_aft_deg(environment: Mapping, campaign: Campaign) -> float:
    """Counter-clockwise angle from the model's x axis to where the nacelle looks; 0 where no heading was recorded."""
    heading = environment.get("nacelle_heading_deg")
    return 0.0 if heading is None else campaign.x_axis_heading_deg - float(heading)
