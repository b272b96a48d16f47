"""Cases of the blind study: what is hidden, what would be the right answer, and everything from a number.

A case is a virtual turbine of its own (parameters from the prior, tolerances drawn) with none, one or two effects. The
place and the severity are uniform over the catalogue; severities of singles lie between the limit that the diagnosis
states for such a turbine (limits.json, from nulls) and the most that the kind allows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

# growth ends where the model means it to: a size is of the same stretch
GROWTH_TOP_M = -2.0
LEGS, FACES, BAYS = "ABCD", ("AB", "BC", "CD", "DA"), (1, 2, 3, 4)
STATIONS_M = (18.0, 42.0, 66.0, 90.0)
LEVELS = {"TP": "all of TP", "tower bottom": "T18", "tower 2/3": "T66", "tower top": "T90"}
CHANNELS = (*(f"TP-{leg}-{axis}" for leg in LEGS for axis in "xyz"),
            *(f"T{z}-{axis}" for z in (18, 66, 90) for axis in "xy"))
DAYS, HOURS = 30.0, 720.0
FAMILIES = {"null": 200, "single": 200, "outside": 50, "pair": 40, "twin": 40, "below": 40, "month": 40}
# a family's place seeds its cases: a new one goes last
STREAMS = ("below", "null", "outside", "pair", "single", "twin", "month")
STEEL_PER_DEGC = -3.6e-4
# 6.4 m by 25.5 mm of steel at the tower's foot, times k_t: what makes a length of tower of a flexibility
FOOT_EI_GNM2 = 1.83 * 210.0 * np.pi / 8 * 6.3745**3 * 0.0255


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A row of what can be hidden: `virtual` the simulator's kind, `cause` the catalogue's; place(rng) -> (the
    simulator's keys, the catalogue's location); `size` the simulator's key, from the catalogue's size by `convert`; low
    and high the catalogue's sizes; time profiles it may take."""

    virtual: str
    cause: str
    place: Callable
    size: str
    low: float
    high: float
    convert: Callable[[float], float] = float
    time_profiles: tuple[str, ...] = ("constant", "step")
    klass: str = "structural"


def _left(size: float) -> float:
    return 1.0 + size


def _bay_face(rng):
    bay, face = int(rng.choice(BAYS)), str(rng.choice(FACES))
    return {"bay": bay, "face": face}, f"face {face}, bay {bay}"


def _joints(rng):
    place, where = _bay_face(rng)
    return {**place, "leg": "all", "end": "all"}, where


def _bay_leg(rng):
    bay, leg = int(rng.choice(BAYS)), str(rng.choice(list(LEGS)))
    return {"bay": bay, "leg": leg}, f"leg {leg}, bay {bay}"


def _leg(prefix: str = "leg"):
    def place(rng):
        leg = str(rng.choice(list(LEGS)))
        return {"leg": leg}, f"{prefix} {leg}"

    return place


def _leg_or_all(word: str, **hidden):
    def place(rng):
        leg = str(rng.choice([*LEGS, "all"]))
        return {"leg": leg, **hidden}, word if leg == "all" else f"leg {leg}"

    return place


def _soil(direction: str):
    def place(rng):
        leg = str(rng.choice(list(LEGS)))
        return {"leg": leg, "direction": direction}, f"leg {leg}"

    return place


def _fixed(keys: Mapping, where: str):
    return lambda rng: (dict(keys), where)


def _band(rng):
    k = int(rng.integers(3))
    low, high = STATIONS_M[k : k + 2]
    return {"bottom_m": low, "top_m": high}, f"{low:g} to {high:g} m"


def _axis(rng):
    axis = str(rng.choice(list("xyz")))
    return {"axis": axis}, f"along the nacelle's {axis}"


def _turning_axis(rng):
    axis = str(rng.choice(list("xyz")))
    return {"axis": axis}, f"about the nacelle's {axis}"


def _channel(rng):
    channel = str(rng.choice(CHANNELS))
    return {"channel": channel}, channel


def _two_channels(rng):
    level = str(rng.choice(["TP", "T18", "T66", "T90"]))
    a, b = sorted(rng.choice([c for c in CHANNELS if c.startswith(level)], 2, replace=False), key=CHANNELS.index)
    return {"channel": str(a), "other": str(b)}, f"{a} and {b}"


def _housing(rng):
    name = str(rng.choice(["TP-A", "TP-B", "TP-C", "TP-D", "T18", "T66", "T90"]))
    return {"channel": f"{name}-x"}, f"{name} about z"


def _level(rng):
    level = str(rng.choice(list(LEVELS)))
    return {"level": level}, LEVELS[level]


KINDS = (
    Kind(virtual="brace_stiffness", cause="brace stiffness lost", place=_bay_face, size="factor", low=-0.2, high=-0.95,
         convert=_left),
    Kind(virtual="joint_stiffness", cause="joints loosened", place=_joints, size="factor", low=-0.5, high=-0.95,
         convert=_left),
    Kind(virtual="leg_stiffness", cause="leg stiffness lost", place=_bay_leg, size="factor", low=-0.1, high=-0.6,
         convert=_left),
    Kind(virtual="scour", cause="scour", place=_leg_or_all("all legs"), size="depth_m", low=0.2, high=4.0,
         time_profiles=("constant", "step", "ramp")),
    Kind(virtual="soil_stiffness", cause="lateral soil stiffness", place=_soil("lateral"), size="factor", low=-0.3,
         high=-0.8, convert=_left),
    Kind(virtual="soil_stiffness", cause="axial soil stiffness", place=_soil("axial"), size="factor", low=-0.3,
         high=-0.8, convert=_left),
    Kind(virtual="marine_growth", cause="marine growth", place=_leg_or_all("all members", top_m=GROWTH_TOP_M),
         size="thickness_m", low=0.03, high=0.2, time_profiles=("constant", "ramp")),
    Kind(virtual="leg_water", cause="leg not flooded", place=_leg(), size="fraction", low=-0.5, high=-1.0),
    Kind(virtual="flange_flexibility", cause="tower flange flexibility", place=_fixed({"station": 1}, "tower at 18 m"),
         size="equivalent_length_m", low=1e-3, high=0.02, convert=lambda size: size * FOOT_EI_GNM2),
    Kind(virtual="rna_mass", cause="nacelle mass", place=_fixed({}, "nacelle"), size="mass_kg", low=5e3, high=6e4),
    Kind(virtual="rna_offset", cause="RNA centre of mass", place=_axis, size="offset_m", low=0.3, high=1.5,
         time_profiles=("constant",)),
    Kind(virtual="rna_inertia", cause="RNA inertia", place=_turning_axis, size="inertia_kgm2", low=1e6, high=2e7,
         time_profiles=("constant",)),
    Kind(virtual="tower_mass", cause="tower mass", place=_band, size="mass_kg", low=5e3, high=4e4),
    Kind(virtual="tower_stiffness", cause="tower stiffness", place=_band, size="factor", low=-0.05, high=-0.4,
         convert=_left, time_profiles=("constant",)),
    Kind(virtual="tp_mass", cause="transition-piece mass", place=_fixed({}, "column"), size="mass_kg", low=1e4,
         high=1.5e5),
    Kind(virtual="wetted_length", cause="wetted length", place=_fixed({}, "all members"), size="gain", low=0.3,
         high=2.0, time_profiles=("own",), klass="environmental"),
    Kind(virtual="steel_temperature", cause="temperature of the steel", place=_fixed({}, "above the water"),
         size="per_kelvin", low=0.5, high=4.0, convert=lambda size: size * STEEL_PER_DEGC, time_profiles=("own",),
         klass="environmental"),
    Kind(virtual="soil_softening", cause="soil softens with amplitude", place=_fixed({}, "all legs"),
         size="per_unit", low=0.05, high=0.4, time_profiles=("own",), klass="environmental"),
    Kind(virtual="icing", cause="icing", place=_fixed({}, "rotor"), size="mass_kg", low=3e3, high=2e4,
         time_profiles=("step",), klass="environmental"),
    Kind(virtual="sensor_gain", cause="sensor gain", place=_channel, size="factor", low=0.03, high=0.4, convert=_left,
         klass="measurement"),
    Kind(virtual="sensor_gain", cause="sensor polarity", place=_channel, size="factor", low=-2.0, high=-2.0,
         convert=_left, time_profiles=("constant",), klass="measurement"),
    Kind(virtual="sensor_swap", cause="swapped channels", place=_two_channels, size="swapped", low=1.0, high=1.0,
         time_profiles=("constant",), klass="measurement"),
    Kind(virtual="sensor_rotation", cause="sensor rotation", place=_housing, size="angle_deg", low=4.0, high=45.0,
         klass="measurement"),
    Kind(virtual="frame_rotation", cause="rotated sensor frame", place=_fixed({}, "all sensors"), size="angle_deg",
         low=4.0, high=30.0, time_profiles=("constant",), klass="measurement"),
    Kind(virtual="clock_offset", cause="clock offset", place=_level, size="offset_s", low=3.0, high=60.0,
         convert=lambda ms: ms / 1000, klass="measurement"),
    Kind(virtual="low_pass", cause="low-pass filter", place=_level, size="time_constant_s", low=5.0, high=60.0,
         convert=lambda ms: ms / 1000, klass="measurement"),
)

OUTSIDE = (
    lambda rng: {"kind": "tuned_mass", "z_m": float(rng.uniform(40, 75)), "direction_deg": float(rng.uniform(0, 180)),
                 "frequency_hz": float(rng.uniform(1.2, 2.2)), "mass_kg": float(rng.uniform(2e3, 8e3))},
    lambda rng: {"kind": "cable", "leg": str(rng.choice(list(LEGS))), "z_m": 13.0,
                 "tower_z_m": float(rng.uniform(40, 85)), "stiffness_npm": float(10 ** rng.uniform(7, 8))},
    lambda rng: {"kind": "fender", "leg": str(rng.choice(list(LEGS))), "z_m": float(rng.uniform(-4, 8)),
                 "direction_deg": float(rng.uniform(0, 180)), "stiffness_npm": float(10 ** rng.uniform(6.7, 7.7))},
    lambda rng: {"kind": "odd_mass", "bay": int(rng.choice(BAYS)), "face": str(rng.choice(FACES)),
                 "mass_kg": float(rng.uniform(2e4, 8e4))},
    lambda rng: {"kind": "crosstalk", "share": float(rng.uniform(0.1, 0.5)),
                 **dict(zip(("channel", "other"), map(str, rng.choice(CHANNELS, 2, replace=False)), strict=True))},
    lambda rng: {"kind": "mount_resonance", "channel": str(rng.choice(CHANNELS)),
                 "period_s": float(rng.uniform(0.15, 0.4))},
)

# what frequencies and shapes of one kind of record cannot distinguish: either name, and the other beside it
TWINS = (
    ("icing", "nacelle mass"), ("joints loosened", "brace stiffness lost"), ("marine growth", "wetted length"),
    ("leg not flooded", "marine growth"),
)


@dataclass(frozen=True, kw_only=True)
class Case:
    """`truth` and `options` for simulate_modes; `effects` what is hidden, in the catalogue's words: (class, cause,
    location, time profile, size)."""

    family: str
    number: int
    seed: int
    truth: Mapping
    options: Mapping = field(default_factory=dict)
    effects: tuple[Mapping, ...] = ()

    @property
    def id(self) -> str:
        return f"{self.family}-{self.number:03d}"


def limit_of(limits: Mapping | None, kind: Kind, location: str, time_profile: str) -> float | None:
    """The stated limit as a size, None where the row has none or cannot be reached."""
    if limits is None:
        return None
    return limits.get(f"{kind.cause} | {location} | {time_profile}")


def draw_effect(rng: np.random.Generator, kind: Kind, limits: Mapping | None = None, *, below: bool = False):
    """One effect of a kind: ([[effect]], its words), or None where no severity is above (below) the stated limit."""
    keys, location = kind.place(rng)
    time_profile = str(rng.choice(kind.time_profiles))
    share, hour = rng.random(), float(rng.uniform(0.3, 0.7) * HOURS)
    stated = limit_of(limits, kind, location, time_profile)
    low, high = abs(kind.low), abs(kind.high)
    if limits is not None and time_profile != "own":
        if stated is None and not below:
            return None
        if stated is not None:
            low, high = (0.1 * abs(stated), 0.6 * abs(stated)) if below else (max(low, 1.05 * abs(stated)), high)
        if not low <= high:
            return None
    size = float(np.sign(kind.high) * (low + share * (high - low)))
    hidden = {"kind": kind.virtual, **keys, kind.size: kind.convert(size)}
    if time_profile == "step":
        hidden |= {"time_profile": "step", "at_hour": hour}
    elif time_profile == "ramp":
        hidden |= {"time_profile": "ramp", "from_hour": 0.0, "to_hour": HOURS}
    words = {"class": kind.klass, "cause": kind.cause, "location": location,
             "time_profile": time_profile, "size": size}
    return hidden, words


def _draw(rng, limits, *, below: bool = False, kinds=KINDS):
    while True:
        found = draw_effect(rng, kinds[int(rng.integers(len(kinds)))], limits, below=below)
        if found is not None:
            return found


def make_case(family: str, number: int, limits: Mapping | None = None) -> Case:
    """The case of that number; the same forever."""
    rng = np.random.default_rng([STREAMS.index(family), number])
    seed = int(rng.integers(2**31))
    truth: dict = {"parameters_from": "prior"}
    options: dict = {"days": DAYS, "n_block": 48}
    hidden: list = []
    words: list = []
    if family == "null":
        _trap(number, rng, truth, options)
    elif family == "month":
        # nothing hidden, but so many sets that what the model's theory leaves out stands far above their scatter
        options |= {"n_block": 400, "states": ["idling", "below rated", "rated"]}
    elif family in ("single", "below"):
        chosen = _draw(rng, limits, below=family == "below")
        hidden, words = [chosen[0]], [chosen[1]]
    elif family == "outside":
        hidden = [OUTSIDE[number % len(OUTSIDE)](rng)]
    elif family == "pair":
        chosen = [_draw(rng, limits) for _ in range(2)]
        while chosen[1][1]["cause"] == chosen[0][1]["cause"]:
            chosen[1] = _draw(rng, limits)
        hidden, words = [c[0] for c in chosen], [c[1] for c in chosen]
    elif family == "twin":
        cause = TWINS[number % len(TWINS)][(number // len(TWINS)) % 2]
        chosen = _draw(rng, limits, kinds=[k for k in KINDS if k.cause == cause])
        hidden, words = [chosen[0]], [chosen[1]]
    if hidden:
        truth["effect"] = hidden
    return Case(family=family, number=number, seed=seed, truth=truth, options=options, effects=tuple(words))


def _trap(number: int, rng, truth: dict, options: dict) -> None:
    """Nulls that may look like something: by turns plain, parameters far out, storms, gaps, a coarse simulator."""
    kind = number % 5
    if kind == 1:
        # two prior standard deviations of k_t, k_j, py and the rotor's mass, in random directions, as the updated file
        # has them
        sign = rng.choice([-1.0, 1.0], 4)
        options["shifts"] = dict(zip(("k_t", "k_j", "py", "m_h"), (2 * sign).tolist(), strict=True))
    elif kind == 2:
        truth["operation"] = {"wind_speed_mean_mps": 14.0}
        options["states"] = ["idling", "below rated", "rated"]
    elif kind == 3:
        options |= {"missing_share": 0.25, "n_block": 30}
    elif kind == 4:
        options["coarseness"] = 2.5
