"""Bodies of the rotor-nacelle assembly and what effects do to them: mass, centre of mass, inertia, swinging blades."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from probupdate.structure.coefficient import Coefficient, parameter
from probupdate.structure.description import Description
from probupdate.structure.effects import Effects
from probupdate.structure.frame import Body


@dataclass(frozen=True, eq=False, kw_only=True)
class Nacelle:
    """Nodes to be tied to the tower's top, those of the bodies in order first: positions, for each the released motions
    (k, 6) with their stiffness (k coefficients); `bodies` count their nodes from zero among these."""

    positions: list[np.ndarray] = field(default_factory=list)
    released: list[tuple[np.ndarray, tuple[Coefficient, ...]]] = field(default_factory=list)
    bodies: list[Body] = field(default_factory=list)


def nacelle_bodies(d: Description, effects: Effects, top_m: np.ndarray, turn: np.ndarray) -> Nacelle:
    """`turn` (3, 3) takes the description's axes to where the nacelle looks; its columns are the nacelle's axes."""
    nacelle = Nacelle()
    for entry in d.rna:
        nacelle.positions.append(top_m + turn @ np.array(entry.offset_m))
        nacelle.released.append((np.zeros((0, 6)), ()))
    for number, entry in enumerate(d.rna):
        mass = parameter("m_h") if entry.name == "hub" else Coefficient(entry.mass_kg)
        shift = tuple((p.name, turn[:, "xyz".index(p.axis)]) for p in effects.on_body("centre_of_mass", entry.name))
        spin = tuple((parameter(p.name), _tensor(turn, np.eye(3)["xyz".index(p.axis)]))
                     for p in effects.on_body("inertia", entry.name))
        own = _tensor(turn, entry.inertia_kgm2)
        nacelle.bodies.append(Body(node=number, mass=mass, inertia_kgm2=own, spin=spin, shift=shift))
        for p in effects.on_body("mass", entry.name):
            per_kg = np.zeros(3) if p.inertia_per_kg_m2 is None else p.inertia_per_kg_m2
            turning = ((parameter(p.name), _tensor(turn, per_kg)),)
            nacelle.bodies.append(Body(node=number, mass=parameter(p.name), spin=turning, shift=shift))
        for p in effects.on_body("oscillator", entry.name):
            _add_swing(nacelle, number, mass * parameter(p.name), shift, turn[:, "xyz".index(p.axis)], p.frequency_hz)
    return nacelle


def _tensor(turn: np.ndarray, diagonal) -> np.ndarray:
    return turn @ np.diag(diagonal) @ turn.T


def _add_swing(
    nacelle: Nacelle, body: int, mass: Coefficient, shift, direction: np.ndarray, frequency_hz: float
) -> None:
    """Move `mass` from a body to a node that follows it but for one direction, where a spring holds it."""
    nacelle.positions.append(nacelle.positions[body])
    nacelle.released.append((np.array([[*direction, 0.0, 0.0, 0.0]]), (mass * (2 * np.pi * frequency_hz) ** 2,)))
    nacelle.bodies.append(Body(node=body, mass=mass * -1.0, shift=shift))
    nacelle.bodies.append(Body(node=len(nacelle.positions) - 1, mass=mass, shift=shift))
