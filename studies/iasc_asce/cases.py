"""What the benchmark hides: five cases, seven patterns of damage, modal sets with noise; and the models that are given.

A case is made from its numbers alone (case, pattern, seed), so that one line of a table can be looked at again.
Stiffnesses are drawn as the given model's prior says: every brace pair of a face and the columns of a storey, each way,
3 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import frame
import numpy as np
from scipy import optimize

from probupdate.modal.modes import ModalData, ModalSet

NOISE = 0.01  # of a frequency, and of a shape's largest component in every component, either part; stated as it is
SCATTER = 0.03
N_SET = 16
# modes of a case: those whose response to its load reaches this share of the strongest one's at any sensor
SEEN = 0.05
DAMPING = 0.01


@dataclass(frozen=True)
class Case:
    """`n_dof` of the structure that is measured, whether its roof is heavier at one corner, the load."""

    number: int
    n_dof: int
    heavy: bool
    load: str


CASES = (
    Case(1, 12, False, "y at every floor"),
    Case(2, 120, False, "y at every floor"),
    Case(3, 12, False, "diagonal at the roof"),
    Case(4, 12, True, "diagonal at the roof"),
    Case(5, 120, True, "diagonal at the roof"),
)


@dataclass(frozen=True)
class Pattern:
    """`lost`: (storey, face or "all", number of one brace or None for both, share of it that is lost)."""

    number: int
    words: str
    lost: tuple[tuple[int, str, int | None, float], ...] = ()
    loose: bool = False

    @property
    def places(self) -> frozenset[str]:
        """Names that a diagnosis has for it."""
        return frozenset(f"braces of storey {s}" if face == "all" else f"b{s}{face}" for s, face, _, _ in self.lost)


PATTERNS = (
    Pattern(0, "none"),
    Pattern(1, "all braces of storey 1", ((1, "all", None, 1.0),)),
    Pattern(2, "all braces of storeys 1 and 3", ((1, "all", None, 1.0), (3, "all", None, 1.0))),
    Pattern(3, "one brace of storey 1", ((1, "x+", 0, 1.0),)),
    Pattern(4, "one brace each of storeys 1 and 3", ((1, "x+", 0, 1.0), (3, "y-", 1, 1.0))),
    Pattern(5, "as 4, one end of a beam of floor 1 loose", ((1, "x+", 0, 1.0), (3, "y-", 1, 1.0)), loose=True),
    Pattern(6, "a third of one brace of storey 1", ((1, "x+", 0, 1 / 3),)),
)
# the beam of floor 1 from the middle of face y- to the floor's middle, at its end on the face
LOOSE_BEAM = (1, (frame.N_PLAN + 1, frame.N_PLAN + 4))


def parameter_names() -> tuple[str, ...]:
    """b<storey><face>: stiffness of the two braces of a face; c<storey><axis>: bending of its columns that way."""
    storeys = range(1, frame.N_STOREY + 1)
    braces = [f"b{s}{face}" for s in storeys for face in frame.FACES]
    return (*braces, *(f"c{s}{axis}" for s in storeys for axis in "xy"))


def lost_braces(pattern: Pattern) -> dict[tuple[int, str, int], float]:
    """(storey, face, number of the brace) -> share of its area that is left, of those that lost any."""
    return {
        (s, face, k): 1 - share
        for s, which, number, share in pattern.lost
        for face in (frame.FACES if which == "all" else (which,))
        for k in ((0, 1) if number is None else (number,))
    }


def stiffness_of(factor: dict[str, float], n_dof: int, pattern: Pattern = PATTERNS[0]) -> np.ndarray:
    """K of the frame with these parameters (absent: 1) and a pattern of damage."""
    left = lost_braces(pattern)
    K = frame.stiffness(*_bars_and_beams(factor, left), n_dof)
    if pattern.loose:
        beam = next(m for m in frame.members() if m.kind == "beam" and m.ends == LOOSE_BEAM[1])
        loose = frame.Member("beam", beam.storey, beam.ends, hinge=True)
        K = K + frame.stiffness((loose, beam), (1.0, -1.0), n_dof)
    for s in range(1, frame.N_STOREY + 1):
        for axis in "xy":
            K = K + (factor.get(f"c{s}{axis}", 1.0) - 1.0) * column_bending(s, axis, n_dof)
    return K


def _bars_and_beams(factor, left):
    kept = [(m, factor.get(f"b{m.storey}{m.face}", 1.0) * left.get((m.storey, m.face, m.number), 1.0)
             if m.kind == "brace" else 1.0) for m in frame.members()]
    return [m for m, _ in kept], [x for _, x in kept]


_BENDING: dict[tuple[int, str, int], np.ndarray] = {}


def column_bending(storey: int, axis: str, n_dof: int) -> np.ndarray:
    """K of what a storey's columns give by bending in one direction (the 12 and the 120 degrees of freedom alike)."""
    key = (storey, axis, n_dof)
    if key not in _BENDING:
        columns = [m for m in frame.members() if m.kind == "column" and m.storey == storey]
        _BENDING[key] = frame.stiffness(columns, [1.0] * len(columns), n_dof, part=axis)
    return _BENDING[key]


def draw(case: Case, seed: int) -> dict[str, float]:
    """Stiffnesses of a structure: each parameter of the model drawn as its prior says."""
    rng = np.random.default_rng([case.number, seed, 0])
    names = parameter_names()
    return dict(zip(names, 1 + SCATTER * rng.standard_normal(len(names)), strict=True))


def seen_modes(case: Case) -> list[int]:
    """Numbers of the nominal modes that the case's load, white noise of force, shows: by their root mean square."""
    K, M = stiffness_of({}, case.n_dof), frame.mass(case.n_dof, case.heavy)
    f, phi = frame.modes(K, M)
    axis = np.arange(12) % 3
    if case.load == "y at every floor":
        loads = np.eye(case.n_dof)[:, :12][:, axis == 1]
    else:
        loads = (np.eye(case.n_dof)[:, [10]] - np.eye(case.n_dof)[:, [9]]) / np.sqrt(2)
    amplitude = np.linalg.norm(phi.T @ loads, axis=1) * np.sqrt(2 * np.pi * f / DAMPING)
    response = amplitude * np.abs(frame.channel_rows(case.n_dof) @ phi).max(axis=0)
    return [int(k) for k in np.flatnonzero(response > SEEN * response.max())]


def shapes_at_sensors(K: np.ndarray, case: Case) -> tuple[np.ndarray, np.ndarray]:
    f, phi = frame.modes(K, frame.mass(case.n_dof, case.heavy))
    phi = frame.channel_rows(case.n_dof) @ phi
    return f, phi / np.abs(phi).max(axis=0)


def mac(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a.T @ b) ** 2 / np.outer(np.sum(a**2, axis=0), np.sum(b**2, axis=0))


def followed(K: Sequence[np.ndarray], case: Case, chosen: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies and shapes of the `chosen` modes of the first of these structures, followed to the last by MAC."""
    f, phi = shapes_at_sensors(K[0], case)
    f, phi = f[list(chosen)], phi[:, list(chosen)]
    for one in K[1:]:
        f_next, phi_next = shapes_at_sensors(one, case)
        _, match = optimize.linear_sum_assignment(-mac(phi, phi_next))
        f, phi = f_next[match], phi_next[:, match]
    return f, phi


def record(case: Case, pattern: Pattern, seed: int, *, time_profile: str, n_set: int = N_SET) -> ModalData:
    """Modal sets, half an hour each; `time_profile`: "constant" (damaged throughout) or "step" (from the middle on)."""
    if time_profile not in ("constant", "step"):
        raise ValueError(f"time profile '{time_profile}' is neither constant nor step")
    factor, chosen = draw(case, seed), seen_modes(case)
    rng = np.random.default_rng([case.number, pattern.number, seed, 1 + (time_profile == "step")])
    nominal = stiffness_of({}, case.n_dof)
    sound = stiffness_of(factor, case.n_dof)
    broken = stiffness_of(factor, case.n_dof, pattern)
    # strong damage turns modes: they are followed in ten steps
    way = [sound + t * (broken - sound) for t in np.linspace(0.1, 1.0, 10)]
    before = followed([nominal, sound], case, chosen)
    after = followed([nominal, sound, *way], case, chosen)
    order = np.argsort(before[0] if time_profile == "step" else after[0])
    sets = []
    for k in range(n_set):
        f, phi = (x[..., order] for x in (before if time_profile == "step" and k < n_set // 2 else after))
        sets.append(ModalSet(
            id=str(np.datetime64("2026-01-01T00:00:00") + np.timedelta64(30 * k, "m")),
            frequency_hz=f * (1 + NOISE * rng.standard_normal(len(f))), damping_ratio=np.full(len(f), DAMPING),
            shape=phi + NOISE * (rng.standard_normal(phi.shape) + 1j * rng.standard_normal(phi.shape)),
            frequency_std_hz=NOISE * f,
            shape_std=np.full(phi.shape, NOISE),
        ))
    return ModalData(channels=frame.CHANNELS, sets=tuple(sets))


def write_model(folder: Path, *, n_dof: int, heavy: bool, std: float = SCATTER) -> Path:
    """model.npz with parameters.toml: the benchmark's own matrices with a row for each pair of braces and for the
    columns of each storey either way."""
    folder.mkdir(parents=True, exist_ok=True)
    names, nominal = parameter_names(), stiffness_of({}, n_dof)
    arrays = {"M0": frame.mass(n_dof, heavy), "channel": np.array(frame.CHANNELS),
              "channel_row": frame.channel_rows(n_dof)}
    tables = []
    for name in names:
        arrays[f"K_{name}"] = stiffness_of({name: 2.0}, n_dof) - nominal
        # braces may be gone; a storey without columns is a mechanism
        lower = 0.0 if name[0] == "b" else 0.3
        tables.append(f'[[parameter]]\nname = "{name}"\nunit = "-"\ninitial = 1.0\nstd = {std}\n'
                      f"lower = {lower}\nupper = 2.0\n")
    arrays["K0"] = nominal - sum(arrays[f"K_{name}"] for name in names)
    np.savez(folder / "model.npz", **arrays)
    (folder / "parameters.toml").write_text("\n".join(tables), encoding="utf-8")
    return folder / "model.npz"


def groups() -> dict[str, dict[str, float]]:
    """What is lost together: all braces of a storey, a size of one being all of them."""
    return {f"braces of storey {s}": {f"b{s}{face}": -1.0 for face in frame.FACES}
            for s in range(1, frame.N_STOREY + 1)}
