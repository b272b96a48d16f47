"""How an effect may run along the record: constant, a step, a ramp, or with a column of the environment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probupdate.diagnosis.blocks import Blocks
from probupdate.runtime.arrays import frozen_array

# times of a step that are tried; finer ones are found in the refit
N_STEP = 16
# blocks that lie on either side of a step that is looked for; one that was found may be nearer to an end
EDGE = 4
# of the weather, in degrees: a day's wave and its first overtone, and waves that are slower than two days, by their
# number; how many of these at most
DAY_STD, HALF_DAY_STD, SLOW_STD = 4.0, 1.3, 4.0
DAY_H, SLOW_H, MOST_SLOW = 24.0, 48.0, 6
# what waves of a day follow, as their column
TIME_OF_DAY = "time_of_day"


@dataclass(frozen=True, eq=False, kw_only=True)
class TimeProfile:
    """`value` (n_block,): what the effect's size is multiplied with. kind "constant", "step", "ramp", "covariate" or,
    of what nobody wrote down, "wave";
    `column` of the environment, `unit` what the size is per, `at` the first block after a step, `centre` what was
    taken off a covariate."""

    kind: str
    value: np.ndarray
    column: str = ""
    at: int = 0
    centre: float = 0.0

    @property
    def name(self) -> str:
        return self.column or self.kind

    @property
    def unit(self) -> str:
        """What is put behind the size's unit."""
        return f" per {_UNITS.get(self.column, 'unit')}" if self.kind == "covariate" else ""


_UNITS = {"water_level_m": "m", "air_temperature_c": "degC", "wind_speed_mps": "m/s", "rms_mps2": "m/s2",
          "power_kw": "kW", "wave_height_m": "m", "thrust_share": "of full thrust", "frost_degc": "degC of frost"}


def make_time_profiles(
    blocks: Blocks, columns: tuple[str, ...], n_step: int = N_STEP
) -> tuple[TimeProfile, ...]:
    """constant, steps at `n_step` times at most, ramp, and the named columns that the blocks show and that vary."""
    n, margin = len(blocks), 1 if blocks.few else EDGE
    time_profiles = [TimeProfile(kind="constant", value=frozen_array(np.ones(n)))]
    if n >= 2 * margin:
        for at in np.unique(np.linspace(margin, n - margin, min(n_step, n - 2 * margin + 1)).astype(int)):
            time_profiles.append(step_profile(n, int(at)))
    if n >= 2 * EDGE + 1:
        span = blocks.hours[-1] - blocks.hours[0]
        time_profiles.append(TimeProfile(kind="ramp", value=frozen_array((blocks.hours - blocks.hours[0]) / span)))
    for column in columns:
        values = blocks.covariate(column)
        if values is not None:
            centre = float(np.mean(values))
            time_profiles.append(
                TimeProfile(kind="covariate", value=frozen_array(values - centre), column=column, centre=centre))
    return tuple(time_profiles)


def weather_profiles(hours: np.ndarray) -> list[tuple[TimeProfile, float]]:
    """How the air's temperature may have run at these times (n_block,) where nobody wrote it down: waves of a day and
    of half a day, and slower ones over the record's span, each with the standard deviation of its size in degC."""
    span = float(np.ptp(hours))
    if not span:
        return []
    phase = 2 * np.pi * hours / DAY_H
    waves = [(np.cos(phase), DAY_STD, TIME_OF_DAY), (np.sin(phase), DAY_STD, TIME_OF_DAY),
             (np.cos(2 * phase), HALF_DAY_STD, TIME_OF_DAY), (np.sin(2 * phase), HALF_DAY_STD, TIME_OF_DAY)]
    for k in range(1, 1 + min(MOST_SLOW, max(1, int(2 * span / SLOW_H)))):
        waves.append((np.cos(np.pi * k * (hours - hours.min()) / span), SLOW_STD / k, ""))
    # at noon and midnight alone a wave may not show
    return [(TimeProfile(kind="wave", value=frozen_array(value - value.mean()), column=column), std)
            for value, std, column in waves if np.ptp(value) > 1e-6]


def blocks_between_steps(n: int, n_step: int = N_STEP) -> int:
    """Blocks from one of `n_step` times of a step that are tried in n blocks to the next, at most."""
    return -(-(n - 2 * EDGE) // n_step)


def step_profile(n: int, at: int) -> TimeProfile:
    return TimeProfile(kind="step", value=frozen_array(np.arange(n) >= at), at=at)
