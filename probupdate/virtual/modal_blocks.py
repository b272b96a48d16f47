"""`simulate_modes`: the virtual turbine's modal sets without its vibration, hundreds of cases a minute-hand apart.

The same plan of operation, SCADA, structure, tolerances and hidden effects as `simulate` for the same seed; each chosen
half hour has the exact modes of its heading and its effects' amounts, as the sensors see them, and the scatter of an
identification (`modal_noise`). Not in it: harmonics, damping bias, modes taken for one another.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from probupdate.errors import InputError
from probupdate.modal.labels import mode_character
from probupdate.modal.modes import ModalData, ModalSet, Sensor
from probupdate.runtime.arrays import frozen_array
from probupdate.virtual import observation, operation
from probupdate.virtual.conditions import AMPLITUDE, expected_rms_mps2, slot_amounts
from probupdate.virtual.dynamics import AERO_DAMPING, N_MODE
from probupdate.virtual.effects import EFFECTS, HiddenEffects, refuse_late
from probupdate.virtual.frame import Structure, build_structure
from probupdate.virtual.modal_noise import SCATTER, identified_modes
from probupdate.virtual.observation import rotation
from probupdate.virtual.reduced_states import ReducedStates, reduce_states
from probupdate.virtual.scada import scada_table
from probupdate.virtual.truth import Truth, draw_truth, parse_truth, read_truth
from probupdate.virtual.turbine_file import TurbineFile, read_turbine, reference_file

LABELS = tuple(SCATTER)
N_SEARCHED = 12  # modes among which those of LABELS are looked for
BLOCK_S = operation.SLOTS_PER_BLOCK * operation.SLOT_S
START = np.datetime64("2019-06-01T00:00:00")
MEANS = (
    "wind_speed_mps", "power_kw", "rotor_speed_rpm", "pitch_deg", "water_level_m", "air_temperature_c", "wave_height_m",
    "wave_period_s",
)


@dataclass(frozen=True, eq=False, kw_only=True)
class VirtualModes:
    """Modal sets and what is true of them: frequency_hz, damping_ratio (n_block, n_mode), shape (n_block, n_channel,
    n_mode) complex as ideal identification would see it, amount (n_block, n_effect), heading_deg (n_block,)."""

    data: ModalData
    sensors: tuple[Sensor, ...]
    truth: Truth
    frequency_hz: np.ndarray
    damping_ratio: np.ndarray
    shape: np.ndarray
    amount: np.ndarray
    heading_deg: np.ndarray
    seed: int


def simulate_modes(
    *,
    model: str | Path | None = None,
    truth: str | Path | Mapping | None = None,
    seed: int,
    days: float = 30.0,
    n_block: int | None = 48,
    states: tuple[str, ...] = ("idling",),
    missing_share: float = 0.03,
    scatter: float = 1.0,
    coarseness: float = 1.0,
) -> VirtualModes:
    """Modal sets of n_block undisturbed half hours (None: all) spread over `days`, in the given turbine states.

    model and truth as for `simulate`; truth may also be the content of a truth.toml. missing_share: chance of a mode
    not to be found in a block. scatter: multiplies the identification's. coarseness: of the finite-element mesh.
    """
    file = read_turbine(reference_file() if model is None else model)
    given = parse_truth(truth, file) if isinstance(truth, Mapping) else read_truth(truth, file)
    for state in states:
        if state not in operation.STATES:
            raise InputError("states", f"'{state}' is unknown", f"choose from {', '.join(operation.STATES)}")
    streams = np.random.SeedSequence(seed, spawn_key=(0,)).spawn(5)
    drawn = draw_truth(given, file, np.random.default_rng(streams[0]), N_MODE)
    refuse_late(drawn.effects, 24 * days, "truth" if truth is None or isinstance(truth, Mapping) else str(truth))
    plan = operation.make_plan(max(round(days * 144), 3), given.operation, np.random.default_rng(streams[1]))
    block = _choose(plan, states, n_block)
    slots = block[:, None] * operation.SLOTS_PER_BLOCK + np.arange(operation.SLOTS_PER_BLOCK)
    amount = slot_amounts(plan, drawn.effects)[slots].mean(axis=1)
    heading = plan.heading_deg[slots[:, 1] * operation.PER_SLOT]
    state = plan.state[slots[:, 1]]
    acts = np.array([EFFECTS[e["kind"]].acts != "measurement" for e in drawn.effects], bool)

    def build(a: np.ndarray) -> Structure:
        return build_structure(file, drawn, a, coarseness=coarseness)

    reduced = reduce_states(build, amount, acts, drawn.damping_ratio)
    motion = _motions(build, reduced, drawn, amount)
    frequency, damping, shape = _true_modes(reduced, motion, file, drawn, amount, heading, state)
    rng = np.random.default_rng(streams[4])
    environment = _environments(plan, block, heading, drawn, amount, np.random.default_rng(streams[3]), rng)
    sets = []
    for k, number in enumerate(block):
        f, z, phi, covariance_factors = identified_modes(frequency[k], damping[k], shape[k], LABELS, BLOCK_S, rng,
                                                   scale=scatter)
        lost = rng.random(len(LABELS)) < missing_share
        f, z, phi = np.where(lost, np.nan, f), np.where(lost, np.nan, z), np.where(lost, np.nan, phi)
        time = START + np.timedelta64(int(number * BLOCK_S), "s")
        sets.append(ModalSet(
            id=f"{time}Z", frequency_hz=f, damping_ratio=z, shape=phi, covariance_factors=covariance_factors,
            frequency_std_hz=np.full(len(f), np.nan), shape_std=np.full(phi.shape, np.nan),
            environment=environment[k],
        ))
    return VirtualModes(
        data=ModalData(channels=tuple(s.channel for s in file.sensors), sets=tuple(sets), labels=LABELS,
                       gravity=tuple(bool(s.gravity) for s in file.sensors)),
        sensors=file.sensors, truth=drawn, frequency_hz=frozen_array(frequency), damping_ratio=frozen_array(damping),
        shape=frozen_array(shape, complex), amount=frozen_array(amount), heading_deg=frozen_array(heading),
        seed=int(seed),
    )


def _choose(plan: operation.Plan, states: tuple[str, ...], n_block: int | None) -> np.ndarray:
    """Numbers of half hours of one wanted state, without a yaw or pitch event, evenly spread."""
    n = plan.n_slot // operation.SLOTS_PER_BLOCK
    by_block = plan.state[: n * operation.SLOTS_PER_BLOCK].reshape(n, -1)
    wanted = [operation.STATES.index(s) for s in states]
    good = np.all(by_block == by_block[:, :1], axis=1) & np.isin(by_block[:, 0], wanted)
    for event in plan.events:
        first, last = int(event.start_s // BLOCK_S), int((event.start_s + event.duration_s) // BLOCK_S)
        good[first : last + 1] = False
    found = np.flatnonzero(good)
    if not len(found):
        raise InputError("states", f"no undisturbed half hour is {' or '.join(states)}", "choose more days")
    if n_block is None or n_block >= len(found):
        return found
    return found[np.unique(np.round(np.linspace(0, len(found) - 1, n_block)).astype(int))]


def _motions(
    build: Callable[[np.ndarray], Structure], reduced: ReducedStates, truth: Truth, amount: np.ndarray
) -> list[np.ndarray]:
    """Of each block the motion of the sensors' points in the basis, and what gravity adds there for a displacement (2,
    n_channel, 3, n), where they sit then."""
    moves = [k for k, effect in enumerate(truth.effects) if effect["kind"] in ("sensor_height", "sensor_gravity")]
    places, place_of = np.unique(amount[:, moves], axis=0, return_inverse=True)
    found = []
    for number in range(len(places)):
        first = amount[np.argmax(place_of.ravel() == number)]
        structure = build(first) if moves else reduced.base
        n_channel = structure.nominal_channel.shape[0]
        found.append(np.array([(rows @ reduced.basis).reshape(n_channel, 3, -1)
                               for rows in (structure.sensor_motion, structure.sensor_tilt)]))
    return [found[number] for number in place_of.ravel()]


def _true_modes(reduced: ReducedStates, motions, file: TurbineFile, truth: Truth, amount, heading, state):
    """Frequencies, damping ratios (n_block, n_mode), complex shapes as mounted (n_block, n_channel, n_mode); motions of
    the sensors' points, a block each."""
    nominal = reduced.base.nominal_channel @ reduced.basis
    head = reduced.basis[6 * reduced.base.top + np.arange(3)]
    reference = _reference(reduced, file, nominal, amount[0], heading[0])
    known, frequency, damping, shape = {}, [], [], []
    for a, motion, angle, running in zip(amount, motions, heading, state > 0, strict=True):
        key = (tuple(a), angle)
        if key not in known:
            f, modes = reduced.modes(a, angle, N_SEARCHED)
            # strain energy in common with the reference's modes: sensors alone take a higher torsion for the first
            energy = reference.T @ reduced.stiffness @ modes
            own = [np.einsum("ij,ik,kj->j", x, reduced.stiffness, x) for x in (reference, modes)]
            common = energy**2 / np.outer(*own)
            chosen = _sort(common, mode_character(nominal @ modes, _turned_sensors(file.sensors, angle)).share)
            known[key] = f[chosen], modes[:, chosen], chosen
        f, modes, chosen = known[key]
        turn = rotation(np.array([0.0, 0.0, -np.radians(angle)]))
        along, across = AERO_DAMPING["operating" if running else "idling"]
        at_top = head @ modes
        aero = (along * (turn[:, 0] @ at_top) ** 2 + across * (turn[:, 1] @ at_top) ** 2) / (4 * np.pi * f)
        hidden = HiddenEffects(effects=truth.effects, amount=tuple(a))
        direction, gain = observation.mounted_direction(file, truth, hidden)
        moved, tilted = np.einsum("c,cx,kcxb->kcb", gain, direction, motion) @ modes
        seen = moved - tilted / (2 * np.pi * f) ** 2
        mixing = observation.channel_mixing(file, hidden)
        seen = seen if mixing is None else mixing @ seen
        response = observation.frequency_response(file, hidden, f)
        seen = seen.astype(complex) if response is None else seen * response.T
        frequency.append(f / observation.sampling_ratio(hidden))
        damping.append(truth.damping_ratio[chosen] + aero)
        shape.append(seen)
    return np.array(frequency), np.array(damping), np.array(shape)


def _turned_sensors(sensors: tuple[Sensor, ...], heading_deg: float) -> tuple[Sensor, ...]:
    """Sensors in the nacelle's axes."""
    back = rotation(np.array([0.0, 0.0, np.radians(heading_deg)]))
    return tuple(Sensor(channel=s.channel, level=s.level, position_m=back @ s.position_m, direction=back @ s.direction)
                 for s in sensors)


def _reference(reduced: ReducedStates, file: TurbineFile, nominal: np.ndarray, amount, heading_deg) -> np.ndarray:
    """First pair, torsion, second pair of the first block in the basis (n, 5), by their character at the sensors; what
    hangs on springs is held: by the shape alone the mode of a mass of a gram is a bending mode of the tower below."""
    _, modes = reduced.modes(amount, heading_deg, N_SEARCHED, held=True)
    character = mode_character(nominal @ modes, _turned_sensors(file.sensors, heading_deg))
    of_structure = (character.local < 0.5) & (np.arange(N_SEARCHED) >= 2)
    twists = np.flatnonzero(of_structure & (np.argmax(character.share, axis=1) == 2))
    torsion = int(twists[0]) if len(twists) else -1
    bending = character.share[:, :2].sum(axis=1)
    second = [k for k in range(2, N_SEARCHED) if k != torsion and of_structure[k] and bending[k] > 0.5][:2]
    if len(second) < 2 or torsion < 0:
        raise InputError("virtual turbine", f"has no torsion or no second pair among its lowest {N_SEARCHED} modes",
                         "correct the truth")
    return modes[:, [0, 1, torsion, *second]]


def _sort(common: np.ndarray, share: np.ndarray) -> list[int]:
    """Which modes are FA1, SS1, T1, FA2, SS2: planes and torsion by what they have in common (5, n_mode) with those of
    the reference, the mates by the nacelle's axes (share (n_mode, 3))."""
    free = np.ones(common.shape[1], bool)
    order = []
    for rows in ((0, 1), (2,), (3, 4)):
        similarity = np.where(free, common[list(rows)].sum(axis=0), -1.0)
        found = np.sort(np.argsort(similarity)[-len(rows):])
        free[found] = False
        if len(found) == 2 and share[found[0], 0] - share[found[0], 1] < share[found[1], 0] - share[found[1], 1]:
            found = found[::-1]
        order += found.tolist()
    return order


def _environments(plan, block, heading, truth: Truth, amount, scada_rng, rng) -> list[dict]:
    """What SCADA and the block itself say of each block, under the names an identification gives them."""
    table = scada_table(plan, START, scada_rng)
    slots = block[:, None] * operation.SLOTS_PER_BLOCK + np.arange(operation.SLOTS_PER_BLOCK)
    state = plan.state[slots[:, 1]]
    rms = expected_rms_mps2(plan.wind_mps[slots].mean(axis=1), plan.wave_height_m[slots].mean(axis=1), state > 0)
    rms = rms * np.exp(np.where(state > 0, AMPLITUDE[1][3], AMPLITUDE[0][3]) * rng.standard_normal(len(block)))
    found = []
    for k in range(len(block)):
        hidden = HiddenEffects(effects=truth.effects, amount=tuple(amount[k]))
        reported = heading[k] + hidden.total("heading_offset")
        found.append({
            "state": operation.STATES[state[k]],
            **{name: float(table[name].to_numpy()[slots[k]].mean()) for name in MEANS},
            "nacelle_heading_deg": float(reported % 360.0),
            # counter-clockwise from x; at heading 0 it looks along -x
            "nacelle_angle_deg": float((-reported) % 360.0 - 180.0),
            "block_minutes": BLOCK_S / 60,
            "rms_mps2": float(rms[k]),
        })
    return found
