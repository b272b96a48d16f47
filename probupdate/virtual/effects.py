"""The effects a virtual turbine can hide: where each acts, how large it is, and how it runs over time.

An effect is a table of truth.toml: `kind`, its place, its size, and a `time_profile`. Its size at a time is
neutral + amount (size - neutral), the amount being 1 (constant), 0 then 1 (step, ramp), or (x - reference) / scale of
a covariate x. Amount zero is the structure without the effect. `inside` says whether an engineer's list of causes
would hold the kind; the others are there because no list is complete.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from probupdate.errors import InputError
from probupdate.virtual.turbine_file import TurbineFile, unknown_name

ALL = "all"
TIME_PROFILES = ("constant", "step", "ramp", "covariate")
# the key of files written before it was called time_profile
FORMER_KEY = "course"
# what each time profile needs, and may have
PROFILE_KEYS = MappingProxyType({
    "constant": (), "step": ("at_hour",), "ramp": ("from_hour", "to_hour"),
    "covariate": ("covariate", "reference", "scale"),
})
COVARIATES = (
    "water_level_m", "air_temperature_c", "wind_speed_mps", "wave_height_m", "thrust_mn", "rotor_speed_rpm",
    "amplitude",
)
SMALLEST_FACTOR = 1e-6
# of any structure or sensor, by unit; others
LARGEST_SIZE, LARGEST = MappingProxyType({"-": 1e3, "m": 1e3, "m/m": 1e3, "1/K": 1.0, "kg": 1e9, "deg": 360.0}), 1e15


@dataclass(frozen=True, kw_only=True)
class EffectKind:
    """One kind of effect: `acts` structure, environment or measurement; `place` its keys; `size` the key of its
    size with the value that changes nothing and the unit; `time_profile` what it follows unless stated otherwise."""

    acts: str
    place: tuple[str, ...]
    size: str
    neutral: float
    unit: str
    low: float = -np.inf
    high: float = np.inf
    inside: bool = True
    time_profile: Mapping = field(default_factory=lambda: MappingProxyType({"time_profile": "constant"}))


def _follows(covariate: str, reference: float, scale: float) -> Mapping:
    return MappingProxyType({"time_profile": "covariate", "covariate": covariate, "reference": reference,
                             "scale": scale})


def _structural(place: tuple[str, ...], size: str, unit: str, neutral: float = 0.0, **more) -> EffectKind:
    return EffectKind(acts="structure", place=place, size=size, neutral=neutral, unit=unit, **more)


def _factor(*place: str, high: float = 3.0, **more) -> EffectKind:
    return _structural(place, "factor", "-", 1.0, low=0.0, high=high, **more)


def _sensor_effect(place: tuple[str, ...], size: str, unit: str, neutral: float = 0.0, **more) -> EffectKind:
    return EffectKind(acts="measurement", place=place, size=size, neutral=neutral, unit=unit, **more)


def _environmental(size: str, unit: str, **more) -> EffectKind:
    return EffectKind(acts="environment", place=(), size=size, neutral=0.0, unit=unit, **more)


# A stiffness factor multiplies Young's modulus of the members named; flexibilities are rotational, given as the length
# of the member itself that would turn as much. Bays and tower stations count from 1 at the bottom.
EFFECTS: Mapping[str, EffectKind] = MappingProxyType({
    "brace_stiffness": _factor("bay", "face", high=1.0),  # all four half braces of a face
    "single_brace": _factor("bay", "face", "brace", high=1.0),  # 1 rises from the face's first leg, 2 from the other
    "joint_stiffness": _factor("bay", "face", "leg", "end"),  # one brace end: leg and "bottom" or "top"
    "leg_stiffness": _factor("leg", "bay"),
    "grout_flexibility": _structural(("leg",), "equivalent_length_m", "m", low=0.0),  # leg foot on its pile head
    "tp_flexibility": _structural(("leg",), "equivalent_length_m", "m", low=0.0),  # leg top to transition piece
    "tp_stiffness": _factor("part"),  # column, strut or tie
    "flange_flexibility": _structural(("station",), "equivalent_length_m", "m", low=0.0),
    "tower_stiffness": _factor("bottom_m", "top_m"),
    "tower_mass": _structural(("bottom_m", "top_m"), "mass_kg", "kg"),
    "tp_mass": _structural((), "mass_kg", "kg"),
    "scour": _structural(("leg",), "depth_m", "m", low=0.0),
    "soil_stiffness": _factor("leg", "direction", high=10.0),  # lateral, axial, tip or all
    "marine_growth": _structural(("leg", "bottom_m", "top_m"), "thickness_m", "m"),  # leg "all": braces too
    "brace_flooding": _structural(("bay", "face"), "fraction", "-", low=0.0, high=1.0),
    "leg_water": _structural(("leg",), "fraction", "-", low=-1.0, high=1.0),  # -1: a flooded leg is dry
    "corrosion": _structural(("leg", "bottom_m", "top_m"), "loss_m", "m", low=0.0),  # outer wall; "all": braces too
    "rna_mass": _structural((), "mass_kg", "kg"),
    "rna_offset": _structural(("axis",), "offset_m", "m"),
    "rna_inertia": _structural(("axis",), "inertia_kgm2", "kg m2"),
    "blade_coupling": _structural(("frequency_hz",), "mass_kg", "kg", low=0.0),  # part of the hub, moves fore-aft
    # environmental: follow a covariate unless stated otherwise
    "wetted_length": _environmental("gain", "m/m", time_profile=_follows("water_level_m", 0.0, 1.0)),
    "steel_temperature": _environmental("per_kelvin", "1/K", time_profile=_follows("air_temperature_c", 15.0, 1.0)),
    "soil_softening": _environmental("per_unit", "-", time_profile=_follows("amplitude", 1.0, 1.0)),
    "icing": _environmental("mass_kg", "kg", low=0.0),
    "p_delta": _environmental("scale", "-"),  # weight above on the tower's deflection, 1: all of it
    # measurement
    "sensor_gain": _sensor_effect(("channel",), "factor", "-", 1.0),
    "sensor_swap": _sensor_effect(("channel", "other"), "swapped", "-", low=0.0, high=1.0),
    "sensor_rotation": _sensor_effect(("channel",), "angle_deg", "deg"),  # its whole housing, about the vertical
    "sensor_height": _sensor_effect(("level",), "height_m", "m"),  # a level's sensors sit farther up their members by
    "sensor_gravity": _sensor_effect((), "share", "-", low=0.0, high=1.0),  # all the other way than stated
    "frame_rotation": _sensor_effect((), "angle_deg", "deg"),
    "heading_offset": _sensor_effect((), "angle_deg", "deg"),  # of SCADA's nacelle heading
    "clock_offset": _sensor_effect(("level",), "offset_s", "s"),  # the logger of a level is late by
    "sampling_rate": _sensor_effect((), "ratio", "-", 1.0, low=0.5, high=2.0),  # samples taken per sample stated
    "low_pass": _sensor_effect(("level",), "time_constant_s", "s", low=0.0),
    # what no list of causes holds
    "tuned_mass": _structural(("z_m", "direction_deg", "frequency_hz"), "mass_kg", "kg", low=0.0, inside=False),
    "cable": _structural(("leg", "z_m", "tower_z_m"), "stiffness_npm", "N/m", low=0.0, inside=False),
    "fender": _structural(("leg", "z_m", "direction_deg"), "stiffness_npm", "N/m", low=0.0, inside=False),
    # a mass beside the leg, held by springs in both horizontal directions and carried by it
    "second_structure": _structural(("leg", "z_m", "frequency_hz"), "mass_kg", "kg", low=0.0, inside=False),
    "odd_mass": _structural(("bay", "face"), "mass_kg", "kg", low=0.0, inside=False),  # hung on the crossing
    "crosstalk": _sensor_effect(("channel", "other"), "share", "-", inside=False),
    "mount_resonance": _sensor_effect(("channel",), "period_s", "s", low=0.0, inside=False),
})
OPTIONAL_PLACE = ("bottom_m", "top_m")  # without them a band is as long as the structure
NOT_ALL = {"sensor_gain", "sensor_swap", "sensor_rotation", "crosstalk", "mount_resonance"}


def is_number(value) -> bool:
    return not isinstance(value, bool) and isinstance(value, (int, float)) and bool(np.isfinite(value))


def faces(file: TurbineFile) -> tuple[str, ...]:
    legs = file.value("jacket", "leg_names")
    return tuple(f"{a}{b}" for a, b in zip(legs, (*legs[1:], legs[0]), strict=True))


def _choices(file: TurbineFile, key: str) -> tuple:
    """What a place's key may say, besides a number."""
    if key in ("channel", "other"):
        return tuple(s.channel for s in file.sensors)
    if key == "level":
        return tuple(dict.fromkeys(s.level for s in file.sensors))
    return {
        "leg": tuple(file.value("jacket", "leg_names")), "face": faces(file), "end": ("bottom", "top"),
        "part": ("column", "strut", "tie"), "direction": ("lateral", "axial", "tip"), "axis": ("x", "y", "z"),
    }[key]


def _count_parts(file: TurbineFile, key: str) -> int:
    return {"bay": len(file.value("jacket", "bay")), "station": len(file.value("tower", "station")), "brace": 2}[key]


def read_effect(path, number: int, entry: Mapping, file: TurbineFile) -> Mapping:
    """Check one [[effect]] against the turbine; returns it, as given and complete."""
    where = f"{path}, effect {number + 1}"
    name = entry.get("kind", "")
    if name not in EFFECTS:
        raise unknown_name(where, str(name), tuple(EFFECTS))
    kind = EFFECTS[name]
    if FORMER_KEY in entry and "time_profile" not in entry:
        entry = {"time_profile" if key == FORMER_KEY else key: value for key, value in entry.items()}
    time_profile = entry.get("time_profile", kind.time_profile["time_profile"])
    if time_profile not in TIME_PROFILES:
        raise unknown_name(f"{where}, time_profile", str(time_profile), TIME_PROFILES)
    keys = (*kind.place, kind.size)
    for key in entry:
        if key not in ("kind", "time_profile", *keys, *PROFILE_KEYS[time_profile]):
            raise unknown_name(where, key, (*keys, "time_profile", *PROFILE_KEYS[time_profile]))
    for key in keys:
        if key not in entry and key not in OPTIONAL_PLACE:
            raise InputError(where, f"{key} is missing", f"a {name} needs {', '.join(keys)}")
    for key in kind.place:
        if key in entry:
            _check_place(f"{where}, {key}", name, key, entry[key], file)
    _check_extent(where, name, entry, file)
    size = entry[kind.size]
    if not is_number(size):
        raise InputError(f"{where}, {kind.size}", f"{size!r} is not a number", f"give one in {kind.unit}")
    largest = LARGEST_SIZE.get(kind.unit, LARGEST)
    low, high = max(kind.low, -largest), min(kind.high, largest)
    if not low <= size <= high or (kind.neutral == 1.0 and size == 0):
        opening = "(" if kind.neutral == 1.0 and kind.low == 0 else "["
        raise InputError(f"{where}, {kind.size}", f"{size} is not in {opening}{low:g}, {high:g}]",
                         "no number other than zero" if kind.low == -np.inf else "give what is left"
                         if kind.size == "factor" else f"give it in {kind.unit}")
    _check_profile(where, time_profile, entry, kind)
    return MappingProxyType(dict(entry))


def _check_place(where: str, kind: str, key: str, value, file: TurbineFile) -> None:
    if key in ("bay", "station", "brace"):
        if value == ALL and key != "station":
            return
        if isinstance(value, bool) or value not in range(1, _count_parts(file, key) + 1):
            raise InputError(where, f"{value!r} does not exist", "count from 1, the lowest")
    elif key.endswith(("_m", "_deg", "_hz")):
        if not is_number(value) or (key == "frequency_hz" and value <= 0):
            raise InputError(where, f"{value!r} is not a number", "give one in the unit of its name")
    else:
        known = _choices(file, key)
        if value == ALL and kind not in NOT_ALL:
            return
        if value not in known:
            raise unknown_name(where, str(value), known)


def _check_extent(where: str, kind: str, entry: Mapping, file: TurbineFile) -> None:
    """Heights lie on what they are heights of, a band has a length there, and two channels are not one."""
    stations, bays = file.value("tower", "station"), file.value("jacket", "bay")
    tower = [s["z_m"] for s in stations]
    # above their uppermost bay legs go on
    legs = [*(bay["bottom_m"] for bay in bays), file.value("jacket", "top")["z_m"]]
    on_tower = kind.startswith("tower_") or kind == "tuned_mass"
    for key in ("z_m", "tower_z_m"):
        at = tower if on_tower or key == "tower_z_m" else legs
        if key in entry and not min(at) <= entry[key] <= max(at):
            raise InputError(f"{where}, {key}", f"{entry[key]:g} m is not on the {'tower' if at is tower else 'legs'}",
                             f"give one from {min(at):g} to {max(at):g} m")
    at = tower if on_tower else legs
    low, high = entry.get("bottom_m", -np.inf), entry.get("top_m", np.inf)
    if not max(low, min(at)) < min(high, max(at)):
        raise InputError(f"{where}, bottom_m", f"{low:g} to {high:g} m is not a length of the "
                         f"{'tower' if on_tower else 'legs'}", f"give bottom_m below top_m, from {min(at):g} to "
                         f"{max(at):g} m")
    if "other" in entry and entry["other"] == entry.get("channel"):
        raise InputError(f"{where}, other", f"{entry['other']} is the channel itself", "name another one")


def _check_profile(where: str, time_profile: str, entry: Mapping, kind: EffectKind) -> None:
    for key in PROFILE_KEYS[time_profile]:
        value = entry.get(key, kind.time_profile.get(key))
        if value is None:
            raise InputError(where, f"{key} is missing",
                             f"a {time_profile} needs {', '.join(PROFILE_KEYS[time_profile])}")
        if key == "covariate":
            if value not in COVARIATES:
                raise unknown_name(f"{where}, covariate", str(value), COVARIATES)
        elif not is_number(value) or (key == "scale" and value == 0):
            raise InputError(f"{where}, {key}", f"{value!r} is not a usable number", "give hours, or the unit of x")
    if time_profile == "ramp" and not entry["from_hour"] < entry["to_hour"]:
        raise InputError(where, "the ramp ends before it starts", "give from_hour below to_hour")


def refuse_late(effects: Sequence[Mapping], hours: float, where: str) -> None:
    """Raises InputError for an effect that begins when the record has ended."""
    for number, effect in enumerate(effects, start=1):
        written = {**EFFECTS[effect["kind"]].time_profile, **effect}
        key = {"step": "at_hour", "ramp": "from_hour"}.get(written["time_profile"])
        if key and written[key] >= hours:
            raise InputError(f"{where}, effect {number} ({effect['kind']}), {key}",
                             f"{written[key]:g} is after the record's end at {hours:g} h", "give less, or more days")


def amounts(effects: Sequence[Mapping], hour: np.ndarray, covariate: Mapping[str, np.ndarray]) -> np.ndarray:
    """How much of each effect there is: (n_time, n_effect) at hours after the start, covariates (n_time,) by name."""
    hour = np.asarray(hour, float)
    table = np.ones((len(hour), len(effects)))
    for column, effect in enumerate(effects):
        written = {**EFFECTS[effect["kind"]].time_profile, **effect}
        if written["time_profile"] == "step":
            table[:, column] = hour >= written["at_hour"]
        elif written["time_profile"] == "ramp":
            table[:, column] = np.clip((hour - written["from_hour"]) / (written["to_hour"] - written["from_hour"]), 0.0,
                                       1.0)
        elif written["time_profile"] == "covariate":
            table[:, column] = (covariate[written["covariate"]] - written["reference"]) / written["scale"]
    return table


@dataclass(frozen=True, eq=False, kw_only=True)
class HiddenEffects:
    """Effects at one instant: what a builder asks of them. `amount` (n_effect,)."""

    effects: tuple[Mapping, ...] = ()
    amount: tuple[float, ...] = ()

    def acting(self, kind: str, **place) -> list[tuple[Mapping, float]]:
        """Effects of a kind that act at a place, with their size now; a place of an effect may be 'all'."""
        about = EFFECTS[kind]
        found = []
        for effect, amount in zip(self.effects, self.amount, strict=True):
            if effect["kind"] == kind and all(effect[key] in (value, ALL) for key, value in place.items()):
                found.append((effect, about.neutral + amount * (effect[about.size] - about.neutral)))
        return found

    def factor(self, kind: str, **place) -> float:
        """Product of the sizes; 1 where none acts."""
        product = 1.0
        for _, size in self.acting(kind, **place):
            product *= size
        return max(product, SMALLEST_FACTOR) if EFFECTS[kind].low == 0 else product

    def total(self, kind: str, **place) -> float:
        """Sum of the sizes; 0 where none acts."""
        return sum((size for _, size in self.acting(kind, **place)), 0.0)

    def acting_in_band(self, kind: str, z_m: float, **place) -> list[tuple[Mapping, float]]:
        """Effects of a kind whose band bottom_m to top_m holds the level."""
        return [(e, size) for e, size in self.acting(kind, **place)
                if e.get("bottom_m", -np.inf) < z_m < e.get("top_m", np.inf)]


def hidden_words(entry: Mapping) -> str:
    """An effect of truth.toml in words: "leg stiffness, leg B, bay 4: factor 0.75, from hour 12 on"."""
    kind = EFFECTS[entry["kind"]]
    place = [f"{key.replace('_', ' ')} {entry[key]}" for key in kind.place if key in entry]
    unit = "" if kind.unit == "-" else f" {kind.unit}"
    size = f"{kind.size.removesuffix('_' + kind.unit).replace('_', ' ')} {entry[kind.size]:g}{unit}"
    time_profile = entry.get("time_profile", kind.time_profile["time_profile"])
    along = {"constant": "all through the record", "step": f"from hour {entry.get('at_hour', 0):g} on",
             "ramp": f"growing from hour {entry.get('from_hour', 0):g} to {entry.get('to_hour', 0):g}",
             "covariate": f"with {entry.get('covariate', kind.time_profile.get('covariate', ''))}"}[time_profile]
    return f"{', '.join([entry['kind'].replace('_', ' '), *place])}: {size}, {along}"
