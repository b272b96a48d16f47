"""What a simulation or a measurement may get wrong: effects as data, and how each one enters.

An effect differs from its neutral value by `size`. A difference within `tolerance` is normal: drawings, data sheets and
calibration papers allow it, and it is a nuisance, not a finding. Beyond it the size has the standard deviation
`prior_scale`. Effects enter as a parameter of the model (`parameter`), as a combination of several of its parameters
(`parts`), or through the sensors (`observe`). `time_profiles` says how an effect may run along the record: "constant",
"step", "ramp", or with a column of the environment.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations
from os.path import commonprefix

import numpy as np

from probupdate.errors import InputError
from probupdate.modal.modes import Sensor
from probupdate.modal.sensor_places import sensors_by_height, sensors_by_place
from probupdate.structure.extend import EffectParameter

KINDS = ("structural", "environmental", "measurement")
# what calibration papers and mounting allow
GAIN_TOLERANCE, ROTATION_TOLERANCE_DEG, FRAME_TOLERANCE_DEG = 0.01, 1.0, 1.0
# a factor less one: units mistaken (m/s2 for g) are a factor of 9.8 either way, a wrong range of volts one of 2 to 10
GAIN_RANGE = (-0.98, 20.0)
# loggers on one network time agree to this
CLOCK_TOLERANCE_S, RATE_TOLERANCE = 1e-4, 1e-5
# clocks and filters are looked for up to this, half a period of the highest mode where that is longer
LATE_MS = 200.0
# the difference by which a late signal's slope is taken: ms, and of the highest mode's periods at most
LATER_MS, LATER_PERIODS = 0.1, 2.5e-4

# Prior odds, beside one member of the structure that has changed. Judgement, no statistics: steel warms in every
# record; one clock serves a whole logger, is checked when it is installed and steps with a new firmware only; of the
# pairs of cables of a level one exchange is as probable as one wrong gain, and so is one crosstalk of all pairs of
# channels.
WARMS_ODDS, RATE_ODDS, RATE_STEP_ODDS = 10.0, 0.3, 0.003

# the cause that is a change of one of the model's own parameters; its place is the parameter's name
OWN_PARAMETER = "parameter"

# complex shapes (n_channel, k) of modes near frequency_hz, and a size -> shapes, and what is added to their ln f
Observation = Callable[[np.ndarray, float, float], tuple[np.ndarray, float]]


@dataclass(frozen=True, eq=False, kw_only=True)
class Effect:
    """One row of the catalogue. `lower` and `upper` bound the size; `signature` and `check` are for people: what it
    leaves in the modes, and what would confirm it on site or in the files. `odds`: how probable it is before any data
    beside one member of the structure that has changed; `odds_along`: where another holds along a time profile. It
    enters in one of four ways: by the model's `parameter`, by `parts` (parameters with their change for a size of one),
    by one that a turbine's model `adds` for it, or by what sensors make of shapes (`observe`)."""

    kind: str
    cause: str
    location: str
    unit: str
    tolerance: float
    prior_scale: float
    lower: float = -np.inf
    upper: float = np.inf
    parameter: str = ""
    parts: tuple[tuple[str, float], ...] = ()
    adds: EffectParameter | None = None
    observe: Observation | None = field(default=None, repr=False)
    step_of_size: float = 0.0
    discrete: tuple[float, ...] = ()
    time_profiles: tuple[str, ...] = ("constant", "step")
    signature: str = ""
    check: str = ""
    odds: float = 1.0
    odds_along: tuple[tuple[str, float], ...] = ()

    def __post_init__(self):
        where = f"effect {self.name}"
        if self.kind not in KINDS:
            raise InputError(where, f"kind '{self.kind}' is unknown", f"choose from {', '.join(KINDS)}")
        if sum((bool(self.parameter), bool(self.parts), self.adds is not None, self.observe is not None)) != 1:
            raise InputError(where, "must enter in exactly one way", "give one of parameter, parts, adds, observe")
        if not (self.prior_scale > 0 and self.tolerance >= 0):
            raise InputError(where, "prior_scale must be above zero and tolerance not below it", "correct them")
        if not self.lower <= 0.0 <= self.upper:
            raise InputError(where, f"a size of zero is outside [{self.lower}, {self.upper}]", "widen the bounds")
        if not all(x > 0 for x in (self.odds, *dict(self.odds_along).values())):
            raise InputError(where, "prior odds must be above zero", "give a small number for a rare effect")
        if not self.time_profiles:
            raise InputError(where, "has no time profile",
                             "give 'constant', 'step', 'ramp' or a column of the environment")

    @property
    def name(self) -> str:
        if self.cause == OWN_PARAMETER:
            return f"{self.cause} {self.location}"
        return f"{self.cause}, {self.location}" if self.location else self.cause

    @property
    def key(self) -> Hashable:
        """What tells it from all other rows, whatever it is called: its cause and how it enters."""
        return self.cause, self.increments or self.observe

    @property
    def increments(self) -> tuple[tuple[str, float], ...]:
        """Model parameters that move, with how much for a size of one."""
        name = self.parameter if self.adds is None else self.adds.name
        return ((name, 1.0),) if name else self.parts

    @cached_property
    def stage(self) -> int:
        """Where on the way of a signal an effect on it happens: mounting, sensor, cable, logger."""
        return next((k for k, laws in enumerate(SIGNAL_PATH) if isinstance(self.observe, laws)), 1)

    @cached_property
    def channels_changed(self) -> tuple[int, ...]:
        """Rows of the channels that an effect on some sensors changes; none of any other."""
        match self.observe:
            case Gain(rows) | Delay(rows) | LowPass(rows) | FrequencyResponse(rows):
                return rows
            case Crosstalk(into, _):
                return (into,)
            case Swap(first, second):
                return (first, second)
            case Turn(pairs):
                return tuple(sorted({row for pair in pairs for row in pair}))
        return ()

    @property
    def one_for_all(self) -> bool:
        """Whether it changes its channels by one factor, each beside what the others show."""
        return isinstance(self.observe, Gain | Delay | LowPass | Crosstalk)

    @property
    def observation(self) -> Observation:
        """`observe` of an effect of sensors. Raises ValueError where the effect is none of sensors."""
        if self.observe is None:
            raise ValueError(f"effect {self.name} is none of sensors: it has no observation")
        return self.observe

    def sensed(self, shape: np.ndarray, frequency_hz: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
        """`observe` of modes (n_channel, n) with their own frequencies (n,): shapes and what is added to ln f (n,)."""
        observe = self.observation
        if isinstance(observe, LAWS):
            changed, more = observe(shape, frequency_hz, size)
            return changed, np.full(len(frequency_hz), more)
        # a user's own law is promised one frequency at a time
        result, shift = np.array(shape, complex), np.zeros(len(frequency_hz))
        for one in np.unique(frequency_hz):
            there = frequency_hz == one
            result[:, there], shift[there] = observe(shape[:, there], float(one), size)
        return result, shift

    def prior_odds(self, time_profile: str) -> float:
        return dict(self.odds_along).get(time_profile, self.odds)

    @property
    def signs(self) -> tuple[int, ...]:
        """Directions in which the size may differ from neutral."""
        return tuple(s for s, end in ((-1, self.lower), (1, self.upper)) if end != 0.0)


# Sensors -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Gain:
    """Channels that show 1 + size of what they should: one, or all of a logger."""

    rows: tuple[int, ...]

    def __call__(self, shape, frequency_hz, size):
        result = np.array(shape, complex)
        result[list(self.rows)] *= 1 + size
        return result, 0.0


@dataclass(frozen=True)
class Swap:
    """Two channels' cables: size 1 is a full swap; what lies between is for the signature only."""

    first: int
    second: int

    def __call__(self, shape, frequency_hz, size):
        result = np.array(shape, complex)
        a, b = result[self.first].copy(), result[self.second].copy()
        result[self.first], result[self.second] = a + size * (b - a), b + size * (a - b)
        return result, 0.0


@dataclass(frozen=True)
class Crosstalk:
    """A channel's row, and that of which it shows the share `size` too."""

    into: int
    other: int

    def __call__(self, shape, frequency_hz, size):
        result = np.array(shape, complex)
        result[self.into] += size * result[self.other]
        return result, 0.0


@dataclass(frozen=True)
class Turn:
    """Sensors turned in the planes of pairs of their axes (first, second row), by `size` degrees."""

    pairs: tuple[tuple[int, int], ...]

    def __call__(self, shape, frequency_hz, size):
        result = np.array(shape, complex)
        c, s = np.cos(np.radians(size)), np.sin(np.radians(size))
        for i, j in self.pairs:
            a, b = result[i].copy(), result[j].copy()
            # what the turned axis sees: its own share and that of the neighbour it turns towards
            result[i], result[j] = c * a + s * b, c * b - s * a
        return result, 0.0


@dataclass(frozen=True)
class Delay:
    """Channels of a logger whose clock is late by `size` milliseconds: it writes an event to an earlier time, so that
    phases lead in proportion to frequency."""

    rows: tuple[int, ...]

    def __call__(self, shape, frequency_hz, size):
        result = np.array(shape, complex)
        result[list(self.rows)] *= np.exp(2j * np.pi * frequency_hz * 1e-3 * size)
        return result, 0.0


@dataclass(frozen=True)
class LowPass:
    """Channels behind a first-order low-pass of `size` milliseconds: a delay, and less of what is fast."""

    rows: tuple[int, ...]

    def __call__(self, shape, frequency_hz, size):
        result = np.array(shape, complex)
        result[list(self.rows)] /= 1 + 2j * np.pi * frequency_hz * 1e-3 * size
        return result, 0.0


@dataclass(frozen=True)
class FrequencyResponse:
    """Channels that show what happens at one of the rising frequencies `at_hz`, the one of this `number`, by 1 + size
    times `along` of what they should: 1 in phase, 1j a quarter of a period ahead. Between two of them, and beyond the
    last ones, size goes along straight lines in ln f to nothing at the next."""

    rows: tuple[int, ...]
    at_hz: tuple[float, ...]
    number: int
    along: complex

    def share(self, frequency_hz: float | np.ndarray) -> np.ndarray:
        """Of the size, at these frequencies."""
        log, at = np.log(frequency_hz), np.log(self.at_hz)
        if len(at) == 1:
            return np.ones_like(log)
        below = np.clip(np.searchsorted(at, log) - 1, 0, len(at) - 2)
        above = (log - at[below]) / (at[below + 1] - at[below])
        return np.where(below == self.number, 1 - above, np.where(below + 1 == self.number, above, 0.0))

    def __call__(self, shape, frequency_hz, size):
        result = np.array(shape, complex)
        result[list(self.rows)] *= 1 + size * self.along * self.share(frequency_hz)
        return result, 0.0


@dataclass(frozen=True)
class Rate:
    """The clock of all channels runs fast by the share `size`: every frequency looks lower by it."""

    def __call__(self, shape, frequency_hz, size):
        return np.array(shape, complex), -np.log1p(size)


@dataclass(frozen=True)
class Stiffness:
    """All stiffness of the structure alike by the share `size`: every frequency moves by half of it, no shape does."""

    def __call__(self, shape, frequency_hz, size):
        return np.array(shape, complex), 0.5 * np.log1p(size)


# in the order in which a signal passes them, the structure first; a sensor turned before its sign is exchanged is not
# one turned after it
SIGNAL_PATH = ((Stiffness, Turn), (Gain, FrequencyResponse), (Swap, Crosstalk), (Delay, LowPass, Rate))
# they take a frequency for each mode as well
LAWS = tuple(law for laws in SIGNAL_PATH for law in laws)


def measurement_effects(
    channels: Sequence[str], sensors: Sequence[Sensor] = (), highest_hz: float = np.inf
) -> tuple[Effect, ...]:
    """Gain, polarity and swapped cables of every channel; with `sensors` (places and directions) also rotation of every
    sensor and of the whole frame, and the gain, clock and filter of every logger (a position, or all of a level), of
    modes up to `highest_hz`."""
    row = {name: k for k, name in enumerate(channels)}
    placed = [s for s in sensors if s.channel in row]
    effects = [*_gains_and_polarities(channels, row), *_swaps(channels, placed, row)]
    if not placed:
        return tuple(effects)
    return (*effects, *_rotations(placed, row), *_logger_faults(placed, row, highest_hz), _sampling_rate())


def _gains_and_polarities(channels: Sequence[str], row: Mapping[str, int]) -> list[Effect]:
    gains = [
        Effect(kind="measurement", cause="sensor gain", location=c, unit="-", tolerance=GAIN_TOLERANCE, prior_scale=0.1,
               lower=GAIN_RANGE[0], upper=GAIN_RANGE[1], observe=Gain((row[c],)), step_of_size=1e-3,
               signature="one channel too large or small, every mode alike; frequencies untouched",
               check="calibrate the channel, or compare its standard deviation with its neighbours'")
        for c in channels
    ]
    polarities = [
        Effect(kind="measurement", cause="sensor polarity", location=c, unit="-", tolerance=0.0, prior_scale=2.0,
               lower=-2.0,
               upper=0.0, observe=Gain((row[c],)), step_of_size=1e-3, discrete=(-2.0,),
               signature="one channel with the other sign in every mode",
               check="tap the sensor's base along its axis, or read its cable list")
        for c in channels
    ]
    return gains + polarities


def _swaps(channels: Sequence[str], placed: Sequence[Sensor], row: Mapping[str, int]) -> list[Effect]:
    pairs = _swappable(channels, placed)
    return [
        Effect(kind="measurement", cause="swapped channels", location=f"{a} and {b}", unit="-", tolerance=0.0,
               prior_scale=1.0, lower=0.0, upper=1.0, observe=Swap(row[a], row[b]), step_of_size=1e-3, discrete=(1.0,),
               signature="two channels exchanged in every mode", check="follow the two cables",
               odds=1 / len(pairs))
        for a, b in pairs
    ]


def _rotations(placed: Sequence[Sensor], row: Mapping[str, int]) -> list[Effect]:
    """Of every sensor, and of all of them alike."""
    effects = []
    for name, _, sensors_there in positions(placed, row):
        for axis, planes in _planes(sensors_there, row).items():
            effects.append(Effect(
                kind="measurement", cause="sensor rotation", location=f"{name} about {axis}", unit="deg",
                tolerance=ROTATION_TOLERANCE_DEG, prior_scale=15.0, lower=-180.0, upper=180.0, observe=Turn(planes),
                step_of_size=0.1, signature="the axes of one sensor mix, every mode alike",
                check="measure its direction on site",
            ))
    turned = tuple(p for _, _, there in positions(placed, row) for p in _planes(there, row).get("z", ()))
    if turned:
        effects.append(Effect(
            kind="measurement", cause="rotated sensor frame", location="all sensors", unit="deg",
            tolerance=FRAME_TOLERANCE_DEG, prior_scale=10.0, lower=-180.0, upper=180.0, observe=Turn(turned),
                              step_of_size=0.1,
            time_profiles=("constant",), signature="all axes turned alike: the pairs' planes turn against the nacelle",
            check="survey the sensors' directions, and the zero of the nacelle's heading",
        ))
    return effects


def _logger_faults(placed: Sequence[Sensor], row: Mapping[str, int], highest_hz: float) -> list[Effect]:
    late_ms = max(LATE_MS, 500.0 / highest_hz)
    later_ms = min(LATER_MS, 1e3 * LATER_PERIODS / highest_hz) if np.isfinite(highest_hz) else LATER_MS
    effects = []
    for name, rows in sensor_groups(placed, row):
        for cause, law, tolerance in (("clock offset", Delay(rows), 1e3 * CLOCK_TOLERANCE_S),
                                      ("low-pass filter", LowPass(rows), 0.1)):
            effects.append(Effect(
                kind="measurement", cause=cause, location=name, unit="ms", tolerance=tolerance,
                prior_scale=0.1 * late_ms, lower=-late_ms if cause == "clock offset" else 0.0, upper=late_ms,
                observe=law, step_of_size=later_ms,
                signature="a phase in proportion to frequency on one logger's channels",
                check="compare the loggers' time stamps of one event, and their filters: only the difference to the "
                      "other channels is seen, whose clock may be the wrong one",
            ))
        if len(rows) > 1:
            # what a data sheet allows is each channel's own; a wrong range or unit is the whole logger's
            effects.append(Effect(
                kind="measurement", cause="sensor gain", location=name, unit="-", tolerance=0.0, prior_scale=0.1,
                lower=GAIN_RANGE[0], upper=GAIN_RANGE[1], observe=Gain(rows), step_of_size=1e-3,
                signature="all channels of one logger too large or small, every mode alike; frequencies untouched",
                check="read the logger's range and unit, or calibrate it",
            ))
    return effects


def _sampling_rate() -> Effect:
    return Effect(
        kind="measurement", cause="sampling rate", location="all channels", unit="-", tolerance=RATE_TOLERANCE,
        prior_scale=0.02, lower=-0.2, upper=0.2, observe=Rate(), step_of_size=1e-4, odds=RATE_ODDS,
        odds_along=(("step", RATE_STEP_ODDS),),
        signature="every frequency shifted by one share; shapes untouched",
        check="compare the lines of rotor and blade passing with the rotor speed in SCADA",
    )


def _swappable(channels, placed: Sequence[Sensor]) -> list[tuple[str, str]]:
    """Channels of one level, as cables of one place are confused; without places any two."""
    if not placed:
        return list(combinations(channels, 2))
    return [(a.channel, b.channel) for a, b in combinations(placed, 2) if a.level == b.level]


def positions(
    placed: Sequence[Sensor], row: Mapping[str, int]
) -> list[tuple[str, tuple[int, ...], list[Sensor]]]:
    """Of sensors at one place what their channels' names share (all of them, where those of another place share as
    much or a channel is called so), their rows, and themselves."""
    found = [[placed[k] for k in there] for there in sensors_by_place(placed)]
    channels = [tuple(s.channel for s in there) for there in found]
    short = [_common(names) for names in channels]
    taken = [*short, *(s.channel for s in placed)]
    called = [_list_words(names) if len(names) > 1 and taken.count(one) > 1 else one
              for one, names in zip(short, channels, strict=True)]
    return [(one, tuple(row[name] for name in names), there)
            for one, names, there in zip(called, channels, found, strict=True)]


def _common(names: tuple[str, ...]) -> str:
    """What the channels' names share at their beginning, or all of them."""
    if len(names) == 1:
        return names[0]
    return commonprefix(names).rstrip("-_ .") or _list_words(names)


def _list_words(names: tuple[str, ...]) -> str:
    *others, last = names
    return f"{', '.join(others)} and {last}" if others else last


def _planes(there: Sequence[Sensor], row) -> dict[str, tuple[tuple[int, int], ...]]:
    """Axis of turning -> the two channels it mixes, first towards second."""
    planes = {}
    for first, second in combinations(there, 2):
        axis = np.cross(first.direction, second.direction)
        if np.linalg.norm(axis) < 0.9:
            continue
        k = int(np.argmax(np.abs(axis)))
        pair = (row[first.channel], row[second.channel])
        planes["xyz"[k]] = ((pair if axis[k] > 0 else pair[::-1]),)
    return planes


def sensor_groups(placed: Sequence[Sensor], row: Mapping[str, int]) -> list[tuple[str, tuple[int, ...]]]:
    """Each position, and each level of several positions (where none is stated: each height), but not all sensors at
    once: only relative time is seen."""
    result = [(name, rows) for name, rows, _ in positions(placed, row)]
    levels: dict[str, list[int]] = {}
    height = {k: placed[there[0]].position_m[2] for there in sensors_by_height(placed) for k in there}
    for k, s in enumerate(placed):
        levels.setdefault(s.level or f"z = {height[k]:.4g} m", []).append(row[s.channel])
    known = {rows for _, rows in result}
    for level, rows in levels.items():
        if tuple(rows) not in known:
            result.append((f"all of {level}", tuple(rows)))
    return [(name, rows) for name, rows in result if len(rows) < len(placed)]


# Conditions --------------------------------------------------------------------------------------------------------


def temperature_effect() -> Effect:
    """The stiffness of a structure that no description says the materials of, with the air's temperature: steel loses
    0.04 % a degree (Eurocode 3, part 1-2, to first order), concrete and asphalt several times as much. It enters
    through the frequencies, which it moves alike, so that any model takes it."""
    return Effect(
        kind="environmental", cause="stiffness with temperature", location="all members", unit="-", tolerance=0.0,
        prior_scale=1e-3, lower=-0.5, upper=0.5, observe=Stiffness(), step_of_size=1e-5,
                  time_profiles=("air_temperature_c",),
        odds=WARMS_ODDS, signature="all frequencies fall with temperature by one share; shapes untouched",
        check="temperature sensors in the structure",
    )


# The model's own parameters ----------------------------------------------------------------------------------------


def _short_description(description: str) -> str:
    """A parameter's description behind its name, without what it adds after a colon or semicolon."""
    words = re.split("[:;]", description)[0].strip()
    return f" ({words})" if words else ""


def parameter_effects(parameters) -> tuple[Effect, ...]:
    """Every updated parameter beyond what its prior expects, or moving along the record."""
    return tuple(
        Effect(
            kind="structural", cause=OWN_PARAMETER, location=p.name, unit=p.unit, tolerance=p.std,
            prior_scale=3 * p.std, lower=p.lower - p.initial, upper=p.upper - p.initial, parameter=p.name,
            time_profiles=("constant", "step", "ramp"),
            signature=p.description or f"that of {p.name}",
            check=f"inspect what {p.name} stands for{_short_description(p.description)}",
        )
        for p in parameters
    )
