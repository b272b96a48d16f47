"""A drawn structure in one form: its user's files, its sensors, and its truth as another program solves it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from drawn import hiding, jackets, matrices, monopiles, opensees_frame, plans, subdyn_files, toml_text
from drawn.hiding import PER_KELVIN, Hidden, on_parts
from drawn.skeleton import Change, State, in_state

PLANS = ("building", "truss", "bridge", "lattice", "monopile", "jacket")
# the kinds that are drawn, in turn
KINDS = ("turbine", *(f"matrices {k}" for k in PLANS), "subdyn lattice", "subdyn jacket", "subdyn monopile",
         "subdyn building", "turbine monopile", "subdyn tripod")
UNITS_OF_LENGTH_M = (1e-3, 1e5)
# elements of a member in OpenSees, whose mass is lumped
TRUE_PIECES = 8


@dataclass(frozen=True, kw_only=True)
class Solution:
    """Frequencies in Hz (n,), what the channels read (n_channel, n), tilts there about x and y (n_channel, 2, n)."""

    frequency_hz: np.ndarray
    shape: np.ndarray
    tilt: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """`write(folder)` -> arguments that name the model; `solve(changes, attached, level, warmer, count)` of the sound
    truth with these changes; `structural(rng)` something hidden in it, `environmental(rng)`, `unknown(rng)`."""

    kind: str
    title: str
    sensors: tuple[dict, ...]
    n_mode: int
    write: Callable[[Path], list[str]]
    solve: Callable[..., Solution]
    structural: Callable[[np.random.Generator], Hidden]
    environmental: Callable[[np.random.Generator], Hidden]
    unknown: Callable[[np.random.Generator], Hidden]
    truth: dict = field(default_factory=dict)
    is_turbine: bool = False


def draw(kind: str, seed: int, *, small: bool = False, designed: bool = False) -> Drawn:
    """The structure of a kind and seed, the same forever; small: of few members; designed: its truth is what the
    files say, with no parameter drawn."""
    rng = np.random.default_rng([KINDS.index(kind), seed, 7])
    if kind.startswith("turbine"):
        return _turbine(rng, kind, small, designed)
    form, plan = kind.split()
    return (_matrices if form == "matrices" else _subdyn)(rng, plan, designed)


def _read(motion: np.ndarray, sensors: Sequence[dict], rows: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Of motions (n_node, 6, n): what the channels read, and the tilts at them."""
    direction = np.array([s["direction"] for s in sensors])
    at = motion[list(rows)]
    return np.einsum("cd,cdn->cn", direction, at[:, :3]), at[:, 3:5]


# turbines ------------------------------------------------------------------------------------------------------------


def _turbine(rng, kind: str, small: bool, designed: bool) -> Drawn:
    on = monopiles if kind.endswith("monopile") else jackets
    raw = on.draw(rng, small=small)
    sound, theta = on.sound_state(raw, rng)
    if designed:
        sound, theta = State(), {row["name"]: row["initial"] for row in raw["parameter"]}
    sensors = tuple({k: s[k] for k in ("channel", "level", "position_m", "direction")} for s in raw["sensor"])
    base = on.skeleton(raw, theta, sound)
    nodes = [min(base.place, key=lambda n, p=s["position_m"]: np.linalg.norm(base.place[n] - p)) for s in sensors]
    known: dict = {}

    def solve(changes=(), attached=(), level=0.0, warmer=0.0, count=5, at=None) -> Solution:
        key = (repr(changes), attached, level, warmer, count, at)
        if key not in known:
            warm = Change(what="stiffness", on={"above": True}, value=1 + PER_KELVIN * warmer)
            state = replace(sound.with_changes(*changes, warm), attached=tuple(attached))
            frame = in_state(on.skeleton(raw, theta, state, level=level), state)
            names = list(dict.fromkeys(nodes)) if at is None else [at]
            f, motion = opensees_frame.modes(frame, count, names)
            if at is not None:
                known[key] = Solution(frequency_hz=f, shape=motion[0], tilt=motion[:, 3:5])
            else:
                known[key] = Solution(frequency_hz=f, **dict(zip(("shape", "tilt"), _read(
                    motion, sensors, [names.index(n) for n in nodes]), strict=True)))
        return known[key]

    def write(folder: Path) -> list[str]:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "model.toml").write_text(toml_text.text(raw), encoding="utf-8")
        return ["--model", str(folder / "model.toml")]

    anchors = on.anchors(raw, rng)
    return Drawn(kind=kind, title=raw["name"], sensors=sensors, n_mode=5, write=write, solve=solve, truth=theta,
                 structural=lambda r: on.fault(r, raw), environmental=lambda r: _turbine_weather(r),
                 unknown=lambda r: _unknown(r, anchors, solve, 5), is_turbine=True)


def _turbine_weather(rng) -> Hidden:
    kind = str(rng.choice(["temperature", "temperature", "water level"]))
    if kind == "temperature":
        return Hidden(kind="environmental", name=kind, follows="air_temperature_c", profile="air_temperature_c",
                      right=frozenset({("temperature of the steel", "above the water")}), size=1.0)
    return Hidden(kind="environmental", name=kind, follows="water_level_m", profile="water_level_m", size=1.0,
                  right=frozenset({("wetted length", "all members")}))


def _unknown(rng, anchors, solve, n_mode: int) -> Hidden:
    sound = solve(count=n_mode)

    def most(node, axis):
        phi = np.asarray(solve(count=n_mode, at=node).shape)[axis]
        number = int(np.argmax(phi**2 / sound.frequency_hz**2))
        return phi[number], number

    def strength(node, axis):
        phi, number = most(node, axis)
        return 0.02 * (2 * math.pi * sound.frequency_hz[number]) ** 2 / phi**2

    def modal_mass(node, axis):
        phi, number = most(node, axis)
        return 1 / phi**2, number

    return hiding.unknown(rng, anchors, strength, modal_mass, sound.frequency_hz)


# plans ---------------------------------------------------------------------------------------------------------------


def _plan_state(plan: plans.Plan, rng) -> tuple[State, dict]:
    """Parameters within two standard deviations of the prior."""
    theta = {p.name: 1 + float(np.clip(rng.standard_normal(), -2, 2)) * p.std for p in plan.parameters}
    return State(changes=tuple(Change(what=p.what, on=p.on, value=theta[p.name]) for p in plan.parameters)), theta


def _plan_sensors(plan: plans.Plan, *, states_level: bool) -> tuple[dict, ...]:
    return tuple({"channel": r.channel, "level": r.level, "direction": [float(r.axis == k) for k in range(3)],
                  "position_m": [float(x) for x in plan.skeleton.place[r.node]], "states_level": states_level}
                 for r in plan.readings)


def _plan_fault(rng, plan: plans.Plan) -> Hidden:
    p = plan.parameters[int(rng.integers(len(plan.parameters)))]
    more = p.what == "mass"
    size = float(rng.uniform(0.15, 0.5)) if more else -float(rng.uniform(0.25, 0.85))
    return Hidden(kind="structural", name=p.what, right=frozenset({("parameter", p.name)}), size=size,
                  profile=str(rng.choice(["step", "step", "constant"])),
                  changes=on_parts(p.what, p.on, lambda a: 1 + a * size))


def _plan_weather(rng) -> Hidden:
    return Hidden(kind="environmental", name="temperature", follows="air_temperature_c", profile="air_temperature_c",
                  right=frozenset({("stiffness with temperature", "all members")}), size=PER_KELVIN)


def _matrices(rng, kind: str, designed: bool) -> Drawn:
    low, high = np.log10((80, 160) if kind == "monopile" else UNITS_OF_LENGTH_M)
    plan = matrices.meshed(plans.draw(kind, rng, float(10 ** rng.uniform(low, high))))
    units, as_csr = str(rng.choice(list(matrices.UNITS))), bool(rng.random() < 0.5)
    picture = bool(rng.random() < 0.85)
    nodes = [r.node for r in plan.readings]

    def raw_solve(state, count, at):
        a = matrices.assembled(plan, state, finer=1)
        f, phi = a.modes(count)
        motion = np.zeros((len(nodes) if at is None else 1, 6, len(f)))
        for k, node in enumerate(nodes if at is None else [at]):
            for d in plan.dofs:
                if (node, d) in a.index:
                    motion[k, d] = phi[a.index[node, d]]
        return f, motion

    def write(folder):
        return matrices.write(plan, folder, units, as_csr=as_csr, picture=picture)

    words = f"{kind} of {max(np.ptp(list(plan.skeleton.place.values()), axis=0)):.3g} m, {units}"
    return _of_plan(rng, f"matrices {kind}", words, plan, write, raw_solve, designed)


def _subdyn(rng, kind: str, designed: bool) -> Drawn:
    extent = {"monopile": rng.uniform(80, 160), "jacket": rng.uniform(50, 140), "lattice": rng.uniform(20, 120),
              "building": rng.uniform(10, 80), "tripod": 90.0}[kind]
    plan = plans.draw(kind, rng, float(extent), bars=False)
    frame = plan.skeleton
    # water's mass has no table in the file; the truth's mesh is finer than the file's
    frame = replace(frame, members=tuple(replace(m, across_kgpm=0.0, pieces=TRUE_PIECES) for m in frame.members))
    layout, div = str(rng.choice(["v4", "v5"])), int(rng.choice([2, 3]))
    plan = matrices.meshed(replace(plan, skeleton=frame, pieces=div))
    nodes = [r.node for r in plan.readings]

    def raw_solve(state, count, at):
        names = list(dict.fromkeys(nodes)) if at is None else [at]
        f, motion = opensees_frame.modes(in_state(frame, state), count, names)
        return f, motion[[names.index(n) for n in nodes]] if at is None else motion

    def write(folder):
        return subdyn_files.write(plan, folder, fem=3, div=plan.pieces, layout=layout)

    return _of_plan(rng, f"subdyn {kind}", f"{kind} of {extent:.3g} m, SubDyn {layout}", plan, write, raw_solve,
                    designed)


def _of_plan(rng, kind, title, plan, write, raw_solve, designed) -> Drawn:
    sound, theta = (State(), {}) if designed else _plan_state(plan, rng)
    sensors, known = _plan_sensors(plan, states_level=kind.startswith("subdyn")), {}

    def solve(changes=(), attached=(), level=0.0, warmer=0.0, count=plan.n_mode, at=None) -> Solution:
        key = (repr(changes), attached, warmer, count, at)
        if key not in known:
            warm = Change(what="stiffness", on={}, value=1 + PER_KELVIN * warmer)
            f, motion = raw_solve(replace(sound.with_changes(*changes, warm), attached=tuple(attached)), count,
                                  at)
            shape, tilt = _read(motion, sensors, range(len(sensors))) if at is None else (motion[0], motion[:, 3:5])
            known[key] = Solution(frequency_hz=f, shape=shape, tilt=tilt)
        return known[key]

    return Drawn(kind=kind, title=title, sensors=sensors, n_mode=plan.n_mode, write=write, solve=solve, truth=theta,
                 structural=lambda r: _plan_fault(r, plan), environmental=lambda r: _plan_weather(r),
                 unknown=lambda r: _unknown(r, list(plan.anchors), solve, plan.n_mode))


