"""How a finding changes fatigue: stress ranges in members per measured motion, with the effect over without.

Both models see the same tower-top motion in the first pair of bending modes, as that is measured; they differ in what
stress goes with it. Damage goes with stress^m, m = 3 and 5 as in the two-slope S-N curves of DNV-RP-C203. Nominal
stress at the ends of members; stress concentration factors are alike on both sides and cancel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from probupdate.diagnosis.expected import parameters_with
from probupdate.diagnosis.fitting import Fit
from probupdate.diagnosis.prepare import Prepared
from probupdate.diagnosis.problem import DiagnosisProblem
from probupdate.modal.modes import Sensor
from probupdate.runtime.arrays import frozen_array
from probupdate.structure import beam as beams
from probupdate.structure.assembly import assemble, beam_stiffness, node_dofs
from probupdate.structure.channels import channel_rows
from probupdate.structure.description import Description
from probupdate.structure.eigen import lowest_modes
from probupdate.structure.extend import extended_description
from probupdate.structure.turbine_frame import build_frame

SLOPES = (3, 5)
# members whose stress is compared, by what the turbine stands on
GROUPS = {"jacket": ("leg", "brace"), "monopile": ("pile", "column", "tower"), "foundation": ("tower",)}
# spots with less stress than this share of their group's largest hardly decide a life
LOADED = 0.5


@dataclass(frozen=True, eq=False, kw_only=True)
class Stresses:
    """Nominal stress (n_spot,) in Pa per metre of tower-top motion, both directions of the pair together, at the ends
    of members; `group`, `place` of each; frequency_hz of the pair's mean."""

    stress: np.ndarray
    group: tuple[str, ...]
    place: tuple[str, ...]
    frequency_hz: float


def member_stresses(
    description: Description, values: Mapping[str, float], sensors: Sequence[Sensor], where: str
) -> Stresses:
    """Of the first two modes, scaled so that the highest sensors move by one metre in each direction: root of the sum
    of squares over both, which does not depend on how the pair is turned."""
    frame = build_frame(description)
    theory = description.mesh.theory
    built = assemble(frame, updated=(), values=values, theory=theory,
                     gravity_mps2=description.gravity_mps2 if description.mesh.geometric_stiffness else None)
    weights = built.coefficients(np.zeros(0))
    K, M = (sum(c * term for c, term in zip(w, terms, strict=True))
            for w, terms in zip(weights, (built.stiffness, built.mass), strict=True))
    value, phi = lowest_modes(K, M, 2, where)
    highest = max(s.position_m[2] for s in sensors)
    top = [s for s in sensors if s.position_m[2] > highest - 0.5]
    rows, _ = channel_rows(frame, tuple(top), {s.channel: s.part for s in description.sensor}, where)
    seen = (rows[: len(top)] @ built.transform) @ phi
    # sensors' directions into x and y, then the pair into one metre along each
    axes = np.array([s.direction[:2] for s in top])
    motion = np.linalg.pinv(axes) @ seen
    u = (built.transform @ phi) @ np.linalg.inv(motion)
    stress, group, place = [], [], []
    for one in frame.beams:
        if one.group not in GROUPS[description.stands_on]:
            continue
        start, end = frame.node_m[one.start], frame.node_m[one.end]
        dofs = node_dofs(one.start, one.end)
        force = np.zeros((12, 2))
        for _, matrix, coefficient in beam_stiffness(_bare(one), start, end, theory):
            force += float(coefficient.value(values)) * (matrix @ u[dofs])
        local = beams.axes(start, end)
        area, second = float(one.tube.area(values)), float(one.tube.second_moment(values))
        radius = 0.5 * float(one.tube.outer(values))
        for node, z in ((0, start[2]), (6, end[2])):
            axial = local[0] @ force[node : node + 3]
            moment = local[1:] @ force[node + 3 : node + 6]
            each = np.abs(axial) / area + radius * np.linalg.norm(moment, axis=0) / second
            stress.append(float(np.linalg.norm(each)))
            group.append(one.group)
            place.append(f"{one.part} at {z:.1f} m")
    return Stresses(stress=frozen_array(stress), group=tuple(group), place=tuple(place),
                    frequency_hz=float(np.mean(np.sqrt(value)) / (2 * np.pi)))


def _bare(one):
    """The beam without its soil springs, whose forces are not the section's."""
    return replace(one, springs=None)


def fatigue_change(prepared: Prepared, problem: DiagnosisProblem, old: Fit, new: Fit) -> dict:
    """Plain numbers for diagnosis.json: of each group of members (legs and braces of a jacket) the most stressed spot,
    and the loaded spot whose stress grows most, each with its ratio of stress and of damage. Effects are as after their
    step; covariates at their mean.

    Empty for a model without members.
    """
    if prepared.description is None:
        return {}
    added = {a.name: a for n in (*old.included, *new.included) if (a := n.effect.adds) is not None}
    description = extended_description(prepared.path, list(added.values()))
    sides = [member_stresses(description, description.values | _values(problem, f), prepared.sensors,
                             str(prepared.path)) for f in (old, new)]
    before, after = sides
    faster = after.frequency_hz / before.frequency_hz
    result = {"per": "tower-top motion in the first pair of modes", "slopes": list(SLOPES)}
    for name in GROUPS[prepared.description.stands_on]:
        rows = np.array([g == name for g in before.group])
        if not rows.any():
            continue
        larger = np.maximum(before.stress, after.stress)
        loaded = np.flatnonzero(rows & (larger > LOADED * larger[rows].max()))
        ratio = after.stress[loaded] / before.stress[loaded]
        spots = {"most_stressed": loaded[np.argmax(larger[loaded])], "grows_most": loaded[np.argmax(ratio)]}
        result[name] = {key: _spot(before, after, k, faster) for key, k in spots.items()}
    return result


def _spot(before: Stresses, after: Stresses, k: int, faster: float) -> dict:
    ratio = float(after.stress[k] / before.stress[k])
    return {"place": before.place[k], "stress_ratio": ratio} | {
        f"damage_ratio_m{m}": float(faster * ratio**m) for m in SLOPES}


def _values(problem: DiagnosisProblem, fitted: Fit) -> dict[str, float]:
    """Parameters by name, effects in their full size."""
    names = problem.predictor.parameters.names
    throughout = [0.0 if n.time_profile.kind == "covariate" else 1.0 for n in fitted.included]
    theta = parameters_with(problem.predictor.parameters, fitted.theta, fitted.included, throughout)
    known = {names[k] for k in problem.updated} | {
        name for n in fitted.included for name, _ in n.effect.increments if n.effect.observe is None}
    return {name: float(v) for name, v in zip(names, theta, strict=True) if name in known}
