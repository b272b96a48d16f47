"""Effects that are laid on a mesh once it stands: masses along members, connections, prestress, and the others.

`mesh` is `turbine_frame`'s: nodes, beams with their places, effects and the description.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from probupdate.errors import InputError
from probupdate.structure.coefficient import parameter
from probupdate.structure.description import Description
from probupdate.structure.effects import LEVEL_TOLERANCE_M, Effects, ends
from probupdate.structure.frame import Hinge, LineMass, Prestress


def hang_masses(mesh) -> None:
    """Effects of kind mass on members: evenly along all that they choose."""
    length = [float(np.linalg.norm(mesh.nodes[beam.end] - mesh.nodes[beam.start])) for beam in mesh.beams]
    for p in mesh.effects.of_kind("mass"):
        chosen = [] if p.on.body else [k for k, place in enumerate(mesh.places) if mesh.effects.acts(p, place)]
        whole = sum(length[k] for k in chosen)
        for k in chosen:
            mass = LineMass(per_metre=parameter(p.name) * (1 / whole), dry=True)
            mesh.beams[k] = replace(mesh.beams[k], carried=(*mesh.beams[k].carried, mass))


def loosen(mesh) -> None:
    """Connections: at each node on the level, in the element of a member that starts there, or else ends there."""
    hinges: dict[tuple[int, int], dict[str, tuple[str, ...]]] = {}
    for p in (*mesh.effects.of_kind("hinge"), *mesh.effects.of_kind("slip")):
        found: dict[tuple[str, int], tuple[int, int]] = {}
        for k, (beam, place) in enumerate(zip(mesh.beams, mesh.places, strict=True)):
            for end, node in ((1, beam.end), (0, beam.start)):
                here = abs(mesh.nodes[node][2] - p.at_m) < LEVEL_TOLERANCE_M and mesh.effects.fits(p, place)
                if here and (end == 0 or (beam.part, node) not in found):
                    found[beam.part, node] = (k, end)
        motion = "bending" if p.kind == "hinge" else "slip"
        for at in found.values():
            mesh.effects.note(p)
            own = hinges.setdefault(at, {})
            own[motion] = (*own.get(motion, ()), p.name)
    for (k, end), names in hinges.items():
        beam = mesh.beams[k]
        if beam.hinge is not None:
            raise InputError(f"parameter {next(iter(names.values()))[0]}", f"an element of {beam.part} would have a "
                             "hinge at either end", f"raise mesh.elements_per_member.{beam.group}")
        mesh.beams[k] = replace(beam, hinge=Hinge(end=end, **names))


def prestress(d: Description, effects: Effects, hub: int, along: np.ndarray) -> tuple[Prestress, ...]:
    """Loads that stiffen or soften with a parameter: weight, and thrust in N at the hub along the unit vector (3,)."""
    weights = [Prestress(coefficient=parameter(p.name), gravity_mps2=d.gravity_mps2)
               for p in effects.on_all("weight")]
    thrusts = [Prestress(coefficient=parameter(p.name), node=hub, force_n=along) for p in effects.on_all("thrust")]
    return (*weights, *thrusts)


def check_effects(mesh) -> None:
    """Every effect has found a place, and walls stay at the ends of all bounds."""
    # where sensors sit is asked when they are attached
    mesh.effects.on_all("sensor_height")
    mesh.effects.on_all("sensor_gravity")
    for p in mesh.effects.lost():
        where = "the structure" if not p.on.given else ", ".join(f"{key} = {getattr(p.on, key)}" for key in p.on.given)
        raise InputError(f"parameter {p.name}", f"the kind '{p.kind}' finds nothing to act on at {where}",
                         "check `on`, the joints' law and the levels")
    worst = {p.name: ends(p) for p in mesh.d.parameter}
    for beam in mesh.beams:
        effects = [name for name in beam.tube.wall_loss if name != "corr"]
        values = mesh.d.values | {name: worst[name][1] for name in beam.tube.wall_loss if name in worst}
        if beam.tube.thickness_factor in worst:
            values[beam.tube.thickness_factor] = worst[beam.tube.thickness_factor][0]
        if effects and beam.tube.wall(values) <= 0:
            raise InputError(
                f"parameter {effects[0]}", f"corrosion at its upper bounds leaves {beam.part} a wall of "
                f"{1000 * beam.tube.wall(values):.1f} mm", "lower the upper bounds",
            )
