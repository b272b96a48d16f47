"""What the turbine and its weather do over a campaign: wind, sea, rotor states, yaw and pitch events, SCADA.

Everything is planned on a grid of ten seconds before any vibration is computed, so that SCADA statistics, the
harmonics' phase and the excitation all follow from one plan. A month is 260 000 rows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import gamma, ndtr

from probupdate.errors import InputError
from probupdate.runtime.arrays import frozen_array

GRID_S = 10.0
SLOT_S = 600.0
PER_SLOT = int(SLOT_S / GRID_S)
SLOTS_PER_BLOCK = 3
IDLING, BELOW_RATED, RATED = 0, 1, 2
STATES = ("idling", "below rated", "rated")
CUT_IN_MPS, RATED_MPS, RATED_KW, RATED_RPM, LOWEST_RPM = 4.0, 12.0, 5000.0, 14.8, 6.9
YAW_RATE_DEGPS, YAW_TOLERANCE_DEG, HEADING_STEP_DEG = 0.3, 10.0, 5.0
FEATHERED_DEG = 84.0


@dataclass(frozen=True, kw_only=True)
class Event:
    """A disturbance: kind "yaw" or "pitch", when (s from the start), how long, how large (deg)."""

    kind: str
    start_s: float
    duration_s: float
    size_deg: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Plan:
    """The campaign on two grids: arrays of length n_slot (10 min) and n_grid (10 s); angles in deg clockwise."""

    n_slot: int
    state: np.ndarray  # (n_slot,) 0 idling, 1 below rated, 2 rated
    maintenance: np.ndarray  # (n_slot,) bool
    wind_mps: np.ndarray  # (n_slot,) mean
    wave_height_m: np.ndarray  # (n_slot,)
    wave_period_s: np.ndarray  # (n_slot,)
    wind_direction_deg: np.ndarray  # (n_slot,)
    water_level_m: np.ndarray  # (n_slot,)
    air_temperature_c: np.ndarray  # (n_slot,)
    fast_wind_mps: np.ndarray  # (n_grid,)
    running: np.ndarray  # (n_grid,) 0 idling .. 1 operating
    rotor_rpm: np.ndarray  # (n_grid,)
    rotor_turns: np.ndarray  # (n_grid,) turns since the start
    pitch_deg: np.ndarray  # (n_grid,)
    power_kw: np.ndarray  # (n_grid,)
    heading_deg: np.ndarray  # (n_grid,) piecewise constant
    yaw_rate_degps: np.ndarray  # (n_grid,)
    events: tuple[Event, ...]

    @property
    def grid_s(self) -> np.ndarray:
        return GRID_S * np.arange(len(self.fast_wind_mps))

    def quiet_blocks(self) -> np.ndarray:
        """(n_block,) bool: half hours that are idling throughout, with no yaw or pitch event."""
        n_block = self.n_slot // SLOTS_PER_BLOCK
        idle = (self.state[: n_block * SLOTS_PER_BLOCK] == IDLING).reshape(n_block, -1).all(axis=1)
        length = SLOTS_PER_BLOCK * SLOT_S
        for event in self.events:
            first, last = int(event.start_s // length), int((event.start_s + event.duration_s) // length)
            idle[first : last + 1] = False
        return idle


def _ou_process(rng: np.random.Generator, n: int, step_s: float, time_constant_s: float) -> np.ndarray:
    """A unit Ornstein-Uhlenbeck process sampled every step_s, started in its stationary state."""
    from scipy.signal import lfilter

    a = np.exp(-step_s / time_constant_s)
    white = rng.standard_normal(n) * np.sqrt(1 - a * a)
    white[0] = rng.standard_normal()
    return lfilter([1.0], [1.0, -a], white)


def _maintenance(n_slot: int, given: Mapping, rng: np.random.Generator) -> np.ndarray:
    """Ten-minute slots in which the turbine stands still at any wind.

    Unless given, the first day has one of 10 to 11 h (enough quiet half hours for an update; a campaign
    shorter than a day has its share), a later day with a chance of 0.35 one of 3 to 8 h.
    """
    stopped = np.zeros(n_slot, bool)
    if "maintenance_hours" in given:
        for window in given["maintenance_hours"]:
            if not 0 <= window[0] < window[1]:
                raise InputError("operation.maintenance_hours", f"{window!r} is not [start, end]", "give hours, rising")
            stopped[round(min(window[0], n_slot) * 6) : round(min(window[1], n_slot) * 6)] = True
        return stopped
    for day in range(-(-n_slot // 144)):
        long, start, chance = rng.uniform(10.0, 11.0), rng.uniform(1.0, 12.0), rng.random()
        if day > 0:
            long = 3 + 5 * (long - 10.0)
        if day == 0 or chance < 0.35:
            share = min(n_slot / 144, 1.0)
            first = day * 144 + round(share * start * 6)
            stopped[first : first + round(share * long * 6)] = True
    return stopped


def _weather(n_slot: int, given: Mapping, rng: np.random.Generator) -> dict[str, np.ndarray]:
    from scipy.signal import lfilter

    mean = given.get("wind_speed_mean_mps", 9.0)
    # Weibull marginal of shape 2.1 through the Gaussian copula of an Ornstein-Uhlenbeck process (10 h)
    quantile = np.clip(ndtr(_ou_process(rng, n_slot, SLOT_S, 10 * 3600.0)), 1e-6, 1 - 1e-6)
    wind = np.minimum(mean / gamma(1 + 1 / 2.1) * (-np.log1p(-quantile)) ** (1 / 2.1), 24.0)
    # prevailing wind along the drawing's x axis
    direction = 35.0 * _ou_process(rng, n_slot, SLOT_S, 9 * 3600.0) + 3.0 * _ou_process(rng, n_slot, SLOT_S, 1800.0)
    # the sea follows the wind with a lag of some hours
    lag = np.exp(-SLOT_S / (5 * 3600.0))
    driven = 0.016 * wind**2
    driven = lfilter([1 - lag], [1, -lag], driven, zi=[lag * driven[0]])[0]
    height = 0.25 + driven + 0.05 * np.abs(_ou_process(rng, n_slot, SLOT_S, 3 * 3600.0))
    period = 4.3 * np.sqrt(height) * (1 + 0.04 * _ou_process(rng, n_slot, SLOT_S, 3 * 3600.0))
    hours = np.arange(n_slot) / 6
    phase = rng.uniform(0, 2 * np.pi, 3)
    level = 0.25 * np.cos(2 * np.pi * hours / 12.42 + phase[0]) + 0.08 * np.cos(2 * np.pi * hours / 12.0 + phase[1])
    level = level + 0.15 * _ou_process(rng, n_slot, SLOT_S, 24 * 3600.0)
    air = 15 - 2.5 * np.cos(2 * np.pi * (hours - 3) / 24) + 2.0 * _ou_process(rng, n_slot, SLOT_S, 36 * 3600.0)
    return {
        "wind_mps": wind, "wind_direction_deg": direction, "wave_height_m": height,
        "wave_period_s": np.maximum(period, 2.5), "water_level_m": level, "air_temperature_c": air,
    }


def _states(wind: np.ndarray, maintenance: np.ndarray) -> np.ndarray:
    """Rotor state per slot, with hysteresis at cut-in: starts above 4.3 m/s, stops below 3.7 m/s."""
    state = np.zeros(len(wind), int)
    running = wind[0] > CUT_IN_MPS
    for k, speed in enumerate(wind):
        running = speed > (CUT_IN_MPS - 0.3 if running else CUT_IN_MPS + 0.3)
        if running and not maintenance[k]:
            state[k] = RATED if speed >= RATED_MPS else BELOW_RATED
    return state


def _simulate_yaw(
    direction: np.ndarray, state: np.ndarray, maintenance: np.ndarray, rng
) -> tuple[np.ndarray, list[Event]]:
    """Heading on the grid, stepping at the middle of each yaw move, and the moves.

    The controller follows the wind once it is off by YAW_TOLERANCE_DEG, less eagerly while idling; in maintenance
    the yaw is locked. Headings are multiples of HEADING_STEP_DEG.
    """
    now = HEADING_STEP_DEG * round(direction[0] / HEADING_STEP_DEG)
    heading, events = np.empty(len(direction) * PER_SLOT), []
    for slot, wanted in enumerate(direction):
        here = slice(slot * PER_SLOT, (slot + 1) * PER_SLOT)
        heading[here] = now
        start = int(rng.integers(5, PER_SLOT - 20))
        off = wanted - now
        limit = YAW_TOLERANCE_DEG if state[slot] else 2 * YAW_TOLERANCE_DEG
        if abs(off) > limit and not maintenance[slot]:
            target = HEADING_STEP_DEG * round(wanted / HEADING_STEP_DEG)
            duration = abs(target - now) / YAW_RATE_DEGPS
            begin = slot * SLOT_S + start * GRID_S
            events.append(Event(kind="yaw", start_s=begin, duration_s=duration, size_deg=float(target - now)))
            middle = slot * PER_SLOT + round((start * GRID_S + duration / 2) / GRID_S)
            heading[middle : here.stop] = target
            now = target
    return heading, events


def _pitch_tests(state: np.ndarray, rng: np.random.Generator) -> list[Event]:
    """While idling, now and then (once in about eight hours) a blade is turned by some degrees and back."""
    chance, start, size = rng.random(len(state)), rng.uniform(60, 400, len(state)), rng.uniform(8, 30, len(state))
    chosen = np.flatnonzero((state == IDLING) & (chance < 1 / 48))
    return [
        Event(kind="pitch", start_s=float(k * SLOT_S + start[k]), duration_s=60.0, size_deg=float(size[k]))
        for k in chosen
    ]


def make_plan(n_slot: int, given: Mapping, rng: np.random.Generator) -> Plan:
    """Draw a campaign of n_slot ten-minute slots; `given` is the truth file's [operation]."""
    from scipy.signal import lfilter

    maintenance = _maintenance(n_slot, given, rng)
    weather = _weather(n_slot, given, rng)
    wind = weather["wind_mps"]
    state = _states(wind, maintenance)
    heading, events = _simulate_yaw(weather["wind_direction_deg"], state, maintenance, rng)
    events += _pitch_tests(state, rng)
    n_grid = n_slot * PER_SLOT
    time = GRID_S * np.arange(n_grid)
    slot_time = SLOT_S * (np.arange(n_slot) + 0.5)
    mean = np.interp(time, slot_time, wind)
    sigma = turbulence_std(mean)
    fast = np.maximum(mean + 0.8 * sigma * _ou_process(rng, n_grid, GRID_S, 25.0), 0.1)
    # starting and stopping takes a minute
    target = np.repeat((state > 0).astype(float), PER_SLOT)
    running = np.minimum(np.convolve(np.pad(target, (6, 0), mode="edge"), np.full(7, 1 / 7), mode="valid"), 1.0)
    rpm_of_wind = np.clip(RATED_RPM * fast / 11.0, LOWEST_RPM, RATED_RPM)
    lag = np.exp(-GRID_S / 30.0)
    smooth = lfilter([1 - lag], [1, -lag], rpm_of_wind, zi=[lag * rpm_of_wind[0]])[0]
    wobble = 1 + 0.01 * _ou_process(rng, n_grid, GRID_S, 40.0)
    idle_rpm = np.clip(0.35 + 0.03 * fast * (0.3 + np.abs(_ou_process(rng, n_grid, GRID_S, 900.0))), 0.0, 1.0)
    idle_rpm = np.where(np.repeat(maintenance, PER_SLOT), 0.05 * idle_rpm, idle_rpm)
    rpm = running * smooth * wobble + (1 - running) * idle_rpm
    turns = np.concatenate([[0.0], np.cumsum(0.5 * (rpm[1:] + rpm[:-1]) * GRID_S / 60)])
    pitch_on = np.where(fast > RATED_MPS, 4.0 * np.sqrt(np.maximum(fast - RATED_MPS, 0)) + 0.6 * (fast - RATED_MPS), 0)
    feathered = FEATHERED_DEG + 0.05 * _ou_process(rng, n_grid, GRID_S, 60.0)
    pitch = running * pitch_on + (1 - running) * feathered
    yaw_rate = np.zeros(n_grid)
    for event in events:
        first = int(event.start_s // GRID_S)
        last = min(int(np.ceil((event.start_s + event.duration_s) / GRID_S)), n_grid)
        if event.kind == "yaw":
            yaw_rate[first:last] = np.sign(event.size_deg) * YAW_RATE_DEGPS
        else:
            pitch[first:last] -= event.size_deg
    cubic = (fast**3 - CUT_IN_MPS**3) / (RATED_MPS**3 - CUT_IN_MPS**3)
    power = running * RATED_KW * np.clip(cubic, 0, 1) + (1 - running) * -(25 + 5 * rng.random(n_grid))
    return Plan(
        n_slot=n_slot, state=frozen_array(state, int), maintenance=frozen_array(maintenance, bool),
        **{key: frozen_array(value) for key, value in weather.items()},
        fast_wind_mps=frozen_array(fast), running=frozen_array(running), rotor_rpm=frozen_array(rpm),
        rotor_turns=frozen_array(turns), pitch_deg=frozen_array(pitch), power_kw=frozen_array(power),
        heading_deg=frozen_array(heading), yaw_rate_degps=frozen_array(yaw_rate),
        events=tuple(sorted(events, key=lambda e: e.start_s)),
    )


def turbulence_std(wind_mps: float | np.ndarray) -> float | np.ndarray:
    """Standard deviation of the wind in m/s: 0.10 (0.75 U + 3.8), the slope of IEC 61400-1 at a calm offshore site."""
    return 0.10 * (0.75 * wind_mps + 3.8)
