"""One hour of a virtual campaign: motion in the modes of each heading and condition, as sensors and loggers have it."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field

import numpy as np

from probupdate.runtime.arrays import frozen_array
from probupdate.virtual import excitation, losses, observation, operation
from probupdate.virtual.conditions import slot_amounts
from probupdate.virtual.dynamics import N_MODE, HeadingModes, factorise, heading_modes
from probupdate.virtual.effects import HiddenEffects
from probupdate.virtual.frame import Structure, build_structure
from probupdate.virtual.operation import Plan
from probupdate.virtual.response import channel_response
from probupdate.virtual.truth import Truth
from probupdate.virtual.turbine_file import TurbineFile

RATE_HZ = 25.0
SPIN_UP_S = 600.0  # 5.4 time constants of the least damped first mode and more: what is left is below the noise
TAIL_S = 60.0  # beyond the hour, where clocks and filters need it
N_KEPT = 64  # solved headings and conditions kept


@dataclass(frozen=True, eq=False, kw_only=True)
class Turbine:
    """A turbine under its plan: amounts (n_condition, n_effect) of its effects, and which of them holds in each ten
    minutes (n_slot,). Structures and modes are solved when first asked for, the last ones kept."""

    file: TurbineFile
    truth: Truth
    plan: Plan
    seed: int
    amount: np.ndarray
    condition: np.ndarray
    _structures: OrderedDict = field(default_factory=OrderedDict)
    _modes: OrderedDict = field(default_factory=OrderedDict)

    def structure(self, condition: int) -> Structure:
        return self._solver(condition)[0]

    def _solver(self, condition: int):
        def solve():
            structure = build_structure(self.file, self.truth, self.amount[condition])
            return structure, factorise(structure)

        return _solved_once(self._structures, int(condition), solve)

    def modes(self, heading_deg: float, condition: int = 0) -> HeadingModes:
        def solve():
            structure, factor = self._solver(condition)
            return heading_modes(structure, self.truth.damping_ratio, float(heading_deg), factor)

        return _solved_once(self._modes, (float(heading_deg), int(condition)), solve)

    def hidden(self, condition: int) -> HiddenEffects:
        return HiddenEffects(effects=self.truth.effects, amount=tuple(self.amount[condition]))


def _solved_once(store: OrderedDict, key, solve):
    if key not in store:
        store[key] = solve()
        if len(store) > N_KEPT:
            store.popitem(last=False)
    store.move_to_end(key)
    return store[key]


def make_turbine(file: TurbineFile, truth: Truth, plan: Plan, seed: int) -> Turbine:
    """Conditions are numbered as they come; amounts of a continuous time profile are rounded."""
    table = slot_amounts(plan, truth.effects, rounded=True)
    known: dict[tuple, int] = {}
    condition = [known.setdefault(tuple(row), len(known)) for row in table]
    return Turbine(file=file, truth=truth, plan=plan, seed=seed, amount=frozen_array(list(known)),
                   condition=frozen_array(condition, int))


def hour_of_data(turbine: Turbine, gaps: tuple[losses.Gap, ...], channels: tuple[str, ...], hour: int) -> np.ndarray:
    """Accelerations (n_sample, n_channel) in m/s2 of one hour (less at the campaign's end), as the logger has them."""
    from scipy.interpolate import CubicSpline

    plan, truth, seed = turbine.plan, turbine.truth, turbine.seed
    first, last = 3600.0 * hour, min(3600.0 * (hour + 1), 600.0 * plan.n_slot)
    lead, n = int(SPIN_UP_S * RATE_HZ), round((last - first) * RATE_HZ)
    begin = first - SPIN_UP_S
    held = turbine.condition[6 * hour : 6 * hour + 6]
    ratio = observation.sampling_ratio(turbine.hidden(held[0]))
    tail = int(max(1 / ratio - 1, 0.0) * n) + (int(TAIL_S * RATE_HZ) if _needs_tail(turbine, held, ratio) else 0)
    total = lead + n + tail
    base = turbine.structure(held[0])
    loads = excitation.make_loads(plan, base.node_m[base.surface, :2], N_MODE, seed, begin, total, RATE_HZ)
    second = begin + np.arange(total) / RATE_HZ
    grid = np.clip((second // operation.GRID_S).astype(int), 0, len(plan.running) - 1)
    slot = np.clip((second // operation.SLOT_S).astype(int), 0, plan.n_slot - 1)
    rotor = np.where(plan.running[grid] > 0.5, "operating", "idling")
    condition = turbine.condition[slot]
    motion = channel_response(loads, plan.heading_deg[grid], rotor, turbine.modes, RATE_HZ, condition)
    motion = _apply_loggers(motion, turbine, condition)
    if ratio != 1.0:
        at = lead + np.arange(n) / ratio
        motion = CubicSpline(np.arange(total), motion, axis=0)(at)
    else:
        motion = motion[lead : lead + n]
    motion += truth.noise_std_mps2 * excitation.white(seed, 3, first, n, len(channels), RATE_HZ) + truth.offset_mps2
    data = motion.astype(np.float32)
    keep = n
    for gap in gaps:
        low = round((gap.start_s - first) * RATE_HZ)
        high = round((gap.start_s + gap.duration_s - first) * RATE_HZ)
        if high <= 0 or low >= n:
            continue
        if gap.kind == losses.LOST_SAMPLES:
            column = channels.index(gap.channel) if gap.channel else slice(None)
            data[max(low, 0) : high, column] = np.nan
        elif gap.kind == losses.SHORT_FILE:
            keep = low
    return data[:keep]


def _needs_tail(turbine: Turbine, held: np.ndarray, ratio: float) -> bool:
    some = np.array([1.0])
    return ratio != 1.0 or any(
        observation.frequency_response(turbine.file, turbine.hidden(c), some) is not None for c in np.unique(held)
    )


def _apply_loggers(motion: np.ndarray, turbine: Turbine, condition: np.ndarray) -> np.ndarray:
    """Clocks, filters and mounts act on the whole span, each for the samples at which it is in that state."""
    frequency = np.fft.rfftfreq(len(motion), 1 / RATE_HZ)
    spectrum, found = None, motion
    for number in np.unique(condition):
        response = observation.frequency_response(turbine.file, turbine.hidden(number), frequency)
        if response is None:
            continue
        if spectrum is None:
            spectrum, found = np.fft.rfft(motion, axis=0), motion.copy()
        rows = condition == number
        found[rows] = np.fft.irfft(spectrum * response, len(motion), axis=0)[rows]
    return found
