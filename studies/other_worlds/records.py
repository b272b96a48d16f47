"""Modal sets of a drawn structure: what is hidden in them, how it runs along the record, and their noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import optimize
from worlds import World, draw_world, modes

from probupdate.effects.catalogue import measurement_effects
from probupdate.modal.modes import ModalData, ModalSet

KINDS = ("storeys", "mast", "truss", "beam")
# masses of the structure about those of the model, each node by itself
MASS_SCATTER = 0.005
# of the largest: a mode that moves the sensors less is not measured
SEEN = 0.05


@dataclass(frozen=True, kw_only=True)
class Scene:
    """What is measured: `state(k)` (K, M) of the structure at each of `n` blocks; `sensors(k, phi, f)` what the sensors
    make of (n_channel, n) motions at the frequencies f (n,), None for sound ones; `environment(k)` what is recorded
    beside it; `sound` (K, M) from which modes are followed (default: the first state)."""

    world: World
    state: Callable[[int], tuple[np.ndarray, np.ndarray]]
    n: int
    sensors: Callable[[int, np.ndarray, np.ndarray], np.ndarray] | None = None
    environment: Callable[[int], dict[str, float]] | None = None
    sound: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def hours(self) -> np.ndarray:
        return 0.5 * np.arange(self.n) if self.n > 20 else 3.0 * np.arange(self.n)


@dataclass(frozen=True, kw_only=True)
class Record:
    """`places`: (cause, location) that would be right, empty where no row describes what is hidden; `size` hidden;
    `time_profile` its time profile; `scene` that `data` are the modes of; `truth`: the parameters, where nothing is
    hidden."""

    family: str
    number: int
    world: World
    scene: Scene
    data: ModalData
    places: frozenset[tuple[str, str]]
    hidden: str
    size: float
    time_profile: str
    truth: dict[str, float] = field(default_factory=dict)


def draw_record(family: str, number: int) -> Record:
    """Record `number` of a family, from its numbers alone."""
    rng = np.random.default_rng([FAMILIES.index(family), number, 20])
    kind = KINDS[number % len(KINDS)]
    if family in ("turned",):
        kind = ("storeys", "mast")[number % 2]
    world = draw_world(kind, rng)
    return _MADE[family](family, number, world, rng)


def _true(world: World, rng: np.random.Generator) -> tuple[dict[str, float], np.ndarray]:
    theta = {p: float(np.clip(1 + world.std[p] * rng.standard_normal(), 1 - 2 * world.std[p], 1 + 2 * world.std[p]))
             for p in world.parts}
    scatter = 1 + 0.5 * MASS_SCATTER * rng.standard_normal(len(world.mass))
    return theta, world.mass * np.outer(scatter, scatter)


def mac(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    # a mode that no sensor sees is like none
    return (a.T @ b) ** 2 / np.maximum(np.outer(np.sum(a**2, axis=0), np.sum(b**2, axis=0)), 1e-300)


def _seen(world: World, K: np.ndarray, M: np.ndarray) -> list[int]:
    _, phi = modes(K, M)
    size = np.abs(world.rows @ phi).max(axis=0)[: world.n_mode]
    return [int(k) for k in np.flatnonzero(size > SEEN * size.max())]


def _followed(states: list[tuple[np.ndarray, np.ndarray]], world: World, chosen: list[int]):
    """Frequencies and shapes at the sensors in the last of these states of the modes that are `chosen` in the first."""
    f, phi = modes(*states[0])
    f, phi = f[chosen], world.rows @ phi[:, chosen]
    for K, M in states[1:]:
        f_next, phi_next = modes(K, M)
        phi_next = world.rows @ phi_next
        n = min(len(f_next), 3 * world.n_mode + 4)
        near = np.exp(-0.5 * (np.log(f[:, None] / f_next[None, :n]) / 0.1) ** 2)
        rows, match = optimize.linear_sum_assignment(-mac(phi, phi_next[:, :n]) - near)
        f, phi = f_next[match], phi_next[:, match]
    return f, phi / np.abs(phi).max(axis=0)


def measured(scene: Scene, rng: np.random.Generator) -> ModalData:
    """Sets of the structure at each block; modes are those of the first set, followed."""
    world, sensors, environment = scene.world, scene.sensors, scene.environment
    noise_f, noise_s = 10 ** rng.uniform(-3.3, -2.5), 10 ** rng.uniform(-2.7, -2.0)
    sound = scene.sound or scene.state(0)
    chosen = _seen(world, *sound)
    known: dict[bytes, tuple] = {}
    sets = []
    for k in range(scene.n):
        here = scene.state(k)
        key = here[0].tobytes() + here[1].tobytes()
        if key not in known:
            way = [(sound[0] + t * (here[0] - sound[0]), sound[1] + t * (here[1] - sound[1]))
                   for t in np.linspace(0, 1, 6)] if here[0].shape == sound[0].shape else [here]
            known[key] = _followed(way, world, chosen)
        f, phi = known[key]
        order = np.argsort(known[next(iter(known))][0])
        f, phi = f[order], phi[:, order].astype(complex)
        if sensors is not None:
            phi = sensors(k, phi, f)
            phi = phi / phi[np.argmax(np.abs(phi), axis=0), np.arange(phi.shape[1])]
        noisy = phi + noise_s * (rng.standard_normal(phi.shape) + 1j * rng.standard_normal(phi.shape))
        sets.append(ModalSet(
            id=str(np.datetime64("2026-01-01T00:00:00") + np.timedelta64(round(60 * scene.hours[k]), "m")),
            frequency_hz=f * (1 + noise_f * rng.standard_normal(len(f))), damping_ratio=np.full(len(f), 0.01),
            shape=noisy, frequency_std_hz=noise_f * f, shape_std=np.full(phi.shape, noise_s),
            environment=environment(k) if environment else {}))
    return ModalData(channels=world.channels, sets=tuple(sets))


def _length(rng: np.random.Generator) -> int:
    return int(rng.choice([16, 24, 48]))


def _null(family, number, world, rng):
    theta, M = _true(world, rng)
    K = world.stiffness(theta)
    scene = Scene(world=world, state=lambda k: (K, M), n=_length(rng))
    return Record(family=family, number=number, world=world, scene=scene, data=measured(scene, rng),
                  places=frozenset(), hidden="nothing", size=0.0, time_profile="", truth=theta)


def _harder_null(family, number, world, rng):
    """Nothing hidden: no standard deviation stated; one stated a third of what it is; single modes of single sets far
    off; masses 2 % off node by node."""
    theta, M = _true(world, rng)
    if family == "null, masses":
        scatter = 1 + 2 * MASS_SCATTER * rng.standard_normal(len(M))
        M = M * np.outer(scatter, scatter)
    K = world.stiffness(theta)
    scene = Scene(world=world, state=lambda k: (K, M), n=_length(rng))
    data, sets = measured(scene, rng), []
    for s in data.sets:
        f, phi, f_std, phi_std = s.frequency_hz, s.shape, s.frequency_std_hz, s.shape_std
        if family == "null, unstated":
            f_std, phi_std = np.full(f.shape, np.nan), np.full(phi.shape, np.nan)
        elif family == "null, too sure":
            f_std, phi_std = f_std / 3, phi_std / 3
        elif family == "null, strays":
            off = rng.random(len(f)) < 0.05
            f = f * np.where(off, 1 + rng.choice([-1, 1], len(f)) * rng.uniform(0.01, 0.05, len(f)), 1.0)
            phi = np.where(off, phi + 0.2 * rng.standard_normal(phi.shape), phi)
        sets.append(replace(s, frequency_hz=f, shape=phi, frequency_std_hz=f_std, shape_std=phi_std))
    return Record(family=family, number=number, world=world, scene=scene, data=replace(data, sets=tuple(sets)),
                  places=frozenset(), hidden="nothing", size=0.0, time_profile="", truth=theta)


def _loss(family, number, world, rng):
    time_profile = "step" if family.endswith("step") else "constant"
    theta, M = _true(world, rng)
    name = str(rng.choice(list(world.parts)))
    loss = float(np.exp(rng.uniform(np.log(0.04), np.log(0.8))))
    if time_profile == "constant":
        # as designed but for what is lost
        theta[name] = 1.0
    n = 2 if family == "two sets" else 9 if family == "nine sets" else _length(rng)
    return _lost(family, number, world, rng, theta, M, {name: -loss}, ("parameter", name), n, time_profile, loss)


def _lost(family, number, world, rng, theta, M, change, place, n, time_profile, loss):
    sound = world.stiffness(theta)
    lost = world.stiffness({p: x * (1 + change.get(p, 0.0)) for p, x in theta.items()})
    # the first block after the step
    at = n // 2 if n < 10 else int(rng.integers(n // 4, 3 * n // 4))
    scene = Scene(world=world, state=lambda k: (lost if time_profile == "constant" or k >= at else sound, M), n=n,
                  sound=(sound, M))
    return Record(family=family, number=number, world=world, scene=scene, data=measured(scene, rng),
                  places=frozenset([place]), hidden=place[1], size=-loss, time_profile=time_profile)


def _two_sets(family, number, world, rng):
    return replace(_loss("two sets step", number, world, rng), family=family)


def _few(family, number, world, rng):
    theta, M = _true(world, rng)
    name, loss = str(rng.choice(list(world.parts))), float(rng.uniform(0.4, 0.8))
    n = {"two sets": 2, "nine sets": 9, "frequencies": 16, "frequencies, 2 sets": 2, "one channel": 16}.get(
        family.removesuffix(" null")) or int(rng.integers(3, 13))
    if family.endswith("null"):
        loss = 0.0
    made = _lost(family, number, world, rng, theta, M, {name: -loss}, ("parameter", name), n, "step", loss)
    data = made.data
    if family.startswith("freq"):
        data = replace(data, sets=tuple(replace(s, shape=np.full(s.shape.shape, np.nan + 0j),
                                                shape_std=np.full(s.shape.shape, np.nan)) for s in data.sets))
    if family.startswith("one"):
        k = len(data.channels) - 2
        sets = []
        for s in data.sets:
            big = np.abs(data.sets[0].shape[k]) > 0.05
            sets.append(ModalSet(
                id=s.id, frequency_hz=s.frequency_hz[big], damping_ratio=s.damping_ratio[big],
                shape=s.shape[[k]][:, big] / s.shape[k, big], shape_std=s.shape_std[[k]][:, big],
                frequency_std_hz=s.frequency_std_hz[big]))
        data = ModalData(channels=(data.channels[k],), sets=tuple(sets))
    if not loss:
        return replace(made, data=data, places=frozenset(), hidden="nothing", time_profile="")
    return replace(made, data=data)


def _sensor(family, number, world, rng):
    theta, M = _true(world, rng)
    K, n, n_channel = world.stiffness(theta), _length(rng), len(world.channels)
    at = 0 if rng.random() < 0.5 else int(rng.integers(n // 4, 3 * n // 4))
    i, j = (int(x) for x in rng.choice(n_channel, 2, replace=False))
    factor, places, size = np.eye(n_channel), frozenset(), 1.0
    if family == "gain":
        size = float(rng.choice([-1, 1]) * rng.uniform(0.08, 0.5))
        factor[i, i] += size
        places = frozenset([("sensor gain", world.channels[i])])
    elif family == "large gain":
        # an amplifier's range, g for m/s2
        size = float(10 ** (rng.choice([-1, 1]) * rng.uniform(0.6, 1.2))) - 1
        factor[i, i] += size
        places = frozenset([("sensor gain", world.channels[i])])
    elif family == "polarity":
        size = -2.0
        factor[i, i] = -1.0
        places = frozenset([("sensor polarity", world.channels[i])])
    elif family == "swap":
        levels = [s.level for s in world.sensors]
        within = [(a, b) for a in range(n_channel) for b in range(a + 1, n_channel) if levels[a] == levels[b]]
        i, j = within[int(rng.integers(len(within)))]
        factor[[i, j]] = factor[[j, i]]
        places = frozenset([("swapped channels", f"{world.channels[i]} and {world.channels[j]}")])
    elif family == "turned":
        size = float(rng.uniform(8.0, 40.0))
        c, s = np.cos(np.radians(size)), np.sin(np.radians(size))
        pairs = [(a, a + 1) for a in range(0, n_channel - 1, 2)]
        i, j = pairs[int(rng.integers(len(pairs)))]
        factor[np.ix_([i, j], [i, j])] = [[c, s], [-s, c]]
        places = frozenset([("sensor rotation", f"{world.channels[i][:-2]} about z")])
    late = family == "clock"
    if late:
        # in milliseconds, up to a seventh of a period of the highest mode
        size = 1e3 * float(rng.uniform(0.02, 0.15) / modes(K, M)[0][world.n_mode - 1])
        places = frozenset(("clock offset", e.location) for e in measurement_effects(world.channels, world.sensors)
                           if e.cause == "clock offset" and e.observe.rows == world.together)

    def sensors(k, phi, f):
        if k < at:
            return phi
        if late:
            phase = np.ones(phi.shape, complex)
            phase[list(world.together)] = np.exp(2e-3j * np.pi * f * size)
            return phase * phi
        return factor @ phi

    scene = Scene(world=world, state=lambda k: (K, M), n=n, sensors=sensors)
    return Record(family=family, number=number, world=world, scene=scene, data=measured(scene, rng), places=places,
                  size=size, hidden=family, time_profile="step" if at else "constant")


def _temperature(rng: np.random.Generator, n: int) -> np.ndarray:
    hours = 0.5 * np.arange(n)
    slow = np.cumsum(rng.standard_normal(n)) / np.sqrt(n)
    return rng.uniform(0, 15) + rng.uniform(3, 8) * np.sin(2 * np.pi * hours / 24 + rng.uniform(0, 6)) + 2 * slow


def _environment(family, number, world, rng):
    """Stiffness falls with temperature, or mass follows a column; the column is given or not."""
    theta, M = _true(world, rng)
    K, n = world.stiffness(theta), 48
    value = _temperature(rng, n)
    heavy = family == "mass column"
    size = float(rng.uniform(0.0003, 0.001)) * (4.0 if heavy else -1.0)

    def state(k):
        change = size * (value[k] - value.mean())
        if heavy:
            change = max(size * (value[k] - value.min()), 0.0)
            return K, M * (1 + change)
        return K * (1 + change), M

    column = "wave_height_m" if heavy else "air_temperature_c"
    known = not family.endswith("untold")
    places = {("stiffness with temperature", "all members")} if family == "temperature" else ()
    scene = Scene(world=world, state=state, n=n,
                  environment=(lambda k: {column: float(value[k])}) if known else None)
    return Record(family=family, number=number, world=world, scene=scene, data=measured(scene, rng),
                  places=frozenset(places), size=size, hidden=family, time_profile=column)


def _outside(family, number, world, rng):
    """A spring to ground, or a tuned mass at one place, from a block on or throughout."""
    theta, M = _true(world, rng)
    K, n, dof = world.stiffness(theta), _length(rng), int(rng.choice(world.ground))
    at = 0 if rng.random() < 0.5 else int(rng.integers(n // 4, 3 * n // 4))
    f, phi = modes(K, M)
    # enough to move the mode that it meets most by 2 to 8 % of its frequency
    size, strength = float(rng.uniform(0.02, 0.08)), np.max(phi[dof, : world.n_mode] ** 2 / f[: world.n_mode] ** 2)
    if family == "ground spring":
        changed = K.copy()
        changed[dof, dof] += 2 * size * (2 * np.pi) ** 2 / strength
        after, sound = (changed, M), (K, M)
    else:
        m = size**2 / np.max(phi[dof, : world.n_mode] ** 2)
        there = f[int(np.argmax(np.abs(phi[dof, : world.n_mode])))] * rng.uniform(0.9, 1.1)
        k = m * (2 * np.pi * there) ** 2
        big = np.zeros((len(K) + 1, len(K) + 1))
        big[:-1, :-1] = K
        big[dof, dof] += k
        big[-1, -1] += k
        big[dof, -1] -= k
        big[-1, dof] -= k
        heavy = np.zeros_like(big)
        heavy[:-1, :-1], heavy[-1, -1] = M, m
        after, sound = (big, heavy), (K, M)
        rows = np.hstack([world.rows, np.zeros((len(world.rows), 1))])
    whole = world

    def state(k):
        return sound if k < at else after

    if family == "tuned mass":
        alone = np.zeros_like(big)
        alone[:-1, :-1], alone[-1, -1] = K, k * 1e3
        light = np.zeros_like(big)
        light[:-1, :-1], light[-1, -1] = M, m
        sound, whole = (alone, light), replace(world, rows=rows)
    scene = Scene(world=whole, state=state, n=n, sound=sound)
    return Record(family=family, number=number, world=world, scene=scene, data=measured(scene, rng),
                  places=frozenset(), size=size, hidden=family, time_profile="step" if at else "constant")


_MADE = {
    "null": _null, "loss step": _loss, "loss constant": _loss,
    "gain": _sensor, "polarity": _sensor, "swap": _sensor, "turned": _sensor, "clock": _sensor,
    "temperature": _environment, "temperature untold": _environment, "mass column": _environment,
    "ground spring": _outside, "tuned mass": _outside,
    "two sets": _few, "two sets null": _few, "nine sets": _few, "nine sets null": _few,
    "frequencies": _few, "frequencies null": _few, "frequencies, 2 sets": _few, "frequencies, 2 sets null": _few,
    "one channel": _few, "one channel null": _few,
    # a family's place seeds its records: a new one goes last
    "null, unstated": _harder_null, "null, too sure": _harder_null, "null, strays": _harder_null,
    "null, masses": _harder_null, "large gain": _sensor,
    "three to twelve sets": _few, "three to twelve sets null": _few,
}
FAMILIES = tuple(_MADE)
