"""Sensors with a frequency response of their own, by the mean shapes alone: what stands at one place shows each mode
with another phase (a filter, a loose mount, a geophone below its corner), where a clock's would grow with frequency.

How far a level moves is not known without a model, and so not by how much its sensors show it too large or small.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from probupdate.effects.catalogue import Effect, FrequencyResponse, positions
from probupdate.modal.modes import Sensor

OWN_RESPONSE = "frequency response of its own"
# prior scale of a mode's phase in radian: what shows as much a quarter of a period ahead as a gain does in phase
SCALE = 0.1
# steps of a fit, the largest one in radian, and the one in standard deviations that ends it
MOST_STEPS, LARGEST_STEP, SETTLED = 40, 0.5, 0.01


@dataclass(frozen=True, eq=False, kw_only=True)
class MeasuredResponse:
    """Channels `rows` that show the modes of each of the rising frequencies `at_hz` with these leads `phase` (n,) in
    radian."""

    rows: tuple[int, ...]
    at_hz: tuple[float, ...]
    phase: tuple[float, ...]

    def __call__(self, shape, frequency_hz, size):
        result = np.array(shape, complex)
        nearest = int(np.argmin(np.abs(np.log(frequency_hz) - np.log(self.at_hz))))
        result[list(self.rows)] *= np.exp(1j * self.phase[nearest] * size)
        return result, 0.0

    def words(self) -> str:
        """The lead of each mode for people."""
        return ", ".join(f"{'a lead' if a >= 0 else 'a lag'} of {abs(np.degrees(a)):.0f} deg at {hz:.3g} Hz"
                         for hz, a in zip(self.at_hz, self.phase, strict=True))


@dataclass(frozen=True, eq=False, kw_only=True)
class FittedResponse:
    """A place's response as an effect that is there (size 1) or not; phases of the modes in radian with their standard
    deviations (n,)."""

    effect: Effect
    phase: np.ndarray
    phase_std: np.ndarray

    @property
    def largest(self) -> tuple[float, float]:
        """The phase that is farthest from none, in standard deviations, and its standard deviation."""
        k = int(np.argmax(np.abs(self.phase) / self.phase_std))
        return float(self.phase[k]), float(self.phase_std[k])


# what a test of shapes with these effects gives after the response is taken out: scores u (n,), information (n, n)
Scored = Callable[[Effect, list[Effect]], tuple[np.ndarray, np.ndarray]]


def own_responses(sensors: Sequence[Sensor | None], at_hz: Sequence[float], scored: Scored) -> list[FittedResponse]:
    """Of each place with sensors the response that fits best; sensors per channel, None where its place is not known;
    at_hz of every group of modes."""
    placed = [s for s in sensors if s is not None]
    row = {s.channel: k for k, s in enumerate(sensors) if s is not None}
    rising = tuple(sorted(map(float, at_hz)))
    fitted = (_fitted(name, rows, rising, scored) for name, rows, _ in positions(placed, row))
    return [f for f in fitted if f is not None]


def _effect(place: str, observe, discrete: tuple[float, ...] = ()) -> Effect:
    return Effect(kind="measurement", cause=OWN_RESPONSE, location=place, unit="rad", tolerance=0.0, prior_scale=SCALE,
                  lower=-np.pi, upper=np.pi, observe=observe, step_of_size=1e-3, discrete=discrete,
                  signature="the channels of one place with another phase in every mode",
                  check="look at its mount, its cable and its filter")


def _fitted(name: str, rows: tuple[int, ...], at_hz: tuple[float, ...], scored: Scored) -> FittedResponse | None:
    """None where no phases below a half turn settle."""
    phase = np.zeros(len(at_hz))
    parts = [_effect(name, FrequencyResponse(rows, at_hz, k, 1j)) for k in range(len(at_hz))]
    for _ in range(MOST_STEPS):
        whole = _effect(name, MeasuredResponse(rows=rows, at_hz=at_hz, phase=tuple(phase)), (1.0,))
        u, information = scored(whole, parts)
        # a mode that this place hardly moves in keeps its prior
        precision = information + np.eye(len(u)) / SCALE**2
        step, std = np.linalg.solve(precision, u), np.sqrt(np.diag(np.linalg.inv(precision)))
        if np.all(np.abs(step) < SETTLED * std):
            return FittedResponse(effect=whole, phase=phase, phase_std=std)
        phase = phase + step * min(1.0, LARGEST_STEP / max(float(np.max(np.abs(step))), 1e-300))
        if np.any(np.abs(phase) > np.pi):
            return None
    return None
