"""What is hidden in a record: of the structure, of its surroundings, of the measurement, or in no catalogue."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from drawn.skeleton import Attached, Change

PER_KELVIN = -3.6e-4  # of E and G of steel
CLASSES = ("null", "structural", "environmental", "measurement", "unknown")


@dataclass(frozen=True, kw_only=True)
class Hidden:
    """`right`: (cause, location) that a right answer gives, any of them; size in the user's unit (nan where none is
    comparable); `changes(amount)`, `attached`: of the structure; `seen`: (shapes (n_channel, n), f, amount) -> shapes;
    `sets`: number -> column and level or warmth, for what follows the weather; `profile`: constant or step."""

    kind: str
    name: str
    right: frozenset[tuple[str, str]] = frozenset()
    size: float = float("nan")
    profile: str = "step"
    changes: Callable[[float], tuple[Change, ...]] | None = None
    attached: tuple[Attached, ...] = ()
    seen: Callable | None = None
    follows: str = ""
    settings: dict = field(default_factory=dict)


def on_parts(what, on, amount_to_value):
    return lambda amount: (Change(what=what, on=on, value=amount_to_value(amount)),)


def common(names) -> str:
    """What channels' names share at their beginning."""
    short = names[0]
    while short and not all(n.startswith(short) for n in names):
        short = short[:-1]
    return short.rstrip("-_ .")


def places(sensors) -> list[list[int]]:
    """Rows of the channels at one place."""
    found: dict[tuple, list[int]] = {}
    position = np.array([s["position_m"] for s in sensors])
    # of structures of a millimetre as of kilometres
    for k, at in enumerate(np.round(position / np.max(np.ptp(position, axis=0)), 4)):
        found.setdefault(tuple(at), []).append(k)
    return list(found.values())


def _factor(rows, value) -> Callable:
    def seen(shape, f, amount):
        result = np.array(shape, complex)
        result[rows] *= 1 + amount * (value - 1)
        return result
    return seen


def _gain(rng, sensors) -> Hidden:
    k = int(rng.integers(len(sensors)))
    size = float(rng.choice([-1, 1]) * rng.uniform(0.06, 0.4))
    name = sensors[k]["channel"]
    return Hidden(kind="measurement", name="gain", right=frozenset({("sensor gain", name)}), size=size,
                  seen=_factor([k], 1 + size))


def _polarity(rng, sensors) -> Hidden:
    k = int(rng.integers(len(sensors)))
    return Hidden(kind="measurement", name="polarity", size=-2.0, seen=_factor([k], -1.0),
                  right=frozenset({("sensor polarity", sensors[k]["channel"])}))


def _exchange(rng, sensors) -> Hidden:
    pairs = [(i, j) for i, a in enumerate(sensors) for j, b in enumerate(sensors) if i < j and a["level"] == b["level"]]
    if not pairs:
        return _polarity(rng, sensors)
    i, j = pairs[int(rng.integers(len(pairs)))]

    def seen(shape, f, amount):
        result = np.array(shape, complex)
        if amount:
            result[[i, j]] = result[[j, i]]
        return result
    names = (sensors[i]["channel"], sensors[j]["channel"])
    return Hidden(kind="measurement", name="exchange", size=1.0, seen=seen,
                  right=frozenset({("swapped channels", f"{names[0]} and {names[1]}")}))


def _rotation(rng, sensors) -> Hidden:
    level = [(p[0], p[1]) for p in places(sensors) if len(p) > 1
             and abs(sensors[p[0]]["direction"][2]) + abs(sensors[p[1]]["direction"][2]) == 0]
    if not level:
        return _gain(rng, sensors)
    i, j = level[int(rng.integers(len(level)))]
    own = next(p for p in places(sensors) if i in p)
    size = float(rng.choice([-1, 1]) * rng.uniform(8, 40))

    def seen(shape, f, amount):
        c, s = np.cos(np.radians(amount * size)), np.sin(np.radians(amount * size))
        result = np.array(shape, complex)
        result[i], result[j] = c * shape[i] + s * shape[j], c * shape[j] - s * shape[i]
        return result
    name = common([sensors[k]["channel"] for k in own])
    return Hidden(kind="measurement", name="rotation", size=size, seen=seen,
                  right=frozenset({("sensor rotation", f"{name} about z")}))


def _logger(rng, sensors) -> tuple[list[int], str]:
    """Channels of one logger: of a level with several places, or, where the model's files state no levels, of a
    place."""
    levels: dict[str, list[int]] = {}
    for k, s in enumerate(sensors):
        levels.setdefault(s["level"] if s.get("states_level", True) else str(s["position_m"]), []).append(k)
    level = str(rng.choice(sorted(levels)))
    rows = levels[level]
    # exactly: sensors of a small structure are millimetres apart
    own = len({str(sensors[k]["position_m"]) for k in rows}) == 1
    return rows, common([sensors[k]["channel"] for k in rows]) if own else f"all of {level}"


def _clock(rng, sensors, highest) -> Hidden:
    """Late by a seventh of the highest mode's period at most."""
    rows, name = _logger(rng, sensors)
    size = 1e3 * float(rng.uniform(0.04, 0.14) / highest)

    def seen(shape, f, amount):
        result = np.array(shape, complex)
        result[rows] *= np.exp(2e-3j * np.pi * f * size * amount)
        return result
    return Hidden(kind="measurement", name="clock", size=size, seen=seen,
                  right=frozenset({("clock offset", name)}), settings={"rows": rows})


def _filter(rng, sensors, highest) -> Hidden:
    rows, name = _logger(rng, sensors)
    size = 1e3 * float(rng.uniform(0.05, 0.15) / highest)

    def seen(shape, f, amount):
        result = np.array(shape, complex)
        result[rows] /= 1 + 2e-3j * np.pi * f * size * amount
        return result
    return Hidden(kind="measurement", name="filter", size=size, seen=seen,
                  right=frozenset({("low-pass filter", name)}), settings={"rows": rows})


def measurement(rng, sensors, highest_hz: float) -> Hidden:
    kind = str(rng.choice(["gain", "polarity", "exchange", "rotation", "clock", "filter"]))
    made = {"gain": _gain, "polarity": _polarity, "exchange": _exchange, "rotation": _rotation}.get(kind)
    if made:
        return made(rng, sensors)
    return {"clock": _clock, "filter": _filter}[kind](rng, sensors, highest_hz)


def unknown(rng, anchors, strength, modal_mass, f) -> Hidden:
    """A spring to the ground, a cable or a swinging mass; anchors: (node, axis); `strength(node, axis)`: the stiffness
    in N/m that raises the mode it meets most by 1 % of its frequency; `modal_mass(node, axis)` in kg of that mode,
    whose number is the second of the pair."""
    node, axis = anchors[int(rng.integers(len(anchors)))]
    kind = str(rng.choice(["spring", "cable", "swinging mass"]))
    size = float(rng.uniform(2.0, 6.0))
    way = tuple(float(axis == k) for k in range(3))
    if kind == "swinging mass" and axis < 2:
        mass, number = modal_mass(node, axis)
        one = Attached(node=node, mass=float(mass * rng.uniform(0.01, 0.03)),
                       frequency_hz=float(f[number] * rng.uniform(0.92, 1.08)))
    elif kind == "cable" and len(anchors) > 1:
        other = next(n for n, _ in anchors if n != node)
        one = Attached(node=node, other=other, stiffness=10 * size * strength(node, axis))
    elif axis == 2:
        return unknown(rng, [a for a in anchors if a[1] < 2], strength, modal_mass, f)
    else:
        one = Attached(node=node, direction=way, stiffness=size * strength(node, axis))
    return Hidden(kind="unknown", name=kind, attached=(one,))
