"""What is hidden in a case, the modal sets of its half hours, and the model as its user would bring it.

A case is made from its family and number alone, so that one line of a table can be looked at again. Everything that
the user's prior calls normal is drawn from it: tower, masses, soil of every pile, braces of every face, walls of
every bay of a leg, growth of every bay. Every half hour has its tide, its temperature and its wind.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import opensees_jacket as jacket
from opensees_jacket import Attached, Build, Description, State
from scipy.optimize import linear_sum_assignment

from probupdate.modal.modes import ModalData, ModalSet
from probupdate.virtual import modal_noise

# a family's place seeds its cases
FAMILIES = ("null", "single", "unknown", "mount", "moved")
N_BLOCK, N_MODE, DAMPING, BLOCK_S = 24, 5, 0.01, 1800.0
# in the order of their frequencies
MODES = ("FA1", "SS1", "FA2", "SS2", "T1")
START = np.datetime64("2024-03-01T00:00:00")
TIDE_M, TIDE_H, SURGE_M = 1.2, 12.42, 0.15
DAILY_K, DRIFT_K = 3.0, 2.0
MOUNT_DAMPING = 0.2
SOFTENING = 0.02  # share of the lateral soil stiffness lost at the strongest wind
# of the prior: what is normal
STD = {
    "k_tower": 0.03,
    "k_braces": 0.03,
    "m_rna": 0.03,
    "m_tp": 0.05,
    "soil": 0.3,
    "brace": 0.03,
    "wall": 0.02,
    "growth": 20.0,
    "lateral": 0.1,
    "axial": 0.1,
}
GROWTH_KGPM = 60.0
BAYS, LEGS, FACES = (1, 2, 3, 4), "ABCD", ("px", "mx", "py", "my")
WET_BAYS = (1, 2, 3)
MUD_BRACES = (33, 34, 35, 36)
# members of a leg from below, to bays; the topmost stub belongs to bay 4
LEG_MEMBERS = {
    (leg, bay): (
        (4 * k + 1, 4 * k + 2, 4 * k + 3, 4 * k + 4)
        if bay == 1
        else (17 + 4 * k + bay - 2,)
        if bay < 4
        else (19 + 4 * k, 20 + 4 * k)
    )
    for k, leg in enumerate(LEGS)
    for bay in BAYS
}
BRACE_MEMBERS = {
    (bay, face): tuple(range(37 + 16 * (bay - 1) + 4 * k, 41 + 16 * (bay - 1) + 4 * k))
    for bay in BAYS
    for k, face in enumerate(FACES)
}
PILES = (61, 62, 63, 64)
# joint and axes of the sensors: two levels of the jacket, the transition piece, the tower
SENSORS = tuple(
    (level, joint, axis)
    for level, joints, axes in (
        ("low", (5, 15), "xy"),
        ("mid", (21, 29), "xy"),
        ("TP", (24, 32), "xyz"),
        ("tower", (112, 124, 135), "xy"),
    )
    for joint in joints
    for axis in axes
)
CHANNELS = tuple(f"{level}-{joint}-{axis}" for level, joint, axis in SENSORS)


@dataclass(frozen=True)
class Effect:
    """What is hidden: its kind, the cause and place that a right answer gives, the size in the user's unit (nan where
    none is comparable), the time profile, and what it is made of."""

    kind: str
    cause: str
    location: str
    size: float
    time_profile: str
    parts: Mapping = field(default_factory=dict)


@dataclass(frozen=True)
class Case:
    family: str
    number: int
    effects: tuple[Effect, ...] = ()

    @property
    def id(self) -> str:
        return f"{self.family}-{self.number:03d}"


def _brace(rng):
    bay, face, lost = int(rng.choice(BAYS)), str(rng.choice(FACES)), float(rng.uniform(0.5, 0.95))
    # one of the two that cross: half of what the face's parameter stands for
    pair = BRACE_MEMBERS[bay, face][2 * int(rng.integers(2)) :][:2]
    return "parameter", f"brace_bay{bay}_{face}", -0.5 * lost, {"members": pair, "lost": lost}


def _corrosion(rng):
    bay, leg, lost = int(rng.choice(BAYS)), str(rng.choice(list(LEGS))), float(rng.uniform(0.08, 0.3))
    return "parameter", f"wall_bay{bay}_{leg}", -lost, {"members": LEG_MEMBERS[leg, bay], "lost": lost}


def _growth(rng):
    bay, thickness = int(rng.choice(WET_BAYS)), float(rng.uniform(0.04, 0.12))
    return "parameter", f"growth_bay{bay}", float("nan"), {"members": bay_members(bay), "thickness": thickness}


def _scour(rng):
    pile, lost = int(rng.choice(PILES)), float(rng.uniform(0.3, 0.7))
    return "parameter", f"lateral_{pile}", -lost, {"pile": pile, "lost": lost}


def _axial(rng):
    pile, lost = int(rng.choice(PILES)), float(rng.uniform(0.3, 0.7))
    return "parameter", f"axial_{pile}", -lost, {"pile": pile, "lost": lost}


def _ice(rng):
    more = float(rng.uniform(0.03, 0.1))
    return "parameter", "m_rna", more, {"more": more}


def _gain(rng):
    size = float(rng.choice([-1, 1]) * rng.uniform(0.04, 0.3))
    channel = str(rng.choice(CHANNELS))
    return "sensor gain", channel, size, {"channel": channel, "factor": 1 + size}


def _flip(rng):
    channel = str(rng.choice(CHANNELS))
    return "sensor polarity", channel, -2.0, {"channel": channel, "factor": -1.0}


def _swap(rng):
    level = str(rng.choice(["low", "mid", "TP", "tower"]))
    own = [c for c in CHANNELS if c.startswith(level)]
    a, b = sorted(rng.choice(own, 2, replace=False), key=CHANNELS.index)
    return "swapped channels", f"{a} and {b}", 1.0, {"swap": (str(a), str(b))}


# by number in turn: kind, how it is drawn, the time profiles it may have
KINDS = (
    ("brace", _brace, ("step", "constant")),
    ("gain", _gain, ("step", "constant")),
    ("corrosion", _corrosion, ("step", "constant")),
    ("flip", _flip, ("constant",)),
    ("scour", _scour, ("step", "constant")),
    ("swap", _swap, ("constant",)),
    ("growth", _growth, ("ramp", "constant")),
    ("axial", _axial, ("step", "constant")),
    ("ice", _ice, ("step",)),
)


def _cable(rng, d):
    leg, z, stiffness = str(rng.choice(list(LEGS))), float(rng.uniform(40, 85)), float(10 ** rng.uniform(7.3, 8.0))
    return Attached(joint=UPPER[leg], other=tower_joint(d, z), stiffness=stiffness)


def _fender(rng, d):
    leg, angle = str(rng.choice(list(LEGS))), float(np.radians(rng.uniform(0, 180)))
    stiffness = float(10 ** rng.uniform(7.2, 7.8))
    return Attached(joint=AT_WATER[leg], direction=(float(np.cos(angle)), float(np.sin(angle)), 0.0),
                    stiffness=stiffness)


def _tuned_mass(rng, d):
    return Attached(joint=tower_joint(d, float(rng.uniform(40, 80))), mass=float(rng.uniform(4e3, 1e4)),
                    frequency_hz=float(rng.uniform(0.8, 1.5)))


def _second_structure(rng, d):
    return Attached(joint=AT_WATER[str(rng.choice(list(LEGS)))], mass=float(rng.uniform(2e4, 6e4)),
                    frequency_hz=float(rng.uniform(0.8, 1.5)))


# what no row of the user's catalogue describes, by the elementary part that is like it
UPPER, AT_WATER = dict(zip(LEGS, (23, 27, 31, 35), strict=True)), dict(zip(LEGS, (22, 26, 30, 34), strict=True))
ATTACHED = {"cable": (_cable, "spring between two points"), "fender": (_fender, "spring to ground"),
            "tuned mass": (_tuned_mass, "mass on springs"), "second structure": (_second_structure, "mass on springs")}


def tower_joint(d: Description, z: float) -> int:
    joints = {joint for one, two, _ in d.tower.values() for joint in (one, two)}
    return min(joints, key=lambda joint: abs(float(d.place[joint][2]) - z))


def unknown_case(d: Description, number: int) -> Case:
    """By turns what is attached, throughout or, every other four, as a step."""
    rng = _stream(("unknown", number), 0)
    kind = list(ATTACHED)[number % len(ATTACHED)]
    draw, part = ATTACHED[kind]
    one = draw(rng, d)
    where = [[float(x) for x in d.place[joint]] for joint in (one.joint, one.other) if joint is not None]
    return Case("unknown", number, (Effect(kind, part, str(where), one.mass or one.stiffness,
                                           "step" if number // len(ATTACHED) % 2 else "constant",
                                           {"attached": (one,), "where": where}),))


def mount_case(number: int) -> Case:
    """A sensor on a mount that resonates above the modes, throughout or, every other one, as a step."""
    rng = _stream(("mount", number), 0)
    channel = str(rng.choice(CHANNELS))
    return Case("mount", number, (Effect("mount", "frequency response of its own", channel, np.nan,
                                         "step" if number % 2 else "constant",
                                         {"channel": channel, "resonance_hz": float(rng.uniform(2.5, 6.0))}),))


def moved_case(d: Description, number: int) -> Case:
    """The sensors of a joint of the jacket at the next joint along one of its members, throughout or, every other one,
    as a step."""
    rng = _stream(("moved", number), 0)
    at = int(rng.choice([joint for level, joint, axis in SENSORS if level in ("low", "mid") and axis == "x"]))
    beside = [two if one == at else one for one, two, _ in d.circular.values() if at in (one, two)]
    to = int(rng.choice([joint for joint in beside if joint not in d.piles]))
    name = next(f"{level}-{joint}" for level, joint, _ in SENSORS if joint == at)
    return Case("moved", number, (Effect("moved", "sensor at another place", name,
                                         float(np.linalg.norm(d.place[to] - d.place[at])),
                                         "step" if number % 2 else "constant", {"joint": at, "to": to}),))


def of_mount(frequency_hz: np.ndarray, resonance_hz: float) -> np.ndarray:
    """What a mount of one degree of freedom makes of each mode."""
    ratio = frequency_hz / resonance_hz
    return 1 / (1 - ratio**2 + 2j * MOUNT_DAMPING * ratio)


def bay_members(bay: int) -> tuple[int, ...]:
    legs = [m for leg in LEGS for m in LEG_MEMBERS[leg, bay]]
    mud = MUD_BRACES if bay == 1 else ()
    return (*legs, *mud, *(m for face in FACES for m in BRACE_MEMBERS[bay, face]))


def _stream(case_id: tuple[str, int], what: int) -> np.random.Generator:
    return np.random.default_rng([FAMILIES.index(case_id[0]), case_id[1], what])


def make_case(family: str, number: int) -> Case:
    """The case of that number, the same forever."""
    if family == "null":
        return Case(family, number)
    rng = _stream((family, number), 0)
    kind, draw, time_profiles = KINDS[number % len(KINDS)]
    cause, location, size, parts = draw(rng)
    return Case(family, number, (Effect(kind, cause, location, size, str(rng.choice(time_profiles)), parts),))


# the truth -------------------------------------------------------------------------------------------------------


def _within(rng, std: float, *shape: int) -> np.ndarray:
    """Normal, cut at two and a half standard deviations."""
    return std * np.clip(rng.standard_normal(shape), -2.5, 2.5)


def sound_state(d: Description, rng: np.random.Generator) -> State:
    """Drawn from the user's prior, nothing hidden."""
    common = {name: 1 + float(_within(rng, STD[name])) for name in ("k_tower", "k_braces", "m_rna", "m_tp")}
    soil = 1 + float(_within(rng, STD["soil"]))
    stiffness = {m: common["k_braces"] for m in MUD_BRACES}
    for members in BRACE_MEMBERS.values():
        own = common["k_braces"] * (1 + float(_within(rng, STD["brace"])))
        stiffness |= dict.fromkeys(members, own)
    wall, growth = {}, {}
    for members in LEG_MEMBERS.values():
        wall |= dict.fromkeys(members, 1 + float(_within(rng, STD["wall"])))
    for bay in WET_BAYS:
        grown = max(GROWTH_KGPM + float(_within(rng, STD["growth"])), 0.0)
        growth |= {m: _thickness(d, m, grown) for m in bay_members(bay)}
    piles = {
        p: (soil * (1 + float(_within(rng, STD["lateral"]))), soil * (1 + float(_within(rng, STD["axial"]))))
        for p in PILES
    }
    return State(
        stiffness=stiffness,
        wall=wall,
        growth_m=growth,
        tower=common["k_tower"],
        rna=common["m_rna"],
        transition=common["m_tp"],
        lateral={p: x[0] for p, x in piles.items()},
        axial={p: x[1] for p, x in piles.items()},
    )


def _thickness(d: Description, member: int, kgpm: float) -> float:
    """Of a layer that weighs so much with the water it displaces beyond the bare tube's."""
    diameter = d.tubes[d.circular[member][2]][3]
    a = np.pi * (jacket.GROWTH_KGPM3 + jacket.ADDED_MASS * jacket.WATER_KGPM3)
    return float((-diameter + np.sqrt(diameter**2 + 4 * kgpm / a)) / 2)


def damaged(state: State, effect: Effect, amount: float) -> State:
    """With `amount` (0 to 1) of an effect of the structure."""
    p = effect.parts

    def scaled(values, keys, factor):
        return {**values, **{k: values.get(k, 1.0) * factor for k in keys}}

    left = 1 - amount * p.get("lost", 0.0)
    if effect.kind == "brace":
        return replace(state, stiffness=scaled(state.stiffness, p["members"], left))
    if effect.kind == "corrosion":
        return replace(state, wall=scaled(state.wall, p["members"], left))
    if effect.kind == "growth":
        return replace(
            state,
            growth_m={
                **state.growth_m,
                **{m: state.growth_m.get(m, 0.0) + amount * p["thickness"] for m in p["members"]},
            },
        )
    if effect.kind == "scour":
        # what is left of the soil also holds the pile further down
        return replace(
            state, lateral=scaled(state.lateral, [p["pile"]], left), deeper_m={p["pile"]: 2.0 * amount * p["lost"]}
        )
    if effect.kind == "axial":
        return replace(state, axial=scaled(state.axial, [p["pile"]], left))
    if effect.kind in ATTACHED:
        # what has no mass yet is not there
        return replace(state, attached=(*state.attached, *p["attached"])) if amount else state
    if effect.kind == "ice":
        return replace(state, rna=state.rna * (1 + amount * p["more"]))
    return state


def seen(shape: np.ndarray, effect: Effect, amount: float, frequency_hz: np.ndarray | None = None) -> np.ndarray:
    """Shapes (n_channel, n_mode) through the sensors' faults; a mount's differs with the frequency (n_mode,)."""
    p = effect.parts
    result = np.array(shape)
    if effect.kind == "mount":
        result = result.astype(complex)
        result[CHANNELS.index(p["channel"])] *= 1 + amount * (of_mount(frequency_hz, p["resonance_hz"]) - 1)
    if effect.kind in ("gain", "flip"):
        result[CHANNELS.index(p["channel"])] *= 1 + amount * (p["factor"] - 1)
    elif effect.kind == "swap" and amount:
        a, b = (CHANNELS.index(c) for c in p["swap"])
        result[[a, b]] = result[[b, a]]
    return result


def true_modes(
    d: Description, state: State, elsewhere: Mapping[int, int] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (n_mode,) and shapes (n_channel, n_mode) at the sensors, largest component one, with all modes of
    masses that are attached. `elsewhere`: joints whose sensors sit at another one."""
    sensors = [(level, (elsewhere or {}).get(joint, joint), axis) for level, joint, axis in SENSORS]
    joints = list(dict.fromkeys(joint for _, joint, _ in sensors))
    # a mass of its own has two modes more, of which any may be like one that is looked for
    count = N_MODE + 2 * sum(one.mass > 0 for one in state.attached)
    frequency, shape = Build(d, state).modes(count, joints)
    rows = np.array([shape[joints.index(joint), "xyz".index(axis)] for _, joint, axis in sensors])
    return frequency, rows / np.abs(rows).max(axis=0)


def _as_named(frequency, shape, reference):
    """In the order, and with the signs, of the reference's shapes; without one the largest components are positive,
    as a solver's sign is chance."""
    if reference is None:
        return frequency, shape * np.sign(shape[np.argmax(np.abs(shape), axis=0), np.arange(N_MODE)])
    one = shape / np.linalg.norm(shape, axis=0)
    other = reference / np.linalg.norm(reference, axis=0)
    likeness = other.T @ one
    _, order = linear_sum_assignment(-np.abs(likeness))
    sign = np.sign(likeness[np.arange(N_MODE), order])
    return frequency[order], shape[:, order] * sign


def identified(frequency, shape, rng) -> ModalSet:
    """What a half hour's identification makes of true modes, as the virtual turbine has it (measured of SSI-cov):
    close modes turn into one another, every channel has its own scatter, and both are estimated with their
    covariance."""
    f, damping, phi, covariance_factors = modal_noise.identified_modes(
        frequency, np.full(N_MODE, DAMPING), shape, MODES, BLOCK_S, rng)
    return ModalSet(
        id="",
        frequency_hz=f,
        damping_ratio=damping,
        shape=phi,
        covariance_factors=covariance_factors,
        frequency_std_hz=np.full(N_MODE, np.nan),
        shape_std=np.full(phi.shape, np.nan),
    )


def as_stated(s: ModalSet, stated: str) -> ModalSet:
    """ "joint": covariances of all modes and channels beside modes.json, as `identify` writes them; "std": the
    standard
    deviations of each number by itself; "none": neither."""
    if stated == "joint":
        return s
    alone = replace(s, covariance_factors=None)
    if stated == "std":
        return alone
    return replace(alone, frequency_std_hz=np.full(N_MODE, np.nan), shape_std=np.full(s.shape.shape, np.nan))


def amount_of(effect: Effect, share: float, onset: float) -> float:
    """0 to 1, at a place of 0 to 1 along the record."""
    return {"constant": 1.0, "step": float(share >= onset), "ramp": share}[effect.time_profile]


def conditions(rng) -> list[dict[str, float]]:
    """Of each half hour, spread evenly over ten days: what SCADA states."""
    hours = np.linspace(0.0, 240.0, N_BLOCK) + rng.uniform(0, 1, N_BLOCK).round(1)
    tide = TIDE_M * np.sin(2 * np.pi * hours / TIDE_H + rng.uniform(0, 2 * np.pi)) + SURGE_M * rng.standard_normal(
        N_BLOCK
    )
    warm = 8 + DAILY_K * np.sin(2 * np.pi * hours / 24) + DRIFT_K * np.sin(2 * np.pi * hours / 240 + rng.uniform(0, 6))
    wind = np.clip(8 * rng.weibull(2.0, N_BLOCK), 0, 20)
    return [
        {"hour": float(h), "water_level_m": float(t), "air_temperature_c": float(w), "wind_speed_mps": float(v)}
        for h, t, w, v in zip(hours, tide, warm, wind, strict=True)
    ]


def record(d: Description, case: Case, *, stated: str = "joint", still: bool = False) -> ModalData:
    """The modal sets; `still`: neither tide nor temperature nor wind moves anything."""
    key = (case.family, case.number)
    state, rng = sound_state(d, _stream(key, 1)), _stream(key, 2)
    weather = conditions(_stream(key, 3))
    onset = float(_stream(key, 4).uniform(0.3, 0.7))
    mean = np.mean([w["air_temperature_c"] for w in weather])
    reference, sets = None, []
    if case.family == "unknown":
        # which of the modes with what is attached are looked for
        reference = _as_named(*true_modes(d, state), None)[1]
    for k, now in enumerate(weather):
        one = (
            state
            if still
            else replace(
                state,
                water_level_m=now["water_level_m"],
                warmer_k=now["air_temperature_c"] - mean,
                lateral={p: (1 - SOFTENING * now["wind_speed_mps"] / 20) * x for p, x in state.lateral.items()},
            )
        )
        for effect in case.effects:
            one = damaged(one, effect, amount_of(effect, k / (N_BLOCK - 1), onset))
        elsewhere = {e.parts["joint"]: e.parts["to"] for e in case.effects
                     if e.kind == "moved" and amount_of(e, k / (N_BLOCK - 1), onset)}
        frequency, shape = _as_named(*true_modes(d, one, elsewhere), reference)
        reference = shape
        for effect in case.effects:
            shape = seen(shape, effect, amount_of(effect, k / (N_BLOCK - 1), onset), frequency)
        start = START + np.timedelta64(round(3600 * now["hour"]), "s")
        sets.append(
            replace(
                as_stated(identified(frequency, shape, rng), stated),
                id=f"{start}Z",
                environment={n: v for n, v in now.items() if n != "hour"},
            )
        )
    # OpenSees' shapes are motions
    return ModalData(channels=CHANNELS, sets=tuple(sets), labels=MODES, gravity=(False,) * len(CHANNELS))


# the user's model ------------------------------------------------------------------------------------------------


def write_model(source: Path, folder: Path, d: Description) -> Path:
    """model.toml beside copies of the SubDyn files: what is updated, what may be wrong, the sensors."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in (jacket.INPUT, jacket.SOIL):
        shutil.copyfile(source / name, folder / name)
    water = {
        kind: jacket.ADDED_MASS * jacket.WATER_KGPM3 * np.pi / 4 * d.tubes[number][3] ** 2
        for kind, number in (("legs", 3), ("braces", 1))
    }

    def middle(member):
        one, two, _ = d.circular[member]
        return 0.5 * (d.place[one][2] + d.place[two][2])

    legs = [m for members in LEG_MEMBERS.values() for m in members]
    braces = [*MUD_BRACES, *(m for members in BRACE_MEMBERS.values() for m in members)]
    groups = {
        "tower": f"members = {sorted(d.tower)}",
        "rna": f"masses = [{jacket.TOP}]",
        "tp": f"masses = [{jacket.TRANSITION}]",
        "piles": f"reactions = {list(PILES)}",
        "braces": f"members = {braces}",
        "wet_legs": f"members = {[m for m in legs if middle(m) < 0]}",
        "wet_braces": f"members = {[m for m in braces if middle(m) < 0]}",
    }
    rows = [
        _row("k_tower", "stiffness", "tower", STD["k_tower"], words="stiffness of the tower"),
        _row("k_braces", "stiffness", "braces", STD["k_braces"], words="stiffness of all braces"),
        _row("m_rna", "mass", "rna", STD["m_rna"], words="mass of rotor and nacelle"),
        _row("m_tp", "mass", "tp", STD["m_tp"], words="mass of the transition piece"),
        _row("soil", "soil", "piles", STD["soil"], words="soil of all piles"),
        _row("water_legs", "line_mass", "wet_legs", 1.0, initial=water["legs"], unit="kg/m", update=False),
        _row("water_braces", "line_mass", "wet_braces", 1.0, initial=water["braces"], unit="kg/m", update=False),
    ]
    for pile in PILES:
        groups[f"pile_{pile}"] = f"reactions = [{pile}]"
        rows += [
            _row(f"{act}_{pile}", f"soil_{word}", f"pile_{pile}", STD[act], words=f"{word} soil of pile {pile}")
            for act, word in (("lateral", "lateral"), ("axial", "vertical"))
        ]
    for (bay, face), members in BRACE_MEMBERS.items():
        groups[f"face_{bay}_{face}"] = f"members = {list(members)}"
        rows.append(
            _row(
                f"brace_bay{bay}_{face}",
                "stiffness",
                f"face_{bay}_{face}",
                STD["brace"],
                words=f"stiffness of the braces of face {face}, bay {bay}",
            )
        )
    for (leg, bay), members in LEG_MEMBERS.items():
        groups[f"leg_{bay}_{leg}"] = f"members = {list(members)}"
        rows.append(
            _row(
                f"wall_bay{bay}_{leg}",
                "thickness",
                f"leg_{bay}_{leg}",
                STD["wall"],
                words=f"wall of leg {leg}, bay {bay}",
            )
        )
    for bay in WET_BAYS:
        groups[f"bay_{bay}"] = f"members = {list(bay_members(bay))}"
        rows.append(
            _row(
                f"growth_bay{bay}",
                "line_mass",
                f"bay_{bay}",
                STD["growth"],
                initial=GROWTH_KGPM,
                unit="kg/m",
                lower=0.0,
                upper=1000.0,
                words=f"growth and its water, bay {bay}",
            )
        )
    text = f'name = "OC4 jacket with tower"\n\n[subdyn]\nfile = "{jacket.INPUT}"\n'
    text += "".join(f"\n[group.{name}]\n{line}\n" for name, line in groups.items()) + "".join(rows)
    for channel, (level, joint, axis) in zip(CHANNELS, SENSORS, strict=True):
        text += (
            f'\n[[sensor]]\nchannel = "{channel}"\nlevel = "{level}"\njoint = {joint}\n'
            f"direction = {np.eye(3)['xyz'.index(axis)].tolist()}\n"
        )
    path = folder / "model.toml"
    path.write_text(text, encoding="utf-8")
    return path


def _row(name, acts, on, std, *, initial=1.0, unit="-", lower=0.05, upper=3.0, update=True, words="") -> str:
    text = (
        f'\n[[parameter]]\nname = "{name}"\nacts = "{acts}"\non = "{on}"\nunit = "{unit}"\n'
        f'initial = {float(initial)}\ndescription = "{words}"\n'
    )
    if not update:
        return text + "std = 1.0\nupdate = false\n"
    return text + f"std = {std}\nlower = {lower}\nupper = {upper}\n"
