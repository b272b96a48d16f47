"""What a SubDyn file may say and hardly a structure has: materials, members listed twice, joints that stand within a
beam and are not joined to it. Said, not refused: SubDyn takes it, and a file may mean it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from probupdate.io.subdyn_file import BEAMS, Member, Row, SubDynFile
from probupdate.structure.subdyn_frame import SAME_PLACE, odd_ratio

# m/s, the most at which sound runs in any solid: Trachenko et al., Science Advances 6 (2020), eabc8662
FASTEST_MPS = 36_100.0

# line of the file, what is said of it
Doubt = tuple[int, str]


def doubtful_rows(file: SubDynFile) -> tuple[str, ...]:
    """Sentences, one of each kind, with the first line that it holds for and how many more."""
    said = []
    for kind in (_odd_ratios, _odd_densities, _large_sections, _rows_twice, _loose_joints):
        found = list(kind(file))
        more = f" (and {len(found) - 1} more)" if found[1:] else ""
        said += [f"{file.where}, line {line}{more}: {text}" for line, text in found[:1]]
    return tuple(said)


def _used_sets(file: SubDynFile, kinds: tuple[str, ...]) -> Iterator[tuple[int, tuple[float, ...]]]:
    rows = {(row.line, row.values) for m in file.members if m.kind in kinds
            for row in (file.set_of(m), file.set_of(m, 1))}
    yield from sorted(rows)


def _odd_ratios(file: SubDynFile) -> Iterator[Doubt]:
    for line, (e, g, *_) in _used_sets(file, BEAMS):
        if (ratio := odd_ratio(e, g)) is not None:
            yield line, (f"YoungE {e:g} and ShearG {g:g} make Poisson's ratio {ratio:.2g}, which no structural "
                         f"material has (0 to 0.5; steel 0.3 with ShearG {e / 2.6:.3g}); they are used as they stand: "
                         "check digits and units")


def _odd_densities(file: SubDynFile) -> Iterator[Doubt]:
    cables = ((line, (values[0], 0.0, values[1])) for line, values in _used_sets(file, ("cable",)))
    for line, (stiffness, _, density, *_) in chain(_used_sets(file, BEAMS), cables):
        if density > 0 and (speed := (stiffness / density) ** 0.5) > FASTEST_MPS:
            yield line, (f"MatDens {density:g} is little for a stiffness of {stiffness:g}: sound would run at "
                         f"{speed / 1000:.3g} km/s, in no material above 36, in steel at 5; give kg/m3 (of a cable "
                         "kg/m), not t, unless the part is to be rigid or without mass")


def _large_sections(file: SubDynFile) -> Iterator[Doubt]:
    extent = float(np.max(np.ptp([joint.position_m for joint in file.joints], axis=0)))
    for member in file.members:
        if 2 * _radius_m(file, member) > extent:
            yield file.set_of(member).line, (f"the section of member {member.id} is {2 * _radius_m(file, member):g} m "
                                             f"wide, the whole structure {extent:g} m: give metres, not mm")


def _rows_twice(file: SubDynFile) -> Iterator[Doubt]:
    first: dict[object, Member | Row] = {}
    for member in file.members:
        other = first.setdefault(frozenset(member.joints), member)
        if other is not member:
            yield member.line, (f"member {member.id} joins the joints of member {other.id} (line {other.line}) again "
                                "and both count: take one out, unless two parts stand side by side or within one "
                                "another")
    for row in file.masses:
        other = first.setdefault((row.id, row.values), row)
        if other is not row and any(row.values):
            yield row.line, (f"the concentrated mass of joint {row.id} in line {other.line} is listed again and both "
                             "count: take one out, unless there are two")


def _radius_m(file: SubDynFile, member: Member) -> float:
    """The least of a beam's section from its axis outwards; 0 of what has no section."""
    if member.kind not in BEAMS:
        return 0.0
    sizes = np.array([file.set_of(member, end).values[3:] for end in (0, 1)]).min(axis=0)
    return {"circular": sizes[0] / 2, "rectangular": sizes[:2].min() / 2,
            "arbitrary": float(np.sqrt(sizes[0] / np.pi))}[member.kind]


def _loose_joints(file: SubDynFile) -> Iterator[Doubt]:
    """Joints within the section of a beam, or at the place of another joint, that no element joins to its ends; what
    springs, rigid links and beams shorter than thick join counts as one."""
    place = {joint.id: k for k, joint in enumerate(file.joints)}
    at = np.array([joint.position_m for joint in file.joints])
    pairs = np.array([[place[j] for j in member.joints] for member in file.members])
    span_m, radius_m = at[pairs[:, 1]] - at[pairs[:, 0]], np.array([_radius_m(file, m) for m in file.members])
    length_m = np.linalg.norm(span_m, axis=1)
    links = pairs[(length_m < 2 * radius_m) | [m.kind in ("rigid", "spring") for m in file.members]]
    graph = sparse.coo_array((np.ones(len(links)), tuple(links.T)), shape=(len(at),) * 2)
    whose = csgraph.connected_components(graph, directed=False)[1]
    beside: dict[int, set[int]] = {}
    for one, two in whose[pairs]:
        beside.setdefault(one, {one}).add(two)
        beside.setdefault(two, {two}).add(one)
    least, said = SAME_PLACE * float(np.max(np.ptp(at, axis=0))), set()
    for member, (one, two), span, length, radius in zip(file.members, pairs, span_m, length_m, radius_m, strict=True):
        axis = span / length if length > least else np.zeros(3)
        along = (at - at[one]) @ axis
        gap = np.linalg.norm(at - at[one] - along[:, None] * axis, axis=1)
        within = (gap < max(radius, least)) & (along > -least) & (along < length + least)
        for k in set(np.flatnonzero(within).tolist()) - said:
            # beside it from an end of it, as a brace's stub is, but not along its axis
            ends, overlaps = {whose[one], whose[two]}, gap[k] < least < along[k] < length - least
            if not ends & ({whose[k]} if overlaps else beside[whose[k]]):
                said.add(k)
                yield file.joints[k].line, (
                    f"joint {file.joints[k].id} stands within member {member.id} (line {member.line}), {gap[k]:.2g} "
                    "m from its axis, and nothing joins it to the member there: use one joint or a rigid link, unless "
                    "the two are to move apart")
