"""A case: a drawn structure, what is hidden, and the modal sets that an identification of each block would give."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import linear_sum_assignment

from drawn import hiding, structures
from drawn.hiding import CLASSES, Hidden
from drawn.structures import KINDS, Drawn

START = np.datetime64("2025-03-01T00:00:00")
DAMPING = 0.01
PERIODS = 800.0  # of the first mode in a block
SMALL = 12  # blocks of a small case
# an identification's scatter over the asymptotic one of ln f, and of a channel alone
FACTOR, OWN = 1.6, 0.002
# of the largest: a mode that moves the sensors less, by a hundredth of the power, is not measured
SEEN = 0.1
GRAVITY = 9.81
GAIN, ANGLE_DEG = 0.01, 1.0  # of sound sensors, one standard deviation


@dataclass(frozen=True)
class Case:
    """The case of a kind of structure, a class of what is hidden and a seed, the same forever; small: of turbines of
    few members, and of few blocks, as the diagnosis's time grows with the cube of their number."""

    kind: str
    hidden_class: str
    seed: int
    small: bool = False

    @property
    def id(self) -> str:
        name = f"{self.kind.replace(' ', '-')}-{self.hidden_class}-{self.seed:04d}"
        return f"{name}-small" if self.small else name


@dataclass(frozen=True, kw_only=True)
class Block:
    """When, what SCADA says then, and how much of what is hidden there is (0 or 1)."""

    hour: float
    columns: dict
    amount: float
    level: float = 0.0
    warmer: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Scene:
    """What is measured: a structure, what is hidden in it, its blocks, and what its sound sensors make of a motion."""

    case: Case
    drawn: Drawn
    hidden: Hidden | None
    blocks: tuple[Block, ...]
    sensors: np.ndarray

    def rng(self, what: int) -> np.random.Generator:
        return _stream(self.case, what)


def _stream(case: Case, what: int) -> np.random.Generator:
    return np.random.default_rng([KINDS.index(case.kind), CLASSES.index(case.hidden_class), case.seed, what])


def scene(case: Case) -> Scene:
    drawn = structures.draw(case.kind, 10 * case.seed + CLASSES.index(case.hidden_class), small=case.small)
    hidden = _hidden(case, drawn)
    rng = _stream(case, 2)
    n = int(rng.choice([16, 20, 24]))
    n = SMALL if case.small else n
    hours = 0.5 * np.sort(rng.choice(240, n, replace=False)) if rng.random() < 0.5 else 0.5 * np.arange(n) + 3.0
    stated = bool(_stream(case, 4).random() < 0.5)
    first = 0 if hidden is None or hidden.profile != "step" else int(rng.integers(n // 3, 2 * n // 3 + 1))
    return Scene(case=case, drawn=drawn, hidden=hidden, sensors=_sound_sensors(drawn, _stream(case, 3)),
                 blocks=tuple(_block(k, h, first, hidden, rng, stated=stated) for k, h in enumerate(hours)))


def _hidden(case: Case, drawn: Drawn) -> Hidden | None:
    rng = _stream(case, 1)
    if case.hidden_class == "null":
        return None
    if case.hidden_class == "measurement":
        return hiding.measurement(rng, drawn.sensors, drawn.solve(count=drawn.n_mode).frequency_hz[-1])
    return {"structural": drawn.structural, "environmental": drawn.environmental, "unknown": drawn.unknown}[
        case.hidden_class](rng)


def _block(k: int, hour: float, first: int, hidden, rng, *, stated: bool) -> Block:
    """Weather runs on; only what is hidden follows it. Columns are stated where one matters, or in half of the
    records."""
    warm = 9 + 7 * np.sin(2 * np.pi * hour / 24) + float(rng.normal(0, 0.4))
    tide = 1.6 * np.sin(2 * np.pi * hour / 12.42) + float(rng.normal(0, 0.05))
    columns = {"air_temperature_c": round(float(warm), 2), "water_level_m": round(float(tide), 3),
               "wind_speed_mps": round(float(rng.uniform(2, 14)), 1)}
    follows = hidden.follows if hidden else ""
    return Block(hour=float(hour), columns=columns if stated or follows else {}, amount=float(k >= first),
                 level=columns["water_level_m"] if follows == "water_level_m" else 0.0,
                 warmer=columns["air_temperature_c"] - 9.0 if follows == "air_temperature_c" else 0.0)


def _sound_sensors(drawn: Drawn, rng) -> np.ndarray:
    """(n_channel, n_channel): gains of one per cent, and sensors of two axes turned by a degree."""
    n = len(drawn.sensors)
    turned = np.eye(n)
    for rows in hiding.places(drawn.sensors):
        if len(rows) < 2:
            continue
        i, j = rows[:2]
        angle = np.radians(ANGLE_DEG * np.clip(rng.standard_normal(), -2, 2))
        turned[i, i] = turned[j, j] = np.cos(angle)
        turned[i, j], turned[j, i] = np.sin(angle), -np.sin(angle)
    return np.diag(1 + GAIN * np.clip(rng.standard_normal(n), -2, 2)) @ turned


# modes of every block ------------------------------------------------------------------------------------------------


def chosen_modes(drawn: Drawn) -> np.ndarray:
    """Of the sound structure, the lowest that move the sensors."""
    return np.flatnonzero(move_sensors(drawn.solve(count=drawn.n_mode).shape))


def move_sensors(shape: np.ndarray) -> np.ndarray:
    """(n,) whether modes (n_channel, n) move the sensors enough to be measured."""
    size = np.abs(shape).max(axis=0)
    return size > SEEN * size.max()


def true_modes(s: Scene, block: Block) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (n,) and shapes (n_channel, n) in one block, in the order of the sound structure's modes, through the
    sensors as they are; of more modes than are looked for, as a fault or what is attached may bring others between."""
    h = s.hidden
    n = s.drawn.n_mode
    changes = h.changes(block.amount) if h and h.changes and block.amount else ()
    attached = h.attached if h and block.amount else ()
    solution = s.drawn.solve(changes=changes, attached=attached, level=block.level, warmer=block.warmer,
                             count=n + 6)
    reading = read_by_accelerometers if holds_gravity(s) else lambda _, x: x.shape
    f, shape = solution.frequency_hz, reading(s.drawn, solution)
    # what is weak may have local modes of its own
    seen = move_sensors(shape)
    if seen.sum() >= n:
        f, shape = f[seen], shape[:, seen]
    wanted = reading(s.drawn, s.drawn.solve(count=n))[:, chosen_modes(s.drawn)]
    f, shape = in_order(f, shape, wanted)
    shape = s.sensors @ shape
    if h and h.seen and block.amount:
        shape = h.seen(shape, f, block.amount)
    return f, shape / np.abs(shape).max(axis=0)


def read_by_accelerometers(s: Drawn, solution) -> np.ndarray:
    """(n_channel, n) of displacements (u_x + g theta_y / w^2, u_y - g theta_x / w^2): a sensor that tilts reads
    gravity's component too."""
    direction = np.array([x["direction"] for x in s.sensors])
    tilt = direction[:, :1] * solution.tilt[:, 1] - direction[:, 1:2] * solution.tilt[:, 0]
    return solution.shape + GRAVITY * tilt / (2 * np.pi * solution.frequency_hz) ** 2


def holds_gravity(s: Scene) -> bool:
    """Whether the sets are of accelerometers' readings: half of those of frames."""
    return not s.case.kind.startswith("matrices") and bool(s.rng(7).random() < 0.5)


def in_order(f, shape, wanted) -> tuple[np.ndarray, np.ndarray]:
    """The modes that are most like the wanted ones, with their signs."""
    a, b = (x / np.maximum(np.linalg.norm(x, axis=0), 1e-300) for x in (wanted, shape))
    likeness = np.real(a.conj().T @ b)
    _, order = linear_sum_assignment(-np.abs(likeness))
    sign = np.where(likeness[np.arange(len(order)), order] < 0, -1.0, 1.0)
    return f[order], shape[:, order] * sign


def identified(f, shape, rng) -> tuple[np.ndarray, ...]:
    """What an identification makes of true modes, and what it states: frequencies and shapes with their standard
    deviations. Poles scatter as the asymptotic sqrt(zeta / (2 pi f T)) says; modes mix by the same scatter over the
    distance of their poles, so that a close pair turns freely; each channel has its own scatter besides."""
    n = len(f)
    std = FACTOR * np.sqrt(DAMPING / (2 * np.pi * PERIODS * f / f.min()))
    pole = 2 * np.pi * f * (-DAMPING + 1j * np.sqrt(1 - DAMPING**2))
    size = np.sqrt(np.outer(2 * np.pi * f * std, 2 * np.pi * f * std))
    pushed = rng.standard_normal((n, n)) + 1j * rng.standard_normal((n, n))
    value, mixed = np.linalg.eig(np.diag(pole) + size * pushed)
    share, order = np.abs(mixed) ** 2, np.full(n, -1)
    for _ in range(n):
        mode, vector = np.unravel_index(np.argmax(share), share.shape)
        order[mode] = vector
        share[mode], share[:, vector] = -1, -1
    value, found = value[order], shape @ mixed[:, order]
    found = found / np.abs(found).max(axis=0)
    found = found + OWN * (rng.standard_normal(found.shape) + 1j * rng.standard_normal(found.shape))
    found = found / found[np.argmax(np.abs(found), axis=0), np.arange(n)]
    gap = np.abs(pole[:, None] - pole[None, :]) + np.eye(n)
    turned = np.where(np.eye(n) > 0, 0.0, np.minimum(size / gap, 0.7))
    shape_std = np.sqrt(OWN**2 + np.abs(shape) ** 2 @ (turned.T**2))
    return np.abs(value) / (2 * np.pi), -value.real / np.abs(value), found, std * f, shape_std


def write_modes(s: Scene, path: Path) -> None:
    """modes.json of all blocks, as a user with an identification of his own writes it: no labels."""
    rng, sets = s.rng(5), []
    for block in s.blocks:
        f, shape = true_modes(s, block)
        f, damping, shape, f_std, shape_std = identified(f, shape, rng)
        start = START + np.timedelta64(round(3600 * block.hour), "s")
        sets.append({"id": f"{start}Z", "frequency_hz": f.tolist(), "damping_ratio": damping.tolist(),
                     "frequency_std_hz": f_std.tolist(), "shape_re": shape.real.T.tolist(),
                     "shape_im": shape.imag.T.tolist(), "shape_std": shape_std.T.tolist(),
                     "environment": block.columns})
    content = {"channels": [x["channel"] for x in s.drawn.sensors], "sets": sets}
    if not holds_gravity(s):
        content["gravity"] = False
    path.write_text(json.dumps(content), encoding="utf-8")
