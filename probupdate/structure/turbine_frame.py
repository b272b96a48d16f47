"""From the description of a turbine to its frame.

Rows of Table 2 act so: k_j on E of legs, braces and their joints; k_t on E of the tower; k_TP on E of column, struts
and ties; k_p on E of the piles; LJF multiplies joint stiffness; D_l, t_l, D_b, t_b scale diameters and walls; sc lowers
the mudline; corr is the external wall loss of legs and braces, or of a monopile with its transition piece, in the
splash zone; mg is the growth's thickness; a_m multiplies added mass; m_h is the hub's mass, its inertia kept; py, tz,
qw scale the displacement axis of the soil curves, so that the springs' stiffness goes with 1/factor. k_c multiplies the
stiffness of a monopile's grouted or bolted connection, k_f that of a foundation's springs. Effects (see `effects`) act
on the elements that they choose; where their bands end, elements are cut once more without changing what they are made
of.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from probupdate.structure.description import Description, FoundationTurbine, JacketTurbine, MonopileTurbine
from probupdate.structure.frame import Frame, Support, Tie
from probupdate.structure.frame_effects import check_effects, hang_masses, loosen, prestress
from probupdate.structure.jacket_frame import add_jacket
from probupdate.structure.monopile_frame import add_foundation, add_monopile
from probupdate.structure.nacelle import nacelle_bodies
from probupdate.structure.turbine_mesh import Mesh, add_tower


def described_angle_deg(description: Description) -> float:
    """Where the nacelle looks as described, counter-clockwise from the x axis: to the hub's side of the tower, -x where
    it is above it."""
    x, y, _ = next((entry.offset_m for entry in description.rna if entry.name == "hub"), (-1.0, 0.0, 0.0))
    return float(np.degrees(np.arctan2(y, x))) if np.hypot(x, y) > 0 else 180.0


def build_frame(description: Description, turn_deg: float = 0.0) -> Frame:
    """Mesh the described turbine. Bodies of the nacelle and rotor are tied rigidly to the tower's top, turned about
    the vertical from where the description has them by turn_deg, counter-clockwise seen from above."""
    mesh, head, pile, held = Mesh(description), None, None, ()
    if isinstance(description, JacketTurbine):
        foot, bodies, springs, head = add_jacket(mesh, description)
        pile = f"pile {description.jacket.leg_names[0]}"
    elif isinstance(description, MonopileTurbine):
        foot, bodies, springs, head = add_monopile(mesh, description)
        pile = "monopile"
    else:
        assert isinstance(description, FoundationTurbine)
        foot, bodies, springs, clamped = add_foundation(mesh, description)
        held = (Support(node=foot),) if clamped else ()
    top, flanges = add_tower(mesh, foot)
    hang_masses(mesh)
    loosen(mesh)
    turn = Rotation.from_euler("z", turn_deg, degrees=True).as_matrix()
    nacelle = nacelle_bodies(description, mesh.effects, mesh.nodes[top], turn)
    number = len(mesh.nodes)
    mesh.nodes += nacelle.positions
    mesh.ties += [Tie(node=number + k, master=top, released=released, stiffness=stiffness)
                  for k, (released, stiffness) in enumerate(nacelle.released)]
    bodies += [*flanges, *(replace(body, node=number + body.node) for body in nacelle.bodies)]
    hub = number + [entry.name for entry in description.rna].index("hub")
    frame = Frame(
        node_m=np.array(mesh.nodes), beams=tuple(mesh.beams), ties=tuple(mesh.ties), bodies=tuple(bodies),
        springs=tuple(springs), supports=held, prestress=prestress(description, mesh.effects, hub, turn[:, 0]),
        pile_head=head, pile_part=pile, nacelle=tuple(range(number, len(mesh.nodes))),
    )
    check_effects(mesh)
    return frame
