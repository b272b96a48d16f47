"""SubDyn's finite elements: sections, beams, cables, springs, rigid links, joints; the matrices SubDyn itself builds.

Formulas: OpenFAST's SubDyn manual, theory (Damiani et al.), checked against its source (Apache-2.0; no code of it
here): two-node beams with the consistent Euler-Bernoulli mass and rotary inertia, also where the stiffness is
Timoshenko's; sections averaged between the ends of an element; constraints eliminated. Its full-system frequencies
leave gravity out, keep the interface free, hold the fixed directions of the reaction joints and add the soil's K and M
at the others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from probupdate.errors import InputError
from probupdate.io.subdyn_file import BEAMS, Member, SubDynFile
from probupdate.runtime.arrays import frozen_array
from probupdate.structure import beam as beams

# a hundred times what a jacket has; a slip in NDiv would fill the memory
MOST_ELEMENTS = 50_000
# within which two joints are at one place, as a share of the structure's extent
SAME_PLACE = 1e-8
# of a cosine matrix, by the digits that it is written with
DIGITS = 1e-4
# the bending planes of `beam`: local x-y (displacement along SubDyn's x_e, its I_yy) and x-z (along y_e, I_xx)
PLANE = (np.array([1, 5, 7, 11]), np.array([2, 4, 8, 10]))


@dataclass(frozen=True, kw_only=True)
class Section:
    """What a beam element's matrices are made of: E, G, density, area, shear coefficients, second moments about x_e and
    y_e, polar moment (of the mass) and torsion constant; numbers, complex ones for complex steps."""

    e: complex
    g: complex
    density: complex
    area: complex
    kappa_x: complex
    kappa_y: complex
    i_xx: complex
    i_yy: complex
    polar: complex
    torsion: complex


def odd_ratio(e: float, g: float) -> float | None:
    """Poisson's ratio where it is none of what structures are made of: below 0 or above 0.5, rounded."""
    ratio = e / (2 * g) - 1
    return None if 0 <= round(ratio, 1) <= 0.5 else ratio


def tube(e, g, density, diameter, thickness) -> Section:
    """A circular tube, solid where the wall is 0; kappa after Steinboeck et al. (2013), as SubDyn takes it."""
    outer = 0.5 * diameter
    solid = np.ndim(thickness) == 0 and thickness == 0
    inner = 0.0 if solid else outer - thickness
    second = np.pi / 4 * (outer**4 - inner**4)
    nu = e / (2 * g) - 1
    # the hole is that of the wall, also of a solid section, as SubDyn computes it
    ratio = ((outer - thickness) / outer) ** 2
    kappa = 6 * (1 + nu) ** 2 * (1 + ratio) ** 2 / (
        (1 + ratio) ** 2 * (7 + 14 * nu + 8 * nu**2) + 4 * ratio * (5 + 10 * nu + 4 * nu**2))
    return Section(e=e, g=g, density=density, area=np.pi * (outer**2 - inner**2), kappa_x=kappa, kappa_y=kappa,
                   i_xx=second, i_yy=second, polar=2 * second, torsion=2 * second)


def box(e, g, density, side_a, side_b, thickness) -> Section:
    """A rectangular tube of sides a (along x_e) and b, solid where the wall is 0: torsion by Roark and Bredt, kappa
    after Cowper (1966)."""
    a, b, nu = side_a, side_b, e / (2 * g) - 1
    inner_a, inner_b = (a - 2 * thickness, b - 2 * thickness) if thickness != 0 else (0.0, 0.0)
    if inner_a == 0 or inner_b == 0:
        long, short = max(a, b), min(a, b)
        torsion = long * short**3 / 16 * (16 / 3 - 3.36 * short / long * (1 - short**4 / (12 * long**4)))
        kappa_x = kappa_y = 10 * (1 + nu) / (12 + 11 * nu)
    else:
        torsion = 2 * thickness * (a - thickness) ** 2 * (b - thickness) ** 2 / (a + b - 2 * thickness)
        kappa_x, kappa_y = _thin_box(inner_b / a, nu), _thin_box(inner_a / b, nu)
    return Section(
        e=e, g=g, density=density, area=a * b - inner_a * inner_b, kappa_x=kappa_x, kappa_y=kappa_y,
        i_xx=(a * b**3 - inner_a * inner_b**3) / 12, i_yy=(a**3 * b - inner_a**3 * inner_b) / 12,
        polar=(a * b * (a**2 + b**2) - inner_a * inner_b * (inner_a**2 + inner_b**2)) / 12, torsion=torsion,
    )


def _thin_box(m: float, nu: float) -> float:
    return 10 * (1 + nu) * (1 + 3 * m) ** 2 / (
        12 + 72 * m + 150 * m**2 + 90 * m**3 + nu * (11 + 66 * m + 135 * m**2 + 90 * m**3)
        + 10 * m**2 * ((3 + nu) * m + 3 * m**2))


def any_section(e, g, density, area, shear_x, shear_y, i_xx, i_yy, polar, torsion) -> Section:
    """Any section; its shear areas stand beside its area."""
    return Section(e=e, g=g, density=density, area=area, kappa_x=shear_x / area, kappa_y=shear_y / area, i_xx=i_xx,
                   i_yy=i_yy, polar=polar, torsion=torsion)


SECTIONS = {"circular": tube, "rectangular": box, "arbitrary": any_section}


def stiffness_factors(section: Section, length_m: float, shear: bool) -> list[complex]:
    """What multiplies `stiffness_units`: EI / (1 + phi) (bending + phi shear) is written as EI shear + EI / (1 + phi)
    (bending - shear), so that matrices depend on the length alone."""
    factors = [section.e * section.area, section.g * section.torsion]
    for moment, kappa in ((section.i_yy, section.kappa_x), (section.i_xx, section.kappa_y)):
        phi = 12 * section.e * moment / (section.g * kappa * section.area * length_m**2) if shear else 0.0
        factors += [section.e * moment, section.e * moment / (1 + phi)]
    return factors


def stiffness_units(length_m: float) -> list[np.ndarray]:
    """(12, 12) local."""
    unit = beams.stiffness_matrices(length_m)
    matrices = [unit["axial"], unit["torsion"]]
    for index in PLANE:
        pick = np.zeros((12, 12))
        pick[np.ix_(index, index)] = 1.0
        matrices += [pick * unit["shear"], pick * (unit["bending"] - unit["shear"])]
    return matrices


def mass_factors(section: Section) -> list[complex]:
    """What multiplies `mass_units`."""
    inertia = (section.area, section.polar, section.i_yy, section.i_xx)
    return [section.density * size for size in inertia]


def mass_units(length_m: float) -> list[np.ndarray]:
    """(12, 12) local; the first one is that of a mass per metre."""
    matrices = [beams.axial_mass(length_m) + beams.transverse_mass(length_m)[0], beams.torsional_mass(length_m)]
    rotary = beams.rotary_mass(length_m)[0]
    for index in PLANE:
        pick = np.zeros((12, 12))
        pick[np.ix_(index, index)] = 1.0
        matrices.append(pick * rotary)
    return matrices


def translational_mass(length_m: float) -> np.ndarray:
    """(12, 12) local, times mass per metre: SubDyn's cables and rigid links, which carry no rotation."""
    matrix = np.zeros((12, 12))
    for k in (0, 1, 2):
        own, other = (1 / 3, 1 / 6) if k == 0 else (13 / 35, 9 / 70)
        matrix[np.ix_((k, k + 6), (k, k + 6))] = np.array([[own, other], [other, own]]) * length_m
    return matrix


def string_stiffness(length_m: float) -> np.ndarray:
    """(12, 12) local, times the tension: what holds a taut straight cable across its axis."""
    matrix = np.zeros((12, 12))
    for k in (1, 2):
        matrix[np.ix_((k, k + 6), (k, k + 6))] = np.array([[1.0, -1.0], [-1.0, 1.0]]) / length_m
    return matrix


def rigid_body_mass(values) -> np.ndarray:
    """(6, 6) at the joint: mass, J_xx, J_yy, J_zz, J_xy, J_xz, J_yz about the centre of gravity, which lies at the
    offset x, y, z. SubDyn adds the products of inertia as they stand in the file."""
    m, jxx, jyy, jzz, jxy, jxz, jyz, *offset = values
    arm = cross_matrix(np.array(offset))
    inertia = np.array([[jxx, jxy, jxz], [jxy, jyy, jyz], [jxz, jyz, jzz]])
    return np.block([[m * np.eye(3), -m * arm], [m * arm, inertia - m * arm @ arm]])


def cross_matrix(v: np.ndarray) -> np.ndarray:
    """(3, 3): a -> v x a, of v (3,)."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def direction_cosines(start: np.ndarray, end: np.ndarray, spin_deg: float) -> np.ndarray:
    """(3, 3), columns x_e, y_e, z_e of SubDyn in global axes: z_e along the element, x_e level."""
    d = end - start
    length, level = np.linalg.norm(d), np.hypot(d[0], d[1])
    if level < 1e-9 * length or not length:
        turn = np.diag([1.0, -1.0, -1.0]) if d[2] < 0 else np.eye(3)
    else:
        z, x = d / length, np.array([d[1], -d[0], 0.0]) / level
        turn = np.column_stack([x, np.cross(z, x), z])
    angle = np.radians(spin_deg)
    spin = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    return turn @ spin


@dataclass(frozen=True, eq=False, kw_only=True)
class Element:
    """One element between two nodes; `share` (2,): from where to where along its member. `axes` (3, 3), columns x_e,
    y_e, z_e."""

    member: Member
    nodes: tuple[int, int]
    share: tuple[float, float]
    length_m: float
    axes: np.ndarray

    def to_global(self, local: np.ndarray) -> np.ndarray:
        # `beam` has its axis along local x: rows are z_e, x_e, y_e
        return beams.to_global(local, self.axes[:, [2, 0, 1]].T)


@dataclass(frozen=True, eq=False, kw_only=True)
class SubDynFrame:
    """Nodes (the joints first, in the file's order, then those inside members), elements and degrees of freedom.

    A rigid joint has six, any other three translations and three rotations for each element end. `reduction` (n_full,
    n_free) takes what is left after joints, rigid links and supports to all of them; `joint_springs` (n_free, n_free)
    acts in joints that turn.
    """

    file: SubDynFile
    node_m: np.ndarray
    elements: tuple[Element, ...]
    node_of: Mapping[int, int]
    dofs: np.ndarray
    translation: np.ndarray
    reduction: sparse.csr_array
    joint_springs: sparse.csr_array

    def node_dofs(self, node: int) -> np.ndarray:
        """(6,) of a node whose joint is rigid."""
        return self.translation[node]

    def reduce(self, full) -> sparse.csc_array:
        return sparse.csc_array(self.reduction.T @ full @ self.reduction)

    @cached_property
    def n_full(self) -> int:
        return self.reduction.shape[0]

    def assemble(self, parts) -> sparse.csc_array:
        """Sum of ((n,) degrees of freedom, (n, n) matrix) as a reduced matrix."""
        rows, columns, values = [], [], []
        for dofs, matrix in parts:
            n = len(dofs)
            rows.append(np.repeat(dofs, n))
            columns.append(np.tile(dofs, n))
            values.append(np.asarray(matrix).ravel())
        if not rows:
            return sparse.csc_array((self.reduction.shape[1],) * 2)
        entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
        return self.reduce(sparse.csr_array(sparse.coo_array(entries, shape=(self.n_full,) * 2)))


def build_subdyn_frame(file: SubDynFile) -> SubDynFrame:
    """Members cut into NDiv elements, degrees of freedom numbered, constraints eliminated."""
    count = file.n_div * sum(m.kind in BEAMS for m in file.members)
    if count > MOST_ELEMENTS:
        raise InputError(file.where, f"NDiv {file.n_div} makes {count} elements, more than {MOST_ELEMENTS}", "lower it")
    node_of = {joint.id: k for k, joint in enumerate(file.joints)}
    node_m = [np.array(joint.position_m) for joint in file.joints]
    elements = []
    for member in file.members:
        elements += _elements(file, member, node_of, node_m)
    node_m = np.array(node_m)
    dofs, translation, ends, n_full = _number(file, node_m, elements)
    columns, n_column, springs = _joint_columns(file, elements, translation, ends)
    joints = sparse.csr_array(sparse.coo_array(
        (np.array([c[2] for c in columns]), ([c[0] for c in columns], [c[1] for c in columns])),
        shape=(n_full, n_column)))
    held = {node_of[r.joint]: sum(r.fixed) for r in file.reactions}
    links = _rigid_links(node_m, elements, translation, joints, held)
    acted = _active_dofs(file, node_of, translation, elements, dofs, n_full)
    keep = _free_columns(file, node_of, translation, joints, links, acted)
    reduction = sparse.csr_array(joints @ links)[:, keep]
    at_joints = sparse.csr_array(links)[:, keep]
    stiffness = sparse.csr_array((n_column, n_column))
    if springs:
        entries = ([s[2] for s in springs], ([s[0] for s in springs], [s[1] for s in springs]))
        stiffness = sparse.csr_array(sparse.coo_array(entries, shape=(n_column,) * 2))
    return SubDynFrame(
        file=file, node_m=frozen_array(node_m), elements=tuple(elements), node_of=node_of, dofs=dofs,
        translation=translation, reduction=sparse.csr_array(reduction),
        joint_springs=sparse.csr_array(at_joints.T @ stiffness @ at_joints),
    )


def _elements(file: SubDynFile, member: Member, node_of, node_m) -> list[Element]:
    where = f"{file.where}, line {member.line}"
    first, last = (node_of[j] for j in member.joints)
    start, end = node_m[first], node_m[last]
    length = float(np.linalg.norm(end - start))
    apart = length > SAME_PLACE * float(np.max(np.ptp([joint.position_m for joint in file.joints], axis=0)))
    if member.kind == "spring" and apart:
        raise InputError(where, f"the spring {member.id} is {length:.3g} m long", "put its two joints at one place")
    if member.kind != "spring" and not apart:
        raise InputError(where, f"member {member.id} has no length", "move one of its joints")
    axes = direction_cosines(start, end, member.spin_deg)
    if member.cosine is not None:
        rows = np.reshape(next(row.values for row in file.cosines if row.id == member.cosine), (3, 3))
        if np.abs(rows @ rows.T - np.eye(3)).max() > DIGITS or np.linalg.det(rows) < 0:
            raise InputError(where, f"the cosine matrix {member.cosine} of member {member.id} is not a rotation",
                             "correct it: its rows are the element's axes")
        if apart and np.abs(rows[2] - (end - start) / length).max() > DIGITS:
            raise InputError(where, f"the third row of the cosine matrix {member.cosine} is not along member "
                             f"{member.id} from joint {member.joints[0]} to {member.joints[1]}",
                             "correct it, or write -1: its axes follow from its joints then")
        axes = rows.T
    n = file.n_div if member.kind in BEAMS else 1
    nodes = [first, *range(len(node_m), len(node_m) + n - 1), last]
    node_m += [start + (end - start) * k / n for k in range(1, n)]
    return [Element(member=member, nodes=(nodes[k], nodes[k + 1]), share=(k / n, (k + 1) / n), length_m=length / n,
                    axes=axes) for k in range(n)]


def _number(file: SubDynFile, node_m, elements):
    """dofs (n_element, 12), those of each node as a rigid one (n_node, 6; -1 for rotations of a joint that turns), the
    element ends at each joint that turns, and how many there are."""
    n_node, n_joint = len(node_m), len(file.joints)
    rigid = np.ones(n_node, bool)
    rigid[:n_joint] = [joint.kind == "cantilever" for joint in file.joints]
    translation = np.full((n_node, 6), -1)
    dofs = np.full((len(elements), 12), -1)
    ends: dict[int, list[tuple[int, int]]] = {}
    for k, element in enumerate(elements):
        for side, node in enumerate(element.nodes):
            if not rigid[node]:
                ends.setdefault(node, []).append((k, side))
    at = 0
    for node in range(n_node):
        count = 6 if rigid[node] else 3
        translation[node, :count] = np.arange(at, at + count)
        at += count
        for k, side in ends.get(node, ()):
            dofs[k, 6 * side + 3 : 6 * side + 6] = np.arange(at, at + 3)
            at += 3
    for k, element in enumerate(elements):
        for side, node in enumerate(element.nodes):
            if rigid[node]:
                dofs[k, 6 * side : 6 * side + 6] = translation[node]
            else:
                dofs[k, 6 * side : 6 * side + 3] = translation[node, :3]
    return dofs, translation, ends, at


def _joint_columns(file: SubDynFile, elements, translation, ends):
    """Entries (row, column, value) that give all degrees of freedom from what the joints leave, how many columns, and
    entries of the joints' own stiffness."""
    entries, springs, column = [], [], 0
    for node in range(len(translation)):
        shared = translation[node][translation[node] >= 0]
        entries += [(int(d), column + k, 1.0) for k, d in enumerate(shared)]
        column += len(shared)
        if node not in ends:
            continue
        joint, axes = file.joints[node], [elements[k].axes for k, _ in ends[node]]
        turns, free = _turns(file, joint, axes)
        # rows of the rotations: behind the node's three translations, three for each end
        first = int(translation[node, 2]) + 1
        entries += [(first + i, column + j, float(turns[i, j])) for i, j in zip(*np.nonzero(turns), strict=True)]
        for i, own in enumerate(free):
            for j, other in enumerate(free):
                for a, b in zip(own, other, strict=True):
                    value = joint.stiffness * (len(free) - 1 if i == j else -1)
                    if value:
                        springs.append((column + a, column + b, value))
        column += turns.shape[1]
    return entries, column, springs


def _turns(file: SubDynFile, joint, axes) -> tuple[np.ndarray, list[tuple[int, ...]]]:
    """Rotations of every element end (3 n, n_column) from those a joint leaves, and which columns belong to an end."""
    n = len(axes)
    if joint.kind == "ball":
        return np.eye(3 * n), [tuple(range(3 * k, 3 * k + 3)) for k in range(n)]
    if joint.kind == "revolute":
        own = np.array(joint.direction) / np.linalg.norm(joint.direction)
        one = np.cross(own, np.eye(3)[np.argmin(np.abs(own))])
        one /= np.linalg.norm(one)
        shared = np.tile(np.column_stack([one, np.cross(own, one)]), (n, 1))
        return np.hstack([shared, np.kron(np.eye(n), own[:, None])]), [(2 + k,) for k in range(n)]
    if n != 2:
        raise InputError(f"{file.where}, line {joint.line}", f"the universal joint {joint.id} has {n} members",
                         "a universal joint connects two")
    # the twist goes through, each end's axis turned the same way along the line of the two
    first, second = axes
    sign = -1.0 if first[:, 2] @ second[:, 2] < 0 else 1.0
    twist = np.concatenate([first[:, 2], sign * second[:, 2]])[:, None]
    bending = np.zeros((6, 4))
    bending[:3, :2], bending[3:, 2:] = first[:, :2], second[:, :2]
    return np.hstack([twist, bending]), [(1, 2), (3, 4)]


def _rigid_links(node_m, elements, translation, joints, held: Mapping[int, int]) -> sparse.csr_array:
    """(n_column, n_left): what is left where rigid links join nodes; of each assembly the node leads that is held in
    most directions (node -> how many), or the first one."""
    n_column = joints.shape[1]
    links = [e.nodes for e in elements if e.member.kind == "rigid"]
    if not links:
        return sparse.eye_array(n_column, format="csr")
    pairs = np.array(links)
    graph = sparse.coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(node_m),) * 2)
    _, label = csgraph.connected_components(graph, directed=False)
    # a rigid node's columns are those of its own six degrees of freedom
    column_of = {}
    for row, column in zip(*sparse.coo_array(joints).coords, strict=True):
        column_of.setdefault(int(row), int(column))
    linked = np.unique(pairs)
    leader = {int(label[node]): node for node in sorted(map(int, linked), key=lambda n: (held.get(n, 0), -n))}
    follower = [int(node) for node in linked if leader[int(label[node])] != node]
    dropped = {column_of[int(d)] for node in follower for d in translation[node]}
    left = [c for c in range(n_column) if c not in dropped]
    place = {c: k for k, c in enumerate(left)}
    entries = [(c, place[c], 1.0) for c in left]
    for node in follower:
        lead = leader[int(label[node])]
        motion = np.eye(6)
        motion[:3, 3:] = -cross_matrix(node_m[node] - node_m[lead])
        rows = [column_of[int(d)] for d in translation[node]]
        columns = [place[column_of[int(d)]] for d in translation[lead]]
        entries += [(rows[i], columns[j], motion[i, j]) for i, j in zip(*np.nonzero(motion), strict=True)]
    return sparse.csr_array(sparse.coo_array(
        ([e[2] for e in entries], ([e[0] for e in entries], [e[1] for e in entries])), shape=(n_column, len(left))))


def _active_dofs(file: SubDynFile, node_of, translation, elements, dofs, n_full: int) -> np.ndarray:
    """(n_full,) which degrees of freedom anything stiff or heavy is at: all but rotations where cables alone end."""
    acted = np.zeros(n_full, bool)
    for own, element in zip(dofs, elements, strict=True):
        acted[own if element.member.kind != "cable" else own[[0, 1, 2, 6, 7, 8]]] = True
    for row in file.masses:
        if any(row.values[1:]):
            acted[translation[node_of[row.id]]] = True
    for reaction in file.reactions:
        if reaction.ssi is not None:
            acted[translation[node_of[reaction.joint]]] = True
    return acted


def _free_columns(file: SubDynFile, node_of, translation, joints, links, acted: np.ndarray) -> np.ndarray:
    """The columns that no reaction joint holds and that move anything."""
    moved = sparse.csr_array(joints @ links)
    held: set[int] = set()
    # who leads rigid links is held in most directions, and those that follow with it
    for reaction in sorted(file.reactions, key=lambda r: -sum(r.fixed)):
        node = node_of[reaction.joint]
        where = f"{file.where}, line {reaction.line}"
        if file.joints[node].kind != "cantilever":
            raise InputError(where, f"the reaction joint {reaction.joint} is {file.joints[node].kind}",
                             "hold a rigid joint (type 1)")
        for k in np.flatnonzero(reaction.fixed):
            row = set(moved[[int(translation[node, k])]].indices.tolist())
            if len(row) > 1 and not row <= held:
                raise InputError(where, f"rigid links join the reaction joint {reaction.joint} to another one, and "
                                 "neither is held in all six directions", "hold one of them so, or give both soil")
            held |= row
    moving = abs(moved).T @ acted.astype(float) > 0
    return np.array([c for c in range(moved.shape[1]) if c not in held and moving[c]])


def sizes_at(
    file: SubDynFile, element: Element, end: int | None = None
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """E, G, density and the sizes of a beam element, averaged between its ends as SubDyn does, or those at an end."""
    one, two = (file.set_of(element.member, side).values for side in (0, 1))
    at = 0.5 * (element.share[0] + element.share[1]) if end is None else element.share[end]
    return one[:3], tuple(a + (b - a) * at for a, b in zip(one[3:], two[3:], strict=True))


def section_at(file: SubDynFile, element: Element) -> Section:
    """The section of a beam element as the file has it."""
    material, sizes = sizes_at(file, element)
    return SECTIONS[element.member.kind](*material, *sizes)


def plain_matrices(file: SubDynFile, element: Element) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and mass (12, 12), global, of an element as the file has it."""
    member, length = element.member, element.length_m
    if member.kind in BEAMS:
        section = section_at(file, element)
        factors = stiffness_factors(section, length, file.shear)
        stiffness = sum(c * unit for c, unit in zip(factors, stiffness_units(length), strict=True))
        mass = sum(c * unit for c, unit in zip(mass_factors(section), mass_units(length), strict=True))
        return element.to_global(np.asarray(stiffness)), element.to_global(np.asarray(mass))
    values = file.set_of(member).values
    if member.kind == "rigid":
        return np.zeros((12, 12)), element.to_global(values[0] * translational_mass(length))
    if member.kind == "cable":
        ea, density, tension = values[:3]
        rest = length / (1 + tension / ea)
        stiffness = ea * length / rest * beams.stiffness_matrices(length)["axial"] + tension * string_stiffness(length)
        return element.to_global(stiffness), element.to_global(density * translational_mass(rest))
    half = np.zeros((6, 6))
    half[np.triu_indices(6)] = values
    half = half + np.triu(half, 1).T
    turn = np.kron(np.eye(2), element.axes)
    half = turn @ half @ turn.T
    return np.block([[half, -half], [-half, half]]), np.zeros((12, 12))
