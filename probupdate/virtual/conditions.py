"""What the virtual turbine is exposed to, ten minutes by ten minutes, and how much of each hidden effect there is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from probupdate.virtual.effects import amounts
from probupdate.virtual.excitation import mean_thrust
from probupdate.virtual.operation import PER_SLOT, SLOT_S, Plan

AMPLITUDE_UNIT_MPS2 = 0.01
# acceleration over all channels, rms in m/s2, of wind (m/s) and wave height (m): factor, two exponents, and the
# scatter of its logarithm; fitted to the half-hour blocks of one virtual day, idling and running
AMPLITUDE = ((3.0e-4, 1.19, 0.33, 0.10), (3.0e-3, 0.62, 0.63, 0.18))
STEPS = 40  # levels to which a continuous time profile is rounded in time series, over its range


def expected_rms_mps2(wind_mps: np.ndarray, wave_height_m: np.ndarray, running: np.ndarray) -> np.ndarray:
    """Root mean square of the acceleration over channels and time; same shape as its arguments."""
    idle, run = (a * wind_mps**b * wave_height_m**c for a, b, c, _ in AMPLITUDE)
    return np.where(np.asarray(running) > 0.5, run, idle)


def slot_covariates(plan: Plan) -> dict[str, np.ndarray]:
    """Means over ten minutes (n_slot,), under the names that effects may follow."""
    running = plan.running.reshape(plan.n_slot, PER_SLOT).mean(axis=1)
    rms = expected_rms_mps2(plan.wind_mps, plan.wave_height_m, plan.state > 0)
    return {
        "water_level_m": plan.water_level_m, "air_temperature_c": plan.air_temperature_c,
        "wind_speed_mps": plan.wind_mps, "wave_height_m": plan.wave_height_m,
        "thrust_mn": running * mean_thrust(plan.wind_mps) / 1e6,
        "rotor_speed_rpm": plan.rotor_rpm.reshape(plan.n_slot, PER_SLOT).mean(axis=1),
        "amplitude": rms / AMPLITUDE_UNIT_MPS2,
    }


def slot_amounts(plan: Plan, effects: Sequence[Mapping], *, rounded: bool = False) -> np.ndarray:
    """Amount of each effect in each ten minutes (n_slot, n_effect); rounded: to STEPS levels of its range."""
    hour = (np.arange(plan.n_slot) + 0.5) * SLOT_S / 3600
    table = amounts(effects, hour, slot_covariates(plan))
    if rounded:
        for column in table.T:
            low, span = column.min(), np.ptp(column)
            if span > 0 and len(np.unique(column)) > 2:
                column[:] = low + span / STEPS * np.round((column - low) / span * STEPS)
    return table
